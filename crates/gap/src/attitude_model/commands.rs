//! Attitude and thrust commands as a zero-order hold, and roll-outs that stop exactly where a delayed command arrives.

use propwash_flight::Channel;
use propwash_physics::integrate::Integrator;
use propwash_physics::rigid_body::{Rate, State};
use propwash_trace::Real;
use propwash_trace::dual::Dual;

/// Commands [roll, pitch, yaw (rad), thrust (N)], each in force from its time until the next.
pub(super) struct Commands {
    /// Times of change, s.
    pub t_s: Vec<f64>,
    /// Values from there on.
    pub values: Vec<[f64; 4]>,
}

impl Commands {
    /// Merges both channels on one clock; times at which nothing changes are dropped.
    pub fn new(attitude: &Channel<3>, thrust: &Channel<1>) -> Self {
        let mut out = Self { t_s: Vec::new(), values: Vec::new() };
        let (Some(a0), Some(f0)) = (attitude.values.first(), thrust.values.first()) else { return out };
        let mut now = [a0[0], a0[1], a0[2], f0[0]];
        let (mut i, mut j) = (0, 0);
        while i < attitude.len() || j < thrust.len() {
            let ta = attitude.t_s.get(i).copied().unwrap_or(f64::INFINITY);
            let tf = thrust.t_s.get(j).copied().unwrap_or(f64::INFINITY);
            let t = ta.min(tf);
            if ta == t {
                now[..3].copy_from_slice(&attitude.values[i]);
                i += 1;
            }
            if tf == t {
                now[3] = thrust.values[j][0];
                j += 1;
            }
            if out.values.last() != Some(&now) {
                out.t_s.push(t);
                out.values.push(now);
            }
        }
        out
    }

    /// Index of the first change after `t_s`.
    pub fn after(&self, t_s: f64) -> usize {
        self.t_s.partition_point(|t| *t <= t_s)
    }

    /// The command in force before change `next`; the first one before any.
    pub fn before(&self, next: usize) -> [f64; 4] {
        self.values[next.saturating_sub(1)]
    }

    /// The command in force at `t_s` without delay.
    pub fn at(&self, t_s: f64) -> [f64; 4] {
        self.before(self.after(t_s))
    }
}

/// Interval below which one slope (Euler) suffices, s.
const SHORT_S: f64 = 1e-6;

/// A roll-out under delayed commands. The arrival times of commands are duals, so the derivative of every state with
/// respect to the delay is exact.
pub(super) struct Walk<'a, const N: usize> {
    commands: &'a Commands,
    delay_s: Dual<f64, N>,
    next: usize,
    t: Dual<f64, N>,
    max_step_s: f64,
    /// The current state.
    pub state: State<Dual<f64, N>>,
}

impl<'a, const N: usize> Walk<'a, N> {
    /// A roll-out from `state` at `from_s`, in steps of at most `max_step_s`.
    pub fn new(
        commands: &'a Commands,
        delay_s: Dual<f64, N>,
        from_s: f64,
        state: State<Dual<f64, N>>,
        max_step_s: f64,
    ) -> Self {
        let next = commands.after(from_s - delay_s.value);
        Self { commands, delay_s, next, t: Dual::lit(from_s), max_step_s, state }
    }

    /// The command in force.
    pub fn command(&self) -> [f64; 4] {
        self.commands.before(self.next)
    }

    /// Integrates up to `to_s`.
    pub fn to(&mut self, to_s: f64, rate: impl Fn(&State<Dual<f64, N>>, [f64; 4]) -> Rate<Dual<f64, N>>) {
        let to = Dual::lit(to_s);
        while let Some(change) = self.commands.t_s.get(self.next) {
            let arrival = Dual::lit(*change) + self.delay_s;
            if arrival.value >= to_s {
                break;
            }
            self.leap(arrival, &rate);
            self.next += 1;
        }
        self.leap(to, &rate);
    }

    fn leap(
        &mut self,
        to: Dual<f64, N>,
        rate: &impl Fn(&State<Dual<f64, N>>, [f64; 4]) -> Rate<Dual<f64, N>>,
    ) {
        let span = to - self.t;
        let command = self.command();
        let n = (span.value / self.max_step_s).ceil().max(1.0);
        let step = span * Dual::lit(1.0 / n);
        // Where a command arrives just before a sample, Euler is as accurate as Runge–Kutta and keeps the derivative by the
        // delay.
        let scheme = if span.value < SHORT_S { Integrator::Euler } else { Integrator::Rk4 };
        for _ in 0..n as usize {
            self.state = scheme.step(&self.state, step, |s| rate(s, command));
        }
        self.t = to;
    }
}
