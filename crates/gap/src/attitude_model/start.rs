//! Start values by equation error: all signals pass one state-variable filter, whose states are the filtered signal and its
//! derivatives, followed by linear least squares over a grid of delays and thrust rates.
//!
//! Young, "Parameter estimation for continuous-time models: a survey", Automatica 17(1), 1981.

use super::commands::Commands;
use super::translation::{self, DELAY, RATE};
use nalgebra::{DMatrix, DVector};
use propwash_flight::resample::{cubic, grid, local_parabola, slerp};
use propwash_flight::{Channel, FlightLog};
use propwash_physics::attitude_response;
use propwash_physics::drone::{Drone, Dynamics};
use propwash_physics::effects::Command;
use propwash_physics::integrate::Integrator;
use propwash_physics::rigid_body::{Rate, State};
use propwash_physics::surroundings::Surroundings;
use propwash_trace::Real;
use propwash_trace::dual::Dual;
use propwash_trace::math::euler;
use rayon::prelude::*;

/// Grid spacing, s.
const STEP_S: f64 = 0.005;
/// Corner of the filter, rad/s.
const CORNER_RAD_S: f64 = 30.0;
/// Time after a gap (and after the start) until the filter has settled, s.
const SETTLE_S: f64 = 0.4;

/// A signal on the grid, filtered: value, slope, curvature.
fn filter(u: &[f64]) -> Vec<[f64; 3]> {
    let a = CORNER_RAD_S;
    let Some(first) = u.first() else { return Vec::new() };
    let mut x = [*first, 0.0, 0.0];
    let slope =
        |x: [f64; 3], u: f64| [x[1], x[2], a * a * a * (u - x[0]) - 3.0 * a * a * x[1] - 3.0 * a * x[2]];
    let mut out = Vec::with_capacity(u.len());
    out.push(x);
    for pair in u.windows(2) {
        let middle = 0.5 * (pair[0] + pair[1]);
        let moved = |k: [f64; 3], h: f64| -> [f64; 3] { std::array::from_fn(|i| x[i] + h * k[i]) };
        let k1 = slope(x, pair[0]);
        let k2 = slope(moved(k1, 0.5 * STEP_S), middle);
        let k3 = slope(moved(k2, 0.5 * STEP_S), middle);
        let k4 = slope(moved(k3, STEP_S), pair[1]);
        x = std::array::from_fn(|i| x[i] + STEP_S / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]));
        out.push(x);
    }
    out
}

/// The log on the grid.
pub(super) struct Grid {
    t_s: Vec<f64>,
    /// Grid points whose filtered values are valid.
    good: Vec<bool>,
    quat: Vec<[f64; 4]>,
}

impl Grid {
    /// Attitude on the grid from the first command on.
    pub fn new(attitude: &Channel<4>, commands: &Commands, max_gap_s: f64) -> Self {
        let from = commands.t_s[0].max(attitude.t_s[0]);
        let t_s = grid(from, attitude.t_s[attitude.len() - 1], STEP_S);
        let mut quat = Vec::with_capacity(t_s.len());
        let mut good = Vec::with_capacity(t_s.len());
        let mut last = attitude.values[0];
        let mut since = 0.0;
        for q in slerp(attitude, &t_s, max_gap_s) {
            since = if q.is_some() { since + STEP_S } else { 0.0 };
            last = q.unwrap_or(last);
            quat.push(last);
            good.push(since > SETTLE_S);
        }
        Self { t_s, good, quat }
    }

    /// Gains (angle, rate, command; roll, pitch, yaw each) and delay (s); gains of an axis that did not move are zero.
    pub fn rotation(&self, commands: &Commands) -> ([f64; 9], f64) {
        let mut angles = vec![Vec::new(); 3];
        for q in &self.quat {
            let rpy = euler::from_quat(*q);
            for k in 0..3 {
                let turn = match angles[k].last() {
                    Some(last) => (rpy[k] - last) / std::f64::consts::TAU,
                    None => 0.0_f64,
                };
                angles[k].push(rpy[k] - std::f64::consts::TAU * turn.round());
            }
        }
        let angles: Vec<Vec<[f64; 3]>> = angles.iter().map(|a| filter(a)).collect();
        let sent: Vec<Vec<[f64; 3]>> = (0..3)
            .map(|k| filter(&self.t_s.iter().map(|t| commands.at(*t)[k]).collect::<Vec<_>>()))
            .collect();
        let mut best = ([0.0; 9], 0.0, f64::INFINITY);
        for late in 0..40 {
            let mut gains = [0.0; 9];
            let mut left = 0.0;
            for k in 0..3 {
                let rows = (late..self.t_s.len()).step_by(3).filter(|i| self.good[*i]).map(|i| {
                    let y = angles[k][i];
                    ([y[0], y[1], sent[k][i - late][0], 1.0], y[2])
                });
                let (x, share) = regress(rows);
                for (g, x) in x.iter().take(3).enumerate() {
                    gains[3 * g + k] = *x;
                }
                left += share;
            }
            if left < best.2 {
                best = (gains, late as f64 * STEP_S, left);
            }
        }
        (best.0, best.1)
    }

    /// Thrust offset, scale, rate and drag for a delay: the model's accelerations at the measured states are linear in all
    /// but the rate, which is searched on a grid.
    pub fn translation(
        &self,
        log: &FlightLog,
        commands: &Commands,
        drone: &Drone<f64>,
        (delay_s, hold_offset, drag): (f64, Option<f64>, bool),
    ) -> [f64; translation::SHARED] {
        let gap = 0.1_f64.max(5.0 * log.position_m.period_s().unwrap_or(0.01));
        let mut positions = vec![Vec::new(); 3];
        let mut good = self.good.clone();
        let mut last = log.position_m.values[0];
        let mut since = 0.0;
        for (i, p) in cubic(&log.position_m, &self.t_s, gap).into_iter().enumerate() {
            since = if p.is_some() { since + STEP_S } else { 0.0 };
            good[i] &= since > SETTLE_S;
            last = p.unwrap_or(last);
            for k in 0..3 {
                positions[k].push(last[k]);
            }
        }
        let positions: Vec<Vec<[f64; 3]>> = positions.iter().map(|p| filter(p)).collect();
        let half = 6.0 * log.position_m.period_s().unwrap_or(0.01);
        let velocities: Vec<[f64; 3]> = local_parabola(&log.position_m, &self.t_s, half)
            .into_iter()
            .map(|l| l.map_or([0.0; 3], |l| l.slope))
            .collect();
        let lags = matches!(&drone.dynamics, Dynamics::AttitudeResponse(p) if p.thrust_dynamics);
        let rates: &[f64] = if lags { &[5.0, 10.0, 20.0, 45.0] } else { &[10.0] };
        let try_rate = |rate: &f64| {
            let thrust = self.thrust(commands, drone, delay_s, *rate);
            let (rows, targets) = self.columns(drone, commands, delay_s, &velocities, &thrust);
            // Per axis: the part without parameters and five regressors, filtered.
            let mut all = Vec::new();
            for axis in 0..3 {
                let columns: Vec<Vec<[f64; 3]>> = (0..5).map(|c| filter(&rows[axis][c])).collect();
                let constant = filter(&targets[axis]);
                for i in (0..self.t_s.len()).filter(|i| good[*i]).step_by(2) {
                    let mut x: [f64; 5] = std::array::from_fn(|c| columns[c][i][0]);
                    let mut y = positions[axis][i][2] - constant[i][0];
                    if let Some(offset) = hold_offset {
                        y -= x[0] * offset;
                        x[0] = 0.0;
                    }
                    if !drag {
                        x[2..].fill(0.0);
                    }
                    all.push((x, y));
                }
            }
            let (x, left) = regress(all.into_iter());
            let mut values = [0.0; translation::SHARED];
            values[0] = hold_offset.unwrap_or(x[0]);
            values[1] = x[1];
            values[RATE] = *rate;
            values[3..6].copy_from_slice(&x[2..5]);
            values[DELAY] = delay_s;
            (values, left)
        };
        let tried: Vec<_> = rates.par_iter().map(try_rate).collect();
        let best = tried.into_iter().min_by(|a, b| a.1.total_cmp(&b.1));
        best.map_or([0.0; translation::SHARED], |b| b.0)
    }

    /// Thrust state on the grid.
    fn thrust(&self, commands: &Commands, drone: &Drone<f64>, delay_s: f64, rate_per_s: f64) -> Vec<f64> {
        let Dynamics::AttitudeResponse(mut p) = drone.dynamics else { return vec![0.0; self.t_s.len()] };
        p.thrust_rate_per_s = rate_per_s;
        let mut state = State { thrust: commands.before(0)[3], ..State::<f64>::rest() };
        self.t_s
            .iter()
            .map(|t| {
                let c = commands.at(t - delay_s)[3];
                let before = state.thrust;
                state = Integrator::Rk4.step(&state, STEP_S, |s| Rate {
                    thrust_rate: attitude_response::thrust_rate(&p, s.thrust, c),
                    ..Rate::zero()
                });
                before
            })
            .collect()
    }

    /// Accelerations per axis: derivatives by offset, scale, drag x, y, z; and the acceleration with all of them zero.
    #[allow(clippy::type_complexity)]
    fn columns(
        &self,
        drone: &Drone<f64>,
        commands: &Commands,
        delay_s: f64,
        velocities: &[[f64; 3]],
        thrust: &[f64],
    ) -> ([[Vec<f64>; 5]; 3], [Vec<f64>; 3]) {
        type E = Dual<f64, 5>;
        let n = self.t_s.len();
        let mut dual: Drone<E> = drone.map(&mut |v| E::lit(v));
        let input = |k: usize| E::input(0.0, k);
        translation::put(&mut dual, &[input(0), input(1), E::lit(10.0), input(2), input(3), input(4)]);
        let surroundings = Surroundings::calm();
        let mut slopes: [[Vec<f64>; 5]; 3] =
            std::array::from_fn(|_| std::array::from_fn(|_| Vec::with_capacity(n)));
        let mut constant: [Vec<f64>; 3] = std::array::from_fn(|_| Vec::with_capacity(n));
        for i in 0..n {
            let state = State {
                quat: self.quat[i].map(E::lit),
                vel: velocities[i].map(E::lit),
                thrust: E::lit(thrust[i]),
                ..State::rest()
            };
            let command = Command::Attitude(commands.at(self.t_s[i] - delay_s).map(E::lit));
            let rate = dual.rate(&state, &command, &surroundings);
            for axis in 0..3 {
                constant[axis].push(rate.acc[axis].value);
                for k in 0..5 {
                    slopes[axis][k].push(rate.acc[axis].partials[k]);
                }
            }
        }
        (slopes, constant)
    }
}

/// Least squares of y on x: the coefficients, and the unexplained share of y². Coefficients of zero or collinear columns
/// are zero or shared (a slight ridge).
fn regress<const K: usize>(rows: impl Iterator<Item = ([f64; K], f64)>) -> ([f64; K], f64) {
    let mut m = DMatrix::<f64>::zeros(K, K);
    let mut v = DVector::<f64>::zeros(K);
    let mut total = 0.0;
    for (x, y) in rows {
        for i in 0..K {
            for j in 0..K {
                m[(i, j)] += x[i] * x[j];
            }
            v[i] += x[i] * y;
        }
        total += y * y;
    }
    let scale: Vec<f64> = (0..K).map(|k| if m[(k, k)] > 0.0 { m[(k, k)].sqrt() } else { 1.0 }).collect();
    let mut unit = DMatrix::from_fn(K, K, |i, j| m[(i, j)] / (scale[i] * scale[j]));
    for k in 0..K {
        unit[(k, k)] += 1e-9;
    }
    let right = DVector::from_fn(K, |k, _| v[k] / scale[k]);
    let Some(solved) = unit.cholesky().map(|c| c.solve(&right)) else { return ([0.0; K], 1.0) };
    let explained = solved.dot(&right);
    let left = if total > 0.0 { ((total - explained) / total).max(0.0) } else { 0.0 };
    (std::array::from_fn(|k| solved[k] / scale[k]), left)
}
