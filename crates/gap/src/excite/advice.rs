//! Which manoeuvre separates two candidates.

use super::flown::{self, Setting};
use super::{Air, Request, Sensors, check, drone_of, fly_library, indices, information, model_of, room_of};
use crate::model::Model;
use crate::{Drive, GapError, Track};
use nalgebra::{Cholesky, DMatrix};
use propwash_flight::clean;
use propwash_vehicle::Vehicle;
use rayon::prelude::*;
use std::sync::{Arc, Mutex};

impl Sensors {
    /// The sensors of a flight: rates and noise from its log.
    pub fn of(track: &Track) -> Self {
        fn hz<const N: usize>(channel: &propwash_flight::Channel<N>) -> u32 {
            channel.period_s().map_or(0, |s| (1.0 / s).round().min(500.0) as u32)
        }
        Self {
            pose_hz: hz(&track.position).max(20),
            position_m: track.noise.position_m,
            attitude_rad: track.noise.attitude_rad,
            gyro_hz: hz(&track.gyro),
            gyro_rad_s: track.noise.gyro_rad_s,
            accel_hz: hz(&track.accel),
            accel_m_s2: track.noise.accel_m_s2,
        }
    }
}

/// Manoeuvres of one vehicle, flown and ready for the fit.
pub(super) struct Ready {
    name: &'static str,
    title: &'static str,
    seconds: f64,
    pub track: Track,
}

/// Number of vehicles whose library is cached.
const KEPT: usize = 4;
/// Cache of libraries simulated in this process, by vehicle, drive and sensors, the latest last.
static FLOWN: Mutex<Vec<(String, Arc<Vec<Ready>>)>> = Mutex::new(Vec::new());

/// The library simulated with a vehicle in the default room.
pub(super) fn ready(vehicle: &Vehicle, drive: Drive, sensors: &Sensors) -> Option<Arc<Vec<Ready>>> {
    let key = format!("{} {drive:?} {sensors:?}", vehicle.sha256());
    let lookup =
        |list: &[(String, Arc<Vec<Ready>>)]| list.iter().find(|(k, _)| *k == key).map(|(_, r)| r.clone());
    if let Some(found) = FLOWN.lock().ok().and_then(|list| lookup(&list)) {
        return Some(found);
    }
    let request = Request { drive, sensors: *sensors, ..Request::default() };
    let drone = drone_of(vehicle, drive).ok()?;
    let room = room_of(&request, &drone);
    let setting = Setting {
        vehicle,
        drone: &drone,
        room: &room,
        sensors: &request.sensors,
        air: &request.air,
        seed: request.seed,
        tracks_load: false,
    };
    let (entries, _) = fly_library(&setting, None).ok()?;
    let flights: Vec<Ready> = entries
        .par_iter()
        .filter_map(|e| {
            let track = flown::track(&e.flown, vehicle, &room, &request.sensors, drive).ok()?;
            Some(Ready { name: e.manoeuvre.name, title: e.manoeuvre.title, seconds: e.seconds(), track })
        })
        .collect();
    let out = Arc::new(flights);
    if let Ok(mut list) = FLOWN.lock() {
        list.push((key, out.clone()));
        let extra = list.len().saturating_sub(KEPT);
        list.drain(..extra);
    }
    Some(out)
}

/// Manoeuvres contained in ordinary flights.
pub(super) const ORDINARY: [&str; 2] = ["hover", "slow eight"];
/// Additional evidence for which a manoeuvre is named, nats.
const WORTH_NATS: f64 = 3.0;

/// Manoeuvres that make hidden effects observable.
pub(crate) struct Showing {
    /// Names, most wanted first.
    pub manoeuvres: Vec<String>,
    /// Their total length, s.
    pub seconds: f64,
    /// Distance of each effect from being visible after them.
    pub far: Vec<f64>,
}

/// Most manoeuvres named at once.
const AT_ONCE: usize = 4;
/// Least reduction of the summed distances for which a manoeuvre is named.
const NEARER: f64 = 0.3;

/// Manoeuvres that make effects visible in addition to flights with information `told` (in slabs). `far` returns each
/// effect's distance from being visible for given information, 0 if visible. With `hardest`, the manoeuvre that demands
/// most of the rotors comes first. `None` where the vehicle cannot fly the library.
pub(crate) fn show(
    vehicle: &Vehicle,
    drive: Drive,
    sensors: &Sensors,
    model: &Model,
    told: &DMatrix<f64>,
    far: &(dyn Fn(&DMatrix<f64>) -> Vec<f64> + Sync),
    hardest: bool,
) -> Option<Showing> {
    let flights = ready(vehicle, drive, sensors)?;
    let tracks: Vec<&Track> = flights.iter().map(|f| &f.track).collect();
    let each = information::of_tracks(&tracks, model, &Air::default());
    let mut out = Showing { manoeuvres: Vec::new(), seconds: 0.0, far: far(told) };
    let mut sum = told.clone();
    // Not the maximum: a single sample while catching the vehicle is no sustained demand.
    let most = |f: &Ready| {
        let rotors = &f.track.inputs.rotors;
        let speeds: Vec<f64> = rotors.iter().flat_map(|c| c.values.iter().map(|v| v[0])).collect();
        clean::quantile(&speeds, 0.98).unwrap_or(0.0)
    };
    let first = (0..flights.len()).max_by(|a, b| most(&flights[*a]).total_cmp(&most(&flights[*b])));
    if let Some(i) = first.filter(|_| hardest) {
        sum += &each[i];
        out.manoeuvres.push(flights[i].name.into());
        out.seconds += flights[i].seconds;
        out.far = far(&sum);
    }
    while out.manoeuvres.len() < AT_ONCE {
        let now: f64 = out.far.iter().sum();
        let tries: Vec<(usize, Vec<f64>, f64)> = (0..flights.len())
            .into_par_iter()
            .filter(|i| !out.manoeuvres.iter().any(|m| m == flights[*i].name))
            .map(|i| {
                let after = far(&(&sum + &each[i]));
                let gain = now - after.iter().sum::<f64>();
                (i, after, gain)
            })
            .filter(|(_, _, gain)| *gain > NEARER)
            .collect();
        let worth = |t: &(usize, Vec<f64>, f64)| t.2 / flights[t.0].seconds.sqrt();
        let Some((i, after, _)) = tries.into_iter().max_by(|a, b| worth(a).total_cmp(&worth(b))) else {
            break;
        };
        sum += &each[i];
        out.manoeuvres.push(flights[i].name.into());
        out.seconds += flights[i].seconds;
        out.far = after;
    }
    Some(out)
}

/// Manoeuvres that best separate the candidates `wanted` from `alike`, at most three, best first: (name, text). `None`
/// where the vehicle has no controller that could fly them, or an id is not in the model; empty where no manoeuvre of the
/// library separates them.
///
/// Considered is the direction of the wanted parameters, one slab long, that the look-alikes imitate best in ordinary
/// flight; the score of a manoeuvre is its evidence per second for that direction that the look-alikes cannot absorb.
pub(crate) fn advice(
    vehicle: &Vehicle,
    drive: Drive,
    sensors: &Sensors,
    model: &Model,
    wanted: &[String],
    alike: &[String],
) -> Option<Vec<(String, String)>> {
    // Only the confusion between these candidates counts, not that with others.
    let only = model.only(&|id| wanted.iter().chain(alike).any(|w| w == id));
    let of = |ids: &[String]| -> Option<Vec<usize>> {
        let mut out = Vec::new();
        for id in ids {
            let c = only.candidates.iter().position(|c| c.id == *id)?;
            out.extend(only.of(c));
        }
        Some(out)
    };
    let w = of(wanted)?;
    let l: Vec<usize> = of(alike)?.into_iter().filter(|k| !w.contains(k)).collect();
    if w.is_empty() || l.is_empty() {
        return None;
    }
    let flights = ready(vehicle, drive, sensors)?;
    let tracks: Vec<&Track> = flights.iter().map(|f| &f.track).collect();
    let told = information::of_tracks(&tracks, &only, &Air::default());
    let mut ordinary = DMatrix::zeros(only.parameters.len(), only.parameters.len());
    for (flight, a) in flights.iter().zip(&told) {
        if ORDINARY.contains(&flight.name) {
            ordinary += a;
        }
    }
    let open = vec![1.0; l.len()];
    let closed: Vec<f64> =
        l.iter().map(|k| (only.parameters[*k].slab / only.parameters[*k].spike).powi(2)).collect();
    // The direction that loses most information in ordinary flight when the look-alikes are freed.
    let v = confused(
        &information::apart(&ordinary, &w, &l, &closed)?,
        &information::apart(&ordinary, &w, &l, &open)?,
    )?;
    let nats = |a: &DMatrix<f64>| -> Option<f64> {
        Some(0.5 * (v.transpose() * information::apart(a, &w, &l, &open)? * &v)[(0, 0)])
    };
    let before = nats(&ordinary)?;
    let mut out: Vec<(f64, String, String)> = Vec::new();
    for (flight, a) in flights.iter().zip(&told) {
        let gain = nats(&(&ordinary + a))? - before;
        if gain > WORTH_NATS && !ORDINARY.contains(&flight.name) {
            let text = format!(
                "{} ({}, {:.0} s) tells {} from {} by {:.0} nats more than hover and a slow figure of eight, which \
                 bring {before:.0}",
                flight.name,
                flight.title,
                flight.seconds,
                wanted.join(" + "),
                alike.join(" + "),
                gain,
            );
            out.push((gain / flight.seconds, flight.name.into(), text));
        }
    }
    out.sort_by(|a, b| b.0.total_cmp(&a.0));
    Some(out.into_iter().take(3).map(|(_, name, text)| (name, text)).collect())
}

/// The direction (one slab long) whose information shrinks most, relatively, from `alone` to `beside`.
fn confused(alone: &DMatrix<f64>, beside: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let n = alone.nrows();
    let unit = DMatrix::identity(n, n);
    let factor = Cholesky::new(alone + &unit)?;
    let inverse = factor.l().try_inverse()?;
    let ratio = &inverse * (beside + &unit) * inverse.transpose();
    let eigen = (0.5 * (&ratio + ratio.transpose())).symmetric_eigen();
    let least = (0..n).min_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]))?;
    let v = inverse.transpose() * eigen.eigenvectors.column(least);
    let length = v.norm();
    (length > 0.0).then(|| DMatrix::from_column_slice(n, 1, (v / length).as_slice()))
}

/// `advice` for a vehicle without a diagnosis: manoeuvres that best separate the candidates `wanted` from `alike`, as
/// (name, text), best first; empty where none of the library does.
///
/// # Errors
/// [`GapError`] where an id is unknown or not observable in such flights, or the vehicle has no controller that follows a
/// path.
pub fn tell_apart(
    vehicle: &Vehicle,
    drive: Drive,
    sensors: &Sensors,
    wanted: &[String],
    alike: &[String],
) -> Result<Vec<(String, String)>, GapError> {
    check(&Request { want: wanted.to_vec(), sensors: *sensors, ..Request::default() })?;
    let drone = drone_of(vehicle, drive)?;
    let nothing = || GapError::Numbers {
        what: "the advice",
        reason: "no manoeuvre of the library could be flown in simulation, or both lists are the same".into(),
    };
    let flights = ready(vehicle, drive, sensors).filter(|f| !f.is_empty()).ok_or_else(nothing)?;
    let model = model_of(&drone, &flights.iter().map(|f| &f.track).collect::<Vec<_>>())?;
    let ids = |list: &[String]| -> Result<Vec<String>, GapError> {
        Ok(indices(&model, list)?.into_iter().map(|c| model.candidates[c].id.clone()).collect())
    };
    advice(vehicle, drive, sensors, &model, &ids(wanted)?, &ids(alike)?).ok_or_else(nothing)
}
