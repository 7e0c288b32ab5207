//! What the shapes are written over: sixteen rays of f32 in lanes, or one ray in f64.
//!
//! Every function here and in the shapes is `#[inline(always)]`, loops over lanes are plain `for` loops, and no closure
//! stands between the entry that turns the processor's features on and the arithmetic: what is not inlined there is
//! compiled without those features and runs many times slower.

use std::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Not, Sub};

use fearless_simd::prelude::*;
use fearless_simd::{f32x16, mask32x16};

/// The number that one lane holds.
pub(crate) trait Real:
    Copy
    + PartialOrd
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
{
    /// It is f32.
    const IS_F32: bool;
    /// Rounds from f64.
    fn of(x: f64) -> Self;
    /// As f64.
    fn wide(self) -> f64;
}

impl Real for f32 {
    const IS_F32: bool = true;
    #[inline(always)]
    fn of(x: f64) -> Self {
        x as f32
    }
    #[inline(always)]
    fn wide(self) -> f64 {
        f64::from(self)
    }
}

impl Real for f64 {
    const IS_F32: bool = false;
    #[inline(always)]
    fn of(x: f64) -> Self {
        x
    }
    #[inline(always)]
    fn wide(self) -> f64 {
        self
    }
}

/// One number for each of several rays.
pub(crate) trait Lanes:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> + Neg<Output = Self>
{
    /// What a lane holds.
    type Real: Real;
    /// One bit for each lane.
    type Mask: Copy + BitAnd<Output = Self::Mask> + BitOr<Output = Self::Mask> + Not<Output = Self::Mask>;
    /// Number of lanes.
    const N: usize;

    /// The same number in all lanes.
    fn all(self, x: Self::Real) -> Self;
    /// self × by + plus, rounded once where the processor can.
    fn fma(self, by: Self, plus: Self) -> Self;
    fn sqrt(self) -> Self;
    fn abs(self) -> Self;
    fn min(self, other: Self) -> Self;
    fn max(self, other: Self) -> Self;
    fn lt(self, other: Self) -> Self::Mask;
    fn le(self, other: Self) -> Self::Mask;
    fn pick(mask: Self::Mask, yes: Self, no: Self) -> Self;
    fn any(mask: Self::Mask) -> bool;
    /// Lane 0 is the lowest bit.
    fn bits(mask: Self::Mask) -> u32;
    fn lane(self, k: usize) -> Self::Real;
    fn set(&mut self, k: usize, x: Self::Real);

    /// The number in all lanes, from f64.
    #[inline(always)]
    fn lit(self, x: f64) -> Self {
        self.all(Self::Real::of(x))
    }
}

impl<S: Simd> Lanes for f32x16<S> {
    type Real = f32;
    type Mask = mask32x16<S>;
    const N: usize = 16;

    #[inline(always)]
    fn all(self, x: f32) -> Self {
        Self::splat(self.simd, x)
    }
    #[inline(always)]
    fn fma(self, by: Self, plus: Self) -> Self {
        self.mul_add(by, plus)
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        SimdFloat::sqrt(self)
    }
    #[inline(always)]
    fn abs(self) -> Self {
        self.simd.abs_f32x16(self)
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.simd.min_f32x16(self, other)
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.simd.max_f32x16(self, other)
    }
    #[inline(always)]
    fn lt(self, other: Self) -> Self::Mask {
        self.simd.simd_lt_f32x16(self, other)
    }
    #[inline(always)]
    fn le(self, other: Self) -> Self::Mask {
        self.simd.simd_le_f32x16(self, other)
    }
    #[inline(always)]
    fn pick(mask: Self::Mask, yes: Self, no: Self) -> Self {
        mask.select(yes, no)
    }
    #[inline(always)]
    fn any(mask: Self::Mask) -> bool {
        mask.any_true()
    }
    #[inline(always)]
    fn bits(mask: Self::Mask) -> u32 {
        mask.to_bitmask() as u32
    }
    #[inline(always)]
    fn lane(self, k: usize) -> f32 {
        self[k]
    }
    #[inline(always)]
    fn set(&mut self, k: usize, x: f32) {
        self[k] = x;
    }
}

impl Lanes for f64 {
    type Real = f64;
    type Mask = bool;
    const N: usize = 1;

    #[inline(always)]
    fn all(self, x: f64) -> Self {
        x
    }
    #[inline(always)]
    fn fma(self, by: Self, plus: Self) -> Self {
        // Without a fused instruction in the target the fused form is a call into a library.
        self * by + plus
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        f64::sqrt(self)
    }
    #[inline(always)]
    fn abs(self) -> Self {
        f64::abs(self)
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        if self < other { self } else { other }
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        if self > other { self } else { other }
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
    fn pick(mask: bool, yes: Self, no: Self) -> Self {
        if mask { yes } else { no }
    }
    #[inline(always)]
    fn any(mask: bool) -> bool {
        mask
    }
    #[inline(always)]
    fn bits(mask: bool) -> u32 {
        u32::from(mask)
    }
    #[inline(always)]
    fn lane(self, _: usize) -> f64 {
        self
    }
    #[inline(always)]
    fn set(&mut self, _: usize, x: f64) {
        *self = x;
    }
}

/// No surface.
#[inline(always)]
pub(crate) fn none<L: Lanes>(like: L) -> L {
    like.lit(f64::INFINITY)
}

#[inline(always)]
pub(crate) fn dot<L: Lanes>(a: [L; 3], b: [L; 3]) -> L {
    a[2].fma(b[2], a[1].fma(b[1], a[0] * b[0]))
}

/// Scalar product of numbers that all rays share with numbers of each ray.
#[inline(always)]
pub(crate) fn dot_all<L: Lanes>(a: [L::Real; 3], b: [L; 3]) -> L {
    let like = b[0];
    like.all(a[2]).fma(b[2], like.all(a[1]).fma(b[1], like.all(a[0]) * b[0]))
}

/// A vector that all rays share × a vector of each ray.
#[inline(always)]
pub(crate) fn cross_all<L: Lanes>(a: [L::Real; 3], b: [L; 3]) -> [L; 3] {
    let like = b[0];
    [
        like.all(a[1]) * b[2] - like.all(a[2]) * b[1],
        like.all(a[2]) * b[0] - like.all(a[0]) * b[2],
        like.all(a[0]) * b[1] - like.all(a[1]) * b[0],
    ]
}

#[inline(always)]
pub(crate) fn cross<R: Real>(a: [R; 3], b: [R; 3]) -> [R; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[inline(always)]
pub(crate) fn sub<R: Real>(a: [R; 3], b: [R; 3]) -> [R; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Keeps a divisor away from zero without turning its sign.
#[inline(always)]
pub(crate) fn away_from_zero<L: Lanes>(x: L) -> L {
    let tiny = x.lit(1e-30);
    let zero = x.lit(0.0);
    L::pick(x.lt(zero), x.min(-tiny), x.max(tiny))
}
