//! Whether something is missing at all, by the first steps of a diagnosis: what `compare` says beside how far a model is off.
//!
//! A vehicle whose numbers are off within their tolerances departs from every log by many times the sensors' noise, and nothing is
//! missing. The search of a diagnosis, on fewer windows and without its later steps, tells one from the other.

use super::GapError;
use super::decide::remainder::{remainder, samples};
use super::fit::Prepared;
use super::model::Model;
use super::replay::drone_for;
use super::solve::{Solution, glance};
use super::track::Track;
use crate::vehicle::Vehicle;

/// Whether numbers within the vehicle's tolerances explain what it leaves on flights; none where too little of them can be used.
///
/// # Errors
/// [`GapError`] where the vehicle lacks the dynamics or a number is not finite.
pub(super) fn within_tolerance(tracks: &[Track], vehicle: &Vehicle) -> Result<Option<bool>, GapError> {
    let Some(first) = tracks.first() else { return Ok(None) };
    if tracks.iter().any(|t| t.dynamics != first.dynamics) {
        return Ok(None);
    }
    let drone = drone_for(first, vehicle)?;
    let logs: Vec<Prepared> = tracks.iter().map(|t| Prepared::new(t, &drone)).collect();
    let arounds: Vec<_> = logs.iter().map(|l| &l.around).collect();
    let mut model = Model::new(&drone, &tracks.iter().collect::<Vec<_>>(), &arounds)?;
    let Some(solution) = glance(&logs, &mut model)? else { return Ok(None) };
    Ok(Some(solution.set.is_empty() && !unexplained(&logs, &model, &solution)))
}

fn unexplained(logs: &[Prepared], model: &Model, solution: &Solution) -> bool {
    let left = samples(logs, model, solution, &solution.disturbance, &solution.deltas);
    remainder(logs, model, solution, &left).0.unexplained
}
