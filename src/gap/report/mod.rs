//! A diagnosis for people: text for a terminal, one self-contained page, a picture of the error ladder.
//!
//! JSON needs nothing here: [`Diagnosis`] serialises whole.

mod comparison;
mod html;
mod ladder_png;
mod page_compare;
mod page_data;
mod pages;
mod quantity;
mod rungs;
mod text;
mod why;

use super::compare::Comparison;
use super::verdict::Diagnosis;
use serde::Serialize;

pub use ladder_png::{LADDER_PNG_WIDTH, ladder_png};
pub(crate) use quantity::{Scale, interval, quantity, significant};
pub(crate) use rungs::turns;
pub use text::{TEXT_COLUMNS, text};
pub use why::why;

/// Everything that a page shows. What is empty is left out of the page.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Report {
    /// Heading, for example the vehicle's name.
    pub title: String,
    /// The verdict, where there is one.
    pub diagnosis: Option<Diagnosis>,
    /// The model as filed against the flights. Its residuals over time and against causes are drawn too.
    pub comparison_before: Option<Comparison>,
    /// The model with what was found, against the same flights.
    pub comparison_after: Option<Comparison>,
    /// Measured against simulated, per log and channel.
    pub overlays: Vec<Overlay>,
    /// Residuals over time, beyond those of the comparisons.
    pub residuals: Vec<ResidualSeries>,
    /// Residuals against what may cause them, beyond those of the comparisons.
    pub causes: Vec<Against>,
    /// What was assumed or left out beyond what the diagnosis says.
    pub warnings: Vec<String>,
}

/// One channel as measured and as simulated. NaN breaks a line, so short roll-outs can stand in one series.
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
    /// Measured, SI, shape (sample).
    pub measured: Vec<f64>,
    /// Simulated with the vehicle as filed, SI, shape (sample); empty where it was not simulated.
    pub as_filed: Vec<f64>,
    /// Simulated with the effects that were found, SI, shape (sample); empty where nothing was found.
    pub with_effects: Vec<f64>,
}

/// A residual over time: measured minus simulated.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ResidualSeries {
    /// Name of the log.
    pub log: String,
    /// What is residual: `force along body x`.
    pub name: String,
    /// SI unit.
    pub unit: String,
    /// Times from the start of the log, s, shape (sample).
    pub t_s: Vec<f64>,
    /// With the vehicle as filed, SI, shape (sample); NaN breaks the line.
    pub before: Vec<f64>,
    /// With the effects that were found, SI, shape (sample); empty where there are none.
    pub after: Vec<f64>,
    /// Standard deviation that noise alone gives one sample, SI, where known.
    pub sigma: Option<f64>,
    /// Where the model fails most, worst first.
    pub worst: Vec<WorstSegment>,
}

/// A stretch of a log in which the model fails.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct WorstSegment {
    /// Start, s from the start of the log.
    pub from_s: f64,
    /// End, s.
    pub to_s: f64,
    /// Root mean square of the residual in it with the vehicle as filed, unit of its series.
    pub rms_before: f64,
    /// The same with the effects that were found.
    pub rms_after: Option<f64>,
    /// What the vehicle did there: `7 m/s, rolling`. May be empty.
    pub what: String,
}

/// A residual against a possible cause, in bins of the cause.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Against {
    /// What is residual.
    pub residual: String,
    /// Its SI unit.
    pub unit: String,
    /// What may cause it: `speed`.
    pub cause: String,
    /// Its SI unit.
    pub cause_unit: String,
    /// Bins with the vehicle as filed, by rising cause.
    pub before: Vec<Bin>,
    /// Bins with the effects that were found; empty where there are none.
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

    /// The page: one HTML file that needs no other and no network.
    pub fn html(&self) -> String {
        html::page(self)
    }
}
