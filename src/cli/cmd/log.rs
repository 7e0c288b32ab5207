//! `propwash log`: check flight logs, convert them to the contract.

use super::{print, print_json};
use crate::cli::args::{FromDatasetArgs, LogArgs, LogCheckArgs, LogCommand, LogConvertArgs};
use crate::cli::exit::{Outcome, warn};
use crate::cli::output;
use crate::cli::progress::waiting;
use crate::dataset::Dataset;
use crate::flight::correction::mend;
use crate::flight::{FlightLog, Severity, check};
use crate::{Error, Result};
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
    if let Some(out) = &args.write_mapping {
        return mend_log(args, out);
    }
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

/// Writes the mapping with which a log is right, as far as the check knows how.
fn mend_log(args: &LogCheckArgs, out: &Path) -> Result<Outcome> {
    let [file] = &args.files[..] else {
        return Err(Error::Usage {
            flag: "--write-mapping",
            expected: "one log; check the others with --mapping and what was written for one".into(),
            got: format!("{} logs", args.files.len()),
        });
    };
    output::check(&[("--write-mapping", Some(out))], args.force)?;
    let mended = waiting("reading", || mend(file, args.mapping.as_deref()))?;
    let text = mended.text.as_bytes();
    match (mended.fixes.is_empty(), args.json) {
        (true, _) => warn("nothing to correct by a mapping file: none was written"),
        (false, true) => output::report("--write-mapping", out, text, args.force)?,
        (false, false) => output::write("--write-mapping", out, text, args.force)?,
    }
    if args.json {
        print_json(&json!([mended.report]))?;
    } else {
        for fix in &mended.fixes {
            print(format_args!("corrected: {fix}"))?;
        }
        if !mended.fixes.is_empty() {
            print(format_args!("wrote {}; with it the log reads so:", out.display()))?;
        }
        print(&mended.report)?;
    }
    for fix in &mended.left {
        warn(&format!("not corrected, since it does not go with the rest of the mapping: {fix}"));
    }
    Ok(if mended.report.verdict == Severity::Info { Outcome::Fine } else { Outcome::Found })
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
