//! Sensors of an autopilot that [`crate::sense`] has not: magnetometer, barometer, satellite receiver; and an inertial sensor that
//! knows when the ground carries the vehicle. They are sensors as all others: their random numbers go with seed, world, drone, step and
//! name, and what they remember is the arena's.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use serde::{Deserialize, Serialize};

use crate::autopilot::earth::atmosphere;
use crate::math::{quat, vec3};
use crate::physics::measure::Reading;
use crate::sense::sensors::{ImuNoise, InertialSensor};
use crate::sense::{Moment, SenseError, Sensor, SensorChannel};

/// Errors of an autopilot's sensors. [`Default`] is none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SensorNoise {
    /// Those of the inertial sensor.
    pub imu: ImuNoise,
    /// White noise of a sample of the magnetometer, each axis, gauss.
    pub magnetometer_gauss: f64,
    /// Standard deviation of its bias, drawn at the start, gauss.
    pub magnetometer_bias_gauss: f64,
    /// White noise of a sample of the barometer, Pa.
    pub barometer_pa: f64,
    /// Random walk of the barometer, Pa/√s.
    pub barometer_walk_pa_sqrt_s: f64,
    /// Standard deviation of the receiver's horizontal position, each axis, m. Its errors wander: a Gauss–Markov process.
    pub gps_horizontal_m: f64,
    /// That of its height, m.
    pub gps_vertical_m: f64,
    /// Correlation time of both, s; 0 makes them white.
    pub gps_correlation_s: f64,
    /// White noise of its velocity, each axis, m/s.
    pub gps_velocity_m_s: f64,
}

impl SensorNoise {
    /// Sensors as small autopilots have them: inertial sensor by the data sheet of the ICM-20689 (0.006 °/s/√Hz, 150 µg/√Hz),
    /// barometer by that of the MS5611 (0.012 hPa). The magnetometer (4 mgauss) and the receiver (0.3 m, 0.5 m, 60 s, 0.05 m/s) are
    /// assumed.
    pub fn typical() -> Self {
        Self {
            imu: ImuNoise {
                gyroscope_density_rad_s_sqrt_hz: 0.006f64.to_radians(),
                accelerometer_density_m_s2_sqrt_hz: 150e-6 * 9.806_65,
                ..ImuNoise::default()
            },
            magnetometer_gauss: 0.004,
            magnetometer_bias_gauss: 0.0,
            barometer_pa: 1.2,
            barometer_walk_pa_sqrt_s: 0.0,
            gps_horizontal_m: 0.3,
            gps_vertical_m: 0.5,
            gps_correlation_s: 60.0,
            gps_velocity_m_s: 0.05,
        }
    }

    /// Refuses numbers that are negative, infinite or NaN.
    ///
    /// # Errors
    /// [`SenseError::Parameter`], naming the field.
    pub fn check(&self) -> Result<(), SenseError> {
        self.imu.check()?;
        let fields = [
            ("magnetometer_gauss", self.magnetometer_gauss),
            ("magnetometer_bias_gauss", self.magnetometer_bias_gauss),
            ("barometer_pa", self.barometer_pa),
            ("barometer_walk_pa_sqrt_s", self.barometer_walk_pa_sqrt_s),
            ("gps_horizontal_m", self.gps_horizontal_m),
            ("gps_vertical_m", self.gps_vertical_m),
            ("gps_correlation_s", self.gps_correlation_s),
            ("gps_velocity_m_s", self.gps_velocity_m_s),
        ];
        match fields.into_iter().find(|(_, v)| !(v.is_finite() && *v >= 0.0)) {
            None => Ok(()),
            Some((name, value)) => Err(SenseError::Parameter {
                what: format!("noise: {name} must be finite and not negative, got {value}"),
            }),
        }
    }
}

/// Whether the ground carries a vehicle; shared by the simulation, which decides it, and the inertial sensor.
#[derive(Clone, Debug, Default)]
pub(super) struct Standing(Arc<AtomicBool>);

impl Standing {
    pub fn set(&self, standing: bool) {
        self.0.store(standing, Ordering::Relaxed);
    }

    pub fn get(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// What a vehicle reads that the ground carries: no rates, and the weight.
pub(super) fn at_rest(moving: Reading<f64>, gravity_m_s2: [f64; 3]) -> Reading<f64> {
    let accel = quat::rotate_inverse(moving.quat, vec3::scale(gravity_m_s2, -1.0));
    Reading { vel: [0.0; 3], gyro: [0.0; 3], accel, ..moving }
}

/// The inertial sensor `imu`, which reads the force of the ground too.
pub(super) struct GroundedImu {
    pub inner: InertialSensor,
    pub standing: Standing,
    pub gravity_m_s2: [f64; 3],
}

impl Sensor for GroundedImu {
    fn name(&self) -> &str {
        self.inner.name()
    }

    fn channels(&self) -> Vec<SensorChannel> {
        self.inner.channels()
    }

    fn memory_len(&self) -> usize {
        self.inner.memory_len()
    }

    fn sample(&self, at: &mut Moment, memory: &mut [f64], out: &mut [&mut [f32]]) -> Result<(), SenseError> {
        if !self.standing.get() {
            return self.inner.sample(at, memory, out);
        }
        let moving = at.reading();
        let read = || at_rest(moving, self.gravity_m_s2);
        let mut still = Moment { worker: None, draw: at.draw.clone(), read: &read, ..*at };
        self.inner.sample(&mut still, memory, out)
    }
}

/// A magnetometer: the field at home, turned into the body, with a bias and white noise. Channel `field`, gauss, body.
#[derive(Clone, Debug)]
pub struct Magnetometer {
    /// The field, gauss, world.
    pub field_gauss: [f64; 3],
    /// White noise of each axis, gauss.
    pub noise_gauss: f64,
    /// Standard deviation of the bias of each axis, gauss.
    pub bias_gauss: f64,
}

impl Sensor for Magnetometer {
    fn name(&self) -> &str {
        "magnetometer"
    }

    fn channels(&self) -> Vec<SensorChannel> {
        vec![SensorChannel::new("field", "gauss", &[3])]
    }

    /// The bias.
    fn memory_len(&self) -> usize {
        3
    }

    fn sample(&self, at: &mut Moment, memory: &mut [f64], out: &mut [&mut [f32]]) -> Result<(), SenseError> {
        let body = quat::rotate_inverse(at.pose.quat_xyzw, self.field_gauss);
        for k in 0..3 {
            if at.first {
                memory[k] = self.bias_gauss * at.draw.normal();
            }
            out[0][k] = (body[k] + memory[k] + self.noise_gauss * at.draw.normal()) as f32;
        }
        Ok(())
    }
}

/// A barometer in the standard atmosphere, with white noise and a random walk. Channels `pressure`, Pa, and `temperature`, °C.
#[derive(Clone, Debug)]
pub struct Barometer {
    /// Height above the sea of the world's z = 0, m.
    pub zero_alt_m: f64,
    /// White noise, Pa.
    pub noise_pa: f64,
    /// Random walk, Pa/√s.
    pub walk_pa_sqrt_s: f64,
}

impl Sensor for Barometer {
    fn name(&self) -> &str {
        "barometer"
    }

    fn channels(&self) -> Vec<SensorChannel> {
        vec![SensorChannel::new("pressure", "Pa", &[]), SensorChannel::new("temperature", "°C", &[])]
    }

    /// How far it has walked, Pa.
    fn memory_len(&self) -> usize {
        1
    }

    fn sample(&self, at: &mut Moment, memory: &mut [f64], out: &mut [&mut [f32]]) -> Result<(), SenseError> {
        let (pressure_pa, celsius) = atmosphere(self.zero_alt_m + at.pose.pos_m[2]);
        memory[0] += self.walk_pa_sqrt_s * at.since_s.sqrt() * at.draw.normal();
        out[0][0] = (pressure_pa + memory[0] + self.noise_pa * at.draw.normal()) as f32;
        out[1][0] = celsius as f32;
        Ok(())
    }
}

/// A satellite receiver. Its position is off by a Gauss–Markov process, its velocity by white noise. Channels `error`, m, world: how far
/// off the position is; and `velocity`, m/s, world.
#[derive(Clone, Debug)]
pub struct Gps {
    /// Standard deviation of the position along each axis, m.
    pub position_m: [f64; 3],
    /// Correlation time of its error, s.
    pub correlation_s: f64,
    /// White noise of the velocity, m/s.
    pub velocity_m_s: f64,
}

impl Sensor for Gps {
    fn name(&self) -> &str {
        "gps"
    }

    fn channels(&self) -> Vec<SensorChannel> {
        vec![SensorChannel::new("error", "m", &[3]), SensorChannel::new("velocity", "m/s", &[3])]
    }

    /// The error of the position, m.
    fn memory_len(&self) -> usize {
        3
    }

    fn sample(&self, at: &mut Moment, memory: &mut [f64], out: &mut [&mut [f32]]) -> Result<(), SenseError> {
        let kept = if at.first || self.correlation_s == 0.0 {
            0.0
        } else {
            (-at.since_s / self.correlation_s).exp()
        };
        for k in 0..3 {
            let fresh = self.position_m[k] * (1.0 - kept * kept).sqrt();
            memory[k] = kept * memory[k] + fresh * at.draw.normal();
            out[0][k] = memory[k] as f32;
            out[1][k] = (at.vel_m_s[k] + self.velocity_m_s * at.draw.normal()) as f32;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Key, purpose};
    use crate::scene::Pose;

    /// `n` samples of a sensor every `dt_s` seconds at a pose: all channels of each in a row.
    fn samples(sensor: &dyn Sensor, pose: Pose, n: u64, dt_s: f64) -> Vec<Vec<f32>> {
        let read = || Reading {
            pos: [0.0; 3],
            quat: pose.quat_xyzw,
            vel: [0.0; 3],
            gyro: [0.3; 3],
            accel: [0.0; 3],
            ang_acc: [0.0; 3],
        };
        let mut memory = vec![0.0; sensor.memory_len()];
        let sample = |step: u64| {
            let mut at = Moment {
                drone: 0,
                layout: None,
                time_s: step as f64 * dt_s,
                since_s: dt_s,
                first: step == 0,
                pose,
                vel_m_s: [1.0, 2.0, 3.0],
                ang_vel_rad_s: [0.0; 3],
                worker: None,
                draw: Key { seed: 1, world: 0, drone: 0, step, purpose: purpose(sensor.name()) }.stream(),
                read: &read,
            };
            let mut out: Vec<Vec<f32>> = sensor.channels().iter().map(|c| vec![0.0; c.len()]).collect();
            let mut rows: Vec<&mut [f32]> = out.iter_mut().map(|c| &mut c[..]).collect();
            sensor.sample(&mut at, &mut memory, &mut rows).unwrap();
            out.concat()
        };
        (0..n).map(sample).collect()
    }

    fn spread(values: impl Iterator<Item = f32> + Clone) -> (f64, f64) {
        let n = values.clone().count() as f64;
        let mean = values.clone().map(f64::from).sum::<f64>() / n;
        (mean, (values.map(|v| (f64::from(v) - mean).powi(2)).sum::<f64>() / n).sqrt())
    }

    #[test]
    fn the_field_turns_with_the_body_and_has_the_stated_noise() {
        // Facing west: north is on the right.
        let west = Pose::new([0.0; 3], quat::exp([0.0, 0.0, core::f64::consts::FRAC_PI_2]));
        let still = Magnetometer { field_gauss: [0.2, 0.0, -0.4], noise_gauss: 0.0, bias_gauss: 0.0 };
        let found = &samples(&still, west, 1, 0.01)[0];
        assert!(
            (found[1] + 0.2).abs() < 1e-6 && (found[2] + 0.4).abs() < 1e-6 && found[0].abs() < 1e-6,
            "{found:?}"
        );
        let all = samples(&Magnetometer { noise_gauss: 0.01, ..still }, Pose::default(), 4000, 0.01);
        let (mean, sigma) = spread(all.iter().map(|s| s[0]));
        assert!((mean - 0.2).abs() < 1e-3 && (sigma / 0.01 - 1.0).abs() < 0.05, "{mean} {sigma}");
    }

    #[test]
    fn a_barometer_reads_the_atmosphere_and_walks_as_stated() {
        let still = Barometer { zero_alt_m: 500.0, noise_pa: 0.0, walk_pa_sqrt_s: 0.0 };
        let found = &samples(&still, Pose::new([0.0, 0.0, 500.0], [0.0, 0.0, 0.0, 1.0]), 1, 0.02)[0];
        assert!((found[0] - 89_874.6).abs() < 0.1 && (found[1] - 8.5).abs() < 1e-5, "{found:?}");
        let steps: Vec<f32> =
            samples(&Barometer { walk_pa_sqrt_s: 2.0, ..still }, Pose::default(), 4000, 0.25)
                .windows(2)
                .map(|w| w[1][0] - w[0][0])
                .collect();
        assert!((spread(steps.iter().copied()).1 / 1.0 - 1.0).abs() < 0.05);
    }

    #[test]
    fn the_error_of_a_receiver_wanders_with_its_correlation_time() {
        let gps = Gps { position_m: [0.5, 0.5, 1.0], correlation_s: 1.0, velocity_m_s: 0.1 };
        let all = samples(&gps, Pose::default(), 40_000, 0.2);
        let (_, sigma) = spread(all.iter().map(|s| s[2]));
        assert!((sigma - 1.0).abs() < 0.06, "{sigma}");
        let lag: f64 =
            all.windows(6).map(|w| f64::from(w[0][2]) * f64::from(w[5][2])).sum::<f64>() / 39_995.0;
        assert!((lag - (-1.0f64).exp()).abs() < 0.06, "{lag}");
        let (mean, sigma) = spread(all.iter().map(|s| s[4]));
        assert!((mean - 2.0).abs() < 0.01 && (sigma - 0.1).abs() < 0.005);
    }

    #[test]
    fn the_ground_carries_the_accelerometer() {
        let inner = InertialSensor::new("imu", ImuNoise::default()).unwrap();
        let standing = Standing::default();
        let imu = GroundedImu { inner, standing: standing.clone(), gravity_m_s2: [0.0, 0.0, -9.75] };
        assert_eq!(samples(&imu, Pose::default(), 1, 0.01)[0][..6], [0.0, 0.0, 0.0, 0.3, 0.3, 0.3]);
        standing.set(true);
        assert_eq!(samples(&imu, Pose::default(), 1, 0.01)[0][..6], [0.0, 0.0, 9.75, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn noise_that_makes_no_sense_is_refused() {
        SensorNoise::typical().check().unwrap();
        let words =
            SensorNoise { gps_vertical_m: -1.0, ..SensorNoise::default() }.check().unwrap_err().to_string();
        assert!(words.contains("gps_vertical_m"), "{words}");
    }
}
