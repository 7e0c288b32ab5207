//! Sensors beside the centre of mass: a tracked point p = x + R c with the velocity v + R (ω × c), and an accelerometer at r, which
//! reads α × r + ω × (ω × r) more.
//!
//! Source: kinematics of a rigid body, e.g. Goldstein, Poole & Safko, "Classical mechanics", § 4.9; of an accelerometer, e.g.
//! Titterton & Weston, "Strapdown inertial navigation technology", 2nd ed., 2004, § 12 ("size effect").

use super::Effect;
use crate::drone::Drone;
use crate::effects::candidate::{Area, Candidate, Freedom, Nature, Needs, along};
use crate::measure::Reading;
use crate::params::parameters;
use propwash_trace::Real;
use propwash_trace::math::{quat, vec3};

parameters! {
    /// Parameters of the offset.
    pub struct Params {
        /// The tracked point c from the centre of mass, m, body.
        position_m: [S; 3],
        /// The accelerometer r from the centre of mass, m, body.
        imu_position_m: [S; 3],
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { position_m: [0.0; 3], imu_position_m: [0.0; 3] }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    fn nature(&self) -> Nature {
        Nature { differs_between_logs: true, ..Nature::default() }
    }

    #[inline(always)]
    fn measure(&self, reading: &mut Reading<S>) {
        let spin = vec3::cross(reading.gyro, self.position_m);
        reading.pos = vec3::add(reading.pos, quat::rotate(reading.quat, self.position_m));
        reading.vel = vec3::add(reading.vel, quat::rotate(reading.quat, spin));
        let r = self.imu_position_m;
        let inward = vec3::cross(reading.gyro, vec3::cross(reading.gyro, r));
        reading.accel = vec3::add(reading.accel, vec3::add(vec3::cross(reading.ang_acc, r), inward));
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(drone: &Drone<f64>) -> Vec<Candidate> {
    let manoeuvre = "roll, pitch and yaw quickly in place, about every axis";
    let candidate =
        |title, freedoms| Candidate::new("sensor_offset", title, Area::Measurement, freedoms, manoeuvre);
    // Angular accelerations are known where torques are. Boards sit some millimetres from a centre of mass that few have measured.
    let imu =
        along("imu_position_m", 0..3, "m", (0.002, IMU_M)).into_iter().map(Freedom::in_torques).collect();
    let marker = along("position_m", 0..3, "m", (0.001, MARKER_M));
    // Larger vehicles carry both farther out.
    let most = |slab: f64| MOST_SLABS.max(MOST_ARM * drone.mean_arm_m() / slab);
    vec![
        candidate("tracked point that is not at the centre of mass", marker).at_most(most(MARKER_M)),
        candidate("accelerometer that is not at the centre of mass", imu)
            .part("imu")
            .needing(Needs::Accelerometer)
            .at_most(most(IMU_M)),
    ]
}

/// Plausible distance of a tracked point and of an accelerometer, m.
const MARKER_M: f64 = 0.015;
const IMU_M: f64 = 0.02;
/// Largest believable distance: plausible sizes, or this share of the rotors' mean arm. A load on a cable that nobody tracked looked like
/// a marker and an accelerometer an arm above the centre of mass.
const MOST_SLABS: f64 = 3.0;
const MOST_ARM: f64 = 0.4;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::AnyEffect;
    use crate::rigid_body::{Rate, State};
    use crate::sample::quad;
    use propwash_trace::math::{euler, quat, vec3};

    const ANG_ACC: [f64; 3] = [4.0, -7.0, 2.0];

    /// (what the sensors of the moving sample vehicle read with the effect, without it)
    fn read(effect: Params<f64>) -> (Reading<f64>, Reading<f64>) {
        let state = State {
            pos: [1.0, 2.0, 3.0],
            quat: euler::to_quat([0.2, -0.3, 0.7]),
            vel: [2.0, -1.0, 0.5],
            ang_vel: [0.5, -0.4, 3.0],
            ..State::rest()
        };
        let rate = Rate { acc: [0.3, -0.2, 1.0], ang_acc: ANG_ACC, ..Rate::zero() };
        (quad(vec![AnyEffect::SensorOffset(effect)]).read(&state, &rate), quad(vec![]).read(&state, &rate))
    }

    #[test]
    fn the_point_moves_with_the_body_and_its_velocity_is_the_derivative_of_its_place() {
        let position_m = [0.02, -0.01, 0.03];
        let (with, without) = read(Params { position_m, ..Params::default() });
        let place = |quat: [f64; 4]| vec3::add(without.pos, quat::rotate(quat, position_m));
        let (now, step) = (place(without.quat), 1e-6);
        let turned = |dt: f64| place(quat::mul(without.quat, quat::exp(vec3::scale(without.gyro, dt))));
        let (after, before) = (turned(step), turned(-step));
        for i in 0..3 {
            assert!((with.pos[i] - now[i]).abs() < 1e-12);
            let slope = without.vel[i] + (after[i] - before[i]) / (2.0 * step);
            assert!((with.vel[i] - slope).abs() < 1e-8, "{} {slope}", with.vel[i]);
            assert!((with.vel[i] - without.vel[i]).abs() > 1e-3);
        }
        assert_eq!((with.quat, with.gyro, with.accel), (without.quat, without.gyro, without.accel));
    }

    #[test]
    fn an_accelerometer_beside_the_centre_of_mass_reads_the_acceleration_of_its_place() {
        let r = [0.02, -0.01, 0.03];
        let (with, without) = read(Params { imu_position_m: r, ..Params::default() });
        // The place of the sensor from the centre of mass in the world, while the vehicle turns faster and faster: its second derivative,
        // seen from the body.
        let (gyro, step) = (without.gyro, 1e-4);
        let place = |dt: f64| {
            let mid: [f64; 3] = core::array::from_fn(|k| dt * gyro[k] + 0.5 * dt * dt * ANG_ACC[k]);
            quat::rotate(quat::exp(mid), r)
        };
        let (before, now, after) = (place(-step), place(0.0), place(step));
        for i in 0..3 {
            let bend = (after[i] - 2.0 * now[i] + before[i]) / (step * step);
            let more = with.accel[i] - without.accel[i];
            assert!((more - bend).abs() < 1e-5, "{more} {bend}");
            assert!(more.abs() > 0.01);
        }
        assert_eq!(
            (with.pos, with.vel, with.quat, with.gyro),
            (without.pos, without.vel, without.quat, without.gyro)
        );
    }
}
