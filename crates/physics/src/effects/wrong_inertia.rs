//! Inertia other than filed, axis by axis: J = D J_filed D with D = diag(√s), and principal axes that are askew: off its diagonal p √(J_ii J_jj)
//! more.
//!
//! Moments about x, y, z become s times as large, products grow with the geometric mean, and the matrix stays symmetric
//! and positive definite for all |p| < ½. Source: Newton–Euler equations; the scatter of measured inertias: Förster, "System
//! identification of the Crazyflie 2.0 nano quadrocopter", ETH Zürich 2015.

use super::{Effect, Parts};
use crate::drone::Drone;
use crate::effects::candidate::{
    Answer, Area, Bounds, Candidate, Filed, Freedom, Group, Nature, Relative, along,
};
use crate::params::parameters;
use propwash_trace::Real;

parameters! {
    /// Parameters of the inertia.
    pub struct Params {
        /// Moments of inertia about x, y, z of the body over the filed ones, s.
        factor: [S; 3],
        /// Entries xy, xz, yz of the inertia beyond those of the file, over the geometric mean of the moments about the two axes, p.
        product: [S; 3],
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { factor: [1.0; 3], product: [0.0; 3] }
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
        const { &[("factor", Bounds::above(0.0)), ("product", Bounds::within(-MOST_PRODUCT, MOST_PRODUCT))] }
    }

    fn builds(&self) -> bool {
        true
    }

    #[inline(always)]
    fn build(&self, parts: &mut Parts<S>) {
        let filed = parts.body.inertia_kg_m2;
        let own: [S; 3] = core::array::from_fn(|i| filed[i][i] * self.factor[i]);
        for i in 0..3 {
            parts.body.inertia_kg_m2[i][i] = own[i];
        }
        for (i, j, product) in [(0, 1, 0), (0, 2, 1), (1, 2, 2)] {
            let scale = (self.factor[i] * self.factor[j]).sqrt();
            let entry = filed[i][j] * scale + self.product[product] * (own[i] * own[j]).sqrt();
            (parts.body.inertia_kg_m2[i][j], parts.body.inertia_kg_m2[j][i]) = (entry, entry);
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
    let mut out: Vec<Candidate> = axes.into_iter().enumerate().map(candidate).collect();
    let askew = Candidate::new(
        "wrong_inertia",
        "principal axes of inertia that are not those of the file",
        Area::Mass,
        along("product", 0..3, "1", (0.01, 0.1)),
        "roll, pitch and yaw quickly, one after the other",
    );
    out.push(askew.part("products"));
    out
}

/// Largest share of a product: on a file without products of its own the matrix stays positive definite whatever the other two are. A
/// vehicle file whose effects leave no inertia is refused.
const MOST_PRODUCT: f64 = 0.49;

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
        let effect = Params { factor: [1.25, 0.8, 2.0], ..Params::default() };
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
    fn products_are_shares_of_the_geometric_mean_of_the_moments() {
        let effect = AnyEffect::WrongInertia(Params { factor: [4.0, 1.0, 1.0], product: [0.1, -0.2, 0.3] });
        let plain = quad(vec![]).parts().body.inertia_kg_m2;
        let j = quad(vec![effect]).parts().body.inertia_kg_m2;
        for (a, b, p) in [(0, 1, 0.1), (0, 2, -0.2), (1, 2, 0.3)] {
            let more = j[a][b] - plain[a][b] * (j[a][a] * j[b][b] / (plain[a][a] * plain[b][b])).sqrt();
            assert!((more / (j[a][a] * j[b][b]).sqrt() - p).abs() < 1e-12 && j[a][b] == j[b][a], "{j:?}");
        }
        // A torque about x turns about y and z too.
        let mut state = State::rest();
        state.rotor_vel[..4].copy_from_slice(&[480.0, 500.0, 530.0, 490.0]);
        let command = Command::Rotors(state.rotor_vel);
        let turned = quad(vec![effect]).rate(&state, &command, &Surroundings::calm()).ang_acc;
        let torque = propwash_trace::math::vec3::mat_vec(j, turned);
        let free = quad(vec![]).rate(&state, &command, &Surroundings::calm()).ang_acc;
        let expected = propwash_trace::math::vec3::mat_vec(plain, free);
        assert!((0..3).all(|k| (torque[k] - expected[k]).abs() < 1e-12), "{torque:?} {expected:?}");
    }

    #[test]
    fn products_of_inertia_grow_with_the_geometric_mean() {
        let inertia = [[0.01, -0.002, 0.0], [-0.002, 0.012, 0.001], [0.0, 0.001, 0.018]];
        let body = rigid_body::Params::new(1.0, inertia, [0.0, 0.0, -9.81]);
        let effect = AnyEffect::WrongInertia(Params { factor: [4.0, 1.0, 2.25], ..Params::default() });
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
