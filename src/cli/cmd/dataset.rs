//! `propwash dataset`: whether a data set is whole, and its worlds as files of other formats.

use super::{print, print_json};
use crate::Result;
use crate::cli::args::{DatasetArgs, DatasetCommand, McapArgs, VerifyArgs};
use crate::cli::exit::Outcome;
use crate::cli::output;
use crate::dataset::mcap::{self, McapSummary};
use crate::dataset::{Dataset, DatasetError};
use crate::flight::files;
use serde_json::json;

/// Runs the command.
pub fn run(args: &DatasetArgs) -> Result<Outcome> {
    match &args.command {
        DatasetCommand::Verify(args) => verify(args),
        DatasetCommand::Mcap(args) => to_mcap(args),
    }
}

fn to_mcap(args: &McapArgs) -> Result<Outcome> {
    output::check(&[("--out", Some(&args.out))], args.force)?;
    let set = Dataset::open(&args.dir)?;
    let world = set.world(args.world)?;
    let (mut summary, mut fault) = (McapSummary::default(), None);
    let written = files::write(&args.out, args.force, |file| match mcap::write(&world, file) {
        Ok(done) => {
            summary = done;
            Ok(())
        }
        Err(e) => {
            let told = std::io::Error::other(e.to_string());
            fault = Some(e);
            Err(told)
        }
    });
    if let Some(e) = fault {
        return Err(e.into());
    }
    written.map_err(|e| output::refused("--out", &args.out, e))?;
    let McapSummary { messages, topics, images } = summary;
    if args.json {
        let told = json!({ "path": args.out, "messages": messages, "topics": topics, "images": images });
        print_json(&told)?;
    } else {
        let (name, world) = (args.out.display(), args.world);
        print(format_args!(
            "{name}: world {world}, {messages} messages in {topics} topics, {images} depth images"
        ))?;
    }
    Ok(Outcome::Fine)
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
