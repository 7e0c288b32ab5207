//! Less thrust the faster a rotor moves along its axis through the air: ΔTᵢ = −k Ωᵢ vᵢ,∥.
//!
//! Flow from ahead of the disc takes from the angle of attack of every blade; blade elements give a loss in proportion to
//! rotor speed and to that flow. Source: Leishman, "Principles of helicopter aerodynamics", ch. 3 (blade element theory);
//! Huang, Hoffmann, Waslander & Tomlin, "Aerodynamics and control of autonomous quadrotor helicopters in aggressive
//! maneuvering", ICRA 2009 (climb and descent).

use super::{Effect, View, add_hub_force};
use crate::drone::Drone;
use crate::effects::candidate::{Area, Bounds, Candidate, Freedom, Scale};
use crate::params::parameters;
use crate::rigid_body::Wrench;
use crate::surroundings::Reads;
use propwash_trace::Real;
use propwash_trace::math::vec3;

parameters! {
    /// Parameters of inflow.
    pub struct Params {
        /// Thrust that one rotor loses per rotor speed and velocity along its axis, N·s²/(rad·m).
        loss_n_s2_per_rad_m: S,
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { loss_n_s2_per_rad_m: 0.0 }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    fn ranges(&self) -> &'static [(&'static str, Bounds)] {
        const { &[("loss_n_s2_per_rad_m", Bounds::from(0.0))] }
    }

    fn reads(&self) -> Reads {
        Reads::WIND
    }

    #[inline(always)]
    fn wrench(&self, view: &View<S>, out: &mut Wrench<S>) {
        let speeds = view.rotor_vel();
        let air = view.air_velocity();
        for i in 0..view.airframe.n_rotors {
            let (along, _) = view.hub_velocity(i, air);
            let thrust = -(self.loss_n_s2_per_rad_m * speeds[i] * along);
            add_hub_force(view, i, vec3::scale(view.airframe.rotors[i].axis, thrust), out);
        }
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(drone: &Drone<f64>) -> Vec<Candidate> {
    // 6 % of the weight per m/s of climb.
    let scale = Scale::of(drone);
    let slab = 0.06 * scale.weight_n / scale.speed_sum_rad_s;
    vec![Candidate::new(
        "inflow",
        "less thrust the faster a rotor climbs through the air",
        Area::Airframe,
        vec![Freedom::up("loss_n_s2_per_rad_m", "N·s²/(rad·m)", 0.02 * slab, slab)],
        "climb and sink at several speeds, and roll and pitch quickly in place",
    )]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{AnyEffect, Command};
    use crate::rigid_body::{Rate, State};
    use crate::sample::quad;
    use crate::surroundings::Surroundings;

    fn rate(vel: [f64; 3], ang_vel: [f64; 3]) -> Rate<f64> {
        let drone = quad(vec![AnyEffect::Inflow(Params { loss_n_s2_per_rad_m: 1e-4 })]);
        let state = State { vel, ang_vel, rotor_vel: drone.hover_rotor_vel(), ..State::rest() };
        drone.rate(&state, &Command::Rotors(state.rotor_vel), &Surroundings::calm())
    }

    #[test]
    fn climbing_loses_thrust_and_sinking_gains_as_much() {
        let speed = (9.81f64 / 4.0 / 1e-5).sqrt();
        for climb in [2.0, -2.0] {
            let acc = rate([3.0, 0.0, climb], [0.0; 3]).acc;
            assert!((acc[2] + 4.0 * 1e-4 * speed * climb).abs() < 1e-12 && acc[0].abs() < 1e-12, "{acc:?}");
        }
    }

    #[test]
    fn a_rolling_vehicle_is_damped() {
        let speed = (9.81f64 / 4.0 / 1e-5).sqrt();
        let turning = rate([0.0; 3], [1.5, 0.0, 0.0]);
        // Hubs 0.1 m off the axis move at 0.15 m/s: torque −4 k Ω y² ω.
        let torque = -4.0 * 1e-4 * speed * 0.01 * 1.5;
        assert!((turning.ang_acc[0] - torque / 0.01).abs() < 1e-9, "{:?}", turning.ang_acc);
    }
}
