//! Accelerometer and gyroscope at the centre of mass, with optional noise.
//!
//! reading = truth + bias + white noise; the bias starts with a draw and walks (Woodman, "An introduction to inertial
//! navigation", UCAM-CL-TR-696, 2007, section 3.2).

use serde::{Deserialize, Serialize};

use crate::sense::SenseError;
use crate::sense::sensor::{ChannelType, Moment, Sensor, SensorChannel};

/// Errors of an inertial sensor. [`Default`] is none, with no limits.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ImuNoise {
    /// White noise of the accelerometer, m/s²/√Hz.
    pub accelerometer_density_m_s2_sqrt_hz: f64,
    /// White noise of the gyroscope, rad/s/√Hz.
    pub gyroscope_density_rad_s_sqrt_hz: f64,
    /// Standard deviation of the accelerometer's bias at the start, m/s².
    pub accelerometer_bias_m_s2: f64,
    /// Standard deviation of the gyroscope's bias at the start, rad/s.
    pub gyroscope_bias_rad_s: f64,
    /// Random walk of the accelerometer's bias, m/s²/√s.
    pub accelerometer_walk_m_s2_sqrt_s: f64,
    /// Random walk of the gyroscope's bias, rad/s/√s.
    pub gyroscope_walk_rad_s_sqrt_s: f64,
    /// Largest reading of each accelerometer axis, m/s²; no limit where it is infinite, in files null.
    #[serde(with = "unlimited")]
    pub accelerometer_limit_m_s2: f64,
    /// Largest reading of each gyroscope axis, rad/s; as that of the accelerometer.
    #[serde(with = "unlimited")]
    pub gyroscope_limit_rad_s: f64,
}

/// Infinity as null, which JSON has no other word for.
mod unlimited {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub fn serialize<S: Serializer>(limit: &f64, to: S) -> Result<S::Ok, S::Error> {
        limit.is_finite().then_some(*limit).serialize(to)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
        Ok(Option::<f64>::deserialize(from)?.unwrap_or(f64::INFINITY))
    }
}

impl Default for ImuNoise {
    fn default() -> Self {
        Self {
            accelerometer_density_m_s2_sqrt_hz: 0.0,
            gyroscope_density_rad_s_sqrt_hz: 0.0,
            accelerometer_bias_m_s2: 0.0,
            gyroscope_bias_rad_s: 0.0,
            accelerometer_walk_m_s2_sqrt_s: 0.0,
            gyroscope_walk_rad_s_sqrt_s: 0.0,
            accelerometer_limit_m_s2: f64::INFINITY,
            gyroscope_limit_rad_s: f64::INFINITY,
        }
    }
}

impl ImuNoise {
    /// Refuses numbers that are negative, infinite (but for limits) or NaN.
    ///
    /// # Errors
    /// [`SenseError::Parameter`], naming the field.
    pub fn check(&self) -> Result<(), SenseError> {
        let fields = [
            ("accelerometer_density_m_s2_sqrt_hz", self.accelerometer_density_m_s2_sqrt_hz),
            ("gyroscope_density_rad_s_sqrt_hz", self.gyroscope_density_rad_s_sqrt_hz),
            ("accelerometer_bias_m_s2", self.accelerometer_bias_m_s2),
            ("gyroscope_bias_rad_s", self.gyroscope_bias_rad_s),
            ("accelerometer_walk_m_s2_sqrt_s", self.accelerometer_walk_m_s2_sqrt_s),
            ("gyroscope_walk_rad_s_sqrt_s", self.gyroscope_walk_rad_s_sqrt_s),
            ("accelerometer_limit_m_s2", self.accelerometer_limit_m_s2),
            ("gyroscope_limit_rad_s", self.gyroscope_limit_rad_s),
        ];
        let odd = |(name, value): &(&str, f64)| {
            !(*value >= 0.0) || (value.is_infinite() && !name.contains("limit"))
        };
        match fields.into_iter().find(odd) {
            None => Ok(()),
            Some((name, value)) => Err(SenseError::Parameter {
                what: format!("inertial sensor: {name} must be finite and not negative, got {value}"),
            }),
        }
    }
}

/// An inertial sensor at the centre of mass. Its white noise is that of readings which average over the time between samples.
///
/// Channels: `accelerometer` (m/s², specific force, body), `gyroscope` (rad/s, body), and `saturated`: 1 where an axis was beyond its
/// limit and reads the limit.
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
        noise.check()?;
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
            SensorChannel::new("saturated", "1", &[]).of_type(ChannelType::U8),
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
        let root = at.since_s.sqrt();
        let mut saturated = false;
        for k in 0..3 {
            acc[k] += n.accelerometer_walk_m_s2_sqrt_s * root * at.draw.normal();
            gyro[k] += n.gyroscope_walk_rad_s_sqrt_s * root * at.draw.normal();
            let a =
                reading.accel[k] + acc[k] + n.accelerometer_density_m_s2_sqrt_hz / root * at.draw.normal();
            let g = reading.gyro[k] + gyro[k] + n.gyroscope_density_rad_s_sqrt_hz / root * at.draw.normal();
            saturated |= a.abs() > n.accelerometer_limit_m_s2 || g.abs() > n.gyroscope_limit_rad_s;
            out[0][k] = a.clamp(-n.accelerometer_limit_m_s2, n.accelerometer_limit_m_s2) as f32;
            out[1][k] = g.clamp(-n.gyroscope_limit_rad_s, n.gyroscope_limit_rad_s) as f32;
        }
        out[2][0] = f32::from(u8::from(saturated));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::physics::measure::Reading;
    use crate::random::{Key, purpose};
    use crate::scene::Pose;

    /// Accelerometer, gyroscope and whether they are saturated, every `dt_s` seconds, of a drone that hovers and turns.
    fn samples(noise: ImuNoise, world: u64, n: u64, dt_s: f64) -> Vec<[f64; 7]> {
        let sensor = InertialSensor::new("imu", noise).unwrap();
        let read = || Reading {
            pos: [0.0; 3],
            quat: [0.0, 0.0, 0.0, 1.0],
            vel: [0.0; 3],
            gyro: [0.125, -0.25, 0.5],
            accel: [0.0, 0.0, 9.75],
            ang_acc: [0.0; 3],
        };
        let mut memory = vec![0.0; sensor.memory_len()];
        let sample = |step: u64| {
            let draw = Key { seed: 1, world, drone: 0, step, purpose: purpose("imu") }.stream();
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
            let (mut acc, mut gyro, mut saturated) = ([0.0f32; 3], [0.0f32; 3], [0.0f32]);
            sensor.sample(&mut at, &mut memory, &mut [&mut acc, &mut gyro, &mut saturated]).unwrap();
            [acc[0], acc[1], acc[2], gyro[0], gyro[1], gyro[2], saturated[0]].map(f64::from)
        };
        (0..n).map(sample).collect()
    }

    const TRUTH: [f64; 7] = [0.0, 0.0, 9.75, 0.125, -0.25, 0.5, 0.0];

    /// Root mean square of what differs from the truth, in some axes.
    fn spread(all: &[[f64; 7]], axes: core::ops::Range<usize>) -> f64 {
        let n = (all.len() * axes.len()) as f64;
        let square = |s: &[f64; 7]| axes.clone().map(|k| (s[k] - TRUTH[k]).powi(2)).sum::<f64>();
        (all.iter().map(square).sum::<f64>() / n).sqrt()
    }

    #[test]
    fn without_noise_it_reads_the_truth() {
        assert_eq!(samples(ImuNoise::default(), 0, 2, 0.01), [TRUTH, TRUTH]);
    }

    #[test]
    fn noise_has_the_stated_density_and_repeats() {
        let noise = ImuNoise {
            accelerometer_density_m_s2_sqrt_hz: 0.002,
            gyroscope_density_rad_s_sqrt_hz: 0.0003,
            ..ImuNoise::default()
        };
        let all = samples(noise, 0, 4000, 0.01);
        assert_eq!(all, samples(noise, 0, 4000, 0.01));
        assert!(all != samples(noise, 1, 4000, 0.01));
        // density / sqrt(0.01 s) = 10 × density.
        let (a, g) = (spread(&all, 0..3), spread(&all, 3..6));
        assert!((a / 0.02 - 1.0).abs() < 0.03 && (g / 0.003 - 1.0).abs() < 0.03, "{a} {g}");
    }

    #[test]
    fn a_bias_stays_and_has_the_stated_size() {
        let noise =
            ImuNoise { accelerometer_bias_m_s2: 0.3, gyroscope_bias_rad_s: 0.02, ..ImuNoise::default() };
        let first: Vec<_> = (0..600).map(|world| samples(noise, world, 1, 0.01)[0]).collect();
        let (a, g) = (spread(&first, 0..3), spread(&first, 3..6));
        assert!((a / 0.3 - 1.0).abs() < 0.08 && (g / 0.02 - 1.0).abs() < 0.08, "{a} {g}");
        assert_eq!(samples(noise, 7, 50, 0.01)[49], first[7]);
    }

    #[test]
    fn a_bias_walks_with_the_root_of_time() {
        let noise = ImuNoise {
            accelerometer_walk_m_s2_sqrt_s: 0.1,
            gyroscope_walk_rad_s_sqrt_s: 0.01,
            ..ImuNoise::default()
        };
        let last: Vec<_> = (0..600).map(|world| samples(noise, world, 25, 0.16)[24]).collect();
        // 25 steps of 0.16 s: 4 s.
        let (a, g) = (spread(&last, 0..3), spread(&last, 3..6));
        assert!((a / 0.2 - 1.0).abs() < 0.08 && (g / 0.02 - 1.0).abs() < 0.08, "{a} {g}");
    }

    #[test]
    fn a_reading_beyond_the_limit_is_held_and_said() {
        let noise = ImuNoise { gyroscope_limit_rad_s: 0.375, ..ImuNoise::default() };
        let expected = [0.0, 0.0, 9.75, 0.125, -0.25, 0.375, 1.0];
        assert_eq!(samples(noise, 0, 1, 0.01), [expected]);
        let noise = ImuNoise { accelerometer_limit_m_s2: 9.75, ..ImuNoise::default() };
        assert_eq!(samples(noise, 0, 1, 0.01), [TRUTH]);
    }

    #[test]
    fn numbers_that_make_no_sense_are_refused() {
        for value in [-1.0, f64::NAN, f64::INFINITY] {
            let noise = ImuNoise { gyroscope_bias_rad_s: value, ..ImuNoise::default() };
            let words = InertialSensor::new("imu", noise).unwrap_err().to_string();
            assert!(words.contains("gyroscope_bias_rad_s"), "{words}");
        }
        let noise = ImuNoise { gyroscope_limit_rad_s: f64::NAN, ..ImuNoise::default() };
        assert!(InertialSensor::new("imu", noise).is_err());
    }
}
