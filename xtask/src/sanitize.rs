//! Tests under a sanitizer of LLVM, which sees what reads and writes outside of its memory.

use crate::run::{self, Result};
use crate::setup;

/// The target; a sanitizer is for the code that is built for it, and not for build scripts and macros.
const TARGET: &str = "x86_64-unknown-linux-gnu";

/// Tests that run where none are named: those that go through `unsafe` code, all of which hands memory to MuJoCo or reads it there.
const TESTS: [&str; 10] = [
    "arena",
    "obstacles",
    "sense_caster",
    "sense_collide",
    "sense_contact",
    "sense_depth",
    "sense_extremes",
    "sense_lint",
    "sense_scene",
    "sensors",
];

/// Builds and runs them with AddressSanitizer, in a target folder of its own. ARGS go to `cargo test` in place of the list.
///
/// The runtime of the sanitizer comes with the toolchain; the flag for it is one that stable compilers take only when told so.
pub fn run(args: &[String]) -> Result {
    setup::run()?;
    let mut cargo = run::cargo();
    cargo.args(["test", "--package", "propwash", "--target", TARGET, "--target-dir", "target/sanitize"]);
    if args.is_empty() {
        TESTS.iter().for_each(|test| {
            cargo.args(["--test", test]);
        });
    } else {
        cargo.args(args);
    }
    cargo.env("RUSTC_BOOTSTRAP", "1").env("RUSTFLAGS", "-Zsanitizer=address");
    // MuJoCo's library and the thread pool keep memory until the end of the process. A scene that asks for more memory than there is
    // gets none, as without the sanitizer, and MuJoCo says so.
    cargo.env("ASAN_OPTIONS", "detect_leaks=0:allocator_may_return_null=1");
    run::check(&mut cargo)
}
