//! Colours by perception.

use super::Ink;

/// sRGB of an OKLCH colour: lightness 0..1, chroma, hue in degrees. Chroma is lowered until the colour exists in sRGB.
/// Formulas: B. Ottosson, "A perceptual color space for image processing", 2020.
pub fn oklch(lightness: f64, chroma: f64, hue_deg: f64) -> Ink {
    let (sin, cos) = hue_deg.to_radians().sin_cos();
    let linear = |c: f64| {
        let (a, b) = (c * cos, c * sin);
        let l = (lightness + 0.396_337_777_4 * a + 0.215_803_757_3 * b).powi(3);
        let m = (lightness - 0.105_561_345_8 * a - 0.063_854_172_8 * b).powi(3);
        let s = (lightness - 0.089_484_177_5 * a - 1.291_485_548_0 * b).powi(3);
        [
            4.076_741_662_1 * l - 3.307_711_591_3 * m + 0.230_969_929_2 * s,
            -1.268_438_004_6 * l + 2.609_757_401_1 * m - 0.341_319_396_5 * s,
            -0.004_196_086_3 * l - 0.703_418_614_7 * m + 1.707_614_701_0 * s,
        ]
    };
    let exists = |rgb: [f64; 3]| rgb.iter().all(|v| (-1e-4..=1.0001).contains(v));
    let (mut low, mut high) = (0.0, chroma);
    if !exists(linear(chroma)) {
        for _ in 0..20 {
            let middle = 0.5 * (low + high);
            if exists(linear(middle)) { low = middle } else { high = middle }
        }
    } else {
        low = chroma;
    }
    linear(low).map(|v| {
        let v = v.clamp(0.0, 1.0);
        let encoded = if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
        (encoded * 255.0).round() as u8
    })
}
