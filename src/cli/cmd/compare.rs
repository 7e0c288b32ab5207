//! `propwash compare`: a vehicle's model against flights.

use super::diagnose::refuse_log;
use super::{print, print_json};
use crate::cli::exit::Outcome;
use crate::cli::gap_args::CompareArgs;
use crate::cli::output;
use crate::cli::progress::waiting;
use crate::gap::compare::{Axes, Comparison, Horizon, LogComparison, Pooled};
use crate::gap::report::Report;
use crate::gap::{GapError, compare};
use crate::{Error, Result};

/// Runs the command.
pub fn run(args: &CompareArgs) -> Result<Outcome> {
    refuse_log("--report", args.report.as_deref(), &args.logs.logs, &[])?;
    output::check(&[("--report", args.report.as_deref())], args.force)?;
    let (vehicle, tracks) = waiting("reading", || args.logs.open())?;
    let comparison = waiting("comparing", || compare(&tracks, &vehicle))?;
    if let Some(path) = &args.report {
        let page = Report::with_flights(&comparison, &tracks, &vehicle)?;
        output::report("--report", path, page.html().as_bytes(), args.force)?;
    }
    if args.json {
        print_json(
            &serde_json::to_value(&comparison)
                .map_err(|e| Error::Gap(GapError::Numbers { what: "JSON", reason: e.to_string() }))?,
        )?;
    } else {
        show(&comparison)?;
    }
    Ok(if comparison.nothing_missing() { Outcome::Fine } else { Outcome::Found })
}

fn show(c: &Comparison) -> Result<()> {
    for log in &c.logs {
        show_log(log)?;
        print("")?;
    }
    if let Some(pooled) = &c.pooled {
        show_pooled(pooled, c.logs.len())?;
        print("")?;
    }
    print(format_args!("{}: {}", c.vehicle, c.verdict))?;
    match (c.agrees, c.within_tolerance) {
        (true, _) => Ok(()),
        (_, Some(true)) => print(
            "next: propwash diagnose names the numbers that are off, add --calibrate writes those that help",
        ),
        (_, Some(false)) => print("next: propwash diagnose names what is missing"),
        (_, None) if c.logs.iter().any(|l| l.other_rotors.is_some()) => {
            print("next: put the file's rotors right; nothing else can be told before")
        }
        (_, None) => print(
            "next: propwash diagnose tells whether an effect is missing or numbers within their tolerance are off",
        ),
    }
}

fn show_log(c: &LogComparison) -> Result<()> {
    print(format_args!(
        "{}  {:.1} s, driven by {}, sha256 {}",
        c.log.name,
        c.log.duration_s,
        c.log.drive,
        &c.log.sha256.get(..16).unwrap_or(&c.log.sha256)
    ))?;
    for warning in &c.warnings {
        print(format_args!("  warning: {warning}"))?;
    }
    print("\n  roll-outs from measured states, error at the end (times what the sensors' noise makes)")?;
    header()?;
    for h in &c.horizons {
        row(h)?;
    }
    print(format_args!("\n  force and torque that the model lacks: {}", c.one_step.certainty))?;
    show_axes("force", "N", &c.one_step.force)?;
    if let Some(torque) = &c.one_step.torque {
        show_axes("torque", "N·m", torque)?;
    }
    if let Some(flown) = &c.closed_loop {
        print(format_args!(
            "\n  whole flight with our controller, {:.1} s: {:.3} m from the measured flight; from the references: measured \
             {:.3} m, model {:.3} m",
            flown.duration_s, flown.position_m, flown.tracking_measured_m, flown.tracking_model_m
        ))?;
        for note in &flown.notes {
            print(format_args!("    {note}"))?;
        }
    } else if let Some(why) = &c.closed_loop_missing {
        print(format_args!("\n  no whole flight with our controller: {why}"))?;
    }
    if !c.worst.is_empty() {
        print("\n  worst segments")?;
        let (force, torque) = c.worst.iter().fold((0.0f64, 0.0f64), |(f, t), s| {
            (f.max(s.force_rms_n), t.max(s.torque_rms_n_m.unwrap_or(0.0)))
        });
        let ((by_force, f), (by_torque, t)) = (small([force; 3]), small([torque; 3]));
        let head = [format!("force {f}N"), format!("torque {t}N·m")];
        print(format_args!("    {:>15}  {:>9}  {:>11}  going on", "time s", head[0], head[1]))?;
        for s in &c.worst {
            let torque = s.torque_rms_n_m.map_or("–".into(), |t| format!("{:.3}", by_torque * t));
            let span = format!("{:.1}–{:.1}", s.from_s, s.to_s);
            print(format_args!(
                "    {span:>15}  {:>9.3}  {torque:>11}  {}",
                by_force * s.force_rms_n,
                s.text
            ))?;
        }
    }
    show_findings(&c.findings)
}

fn show_findings(findings: &[String]) -> Result<()> {
    if findings.is_empty() {
        return print("\n  the residuals go with nothing that was looked at");
    }
    print("\n  what the residuals go with")?;
    for text in findings {
        print(format_args!("    {text}"))?;
    }
    Ok(())
}

fn header() -> Result<()> {
    print(format_args!(
        "    {:>6} {:>18} {:>18} {:>18} {:>18} {:>6}",
        "s", "position mm", "velocity mm/s", "attitude °", "rate °/s", "n"
    ))
}

fn row(h: &Horizon) -> Result<()> {
    let e = &h.error;
    let cell = |value: f64, times: Option<f64>| match times {
        Some(times) => format!("{value:.2} ({times:.1}×)"),
        None => "–".into(),
    };
    let [p, v, a, w] = h.times_expected;
    print(format_args!(
        "    {:>6} {:>18} {:>18} {:>18} {:>18} {:>6}",
        e.horizon_s,
        cell(1e3 * e.position_m, p),
        cell(1e3 * e.velocity_m_s, v),
        cell(e.attitude_rad.to_degrees(), a),
        cell(e.rate_rad_s.to_degrees(), w),
        e.n
    ))
}

/// Factor and prefix in which forces and torques are shown: milli where all of them are below one.
fn small(values: [f64; 3]) -> (f64, &'static str) {
    if values.iter().all(|v| v.abs() < 1.0) { (1e3, "m") } else { (1.0, "") }
}

/// A number in three digits, as many as a residual has at most.
fn three_digits(v: f64) -> String {
    let decimals = match v.abs() {
        a if a >= 99.95 => 0,
        a if a >= 9.995 => 1,
        a if a >= 0.9995 => 2,
        _ => 3,
    };
    format!("{v:.decimals$}")
}

fn show_axes(what: &str, unit: &str, a: &Axes) -> Result<()> {
    let (scale, prefix) = small(a.rms);
    for (k, axis) in ["x", "y", "z"].iter().enumerate() {
        // Without what stays the same (`mean`), which may be large beside 100 %.
        let explained = a.explained[k]
            .map_or("hardly varies".into(), |e| format!("model explains {:.0} % of what varies", 100.0 * e));
        print(format_args!(
            "    {what:<6} {axis}  rms {:>8} {prefix}{unit} ({:.1}× noise), mean {:>8} {prefix}{unit}, {explained}",
            three_digits(scale * a.rms[k]),
            a.in_sigmas[k],
            three_digits(scale * a.mean[k])
        ))?;
    }
    Ok(())
}

fn show_pooled(c: &Pooled, n: usize) -> Result<()> {
    print(format_args!("all {n} logs"))?;
    print(format_args!(
        "    {:>6} {:>13} {:>13} {:>13} {:>13} {:>6}",
        "s", "position mm", "velocity mm/s", "attitude °", "rate °/s", "n"
    ))?;
    let cell = |value: f64, known: bool| if known { format!("{value:.2}") } else { "–".into() };
    let turning = c.torque_rms_n_m.is_some();
    for e in &c.horizons {
        print(format_args!(
            "    {:>6} {:>13} {:>13} {:>13} {:>13} {:>6}",
            e.horizon_s,
            cell(1e3 * e.position_m, true),
            cell(1e3 * e.velocity_m_s, true),
            cell(e.attitude_rad.to_degrees(), turning),
            cell(e.rate_rad_s.to_degrees(), turning),
            e.n
        ))?;
    }
    let rms = |what: &str, unit: &str, values: [f64; 3]| {
        let (scale, prefix) = small(values);
        let [x, y, z] = values.map(|v| scale * v);
        print(format_args!("    residual {what} rms {x:.4}, {y:.4}, {z:.4} {prefix}{unit} (body x, y, z)"))
    };
    rms("force", "N", c.force_rms_n)?;
    if let Some(torque) = c.torque_rms_n_m {
        rms("torque", "N·m", torque)?;
    }
    show_findings(&c.findings)
}
