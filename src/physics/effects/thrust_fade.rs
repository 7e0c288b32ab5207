//! Thrust that falls with the time since the start: T = (1 − s t) T_filed, as a battery that runs down lets it.
//!
//! First term of the discharge over time; a flight at about constant power draws charge at a constant rate, and the
//! voltage of a lithium cell falls almost evenly over most of it. Source: Tremblay & Dessaint, "Experimental validation of
//! a battery dynamic model for EV applications", World Electric Vehicle Journal 3, 2009 (discharge curve).

use super::{Effect, View};
use crate::physics::drone::Drone;
use crate::physics::effects::candidate::{Area, Candidate, Freedom};
use crate::physics::params::parameters;
use crate::scalar::Real;

parameters! {
    /// Parameters of the fade.
    pub struct Params {
        /// Share s of the thrust that is lost per second, 1/s.
        rate_per_s: S,
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { rate_per_s: 0.0 }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    #[inline(always)]
    fn thrust_gain(&self, view: &View<S>, _: [S; 3]) -> S {
        (S::one() - self.rate_per_s * view.surroundings.time_s).max(S::zero())
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(_: &Drone<f64>) -> Vec<Candidate> {
    vec![Candidate::new(
        "thrust_fade",
        "thrust that falls with time, as the battery runs down",
        Area::Drive,
        vec![Freedom::up("rate_per_s", "1/s", 1e-5, 0.004)],
        "hover at the beginning and again at the end of a long flight",
    )]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::physics::effects::{AnyEffect, Command};
    use crate::physics::rigid_body::State;
    use crate::physics::sample::quad;
    use crate::physics::surroundings::Surroundings;

    #[test]
    fn thrust_falls_evenly_with_time_to_nothing_and_torque_stays() {
        let drone = quad(vec![AnyEffect::ThrustFade(Params { rate_per_s: 0.002 })]);
        let mut state = State::rest();
        state.rotor_vel[..4].copy_from_slice(&[480.0, 500.0, 480.0, 500.0]);
        let thrust = 1e-5 * 2.0 * (480.0f64.powi(2) + 500.0f64.powi(2));
        let at = |time_s: f64| {
            let around = Surroundings { time_s, ..Surroundings::calm() };
            drone.rate(&state, &Command::Rotors(state.rotor_vel), &around)
        };
        for (time_s, share) in [(0.0, 1.0), (50.0, 0.9), (100.0, 0.8), (1000.0, 0.0)] {
            let rate = at(time_s);
            assert!((rate.acc[2] + 9.81 - share * thrust).abs() < 1e-12, "{:?} at {time_s}", rate.acc);
            let yaw = 1e-7 * 2.0 * (500.0f64.powi(2) - 480.0f64.powi(2)) / 0.018;
            assert!((rate.ang_acc[2] - yaw).abs() < 1e-9, "{:?} at {time_s}", rate.ang_acc);
        }
    }
}
