//! The pictures of README and docs that show pages, taken by a browser without a window.

use std::process::Command;

use crate::run::{self, Result};
use crate::{python, setup, test, web};

/// Builds the program, flies and diagnoses, and takes the pictures.
pub fn run() -> Result {
    web::prepare()?;
    setup::run()?;
    run::check(run::cargo().args([
        "build",
        "--release",
        "-p",
        "propwash",
        "--bin",
        "propwash",
        "--example",
        "hidden_flight",
    ]))?;
    let python = python::test_environment()?;
    let built = test::target_dir()?.join("release");
    run::check(Command::new(python).arg("docs/make_page_pictures.py").arg(built).current_dir(run::root()))?;
    println!("docs/gap.webp, docs/gap_report.png, docs/view.png");
    Ok(())
}
