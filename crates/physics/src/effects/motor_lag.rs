//! Motors that follow their command slower or faster than filed, up and down each for itself: Ω̇ = Ω̇_filed / s.
//!
//! The time constant is scaled, so the speed that a command ends in stays. Source: Förster, "System identification of the
//! Crazyflie 2.0 nano quadrocopter", ETH Zürich 2015, for the size and the difference of the two time constants.

use super::{Effect, Parts};
use crate::drone::Drone;
use crate::effects::candidate::{Area, Bounds, Candidate, Filed, Freedom, Needs};
use crate::params::parameters;
use propwash_trace::Real;

parameters! {
    /// Parameters of the lag.
    pub struct Params {
        /// Time that rotors take to spin up over the filed time.
        spin_up_factor: S,
        /// Time that rotors take to spin down over the filed time.
        spin_down_factor: S,
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { spin_up_factor: 1.0, spin_down_factor: 1.0 }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    fn ranges(&self) -> &'static [(&'static str, Bounds)] {
        const { &[("spin_up_factor", Bounds::above(0.0)), ("spin_down_factor", Bounds::above(0.0))] }
    }

    fn builds(&self) -> bool {
        true
    }

    #[inline(always)]
    fn build(&self, parts: &mut Parts<S>) {
        for i in 0..parts.airframe.n_rotors {
            let rotor = &mut parts.airframe.rotors[i];
            for k in 0..2 {
                rotor.spin_up[k] = rotor.spin_up[k] / self.spin_up_factor;
                rotor.spin_down[k] = rotor.spin_down[k] / self.spin_down_factor;
            }
        }
        // The abstracted model has one time constant for both.
        if let Some(p) = &mut parts.response {
            let mean = S::lit(0.5) * (self.spin_up_factor + self.spin_down_factor);
            p.thrust_rate_per_s = p.thrust_rate_per_s / mean;
        }
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(_: &Drone<f64>) -> Vec<Candidate> {
    let freedom = |name: &str, of| Freedom::any(name, "1", 0.05, 0.4).dividing().scaling(of);
    vec![
        Candidate::new(
            "motor_lag",
            "motors slower or faster than filed",
            Area::Drive,
            vec![freedom("spin_up_factor", Filed::SpinUp), freedom("spin_down_factor", Filed::SpinDown)],
            "make sharp steps of thrust, roll and pitch, up and down",
        )
        .needing(Needs::Commands),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{AnyEffect, Command};
    use crate::integrate::Integrator;
    use crate::rigid_body::State;
    use crate::sample::quad;
    use crate::surroundings::Surroundings;

    #[test]
    fn a_step_reaches_two_thirds_after_the_scaled_time_constant() {
        let effect = Params { spin_up_factor: 1.5, spin_down_factor: 0.5 };
        let drone = quad(vec![AnyEffect::MotorLag(effect)]);
        // The sample's motors have time constants of 1/20 s up and 1/15 s down.
        for (from, to, time_constant) in [(400.0, 500.0, 1.5 / 20.0), (500.0, 400.0, 0.5 / 15.0)] {
            let mut state = State::rest();
            state.rotor_vel[..4].fill(from);
            let mut command = [0.0; 8];
            command[..4].fill(to);
            for _ in 0..100 {
                state = Integrator::Rk4.step(&state, time_constant / 100.0, |s| {
                    drone.rate(s, &Command::Rotors(command), &Surroundings::calm())
                });
            }
            let expected = to + (from - to) * (-1.0f64).exp();
            assert!((state.rotor_vel[0] - expected).abs() < 1e-6, "{} {expected}", state.rotor_vel[0]);
        }
    }
}
