//! Force against the motion through the air that grows with its square: F = −C |v| v, with C along the body axes.
//!
//! Source: Hoerner, "Fluid-dynamic drag", 1965, ch. 3: a bluff body at high Reynolds number has c = ½ ρ c_d A.

use super::{Effect, View};
use crate::drone::Drone;
use crate::effects::candidate::{Area, Bounds, Candidate, Freedom};
use crate::params::parameters;
use crate::rigid_body::Wrench;
use crate::surroundings::Reads;
use propwash_trace::Real;
use propwash_trace::math::vec3;

parameters! {
    /// Parameters of quadratic drag.
    pub struct Params {
        /// Drag coefficients along x, y, z of the body, N·s²/m²; positive numbers brake.
        drag_n_s2_per_m2: [S; 3],
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { drag_n_s2_per_m2: [0.0; 3] }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    fn ranges(&self) -> &'static [(&'static str, Bounds)] {
        const { &[("drag_n_s2_per_m2", Bounds::from(0.0))] }
    }

    fn reads(&self) -> Reads {
        Reads::WIND
    }

    #[inline(always)]
    fn wrench(&self, view: &View<S>, out: &mut Wrench<S>) {
        let v = view.air_velocity();
        let drag = vec3::scale(vec3::mul(self.drag_n_s2_per_m2, v), -vec3::norm(v));
        out.add_body_force(drag);
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(drone: &Drone<f64>) -> Vec<Candidate> {
    // A bluff body of the size of a small quadrotor: ½ ρ c_d A over mass, 1/m.
    let mass = drone.parts().body.mass_kg;
    let freedom =
        |i: usize| Freedom::up(format!("drag_n_s2_per_m2.{i}"), "N·s²/m²", 0.004 * mass, 0.08 * mass);
    vec![Candidate::new(
        "quadratic_drag",
        "drag that grows with the square of speed",
        Area::Airframe,
        (0..3).map(freedom).collect(),
        "fly level and vertical legs, slow and as fast as possible, along every body axis",
    )]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{AnyEffect, Command};
    use crate::rigid_body::State;
    use crate::sample::quad;
    use crate::surroundings::Surroundings;
    use propwash_trace::dual::Dual;
    use propwash_trace::math::euler;

    /// Force on the vehicle of 1 kg with still rotors, N, world.
    fn force(state: &State<f64>, wind_m_s: [f64; 3]) -> [f64; 3] {
        let effect = Params { drag_n_s2_per_m2: [0.1, 0.2, 0.4] };
        let around = Surroundings { wind_m_s, ..Surroundings::calm() };
        let rate =
            quad(vec![AnyEffect::QuadraticDrag(effect)]).rate(state, &Command::Rotors([0.0; 8]), &around);
        assert_eq!(rate.ang_acc, [0.0; 3]);
        [rate.acc[0], rate.acc[1], rate.acc[2] + 9.81]
    }

    #[test]
    fn drag_is_the_coefficient_of_each_axis_times_speed_times_velocity() {
        // |v| = 3 with the wind taken off.
        let state = State { vel: [3.0, 2.0, -2.0], ..State::rest() };
        let f = force(&state, [2.0, 0.0, 0.0]);
        for (got, expected) in f.iter().zip([-0.1 * 3.0, -0.2 * 3.0 * 2.0, 0.4 * 3.0 * 2.0]) {
            assert!((got - expected).abs() < 1e-12, "{f:?}");
        }
    }

    #[test]
    fn the_axes_turn_with_the_body() {
        // Nose to the left: world x is the body's −y.
        let quat = euler::to_quat([0.0, 0.0, core::f64::consts::FRAC_PI_2]);
        let f = force(&State { quat, vel: [2.0, 0.0, 0.0], ..State::rest() }, [0.0; 3]);
        assert!((f[0] + 0.2 * 4.0).abs() < 1e-12 && f[1].abs() < 1e-12);
    }

    #[test]
    fn drag_and_its_slope_are_zero_at_rest() {
        let effect = Params { drag_n_s2_per_m2: [0.1, 0.2, 0.4] };
        type D = Dual<f64, 1>;
        let drone = quad(vec![AnyEffect::QuadraticDrag(effect)]).map(&mut D::lit);
        let mut state = State::<D>::rest();
        state.vel[0] = D::input(0.0, 0);
        let rate = drone.rate(&state, &Command::Rotors([D::lit(0.0); 8]), &Surroundings::calm());
        assert_eq!((rate.acc[0].value, rate.acc[0].partials[0]), (0.0, 0.0));
    }
}
