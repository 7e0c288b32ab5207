//! Bayesian model selection: log marginal likelihood of sets of candidate effects under one Gaussian (Laplace)
//! approximation.
//!
//! Every parameter has a Gaussian prior about its nominal value: the spike if its candidate is left out, the slab if it is
//! in; one-sided where physics fixes the sign. For a quadratic log likelihood the evidence of a set follows by a low-rank
//! update, so thousands of sets cost no further simulation. Spike and slab: George & McCulloch, JASA 88(423), 1993;
//! dispersion of scores: Takeuchi, "Distribution of informational statistics", Mathematical Sciences 153, 1976.

use super::GapError;
use super::model::Model;
use nalgebra::{Cholesky, DMatrix, DVector};
use propwash_physics::effects::{Relative, Sign, nature};

/// Evidence required to add an effect, nats.
pub(crate) const THRESHOLD: f64 = 6.0;
/// Most effects of one verdict; inertia about several axes counts once.
pub(crate) const MOST: usize = 4;

/// The log's quadratic in scaled parameters z = (value − nominal)/slab: ln L = bᵀz − ½ zᵀAz, and what follows with all
/// candidates left out.
pub(crate) struct Evidence<'a> {
    model: &'a Model,
    /// Information divided by the dispersion.
    pub a: DMatrix<f64>,
    pub b: DVector<f64>,
    /// Prior variance with the candidate left out: (spike over slab)².
    closed: Vec<f64>,
    /// Posterior covariance and mean with all candidates left out.
    k0: DMatrix<f64>,
    m0: DVector<f64>,
    members: Vec<Vec<usize>>,
    dispersion: f64,
}

/// A set of candidates with its score.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Scored {
    /// Indices of candidates, rising.
    pub set: Vec<usize>,
    /// Log evidence over that of the empty set, nats.
    pub evidence: f64,
}

impl Scored {
    /// Evidence minus the price of the effects.
    pub fn score(&self) -> f64 {
        self.evidence - THRESHOLD * self.set.len() as f64
    }
}

/// Posterior of the parameters in their units.
#[derive(Clone, Debug)]
pub(crate) struct Posterior {
    pub mean: Vec<f64>,
    pub sigma: Vec<f64>,
}

impl<'a> Evidence<'a> {
    /// From the sums over windows: information `h` and score `g` (per unit of the parameters, at values `at`). `tolerance`
    /// is the factor by which the vehicle's tolerances are wider than usual.
    pub fn new(
        model: &'a Model,
        h: &DMatrix<f64>,
        g: &DVector<f64>,
        at: &[f64],
        dispersion: f64,
        tolerance: f64,
    ) -> Result<Self, GapError> {
        let n = model.parameters.len();
        let slab: Vec<f64> = model.parameters.iter().map(|p| p.slab).collect();
        let from: DVector<f64> = DVector::from_iterator(n, (0..n).map(|k| at[k] - model.parameters[k].filed));
        // About the nominal values: b = g + H (at − nominal).
        let about = g + h * from;
        let a = DMatrix::from_fn(n, n, |i, j| h[(i, j)] * slab[i] * slab[j] / dispersion);
        let b = DVector::from_fn(n, |i, _| about[i] * slab[i] / dispersion);
        let closed: Vec<f64> =
            model.parameters.iter().map(|p| (tolerance * p.spike / p.slab).powi(2).min(0.5)).collect();
        let mut precision = a.clone();
        for k in 0..n {
            precision[(k, k)] += 1.0 / closed[k];
        }
        let factor = Cholesky::new(precision).ok_or_else(|| GapError::Numbers {
            what: "the evidence",
            reason: "the log's information is no positive definite matrix (numbers that are not finite?)"
                .into(),
        })?;
        let k0 = factor.inverse();
        let m0 = &k0 * &b;
        let members = (0..model.candidates.len()).map(|c| model.of(c).collect()).collect();
        Ok(Self { model, a, b, closed, k0, m0, members, dispersion })
    }

    /// Log evidence of a set up to a constant common to all sets: `chi2` is that at the linearisation point. For comparing
    /// solutions from different starts.
    pub fn whole(&self, set: &[usize], chi2: f64, g: &DVector<f64>, h: &DMatrix<f64>, at: &[f64]) -> f64 {
        let n = at.len();
        let from = DVector::from_fn(n, |k, _| at[k] - self.model.parameters[k].filed);
        let filed = chi2 + 2.0 * g.dot(&from) + from.dot(&(h * &from));
        -0.5 * filed / self.dispersion + self.empty() + self.of(set)
    }

    /// Log evidence of the empty set over that of exactly nominal parameters: what the tolerances explain, minus their
    /// Occam factor.
    pub fn empty(&self) -> f64 {
        let narrower: f64 = Cholesky::new(self.k0.clone())
            .map_or(0.0, |f| f.l_dirty().diagonal().map(|d| 2.0 * d.ln()).sum());
        0.5 * (self.b.dot(&self.m0) + narrower - self.closed.iter().map(|c| c.ln()).sum::<f64>())
    }

    /// Log evidence of a set over that of the empty set.
    pub fn of(&self, set: &[usize]) -> f64 {
        let open: Vec<usize> = set.iter().flat_map(|c| self.members[*c].iter().copied()).collect();
        if open.is_empty() {
            return 0.0;
        }
        let m = open.len();
        // (Δ⁻¹ + K₀), with Δ = 1 − 1/s² < 0 the change of prior precision.
        let core = DMatrix::from_fn(m, m, |i, j| {
            let s2 = self.closed[open[i]];
            let diagonal = if i == j { s2 / (s2 - 1.0) } else { 0.0 };
            self.k0[(open[i], open[j])] + diagonal
        });
        let Some(factor) = Cholesky::new(-&core) else { return f64::NEG_INFINITY };
        let mean0 = DVector::from_fn(m, |i, _| self.m0[open[i]]);
        let solved = factor.solve(&mean0);
        let gain = 0.5 * mean0.dot(&solved);
        // det(D₁/D₀) det(I + Δ K₀) = Π (1/s²) · Π|Δ| · det(−(Δ⁻¹ + K₀)).
        let mut log_det = 0.0;
        for (i, k) in open.iter().enumerate() {
            let s2 = self.closed[*k];
            log_det += -s2.ln() + ((1.0 - s2) / s2).ln() + 2.0 * factor.l_dirty()[(i, i)].ln();
        }
        let mut evidence = gain - 0.5 * log_det;
        // One-sided slabs: the Gaussian on the allowed side, renormalised.
        let k = DMatrix::from_fn(m, m, |i, j| self.k0[(open[i], open[j])]);
        let spread = factor.solve(&k);
        for (i, p) in open.iter().enumerate() {
            let side = match self.model.parameters[*p].sign {
                Sign::Any => continue,
                Sign::Up => 1.0,
                Sign::Down => -1.0,
            };
            let mut mean = mean0[i];
            let mut variance = self.k0[(*p, *p)];
            for j in 0..m {
                mean += k[(i, j)] * solved[j];
                variance += k[(i, j)] * spread[(j, i)];
            }
            let back = self.model.parameters[*p].back;
            let allowed = normal_cdf((side * mean + back) / variance.max(1e-300).sqrt());
            evidence += (allowed / normal_cdf(back)).max(1e-300).ln();
        }
        evidence
    }

    /// Number of kinds in a set.
    fn kinds(&self, set: &[usize]) -> usize {
        let kind = |c: usize| self.model.candidates[c].kind;
        (0..set.len()).filter(|i| !set[..*i].iter().any(|c| kind(*c) == kind(set[*i]))).count()
    }

    fn scored(&self, mut set: Vec<usize>) -> Scored {
        set.sort_unstable();
        let never = set.iter().filter(|c| self.model.never_both.contains(c)).count() > 1;
        Scored { evidence: if never { f64::NEG_INFINITY } else { self.of(&set) }, set }
    }

    /// Posterior with the candidates of `set` free (slab).
    pub fn posterior(&self, set: &[usize]) -> Result<Posterior, GapError> {
        let n = self.model.parameters.len();
        let mut precision = self.a.clone();
        for k in 0..n {
            let open = set.contains(&self.model.parameters[k].candidate);
            precision[(k, k)] += if open { 1.0 } else { 1.0 / self.closed[k] };
        }
        let factor = Cholesky::new(precision).ok_or_else(|| GapError::Numbers {
            what: "the posterior",
            reason: "the log's information is no positive definite matrix".into(),
        })?;
        let mut cov = factor.inverse();
        let mut mean = &cov * &self.b;
        // A parameter that an unbounded fit would move past its one-sided bound is fixed where its effect is absent.
        for _ in 0..4 {
            let wrong = (0..n).find(|k| {
                let p = &self.model.parameters[*k];
                set.contains(&p.candidate)
                    && cov[(*k, *k)] > 0.0
                    && match p.sign {
                        Sign::Any => false,
                        Sign::Up => mean[*k] < -p.back - 1e-12,
                        Sign::Down => mean[*k] > p.back + 1e-12,
                    }
            });
            let Some(k) = wrong else { break };
            let column = cov.column(k).into_owned();
            let p = &self.model.parameters[k];
            let bound = if p.sign == Sign::Up { -p.back } else { p.back };
            let (value, variance) = (mean[k] - bound, cov[(k, k)]);
            mean -= &column * (value / variance);
            cov -= &column * column.transpose() / variance;
            // Fixed at its bound, it has no variance left.
            cov[(k, k)] = 0.0;
            mean[k] = bound;
        }
        let slab = |k: usize| self.model.parameters[k].slab;
        Ok(Posterior {
            mean: (0..n)
                .map(|k| {
                    let value = self.model.parameters[k].filed + mean[k] * slab(k);
                    self.model.least(k).map_or(value, |least| value.max(least))
                })
                .collect(),
            sigma: (0..n).map(|k| cov[(k, k)].max(0.0).sqrt() * slab(k)).collect(),
        })
    }

    /// Posterior covariance of the parameters in their units, with the candidates of `set` free and bounds ignored.
    pub fn covariance(&self, set: &[usize]) -> Option<DMatrix<f64>> {
        let open = |k: usize| set.contains(&self.model.parameters[k].candidate);
        let prior: Vec<f64> =
            (0..self.closed.len()).map(|k| if open(k) { 1.0 } else { 1.0 / self.closed[k] }).collect();
        let mut out = covariance(&self.a, &prior)?;
        let slab = |k: usize| self.model.parameters[k].slab;
        for i in 0..out.nrows() {
            for j in 0..out.ncols() {
                out[(i, j)] *= slab(i) * slab(j);
            }
        }
        Some(out)
    }

    /// Sandwich standard deviations of the parameters, from the scatter between parts of the log: `scores` are the
    /// gradients of each part's log likelihood at the estimate, per unit of the parameters. White, Econometrica 50(1),
    /// 1982.
    pub fn by_scatter(&self, set: &[usize], scores: &[DVector<f64>]) -> Option<Vec<f64>> {
        let n = self.model.parameters.len();
        let slab = |k: usize| self.model.parameters[k].slab;
        let mut precision = self.a.clone();
        for k in 0..n {
            let open = set.contains(&self.model.parameters[k].candidate);
            precision[(k, k)] += if open { 1.0 } else { 1.0 / self.closed[k] };
        }
        let factor = Cholesky::new(precision)?;
        let mut variance = DVector::<f64>::zeros(n);
        for score in scores {
            let scaled = DVector::from_fn(n, |k, _| score[k] * slab(k) / self.dispersion);
            let pull = factor.solve(&scaled);
            variance += pull.component_mul(&pull);
        }
        let parts = scores.len() as f64;
        let unbiased = parts / (parts - 1.0).max(1.0);
        Some((0..n).map(|k| (unbiased * variance[k]).sqrt() * slab(k)).collect())
    }

    /// For every candidate the size of its parameters, in slabs, with an expected evidence of `nats` beside `set`, with
    /// everything else within its tolerance; large where the log has no information about it.
    pub fn smallest(&self, set: &[usize], nats: f64) -> Option<Vec<f64>> {
        let open = |k: usize| set.contains(&self.model.parameters[k].candidate);
        let prior: Vec<f64> =
            (0..self.closed.len()).map(|k| if open(k) { 1.0 } else { 1.0 / self.closed[k] }).collect();
        let covariance = covariance(&self.a, &prior)?;
        let size = |of: &Vec<usize>| {
            let by_noise = smallest(&covariance, of, &prior, nats)?;
            Some(by_noise.max(beyond_tolerance(of.iter().map(|k| self.closed[*k]))))
        };
        self.members.iter().map(size).collect()
    }

    /// The best set: all singles and pairs, then additions, removals and exchanges until nothing improves. Also returns
    /// every set evaluated.
    pub fn search(&self) -> (Scored, Vec<Scored>) {
        let n = self.members.len();
        let mut seen = vec![Scored { set: vec![], evidence: 0.0 }];
        let may = |c: &usize| self.model.may[*c];
        for a in (0..n).filter(may) {
            seen.push(self.scored(vec![a]));
            for b in (a + 1..n).filter(may) {
                seen.push(self.scored(vec![a, b]));
            }
        }
        let better = |x: &Scored, y: &Scored| x.score().total_cmp(&y.score());
        seen.sort_by(|x, y| better(y, x));
        // From several starts: the best pair may be a local optimum.
        let starts: Vec<Scored> = seen.iter().take(4).cloned().collect();
        let mut best = seen[0].clone();
        for start in starts {
            let mut now = start;
            for _ in 0..24 {
                let mut moves = Vec::new();
                for c in (0..n).filter(may) {
                    if now.set.contains(&c) {
                        let rest: Vec<usize> = now.set.iter().copied().filter(|x| *x != c).collect();
                        moves.push(rest.clone());
                        for other in (0..n).filter(may).filter(|o| !now.set.contains(o)) {
                            moves.push([rest.clone(), vec![other]].concat());
                        }
                    } else if self.kinds(&now.set) < MOST
                        || now
                            .set
                            .iter()
                            .any(|x| self.model.candidates[*x].kind == self.model.candidates[c].kind)
                    {
                        moves.push([now.set.clone(), vec![c]].concat());
                    }
                }
                let next: Vec<Scored> = moves.into_iter().map(|set| self.scored(set)).collect();
                let Some(top) = next.iter().max_by(|x, y| better(x, y)).cloned() else { break };
                seen.extend(next);
                if top.score() <= now.score() + 1e-9 {
                    break;
                }
                now = top;
            }
            if now.score() > best.score() {
                best = now;
            }
        }
        (best, seen)
    }

    /// Alternatives to the candidates of `set` that are determined only relative to each other, `of` among them: a common
    /// factor of mass, thrust, inertia and torque is unobservable, and a delay of all sensors equals a delay of the
    /// commands, so one set of them can replace another though no single exchange shows it. Each with its evidence deficit,
    /// within `margin` nats.
    pub fn in_place_of_all(&self, set: &[usize], of: usize, margin: f64) -> Vec<(Vec<usize>, f64)> {
        Relative::ALL.iter().flat_map(|by| self.in_place_of_relatives(*by, set, of, margin)).collect()
    }

    fn in_place_of_relatives(
        &self,
        by: Relative,
        set: &[usize],
        of: usize,
        margin: f64,
    ) -> Vec<(Vec<usize>, f64)> {
        let relative = |c: &usize| nature(self.model.candidates[*c].kind).relative == Some(by);
        let own: Vec<usize> = set.iter().copied().filter(relative).collect();
        if own.len() < 2 || !own.contains(&of) {
            return Vec::new();
        }
        let rest: Vec<usize> = set.iter().copied().filter(|c| !own.contains(c)).collect();
        let all: Vec<usize> =
            (0..self.members.len()).filter(relative).filter(|c| self.model.may[*c]).collect();
        let score = self.scored(set.to_vec()).score();
        let mut out: Vec<(Vec<usize>, f64)> = (1..1usize << all.len())
            .map(|bits| (0..all.len()).filter(|i| bits & (1 << i) != 0).map(|i| all[i]).collect::<Vec<_>>())
            .filter(|other| other.len() <= own.len() + 1 && !other.contains(&of))
            .filter(|other| !other.iter().all(|c| own.contains(c)))
            .map(|other| {
                let worse = score - self.scored([rest.clone(), other.clone()].concat()).score();
                (other, worse)
            })
            .filter(|(_, worse)| *worse < margin)
            .collect();
        out.sort_by(|x, y| x.1.total_cmp(&y.1));
        // A superset of such a set adds nothing.
        let part_of = |a: &[usize], b: &[usize]| a.len() < b.len() && a.iter().all(|c| b.contains(c));
        let sets: Vec<Vec<usize>> = out.iter().map(|(set, _)| set.clone()).collect();
        out.retain(|(set, _)| !sets.iter().any(|other| part_of(other, set)));
        out.truncate(MOST_TOGETHER);
        out
    }

    /// Alternatives to candidate `of` in `set` that fit almost as well, within `margin` nats: single candidates and pairs,
    /// each with its evidence deficit. A late gyroscope with a late accelerometer is one late inertial unit, and one effect.
    pub fn in_place_of(&self, set: &[usize], of: usize, margin: f64) -> Vec<(Vec<usize>, f64)> {
        let n = self.members.len();
        let rest: Vec<usize> = set.iter().copied().filter(|c| *c != of).collect();
        let own = self.scored(set.to_vec()).score();
        let mut out: Vec<(Vec<usize>, f64)> = Vec::new();
        let free: Vec<usize> = (0..n).filter(|c| !set.contains(c) && !self.model.is_shape(*c)).collect();
        for (i, a) in free.iter().enumerate() {
            let worse = own - self.scored([rest.clone(), vec![*a]].concat()).score();
            if worse < margin {
                out.push((vec![*a], worse));
            }
            for b in &free[i + 1..] {
                let mut worse = own - self.scored([rest.clone(), vec![*a, *b]].concat()).score();
                if self.model.of_one_clock(*a, *b) {
                    worse -= THRESHOLD;
                }
                if worse < margin {
                    out.push((vec![*a, *b], worse));
                }
            }
        }
        out.sort_by(|x, y| x.1.total_cmp(&y.1));
        // A pair adds nothing if one of its members alone fits as well.
        let single: Vec<usize> =
            out.iter().filter(|(ids, _)| ids.len() == 1).map(|(ids, _)| ids[0]).collect();
        out.retain(|(ids, _)| ids.len() == 1 || !ids.iter().any(|c| single.contains(c)));
        out
    }
}

/// Most alternatives reported for candidates that are determined only relative to each other.
const MOST_TOGETHER: usize = 3;

/// Posterior covariance of all parameters from their information and prior precision.
pub(crate) fn covariance(a: &DMatrix<f64>, prior: &[f64]) -> Option<DMatrix<f64>> {
    let mut precision = a.clone();
    for (k, p) in prior.iter().enumerate() {
        precision[(k, k)] += p;
    }
    Some(Cholesky::new(precision)?.inverse())
}

/// Size in slabs at which the parameters `of` have an expected evidence of `nats`, from the posterior covariance of all
/// parameters and their prior precision.
///
/// With information S about them, marginalised over all others, a size z gives ½ zᵀS(1 + S)⁻¹S z − ½ ln det(1 + S) of
/// evidence.
pub(crate) fn smallest(covariance: &DMatrix<f64>, of: &[usize], prior: &[f64], nats: f64) -> Option<f64> {
    let m = of.len();
    let block = DMatrix::from_fn(m, m, |i, j| covariance[(of[i], of[j])]);
    let mut told = Cholesky::new(block)?.inverse();
    for (i, k) in of.iter().enumerate() {
        told[(i, i)] -= prior[*k];
    }
    let values = told.symmetric_eigenvalues().map(|v| v.max(0.0));
    let gain = values.iter().map(|v| v * v / (1.0 + v)).sum::<f64>() / m as f64;
    let price = 0.5 * values.iter().map(|v| (1.0 + v).ln()).sum::<f64>();
    Some((2.0 * (nats + price) / gain.max(1e-12)).sqrt())
}

/// Size in slabs at which exactly known parameters have the evidence of an effect against being within tolerance; `closed`
/// are their squared tolerances over slabs.
///
/// One slab gives ½ (1/c − 1) + ½ ln c of it for each parameter of tolerance c.
fn beyond_tolerance(closed: impl Iterator<Item = f64>) -> f64 {
    let (mut gain, mut price, mut m) = (0.0, 0.0, 0.0);
    for c in closed {
        gain += (1.0 / c - 1.0).max(0.0);
        price -= 0.5 * c.min(1.0).ln();
        m += 1.0;
    }
    let (gain, price) = (gain / f64::max(m, 1.0), price);
    (2.0 * (THRESHOLD + price) / gain.max(1e-12)).sqrt()
}

/// Standard normal distribution function, to 1e-7 (Abramowitz & Stegun 7.1.26), with the asymptotic series in the lower
/// tail so that logarithms stay accurate.
pub(crate) fn normal_cdf(x: f64) -> f64 {
    if x < -5.0 {
        let density = (-0.5 * x * x).exp() / (2.0 * core::f64::consts::PI).sqrt();
        return density / -x * (1.0 - 1.0 / (x * x) + 3.0 / x.powi(4));
    }
    let t = 1.0 / (1.0 + 0.3275911 * (x.abs() / core::f64::consts::SQRT_2));
    let poly =
        t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))));
    let erf = 1.0 - poly * (-0.5 * x * x).exp();
    if x >= 0.0 { 0.5 * (1.0 + erf) } else { 0.5 * (1.0 - erf) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_within_a_wide_tolerance_could_hide() {
        // An inertia off by 0.6 of its plausible 20 % is separable from a tolerance of 3 %: evidence of 6 nats.
        let c = (0.03f64 / 0.2).powi(2);
        let size = beyond_tolerance([c].into_iter());
        assert!((0.5 * size * size * (1.0 / c - 1.0) + 0.5 * c.ln() - THRESHOLD).abs() < 1e-9);
        assert!(size > 0.5 && size < 0.7, "{size}");
        // A clock behind inputs smoothed over 14 ms cannot be told from a correct one.
        assert!(beyond_tolerance([(0.007f64 / 0.012).powi(2)].into_iter()) > 2.0);
    }
}
