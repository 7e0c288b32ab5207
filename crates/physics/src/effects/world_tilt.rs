//! A motion capture whose world is tilted: positions, attitudes and velocities in a frame that leans against gravity.
//!
//! Source: levelling of the reference frame, e.g. Titterton & Weston, "Strapdown inertial navigation technology", 2nd ed.,
//! 2004, ch. 10.

use super::Effect;
use crate::drone::Drone;
use crate::effects::candidate::{Area, Candidate, Nature, along};
use crate::measure::Reading;
use crate::params::parameters;
use propwash_trace::Real;
use propwash_trace::math::quat;

parameters! {
    /// Parameters of the tilt.
    pub struct Params {
        /// Turn of everything that is seen, about x and y of the world, rad.
        tilt_rad: [S; 2],
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { tilt_rad: [0.0; 2] }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    fn nature(&self) -> Nature {
        Nature { differs_between_logs: true, ..Nature::default() }
    }

    #[inline(always)]
    fn measure(&self, reading: &mut Reading<S>) {
        let turn = quat::exp([self.tilt_rad[0], self.tilt_rad[1], S::zero()]);
        reading.pos = quat::rotate(turn, reading.pos);
        reading.vel = quat::rotate(turn, reading.vel);
        reading.quat = quat::mul(turn, reading.quat);
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(_: &Drone<f64>) -> Vec<Candidate> {
    vec![Candidate::new(
        "world_tilt",
        "motion capture whose world is not level",
        Area::Measurement,
        along("tilt_rad", 0..2, "rad", (0.05f64.to_radians(), 1.1f64.to_radians())),
        "hover and fly level legs at several yaw angles and several speeds",
    )]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::AnyEffect;
    use crate::rigid_body::{Rate, State};
    use crate::sample::quad;
    use propwash_trace::math::{euler, quat, vec3};

    /// (what the sensors of the moving sample vehicle read with the effect, without it)
    fn read(effect: Params<f64>) -> (Reading<f64>, Reading<f64>) {
        let state = State {
            pos: [1.0, 2.0, 3.0],
            quat: euler::to_quat([0.2, -0.3, 0.7]),
            vel: [2.0, -1.0, 0.5],
            ang_vel: [0.5, -0.4, 3.0],
            ..State::rest()
        };
        let rate = Rate { acc: [0.3, -0.2, 1.0], ..Rate::zero() };
        (quad(vec![AnyEffect::WorldTilt(effect)]).read(&state, &rate), quad(vec![]).read(&state, &rate))
    }

    #[test]
    fn what_is_seen_turns_about_the_origin_and_sensors_on_board_do_not_notice() {
        let tilt_rad = [core::f64::consts::FRAC_PI_2, 0.0];
        let (with, without) = read(Params { tilt_rad });
        // About x by 90°: y becomes z, z becomes −y.
        let seen = |a: [f64; 3]| [a[0], -a[2], a[1]];
        for i in 0..3 {
            assert!((with.pos[i] - seen(without.pos)[i]).abs() < 1e-12);
            assert!((with.vel[i] - seen(without.vel)[i]).abs() < 1e-12);
        }
        let ahead = [1.0, 0.0, 0.0];
        let (a, b) = (quat::rotate(with.quat, ahead), seen(quat::rotate(without.quat, ahead)));
        assert!(vec3::norm(vec3::sub(a, b)) < 1e-12);
        assert_eq!((with.gyro, with.accel), (without.gyro, without.accel));
    }
}
