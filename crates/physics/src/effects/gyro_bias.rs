//! A gyroscope that reads a constant rate while it stands still.
//!
//! Source: Woodman, "An introduction to inertial navigation", University of Cambridge UCAM-CL-TR-696, 2007.

use super::Effect;
use crate::drone::Drone;
use crate::effects::candidate::{Area, Candidate, Nature, Needs, along};
use crate::measure::Reading;
use crate::params::parameters;
use propwash_trace::Real;
use propwash_trace::math::vec3;

parameters! {
    /// Parameters of the bias.
    pub struct Params {
        /// What is read too much along x, y, z of the sensor, rad/s.
        bias_rad_s: [S; 3],
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { bias_rad_s: [0.0; 3] }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    fn nature(&self) -> Nature {
        Nature { differs_between_logs: true, ..Nature::default() }
    }

    #[inline(always)]
    fn measure(&self, reading: &mut Reading<S>) {
        reading.gyro = vec3::add(reading.gyro, self.bias_rad_s);
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(_: &Drone<f64>) -> Vec<Candidate> {
    vec![
        Candidate::new(
            "gyro_bias",
            "gyroscope that reads a rate while it stands still",
            Area::Measurement,
            along("bias_rad_s", 0..3, "rad/s", (0.005, 0.06)),
            "stand still or hover for some seconds, then fly anything",
        )
        .needing(Needs::Gyro),
    ]
}

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
        (quad(vec![AnyEffect::GyroBias(effect)]).read(&state, &rate), quad(vec![]).read(&state, &rate))
    }

    #[test]
    fn the_bias_is_added_to_this_sensor_alone() {
        let (with, without) = read(Params { bias_rad_s: [0.1, -0.2, 0.3] });
        for (i, bias) in [0.1, -0.2, 0.3].into_iter().enumerate() {
            assert!((with.gyro[i] - without.gyro[i] - bias).abs() < 1e-12);
        }
        assert_eq!(Reading { gyro: without.gyro, ..with }, without);
    }
}
