//! What the picture shows, collected from a finished data set.

use std::collections::BTreeMap;
use std::path::Path;

use rayon::prelude::*;

use super::sheet::SHEET;
use super::{HeightMap, Overview, PathLine, SheetFrame};
use crate::dataset::depth_png::status;
use crate::dataset::error::{DatasetError, Result};
use crate::dataset::manifest::Manifest;
use crate::dataset::reader::{Dataset, WorldReader};
use crate::sense::DepthKind;

/// Points of a path on the picture, at most.
const PATH_POINTS: usize = 400;

/// What one world adds to the picture.
struct Gathered {
    paths: Vec<PathLine>,
    contacts: Vec<(f64, [f64; 2])>,
    length_m: f64,
    top_speed_m_s: f64,
    n_frames: u64,
    quarantined: bool,
}

impl Overview {
    /// Collects from a finished data set what the picture shows. The scene from above comes from the caller.
    ///
    /// Frames: up to four worlds spread over all, three times each (more of each where there are fewer worlds). Paths are
    /// thinned to at most 400 points each.
    pub fn from_dataset(data: &Dataset, map: HeightMap) -> Result<Self> {
        let m = data.manifest();
        let worlds = data.worlds();
        if worlds.is_empty() {
            return Err(DatasetError::Overview {
                item: data.dir().display().to_string(),
                expected: "a data set with at least one finished world".into(),
                found: "none".into(),
            });
        }
        let frames = if m.cameras.is_empty() { Vec::new() } else { all_frames(data, &worlds)? };
        let gathered: Vec<Gathered> =
            worlds.par_iter().map(|world| gather(&data.world(*world)?, m)).collect::<Result<_>>()?;
        let (title, subtitle) = (title(m), subtitle(m));
        Ok(Self {
            title,
            subtitle,
            sheet_heading: "Depth and geoms, exact".to_owned(),
            notes: notes(m, &gathered, &frames),
            frames,
            contacts: gathered.iter().flat_map(|g| g.contacts.iter().copied()).collect(),
            paths: gathered.into_iter().flat_map(|g| g.paths).collect(),
            map,
            seconds: m.seconds,
            clearance_max_m: m.flight.clearance_max_m,
        })
    }
}

/// Scene, drones, worlds, time and seed.
fn title(m: &Manifest) -> String {
    let scene = Path::new(&m.scene.name)
        .file_stem()
        .map_or_else(|| m.scene.name.clone(), |s| s.to_string_lossy().into_owned());
    let mut drones: Vec<&str> = m.vehicles.iter().map(|v| v.name.as_str()).collect();
    drones.dedup();
    let (drones, worlds) = (drones.join(" + "), plural(m.n_worlds, "world"));
    format!("{scene} · {drones} · {worlds} × {} s · seed {}", m.seconds, m.seed)
}

/// How they fly, and what they see with.
fn subtitle(m: &Manifest) -> String {
    let camera = m.cameras.first().map_or("no camera".to_owned(), |c| {
        let kind = match c.kind {
            DepthKind::Range => "range",
            DepthKind::ZDepth => "z-depth",
        };
        let (size, range) = (format!("{}×{}", c.width, c.height), format!("{} to {} m", c.near_m, c.far_m));
        format!("camera {} {size} at {} Hz, {kind} {range}", c.name, m.fps)
    });
    let trajectory = m.flight.trajectory.get("kind").and_then(|k| k.as_str()).unwrap_or("custom");
    let (control, integrator) = (&m.flight.control_mode, &m.flight.integrator);
    format!("{trajectory}, control {control}, integrator {integrator} at {} Hz · {camera}", m.flight.sim_hz)
}

/// What happened in all flights together.
fn notes(m: &Manifest, gathered: &[Gathered], frames: &[SheetFrame]) -> Vec<String> {
    let n_quarantined = gathered.iter().filter(|g| g.quarantined).count();
    let n_touching = gathered.iter().filter(|g| !g.contacts.is_empty()).count();
    let n_contacts: usize = gathered.iter().map(|g| g.contacts.len()).sum();
    let mut notes = vec![format!(
        "{} in {}: {n_touching} of them with contacts ({n_contacts} in all), {n_quarantined} quarantined.",
        plural(m.n_drones * gathered.len(), "flight"),
        plural(gathered.len(), "world"),
    )];
    let clearances = gathered.iter().flat_map(|g| &g.paths).flat_map(|p| &p.clearance_m).copied();
    let least = clearances.filter(|c| !c.is_nan()).fold(f64::INFINITY, f64::min);
    let near = if least.is_finite() {
        format!("least clearance {least:.2} m")
    } else {
        "no clearance below the limit".into()
    };
    let length_m: f64 = gathered.iter().map(|g| g.length_m).sum();
    let top_speed = gathered.iter().map(|g| g.top_speed_m_s).fold(0.0, f64::max);
    notes.push(format!("{length_m:.0} m flown, top speed {top_speed:.1} m/s, {near}."));
    let pixels: usize = frames.iter().map(|f| f.status.len()).sum();
    if pixels > 0 {
        let hits = frames.iter().flat_map(|f| &f.status).filter(|s| **s == status::HIT).count();
        let n_frames: u64 = gathered.iter().map(|g| g.n_frames).sum::<u64>() * m.n_drones as u64;
        let share = 100.0 * hits as f64 / pixels as f64;
        notes.push(format!("{n_frames} depth images; {share:.0} % of the pixels above are hits."));
    }
    notes
}

fn plural(n: usize, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}

/// Frames of the contact sheet: worlds and times spread over all.
fn all_frames(data: &Dataset, worlds: &[usize]) -> Result<Vec<SheetFrame>> {
    let n = worlds.len().min(SHEET.0);
    let per_world = SHEET.0 * SHEET.1 / n;
    let mut frames = Vec::new();
    for i in 0..n {
        let world = worlds[if n > 1 { i * (worlds.len() - 1) / (n - 1) } else { 0 }];
        frames.extend(sheet_frames(&data.world(world)?, world, data.manifest().n_drones, per_world)?);
    }
    Ok(frames)
}

/// `n` frames of a world, spread over time; drones take turns.
fn sheet_frames(world: &WorldReader, number: usize, n_drones: usize, n: usize) -> Result<Vec<SheetFrame>> {
    let frames = world.frames()?;
    let have = frames.time_s.len();
    let n = n.min(have);
    Ok((0..n)
        .map(|i| {
            let (f, drone) = ((2 * i + 1) * have / (2 * n), i % n_drones);
            let depth = frames.depth_m.index_axis(ndarray::Axis(0), f);
            let depth = depth.index_axis(ndarray::Axis(0), drone);
            let (height, width) = depth.dim();
            let status = frames.status.index_axis(ndarray::Axis(0), f);
            let geom_id = frames.geom_id.index_axis(ndarray::Axis(0), f);
            SheetFrame {
                world: number,
                drone,
                t_s: frames.time_s[f],
                width,
                height,
                depth_m: depth.iter().copied().collect(),
                status: status.index_axis(ndarray::Axis(0), drone).iter().copied().collect(),
                geom_id: geom_id.index_axis(ndarray::Axis(0), drone).iter().copied().collect(),
            }
        })
        .collect())
}

fn gather(world: &WorldReader, m: &Manifest) -> Result<Gathered> {
    let (mut paths, mut length_m, mut top_speed_m_s) = (Vec::new(), 0.0, 0.0f64);
    let states = world.states(Some(&["t", "drone", "px", "py", "pz", "vx", "vy", "vz"]))?;
    let get = |name| states.column(name);
    let (t, drone) = (get("t")?, get("drone")?);
    let (p, v) = ([get("px")?, get("py")?, get("pz")?], [get("vx")?, get("vy")?, get("vz")?]);
    let clearances = if m.flight.clearance_every_steps > 0 { Some(clearances(world)?) } else { None };
    for d in 0..m.n_drones {
        let rows: Vec<usize> = (0..t.len()).filter(|i| drone[*i] == d as f64).collect();
        for pair in rows.windows(2) {
            let step: f64 = (0..3).map(|k| (p[k][pair[1]] - p[k][pair[0]]).powi(2)).sum::<f64>().sqrt();
            if step.is_finite() {
                length_m += step;
            }
        }
        for i in &rows {
            let speed = (0..3).map(|k| v[k][*i].powi(2)).sum::<f64>().sqrt();
            // f64::max passes over NaN.
            top_speed_m_s = top_speed_m_s.max(speed);
        }
        let near: Option<Vec<(f64, f64)>> = clearances
            .as_ref()
            .map(|rows| rows.iter().filter(|r| r.1 == d as f64).map(|r| (r.0, r.2)).collect());
        let points = rows.iter().map(|i| (t[*i], [p[0][*i], p[1][*i]])).collect::<Vec<_>>();
        paths.push(thinned(&points, near.as_deref()));
    }
    Ok(Gathered {
        paths,
        contacts: beginnings(world, m.flight.contact_every_steps)?,
        length_m,
        top_speed_m_s,
        n_frames: world.record().n_frames,
        quarantined: world.record().quarantine.is_some(),
    })
}

/// Rows of the table of clearances: time, drone, distance.
fn clearances(world: &WorldReader) -> Result<Vec<(f64, f64, f64)>> {
    let table = world.clearance(Some(&["t", "drone", "distance"]))?;
    let columns = table.column("t")?.iter().zip(table.column("drone")?).zip(table.column("distance")?);
    // An empty distance is one beyond the range of the search.
    Ok(columns.map(|((t, drone), c)| (*t, *drone, if c.is_nan() { f64::INFINITY } else { *c })).collect())
}

/// A path of at most [`PATH_POINTS`] points and its last one: (time, place); `near` is (time, clearance), none where it was not measured.
fn thinned(points: &[(f64, [f64; 2])], near: Option<&[(f64, f64)]>) -> PathLine {
    let stride = points.len().div_ceil(PATH_POINTS).max(1);
    let mut path = PathLine { t_s: Vec::new(), xy_m: Vec::new(), clearance_m: Vec::new() };
    let mut next = 0;
    for (k, (t_s, xy_m)) in points.iter().enumerate() {
        if k % stride != 0 && k + 1 != points.len() {
            continue;
        }
        // The least clearance since the point before, so that thinning hides no near pass.
        let mut least = f64::NAN;
        if let Some(near) = near {
            let from = next;
            while next < near.len() && near[next].0 <= *t_s {
                least = least.min(near[next].1);
                next += 1;
            }
            if next == from {
                least = near.get(next.saturating_sub(1)).map_or(f64::NAN, |r| r.1);
            }
        }
        path.t_s.push(*t_s);
        path.xy_m.push(*xy_m);
        path.clearance_m.push(least);
    }
    path
}

/// Times and places at which contacts begin: one that lasts has a row per step.
fn beginnings(world: &WorldReader, every_steps: u32) -> Result<Vec<(f64, [f64; 2])>> {
    const COLUMNS: [&str; 9] = ["t", "step", "drone", "geom2", "other_flex", "distance", "swept", "x", "y"];
    let table = world.contacts(Some(&COLUMNS))?;
    let get = |name| table.column(name);
    let (t, x, y, step) = (get("t")?, get("x")?, get("y")?, get("step")?);
    let (drone, geom, flex, distance) = (get("drone")?, get("geom2")?, get("other_flex")?, get("distance")?);
    let swept = get("swept")?;
    let mut last = BTreeMap::new();
    let mut contacts = Vec::new();
    for i in 0..t.len() {
        if distance[i] > 0.0 && swept[i] == 0.0 {
            continue; // within a margin only
        }
        let pair = (drone[i] as i64, geom[i] as i64, flex[i] as i64);
        let before = last.insert(pair, step[i]);
        if before.is_none_or(|b| step[i] - b > 2.0 * f64::from(every_steps.max(1))) {
            contacts.push((t[i], [x[i], y[i]]));
        }
    }
    Ok(contacts)
}
