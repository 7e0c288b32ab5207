//! How much of the residual force and torque is seen by two independent instruments: poses and inertial data.
//!
//! A slow error of an estimator bends the path over 0.25 s as an unknown force would, and a filtered attitude turns it as
//! an unknown torque would; their sizes alone cannot be told from physics. But an error of the poses is not in the
//! accelerometer, nor one of the attitude in the gyroscope. The products of both residuals are summed: errors of either
//! cancel, what really acts on the vehicle remains (two instruments with independent errors: Grubbs, "On estimating
//! precision of measuring instruments and product variability", J. American Statistical Association 43, 1948).

use super::fit::Prepared;
use super::model::Model;
use super::replay::{STEP, STEP_S, Tick, clock};
use super::residual::Replay;
use super::sensor_regression::{half_stretch, hat, turned_more};
use super::solve::Solution;
use super::track::{Drive, Measured};
use propwash_physics::rigid_body::State;
use propwash_trace::math::{quat, vec3};
use rayon::prelude::*;

/// Force over mass (m/s²) and torque over inertia (rad/s²) that both instruments see, root mean square over time and axes;
/// `None` where one of them is missing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct CrossCheck {
    pub force: Option<f64>,
    pub torque: Option<f64>,
}

/// Fewest instants for an estimate.
const FEWEST: usize = 40;

/// A residual by the inertial data, and how much more the poses see: three axes each.
type Pair = [[f64; 3]; 2];

/// The cross-check of a solution, all logs together.
pub(crate) fn cross_check(logs: &[Prepared], model: &Model, solution: &Solution) -> CrossCheck {
    let (mut forces, mut torques): (Vec<Pair>, Vec<Pair>) = (Vec::new(), Vec::new());
    for (index, log) in logs.iter().enumerate() {
        let drone = model.plain_at(&solution.values_of(index), &solution.set);
        let replay = Replay::new(log.track, &log.around, &log.raw, &drone);
        let (force, torque) = pairs(&replay);
        forces.extend(force);
        torques.extend(torque);
    }
    CrossCheck { force: left(&forces), torque: left(&torques) }
}

fn left(pairs: &[Pair]) -> Option<f64> {
    if pairs.len() < FEWEST {
        return None;
    }
    let n = 3.0 * pairs.len() as f64;
    let both: f64 = pairs.iter().map(|[own, more]| vec3::dot(*own, vec3::add(*own, *more))).sum();
    Some((both / n).max(0.0).sqrt())
}

/// Model and measurement at an instant.
struct Instant {
    at: Measured,
    /// Measured minus modelled specific force, world, m/s²; and the modelled acceleration.
    felt: Option<[f64; 3]>,
    moved: [f64; 3],
    /// Modelled angular acceleration, body, rad/s².
    turned: [f64; 3],
}

/// Means under consecutive hat functions, half as wide as the windows of the fit are long: what a second difference sees.
fn pairs(replay: &Replay) -> (Vec<Pair>, Vec<Pair>) {
    let (track, drone) = (replay.track, replay.drone);
    let apart = half_stretch();
    let n = replay.n_steps();
    let plant = replay.plant();
    let late = clock(track, drone).accel_s;
    let at: Vec<f64> = (0..n).map(|i| replay.time_s(i) + late).collect();
    let accel: Vec<Option<[f64; 3]>> = at.par_chunks(512).flat_map_iter(|at| track.felt(at)).collect();
    let instants: Vec<Option<Instant>> = (0..n)
        .into_par_iter()
        .with_min_len(256)
        .map_init(Vec::new, |neighbours, i| {
            let at = *replay.known(i)?;
            let tick: &Tick<f64> = &replay.ticks[i * STEP];
            let mut state =
                State { pos: at.pos, quat: at.quat, vel: at.vel, ang_vel: at.ang_vel, ..State::rest() };
            let rate = plant.rate(i * STEP, tick, &mut state, neighbours);
            let reads = drone.read(&state, &rate).accel;
            let felt = accel[i].map(|a| quat::rotate(at.quat, vec3::sub(a, reads)));
            Some(Instant { at, felt, moved: rate.acc, turned: rate.ang_acc })
        })
        .collect();
    let turns = track.drive != Drive::Thrust && !track.gyro.is_empty();
    let (mut forces, mut torques) = (Vec::new(), Vec::new());
    for middle in (apart..n.saturating_sub(apart)).step_by(apart) {
        let Some(span) = instants[middle - apart..=middle + apart].iter().map(Option::as_ref).collect()
        else {
            continue;
        };
        let span: Vec<&Instant> = span;
        forces.extend(force(&span, apart));
        if turns {
            torques.push(torque(&span, apart));
        }
    }
    (forces, torques)
}

fn force(span: &[&Instant], apart: usize) -> Option<Pair> {
    let (mut felt, mut moved) = ([0.0; 3], [0.0; 3]);
    for (instant, w) in span.iter().zip(hat(apart)) {
        felt = vec3::add(felt, vec3::scale(instant.felt?, w));
        moved = vec3::add(moved, vec3::scale(instant.moved, w));
    }
    let time = apart as f64 * STEP_S;
    let [a, b, c] = [0, apart, 2 * apart].map(|i| span[i].at.pos);
    let bend: [f64; 3] = core::array::from_fn(|k| (a[k] - 2.0 * b[k] + c[k]) / (time * time));
    Some([felt, vec3::sub(vec3::sub(bend, moved), felt)])
}

fn torque(span: &[&Instant], apart: usize) -> Pair {
    let time = apart as f64 * STEP_S;
    let measured: Vec<&Measured> = span.iter().map(|i| &i.at).collect();
    // Mean rate over each half, and by how much the attitude turned more than the gyroscope measured.
    let half = |from: usize| {
        let part = &measured[from..=from + apart];
        let mut mean = [0.0; 3];
        for pair in part.windows(2) {
            let rate = vec3::scale(vec3::add(pair[0].ang_vel, pair[1].ang_vel), 0.5);
            mean = vec3::add(mean, vec3::scale(rate, 1.0 / apart as f64));
        }
        (mean, turned_more(part))
    };
    let (before, after) = (half(0), half(apart));
    let mut modelled = [0.0; 3];
    for (instant, w) in span.iter().zip(hat(apart)) {
        modelled = vec3::add(modelled, vec3::scale(instant.turned, w));
    }
    let by_gyro = vec3::scale(vec3::sub(after.0, before.0), 1.0 / time);
    let more = vec3::scale(vec3::sub(after.1, before.1), 1.0 / (time * time));
    [vec3::sub(by_gyro, modelled), more]
}

#[cfg(test)]
mod tests {
    use super::*;
    use propwash_rollout::random::{Key, purpose};

    #[test]
    fn errors_of_one_instrument_cancel_and_what_both_see_stays() {
        let key = Key { seed: 4, world: 0, drone: 0, step: 0, purpose: purpose("cross-check test") };
        let mut dice = key.stream();
        let mut drawn = |sigma: f64| -> [f64; 3] { core::array::from_fn(|_| sigma * dice.normal()) };
        let mut pairs = |real: f64, felt: f64, posed: f64| -> Vec<Pair> {
            let one = |_| {
                let (real, felt, posed) = (drawn(real), drawn(felt), drawn(posed));
                [vec3::add(real, felt), vec3::sub(posed, felt)]
            };
            (0..2000).map(one).collect()
        };
        let of_poses = left(&pairs(0.0, 0.02, 0.3)).unwrap();
        assert!(of_poses < 0.03, "{of_poses}");
        let of_inertia = left(&pairs(0.0, 0.3, 0.02)).unwrap();
        assert!(of_inertia < 0.08, "{of_inertia}");
        let real = left(&pairs(0.2, 0.1, 0.3)).unwrap();
        assert!((real - 0.2).abs() < 0.02, "{real}");
        assert_eq!(left(&pairs(0.2, 0.1, 0.3)[..FEWEST - 1]), None);
    }
}
