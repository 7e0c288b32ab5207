//! Clearance and contacts over time.

use crate::picture::{Anchor, Canvas, Ink, round_up, tick_label, ticks};

use super::{DRAWING_X, INK, Overview, RIGHT_END, RIGHT_X, RULE, SOFT, words};

/// Time is cut into this many bins.
const BINS: usize = 160;
/// The plot: left, top, width, height.
const PLOT: [f32; 4] = [DRAWING_X, 796.0, RIGHT_END - DRAWING_X, 230.0];
/// Baseline of its heading and legend.
const HEADING_Y: f32 = 762.0;
const RED: Ink = [198, 40, 48];
const BLUE: Ink = [38, 98, 168];
const GREY: Ink = [150, 153, 160];
const GRID: Ink = [228, 229, 232];

/// Clearances of one bin over paths.
struct Row {
    t_s: f64,
    least_m: f64,
    median_m: f64,
}

/// What stands where in the plot.
struct Axes {
    seconds: f64,
    low: f64,
    high: f64,
}

impl Axes {
    /// Round numbers around what is drawn.
    fn around(rows: &[Row], seconds: f64) -> Self {
        let high = rows.iter().map(|r| r.median_m).fold(0.0, f64::max);
        let low = rows.iter().map(|r| r.least_m).fold(0.0, f64::min);
        Self {
            seconds,
            low: if low < 0.0 { -round_up(-low) } else { 0.0 },
            high: round_up(high.max(0.5) * 1.02),
        }
    }

    fn place(&self, t_s: f64, clearance_m: f64) -> [f32; 2] {
        let [x, y, w, h] = PLOT;
        let up = (clearance_m - self.low) / (self.high - self.low);
        [x + (t_s / self.seconds) as f32 * w, y + h - up as f32 * h]
    }
}

impl Overview {
    /// The plot with its legend.
    pub(super) fn draw_clearance(&self, canvas: &mut Canvas) {
        let [x, y, w, h] = PLOT;
        words(canvas, RIGHT_X, HEADING_Y, INK, Anchor::Start, "Clearance over time, m");
        let rows = self.clearance_rows();
        let axes = Axes::around(&rows, self.seconds);
        draw_axes(canvas, &axes);
        self.draw_contact_bars(canvas);
        if rows.is_empty() {
            words(canvas, x + 0.5 * w, y + 0.5 * h - 10.0, SOFT, Anchor::Middle, "not measured");
        }
        canvas.clip(Some(PLOT));
        let line = |of: fn(&Row) -> f64| -> Vec<[f32; 2]> {
            rows.iter().map(|row| axes.place(row.t_s, of(row))).collect()
        };
        canvas.line(&line(|row| row.median_m), BLUE, 2.2, false);
        canvas.line(&line(|row| row.least_m), RED, 2.2, false);
        canvas.clip(None);
        canvas.outline(PLOT, RULE);
        draw_legend(canvas);
        words(canvas, RIGHT_END, y + h + 32.0, SOFT, Anchor::End, "time, s");
    }

    /// The bin of a time; none before the start.
    fn bin(&self, t_s: f64) -> Option<usize> {
        let at = (t_s / self.seconds * BINS as f64) as usize;
        (t_s.is_finite() && t_s >= 0.0).then_some(at.min(BINS - 1))
    }

    /// Per path and bin the least clearance; then least and median over paths. Bins without any are left out.
    fn clearance_rows(&self) -> Vec<Row> {
        let mut bins: Vec<Vec<f64>> = vec![Vec::new(); BINS];
        for path in &self.paths {
            let mut least = [f64::NAN; BINS];
            for (t, c) in path.t_s.iter().zip(&path.clearance_m).filter(|(_, c)| !c.is_nan()) {
                if let Some(bin) = self.bin(*t) {
                    // f64::min passes over NaN.
                    least[bin] = least[bin].min(*c);
                }
            }
            for (bin, c) in bins.iter_mut().zip(least).filter(|(_, c)| !c.is_nan()) {
                bin.push(c.min(self.clearance_max_m));
            }
        }
        let mut rows = Vec::new();
        for (i, bin) in bins.iter_mut().enumerate() {
            bin.sort_by(f64::total_cmp);
            if let Some(least) = bin.first() {
                let t_s = (i as f64 + 0.5) / BINS as f64 * self.seconds;
                rows.push(Row { t_s, least_m: *least, median_m: bin[bin.len() / 2] });
            }
        }
        rows
    }

    /// Contacts as bars on the floor of the plot, as high as there are many in a bin.
    fn draw_contact_bars(&self, canvas: &mut Canvas) {
        let [x, y, w, h] = PLOT;
        let mut counts = [0usize; BINS];
        self.contacts.iter().filter_map(|(t, _)| self.bin(*t)).for_each(|bin| counts[bin] += 1);
        let most = counts.iter().copied().max().unwrap_or(0).max(3) as f32;
        let edge = |i: usize| (x + i as f32 * w / BINS as f32).floor();
        for (i, count) in counts.iter().enumerate().filter(|(_, count)| **count > 0) {
            let tall = (*count as f32 / most * 36.0).round();
            let wide = (edge(i + 1) - edge(i) - 1.0).max(1.0);
            canvas.rect([edge(i), y + h - tall, wide, tall], GREY);
        }
    }
}

/// White paper, a grid, and round numbers along both axes.
fn draw_axes(canvas: &mut Canvas, axes: &Axes) {
    let [x, y, w, h] = PLOT;
    canvas.rect(PLOT, [255; 3]);
    let marks = ticks(axes.low, axes.high, 5);
    for mark in &marks {
        let at = axes.place(0.0, *mark)[1].round();
        canvas.rect([x, at.min(y + h - 1.0), w, 1.0], GRID);
        canvas.rect([x - 6.0, at, 5.0, 1.0], INK);
        words(canvas, x - 10.0, at - 10.0, INK, Anchor::End, &tick_label(*mark, &marks));
    }
    if axes.low < 0.0 {
        canvas.rect([x, axes.place(0.0, 0.0)[1].round(), w, 1.0], SOFT);
    }
    let marks = ticks(0.0, axes.seconds, 6);
    for mark in &marks {
        let at = axes.place(*mark, 0.0)[0].round();
        canvas.rect([at, y + h + 1.0, 1.0, 5.0], INK);
        words(canvas, at, y + h + 8.0, INK, Anchor::Middle, &tick_label(*mark, &marks));
    }
}

/// What lines and bars are.
fn draw_legend(canvas: &mut Canvas) {
    let mut x = RIGHT_X + 260.0;
    for (ink, label) in [(BLUE, "median"), (RED, "least"), (GREY, "contacts")] {
        if ink == GREY {
            for (i, tall) in [8.0, 14.0, 5.0].into_iter().enumerate() {
                canvas.rect([x + 8.0 + 5.0 * i as f32, HEADING_Y + 17.0 - tall, 4.0, tall], ink);
            }
        } else {
            canvas.line(&[[x, HEADING_Y + 10.0], [x + 24.0, HEADING_Y + 10.0]], ink, 2.6, false);
        }
        x += 32.0 + words(canvas, x + 32.0, HEADING_Y, INK, Anchor::Start, label) + 24.0;
    }
}
