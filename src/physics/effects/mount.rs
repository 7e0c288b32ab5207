//! Sensors mounted askew: marker body, gyroscope and accelerometer measure in a frame that is turned against the body.
//!
//! Source: misalignment between sensor and body frame, e.g. Titterton & Weston, "Strapdown inertial navigation technology",
//! 2nd ed., 2004, ch. 12.

use super::Effect;
use crate::math::quat;
use crate::physics::drone::Drone;
use crate::physics::effects::candidate::{Area, Candidate, along};
use crate::physics::measure::Reading;
use crate::physics::params::parameters;
use crate::scalar::Real;

parameters! {
    /// Parameters of the mount.
    pub struct Params {
        /// Rotation vector from the body frame to that of the sensors, rad, body.
        rotation_rad: [S; 3],
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { rotation_rad: [0.0; 3] }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    #[inline(always)]
    fn measure(&self, reading: &mut Reading<S>) {
        let turn = quat::exp(self.rotation_rad);
        reading.quat = quat::mul(reading.quat, turn);
        reading.gyro = quat::rotate_inverse(turn, reading.gyro);
        reading.accel = quat::rotate_inverse(turn, reading.accel);
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(_: &Drone<f64>) -> Vec<Candidate> {
    vec![Candidate::new(
        "mount",
        "sensors mounted askew on the body",
        Area::Measurement,
        along("rotation_rad", 0..3, "rad", (0.17f64.to_radians(), 1.7f64.to_radians())),
        "climb and sink hard, and fly level legs at several yaw angles",
    )]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{euler, quat, vec3};
    use crate::physics::effects::AnyEffect;
    use crate::physics::rigid_body::{Rate, State};
    use crate::physics::sample::quad;

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
        (quad(vec![AnyEffect::Mount(effect)]).read(&state, &rate), quad(vec![]).read(&state, &rate))
    }

    #[test]
    fn the_sensors_see_the_body_turned_and_agree_with_each_other() {
        let rotation_rad = [0.0, 0.0, core::f64::consts::FRAC_PI_2];
        let (with, without) = read(Params { rotation_rad });
        // Sensors turned to the left by 90°: what points ahead of the body points to their right.
        let seen = |a: [f64; 3]| [a[1], -a[0], a[2]];
        for i in 0..3 {
            assert!((with.gyro[i] - seen(without.gyro)[i]).abs() < 1e-12);
            assert!((with.accel[i] - seen(without.accel)[i]).abs() < 1e-12);
        }
        // In the world, attitude and gyroscope together say the same.
        let (a, b) = (quat::rotate(with.quat, with.gyro), quat::rotate(without.quat, without.gyro));
        assert!(vec3::norm(vec3::sub(a, b)) < 1e-12);
        assert_eq!((with.pos, with.vel), (without.pos, without.vel));
    }
}
