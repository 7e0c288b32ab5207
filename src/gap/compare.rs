//! Compare: where and how far a model departs from measured flights.
//!
//! Three ways: what force and torque it lacks at every instant, how far short roll-outs from measured states end from the
//! measurement, and, where a log has references, how a whole flight with our own controller compares.

use super::GapError;
use super::causes::{self, BLOCK_S, Block, Label, short};
use super::constants;
use super::first_look::within_tolerance;
use super::integration;
use super::judge::settling_s;
use super::replay::{self, Around, Raw, STEP, STEP_S};
use super::residual::{self, Replay, Residuals};
use super::track::{Drive, Measured, Track};
use super::verdict::{HorizonError, LogSummary};
use super::wiring;
use crate::flight::STANDARD_GRAVITY_M_S2 as G;
use crate::flight::{clean, resample};
use crate::math::{quat, vec3};
use crate::physics::controllers::ControlMode;
use crate::physics::drone::Drone;
use crate::physics::integrate::Integrator;
use crate::physics::rigid_body::State;
use crate::rollout::trajectory::Reference;
use crate::rollout::{Sim, SimOptions};
use crate::vehicle::Vehicle;
use rayon::prelude::*;
use serde::Serialize;

pub use super::causes::{Cause, Response, SIGNIFICANT};

/// Lengths of the roll-outs, s.
pub const HORIZONS_S: [f64; 4] = [0.1, 0.2, 0.5, 1.0];
/// A model agrees with a log when nothing is off by more than this many times what the sensors' noise makes.
pub const AGREE: f64 = 2.0;
/// Worst segments that are named, and their length, s.
const WORST: usize = 5;
const SEGMENT_S: f64 = 1.0;
/// Distance of the points of a series, s.
const SERIES_S: f64 = 0.05;
/// Fewest roll-outs that a verdict rests on.
const FEWEST: usize = 5;

/// Force and torque that the model lacks, over time; means over 0.05 s.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Series {
    /// Times, s.
    pub t_s: Vec<f64>,
    /// Force, N, body, shape (sample, 3).
    pub force_body_n: Vec<[f64; 3]>,
    /// Force, N, world, shape (sample, 3).
    pub force_world_n: Vec<[f64; 3]>,
    /// Standard deviation of a force, N, body axes, by the sensors' noise.
    pub force_sigma_n: [f64; 3],
    /// Torque, N·m, body, shape (sample, 3); null where it is not known, empty where the drive says nothing of torques.
    pub torque_n_m: Vec<Option<[f64; 3]>>,
    /// Standard deviation of a torque, N·m, body axes.
    pub torque_sigma_n_m: [f64; 3],
}

/// Residual force or torque in figures, body axes x, y, z.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Axes {
    /// Root mean square of the residual, N or N·m.
    pub rms: [f64; 3],
    /// Its mean, N or N·m.
    pub mean: [f64; 3],
    /// Standard deviation of a sample by the sensors' noise alone, N or N·m.
    pub sigma: [f64; 3],
    /// Root mean square over that standard deviation.
    pub in_sigmas: [f64; 3],
    /// Share of the variation of the measured force without gravity (or torque) that the model explains:
    /// 1 − variance of the residual / variance of the measured, a constant offset (`mean`) apart. 1 is all of it, 0 none,
    /// negative: the model makes it worse. Null where the measured one hardly varies beyond its noise.
    pub explained: [Option<f64>; 3],
}

/// The model against the measurement at every instant.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OneStep {
    /// Number of instants, 5 ms apart.
    pub n: usize,
    /// Where forces come from: `accelerometer` or `poses`.
    pub force_from: &'static str,
    /// Where torques come from: `gyroscope` or `attitudes`.
    pub torque_from: &'static str,
    /// How certain that is, in words.
    pub certainty: String,
    /// Residual force.
    pub force: Axes,
    /// Residual torque; null where the drive says nothing of torques.
    pub torque: Option<Axes>,
    /// Over time.
    pub series: Series,
}

/// Errors of roll-outs of one length.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Horizon {
    /// Root-mean-square errors (lengths of 3-D differences).
    pub error: HorizonError,
    /// What they would be if the model were right: the sensors' noise at start and end, sent through the model.
    pub expected: HorizonError,
    /// Errors over what is expected: position, velocity, attitude, rate. Null where attitude is an input.
    pub times_expected: [Option<f64>; 4],
    /// Errors over the noise of one sample per channel (position, attitude; body rate where there is a gyroscope), as
    /// lengths: √3 times that of an axis. Null where there is no such sensor.
    pub times_sample_noise: [Option<f64>; 4],
}

/// A whole flight of the model with its controller along the logged references.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ClosedLoop {
    /// Length, s.
    pub duration_s: f64,
    /// Root-mean-square distance of the model's flight from the measured one, m.
    pub position_m: f64,
    /// The same of velocities, m/s.
    pub velocity_m_s: f64,
    /// Root-mean-square distance of the measured flight from the references, m.
    pub tracking_measured_m: f64,
    /// Root-mean-square distance of the model's flight from the references, m.
    pub tracking_model_m: f64,
    /// What was assumed.
    pub notes: Vec<String>,
}

/// A stretch of a flight.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Segment {
    /// From, s.
    pub from_s: f64,
    /// To, s.
    pub to_s: f64,
    /// Root-mean-square residual force (length), N.
    pub force_rms_n: f64,
    /// Root-mean-square residual torque (length), N·m.
    pub torque_rms_n_m: Option<f64>,
    /// Force and torque together, in standard deviations of the sensors' noise.
    pub in_sigmas: f64,
    /// What was going on: name, mean, unit.
    pub context: Vec<(String, f64, String)>,
    /// What was special about it, in words.
    pub text: String,
}

/// One log against the model.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LogComparison {
    /// Name, hash, drive, length, noise.
    #[serde(flatten)]
    pub log: LogSummary,
    /// What the checker and the preparation say.
    pub warnings: Vec<String>,
    /// One step: residual force and torque.
    pub one_step: OneStep,
    /// Short roll-outs.
    pub horizons: Vec<Horizon>,
    /// Whole flight; null where the log or the vehicle does not allow it.
    pub closed_loop: Option<ClosedLoop>,
    /// Why there is no closed loop.
    pub closed_loop_missing: Option<String>,
    /// Worst segments, worst first.
    pub worst: Vec<Segment>,
    /// Residual against possible causes.
    pub causes: Vec<Cause>,
    /// What of that is worth saying, most telling first.
    pub findings: Vec<String>,
    /// Why the file's rotors cannot be those of the log (their order, their spins, another vehicle); null where they can.
    pub other_rotors: Option<String>,
    /// Largest error over what noise makes, of all channels and horizons and of residual force and torque.
    pub worst_times_noise: f64,
    /// Whether that is at most [`AGREE`].
    pub agrees: bool,
    /// One sentence.
    pub verdict: String,
}

/// All logs together.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Pooled {
    /// Root mean square of the residual force, N, body axes.
    pub force_rms_n: [f64; 3],
    /// Root mean square of the residual torque, N·m, body axes; null where no log has one.
    pub torque_rms_n_m: Option<[f64; 3]>,
    /// Roll-outs of all logs.
    pub horizons: Vec<HorizonError>,
    /// Residual against possible causes (without time).
    pub causes: Vec<Cause>,
    /// What of that is worth saying, most telling first.
    pub findings: Vec<String>,
}

/// The result: a model against flights.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Name of the vehicle.
    pub vehicle: String,
    /// SHA-256 of its file's contents.
    pub vehicle_sha256: String,
    /// The logs.
    pub logs: Vec<LogComparison>,
    /// All together, where there are several.
    pub pooled: Option<Pooled>,
    /// Threshold of agreement, multiples of what noise makes.
    pub threshold: f64,
    /// Whether the model agrees with every log.
    pub agrees: bool,
    /// Where it does not: whether numbers within the vehicle's tolerances explain what it leaves, so that nothing is missing; null
    /// where it agrees, or where the logs are too short to tell.
    pub within_tolerance: Option<bool>,
    /// One sentence.
    pub verdict: String,
}

impl Comparison {
    /// Whether nothing is missing: the model agrees, or numbers within their tolerances are all that is off. As a diagnosis has it, but
    /// by its first steps only.
    pub fn nothing_missing(&self) -> bool {
        self.agrees || self.within_tolerance == Some(true)
    }
}

/// Compares a vehicle with flights.
///
/// # Errors
/// [`GapError::Log`] without any log, [`GapError::TooShort`] where too little of one can be used, [`GapError::DifferentVehicles`] where logs
/// cannot be of one vehicle, [`GapError::Numbers`] where the model does not stay finite.
pub fn compare(tracks: &[Track], vehicle: &Vehicle) -> Result<Comparison, GapError> {
    if tracks.is_empty() {
        return Err(GapError::Log {
            log: "compare".into(),
            expected: "at least one log".into(),
            found: "none".into(),
            remedy: "name one or more logs".into(),
        });
    }
    one_vehicle(tracks)?;
    let parts: Vec<Part> = tracks.par_iter().map(|track| one(track, vehicle)).collect::<Result<_, _>>()?;
    let departs =
        parts.iter().any(|(log, ..)| !log.agrees) && parts.iter().all(|(log, ..)| log.other_rotors.is_none());
    // A fit that finds no numbers takes nothing from what was measured.
    let within_tolerance = departs.then(|| within_tolerance(tracks, vehicle).ok().flatten()).flatten();
    let pooled = (parts.len() > 1).then(|| pool(&parts));
    let logs: Vec<LogComparison> = parts.into_iter().map(|(log, ..)| log).collect();
    let agrees = logs.iter().all(|l| l.agrees);
    let verdict = match &logs[..] {
        [only] => only.verdict.clone(),
        _ if agrees => format!(
            "the model agrees with all {} logs: nothing is off by more than {AGREE} times what the sensors' noise makes",
            logs.len()
        ),
        _ => {
            let bad: Vec<&LogComparison> = logs.iter().filter(|l| !l.agrees).collect();
            let worst = bad
                .iter()
                .max_by(|a, b| a.worst_times_noise.total_cmp(&b.worst_times_noise))
                .map_or_else(String::new, |l| format!("; worst on {}: {}", l.log.name, l.verdict));
            format!("the model departs from {} of {} logs{worst}", bad.len(), logs.len())
        }
    };
    let verdict = match within_tolerance {
        Some(true) => format!("nothing is missing: numbers within tolerance explain all; {verdict}"),
        _ => verdict,
    };
    Ok(Comparison {
        vehicle: vehicle.name.clone(),
        vehicle_sha256: vehicle.sha256(),
        logs,
        pooled,
        threshold: AGREE,
        agrees,
        within_tolerance,
        verdict,
    })
}

/// Refuses logs that cannot be of one vehicle: other numbers of rotors, or thrusts or rotor speeds that differ by more than
/// 30 % at the same load factor. A flight of hard turns has twice the thrust of a hover.
///
/// # Errors
/// [`GapError::DifferentVehicles`].
pub fn one_vehicle(tracks: &[Track]) -> Result<(), GapError> {
    let Some((first, others)) = tracks.split_first() else { return Ok(()) };
    let differ = |other: &Track, reason: String| {
        Err(GapError::DifferentVehicles { first: first.name.clone(), second: other.name.clone(), reason })
    };
    for other in others {
        let n = [first, other].map(|t| t.log.rotor_speed_rad_s.len().max(t.log.cmd_rotor_rad_s.len()));
        if n[0] != n[1] && n[0] > 0 && n[1] > 0 {
            return differ(other, format!("they have {} and {} rotors", n[0], n[1]));
        }
        let level = |t: &Track, which: usize| {
            let channels = match which {
                0 => &t.log.rotor_speed_rad_s[..],
                1 => &t.log.cmd_rotor_rad_s[..],
                2 => std::slice::from_ref(&t.log.thrust_n),
                _ => std::slice::from_ref(&t.log.cmd_thrust_n),
            };
            per_load(t, channels, if which < 2 { 0.5 } else { 1.0 })
        };
        let names = [
            ("rotor speeds", "rad/s"),
            ("rotor commands", "rad/s"),
            ("thrusts", "N"),
            ("thrust commands", "N"),
        ];
        for (which, (name, unit)) in names.iter().enumerate() {
            if let (Some(a), Some(b)) = (level(first, which), level(other, which))
                && a.max(b) > 1.3 * a.min(b)
            {
                let (a, b) = (short(a), short(b));
                let reason = format!("at a load factor of 1 their median {name} are {a} and {b} {unit}");
                return differ(other, reason);
            }
        }
    }
    Ok(())
}

/// Median of channels in the usable flight, each sample over the load factor to a power: thrust goes with it, rotor speed with
/// its root. The load factor is what the accelerometer feels along the rotors' axis, or what holds the motion up.
fn per_load(track: &Track, channels: &[crate::flight::Channel<1>], power: f64) -> Option<f64> {
    let stride = channels.first().map_or(1, |c| (c.len() / MOST_LOADS).max(1));
    let mut all = Vec::new();
    for c in channels {
        let [from, to] = track.span_s;
        let used: Vec<usize> = (0..c.len())
            .step_by(stride)
            .filter(|i| c.t_s[*i] >= from && c.t_s[*i] <= to && !track.is_excluded(c.t_s[*i]))
            .collect();
        let at: Vec<f64> = used.iter().map(|i| c.t_s[*i]).collect();
        let felt: Vec<Option<f64>> = if track.accel.is_empty() {
            let half = 0.1f64.max(4.2 * track.position.period_s().unwrap_or(0.01));
            let pulled = resample::local_parabola(&track.position, &at, half);
            pulled
                .iter()
                .map(|p| p.as_ref().map(|p| vec3::norm(vec3::add(p.curvature, [0.0, 0.0, G]))))
                .collect()
        } else {
            let half = LOAD_HALF_S.max(3.2 * track.accel.period_s().unwrap_or(0.01));
            resample::local_parabola(&track.accel, &at, half)
                .iter()
                .map(|a| a.as_ref().map(|a| a.value[2]))
                .collect()
        };
        for (i, felt) in used.iter().zip(felt) {
            let load = felt.map_or(1.0, |f| f / G);
            if load > LEAST_LOAD {
                all.push(c.values[*i][0] / load.powf(power));
            }
        }
    }
    clean::median(all).filter(|m| *m > 0.0)
}

/// Samples of a channel at which load factors are taken, half width of their smoothing, s, and the least that says anything.
const MOST_LOADS: usize = 2000;
const LOAD_HALF_S: f64 = 0.03;
const LEAST_LOAD: f64 = 0.3;

/// What happens along a log, per instant, in the order of its labels; NaN where not known.
struct Context {
    labels: Vec<Label>,
    values: Vec<Vec<f64>>,
}

fn context(replay: &Replay) -> Context {
    let track = replay.track;
    let n = replay.n_steps();
    let at: Vec<f64> = (0..n).map(|i| replay.time_s(i)).collect();
    let mut out = Context { labels: Vec::new(), values: Vec::new() };
    let mut add = |name: &str, title: &str, unit: &'static str, values: Vec<f64>| {
        out.labels.push((name.into(), title.into(), unit));
        out.values.push(values);
    };
    let of_state = |f: &dyn Fn(&Measured) -> f64| -> Vec<f64> {
        replay.around.measured.iter().map(|m| m.as_ref().map_or(f64::NAN, f)).collect()
    };
    add("speed", "speed", "m/s", of_state(&|m| vec3::norm(m.vel)));
    let along = |axis: usize| of_state(&move |m| quat::rotate_inverse(m.quat, m.vel)[axis]);
    add("velocity_forward", "forward velocity", "m/s", along(0));
    add("velocity_left", "velocity to the left", "m/s", along(1));
    add("velocity_up", "velocity along body z", "m/s", along(2));
    add("height", "height over the ground", "m", of_state(&|m| track.ground_distance_m(m.pos[2])));
    match track.drive {
        Drive::RotorSpeeds | Drive::RotorCommands => {
            let rotors = replay.drone.airframe.n_rotors.max(1);
            let mean =
                |i: usize| replay.ticks[i * STEP].rotor_vel[..rotors].iter().sum::<f64>() / rotors as f64;
            add("rotor_speed", "mean rotor speed", "rad/s", (0..n).map(mean).collect());
        }
        Drive::AttitudeCommands | Drive::Thrust => {
            add("thrust", "thrust", "N", (0..n).map(|i| replay.ticks[i * STEP].thrust).collect());
        }
    }
    add(
        "tilt",
        "tilt",
        "rad",
        of_state(&|m| quat::rotate(m.quat, [0.0, 0.0, 1.0])[2].clamp(-1.0, 1.0).acos()),
    );
    add("yaw_rate", "yaw rate", "rad/s", of_state(&|m| m.ang_vel[2]));
    if track.log.vbat_v.len() > 1 {
        let v = resample::linear(&track.log.vbat_v, &at, 5.0);
        let v = v.into_iter().map(|v| v.map_or(f64::NAN, |v| v[0])).collect();
        add("battery", "battery voltage", "V", v);
    }
    add("time", "time", "s", at.clone());
    for name in &track.neighbours {
        let Some(channel) = track.log.objects_m.get(name) else { continue };
        let places = resample::linear(channel, &at, 0.2);
        let distance = places
            .into_iter()
            .zip(&replay.around.measured)
            .map(|(p, m)| match (p, m) {
                (Some(p), Some(m)) => vec3::norm(vec3::sub(p, m.pos)),
                _ => f64::NAN,
            })
            .collect();
        add(&format!("distance.{name}"), &format!("distance to {name}"), "m", distance);
    }
    out
}

fn responses() -> Vec<Label> {
    [
        ("force", "force", "N"),
        ("force_body_x", "force along body x", "N"),
        ("force_body_y", "force along body y", "N"),
        ("force_body_z", "force along body z", "N"),
        ("force_along_velocity", "force along the velocity", "N"),
        ("torque", "torque", "N·m"),
        ("torque_body_x", "torque about body x", "N·m"),
        ("torque_body_y", "torque about body y", "N·m"),
        ("torque_body_z", "torque about body z", "N·m"),
    ]
    .map(|(name, title, unit)| (name.into(), title.into(), unit))
    .to_vec()
}

/// Slowest flight whose direction means something, m/s.
const MOVING_M_S: f64 = 0.1;

/// Means over blocks of [`BLOCK_S`].
fn blocks(replay: &Replay, residuals: &Residuals, context: &Context) -> Vec<Block> {
    let per = (BLOCK_S / STEP_S).round() as usize;
    let mut out = Vec::new();
    let mut from = 0;
    let list = &residuals.samples;
    while from < list.len() {
        let number = list[from].step / per;
        let to = from + list[from..].partition_point(|s| s.step / per == number);
        let part = &list[from..to];
        from = to;
        if part.len() * 2 < per {
            continue;
        }
        let mean = |f: &dyn Fn(&residual::Sample) -> f64| part.iter().map(f).sum::<f64>() / part.len() as f64;
        let force: [f64; 3] = std::array::from_fn(|k| mean(&|s| s.force_n[k]));
        let torque: [f64; 3] = std::array::from_fn(|k| mean(&|s| s.torque_n_m.map_or(f64::NAN, |t| t[k])));
        let along = mean(&|s| match &replay.around.measured[s.step] {
            Some(m) if vec3::norm(m.vel) > MOVING_M_S => {
                let v = quat::rotate_inverse(m.quat, m.vel);
                vec3::dot(s.force_n, v) / vec3::norm(v)
            }
            _ => f64::NAN,
        });
        let mut responses = vec![vec3::norm(force)];
        responses.extend(force);
        responses.push(along);
        responses.push(vec3::norm(torque));
        responses.extend(torque);
        out.push(Block {
            number,
            causes: context.values.iter().map(|v| mean(&|s| v[s.step])).collect(),
            responses,
        });
    }
    out
}

fn axes(residual: &[[f64; 3]], measured: &[[f64; 3]], sigma: [f64; 3]) -> Axes {
    let n = residual.len().max(1) as f64;
    let mean = |list: &[[f64; 3]], k: usize| list.iter().map(|v| v[k]).sum::<f64>() / n;
    let square = |list: &[[f64; 3]], k: usize, about: f64| {
        list.iter().map(|v| (v[k] - about).powi(2)).sum::<f64>() / n
    };
    let rms: [f64; 3] = std::array::from_fn(|k| square(residual, k, 0.0).sqrt());
    Axes {
        rms,
        mean: std::array::from_fn(|k| mean(residual, k)),
        sigma,
        in_sigmas: std::array::from_fn(|k| if sigma[k] > 0.0 { rms[k] / sigma[k] } else { 0.0 }),
        explained: std::array::from_fn(|k| {
            let all = square(measured, k, mean(measured, k));
            (all > (2.0 * sigma[k]).powi(2)).then(|| 1.0 - square(residual, k, mean(residual, k)) / all)
        }),
    }
}

fn one_step(replay: &Replay, residuals: &Residuals) -> OneStep {
    let list = &residuals.samples;
    let forces: Vec<[f64; 3]> = list.iter().map(|s| s.force_n).collect();
    let measured: Vec<[f64; 3]> = list.iter().map(|s| s.measured_force_n).collect();
    let torques: Vec<[f64; 3]> = list.iter().filter_map(|s| s.torque_n_m).collect();
    let torques_read: Vec<[f64; 3]> = list.iter().filter_map(|s| s.measured_torque_n_m).collect();
    let mut series = Series::default();
    let per = (SERIES_S / STEP_S).round() as usize;
    let mut from = 0;
    while from < list.len() {
        let number = list[from].step / per;
        let to = from + list[from..].partition_point(|s| s.step / per == number);
        let part = &list[from..to];
        from = to;
        let n = part.len() as f64;
        let mean = |f: &dyn Fn(&residual::Sample) -> [f64; 3]| -> [f64; 3] {
            let sum = part.iter().fold([0.0; 3], |sum, s| vec3::add(sum, f(s)));
            vec3::scale(sum, 1.0 / n)
        };
        series.t_s.push(part.iter().map(|s| replay.time_s(s.step)).sum::<f64>() / n);
        series.force_body_n.push(mean(&|s| s.force_n));
        series.force_world_n.push(mean(&|s| quat::rotate(s.quat, s.force_n)));
        if !torques.is_empty() {
            let all = part.iter().all(|s| s.torque_n_m.is_some());
            series.torque_n_m.push(all.then(|| mean(&|s| s.torque_n_m.unwrap_or_default())));
        }
    }
    let averaged = |memory_s: f64| (memory_s / SERIES_S).min(1.0).sqrt();
    series.force_sigma_n = residuals.force_sigma_n.map(|s| s * averaged(residuals.force_memory_s));
    series.torque_sigma_n_m = residuals.torque_sigma_n_m.map(|s| s * averaged(residuals.torque_memory_s));
    let mass = replay.plant().parts.body.mass_kg;
    let sigma = residuals.force_sigma_n.iter().fold(0.0, |a: f64, b| a.max(*b));
    let force = if residuals.from_accelerometer {
        format!("forces from the accelerometer, smoothed over ±{:.0} ms", 1e3 * residuals.force_half_s)
    } else {
        format!(
            "no accelerometer: forces from the second derivative of positions over ±{:.0} ms, in which nothing faster \
             is seen",
            1e3 * residuals.force_half_s
        )
    };
    let torque = match (torques.is_empty(), residuals.from_gyroscope) {
        (true, _) => "no torques: the attitude is an input".to_string(),
        (false, true) => format!("torques from the gyroscope over ±{:.0} ms", 1e3 * residuals.torque_half_s),
        (false, false) => format!(
            "no gyroscope: torques from the second derivative of attitudes over ±{:.0} ms",
            1e3 * residuals.torque_half_s
        ),
    };
    OneStep {
        n: list.len(),
        force_from: if residuals.from_accelerometer { "accelerometer" } else { "poses" },
        torque_from: if residuals.from_gyroscope { "gyroscope" } else { "attitudes" },
        certainty: format!(
            "{force}; one standard deviation by noise {} N ({} m/s²); {torque}",
            short(sigma),
            short(sigma / mass)
        ),
        force: axes(&forces, &measured, residuals.force_sigma_n),
        torque: (!torques.is_empty()).then(|| axes(&torques, &torques_read, residuals.torque_sigma_n_m)),
        series,
    }
}

/// The span of a log in which motors turn as the model has them, s.
fn settled(replay: &Replay) -> [f64; 2] {
    let [from, to] = replay.track.span_s;
    [from + settling_s(replay.track), to]
}

fn horizons(replay: &Replay) -> Vec<Horizon> {
    let settled = settled(replay);
    let (errors, mut expected) = rayon::join(
        || residual::replay_errors(replay, &HORIZONS_S, Some(&[settled])),
        || residual::expected_errors(replay, &HORIZONS_S),
    );
    // What the integrator of a simulated flight makes is no fault of the vehicle.
    for (e, made) in expected.iter_mut().zip(integration::errors(replay)) {
        e.position_m = e.position_m.hypot(made[0]);
        e.velocity_m_s = e.velocity_m_s.hypot(made[1]);
        e.attitude_rad = e.attitude_rad.hypot(made[2]);
        e.rate_rad_s = e.rate_rad_s.hypot(made[3]);
    }
    let (track, noise) = (replay.track, &replay.track.noise);
    let turning = track.drive != Drive::Thrust;
    let length = |sigma: f64| 3f64.sqrt() * sigma;
    errors
        .into_iter()
        .zip(expected)
        .map(|(error, expected)| {
            let list = |e: &HorizonError| [e.position_m, e.velocity_m_s, e.attitude_rad, e.rate_rad_s];
            let (got, made) = (list(&error), list(&expected));
            let some = |k: usize| error.n > 0 && (k < 2 || turning);
            let sample = [
                Some(length(noise.position_m)),
                None,
                Some(length(noise.attitude_rad)),
                (!track.gyro.is_empty()).then(|| length(noise.gyro_rad_s)),
            ];
            Horizon {
                times_expected: std::array::from_fn(|k| (some(k) && made[k] > 0.0).then(|| got[k] / made[k])),
                times_sample_noise: std::array::from_fn(|k| {
                    sample[k].filter(|s| some(k) && *s > 0.0).map(|s| got[k] / s)
                }),
                error,
                expected,
            }
        })
        .collect()
}

/// A whole flight along the logged references, or why there is none.
fn closed_loop(replay: &Replay, vehicle: &Vehicle) -> Result<ClosedLoop, String> {
    let (track, log) = (replay.track, &replay.track.log);
    let refs = &log.ref_position_m;
    if refs.len() < 10 {
        return Err("the log has no references (ref_x ref_y ref_z)".into());
    }
    let modes = vehicle.modes(track.dynamics).map_err(|e| e.to_string())?;
    if !modes.contains(&ControlMode::State) {
        return Err("the vehicle file has no position controller that flies along references".into());
    }
    let from = track.span_s[0].max(refs.t_s[0]);
    let to = track.span_s[1].min(refs.t_s[refs.len() - 1]);
    let n_steps = replay.n_steps();
    let first = (0..n_steps).find(|i| replay.time_s(*i) >= from && replay.around.measured[*i].is_some());
    let Some((first, start)) = first.and_then(|i| Some((i, replay.around.measured[i]?))) else {
        return Err("references and poses do not overlap".into());
    };
    let sim_hz = 500;
    let every = sim_hz / 100;
    let begin = replay.time_s(first);
    let n = ((to - begin) * 100.0).floor();
    if !(n >= 100.0) {
        return Err("references and poses overlap for less than 1 s".into());
    }
    let at: Vec<f64> = (0..=n as usize).map(|i| begin + i as f64 * 0.01).collect();
    let half = 0.05f64.max(3.2 * refs.period_s().unwrap_or(0.01));
    let mut notes = Vec::new();
    let positions = resample::linear(refs, &at, 1.0);
    let local = resample::local_parabola(refs, &at, half);
    let given = |c: &crate::flight::Channel<3>| (c.len() > 1).then(|| resample::linear(c, &at, 1.0));
    let (velocities, accelerations) = (given(&log.ref_velocity_m_s), given(&log.ref_acceleration_m_s2));
    if velocities.is_none() {
        notes.push("reference velocities are the derivative of reference positions".into());
    }
    if accelerations.is_none() {
        notes.push("reference accelerations are the second derivative of reference positions".into());
    }
    if log.ref_yaw_rad.is_empty() {
        notes.push("no reference yaw: the measured one is used".into());
    }
    if !replay.around.neighbours.is_empty() {
        notes.push("the other vehicles are not in the model's flight".into());
    }
    let measured = track.measured_state(&at);
    let options = SimOptions {
        sim_hz,
        integrator: Integrator::Rk4,
        control: ControlMode::State,
        ..SimOptions::default()
    };
    let run = || -> Result<Vec<State<f64>>, crate::rollout::RolloutError> {
        let mut sim = Sim::new(options, vec![(replay.drone.clone(), vehicle.rates)])?;
        let state = State {
            pos: start.pos,
            quat: quat::normalize(start.quat),
            vel: start.vel,
            ang_vel: start.ang_vel,
            ..State::rest()
        };
        sim.set_initial(0, 0, state)?;
        sim.reset(None)?;
        if let Some(ground) = track.ground_z_m {
            sim.data.ground_z.fill(ground);
        }
        let mut out = Vec::with_capacity(at.len());
        let (mut yaw, mut last) = (heading(start.quat), None);
        for (i, t) in at.iter().enumerate() {
            out.push(sim.data.state(0, 0));
            if let Some(pos_m) = positions[i] {
                let column = log.ref_yaw_rad.t_s.partition_point(|x| x <= t);
                if column > 0 {
                    yaw = log.ref_yaw_rad.values[column - 1][0];
                } else if let Some(m) = measured[i].filter(|_| log.ref_yaw_rad.is_empty()) {
                    yaw = heading(m.quat);
                }
                let pick = |list: &Option<Vec<Option<[f64; 3]>>>| list.as_ref().map(|l| l[i]);
                let slope = local[i].map_or([0.0; 3], |l| l.slope);
                let bend = local[i].map_or([0.0; 3], |l| l.curvature);
                last = Some(Reference {
                    pos_m,
                    vel_m_s: pick(&velocities).map_or(slope, |v| v.unwrap_or(slope)),
                    acc_m_s2: pick(&accelerations).map_or(bend, |a| a.unwrap_or(bend)),
                    yaw_rad: yaw,
                });
            }
            if let Some(reference) = last {
                sim.set_command(&reference.command())?;
            }
            let place = first + ((t - begin) / STEP_S).round() as usize;
            if let Some(wind) = replay.around.wind.get(place) {
                sim.data.wind.copy_from_slice(wind);
            }
            sim.step(every as usize)?;
        }
        Ok(out)
    };
    let flown = run().map_err(|e| e.to_string())?;
    if flown.iter().any(|s| !s.pos.iter().chain(&s.vel).all(|x| x.is_finite())) {
        return Err("the model's flight does not stay finite".into());
    }
    let (mut sums, mut counts) = ([0.0; 4], [0.0f64; 3]);
    let square = |a: [f64; 3], b: [f64; 3]| {
        let d = vec3::sub(a, b);
        vec3::dot(d, d)
    };
    for i in 0..at.len() {
        let state = &flown[i];
        if let Some(m) = &measured[i] {
            sums[0] += square(state.pos, m.pos);
            sums[1] += square(state.vel, m.vel);
            counts[0] += 1.0;
            if let Some(p) = positions[i] {
                sums[2] += square(m.pos, p);
                counts[1] += 1.0;
            }
        }
        if let Some(p) = positions[i] {
            sums[3] += square(state.pos, p);
            counts[2] += 1.0;
        }
    }
    let root = |sum: f64, n: f64| (sum / n.max(1.0)).sqrt();
    Ok(ClosedLoop {
        duration_s: at[at.len() - 1] - begin,
        position_m: root(sums[0], counts[0]),
        velocity_m_s: root(sums[1], counts[0]),
        tracking_measured_m: root(sums[2], counts[1]),
        tracking_model_m: root(sums[3], counts[2]),
        notes,
    })
}

/// Yaw of an attitude, rad.
fn heading(q: [f64; 4]) -> f64 {
    let forward = quat::rotate(q, [1.0, 0.0, 0.0]);
    forward[1].atan2(forward[0])
}

fn worst(replay: &Replay, residuals: &Residuals, context: &Context) -> Vec<Segment> {
    let list = &residuals.samples;
    let (per, stride) = ((SEGMENT_S / STEP_S).round() as usize, (0.25 / STEP_S).round() as usize);
    let total = |sigma: [f64; 3]| vec3::dot(sigma, sigma).max(1e-300);
    let sigmas = [total(residuals.force_sigma_n), total(residuals.torque_sigma_n_m)];
    let mut all: Vec<(f64, usize, usize)> = Vec::new();
    let mut at = 0;
    while at + per <= replay.n_steps() {
        let (a, b) = (list.partition_point(|s| s.step < at), list.partition_point(|s| s.step < at + per));
        at += stride;
        if (b - a) * 2 < per {
            continue;
        }
        let (force, torque) = squares(&list[a..b]);
        let score = force / sigmas[0] + torque.map_or(0.0, |t| t / sigmas[1]);
        all.push((score, a, b));
    }
    all.sort_by(|x, y| y.0.total_cmp(&x.0));
    let mut chosen: Vec<(f64, usize, usize)> = Vec::new();
    for one in all {
        let apart = |c: &(f64, usize, usize)| one.2 <= c.1 || one.1 >= c.2;
        if chosen.len() < WORST && chosen.iter().all(apart) {
            chosen.push(one);
        }
    }
    // What is usual in this flight, to say what is special about a segment.
    let usual: Vec<[f64; 2]> = context
        .values
        .iter()
        .map(|v| [0.1, 0.9].map(|p| clean::quantile(v, p).unwrap_or(f64::NAN)))
        .collect();
    chosen
        .into_iter()
        .map(|(score, a, b)| {
            let part = &list[a..b];
            let (force, torque) = squares(part);
            let mut seen = Vec::new();
            let mut special = Vec::new();
            for ((label, values), usual) in context.labels.iter().zip(&context.values).zip(&usual) {
                let mean = part.iter().map(|s| values[s.step]).sum::<f64>() / part.len() as f64;
                if !mean.is_finite() {
                    continue;
                }
                seen.push((label.0.clone(), mean, label.2.to_string()));
                if label.0 != "time" && usual[1] > usual[0] && (mean < usual[0] || mean > usual[1]) {
                    let word = if mean > usual[1] { "high" } else { "low" };
                    special.push(format!("{word} {} ({} {})", label.1, short(mean), label.2));
                }
            }
            let text =
                if special.is_empty() { "nothing unusual going on".into() } else { special.join(", ") };
            let from_s = replay.time_s(part[0].step);
            Segment {
                from_s,
                to_s: replay.time_s(part[part.len() - 1].step),
                force_rms_n: force.sqrt(),
                torque_rms_n_m: torque.map(f64::sqrt),
                in_sigmas: (score / if torque.is_some() { 2.0 } else { 1.0 }).sqrt(),
                context: seen,
                text,
            }
        })
        .collect()
}

/// Mean squares of the lengths of residual force and torque.
fn squares(part: &[residual::Sample]) -> (f64, Option<f64>) {
    let n = part.len().max(1) as f64;
    let force = part.iter().map(|s| vec3::dot(s.force_n, s.force_n)).sum::<f64>() / n;
    let torques: Vec<f64> = part.iter().filter_map(|s| s.torque_n_m.map(|t| vec3::dot(t, t))).collect();
    let torque = (!torques.is_empty()).then(|| torques.iter().sum::<f64>() / torques.len() as f64);
    (force, torque)
}

fn cause_list(blocks: &[Block], labels: &[Label], skip_time: bool) -> Vec<Cause> {
    let responses = responses();
    labels
        .iter()
        .enumerate()
        .filter(|(_, label)| !(skip_time && label.0 == "time"))
        .filter_map(|(i, label)| causes::bins(blocks, i, label, &responses))
        .collect()
}

fn sentences(list: &[Cause]) -> Vec<String> {
    causes::sentences(list).into_iter().map(|(_, text)| text).collect()
}

/// A log's comparison, and what pooling needs of it.
type Part = (LogComparison, Vec<Block>, Vec<Label>);

fn one(track: &Track, vehicle: &Vehicle) -> Result<Part, GapError> {
    let drone: Drone<f64> = replay::drone_for(track, vehicle)?;
    let around = Around::new(track, &drone);
    let raw = Raw::new(track, &around);
    let replay = Replay::new(track, &around, &raw, &drone);
    let ((mut residuals, horizons), loop_) = rayon::join(
        || rayon::join(|| Residuals::new(&replay), || horizons(&replay)),
        || closed_loop(&replay, vehicle),
    );
    residuals.samples.retain(|s| replay.time_s(s.step) >= settled(&replay)[0]);
    let fault = |found: String| GapError::TooShort {
        log: track.name.clone(),
        expected: format!("stretches of at least {} s with pose and {}", HORIZONS_S[0], track.drive.title()),
        found,
        remedy: "look at the gaps that `propwash log check` names, or give another log".into(),
    };
    if residuals.samples.len() < 50 || horizons[0].error.n < FEWEST {
        return Err(fault(format!(
            "{} instants and {} roll-outs that can be used",
            residuals.samples.len(),
            horizons[0].error.n
        )));
    }
    let finite =
        |e: &HorizonError| (e.position_m + e.velocity_m_s + e.attitude_rad + e.rate_rad_s).is_finite();
    if !horizons.iter().all(|h| finite(&h.error) && finite(&h.expected)) {
        return Err(GapError::Numbers {
            what: "roll-outs",
            reason: format!(
                "with {} the model of `{}` does not stay finite on {}: check the vehicle file's values",
                track.drive.title(),
                vehicle.name,
                track.name
            ),
        });
    }
    let one_step = one_step(&replay, &residuals);
    let context = context(&replay);
    let blocks = blocks(&replay, &residuals, &context);
    let causes = cause_list(&blocks, &context.labels, false);
    // What is there throughout comes first: it rules roll-outs, and no cause tells of it.
    let build = constants::Build::of(&replay.plant().parts);
    let mut findings = constants::sentences(&one_step, &build, &causes);
    findings.extend(sentences(&causes));
    let worst = worst(&replay, &residuals, &context);
    let (closed_loop, closed_loop_missing) = match loop_ {
        Ok(flown) => (Some(flown), None),
        Err(why) => (None, Some(why)),
    };
    let (worst_times_noise, place) = most(&one_step, &horizons);
    let agrees = worst_times_noise <= AGREE;
    let mismatch = (!agrees).then(|| wiring::mismatch(track, &around, &raw, &drone)).flatten();
    let other_rotors = mismatch.map(|m| format!("the log has {}; {}; {}", m.found, m.remedy, m.numbers));
    findings.splice(..0, other_rotors.clone());
    let verdict = if agrees {
        format!(
            "the model agrees with the log: nothing is off by more than {worst_times_noise:.1} times what the sensors' \
             noise makes (threshold {AGREE})"
        )
    } else {
        let mut text = format!(
            "the model departs from the log: {place}, {} times what the sensors' noise makes (threshold {AGREE})",
            short(worst_times_noise)
        );
        if let Some(other) = &other_rotors {
            text = format!("{other}; {text}");
        } else if let Some(first) = findings.first() {
            text = format!("{text}; {first}");
        }
        if let Some(segment) = worst.first() {
            text = format!("{text}; worst from {:.1} to {:.1} s", segment.from_s, segment.to_s);
        }
        text
    };
    let log = LogSummary {
        name: track.name.clone(),
        sha256: track.log.sha256.clone(),
        duration_s: track.duration_s(),
        drive: track.drive.title().into(),
        noise: track.noise,
        held_out: false,
    };
    let warnings = track.warnings.clone();
    let comparison = LogComparison {
        log,
        warnings,
        one_step,
        horizons,
        closed_loop,
        closed_loop_missing,
        worst,
        causes,
        findings,
        other_rotors,
        worst_times_noise,
        agrees,
        verdict,
    };
    Ok((comparison, blocks, context.labels))
}

/// The largest of all errors in multiples of noise, and where it is.
fn most(one_step: &OneStep, horizons: &[Horizon]) -> (f64, String) {
    let mut best = (0.0, String::from("nothing is off"));
    let mut take = |times: f64, text: &dyn Fn() -> String| {
        if times > best.0 {
            best = (times, text());
        }
    };
    for h in horizons.iter().filter(|h| h.error.n >= FEWEST) {
        let e = &h.error;
        let channels = [
            ("position", e.position_m, "m"),
            ("velocity", e.velocity_m_s, "m/s"),
            ("attitude", e.attitude_rad, "rad"),
            ("body rate", e.rate_rad_s, "rad/s"),
        ];
        for ((name, error, unit), times) in channels.iter().zip(h.times_expected) {
            if let Some(times) = times {
                take(times, &|| format!("after {} s {name} is off by {} {unit}", e.horizon_s, short(*error)));
            }
        }
    }
    let axis = ["x", "y", "z"];
    for k in 0..3 {
        let f = &one_step.force;
        take(f.in_sigmas[k], &|| {
            format!("a force of {} N along body {} is missing", short(f.rms[k]), axis[k])
        });
        if let Some(t) = &one_step.torque {
            take(t.in_sigmas[k], &|| {
                format!("a torque of {} N·m about body {} is missing", short(t.rms[k]), axis[k])
            });
        }
    }
    best
}

fn pool(parts: &[Part]) -> Pooled {
    let root = |pick: fn(&LogComparison) -> Option<&Axes>| -> Option<[f64; 3]> {
        let (mut sum, mut n) = ([0.0; 3], 0.0);
        for (axes, count) in parts.iter().filter_map(|(log, ..)| Some((pick(log)?, log.one_step.n as f64))) {
            (0..3).for_each(|k| sum[k] += axes.rms[k] * axes.rms[k] * count);
            n += count;
        }
        (n > 0.0).then(|| sum.map(|s| (s / n).sqrt()))
    };
    let horizons = (0..HORIZONS_S.len())
        .map(|i| {
            let list = parts.iter().map(|(log, ..)| &log.horizons[i].error);
            let n: usize = list.clone().map(|e| e.n).sum();
            let pooled = |f: &dyn Fn(&HorizonError) -> f64| {
                let sum: f64 = list.clone().map(|e| f(e).powi(2) * e.n as f64).sum();
                (sum / n.max(1) as f64).sqrt()
            };
            HorizonError {
                horizon_s: HORIZONS_S[i],
                position_m: pooled(&|e| e.position_m),
                velocity_m_s: pooled(&|e| e.velocity_m_s),
                attitude_rad: pooled(&|e| e.attitude_rad),
                rate_rad_s: pooled(&|e| e.rate_rad_s),
                n,
            }
        })
        .collect();
    // Causes that any log has, in the order of their first appearance.
    let mut labels: Vec<Label> = Vec::new();
    for label in parts.iter().flat_map(|(_, _, own)| own) {
        if !labels.contains(label) {
            labels.push(label.clone());
        }
    }
    let mut blocks = Vec::new();
    let mut offset = 0;
    for (_, list, own) in parts {
        for b in list {
            let value = |l: &Label| own.iter().position(|o| o == l).map_or(f64::NAN, |i| b.causes[i]);
            blocks.push(Block {
                number: offset + b.number,
                causes: labels.iter().map(value).collect(),
                ..b.clone()
            });
        }
        offset += list.last().map_or(0, |b| b.number) + 2;
    }
    let causes = cause_list(&blocks, &labels, true);
    Pooled {
        force_rms_n: root(|l| Some(&l.one_step.force)).unwrap_or_default(),
        torque_rms_n_m: root(|l| l.one_step.torque.as_ref()),
        horizons,
        findings: sentences(&causes),
        causes,
    }
}
