//! Paper to draw on. Places are pixels from the top left corner, y down.

use tiny_skia::{
    Color, FillRule, LineCap, LineJoin, Mask, Paint, Path, PathBuilder, Pixmap, PremultipliedColorU8, Rect,
    Stroke, StrokeDash, Transform,
};
use ttf_parser::Face;

use super::{Effort, Ink, PictureError, glyphs, rgb_png};

const REGULAR: &[u8] = include_bytes!("../../../assets/report/DejaVuSans.subset.ttf");
const BOLD: &[u8] = include_bytes!("../../../assets/report/DejaVuSans-Bold.subset.ttf");

/// Which part of a text stands at its place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    /// Its left end.
    Start,
    /// Its middle.
    Middle,
    /// Its right end.
    End,
}

/// Paper, and what was drawn on it.
pub struct Canvas {
    pixels: Pixmap,
    regular: Face<'static>,
    bold: Face<'static>,
    clip: Option<Mask>,
}

impl std::fmt::Debug for Canvas {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Canvas")
            .field("width", &self.pixels.width())
            .field("height", &self.pixels.height())
            .finish_non_exhaustive()
    }
}

impl Canvas {
    /// Paper of a size in pixels.
    ///
    /// # Errors
    /// [`PictureError::Size`] where a side is 0 or there is no memory for it.
    pub fn new(width: u32, height: u32, paper: Ink) -> Result<Self, PictureError> {
        let mut pixels = Pixmap::new(width, height).ok_or(PictureError::Size { width, height })?;
        let [r, g, b] = paper;
        pixels.fill(Color::from_rgba8(r, g, b, 255));
        let (regular, bold) = (Face::parse(REGULAR, 0)?, Face::parse(BOLD, 0)?);
        Ok(Self { pixels, regular, bold, clip: None })
    }

    /// Pixels of a row.
    pub fn width(&self) -> u32 {
        self.pixels.width()
    }

    /// Rows.
    pub fn height(&self) -> u32 {
        self.pixels.height()
    }

    /// The pixels, shape `(row, column, 3)`.
    pub fn rgb(&self) -> Vec<u8> {
        self.pixels.data().chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect()
    }

    /// The picture as PNG.
    ///
    /// # Errors
    /// [`PictureError::Png`].
    pub fn png(&self, effort: Effort) -> Result<Vec<u8>, PictureError> {
        rgb_png(self.width(), self.height(), &self.rgb(), effort)
    }

    /// Draws lines and discs within a rectangle (left, top, width, height) only, until called with none.
    pub fn clip(&mut self, to: Option<[f32; 4]>) {
        self.clip = to.and_then(|to| {
            let mut mask = Mask::new(self.pixels.width(), self.pixels.height())?;
            mask.fill_path(&rectangle(to)?, FillRule::Winding, false, Transform::identity());
            Some(mask)
        });
    }

    /// A filled rectangle: left, top, width, height.
    pub fn rect(&mut self, rect: [f32; 4], ink: Ink) {
        if let Some(path) = rectangle(rect) {
            self.fill(&path, ink);
        }
    }

    /// A frame one pixel wide just outside a rectangle.
    pub fn outline(&mut self, [x, y, w, h]: [f32; 4], ink: Ink) {
        self.rect([x - 1.0, y - 1.0, w + 2.0, 1.0], ink);
        self.rect([x - 1.0, y + h, w + 2.0, 1.0], ink);
        self.rect([x - 1.0, y - 1.0, 1.0, h + 2.0], ink);
        self.rect([x + w, y - 1.0, 1.0, h + 2.0], ink);
    }

    /// A line through points with round ends; dashed or not.
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
        self.pixels.stroke_path(&path, &paint(ink), &stroke, Transform::identity(), self.clip.as_ref());
    }

    /// A disc.
    pub fn disc(&mut self, [x, y]: [f32; 2], radius: f32, ink: Ink) {
        if let Some(path) = PathBuilder::from_circle(x, y, radius) {
            self.fill(&path, ink);
        }
    }

    /// A diagonal cross.
    pub fn cross(&mut self, [x, y]: [f32; 2], half: f32, width: f32, ink: Ink) {
        self.line(&[[x - half, y - half], [x + half, y + half]], ink, width, false);
        self.line(&[[x - half, y + half], [x + half, y - half]], ink, width, false);
    }

    /// An image of `size` (columns, rows) scaled into a rectangle of whole pixels: nearest pixel when larger, mean of the covered pixels
    /// when smaller. `ink` is asked for (row, column).
    pub fn image(
        &mut self,
        [left, top, w, h]: [usize; 4],
        size: (usize, usize),
        ink: impl Fn(usize, usize) -> Ink,
    ) {
        let covered = |i: usize, n: usize, size: usize| {
            let first = i * size / n;
            first..((i + 1) * size / n).max(first + 1)
        };
        let (wide, high) = (self.pixels.width() as usize, self.pixels.height() as usize);
        let pixels = self.pixels.pixels_mut();
        for y in (0..h).take_while(|y| top + y < high) {
            for x in (0..w).take_while(|x| left + x < wide) {
                let (mut sum, mut n) = ([0u32; 3], 0);
                for row in covered(y, h, size.1) {
                    for column in covered(x, w, size.0) {
                        let c = ink(row, column);
                        (0..3).for_each(|i| sum[i] += u32::from(c[i]));
                        n += 1;
                    }
                }
                let [r, g, b] = sum.map(|s| ((s + n / 2) / n) as u8);
                // With full opacity every colour is one.
                if let Some(pixel) = PremultipliedColorU8::from_rgba(r, g, b, 255) {
                    pixels[(top + y) * wide + left + x] = pixel;
                }
            }
        }
    }

    /// A line of text on its baseline; its width in pixels. `size` is that of the em square. Letters that the font lacks show as `?`.
    pub fn text(
        &mut self,
        at: [f32; 2],
        size: f32,
        bold: bool,
        ink: Ink,
        anchor: Anchor,
        words: &str,
    ) -> f32 {
        let width = self.text_width(words, size, bold);
        let left = match anchor {
            Anchor::Start => at[0],
            Anchor::Middle => at[0] - 0.5 * width,
            Anchor::End => at[0] - width,
        };
        if let Some(path) = glyphs::outline(self.face(bold), words, size, [left, at[1]]) {
            self.pixels.fill_path(&path, &paint(ink), FillRule::Winding, Transform::identity(), None);
        }
        width
    }

    /// Width of a line of text, pixels.
    pub fn text_width(&self, words: &str, size: f32, bold: bool) -> f32 {
        glyphs::width(self.face(bold), words, size)
    }

    /// Text cut to a width, with an ellipsis where text is cut.
    pub fn shortened(&self, words: &str, size: f32, bold: bool, wide: f32) -> String {
        if self.text_width(words, size, bold) <= wide {
            return words.to_string();
        }
        let mut kept: Vec<char> = words.chars().collect();
        loop {
            kept.pop();
            let short: String = kept.iter().chain(&['…']).collect();
            if kept.is_empty() || self.text_width(&short, size, bold) <= wide {
                return short;
            }
        }
    }

    /// Words broken into at most `most` lines of a width, as [`Self::text`] draws them; an ellipsis where text is cut.
    pub fn lines(&self, words: &str, size: f32, bold: bool, wide: f32, most: usize) -> Vec<String> {
        let mut lines: Vec<String> = Vec::new();
        let mut words = words.split_whitespace().peekable();
        while let Some(word) = words.next() {
            let longer = lines.last().map(|l| format!("{l} {word}"));
            match longer.filter(|l| self.text_width(l, size, bold) <= wide) {
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
        lines.iter().map(|l| self.shortened(l, size, bold, wide)).collect()
    }

    fn fill(&mut self, path: &Path, ink: Ink) {
        let (paint, clip) = (paint(ink), self.clip.as_ref());
        self.pixels.fill_path(path, &paint, FillRule::Winding, Transform::identity(), clip);
    }

    fn face(&self, bold: bool) -> &Face<'static> {
        if bold { &self.bold } else { &self.regular }
    }
}

fn rectangle([x, y, w, h]: [f32; 4]) -> Option<Path> {
    Rect::from_xywh(x, y, w, h).map(PathBuilder::from_rect)
}

fn paint([r, g, b]: Ink) -> Paint<'static> {
    let mut paint = Paint { anti_alias: true, ..Paint::default() };
    paint.set_color_rgba8(r, g, b, 255);
    paint
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(canvas: &Canvas, x: usize, y: usize) -> Ink {
        let first = 3 * (y * canvas.width() as usize + x);
        canvas.rgb()[first..first + 3].try_into().unwrap()
    }

    #[test]
    fn rectangles_are_sharp_and_lines_stay_in_their_clip() {
        let mut canvas = Canvas::new(20, 10, [255; 3]).unwrap();
        canvas.rect([2.0, 3.0, 4.0, 2.0], [10, 20, 30]);
        assert_eq!([at(&canvas, 2, 3), at(&canvas, 5, 4)], [[10, 20, 30]; 2]);
        assert_eq!([at(&canvas, 1, 3), at(&canvas, 6, 4), at(&canvas, 2, 5)], [[255; 3]; 3]);
        canvas.clip(Some([10.0, 0.0, 5.0, 10.0]));
        canvas.line(&[[0.0, 8.0], [20.0, 8.0]], [0; 3], 2.0, false);
        canvas.clip(None);
        assert_eq!([at(&canvas, 10, 8), at(&canvas, 14, 8)], [[0; 3]; 2]);
        assert_eq!([at(&canvas, 9, 8), at(&canvas, 15, 8)], [[255; 3]; 2]);
    }

    #[test]
    fn images_grow_by_repetition_and_shrink_by_mean() {
        let mut canvas = Canvas::new(6, 4, [255; 3]).unwrap();
        let chess =
            |row: usize, column: usize| if (row + column).is_multiple_of(2) { [0; 3] } else { [200; 3] };
        canvas.image([0, 0, 4, 4], (2, 2), chess);
        assert_eq!([at(&canvas, 1, 1), at(&canvas, 2, 1), at(&canvas, 3, 3)], [[0; 3], [200; 3], [0; 3]]);
        canvas.image([4, 0, 2, 2], (4, 4), chess);
        assert_eq!([at(&canvas, 4, 0), at(&canvas, 5, 1)], [[100; 3]; 2]);
    }

    #[test]
    fn text_is_as_wide_as_said_and_cut_where_it_must_be() {
        let mut canvas = Canvas::new(300, 30, [255; 3]).unwrap();
        let width = canvas.text([290.0, 20.0], 18.0, false, [0; 3], Anchor::End, "0.25 m");
        let rgb = canvas.rgb();
        let drawn = rgb.chunks_exact(3).enumerate().filter(|(_, p)| p[0] < 200).map(|(i, _)| i % 300);
        let (first, last) = drawn.fold((300, 0), |(a, b), x| (a.min(x), b.max(x)));
        assert!(first as f32 >= 290.0 - width && last < 290, "{first} {last} {width}");
        let long = "a name that goes on and on and does not end";
        let short = canvas.shortened(long, 18.0, true, 120.0);
        assert!(short.ends_with('…') && canvas.text_width(&short, 18.0, true) <= 120.0, "{short}");
        assert_eq!(canvas.lines(long, 18.0, false, 150.0, 2).len(), 2);
        // A line of regular letters that just fits is two of bold ones, which are wider.
        let (words, size) = ("torque that the model lacks", 20.0);
        let wide = canvas.text_width(words, size, false) + 1.0;
        assert_eq!([false, true].map(|bold| canvas.lines(words, size, bold, wide, 2).len()), [1, 2]);
        assert!(
            canvas.lines(words, size, true, wide, 2).iter().all(|l| canvas.text_width(l, size, true) <= wide)
        );
        // What the font lacks is seen, not left out.
        assert_eq!(canvas.text_width("漢", 18.0, false), canvas.text_width("?", 18.0, false));
    }
}
