//! Replays a log through a model: its inputs at every instant, and roll-outs from measured states.

mod commanded;
mod context;
mod readings;

use super::GapError;
use super::cable::{Cable, Pulled};
use super::track::{Drive, Measured, SETTLE_S, Track, throttle};
pub(crate) use commanded::Driven;
use commanded::commanded;
pub(crate) use context::{Context, Contexts};
use propwash_flight::{Channel, resample};
use propwash_physics::drone::{self, Drone, Dynamics};
use propwash_physics::effects::{Command, Parts};
use propwash_physics::integrate::Integrator;
use propwash_physics::measure::{Clock, Reading};
use propwash_physics::rigid_body::{MAX_ROTORS, Rate, State};
use propwash_physics::surroundings::{Load, Neighbour, Surroundings};
use propwash_trace::Real;
use propwash_trace::dual::Dual;
use propwash_trace::math::quat;
use propwash_vehicle::schema::ThrottleOf;
use readings::Readings;
use std::ops::Range;
use std::sync::Arc;

/// Interval between the instants at which inputs are known, s.
pub(crate) const TICK_S: f64 = 0.0025;
/// Ticks per step of a roll-out (Runge–Kutta needs the midpoint too).
pub(crate) const STEP: usize = 2;
/// Step of roll-outs, s.
pub(crate) const STEP_S: f64 = TICK_S * STEP as f64;
/// Longest gap in an input that is interpolated, s.
pub(crate) const LONGEST_HOLE_S: f64 = 0.1;

/// Model inputs at one tick.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tick<S> {
    /// Rotor speeds, rad/s, and their rates, rad/s².
    pub rotor_vel: [S; MAX_ROTORS],
    pub rotor_acc: [S; MAX_ROTORS],
    /// Collective thrust, or the thrust state of the abstracted model, N.
    pub thrust: S,
    /// Delayed roll, pitch, yaw (rad) and thrust (N) commands.
    pub command: [S; 4],
}

impl<S: Plain> Tick<S> {
    /// Rotors at rest, no command.
    pub fn zero() -> Self {
        let zero = S::zero();
        Self {
            rotor_vel: [zero; MAX_ROTORS],
            rotor_acc: [zero; MAX_ROTORS],
            thrust: zero,
            command: [zero; 4],
        }
    }
}

impl<S: Copy> Tick<S> {
    /// Applies `f` to every number.
    pub fn map<T>(&self, mut f: impl FnMut(S) -> T) -> Tick<T> {
        Tick {
            rotor_vel: self.rotor_vel.map(&mut f),
            rotor_acc: self.rotor_acc.map(&mut f),
            thrust: f(self.thrust),
            command: self.command.map(f),
        }
    }

    /// Applies `f` to every number and that of another tick.
    pub fn with(&self, other: &Self, f: impl Fn(S, S) -> S) -> Self {
        let both = |i: usize, a: &[S; MAX_ROTORS], b: &[S; MAX_ROTORS]| f(a[i], b[i]);
        Self {
            rotor_vel: core::array::from_fn(|i| both(i, &self.rotor_vel, &other.rotor_vel)),
            rotor_acc: core::array::from_fn(|i| both(i, &self.rotor_acc, &other.rotor_acc)),
            thrust: f(self.thrust, other.thrust),
            command: core::array::from_fn(|i| f(self.command[i], other.command[i])),
        }
    }
}

/// The context of a log, independent of the model: the world around the vehicle at every tick.
#[derive(Clone, Debug)]
pub(crate) struct Around {
    /// First tick's time, s.
    pub from_s: f64,
    /// Measured states, every [`STEP`] ticks; `None` in gaps.
    pub measured: Vec<Option<Measured>>,
    /// Measured wind, m/s, world, every [`STEP`] ticks; empty where none was measured.
    pub wind: Vec<[f64; 3]>,
    /// Other vehicles, every [`STEP`] ticks; empty where there are none.
    pub neighbours: Vec<Vec<Neighbour<f64>>>,
    /// What hangs on a cable, every [`STEP`] ticks: from its track, else a pendulum under the measured motion.
    pub load: Vec<Load<f64>>,
    /// The cable, where the load was tracked.
    pub cable: Option<Cable>,
    /// Number of ticks.
    pub n_ticks: usize,
    /// What sensors read along the log.
    pub readings: Arc<Readings>,
}

impl Around {
    /// Builds the context of a log.
    pub fn new(track: &Track, drone: &Drone<f64>) -> Self {
        // Motors and filters settle before the span, on the commands sent then; states count within the span only.
        let settle = (SETTLE_S / STEP_S).round() as usize;
        let n_steps = settle + (track.duration_s() / STEP_S).floor() as usize;
        let from_s = track.span_s[0] - settle as f64 * STEP_S;
        let at: Vec<f64> = (0..=n_steps).map(|i| from_s + i as f64 * STEP_S).collect();
        let mut measured = vec![None; settle];
        measured.extend(track.measured_state(&at[settle..]));
        for (state, t) in measured.iter_mut().zip(&at) {
            state.take_if(|_| {
                track.excluded.iter().any(|e| e.hides_state() && *t >= e.from_s && *t <= e.to_s)
            });
        }
        let wind = if track.log.wind_m_s.len() > 1 { held(&track.log.wind_m_s, &at) } else { Vec::new() };
        let mut neighbours = Vec::new();
        if !track.neighbours.is_empty() {
            let weight_n = drone.hover_thrust();
            let disc_radius_m = drone.disc_radius_m();
            neighbours = vec![Vec::new(); at.len()];
            for name in &track.neighbours {
                let Some(channel) = track.log.objects_m.get(name) else { continue };
                let places = resample::local_parabola(channel, &at, 0.05);
                for (list, place) in neighbours.iter_mut().zip(places) {
                    if let Some(p) = place {
                        list.push(Neighbour { pos: p.value, vel: p.slope, weight_n, disc_radius_m });
                    }
                }
            }
        }
        let (load, cable) = Pulled::new(track, drone, &at, &measured).load(drone);
        Self {
            from_s,
            measured,
            wind,
            neighbours,
            load,
            cable,
            n_ticks: n_steps * STEP + 1,
            readings: Arc::default(),
        }
    }

    /// Time of a tick, s.
    pub fn time_s(&self, tick: usize) -> f64 {
        self.from_s + tick as f64 * TICK_S
    }

    /// Measured state at a tick; between two states, the earlier one.
    pub fn measured(&self, tick: usize) -> Option<&Measured> {
        self.measured.get(tick / STEP).and_then(Option::as_ref)
    }
}

/// Zero-order hold: the last value at or before each time; the first before the channel begins.
fn held<const N: usize>(channel: &Channel<N>, at_s: &[f64]) -> Vec<[f64; N]> {
    at_s.iter()
        .map(|at| {
            let i = channel.t_s.partition_point(|t| t <= at).saturating_sub(1);
            channel.values[i]
        })
        .collect()
}

/// Merges channels: every time at which one of them changes, with the values from then on. Before its first sample a
/// channel has that sample's value.
pub(crate) fn merged(channels: &[&Channel<1>]) -> Vec<(f64, [f64; MAX_ROTORS])> {
    let mut times: Vec<f64> = channels.iter().flat_map(|c| c.t_s.iter().copied()).collect();
    times.sort_by(f64::total_cmp);
    times.dedup();
    let mut next = [0; MAX_ROTORS];
    let mut now = [0.0; MAX_ROTORS];
    for (value, c) in now.iter_mut().zip(channels) {
        *value = c.values.first().map_or(0.0, |v| v[0]);
    }
    times
        .into_iter()
        .map(|t| {
            for (i, c) in channels.iter().enumerate() {
                while next[i] < c.len() && c.t_s[next[i]] <= t {
                    now[i] = c.values[next[i]][0];
                    next[i] += 1;
                }
            }
            (t, now)
        })
        .collect()
}

/// Whether a channel has samples near every tick.
fn covered(t: &[f64], from_s: f64, n: usize) -> Vec<bool> {
    (0..n)
        .map(|k| {
            let at = from_s + k as f64 * TICK_S;
            let i = t.partition_point(|t| *t <= at);
            i > 0 && i < t.len() && t[i] - t[i - 1] <= LONGEST_HOLE_S
        })
        .collect()
}

/// The inputs of a log before the modelled motors, at every tick.
#[derive(Clone, Debug)]
pub(crate) struct Raw {
    rotors: Vec<[f64; MAX_ROTORS]>,
    rotor_acc: Vec<[f64; MAX_ROTORS]>,
    thrust: Vec<f64>,
    /// Commands with the times at which they were sent, each held until the next: rotor speeds, or roll, pitch, yaw and
    /// thrust.
    sent: Vec<(f64, [f64; MAX_ROTORS])>,
    /// The battery's measured voltage at every tick, V; empty where there is none, or where commands follow from it already.
    battery_v: Vec<f64>,
    /// Whether commands follow from throttles and the battery's measured voltage.
    battery_in_commands: bool,
    /// Whether all inputs are available.
    pub valid: Vec<bool>,
}

impl Raw {
    /// Reads the inputs of a log.
    pub fn new(track: &Track, around: &Around) -> Self {
        let (from, n) = (around.from_s, around.n_ticks);
        let mut out = Self {
            rotors: Vec::new(),
            rotor_acc: Vec::new(),
            thrust: Vec::new(),
            sent: Vec::new(),
            battery_v: Vec::new(),
            battery_in_commands: track.battery_in_commands,
            valid: (0..n).map(|k| !track.is_excluded(from + k as f64 * TICK_S)).collect(),
        };
        // An instant is valid only if every input has samples near it.
        let mut cover = |t: &[f64]| {
            for (a, b) in out.valid.iter_mut().zip(covered(t, from, n)) {
                *a &= b;
            }
        };
        let at: Vec<f64> = (0..n).map(|k| from + k as f64 * TICK_S).collect();
        let inputs = &track.inputs;
        inputs.rotors.iter().for_each(|c| cover(&c.t_s));
        if by_pose(track.drive) && !track.battery_in_commands && throttle::has_voltage(&track.log) {
            out.battery_v = throttle::voltage(&track.log.vbat_v, ThrottleOf::Battery, 0.0, &at);
        }
        match track.drive {
            Drive::RotorCommands => {
                let all: Vec<&Channel<1>> = inputs.rotors.iter().collect();
                out.sent = merged(&all);
            }
            Drive::RotorSpeeds => {
                out.rotors = vec![[0.0; MAX_ROTORS]; n];
                out.rotor_acc = vec![[0.0; MAX_ROTORS]; n];
                for (i, c) in inputs.rotors.iter().enumerate() {
                    let period = c.period_s().unwrap_or(0.004);
                    // Rotor accelerations need a smooth derivative. Where samples are too sparse for it, speeds are
                    // interpolated and accelerations stay zero.
                    let local = resample::local_parabola(c, &at, 0.01f64.max(3.2 * period));
                    let plain = resample::linear(c, &at, LONGEST_HOLE_S);
                    for k in 0..n {
                        match (&local[k], plain[k]) {
                            (Some(l), _) => {
                                out.rotors[k][i] = l.value[0];
                                out.rotor_acc[k][i] = l.slope[0];
                            }
                            (None, Some(v)) => out.rotors[k][i] = v[0],
                            (None, None) => out.valid[k] = false,
                        }
                    }
                }
            }
            Drive::AttitudeCommands => {
                cover(&inputs.attitude.t_s);
                cover(&inputs.thrust.t_s);
                let angles: [Channel<1>; 3] = core::array::from_fn(|k| {
                    Channel::new(
                        inputs.attitude.t_s.clone(),
                        inputs.attitude.values.iter().map(|v| [v[k]]).collect(),
                    )
                });
                let [roll, pitch, yaw] = &angles;
                out.sent = merged(&[roll, pitch, yaw, &inputs.thrust]);
            }
            Drive::Thrust => {
                cover(&inputs.thrust.t_s);
                for (k, v) in resample::linear(&inputs.thrust, &at, LONGEST_HOLE_S).into_iter().enumerate() {
                    out.thrust.push(v.map_or(0.0, |v| v[0]));
                    out.valid[k] &= v.is_some();
                }
            }
        }
        out
    }
}

/// A log with the vehicle that it is compared with: its parameters, its context and its inputs.
pub(crate) struct Inputs {
    pub drone: Drone<f64>,
    pub around: Arc<Around>,
    pub raw: Arc<Raw>,
}

impl Inputs {
    /// Prepares a log for a vehicle.
    ///
    /// # Errors
    /// As [`drone_for`].
    pub fn new(track: &Track, vehicle: &propwash_vehicle::Vehicle) -> Result<Self, GapError> {
        let drone = drone_for(track, vehicle)?;
        let Context { around, raw } = Context::of(track, &drone);
        Ok(Self { drone, around, raw })
    }
}

/// A number type with a plain value: lookups in the log take no derivatives.
pub(crate) trait Plain: Real {
    /// The value.
    fn plain(self) -> f64;
}

impl Plain for f64 {
    fn plain(self) -> f64 {
        self
    }
}

impl<const N: usize> Plain for Dual<f64, N> {
    fn plain(self) -> f64 {
        self.value
    }
}

/// Whether time is counted by the pose stamps: a pose delay then delays the commands instead.
///
/// A common delay of all sensors is equivalent to delayed commands. Counted like this the two agree in every digit: windows
/// hold the same samples, whose noise would otherwise decide between them.
pub(crate) fn by_pose(drive: Drive) -> bool {
    matches!(drive, Drive::RotorCommands | Drive::AttitudeCommands)
}

/// Delays of the sensors of a log against what drives the model: commands have the log's time, measured inputs a clock of their own.
pub(crate) fn clock<S: Real>(track: &Track, drone: &Drone<S>) -> Clock<S> {
    let clock = drone.clock();
    match track.drive {
        Drive::RotorSpeeds | Drive::Thrust => clock.from_inputs(),
        Drive::RotorCommands | Drive::AttitudeCommands => clock,
    }
}

/// Delays of pose, gyroscope and accelerometer on the time axis of [`commanded_by_pose`].
pub(crate) fn delays<S: Plain>(track: &Track, drone: &Drone<S>) -> [f64; 3] {
    let clock = clock(track, drone);
    let all = [clock.pose_s, clock.gyro_s, clock.accel_s].map(S::plain);
    let zero = if by_pose(track.drive) { all[0] } else { 0.0 };
    all.map(|delay| delay - zero)
}

/// As [`drive`] by commands, on the time axis of the pose stamps where [`by_pose`] says so, at the ticks of `asked` alone, and without a whole
/// [`Tick`] for each instant.
pub(crate) fn commanded_by_pose<S: Plain>(
    track: &Track,
    around: &Around,
    raw: &Raw,
    drone: &Drone<S>,
    asked: &[Range<usize>],
) -> Driven<S> {
    commanded(around, raw, drone, (track.drive, drone.clock().pose_s), asked)
}

/// The model's inputs along a log: delays, motors and other effects on commands, for the whole log at once.
pub(crate) fn drive<S: Plain>(track: &Track, around: &Around, raw: &Raw, drone: &Drone<S>) -> Vec<Tick<S>> {
    let n = around.n_ticks;
    match track.drive {
        Drive::RotorSpeeds => (0..n)
            .map(|k| Tick {
                rotor_vel: raw.rotors[k].map(S::lit),
                rotor_acc: raw.rotor_acc[k].map(S::lit),
                ..Tick::zero()
            })
            .collect(),
        Drive::Thrust => (0..n).map(|k| Tick { thrust: S::lit(raw.thrust[k]), ..Tick::zero() }).collect(),
        Drive::RotorCommands | Drive::AttitudeCommands => {
            let driven =
                commanded(around, raw, drone, (track.drive, S::zero()), std::slice::from_ref(&(0..n)));
            (0..n).map(|k| driven.tick(k, |x| x)).collect()
        }
    }
}

/// A model with its inputs and context along a log.
pub(crate) struct Plant<'a, S> {
    pub drone: &'a Drone<S>,
    pub parts: Parts<S>,
    pub track: &'a Track,
    pub around: &'a Around,
}

impl<'a, S: Real> Plant<'a, S> {
    pub fn new(drone: &'a Drone<S>, track: &'a Track, around: &'a Around) -> Self {
        Self { drone, parts: drone.parts(), track, around }
    }

    /// Time derivative of `state` at a tick, after setting in `state` what is an input. `neighbours` is scratch space.
    #[inline]
    pub fn rate(
        &self,
        tick: usize,
        input: &Tick<S>,
        state: &mut State<S>,
        neighbours: &mut Vec<Neighbour<S>>,
    ) -> Rate<S> {
        let place = tick / STEP;
        neighbours.clear();
        if let Some(list) = self.around.neighbours.get(place) {
            neighbours.extend(list.iter().map(|n| Neighbour {
                pos: n.pos.map(S::lit),
                vel: n.vel.map(S::lit),
                weight_n: S::lit(n.weight_n),
                disc_radius_m: S::lit(n.disc_radius_m),
            }));
        }
        let wind = self.around.wind.get(place).copied().unwrap_or([0.0; 3]);
        let mut surroundings = Surroundings::<S> {
            time_s: S::lit(self.around.time_s(tick)),
            wind_m_s: wind.map(S::lit),
            neighbours,
            ..Surroundings::calm()
        };
        if let Some(load) = self.around.load.get(place) {
            surroundings.load = Load {
                position_m: load.position_m.map(S::lit),
                velocity_m_s: load.velocity_m_s.map(S::lit),
                acceleration_m_s2: load.acceleration_m_s2.map(S::lit),
                present: S::lit(load.present),
            };
        }
        if let Some(ceiling) = self.track.ceiling_z_m {
            surroundings.ceiling_distance_m = S::lit(ceiling) - state.pos[2];
        }
        if let Some(ground) = self.track.ground_z_m {
            surroundings.ground_distance_m = state.pos[2] - S::lit(ground);
        }
        match self.track.drive {
            Drive::RotorSpeeds | Drive::RotorCommands => {
                state.rotor_vel = input.rotor_vel;
                let measured = drone::Measured::RotorAcc(input.rotor_acc);
                self.drone.rate_measured_of(&self.parts, state, &measured, &surroundings)
            }
            Drive::AttitudeCommands => {
                state.thrust = input.thrust;
                self.drone.rate(state, &Command::Attitude(input.command), &surroundings)
            }
            Drive::Thrust => {
                let measured = drone::Measured::Thrust(input.thrust);
                let mut rate = self.drone.rate_measured_of(&self.parts, state, &measured, &surroundings);
                // The attitude is an input.
                rate.ang_acc = [S::zero(); 3];
                rate
            }
        }
    }
}

/// One point of a roll-out.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Point {
    pub state: State<f64>,
    pub rate: Rate<f64>,
}

/// Steps over which a disturbance of a roll-out is constant: 50 ms.
pub(crate) const PUSH_STEPS: usize = 10;

/// Process noise: accelerations added to the model's over [`PUSH_STEPS`]: force (m/s², world) and torque (rad/s², body).
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Push {
    pub acc: [f64; 3],
    pub ang_acc: [f64; 3],
}

impl Plant<'_, f64> {
    /// Rolls the model out from a state at tick `from` over `steps` steps of [`STEP_S`]; fills `out` with `steps + 1`
    /// points. `ticks` are the inputs from that tick on. `push` holds the consecutive disturbances; the last one is held.
    pub fn roll(
        &self,
        ticks: &[Tick<f64>],
        from: usize,
        steps: usize,
        start: &Measured,
        push: &[Push],
        out: &mut Vec<Point>,
    ) {
        let mut neighbours = Vec::new();
        let mut state = State {
            pos: start.pos,
            quat: start.quat,
            vel: start.vel,
            ang_vel: start.ang_vel,
            ..State::rest()
        };
        let add = |step: usize, mut rate: Rate<f64>| {
            let Some(push) = push.get(step / PUSH_STEPS).or(push.last()) else { return rate };
            for k in 0..3 {
                rate.acc[k] += push.acc[k];
                rate.ang_acc[k] += push.ang_acc[k];
            }
            rate
        };
        out.clear();
        for s in 0..steps {
            let at = from + s * STEP;
            self.measured_attitude(at, &mut state);
            let rate = add(s, self.rate(at, &ticks[s * STEP], &mut state, &mut neighbours));
            out.push(Point { state, rate });
            let mut stage = 0;
            state = Integrator::Rk4.step(&state, STEP_S, |x| {
                let ahead = [0, 1, 1, 2][stage.min(3)];
                stage += 1;
                if stage == 1 {
                    return rate;
                }
                let mut x = *x;
                add(s, self.rate(at + ahead, &ticks[s * STEP + ahead], &mut x, &mut neighbours))
            });
            // Rotor speeds and thrust are inputs, not results.
            state.rotor_vel = [0.0; MAX_ROTORS];
            state.thrust = 0.0;
        }
        let at = from + steps * STEP;
        self.measured_attitude(at, &mut state);
        let rate = add(steps, self.rate(at, &ticks[steps * STEP], &mut state, &mut neighbours));
        out.push(Point { state, rate });
    }

    /// An input attitude is copied from the measurement.
    fn measured_attitude(&self, tick: usize, state: &mut State<f64>) {
        let given = (self.track.drive == Drive::Thrust).then(|| self.around.measured(tick)).flatten();
        if let Some(m) = given {
            state.quat = m.quat;
            state.ang_vel = m.ang_vel;
        }
    }

    /// Sensor outputs `after_s` seconds after point `i` of a roll-out; between points by cubic Hermite interpolation.
    pub fn reading(&self, points: &[Point], i: usize, after_s: f64) -> Reading<f64> {
        let point = between(points, i, after_s);
        self.drone.read(&point.state, &point.rate)
    }
}

/// State and rate `after_s` s after point `i`.
fn between(points: &[Point], i: usize, after_s: f64) -> Point {
    let ends = (&points[i], &points[(i + 1).min(points.len() - 1)]);
    between_turned(ends, turn_to_next(ends.0, ends.1), after_s)
}

/// Rotation vector from a point of a roll-out to the next.
pub(crate) fn turn_to_next(a: &Point, b: &Point) -> [f64; 3] {
    resample::rotation_vector(quat::mul(quat::conjugate(a.state.quat), b.state.quat))
}

/// State and rate `after_s` s after the first of two points, with the rotation vector between them.
pub(crate) fn between_turned((a, b): (&Point, &Point), turn: [f64; 3], after_s: f64) -> Point {
    let s = after_s / STEP_S;
    let hermite = |x0: f64, v0: f64, x1: f64, v1: f64| {
        let (g, rise) = (1.0 - s, x1 - x0);
        x0 + s * rise + s * g * (g * (v0 * STEP_S - rise) - s * (v1 * STEP_S - rise))
    };
    let line = |x0: f64, x1: f64| x0 + s * (x1 - x0);
    let mut out = *a;
    let mut part = [0.0; 3];
    for k in 0..3 {
        out.state.pos[k] = hermite(a.state.pos[k], a.state.vel[k], b.state.pos[k], b.state.vel[k]);
        out.state.vel[k] = hermite(a.state.vel[k], a.rate.acc[k], b.state.vel[k], b.rate.acc[k]);
        out.state.ang_vel[k] =
            hermite(a.state.ang_vel[k], a.rate.ang_acc[k], b.state.ang_vel[k], b.rate.ang_acc[k]);
        out.rate.acc[k] = line(a.rate.acc[k], b.rate.acc[k]);
        out.rate.ang_acc[k] = line(a.rate.ang_acc[k], b.rate.ang_acc[k]);
        part[k] = hermite(0.0, a.state.ang_vel[k], turn[k], b.state.ang_vel[k]);
    }
    for k in 0..MAX_ROTORS {
        out.state.rotor_vel[k] = line(a.state.rotor_vel[k], b.state.rotor_vel[k]);
    }
    out.state.quat = quat::mul(a.state.quat, quat::exp(part));
    out.rate.vel = out.state.vel;
    out.rate.ang_vel = out.state.ang_vel;
    out
}

/// The parameters of a vehicle for a log's dynamics.
pub(crate) fn drone_for(track: &Track, vehicle: &propwash_vehicle::Vehicle) -> Result<Drone<f64>, GapError> {
    let drone = vehicle.drone(track.dynamics).map_err(|e| GapError::Log {
        log: track.name.clone(),
        expected: format!("a vehicle with the dynamics {}", track.dynamics),
        found: e.to_string(),
        remedy: "choose another vehicle file".into(),
    })?;
    debug_assert!(
        track.drive != Drive::AttitudeCommands || matches!(drone.dynamics, Dynamics::AttitudeResponse(_))
    );
    Ok(drone)
}
