//! Flight logs for a page: what was measured.

use std::path::Path;

use super::flown::{self, Ghost, Track, World};
use super::{Data, Made, Options, shapes};
use crate::flight::{FlightLog, resample};
use crate::gap;
use crate::page::Array;
use crate::scene::{Scene, SceneSource};
use crate::vehicle::Vehicle;
use crate::{Error, Result};

/// A hole in the measured attitude that is bridged, s.
const MAX_GAP_S: f64 = 0.5;

/// How often the model starts again from the measurement, s; the page lets one choose.
const EVERY_S: [f64; 4] = [0.1, 0.2, 0.5, 1.0];
/// About the number of poses of each.
const GHOST_SAMPLES: usize = 2500;

/// The page of a log.
pub(super) fn page(path: &Path, options: &Options) -> Result<Made> {
    let (log, report) = FlightLog::open(path, None)?;
    let mut data = Data { title: super::title(path), kind: "flight log", colour: "speed", ..Data::default() };
    if log.position_m.is_empty() {
        return Err(Error::Usage {
            flag: "WHAT",
            expected: "a log with measured positions (px, py, pz), which a path is drawn of".into(),
            got: format!("{}, which has none", path.display()),
        });
    }
    data.notes.extend(log.warnings.iter().cloned());
    data.notes.extend(report.findings.iter().map(|f| f.text.clone()));
    if let Some(scene) = &options.scene {
        let scene = Scene::build(&SceneSource::file(scene), &[])?;
        data.obstacles = scene.obstacles().iter().map(|o| o.name.clone()).collect();
        data.scene = Some(shapes::shapes(&scene, &mut data.notes)?);
    }
    let vehicle = options.vehicle.as_deref().map(vehicle).transpose()?;
    data.drones =
        vec![vehicle.as_ref().map_or_else(|| flown::unknown(Vec::new()), |v| flown::drone(v, false))];
    let mut world = world(&log, &mut data.notes);
    if let Some(vehicle) = vehicle {
        let (ghosts, warnings) = ghosts(log, &vehicle)?;
        world.ghosts = ghosts;
        data.notes.extend(warnings);
    }
    data.worlds = vec![world];
    Ok(super::finished(data))
}

/// A vehicle by its name, or from a file.
fn vehicle(name: &str) -> Result<Vehicle> {
    Ok(crate::arena::VehicleSource::Named(name.into()).load()?)
}

fn world(log: &FlightLog, notes: &mut Vec<String>) -> World {
    let t = &log.position_m.t_s;
    let quat: Vec<[f64; 4]> = if log.attitude.is_empty() {
        notes.push("the log has no attitude: the drone is drawn level".into());
        vec![[0.0, 0.0, 0.0, 1.0]; t.len()]
    } else {
        let at = resample::slerp(&log.attitude, t, MAX_GAP_S);
        at.into_iter().map(|q| q.unwrap_or([f64::NAN; 4])).collect()
    };
    let velocity = &log.velocity_m_s;
    let speed: Vec<f64> = if velocity.is_empty() {
        from_positions(t, &log.position_m.values)
    } else {
        let at = resample::linear(velocity, t, MAX_GAP_S);
        at.into_iter().map(|v| v.map_or(f64::NAN, |v| v.iter().map(|c| c * c).sum::<f64>().sqrt())).collect()
    };
    let (track, thinned) = Track::new(t, &log.position_m.values, &quat, &speed);
    if let Some([kept, all]) = thinned {
        notes.push(format!("the path has {kept} of {all} samples"));
    }
    World {
        number: 0,
        from: t.first().copied().unwrap_or(0.0),
        to: t.last().copied().unwrap_or(0.0),
        note: String::new(),
        drones: vec![track],
        clearance: Vec::new(),
        contacts: None,
        frames: None,
        obstacles: Vec::new(),
        ghosts: Vec::new(),
    }
}

/// The model beside the measurement, for each of [`EVERY_S`].
fn ghosts(log: FlightLog, vehicle: &Vehicle) -> Result<(Vec<Ghost>, Vec<String>)> {
    let track = gap::Track::new(log, vehicle, &gap::Options::default())?;
    let sample = (track.duration_s() / GHOST_SAMPLES as f64).max(0.02);
    let mut out = Vec::new();
    for every in EVERY_S {
        let flown = gap::ghost::ghost(&track, vehicle, every, sample)?;
        if flown.starts_s.is_empty() {
            continue;
        }
        let unknown = vec![f64::NAN; flown.t_s.len()];
        let (poses, _) = Track::new(&flown.t_s, &flown.pos_m, &flown.quat_xyzw, &unknown);
        out.push(Ghost { every, track: poses, starts: Array::f32(flown.starts_s.iter().map(|t| *t as f32)) });
    }
    let mut warnings = track.warnings;
    if out.is_empty() {
        warnings.push("the model could start nowhere: no stretch of this log has all that it needs".into());
    }
    Ok((out, warnings))
}

/// Speed by differences over about 0.1 s, m/s.
fn from_positions(t: &[f64], pos: &[[f64; 3]]) -> Vec<f64> {
    let (mut first, mut last) = (0, 0);
    (0..t.len())
        .map(|k| {
            while t[k] - t[first] > 0.05 {
                first += 1;
            }
            while last + 1 < t.len() && t[last] - t[k] < 0.05 {
                last += 1;
            }
            let way: f64 = (0..3).map(|c| (pos[last][c] - pos[first][c]).powi(2)).sum();
            if t[last] > t[first] { way.sqrt() / (t[last] - t[first]) } else { f64::NAN }
        })
        .collect()
}
