//! A small raster canvas: smooth lines and discs, scaled images, text in built-in fonts, colours by perception.

use embedded_graphics::mono_font::iso_8859_1::FONT_10X20;
use embedded_graphics::mono_font::{MonoFont, MonoTextStyle};
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::text::{Baseline, Text};

/// Red, green, blue, sRGB.
pub(super) type Rgb = [u8; 3];

/// Height of a line of text, pixels.
pub(super) const TEXT_H: i32 = 20;
/// Width of a character of text, pixels.
pub(super) const CHAR_W: i32 = 10;

/// Where text stands relative to its point.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Align {
    Left,
    Center,
    Right,
}

/// sRGB of an OKLCH colour: lightness 0..1, chroma, hue in degrees. Chroma is lowered until the colour exists in sRGB.
/// Formulas: B. Ottosson, "A perceptual color space for image processing", 2020.
pub(super) fn oklch(lightness: f64, chroma: f64, hue_deg: f64) -> Rgb {
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

fn mix(from: Rgb, to: Rgb, share: f32) -> Rgb {
    std::array::from_fn(|i| {
        (f32::from(from[i]) + (f32::from(to[i]) - f32::from(from[i])) * share).round() as u8
    })
}

/// The picture.
pub(super) struct Canvas {
    pub width: i32,
    pub height: i32,
    pub pixels: Vec<Rgb>,
}

impl Canvas {
    pub fn new(width: i32, height: i32, color: Rgb) -> Self {
        Self { width, height, pixels: vec![color; (width * height) as usize] }
    }

    fn blend(&mut self, x: i32, y: i32, color: Rgb, share: f32) {
        if (0..self.width).contains(&x) && (0..self.height).contains(&y) && share > 0.0 {
            let pixel = &mut self.pixels[(y * self.width + x) as usize];
            *pixel = mix(*pixel, color, share.min(1.0));
        }
    }

    pub fn rect(&mut self, x: i32, y: i32, w: i32, h: i32, color: Rgb) {
        for y in y..y + h {
            for x in x..x + w {
                self.blend(x, y, color, 1.0);
            }
        }
    }

    /// A frame one pixel wide just outside the rectangle.
    pub fn outline(&mut self, x: i32, y: i32, w: i32, h: i32, color: Rgb) {
        self.rect(x - 1, y - 1, w + 2, 1, color);
        self.rect(x - 1, y + h, w + 2, 1, color);
        self.rect(x - 1, y - 1, 1, h + 2, color);
        self.rect(x + w, y - 1, 1, h + 2, color);
    }

    /// A smooth line with round ends; coverage is the distance to its edge, clipped to `clip` = (x, y, w, h).
    pub fn line(&mut self, from: [f64; 2], to: [f64; 2], width: f64, color: Rgb, clip: [i32; 4]) {
        let radius = 0.5 * width;
        let reach = radius + 1.0;
        let span = |a: f64, b: f64, low: i32, size: i32| {
            let first = ((a.min(b) - reach).floor().max(f64::from(low))) as i32;
            let last = ((a.max(b) + reach).ceil().min(f64::from(low + size - 1))) as i32;
            first..=last
        };
        let along = [to[0] - from[0], to[1] - from[1]];
        let length2 = along[0] * along[0] + along[1] * along[1];
        for y in span(from[1], to[1], clip[1], clip[3]) {
            for x in span(from[0], to[0], clip[0], clip[2]) {
                let p = [f64::from(x) + 0.5 - from[0], f64::from(y) + 0.5 - from[1]];
                let share = if length2 > 0.0 {
                    ((p[0] * along[0] + p[1] * along[1]) / length2).clamp(0.0, 1.0)
                } else {
                    0.0
                };
                let distance = (p[0] - share * along[0]).hypot(p[1] - share * along[1]);
                self.blend(x, y, color, (radius + 0.5 - distance) as f32);
            }
        }
    }

    /// A filled disc.
    pub fn disc(&mut self, center: [f64; 2], radius: f64, color: Rgb, clip: [i32; 4]) {
        self.line(center, center, 2.0 * radius, color, clip);
    }

    /// A diagonal cross.
    pub fn cross(&mut self, center: [f64; 2], half: f64, width: f64, color: Rgb, clip: [i32; 4]) {
        let [x, y] = center;
        self.line([x - half, y - half], [x + half, y + half], width, color, clip);
        self.line([x - half, y + half], [x + half, y - half], width, color, clip);
    }

    /// An image scaled into a rectangle: nearest pixel when larger, mean of the covered pixels when smaller.
    pub fn image(
        &mut self,
        [x0, y0, w, h]: [i32; 4],
        (iw, ih): (usize, usize),
        color: impl Fn(usize, usize) -> Rgb,
    ) {
        let bounds = |i: i32, n: i32, size: usize| {
            let first = i as usize * size / n as usize;
            let last = ((i as usize + 1) * size / n as usize).max(first + 1);
            first..last
        };
        for y in 0..h {
            for x in 0..w {
                let (mut sum, mut n) = ([0u32; 3], 0);
                for row in bounds(y, h, ih) {
                    for column in bounds(x, w, iw) {
                        let c = color(row, column);
                        (0..3).for_each(|i| sum[i] += u32::from(c[i]));
                        n += 1;
                    }
                }
                self.blend(x0 + x, y0 + y, sum.map(|s| ((s + n / 2) / n) as u8), 1.0);
            }
        }
    }

    /// A line of text whose top is at `y`. Characters outside Latin-1 show as `?`.
    pub fn text(&mut self, x: i32, y: i32, text: &str, color: Rgb, align: Align) {
        let x = aligned(x, text_width(text), align);
        draw_text(self, &FONT_10X20, x, y, text, color);
    }

    /// A line of text in twice the size, smoothed.
    pub fn headline(&mut self, x: i32, y: i32, text: &str, color: Rgb) {
        let mut mask = Canvas::new(text_width(text).max(1), TEXT_H, [0; 3]);
        draw_text(&mut mask, &FONT_10X20, 0, 0, text, [255; 3]);
        let mut bits: Vec<bool> = mask.pixels.iter().map(|p| p[0] > 0).collect();
        let (mut w, mut h) = (mask.width as usize, mask.height as usize);
        // Four times as many pixels each way, then each 2×2 block gives one level of grey.
        for _ in 0..2 {
            bits = double(&bits, w, h);
            (w, h) = (2 * w, 2 * h);
        }
        for row in 0..h / 2 {
            for column in 0..w / 2 {
                let at =
                    |dy: usize, dx: usize| f32::from(u8::from(bits[(2 * row + dy) * w + 2 * column + dx]));
                let share = (at(0, 0) + at(0, 1) + at(1, 0) + at(1, 1)) / 4.0;
                self.blend(x + column as i32, y + row as i32, color, share);
            }
        }
    }
}

/// Twice as many pixels each way; a corner takes its neighbours' value where the two that meet there agree and the
/// others do not (the rule known as Scale2x, A. Mazzoleni, 2001).
fn double(bits: &[bool], w: usize, h: usize) -> Vec<bool> {
    let mut out = vec![false; 4 * w * h];
    for y in 0..h {
        for x in 0..w {
            let here = bits[y * w + x];
            let up = if y > 0 { bits[(y - 1) * w + x] } else { here };
            let down = if y + 1 < h { bits[(y + 1) * w + x] } else { here };
            let left = if x > 0 { bits[y * w + x - 1] } else { here };
            let right = if x + 1 < w { bits[y * w + x + 1] } else { here };
            let corner =
                |a: bool, b: bool, c: bool, d: bool| if a == b && a != c && b != d { a } else { here };
            let to = 4 * w * y + 2 * x;
            out[to] = corner(left, up, down, right);
            out[to + 1] = corner(up, right, left, down);
            out[to + 2 * w] = corner(down, left, right, up);
            out[to + 2 * w + 1] = corner(right, down, up, left);
        }
    }
    out
}

/// Width of a line of text, pixels.
pub(super) fn text_width(text: &str) -> i32 {
    text.chars().count() as i32 * CHAR_W
}

fn aligned(x: i32, width: i32, align: Align) -> i32 {
    match align {
        Align::Left => x,
        Align::Center => x - width / 2,
        Align::Right => x - width,
    }
}

fn draw_text(canvas: &mut Canvas, font: &'static MonoFont<'static>, x: i32, y: i32, text: &str, color: Rgb) {
    let style = MonoTextStyle::new(font, Rgb888::new(color[0], color[1], color[2]));
    // Drawing on a canvas cannot fail: its error type is empty.
    let _ = Text::with_baseline(text, Point::new(x, y), style, Baseline::Top).draw(canvas);
}

impl OriginDimensions for Canvas {
    fn size(&self) -> Size {
        Size::new(self.width as u32, self.height as u32)
    }
}

impl DrawTarget for Canvas {
    type Color = Rgb888;
    type Error = core::convert::Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<Rgb888>>>(&mut self, pixels: I) -> Result<(), Self::Error> {
        for Pixel(at, color) in pixels {
            self.blend(at.x, at.y, [color.r(), color.g(), color.b()], 1.0);
        }
        Ok(())
    }
}

/// About `n` round numbers that cover `low..high`: steps of 1, 2 or 5 times a power of ten.
pub(super) fn ticks(low: f64, high: f64, n: usize) -> Vec<f64> {
    let span = high - low;
    if !(span.is_finite() && span > 0.0 && n > 0) {
        return Vec::new();
    }
    let rough = span / n as f64;
    let power = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0]
        .map(|f| f * power)
        .into_iter()
        .find(|s| *s >= rough * 0.999)
        .unwrap_or(10.0 * power);
    let first = (low / step - 1e-9).ceil() as i64;
    let last = (high / step + 1e-9).floor() as i64;
    (first..=last).map(|i| i as f64 * step).collect()
}

/// A tick's label, with the decimals that its neighbours need.
pub(super) fn tick_label(value: f64, ticks: &[f64]) -> String {
    let step = if ticks.len() > 1 { (ticks[1] - ticks[0]).abs() } else { value.abs().max(1.0) };
    let decimals = (-(step + 1e-12).log10().floor()).max(0.0) as usize;
    let text = format!("{value:.decimals$}");
    if text.trim_start_matches('-').chars().all(|c| c == '0' || c == '.') { "0".into() } else { text }
}
