//! A gyroscope that reads too much or too little in proportion to the rate, axis by axis.
//!
//! Source: scale factors of inertial sensors, e.g. Tedaldi, Pretto & Menegatti, "A robust and easy to implement method for
//! IMU calibration without external equipments", ICRA 2014.

use super::Effect;
use crate::drone::Drone;
use crate::effects::candidate::{Area, Bounds, Candidate, Needs, along};
use crate::measure::Reading;
use crate::params::parameters;
use propwash_trace::Real;
use propwash_trace::math::vec3;

parameters! {
    /// Parameters of the scale.
    pub struct Params {
        /// What is read over the true rate about x, y, z of the sensor.
        factor: [S; 3],
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { factor: [1.0; 3] }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    fn ranges(&self) -> &'static [(&'static str, Bounds)] {
        const { &[("factor", Bounds::above(0.0))] }
    }

    #[inline(always)]
    fn measure(&self, reading: &mut Reading<S>) {
        reading.gyro = vec3::mul(reading.gyro, self.factor);
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(_: &Drone<f64>) -> Vec<Candidate> {
    vec![
        Candidate::new(
            "gyro_scale",
            "gyroscope that reads too much or too little in proportion to the rate",
            Area::Measurement,
            along("factor", 0..3, "1", (0.005, 0.05)),
            "roll, pitch and yaw far and quickly, about every axis",
        )
        .needing(Needs::Gyro)
        .at_most(MOST_SLABS),
    ]
}

/// Largest believable size, slabs: data sheets allow 3 % at most (MPU-6050, rev. 3.4, "sensitivity scale factor tolerance").
/// Attitudes of an estimator that follows slowly made scales of 0.83 and 1.12 in flights that turn at one frequency.
const MOST_SLABS: f64 = 2.0;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::AnyEffect;
    use crate::rigid_body::{Rate, State};
    use crate::sample::quad;
    use propwash_trace::math::euler;

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
        (quad(vec![AnyEffect::GyroScale(effect)]).read(&state, &rate), quad(vec![]).read(&state, &rate))
    }

    #[test]
    fn each_axis_reads_its_factor_times_the_rate() {
        let (with, without) = read(Params { factor: [1.1, 0.9, 1.05] });
        for (i, factor) in [1.1, 0.9, 1.05].into_iter().enumerate() {
            assert!((with.gyro[i] - factor * without.gyro[i]).abs() < 1e-12);
        }
        assert_eq!(Reading { gyro: without.gyro, ..with }, without);
    }
}
