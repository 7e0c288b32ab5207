//! The error ladder as a picture: one panel per channel, logarithmic, a line per horizon, unseen flight and flight of
//! the fit apart.

use super::quantity::{quantity, significant};
use super::text::{LADDER_CHANNELS, LadderChannel, at, horizons};
use crate::gap::GapError;
use crate::gap::verdict::{Diagnosis, HorizonError, Rung};
use tiny_skia::{
    Color, FillRule, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, Stroke, StrokeDash, Transform,
};
use ttf_parser::{Face, OutlineBuilder};

/// Width and height of the picture, pixels.
pub const LADDER_PNG_SIZE: [u32; 2] = [1600, 1180];

const REGULAR: &[u8] = include_bytes!("../../../assets/report/DejaVuSans.subset.ttf");
const BOLD: &[u8] = include_bytes!("../../../assets/report/DejaVuSans-Bold.subset.ttf");

const PAPER: [u8; 3] = [255, 255, 255];
const INK: [u8; 3] = [28, 32, 38];
const SOFT: [u8; 3] = [96, 104, 116];
const GRID: [u8; 3] = [226, 229, 234];
/// Colours that stay apart for colour-blind eyes: M. Okabe and K. Ito, "Color Universal Design", 2008.
const LINES: [[u8; 3]; 6] =
    [[0, 114, 178], [213, 94, 0], [0, 158, 115], [204, 121, 167], [230, 159, 0], [86, 180, 233]];

/// The ladder of a diagnosis as a PNG image of [`LADDER_PNG_SIZE`].
///
/// # Errors
/// [`GapError::Numbers`] where the image cannot be drawn or encoded.
pub fn ladder_png(diagnosis: &Diagnosis) -> Result<Vec<u8>, GapError> {
    let mut page = Page::new()?;
    page.heading(&format!("Error ladder of {}", diagnosis.vehicle), &diagnosis.verdict);
    let horizons = horizons(&diagnosis.ladder);
    if horizons.is_empty() {
        page.text([80.0, 220.0], 24.0, false, SOFT, Anchor::Start, "No roll-outs were made.");
    } else {
        page.legend(&horizons, &diagnosis.ladder);
        let (width, height) = (680.0, 380.0);
        for (k, channel) in LADDER_CHANNELS.iter().enumerate() {
            let left = 130.0 + (k % 2) as f32 * 770.0;
            let top = 254.0 + (k / 2) as f32 * 480.0;
            page.panel([left, top, width - 30.0, height], channel, &horizons, &diagnosis.ladder);
        }
    }
    page.encode()
}

#[derive(Clone, Copy)]
enum Anchor {
    Start,
    Middle,
    End,
}

/// Positions of values on a logarithmic axis.
struct LogAxis {
    low: f64,
    high: f64,
    top: f32,
    height: f32,
}

impl LogAxis {
    fn y(&self, value: f64) -> f32 {
        let share = (value / self.low).log10() / (self.high / self.low).log10();
        self.top + self.height * (1.0 - share as f32)
    }

    /// Round values on the axis: 1, 2, 5 of each decade, or only decades where there are many.
    fn ticks(&self) -> Vec<f64> {
        let decades = (self.low.log10().floor() as i32)..=(self.high.log10().ceil() as i32);
        let wide = (self.high / self.low).log10() > 2.5;
        let steps: &[f64] = if wide { &[1.0] } else { &[1.0, 2.0, 5.0] };
        let all = decades.flat_map(|d| steps.iter().map(move |s| s * 10f64.powi(d)));
        all.filter(|v| (self.low..=self.high).contains(v)).collect()
    }
}

struct Page<'a> {
    pixels: Pixmap,
    regular: Face<'a>,
    bold: Face<'a>,
}

impl Page<'_> {
    fn new() -> Result<Self, GapError> {
        let failed = |reason: String| GapError::Numbers { what: "the picture of the ladder", reason };
        let [width, height] = LADDER_PNG_SIZE;
        let mut pixels =
            Pixmap::new(width, height).ok_or_else(|| failed("there is no memory for it".into()))?;
        pixels.fill(color(PAPER));
        let face = |data| Face::parse(data, 0).map_err(|e| failed(format!("the font cannot be read: {e}")));
        Ok(Self { pixels, regular: face(REGULAR)?, bold: face(BOLD)? })
    }

    fn encode(self) -> Result<Vec<u8>, GapError> {
        let mut out = Vec::new();
        let mut encoder = png::Encoder::new(&mut out, LADDER_PNG_SIZE[0], LADDER_PNG_SIZE[1]);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let rgb: Vec<u8> = self.pixels.data().chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
        let write = |encoder: png::Encoder<&mut Vec<u8>>| -> Result<(), png::EncodingError> {
            let mut writer = encoder.write_header()?;
            writer.write_image_data(&rgb)?;
            writer.finish()
        };
        write(encoder)
            .map_err(|e| GapError::Numbers { what: "the picture of the ladder", reason: e.to_string() })?;
        Ok(out)
    }

    fn heading(&mut self, title: &str, verdict: &str) {
        let wide = LADDER_PNG_SIZE[0] as f32 - 160.0;
        let title = self.shortened(title, 34.0, true, wide);
        self.text([80.0, 68.0], 34.0, true, INK, Anchor::Start, &title);
        for (k, line) in self.lines(verdict, 21.0, wide, 2).iter().enumerate() {
            self.text([80.0, 108.0 + 29.0 * k as f32], 21.0, false, SOFT, Anchor::Start, line);
        }
    }

    fn legend(&mut self, horizons: &[f64], ladder: &[Rung]) {
        let (y, mut x) = (180.0, 80.0);
        let mut item = |page: &mut Self, style: Option<usize>, dashed: bool, words: &str| {
            let ink = style.map_or(SOFT, |k| LINES[k % LINES.len()]);
            page.line(&[[x, y], [x + 46.0, y]], ink, 3.0, dashed);
            page.marker([x + 23.0, y], style.unwrap_or(0), ink, !dashed);
            page.text([x + 56.0, y + 7.0], 20.0, false, INK, Anchor::Start, words);
            x += 56.0 + page.width(words, 20.0, false) + 36.0;
        };
        for (k, h) in horizons.iter().enumerate() {
            item(self, Some(k), false, &format!("after {}", quantity(*h, "s", 2)));
        }
        if ladder.iter().any(|r| !r.held_out.is_empty()) {
            item(self, None, false, "unseen flight");
        }
        if ladder.iter().any(|r| !r.training.is_empty()) {
            item(self, None, true, "flight of the fit");
        }
    }

    fn panel(
        &mut self,
        [left, top, width, height]: [f32; 4],
        (name, unit, error): &LadderChannel,
        horizons: &[f64],
        ladder: &[Rung],
    ) {
        self.text([left, top - 14.0], 21.0, true, INK, Anchor::Start, &format!("Error of the {name}, RMS"));
        let drawn = |v: f64| v.is_finite() && v > 0.0;
        // Angles in degrees, so that the ticks are round.
        let (by, unit) = if *unit == "rad" { (1f64.to_degrees(), "°") } else { (1.0, *unit) };
        let error = |e: &HorizonError| by * error(e);
        let values = ladder.iter().flat_map(|r| r.training.iter().chain(&r.held_out)).map(&error);
        let (low, high) =
            values.filter(|v| drawn(*v)).fold((f64::INFINITY, 0.0f64), |(l, h), v| (l.min(v), h.max(v)));
        if high == 0.0 {
            let middle = [left + 0.5 * width, top + 0.5 * height];
            self.text(middle, 20.0, false, SOFT, Anchor::Middle, "no error to show");
            return;
        }
        // At least half a decade, and room at both ends.
        let grow = (3.2 / (high / low)).max(1.0).sqrt() * 1.3;
        let axis = LogAxis { low: low / grow, high: high * grow, top, height };
        for tick in axis.ticks() {
            let y = axis.y(tick);
            self.line(&[[left, y], [left + width, y]], GRID, 1.5, false);
            let words =
                if unit == "°" { format!("{}°", significant(tick, 1)) } else { quantity(tick, unit, 1) };
            self.text([left - 12.0, y + 6.0], 17.0, false, SOFT, Anchor::End, &words);
        }
        self.line(&[[left, top + height], [left + width, top + height]], SOFT, 1.5, false);
        let slot = width / ladder.len() as f32;
        let x = |k: usize| left + slot * (k as f32 + 0.5);
        for (k, rung) in ladder.iter().enumerate() {
            self.line(&[[x(k), top + height], [x(k), top + height + 6.0]], SOFT, 1.5, false);
            for (row, line) in self.lines(&rung.label, 17.0, slot - 10.0, 2).iter().enumerate() {
                let y = top + height + 27.0 + 21.0 * row as f32;
                self.text([x(k), y], 17.0, false, INK, Anchor::Middle, line);
            }
        }
        // Flight of the fit first, so that the unseen one lies on top.
        for held_out in [false, true] {
            for (k, h) in horizons.iter().enumerate() {
                let points: Vec<Option<[f32; 2]>> = ladder
                    .iter()
                    .enumerate()
                    .map(|(i, r)| {
                        let errors = if held_out { &r.held_out } else { &r.training };
                        at(errors, *h).map(&error).filter(|v| drawn(*v)).map(|v| [x(i), axis.y(v)])
                    })
                    .collect();
                let ink = LINES[k % LINES.len()];
                for pair in points.windows(2) {
                    if let [Some(a), Some(b)] = pair {
                        self.line(&[*a, *b], ink, if held_out { 3.5 } else { 2.5 }, !held_out);
                    }
                }
                for p in points.into_iter().flatten() {
                    self.marker(p, k, ink, held_out);
                }
            }
        }
    }

    /// A disc, square, diamond or triangle, one per line; hollow for the flight of the fit.
    fn marker(&mut self, [x, y]: [f32; 2], shape: usize, ink: [u8; 3], filled: bool) {
        let r = 7.0;
        let corners: &[[f32; 2]] = match shape % 4 {
            0 => &[],
            1 => &[[-0.9, -0.9], [0.9, -0.9], [0.9, 0.9], [-0.9, 0.9]],
            2 => &[[0.0, -1.25], [1.25, 0.0], [0.0, 1.25], [-1.25, 0.0]],
            _ => &[[0.0, -1.15], [1.1, 0.85], [-1.1, 0.85]],
        };
        let mut path = PathBuilder::new();
        if corners.is_empty() {
            path.push_circle(x, y, r);
        } else {
            for (k, [dx, dy]) in corners.iter().enumerate() {
                let (px, py) = (x + r * dx, y + r * dy);
                if k == 0 { path.move_to(px, py) } else { path.line_to(px, py) }
            }
            path.close();
        }
        if let Some(path) = path.finish() {
            self.fill(&path, if filled { ink } else { PAPER });
            self.stroke(&path, ink, 2.5, false);
        }
    }

    fn line(&mut self, points: &[[f32; 2]], ink: [u8; 3], width: f32, dashed: bool) {
        let mut path = PathBuilder::new();
        for (k, [x, y]) in points.iter().enumerate() {
            if k == 0 { path.move_to(*x, *y) } else { path.line_to(*x, *y) }
        }
        if let Some(path) = path.finish() {
            self.stroke(&path, ink, width, dashed);
        }
    }

    fn stroke(&mut self, path: &Path, ink: [u8; 3], width: f32, dashed: bool) {
        let stroke = Stroke {
            width,
            line_cap: LineCap::Butt,
            line_join: LineJoin::Round,
            dash: if dashed { StrokeDash::new(vec![9.0, 6.0], 0.0) } else { None },
            ..Stroke::default()
        };
        self.pixels.stroke_path(path, &paint(ink), &stroke, Transform::identity(), None);
    }

    fn fill(&mut self, path: &Path, ink: [u8; 3]) {
        self.pixels.fill_path(path, &paint(ink), FillRule::Winding, Transform::identity(), None);
    }

    fn face(&self, bold: bool) -> &Face<'_> {
        if bold { &self.bold } else { &self.regular }
    }

    /// Width of a line of text, pixels. `size` is that of the em square.
    fn width(&self, words: &str, size: f32, bold: bool) -> f32 {
        let face = self.face(bold);
        let units: f32 = words.chars().map(|c| advance(face, c)).sum();
        units * size / f32::from(face.units_per_em())
    }

    /// Text on a baseline.
    fn text(&mut self, at: [f32; 2], size: f32, bold: bool, ink: [u8; 3], anchor: Anchor, words: &str) {
        let shift = match anchor {
            Anchor::Start => 0.0,
            Anchor::Middle => 0.5 * self.width(words, size, bold),
            Anchor::End => self.width(words, size, bold),
        };
        let face = self.face(bold);
        let scale = size / f32::from(face.units_per_em());
        let mut pen = Outline { path: PathBuilder::new(), x: at[0] - shift, y: at[1], scale };
        for c in words.chars() {
            if let Some(glyph) = face.glyph_index(c).or_else(|| face.glyph_index('?')) {
                face.outline_glyph(glyph, &mut pen);
            }
            pen.x += advance(face, c) * scale;
        }
        if let Some(path) = pen.path.finish() {
            self.fill(&path, ink);
        }
    }

    /// Words broken into at most `most` lines of a width; an ellipsis where they are cut.
    fn lines(&self, words: &str, size: f32, wide: f32, most: usize) -> Vec<String> {
        let mut lines: Vec<String> = Vec::new();
        let mut words = words.split_whitespace().peekable();
        while let Some(word) = words.next() {
            let longer = lines.last().map(|l| format!("{l} {word}"));
            match longer.filter(|l| self.width(l, size, false) <= wide) {
                Some(longer) => {
                    lines.pop();
                    lines.push(longer);
                }
                None if lines.len() < most => lines.push(word.to_string()),
                None => {
                    let rest = words.by_ref().fold(word.to_string(), |all, w| format!("{all} {w}"));
                    let last = lines.pop().unwrap_or_default();
                    lines.push(format!("{last} {rest}"));
                }
            }
        }
        lines.iter().map(|l| self.shortened(l, size, false, wide)).collect()
    }

    /// Text cut to a width, with an ellipsis where it is cut.
    fn shortened(&self, words: &str, size: f32, bold: bool, wide: f32) -> String {
        if self.width(words, size, bold) <= wide {
            return words.to_string();
        }
        let mut kept: Vec<char> = words.chars().collect();
        loop {
            kept.pop();
            let short: String = kept.iter().chain(&['…']).collect();
            if kept.is_empty() || self.width(&short, size, bold) <= wide {
                return short;
            }
        }
    }
}

fn advance(face: &Face, c: char) -> f32 {
    let glyph = face.glyph_index(c).or_else(|| face.glyph_index('?'));
    f32::from(glyph.and_then(|g| face.glyph_hor_advance(g)).unwrap_or(0))
}

fn color([r, g, b]: [u8; 3]) -> Color {
    Color::from_rgba8(r, g, b, 255)
}

fn paint(ink: [u8; 3]) -> Paint<'static> {
    let mut paint = Paint { anti_alias: true, ..Paint::default() };
    paint.set_color(color(ink));
    paint
}

/// Letters as a path; font units with y up become pixels with y down.
struct Outline {
    path: PathBuilder,
    x: f32,
    y: f32,
    scale: f32,
}

impl Outline {
    fn at(&self, x: f32, y: f32) -> (f32, f32) {
        (self.x + self.scale * x, self.y - self.scale * y)
    }
}

impl OutlineBuilder for Outline {
    fn move_to(&mut self, x: f32, y: f32) {
        let (x, y) = self.at(x, y);
        self.path.move_to(x, y);
    }

    fn line_to(&mut self, x: f32, y: f32) {
        let (x, y) = self.at(x, y);
        self.path.line_to(x, y);
    }

    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        let ((x1, y1), (x, y)) = (self.at(x1, y1), self.at(x, y));
        self.path.quad_to(x1, y1, x, y);
    }

    fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
        let ((x1, y1), (x2, y2), (x, y)) = (self.at(x1, y1), self.at(x2, y2), self.at(x, y));
        self.path.cubic_to(x1, y1, x2, y2, x, y);
    }

    fn close(&mut self) {
        self.path.close();
    }
}
