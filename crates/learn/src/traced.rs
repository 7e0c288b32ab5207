//! What a goal observes and what it costs, as formulas in lanes, with what a loss gains backwards.

use crate::goal::{Goal, Seen};
use propwash_trace::Real;
use propwash_trace::adjoint::{evaluate, pull_back};
use propwash_trace::formula::Formula;
use propwash_trace::trace::{Sym, trace};

/// Formulas of a goal. All begin with the same inputs: the numbers of a state, the time, what the episode remembers.
pub(crate) struct Traced {
    /// To the observation.
    pub observe: Formula,
    /// From these and what a loss gains by the observation to what it gains by the state.
    pub observe_back: Formula,
    /// From these, the action and the action before to the cost.
    pub price: Formula,
    /// The same, and behind the cost its gains by state, action and action before.
    pub cost: Formula,
}

impl Traced {
    /// For states of `width` numbers and actions of `actions`.
    pub fn new<G: Goal>(goal: &G, width: usize, actions: usize) -> Self {
        let inputs = width + 1 + goal.memory();
        let observe = |x: &[Sym]| {
            let mut out = Vec::new();
            goal.observe(&Seen::of(x, x[width], &x[width + 1..inputs]), &mut out);
            out
        };
        let graph = trace(inputs, observe);
        let observe_back = Formula::new(inputs + graph.outputs.len(), |x| {
            pull_back::<Sym>(&graph, &x[..inputs], &x[inputs..])[..width].to_vec()
        });
        let all = inputs + 2 * actions;
        let price = |x: &[Sym]| {
            let (action, before) = x[inputs..].split_at(actions);
            vec![goal.cost(&Seen::of(x, x[width], &x[width + 1..inputs]), action, before)]
        };
        let graph = trace(all, price);
        let cost = Formula::new(all, |x| {
            let gains = pull_back::<Sym>(&graph, x, &[Sym::one()]);
            let value = evaluate::<Sym>(&graph, x)[0];
            [&[value], &gains[..width], &gains[inputs..]].concat()
        });
        Self { observe: Formula::new(inputs, observe), observe_back, price: Formula::new(all, price), cost }
    }
}
