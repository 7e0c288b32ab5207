//! More thrust under a ceiling: gain = 1 / (1 − k (R / 4d)²) for a rotor of radius R at the distance d below it.
//!
//! Source: Sanchez-Cuevas, Heredia & Ollero, "Multirotor UAS for bridge inspection by contact using the ceiling effect",
//! ICUAS 2017: the form of the ground effect with fitted constants. Below d = R/2 the distance is held there.

use super::{Effect, View};
use crate::drone::Drone;
use crate::effects::candidate::{Area, Bounds, Candidate, Freedom, Needs};
use crate::params::parameters;
use crate::surroundings::Reads;
use propwash_trace::Real;
use propwash_trace::math::quat;

parameters! {
    /// Parameters of ceiling effect.
    pub struct Params {
        /// Strength k, 0: none. Rotors under a ceiling show more than they do over ground.
        strength: S,
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { strength: 0.0 }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    fn ranges(&self) -> &'static [(&'static str, Bounds)] {
        const { &[("strength", Bounds::from(0.0))] }
    }

    fn reads(&self) -> Reads {
        Reads::CEILING
    }

    #[inline(always)]
    fn thrust_gain(&self, view: &View<S>, hub_m: [S; 3]) -> S {
        let radius = view.airframe.rotors[0].radius_m;
        let distance = view.surroundings.ceiling_distance_m - quat::rotate(view.state.quat, hub_m)[2];
        let ratio = radius / (S::lit(4.0) * distance.max(S::lit(0.5) * radius));
        // Held below a gain of 4, which only strengths above 3 reach.
        S::one() / (S::one() - self.strength * ratio * ratio).max(S::lit(0.25))
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(_: &Drone<f64>) -> Vec<Candidate> {
    vec![
        Candidate::new(
            "ceiling_effect",
            "more thrust under a ceiling",
            Area::Airframe,
            vec![Freedom::up("strength", "1", 0.05, 1.0)],
            "hover and fly slowly at half, one and two rotor diameters below the ceiling, and far below it",
        )
        .needing(Needs::Ceiling),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{AnyEffect, Command};
    use crate::rigid_body::State;
    use crate::sample::quad;
    use crate::surroundings::Surroundings;
    use propwash_trace::math::euler;

    #[test]
    fn thrust_grows_under_the_ceiling_and_more_so_for_the_rotors_that_are_nearer() {
        let drone = quad(vec![AnyEffect::CeilingEffect(Params { strength: 1.0 })]);
        let lift = |distance: f64| {
            let state = State { rotor_vel: drone.hover_rotor_vel(), ..State::rest() };
            let near = Surroundings { ceiling_distance_m: distance, ..Surroundings::calm() };
            drone.rate(&state, &Command::Rotors([0.0; 8]), &near).acc[2] + 9.81
        };
        // One radius below: 1 / (1 − 1/16).
        assert!((lift(0.06) / 9.81 - 16.0 / 15.0).abs() < 1e-12);
        assert!((lift(1e6) / 9.81 - 1.0).abs() < 1e-12);
        assert!((lift(0.001) / 9.81 - 4.0 / 3.0).abs() < 1e-12, "held at half a radius");
        // Left side up: its rotors are 0.1 m · sin 0.3 nearer than the centre and lift more, about +x.
        let tilted = State {
            quat: euler::to_quat([0.3, 0.0, 0.0]),
            rotor_vel: drone.hover_rotor_vel(),
            ..State::rest()
        };
        let near = Surroundings { ceiling_distance_m: 0.1, ..Surroundings::calm() };
        let turn = drone.rate(&tilted, &Command::Rotors([0.0; 8]), &near).ang_acc[0];
        let gain = |side: f64| 1.0 / (1.0 - (0.06 / (4.0 * (0.1 - side * 0.1 * 0.3f64.sin()))).powi(2));
        let torque = 0.1 * 9.81 / 2.0 * (gain(1.0) - gain(-1.0));
        // Rotors that stand still as commanded react on the body only about z.
        assert!((turn - torque / 0.01).abs() < 1e-9 && torque > 0.0, "{turn} {torque}");
    }
}
