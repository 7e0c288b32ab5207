//! Force linear in the velocity relative to the air: F = −D v, with D in the body frame.

use super::{Effect, View};
use crate::drone::Drone;
use crate::effects::candidate::{Area, Candidate, Freedom};
use crate::params::parameters;
use crate::rigid_body::Wrench;
use crate::surroundings::Reads;
use propwash_trace::Real;
use propwash_trace::math::{quat, vec3};

parameters! {
    /// Parameters of linear drag.
    pub struct Params {
        /// Drag matrix D, N·s/m, body axes; positive entries brake.
        drag_n_s_per_m: [[S; 3]; 3],
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { drag_n_s_per_m: [[0.0; 3]; 3] }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    fn reads(&self) -> Reads {
        Reads::WIND
    }

    #[inline(always)]
    fn wrench(&self, view: &View<S>, out: &mut Wrench<S>) {
        let relative = vec3::sub(view.state.vel, view.surroundings.wind_m_s);
        let body = quat::rotate_inverse(view.state.quat, relative);
        let drag = vec3::mat_vec(self.drag_n_s_per_m, body);
        out.add_body_force([-drag[0], -drag[1], -drag[2]]);
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(drone: &Drone<f64>) -> Vec<Candidate> {
    // Small quadrotors: 0.25 to 0.45 1/s, divided by mass (measured flights; see docs/effects/linear_drag.md).
    let mass = drone.body.mass_kg;
    let freedom =
        |i: usize| Freedom::up(format!("drag_n_s_per_m.{i}.{i}"), "N·s/m", 0.03 * mass, 0.35 * mass);
    vec![Candidate::new(
        "linear_drag",
        "drag in proportion to speed",
        Area::Airframe,
        (0..3).map(freedom).collect(),
        "fly level legs at several speeds along every body axis",
    )]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{AnyEffect, Command, constant_wind};
    use crate::rigid_body::State;
    use crate::sample::quad;
    use crate::surroundings::Surroundings;

    #[test]
    fn drag_opposes_the_motion_through_the_air_and_not_over_ground() {
        let drag = Params { drag_n_s_per_m: [[0.3, 0.0, 0.0], [0.0, 0.4, 0.0], [0.0, 0.0, 0.5]] };
        let calm = force(AnyEffect::LinearDrag(drag), [2.0, 1.0, -1.0], &[]);
        assert!(
            (calm[0] + 0.6).abs() < 1e-12 && (calm[1] + 0.4).abs() < 1e-12 && (calm[2] - 0.5).abs() < 1e-12
        );
        let wind = AnyEffect::ConstantWind(constant_wind::Params { velocity_m_s: [2.0, 1.0, -1.0] });
        let drifting = force(AnyEffect::LinearDrag(drag), [2.0, 1.0, -1.0], &[wind]);
        assert!(drifting.iter().all(|f| f.abs() < 1e-12), "{drifting:?}");
    }

    /// Force of the effects beyond gravity on a vehicle without rotors turning, N.
    fn force(effect: AnyEffect<f64>, vel: [f64; 3], others: &[AnyEffect<f64>]) -> [f64; 3] {
        let drone = quad([vec![effect], others.to_vec()].concat());
        let state = State { vel, ..State::rest() };
        let rate = drone.rate(&state, &Command::Rotors([0.0; 8]), &Surroundings::calm());
        [rate.acc[0], rate.acc[1], rate.acc[2] + 9.81]
    }
}
