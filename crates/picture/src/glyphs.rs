//! Letters as outlines.

use tiny_skia::{Path, PathBuilder};
use ttf_parser::{Face, OutlineBuilder};

/// Width of a letter in units of the font; letters that the font lacks show as `?`.
fn glyph(face: &Face, c: char) -> (Option<ttf_parser::GlyphId>, f32) {
    let glyph = face.glyph_index(c).or_else(|| face.glyph_index('?'));
    (glyph, f32::from(glyph.and_then(|g| face.glyph_hor_advance(g)).unwrap_or(0)))
}

/// Width of a line of text, pixels; `size` is that of the em square.
pub(super) fn width(face: &Face, words: &str, size: f32) -> f32 {
    let units: f32 = words.chars().map(|c| glyph(face, c).1).sum();
    units * size / f32::from(face.units_per_em())
}

/// A line of text that begins at `at` on its baseline; none where nothing is to be seen of it.
pub(super) fn outline(face: &Face, words: &str, size: f32, at: [f32; 2]) -> Option<Path> {
    let scale = size / f32::from(face.units_per_em());
    let mut pen = Outline { path: PathBuilder::new(), x: at[0], y: at[1], scale };
    for c in words.chars() {
        let (glyph, advance) = glyph(face, c);
        if let Some(glyph) = glyph {
            // Spaces have no outline.
            let _ = face.outline_glyph(glyph, &mut pen);
        }
        pen.x += advance * scale;
    }
    pen.path.finish()
}

/// Font units with y up become pixels with y down.
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
