//! Errors of short roll-outs from measured states, and the errors that sensor noise alone would cause.

use super::{Replay, StateNoise, input_noise};
use crate::replay::{Point, STEP, STEP_S, TICK_S};
use crate::track::{Drive, Measured};
use crate::verdict::HorizonError;
use propwash_flight::resample;
use propwash_physics::rigid_body::State;
use propwash_rollout::random::{Key, purpose};
use propwash_trace::math::{quat, vec3};
use rayon::prelude::*;

/// Steps between the starts of roll-outs: 0.1 s.
const START_EVERY: usize = 20;
/// Starts for which the effect of sensor noise is computed.
const NOISE_STARTS: usize = 16;

/// Roll-outs along a log and the measurements at their ends.
struct Starts<'a> {
    replay: &'a Replay<'a>,
    /// Length of each horizon in steps.
    steps: Vec<usize>,
    /// Cumulative number of instants that a roll-out cannot cross.
    holes: Vec<usize>,
}

impl<'a> Starts<'a> {
    fn new(replay: &'a Replay<'a>, horizons_s: &[f64]) -> Self {
        let raw = &replay.raw.valid;
        let mut holes = vec![0];
        for i in 0..replay.n_steps() {
            let inputs = (i * STEP..(i + 1) * STEP).all(|k| raw.get(k).copied().unwrap_or(false));
            let pose = replay.track.drive != Drive::Thrust || replay.around.measured[i].is_some();
            // The last instant of a roll-out needs no input after it; its own tick is checked together with the
            // measurement.
            holes.push(holes[i] + usize::from(!(inputs && pose)));
        }
        let steps = horizons_s.iter().map(|h| ((h / STEP_S).round() as usize).max(1)).collect();
        Self { replay, steps, holes }
    }

    /// Indices of the horizons that can be rolled out from step `i` within the segments.
    fn reach(&self, i: usize, segments: Option<&[[f64; 2]]>) -> Vec<usize> {
        if self.replay.known(i).is_none() {
            return Vec::new();
        }
        let (n, time) = (self.replay.n_steps(), |k: usize| self.replay.time_s(k));
        (0..self.steps.len())
            .filter(|h| {
                let end = i + self.steps[*h];
                end < n
                    && self.holes[end] == self.holes[i]
                    && self.replay.known(end).is_some()
                    && segments.is_none_or(|list| {
                        list.iter().any(|s| time(i) >= s[0] - 1e-9 && time(end) <= s[1] + 1e-9)
                    })
            })
            .collect()
    }
}

/// Squared lengths of the differences (position, velocity, attitude, rate) of two states.
fn squares(a: &State<f64>, b: &Measured) -> [f64; 4] {
    let d = |a: [f64; 3], b: [f64; 3]| {
        let d = vec3::sub(a, b);
        vec3::dot(d, d)
    };
    let turn = resample::rotation_vector(quat::mul(quat::conjugate(b.quat), a.quat));
    [d(a.pos, b.pos), d(a.vel, b.vel), vec3::dot(turn, turn), d(a.ang_vel, b.ang_vel)]
}

fn finish(horizons_s: &[f64], sums: &[[f64; 4]], counts: &[usize]) -> Vec<HorizonError> {
    horizons_s
        .iter()
        .zip(sums)
        .zip(counts)
        .map(|((h, s), n)| {
            let [position_m, velocity_m_s, attitude_rad, rate_rad_s] =
                s.map(|s| if *n > 0 { (s / *n as f64).sqrt() } else { 0.0 });
            HorizonError { horizon_s: *h, position_m, velocity_m_s, attitude_rad, rate_rad_s, n: *n }
        })
        .collect()
}

/// Root-mean-square errors (length of the 3-D difference) of roll-outs that start from the measured state every 0.1 s,
/// against the measured state at their ends; `segments` (s, from–to) are the spans in which they must lie. A horizon
/// without roll-outs has `n` 0; a diverging roll-out makes its errors non-finite.
pub(crate) fn replay_errors(
    replay: &Replay,
    horizons_s: &[f64],
    segments: Option<&[[f64; 2]]>,
) -> Vec<HorizonError> {
    let starts = Starts::new(replay, horizons_s);
    let plant = replay.plant();
    let places: Vec<usize> = (0..replay.n_steps()).step_by(START_EVERY).collect();
    let each: Vec<Vec<(usize, [f64; 4])>> = places
        .par_iter()
        .with_min_len(8)
        .map_init(Vec::<Point>::new, |points, &i| {
            let reach = starts.reach(i, segments);
            let (Some(far), Some(start)) = (reach.iter().map(|h| starts.steps[*h]).max(), replay.known(i))
            else {
                return Vec::new();
            };
            plant.roll(&replay.ticks[i * STEP..], i * STEP, far, start, &[], points);
            reach
                .into_iter()
                .filter_map(|h| {
                    let end = starts.steps[h];
                    Some((h, squares(&points[end].state, replay.known(i + end)?)))
                })
                .collect()
        })
        .collect();
    let mut sums = vec![[0.0; 4]; horizons_s.len()];
    let mut counts = vec![0; horizons_s.len()];
    for (h, s) in each.into_iter().flatten() {
        (0..4).for_each(|k| sums[h][k] += s[k]);
        counts[h] += 1;
    }
    finish(horizons_s, &sums, &counts)
}

/// Expected [`replay_errors`] of a perfect model with noisy sensors: the noise of the initial state and of the inputs
/// propagated through the model, and the noise at the end.
pub(crate) fn expected_errors(replay: &Replay, horizons_s: &[f64]) -> Vec<HorizonError> {
    let noise = StateNoise::of(replay.track);
    let starts = Starts::new(replay, horizons_s);
    let plant = replay.plant();
    let able: Vec<(usize, Vec<usize>)> = (0..replay.n_steps())
        .step_by(START_EVERY)
        .map(|i| (i, starts.reach(i, None)))
        .filter(|(_, reach)| !reach.is_empty())
        .collect();
    let stride = able.len().div_ceil(NOISE_STARTS).max(1);
    let chosen: Vec<_> = able.iter().step_by(stride).collect();
    let input = input_noise(replay.track);
    let each: Vec<Vec<(usize, [f64; 4])>> = chosen
        .par_iter()
        .map(|(i, reach)| {
            let (mut base, mut points) = (Vec::<Point>::new(), Vec::<Point>::new());
            let far = reach.iter().map(|h| starts.steps[*h]).max().unwrap_or(0);
            let Some(start) = replay.known(*i) else { return Vec::new() };
            let from = i * STEP;
            plant.roll(&replay.ticks[from..], from, far, start, &[], &mut base);
            let end_noise =
                [noise.pos_m, noise.vel_m_s, noise.att_rad, noise.rate_rad_s].map(|s| 3.0 * s * s);
            let mut sums = vec![end_noise; reach.len()];
            let mut take = |points: &[Point]| {
                for (sum, h) in sums.iter_mut().zip(reach) {
                    let end = starts.steps[*h];
                    let b = &base[end].state;
                    let b = Measured { pos: b.pos, vel: b.vel, quat: b.quat, ang_vel: b.ang_vel };
                    let s = squares(&points[end].state, &b);
                    (0..4).for_each(|k| sum[k] += s[k]);
                }
            };
            // First-order propagation: one roll-out per perturbed component of the initial state.
            for which in 0..12 {
                let moved = noise.moved(start, which);
                plant.roll(&replay.ticks[from..], from, far, &moved, &[], &mut points);
                take(&points);
            }
            if let Some((sigma, period)) = input {
                // White noise per tick with the same low-frequency power as that of the samples: what integrates is the
                // same.
                let sigma = sigma * (period / TICK_S).sqrt();
                let key =
                    Key { seed: 0, world: 0, drone: 0, step: *i as u64, purpose: purpose("gap.input_noise") };
                let mut draws = key.stream();
                let mut ticks = replay.ticks[from..=from + far * STEP].to_vec();
                for tick in &mut ticks {
                    tick.thrust +=
                        if replay.track.drive == Drive::Thrust { sigma * draws.normal() } else { 0.0 };
                    if replay.track.drive == Drive::RotorSpeeds {
                        for v in tick.rotor_vel.iter_mut().take(plant.parts.airframe.n_rotors) {
                            *v += sigma * draws.normal();
                        }
                    }
                }
                plant.roll(&ticks, from, far, start, &[], &mut points);
                take(&points);
            }
            reach.iter().copied().zip(sums).collect()
        })
        .collect();
    let mut sums = vec![[0.0; 4]; horizons_s.len()];
    let mut counts = vec![0; horizons_s.len()];
    for (h, s) in each.into_iter().flatten() {
        (0..4).for_each(|k| sums[h][k] += s[k]);
        counts[h] += 1;
    }
    finish(horizons_s, &sums, &counts)
}
