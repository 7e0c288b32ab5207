//! What runs the code of a plan on the file of a pack: a kernel, code that was compiled at run time, byte code, or a backend of the user's.

use fearless_simd::Level;

use super::plan::Plan;
use crate::backend::PreparedStep;
use propwash_compile::Code;
use propwash_trace::Real;
use propwash_trace::bytecode::Interpret;
use propwash_trace::kernel::Entries;

/// The code of a plan for one type of cells.
pub(super) enum Runner<'a, C: Interpret> {
    Kernel(Entries<C>),
    Compiled(Code),
    ByteCode,
    Backend(&'a dyn PreparedStep<C::Number>),
}

/// Numbers of cells, shape (cell, lane).
fn spread<C: Interpret>(cells: &[C]) -> Vec<C::Number> {
    let mut out = vec![C::Number::zero(); cells.len() * C::LANES];
    for (numbers, cell) in out.chunks_exact_mut(C::LANES).zip(cells) {
        cell.drain(0, |lane, v| numbers[lane] = v);
    }
    out
}

/// Puts numbers back into cells.
fn gather<C: Interpret>(cells: &mut [C], numbers: &[C::Number]) {
    for (cell, numbers) in cells.iter_mut().zip(numbers.chunks_exact(C::LANES)) {
        cell.fill(0, |lane| numbers[lane]);
    }
}

impl<C: Interpret> Runner<'_, C> {
    /// Fills the per-call table.
    pub(super) fn call(&self, level: Level, plan: &Plan<C::Number>, file: &mut [C]) {
        match self {
            Self::Kernel(entries) => (entries.call)(level, &mut file[plan.scratch..]),
            Self::Compiled(code) => code.call(&mut file[plan.scratch..]),
            Self::ByteCode => C::interpret(level, &plan.program.call, file, 1),
            Self::Backend(step) => {
                let cells = &mut file[plan.scratch..][..plan.schedule.n_scratch()];
                let mut scratch = spread(cells);
                step.call(C::LANES, &mut scratch);
                gather(cells, &scratch);
            }
        }
    }

    /// Takes some steps.
    pub(super) fn step(&self, level: Level, plan: &Plan<C::Number>, file: &mut [C], times: usize) {
        match self {
            Self::Kernel(entries) => {
                let (home, scratch) = file.split_at_mut(plan.scratch);
                (entries.step)(level, home, scratch, times);
            }
            Self::Compiled(code) => {
                let (home, scratch) = file.split_at_mut(plan.scratch);
                code.step(home, scratch, times);
            }
            Self::ByteCode => C::interpret(level, &plan.program.step, file, times),
            Self::Backend(step) => on_numbers(plan, file, |home, scratch| {
                step.step(C::LANES, home, scratch, times);
            }),
        }
    }

    /// Computes what is needed after the last step only.
    pub(super) fn epilogue(&self, level: Level, plan: &Plan<C::Number>, file: &mut [C]) {
        match self {
            Self::Kernel(entries) => {
                let (home, scratch) = file.split_at_mut(plan.scratch);
                (entries.epilogue)(level, home, scratch);
            }
            Self::Compiled(code) => {
                let (home, scratch) = file.split_at_mut(plan.scratch);
                code.epilogue(home, scratch);
            }
            Self::ByteCode => C::interpret(level, &plan.program.epilogue, file, 1),
            Self::Backend(step) => on_numbers(plan, file, |home, scratch| {
                step.epilogue(C::LANES, home, scratch);
            }),
        }
    }
}

/// Lends home and scratch as plain numbers.
fn on_numbers<C: Interpret>(
    plan: &Plan<C::Number>,
    file: &mut [C],
    f: impl FnOnce(&mut [C::Number], &mut [C::Number]),
) {
    let (home, scratch) = file.split_at_mut(plan.scratch);
    let (home, scratch) = (&mut home[..plan.schedule.n_home()], &mut scratch[..plan.schedule.n_scratch()]);
    let (mut of_home, mut of_scratch) = (spread(home), spread(scratch));
    f(&mut of_home, &mut of_scratch);
    gather(home, &of_home);
    gather(scratch, &of_scratch);
}
