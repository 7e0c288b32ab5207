//! A centre of mass elsewhere than the vehicle file says: every lever arm is shorter by the offset, τ = τ_filed − c × F.
//!
//! The state is that of the true centre of mass, and the inertia is that about it. Source: Newton–Euler equations; Fresk,
//! Wuthier & Nikolakopoulos, "Generalized center of gravity compensation for multirotors with application to aerial
//! manipulation", IROS 2017.

use super::{Effect, Parts};
use crate::drone::Drone;
use crate::effects::candidate::{Area, Candidate, Nature, Scale, along};
use crate::params::parameters;
use propwash_trace::Real;

parameters! {
    /// Parameters of the offset.
    pub struct Params {
        /// The true centre of mass c, from the filed one, m, body.
        offset_m: [S; 3],
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { offset_m: [0.0; 3] }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    fn nature(&self) -> Nature {
        Nature { torques_only: true, ..Nature::default() }
    }

    fn builds(&self) -> bool {
        true
    }

    #[inline(always)]
    fn build(&self, parts: &mut Parts<S>) {
        parts.shift_com(self.offset_m);
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(drone: &Drone<f64>) -> Vec<Candidate> {
    let size = Scale::of(drone).size;
    let mut freedoms = along("offset_m", 0..2, "m", (0.0002 * size, 0.003 * size));
    freedoms.extend(along("offset_m", 2..3, "m", (0.0008 * size, 0.008 * size)));
    vec![Candidate::new(
        "com_offset",
        "centre of mass elsewhere than filed",
        Area::Mass,
        freedoms,
        "climb and sink hard, so that thrust changes while the vehicle stays level, and fly fast sideways",
    )]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{AnyEffect, Command, rotor_drag};
    use crate::rigid_body::State;
    use crate::sample::quad;
    use crate::surroundings::Surroundings;
    use propwash_trace::math::vec3;

    #[test]
    fn the_torque_of_the_rotors_changes_by_the_offset_times_their_force() {
        let offset_m = [0.003, -0.002, 0.01];
        let drag = AnyEffect::RotorDrag(rotor_drag::Params { drag_n_s2_per_rad_m: 1e-4 });
        let (filed, real) = (quad(vec![drag]), quad(vec![drag, AnyEffect::ComOffset(Params { offset_m })]));
        let mut state = State { vel: [4.0, 1.0, 0.0], ..State::rest() };
        state.rotor_vel[..4].copy_from_slice(&[450.0, 480.0, 510.0, 500.0]);
        let command = Command::Rotors(state.rotor_vel);
        let (a, b) = (
            filed.rate(&state, &command, &Surroundings::calm()),
            real.rate(&state, &command, &Surroundings::calm()),
        );
        assert_eq!(a.acc, b.acc);
        // Force of the rotors on 1 kg, level: acceleration less gravity. It leans back by the rotor drag.
        let force = [a.acc[0], a.acc[1], a.acc[2] + 9.81];
        let torque = vec3::cross(offset_m, force);
        for i in 0..3 {
            let change = (b.ang_acc[i] - a.ang_acc[i]) * [0.01, 0.01, 0.018][i];
            assert!((change + torque[i]).abs() < 1e-12, "axis {i}: {change} {torque:?}");
            assert!(torque[i].abs() > 1e-4);
        }
    }
}
