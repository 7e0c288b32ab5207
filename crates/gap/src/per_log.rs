//! What may differ between logs: clocks, biases and offsets of sensors, wind, battery.
//!
//! All logs of a diagnosis have the same vehicle, but not necessarily the same instruments and weather. Every such
//! parameter has, besides the value shared by all logs, a deviation per log. The deviations sum to zero, so that what the
//! logs have in common is an ordinary effect, to be found or not. They are eliminated from the sum over the logs like the
//! nuisance parameters of a window (Schur complement).

use super::GapError;
use super::disturbance::Reduced;
use super::fit::{Linear, Prepared};
use super::model::{Enters, Model, Parameter};
use super::policy::{CERTAIN_ALONE_NATS, DIFFERS_KNOWN, DIFFERS_SIGMAS, SMOOTHED_TIMING_APART};
use super::solve::Solution;
use super::verdict::OfOneLog;
use nalgebra::{Cholesky, DMatrix, DVector};
use propwash_physics::effects::nature;

/// Prior precision of the mean of all deviations over that of a single one: holds the mean at zero.
const HELD: f64 = 1e6;

/// Parameter values: those shared by all logs, and each log's deviation from them, shape (log, parameter).
#[derive(Clone, Debug)]
pub(crate) struct Values {
    pub shared: Vec<f64>,
    pub apart: Vec<Vec<f64>>,
}

impl From<Vec<f64>> for Values {
    fn from(shared: Vec<f64>) -> Self {
        Self { shared, apart: Vec::new() }
    }
}

impl Values {
    /// Values of one log.
    pub fn of(&self, log: usize) -> Vec<f64> {
        of_log(&self.shared, &self.apart, log)
    }
}

/// Values of a log, from the shared ones and each log's deviation; `apart` may be empty.
pub(super) fn of_log(shared: &[f64], apart: &[Vec<f64>], log: usize) -> Vec<f64> {
    match apart.get(log) {
        Some(apart) => shared.iter().zip(apart).map(|(v, d)| v + d).collect(),
        None => shared.to_vec(),
    }
}

impl Model {
    /// Parameters that may differ when there are so many logs.
    pub fn per_log(&self, logs: usize) -> Vec<usize> {
        let differs =
            |k: &usize| nature(self.candidates[self.parameters[*k].candidate].kind).differs_between_logs;
        (0..self.parameters.len()).filter(|k| logs > 1 && differs(k)).collect()
    }
}

/// Parameters in which the logs of a solution differ significantly.
pub(super) fn differences(
    logs: &[Prepared],
    model: &Model,
    solution: &Solution,
) -> Result<Vec<OfOneLog>, GapError> {
    if logs.len() < 2 {
        return Ok(Vec::new());
    }
    let all = Information::new(model, &solution.linear, &solution.reduced, |_| true)?;
    let Some(covariance) = solution.evidence(model)?.covariance(&solution.set) else { return Ok(Vec::new()) };
    let sigmas = all.sigmas(&covariance, solution.dispersion);
    let mut out = Vec::new();
    for (log, p) in logs.iter().enumerate() {
        let values = solution.values_of(log);
        for (i, k) in all.differing.iter().enumerate() {
            let parameter = &model.parameters[*k];
            // A clock is known to a share of the time over which what it is compared with is smoothed.
            let clock = matches!(parameter.enters, Enters::Clock(_));
            let blurred_s = if clock { SMOOTHED_TIMING_APART * p.track.smoothing.reach_s } else { 0.0 };
            let one = OfOneLog {
                log: p.track.name.clone(),
                id: model.candidates[parameter.candidate].id.clone(),
                name: parameter.name.clone(),
                unit: parameter.unit.into(),
                value: values[*k],
                shared: solution.posterior.mean[*k],
                sigma: sigmas[log][i].hypot(DIFFERS_KNOWN * parameter.spike).hypot(blurred_s),
            };
            if (one.value - one.shared).abs() > DIFFERS_SIGMAS * one.sigma {
                out.push(one);
            }
        }
    }
    Ok(out)
}

/// Candidates outside the set of a solution of which a log has a value beyond tolerance, with the evidence of that log alone, nats: winds
/// of two days that are opposite have nothing in common for the search to find. The evidence is that of the wide against the narrow prior
/// for the log's value, parameter by parameter.
pub(super) fn beyond_tolerance_in_a_log(
    model: &Model,
    solution: &Solution,
    differ: &[OfOneLog],
) -> Vec<(usize, f64)> {
    let nats = |c: usize, log: &str| -> f64 {
        let own = differ.iter().filter(|d| d.log == log && d.id == model.candidates[c].id);
        own.filter_map(|d| {
            let p = model.of(c).map(|k| &model.parameters[k]).find(|p| p.name == d.name)?;
            let [narrow, wide] = [p.spike, p.slab].map(|s| s * s + d.sigma * d.sigma);
            let off = (d.value - p.filed).powi(2);
            (wide > narrow).then(|| 0.5 * (off / narrow - off / wide) - 0.5 * (wide / narrow).ln())
        })
        .sum()
    };
    let most = |c: usize| differ.iter().map(|d| nats(c, &d.log)).fold(0.0, f64::max);
    let outside = model.named().filter(|c| !solution.set.contains(c));
    outside.map(|c| (c, most(c))).filter(|(_, nats)| *nats > CERTAIN_ALONE_NATS).collect()
}

/// Prior standard deviation of a log's deviation: the geometric mean of tolerance and plausible size. At the plausible
/// size, clocks went 30 ms off to absorb what an unknown thrust curve left on short flights of a payload.
fn width(p: &Parameter) -> f64 {
    (p.spike * p.slab).sqrt()
}

/// Information of all logs about the shared parameters, with the per-log deviations eliminated.
pub(crate) struct Information {
    /// JᵀJ by the parameters.
    pub h: DMatrix<f64>,
    /// Jᵀ of the residual.
    pub g: DVector<f64>,
    /// χ² at the linearisation point.
    pub c: f64,
    /// Occam factor of all eliminated parameters, nats.
    pub occam: f64,
    logs: usize,
    /// Parameters that may differ.
    pub differing: Vec<usize>,
    /// Deviations from each log's linearisation point: `base − slope · delta`, (log, differing parameter), log by log.
    base: DVector<f64>,
    slope: DMatrix<f64>,
    /// Covariance of the deviations, given the shared values.
    covariance: DMatrix<f64>,
}

impl Information {
    /// Sums the windows that `take` accepts by index.
    ///
    /// # Errors
    /// [`GapError::Numbers`] where values are not finite.
    /// [`GapError::Numbers`] where numbers are not finite.
    pub fn new(
        model: &Model,
        linear: &Linear,
        reduced: &[Reduced],
        take: impl Fn(usize) -> bool,
    ) -> Result<Self, GapError> {
        let n = model.parameters.len();
        let logs = linear.noise.len();
        let differing = model.per_log(logs);
        let m = differing.len();
        let (mut h, mut g) = (DMatrix::zeros(n, n), DVector::zeros(n));
        let (mut c, mut occam) = (0.0, 0.0);
        // Rows of each log's information that belong to the differing parameters.
        let mut slope = DMatrix::zeros(logs * m, n);
        let mut base = DVector::zeros(logs * m);
        for (_, r) in reduced.iter().enumerate().filter(|(i, _)| take(*i)) {
            h += &r.h;
            g += &r.g;
            c += r.c;
            occam += r.occam;
            for (i, k) in differing.iter().enumerate() {
                let mut row = slope.row_mut(r.log * m + i);
                row += r.h.row(*k);
                base[r.log * m + i] += r.g[*k];
            }
        }
        let mut out = Self { h, g, c, occam, logs, differing, base, slope, covariance: DMatrix::zeros(0, 0) };
        if m > 0 {
            out.eliminate(model, linear)?;
        }
        Ok(out)
    }

    /// Eliminates the deviations.
    fn eliminate(&mut self, model: &Model, linear: &Linear) -> Result<(), GapError> {
        let (m, logs) = (self.differing.len(), self.logs);
        let width = |i: usize| width(&model.parameters[self.differing[i]]);
        // Prior precision of the deviations: each by its width, and their sum held at zero.
        let prior = DMatrix::from_fn(logs * m, logs * m, |a, b| {
            let held = if a % m == b % m { HELD } else { 0.0 };
            let own = if a == b { 1.0 } else { 0.0 };
            (own + held) / width(a % m).powi(2)
        });
        let at = DVector::from_fn(logs * m, |a, _| {
            linear.apart.get(a / m).map_or(0.0, |apart| apart[self.differing[a % m]])
        });
        let pulled = &prior * &at;
        self.c += at.dot(&pulled);
        self.base -= &pulled;
        let mut precision = prior;
        for a in 0..logs * m {
            for b in 0..m {
                precision[(a, a / m * m + b)] += self.slope[(a, self.differing[b])];
            }
        }
        let factor = Cholesky::new(precision).ok_or(GapError::Numbers {
            what: "what differs between logs",
            reason: "its information is no positive definite matrix (numbers that are not finite?)".into(),
        })?;
        let base = factor.solve(&self.base);
        let slope = factor.solve(&self.slope);
        self.h -= self.slope.tr_mul(&slope);
        self.g -= self.slope.tr_mul(&base);
        self.c -= self.base.dot(&base);
        let widths: f64 = (0..m).map(|i| width(i).ln()).sum();
        self.occam += factor.l_dirty().diagonal().map(f64::ln).sum() + logs as f64 * widths;
        (self.base, self.slope, self.covariance) = (base, slope, factor.inverse());
        Ok(())
    }

    /// Every log's parameters minus those at its linearisation point, with the shared ones at `delta`: shape (log,
    /// parameter).
    pub fn deltas(&self, delta: &[f64]) -> Vec<Vec<f64>> {
        let m = self.differing.len();
        let mut out = vec![delta.to_vec(); self.logs];
        if m > 0 {
            let own = &self.base - &self.slope * DVector::from_column_slice(delta);
            for (log, own) in out.iter_mut().zip(own.as_slice().chunks(m)) {
                self.differing.iter().zip(own).for_each(|(k, deviation)| log[*k] += deviation);
            }
        }
        out
    }

    /// Standard deviations of the deviations, shape (log, differing parameter), given the covariance of the shared values
    /// and the `dispersion` of the noise.
    pub fn sigmas(&self, covariance: &DMatrix<f64>, dispersion: f64) -> Vec<Vec<f64>> {
        let m = self.differing.len();
        let by_shared = &self.slope * covariance;
        let variance =
            |a: usize| dispersion * self.covariance[(a, a)] + by_shared.row(a).dot(&self.slope.row(a));
        (0..self.logs).map(|l| (0..m).map(|i| variance(l * m + i).sqrt()).collect()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::chi2;
    use crate::track::Noise;
    use propwash_physics::effects::candidates;
    use propwash_rollout::random::{Key, purpose};
    use propwash_vehicle::Vehicle;

    /// The χ² after elimination is the minimum over all deviations, written out in full.
    #[test]
    fn deviations_that_are_taken_out_are_where_they_explain_most() {
        const LOGS: usize = 3;
        let vehicle =
            Vehicle::from_toml("quad", include_str!("../../../tests/data/planted_quad.toml")).unwrap();
        let drone = vehicle.drone("first_principles").unwrap();
        let mut model = Model::new(&drone, &[], &[]).unwrap().only(&|_| false);
        for candidate in candidates(&drone) {
            if ["clock_offset.gyro", "wrong_mass"].contains(&candidate.id.as_str()) {
                model.admit(candidate).unwrap();
            }
        }
        let differing = model.per_log(LOGS);
        assert!(differing.len() == 1 && model.per_log(1).is_empty(), "{differing:?}");
        let (k, n) = (differing[0], model.parameters.len());
        let width = width(&model.parameters[k]);
        let mut dice =
            Key { seed: 7, world: 0, drone: 0, step: 0, purpose: purpose("per-log test") }.stream();
        let slab: Vec<f64> = model.parameters.iter().map(|p| p.slab).collect();
        let reduced: Vec<Reduced> = (0..2 * LOGS)
            .map(|i| {
                let rows = DMatrix::from_fn(8, n, |_, j| dice.normal() / slab[j]);
                let left = DVector::from_fn(8, |_, _| 3.0 * dice.normal());
                Reduced {
                    log: i % LOGS,
                    h: rows.tr_mul(&rows),
                    g: rows.tr_mul(&left),
                    c: left.dot(&left),
                    occam: 0.0,
                }
            })
            .collect();
        // Linearised where the logs already differ.
        let apart: Vec<Vec<f64>> = [0.4, -0.1, -0.3]
            .iter()
            .map(|d| (0..n).map(|j| if j == k { d * width } else { 0.0 }).collect())
            .collect();
        let noise = Noise {
            position_m: 1.0,
            attitude_rad: 1.0,
            gyro_rad_s: 1.0,
            accel_m_s2: 1.0,
            rotor_rad_s: None,
            thrust_n: None,
            stated: [false; 4],
        };
        let linear = Linear {
            windows: vec![],
            at: model.filed(),
            apart: apart.clone(),
            horizon_s: 0.25,
            noise: vec![noise; LOGS],
        };
        let all = Information::new(&model, &linear, &reduced, |_| true).unwrap();
        let delta: Vec<f64> = (0..n).map(|j| 0.3 * slab[j]).collect();
        let whole = |deltas: &[Vec<f64>]| -> f64 {
            let rows: f64 = reduced.iter().map(|r| chi2(r, deltas)).sum();
            let off: Vec<f64> = (0..LOGS).map(|l| apart[l][k] + deltas[l][k] - delta[k]).collect();
            let sum: f64 = off.iter().sum();
            rows + (off.iter().map(|d| d * d).sum::<f64>() + HELD * sum * sum) / width.powi(2)
        };
        let deltas = all.deltas(&delta);
        let at = DVector::from_column_slice(&delta);
        let least = all.c - 2.0 * all.g.dot(&at) + at.dot(&(&all.h * &at));
        assert!((whole(&deltas) / least - 1.0).abs() < 1e-6, "{} {least}", whole(&deltas));
        let total: f64 = (0..LOGS).map(|l| apart[l][k] + deltas[l][k] - delta[k]).sum();
        assert!(total.abs() < 1e-5 * width, "deviations sum to nothing: {total}");
        // No other deviations with the same sum fit better.
        for (a, b) in [(0, 1), (1, 2), (2, 0)] {
            let mut other = deltas.clone();
            other[a][k] += 0.2 * width;
            other[b][k] -= 0.2 * width;
            assert!(whole(&other) > least, "{a} {b}");
        }
    }
}
