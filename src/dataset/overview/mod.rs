//! One picture of a data set: what the cameras saw, where the drones flew, how near they came.

mod clearance;
mod colors;
mod gather;
mod map;
mod sheet;

use std::io::Write;
use std::path::Path;

use crate::picture::{Anchor, Canvas, Effort, Ink, PictureError, rgb_png};

use super::depth_png::status;
use super::error::{DatasetError, Result};
use crate::flight::files;
use colors::{COLOR_MISS, COLOR_TOO_FAR, COLOR_TOO_NEAR, depth_color};

/// Size of the picture, pixels.
pub const OVERVIEW_SIZE: (usize, usize) = (1600, 1100);

/// The scene from above: height of the highest surface over a grid, as seen by rays that go straight down.
#[derive(Clone, Debug, PartialEq)]
pub struct HeightMap {
    /// Edges in x, m, world; columns run from the first to the second.
    pub x_m: [f64; 2],
    /// Edges in y, m, world; row 0 is at the second (top), the last row at the first.
    pub y_m: [f64; 2],
    /// Columns.
    pub columns: usize,
    /// Rows.
    pub rows: usize,
    /// Heights, m, NaN where nothing is, shape `(row, column)`.
    pub heights_m: Vec<f32>,
}

/// One frame on the contact sheet.
#[derive(Clone, Debug, PartialEq)]
pub struct SheetFrame {
    /// World.
    pub world: usize,
    /// Drone.
    pub drone: usize,
    /// Seconds since the start.
    pub t_s: f64,
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Depth, m, shape `(row, column)`.
    pub depth_m: Vec<f32>,
    /// Pixel statuses, shape `(row, column)`.
    pub status: Vec<u8>,
    /// Geoms, shape `(row, column)`.
    pub geom_id: Vec<i32>,
}

/// The path of one drone in one world.
#[derive(Clone, Debug, PartialEq)]
pub struct PathLine {
    /// Seconds since the start, shape `(point,)`.
    pub t_s: Vec<f64>,
    /// Positions x, y, m, world, shape `(point,)`.
    pub xy_m: Vec<[f64; 2]>,
    /// Clearance, m, infinite beyond the range of the search, NaN not measured, shape `(point,)`.
    pub clearance_m: Vec<f64>,
}

/// Everything that the picture shows.
#[derive(Clone, Debug, PartialEq)]
pub struct Overview {
    /// Headline.
    pub title: String,
    /// Line below it.
    pub subtitle: String,
    /// Heading of the contact sheet.
    pub sheet_heading: String,
    /// Up to twelve frames.
    pub frames: Vec<SheetFrame>,
    /// Paths, one per drone and world.
    pub paths: Vec<PathLine>,
    /// Beginnings of contacts: time (s) and place x, y (m, world).
    pub contacts: Vec<(f64, [f64; 2])>,
    /// The scene from above.
    pub map: HeightMap,
    /// Flight time, s.
    pub seconds: f64,
    /// Largest clearance that was looked for, m.
    pub clearance_max_m: f64,
    /// Up to four lines of text.
    pub notes: Vec<String>,
}

/// The drawn picture, 8-bit RGB.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Shape `(row, column, 3)`.
    pub rgb: Vec<u8>,
}

impl Picture {
    /// A depth image for eyes: near is light, far is dark, from the nearest to the farthest hit.
    pub fn of_depth(width: usize, height: usize, depth_m: &[f32], statuses: &[u8]) -> Self {
        let hits =
            || depth_m.iter().zip(statuses).filter(|(_, s)| **s == status::HIT).map(|(d, _)| f64::from(*d));
        let (low, high) = hits().fold((f64::INFINITY, 0.0f64), |(a, b), d| (a.min(d), b.max(d)));
        let color = |(depth, pixel): (&f32, &u8)| match *pixel {
            status::HIT => depth_color((f64::from(*depth) - low) / (high - low).max(1e-9)),
            status::TOO_FAR => COLOR_TOO_FAR,
            status::TOO_NEAR => COLOR_TOO_NEAR,
            _ => COLOR_MISS,
        };
        Self { width, height, rgb: depth_m.iter().zip(statuses).flat_map(color).collect() }
    }

    /// Writes the picture as PNG; it is there either whole or not at all.
    pub fn save(&self, path: &Path) -> Result<()> {
        let failed = |e: PictureError| DatasetError::damaged(path, "a picture that PNG can hold", e);
        let bytes =
            rgb_png(self.width as u32, self.height as u32, &self.rgb, Effort::Balanced).map_err(failed)?;
        files::write(path, true, |file| file.write_all(&bytes)).map_err(DatasetError::io(path))
    }
}

const PAGE: Ink = [252, 252, 250];
const INK: Ink = [28, 30, 34];
const SOFT: Ink = [105, 108, 114];
const RULE: Ink = [200, 202, 206];
const MARGIN: f32 = 28.0;
/// Left edge of the right column.
const RIGHT_X: f32 = 936.0;
/// Left edge of the drawings in the right column: labels of axes stand before it.
const DRAWING_X: f32 = RIGHT_X + 50.0;
/// Right edge of the right column.
const RIGHT_END: f32 = OVERVIEW_SIZE.0 as f32 - MARGIN;
/// Size of letters of a line of text, and how far its baseline is below its top, pixels.
const TEXT: f32 = 17.0;
const BASE: f32 = 15.0;

impl Overview {
    fn check(&self) -> Result<()> {
        let bad = |item: String, expected: String, found: String| {
            Err(DatasetError::Overview { item, expected, found })
        };
        for (i, f) in self.frames.iter().enumerate() {
            let n = f.width * f.height;
            let sizes = [f.depth_m.len(), f.status.len(), f.geom_id.len()];
            if n == 0 || sizes != [n; 3] {
                return bad(format!("frame {i}"), format!("{n} pixels, above 0"), format!("{sizes:?}"));
            }
        }
        for (i, p) in self.paths.iter().enumerate() {
            let sizes = [p.t_s.len(), p.xy_m.len(), p.clearance_m.len()];
            if sizes != [sizes[0]; 3] {
                return bad(
                    format!("path {i}"),
                    "as many times as places and clearances".into(),
                    format!("{sizes:?}"),
                );
            }
        }
        let m = &self.map;
        if m.columns == 0 || m.rows == 0 || m.heights_m.len() != m.columns * m.rows {
            let expected = format!("{} × {} heights, above 0", m.rows, m.columns);
            return bad("height map".into(), expected, m.heights_m.len().to_string());
        }
        for edges in [m.x_m, m.y_m] {
            if !(edges[0].is_finite() && edges[1].is_finite() && edges[0] < edges[1]) {
                return bad("height map".into(), "edges in rising order".into(), format!("{edges:?}"));
            }
        }
        if !(self.seconds.is_finite() && self.seconds > 0.0) {
            return bad("flight time".into(), "above 0 s".into(), self.seconds.to_string());
        }
        Ok(())
    }

    /// Draws the picture, 1600 × 1100 pixels. Errors when lengths do not match or a size is zero.
    pub fn draw(&self) -> Result<Picture> {
        self.check()?;
        let (width, height) = OVERVIEW_SIZE;
        let failed = |e: PictureError| DatasetError::Overview {
            item: "the picture".into(),
            expected: format!("{width} × {height} pixels that can be drawn"),
            found: e.to_string(),
        };
        let mut canvas = Canvas::new(width as u32, height as u32, PAGE).map_err(failed)?;
        self.draw_head(&mut canvas);
        self.draw_sheet(&mut canvas);
        self.draw_map(&mut canvas);
        self.draw_clearance(&mut canvas);
        for (i, line) in self.notes.iter().take(4).enumerate() {
            let line = canvas.shortened(line, TEXT, false, RIGHT_X - 2.0 * MARGIN);
            words(&mut canvas, MARGIN, 1000.0 + 22.0 * i as f32, INK, Anchor::Start, &line);
        }
        Ok(Picture { width, height, rgb: canvas.rgb() })
    }

    /// Headline and the line below it.
    fn draw_head(&self, canvas: &mut Canvas) {
        let wide = RIGHT_END - MARGIN;
        // A long title is set smaller before it is cut.
        let size = (36.0 * wide / canvas.text_width(&self.title, 36.0, true).max(1.0)).clamp(22.0, 36.0);
        let title = canvas.shortened(&self.title, size, true, wide);
        canvas.text([MARGIN, 52.0], size, true, INK, Anchor::Start, &title);
        let subtitle = canvas.shortened(&self.subtitle, TEXT, false, wide);
        words(canvas, MARGIN, 66.0, SOFT, Anchor::Start, &subtitle);
        canvas.rect([MARGIN, 96.0, wide, 1.0], RULE);
    }
}

/// A line of text whose top is at `y`; its width.
fn words(canvas: &mut Canvas, x: f32, y: f32, ink: Ink, anchor: Anchor, words: &str) -> f32 {
    canvas.text([x, y + BASE], TEXT, false, ink, anchor, words)
}
