//! A network of dense layers with tanh between them, in lanes.

use propwash_rollout::random::Stream;
use propwash_trace::dense::{Dense, Rows, sum, undo_tanh};
use propwash_trace::lanes::{Cell, F32x16};

/// Layers and their weights. Behind every layer stands a tanh, behind the last one only where the network gives actions.
#[derive(Clone, Debug, PartialEq)]
pub struct Network {
    layers: Vec<Dense>,
    weights: Vec<f32>,
    /// Whether a tanh stands behind the last layer.
    held: bool,
}

impl Network {
    /// A network of these widths, from the observation to the action. Weights are normal with variance 1 / inputs (LeCun, "Efficient
    /// BackProp", 1998), those of the last layer a tenth of that size, so that it begins with small actions; biases are zero.
    pub fn new(widths: &[usize], random: &mut Stream) -> Self {
        let layers: Vec<Dense> =
            widths.windows(2).map(|pair| Dense { inputs: pair[0], outputs: pair[1] }).collect();
        let mut weights = Vec::new();
        for (k, layer) in layers.iter().enumerate() {
            let size = if k + 1 == layers.len() { 0.1 } else { 1.0 } / (layer.inputs as f64).sqrt();
            weights.extend((0..layer.inputs * layer.outputs).map(|_| (size * random.normal()) as f32));
            weights.extend(std::iter::repeat_n(0.0, layer.outputs));
        }
        Self { layers, weights, held: true }
    }

    /// The same without a tanh behind the last layer: for values, which have no limits.
    pub fn unlimited(widths: &[usize], random: &mut Stream) -> Self {
        Self { held: false, ..Self::new(widths, random) }
    }

    fn is_bent(&self, layer: usize) -> bool {
        self.held || layer + 1 < self.layers.len()
    }

    /// Numbers of the result.
    fn outputs(&self) -> usize {
        self.layers.last().map_or(0, |layer| layer.outputs)
    }

    /// Widths from the observation to the action.
    pub fn widths(&self) -> Vec<usize> {
        let first = self.layers.first().map(|layer| layer.inputs);
        first.into_iter().chain(self.layers.iter().map(|layer| layer.outputs)).collect()
    }

    /// All weights: of each layer (output, input), row by row, and then its biases.
    pub fn weights(&self) -> &[f32] {
        &self.weights
    }

    /// The same to be changed.
    pub fn weights_mut(&mut self) -> &mut [f32] {
        &mut self.weights
    }

    /// Cells that one evaluation keeps: the input and what stands behind every layer.
    pub(crate) fn kept(&self) -> usize {
        self.widths().iter().sum()
    }

    /// Evaluates it. `kept` begins with the input; behind it every layer writes its output, the last of which is the action.
    pub(crate) fn forward(&self, kept: &mut [F32x16]) {
        let (mut weights, mut at) = (&self.weights[..], 0);
        for (k, layer) in self.layers.iter().enumerate() {
            let (own, rest) = weights.split_at(layer.len());
            weights = rest;
            let (x, y) = kept[at..].split_at_mut(layer.inputs);
            layer.forward(own, x, &mut y[..layer.outputs], self.is_bent(k));
            at += layer.inputs;
        }
    }

    /// Takes what a loss gains by the action (the first cells of `gains`, which it uses up) to what it gains by the input, which is left there, and by
    /// weights, which is added.
    pub(crate) fn backward(&self, kept: &[F32x16], gains: &mut Vec<F32x16>, by_weights: &mut [F32x16]) {
        let zero = F32x16::splat(0.0);
        let (mut end, mut to) = (self.weights.len(), kept.len());
        let mut by_x = Vec::new();
        for (k, layer) in self.layers.iter().enumerate().rev() {
            let from = end - layer.len();
            let y = &kept[to - layer.outputs..to];
            if self.is_bent(k) {
                undo_tanh(y, &mut gains[..layer.outputs]);
            }
            let x_end = to - layer.outputs;
            let x = &kept[x_end - layer.inputs..x_end];
            by_x.clear();
            by_x.resize(layer.inputs, zero);
            let own = &self.weights[from..end];
            layer.backward(own, x, &gains[..layer.outputs], &mut by_x, &mut by_weights[from..end]);
            std::mem::swap(gains, &mut by_x);
            (end, to) = (from, x_end);
        }
    }

    /// Takes what a loss gains by the results of many samples (`gains`, one after the other, which it uses up) to what it gains by weights, which is added.
    /// What each sample kept stands in `kept`, one after the other.
    pub(crate) fn backward_many(&self, kept: &[F32x16], gains: &mut Vec<F32x16>, by_weights: &mut [F32x16]) {
        let (size, zero) = (self.kept(), F32x16::splat(0.0));
        let (mut end, mut to) = (self.weights.len(), size);
        let mut by_x = Vec::new();
        for (k, layer) in self.layers.iter().enumerate().rev() {
            let (from, x_from) = (end - layer.len(), to - layer.outputs - layer.inputs);
            if self.is_bent(k) {
                for (own, gains) in kept.chunks_exact(size).zip(gains.chunks_exact_mut(layer.outputs)) {
                    undo_tanh(&own[to - layer.outputs..to], gains);
                }
            }
            layer.to_weights((&kept[x_from..], size), gains, &mut by_weights[from..end]);
            if k > 0 {
                by_x.clear();
                by_x.resize(gains.len() / layer.outputs * layer.inputs, zero);
                let rows = by_x.chunks_exact_mut(layer.inputs);
                for (gains, by_x) in gains.chunks_exact(layer.outputs).zip(rows) {
                    layer.to_inputs(&self.weights[from..end], gains, by_x);
                }
                std::mem::swap(gains, &mut by_x);
            }
            (end, to) = (from, to - layer.outputs);
        }
    }

    /// What a result gains by the input, through what was kept: `gains` begins with what a loss gains by the results and ends as that.
    pub(crate) fn back_to_input(&self, kept: &[F32x16], gains: &mut Vec<F32x16>) {
        let (mut end, mut to) = (self.weights.len(), kept.len());
        for (k, layer) in self.layers.iter().enumerate().rev() {
            let from = end - layer.len();
            if self.is_bent(k) {
                undo_tanh(&kept[to - layer.outputs..to], &mut gains[..layer.outputs]);
            }
            let mut by_x = vec![F32x16::splat(0.0); layer.inputs];
            layer.to_inputs(&self.weights[from..end], gains, &mut by_x);
            *gains = by_x;
            (end, to) = (from, to - layer.outputs);
        }
    }

    /// Weights and biases of the last layer, to be changed.
    pub(crate) fn last_layer_mut(&mut self) -> &mut [f32] {
        let n = self.layers.last().map_or(0, |layer| layer.len());
        let from = self.weights.len() - n;
        &mut self.weights[from..]
    }

    /// Numbers before all its tanh.
    pub(crate) fn sums(&self) -> usize {
        self.layers.iter().map(|layer| layer.outputs).sum()
    }

    /// As [`Network::backward`] without gains by weights: what a loss gains by the numbers before each tanh is written to `by_sums`, layer after layer, and what it gains
    /// by the first `inputs` numbers of the input is left in `gains`.
    pub(crate) fn backward_inputs(
        &self,
        kept: &[F32x16],
        gains: &mut Vec<F32x16>,
        by_sums: &mut [F32x16],
        inputs: usize,
    ) {
        let (mut end, mut to, mut sums) = (self.weights.len(), kept.len(), by_sums.len());
        let mut by_x = Vec::new();
        for (k, layer) in self.layers.iter().enumerate().rev() {
            let from = end - layer.len();
            if self.is_bent(k) {
                undo_tanh(&kept[to - layer.outputs..to], &mut gains[..layer.outputs]);
            }
            by_sums[sums - layer.outputs..sums].copy_from_slice(&gains[..layer.outputs]);
            by_x.clear();
            by_x.resize(if k == 0 { inputs } else { layer.inputs }, F32x16::splat(0.0));
            layer.to_inputs(&self.weights[from..end], &gains[..layer.outputs], &mut by_x);
            std::mem::swap(gains, &mut by_x);
            (end, to, sums) = (from, to - layer.outputs, sums - layer.outputs);
        }
    }

    /// Adds what a loss gains by the weights over `times` evaluations: from what these kept and what the loss gains by the numbers before each tanh.
    pub(crate) fn weight_gains(
        &self,
        kept: &[F32x16],
        by_sums: &[F32x16],
        times: usize,
        by_weights: &mut [f32],
    ) {
        let (mut from, mut x, mut y) = (0, 0, 0);
        for layer in &self.layers {
            let given = Rows { cells: &kept[x..], stride: self.kept() };
            let gains = Rows { cells: &by_sums[y..], stride: self.sums() };
            layer.weight_gains(given, gains, times, &mut by_weights[from..from + layer.len()]);
            (from, x, y) = (from + layer.len(), x + layer.inputs, y + layer.outputs);
        }
    }

    /// Evaluates it for one observation.
    pub fn act(&self, observation: &[f32]) -> Vec<f32> {
        let mut kept = vec![F32x16::splat(0.0); self.kept()];
        for (cell, v) in kept.iter_mut().zip(observation) {
            *cell = F32x16::splat(*v);
        }
        self.forward(&mut kept);
        kept[kept.len() - self.outputs()..].iter().map(|cell| cell.get(0)).collect()
    }

    /// Sums over lanes.
    pub(crate) fn gathered(by_weights: &[F32x16]) -> impl Iterator<Item = f32> + '_ {
        by_weights.iter().map(sum)
    }
}
