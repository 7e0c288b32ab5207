//! Turbulence: a background that is estimated and reported, and replaces no finding.

use super::unlisted;
use crate::fit::{Prepared, forces_only};
use crate::model::Model;
use crate::opinion;
use crate::policy::{LARGE_FORCE_M_S2, MOST_DISPERSION, WEATHER_SHARE};
use crate::solve::Solution;
use crate::verdict::{Finding, FreeTerm, ParameterFit, Remainder};
use propwash_physics::drone;
use propwash_physics::effects::Area;
use propwash_physics::rigid_body::{MAX_ROTORS, State};
use propwash_physics::surroundings::Surroundings;

/// The verdict "turbulence": a force without pattern, spread over the flight, of the size that wind of up to 3 m/s causes
/// on this vehicle.
pub(super) fn turbulence(
    model: &Model,
    logs: &[Prepared],
    solution: &Solution,
    left: &Remainder,
    poor: bool,
) -> Option<Finding> {
    // Turbulence has no pattern, except through the pilot's reaction to it: all that there is in a quiet flight.
    let pattern = |t: &FreeTerm| t.on.starts_with("force") && t.explained_share > WEATHER_SHARE;
    // Nor does it leave more than disturbances and sensor noise explain. Quiet flights excite too little to tell; what is
    // named there is in doubt anyway.
    let scatter = if poor { solution.dispersion } else { solution.misfit };
    let misfit = scatter > MOST_DISPERSION;
    let patterned = left.terms.iter().any(pattern);
    let force_m_s2 = left.force_seen_m_s2();
    if misfit || (patterned && !poor) || force_m_s2 <= LARGE_FORCE_M_S2 {
        return None;
    }
    // Acceleration per 1 m/s of wind in hover; a poorly excited flight determines its drag less well than the file.
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
                // Windows within a second are correlated.
                sigma: value / (0.5 * n).sqrt(),
            }
        })
        .collect();
    // Turbulence is about as strong sideways as along, and no stronger vertically (Dryden: σ_w ≤ σ_u).
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
        each_log: false,
    })
}
