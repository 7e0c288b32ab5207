//! Moments of a flight at which something changed: a load that was dropped, a rotor that chipped, wind that came.
//!
//! The flight is cut into windows, and what every window says of the model's parameters is kept apart. A moment is a step of one effect's
//! parameters at the beginning of a window: every effect and every such time are compared with no step by their evidence (generalised
//! likelihood ratio: Willsky & Jones, IEEE Trans. Automatic Control 21(1), 1976), first quickly, as if all that is left were new in each
//! window, and the best again beside weather that may persist ([`steps`]). A step must also explain more than the same parameters going
//! steadily from one value to another over the flight, and all steps together most of what the flight leaves without them. The time is
//! refined by windows that begin in between.

mod steps;
pub(crate) mod words;

use crate::GapError;
use crate::disturbance::{Disturbance, Reduced};
use crate::drift::changes::{ChangedParameter, Part, Space};
use crate::drift::sight::{Sight, alone, effect, parameter};
use crate::fit::Prepared;
use crate::model::Model;
use crate::policy::{MOMENT_NATS, MOMENT_SHARE, MOMENT_WIDEST_S, MOMENTS_PER_LOG, NAMED_SIGMAS};
use crate::report::quantity::HALF_95;
use crate::search::THRESHOLD;
use crate::solve::{Solution, difference};
use crate::track::{SHORTEST_S, Track};
use crate::watch::Watch;
use propwash_physics::drone::Drone;
use propwash_physics::effects::{Area, Relative, nature};
use serde::Serialize;
use steps::{Fit, Place, Windows};

/// Grids of windows by which a time is refined.
const GRIDS: usize = 4;
/// Effects of the quick comparison that are compared again.
const AGAIN: usize = 4;
/// Least evidence in the quick comparison of what is compared again, nats.
const LEAST_NATS: f64 = 5.0;
/// Share of a change by which a value may be off the file's and still be as filed.
const NEARLY: f64 = 0.25;
/// Evidence by which such an effect may be behind the best beside the latter's weather, nats.
const FAR_NATS: f64 = 30.0;
/// Nothing else is a moment of its own so near to another, s: the same event, seen by its other effects.
const SAME_S: f64 = 1.0;

/// A moment at which an effect of the vehicle or of its air changed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Moment {
    /// Name of the log.
    pub log: String,
    /// Its number among those of the fit, from 0.
    pub index: usize,
    /// Whether it changed between this log and the one before.
    pub between_logs: bool,
    /// When, s, in the time of the log.
    pub at_s: f64,
    /// Interval that holds it with 95 %, s.
    pub interval_s: [f64; 2],
    /// Candidate id of what changed.
    pub id: String,
    /// In plain words.
    pub title: String,
    /// Its parameters before and after.
    pub parameters: Vec<ChangedParameter>,
    /// Evidence for the change, over all effects and times that were compared, nats.
    pub evidence_nats: f64,
    /// Other effects whose change explains the flight about as well.
    pub look_alikes: Vec<String>,
    /// Other effects whose change was fitted in its place, from its own estimates, and explains the flight clearly worse.
    pub ruled_out: Vec<String>,
}

/// Moments of the flights of a solution; `tracks` may be longer than what was fitted. `unexplained`: whether the solution leaves more than a
/// known vehicle does.
///
/// # Errors
/// [`GapError`] where numbers are not finite, and [`GapError::Cancelled`] at the watcher's wish.
pub(crate) fn moments(
    tracks: &[Track],
    drone: &Drone<f64>,
    (model, solution): (&Model, &Solution),
    unexplained: bool,
    watch: &Watch,
) -> Result<Vec<Moment>, GapError> {
    let mut out = between(tracks, model, solution, unexplained)?;
    for (index, track) in tracks.iter().enumerate() {
        let log = Prepared::new(track, drone);
        let flight = |place: Place| {
            let windows = Windows::of(&log, model, solution, index, &place)?;
            let from_s = windows.linear.windows.iter().map(|w| log.around.time_s(w.from)).collect();
            Some(Flight { track, drone, model, solution, index, windows, from_s, place })
        };
        let as_found = Place { set: solution.set.clone(), active: solution.set.clone(), pieces: Vec::new() };
        let as_filed =
            Place { set: Vec::new(), active: Vec::new(), pieces: vec![(f64::NEG_INFINITY, model.filed())] };
        // What was found and leaves much may be too far from all of the flight to say what changed: then the file is nearer.
        let begin =
            if unexplained && !solution.set.is_empty() { vec![as_found, as_filed] } else { vec![as_found] };
        let mut seen = None;
        for place in begin {
            watch.check()?;
            let Some(flight) = flight(place) else { continue };
            if let Some(changed) = flight.steps(None)? {
                seen = Some((flight, changed));
                break;
            }
        }
        let Some((first, changed)) = seen else { continue };
        // What was found as if nothing had changed may be far from either side, or only stand for the change: each side is linearised
        // again by itself, with what was found and without it.
        let mut places = vec![(None, first.place(&changed.found, &changed.fit, true))];
        if !solution.set.is_empty() {
            places.push((None, first.place(&changed.found, &changed.fit, false)));
        }
        // So is what else was compared with the first step: where a load hangs shows only beside its mass.
        let led = changed.found[0].step.effect;
        for t in changed.others.iter().filter(|t| t.step.effect != led && t.step.from > 0) {
            let found = Found { step: t.step, gain: 0.0, look_alikes: Vec::new() };
            places.push((Some(t.step.effect), first.place(&[found], &t.fit, false)));
        }
        let mut ended: Vec<(Option<usize>, Flight, Changed)> = Vec::new();
        let mut failed: Vec<usize> = Vec::new();
        for (of, place) in places {
            watch.check()?;
            match flight(place).map(|f| f.steps(of).map(|c| c.map(|c| (f, c)))).transpose()?.flatten() {
                Some((flight, changed)) => ended.push((of, flight, changed)),
                None => failed.extend(of),
            }
        }
        ended.sort_by(|a, b| b.2.fit.evidence.total_cmp(&a.2.fit.evidence));
        let Some((_, flight, changed)) = ended.first() else { continue };
        let mut told = flight.moments(changed)?;
        // What the first step is not: a change that was fitted from its own estimates and ends as another one, or clearly behind it.
        let led = changed.found[0].step;
        let clearly = |c: &Changed| changed.fit.evidence - c.fit.evidence > THRESHOLD;
        let id = |effect: usize| model.candidates[effect].id.clone();
        for (of, _, c) in &ended[1..] {
            let other = c.found[0].step.effect;
            if other != led.effect && !clearly(c) {
                told.iter_mut().take(1).for_each(|m| m.look_alikes.push(id(other)));
            } else {
                failed.extend(of.filter(|of| *of != led.effect));
            }
        }
        for m in told.iter_mut().filter(|m| m.id == id(led.effect)) {
            m.ruled_out = failed.iter().map(|e| id(*e)).filter(|e| !m.look_alikes.contains(e)).collect();
        }
        out.extend(told);
    }
    out.sort_by(|a, b| a.index.cmp(&b.index).then(a.at_s.total_cmp(&b.at_s)));
    Ok(out)
}

/// Effects of the vehicle that differ between logs: steps from one log to the next, each log by itself being what it says at the solution's
/// linearisation, as precisely as its parts agree. Clocks, sensors, wind and battery may differ anyway.
///
/// Beside something unexplained, which is easily taken for another size of an effect, only what comes or goes is told, values as filed on
/// one side, and takes most of what one vehicle for all logs leaves.
fn between(
    tracks: &[Track],
    model: &Model,
    solution: &Solution,
    unexplained: bool,
) -> Result<Vec<Moment>, GapError> {
    let mut out = Vec::new();
    if tracks.len() < 2 {
        return Ok(out);
    }
    let logs = 0..tracks.len();
    let sights = logs.map(|i| Sight::of_log(model, solution, i)).collect::<Result<Vec<_>, _>>()?;
    let space = Space::new(&sights.iter().collect::<Vec<_>>());
    let whole =
        |c: &usize| space.effect(&model.candidates[*c].id).map(|effect| Part { effect, from: 0, until: 0 });
    let mut parts: Vec<Part> = solution.set.iter().filter_map(whole).collect();
    let price = ((space.effects().len().max(1) * (tracks.len() - 1)) as f64).ln();
    let names: Vec<&str> = tracks.iter().map(|t| t.name.as_str()).collect();
    let mut taken: Vec<usize> = Vec::new();
    while taken.len() < MOMENTS_PER_LOG {
        let asked = |effect: usize| {
            let all = (1..tracks.len()).filter(|from| !taken.contains(from));
            all.map(|from| Part { effect, from, until: from }).collect()
        };
        let Some(proposed) = space.best(&parts, asked, MOMENT_NATS + price)? else { break };
        let before = parts.clone();
        parts.push(proposed.part);
        let change = space.told(&proposed, (&before, &parts), &names)?;
        let track = &tracks[proposed.part.from];
        taken.push(proposed.part.from);
        if unexplained {
            if !comes_or_goes(&change.parameters) {
                continue;
            }
            let effect = model.candidates.iter().position(|c| c.id == change.id);
            let left = effect.map(|e| left_apart(model, solution, e)).transpose()?;
            if !left.is_some_and(|l| l.into_iter().any(|share| share <= 1.0 - MOMENT_SHARE)) {
                continue;
            }
        }
        out.push(Moment {
            log: track.name.clone(),
            index: proposed.part.from,
            between_logs: true,
            at_s: track.span_s[0],
            interval_s: [track.span_s[0]; 2],
            id: change.id,
            title: change.title,
            parameters: change.parameters,
            evidence_nats: change.evidence_nats - price,
            look_alikes: change.look_alikes,
            ruled_out: Vec::new(),
        });
    }
    Ok(out)
}

/// Shares of the force and the torque that one vehicle for all logs leaves (their variances without what sensor noise makes of them) that
/// are left where every log has a vehicle of its own, candidate `effect` with what was found: a change between logs can take no more.
///
/// The change alone, beside what all logs have in common, says nothing of it: a load that came with the second log has made the
/// vehicle of both logs heavier by half of it.
fn left_apart(model: &Model, solution: &Solution, effect: usize) -> Result<[f64; 2], GapError> {
    let size = |deltas: &[Vec<f64>]| {
        let mut sum = [0.0; 2];
        for w in &solution.linear.windows {
            let estimate = w.push_estimate(&Disturbance::unknown(), &deltas[w.log]);
            let Some((push, variance)) = estimate else { continue };
            for k in 0..6 {
                sum[k / 3] += push[k] * push[k] - variance[k];
            }
        }
        sum.map(|s| s.max(0.0))
    };
    let mut set = solution.set.clone();
    if !set.contains(&effect) {
        set.push(effect);
    }
    let own = (0..solution.deltas.len()).map(|log| {
        let (evidence, at) = alone(model, solution, log)?;
        Ok(difference(&evidence.posterior(&set)?, &at))
    });
    let own = own.collect::<Result<Vec<_>, GapError>>()?;
    let (one, apart) = (size(&solution.deltas), size(&own));
    Ok([0, 1].map(|k| if one[k] > 0.0 { apart[k] / one[k] } else { 1.0 }))
}

/// Whether the parameter that changed most is as filed on one side, or nearer to it than [`NEARLY`] of the change.
fn comes_or_goes(parameters: &[ChangedParameter]) -> bool {
    let most = parameters.iter().max_by(|a, b| a.sigmas().total_cmp(&b.sigmas()));
    most.is_some_and(|p| {
        let near = |value: f64, sigma: f64| {
            (value - p.filed).abs() <= (NAMED_SIGMAS * sigma).max(NEARLY * (p.after - p.before).abs())
        };
        near(p.before, p.before_sigma) || near(p.after, p.after_sigma)
    })
}

/// One flight.
struct Flight<'a> {
    track: &'a Track,
    drone: &'a Drone<f64>,
    model: &'a Model,
    solution: &'a Solution,
    index: usize,
    windows: Windows<'a>,
    /// Beginnings of the windows, s.
    from_s: Vec<f64>,
    place: Place,
}

/// A step that has the evidence.
struct Found {
    step: Part,
    /// Evidence over the fit without it, nats.
    gain: f64,
    look_alikes: Vec<String>,
}

/// What changed in a flight: steps with enough evidence, most first, and the fit with them.
struct Changed {
    found: Vec<Found>,
    fit: Fit,
    /// What else was compared with the first step, most evident first.
    others: Vec<Tried>,
}

/// A step, and the fit with it.
struct Tried {
    step: Part,
    fit: Fit,
    /// Whether the fit is beside weather of its own, and the step enough and possible.
    settled: bool,
}

/// The next step, what would explain the flight about as well, and all else that was compared.
struct Next {
    step: Part,
    fit: Fit,
    look_alikes: Vec<String>,
    others: Vec<Tried>,
}

impl Flight<'_> {
    /// Where the flight is linearised before, between and after steps.
    fn place(&self, found: &[Found], fit: &Fit, kept: bool) -> Place {
        let mut begins: Vec<usize> = found.iter().map(|f| f.step.from).chain([0]).collect();
        begins.sort_unstable();
        begins.dedup();
        let set = if kept { self.windows.set.clone() } else { Vec::new() };
        let active: Vec<usize> = set.iter().copied().chain(found.iter().map(|f| f.step.effect)).collect();
        let piece = |from: usize| {
            let from_s = if from == 0 { f64::NEG_INFINITY } else { self.from_s[from] };
            (from_s, self.windows.values(fit, from, &active, kept))
        };
        let pieces = begins.into_iter().map(piece).collect();
        Place { set, active, pieces }
    }

    fn moments(&self, changed: &Changed) -> Result<Vec<Moment>, GapError> {
        let mut out: Vec<Moment> = Vec::new();
        for f in &changed.found {
            let near = |m: &Moment| (m.at_s - self.from_s[f.step.from]).abs() < SAME_S;
            if f.step.from > 0 && !out.iter().any(near) {
                let told = self.told(f, &changed.fit)?;
                // What cannot be dated came little by little, or not at all.
                if told.interval_s[1] - told.interval_s[0] <= MOMENT_WIDEST_S {
                    out.push(told);
                }
            }
        }
        out.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
        Ok(out)
    }

    /// Steps with enough evidence that take most of what the flight leaves without them; `None` where nothing changed, or something else
    /// than the asked `effect`.
    fn steps(&self, effect: Option<usize>) -> Result<Option<Changed>, GapError> {
        let alone = self.windows.alone();
        let (true, Some(mut now)) = (alone.len() == self.from_s.len(), self.windows.fit(&[])) else {
            return Ok(None);
        };
        let quick = self.space(&alone);
        let first = now.disturbance;
        let mut found: Vec<Found> = Vec::new();
        // Times at which something changed: other effects may change at the same.
        let mut times: Vec<f64> = Vec::new();
        let mut others = Vec::new();
        // Shares of force and torque that are left.
        let left = |now: &Fit| {
            let ((force, torque), (f, t)) = (now.disturbance.sizes(), first.sizes());
            [(force / f).powi(2), (torque / t).powi(2)]
        };
        let most = 2 * MOMENTS_PER_LOG;
        for further in (0..most).rev() {
            let steps: Vec<Part> = found.iter().map(|f| f.step).collect();
            let Some(next) = self.next(&quick, &steps, &now)? else { break };
            let Next { step, fit, look_alikes, others: rest } = next;
            if found.is_empty() {
                if effect.is_some_and(|asked| asked != step.effect) {
                    return Ok(None);
                }
                others = rest;
            }
            let at_s = self.from_s[step.from];
            if step.from > 0 && !times.iter().any(|t| (t - at_s).abs() < SAME_S) {
                if times.len() == MOMENTS_PER_LOG {
                    break;
                }
                times.push(at_s);
            }
            found.push(Found { step, gain: fit.evidence - now.evidence, look_alikes });
            let before = left(&now);
            now = fit;
            // Steps come in the order of what they take: where as many as may follow cannot take enough, there is no use in more.
            let reach = |(before, left): (f64, f64)| left - (before - left).max(0.0) * further as f64;
            if before.into_iter().zip(left(&now)).map(reach).all(|least| least > 1.0 - MOMENT_SHARE) {
                return Ok(None);
            }
        }
        // Steps follow any shape that is in no list a little of the way, and leave most of it.
        let enough = left(&now).into_iter().any(|left| left <= 1.0 - MOMENT_SHARE);
        Ok((!times.is_empty() && enough).then_some(Changed { found, fit: now, others }))
    }

    /// Number of hypotheses that are compared, in nats.
    fn price(&self) -> f64 {
        let effects = (0..self.model.candidates.len()).filter(|c| can_change(self.model, *c)).count();
        ((effects.max(1) * self.from_s.len().max(1)) as f64).ln()
    }

    /// Steps that leave enough flight on both sides, and the same effect all the time.
    fn asked(&self, effect: usize, taken: &[Part]) -> Vec<Part> {
        let (Some(first), Some(last)) = (self.from_s.first(), self.from_s.last()) else { return Vec::new() };
        let end = last + self.windows.linear.horizon_s;
        // A part begins and ends at the interval of the moment.
        let least_s = SHORTEST_S + 0.5 * MOMENT_WIDEST_S;
        let enough = |t: f64| t - first >= least_s && end - t >= least_s;
        let of = |from: usize| Part { effect, from, until: from };
        let mut out: Vec<Part> =
            (1..self.from_s.len()).filter(|from| enough(self.from_s[*from])).map(of).collect();
        out.push(of(0));
        // One change of an effect at a time.
        let near = |p: &Part, o: &Part| {
            o.effect == p.effect && (self.from_s[o.from] - self.from_s[p.from]).abs() < SAME_S
        };
        out.retain(|p| !taken.iter().any(|o| near(p, o)));
        out
    }

    /// The next step with enough evidence.
    fn next(&self, quick: &Space, steps: &[Part], now: &Fit) -> Result<Option<Next>, GapError> {
        let effect = |c: usize| quick.effect(&self.model.candidates[c].id);
        let of_space = |part: &Part| effect(part.effect).map(|effect| Part { effect, ..*part });
        let of_model = |part: Part| {
            let id = &quick.effects()[part.effect].id;
            self.model.candidates.iter().position(|c| c.id == *id).map(|effect| Part { effect, ..part })
        };
        let mut taken: Vec<Part> = steps.iter().filter_map(of_space).collect();
        let whole = |c: &usize| effect(*c).map(|effect| Part { effect, from: 0, until: 0 });
        taken.extend(self.windows.set.iter().filter_map(whole));
        let accepted = quick.accepted(&taken)?;
        let asked = |e: usize| match of_model(Part { effect: e, from: 0, until: 0 }) {
            Some(part) if can_change(self.model, part.effect) => self.asked(e, &taken),
            _ => Vec::new(),
        };
        let price = self.price();
        let with = |step: Part| [steps, &[step]].concat();
        let mut tried: Vec<Tried> = Vec::new();
        let ranked = quick.ranked(&accepted, asked);
        for (_, part) in ranked.into_iter().take(AGAIN).filter(|(nats, _)| *nats >= LEAST_NATS) {
            let Some(step) = of_model(part) else { continue };
            // What is far behind beside the weather of the best so far is no match for it beside its own.
            let settled = tried.iter().filter(|t| t.settled);
            if let Some(best) = settled.max_by(|a, b| a.fit.evidence.total_cmp(&b.fit.evidence)) {
                let Some(fit) = self.windows.once(&with(step), best.fit.disturbance) else { continue };
                if fit.evidence < best.fit.evidence - FAR_NATS {
                    tried.push(Tried { step, fit, settled: false });
                    continue;
                }
            }
            let Some(fit) = self.windows.fit(&with(step)) else { continue };
            let enough = fit.evidence - now.evidence - price >= MOMENT_NATS;
            let settled = enough && self.windows.allowed(&fit, step.effect);
            tried.push(Tried { step, fit, settled });
        }
        tried.sort_by(|a, b| b.fit.evidence.total_cmp(&a.fit.evidence));
        // What goes on all the time is no moment: a battery that empties.
        let steadily = |t: &Tried| {
            let line = Part { from: 0, until: self.from_s.len() - 1, ..t.step };
            let line = if t.step.from == 0 { None } else { self.windows.fit(&with(line)) };
            line.is_some_and(|l| l.evidence > t.fit.evidence - THRESHOLD)
        };
        let Some(at) = (0..tried.len()).find(|i| tried[*i].settled && !steadily(&tried[*i])) else {
            return Ok(None);
        };
        let Tried { step, fit, .. } = tried.remove(at);
        let near = |t: &&Tried| {
            t.settled && t.fit.evidence > fit.evidence - THRESHOLD && t.step.from.abs_diff(step.from) <= 2
        };
        let alike =
            tried.iter().filter(near).map(|t| self.model.candidates[t.step.effect].id.clone()).collect();
        Ok(Some(Next { step, fit, look_alikes: alike, others: tried }))
    }

    fn told(&self, found: &Found, fit: &Fit) -> Result<Moment, GapError> {
        let step = found.step;
        let of = effect(self.model, step.effect);
        let parameters = self
            .model
            .of(step.effect)
            .map(|k| {
                let p = parameter(self.model, k, 0);
                let [before, after] = [false, true]
                    .map(|after| fit.value(k, |s| s.from < step.from || (after && s.from == step.from)));
                ChangedParameter {
                    name: p.name,
                    unit: p.unit,
                    filed: p.filed,
                    before: p.filed + before.0,
                    before_sigma: before.1,
                    after: p.filed + after.0,
                    after_sigma: after.1,
                    of: p.of,
                }
            })
            .collect();
        let (at_s, interval_s) = self.refined(step, fit)?;
        let evidence_nats = found.gain - self.price();
        let look_alikes = found.look_alikes.clone();
        let log = self.track.name.clone();
        Ok(Moment {
            log,
            index: self.index,
            between_logs: false,
            at_s,
            interval_s,
            id: of.id,
            title: of.title,
            parameters,
            evidence_nats,
            look_alikes,
            ruled_out: Vec::new(),
        })
    }

    /// What windows say, each by itself.
    fn space(&self, reduced: &[Reduced]) -> Space {
        let all = sights(reduced, &self.windows.linear.at, self.model, self.solution);
        Space::new(&all.iter().collect::<Vec<_>>())
    }

    /// The time of a step, and the interval that holds it: by grids of windows that begin in between.
    fn refined(&self, step: Part, fit: &Fit) -> Result<(f64, [f64; 2]), GapError> {
        let coarse_s = self.from_s[step.from];
        let length_s = self.windows.linear.horizon_s;
        let alone = Disturbance { kept: [0.0; 4], ..fit.disturbance };
        let id = &self.model.candidates[step.effect].id;
        let mut points: Vec<(f64, f64)> = Vec::new();
        for grid in 0..GRIDS {
            let by_s = length_s * grid as f64 / GRIDS as f64;
            let cut = self.track.cut([self.track.span_s[0] + by_s, self.track.span_s[1]]);
            let log = Prepared::new(&cut, self.drone);
            let Some(windows) = Windows::of(&log, self.model, self.solution, self.index, &self.place) else {
                continue;
            };
            let reduced = windows.linear.reduce(&alone);
            if reduced.len() != windows.linear.windows.len() {
                continue;
            }
            let space = self.space(&reduced);
            let whole = |c: &usize| {
                space.effect(&self.model.candidates[*c].id).map(|effect| Part { effect, from: 0, until: 0 })
            };
            let parts: Vec<Part> = self.windows.set.iter().filter_map(whole).collect();
            let (accepted, Some(effect)) = (space.accepted(&parts)?, space.effect(id)) else { continue };
            let mut of_grid = Vec::new();
            for (from, w) in windows.linear.windows.iter().enumerate().skip(1) {
                let at_s = log.around.time_s(w.from);
                if (at_s - coarse_s).abs() <= 4.0 * length_s {
                    of_grid.push((at_s, space.evidence(&accepted, Part { effect, from, until: from })));
                }
            }
            // Each grid by itself says where: the evidence of different grids is of slightly different samples.
            let most = of_grid.iter().map(|p| p.1).fold(f64::NEG_INFINITY, f64::max);
            points.extend(of_grid.iter().map(|(t, nats)| (*t, (nats - most).exp())));
        }
        let sum: f64 = points.iter().map(|p| p.1).sum();
        if sum <= 0.0 {
            return Ok((coarse_s, [coarse_s - length_s, coarse_s + length_s]));
        }
        let at_s = points.iter().map(|p| p.0 * p.1).sum::<f64>() / sum;
        let scatter = points.iter().map(|p| p.1 * (p.0 - at_s).powi(2)).sum::<f64>() / sum;
        // A step lies anywhere around a boundary.
        let sigma_s = (scatter + length_s.powi(2) / 12.0).sqrt();
        Ok((at_s, [at_s - HALF_95 * sigma_s, at_s + HALF_95 * sigma_s]))
    }
}

/// Whether an effect can change in flight: instruments do not, and what goes with time does so by itself.
fn can_change(model: &Model, c: usize) -> bool {
    let candidate = &model.candidates[c];
    !model.is_shape(c)
        && candidate.area != Area::Measurement
        && nature(candidate.kind).relative != Some(Relative::Time)
        && !nature(candidate.kind).goes_with_charge
}

/// What each window says, linearised at `at`, in the form of what a log says of a vehicle.
fn sights(reduced: &[Reduced], at: &[f64], model: &Model, solution: &Solution) -> Vec<Sight> {
    let own: Vec<usize> =
        (0..model.parameters.len()).filter(|k| !model.is_shape(model.parameters[*k].candidate)).collect();
    let filed = model.filed();
    let off: Vec<f64> = at.iter().zip(&filed).map(|(at, filed)| at - filed).collect();
    let phi = solution.dispersion;
    let one = |r: &Reduced| {
        // About the file: g + H (at − filed).
        let moved = |k: usize| (0..off.len()).map(|l| r.h[(k, l)] * off[l]).sum::<f64>();
        let score = |i: usize| (r.g[own[i]] + moved(own[i])) / phi;
        Sight::about(model, solution.tolerance, &own, |i, j| r.h[(own[i], own[j])] / phi, score)
    };
    reduced.iter().map(one).collect()
}
