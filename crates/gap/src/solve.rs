//! From logs to the set of effects that explains them: one search from the vehicle file, others from alternative
//! explanations; the solution with the most evidence wins.

use super::GapError;
use super::disturbance::{Disturbance, Reduced};
use super::fit::{Linear, Prepared, forces_only};
use super::model::Model;
use super::per_log::Information;
use super::policy::{INTERVAL_TOLERANCE, WEAK_NATS};
use super::search::{Evidence, Posterior};
use super::starts::{Start, fewer_clocks, named_by_witness};
use super::walk::settle;
use super::watch::Watch;
use nalgebra::DVector;

/// Prior standard deviation of the logarithm of the factor by which a vehicle's tolerances are wider than usual.
const TOLERANCE_SPREAD: f64 = 0.15;
/// Longest move of a parameter between linearisations, slabs.
pub(super) const LONGEST_STEP: f64 = 1.5;

/// Penalty for tolerances wider by this factor, nats.
pub(super) fn price_of(tolerance: f64) -> f64 {
    0.5 * (tolerance.ln() / TOLERANCE_SPREAD).powi(2)
}

/// A converged search.
pub(crate) struct Solution {
    /// Candidates in the set, in rising order.
    pub set: Vec<usize>,
    pub linear: Linear,
    pub reduced: Vec<Reduced>,
    /// The same by parts of the log, once it is [`Solution::compact`].
    pub parts: Vec<Vec<Reduced>>,
    pub disturbance: Disturbance,
    /// Disturbances without findings, at the same window length.
    pub disturbance_before: Disturbance,
    pub dispersion: f64,
    /// The dispersion with the set, relative to the noise of neighbouring samples: what disturbances cannot explain.
    pub misfit: f64,
    /// Factor by which this vehicle's tolerances are wider than usual.
    pub tolerance: f64,
    pub posterior: Posterior,
    /// Every log's parameters at their estimate minus those at the linearisation point, shape (log, parameter).
    pub deltas: Vec<Vec<f64>>,
}

impl Solution {
    /// Evidence at the last linearisation.
    pub fn evidence<'a>(&self, model: &'a Model) -> Result<Evidence<'a>, GapError> {
        self.beside_tolerances(model, 1.0)
    }

    /// The same with the vehicle's tolerances `wider` times as wide as estimated.
    fn beside_tolerances<'a>(&self, model: &'a Model, wider: f64) -> Result<Evidence<'a>, GapError> {
        let all = Information::new(model, &self.linear, &self.reduced, |_| true)?;
        Evidence::new(model, &all.h, &all.g, &self.linear.at, self.dispersion, wider * self.tolerance)
    }

    /// A log's parameters at their estimate.
    pub fn values_of(&self, log: usize) -> Vec<f64> {
        let mut out = self.linear.values_of(log);
        out.iter_mut().zip(&self.deltas[log]).for_each(|(v, d)| *v += d);
        out
    }

    /// [`Self::deltas`] with the parameters of candidates in `back` reset to nominal, in every log.
    pub fn deltas_without(&self, model: &Model, back: impl Fn(usize) -> bool) -> Vec<Vec<f64>> {
        let mut out = self.deltas.clone();
        for (log, deltas) in out.iter_mut().enumerate() {
            let at = self.linear.values_of(log);
            for (k, p) in model.parameters.iter().enumerate().filter(|(_, p)| back(p.candidate)) {
                deltas[k] = p.filed - at[k];
            }
        }
        out
    }
}

impl Solution {
    /// Log evidence minus the price of the effects, for disturbances of these sizes.
    fn whole(&self, model: &Model, dispersion: f64, disturbance: &Disturbance) -> Result<f64, GapError> {
        let reduced = self.linear.reduce(disturbance);
        let all = Information::new(model, &self.linear, &reduced, |_| true)?;
        let evidence = Evidence::new(model, &all.h, &all.g, &self.linear.at, dispersion, self.tolerance)?;
        // The number of rows varies slightly with the clocks, so χ² is compared per row.
        let rows: usize = self.linear.windows.iter().map(|w| w.n_rows).sum();
        let price = super::search::THRESHOLD * self.set.len() as f64 + price_of(self.tolerance);
        let whole = evidence.whole(&self.set, all.c, &all.g, &all.h, &self.linear.at);
        Ok(whole - all.occam + 0.5 * rows as f64 - price)
    }

    /// Whether its estimates are near the linearisation point: far from it the linearisation is an extrapolation never
    /// checked against the model. A light vehicle looked like drag there, by a mass of a seventh and a thrust of a seventh.
    pub(super) fn near_by(&self, model: &Model) -> bool {
        self.set.iter().flat_map(|c| model.of(*c)).all(|k| {
            (self.posterior.mean[k] - self.linear.at[k]).abs() <= LONGEST_STEP * model.parameters[k].slab
        })
    }

    /// Whether the log favours this over `other`. Sizes of disturbances converge slowly: each of the two may use those of
    /// the other.
    fn better_than(&self, other: &Self, model: &Model) -> Result<bool, GapError> {
        let near = self.near_by(model);
        if near != other.near_by(model) {
            return Ok(near);
        }
        let phi = self.dispersion.max(other.dispersion);
        let best = |of: &Self| -> Result<f64, GapError> {
            let own = of.whole(model, phi, &self.disturbance)?;
            Ok(own.max(of.whole(model, phi, &other.disturbance)?))
        };
        Ok(best(self)? > best(other)?)
    }
}

/// χ² of a window with every log's parameters at `deltas` from the linearisation point.
pub(crate) fn chi2(r: &Reduced, deltas: &[Vec<f64>]) -> f64 {
    let delta = DVector::from_column_slice(&deltas[r.log]);
    r.c - 2.0 * r.g.dot(&delta) + delta.dot(&(&r.h * &delta))
}

/// Gradient of a window's log likelihood by the parameters, there.
pub(super) fn score(r: &Reduced, deltas: &[Vec<f64>]) -> DVector<f64> {
    &r.g - &r.h * DVector::from_column_slice(&deltas[r.log])
}

pub(super) fn difference(posterior: &Posterior, at: &[f64]) -> Vec<f64> {
    posterior.mean.iter().zip(at).map(|(m, a)| m - a).collect()
}

/// Searches (or, with `given`, fits that set) until it converges. `watch` is told of every linearisation.
///
/// A search descends from the vehicle file. A common delay of all sensors is equivalent to a delay of the commands, so that
/// a search can end anywhere along that degenerate direction. It is restarted from the point on it that needs the fewest
/// causes, and the solution with more evidence wins.
pub(crate) fn solve(
    logs: &[Prepared],
    model: &mut Model,
    given: Option<&[usize]>,
    watch: &Watch,
) -> Result<Solution, GapError> {
    solve_from(logs, model, given, None, watch)
}

/// [`solve`], with the first search from `start` instead of the vehicle file.
pub(crate) fn solve_from(
    logs: &[Prepared],
    model: &mut Model,
    given: Option<&[usize]>,
    start: Option<Start>,
    watch: &Watch,
) -> Result<Solution, GapError> {
    let mut best = settle(logs, model, given, start, watch)?.ok_or_else(no_window)?;
    if given.is_some() {
        return Ok(best);
    }
    let mut tried = vec![best.set.clone()];
    for _ in 0..2 {
        let Some(start) = fewer_clocks(model, &best).filter(|s| !tried.contains(&s.set)) else { break };
        tried.push(start.set.clone());
        if let Some(other) = again(logs, model, None, start, watch)?
            && other.better_than(&best, model)?
        {
            best = other;
        }
    }
    if let Some(start) = named_by_witness(logs, model, &best)
        && let Some(other) = again(logs, model, None, start, watch)?
        && other.better_than(&best, model)?
    {
        best = other;
    }
    // An effect far beyond its plausible size may mark a local optimum: start again from single candidates, one by one.
    if !best.set.iter().any(|c| implausible(model, &best, *c)) {
        return pruned(logs, model, best, watch);
    }
    let evidence = best.evidence(model)?;
    let mut alone: Vec<(f64, usize)> = (0..model.candidates.len())
        .filter(|c| model.may[*c])
        .map(|c| (evidence.of(&[c]), c))
        .filter(|(nats, _)| *nats > super::search::THRESHOLD)
        .collect();
    drop(evidence);
    alone.sort_by(|a, b| b.0.total_cmp(&a.0));
    for (_, c) in alone.into_iter().take(4) {
        let unknown = Disturbance::unknown();
        let set = vec![c];
        if best.set == set {
            continue;
        }
        let back = Some(best.set.clone());
        let start = Start { set, held: 3, back, disturbance: unknown, ..Start::beside(model, &best) };
        if let Some(other) = again(logs, model, None, start, watch)?
            && other.better_than(&best, model)?
        {
            best = other;
        }
    }
    pruned(logs, model, best, watch)
}

/// Removes effects that the log does not need after all. An effect with little evidence may exist only because the model
/// was linearised with it (a limit that few commands reach): it is removed if the model without it does not need it, or if
/// it would have to be many times its plausible size. Wider tolerances, which would absorb any small effect, are not tried
/// without it.
fn pruned(
    logs: &[Prepared],
    model: &mut Model,
    mut best: Solution,
    watch: &Watch,
) -> Result<Solution, GapError> {
    if forces_only(logs) {
        return Ok(best);
    }
    loop {
        let evidence = best.evidence(model)?;
        let all = evidence.of(&best.set);
        let mut weak: Vec<(f64, usize)> = best
            .set
            .iter()
            .map(|c| {
                let rest: Vec<usize> = best.set.iter().copied().filter(|x| x != c).collect();
                (all - evidence.of(&rest), *c)
            })
            .filter(|(nats, _)| *nats < WEAK_NATS)
            .collect();
        drop(evidence);
        weak.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut better = None;
        for (_, c) in weak {
            let Some(other) = left_out(logs, model, &best, c, watch)? else { continue };
            let rest = other.set.clone();
            let without = other.evidence(model)?;
            let mut with = rest.clone();
            with.push(c);
            with.sort_unstable();
            let gain = without.of(&with) - without.of(&rest);
            drop(without);
            if gain < super::search::THRESHOLD || implausible(model, &best, c) {
                better = Some(other);
                break;
            }
        }
        match better {
            Some(other) => best = other,
            None => return Ok(best),
        }
    }
}

/// The solution without one of the effects; `None` if that model diverges in all windows.
pub(crate) fn left_out(
    logs: &[Prepared],
    model: &mut Model,
    found: &Solution,
    candidate: usize,
    watch: &Watch,
) -> Result<Option<Solution>, GapError> {
    let set: Vec<usize> = found.set.iter().copied().filter(|x| *x != candidate).collect();
    let mut values = found.linear.at.clone();
    model.of(candidate).for_each(|k| values[k] = model.parameters[k].filed);
    let widest = found.tolerance;
    let start = Start { values, set: set.clone(), horizon: 1, widest, ..Start::beside(model, found) };
    again(logs, model, Some(&set), start, watch)
}

/// The same set with the model relinearised at all its estimates, including those within tolerance: several small errors
/// together bias a large one by more than its interval. `None` for forces alone, and if that model diverges in all windows.
pub(crate) fn polished(
    logs: &[Prepared],
    model: &mut Model,
    found: &Solution,
    watch: &Watch,
) -> Result<Option<Solution>, GapError> {
    if forces_only(logs) {
        return Ok(None);
    }
    refitted(logs, model, found, (&found.set, &found.posterior), watch)
}

/// A set fitted by one linearisation at its `posterior` and at what that corrects within tolerance.
pub(crate) fn refitted(
    logs: &[Prepared],
    model: &mut Model,
    found: &Solution,
    (set, posterior): (&[usize], &Posterior),
    watch: &Watch,
) -> Result<Option<Solution>, GapError> {
    let timing = model.timing();
    let mut start = Start { set: set.to_vec(), horizon: 1, follow: true, ..Start::beside(model, found) };
    // Candidates may have been added since.
    for (k, p) in model.parameters.iter().enumerate().take(posterior.mean.len()) {
        if set.contains(&p.candidate)
            || timing.contains(&p.candidate)
            || corrected(model, posterior, p.candidate)
        {
            start.values[k] = posterior.mean[k];
        }
    }
    again(logs, model, Some(set), start, watch)
}

/// A part of what was found, fitted with all else at the vehicle file but clocks; `None` if that model diverges in all windows.
pub(crate) fn fitted_with(
    logs: &[Prepared],
    model: &mut Model,
    found: &Solution,
    set: &[usize],
    watch: &Watch,
) -> Result<Option<Solution>, GapError> {
    let timing = model.timing();
    let mut start = Start { set: set.to_vec(), horizon: 1, ..Start::beside(model, found) };
    for (k, p) in model.parameters.iter().enumerate() {
        if set.contains(&p.candidate) || timing.contains(&p.candidate) {
            start.values[k] = found.posterior.mean[k];
        }
    }
    again(logs, model, Some(set), start, watch)
}

/// Widens standard deviations to at least the scatter between parts of the log.
pub(crate) fn with_scatter(model: &Model, mut found: Solution) -> Result<Solution, GapError> {
    let all = Information::new(model, &found.linear, &found.reduced, |_| true)?;
    let parts: Vec<&[Reduced]> = found.reduced.chunks(PART).collect();
    let mut posterior = found.posterior.clone();
    found.widen(model, &all, (&found.set, &found.deltas), &parts, &mut posterior)?;
    found.posterior = posterior;
    Ok(found)
}

impl Solution {
    /// Widens the standard deviations of a set's `posterior` to at least the scatter between the `parts` of the log, at
    /// `deltas` from the linearisation point.
    fn widen(
        &self,
        model: &Model,
        all: &Information,
        (set, deltas): (&[usize], &[Vec<f64>]),
        parts: &[&[Reduced]],
        posterior: &mut Posterior,
    ) -> Result<(), GapError> {
        let n = model.parameters.len();
        let of_part =
            |part: &&[Reduced]| part.iter().fold(DVector::zeros(n), |sum, r| sum + score(r, deltas));
        let scores: Vec<DVector<f64>> = parts.iter().map(of_part).collect();
        let evidence = |wider: f64| {
            let (at, tolerance) = (&self.linear.at, wider * self.tolerance);
            Evidence::new(model, &all.h, &all.g, at, self.dispersion, tolerance)
        };
        let enough = scores.len() >= FEWEST_PARTS;
        let scatter = if enough { evidence(1.0)?.by_scatter(set, &scores) } else { None };
        let wider = evidence(INTERVAL_TOLERANCE)?.covariance(set);
        for (k, sigma) in posterior.sigma.iter_mut().enumerate() {
            // An estimate held by a bound has no standard deviation.
            if *sigma > 0.0 {
                let scatter = scatter.as_ref().map_or(0.0, |s| s[k]);
                let p = &model.parameters[k];
                let size = posterior.mean[k] - p.filed;
                if let Some(wider) = wider.as_ref().filter(|_| set.contains(&p.candidate)) {
                    *sigma = sigma.max(wider[(k, k)].max(0.0).sqrt());
                }
                *sigma = sigma.max(scatter).hypot(BENT * p.spike).hypot(SIZE_KNOWN * size);
            }
        }
        Ok(())
    }

    /// The posterior of another set at the same linearisation, as wide as [`with_scatter`] makes that of its own. `all` are
    /// the sums of a solution that is [`Solution::compact`].
    pub fn of_set(&self, model: &Model, all: &Information, set: &[usize]) -> Result<Posterior, GapError> {
        let at = &self.linear.at;
        let evidence = Evidence::new(model, &all.h, &all.g, at, self.dispersion, self.tolerance)?;
        let mut posterior = evidence.posterior(set)?;
        let deltas = all.deltas(&difference(&posterior, at));
        let parts: Vec<&[Reduced]> = self.parts.iter().map(Vec::as_slice).collect();
        self.widen(model, all, (set, &deltas), &parts, &mut posterior)?;
        Ok(posterior)
    }

    /// Leaves of the windows the sums over each part of the log, which is all that other sets need: a hundredth of the
    /// memory.
    pub fn compact(&mut self) {
        let part = |part: &[Reduced]| {
            let mut out: Vec<Reduced> = Vec::new();
            for r in part {
                match out.iter_mut().find(|sum| sum.log == r.log) {
                    Some(sum) => {
                        sum.h += &r.h;
                        sum.g += &r.g;
                        sum.c += r.c;
                        sum.occam += r.occam;
                    }
                    None => out.push(r.clone()),
                }
            }
            out
        };
        self.parts = self.reduced.chunks(PART).map(part).collect();
        self.reduced = self.parts.concat();
        self.linear.windows = Vec::new();
    }

    /// All of it about every parameter.
    pub fn information(&self, model: &Model) -> Result<Information, GapError> {
        Information::new(model, &self.linear, &self.reduced, |_| true)
    }
}

/// Best accuracy of a parameter, as a share of its tolerance: the other parameters bias the model within theirs. In flights
/// of the generator motor lags were off by this much with a hundredth of it in their intervals.
const BENT: f64 = 0.03;

/// Best accuracy of a parameter, as a share of its deviation from nominal: log and model are two simulations even where the
/// effect is the same, and filters, clocks and mounts of the log are only known to this accuracy. In the flights of `bench
/// gap --half develop` translational lift, downwash and motor lags were off by 1.4 to 2.6 % with a tenth to a half of it in
/// their intervals.
const SIZE_KNOWN: f64 = 0.02;

/// Windows per part of a log, and fewest parts for a usable scatter.
pub(super) const PART: usize = 8;
const FEWEST_PARTS: usize = 8;

/// Whether the log moves a candidate's parameters off nominal, though within tolerance.
pub(super) fn corrected(model: &Model, posterior: &Posterior, candidate: usize) -> bool {
    !model.is_shape(candidate)
        && model.of(candidate).any(|k| {
            let p = &model.parameters[k];
            let off = (posterior.mean[k] - p.filed).abs();
            off > posterior.sigma[k] && off > 0.1 * p.spike
        })
}

/// Whether a found effect would have to be many times its plausible size.
fn implausible(model: &Model, found: &Solution, candidate: usize) -> bool {
    larger_than(model, found, candidate, HUGE)
}

/// Whether a parameter of a found effect is more than so many times its plausible size.
pub(super) fn larger_than(model: &Model, found: &Solution, candidate: usize, times: f64) -> bool {
    model.of(candidate).any(|k| {
        let p = &model.parameters[k];
        p.name != "frequency_hz" && (found.posterior.mean[k] - p.filed).abs() > times * p.slab
    })
}

/// Multiple of the plausible size above which an effect is implausible.
const HUGE: f64 = 4.0;

/// [`settle`] from a given start; `None` if the model diverges in all windows there.
fn again(
    logs: &[Prepared],
    model: &mut Model,
    given: Option<&[usize]>,
    start: Start,
    watch: &Watch,
) -> Result<Option<Solution>, GapError> {
    match settle(logs, model, given, Some(start), watch) {
        Err(GapError::Log { .. }) => Ok(None),
        other => other,
    }
}

/// A short search from the file: about so many of the long windows, and as many rounds as the noise estimate needs; `None`
/// where too few windows are usable. What disturbances there are without findings is not estimated.
pub(crate) fn glance(
    logs: &[Prepared],
    model: &mut Model,
    windows: usize,
) -> Result<Option<Solution>, GapError> {
    let quick = Some(windows);
    let start = Start { horizon: 1, quick, ..Start::file(model, Disturbance::unknown()) };
    again(logs, model, None, start, &Watch::default())
}

pub(super) fn no_window() -> GapError {
    GapError::Numbers { what: "the fit", reason: "no window could be used".into() }
}
