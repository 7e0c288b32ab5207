//! A flight with the residuals of a vehicle and of its variants.

use super::proposals::Move;
use super::{Change, LiveCause, LiveFlight, NO_CHANGE, Path, Poses};
use crate::GapError;
use crate::compare::{Context, context};
use crate::ghost::{Ghost, ghost};
use crate::judge::{Stretch, settling_s};
use crate::model::Model;
use crate::policy::BAND_S;
use crate::replay::{Around, Context as Shared, Inputs, Raw, STEP, STEP_S};
use crate::residual::{Replay, Residuals, Sample};
use crate::track::Track;
use propwash_physics::drone::Drone;
use propwash_vehicle::Vehicle;
use serde::Serialize;
use std::sync::Arc;

/// Steps between points of a path.
const PATH_EVERY: usize = 10;
/// Length of the simulations that restart from the measurement, s.
const RESTART_S: f64 = 0.5;

/// Residuals on the grid of a flight; NaN where unknown.
#[derive(Clone, Debug, Default)]
pub(crate) struct Evaluated {
    /// N, body, shape (sample, 3).
    pub force_n: Vec<[f64; 3]>,
    /// N·m, body, shape (sample, 3); empty where the drive carries no torques.
    pub torque_n_m: Vec<[f64; 3]>,
}

impl Evaluated {
    fn with(&self, other: &Self, of: impl Fn(f64, f64) -> f64) -> Self {
        let join = |a: &[[f64; 3]], b: &[[f64; 3]]| -> Vec<[f64; 3]> {
            a.iter().zip(b).map(|(a, b)| std::array::from_fn(|k| of(a[k], b[k]))).collect()
        };
        Self {
            force_n: join(&self.force_n, &other.force_n),
            torque_n_m: join(&self.torque_n_m, &other.torque_n_m),
        }
    }

    /// What it has more than the filed vehicle; zero where either is unknown.
    pub fn minus(&self, filed: &Self) -> Self {
        self.with(filed, |a, b| if (a - b).is_finite() { a - b } else { 0.0 })
    }

    pub fn plus(&self, change: &Self, share: f64) -> Self {
        self.with(change, |a, b| a + share * b)
    }
}

/// A flight prepared for many evaluations.
pub(crate) struct Flight {
    pub track: Arc<Track>,
    around: Arc<Around>,
    raw: Arc<Raw>,
    /// Numbers of the samples' spans of [`BAND_S`].
    numbers: Vec<usize>,
    pub t_s: Vec<f64>,
    /// Whether a sample is on the judged flight.
    pub judged: Vec<bool>,
    pub filed: Evaluated,
    pub force_sigma_n: [f64; 3],
    pub torque_sigma_n_m: [f64; 3],
    causes: Vec<LiveCause>,
}

/// Root mean squares by body axis over the instants of a flight.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Axes {
    /// N.
    pub force_n: [f64; 3],
    /// N·m; null where the drive carries no torques.
    pub torque_n_m: Option<[f64; 3]>,
    /// Number of instants, 5 ms apart.
    pub n: usize,
}

impl From<Ghost> for Poses {
    fn from(g: Ghost) -> Self {
        Self { t_s: g.t_s, pos: g.pos_m, quat: g.quat_xyzw }
    }
}

/// Steps in a span.
fn per() -> usize {
    (BAND_S / STEP_S).round() as usize
}

impl Flight {
    /// The residuals of a vehicle on a flight that is judged from a time on, s.
    pub fn new(track: Arc<Track>, judged_from_s: f64, vehicle: &Vehicle) -> Result<Self, GapError> {
        let Inputs { drone, around, raw } = Inputs::new(&track, vehicle)?;
        let replay = Replay::new(&track, &around, &raw, &drone);
        let seen = stretch(&replay);
        let middle = |number: &usize| replay.time_s(number * per() + per() / 2);
        let t_s: Vec<f64> = seen.numbers.iter().map(middle).collect();
        let causes = causes(&context(&replay), &seen.numbers);
        let judged = t_s.iter().map(|t| *t >= judged_from_s).collect();
        drop(replay);
        Ok(Self {
            track,
            around,
            raw,
            t_s,
            judged,
            filed: on(&seen, &seen.numbers),
            force_sigma_n: seen.force_sigma_n,
            torque_sigma_n_m: seen.torque_sigma_n_m,
            causes,
            numbers: seen.numbers,
        })
    }

    /// The residuals with some parameters at other values.
    pub fn with(&self, model: &Model, moves: &[Move]) -> Evaluated {
        self.looked(&model.moved(moves.iter().map(|m| (m.parameter, m.value)))).0
    }

    fn looked(&self, drone: &Drone<f64>) -> (Evaluated, (Residuals, f64)) {
        // What hangs on a cable depends on the vehicle.
        let around = match self.around.cable {
            Some(_) => Shared::of(&self.track, drone).around,
            None => self.around.clone(),
        };
        let replay = Replay::new(&self.track, &around, &self.raw, drone);
        let residuals = Residuals::new(&replay);
        let [from, to] = self.settled_s();
        let seen = Stretch::new(&replay, &residuals, [from, to]);
        (on(&seen, &self.numbers), (residuals, from))
    }

    /// The span that is judged at all, s: motors have settled.
    fn settled_s(&self) -> [f64; 2] {
        let [from, to] = self.track.span_s;
        [from + settling_s(&self.track), to]
    }

    /// The residuals of a vehicle on the spans, and its root mean squares of force (N) and torque (N·m) by body axis over all
    /// instants within `window_s` after the motors have settled, as a comparison has them.
    pub fn exact(&self, drone: &Drone<f64>, window_s: [f64; 2]) -> (Evaluated, Axes) {
        let (seen, (residuals, from_s)) = self.looked(drone);
        let time_s = |step: usize| self.around.time_s(step * STEP);
        let inside = |step: usize| {
            let t = time_s(step);
            t >= from_s && t >= window_s[0] && t <= window_s[1]
        };
        let list: Vec<&Sample> = residuals.samples.iter().filter(|s| inside(s.step)).collect();
        let mut axes = Axes { n: list.len(), ..Axes::default() };
        let turned: Vec<[f64; 3]> = list.iter().filter_map(|s| s.torque_n_m).collect();
        for k in 0..3 {
            let force: f64 = list.iter().map(|s| s.force_n[k].powi(2)).sum();
            axes.force_n[k] = (force / list.len().max(1) as f64).sqrt();
        }
        axes.torque_n_m = (!turned.is_empty()).then(|| {
            std::array::from_fn(|k| {
                (turned.iter().map(|t| t[k] * t[k]).sum::<f64>() / turned.len() as f64).sqrt()
            })
        });
        (seen, axes)
    }

    /// Whether a change of force, and one of torque, is more than nothing.
    fn of_channels(&self, change: &Evaluated) -> [bool; 2] {
        let rms = |list: &[[f64; 3]]| {
            let sum: f64 = list.iter().flatten().map(|v| v * v).sum();
            (sum / list.len().max(1) as f64).sqrt()
        };
        let size = |sigma: [f64; 3]| sigma.iter().map(|s| s * s).sum::<f64>().sqrt();
        [
            rms(&change.force_n) > NO_CHANGE * size(self.force_sigma_n),
            rms(&change.torque_n_m) > NO_CHANGE * size(self.torque_sigma_n_m),
        ]
    }

    /// Whether a change is more than nothing.
    pub fn acts(&self, change: &Evaluated) -> bool {
        self.of_channels(change).contains(&true)
    }

    /// Number of channels (force, torque) that a change needs.
    pub fn channels(&self, change: &Evaluated) -> usize {
        self.of_channels(change).into_iter().filter(|c| *c).count()
    }

    /// For the page: every `stride`-th sample.
    pub fn live(&self, which: usize, changes: &[&Vec<Evaluated>], stride: usize) -> LiveFlight {
        let thin = |list: &[[f64; 3]]| list.iter().step_by(stride).copied().collect::<Vec<_>>();
        LiveFlight {
            log: self.track.name.clone(),
            t_s: self.t_s.iter().step_by(stride).copied().collect(),
            judged: self.judged.iter().step_by(stride).copied().collect(),
            force_n: thin(&self.filed.force_n),
            torque_n_m: thin(&self.filed.torque_n_m),
            force_sigma_n: self.force_sigma_n,
            torque_sigma_n_m: self.torque_sigma_n_m,
            changes: self.changes(which, changes, stride),
            causes: self
                .causes
                .iter()
                .map(|c| LiveCause {
                    values: c.values.iter().step_by(stride).copied().collect(),
                    ..c.clone()
                })
                .collect(),
            path: Path::default(),
        }
    }

    /// Changes of flight `which`, of every `stride`-th sample.
    pub fn changes(&self, which: usize, changes: &[&Vec<Evaluated>], stride: usize) -> Vec<Change> {
        let thin = |list: &[[f64; 3]]| list.iter().step_by(stride).copied().collect::<Vec<_>>();
        let change = |c: &&Vec<Evaluated>| {
            let c = &c[which];
            let [force, torque] = self.of_channels(c);
            Change {
                force_n: if force { thin(&c.force_n) } else { Vec::new() },
                torque_n_m: if torque { thin(&c.torque_n_m) } else { Vec::new() },
            }
        };
        changes.iter().map(change).collect()
    }

    /// The measured path, of about `most` points, with the simulations of one or two vehicles that restart from it.
    pub fn path(&self, before: &Vehicle, after: Option<&Vehicle>, most: usize) -> Result<Path, GapError> {
        let known: Vec<usize> =
            (0..self.around.measured.len()).filter(|i| self.around.measured[*i].is_some()).collect();
        let every = PATH_EVERY * (known.len() / PATH_EVERY).div_ceil(most.max(1)).max(1);
        let sample_s = every as f64 * STEP_S;
        let mut measured = Poses::default();
        for i in known.into_iter().step_by(every) {
            let Some(m) = &self.around.measured[i] else { continue };
            measured.t_s.push(self.around.time_s(i * STEP));
            measured.pos.push(m.pos);
            measured.quat.push(m.quat);
        }
        let poses = |v: &Vehicle| Ok(Poses::from(ghost(&self.track, v, RESTART_S, sample_s)?));
        let (before, after) = rayon::join(|| poses(before), || after.map(poses).transpose());
        Ok(Path { measured, before: before?, after: after?.unwrap_or_default(), restart_s: RESTART_S })
    }
}

/// Residuals after the motors have settled, in spans of [`BAND_S`].
fn stretch(replay: &Replay) -> Stretch {
    let [from, to] = replay.track.span_s;
    Stretch::new(replay, &Residuals::new(replay), [from + settling_s(replay.track), to])
}

/// Residuals at the spans of another evaluation.
fn on(seen: &Stretch, numbers: &[usize]) -> Evaluated {
    let nothing = [f64::NAN; 3];
    let place = |number: &usize| seen.numbers.binary_search(number).ok();
    let torques = seen.torque_n_m.iter().any(Option::is_some);
    Evaluated {
        force_n: numbers.iter().map(|n| place(n).map_or(nothing, |i| seen.force_n[i])).collect(),
        torque_n_m: numbers
            .iter()
            .take(if torques { numbers.len() } else { 0 })
            .map(|n| place(n).and_then(|i| seen.torque_n_m[i]).unwrap_or(nothing))
            .collect(),
    }
}

/// Operating conditions in the spans.
fn causes(context: &Context, numbers: &[usize]) -> Vec<LiveCause> {
    let mean = |values: &[f64], number: usize| {
        let part = &values[(number * per()).min(values.len())..((number + 1) * per()).min(values.len())];
        let finite: Vec<f64> = part.iter().copied().filter(|v| v.is_finite()).collect();
        if finite.is_empty() { f64::NAN } else { finite.iter().sum::<f64>() / finite.len() as f64 }
    };
    context
        .labels
        .iter()
        .zip(&context.values)
        .map(|((name, title, unit), values)| LiveCause {
            name: name.clone(),
            title: title.clone(),
            unit: (*unit).into(),
            values: numbers.iter().map(|n| mean(values, *n)).collect(),
        })
        .collect()
}
