//! Numbers of flight physics, and the compiler that traces formulas over them.
//!
//! A formula is written once over the number trait [`Real`], which the reference (`f64`), throughput (`f32`, [`lanes`]),
//! derivatives ([`dual::Dual`]) and traces ([`trace::Sym`]) all implement. A trace is a graph ([`trace::Graph`]); [`schedule`]
//! schedules it, [`adjoint`] turns it into that of its derivatives, [`export`] prints it as Rust (a [`kernel::Kernel`]), and
//! [`bytecode`] runs what has no kernel, [`formula`] runs what carries no state. [`math`] builds vectors and rotations of numbers,
//! [`params`] makes structs of them that can be visited by name, [`mlp`] holds small networks, [`units`] converts those of files,
//! [`names`] guesses what a mistyped one means.
//!
//! Published scalar traits require `PartialOrd` or `bool`, which a lane, a tape or a symbol cannot provide. Here a
//! comparison returns a [`Real::Mask`] and a choice is [`Real::select`], so a formula written over `Real` contains no
//! branch.

#![forbid(unsafe_code)]

use core::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Not, Sub};

pub mod adjoint;
pub mod bytecode;
pub mod dense;
pub mod dual;
pub mod export;
pub mod formula;
pub mod kernel;
pub mod lanes;
pub mod math;
pub mod mlp;
pub mod names;
pub mod params;
pub mod program;
mod rows;
pub mod schedule;
pub mod trace;
pub mod units;

/// A real number for flight physics.
pub trait Real:
    Copy
    + core::fmt::Debug
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + 'static
{
    /// Result of a comparison: `bool`, a lane mask, or a graph node.
    type Mask: Copy + BitAnd<Output = Self::Mask> + BitOr<Output = Self::Mask> + Not<Output = Self::Mask>;

    /// A literal constant.
    fn lit(v: f64) -> Self;
    /// Square root.
    fn sqrt(self) -> Self;
    /// Sine and cosine of an angle in radians.
    fn sin_cos(self) -> (Self, Self);
    /// `e^self`.
    fn exp(self) -> Self;
    /// Angle of the point (`x`, `self`) in radians, in (−π, π].
    fn atan2(self, x: Self) -> Self;
    /// Largest integer not above `self`.
    fn floor(self) -> Self;
    /// `self < other`.
    fn lt(self, other: Self) -> Self::Mask;
    /// `self <= other`.
    fn le(self, other: Self) -> Self::Mask;
    /// `yes` where `mask` holds, else `no`. Both sides are computed.
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self;

    /// sin(θ/2)/θ and cos(θ/2) of a squared angle θ², rad²: the quaternion parts of a rotation vector of that length.
    ///
    /// Below an angle of 1e-3 rad the series to θ⁴ is used (error below 1e-22), so value and derivative are exact at
    /// zero. (Grassia, "Practical parameterization of rotations using the exponential map", J. Graphics Tools 3(3), 1998.)
    #[inline(always)]
    fn half_turn(self) -> (Self, Self) {
        half_turn_by_root(self)
    }

    /// Zero.
    #[inline(always)]
    fn zero() -> Self {
        Self::lit(0.0)
    }
    /// One.
    #[inline(always)]
    fn one() -> Self {
        Self::lit(1.0)
    }
    /// `self > other`.
    #[inline(always)]
    fn gt(self, other: Self) -> Self::Mask {
        other.lt(self)
    }
    /// Magnitude.
    #[inline(always)]
    fn abs(self) -> Self {
        Self::select(self.lt(Self::zero()), -self, self)
    }
    /// The smaller of two numbers.
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self::select(other.lt(self), other, self)
    }
    /// The larger of two numbers.
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self::select(self.lt(other), other, self)
    }
    /// Clamps `self` to `[low, high]`.
    #[inline(always)]
    fn clamp(self, low: Self, high: Self) -> Self {
        self.max(low).min(high)
    }
    /// `self²`.
    #[inline(always)]
    fn square(self) -> Self {
        self * self
    }
}

/// [`Real::half_turn`] by root, sine and cosine.
#[inline(always)]
pub fn half_turn_by_root<S: Real>(t2: S) -> (S, S) {
    let small = t2.lt(S::lit(1e-6));
    let t = S::select(small, S::one(), t2).sqrt();
    let (sin, cos) = (t * S::lit(0.5)).sin_cos();
    let k_series = S::lit(0.5) - t2 * S::lit(1.0 / 48.0) + t2 * t2 * S::lit(1.0 / 3840.0);
    let c_series = S::one() - t2 * S::lit(1.0 / 8.0) + t2 * t2 * S::lit(1.0 / 384.0);
    (S::select(small, k_series, sin / t), S::select(small, c_series, cos))
}

macro_rules! impl_real_for_float {
    ($float:ident) => {
        impl Real for $float {
            type Mask = bool;
            #[inline(always)]
            fn lit(v: f64) -> Self {
                v as $float
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                $float::sqrt(self)
            }
            #[inline(always)]
            fn sin_cos(self) -> (Self, Self) {
                $float::sin_cos(self)
            }
            #[inline(always)]
            fn exp(self) -> Self {
                $float::exp(self)
            }
            #[inline(always)]
            fn atan2(self, x: Self) -> Self {
                $float::atan2(self, x)
            }
            #[inline(always)]
            fn floor(self) -> Self {
                $float::floor(self)
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
    };
}

impl_real_for_float!(f64);
impl_real_for_float!(f32);
