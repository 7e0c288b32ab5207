//! Each rotor gives its own share of the filed thrust: Tᵢ = sᵢ Tᵢ,filed. A chipped propeller has s below 1.
//!
//! Source: loss of effectiveness of an actuator, e.g. Zhang et al., "Development of advanced FDD and FTC techniques with
//! application to an unmanned quadrotor helicopter testbed", Journal of the Franklin Institute 350(9), 2013.

use super::{Effect, Parts};
use crate::drone::Drone;
use crate::effects::candidate::{Area, Bounds, Candidate, Freedom, Group, Nature};
use crate::params::parameters;
use crate::rigid_body::MAX_ROTORS;
use propwash_trace::Real;
use propwash_trace::math::vec3;

parameters! {
    /// Parameters of the rotors' shares.
    pub struct Params {
        /// Thrust of rotor i over the filed one, sᵢ; entries past the last rotor are unused.
        factor: [S; MAX_ROTORS],
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { factor: [1.0; MAX_ROTORS] }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    fn nature(&self) -> Nature {
        Nature {
            torques_only: true,
            group: Some(Group::Rotors),
            alike_by_thrust: &["thrust_scale"],
            ..Nature::default()
        }
    }

    fn ranges(&self) -> &'static [(&'static str, Bounds)] {
        const { &[("factor", Bounds::above(0.0))] }
    }

    fn builds(&self) -> bool {
        true
    }

    #[inline(always)]
    fn build(&self, parts: &mut Parts<S>) {
        let n_rotors = parts.airframe.n_rotors;
        let mut sum = S::zero();
        let mut moment = [S::zero(); 3];
        for i in 0..n_rotors {
            let rotor = &mut parts.airframe.rotors[i];
            rotor.thrust_curve = vec3::scale(rotor.thrust_curve, self.factor[i]);
            sum = sum + self.factor[i];
            let excess = self.factor[i] - S::one();
            moment = vec3::add(moment, vec3::scale(rotor.position_m, excess));
        }
        // Equal shares of the abstracted model's thrust become unequal ones: a mean factor, and another point of attack.
        let mean = sum / S::lit(n_rotors.max(1) as f64);
        parts.thrust_factor = parts.thrust_factor * mean;
        if let Some(p) = &mut parts.response {
            p.thrust_offset_n = p.thrust_offset_n * mean;
            p.thrust_scale = p.thrust_scale * mean;
            let some = S::zero().lt(sum);
            let shift = vec3::scale(moment, S::one() / S::select(some, sum, S::one()));
            parts.thrust_point_m = vec3::add(parts.thrust_point_m, shift);
        }
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(drone: &Drone<f64>) -> Vec<Candidate> {
    let candidate = |i: usize| {
        Candidate::new(
            "weak_rotor",
            &format!("rotor {} gives more or less thrust than filed", i + 1),
            Area::Drive,
            vec![Freedom::any(format!("factor.{i}"), "1", 0.007, 0.12)],
            "climb and sink hard, so that thrust changes while the vehicle stays level, and yaw quickly",
        )
        .part(i + 1)
    };
    (0..drone.airframe.n_rotors).map(candidate).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::attitude_response;
    use crate::drone::Dynamics;
    use crate::effects::{AnyEffect, Command};
    use crate::rigid_body::State;
    use crate::sample::quad;
    use crate::surroundings::Surroundings;

    #[test]
    fn a_weak_rotor_drops_its_own_corner() {
        let mut factor = [1.0; 8];
        factor[0] = 0.8;
        let drone = quad(vec![AnyEffect::WeakRotor(Params { factor })]);
        let mut state = State::rest();
        state.rotor_vel[..4].fill(500.0);
        let rate = drone.rate(&state, &Command::Rotors(state.rotor_vel), &Surroundings::calm());
        // Rotor 0 is ahead on the right and misses 0.2 · 2.5 N.
        assert!((rate.acc[2] + 9.81 - (10.0 - 0.5)).abs() < 1e-12);
        assert!((rate.ang_acc[0] - 0.1 * 0.5 / 0.01).abs() < 1e-9, "the right side drops: +x");
        assert!((rate.ang_acc[1] - 0.1 * 0.5 / 0.01).abs() < 1e-9, "the nose drops: +y");
        assert!(rate.ang_acc[2].abs() < 1e-12, "torque about the axis stays");
        // The abstracted model at the same thrust per rotor is pushed and turned alike.
        let mut abstracted = drone.clone();
        abstracted.dynamics = Dynamics::AttitudeResponse(attitude_response::Params {
            thrust_offset_n: 0.0,
            thrust_scale: 1.0,
            thrust_rate_per_s: 0.0,
            angle_gain_per_s2: [0.0; 3],
            rate_gain_per_s: [0.0; 3],
            command_gain_per_s2: [0.0; 3],
            thrust_dynamics: false,
        });
        let command = Command::Attitude([0.0, 0.0, 0.0, 10.0]);
        let same = abstracted.rate(&state, &command, &Surroundings::calm());
        assert!((same.acc[2] - rate.acc[2]).abs() < 1e-12);
        for i in 0..3 {
            assert!(
                (same.ang_acc[i] - rate.ang_acc[i]).abs() < 1e-9,
                "{:?} {:?}",
                same.ang_acc,
                rate.ang_acc
            );
        }
    }
}
