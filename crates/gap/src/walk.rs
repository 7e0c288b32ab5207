//! One search: linearise, estimate the disturbances' sizes, choose the set, move to the estimate, on windows of growing
//! length, until it converges.

use super::GapError;
use super::disturbance::{Disturbance, Reduced};
use super::fit::{Cut, EVER_S, Linear, Prepared, Starts, forces_only, linearise, shortest_window_s};
use super::gust_line::loudest_hz;
use super::model::Model;
use super::per_log::{Information, Values};
use super::policy::{GIVEN_ATTITUDE_RAD, GLANCE_ROUNDS, SHORT_WINDOWS};
use super::search::{Evidence, Scored};
use super::solve::{LONGEST_STEP, Solution, chi2, corrected, difference, no_window, price_of, score};
use super::starts::Start;
use super::track::Noise;
use super::watch::{Ranked, Watch};
use propwash_flight::clean;
use propwash_physics::effects::FromLog;

/// Lengths of the windows, s: short ones first, since long ones are more sensitive but less linear.
const HORIZONS_S: [f64; 2] = [0.1, 0.25];
/// Most updates of the disturbances' sizes per linearisation, and steps of expectation maximisation in each.
const PASSES: usize = 4;
const STEPS: usize = 3;
/// Most linearisations per window length.
const ROUNDS: [usize; 2] = [4, 4];
/// Tolerance factors that are tried: a carelessly built or measured vehicle is off in many parameters, which is no missing
/// effect.
const TOLERANCES: [f64; 3] = [1.4, 2.0, 2.8];

/// One search from one start; `None` if it reaches [`Start::back`].
pub(super) fn settle(
    logs: &[Prepared],
    model: &mut Model,
    given: Option<&[usize]>,
    start: Option<Start>,
    watch: &Watch,
) -> Result<Option<Solution>, GapError> {
    let mut walk = Walk::new(logs, model, given, start);
    let all: usize = ROUNDS.iter().sum();
    let mut last = None;
    for (horizon_s, rounds) in HORIZONS_S.into_iter().zip(ROUNDS).skip(walk.start.horizon) {
        walk.starts = Starts::new();
        for round in 1..=walk.rounds(rounds) {
            let linear = walk.linearise(model, horizon_s, watch);
            watch.check()?;
            watch.done(walk.done, all);
            walk.done += 1;
            if linear.windows.len() < 4 {
                if last.is_some() {
                    break;
                }
                return Err(walk.too_short(&linear));
            }
            let known = walk.disturbances(model, &linear, horizon_s)?;
            if walk.tune_gust(model, &linear) {
                continue;
            }
            let Some(set) = walk.choose(model, &linear, &known, horizon_s)? else { return Ok(None) };
            if let Some(early) = watch.early.filter(|_| walk.from_file && walk.given.is_none()) {
                early(&walk.ranked(model, &linear, &known, &set)?);
            }
            let ends = horizon_s == HORIZONS_S[1] && round == walk.rounds(rounds);
            let (found, settled) = walk.step(model, linear, known, set, ends)?;
            // A last round that jumps far from its linearisation point is discarded.
            let of_now = last.take_if(|l: &mut Solution| {
                l.linear.horizon_s == found.linear.horizon_s && l.near_by(model) && !found.near_by(model)
            });
            last = Some(of_now.unwrap_or(found));
            if settled {
                break;
            }
        }
    }
    watch.done(all, all);
    let mut solution = last.ok_or_else(no_window)?;
    if walk.start.quick.is_some() {
        return Ok(Some(solution));
    }
    // Disturbances without any findings: the effects are reset to nominal, since a spike alone would not hold them there
    // against so much data.
    let deltas = solution.deltas_without(model, |c| solution.set.contains(&c));
    solution.disturbance_before = Disturbance::unknown();
    for _ in 0..6 {
        solution.disturbance_before = solution.linear.disturbance(&solution.disturbance_before, &deltas);
    }
    Ok(Some(solution))
}

/// State of a search in progress.
struct Walk<'a> {
    logs: &'a [Prepared<'a>],
    given: Option<&'a [usize]>,
    /// Its start; values, set and disturbance are updated.
    start: Start,
    from_file: bool,
    forces_only: bool,
    /// Candidates that a search may choose, and those that shift samples in time.
    every: Vec<usize>,
    timing: Vec<usize>,
    /// Whether to look for a gust frequency.
    may_gust: bool,
    /// Noise from neighbouring samples, and the noise by which rows are divided now.
    least: Vec<Noise>,
    noise: Vec<Noise>,
    values: Values,
    starts: Starts,
    tolerance: f64,
    /// Number of linearisations so far.
    done: usize,
}

/// A linearisation with its estimated disturbances.
struct Known {
    reduced: Vec<Reduced>,
    all: Information,
    dispersion: f64,
}

impl<'a> Walk<'a> {
    fn new(
        logs: &'a [Prepared<'a>],
        model: &Model,
        given: Option<&'a [usize]>,
        start: Option<Start>,
    ) -> Self {
        let from_file = start.is_none();
        let every: Vec<usize> = (0..model.candidates.len()).filter(|c| model.may[*c]).collect();
        let is_gust = |c: &usize| model.candidates[*c].given(FromLog::LoudestFrequency).is_some();
        let may_gust = given.unwrap_or(&every).iter().any(is_gust);
        // A given set needs no short windows, which only provide a start for the long ones; except for the gust frequency.
        let mut start = start.unwrap_or_else(|| Start {
            set: given.map(<[usize]>::to_vec).unwrap_or_default(),
            horizon: usize::from(given.is_some() && !may_gust),
            ..Start::file(model, Disturbance::unknown())
        });
        let least: Vec<Noise> = logs.iter().map(|l| l.noise).collect();
        let forces_only = forces_only(logs);
        if (from_file || start.quick.is_some()) && forces_only {
            start.disturbance.attitude_rad = GIVEN_ATTITUDE_RAD;
        }
        Self {
            logs,
            given,
            from_file,
            forces_only,
            every,
            timing: model.timing(),
            may_gust,
            noise: start.noise.clone().unwrap_or_else(|| least.clone()),
            least,
            values: Values { shared: start.values.clone(), apart: start.apart.clone() },
            starts: Starts::new(),
            tolerance: 1.0,
            done: 0,
            start,
        }
    }

    fn rounds(&self, usual: usize) -> usize {
        match (self.start.follow, self.start.quick) {
            (true, _) => 1,
            (_, Some(_)) => GLANCE_ROUNDS,
            _ => usual,
        }
    }

    /// Whether this is the first pass from the file, in which the gust frequency is looked for in all windows.
    fn looks_for_gust(&self, done: usize) -> bool {
        done == 0 && self.from_file && self.may_gust
    }

    fn linearise(&self, model: &Model, horizon_s: f64, watch: &Watch) -> Linear {
        let moved = |c: usize| {
            let off = |k: usize| self.values.shared[k] != model.parameters[k].filed;
            self.start.follow && model.of(c).any(off)
        };
        let at_work: Vec<usize> = (0..model.candidates.len())
            .filter(|c| self.start.set.contains(c) || self.timing.contains(c) || moved(*c))
            .collect();
        // The final rounds need all windows.
        let short = horizon_s == HORIZONS_S[0] && !self.looks_for_gust(self.done);
        let most = match (self.start.quick, short) {
            (Some(windows), _) => windows,
            (_, true) => SHORT_WINDOWS,
            _ => usize::MAX,
        };
        let length_s = horizon_s.max(shortest_window_s(self.logs));
        let cut = Cut { length_s, most, begin_s: EVER_S, cancel: watch.cancel };
        linearise(self.logs, model, &self.values, &at_work, cut, &self.starts, &self.noise)
    }

    fn too_short(&self, linear: &Linear) -> GapError {
        GapError::Log {
            log: self.logs.first().map_or_else(String::new, |l| l.track.name.clone()),
            expected: format!("at least 4 stretches of {:.2} s with pose and inputs", linear.horizon_s),
            found: linear.windows.len().to_string(),
            remedy: "check the log for gaps (propwash log check), or give a longer flight".into(),
        }
    }

    /// Estimates the disturbances' sizes with the current set, and reduces the windows with them.
    fn disturbances(&mut self, model: &Model, linear: &Linear, horizon_s: f64) -> Result<Known, GapError> {
        let mut phi = 1.0;
        let mut pass = 0;
        loop {
            let reduced = linear.reduce(&self.start.disturbance);
            let all = Information::new(model, linear, &reduced, |_| true)?;
            let evidence = Evidence::new(model, &all.h, &all.g, &linear.at, phi, self.tolerance)?;
            let posterior = evidence.posterior(&self.start.set)?;
            let delta = all.deltas(&difference(&posterior, &linear.at));
            // The dispersion is taken with all candidates free: otherwise a missing effect would reduce its own evidence.
            let free = all.deltas(&difference(&evidence.posterior(&self.every)?, &linear.at));
            phi = dispersion(model, linear, &reduced, &free);
            if pass >= PASSES {
                return Ok(Known { reduced, all, dispersion: phi });
            }
            // Expectation maximisation converges slowly: several steps per update of the parameters.
            let mut near = false;
            for _ in 0..STEPS {
                let mut next = linear.disturbance(&self.start.disturbance, &delta);
                if horizon_s == HORIZONS_S[0] {
                    next.kept = [0.0; 4];
                }
                near = next.near(&self.start.disturbance);
                self.start.disturbance = next;
                if near {
                    break;
                }
            }
            pass = if near { PASSES } else { pass + 1 };
        }
    }

    /// A gust has a single frequency, taken once from the disturbances. Returns whether there is one; then the search
    /// restarts.
    fn tune_gust(&mut self, model: &mut Model, linear: &Linear) -> bool {
        if !self.looks_for_gust(self.done - 1) {
            return false;
        }
        let hz = loudest_hz(self.logs, linear, &self.start.disturbance);
        let tuned = match (model.given(FromLog::LoudestFrequency), hz) {
            (Some((gust, name)), Some(hz)) => model.preset_of(gust, name, hz),
            _ => false,
        };
        if tuned {
            self.values = model.filed().into();
        }
        tuned
    }

    /// Chooses the set and this vehicle's tolerance factor; `None` if the search reaches [`Start::back`].
    fn choose(
        &mut self,
        model: &Model,
        linear: &Linear,
        known: &Known,
        horizon_s: f64,
    ) -> Result<Option<Vec<usize>>, GapError> {
        let all = &known.all;
        let one = |tolerance: f64| -> Result<(f64, Scored), GapError> {
            let evidence = Evidence::new(model, &all.h, &all.g, &linear.at, known.dispersion, tolerance)?;
            let held = (self.done <= self.start.held).then_some(&*self.start.set);
            let scored = match self.given.or(held) {
                Some(given) => Scored { set: given.to_vec(), evidence: evidence.of(given) },
                None => evidence.search().0,
            };
            Ok((evidence.empty() + scored.score() - price_of(tolerance), scored))
        };
        let (mut most, mut best) = one(1.0)?;
        if self.done > self.start.held && self.start.back.as_ref() == Some(&best.set) {
            return Ok(None);
        }
        let mut widest = 1.0;
        // Far from the optimum, short windows blame loose tolerances for a missing effect.
        let tried =
            |wider: &f64| horizon_s == HORIZONS_S[1] && !self.forces_only && *wider <= self.start.widest;
        for wider in TOLERANCES.into_iter().filter(tried) {
            let (total, scored) = one(wider)?;
            if total <= most {
                break;
            }
            (most, best, widest) = (total, scored, wider);
        }
        self.tolerance = widest;
        Ok(Some(best.set))
    }

    /// The named candidates by the evidence for each alone, most first.
    fn ranked(
        &self,
        model: &Model,
        linear: &Linear,
        known: &Known,
        set: &[usize],
    ) -> Result<Vec<Ranked>, GapError> {
        let (h, g) = (&known.all.h, &known.all.g);
        let evidence = Evidence::new(model, h, g, &linear.at, known.dispersion, self.tolerance)?;
        let one = |c: usize| Ranked {
            id: model.candidates[c].id.clone(),
            title: model.candidates[c].title.clone(),
            evidence_nats: evidence.of(&[c]),
            chosen: set.contains(&c),
        };
        let mut out: Vec<Ranked> = model.named().filter(|c| model.may[*c]).map(one).collect();
        out.sort_by(|a, b| b.chosen.cmp(&a.chosen).then(b.evidence_nats.total_cmp(&a.evidence_nats)));
        Ok(out)
    }

    /// Moves to the estimate with `set`; returns the solution, and whether it has converged. Noise and initial states are
    /// not estimated again where the search `ends`.
    fn step(
        &mut self,
        model: &Model,
        linear: Linear,
        known: Known,
        set: Vec<usize>,
        ends: bool,
    ) -> Result<(Solution, bool), GapError> {
        let Known { reduced, all, dispersion: phi } = known;
        let disturbance = self.start.disturbance;
        let evidence = Evidence::new(model, &all.h, &all.g, &linear.at, phi, self.tolerance)?;
        let posterior = evidence.posterior(&set)?;
        let deltas = all.deltas(&difference(&posterior, &linear.at));
        // With all candidates free: a missing effect would count as noise.
        let quieter = match &self.start.noise {
            Some(known) => known.clone(),
            None if ends => self.noise.clone(),
            None => {
                let free = all.deltas(&difference(&evidence.posterior(&self.every)?, &linear.at));
                linear.noise_beside(&disturbance, &free, &self.least)
            }
        };
        let same_noise = quieter.iter().zip(&self.noise).all(|(a, b)| a.near(b));
        self.noise = quieter;
        if !self.forces_only && !ends {
            self.starts = linear.starts(&disturbance, &deltas);
        }
        let same = set == self.start.set;
        self.start.set = set.clone();
        let misfit = dispersion(model, &linear, &reduced, &deltas) * inflation(&linear.noise, &self.least);
        let found = Solution {
            set,
            linear,
            reduced,
            parts: Vec::new(),
            disturbance,
            disturbance_before: disturbance,
            dispersion: phi,
            misfit,
            tolerance: self.tolerance,
            posterior,
            deltas,
        };
        let moved = self.moved(model, &found, &all.differing);
        Ok((found, same && same_noise && moved < 1.0 && self.done > self.start.held))
    }

    /// Moves the values of the set, of what shifts samples in time, and, if the start says so, of what is within tolerance;
    /// returns the largest move in standard deviations.
    fn moved(&mut self, model: &Model, found: &Solution, differing: &[usize]) -> f64 {
        let Solution { set, linear, posterior, deltas, .. } = found;
        let delta = difference(posterior, &linear.at);
        let mut next = model.filed();
        let mut apart = vec![vec![0.0; next.len()]; self.logs.len()];
        let mut moved: f64 = 0.0;
        for (k, p) in model.parameters.iter().enumerate() {
            let c = p.candidate;
            let at_work = set.contains(&c) || self.timing.contains(&c);
            let longest = LONGEST_STEP * p.slab;
            let per = 1.0 / posterior.sigma[k].max(0.02 * p.slab);
            if at_work || (self.start.follow && corrected(model, posterior, c)) {
                let step = delta[k].clamp(-longest, longest);
                next[k] = linear.at[k] + step;
                if let Some(least) = model.least(k) {
                    next[k] = next[k].max(least);
                }
                moved = moved.max(step.abs() * per);
            }
            if at_work && differing.contains(&k) {
                for (log, apart) in apart.iter_mut().enumerate() {
                    let now = linear.apart.get(log).map_or(0.0, |apart| apart[k]);
                    let step = (deltas[log][k] - delta[k]).clamp(-longest, longest);
                    apart[k] = now + step;
                    moved = moved.max(step.abs() * per);
                }
            }
        }
        self.values = Values { shared: next, apart };
        moved
    }
}

/// Dispersion: the larger of the reduced chi-square and the scatter of window scores over the information (median over
/// parameters about which the log is informative), at least 1.
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

/// Largest ratio of noise variance between the noise beside the model and that of neighbouring samples, over the channels.
fn inflation(noise: &[Noise], least: &[Noise]) -> f64 {
    let pairs = noise.iter().zip(least).flat_map(|(a, b)| a.channels().into_iter().zip(b.channels()));
    pairs.map(|(a, b)| (a / b).powi(2)).fold(1.0, f64::max)
}
