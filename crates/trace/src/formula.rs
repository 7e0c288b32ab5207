//! A formula for many rows of numbers at once: traced, and run as byte code in lanes.
//!
//! It is what [`super::schedule`] does for the steps of a simulation, for a formula that is computed once a row: no state is
//! carried from one call to the next.
//!
//! ```
//! use propwash_trace::formula::{Formula, Registers};
//! use propwash_trace::lanes::{Cell, F64x8};
//! use propwash_trace::Real;
//!
//! let formula = Formula::new(2, |v| vec![(v[0] * v[0] + v[1] * v[1]).sqrt()]);
//! let mut registers = Registers::<F64x8>::new(&formula);
//! registers.input(0).fill(0, |lane| 3.0 * lane as f64);
//! registers.input(1).fill(0, |lane| 4.0 * lane as f64);
//! registers.run(&formula);
//! assert_eq!(registers.output(&formula, 0).get(2), 10.0);
//! ```

use super::bytecode::{Interpret, Program};
use super::lanes::{Number, level};
use super::schedule::{Input, Location, Output, Source, schedule};
use super::trace::{Graph, Node, Sym, trace};
use crate::Real;

/// A traced formula, ready to run.
#[derive(Clone, Debug)]
pub struct Formula {
    graph: Graph,
    program: Program,
    /// (input, register): what the code reads elsewhere than the caller wrote it.
    given: Vec<(u32, u32)>,
    /// Register of each result.
    results: Vec<u32>,
    /// (register, number): results that are constant.
    constants: Vec<(u32, f64)>,
    registers: usize,
}

impl Formula {
    /// Traces what `formula` computes from `n_inputs` numbers.
    ///
    /// # Panics
    /// When called within a trace on the same thread.
    pub fn new(n_inputs: usize, formula: impl FnOnce(&[Sym]) -> Vec<Sym>) -> Self {
        let graph = trace(n_inputs, formula);
        // Everything is given and nothing carried, so that all of it stands in the code of the call.
        let inputs: Vec<Input> = (0..n_inputs as u32).map(Input::Given).collect();
        let outputs: Vec<Output> = (0..graph.outputs.len() as u32).map(Output::Final).collect();
        let schedule = schedule(&graph, &inputs, &outputs);
        let program = Program::new(&schedule, n_inputs);
        let cell = |at: Location| match at {
            Location::Home(p) => p,
            Location::Scratch(k) => n_inputs as u32 + k,
        };
        let given = schedule.given.iter().zip(schedule.given_at());
        let given = given.filter_map(|(input, at)| Some((input.place()?, cell(at)))).collect();
        let table: Vec<u32> = schedule.call_at().into_iter().map(cell).collect();
        let mut registers = n_inputs + program.len;
        let (mut results, mut constants) = (vec![0; outputs.len()], Vec::new());
        for (output, source) in &schedule.finals {
            results[output.place() as usize] = match source {
                Source::Call(k) => table[*k as usize],
                Source::Input(input) => input.place().unwrap_or(0),
                Source::Constant(v) => {
                    constants.push((registers as u32, *v));
                    registers += 1;
                    registers as u32 - 1
                }
                Source::State(_) => unreachable!("a formula that carries nothing has no state"),
            };
        }
        Self { graph, program, given, results, constants, registers }
    }

    /// Numbers of the inputs that it reads, in order.
    pub fn reads(&self) -> Vec<usize> {
        let of = |node: &Node| match node {
            Node::Input(i) => Some(*i as usize),
            _ => None,
        };
        let mut list: Vec<usize> = self.graph.nodes.iter().filter_map(of).collect();
        list.sort_unstable();
        list.dedup();
        list
    }

    /// The formula as a graph: what [`super::adjoint::adjoint`] takes.
    pub fn graph(&self) -> &Graph {
        &self.graph
    }
}

/// Working memory in which formulas run, one block of lanes for each number.
#[derive(Clone, Debug)]
pub struct Registers<C> {
    file: Vec<C>,
}

impl<C: Interpret> Registers<C> {
    /// Those of a formula.
    pub fn new(formula: &Formula) -> Self {
        let mut file = vec![C::splat(C::Number::zero()); formula.registers];
        let program = &formula.program;
        for (cell, v) in file[program.constants_at..].iter_mut().zip(&program.constants) {
            *cell = C::splat(C::Number::constant(*v));
        }
        for (cell, v) in &formula.constants {
            file[*cell as usize] = C::splat(C::Number::constant(*v));
        }
        Self { file }
    }

    /// Input `i`, to be written before each run. Only those that the formula [reads](Formula::reads) count.
    #[inline]
    pub fn input(&mut self, i: usize) -> &mut C {
        &mut self.file[i]
    }

    /// Computes all results of the formula that they were made for.
    pub fn run(&mut self, formula: &Formula) {
        for (from, to) in &formula.given {
            self.file[*to as usize] = self.file[*from as usize];
        }
        C::interpret(level(), &formula.program.call, &mut self.file, 1);
    }

    /// Result `k`.
    #[inline]
    pub fn output(&self, formula: &Formula, k: usize) -> &C {
        &self.file[formula.results[k] as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::{F32x16, F64x8};

    /// An input that is passed on, a constant, a value that two results share, a comparison.
    fn everything<S: Real>(v: &[S]) -> Vec<S> {
        let far = (v[0] * v[0] + v[2] * v[2]).sqrt();
        let (sin, _) = (v[0] * S::lit(3.0)).sin_cos();
        vec![v[2], S::lit(-1.5), far, (-far).exp() + sin, far, S::select(v[0].lt(v[2]), far, -v[2])]
    }

    fn check<C: Interpret>(tolerance: f64) {
        let formula = Formula::new(4, everything);
        assert_eq!(formula.reads(), [0, 2], "inputs 1 and 3 are not read");
        let mut registers = Registers::<C>::new(&formula);
        // Twice: the first run must leave nothing behind that the second reads.
        for round in 0..2 {
            let number = |i: usize, lane: usize| (0.37 * (lane + 3 * i + round) as f64).sin();
            for i in 0..4 {
                registers.input(i).fill(0, |lane| C::Number::of(number(i, lane)));
            }
            registers.run(&formula);
            for lane in 0..C::LANES {
                let inputs: Vec<f64> = (0..4).map(|i| C::Number::of(number(i, lane)).wide()).collect();
                for (k, wanted) in everything(&inputs).into_iter().enumerate() {
                    let got = registers.output(&formula, k).get(lane).wide();
                    assert!(
                        (got - wanted).abs() <= tolerance,
                        "result {k}, lane {lane}: {got}, not {wanted}"
                    );
                }
            }
        }
    }

    #[test]
    fn a_formula_gives_in_lanes_what_it_gives_one_by_one() {
        check::<F64x8>(1e-14);
        check::<[[F64x8; 2]; 2]>(1e-14);
        check::<F32x16>(1e-6);
        check::<f64>(0.0);
    }
}
