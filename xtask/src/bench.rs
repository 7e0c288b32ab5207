//! Benchmarks, by name.

use crate::run::{self, Result};
use crate::setup;

/// Benchmarks that there are.
const NAMES: &[&str] = &["gap"];

/// Sets up and runs a benchmark in the release profile; what follows its name goes to it.
pub fn run(args: &[String]) -> Result {
    let Some((name, rest)) = args.split_first() else {
        return Err(format!("`cargo xtask bench` needs the name of a benchmark: {}", NAMES.join(", ")));
    };
    if !NAMES.contains(&name.as_str()) {
        return Err(format!("there is no benchmark `{name}`; there are {}", NAMES.join(", ")));
    }
    setup::run()?;
    run::check(run::cargo().args(["bench", "--bench", name, "--"]).args(rest))
}
