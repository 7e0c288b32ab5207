//! A vehicle heavier or lighter than filed, with the filed inertia and centre of mass: m = s m_filed.
//!
//! Source: Newton–Euler equations, e.g. McKinnon & Schoellig, "Unscented external force and torque estimation for
//! quadrotors", IROS 2016, eq. 1–4.

use super::{Effect, Parts};
use crate::drone::Drone;
use crate::effects::candidate::{Area, Bounds, Candidate, Filed, Freedom, Nature, Relative};
use crate::params::parameters;
use propwash_trace::Real;

parameters! {
    /// Parameters of the mass.
    pub struct Params {
        /// Mass over the filed one, s.
        factor: S,
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { factor: 1.0 }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    fn nature(&self) -> Nature {
        Nature { scales_hover: true, relative: Some(Relative::Ratio), ..Nature::default() }
    }

    fn ranges(&self) -> &'static [(&'static str, Bounds)] {
        const { &[("factor", Bounds::above(0.0))] }
    }

    fn builds(&self) -> bool {
        true
    }

    #[inline(always)]
    fn build(&self, parts: &mut Parts<S>) {
        parts.body.mass_kg = parts.body.mass_kg * self.factor;
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(_: &Drone<f64>) -> Vec<Candidate> {
    vec![Candidate::new(
        "wrong_mass",
        "vehicle heavier or lighter than filed",
        Area::Mass,
        vec![Freedom::any("factor", "1", 0.005, 0.15).dividing().scaling(Filed::Mass)],
        "climb and sink hard, roll and pitch quickly, and drop for a moment with little thrust",
    )]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{AnyEffect, Command};
    use crate::rigid_body::State;
    use crate::sample::quad;
    use crate::surroundings::Surroundings;

    #[test]
    fn a_heavier_vehicle_accelerates_less_and_turns_alike() {
        let drone = quad(vec![AnyEffect::WrongMass(Params { factor: 1.25 })]);
        let mut state = State { ang_vel: [0.4, 0.2, -0.3], ..State::rest() };
        state.rotor_vel[..4].copy_from_slice(&[480.0, 500.0, 510.0, 490.0]);
        let command = Command::Rotors(state.rotor_vel);
        let rate = drone.rate(&state, &command, &Surroundings::calm());
        let plain = quad(vec![]).rate(&state, &command, &Surroundings::calm());
        assert!((rate.acc[2] + 9.81 - (plain.acc[2] + 9.81) / 1.25).abs() < 1e-12, "{:?}", rate.acc);
        assert_eq!(rate.ang_acc, plain.ang_acc);
        assert!((drone.hover_thrust() - 1.25 * 9.81).abs() < 1e-12);
        assert!((drone.hover_rotor_vel()[0] - (1.25f64 * 9.81 / 4.0 / 1e-5).sqrt()).abs() < 1e-9);
    }
}
