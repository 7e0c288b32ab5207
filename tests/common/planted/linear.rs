//! Vectors, quaternions (xyzw) and matrices of plain f64, written here so that nothing is shared with the code under test.

/// Three numbers.
pub type V = [f64; 3];
/// A quaternion, xyzw.
pub type Q = [f64; 4];
/// A matrix of three rows.
pub type M = [V; 3];

/// a + b.
pub fn add(a: V, b: V) -> V {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// a − b.
pub fn sub(a: V, b: V) -> V {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// k a.
pub fn mul(a: V, k: f64) -> V {
    [a[0] * k, a[1] * k, a[2] * k]
}

/// a · b.
pub fn dot(a: V, b: V) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// a × b.
pub fn cross(a: V, b: V) -> V {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// |a|.
pub fn norm(a: V) -> f64 {
    dot(a, a).sqrt()
}

/// a / |a|, or zero.
pub fn unit(a: V) -> V {
    let n = norm(a);
    if n > 0.0 { mul(a, 1.0 / n) } else { a }
}

/// The product of two rotations.
pub fn quat_mul(a: Q, b: Q) -> Q {
    let (av, bv) = ([a[0], a[1], a[2]], [b[0], b[1], b[2]]);
    let v = add(add(mul(bv, a[3]), mul(av, b[3])), cross(av, bv));
    [v[0], v[1], v[2], a[3] * b[3] - dot(av, bv)]
}

/// The quaternion of length one.
pub fn quat_unit(q: Q) -> Q {
    let n = (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]).sqrt();
    [q[0] / n, q[1] / n, q[2] / n, q[3] / n]
}

/// The rotation by a rotation vector, rad.
pub fn quat_exp(r: V) -> Q {
    let angle = norm(r);
    let k = if angle > 1e-9 { (0.5 * angle).sin() / angle } else { 0.5 };
    quat_unit([k * r[0], k * r[1], k * r[2], (0.5 * angle).cos()])
}

/// The matrix of a rotation.
pub fn matrix(q: Q) -> M {
    let [x, y, z, w] = q;
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

/// M a.
pub fn mat_vec(m: M, a: V) -> V {
    [dot(m[0], a), dot(m[1], a), dot(m[2], a)]
}

/// Mᵀ a.
pub fn mat_t_vec(m: M, a: V) -> V {
    add(add(mul(m[0], a[0]), mul(m[1], a[1])), mul(m[2], a[2]))
}

/// The inverse by cofactors.
pub fn inverse(m: M) -> M {
    let (a, b, c) = (cross(m[1], m[2]), cross(m[2], m[0]), cross(m[0], m[1]));
    let k = 1.0 / dot(m[0], a);
    [[a[0] * k, b[0] * k, c[0] * k], [a[1] * k, b[1] * k, c[1] * k], [a[2] * k, b[2] * k, c[2] * k]]
}

/// The solution of four linear equations by elimination with row exchange; `None` where they are dependent.
pub fn solve4(mut a: [[f64; 4]; 4], mut b: [f64; 4]) -> Option<[f64; 4]> {
    for k in 0..4 {
        let pivot = (k..4).max_by(|i, j| a[*i][k].abs().total_cmp(&a[*j][k].abs()))?;
        a.swap(k, pivot);
        b.swap(k, pivot);
        if a[k][k].abs() < 1e-12 {
            return None;
        }
        for i in k + 1..4 {
            let f = a[i][k] / a[k][k];
            for j in k..4 {
                a[i][j] -= f * a[k][j];
            }
            b[i] -= f * b[k];
        }
    }
    for k in (0..4).rev() {
        for j in k + 1..4 {
            b[k] -= a[k][j] * b[j];
        }
        b[k] /= a[k][k];
    }
    Some(b)
}
