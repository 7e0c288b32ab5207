//! How much better than expected each action was, and the gradient that makes better ones likelier.

use super::Options;
use super::flight::{Block, likelihood};
use crate::batch::{TOGETHER, summed};
use crate::goal::Outcome;
use crate::network::Network;
use crate::value::Value;
use propwash_rollout::pool;
use propwash_trace::lanes::{Cell, F32x16};

/// What flights gave. Sample `i` is command `i % times` of block `i / times`.
pub(super) struct Samples<'a> {
    pub blocks: Vec<&'a Block>,
    pub times: usize,
    pub actions: usize,
    pub observations: usize,
}

/// How good the actions were.
pub(super) struct Judged {
    /// How much less than expected they cost, of mean zero and variance one over all samples.
    pub advantages: Vec<F32x16>,
    /// The cost to go that was found.
    pub targets: Vec<F32x16>,
    pub target_mean: f64,
    pub target_variance: f64,
}

/// Mean and variance of what counts, in the order of the samples.
fn moments(cells: &[F32x16], samples: &Samples) -> (f64, f64) {
    let each = || {
        let lanes = |i: usize| {
            let weight = samples.weight(i);
            (0..F32x16::LANES).filter(move |l| weight.0[*l] > 0.0).map(move |l| f64::from(cells[i].0[l]))
        };
        (0..cells.len()).flat_map(lanes)
    };
    let count = each().count().max(1) as f64;
    let mean = each().sum::<f64>() / count;
    (mean, each().map(|v| (v - mean).powi(2)).sum::<f64>() / count)
}

impl<'a> Samples<'a> {
    pub fn len(&self) -> usize {
        self.blocks.len() * self.times
    }

    fn of(&self, i: usize) -> (&'a Block, usize) {
        (self.blocks[i / self.times], i % self.times)
    }

    pub fn observation(&self, i: usize) -> &'a [F32x16] {
        let (block, t) = self.of(i);
        &block.observations[t * self.observations..(t + 1) * self.observations]
    }

    /// One for lanes whose episode was not over, else zero.
    pub fn weight(&self, i: usize) -> F32x16 {
        let (block, t) = self.of(i);
        let of = |lane| if lane < block.worlds && !block.void { block.lives.alive(t, lane) } else { 0.0 };
        F32x16(std::array::from_fn(of))
    }

    /// Generalised advantage estimation (Schulman et al., 2016, eq. 16), of costs: δ = V(s) − c − γ V(s'), summed with (γ λ)ⁿ. An episode that is over has
    /// no cost to go; at the end of a flight, and of an episode's time, it is what the value network says.
    pub fn judge(&self, value: &Value, lost_cost: f32, options: &Options) -> Judged {
        let times = self.times;
        let mut rows: Vec<(&Block, Vec<F32x16>, Vec<F32x16>)> =
            self.blocks.iter().map(|block| (*block, Vec::new(), Vec::new())).collect();
        let work = self.len() * TOGETHER;
        pool::for_each(&mut rows, work, |(block, advantages, targets)| {
            let zero = F32x16::splat(0.0);
            let mut kept = vec![zero; value.kept()];
            let said: Vec<F32x16> = block
                .observations
                .chunks_exact(self.observations)
                .map(|own| {
                    kept[..own.len()].copy_from_slice(own);
                    value.estimate(&mut kept)
                })
                .collect();
            (*advantages, *targets) = (vec![zero; times], vec![zero; times]);
            let (discount, lambda) = (options.discount as f32, options.lambda as f32);
            for lane in 0..block.worlds {
                let mut sum = 0.0;
                for t in (0..times).rev() {
                    let (now, next) = (block.lives.alive(t, lane), block.lives.alive(t + 1, lane));
                    if now == 0.0 {
                        continue;
                    }
                    let lost = next == 0.0 && block.lives.outcome(lane) == Outcome::Lost;
                    let mut cost = block.costs[t].0[lane] + if lost { lost_cost } else { 0.0 };
                    if next > 0.0 {
                        cost += discount * said[t + 1].0[lane];
                    } else {
                        sum = 0.0;
                    }
                    sum = said[t].0[lane] - cost + discount * lambda * sum;
                    advantages[t].0[lane] = sum;
                    targets[t].0[lane] = said[t].0[lane] - sum;
                }
            }
        });
        let mut advantages: Vec<F32x16> = rows.iter().flat_map(|row| &row.1).copied().collect();
        let targets: Vec<F32x16> = rows.iter().flat_map(|row| &row.2).copied().collect();
        let (mean, variance) = moments(&advantages, self);
        let scale = 1.0 / (variance.sqrt() + 1e-8);
        for cell in &mut advantages {
            *cell = F32x16(cell.0.map(|v| ((f64::from(v) - mean) * scale) as f32));
        }
        let (target_mean, target_variance) = moments(&targets, self);
        Judged { advantages, targets, target_mean, target_variance }
    }
}

/// The gradient of the clipped surrogate (Schulman et al., 2017, eq. 7) by the weights of the network and the logarithms of the standard deviations, with the
/// sign of a loss: it shrinks what turned out worse.
pub(super) fn surrogate(
    part: &[usize],
    samples: &Samples,
    judged: &Judged,
    (network, log_std): (&Network, &[f32]),
    options: &Options,
) -> Vec<f32> {
    let n = samples.actions;
    let std: Vec<f32> = log_std.iter().map(|v| v.exp()).collect();
    let count: f32 = part.iter().map(|i| samples.weight(*i).0.iter().sum::<f32>()).sum();
    let (size, weights) = (network.kept(), network.weights().len());
    if count == 0.0 {
        return vec![0.0; weights + n];
    }
    let mut gradient = summed(part, weights + n, |own, cells| {
        let (by_weights, by_std) = cells.split_at_mut(weights);
        let mut kept = vec![F32x16::splat(0.0); TOGETHER * size];
        let mut gains = Vec::new();
        for own in own.chunks(TOGETHER) {
            gains.clear();
            for (i, kept) in own.iter().zip(kept.chunks_exact_mut(size)) {
                kept[..samples.observations].copy_from_slice(samples.observation(*i));
                network.forward(kept);
                let (block, t) = samples.of(*i);
                let (middle, action) = (&kept[size - n..], &block.actions[t * n..(t + 1) * n]);
                let weight = samples.weight(*i);
                let mut by_middle = vec![F32x16::splat(0.0); n];
                for lane in (0..F32x16::LANES).filter(|l| weight.0[*l] > 0.0) {
                    let now = likelihood(action, middle, &std, lane);
                    let ratio = (now - block.likelihoods[t].0[lane]).exp();
                    let advantage = judged.advantages[*i].0[lane];
                    let far =
                        if advantage > 0.0 { ratio > 1.0 + options.clip } else { ratio < 1.0 - options.clip };
                    if far {
                        continue;
                    }
                    let gain = -advantage * ratio / count;
                    for k in 0..n {
                        let z = (action[k].0[lane] - middle[k].0[lane]) / std[k];
                        by_middle[k].0[lane] = gain * z / std[k];
                        by_std[k].0[lane] += gain * (z * z - 1.0);
                    }
                }
                gains.extend(by_middle);
            }
            network.backward_many(&kept[..own.len() * size], &mut gains, by_weights);
        }
    });
    // The entropy of normal draws grows by one with the logarithm of each standard deviation.
    gradient[weights..].iter_mut().for_each(|g| *g -= options.entropy);
    gradient
}
