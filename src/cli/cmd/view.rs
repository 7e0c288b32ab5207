//! `propwash view`: a scene, a data set or a flight log as a page in three dimensions.

use super::{print, print_json};
use crate::Result;
use crate::cli::args::ViewArgs;
use crate::cli::exit::{Outcome, warn};
use crate::cli::output;
use crate::cli::progress::waiting;
use crate::view::{self, Made, Options};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Runs the command.
pub fn run(args: &ViewArgs) -> Result<Outcome> {
    if args.watch {
        view::check_scene(&args.what)?;
        return super::view_watch::run(&args.what, args.port.unwrap_or(0), |address| match args.open {
            true => start(Path::new(address)),
            false => Ok(()),
        });
    }
    let out = args.out.clone().unwrap_or_else(|| PathBuf::from("view.html"));
    output::check(&[("--out", Some(&out))], args.force)?;
    let options =
        Options { worlds: args.world.clone(), scene: args.scene.clone(), vehicle: args.vehicle.clone() };
    let made = waiting("drawing", || view::page(&args.what, &options))?;
    output::write("--out", &out, made.html.as_bytes(), args.force)?;
    if args.json {
        print_json(&json!({ "path": out, "bytes": made.html.len(), "notes": made.notes }))?;
    } else {
        print(summary(&out, &made))?;
    }
    if args.open {
        open(&out)?;
    }
    Ok(Outcome::Fine)
}

/// The page and what it says of itself, in words.
fn summary(out: &Path, made: &Made) -> String {
    let mut text = format!("page  {}, {:.2} MB", out.display(), made.html.len() as f64 / 1e6);
    for note in &made.notes {
        text.push_str("\nnote: ");
        text.push_str(note);
    }
    text
}

/// Opens a page with what the system opens pages with; says so where there is nothing of the kind.
fn open(page: &Path) -> Result<()> {
    start(&page.canonicalize().map_err(super::io_error(page))?)
}

/// Opens a path or an address in the browser.
pub(super) fn start(path: &Path) -> Result<()> {
    let program = if cfg!(target_os = "macos") { "open" } else { "xdg-open" };
    let mut command = Command::new(program);
    command.arg(path).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    if command.spawn().is_err() {
        warn(&format!("`{program}` could not be started: open {} yourself", path.display()));
    }
    Ok(())
}
