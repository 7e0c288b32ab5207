//! `propwash dataset`: whether a data set is whole.

use super::{print, print_json};
use crate::Result;
use crate::cli::args::{DatasetArgs, DatasetCommand, VerifyArgs};
use crate::cli::exit::Outcome;
use crate::dataset::{Dataset, DatasetError};
use serde_json::json;

/// Runs the command.
pub fn run(args: &DatasetArgs) -> Result<Outcome> {
    let DatasetCommand::Verify(args) = &args.command;
    verify(args)
}

fn verify(args: &VerifyArgs) -> Result<Outcome> {
    let faults = match Dataset::open(&args.dir) {
        Ok(set) => set.faults(),
        Err(fault) => vec![fault],
    };
    let mut words = Vec::new();
    for fault in faults {
        match fault {
            DatasetError::Damaged { .. } | DatasetError::Incomplete { .. } => words.push(fault.to_string()),
            other => return Err(other.into()),
        }
    }
    if args.json {
        print_json(&json!({ "path": args.dir, "whole": words.is_empty(), "faults": words }))?;
    } else if words.is_empty() {
        print(format_args!("{}: every file is there and has its hash", args.dir.display()))?;
    } else {
        words.iter().try_for_each(print)?;
    }
    Ok(if words.is_empty() { Outcome::Fine } else { Outcome::Found })
}
