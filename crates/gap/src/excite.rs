//! Plans flights that excite the wanted parameters, and names manoeuvres that separate two candidates.
//!
//! The vehicle's own controller flies the manoeuvres of a library in simulation. Measurements by sensors of an assumed
//! quality are linearised as in the fit, which gives each manoeuvre's Fisher information about every parameter. The
//! information of separate flights adds up, so the shortest plan is searched greedily without further simulation.

mod advice;
mod flown;
mod information;
mod library;
#[cfg(test)]
mod tests;

pub use advice::tell_apart;
pub(crate) use advice::{advice, show};
pub use library::{Knot, Room};

use super::GapError;
use super::model::Model;
use super::replay::Around;
use super::track::{Drive, Track};
use flown::{Flown, Setting};
use information::{Judge, Width};
use library::Manoeuvre;
use nalgebra::DMatrix;
use propwash_flight::FlightLog;
use propwash_physics::controllers::ControlMode;
use propwash_physics::drone::Drone;
use propwash_rollout::trajectory::Spline;
use propwash_vehicle::{DYNAMICS, Vehicle};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::fmt::Write;

/// Sensors of the flight to be logged; a rate of 0 means no such sensor. Rates beyond 500 Hz add nothing.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sensors {
    /// Poses per second.
    pub pose_hz: u32,
    /// Standard deviation of positions, m.
    pub position_m: f64,
    /// Standard deviation of attitudes, rad.
    pub attitude_rad: f64,
    /// Samples of the gyroscope per second.
    pub gyro_hz: u32,
    /// Standard deviation of the gyroscope, rad/s.
    pub gyro_rad_s: f64,
    /// Samples of the accelerometer per second.
    pub accel_hz: u32,
    /// Standard deviation of the accelerometer, m/s².
    pub accel_m_s2: f64,
}

impl Default for Sensors {
    /// Motion capture at 240 Hz with 1 mm and 0.2°, gyroscope at 500 Hz with 0.01 rad/s, accelerometer at 500 Hz with
    /// 0.1 m/s².
    fn default() -> Self {
        Self {
            pose_hz: 240,
            position_m: 1e-3,
            attitude_rad: 0.2f64.to_radians(),
            gyro_hz: 500,
            gyro_rad_s: 0.01,
            accel_hz: 500,
            accel_m_s2: 0.1,
        }
    }
}

/// Process noise (turbulence, flow in the room): standard deviation of a part that changes every 50 ms and of one that
/// changes every 250 ms, each.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Air {
    /// By forces, m/s² per axis.
    pub force_m_s2: f64,
    /// By torques, rad/s² per axis.
    pub torque_rad_s2: f64,
}

impl Default for Air {
    /// A calm room: 0.03 m/s² and 0.2 rad/s².
    fn default() -> Self {
        Self { force_m_s2: 0.03, torque_rad_s2: 0.2 }
    }
}

/// Request for a plan.
#[derive(Clone, Debug, PartialEq)]
pub struct Request {
    /// Ids of the wanted candidates, such as `linear_drag`, `weak_rotor.2`; a kind stands for all its candidates.
    pub want: Vec<String>,
    /// Longest flight, s.
    pub seconds: f64,
    /// Wanted standard deviation, as a share of the slab.
    pub share: f64,
    /// Length, width and height of the flight space, m.
    pub box_m: [f64; 3],
    /// Whether z = 0 is ground that can be flown over.
    pub ground: bool,
    /// Height of a ceiling that can be flown under, m.
    pub ceiling_z_m: Option<f64>,
    /// Sensors.
    pub sensors: Sensors,
    /// How calm the air is.
    pub air: Air,
    /// Drive of the model in the later analysis.
    pub drive: Drive,
    /// Seed of noise and disturbances.
    pub seed: u64,
}

impl Default for Request {
    /// Up to 60 s in 6 × 6 × 3 m over ground, to a tenth of each slab, from rotor commands.
    fn default() -> Self {
        Self {
            want: Vec::new(),
            seconds: 60.0,
            share: 0.1,
            box_m: [6.0, 6.0, 3.0],
            ground: true,
            ceiling_z_m: None,
            sensors: Sensors::default(),
            air: Air::default(),
            drive: Drive::RotorCommands,
            seed: 0,
        }
    }
}

/// Predicted standard deviation of a parameter, in its unit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Sigma {
    /// With all other candidates within the tolerance of a carefully built vehicle.
    pub alone: f64,
    /// With the worst look-alike free up to its plausible size.
    pub with_look_alike: f64,
}

/// A wanted parameter.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct WantedParameter {
    /// Candidate.
    pub id: String,
    /// Name within its effect.
    pub name: String,
    /// SI unit.
    pub unit: String,
    /// Plausible size: prior standard deviation.
    pub slab: f64,
    /// Tolerance of a carefully built vehicle.
    pub spike: f64,
    /// Wanted standard deviation.
    pub target: f64,
    /// Prediction after each manoeuvre of the plan, in order.
    pub after: Vec<Sigma>,
    /// Prediction for the whole flight as simulated, joints included.
    pub whole: Sigma,
    /// The candidate most correlated with it in the whole flight, if it widens the interval by more than 5 %.
    pub look_alike: Option<String>,
    /// Whether the wanted standard deviation is reached, look-alike included.
    pub reached: bool,
    /// Why not.
    pub reason: Option<String>,
}

/// A manoeuvre of a plan.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PlannedManoeuvre {
    /// Name in the library.
    pub name: String,
    /// What is flown.
    pub title: String,
    /// When it begins, s.
    pub start_s: f64,
    /// Its length, s.
    pub duration_s: f64,
    /// Share of full speed and acceleration at which this vehicle can fly it.
    pub intensity: f64,
    /// Greatest speed, m/s.
    pub peak_speed_m_s: f64,
    /// Greatest tilt, rad.
    pub peak_tilt_rad: f64,
    /// Greatest distance from the reference, m.
    pub peak_error_m: f64,
}

/// A planned flight that excites the wanted parameters.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FlightPlan {
    /// Vehicle.
    pub vehicle: String,
    /// Its parameters' hash.
    pub vehicle_sha256: String,
    /// Length, s.
    pub duration_s: f64,
    /// The wanted parameters.
    pub parameters: Vec<WantedParameter>,
    /// The manoeuvres, in order.
    pub manoeuvres: Vec<PlannedManoeuvre>,
    /// Greatest distance from the reference in the whole flight, m.
    pub peak_error_m: f64,
    /// Share of the time in which a rotor is at its limit.
    pub saturated: f64,
    /// Warnings.
    pub warnings: Vec<String>,
    /// Waypoints: time (s), position (m), heading (rad).
    #[serde(skip)]
    pub waypoints: Vec<Knot>,
}

impl FlightPlan {
    /// Whether every parameter reaches its wanted standard deviation.
    pub fn complete(&self) -> bool {
        self.parameters.iter().all(|p| p.reached)
    }

    /// The waypoints as [`csv()`] writes them.
    pub fn csv(&self) -> String {
        csv(&self.waypoints)
    }

    /// The spline through the waypoints.
    ///
    /// # Errors
    /// [`GapError::Numbers`] where the waypoints form no path, which cannot happen for a plan's own.
    pub fn spline(&self) -> Result<Spline, GapError> {
        path(&self.waypoints)
    }
}

/// Waypoints as `t,x,y,z,yaw` (s, m, m, m, rad), which `propwash fly --trajectory waypoints FILE` flies.
pub fn csv(waypoints: &[Knot]) -> String {
    let mut out = String::from("t,x,y,z,yaw\n");
    for (t, [x, y, z], yaw) in waypoints {
        // Writing to a string cannot fail.
        let _ = writeln!(out, "{t:.3},{x:.5},{y:.5},{z:.5},{yaw:.5}");
    }
    out
}

fn path(knots: &[Knot]) -> Result<Spline, GapError> {
    Spline::new(knots).map_err(|e| GapError::Numbers { what: "the planned path", reason: e.to_string() })
}

/// Shares of full speed and acceleration tried in turn, until the vehicle can fly the manoeuvre.
const INTENSITIES: [f64; 5] = [1.0, 0.75, 0.5, 0.35, 0.2];
/// Largest tracking error of a manoeuvre that counts as flown, m.
const TRACKING_M: f64 = 0.4;
/// Largest share of time in rotor saturation of a manoeuvre that counts as flown.
const SATURATED: f64 = 0.02;
/// Gain in the sum of ln(σ/wanted) below which another manoeuvre is not worth flying.
const LEAST_GAIN: f64 = 0.02;
/// Most manoeuvres of a plan.
const MOST: usize = 24;

/// A manoeuvre flown in simulation.
struct Entry {
    manoeuvre: &'static Manoeuvre,
    knots: Vec<Knot>,
    intensity: f64,
    flown: Flown,
}

impl Entry {
    fn seconds(&self) -> f64 {
        self.knots.last().map_or(0.0, |k| k.0)
    }
}

/// Simulates the library, or those of it that are named: the manoeuvres that the vehicle can fly, and the reasons for the others.
fn fly_library(setting: &Setting, names: Option<&[String]>) -> Result<(Vec<Entry>, Vec<String>), GapError> {
    let wanted = |m: &Manoeuvre| names.is_none_or(|names| names.iter().any(|n| n == m.name));
    let mut left: Vec<&'static Manoeuvre> =
        library::ALL.iter().filter(|m| m.fits(setting.room) && wanted(m)).collect();
    let (mut entries, mut failed) = (Vec::new(), Vec::new());
    for (round, intensity) in INTENSITIES.into_iter().enumerate() {
        if left.is_empty() {
            break;
        }
        let knots: Vec<Vec<Knot>> = left.iter().map(|m| m.knots(setting.room, intensity)).collect();
        let paths = knots.iter().map(|k| path(k)).collect::<Result<Vec<_>, _>>()?;
        let flights = flown::fly(setting, &paths)?;
        let mut again = Vec::new();
        for ((manoeuvre, knots), flown) in left.iter().zip(knots).zip(flights) {
            let fault = if flown.lost {
                Some("the vehicle turns over or meets the ground".to_string())
            } else if flown.outside_m > 0.0 {
                Some(format!("it leaves the box by {:.2} m", flown.outside_m))
            } else if flown.peak_error_m > TRACKING_M {
                Some(format!("it is {:.2} m off its path", flown.peak_error_m))
            } else if flown.saturated > SATURATED {
                Some(format!("rotors are at their limit for {:.0} % of the time", 100.0 * flown.saturated))
            } else {
                None
            };
            match fault {
                None => entries.push(Entry { manoeuvre, knots, intensity, flown }),
                Some(_) if round + 1 < INTENSITIES.len() => again.push(*manoeuvre),
                Some(why) => failed.push(format!("{} is left out: even flown gently, {why}", manoeuvre.name)),
            }
        }
        left = again;
    }
    entries.sort_by_key(|e| library::ALL.iter().position(|m| m.name == e.manoeuvre.name));
    Ok((entries, failed))
}

/// Dynamics of a drive, and the vehicle's parameters for them.
fn drone_of(vehicle: &Vehicle, drive: Drive) -> Result<Drone<f64>, GapError> {
    let wrong = |expected: &str, found: String, remedy: &str| GapError::Log {
        log: vehicle.name.clone(),
        expected: expected.into(),
        found,
        remedy: remedy.into(),
    };
    let dynamics = match drive {
        Drive::AttitudeCommands => {
            DYNAMICS[1..].iter().rev().find(|d| vehicle.drone(d).is_ok()).copied().ok_or_else(|| {
                wrong(
                    "an attitude response in the vehicle file",
                    "none".into(),
                    "plan for another drive, or identify the response (propwash identify)",
                )
            })?
        }
        _ => DYNAMICS[0],
    };
    let bad = |e: propwash_vehicle::VehicleError| {
        wrong("parameters for the dynamics", e.to_string(), "correct the vehicle file")
    };
    let modes = vehicle.modes(dynamics).map_err(bad)?;
    if !modes.contains(&ControlMode::State) {
        return Err(wrong(
            "a controller that follows a path ([controller.mellinger])",
            "none".into(),
            "add one to the vehicle file; without it no manoeuvre can be flown in simulation",
        ));
    }
    vehicle.drone(dynamics).map_err(bad)
}

/// The flight space of a request, for a vehicle.
fn room_of(request: &Request, drone: &Drone<f64>) -> Room {
    Room {
        size_m: request.box_m,
        ground: request.ground,
        ceiling_z_m: request.ceiling_z_m,
        // At two rotor radii the ground effect is large and the legs of most vehicles clear the ground.
        close_m: 0.06 + 2.0 * drone.disc_radius_m(),
    }
}

fn check(request: &Request) -> Result<(), GapError> {
    let wrong = |expected: &str, found: String, remedy: &str| {
        Err(GapError::Log { log: "the plan".into(), expected: expected.into(), found, remedy: remedy.into() })
    };
    if request.want.is_empty() {
        return wrong("at least one wanted effect", "none".into(), "name one, as linear_drag");
    }
    if request.box_m.iter().any(|s| !(1.0..=1000.0).contains(s)) {
        return wrong(
            "a box of 1 m to 1000 m each way",
            format!("{:?} m", request.box_m),
            "give length, width and height of the space",
        );
    }
    if !(request.seconds >= 4.0 && request.seconds <= 1800.0) {
        return wrong("4 s to 1800 s of flight", format!("{} s", request.seconds), "give another length");
    }
    if !(request.share > 0.0 && request.share < 1.0) {
        return wrong("a share of the slab between 0 and 1", request.share.to_string(), "give one, as 0.1");
    }
    if let Some(z) = request.ceiling_z_m.filter(|z| !(*z > 0.0 && *z <= request.box_m[2])) {
        return wrong(
            &format!("a ceiling in the box, above 0 and up to {} m", request.box_m[2]),
            format!("{z} m"),
            "give its height, or a higher box",
        );
    }
    let s = &request.sensors;
    let sizes = [s.position_m, s.attitude_rad, s.gyro_rad_s, s.accel_m_s2];
    let air = [request.air.force_m_s2, request.air.torque_rad_s2];
    if sizes.iter().chain(&air).any(|v| !(*v > 0.0 && v.is_finite())) || s.pose_hz < 20 {
        return wrong(
            "poses at 20 Hz or more, and noise and disturbances above 0",
            format!("poses at {} Hz, noise {sizes:?}, disturbances {air:?}", s.pose_hz),
            "give what the sensors' data sheets say",
        );
    }
    Ok(())
}

/// Indices of wanted candidates; a kind stands for all its candidates.
fn indices(model: &Model, ids: &[String]) -> Result<Vec<usize>, GapError> {
    let mut out = Vec::new();
    for id in ids {
        let before = out.len();
        let exact = model.candidates.iter().position(|c| c.id == *id);
        match exact {
            Some(index) => out.push(index),
            None => out.extend((0..model.candidates.len()).filter(|c| model.candidates[*c].kind == *id)),
        }
        if out.len() == before {
            if let Some((_, reason)) = model.not_tried.iter().find(|(of, _)| of == id) {
                return Err(GapError::Log {
                    log: "the plan".into(),
                    expected: format!("what {id} needs"),
                    found: reason.clone(),
                    remedy: "a simulated flight of one vehicle in the box has it not: change the box, the sensors or \
                             the drive, or want another effect"
                        .into(),
                });
            }
            let known: Vec<&str> = model.candidates.iter().map(|c| c.id.as_str()).collect();
            return Err(GapError::Unknown { name: id.clone(), what: "candidate", known: known.join(", ") });
        }
    }
    out.sort_unstable();
    out.dedup();
    Ok(out)
}

/// A model with all candidates, for planned flights.
fn model_of(drone: &Drone<f64>, tracks: &[&Track]) -> Result<Model, GapError> {
    let arounds: Vec<Around> = tracks.par_iter().map(|t| Around::new(t, drone)).collect();
    Model::new(drone, tracks, &arounds.iter().collect::<Vec<_>>())
}

/// Plans a flight for a vehicle.
///
/// # Errors
/// [`GapError`] where the request is invalid, a wanted effect is unknown or not observable in such a flight, or the vehicle
/// has no controller that follows a path.
pub fn plan(vehicle: &Vehicle, request: &Request) -> Result<FlightPlan, GapError> {
    check(request)?;
    let drone = drone_of(vehicle, request.drive)?;
    let room = room_of(request, &drone);
    let setting = setting(vehicle, &drone, &room, request);
    let (entries, mut warnings) = fly_library(&setting, None)?;
    if entries.is_empty() {
        return Err(GapError::Log {
            log: vehicle.name.clone(),
            expected: "a manoeuvre that it can fly in the box".into(),
            found: warnings.join("; "),
            remedy: "give a larger box, or check the controller of the vehicle file".into(),
        });
    }
    let tracks = entries
        .par_iter()
        .map(|e| flown::track(&e.flown, vehicle, &room, &request.sensors, request.drive))
        .collect::<Result<Vec<_>, _>>()?;
    let all: Vec<&Track> = tracks.iter().collect();
    let model = model_of(&drone, &all)?;
    let wanted = indices(&model, &request.want)?;
    let told = information::of_tracks(&all, &model, &request.air);
    let judge = Judge::new(&model, &wanted);
    let search = Search::new(&judge, &entries, &told, request)?;
    let order = search.greedy()?;

    // The whole flight in one simulation, since joints and noise differ from the sum of manoeuvres.
    let (knots, manoeuvres) = join(&entries, &order);
    let whole = path(&knots)?;
    let flight = flown::fly(&setting, std::slice::from_ref(&whole))?.remove(0);
    if flight.lost {
        return Err(GapError::Numbers {
            what: "the plan",
            reason: "the vehicle can fly its manoeuvres one by one but is lost in the whole flight; give a larger box"
                .into(),
        });
    }
    if flight.outside_m > 0.0 {
        warnings.push(format!("the vehicle leaves the box by {:.2} m", flight.outside_m));
    }
    if flight.peak_error_m > TRACKING_M {
        warnings.push(format!("the vehicle is up to {:.2} m off its path", flight.peak_error_m));
    }
    if flight.saturated > SATURATED {
        warnings.push(format!("rotors are at their limit for {:.0} % of the time", 100.0 * flight.saturated));
    }
    for m in manoeuvres.iter().filter(|m| m.intensity < 1.0) {
        let text = format!(
            "{} is flown at {:.0} % of full speed and acceleration, which is what the vehicle follows in this box",
            m.name,
            100.0 * m.intensity
        );
        if !warnings.contains(&text) {
            warnings.push(text);
        }
    }
    let track = flown::track(&flight, vehicle, &room, &request.sensors, request.drive)?;
    let told_whole = information::of_tracks(&[&track], &model, &request.air).remove(0);
    // Predictions per manoeuvre add separate flights; the last one is of the flight as a whole.
    let after = search.after(&order)?;
    Ok(FlightPlan {
        vehicle: vehicle.name.clone(),
        vehicle_sha256: vehicle.sha256(),
        duration_s: whole.end_s(),
        parameters: search.parameters(&after, &judge.widths(&told_whole)?),
        manoeuvres,
        peak_error_m: flight.peak_error_m,
        saturated: flight.saturated,
        warnings,
        waypoints: knots,
    })
}

/// A flight of the library's manoeuvres `names`, in order, in the space and with the sensors of `request` (whose `want` and
/// `seconds` are ignored).
///
/// # Errors
/// [`GapError`] where a name is unknown, the space lacks what a manoeuvre needs, or the vehicle cannot fly one.
pub fn flight(vehicle: &Vehicle, request: &Request, names: &[String]) -> Result<Vec<Knot>, GapError> {
    let nothing = vec!["any".to_string()];
    check(&Request { want: nothing, ..request.clone() })?;
    let known = || library::ALL.iter().map(|m| m.name).collect::<Vec<_>>().join(", ");
    let unknown = |name: &str| GapError::Unknown { name: name.into(), what: "manoeuvre", known: known() };
    if names.is_empty() {
        return Err(unknown(""));
    }
    for name in names {
        library::ALL.iter().find(|m| m.name == *name).ok_or_else(|| unknown(name))?;
    }
    let drone = drone_of(vehicle, request.drive)?;
    let room = room_of(request, &drone);
    let setting = setting(vehicle, &drone, &room, request);
    let (entries, failed) = fly_library(&setting, Some(names))?;
    let order: Vec<usize> = names
        .iter()
        .map(|name| {
            entries.iter().position(|e| e.manoeuvre.name == name).ok_or_else(|| GapError::Log {
                log: vehicle.name.clone(),
                expected: format!("a vehicle and a space in which {name} can be flown"),
                found: failed
                    .iter()
                    .find(|f| f.starts_with(name))
                    .cloned()
                    .unwrap_or_else(|| "the space has no ground or ceiling for it".into()),
                remedy: "give a larger box, its ceiling's height, or another manoeuvre".into(),
            })
        })
        .collect::<Result<_, _>>()?;
    Ok(join(&entries, &order).0)
}

/// A practice log: `truth` flies the manoeuvres `names`, which are planned for `vehicle`, by its own controller, and the sensors of the request
/// log it, a load on a cable as the object `load`. Where the two vehicles differ, the log shows what `vehicle` lacks.
///
/// # Errors
/// Those of [`flight`]; [`GapError::Log`] where `truth` cannot fly what `vehicle` can.
pub fn rehearse(
    vehicle: &Vehicle,
    truth: &Vehicle,
    request: &Request,
    names: &[String],
) -> Result<FlightLog, GapError> {
    let knots = flight(vehicle, request, names)?;
    let drone = drone_of(truth, request.drive)?;
    let room = room_of(request, &drone);
    let setting = Setting { tracks_load: true, ..setting(truth, &drone, &room, request) };
    let flown = flown::fly(&setting, &[path(&knots)?])?.remove(0);
    if flown.lost {
        return Err(GapError::Log {
            log: truth.name.clone(),
            expected: format!("a vehicle that flies {} as {} does", names.join(", "), vehicle.name),
            found: "it turns over or meets the ground".into(),
            remedy: "hide a smaller effect, or fly gentler manoeuvres".into(),
        });
    }
    Ok(flown.log)
}

/// Simulation settings of a request.
fn setting<'a>(
    vehicle: &'a Vehicle,
    drone: &'a Drone<f64>,
    room: &'a Room,
    request: &'a Request,
) -> Setting<'a> {
    Setting {
        vehicle,
        drone,
        room,
        sensors: &request.sensors,
        air: &request.air,
        seed: request.seed,
        tracks_load: false,
    }
}

/// Manoeuvres one after the other.
fn join(entries: &[Entry], order: &[usize]) -> (Vec<Knot>, Vec<PlannedManoeuvre>) {
    let mut knots: Vec<Knot> = Vec::new();
    let mut manoeuvres = Vec::new();
    for i in order {
        let entry = &entries[*i];
        let start_s = knots.last().map_or(0.0, |k| k.0);
        // The first knot repeats the last of the previous manoeuvre.
        knots.extend(
            entry
                .knots
                .iter()
                .skip(usize::from(!knots.is_empty()))
                .map(|(t, p, yaw)| (start_s + t, *p, *yaw)),
        );
        manoeuvres.push(PlannedManoeuvre {
            name: entry.manoeuvre.name.into(),
            title: entry.manoeuvre.title.into(),
            start_s,
            duration_s: entry.seconds(),
            intensity: entry.intensity,
            peak_speed_m_s: entry.flown.peak_speed_m_s,
            peak_tilt_rad: entry.flown.peak_tilt_rad,
            peak_error_m: entry.flown.peak_error_m,
        });
    }
    (knots, manoeuvres)
}

/// The search for a short sequence.
struct Search<'a> {
    judge: &'a Judge<'a>,
    model: &'a Model,
    entries: &'a [Entry],
    told: &'a [DMatrix<f64>],
    request: &'a Request,
    /// Per wanted parameter: the achievable aim.
    aims: Vec<Aim>,
}

/// What is achievable for a parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Aim {
    /// Reaches the target even with the worst look-alike free.
    Opened,
    /// Reaches the target only with look-alikes within their tolerance.
    Closed,
    /// Does not reach the target in the time; as good as possible.
    Best,
    /// Not observable: no measurement depends on it.
    Silent,
}

impl<'a> Search<'a> {
    fn new(
        judge: &'a Judge<'a>,
        entries: &'a [Entry],
        told: &'a [DMatrix<f64>],
        request: &'a Request,
    ) -> Result<Self, GapError> {
        // Best achievable in the time: the whole library as often as it fits, at least once.
        let seconds: f64 = entries.iter().map(Entry::seconds).sum();
        let mut most = told.iter().fold(told[0].clone() * 0.0, |sum, a| sum + a);
        most *= (request.seconds / seconds).max(1.0);
        let aims = judge
            .widths(&most)?
            .iter()
            .zip(&judge.parameters)
            .map(|(w, k)| match w {
                _ if most[(*k, *k)] < 1e-2 => Aim::Silent,
                w if w.opened <= request.share => Aim::Opened,
                w if w.closed <= request.share => Aim::Closed,
                _ => Aim::Best,
            })
            .collect();
        let model = judge.model();
        Ok(Self { judge, model, entries, told, request, aims })
    }

    /// Sum over parameters of ln(σ/wanted), where above 0.
    fn missing(&self, widths: &[Width]) -> f64 {
        let of = |(w, aim): (&Width, &Aim)| {
            let sigma = match aim {
                Aim::Opened => w.opened,
                Aim::Closed | Aim::Best => w.closed,
                Aim::Silent => return 0.0,
            };
            (sigma / self.request.share).ln().max(0.0)
        };
        widths.iter().zip(&self.aims).map(of).sum()
    }

    /// Adds the manoeuvre with the largest gain per second until none is worth it, then drops those that became redundant.
    fn greedy(&self) -> Result<Vec<usize>, GapError> {
        let nothing = self.told[0].clone() * 0.0;
        let mut sum = nothing.clone();
        let mut order: Vec<usize> = Vec::new();
        let mut left_s = self.request.seconds;
        let mut now = self.missing(&self.judge.widths(&sum)?);
        while now > 0.0 && order.len() < MOST {
            let tries: Vec<(usize, f64)> = (0..self.entries.len())
                .into_par_iter()
                .filter(|i| self.entries[*i].seconds() <= left_s)
                .map(|i| Ok((i, now - self.missing(&self.judge.widths(&(&sum + &self.told[i]))?))))
                .collect::<Result<_, GapError>>()?;
            let per_second = |t: &(usize, f64)| t.1 / self.entries[t.0].seconds();
            let best = tries.iter().max_by(|a, b| per_second(a).total_cmp(&per_second(b)));
            let Some((i, gain)) = best.copied().filter(|(_, gain)| *gain > LEAST_GAIN) else { break };
            order.push(i);
            sum += &self.told[i];
            left_s -= self.entries[i].seconds();
            now -= gain;
        }
        // Early choices may have become redundant.
        let mut place = 0;
        while place < order.len() && order.len() > 1 {
            let mut without = order.clone();
            without.remove(place);
            let rest = without.iter().fold(nothing.clone(), |sum, i| sum + &self.told[*i]);
            if self.missing(&self.judge.widths(&rest)?) <= now + 1e-9 {
                order = without;
            } else {
                place += 1;
            }
        }
        if order.is_empty() {
            // Nothing to gain, but a plan must have a flight: take the shortest manoeuvre.
            let shortest = (0..self.entries.len())
                .min_by(|a, b| self.entries[*a].seconds().total_cmp(&self.entries[*b].seconds()));
            order.extend(shortest);
        }
        Ok(order)
    }

    /// Widths after each manoeuvre.
    fn after(&self, order: &[usize]) -> Result<Vec<Vec<Width>>, GapError> {
        let mut sum = self.told[0].clone() * 0.0;
        order
            .iter()
            .map(|i| {
                sum += &self.told[*i];
                self.judge.widths(&sum)
            })
            .collect()
    }

    fn parameters(&self, after: &[Vec<Width>], whole: &[Width]) -> Vec<WantedParameter> {
        let share = self.request.share;
        let one = |(i, k): (usize, &usize)| {
            let p = &self.model.parameters[*k];
            let sigma = |w: &Width| Sigma { alone: w.closed * p.slab, with_look_alike: w.opened * p.slab };
            let w = &whole[i];
            // Joints make the whole flight differ a little from the sum of its manoeuvres.
            let reached = w.opened <= 1.05 * share;
            let alike = w.look_alike.map(|c| self.model.candidates[c].id.clone());
            let reason = (!reached).then(|| match (self.aims[i], &alike) {
                (Aim::Silent, _) => "no measurement answers to it while the effect has its filed value".to_string(),
                (Aim::Closed, Some(alike)) => {
                    format!("{alike} looks like it in every manoeuvre of the library; it is known only as far as {alike} is")
                }
                (Aim::Best, _) => format!(
                    "the whole library in {} s does not suffice with these sensors",
                    self.request.seconds
                ),
                _ => "the flight is too short for it".to_string(),
            });
            WantedParameter {
                id: self.model.candidates[p.candidate].id.clone(),
                name: p.name.clone(),
                unit: p.unit.into(),
                slab: p.slab,
                spike: p.spike,
                target: share * p.slab,
                after: after.iter().map(|widths| sigma(&widths[i])).collect(),
                whole: sigma(w),
                look_alike: alike,
                reached,
                reason,
            }
        };
        self.judge.parameters.iter().enumerate().map(one).collect()
    }
}
