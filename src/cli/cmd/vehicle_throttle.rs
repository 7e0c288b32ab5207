//! `propwash vehicle throttle`: how fast the motors turn by throttle and voltage, into the vehicle file.

use super::diagnose::refuse_log;
use super::drones::find;
use super::{print, print_json, vehicle};
use crate::Result;
use crate::cli::args::VehicleThrottleArgs;
use crate::cli::exit::Outcome;
use crate::cli::output;
use crate::cli::progress::waiting;
use crate::gap::throttle;
use serde_json::json;

/// Runs the command.
pub(super) fn run(args: &VehicleThrottleArgs) -> Result<Outcome> {
    refuse_log("--out", Some(&args.out), &args.logs, &args.held_out)?;
    output::check(&[("--out", Some(&args.out))], args.force)?;
    let text = vehicle::text_of(&args.vehicle)?;
    let known = find(&args.vehicle)?;
    let found =
        waiting("fitting", || throttle::read(&args.logs, &args.held_out, args.mapping.as_deref(), &known))?;
    let out = found.write_into(&text, &args.vehicle, &known)?;
    if args.json {
        crate::gap::accept::write(&args.out, &out, args.force)?;
        print_json(&json!({ "file": args.out, "motors": found }))?;
        return Ok(Outcome::Fine);
    }
    print(format_args!("motors by throttle, with 95 % intervals\n{found}"))?;
    vehicle::save(&args.vehicle, &out, &args.out, args.force)?;
    Ok(Outcome::Fine)
}
