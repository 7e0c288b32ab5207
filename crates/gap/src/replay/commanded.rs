//! Response of motors and thrust to the commands of a log.

use super::{Around, Plain, Raw, TICK_S, Tick};
use crate::policy::SETTLING_S;
use crate::track::Drive;
use propwash_physics::attitude_response;
use propwash_physics::drone::Drone;
use propwash_physics::effects::{Command, Effect, Parts};
use propwash_physics::rigid_body::{MAX_ROTORS, State};
use propwash_physics::rotor;
use propwash_physics::surroundings::Surroundings;
use propwash_trace::Real;
use std::ops::Range;

/// Ticks by which motors are followed before what is asked for: [`SETTLING_S`], after which their unknown speeds at the beginning matter
/// no more.
const RUN_IN: usize = (SETTLING_S / TICK_S) as usize;

/// Rotor speeds, or thrust and commands, of a vehicle under the commands of a log, tick by tick. With derivatives a [`Tick`] is a kilobyte,
/// and most of it zero: only what the dynamics have is kept.
pub(crate) struct Driven<S> {
    n_ticks: usize,
    n_rotors: usize,
    /// Rotor speeds, rad/s, shape (tick, rotor); empty by attitude commands.
    rotor_vel: Vec<S>,
    /// Thrust, N, and mean command of every tick; empty by rotor commands.
    abstracted: Vec<(S, [S; 4])>,
}

impl<S: Plain> Driven<S> {
    pub fn n_ticks(&self) -> usize {
        self.n_ticks
    }

    /// One tick, with `f` applied to every number. Rotor accelerations come from rotor speeds: a rate that jumps with every command would
    /// alias, so it is taken from the change over two ticks, which sums to the change of speed over a flight.
    pub fn tick<T: Plain>(&self, k: usize, f: impl Fn(S) -> T) -> Tick<T> {
        let mut out = Tick::zero();
        if let Some((thrust, command)) = self.abstracted.get(k) {
            (out.thrust, out.command) = (f(*thrust), command.map(f));
            return out;
        }
        let (a, b) = (k.saturating_sub(1), (k + 1).min(self.n_ticks - 1));
        let per_s = S::lit(1.0 / (TICK_S * (b - a).max(1) as f64));
        let speeds = |k: usize| &self.rotor_vel[k * self.n_rotors..(k + 1) * self.n_rotors];
        let (before, now, after) = (speeds(a), speeds(k), speeds(b));
        for i in 0..self.n_rotors {
            out.rotor_vel[i] = f(now[i]);
            out.rotor_acc[i] = f((after[i] - before[i]) * per_s);
        }
        out
    }
}

/// A vehicle under commands: motors and thrust are integrated from one command arrival to the next, so that sample
/// times of the log need not coincide with ticks, and a delay moves the arrivals (its derivative is that of the intervals).
/// A tick holds the mean under a hat function that is zero at the neighbouring ticks: commands that jump every 2 ms,
/// sampled every 2.5 ms, would alias.
///
/// Only the ticks in `asked` (ranges in rising order) are known afterwards, and motors are only followed from [`RUN_IN`] before each on, unless
/// something on the way from command to rotor remembers for longer.
pub(super) fn commanded<S: Plain>(
    around: &Around,
    raw: &Raw,
    drone: &Drone<S>,
    (kind, late): (Drive, S),
    asked: &[Range<usize>],
) -> Driven<S> {
    let (n_ticks, n_rotors) = (around.n_ticks, drone.airframe.n_rotors);
    let by_rotors = kind == Drive::RotorCommands;
    let mut out = Driven {
        n_ticks,
        n_rotors,
        rotor_vel: vec![S::zero(); if by_rotors { n_ticks * n_rotors } else { 0 }],
        abstracted: vec![(S::zero(), [S::zero(); 4]); if by_rotors { 0 } else { n_ticks }],
    };
    let at = |first: usize| Commanded::new(around, raw, drone, (kind, late), first);
    let mut drive = at(0);
    let all = 0..n_ticks;
    let remembers = !drive.memory.is_empty();
    for stretch in if remembers { vec![all] } else { with_run_in(asked, n_ticks) } {
        if stretch.start > 0 {
            drive = at(stretch.start);
        }
        // Rising half of the hat, from the previous tick.
        let mut rising = Hat::<S>::empty();
        for k in stretch.clone() {
            drive.surroundings.battery_v = S::lit(drive.battery_v.get(k).copied().unwrap_or(0.0));
            let first = k == stretch.start;
            let passed = drive.pass(around.time_s(k), first);
            // The first tick has only the falling half.
            let times = S::lit(if first { 2.0 } else { 1.0 });
            if by_rotors {
                let both = rising.rotor_vel.iter().zip(&passed.falling.rotor_vel);
                let speeds = &mut out.rotor_vel[k * n_rotors..(k + 1) * n_rotors];
                speeds.iter_mut().zip(both).for_each(|(speed, (up, down))| *speed = (*up + *down) * times);
            } else {
                out.abstracted[k] = ((rising.thrust + passed.falling.thrust) * times, passed.command);
            }
            rising = passed.rising;
        }
    }
    out
}

/// Ranges that begin [`RUN_IN`] earlier and end one tick later (a tick's acceleration is that of its neighbours), as far as there are ticks; those that
/// meet are one.
fn with_run_in(asked: &[Range<usize>], n_ticks: usize) -> Vec<Range<usize>> {
    let mut out: Vec<Range<usize>> = Vec::new();
    for range in asked.iter().filter(|r| !r.is_empty()) {
        let (from, to) = (range.start.saturating_sub(RUN_IN), (range.end + 1).min(n_ticks));
        match out.last_mut() {
            Some(last) if from <= last.end => last.end = last.end.max(to),
            _ => out.push(from..to),
        }
    }
    out
}

/// Integrates a vehicle's motors and thrust under the commands of a log.
struct Commanded<'a, S> {
    kind: Drive,
    /// Without its delay, which is in `late`.
    drone: Drone<S>,
    parts: Parts<S>,
    sent: &'a [(f64, [f64; MAX_ROTORS])],
    /// The battery's measured voltage at every tick, V; empty where there is none.
    battery_v: &'a [f64],
    /// Time from sending to arrival, s.
    late: S,
    /// Index of the command in force.
    now: usize,
    /// Memory of effects on commands.
    memory: Vec<S>,
    /// Rotor speeds and thrust.
    state: State<S>,
    /// What effects on commands make of the surroundings is kept from tick to tick.
    surroundings: Surroundings<'a, S>,
}

/// Results of one tick.
struct Passed<S> {
    /// Sums under the falling half of the hat of the starting tick, and the rising half of the next.
    falling: Hat<S>,
    rising: Hat<S>,
    /// Mean of the attitude and thrust commands.
    command: [S; 4],
}

/// An interval with a constant command.
#[derive(Clone, Copy)]
struct Stretch<S> {
    /// Length, s.
    dt: S,
    /// Its start and end within the tick, 0 to 1.
    place: [S; 2],
    /// Whether it is the very first: the vehicle starts in equilibrium with the command.
    first: bool,
}

impl<'a, S: Plain> Commanded<'a, S> {
    /// At tick `first`.
    fn new(
        around: &Around,
        raw: &'a Raw,
        drone: &Drone<S>,
        (kind, mut late): (Drive, S),
        first: usize,
    ) -> Self {
        let mut drone = drone.clone();
        drone.effects.retain(|e| match e.delay_s() {
            Some(delay_s) => {
                late = late + delay_s;
                false
            }
            None => true,
        });
        // The log says what was commanded, whoever did.
        drone.effects.retain(|e| !e.controls());
        // Taken out of throttles once, a battery would slow the motors again.
        drone.effects.retain(|e| !(raw.battery_in_commands && e.nature().is_battery));
        let parts = drone.parts();
        let sent_before = around.time_s(first) - late.plain();
        let now = raw.sent.partition_point(|(t, _)| *t <= sent_before).saturating_sub(1);
        let memory = vec![S::zero(); drone.memory_len(TICK_S)];
        let mut out = Self {
            kind,
            drone,
            parts,
            sent: &raw.sent,
            battery_v: &raw.battery_v,
            late,
            now,
            memory,
            state: State::rest(),
            surroundings: Surroundings::calm(),
        };
        let command = out.command();
        out.drone.start(&command, |e| e.memory_len(TICK_S), &mut out.memory);
        out
    }

    /// The command in force.
    fn command(&self) -> Command<S> {
        let v = self.sent[self.now].1.map(S::lit);
        match self.kind {
            Drive::AttitudeCommands => Command::Attitude([v[0], v[1], v[2], v[3]]),
            _ => Command::Rotors(v),
        }
    }

    /// Integrates over one tick.
    fn pass(&mut self, begin: f64, first_tick: bool) -> Passed<S> {
        self.surroundings.time_s = S::lit(begin);
        let mut passed = Passed { falling: Hat::empty(), rising: Hat::empty(), command: [S::zero(); 4] };
        let mut at = S::lit(begin);
        let end = S::lit(begin + TICK_S);
        let mut first = first_tick;
        loop {
            // This command is held until the next one arrives, or to the end of the tick.
            let next = self.sent.get(self.now + 1);
            let arrives = next.map(|(t, _)| S::lit(*t) + self.late).filter(|t| t.plain() < end.plain());
            let until = arrives.unwrap_or(end);
            let stretch = Stretch {
                dt: until - at,
                place: [at, until].map(|t| (t - S::lit(begin)) * S::lit(1.0 / TICK_S)),
                first,
            };
            self.hold(&stretch, &mut passed);
            first = false;
            at = until;
            if arrives.is_none() {
                return passed;
            }
            self.now += 1;
        }
    }

    /// Integrates over an interval with a constant command.
    fn hold(&mut self, stretch: &Stretch<S>, passed: &mut Passed<S>) {
        let mut now = self.command();
        if let (true, Command::Rotors(speeds)) = (stretch.first, now) {
            self.state.rotor_vel = speeds;
        }
        self.drone.transmit_as_built(
            Some(&self.parts),
            &self.state,
            &mut self.surroundings,
            (stretch.dt, TICK_S),
            &mut now,
            &mut self.memory,
        );
        match now {
            Command::Attitude(c) => self.thrust(c, stretch, passed),
            Command::Rotors(speeds) => self.motors(speeds, stretch, passed),
        }
    }

    /// Integrates the thrust of the abstracted response.
    fn thrust(&mut self, c: [S; 4], Stretch { dt, place, first }: &Stretch<S>, passed: &mut Passed<S>) {
        let Some(p) = &self.parts.response else { return };
        let (dt, state) = (*dt, &mut self.state);
        if *first {
            state.thrust = c[3];
        }
        for i in 0..4 {
            passed.command[i] = passed.command[i] + c[i] * dt * S::lit(1.0 / TICK_S);
        }
        let before = state.thrust;
        state.thrust = rk4(before, dt, |x| attitude_response::thrust_rate(p, x, c[3]));
        let (down, up) = hat_sums(*place, [before, state.thrust]);
        passed.falling.thrust = passed.falling.thrust + down;
        passed.rising.thrust = passed.rising.thrust + up;
    }

    /// Integrates the motors.
    fn motors(
        &mut self,
        speeds: [S; MAX_ROTORS],
        Stretch { dt, place, first }: &Stretch<S>,
        passed: &mut Passed<S>,
    ) {
        let state = &mut self.state;
        if *first {
            state.rotor_vel = speeds;
        }
        for i in 0..self.parts.airframe.n_rotors {
            let p = &self.parts.airframe.rotors[i];
            let rate = |x: S| rotor::acceleration(p, x, speeds[i]);
            let before = state.rotor_vel[i];
            state.rotor_vel[i] = rk4(before, *dt, rate);
            let (down, up) = hat_sums(*place, [before, state.rotor_vel[i]]);
            passed.falling.rotor_vel[i] = passed.falling.rotor_vel[i] + down;
            passed.rising.rotor_vel[i] = passed.rising.rotor_vel[i] + up;
        }
    }
}

/// Sums under one half of a tick's hat.
struct Hat<S> {
    rotor_vel: [S; MAX_ROTORS],
    thrust: S,
}

impl<S: Real> Hat<S> {
    fn empty() -> Self {
        Self { rotor_vel: [S::zero(); MAX_ROTORS], thrust: S::zero() }
    }
}

/// Integral of the straight line from `value[0]` at `place[0]` to `value[1]` at `place[1]`, under the half of a hat that
/// falls from one to zero over 0..1, and under the half that rises.
fn hat_sums<S: Real>(place: [S; 2], value: [S; 2]) -> (S, S) {
    let length = place[1] - place[0];
    let (third, sixth, half) = (S::lit(1.0 / 3.0), S::lit(1.0 / 6.0), S::lit(0.5));
    let up = length
        * (third * (place[0] * value[0] + place[1] * value[1])
            + sixth * (place[0] * value[1] + place[1] * value[0]));
    (half * length * (value[0] + value[1]) - up, up)
}

/// One step of the classical Runge–Kutta scheme for a single number.
fn rk4<S: Real>(x: S, dt: S, rate: impl Fn(S) -> S) -> S {
    let (half, two) = (S::lit(0.5) * dt, S::lit(2.0));
    let a = rate(x);
    let b = rate(x + half * a);
    let c = rate(x + half * b);
    let d = rate(x + dt * c);
    x + dt * S::lit(1.0 / 6.0) * (a + two * (b + c) + d)
}
