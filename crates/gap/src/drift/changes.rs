//! Drifts by their evidence: all logs so far in one linear model of the vehicle's parameters, with a step or a line of each accepted drift.
//!
//! With z the parameters of the vehicle file's time and gᵢ the drift i, log t sees z + Σ rᵢ(t) gᵢ, where r is 0 before the drift, 1 after it
//! and a straight line between. All are Gaussian, z about the file by its tolerances, g about zero by the width of a drift, so that their
//! posterior and the evidence of one more drift are sums and solutions of linear systems.

use super::AcceptedParameter;
use super::sight::{FollowedEffect, FollowedParameter, Sight};
use crate::GapError;
use crate::policy::{DRIFT_BEGINNINGS, NAMED_SIGMAS};
use crate::search::THRESHOLD;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// What a drift is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ChangeKind {
    /// The vehicle was never as the file says: it differs since the first log.
    DiffersFromFile,
    /// An effect that was not there before.
    New,
    /// It was as accepted, and differs now.
    Drifted,
    /// A drift that was accepted before goes on.
    GoesOn,
    /// It is back where it was before its drift.
    Returned,
}

/// A parameter before and after a drift.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ChangedParameter {
    /// Name within the effect.
    pub name: String,
    /// SI unit.
    pub unit: String,
    /// Value of the vehicle file.
    pub filed: f64,
    /// Accepted value without the drift.
    pub before: f64,
    /// Its standard deviation.
    pub before_sigma: f64,
    /// Accepted value with it.
    pub after: f64,
    /// Its standard deviation.
    pub after_sigma: f64,
    /// For a factor of a mass or a moment of inertia: the file's value, and its unit.
    pub of: Option<(f64, String)>,
}

impl ChangedParameter {
    /// Size of the change over the larger standard deviation.
    pub(crate) fn sigmas(&self) -> f64 {
        (self.after - self.before).abs() / self.before_sigma.max(self.after_sigma).max(f64::MIN_POSITIVE)
    }
}

/// A drift of one effect's parameters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Change {
    /// Candidate id.
    pub id: String,
    /// In plain words.
    pub title: String,
    /// What it is.
    pub kind: ChangeKind,
    /// Log in which it began.
    pub since: String,
    /// Number of that log among those that were diagnosed, from 0.
    pub from: usize,
    /// Number of the log in which it was complete; that of `from` for a step.
    pub until: usize,
    /// The parameters.
    pub parameters: Vec<ChangedParameter>,
    /// Evidence for it, over all beginnings that were compared, nats.
    pub evidence_nats: f64,
    /// Errors of the vehicle with it over those without it on unseen flight of the newest log: geometric mean over force, torque and
    /// roll-outs. None where that flight was too short.
    pub errors_ratio: Option<f64>,
    /// Other effects whose drift explains the logs about as well.
    pub look_alikes: Vec<String>,
    /// Why it is in doubt and not accepted; none where it is.
    pub doubt: Option<String>,
}

/// A drift in the model: its effect, the log in which it begins and the one in which it is complete.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Part {
    pub effect: usize,
    pub from: usize,
    pub until: usize,
}

impl Part {
    /// Share of the drift that a log sees.
    pub fn share(&self, log: usize) -> f64 {
        match log {
            t if t < self.from => 0.0,
            t if t >= self.until => 1.0,
            t => (t - self.from + 1) as f64 / (self.until - self.from + 1) as f64,
        }
    }
}

/// A drift that the evidence names.
pub(crate) struct Proposed {
    pub part: Part,
    pub nats: f64,
    alike: Vec<String>,
}

/// Information of one log about the parameters of all logs, per unit of their drifts.
struct Log {
    a: DMatrix<f64>,
    b: DVector<f64>,
}

/// The parameters of all logs, and what each log says of them.
pub(crate) struct Space {
    effects: Vec<FollowedEffect>,
    parameters: Vec<FollowedParameter>,
    dynamics: String,
    /// Prior variance of each parameter, drifts squared.
    prior: Vec<f64>,
    logs: Vec<Log>,
    /// Sums of the logs from each one on.
    sums: Vec<Log>,
}

/// Posterior of the parameters and of the drifts.
pub(crate) struct Accepted {
    factor: Cholesky<f64, Dyn>,
    mean: DVector<f64>,
    /// Parameter of each column behind those of the file, with the part that it belongs to.
    columns: Vec<(usize, Part)>,
}

impl Space {
    pub fn new(sights: &[&Sight]) -> Self {
        let mut out = Self {
            effects: Vec::new(),
            parameters: Vec::new(),
            dynamics: sights.first().map_or_else(String::new, |s| s.dynamics.clone()),
            prior: Vec::new(),
            logs: Vec::new(),
            sums: Vec::new(),
        };
        for sight in sights {
            for effect in &sight.effects {
                if !out.effects.iter().any(|e| e.id == effect.id) {
                    out.effects.push(effect.clone());
                }
            }
            for p in &sight.parameters {
                let effect = out.place(&sight.effects[p.effect].id);
                if !out.parameters.iter().any(|o| o.effect == effect && o.name == p.name) {
                    out.parameters.push(FollowedParameter { effect, ..p.clone() });
                }
            }
        }
        // A vehicle whose tolerances one log finds wide has them in all logs.
        let wider = sights.iter().map(|s| s.wider).fold(1.0, f64::max);
        out.prior = out.parameters.iter().map(|p| (wider * p.tolerance / p.drift).powi(2)).collect();
        out.logs = sights.iter().map(|s| out.log(s)).collect();
        for log in out.logs.iter().rev() {
            let sum = match out.sums.last() {
                Some(sum) => Log { a: &sum.a + &log.a, b: &sum.b + &log.b },
                None => Log { a: log.a.clone(), b: log.b.clone() },
            };
            out.sums.push(sum);
        }
        out.sums.reverse();
        out
    }

    fn place(&self, id: &str) -> usize {
        self.effects.iter().position(|e| e.id == id).unwrap_or(0)
    }

    /// What a log says, about the parameters and nominal values of this space.
    fn log(&self, sight: &Sight) -> Log {
        let n = self.parameters.len();
        let (mut a, mut b) = (DMatrix::zeros(n, n), DVector::zeros(n));
        let place: Vec<usize> = sight
            .parameters
            .iter()
            .map(|p| {
                let effect = self.place(&sight.effects[p.effect].id);
                self.parameters.iter().position(|o| o.effect == effect && o.name == p.name).unwrap_or(0)
            })
            .collect();
        let own = |i: usize, j: usize| sight.precision[i.max(j) * (i.max(j) + 1) / 2 + i.min(j)];
        for (i, at) in place.iter().enumerate() {
            let mut score = sight.score[i];
            for (j, to) in place.iter().enumerate() {
                a[(*at, *to)] = own(i, j) * self.parameters[*at].drift * self.parameters[*to].drift;
                // Of effects that the file does not list the nominal value may be another in each log.
                score += own(i, j) * (sight.parameters[j].filed - self.parameters[*to].filed);
            }
            b[*at] = score * self.parameters[*at].drift;
        }
        Log { a, b }
    }

    pub fn dynamics(&self) -> &str {
        &self.dynamics
    }

    pub fn effects(&self) -> &[FollowedEffect] {
        &self.effects
    }

    fn of(&self, effect: usize) -> Vec<usize> {
        (0..self.parameters.len()).filter(|k| self.parameters[*k].effect == effect).collect()
    }

    /// The part of a drift that was told.
    pub fn part(&self, change: &Change) -> Option<Part> {
        let effect = self.effects.iter().position(|e| e.id == change.id)?;
        Some(Part { effect, from: change.from, until: change.until })
    }

    fn columns(&self, parts: &[Part]) -> Vec<(usize, Part)> {
        parts.iter().flat_map(|p| self.of(p.effect).into_iter().map(|k| (k, *p))).collect()
    }

    /// The posterior with these drifts.
    ///
    /// # Errors
    /// [`GapError::Numbers`] where numbers are not finite.
    pub fn accepted(&self, parts: &[Part]) -> Result<Accepted, GapError> {
        let n = self.parameters.len();
        let columns = self.columns(parts);
        let all = n + columns.len();
        let (mut a, mut b) = (DMatrix::zeros(all, all), DVector::zeros(all));
        for (k, variance) in self.prior.iter().enumerate() {
            a[(k, k)] += 1.0 / variance.max(LEAST_PRIOR);
        }
        for c in n..all {
            a[(c, c)] += 1.0;
        }
        for (t, log) in self.logs.iter().enumerate() {
            let seen: Vec<(usize, usize, f64)> = (0..n)
                .map(|k| (k, k, 1.0))
                .chain(columns.iter().enumerate().map(|(c, (k, part))| (n + c, *k, part.share(t))))
                .filter(|(_, _, share)| *share != 0.0)
                .collect();
            for &(i, k, r) in &seen {
                b[i] += r * log.b[k];
                for &(j, l, s) in &seen {
                    a[(i, j)] += r * s * log.a[(k, l)];
                }
            }
        }
        let factor = Cholesky::new(a).ok_or_else(not_definite)?;
        let mean = factor.solve(&b);
        let finite = mean.iter().all(|m: &f64| m.is_finite());
        if finite { Ok(Accepted { factor, mean, columns }) } else { Err(not_definite()) }
    }

    /// A sum of columns of the posterior: mean and standard deviation.
    fn sum(&self, accepted: &Accepted, of: &[usize]) -> (f64, f64) {
        let mut pick = DVector::zeros(accepted.mean.len());
        of.iter().for_each(|c| pick[*c] = 1.0);
        let variance = pick.dot(&accepted.factor.solve(&pick));
        (pick.dot(&accepted.mean), variance.max(0.0).sqrt())
    }

    /// Columns of the drifts of a parameter that a log sees wholly.
    fn drifts_of(&self, accepted: &Accepted, k: usize) -> Vec<usize> {
        let n = self.parameters.len();
        (0..accepted.columns.len()).filter(|c| accepted.columns[*c].0 == k).map(|c| n + c).collect()
    }

    /// The parameters after the newest log.
    pub fn parameters(&self, accepted: &Accepted, parts: &[Part]) -> Vec<AcceptedParameter> {
        let one = |(k, p): (usize, &FollowedParameter)| {
            let columns = [vec![k], self.drifts_of(accepted, k)].concat();
            let (mean, sigma) = self.sum(accepted, &columns);
            AcceptedParameter {
                id: self.effects[p.effect].id.clone(),
                name: p.name.clone(),
                unit: p.unit.clone(),
                filed: p.filed,
                value: p.filed + p.drift * mean,
                sigma: p.drift * sigma,
                changed: parts.iter().any(|part| part.effect == p.effect),
            }
        };
        self.parameters.iter().enumerate().map(one).collect()
    }

    /// What a log by itself says of an effect's parameters, all others being within tolerance and these as wide as a drift: value and
    /// standard deviation, in units of the parameters.
    pub fn alone(&self, log: usize, effect: usize) -> Vec<(f64, f64)> {
        let own = self.of(effect);
        let mut a = self.logs[log].a.clone();
        for (k, variance) in self.prior.iter().enumerate() {
            a[(k, k)] += if own.contains(&k) { 1.0 } else { 1.0 / variance.max(LEAST_PRIOR) };
        }
        let Some(factor) = Cholesky::new(a) else { return Vec::new() };
        let mean = factor.solve(&self.logs[log].b);
        own.iter()
            .map(|k| {
                let mut pick = DVector::zeros(mean.len());
                pick[*k] = 1.0;
                let p = &self.parameters[*k];
                let sigma = factor.solve(&pick)[*k].max(0.0).sqrt();
                (p.filed + p.drift * mean[*k], p.drift * sigma)
            })
            .collect()
    }

    /// The drift with the most evidence beside those in `parts`, if it is enough; `doubted` are ids that are not asked.
    ///
    /// Every beginning counts alike beforehand, and so do step and line: the evidence of a drift is the mean over them. It must reach the
    /// [`THRESHOLD`] of every effect that a verdict names.
    pub fn proposed(&self, parts: &[Part], doubted: &[&str]) -> Result<Option<Proposed>, GapError> {
        let asked = |effect: usize| match doubted.contains(&self.effects[effect].id.as_str()) {
            true => Vec::new(),
            false => self.beginnings(effect, parts),
        };
        self.best(parts, asked, THRESHOLD)
    }

    /// The best of the `asked` drifts of each effect, most evident first, with its evidence over all that were asked, nats.
    pub fn ranked(&self, accepted: &Accepted, asked: impl Fn(usize) -> Vec<Part> + Sync) -> Vec<(f64, Part)> {
        let one = |effect: usize| {
            let tried: Vec<(f64, Part)> =
                asked(effect).into_iter().map(|part| (self.evidence(accepted, part), part)).collect();
            let (most, part) = tried.iter().copied().max_by(|x, y| x.0.total_cmp(&y.0))?;
            let mean = tried.iter().map(|(nats, _)| (nats - most).exp()).sum::<f64>() / tried.len() as f64;
            Some((most + mean.ln(), part))
        };
        let mut found: Vec<(f64, Part)> = (0..self.effects.len()).into_par_iter().filter_map(one).collect();
        found.sort_by(|x, y| y.0.total_cmp(&x.0));
        found
    }

    /// The one of the `asked` drifts with the most evidence, where that reaches `threshold`, nats.
    pub fn best(
        &self,
        parts: &[Part],
        asked: impl Fn(usize) -> Vec<Part> + Sync,
        threshold: f64,
    ) -> Result<Option<Proposed>, GapError> {
        let found = self.ranked(&self.accepted(parts)?, asked);
        let mut enough = found.iter().filter(|(nats, _)| *nats >= threshold);
        let Some((nats, part)) = enough.find(|(_, part)| self.allowed(parts, *part).unwrap_or(false)) else {
            return Ok(None);
        };
        let near = |(other, of): &&(f64, Part)| of.effect != part.effect && *other > nats - THRESHOLD;
        let alike = found.iter().filter(near).map(|(_, of)| self.effects[of.effect].id.clone()).collect();
        Ok(Some(Proposed { part: *part, nats: *nats, alike }))
    }

    /// Steps and lines of an effect that are compared: all that begin after its last drift was complete, at most
    /// [`DRIFT_BEGINNINGS`] logs ago.
    fn beginnings(&self, effect: usize, parts: &[Part]) -> Vec<Part> {
        let Some(newest) = self.logs.len().checked_sub(1) else { return Vec::new() };
        let last = parts.iter().filter(|p| p.effect == effect).map(|p| p.until + 1).max().unwrap_or(0);
        let first = last.max((newest + 1).saturating_sub(DRIFT_BEGINNINGS));
        let mut out = Vec::new();
        for from in first..=newest {
            out.push(Part { effect, from, until: from });
            // A line needs three logs to be more than a step, and one before it to begin at.
            if from > 0 && newest >= from + 2 {
                out.push(Part { effect, from, until: newest });
            }
        }
        out
    }

    /// Evidence for one more drift, nats.
    pub fn evidence(&self, accepted: &Accepted, part: Part) -> f64 {
        let (own, n) = (self.of(part.effect), self.parameters.len());
        let (m, all) = (own.len(), accepted.mean.len());
        let (mut inner, mut score) = (DMatrix::<f64>::identity(m, m), DVector::zeros(m));
        let mut across = DMatrix::zeros(all, m);
        // What a step sees from a log on is the sum of all further ones, so long as other drifts see as much of each.
        let all_steps = accepted.columns.iter().all(|(_, other)| other.from == other.until);
        let begins = |t: usize| t == part.from || accepted.columns.iter().any(|(_, other)| other.from == t);
        let step = part.from == part.until && all_steps;
        for t in part.from..self.logs.len() {
            if step && !begins(t) {
                continue;
            }
            let (r, log, rest) = match step {
                true => {
                    let until = (t + 1..self.logs.len()).find(|t| begins(*t));
                    (1.0, &self.sums[t], until.map(|t| &self.sums[t]))
                }
                false => (part.share(t), &self.logs[t], None),
            };
            let a = |k: usize, l: usize| log.a[(k, l)] - rest.map_or(0.0, |rest| rest.a[(k, l)]);
            let b = |k: usize| log.b[k] - rest.map_or(0.0, |rest| rest.b[k]);
            for (i, k) in own.iter().enumerate() {
                score[i] += r * b(*k);
                for (j, l) in own.iter().enumerate() {
                    inner[(i, j)] += r * r * a(*k, *l);
                }
                for l in 0..n {
                    across[(l, i)] += r * a(l, *k);
                }
                for (c, (l, other)) in accepted.columns.iter().enumerate() {
                    across[(n + c, i)] += r * other.share(t) * a(*l, *k);
                }
            }
        }
        // With everything else eliminated: ln ∫ N(g; 0, 1) exp(vᵀg − ½ gᵀMg) dg.
        let solved = accepted.factor.solve(&across);
        let inner = inner - across.tr_mul(&solved);
        let score = score - across.tr_mul(&accepted.mean);
        let Some(factor) = Cholesky::new((&inner + inner.transpose()) * 0.5) else {
            return f64::NEG_INFINITY;
        };
        let log_det: f64 = factor.l_dirty().diagonal().map(|d| 2.0 * d.ln()).sum();
        0.5 * (score.dot(&factor.solve(&score)) - log_det)
    }

    /// Whether an effect with one more drift would still have a sign that it can have: a drag that pushes is none.
    fn allowed(&self, parts: &[Part], part: Part) -> Result<bool, GapError> {
        let mut with = parts.to_vec();
        with.push(part);
        let accepted = self.accepted(&with)?;
        Ok(self.of(part.effect).into_iter().all(|k| {
            let p = &self.parameters[k];
            let (mean, sigma) = self.sum(&accepted, &[vec![k], self.drifts_of(&accepted, k)].concat());
            let beyond = f64::from(p.sign) * (p.filed + p.drift * mean - p.absent);
            p.sign == 0 || beyond >= -p.drift * sigma
        }))
    }

    /// A drift in words and numbers: `before` without it, `with` it.
    pub fn told(
        &self,
        proposed: &Proposed,
        (before, with): (&[Part], &[Part]),
        names: &[&str],
    ) -> Result<Change, GapError> {
        let part = proposed.part;
        let accepted = self.accepted(with)?;
        let parameters = self
            .of(part.effect)
            .into_iter()
            .map(|k| {
                let p = &self.parameters[k];
                let drifts = self.drifts_of(&accepted, k);
                let (new, old): (Vec<usize>, Vec<usize>) =
                    drifts.iter().partition(|c| accepted.columns[**c - self.parameters.len()].1 == part);
                let (was, was_sigma) = self.sum(&accepted, &[vec![k], old.clone()].concat());
                let (is, is_sigma) = self.sum(&accepted, &[vec![k], old, new].concat());
                ChangedParameter {
                    name: p.name.clone(),
                    unit: p.unit.clone(),
                    filed: p.filed,
                    before: p.filed + p.drift * was,
                    before_sigma: p.drift * was_sigma,
                    after: p.filed + p.drift * is,
                    after_sigma: p.drift * is_sigma,
                    of: p.of.clone(),
                }
            })
            .collect();
        let effect = &self.effects[part.effect];
        Ok(Change {
            id: effect.id.clone(),
            title: effect.title.clone(),
            kind: self.kind(&accepted, before, part),
            since: names.get(part.from).map_or_else(String::new, ToString::to_string),
            from: part.from,
            until: part.until,
            parameters,
            evidence_nats: proposed.nats,
            errors_ratio: None,
            look_alikes: proposed.alike.clone(),
            doubt: None,
        })
    }

    /// What a drift is, beside those of its effect before it.
    fn kind(&self, accepted: &Accepted, before: &[Part], part: Part) -> ChangeKind {
        let earlier = |p: &&Part| p.effect == part.effect && p.from > 0;
        if part.from == 0 {
            return ChangeKind::DiffersFromFile;
        }
        if before.iter().filter(earlier).count() == 0 {
            let there = before.iter().any(|p| p.effect == part.effect);
            let new = self.effects[part.effect].there_or_not && !there;
            return if new { ChangeKind::New } else { ChangeKind::Drifted };
        }
        if self.away(accepted, part.effect) { self.same_way(accepted, part) } else { ChangeKind::Returned }
    }

    /// Whether a drift has the direction of the sum of those before it.
    fn same_way(&self, accepted: &Accepted, part: Part) -> ChangeKind {
        let n = self.parameters.len();
        let along: f64 = self
            .of(part.effect)
            .into_iter()
            .map(|k| {
                let of = |new: bool| -> f64 {
                    let mine = |c: &&usize| {
                        let of = accepted.columns[**c - n].1;
                        of.from > 0 && (of == part) == new
                    };
                    self.drifts_of(accepted, k).iter().filter(mine).map(|c| accepted.mean[*c]).sum()
                };
                of(true) * of(false)
            })
            .sum();
        if along > 0.0 { ChangeKind::GoesOn } else { ChangeKind::Drifted }
    }

    /// Whether an effect is not where it was before all of its drifts.
    fn away(&self, accepted: &Accepted, effect: usize) -> bool {
        let n = self.parameters.len();
        self.of(effect).into_iter().any(|k| {
            let mut drifts = self.drifts_of(accepted, k);
            drifts.retain(|c| accepted.columns[*c - n].1.from > 0);
            let (off, sigma) = self.sum(accepted, &drifts);
            off.abs() > NAMED_SIGMAS * sigma
        })
    }

    /// Effects that drifted in earlier logs and are still away, each with the log since which.
    pub fn still(
        &self,
        parts: &[Part],
        new: &[Change],
        names: &[&str],
    ) -> Result<Vec<(String, String)>, GapError> {
        let accepted = self.accepted(parts)?;
        let mut out: Vec<(String, String)> = Vec::new();
        for part in parts {
            let id = &self.effects[part.effect].id;
            let told = new.iter().any(|c| c.id == *id) || out.iter().any(|(other, _)| other == id);
            let first = part.from == 0;
            if !told && (first || self.away(&accepted, part.effect)) {
                out.push((id.clone(), names.get(part.from).map_or_else(String::new, ToString::to_string)));
            }
        }
        Ok(out)
    }

    /// Index of an effect.
    pub fn effect(&self, id: &str) -> Option<usize> {
        self.effects.iter().position(|e| e.id == id)
    }

    /// Names, units and indices of an effect's parameters.
    pub fn parameters_of(&self, effect: usize) -> Vec<&FollowedParameter> {
        self.of(effect).into_iter().map(|k| &self.parameters[k]).collect()
    }
}

/// Least prior variance, of parameters that are only free together with their effect.
const LEAST_PRIOR: f64 = 1e-6;

fn not_definite() -> GapError {
    GapError::Numbers {
        what: "what has drifted",
        reason: "the logs' information is no positive definite matrix (numbers that are not finite?)".into(),
    }
}
