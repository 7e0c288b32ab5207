//! All rotors meet more or less aerodynamic torque than their filed curve: Q = s Q_filed.
//!
//! Source: the torque constant is the least certain one of a bench test, since it is small and hard to measure; Förster,
//! "System identification of the Crazyflie 2.0 nano quadrocopter", ETH Zürich 2015.

use super::{Effect, Parts};
use crate::drone::Drone;
use crate::effects::candidate::{Answer, Area, Bounds, Candidate, Filed, Freedom, Nature, Relative};
use crate::params::parameters;
use propwash_trace::Real;
use propwash_trace::math::vec3;

parameters! {
    /// Parameters of the scale.
    pub struct Params {
        /// Torque of every rotor over the filed one, s.
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
        Nature { torques_only: true, relative: Some(Relative::Ratio), ..Nature::default() }
    }

    fn ranges(&self) -> &'static [(&'static str, Bounds)] {
        const { &[("factor", Bounds::from(0.0))] }
    }

    fn builds(&self) -> bool {
        true
    }

    #[inline(always)]
    fn build(&self, parts: &mut Parts<S>) {
        for i in 0..parts.airframe.n_rotors {
            let curve = &mut parts.airframe.rotors[i].torque_curve;
            *curve = vec3::scale(*curve, self.factor);
        }
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(_: &Drone<f64>) -> Vec<Candidate> {
    vec![
        Candidate::new(
            "torque_scale",
            "all rotors meet more or less torque than filed",
            Area::Drive,
            vec![Freedom::any("factor", "1", 0.03, 0.3).scaling(Filed::Torque)],
            "yaw to and fro, slowly and quickly, at low and at high thrust",
        )
        .answering(Answer::Torque(2)),
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
    fn yaw_acceleration_is_scaled_and_thrust_is_not() {
        let drone = quad(vec![AnyEffect::TorqueScale(Params { factor: 1.3 })]);
        let mut state = State::rest();
        state.rotor_vel[..4].copy_from_slice(&[480.0, 500.0, 480.0, 500.0]);
        let rate = drone.rate(&state, &Command::Rotors(state.rotor_vel), &Surroundings::calm());
        let squares = 2.0 * (500.0f64.powi(2) - 480.0f64.powi(2));
        assert!((rate.ang_acc[2] - 1.3 * 1e-7 * squares / 0.018).abs() < 1e-9, "{:?}", rate.ang_acc);
        let thrust = 1e-5 * 2.0 * (480.0f64.powi(2) + 500.0f64.powi(2));
        assert!((rate.acc[2] + 9.81 - thrust).abs() < 1e-12);
    }
}
