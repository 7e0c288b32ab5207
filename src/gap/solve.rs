//! From logs to the set of effects that explains them: linearise, search, move to the estimate, again until it settles, on
//! windows that grow longer.

use super::GapError;
use super::disturbance::{Disturbance, Reduced};
use super::fit::{Cut, Linear, Prepared, Starts, forces_only, linearise, shortest_window_s};
use super::model::Model;
use super::per_log::{Information, Values};
use super::policy::{
    GIVEN_ATTITUDE_RAD, GLANCE_ROUNDS, GLANCE_WINDOWS, GUST_BESIDE_MOTION, SHORT_WINDOWS, WEAK_NATS,
};
use super::search::{Evidence, Posterior, Scored};
use super::starts::{Start, fewer_clocks, named_by_witness};
use super::track::Noise;
use crate::flight::clean;
use nalgebra::{DMatrix, DVector};

/// Lengths of the windows, s: short ones first, since long ones see further but bend more.
const HORIZONS_S: [f64; 2] = [0.1, 0.25];
/// Most passes of the disturbances' sizes per linearisation, and steps of expectation maximisation in each.
const PASSES: usize = 4;
const STEPS: usize = 3;
/// Most linearisations per length.
const ROUNDS: [usize; 2] = [4, 4];
/// Widths of a vehicle's tolerances that are tried, times the usual: a vehicle built or measured carelessly is off in many
/// numbers, which is no missing effect.
const TOLERANCES: [f64; 3] = [1.4, 2.0, 2.8];
/// Standard deviation of the logarithm of that width.
const TOLERANCE_SPREAD: f64 = 0.15;
/// Longest move of a parameter between linearisations, slabs.
const LONGEST_STEP: f64 = 1.5;

/// Price of tolerances so many times wider than usual, nats.
fn price_of(tolerance: f64) -> f64 {
    0.5 * (tolerance.ln() / TOLERANCE_SPREAD).powi(2)
}

/// Where a search has settled.
pub(crate) struct Solution {
    /// Candidates in the verdict, rising.
    pub set: Vec<usize>,
    pub linear: Linear,
    pub reduced: Vec<Reduced>,
    pub disturbance: Disturbance,
    /// Disturbances with nothing found, at the same window length.
    pub disturbance_before: Disturbance,
    pub dispersion: f64,
    /// The same beside what was found, over the noise that neighbouring samples show: what no disturbance makes.
    pub misfit: f64,
    /// How many times wider than usual this vehicle's tolerances are.
    pub tolerance: f64,
    pub posterior: Posterior,
    /// Every log's parameters at their estimate less those where it was linearised, shape (log, parameter).
    pub deltas: Vec<Vec<f64>>,
}

impl Solution {
    /// The evidence at the last linearisation.
    pub fn evidence<'a>(&self, model: &'a Model) -> Result<Evidence<'a>, GapError> {
        let all = Information::new(model, &self.linear, &self.reduced, |_| true)?;
        Evidence::new(model, &all.h, &all.g, &self.linear.at, self.dispersion, self.tolerance)
    }

    /// A log's parameters at their estimate.
    pub fn values_of(&self, log: usize) -> Vec<f64> {
        let mut out = self.linear.values_of(log);
        out.iter_mut().zip(&self.deltas[log]).for_each(|(v, d)| *v += d);
        out
    }

    /// [`Self::deltas`] with the parameters that are `back` where they are filed, in every log.
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
    /// Log evidence less the price of the effects, with disturbances of such sizes.
    fn whole(&self, model: &Model, dispersion: f64, disturbance: &Disturbance) -> Result<f64, GapError> {
        let reduced = self.linear.reduce(disturbance);
        let all = Information::new(model, &self.linear, &reduced, |_| true)?;
        let evidence = Evidence::new(model, &all.h, &all.g, &self.linear.at, dispersion, self.tolerance)?;
        // Windows differ a little in their rows where clocks move: per row.
        let rows: usize = self.linear.windows.iter().map(|w| w.n_rows).sum();
        let price = super::search::THRESHOLD * self.set.len() as f64 + price_of(self.tolerance);
        let whole = evidence.whole(&self.set, all.c, &all.g, &all.h, &self.linear.at);
        Ok(whole - all.occam + 0.5 * rows as f64 - price)
    }

    /// Whether its numbers lie where the model was linearised: what is said of a place far away is a guess that the model was
    /// never asked about. A light vehicle looked like drag there, by a mass of a seventh and a thrust of a seventh.
    fn near_by(&self, model: &Model) -> bool {
        self.set.iter().flat_map(|c| model.of(*c)).all(|k| {
            (self.posterior.mean[k] - self.linear.at[k]).abs() <= LONGEST_STEP * model.parameters[k].slab
        })
    }

    /// Whether the log speaks more for this than for `other`. Sizes of disturbances creep to their best values: each of the two
    /// may take those of the other.
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

/// χ² of a window with every log's parameters `deltas` from where it was linearised.
pub(crate) fn chi2(r: &Reduced, deltas: &[Vec<f64>]) -> f64 {
    let delta = DVector::from_column_slice(&deltas[r.log]);
    r.c - 2.0 * r.g.dot(&delta) + delta.dot(&(&r.h * &delta))
}

/// Slope of a window's log likelihood by the parameters, there.
fn score(r: &Reduced, deltas: &[Vec<f64>]) -> DVector<f64> {
    &r.g - &r.h * DVector::from_column_slice(&deltas[r.log])
}

fn difference(posterior: &Posterior, at: &[f64]) -> Vec<f64> {
    posterior.mean.iter().zip(at).map(|(m, a)| m - a).collect()
}

/// How much larger than expected residuals scatter: the larger of χ² per degree of freedom and the scatter of window scores
/// over the information (median over parameters that the log says something about), at least 1.
fn dispersion(model: &Model, linear: &Linear, reduced: &[Reduced], deltas: &[Vec<f64>]) -> f64 {
    let rows: usize = linear.windows.iter().map(|w| w.n_rows).sum();
    let used = 12 * linear.windows.len();
    let total: f64 = reduced.iter().map(|r| chi2(r, deltas)).sum();
    let per_row = total / (rows.saturating_sub(used).max(1)) as f64;
    let n = model.parameters.len();
    let (mut scatter, mut information) = (vec![0.0; n], vec![0.0; n]);
    for r in reduced {
        let score = score(r, deltas);
        for k in 0..n {
            scatter[k] += score[k] * score[k];
            information[k] += r.h[(k, k)];
        }
    }
    let ratios: Vec<f64> = (0..n)
        .filter(|k| information[*k] * model.parameters[*k].slab.powi(2) > 10.0)
        .map(|k| scatter[k] / information[k])
        .collect();
    clean::median(ratios).unwrap_or(1.0).max(per_row).max(1.0)
}

/// How much larger, squared, the noise beside the model is than what neighbouring samples show, in the worst channel.
fn inflation(noise: &[Noise], least: &[Noise]) -> f64 {
    let pairs = noise.iter().zip(least).flat_map(|(a, b)| a.channels().into_iter().zip(b.channels()));
    pairs.map(|(a, b)| (a / b).powi(2)).fold(1.0, f64::max)
}

/// Searches (or, with `given`, fits that set) until it settles. `progress(done, of)` hears of every linearisation.
///
/// A search walks downhill from the file. All sensors late by the same time look like late commands, and one of them early
/// like the others late: a walk can end anywhere along that line. Then it goes on from the place on the line that needs the
/// fewest causes, and the more evident of the two stands.
pub(crate) fn solve(
    logs: &[Prepared],
    model: &mut Model,
    given: Option<&[usize]>,
    progress: &dyn Fn(usize, usize),
) -> Result<Solution, GapError> {
    let mut best = settle(logs, model, given, None, progress)?.ok_or_else(no_window)?;
    if given.is_some() {
        return Ok(best);
    }
    let mut tried = vec![best.set.clone()];
    for _ in 0..2 {
        let Some(start) = fewer_clocks(model, &best).filter(|s| !tried.contains(&s.set)) else { break };
        tried.push(start.set.clone());
        if let Some(other) = again(logs, model, None, start, progress)?
            && other.better_than(&best, model)?
        {
            best = other;
        }
    }
    if let Some(start) = named_by_witness(logs, model, &best)
        && let Some(other) = again(logs, model, None, start, progress)?
        && other.better_than(&best, model)?
    {
        best = other;
    }
    // What no effect of a plausible size explains may be the end of a wrong way: others are tried from the file, one by one.
    if !best.set.iter().any(|c| implausible(model, &best, *c)) {
        return pruned(logs, model, best, progress);
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
        if let Some(other) = again(logs, model, None, start, progress)?
            && other.better_than(&best, model)?
        {
            best = other;
        }
    }
    pruned(logs, model, best, progress)
}

/// Without the effects that the log does not miss after all. One on little evidence, which only stands because the model was
/// bent towards it (a limit that few commands reach), goes where the model without it does not ask for it, and where it would
/// have to be many times its plausible size. Wider tolerances, which would explain any small effect, are not tried without it.
fn pruned(
    logs: &[Prepared],
    model: &mut Model,
    mut best: Solution,
    progress: &dyn Fn(usize, usize),
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
            let Some(other) = left_out(logs, model, &best, c, progress)? else { continue };
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

/// The same without one of the effects; `None` where that model flies nowhere.
pub(crate) fn left_out(
    logs: &[Prepared],
    model: &mut Model,
    found: &Solution,
    candidate: usize,
    progress: &dyn Fn(usize, usize),
) -> Result<Option<Solution>, GapError> {
    let set: Vec<usize> = found.set.iter().copied().filter(|x| *x != candidate).collect();
    let mut values = found.linear.at.clone();
    model.of(candidate).for_each(|k| values[k] = model.parameters[k].filed);
    let widest = found.tolerance;
    let start = Start { values, set: set.clone(), horizon: 1, widest, ..Start::beside(model, found) };
    again(logs, model, Some(&set), start, progress)
}

/// The same set with the model moved to all its estimates, also those within tolerance: several small faults together bend
/// what a large one is taken for, by more than its interval. `None` for forces alone, and where that model flies nowhere.
pub(crate) fn polished(
    logs: &[Prepared],
    model: &mut Model,
    found: &Solution,
    progress: &dyn Fn(usize, usize),
) -> Result<Option<Solution>, GapError> {
    if forces_only(logs) {
        return Ok(None);
    }
    let timing = model.timing();
    let mut start = Start { set: found.set.clone(), horizon: 1, follow: true, ..Start::beside(model, found) };
    // Candidates may have been added since.
    for (k, p) in model.parameters.iter().enumerate().take(found.posterior.mean.len()) {
        if found.set.contains(&p.candidate)
            || timing.contains(&p.candidate)
            || corrected(model, &found.posterior, p.candidate)
        {
            start.values[k] = found.posterior.mean[k];
        }
    }
    again(logs, model, Some(&found.set), start, progress)
}

/// With standard deviations no smaller than the log's parts disagree by.
pub(crate) fn with_scatter(model: &Model, mut found: Solution) -> Result<Solution, GapError> {
    let n = model.parameters.len();
    let scores: Vec<DVector<f64>> = found
        .reduced
        .chunks(PART)
        .map(|part| part.iter().fold(DVector::zeros(n), |sum, r| sum + score(r, &found.deltas)))
        .collect();
    let scatter = if scores.len() < FEWEST_PARTS {
        None
    } else {
        found.evidence(model)?.by_scatter(&found.set, &scores)
    };
    for (k, sigma) in found.posterior.sigma.iter_mut().enumerate() {
        // Nothing is known of the width of a number that a bound holds.
        if *sigma > 0.0 {
            let scatter = scatter.as_ref().map_or(0.0, |s| s[k]);
            *sigma = sigma.max(scatter).hypot(BENT * model.parameters[k].spike);
        }
    }
    Ok(found)
}

/// Share of its tolerance to which a number is known at best: the others bend the model within theirs. In flights of the
/// generator motor lags were off by this much with a hundredth of it in their intervals.
const BENT: f64 = 0.03;

/// Windows of one part of a log, and parts below which their scatter says little.
const PART: usize = 8;
const FEWEST_PARTS: usize = 8;

/// Whether the log says that a candidate's numbers are not those of the file, though within tolerance.
fn corrected(model: &Model, posterior: &Posterior, candidate: usize) -> bool {
    !model.is_shape(candidate)
        && model.of(candidate).any(|k| {
            let p = &model.parameters[k];
            let off = (posterior.mean[k] - p.filed).abs();
            off > posterior.sigma[k] && off > 0.1 * p.spike
        })
}

/// Whether a found effect would have to be many times its plausible size.
fn implausible(model: &Model, found: &Solution, candidate: usize) -> bool {
    model.of(candidate).any(|k| {
        let p = &model.parameters[k];
        p.name != "frequency_hz" && (found.posterior.mean[k] - p.filed).abs() > HUGE * p.slab
    })
}

/// Plausible sizes from which on an effect is doubted.
const HUGE: f64 = 4.0;

/// [`settle`] from a start of its own; `None` where the model there flies through no window.
fn again(
    logs: &[Prepared],
    model: &mut Model,
    given: Option<&[usize]>,
    start: Start,
    progress: &dyn Fn(usize, usize),
) -> Result<Option<Solution>, GapError> {
    match settle(logs, model, given, Some(start), progress) {
        Err(GapError::Log { .. }) => Ok(None),
        other => other,
    }
}

/// A short search from the file: a few of the long windows, and as many rounds as the noise needs; `None` where too few windows can be
/// used.
pub(crate) fn glance(logs: &[Prepared], model: &mut Model) -> Result<Option<Solution>, GapError> {
    let start = Start { horizon: 1, quick: true, ..Start::file(model, Disturbance::unknown()) };
    again(logs, model, None, start, &|_, _| {})
}

fn no_window() -> GapError {
    GapError::Numbers { what: "the fit", reason: "no window could be used".into() }
}

/// One search from one start; none where it comes [`Start::back`].
fn settle(
    logs: &[Prepared],
    model: &mut Model,
    given: Option<&[usize]>,
    start: Option<Start>,
    progress: &dyn Fn(usize, usize),
) -> Result<Option<Solution>, GapError> {
    let mut filed = model.filed();
    let from_file = start.is_none();
    let every: Vec<usize> = (0..model.candidates.len()).filter(|c| model.may[*c]).collect();
    let is_gust = |c: &usize| model.candidates[*c].kind == "gust";
    let may_gust = given.unwrap_or(&every).iter().any(is_gust);
    // A given set needs no short windows, which only lead to where a search begins on long ones; but for the line of a gust.
    let start = start.unwrap_or_else(|| Start {
        set: given.map(<[usize]>::to_vec).unwrap_or_default(),
        horizon: usize::from(given.is_some() && !may_gust),
        ..Start::file(model, Disturbance::unknown())
    });
    let Start {
        values,
        apart,
        mut set,
        mut disturbance,
        horizon,
        held,
        back,
        follow,
        widest,
        quick,
        noise: known,
    } = start;
    let mut values = Values { shared: values, apart };
    let least: Vec<Noise> = logs.iter().map(|l| l.noise).collect();
    let mut noise = known.clone().unwrap_or_else(|| least.clone());
    let forces_only = forces_only(logs);
    if (from_file || quick) && forces_only {
        disturbance.attitude_rad = GIVEN_ATTITUDE_RAD;
    }
    let all: usize = ROUNDS.iter().sum();
    let mut done = 0;
    let mut last = None;
    let timing = model.timing();
    let mut tolerance = 1.0;
    let shortest_s = shortest_window_s(logs);
    for (horizon_s, rounds) in HORIZONS_S.into_iter().zip(ROUNDS).skip(horizon) {
        let mut starts = Starts::new();
        let rounds = match (follow, quick) {
            (true, _) => 1,
            (_, true) => GLANCE_ROUNDS,
            _ => rounds,
        };
        for _ in 0..rounds {
            let moved =
                |c: usize| follow && model.of(c).any(|k| values.shared[k] != model.parameters[k].filed);
            let at_work: Vec<usize> = (0..model.candidates.len())
                .filter(|c| set.contains(c) || timing.contains(c) || moved(*c))
                .collect();
            let length_s = horizon_s.max(shortest_s);
            // The line of a spectrum is looked for in all windows, and the last word needs all of them.
            let look = done == 0 && from_file && may_gust;
            let most = match (quick, horizon_s == HORIZONS_S[0] && !look) {
                (true, _) => GLANCE_WINDOWS,
                (_, true) => SHORT_WINDOWS,
                _ => usize::MAX,
            };
            let cut = Cut { length_s, most };
            let linear = linearise(logs, model, &values, &at_work, cut, &starts, &noise);
            progress(done, all);
            done += 1;
            if linear.windows.len() < 4 {
                if last.is_some() {
                    break;
                }
                return Err(GapError::Log {
                    log: logs.first().map_or_else(String::new, |l| l.track.name.clone()),
                    expected: format!("at least 4 stretches of {length_s:.2} s with pose and inputs"),
                    found: linear.windows.len().to_string(),
                    remedy: "check the log for gaps (propwash log check), or give a longer flight".into(),
                });
            }
            // The disturbances' sizes with the present set, then the search with them.
            let mut phi = 1.0;
            let mut pass = 0;
            let (reduced, all) = loop {
                let reduced = linear.reduce(&disturbance);
                let all = Information::new(model, &linear, &reduced, |_| true)?;
                let evidence = Evidence::new(model, &all.h, &all.g, &linear.at, phi, tolerance)?;
                let posterior = evidence.posterior(&set)?;
                let delta = all.deltas(&difference(&posterior, &linear.at));
                // What any candidate could explain is no scatter: a missing effect would divide its own evidence by it.
                let free = all.deltas(&difference(&evidence.posterior(&every)?, &linear.at));
                phi = dispersion(model, &linear, &reduced, &free);
                if pass >= PASSES {
                    break (reduced, all);
                }
                // Expectation maximisation creeps: several steps for one look at the parameters.
                let mut near = false;
                for _ in 0..STEPS {
                    let mut next = linear.disturbance(&disturbance, &delta);
                    if horizon_s == HORIZONS_S[0] {
                        next.kept = [0.0; 4];
                    }
                    near = next.near(&disturbance);
                    disturbance = next;
                    if near {
                        break;
                    }
                }
                pass = if near { PASSES } else { pass + 1 };
            };
            // A gust is one line of a spectrum: which, the disturbances tell once.
            let hz = if look { loudest_hz(logs, &linear, &disturbance) } else { None };
            if hz.is_some_and(|hz| model.preset_of("gust", "frequency_hz", hz)) {
                values = model.filed().into();
                filed = model.filed();
                continue;
            }
            // The set, and how wide this vehicle's tolerances are.
            let choose = |model: &Model, tolerance: f64| -> Result<(f64, Scored), GapError> {
                let evidence = Evidence::new(model, &all.h, &all.g, &linear.at, phi, tolerance)?;
                let held = (done <= held).then_some(&*set);
                let scored = match given.or(held) {
                    Some(given) => Scored { set: given.to_vec(), evidence: evidence.of(given) },
                    None => evidence.search().0,
                };
                Ok((evidence.empty() + scored.score() - price_of(tolerance), scored))
            };
            let (mut most, mut best) = choose(model, 1.0)?;
            if done > held && back.as_ref() == Some(&best.set) {
                return Ok(None);
            }
            tolerance = 1.0;
            // Short windows, seen from far off, would take a missing effect for carelessness.
            let tried = |wider: &f64| horizon_s == HORIZONS_S[1] && !forces_only && *wider <= widest;
            for wider in TOLERANCES.into_iter().filter(tried) {
                let (total, scored) = choose(model, wider)?;
                if total <= most {
                    break;
                }
                (most, best, tolerance) = (total, scored, wider);
            }
            let evidence = Evidence::new(model, &all.h, &all.g, &linear.at, phi, tolerance)?;
            let posterior = evidence.posterior(&best.set)?;
            let delta = difference(&posterior, &linear.at);
            let deltas = all.deltas(&delta);
            let mut next = filed.clone();
            let mut next_apart = vec![vec![0.0; filed.len()]; logs.len()];
            let mut moved: f64 = 0.0;
            let off = |c: usize| follow && corrected(model, &posterior, c);
            for (k, p) in model.parameters.iter().enumerate() {
                let c = p.candidate;
                if best.set.contains(&c) || timing.contains(&c) || off(c) {
                    let step = (posterior.mean[k] - linear.at[k])
                        .clamp(-LONGEST_STEP * p.slab, LONGEST_STEP * p.slab);
                    next[k] = linear.at[k] + step;
                    if let Some(least) = model.least(k) {
                        next[k] = next[k].max(least);
                    }
                    moved = moved.max(step.abs() / posterior.sigma[k].max(0.02 * p.slab));
                }
                if all.differing.contains(&k) && (best.set.contains(&c) || timing.contains(&c)) {
                    for (log, apart) in next_apart.iter_mut().enumerate() {
                        let now = linear.apart.get(log).map_or(0.0, |apart| apart[k]);
                        let step =
                            (deltas[log][k] - delta[k]).clamp(-LONGEST_STEP * p.slab, LONGEST_STEP * p.slab);
                        apart[k] = now + step;
                        moved = moved.max(step.abs() / posterior.sigma[k].max(0.02 * p.slab));
                    }
                }
            }
            // With all candidates free, for the same reason as above.
            let quieter = match &known {
                Some(known) => known.clone(),
                None => {
                    let free = all.deltas(&difference(&evidence.posterior(&every)?, &linear.at));
                    linear.noise_beside(&disturbance, &free, &least)
                }
            };
            let same_noise = quieter.iter().zip(&noise).all(|(a, b)| a.near(b));
            noise = quieter;
            if !forces_only {
                starts = linear.starts(&disturbance, &deltas);
            }
            let same = best.set == set;
            set = best.set.clone();
            values = Values { shared: next, apart: next_apart };
            let misfit = dispersion(model, &linear, &reduced, &deltas) * inflation(&linear.noise, &least);
            let found = Solution {
                set: set.clone(),
                linear,
                reduced,
                disturbance,
                disturbance_before: disturbance,
                dispersion: phi,
                misfit,
                tolerance,
                posterior,
                deltas,
            };
            // A search that jumps far off in its last round has not been there.
            let of_now = last.take_if(|l: &mut Solution| {
                l.linear.horizon_s == found.linear.horizon_s && l.near_by(model) && !found.near_by(model)
            });
            last = Some(of_now.unwrap_or(found));
            if same && same_noise && moved < 1.0 && done > held {
                break;
            }
        }
    }
    progress(all, all);
    let mut solution = last.ok_or_else(no_window)?;
    // How large the disturbances would have to be without anything found.
    // Found effects are back at the file; a spike alone would not hold them there against so much data.
    let deltas = solution.deltas_without(model, |c| solution.set.contains(&c));
    solution.disturbance_before = Disturbance::unknown();
    for _ in 0..6 {
        solution.disturbance_before = solution.linear.disturbance(&solution.disturbance_before, &deltas);
    }
    Ok(Some(solution))
}

/// Frequency (Hz) at which the windows' disturbances swing most, of all three axes together: the highest peak of the
/// least-squares spectrum (Lomb, Astrophysics and Space Science 39, 1976) between two periods in the log and 3 Hz. `None`
/// where no peak stands out.
fn loudest_hz(logs: &[Prepared], linear: &Linear, disturbance: &Disturbance) -> Option<f64> {
    let nothing = vec![0.0; linear.at.len()];
    let mut samples: Vec<(f64, [f64; 3])> = Vec::new();
    for w in linear.windows.iter().filter(|w| w.log == 0) {
        let (mean, _) = w.push_estimate(disturbance, &nothing)?;
        samples.push((logs[0].around.time_s(w.from) + 0.5 * linear.horizon_s, [mean[0], mean[1], mean[2]]));
    }
    let own: Vec<(f64, [f64; 3])> = linear
        .windows
        .iter()
        .filter(|w| w.log == 0)
        .zip(&samples)
        .map(|(w, (t, _))| (*t, w.start.vel))
        .collect();
    let (first, last) = (samples.first()?.0, samples.last()?.0);
    let length = last - first;
    if samples.len() < 40 || length < 4.0 {
        return None;
    }
    let step = 0.2 / length;
    let power_of = |samples: &[(f64, [f64; 3])], hz: f64| -> f64 {
        let turn = 2.0 * core::f64::consts::PI * hz;
        let (mut cc, mut ss, mut cs) = (0.0, 0.0, 0.0);
        let mut y = [[0.0; 2]; 3];
        for (t, a) in samples {
            let (s, c) = (turn * t).sin_cos();
            cc += c * c;
            ss += s * s;
            cs += c * s;
            for k in 0..3 {
                y[k][0] += c * a[k];
                y[k][1] += s * a[k];
            }
        }
        let det = cc * ss - cs * cs;
        y.iter().map(|[c, s]| (ss * c * c - 2.0 * cs * c * s + cc * s * s) / det).sum()
    };
    let power = |hz: f64| power_of(&samples, hz);
    let n = ((3.0 - 2.0 / length) / step) as usize;
    let spectrum: Vec<(f64, f64)> =
        (0..n).map(|i| 2.0 / length + i as f64 * step).map(|hz| (hz, power(hz))).collect();
    let (hz, peak) = *spectrum.iter().max_by(|a, b| a.1.total_cmp(&b.1))?;
    let usual = clean::median(spectrum.iter().map(|s| s.1).collect())?;
    // At a frequency at which the vehicle itself goes to and fro, whatever is wrong with the model comes back with it.
    let moves: Vec<f64> = spectrum.iter().map(|s| power_of(&own, s.0)).collect();
    // Where the path itself repeats, its errors do too: most of them go with velocity and acceleration, and the line with them.
    // Only a log without torques needs that doubt: elsewhere what the vehicle does is told from what pushes it.
    let doubtful = logs[0].track.drive == super::track::Drive::Thrust;
    let repeats = doubtful
        && power_of(&own, hz) > 8.0 * clean::median(moves)?
        && power_of(&beside_motion(&samples, &own)?, hz) < GUST_BESIDE_MOTION * peak;
    (peak > 8.0 * usual && !repeats).then_some(hz)
}

/// Samples without what goes with velocity and acceleration, by least squares in each component.
fn beside_motion(samples: &[(f64, [f64; 3])], own: &[(f64, [f64; 3])]) -> Option<Vec<(f64, [f64; 3])>> {
    let n = samples.len();
    let slope = |i: usize, k: usize| {
        let (a, b) = (i.saturating_sub(1), (i + 1).min(n - 1));
        (own[b].1[k] - own[a].1[k]) / (own[b].0 - own[a].0).max(1e-6)
    };
    let row = |i: usize, c: usize| match c {
        0 => 1.0,
        1..=3 => own[i].1[c - 1],
        _ => slope(i, c - 4),
    };
    let motion = DMatrix::from_fn(n, 7, row);
    let forces = DMatrix::from_fn(n, 3, |i, k| samples[i].1[k]);
    let coefficients = (motion.transpose() * &motion).cholesky()?.solve(&(motion.transpose() * &forces));
    let left = forces - motion * coefficients;
    Some((0..n).map(|i| (samples[i].0, [left[(i, 0)], left[(i, 1)], left[(i, 2)]])).collect())
}
