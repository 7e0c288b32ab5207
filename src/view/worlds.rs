//! Worlds of a data set for a page, and how much of them fits.

use serde::Serialize;

use super::flown::{self, Clearance, Drone, Marks, Track, World};
use super::{Data, MAX_PAGE_BYTES, Options};
use crate::dataset::recorder::FlightConfig;
use crate::dataset::{Dataset, Frames, Manifest, Table, WorldReader, encode};
use crate::page::Array;
use crate::vehicle::Vehicle;
use crate::{Error, Result};

/// Most contacts of a world that are drawn.
const MAX_CONTACTS: usize = 2000;
/// Most rows of clearance of a drone.
const MAX_CLEARANCES: usize = 3000;
/// Worlds that a page takes where none were named, at most.
const MAX_WORLDS: usize = 8;

/// The camera of all drones.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Camera {
    width: usize,
    height: usize,
    kind: crate::sense::DepthKind,
    far: f64,
    k: [[f64; 3]; 3],
    /// Metres of one unit of the images, and the values that are no distances: a miss, too near, too far.
    unit: f64,
    codes: [u16; 3],
}

/// Images of a world, those that fit.
#[derive(Clone, Debug, Serialize)]
pub(super) struct FrameData {
    t: Array,
    /// (drone,) position and attitude of the camera, camera to world.
    pos: Vec<Vec<Array>>,
    quat: Vec<Vec<Array>>,
    /// (frame, drone): the 16-bit values of the depth images, as [`folded`] writes them; empty where an image was left out.
    depth: Vec<Vec<Array>>,
    /// (frame, drone): number of the geom and 1, 0 for none.
    geom: Vec<Vec<Array>>,
}

/// The camera that all drones of a data set have.
pub(super) fn camera(set: &Dataset) -> Option<Camera> {
    let (camera, png) = (set.manifest().cameras.first()?, &set.manifest().depth_png);
    Some(Camera {
        width: camera.width,
        height: camera.height,
        kind: camera.kind,
        far: camera.far_m,
        k: camera.k,
        unit: png.metres_per_unit,
        codes: [png.miss, png.too_near, png.too_far],
    })
}

/// The drones of a data set: from its own description of the flight, else those that are built in, else some drone.
pub(super) fn drones(set: &Dataset, notes: &mut Vec<String>) -> Vec<Drone> {
    let manifest = set.manifest();
    let described = manifest.config.as_ref().and_then(|c| FlightConfig::from_text(&c.to_string()).ok());
    let shell = manifest.scene.mjb_sha256.is_some();
    let mut unknown = false;
    let of = |(d, record): (usize, &crate::dataset::VehicleRecord)| {
        let listed = described.as_ref().map(|c| &c.sim.drones).filter(|l| !l.is_empty());
        let vehicle = listed.and_then(|l| l[d % l.len()].vehicle.load().ok());
        let vehicle = vehicle.or_else(|| Vehicle::builtin(&record.name).ok());
        match vehicle {
            Some(vehicle) => flown::drone(&vehicle, shell),
            None => {
                unknown = true;
                Drone { name: record.name.clone(), shell, ..flown::unknown(Vec::new()) }
            }
        }
    };
    let drones = manifest.vehicles.iter().enumerate().map(of).collect();
    if unknown {
        notes.push("the vehicle is not stated in this data set: its rotors are drawn at usual places".into());
    }
    drones
}

/// Adds the worlds that were asked for, or the first ones that fit into `room` bytes; thins images where they do not.
pub(super) fn add(set: &Dataset, options: &Options, room: usize, data: &mut Data) -> Result<()> {
    let there = set.worlds();
    let total = set.manifest().n_worlds;
    if there.is_empty() {
        data.notes.push("no world of this data set is finished".into());
    }
    if let Some(missing) = options.worlds.iter().find(|w| !there.contains(w)) {
        return Err(Error::Usage {
            flag: "--world",
            expected: format!("worlds that are there: {}", listed(&there)),
            got: missing.to_string(),
        });
    }
    let asked = !options.worlds.is_empty();
    let wanted: Vec<usize> =
        if asked { options.worlds.clone() } else { there.iter().copied().take(MAX_WORLDS).collect() };
    let mut worlds: Vec<(World, Option<FrameData>)> = Vec::new();
    let mut sizes = Sizes::default();
    // Images of a few worlds more are worth fewer of each, down to two a second.
    let most = if asked { usize::MAX } else { (0.5 * set.manifest().fps).max(1.0) as usize };
    for number in wanted {
        let (world, frames) = world(set, number, &mut data.notes)?;
        let with = sizes.with(weight(&world), frames.as_ref());
        if !asked && !worlds.is_empty() && (with.fixed > room / 2 || with.step(room) > most) {
            break;
        }
        sizes = with;
        worlds.push((world, frames));
    }
    if worlds.len() < there.len() {
        let shown: Vec<usize> = worlds.iter().map(|(w, _)| w.number).collect();
        data.notes.push(format!(
            "of {total} worlds this page has {}: {}; --world N shows another",
            shown.len(),
            listed(&shown)
        ));
    }
    let step = sizes.step(room);
    if step > 1 {
        let what = match step {
            2 => "every second image".to_string(),
            n => format!("one image in {n}"),
        };
        let limit = MAX_PAGE_BYTES as f64 / 1e6;
        data.notes.push(format!("only {what} is on this page, so that it stays within {limit} MB"));
    }
    for (mut world, frames) in worlds {
        world.frames = frames.map(|f| f.thinned(step));
        data.worlds.push(world);
    }
    data.colour = if data.worlds.iter().any(|w| !w.clearance.is_empty()) { "clearance" } else { "speed" };
    Ok(())
}

/// Bytes of what is on a page for certain, and of the images of each frame of each world.
#[derive(Clone, Debug, Default)]
struct Sizes {
    fixed: usize,
    images: Vec<Vec<usize>>,
}

impl Sizes {
    /// Room for notes and for names of fields.
    const RESERVE: usize = 4000;

    fn with(&self, world: usize, frames: Option<&FrameData>) -> Self {
        let mut out = self.clone();
        out.fixed += world;
        if let Some(frames) = frames {
            let (poses, images) = frames.weights();
            out.fixed += poses;
            out.images.push(images);
        }
        out
    }

    /// The least number so that every so-manieth image fits; all but the first of each world go where nothing does.
    fn step(&self, room: usize) -> usize {
        let most = self.images.iter().map(Vec::len).max().unwrap_or(0).max(1);
        let used = |step: usize| -> usize { self.images.iter().flat_map(|w| w.iter().step_by(step)).sum() };
        (1..most).find(|step| self.fixed + used(*step) + Self::RESERVE <= room).unwrap_or(most)
    }
}

/// Bytes that a part of the data takes.
fn weight(part: &impl Serialize) -> usize {
    serde_json::to_string(part).map_or(0, |text| text.len())
}

fn listed(numbers: &[usize]) -> String {
    let all: Vec<String> = numbers.iter().take(20).map(usize::to_string).collect();
    format!("{}{}", all.join(", "), if numbers.len() > 20 { ", …" } else { "" })
}

fn world(set: &Dataset, number: usize, notes: &mut Vec<String>) -> Result<(World, Option<FrameData>)> {
    let (manifest, reader) = (set.manifest(), set.world(number)?);
    let mut drones = Vec::new();
    let mut end = 0.0f64;
    let states =
        reader.states(Some(&["t", "drone", "px", "py", "pz", "qx", "qy", "qz", "qw", "vx", "vy", "vz"]))?;
    for d in 0..manifest.n_drones {
        let rows = rows_of(&states, d)?;
        let t = picked(&states, "t", &rows)?;
        let velocity = triples(&states, ["vx", "vy", "vz"], &rows)?;
        let speed: Vec<f64> = velocity.iter().map(|v| v.iter().map(|c| c * c).sum::<f64>().sqrt()).collect();
        let quat = columns(&states, ["qx", "qy", "qz", "qw"], &rows)?;
        let (track, thinned) = Track::new(&t, &triples(&states, ["px", "py", "pz"], &rows)?, &quat, &speed);
        if let Some([kept, all]) = thinned {
            note(notes, format!("paths have {kept} of {all} samples"));
        }
        end = end.max(t.last().copied().unwrap_or(0.0));
        drones.push(track);
    }
    let clearance =
        if manifest.flight.clearance_every_steps > 0 { near(&reader, manifest)? } else { Vec::new() };
    let frames = if manifest.cameras.is_empty() { None } else { Some(reader.frames()?) };
    let record = reader.record();
    let world = World {
        number,
        from: 0.0,
        to: end,
        note: record.quarantine.as_ref().map_or(String::new(), |q| format!("ended early: {}", q.reason)),
        drones,
        clearance,
        contacts: contacts(&reader, notes)?,
        frames: None,
        obstacles: frames.as_ref().map_or(Vec::new(), |f| obstacles(f, manifest.obstacles.len())),
        ghosts: Vec::new(),
    };
    let images = frames.map(|f| FrameData::new(&f, manifest));
    Ok((world, images))
}

/// Adds a note that is not there yet.
fn note(notes: &mut Vec<String>, text: String) {
    if !notes.contains(&text) {
        notes.push(text);
    }
}

fn rows_of(table: &Table, drone: usize) -> Result<Vec<usize>> {
    let of = table.column("drone")?;
    Ok((0..table.n_rows()).filter(|r| of[*r] == drone as f64).collect())
}

fn picked(table: &Table, name: &str, rows: &[usize]) -> Result<Vec<f64>> {
    let column = table.column(name)?;
    Ok(rows.iter().map(|r| column[*r]).collect())
}

fn columns<const N: usize>(table: &Table, names: [&str; N], rows: &[usize]) -> Result<Vec<[f64; N]>> {
    let all = names.iter().map(|n| table.column(n)).collect::<Result<Vec<_>, _>>()?;
    Ok(rows.iter().map(|r| core::array::from_fn(|c| all[c][*r])).collect())
}

fn triples(table: &Table, names: [&str; 3], rows: &[usize]) -> Result<Vec<[f64; 3]>> {
    columns(table, names, rows)
}

fn near(reader: &WorldReader, manifest: &Manifest) -> Result<Vec<Clearance>> {
    let table = reader.clearance(None)?;
    let mut out = Vec::new();
    for d in 0..manifest.n_drones {
        let all = rows_of(&table, d)?;
        let step = all.len().div_ceil(MAX_CLEARANCES).max(1);
        // The nearest of each group stays, so that no near miss is lost.
        let distance = table.column("distance")?;
        let least = |group: &[usize]| {
            let far = |r: &usize| if distance[*r].is_finite() { distance[*r] } else { f64::INFINITY };
            group.iter().copied().min_by(|a, b| far(a).total_cmp(&far(b)))
        };
        let rows: Vec<usize> = all.chunks(step).filter_map(least).collect();
        out.push(Clearance {
            t: Array::f32(picked(&table, "t", &rows)?.into_iter().map(|t| t as f32)).packed(),
            distance: Array::i16(&picked(&table, "distance", &rows)?).packed(),
            from: super::columns(&triples(&table, ["from_x", "from_y", "from_z"], &rows)?),
            to: super::columns(&triples(&table, ["to_x", "to_y", "to_z"], &rows)?),
            geom: Array::i16(&picked(&table, "geom", &rows)?).packed(),
        });
    }
    Ok(out)
}

fn contacts(reader: &WorldReader, notes: &mut Vec<String>) -> Result<Option<Marks>> {
    let table = reader.contacts(None)?;
    let (all, number) = (table.n_rows(), reader.record().world);
    if all == 0 {
        return Ok(None);
    }
    let rows: Vec<usize> = (0..all).step_by(all.div_ceil(MAX_CONTACTS).max(1)).collect();
    if rows.len() < all {
        notes.push(format!("{} of the {all} rows of contacts of world {number} are drawn", rows.len()));
    }
    let exact = |names: &[&str]| -> Result<Vec<Array>> {
        names.iter().map(|n| Ok(Array::f64(picked(&table, n, &rows)?).packed())).collect()
    };
    let one = |name: &str| -> Result<Array> { Ok(Array::f64(picked(&table, name, &rows)?).packed()) };
    Ok(Some(Marks {
        t: one("t")?,
        drone: one("drone")?,
        pos: exact(&["x", "y", "z"])?,
        normal: exact(&["nx", "ny", "nz"])?,
        geoms: exact(&["geom1", "geom2"])?,
        count: rows.len(),
    }))
}

fn obstacles(frames: &Frames, n: usize) -> Vec<Track> {
    let (Some(pos), Some(quat)) = (&frames.obstacle_pos_m, &frames.obstacle_quat_xyzw) else {
        return Vec::new();
    };
    let t = frames.time_s.to_vec();
    let of = |o: usize| {
        let at: Vec<[f64; 3]> = (0..t.len()).map(|f| core::array::from_fn(|c| pos[[f, o, c]])).collect();
        let turn: Vec<[f64; 4]> = (0..t.len()).map(|f| core::array::from_fn(|c| quat[[f, o, c]])).collect();
        Track::new(&t, &at, &turn, &vec![f64::NAN; t.len()]).0
    };
    (0..n).map(of).collect()
}

/// Values of an image as differences from what their neighbours let one expect (the predictor of LOCO-I: Weinberger, Seroussi, Sapiro
/// 2000, doi 10.1109/83.855427), small ones as small numbers; first all low bytes, then all high ones. It halves what zlib makes of them.
fn folded(values: &[u16], width: usize) -> Vec<u8> {
    let at = |k: Option<usize>| k.map_or(0, |k| values[k]);
    let differences: Vec<u16> = (0..values.len())
        .map(|k| {
            let inner = k % width > 0;
            let (left, up) = (at(inner.then(|| k - 1)), at(k.checked_sub(width)));
            let corner = at(k.checked_sub(width + 1).filter(|_| inner));
            let guess = if corner >= left.max(up) {
                left.min(up)
            } else if corner <= left.min(up) {
                left.max(up)
            } else {
                left + (up - corner.min(up)) - (corner - corner.min(up))
            };
            let difference = values[k].wrapping_sub(guess) as i16;
            ((difference << 1) ^ (difference >> 15)) as u16
        })
        .collect();
    let byte = |k: usize| differences.iter().map(move |d| d.to_le_bytes()[k]);
    byte(0).chain(byte(1)).collect()
}

impl FrameData {
    fn new(frames: &Frames, manifest: &Manifest) -> Self {
        let unit = manifest.depth_png.metres_per_unit;
        let shape = frames.depth_m.dim();
        let (n, drones, height, width) = shape;
        let pose = |d: usize, c: usize, of: &ndarray::Array3<f64>| -> Vec<f64> {
            (0..n).map(|f| of[[f, d, c]]).collect()
        };
        let all = |d: usize, size: usize, of: &ndarray::Array3<f64>| -> Vec<Array> {
            (0..size).map(|c| Array::i16(&pose(d, c, of))).collect()
        };
        let depth = |f: usize, d: usize| {
            let pixels = (0..height).flat_map(|r| (0..width).map(move |c| [f, d, r, c]));
            let value = |at: [usize; 4]| encode(frames.depth_m[at], frames.status[at], unit).unwrap_or(0);
            Array::u8(&folded(&pixels.map(value).collect::<Vec<_>>(), width)).packed()
        };
        let geom = |f: usize, d: usize| {
            let ids = (0..height).flat_map(|r| (0..width).map(move |c| [f, d, r, c]));
            Array::u16(ids.map(|at| u16::try_from(frames.geom_id[at] + 1).unwrap_or(0))).packed()
        };
        let each = |of: &dyn Fn(usize, usize) -> Array| {
            (0..n).map(|f| (0..drones).map(|d| of(f, d)).collect()).collect()
        };
        Self {
            t: Array::f64(frames.time_s.to_vec()),
            pos: (0..drones).map(|d| all(d, 3, &frames.camera_pos_m)).collect(),
            quat: (0..drones).map(|d| all(d, 4, &frames.camera_quat_xyzw)).collect(),
            depth: each(&depth),
            geom: each(&geom),
        }
    }

    /// Bytes of what is kept of every frame, and of each frame's images.
    fn weights(&self) -> (usize, Vec<usize>) {
        let images = |f: usize| weight(&self.depth[f]) + weight(&self.geom[f]);
        (weight(&(&self.t, &self.pos, &self.quat)), (0..self.depth.len()).map(images).collect())
    }

    /// Every `step`-th image; poses of the camera stay, with empty places for the images that are gone.
    fn thinned(mut self, step: usize) -> Self {
        for images in [&mut self.depth, &mut self.geom] {
            for (f, of) in images.iter_mut().enumerate() {
                if f % step != 0 {
                    of.clear();
                }
            }
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As the script of the page does it.
    fn unfolded(halves: &[u8], width: usize) -> Vec<u16> {
        let n = halves.len() / 2;
        let mut out: Vec<u16> = Vec::with_capacity(n);
        for k in 0..n {
            let folded = i32::from(halves[k]) | i32::from(halves[n + k]) << 8;
            let at = |there: bool, back: usize| if there { i32::from(out[k - back]) } else { 0 };
            let (inner, below) = (k % width > 0, k >= width);
            let (left, up, corner) = (at(inner, 1), at(below, width), at(inner && below, width + 1));
            let guess = if corner >= left.max(up) {
                left.min(up)
            } else if corner <= left.min(up) {
                left.max(up)
            } else {
                left + up - corner
            };
            let difference = if folded & 1 == 1 { -((folded + 1) >> 1) } else { folded >> 1 };
            out.push((guess + difference) as u16);
        }
        out
    }

    #[test]
    fn images_come_back_to_the_bit() {
        let mut seed = 7u32;
        let mut random = || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (seed >> 16) as u16
        };
        let noise: Vec<u16> = (0..48 * 5).map(|_| random()).collect();
        assert_eq!(unfolded(&folded(&noise, 48), 48), noise);
        let slope: Vec<u16> = (0..64 * 64).map(|k| 3000 + (k % 64) * 7 + (k / 64) * 3).collect();
        let folded = folded(&slope, 64);
        assert_eq!(unfolded(&folded, 64), slope);
        // All but the first are small.
        assert!(folded[1..4096].iter().all(|b| *b < 16) && folded[4097..].iter().all(|b| *b == 0));
    }

    #[test]
    fn images_are_thinned_until_they_fit() {
        let sizes = Sizes { fixed: 1000, images: vec![vec![100; 50], vec![100; 20]] };
        assert_eq!(sizes.step(1_000_000), 1);
        assert_eq!(sizes.step(Sizes::RESERVE + 1000 + 3500), 2);
        assert_eq!(sizes.step(Sizes::RESERVE + 1000 + 2400), 3);
        assert_eq!(sizes.step(0), 50);
    }
}
