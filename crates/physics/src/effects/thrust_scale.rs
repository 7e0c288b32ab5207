//! All rotors give more or less thrust than their filed curve: T = s T_filed.
//!
//! Source: the thrust constant of a bench test differs from that in flight by propeller batch, air density and voltage;
//! Bangura & Mahony, "Nonlinear dynamic modeling for high performance control of a quadrotor", ACRA 2012.

use super::{Effect, Parts};
use crate::drone::Drone;
use crate::effects::candidate::{Area, Bounds, Candidate, Filed, Freedom, Nature, Relative};
use crate::params::parameters;
use propwash_trace::Real;
use propwash_trace::math::vec3;

parameters! {
    /// Parameters of the scale.
    pub struct Params {
        /// Thrust of every rotor over the filed one, s.
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
        for i in 0..parts.airframe.n_rotors {
            let curve = &mut parts.airframe.rotors[i].thrust_curve;
            *curve = vec3::scale(*curve, self.factor);
        }
        parts.thrust_factor = parts.thrust_factor * self.factor;
        if let Some(p) = &mut parts.response {
            p.thrust_offset_n = p.thrust_offset_n * self.factor;
            p.thrust_scale = p.thrust_scale * self.factor;
        }
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(_: &Drone<f64>) -> Vec<Candidate> {
    vec![Candidate::new(
        "thrust_scale",
        "all rotors give more or less thrust than filed",
        Area::Drive,
        vec![Freedom::any("factor", "1", 0.012, 0.12).scaling(Filed::Thrust)],
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
    fn thrust_is_scaled_and_torque_is_not() {
        let drone = quad(vec![AnyEffect::ThrustScale(Params { factor: 0.9 })]);
        // Rotors 1 and 3 turn clockwise: faster, they turn the body by their torque.
        let mut state = State::rest();
        state.rotor_vel[..4].copy_from_slice(&[480.0, 500.0, 480.0, 500.0]);
        let command = Command::Rotors(state.rotor_vel);
        let rate = drone.rate(&state, &command, &Surroundings::calm());
        let thrust = 1e-5 * 2.0 * (480.0f64.powi(2) + 500.0f64.powi(2));
        assert!((rate.acc[2] + 9.81 - 0.9 * thrust).abs() < 1e-12);
        let torque = 1e-7 * 2.0 * (500.0f64.powi(2) - 480.0f64.powi(2));
        assert!((rate.ang_acc[2] - torque / 0.018).abs() < 1e-9, "{:?}", rate.ang_acc);
        // It hovers at a higher speed.
        let hover = (9.81f64 / 4.0 / 0.9e-5).sqrt();
        assert!((drone.hover_rotor_vel()[0] - hover).abs() < 1e-9);
    }
}
