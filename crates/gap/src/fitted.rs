//! From flights to a diagnosis and the vehicle completed by it: `diagnose` and `add` without a terminal.

mod calibration;
mod findings;
mod own;
mod partners;
mod parts;
mod sections;

use super::accept::{AcceptError, Source, today_utc};
use super::complete::{Completion, Entry};
use super::decide::rules::{Rule, Why};
use super::diagnose::{Diagnosed, Moments, Settings, diagnose, diagnose_from};
use super::formula::{self, Formula, Proposed};
use super::headline::{headline, pair};
use super::judge::{Judge, rung_over};
use super::ladder::Flights;
use super::network;
use super::policy::{HEADLINE_CHARS, WORSE};
use super::report::significant;
use super::track::{Noise, Options, Track};
use super::verdict::{Calibration, Diagnosis, Finding, Rung, Said};
use crate::error::{Error, GapError, Result};
use own::Own;
use propwash_flight::{CheckReport, Fault, FlightLog, Severity};
use propwash_vehicle::Vehicle;
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Prepares logs for a vehicle. Every log is checked first: an invalid one is refused, and the checker's other messages
/// become warnings of its track.
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
            let mut said: Vec<String> = log.warnings.clone();
            for text in warnings(&report) {
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

/// The checker's warnings, except about what a track leaves out and reports itself.
pub(crate) fn warnings(report: &CheckReport) -> Vec<String> {
    let own = |f: Fault| matches!(f, Fault::Gap | Fault::Glitch | Fault::RotorDead | Fault::Crash);
    let found = report.findings.iter().filter(|f| f.severity == Severity::Warning && !own(f.fault));
    found.map(|f| f.text.clone()).collect()
}

/// The vehicle as read from its file.
pub struct Filed<'a> {
    /// Name or path for messages.
    pub label: &'a str,
    /// The vehicle described by the file.
    pub vehicle: &'a Vehicle,
    /// The file's text, with comments.
    pub text: String,
}

/// How to treat parameters within tolerance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Calibrate {
    /// They stay nominal.
    No,
    /// The ladder shows their effect; they stay nominal.
    Show,
    /// Those of the groups that lower the held-out error are written.
    Write,
}

/// A diagnosis with the resulting vehicle.
pub struct Fitted {
    /// The diagnosis with its ladder.
    pub diagnosed: Diagnosed,
    /// The vehicle with everything written; `None` where nothing is.
    pub after: Option<Vehicle>,
    /// The text of its file; the original text where nothing is written.
    pub text: String,
    /// Number of parameters within tolerance that were written.
    pub calibrated: usize,
    /// Findings that cannot be written into a vehicle file, by id, with the reason.
    pub unwritable: Vec<(String, AcceptError)>,
    /// The vehicle with all that lowers the errors on the judge's flight, written or not; only where formulas were proposed.
    at_best: Option<Vehicle>,
    /// Where something changed in mid-flight: the flight that the diagnosis is about.
    now: Option<Flights>,
    /// What is written with all calibration that lowers the errors on the judge's flight; only where a network is searched.
    pub(crate) helped: Option<Helped>,
}

/// A vehicle with calibration.
pub(crate) struct Helped {
    pub vehicle: Vehicle,
    pub text: String,
    /// Number of parameters within tolerance that were set.
    pub calibrated: usize,
    /// All parameters within tolerance, those that help marked.
    pub adjusted: Vec<Calibration>,
}

impl Fitted {
    /// The flights that the diagnosis is about: of `all` of them the last part, where something changed in mid-flight.
    pub fn flights<'a>(&'a self, all: &'a Flights) -> &'a Flights {
        self.now.as_ref().unwrap_or(all)
    }

    /// The vehicle with everything written, if anything is.
    pub fn after(&self) -> Option<&Vehicle> {
        self.after.as_ref()
    }

    /// Why nothing is written, if nothing is.
    pub fn nothing(&self) -> Option<String> {
        if self.after.is_some() {
            return None;
        }
        let findings = &self.diagnosed.verdict.findings;
        let doubts: Vec<String> =
            findings.iter().filter_map(|f| Some(format!("{}: {}", f.id, f.unwritten()?))).collect();
        Some(if doubts.is_empty() {
            "nothing is written: nothing was found that changes the vehicle".into()
        } else {
            format!("nothing is written; {}", doubts.join("; "))
        })
    }
}

/// Diagnoses flights, completes the vehicle by what does not raise the held-out error, and measures every step on all
/// flights. Where something is unexplained that a formula describes, the formula is a candidate like any other, and is named where it
/// is then found and lowers the held-out error. `by` names the author in the file's sources.
///
/// # Errors
/// Those of [`diagnose`], and where the text is no vehicle file.
pub fn fit(
    filed: Filed,
    flights: &Flights,
    settings: &Settings,
    by: &str,
    calibrate: Calibrate,
) -> Result<Fitted> {
    let settings = &Settings { whole: Some(&flights.whole), ..settings.copied() };
    let diagnosed = diagnose(&flights.fit, filed.vehicle, settings)?;
    fit_from(filed, flights, settings, by, calibrate, diagnosed)
}

/// [`fit`] from the diagnosis without formulas.
pub(crate) fn fit_from(
    filed: Filed,
    flights: &Flights,
    settings: &Settings,
    by: &str,
    calibrate: Calibrate,
    diagnosed: Diagnosed,
) -> Result<Fitted> {
    if settings.moments == Moments::Apart && !diagnosed.verdict.moments.is_empty() {
        let apart = sections::fit_each(&filed, flights, settings, (by, calibrate), diagnosed)?;
        let told = &apart.diagnosed.verdict;
        let steady = sections::by_formula(&filed, flights, settings, (by, calibrate), told)?;
        return Ok(steady.unwrap_or(apart));
    }
    let mut why = Vec::new();
    let proposed = diagnosed.proposed.clone();
    let formulas = !proposed.is_empty();
    let work = Work { filed: &filed, flights, settings, by, calibrate, judge: Judge::new(flights), formulas };
    let plain = completed(&work, &filed, diagnosed, &[])?;
    let mut found: Option<Fitted> = None;
    let explained = |f: &Fitted| !f.diagnosed.verdict.remainder.unexplained;
    // One formula, unless it leaves something unexplained: a second is easily the error of the first.
    let tries = proposed.iter().flat_map(|p| (1..=p.formulas.len()).map(move |n| p.first(n)));
    for some in tries {
        if found.as_ref().is_some_and(explained) {
            break;
        }
        match with_formulas(&work, &some, &plain, found.as_ref().unwrap_or(&plain)) {
            Ok(Ok(fitted)) => found = Some(fitted),
            Ok(Err(reasons)) => why.extend(reasons),
            Err(Error::Gap(GapError::Cancelled)) => return Err(GapError::Cancelled.into()),
            // A verdict that was reached is given, whatever becomes of a formula.
            Err(error) => why.extend(some.formulas.iter().map(|f| not_named(f, &error.to_string()))),
        }
    }
    let mut fitted = found.unwrap_or(plain);
    if settings.network {
        network::add(&filed, flights, &work.judge, (settings, by), &mut fitted)?;
    }
    let named = |w: &Why| fitted.diagnosed.verdict.formulas.iter().any(|f| f.id == w.id);
    why.retain(|w| !named(w));
    why.dedup();
    fitted.diagnosed.verdict.why.extend(why);
    Ok(fitted)
}

/// What a fit is asked for, and where vehicles are judged.
struct Work<'a> {
    filed: &'a Filed<'a>,
    flights: &'a Flights,
    settings: &'a Settings<'a>,
    by: &'a str,
    calibrate: Calibrate,
    judge: Judge,
    /// Whether vehicles with formulas are compared with those without.
    formulas: bool,
}

/// Why a formula is not named.
fn not_named(f: &Formula, reason: &str) -> Why {
    Why::new(&f.id, Rule::Formula, format!("{}: {reason}", f.words))
}

/// The diagnosis with formulas as candidates: what was found, or why not all of them are named. A formula must make the vehicle
/// better than what is written without the last of them, `before`, does.
fn with_formulas(
    work: &Work,
    tried: &Proposed,
    plain: &Fitted,
    before: &Fitted,
) -> Result<std::result::Result<Fitted, Vec<Why>>> {
    let Work { filed, flights, settings, judge, .. } = work;
    let proposed = &tried.formulas[..];
    let text = formula::with_formulas(&filed.text, proposed);
    let vehicle = formula::vehicle_with(filed.vehicle, &text)?;
    let ids = proposed.iter().map(|f| f.id.clone());
    let again = Settings {
        given: None,
        only: settings.only.clone().map(|only| only.into_iter().chain(ids).collect()),
        no_formulas: true,
        moments: Moments::No,
        ..settings.copied()
    };
    let without = Some((&plain.diagnosed, tried));
    let diagnosed = diagnose_from(&flights.fit, &vehicle, &again, without)?;
    let named = |f: &&Formula| diagnosed.verdict.findings.iter().any(|x| x.id == f.id);
    let missed: Vec<&Formula> = proposed.iter().filter(|f| !named(f)).collect();
    if !missed.is_empty() {
        return Ok(Err(missed.into_iter().map(|f| not_named(f, "the search did not choose it")).collect()));
    }
    // What one estimator denies and leaves something unexplained only stands in for it: of a load on a cable that was not tracked a part of
    // the thrust that goes with the tilt, with nine tenths of the mass.
    let denied = |f: &&Formula| {
        let second = |x: &Finding| x.id == f.id && x.second.said == Said::Differs;
        diagnosed.verdict.remainder.plainly_unexplained() && diagnosed.verdict.findings.iter().any(second)
    };
    let denied: Vec<&Formula> = proposed.iter().filter(denied).collect();
    if !denied.is_empty() {
        let reason = "the second estimator differs, and something is still unexplained";
        return Ok(Err(denied.into_iter().map(|f| not_named(f, reason)).collect()));
    }
    let own = Filed { label: filed.label, vehicle: &vehicle, text };
    let mut fitted = completed(work, &own, diagnosed, proposed)?;
    let findings = &fitted.diagnosed.verdict.findings;
    let reason = |f: &Formula| {
        let of_file = fitted.unwritable.iter().find(|(id, _)| *id == f.id);
        let of_flight = findings.iter().find(|x| x.id == f.id).and_then(|x| x.unwritten());
        match (of_file, of_flight) {
            (Some((_, error)), _) => Some(format!("it cannot be written: {error}")),
            (None, Some(doubt)) => Some(format!("it does not lower the errors on unseen flight: {doubt}")),
            (None, None) => fitted.after.is_none().then(|| "nothing can be written".to_string()),
        }
    };
    let idle: Vec<Why> = proposed.iter().filter_map(|f| Some(not_named(f, &reason(f)?))).collect();
    if !idle.is_empty() {
        return Ok(Err(idle));
    }
    // Each with the calibration that helps it: what leans on a missing effect is often written with partners, the effect itself
    // without. What is written without a formula may diverge, and then any formula is better.
    let written = |f: &Fitted| judge.look(f.at_best.as_ref().unwrap_or(filed.vehicle));
    if let (Ok(with), Ok(without)) = (written(&fitted), written(before))
        && with.hardly_better(&without)
    {
        let own = with.clearest(&without);
        let channel = format!("{} {}", own.channel, pair(own.without, own.with, &own.unit));
        let times = significant(with.over(&without), 3);
        let words = format!(
            "on {} its vehicle has {times} times the errors of the one without it ({channel})",
            judge.title()
        );
        return Ok(Err(proposed.iter().map(|f| not_named(f, &words)).collect()));
    }
    let verdict = &mut fitted.diagnosed.verdict;
    verdict.vehicle_sha256 = filed.vehicle.sha256();
    for f in proposed {
        for finding in verdict.findings.iter_mut().filter(|x| x.id == f.id) {
            finding.title = f.said(finding);
            verdict.verdict = verdict.verdict.replacen(&f.id, &format!("{} ({})", f.id, finding.title), 1);
            // The name of a formula says nothing; what it is does, where there is room.
            let short = finding.title.split(';').next().unwrap_or_default();
            let law = match (short.split_once(" = "), short.split_once(" · ")) {
                (Some((on, _)), Some((_, law))) => format!("{on} ∝ {law}"),
                _ => short.to_string(),
            };
            for words in [short, law.as_str()] {
                let line = verdict.headline.replacen(&f.id, words, 1);
                if line.chars().count() <= HEADLINE_CHARS {
                    verdict.headline = line;
                    break;
                }
            }
        }
    }
    verdict.formulas = proposed.to_vec();
    Ok(Ok(fitted))
}

/// The vehicle completed by what a diagnosis found, with the formulas that were proposed to it.
fn completed(work: &Work, filed: &Filed, mut diagnosed: Diagnosed, proposed: &[Formula]) -> Result<Fitted> {
    let Work { flights, settings, by, calibrate, judge, .. } = work;
    let verdict = &mut diagnosed.verdict;
    // Simulate with the noise estimated by the fit.
    let noise: Vec<Noise> = verdict.logs.iter().map(|l| l.noise).collect();
    verdict.logs = flights.summaries();
    for (log, noise) in verdict.logs.iter_mut().filter(|l| !l.held_out).zip(noise) {
        log.noise = noise;
    }
    verdict.warnings.extend(flights.warnings.iter().cloned());
    let (source, dynamics) = (source(flights, by), verdict.dynamics.clone());
    let given = settings.given.is_some();
    let formulas = proposed.iter().map(|f| f.id.clone()).collect();
    let writer = Writer { source, dynamics, filed, partners: Vec::new(), given, formulas };
    warn_of_judge(judge, filed.vehicle, verdict);
    let (writable, unwritable) = writer.writable(&verdict.findings)?;
    for (id, error) in &unwritable {
        verdict.warnings.push(format!("the ladder is without {id}: {error}"));
    }
    let own = if given { Own::default() } else { Own::of(verdict, flights) };
    let one_log = !given && flights.whole.len() == 1 && flights.held_out.is_empty();
    let clock = |i: &usize| one_log && findings::is_clock_in_doubt(&verdict.findings[*i]);
    let writable = writable.into_iter().filter(|i| !own.indices.contains(i));
    let (clocks, writable): (Vec<usize>, Vec<usize>) = writable.partition(clock);
    let mut kept = partners::judged(&writer, judge, &mut verdict.findings, writable, &mut verdict.adjusted)?;
    if verdict.remainder.plainly_unexplained() {
        kept = parts::judged(&writer, judge, &mut verdict.findings, kept, &mut verdict.adjusted)?;
    }

    findings::leave_clocks(&writer, judge, &mut verdict.findings, &kept, &clocks)?;

    let mut rungs = vec![("as filed".to_string(), filed.vehicle.clone())];
    let mut completion = writer.begin();
    for index in kept {
        let finding = &verdict.findings[index];
        completion.add(&Entry::of(finding))?;
        rungs.push((format!("+ {}", finding.id), completion.vehicle(filed.vehicle)?));
    }
    let partners = completion.partners(&verdict.adjusted)?;
    if let (Some(words), Some((label, last))) = (&partners, rungs.last_mut()) {
        // What was fitted together is one step of the ladder.
        *label = format!("{label} with {words}");
        *last = completion.vehicle(filed.vehicle)?;
    }
    own.judged((judge, filed.vehicle), &completion, verdict, flights)?;
    say_doubts(verdict);
    let found = rungs.len();
    let mut after = (rungs.len() > 1).then(|| rungs[rungs.len() - 1].1.clone());
    let mut calibrated = 0;
    let (mut at_best, mut helped) = (None, None);
    if *calibrate != Calibrate::No || work.formulas || settings.network {
        let mut adjusted = verdict.adjusted.clone();
        let shown = calibration::judged(&writer, judge, &completion, &mut adjusted)?;
        let last = shown.iter().rev().find(|s| s.helps).map(|s| s.vehicle.clone());
        at_best = last.or_else(|| after.clone());
        if settings.network {
            helped = with_help(&completion, filed.vehicle, adjusted.clone())?;
        }
        if *calibrate != Calibrate::No {
            verdict.adjusted = adjusted;
        }
        let helping: Vec<Calibration> = verdict.adjusted.iter().filter(|c| c.helps).cloned().collect();
        match calibrate {
            Calibrate::Write => {
                calibrated = completion.calibrate(&helping)?;
                if calibrated > 0 {
                    after = Some(completion.vehicle(filed.vehicle)?);
                }
                rungs.extend(shown.into_iter().filter(|s| s.helps).map(|s| (s.label, s.vehicle)));
            }
            Calibrate::Show => rungs.extend(shown.into_iter().map(|s| (s.label, s.vehicle))),
            Calibrate::No => {}
        }
    }
    // Ladder steps whose roll-outs diverge are skipped.
    if !settings.no_ladder {
        match flights.ladder(&rungs) {
            Ok(ladder) => verdict.ladder = unparted(ladder, found),
            Err(error) => verdict.warnings.push(format!("no error ladder: {error}")),
        }
        match own.rung((&completion, filed.vehicle), verdict, flights) {
            Ok(rung) => verdict.ladder.extend(rung),
            Err(error) => {
                verdict.warnings.push(format!("the ladder is without each log's own values: {error}"))
            }
        }
    }
    completion.remarks.dedup();
    verdict.warnings.append(&mut completion.remarks);
    Ok(Fitted { diagnosed, after, text: completion.text, calibrated, unwritable, at_best, now: None, helped })
}

/// A completed vehicle with the calibration that helps; none where nothing does.
fn with_help(completion: &Completion, like: &Vehicle, adjusted: Vec<Calibration>) -> Result<Option<Helped>> {
    let mut whole = completion.clone();
    let helping: Vec<Calibration> = adjusted.iter().filter(|c| c.helps).cloned().collect();
    let calibrated = whole.calibrate(&helping)?;
    if calibrated == 0 {
        return Ok(None);
    }
    Ok(Some(Helped { vehicle: whole.vehicle(like)?, text: whole.text, calibrated, adjusted }))
}

/// Warns where findings cannot be judged, or only on flight used in the fit.
fn warn_of_judge(judge: &Judge, vehicle: &Vehicle, verdict: &mut Diagnosis) {
    if !verdict.findings.is_empty() && judge.blind(vehicle) {
        let words = "is too short to judge what was found: it is written as it was fitted";
        verdict.warnings.push(format!("{} {words}", judge.title()));
    } else if !judge.unseen && !verdict.findings.is_empty() {
        verdict.warnings.push(
            "no flight was kept from the fit: what is written was judged on flight used for the fit alone"
                .into(),
        );
    }
}

/// Says which findings are in doubt and not written, and why, also in the headline.
fn say_doubts(verdict: &mut Diagnosis) {
    let harmful = verdict.findings.iter().filter_map(|f| {
        let doubt = if f.doubt().is_some() { "in doubt, not written: " } else { "" };
        Some(Why::new(&f.id, Rule::NeverWorse, format!("{doubt}{}", f.unwritten()?)))
    });
    verdict.why.extend(harmful);
    let short = headline(&verdict.verdict, &verdict.findings, verdict.remainder.unexplained);
    verdict.headline = verdict.beside_moments(&short);
    let doubtful: Vec<&str> =
        verdict.findings.iter().filter(|f| f.doubt().is_some()).map(|f| f.id.as_str()).collect();
    if !doubtful.is_empty() {
        verdict.verdict = format!("{}; in doubt and not written: {}", verdict.verdict, doubtful.join(", "));
    }
}

/// Merges ladder steps of effects that only help together with the next one: what was fitted together is not split. The
/// first `found` steps are those of the nominal vehicle and of the findings.
fn unparted(ladder: Vec<Rung>, found: usize) -> Vec<Rung> {
    let mut out: Vec<Rung> = Vec::new();
    let mut held: Option<String> = None;
    for (i, mut rung) in ladder.into_iter().enumerate() {
        if let Some(before) = held.take() {
            rung.label = format!("{before} {}", rung.label);
        }
        let worse = out.last().is_some_and(|below| rung_over(&rung, below) > WORSE);
        if worse && i + 1 < found {
            held = Some(rung.label);
        } else {
            out.push(rung);
        }
    }
    out
}

/// Provenance of the values in a file.
pub(crate) fn source(flights: &Flights, by: &str) -> Source {
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
    Source {
        log_sha256,
        date: today_utc(),
        text: format!(
            "{by} on {}, driven by {}",
            held.join(", "),
            flights.whole.first().map_or("nothing", |t| t.drive.title())
        ),
    }
}

/// Findings that cannot be written into a vehicle file, by id, with the reason.
type Unwritable = Vec<(String, AcceptError)>;

/// Writes findings into the text of the nominal vehicle.
#[derive(Clone)]
struct Writer<'a> {
    source: Source,
    dynamics: String,
    filed: &'a Filed<'a>,
    /// Parameters within tolerance written together with the findings.
    partners: Vec<Calibration>,
    /// The user requested these effects; nothing was searched.
    given: bool,
    /// Ids of formulas, whose gain is judged beside calibration, once everything is written: without it the tolerances of a vehicle can be
    /// many times what is missing.
    formulas: Vec<String>,
}

impl Writer<'_> {
    fn begin(&self) -> Completion {
        let Filed { label, vehicle, text } = self.filed;
        Completion::new(vehicle, text.clone(), label, &self.dynamics, self.source.clone())
    }

    /// Indices of findings that can be written, and the others with the reason.
    fn writable(&self, findings: &[Finding]) -> Result<(Vec<usize>, Unwritable)> {
        let mut completion = self.begin();
        let (mut can, mut cannot) = (Vec::new(), Vec::new());
        for (index, f) in findings.iter().enumerate() {
            match completion.add(&Entry::of(f)) {
                Ok(()) => can.push(index),
                Err(error @ (AcceptError::OutOfRange { .. } | AcceptError::Effect { .. })) => {
                    cannot.push((f.id.clone(), error));
                }
                Err(other) => return Err(other.into()),
            }
        }
        Ok((can, cannot))
    }

    /// The file with some of the findings.
    fn completed(&self, findings: &[Finding], chosen: &[usize]) -> Result<Completion> {
        let mut completion = self.begin();
        for index in chosen {
            completion.add(&Entry::of(&findings[*index]))?;
        }
        completion.calibrate(&self.partners)?;
        Ok(completion)
    }

    /// The vehicle with some of the findings.
    fn with(&self, findings: &[Finding], chosen: &[usize]) -> Result<Vehicle> {
        Ok(self.completed(findings, chosen)?.vehicle(self.filed.vehicle)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::verdict::{HorizonError, Lack};

    fn rung(label: &str, error: f64) -> Rung {
        let at = |horizon_s| HorizonError {
            horizon_s,
            position_m: error,
            velocity_m_s: error,
            attitude_rad: error,
            rate_rad_s: error,
            n: 9,
        };
        let lack = Lack {
            force_n: error,
            force_times_noise: error,
            torque_n_m: Some(error),
            torque_times_noise: Some(error),
            n: 99,
        };
        let horizons = vec![at(0.5), at(1.0)];
        Rung {
            label: label.into(),
            training: horizons.clone(),
            held_out: horizons,
            training_lack: Some(lack),
            held_out_lack: Some(lack),
        }
    }

    #[test]
    fn what_only_helps_with_the_next_effect_shares_its_rung() {
        let ladder = |errors: [f64; 4]| {
            let labels = ["as filed", "+ wrong_mass", "+ thrust_scale", "+ air"];
            labels.iter().zip(errors).map(|(label, e)| rung(label, e)).collect::<Vec<_>>()
        };
        let labels = |list: Vec<Rung>| list.into_iter().map(|r| r.label).collect::<Vec<_>>().join(", ");
        let shown = labels(unparted(ladder([1.0, 8.0, 0.5, 0.4]), 3));
        assert_eq!(shown, "as filed, + wrong_mass + thrust_scale, + air");
        let shown = labels(unparted(ladder([1.0, 0.8, 0.5, 0.4]), 3));
        assert_eq!(shown, "as filed, + wrong_mass, + thrust_scale, + air");
        // A rise by the last effect or by the calibration is not hidden.
        let shown = labels(unparted(ladder([1.0, 0.8, 0.9, 1.4]), 3));
        assert_eq!(shown, "as filed, + wrong_mass, + thrust_scale, + air");
    }
}
