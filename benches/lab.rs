//! A session of the lab on a flight of 50 s: how long its answers take, beside what they may.
//!
//! `cargo xtask bench lab --help`. Prints a Markdown table of medians.

mod common;
#[path = "../tests/common/planted/mod.rs"]
mod planted;

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Mutex;
use std::time::Instant;

use clap::Parser;
use common::report::{Report, figures, numbers, shown, word, words};
use common::{Fallible, ended, median};
use planted::Plan;
use propwash::flight::FlightLog;
use propwash::gap::diagnose::Settings;
use propwash::gap::fitted::{Calibrate, Filed, fit};
use propwash::gap::ladder::Flights;
use propwash::gap::session::{Flight, Session, Use};
use propwash::gap::watch::{Ranked, Watch};
use propwash::gap::{Options, Track, compare};
use propwash::vehicle::Vehicle;

const VEHICLE: &str = include_str!("../tests/data/planted_quad.toml");
/// The flight of `hidden_flight --effect rotor_drag --seed 3`.
const HIDDEN: &str = "rotor_drag";
const SEED: u64 = 3;
/// Parameter of it that the slider moves.
const PARAMETER: &str = "drag_n_s2_per_rad_m";

/// Times what a person waits for: opening a log, sliders, switches, fits, the search.
#[derive(Parser)]
struct Args {
    /// How often each is timed.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..))]
    rounds: u32,
    /// Length of the flight, s.
    #[arg(long, default_value_t = 50.0)]
    seconds: f64,
    /// Also writes the figures as lines of JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Ignored; `cargo bench` passes it.
    #[arg(long, hide = true)]
    bench: bool,
}

fn main() -> ExitCode {
    ended(run(&Args::parse()))
}

/// What is timed, and how long it may take, s.
const STEPS: [(&str, f64); 8] = [
    ("open: read, check, residuals and paths of the first page", 1.0),
    ("find what is missing: the first ranked list", 1.5),
    ("find what is missing: settled", 3.0),
    ("switch: posterior, evidence and forecast", 0.020),
    ("slider: exact residuals", 0.100),
    ("fit the effects that are on", 0.7),
    ("`compare`, 60 s", 0.12),
    ("`add` of one given effect", 0.7),
];

fn run(args: &Args) -> Fallible<()> {
    let folder = tempfile::tempdir()?;
    let vehicle = Vehicle::from_toml("quad", VEHICLE)?;
    let flight = |name: &str, seconds: f64| -> Fallible<PathBuf> {
        let path = folder.path().join(name);
        planted::fly(&Plan::exciting(&vehicle, &[HIDDEN], seconds, SEED))?.write(&path)?;
        Ok(path)
    };
    let (log, longer) = (flight("flight.csv", args.seconds)?, flight("longer.csv", 60.0)?);
    let about =
        format!("{} rounds; {} s of flight, poses at 240 Hz, gyroscope at 500 Hz", args.rounds, args.seconds);
    let mut report = Report::begin("lab", args.json.as_deref(), &about)?;
    let mut times: Vec<Vec<f64>> = vec![Vec::new(); STEPS.len()];
    for round in 1..=args.rounds {
        for (list, time) in times.iter_mut().zip(once(&vehicle, &log, &longer)?) {
            list.push(time);
        }
        eprintln!("round {round} of {}", args.rounds);
    }
    let columns = [words("step", "step"), numbers("median_s", "median, s"), numbers("budget_s", "budget, s")];
    report.table("times", "What a session of `propwash lab` takes, wall time.", &columns)?;
    for ((step, budget), mut list) in STEPS.into_iter().zip(times) {
        let middle = median(&mut list);
        report.row(vec![word(step), shown(middle, figures(middle)), shown(budget, budget.to_string())])?;
    }
    report.end()
}

fn track(path: &Path, vehicle: &Vehicle) -> Fallible<Track> {
    let (log, _) = FlightLog::open(path, None)?;
    Ok(Track::new(log, vehicle, &Options::default())?)
}

/// Times of all steps, s.
fn once(vehicle: &Vehicle, log: &Path, longer: &Path) -> Fallible<[f64; 8]> {
    let timed = |start: Instant| start.elapsed().as_secs_f64();
    let start = Instant::now();
    let flights = vec![Flight { track: track(log, vehicle)?, used: Use::Fit }];
    let mut session = Session::open("quad", vehicle, VEHICLE, flights)?;
    let opened = timed(start);

    let first = Mutex::new(None);
    let start = Instant::now();
    let early = |list: &[Ranked]| {
        if list.first().is_some_and(|r| r.evidence_nats > 0.0) {
            first.lock().map(|mut f| f.get_or_insert(start.elapsed().as_secs_f64()).to_owned()).ok();
        }
    };
    session.find(&Watch { early: Some(&early), ..Watch::default() })?;
    let settled = timed(start);
    let first = first.into_inner()?.ok_or("the search gave no early list")?;

    let start = Instant::now();
    session.toggle(HIDDEN, true)?;
    let state = session.state();
    let switched = timed(start);
    let found = state.effects.iter().find(|e| e.id == HIDDEN).ok_or("what is hidden was not found")?;
    let value = found.parameters[0].value;

    session.set(HIDDEN, PARAMETER, 0.5 * value)?;
    let start = Instant::now();
    session.exact(None)?;
    let exact = timed(start);

    let start = Instant::now();
    session.fit(&Watch::default())?;
    let fitted = timed(start);

    let long = [track(longer, vehicle)?];
    let start = Instant::now();
    compare(&long, vehicle)?;
    let compared = timed(start);

    let flights = Flights::new(vec![track(log, vehicle)?], Vec::new(), 0.2);
    let settings = Settings { given: Some(vec![HIDDEN.into()]), no_advice: true, ..Settings::default() };
    let filed = Filed { label: "quad", vehicle, text: VEHICLE.into() };
    let start = Instant::now();
    fit(filed, &flights, &settings, "bench", Calibrate::No)?;
    let added = timed(start);
    Ok([opened, first, settled, switched, exact, fitted, compared, added])
}
