//! A picture with lines, markers and text.

use tiny_skia::{
    Color, FillRule, LineCap, LineJoin, Paint, PathBuilder, Pixmap, Stroke, StrokeDash, Transform,
};
use ttf_parser::{Face, GlyphId, OutlineBuilder};

use super::common::Fallible;

const REGULAR: &[u8] = include_bytes!("../../assets/report/DejaVuSans.subset.ttf");
const BOLD: &[u8] = include_bytes!("../../assets/report/DejaVuSans-Bold.subset.ttf");

/// Red, green, blue.
pub type Ink = [u8; 3];

/// Which part of a text stands at its place.
#[derive(Clone, Copy)]
pub enum Anchor {
    Start,
    Middle,
    End,
}

/// White paper.
pub struct Canvas {
    pixels: Pixmap,
    regular: Face<'static>,
    bold: Face<'static>,
}

impl Canvas {
    /// Paper of a size in pixels.
    pub fn new(width: u32, height: u32) -> Fallible<Self> {
        let mut pixels = Pixmap::new(width, height).ok_or("no memory for the picture")?;
        pixels.fill(Color::WHITE);
        Ok(Self { pixels, regular: Face::parse(REGULAR, 0)?, bold: Face::parse(BOLD, 0)? })
    }

    /// The picture as PNG.
    pub fn encode(&self) -> Fallible<Vec<u8>> {
        let mut out = Vec::new();
        let mut encoder = png::Encoder::new(&mut out, self.pixels.width(), self.pixels.height());
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::High);
        let rgb: Vec<u8> = self.pixels.data().chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&rgb)?;
        writer.finish()?;
        Ok(out)
    }

    /// A line through points, as wide as said, dashed or not.
    pub fn line(&mut self, points: &[[f32; 2]], ink: Ink, width: f32, dashed: bool) {
        let mut path = PathBuilder::new();
        for (k, [x, y]) in points.iter().enumerate() {
            if k == 0 { path.move_to(*x, *y) } else { path.line_to(*x, *y) }
        }
        // A single point is no path.
        let Some(path) = path.finish() else { return };
        let stroke = Stroke {
            width,
            line_cap: LineCap::Round,
            line_join: LineJoin::Round,
            dash: if dashed { StrokeDash::new(vec![2.5 * width, 2.5 * width], 0.0) } else { None },
            ..Stroke::default()
        };
        self.pixels.stroke_path(&path, &paint(ink), &stroke, Transform::identity(), None);
    }

    /// A disc; hollow ones are white inside.
    pub fn disc(&mut self, [x, y]: [f32; 2], radius: f32, ink: Ink, hollow: bool) {
        for (radius, ink) in
            [(radius, ink), (0.55 * radius, [255; 3])].into_iter().take(1 + usize::from(hollow))
        {
            if let Some(path) = PathBuilder::from_circle(x, y, radius) {
                self.pixels.fill_path(&path, &paint(ink), FillRule::Winding, Transform::identity(), None);
            }
        }
    }

    /// A line of text on its base line; its width.
    pub fn text(
        &mut self,
        at: [f32; 2],
        size: f32,
        bold: bool,
        ink: Ink,
        anchor: Anchor,
        words: &str,
    ) -> f32 {
        let face = if bold { &self.bold } else { &self.regular };
        let scale = size / f32::from(face.units_per_em());
        let glyphs: Vec<GlyphId> = words.chars().map(|c| face.glyph_index(c).unwrap_or_default()).collect();
        let advance = |glyph: GlyphId| f32::from(face.glyph_hor_advance(glyph).unwrap_or(0)) * scale;
        let width: f32 = glyphs.iter().map(|glyph| advance(*glyph)).sum();
        let mut x = match anchor {
            Anchor::Start => at[0],
            Anchor::Middle => at[0] - 0.5 * width,
            Anchor::End => at[0] - width,
        };
        let mut outline = Outline { path: PathBuilder::new(), x, y: at[1], scale };
        for glyph in glyphs {
            outline.x = x;
            // Spaces have no outline.
            let _ = face.outline_glyph(glyph, &mut outline);
            x += advance(glyph);
        }
        if let Some(path) = outline.path.finish() {
            self.pixels.fill_path(&path, &paint(ink), FillRule::Winding, Transform::identity(), None);
        }
        width
    }
}

fn paint([r, g, b]: Ink) -> Paint<'static> {
    let mut paint = Paint { anti_alias: true, ..Paint::default() };
    paint.set_color_rgba8(r, g, b, 255);
    paint
}

/// Letters as a path: y of a font goes up, y of a picture down.
struct Outline {
    path: PathBuilder,
    x: f32,
    y: f32,
    scale: f32,
}

impl Outline {
    fn at(&self, x: f32, y: f32) -> (f32, f32) {
        (self.x + x * self.scale, self.y - y * self.scale)
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
