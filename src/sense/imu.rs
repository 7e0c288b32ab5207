//! Accelerometer and gyroscope at the centre of mass, with optional noise.
//!
//! reading = truth + bias + white noise; the bias starts with a draw and walks (Woodman, "An introduction to inertial
//! navigation", UCAM-CL-TR-696, 2007, section 3.2). Draws depend only on the key and the step.

use serde::{Deserialize, Serialize};

use super::SenseError;
use crate::physics::measure::{Rate, Reading, State};
use crate::random::{Key, purpose};

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

/// One reading.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ImuReading {
    /// Specific force, m/s², body.
    pub accelerometer_m_s2: [f64; 3],
    /// Angular velocity, rad/s, body.
    pub gyroscope_rad_s: [f64; 3],
    /// Some axis was beyond the sensor's limit and reads the limit.
    pub saturated: bool,
}

/// An inertial sensor of one drone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Imu {
    noise: ImuNoise,
    key: Key,
    accelerometer_bias: [f64; 3],
    gyroscope_bias: [f64; 3],
}

impl Imu {
    /// A sensor whose draws belong to a seed, a world and a drone.
    ///
    /// # Errors
    /// [`SenseError::Parameter`] for a number that is negative or NaN.
    pub fn new(noise: ImuNoise, seed: u64, world: u64, drone: u32) -> Result<Self, SenseError> {
        let fields = [
            ("accelerometer_density_m_s2_sqrt_hz", noise.accelerometer_density_m_s2_sqrt_hz),
            ("gyroscope_density_rad_s_sqrt_hz", noise.gyroscope_density_rad_s_sqrt_hz),
            ("accelerometer_bias_m_s2", noise.accelerometer_bias_m_s2),
            ("gyroscope_bias_rad_s", noise.gyroscope_bias_rad_s),
            ("accelerometer_walk_m_s2_sqrt_s", noise.accelerometer_walk_m_s2_sqrt_s),
            ("gyroscope_walk_rad_s_sqrt_s", noise.gyroscope_walk_rad_s_sqrt_s),
            ("accelerometer_limit_m_s2", noise.accelerometer_limit_m_s2),
            ("gyroscope_limit_rad_s", noise.gyroscope_limit_rad_s),
        ];
        for (name, value) in fields {
            if !(value >= 0.0) || (value.is_infinite() && !name.contains("limit")) {
                return Err(SenseError::Parameter {
                    what: format!("inertial sensor: {name} must be finite and not negative, got {value}"),
                });
            }
        }
        let key = Key { seed, world, drone, step: 0, purpose: purpose("imu bias") };
        let mut draws = key.stream();
        let accelerometer_bias = [0; 3].map(|_| noise.accelerometer_bias_m_s2 * draws.normal());
        let gyroscope_bias = [0; 3].map(|_| noise.gyroscope_bias_rad_s * draws.normal());
        Ok(Self { noise, key, accelerometer_bias, gyroscope_bias })
    }

    /// Bias of the accelerometer (m/s²) and of the gyroscope (rad/s) now.
    pub fn bias(&self) -> ([f64; 3], [f64; 3]) {
        (self.accelerometer_bias, self.gyroscope_bias)
    }

    /// Reads state and rate at `step`, `dt_s` after the reading before. Steps are read in order, each once: the bias
    /// walks with every reading.
    ///
    /// # Errors
    /// [`SenseError::Parameter`] for a time step that is not positive and finite.
    pub fn read(
        &mut self,
        state: &State<f64>,
        rate: &Rate<f64>,
        gravity_m_s2: [f64; 3],
        dt_s: f64,
        step: u64,
    ) -> Result<ImuReading, SenseError> {
        self.read_as(&Reading::ideal(state, rate, gravity_m_s2), dt_s, step)
    }

    /// As [`Imu::read`], of what effects of the vehicle let its sensors read (`Drone::read`: mounted askew, biased …)
    /// before noise.
    ///
    /// # Errors
    /// [`SenseError::Parameter`] for a time step that is not positive and finite.
    pub fn read_as(
        &mut self,
        reading: &Reading<f64>,
        dt_s: f64,
        step: u64,
    ) -> Result<ImuReading, SenseError> {
        if !(dt_s > 0.0 && dt_s.is_finite()) {
            return Err(SenseError::Parameter {
                what: format!(
                    "inertial sensor: the time between readings must be positive and finite, got {dt_s} s"
                ),
            });
        }
        let mut draws = Key { step, purpose: purpose("imu noise"), ..self.key }.stream();
        let n = &self.noise;
        let root = dt_s.sqrt();
        let (mut acc, mut gyro) = (reading.accel, reading.gyro);
        let mut saturated = false;
        for k in 0..3 {
            acc[k] +=
                self.accelerometer_bias[k] + n.accelerometer_density_m_s2_sqrt_hz / root * draws.normal();
            gyro[k] += self.gyroscope_bias[k] + n.gyroscope_density_rad_s_sqrt_hz / root * draws.normal();
            saturated |= acc[k].abs() > n.accelerometer_limit_m_s2 || gyro[k].abs() > n.gyroscope_limit_rad_s;
            acc[k] = acc[k].clamp(-n.accelerometer_limit_m_s2, n.accelerometer_limit_m_s2);
            gyro[k] = gyro[k].clamp(-n.gyroscope_limit_rad_s, n.gyroscope_limit_rad_s);
        }
        for k in 0..3 {
            self.accelerometer_bias[k] += n.accelerometer_walk_m_s2_sqrt_s * root * draws.normal();
            self.gyroscope_bias[k] += n.gyroscope_walk_rad_s_sqrt_s * root * draws.normal();
        }
        Ok(ImuReading { accelerometer_m_s2: acc, gyroscope_rad_s: gyro, saturated })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::quat;

    const G: [f64; 3] = [0.0, 0.0, -9.81];

    fn state() -> (State<f64>, Rate<f64>) {
        let mut s = State::rest();
        s.quat = quat::exp([0.3, -0.2, 0.5]);
        s.ang_vel = [0.1, -0.2, 0.3];
        let r = Rate {
            vel: [0.0; 3],
            ang_vel: s.ang_vel,
            acc: [1.0, 2.0, -3.0],
            ang_acc: [0.0; 3],
            rotor_acc: s.rotor_vel,
            thrust_rate: 0.0,
        };
        (s, r)
    }

    #[test]
    fn without_noise_it_reads_specific_force_and_angular_velocity() {
        let (s, r) = state();
        let mut imu = Imu::new(ImuNoise::default(), 1, 2, 3).unwrap();
        let reading = imu.read(&s, &r, G, 0.01, 7).unwrap();
        let expected = quat::rotate_inverse(s.quat, [1.0, 2.0, 6.81]);
        for k in 0..3 {
            assert!((reading.accelerometer_m_s2[k] - expected[k]).abs() < 1e-12);
        }
        assert_eq!(reading.gyroscope_rad_s, s.ang_vel);
        assert!(!reading.saturated);
    }

    #[test]
    fn it_reads_what_effects_leave_of_the_truth() {
        let (s, r) = state();
        let mut seen = Reading::ideal(&s, &r, G);
        seen.gyro[1] += 0.5;
        seen.accel[2] -= 0.25;
        let mut imu = Imu::new(ImuNoise::default(), 1, 2, 3).unwrap();
        let plain = imu.read(&s, &r, G, 0.01, 7).unwrap();
        let reading = imu.read_as(&seen, 0.01, 8).unwrap();
        assert_eq!(reading.gyroscope_rad_s[1], plain.gyroscope_rad_s[1] + 0.5);
        assert_eq!(reading.accelerometer_m_s2[2], plain.accelerometer_m_s2[2] - 0.25);
        assert!(imu.read_as(&seen, 0.0, 9).is_err());
    }

    #[test]
    fn noise_has_the_stated_density_and_repeats() {
        let (s, r) = state();
        let noise = ImuNoise {
            accelerometer_density_m_s2_sqrt_hz: 0.002,
            gyroscope_density_rad_s_sqrt_hz: 0.0003,
            ..ImuNoise::default()
        };
        let clean = Imu::new(ImuNoise::default(), 1, 0, 0).unwrap().read(&s, &r, G, 0.01, 0).unwrap();
        let mut imu = Imu::new(noise, 1, 0, 0).unwrap();
        let mut again = Imu::new(noise, 1, 0, 0).unwrap();
        let (mut a2, mut g2, n) = (0.0, 0.0, 4000);
        for step in 0..n {
            let reading = imu.read(&s, &r, G, 0.01, step).unwrap();
            assert_eq!(reading, again.read(&s, &r, G, 0.01, step).unwrap());
            for k in 0..3 {
                a2 += (reading.accelerometer_m_s2[k] - clean.accelerometer_m_s2[k]).powi(2);
                g2 += (reading.gyroscope_rad_s[k] - clean.gyroscope_rad_s[k]).powi(2);
            }
        }
        // density / sqrt(0.01 s) = 10 × density.
        let (a, g) = ((a2 / (3.0 * n as f64)).sqrt(), (g2 / (3.0 * n as f64)).sqrt());
        assert!((a / 0.02 - 1.0).abs() < 0.03 && (g / 0.003 - 1.0).abs() < 0.03, "{a} {g}");
    }

    #[test]
    fn a_bias_walks_with_the_root_of_time() {
        let (s, r) = state();
        let noise = ImuNoise { gyroscope_walk_rad_s_sqrt_s: 0.01, ..ImuNoise::default() };
        let (mut sum, worlds) = (0.0, 600);
        for world in 0..worlds {
            let mut imu = Imu::new(noise, 5, world, 0).unwrap();
            for step in 0..25 {
                imu.read(&s, &r, G, 0.16, step).unwrap();
            }
            sum += imu.bias().1.iter().map(|b| b * b).sum::<f64>();
        }
        // 25 steps of 0.16 s: 4 s, so 0.01 · 2.
        let sigma = (sum / (3.0 * worlds as f64)).sqrt();
        assert!((sigma / 0.02 - 1.0).abs() < 0.08, "{sigma}");
    }

    #[test]
    fn a_reading_beyond_the_limit_is_held_and_said() {
        let (s, r) = state();
        let noise = ImuNoise { gyroscope_limit_rad_s: 0.25, ..ImuNoise::default() };
        let reading = Imu::new(noise, 1, 0, 0).unwrap().read(&s, &r, G, 0.01, 0).unwrap();
        assert_eq!(reading.gyroscope_rad_s, [0.1, -0.2, 0.25]);
        assert!(reading.saturated);
        assert!(Imu::new(ImuNoise { gyroscope_bias_rad_s: f64::NAN, ..noise }, 1, 0, 0).is_err());
    }
}
