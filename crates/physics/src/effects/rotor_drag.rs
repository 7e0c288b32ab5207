//! Drag of every rotor in its own plane, in proportion to its speed and to the flow across its axis:
//! Fᵢ = −k Ωᵢ vᵢ,⊥ at the hub.
//!
//! Source: Martin & Salaün, "The true role of accelerometer feedback in quadrotor control", ICRA 2010; Kai, Allibert, Hua
//! & Hamel, "Nonlinear feedback control of quadrotors exploiting first-order drag effects", IFAC-PapersOnLine 50(1), 2017.

use super::{Effect, View, add_hub_force};
use crate::drone::Drone;
use crate::effects::candidate::{Area, Bounds, Candidate, Freedom, Nature, Scale};
use crate::params::parameters;
use crate::rigid_body::Wrench;
use crate::surroundings::Reads;
use propwash_trace::Real;
use propwash_trace::math::vec3;

parameters! {
    /// Parameters of rotor drag.
    pub struct Params {
        /// Force of one rotor per rotor speed and flow across its axis, N·s²/(rad·m); positive numbers brake.
        drag_n_s2_per_rad_m: S,
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { drag_n_s2_per_rad_m: 0.0 }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    fn nature(&self) -> Nature {
        Nature { alike_by_thrust: &["linear_drag"], by_mean_speed: true, ..Nature::default() }
    }

    fn ranges(&self) -> &'static [(&'static str, Bounds)] {
        const { &[("drag_n_s2_per_rad_m", Bounds::from(0.0))] }
    }

    fn reads(&self) -> Reads {
        Reads::WIND
    }

    #[inline(always)]
    fn wrench(&self, view: &View<S>, out: &mut Wrench<S>) {
        let speeds = view.rotor_vel();
        let air = view.air_velocity();
        for i in 0..view.airframe.n_rotors {
            let (_, across) = view.hub_velocity(i, air);
            add_hub_force(view, i, vec3::scale(across, -(self.drag_n_s2_per_rad_m * speeds[i])), out);
        }
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(drone: &Drone<f64>) -> Vec<Candidate> {
    // Measured quadrotors lose 0.2 to 0.5 1/s of their speed through the air in hover.
    let scale = Scale::of(drone);
    let slab = 0.3 * scale.mass_kg / scale.speed_sum_rad_s;
    vec![Candidate::new(
        "rotor_drag",
        "drag of the rotors, in proportion to their speed and to the flow from the side",
        Area::Airframe,
        vec![Freedom::up("drag_n_s2_per_rad_m", "N·s²/(rad·m)", 0.02 * slab, slab)],
        "fly level legs while climbing hard and while sinking, so that rotor speed changes at the same flow",
    )]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{AnyEffect, Command};
    use crate::rigid_body::{Rate, State};
    use crate::sample::quad;
    use crate::surroundings::Surroundings;

    /// What the effect adds to the rate of the sample vehicle.
    fn added(state: &State<f64>) -> Rate<f64> {
        let effect = Params { drag_n_s2_per_rad_m: 1e-4 };
        let command = Command::Rotors([0.0; 8]);
        let calm = Surroundings::calm();
        let plain = quad(vec![]).rate(state, &command, &calm);
        let mut rate = quad(vec![AnyEffect::RotorDrag(effect)]).rate(state, &command, &calm);
        rate.acc = vec3::sub(rate.acc, plain.acc);
        rate.ang_acc = vec3::sub(rate.ang_acc, plain.ang_acc);
        rate
    }

    #[test]
    fn drag_is_the_sum_of_rotor_speeds_times_the_flow_across_the_axes() {
        let mut state = State { vel: [2.0, -1.0, 5.0], ..State::rest() };
        state.rotor_vel[..4].copy_from_slice(&[100.0, 200.0, 300.0, 400.0]);
        let rate = added(&state);
        for (got, expected) in rate.acc.iter().zip([-1e-4 * 1000.0 * 2.0, 1e-4 * 1000.0, 0.0]) {
            assert!((got - expected).abs() < 1e-12, "{:?}", rate.acc);
        }
        // Rotors 0 and 1 are on the right (y = −0.1), 2 and 3 on the left and faster: the left side is held back more,
        // which turns the nose to the left; likewise fore and aft under the flow from the side.
        let yaw: f64 = [(0.1, -0.1, 100.0), (-0.1, -0.1, 200.0), (-0.1, 0.1, 300.0), (0.1, 0.1, 400.0)]
            .iter()
            .map(|(x, y, speed)| 1e-4 * speed * (x * 1.0 + y * 2.0))
            .sum();
        assert!((rate.ang_acc[2] - yaw / 0.018).abs() < 1e-9 && yaw > 0.0, "{:?} {yaw}", rate.ang_acc);
    }

    #[test]
    fn a_yawing_vehicle_is_braked_at_its_hubs() {
        let mut state = State { ang_vel: [0.0, 0.0, 4.0], ..State::rest() };
        state.rotor_vel[..4].fill(500.0);
        let rate = added(&state);
        // Four hubs at √2 · 0.1 m: torque −k Ω r² ω each.
        let torque = -4.0 * 1e-4 * 500.0 * 0.02 * 4.0;
        assert!((rate.ang_acc[2] - torque / 0.018).abs() < 1e-9);
        assert!(vec3::norm(rate.acc) < 1e-12);
    }
}
