//! Units of files and printers to SI and back. Everything inside the library is SI already.

use core::f64::consts::PI;

/// rad/s of one revolution per minute.
pub const RAD_S_PER_RPM: f64 = 2.0 * PI / 60.0;

/// Revolutions per minute to rad/s.
pub fn rpm_to_rad_s(rpm: f64) -> f64 {
    rpm * RAD_S_PER_RPM
}

/// rad/s to revolutions per minute.
pub fn rad_s_to_rpm(rad_s: f64) -> f64 {
    rad_s / RAD_S_PER_RPM
}

/// Degrees to radians.
pub fn deg_to_rad(deg: f64) -> f64 {
    deg * (PI / 180.0)
}

/// Radians to degrees.
pub fn rad_to_deg(rad: f64) -> f64 {
    rad * (180.0 / PI)
}

/// Standard gravity, m/s² (ISO 80000-3).
pub const STANDARD_GRAVITY_M_S2: f64 = 9.80665;

/// Multiples of standard gravity to m/s².
pub fn g_to_m_s2(g: f64) -> f64 {
    g * STANDARD_GRAVITY_M_S2
}

/// Polynomial coefficients c0, c1, c2 in powers of rpm to coefficients in powers of rad/s.
pub fn curve_rpm_to_rad_s(c: [f64; 3]) -> [f64; 3] {
    [c[0], c[1] / RAD_S_PER_RPM, c[2] / (RAD_S_PER_RPM * RAD_S_PER_RPM)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_has_the_same_value_in_both_units() {
        let c = [0.1, 2e-6, 3e-10];
        let d = curve_rpm_to_rad_s(c);
        let (rpm, w) = (12_000.0, rpm_to_rad_s(12_000.0));
        let (a, b) = (c[0] + c[1] * rpm + c[2] * rpm * rpm, d[0] + d[1] * w + d[2] * w * w);
        assert!((a - b).abs() < 1e-15);
        assert_eq!(rad_s_to_rpm(rpm_to_rad_s(60.0)), 60.0);
        assert!((rad_to_deg(deg_to_rad(33.0)) - 33.0).abs() < 1e-14);
        assert_eq!(g_to_m_s2(1.0), 9.80665);
    }
}
