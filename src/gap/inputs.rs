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
//! Noise is known by two signs: white noise has the same power at all frequencies, most of which rotors with their inertia
//! do not reach; and what is no motion of the rotors turns nothing: it does not go with what gyroscope and accelerometer
//! read (coherence: Bendat and Piersol, "Random data", 4th ed. 2010, ch. 6).

use super::policy::{COHERENT_FROM, NOISE_BAND};
use crate::flight::{Channel, clean, resample};
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

/// What the vehicle did, to hold inputs against.
pub(super) struct Response<'a> {
    /// Body rates, rad/s.
    pub gyro: &'a Channel<3>,
    /// Specific force, m/s².
    pub accel: &'a Channel<3>,
}

/// Spectra of an input and of what answers it, by frequency.
struct Spectra {
    /// Power of the input.
    power: Vec<f64>,
    /// The largest coherence with any answer, 0 to 1; empty where nothing was measured that answers.
    coherence: Vec<f64>,
}

/// The inputs without noise; `None` where the record is too short to tell noise from signal.
pub(super) fn without_noise(inputs: &[Channel<1>], response: &Response) -> Option<Smoothed> {
    let first = inputs.first()?;
    let period_s = first.period_s()?;
    let length = ((SEGMENT_S / period_s).round() as usize / 2 * 2).max(8);
    let runs = runs(&first.t_s, period_s);
    // Rotors that are read together are smoothed together: sums and differences of them move by different amounts, and one
    // filter for all would take noise of a difference for motion. The noise itself is the same in any direction.
    let together = inputs.iter().all(|c| c.t_s == first.t_s);
    if !together {
        let each: Option<Vec<Smoothed>> =
            inputs.iter().map(|c| without_noise(std::slice::from_ref(c), response)).collect();
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
    let answers = answers(&first.t_s, response);
    let fourier = Fourier::new(length);
    let segments = segments(&runs, length);
    if segments.len() < FEWEST_SEGMENTS {
        return None;
    }
    let answer_spectra: Vec<Vec<Option<Line>>> =
        answers.iter().map(|a| fourier.lines(a, &segments)).collect();
    let spectra: Vec<Spectra> =
        modes.iter().map(|m| fourier.spectra(m, &answer_spectra, &segments)).collect();
    // White noise is the same in every direction: the quietest of them says most truly how much it is.
    let floor = spectra.iter().filter_map(|s| noise_floor(&s.power)).fold(f64::INFINITY, f64::min);
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

/// What answers the inputs, at their times: angular acceleration and specific force, per axis.
fn answers(t_s: &[f64], response: &Response) -> Vec<Vec<Option<f64>>> {
    let mut out = Vec::new();
    for (channel, slope) in [(response.gyro, true), (response.accel, false)] {
        let Some(period_s) = channel.period_s() else { continue };
        let local = resample::local_parabola(channel, t_s, (2.2 * period_s).max(0.005));
        for k in 0..3 {
            let pick = |l: &resample::Local<3>| if slope { l.slope[k] } else { l.value[k] };
            out.push(local.iter().map(|l| l.as_ref().map(pick)).collect());
        }
    }
    out
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

    /// Coefficients of every segment; `None` where a value is missing.
    fn lines(&self, values: &[Option<f64>], segments: &[usize]) -> Vec<Option<Line>> {
        segments
            .iter()
            .map(|from| {
                let part: Option<Vec<f64>> = values[*from..from + self.length].iter().copied().collect();
                Some(self.line(&part?))
            })
            .collect()
    }

    /// Power of an input, and its coherence with what answers it.
    fn spectra(&self, input: &[f64], answers: &[Vec<Option<Line>>], segments: &[usize]) -> Spectra {
        let half = self.length / 2;
        let lines: Vec<Line> = segments.iter().map(|s| self.line(&input[*s..s + self.length])).collect();
        let square = |(c, s): (f64, f64)| c * c + s * s;
        let power =
            (0..half).map(|k| lines.iter().map(|l| square(l[k])).sum::<f64>() / lines.len() as f64).collect();
        let mut coherence = vec![0.0; if answers.is_empty() { 0 } else { half }];
        for answer in answers {
            let both: Vec<(&Line, &Line)> =
                lines.iter().zip(answer).filter_map(|(l, a)| Some((l, a.as_ref()?))).collect();
            if both.len() < FEWEST_SEGMENTS {
                continue;
            }
            for (k, most) in coherence.iter_mut().enumerate() {
                let (mut xx, mut yy, mut re, mut im) = (0.0, 0.0, 0.0, 0.0);
                for (x, y) in &both {
                    xx += square(x[k]);
                    yy += square(y[k]);
                    re += x[k].0 * y[k].0 + x[k].1 * y[k].1;
                    im += x[k].0 * y[k].1 - x[k].1 * y[k].0;
                }
                let raw = (re * re + im * im) / (xx * yy).max(f64::MIN_POSITIVE);
                // So many segments agree by chance to the inverse of their number.
                let chance = 1.0 / both.len() as f64;
                *most = f64::max(*most, ((raw - chance) / (1.0 - chance)).max(0.0));
            }
        }
        Spectra { power, coherence }
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
fn shares(spectra: &Spectra, floor: f64) -> Vec<f64> {
    let coherence = &spectra.coherence;
    let peak = (1..coherence.len()).max_by(|a, b| coherence[*a].total_cmp(&coherence[*b]));
    // Where the answer says little at best, it is the answer that is noisy.
    let telling = peak.filter(|k| coherence[*k] > COHERENT_FROM);
    let mut least: f64 = 1.0;
    (0..spectra.power.len())
        .map(|k| {
            let white = (1.0 - floor / spectra.power[k].max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
            // The straight line was taken out of the lowest ones.
            let mut share = if k < 2 { 1.0 } else { white };
            if let Some(peak) = telling.filter(|peak| k > *peak) {
                share = share.min(coherence[k] / coherence[peak]);
            }
            least = least.min(share);
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

    /// Four rotors that turn a vehicle slowly to and fro, with white noise of `sigma`; and what the gyroscope reads.
    fn flown(sigma: f64, n: usize) -> (Vec<Channel<1>>, Vec<Vec<f64>>, Channel<3>) {
        let key = Key { seed: 5, world: 0, drone: 0, step: 0, purpose: purpose("inputs test") };
        let mut dice = key.stream();
        let mut truth = vec![Vec::new(); 4];
        let (mut inputs, mut gyro) = (vec![Channel::<1>::default(); 4], Channel::<3>::default());
        let (mut state, mut rate) = ([0.0; 3], [0.0; 3]);
        for i in 0..n {
            let t = i as f64 / HZ;
            for k in 0..3 {
                // A first-order lag of 40 ms under white commands.
                state[k] += (-state[k] / 0.04 + 400.0 * dice.normal()) / HZ;
                rate[k] += (0.5 * state[k] - 3.0 * rate[k]) / HZ;
            }
            let all = 1500.0 + 10.0 * (3.0 * t).sin();
            let [a, b, c] = state;
            for (r, value) in
                [all + a + b + c, all + a - b - c, all - a + b - c, all - a - b + c].into_iter().enumerate()
            {
                truth[r].push(value);
                inputs[r].push(t, [value + sigma * dice.normal()]);
            }
            gyro.push(t, rate.map(|w| w + 1e-3 * dice.normal()));
        }
        (inputs, truth, gyro)
    }

    fn slope(x: &[f64], y: &[f64]) -> f64 {
        let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
        let (mx, my) = (mean(x), mean(y));
        let across: f64 = x.iter().zip(y).map(|(a, b)| (a - mx) * (b - my)).sum();
        across / x.iter().map(|a| (a - mx).powi(2)).sum::<f64>()
    }

    #[test]
    fn smoothed_inputs_answer_as_the_true_ones_do() {
        let (inputs, truth, gyro) = flown(4.0, 10_000);
        let none = Channel::default();
        let out = without_noise(&inputs, &Response { gyro: &gyro, accel: &none }).unwrap();
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
        let (inputs, _, gyro) = flown(0.0, 10_000);
        let none = Channel::default();
        let out = without_noise(&inputs, &Response { gyro: &gyro, accel: &none }).unwrap();
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
        let (inputs, _, gyro) = flown(4.0, 700);
        let none = Channel::default();
        assert!(without_noise(&inputs, &Response { gyro: &gyro, accel: &none }).is_none());
        assert_eq!(runs(&[0.0, 0.01, 0.02, 0.2, 0.21], 0.01), vec![(0, 3), (3, 5)]);
    }
}
