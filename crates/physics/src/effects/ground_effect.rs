//! More thrust near the ground: gain = 1 / (1 − k (R / 4z)²) for a rotor of radius R at height z.
//!
//! Source: Cheeseman & Bennett, "The effect of the ground on a helicopter rotor in forward flight", ARC R&M 3021, 1955,
//! with the strength k of Danjun et al., "Autonomous landing of quadrotor based on ground effect modelling", CCC 2015.
//! The formula holds for z > R/2; below, z is held at R/2.

use super::{Effect, View};
use crate::drone::Drone;
use crate::effects::candidate::{Area, Bounds, Candidate, Freedom, Needs};
use crate::params::parameters;
use crate::surroundings::Reads;
use propwash_trace::Real;
use propwash_trace::math::quat;

parameters! {
    /// Parameters of ground effect.
    pub struct Params {
        /// Strength k, 1: single rotor of Cheeseman and Bennett; 0: none. A quadrotor as a whole shows more than 1.
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
        Reads::GROUND
    }

    #[inline(always)]
    fn thrust_gain(&self, view: &View<S>, hub_m: [S; 3]) -> S {
        let radius = view.airframe.rotors[0].radius_m;
        let height = view.surroundings.ground_distance_m + quat::rotate(view.state.quat, hub_m)[2];
        let ratio = radius / (S::lit(4.0) * height.max(S::lit(0.5) * radius));
        // Held below a gain of 4, which only strengths above 3 reach.
        S::one() / (S::one() - self.strength * ratio * ratio).max(S::lit(0.25))
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(_: &Drone<f64>) -> Vec<Candidate> {
    vec![
        Candidate::new(
            "ground_effect",
            "more thrust near the ground",
            Area::Airframe,
            vec![Freedom::up("strength", "1", 0.05, 1.0)],
            "hover and fly slowly at half, one and two rotor diameters above the ground, and high above it",
        )
        .needing(Needs::Ground),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{AnyEffect, Command};
    use crate::rigid_body::State;
    use crate::sample::quad;
    use crate::surroundings::Surroundings;

    #[test]
    fn thrust_grows_near_the_ground_as_cheeseman_and_bennett_say() {
        let drone = quad(vec![AnyEffect::GroundEffect(Params { strength: 1.0 })]);
        let lift = |height: f64| {
            let state = State { rotor_vel: drone.hover_rotor_vel(), ..State::rest() };
            let near = Surroundings { ground_distance_m: height, ..Surroundings::calm() };
            drone.rate(&state, &Command::Rotors([0.0; 8]), &near).acc[2] + 9.81
        };
        // One radius up: 1 / (1 − 1/16).
        assert!((lift(0.06) / 9.81 - 16.0 / 15.0).abs() < 1e-12);
        assert!((lift(1e6) / 9.81 - 1.0).abs() < 1e-12);
        assert!((lift(0.001) / 9.81 - 4.0 / 3.0).abs() < 1e-12, "held at half a radius");
    }
}
