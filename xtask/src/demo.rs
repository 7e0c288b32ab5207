//! The main job from nothing: set-up, build, one flight through the forest.

use std::fs;
use std::process::Command;

use crate::run::{self, Result};
use crate::{setup, test};

/// Where the data set goes, from the root of the checkout.
const OUT: &str = "out/demo";

/// The flight.
const FLY: &[&str] = &[
    "fly",
    "--scene",
    "xml/forest.xml",
    "--drone",
    "cf2x_L250",
    "--worlds",
    "4",
    "--trajectory",
    "lissajous",
    "--seconds",
    "4",
    "--camera",
    "fpv",
    "--size",
    "64x64",
    "--fps",
    "20",
    "--seed",
    "0",
    "--out",
    OUT,
];

/// Sets up, builds and flies.
pub fn run(args: &[String]) -> Result {
    let mut fresh = false;
    for arg in args {
        match arg.as_str() {
            "--fresh" => fresh = true,
            other => return Err(format!("`cargo xtask demo` knows only --fresh, found `{other}`")),
        }
    }
    setup::run()?;
    run::check(run::cargo().args(["build", "--release"]))?;
    let root = run::root();
    let out = root.join(OUT);
    if fresh && out.exists() {
        fs::remove_dir_all(&out).map_err(|e| format!("{} cannot be deleted: {e}", out.display()))?;
    }
    let program = test::target_dir()?.join("release/propwash");
    run::check(Command::new(program).args(FLY).current_dir(&root))?;
    let picture = out.join("overview.png");
    if !picture.is_file() {
        return Err(format!(
            "the flight ended well but left no {}: that is a bug of `propwash fly`",
            picture.display()
        ));
    }
    println!("data set:         {}", out.display());
    println!("overview picture: {}", picture.display());
    println!("more:             target/release/propwash --help");
    Ok(())
}
