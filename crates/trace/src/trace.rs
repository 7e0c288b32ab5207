//! Formulas as graphs: running the ordinary generic code once with [`Sym`] records its operations.
//!
//! ```
//! use propwash_trace::trace::{Sym, trace};
//! use propwash_trace::Real;
//!
//! fn length<S: Real>(v: &[S]) -> S {
//!     (v[0] * v[0] + v[1] * v[1]).sqrt()
//! }
//! let graph = trace(2, |v| vec![length::<Sym>(v)]);
//! assert_eq!(graph.eval(&[3.0, 4.0]), [5.0]);
//! assert_eq!(graph.len(), 6, "two inputs, two squares, a sum, a root");
//! ```
//!
//! Every value is recorded once: an operation on the same operands is the same node (common subexpressions are shared).
//! Operations on literals are folded, and so are those that return their operand bit by bit: x − 0, 1 x, x / 1. A product
//! with 0 stays, since it may be NaN, and so does x + 0, since it may change the sign of a zero. So a graph reproduces the
//! traced code bit by bit. [`trace_finite`] folds these too: its graph gives the same numbers wherever all are finite, up
//! to the sign of zeros.

use super::Real;
use core::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Not, Sub};
use std::cell::RefCell;
use std::collections::HashMap;

/// Index of a node in its graph.
pub type NodeId = u32;

/// One value of a graph. Operands come before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Node {
    /// A constant, by the bits of its f64.
    Literal(u64),
    /// An input, by its number.
    Input(u32),
    /// a + b.
    Add(NodeId, NodeId),
    /// a − b.
    Sub(NodeId, NodeId),
    /// a b.
    Mul(NodeId, NodeId),
    /// a / b.
    Div(NodeId, NodeId),
    /// −a.
    Neg(NodeId),
    /// √a.
    Sqrt(NodeId),
    /// Sine of a, rad.
    Sin(NodeId),
    /// Cosine of a, rad.
    Cos(NodeId),
    /// The first of [`Real::half_turn`] of a.
    TurnSin(NodeId),
    /// The second of [`Real::half_turn`] of a.
    TurnCos(NodeId),
    /// e to the power of a.
    Exp(NodeId),
    /// Angle of the point (b, a), rad.
    Atan2(NodeId, NodeId),
    /// Largest integer not above a.
    Floor(NodeId),
    /// Whether a < b.
    Lt(NodeId, NodeId),
    /// Whether a ≤ b.
    Le(NodeId, NodeId),
    /// A boolean constant.
    Truth(bool),
    /// Logical and.
    And(NodeId, NodeId),
    /// Logical or.
    Or(NodeId, NodeId),
    /// Logical not.
    Not(NodeId),
    /// b where the boolean a holds, else c.
    Select(NodeId, NodeId, NodeId),
}

impl Node {
    /// Its operands, in order.
    pub fn operands(self) -> impl Iterator<Item = NodeId> {
        let list = match self {
            Self::Literal(_) | Self::Input(_) | Self::Truth(_) => [None; 3],
            Self::Neg(a) | Self::Sqrt(a) | Self::Sin(a) | Self::Cos(a) => [Some(a), None, None],
            Self::TurnSin(a) | Self::TurnCos(a) => [Some(a), None, None],
            Self::Exp(a) | Self::Floor(a) | Self::Not(a) => [Some(a), None, None],
            Self::Add(a, b) | Self::Sub(a, b) | Self::Mul(a, b) | Self::Div(a, b) => [Some(a), Some(b), None],
            Self::Atan2(a, b) | Self::Lt(a, b) | Self::Le(a, b) => [Some(a), Some(b), None],
            Self::And(a, b) | Self::Or(a, b) => [Some(a), Some(b), None],
            Self::Select(a, b, c) => [Some(a), Some(b), Some(c)],
        };
        list.into_iter().flatten()
    }

    /// Whether its value is a boolean, not a number.
    pub fn is_truth(self) -> bool {
        matches!(
            self,
            Self::Lt(..) | Self::Le(..) | Self::Truth(_) | Self::And(..) | Self::Or(..) | Self::Not(_)
        )
    }
}

/// A recorded formula: nodes in an order in which they can be computed, and which of them are the results.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Graph {
    /// Number of inputs.
    pub n_inputs: usize,
    /// Nodes, operands before their users; all are needed.
    pub nodes: Vec<Node>,
    /// Indices of the results.
    pub outputs: Vec<NodeId>,
}

#[derive(Default)]
struct Recorder {
    nodes: Vec<Node>,
    seen: HashMap<Node, NodeId>,
    /// Whether a trace is being recorded.
    running: bool,
    /// Whether all numbers may be assumed finite, and the sign of zeros ignored.
    finite: bool,
}

impl Recorder {
    fn place(&mut self, node: Node) -> NodeId {
        if let Some(place) = self.seen.get(&node) {
            return *place;
        }
        let place = NodeId::try_from(self.nodes.len()).expect("a trace has fewer than 2³² operations");
        self.nodes.push(node);
        self.seen.insert(node, place);
        place
    }

    fn literal(&self, place: NodeId) -> Option<f64> {
        match self.nodes[place as usize] {
            Node::Literal(bits) => Some(f64::from_bits(bits)),
            _ => None,
        }
    }

    fn truth(&self, place: NodeId) -> Option<bool> {
        match self.nodes[place as usize] {
            Node::Truth(truth) => Some(truth),
            _ => None,
        }
    }

    fn number(&mut self, value: f64) -> NodeId {
        self.place(Node::Literal(value.to_bits()))
    }

    /// Index of a node's value; folds what is known instead of recording it.
    fn record(&mut self, node: Node) -> NodeId {
        self.known(node).unwrap_or_else(|| self.place(node))
    }

    fn known(&mut self, node: Node) -> Option<NodeId> {
        // Constant folding.
        if let Some(value) = self.folded(node) {
            return Some(match value {
                Value::Number(v) => self.number(v),
                Value::Truth(t) => self.place(Node::Truth(t)),
            });
        }
        let is = |r: &Self, place: NodeId, value: f64| {
            r.literal(place).is_some_and(|v| v.to_bits() == value.to_bits())
        };
        if self.finite
            && let Some(place) = self.known_of_finite(node)
        {
            return Some(place);
        }
        match node {
            Node::Add(a, b) if is(self, a, -0.0) => Some(b),
            Node::Add(a, b) if is(self, b, -0.0) => Some(a),
            Node::Sub(a, b) if is(self, b, 0.0) => Some(a),
            Node::Sub(a, b) if is(self, a, -0.0) => Some(self.record(Node::Neg(b))),
            Node::Mul(a, b) if is(self, a, 1.0) => Some(b),
            Node::Mul(a, b) | Node::Div(a, b) if is(self, b, 1.0) => Some(a),
            Node::Mul(a, b) if is(self, a, -1.0) => Some(self.record(Node::Neg(b))),
            Node::Mul(a, b) if is(self, b, -1.0) => Some(self.record(Node::Neg(a))),
            // Sums and products commute: one order for both.
            Node::Add(a, b) if a > b => Some(self.record(Node::Add(b, a))),
            Node::Mul(a, b) if a > b => Some(self.record(Node::Mul(b, a))),
            Node::Neg(a) => match self.nodes[a as usize] {
                Node::Neg(b) => Some(b),
                _ => None,
            },
            Node::Not(a) => match self.nodes[a as usize] {
                Node::Not(b) => Some(b),
                _ => None,
            },
            Node::And(a, b) => match (self.truth(a), self.truth(b)) {
                (Some(false), _) | (_, Some(true)) => Some(a),
                (_, Some(false)) | (Some(true), _) => Some(b),
                _ => (a == b).then_some(a),
            },
            Node::Or(a, b) => match (self.truth(a), self.truth(b)) {
                (Some(true), _) | (_, Some(false)) => Some(a),
                (_, Some(true)) | (Some(false), _) => Some(b),
                _ => (a == b).then_some(a),
            },
            Node::Select(_, b, c) if b == c => Some(b),
            Node::Select(a, b, c) => match self.truth(a) {
                Some(true) => Some(b),
                Some(false) => Some(c),
                None => match self.nodes[a as usize] {
                    Node::Not(opposite) => Some(self.record(Node::Select(opposite, c, b))),
                    _ => None,
                },
            },
            _ => None,
        }
    }

    /// Further simplifications where all numbers are finite and zeros have no sign. Signs move outwards, until a sum or a
    /// difference absorbs them.
    fn known_of_finite(&mut self, node: Node) -> Option<NodeId> {
        let zero = |r: &Self, place: NodeId| r.literal(place) == Some(0.0);
        let negated = |r: &Self, place: NodeId| match r.nodes[place as usize] {
            Node::Neg(of) => Some(of),
            _ => None,
        };
        match node {
            Node::Mul(a, b) | Node::Div(a, b)
                if zero(self, a) || (zero(self, b) && node == Node::Mul(a, b)) =>
            {
                Some(self.number(0.0))
            }
            Node::Add(a, b) if zero(self, a) => Some(b),
            Node::Add(a, b) | Node::Sub(a, b) if zero(self, b) => Some(a),
            Node::Sub(a, b) if zero(self, a) => Some(self.record(Node::Neg(b))),
            Node::Sub(a, b) if a == b => Some(self.number(0.0)),
            Node::Add(a, b) => match (negated(self, a), negated(self, b)) {
                (_, Some(b)) => Some(self.record(Node::Sub(a, b))),
                (Some(a), None) => Some(self.record(Node::Sub(b, a))),
                _ => None,
            },
            Node::Sub(a, b) => negated(self, b).map(|b| self.record(Node::Add(a, b))),
            Node::Mul(a, b) | Node::Div(a, b) => {
                let again =
                    |a, b| if matches!(node, Node::Mul(..)) { Node::Mul(a, b) } else { Node::Div(a, b) };
                let (positive, negative) = match (negated(self, a), negated(self, b)) {
                    (Some(a), Some(b)) => (Some(again(a, b)), None),
                    (Some(a), None) => (None, Some(again(a, b))),
                    (None, Some(b)) => (None, Some(again(a, b))),
                    (None, None) => (None, None),
                };
                let negative = negative.map(|of| Node::Neg(self.record(of)));
                positive.or(negative).map(|of| self.record(of))
            }
            Node::Neg(a) => match self.nodes[a as usize] {
                Node::Sub(x, y) => Some(self.record(Node::Sub(y, x))),
                _ => None,
            },
            _ => None,
        }
    }

    /// Result of an operation on constants.
    fn folded(&self, node: Node) -> Option<Value> {
        if matches!(node, Node::Literal(_) | Node::Truth(_) | Node::Input(_)) {
            return None;
        }
        let mut values = [Value::Truth(false); 3];
        for (value, place) in values.iter_mut().zip(node.operands()) {
            *value = match self.nodes[place as usize] {
                Node::Literal(bits) => Value::Number(f64::from_bits(bits)),
                Node::Truth(truth) => Value::Truth(truth),
                _ => return None,
            };
        }
        Some(compute(node, |_, i| values[i], &[]))
    }
}

thread_local! {
    static RECORDER: RefCell<Recorder> = RefCell::default();
}

fn record(node: Node) -> NodeId {
    RECORDER.with_borrow_mut(|r| {
        assert!(r.running, "symbols compute only within `trace`, on its thread");
        r.record(node)
    })
}

/// A symbolic number that stands for a formula. Made by [`trace`] only.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sym(NodeId);

/// A symbolic boolean that stands for a comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SymMask(NodeId);

/// Records what `formula` computes from `n_inputs` numbers. Dead code is removed.
///
/// # Panics
/// When called within another trace on the same thread.
pub fn trace(n_inputs: usize, formula: impl FnOnce(&[Sym]) -> Vec<Sym>) -> Graph {
    recorded(n_inputs, false, formula)
}

/// As [`trace`], for numbers that are all finite and zeros whose sign does not matter: a product with 0 is 0, x + 0 is x.
///
/// # Panics
/// As [`trace`].
pub fn trace_finite(n_inputs: usize, formula: impl FnOnce(&[Sym]) -> Vec<Sym>) -> Graph {
    recorded(n_inputs, true, formula)
}

fn recorded(n_inputs: usize, finite: bool, formula: impl FnOnce(&[Sym]) -> Vec<Sym>) -> Graph {
    // Recording ends even if the formula panics.
    struct Running;
    impl Drop for Running {
        fn drop(&mut self) {
            RECORDER.take();
        }
    }
    let inputs: Vec<Sym> = RECORDER.with_borrow_mut(|r| {
        assert!(!r.running, "a trace within a trace");
        r.running = true;
        r.finite = finite;
        (0..n_inputs as u32).map(|i| Sym(r.place(Node::Input(i)))).collect()
    });
    let running = Running;
    let outputs: Vec<NodeId> = formula(&inputs).iter().map(|s| s.0).collect();
    let nodes = RECORDER.with_borrow_mut(|r| std::mem::take(&mut r.nodes));
    drop(running);
    Graph { n_inputs, nodes, outputs }.needed()
}

#[derive(Clone, Copy, Debug)]
enum Value {
    Number(f64),
    Truth(bool),
}

impl Value {
    fn number(self) -> f64 {
        match self {
            Self::Number(v) => v,
            Self::Truth(_) => f64::NAN,
        }
    }

    fn truth(self) -> bool {
        matches!(self, Self::Truth(true))
    }
}

/// Value of a node; `of(place, i)` is its i-th operand.
fn compute(node: Node, of: impl Fn(NodeId, usize) -> Value, inputs: &[f64]) -> Value {
    let number = |place: NodeId, i: usize| of(place, i).number();
    let truth = |place: NodeId, i: usize| of(place, i).truth();
    Value::Number(match node {
        Node::Literal(bits) => f64::from_bits(bits),
        Node::Input(i) => inputs[i as usize],
        Node::Add(a, b) => number(a, 0) + number(b, 1),
        Node::Sub(a, b) => number(a, 0) - number(b, 1),
        Node::Mul(a, b) => number(a, 0) * number(b, 1),
        Node::Div(a, b) => number(a, 0) / number(b, 1),
        Node::Neg(a) => -number(a, 0),
        Node::Sqrt(a) => number(a, 0).sqrt(),
        Node::Sin(a) => Real::sin_cos(number(a, 0)).0,
        Node::Cos(a) => Real::sin_cos(number(a, 0)).1,
        Node::TurnSin(a) => Real::half_turn(number(a, 0)).0,
        Node::TurnCos(a) => Real::half_turn(number(a, 0)).1,
        Node::Exp(a) => Real::exp(number(a, 0)),
        Node::Atan2(a, b) => Real::atan2(number(a, 0), number(b, 1)),
        Node::Floor(a) => number(a, 0).floor(),
        Node::Lt(a, b) => return Value::Truth(number(a, 0) < number(b, 1)),
        Node::Le(a, b) => return Value::Truth(number(a, 0) <= number(b, 1)),
        Node::Truth(t) => return Value::Truth(t),
        Node::And(a, b) => return Value::Truth(truth(a, 0) && truth(b, 1)),
        Node::Or(a, b) => return Value::Truth(truth(a, 0) || truth(b, 1)),
        Node::Not(a) => return Value::Truth(!truth(a, 0)),
        Node::Select(a, b, c) => {
            if truth(a, 0) {
                number(b, 1)
            } else {
                number(c, 2)
            }
        }
    })
}

impl Graph {
    /// Number of nodes.
    pub fn len(&self) -> usize {
        self.nodes.len()
    }

    /// Whether the graph is empty.
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// Evaluates the results node by node: slow, the reference for everything faster.
    ///
    /// # Panics
    /// Where there are fewer inputs than [`Graph::n_inputs`].
    pub fn eval(&self, inputs: &[f64]) -> Vec<f64> {
        assert!(inputs.len() >= self.n_inputs, "expected {} inputs, found {}", self.n_inputs, inputs.len());
        let mut values: Vec<Value> = Vec::with_capacity(self.nodes.len());
        for node in &self.nodes {
            let value = compute(*node, |place, _| values[place as usize], inputs);
            values.push(value);
        }
        self.outputs.iter().map(|o| values[*o as usize].number()).collect()
    }

    /// What it takes to compute some of the outputs (by their places among them) again and again, where no other inputs change than those that
    /// `varies` marks.
    ///
    /// # Panics
    /// Where there are fewer inputs than [`Graph::n_inputs`].
    pub fn again(&self, inputs: &[f64], varies: &[bool], outputs: &[u32]) -> Again {
        assert!(inputs.len() >= self.n_inputs, "expected {} inputs, found {}", self.n_inputs, inputs.len());
        let mut values: Vec<Value> = Vec::with_capacity(self.nodes.len());
        let mut changes: Vec<bool> = Vec::with_capacity(self.nodes.len());
        for node in &self.nodes {
            values.push(compute(*node, |place, _| values[place as usize], inputs));
            let own = matches!(node, Node::Input(k) if varies[*k as usize]);
            changes.push(own || node.operands().any(|o| changes[o as usize]));
        }
        let outputs: Vec<NodeId> = outputs.iter().map(|o| self.outputs[*o as usize]).collect();
        let mut needed = vec![false; self.nodes.len()];
        outputs.iter().for_each(|o| needed[*o as usize] = true);
        for i in (0..self.nodes.len()).rev().filter(|i| changes[*i]) {
            if needed[i] {
                self.nodes[i].operands().for_each(|o| needed[o as usize] = true);
            }
        }
        let anew = (0..self.nodes.len()).filter(|i| needed[*i] && changes[*i]);
        let nodes = anew.map(|i| (i as NodeId, self.nodes[i])).collect();
        Again { values, nodes, outputs }
    }

    /// Removes dead nodes; inputs keep their numbers.
    pub(super) fn needed(self) -> Self {
        let mut needed = vec![false; self.nodes.len()];
        for output in &self.outputs {
            needed[*output as usize] = true;
        }
        for i in (0..self.nodes.len()).rev() {
            if needed[i] {
                self.nodes[i].operands().for_each(|o| needed[o as usize] = true);
            }
        }
        let mut moved = vec![0; self.nodes.len()];
        let mut nodes = Vec::new();
        for (i, node) in self.nodes.iter().enumerate().filter(|(i, _)| needed[*i]) {
            moved[i] = nodes.len() as NodeId;
            nodes.push(node.with(|o| moved[o as usize]));
        }
        let outputs = self.outputs.iter().map(|o| moved[*o as usize]).collect();
        Self { n_inputs: self.n_inputs, nodes, outputs }
    }
}

/// Some outputs of a graph of which few inputs change: [`Graph::again`].
#[derive(Clone, Debug, Default)]
pub struct Again {
    values: Vec<Value>,
    /// Nodes that are computed anew, in order.
    nodes: Vec<(NodeId, Node)>,
    outputs: Vec<NodeId>,
}

impl Again {
    /// The outputs for these inputs, as [`Graph::eval`] gives them.
    pub fn eval(&mut self, inputs: &[f64]) -> impl Iterator<Item = f64> {
        for (i, node) in &self.nodes {
            self.values[*i as usize] = compute(*node, |place, _| self.values[place as usize], inputs);
        }
        self.outputs.iter().map(|o| self.values[*o as usize].number())
    }
}

impl Node {
    /// The same node with its operand indices mapped.
    pub fn with(self, place: impl Fn(NodeId) -> NodeId) -> Self {
        match self {
            Self::Literal(_) | Self::Input(_) | Self::Truth(_) => self,
            Self::Add(a, b) => Self::Add(place(a), place(b)),
            Self::Sub(a, b) => Self::Sub(place(a), place(b)),
            Self::Mul(a, b) => Self::Mul(place(a), place(b)),
            Self::Div(a, b) => Self::Div(place(a), place(b)),
            Self::Neg(a) => Self::Neg(place(a)),
            Self::Sqrt(a) => Self::Sqrt(place(a)),
            Self::Sin(a) => Self::Sin(place(a)),
            Self::Cos(a) => Self::Cos(place(a)),
            Self::TurnSin(a) => Self::TurnSin(place(a)),
            Self::TurnCos(a) => Self::TurnCos(place(a)),
            Self::Exp(a) => Self::Exp(place(a)),
            Self::Atan2(a, b) => Self::Atan2(place(a), place(b)),
            Self::Floor(a) => Self::Floor(place(a)),
            Self::Lt(a, b) => Self::Lt(place(a), place(b)),
            Self::Le(a, b) => Self::Le(place(a), place(b)),
            Self::And(a, b) => Self::And(place(a), place(b)),
            Self::Or(a, b) => Self::Or(place(a), place(b)),
            Self::Not(a) => Self::Not(place(a)),
            Self::Select(a, b, c) => Self::Select(place(a), place(b), place(c)),
        }
    }
}

macro_rules! binary {
    ($($trait:ident, $method:ident, $node:ident;)*) => {$(
        impl $trait for Sym {
            type Output = Self;
            fn $method(self, other: Self) -> Self {
                Self(record(Node::$node(self.0, other.0)))
            }
        }
    )*};
}

binary! {
    Add, add, Add;
    Sub, sub, Sub;
    Mul, mul, Mul;
    Div, div, Div;
}

impl Neg for Sym {
    type Output = Self;
    fn neg(self) -> Self {
        Self(record(Node::Neg(self.0)))
    }
}

impl BitAnd for SymMask {
    type Output = Self;
    fn bitand(self, other: Self) -> Self {
        Self(record(Node::And(self.0, other.0)))
    }
}

impl BitOr for SymMask {
    type Output = Self;
    fn bitor(self, other: Self) -> Self {
        Self(record(Node::Or(self.0, other.0)))
    }
}

impl Not for SymMask {
    type Output = Self;
    fn not(self) -> Self {
        Self(record(Node::Not(self.0)))
    }
}

impl Real for Sym {
    type Mask = SymMask;

    fn lit(v: f64) -> Self {
        Self(record(Node::Literal(v.to_bits())))
    }
    fn sqrt(self) -> Self {
        Self(record(Node::Sqrt(self.0)))
    }
    fn sin_cos(self) -> (Self, Self) {
        (Self(record(Node::Sin(self.0))), Self(record(Node::Cos(self.0))))
    }
    fn half_turn(self) -> (Self, Self) {
        (Self(record(Node::TurnSin(self.0))), Self(record(Node::TurnCos(self.0))))
    }
    fn exp(self) -> Self {
        Self(record(Node::Exp(self.0)))
    }
    fn atan2(self, x: Self) -> Self {
        Self(record(Node::Atan2(self.0, x.0)))
    }
    fn floor(self) -> Self {
        Self(record(Node::Floor(self.0)))
    }
    fn lt(self, other: Self) -> SymMask {
        SymMask(record(Node::Lt(self.0, other.0)))
    }
    fn le(self, other: Self) -> SymMask {
        SymMask(record(Node::Le(self.0, other.0)))
    }
    fn select(mask: SymMask, yes: Self, no: Self) -> Self {
        Self(record(Node::Select(mask.0, yes.0, no.0)))
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Every operation of [`Real`].
    pub fn all<S: Real>(x: &[S]) -> Vec<S> {
        let (s, c) = (x[0] * x[1]).sin_cos();
        let a = (x[0] * x[0] + x[1].square() + S::one()).sqrt();
        let b = (x[2] / a - x[1]).exp();
        let (k, c2) = (x[1] * x[2]).square().half_turn();
        let d = x[0].atan2(x[2]) + x[1].floor() + k * c2;
        let near = x[0].lt(x[1]) & !x[2].le(x[0]) | S::zero().lt(x[2]);
        let e = S::select(near, s * b, c - a);
        vec![e.abs().min(d).max(-x[1]), e.clamp(S::lit(-0.5), S::lit(0.5)) * d, b * a / c]
    }

    /// Where no choice switches.
    pub const POINTS: [[f64; 3]; 5] =
        [[0.3, 0.7, 1.9], [-1.2, 0.4, 0.3], [2.0, -0.6, -0.7], [0.1, 1.7, -2.0], [-0.8, -0.9, 0.2]];

    #[test]
    fn a_graph_gives_the_bits_of_the_code() {
        let graph = trace(3, all::<Sym>);
        for x in POINTS {
            assert_eq!(graph.eval(&x), all(&x));
        }
    }

    #[test]
    fn what_is_known_is_not_computed() {
        let graph = trace(2, |x| {
            let (a, b) = (x[0], x[1]);
            let two = Sym::one() + Sym::one();
            let same = Sym::select(two.lt(Sym::zero()), b, a);
            vec![a * b - Sym::zero(), same / Sym::one(), -(-b) * Sym::one()]
        });
        assert_eq!(graph.nodes.len(), 3, "{graph:?}");
        assert_eq!(graph.eval(&[3.0, 5.0]), [15.0, 3.0, 5.0]);
        let unused = trace(2, |x| vec![x[1].exp().sqrt() * x[0] - x[0], x[1]]);
        assert_eq!(unused.len(), 6);
        let constant = trace(1, |_| vec![Sym::lit(2.0).sqrt()]);
        assert_eq!((constant.len(), constant.eval(&[0.0])), (1, vec![2f64.sqrt()]));
    }

    #[test]
    fn what_is_no_number_and_the_sign_of_a_zero_stay() {
        let graph = trace(1, |x| {
            let zero = Sym::zero();
            vec![x[0] * zero, (x[0] + zero).atan2(-Sym::one()), (zero - x[0]).atan2(-Sym::one())]
        });
        for x in [f64::NAN, f64::INFINITY, 0.0, -0.0, 2.0] {
            let direct = [x * 0.0, f64::atan2(x + 0.0, -1.0), f64::atan2(0.0 - x, -1.0)];
            let bits =
                |v: &[f64]| v.iter().map(|v| if v.is_nan() { 0 } else { v.to_bits() }).collect::<Vec<_>>();
            assert_eq!(bits(&graph.eval(&[x])), bits(&direct), "{x}");
        }
    }

    #[test]
    fn what_is_computed_again_is_what_the_whole_gives() {
        let graph = trace(4, |v| {
            let far = (v[0] * v[0] + v[1] * v[1]).sqrt();
            vec![far + v[2], v[3] * Sym::lit(2.0), Sym::select(v[2].lt(v[3]), far, v[2]), v[2].exp() * far]
        });
        let first = [3.0, 4.0, 1.0, 2.0];
        let mut again = graph.again(&first, &[false, false, true, false], &[3, 0, 2]);
        assert!(again.nodes.len() < graph.nodes.len());
        for third in [1.0, -0.5, 7.0] {
            let inputs = [3.0, 4.0, third, 2.0];
            let whole = graph.eval(&inputs);
            assert_eq!(again.eval(&inputs).collect::<Vec<_>>(), [whole[3], whole[0], whole[2]]);
        }
    }

    #[test]
    fn a_formula_that_fails_leaves_nothing_behind() {
        let failed = std::panic::catch_unwind(|| trace(1, |_| panic!("no formula")));
        assert!(failed.is_err());
        assert_eq!(trace(1, |x| vec![x[0] + x[0]]).eval(&[2.0]), [4.0]);
    }
}
