//! Errors of measured inputs: how noisy rotor speeds or a thrust are, and the same inputs without that noise.
//!
//! A fit that takes a noisy input for exact makes the vehicle answer less than it does: regression dilution. 4 rad/s of
//! noise on rotor speeds turn into torques several times larger than those of a gentle flight, and mass and thrust were
//! then found at a fifth of their values. An input's expected value, given the whole record, in its place takes this bias away:
//! what it is still off by does not go with it (regression calibration: Carroll, Ruppert, Stefanski and Crainiceanu,
//! "Measurement error in nonlinear models", 2nd ed. 2006, ch. 4). The expected value is Wiener's smoother: every frequency is
//! kept by the share of its power that is no noise ("Extrapolation, interpolation and smoothing of stationary time
//! series", 1949, ch. 3).
//!
//! Noise is known by its even power at high frequencies, to which rotors with their inertia do not follow. What a logger adds at
//! some frequency only (a beat of the rotors) is not told from motion.

use super::policy::NOISE_BAND;
use crate::flight::{Channel, clean};
use nalgebra::{DMatrix, SymmetricEigen};

/// Length of one segment of a spectrum, s: frequencies 2 Hz apart.
const SEGMENT_S: f64 = 0.5;
/// Most segments that a spectrum is averaged over, and fewest from which it says something.
const MOST_SEGMENTS: usize = 120;
const FEWEST_SEGMENTS: usize = 8;
/// Distance of two samples, over the usual one, from which on a record is interrupted.
const INTERRUPTED: f64 = 3.5;

/// Inputs without their noise.
pub(super) struct Smoothed {
    /// The inputs, at the times of the samples.
    pub inputs: Vec<Channel<1>>,
    /// Standard deviation of what was taken away, unit of the inputs.
    pub noise: f64,
    /// Time over which the inputs were smoothed (root mean square of the kernel's reach, the widest of all directions), s.
    pub reach_s: f64,
}

/// The inputs without noise; `None` where the record is too short to tell noise from signal.
pub(super) fn without_noise(inputs: &[Channel<1>]) -> Option<Smoothed> {
    let first = inputs.first()?;
    let period_s = first.period_s()?;
    let length = ((SEGMENT_S / period_s).round() as usize / 2 * 2).max(8);
    let runs = runs(&first.t_s, period_s);
    // Rotors that are read together are smoothed together: sums and differences of them move by different amounts, and one
    // filter for all would take noise of a difference for motion. The noise itself is the same in any direction.
    let together = inputs.iter().all(|c| c.t_s == first.t_s);
    if !together {
        let each: Option<Vec<Smoothed>> =
            inputs.iter().map(|c| without_noise(std::slice::from_ref(c))).collect();
        let each = each?;
        let noise = (each.iter().map(|s| s.noise * s.noise).sum::<f64>() / each.len() as f64).sqrt();
        let reach_s = each.iter().map(|s| s.reach_s).fold(0.0, f64::max);
        return Some(Smoothed { inputs: each.into_iter().flat_map(|s| s.inputs).collect(), noise, reach_s });
    }
    let columns: Vec<Vec<f64>> = inputs.iter().map(|c| c.component(0)).collect();
    let basis = principal_axes(&columns);
    let modes: Vec<Vec<f64>> = (0..inputs.len())
        .map(|m| {
            (0..first.len()).map(|i| (0..inputs.len()).map(|r| basis[(r, m)] * columns[r][i]).sum()).collect()
        })
        .collect();
    let fourier = Fourier::new(length);
    let segments = segments(&runs, length);
    if segments.len() < FEWEST_SEGMENTS {
        return None;
    }
    let spectra: Vec<Vec<f64>> = modes.iter().map(|m| fourier.power(m, &segments)).collect();
    // White noise is the same in every direction: the quietest of them says most truly how much it is.
    let floor = spectra.iter().filter_map(|s| noise_floor(s)).fold(f64::INFINITY, f64::min);
    let kernels: Vec<Vec<f64>> = spectra.iter().map(|s| fourier.kernel(&shares(s, floor))).collect();
    let smoothed: Vec<Vec<f64>> = modes.iter().zip(&kernels).map(|(m, k)| filtered(m, &runs, k)).collect();
    let reach_s = period_s * kernels.iter().map(|k| reach(k)).fold(0.0, f64::max);
    let mut removed = 0.0;
    let inputs = (0..inputs.len())
        .map(|r| {
            let values = (0..first.len())
                .map(|i| {
                    let value: f64 = (0..smoothed.len()).map(|m| basis[(r, m)] * smoothed[m][i]).sum();
                    removed += (value - columns[r][i]).powi(2);
                    [value]
                })
                .collect();
            Channel::new(first.t_s.clone(), values)
        })
        .collect();
    let noise = (removed / (columns.len() * first.len()).max(1) as f64).sqrt();
    Some(Smoothed { inputs, noise, reach_s })
}

/// Stretches of a record without interruption: (first, one after the last).
fn runs(t_s: &[f64], period_s: f64) -> Vec<(usize, usize)> {
    let mut out = Vec::new();
    let mut from = 0;
    for i in 1..=t_s.len() {
        if i == t_s.len() || t_s[i] - t_s[i - 1] > INTERRUPTED * period_s {
            out.push((from, i));
            from = i;
        }
    }
    out
}

/// Starts of half-overlapping segments, spread over the record.
fn segments(runs: &[(usize, usize)], length: usize) -> Vec<usize> {
    let all: Vec<usize> = runs
        .iter()
        .flat_map(|(from, to)| (*from..(to + 1).saturating_sub(length)).step_by((length / 2).max(1)))
        .collect();
    let step = all.len().div_ceil(MOST_SEGMENTS).max(1);
    all.into_iter().step_by(step).collect()
}

/// Directions in which rotors move together, as columns: the eigenvectors of their covariance.
fn principal_axes(columns: &[Vec<f64>]) -> DMatrix<f64> {
    let n = columns.len();
    let means: Vec<f64> = columns.iter().map(|c| c.iter().sum::<f64>() / c.len().max(1) as f64).collect();
    let covariance = DMatrix::from_fn(n, n, |a, b| {
        columns[a].iter().zip(&columns[b]).map(|(x, y)| (x - means[a]) * (y - means[b])).sum::<f64>()
    });
    SymmetricEigen::new(covariance).eigenvectors
}

/// One segment's Fourier coefficients: (cosine, sine) by frequency.
type Line = Vec<(f64, f64)>;

/// The discrete Fourier transform of segments of one length under Hann's window.
struct Fourier {
    length: usize,
    window: Vec<f64>,
    cosine: Vec<f64>,
}

impl Fourier {
    fn new(length: usize) -> Self {
        let turn = 2.0 * core::f64::consts::PI / length as f64;
        let cosine: Vec<f64> = (0..length).map(|i| (turn * i as f64).cos()).collect();
        let window = cosine.iter().map(|c| 0.5 - 0.5 * c).collect();
        Self { length, window, cosine }
    }

    /// Cosine and sine of `2π·k·i/length`, by table.
    fn turn(&self, k: usize, i: usize) -> (f64, f64) {
        let at = k * i % self.length;
        (self.cosine[at], self.cosine[(at + 3 * self.length / 4) % self.length])
    }

    /// Coefficients of one segment without its straight line, below half the sample rate.
    fn line(&self, values: &[f64]) -> Line {
        let n = self.length as f64;
        let mean = values.iter().sum::<f64>() / n;
        let middle = 0.5 * (n - 1.0);
        let (mut across, mut square) = (0.0, 0.0);
        for (i, v) in values.iter().enumerate() {
            across += (i as f64 - middle) * (v - mean);
            square += (i as f64 - middle).powi(2);
        }
        let slope = across / square;
        let rest: Vec<f64> = values
            .iter()
            .enumerate()
            .map(|(i, v)| self.window[i] * (v - mean - slope * (i as f64 - middle)))
            .collect();
        (0..self.length / 2)
            .map(|k| {
                rest.iter().enumerate().fold((0.0, 0.0), |(c, s), (i, v)| {
                    let (cos, sin) = self.turn(k, i);
                    (c + v * cos, s + v * sin)
                })
            })
            .collect()
    }

    /// Power of an input by frequency, mean over segments.
    fn power(&self, input: &[f64], segments: &[usize]) -> Vec<f64> {
        let mut sum = vec![0.0; self.length / 2];
        for from in segments {
            for (sum, (c, s)) in sum.iter_mut().zip(self.line(&input[*from..from + self.length])) {
                *sum += (c * c + s * s) / segments.len() as f64;
            }
        }
        sum
    }

    /// The kernel without phase whose frequency response is `shares`, one way from its middle, under Hann's window.
    fn kernel(&self, shares: &[f64]) -> Vec<f64> {
        let half = self.length / 2;
        let n = self.length as f64;
        let mut out: Vec<f64> = (0..half)
            .map(|i| {
                let sum: f64 = shares
                    .iter()
                    .enumerate()
                    .map(|(k, share)| if k == 0 { 1.0 } else { 2.0 } * share * self.turn(k, i).0)
                    .sum();
                let last = if i % 2 == 0 { 1.0 } else { -1.0 } * shares.last().copied().unwrap_or(0.0);
                (sum + last) / n * (0.5 + 0.5 * (core::f64::consts::PI * i as f64 / half as f64).cos())
            })
            .collect();
        let sum = out[0] + 2.0 * out[1..].iter().sum::<f64>();
        out.iter_mut().for_each(|w| *w /= sum);
        out
    }
}

/// Power of the noise: the median of the upper frequencies, in which rotors do not move.
fn noise_floor(power: &[f64]) -> Option<f64> {
    let at = |share: f64| (share * power.len() as f64) as usize;
    clean::median(power[at(NOISE_BAND[0])..at(NOISE_BAND[1])].to_vec())
}

/// Share of each frequency that is no noise: never more at a higher frequency, for rotors follow slow commands better.
fn shares(power: &[f64], floor: f64) -> Vec<f64> {
    let mut least: f64 = 1.0;
    power
        .iter()
        .enumerate()
        .map(|(k, power)| {
            // The straight line was taken out of the lowest ones.
            let white =
                if k < 2 { 1.0 } else { (1.0 - floor / power.max(f64::MIN_POSITIVE)).clamp(0.0, 1.0) };
            least = least.min(white);
            least
        })
        .collect()
}

/// Root mean square distance of a kernel's weights from its middle, samples.
fn reach(kernel: &[f64]) -> f64 {
    let mut sums = (0.0, kernel[0] * kernel[0]);
    for (i, w) in kernel.iter().enumerate().skip(1) {
        sums.0 += 2.0 * w * w * (i * i) as f64;
        sums.1 += 2.0 * w * w;
    }
    (sums.0 / sums.1).sqrt()
}

/// A record under a kernel without phase; at its ends the weights that are left stand for all.
fn filtered(values: &[f64], runs: &[(usize, usize)], kernel: &[f64]) -> Vec<f64> {
    let mut out = values.to_vec();
    for (from, to) in runs {
        let part = &values[*from..*to];
        // About its mean, so that the ends do not lean.
        for i in 0..part.len() {
            let reach = kernel.len().min(i + 1).min(part.len() - i);
            let (mut sum, mut weights) = (kernel[0] * part[i], kernel[0]);
            for j in 1..reach {
                sum += kernel[j] * (part[i - j] + part[i + j]);
                weights += 2.0 * kernel[j];
            }
            // Few weights are left close to an end: the sample itself is the better one.
            out[from + i] = if weights > 0.5 { sum / weights } else { part[i] };
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Key, purpose};

    const HZ: f64 = 500.0;

    /// Four rotors that turn a vehicle slowly to and fro, with white noise of `sigma`.
    fn flown(sigma: f64, n: usize) -> (Vec<Channel<1>>, Vec<Vec<f64>>) {
        let key = Key { seed: 5, world: 0, drone: 0, step: 0, purpose: purpose("inputs test") };
        let mut dice = key.stream();
        let mut truth = vec![Vec::new(); 4];
        let mut inputs = vec![Channel::<1>::default(); 4];
        let mut state = [0.0; 3];
        for i in 0..n {
            let t = i as f64 / HZ;
            for k in 0..3 {
                // A first-order lag of 40 ms under white commands.
                state[k] += (-state[k] / 0.04 + 400.0 * dice.normal()) / HZ;
            }
            let all = 1500.0 + 10.0 * (3.0 * t).sin();
            let [a, b, c] = state;
            for (r, value) in
                [all + a + b + c, all + a - b - c, all - a + b - c, all - a - b + c].into_iter().enumerate()
            {
                truth[r].push(value);
                inputs[r].push(t, [value + sigma * dice.normal()]);
            }
        }
        (inputs, truth)
    }

    fn slope(x: &[f64], y: &[f64]) -> f64 {
        let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
        let (mx, my) = (mean(x), mean(y));
        let across: f64 = x.iter().zip(y).map(|(a, b)| (a - mx) * (b - my)).sum();
        across / x.iter().map(|a| (a - mx).powi(2)).sum::<f64>()
    }

    #[test]
    fn smoothed_inputs_answer_as_the_true_ones_do() {
        let (inputs, truth) = flown(4.0, 10_000);
        let out = without_noise(&inputs).unwrap();
        let roll = |c: &dyn Fn(usize, usize) -> f64| -> Vec<f64> {
            (300..9700).map(|i| c(0, i) + c(1, i) - c(2, i) - c(3, i)).collect()
        };
        let (noisy, smooth) =
            (roll(&|r, i| inputs[r].values[i][0]), roll(&|r, i| out.inputs[r].values[i][0]));
        let exact = roll(&|r, i| truth[r][i]);
        // Noise halves the slope of the truth by the noisy input; by the smoothed one it is 1.
        assert!(slope(&noisy, &exact) < 0.75, "{}", slope(&noisy, &exact));
        assert!((slope(&smooth, &exact) - 1.0).abs() < 0.05, "{}", slope(&smooth, &exact));
        assert!((out.noise / 4.0 - 1.0).abs() < 0.15, "{}", out.noise);
    }

    #[test]
    fn exact_inputs_stay_as_they_are() {
        let (inputs, _) = flown(0.0, 10_000);
        let out = without_noise(&inputs).unwrap();
        for (a, b) in inputs.iter().zip(&out.inputs) {
            assert_eq!(a.t_s, b.t_s);
            let scatter = clean::robust_sigma(&a.component(0)).unwrap();
            let off: f64 = a.values[300..9700]
                .iter()
                .zip(&b.values[300..9700])
                .map(|(x, y)| (x[0] - y[0]).powi(2))
                .sum();
            assert!((off / 9400.0).sqrt() < 0.1 * scatter, "{}", (off / 9400.0).sqrt());
        }
    }

    #[test]
    fn a_short_or_interrupted_record_says_nothing_of_its_noise() {
        let (inputs, _) = flown(4.0, 700);
        assert!(without_noise(&inputs).is_none());
        assert_eq!(runs(&[0.0, 0.01, 0.02, 0.2, 0.21], 0.01), vec![(0, 3), (3, 5)]);
    }
}
