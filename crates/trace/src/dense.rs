//! Dense layers of a network in lanes: one block of lanes for each number, every weight the same in all lanes.
//!
//! y = W x + b, forwards and backwards (Goodfellow, Bengio, Courville, "Deep learning", 2016, ch. 6.5). Gains by weights are summed lane by
//! lane and only added up over lanes at the end, so that no step needs a sum across lanes.

use fearless_simd::{Simd, dispatch, f32x16};

use super::lanes::{Arith, F32x16, level, vectorize};

/// Outputs that are summed side by side: as many sums as the processor works on at once.
const AT_ONCE: usize = 8;

/// One dense layer: weights (output, input), row by row, and behind them one bias for each output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Dense {
    /// Number of inputs.
    pub inputs: usize,
    /// Number of outputs.
    pub outputs: usize,
}

impl Dense {
    /// Numbers of weights and biases.
    pub fn len(self) -> usize {
        self.outputs * (self.inputs + 1)
    }

    /// Whether it has none.
    pub fn is_empty(self) -> bool {
        self.len() == 0
    }

    /// y = W x + b, each number through tanh where `tanh` is true.
    ///
    /// # Panics
    /// Where lists are shorter than the layer.
    pub fn forward(self, weights: &[f32], x: &[F32x16], y: &mut [F32x16], tanh: bool) {
        dispatch!(level(), simd => forward_at(simd, self, weights, x, y, tanh));
    }

    /// From `by_y`, what a loss gains by the outputs (of W x + b, before any tanh), to what it gains by the inputs, which is written to `by_x`, and
    /// by weights, which is added to `by_weights`.
    ///
    /// # Panics
    /// Where lists are shorter than the layer.
    pub fn backward(
        self,
        weights: &[f32],
        x: &[F32x16],
        by_y: &[F32x16],
        by_x: &mut [F32x16],
        by_weights: &mut [F32x16],
    ) {
        dispatch!(level(), simd => backward_at(simd, self, weights, (x, by_y), by_x, by_weights));
    }

    /// From what a loss gains by the outputs (before any tanh) to what it gains by the first inputs, as many as `by_x` has, which is written there.
    ///
    /// # Panics
    /// Where lists are shorter than the layer.
    pub fn to_inputs(self, weights: &[f32], by_y: &[F32x16], by_x: &mut [F32x16]) {
        dispatch!(level(), simd => to_inputs_at(simd, self, weights, by_y, by_x));
    }

    /// From what a loss gains by the outputs of several samples, one block of lanes each, to what it gains by weights, which is added to `by_weights`.
    /// The inputs of sample c begin at `x[c * stride]`, its gains at `by_y[c * outputs]`. Many samples at once cost less than one by one: sums stay in
    /// registers.
    ///
    /// # Panics
    /// Where lists are shorter than the layer.
    pub fn to_weights(self, (x, stride): (&[F32x16], usize), by_y: &[F32x16], by_weights: &mut [F32x16]) {
        dispatch!(level(), simd => to_weights_at(simd, self, (x, stride), by_y, by_weights));
    }
}

/// Cells of several evaluations, each `stride` behind the one before.
#[derive(Clone, Copy, Debug)]
pub struct Rows<'a> {
    /// All cells from the first evaluation's on.
    pub cells: &'a [F32x16],
    /// Cells from one evaluation to the next.
    pub stride: usize,
}

impl Dense {
    /// Adds to `by_weights` what a loss gains by the weights over several evaluations and all lanes, from their inputs and what it gains by their outputs.
    ///
    /// Each sum stays in registers over all evaluations: with many inputs that is several times faster than gains by weights in lanes, which are
    /// fetched and written for every evaluation.
    ///
    /// # Panics
    /// Where lists are shorter than the layer.
    pub fn weight_gains(self, x: Rows, by_y: Rows, times: usize, by_weights: &mut [f32]) {
        dispatch!(level(), simd => gains_at(simd, self, (x, by_y), times, by_weights));
    }
}

/// What a loss gains by the numbers before a tanh, from what it gains by those after it, `y`: in place.
pub fn undo_tanh(y: &[F32x16], gains: &mut [F32x16]) {
    #[inline(always)]
    fn at<S: Simd>(simd: S, y: &[F32x16], gains: &mut [F32x16]) {
        vectorize(
            simd,
            #[inline(always)]
            || undo::<f32x16<S>>(simd, y, gains),
        );
    }
    dispatch!(level(), simd => at(simd, y, gains));
}

/// Sum over lanes.
pub fn sum(cell: &F32x16) -> f32 {
    // By halves, so that no sum waits for the one before.
    let mut v = cell.0;
    for half in [8, 4, 2, 1] {
        for i in 0..half {
            v[i] += v[i + half];
        }
    }
    v[0]
}

#[inline(always)]
fn forward_at<S: Simd>(simd: S, layer: Dense, weights: &[f32], x: &[F32x16], y: &mut [F32x16], tanh: bool) {
    vectorize(
        simd,
        #[inline(always)]
        || forward::<f32x16<S>>(simd, layer, weights, x, y, tanh),
    );
}

#[inline(always)]
fn backward_at<S: Simd>(
    simd: S,
    layer: Dense,
    weights: &[f32],
    given: (&[F32x16], &[F32x16]),
    by_x: &mut [F32x16],
    by_weights: &mut [F32x16],
) {
    vectorize(
        simd,
        #[inline(always)]
        || backward::<f32x16<S>>(simd, layer, weights, given, by_x, by_weights),
    );
}

#[inline(always)]
fn to_inputs_at<S: Simd>(simd: S, layer: Dense, weights: &[f32], by_y: &[F32x16], by_x: &mut [F32x16]) {
    vectorize(
        simd,
        #[inline(always)]
        || to_inputs::<f32x16<S>>(simd, layer, weights, by_y, by_x),
    );
}

#[inline(always)]
fn to_weights_at<S: Simd>(
    simd: S,
    layer: Dense,
    x: (&[F32x16], usize),
    by_y: &[F32x16],
    by_weights: &mut [F32x16],
) {
    vectorize(
        simd,
        #[inline(always)]
        || to_weights::<f32x16<S>>(simd, layer, x, by_y, by_weights),
    );
}

#[inline(always)]
fn to_inputs<A: Arith<Cell = F32x16>>(
    t: A::Token,
    layer: Dense,
    weights: &[f32],
    by_y: &[F32x16],
    by_x: &mut [F32x16],
) {
    let (n, m) = (layer.inputs, layer.outputs);
    let rows = &weights[..n * m];
    let by_y = &by_y[..m];
    let wanted = by_x.len().min(n);
    let mut i = 0;
    while i < wanted {
        let k = if i + AT_ONCE <= wanted { AT_ONCE } else { 1 };
        let mut sums = [A::lit(t, 0.0); AT_ONCE];
        if k == AT_ONCE {
            for j in 0..m {
                let gain = A::load(t, &by_y[j]);
                let row = &rows[j * n + i..j * n + i + AT_ONCE];
                for s in 0..AT_ONCE {
                    sums[s] = A::every(t, row[s]).mul_add(gain, sums[s]);
                }
            }
        } else {
            for j in 0..m {
                sums[0] = A::every(t, rows[j * n + i]).mul_add(A::load(t, &by_y[j]), sums[0]);
            }
        }
        for s in 0..k {
            sums[s].store(&mut by_x[i + s]);
        }
        i += k;
    }
}

#[inline(always)]
fn gains_at<S: Simd>(simd: S, layer: Dense, rows: (Rows, Rows), times: usize, by_weights: &mut [f32]) {
    vectorize(
        simd,
        #[inline(always)]
        || gains_over::<f32x16<S>>(simd, layer, rows, times, by_weights),
    );
}

/// Outputs and inputs whose products are summed at once over all lanes.
const SQUARE: usize = 4;

#[inline(always)]
fn gains_over<A: Arith<Cell = F32x16>>(
    t: A::Token,
    layer: Dense,
    (x, by_y): (Rows, Rows),
    times: usize,
    by_weights: &mut [f32],
) {
    let (n, m) = (layer.inputs, layer.outputs);
    let (by_rows, by_biases) = by_weights[..layer.len()].split_at_mut(n * m);
    let mut cell = F32x16([0.0; 16]);
    for j in 0..m {
        let mut total = A::lit(t, 0.0);
        for k in 0..times {
            total = total + A::load(t, &by_y.cells[k * by_y.stride + j]);
        }
        total.store(&mut cell);
        by_biases[j] += sum(&cell);
    }
    for j in (0..m).step_by(SQUARE) {
        for i in (0..n).step_by(SQUARE) {
            let mut sums = [[A::lit(t, 0.0); SQUARE]; SQUARE];
            // Tiles at the edges repeat the last row and column.
            let (js, is) = (
                [0, 1, 2, 3].map(|a: usize| (j + a).min(m - 1)),
                [0, 1, 2, 3].map(|b: usize| (i + b).min(n - 1)),
            );
            for k in 0..times {
                let gains = js.map(|j| A::load(t, &by_y.cells[k * by_y.stride + j]));
                let given = is.map(|i| A::load(t, &x.cells[k * x.stride + i]));
                for a in 0..SQUARE {
                    for b in 0..SQUARE {
                        sums[a][b] = gains[a].mul_add(given[b], sums[a][b]);
                    }
                }
            }
            for a in 0..SQUARE.min(m - j) {
                for b in 0..SQUARE.min(n - i) {
                    sums[a][b].store(&mut cell);
                    by_rows[(j + a) * n + i + b] += sum(&cell);
                }
            }
        }
    }
}

/// Outputs and inputs whose products are summed side by side.
const TILE: [usize; 2] = [4, 2];

#[inline(always)]
fn to_weights<A: Arith<Cell = F32x16>>(
    t: A::Token,
    layer: Dense,
    x: (&[F32x16], usize),
    by_y: &[F32x16],
    by_weights: &mut [F32x16],
) {
    let (n, m) = (layer.inputs, layer.outputs);
    let (by_rows, by_biases) = by_weights[..layer.len()].split_at_mut(n * m);
    for (j, bias) in by_biases.iter_mut().enumerate() {
        let mut sum = A::load(t, bias);
        for gains in by_y.chunks_exact(m) {
            sum = sum + A::load(t, &gains[j]);
        }
        sum.store(bias);
    }
    let (whole_m, whole_n) = (m - m % TILE[0], n - n % TILE[1]);
    for j in (0..whole_m).step_by(TILE[0]) {
        for i in (0..whole_n).step_by(TILE[1]) {
            tile::<A, 4, 2>(t, (n, m), x, by_y, by_rows, (j, i));
        }
        if whole_n < n {
            tile::<A, 4, 1>(t, (n, m), x, by_y, by_rows, (j, whole_n));
        }
    }
    for j in whole_m..m {
        for i in 0..n {
            tile::<A, 1, 1>(t, (n, m), x, by_y, by_rows, (j, i));
        }
    }
}

/// Adds the products of `J` gains and `I` inputs, from these numbers on, over all samples.
#[inline(always)]
fn tile<A: Arith<Cell = F32x16>, const J: usize, const I: usize>(
    t: A::Token,
    (n, m): (usize, usize),
    (x, stride): (&[F32x16], usize),
    by_y: &[F32x16],
    by_rows: &mut [F32x16],
    (j, i): (usize, usize),
) {
    let mut sums = [[A::lit(t, 0.0); I]; J];
    for (c, gains) in by_y.chunks_exact(m).enumerate() {
        let gains = &gains[j..j + J];
        let inputs = &x[c * stride + i..c * stride + i + I];
        for b in 0..I {
            let v = A::load(t, &inputs[b]);
            for a in 0..J {
                sums[a][b] = A::load(t, &gains[a]).mul_add(v, sums[a][b]);
            }
        }
    }
    for a in 0..J {
        for b in 0..I {
            let to = &mut by_rows[(j + a) * n + i + b];
            (A::load(t, to) + sums[a][b]).store(to);
        }
    }
}

#[inline(always)]
fn tanh_of<A: Arith>(t: A::Token, v: A) -> A {
    let (one, two) = (A::lit(t, 1.0), A::lit(t, 2.0));
    // Beyond ±9 it differs from ±1 by less than rounding.
    let held = v.max(A::lit(t, -9.0)).min(A::lit(t, 9.0));
    one - two / ((two * held).exp() + one)
}

#[inline(always)]
fn forward<A: Arith<Cell = F32x16>>(
    t: A::Token,
    layer: Dense,
    weights: &[f32],
    x: &[F32x16],
    y: &mut [F32x16],
    tanh: bool,
) {
    let (n, m) = (layer.inputs, layer.outputs);
    let (rows, biases) = weights[..layer.len()].split_at(n * m);
    let x = &x[..n];
    let mut j = 0;
    while j < m {
        let k = if j + AT_ONCE <= m { AT_ONCE } else { 1 };
        let mut sums = [A::lit(t, 0.0); AT_ONCE];
        for s in 0..k {
            sums[s] = A::every(t, biases[j + s]);
        }
        if k == AT_ONCE {
            let rows = &rows[j * n..(j + AT_ONCE) * n];
            for i in 0..n {
                let v = A::load(t, &x[i]);
                for s in 0..AT_ONCE {
                    sums[s] = A::every(t, rows[s * n + i]).mul_add(v, sums[s]);
                }
            }
        } else {
            for i in 0..n {
                sums[0] = A::every(t, rows[j * n + i]).mul_add(A::load(t, &x[i]), sums[0]);
            }
        }
        for s in 0..k {
            let v = if tanh { tanh_of(t, sums[s]) } else { sums[s] };
            v.store(&mut y[j + s]);
        }
        j += k;
    }
}

#[inline(always)]
fn backward<A: Arith<Cell = F32x16>>(
    t: A::Token,
    layer: Dense,
    weights: &[f32],
    (x, by_y): (&[F32x16], &[F32x16]),
    by_x: &mut [F32x16],
    by_weights: &mut [F32x16],
) {
    let (n, m) = (layer.inputs, layer.outputs);
    let rows = &weights[..n * m];
    let (x, by_x) = (&x[..n], &mut by_x[..n]);
    let (by_rows, by_biases) = by_weights[..layer.len()].split_at_mut(n * m);
    for i in 0..n {
        A::lit(t, 0.0).store(&mut by_x[i]);
    }
    let mut j = 0;
    while j < m {
        let k = if j + 4 <= m { 4 } else { 1 };
        let mut gains = [A::lit(t, 0.0); 4];
        for s in 0..k {
            gains[s] = A::load(t, &by_y[j + s]);
            (A::load(t, &by_biases[j + s]) + gains[s]).store(&mut by_biases[j + s]);
        }
        let rows = &rows[j * n..(j + k) * n];
        let by_rows = &mut by_rows[j * n..(j + k) * n];
        for i in 0..n {
            let v = A::load(t, &x[i]);
            let mut sum = A::load(t, &by_x[i]);
            for s in 0..k {
                let at = s * n + i;
                gains[s].mul_add(v, A::load(t, &by_rows[at])).store(&mut by_rows[at]);
                sum = A::every(t, rows[at]).mul_add(gains[s], sum);
            }
            sum.store(&mut by_x[i]);
        }
        j += k;
    }
}

#[inline(always)]
fn undo<A: Arith<Cell = F32x16>>(t: A::Token, y: &[F32x16], gains: &mut [F32x16]) {
    let one = A::lit(t, 1.0);
    for i in 0..gains.len() {
        let v = A::load(t, &y[i]);
        (A::load(t, &gains[i]) * v.mul_from(v, one)).store(&mut gains[i]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::Cell;

    fn wave(k: usize) -> f32 {
        ((k as f32 + 1.0) * 12.9898).sin()
    }

    #[test]
    fn layers_are_sums_of_products_and_backwards_their_slopes() {
        for (inputs, outputs) in [(1, 1), (5, 3), (13, 8), (43, 64), (64, 4), (7, 21)] {
            let layer = Dense { inputs, outputs };
            let weights: Vec<f32> = (0..layer.len()).map(|k| 0.3 * wave(k)).collect();
            let cell = |from: usize| {
                let mut cell = F32x16::splat(0.0);
                cell.fill(0, |lane| wave(7 * from + 31 * lane));
                cell
            };
            let x: Vec<F32x16> = (0..inputs).map(cell).collect();
            let by_y: Vec<F32x16> = (0..outputs).map(|j| cell(j + 1000)).collect();
            let mut y = vec![F32x16::splat(0.0); outputs];
            layer.forward(&weights, &x, &mut y, false);
            let mut bent = y.clone();
            layer.forward(&weights, &x, &mut bent, true);
            let (mut by_x, mut by_weights) = (vec![cell(3); inputs], vec![F32x16::splat(1.0); layer.len()]);
            layer.backward(&weights, &x, &by_y, &mut by_x, &mut by_weights);
            let mut undone = by_y.clone();
            undo_tanh(&bent, &mut undone);
            // The same in two steps, the weights from three samples at once.
            let mut alone = vec![F32x16::splat(0.0); inputs];
            layer.to_inputs(&weights, &by_y, &mut alone);
            let (stride, mut three) = (inputs + 2, vec![F32x16::splat(1.0); layer.len()]);
            let samples = [&x[..], &[cell(1), cell(2)]].concat().repeat(3);
            layer.to_weights((&samples, stride), &by_y.repeat(3), &mut three);
            for lane in 0..F32x16::LANES {
                let close = |a: f32, b: f32| assert!((a - b).abs() < 2e-5, "{inputs} {outputs}: {a} {b}");
                for (a, b) in alone.iter().zip(&by_x) {
                    close(a.get(lane), b.get(lane));
                }
                for (a, b) in three.iter().zip(&by_weights) {
                    close(a.get(lane) - 1.0, 3.0 * (b.get(lane) - 1.0));
                }
                for j in 0..outputs {
                    let products = (0..inputs).map(|i| weights[j * inputs + i] * x[i].get(lane));
                    let wanted = weights[inputs * outputs + j] + products.sum::<f32>();
                    close(y[j].get(lane), wanted);
                    close(bent[j].get(lane), wanted.tanh());
                    let slope = 1.0 - wanted.tanh().powi(2);
                    close(undone[j].get(lane), by_y[j].get(lane) * slope);
                    close(by_weights[inputs * outputs + j].get(lane), 1.0 + by_y[j].get(lane));
                    for i in 0..inputs {
                        close(by_weights[j * inputs + i].get(lane), 1.0 + by_y[j].get(lane) * x[i].get(lane));
                    }
                }
                for i in 0..inputs {
                    let products = (0..outputs).map(|j| weights[j * inputs + i] * by_y[j].get(lane));
                    close(by_x[i].get(lane), products.sum::<f32>());
                }
            }
            // Over two evaluations of which the second is half of the first, and all lanes; the first inputs alone.
            let halves = |cells: &[F32x16]| -> Vec<F32x16> {
                let half = cells.iter().map(|c| F32x16(c.0.map(|v| 0.5 * v)));
                cells.iter().copied().chain(half).collect()
            };
            let (xs, gains) = (halves(&x), halves(&by_y));
            let (xs, gains) = (Rows { cells: &xs, stride: inputs }, Rows { cells: &gains, stride: outputs });
            let mut sums = vec![2.0; layer.len()];
            layer.weight_gains(xs, gains, 2, &mut sums);
            for (k, got) in sums.iter().enumerate() {
                let once = sum(&by_weights[k]) - F32x16::LANES as f32;
                let wanted = 2.0 + once * if k < inputs * outputs { 1.25 } else { 1.5 };
                assert!((got - wanted).abs() < 2e-4, "{inputs} {outputs} {k}: {got} {wanted}");
            }
            let mut first = vec![cell(9); inputs.div_ceil(2)];
            layer.to_inputs(&weights, &by_y, &mut first);
            assert!(first.iter().zip(&by_x).all(|(a, b)| (0..16).all(|l| (a.0[l] - b.0[l]).abs() < 2e-5)));
        }
    }
}
