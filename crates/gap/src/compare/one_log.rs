//! Compares one log with the model.

use super::closed_loop::closed_loop;
use super::context::{blocks, context};
use super::one_step::one_step;
use super::worst::worst;
use super::{AGREE, HORIZONS_S, Horizon, LogComparison, OneStep, Part, Segment, cause_list, sentences};
use crate::causes::short;
use crate::judge::settling_s;
use crate::replay::Inputs;
use crate::residual::{self, Replay, Residuals};
use crate::track::{Drive, Track};
use crate::verdict::{HorizonError, LogSummary};
use crate::{GapError, constants, integration, wiring};
use propwash_vehicle::Vehicle;

/// Fewest roll-outs for a verdict.
const FEWEST: usize = 5;

/// A log replayed: how far the model is off, without what it goes with.
pub(super) struct Replayed<'a> {
    replay: Replay<'a>,
    residuals: Residuals,
    one_step: OneStep,
    horizons: Vec<Horizon>,
    /// Largest error over the noise level, and where it is.
    worst_times_noise: f64,
    place: String,
    /// Whether that is at most [`AGREE`].
    pub agrees: bool,
    /// Why the file's rotors cannot be those of the log.
    pub other_rotors: Option<String>,
}

impl<'a> Replayed<'a> {
    pub(super) fn new(track: &'a Track, inputs: &'a Inputs, vehicle: &Vehicle) -> Result<Self, GapError> {
        let Inputs { drone, around, raw } = inputs;
        let replay = Replay::new(track, around, raw, drone);
        let (mut residuals, horizons) = rayon::join(|| Residuals::new(&replay), || horizons(&replay));
        residuals.samples.retain(|s| replay.time_s(s.step) >= settled(&replay)[0]);
        enough(track, &residuals, &horizons)?;
        stays_finite(track, vehicle, &horizons)?;
        let one_step = one_step(&replay, &residuals);
        let (worst_times_noise, place) = most(&one_step, &horizons);
        let agrees = worst_times_noise <= AGREE;
        let mismatch = (!agrees).then(|| wiring::mismatch(track, around, raw, drone)).flatten();
        let other_rotors = mismatch.map(|m| format!("the log has {}; {}; {}", m.found, m.remedy, m.numbers));
        Ok(Self { replay, residuals, one_step, horizons, worst_times_noise, place, agrees, other_rotors })
    }

    /// The comparison: with the whole flight, the worst segments and what the residuals go with.
    pub(super) fn compared(self, vehicle: &Vehicle) -> Part {
        let Self { replay, residuals, one_step, horizons, worst_times_noise, place, agrees, other_rotors } =
            self;
        let track = replay.track;
        let ((context, blocks, causes), flown) = rayon::join(
            || {
                let context = context(&replay);
                let blocks = blocks(&replay, &residuals, &context);
                let causes = cause_list(&blocks, &context.labels, false);
                (context, blocks, causes)
            },
            || closed_loop(&replay, vehicle),
        );
        // Constant residuals first: they dominate the roll-outs, and no varying cause explains them.
        let build = constants::Build::of(&replay.plant().parts);
        let mut findings = constants::sentences(&one_step, &build, &causes);
        findings.extend(sentences(&causes));
        let worst = worst(&replay, &residuals, &context);
        let (closed_loop, closed_loop_missing) = match flown {
            Ok(flown) => (Some(flown), None),
            Err(why) => (None, Some(why)),
        };
        findings.splice(..0, other_rotors.clone());
        let verdict = if agrees {
            format!(
                "the model agrees with the log: nothing is off by more than {worst_times_noise:.1} times what the \
                 sensors' noise makes (threshold {AGREE})"
            )
        } else {
            departs((worst_times_noise, &place), other_rotors.as_deref(), &findings, &worst)
        };
        let comparison = LogComparison {
            log: summary(track),
            warnings: track.warnings.clone(),
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
        (comparison, blocks, context.labels)
    }
}

/// Refuses a log with too few instants and roll-outs for a verdict.
fn enough(track: &Track, residuals: &Residuals, horizons: &[Horizon]) -> Result<(), GapError> {
    if residuals.samples.len() >= 50 && horizons[0].error.n >= FEWEST {
        return Ok(());
    }
    Err(GapError::TooShort {
        log: track.name.clone(),
        expected: format!("stretches of at least {} s with pose and {}", HORIZONS_S[0], track.drive.title()),
        found: format!(
            "{} instants and {} roll-outs that can be used",
            residuals.samples.len(),
            horizons[0].error.n
        ),
        remedy: "look at the gaps that `propwash log check` names, or give another log".into(),
    })
}

/// Refuses a model whose roll-outs diverge.
fn stays_finite(track: &Track, vehicle: &Vehicle, horizons: &[Horizon]) -> Result<(), GapError> {
    let finite =
        |e: &HorizonError| (e.position_m + e.velocity_m_s + e.attitude_rad + e.rate_rad_s).is_finite();
    if horizons.iter().all(|h| finite(&h.error) && finite(&h.expected)) {
        return Ok(());
    }
    Err(GapError::Numbers {
        what: "roll-outs",
        reason: format!(
            "with {} the model of `{}` does not stay finite on {}: check the vehicle file's values",
            track.drive.title(),
            vehicle.name,
            track.name
        ),
    })
}

/// Verdict on a model that is off: by how many times the noise, in what, why and when.
fn departs(
    (times_noise, place): (f64, &str),
    other_rotors: Option<&str>,
    findings: &[String],
    worst: &[Segment],
) -> String {
    let mut text = format!(
        "the model departs from the log: {place}, {} times what the sensors' noise makes (threshold {AGREE})",
        short(times_noise)
    );
    if let Some(other) = other_rotors {
        text = format!("{other}; {text}");
    } else if let Some(first) = findings.first() {
        text = format!("{text}; {first}");
    }
    if let Some(segment) = worst.first() {
        text = format!("{text}; worst from {:.1} to {:.1} s", segment.from_s, segment.to_s);
    }
    text
}

fn summary(track: &Track) -> LogSummary {
    LogSummary {
        name: track.name.clone(),
        sha256: track.log.sha256.clone(),
        duration_s: track.duration_s(),
        drive: track.drive.title().into(),
        noise: track.noise,
        held_out: false,
    }
}

/// The span of a log in which the modelled motors have settled, s.
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
    // Errors of the simulated flight's own integrator are no fault of the vehicle.
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
