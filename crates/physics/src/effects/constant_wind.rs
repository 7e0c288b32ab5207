//! Wind that is the same everywhere and always.

use super::{Effect, View};
use crate::drone::Drone;
use crate::effects::candidate::{Area, Candidate, Nature, along};
use crate::params::parameters;
use propwash_trace::Real;

parameters! {
    /// Parameters of constant wind.
    pub struct Params {
        /// Velocity of the air, m/s, world.
        velocity_m_s: [S; 3],
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { velocity_m_s: [0.0; 3] }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    fn nature(&self) -> Nature {
        Nature { of_the_flight: true, differs_between_logs: true, only_when_found: true, ..Nature::default() }
    }

    #[inline(always)]
    fn air(&self, _: &View<S>) -> [S; 3] {
        self.velocity_m_s
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(_: &Drone<f64>) -> Vec<Candidate> {
    let mut freedoms = along("velocity_m_s", 0..2, "m/s", (0.02, 1.0));
    freedoms.extend(along("velocity_m_s", 2..3, "m/s", (0.02, 0.3)));
    vec![Candidate::new(
        "constant_wind",
        "steady wind",
        Area::Airframe,
        freedoms,
        "fly legs at several speeds in opposite directions, and hover at several yaw angles",
    )]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{AnyEffect, Command, linear_drag};
    use crate::rigid_body::State;
    use crate::sample::quad;
    use crate::surroundings::Surroundings;

    #[test]
    fn wind_without_drag_moves_nothing_and_adds_to_the_wind_of_the_surroundings() {
        let effect = Params { velocity_m_s: [3.0, 0.0, 0.0] };
        let drone = quad(vec![AnyEffect::ConstantWind(effect)]);
        let still = drone.rate(&State::rest(), &Command::Rotors([0.0; 8]), &Surroundings::calm());
        assert_eq!(still.acc, [0.0, 0.0, -9.81]);
        let drag = linear_drag::Params { drag_n_s_per_m: [[0.5, 0.0, 0.0], [0.0; 3], [0.0; 3]] };
        let drone = quad(vec![AnyEffect::LinearDrag(drag), AnyEffect::ConstantWind(effect)]);
        let gust = Surroundings { wind_m_s: [1.0, 0.0, 0.0], ..Surroundings::calm() };
        let rate = drone.rate(&State::rest(), &Command::Rotors([0.0; 8]), &gust);
        assert!((rate.acc[0] - 0.5 * 4.0).abs() < 1e-12);
    }
}
