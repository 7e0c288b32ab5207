//! Residuals of specific force and angular acceleration at every instant of a log, and their derivatives by every
//! parameter.

use super::super::drive_slopes::{DriveInputs, drive_inputs};
use super::super::fit::{Prepared, Wide, passes};
use super::super::model::Model;
use super::super::replay::{Plant, STEP, STEP_S, Tick, clock};
use super::super::residual::Replay;
use super::super::track::{Drive, Measured};
use super::CHANNELS;
use propwash_flight::resample::{self, rotation_vector};
use propwash_physics::rigid_body::State;
use propwash_trace::Real;
use propwash_trace::math::{quat, vec3};
use rayon::prelude::*;

/// Steps of a roll-out between two instants, 20 ms: six per period of the fastest band.
const EVERY: usize = 4;
/// Steps between the nodes at which [`drive_inputs`] gives derivatives.
const DRIVE_EVERY: usize = 2;
/// Time between two instants, s.
pub(super) const EVERY_S: f64 = STEP_S * EVERY as f64;
/// Longest gap that is interpolated linearly for the filter, s; well below the period of the band.
const BRIDGED_S: f64 = 0.1;
/// Specific force over gravity that the rotors must give where more than [`HELD_UP`] is felt: otherwise something else
/// holds the vehicle up (ground, a hand), and its force is not an effect of flight.
const FLYING: f64 = 0.3;
/// See [`FLYING`].
const HELD_UP: f64 = 0.7;
/// Time around such an instant that is excluded too, s: falling with the motors off, the impact, and jumps after it.
const BESIDE_GROUND_S: f64 = 0.5;

/// Derivative times plausible size, m/s² or rad/s², below which a parameter does not act on a channel: rounding.
const LEAST_SLOPE: f64 = 1e-9;

/// Regression rows of a log: [derivatives by parameter … | residual] for each channel, [`EVERY_S`] apart.
pub(super) struct Samples {
    /// Columns, (channel, parameter); the parameter is `usize::MAX` for the residual.
    pub columns: Vec<(usize, usize)>,
    /// Row after row.
    pub rows: Vec<f64>,
    /// Whether a row was fully measured.
    pub measured: Vec<bool>,
    /// Ranges of rows without a long gap: from, to (not included).
    pub stretches: Vec<(usize, usize)>,
}

/// Column of the residual.
pub(super) const RESIDUAL: usize = usize::MAX;

impl Samples {
    /// From a log, at parameter values `values` with the effects of `chosen` active; derivatives by the parameters `by`
    /// only.
    pub fn new(log: &Prepared, model: &Model, values: &[f64], chosen: &[usize], by: &[usize]) -> Self {
        let drone = model.plain_at(values, chosen);
        let replay = Replay::new(log.track, &log.around, &log.raw, &drone);
        let (residual, inputs) = rayon::join(
            || residuals(&replay),
            || drive_inputs(log, model, values, chosen, std::slice::from_ref(&(0..log.around.n_ticks))),
        );
        let slopes = slopes(log, &replay, model, &inputs, (values, chosen), by);
        let torques = log.track.drive != Drive::Thrust;
        let channels = if torques { CHANNELS } else { 3 };

        let mut columns = Vec::new();
        for channel in 0..channels {
            columns.push((channel, RESIDUAL));
            for (slot, k) in by.iter().enumerate() {
                let slab = model.parameters[*k].slab;
                if slopes.iter().flatten().any(|s| (slab * s[slot][channel]).abs() > LEAST_SLOPE) {
                    columns.push((channel, *k));
                }
            }
        }
        let width = columns.len();
        let n = residual.len();
        let mut rows = vec![0.0; n * width];
        let mut measured = vec![false; n];
        let slot_of = |k: usize| by.iter().position(|b| *b == k);
        let slots: Vec<Option<usize>> = columns.iter().map(|(_, k)| slot_of(*k)).collect();
        for i in 0..n {
            let (Some(left), Some(slope)) = (&residual[i], &slopes[i]) else { continue };
            let row = &mut rows[i * width..(i + 1) * width];
            for ((value, (channel, _)), slot) in row.iter_mut().zip(&columns).zip(&slots) {
                *value = slot.map_or(left[*channel], |slot| slope[slot][*channel]);
            }
            measured[i] = row.iter().all(|x| x.is_finite());
        }
        let stretches = bridge(&mut rows, width, &measured);
        Self { columns, rows, measured, stretches }
    }
}

/// Fills short gaps linearly; returns the ranges between long ones.
fn bridge(rows: &mut [f64], width: usize, measured: &[bool]) -> Vec<(usize, usize)> {
    let longest = (BRIDGED_S / EVERY_S).round() as usize;
    let mut out: Vec<(usize, usize)> = Vec::new();
    for i in (0..measured.len()).filter(|i| measured[*i]) {
        match out.last_mut() {
            Some((_, to)) if i - *to <= longest => {
                let (before, hole) = (*to - 1, i - *to);
                for h in 0..hole {
                    let f = (h + 1) as f64 / (hole + 1) as f64;
                    for c in 0..width {
                        let (a, b) = (rows[before * width + c], rows[i * width + c]);
                        rows[(before + 1 + h) * width + c] = a + f * (b - a);
                    }
                }
                *to = i + 1;
            }
            _ => out.push((i, i + 1)),
        }
    }
    out
}

fn state_of(m: &Measured) -> State<f64> {
    State { pos: m.pos, quat: m.quat, vel: m.vel, ang_vel: m.ang_vel, ..State::rest() }
}

/// The measured state of a step at which the inputs are known too.
fn known<'a>(replay: &'a Replay, step: usize) -> Option<&'a Measured> {
    let valid = replay.raw.valid.get(step * STEP).copied().unwrap_or(false);
    replay.around.measured.get(step)?.as_ref().filter(|_| valid)
}

/// Offsets and weights of a hat function that falls to zero `apart` away: a second difference over `apart` sees the mean of
/// the second derivative under it. All compared quantities are averaged under it, so that nothing above the band aliases
/// into it.
fn hat(apart: usize) -> impl Iterator<Item = (usize, f64)> {
    let square = (apart * apart) as f64;
    (1..2 * apart).map(move |i| (i, (apart - i.abs_diff(apart)) as f64 / square))
}

/// Mean under the hat over an instant; `None` where a neighbour is missing.
fn under_hat(list: &[Option<[f64; 3]>], step: usize) -> Option<[f64; 3]> {
    let from = step.checked_sub(EVERY)?;
    let mut sum = [0.0; 3];
    for (offset, weight) in hat(EVERY) {
        let value = list.get(from + offset)?.as_ref()?;
        (0..3).for_each(|k| sum[k] += weight * value[k]);
    }
    Some(sum)
}

/// Mean of the inputs under the same hat.
fn input_under_hat(ticks: &[Tick<f64>], at: usize) -> Tick<f64> {
    let apart = EVERY * STEP;
    let mut out = Tick::zero();
    for (offset, weight) in hat(apart) {
        let tick = &ticks[(at + offset).saturating_sub(apart).min(ticks.len() - 1)];
        out = out.with(tick, |sum, x| sum + weight * x);
    }
    out
}

/// Measured minus modelled specific force (m/s², body) and angular acceleration (rad/s², body) at every instant.
fn residuals(replay: &Replay) -> Vec<Option<[f64; CHANNELS]>> {
    let (track, drone) = (replay.track, replay.drone);
    let plant = replay.plant();
    let n = replay.n_steps();
    let gravity = plant.parts.body.gravity_m_s2;
    let modelled: Vec<Option<([f64; 3], [f64; 3])>> = (0..n)
        .into_par_iter()
        .with_min_len(256)
        .map_init(Vec::new, |neighbours, i| {
            let mut state = state_of(known(replay, i)?);
            let rate = plant.rate(i * STEP, &replay.ticks[i * STEP], &mut state, neighbours);
            Some((drone.read(&state, &rate).accel, rate.ang_acc))
        })
        .collect();
    let force: Vec<Option<[f64; 3]>> = modelled.iter().map(|m| m.map(|m| m.0)).collect();
    let torque: Vec<Option<[f64; 3]>> = modelled.iter().map(|m| m.map(|m| m.1)).collect();
    let accel: Option<Vec<Option<[f64; 3]>>> = (!track.accel.is_empty()).then(|| {
        let period = track.accel.period_s().unwrap_or(0.01);
        let late = clock(track, drone).accel_s;
        let at: Vec<f64> = (0..n).map(|i| replay.time_s(i) + late).collect();
        at.par_chunks(512)
            .flat_map_iter(|at| {
                resample::local_parabola(&track.accel, at, 0.0125f64.max(3.2 * period))
                    .into_iter()
                    .map(|l| l.map(|l| l.value))
            })
            .collect()
    });
    let mut held = Vec::new();
    let mut out: Vec<Option<[f64; CHANNELS]>> = (0..n)
        .step_by(EVERY)
        .map(|i| {
            let (model, turning) = (under_hat(&force, i)?, under_hat(&torque, i)?);
            let felt = match &accel {
                Some(accel) => under_hat(accel, i)?,
                None => felt_by_positions(replay, i, gravity)?,
            };
            let of_gravity = vec3::norm(gravity).max(1e-9);
            if vec3::norm(model) < FLYING * of_gravity && vec3::norm(felt) > HELD_UP * of_gravity {
                held.push(i / EVERY);
                return None;
            }
            let turned = match track.drive {
                Drive::Thrust => [0.0; 3],
                _ if track.gyro.is_empty() => turned_by_attitudes(replay, i)?,
                _ => turned_by_rates(replay, i)?,
            };
            let (f, t) = (vec3::sub(felt, model), vec3::sub(turned, turning));
            Some([f[0], f[1], f[2], t[0], t[1], t[2]])
        })
        .collect();
    let beside = (BESIDE_GROUND_S / EVERY_S).round() as usize;
    for at in held {
        let to = (at + beside + 1).min(out.len());
        out[at.saturating_sub(beside)..to].fill(None);
    }
    out
}

/// Specific force from the second difference of positions.
fn felt_by_positions(replay: &Replay, i: usize, gravity: [f64; 3]) -> Option<[f64; 3]> {
    let at = |i: usize| known(replay, i).map(|m| m.pos);
    let (a, b, c) = (at(i.checked_sub(EVERY)?)?, at(i)?, at(i + EVERY)?);
    let acc: [f64; 3] =
        core::array::from_fn(|k| (a[k] - 2.0 * b[k] + c[k]) / (EVERY_S * EVERY_S) - gravity[k]);
    Some(quat::rotate_inverse(known(replay, i)?.quat, acc))
}

/// Weights of Simpson's rule for the mean over the [`EVERY`] steps after an instant.
const SIMPSON: [f64; EVERY + 1] = [1.0 / 12.0, 4.0 / 12.0, 2.0 / 12.0, 4.0 / 12.0, 1.0 / 12.0];

/// Angular acceleration as the difference of the mean rates after and before an instant.
fn turned_by_rates(replay: &Replay, i: usize) -> Option<[f64; 3]> {
    let from = i.checked_sub(EVERY)?;
    let mut sum = [0.0; 3];
    for (j, weight) in SIMPSON.iter().enumerate() {
        let (before, after) = (known(replay, from + EVERY - j)?, known(replay, i + j)?);
        (0..3).for_each(|k| sum[k] += weight * (after.ang_vel[k] - before.ang_vel[k]) / EVERY_S);
    }
    Some(sum)
}

/// Angular acceleration from the rotations to the next and from the previous instant.
fn turned_by_attitudes(replay: &Replay, i: usize) -> Option<[f64; 3]> {
    let q = |i: usize| known(replay, i).map(|m| m.quat);
    let (a, b, c) = (q(i.checked_sub(EVERY)?)?, q(i)?, q(i + EVERY)?);
    let turn = |a, b| rotation_vector(quat::mul(quat::conjugate(a), b));
    Some(vec3::scale(vec3::sub(turn(b, c), turn(a, b)), 1.0 / (EVERY_S * EVERY_S)))
}

/// Derivatives at every instant: (parameter of `by`, channel).
fn slopes(
    log: &Prepared,
    replay: &Replay,
    model: &Model,
    inputs: &DriveInputs,
    (values, chosen): (&[f64], &[usize]),
    by: &[usize],
) -> Vec<Option<Vec<[f64; CHANNELS]>>> {
    let mut passes = passes(model, values, chosen);
    // Passes of sensor outputs come last: those without a wanted parameter are skipped.
    passes.retain(|p| p.parameters.iter().any(|k| by.contains(k)));
    let plants: Vec<(&[usize], Plant<Wide>)> = passes
        .iter()
        .map(|p| (p.parameters.as_slice(), Plant::new(&p.drone, log.track, &replay.around)))
        .collect();
    let place = |k: &usize| by.iter().position(|b| b == k);
    let places: Vec<Vec<Option<usize>>> =
        plants.iter().map(|(list, _)| list.iter().map(place).collect()).collect();
    let lit = |v: [f64; 3]| v.map(Wide::lit);
    (0..replay.n_steps().div_ceil(EVERY))
        .into_par_iter()
        .with_min_len(64)
        .map_init(Vec::new, |neighbours, node| {
            let step = node * EVERY;
            let m = known(replay, step)?;
            let tick = input_under_hat(&replay.ticks, step * STEP).map(Wide::lit);
            let mut out = vec![[0.0; CHANNELS]; by.len()];
            for ((parameters, plant), places) in plants.iter().zip(&places) {
                let mut state = State::<Wide> {
                    pos: lit(m.pos),
                    quat: m.quat.map(Wide::lit),
                    vel: lit(m.vel),
                    ang_vel: lit(m.ang_vel),
                    ..State::rest()
                };
                let driven = inputs.by(parameters, &tick, step / DRIVE_EVERY);
                let rate = plant.rate(step * STEP, &driven, &mut state, neighbours);
                let accel = plant.drone.read(&state, &rate).accel;
                for (slot, place) in places.iter().enumerate() {
                    let Some(place) = *place else { continue };
                    for r in 0..3 {
                        out[place][r] = accel[r].partials[slot];
                        out[place][3 + r] = rate.ang_acc[r].partials[slot];
                    }
                }
            }
            Some(out)
        })
        .collect()
}
