//! Moment of blades that flap in a flow across the axis: τᵢ = Ωᵢ (K vᵢ) × aᵢ, which lifts the side that the flow meets.
//! K is k along body x and z, and k with a lateral extra along body y.
//!
//! The blade that runs against the flow lifts more and rises a quarter turn later, in front; stiff blades hand that
//! tilt to the hub as a moment. A frame in the rotors' wake makes the moment unequal along and across it. Its force, a
//! thrust that leans back, has the form of [`super::rotor_drag`].
//! Source: Mahony, Kumar & Corke, "Multirotor aerial vehicles: modeling, estimation, and control of quadrotor", IEEE
//! Robotics & Automation Magazine 19(3), 2012; Hoffmann, Huang, Waslander & Tomlin, "Quadrotor helicopter flight dynamics
//! and control: theory and experiment", AIAA GNC 2007.

use super::{Effect, View};
use crate::drone::Drone;
use crate::effects::candidate::{Area, Candidate, Freedom, Nature, Scale};
use crate::params::parameters;
use crate::rigid_body::Wrench;
use crate::surroundings::Reads;
use propwash_trace::Real;
use propwash_trace::math::vec3;

parameters! {
    /// Parameters of blade flapping.
    pub struct Params {
        /// Moment of one rotor per rotor speed and flow across its axis, N·s²/rad; positive numbers lift the side that
        /// the flow meets.
        moment_n_s2_per_rad: S,
        /// What is added to it for flow along body y, N·s²/rad.
        lateral_extra_n_s2_per_rad: S,
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { moment_n_s2_per_rad: 0.0, lateral_extra_n_s2_per_rad: 0.0 }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    fn nature(&self) -> Nature {
        Nature { torques_only: true, ..Nature::default() }
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
            let [x, y, z] = vec3::scale(across, self.moment_n_s2_per_rad);
            let lateral = y + self.lateral_extra_n_s2_per_rad * across[1];
            let moment = vec3::cross([x, lateral, z], view.airframe.rotors[i].axis);
            out.torque = vec3::add(out.torque, vec3::scale(moment, speeds[i]));
        }
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(drone: &Drone<f64>) -> Vec<Candidate> {
    // 5 % of weight times rotor radius per m/s. A stiff rotor whose tips run at 50 m/s has 2 %; a Crazyflie Brushless has 6 % along
    // body y and 8 % along body x (docs/effects/blade_flapping.md). On a careful vehicle 0.02 % are within tolerance.
    let scale = Scale::of(drone);
    let unit = scale.weight_n * scale.radius_m / scale.speed_sum_rad_s;
    let freedom = |name: &str| Freedom::any(name, "N·s²/rad", 0.0002 * unit, 0.05 * unit);
    vec![Candidate::new(
        "blade_flapping",
        "moment of blades that flap in a flow from the side",
        Area::Airframe,
        vec![freedom("moment_n_s2_per_rad"), freedom("lateral_extra_n_s2_per_rad")],
        "fly level legs forward, backward and sideways, fast and slow",
    )]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{AnyEffect, Command};
    use crate::rigid_body::State;
    use crate::sample::quad;
    use crate::surroundings::Surroundings;

    #[test]
    fn a_flow_from_ahead_lifts_the_nose_and_one_from_the_left_lifts_the_left_side() {
        let drone =
            quad(vec![AnyEffect::BladeFlapping(Params { moment_n_s2_per_rad: 1e-6, ..Params::default() })]);
        let turn = |vel: [f64; 3], wind_m_s: [f64; 3]| {
            let mut state = State { vel, ..State::rest() };
            state.rotor_vel[..4].fill(500.0);
            let around = Surroundings { wind_m_s, ..Surroundings::calm() };
            let rate = drone.rate(&state, &Command::Rotors([500.0; 8]), &around);
            assert!(rate.acc[0].abs() < 1e-12 && rate.acc[1].abs() < 1e-12, "a moment without a force");
            rate.ang_acc
        };
        let size = 4.0 * 1e-6 * 500.0 * 3.0 / 0.01;
        // About +y the nose goes down, about +x the left side goes up.
        let ahead = turn([3.0, 0.0, 2.0], [0.0; 3]);
        assert!((ahead[1] + size).abs() < 1e-12 && ahead[0].abs() < 1e-12, "{ahead:?}");
        let left = turn([0.0; 3], [0.0, -3.0, 0.0]);
        assert!((left[0] - size).abs() < 1e-12 && left[1].abs() < 1e-12, "{left:?}");
    }

    #[test]
    fn what_is_extra_across_the_body_acts_there_alone() {
        let turn = |lateral_extra_n_s2_per_rad: f64| {
            let flapping = Params { moment_n_s2_per_rad: 1e-6, lateral_extra_n_s2_per_rad };
            let drone = quad(vec![AnyEffect::BladeFlapping(flapping)]);
            let mut state = State { vel: [3.0, 3.0, 0.0], ..State::rest() };
            state.rotor_vel[..4].fill(500.0);
            drone.rate(&state, &Command::Rotors([500.0; 8]), &Surroundings::calm()).ang_acc
        };
        let (equal, unequal) = (turn(0.0), turn(-4e-7));
        assert!((unequal[0] - 0.6 * equal[0]).abs() < 1e-12 * equal[0].abs(), "{equal:?} {unequal:?}");
        assert!(unequal[1].to_bits() == equal[1].to_bits(), "{equal:?} {unequal:?}");
    }

    #[test]
    fn the_abstracted_model_flaps_at_the_speed_of_its_thrust() {
        use crate::attitude_response;
        use crate::drone::Dynamics;
        let mut drone =
            quad(vec![AnyEffect::BladeFlapping(Params { moment_n_s2_per_rad: 1e-6, ..Params::default() })]);
        drone.dynamics = Dynamics::AttitudeResponse(attitude_response::Params {
            thrust_offset_n: 0.0,
            thrust_scale: 1.0,
            thrust_rate_per_s: 0.0,
            angle_gain_per_s2: [0.0; 3],
            rate_gain_per_s: [0.0; 3],
            command_gain_per_s2: [0.0; 3],
            thrust_dynamics: false,
        });
        // The rotor speeds of the state are not those of this model and must not count.
        let state = State { vel: [3.0, 0.0, 0.0], rotor_vel: [7.0; 8], ..State::rest() };
        // 10 N over four rotors of 1e-5 N·s²/rad²: 500 rad/s.
        let rate = drone.rate(&state, &Command::Attitude([0.0, 0.0, 0.0, 10.0]), &Surroundings::calm());
        assert!((rate.ang_acc[1] + 4.0 * 1e-6 * 500.0 * 3.0 / 0.01).abs() < 1e-12, "{:?}", rate.ang_acc);
    }
}
