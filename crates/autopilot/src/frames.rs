//! From our frames to those of flight stacks.
//!
//! Ours: world north-west-up, body forward-left-up. PX4 and ArduPilot: world north-east-down, body forward-right-down. The two differ by
//! half a turn about x, in the world and in the body, so that one function serves both.

/// A vector of our world in north-east-down, or one of our body in forward-right-down; and back.
pub fn turned<T: Copy + core::ops::Neg<Output = T>>(v: [T; 3]) -> [T; 3] {
    [v[0], -v[1], -v[2]]
}

/// Attitude w, x, y, z from forward-right-down to north-east-down, of one xyzw from our body to our world. With the half turn T on both
/// sides, T q T⁻¹, the parts along y and z change their signs. Of q and −q it is the one with w ≥ 0.
pub fn quat_wxyz_ned(q: [f64; 4]) -> [f64; 4] {
    let s = if q[3] < 0.0 { -1.0 } else { 1.0 };
    [s * q[3], s * q[0], -s * q[1], -s * q[2]]
}

/// Roll, pitch and yaw, rad, from forward-right-down to north-east-down (z-y′-x″), of an attitude w, x, y, z. Yaw counts from north to
/// the east.
pub fn euler([w, x, y, z]: [f64; 4]) -> [f64; 3] {
    [
        (2.0 * (w * x + y * z)).atan2(1.0 - 2.0 * (x * x + y * y)),
        (2.0 * (w * y - z * x)).clamp(-1.0, 1.0).asin(),
        (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z)),
    ]
}

/// Vectors as f32, which messages hold.
pub fn narrow<const N: usize>(v: [f64; N]) -> [f32; N] {
    v.map(|x| x as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use propwash_trace::math::quat;

    #[test]
    fn turning_the_attitude_turns_vectors_alike() {
        let q = quat::exp([0.3, -0.7, 1.9]);
        let body = [0.4, -1.2, 2.5];
        let expected = turned(quat::rotate(q, body));
        let [w, x, y, z] = quat_wxyz_ned(q);
        let found = quat::rotate([x, y, z, w], turned(body));
        assert!((0..3).all(|k| (expected[k] - found[k]).abs() < 1e-12), "{expected:?} {found:?}");
    }

    #[test]
    fn angles_are_those_of_a_pilot() {
        let degrees = |r: [f64; 3]| euler(quat_wxyz_ned(quat::exp(r))).map(f64::to_degrees);
        // About our x: the right side goes down.
        assert!((degrees([0.2, 0.0, 0.0])[0] - 0.2f64.to_degrees()).abs() < 1e-9);
        // About our y, to the left: the nose goes down.
        assert!((degrees([0.0, 0.2, 0.0])[1] + 0.2f64.to_degrees()).abs() < 1e-9);
        // About our z, up: the nose goes to the west.
        assert!((degrees([0.0, 0.0, 0.2])[2] + 0.2f64.to_degrees()).abs() < 1e-9);
        assert_eq!(quat_wxyz_ned([0.0, 0.0, 0.0, -1.0])[0], 1.0);
    }
}
