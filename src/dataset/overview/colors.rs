//! Colours of depths, clearances and geoms.

use crate::picture::{Ink, oklch};

pub(super) const COLOR_MISS: Ink = [226, 228, 232];
pub(super) const COLOR_TOO_FAR: Ink = [128, 131, 137];
pub(super) const COLOR_TOO_NEAR: Ink = [214, 40, 57];
/// Clearance at which a path is wholly red and wholly green, m.
pub(super) const CLEARANCE_RED_M: f64 = 0.1;
pub(super) const CLEARANCE_GREEN_M: f64 = 1.0;

/// Colour of depth from 0 (near, light yellow) to 1 (far, dark violet): even steps of OKLab lightness, hues from yellow
/// over green and blue to violet.
pub(super) fn depth_color(share: f64) -> Ink {
    let s = share.clamp(0.0, 1.0);
    oklch(0.93 - 0.70 * s, 0.10 + 0.12 * s * (1.0 - s), 105.0 + 200.0 * s)
}

/// Colour of clearance: red up to 0.1 m, over orange and yellow to green from 1 m on, even in the logarithm.
pub(super) fn clearance_color(clearance_m: f64) -> Ink {
    if clearance_m.is_nan() {
        return [90, 92, 98];
    }
    let s = clearance_share(clearance_m);
    oklch(0.58 + 0.68 * s * (1.0 - s), 0.19, 27.0 + 118.0 * s)
}

fn clearance_share(clearance_m: f64) -> f64 {
    let ratio = (clearance_m.max(1e-6) / CLEARANCE_RED_M).ln() / (CLEARANCE_GREEN_M / CLEARANCE_RED_M).ln();
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
