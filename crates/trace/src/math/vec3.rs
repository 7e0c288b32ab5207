//! Three-vectors and 3×3 matrices.

use crate::Real;

/// `a + b`.
#[inline(always)]
pub fn add<S: Real>(a: [S; 3], b: [S; 3]) -> [S; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// `a − b`.
#[inline(always)]
pub fn sub<S: Real>(a: [S; 3], b: [S; 3]) -> [S; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// `a · s`.
#[inline(always)]
pub fn scale<S: Real>(a: [S; 3], s: S) -> [S; 3] {
    [a[0] * s, a[1] * s, a[2] * s]
}

/// Elementwise product.
#[inline(always)]
pub fn mul<S: Real>(a: [S; 3], b: [S; 3]) -> [S; 3] {
    [a[0] * b[0], a[1] * b[1], a[2] * b[2]]
}

/// Inner product.
#[inline(always)]
pub fn dot<S: Real>(a: [S; 3], b: [S; 3]) -> S {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Cross product `a × b`.
#[inline(always)]
pub fn cross<S: Real>(a: [S; 3], b: [S; 3]) -> [S; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Length, with a zero (not infinite) slope at the origin.
#[inline(always)]
pub fn norm<S: Real>(a: [S; 3]) -> S {
    let n2 = dot(a, a);
    let tiny = n2.lt(S::lit(MIN_NORM2));
    S::select(tiny, S::zero(), S::select(tiny, S::one(), n2).sqrt())
}

/// `a` divided by its length; `fallback` where the length is below 1e-150.
#[inline(always)]
pub fn normalize_or<S: Real>(a: [S; 3], fallback: [S; 3]) -> [S; 3] {
    let n2 = dot(a, a);
    let tiny = n2.lt(S::lit(MIN_NORM2));
    let inverse = S::one() / S::select(tiny, S::one(), n2).sqrt();
    let mut out = fallback;
    for i in 0..3 {
        out[i] = S::select(tiny, fallback[i], a[i] * inverse);
    }
    out
}

/// Squared length below which a vector counts as zero: far below any physical length, far above underflow.
const MIN_NORM2: f64 = 1e-300;

/// Matrix times vector, `m` given by rows.
#[inline(always)]
pub fn mat_vec<S: Real>(m: [[S; 3]; 3], v: [S; 3]) -> [S; 3] {
    [dot(m[0], v), dot(m[1], v), dot(m[2], v)]
}

/// Transposed matrix times vector.
#[inline(always)]
pub fn mat_t_vec<S: Real>(m: [[S; 3]; 3], v: [S; 3]) -> [S; 3] {
    [
        m[0][0] * v[0] + m[1][0] * v[1] + m[2][0] * v[2],
        m[0][1] * v[0] + m[1][1] * v[1] + m[2][1] * v[2],
        m[0][2] * v[0] + m[1][2] * v[1] + m[2][2] * v[2],
    ]
}

/// Inverse by the adjugate. The caller guarantees that `m` is regular (an inertia matrix is).
#[inline(always)]
pub fn inverse<S: Real>(m: [[S; 3]; 3]) -> [[S; 3]; 3] {
    let c0 = cross(m[1], m[2]);
    let c1 = cross(m[2], m[0]);
    let c2 = cross(m[0], m[1]);
    let inverse_det = S::one() / dot(m[0], c0);
    let mut out = m;
    for i in 0..3 {
        out[i] = [c0[i] * inverse_det, c1[i] * inverse_det, c2[i] * inverse_det];
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverse_times_matrix_is_identity() {
        let m = [[2.0, 0.3, -0.1], [0.3, 1.5, 0.2], [-0.1, 0.2, 3.0]];
        let inv = inverse(m);
        for i in 0..3 {
            let column = mat_vec(m, [inv[0][i], inv[1][i], inv[2][i]]);
            for j in 0..3 {
                assert!((column[j] - f64::from(u8::from(i == j))).abs() < 1e-15);
            }
        }
    }

    #[test]
    fn norm_has_a_finite_slope_at_zero() {
        use crate::dual::Dual;
        let v = [Dual::<f64, 3>::input(0.0, 0), Dual::input(0.0, 1), Dual::input(0.0, 2)];
        let n = norm(v);
        assert_eq!((n.value, n.partials), (0.0, [0.0; 3]));
        assert_eq!(normalize_or(v, [Real::zero(), Real::zero(), Real::one()])[2].value, 1.0);
    }
}
