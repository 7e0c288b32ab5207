//! Whole pages, with overlays of the flights.

use super::Report;
use crate::GapError;
use crate::compare::{Comparison, compare};
use crate::diagnose::Diagnosed;
use crate::error::Result;
use crate::ladder::Flights;
use crate::live::Live;
use crate::overlay::overlays;
use crate::track::Track;
use propwash_vehicle::Vehicle;

/// Logs with overlays on a page; more make it slow to load.
const MOST_LOGS: usize = 2;

/// Overlays of the first logs; each segment starts at `from_s` if that is known, else in the middle of the log.
fn add_overlays(
    report: &mut Report,
    logs: &[(&Track, Option<f64>)],
    before: &Vehicle,
    after: Option<&Vehicle>,
) -> Result<()> {
    for (track, from_s) in logs.iter().take(MOST_LOGS) {
        let middle = 0.5 * (track.span_s[0] + track.span_s[1]) - 5.0;
        report.overlays.extend(overlays(track, from_s.unwrap_or(middle), before, after)?);
    }
    if logs.len() > MOST_LOGS {
        report.warnings.push(format!("overlays are shown for the first {MOST_LOGS} of {} logs", logs.len()));
    }
    Ok(())
}

impl Report {
    /// The page of a comparison, with overlays of its flights.
    ///
    /// # Errors
    /// If a flight cannot be simulated again.
    pub fn with_flights(comparison: &Comparison, tracks: &[Track], vehicle: &Vehicle) -> Result<Self> {
        let mut report = Self::of_comparison(comparison.clone());
        let logs: Vec<_> = tracks.iter().map(|t| (t, None)).collect();
        add_overlays(&mut report, &logs, vehicle, None)?;
        report.live = Some(Live::without_effects(tracks, vehicle)?);
        Ok(report)
    }

    /// The page of a diagnosis; `after` is the vehicle with the findings, if there are any.
    ///
    /// # Errors
    /// If a flight cannot be simulated again.
    pub fn of_diagnosis(
        diagnosed: &Diagnosed,
        flights: &Flights,
        before: &Vehicle,
        after: Option<&Vehicle>,
    ) -> Result<Self> {
        let mut report = Self::of(diagnosed.verdict.clone());
        let mut all = flights.all();
        // A held-out log that is too short to compare is skipped.
        report.comparison_before = Some(loop {
            match compare(&all, before) {
                Err(GapError::TooShort { log, .. })
                    if flights.held_out.iter().any(|t| t.name == log)
                        && all.iter().any(|t| t.name == log) =>
                {
                    all.retain(|t| t.name != log);
                }
                other => break other?,
            }
        });
        report.comparison_after = after.map(|v| compare(&all, v)).transpose()?;
        // Held-out flight first.
        let parted = flights.whole.iter().zip(&flights.cut_s);
        let held_out = flights.held_out.iter().map(|t| (t, None));
        let logs: Vec<_> = held_out.chain(parted.map(|(t, cut)| (t, *cut))).collect();
        add_overlays(&mut report, &logs, before, after)?;
        report.live = Some(Live::of(diagnosed, flights, before, after)?);
        Ok(report)
    }
}
