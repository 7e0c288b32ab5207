//! Errors of roll-outs caused by the integrator of a simulated flight.
//!
//! A first-order scheme with step h follows ẋ = f − (h/2) f′f instead of ẋ = f: after a second at 500 Hz, positions of a
//! Crazyflie in a Lissajous figure are off by 2 mm. That is no fault of the vehicle, and exceeds the noise of a noise-free
//! log.

use super::compare::HORIZONS_S;
use super::replay::{STEP, STEP_S};
use super::residual::Replay;
use propwash_flight::{Simulated, resample};
use propwash_physics::integrate::Integrator;
use propwash_physics::rigid_body::{MAX_ROTORS, State};
use propwash_trace::math::{quat, vec3};

/// Starts over which the error is averaged.
const STARTS: usize = 24;

/// Root mean square errors of position, velocity, attitude and body rate after each of [`HORIZONS_S`] caused by the
/// flight's integrator; zero for real flights, or where the scheme is of higher order.
///
/// Two roll-outs of the model differ by the scheme alone, at the step of the replay; to first order, the error is
/// proportional to the step.
pub(crate) fn errors(replay: &Replay) -> Vec<[f64; 4]> {
    let none = vec![[0.0; 4]; HORIZONS_S.len()];
    let Some(Simulated { step_s, order: 1 }) = replay.track.log.simulated else { return none };
    let steps = HORIZONS_S.map(|h| (h / STEP_S).round() as usize);
    let far = steps[steps.len() - 1];
    let whole = |i: &usize| i + far < replay.n_steps() && replay.start(*i, far).is_some();
    let able: Vec<usize> = (0..replay.n_steps()).filter(whole).collect();
    let stride = able.len().div_ceil(STARTS).max(1);
    let (mut sums, mut n) = (none, 0.0);
    let (mut exact, mut coarse) = (Vec::new(), Vec::new());
    for i in able.into_iter().step_by(stride) {
        let Some(start) = replay.around.measured[i] else { continue };
        replay.plant().roll(&replay.ticks[i * STEP..], i * STEP, far, &start, &[], &mut exact);
        euler(replay, i, far, &mut coarse);
        for (sum, at) in sums.iter_mut().zip(steps) {
            let (a, b) = (&coarse[at], &exact[at].state);
            let turn = resample::rotation_vector(quat::mul(quat::conjugate(b.quat), a.quat));
            let apart =
                [vec3::sub(a.pos, b.pos), vec3::sub(a.vel, b.vel), turn, vec3::sub(a.ang_vel, b.ang_vel)];
            (0..4).for_each(|k| sum[k] += vec3::dot(apart[k], apart[k]));
        }
        n += 1.0;
    }
    let share = step_s / STEP_S;
    sums.into_iter().map(|s| s.map(|s| share * f64::sqrt(s / f64::max(n, 1.0)))).collect()
}

/// A roll-out by explicit Euler, from the measured state of an instant.
fn euler(replay: &Replay, from: usize, steps: usize, out: &mut Vec<State<f64>>) {
    let plant = replay.plant();
    let Some(start) = replay.around.measured[from] else { return };
    let mut state =
        State { pos: start.pos, quat: start.quat, vel: start.vel, ang_vel: start.ang_vel, ..State::rest() };
    let fed_in = replay.track.drive == super::track::Drive::Thrust;
    let mut neighbours = Vec::new();
    out.clear();
    for s in 0..=steps {
        // An input attitude is copied from the measurement.
        if let (true, Some(m)) = (fed_in, replay.around.measured[from + s]) {
            (state.quat, state.ang_vel) = (m.quat, m.ang_vel);
        }
        out.push(state);
        let tick = (from + s) * STEP;
        let rate = plant.rate(tick, &replay.ticks[tick], &mut state, &mut neighbours);
        state = Integrator::Euler.step(&state, STEP_S, |_| rate);
        // Rotor speeds and thrust are inputs, not results.
        state.rotor_vel = [0.0; MAX_ROTORS];
        state.thrust = 0.0;
    }
}
