//! An accelerometer that reads a constant acceleration too much.
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
        /// What is read too much along x, y, z of the sensor, m/s².
        bias_m_s2: [S; 3],
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { bias_m_s2: [0.0; 3] }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    fn nature(&self) -> Nature {
        Nature { differs_between_logs: true, ..Nature::default() }
    }

    #[inline(always)]
    fn measure(&self, reading: &mut Reading<S>) {
        reading.accel = vec3::add(reading.accel, self.bias_m_s2);
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(_: &Drone<f64>) -> Vec<Candidate> {
    vec![
        Candidate::new(
            "accel_bias",
            "accelerometer that reads a constant acceleration too much",
            Area::Measurement,
            along("bias_m_s2", 0..3, "m/s²", (0.05, 0.5)),
            "hover at several yaw angles, and roll and pitch far",
        )
        .needing(Needs::Accelerometer),
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
        (quad(vec![AnyEffect::AccelBias(effect)]).read(&state, &rate), quad(vec![]).read(&state, &rate))
    }

    #[test]
    fn the_bias_is_added_to_this_sensor_alone() {
        let (with, without) = read(Params { bias_m_s2: [0.1, -0.2, 0.3] });
        for (i, bias) in [0.1, -0.2, 0.3].into_iter().enumerate() {
            assert!((with.accel[i] - without.accel[i] - bias).abs() < 1e-12);
        }
        assert_eq!(Reading { accel: without.accel, ..with }, without);
    }
}
