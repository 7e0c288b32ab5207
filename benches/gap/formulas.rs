//! Effects that are in no list: whether a formula is found for them, and what it takes off the error of another flight.

use super::Args;
use super::planted::{Build, STRANGE, UNLISTED, fly};
use super::score::{Case, Failure, added, source};
use propwash::gap::complete::{Completion, Entry};
use propwash::gap::decide::rules::Rule;
use propwash::gap::fitted::{Calibrate, Fitted};
use propwash::gap::formula::with_formulas;
use propwash::gap::ladder::Flights;
use propwash::vehicle::Vehicle;
use rayon::prelude::*;
use std::ops::Range;

/// Share of what the truth would take off the error that a formula must take off.
pub const ENOUGH: f64 = 0.8;
/// Roll-outs that are compared, s.
const HORIZON_S: f64 = 0.5;

/// One hidden effect, and what became of it.
pub struct Tried {
    /// What the formula says; `None` where none was found.
    pub formula: Option<String>,
    /// Whether an effect of the list was named, and certain.
    pub wrong: bool,
    /// What was said.
    pub headline: String,
    /// Why formulas that were tried are not named.
    pub why_not: Vec<String>,
    /// Names of the list that are certain.
    pub named: Vec<String>,
    /// What the model lacks on another flight, of the vehicle as filed with the effect, in times of noise: as filed, with what was found, and as filed on the
    /// same flight without the effect. Of force and torque the one that the effect raises more.
    pub lacks: [f64; 3],
    /// Force and torque that the model lacks on another flight of the vehicle itself, in times of noise, and the error of position, m: as
    /// filed, and with all that was written.
    pub errors: [[f64; 3]; 2],
}

impl Tried {
    /// Share of what the truth would take off that was taken off.
    pub fn gained(&self) -> f64 {
        let [filed, found, floor] = self.lacks;
        (filed - found) / (filed - floor).max(1e-9)
    }

    /// Whether what is missing or the error of position rose.
    pub fn raised(&self) -> bool {
        (0..3).any(|k| self.errors[1][k] > 1.01 * self.errors[0][k])
    }
}

/// All effects; an event is none for a formula.
pub fn kinds(args: &Args) -> Vec<&'static str> {
    let wanted = |id: &&str| args.kinds.is_empty() || args.kinds.iter().any(|k| k == id);
    UNLISTED.iter().chain(STRANGE).copied().filter(|id| *id != "sudden_push").filter(wanted).collect()
}

/// All effects with all seeds, otherwise as `base`.
pub fn run(
    seeds: Range<u64>,
    base: &Case,
    vehicle: &Vehicle,
    path: &str,
    args: &Args,
) -> Result<Vec<Tried>, Failure> {
    let text = std::fs::read_to_string(path)?;
    let each = kinds(args).into_iter().flat_map(|id| seeds.clone().map(move |seed| (id, seed)));
    let cases: Vec<Case> = each.map(|(id, seed)| Case { hidden: vec![id], seed, ..base.clone() }).collect();
    cases
        .par_iter()
        .map(|case| {
            let tried = tried(case, vehicle, &text)?;
            if args.verbose {
                let [filed, found, floor] = tried.lacks;
                println!(
                    "{:22} seed {:3}  {:6.2} → {:6.2} × noise, floor {:6.2}: {:4.0} %{}  {}",
                    case.hidden[0],
                    case.seed,
                    filed,
                    found,
                    floor,
                    100.0 * tried.gained(),
                    [
                        if tried.raised() { " RAISED".into() } else { String::new() },
                        if tried.wrong {
                            format!(" NAMED {}", tried.named.join(", "))
                        } else {
                            String::new()
                        },
                    ]
                    .concat(),
                    tried.formula.clone().unwrap_or_else(|| format!(
                        "none: {}; {}",
                        tried.headline,
                        tried.why_not.join("; ")
                    ))
                );
            }
            Ok(tried)
        })
        .collect()
}

fn tried(case: &Case, vehicle: &Vehicle, text: &str) -> Result<Tried, Failure> {
    let track = case.track(vehicle, &fly(&case.plan(vehicle, 0))?)?;
    let fitted = added(track, vehicle, text, Calibrate::No)?;
    let verdict = &fitted.diagnosed.verdict;
    let of_list = |id: &str| !verdict.formulas.iter().any(|f| f.id == id);
    let sure = verdict.findings.iter().filter(|f| f.certain && f.kind != "turbulence" && of_list(&f.id));
    let named: Vec<String> = sure.map(|f| f.id.clone()).collect();
    let formula = verdict.formulas.first().and_then(|f| verdict.findings.iter().find(|x| x.id == f.id));
    let other = |hidden: Vec<&'static str>, build: Build| -> Result<Flights, Failure> {
        let case = Case { hidden, build, ..case.clone() };
        let unseen = case.track(vehicle, &fly(&case.plan(vehicle, 1))?)?;
        Ok(Flights::new(Vec::new(), vec![unseen], 0.0))
    };
    // What formulas gain is measured on a vehicle exactly as filed but for the effect, so that tolerances do not hide it; whether
    // errors rise, on the vehicle itself with all that was written.
    let (with, without) =
        (other(case.hidden.clone(), Build::usual(0.0))?, other(Vec::new(), Build::usual(0.0))?);
    let own = other(case.hidden.clone(), case.build)?;
    let all = [
        left(&with, vehicle)?,
        left(&with, &formulas_alone(&fitted, vehicle, text)?)?,
        left(&without, vehicle)?,
    ];
    let errors = [left(&own, vehicle)?, left(&own, fitted.after().unwrap_or(vehicle))?];
    // The effect acts on the channel that it raises more.
    let raised = |k: usize| all[0][k] / all[2][k];
    let channel = if raised(0) > raised(1) { 0 } else { 1 };
    Ok(Tried {
        formula: formula.map(|f| f.title.clone()),
        headline: verdict.headline.clone(),
        why_not: verdict.why.iter().filter(|w| w.rule == Rule::Formula).map(|w| w.text.clone()).collect(),
        wrong: !named.is_empty(),
        named,
        lacks: all.map(|e| e[channel]),
        errors,
    })
}

/// The vehicle with the formulas of a verdict, and nothing else that it found.
fn formulas_alone(fitted: &Fitted, vehicle: &Vehicle, text: &str) -> Result<Vehicle, Failure> {
    let verdict = &fitted.diagnosed.verdict;
    let text = with_formulas(text, &verdict.formulas);
    let mut completion = Completion::new(vehicle, text, "vehicle", &verdict.dynamics, source());
    for finding in verdict.findings.iter().filter(|f| verdict.formulas.iter().any(|x| x.id == f.id)) {
        completion.add(&Entry::of(finding))?;
    }
    Ok(completion.vehicle(vehicle)?)
}

/// Force and torque that a vehicle lacks on a flight, times noise, and its error of position after [`HORIZON_S`], m.
fn left(flights: &Flights, vehicle: &Vehicle) -> Result<[f64; 3], Failure> {
    let ladder = flights.ladder(&[("it".to_string(), vehicle.clone())])?;
    let rung = ladder.first().ok_or("the unseen flight is too short")?;
    let lack = rung.held_out_lack.ok_or("the unseen flight has no instants")?;
    let at = rung.held_out.iter().find(|e| (e.horizon_s - HORIZON_S).abs() < 1e-9);
    let position = at.ok_or("the unseen flight is too short")?.position_m;
    Ok([lack.force_times_noise, lack.torque_times_noise.unwrap_or(f64::NAN), position])
}

/// Flights with nothing hidden: the formula that is found all the same.
pub fn nothing(
    seeds: Range<u64>,
    base: &Case,
    vehicle: &Vehicle,
    path: &str,
) -> Result<Vec<Option<String>>, Failure> {
    let text = std::fs::read_to_string(path)?;
    seeds
        .into_par_iter()
        .map(|seed| {
            let case = Case { hidden: vec![], seed, ..base.clone() };
            let track = case.track(vehicle, &fly(&case.plan(vehicle, 0))?)?;
            let fitted = added(track, vehicle, &text, Calibrate::No)?;
            Ok(fitted.diagnosed.verdict.formulas.first().map(|f| f.words.clone()))
        })
        .collect()
}
