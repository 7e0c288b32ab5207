//! A small neural network as data: layers of numbers that are checked once and evaluated over any number type.
//!
//! Every input is scaled, passes at most two layers of tanh and one linear layer (a multilayer perceptron; Bishop, "Pattern
//! recognition and machine learning", 2006, ch. 5.1). A network says nothing about inputs that it has not seen: outside the stated
//! range of every input its outputs fade to zero over a margin, with a continuous slope.

use super::Real;
use super::program::tanh;

/// Most weights of a network, biases included.
pub const MAX_WEIGHTS: usize = 1000;
/// Most numbers of one layer, and most inputs.
pub const MAX_WIDTH: usize = 32;
/// Most hidden layers.
pub const MAX_HIDDEN: usize = 2;

/// How an input enters, and where it was seen; all in the input's unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scaling {
    /// Subtracted from the input.
    pub offset: f64,
    /// What is left is divided by this; above 0.
    pub scale: f64,
    /// Lower end of the range in which the network counts in full.
    pub low: f64,
    /// Upper end of that range.
    pub high: f64,
    /// Distance beyond either end over which the outputs fade to zero; above 0.
    pub margin: f64,
}

/// One layer: weight × input + bias.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Layer {
    /// Weights, shape (output, input).
    pub weight: Vec<Vec<f64>>,
    /// Biases, shape (output).
    pub bias: Vec<f64>,
}

impl Layer {
    /// Number of weights and biases.
    pub fn n_weights(&self) -> usize {
        self.bias.len() + self.weight.iter().map(Vec::len).sum::<usize>()
    }
}

/// Why numbers make no network.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected {expected}, found {found}")]
pub struct MlpError {
    /// The part that is wrong: `hidden.0.weight.3`.
    pub place: String,
    /// What was expected.
    pub expected: String,
    /// What was found.
    pub found: String,
}

fn fault(place: impl Into<String>, expected: impl Into<String>, found: impl ToString) -> MlpError {
    MlpError { place: place.into(), expected: expected.into(), found: found.to_string() }
}

/// A checked network.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mlp {
    inputs: Vec<Scaling>,
    hidden: Vec<Layer>,
    output: Layer,
}

impl Mlp {
    /// Checks the numbers of a network: shapes that fit each other, finite numbers, at most [`MAX_WEIGHTS`] of them in the layers.
    ///
    /// # Errors
    /// [`MlpError`] with the place of the first fault.
    pub fn new(inputs: Vec<Scaling>, hidden: Vec<Layer>, output: Layer) -> Result<Self, MlpError> {
        if !(1..=MAX_WIDTH).contains(&inputs.len()) {
            return Err(fault("input", format!("1 to {MAX_WIDTH} inputs"), inputs.len()));
        }
        if !(1..=MAX_HIDDEN).contains(&hidden.len()) {
            return Err(fault("hidden", format!("1 to {MAX_HIDDEN} hidden layers"), hidden.len()));
        }
        for (i, input) in inputs.iter().enumerate() {
            checked_scaling(&format!("input.{i}"), input)?;
        }
        let n_weights = hidden.iter().chain([&output]).map(Layer::n_weights).sum::<usize>();
        if n_weights > MAX_WEIGHTS {
            return Err(fault(
                "hidden",
                format!("at most {MAX_WEIGHTS} weights and biases in all"),
                n_weights,
            ));
        }
        let mut width = inputs.len();
        for (i, layer) in hidden.iter().enumerate() {
            width = checked_layer(&format!("hidden.{i}"), layer, width)?;
        }
        checked_layer("output", &output, width)?;
        Ok(Self { inputs, hidden, output })
    }

    /// How its inputs enter.
    pub fn inputs(&self) -> &[Scaling] {
        &self.inputs
    }

    /// Its hidden layers, in order.
    pub fn hidden(&self) -> &[Layer] {
        &self.hidden
    }

    /// Its last layer.
    pub fn output(&self) -> &Layer {
        &self.output
    }

    /// Number of its outputs.
    pub fn n_outputs(&self) -> usize {
        self.output.bias.len()
    }

    /// Number of its weights and biases.
    pub fn n_weights(&self) -> usize {
        self.hidden.iter().chain([&self.output]).map(Layer::n_weights).sum()
    }

    /// Its outputs, the rest of the array zero; `input` gives input number i.
    pub fn eval<S: Real>(&self, input: impl Fn(usize) -> S) -> [S; MAX_WIDTH] {
        let mut now = [S::zero(); MAX_WIDTH];
        let mut share = S::one();
        for (i, of) in self.inputs.iter().enumerate() {
            let value = input(i);
            now[i] = (value - S::lit(of.offset)) / S::lit(of.scale);
            share = share * of.share(value);
        }
        for layer in &self.hidden {
            now = layer.eval(&now);
            for value in now.iter_mut().take(layer.bias.len()) {
                *value = tanh(*value);
            }
        }
        let mut out = self.output.eval(&now);
        for value in out.iter_mut().take(self.output.bias.len()) {
            *value = share * *value;
        }
        out
    }
}

impl Mlp {
    /// All weights and biases: layer by layer, row by row, the biases of a layer after its weights.
    pub fn weights(&self) -> Vec<f64> {
        let layers = self.hidden.iter().chain([&self.output]);
        layers.flat_map(|l| l.weight.iter().flatten().chain(&l.bias).copied()).collect()
    }

    /// The same network with other weights, in the order of [`Mlp::weights`]; those that are missing stay.
    #[must_use]
    pub fn with_weights(&self, weights: &[f64]) -> Self {
        let mut out = self.clone();
        let mut given = weights.iter();
        for layer in out.hidden.iter_mut().chain([&mut out.output]) {
            for slot in layer.weight.iter_mut().flatten().chain(&mut layer.bias) {
                if let Some(v) = given.next() {
                    *slot = *v;
                }
            }
        }
        out
    }

    /// Outputs for the inputs `x`, and their derivatives by every weight, shape (output, weight), by one sweep backwards for each
    /// output (backpropagation; Rumelhart, Hinton & Williams, Nature 323, 1986).
    pub fn by_weights(&self, x: &[f64]) -> (Vec<f64>, Vec<Vec<f64>>) {
        let share: f64 = self.inputs.iter().zip(x).map(|(of, v)| of.share(*v)).product();
        // What enters every layer.
        let scaled =
            self.inputs.iter().zip(x).map(|(of, v)| (v - of.offset) / of.scale).collect::<Vec<f64>>();
        let mut entered = vec![scaled];
        let sums = |layer: &Layer, input: &[f64]| -> Vec<f64> {
            let row = |(row, bias): (&Vec<f64>, &f64)| {
                row.iter().zip(input).map(|(w, v)| w * v).sum::<f64>() + bias
            };
            layer.weight.iter().zip(&layer.bias).map(row).collect()
        };
        for layer in &self.hidden {
            let next = sums(layer, entered.last().map_or(&[][..], Vec::as_slice));
            entered.push(next.into_iter().map(f64::tanh).collect());
        }
        let last = entered.last().map_or(&[][..], Vec::as_slice);
        let out: Vec<f64> = sums(&self.output, last).into_iter().map(|v| share * v).collect();
        let slopes = (0..out.len()).map(|o| self.slopes_of(o, share, &entered)).collect();
        (out, slopes)
    }

    /// Derivatives of output `o` by every weight; `entered` is what enters each layer.
    fn slopes_of(&self, o: usize, share: f64, entered: &[Vec<f64>]) -> Vec<f64> {
        let layers: Vec<&Layer> = self.hidden.iter().chain([&self.output]).collect();
        let mut parts: Vec<Vec<f64>> = Vec::with_capacity(layers.len());
        // Derivative of the output by the sums of the layer at hand.
        let mut by_sum = vec![0.0; self.n_outputs()];
        by_sum[o] = share;
        for (layer, input) in layers.iter().zip(entered).rev() {
            let mut part: Vec<f64> = by_sum.iter().flat_map(|d| input.iter().map(move |v| d * v)).collect();
            part.extend(&by_sum);
            parts.push(part);
            by_sum = (0..input.len())
                .map(|i| {
                    let back: f64 = layer.weight.iter().zip(&by_sum).map(|(row, d)| d * row[i]).sum();
                    back * (1.0 - input[i] * input[i])
                })
                .collect();
        }
        parts.into_iter().rev().flatten().collect()
    }
}

impl Scaling {
    /// 1 within the range, 0 beyond its margins, between them 3 t² − 2 t³ (Hermite's cubic, whose slope is zero at both ends).
    pub fn share<S: Real>(&self, value: S) -> S {
        let beyond = (S::lit(self.low) - value).max(value - S::lit(self.high));
        let t = (S::one() - beyond / S::lit(self.margin)).clamp(S::zero(), S::one());
        t * t * (S::lit(3.0) - S::lit(2.0) * t)
    }
}

impl Layer {
    fn eval<S: Real>(&self, input: &[S; MAX_WIDTH]) -> [S; MAX_WIDTH] {
        let mut out = [S::zero(); MAX_WIDTH];
        for ((out, row), bias) in out.iter_mut().zip(&self.weight).zip(&self.bias) {
            let mut sum = S::lit(*bias);
            for (weight, value) in row.iter().zip(input) {
                sum = sum + S::lit(*weight) * *value;
            }
            *out = sum;
        }
        out
    }
}

fn checked_scaling(place: &str, input: &Scaling) -> Result<(), MlpError> {
    let Scaling { offset, scale, low, high, margin } = *input;
    for (name, v) in [("offset", offset), ("scale", scale), ("low", low), ("high", high), ("margin", margin)]
    {
        if !v.is_finite() {
            return Err(fault(format!("{place}.{name}"), "a finite number", v));
        }
    }
    for (name, v) in [("scale", scale), ("margin", margin)] {
        if v <= 0.0 {
            return Err(fault(format!("{place}.{name}"), "a number above 0", v));
        }
    }
    if low >= high {
        return Err(fault(format!("{place}.low"), format!("less than high, {high}"), low));
    }
    Ok(())
}

/// Number of outputs of a layer that takes `width` numbers.
fn checked_layer(place: &str, layer: &Layer, width: usize) -> Result<usize, MlpError> {
    let n = layer.bias.len();
    if !(1..=MAX_WIDTH).contains(&n) {
        return Err(fault(format!("{place}.bias"), format!("1 to {MAX_WIDTH} numbers"), n));
    }
    if layer.weight.len() != n {
        let expected = format!("{n} rows, one for each bias");
        return Err(fault(format!("{place}.weight"), expected, layer.weight.len()));
    }
    for (i, row) in layer.weight.iter().enumerate() {
        if row.len() != width {
            let expected = format!("{width} numbers, one for each number that enters the layer");
            return Err(fault(format!("{place}.weight.{i}"), expected, row.len()));
        }
        if let Some(k) = row.iter().position(|w| !w.is_finite()) {
            return Err(fault(format!("{place}.weight.{i}.{k}"), "a finite number", row[k]));
        }
    }
    match layer.bias.iter().position(|b| !b.is_finite()) {
        Some(k) => Err(fault(format!("{place}.bias.{k}"), "a finite number", layer.bias[k])),
        None => Ok(n),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dual::Dual;

    fn scaling(offset: f64, scale: f64) -> Scaling {
        Scaling { offset, scale, low: -2.0, high: 3.0, margin: 0.5 }
    }

    fn small() -> Mlp {
        let hidden = vec![
            Layer {
                weight: vec![vec![0.3, -1.2], vec![0.8, 0.4], vec![-0.5, 0.9]],
                bias: vec![0.1, -0.2, 0.0],
            },
            Layer { weight: vec![vec![1.1, -0.7, 0.2], vec![0.4, 0.6, -1.3]], bias: vec![0.05, -0.3] },
        ];
        let output = Layer { weight: vec![vec![0.7, -0.2], vec![1.5, 0.9]], bias: vec![0.02, -0.4] };
        Mlp::new(vec![scaling(0.5, 2.0), scaling(-0.1, 0.7)], hidden, output).unwrap()
    }

    #[test]
    fn it_computes_what_python_computes() {
        // Python 3.11, with math.tanh and sums of products:
        // def layer(W, b, x): return [sum(w * v for w, v in zip(row, x)) + c for row, c in zip(W, b)]
        // x = [(1.0 - 0.5) / 2.0, (-0.4 + 0.1) / 0.7]
        // h = [tanh(v) for v in layer([[.3, -1.2], [.8, .4], [-.5, .9]], [.1, -.2, 0], x)]
        // h = [tanh(v) for v in layer([[1.1, -.7, .2], [.4, .6, -1.3]], [.05, -.3], h)]
        // print(layer([[.7, -.2], [1.5, .9]], [.02, -.4], h))
        let by_python = [0.37282435601623265, 0.9152638999191954];
        let out = small().eval(|i| [1.0, -0.4][i]);
        for k in 0..2 {
            assert!((out[k] - by_python[k]).abs() < 1e-14, "{out:?}");
        }
        assert!(out[2..].iter().all(|v| *v == 0.0));
        let narrow = small().eval(|i| [1.0f32, -0.4][i]);
        assert!((f64::from(narrow[0]) - by_python[0]).abs() < 1e-6, "{narrow:?}");
        assert_eq!((small().n_weights(), small().n_outputs()), (9 + 8 + 6, 2));
    }

    #[test]
    fn slopes_are_those_of_differences_also_where_it_fades() {
        let net = small();
        for x in [[1.0, -0.4], [-2.2, 0.3], [3.3, 3.1], [0.0, 2.9], [-2.49, 1.0]] {
            let dual = net.eval(|i| Dual::<f64, 2>::input(x[i], i));
            for k in 0..2 {
                let at = |h: f64| {
                    let mut moved = x;
                    moved[k] += h;
                    net.eval(|i| moved[i])
                };
                let (up, down) = (at(1e-6), at(-1e-6));
                for o in 0..2 {
                    let slope = (up[o] - down[o]) / 2e-6;
                    assert!((dual[o].partials[k] - slope).abs() < 1e-8, "{x:?} {o} {k}");
                }
            }
        }
    }

    #[test]
    fn slopes_by_weights_are_those_of_differences() {
        let net = small();
        let weights = net.weights();
        assert_eq!(weights.len(), net.n_weights());
        assert_eq!(net.with_weights(&weights), net);
        for x in [[1.0, -0.4], [3.2, 0.7]] {
            let (out, slopes) = net.by_weights(&x);
            let direct = net.eval(|i| x[i]);
            assert!((out[0] - direct[0]).abs() < 1e-14 && (out[1] - direct[1]).abs() < 1e-14);
            for k in 0..weights.len() {
                let at = |h: f64| {
                    let mut moved = weights.clone();
                    moved[k] += h;
                    net.with_weights(&moved).eval(|i| x[i])
                };
                let (up, down) = (at(1e-6), at(-1e-6));
                for o in 0..2 {
                    let slope = (up[o] - down[o]) / 2e-6;
                    assert!((slopes[o][k] - slope).abs() < 1e-8, "{x:?} {o} {k}");
                }
            }
        }
    }

    #[test]
    fn outside_the_range_it_is_zero_with_its_slope() {
        let net = small();
        for x in [[-2.5, 0.0], [3.5, 0.0], [0.0, 1e6], [-1e6, 1e6], [0.0, -2.5]] {
            let out = net.eval(|i| Dual::<f64, 2>::input(x[i], i));
            for v in &out[..2] {
                assert!(v.value == 0.0 && v.partials == [0.0, 0.0], "{x:?} {v:?}");
            }
        }
        // In full within the range, up to its ends.
        let scaling = scaling(0.0, 1.0);
        assert_eq!([-2.0, 0.0, 3.0].map(|x: f64| scaling.share(x)), [1.0; 3]);
        assert_eq!(scaling.share(3.25), 0.5);
    }

    #[test]
    fn what_is_no_network_is_refused_with_its_place() {
        let layer = |rows: usize, columns: usize| Layer {
            weight: vec![vec![0.1; columns]; rows],
            bias: vec![0.0; rows],
        };
        let inputs = |n: usize| vec![scaling(0.0, 1.0); n];
        let place = |of: Result<Mlp, MlpError>| of.unwrap_err().place;
        assert_eq!(place(Mlp::new(inputs(0), vec![layer(2, 0)], layer(1, 2))), "input");
        assert_eq!(place(Mlp::new(inputs(33), vec![layer(2, 33)], layer(1, 2))), "input");
        assert_eq!(place(Mlp::new(inputs(2), vec![], layer(1, 2))), "hidden");
        assert_eq!(
            place(Mlp::new(inputs(2), vec![layer(2, 2), layer(2, 2), layer(2, 2)], layer(1, 2))),
            "hidden"
        );
        // 32·5 + 32 + 32·25 + 25 + 25 + 1 = 1043 weights.
        let large = Mlp::new(inputs(5), vec![layer(32, 5), layer(25, 32)], layer(1, 25)).unwrap_err();
        assert_eq!((large.place.as_str(), large.found.as_str()), ("hidden", "1043"));
        assert_eq!(place(Mlp::new(inputs(2), vec![layer(3, 2)], layer(1, 2))), "output.weight.0");
        assert_eq!(place(Mlp::new(inputs(2), vec![layer(3, 4)], layer(1, 3))), "hidden.0.weight.0");
        assert_eq!(place(Mlp::new(inputs(2), vec![layer(33, 2)], layer(1, 33))), "hidden.0.bias");
        let mut torn = layer(3, 2);
        torn.weight.pop();
        assert_eq!(place(Mlp::new(inputs(2), vec![torn], layer(1, 3))), "hidden.0.weight");
        let mut wild = layer(3, 2);
        wild.weight[2][1] = f64::NAN;
        assert_eq!(place(Mlp::new(inputs(2), vec![wild], layer(1, 3))), "hidden.0.weight.2.1");
        let mut wild = layer(1, 3);
        wild.bias[0] = f64::INFINITY;
        assert_eq!(place(Mlp::new(inputs(2), vec![layer(3, 2)], wild)), "output.bias.0");
        for (input, at) in [
            (Scaling { scale: 0.0, ..scaling(0.0, 1.0) }, "input.0.scale"),
            (Scaling { margin: -1.0, ..scaling(0.0, 1.0) }, "input.0.margin"),
            (Scaling { low: 4.0, ..scaling(0.0, 1.0) }, "input.0.low"),
            (Scaling { offset: f64::NAN, ..scaling(0.0, 1.0) }, "input.0.offset"),
        ] {
            assert_eq!(place(Mlp::new(vec![input], vec![layer(3, 1)], layer(1, 3))), at);
        }
    }
}
