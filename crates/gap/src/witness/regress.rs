//! Least squares on blocks of band-limited samples, with standard errors by the scatter between blocks and scores on
//! held-out samples.
//!
//! The low-passed samples of a block are reduced to one Gram matrix per channel, so that every set of parameters costs a
//! few small matrices. Equation error: Morelli & Klein, "Aircraft system identification: theory and practice", 2nd ed.,
//! Sunflyte 2016, ch. 5 and 6 (SIDPAC); standard errors of coloured residuals: Liang & Zeger, Biometrika 73(1), 1986.

use super::CHANNELS;
use super::band::low_pass;
use super::samples::{EVERY_S, RESIDUAL, Samples};
use nalgebra::{Cholesky, DMatrix, DVector};

/// Time at the ends of a span affected by the filter's start, periods of the cut-off.
const SPOILT_PERIODS: f64 = 1.0;
/// Samples kept per period of the cut-off: twice what the band needs.
const PER_PERIOD: f64 = 4.0;
/// Length of a block, s: longer than the memory of vehicle and weather, and short enough for some tens of blocks.
const BLOCK_S: f64 = 2.0;
/// Fewest blocks of a log: shorter logs get shorter blocks, down to [`SHORTEST_BLOCK_S`].
const BLOCKS: f64 = 24.0;
/// Length of the shortest block, s: half a period of a slow oscillation (1 Hz).
const SHORTEST_BLOCK_S: f64 = 0.5;
/// Folds where there is only one log.
const FOLDS: usize = 8;
/// Blocks beside a fold that are left out of its fit: the filter and slow weather reach across the edge.
const GUARD: usize = 1;
/// Iterations of the channels' weights.
const PASSES: usize = 4;
/// Width of the ridge in slabs: negligible where the log is informative.
const RIDGE_SLABS: f64 = 10.0;
/// Lower bound on a channel's residual variance, as a share of its variance before: otherwise a fully explained channel
/// would outweigh all others.
const LEAST_REST: f64 = 1e-4;

/// Columns of a channel: parameters, then the residual.
#[derive(Clone, Debug, Default)]
struct Channel {
    /// Parameters that act on the channel.
    parameters: Vec<usize>,
}

/// Sums over samples, (channel): number of samples, Gram matrix of [parameters | residual].
#[derive(Clone, Debug)]
struct Sums {
    n: [f64; CHANNELS],
    gram: Vec<DMatrix<f64>>,
}

impl Sums {
    fn zero(channels: &[Channel]) -> Self {
        let gram = channels.iter().map(|c| DMatrix::zeros(c.parameters.len() + 1, c.parameters.len() + 1));
        Self { n: [0.0; CHANNELS], gram: gram.collect() }
    }

    fn add(&mut self, other: &Self, times: f64) {
        for c in 0..CHANNELS {
            self.n[c] += times * other.n[c];
            self.gram[c].zip_apply(&other.gram[c], |a, b| *a += times * b);
        }
    }
}

/// All logs in one band.
pub(super) struct Band {
    channels: Vec<Channel>,
    /// Plausible sizes of all parameters of the model.
    slab: Vec<f64>,
    blocks: Vec<Sums>,
    all: Sums,
    /// Folds: held-out blocks, and sums over the blocks of their fit.
    folds: Vec<(Vec<usize>, Sums)>,
}

/// Fitted parameters with the factors of their covariance.
#[derive(Clone, Debug)]
pub(super) struct Fit {
    pub parameters: Vec<usize>,
    pub beta: DVector<f64>,
    /// Weights of the channels: inverse of their residual variance.
    pub weight: [f64; CHANNELS],
    inverse: DMatrix<f64>,
}

/// Held-out residual squares of a fit, (block, channel).
pub(super) type Left = Vec<[f64; CHANNELS]>;

/// +1 or −1 where a parameter's sign is fixed, else 0.
pub(super) type Sides = Vec<f64>;

impl Band {
    /// Filters the samples of all logs at `cut_hz`, removes the mean per log and axis, and sums over blocks.
    pub fn new(logs: &[Samples], slab: Vec<f64>, cut_hz: f64) -> Self {
        let mut channels = vec![Channel::default(); CHANNELS];
        for (channel, k) in logs.iter().flat_map(|l| &l.columns).filter(|(_, k)| *k != RESIDUAL) {
            let list = &mut channels[*channel].parameters;
            if !list.contains(k) {
                list.push(*k);
            }
        }
        channels.iter_mut().for_each(|c| c.parameters.sort_unstable());
        let (mut blocks, mut of_log) = (Vec::new(), Vec::new());
        for (index, log) in logs.iter().enumerate() {
            let own = blocks_of(log, &channels, cut_hz);
            of_log.extend(vec![index; own.len()]);
            blocks.extend(own);
        }
        let mut all = Sums::zero(&channels);
        blocks.iter().for_each(|b| all.add(b, 1.0));
        let folds = folds(&blocks, &of_log, &all);
        Self { channels, slab, blocks, all, folds }
    }

    /// Whether there is enough data for a judgement.
    pub fn judges(&self) -> bool {
        !self.folds.is_empty()
    }

    /// Root mean square of a parameter's column in a channel, per unit of the parameter.
    pub fn size(&self, k: usize, channel: usize) -> f64 {
        let place = self.channels[channel].parameters.iter().position(|p| *p == k);
        let n = self.all.n[channel].max(1.0);
        place.map_or(0.0, |i| (self.all.gram[channel][(i, i)] / n).max(0.0).sqrt())
    }

    /// Squares of the residual itself, (block, channel).
    pub fn before(&self) -> Left {
        self.blocks.iter().map(|b| core::array::from_fn(|c| last(&b.gram[c]))).collect()
    }

    /// Least squares over all blocks, on the channels selected by `on`.
    pub fn fit(&self, parameters: &[usize], on: &[bool; CHANNELS], sides: &Sides) -> Option<Fit> {
        self.one_sided(&self.all, parameters, on, sides)
    }

    /// Residual squares on blocks held out from each fit.
    pub fn left(&self, parameters: &[usize], on: &[bool; CHANNELS], sides: &Sides) -> Option<Left> {
        let mut out = self.before();
        for (judging, sums) in &self.folds {
            let fit = self.one_sided(sums, parameters, on, sides)?;
            for b in judging {
                out[*b] = self.rest(&self.blocks[*b], &fit);
            }
        }
        Some(out)
    }

    /// Residual squares of a fit to other logs.
    #[cfg(test)]
    pub fn left_by(&self, fit: &Fit) -> Left {
        self.blocks.iter().map(|b| self.rest(b, fit)).collect()
    }

    /// As [`Self::solve`], without the parameters that would get the wrong sign.
    fn one_sided(
        &self,
        sums: &Sums,
        parameters: &[usize],
        on: &[bool; CHANNELS],
        sides: &Sides,
    ) -> Option<Fit> {
        let mut kept = parameters.to_vec();
        loop {
            let fit = self.solve(sums, &kept, on)?;
            // The one furthest on the wrong side, in slabs.
            let wrong = (0..kept.len())
                .map(|i| (fit.beta[i] * sides[kept[i]] / self.slab[kept[i]], i))
                .filter(|(size, _)| *size < 0.0)
                .min_by(|a, b| a.0.total_cmp(&b.0));
            let Some((_, i)) = wrong else { return Some(fit) };
            kept.remove(i);
        }
    }

    fn solve(&self, sums: &Sums, parameters: &[usize], on: &[bool; CHANNELS]) -> Option<Fit> {
        let m = parameters.len();
        let places: Vec<Vec<Option<usize>>> = self
            .channels
            .iter()
            .map(|c| parameters.iter().map(|k| c.parameters.iter().position(|p| p == k)).collect())
            .collect();
        let mut weight: [f64; CHANNELS] = core::array::from_fn(|c| {
            let square = last(&sums.gram[c]);
            if on[c] && sums.n[c] > 0.0 && square > 0.0 { sums.n[c] / square } else { 0.0 }
        });
        let first = weight;
        let mut fit = None;
        for _ in 0..PASSES {
            let (mut a, mut b) = (DMatrix::zeros(m, m), DVector::zeros(m));
            for (i, k) in parameters.iter().enumerate() {
                a[(i, i)] = (RIDGE_SLABS * self.slab[*k]).powi(-2);
            }
            for c in (0..CHANNELS).filter(|c| weight[*c] > 0.0) {
                let gram = &sums.gram[c];
                let end = gram.nrows() - 1;
                for i in 0..m {
                    let Some(p) = places[c][i] else { continue };
                    b[i] += weight[c] * gram[(p, end)];
                    for j in 0..m {
                        let Some(q) = places[c][j] else { continue };
                        a[(i, j)] += weight[c] * gram[(p, q)];
                    }
                }
            }
            // Scaled to a unit diagonal: units differ by many orders of magnitude.
            let scale = DVector::from_fn(m, |i, _| a[(i, i)].max(1e-300).sqrt().recip());
            let scaled = DMatrix::from_fn(m, m, |i, j| a[(i, j)] * scale[i] * scale[j]);
            let inverse = Cholesky::new(scaled)?.inverse();
            let inverse = DMatrix::from_fn(m, m, |i, j| inverse[(i, j)] * scale[i] * scale[j]);
            let beta = &inverse * &b;
            let now = Fit { parameters: parameters.to_vec(), beta, weight, inverse };
            let left = self.rest(sums, &now);
            for c in (0..CHANNELS).filter(|c| first[*c] > 0.0) {
                weight[c] = (sums.n[c] / left[c].max(1e-300)).min(first[c] / LEAST_REST);
            }
            fit = Some(now);
        }
        fit
    }

    /// Residual squares of a fit per channel.
    fn rest(&self, sums: &Sums, fit: &Fit) -> [f64; CHANNELS] {
        core::array::from_fn(|c| {
            let gram = &sums.gram[c];
            let v = self.direction(c, fit);
            v.dot(&(gram * &v)).max(0.0)
        })
    }

    /// [−β | 1] in the columns of a channel.
    fn direction(&self, channel: usize, fit: &Fit) -> DVector<f64> {
        let list = &self.channels[channel].parameters;
        let mut v = DVector::zeros(list.len() + 1);
        v[list.len()] = 1.0;
        for (k, beta) in fit.parameters.iter().zip(fit.beta.iter()) {
            if let Some(i) = list.iter().position(|p| p == k) {
                v[i] = -beta;
            }
        }
        v
    }

    /// Standard errors of a fit by the scatter of the blocks' scores (cluster-robust).
    pub fn standard_errors(&self, fit: &Fit) -> Vec<f64> {
        let m = fit.parameters.len();
        let directions: Vec<DVector<f64>> = (0..CHANNELS).map(|c| self.direction(c, fit)).collect();
        let mut meat = DMatrix::<f64>::zeros(m, m);
        for block in &self.blocks {
            let mut score = DVector::<f64>::zeros(m);
            for c in (0..CHANNELS).filter(|c| fit.weight[*c] > 0.0) {
                let pulled = &block.gram[c] * &directions[c];
                for (i, k) in fit.parameters.iter().enumerate() {
                    if let Some(p) = self.channels[c].parameters.iter().position(|p| p == k) {
                        score[i] += fit.weight[c] * pulled[p];
                    }
                }
            }
            meat.ger(1.0, &score, &score, 1.0);
        }
        let n = self.blocks.len() as f64;
        let covariance = &fit.inverse * meat * &fit.inverse * (n / (n - m as f64).max(1.0));
        (0..m).map(|i| covariance[(i, i)].max(0.0).sqrt()).collect()
    }
}

/// Last entry of a Gram matrix: the residual's square.
fn last(gram: &DMatrix<f64>) -> f64 {
    gram[(gram.nrows() - 1, gram.ncols() - 1)]
}

/// A log's blocks.
fn blocks_of(log: &Samples, channels: &[Channel], cut_hz: f64) -> Vec<Sums> {
    let width = log.columns.len();
    let mut rows = log.rows.clone();
    for (from, to) in &log.stretches {
        low_pass(&mut rows[from * width..to * width], width, cut_hz, EVERY_S);
    }
    let spoilt = (SPOILT_PERIODS / cut_hz / EVERY_S).ceil() as usize;
    let apart = ((1.0 / (PER_PERIOD * cut_hz) / EVERY_S).round() as usize).max(1);
    let kept: Vec<usize> = log
        .stretches
        .iter()
        .flat_map(|(from, to)| (from + spoilt..to.saturating_sub(spoilt)).step_by(apart))
        .filter(|i| log.measured[*i])
        .collect();
    let mut mean = vec![0.0; width];
    for i in &kept {
        mean.iter_mut().zip(&rows[i * width..]).for_each(|(m, x)| *m += x / kept.len() as f64);
    }
    let kept_s = kept.len() as f64 * apart as f64 * EVERY_S;
    let block_s = (kept_s / BLOCKS).clamp(SHORTEST_BLOCK_S, BLOCK_S);
    let per_block = (block_s / (apart as f64 * EVERY_S)).round().max(1.0) as usize;
    let place: Vec<(usize, usize)> = log
        .columns
        .iter()
        .map(|(c, k)| {
            let list = &channels[*c].parameters;
            (*c, list.iter().position(|p| p == k).unwrap_or(list.len()))
        })
        .collect();
    let mut out = Vec::new();
    // The remaining samples at the end go to the last block.
    let n_blocks = (kept.len() / per_block).max(usize::from(!kept.is_empty()));
    for b in 0..n_blocks {
        let to = if b + 1 == n_blocks { kept.len() } else { (b + 1) * per_block };
        let mut sums = Sums::zero(channels);
        for i in &kept[b * per_block..to] {
            let row: Vec<f64> =
                rows[i * width..(i + 1) * width].iter().zip(&mean).map(|(x, m)| x - m).collect();
            for (a, (c, p)) in place.iter().enumerate() {
                // Columns of a channel are contiguous.
                for (e, (d, q)) in place.iter().enumerate().skip(a).take_while(|(_, (d, _))| d == c) {
                    debug_assert_eq!(c, d);
                    let product = row[a] * row[e];
                    sums.gram[*c][(*p, *q)] += product;
                    if p != q {
                        sums.gram[*c][(*q, *p)] += product;
                    }
                }
            }
        }
        let n = (to - b * per_block) as f64;
        for (c, k) in &log.columns {
            if *k == RESIDUAL {
                sums.n[*c] = n;
            }
        }
        out.push(sums);
    }
    out
}

/// Every log is judged by a fit to the others; of a single log, every eighth by a fit to the rest, with a gap between.
fn folds(blocks: &[Sums], of_log: &[usize], all: &Sums) -> Vec<(Vec<usize>, Sums)> {
    let logs = of_log.last().map_or(0, |l| l + 1);
    let n = blocks.len();
    let mut out = Vec::new();
    if logs >= 2 {
        for log in 0..logs {
            let judging: Vec<usize> = (0..n).filter(|b| of_log[*b] == log).collect();
            out.push((judging.clone(), judging));
        }
    } else {
        let folds = FOLDS.min(n / (2 * GUARD + 1));
        for f in 0..folds {
            let (from, to) = (f * n / folds, (f + 1) * n / folds);
            let beside = from.saturating_sub(GUARD)..(to + GUARD).min(n);
            out.push(((from..to).collect(), beside.collect()));
        }
    }
    out.retain(|(judging, unseen): &(Vec<usize>, Vec<usize>)| !judging.is_empty() && unseen.len() < n);
    if out.len() < 2 {
        return Vec::new();
    }
    out.into_iter()
        .map(|(judging, unseen)| {
            let mut rest = all.clone();
            unseen.iter().for_each(|b| rest.add(&blocks[*b], -1.0));
            (judging, rest)
        })
        .collect()
}
