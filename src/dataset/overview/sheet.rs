//! The contact sheet: frames of depth and of geoms, and their scale.

use crate::picture::{Anchor, Canvas, Ink, round_up, tick_label, ticks};

use super::colors::{COLOR_MISS, COLOR_TOO_FAR, COLOR_TOO_NEAR, depth_color, geom_color};
use super::{INK, MARGIN, Overview, RIGHT_X, RULE, SOFT, SheetFrame, TEXT, words};
use crate::dataset::depth_png::status;

/// Rows and columns of the contact sheet.
pub(super) const SHEET: (usize, usize) = (4, 3);
/// Top of the first row, height of a row, pixels.
const TOP: usize = 138;
const ROW_H: usize = 196;
/// Place and width of the scale.
const SCALE_Y: f32 = 932.0;
const SCALE_W: usize = 400;

/// Colours of depths up to `end_m`, in 256 steps.
struct Scale {
    end_m: f64,
    table: Vec<Ink>,
}

impl Scale {
    /// It ends where 98 of 100 hits are: a few far ones must not darken all others.
    fn of(frames: &[SheetFrame]) -> Self {
        let pixels = frames.iter().flat_map(|f| f.depth_m.iter().zip(&f.status));
        let hits = pixels.filter(|(d, s)| **s == status::HIT && d.is_finite());
        let mut hits: Vec<f32> = hits.map(|(d, _)| *d).collect();
        hits.sort_by(f32::total_cmp);
        let end = hits.get(hits.len().saturating_sub(1) * 98 / 100).map_or(1.0, |d| f64::from(*d));
        let table = (0..=255).map(|i| depth_color(f64::from(i) / 255.0)).collect();
        Self { end_m: round_up(end.max(0.1)), table }
    }

    fn ink(&self, depth_m: f32, code: u8) -> Ink {
        match code {
            status::HIT => self.table[((f64::from(depth_m) / self.end_m).clamp(0.0, 1.0) * 255.0) as usize],
            status::TOO_FAR => COLOR_TOO_FAR,
            status::TOO_NEAR => COLOR_TOO_NEAR,
            _ => COLOR_MISS,
        }
    }
}

impl Overview {
    /// The contact sheet with its scale.
    pub(super) fn draw_sheet(&self, canvas: &mut Canvas) {
        let heading = if self.frames.is_empty() { "No images in this data set" } else { &self.sheet_heading };
        words(canvas, MARGIN, 108.0, INK, Anchor::Start, heading);
        if self.frames.is_empty() {
            return;
        }
        let scale = Scale::of(&self.frames);
        let several = self.frames.iter().any(|f| f.drone > 0);
        let cell_w = (RIGHT_X - MARGIN - 24.0) as usize / SHEET.1;
        for (i, frame) in self.frames.iter().take(SHEET.0 * SHEET.1).enumerate() {
            let at = [MARGIN as usize + i % SHEET.1 * cell_w, TOP + i / SHEET.1 * ROW_H];
            draw_frame(canvas, frame, at, &scale, several);
        }
        draw_scale(canvas, &scale);
    }
}

/// A frame: depth, geoms beside it in small, and a caption with its drone where there are `several`.
fn draw_frame(canvas: &mut Canvas, f: &SheetFrame, [x, y]: [usize; 2], scale: &Scale, several: bool) {
    // The caption stands right of square images and below wide ones, whichever lets the image be larger.
    let (beside, below) = (fit(f, 180, 182), fit(f, 202, 150));
    let wide = below.0 * below.1 > beside.0 * beside.1;
    let (w, h) = if wide { below } else { beside };
    canvas.image([x, y, w, h], (f.width, f.height), |row, column| {
        let at = row * f.width + column;
        scale.ink(f.depth_m[at], f.status[at])
    });
    let (small_w, small_h) = fit(f, if wide { 74 } else { 90 }, h / 2);
    canvas.image([x + w + 8, y, small_w, small_h], (f.width, f.height), |row, column| {
        geom_color(f.geom_id[row * f.width + column])
    });
    let mut lines = vec![format!("world {}", f.world), format!("{:.2} s", f.t_s)];
    if several {
        lines.push(format!("drone {}", f.drone));
    }
    if wide {
        let line = canvas.shortened(&lines.join(", "), TEXT, false, 280.0);
        words(canvas, x as f32, (y + h + 3) as f32, INK, Anchor::Start, &line);
    } else {
        for (k, line) in lines.iter().enumerate() {
            let at = (y + small_h + 8 + 22 * k) as f32;
            words(canvas, (x + w + 8) as f32, at, if k == 0 { INK } else { SOFT }, Anchor::Start, line);
        }
    }
}

/// The scale of depths, and the colours of pixels without one.
fn draw_scale(canvas: &mut Canvas, scale: &Scale) {
    for i in 0..SCALE_W {
        let ink = scale.table[i * 255 / (SCALE_W - 1)];
        canvas.rect([MARGIN + i as f32, SCALE_Y, 1.0, 22.0], ink);
    }
    let marks = ticks(0.0, scale.end_m, 5);
    for mark in &marks {
        let at = MARGIN + (mark / scale.end_m * (SCALE_W - 1) as f64).round() as f32;
        canvas.rect([at, SCALE_Y + 22.0, 1.0, 5.0], INK);
        let anchor = if *mark == 0.0 { Anchor::Start } else { Anchor::Middle };
        words(canvas, at, SCALE_Y + 29.0, INK, anchor, &tick_label(*mark, &marks));
    }
    let mut x = MARGIN + SCALE_W as f32;
    words(canvas, x + 14.0, SCALE_Y + 29.0, INK, Anchor::Start, "m");
    x += 60.0;
    for (ink, label) in [(COLOR_MISS, "nothing"), (COLOR_TOO_FAR, "too far"), (COLOR_TOO_NEAR, "too near")] {
        canvas.rect([x, SCALE_Y, 22.0, 22.0], ink);
        canvas.outline([x, SCALE_Y, 22.0, 22.0], RULE);
        x += 30.0 + words(canvas, x + 30.0, SCALE_Y + 1.0, INK, Anchor::Start, label) + 22.0;
    }
}

/// Largest size with the frame's aspect inside `w` × `h`.
fn fit(f: &SheetFrame, w: usize, h: usize) -> (usize, usize) {
    let (iw, ih) = (f.width as f64, f.height as f64);
    let scale = (w as f64 / iw).min(h as f64 / ih);
    (((iw * scale) as usize).max(2), ((ih * scale) as usize).max(2))
}
