//! Output error of the attitude: roll-outs in windows, each with its own initial state and level offset.

use super::commands::{Commands, Walk};
use super::solve::{Push, Windows};
use propwash_flight::resample::body_rates;
use propwash_flight::{Channel, FlightLog};
use propwash_physics::drone::{Drone, Dynamics};
use propwash_physics::effects::Command;
use propwash_physics::measure;
use propwash_physics::rigid_body::State;
use propwash_physics::surroundings::Surroundings;
use propwash_trace::Real;
use propwash_trace::dual::Dual;
use propwash_trace::math::{quat, vec3};

/// Shared parameters: angle, rate and command gains per axis, delay, gyro bias.
pub(super) const SHARED: usize = 13;
/// Index of the delay.
pub(super) const DELAY: usize = 9;
/// Index of the gyro bias.
pub(super) const BIAS: usize = 10;
/// Nuisance parameters of a window: initial rotation vector and body rate, level offset (rad, added to the command).
pub(super) const OWN: usize = 9;
/// Directions of the duals: gains and delay, nuisance parameters.
const N: usize = 10 + OWN;
const _: () = assert!(propwash_physics::effects::custom::differentiates(N));
type D = Dual<f64, N>;

/// First channel of the attitude (rotation vector, rad), then of the gyro (rad/s).
pub(super) const GYRO: usize = 3;

/// A measurement at a time.
enum Seen {
    Attitude([f64; 4]),
    Gyro([f64; 3]),
}

/// A window of the log.
pub(super) struct Window {
    pub from_s: f64,
    pub to_s: f64,
    start: [f64; 4],
    velocity_m_s: [f64; 3],
    seen: Vec<(f64, Seen)>,
}

/// All windows with the data for their roll-outs.
pub(super) struct Rotation<'a> {
    pub commands: &'a Commands,
    pub drone: &'a Drone<f64>,
    pub windows: Vec<Window>,
}

impl<'a> Rotation<'a> {
    /// Windows over the spans (s) of the log; `attitude` and `gyro` as used in the fit. Also returns start values of the
    /// nuisance parameters.
    pub fn new(
        log: &FlightLog,
        commands: &'a Commands,
        drone: &'a Drone<f64>,
        attitude: &Channel<4>,
        gyro: &Channel<3>,
        spans: &[(f64, f64)],
    ) -> (Self, Vec<[f64; OWN]>) {
        let period = attitude.period_s().unwrap_or(0.01);
        let mut windows = Vec::new();
        let mut own = Vec::new();
        for (from_s, to_s) in spans {
            let inside = attitude.between(*from_s, *to_s);
            let Some(start) = inside.values.first() else { continue };
            let start = quat::normalize(*start);
            let rates = measure_rate(attitude, gyro, inside.t_s[0], period);
            let mut seen: Vec<(f64, Seen)> =
                inside.t_s.iter().zip(&inside.values).map(|(t, q)| (*t, Seen::Attitude(*q))).collect();
            let gyro = gyro.between(inside.t_s[0], *to_s);
            seen.extend(gyro.t_s.iter().zip(&gyro.values).map(|(t, w)| (*t, Seen::Gyro(*w))));
            seen.sort_by(|a, b| a.0.total_cmp(&b.0));
            let velocity_m_s = super::translation::velocity(log, 0.5 * (from_s + to_s));
            own.push([0.0, 0.0, 0.0, rates[0], rates[1], rates[2], 0.0, 0.0, 0.0]);
            windows.push(Window { from_s: inside.t_s[0], to_s: *to_s, start, velocity_m_s, seen });
        }
        (Self { commands, drone, windows }, own)
    }
}

/// Body rate at a time: from the attitudes around it, else the nearest gyro sample, else zero.
fn measure_rate(attitude: &Channel<4>, gyro: &Channel<3>, at_s: f64, period_s: f64) -> [f64; 3] {
    let around = body_rates(attitude, &[at_s + 3.0 * period_s], 4.0 * period_s);
    let nearest = gyro.t_s.partition_point(|t| *t < at_s).min(gyro.len().saturating_sub(1));
    around[0].or(gyro.values.get(nearest).copied()).unwrap_or([0.0; 3])
}

/// Sets the shared values (gains, 9 numbers) in a vehicle's attitude response.
pub(super) fn put<S: Real>(drone: &mut Drone<S>, gains: &[S; 9]) {
    if let Dynamics::AttitudeResponse(p) = &mut drone.dynamics {
        p.angle_gain_per_s2 = [gains[0], gains[1], gains[2]];
        p.rate_gain_per_s = [gains[3], gains[4], gains[5]];
        p.command_gain_per_s2 = [gains[6], gains[7], gains[8]];
    }
}

impl Windows<SHARED, OWN> for Rotation<'_> {
    fn rows(&self, window: usize, shared: &[f64; SHARED], own: &[f64; OWN], push: &mut Push<SHARED, OWN>) {
        let w = &self.windows[window];
        let mut drone: Drone<D> = self.drone.map(&mut |v| D::lit(v));
        put(&mut drone, &std::array::from_fn(|k| D::input(shared[k], k)));
        let local: [D; OWN] = std::array::from_fn(|k| D::input(own[k], 10 + k));
        let turn = quat::exp([local[0], local[1], local[2]]);
        let still = w.velocity_m_s.map(D::lit);
        let state = State {
            quat: quat::mul(w.start.map(D::lit), turn),
            ang_vel: [local[3], local[4], local[5]],
            vel: still,
            ..State::rest()
        };
        let surroundings = Surroundings::calm();
        let rate = |s: &State<D>, c: [f64; 4]| {
            let command =
                [local[6] + D::lit(c[0]), local[7] + D::lit(c[1]), local[8] + D::lit(c[2]), D::lit(c[3])];
            let mut s = *s;
            s.thrust = D::lit(c[3]);
            let mut rate = drone.rate(&s, &Command::Attitude(command), &surroundings);
            // Only the attitude is rolled out here.
            rate.vel = [D::zero(); 3];
            rate.acc = [D::zero(); 3];
            rate.thrust_rate = D::zero();
            rate
        };
        let delay = D::input(shared[DELAY], DELAY);
        let mut walk = Walk::new(self.commands, delay, w.from_s, state, 0.006);
        let mut jl = [0.0; OWN];
        for (t, seen) in &w.seen {
            walk.to(*t, rate);
            let (first, error) = match seen {
                Seen::Attitude(q) => {
                    let measured = quat::conjugate(quat::normalize(*q)).map(D::lit);
                    let e = quat::mul(measured, walk.state.quat);
                    // Twice the vector part is the rotation vector to third order; the sign selects the shorter rotation.
                    let two = D::lit(if e[3].value < 0.0 { -2.0 } else { 2.0 });
                    (0, [e[0] * two, e[1] * two, e[2] * two])
                }
                Seen::Gyro(v) => {
                    let bias = [shared[BIAS], shared[BIAS + 1], shared[BIAS + 2]];
                    let read = vec3::sub(measure::gyroscope(&walk.state), v.map(D::lit));
                    (GYRO, vec3::add(read, bias.map(D::lit)))
                }
            };
            for k in 0..3 {
                let mut jg = [0.0; SHARED];
                jg[..10].copy_from_slice(&error[k].partials[..10]);
                if first == GYRO {
                    jg[BIAS + k] = 1.0;
                }
                jl.copy_from_slice(&error[k].partials[10..]);
                push(first + k, error[k].value, &jg, &jl);
            }
        }
    }
}
