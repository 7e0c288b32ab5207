//! One picture of a data set: what the cameras saw, where the drones flew, how near they came.

use std::collections::BTreeMap;
use std::io::{BufWriter, Write};
use std::path::Path;

use rayon::prelude::*;

use super::canvas::{Align, CHAR_W, Canvas, Rgb, TEXT_H, oklch, text_width, tick_label, ticks};
use super::depth_png::status;
use super::error::{DatasetError, Result};
use super::reader::{Dataset, WorldReader};
use crate::flight::files;
use crate::sense::DepthKind;

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
        let mut bytes = Vec::new();
        let mut encoder =
            png::Encoder::new(BufWriter::new(&mut bytes), self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::Balanced);
        let write = || -> Result<(), png::EncodingError> {
            let mut writer = encoder.write_header()?;
            writer.write_image_data(&self.rgb)?;
            writer.finish()
        };
        write().map_err(|e| DatasetError::damaged(path, "a picture that PNG can hold", e))?;
        files::write(path, true, |file| file.write_all(&bytes)).map_err(DatasetError::io(path))
    }
}

const PAGE: Rgb = [252, 252, 250];
const INK: Rgb = [28, 30, 34];
const SOFT: Rgb = [105, 108, 114];
const RULE: Rgb = [200, 202, 206];
const COLOR_MISS: Rgb = [226, 228, 232];
const COLOR_TOO_FAR: Rgb = [128, 131, 137];
const COLOR_TOO_NEAR: Rgb = [214, 40, 57];
const NOTHING: Rgb = [253, 253, 253];
const MARGIN: i32 = 28;
/// Left edge of the right column.
const RIGHT_X: i32 = 936;
/// Rows and columns of the contact sheet.
const SHEET: (usize, usize) = (4, 3);
/// Clearance at which a path is wholly red and wholly green, m.
const CLEARANCE_RED_M: f64 = 0.1;
const CLEARANCE_GREEN_M: f64 = 1.0;

/// Colour of depth from 0 (near, light yellow) to 1 (far, dark violet): even steps of OKLab lightness, hues from yellow
/// over green and blue to violet.
fn depth_color(share: f64) -> Rgb {
    let s = share.clamp(0.0, 1.0);
    oklch(0.93 - 0.70 * s, 0.10 + 0.12 * s * (1.0 - s), 105.0 + 200.0 * s)
}

/// Colour of clearance: red up to 0.1 m, over orange and yellow to green from 1 m on, even in the logarithm.
fn clearance_color(clearance_m: f64) -> Rgb {
    if clearance_m.is_nan() {
        return [90, 92, 98];
    }
    let s = clearance_share(clearance_m);
    oklch(0.58 + 0.68 * s * (1.0 - s), 0.19, 27.0 + 118.0 * s)
}

fn clearance_share(clearance_m: f64) -> f64 {
    let ratio = (clearance_m.max(1e-6) / CLEARANCE_RED_M).ln() / (CLEARANCE_GREEN_M / CLEARANCE_RED_M).ln();
    ratio.clamp(0.0, 1.0)
}

/// Colour of a geom: hues a golden angle apart, so that neighbours in number differ.
fn geom_color(id: i32) -> Rgb {
    if id < 0 {
        return COLOR_MISS;
    }
    let i = f64::from(id);
    oklch(0.52 + 0.11 * f64::from(id % 4), 0.13, (i * 137.508) % 360.0)
}

impl Overview {
    /// Collects from a finished data set what the picture shows. The scene from above comes from the caller.
    ///
    /// Frames: up to four worlds spread over all, three times each (more of each where there are fewer worlds). Paths are
    /// thinned to at most 400 points each.
    pub fn from_dataset(data: &Dataset, map: HeightMap) -> Result<Self> {
        let m = data.manifest();
        let worlds = data.worlds();
        if worlds.is_empty() {
            return Err(DatasetError::Overview {
                item: data.dir().display().to_string(),
                expected: "a data set with at least one finished world".into(),
                found: "none".into(),
            });
        }

        let mut frames = Vec::new();
        if !m.cameras.is_empty() {
            let n = worlds.len().min(SHEET.0);
            let per_world = SHEET.0 * SHEET.1 / n;
            for i in 0..n {
                let world = worlds[if n > 1 { i * (worlds.len() - 1) / (n - 1) } else { 0 }];
                frames.extend(sheet_frames(&data.world(world)?, world, m.n_drones, per_world)?);
            }
        }

        let gathered: Vec<Gathered> = worlds
            .par_iter()
            .map(|world| {
                gather(
                    &data.world(*world)?,
                    m.n_drones,
                    m.flight.clearance_every_steps > 0,
                    m.flight.contact_every_steps,
                )
            })
            .collect::<Result<_>>()?;
        let n_quarantined = gathered.iter().filter(|g| g.quarantined).count();
        let n_touching = gathered.iter().filter(|g| !g.contacts.is_empty()).count();
        let n_frames: u64 = gathered.iter().map(|g| g.n_frames).sum::<u64>() * m.n_drones as u64;
        let hits: u64 =
            frames.iter().flat_map(|f: &SheetFrame| &f.status).filter(|s| **s == status::HIT).count() as u64;
        let pixels: u64 = frames.iter().map(|f| f.status.len() as u64).sum();
        let length_m: f64 = gathered.iter().map(|g| g.length_m).sum();
        let top_speed = gathered.iter().map(|g| g.top_speed_m_s).fold(0.0, f64::max);
        let least = gathered
            .iter()
            .flat_map(|g| &g.paths)
            .flat_map(|p| &p.clearance_m)
            .copied()
            .filter(|c| !c.is_nan())
            .fold(f64::INFINITY, f64::min);
        let contacts: Vec<_> = gathered.iter().flat_map(|g| g.contacts.iter().copied()).collect();

        let plural = |n: usize, what: &str| format!("{n} {what}{}", if n == 1 { "" } else { "s" });
        let scene = Path::new(&m.scene.name)
            .file_stem()
            .map_or_else(|| m.scene.name.clone(), |s| s.to_string_lossy().into_owned());
        let mut drones: Vec<&str> = m.vehicles.iter().map(|v| v.name.as_str()).collect();
        drones.dedup();
        let title = format!(
            "{scene} · {} · {} × {} s · seed {}",
            drones.join(" + "),
            plural(m.n_worlds, "world"),
            m.seconds,
            m.seed
        );
        let camera = m.cameras.first().map_or("no camera".to_owned(), |c| {
            let kind = match c.kind {
                DepthKind::Range => "range",
                DepthKind::ZDepth => "z-depth",
            };
            format!(
                "camera {} {}×{} at {} Hz, {kind} {} to {} m",
                c.name, c.width, c.height, m.fps, c.near_m, c.far_m
            )
        });
        let trajectory = m.flight.trajectory.get("kind").and_then(|k| k.as_str()).unwrap_or("custom");
        let subtitle = format!(
            "{}, control {}, {} {} at {} Hz · {camera}",
            trajectory, m.flight.control_mode, "integrator", m.flight.integrator, m.flight.sim_hz
        );
        let mut notes = vec![format!(
            "{} in {}: {} of them with contacts ({} in all), {n_quarantined} quarantined.",
            plural(m.n_drones * worlds.len(), "flight"),
            plural(worlds.len(), "world"),
            n_touching,
            contacts.len()
        )];
        let near = if least.is_finite() {
            format!("least clearance {least:.2} m")
        } else {
            "no clearance below the limit".into()
        };
        notes.push(format!("{length_m:.0} m flown, top speed {top_speed:.1} m/s, {near}."));
        if pixels > 0 {
            let share = 100.0 * hits as f64 / pixels as f64;
            notes.push(format!("{n_frames} depth images; {share:.0} % of the pixels above are hits."));
        }
        Ok(Self {
            title,
            subtitle,
            sheet_heading: "Depth and geoms, exact".to_owned(),
            frames,
            paths: gathered.into_iter().flat_map(|g| g.paths).collect(),
            contacts,
            map,
            seconds: m.seconds,
            clearance_max_m: m.flight.clearance_max_m,
            notes,
        })
    }

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
        let mut canvas = Canvas::new(width as i32, height as i32, PAGE);
        let most = ((width as i32 - 2 * MARGIN) / CHAR_W) as usize;
        if 2 * self.title.chars().count() <= most {
            canvas.headline(MARGIN, 20, &self.title, INK);
        } else {
            canvas.text(MARGIN, 32, &shorten(&self.title, most), INK, Align::Left);
        }
        canvas.text(MARGIN, 66, &shorten(&self.subtitle, most), SOFT, Align::Left);
        canvas.rect(MARGIN, 96, width as i32 - 2 * MARGIN, 1, RULE);
        self.draw_sheet(&mut canvas);
        self.draw_map(&mut canvas);
        self.draw_clearance(&mut canvas);
        let most = ((RIGHT_X - 2 * MARGIN) / CHAR_W) as usize;
        for (i, line) in self.notes.iter().take(4).enumerate() {
            canvas.text(MARGIN, 1000 + i as i32 * 22, &shorten(line, most), INK, Align::Left);
        }
        let rgb = canvas.pixels.iter().flatten().copied().collect();
        Ok(Picture { width, height, rgb })
    }

    /// The contact sheet with its scale.
    fn draw_sheet(&self, canvas: &mut Canvas) {
        let top = 138;
        let heading = if self.frames.is_empty() { "No images in this data set" } else { &self.sheet_heading };
        canvas.text(MARGIN, 108, heading, INK, Align::Left);
        if self.frames.is_empty() {
            return;
        }
        let mut hits: Vec<f32> = self
            .frames
            .iter()
            .flat_map(|f| f.depth_m.iter().zip(&f.status))
            .filter(|(d, s)| **s == status::HIT && d.is_finite())
            .map(|(d, _)| *d)
            .collect();
        hits.sort_by(f32::total_cmp);
        // The scale ends where 98 of 100 hits are; a few far ones must not darken all others.
        let end = hits.get(hits.len().saturating_sub(1) * 98 / 100).map_or(1.0, |d| f64::from(*d));
        let end = round_up(end.max(0.1));
        let table: Vec<Rgb> = (0..=255).map(|i| depth_color(f64::from(i) / 255.0)).collect();
        let pixel = |depth: f32, code: u8| match code {
            status::HIT => table[((f64::from(depth) / end).clamp(0.0, 1.0) * 255.0) as usize],
            status::TOO_FAR => COLOR_TOO_FAR,
            status::TOO_NEAR => COLOR_TOO_NEAR,
            _ => COLOR_MISS,
        };

        let (cell_w, cell_h) = ((RIGHT_X - MARGIN - 24) / SHEET.1 as i32, 196);
        let several = self.frames.iter().any(|f| f.drone > 0);
        for (i, f) in self.frames.iter().take(SHEET.0 * SHEET.1).enumerate() {
            let x = MARGIN + (i % SHEET.1) as i32 * cell_w;
            let y = top + (i / SHEET.1) as i32 * cell_h;
            // The caption stands right of square images and below wide ones, whichever lets the image be larger.
            let (beside, below) = (fit(f.width, f.height, 180, 182), fit(f.width, f.height, 202, 150));
            let wide = below.0 * below.1 > beside.0 * beside.1;
            let (w, h) = if wide { below } else { beside };
            canvas.image([x, y, w, h], (f.width, f.height), |row, column| {
                let at = row * f.width + column;
                pixel(f.depth_m[at], f.status[at])
            });
            let (small_w, small_h) = fit(f.width, f.height, if wide { 74 } else { 90 }, h / 2);
            canvas.image([x + w + 8, y, small_w, small_h], (f.width, f.height), |row, column| {
                let at = row * f.width + column;
                geom_color(f.geom_id[at])
            });
            let mut lines = vec![format!("world {}", f.world), format!("{:.2} s", f.t_s)];
            if several {
                lines.push(format!("drone {}", f.drone));
            }
            if wide {
                canvas.text(x, y + h + 3, &shorten(&lines.join(", "), 27), INK, Align::Left);
            } else {
                for (k, line) in lines.iter().enumerate() {
                    let at = y + small_h + 8 + 22 * k as i32;
                    canvas.text(x + w + 8, at, line, if k == 0 { INK } else { SOFT }, Align::Left);
                }
            }
        }

        // Scale, then codes.
        let (x, y, w) = (MARGIN, 932, 400);
        for i in 0..w {
            canvas.rect(x + i, y, 1, 22, table[(i * 255 / (w - 1)) as usize]);
        }
        let marks = ticks(0.0, end, 5);
        for mark in &marks {
            let at = x + (mark / end * f64::from(w - 1)).round() as i32;
            canvas.rect(at, y + 22, 1, 5, INK);
            let label = tick_label(*mark, &marks);
            let align = if *mark == 0.0 { Align::Left } else { Align::Center };
            canvas.text(at, y + 29, &label, INK, align);
        }
        canvas.text(x + w + 14, y + 29, "m", INK, Align::Left);
        let mut x = x + w + 60;
        for (color, label) in
            [(COLOR_MISS, "nothing"), (COLOR_TOO_FAR, "too far"), (COLOR_TOO_NEAR, "too near")]
        {
            canvas.rect(x, y, 22, 22, color);
            canvas.outline(x, y, 22, 22, RULE);
            canvas.text(x + 30, y + 1, label, INK, Align::Left);
            x += 30 + text_width(label) + 22;
        }
    }

    /// The scene from above with paths, starts and contacts.
    fn draw_map(&self, canvas: &mut Canvas) {
        let right = OVERVIEW_SIZE.0 as i32 - MARGIN;
        canvas.text(RIGHT_X, 108, "From above: paths by clearance, x and y in m", INK, Align::Left);
        let area = [RIGHT_X + 50, 138, right - RIGHT_X - 50, 524];
        let m = &self.map;
        let (wide, deep) = (m.x_m[1] - m.x_m[0], m.y_m[1] - m.y_m[0]);
        let scale = (f64::from(area[2]) / wide).min(f64::from(area[3]) / deep);
        let (w, h) = (((wide * scale) as i32).max(2), ((deep * scale) as i32).max(2));
        let (x0, y0) = (area[0] + (area[2] - w) / 2, area[1] + (area[3] - h) / 2);
        let clip = [x0, y0, w, h];

        let seen: Vec<f32> = m.heights_m.iter().copied().filter(|h| h.is_finite()).collect();
        let (low, high) = (
            seen.iter().copied().fold(f32::INFINITY, f32::min),
            seen.iter().copied().fold(f32::NEG_INFINITY, f32::max),
        );
        let cell = [wide / m.columns as f64, deep / m.rows as f64];
        canvas.image(clip, (m.columns, m.rows), |row, column| {
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
        canvas.outline(x0, y0, w, h, RULE);

        let place = |p: [f64; 2]| {
            [f64::from(x0) + (p[0] - m.x_m[0]) * scale, f64::from(y0) + (m.y_m[1] - p[1]) * scale]
        };
        for (edges, vertical) in [(m.x_m, false), (m.y_m, true)] {
            let room = if vertical { h / 60 } else { w / 90 }.clamp(2, 8) as usize;
            let marks = ticks(edges[0], edges[1], room);
            for mark in &marks {
                let label = tick_label(*mark, &marks);
                if vertical {
                    let y = place([0.0, *mark])[1].round() as i32;
                    canvas.rect(x0 - 6, y, 5, 1, INK);
                    canvas.text(x0 - 10, y - TEXT_H / 2, &label, INK, Align::Right);
                } else {
                    let x = place([*mark, 0.0])[0].round() as i32;
                    canvas.rect(x, y0 + h + 1, 1, 5, INK);
                    canvas.text(x, y0 + h + 8, &label, INK, Align::Center);
                }
            }
        }

        // The nearest passes are drawn last, so that they stay visible where paths cross.
        let mut pieces: Vec<(f64, [f64; 2], [f64; 2])> = Vec::new();
        for path in &self.paths {
            for i in 1..path.xy_m.len() {
                let (a, b) = (path.xy_m[i - 1], path.xy_m[i]);
                if a.iter().chain(&b).all(|v| v.is_finite()) {
                    let near = path.clearance_m[i - 1].min(path.clearance_m[i]);
                    pieces.push((near, place(a), place(b)));
                }
            }
        }
        pieces.sort_by(|a, b| b.0.total_cmp(&a.0));
        let thick = if self.paths.len() > 60 { 1.6 } else { 2.4 };
        for (near, a, b) in pieces {
            canvas.line(a, b, thick, clearance_color(near), clip);
        }
        let dot = if self.paths.len() > 60 { 2.6 } else { 5.0 };
        for path in &self.paths {
            if let Some(start) = path.xy_m.first().filter(|p| p.iter().all(|v| v.is_finite())) {
                canvas.disc(place(*start), dot + 1.4, INK, clip);
                canvas.disc(place(*start), dot, [255; 3], clip);
            }
        }
        let half = if self.contacts.len() > 120 { 3.0 } else { 5.0 };
        for (_, at) in &self.contacts {
            if at.iter().all(|v| v.is_finite()) {
                canvas.cross(place(*at), half, 0.5 * half + 2.0, [255; 3], clip);
                canvas.cross(place(*at), half, 0.3 * half + 0.7, INK, clip);
            }
        }

        let (x, y, w) = (RIGHT_X + 50, 704, 180);
        let everywhere = [0, 0, OVERVIEW_SIZE.0 as i32, OVERVIEW_SIZE.1 as i32];
        let ratio = CLEARANCE_GREEN_M / CLEARANCE_RED_M;
        for i in 0..w {
            let c = CLEARANCE_RED_M * ratio.powf(f64::from(i) / f64::from(w - 1));
            canvas.rect(x + i, y, 1, 14, clearance_color(c));
        }
        for (at, label) in [(0.0, "0.1"), (0.477, "0.3"), (1.0, "1 m")] {
            canvas.text(x + (at * f64::from(w)) as i32, y + 17, label, INK, Align::Center);
        }
        let mut x = x + w + 36;
        canvas.disc([f64::from(x), f64::from(y) + 8.0], 6.4, INK, everywhere);
        canvas.disc([f64::from(x), f64::from(y) + 8.0], 5.0, [255; 3], everywhere);
        canvas.text(x + 14, y - 2, "start", INK, Align::Left);
        x += 100;
        canvas.cross([f64::from(x), f64::from(y) + 8.0], 5.0, 2.2, INK, everywhere);
        let label = format!("contact ({})", self.contacts.len());
        canvas.text(x + 14, y - 2, &label, INK, Align::Left);
    }

    /// Clearance and contacts over time.
    fn draw_clearance(&self, canvas: &mut Canvas) {
        const BINS: usize = 160;
        let red = [198, 40, 48];
        let blue = [38, 98, 168];
        let right = OVERVIEW_SIZE.0 as i32 - MARGIN;
        let clip = [RIGHT_X + 50, 796, right - RIGHT_X - 50, 230];
        let [x0, y0, w, h] = clip;
        canvas.text(RIGHT_X, 762, "Clearance over time, m", INK, Align::Left);

        // Per path and bin the least value; then over paths.
        let mut bins: Vec<Vec<f64>> = vec![Vec::new(); BINS];
        for path in &self.paths {
            let mut least = [f64::NAN; BINS];
            for (t, c) in path.t_s.iter().zip(&path.clearance_m) {
                if !c.is_nan() && t.is_finite() && *t >= 0.0 {
                    let bin = ((t / self.seconds * BINS as f64) as usize).min(BINS - 1);
                    // f64::min passes over NaN.
                    least[bin] = least[bin].min(*c);
                }
            }
            for (bin, c) in bins.iter_mut().zip(least) {
                if !c.is_nan() {
                    bin.push(c.min(self.clearance_max_m));
                }
            }
        }
        let mut rows: Vec<(f64, f64, f64)> = Vec::new(); // time, least, median
        for (i, bin) in bins.iter_mut().enumerate() {
            bin.sort_by(f64::total_cmp);
            if let Some(least) = bin.first() {
                rows.push(((i as f64 + 0.5) / BINS as f64 * self.seconds, *least, bin[bin.len() / 2]));
            }
        }
        let top = rows.iter().map(|r| r.2).fold(0.0, f64::max);
        let top = round_up(top.max(0.5) * 1.02);
        let low = rows.iter().map(|r| r.1).fold(0.0, f64::min);
        let low = if low < 0.0 { -round_up(-low) } else { 0.0 };
        let place = |t: f64, c: f64| {
            [
                f64::from(x0) + t / self.seconds * f64::from(w),
                f64::from(y0 + h) - (c - low) / (top - low) * f64::from(h),
            ]
        };
        canvas.rect(x0, y0, w, h, [255; 3]);
        let marks = ticks(low, top, 5);
        for mark in &marks {
            let y = place(0.0, *mark)[1].round() as i32;
            canvas.rect(x0, y.min(y0 + h - 1), w, 1, [228, 229, 232]);
            canvas.rect(x0 - 6, y, 5, 1, INK);
            canvas.text(x0 - 10, y - TEXT_H / 2, &tick_label(*mark, &marks), INK, Align::Right);
        }
        if low < 0.0 {
            canvas.rect(x0, place(0.0, 0.0)[1].round() as i32, w, 1, SOFT);
        }
        let marks = ticks(0.0, self.seconds, 6);
        for mark in &marks {
            let x = place(*mark, 0.0)[0].round() as i32;
            canvas.rect(x, y0 + h + 1, 1, 5, INK);
            canvas.text(x, y0 + h + 8, &tick_label(*mark, &marks), INK, Align::Center);
        }
        // Contacts as bars on the floor of the plot, as high as there are many in a bin.
        let mut counts = [0usize; BINS];
        for (t, _) in self.contacts.iter().filter(|(t, _)| t.is_finite() && *t >= 0.0) {
            counts[((t / self.seconds * BINS as f64) as usize).min(BINS - 1)] += 1;
        }
        let most = counts.iter().copied().max().unwrap_or(0).max(3) as f64;
        for (i, count) in counts.iter().enumerate().filter(|(_, count)| **count > 0) {
            let (from, to) = (x0 + i as i32 * w / BINS as i32, x0 + (i as i32 + 1) * w / BINS as i32);
            let tall = (*count as f64 / most * 36.0).round() as i32;
            canvas.rect(from, y0 + h - tall, (to - from - 1).max(1), tall, [150, 153, 160]);
        }
        if rows.is_empty() {
            canvas.text(x0 + w / 2, y0 + h / 2 - TEXT_H / 2, "not measured", SOFT, Align::Center);
        }
        for pair in rows.windows(2) {
            canvas.line(place(pair[0].0, pair[0].2), place(pair[1].0, pair[1].2), 2.2, blue, clip);
        }
        for pair in rows.windows(2) {
            canvas.line(place(pair[0].0, pair[0].1), place(pair[1].0, pair[1].1), 2.2, red, clip);
        }
        canvas.outline(x0, y0, w, h, RULE);
        let everywhere = [0, 0, OVERVIEW_SIZE.0 as i32, OVERVIEW_SIZE.1 as i32];
        let mut x = RIGHT_X + 260;
        for (color, label) in [(blue, "median"), (red, "least"), ([150, 153, 160], "contacts")] {
            if label == "contacts" {
                for (i, tall) in [8, 14, 5].into_iter().enumerate() {
                    canvas.rect(x + 8 + 5 * i as i32, 779 - tall, 4, tall, color);
                }
            } else {
                canvas.line([f64::from(x), 772.0], [f64::from(x) + 24.0, 772.0], 2.6, color, everywhere);
            }
            canvas.text(x + 32, 762, label, INK, Align::Left);
            x += 32 + text_width(label) + 24;
        }
        canvas.text(right, y0 + h + 32, "time, s", SOFT, Align::Right);
    }
}

/// The next of 1, 1.5, 2, 3, 4, 5, 6, 8, 10 times a power of ten.
fn round_up(value: f64) -> f64 {
    let power = 10f64.powf(value.log10().floor());
    let steps = [1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0];
    steps.map(|s| s * power).into_iter().find(|s| *s >= value * 0.9999).unwrap_or(10.0 * power)
}

/// Largest size with the image's aspect inside `w` × `h`.
fn fit(iw: usize, ih: usize, w: i32, h: i32) -> (i32, i32) {
    let scale = (f64::from(w) / iw as f64).min(f64::from(h) / ih as f64);
    (((iw as f64 * scale) as i32).max(2), ((ih as f64 * scale) as i32).max(2))
}

/// At most `most` characters.
fn shorten(text: &str, most: usize) -> String {
    if text.chars().count() <= most {
        return text.to_owned();
    }
    let mut short: String = text.chars().take(most.saturating_sub(3)).collect();
    short.push_str("...");
    short
}

/// `n` frames of a world, spread over time; drones take turns.
fn sheet_frames(world: &WorldReader, number: usize, n_drones: usize, n: usize) -> Result<Vec<SheetFrame>> {
    let frames = world.frames()?;
    let have = frames.time_s.len();
    let n = n.min(have);
    Ok((0..n)
        .map(|i| {
            let (f, drone) = ((2 * i + 1) * have / (2 * n), i % n_drones);
            let depth = frames.depth_m.index_axis(ndarray::Axis(0), f);
            let depth = depth.index_axis(ndarray::Axis(0), drone);
            let (height, width) = depth.dim();
            let status = frames.status.index_axis(ndarray::Axis(0), f);
            let geom_id = frames.geom_id.index_axis(ndarray::Axis(0), f);
            SheetFrame {
                world: number,
                drone,
                t_s: frames.time_s[f],
                width,
                height,
                depth_m: depth.iter().copied().collect(),
                status: status.index_axis(ndarray::Axis(0), drone).iter().copied().collect(),
                geom_id: geom_id.index_axis(ndarray::Axis(0), drone).iter().copied().collect(),
            }
        })
        .collect())
}

/// What one world adds to the picture.
struct Gathered {
    paths: Vec<PathLine>,
    contacts: Vec<(f64, [f64; 2])>,
    length_m: f64,
    top_speed_m_s: f64,
    n_frames: u64,
    quarantined: bool,
}

/// Points of a path on the picture, at most.
const PATH_POINTS: usize = 400;

fn gather(
    world: &WorldReader,
    n_drones: usize,
    with_clearance: bool,
    contact_every_steps: u32,
) -> Result<Gathered> {
    let states = world.states(Some(&["t", "drone", "px", "py", "pz", "vx", "vy", "vz"]))?;
    let get = |name| states.column(name);
    let (t, drone) = (get("t")?, get("drone")?);
    let (p, v) = ([get("px")?, get("py")?, get("pz")?], [get("vx")?, get("vy")?, get("vz")?]);
    let clearance = if with_clearance {
        let table = world.clearance(Some(&["t", "drone", "distance"]))?;
        let rows: Vec<(f64, f64, f64)> = table
            .column("t")?
            .iter()
            .zip(table.column("drone")?)
            .zip(table.column("distance")?)
            // An empty distance is one beyond the range of the search.
            .map(|((t, drone), c)| (*t, *drone, if c.is_nan() { f64::INFINITY } else { *c }))
            .collect();
        Some(rows)
    } else {
        None
    };
    let (mut paths, mut length_m, mut top_speed_m_s) = (Vec::new(), 0.0, 0.0f64);
    for d in 0..n_drones {
        let rows: Vec<usize> = (0..t.len()).filter(|i| drone[*i] == d as f64).collect();
        for pair in rows.windows(2) {
            let step: f64 = (0..3).map(|k| (p[k][pair[1]] - p[k][pair[0]]).powi(2)).sum::<f64>().sqrt();
            if step.is_finite() {
                length_m += step;
            }
        }
        for i in &rows {
            let speed = (0..3).map(|k| v[k][*i].powi(2)).sum::<f64>().sqrt();
            // f64::max passes over NaN.
            top_speed_m_s = top_speed_m_s.max(speed);
        }
        let near: Option<Vec<(f64, f64)>> = clearance
            .as_ref()
            .map(|rows| rows.iter().filter(|r| r.1 == d as f64).map(|r| (r.0, r.2)).collect());
        let stride = rows.len().div_ceil(PATH_POINTS).max(1);
        let mut path = PathLine { t_s: Vec::new(), xy_m: Vec::new(), clearance_m: Vec::new() };
        let mut next = 0;
        let last = rows.last().copied();
        for (k, i) in rows.iter().enumerate() {
            if k % stride != 0 && Some(*i) != last {
                continue;
            }
            // The least clearance since the point before, so that thinning hides no near pass.
            let mut least = f64::NAN;
            if let Some(near) = &near {
                let from = next;
                while next < near.len() && near[next].0 <= t[*i] {
                    least = least.min(near[next].1);
                    next += 1;
                }
                if next == from {
                    least = near.get(next.saturating_sub(1)).map_or(f64::NAN, |r| r.1);
                }
            }
            path.t_s.push(t[*i]);
            path.xy_m.push([p[0][*i], p[1][*i]]);
            path.clearance_m.push(least);
        }
        paths.push(path);
    }
    // A contact that lasts has a row per step; the picture counts its beginning.
    let table = world.contacts(Some(&[
        "t",
        "step",
        "drone",
        "geom2",
        "other_flex",
        "distance",
        "swept",
        "x",
        "y",
    ]))?;
    let get = |name| table.column(name);
    let (ct, cx, cy, step) = (get("t")?, get("x")?, get("y")?, get("step")?);
    let (drone, geom, flex, distance) = (get("drone")?, get("geom2")?, get("other_flex")?, get("distance")?);
    let swept = get("swept")?;
    let mut last = BTreeMap::new();
    let mut contacts = Vec::new();
    for i in 0..ct.len() {
        if distance[i] > 0.0 && swept[i] == 0.0 {
            continue; // within a margin only
        }
        let pair = (drone[i] as i64, geom[i] as i64, flex[i] as i64);
        let before = last.insert(pair, step[i]);
        if before.is_none_or(|b| step[i] - b > 2.0 * f64::from(contact_every_steps.max(1))) {
            contacts.push((ct[i], [cx[i], cy[i]]));
        }
    }
    Ok(Gathered {
        paths,
        contacts,
        length_m,
        top_speed_m_s,
        n_frames: world.record().n_frames,
        quarantined: world.record().quarantine.is_some(),
    })
}
