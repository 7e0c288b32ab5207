//! The commands, each short.

pub mod add;
pub mod bench;
pub mod compare;
pub mod completions;
pub mod dataset;
pub mod depth;
pub mod diagnose;
pub mod drones;
pub mod excite;
pub mod export;
pub mod fly;
pub mod identify;
pub mod lab;
pub mod log;
pub mod remove;
pub mod scene;
pub mod sitl;
pub mod urdf;
pub mod vehicle;
mod vehicle_new;
mod vehicle_throttle;
pub mod view;
mod view_watch;
pub mod watch;

use crate::{Error, Result};
use std::path::Path;

/// An error of reading or writing `path`.
fn io_error(path: &Path) -> impl FnOnce(std::io::Error) -> Error + '_ {
    move |source| Error::Io { path: path.to_path_buf(), source }
}

/// Prints a line to standard output; a closed pipe becomes an error that ends the program quietly.
fn print(text: impl std::fmt::Display) -> Result<()> {
    use std::io::Write;
    writeln!(std::io::stdout(), "{text}").map_err(io_error(Path::new("standard output")))
}

/// Prints a value as JSON.
fn print_json(value: &serde_json::Value) -> Result<()> {
    print(format_args!("{value:#}"))
}
