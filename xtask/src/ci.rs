//! Everything that must hold before a change is merged.

use std::process::Stdio;

use crate::run::{self, Result};
use crate::{docs, setup, test, tidy};

/// Formatting, lints, rules, documentation, licences, tests; stops at the first that fails.
pub fn run() -> Result {
    setup::run()?;
    run::check(run::cargo().args(["fmt", "--all", "--check"]))
        .map_err(|e| format!("{e}: run `cargo fmt --all`"))?;
    run::check(run::cargo().args(["clippy", "--workspace", "--all-targets", "--", "-D", "warnings"]))?;
    tidy::run()?;
    run::check(run::cargo().args(["doc", "--workspace", "--no-deps"]).env("RUSTDOCFLAGS", "-D warnings"))?;
    docs::run(&[])?;
    let mut deny = run::cargo();
    let has_deny = deny.args(["deny", "--version"]).stdout(Stdio::null()).stderr(Stdio::null());
    if has_deny.status().is_ok_and(|s| s.success()) {
        run::check(run::cargo().args(["deny", "check", "bans", "licenses", "sources"]))?;
    } else {
        eprintln!("cargo-deny is not installed: licences and sources of dependencies were not checked");
        eprintln!("  (`cargo install --locked cargo-deny` installs it)");
    }
    test::run(&[])
}
