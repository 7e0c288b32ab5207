//! A step backwards: from what a loss gains by the numbers after a step to what it gains by those before.

use super::{Shape, graph, place};
use crate::blocks::Phase;
use propwash_physics::drone::Drone;
use propwash_trace::Real;
use propwash_trace::adjoint::pull_back;
use propwash_trace::schedule::{Input, Output, Schedule, schedule};
use propwash_trace::trace::{Sym, trace_finite};

/// Where a step backwards keeps its numbers: those of the step before it was taken, by their places; behind them what the loss
/// gains by each of them, in the same order; and behind these what it gains by parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Backwards {
    /// Numbers of the step: one more than its highest place.
    pub n_places: u32,
}

impl Backwards {
    /// Of a drone whose effects remember `effects` numbers, beside `neighbours` other drones.
    pub fn new(effects: usize, neighbours: usize) -> Self {
        Self { n_places: place::EFFECTS + effects as u32 + neighbours as u32 * place::NEIGHBOUR }
    }

    /// What the loss gains by the number at place `p`.
    pub fn by(self, p: u32) -> u32 {
        self.n_places + p
    }

    /// What it gains by the `j`-th of the parameters that are asked for.
    pub fn by_parameter(self, j: usize) -> u32 {
        2 * self.n_places + j as u32
    }

    /// Numbers in all, with `parameters` of these.
    pub fn n_home(self, parameters: usize) -> usize {
        2 * self.n_places as usize + parameters
    }
}

/// Places of what is the same during a call, by which gains are summed over its steps: the command, what disturbs, the wind, ground and
/// ceiling.
pub(crate) const SUMMED: std::ops::Range<u32> = place::COMMAND..place::TIME;

/// The step of `drone` backwards, scheduled. Its state is what a loss gains by every carried number, before the step where it was after;
/// by what is the same during a call, by other drones and by the `parameters` (indices among [`super::fixed`]) the gain is
/// added to what stands there. The numbers themselves, as they were before the step, are fresh.
pub(crate) fn adjoint_schedule(
    drone: &Drone<f64>,
    shape: &Shape,
    varies: &dyn Fn(usize) -> bool,
    parameters: &[usize],
) -> Schedule {
    debug_assert!(shape.phase == Phase::Both, "steps are undone whole");
    let symbol = |k: usize| varies(k) || parameters.contains(&k);
    let (forward, forward_inputs, forward_outputs) = graph(drone, shape, &symbol);
    let effects = drone.memory_len(1.0 / f64::from(shape.sim_hz));
    let (back, first_neighbour) =
        (Backwards::new(effects, shape.neighbours), Backwards::new(effects, 0).n_places);
    let (mut inputs, mut outputs) = (Vec::new(), Vec::new());
    // (input of the step, where its gain stands, whether it is added to what stands there)
    let mut wanted: Vec<(usize, u32, bool)> = Vec::new();
    for (i, input) in forward_inputs.iter().enumerate() {
        inputs.push(match *input {
            Input::Carried(p) | Input::Fresh(p) => Input::Fresh(p),
            other => other,
        });
        match *input {
            Input::Carried(p) => wanted.push((i, back.by(p), false)),
            Input::Given(p) if SUMMED.contains(&p) => wanted.push((i, back.by(p), true)),
            Input::Fresh(p) if p >= first_neighbour => wanted.push((i, back.by(p), true)),
            Input::Fixed(k) => {
                if let Some(j) = parameters.iter().position(|wanted| *wanted == k as usize) {
                    wanted.push((i, back.by_parameter(j), true));
                }
            }
            Input::Given(_) | Input::Fresh(_) => {}
        }
    }
    let n = inputs.len();
    inputs.extend(wanted.iter().map(|(_, at, _)| Input::Carried(*at)));
    let graph = trace_finite(inputs.len(), |x| {
        let (numbers, gains) = x.split_at(n);
        let by = |p: u32| wanted.iter().position(|(_, at, _)| *at == back.by(p)).map(|k| gains[k]);
        let seeds: Vec<Sym> = forward_outputs
            .iter()
            .map(|output| match output {
                Output::Carried(p) => by(*p).unwrap_or(Sym::lit(0.0)),
                // Results that no later step reads.
                Output::Final(_) => Sym::lit(0.0),
            })
            .collect();
        let own = pull_back(&forward, numbers, &seeds);
        let mut results = Vec::new();
        for ((i, at, sums), gain) in wanted.iter().zip(gains) {
            outputs.push(Output::Carried(*at));
            results.push(if *sums { *gain + own[*i] } else { own[*i] });
        }
        results
    });
    schedule(&graph, &inputs, &outputs)
}
