//! From flight logs and a vehicle to a verdict: which effects are missing, how sure that is, and what remains.

use super::GapError;
use super::cable::{differing, reattach};
use super::cross_check::cross_check;
use super::disturbance::{Disturbance, Reduced};
use super::excite;
use super::fit::{Prepared, forces_only};
use super::free_form::{self, Doing, Sample};
use super::headline::headline;
use super::limits;
use super::model::Model;
use super::opinion;
use super::per_log::{Information, differences};
use super::policy::{LOST_NATS, NAMED_SIGMAS, WEAK_NATS};
use super::replay::{STEP, STEP_S, drive, drone_for};
use super::search::THRESHOLD;
use super::shapes;
use super::solve::{Solution, chi2, left_out, polished, solve, with_scatter};
use super::track::Track;
use super::verdict::{
    Advice, Calibration, Diagnosis, Finding, FreeTerm, LogSummary, LookAlike, ParameterFit, Remainder, Said,
};
use super::wiring;
use super::witness::Witness;
use crate::flight::clean;
use crate::math::{euler, quat};
use crate::physics::drone;
use crate::physics::effects::Area;
use crate::physics::rigid_body::{MAX_ROTORS, State};
use crate::physics::surroundings::Surroundings;
use crate::vehicle::Vehicle;

/// What a diagnosis is asked.
#[derive(Default)]
pub struct Settings<'a> {
    /// Fits exactly these candidates instead of searching.
    pub given: Option<Vec<String>>,
    /// Searches among these candidates only; the others stay within their tolerance.
    pub only: Option<Vec<String>>,
    /// Hears of progress: (done, of).
    pub progress: Option<&'a dyn Fn(usize, usize)>,
}

/// Share of the error on flight that the fit has not seen which an effect beside others must take away.
const LEAST_SHARE: f64 = 0.1;
/// The same of an effect alone, on weak evidence.
const LEAST_SHARE_ALONE: f64 = 0.3;
/// Windows that are held out together, and number of folds.
const TOGETHER: usize = 4;
const FOLDS: usize = 8;

/// Scatter of what is left, over what disturbances and noise make, beyond which a force is no weather. Flights in turbulence of
/// the generator have 1.0 to 1.7, in effects that are in no list up to 20.
const MOST_DISPERSION: f64 = 2.0;

/// Nats of evidence from which an effect stands beside weather.
const BESIDE_WEATHER: f64 = 20.0;

/// A diagnosis with the fit behind it.
pub struct Diagnosed {
    /// What it says.
    pub verdict: Diagnosis,
    pub(crate) solution: Solution,
    pub(crate) model: Model,
}

/// Diagnoses flights of one vehicle. `held_out` logs take no part in the fit.
///
/// # Errors
/// [`GapError`] where the logs do not hold what the fit needs, belong to different vehicles or to another than that of the file, or
/// a name is unknown.
pub fn diagnose(tracks: &[Track], vehicle: &Vehicle, settings: &Settings) -> Result<Diagnosed, GapError> {
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
    let all: Vec<&Track> = tracks.iter().collect();
    let mut logs: Vec<Prepared> = tracks.iter().map(|t| Prepared::new(t, &drone)).collect();
    wiring::check(&logs, &drone)?;
    let arounds: Vec<_> = logs.iter().map(|l| &l.around).collect();
    let mut model = Model::new(&drone, &all, &arounds)?;
    let given = settings.given.as_ref().map(|ids| indices(&model, ids)).transpose()?;
    if let Some(ids) = &settings.only {
        let chosen = indices(&model, ids)?;
        model.may = (0..model.candidates.len()).map(|c| chosen.contains(&c)).collect();
    }
    let quiet = |_: usize, _: usize| {};
    let progress = settings.progress.unwrap_or(&quiet);
    let mut solution = solve(&logs, &mut model, given.as_deref(), progress)?;
    while given.is_none() && !forces_only(&logs) && !solution.set.is_empty() {
        // What takes hardly anything from the error on unseen flight leans on another effect's rest, or on that of none.
        let evidence = solution.evidence(&model)?;
        let whole = evidence.of(&solution.set);
        let apart = each_for_itself(&solution);
        let mut shares = Vec::new();
        for c in &solution.set {
            let rest: Vec<usize> = solution.set.iter().copied().filter(|x| x != c).collect();
            let sure = rest.is_empty() && whole > WEAK_NATS;
            let least = if rest.is_empty() { LEAST_SHARE_ALONE } else { LEAST_SHARE };
            let share = removed_share(&model, &solution, &apart, &[*c])?;
            if !sure && share < least {
                shares.push((share, *c));
            }
        }
        drop(evidence);
        // A small effect among weather takes little away, and is there all the same where another estimator sees it too.
        let witness = (!shares.is_empty()).then(|| Witness::beside(&model, &logs, &solution));
        shares.retain(|(_, c)| {
            let own: Vec<usize> = solution.set.iter().copied().filter(|x| x != c).collect();
            let nats = solution.evidence(&model).map_or(0.0, |e| e.of(&solution.set) - e.of(&own));
            let said = witness.as_ref().map(|w| opinion::of(&model, w, &solution, *c).said);
            nats < BESIDE_WEATHER || said != Some(Said::Agrees)
        });
        let Some((_, least)) = shares.into_iter().min_by(|a, b| a.0.total_cmp(&b.0)) else {
            break;
        };
        let rest: Vec<usize> = solution.set.iter().copied().filter(|c| *c != least).collect();
        solution = solve(&logs, &mut model, Some(&rest), progress)?;
    }
    let (mut rehung, mut cables) = (false, None);
    if solution.set.iter().any(|c| model.candidates[*c].kind == "slung_payload") {
        let found = model.plain_at(&solution.posterior.mean, &solution.set);
        let lengths = reattach(&mut logs, &found);
        if let Some(length_m) = lengths.first() {
            model.set_preset("slung_payload", "cable_length_m", *length_m);
            rehung = true;
        }
        cables = differing(&lengths);
    }
    // Shapes to hold it against are only needed now.
    let of_the_air = solution.set.iter().any(|c| model.candidates[*c].area == Area::Airframe);
    let mut shaped = if of_the_air { model.clone().with_shapes()? } else { model.clone() };
    if let Some(polished) = polished(&logs, &mut shaped, &solution, progress)? {
        (model, solution) = (shaped, polished);
    } else if rehung {
        let set = solution.set.clone();
        solution = solve(&logs, &mut model, Some(&set), progress)?;
    }
    // Where the model was moved to all its estimates, an effect may have lost what spoke for it.
    while given.is_none() {
        let evidence = solution.evidence(&model)?;
        let whole = evidence.of(&solution.set);
        let own = |c: &usize| {
            let rest: Vec<usize> = solution.set.iter().copied().filter(|x| x != c).collect();
            whole - evidence.of(&rest)
        };
        let weakest = solution.set.iter().map(|c| (own(c), *c)).min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((_, lost)) = weakest.filter(|(nats, _)| *nats < LOST_NATS) else { break };
        drop(evidence);
        let Some(rest) = left_out(&logs, &mut model, &solution, lost, progress)? else { break };
        solution = rest;
    }
    let mut solution = with_scatter(&model, solution)?;
    // What the parts of the log do not agree on may be nothing: then it is not named.
    while given.is_none() {
        let nothing = |c: &&usize| {
            model.of(**c).all(|k| {
                let off = (solution.posterior.mean[k] - model.parameters[k].filed).abs();
                off <= NAMED_SIGMAS * solution.posterior.sigma[k]
            })
        };
        let Some(lost) = solution.set.iter().find(nothing).copied() else { break };
        let Some(rest) = left_out(&logs, &mut model, &solution, lost, progress)? else { break };
        solution = with_scatter(&model, rest)?;
    }
    let mut verdict = speak(tracks, vehicle, &model, &logs, &solution)?;
    verdict.warnings.extend(cables);
    Ok(Diagnosed { verdict, solution, model })
}

/// Indices of candidates by their ids.
fn indices(model: &Model, ids: &[String]) -> Result<Vec<usize>, GapError> {
    let mut out = Vec::new();
    for id in ids {
        let found = model.named().find(|c| model.candidates[*c].id == *id);
        match found {
            Some(index) => out.push(index),
            None => {
                if let Some((_, reason)) = model.not_tried.iter().find(|(of, _)| of == id) {
                    return Err(GapError::Log {
                        log: "the logs".into(),
                        expected: format!("what {id} needs"),
                        found: reason.clone(),
                        remedy: "give a log that has it, or another effect".into(),
                    });
                }
                let known: Vec<&str> = model.named().map(|c| model.candidates[c].id.as_str()).collect();
                return Err(GapError::Unknown {
                    name: id.clone(),
                    what: "candidate",
                    known: known.join(", "),
                });
            }
        }
    }
    out.sort_unstable();
    out.dedup();
    Ok(out)
}

fn parameter_fit(model: &Model, solution: &Solution, k: usize) -> ParameterFit {
    let p = &model.parameters[k];
    // At a bound a value is the bound, without what rounding makes of it.
    let value = solution.posterior.mean[k];
    let at_bound =
        [p.filed, p.filed - p.back * p.slab].into_iter().find(|b| (value - b).abs() < 1e-12 * p.slab);
    ParameterFit {
        name: p.name.clone(),
        unit: p.unit.into(),
        filed: p.filed,
        value: at_bound.unwrap_or(value),
        sigma: solution.posterior.sigma[k],
    }
}

/// The windows without what those before them say about the disturbance: none knows anything of another.
fn each_for_itself(solution: &Solution) -> Vec<Reduced> {
    solution.linear.reduce(&Disturbance { kept: [0.0; 4], ..solution.disturbance })
}

/// Share of the excess error that the candidates `of` remove on windows that the fit has not seen: what is left with them,
/// against what is left when their numbers go back to the file and everything else stays. `apart` are the windows as
/// [`each_for_itself`] gives them.
fn removed_share(
    model: &Model,
    solution: &Solution,
    apart: &[Reduced],
    of: &[usize],
) -> Result<f64, GapError> {
    use super::search::Evidence;
    let fold = |i: usize| (i / TOGETHER) % FOLDS;
    let (mut with, mut without) = (0.0, 0.0);
    for f in 0..FOLDS.min(apart.len() / TOGETHER).max(2) {
        let all = Information::new(model, &solution.linear, apart, |i| fold(i) != f)?;
        let (at, phi) = (&solution.linear.at, solution.dispersion);
        let evidence = Evidence::new(model, &all.h, &all.g, at, phi, solution.tolerance)?;
        let posterior = evidence.posterior(&solution.set)?;
        let delta: Vec<f64> = posterior.mean.iter().zip(at).map(|(m, a)| m - a).collect();
        let kept = all.deltas(&delta);
        // By how much each log differs from what all share stays.
        let mut gone = kept.clone();
        for (k, p) in model.parameters.iter().enumerate().filter(|(_, p)| of.contains(&p.candidate)) {
            gone.iter_mut().for_each(|log| log[k] += p.filed - posterior.mean[k]);
        }
        for (deltas, total) in [(&kept, &mut with), (&gone, &mut without)] {
            let unseen = apart.iter().enumerate().filter(|(i, _)| fold(*i) == f);
            *total += unseen.map(|(_, r)| chi2(r, deltas)).sum::<f64>();
        }
    }
    let rows: usize = solution.linear.windows.iter().map(|w| w.n_rows).sum();
    let noise = rows.saturating_sub(12 * solution.linear.windows.len()) as f64;
    let excess = without - noise.min(with);
    Ok(if excess > 0.0 { (without - with) / excess } else { 0.0 })
}

fn speak(
    tracks: &[Track],
    vehicle: &Vehicle,
    model: &Model,
    logs: &[Prepared],
    solution: &Solution,
) -> Result<Diagnosis, GapError> {
    let evidence = solution.evidence(model)?;
    let whole = evidence.of(&solution.set);
    let apart = each_for_itself(solution);
    let mut findings = Vec::new();
    let witness = Witness::beside(model, logs, solution);
    for c in &solution.set {
        let second = opinion::of(model, &witness, solution, *c);
        let candidate = &model.candidates[*c];
        let rest: Vec<usize> = solution.set.iter().copied().filter(|x| x != c).collect();
        let mut alike = evidence.in_place_of(&solution.set, *c, THRESHOLD);
        let together = evidence.in_place_of_all(&solution.set, *c, THRESHOLD);
        let new = |set: &[usize]| !alike.iter().any(|(ids, _)| ids.iter().all(|i| set.contains(i)));
        let together: Vec<_> = together.into_iter().filter(|(set, _)| new(set)).collect();
        alike.extend(together);
        let look_alikes: Vec<LookAlike> = alike
            .into_iter()
            .take(8)
            .map(|(ids, worse)| LookAlike {
                title: ids
                    .iter()
                    .map(|i| model.candidates[*i].title.as_str())
                    .collect::<Vec<_>>()
                    .join(" with "),
                manoeuvre: model.candidates[ids[0]].manoeuvre.into(),
                ids: ids.iter().map(|i| model.candidates[*i].id.clone()).collect(),
                worse_by_nats: worse,
            })
            .collect();
        let mut names = vec![candidate.id.as_str()];
        names.extend(look_alikes.iter().flat_map(|l| &l.ids).map(String::as_str));
        let stands_for = model.hidden_behind(&names);
        findings.push(Finding {
            id: candidate.id.clone(),
            kind: candidate.kind.into(),
            title: candidate.title.clone(),
            area: candidate.area,
            parameters: model.of(*c).map(|k| parameter_fit(model, solution, k)).collect(),
            set: model.preset_values(*c),
            evidence_nats: whole - evidence.of(&rest),
            removed_share: removed_share(model, solution, &apart, &[*c])?,
            certain: look_alikes.is_empty() && opinion::certain(second.said, whole - evidence.of(&rest)),
            second,
            look_alikes,
            stands_for,
            held_out: None,
        });
    }
    findings.sort_by(|a, b| b.evidence_nats.total_cmp(&a.evidence_nats));
    let mut singles: Vec<(String, f64)> =
        model.named().map(|c| (model.candidates[c].id.clone(), evidence.of(&[c]))).collect();
    singles.sort_by(|a, b| b.1.total_cmp(&a.1));

    let mut calibration = Vec::new();
    let mut adjusted = Vec::new();
    for (k, p) in model.parameters.iter().enumerate() {
        if solution.set.contains(&p.candidate) || model.is_shape(p.candidate) {
            continue;
        }
        let candidate = &model.candidates[p.candidate];
        let entry = Calibration {
            id: candidate.id.clone(),
            kind: candidate.kind.into(),
            area: candidate.area,
            parameter: parameter_fit(model, solution, k),
            set: model.preset_values(p.candidate),
            tolerance: p.spike,
            helps: false,
            partner: false,
        };
        let off = (entry.parameter.value - p.filed).abs();
        if off > 2.0 * entry.parameter.sigma && off > 0.5 * p.spike {
            calibration.push(entry.clone());
        }
        adjusted.push(entry);
    }
    let left = samples(logs, model, solution, &solution.disturbance, &solution.deltas);
    let (mut remainder, event) = remainder(logs, model, solution, &left);
    let limits = limits::limits(model, &evidence, solution);
    let poor = limits::poor(model, solution)?;
    let mut nearest = Vec::new();
    let wholly_driven = !forces_only(logs);
    let of_the_air = |c: &&usize| model.candidates[**c].area == Area::Airframe;
    for c in solution.set.iter().filter(of_the_air).filter(|_| wholly_driven) {
        let id = &model.candidates[*c].id;
        let better = shapes::better(model, &evidence, &solution.set, *c)
            .map(|(words, nats)| format!("{words} fits better than {id} by {nats:.0} nats"));
        let other = better.or_else(|| {
            let term = other_shape(logs, model, solution, *c, &left)?;
            Some(format!("{id} leaves a shape that goes with {term}"))
        });
        if let Some(words) = other {
            remainder.unexplained = true;
            remainder.text = format!("{}; {words}", remainder.text);
            // What was found beside it, on less evidence, was found beside the wrong shape.
            let own = findings.iter().find(|f| f.id == *id).map_or(0.0, |f| f.evidence_nats);
            doubt(&mut findings, &mut nearest, poor, |f| f.evidence_nats <= own);
        }
    }
    let doubtful_shape = !nearest.is_empty();
    // Findings that together take away too little of the error on unseen flight, or of the disturbances, only lean on what is
    // really missing; so do those beside an event.
    let together = removed_share(model, solution, &apart, &solution.set)?;
    let part = |after: f64, before: f64| 1.0 - (after / before).powi(2);
    let explained = part(remainder.force_m_s2, remainder.force_before_m_s2)
        .max(part(remainder.torque_rad_s2, remainder.torque_before_rad_s2));
    // Weather beside what is certain and no matter of the air: it leaves neither shape nor pattern, and takes no share itself.
    let sure = |f: &Finding| f.certain && f.area != Area::Airframe && f.evidence_nats >= BESIDE_WEATHER;
    let drift = remainder.unexplained && !doubtful_shape && !event;
    let weather = || turbulence(model, logs, solution, &remainder, poor);
    let beside = !findings.is_empty() && !poor && wholly_driven && findings.iter().all(sure);
    let mut weather_found = (drift && beside).then(weather).flatten();
    if wholly_driven
        && weather_found.is_none()
        && remainder.unexplained
        && (together < 0.5 || explained < LEANING || (event && explained < EVENTFUL))
    {
        // Weather is a background: it takes nothing from what two independent estimators agree on.
        let background = if drift { weather() } else { None };
        let stands = |f: &Finding| f.second.said == Said::Agrees && f.evidence_nats >= BESIDE_WEATHER;
        let shielded = background.is_some();
        doubt(&mut findings, &mut nearest, poor, |f| !(shielded && stands(f)));
        if shielded && !findings.is_empty() {
            weather_found = background;
        }
    }
    if drift && findings.is_empty() {
        weather_found = weather();
    }
    // Forces that are larger with the findings than without them were explained by none of them.
    if !wholly_driven && remainder.unexplained && explained < 0.0 {
        doubt(&mut findings, &mut nearest, poor, |_| true);
    }
    // Beside what is not explained, what no second estimator has felt is in doubt.
    for f in findings.iter_mut().filter(|f| f.second.said == Said::Silent) {
        f.certain &= !remainder.unexplained;
    }
    findings.extend(weather_found);
    let explained = findings.iter().any(|f| f.kind == "turbulence" && f.certain);
    let remainder = Remainder { unexplained: remainder.unexplained && !explained, ..remainder };
    let hidden = if poor { limits.iter().filter(|l| !l.visible).count() } else { 0 };
    let verdict = sentence(&findings, &remainder, &nearest, hidden);
    let mut warnings: Vec<String> = Vec::new();
    for t in tracks {
        for w in &t.warnings {
            warnings.push(if tracks.len() > 1 { format!("{}: {w}", t.name) } else { w.clone() });
        }
    }
    let mut advice: Vec<Advice> = Vec::new();
    let ids: Vec<&str> = model.named().map(|c| model.candidates[c].id.as_str()).collect();
    let listed = model.only(&|id| ids.contains(&id));
    for f in findings.iter().filter(|f| !f.certain) {
        let names: Vec<String> = f.look_alikes.iter().map(|l| l.ids.join(" + ")).collect();
        let alike: Vec<String> =
            f.look_alikes.iter().flat_map(|l| l.ids.iter().cloned()).filter(|id| id != UNLISTED).collect();
        if alike.is_empty() {
            continue;
        }
        let planned = tracks.first().and_then(|t| {
            excite::advice(
                vehicle,
                t.drive,
                &excite::Sensors::of(t),
                &listed,
                std::slice::from_ref(&f.id),
                &alike,
            )
        });
        // Where the vehicle cannot be flown in simulation, or nothing of the library tells them apart, the effect's own page.
        let planned = planned.unwrap_or_default();
        let manoeuvre = match planned.first() {
            Some((name, text)) => format!("{name} ({text})"),
            None => model.candidates.iter().find(|c| c.id == f.id).map_or("", |c| c.manoeuvre).to_string(),
        };
        let text = format!("to tell {} from {}: {manoeuvre}", f.id, names.join(", "));
        advice.push(Advice { text, manoeuvres: planned.into_iter().map(|(name, _)| name).collect() });
    }
    if let Some(first) = tracks.first() {
        advice.extend(limits::advice(vehicle, first, model, &evidence, &limits, &solution.set)?);
    }
    Ok(Diagnosis {
        vehicle: vehicle.name.clone(),
        vehicle_sha256: vehicle.sha256(),
        dynamics: tracks.first().map_or_else(String::new, |t| t.dynamics.into()),
        logs: tracks
            .iter()
            .zip(&solution.linear.noise)
            .map(|(t, noise)| LogSummary {
                name: t.name.clone(),
                sha256: t.log.sha256.clone(),
                duration_s: t.duration_s(),
                drive: t.drive.title().into(),
                noise: *noise,
                held_out: false,
            })
            .collect(),
        headline: headline(&verdict, &findings, remainder.unexplained),
        verdict,
        findings,
        calibration,
        adjusted,
        remainder,
        ladder: Vec::new(),
        advice,
        limits,
        not_tried: model.not_tried.clone(),
        singles,
        second: opinion::selection(model, &witness),
        dispersion: solution.dispersion,
        per_log: differences(logs, model, solution)?,
        warnings,
    })
}

/// Id of what no candidate describes, among look-alikes.
pub const UNLISTED: &str = "unlisted";

/// What stands in place of a finding where the logs cannot tell it from physics that is in no list.
fn unlisted() -> LookAlike {
    LookAlike {
        ids: vec![UNLISTED.into()],
        title: "something that is not in the list".into(),
        worse_by_nats: 0.0,
        manoeuvre: String::new(),
    }
}

/// Takes the findings `of` back, as the nearest of what is in the list; from logs that show little they stay, in doubt.
fn doubt(findings: &mut Vec<Finding>, nearest: &mut Vec<String>, poor: bool, of: impl Fn(&Finding) -> bool) {
    if !poor {
        nearest.extend(findings.extract_if(.., |f| of(f)).map(|f| f.id));
        return;
    }
    for f in findings.iter_mut().filter(|f| of(f)) {
        if !f.look_alikes.iter().any(|l| l.ids == [UNLISTED]) {
            f.certain = false;
            f.look_alikes.push(unlisted());
        }
    }
}

/// The verdict "turbulence": a force without pattern, at no particular time, of the size that wind of up to 3 m/s makes on this
/// vehicle.
fn turbulence(
    model: &Model,
    logs: &[Prepared],
    solution: &Solution,
    left: &Remainder,
    poor: bool,
) -> Option<Finding> {
    // Weather has no pattern, but for what the pilot does against it: all that there is in a quiet flight.
    let pattern = |t: &FreeTerm| t.on.starts_with("force") && t.explained_share > WEATHER_SHARE;
    // Nor does it leave more than disturbances and the sensors' noise make together.
    // Quiet flights show too little to tell; what is named there stands in doubt anyway.
    let scatter = if poor { solution.dispersion } else { solution.misfit };
    let misfit = scatter > MOST_DISPERSION;
    let patterned = left.terms.iter().any(pattern);
    let force_m_s2 = left.force_seen_m_s2();
    if misfit || (patterned && !poor) || force_m_s2 <= LARGE_FORCE_M_S2 {
        return None;
    }
    // Acceleration by 1 m/s of wind in hover; a poor flight knows its drag less well than the file.
    let values = if poor { model.filed() } else { solution.linear.at.clone() };
    let drone = model.plain_at(&values, &[]);
    let hovering = State { rotor_vel: drone.hover_rotor_vel(), ..State::rest() };
    let acceleration = |wind_m_s: [f64; 3]| {
        let around = Surroundings { wind_m_s, ..Surroundings::calm() };
        let held = drone::Measured::RotorAcc([0.0; MAX_ROTORS]);
        drone.rate_measured(&hovering, &held, &around).acc
    };
    let still = acceleration([0.0; 3]);
    let gain = |axis: usize| {
        let mut wind = [0.0; 3];
        wind[axis] = 1.0;
        (acceleration(wind)[axis] - still[axis]).abs()
    };
    let n = solution.linear.windows.len().max(1) as f64;
    let [across, up, ..] = solution.disturbance.common;
    let parameters: Vec<ParameterFit> = [(0, across), (1, across), (2, up)]
        .into_iter()
        .filter(|(axis, _)| gain(*axis) > 1e-6)
        .map(|(axis, force)| {
            let value = force * force_m_s2 / left.force_m_s2 / gain(axis);
            ParameterFit {
                name: format!("sigma_m_s.{axis}"),
                unit: "m/s".into(),
                filed: 0.0,
                value,
                // Windows within a second are not independent.
                sigma: value / (0.5 * n).sqrt(),
            }
        })
        .collect();
    // Air is as restless across as along, and not more so up and down (Dryden: σ_w ≤ σ_u).
    let flat_air = parameters.iter().all(|p| p.value < 1.6 * parameters[0].value);
    let believable = !parameters.is_empty() && parameters.iter().all(|p| p.value < 3.0) && flat_air;
    (believable && !forces_only(logs)).then(|| Finding {
        id: "turbulence".into(),
        kind: "turbulence".into(),
        title: "gusty air without a rhythm".into(),
        area: Area::Airframe,
        second: opinion::weather(),
        set: Vec::new(),
        parameters,
        evidence_nats: 0.5 * n * (force_m_s2 / LARGE_FORCE_M_S2).powi(2).ln(),
        removed_share: 0.0,
        certain: !patterned,
        look_alikes: if patterned { vec![unlisted()] } else { Vec::new() },
        stands_for: Vec::new(),
        held_out: None,
    })
}

/// What pushes the windows with every log's parameters `deltas` from where they were linearised.
pub(super) fn samples(
    logs: &[Prepared],
    model: &Model,
    solution: &Solution,
    disturbance: &Disturbance,
    deltas: &[Vec<f64>],
) -> Vec<Sample> {
    // Mean rotor speed (or the root of the thrust) over that of the flight.
    let rotors: Vec<Vec<f64>> = logs
        .iter()
        .enumerate()
        .map(|(index, p)| {
            let plain = model.plain_at(&solution.linear.values_of(index), &solution.set);
            let ticks = drive(p.track, &p.around, &p.raw, &plain);
            let speeds: Vec<f64> = ticks
                .iter()
                .map(|t| {
                    let sum: f64 = t.rotor_vel.iter().sum();
                    if sum > 0.0 { sum } else { t.thrust.max(0.0).sqrt() }
                })
                .collect();
            let mean = speeds.iter().sum::<f64>() / speeds.len().max(1) as f64;
            speeds.iter().map(|s| if mean > 0.0 { s / mean } else { 1.0 }).collect()
        })
        .collect();
    let steps = (solution.linear.horizon_s / STEP_S).round() as usize;
    let mut out = Vec::new();
    for w in &solution.linear.windows {
        let Some((mean, variance)) = w.push_estimate(disturbance, &deltas[w.log]) else { continue };
        let p = &logs[w.log];
        let measured = |tick: usize| p.around.measured(tick).copied().unwrap_or(w.start);
        let doing = (0..PLACES)
            .map(|i| {
                let tick = w.from + STEP * (steps * (2 * i + 1) / (2 * PLACES));
                let here = measured(tick);
                let rpy = euler::from_quat(here.quat);
                Doing {
                    vel: quat::rotate_inverse(here.quat, here.vel),
                    ang_vel: here.ang_vel,
                    tilt: [rpy[0], rpy[1]],
                    height_m: here.pos[2],
                    rotor: rotors[w.log].get(tick).copied().unwrap_or(1.0),
                    time: (p.around.time_s(tick) - p.track.span_s[0]) / p.track.duration_s(),
                }
            })
            .collect();
        let middle = measured(w.from + STEP * (steps / 2));
        let acc = quat::rotate_inverse(middle.quat, [mean[0], mean[1], mean[2]]);
        let push = [acc[0], acc[1], acc[2], mean[3], mean[4], mean[5]];
        out.push(Sample { push, variance, doing });
    }
    out
}

/// Times of a window at which the library's variables are taken.
const PLACES: usize = 5;

/// The term that clearly describes what finding `of` leaves, where that comes of its shape: then its shape is not that of what
/// is missing.
fn other_shape(
    logs: &[Prepared],
    model: &Model,
    solution: &Solution,
    of: usize,
    left: &[Sample],
) -> Option<String> {
    // What it explains is a disturbance then, and as free to be one as it is large.
    let without = |gone: &dyn Fn(usize) -> bool| {
        let deltas = solution.deltas_without(model, gone);
        samples(logs, model, solution, &Disturbance::unknown(), &deltas)
    };
    // With the tolerances of the air, which would lend themselves to its shape.
    let airy = |c: usize| model.candidates[c].area == Area::Airframe && !solution.set.contains(&c);
    let pushed = without(&|c| c == of || airy(c));
    let alone = without(&|c| c == of);
    let left: Vec<[f64; 6]> = left.iter().map(|s| s.push).collect();
    if pushed.len() != left.len() || alone.len() != left.len() {
        return None;
    }
    // A shape along an axis along which the effect hardly acts is not left by it: a torque leaves no force.
    let acts = core::array::from_fn(|k| {
        let part =
            |of: &[Sample]| -> f64 { of.iter().zip(&left).map(|(s, l)| (s.push[k] - l[k]).powi(2)).sum() };
        part(&alone) > OWN_SHARE * part(&pushed)
    });
    let drag_too = model.candidates[of].kind != "linear_drag";
    let (term, nats) = free_form::instead(&pushed, &left, acts, drag_too)?;
    (nats > SURE_NATS).then_some(term)
}

/// Share of what is explained along an axis, beside the tolerances of the air, from which on an effect acts there.
const OWN_SHARE: f64 = 0.25;

/// Share of the disturbances' variance that findings must explain, where something regular or large is left.
const LEANING: f64 = 0.7;
/// The same where what is left is an event.
const EVENTFUL: f64 = 0.9;

/// Evidence by which a term must describe what an effect leaves.
const SURE_NATS: f64 = 25.0;

/// What the windows' disturbances say about what is left, as far as poses and inertial data agree on it.
pub(super) fn remainder(
    logs: &[Prepared],
    model: &Model,
    solution: &Solution,
    samples: &[Sample],
) -> (Remainder, bool) {
    let cross = cross_check(logs, model, solution);
    let sizes = |of: &Disturbance| {
        let (force, torque) = of.sizes();
        // Where the attitude is fed in, nothing is known of torques: their size is still what was assumed at first.
        (force, if forces_only(logs) { 0.0 } else { torque })
    };
    let (force_m_s2, torque_rad_s2) = sizes(&solution.disturbance);
    let (force0, torque0) = sizes(&solution.disturbance_before);
    let mut remainder = Remainder {
        force_m_s2,
        torque_rad_s2,
        force_before_m_s2: force0,
        torque_before_rad_s2: torque0,
        force_agreed_m_s2: cross.force,
        torque_agreed_rad_s2: cross.torque,
        unexplained: false,
        terms: free_form::describe(samples),
        text: String::new(),
    };
    let (force, torque) = (remainder.force_seen_m_s2(), remainder.torque_seen_rad_s2());
    remainder.terms.retain(|t| size_of(t, force, torque) >= 0.5);
    let regular = regular(&remainder.terms, force, torque);
    let large = force > LARGE_FORCE_M_S2 || torque > LARGE_TORQUE_RAD_S2;
    let event = concentrated(samples).filter(|(_, times)| large && *times > EVENT);
    remainder.unexplained = regular || large;
    (remainder.told(event.map(|e| e.0)), event.is_some())
}

/// Size of what a term describes, over that from which on it matters.
fn size_of(t: &FreeTerm, force_m_s2: f64, torque_rad_s2: f64) -> f64 {
    let share = t.explained_share.max(0.0).sqrt();
    if t.on.starts_with("force") {
        share * force_m_s2 / REGULAR_FORCE_M_S2
    } else {
        share * torque_rad_s2 / REGULAR_TORQUE_RAD_S2
    }
}

/// Whether a term describes something that is both regular and large enough to matter.
fn regular(terms: &[FreeTerm], force_m_s2: f64, torque_rad_s2: f64) -> bool {
    terms.iter().any(|t| t.explained_share >= REGULAR_SHARE && size_of(t, force_m_s2, torque_rad_s2) >= 1.0)
}

/// Share of the scatter that a term may describe by chance, where the wind itself sets the vehicle in motion.
const WEATHER_SHARE: f64 = 0.14;
/// Size of what a term describes from which on it matters.
const REGULAR_FORCE_M_S2: f64 = 0.03;
const REGULAR_TORQUE_RAD_S2: f64 = 0.06;
/// Share of the scatter from which on a term says that something regular is missing.
const REGULAR_SHARE: f64 = 0.2;
/// Force over mass and torque over inertia that a well-known vehicle in calm air does not leave.
const LARGE_FORCE_M_S2: f64 = 0.06;
const LARGE_TORQUE_RAD_S2: f64 = 0.8;
/// Scatter of the worst two seconds over that of usual ones from which on a disturbance is an event and no weather.
const EVENT: f64 = 3.5;

/// Where the disturbing force is concentrated: middle of the worst two seconds (share of the log's length) and its scatter
/// over that of the median two seconds.
fn concentrated(samples: &[Sample]) -> Option<(f64, f64)> {
    let blocks = samples.chunks(8);
    let rms: Vec<(f64, f64)> = blocks
        .map(|b| {
            let square: f64 = b.iter().map(|s| s.push[..3].iter().map(|p| p * p).sum::<f64>()).sum();
            let middle = &b[b.len() / 2].doing;
            (middle[middle.len() / 2].time, (square / b.len() as f64).sqrt())
        })
        .collect();
    let usual = clean::median(rms.iter().map(|r| r.1).collect())?;
    let worst = rms.iter().max_by(|a, b| a.1.total_cmp(&b.1))?;
    Some((worst.0, worst.1 / usual.max(1e-12)))
}

impl Remainder {
    /// The force that is left, as far as poses and inertial data agree on it: errors of one of them are no physics.
    fn force_seen_m_s2(&self) -> f64 {
        self.force_agreed_m_s2.map_or(self.force_m_s2, |agreed| agreed.min(self.force_m_s2))
    }

    /// The same of the torque.
    fn torque_seen_rad_s2(&self) -> f64 {
        self.torque_agreed_rad_s2.map_or(self.torque_rad_s2, |agreed| agreed.min(self.torque_rad_s2))
    }

    /// Puts the remainder into words.
    fn told(mut self, event_at: Option<f64>) -> Self {
        let part = |name, unit, size: f64, before: f64, agreed: Option<f64>, decimals: usize| {
            let only = match agreed.filter(|agreed| *agreed < size) {
                Some(agreed) => format!(", but poses and inertial data agree on {agreed:.decimals$} only"),
                None => String::new(),
            };
            format!("{name} {size:.decimals$} {unit} (before: {before:.decimals$}{only})")
        };
        let mut size = format!(
            "what stays over 0.25 s: {}",
            part("force", "m/s²", self.force_m_s2, self.force_before_m_s2, self.force_agreed_m_s2, 3)
        );
        if self.torque_before_rad_s2 > 0.0 {
            let (now, before) = (self.torque_rad_s2, self.torque_before_rad_s2);
            size = format!("{size}, {}", part("torque", "rad/s²", now, before, self.torque_agreed_rad_s2, 2));
        }
        self.text = match (&self.terms.first(), event_at) {
            (_, Some(at)) => format!("{size}; most of it at {:.0} % of the flight: an event", 100.0 * at),
            (Some(t), _) if t.explained_share >= REGULAR_SHARE => format!(
                "{size}; {} goes with {} ({:.0} % of it)",
                t.on,
                t.variable,
                100.0 * t.explained_share
            ),
            _ => size,
        };
        self
    }
}

/// `hidden`: how many effects could hide, where that is too many for a plain no.
fn sentence(findings: &[Finding], remainder: &Remainder, nearest: &[String], hidden: usize) -> String {
    let names: Vec<String> = findings
        .iter()
        .map(|f| {
            if f.certain {
                f.id.clone()
            } else if f.look_alikes.is_empty() {
                format!("{} (not certain: the second estimator {})", f.id, f.second.said.words())
            } else {
                let others: Vec<String> = f.look_alikes.iter().map(|l| l.ids.join(" + ")).collect();
                format!("{} (or {})", f.id, others.join(", or "))
            }
        })
        .collect();
    // What was taken back is told all the same.
    let seen = |text: String| match nearest {
        [] => text,
        near => format!("{text} (seen, but not enough to be sure: {})", near.join(", ")),
    };
    match (findings.is_empty(), remainder.unexplained) {
        (true, false) if hidden == 0 => "nothing is missing".into(),
        (true, false) => {
            format!(
                "nothing is missing that these logs could show; {hidden} effects of usual size could hide in them"
            )
        }
        (false, false) => seen(format!("missing: {}", names.join("; "))),
        (false, true) => seen(format!("missing: {}; and something unexplained is left", names.join("; "))),
        (true, true) if nearest.is_empty() => {
            "unexplained: something is missing that is not in the list".into()
        }
        (true, true) => format!(
            "unexplained: something is missing that is not in the list (nearest, but not enough: {})",
            nearest.join(", ")
        ),
    }
}
