//! The site of the documentation, and the notebooks in it.

use std::process::Command;

use crate::run::{self, Result};
use crate::{python, setup, test};

/// What builds the site, from the root of the checkout.
const REQUIREMENTS: &str = "docs/requirements.txt";

/// Builds the site; with `--notebooks` runs all notebooks before and writes what they show.
pub fn run(args: &[String]) -> Result {
    let mut notebooks = false;
    for arg in args {
        match arg.as_str() {
            "--notebooks" => notebooks = true,
            other => return Err(format!("`cargo xtask docs` knows only --notebooks, found `{other}`")),
        }
    }
    let target = test::target_dir()?;
    if notebooks {
        setup::run()?;
        let python = python::test_environment()?;
        let package = python::package(&target)?;
        run::check(
            Command::new(python).arg("notebooks/make.py").current_dir(run::root()).env("PYTHONPATH", package),
        )?;
    }
    let python =
        python::environment(&target.join("docs-venv"), REQUIREMENTS, "mkdocs and its plugins (once)")?;
    let site = target.join("site");
    let mut build = Command::new(python);
    build
        .args(["-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir"])
        .arg(&site)
        .current_dir(run::root());
    // Words about another program.
    build.env("NO_MKDOCS_2_WARNING", "1");
    run::check(&mut build).map_err(|e| format!("{e}: what is wrong with the pages stands above"))?;
    println!("site:             {}", site.join("index.html").display());
    println!("with its search:  python3 -m http.server --directory {}", site.display());
    Ok(())
}
