//! Noise of each channel of each log beside the model.
//!
//! The difference between neighbouring samples ([`super::track::noise_of`]) is a lower bound on the noise of a channel.
//! Channels smoothed by an estimator or a filter have larger errors with longer correlation times. These show in the
//! residuals after every window's initial state and disturbances are fitted: in their size, and in how long they keep their
//! sign. An error of size `s` that persists for `τ` samples carries as much information about a slow quantity as white
//! noise of `s √τ` (coloured residuals: Morelli and Klein, "Accuracy of aerodynamic model parameters estimated from flight
//! test data", J. Guidance, Control and Dynamics 20(1), 1997).
//!
//! The residuals are taken with *all* candidates free. Otherwise the residual of a missing effect would count as noise and
//! reduce the very evidence for it.

use super::disturbance::Disturbance;
use super::fit::{CHANNELS, Linear, Window};
use super::policy::{NOISE_SETTLED, SLOWEST_NOISE};
use super::track::Noise;
use rayon::prelude::*;

impl Noise {
    /// Standard deviations of position (m), attitude (rad), gyroscope (rad/s) and accelerometer (m/s²).
    pub(super) fn channels(&self) -> [f64; CHANNELS] {
        [self.position_m, self.attitude_rad, self.gyro_rad_s, self.accel_m_s2]
    }

    /// The same noise with other standard deviations.
    pub(super) fn with_channels(
        &self,
        [position_m, attitude_rad, gyro_rad_s, accel_m_s2]: [f64; CHANNELS],
    ) -> Self {
        Self { position_m, attitude_rad, gyro_rad_s, accel_m_s2, ..*self }
    }

    /// Whether all channels agree within [`NOISE_SETTLED`].
    pub(super) fn near(&self, other: &Self) -> bool {
        let pairs = self.channels().into_iter().zip(other.channels());
        pairs.into_iter().all(|(a, b)| (a / b).ln().abs() < NOISE_SETTLED)
    }
}

/// Sums over the residuals of one channel.
#[derive(Clone, Copy)]
struct Left {
    square: f64,
    rows: f64,
    /// Degrees of freedom used up by the window's nuisance parameters.
    used: f64,
    /// Products of residuals at each lag, and their number.
    lagged: [(f64, f64); SLOWEST_NOISE],
}

impl Left {
    fn nothing() -> Self {
        Self { square: 0.0, rows: 0.0, used: 0.0, lagged: [(0.0, 0.0); SLOWEST_NOISE] }
    }

    fn add(&mut self, other: &Self) {
        self.square += other.square;
        self.rows += other.rows;
        self.used += other.used;
        for (a, b) in self.lagged.iter_mut().zip(&other.lagged) {
            a.0 += b.0;
            a.1 += b.1;
        }
    }

    /// Standard deviation of equivalent white noise, over that by which the rows were divided.
    fn times(&self) -> f64 {
        let free = self.rows - self.used;
        if free < 0.1 * self.rows || free < 30.0 || self.square <= 0.0 {
            return 1.0;
        }
        let variance = self.square / self.rows;
        // Correlation time in samples: up to the first lag at which the correlation vanishes.
        let together: f64 = self
            .lagged
            .iter()
            .map(|(sum, n)| if *n > 0.0 { sum / n / variance } else { 0.0 })
            .take_while(|rho| *rho > 0.0)
            .sum();
        (self.square / free * (1.0 + 2.0 * together)).sqrt()
    }
}

/// Residuals of a window's rows, with its nuisance parameters at their estimate.
fn left_of(window: &Window, disturbance: &Disturbance, delta: &[f64]) -> Option<[Left; CHANNELS]> {
    let kept = window.kept.as_ref()?;
    let own = window.own_solution(disturbance, delta)?;
    let by: Vec<f64> = own.mean.iter().copied().chain(delta.iter().copied()).collect();
    let rest = kept.left(&by);
    let covariance = own.inverse.transpose() * &own.inverse;
    let mut out = [Left::nothing(); CHANNELS];
    let mut from = 0;
    for (channel, rows) in window.rows_of.into_iter().enumerate() {
        let part = &rest[from..from + rows];
        let left = &mut out[channel];
        left.square = part.iter().map(|e| e * e).sum();
        left.rows = rows as f64;
        // Trace of J C Jᵀ: what the rows of this channel are taken up by.
        left.used = covariance.dot(&kept.own[channel]);
        // Samples have three axes each.
        for (lag, (sum, n)) in left.lagged.iter_mut().enumerate() {
            let apart = 3 * (lag + 1);
            if apart < rows {
                *sum = part[apart..].iter().zip(part).map(|(a, b)| a * b).sum();
                *n = (rows - apart) as f64;
            }
        }
        from += rows;
    }
    Some(out)
}

impl Linear {
    /// Noise of every log with its parameters at `deltas`; never below `least`, the difference of neighbouring samples.
    pub fn noise_beside(
        &self,
        disturbance: &Disturbance,
        deltas: &[Vec<f64>],
        least: &[Noise],
    ) -> Vec<Noise> {
        let kept = self.windows.par_iter().filter(|w| w.kept.is_some());
        let all: Vec<Option<(usize, [Left; CHANNELS])>> =
            kept.map(|w| Some((w.log, left_of(w, disturbance, &deltas[w.log])?))).collect();
        let mut sums = vec![[Left::nothing(); CHANNELS]; least.len()];
        for (log, left) in all.iter().flatten() {
            sums[*log].iter_mut().zip(left).for_each(|(sum, part)| sum.add(part));
        }
        (0..least.len())
            .map(|log| {
                let (now, floor) = (self.noise[log].channels(), least[log].channels());
                let stated = least[log].stated;
                self.noise[log].with_channels(core::array::from_fn(|c| {
                    // User-stated noise is not re-estimated.
                    if stated[c] { floor[c] } else { (now[c] * sums[log][c].times()).max(floor[c]) }
                }))
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use propwash_rollout::random::{Key, purpose};

    /// Residuals of a channel whose errors persist for about `stays` samples.
    fn left(stays: f64, n: usize) -> Left {
        let key = Key { seed: 2, world: 0, drone: 0, step: 0, purpose: purpose("noise test") };
        let mut dice = key.stream();
        let kept = if stays > 0.0 { (-1.0 / stays).exp() } else { 0.0 };
        let mut now = [0.0; 3];
        let mut part = Vec::new();
        for _ in 0..n {
            for x in &mut now {
                *x = kept * *x + (1.0 - kept * kept).sqrt() * dice.normal();
                part.push(*x);
            }
        }
        let mut out = Left::nothing();
        out.square = part.iter().map(|e| e * e).sum();
        out.rows = part.len() as f64;
        for (lag, (sum, n)) in out.lagged.iter_mut().enumerate() {
            let apart = 3 * (lag + 1);
            *sum = part[apart..].iter().zip(&part).map(|(a, b)| a * b).sum();
            *n = (part.len() - apart) as f64;
        }
        out
    }

    #[test]
    fn errors_that_stay_count_as_more_noise_and_white_ones_as_they_are() {
        assert!((left(0.0, 5000).times() - 1.0).abs() < 0.06, "{}", left(0.0, 5000).times());
        // An error decaying with time constant τ samples has an integrated correlation of 2τ.
        let smooth = left(6.0, 20000).times();
        let known = ((1.0 + (-1.0f64 / 6.0).exp()) / (1.0 - (-1.0f64 / 6.0).exp())).sqrt();
        assert!((smooth / known - 1.0).abs() < 0.1, "{smooth} {known}");
    }

    #[test]
    fn what_the_start_of_a_window_has_used_up_is_missing_from_what_is_left() {
        let mut some = left(0.0, 200);
        some.square *= 0.5;
        some.used = 0.5 * some.rows;
        assert!((some.times() - 1.0).abs() < 0.1);
    }
}
