//! Flags of `propwash lab`.

use super::args::whole;
use clap::Args as ClapArgs;
use std::path::PathBuf;

/// Ends the help of `propwash lab`.
pub const LAB_EXAMPLES: &str = "\
Examples:
  propwash lab                                   the browser opens; three example flights need no data
  propwash lab flight.csv --vehicle quad.toml    begins with a log and its vehicle
  propwash lab a.csv b.csv --vehicle quad.toml --scene hall.xml --port 8080 --no-open

Drop a flight log on the page, see where the model fails, find which effect is missing, switch it on
and save the better vehicle file. The server binds 127.0.0.1 and answers to the secret in the
printed address alone; nothing leaves this machine. Ctrl-C ends it.";

/// `propwash lab`.
#[derive(Clone, Debug, ClapArgs)]
pub struct LabArgs {
    /// Flight logs to begin with: .csv, .parquet, .ulg, .mcap, or the folder of a ROS 2 bag (docs/logs.md). Others can be dropped on the page.
    #[arg(value_name = "LOG")]
    pub logs: Vec<PathBuf>,
    /// Vehicle to begin with: a built-in name or a vehicle file.
    #[arg(long, visible_alias = "drone", value_name = "NAME|FILE")]
    pub vehicle: Option<String>,
    /// Scene in which the flights are shown: a file or a name.
    #[arg(long, value_name = "FILE")]
    pub scene: Option<PathBuf>,
    /// Port on 127.0.0.1; 0 for any that is free.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = whole::<u16>)]
    pub port: u16,
    /// Do not open the browser.
    #[arg(long)]
    pub no_open: bool,
}
