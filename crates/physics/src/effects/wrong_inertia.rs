//! Inertia other than filed, axis by axis: J = D J_filed D with D = diag(√s).
//!
//! Moments about x, y, z become s times as large, products grow with the geometric mean, and the matrix stays symmetric
//! and positive definite. Source: Newton–Euler equations; the scatter of measured inertias: Förster, "System
//! identification of the Crazyflie 2.0 nano quadrocopter", ETH Zürich 2015.

use super::{Effect, Parts};
use crate::drone::Drone;
use crate::effects::candidate::{Answer, Area, Bounds, Candidate, Filed, Freedom, Group, Nature, Relative};
use crate::params::parameters;
use propwash_trace::Real;

parameters! {
    /// Parameters of the inertia.
    pub struct Params {
        /// Moments of inertia about x, y, z of the body over the filed ones, s.
        factor: [S; 3],
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { factor: [1.0; 3] }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    fn nature(&self) -> Nature {
        Nature {
            torques_only: true,
            relative: Some(Relative::Ratio),
            group: Some(Group::Inertia),
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
        let filed = parts.body.inertia_kg_m2;
        for i in 0..3 {
            for j in 0..3 {
                let scale = if i == j { self.factor[i] } else { (self.factor[i] * self.factor[j]).sqrt() };
                parts.body.inertia_kg_m2[i][j] = filed[i][j] * scale;
            }
        }
        parts.body.refresh();
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(_: &Drone<f64>) -> Vec<Candidate> {
    let axes = [
        ("x", "inertia about the forward axis other than filed", "roll to and fro quickly"),
        ("y", "inertia about the left axis other than filed", "pitch to and fro quickly"),
        ("z", "inertia about the upward axis other than filed", "yaw to and fro quickly"),
    ];
    let candidate = |(i, (axis, title, manoeuvre))| {
        let freedom =
            Freedom::any(format!("factor.{i}"), "1", 0.03, 0.2).dividing().scaling(Filed::Inertia(i));
        Candidate::new("wrong_inertia", title, Area::Mass, vec![freedom], manoeuvre)
            .part(axis)
            .answering(Answer::Torque(i))
    };
    axes.into_iter().enumerate().map(candidate).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drone::Drone;
    use crate::effects::{AnyEffect, Command};
    use crate::rigid_body::{self, State};
    use crate::sample::quad;
    use crate::surroundings::Surroundings;

    #[test]
    fn the_same_torque_turns_a_larger_inertia_less() {
        let effect = Params { factor: [1.25, 0.8, 2.0] };
        let drone = quad(vec![AnyEffect::WrongInertia(effect)]);
        let mut state = State::rest();
        state.rotor_vel[..4].copy_from_slice(&[480.0, 500.0, 530.0, 490.0]);
        let command = Command::Rotors(state.rotor_vel);
        let rate = drone.rate(&state, &command, &Surroundings::calm());
        let plain = quad(vec![]).rate(&state, &command, &Surroundings::calm());
        assert_eq!(rate.acc, plain.acc);
        for i in 0..3 {
            assert!(plain.ang_acc[i].abs() > 0.01);
            assert!((rate.ang_acc[i] * effect.factor[i] - plain.ang_acc[i]).abs() < 1e-9, "axis {i}");
        }
    }

    #[test]
    fn products_of_inertia_grow_with_the_geometric_mean() {
        let inertia = [[0.01, -0.002, 0.0], [-0.002, 0.012, 0.001], [0.0, 0.001, 0.018]];
        let body = rigid_body::Params::new(1.0, inertia, [0.0, 0.0, -9.81]);
        let effect = AnyEffect::WrongInertia(Params { factor: [4.0, 1.0, 2.25] });
        let parts = Drone { body, ..quad(vec![effect]) }.parts();
        let expected = [[0.04, -0.004, 0.0], [-0.004, 0.012, 0.0015], [0.0, 0.0015, 0.0405]];
        let inverse = propwash_trace::math::vec3::inverse(expected);
        for i in 0..3 {
            for j in 0..3 {
                assert!((parts.body.inertia_kg_m2[i][j] - expected[i][j]).abs() < 1e-15);
                assert!((parts.body.inertia_inverse[i][j] - inverse[i][j]).abs() < 1e-9);
            }
        }
    }
}
