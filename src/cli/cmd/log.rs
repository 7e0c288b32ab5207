//! `propwash log`: check flight logs, convert them to the contract.

use super::{print, print_json};
use crate::Result;
use crate::cli::args::{FromDatasetArgs, LogArgs, LogCheckArgs, LogCommand, LogConvertArgs};
use crate::cli::exit::{Outcome, warn};
use crate::cli::output;
use crate::cli::progress::waiting;
use crate::dataset::Dataset;
use crate::flight::{FlightLog, Severity, check};
use serde_json::json;
use std::path::Path;

/// Runs the command.
pub fn run(args: &LogArgs) -> Result<Outcome> {
    match &args.command {
        LogCommand::Check(a) => check_logs(a),
        LogCommand::Convert(a) => convert(a),
        LogCommand::FromDataset(a) => from_dataset(a),
    }
}

fn check_logs(args: &LogCheckArgs) -> Result<Outcome> {
    let mut worst = Severity::Info;
    let mut reports = Vec::new();
    for (i, file) in args.files.iter().enumerate() {
        let log = waiting("reading", || FlightLog::load(file, args.mapping.as_deref()))?;
        let report = check(&log);
        worst = worst.max(report.verdict);
        if args.json {
            reports.push(report);
        } else {
            if i > 0 {
                print("")?;
            }
            print(&report)?;
        }
    }
    if args.json {
        print_json(&json!(reports))?;
    }
    Ok(if worst == Severity::Info { Outcome::Fine } else { Outcome::Found })
}

fn convert(args: &LogConvertArgs) -> Result<Outcome> {
    may_save(&args.out, args.force)?;
    save(&FlightLog::load(&args.file, args.mapping.as_deref())?, &args.out)
}

fn from_dataset(args: &FromDatasetArgs) -> Result<Outcome> {
    may_save(&args.out, args.force)?;
    save(&Dataset::open(&args.dir)?.world(args.world)?.flight_log(args.drone)?, &args.out)
}

fn may_save(out: &Path, force: bool) -> Result<()> {
    output::check(&[("--out", Some(out))], force)?;
    Ok(FlightLog::may_save(out)?)
}

fn save(log: &FlightLog, out: &Path) -> Result<Outcome> {
    for warning in &log.warnings {
        warn(warning);
    }
    log.save(out)?;
    print(format_args!("wrote {} ({:.1} s)", out.display(), log.duration_s))?;
    Ok(Outcome::Fine)
}
