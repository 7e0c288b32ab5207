//! Sensors mounted askew: marker body, gyroscope and accelerometer measure in a frame that is turned against the body.
//!
//! Source: misalignment between sensor and body frame, e.g. Titterton & Weston, "Strapdown inertial navigation technology",
//! 2nd ed., 2004, ch. 12.

use super::Effect;
use crate::drone::Drone;
use crate::effects::candidate::{Area, Candidate, along};
use crate::measure::Reading;
use crate::params::parameters;
use propwash_trace::Real;
use propwash_trace::math::quat;

parameters! {
    /// Parameters of the mount.
    pub struct Params {
        /// Rotation vector from the body frame to that of all sensors, rad, body.
        rotation_rad: [S; 3],
        /// Rotation vector of the marker body of motion capture alone, beside that of all, rad, body.
        pose_rotation_rad: [S; 3],
        /// Rotation vector of gyroscope and accelerometer alone, beside that of all, rad, body.
        imu_rotation_rad: [S; 3],
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { rotation_rad: [0.0; 3], pose_rotation_rad: [0.0; 3], imu_rotation_rad: [0.0; 3] }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    #[inline(always)]
    fn measure(&self, reading: &mut Reading<S>) {
        let turn = quat::exp(self.rotation_rad);
        reading.quat = quat::mul(quat::mul(reading.quat, turn), quat::exp(self.pose_rotation_rad));
        let imu = quat::mul(turn, quat::exp(self.imu_rotation_rad));
        reading.gyro = quat::rotate_inverse(imu, reading.gyro);
        reading.accel = quat::rotate_inverse(imu, reading.accel);
        reading.ang_acc = quat::rotate_inverse(imu, reading.ang_acc);
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(_: &Drone<f64>) -> Vec<Candidate> {
    let candidate = |name: &str, title| {
        let freedoms = along(name, 0..3, "rad", (0.17f64.to_radians(), 1.7f64.to_radians()));
        let manoeuvre = "climb and sink hard, and fly level legs at several yaw angles";
        Candidate::new("mount", title, Area::Measurement, freedoms, manoeuvre)
    };
    vec![
        candidate("rotation_rad", "sensors mounted askew on the body"),
        candidate("pose_rotation_rad", "motion capture's markers askew on the body").part("pose"),
        candidate("imu_rotation_rad", "gyroscope and accelerometer askew in the body").part("imu"),
    ]
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
        (quad(vec![AnyEffect::Mount(effect)]).read(&state, &rate), quad(vec![]).read(&state, &rate))
    }

    #[test]
    fn markers_and_inertial_sensors_turn_apart_and_together_as_all() {
        let turn = [0.1, -0.2, 0.3];
        let apart = Params { pose_rotation_rad: turn, imu_rotation_rad: turn, ..Params::default() };
        let ((a, none), (b, _)) = (read(apart), read(Params { rotation_rad: turn, ..Params::default() }));
        assert!((0..3).all(|i| (a.gyro[i] - b.gyro[i]).abs() + (a.accel[i] - b.accel[i]).abs() < 1e-12));
        assert!((0..4).all(|i| (a.quat[i] - b.quat[i]).abs() < 1e-12));
        let (markers, _) = read(Params { pose_rotation_rad: turn, ..Params::default() });
        assert_eq!((markers.gyro, markers.accel), (none.gyro, none.accel));
        assert!((markers.quat[0] - none.quat[0]).abs() > 1e-3);
        let (imu, _) = read(Params { imu_rotation_rad: turn, ..Params::default() });
        assert!(
            (imu.gyro[0] - none.gyro[0]).abs() > 1e-3
                && (0..4).all(|i| (imu.quat[i] - none.quat[i]).abs() < 1e-12)
        );
    }

    #[test]
    fn the_sensors_see_the_body_turned_and_agree_with_each_other() {
        let rotation_rad = [0.0, 0.0, core::f64::consts::FRAC_PI_2];
        let (with, without) = read(Params { rotation_rad, ..Params::default() });
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
