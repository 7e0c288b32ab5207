//! Least squares for the motors of a vehicle, with what is known of motors beforehand as prior.

use super::Voltage;
use super::course::{Course, FREE, Motor, Row};
use nalgebra::{SMatrix, SVector};
use propwash_physics::throttle::Params;
use std::collections::BTreeMap;

type Vector = SVector<f64, FREE>;
type Matrix = SMatrix<f64, FREE, FREE>;

/// Shares of offset, back-EMF and load in the voltage at the usual speed, and their standard deviations. A motor loses 10 to
/// 40 % of its voltage to its current at hover; speed controllers start to turn at 0 to 20 % of it.
const SHARES: [(f64, f64); 3] = [(0.1, 0.15), (0.6, 0.3), (0.3, 0.25)];
/// Unit of delays within the fit, s, and what is known of them in it: serial lines and control loops take some milliseconds.
const DELAY_UNIT_S: f64 = 0.01;
const DELAY: (f64, f64) = (0.4, 1.0);
/// Drag along body z over mass, 1/s: what vehicles of the field have.
const DRAG_PER_S: (f64, f64) = (0.2, 0.3);
/// Bounds of time constants, s, and of delays.
const LAG_S: [f64; 2] = [1e-3, 1.0];
const LONGEST_DELAY_S: f64 = 0.2;
/// Most iterations, and the step below which they end.
const ITERATIONS: usize = 60;
const SMALL: f64 = 1e-7;

/// What a fit begins with.
#[derive(Clone, Copy, Debug)]
pub(super) struct Begin {
    /// Usual product of throttle and voltage, and usual speed, rad/s.
    pub drive_v: f64,
    pub speed_rad_s: f64,
    /// Mass, kg.
    pub mass_kg: f64,
    /// Time constants up and down, s, and the standard deviation of their logarithms.
    pub lag_s: [f64; 2],
    pub lag_spread: f64,
}

/// Motors that were fitted.
#[derive(Clone, Debug)]
pub(super) struct Solution {
    pub motor: Motor,
    /// Standard deviations of offset, back-EMF, load, both time constants, delay and drag, SI.
    pub sigma: [f64; FREE],
    /// Sum of squared residuals.
    pub squares: f64,
}

impl Begin {
    fn motor(&self, z: &Vector) -> Motor {
        let (x, w) = (self.drive_v, self.speed_rad_s);
        let by = Params {
            offset_v: z[0] * x,
            back_emf_v_s_per_rad: z[1] * x / w,
            load_v_s2_per_rad2: z[2] * x / (w * w),
        };
        Motor {
            by,
            lag_s: [z[3].exp(), z[4].exp()],
            delay_s: z[5] * DELAY_UNIT_S,
            drag_n_s_per_m: z[6] * self.mass_kg,
        }
    }

    /// Derivatives of the free numbers by those of the fit.
    fn units(&self, motor: &Motor) -> Vector {
        let (x, w) = (self.drive_v, self.speed_rad_s);
        Vector::from([x, x / w, x / (w * w), motor.lag_s[0], motor.lag_s[1], DELAY_UNIT_S, self.mass_kg])
    }

    fn prior(&self) -> (Vector, Vector) {
        let [c, a, b] = SHARES;
        let [up, down] = self.lag_s.map(|lag| (lag.clamp(LAG_S[0], LAG_S[1]).ln(), self.lag_spread));
        let all = [c, a, b, up, down, DELAY, DRAG_PER_S];
        (Vector::from(all.map(|p| p.0)), Vector::from(all.map(|p| p.1)))
    }

    fn bounds(&self) -> [[f64; 2]; FREE] {
        let most = f64::INFINITY;
        let lag = LAG_S.map(f64::ln);
        [[0.0, most], [0.0, most], [0.0, most], lag, lag, [0.0, LONGEST_DELAY_S / DELAY_UNIT_S], [0.0, most]]
    }
}

/// Sums over the observations at one point.
struct Sums {
    /// Gauss-Newton matrix and gradient, over the variance of a residual.
    h: Matrix,
    g: Vector,
    squares: f64,
    variance: f64,
    /// How many times wider the scatter between stretches is than independent residuals would make it: at least 1.
    dispersion: f64,
}

fn all_rows(courses: &[Course], motor: &Motor, of: Voltage) -> Vec<(usize, Row)> {
    courses.iter().enumerate().flat_map(|(i, c)| c.rows(motor, of).into_iter().map(move |r| (i, r))).collect()
}

fn sums(courses: &[Course], begin: &Begin, z: &Vector, of: Voltage) -> Sums {
    let motor = begin.motor(z);
    let units = begin.units(&motor);
    let rows = all_rows(courses, &motor, of);
    let squares: f64 = rows.iter().map(|(_, r)| r.residual * r.residual).sum();
    let variance = (squares / rows.len().max(1) as f64).max(1e-300);
    let (mut h, mut g) = (Matrix::zeros(), Vector::zeros());
    let mut scores: BTreeMap<(usize, usize), Vector> = BTreeMap::new();
    for (course, row) in &rows {
        let slopes = Vector::from(row.slopes).component_mul(&units);
        let score = slopes * (row.residual / variance);
        h += slopes * slopes.transpose() / variance;
        g += score;
        *scores.entry((*course, row.stretch)).or_insert_with(Vector::zeros) += score;
    }
    // Residuals of neighbouring samples go together: scores of whole stretches do not (sandwich estimator, White,
    // Econometrica 50(1), 1982).
    let scatter: Matrix = scores.values().map(|s| s * s.transpose()).sum();
    let wider = h.try_inverse().map_or(1.0, |inverse| (inverse * scatter).trace() / FREE as f64);
    Sums { h, g, squares, variance, dispersion: wider.max(1.0) }
}

/// Fits motors to flights; the prior decides what these do not tell.
pub(super) fn solve(courses: &[Course], begin: &Begin, of: Voltage) -> Solution {
    let (mean, spread) = begin.prior();
    let weight = Matrix::from_diagonal(&spread.map(|s| 1.0 / (s * s)));
    let bounds = begin.bounds();
    let mut z = mean;
    let mut covariance = Matrix::from_diagonal(&spread.map(|s| s * s));
    let mut squares = f64::INFINITY;
    for _ in 0..ITERATIONS {
        let at = sums(courses, begin, &z, of);
        let share = 1.0 / at.dispersion;
        let mut h = at.h * share + weight;
        let mut g = at.g * share + weight * (mean - z);
        // A number at its bound that would leave it stays there.
        for k in 0..FREE {
            let held = (z[k] <= bounds[k][0] && g[k] < 0.0) || (z[k] >= bounds[k][1] && g[k] > 0.0);
            if held {
                h.row_mut(k).fill(0.0);
                h.column_mut(k).fill(0.0);
                (h[(k, k)], g[k]) = (1.0 / (spread[k] * spread[k]), 0.0);
            }
        }
        squares = at.squares;
        let Some(inverse) = h.try_inverse() else { break };
        covariance = inverse;
        let cost = |z: &Vector, squares: f64| {
            let off = z - mean;
            squares * share / at.variance + (off.transpose() * weight * off)[0]
        };
        let before = cost(&z, at.squares);
        let step = covariance * g;
        let mut taken = 1.0;
        let better = (0..12).find_map(|_| {
            let next = Vector::from_fn(|k, _| (z[k] + taken * step[k]).clamp(bounds[k][0], bounds[k][1]));
            let rows = all_rows(courses, &begin.motor(&next), of);
            let sum: f64 = rows.iter().map(|(_, r)| r.residual * r.residual).sum();
            taken *= 0.5;
            (cost(&next, sum) < before).then_some((next, sum))
        });
        let Some((next, sum)) = better else { break };
        let moved = (next - z).component_div(&spread).amax();
        (z, squares) = (next, sum);
        if moved < SMALL {
            break;
        }
    }
    let motor = begin.motor(&z);
    let units = begin.units(&motor);
    let sigma = core::array::from_fn(|k| covariance[(k, k)].max(0.0).sqrt() * units[k]);
    Solution { motor, sigma, squares }
}

/// Share of the variance over flights that motors explain, root mean square of what they do not, and the number of samples.
pub(super) fn explained(courses: &[Course], motor: &Motor, of: Voltage) -> (f64, f64, usize) {
    let rows = all_rows(courses, motor, of);
    let n = rows.len().max(1) as f64;
    let mean = rows.iter().map(|(_, r)| r.measured).sum::<f64>() / n;
    let varies: f64 = rows.iter().map(|(_, r)| (r.measured - mean).powi(2)).sum();
    let left: f64 = rows.iter().map(|(_, r)| r.residual * r.residual).sum();
    (1.0 - left / varies.max(1e-300), (left / n).sqrt(), rows.len())
}
