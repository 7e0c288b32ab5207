//! Accelerometer and gyroscope.

use crate::sense::sensor::{Moment, Sensor, SensorChannel};
use crate::sense::{Imu, ImuNoise, SenseError};

/// An inertial sensor at the centre of mass, with the noise of [`Imu`](crate::sense::Imu): white noise, a bias that starts with a draw
/// and walks, limits.
#[derive(Clone, Debug)]
pub struct InertialSensor {
    name: String,
    noise: ImuNoise,
}

impl InertialSensor {
    /// A sensor with these errors.
    ///
    /// # Errors
    /// [`SenseError::Parameter`] for a number that is negative or NaN.
    pub fn new(name: impl Into<String>, noise: ImuNoise) -> Result<Self, SenseError> {
        Imu::new(noise, 0, 0, 0)?;
        Ok(Self { name: name.into(), noise })
    }
}

impl Sensor for InertialSensor {
    fn name(&self) -> &str {
        &self.name
    }

    fn channels(&self) -> Vec<SensorChannel> {
        vec![
            SensorChannel::new("accelerometer", "m/s²", &[3]),
            SensorChannel::new("gyroscope", "rad/s", &[3]),
        ]
    }

    /// Biases of accelerometer and gyroscope.
    fn memory_len(&self) -> usize {
        6
    }

    fn sample(&self, at: &mut Moment, memory: &mut [f64], out: &mut [&mut [f32]]) -> Result<(), SenseError> {
        let (n, reading) = (&self.noise, at.reading());
        let (acc, gyro) = memory.split_at_mut(3);
        if at.first {
            (0..3).for_each(|k| acc[k] = n.accelerometer_bias_m_s2 * at.draw.normal());
            (0..3).for_each(|k| gyro[k] = n.gyroscope_bias_rad_s * at.draw.normal());
        }
        // White noise of a density is as large as the time over which the sensor averages is short: that between samples. A sample at
        // the reset itself has none before it, so it is taken at its bias.
        let root = at.since_s.max(0.0).sqrt();
        let white = if root > 0.0 { 1.0 / root } else { 0.0 };
        for k in 0..3 {
            acc[k] += n.accelerometer_walk_m_s2_sqrt_s * root * at.draw.normal();
            gyro[k] += n.gyroscope_walk_rad_s_sqrt_s * root * at.draw.normal();
            let a =
                reading.accel[k] + acc[k] + n.accelerometer_density_m_s2_sqrt_hz * white * at.draw.normal();
            let g = reading.gyro[k] + gyro[k] + n.gyroscope_density_rad_s_sqrt_hz * white * at.draw.normal();
            out[0][k] = a.clamp(-n.accelerometer_limit_m_s2, n.accelerometer_limit_m_s2) as f32;
            out[1][k] = g.clamp(-n.gyroscope_limit_rad_s, n.gyroscope_limit_rad_s) as f32;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::physics::measure::Reading;
    use crate::random::{Key, purpose};
    use crate::scene::Pose;

    fn samples(noise: ImuNoise, n: usize, dt_s: f64) -> Vec<[f32; 6]> {
        let sensor = InertialSensor::new("imu", noise).unwrap();
        let read = || Reading {
            pos: [0.0; 3],
            quat: [0.0, 0.0, 0.0, 1.0],
            vel: [0.0; 3],
            gyro: [0.1, 0.2, 0.3],
            accel: [0.0, 0.0, 9.81],
        };
        let mut memory = vec![0.0; sensor.memory_len()];
        (0..n as u64)
            .map(|step| {
                let draw = Key { seed: 1, world: 0, drone: 0, step, purpose: purpose("imu") }.stream();
                let mut at = Moment {
                    drone: 0,
                    layout: None,
                    time_s: step as f64 * dt_s,
                    since_s: dt_s,
                    first: step == 0,
                    pose: Pose::default(),
                    vel_m_s: [0.0; 3],
                    ang_vel_rad_s: [0.0; 3],
                    worker: None,
                    draw,
                    read: &read,
                };
                let (mut acc, mut gyro) = ([0.0f32; 3], [0.0f32; 3]);
                sensor.sample(&mut at, &mut memory, &mut [&mut acc, &mut gyro]).unwrap();
                [acc[0], acc[1], acc[2], gyro[0], gyro[1], gyro[2]]
            })
            .collect()
    }

    #[test]
    fn without_noise_it_reads_the_truth_and_noise_has_the_size_of_its_density() {
        assert_eq!(samples(ImuNoise::default(), 2, 0.01)[1], [0.0, 0.0, 9.81, 0.1, 0.2, 0.3]);
        let noise = ImuNoise { gyroscope_density_rad_s_sqrt_hz: 1e-3, ..ImuNoise::default() };
        let all = samples(noise, 4000, 0.01);
        let square: f64 = all.iter().map(|s| (f64::from(s[3]) - 0.1).powi(2)).sum::<f64>() / all.len() as f64;
        // 1e-3 rad/s/√Hz over 10 ms: 0.01 rad/s.
        assert!((square.sqrt() - 0.01).abs() < 5e-4, "{}", square.sqrt());
    }

    #[test]
    fn a_bias_stays_and_a_walk_grows() {
        let noise = ImuNoise { accelerometer_bias_m_s2: 0.3, ..ImuNoise::default() };
        let all = samples(noise, 50, 0.01);
        assert!(all[0][0] != 0.0 && all.iter().all(|s| s[0] == all[0][0]), "{:?}", all[0]);
        let noise = ImuNoise { accelerometer_walk_m_s2_sqrt_s: 0.1, ..ImuNoise::default() };
        let all = samples(noise, 5000, 0.01);
        let far = f64::from(all[4999][0] - all[0][0]).abs();
        assert!(far > 0.02 && far < 3.0, "{far}");
        assert!(InertialSensor::new("imu", ImuNoise { gyroscope_bias_rad_s: -1.0, ..noise }).is_err());
    }
}
