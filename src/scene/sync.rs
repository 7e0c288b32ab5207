//! Plain poses to MuJoCo's arrays and back. The only place where quaternions change from x, y, z, w to w, x, y, z.

use super::SceneError;
pub use crate::geometry::Pose;

/// Largest coordinate that is taken, m. MuJoCo itself calls a state beyond 1e10 bad.
pub const MAX_COORDINATE_M: f64 = 1e9;

/// x, y, z, w → w, x, y, z.
#[inline]
pub(crate) fn to_wxyz(q: [f64; 4]) -> [f64; 4] {
    [q[3], q[0], q[1], q[2]]
}

/// w, x, y, z → x, y, z, w.
#[inline]
pub(crate) fn from_wxyz(q: [f64; 4]) -> [f64; 4] {
    [q[1], q[2], q[3], q[0]]
}

/// A pose (position, m; quaternion x, y, z, w of any length but zero) with a unit quaternion; `who` names it in the error.
///
/// # Errors
/// [`SceneError::BadPose`] for NaN, infinities, coordinates beyond [`MAX_COORDINATE_M`] and quaternions shorter than 1e-6.
pub fn checked(who: impl Fn() -> String, pos: [f64; 3], quat_xyzw: [f64; 4]) -> Result<Pose, SceneError> {
    if pos.iter().any(|x| !x.is_finite() || x.abs() > MAX_COORDINATE_M) {
        return Err(SceneError::BadPose { who: who(), what: format!("position {pos:?} m") });
    }
    let n = quat_xyzw.iter().map(|x| x * x).sum::<f64>().sqrt();
    if !n.is_finite() || n < 1e-6 {
        return Err(SceneError::BadPose { who: who(), what: format!("quaternion {quat_xyzw:?}") });
    }
    // A quaternion that is already of unit length is passed on bit by bit.
    if (n - 1.0).abs() < 1e-15 {
        return Ok(Pose { pos_m: pos, quat_xyzw });
    }
    Ok(Pose { pos_m: pos, quat_xyzw: quat_xyzw.map(|x| x / n) })
}

/// Quaternion x, y, z, w of a rotation matrix (row major, 9 numbers).
pub(crate) fn quat_of_matrix(m: &[f64; 9]) -> [f64; 4] {
    // Shepperd, "Quaternion from rotation matrix", J. Guidance and Control 1(3), 1978: take the largest component.
    let trace = m[0] + m[4] + m[8];
    let (x, y, z, w);
    if trace >= m[0] && trace >= m[4] && trace >= m[8] {
        w = 1.0 + trace;
        x = m[7] - m[5];
        y = m[2] - m[6];
        z = m[3] - m[1];
    } else if m[0] >= m[4] && m[0] >= m[8] {
        w = m[7] - m[5];
        x = 1.0 + m[0] - m[4] - m[8];
        y = m[1] + m[3];
        z = m[2] + m[6];
    } else if m[4] >= m[8] {
        w = m[2] - m[6];
        x = m[1] + m[3];
        y = 1.0 - m[0] + m[4] - m[8];
        z = m[5] + m[7];
    } else {
        w = m[3] - m[1];
        x = m[2] + m[6];
        y = m[5] + m[7];
        z = 1.0 - m[0] - m[4] + m[8];
    }
    let n = (w * w + x * x + y * y + z * z).sqrt();
    let s = if w < 0.0 { -n } else { n };
    [x / s, y / s, z / s, w / s]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::quat;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_quaternion_survives_the_matrix(q in prop::array::uniform4(-1.0..1.0f64)) {
            prop_assume!(q.iter().map(|x| x * x).sum::<f64>() > 1e-3);
            let q = quat::normalize(q);
            let q = if q[3] < 0.0 { q.map(|x| -x) } else { q };
            let m = quat::matrix(q);
            let flat = [m[0][0], m[0][1], m[0][2], m[1][0], m[1][1], m[1][2], m[2][0], m[2][1], m[2][2]];
            let back = quat_of_matrix(&flat);
            let same = (0..4).all(|i| (back[i] - q[i]).abs() < 1e-12);
            // w = 0 leaves the sign open.
            let mirrored = q[3].abs() < 1e-9 && (0..4).all(|i| (back[i] + q[i]).abs() < 1e-6);
            prop_assert!(same || mirrored, "{q:?} {back:?}");
        }
    }

    #[test]
    fn order_changes_and_returns() {
        assert_eq!(to_wxyz([1.0, 2.0, 3.0, 4.0]), [4.0, 1.0, 2.0, 3.0]);
        assert_eq!(from_wxyz(to_wxyz([1.0, 2.0, 3.0, 4.0])), [1.0, 2.0, 3.0, 4.0]);
    }

    #[test]
    fn bad_poses_are_refused_with_the_name_and_the_number() {
        let who = || "drone 3".to_string();
        for (pos, quat) in [
            ([f64::NAN, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]),
            ([0.0, f64::INFINITY, 0.0], [0.0, 0.0, 0.0, 1.0]),
            ([0.0, 2e9, 0.0], [0.0, 0.0, 0.0, 1.0]),
            ([0.0; 3], [0.0; 4]),
            ([0.0; 3], [f64::NAN, 0.0, 0.0, 1.0]),
        ] {
            let message = checked(who, pos, quat).unwrap_err().to_string();
            assert!(message.contains("drone 3"), "{message}");
        }
        let pose = checked(who, [1.0, 2.0, 3.0], [0.0, 0.0, 2.0, 0.0]).unwrap();
        assert_eq!(pose.quat_xyzw, [0.0, 0.0, 1.0, 0.0]);
    }
}
