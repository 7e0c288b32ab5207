//! `propwash remove`: an effect out of a vehicle file.

use super::vehicle::{save, text_of};
use crate::Result;
use crate::cli::args::RemoveArgs;
use crate::cli::exit::Outcome;
use crate::gap::accept;

/// Runs the command.
pub fn run(args: &RemoveArgs) -> Result<Outcome> {
    accept::may_write(&args.out, args.force)?;
    let text = accept::remove(&text_of(&args.vehicle)?, &args.vehicle, &args.effect)?;
    save(&args.vehicle, &text, &args.out, args.force)?;
    Ok(Outcome::Fine)
}
