//! More thrust in a flow across the axis: ΔTᵢ = k |vᵢ,⊥|².
//!
//! In forward flight the disc works on more air in the same time, and the advancing blade gains more lift than the
//! retreating one loses; both grow with the square of the flow while it is small beside the speed of the blade tips.
//! Source: Leishman, "Principles of helicopter aerodynamics", ch. 3 (thrust of blade elements over the advance ratio);
//! Svacha, Mohta & Kumar, "Improving quadrotor trajectory tracking by compensating for aerodynamic effects", ICUAS 2017.

use super::{Effect, View, add_hub_force};
use crate::drone::Drone;
use crate::effects::candidate::{Area, Bounds, Candidate, Freedom, Scale};
use crate::params::parameters;
use crate::rigid_body::Wrench;
use crate::surroundings::Reads;
use propwash_trace::Real;
use propwash_trace::math::vec3;

parameters! {
    /// Parameters of translational lift.
    pub struct Params {
        /// Thrust that one rotor gains per squared flow across its axis, N·s²/m².
        lift_n_s2_per_m2: S,
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { lift_n_s2_per_m2: 0.0 }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    fn ranges(&self) -> &'static [(&'static str, Bounds)] {
        const { &[("lift_n_s2_per_m2", Bounds::from(0.0))] }
    }

    fn reads(&self) -> Reads {
        Reads::WIND
    }

    #[inline(always)]
    fn wrench(&self, view: &View<S>, out: &mut Wrench<S>) {
        let air = view.air_velocity();
        for i in 0..view.airframe.n_rotors {
            let (_, across) = view.hub_velocity(i, air);
            let thrust = self.lift_n_s2_per_m2 * vec3::dot(across, across);
            add_hub_force(view, i, vec3::scale(view.airframe.rotors[i].axis, thrust), out);
        }
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(drone: &Drone<f64>) -> Vec<Candidate> {
    // 1 % of the weight per (m/s)².
    let scale = Scale::of(drone);
    let slab = 0.01 * scale.weight_n / scale.n_rotors;
    vec![Candidate::new(
        "translational_lift",
        "more thrust in a flow from the side",
        Area::Airframe,
        vec![Freedom::up("lift_n_s2_per_m2", "N·s²/m²", 0.02 * slab, slab)],
        "fly level legs at several speeds and hover between them",
    )]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{AnyEffect, Command};
    use crate::rigid_body::{Rate, State};
    use crate::sample::quad;
    use crate::surroundings::Surroundings;

    fn rate(vel: [f64; 3], ang_vel: [f64; 3], wind_m_s: [f64; 3]) -> Rate<f64> {
        let drone = quad(vec![AnyEffect::TranslationalLift(Params { lift_n_s2_per_m2: 0.01 })]);
        let state = State { vel, ang_vel, rotor_vel: drone.hover_rotor_vel(), ..State::rest() };
        let around = Surroundings { wind_m_s, ..Surroundings::calm() };
        drone.rate(&state, &Command::Rotors(state.rotor_vel), &around)
    }

    #[test]
    fn lift_grows_with_the_square_of_the_flow_across_and_not_with_climb() {
        let acc = rate([3.0, 4.0, 7.0], [0.0; 3], [0.0; 3]).acc;
        assert!((acc[2] - 4.0 * 0.01 * 25.0).abs() < 1e-12 && acc[0].abs() < 1e-12, "{acc:?}");
        assert!(
            rate([3.0, 4.0, 0.0], [0.0; 3], [3.0, 4.0, 0.0]).acc[2].abs() < 1e-12,
            "drifting with the air"
        );
    }

    #[test]
    fn a_yawing_vehicle_rolls_since_one_side_meets_more_air() {
        // Flying ahead and turning left: hubs on the right (y = −0.1) are faster by 0.1 · ω.
        let ang_acc = rate([3.0, 0.0, 0.0], [0.0, 0.0, 5.0], [0.0; 3]).ang_acc;
        let gain = |y: f64, x: f64| 0.01 * ((3.0 - 5.0 * y).powi(2) + (5.0 * x).powi(2));
        let torque = 2.0 * (0.1 * gain(0.1, 0.1) - 0.1 * gain(-0.1, 0.1));
        assert!((ang_acc[0] - torque / 0.01).abs() < 1e-9 && torque < 0.0, "{ang_acc:?} {torque}");
    }
}
