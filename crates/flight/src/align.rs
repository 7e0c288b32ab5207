//! How far two channels are out of step.

use super::channel::Channel;
use super::resample;
use rayon::prelude::*;
use serde::Serialize;

/// A delay between a measured channel and what another channel predicts for it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Lag {
    /// s; positive: the measured channel comes late.
    pub lag_s: f64,
    /// Standard deviation, s, from the scatter between parts of the log.
    pub sigma_s: f64,
    /// Share of the measured variance that the shifted prediction explains, 0 to 1.
    pub explained: f64,
    /// The same share without a shift.
    pub explained_at_zero: f64,
    /// Whether the best shift lies at the edge of the search range, so that the true one may be longer.
    pub at_edge: bool,
}

/// About so many samples tell where a correlation has its peak.
const COARSE: usize = 2000;
/// Parts of the log from whose scatter the uncertainty of a delay comes.
const PARTS: usize = 8;

/// The shift `d` for which `measured(t)` is best explained by a linear map of `predicted(t − d)` plus a constant,
/// searched within `± max_lag_s`: cross-correlation with a free mount, scale and bias. `predicted` must be smooth; it
/// is interpolated, `measured` never, so noise of the sensor favours no shift over another.
///
/// `None` with fewer than 64 common samples or where nothing moves. (Knapp and Carter, "The generalized correlation
/// method for estimation of time delay", IEEE Trans. ASSP 24(4), 1976, without pre-whitening.)
pub fn lag<const N: usize>(measured: &Channel<N>, predicted: &Channel<N>, max_lag_s: f64) -> Option<Lag> {
    let period = predicted.period_s()?;
    let (first, last) = (*predicted.t_s.first()?, *predicted.t_s.last()?);
    let used: Vec<usize> = (0..measured.len())
        .filter(|i| {
            let t = measured.t_s[*i];
            t - max_lag_s >= first && t + max_lag_s <= last
        })
        .collect();
    // Long logs need no more than this many samples to place a correlation peak.
    let stride = (used.len() / 20_000).max(1);
    let used: Vec<usize> = used.into_iter().step_by(stride).collect();
    if used.len() < 64 {
        return None;
    }
    let moments = |among: &[usize], d: f64| -> Vec<Moments<N>> {
        let at: Vec<f64> = among.iter().map(|i| measured.t_s[*i] - d).collect();
        let x = resample::cubic(predicted, &at, 10.0 * period);
        let mut parts = vec![Moments::default(); PARTS];
        for (k, (i, x)) in among.iter().zip(x).enumerate() {
            if let Some(x) = x {
                parts[k * PARTS / among.len()].add(x, measured.values[*i]);
            }
        }
        parts
    };
    let whole = |parts: &[Moments<N>]| {
        let mut whole = Moments::default();
        parts.iter().for_each(|p| whole.join(p));
        whole
    };
    // Coarse to fine: some samples tell about where, then all of them go on to where it is best.
    let coarse = (max_lag_s / 25.0).max(5e-4);
    let n = (max_lag_s / coarse).round() as i32;
    let few: Vec<usize> = used.iter().copied().step_by((used.len() / COARSE).max(1)).collect();
    let share = |parts: &[Moments<N>]| Some(whole(parts).solve()?.1);
    let at = |among: &[usize], k: i32| moments(among, f64::from(k) * coarse);
    let shares: Vec<Option<f64>> = (-n..=n).into_par_iter().map(|k| share(&at(&few, k))).collect();
    let about = (-n..=n).zip(&shares).filter_map(|(k, share)| Some((k, (*share)?)));
    let (mut k, _) = about.max_by(|a, b| a.1.total_cmp(&b.1))?;
    // The moments of the best shift, of the one before it and of the one after it.
    let mut centre = at(&used, k);
    let mut beside = [at(&used, k - 1), at(&used, k + 1)];
    let mut best_share = share(&centre)?;
    for (side, towards) in [(0, -1), (1, 1)] {
        while let Some(next) = share(&beside[side]).filter(|s| (k + towards).abs() <= n && *s > best_share) {
            (k, best_share) = (k + towards, next);
            beside[1 - side] = core::mem::replace(&mut centre, core::mem::take(&mut beside[side]));
            beside[side] = at(&used, k + towards);
        }
    }
    let best = f64::from(k) * coarse;
    let at_edge = best.abs() > max_lag_s - 1.5 * coarse;
    let step = coarse;
    // The map of the best shift, then a parabola through the losses of each part and of all.
    let (map, _) = whole(&centre).solve()?;
    let [before, after] = beside;
    let vertex = |part: &dyn Fn(&[Moments<N>]) -> f64| {
        let (a, b, c) = (part(&before), part(&centre), part(&after));
        let bend = a - 2.0 * b + c;
        (bend > 0.0).then(|| (0.5 * step * (a - c) / bend).clamp(-3.0 * step, 3.0 * step))
    };
    let all = vertex(&|parts: &[Moments<N>]| parts.iter().map(|p| p.loss(&map)).sum())?;
    let lag_s = best + if at_edge { 0.0 } else { all.clamp(-step, step) };
    let single: Vec<f64> = (0..PARTS).filter_map(|k| vertex(&|p: &[Moments<N>]| p[k].loss(&map))).collect();
    let sigma_s = if single.len() < 3 {
        f64::INFINITY
    } else {
        let mean = single.iter().sum::<f64>() / single.len() as f64;
        let n = single.len() as f64;
        (single.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0) / n).sqrt()
    };
    let explains = |d: f64| whole(&moments(&used, d)).solve().map(|(_, share)| share);
    let explained = explains(lag_s).unwrap_or(best_share);
    let explained_at_zero = explains(0.0).unwrap_or(0.0);
    Some(Lag { lag_s, sigma_s, explained, explained_at_zero, at_edge })
}

/// Most numbers of a sample, and one.
const ROWS: usize = 5;

/// Sums for least squares of `y` on `x` and 1; the first N + 1 rows and columns are in use.
#[derive(Clone, Copy, Debug)]
struct Moments<const N: usize> {
    xx: [[f64; ROWS]; ROWS],
    xy: [[f64; N]; ROWS],
    yy: f64,
}

impl<const N: usize> Default for Moments<N> {
    fn default() -> Self {
        const { assert!(N < ROWS, "channels have at most four numbers") }
        Self { xx: [[0.0; ROWS]; ROWS], xy: [[0.0; N]; ROWS], yy: 0.0 }
    }
}

impl<const N: usize> Moments<N> {
    fn add(&mut self, x: [f64; N], y: [f64; N]) {
        let row = |i: usize| if i < N { x[i] } else { 1.0 };
        for i in 0..=N {
            for j in 0..=N {
                self.xx[i][j] += row(i) * row(j);
            }
            for j in 0..N {
                self.xy[i][j] += row(i) * y[j];
            }
        }
        self.yy += y.iter().map(|v| v * v).sum::<f64>();
    }

    fn join(&mut self, other: &Self) {
        for i in 0..=N {
            for j in 0..=N {
                self.xx[i][j] += other.xx[i][j];
            }
            for j in 0..N {
                self.xy[i][j] += other.xy[i][j];
            }
        }
        self.yy += other.yy;
    }

    /// The best map, rows for x and 1, and the share of the variance of `y` that it explains.
    fn solve(&self) -> Option<(Vec<[f64; N]>, f64)> {
        let n = self.xx[N][N];
        if n < 32.0 {
            return None;
        }
        let mean_square: f64 = self.xy[N].iter().map(|s| s * s / n).sum();
        let variance = self.yy - mean_square;
        if !(variance > 1e-12 * self.yy.max(1e-300)) {
            return None;
        }
        // A tiny ridge keeps directions that never moved out of the map.
        let trace: f64 = (0..N).map(|i| self.xx[i][i]).sum();
        let mut a = self.xx;
        let mut b = self.xy;
        for (i, row) in a.iter_mut().enumerate().take(N) {
            row[i] += 1e-9 * trace + 1e-300;
        }
        for i in 0..=N {
            let pivot = (i..=N).max_by(|p, q| a[*p][i].abs().total_cmp(&a[*q][i].abs()))?;
            a.swap(i, pivot);
            b.swap(i, pivot);
            if a[i][i] == 0.0 {
                return None;
            }
            for r in 0..=N {
                if r != i {
                    let f = a[r][i] / a[i][i];
                    for c in i..=N {
                        a[r][c] -= f * a[i][c];
                    }
                    for c in 0..N {
                        b[r][c] -= f * b[i][c];
                    }
                }
            }
        }
        let map: Vec<[f64; N]> = (0..=N).map(|i| b[i].map(|v| v / a[i][i])).collect();
        let share = 1.0 - self.loss(&map) / variance;
        Some((map, share))
    }

    /// Sum of squares of what the map leaves.
    fn loss(&self, map: &[[f64; N]]) -> f64 {
        let mut out = self.yy;
        for k in 0..N {
            for i in 0..=N {
                out -= 2.0 * map[i][k] * self.xy[i][k];
                for j in 0..=N {
                    out += map[i][k] * map[j][k] * self.xx[i][j];
                }
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn signal(t: f64) -> [f64; 3] {
        [(2.0 * t).sin() + 0.3 * (9.0 * t).sin(), (3.1 * t).cos(), (1.3 * t).sin() * (4.0 * t).cos()]
    }

    #[test]
    fn a_planted_delay_is_found_to_a_tenth_of_a_millisecond_through_mount_scale_and_noise() {
        for planted in [-0.037, -0.004, 0.0, 0.0063, 0.024, 0.08] {
            let t = resample::grid(0.0, 20.0, 0.005);
            let predicted = Channel::new(t.clone(), t.iter().map(|t| signal(*t)).collect());
            let times = resample::grid(0.0, 20.0, 0.0041);
            let values = times
                .iter()
                .enumerate()
                .map(|(i, t)| {
                    let s = signal(t - planted);
                    let noise = 0.02 * ((i * 7919 % 1009) as f64 / 504.5 - 1.0);
                    [1.1 * s[1] + 0.2 + noise, -0.9 * s[0] + noise, s[2] - 0.1]
                })
                .collect();
            let found = lag(&Channel::new(times, values), &predicted, 0.15).unwrap();
            assert!((found.lag_s - planted).abs() < 2e-4, "{planted}: {found:?}");
            assert!(found.sigma_s < 5e-4 && found.explained > 0.99 && !found.at_edge, "{found:?}");
        }
    }

    #[test]
    fn nothing_is_said_of_channels_that_do_not_move() {
        let t = resample::grid(0.0, 5.0, 0.01);
        let still = Channel::new(t.clone(), vec![[1.0]; t.len()]);
        assert_eq!(lag(&still, &still, 0.1), None);
    }
}
