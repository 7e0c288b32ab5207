//! Unit quaternions `[x, y, z, w]`, body to world.

use super::vec3;
use crate::Real;

/// No rotation.
#[inline(always)]
pub fn identity<S: Real>() -> [S; 4] {
    [S::zero(), S::zero(), S::zero(), S::one()]
}

/// Hamilton product `a ⊗ b`: rotate by `b`, then by `a`.
#[inline(always)]
pub fn mul<S: Real>(a: [S; 4], b: [S; 4]) -> [S; 4] {
    [
        a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
        a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
        a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
        a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
    ]
}

/// Conjugate: the inverse of a unit quaternion.
#[inline(always)]
pub fn conjugate<S: Real>(q: [S; 4]) -> [S; 4] {
    [-q[0], -q[1], -q[2], q[3]]
}

/// `q` scaled to unit length. A zero quaternion stays zero.
#[inline(always)]
pub fn normalize<S: Real>(q: [S; 4]) -> [S; 4] {
    let n2 = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
    let tiny = n2.lt(S::lit(1e-300));
    let inverse = S::one() / S::select(tiny, S::one(), n2).sqrt();
    [q[0] * inverse, q[1] * inverse, q[2] * inverse, q[3] * inverse]
}

/// `q`, which differs from unit length by rounding only, brought back to it: one step of Newton's method for 1/√(q·q), which
/// leaves ⅜ of the square of the error. Costs no root and no division. For anything else there is [`normalize`].
#[inline(always)]
pub fn renormalize<S: Real>(q: [S; 4]) -> [S; 4] {
    let n2 = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
    let k = S::lit(1.5) - S::lit(0.5) * n2;
    [q[0] * k, q[1] * k, q[2] * k, q[3] * k]
}

/// Rotation matrix (rows) of a unit quaternion.
#[inline(always)]
pub fn matrix<S: Real>(q: [S; 4]) -> [[S; 3]; 3] {
    let [x, y, z, w] = q;
    let (x2, y2, z2) = (x + x, y + y, z + z);
    let (xx, yy, zz) = (x2 * x, y2 * y, z2 * z);
    let (xy, xz, yz) = (x2 * y, x2 * z, y2 * z);
    let (xw, yw, zw) = (x2 * w, y2 * w, z2 * w);
    let one = S::one();
    [
        [one - (yy + zz), xy - zw, xz + yw],
        [xy + zw, one - (xx + zz), yz - xw],
        [xz - yw, yz + xw, one - (xx + yy)],
    ]
}

/// `v` turned from body to world.
#[inline(always)]
pub fn rotate<S: Real>(q: [S; 4], v: [S; 3]) -> [S; 3] {
    vec3::mat_vec(matrix(q), v)
}

/// `v` turned from world to body.
#[inline(always)]
pub fn rotate_inverse<S: Real>(q: [S; 4], v: [S; 3]) -> [S; 3] {
    vec3::mat_t_vec(matrix(q), v)
}

/// Quaternion of the rotation vector `r` (axis times angle, rad): the exponential map, exact in value and derivative at
/// zero; see [`Real::half_turn`].
#[inline(always)]
pub fn exp<S: Real>(r: [S; 3]) -> [S; 4] {
    let (k, c) = vec3::dot(r, r).half_turn();
    [r[0] * k, r[1] * k, r[2] * k, c]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dual::Dual;
    use proptest::prelude::*;

    fn vector() -> impl Strategy<Value = [f64; 3]> {
        prop::array::uniform3(-3.0..3.0f64)
    }

    proptest! {
        #[test]
        fn rotation_keeps_length_and_inverse_undoes_it(r in vector(), v in vector()) {
            let q = exp(r);
            let w = rotate(q, v);
            prop_assert!((vec3::dot(w, w) - vec3::dot(v, v)).abs() < 1e-12);
            let back = rotate_inverse(q, w);
            for i in 0..3 {
                prop_assert!((back[i] - v[i]).abs() < 1e-12);
            }
        }

        #[test]
        fn product_is_composition(a in vector(), b in vector(), v in vector()) {
            let (p, q) = (exp(a), exp(b));
            let (one, two) = (rotate(mul(p, q), v), rotate(p, rotate(q, v)));
            for i in 0..3 {
                prop_assert!((one[i] - two[i]).abs() < 1e-12);
            }
        }

        #[test]
        fn halves_compose_to_the_whole(r in vector()) {
            let h = exp(vec3::scale(r, 0.5));
            let (whole, twice) = (exp(r), mul(h, h));
            for i in 0..4 {
                prop_assert!((whole[i] - twice[i]).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn rounding_of_the_length_goes_and_the_direction_stays() {
        for off in [-1e-4, -1e-9, 3e-16, 1e-9, 1e-4] {
            let q = exp([0.3, -1.2, 0.7]);
            let long = q.map(|v| v * (1.0 + off));
            let back = renormalize(long);
            for i in 0..4 {
                assert!((back[i] - q[i]).abs() < 1.6 * off * off + 3e-16, "{off}: {back:?} is not {q:?}");
            }
        }
    }

    #[test]
    fn exp_is_exact_in_value_and_slope_on_both_sides_of_the_series() {
        for t in [0.0, 1e-9, 0.999e-3, 1.001e-3, 0.1] {
            let r = [Dual::<f64, 1>::input(t, 0), Dual::lit(0.0), Dual::lit(0.0)];
            let q = exp(r);
            assert!((q[0].value - (t / 2.0).sin()).abs() < 1e-16);
            assert!((q[0].partials[0] - 0.5 * (t / 2.0).cos()).abs() < 1e-13, "at {t}");
            assert!((q[3].partials[0] + 0.5 * (t / 2.0).sin()).abs() < 1e-13, "at {t}");
        }
    }
}
