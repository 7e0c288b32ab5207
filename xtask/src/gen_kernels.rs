//! The kernels in `crates/kernels/src/`, written from the equations.

use crate::run::{self, Result};
use crate::setup;

/// Writes the kernels; with `--check` it only compares. Both are the test that compares them, since only the library itself can
/// trace its equations.
pub fn run(args: &[String]) -> Result {
    let check = match args {
        [] => false,
        [one] if one == "--check" => true,
        _ => return Err(format!("`cargo xtask gen` takes `--check` or nothing, found `{}`", args.join(" "))),
    };
    setup::run()?;
    let mut command = run::cargo();
    command.args(["test", "--test", "kernels", "kernels_are_what_the_equations_give"]);
    if !check {
        command.env("PROPWASH_WRITE_KERNELS", "1");
    }
    run::check(&mut command)
}
