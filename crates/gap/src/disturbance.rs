//! Process noise: the disturbances of every window of a log, and the windows with them eliminated.
//!
//! The nuisance parameters of a window, its initial state and its disturbances, are eliminated (Schur complement). A
//! disturbance has a part that is constant over the window and a part that changes every 50 ms. The first persists from
//! window to window and decays, as turbulence does: what earlier windows say about it is carried along (Kalman filter,
//! conditional on the parameters). Without that, a pilot who counters turbulence would make thrust look weak: in a hover,
//! rotors speed up just where air pushes down (bias of closed-loop identification: Ljung, "System identification", 2nd ed.
//! 1999, ch. 13).

use super::fit::{Linear, START_STATE, Starts, Window, own_len};
use super::replay::TICK_S;
use super::track::Measured;
use nalgebra::{Cholesky, Const, DMatrix, DVector, Matrix6, Matrix6xX};
use propwash_trace::math::quat;
use rayon::prelude::*;

/// A window with its nuisance parameters eliminated: χ²(δ) = c − 2 gᵀδ + δᵀ H δ.
#[derive(Clone, Debug)]
pub(crate) struct Reduced {
    /// Index of the log.
    pub log: usize,
    pub h: DMatrix<f64>,
    pub g: DVector<f64>,
    pub c: f64,
    /// Occam factor: half the log of the ratio of posterior to prior precision determinants of the nuisance parameters.
    pub occam: f64,
}

/// Standard deviations of the disturbances: horizontal and vertical force (m/s²), torque about x/y and about z (rad/s²).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Disturbance {
    /// Of the part that is constant over a window.
    pub common: [f64; 4],
    /// Of the part that changes every [`super::replay::PUSH_STEPS`].
    pub quick: [f64; 4],
    /// Share of the first part that persists into the next window.
    pub kept: [f64; 4],
    /// Standard deviation of a window's attitude about the measured one, rad. Where the attitude is an input, this error is
    /// constant over the window.
    pub attitude_rad: f64,
}

/// Index of the size (of the four) of each of the six disturbances.
const SIZE_OF: [usize; 6] = [0, 0, 1, 2, 2, 3];
/// Upper bound on the persistence of a disturbance: a constant one is an effect.
const MOST_KEPT: f64 = 0.95;
/// Prior standard deviations of a window's initial state about its start value: m, m/s, rad, rad/s. They are wide, since the
/// sensors' samples determine the state: a world of the motion capture that leans by 0.02 rad shifts a true position 4 m from
/// the origin by 80 mm, and with 0.1 m here that lean was estimated at a fifth of its size.
const START: [f64; 4] = [10.0, 10.0, 1.0, 10.0];

/// Lower bound on the error of a measured attitude, rad.
const LEAST_TURN_RAD: f64 = 1e-3;

impl Disturbance {
    /// Prior sizes, before any data.
    pub fn unknown() -> Self {
        let sizes = [0.2, 0.2, 2.0, 1.0];
        Self { common: sizes, quick: sizes, kept: [0.0; 4], attitude_rad: START[2] }
    }

    /// Whether all sizes agree within 3 %.
    pub fn near(&self, other: &Self) -> bool {
        let pairs = self.common.iter().zip(&other.common).chain(self.quick.iter().zip(&other.quick));
        let attitude = (self.attitude_rad / other.attitude_rad - 1.0).abs() < 0.03;
        attitude && pairs.into_iter().all(|(a, b)| (a / b - 1.0).abs() < 0.03)
    }

    /// Root mean square of the common parts: force (m/s²), torque (rad/s²).
    pub fn sizes(&self) -> (f64, f64) {
        let [f, fz, t, tz] = self.common;
        let mean = |a: f64, b: f64| ((2.0 * a * a + b * b) / 3.0).sqrt();
        (mean(f, fz), mean(t, tz))
    }

    /// Prior standard deviations of a window's initial state about the measured state: m, m/s, rad, rad/s.
    fn start(&self) -> [f64; 4] {
        let [position, velocity, _, rate] = START;
        [position, velocity, self.attitude_rad, rate]
    }

    /// Prior variance of the common part of each component.
    fn common_variance(&self) -> [f64; 6] {
        SIZE_OF.map(|s| self.common[s].powi(2))
    }
}

/// A window with its initial state and quick disturbances eliminated: the Gram matrix of [common disturbance (6) |
/// parameters | residual].
pub(crate) struct Core {
    gram: DMatrix<f64>,
    /// Occam factor of what was eliminated.
    occam: f64,
}

/// Prediction of a window's common disturbance: its covariance, and its mean as a linear function of the parameters, (6,
/// [slope by every parameter | −value]), in the column order of a Gram matrix.
struct Expected {
    covariance: Matrix6<f64>,
    /// `None` where it is zero: no window goes before.
    mean: Option<Matrix6xX<f64>>,
}

impl Expected {
    fn nothing(disturbance: &Disturbance) -> Self {
        let covariance = Matrix6::from_diagonal(&disturbance.common_variance().into());
        Self { covariance, mean: None }
    }
}

/// A block of a matrix from (row, column) on, copied column by column.
fn block(m: &DMatrix<f64>, (row, column): (usize, usize), (rows, columns): (usize, usize)) -> DMatrix<f64> {
    let mut values = Vec::with_capacity(rows * columns);
    for c in column..column + columns {
        let from = c * m.nrows() + row;
        values.extend_from_slice(&m.as_slice()[from..from + rows]);
    }
    DMatrix::from_vec(rows, columns, values)
}

impl Core {
    /// With other parameters: column `k` is that of a parameter, times a factor, for each (parameter, factor) of `columns`.
    pub fn with_columns(&self, columns: &[(usize, f64)]) -> Self {
        let before = (0..6).map(|c| (c, 1.0));
        let places: Vec<(usize, f64)> = before
            .chain(columns.iter().map(|(k, factor)| (6 + k, *factor)))
            .chain([(self.gram.ncols() - 1, 1.0)])
            .collect();
        let at = |r: usize, c: usize| {
            let ((a, x), (b, y)) = (places[r], places[c]);
            self.gram[(a, b)] * x * y
        };
        Self { gram: DMatrix::from_fn(places.len(), places.len(), at), occam: self.occam }
    }

    /// Remaining columns in the rows of the common disturbance, with the prediction subtracted; and the Cholesky factor of
    /// its posterior precision.
    fn beside(&self, expected: &Expected) -> Option<(DMatrix<f64>, Cholesky<f64, Const<6>>)> {
        let common: Matrix6<f64> = self.gram.fixed_view::<6, 6>(0, 0).into_owned();
        let mut out = block(&self.gram, (0, 6), (6, self.gram.ncols() - 6));
        if let Some(mean) = &expected.mean {
            out += common * mean;
        }
        let precision = Cholesky::new(expected.covariance)?.inverse() + common;
        Some((out, Cholesky::new(precision)?))
    }

    /// Prediction for the next window, given `expected` for this one.
    fn next(&self, expected: &Expected, disturbance: &Disturbance) -> Option<Expected> {
        let (beside, factor) = self.beside(expected)?;
        let kept = Matrix6::from_diagonal(&SIZE_OF.map(|s| disturbance.kept[s]).into());
        let all = Matrix6::from_diagonal(&disturbance.common_variance().into());
        let covariance = kept * (factor.inverse() - all) * kept + all;
        let told = factor.solve(&beside);
        let mean = match &expected.mean {
            Some(mean) => kept * (mean - told),
            None => kept * -told,
        };
        Some(Expected { covariance, mean: Some(mean) })
    }

    /// Eliminates the common disturbance.
    fn reduce(&self, expected: &Expected, log: usize) -> Option<Reduced> {
        let (mut beside, factor) = self.beside(expected)?;
        let n = self.gram.ncols() - 6;
        let mut rest = block(&self.gram, (6, 6), (n, n));
        // MᵀB + BᵀM − MᵀCM, with B = G + CM.
        if let Some(mean) = &expected.mean {
            let common: Matrix6<f64> = self.gram.fixed_view::<6, 6>(0, 0).into_owned();
            let twice = &beside - (common * mean) * 0.5;
            let across = mean.tr_mul(&twice);
            rest += across.transpose();
            rest += across;
        }
        factor.l_dirty().solve_lower_triangular_mut(&mut beside);
        rest.gemm(-1.0, &beside.transpose(), &beside, 1.0);
        let narrower: f64 = factor.l_dirty().diagonal().map(f64::ln).sum();
        let prior: f64 = Cholesky::new(expected.covariance)?.l_dirty().diagonal().map(f64::ln).sum();
        let p = n - 1;
        Some(Reduced {
            log,
            h: block(&rest, (0, 0), (p, p)),
            g: rest.view((0, p), (p, 1)).column(0).into_owned(),
            c: rest[(p, p)],
            occam: self.occam + narrower + prior,
        })
    }
}

/// Index of disturbance `r` of interval `i` among a window's nuisance parameters.
fn place(i: usize, r: usize) -> usize {
    START_STATE + 6 * i + r
}

/// Cholesky factor of a symmetric matrix in its lower triangle, what is above it left as it was; `None` where the matrix is
/// not positive definite. The arithmetic is that of `nalgebra::Cholesky`, in its order, over plain slices.
fn lower_factor(mut m: DMatrix<f64>) -> Option<DMatrix<f64>> {
    let n = m.nrows();
    for j in 0..n {
        let (before, rest) = m.as_mut_slice().split_at_mut(j * n);
        let column = &mut rest[j..n];
        for k in 0..j {
            let other = &before[k * n + j..(k + 1) * n];
            let factor = -other[0];
            for (x, l) in column.iter_mut().zip(other) {
                *x += factor * l;
            }
        }
        let diagonal = column[0];
        if !(diagonal > 0.0) {
            return None;
        }
        let root = diagonal.sqrt();
        column[0] = root;
        column[1..].iter_mut().for_each(|x| *x /= root);
    }
    Some(m)
}

/// Inverse of a lower triangular matrix; entries above the diagonal are ignored.
fn inverse_of_lower(l: &DMatrix<f64>) -> DMatrix<f64> {
    let n = l.nrows();
    let mut out = DMatrix::zeros(n, n);
    for c in 0..n {
        // Column c of the unit matrix; forward substitution starts at its one.
        let column = &mut out.as_mut_slice()[c * n..(c + 1) * n];
        column[c] = 1.0;
        for k in c..n {
            let below = &l.as_slice()[k * n..(k + 1) * n];
            let x = column[k] / below[k];
            column[k] = x;
            for (sum, l) in column[k + 1..].iter_mut().zip(&below[k + 1..]) {
                *sum -= l * x;
            }
        }
    }
    out
}

/// Posterior of a window's nuisance parameters: mean, and the inverse of the Cholesky factor L of the precision. The
/// covariance is L⁻ᵀ L⁻¹.
pub(crate) struct Own {
    pub mean: DVector<f64>,
    pub inverse: DMatrix<f64>,
}

impl Own {
    /// Second moment of nuisance parameter `k`.
    fn second_moment(&self, k: usize) -> f64 {
        self.mean[k].powi(2) + self.inverse.column(k).rows_range(k..).norm_squared()
    }

    /// Sum of component `r` of the disturbances.
    fn sum(&self, pushes: usize, r: usize) -> f64 {
        (0..pushes).map(|i| self.mean[place(i, r)]).sum()
    }

    /// Variance of that sum.
    fn variance_of_sum(&self, pushes: usize, r: usize) -> f64 {
        let mut sum = self.inverse.column(place(0, r)).into_owned();
        for i in 1..pushes {
            sum += self.inverse.column(place(i, r));
        }
        sum.norm_squared()
    }
}

/// Adds the prior precision of a window's initial state, the first of its nuisance parameters.
fn add_prior_of_start(precision: &mut DMatrix<f64>, disturbance: &Disturbance) {
    let start = disturbance.start();
    for k in 0..START_STATE {
        precision[(k, k)] += start[k / 3].powi(-2);
    }
}

impl Window {
    /// Cholesky factor of the posterior precision of the nuisance parameters, prior included.
    fn own(&self, common_variance: &[f64; 6], disturbance: &Disturbance) -> Option<DMatrix<f64>> {
        let len = own_len(self.pushes);
        let mut own = block(&self.gram, (0, 0), (len, len));
        add_prior_of_start(&mut own, disturbance);
        self.add_prior_of_pushes(&mut own, START_STATE, common_variance, disturbance);
        lower_factor(own)
    }

    /// Adds the prior precision of the pushes, whose first has number `first`: of one component they have the covariance common² 11ᵀ +
    /// quick² I.
    fn add_prior_of_pushes(
        &self,
        precision: &mut DMatrix<f64>,
        first: usize,
        common_variance: &[f64; 6],
        disturbance: &Disturbance,
    ) {
        let n = self.pushes as f64;
        for r in 0..6 {
            let quick = disturbance.quick[SIZE_OF[r]];
            let apart = quick.powi(-2);
            let together = 1.0 / (quick * quick + n * common_variance[r]);
            for i in 0..self.pushes {
                for j in 0..self.pushes {
                    let both = (together - apart) / n + if i == j { apart } else { 0.0 };
                    precision[(first + 6 * i + r, first + 6 * j + r)] += both;
                }
            }
        }
    }

    /// Eliminates its initial state and its quick disturbances.
    fn core(&self, disturbance: &Disturbance) -> Option<Core> {
        let len = own_len(self.pushes);
        let n = self.gram.nrows() - len;
        // The column of a common disturbance is the sum of the columns of its intervals.
        let mut of_common = DMatrix::zeros(self.gram.nrows(), 6);
        for r in 0..6 {
            for i in 0..self.pushes {
                let mut sum = of_common.column_mut(r);
                sum += self.gram.column(place(i, r));
            }
        }
        let mut common = Matrix6::zeros();
        for r in 0..6 {
            for i in 0..self.pushes {
                common.set_row(r, &(common.row(r) + of_common.row(place(i, r))));
            }
        }
        let mut gram = DMatrix::zeros(6 + n, 6 + n);
        gram.fixed_view_mut::<6, 6>(0, 0).copy_from(&common);
        let across = of_common.rows(len, n);
        gram.view_mut((6, 0), (n, 6)).copy_from(&across);
        gram.view_mut((0, 6), (6, n)).copy_from(&across.transpose());
        gram.view_mut((6, 6), (n, n)).copy_from(&self.gram.view((len, len), (n, n)));

        let factor = self.own(&[0.0; 6], disturbance)?;
        let mut beside = DMatrix::zeros(len, 6 + n);
        beside.view_mut((0, 0), (len, 6)).copy_from(&of_common.rows(0, len));
        beside.view_mut((0, 6), (len, n)).copy_from(&self.gram.view((0, len), (len, n)));
        let x = inverse_of_lower(&factor) * beside;
        gram.gemm(-1.0, &x.transpose(), &x, 1.0);
        let narrower: f64 = factor.diagonal().map(f64::ln).sum();
        let start: f64 = disturbance.start().iter().map(|s| 3.0 * s.ln()).sum();
        let quick: f64 = SIZE_OF.iter().map(|s| self.pushes as f64 * disturbance.quick[*s].ln()).sum();
        Some(Core { gram, occam: narrower + start + quick })
    }

    /// Posterior of the nuisance parameters with the parameters at `delta`, from this window alone.
    pub fn own_solution(&self, disturbance: &Disturbance, delta: &[f64]) -> Option<Own> {
        let len = own_len(self.pushes);
        let n = self.gram.nrows() - len - 1;
        let factor = self.own(&disturbance.common_variance(), disturbance)?;
        let mut b = self.gram.view((0, len + n), (len, 1)).column(0).into_owned();
        b -= self.gram.view((0, len), (len, n)) * DVector::from_column_slice(delta);
        let inverse = inverse_of_lower(&factor);
        let mean = inverse.tr_mul(&(&inverse * b));
        Some(Own { mean, inverse })
    }

    /// What it says of further pushes in its intervals, with the parameters at `delta`, its initial state and its disturbances eliminated:
    /// their information, and that times the likeliest pushes; order (interval, component), the components those of the disturbances.
    pub fn pushes(&self, disturbance: &Disturbance, delta: &[f64]) -> Option<(DMatrix<f64>, DVector<f64>)> {
        let len = own_len(self.pushes);
        let (n, m) = (self.gram.nrows() - len - 1, len - START_STATE);
        let mut of_start = block(&self.gram, (0, 0), (START_STATE, START_STATE));
        add_prior_of_start(&mut of_start, disturbance);
        let mut score = self.gram.view((0, len + n), (len, 1)).column(0).into_owned();
        if !delta.is_empty() {
            score -= self.gram.view((0, len), (len, n)) * DVector::from_column_slice(delta);
        }
        let across = block(&self.gram, (0, START_STATE), (START_STATE, m));
        let factor = Cholesky::new(of_start)?;
        let information =
            block(&self.gram, (START_STATE, START_STATE), (m, m)) - across.tr_mul(&factor.solve(&across));
        let known = score.rows(0, START_STATE).into_owned();
        let score = score.rows(START_STATE, m) - across.tr_mul(&factor.solve(&known));
        let mut both = information.clone();
        self.add_prior_of_pushes(&mut both, 0, &disturbance.common_variance(), disturbance);
        let factor = Cholesky::new((&both + both.transpose()) * 0.5)?;
        let p = &information - &information * factor.solve(&information);
        let b = &score - &information * factor.solve(&score);
        Some(((&p + p.transpose()) * 0.5, b))
    }

    /// Its initial state with the nuisance parameters at `own`.
    pub fn moved(&self, own: &DVector<f64>) -> Measured {
        let mut start = self.start;
        for k in 0..3 {
            start.pos[k] += own[k];
            start.vel[k] += own[3 + k];
            start.ang_vel[k] += own[9 + k];
        }
        start.quat = quat::normalize(quat::mul(start.quat, quat::exp([own[6], own[7], own[8]])));
        start
    }

    /// Mean of the disturbance over the window, and its variance due to sensor noise.
    pub fn push_estimate(&self, disturbance: &Disturbance, delta: &[f64]) -> Option<([f64; 6], [f64; 6])> {
        let own = self.own_solution(disturbance, delta)?;
        let n = self.pushes as f64;
        let mean = |r: usize| own.sum(self.pushes, r) / n;
        let variance = |r: usize| own.variance_of_sum(self.pushes, r) / (n * n);
        Some((core::array::from_fn(mean), core::array::from_fn(variance)))
    }
}

impl Linear {
    /// Whether window `i` starts where the previous one ends.
    fn goes_on(&self, i: usize) -> bool {
        let length = (self.horizon_s / TICK_S).round() as usize;
        i > 0 && {
            let (a, b) = (&self.windows[i - 1], &self.windows[i]);
            a.log == b.log && a.from + length == b.from
        }
    }

    /// Reduces all windows, each with the prediction from the windows before.
    pub fn reduce(&self, disturbance: &Disturbance) -> Vec<Reduced> {
        self.reduce_cores(&self.cores(disturbance), disturbance)
    }

    /// All windows with their initial states and quick disturbances eliminated.
    pub fn cores(&self, disturbance: &Disturbance) -> Vec<Option<Core>> {
        self.windows.par_iter().map(|w| w.core(disturbance)).collect()
    }

    /// Reduces what [`Self::cores`] left of the windows: quick disturbances have the sizes that they had there.
    pub fn reduce_cores(&self, cores: &[Option<Core>], disturbance: &Disturbance) -> Vec<Reduced> {
        let mut expected: Vec<Expected> = Vec::with_capacity(cores.len());
        for i in 0..cores.len() {
            let before = if self.goes_on(i) { cores[i - 1].as_ref() } else { None };
            let next = before.zip(expected.last()).and_then(|(core, e)| core.next(e, disturbance));
            expected.push(next.unwrap_or_else(|| Expected::nothing(disturbance)));
        }
        let all = cores.par_iter().zip(&expected).zip(&self.windows);
        all.filter_map(|((core, e), w)| core.as_ref()?.reduce(e, w.log)).collect()
    }

    /// Initial states of the windows with every log's parameters at `deltas`.
    pub fn starts(&self, disturbance: &Disturbance, deltas: &[Vec<f64>]) -> Starts {
        let one = |w: &Window| {
            let own = w.own_solution(disturbance, &deltas[w.log])?;
            Some(((w.log, w.from), w.moved(&own.mean)))
        };
        self.windows.par_iter().filter_map(one).collect()
    }

    /// One step of expectation maximisation for the disturbances' sizes, with every log's parameters at `deltas`; and their
    /// persistence, from the correlation of consecutive windows.
    pub fn disturbance(&self, now: &Disturbance, deltas: &[Vec<f64>]) -> Disturbance {
        self.disturbance_of(now, |i| &deltas[self.windows[i].log])
    }

    /// The same with the parameters of every window.
    pub fn disturbance_of<'d>(
        &self,
        now: &Disturbance,
        deltas: impl Fn(usize) -> &'d [f64] + Sync,
    ) -> Disturbance {
        // For each component: mean square of the disturbances' sum over their number, and of the deviations from their
        // mean; the estimate of their mean, and its shrinkage towards zero (which biases the lag product).
        let solved: Vec<Option<(f64, [[f64; 4]; 6])>> = self
            .windows
            .par_iter()
            .enumerate()
            .map(|(i, w)| {
                let own = w.own_solution(now, deltas(i))?;
                let n = w.pushes as f64;
                let turned = (6..9).map(|k| own.second_moment(k)).sum::<f64>() / 3.0;
                let sums = core::array::from_fn(|r| {
                    let (sum, variance) = (own.sum(w.pushes, r), own.variance_of_sum(w.pushes, r));
                    let all = (sum * sum + variance) / n;
                    let trace: f64 = (0..w.pushes).map(|i| own.second_moment(place(i, r))).sum();
                    let size = SIZE_OF[r];
                    let prior = now.common[size].powi(2) + now.quick[size].powi(2) / n;
                    let share = (1.0 - variance / (n * n) / prior).max(0.0);
                    [all, (trace - all) / (n - 1.0).max(1.0), sum / n, share]
                });
                Some((turned, sums))
            })
            .collect();
        let parts: Vec<Option<[[f64; 4]; 6]>> = solved.iter().map(|s| s.map(|s| s.1)).collect();
        let pushes = self.windows.first().map_or(1, |w| w.pushes) as f64;
        let known: Vec<&[[f64; 4]; 6]> = parts.iter().flatten().collect();
        let count = known.len().max(1) as f64;
        let mut out = Disturbance { common: [0.0; 4], quick: [0.0; 4], kept: [0.0; 4], ..*now };
        let mut members = [0.0; 4];
        let mut lag = [[0.0; 2]; 4];
        for r in 0..6 {
            let mean = |which: usize| known.iter().map(|p| p[r][which]).sum::<f64>() / count;
            let (together, apart) = (mean(0), mean(1));
            let size = SIZE_OF[r];
            out.common[size] += ((together - apart) / pushes).max(0.0);
            out.quick[size] += apart;
            members[size] += 1.0;
            for i in (1..parts.len()).filter(|i| self.goes_on(*i)) {
                if let (Some(a), Some(b)) = (&parts[i - 1], &parts[i]) {
                    lag[size][0] += a[r][2] * b[r][2];
                    lag[size][1] += a[r][3] * b[r][3];
                }
            }
        }
        if self.windows.iter().all(|w| w.rows_of[1] == 0) {
            let turned: f64 = solved.iter().flatten().map(|s| s.0).sum::<f64>() / count;
            out.attitude_rad = turned.sqrt().max(LEAST_TURN_RAD);
        }
        const LEAST: [f64; 4] = [2e-3, 2e-3, 2e-2, 2e-2];
        for s in 0..4 {
            out.common[s] = (out.common[s] / members[s]).sqrt().max(LEAST[s]);
            out.quick[s] = (out.quick[s] / members[s]).sqrt().max(LEAST[s]);
            let [product, share] = lag[s];
            let expected = share * now.common[s].powi(2);
            if expected > 0.0 {
                out.kept[s] = (product / expected).clamp(0.0, MOST_KEPT);
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use propwash_rollout::random::{Key, purpose};

    const PUSHES: usize = 3;
    const PARAMETERS: usize = 2;
    const WINDOWS: usize = 4;

    /// A window whose Gram matrix comes from random rows.
    fn window(seed: u64) -> Window {
        let own = own_len(PUSHES);
        let width = own + PARAMETERS + 1;
        let key = Key { seed, world: 0, drone: 0, step: 0, purpose: purpose("window test") };
        let mut dice = key.stream();
        let n_rows = 60;
        let rows = DMatrix::from_fn(n_rows, width, |_, _| dice.normal());
        let start = Measured { pos: [0.0; 3], quat: [0.0, 0.0, 0.0, 1.0], vel: [0.0; 3], ang_vel: [0.0; 3] };
        let from = seed as usize * 10 * super::super::replay::PUSH_STEPS;
        let (gram, rows_of) = (rows.transpose() * &rows, [n_rows, 0, 0, 0]);
        Window { log: 0, from, start, gram, kept: None, rows_of, n_rows, pushes: PUSHES }
    }

    #[test]
    fn further_pushes_are_as_likely_as_with_the_disturbances_solved_for() {
        let (window, disturbance) = (window(3), Disturbance::unknown());
        let delta = [0.3, -0.2];
        let (information, score) = window.pushes(&disturbance, &delta).unwrap();
        // χ² with the nuisance parameters at their best, up to a constant, by moving the residual by the pushes.
        let len = own_len(PUSHES);
        let last = window.gram.nrows() - 1;
        let left = |pushes: &DVector<f64>| {
            let mut sum = DVector::zeros(last + 1);
            (0..PARAMETERS).for_each(|k| sum[len + k] = -delta[k]);
            (0..6 * PUSHES).for_each(|i| sum[START_STATE + i] = -pushes[i]);
            sum[last] = 1.0;
            let column = &window.gram * &sum;
            let own = column.rows(0, len).into_owned();
            let factor = window.own(&disturbance.common_variance(), &disturbance).unwrap();
            sum.dot(&column) - (inverse_of_lower(&factor) * own).norm_squared()
        };
        let pushes = DVector::from_fn(6 * PUSHES, |i, _| (0.7 * i as f64).sin());
        let expected = left(&pushes) - left(&DVector::zeros(6 * PUSHES));
        let given = pushes.dot(&(&information * &pushes)) - 2.0 * score.dot(&pushes);
        assert!((given - expected).abs() < 1e-8 * expected.abs().max(1.0), "{given} {expected}");
    }

    #[test]
    fn the_factor_is_that_of_nalgebra_to_the_last_bit() {
        for seed in 0..4 {
            let gram = window(seed).gram;
            let (own, known) = (lower_factor(gram.clone()).unwrap(), Cholesky::new(gram).unwrap());
            assert_eq!(own.lower_triangle(), known.l());
        }
        assert!(lower_factor(DMatrix::from_diagonal_element(3, 3, -1.0)).is_none());
        assert!(lower_factor(DMatrix::from_diagonal_element(3, 3, f64::NAN)).is_none());
    }

    #[test]
    fn windows_one_after_the_other_are_as_likely_as_all_at_once() {
        let windows: Vec<Window> = (0..WINDOWS as u64).map(window).collect();
        let horizon_s = windows[1].from as f64 * TICK_S;
        let disturbance = Disturbance {
            common: [0.3, 0.5, 0.3, 0.3],
            quick: [0.2, 0.4, 0.2, 0.2],
            kept: [0.7, 0.8, 0.3, 0.9],
            attitude_rad: START[2],
        };
        let linear =
            Linear { windows, at: vec![0.0; PARAMETERS], apart: Vec::new(), horizon_s, noise: Vec::new() };
        let reduced = linear.reduce(&disturbance);

        // The nuisance parameters of all windows at once, with the covariance of a persistent disturbance.
        let own = own_len(PUSHES);
        let len = own * WINDOWS;
        let mut prior = DMatrix::zeros(len, len);
        for a in 0..WINDOWS {
            for k in 0..START_STATE {
                prior[(a * own + k, a * own + k)] = START[k / 3].powi(2);
            }
            for (r, size) in SIZE_OF.into_iter().enumerate() {
                let Disturbance { common, quick, kept, .. } = disturbance;
                for b in 0..WINDOWS {
                    let stays = common[size].powi(2) * kept[size].powi((a as i32 - b as i32).abs());
                    for i in 0..PUSHES {
                        for j in 0..PUSHES {
                            let same = if a == b && i == j { quick[size].powi(2) } else { 0.0 };
                            prior[(a * own + place(i, r), b * own + place(j, r))] = stays + same;
                        }
                    }
                }
            }
        }
        let precision = prior.clone().try_inverse().unwrap();
        let mut all = precision;
        let mut beside = DMatrix::zeros(len, PARAMETERS + 1);
        let mut rest = DMatrix::zeros(PARAMETERS + 1, PARAMETERS + 1);
        for (a, w) in linear.windows.iter().enumerate() {
            let mut block = all.view_mut((a * own, a * own), (own, own));
            block += w.gram.view((0, 0), (own, own));
            beside
                .view_mut((a * own, 0), (own, PARAMETERS + 1))
                .copy_from(&w.gram.view((0, own), (own, PARAMETERS + 1)));
            rest += w.gram.view((own, own), (PARAMETERS + 1, PARAMETERS + 1));
        }
        let factor = Cholesky::new(all).unwrap();
        rest -= beside.transpose() * factor.solve(&beside);
        let occam = factor.l_dirty().diagonal().map(f64::ln).sum()
            + 0.5 * Cholesky::new(prior).unwrap().l_dirty().diagonal().map(|d| 2.0 * f64::ln(d)).sum();

        let c: f64 = reduced.iter().map(|r| r.c).sum();
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-8 * a.abs().max(1.0), "{a} {b}");
        near(c, rest[(PARAMETERS, PARAMETERS)]);
        near(reduced.iter().map(|r| r.occam).sum(), occam);
        for k in 0..PARAMETERS {
            near(reduced.iter().map(|r| r.g[k]).sum(), rest[(k, PARAMETERS)]);
            for j in 0..PARAMETERS {
                near(reduced.iter().map(|r| r.h[(k, j)]).sum(), rest[(k, j)]);
            }
        }
        // Windows that are not consecutive are independent.
        let mut apart = linear;
        apart.windows.iter_mut().for_each(|w| w.from *= 2);
        let alone = Disturbance { kept: [0.0; 4], ..disturbance };
        let (a, b) = (apart.reduce(&disturbance), apart.reduce(&alone));
        assert!(a.iter().zip(&b).all(|(a, b)| a.c == b.c && a.occam == b.occam));
        assert!((a.iter().map(|r| r.c).sum::<f64>() - c).abs() > 1e-6 * c);
    }
}
