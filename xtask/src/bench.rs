//! Benchmarks, by name.

use crate::run::{self, Result};
use crate::{python, setup};

/// Benchmarks that there are.
const NAMES: &[&str] = &["contacts", "depth", "gap", "identify", "steps"];

/// Those that compare with a peer of the test environment.
const WITH_PEERS: &[&str] = &["contacts", "depth", "identify", "steps"];

/// Sets up and runs a benchmark in the release profile; what follows its name goes to it.
pub fn run(args: &[String]) -> Result {
    let Some((name, rest)) = args.split_first() else {
        return Err(format!("`cargo xtask bench` needs the name of a benchmark: {}", NAMES.join(", ")));
    };
    if !NAMES.contains(&name.as_str()) {
        return Err(format!("there is no benchmark `{name}`; there are {}", NAMES.join(", ")));
    }
    setup::run()?;
    let mut command = run::cargo();
    command.args(["bench", "--bench", name, "--"]).args(rest);
    if WITH_PEERS.contains(&name.as_str()) {
        command.env("PROPWASH_PYTHON", python::test_environment()?);
    }
    run::check(&mut command)
}
