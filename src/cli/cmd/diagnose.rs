//! `propwash diagnose`: which physics a vehicle's model lacks.

use super::vehicle::text_of;
use super::{print, print_json};
use crate::cli::exit::Outcome;
use crate::cli::gap_args::{DiagnoseArgs, HeldOutArgs};
use crate::cli::gap_logs::ReadingArgs;
use crate::cli::output;
use crate::gap::diagnose::{Moments, Settings};
use crate::gap::fitted::{self, Calibrate, Filed, Fitted};
use crate::gap::ladder::Flights;
use crate::gap::report::{Report, ladder_png, text, why};
use crate::gap::watch::Watch;
use crate::gap::{Diagnosis, GapError, compare};
use crate::vehicle::Vehicle;
use crate::{Error, Result};
use indicatif::{ProgressBar, ProgressStyle};
use std::path::{Path, PathBuf};

/// Runs the command.
pub fn run(args: &DiagnoseArgs) -> Result<Outcome> {
    let outputs = [("--out", &args.out), ("--report", &args.report), ("--ladder", &args.ladder)]
        .map(|(flag, path)| (flag, path.as_deref()));
    for (flag, path) in outputs {
        refuse_log(flag, path, &args.logs.logs, &args.held_out.held_out)?;
    }
    output::check(&outputs, args.force)?;
    let (vehicle, flights) = open(&args.logs.reading, &args.logs.logs, &args.held_out)?;
    let only = (!args.candidates.is_empty()).then(|| args.candidates.clone());
    let moments = if args.no_moments { Moments::No } else { Moments::Apart };
    let (no_formulas, network) = (args.no_formulas, args.network);
    let settings = Settings { only, no_formulas, network, moments, ..Settings::default() };
    let fitted = fit(&args.logs.reading.vehicle, &vehicle, &flights, settings, "diagnose", Calibrate::Show)?;
    let verdict = &fitted.diagnosed.verdict;
    if let Some(path) = &args.out {
        let text = serde_json::to_string_pretty(verdict).map_err(json_error)?;
        output::report("--out", path, format!("{text}\n").as_bytes(), args.force)?;
    }
    // Said before anything is drawn: a picture that cannot be drawn takes no verdict back. Nor does a reader that has seen enough
    // (`propwash diagnose … | head`) take the files.
    let said = say(args, verdict);
    if let Some(path) = &args.ladder {
        output::report("--ladder", path, &ladder_png(verdict)?, args.force)?;
    }
    if let Some(path) = &args.report {
        let page =
            Report::of_diagnosis(&fitted.diagnosed, fitted.flights(&flights), &vehicle, fitted.after())?;
        output::report("--report", path, page.html().as_bytes(), args.force)?;
    }
    said?;
    Ok(outcome(verdict))
}

fn say(args: &DiagnoseArgs, verdict: &Diagnosis) -> Result<()> {
    if args.json {
        return print_json(&serde_json::to_value(verdict).map_err(json_error)?);
    }
    print(text(verdict).trim_end())?;
    if args.why { print(why(verdict).trim_end()) } else { Ok(()) }
}

/// Exit code of a verdict: found where something is missing, unexplained or changed in mid-flight.
pub fn outcome(verdict: &Diagnosis) -> Outcome {
    let network = verdict.network.as_ref().is_some_and(|n| n.found.is_some());
    let listed = verdict.findings.is_empty() && verdict.moments.is_empty();
    let fine = listed && !verdict.remainder.unexplained && !network;
    if fine { Outcome::Fine } else { Outcome::Found }
}

/// An error of writing JSON.
pub fn json_error(e: serde_json::Error) -> Error {
    Error::Gap(GapError::Numbers { what: "JSON", reason: e.to_string() })
}

/// Refuses an output that is one of the logs.
pub fn refuse_log(flag: &'static str, path: Option<&Path>, logs: &[PathBuf], more: &[PathBuf]) -> Result<()> {
    let same = |log: &PathBuf| Some(log.as_path()) == path;
    match logs.iter().chain(more).find(|l| same(l)) {
        Some(log) => Err(Error::Usage {
            flag,
            expected: "a file to write that is none of the logs".into(),
            got: log.display().to_string(),
        }),
        None => Ok(()),
    }
}

/// The vehicle and the flights, parted into what the fit sees and what checks it.
pub fn open(reading: &ReadingArgs, logs: &[PathBuf], held_out: &HeldOutArgs) -> Result<(Vehicle, Flights)> {
    if let Some(both) = held_out.held_out.iter().find(|l| logs.contains(l)) {
        return Err(Error::Usage {
            flag: "--held-out",
            expected: "flights that the fit does not see".into(),
            got: format!("{}, which is one of the logs to fit", both.display()),
        });
    }
    let (vehicle, tracks) = reading.open(logs)?;
    let (mut unseen, mut short) = (Vec::new(), Vec::new());
    for log in &held_out.held_out {
        match reading.open(std::slice::from_ref(log)) {
            Ok((_, track)) => unseen.extend(track),
            // A fit needs no such log.
            Err(Error::Gap(error @ GapError::TooShort { .. })) => {
                short.push(format!("not held out: {error}"));
            }
            Err(error) => return Err(error),
        }
    }
    let mut flights = Flights::new(tracks, unseen, held_out.hold_out);
    flights.warnings.extend(short);
    compare::one_vehicle(&flights.all())?;
    Ok((vehicle, flights))
}

/// Diagnoses flights and completes the vehicle, with a bar on a terminal. `name` is the vehicle as it was asked for,
/// `command` names the command in the file's sources.
pub fn fit(
    name: &str,
    vehicle: &Vehicle,
    flights: &Flights,
    settings: Settings,
    command: &str,
    calibrate: Calibrate,
) -> Result<Fitted> {
    let style = ProgressStyle::with_template("{bar:40} fitting, {elapsed} elapsed");
    let bar = ProgressBar::new(1).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    let progress = |done: usize, of: usize| {
        bar.set_length(of as u64);
        bar.set_position(done as u64);
    };
    let settings = Settings { watch: Watch { progress: Some(&progress), ..Watch::default() }, ..settings };
    let filed = Filed { label: name, vehicle, text: text_of(name)? };
    let result = fitted::fit(filed, flights, &settings, &format!("propwash {command}"), calibrate);
    bar.finish_and_clear();
    Ok(result?)
}
