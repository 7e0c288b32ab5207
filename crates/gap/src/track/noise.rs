//! Sensor noise: the deviation of a sample from the curve through its neighbours.

use super::{Noise, StatedNoise};
use propwash_flight::{Channel, clean, resample};
use propwash_trace::math::quat;

impl Noise {
    /// Noise of position and attitude, gyroscope and accelerometer, as stated or else as estimated from their samples.
    pub(super) fn of(
        stated: &StatedNoise,
        (position, attitude): (&Channel<3>, &Channel<4>),
        (gyro, accel): (&Channel<3>, &Channel<3>),
    ) -> Self {
        let pose = || {
            rayon::join(
                || stated.position_m.unwrap_or_else(|| noise_of(position).max(2e-5)),
                || stated.attitude_rad.unwrap_or_else(|| attitude_noise(attitude).max(1e-4)),
            )
        };
        let inertial = || {
            rayon::join(
                || stated.gyro_rad_s.unwrap_or_else(|| noise_of(gyro).max(5e-4)),
                || stated.accel_m_s2.unwrap_or_else(|| noise_of(accel).max(5e-3)),
            )
        };
        let ((position_m, attitude_rad), (gyro_rad_s, accel_m_s2)) = rayon::join(pose, inertial);
        Self {
            position_m,
            attitude_rad,
            gyro_rad_s,
            accel_m_s2,
            rotor_rad_s: None,
            thrust_n: None,
            stated: [
                stated.position_m.is_some(),
                stated.attitude_rad.is_some(),
                stated.gyro_rad_s.is_some(),
                stated.accel_m_s2.is_some(),
            ],
        }
    }
}

/// Samples of the local fits whose residuals give the noise.
const NEAR: usize = 7;

/// Standard deviation of a sample: residual of cubics through 7 neighbours, by the median over the log and components.
pub(crate) fn noise_of<const N: usize>(channel: &Channel<N>) -> f64 {
    let mut all = Vec::new();
    let stride = (channel.len() / 2000).max(1);
    for from in (0..channel.len().saturating_sub(NEAR)).step_by(stride) {
        let cubic = Cubic::new(&channel.t_s[from..from + NEAR]);
        for k in 0..N {
            all.push(cubic.residual(core::array::from_fn(|i| channel.values[from + i][k])));
        }
    }
    // Median of χ² with NEAR − 4 = 3 degrees of freedom: 2.366.
    clean::median(all).map_or(0.0, |m| (m / 2.366).sqrt())
}

fn attitude_noise(channel: &Channel<4>) -> f64 {
    let mut all = Vec::new();
    let stride = (channel.len() / 2000).max(1);
    for from in (0..channel.len().saturating_sub(NEAR)).step_by(stride) {
        let base = quat::conjugate(channel.values[from + NEAR / 2]);
        let turns: [[f64; 3]; NEAR] =
            core::array::from_fn(|i| resample::rotation_vector(quat::mul(base, channel.values[from + i])));
        let cubic = Cubic::new(&channel.t_s[from..from + NEAR]);
        for k in 0..3 {
            all.push(cubic.residual(turns.map(|r| r[k])));
        }
    }
    clean::median(all).map_or(0.0, |m| (m / 2.366).sqrt())
}

/// Cubics at some times: orthogonal polynomials by Gram–Schmidt, exact for uneven sample times.
struct Cubic {
    basis: [[f64; NEAR]; 4],
    /// How many of them there are: fewer where times repeat.
    len: usize,
}

impl Cubic {
    fn new(t: &[f64]) -> Self {
        let (middle, scale) = (t[t.len() / 2], (t[t.len() - 1] - t[0]).max(1e-9));
        let mut out = Self { basis: [[0.0; NEAR]; 4], len: 0 };
        for power in 0..4 {
            let mut p: [f64; NEAR] = core::array::from_fn(|i| ((t[i] - middle) / scale).powi(power));
            for b in &out.basis[..out.len] {
                take_away(&mut p, b);
            }
            let norm = p.iter().map(|a| a * a).sum::<f64>().sqrt();
            if norm < 1e-9 {
                continue;
            }
            out.basis[out.len] = p.map(|a| a / norm);
            out.len += 1;
        }
        out
    }

    /// Residual sum of squares of its fit.
    fn residual(&self, mut rest: [f64; NEAR]) -> f64 {
        for b in &self.basis[..self.len] {
            take_away(&mut rest, b);
        }
        rest.iter().map(|r| r * r).sum()
    }
}

/// Takes the part along a unit vector out of `values`.
fn take_away(values: &mut [f64; NEAR], along: &[f64; NEAR]) {
    let d: f64 = values.iter().zip(along).map(|(a, b)| a * b).sum();
    values.iter_mut().zip(along).for_each(|(a, b)| *a -= d * b);
}
