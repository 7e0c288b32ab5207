//! Compares a model with measured flights: where and by how much it is off.
//!
//! Three measures: the force and torque that the model lacks at every instant, the errors of short roll-outs from measured
//! states, and, where a log has references, a whole flight simulated with our own controller.

mod closed_loop;
mod context;
mod one_log;
mod one_step;
mod pooled;
mod vehicles;
mod worst;

use super::GapError;
use super::causes::{self, Block, Label};
use super::first_look::within_tolerance;
use super::replay::Inputs;
use super::track::Track;
use super::verdict::{HorizonError, LogSummary};
use context::responses;
pub(crate) use context::{Context, context};
use one_log::Replayed;
use pooled::pool;
use propwash_vehicle::Vehicle;
use rayon::prelude::*;
use serde::Serialize;

pub use super::causes::{Cause, Response, SIGNIFICANT};
pub use vehicles::one_vehicle;

/// Lengths of the roll-outs, s.
pub const HORIZONS_S: [f64; 4] = [0.1, 0.2, 0.5, 1.0];
/// A model agrees with a log when no error exceeds this many times the sensors' noise.
pub const AGREE: f64 = 2.0;

/// Force and torque that the model lacks (residuals) over time; means over 0.05 s.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Series {
    /// Times, s.
    pub t_s: Vec<f64>,
    /// Force, N, body, shape (sample, 3).
    pub force_body_n: Vec<[f64; 3]>,
    /// Force, N, world, shape (sample, 3).
    pub force_world_n: Vec<[f64; 3]>,
    /// Standard deviation of a force due to sensor noise, N, body axes.
    pub force_sigma_n: [f64; 3],
    /// Torque, N·m, body, shape (sample, 3); null where unknown, empty where the drive carries no torques.
    pub torque_n_m: Vec<Option<[f64; 3]>>,
    /// Standard deviation of a torque, N·m, body axes.
    pub torque_sigma_n_m: [f64; 3],
}

/// Statistics of residual force or torque, body axes x, y, z.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Axes {
    /// Root mean square of the residual, N or N·m.
    pub rms: [f64; 3],
    /// Its mean, N or N·m.
    pub mean: [f64; 3],
    /// Standard deviation of a sample due to sensor noise alone, N or N·m.
    pub sigma: [f64; 3],
    /// Root mean square over that standard deviation.
    pub in_sigmas: [f64; 3],
    /// Share of the variance of the measured force without gravity (or torque) that the model explains: 1 − variance of the
    /// residual / variance of the measured, not counting a constant offset (`mean`). 1 is all of it, 0 none, negative: the
    /// model makes it worse. Null where the measured one hardly varies beyond its noise.
    pub explained: [Option<f64>; 3],
}

/// The model against the measurement at every instant.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OneStep {
    /// Number of instants, 5 ms apart.
    pub n: usize,
    /// Source of the forces: `accelerometer` or `poses`.
    pub force_from: &'static str,
    /// Source of the torques: `gyroscope` or `attitudes`.
    pub torque_from: &'static str,
    /// Reliability of these sources, in words.
    pub certainty: String,
    /// Residual force.
    pub force: Axes,
    /// Residual torque; null where the drive carries no torques.
    pub torque: Option<Axes>,
    /// Residuals over time.
    pub series: Series,
}

/// Errors of roll-outs of one length.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Horizon {
    /// Root-mean-square errors (lengths of 3-D differences).
    pub error: HorizonError,
    /// Errors expected of a perfect model: the sensors' noise at start and end, propagated through the model.
    pub expected: HorizonError,
    /// Errors over the expected ones: position, velocity, attitude, rate. Null where attitude is an input.
    pub times_expected: [Option<f64>; 4],
    /// Errors over the noise of one sample per channel (position, attitude; body rate where there is a gyroscope), as
    /// lengths: √3 times that of an axis. Null where there is no such sensor.
    pub times_sample_noise: [Option<f64>; 4],
}

/// A closed-loop simulation of the model with its controller along the logged references.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ClosedLoop {
    /// Length, s.
    pub duration_s: f64,
    /// Root-mean-square distance of the simulated flight from the measured one, m.
    pub position_m: f64,
    /// The same of velocities, m/s.
    pub velocity_m_s: f64,
    /// Root-mean-square distance of the measured flight from the references, m.
    pub tracking_measured_m: f64,
    /// Root-mean-square distance of the simulated flight from the references, m.
    pub tracking_model_m: f64,
    /// What was assumed.
    pub notes: Vec<String>,
}

/// A segment of a flight.
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
    /// Operating conditions: name, mean, unit.
    pub context: Vec<(String, f64, String)>,
    /// What was unusual about it, in words.
    pub text: String,
}

/// One log against the model.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LogComparison {
    /// Name, hash, drive, length, noise.
    #[serde(flatten)]
    pub log: LogSummary,
    /// Messages of the checker and the preparation.
    pub warnings: Vec<String>,
    /// One step: residual force and torque.
    pub one_step: OneStep,
    /// Short roll-outs.
    pub horizons: Vec<Horizon>,
    /// Whole flight; null where the log or the vehicle does not allow it.
    pub closed_loop: Option<ClosedLoop>,
    /// Why there is no closed-loop simulation.
    pub closed_loop_missing: Option<String>,
    /// Worst segments, worst first.
    pub worst: Vec<Segment>,
    /// Residual against possible causes.
    pub causes: Vec<Cause>,
    /// Sentences about the strongest dependences, strongest first.
    pub findings: Vec<String>,
    /// Why the file's rotors cannot be those of the log (their order, their spins, another vehicle); null where they can.
    pub other_rotors: Option<String>,
    /// Largest error over the noise level, over all channels and horizons and residual force and torque.
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
    /// Sentences about the strongest dependences, strongest first.
    pub findings: Vec<String>,
}

/// Result of comparing a model with flights.
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
    /// Threshold of agreement, multiples of the noise.
    pub threshold: f64,
    /// Whether the model agrees with every log.
    pub agrees: bool,
    /// If it does not agree: whether parameter changes within the vehicle's tolerances explain the residual, so that no
    /// effect is missing; null where it agrees, or where the logs are too short to tell.
    pub within_tolerance: Option<bool>,
    /// One sentence.
    pub verdict: String,
}

impl Comparison {
    /// Whether no effect is missing: the model agrees, or it is only off by parameters within their tolerances. As in a
    /// diagnosis, but by its first steps only.
    pub fn nothing_missing(&self) -> bool {
        self.agrees || self.within_tolerance == Some(true)
    }
}

/// Compares a vehicle with flights.
///
/// # Errors
/// [`GapError::Log`] without any log, [`GapError::TooShort`] where too little of one is usable,
/// [`GapError::DifferentVehicles`] where the logs cannot be of one vehicle, [`GapError::Numbers`] where the model does not
/// stay finite.
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
    let inputs: Vec<Inputs> =
        tracks.par_iter().map(|track| Inputs::new(track, vehicle)).collect::<Result<_, _>>()?;
    let replayed: Vec<Replayed> = tracks
        .par_iter()
        .zip(&inputs)
        .map(|(track, inputs)| Replayed::new(track, inputs, vehicle))
        .collect::<Result<_, _>>()?;
    let departs = replayed.iter().any(|r| !r.agrees) && replayed.iter().all(|r| r.other_rotors.is_none());
    let (within_tolerance, parts): (_, Vec<Part>) = rayon::join(
        // A failed fit does not invalidate the comparison itself.
        || departs.then(|| within_tolerance(tracks, &inputs, vehicle).ok().flatten()).flatten(),
        || replayed.into_par_iter().map(|r| r.compared(vehicle)).collect(),
    );
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

/// Comparison of one log, with what pooling needs.
type Part = (LogComparison, Vec<Block>, Vec<Label>);

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
