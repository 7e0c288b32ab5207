//! Reverse-mode derivatives of a graph: from the gradient with respect to each result to the gradient with respect to each
//! input.
//!
//! The sweep is generic over the number type: over f64 it is the reference, over [`Sym`] it records the gradient as a graph
//! of its own, which is scheduled, printed and run like any other.
//!
//! ```
//! use propwash_trace::{Real, adjoint::adjoint, trace::{Sym, trace}};
//!
//! fn area<S: Real>(v: &[S]) -> S {
//!     v[0] * v[1]
//! }
//! let graph = trace(2, |v| vec![area::<Sym>(v)]);
//! // Inputs: those of the graph, then the derivative of the loss by each of its results.
//! assert_eq!(adjoint(&graph).eval(&[3.0, 4.0, 1.0]), [4.0, 3.0]);
//! ```

use super::Real;
use super::trace::{Graph, Node, NodeId, Sym, trace_finite};

/// A value of a graph over the number type `S`.
#[derive(Clone, Copy)]
enum Value<S: Real> {
    Number(S),
    Truth(S::Mask),
}

impl<S: Real> Value<S> {
    fn number(self) -> S {
        match self {
            Self::Number(v) => v,
            Self::Truth(mask) => S::select(mask, S::one(), S::zero()),
        }
    }

    fn truth(self) -> S::Mask {
        match self {
            Self::Truth(mask) => mask,
            Self::Number(v) => !v.le(S::zero()),
        }
    }
}

/// All values of a graph for these inputs; `half_turn` is [`Real::half_turn`], or another way to compute it.
fn values<S: Real>(graph: &Graph, inputs: &[S], half_turn: impl Fn(S) -> (S, S)) -> Vec<Value<S>> {
    let mut out: Vec<Value<S>> = Vec::with_capacity(graph.nodes.len());
    for node in &graph.nodes {
        let n = |place: NodeId| out[place as usize].number();
        let t = |place: NodeId| out[place as usize].truth();
        let zero = S::zero();
        let value = match *node {
            Node::Literal(bits) => Value::Number(S::lit(f64::from_bits(bits))),
            Node::Input(i) => Value::Number(inputs[i as usize]),
            Node::Add(a, b) => Value::Number(n(a) + n(b)),
            Node::Sub(a, b) => Value::Number(n(a) - n(b)),
            Node::Mul(a, b) => Value::Number(n(a) * n(b)),
            Node::Div(a, b) => Value::Number(n(a) / n(b)),
            Node::Neg(a) => Value::Number(-n(a)),
            Node::Sqrt(a) => Value::Number(n(a).sqrt()),
            Node::Sin(a) => Value::Number(n(a).sin_cos().0),
            Node::Cos(a) => Value::Number(n(a).sin_cos().1),
            Node::TurnSin(a) => Value::Number(half_turn(n(a)).0),
            Node::TurnCos(a) => Value::Number(half_turn(n(a)).1),
            Node::Exp(a) => Value::Number(n(a).exp()),
            Node::Atan2(a, b) => Value::Number(n(a).atan2(n(b))),
            Node::Floor(a) => Value::Number(n(a).floor()),
            Node::Lt(a, b) => Value::Truth(n(a).lt(n(b))),
            Node::Le(a, b) => Value::Truth(n(a).le(n(b))),
            Node::Truth(true) => Value::Truth(zero.le(zero)),
            Node::Truth(false) => Value::Truth(zero.lt(zero)),
            Node::And(a, b) => Value::Truth(t(a) & t(b)),
            Node::Or(a, b) => Value::Truth(t(a) | t(b)),
            Node::Not(a) => Value::Truth(!t(a)),
            Node::Select(a, b, c) => Value::Number(S::select(t(a), n(b), n(c))),
        };
        out.push(value);
    }
    out
}

/// The results of a graph for these inputs, over any number type: over symbols a graph within another.
///
/// # Panics
/// Where there are fewer inputs than [`Graph::n_inputs`].
pub fn evaluate<S: Real>(graph: &Graph, inputs: &[S]) -> Vec<S> {
    evaluate_with(graph, inputs, S::half_turn)
}

/// The same with another way to compute [`Real::half_turn`].
pub(crate) fn evaluate_with<S: Real>(graph: &Graph, inputs: &[S], half_turn: impl Fn(S) -> (S, S)) -> Vec<S> {
    assert!(inputs.len() >= graph.n_inputs, "expected {} inputs, found {}", graph.n_inputs, inputs.len());
    let values = values(graph, inputs, half_turn);
    graph.outputs.iter().map(|place| values[*place as usize].number()).collect()
}

/// Below this squared angle, rad², the slope of [`Real::half_turn`] is taken from its series: the closed form loses
/// precision.
const SMALL_TURN: f64 = 0.05;

/// d/dθ² of sin(θ/2)/θ, given θ² and both results of [`Real::half_turn`]. Series to θ⁸, error below 1e-17 where it is used.
fn turn_slope<S: Real>(t2: S, sin_over: S, cos: S) -> S {
    let small = t2.lt(S::lit(SMALL_TURN));
    // (−1)ⁿ n / (2²ⁿ⁺¹ (2n+1)!) for n from 1.
    let series = [-1.0 / 48.0, 2.0 / 3840.0, -3.0 / 645_120.0, 4.0 / 185_794_560.0, -5.0 / 81_749_606_400.0];
    let sum = series.iter().rev().fold(S::zero(), |sum, c| sum * t2 + S::lit(*c));
    let far = S::select(small, S::one(), t2);
    S::select(small, sum, (S::lit(0.5) * cos - sin_over) / (far + far))
}

/// Gradient with respect to each input, given the gradient `seeds` with respect to each result. A select passes the
/// gradient to the chosen side only, whatever the slope of the other (√0 …); a floor has slope zero.
///
/// # Panics
/// Where there are fewer inputs than [`Graph::n_inputs`], or fewer seeds than results.
pub fn pull_back<S: Real>(graph: &Graph, inputs: &[S], seeds: &[S]) -> Vec<S> {
    assert!(inputs.len() >= graph.n_inputs, "expected {} inputs, found {}", graph.n_inputs, inputs.len());
    assert!(
        seeds.len() >= graph.outputs.len(),
        "expected {} seeds, found {}",
        graph.outputs.len(),
        seeds.len()
    );
    let values = values(graph, inputs, S::half_turn);
    let zero = S::zero();
    let mut gains: Vec<Option<S>> = vec![None; graph.nodes.len()];
    // A zero gradient stays zero even through an infinite slope.
    let by = |g: S, slope: S| S::select(g.abs().le(zero), zero, g * slope);
    let add = |gains: &mut Vec<Option<S>>, place: NodeId, gain: S| {
        let sum = &mut gains[place as usize];
        *sum = Some(sum.map_or(gain, |sum| sum + gain));
    };
    for (place, seed) in graph.outputs.iter().zip(seeds) {
        add(&mut gains, *place, *seed);
    }
    let mut out = vec![zero; inputs.len()];
    for (place, node) in graph.nodes.iter().enumerate().rev() {
        let Some(g) = gains[place] else { continue };
        let n = |place: NodeId| values[place as usize].number();
        let own = values[place].number();
        match *node {
            Node::Input(i) => out[i as usize] = g,
            Node::Add(a, b) => {
                add(&mut gains, a, g);
                add(&mut gains, b, g);
            }
            Node::Sub(a, b) => {
                add(&mut gains, a, g);
                add(&mut gains, b, -g);
            }
            Node::Mul(a, b) => {
                add(&mut gains, a, g * n(b));
                add(&mut gains, b, g * n(a));
            }
            Node::Div(a, b) => {
                let over = S::one() / n(b);
                add(&mut gains, a, by(g, over));
                add(&mut gains, b, -by(g, over * own));
            }
            Node::Neg(a) => add(&mut gains, a, -g),
            Node::Sqrt(a) => add(&mut gains, a, by(g, S::one() / (own + own))),
            Node::Sin(a) => add(&mut gains, a, g * n(a).sin_cos().1),
            Node::Cos(a) => add(&mut gains, a, -(g * n(a).sin_cos().0)),
            Node::TurnSin(a) => {
                let (sin_over, cos) = n(a).half_turn();
                add(&mut gains, a, g * turn_slope(n(a), sin_over, cos));
            }
            // d cos(θ/2)/dθ² = −¼ sin(θ/2)/θ.
            Node::TurnCos(a) => add(&mut gains, a, -(g * (S::lit(0.25) * n(a).half_turn().0))),
            Node::Exp(a) => add(&mut gains, a, g * own),
            Node::Atan2(a, b) => {
                let (y, x) = (n(a), n(b));
                let over = S::one() / (x * x + y * y);
                add(&mut gains, a, by(g, over * x));
                add(&mut gains, b, -by(g, over * y));
            }
            Node::Select(m, a, b) => {
                let mask = values[m as usize].truth();
                add(&mut gains, a, S::select(mask, g, zero));
                add(&mut gains, b, S::select(mask, zero, g));
            }
            Node::Literal(_) | Node::Floor(_) | Node::Truth(_) => {}
            Node::Lt(..) | Node::Le(..) | Node::And(..) | Node::Or(..) | Node::Not(_) => {}
        }
    }
    out
}

/// [`pull_back`] as a graph: its inputs are those of `graph` followed by one seed per result; its results are the gradients
/// with respect to each input of `graph`.
pub fn adjoint(graph: &Graph) -> Graph {
    let n = graph.n_inputs;
    trace_finite(n + graph.outputs.len(), |x| pull_back::<Sym>(graph, &x[..n], &x[n..]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dual::Dual;
    use crate::trace::tests::{POINTS, all};
    use crate::trace::trace;

    /// Uses every kind of node, with selects away from their switching points.
    fn formula<S: Real>(v: &[S]) -> Vec<S> {
        let [a, b, c] = [v[0], v[1], v[2]];
        let (s, k) = (a * b - c).sin_cos();
        let (turn, half) = (a * a + b * b).half_turn();
        let (small, flat) = (c * c * S::lit(1e-3)).half_turn();
        let either = (a.lt(b) | c.le(a)) & !b.lt(S::zero());
        let chosen = S::select(either, s / (b + S::lit(3.0)), k.exp());
        vec![
            chosen + turn * half,
            a.atan2(b) * (a * a + c * c).sqrt() - c.floor() * b,
            small * k + flat - a.max(b),
        ]
    }

    #[test]
    fn gradients_are_those_of_duals() {
        let graph = trace(3, formula::<Sym>);
        let back = adjoint(&graph);
        for at in [[0.3, 0.8, -1.2], [1.4, 0.2, 0.9], [-0.7, -0.4, 2.5], [0.01, 0.02, 0.03]] {
            let duals: [Dual<f64, 3>; 3] = core::array::from_fn(|i| Dual::input(at[i], i));
            let wanted = formula(&duals);
            for (k, result) in wanted.iter().enumerate() {
                let mut seeds = [0.0; 3];
                seeds[k] = 1.0;
                let swept = pull_back(&graph, &at, &seeds);
                let traced = back.eval(&[&at[..], &seeds].concat());
                for i in 0..3 {
                    let want = result.partials[i];
                    assert!((swept[i] - want).abs() < 1e-13 * (1.0 + want.abs()), "{at:?} {k} {i}");
                    assert!((traced[i] - want).abs() < 1e-13 * (1.0 + want.abs()), "{at:?} {k} {i}");
                }
            }
        }
    }

    #[test]
    fn slopes_backwards_are_those_of_finite_differences() {
        let graph = trace(3, all::<Sym>);
        let back = adjoint(&graph);
        assert!(back.len() < 5 * graph.len(), "{} after {}", back.len(), graph.len());
        for x in POINTS {
            let weights = [0.7, -1.3, 0.4];
            let slopes = back.eval(&[x.as_slice(), &weights].concat());
            let value = |x: &[f64]| -> f64 { all(x).iter().zip(&weights).map(|(v, w)| v * w).sum() };
            for k in 0..3 {
                let at = |h: f64| {
                    let mut y = x;
                    y[k] += h;
                    value(&y)
                };
                let slope = (at(1e-6) - at(-1e-6)) / 2e-6;
                assert!(
                    (slopes[k] - slope).abs() < 1e-7 * (1.0 + slope.abs()),
                    "{x:?} {k}: {} {slope}",
                    slopes[k]
                );
            }
        }
    }

    #[test]
    fn an_infinite_slope_on_the_side_that_is_not_chosen_does_no_harm() {
        fn guarded<S: Real>(v: &[S]) -> Vec<S> {
            let some = S::zero().lt(v[0]);
            let (root, over, angle) = (v[0].sqrt(), v[1] / v[0], v[0].atan2(v[0]));
            vec![S::select(some, root + over + angle, v[1] * S::lit(3.0))]
        }
        let graph = trace(2, guarded::<Sym>);
        assert_eq!(pull_back(&graph, &[0.0, 2.0], &[1.0]), [0.0, 3.0]);
        assert_eq!(adjoint(&graph).eval(&[0.0, 2.0, 1.0]), [0.0, 3.0]);
    }

    #[test]
    fn the_slope_of_a_turn_is_exact_on_both_sides_of_its_series() {
        for t2 in [0.0, 1e-12, 0.99e-6, 1.01e-6, 1e-3, 0.049_999, 0.050_001, 0.3, 4.0] {
            let dual = Dual::<f64, 1>::input(t2, 0).half_turn().0;
            let (sin_over, cos) = Real::half_turn(t2);
            let slope = turn_slope(t2, sin_over, cos);
            // The dual's own slope loses precision near zero, in proportion to 1/θ².
            assert!((slope - dual.partials[0]).abs() < 1e-14 + 1e-15 / t2.max(1e-6), "{t2}");
        }
    }
}
