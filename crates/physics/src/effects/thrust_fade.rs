//! Motors that turn slower with the time since the start, so that thrust falls as T = (1 − s t) T_commanded, as a battery that
//! runs down lets it.
//!
//! First term of the discharge over time; a flight at about constant power draws charge at a constant rate, and the
//! voltage of a lithium cell falls almost evenly over most of it. Source: Tremblay & Dessaint, "Experimental validation of
//! a battery dynamic model for EV applications", World Electric Vehicle Journal 3, 2009 (discharge curve).

use super::{Command, Effect, View};
use crate::drone::Drone;
use crate::effects::candidate::{Area, Bounds, Candidate, Freedom, Nature, Needs};
use crate::params::parameters;
use propwash_trace::Real;

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
    fn nature(&self) -> Nature {
        Nature { differs_between_logs: true, goes_with_charge: true, ..Nature::default() }
    }

    fn ranges(&self) -> &'static [(&'static str, Bounds)] {
        const { &[("rate_per_s", Bounds::from(0.0))] }
    }

    /// Thrust and torque go with the square of the speed. A rotor that has nothing left keeps a thousandth, so that the
    /// derivative stays finite.
    #[inline(always)]
    fn command(&self, view: &View<S>, _: S, command: &mut Command<S>, _: &mut [S]) {
        let share = (S::one() - self.rate_per_s * view.surroundings.time_s).max(S::lit(1e-6));
        match command {
            Command::Rotors(speeds) => {
                let ratio = share.sqrt();
                for i in 0..view.airframe.n_rotors {
                    speeds[i] = speeds[i] * ratio;
                }
            }
            Command::Attitude(c) => c[3] = c[3] * share,
        }
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(_: &Drone<f64>) -> Vec<Candidate> {
    vec![
        Candidate::new(
            "thrust_fade",
            "motors that turn slower with time, as the battery runs down",
            Area::Drive,
            vec![Freedom::up("rate_per_s", "1/s", 1e-5, 0.004)],
            "hover at the beginning and again at the end of a long flight",
        )
        .needing(Needs::Commands),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::AnyEffect;
    use crate::rigid_body::State;
    use crate::sample::quad;
    use crate::surroundings::Surroundings;

    #[test]
    fn speeds_fall_so_that_thrust_falls_evenly_with_time() {
        let drone = quad(vec![AnyEffect::ThrustFade(Params { rate_per_s: 0.002 })]);
        let state = State::rest();
        for (time_s, share) in [(0.0, 1.0), (50.0, 0.9), (100.0, 0.8), (1000.0, 1e-6)] {
            let mut around = Surroundings { time_s, ..Surroundings::calm() };
            let mut command = Command::Rotors([500.0; 8]);
            drone.transmit(&state, &mut around, (0.01, 0.01), &mut command, &mut []);
            let Command::Rotors(speeds) = command else { panic!("{command:?}") };
            for speed in &speeds[..4] {
                assert!((speed - 500.0 * f64::sqrt(share)).abs() < 1e-9, "{speed} at {time_s}");
            }
            let mut command = Command::Attitude([0.1, 0.2, 0.3, 5.0]);
            drone.transmit(&state, &mut around, (0.01, 0.01), &mut command, &mut []);
            let Command::Attitude(c) = command else { panic!("{command:?}") };
            assert!(c[..3] == [0.1, 0.2, 0.3] && (c[3] - 5.0 * share).abs() < 1e-12, "{c:?} at {time_s}");
        }
    }
}
