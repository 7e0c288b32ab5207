//! What pages are tested and photographed with: node, its packages of `tests/web`, and Chromium.

use std::path::PathBuf;
use std::process::{Command, Stdio};

use crate::run::{self, Result};

/// What is missing of node, npm and Chromium, in words; `None` where all are there.
fn missing() -> Option<String> {
    let answers = |program: &str| {
        let mut asked = Command::new(program);
        asked.arg("--version").stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        asked.status().is_ok_and(|s| s.success())
    };
    let chromium = std::env::var_os("CHROMIUM").map_or_else(|| "/usr/bin/chromium".into(), PathBuf::from);
    let absent = ["node", "npm"].into_iter().filter(|p| !answers(p)).map(str::to_string);
    let browser = (!chromium.is_file()).then(|| format!("Chromium as {} (or $CHROMIUM)", chromium.display()));
    let all: Vec<String> = absent.chain(browser).collect();
    (!all.is_empty()).then(|| all.join(", "))
}

/// Installs the pinned packages of `tests/web`, unless they are there.
///
/// # Errors
/// Says what is missing.
pub fn prepare() -> Result {
    if let Some(what) = missing() {
        return Err(format!("pages in a browser need {what}"));
    }
    let folder = run::root().join("tests/web");
    let (wanted, there) = (folder.join("package-lock.json"), folder.join("node_modules/.package-lock.json"));
    let time = |path: PathBuf| path.metadata().and_then(|m| m.modified()).ok();
    if time(there).is_some_and(|there| time(wanted).is_some_and(|wanted| there >= wanted)) {
        return Ok(());
    }
    let mut install = Command::new("npm");
    install
        .args(["ci", "--no-audit", "--no-fund", "--ignore-scripts", "--loglevel=error"])
        .current_dir(folder);
    run::check(&mut install)
}
