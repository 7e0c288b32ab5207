//! Sensors whose samples are stamped late: a sample stamped t was taken at t − delay, with a delay per sensor.
//!
//! Source: Furgale, Rehder & Siegwart, "Unified temporal and spatial calibration for multi-sensor systems", IROS 2013.

use super::Effect;
use crate::drone::Drone;
use crate::effects::candidate::{Area, Candidate, Freedom, Group, Nature, Needs, Relative};
use crate::measure::Clock;
use crate::params::parameters;
use propwash_trace::Real;

parameters! {
    /// Parameters of the clocks; negative numbers are stamps too early.
    pub struct Params {
        /// Delay of the motion capture (position, attitude, velocity), s.
        pose_s: S,
        /// Delay of the gyroscope, s.
        gyro_s: S,
        /// Delay of the accelerometer, s.
        accel_s: S,
        /// Delay of what drives the model where that was measured (rotor speeds, thrust; not commands), s.
        inputs_s: S,
    }
}

impl Default for Params<f64> {
    fn default() -> Self {
        Self { pose_s: 0.0, gyro_s: 0.0, accel_s: 0.0, inputs_s: 0.0 }
    }
}

impl<S: Real> Effect<S> for Params<S> {
    fn nature(&self) -> Nature {
        Nature {
            differs_between_logs: true,
            relative: Some(Relative::Time),
            group: Some(Group::Clocks),
            ..Nature::default()
        }
    }

    #[inline(always)]
    fn clock(&self) -> Clock<S> {
        Clock { pose_s: self.pose_s, gyro_s: self.gyro_s, accel_s: self.accel_s, inputs_s: self.inputs_s }
    }
}

/// What a search for missing physics may free; see [`Candidate`].
pub fn candidates(_: &Drone<f64>) -> Vec<Candidate> {
    let sensors = [
        ("pose", "pose_s", "motion capture whose clock is off", Needs::Nothing),
        ("gyro", "gyro_s", "gyroscope whose clock is off", Needs::Gyro),
        ("accel", "accel_s", "accelerometer whose clock is off", Needs::Accelerometer),
        ("inputs", "inputs_s", "rotor speeds or thrust whose clock is off", Needs::MeasuredInputs),
    ];
    let candidate = |(sensor, name, title, needs)| {
        let freedom = Freedom::any(name, "s", 0.0005, 0.012);
        let manoeuvre = "make sharp steps of roll, pitch, yaw and thrust";
        Candidate::new("clock_offset", title, Area::Measurement, vec![freedom], manoeuvre)
            .part(sensor)
            .needing(needs)
    };
    sensors.into_iter().map(candidate).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::AnyEffect;
    use crate::sample::quad;

    #[test]
    fn delays_reach_the_clocks_of_the_vehicle_and_add_up() {
        let first = Params { pose_s: 0.004, gyro_s: -0.002, accel_s: 0.001, inputs_s: 0.0 };
        let second = Params { pose_s: 0.001, gyro_s: 0.0, accel_s: 0.002, inputs_s: 0.001 };
        let clock = quad([first, second].map(AnyEffect::ClockOffset).to_vec()).clock();
        for (clock, expected) in
            [(clock, [0.005, -0.002, 0.003, 0.001]), (clock.from_inputs(), [0.004, -0.003, 0.002, 0.0])]
        {
            let got = [clock.pose_s, clock.gyro_s, clock.accel_s, clock.inputs_s];
            for (got, expected) in got.into_iter().zip(expected) {
                assert!((got - expected).abs() < 1e-15);
            }
        }
        assert_eq!(quad(vec![]).clock(), Clock::zero());
    }
}
