//! `propwash completions`.

use super::print;
use crate::Result;
use crate::cli::args::{Args, CompletionsArgs};
use crate::cli::exit::Outcome;
use clap::CommandFactory;

/// Prints the script.
pub fn run(args: &CompletionsArgs) -> Result<Outcome> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Args::command(), "propwash", &mut script);
    print(String::from_utf8_lossy(&script).trim_end())?;
    Ok(Outcome::Fine)
}
