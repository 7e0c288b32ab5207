//! The error ladder as a picture: a row per step with its name on the left, and for each measure a bar with its value and
//! its per cent of the nominal model.

use super::quantity::percent;
use super::rungs::{Measure, measures};
use crate::GapError;
use crate::headline::evidence;
use crate::verdict::Diagnosis;
use tiny_skia::{Color, FillRule, Paint, Path, PathBuilder, Pixmap, Transform};
use ttf_parser::{Face, OutlineBuilder};

/// Width of the picture, pixels; its height grows with the number of steps.
pub const LADDER_PNG_WIDTH: u32 = 1600;
/// Margin, height of the head with title, verdict and names of the measures, and height of a row, pixels.
const MARGIN: f32 = 70.0;
const HEAD: f32 = 262.0;
const ROW: f32 = 62.0;
/// Widest column of names, and distance between columns, pixels.
const NAMES: f32 = 400.0;
const GAP: f32 = 34.0;

const REGULAR: &[u8] = include_bytes!("../../../../assets/report/DejaVuSans.subset.ttf");
const BOLD: &[u8] = include_bytes!("../../../../assets/report/DejaVuSans-Bold.subset.ttf");

const PAPER: [u8; 3] = [255, 255, 255];
const INK: [u8; 3] = [28, 32, 38];
const SOFT: [u8; 3] = [96, 104, 116];
const GRID: [u8; 3] = [226, 229, 234];
/// Colours of the nominal and the completed model, distinct for colour-blind readers: M. Okabe and K. Ito, "Color Universal
/// Design", 2008.
const FILED: [u8; 3] = [213, 94, 0];
const FOUND: [u8; 3] = [0, 114, 178];

/// The ladder of a diagnosis as a PNG image, [`LADDER_PNG_WIDTH`] wide.
///
/// # Errors
/// [`GapError::Numbers`] where the image cannot be drawn or encoded.
pub fn ladder_png(diagnosis: &Diagnosis) -> Result<Vec<u8>, GapError> {
    let measures = measures(&diagnosis.ladder);
    let rows = if measures.is_empty() { 1 } else { diagnosis.ladder.len() };
    let mut page = Page::new((HEAD + ROW * rows as f32 + MARGIN) as u32)?;
    page.heading(
        &format!("Error ladder of {}", diagnosis.vehicle),
        &diagnosis.headline,
        &evidence(diagnosis),
    );
    if measures.is_empty() {
        page.text([MARGIN, HEAD], 24.0, false, SOFT, Anchor::Start, "No roll-outs were made.");
        return page.encode();
    }
    let labels: Vec<String> = diagnosis.ladder.iter().map(|r| r.label.clone()).collect();
    let widest = labels.iter().map(|l| page.width(l, 21.0, false)).fold(0.0, f32::max);
    let names = widest.min(NAMES);
    for (k, label) in labels.iter().enumerate() {
        let lines = page.lines(label, 21.0, names, 2);
        let first = page.row(k) + if lines.len() == 1 { 7.0 } else { -5.0 };
        for (i, line) in lines.iter().enumerate() {
            page.text([MARGIN, first + 25.0 * i as f32], 21.0, false, INK, Anchor::Start, line);
        }
    }
    let left = MARGIN + names + GAP;
    let width = (LADDER_PNG_WIDTH as f32 - MARGIN - left + GAP) / measures.len() as f32 - GAP;
    for (k, measure) in measures.iter().enumerate() {
        page.bars(left + (width + GAP) * k as f32, width, measure);
    }
    page.foot(&measures);
    page.encode()
}

#[derive(Clone, Copy)]
enum Anchor {
    Start,
    End,
}

struct Page<'a> {
    pixels: Pixmap,
    regular: Face<'a>,
    bold: Face<'a>,
}

impl Page<'_> {
    fn new(height: u32) -> Result<Self, GapError> {
        let failed = |reason: String| GapError::Numbers { what: "the picture of the ladder", reason };
        let mut pixels = Pixmap::new(LADDER_PNG_WIDTH, height)
            .ok_or_else(|| failed("there is no memory for it".into()))?;
        pixels.fill(color(PAPER));
        let face = |data| Face::parse(data, 0).map_err(|e| failed(format!("the font cannot be read: {e}")));
        Ok(Self { pixels, regular: face(REGULAR)?, bold: face(BOLD)? })
    }

    fn encode(self) -> Result<Vec<u8>, GapError> {
        let mut out = Vec::new();
        let mut encoder = png::Encoder::new(&mut out, self.pixels.width(), self.pixels.height());
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

    fn heading(&mut self, title: &str, verdict: &str, evidence: &str) {
        let wide = LADDER_PNG_WIDTH as f32 - 2.0 * MARGIN;
        let title = self.shortened(title, 20.0, true, wide);
        self.text([MARGIN, 54.0], 20.0, true, SOFT, Anchor::Start, &title);
        // A headline of wide letters is set smaller, not cut: its end may say that something is unexplained.
        let size = (31.0 * wide / self.width(verdict, 31.0, true)).clamp(24.0, 31.0);
        let verdict = self.shortened(verdict, size, true, wide);
        self.text([MARGIN, 100.0], size, true, INK, Anchor::Start, &verdict);
        for (k, line) in self.lines(evidence, 20.0, wide, 2).iter().enumerate() {
            self.text([MARGIN, 138.0 + 27.0 * k as f32], 20.0, false, SOFT, Anchor::Start, line);
        }
    }

    /// Middle of a row.
    fn row(&self, k: usize) -> f32 {
        HEAD + ROW * (k as f32 + 0.5)
    }

    /// A column: name of the measure, and a bar per step with its value and its per cent of the first.
    fn bars(&mut self, left: f32, width: f32, measure: &Measure) {
        let lines = self.lines(&measure.name, 20.0, width, 2);
        for (i, line) in lines.iter().enumerate() {
            let y = HEAD - 16.0 - 25.0 * (lines.len() - 1 - i) as f32;
            self.text([left, y], 20.0, true, INK, Anchor::Start, line);
        }
        self.rectangle([left, HEAD - 4.0, width, 1.5], GRID);
        for k in 0..measure.values.len() {
            let y = self.row(k);
            self.text([left, y - 5.0], 19.0, k == 0, INK, Anchor::Start, &measure.words(k));
            self.text([left + width, y - 5.0], 19.0, false, SOFT, Anchor::End, &measure.share(k));
            self.rectangle([left, y + 4.0, width, 13.0], GRID);
            let Some(value) = measure.drawn(k).filter(|v| v.is_finite()) else { continue };
            let length = (width * measure.length(value) as f32).max(2.0);
            self.rectangle([left, y + 4.0, length, 13.0], if k == 0 { FILED } else { FOUND });
            // A mark for the value on the flight of the fit.
            if let ([Some(_), Some(seen)], true) = (measure.values[k], value > 0.0) {
                let at = left + width * measure.length(seen) as f32;
                self.rectangle([at.min(left + width - 3.0), y + 1.0, 3.0, 19.0], INK);
            }
        }
    }

    fn foot(&mut self, measures: &[Measure]) {
        let both = measures.iter().flat_map(|m| &m.values).any(|v| v[0].is_some() && v[1].is_some());
        let unseen = measures.iter().flat_map(|m| &m.values).any(|v| v[0].is_some());
        let words = match (both, unseen) {
            (true, _) => "Bars: flight that the fit has not seen; upright marks: the flight of the fit.",
            (false, true) => "On flight that the fit has not seen.",
            (false, false) => "On the flight of the fit.",
        };
        let words = format!("{words} Root mean squares; {} is the model as filed.", percent(1.0));
        let y = self.pixels.height() as f32 - 28.0;
        self.text([MARGIN, y], 17.0, false, SOFT, Anchor::Start, &words);
    }

    fn rectangle(&mut self, [x, y, width, height]: [f32; 4], ink: [u8; 3]) {
        if let Some(rect) = tiny_skia::Rect::from_xywh(x, y, width, height) {
            self.fill(&PathBuilder::from_rect(rect), ink);
        }
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

    /// Words broken into at most `most` lines of a width; an ellipsis where text is cut.
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

    /// Text cut to a width, with an ellipsis where text is cut.
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

/// Glyphs as a path; font units with y up become pixels with y down.
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
