//! Flags of `propwash watch`.

use super::gap_logs::ReadingArgs;
use crate::gap::drift::Order;
use clap::{Args as ClapArgs, ValueEnum};
use std::path::PathBuf;

/// Ends the help of `propwash watch`.
pub const WATCH_EXAMPLES: &str = "\
Examples:
  propwash watch logs --vehicle my_quad.toml --once
  propwash watch logs --vehicle my_quad.toml --record watch.jsonl --write now.toml --force
  propwash watch logs --vehicle my_quad.toml --once --json drift.json

Logs are the files of LOGDIR and of its sub-folders that end in .csv, .parquet, .ulg or .mcap. Each is
checked and diagnosed by itself; a log that cannot be used is said in a line. Wind, battery, clocks and
offsets of sensors may differ from log to log and are no drift. Ctrl-C ends it after the table of what
has drifted. Exit codes: 0 nothing has drifted, 1 something has, 2 error.";

/// In which order logs are taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum OrderArg {
    /// By the time at which the file was last changed, then by name.
    Time,
    /// By name, sub-folders included.
    Name,
}

impl From<OrderArg> for Order {
    fn from(arg: OrderArg) -> Self {
        match arg {
            OrderArg::Time => Self::Time,
            OrderArg::Name => Self::Name,
        }
    }
}

/// `propwash watch`.
#[derive(Clone, Debug, ClapArgs)]
pub struct WatchArgs {
    /// Folder with flight logs of one vehicle.
    #[arg(value_name = "LOGDIR")]
    pub folder: PathBuf,
    /// The vehicle, and how the flights are read.
    #[command(flatten)]
    pub reading: ReadingArgs,
    /// End after the logs that are there, in place of waiting for new ones.
    #[arg(long)]
    pub once: bool,
    /// Time between two looks at the folder, s. A log is taken when two looks found it alike.
    #[arg(long, value_name = "SECONDS", default_value_t = 2.0, value_parser = interval)]
    pub interval: f64,
    /// Order of the logs that are there at a look.
    #[arg(long, value_enum, default_value_t = OrderArg::Time)]
    pub order: OrderArg,
    /// Share at the end of each log on which drifts are judged and that no fit sees; 0 for none, at most 0.5.
    #[arg(long, value_name = "SHARE", default_value_t = 0.2, value_parser = super::gap_args::half)]
    pub hold_out: f64,
    /// Keep what is known of each log in this file, and go on from it where it is there: no log is diagnosed twice.
    #[arg(long, value_name = "FILE.jsonl")]
    pub record: Option<PathBuf>,
    /// Write the vehicle with the accepted values and standard deviations, after each log that lowers its errors.
    #[arg(long, value_name = "V2.toml")]
    pub write: Option<PathBuf>,
    /// Write everything as JSON after each log; `-` prints it at the end in place of text, with --once.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
    /// Replace files that are there already, that of --vehicle too.
    #[arg(long)]
    pub force: bool,
}

/// Parses an interval from 0.05 s to a day.
fn interval(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if (0.05..=86_400.0).contains(&v) => Ok(v),
        _ => Err(format!("expected a time from 0.05 to 86400 s, got {text:?}")),
    }
}
