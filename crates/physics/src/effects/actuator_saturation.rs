//! Motors that cannot turn faster than a limit: Ω_cmd ← min(Ω_cmd, Ω_max), whatever the controller asks for.
//!
//! Source: Faessler, Falanga & Scaramuzza, "Thrust mixing, saturation, and body-rate control for accurate aggressive
//! quadrotor flight", IEEE Robotics and Automation Letters 2(2), 2017.

use super::{Command, Effect, View};
use crate::drone::Drone;
use crate::effects::candidate::{Area, Bounds, Candidate, Freedom, FromLog, Nature, Needs, Scale};
use crate::params::parameters;
use crate::rotor;
use propwash_trace::Real;

/// Limit that stands for none, rad/s: far above any motor.
pub const NO_LIMIT_RAD_S: f64 = 1e6;

parameters! {
    /// Parameters of the saturation.
    pub struct Params {
        /// Highest rotor speed, rad/s.
        max_rotor_vel_rad_s: S,
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { max_rotor_vel_rad_s: NO_LIMIT_RAD_S }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    fn nature(&self) -> Nature {
        Nature { of_the_flight: true, only_when_found: true, ..Nature::default() }
    }

    fn ranges(&self) -> &'static [(&'static str, Bounds)] {
        const { &[("max_rotor_vel_rad_s", Bounds::above(0.0))] }
    }

    #[inline(always)]
    fn command(&self, view: &View<S>, _: S, command: &mut Command<S>, _: &mut [S]) {
        let limit = self.max_rotor_vel_rad_s;
        match command {
            Command::Rotors(speeds) => {
                for i in 0..view.airframe.n_rotors {
                    speeds[i] = speeds[i].min(limit);
                }
            }
            Command::Attitude(c) => {
                let mut most = S::zero();
                for i in 0..view.airframe.n_rotors {
                    most = most + rotor::curve(view.airframe.rotors[i].thrust_curve, limit);
                }
                c[3] = c[3].min(most);
            }
        }
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(drone: &Drone<f64>) -> Vec<Candidate> {
    // The filed limit is none, and up to the fastest command a limit does nothing: who tries this seeds the limit just below
    // the largest speeds of the data.
    let slab = 0.3 * Scale::of(drone).hover_rad_s;
    vec![
        Candidate::new(
            "actuator_saturation",
            "motors that cannot turn faster than a limit (tried from the largest speeds in the data down)",
            Area::Drive,
            vec![Freedom::down("max_rotor_vel_rad_s", "rad/s", 0.0, slab)],
            "climb as hard as possible, and roll and pitch at full thrust",
        )
        .needing(Needs::Commands)
        .given_by("max_rotor_vel_rad_s", FromLog::FastestCommand),
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
    fn speeds_above_the_limit_are_held_there_and_others_pass() {
        let drone = quad(vec![AnyEffect::ActuatorSaturation(Params { max_rotor_vel_rad_s: 600.0 })]);
        let send = |mut command: Command<f64>| {
            let calm = Surroundings::calm();
            drone.transmit(&State::rest(), &mut { calm }, (0.01, 0.01), &mut command, &mut []);
            command
        };
        let sent = send(Command::Rotors([599.0, 601.0, 0.0, 1e4, 700.0, 0.0, 0.0, 0.0]));
        assert_eq!(sent, Command::Rotors([599.0, 600.0, 0.0, 600.0, 700.0, 0.0, 0.0, 0.0]));
        // Four rotors of 1e-5 N·s²/rad² at 600 rad/s give 14.4 N; angles pass.
        let Command::Attitude(c) = send(Command::Attitude([0.1, 0.2, 0.3, 20.0])) else { panic!("attitude") };
        assert!((c[3] - 14.4).abs() < 1e-12 && c[..3] == [0.1, 0.2, 0.3]);
        assert_eq!(send(Command::Attitude([0.0, 0.0, 0.0, 14.0])), Command::Attitude([0.0, 0.0, 0.0, 14.0]));
    }
}
