//! Byte code: interprets straight-line code that has not been compiled. Each instruction runs on several blocks of lanes,
//! so that decoding it costs little beside computing it.
//!
//! It does the same arithmetic in the same order as a generated kernel, so both give the same bits.

use std::collections::HashMap;

use fearless_simd::{Level, Simd, dispatch, f32x16, f64x8};

use super::kernel::Compiled;
use super::lanes::{Arith, F32x16, F64x8, Pair, vectorize};
use super::schedule::{Code, Instruction, Location, Schedule};

/// An instruction whose operands and result are registers (cells of the register file).
#[derive(Clone, Copy, Debug, PartialEq)]
struct Op {
    /// Operands are indices into the register file.
    ins: Instruction,
    to: u32,
    /// Register of a second result.
    second: u32,
}

/// Code over a register file: the drones' state slots (home), and behind it, among the scratch of other codes, its own:
/// `[constant table | given | per-call table | numbers for the epilogue | constants | registers]`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ByteCode {
    ops: Vec<Op>,
    /// (from, to), copied after all instructions.
    moves: Vec<(u32, u32)>,
}

/// The three codes of a [`Schedule`] and the scratch that they need beside the home.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Program {
    /// Runs once per call.
    pub call: ByteCode,
    /// Runs in every step.
    pub step: ByteCode,
    /// Epilogue: runs after the last step.
    pub epilogue: ByteCode,
    /// Values of the constants.
    pub constants: Vec<f64>,
    /// Register of the first constant.
    pub constants_at: usize,
    /// Scratch cells beside the home.
    pub len: usize,
}

impl Program {
    /// Allocates registers. The scratch of the codes begins at cell `scratch` of the register file.
    pub fn new(schedule: &Schedule, scratch: usize) -> Self {
        let Schedule { call, step, epilogue, .. } = schedule;
        let mut constants: Vec<f64> = Vec::new();
        for code in [call, step, epilogue] {
            for ins in &code.instructions {
                if let Instruction::Lit(bits) = ins
                    && !constants.iter().any(|c| c.to_bits() == *bits)
                {
                    constants.push(f64::from_bits(*bits));
                }
            }
        }
        let constants_at = scratch + schedule.n_scratch();
        let first = (constants_at + constants.len()) as u32;
        let cells = |list: Vec<Location>| -> Vec<u32> {
            let cell = |at| match at {
                Location::Home(p) => p,
                Location::Scratch(k) => scratch as u32 + k,
            };
            list.into_iter().map(cell).collect()
        };
        let (given, table, state) =
            (cells(schedule.given_at()), cells(schedule.call_at()), cells(schedule.state_at()));
        let places =
            Places { scratch: scratch as u32, table: &table, constants: &constants, at: constants_at as u32 };
        // Results of the call go to the per-call table, all others to the state.
        let (call, a) = assign(call, &places, first, &given, &table);
        let (step, b) = assign(step, &places, first, &state, &state);
        let (epilogue, c) = assign(epilogue, &places, first, &state, &state);
        let len = a.max(b).max(c) as usize - scratch;
        Self { call, step, epilogue, constants, constants_at, len }
    }
}

/// Cells known to all codes of a program.
struct Places<'a> {
    /// First cell of the constant table.
    scratch: u32,
    /// Cells of the per-call table.
    table: &'a [u32],
    constants: &'a [f64],
    /// Cell of the first constant.
    at: u32,
}

fn assign(code: &Code, places: &Places, first: u32, reads: &[u32], writes: &[u32]) -> (ByteCode, u32) {
    let n = code.instructions.len();
    let mut last_use = vec![0usize; n];
    for (i, ins) in code.instructions.iter().enumerate() {
        ins.operands().into_iter().flatten().for_each(|o| last_use[o as usize] = i);
    }
    // Stores follow all instructions, so what they read must not be overwritten.
    for (place, _) in &code.stores {
        last_use[*place as usize] = n;
    }
    let mut out = ByteCode::default();
    let mut place = vec![u32::MAX; n];
    let mut free: Vec<u32> = Vec::new();
    let mut next = first;
    let mut take = |free: &mut Vec<u32>| {
        free.pop().unwrap_or_else(|| {
            next += 1;
            next - 1
        })
    };
    // Register of the second result, per instruction.
    let mut seconds = vec![u32::MAX; n];
    for (i, ins) in code.instructions.iter().enumerate() {
        match *ins {
            Instruction::Lit(bits) => {
                let at = places.constants.iter().position(|c| c.to_bits() == bits).unwrap_or(0);
                place[i] = places.at + at as u32;
                continue;
            }
            Instruction::Constant(k) => place[i] = places.scratch + k,
            Instruction::Call(k) => place[i] = places.table[k as usize],
            Instruction::State(k) => place[i] = reads[k as usize],
            Instruction::Second(of) => place[i] = seconds[of as usize],
            ins => {
                let moved = with(ins, |o| place[o as usize]);
                // Registers of operands whose last use is here are free for the result.
                let mut ended: Vec<u32> = ins.operands().into_iter().flatten().collect();
                ended.dedup();
                for o in ended {
                    if last_use[o as usize] == i
                        && place[o as usize] >= first
                        && !free.contains(&place[o as usize])
                    {
                        free.push(place[o as usize]);
                    }
                }
                let to = take(&mut free);
                place[i] = to;
                let mut second = to;
                if matches!(ins, Instruction::SinCos(_) | Instruction::HalfTurn(_)) {
                    second = take(&mut free);
                    seconds[i] = second;
                    // A second result that nothing reads gives its register back at once.
                    let read = code.instructions[i..].contains(&Instruction::Second(i as u32));
                    if !read {
                        free.push(second);
                    }
                }
                out.ops.push(Op { ins: moved, to, second });
            }
        }
    }
    let moves =
        code.stores.iter().map(|(value, slot)| (place[*value as usize], writes[*slot as usize])).collect();
    (out.moves, next) = ordered(moves, next);
    (out, next)
}

/// Orders moves so that none overwrites a source still to be read; a cycle is broken through a new register.
fn ordered(moves: Vec<(u32, u32)>, mut next: u32) -> (Vec<(u32, u32)>, u32) {
    let mut pending: Vec<(u32, u32)> = moves.into_iter().filter(|(from, to)| from != to).collect();
    let mut readers: HashMap<u32, usize> = HashMap::new();
    for (from, _) in &pending {
        *readers.entry(*from).or_default() += 1;
    }
    let writer: HashMap<u32, usize> = pending.iter().enumerate().map(|(i, (_, to))| (*to, i)).collect();
    let mut done = vec![false; pending.len()];
    let mut out = Vec::new();
    let mut ready: Vec<usize> =
        (0..pending.len()).filter(|i| readers.get(&pending[*i].1).is_none_or(|n| *n == 0)).collect();
    for i in 0..pending.len() {
        while let Some(now) = ready.pop() {
            if std::mem::replace(&mut done[now], true) {
                continue;
            }
            let (from, to) = pending[now];
            out.push((from, to));
            let left = readers.entry(from).or_default();
            *left -= 1;
            if *left == 0
                && let Some(freed) = writer.get(&from)
            {
                ready.push(*freed);
            }
        }
        if !done[i] {
            // Only cycles are left: save one source in a register to break it.
            let (from, _) = pending[i];
            out.push((from, next));
            let again: Vec<usize> =
                (i..pending.len()).filter(|k| !done[*k] && pending[*k].0 == from).collect();
            for k in again {
                pending[k].0 = next;
            }
            readers.insert(next, readers[&from]);
            readers.insert(from, 0);
            next += 1;
            ready.extend(writer.get(&from));
        }
    }
    while let Some(now) = ready.pop() {
        if !std::mem::replace(&mut done[now], true) {
            out.push(pending[now]);
        }
    }
    (out, next)
}

fn with(ins: Instruction, at: impl Fn(u32) -> u32) -> Instruction {
    match ins {
        Instruction::Lit(_) | Instruction::Constant(_) | Instruction::Call(_) | Instruction::State(_) => ins,
        Instruction::Add(a, b) => Instruction::Add(at(a), at(b)),
        Instruction::Sub(a, b) => Instruction::Sub(at(a), at(b)),
        Instruction::Mul(a, b) => Instruction::Mul(at(a), at(b)),
        Instruction::Div(a, b) => Instruction::Div(at(a), at(b)),
        Instruction::Over(a, b, c) => Instruction::Over(at(a), at(b), at(c)),
        Instruction::MulAdd(a, b, c) => Instruction::MulAdd(at(a), at(b), at(c)),
        Instruction::MulSub(a, b, c) => Instruction::MulSub(at(a), at(b), at(c)),
        Instruction::MulFrom(a, b, c) => Instruction::MulFrom(at(a), at(b), at(c)),
        Instruction::Neg(a) => Instruction::Neg(at(a)),
        Instruction::Sqrt(a) => Instruction::Sqrt(at(a)),
        Instruction::Abs(a) => Instruction::Abs(at(a)),
        Instruction::Min(a, b) => Instruction::Min(at(a), at(b)),
        Instruction::Max(a, b) => Instruction::Max(at(a), at(b)),
        Instruction::SinCos(a) => Instruction::SinCos(at(a)),
        Instruction::HalfTurn(a) => Instruction::HalfTurn(at(a)),
        Instruction::Second(a) => Instruction::Second(at(a)),
        Instruction::Exp(a) => Instruction::Exp(at(a)),
        Instruction::Atan2(a, b) => Instruction::Atan2(at(a), at(b)),
        Instruction::Floor(a) => Instruction::Floor(at(a)),
        Instruction::Lt(a, b) => Instruction::Lt(at(a), at(b)),
        Instruction::Le(a, b) => Instruction::Le(at(a), at(b)),
        Instruction::And(a, b) => Instruction::And(at(a), at(b)),
        Instruction::Or(a, b) => Instruction::Or(at(a), at(b)),
        Instruction::Not(a) => Instruction::Not(at(a)),
        Instruction::Select(a, b, c) => Instruction::Select(at(a), at(b), at(c)),
    }
}

/// Runs `code` `times` times on a register file.
#[inline(always)]
fn interpret<A: Arith>(t: A::Token, code: &ByteCode, file: &mut [A::Cell], times: usize) {
    let (one, zero, half) = (A::lit(t, 1.0), A::lit(t, 0.0), A::lit(t, 0.5));
    for _ in 0..times {
        for op in &code.ops {
            macro_rules! get {
                ($a:expr) => {
                    A::load(t, &file[$a as usize])
                };
            }
            // Booleans are stored as 1 or 0 in the register file.
            macro_rules! truth {
                ($a:expr) => {
                    half.lt(get!($a))
                };
            }
            let value = match op.ins {
                Instruction::Add(a, b) => get!(a) + get!(b),
                Instruction::Sub(a, b) => get!(a) - get!(b),
                Instruction::Mul(a, b) => get!(a) * get!(b),
                Instruction::Div(a, b) => get!(a) / get!(b),
                Instruction::Over(a, b, c) => get!(a).over(get!(b), get!(c)),
                Instruction::MulAdd(a, b, c) => get!(a).mul_add(get!(b), get!(c)),
                Instruction::MulSub(a, b, c) => get!(a).mul_sub(get!(b), get!(c)),
                Instruction::MulFrom(a, b, c) => get!(a).mul_from(get!(b), get!(c)),
                Instruction::Neg(a) => -get!(a),
                Instruction::Sqrt(a) => get!(a).sqrt(),
                Instruction::Abs(a) => get!(a).abs(),
                Instruction::Min(a, b) => get!(a).min(get!(b)),
                Instruction::Max(a, b) => get!(a).max(get!(b)),
                Instruction::SinCos(a) => {
                    let (first, second) = get!(a).sin_cos();
                    second.store(&mut file[op.second as usize]);
                    first
                }
                Instruction::HalfTurn(a) => {
                    let (first, second) = get!(a).half_turn();
                    second.store(&mut file[op.second as usize]);
                    first
                }
                Instruction::Exp(a) => get!(a).exp(),
                Instruction::Atan2(a, b) => get!(a).atan2(get!(b)),
                Instruction::Floor(a) => get!(a).floor(),
                Instruction::Lt(a, b) => A::select(get!(a).lt(get!(b)), one, zero),
                Instruction::Le(a, b) => A::select(get!(a).le(get!(b)), one, zero),
                Instruction::And(a, b) => A::select(truth!(a) & truth!(b), one, zero),
                Instruction::Or(a, b) => A::select(truth!(a) | truth!(b), one, zero),
                Instruction::Not(a) => A::select(truth!(a), zero, one),
                Instruction::Select(a, b, c) => A::select(truth!(a), get!(b), get!(c)),
                Instruction::Lit(_)
                | Instruction::Constant(_)
                | Instruction::Call(_)
                | Instruction::State(_)
                | Instruction::Second(_) => continue,
            };
            value.store(&mut file[op.to as usize]);
        }
        for (from, to) in &code.moves {
            file[*to as usize] = file[*from as usize];
        }
    }
}

/// Cells on which byte code can run.
pub trait Interpret: Compiled {
    /// Runs `code` `times` times on a register file, with the instructions of a SIMD level.
    fn interpret(level: Level, code: &ByteCode, file: &mut [Self], times: usize);
}

impl Interpret for f64 {
    fn interpret(_: Level, code: &ByteCode, file: &mut [f64], times: usize) {
        interpret::<f64>((), code, file, times);
    }
}

macro_rules! impl_interpret {
    ($($cell:ty, $arith:ident, $entry:ident;)*) => {$(
        impl Interpret for $cell {
            fn interpret(level: Level, code: &ByteCode, file: &mut [Self], times: usize) {
                #[inline(always)]
                fn $entry<S: Simd>(simd: S, code: &ByteCode, file: &mut [$cell], times: usize) {
                    interpret::<$arith<S>>(simd, code, file, times);
                }
                dispatch!(level, simd => vectorize(simd, #[inline(always)] || $entry(simd, code, file, times)));
            }
        }
    )*};
}
type Two<T> = Pair<T>;
type F32Two<S> = Two<f32x16<S>>;
type F64Two<S> = Two<f64x8<S>>;
type F32Four<S> = Pair<Two<f32x16<S>>>;
type F64Four<S> = Pair<Two<f64x8<S>>>;
impl_interpret! {
    F32x16, f32x16, one_f32;
    F64x8, f64x8, one_f64;
    [F32x16; 2], F32Two, two_f32;
    [F64x8; 2], F64Two, two_f64;
    [[F32x16; 2]; 2], F32Four, four_f32;
    [[F64x8; 2]; 2], F64Four, four_f64;
}
