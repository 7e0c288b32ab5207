//! The error ladder as a picture: a row per step with its name on the left, and for each measure a bar with its value and
//! its per cent of the nominal model.

use super::quantity::percent;
use super::rungs::{Measure, measures};
use crate::GapError;
use crate::headline::evidence;
use crate::verdict::Diagnosis;
use propwash_picture::{Anchor, Canvas, Effort, PictureError};

/// Width of the picture, pixels; its height grows with the number of steps.
pub const LADDER_PNG_WIDTH: u32 = 1600;
/// Margin, height of the head with title, verdict and names of the measures, and height of a row, pixels.
const MARGIN: f32 = 70.0;
const HEAD: f32 = 262.0;
const ROW: f32 = 62.0;
/// Widest column of names, and distance between columns, pixels.
const NAMES: f32 = 400.0;
const GAP: f32 = 34.0;

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
    let height = (HEAD + ROW * rows as f32 + MARGIN) as u32;
    let mut page = Page(Canvas::new(LADDER_PNG_WIDTH, height, PAPER).map_err(failed)?);
    page.heading(
        &format!("Error ladder of {}", diagnosis.vehicle),
        &diagnosis.headline,
        &evidence(diagnosis),
    );
    if measures.is_empty() {
        page.0.text([MARGIN, HEAD], 24.0, false, SOFT, Anchor::Start, "No roll-outs were made.");
        return page.0.png(Effort::Balanced).map_err(failed);
    }
    let labels: Vec<String> = diagnosis.ladder.iter().map(|r| r.label.clone()).collect();
    let widest = labels.iter().map(|l| page.0.text_width(l, 21.0, false)).fold(0.0, f32::max);
    let names = widest.min(NAMES);
    for (k, label) in labels.iter().enumerate() {
        let lines = page.0.lines(label, 21.0, false, names, 2);
        let first = page.row(k) + if lines.len() == 1 { 7.0 } else { -5.0 };
        for (i, line) in lines.iter().enumerate() {
            page.0.text([MARGIN, first + 25.0 * i as f32], 21.0, false, INK, Anchor::Start, line);
        }
    }
    let left = MARGIN + names + GAP;
    let width = (LADDER_PNG_WIDTH as f32 - MARGIN - left + GAP) / measures.len() as f32 - GAP;
    for (k, measure) in measures.iter().enumerate() {
        page.bars(left + (width + GAP) * k as f32, width, measure);
    }
    page.foot(&measures);
    page.0.png(Effort::Balanced).map_err(failed)
}

/// The picture that is being drawn.
struct Page(Canvas);

fn failed(e: PictureError) -> GapError {
    GapError::Numbers { what: "the picture of the ladder", reason: e.to_string() }
}

impl Page {
    fn heading(&mut self, title: &str, verdict: &str, evidence: &str) {
        let wide = LADDER_PNG_WIDTH as f32 - 2.0 * MARGIN;
        let title = self.0.shortened(title, 20.0, true, wide);
        self.0.text([MARGIN, 54.0], 20.0, true, SOFT, Anchor::Start, &title);
        // A headline of wide letters is set smaller, not cut: its end may say that something is unexplained.
        let size = (31.0 * wide / self.0.text_width(verdict, 31.0, true)).clamp(24.0, 31.0);
        let verdict = self.0.shortened(verdict, size, true, wide);
        self.0.text([MARGIN, 100.0], size, true, INK, Anchor::Start, &verdict);
        for (k, line) in self.0.lines(evidence, 20.0, false, wide, 2).iter().enumerate() {
            self.0.text([MARGIN, 138.0 + 27.0 * k as f32], 20.0, false, SOFT, Anchor::Start, line);
        }
    }

    /// Middle of a row.
    fn row(&self, k: usize) -> f32 {
        HEAD + ROW * (k as f32 + 0.5)
    }

    /// A column: name of the measure, and a bar per step with its value and its per cent of the first.
    fn bars(&mut self, left: f32, width: f32, measure: &Measure) {
        let lines = self.0.lines(&measure.name, 20.0, true, width, 2);
        for (i, line) in lines.iter().enumerate() {
            let y = HEAD - 16.0 - 25.0 * (lines.len() - 1 - i) as f32;
            self.0.text([left, y], 20.0, true, INK, Anchor::Start, line);
        }
        self.0.rect([left, HEAD - 4.0, width, 1.5], GRID);
        for k in 0..measure.values.len() {
            let y = self.row(k);
            self.0.text([left, y - 5.0], 19.0, k == 0, INK, Anchor::Start, &measure.words(k));
            self.0.text([left + width, y - 5.0], 19.0, false, SOFT, Anchor::End, &measure.share(k));
            self.0.rect([left, y + 4.0, width, 13.0], GRID);
            let Some(value) = measure.drawn(k).filter(|v| v.is_finite()) else { continue };
            let length = (width * measure.length(value) as f32).max(2.0);
            self.0.rect([left, y + 4.0, length, 13.0], if k == 0 { FILED } else { FOUND });
            // A mark for the value on the flight of the fit.
            if let ([Some(_), Some(seen)], true) = (measure.values[k], value > 0.0) {
                let at = left + width * measure.length(seen) as f32;
                self.0.rect([at.min(left + width - 3.0), y + 1.0, 3.0, 19.0], INK);
            }
        }
    }

    fn foot(&mut self, measures: &[Measure]) {
        let both = measures.iter().flat_map(|m| &m.values).any(|v| v[0].is_some() && v[1].is_some());
        let unseen = measures.iter().flat_map(|m| &m.values).any(|v| v[0].is_some());
        let words = match (both, unseen) {
            (true, _) => "Bars: flight that the fit has not seen; upright marks: flight used for the fit.",
            (false, true) => "On flight that the fit has not seen.",
            (false, false) => "On flight used for the fit.",
        };
        let words = format!("{words} Root mean squares; {} is your model.", percent(1.0));
        let y = self.0.height() as f32 - 28.0;
        self.0.text([MARGIN, y], 17.0, false, SOFT, Anchor::Start, &words);
    }
}
