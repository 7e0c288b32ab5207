//! Whether any effect is missing, by the first steps of a diagnosis: reported by `compare` beside the size of the errors.
//!
//! A vehicle whose parameters are off within their tolerances departs from every log by many times the sensors' noise,
//! though no effect is missing. The search of a diagnosis, on fewer windows and without its later steps, distinguishes the
//! two.

use super::GapError;
use super::decide::remainder::{remainder, samples};
use super::fit::{Prepared, forces_only};
use super::model::Model;
use super::policy::{
    CLEAR_FROM_S, CLEAR_NATS, CLEAR_TIMES, CLEAR_WINDOWS, GLANCE_WINDOWS, LARGE_FORCE_M_S2,
    LARGE_TORQUE_RAD_S2,
};
use super::replay::Inputs;
use super::solve::{Solution, glance};
use super::track::Track;
use super::verdict::Remainder;
use propwash_vehicle::Vehicle;

/// Whether parameters within the vehicle's tolerances explain its residuals on flights; `None` where too little of them is
/// usable.
///
/// # Errors
/// [`GapError`] where the vehicle lacks the dynamics or a value is not finite.
pub(super) fn within_tolerance(
    tracks: &[Track],
    inputs: &[Inputs],
    vehicle: &Vehicle,
) -> Result<Option<bool>, GapError> {
    let (Some(first), Some(Inputs { drone, .. })) = (tracks.first(), inputs.first()) else { return Ok(None) };
    if tracks.iter().any(|t| t.dynamics != first.dynamics) {
        return Ok(None);
    }
    let of_log = |(t, i): (_, &Inputs)| Prepared::of(t, i.around.clone(), i.raw.clone(), drone);
    let logs: Vec<Prepared> = tracks.iter().zip(inputs).map(of_log).collect();
    let arounds: Vec<_> = logs.iter().map(|l| &*l.around).collect();
    let mut model = Model::new(drone, &tracks.iter().collect::<Vec<_>>(), &arounds)?.held_to(vehicle);
    let long = tracks.iter().map(Track::duration_s).sum::<f64>() > CLEAR_FROM_S;
    for most in CLEAR_WINDOWS.into_iter().filter(|_| long) {
        if clearly_missing(&logs, &mut model, most)? {
            return Ok(Some(false));
        }
    }
    let Some(solution) = glance(&logs, &mut model, GLANCE_WINDOWS)? else { return Ok(None) };
    Ok(Some(solution.set.is_empty() && !left(&logs, &model, &solution).unexplained))
}

/// Whether so much is missing that a few of the windows show it: an effect, or forces that no effect explains.
fn clearly_missing(logs: &[Prepared], model: &mut Model, windows: usize) -> Result<bool, GapError> {
    let Some(few) = glance(logs, model, windows)? else { return Ok(false) };
    if !few.set.is_empty() && few.evidence(model)?.of(&few.set) > CLEAR_NATS {
        return Ok(true);
    }
    let (force, torque) = few.disturbance.sizes();
    let large = |force: f64, torque: f64| {
        force > CLEAR_TIMES * LARGE_FORCE_M_S2 || torque > CLEAR_TIMES * LARGE_TORQUE_RAD_S2
    };
    // The sizes alone are cheap, what two instruments agree on is not.
    let torque = if forces_only(logs) { 0.0 } else { torque };
    Ok(large(force, torque) && {
        let left = left(logs, model, &few);
        let agreed = |size: f64, agreed: Option<f64>| agreed.map_or(size, |agreed| agreed.min(size));
        large(agreed(force, left.force_agreed_m_s2), agreed(torque, left.torque_agreed_rad_s2))
    })
}

/// What a solution leaves.
fn left(logs: &[Prepared], model: &Model, solution: &Solution) -> Remainder {
    let left = samples(logs, model, solution, &solution.disturbance, &solution.deltas);
    remainder(logs, model, solution, &left).0
}
