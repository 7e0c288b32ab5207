//! Numbers for readers: SI prefixes, rounding to the known digits, intervals.

/// Half-width of a 95 % interval in standard deviations of a normal distribution.
pub(crate) const HALF_95: f64 = 1.959_963_984_540_054;

/// A unit in which a number is shown: `shown = factor · SI`.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Scale {
    /// Multiplier from SI.
    pub factor: f64,
    /// Unit as printed; empty for pure numbers.
    pub unit: String,
}

impl Scale {
    /// The scale that best shows a number of size `size` (SI). `unit` is an SI unit: `m`, `N·s/m`, `1` …
    pub fn for_size(size: f64, unit: &str) -> Self {
        let size = size.abs();
        let plain = |unit: &str| Self { factor: 1.0, unit: unit.to_string() };
        match unit {
            "" | "1" | "-" => return plain(""),
            "rad" => return Self { factor: 1f64.to_degrees(), unit: "°".into() },
            _ => {}
        }
        if !size.is_finite() || size == 0.0 {
            return plain(unit);
        }
        if unit == "kg" {
            // The kilogram already has a prefix.
            return match size {
                s if s >= 1.0 => plain(unit),
                s if s >= 0.999e-3 => Self { factor: 1e3, unit: "g".into() },
                _ => Self { factor: 1e6, unit: "mg".into() },
            };
        }
        // A prefix goes on a first symbol without an exponent: m, N·s/m, but not m² or 1/s.
        let first: String = unit.chars().take_while(|c| c.is_ascii_alphabetic()).collect();
        let next = unit.chars().nth(first.chars().count());
        let prefixed = ["m", "s", "N", "V", "A", "W", "Hz"].contains(&first.as_str())
            && next.is_none_or(|c| c == '/' || c == '·');
        match size {
            s if !prefixed || s >= 1.0 => plain(unit),
            s if s >= 0.999e-3 => Self { factor: 1e3, unit: format!("m{unit}") },
            s if s >= 0.999e-6 => Self { factor: 1e6, unit: format!("µ{unit}") },
            _ => plain(unit),
        }
    }

    /// `12.3 mm`, with `digits` significant digits.
    pub fn show(&self, si: f64, digits: usize) -> String {
        with_unit(&significant(si * self.factor, digits), &self.unit)
    }
}

/// A number and its unit; the degree sign follows directly, other units after a space.
fn with_unit(number: &str, unit: &str) -> String {
    match unit {
        "" => number.to_string(),
        "°" => format!("{number}°"),
        _ => format!("{number} {unit}"),
    }
}

/// A value in a suitable unit, with `digits` significant digits.
pub(crate) fn quantity(si: f64, unit: &str, digits: usize) -> String {
    Scale::for_size(si, unit).show(si, digits)
}

/// A value with its 95 % interval: `0.320 ± 0.012 N·s/m`. `sigma` is the standard deviation, SI.
pub(crate) fn interval(value: f64, sigma: f64, unit: &str) -> String {
    let half = HALF_95 * sigma;
    if !(half.is_finite() && half > 0.0) {
        return format!("{} (no interval)", quantity(value, unit, 4));
    }
    let scale = Scale::for_size(value.abs().max(half), unit);
    with_unit(&interval_number(value * scale.factor, half * scale.factor), &scale.unit)
}

/// `0.320 ± 0.012`; very large or small values with a power of ten: `(1.66 ± 0.05)×10⁻⁵`.
fn interval_number(value: f64, half: f64) -> String {
    let size = value.abs().max(half);
    let exponent = size.log10().floor() as i32;
    let power = if (-3..5).contains(&exponent) { 0 } else { exponent };
    let by = 10f64.powi(-power);
    let (value, half) = (value * by, half * by);
    // Two significant digits of the half-width, after rounding.
    let decimals = (1 - half.log10().floor() as i32).clamp(0, 12) as usize;
    let (v, h) = (minus(format!("{value:.decimals$}")), format!("{half:.decimals$}"));
    if power == 0 { format!("{v} ± {h}") } else { format!("({v} ± {h}){}", times_ten(power)) }
}

/// A number with `digits` significant digits, trailing zeros kept; very large or small values with a power of ten.
pub(crate) fn significant(value: f64, digits: usize) -> String {
    if value == 0.0 {
        return "0".into();
    }
    if !value.is_finite() {
        return if value.is_nan() { "–".into() } else { minus(format!("{value}")).replace("inf", "∞") };
    }
    // The exponent after rounding: 9.996 with three digits is 10.0.
    let rounded = format!("{value:.*e}", digits.max(1) - 1);
    let (mantissa, exponent) = rounded.split_once('e').unwrap_or((&rounded, "0"));
    let exponent: i32 = exponent.parse().unwrap_or(0);
    if (-4..6).contains(&exponent) {
        let decimals = (digits as i32 - 1 - exponent).max(0) as usize;
        minus(format!("{value:.decimals$}"))
    } else {
        format!("{}{}", minus(mantissa.to_string()), times_ten(exponent))
    }
}

/// A share as per cent: `91 %`, `0.4 %`.
pub(crate) fn percent(share: f64) -> String {
    let value = 100.0 * share;
    if !value.is_finite() {
        return "–".into();
    }
    let decimals = usize::from(value.abs() < 9.95 && value != 0.0);
    minus(format!("{value:.decimals$} %"))
}

fn minus(number: String) -> String {
    number.replace('-', "−")
}

fn times_ten(power: i32) -> String {
    let power = power.to_string();
    let digits = power.chars().map(|c| match c {
        '-' => '⁻',
        '0' => '⁰',
        '1' => '¹',
        '2' => '²',
        '3' => '³',
        '4' => '⁴',
        '5' => '⁵',
        '6' => '⁶',
        '7' => '⁷',
        '8' => '⁸',
        _ => '⁹',
    });
    format!("×10{}", digits.collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_get_the_prefix_of_their_size() {
        assert_eq!(quantity(0.0123, "m", 3), "12.3 mm");
        assert_eq!(quantity(4.2e-5, "s", 2), "42 µs");
        assert_eq!(quantity(0.0315, "kg", 3), "31.5 g");
        assert_eq!(quantity(1.66e-5, "kg·m²", 3), "1.66×10⁻⁵ kg·m²");
        assert_eq!(quantity(0.25, "N·s/m", 3), "250 mN·s/m");
        assert_eq!(quantity(0.004, "1/s", 1), "0.004 1/s");
        assert_eq!(quantity(0.0349, "rad", 3), "2.00°");
        assert_eq!(quantity(-0.08, "1", 2), "−0.080");
        assert_eq!(quantity(0.0, "m", 3), "0 m");
        assert_eq!(quantity(f64::NAN, "m", 3), "– m");
        assert_eq!(significant(9.996, 3), "10.0");
    }

    #[test]
    fn an_interval_shows_no_more_digits_than_are_known() {
        assert_eq!(interval(0.32, 0.00612, "N·s/m"), "320 ± 12 mN·s/m");
        assert_eq!(interval(-0.0801, 0.0021, "1"), "−0.0801 ± 0.0041");
        assert_eq!(interval(1.66e-5, 0.03e-5, "kg·m²"), "(1.660 ± 0.059)×10⁻⁵ kg·m²");
        assert_eq!(interval(0.002, 0.00005, "m"), "2.000 ± 0.098 mm");
        assert_eq!(interval(1.0, 0.0, "m"), "1.000 m (no interval)");
        assert_eq!(interval(1.0, f64::NAN, "m"), "1.000 m (no interval)");
        assert_eq!(interval(0.0175, 0.0005, "rad"), "1.003 ± 0.056°");
    }

    #[test]
    fn shares_are_per_cent() {
        assert_eq!(percent(0.914), "91 %");
        assert_eq!(percent(0.0042), "0.4 %");
        assert_eq!(percent(-0.123), "−12 %");
        assert_eq!(percent(0.0), "0 %");
    }
}
