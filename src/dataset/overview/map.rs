//! The scene from above with paths, starts and contacts.

use crate::picture::{Anchor, Canvas, Ink, tick_label, ticks};

use super::colors::{CLEARANCE_FAR_M, CLEARANCE_NEAR_M, clearance_color};
use super::{DRAWING_X, HeightMap, INK, Overview, RIGHT_END, RIGHT_X, RULE, words};

/// Where nothing is.
const NOTHING: Ink = [253, 253, 253];
/// Top and greatest height of the map, pixels.
const TOP: f32 = 138.0;
const HIGH: f32 = 524.0;
/// Top and width of the scale of clearances.
const SCALE_Y: f32 = 704.0;
const SCALE_W: usize = 180;

/// Where the map is on the picture, in whole pixels, and pixels of a metre.
struct Frame<'a> {
    map: &'a HeightMap,
    x: f32,
    y: f32,
    w: f32,
    h: f32,
    scale: f64,
}

impl<'a> Frame<'a> {
    /// The largest that fits, in the middle of its room.
    fn of(map: &'a HeightMap) -> Self {
        let (wide, deep) = (map.x_m[1] - map.x_m[0], map.y_m[1] - map.y_m[0]);
        let room = RIGHT_END - DRAWING_X;
        let scale = (f64::from(room) / wide).min(f64::from(HIGH) / deep);
        let (w, h) = ((wide * scale).floor().max(2.0) as f32, (deep * scale).floor().max(2.0) as f32);
        let (x, y) = ((DRAWING_X + 0.5 * (room - w)).floor(), (TOP + 0.5 * (HIGH - h)).floor());
        Self { map, x, y, w, h, scale }
    }

    /// Pixels of a place x, y, m, world.
    fn place(&self, at: [f64; 2]) -> [f32; 2] {
        let [x, y] = [at[0] - self.map.x_m[0], self.map.y_m[1] - at[1]].map(|v| (v * self.scale) as f32);
        [self.x + x, self.y + y]
    }
}

impl Overview {
    /// The map with its legend.
    pub(super) fn draw_map(&self, canvas: &mut Canvas) {
        let heading = "From above: paths by clearance, x and y in m";
        words(canvas, RIGHT_X, 108.0, INK, Anchor::Start, heading);
        let frame = Frame::of(&self.map);
        draw_heights(canvas, &frame);
        draw_axes(canvas, &frame);
        canvas.clip(Some([frame.x, frame.y, frame.w, frame.h]));
        self.draw_paths(canvas, &frame);
        self.draw_marks(canvas, &frame);
        canvas.clip(None);
        self.draw_legend(canvas);
    }

    /// Paths; the nearest passes are drawn last, so that they stay visible where paths cross.
    fn draw_paths(&self, canvas: &mut Canvas, frame: &Frame) {
        let mut pieces: Vec<(f64, [[f32; 2]; 2])> = Vec::new();
        for path in &self.paths {
            for i in 1..path.xy_m.len() {
                let (a, b) = (path.xy_m[i - 1], path.xy_m[i]);
                if a.iter().chain(&b).all(|v| v.is_finite()) {
                    let near = path.clearance_m[i - 1].min(path.clearance_m[i]);
                    pieces.push((near, [frame.place(a), frame.place(b)]));
                }
            }
        }
        pieces.sort_by(|a, b| b.0.total_cmp(&a.0));
        let thick = if self.paths.len() > 60 { 1.6 } else { 2.4 };
        for (near, ends) in pieces {
            canvas.line(&ends, clearance_color(near), thick, false);
        }
    }

    /// Starts and contacts, smaller where there are many.
    fn draw_marks(&self, canvas: &mut Canvas, frame: &Frame) {
        let radius = if self.paths.len() > 60 { 2.6 } else { 5.0 };
        for path in &self.paths {
            if let Some(start) = path.xy_m.first().filter(|p| p.iter().all(|v| v.is_finite())) {
                ring(canvas, frame.place(*start), radius);
            }
        }
        let half = if self.contacts.len() > 120 { 3.0 } else { 5.0 };
        for (_, at) in self.contacts.iter().filter(|(_, at)| at.iter().all(|v| v.is_finite())) {
            // White below, so that it is seen on dark things.
            canvas.cross(frame.place(*at), half, 0.5 * half + 2.0, [255; 3]);
            canvas.cross(frame.place(*at), half, 0.3 * half + 0.7, INK);
        }
    }

    /// The scale of clearances, and what the marks mean.
    fn draw_legend(&self, canvas: &mut Canvas) {
        let last = (SCALE_W - 1) as f32;
        let ratio = CLEARANCE_FAR_M / CLEARANCE_NEAR_M;
        for i in 0..SCALE_W {
            let clearance_m = CLEARANCE_NEAR_M * ratio.powf(i as f64 / f64::from(last));
            canvas.rect([DRAWING_X + i as f32, SCALE_Y, 1.0, 14.0], clearance_color(clearance_m));
        }
        for (at, label) in [(0.0, "0.1"), (0.477, "0.3"), (1.0, "1 m")] {
            let x = (DRAWING_X + at * SCALE_W as f32).floor();
            words(canvas, x, SCALE_Y + 17.0, INK, Anchor::Middle, label);
        }
        let mut x = DRAWING_X + SCALE_W as f32 + 36.0;
        let middle = SCALE_Y + 8.0;
        ring(canvas, [x, middle], 5.0);
        words(canvas, x + 14.0, SCALE_Y - 2.0, INK, Anchor::Start, "start");
        x += 100.0;
        canvas.cross([x, middle], 5.0, 2.2, INK);
        let label = format!("contact ({})", self.contacts.len());
        words(canvas, x + 14.0, SCALE_Y - 2.0, INK, Anchor::Start, &label);
    }
}

/// Where a path starts.
fn ring(canvas: &mut Canvas, at: [f32; 2], radius: f32) {
    canvas.disc(at, radius + 1.4, INK);
    canvas.disc(at, radius, [255; 3]);
}

/// Heights as grey, in light from the north-west.
fn draw_heights(canvas: &mut Canvas, frame: &Frame) {
    let m = frame.map;
    let seen = || m.heights_m.iter().copied().filter(|h| h.is_finite());
    let (low, high) = (seen().fold(f32::INFINITY, f32::min), seen().fold(f32::NEG_INFINITY, f32::max));
    let cell = [(m.x_m[1] - m.x_m[0]) / m.columns as f64, (m.y_m[1] - m.y_m[0]) / m.rows as f64];
    let rect = [frame.x, frame.y, frame.w, frame.h].map(|v| v as usize);
    canvas.image(rect, (m.columns, m.rows), |row, column| {
        let at = |r: usize, c: usize| m.heights_m[r.min(m.rows - 1) * m.columns + c.min(m.columns - 1)];
        let here = at(row, column);
        if !here.is_finite() {
            return NOTHING;
        }
        // Light from the north-west, 45° high; a wall's slope counts as 60° at most.
        let slope = |a: f32, b: f32, step: f64| {
            let rise = f64::from(a - b) / step;
            if rise.is_finite() { rise.clamp(-1.7, 1.7) } else { 0.0 }
        };
        let east = slope(at(row, column + 1), at(row, column.saturating_sub(1)), 2.0 * cell[0]);
        let north = slope(at(row.saturating_sub(1), column), at(row + 1, column), 2.0 * cell[1]);
        // Normal (-east, -north, 1), light (-1, 1, √2)/2; flat ground is 1.
        let light = (1.0 + std::f64::consts::FRAC_1_SQRT_2 * (east - north))
            / (1.0 + east * east + north * north).sqrt();
        let tall = if high > low { f64::from((here - low) / (high - low)) } else { 0.0 };
        let grey = (0.93 - 0.50 * tall.sqrt()) * (0.72 + 0.28 * light.clamp(0.0, 1.4));
        [(grey.clamp(0.0, 0.97) * 255.0).round() as u8; 3]
    });
}

/// The frame of the map, and round numbers along it.
fn draw_axes(canvas: &mut Canvas, frame: &Frame) {
    canvas.outline([frame.x, frame.y, frame.w, frame.h], RULE);
    let across = ticks(frame.map.x_m[0], frame.map.x_m[1], (frame.w / 90.0).clamp(2.0, 8.0) as usize);
    for mark in &across {
        let x = frame.place([*mark, 0.0])[0].round();
        let below = frame.y + frame.h;
        canvas.rect([x, below + 1.0, 1.0, 5.0], INK);
        words(canvas, x, below + 8.0, INK, Anchor::Middle, &tick_label(*mark, &across));
    }
    let up = ticks(frame.map.y_m[0], frame.map.y_m[1], (frame.h / 60.0).clamp(2.0, 8.0) as usize);
    for mark in &up {
        let y = frame.place([0.0, *mark])[1].round();
        canvas.rect([frame.x - 6.0, y, 5.0, 1.0], INK);
        words(canvas, frame.x - 10.0, y - 10.0, INK, Anchor::End, &tick_label(*mark, &up));
    }
}
