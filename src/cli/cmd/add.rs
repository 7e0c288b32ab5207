//! `propwash add`: fitted effects into a vehicle file.

use super::diagnose::{fit, json_error, open, refuse_log};
use super::vehicle::{save, text_of};
use super::{drones, io_error, print, print_json};
use crate::cli::exit::Outcome;
use crate::cli::gap_args::AddArgs;
use crate::cli::output;
use crate::flight::files;
use crate::gap::Drive;
use crate::gap::GapError;
use crate::gap::accept::{self, Source, today_utc};
use crate::gap::complete::{Completion, Entry, note};
use crate::gap::diagnose::Settings;
use crate::gap::fitted::{Calibrate, Filed};
use crate::gap::formula::{Formula, with_formulas};
use crate::gap::headline::{before_after, pair};
use crate::gap::network::{FoundNetwork, with_network};
use crate::gap::report::{Report, turns};
use crate::gap::session::{Put, completed_by};
use crate::gap::verdict::{Calibration, HorizonError, ParameterFit, Rung};
use crate::physics::drone::Drone;
use crate::physics::effects::{Area, candidates};
use crate::vehicle::Vehicle;
use crate::{Error, Result};
use serde::Deserialize;
use serde_json::json;
use std::path::Path;

/// Runs the command.
pub fn run(args: &AddArgs) -> Result<Outcome> {
    accept::may_write(&args.out, args.force)?;
    let report = args.report.as_deref();
    output::check(&[("--out", Some(&args.out)), ("--report", report)], args.force)?;
    match &args.from_diagnosis {
        Some(path) => from_diagnosis(args, path),
        None if args.set.is_empty() && args.adjust.is_empty() => fitted(args),
        None => by_values(args),
    }
}

/// Writes values that are given, without a fit.
fn by_values(args: &AddArgs) -> Result<Outcome> {
    refuse_log("--out", Some(&args.out), &args.fit, &args.held_out.held_out)?;
    let (vehicle, flights) = open(&args.reading, &args.fit, &args.held_out)?;
    let name = &args.reading.vehicle;
    let corrections = args.adjust.iter().map(|put| Put { correction: true, ..put.clone() });
    let puts: Vec<Put> = args.set.iter().cloned().chain(corrections).collect();
    let filed = Filed { label: name, vehicle: &vehicle, text: text_of(name)? };
    let (text, _, remarks) = completed_by(&filed, &flights, "propwash add", &puts, &args.expression)?;
    accept_and_say(args, &text)?;
    if args.json {
        return print_json(
            &json!({ "vehicle": name, "out": &args.out, "values": puts.len(), "remarks": remarks }),
        )
        .map(|()| Outcome::Fine);
    }
    for put in &puts {
        print(put)?;
    }
    for remark in remarks {
        print(format_args!("warning: {remark}"))?;
    }
    Ok(Outcome::Fine)
}

fn fitted(args: &AddArgs) -> Result<Outcome> {
    refuse_log("--out", Some(&args.out), &args.fit, &args.held_out.held_out)?;
    refuse_log("--report", args.report.as_deref(), &args.fit, &args.held_out.held_out)?;
    let (vehicle, flights) = open(&args.reading, &args.fit, &args.held_out)?;
    // Only the page and the JSON hold the advice.
    let no_advice = args.report.is_none() && !args.json;
    let (given, network) = (Some(args.effects.clone()), args.network);
    let settings = Settings { given, no_advice, network, ..Settings::default() };
    let name = &args.reading.vehicle;
    let calibrate = if args.calibrate { Calibrate::Write } else { Calibrate::No };
    let mut fitted = fit(name, &vehicle, &flights, settings, "add", calibrate)?;
    let undetermined = fitted.diagnosed.undetermined();
    if let (Some(open), false) = (undetermined.first(), args.force) {
        return Err(Error::Gap(GapError::Log {
            log: flights.fit.iter().map(|t| t.name.as_str()).collect::<Vec<_>>().join(", "),
            expected: format!("a flight that shows {}", open.id),
            found: format!("one that does not show it ({})", open.found),
            remedy: format!("{}; or add --force to write the value all the same", open.manoeuvre),
        }));
    }
    if !fitted.unwritable.is_empty() {
        // The file cannot hold it: its own words say why.
        return Err(fitted.unwritable.remove(0).1.into());
    }
    let verdict = &fitted.diagnosed.verdict;
    if let Some(path) = &args.report {
        let page = Report::of_diagnosis(&fitted.diagnosed, &flights, &vehicle, fitted.after())?;
        output::report("--report", path, page.html().as_bytes(), args.force)?;
    }
    let nothing = fitted.nothing();
    if nothing.is_none() {
        accept_and_say(args, &fitted.text)?;
    }
    let outcome = if nothing.is_some() { Outcome::Found } else { Outcome::Fine };
    if args.json {
        return print_json(&json!({
            "vehicle": name,
            "out": nothing.is_none().then_some(&args.out),
            "nothing_written": nothing,
            "calibrated": fitted.calibrated,
            "diagnosis": serde_json::to_value(verdict).map_err(json_error)?,
        }))
        .map(|()| outcome);
    }
    if let Some(words) = &nothing {
        print(words)?;
    }
    for f in verdict.findings.iter().filter(|f| f.unwritten().is_none()) {
        show_parameters(&f.id, &f.parameters)?;
        if let Some(words) = before_after(f) {
            print(format_args!("{}  {words}", f.id))?;
        }
    }
    if nothing.is_none() {
        for f in &verdict.findings {
            if let Some(reason) = f.unwritten() {
                print(format_args!("{}: {reason}", f.id))?;
            }
        }
    }
    if args.calibrate {
        print(match fitted.calibrated {
            0 => "no group of parameters within tolerance lowers the error on unseen flight: they stay as filed".into(),
            n => format!("and {n} parameters within tolerance at their estimates"),
        })?;
    }
    if let Some(network) = &verdict.network {
        print(&network.text)?;
    }
    if let [before, .., after] = &verdict.ladder[..] {
        show_errors(before, after)?;
    }
    for warning in &verdict.warnings {
        print(format_args!("warning: {warning}"))?;
    }
    Ok(outcome)
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

/// Errors before and after, on unseen flight where there is some.
fn show_errors(before: &Rung, after: &Rung) -> Result<()> {
    let unseen = !after.held_out.is_empty();
    let errors = |r: &Rung| if unseen { r.held_out.clone() } else { r.training.clone() };
    let lack = |r: &Rung| if unseen { r.held_out_lack } else { r.training_lack };
    let on = if unseen { "flight that the fit has not seen" } else { "flight used for the fit" };
    print(format_args!("error on {on}, before → after"))?;
    if let (Some(b), Some(a)) = (lack(before), lack(after)) {
        print(format_args!("  force that the model lacks   {}", pair(b.force_n, a.force_n, "N")))?;
        if let (Some(b), Some(a)) = (b.torque_n_m, a.torque_n_m) {
            print(format_args!("  torque that the model lacks  {}", pair(b, a, "N·m")))?;
        }
    }
    let turning = turns(std::slice::from_ref(before));
    let mut head = format!("  {:>5}  {:>20}  {:>20}", "s", "position mm", "velocity mm/s");
    if turning {
        head = format!("{head}  {:>20}  {:>20}", "attitude °", "rate °/s");
    }
    print(head)?;
    for (b, a) in errors(before).iter().zip(errors(after)) {
        let cell = |pick: fn(&HorizonError) -> f64| format!("{:.2} → {:.2}", pick(b), pick(&a));
        let (position, velocity) = (cell(|e| 1e3 * e.position_m), cell(|e| 1e3 * e.velocity_m_s));
        let mut line = format!("  {:>5}  {position:>20}  {velocity:>20}", a.horizon_s);
        if turning {
            let (turn, rate) = (cell(|e| e.attitude_rad.to_degrees()), cell(|e| e.rate_rad_s.to_degrees()));
            line = format!("{line}  {turn:>20}  {rate:>20}");
        }
        print(line)?;
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
    #[serde(default)]
    formulas: Vec<Formula>,
    #[serde(default)]
    network: Option<SavedNetwork>,
}

#[derive(Deserialize)]
struct SavedNetwork {
    found: Option<FoundNetwork>,
}

impl Saved {
    /// The network that was found, if one was.
    fn found_network(&self) -> Option<&FoundNetwork> {
        self.network.as_ref().and_then(|n| n.found.as_ref())
    }
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
    #[serde(default)]
    held_out: Option<SavedHeldOut>,
}

#[derive(Deserialize)]
struct SavedHeldOut {
    doubt: Option<String>,
    #[serde(default)]
    little: bool,
}

impl SavedFinding {
    /// Why it is not written, where it is not. What takes little off the errors is written all the same where it is asked for by name.
    fn unwritten(&self, asked: &[String]) -> Option<&str> {
        let held_out = self.held_out.as_ref().filter(|h| !(h.little && asked.contains(&self.id)));
        held_out.and_then(|h| h.doubt.as_deref())
    }
}

/// What is wrong with the diagnosis that was saved.
fn usage(expected: String, got: String) -> Error {
    Error::Usage { flag: "--from-diagnosis", expected, got }
}

/// Refuses what no diagnosis of the vehicle says: dynamics that the logs do not drive, effects beyond all reason.
fn believe(saved: &Saved, vehicle: &Vehicle, path: &Path) -> Result<()> {
    /// Plausible sizes by which a parameter may be off.
    const MOST: f64 = 1000.0;
    let refuse = |expected: String, got: String| {
        let got = format!("{got} in {}: diagnose again", path.display());
        Err(usage(expected, got))
    };
    for log in &saved.logs {
        let Some(drive) = Drive::ALL.into_iter().find(|drive| drive.title() == log.drive) else {
            let known = Drive::ALL.map(Drive::title).join(", ");
            return refuse(format!("a log driven by one of {known}"), format!("`{}`", log.drive));
        };
        let dynamics = drive.dynamics(vehicle);
        if dynamics != saved.dynamics {
            let expected = format!("the dynamics {dynamics}, which {} drive", log.drive);
            return refuse(expected, format!("`{}`", saved.dynamics));
        }
    }
    let possible = candidates(&vehicle.drone(&saved.dynamics)?);
    let findings = saved.findings.iter().flat_map(|f| f.parameters.iter().map(move |p| (&f.id, p)));
    for (id, p) in findings.chain(saved.adjusted.iter().map(|c| (&c.id, &c.parameter))) {
        let candidate = possible.iter().find(|c| c.id == *id);
        let freedom = candidate.and_then(|c| c.freedoms.iter().find(|f| f.name == p.name));
        let Some(size) = freedom.map(|f| f.slab.max(f.spike)).filter(|size| *size > 0.0) else { continue };
        if (p.value - p.filed).abs() > MOST * size {
            let expected =
                format!("{} of {id} within {MOST} times its plausible size, {size:.3e} {}", p.name, p.unit);
            return refuse(expected, format!("{:e}", p.value));
        }
    }
    Ok(())
}

/// Refuses effects with which the rotors do not carry a vehicle that they carry without.
fn carries(before: &Drone<f64>, after: &Drone<f64>, path: &Path) -> Result<()> {
    let most = after.airframe.n_rotors as f64 * after.controller.thrust_max_n;
    let weight = after.hover_thrust();
    if weight <= most || before.hover_thrust() > most {
        return Ok(());
    }
    Err(usage(
        format!("a vehicle of at most {most:.4} N, which all rotors together lift"),
        format!(
            "one of {weight:.4e} N with the effects of {}: diagnose again, or correct thrust_max_n in the vehicle file",
            path.display()
        ),
    ))
}

fn read_saved(path: &Path) -> Result<Saved> {
    let text = files::read_text(path).map_err(io_error(path))?;
    serde_json::from_str(&text).map_err(|e| {
        usage(
            "a file that `propwash diagnose --out` of this version wrote".into(),
            format!("{}, in which {e}", path.display()),
        )
    })
}

/// Refuses the diagnosis of a file with other contents: its values would stand beside numbers that they were not fitted with.
fn same_vehicle(saved: &Saved, vehicle: &Vehicle, name: &str) -> Result<()> {
    if vehicle.sha256() == saved.vehicle_sha256 {
        return Ok(());
    }
    Err(usage(
        format!("a diagnosis of {name} as it is now"),
        format!(
            "one of the vehicle `{}` with other contents (sha256 {:.12}…, not {:.12}…): diagnose again with {name}, \
             or name the file that was diagnosed",
            saved.vehicle,
            saved.vehicle_sha256,
            vehicle.sha256()
        ),
    ))
}

/// Refuses names of effects that the diagnosis did not find.
fn has_found(saved: &Saved, effects: &[String]) -> Result<()> {
    let mut known: Vec<&str> = saved.findings.iter().map(|f| f.id.as_str()).collect();
    known.extend(saved.found_network().map(|n| n.id.as_str()));
    let Some(unknown) = effects.iter().find(|e| !known.contains(&e.as_str())) else { return Ok(()) };
    let list = if known.is_empty() { "nothing".into() } else { known.join(", ") };
    Err(Error::Gap(GapError::Unknown {
        name: unknown.clone(),
        what: "effect that this diagnosis found",
        known: list,
    }))
}

/// What the values were fitted to, for the vehicle file.
fn source_of(saved: &Saved) -> Source {
    let fit: Vec<&SavedLog> = saved.logs.iter().filter(|l| !l.held_out).collect();
    Source {
        log_sha256: fit.iter().map(|l| l.sha256.clone()).collect(),
        date: today_utc(),
        text: format!(
            "propwash diagnose on {}, driven by {}",
            fit.iter().map(|l| l.name.as_str()).collect::<Vec<_>>().join(", "),
            fit.first().map_or("nothing", |l| l.drive.as_str())
        ),
    }
}

/// What of a diagnosis goes into the vehicle file, and what does not.
struct Taken<'a> {
    written: Vec<&'a SavedFinding>,
    /// Findings that are left out, each with its reason.
    doubtful: Vec<String>,
    /// All findings that may be written were: none was left out by name.
    whole: bool,
    /// Parameters within tolerance that were written.
    calibrated: usize,
    /// The network that was written.
    network: Option<&'a FoundNetwork>,
}

impl Taken<'_> {
    fn is_nothing(&self) -> bool {
        self.written.is_empty() && self.calibrated == 0 && self.network.is_none()
    }
}

/// Puts the findings that were asked for, and the calibration, into `completion`.
fn take<'a>(args: &AddArgs, saved: &'a Saved, completion: &mut Completion) -> Result<Taken<'a>> {
    let chosen = |f: &&SavedFinding| args.effects.is_empty() || args.effects.contains(&f.id);
    let (mut written, mut doubtful) = (Vec::new(), Vec::new());
    for f in saved.findings.iter().filter(chosen) {
        if let Some(reason) = f.unwritten(&args.effects) {
            doubtful.push(format!("{}: {reason}", f.id));
            continue;
        }
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
    let whole =
        written.len() == saved.findings.iter().filter(|f| f.unwritten(&args.effects).is_none()).count();
    if !written.is_empty() {
        completion.partners(&saved.adjusted)?;
    }
    let helping: Vec<Calibration> = saved.adjusted.iter().filter(|c| c.helps).cloned().collect();
    let calibrated = if args.calibrate && whole { completion.calibrate(&helping)? } else { 0 };
    Ok(Taken { written, doubtful, whole, calibrated, network: None })
}

/// The network of a diagnosis, where it is asked for: it was fitted beside everything else that was found, and goes with all of it.
fn network_of<'a>(args: &AddArgs, saved: &'a Saved, taken: &Taken) -> Option<&'a FoundNetwork> {
    let asked = |n: &&FoundNetwork| args.effects.is_empty() || args.effects.contains(&n.id);
    saved.found_network().filter(asked).filter(|_| taken.whole)
}

/// The text of the vehicle file with those formulas of a diagnosis that are `wanted`, which are effects of the file from here on.
fn with_found(
    saved: &Saved,
    name: &str,
    path: &Path,
    wanted: impl Fn(&str) -> bool,
) -> Result<(String, Vehicle)> {
    let list: Vec<Formula> = saved.formulas.iter().filter(|f| wanted(&f.id)).cloned().collect();
    let text = with_formulas(&text_of(name)?, &list);
    match Vehicle::from_toml(name, &text) {
        Ok(vehicle) => Ok((text, vehicle)),
        Err(error) => Err(usage(
            "formulas as a diagnosis writes them".into(),
            format!("in {}: {error}", path.display()),
        )),
    }
}

fn from_diagnosis(args: &AddArgs, path: &Path) -> Result<Outcome> {
    let saved = read_saved(path)?;
    let name = &args.reading.vehicle;
    let vehicle = drones::find(name)?;
    same_vehicle(&saved, &vehicle, name)?;
    believe(&saved, &with_found(&saved, name, path, |_| true)?.1, path)?;
    has_found(&saved, &args.effects)?;
    let written = |id: &str| {
        let asked = args.effects.is_empty() || args.effects.iter().any(|e| e == id);
        asked && saved.findings.iter().any(|f| f.id == id && f.unwritten(&args.effects).is_none())
    };
    let (text, _) = with_found(&saved, name, path, written)?;
    let mut completion = Completion::new(&vehicle, text, name, &saved.dynamics, source_of(&saved));
    let mut taken = take(args, &saved, &mut completion)?;
    taken.network = network_of(args, &saved, &taken);
    if let Some(network) = taken.network {
        if network.with_calibration && !args.calibrate {
            let helping: Vec<Calibration> = saved.adjusted.iter().filter(|c| c.helps).cloned().collect();
            taken.calibrated = completion.calibrate(&helping)?;
        }
        completion.text = with_network(&completion.text, network);
    }
    if !taken.is_nothing() {
        let better = Vehicle::from_toml(name, &completion.text)?;
        carries(&vehicle.drone(&saved.dynamics)?, &better.drone(&saved.dynamics)?, path)?;
        accept_and_say(args, &completion.text)?;
    }
    say_taken(args, &taken, &completion.remarks)?;
    Ok(if taken.is_nothing() { Outcome::Found } else { Outcome::Fine })
}

/// Prints what was taken of a diagnosis, as text or as JSON.
fn say_taken(args: &AddArgs, taken: &Taken, remarks: &[String]) -> Result<()> {
    let nothing = taken.is_nothing();
    if args.json {
        let mut ids: Vec<&str> = taken.written.iter().map(|f| f.id.as_str()).collect();
        ids.extend(taken.network.map(|n| n.id.as_str()));
        return print_json(&json!({
            "vehicle": &args.reading.vehicle,
            "out": (!nothing).then_some(&args.out),
            "effects": ids,
            "doubtful": taken.doubtful,
            "calibrated": taken.calibrated,
            "remarks": remarks,
        }));
    }
    if nothing {
        print("nothing is written: the diagnosis found nothing that makes the vehicle better")?;
    }
    for f in &taken.written {
        show_parameters(&f.id, &f.parameters)?;
    }
    if let Some(network) = taken.network {
        let (id, file) = (&network.id, &network.file);
        print(format_args!(
            "{id}  a network of {} weights, beside the vehicle file: {file}",
            network.n_weights
        ))?;
    }
    for words in &taken.doubtful {
        print(words)?;
    }
    if args.calibrate {
        print(match taken.calibrated {
            0 if !taken.whole => {
                "parameters within tolerance stay as filed: their estimates hold with all findings only"
                    .into()
            }
            0 => "parameters within tolerance stay as filed: none lowers the error on unseen flight".into(),
            n => format!("and {n} parameters within tolerance at their estimates"),
        })?;
    }
    for remark in remarks {
        print(format_args!("warning: {remark}"))?;
    }
    Ok(())
}
