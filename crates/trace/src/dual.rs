//! Forward-mode derivatives: a value and its partial derivatives with respect to `N` inputs.

use super::Real;
use core::ops::{Add, Div, Mul, Neg, Sub};

/// A value with `N` partial derivatives. Running any function that is generic over [`Real`] on duals gives its
/// exact Jacobian, one column per seeded input.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dual<S, const N: usize> {
    /// The value.
    pub value: S,
    /// Partial derivatives of the value with respect to the `N` seeded inputs.
    pub partials: [S; N],
}

impl<S: Real, const N: usize> Dual<S, N> {
    /// Seeds the `index`-th input: its derivative with respect to itself is one.
    pub fn input(value: S, index: usize) -> Self {
        let mut partials = [S::zero(); N];
        partials[index] = S::one();
        Self { value, partials }
    }

    /// Chain rule for `f(self)`, with `value = f(v)` and `slope = f'(v)`.
    #[inline(always)]
    fn chain(self, value: S, slope: S) -> Self {
        let mut partials = self.partials;
        for p in &mut partials {
            *p = *p * slope;
        }
        Self { value, partials }
    }

    /// `value` with the partials `a·self' + b·other'`.
    #[inline(always)]
    fn combine(self, other: Self, value: S, a: S, b: S) -> Self {
        let mut partials = self.partials;
        for i in 0..N {
            partials[i] = a * self.partials[i] + b * other.partials[i];
        }
        Self { value, partials }
    }
}

impl<S: Real, const N: usize> Add for Dual<S, N> {
    type Output = Self;
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        self.combine(o, self.value + o.value, S::one(), S::one())
    }
}

impl<S: Real, const N: usize> Sub for Dual<S, N> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, o: Self) -> Self {
        self.combine(o, self.value - o.value, S::one(), -S::one())
    }
}

impl<S: Real, const N: usize> Mul for Dual<S, N> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, o: Self) -> Self {
        self.combine(o, self.value * o.value, o.value, self.value)
    }
}

impl<S: Real, const N: usize> Div for Dual<S, N> {
    type Output = Self;
    #[inline(always)]
    fn div(self, o: Self) -> Self {
        let inverse = S::one() / o.value;
        let value = self.value / o.value;
        self.combine(o, value, inverse, -value * inverse)
    }
}

impl<S: Real, const N: usize> Neg for Dual<S, N> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.chain(-self.value, -S::one())
    }
}

impl<S: Real, const N: usize> Real for Dual<S, N> {
    type Mask = S::Mask;

    fn lit(v: f64) -> Self {
        Self { value: S::lit(v), partials: [S::zero(); N] }
    }
    fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        self.chain(root, S::lit(0.5) / root)
    }
    fn sin_cos(self) -> (Self, Self) {
        let (sin, cos) = self.value.sin_cos();
        (self.chain(sin, cos), self.chain(cos, -sin))
    }
    fn exp(self) -> Self {
        let e = self.value.exp();
        self.chain(e, e)
    }
    fn atan2(self, x: Self) -> Self {
        let norm2 = self.value * self.value + x.value * x.value;
        self.combine(x, self.value.atan2(x.value), x.value / norm2, -self.value / norm2)
    }
    fn floor(self) -> Self {
        self.chain(self.value.floor(), S::zero())
    }
    fn lt(self, other: Self) -> S::Mask {
        self.value.lt(other.value)
    }
    fn le(self, other: Self) -> S::Mask {
        self.value.le(other.value)
    }
    fn select(mask: S::Mask, yes: Self, no: Self) -> Self {
        let mut partials = yes.partials;
        for i in 0..N {
            partials[i] = S::select(mask, yes.partials[i], no.partials[i]);
        }
        Self { value: S::select(mask, yes.value, no.value), partials }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_operation_has_the_slope_of_its_finite_difference() {
        type D = Dual<f64, 2>;
        let f: [fn(D, D) -> D; 10] = [
            |a, b| a + b,
            |a, b| a - b,
            |a, b| a * b,
            |a, b| a / b,
            |a, _| -a,
            |a, _| a.sqrt(),
            |a, b| a.sin_cos().0 * b.sin_cos().1,
            |a, _| a.exp(),
            |a, b| a.atan2(b),
            |a, b| D::select(a.lt(b), a * a, b * b * b).abs(),
        ];
        let h = 1e-6;
        for (k, f) in f.iter().enumerate() {
            for (a, b) in [(0.3, 1.7), (2.1, 0.4), (1.2, 1.3)] {
                let exact = f(D::input(a, 0), D::input(b, 1)).partials;
                let at = |a: f64, b: f64| f(D::lit(a), D::lit(b)).value;
                let fd =
                    [(at(a + h, b) - at(a - h, b)) / (2.0 * h), (at(a, b + h) - at(a, b - h)) / (2.0 * h)];
                for i in 0..2 {
                    assert!((exact[i] - fd[i]).abs() < 1e-7, "operation {k}: {exact:?} against {fd:?}");
                }
            }
        }
    }
}
