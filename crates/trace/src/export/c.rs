//! C with vector types: the code of a step for the C compiler of this machine, with the bits of a kernel.
//!
//! A number of the code is a vector `V`, as wide as the registers of the SIMD level, and a cell of [`Cell::LANES`] lanes is taken in as many parts as
//! it has of them, one after the other; with AVX2 a `V` is both halves of a cell where registers suffice for that. The head of the file ([`head`]) says what `Add`, `MulAdd` … of vectors are; sines, exponentials and angles are printed from the same
//! functions that lanes compute ([`super::recorded`]), so nothing is written twice.

use std::fmt::Write as _;

use fearless_simd::Level;

use super::recorded::{function, literal};
use crate::lanes::{Cell, F32x16, F64x8, Number};
use crate::schedule::{Code, Instruction, Location, Schedule};

/// What the C compiler compiles for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Target {
    /// Vectors of 64 bytes, masks in registers of their own.
    Avx512,
    /// Vectors of 32 bytes, with fused products.
    Avx2,
    /// Vectors of 16 bytes of the compiler's own types: NEON and SSE4.2.
    Vectors,
}

impl Target {
    /// That of a SIMD level; `None` where the processor has too little.
    pub fn of(level: Level) -> Option<Self> {
        #[cfg(target_arch = "x86_64")]
        {
            match level {
                _ if level.as_avx512().is_some() => Some(Self::Avx512),
                _ if level.as_avx2().is_some() => Some(Self::Avx2),
                _ if level.as_sse4_2().is_some() => Some(Self::Vectors),
                _ => None,
            }
        }
        #[cfg(not(target_arch = "x86_64"))]
        {
            (!level.is_fallback()).then_some(Self::Vectors)
        }
    }

    /// Flags that let a compiler use its instructions, and no others: what was compiled runs on every machine of this level.
    pub fn flags(self) -> &'static [&'static str] {
        match self {
            Self::Avx512 => &["-mavx512f", "-mavx512bw", "-mavx512cd", "-mavx512dq", "-mavx512vl", "-mfma"],
            Self::Avx2 => &["-mavx2", "-mfma"],
            Self::Vectors if cfg!(target_arch = "x86_64") => &["-msse4.2"],
            Self::Vectors => &[],
        }
    }

    /// Bytes of a vector.
    fn bytes(self) -> usize {
        match self {
            Self::Avx512 => 64,
            Self::Avx2 => 32,
            Self::Vectors => 16,
        }
    }
}

/// Source file of a scheduled step, with the functions `pw_call(f)`, `pw_step(h, f, times, t)` and `pw_epilogue(h, f)` over cells of N's lanes: `h` is the
/// home, `f` the scratch ([`Location`]). Fresh inputs are read from `t`, the same in all lanes, (step, number of [`Schedule::fresh`]); where `t` is null they
/// stand in the home, the same in all steps.
pub fn kernel<N: Number>(schedule: &Schedule, target: Target) -> String {
    let (call, state, given) = (schedule.call_at(), schedule.state_at(), schedule.given_at());
    let codes = [&schedule.call, &schedule.step, &schedule.epilogue];
    let at_once = target == Target::Avx2 && most_alive(&schedule.step) <= ALIVE_IN_HALVES;
    let mut out = head::<N>(target, at_once);
    for name in functions(&codes) {
        out.push_str(&function::<N>(name));
    }
    let part = |lines: &[String]| {
        let body: String = lines.iter().fold(String::new(), |text, line| text + "    " + line + "\n");
        format!("  for (int part = 0; part < PARTS; part++, h += W, f += W) {{\n{body}  }}\n}}\n")
    };

    let mut lines = body::<N>(&schedule.call, &call, |k| load(given[k]));
    lines.extend(stores(&schedule.call, |k| call[k]));
    let _ = write!(out, "\nvoid pw_call(N *f) {{\n  N *h = f;\n{}", part(&lines));

    // The state stays in registers across the steps; the constants are loaded anew in each, or the compiler would spill them.
    let written = |slot: usize| schedule.step.stores.iter().any(|(_, to)| *to as usize == slot);
    let read = |slot: usize| schedule.step.instructions.contains(&Instruction::State(slot as u32));
    let mut lines = Vec::new();
    for slot in (0..state.len()).filter(|slot| written(*slot) || read(*slot)) {
        let first = if read(slot) { load(state[slot]) } else { "Lit(0)".to_string() };
        lines.push(format!("V s{slot} = {first};"));
    }
    lines.push("for (long n = 0; n < times; n++) {".to_string());
    lines.push("  AGAIN(f);".to_string());
    let fresh = schedule.fresh();
    let given_anew = fresh
        .iter()
        .enumerate()
        .map(|(j, slot)| format!("  if (t) s{slot} = Lit(t[n * {} + {j}]);", fresh.len()));
    lines.extend(given_anew);
    lines.extend(body::<N>(&schedule.step, &call, |k| format!("s{k}")).into_iter().map(|l| format!("  {l}")));
    lines.extend(schedule.step.stores.iter().map(|(value, slot)| format!("  s{slot} = v{value};")));
    lines.push("}".to_string());
    for slot in (0..state.len()).filter(|slot| written(*slot)) {
        lines.push(format!("Store({}, s{slot});", cell(state[slot])));
    }
    let _ = write!(out, "\nvoid pw_step(N *h, N *f, long times, const N *t) {{\n{}", part(&lines));

    let mut lines = body::<N>(&schedule.epilogue, &call, |k| load(state[k]));
    lines.extend(stores(&schedule.epilogue, |k| state[k]));
    let _ = write!(out, "\nvoid pw_epilogue(N *h, N *f) {{\n{}", part(&lines));
    out
}

/// Most computed numbers alive at once for which both halves of a cell are taken together. The two are independent, so that the processor always has
/// something to do: 9 to 26 % less time (47 and 52 numbers alive, attitude and state commands); with more, spilling costs more than that brings (111, RK4:
/// 4 % less; 122, a step backwards: 13 % more; gcc 12.2, AVX2).
const ALIVE_IN_HALVES: usize = 64;

/// How many of the numbers that code computes are still needed later, at most.
fn most_alive(code: &Code) -> usize {
    let n = code.instructions.len();
    let mut last = vec![0; n];
    for (i, ins) in code.instructions.iter().enumerate() {
        if let Instruction::Second(of) = ins {
            last[*of as usize] = i;
        }
        for of in ins.operands().into_iter().flatten() {
            last[of as usize] = i;
        }
    }
    code.stores.iter().for_each(|(value, _)| last[*value as usize] = n);
    let is_computed = |ins: &Instruction| {
        !matches!(
            ins,
            Instruction::Lit(_) | Instruction::Constant(_) | Instruction::Call(_) | Instruction::State(_)
        )
    };
    let (mut ends, mut alive, mut most) = (vec![0; n + 1], 0, 0);
    for (i, ins) in code.instructions.iter().enumerate() {
        if is_computed(ins) && last[i] > i {
            ends[last[i]] += 1;
            alive += 1;
        }
        alive -= ends[i];
        most = most.max(alive);
    }
    most
}

/// Functions that codes call, each after those that it calls itself.
fn functions(codes: &[&Code]) -> Vec<&'static str> {
    let mut out: Vec<&'static str> = Vec::new();
    for ins in codes.iter().flat_map(|c| &c.instructions) {
        let needs: &[&'static str] = match ins {
            Instruction::SinCos(_) => &["SinCos"],
            Instruction::HalfTurn(_) => &["SinCos", "HalfTurn"],
            Instruction::Exp(_) => &["Exp"],
            Instruction::Atan2(..) => &["Atan2"],
            _ => &[],
        };
        for name in needs {
            if !out.contains(name) {
                out.push(name);
            }
        }
    }
    out
}

/// Expression for the address of a cell.
fn cell(at: Location) -> String {
    match at {
        Location::Home(p) => format!("h + {p} * LANES"),
        Location::Scratch(k) => format!("f + {k} * LANES"),
    }
}

fn load(at: Location) -> String {
    format!("Load({})", cell(at))
}

fn stores(code: &Code, at: impl Fn(usize) -> Location) -> Vec<String> {
    code.stores
        .iter()
        .map(|(value, slot)| format!("Store({}, v{value});", cell(at(*slot as usize))))
        .collect()
}

/// Instructions as statements; `state` gives the expression that reads a state slot.
fn body<N: Number>(code: &Code, table: &[Location], state: impl Fn(usize) -> String) -> Vec<String> {
    let statement = |(i, ins): (usize, &Instruction)| {
        let kind = if ins.is_truth() { "M" } else { "V" };
        let text = match *ins {
            Instruction::Lit(bits) => literal::<N>(f64::from_bits(bits)),
            Instruction::Constant(k) => load(Location::Scratch(k)),
            Instruction::Call(k) => load(table[k as usize]),
            Instruction::State(k) => state(k as usize),
            Instruction::Second(of) => format!("w{of}"),
            ins => {
                let operands: Vec<String> =
                    ins.operands().into_iter().flatten().map(|o| format!("v{o}")).collect();
                let name = format!("{ins:?}");
                let name = name.split('(').next().unwrap_or_default();
                if matches!(ins, Instruction::SinCos(_) | Instruction::HalfTurn(_)) {
                    return format!("V v{i}, w{i}; {name}({}, &v{i}, &w{i});", operands.join(", "));
                }
                format!("{name}({})", operands.join(", "))
            }
        };
        format!("{kind} v{i} = {text};")
    };
    code.instructions.iter().enumerate().map(statement).collect()
}

/// Names that the head of a file gives to vectors, masks and what is done with them, in `c_halves.h` too.
const NAMES: [&str; 27] = [
    "V", "M", "Lit", "MulAdd", "MulSub", "MulFrom", "Sqrt", "Abs", "Min", "Max", "Floor", "Lt", "Le", "And",
    "Or", "Not", "Select", "Any", "Pow2", "Add", "Sub", "Mul", "Div", "Neg", "Over", "Load", "Store",
];

/// The line of a head before which nothing is renamed.
const INCLUDE: &str = "#include <immintrin.h>\n";

fn name_of_half(name: &str) -> String {
    match name {
        "V" => "Half".to_string(),
        "M" => "HalfMask".to_string(),
        name => format!("Half{name}"),
    }
}

/// What vectors are and what is done with them; `at_once`: a vector is two registers, both halves of a cell.
fn head<N: Number>(target: Target, at_once: bool) -> String {
    let single = size_of::<N>() == size_of::<f32>();
    let lanes = if single { F32x16::LANES } else { F64x8::LANES };
    let width = if at_once { lanes } else { target.bytes() / size_of::<N>() };
    let number = if single { "float" } else { "double" };
    let mut out = format!(
        "typedef {number} N;\nenum {{ LANES = {lanes}, W = {width}, PARTS = LANES / W }};\n\
         #define INLINE static inline __attribute__((always_inline))\n\
         #define AGAIN(p) __asm__ volatile(\"\" : \"+r\"(p))\n"
    );
    let text = match target {
        Target::Avx512 => include_str!("c_avx512.h"),
        Target::Avx2 => include_str!("c_avx2.h"),
        Target::Vectors => include_str!("c_vectors.h"),
    };
    let words = if single {
        [
            ("@p", "ps"),
            ("@s", "f"),
            ("@d", ""),
            ("@mask", "__mmask16"),
            ("@epi", "epi32"),
            ("@int", "int"),
            ("@bias", "127"),
            ("@shift", "23"),
            ("@quiet", "0x7fffffff"),
            ("@wide", "f32"),
        ]
    } else {
        [
            ("@p", "pd"),
            ("@s", ""),
            ("@d", "d"),
            ("@mask", "__mmask8"),
            ("@epi", "epi64"),
            ("@int", "long long"),
            ("@bias", "1023"),
            ("@shift", "52"),
            ("@quiet", "0x7fffffffffffffffll"),
            ("@wide", "f64"),
        ]
    };
    // Longer words first: one may begin with another.
    let mut words = words.to_vec();
    words.sort_by_key(|(from, _)| std::cmp::Reverse(from.len()));
    let text = words.iter().fold(text.to_string(), |text, (from, to)| text.replace(from, to));
    // Under other names the same definitions are those of one register.
    let (above, below) = text.split_once(INCLUDE).filter(|_| at_once).unwrap_or((&text, ""));
    out.push_str(above);
    if at_once {
        out.push_str(INCLUDE);
        out.extend(NAMES.iter().map(|name| format!("#define {name} {}\n", name_of_half(name))));
        out.push_str(below);
    }
    out.push_str(
        "INLINE V Add(V a, V b) { return a + b; }\nINLINE V Sub(V a, V b) { return a - b; }\n\
         INLINE V Mul(V a, V b) { return a * b; }\nINLINE V Div(V a, V b) { return a / b; }\n\
         INLINE V Neg(V a) { return -a; }\nINLINE V Over(V a, V b, V r) { (void)b; return a * r; }\n\
         INLINE V Load(const N *p) { return *(const V *)p; }\nINLINE void Store(N *p, V v) { *(V *)p = v; }\n",
    );
    if at_once {
        out.extend(NAMES.iter().map(|name| format!("#undef {name}\n")));
        out.push_str(include_str!("c_halves.h"));
    }
    out
}
