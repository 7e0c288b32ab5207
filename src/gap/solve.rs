//! From logs to the set of effects that explains them: linearise, search, move to the estimate, again until it settles, on
//! windows that grow longer.

use super::GapError;
use super::fit::{Disturbance, Linear, Prepared, Reduced, linearise};
use super::model::Model;
use super::search::{Evidence, Posterior, Scored};
use crate::flight::clean;
use nalgebra::{DMatrix, DVector};

/// Lengths of the windows, s: short ones first, since long ones see further but bend more.
const HORIZONS_S: [f64; 2] = [0.1, 0.25];
/// Most linearisations per length.
const ROUNDS: [usize; 2] = [4, 4];
/// Longest move of a parameter between linearisations, slabs.
const LONGEST_STEP: f64 = 1.5;

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
    pub posterior: Posterior,
}

impl Solution {
    /// The evidence at the last linearisation.
    pub fn evidence<'a>(&self, model: &'a Model) -> Result<Evidence<'a>, GapError> {
        let (h, g) = sum(&self.reduced, |_| true);
        Evidence::new(model, &h, &g, &self.linear.at, self.dispersion)
    }
}

impl Solution {
    /// Log evidence less the price of the effects, comparable between starts.
    fn whole(&self, model: &Model, dispersion: f64) -> Result<f64, GapError> {
        let (h, g) = sum(&self.reduced, |_| true);
        let evidence = Evidence::new(model, &h, &g, &self.linear.at, dispersion)?;
        let chi2: f64 = self.reduced.iter().map(|r| r.c).sum();
        // Windows differ a little in their rows where clocks move: per row.
        let rows: usize = self.linear.windows.iter().map(|w| w.n_rows).sum();
        let price = super::search::THRESHOLD * self.set.len() as f64;
        Ok(evidence.whole(&self.set, chi2, &g, &h, &self.linear.at) + 0.5 * rows as f64 - price)
    }
}

/// Sum of the windows that `take` by index.
pub(crate) fn sum(reduced: &[Reduced], take: impl Fn(usize) -> bool) -> (DMatrix<f64>, DVector<f64>) {
    let n = reduced.first().map_or(0, |r| r.g.len());
    let (mut h, mut g) = (DMatrix::zeros(n, n), DVector::zeros(n));
    for (_, r) in reduced.iter().enumerate().filter(|(i, _)| take(*i)) {
        h += &r.h;
        g += &r.g;
    }
    (h, g)
}

/// χ² of a window with the parameters `delta` from where it was linearised.
pub(crate) fn chi2(r: &Reduced, delta: &DVector<f64>) -> f64 {
    r.c - 2.0 * r.g.dot(delta) + delta.dot(&(&r.h * delta))
}

fn difference(posterior: &Posterior, at: &[f64]) -> Vec<f64> {
    posterior.mean.iter().zip(at).map(|(m, a)| m - a).collect()
}

/// How much larger than expected residuals scatter: the larger of χ² per degree of freedom and the scatter of window scores
/// over the information (median over parameters that the log says something about), at least 1.
fn dispersion(model: &Model, linear: &Linear, reduced: &[Reduced], delta: &[f64]) -> f64 {
    let delta = DVector::from_column_slice(delta);
    let rows: usize = linear.windows.iter().map(|w| w.n_rows).sum();
    let used = 12 * linear.windows.len();
    let total: f64 = reduced.iter().map(|r| chi2(r, &delta)).sum();
    let per_row = total / (rows.saturating_sub(used).max(1)) as f64;
    let n = delta.len();
    let (mut scatter, mut information) = (vec![0.0; n], vec![0.0; n]);
    for r in reduced {
        let score = &r.g - &r.h * &delta;
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

/// Searches (or, with `given`, fits that set) until it settles. `progress(done, of)` hears of every linearisation.
///
/// A search walks downhill from the file, and where several measurement effects together look like one effect of the
/// vehicle it can end among them; then the one is tried from its own start, and the more evident of the two stands.
pub(crate) fn solve(
    logs: &[Prepared],
    model: &mut Model,
    given: Option<&[usize]>,
    progress: &dyn Fn(usize, usize),
) -> Result<Solution, GapError> {
    let found = settle(logs, model, given, None, progress)?;
    if given.is_some() {
        return Ok(found);
    }
    // All sensors late by the same time is the commands being late, and one of them early is the others late.
    let timing: Vec<usize> = (0..model.candidates.len())
        .filter(|c| matches!(model.candidates[*c].kind, "clock_offset" | "command_delay"))
        .collect();
    if found.set.iter().filter(|c| timing.contains(c)).count() < 2 {
        return Ok(found);
    }
    let value = |c: usize| -> f64 {
        model.of(c).map(|k| found.posterior.mean[k] - model.parameters[k].filed).sum::<f64>()
            * f64::from(u8::from(found.set.contains(&c)))
    };
    let delay = timing.iter().copied().find(|c| model.candidates[*c].kind == "command_delay");
    let late = delay.map_or(0.0, value);
    let clocks: Vec<usize> = timing.iter().copied().filter(|c| Some(*c) != delay).collect();
    let mean = clocks.iter().map(|c| late + value(*c)).sum::<f64>() / clocks.len().max(1) as f64;
    let starts: Vec<(usize, f64)> = timing
        .iter()
        .map(|c| {
            let others = clocks.iter().filter(|o| *o != c).count().max(1) as f64;
            let rest = clocks.iter().filter(|o| *o != c).map(|o| late + value(*o)).sum::<f64>() / others;
            if Some(*c) == delay { (*c, mean) } else { (*c, late + value(*c) - rest) }
        })
        .filter(|(c, at)| Some(*c) != delay || *at > 0.0)
        .collect();
    let mut best = found;
    let first: Vec<usize> = best.set.clone();
    let base = best.posterior.mean.clone();
    for (alone, at) in starts {
        let mut set: Vec<usize> = first.iter().copied().filter(|c| !timing.contains(c)).collect();
        set.push(alone);
        set.sort_unstable();
        let mut start = model.filed();
        for k in 0..start.len() {
            let p = &model.parameters[k];
            if p.candidate == alone {
                start[k] += at;
            } else if set.contains(&p.candidate) {
                start[k] = base[k];
            }
        }
        let other = settle(logs, model, Some(&set), Some(start), progress)?;
        let phi = best.dispersion.max(other.dispersion);
        if other.whole(model, phi)? > best.whole(model, phi)? {
            best = other;
        }
    }
    Ok(best)
}

/// One search from one start.
fn settle(
    logs: &[Prepared],
    model: &mut Model,
    given: Option<&[usize]>,
    start: Option<Vec<f64>>,
    progress: &dyn Fn(usize, usize),
) -> Result<Solution, GapError> {
    let mut filed = model.filed();
    let mut values = start.clone().unwrap_or_else(|| filed.clone());
    let mut set: Vec<usize> = given.map(<[usize]>::to_vec).unwrap_or_default();
    let mut disturbance = Disturbance::unknown();
    let all: usize = ROUNDS.iter().sum();
    let mut done = 0;
    let mut last = None;
    for (horizon_s, rounds) in HORIZONS_S.into_iter().zip(ROUNDS) {
        let mut settled = false;
        for round in 0..rounds {
            let linear = linearise(logs, model, &values, &set, horizon_s);
            progress(done, all);
            done += 1;
            if linear.windows.len() < 4 {
                if last.is_some() {
                    settled = true;
                    break;
                }
                return Err(GapError::Log {
                    log: logs.first().map_or_else(String::new, |l| l.track.name.clone()),
                    expected: format!("at least 4 stretches of {horizon_s} s with pose and inputs"),
                    found: linear.windows.len().to_string(),
                    remedy: "check the log for gaps (propwash log check), or give a longer flight".into(),
                });
            }
            // The disturbances' sizes with the present set, then the search with them.
            let mut phi = 1.0;
            let mut reduced = Vec::new();
            for pass in 0..3 {
                reduced = linear.reduce(&disturbance);
                let (h, g) = sum(&reduced, |_| true);
                let evidence = Evidence::new(model, &h, &g, &linear.at, phi)?;
                let posterior = evidence.posterior(&set)?;
                let delta = difference(&posterior, &linear.at);
                phi = dispersion(model, &linear, &reduced, &delta);
                if pass < 2 {
                    disturbance = linear.disturbance(&disturbance, &delta);
                }
            }
            // A gust is one line of a spectrum: which, the disturbances tell once.
            let hz =
                (done == 1 && start.is_none()).then(|| loudest_hz(logs, &linear, &disturbance)).flatten();
            if hz.is_some_and(|hz| model.preset_of("gust", "frequency_hz", hz)) {
                values = model.filed();
                filed = model.filed();
                continue;
            }
            let (h, g) = sum(&reduced, |_| true);
            let evidence = Evidence::new(model, &h, &g, &linear.at, phi)?;
            let best = match given {
                Some(given) => Scored { set: given.to_vec(), evidence: evidence.of(given) },
                None => evidence.search().0,
            };
            let posterior = evidence.posterior(&best.set)?;
            let mut next = filed.clone();
            let mut moved: f64 = 0.0;
            for (k, p) in model.parameters.iter().enumerate() {
                if best.set.contains(&p.candidate) {
                    let step = (posterior.mean[k] - linear.at[k])
                        .clamp(-LONGEST_STEP * p.slab, LONGEST_STEP * p.slab);
                    next[k] = linear.at[k] + step;
                    moved = moved.max(step.abs() / posterior.sigma[k].max(0.02 * p.slab));
                }
            }
            let same = best.set == set;
            set = best.set.clone();
            values = next;
            last = Some(Solution {
                set: set.clone(),
                linear,
                reduced,
                disturbance,
                disturbance_before: disturbance,
                dispersion: phi,
                posterior,
            });
            if same && moved < 1.0 {
                settled = true;
                break;
            }
            let _ = round;
        }
        let _ = settled;
    }
    progress(all, all);
    let mut solution =
        last.ok_or_else(|| GapError::Numbers { what: "the fit", reason: "no window could be used".into() })?;
    // How large the disturbances would have to be without anything found.
    let bare = solution.evidence(model)?.posterior(&[])?;
    let delta = difference(&bare, &solution.linear.at);
    solution.disturbance_before = Disturbance::unknown();
    for _ in 0..6 {
        solution.disturbance_before = solution.linear.disturbance(&solution.disturbance_before, &delta);
    }
    Ok(solution)
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
    // Where the path itself repeats, its errors do too.
    // Only a log without torques needs that doubt: elsewhere what the vehicle does is told from what pushes it.
    let doubtful = logs[0].track.drive == super::track::Drive::Thrust;
    let repeats = doubtful && power_of(&own, hz) > 8.0 * clean::median(moves)?;
    (peak > 8.0 * usual && !repeats).then_some(hz)
}
