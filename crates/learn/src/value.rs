//! What is still to come from a state on: a network that learns the discounted cost to go.

use crate::adam::Adam;
use crate::batch::{TOGETHER, shorten, summed};
use crate::episodes::stream;
use crate::network::Network;
use propwash_trace::lanes::{Cell, F32x16};

/// Share of new targets in the mean and size of targets that are kept.
const NEW: f64 = 0.2;

/// An observation, the cost to go that was found from there on, and what it counts, lane by lane.
#[derive(Clone, Copy)]
pub(crate) struct Sample<'a> {
    pub observation: &'a [F32x16],
    pub target: F32x16,
    pub weight: F32x16,
}

/// A network for the cost to go. It gives the number of standard deviations from the mean, both those of what it was taught, so that the size of costs does not
/// matter; when these change, its last layer is changed so that what it says stays the same (van Hasselt et al., "Learning values across many orders of
/// magnitude", 2016).
#[derive(Clone, Debug)]
pub(crate) struct Value {
    network: Network,
    adam: Adam,
    mean: f64,
    size: f64,
    taught: bool,
}

impl Value {
    pub fn new(observations: usize, hidden: &[usize], seed: u64) -> Self {
        let widths: Vec<usize> =
            [observations].into_iter().chain(hidden.iter().copied()).chain([1]).collect();
        let network = Network::unlimited(&widths, &mut stream(seed, 0, 0, "learn.value"));
        let adam = Adam::new(network.weights().len());
        Self { network, adam, mean: 0.0, size: 1.0, taught: false }
    }

    /// Cells that one evaluation keeps.
    pub fn kept(&self) -> usize {
        self.network.kept()
    }

    /// The cost to go. `kept` begins with the observation.
    pub fn estimate(&self, kept: &mut [F32x16]) -> F32x16 {
        self.network.forward(kept);
        let (mean, size) = (self.mean as f32, self.size as f32);
        F32x16(kept[kept.len() - 1].0.map(|v| mean + size * v))
    }

    /// What it gains by the observation, after [`Value::estimate`].
    pub fn slopes(&self, kept: &[F32x16]) -> Vec<F32x16> {
        let mut gains = vec![F32x16::splat(self.size as f32)];
        self.network.back_to_input(kept, &mut gains);
        gains
    }

    /// Takes the mean and size of new targets into account.
    pub fn note(&mut self, mean: f64, variance: f64) {
        let new = if self.taught { NEW } else { 1.0 };
        self.taught = true;
        let next_mean = self.mean + new * (mean - self.mean);
        // The variance around the mean that is kept, not around that of the new targets.
        let spread = variance + (mean - next_mean).powi(2);
        let next_size = ((1.0 - new) * self.size.powi(2) + new * spread).sqrt().max(1e-6);
        let (scale, shift) = (self.size / next_size, (self.mean - next_mean) / next_size);
        let last = self.network.last_layer_mut();
        last.iter_mut().for_each(|w| *w *= scale as f32);
        if let Some(bias) = last.last_mut() {
            *bias += shift as f32;
        }
        (self.mean, self.size) = (next_mean, next_size);
    }

    /// Takes one step of Adam towards the targets of some samples.
    pub fn teach<'a>(
        &mut self,
        samples: &[usize],
        of: impl Fn(usize) -> Sample<'a> + Sync,
        (rate, longest): (f32, f32),
    ) {
        let count: f32 = samples.iter().map(|s| of(*s).weight.0.iter().sum::<f32>()).sum();
        if count == 0.0 {
            return;
        }
        let (size, network) = (self.kept(), &self.network);
        let (mean, scale) = (self.mean as f32, 1.0 / self.size as f32);
        let mut gradient = summed(samples, network.weights().len(), |own, by_weights| {
            let mut kept = vec![F32x16::splat(0.0); TOGETHER * size];
            let mut gains = Vec::new();
            for own in own.chunks(TOGETHER) {
                gains.clear();
                for (sample, kept) in own.iter().zip(kept.chunks_exact_mut(size)) {
                    let sample = of(*sample);
                    kept[..sample.observation.len()].copy_from_slice(sample.observation);
                    network.forward(kept);
                    let said = kept[size - 1];
                    let mut gain = F32x16::splat(0.0);
                    gain.fill(0, |l| {
                        let wanted = (sample.target.0[l] - mean) * scale;
                        if sample.weight.0[l] > 0.0 { (said.0[l] - wanted) / count } else { 0.0 }
                    });
                    gains.push(gain);
                }
                network.backward_many(&kept[..own.len() * size], &mut gains, by_weights);
            }
        });
        shorten(&mut gradient, longest);
        self.adam.step(self.network.weights_mut(), &gradient, rate);
    }

    /// Moves its weights a share of the way to those of another, which it takes its scale from.
    pub fn follow(&mut self, other: &Self, share: f32) {
        let (scale, shift) = (self.size / other.size, (self.mean - other.mean) / other.size);
        let last = self.network.last_layer_mut();
        last.iter_mut().for_each(|w| *w *= scale as f32);
        if let Some(bias) = last.last_mut() {
            *bias += shift as f32;
        }
        (self.mean, self.size, self.taught) = (other.mean, other.size, other.taught);
        for (w, to) in self.network.weights_mut().iter_mut().zip(other.network.weights()) {
            *w += share * (to - *w);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cells(n: usize) -> Vec<[F32x16; 2]> {
        let wave = |k: usize| F32x16(std::array::from_fn(|l| ((k * 16 + l) as f32 * 0.7391).sin()));
        (0..n).map(|k| [wave(2 * k), wave(2 * k + 1)]).collect()
    }

    fn said(value: &Value, at: [F32x16; 2]) -> (F32x16, Vec<F32x16>) {
        let mut kept = vec![F32x16::splat(0.0); value.kept()];
        kept[..2].copy_from_slice(&at);
        let estimate = value.estimate(&mut kept);
        (estimate, value.slopes(&kept))
    }

    /// Costs of 1000 with differences of 300 are learnt as well as small ones, samples without weight are not; slopes are those of differences.
    #[test]
    fn it_learns_costs_of_any_size_and_knows_its_slopes() {
        let (seen, mut value) = (cells(40), Value::new(2, &[16, 16], 1));
        let of_one = |x: f32, y: f32| 1000.0 + 300.0 * x - 100.0 * y;
        let targets: Vec<F32x16> =
            seen.iter().map(|[x, y]| F32x16(std::array::from_fn(|l| of_one(x.0[l], y.0[l])))).collect();
        let sample = |i: usize| Sample {
            observation: &seen[i],
            target: if i == 3 { F32x16::splat(f32::NAN) } else { targets[i] },
            weight: F32x16::splat(if i == 3 { 0.0 } else { 1.0 }),
        };
        let samples: Vec<usize> = (0..40).collect();
        for k in 0..600 {
            if k % 50 == 0 {
                let before = said(&value, seen[0]).0;
                value.note(1000.0, 200f64.powi(2));
                let after = said(&value, seen[0]).0;
                assert!(k == 0 || (0..16).all(|l| (before.0[l] - after.0[l]).abs() < 0.1));
            }
            value.teach(&samples, sample, (0.01, 1.0));
        }
        let off = |i: usize| {
            (0..16).map(|l| (said(&value, seen[i]).0.0[l] - targets[i].0[l]).abs()).fold(0.0, f32::max)
        };
        assert!((4..40).all(|i| off(i) < 40.0), "{:?}", (0..40).map(off).collect::<Vec<_>>());
        let ([x, y], step) = (seen[7], 0.01);
        let slopes = said(&value, seen[7]).1;
        let moved = |by: f32| said(&value, [F32x16(x.0.map(|v| v + by)), y]).0;
        for l in 0..16 {
            let slope = (moved(step).0[l] - moved(-step).0[l]) / (2.0 * step);
            assert!((slopes[0].0[l] - slope).abs() < 3.0, "{} {slope}", slopes[0].0[l]);
        }
        let mut behind = Value::new(2, &[16, 16], 1);
        behind.follow(&value, 1.0);
        let (one, other) = (said(&behind, seen[5]).0, said(&value, seen[5]).0);
        assert!((0..16).all(|l| (one.0[l] - other.0[l]).abs() < 1e-3), "{one:?} {other:?}");
    }
}
