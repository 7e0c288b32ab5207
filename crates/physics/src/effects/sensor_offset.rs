//! A tracked point beside the centre of mass: p = x + R c, and its velocity v + R (ω × c).
//!
//! Source: kinematics of a rigid body, e.g. Goldstein, Poole & Safko, "Classical mechanics", § 4.9.

use super::Effect;
use crate::drone::Drone;
use crate::effects::candidate::{Area, Candidate, Nature, along};
use crate::measure::Reading;
use crate::params::parameters;
use propwash_trace::Real;
use propwash_trace::math::{quat, vec3};

parameters! {
    /// Parameters of the offset.
    pub struct Params {
        /// The tracked point c from the centre of mass, m, body.
        position_m: [S; 3],
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { position_m: [0.0; 3] }
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
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(_: &Drone<f64>) -> Vec<Candidate> {
    vec![Candidate::new(
        "sensor_offset",
        "tracked point that is not at the centre of mass",
        Area::Measurement,
        along("position_m", 0..3, "m", (0.001, 0.015)),
        "roll, pitch and yaw quickly in place, about every axis",
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
        (quad(vec![AnyEffect::SensorOffset(effect)]).read(&state, &rate), quad(vec![]).read(&state, &rate))
    }

    #[test]
    fn the_point_moves_with_the_body_and_its_velocity_is_the_derivative_of_its_place() {
        let position_m = [0.02, -0.01, 0.03];
        let (with, without) = read(Params { position_m });
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
}
