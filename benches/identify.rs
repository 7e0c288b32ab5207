//! Identification of the attitude model, ours against Crazyflow's on one log of Crazyflow's simulation, alternately.
//!
//! `cargo xtask bench identify --help`. Prints a Markdown table of errors, and median times.

mod common;

use std::path::PathBuf;
use std::process::{Command, ExitCode};
use std::time::Instant;

use clap::Parser;
use common::peer::python;
use common::report::{Report, code, nothing, numbers, shown, words};
use common::{Fallible, ended};
use propwash::flight::{Channel, FlightLog};
use propwash::gap::attitude_model::{Identification, Options, identify};
use propwash::vehicle::Vehicle;
use serde_json::Value;

/// Version of Crazyflow that is compared with.
const CRAZYFLOW: &str = "0.4.0";
const SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/peers/identify.py");
const AXES: [&str; 3] = ["roll", "pitch", "yaw"];

/// Identifies the attitude model from 60 s without noise, by Propwash and by Crazyflow in turn.
#[derive(Parser)]
struct Args {
    /// How often each of the two runs.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    rounds: u32,
    /// Time between steps of roll in the flight, s; those of pitch are 0.26 s longer.
    #[arg(long, default_value_t = 4.31)]
    hold_s: f64,
    /// Gives ours the logged velocities and body rates too. Without it ours reads what Crazyflow's reads: poses and commands.
    #[arg(long)]
    all_columns: bool,
    /// Lets Crazyflow's count in double precision, which is not its default.
    #[arg(long)]
    double: bool,
    /// Leaves out Crazyflow's identification; its simulation still makes the log.
    #[arg(long)]
    ours_alone: bool,
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

fn run(args: &Args) -> Fallible<()> {
    let python = peer()?;
    let dir = tempfile::tempdir()?;
    let csv = dir.path().join("flight.csv");
    let json = dir.path().join("truth.json");
    let script = |what: &str| {
        let mut command = Command::new(&python);
        // MuJoCo leaves its log in the current folder.
        command.arg(SCRIPT).arg(what).arg(&csv).current_dir(dir.path());
        command
    };
    eprintln!("Crazyflow flies 60 s");
    output(script("make").arg(&json).arg(args.hold_s.to_string()))?;
    let truth: Value = serde_json::from_str(&std::fs::read_to_string(&json)?)?;
    let mass_kg = number(&truth["mass"])?;

    let mut log = FlightLog::load(&csv, None)?;
    if !args.all_columns {
        log.velocity_m_s = Channel::new(vec![], vec![]);
        log.angular_velocity_rad_s = Channel::new(vec![], vec![]);
    }
    let Rounds { ours, theirs, times_s } = rounds(args, &log, mass_kg, &script)?;
    let about = format!(
        "{} rounds; {} of {}, 60 s without noise, flown at up to {:.1} m/s; log: {} rows, {} for ours",
        args.rounds,
        ours.dynamics,
        ours.vehicle,
        number(&truth["fastest_m_s"])?,
        log.n_rows,
        if args.all_columns { "all columns" } else { "poses and commands" },
    );
    let mut report = Report::begin("identify", args.json.as_deref(), &about)?;
    let worst = table(&mut report, &truth, &ours, theirs.as_ref())?;
    times(&mut report, times_s, worst)?;
    if let Some(found) = &theirs {
        let versions = found["versions"].as_object().ok_or("Crazyflow's fit named no versions")?;
        let listed: Vec<String> =
            versions.iter().map(|(name, v)| format!("{name} {}", v.as_str().unwrap_or("?"))).collect();
        let precision = if args.double { "double" } else { "single" };
        report.text(&format!("Peer: {} (Crazyflow's in {precision} precision).", listed.join(", ")))?;
    }
    for warning in &ours.warnings {
        report.text(&format!("Propwash warns: {warning}"))?;
    }
    report.end()
}

/// What the last round found, and how long each took.
struct Rounds {
    ours: Identification,
    theirs: Option<Value>,
    /// Ours and Crazyflow's, s.
    times_s: [Vec<f64>; 2],
}

/// Identifies in turn; `script` makes the command of Crazyflow's part that is named.
fn rounds(args: &Args, log: &FlightLog, mass_kg: f64, script: &dyn Fn(&str) -> Command) -> Fallible<Rounds> {
    let vehicle = unknown(mass_kg)?;
    let (mut ours, mut theirs): (Option<Identification>, Option<Value>) = (None, None);
    let (mut our_s, mut their_s) = (Vec::new(), Vec::new());
    for round in 1..=args.rounds {
        let start = Instant::now();
        let found = identify(log, &vehicle, &Options::default())?;
        our_s.push(start.elapsed().as_secs_f64());
        eprintln!("round {round}: Propwash {:.2} s", our_s[our_s.len() - 1]);
        ours = Some(found);
        if args.ours_alone {
            continue;
        }
        let mut fit = script("fit");
        fit.arg(mass_kg.to_string()).env("JAX_ENABLE_X64", if args.double { "1" } else { "0" });
        let found = fitted(&mut fit)?;
        their_s.push(number(&found["seconds"])?);
        eprintln!("round {round}: Crazyflow {}", parts(&found));
        theirs = Some(found);
    }
    Ok(Rounds { ours: ours.ok_or("no round was run")?, theirs, times_s: [our_s, their_s] })
}

/// The table of times; `worst` is the largest error of each, %.
fn times(report: &mut Report, mut times_s: [Vec<f64>; 2], worst: [f64; 2]) -> Fallible<()> {
    let columns = [
        words("who", "who"),
        numbers("seconds", "median time, s"),
        numbers("worst_percent", "largest error, %"),
    ];
    let [our_median, their_median] = times_s.each_mut().map(|times| median(times));
    let caption = if their_median.is_finite() {
        format!(
            "Time of an identification; Crazyflow's takes {:.0} times as long.",
            their_median / our_median
        )
    } else {
        "Time of an identification.".to_string()
    };
    report.table("times", &caption, &columns)?;
    for (who, seconds, worst) in [("Propwash", our_median, worst[0]), ("Crazyflow", their_median, worst[1])] {
        if seconds.is_finite() {
            report.row(vec![
                common::report::word(who),
                shown(seconds, common::report::figures(seconds)),
                shown(worst, common::report::figures(worst)),
            ])?;
        }
    }
    Ok(())
}

/// What Crazyflow's identification printed.
fn fitted(fit: &mut Command) -> Fallible<Value> {
    let text = output(fit)?;
    let line = text.lines().rev().find(|l| l.starts_with('{'));
    Ok(serde_json::from_str(line.ok_or("Crazyflow's identification printed no line of JSON")?)?)
}

/// Its time, whole and by part.
fn parts(found: &Value) -> String {
    let [all, filter, translation, rotation] = ["seconds", "filter_s", "translation_s", "rotation_s"]
        .map(|name| found[name].as_f64().unwrap_or(f64::NAN));
    format!("{all:.1} s (filters {filter:.1} s, translation {translation:.1} s, rotation {rotation:.1} s)")
}

/// The vehicle of the flight as far as a user knows it: its mass is weighed, its response and drag are not in the file.
fn unknown(mass_kg: f64) -> Fallible<Vehicle> {
    let mut file = Vehicle::builtin("cf2x_L250")?.file().clone();
    file.attitude_response = Default::default();
    file.effect.clear();
    file.body.mass_kg = mass_kg;
    Ok(Vehicle::from_file("cf2x_L250", file)?)
}

/// One row per parameter: truth, ours, Crazyflow's. Errors are in per cent of the truth, and for the thrust offset, which is
/// zero in truth, of the weight. Returns the largest error of each, %.
fn table(
    report: &mut Report,
    truth: &Value,
    ours: &Identification,
    theirs: Option<&Value>,
) -> Fallible<[f64; 2]> {
    let mut rows: Vec<(String, f64, Option<f64>)> = Vec::new();
    let gains = [
        ("angle_gain_per_s2", "rpy_coef"),
        ("rate_gain_per_s", "rpy_rates_coef"),
        ("command_gain_per_s2", "cmd_rpy_coef"),
    ];
    for (name, key) in gains {
        for (k, axis) in AXES.iter().enumerate() {
            let other = theirs.map(|t| number(&t[key][k])).transpose()?;
            rows.push((format!("{name}.{axis}"), number(&truth[key][k])?, other));
        }
    }
    for (name, key) in [("thrust_scale", "cmd_f_coef"), ("thrust_rate_per_s", "thrust_dyn_coef")] {
        rows.push((name.into(), number(&truth[key])?, theirs.map(|t| number(&t[key])).transpose()?));
    }
    for (k, (axis, key)) in
        [("x", "drag_xy_coef"), ("y", "drag_xy_coef"), ("z", "drag_z_coef")].iter().enumerate()
    {
        // Crazyflow's matrix multiplies the velocity; ours brakes where it is positive.
        let other = theirs.map(|t| number(&t[*key])).transpose()?.map(|d| -d);
        rows.push((format!("drag_n_s_per_m.{axis}"), -number(&truth["drag_matrix"][k][k])?, other));
    }
    let columns = [
        words("parameter", "parameter"),
        numbers("truth", "truth"),
        numbers("propwash", "Propwash"),
        numbers("propwash_error", "error"),
        numbers("crazyflow", "Crazyflow"),
        numbers("crazyflow_error", "error"),
    ];
    report.table("identify", "The attitude model from one log of Crazyflow's simulation.", &columns)?;
    let (mut our_worst, mut their_worst): (f64, f64) = (0.0, 0.0);
    for (name, value, other) in &rows {
        let found = ours.get(name).ok_or_else(|| format!("ours did not identify {name}"))?.value;
        let percent = |v: f64| 100.0 * (v / value - 1.0).abs();
        our_worst = our_worst.max(percent(found));
        their_worst = their_worst.max(other.map_or(0.0, percent));
        let other = other.unwrap_or(f64::NAN);
        report.row(vec![
            code(name),
            shown(*value, figure(*value)),
            shown(found, figure(found)),
            shown(percent(found), format!("{:.4} %", percent(found))),
            shown(other, figure(other)),
            shown(percent(other), format!("{:.2} %", percent(other))),
        ])?;
    }
    let weight_n = ours.mass_kg * 9.81;
    for name in ["thrust_offset_n", "attitude_delay_s", "thrust_delay_s"] {
        let found = ours.get(name).ok_or_else(|| format!("ours did not identify {name}"))?.value;
        let (value, error) = if name == "thrust_offset_n" {
            (number(&truth["acc_coef"])?, format!("{:.4} % of weight", 100.0 * found.abs() / weight_n))
        } else {
            (0.0, format!("{:.4} ms", 1e3 * found.abs()))
        };
        report.row(vec![
            code(name),
            shown(value, value.to_string()),
            shown(found, format!("{found:.1e}")),
            shown(found.abs(), error),
            nothing(),
            nothing(),
        ])?;
    }
    Ok([our_worst, their_worst])
}

/// The Python with the peer: `PROPWASH_PYTHON`, or that of `.venv`.
fn peer() -> Fallible<PathBuf> {
    let python = python();
    let ask = ["-c", "from importlib import metadata; print(metadata.version('crazyflow'))"];
    let told = Command::new(&python).args(ask).output();
    let version = told.map(|o| String::from_utf8_lossy(&o.stdout).trim().to_string()).unwrap_or_default();
    if version != CRAZYFLOW {
        let found = if version.is_empty() { "none".into() } else { version };
        return Err(format!(
            "expected Crazyflow {CRAZYFLOW} for {}, found {found}: `cargo xtask bench identify` makes .venv with it (once, about \
             1 GB), or name a Python that has it in PROPWASH_PYTHON",
            python.display()
        )
        .into());
    }
    Ok(python)
}

/// Standard output of a run of the script; what it says on standard error, where it fails.
fn output(command: &mut Command) -> Fallible<String> {
    let out =
        command.output().map_err(|e| format!("{:?} could not be started: {e}", command.get_program()))?;
    if !out.status.success() {
        return Err(
            format!("{SCRIPT} failed ({}): {}", out.status, String::from_utf8_lossy(&out.stderr)).into()
        );
    }
    Ok(String::from_utf8(out.stdout)?)
}

/// A number, or the only one of a list.
fn number(v: &Value) -> Fallible<f64> {
    let one = v.as_array().filter(|items| items.len() == 1).map_or(v, |items| &items[0]);
    Ok(one.as_f64().ok_or_else(|| format!("expected a number from Crazyflow, found {v}"))?)
}

/// Six significant figures.
fn figure(v: f64) -> String {
    let size = v.abs().max(1e-300).log10().floor() as i32;
    format!("{v:.*}", (5 - size).clamp(0, 12) as usize)
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    if n == 0 { f64::NAN } else { 0.5 * (values[(n - 1) / 2] + values[n / 2]) }
}
