//! How large an effect could be without showing in the logs, and which manoeuvres would reveal those that could be large.

use super::GapError;
use super::disturbance::Disturbance;
use super::excite;
use super::model::Model;
use super::per_log::Information;
use super::search::{Evidence, covariance, smallest};
use super::solve::Solution;
use super::track::Track;
use super::verdict::{Advice, Limit};
use nalgebra::DMatrix;
use propwash_physics::effects::{Area, FromLog};
use propwash_vehicle::Vehicle;

/// Expected evidence of an effect that exceeds its threshold in 95 of 100 flights, nats: evidence has the variance of twice
/// itself.
const SURE: f64 = 16.0;
/// Share of its plausible size at which an effect must be visible for the logs to count as sensitive to it.
const VISIBLE: f64 = 0.7;
/// Most hidden effects for which each one's own manoeuvre is named; above, a flight is planned for all of them. In calm air
/// exciting flights of the generator hide 2 to 4, Lissajous figures, circles and way-points 9 to 13, hovering 11 to 15.
const FEW: usize = 6;

/// Target of a planned flight, as a share of the plausible size: with a margin, since it is not flown exactly as planned.
const AIM: f64 = 0.45;
/// Rotor command over hover speed at which a limit of the rotors would show.
const DEMANDING: f64 = 1.4;

/// Whether, even in calm air, so many effects could hide that the logs cannot separate unlisted physics from listed effects
/// or from turbulence. The unexplained remainder does not count: it would hide everything.
pub(super) fn poor(model: &Model, solution: &Solution) -> Result<bool, GapError> {
    let air = excite::Air::default();
    let sizes = [air.force_m_s2, air.force_m_s2, air.torque_rad_s2, air.torque_rad_s2];
    let calm = Disturbance { common: sizes, quick: sizes, kept: [0.0; 4], ..solution.disturbance };
    let all = Information::new(model, &solution.linear, &solution.linear.reduce(&calm), |_| true)?;
    let evidence = Evidence::new(model, &all.h, &all.g, &solution.linear.at, 1.0, 1.0)?;
    // Clocks are no physics: behind smoothed inputs they could be off by milliseconds in any flight.
    let clocks: Vec<&str> = model
        .timing()
        .into_iter()
        .map(|c| &model.candidates[c])
        .filter(|c| c.area == Area::Measurement)
        .map(|c| c.id.as_str())
        .collect();
    let limit = of_a_limit(model);
    let of_physics = |l: &&Limit| limit != Some(l.id.as_str()) && !clocks.contains(&l.id.as_str());
    let hidden = limits(model, &evidence, solution).iter().filter(of_physics).filter(|l| !l.visible).count();
    Ok(hidden > FEW)
}

/// Name of the candidate whose parameter is a limit: it only shows where it is reached.
fn of_a_limit(model: &Model) -> Option<&str> {
    model.given(FromLog::FastestCommand).map(|(c, _)| model.candidates[c].id.as_str())
}

/// Whether rotors were commanded far beyond hover.
fn demanding(model: &Model) -> bool {
    let limit = model.given(FromLog::FastestCommand);
    let most = limit.and_then(|(c, given)| model.candidates[c].preset.iter().find(|(name, _)| name == given));
    most.is_some_and(|(_, v)| *v >= DEMANDING * model.drone.hover_rotor_vel()[0])
}

/// The limits of all candidates that were not found, the least visible first.
pub(super) fn limits(model: &Model, evidence: &Evidence, solution: &Solution) -> Vec<Limit> {
    let smallest = evidence.smallest(&solution.set, SURE).unwrap_or_default();
    let limit = of_a_limit(model);
    let mut out: Vec<(f64, Limit)> = model
        .named()
        .filter(|c| model.may[*c] && !solution.set.contains(c))
        .filter_map(|c| {
            let p = &model.parameters[model.of(c).next()?];
            let share = *smallest.get(c)?;
            let known = share < MOST;
            let hidden = Limit {
                id: model.candidates[c].id.clone(),
                parameter: p.name.clone(),
                unit: p.unit.into(),
                size: known.then_some(share * p.slab),
                share: known.then_some(share),
                visible: share <= VISIBLE
                    && (limit != Some(model.candidates[c].id.as_str()) || demanding(model)),
            };
            Some((share, hidden))
        })
        .collect();
    out.sort_by(|a, b| b.0.total_cmp(&a.0));
    out.into_iter().map(|(_, limit)| limit).collect()
}

/// Shares of a plausible size above which the logs count as insensitive.
const MOST: f64 = 100.0;

/// What to fly so that possibly hidden effects would show.
pub(super) fn advice(
    vehicle: &Vehicle,
    track: &Track,
    model: &Model,
    evidence: &Evidence,
    limits: &[Limit],
    found: &[usize],
) -> Result<Vec<Advice>, GapError> {
    let hidden: Vec<&str> = limits.iter().filter(|l| !l.visible).map(|l| l.id.as_str()).collect();
    let own = |id: &str| {
        let candidate = model.candidates.iter().find(|c| c.id == id);
        let manoeuvre = candidate.map_or("", |c| c.manoeuvre);
        Advice { text: format!("{id} could hide in these logs: {manoeuvre}"), manoeuvres: Vec::new() }
    };
    // A planned flight pays only for many effects at once.
    if hidden.len() <= FEW {
        return Ok(hidden.into_iter().map(own).collect());
    }
    let listed = model.only(&|id| model.named().any(|c| model.candidates[c].id == id));
    // The logs' own information about the parameters for which the manoeuvres are judged.
    let n = listed.parameters.len();
    let place = |k: usize| {
        let p = &listed.parameters[k];
        let id = &listed.candidates[p.candidate].id;
        model
            .parameters
            .iter()
            .position(|q| q.name == p.name && model.candidates[q.candidate].id == *id)
            .unwrap_or(0)
    };
    let places: Vec<usize> = (0..n).map(place).collect();
    let told = DMatrix::from_fn(n, n, |i, j| evidence.a[(places[i], places[j])]);
    let open = |c: usize| found.iter().any(|f| model.candidates[*f].id == listed.candidates[c].id);
    let prior: Vec<f64> = listed
        .parameters
        .iter()
        .map(|p| if open(p.candidate) { 1.0 } else { (p.slab / p.spike).powi(2) })
        .collect();
    let wanted: Vec<usize> =
        hidden.iter().filter_map(|id| listed.candidates.iter().position(|c| c.id == *id)).collect();
    // Distance of each from being visible, ln.
    let far = |a: &DMatrix<f64>| -> Vec<f64> {
        let covariance = covariance(a, &prior);
        let far = |c: &usize| {
            let of: Vec<usize> = listed.of(*c).collect();
            let size = covariance.as_ref().and_then(|k| smallest(k, &of, &prior, SURE)).unwrap_or(MOST);
            (size.min(MOST) / AIM).ln().max(0.0)
        };
        wanted.iter().map(far).collect()
    };
    let sensors = excite::Sensors::of(track);
    // A rotor limit shows only where it is reached; no derivative tells how far away it is.
    let limit = of_a_limit(model);
    let hardest = limit.is_some_and(|id| hidden.contains(&id));
    let Some(plan) = excite::show(vehicle, track.drive, &sensors, &listed, &told, &far, hardest) else {
        return Ok(hidden.into_iter().map(own).collect());
    };
    let names = |keep: &dyn Fn(f64) -> bool| -> Vec<&str> {
        let kept = wanted.iter().zip(&plan.far).filter(|(_, far)| keep(**far));
        kept.map(|(c, _)| listed.candidates[*c].id.as_str()).collect()
    };
    let (aimed, hidden_still) = (names(&|f| f <= 0.0), names(&|f| f > (VISIBLE / AIM).ln()));
    let left: Vec<&str> = hidden_still.into_iter().filter(|id| Some(*id) != limit).collect();
    let mut text = format!("effects of usual size could hide in these logs: {}", hidden.join(", "));
    if !plan.manoeuvres.is_empty() {
        let what = match (aimed.is_empty(), left.is_empty()) {
            (true, false) => "which brings them nearer to sight".to_string(),
            (_, true) => "which would show all of them".to_string(),
            (false, false) => format!("which would show all but {}", left.join(", ")),
        };
        text = format!("{text}; fly {} ({:.0} s), {what}", plan.manoeuvres.join(", "), plan.seconds);
    }
    Ok(vec![Advice { text, manoeuvres: plan.manoeuvres }])
}
