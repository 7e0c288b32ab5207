//! Arithmetic of generated kernels and byte code: on one number, or on several in SIMD lanes.
//!
//! A kernel is straight-line code over [`Arith`]. Over f64 its results have the same bits as the traced code. In lanes,
//! products and sums are fused where the processor can, division by an invariant becomes multiplication by its reciprocal,
//! and sines, exponentials and angles are the polynomials below. Each lane's result is independent of the other lanes.
//!
//! Every function here is `#[inline(always)]`, and no closure or iterator stands between the entry that enables the
//! processor's features and the arithmetic: what is not inlined there is compiled without those features and runs many
//! times slower.
//!
//! Largest errors in units in the last place of the result, as measured by the tests below:
//!
//! | function | where | f32 lanes | f64 lanes |
//! | --- | --- | --- | --- |
//! | sine, cosine | angles up to 10,000 rad, absolute error in units of the last place of 1 | 1 | 1 |
//! | `exp` | results that are normal numbers | 2 | 2 |
//! | `atan2` | everywhere | 3 | 3 |
//! | `half_turn` | squared angles up to 4 rad² | 2 | 2 |
//! | cosine of `half_turn` | squared angles up to 100 rad², in units of the last place of 1 | 4 | 4 |

#![allow(clippy::excessive_precision, reason = "coefficients stand as they were published")]
#![allow(clippy::eq_op, reason = "x − x tells numbers from what is none")]

use core::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Not, Sub};
use std::sync::OnceLock;

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch, f32x16, f64x8, i32x16, i64x8, mask32x16, mask64x8};

use super::bytecode::Interpret;
use super::{Real, rows};

/// A number type for storage: f64 or f32.
pub trait Number: Real + Default + PartialOrd + Send + Sync + core::fmt::Display {
    /// One block of lanes.
    type Cell: Interpret<Number = Self>;
    /// Two blocks of lanes.
    type Two: Interpret<Number = Self>;
    /// Four blocks of lanes.
    type Four: Interpret<Number = Self>;
    /// Name used in messages and file names.
    const NAME: &'static str;
    /// Rounded to this type.
    fn of(v: f64) -> Self;
    /// Rounded to this type; a nonzero value that would underflow to zero becomes the smallest normal number.
    fn constant(v: f64) -> Self;
    /// Exact conversion to f64.
    fn wide(self) -> f64;
    /// Whether it is finite (neither NaN nor infinite).
    fn finite(self) -> bool;
}

macro_rules! impl_number {
    ($float:ident, $cell:ident) => {
        impl Number for $float {
            type Cell = $cell;
            type Two = [$cell; 2];
            type Four = [[$cell; 2]; 2];
            const NAME: &'static str = stringify!($float);
            #[inline(always)]
            fn of(v: f64) -> Self {
                v as $float
            }
            #[inline(always)]
            fn constant(v: f64) -> Self {
                let rounded = v as $float;
                let lost = v != 0.0 && rounded.abs() < $float::MIN_POSITIVE;
                let kept = if v < 0.0 { -$float::MIN_POSITIVE } else { $float::MIN_POSITIVE };
                if lost { kept } else { rounded }
            }
            #[inline(always)]
            fn wide(self) -> f64 {
                self.into()
            }
            #[inline(always)]
            fn finite(self) -> bool {
                self.is_finite()
            }
        }
    };
}
impl_number!(f64, F64x8);
impl_number!(f32, F32x16);

/// Memory layout of one block of lanes.
pub trait Cell: Copy + Send + Sync + core::fmt::Debug + 'static {
    /// Number type of a lane.
    type Number: Number;
    /// Number of lanes.
    const LANES: usize;
    /// Broadcasts a number to all lanes.
    fn splat(v: Self::Number) -> Self;
    /// Number in one lane.
    fn get(&self, lane: usize) -> Self::Number;
    /// Sets the number of one lane.
    fn set(&mut self, lane: usize, v: Self::Number);
    /// Sets lane i to `get(from + i)`, for all lanes.
    fn fill(&mut self, from: usize, get: impl Fn(usize) -> Self::Number);
    /// Calls `put(from + i, number)` for every lane; returns the index after the last.
    fn drain(&self, from: usize, put: impl FnMut(usize, Self::Number)) -> usize;
    /// Adds x − x per lane: zero where x is finite, NaN elsewhere.
    fn poison(&mut self, of: &Self);
    /// Adds NaN per lane where |x| is greater than `limit`.
    fn poison_beyond(&mut self, of: &Self, limit: Self::Number);
    /// Sets lane i of cell j to number `col + j` of row i, for all lanes: rows of `width` numbers stand one behind the other in `rows`.
    fn gather(_level: Level, cells: &mut [Self], rows: &[Self::Number], width: usize, col: usize) {
        rows::gather(cells, rows, width, col);
    }
    /// The way back from [`Cell::gather`]; other columns stay as they are.
    fn scatter(_level: Level, cells: &[Self], rows: &mut [Self::Number], width: usize, col: usize) {
        rows::scatter(cells, rows, width, col);
    }
}

macro_rules! impl_cell {
    ($(#[$meta:meta])* $name:ident, $float:ident, $lanes:literal, $gather:ident, $scatter:ident) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq)]
        #[repr(align(64))]
        pub struct $name(pub [$float; $lanes]);

        impl Cell for $name {
            type Number = $float;
            const LANES: usize = $lanes;
            #[inline(always)]
            fn splat(v: $float) -> Self {
                Self([v; $lanes])
            }
            #[inline(always)]
            fn get(&self, lane: usize) -> $float {
                self.0[lane]
            }
            #[inline(always)]
            fn set(&mut self, lane: usize, v: $float) {
                self.0[lane] = v;
            }
            #[inline(always)]
            fn fill(&mut self, from: usize, get: impl Fn(usize) -> $float) {
                for lane in 0..$lanes {
                    self.0[lane] = get(from + lane);
                }
            }
            #[inline(always)]
            fn drain(&self, from: usize, mut put: impl FnMut(usize, $float)) -> usize {
                for lane in 0..$lanes {
                    put(from + lane, self.0[lane]);
                }
                from + $lanes
            }
            #[inline(always)]
            fn poison(&mut self, of: &Self) {
                for lane in 0..$lanes {
                    self.0[lane] += of.0[lane] - of.0[lane];
                }
            }
            #[inline(always)]
            fn poison_beyond(&mut self, of: &Self, limit: $float) {
                for lane in 0..$lanes {
                    self.0[lane] += if of.0[lane].abs() > limit { $float::NAN } else { 0.0 };
                }
            }
            #[inline(always)]
            fn gather(level: Level, cells: &mut [Self], rows: &[$float], width: usize, col: usize) {
                rows::$gather(level, cells, rows, width, col);
            }
            #[inline(always)]
            fn scatter(level: Level, cells: &[Self], rows: &mut [$float], width: usize, col: usize) {
                rows::$scatter(level, cells, rows, width, col);
            }
        }
    };
}
impl_cell! {
    /// Sixteen lanes of f32.
    F32x16, f32, 16, gather_f32, scatter_f32
}
impl_cell! {
    /// Eight lanes of f64.
    F64x8, f64, 8, gather_f64, scatter_f64
}

impl Cell for f64 {
    type Number = f64;
    const LANES: usize = 1;
    #[inline(always)]
    fn splat(v: f64) -> Self {
        v
    }
    #[inline(always)]
    fn get(&self, _: usize) -> f64 {
        *self
    }
    #[inline(always)]
    fn set(&mut self, _: usize, v: f64) {
        *self = v;
    }
    #[inline(always)]
    fn fill(&mut self, from: usize, get: impl Fn(usize) -> f64) {
        *self = get(from);
    }
    #[inline(always)]
    fn drain(&self, from: usize, mut put: impl FnMut(usize, f64)) -> usize {
        put(from, *self);
        from + 1
    }
    #[inline(always)]
    fn poison(&mut self, of: &f64) {
        *self += of - of;
    }
    #[inline(always)]
    fn poison_beyond(&mut self, of: &f64, limit: f64) {
        *self += if of.abs() > limit { f64::NAN } else { 0.0 };
    }
}

impl<C: Cell, const W: usize> Cell for [C; W] {
    type Number = C::Number;
    const LANES: usize = C::LANES * W;
    #[inline(always)]
    fn splat(v: C::Number) -> Self {
        [C::splat(v); W]
    }
    #[inline(always)]
    fn get(&self, lane: usize) -> C::Number {
        self[lane / C::LANES].get(lane % C::LANES)
    }
    #[inline(always)]
    fn set(&mut self, lane: usize, v: C::Number) {
        self[lane / C::LANES].set(lane % C::LANES, v);
    }
    #[inline(always)]
    fn fill(&mut self, from: usize, get: impl Fn(usize) -> C::Number) {
        for i in 0..W {
            self[i].fill(from + i * C::LANES, &get);
        }
    }
    #[inline(always)]
    fn drain(&self, from: usize, mut put: impl FnMut(usize, C::Number)) -> usize {
        for i in 0..W {
            self[i].drain(from + i * C::LANES, &mut put);
        }
        from + Self::LANES
    }
    #[inline(always)]
    fn poison(&mut self, of: &Self) {
        for i in 0..W {
            self[i].poison(&of[i]);
        }
    }
    #[inline(always)]
    fn poison_beyond(&mut self, of: &Self, limit: C::Number) {
        for i in 0..W {
            self[i].poison_beyond(&of[i], limit);
        }
    }
}

/// Runs `f` with the registers of a level of SIMD, on a stack that is aligned to the widest of them.
///
/// LLVM aligns what it spills only in functions that keep a frame pointer, and decides on that before it gives out registers: code without a local variable of such an
/// alignment spills to addresses that cross lines of the cache, depending on the caller's stack, and a load that follows such a store stalls. Kernels flew 77 to 104
/// million steps a second, another number in each process; aligned 110 in each.
#[inline(always)]
pub fn vectorize<S: Simd, R>(simd: S, f: impl FnOnce() -> R) -> R {
    simd.vectorize(
        #[inline(always)]
        || {
            core::hint::black_box(&core::mem::MaybeUninit::<F32x16>::uninit());
            f()
        },
    )
}

/// Copies cells within a file, in order: (from, to).
pub fn copy_cells<C: Cell>(level: Level, file: &mut [C], pairs: &[(u32, u32)]) {
    #[inline(always)]
    fn copy<C: Cell>(file: &mut [C], pairs: &[(u32, u32)]) {
        for i in 0..pairs.len() {
            let (from, to) = pairs[i];
            file[to as usize] = file[from as usize];
        }
    }
    dispatch!(level, simd => vectorize(simd, #[inline(always)] || copy(file, pairs)));
}

/// Whether all lanes of `cells` are finite, and those of the first `near` cells not beyond `limit`.
pub fn all_finite<C: Cell>(level: Level, cells: &[C], near: usize, limit: C::Number) -> bool {
    #[inline(always)]
    fn finite<C: Cell>(cells: &[C], near: usize, limit: C::Number) -> bool {
        let mut sum = C::splat(C::Number::zero());
        for i in 0..cells.len() {
            sum.poison(&cells[i]);
        }
        for i in 0..near {
            sum.poison_beyond(&cells[i], limit);
        }
        let mut all = true;
        for lane in 0..C::LANES {
            all &= sum.get(lane) == C::Number::zero();
        }
        all
    }
    dispatch!(level, simd => vectorize(simd, #[inline(always)] || finite(cells, near, limit)))
}

/// Operations that kernels need on a number or a block of lanes.
pub trait Arith:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> + Neg<Output = Self>
{
    /// Proof that the processor has the features.
    type Token: Copy;
    /// How such numbers are stored in memory.
    type Cell: Cell;
    /// Results of comparisons.
    type Mask: Copy + BitAnd<Output = Self::Mask> + BitOr<Output = Self::Mask> + Not<Output = Self::Mask>;

    /// A constant. A nonzero value that would underflow to zero becomes the smallest normal number.
    fn lit(token: Self::Token, v: f64) -> Self;
    /// The same number in all lanes.
    fn every(token: Self::Token, v: <Self::Cell as Cell>::Number) -> Self;
    /// Loads from memory.
    fn load(token: Self::Token, cell: &Self::Cell) -> Self;
    /// Loads a cell whose value is shared by all blocks of a batch.
    fn shared(token: Self::Token, cell: &Self::Cell) -> Self;
    /// Stores to memory.
    fn store(self, cell: &mut Self::Cell);
    /// `self` × `by` + `plus`; fused (one rounding) in lanes where the processor can.
    fn mul_add(self, by: Self, plus: Self) -> Self;
    /// `self` × `by` − `less`; fused (one rounding) in lanes where the processor can.
    fn mul_sub(self, by: Self, less: Self) -> Self;
    /// `from` − `self` × `by`; fused (one rounding) in lanes where the processor can.
    fn mul_from(self, by: Self, from: Self) -> Self;
    /// `self` / `divisor`; lanes multiply by `reciprocal` instead.
    fn over(self, divisor: Self, reciprocal: Self) -> Self;
    /// Square root.
    fn sqrt(self) -> Self;
    /// Magnitude, as [`Real::abs`].
    fn abs(self) -> Self;
    /// The smaller, as [`Real::min`].
    fn min(self, other: Self) -> Self;
    /// The larger, as [`Real::max`].
    fn max(self, other: Self) -> Self;
    /// Sine and cosine of an angle in radians.
    fn sin_cos(self) -> (Self, Self);
    /// [`Real::half_turn`].
    fn half_turn(self) -> (Self, Self);
    /// `e^self`.
    fn exp(self) -> Self;
    /// Angle of the point (`x`, `self`), rad.
    fn atan2(self, x: Self) -> Self;
    /// Largest integer not above.
    fn floor(self) -> Self;
    /// Two to the power of an integer from −126 to 127.
    fn pow2(self) -> Self;
    /// Whether any lane of a mask is set.
    fn any(mask: Self::Mask) -> bool;
    /// `self < other`.
    fn lt(self, other: Self) -> Self::Mask;
    /// `self <= other`.
    fn le(self, other: Self) -> Self::Mask;
    /// `yes` where `mask` holds, else `no`.
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self;
}

impl Arith for f64 {
    type Token = ();
    type Cell = f64;
    type Mask = bool;

    #[inline(always)]
    fn lit((): (), v: f64) -> Self {
        v
    }
    #[inline(always)]
    fn every((): (), v: f64) -> Self {
        v
    }
    #[inline(always)]
    fn load((): (), cell: &f64) -> Self {
        *cell
    }
    #[inline(always)]
    fn shared((): (), cell: &f64) -> Self {
        *cell
    }
    #[inline(always)]
    fn store(self, cell: &mut f64) {
        *cell = self;
    }
    #[inline(always)]
    fn mul_add(self, by: Self, plus: Self) -> Self {
        self * by + plus
    }
    #[inline(always)]
    fn mul_sub(self, by: Self, less: Self) -> Self {
        self * by - less
    }
    #[inline(always)]
    fn mul_from(self, by: Self, from: Self) -> Self {
        from - self * by
    }
    #[inline(always)]
    fn over(self, divisor: Self, _: Self) -> Self {
        self / divisor
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        f64::sqrt(self)
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Real::abs(self)
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Real::min(self, other)
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Real::max(self, other)
    }
    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        Real::sin_cos(self)
    }
    #[inline(always)]
    fn half_turn(self) -> (Self, Self) {
        Real::half_turn(self)
    }
    #[inline(always)]
    fn exp(self) -> Self {
        Real::exp(self)
    }
    #[inline(always)]
    fn atan2(self, x: Self) -> Self {
        Real::atan2(self, x)
    }
    #[inline(always)]
    fn floor(self) -> Self {
        f64::floor(self)
    }
    #[inline(always)]
    fn pow2(self) -> Self {
        self.exp2()
    }
    #[inline(always)]
    fn any(mask: bool) -> bool {
        mask
    }
    #[inline(always)]
    fn lt(self, other: Self) -> bool {
        self < other
    }
    #[inline(always)]
    fn le(self, other: Self) -> bool {
        self <= other
    }
    #[inline(always)]
    fn select(mask: bool, yes: Self, no: Self) -> Self {
        if mask { yes } else { no }
    }
}

/// Operations whose code is the same for both lane types.
macro_rules! lanes_alike {
    ($lanes:ident, $mask:ident, $float:ident, $cell:ident, $abs:ident, $min:ident, $max:ident, $lt:ident, $le:ident,
     $sin_cos:ident, $half_turn:ident, $exp:ident, $atan2:ident, $pow2:ident) => {
        impl<S: Simd> Arith for $lanes<S> {
            type Token = S;
            type Cell = $cell;
            type Mask = $mask<S>;

            #[inline(always)]
            fn lit(token: S, v: f64) -> Self {
                Self::splat(token, <$float as Number>::constant(v))
            }
            #[inline(always)]
            fn every(token: S, v: $float) -> Self {
                Self::splat(token, v)
            }
            #[inline(always)]
            fn load(token: S, cell: &$cell) -> Self {
                // Through a reference: with debug assertions on, reading the array by value is checked for overlap.
                let mut lanes = Self::splat(token, 0.0);
                *lanes = cell.0;
                lanes
            }
            #[inline(always)]
            fn shared(token: S, cell: &$cell) -> Self {
                Self::load(token, cell)
            }
            #[inline(always)]
            fn store(self, cell: &mut $cell) {
                cell.0 = *self;
            }
            #[inline(always)]
            fn mul_add(self, by: Self, plus: Self) -> Self {
                SimdFloat::mul_add(self, by, plus)
            }
            #[inline(always)]
            fn mul_sub(self, by: Self, less: Self) -> Self {
                SimdFloat::mul_sub(self, by, less)
            }
            #[inline(always)]
            fn mul_from(self, by: Self, from: Self) -> Self {
                SimdFloat::mul_add(-self, by, from)
            }
            #[inline(always)]
            fn over(self, _: Self, reciprocal: Self) -> Self {
                self * reciprocal
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                SimdFloat::sqrt(self)
            }
            #[inline(always)]
            fn abs(self) -> Self {
                self.simd.$abs(self)
            }
            // Swapped: the processor's own min and max return their second operand where one is NaN.
            #[inline(always)]
            fn min(self, other: Self) -> Self {
                self.simd.$min(other, self)
            }
            #[inline(always)]
            fn max(self, other: Self) -> Self {
                self.simd.$max(other, self)
            }
            #[inline(always)]
            fn sin_cos(self) -> (Self, Self) {
                $sin_cos(self.simd, self)
            }
            #[inline(always)]
            fn half_turn(self) -> (Self, Self) {
                $half_turn(self.simd, self)
            }
            #[inline(always)]
            fn exp(self) -> Self {
                $exp(self.simd, self)
            }
            #[inline(always)]
            fn atan2(self, x: Self) -> Self {
                $atan2(self.simd, self, x)
            }
            #[inline(always)]
            fn floor(self) -> Self {
                SimdFloat::floor(self)
            }
            #[inline(always)]
            fn pow2(self) -> Self {
                $pow2(self)
            }
            #[inline(always)]
            fn any(mask: Self::Mask) -> bool {
                // Via the bit mask: on AVX2, `any_true` of two halves may stay a call.
                mask.to_bitmask() != 0
            }
            #[inline(always)]
            fn lt(self, other: Self) -> Self::Mask {
                self.simd.$lt(self, other)
            }
            #[inline(always)]
            fn le(self, other: Self) -> Self::Mask {
                self.simd.$le(self, other)
            }
            #[inline(always)]
            fn select(mask: Self::Mask, yes: Self, no: Self) -> Self {
                mask.select(yes, no)
            }
        }
    };
}

lanes_alike!(
    f32x16,
    mask32x16,
    f32,
    F32x16,
    abs_f32x16,
    min_f32x16,
    max_f32x16,
    simd_lt_f32x16,
    simd_le_f32x16,
    sin_cos_f32,
    half_turn_f32,
    exp_f32,
    atan2_f32,
    pow2_f32
);
lanes_alike!(
    f64x8,
    mask64x8,
    f64,
    F64x8,
    abs_f64x8,
    min_f64x8,
    max_f64x8,
    simd_lt_f64x8,
    simd_le_f64x8,
    sin_cos_f64,
    half_turn_f64,
    exp_f64,
    atan2_f64,
    pow2_f64
);

/// Two blocks of lanes side by side: the processor computes one while it waits for a result of the other.
#[derive(Clone, Copy, Debug)]
pub struct Pair<T>(T, T);

/// Comparison results of a [`Pair`].
#[derive(Clone, Copy, Debug)]
pub struct PairMask<T>(T, T);

macro_rules! pair_operator {
    ($pair:ident: $($trait:ident, $method:ident;)*) => {$(
        impl<T: $trait<Output = T>> $trait for $pair<T> {
            type Output = Self;
            #[inline(always)]
            fn $method(self, o: Self) -> Self {
                Self(self.0.$method(o.0), self.1.$method(o.1))
            }
        }
    )*};
}
pair_operator!(Pair: Add, add; Sub, sub; Mul, mul; Div, div;);
pair_operator!(PairMask: BitAnd, bitand; BitOr, bitor;);

impl<T: Neg<Output = T>> Neg for Pair<T> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self(-self.0, -self.1)
    }
}
impl<T: Not<Output = T>> Not for PairMask<T> {
    type Output = Self;
    #[inline(always)]
    fn not(self) -> Self {
        Self(!self.0, !self.1)
    }
}

impl<T: Arith> Arith for Pair<T> {
    type Token = T::Token;
    type Cell = [T::Cell; 2];
    type Mask = PairMask<T::Mask>;

    #[inline(always)]
    fn lit(token: Self::Token, v: f64) -> Self {
        Self(T::lit(token, v), T::lit(token, v))
    }
    #[inline(always)]
    fn every(token: Self::Token, v: <Self::Cell as Cell>::Number) -> Self {
        Self(T::every(token, v), T::every(token, v))
    }
    #[inline(always)]
    fn load(token: Self::Token, cell: &Self::Cell) -> Self {
        Self(T::load(token, &cell[0]), T::load(token, &cell[1]))
    }
    #[inline(always)]
    fn shared(token: Self::Token, cell: &Self::Cell) -> Self {
        let both = T::shared(token, &cell[0]);
        Self(both, both)
    }
    #[inline(always)]
    fn store(self, cell: &mut Self::Cell) {
        self.0.store(&mut cell[0]);
        self.1.store(&mut cell[1]);
    }
    #[inline(always)]
    fn mul_add(self, by: Self, plus: Self) -> Self {
        Self(self.0.mul_add(by.0, plus.0), self.1.mul_add(by.1, plus.1))
    }
    #[inline(always)]
    fn mul_sub(self, by: Self, less: Self) -> Self {
        Self(self.0.mul_sub(by.0, less.0), self.1.mul_sub(by.1, less.1))
    }
    #[inline(always)]
    fn mul_from(self, by: Self, from: Self) -> Self {
        Self(self.0.mul_from(by.0, from.0), self.1.mul_from(by.1, from.1))
    }
    #[inline(always)]
    fn over(self, divisor: Self, reciprocal: Self) -> Self {
        Self(self.0.over(divisor.0, reciprocal.0), self.1.over(divisor.1, reciprocal.1))
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(self.0.sqrt(), self.1.sqrt())
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Self(self.0.abs(), self.1.abs())
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self(self.0.min(other.0), self.1.min(other.1))
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self(self.0.max(other.0), self.1.max(other.1))
    }
    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        let ((s0, c0), (s1, c1)) = (self.0.sin_cos(), self.1.sin_cos());
        (Self(s0, s1), Self(c0, c1))
    }
    #[inline(always)]
    fn half_turn(self) -> (Self, Self) {
        let ((s0, c0), (s1, c1)) = (self.0.half_turn(), self.1.half_turn());
        (Self(s0, s1), Self(c0, c1))
    }
    #[inline(always)]
    fn exp(self) -> Self {
        Self(self.0.exp(), self.1.exp())
    }
    #[inline(always)]
    fn atan2(self, x: Self) -> Self {
        Self(self.0.atan2(x.0), self.1.atan2(x.1))
    }
    #[inline(always)]
    fn floor(self) -> Self {
        Self(self.0.floor(), self.1.floor())
    }
    #[inline(always)]
    fn pow2(self) -> Self {
        Self(self.0.pow2(), self.1.pow2())
    }
    #[inline(always)]
    fn any(mask: Self::Mask) -> bool {
        T::any(mask.0) || T::any(mask.1)
    }
    #[inline(always)]
    fn lt(self, other: Self) -> Self::Mask {
        PairMask(self.0.lt(other.0), self.1.lt(other.1))
    }
    #[inline(always)]
    fn le(self, other: Self) -> Self::Mask {
        PairMask(self.0.le(other.0), self.1.le(other.1))
    }
    #[inline(always)]
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self {
        Self(T::select(mask.0, yes.0, no.0), T::select(mask.1, yes.1, no.1))
    }
}

/// Evaluates a polynomial by Horner's rule; coefficients start with the constant one.
#[inline(always)]
fn polynomial<A: Arith, const N: usize>(t: A::Token, x: A, coefficients: [f64; N]) -> A {
    let mut sum = A::lit(t, coefficients[N - 1]);
    let mut i = N - 1;
    while i > 0 {
        i -= 1;
        sum = sum.mul_add(x, A::lit(t, coefficients[i]));
    }
    sum
}

/// Rounds x to the nearest integer.
#[inline(always)]
fn nearest<A: Arith>(t: A::Token, x: A) -> A {
    (x + A::lit(t, 0.5)).floor()
}

/// Argument reduction: x − k · c, with the constant c in three parts of few bits so that the products are exact. Source:
/// Cody & Waite, "Software Manual for the Elementary Functions", Prentice-Hall 1980, ch. 8.
#[inline(always)]
fn reduced<A: Arith>(t: A::Token, x: A, k: A, parts: [f64; 3]) -> A {
    let r = k.mul_from(A::lit(t, parts[0]), x);
    let r = k.mul_from(A::lit(t, parts[1]), r);
    // Where the angle is too large for an exact reduction the remainder is clamped, so that the results stay bounded.
    k.mul_from(A::lit(t, parts[2]), r).max(A::lit(t, -0.8)).min(A::lit(t, 0.8))
}

/// Sine and cosine in quadrant k (an integer), from those of the remainder.
#[inline(always)]
fn of_quadrant<A: Arith>(t: A::Token, k: A, sin: A, cos: A) -> (A, A) {
    // k modulo 4; exact, since k is an integer.
    let q = (k * A::lit(t, 0.25)).floor().mul_from(A::lit(t, 4.0), k);
    let odd = A::lit(t, 0.5).lt((q * A::lit(t, 0.5)).floor().mul_from(A::lit(t, 2.0), q));
    let s = A::select(odd, cos, sin);
    let c = A::select(odd, sin, cos);
    // No logic on masks: on AVX2 the compiler may leave that as calls.
    let first = q.lt(A::lit(t, 0.5));
    let upper = q.lt(A::lit(t, 1.5));
    let last = A::lit(t, 2.5).lt(q);
    (A::select(upper, s, -s), A::select(first, c, A::select(last, c, -c)))
}

// The polynomials of sine, cosine, exponential and arc tangent are those of S. Moshier's Cephes library, release 2.8
// (sinf.c, expf.c, atanf.c, sin.c, exp.c, atan.c).

#[inline(always)]
pub(crate) fn sin_cos_f32<A: Arith>(t: A::Token, x: A) -> (A, A) {
    let k = nearest(t, x * A::lit(t, core::f64::consts::FRAC_2_PI));
    let parts = [1.570_312_5, 4.837_512_969_970_703e-4, 7.549_789_954_891_882e-8];
    let r = reduced(t, x, k, parts);
    let z = r * r;
    let s = polynomial(t, z, [-1.666_665_461_1e-1, 8.332_160_873_6e-3, -1.951_529_589_1e-4]);
    let c = polynomial(t, z, [4.166_664_568_298_827e-2, -1.388_731_625_493_765e-3, 2.443_315_711_809_948e-5]);
    let sin = (s * z).mul_add(r, r);
    let cos = c.mul_add(z * z, z.mul_from(A::lit(t, 0.5), A::lit(t, 1.0)));
    of_quadrant(t, k, sin, cos)
}

#[inline(always)]
pub(crate) fn sin_cos_f64<A: Arith>(t: A::Token, x: A) -> (A, A) {
    let k = nearest(t, x * A::lit(t, core::f64::consts::FRAC_2_PI));
    // Parts of 33 bits, as in fdlibm's e_rem_pio2.c.
    let parts = [1.570_796_326_734_125_6, 6.077_100_506_303_966e-11, 2.022_266_248_795_950_7e-21];
    let r = reduced(t, x, k, parts);
    let z = r * r;
    let s = polynomial(
        t,
        z,
        [
            -1.666_666_666_666_663_07e-1,
            8.333_333_333_322_118_59e-3,
            -1.984_126_982_958_953_86e-4,
            2.755_731_362_138_572_45e-6,
            -2.505_074_776_285_780_73e-8,
            1.589_623_015_765_465_68e-10,
        ],
    );
    let c = polynomial(
        t,
        z,
        [
            4.166_666_666_666_659_29e-2,
            -1.388_888_888_887_305_64e-3,
            2.480_158_728_885_170_45e-5,
            -2.755_731_417_929_673_88e-7,
            2.087_570_084_197_473_17e-9,
            -1.135_853_652_138_768_17e-11,
        ],
    );
    let sin = (s * z).mul_add(r, r);
    let cos = c.mul_add(z * z, z.mul_from(A::lit(t, 0.5), A::lit(t, 1.0)));
    of_quadrant(t, k, sin, cos)
}

/// Both functions of a squared angle: by series up to 2 rad, above that by root, sine and cosine. No body turns that far in
/// a step, so the slow path runs only where a lane needs it.
#[inline(always)]
fn half_turn_by<A: Arith>(t: A::Token, x: A, series: (A, A)) -> (A, A) {
    let far = A::lit(t, HALF_TURN_SERIES).lt(x);
    if A::any(far) {
        let angle = x.sqrt();
        let (sin, cos) = (angle * A::lit(t, 0.5)).sin_cos();
        return (A::select(far, sin / angle, series.0), A::select(far, cos, series.1));
    }
    series
}

/// Squared angle up to which the series is used, rad².
const HALF_TURN_SERIES: f64 = 4.0;

/// Coefficients of sin(√x/2)/√x and cos(√x/2) in x: (−1/4)ⁿ / 2(2n + 1)! and (−1/4)ⁿ / (2n)!.
const HALF_SIN: [f64; 10] = half_turn_series(1, 0.5);
const HALF_COS: [f64; 10] = half_turn_series(0, 1.0);

const fn half_turn_series(odd: usize, first: f64) -> [f64; 10] {
    let mut out = [first; 10];
    let mut n = 1;
    while n < 10 {
        let top = (2 * n + odd) as f64;
        out[n] = out[n - 1] * -0.25 / (top * (top - 1.0));
        n += 1;
    }
    out
}

const fn first_six(c: [f64; 10]) -> [f64; 6] {
    [c[0], c[1], c[2], c[3], c[4], c[5]]
}

#[inline(always)]
pub(crate) fn half_turn_f32<A: Arith>(t: A::Token, x: A) -> (A, A) {
    let series =
        (polynomial(t, x, const { first_six(HALF_SIN) }), polynomial(t, x, const { first_six(HALF_COS) }));
    half_turn_by(t, x, series)
}

#[inline(always)]
pub(crate) fn half_turn_f64<A: Arith>(t: A::Token, x: A) -> (A, A) {
    half_turn_by(t, x, (polynomial(t, x, HALF_SIN), polynomial(t, x, HALF_COS)))
}

/// Exponential of x: 0 below `least`, infinite above `most`; `of_remainder` is e to the remainder after multiples of ln 2.
#[inline(always)]
fn scaled<A: Arith>(t: A::Token, x: A, (least, most): (f64, f64), k: A, of_remainder: A) -> A {
    // In two steps: 2^k itself may overflow where the result does not.
    let half = (k * A::lit(t, 0.5)).floor();
    let value = of_remainder * half.pow2() * (k - half).pow2();
    let value = A::select(x.lt(A::lit(t, least)), A::lit(t, 0.0), value);
    A::select(A::lit(t, most).lt(x), A::lit(t, f64::INFINITY), value)
}

#[inline(always)]
pub(crate) fn exp_f32<A: Arith>(t: A::Token, x: A) -> A {
    let (least, most) = (-87.336_5, 88.722_83);
    let held = x.max(A::lit(t, least)).min(A::lit(t, most));
    let k = nearest(t, held * A::lit(t, core::f64::consts::LOG2_E));
    let r = reduced(t, held, k, [0.693_359_375, -2.121_944_4e-4, 0.0]);
    let p = polynomial(
        t,
        r,
        [
            5.000_000_120_1e-1,
            1.666_666_545_9e-1,
            4.166_579_589_4e-2,
            8.333_451_907_3e-3,
            1.398_199_950_7e-3,
            1.987_569_150_0e-4,
        ],
    );
    let value = p.mul_add(r * r, r) + A::lit(t, 1.0);
    scaled(t, x, (least, most), k, value)
}

#[inline(always)]
pub(crate) fn exp_f64<A: Arith>(t: A::Token, x: A) -> A {
    let (least, most) = (-708.396, 709.782_712_893_384);
    let held = x.max(A::lit(t, least)).min(A::lit(t, most));
    let k = nearest(t, held * A::lit(t, core::f64::consts::LOG2_E));
    let r = reduced(t, held, k, [6.931_457_519_531_25e-1, 1.428_606_820_309_417_2e-6, 0.0]);
    let z = r * r;
    let p = polynomial(
        t,
        z,
        [9.999_999_999_999_999_1e-1, 3.029_944_077_074_419_61e-2, 1.261_771_930_748_105_91e-4],
    ) * r;
    let q = polynomial(
        t,
        z,
        [2.0, 2.272_655_482_081_550_29e-1, 2.524_483_403_496_841_04e-3, 3.001_985_051_386_644_55e-6],
    );
    let value = (p / (q - p)).mul_add(A::lit(t, 2.0), A::lit(t, 1.0));
    scaled(t, x, (least, most), k, value)
}

/// Numerator and denominator of a quotient in [−tan π/8, tan π/8] whose arc tangent, plus π/4 where the mask is set, is the
/// angle of the point (|x|, |y|) from the nearer axis.
#[inline(always)]
fn octant<A: Arith>(t: A::Token, y: A, x: A) -> (A, A, A::Mask) {
    let (a, b) = (y.abs(), x.abs());
    let (low, high) = (a.min(b), a.max(b));
    let wide = (high * A::lit(t, 0.414_213_562_373_095)).lt(low);
    let high = A::select(high.le(A::lit(t, 0.0)), A::lit(t, 1.0), high);
    (A::select(wide, low - high, low), A::select(wide, low + high, high), wide)
}

/// Angle of a point from its angle within the octant; π is `pi.0 + pi.1`. The sign of a zero is ignored: the angle of (−1,
/// −0) is π.
#[inline(always)]
fn of_octant<A: Arith>(t: A::Token, y: A, x: A, wide: A::Mask, angle: A, pi: (f64, f64)) -> A {
    let zero = A::lit(t, 0.0);
    let quarter = A::lit(t, 0.25 * pi.0) + (angle + A::lit(t, 0.25 * pi.1));
    let angle = A::select(wide, quarter, angle);
    let steep = x.abs().lt(y.abs());
    let turned = A::lit(t, 0.5 * pi.0) - (angle - A::lit(t, 0.5 * pi.1));
    let angle = A::select(steep, turned, angle);
    let back = A::lit(t, pi.0) - (angle - A::lit(t, pi.1));
    let angle = A::select(x.lt(zero), back, angle);
    let angle = A::select(y.lt(zero), -angle, angle);
    A::select(x.le(x), angle, x)
}

#[inline(always)]
pub(crate) fn atan2_f32<A: Arith>(t: A::Token, y: A, x: A) -> A {
    let (above, below, wide) = octant(t, y, x);
    let r = above / below;
    let z = r * r;
    let p = polynomial(
        t,
        z,
        [-3.333_294_915_39e-1, 1.997_771_064_78e-1, -1.387_768_560_32e-1, 8.053_744_495_38e-2],
    );
    let pi = core::f32::consts::PI as f64;
    of_octant(t, y, x, wide, (p * z).mul_add(r, r), (pi, core::f64::consts::PI - pi))
}

#[inline(always)]
pub(crate) fn atan2_f64<A: Arith>(t: A::Token, y: A, x: A) -> A {
    let (above, below, wide) = octant(t, y, x);
    let r = above / below;
    let z = r * r;
    let p = polynomial(
        t,
        z,
        [
            -6.485_021_904_942_025_37e1,
            -1.228_866_684_490_136_17e2,
            -7.500_855_792_314_704_67e1,
            -1.615_753_718_733_365_08e1,
            -8.750_608_600_031_904_12e-1,
        ],
    );
    let q = polynomial(
        t,
        z,
        [
            1.945_506_571_482_613_96e2,
            4.853_903_996_359_136_96e2,
            4.328_810_604_912_902_67e2,
            1.650_270_098_316_988_54e2,
            2.485_846_490_142_306_30e1,
            1.0,
        ],
    );
    // Rounding error of π as f64.
    of_octant(t, y, x, wide, (p * z / q).mul_add(r, r), (core::f64::consts::PI, 1.224_646_799_147_353_2e-16))
}

#[inline(always)]
fn pow2_f32<S: Simd>(k: f32x16<S>) -> f32x16<S> {
    let whole: i32x16<S> = k.simd.cvt_i32_f32x16(k + 127.0);
    (whole << 23).bitcast()
}

#[inline(always)]
fn pow2_f64<S: Simd>(k: f64x8<S>) -> f64x8<S> {
    let whole: i64x8<S> = k.simd.cvt_i64_f64x8(k + 1023.0);
    (whole << 52).bitcast()
}

/// SIMD level of the processor, detected once.
pub fn level() -> Level {
    static LEVEL: OnceLock<Level> = OnceLock::new();
    *LEVEL.get_or_init(Level::new)
}

/// Name of [`level`], for reports: `Avx512`, `Avx2`, `Sse4_2`, `Sse2`, `Neon`.
pub fn level_name() -> String {
    let text = format!("{:?}", level());
    text.split('(').next().unwrap_or_default().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Functions whose errors the table at the top of this file states.
    #[derive(Clone, Copy, Debug, PartialEq)]
    enum What {
        Sin,
        Cos,
        Exp,
        Atan2,
        TurnSin,
        TurnCos,
    }

    #[inline(always)]
    fn run<A: Arith>(t: A::Token, what: What, x: &A::Cell, y: &A::Cell, out: &mut A::Cell) {
        let (x, y) = (A::load(t, x), A::load(t, y));
        let value = match what {
            What::Sin => x.sin_cos().0,
            What::Cos => x.sin_cos().1,
            What::Exp => x.exp(),
            What::Atan2 => y.atan2(x),
            What::TurnSin => x.half_turn().0,
            What::TurnCos => x.half_turn().1,
        };
        value.store(out);
    }

    /// The lanes of a number type at one SIMD level.
    trait Lanes: Number {
        fn apply(level: Level, what: What, x: &Self::Cell, y: &Self::Cell, out: &mut Self::Cell);
        /// Distance between this number of magnitude |v| and the next.
        fn ulp(v: f64) -> f64;
    }
    impl Lanes for f32 {
        fn apply(level: Level, what: What, x: &F32x16, y: &F32x16, out: &mut F32x16) {
            dispatch!(level, simd => run::<f32x16<_>>(simd, what, x, y, out));
        }
        fn ulp(v: f64) -> f64 {
            let v = (v.abs() as f32).max(f32::MIN_POSITIVE);
            f64::from(f32::from_bits(v.to_bits() + 1) - v)
        }
    }
    impl Lanes for f64 {
        fn apply(level: Level, what: What, x: &F64x8, y: &F64x8, out: &mut F64x8) {
            dispatch!(level, simd => run::<f64x8<_>>(simd, what, x, y, out));
        }
        fn ulp(v: f64) -> f64 {
            let v = v.abs().max(f64::MIN_POSITIVE);
            f64::from_bits(v.to_bits() + 1) - v
        }
    }

    fn reference(what: What, x: f64, y: f64) -> f64 {
        match what {
            What::Sin => x.sin(),
            What::Cos => x.cos(),
            What::Exp => x.exp(),
            What::Atan2 => y.atan2(x),
            What::TurnSin if x < 1e-4 => 0.5 - x / 48.0 + x * x / 3840.0,
            What::TurnSin => (0.5 * x.sqrt()).sin() / x.sqrt(),
            What::TurnCos => (0.5 * x.sqrt()).cos(),
        }
    }

    /// Largest error in units of the last place of the result (of 1 for sine and cosine), and where.
    fn worst<N: Lanes>(level: Level, what: What, draw: impl Fn(&mut u64) -> (f64, f64)) -> (f64, f64, f64) {
        let mut seed = 7;
        let mut worst = (0.0, 0.0, 0.0);
        for _ in 0..20_000 {
            let mut x = N::Cell::splat(N::zero());
            let (mut y, mut out) = (x, x);
            for lane in 0..N::Cell::LANES {
                let (a, b) = draw(&mut seed);
                x.set(lane, N::of(a));
                y.set(lane, N::of(b));
            }
            N::apply(level, what, &x, &y, &mut out);
            for lane in 0..N::Cell::LANES {
                let (a, b) = (x.get(lane).wide(), y.get(lane).wide());
                let wanted = reference(what, a, b);
                let unit = match what {
                    What::Sin | What::Cos | What::TurnCos => N::ulp(1.0),
                    _ => N::ulp(wanted),
                };
                let off = (out.get(lane).wide() - wanted).abs() / unit;
                if off > worst.0 || off.is_nan() {
                    worst = (off, a, b);
                }
            }
        }
        worst
    }

    fn uniform(seed: &mut u64) -> f64 {
        *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*seed >> 11) as f64 / (1u64 << 53) as f64
    }

    fn levels() -> Vec<Level> {
        let mut out = vec![level()];
        #[cfg(target_arch = "x86_64")]
        {
            out.extend(level().as_avx2().map(Level::Avx2));
            out.extend(level().as_sse2().map(Level::Sse2));
        }
        out
    }

    fn check<N: Lanes>(what: What, bound: f64, draw: impl Fn(&mut u64) -> (f64, f64) + Copy) {
        for level in levels() {
            let (off, x, y) = worst::<N>(level, what, draw);
            println!("{} {what:?} {level:?}: {off:.2}", N::NAME);
            assert!(
                off <= bound,
                "{} {what:?} of ({x:e}, {y:e}) is off by {off} units on {level:?}",
                N::NAME
            );
        }
    }

    #[test]
    fn functions_of_lanes_are_as_exact_as_stated() {
        let small = |s: &mut u64| (8.0 * uniform(s) - 4.0, 0.0);
        let wide = |s: &mut u64| (20_000.0 * uniform(s) - 10_000.0, 0.0);
        for what in [What::Sin, What::Cos] {
            check::<f32>(what, 1.0, small);
            check::<f64>(what, 1.0, small);
            check::<f32>(what, 1.0, wide);
            check::<f64>(what, 1.0, wide);
        }
        check::<f32>(What::Exp, 2.0, |s| (170.0 * uniform(s) - 85.0, 0.0));
        check::<f64>(What::Exp, 2.0, |s| (1400.0 * uniform(s) - 700.0, 0.0));
        let point = |s: &mut u64| {
            let size = 10f64.powf(8.0 * uniform(s) - 4.0);
            (size * (2.0 * uniform(s) - 1.0), 2.0 * uniform(s) - 1.0)
        };
        check::<f32>(What::Atan2, 3.0, point);
        check::<f64>(What::Atan2, 3.0, point);
        let near = |s: &mut u64| (4.2 * uniform(s), 0.0);
        let far = |s: &mut u64| (100.0 * uniform(s), 0.0);
        for what in [What::TurnSin, What::TurnCos] {
            check::<f32>(what, 2.0, near);
            check::<f64>(what, 2.0, near);
        }
        check::<f32>(What::TurnCos, 4.0, far);
        check::<f64>(What::TurnCos, 4.0, far);
    }

    fn one<N: Lanes>(what: What, x: f64, y: f64) -> f64 {
        let mut out = N::Cell::splat(N::zero());
        N::apply(level(), what, &N::Cell::splat(N::of(x)), &N::Cell::splat(N::of(y)), &mut out);
        out.get(0).wide()
    }

    fn special<N: Lanes>() {
        let inf = f64::INFINITY;
        assert_eq!((one::<N>(What::Exp, 0.0, 0.0), one::<N>(What::Exp, -1e4, 0.0)), (1.0, 0.0));
        assert_eq!((one::<N>(What::Exp, inf, 0.0), one::<N>(What::Exp, -inf, 0.0)), (inf, 0.0));
        assert_eq!((one::<N>(What::Sin, 0.0, 0.0), one::<N>(What::Cos, 0.0, 0.0)), (0.0, 1.0));
        assert_eq!((one::<N>(What::TurnSin, 0.0, 0.0), one::<N>(What::TurnCos, 0.0, 0.0)), (0.5, 1.0));
        let pi = N::of(core::f64::consts::PI).wide();
        for (x, y, angle) in [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (-1.0, 0.0, pi), (0.0, 2.0, 0.5 * pi)] {
            assert_eq!(one::<N>(What::Atan2, x, y), angle, "{x} {y}");
        }
        assert_eq!(one::<N>(What::Atan2, 0.0, -2.0), -0.5 * pi);
        for what in [What::Sin, What::Cos, What::Exp, What::Atan2, What::TurnSin, What::TurnCos] {
            assert!(one::<N>(what, f64::NAN, 1.0).is_nan(), "{what:?}");
        }
        assert!(one::<N>(What::Sin, inf, 0.0).is_nan() && one::<N>(What::TurnCos, inf, 0.0).is_nan());
    }

    #[test]
    fn special_numbers_are_right_and_what_is_none_stays_none() {
        special::<f32>();
        special::<f64>();
    }

    #[test]
    fn a_constant_that_f32_cannot_tell_from_zero_stays_above_it() {
        #[inline(always)]
        fn of<S: Simd>(simd: S, out: &mut [f32; 2]) {
            *out = [<f32x16<S> as Arith>::lit(simd, 1e-300)[0], <f32x16<S> as Arith>::lit(simd, -1e-300)[0]];
        }
        let mut out = [0.0; 2];
        dispatch!(level(), simd => of(simd, &mut out));
        assert_eq!(out, [f32::MIN_POSITIVE, -f32::MIN_POSITIVE]);
    }
}
