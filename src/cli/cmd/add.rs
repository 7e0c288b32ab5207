//! `propwash add`: fitted effects into a vehicle file.

use super::diagnose::{fit, json_error, open, refuse_log};
use super::vehicle::{save, text_of};
use super::{drones, io_error, print, print_json, report};
use crate::cli::exit::Outcome;
use crate::cli::gap_args::AddArgs;
use crate::gap::GapError;
use crate::gap::accept::{self, Source, today_utc};
use crate::gap::complete::{Completion, Entry, note};
use crate::gap::diagnose::Settings;
use crate::gap::fitted::Fitted;
use crate::gap::report::Report;
use crate::gap::verdict::{Calibration, HorizonError, ParameterFit, Rung};
use crate::physics::effects::Area;
use crate::{Error, Result};
use serde::Deserialize;
use serde_json::json;
use std::path::Path;

/// Runs the command.
pub fn run(args: &AddArgs) -> Result<Outcome> {
    accept::may_write(&args.out, args.force)?;
    match &args.from_diagnosis {
        Some(path) => from_diagnosis(args, path),
        None => fitted(args),
    }
}

fn fitted(args: &AddArgs) -> Result<Outcome> {
    refuse_log("--out", Some(&args.out), &args.fit, &args.held_out)?;
    refuse_log("--report", args.report.as_deref(), &args.fit, &args.held_out)?;
    let (vehicle, flights) = open(&args.reading, &args.fit, &args.held_out)?;
    let settings = Settings { given: Some(args.effects.clone()), ..Settings::default() };
    let name = &args.reading.vehicle;
    let Fitted { diagnosed, steps } = fit(name, &vehicle, &flights, settings, "add", !args.effects_only)?;
    if let (Some(open), false) = (diagnosed.undetermined().first(), args.force) {
        return Err(Error::Gap(GapError::Log {
            log: flights.fit.iter().map(|t| t.name.as_str()).collect::<Vec<_>>().join(", "),
            expected: format!("a flight that shows {}", open.id),
            found: format!("one that does not show it ({})", open.found),
            remedy: format!("{}; or add --force to write the value all the same", open.manoeuvre),
        }));
    }
    let verdict = &diagnosed.verdict;
    let missing =
        verdict.findings.iter().find(|f| !steps.rungs.iter().any(|(l, _)| *l == format!("+ {}", f.id)));
    if let Some(f) = missing {
        // The file cannot hold it: its own words say why.
        let mut completion = Completion::new(
            &vehicle,
            text_of(name)?,
            name,
            &verdict.dynamics,
            Source { log_sha256: Vec::new(), date: today_utc(), text: "propwash add".into() },
        );
        completion.add(&Entry::of(f))?;
    }
    if let Some(path) = &args.report {
        let after = steps.rungs.last().map(|(_, v)| v);
        let page = Report::of_diagnosis(verdict, &flights, &vehicle, after)?;
        report::write(path, page.html().as_bytes())?;
    }
    accept_and_say(args, &steps.text)?;
    if args.json {
        return print_json(&json!({
            "vehicle": name,
            "out": args.out,
            "diagnosis": serde_json::to_value(verdict).map_err(json_error)?,
        }))
        .map(|()| Outcome::Fine);
    }
    for f in &verdict.findings {
        show_parameters(&f.id, &f.parameters)?;
    }
    let calibrated = verdict.ladder.last().is_some_and(|r| r.label == "+ calibration");
    if calibrated {
        print("and parameters within tolerance at their estimates (--effects-only leaves them as filed)")?;
    }
    if let [before, .., after] = &verdict.ladder[..] {
        show_errors(before, after)?;
    }
    for warning in &verdict.warnings {
        print(format_args!("warning: {warning}"))?;
    }
    Ok(Outcome::Fine)
}

/// Writes the file, and says so where no JSON is printed.
fn accept_and_say(args: &AddArgs, text: &str) -> Result<()> {
    if args.json {
        accept::write(&args.out, text, args.force)?;
        return Ok(());
    }
    save(&args.reading.vehicle, text, &args.out, args.force)
}

fn show_parameters(id: &str, parameters: &[ParameterFit]) -> Result<()> {
    for p in parameters {
        let unit = if p.unit == "1" { "" } else { &p.unit };
        let line = format!("{id}  {} = {:.5e} ± {:.1e} {unit}", p.name, p.value, p.sigma);
        print(format_args!("{}  (filed {:.5e})", line.trim_end(), p.filed))?;
    }
    Ok(())
}

/// Errors of roll-outs before and after, on unseen flight where there is some.
fn show_errors(before: &Rung, after: &Rung) -> Result<()> {
    let unseen = !after.held_out.is_empty();
    let errors = |r: &Rung| if unseen { r.held_out.clone() } else { r.training.clone() };
    let on = if unseen { "flight that the fit has not seen" } else { "the flight of the fit" };
    print(format_args!("error of roll-outs on {on}, before → after"))?;
    print(format_args!(
        "  {:>5}  {:>20}  {:>20}  {:>20}  {:>20}",
        "s", "position mm", "velocity mm/s", "attitude mrad", "rate mrad/s"
    ))?;
    for (b, a) in errors(before).iter().zip(errors(after)) {
        let cell = |pick: fn(&HorizonError) -> f64| format!("{:.2} → {:.2}", 1e3 * pick(b), 1e3 * pick(&a));
        print(format_args!(
            "  {:>5}  {:>20}  {:>20}  {:>20}  {:>20}",
            a.horizon_s,
            cell(|e| e.position_m),
            cell(|e| e.velocity_m_s),
            cell(|e| e.attitude_rad),
            cell(|e| e.rate_rad_s)
        ))?;
    }
    Ok(())
}

/// What is needed of a diagnosis that was saved.
#[derive(Deserialize)]
struct Saved {
    vehicle: String,
    vehicle_sha256: String,
    dynamics: String,
    logs: Vec<SavedLog>,
    findings: Vec<SavedFinding>,
    adjusted: Vec<Calibration>,
}

#[derive(Deserialize)]
struct SavedLog {
    name: String,
    sha256: String,
    drive: String,
    held_out: bool,
}

#[derive(Deserialize)]
struct SavedFinding {
    id: String,
    kind: String,
    area: Area,
    parameters: Vec<ParameterFit>,
    set: Vec<(String, f64)>,
}

fn from_diagnosis(args: &AddArgs, path: &Path) -> Result<Outcome> {
    let usage = |expected: String, got: String| Error::Usage { flag: "--from-diagnosis", expected, got };
    let text = std::fs::read_to_string(path).map_err(io_error(path))?;
    let saved: Saved = serde_json::from_str(&text).map_err(|e| {
        usage(
            "a file that `propwash diagnose --out` of this version wrote".into(),
            format!("{}, in which {e}", path.display()),
        )
    })?;
    let name = &args.reading.vehicle;
    let vehicle = drones::find(name)?;
    if vehicle.sha256() != saved.vehicle_sha256 {
        return Err(usage(
            format!("a diagnosis of {name} as it is now"),
            format!(
                "one of the vehicle `{}` with other contents (sha256 {:.12}…, not {:.12}…): diagnose again with {name}, \
                 or name the file that was diagnosed",
                saved.vehicle,
                saved.vehicle_sha256,
                vehicle.sha256()
            ),
        ));
    }
    let known: Vec<&str> = saved.findings.iter().map(|f| f.id.as_str()).collect();
    if let Some(unknown) = args.effects.iter().find(|e| !known.contains(&e.as_str())) {
        let list = if known.is_empty() { "nothing".into() } else { known.join(", ") };
        return Err(Error::Gap(GapError::Unknown {
            name: unknown.clone(),
            what: "effect that this diagnosis found",
            known: list,
        }));
    }
    let chosen = |f: &&SavedFinding| args.effects.is_empty() || args.effects.contains(&f.id);
    let fit: Vec<&SavedLog> = saved.logs.iter().filter(|l| !l.held_out).collect();
    let source = Source {
        log_sha256: fit.iter().map(|l| l.sha256.clone()).collect(),
        date: today_utc(),
        text: format!(
            "propwash diagnose on {}, driven by {}",
            fit.iter().map(|l| l.name.as_str()).collect::<Vec<_>>().join(", "),
            fit.first().map_or("nothing", |l| l.drive.as_str())
        ),
    };
    let mut completion = Completion::new(&vehicle, text_of(name)?, name, &saved.dynamics, source);
    let mut written = Vec::new();
    for f in saved.findings.iter().filter(chosen) {
        let sensor = f.area == Area::Measurement;
        completion.add(&Entry {
            id: f.id.clone(),
            kind: f.kind.clone(),
            parameters: f.parameters.clone(),
            set: f.set.clone(),
            sensor,
            note: note(sensor, &f.kind),
        })?;
        written.push(f);
    }
    // The calibration goes with all findings together: some of them left out, it would make up for them.
    let whole = written.len() == saved.findings.len();
    let calibrated = if args.effects_only || !whole { 0 } else { completion.calibrate(&saved.adjusted)? };
    if written.is_empty() && calibrated == 0 {
        return Err(usage(
            "a diagnosis that found something to write".into(),
            "one that found nothing".into(),
        ));
    }
    accept_and_say(args, &completion.text)?;
    if args.json {
        let ids: Vec<&str> = written.iter().map(|f| f.id.as_str()).collect();
        return print_json(&json!({
            "vehicle": name,
            "out": args.out,
            "effects": ids,
            "calibrated": calibrated,
            "remarks": completion.remarks,
        }))
        .map(|()| Outcome::Fine);
    }
    for f in written {
        show_parameters(&f.id, &f.parameters)?;
    }
    if calibrated > 0 {
        print(format_args!(
            "and {calibrated} parameters within tolerance at their estimates (--effects-only leaves them as filed)"
        ))?;
    }
    if !whole && !args.effects_only {
        print("parameters within tolerance stay as filed: their estimates hold with all findings only")?;
    }
    for remark in &completion.remarks {
        print(format_args!("warning: {remark}"))?;
    }
    Ok(Outcome::Fine)
}
