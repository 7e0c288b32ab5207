//! Whether any effect is missing, by the first steps of a diagnosis: reported by `compare` beside the size of the errors.
//!
//! A vehicle whose parameters are off within their tolerances departs from every log by many times the sensors' noise,
//! though no effect is missing. The search of a diagnosis, on fewer windows and without its later steps, distinguishes the
//! two.

use super::GapError;
use super::decide::remainder::{remainder, samples};
use super::fit::Prepared;
use super::model::Model;
use super::replay::Inputs;
use super::solve::{Solution, glance};
use super::track::Track;
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
    let Some(solution) = glance(&logs, &mut model)? else { return Ok(None) };
    Ok(Some(solution.set.is_empty() && !unexplained(&logs, &model, &solution)))
}

fn unexplained(logs: &[Prepared], model: &Model, solution: &Solution) -> bool {
    let left = samples(logs, model, solution, &solution.disturbance, &solution.deltas);
    remainder(logs, model, solution, &left).0.unexplained
}
