//! Rotors whose axes lean: all of them together about body x and y, and each about its own arm.
//!
//! Leaning together they push sideways; twisted about their arms in the same sense they push round, which turns the
//! vehicle. Source: Rajappa, Ryll, Bülthoff & Franchi, "Modeling, control and design optimization for a fully-actuated
//! hexarotor aerial vehicle with tilted propellers", ICRA 2015 (there on purpose; here by fractions of a degree).

use super::{Effect, Parts};
use crate::drone::Drone;
use crate::effects::candidate::{Area, Candidate, Freedom, Group, Nature};
use crate::params::parameters;
use propwash_trace::Real;
use propwash_trace::math::{quat, vec3};

parameters! {
    /// Parameters of the tilt.
    pub struct Params {
        /// Turn of all axes about body x and y, rad.
        lean_rad: [S; 2],
        /// Turn of each axis about its arm, rad; positive numbers push the body counter-clockwise seen from above.
        twist_rad: S,
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { lean_rad: [0.0; 2], twist_rad: 0.0 }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    fn nature(&self) -> Nature {
        Nature {
            torques_only: true,
            group: Some(Group::Rotors),
            alike_by_thrust: &["mount", "mount.pose"],
            ..Nature::default()
        }
    }

    fn builds(&self) -> bool {
        true
    }

    #[inline(always)]
    fn build(&self, parts: &mut Parts<S>) {
        let zero = S::zero();
        let lean = quat::exp([self.lean_rad[0], self.lean_rad[1], zero]);
        for i in 0..parts.airframe.n_rotors {
            let rotor = &mut parts.airframe.rotors[i];
            let [x, y, _] = rotor.position_m;
            let arm = vec3::normalize_or([x, y, zero], [zero; 3]);
            let twist = quat::exp(vec3::scale(arm, -self.twist_rad));
            rotor.axis = quat::rotate(lean, quat::rotate(twist, rotor.axis));
        }
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(_: &Drone<f64>) -> Vec<Candidate> {
    let freedom = |name: &str| Freedom::any(name, "rad", 0.1f64.to_radians(), 1.5f64.to_radians());
    vec![Candidate::new(
        "rotor_tilt",
        "rotors whose axes lean",
        Area::Drive,
        ["lean_rad.0", "lean_rad.1", "twist_rad"].map(freedom).into(),
        "climb and sink hard at several yaw angles, so that thrust changes while the vehicle stays level",
    )]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{AnyEffect, Command};
    use crate::rigid_body::State;
    use crate::sample::quad;
    use crate::surroundings::Surroundings;

    fn rate(effect: Params<f64>) -> crate::rigid_body::Rate<f64> {
        let mut state = State::rest();
        state.rotor_vel[..4].fill(500.0);
        let drone = quad(vec![AnyEffect::RotorTilt(effect)]);
        drone.rate(&state, &Command::Rotors(state.rotor_vel), &Surroundings::calm())
    }

    #[test]
    fn leaning_axes_push_sideways_and_keep_the_size_of_the_thrust() {
        // About +y the thrust of 10 N leans ahead, about +x to the right.
        let (sin, cos) = 0.02f64.sin_cos();
        let ahead = rate(Params { lean_rad: [0.0, 0.02], twist_rad: 0.0 }).acc;
        assert!((ahead[0] - 10.0 * sin).abs() < 1e-12 && ahead[1].abs() < 1e-12, "{ahead:?}");
        assert!((ahead[2] + 9.81 - 10.0 * cos).abs() < 1e-12, "{ahead:?}");
        let right = rate(Params { lean_rad: [0.02, 0.0], twist_rad: 0.0 }).acc;
        assert!((right[1] + 10.0 * sin).abs() < 1e-12 && right[0].abs() < 1e-12, "{right:?}");
    }

    #[test]
    fn twisted_arms_turn_the_vehicle_without_pushing_it() {
        let turned = rate(Params { lean_rad: [0.0; 2], twist_rad: 0.02 });
        // 10 N at arms of √2 · 0.1 m.
        let torque = 10.0 * 0.02f64.sin() * 0.02f64.sqrt();
        assert!((turned.ang_acc[2] - torque / 0.018).abs() < 1e-9, "{:?}", turned.ang_acc);
        assert!(turned.acc[0].abs() < 1e-12 && turned.acc[1].abs() < 1e-12, "{:?}", turned.acc);
        assert!(turned.ang_acc[0].abs() < 1e-9 && turned.ang_acc[1].abs() < 1e-9);
    }
}
