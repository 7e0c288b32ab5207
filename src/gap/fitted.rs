//! From flights to a diagnosis and the vehicle that it completes: what `diagnose` and `add` do, without a terminal.

use super::accept::{Source, today_utc};
use super::complete::{Steps, steps};
use super::diagnose::{Diagnosed, Settings, diagnose};
use super::ladder::Flights;
use super::track::{Options, Track};
use crate::Result;
use crate::flight::{Fault, FlightLog, Severity};
use crate::vehicle::Vehicle;
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Logs made ready for a vehicle. Every log is checked first: one that cannot be right is refused, and what else the checker
/// says goes into the warnings of its track.
///
/// # Errors
/// Those of [`FlightLog::open`] and of [`Track::new`].
pub fn read(
    logs: &[PathBuf],
    mapping: Option<&Path>,
    vehicle: &Vehicle,
    options: &Options,
) -> Result<Vec<Track>> {
    logs.par_iter()
        .map(|path| {
            let (log, report) = FlightLog::open(path, mapping)?;
            // What is left out, the track says itself.
            let own = |f: Fault| matches!(f, Fault::Gap | Fault::Glitch | Fault::RotorDead | Fault::Crash);
            let found = report.findings.iter().filter(|f| f.severity == Severity::Warning && !own(f.fault));
            let mut said: Vec<String> = log.warnings.clone();
            for text in found.map(|f| f.text.clone()) {
                if !said.contains(&text) {
                    said.push(text);
                }
            }
            let mut track = Track::new(log, vehicle, options)?;
            said.append(&mut track.warnings);
            track.warnings = said;
            Ok(track)
        })
        .collect()
}

/// The vehicle as it is filed.
pub struct Filed<'a> {
    /// Name or path, as messages say it.
    pub label: &'a str,
    /// What the file says.
    pub vehicle: &'a Vehicle,
    /// Its text, with comments.
    pub text: String,
}

/// A diagnosis with the vehicles that follow from it.
pub struct Fitted {
    /// With its ladder.
    pub diagnosed: Diagnosed,
    /// Vehicles and texts.
    pub steps: Steps,
}

impl Fitted {
    /// The vehicle with all that was found, where that changes it.
    pub fn after(&self) -> Option<&Vehicle> {
        self.steps.rungs[1..].last().map(|(_, vehicle)| vehicle)
    }
}

/// Diagnoses flights, completes the vehicle, and measures every step on all flights. `by` names who did it in the file's
/// sources; without `calibrate` parameters within tolerance stay as filed.
///
/// # Errors
/// Those of [`diagnose`], and where the text is no vehicle file.
pub fn fit(
    filed: Filed,
    flights: &Flights,
    settings: &Settings,
    by: &str,
    calibrate: bool,
) -> Result<Fitted> {
    let mut diagnosed = diagnose(&flights.fit, filed.vehicle, settings)?;
    let verdict = &mut diagnosed.verdict;
    verdict.logs = flights.summaries();
    let held: Vec<String> = flights
        .whole
        .iter()
        .zip(&flights.cut_s)
        .map(|(t, cut)| match cut {
            Some(cut) => format!("{} to {cut:.1} s", t.name),
            None => t.name.clone(),
        })
        .collect();
    let mut log_sha256: Vec<String> = flights.whole.iter().map(|t| t.log.sha256.clone()).collect();
    log_sha256.dedup();
    let source = Source {
        log_sha256,
        date: today_utc(),
        text: format!(
            "{by} on {}, driven by {}",
            held.join(", "),
            flights.whole.first().map_or("nothing", |t| t.drive.title())
        ),
    };
    let mut complete = verdict.clone();
    if !calibrate {
        complete.adjusted.clear();
    }
    let mut steps = steps(&complete, filed.vehicle, filed.text, filed.label, source)?;
    // A rung whose roll-outs run away is no rung; the others stand.
    match flights.ladder(&steps.rungs) {
        Ok(ladder) => verdict.ladder = ladder,
        Err(error) => verdict.warnings.push(format!("no error ladder: {error}")),
    }
    verdict.warnings.extend(flights.warnings.iter().cloned());
    verdict.warnings.append(&mut steps.remarks.clone());
    steps.remarks.dedup();
    Ok(Fitted { diagnosed, steps })
}
