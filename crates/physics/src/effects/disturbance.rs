//! A constant force and torque, both given in the world frame.

use super::{Effect, View};
use crate::drone::Drone;
use crate::effects::candidate::{Candidate, Nature};
use crate::params::parameters;
use crate::rigid_body::Wrench;
use propwash_trace::Real;
use propwash_trace::math::{quat, vec3};

parameters! {
    /// Parameters of the disturbance.
    pub struct Params {
        /// Force at the centre of mass, N, world.
        force_n: [S; 3],
        /// Torque, N·m, world.
        torque_n_m: [S; 3],
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { force_n: [0.0; 3], torque_n_m: [0.0; 3] }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    fn nature(&self) -> Nature {
        Nature { of_the_flight: true, only_when_found: true, ..Nature::default() }
    }

    #[inline(always)]
    fn wrench(&self, view: &View<S>, out: &mut Wrench<S>) {
        out.force = vec3::add(out.force, self.force_n);
        out.torque = vec3::add(out.torque, quat::rotate_inverse(view.state.quat, self.torque_n_m));
    }
}

/// What a search for missing physics may free; see [`Candidate`]. None: a constant force of unknown cause is no explanation.
pub fn candidates(_: &Drone<f64>) -> Vec<Candidate> {
    Vec::new()
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
    fn force_and_torque_are_world_vectors() {
        let effect = Params { force_n: [1.0, 0.0, 0.0], torque_n_m: [0.0, 0.02, 0.0] };
        let drone = quad(vec![AnyEffect::Disturbance(effect)]);
        // Nose turned to the left: world y is body x.
        let quarter = core::f64::consts::FRAC_PI_2;
        let state = State { quat: euler::to_quat([0.0, 0.0, quarter]), ..State::rest() };
        let rate = drone.rate(&state, &Command::Rotors([0.0; 8]), &Surroundings::calm());
        assert!((rate.acc[0] - 1.0).abs() < 1e-12 && rate.acc[1].abs() < 1e-12);
        assert!((rate.ang_acc[0] - 2.0).abs() < 1e-12 && rate.ang_acc[1].abs() < 1e-12);
    }
}
