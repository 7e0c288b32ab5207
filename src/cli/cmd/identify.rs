//! `propwash identify`: parameters of a model from a flight log.

use super::drones::find;
use super::{print, print_json};
use crate::Result;
use crate::cli::args::{IdentifyArgs, ModelArg};
use crate::cli::exit::{Outcome, warn};
use crate::cli::output;
use crate::flight::FlightLog;
use crate::gap::accept::today_utc;
use crate::gap::attitude_model::{Options, check_out, identify};
use serde_json::json;

/// Runs the command.
pub fn run(args: &IdentifyArgs) -> Result<Outcome> {
    let ModelArg::Attitude = args.model;
    args.out.as_deref().map_or(Ok(()), check_out)?;
    output::check(&[("--out", args.out.as_deref())], args.force)?;
    let vehicle = find(&args.vehicle)?;
    let (log, report) = FlightLog::open(&args.file, args.mapping.as_deref())?;
    for warning in report.warnings() {
        warn(&warning);
    }
    let found = identify(&log, &vehicle, &Options { dynamics: args.dynamics.clone() })?;
    let better = match &args.out {
        Some(out) => Some((out, found.vehicle_for_any_folder(&vehicle, &today_utc())?)),
        None => None,
    };
    if args.json {
        print_json(&json!(found))?;
    } else {
        print(&found)?;
    }
    if let Some((out, better)) = better {
        output::write("--out", out, better.to_toml().as_bytes(), args.force)?;
        if !args.json {
            print(format_args!("\nwrote {}", out.display()))?;
        }
    }
    Ok(Outcome::Fine)
}
