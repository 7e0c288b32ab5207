//! Functions of lanes as C: their code runs once over a number that writes down what is done with it.

use core::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Not, Sub};
use std::cell::RefCell;

use crate::lanes::{
    Arith, Number, atan2_f32, atan2_f64, exp_f32, exp_f64, half_turn_f32, half_turn_f64, sin_cos_f32,
    sin_cos_f64,
};

/// Statements so far, whether literals are f32, and what [`Arith::any`] is to answer.
#[derive(Default)]
struct Notes {
    lines: Vec<String>,
    single: bool,
    any: bool,
}

thread_local! {
    static NOTES: RefCell<Notes> = RefCell::default();
}

/// A vector, by the number of the statement that made it; 0 is the first argument, 1 the second.
#[derive(Clone, Copy, Debug)]
struct Noted(usize);

/// A mask, in the same way.
#[derive(Clone, Copy, Debug)]
struct NotedMask(usize);

/// Writes down a statement; returns its number.
fn note(kind: &str, text: &str) -> usize {
    NOTES.with_borrow_mut(|notes| {
        let n = notes.lines.len() + 2;
        notes.lines.push(format!("{kind} x{n} = {text};"));
        n
    })
}

fn vector(text: &str) -> Noted {
    Noted(note("V", text))
}

fn mask(text: &str) -> NotedMask {
    NotedMask(note("M", text))
}

/// A literal of N in C: a hexadecimal number, exact, rounded as lanes do it.
pub(super) fn literal<N: Number>(v: f64) -> String {
    format!("Lit({})", hexadecimal(N::constant(v).wide(), size_of::<N>() == size_of::<f32>()))
}

/// A number as C writes it exactly.
fn hexadecimal(v: f64, single: bool) -> String {
    let end = if single { "f" } else { "" };
    let sign = if v.is_sign_negative() { "-" } else { "" };
    let bits = v.to_bits();
    let (exponent, fraction) = ((bits >> 52 & 0x7ff) as i64, bits & ((1 << 52) - 1));
    match exponent {
        0x7ff if fraction == 0 => format!("{sign}__builtin_inf{end}()"),
        0x7ff => format!("__builtin_nan{end}(\"\")"),
        0 if fraction == 0 => format!("{sign}0x0p0{end}"),
        0 => format!("{sign}0x0.{fraction:013x}p-1022{end}"),
        _ => format!("{sign}0x1.{fraction:013x}p{}{end}", exponent - 1023),
    }
}

macro_rules! operators {
    ($of:ident, $make:ident: $($trait:ident, $method:ident, $name:literal;)*) => {$(
        impl $trait for $of {
            type Output = Self;
            fn $method(self, o: Self) -> Self {
                $make(&format!(concat!($name, "(x{}, x{})"), self.0, o.0))
            }
        }
    )*};
}
operators!(Noted, vector: Add, add, "Add"; Sub, sub, "Sub"; Mul, mul, "Mul"; Div, div, "Div";);
operators!(NotedMask, mask: BitAnd, bitand, "And"; BitOr, bitor, "Or";);

impl Neg for Noted {
    type Output = Self;
    fn neg(self) -> Self {
        vector(&format!("Neg(x{})", self.0))
    }
}
impl Not for NotedMask {
    type Output = Self;
    fn not(self) -> Self {
        mask(&format!("Not(x{})", self.0))
    }
}

impl Noted {
    fn one(self, name: &str) -> Self {
        vector(&format!("{name}(x{})", self.0))
    }
    fn two(self, name: &str, o: Self) -> Self {
        vector(&format!("{name}(x{}, x{})", self.0, o.0))
    }
    fn three(self, name: &str, a: Self, b: Self) -> Self {
        vector(&format!("{name}(x{}, x{}, x{})", self.0, a.0, b.0))
    }
    fn both(self, name: &str) -> (Self, Self) {
        NOTES.with_borrow_mut(|notes| {
            let n = notes.lines.len() + 2;
            notes.lines.push(format!("V x{n};"));
            notes.lines.push(format!("V x{}; {name}(x{}, &x{n}, &x{});", n + 1, self.0, n + 1));
            (Self(n), Self(n + 1))
        })
    }
}

impl Arith for Noted {
    type Token = ();
    type Cell = f64;
    type Mask = NotedMask;

    fn lit((): (), v: f64) -> Self {
        let single = NOTES.with_borrow(|notes| notes.single);
        vector(&if single { literal::<f32>(v) } else { literal::<f64>(v) })
    }
    fn every((): (), v: f64) -> Self {
        Self::lit((), v)
    }
    fn load((): (), cell: &f64) -> Self {
        Self::lit((), *cell)
    }
    fn shared((): (), cell: &f64) -> Self {
        Self::lit((), *cell)
    }
    fn store(self, _: &mut f64) {}
    fn mul_add(self, by: Self, plus: Self) -> Self {
        self.three("MulAdd", by, plus)
    }
    fn mul_sub(self, by: Self, less: Self) -> Self {
        self.three("MulSub", by, less)
    }
    fn mul_from(self, by: Self, from: Self) -> Self {
        self.three("MulFrom", by, from)
    }
    fn over(self, divisor: Self, reciprocal: Self) -> Self {
        self.three("Over", divisor, reciprocal)
    }
    fn sqrt(self) -> Self {
        self.one("Sqrt")
    }
    fn abs(self) -> Self {
        self.one("Abs")
    }
    fn min(self, other: Self) -> Self {
        self.two("Min", other)
    }
    fn max(self, other: Self) -> Self {
        self.two("Max", other)
    }
    fn sin_cos(self) -> (Self, Self) {
        self.both("SinCos")
    }
    fn half_turn(self) -> (Self, Self) {
        self.both("HalfTurn")
    }
    fn exp(self) -> Self {
        self.one("Exp")
    }
    fn atan2(self, x: Self) -> Self {
        self.two("Atan2", x)
    }
    fn floor(self) -> Self {
        self.one("Floor")
    }
    fn pow2(self) -> Self {
        self.one("Pow2")
    }
    fn any(mask: NotedMask) -> bool {
        NOTES.with_borrow_mut(|notes| {
            if !notes.any {
                // The short way: what was computed so far is the answer unless some lane needs the long one.
                notes.lines.push(format!("far = x{};", mask.0));
            }
            notes.any
        })
    }
    fn lt(self, other: Self) -> NotedMask {
        mask(&format!("Lt(x{}, x{})", self.0, other.0))
    }
    fn le(self, other: Self) -> NotedMask {
        mask(&format!("Le(x{}, x{})", self.0, other.0))
    }
    fn select(mask: NotedMask, yes: Self, no: Self) -> Self {
        vector(&format!("Select(x{}, x{}, x{})", mask.0, yes.0, no.0))
    }
}

/// Runs code over noted vectors; its statements and what it returns.
fn noted<T>(single: bool, any: bool, code: impl FnOnce() -> T) -> (String, T) {
    NOTES.set(Notes { single, any, lines: Vec::new() });
    let result = code();
    let lines = NOTES.take().lines;
    (lines.into_iter().fold(String::new(), |text, line| text + "  " + &line + "\n"), result)
}

/// A function of lanes as a C function of that name: `SinCos`, `HalfTurn`, `Exp` or `Atan2`.
pub(super) fn function<N: Number>(name: &str) -> String {
    let single = size_of::<N>() == size_of::<f32>();
    let (x, y) = (Noted(0), Noted(1));
    let pick = |one: fn((), Noted) -> (Noted, Noted), other: fn((), Noted) -> (Noted, Noted)| {
        let f = if single { one } else { other };
        move || f((), x)
    };
    let two = |(s, c): (Noted, Noted)| format!("  *first = x{};\n  *second = x{};\n", s.0, c.0);
    match name {
        "SinCos" => {
            let (text, out) = noted(single, true, pick(sin_cos_f32, sin_cos_f64));
            format!("INLINE void SinCos(V x0, V *first, V *second) {{\n{text}{}}}\n", two(out))
        }
        "HalfTurn" => {
            let (short, out) = noted(single, false, pick(half_turn_f32, half_turn_f64));
            let (long, far) = noted(single, true, pick(half_turn_f32, half_turn_f64));
            format!(
                "static __attribute__((noinline)) void HalfTurnFar(V x0, V *first, V *second) {{\n{long}{}}}\n\
                 INLINE void HalfTurn(V x0, V *first, V *second) {{\n  M far;\n{short}{}  if (__builtin_expect(Any(far), 0)) HalfTurnFar(x0, first, second);\n}}\n",
                two(far),
                two(out)
            )
        }
        "Exp" => {
            let (text, out) = noted(single, true, || if single { exp_f32((), x) } else { exp_f64((), x) });
            format!("INLINE V Exp(V x0) {{\n{text}  return x{};\n}}\n", out.0)
        }
        _ => {
            let angle = || if single { atan2_f32((), x, y) } else { atan2_f64((), x, y) };
            let (text, out) = noted(single, true, angle);
            format!("INLINE V Atan2(V x0, V x1) {{\n{text}  return x{};\n}}\n", out.0)
        }
    }
}
