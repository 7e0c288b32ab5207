//! Sensor noise: the deviation of a sample from the curve through its neighbours.

use super::{Noise, StatedNoise};
use crate::flight::{Channel, clean, resample};
use crate::math::quat;

impl Noise {
    /// Noise of position and attitude, gyroscope and accelerometer, as stated or else as estimated from their samples.
    pub(super) fn of(
        stated: &StatedNoise,
        (position, attitude): (&Channel<3>, &Channel<4>),
        (gyro, accel): (&Channel<3>, &Channel<3>),
    ) -> Self {
        Self {
            position_m: stated.position_m.unwrap_or_else(|| noise_of(position).max(2e-5)),
            attitude_rad: stated.attitude_rad.unwrap_or_else(|| attitude_noise(attitude).max(1e-4)),
            gyro_rad_s: stated.gyro_rad_s.unwrap_or_else(|| noise_of(gyro).max(5e-4)),
            accel_m_s2: stated.accel_m_s2.unwrap_or_else(|| noise_of(accel).max(5e-3)),
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
        let t = &channel.t_s[from..from + NEAR];
        for k in 0..N {
            let y: Vec<f64> = (0..NEAR).map(|i| channel.values[from + i][k]).collect();
            all.push(cubic_residual(t, &y));
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
        let turns: Vec<[f64; 3]> =
            (0..NEAR).map(|i| resample::rotation_vector(quat::mul(base, channel.values[from + i]))).collect();
        for k in 0..3 {
            let y: Vec<f64> = turns.iter().map(|r| r[k]).collect();
            all.push(cubic_residual(&channel.t_s[from..from + NEAR], &y));
        }
    }
    clean::median(all).map_or(0.0, |m| (m / 2.366).sqrt())
}

/// Residual sum of squares of a cubic fit.
fn cubic_residual(t: &[f64], y: &[f64]) -> f64 {
    let (middle, scale) = (t[t.len() / 2], (t[t.len() - 1] - t[0]).max(1e-9));
    // Orthogonal polynomials by Gram–Schmidt, exact for uneven sample times.
    let mut rest = y.to_vec();
    let mut basis: Vec<Vec<f64>> = Vec::new();
    for power in 0..4 {
        let mut p: Vec<f64> = t.iter().map(|t| ((t - middle) / scale).powi(power)).collect();
        for b in &basis {
            let d: f64 = p.iter().zip(b).map(|(a, b)| a * b).sum();
            p.iter_mut().zip(b).for_each(|(a, b)| *a -= d * b);
        }
        let norm = p.iter().map(|a| a * a).sum::<f64>().sqrt();
        if norm < 1e-9 {
            continue;
        }
        p.iter_mut().for_each(|a| *a /= norm);
        let d: f64 = rest.iter().zip(&p).map(|(a, b)| a * b).sum();
        rest.iter_mut().zip(&p).for_each(|(a, b)| *a -= d * b);
        basis.push(p);
    }
    rest.iter().map(|r| r * r).sum()
}
