//! Regression of poses on inertial data of one log: second differences of poses against the inertial readings between them,
//! with all sensor error parameters (scale, skew, offset, lateness, lever arm) as columns.

use super::policy::CROSS_CHECK_S;
use super::replay::STEP_S;
use super::track::Measured;
use nalgebra::{Cholesky, DMatrix, DVector};
use propwash_flight::resample::rotation_vector;
use propwash_trace::math::{quat, vec3};

/// Steps from the middle of a span to either end.
pub(super) fn half_stretch() -> usize {
    (0.5 * CROSS_CHECK_S / STEP_S).round() as usize
}

/// Weights of a hat function over `2 apart + 1` instants: a second difference is the mean of the acceleration under it.
pub(super) fn hat(apart: usize) -> impl Iterator<Item = f64> {
    let square = (apart * apart) as f64;
    (0..=2 * apart).map(move |i| (apart - i.abs_diff(apart)) as f64 / square)
}

/// Rotation of the attitude over a span minus that of the gyroscope, rad, in axes of its end.
pub(super) fn turned_more(span: &[&Measured]) -> [f64; 3] {
    let (Some(first), Some(last)) = (span.first(), span.last()) else { return [0.0; 3] };
    let mut turned = [0.0, 0.0, 0.0, 1.0];
    for pair in span.windows(2) {
        let rate = vec3::scale(vec3::add(pair[0].ang_vel, pair[1].ang_vel), 0.5);
        turned = quat::mul(turned, quat::exp(vec3::scale(rate, STEP_S)));
    }
    let measured = quat::mul(quat::conjugate(first.quat), last.quat);
    rotation_vector(quat::mul(quat::conjugate(turned), measured))
}

/// Fewest instants per unknown.
const PER_UNKNOWN: usize = 5;

/// Rows sharing an instant: spans overlap, and their errors are correlated.
const ROWS_SHARED: f64 = 4.0;

/// Prior standard deviations of sensor errors, from data sheets and mountings: scale and skew, offset (m/s² and rad/s),
/// lateness (s), lever arm (m).
const WIDTHS: [f64; 4] = [0.05, 0.5, 0.02, 0.1];

/// Priors of the parameters of [`bend_of`] and, without a lever arm, of the gyroscope.
pub(super) fn widths() -> [f64; 16] {
    let [scale, offset, late, arm] = WIDTHS;
    core::array::from_fn(|k| match k {
        0..9 => scale,
        9..12 => offset,
        12 => late,
        _ => arm,
    })
}

/// Result of a regression.
pub(super) struct Fit {
    pub values: DVector<f64>,
    /// Standard deviations.
    pub sigma: DVector<f64>,
    /// Root mean square residual.
    pub left: f64,
}

/// Normal equations of a regression with three rows (axes) per instant.
pub(super) struct Regression {
    gram: DMatrix<f64>,
    rows: usize,
}

/// Derivatives of a sensor's contribution to a span by its nuisance parameters.
pub(super) struct Nuisances(pub [[f64; 3]; 13]);

impl Nuisances {
    pub fn none() -> Self {
        Self([[0.0; 3]; 13])
    }

    /// Adds an instant of the span: rotation from the sensor's frame to that of the sum, its reading and the reading's
    /// slope.
    pub fn add(&mut self, frame: [f64; 4], reading: [f64; 3], slope: [f64; 3], weight: f64) {
        let axes: [[f64; 3]; 3] = core::array::from_fn(|k| {
            quat::rotate(frame, core::array::from_fn(|i| f64::from(u8::from(i == k))))
        });
        for (k, axis) in axes.into_iter().enumerate() {
            for (j, r) in reading.into_iter().enumerate() {
                let entry = &mut self.0[3 * k + j];
                *entry = vec3::add(*entry, vec3::scale(axis, weight * r));
            }
            self.0[9 + k] = vec3::add(self.0[9 + k], vec3::scale(axis, weight));
        }
        self.0[12] = vec3::add(self.0[12], vec3::scale(quat::rotate(frame, slope), weight));
    }
}

impl Regression {
    pub fn new(unknowns: usize) -> Self {
        Self { gram: DMatrix::zeros(unknowns + 1, unknowns + 1), rows: 0 }
    }

    /// Adds one instant: the nuisance columns and their target.
    pub fn add(&mut self, nuisances: impl IntoIterator<Item = [f64; 3]>, target: [f64; 3]) {
        let columns: Vec<[f64; 3]> = nuisances.into_iter().chain([target]).collect();
        for axis in 0..3 {
            let row = DVector::from_iterator(columns.len(), columns.iter().map(|c| c[axis]));
            self.gram.ger(1.0, &row, &row, 1.0);
            self.rows += 1;
        }
    }

    /// Least squares on these columns, with priors about zero of standard deviations `widths` (infinite: free). `None` with
    /// too few rows.
    pub fn fit(&self, columns: &[usize], widths: &[f64]) -> Option<Fit> {
        let free = self.held(columns, &vec![0.0; columns.len()])?;
        let weight = |w: &f64| ROWS_SHARED * (free.left / w).powi(2);
        self.held(columns, &widths.iter().map(weight).collect::<Vec<f64>>())
    }

    /// The same with weights added to the diagonal.
    fn held(&self, columns: &[usize], weights: &[f64]) -> Option<Fit> {
        let n = columns.len();
        let last = self.gram.nrows() - 1;
        if self.rows < 3 * PER_UNKNOWN * n {
            return None;
        }
        let mut gram = DMatrix::from_fn(n, n, |i, j| self.gram[(columns[i], columns[j])]);
        // Ridge: a nuisance parameter that the flight does not excite stays at zero.
        let ridge = 1e-9 * gram.trace().max(1e-12);
        for k in 0..n {
            gram[(k, k)] += ridge + weights[k];
        }
        let across = DVector::from_fn(n, |i, _| self.gram[(columns[i], last)]);
        let factor = Cholesky::new(gram)?;
        let values = factor.solve(&across);
        let left = (self.gram[(last, last)] - across.dot(&values)).max(0.0) / (self.rows - n) as f64;
        let sigma = factor.inverse().diagonal().map(|v| (ROWS_SHARED * left * v).sqrt());
        Some(Fit { values, sigma, left: left.sqrt() })
    }
}

/// Second derivative of the path around the middle of a span (m/s², body axes there, without gravity).
pub(super) struct Bend {
    pub whole: [f64; 3],
    /// Its excess over the accelerometer.
    pub more: [f64; 3],
    /// Derivatives by the accelerometer's parameters: scale and skew (9), offset (3), lateness, lever arm (3).
    pub columns: Vec<[f64; 3]>,
}

/// Compares poses and accelerometer over a span.
pub(super) fn bend_of(span: &[&Measured], felt: &[[f64; 3]], apart: usize, gravity: [f64; 3]) -> Bend {
    let time = apart as f64 * STEP_S;
    let [a, b, c] = [0, apart, 2 * apart].map(|i| span[i]);
    let bend: [f64; 3] =
        core::array::from_fn(|k| (a.pos[k] - 2.0 * b.pos[k] + c.pos[k]) / (time * time) - gravity[k]);
    let mut nuisances = Nuisances::none();
    // The weights at both ends are zero.
    for (i, weight) in hat(apart).enumerate().take(2 * apart).skip(1) {
        let frame = quat::mul(quat::conjugate(b.quat), span[i].quat);
        let slope = vec3::scale(vec3::sub(felt[i + 1], felt[i - 1]), 0.5 / STEP_S);
        nuisances.add(frame, felt[i], slope, weight);
    }
    // A point away from the accelerometer has its own acceleration (lever arm).
    let body = |v: [f64; 3]| quat::rotate_inverse(b.quat, v);
    let arm = (0..3).map(|k| {
        let mut unit = [0.0; 3];
        unit[k] = 1.0;
        let at = |m: &Measured| quat::rotate(m.quat, unit);
        let bend = vec3::add(vec3::sub(at(a), vec3::scale(at(b), 2.0)), at(c));
        body(vec3::scale(bend, 1.0 / (time * time)))
    });
    let columns: Vec<[f64; 3]> = nuisances.0.into_iter().chain(arm).collect();
    let whole = body(bend);
    let more = [0, 4, 8].iter().fold(whole, |left, k| vec3::sub(left, columns[*k]));
    Bend { whole, more, columns }
}
