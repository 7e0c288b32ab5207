//! From flight logs and a vehicle to a verdict: which effects are missing, how certain that is, and what remains
//! unexplained.

use super::GapError;
use super::cable::{differing, reattach};
use super::decide::rules::{Rule, Why};
use super::fit::{Prepared, forces_only};
use super::formula::{self, Proposed};
use super::model::Model;
use super::moments::moments;
use super::opinion;
use super::policy::{
    BESIDE_WEATHER, EXCHANGE_NATS, LEAST_SHARE, LEAST_SHARE_ALONE, LOST_NATS, MOST_EXCHANGES, NAMED_SIGMAS,
    WEAK_NATS,
};
use super::replay::drone_for;
use super::shapes::usual_speed_m_s;
use super::solve::{Solution, left_out, polished, solve, solve_from, with_scatter};
use super::speak::{advice, speak};
use super::starts::beside_formulas;
use super::track::Track;
use super::unseen::{each_for_itself, removed_share};
use super::verdict::{Diagnosis, Said};
use super::watch::Watch;
use super::wiring;
use super::witness::Witness;
use propwash_physics::effects::{Area, FromLog};
use propwash_vehicle::Vehicle;

/// What is done about moments at which something changed in mid-flight.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Moments {
    /// They are looked for, and [`crate::fitted::fit`] fits the flight before and after each by itself.
    #[default]
    Apart,
    /// They are looked for and told; the flight is fitted as one.
    Tell,
    /// They are not looked for.
    No,
}

/// Settings of a diagnosis.
#[derive(Default)]
pub struct Settings<'a> {
    /// Fits exactly these candidates instead of searching.
    pub given: Option<Vec<String>>,
    /// Searches among these candidates only; the others stay free within their tolerance.
    pub only: Option<Vec<String>>,
    /// Leaves out the advice what to fly next, for which manoeuvres may have to be flown in simulation.
    pub no_advice: bool,
    /// Leaves out the search for formulas where something is unexplained.
    pub no_formulas: bool,
    /// Fits a small network to what is left in the end ([`crate::network`]).
    pub network: bool,
    /// Leaves out the ladder of [`crate::fitted::fit`], for which every step is flown on all flights.
    pub no_ladder: bool,
    /// What is done about moments at which something changed in mid-flight.
    pub moments: Moments,
    /// The same logs at full length, where only a part of them is fitted: moments are looked for in all of it.
    pub whole: Option<&'a [Track]>,
    /// Who watches.
    pub watch: Watch<'a>,
}

impl Settings<'_> {
    /// The same settings, with the same watcher.
    pub(crate) fn copied(&self) -> Settings<'_> {
        let Settings { given, only, watch, .. } = self;
        Settings { given: given.clone(), only: only.clone(), watch: Watch { ..*watch }, ..*self }
    }
}

/// A diagnosis with the fit behind it.
pub struct Diagnosed {
    /// The verdict.
    pub verdict: Diagnosis,
    pub(crate) solution: Solution,
    pub(crate) model: Model,
    /// Formulas that would explain what is unexplained, likeliest first, none of them in the verdict: see [`crate::fitted::fit`].
    pub(crate) proposed: Vec<Proposed>,
}

/// Diagnoses flights of one vehicle. `held_out` logs are not used in the fit.
///
/// # Errors
/// [`GapError`] where the logs lack what the fit needs, belong to different vehicles or to another one than the file's, or
/// a name is unknown.
pub fn diagnose(tracks: &[Track], vehicle: &Vehicle, settings: &Settings) -> Result<Diagnosed, GapError> {
    diagnose_from(tracks, vehicle, settings, None)
}

/// [`diagnose`] of a vehicle with formulas, from what was found without them.
pub(crate) fn diagnose_from(
    tracks: &[Track],
    vehicle: &Vehicle,
    settings: &Settings,
    without: Option<(&Diagnosed, &Proposed)>,
) -> Result<Diagnosed, GapError> {
    let first =
        tracks.first().ok_or(GapError::Numbers { what: "a diagnosis", reason: "no log was given".into() })?;
    let drone = drone_for(first, vehicle)?;
    if let Some(other) = tracks.iter().find(|t| t.dynamics != first.dynamics) {
        return Err(GapError::DifferentVehicles {
            first: first.name.clone(),
            second: other.name.clone(),
            reason: format!("one is driven by {}, the other by {}", first.drive.title(), other.drive.title()),
        });
    }
    let mut logs: Vec<Prepared> = tracks.iter().map(|t| Prepared::new(t, &drone)).collect();
    wiring::check(&logs, &drone)?;
    let arounds: Vec<_> = logs.iter().map(|l| &*l.around).collect();
    let mut model = Model::new(&drone, &tracks.iter().collect::<Vec<_>>(), &arounds)?.held_to(vehicle);
    let given = settings.given.as_ref().map(|ids| indices(&model, ids)).transpose()?;
    if let Some(ids) = &settings.only {
        let chosen = indices(&model, ids)?;
        model.may = (0..model.candidates.len()).map(|c| model.may[c] && chosen.contains(&c)).collect();
    }
    let watch = &settings.watch;
    let mut less = LeftOut { watch, why: Vec::new() };
    let start = without
        .map(|(before, proposed)| beside_formulas(&mut model, (&before.model, &before.solution), proposed));
    let mut solution = solve_from(&logs, &mut model, given.as_deref(), start, watch)?;
    if given.is_none() {
        solution = less.without_little_gain(&logs, &mut model, solution)?;
    }
    let cables = polish(&mut logs, &mut model, &mut solution, watch)?;
    if given.is_none() {
        solution = less.without_lost(&logs, &mut model, solution)?;
        solution = less.exchanged(&logs, &mut model, solution)?;
    }
    let mut solution = with_scatter(&model, solution)?;
    if given.is_none() {
        solution = less.without_nothing(&logs, &mut model, solution)?;
    }
    let mut verdict = speak(tracks, vehicle, &model, &logs, &solution, less.why, without.is_some())?;
    if !settings.no_advice {
        verdict.advice = advice(tracks, vehicle, &model, &solution, &verdict)?;
    }
    verdict.warnings.extend(cables);
    if given.is_none() && settings.moments != Moments::No {
        verdict.moments = moments(
            settings.whole.unwrap_or(tracks),
            &drone,
            (&model, &solution),
            verdict.remainder.unexplained,
            watch,
        )?;
        verdict.doubt_by_moments();
    }
    // Where the second estimator sees something else than a finding, the finding may only lean on what is missing.
    let differs = verdict.findings.iter().any(|f| f.second.said == Said::Differs);
    let wanted = (verdict.remainder.unexplained || differs)
        && given.is_none()
        && !settings.no_formulas
        && verdict.moments.is_empty();
    let mut proposed = Vec::new();
    if wanted {
        // A verdict that was reached is given, whatever becomes of the search for formulas.
        match formula::proposed(&logs, &model, &solution, &verdict.findings, watch) {
            Ok(found) => proposed = found,
            Err(GapError::Cancelled) => return Err(GapError::Cancelled),
            Err(error) => verdict.warnings.push(format!("no formula was searched: {error}")),
        }
    }
    Ok(Diagnosed { verdict, solution, model, proposed })
}

/// Relinearises the model at all its estimates, with the cable of a load as tracked; returns notes on cables.
fn polish(
    logs: &mut [Prepared],
    model: &mut Model,
    solution: &mut Solution,
    watch: &Watch,
) -> Result<Option<String>, GapError> {
    let (mut rehung, mut cables) = (false, None);
    if let Some((load, name)) = model.given(FromLog::CableLength)
        && solution.set.contains(&load)
    {
        let found = model.plain_at(&solution.posterior.mean, &solution.set);
        let lengths = reattach(logs, &found);
        if let Some(length_m) = lengths.first() {
            model.set_preset(load, name, *length_m);
            rehung = true;
        }
        cables = differing(&lengths);
    }
    // Shapes to test findings against are only needed from here on.
    let of_the_air = solution.set.iter().any(|c| model.candidates[*c].area == Area::Airframe);
    let mut shaped =
        if of_the_air { model.clone().with_shapes(usual_speed_m_s(logs))? } else { model.clone() };
    if let Some(polished) = polished(logs, &mut shaped, solution, watch)? {
        (*model, *solution) = (shaped, polished);
    } else if rehung {
        let set = solution.set.clone();
        *solution = solve(logs, model, Some(&set), watch)?;
    }
    Ok(cables)
}

/// What was left out of a solution after the search, and why.
struct LeftOut<'a> {
    watch: &'a Watch<'a>,
    why: Vec<Why>,
}

impl LeftOut<'_> {
    /// Leaves out effects that remove hardly any held-out error: they only fit the residual of another effect, or of none.
    fn without_little_gain(
        &mut self,
        logs: &[Prepared],
        model: &mut Model,
        mut solution: Solution,
    ) -> Result<Solution, GapError> {
        while !forces_only(logs) && !solution.set.is_empty() {
            let evidence = solution.evidence(model)?;
            let whole = evidence.of(&solution.set);
            let apart = each_for_itself(&solution);
            let mut shares = Vec::new();
            for c in &solution.set {
                let rest: Vec<usize> = solution.set.iter().copied().filter(|x| x != c).collect();
                let sure = rest.is_empty() && whole > WEAK_NATS;
                let least = if rest.is_empty() { LEAST_SHARE_ALONE } else { LEAST_SHARE };
                let share = removed_share(model, &solution, &apart, &[*c])?;
                if !sure && share < least {
                    shares.push((share, *c));
                }
            }
            drop(evidence);
            // Beside turbulence a small effect removes little; it stays if the second estimator sees it too.
            let witness = (!shares.is_empty()).then(|| Witness::beside(model, logs, &solution));
            shares.retain(|(_, c)| {
                let own: Vec<usize> = solution.set.iter().copied().filter(|x| x != c).collect();
                let nats = solution.evidence(model).map_or(0.0, |e| e.of(&solution.set) - e.of(&own));
                let said = witness.as_ref().map(|w| opinion::of(model, w, &solution, *c).said);
                nats < BESIDE_WEATHER || said != Some(Said::Agrees)
            });
            let Some((share, least)) = shares.into_iter().min_by(|a, b| a.0.total_cmp(&b.0)) else {
                break;
            };
            let text =
                format!("left out: takes {:.0} % of the excess error on unseen windows", 100.0 * share);
            self.why.push(Why::new(&model.candidates[least].id, Rule::LittleGain, text));
            let rest: Vec<usize> = solution.set.iter().copied().filter(|c| *c != least).collect();
            solution = solve(logs, model, Some(&rest), self.watch)?;
        }
        Ok(solution)
    }

    /// Leaves out effects that lose their evidence when the model is relinearised at all its estimates.
    fn without_lost(
        &mut self,
        logs: &[Prepared],
        model: &mut Model,
        mut solution: Solution,
    ) -> Result<Solution, GapError> {
        loop {
            let evidence = solution.evidence(model)?;
            let whole = evidence.of(&solution.set);
            let own = |c: &usize| {
                let rest: Vec<usize> = solution.set.iter().copied().filter(|x| x != c).collect();
                whole - evidence.of(&rest)
            };
            let weakest = solution.set.iter().map(|c| (own(c), *c)).min_by(|a, b| a.0.total_cmp(&b.0));
            let Some((nats, lost)) = weakest.filter(|(nats, _)| *nats < LOST_NATS) else {
                return Ok(solution);
            };
            drop(evidence);
            let Some(rest) = left_out(logs, model, &solution, lost, self.watch)? else {
                return Ok(solution);
            };
            let text = format!("left out: {nats:.1} nats in the last fit");
            self.why.push(Why::new(&model.candidates[lost].id, Rule::EvidenceLost, text));
            solution = rest;
        }
    }

    /// Exchanges effects for others that fit better in the last fit: the search settles where it first converges, and a
    /// payload with a place of its own was found, and then refused for its torque, where the vehicle was heavier.
    fn exchanged(
        &mut self,
        logs: &[Prepared],
        model: &mut Model,
        mut solution: Solution,
    ) -> Result<Solution, GapError> {
        for _ in 0..MOST_EXCHANGES {
            let evidence = solution.evidence(model)?;
            // A formula has to bring more than the list does, which is asked elsewhere.
            let may = |c: usize| model.may[c] && model.candidates[c].kind != "expression";
            let instead = |c: &usize| {
                let alone = |(ids, worse): (Vec<usize>, f64)| (ids.len() == 1).then(|| (*c, ids[0], -worse));
                let mut all = evidence.in_place_of(&solution.set, *c, 0.0).into_iter().filter_map(alone);
                all.find(|(_, other, _)| may(*other))
            };
            let best = solution.set.iter().filter_map(instead).max_by(|a, b| a.2.total_cmp(&b.2));
            let Some((old, new, nats)) = best.filter(|(.., nats)| *nats > EXCHANGE_NATS) else { break };
            drop(evidence);
            let set: Vec<usize> = solution.set.iter().map(|c| if *c == old { new } else { *c }).collect();
            let before = solution.set.clone();
            let other = solve(logs, model, Some(&set), self.watch)?;
            // Seen from where the other was fitted the first may fit better: the two views count alike.
            let back = other.evidence(model)?;
            if !other.near_by(model) || back.of(&before) - back.of(&other.set) > nats {
                break;
            }
            drop(back);
            let (id, by) = (&model.candidates[old].id, &model.candidates[new].id);
            let text = format!("exchanged for {by}, which fits better by {nats:.1} nats in its place");
            self.why.push(Why::new(id, Rule::LookAlikes, text));
            solution = other;
        }
        Ok(solution)
    }

    /// Leaves out effects that may be zero, since the parts of the log disagree about them.
    fn without_nothing(
        &mut self,
        logs: &[Prepared],
        model: &mut Model,
        mut solution: Solution,
    ) -> Result<Solution, GapError> {
        loop {
            let nothing = |c: &&usize| {
                model.of(**c).all(|k| {
                    let off = (solution.posterior.mean[k] - model.parameters[k].filed).abs();
                    off <= NAMED_SIGMAS * solution.posterior.sigma[k]
                })
            };
            let Some(lost) = solution.set.iter().find(nothing).copied() else { return Ok(solution) };
            let Some(rest) = left_out(logs, model, &solution, lost, self.watch)? else {
                return Ok(solution);
            };
            let id = &model.candidates[lost].id;
            self.why.push(Why::new(
                id,
                Rule::MayBeNothing,
                "left out: the parts of the log do not agree on it",
            ));
            solution = with_scatter(model, rest)?;
        }
    }
}

/// Indices of candidates by their ids.
fn indices(model: &Model, ids: &[String]) -> Result<Vec<usize>, GapError> {
    let mut out = ids.iter().map(|id| model.candidate(id)).collect::<Result<Vec<_>, _>>()?;
    out.sort_unstable();
    out.dedup();
    Ok(out)
}
