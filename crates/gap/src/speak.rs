//! Composes a diagnosis from a solution: findings with look-alikes and the second estimator's opinion, calibration, advice.

use super::GapError;
use super::decide::rules::Why;
use super::decide::{Decision, UNLISTED, remainder::samples};
use super::excite;
use super::fit::Prepared;
use super::headline::headline;
use super::limits;
use super::model::Model;
use super::opinion;
use super::per_log::{beyond_tolerance_in_a_log, differences};
use super::policy::{LATE_S, LATE_SIGMAS};
use super::report::interval;
use super::search::{Evidence, THRESHOLD};
use super::solve::Solution;
use super::track::{Drive, Track};
use super::unseen::{each_for_itself, removed_share};
use super::verdict::{
    Advice, Calibration, Diagnosis, Finding, LogSummary, LookAlike, OfOneLog, Opinion, ParameterFit,
};
use super::witness::Witness;
use propwash_physics::effects::Needs;
use propwash_vehicle::Vehicle;

/// Most look-alikes reported per finding.
const MOST_ALIKE: usize = 8;

/// The diagnosis of a solution, without [`advice`]. `why` holds what was left out before; `by_formula` says whether formulas of a search
/// are among the candidates.
pub(super) fn speak(
    tracks: &[Track],
    vehicle: &Vehicle,
    model: &Model,
    logs: &[Prepared],
    solution: &Solution,
    why: Vec<Why>,
    by_formula: bool,
) -> Result<Diagnosis, GapError> {
    let evidence = solution.evidence(model)?;
    let witness = Witness::beside(model, logs, solution);
    // Independent windows: a held-out one must not carry information from the others.
    let apart = each_for_itself(solution);
    let mut found = Vec::new();
    for c in &solution.set {
        let share = removed_share(model, solution, &apart, &[*c])?;
        found.push(Finding { removed_share: share, ..finding(model, solution, &evidence, &witness, *c) });
    }
    found.sort_by(|a, b| b.evidence_nats.total_cmp(&a.evidence_nats));
    let mut singles: Vec<(String, f64)> =
        model.named().map(|c| (model.candidates[c].id.clone(), evidence.of(&[c]))).collect();
    singles.sort_by(|a, b| b.1.total_cmp(&a.1));

    let left = samples(logs, model, solution, &solution.disturbance, &solution.deltas);
    let limits = limits::limits(model, &evidence, solution);
    let poor = limits::poor(model, solution)?;
    let mut decision = Decision::new(model, logs, solution, &left, found, poor);
    // Shapes first: the joint rule reads a remainder as turbulence only if no shape was withdrawn.
    decision.judge_shapes(&evidence, &left);
    decision.judge_together(removed_share(model, solution, &apart, &solution.set)?, by_formula);
    decision.say_why_not(&evidence, &singles);
    let per_log = differences(logs, model, solution)?;
    decision.findings.extend(of_each_log(model, solution, &per_log));
    let hidden = if poor { limits.iter().filter(|l| !l.visible).count() } else { 0 };
    let verdict = decision.sentence(hidden);
    let Decision { findings, remainder, why: decided, .. } = decision;
    let mut adjusted = adjusted(model, solution);
    adjusted.retain(|a| findings.iter().all(|f| f.id != a.id));
    let name = |t: &Track, w: &String| if tracks.len() > 1 { format!("{}: {w}", t.name) } else { w.clone() };
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
        formulas: Vec::new(),
        network: None,
        why: why.into_iter().chain(decided).collect(),
        calibration: adjusted.iter().filter(|c| corrected(c)).cloned().collect(),
        adjusted,
        remainder,
        ladder: Vec::new(),
        advice: Vec::new(),
        limits,
        not_tried: model.not_tried.clone(),
        singles,
        second: opinion::selection(model, &witness),
        dispersion: solution.dispersion,
        per_log,
        moments: Vec::new(),
        sections: Vec::new(),
        warnings: tracks
            .iter()
            .flat_map(|t| t.warnings.iter().map(move |w| name(t, w)))
            .chain(model.say_held(&solution.posterior.mean))
            .chain(late_drive(tracks, model, solution))
            .collect(),
    })
}

/// That what drives the model comes late, or early, against all sensors alike. Where it was smoothed that counts as tolerance, which
/// may be wide, but nobody should fly with it unknowingly.
fn late_drive(tracks: &[Track], model: &Model, solution: &Solution) -> Option<String> {
    let drive =
        tracks.first().map(|t| t.drive).filter(|d| matches!(d, Drive::RotorSpeeds | Drive::Thrust))?;
    let own = |c: &usize| model.candidates[*c].needs == Needs::MeasuredInputs;
    let clock = model.timing().into_iter().find(own).filter(|c| !solution.set.contains(c))?;
    let k = model.of(clock).next()?;
    let late_s = solution.posterior.mean[k] - model.parameters[k].filed;
    let sigma_s = solution.posterior.sigma[k];
    (late_s.abs() > LATE_S.max(LATE_SIGMAS * sigma_s)).then(|| {
        format!(
            "the {} come {} {} than all sensors say: within what smoothing their noise leaves open, so nothing is missing by it; shift \
             their time (shift_s of a mapping), or write the clocks (add --calibrate)",
            drive.title(),
            interval(late_s.abs(), sigma_s, "s"),
            if late_s > 0.0 { "later" } else { "earlier" },
        )
    })
}

/// What the logs have each for itself and not in common, beyond tolerance.
fn of_each_log(model: &Model, solution: &Solution, per_log: &[OfOneLog]) -> Vec<Finding> {
    let beyond = beyond_tolerance_in_a_log(model, solution, per_log);
    let one = |(c, nats)| Finding {
        each_log: true,
        certain: true,
        ..estimated(model, solution, c, nats, opinion::each_log())
    };
    beyond.into_iter().map(one).collect()
}

/// The finding for one candidate of a solution's set; its share of the held-out error is filled in later.
fn finding(model: &Model, solution: &Solution, evidence: &Evidence, witness: &Witness, c: usize) -> Finding {
    let second = opinion::of(model, witness, solution, c);
    let rest: Vec<usize> = solution.set.iter().copied().filter(|x| *x != c).collect();
    let nats = evidence.of(&solution.set) - evidence.of(&rest);
    let look_alikes = alike(model, evidence, &solution.set, c);
    let mut names = vec![model.candidates[c].id.as_str()];
    names.extend(look_alikes.iter().flat_map(|l| &l.ids).map(String::as_str));
    Finding {
        stands_for: model.hidden_behind(&names),
        certain: look_alikes.is_empty() && opinion::certain(second.said, nats),
        look_alikes,
        ..estimated(model, solution, c, nats, second)
    }
}

/// A candidate with the estimates of a solution, as a finding of which nothing else is known yet.
fn estimated(model: &Model, solution: &Solution, c: usize, nats: f64, second: Opinion) -> Finding {
    let candidate = &model.candidates[c];
    Finding {
        id: candidate.id.clone(),
        kind: candidate.kind.into(),
        title: candidate.title.clone(),
        area: candidate.area,
        parameters: model.of(c).map(|k| parameter_fit(model, solution, k)).collect(),
        set: model.preset_values(c),
        evidence_nats: nats,
        removed_share: 0.0,
        certain: false,
        second,
        look_alikes: Vec::new(),
        stands_for: Vec::new(),
        held_out: None,
        each_log: false,
    }
}

/// What fits about as well in place of a candidate of a set.
pub(super) fn alike(model: &Model, evidence: &Evidence, set: &[usize], c: usize) -> Vec<LookAlike> {
    let mut alike = evidence.in_place_of(set, c, THRESHOLD);
    let together = evidence.in_place_of_all(set, c, THRESHOLD);
    let new = |set: &[usize]| !alike.iter().any(|(ids, _)| ids.iter().all(|i| set.contains(i)));
    let together: Vec<_> = together.into_iter().filter(|(set, _)| new(set)).collect();
    alike.extend(together);
    let one = |(ids, worse): (Vec<usize>, f64)| LookAlike {
        title: ids.iter().map(|i| model.candidates[*i].title.as_str()).collect::<Vec<_>>().join(" with "),
        manoeuvre: model.candidates[ids[0]].manoeuvre.into(),
        ids: ids.iter().map(|i| model.candidates[*i].id.clone()).collect(),
        worse_by_nats: worse,
    };
    alike.into_iter().take(MOST_ALIKE).map(one).collect()
}

fn parameter_fit(model: &Model, solution: &Solution, k: usize) -> ParameterFit {
    let p = &model.parameters[k];
    // An estimate at its bound is set to the bound, without rounding error.
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

/// Estimates of all parameters that are not findings.
fn adjusted(model: &Model, solution: &Solution) -> Vec<Calibration> {
    let beside = |p: usize| !solution.set.contains(&p) && !model.is_shape(p);
    let parameters = model.parameters.iter().enumerate().filter(|(_, p)| beside(p.candidate));
    parameters
        .map(|(k, p)| {
            let candidate = &model.candidates[p.candidate];
            Calibration {
                id: candidate.id.clone(),
                kind: candidate.kind.into(),
                area: candidate.area,
                parameter: parameter_fit(model, solution, k),
                set: model.preset_values(p.candidate),
                tolerance: p.spike,
                helps: false,
                partner: false,
            }
        })
        .collect()
}

/// Whether the log moves a parameter by more than two standard deviations and half of its tolerance.
fn corrected(c: &Calibration) -> bool {
    let off = (c.parameter.value - c.parameter.filed).abs();
    off > 2.0 * c.parameter.sigma && off > 0.5 * c.tolerance
}

/// What to fly next: to separate findings from look-alikes, and to reveal effects that could be hidden.
pub(super) fn advice(
    tracks: &[Track],
    vehicle: &Vehicle,
    model: &Model,
    solution: &Solution,
    verdict: &Diagnosis,
) -> Result<Vec<Advice>, GapError> {
    let Some(first) = tracks.first() else { return Ok(Vec::new()) };
    let Diagnosis { findings, limits, .. } = verdict;
    let evidence = solution.evidence(model)?;
    let ids: Vec<&str> = model.named().map(|c| model.candidates[c].id.as_str()).collect();
    let listed = model.only(&|id| ids.contains(&id));
    let mut out = Vec::new();
    for f in findings.iter().filter(|f| !f.certain) {
        let names: Vec<String> = f.look_alikes.iter().map(|l| l.ids.join(" + ")).collect();
        let alike: Vec<String> =
            f.look_alikes.iter().flat_map(|l| l.ids.iter().cloned()).filter(|id| id != UNLISTED).collect();
        if alike.is_empty() {
            continue;
        }
        let (sensors, own) = (excite::Sensors::of(first), std::slice::from_ref(&f.id));
        let planned = excite::advice(vehicle, first.drive, &sensors, &listed, own, &alike);
        // If the vehicle cannot be simulated, or no manoeuvre of the library separates them, refer to the effect's own
        // page.
        let planned = planned.unwrap_or_default();
        let manoeuvre = match planned.first() {
            Some((name, text)) => format!("{name} ({text})"),
            None => model.candidates.iter().find(|c| c.id == f.id).map_or("", |c| c.manoeuvre).to_string(),
        };
        let text = format!("to tell {} from {}: {manoeuvre}", f.id, names.join(", "));
        out.push(Advice { text, manoeuvres: planned.into_iter().map(|(name, _)| name).collect() });
    }
    out.extend(limits::advice(vehicle, first, model, &evidence, limits, &solution.set)?);
    Ok(out)
}
