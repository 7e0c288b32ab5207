//! Human-readable reports of a diagnosis: text for a terminal, one self-contained page, a picture of the error ladder.
//!
//! JSON needs no code here: [`Diagnosis`] serialises as it is.

mod comparison;
mod html;
mod ladder_png;
mod moments;
mod page_compare;
mod page_data;
mod page_live;
mod pages;
pub(crate) mod quantity;
mod rungs;
mod text;
mod why;

use super::compare::Comparison;
use super::live::Live;
use super::verdict::Diagnosis;
use serde::Serialize;

pub use ladder_png::{LADDER_PNG_WIDTH, ladder_png};
pub(crate) use quantity::{Scale, interval, quantity, significant};
pub use rungs::turns;
pub use text::{TEXT_COLUMNS, text};
pub use why::why;

/// The data of the living part of a page, for a page that asks a server for them: residuals, columns and paths, numbers as base64. The
/// comparison knows the worst stretches and what the error depends on.
pub fn living<'a>(
    live: &'a Live,
    diagnosis: Option<&'a Diagnosis>,
    comparison: Option<&Comparison>,
) -> impl Serialize + use<'a> {
    page_live::data(live, diagnosis, comparison)
}

/// Everything that a page shows. Empty parts are left out.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Report {
    /// Heading, for example the vehicle's name.
    pub title: String,
    /// The verdict, where there is one.
    pub diagnosis: Option<Diagnosis>,
    /// The nominal model against the flights. Its residuals over time and against causes are plotted too.
    pub comparison_before: Option<Comparison>,
    /// The model with the findings, against the same flights.
    pub comparison_after: Option<Comparison>,
    /// Residuals with their changes by effects: the living part of a page.
    pub live: Option<Live>,
    /// Measured against simulated, per log and channel.
    pub overlays: Vec<Overlay>,
    /// Residuals over time, beyond those of the comparisons.
    pub residuals: Vec<ResidualSeries>,
    /// Residuals against possible causes, beyond those of the comparisons.
    pub causes: Vec<Against>,
    /// Assumptions and omissions beyond those of the diagnosis.
    pub warnings: Vec<String>,
}

/// One measured and simulated channel. NaN breaks a line, so short roll-outs fit into one series.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Overlay {
    /// Name of the log.
    pub log: String,
    /// Name of the channel: `position x`.
    pub channel: String,
    /// SI unit.
    pub unit: String,
    /// Times from the start of the log, s, shape (sample).
    pub t_s: Vec<f64>,
    /// Simulated with the nominal vehicle, SI, shape (sample); empty where it was not simulated.
    pub measured: Vec<f64>,
    /// Simulated with the findings, SI, shape (sample); empty where nothing was found.
    pub as_filed: Vec<f64>,
    /// Simulated with the effects that were found, SI, shape (sample); empty where nothing was found.
    pub with_effects: Vec<f64>,
}

/// A residual over time: measured minus simulated.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ResidualSeries {
    /// Name of the log.
    pub log: String,
    /// Quantity: `force along body x`.
    pub name: String,
    /// SI unit.
    pub unit: String,
    /// Times from the start of the log, s, shape (sample).
    pub t_s: Vec<f64>,
    /// With the nominal vehicle, SI, shape (sample); NaN breaks the line.
    pub before: Vec<f64>,
    /// With the findings, SI, shape (sample); empty where there are none.
    pub after: Vec<f64>,
    /// Standard deviation of one sample due to noise alone, SI, where known.
    pub sigma: Option<f64>,
    /// Where the model's errors are largest, worst first.
    pub worst: Vec<WorstSegment>,
}

/// A segment of a log with large model errors.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct WorstSegment {
    /// Start, s from the start of the log.
    pub from_s: f64,
    /// End, s.
    pub to_s: f64,
    /// Root mean square of the residual in it with the nominal vehicle, unit of its series.
    pub rms_before: f64,
    /// The same with the findings.
    pub rms_after: Option<f64>,
    /// Operating conditions there: `7 m/s, rolling`. May be empty.
    pub what: String,
}

/// A residual against a possible cause, in bins of the cause.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Against {
    /// The residual quantity.
    pub residual: String,
    /// Its SI unit.
    pub unit: String,
    /// The possible cause: `speed`.
    pub cause: String,
    /// Its SI unit.
    pub cause_unit: String,
    /// Bins with the nominal vehicle, by rising cause.
    pub before: Vec<Bin>,
    /// Bins with the findings; empty where there are none.
    pub after: Vec<Bin>,
}

/// A bin of a cause.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Bin {
    /// Mean cause in the bin, SI.
    pub cause: f64,
    /// Mean residual in it, SI.
    pub mean: f64,
    /// Standard deviation of that mean, SI.
    pub sigma: f64,
    /// Samples in it.
    pub n: usize,
}

impl Report {
    /// A page for a diagnosis, to which series can be added.
    pub fn of(diagnosis: Diagnosis) -> Self {
        Self {
            title: format!("What the model of {} lacks", diagnosis.vehicle),
            diagnosis: Some(diagnosis),
            ..Self::default()
        }
    }

    /// A page for a comparison, to which a later one and series can be added.
    pub fn of_comparison(comparison: Comparison) -> Self {
        Self {
            title: format!("The model of {} against its flights", comparison.vehicle),
            comparison_before: Some(comparison),
            ..Self::default()
        }
    }

    /// The page: one HTML file without external files or network access.
    pub fn html(&self) -> String {
        html::page(self)
    }
}
