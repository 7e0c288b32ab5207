//! Rotors with more or less inertia than filed: Jᵢ = s Jᵢ,filed, in the gyroscopic torque and in the reaction to spinning up.
//!
//! Source: Bouabdallah, "Design and control of quadrotors with application to autonomous flying", EPFL 2007, ch. 2.

use super::{Effect, Parts};
use crate::drone::Drone;
use crate::effects::candidate::{Answer, Area, Bounds, Candidate, Filed, Freedom, Group, Nature};
use crate::params::parameters;
use propwash_trace::Real;

parameters! {
    /// Parameters of the rotors' inertia.
    pub struct Params {
        /// Inertia of every rotor about its axis over the filed one, s.
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
        Nature { torques_only: true, group: Some(Group::Inertia), ..Nature::default() }
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
            let inertia = &mut parts.airframe.rotors[i].inertia_kg_m2;
            *inertia = *inertia * self.factor;
        }
    }
}

/// What a search for missing physics may free; see [`Candidate`]. None for a vehicle whose rotors are filed without
/// inertia: no factor changes that.
pub fn candidates(drone: &Drone<f64>) -> Vec<Candidate> {
    if drone.airframe.rotors[..drone.airframe.n_rotors].iter().all(|r| r.inertia_kg_m2 == 0.0) {
        return Vec::new();
    }
    vec![
        Candidate::new(
            "rotor_inertia",
            "rotors with more or less inertia than filed",
            Area::Mass,
            vec![Freedom::any("factor", "1", 0.1, 1.5).scaling(Filed::RotorInertia)],
            "yaw in sharp steps, and roll and pitch quickly while yawing",
        )
        .answering(Answer::RotorAcceleration),
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
    fn reaction_and_gyroscopic_torque_grow_with_the_inertia() {
        let drone = quad(vec![AnyEffect::RotorInertia(Params { factor: 3.0 })]);
        let mut state = State { ang_vel: [2.0, 0.0, 0.0], ..State::rest() };
        // Rotors 0 and 2 turn one way (spin −1), 1 and 3 the other: 100 rad/s more of the second.
        state.rotor_vel[..4].copy_from_slice(&[480.0, 530.0, 480.0, 530.0]);
        let sped = Command::Rotors([480.0, 540.0, 480.0, 540.0, 0.0, 0.0, 0.0, 0.0]);
        let kept = Command::Rotors(state.rotor_vel);
        let calm = Surroundings::calm();
        let turn = |command: &Command<f64>| drone.rate(&state, command, &calm).ang_acc;
        // Two rotors speed up by 20 1/s · 10 rad/s; the body turns the way that clockwise rotors push it.
        let reaction = 2.0 * 3.0 * 1e-5 * 20.0 * 10.0;
        assert!((turn(&sped)[2] - turn(&kept)[2] - reaction / 0.018).abs() < 1e-9);
        // −ω × h with h = −3e-5 · 100 along z and ω = 2 along x: ω × z is −y.
        let gyroscopic = -2.0 * 3.0 * 1e-5 * 100.0;
        assert!((turn(&kept)[1] - gyroscopic / 0.01).abs() < 1e-9, "{:?}", turn(&kept));
    }

    #[test]
    fn rotors_without_filed_inertia_are_no_candidate() {
        let mut drone = quad(vec![]);
        assert_eq!(candidates(&drone).len(), 1);
        drone.airframe.rotors.iter_mut().for_each(|r| r.inertia_kg_m2 = 0.0);
        assert!(candidates(&drone).is_empty());
    }
}
