//! Errors of measured inputs: the noise of rotor speeds or of a thrust, and the smoothed inputs.
//!
//! A fit that treats a noisy input as exact underestimates the vehicle's response: regression dilution. 4 rad/s of noise on
//! rotor speeds become torques several times larger than those of a gentle flight, and mass and thrust were then found at a
//! fifth of their values. Replacing an input by its expectation given the whole record removes this bias, since its
//! remaining error is uncorrelated with it (regression calibration: Carroll, Ruppert, Stefanski and Crainiceanu,
//! "Measurement error in nonlinear models", 2nd ed. 2006, ch. 4). The expectation is the Wiener smoother: every frequency
//! is scaled by the share of its power that is not noise ("Extrapolation, interpolation and smoothing of stationary time
//! series", 1949, ch. 3).
//!
//! Noise is identified by its flat power at high frequencies, which rotors with their inertia do not follow. Narrow-band
//! noise that a logger adds (a beat of the rotors) cannot be told from motion.

use super::policy::NOISE_BAND;
use nalgebra::{DMatrix, SymmetricEigen};
use propwash_flight::{Channel, clean};
use rayon::prelude::*;

/// Length of one segment of a spectrum, s: a resolution of 2 Hz.
const SEGMENT_S: f64 = 0.5;
/// Share of noise in a direction's power at low frequencies above which motion counts as faint: the response would be
/// underestimated by a tenth.
const FAINT: f64 = 0.1;
/// Segment length where motion is slow, s: a resolution of 0.5 Hz, used up to [`SLOW_HZ`]. In a hover rotors hardly differ
/// at all below 3 Hz, and noise there was taken for motion: mass and thrust were found at a fifth of their values.
const SLOW_SEGMENT_S: f64 = 2.0;
/// Frequency up to which the longer segments are used, Hz.
const SLOW_HZ: f64 = 10.0;
/// Most segments averaged in a spectrum, and fewest for a usable one.
const MOST_SEGMENTS: usize = 120;
const FEWEST_SEGMENTS: usize = 8;
/// Interval between samples, over the usual one, above which a record counts as interrupted …
const INTERRUPTED: f64 = 3.5;
/// … if it is at least this long, s: held samples leave shorter gaps, in which nothing in the pass band changes much.
const INTERRUPTED_S: f64 = 0.05;

/// Smoothed inputs.
pub(super) struct Smoothed {
    /// The inputs, at the sample times.
    pub inputs: Vec<Channel<1>>,
    /// Standard deviation of the removed noise, unit of the inputs.
    pub noise: f64,
    /// What was smoothed.
    pub smoothing: Smoothing,
}

/// How measured inputs were smoothed, and the remaining uncertainty.
#[derive(Clone, Debug, Default)]
pub(crate) struct Smoothing {
    /// Smoothing time (root mean square width of the kernel, the widest of all directions), s.
    pub reach_s: f64,
    directions: Vec<Direction>,
}

/// Inputs that were smoothed together: mean squares of the smoothed one about its mean, and of its remaining noise.
#[derive(Clone, Debug)]
struct Direction {
    /// Weight of every input.
    of: Vec<f64>,
    all: [f64; 2],
    /// The same of its differences from sample to sample.
    changes: [f64; 2],
    /// Effective number of independent noise values.
    values: f64,
}

impl Smoothing {
    /// Relative uncertainty of the vehicle's response to a sum of the inputs (`weights`), over all records: smoothed inputs
    /// are unbiased only as far as the power of their noise is known, and where noise is much larger than motion, chance
    /// alone leaves as much as the motion. `changes`: the response to the rate of change of the sum.
    pub fn doubt<'a>(all: impl Iterator<Item = &'a Self>, weights: &[f64], changes: bool) -> f64 {
        let (mut variance, mut signal) = (0.0, 0.0);
        for direction in all.flat_map(|s| &s.directions) {
            let along: f64 = direction.of.iter().zip(weights).map(|(a, b)| a * b).sum();
            let [power, noise] = if changes { direction.changes } else { direction.all };
            variance += (along * along * noise).powi(2) / direction.values;
            signal += along * along * (power - noise).max(0.0);
        }
        if variance > 0.0 {
            (variance.sqrt() / signal.max(f64::MIN_POSITIVE)).min(NOTHING_KNOWN)
        } else {
            0.0
        }
    }
}

impl Direction {
    /// What is left of motion and of white noise with the mean square `white` in a direction, smoothed by a filter.
    fn of(of: Vec<f64>, smoothed: &[f64], kernel: &[f64], shares: &[f64], white: f64) -> Self {
        // In a direction indistinguishable from noise, at least one line's worth of noise remains.
        let line = 1.0 / kernel.len() as f64;
        let slow = (core::f64::consts::PI * line).powi(2);
        let [all, changes] = passed(kernel);
        let [all, changes] = [all.max(line) * white, changes.max(slow * line) * white];
        let (power, change) = mean_squares(smoothed);
        Self {
            of,
            all: [power, all],
            changes: [change, changes],
            values: (bandwidth(shares) * smoothed.len() as f64).max(1.0),
        }
    }
}

/// Relative uncertainty of a response of which nothing is known.
const NOTHING_KNOWN: f64 = 3.0;

/// Smooths the inputs; `None` where the record is too short to separate noise from signal.
pub(super) fn without_noise(inputs: &[Channel<1>]) -> Option<Smoothed> {
    let first = inputs.first()?;
    let runs = runs(&first.t_s, (INTERRUPTED * first.period_s()?).max(INTERRUPTED_S));
    // The mean interval: where every second sample was held and left out, steps of one and of two alternate.
    let steps = runs.iter().map(|(from, to)| to - 1 - from).sum::<usize>().max(1) as f64;
    let period_s = runs.iter().map(|(from, to)| first.t_s[to - 1] - first.t_s[*from]).sum::<f64>() / steps;
    if period_s <= 0.0 {
        return None;
    }
    let length = ((SEGMENT_S / period_s).round() as usize / 2 * 2).max(8);
    // Rotors sampled together are smoothed together: their sums and differences move by different amounts, and one filter
    // for all would take the noise of a difference for motion. The noise itself is the same in any direction.
    let together = inputs.iter().all(|c| c.t_s == first.t_s);
    if !together {
        return each_alone(inputs);
    }
    let columns: Vec<Vec<f64>> = inputs.iter().map(|c| c.component(0)).collect();
    let basis = principal_axes(&columns);
    let modes: Vec<Vec<f64>> = (0..inputs.len())
        .map(|m| {
            (0..first.len()).map(|i| (0..inputs.len()).map(|r| basis[(r, m)] * columns[r][i]).sum()).collect()
        })
        .collect();
    let Wiener { kernels, shares, white } = Wiener::of(&modes, &runs, length)?;
    let smoothed: Vec<Vec<f64>> =
        modes.par_iter().zip(&kernels).map(|(m, k)| filtered(m, &runs, k)).collect();
    let directions: Vec<Direction> = (0..modes.len())
        .map(|m| {
            let of = basis.column(m).iter().copied().collect();
            Direction::of(of, &smoothed[m], &kernels[m], &shares[m], white)
        })
        .collect();
    let smoothing =
        Smoothing { reach_s: period_s * kernels.iter().map(|k| reach(k)).fold(0.0, f64::max), directions };
    // Back from directions to inputs.
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
    Some(Smoothed { inputs, noise, smoothing })
}

/// Inputs with times of their own: each is smoothed by itself, as a direction of its own.
fn each_alone(inputs: &[Channel<1>]) -> Option<Smoothed> {
    let each: Option<Vec<Smoothed>> = inputs.iter().map(|c| without_noise(std::slice::from_ref(c))).collect();
    let each = each?;
    let noise = (each.iter().map(|s| s.noise * s.noise).sum::<f64>() / each.len() as f64).sqrt();
    let mut smoothing = Smoothing::default();
    for (i, one) in each.iter().enumerate() {
        smoothing.reach_s = smoothing.reach_s.max(one.smoothing.reach_s);
        let mut of = vec![0.0; each.len()];
        of[i] = 1.0;
        let own = one.smoothing.directions.iter();
        smoothing.directions.extend(own.map(|d| Direction { of: of.clone(), ..d.clone() }));
    }
    Some(Smoothed { inputs: each.into_iter().flat_map(|s| s.inputs).collect(), noise, smoothing })
}

/// Wiener smoothers of directions.
struct Wiener {
    /// The filter of each, in time.
    kernels: Vec<Vec<f64>>,
    /// The share that it passes, by frequency.
    shares: Vec<Vec<f64>>,
    /// Mean square of the white noise in any direction.
    white: f64,
}

impl Wiener {
    /// From spectra of segments of `length` samples; `None` where there are too few.
    fn of(modes: &[Vec<f64>], runs: &[(usize, usize)], length: usize) -> Option<Self> {
        let fast = Spectra::new(modes, runs, length, length / 2)?;
        // White noise is the same in every direction: the quietest one gives the best estimate of it.
        let floor = fast.power.iter().filter_map(|s| noise_floor(s)).fold(f64::INFINITY, f64::min);
        let longer = (SLOW_SEGMENT_S / SEGMENT_S) as usize;
        let slow_lines = ((SLOW_HZ * SLOW_SEGMENT_S) as usize).min(longer * length / 2);
        let slow = Spectra::new(modes, runs, longer * length, slow_lines);
        // Slow and small motion needs its own, finer spectrum; elsewhere noise below 3 Hz is small, and all of it passes.
        let (kernels, shares) = (0..modes.len())
            .map(|m| match slow.as_ref().filter(|slow| slow.is_faint(m, &fast, floor)) {
                Some(slow) => {
                    let shares = slow.refined(m, &fast, floor);
                    (slow.fourier.kernel(&shares), shares)
                }
                None => {
                    let shares = falling(fast.shares(m, floor), 0);
                    (fast.fourier.kernel(&shares), shares)
                }
            })
            .unzip();
        Some(Self { kernels, shares, white: floor / fast.fourier.square() })
    }
}

/// Uninterrupted parts of a record, with no step longer than `interrupted_s`: (first, one past the last).
fn runs(t_s: &[f64], interrupted_s: f64) -> Vec<(usize, usize)> {
    let mut out = Vec::new();
    let mut from = 0;
    for i in 1..=t_s.len() {
        if i == t_s.len() || t_s[i] - t_s[i - 1] > interrupted_s {
            out.push((from, i));
            from = i;
        }
    }
    out
}

/// Starts of half-overlapping segments, spread evenly over the record.
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

/// Fourier coefficients of one segment: (cosine, sine) by frequency.
type Line = Vec<(f64, f64)>;

/// Coefficients that are summed at the same time.
const ABREAST: usize = 8;

/// Discrete Fourier transform of segments of one length under a Hann window.
struct Fourier {
    length: usize,
    window: Vec<f64>,
    /// Of `2π·i/length`.
    cosine: Vec<f64>,
    sine: Vec<f64>,
}

impl Fourier {
    fn new(length: usize) -> Self {
        let turn = 2.0 * core::f64::consts::PI / length as f64;
        let cosine: Vec<f64> = (0..length).map(|i| (turn * i as f64).cos()).collect();
        let sine = (0..length).map(|i| cosine[(i + 3 * length / 4) % length]).collect();
        let window = cosine.iter().map(|c| 0.5 - 0.5 * c).collect();
        Self { length, window, cosine, sine }
    }

    /// Sum of the squares of the window: power of white noise of unit mean square.
    fn square(&self) -> f64 {
        self.window.iter().map(|w| w * w).sum()
    }

    /// Cosine of `2π·k·i/length`, from a table.
    fn cosine_of(&self, k: usize, i: usize) -> f64 {
        self.cosine[k * i % self.length]
    }

    /// The lowest `lines` coefficients of one detrended segment.
    fn line(&self, values: &[f64], lines: usize) -> Line {
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
        let mut out = Vec::with_capacity(lines);
        for first in (0..lines).step_by(ABREAST) {
            let many = self.abreast(&rest, first);
            out.extend_from_slice(&many[..ABREAST.min(lines - first)]);
        }
        out
    }

    /// [`ABREAST`] coefficients from `first` on: sums that wait for one another one by one do not together.
    fn abreast(&self, rest: &[f64], first: usize) -> [(f64, f64); ABREAST] {
        let mut out = [(0.0, 0.0); ABREAST];
        let step: [usize; ABREAST] = core::array::from_fn(|j| (first + j) % self.length);
        let mut at = [0; ABREAST];
        for v in rest {
            for j in 0..ABREAST {
                out[j].0 += v * self.cosine[at[j]];
                out[j].1 += v * self.sine[at[j]];
                let next = at[j] + step[j];
                at[j] = if next >= self.length { next - self.length } else { next };
            }
        }
        out
    }

    /// Power of an input by frequency, averaged over segments.
    fn power(&self, input: &[f64], segments: &[usize], lines: usize) -> Vec<f64> {
        let each: Vec<Line> =
            segments.par_iter().map(|from| self.line(&input[*from..from + self.length], lines)).collect();
        let mut sum = vec![0.0; lines];
        for line in each {
            for (sum, (c, s)) in sum.iter_mut().zip(line) {
                *sum += (c * c + s * s) / segments.len() as f64;
            }
        }
        sum
    }

    /// The zero-phase kernel with the frequency response `shares` (the first is at zero frequency), one side from its
    /// middle, under a Hann window.
    fn kernel(&self, shares: &[f64]) -> Vec<f64> {
        let half = self.length / 2;
        let n = self.length as f64;
        (0..half)
            .map(|i| {
                let sum: f64 = shares
                    .iter()
                    .enumerate()
                    .map(|(k, share)| if k == 0 { 1.0 } else { 2.0 } * share * self.cosine_of(k, i))
                    .sum();
                let last = if i % 2 == 0 { 1.0 } else { -1.0 } * shares.last().copied().unwrap_or(0.0);
                (sum + last) / n * (0.5 + 0.5 * (core::f64::consts::PI * i as f64 / half as f64).cos())
            })
            .collect()
    }
}

/// Noise floor: the median power at the upper frequencies, where rotors do not move.
fn noise_floor(power: &[f64]) -> Option<f64> {
    let at = |share: f64| (share * power.len() as f64) as usize;
    clean::median(power[at(NOISE_BAND[0])..at(NOISE_BAND[1])].to_vec())
}

/// Makes shares non-increasing from frequency `from` on: rotors follow slow commands better.
fn falling(mut shares: Vec<f64>, from: usize) -> Vec<f64> {
    for k in from + 1..shares.len() {
        shares[k] = shares[k].min(shares[k - 1]);
    }
    shares
}

/// Spectra of all directions from segments of one length.
struct Spectra {
    fourier: Fourier,
    /// Power by direction and frequency, averaged over the segments.
    power: Vec<Vec<f64>>,
    /// Mean square of the segments' means about the overall mean, by direction.
    drift: Vec<f64>,
    segments: usize,
}

impl Spectra {
    /// The lowest `lines` frequencies; `None` where the record has too few segments.
    fn new(modes: &[Vec<f64>], runs: &[(usize, usize)], length: usize, lines: usize) -> Option<Self> {
        let fourier = Fourier::new(length);
        let segments = segments(runs, length);
        if segments.len() < FEWEST_SEGMENTS {
            return None;
        }
        let power = modes.iter().map(|m| fourier.power(m, &segments, lines)).collect();
        let drift = modes.iter().map(|m| {
            let of = |from: &usize| m[*from..from + length].iter().sum::<f64>() / length as f64;
            let means: Vec<f64> = segments.iter().map(of).collect();
            mean_squares(&means).0
        });
        Some(Self { drift: drift.collect(), fourier, power, segments: segments.len() })
    }

    /// Share of each frequency of direction `m` that is not noise. The lowest two, affected by the detrending, all pass.
    fn shares(&self, m: usize, floor: f64) -> Vec<f64> {
        let share = |power: &f64| (1.0 - floor / power.max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        self.power[m].iter().enumerate().map(|(k, power)| if k < 2 { 1.0 } else { share(power) }).collect()
    }

    /// Whether noise exceeds [`FAINT`] of the power of direction `m` below the frequencies that `fast` resolves.
    fn is_faint(&self, m: usize, fast: &Self, floor: f64) -> bool {
        let longer = self.fourier.length / fast.fourier.length;
        let of_mean = floor / fast.fourier.square() / self.fourier.length as f64;
        // In units of a line's noise. A segment's mean counts as half a line.
        let lines = &self.power[m][1..(2 * longer).min(self.power[m].len())];
        let held = 0.5 * self.drift[m] / of_mean + lines.iter().sum::<f64>() / (floor * longer as f64);
        (0.5 + lines.len() as f64) > FAINT * held
    }

    /// The shares on these longer segments: from their own spectrum as far as it reaches, above that from `fast`, whose
    /// noise has the power `floor`.
    fn refined(&self, m: usize, fast: &Self, floor: f64) -> Vec<f64> {
        let longer = self.fourier.length / fast.fourier.length;
        // Power of white noise grows with the length of a segment. An excess that chance alone could produce does not count
        // as motion; of what does, the share that is right on average passes: a smaller one would overestimate the
        // response.
        let kept = |power: f64, noise: f64, chance: f64| {
            if power > noise * (1.0 + chance) { 1.0 - noise / power } else { 0.0 }
        };
        let noise = floor * longer as f64;
        // Two standard deviations: of the mean of three lines, of one line, and of half as many means, since segments
        // overlap by half.
        let n = self.segments as f64;
        let [of_near, of_one, of_drift] = [3.0 * n, n, 0.25 * n].map(|values| 2.0 / values.sqrt());
        let own = &self.power[m];
        let near = |k: usize| {
            let part = &own[k.max(3) - 1..(k + 2).min(own.len())];
            part.iter().sum::<f64>() / part.len() as f64
        };
        let share = |k: usize| kept(near(k), noise, of_near);
        let above = fast.shares(m, floor);
        let of_mean = floor / fast.fourier.square() / self.fourier.length as f64;
        let slowest = kept(self.drift[m], of_mean, of_drift);
        // The next frequency lost power to detrending: what it shows is a lower bound. Figures with periods of 2 s and
        // longer lie there.
        let at_one = kept(own[1], noise, of_one).max(slowest).max(share(2));
        let all = (0..self.fourier.length / 2).map(|k| match k {
            0 => slowest,
            1 => at_one,
            k if k < own.len() => share(k),
            k => above[(k / longer).min(above.len() - 1)],
        });
        let most = (2..own.len()).max_by(|a, b| near(*a).total_cmp(&near(*b))).unwrap_or(0);
        falling(all.collect(), most)
    }
}

/// Shares of white noise's mean square passed by a kernel: of the noise itself, and of the differences of its samples.
fn passed(kernel: &[f64]) -> [f64; 2] {
    let square = |v: &mut dyn Iterator<Item = f64>| v.map(|w| w * w).sum::<f64>();
    let all = 2.0 * square(&mut kernel.iter().copied()) - kernel[0] * kernel[0];
    let beyond = kernel.iter().skip(1).copied().chain([0.0]);
    let changes = 2.0 * square(&mut kernel.iter().zip(beyond).map(|(a, b)| b - a));
    [all, changes]
}

/// Mean squares of a record about its mean, and of the differences of neighbouring samples.
fn mean_squares(values: &[f64]) -> (f64, f64) {
    let n = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / n;
    let power = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n;
    (power, values.windows(2).map(|w| (w[1] - w[0]).powi(2)).sum::<f64>() / n)
}

/// Noise bandwidth of the shares over the sample rate: independent values per sample.
fn bandwidth(shares: &[f64]) -> f64 {
    let sum = |power: i32| shares.iter().map(|s| s.powi(power)).sum::<f64>();
    sum(2).powi(2) / (sum(4).max(f64::MIN_POSITIVE) * 2.0 * shares.len() as f64)
}

/// Root mean square width of a kernel, by its squared weights, samples.
fn reach(kernel: &[f64]) -> f64 {
    let mut sums = (0.0, kernel[0] * kernel[0]);
    for (i, w) in kernel.iter().enumerate().skip(1) {
        sums.0 += 2.0 * w * w * (i * i) as f64;
        sums.1 += 2.0 * w * w;
    }
    (sums.0 / sums.1).sqrt()
}

/// Mean about sample `i` with all weights of a kernel that lie within the record.
fn one_sided(part: &[f64], kernel: &[f64], i: usize) -> f64 {
    let first = (i + 1).saturating_sub(kernel.len());
    let (mut sum, mut weights) = (0.0, 0.0);
    for (j, value) in part.iter().enumerate().take(i + kernel.len()).skip(first) {
        sum += kernel[i.abs_diff(j)] * value;
        weights += kernel[i.abs_diff(j)];
    }
    if weights > 0.25 { sum / weights } else { part[i] }
}

/// A record under a zero-phase kernel, about its mean, which is kept; near its ends the remaining weights are renormalised.
fn filtered(values: &[f64], runs: &[(usize, usize)], kernel: &[f64]) -> Vec<f64> {
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    let about: Vec<f64> = values.iter().map(|v| v - mean).collect();
    let whole = kernel[0] + 2.0 * kernel[1..].iter().sum::<f64>();
    let mut out = values.to_vec();
    for (from, to) in runs {
        let part = &about[*from..*to];
        for i in 0..part.len() {
            // Symmetric, so that the ends are not biased.
            let reach = kernel.len().min(i + 1).min(part.len() - i);
            let (mut sum, mut weights) = (kernel[0] * part[i], kernel[0]);
            for j in 1..reach {
                sum += kernel[j] * (part[i - j] + part[i + j]);
                weights += 2.0 * kernel[j];
            }
            let value = if reach == kernel.len() || whole < 0.5 {
                sum
            } else if weights > 0.5 * whole {
                sum / weights * whole
            } else {
                // Near an end few weights remain: there one side stands for both.
                one_sided(part, kernel, i) * whole
            };
            out[from + i] = mean + value;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use propwash_rollout::random::{Key, purpose};

    const HZ: f64 = 500.0;

    /// Four rotors that turn a vehicle slowly back and forth, with white noise of `sigma`.
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
        // Noise halves the slope of the truth regressed on the noisy input; on the smoothed one it is 1.
        assert!(slope(&noisy, &exact) < 0.75, "{}", slope(&noisy, &exact));
        assert!((slope(&smooth, &exact) - 1.0).abs() < 0.05, "{}", slope(&smooth, &exact));
        assert!((out.noise / 4.0 - 1.0).abs() < 0.15, "{}", out.noise);
    }

    /// Rotors of a hover: they climb and sink slowly together, and turn the vehicle far less than their noise. The noise
    /// remaining below 3 Hz was once taken for motion to which the vehicle did not respond.
    #[test]
    fn what_a_hover_leaves_to_noise_is_no_motion() {
        let dice = |seed| Key { seed, world: 0, drone: 0, step: 0, purpose: purpose("inputs test") }.stream();
        let (mut noise, mut lift) = (dice(6), 0.0);
        let mut inputs = vec![Channel::<1>::default(); 4];
        for i in 0..15_000 {
            let t = i as f64 / HZ;
            lift += -lift / 0.3 / HZ + 30.0 * noise.normal() / HZ.sqrt();
            for (r, input) in inputs.iter_mut().enumerate() {
                let trim = if r < 2 { 12.0 } else { -12.0 };
                input.push(t, [1500.0 + trim + lift + 5.0 * noise.normal()]);
            }
        }
        let out = without_noise(&inputs).unwrap();
        let along = |inputs: &[Channel<1>], weights: [f64; 4]| -> Vec<f64> {
            let at = |i: usize| (0..4).map(|r| weights[r] * inputs[r].values[i][0]).sum();
            (0..15_000).map(at).collect()
        };
        let (together, roll) = ([1.0; 4], [1.0, 1.0, -1.0, -1.0]);
        let scatter = |v: &[f64]| mean_squares(v).0.sqrt();
        // 10 rad/s of noise in a sum of four, of which less than a twenty-fifth remains where nothing moves (a ninth, were
        // all kept below 3 Hz).
        assert!(scatter(&along(&out.inputs, roll)) < 0.4, "{}", scatter(&along(&out.inputs, roll)));
        let mean = along(&out.inputs, roll).iter().sum::<f64>() / 15_000.0;
        assert!((mean - 48.0).abs() < 0.5, "the trim stays: {mean}");
        let kept = scatter(&along(&out.inputs, together)) / scatter(&along(&inputs, together));
        assert!(kept > 0.9, "{kept}");
        let doubt = |weights: [f64; 4]| Smoothing::doubt([&out.smoothing].into_iter(), &weights, false);
        assert!(doubt(together) < 0.02 && doubt(roll) > 0.1, "{} {}", doubt(together), doubt(roll));
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
        assert_eq!(runs(&[0.0, 0.01, 0.02, 0.2, 0.21], 0.05), vec![(0, 3), (3, 5)]);
    }
}
