//! Colours of depths, clearances and geoms.

use crate::picture::{Ink, oklch};

pub(super) const COLOR_MISS: Ink = [226, 228, 232];
pub(super) const COLOR_TOO_FAR: Ink = [128, 131, 137];
pub(super) const COLOR_TOO_NEAR: Ink = [214, 40, 57];
/// Clearance at which a path is wholly orange and wholly blue, m.
pub(super) const CLEARANCE_NEAR_M: f64 = 0.1;
pub(super) const CLEARANCE_FAR_M: f64 = 1.0;

/// Colour of depth from 0 (near, light yellow) to 1 (far, dark violet): even steps of OKLab lightness, hues from yellow
/// over green and blue to violet.
pub(super) fn depth_color(share: f64) -> Ink {
    let s = share.clamp(0.0, 1.0);
    oklch(0.93 - 0.70 * s, 0.10 + 0.12 * s * (1.0 - s), 105.0 + 200.0 * s)
}

/// Colour of clearance: orange up to 0.1 m, over purple to blue from 1 m on, even in the logarithm. Those who cannot tell red from green see
/// it go from yellow to blue.
pub(super) fn clearance_color(clearance_m: f64) -> Ink {
    if clearance_m.is_nan() {
        return [90, 92, 98];
    }
    let s = clearance_share(clearance_m);
    oklch(0.66 - 0.16 * s, 0.16, (50.0 - 150.0 * s).rem_euclid(360.0))
}

fn clearance_share(clearance_m: f64) -> f64 {
    let ratio = (clearance_m.max(1e-6) / CLEARANCE_NEAR_M).ln() / (CLEARANCE_FAR_M / CLEARANCE_NEAR_M).ln();
    ratio.clamp(0.0, 1.0)
}

/// Colour of a geom: hues a golden angle apart, so that neighbours in number differ.
pub(super) fn geom_color(id: i32) -> Ink {
    if id < 0 {
        return COLOR_MISS;
    }
    let i = f64::from(id);
    oklch(0.52 + 0.11 * f64::from(id % 4), 0.13, (i * 137.508) % 360.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Blue less yellow of a colour: what those who see no difference of red and green have left, beside how light it is.
    fn blueness(ink: Ink) -> i32 {
        2 * i32::from(ink[2]) - i32::from(ink[0]) - i32::from(ink[1])
    }

    #[test]
    fn clearances_are_told_apart_without_red_and_green() {
        let steps: Vec<i32> =
            (0..=10).map(|i| blueness(clearance_color(0.1 * 10f64.powf(f64::from(i) / 10.0)))).collect();
        assert!(steps.windows(2).all(|w| w[1] > w[0]), "{steps:?}");
        assert!(steps[0] < -150 && steps[10] > 150, "{steps:?}");
        assert_eq!(clearance_color(0.01), clearance_color(0.1));
        assert_eq!(clearance_color(5.0), clearance_color(1.0));
    }
}
