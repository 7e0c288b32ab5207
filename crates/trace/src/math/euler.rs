//! Roll, pitch, yaw: R = Rz(yaw) · Ry(pitch) · Rx(roll), the aerospace convention with x forward, y left, z up.

use super::quat;
use crate::Real;

/// Cosine of pitch below which rates of roll and yaw are no longer followed exactly: |pitch| > 85°.
///
/// Roll and yaw rates are ω divided by cos(pitch). Beyond 85° the divisor is held at cos 85°, which bounds the rates
/// by 11.5 |ω| where the exact ones would grow without end.
pub const MIN_COS_PITCH: f64 = 0.087_155_742_747_658_17;

/// Roll, pitch, yaw (rad) of a unit quaternion; pitch in [−π/2, π/2].
#[inline(always)]
pub fn from_quat<S: Real>(q: [S; 4]) -> [S; 3] {
    from_matrix(quat::matrix(q))
}

/// Roll, pitch, yaw (rad) of a rotation matrix given by rows.
#[inline(always)]
pub fn from_matrix<S: Real>(m: [[S; 3]; 3]) -> [S; 3] {
    let cos_pitch = (m[0][0] * m[0][0] + m[1][0] * m[1][0]).max(S::lit(1e-300)).sqrt();
    // At cos(pitch) = 0 roll and yaw cannot be told apart: the whole turn is then given to yaw, and roll is zero.
    let locked = cos_pitch.lt(S::lit(1e-12));
    let one = S::one();
    let roll = S::select(locked, S::zero(), m[2][1]).atan2(S::select(locked, one, m[2][2]));
    let yaw = S::select(locked, -m[0][1], m[1][0]).atan2(S::select(locked, m[1][1], m[0][0]));
    [roll, (-m[2][0]).atan2(cos_pitch), yaw]
}

/// Unit quaternion of roll, pitch, yaw (rad).
#[inline(always)]
pub fn to_quat<S: Real>(rpy: [S; 3]) -> [S; 4] {
    let half = S::lit(0.5);
    let (sr, cr) = (rpy[0] * half).sin_cos();
    let (sp, cp) = (rpy[1] * half).sin_cos();
    let (sy, cy) = (rpy[2] * half).sin_cos();
    [
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    ]
}

/// Sines and cosines of roll and pitch, with cos(pitch) held at or above [`MIN_COS_PITCH`].
#[derive(Clone, Copy, Debug)]
struct Tilt<S> {
    sr: S,
    cr: S,
    sp: S,
    cp: S,
}

#[inline(always)]
fn tilt<S: Real>(rpy: [S; 3]) -> Tilt<S> {
    let (sr, cr) = rpy[0].sin_cos();
    let (sp, cp) = rpy[1].sin_cos();
    Tilt { sr, cr, sp, cp: cp.max(S::lit(MIN_COS_PITCH)) }
}

/// Rates of roll, pitch, yaw (rad/s) of a body turning with `w` (rad/s, body frame).
/// (Diebel, "Representing attitude", 2006, eq. 76.)
#[inline(always)]
pub fn rates_from_body<S: Real>(rpy: [S; 3], w: [S; 3]) -> [S; 3] {
    let t = tilt(rpy);
    let yaw_rate = (t.sr * w[1] + t.cr * w[2]) / t.cp;
    [w[0] + t.sp * yaw_rate, t.cr * w[1] - t.sr * w[2], yaw_rate]
}

/// Angular velocity (rad/s, body frame) of the rates of roll, pitch, yaw: the inverse of [`rates_from_body`].
#[inline(always)]
pub fn body_from_rates<S: Real>(rpy: [S; 3], rates: [S; 3]) -> [S; 3] {
    let t = tilt(rpy);
    [
        rates[0] - t.sp * rates[2],
        t.cr * rates[1] + t.sr * t.cp * rates[2],
        t.cr * t.cp * rates[2] - t.sr * rates[1],
    ]
}

/// Angular acceleration (rad/s², body frame) from rates (rad/s) and accelerations (rad/s²) of roll, pitch, yaw:
/// the time derivative of [`body_from_rates`].
#[inline(always)]
pub fn body_accel_from_rates<S: Real>(rpy: [S; 3], rates: [S; 3], accels: [S; 3]) -> [S; 3] {
    let t = tilt(rpy);
    let [dr, dp, dy] = rates;
    let steady = body_from_rates(rpy, accels);
    [
        steady[0] - t.cp * dp * dy,
        steady[1] - t.sr * dr * dp + (t.cr * t.cp * dr - t.sr * t.sp * dp) * dy,
        steady[2] - t.cr * dr * dp - (t.sr * t.cp * dr + t.cr * t.sp * dp) * dy,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn angles_survive_the_quaternion(roll in -3.1..3.1f64, pitch in -1.55..1.55f64, yaw in -3.1..3.1f64) {
            let back = from_quat(to_quat([roll, pitch, yaw]));
            for (a, b) in back.iter().zip([roll, pitch, yaw]) {
                prop_assert!((a - b).abs() < 1e-11);
            }
        }

        #[test]
        fn rates_and_body_rates_are_inverse(rpy in prop::array::uniform3(-1.4..1.4f64), w in prop::array::uniform3(-9.0..9.0f64)) {
            let back = body_from_rates(rpy, rates_from_body(rpy, w));
            for i in 0..3 {
                prop_assert!((back[i] - w[i]).abs() < 1e-12);
            }
        }

        #[test]
        fn acceleration_is_the_derivative_of_body_rates(
            rpy in prop::array::uniform3(-1.4..1.4f64),
            rates in prop::array::uniform3(-3.0..3.0f64),
            accels in prop::array::uniform3(-9.0..9.0f64),
        ) {
            let h = 1e-5;
            let at = |t: f64| {
                let mut angle = rpy;
                let mut rate = rates;
                for i in 0..3 {
                    angle[i] += rates[i] * t + 0.5 * accels[i] * t * t;
                    rate[i] += accels[i] * t;
                }
                body_from_rates(angle, rate)
            };
            let (plus, minus, exact) = (at(h), at(-h), body_accel_from_rates(rpy, rates, accels));
            for i in 0..3 {
                prop_assert!(((plus[i] - minus[i]) / (2.0 * h) - exact[i]).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn rates_stay_bounded_at_ninety_degrees() {
        use core::f64::consts::FRAC_PI_2;
        for pitch in [FRAC_PI_2, -FRAC_PI_2, FRAC_PI_2 - 1e-14] {
            let rates = rates_from_body([0.3, pitch, 0.0], [1.0, 1.0, 1.0]);
            assert!(rates.iter().all(|r| r.abs() < 1.0 + 1.5 / MIN_COS_PITCH), "{rates:?}");
            let rpy = from_quat(to_quat([0.3, pitch, 0.2]));
            assert!(rpy.iter().all(|a| a.is_finite()) && (rpy[1].abs() - FRAC_PI_2).abs() < 1e-7);
        }
    }
}
