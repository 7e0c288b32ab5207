//! Output error of position, velocity and accelerometer: roll-outs in windows along the measured attitude, each with its
//! own initial state and constant disturbance force.

use super::commands::{Commands, Walk};
use super::solve::{Push, Windows};
use propwash_flight::resample::{linear, local_parabola, rotation_vector};
use propwash_flight::{Channel, FlightLog};
use propwash_physics::drone::{Drone, Dynamics};
use propwash_physics::effects::{AnyEffect, Command, linear_drag};
use propwash_physics::measure;
use propwash_physics::rigid_body::{Rate, State};
use propwash_physics::surroundings::Surroundings;
use propwash_trace::Real;
use propwash_trace::dual::Dual;
use propwash_trace::math::{quat, vec3};

/// Shared parameters: thrust offset, scale and rate, drag along x, y, z, delay, accelerometer bias.
pub(super) const SHARED: usize = 10;
/// Index of the thrust rate.
pub(super) const RATE: usize = 2;
/// Index of the drag.
pub(super) const DRAG: usize = 3;
/// Index of the delay.
pub(super) const DELAY: usize = 6;
/// Index of the accelerometer bias.
pub(super) const BIAS: usize = 7;
/// Nuisance parameters of a window: initial velocity, disturbance force (N, world), initial position minus the measured
/// one.
pub(super) const OWN: usize = 9;
/// Directions of the duals: seven shared ones, velocity and force; an initial position only shifts all positions.
const N: usize = 13;
const _: () = assert!(propwash_physics::effects::custom::differentiates(N));
type D = Dual<f64, N>;

/// First channel of position, velocity and accelerometer.
pub(super) const VELOCITY: usize = 3;
/// See [`VELOCITY`].
pub(super) const ACCELEROMETER: usize = 6;

/// Measured channels used in the fit.
pub(super) struct Channels {
    pub attitude: Channel<4>,
    pub position: Channel<3>,
    pub velocity: Channel<3>,
    pub accelerometer: Channel<3>,
}

enum Seen {
    /// Attitude from here to the next one, and the constant body rate between the two.
    Turn([f64; 4], [f64; 3]),
    Position([f64; 3]),
    Velocity([f64; 3]),
    Accelerometer([f64; 3]),
}

/// A window of the log.
pub(super) struct Window {
    pub from_s: f64,
    pub to_s: f64,
    start_m: [f64; 3],
    wind_m_s: [f64; 3],
    seen: Vec<(f64, Seen)>,
}

/// All windows with the data for their roll-outs.
pub(super) struct Translation<'a> {
    pub commands: &'a Commands,
    pub drone: &'a Drone<f64>,
    pub windows: Vec<Window>,
}

/// Velocity at a time: the measured one if available, else the slope of the position, else zero.
pub(super) fn velocity(log: &FlightLog, at_s: f64) -> [f64; 3] {
    let gap = 10.0 * log.velocity_m_s.period_s().unwrap_or(0.0);
    if let Some(v) = linear(&log.velocity_m_s, &[at_s], gap)[0] {
        return v;
    }
    let half = 5.0 * log.position_m.period_s().unwrap_or(0.01);
    local_parabola(&log.position_m, &[at_s], half)[0].map_or([0.0; 3], |l| l.slope)
}

/// Sets thrust and drag (offset, scale, rate, drag x, y, z) in a vehicle whose first effect is linear drag.
pub(super) fn put<S: Real>(drone: &mut Drone<S>, values: &[S; 6]) {
    if let Dynamics::AttitudeResponse(p) = &mut drone.dynamics {
        p.thrust_offset_n = values[0];
        p.thrust_scale = values[1];
        p.thrust_rate_per_s = values[RATE];
    }
    if let Some(AnyEffect::LinearDrag(linear_drag::Params { drag_n_s_per_m })) = drone.effects.first_mut() {
        for k in 0..3 {
            drag_n_s_per_m[k] = [S::zero(); 3];
            drag_n_s_per_m[k][k] = values[DRAG + k];
        }
    }
}

/// Longest accurate integration step, s, for thrust that follows at `rate_per_s`.
fn longest_step(rate_per_s: f64) -> f64 {
    (0.5 / rate_per_s.abs().max(1.0)).min(0.006)
}

impl<'a> Translation<'a> {
    /// Windows over the spans (s) of the log, and start values of their nuisance parameters.
    pub fn new(
        log: &FlightLog,
        commands: &'a Commands,
        drone: &'a Drone<f64>,
        channels: &Channels,
        spans: &[(f64, f64)],
    ) -> (Self, Vec<[f64; OWN]>) {
        let mut windows = Vec::new();
        let mut own = Vec::new();
        for (from_s, to_s) in spans {
            let turns = channels.attitude.between(*from_s, *to_s);
            let positions = channels.position.between(*from_s, *to_s);
            let (Some(first), Some(start)) = (turns.t_s.first(), positions.values.first()) else { continue };
            let first = *first;
            let mut seen = Vec::new();
            for i in 0..turns.len() {
                let q = quat::normalize(turns.values[i]);
                let w = match turns.values.get(i + 1) {
                    Some(next) => {
                        let turn = rotation_vector(quat::mul(quat::conjugate(q), quat::normalize(*next)));
                        vec3::scale(turn, 1.0 / (turns.t_s[i + 1] - turns.t_s[i]))
                    }
                    None => [0.0; 3],
                };
                seen.push((turns.t_s[i], Seen::Turn(q, w)));
            }
            let last = turns.t_s[turns.len() - 1];
            let mut add = |c: &Channel<3>, make: fn([f64; 3]) -> Seen| {
                for (t, v) in c.t_s.iter().zip(&c.values) {
                    if *t >= first && *t <= last {
                        seen.push((*t, make(*v)));
                    }
                }
            };
            add(&positions, Seen::Position);
            add(&channels.velocity.between(*from_s, *to_s), Seen::Velocity);
            add(&channels.accelerometer.between(*from_s, *to_s), Seen::Accelerometer);
            // Attitudes first among equal times: the sort is stable.
            seen.sort_by(|a, b| a.0.total_cmp(&b.0));
            let wind = linear(&log.wind_m_s, &[0.5 * (from_s + to_s)], f64::INFINITY)[0];
            let v = velocity(log, first);
            own.push([v[0], v[1], v[2], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
            windows.push(Window {
                from_s: first,
                to_s: *to_s,
                start_m: *start,
                wind_m_s: wind.unwrap_or([0.0; 3]),
                seen,
            });
        }
        (Self { commands, drone, windows }, own)
    }

    /// Thrust state (N) at the start of every window, with its derivatives by thrust rate and delay: rolled out over the
    /// whole log from a command that has long been in force.
    pub fn thrust_states(&self, shared: &[f64; SHARED]) -> Vec<(f64, [f64; 2])> {
        type T = Dual<f64, 2>;
        let mut drone: Drone<T> = self.drone.map(&mut |v| T::lit(v));
        let mut values: [T; 6] = std::array::from_fn(|k| T::lit(shared[k]));
        values[RATE] = T::input(shared[RATE], 0);
        put(&mut drone, &values);
        let state = State { thrust: T::lit(self.commands.before(0)[3]), ..State::rest() };
        let from = self.commands.t_s.first().copied().unwrap_or(0.0).min(0.0);
        let delay = T::input(shared[DELAY], 1);
        let longest_s = 0.3 / shared[RATE].abs().max(1.0);
        let mut walk = Walk::new(self.commands, delay, from, state, longest_s);
        let Dynamics::AttitudeResponse(response) = drone.dynamics else { return Vec::new() };
        let rate = |s: &State<T>, c: [f64; 4]| Rate {
            thrust_rate: propwash_physics::attitude_response::thrust_rate(&response, s.thrust, T::lit(c[3])),
            ..Rate::zero()
        };
        self.windows
            .iter()
            .map(|w| {
                walk.to(w.from_s.max(from), rate);
                (walk.state.thrust.value, walk.state.thrust.partials)
            })
            .collect()
    }
}

/// Thrust state (N) and its derivatives by thrust rate and delay, per window.
type ThrustStates = std::sync::Arc<Vec<(f64, [f64; 2])>>;

/// A translation problem at one set of shared values, with the thrust states that follow from them.
pub(super) struct Along<'a> {
    pub problem: &'a Translation<'a>,
    pub cache: std::sync::Mutex<Option<([f64; SHARED], ThrustStates)>>,
}

impl Along<'_> {
    fn thrust_states(&self, shared: &[f64; SHARED]) -> ThrustStates {
        let mut cache = self.cache.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if let Some((of, states)) = cache.as_ref()
            && of == shared
        {
            return states.clone();
        }
        let states = std::sync::Arc::new(self.problem.thrust_states(shared));
        *cache = Some((*shared, states.clone()));
        states
    }
}

impl Windows<SHARED, OWN> for Along<'_> {
    fn rows(&self, window: usize, shared: &[f64; SHARED], own: &[f64; OWN], push: &mut Push<SHARED, OWN>) {
        let problem = self.problem;
        let w = &problem.windows[window];
        let mut drone: Drone<D> = problem.drone.map(&mut |v| D::lit(v));
        put(&mut drone, &std::array::from_fn(|k| D::input(shared[k], k)));
        let (thrust, slopes) = self.thrust_states(shared)[window];
        let mut thrust = D::lit(thrust);
        thrust.partials[RATE] = slopes[0];
        thrust.partials[DELAY] = slopes[1];
        let state = State { vel: std::array::from_fn(|k| D::input(own[k], 7 + k)), thrust, ..State::rest() };
        let mut surroundings = Surroundings::calm();
        surroundings.wind_m_s = w.wind_m_s.map(D::lit);
        surroundings.disturbance_force_n = std::array::from_fn(|k| D::input(own[3 + k], 10 + k));
        let rate = |s: &State<D>, c: [f64; 4]| {
            let mut rate = drone.rate(s, &Command::Attitude(c.map(D::lit)), &surroundings);
            // The attitude follows the measured one.
            rate.ang_acc = [D::zero(); 3];
            rate
        };
        let delay = D::input(shared[DELAY], DELAY);
        let mut walk = Walk::new(problem.commands, delay, w.from_s, state, longest_step(shared[RATE]));
        for (t, seen) in &w.seen {
            walk.to(*t, rate);
            let (first, error) = match seen {
                Seen::Turn(q, rate) => {
                    walk.state.quat = q.map(D::lit);
                    walk.state.ang_vel = rate.map(D::lit);
                    continue;
                }
                Seen::Position(p) => {
                    let start: [f64; 3] = std::array::from_fn(|k| w.start_m[k] + own[6 + k] - p[k]);
                    (0, vec3::add(walk.state.pos, start.map(D::lit)))
                }
                Seen::Velocity(v) => (VELOCITY, vec3::sub(walk.state.vel, v.map(D::lit))),
                Seen::Accelerometer(a) => {
                    let rate = rate(&walk.state, walk.command());
                    let read = measure::accelerometer(&walk.state, &rate, drone.body.gravity_m_s2);
                    let bias: [f64; 3] = std::array::from_fn(|k| shared[BIAS + k] - a[k]);
                    (ACCELEROMETER, vec3::add(read, bias.map(D::lit)))
                }
            };
            for k in 0..3 {
                let mut jg = [0.0; SHARED];
                let mut jl = [0.0; OWN];
                jg[..7].copy_from_slice(&error[k].partials[..7]);
                jl[..6].copy_from_slice(&error[k].partials[7..]);
                if first == ACCELEROMETER {
                    jg[BIAS + k] = 1.0;
                }
                if first == 0 {
                    jl[6 + k] = 1.0;
                }
                push(first + k, error[k].value, &jg, &jl);
            }
        }
    }
}
