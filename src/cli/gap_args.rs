//! Flags of the commands that compare a vehicle with flight logs: compare, diagnose, add.

use super::gap_logs::{GapLogArgs, ReadingArgs};
use crate::gap::session::Put;
use clap::Args as ClapArgs;
use std::path::PathBuf;

/// Epilogue of `propwash compare --help`.
pub const COMPARE_EXAMPLES: &str = "\
Examples:
  propwash compare flight.csv --vehicle my_quad.toml
  propwash compare flights/*.csv --vehicle cf2x_L250 --drive rotor-commands --json
  propwash compare usd01.csv --vehicle cf2x_L250 --mapping crazyflie.toml --ground-z 0.02

It compares in three ways: force and torque that the model lacks at every instant; errors of 0.1 to
1 s roll-outs from measured states; a whole flight along the log's references. Exit codes: 0 nothing
is missing (the model agrees to the noise of the sensors, or is off within its tolerances only),
1 something is missing, 2 error.";

/// `propwash compare`.
#[derive(Clone, Debug, ClapArgs)]
pub struct CompareArgs {
    /// The flights and how to read them.
    #[command(flatten)]
    pub logs: GapLogArgs,
    /// Print everything as JSON.
    #[arg(long)]
    pub json: bool,
    /// Write a report page (HTML): errors, overlays, residuals over time and against their causes.
    #[arg(long, value_name = "FILE.html")]
    pub report: Option<PathBuf>,
    /// Replace files that are there already.
    #[arg(long)]
    pub force: bool,
}

/// Which part of the flights is held out of the fit.
#[derive(Clone, Debug, ClapArgs)]
pub struct HeldOutArgs {
    /// Flights that check the result and are not used by the fit. Default: the end of each log.
    #[arg(long, value_name = "LOG", num_args = 1..)]
    pub held_out: Vec<PathBuf>,
    /// Share at the end of each log that checks the result and is not used by the fit; 0 for none, at most 0.5.
    #[arg(long, value_name = "SHARE", default_value_t = 0.2, value_parser = half, conflicts_with = "held_out")]
    pub hold_out: f64,
}

/// Parses a share from 0 to 0.5.
pub(super) fn half(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if (0.0..=0.5).contains(&v) => Ok(v),
        _ => Err(format!("expected a share from 0 to 0.5, got {text:?}")),
    }
}

/// Epilogue of `propwash diagnose --help`.
pub const DIAGNOSE_EXAMPLES: &str = "\
Examples:
  propwash diagnose flight.csv --vehicle my_quad.toml --report diagnosis.html
  propwash diagnose a.csv b.csv --held-out c.csv --vehicle my_quad.toml --out diagnosis.json
  propwash diagnose flight.csv --vehicle my_quad.toml --candidates rotor_drag,linear_drag

All values are SI. Exit codes: 0 nothing is missing, 1 something is missing or unexplained, 2 error.";

/// `propwash diagnose`.
#[derive(Clone, Debug, ClapArgs)]
pub struct DiagnoseArgs {
    /// The flights and how to read them.
    #[command(flatten)]
    pub logs: GapLogArgs,
    /// Which flights are held out of the fit.
    #[command(flatten)]
    pub held_out: HeldOutArgs,
    /// Search only these candidates; all others stay free within their tolerance.
    #[arg(long, value_name = "ID,ID", value_delimiter = ',')]
    pub candidates: Vec<String>,
    /// Where something is unexplained, search for no formula.
    #[arg(long)]
    pub no_formulas: bool,
    /// Look for no moments at which something changed in mid-flight: take the flights as of one vehicle.
    #[arg(long)]
    pub no_moments: bool,
    /// Fit a small neural network to what is left beside everything that was found, where that makes unseen flight better.
    #[arg(long)]
    pub network: bool,
    /// After the verdict, print which rule decided about each effect and what each rule states.
    #[arg(long, conflicts_with = "json")]
    pub why: bool,
    /// Print everything as JSON.
    #[arg(long)]
    pub json: bool,
    /// Write the diagnosis as JSON, for `propwash add --from-diagnosis`.
    #[arg(long, value_name = "FILE.json")]
    pub out: Option<PathBuf>,
    /// Write a report page (HTML): verdict, error ladder, overlays, residuals before and after.
    #[arg(long, value_name = "FILE.html")]
    pub report: Option<PathBuf>,
    /// Write a picture of the error ladder.
    #[arg(long, value_name = "FILE.png")]
    pub ladder: Option<PathBuf>,
    /// Replace files that are there already.
    #[arg(long)]
    pub force: bool,
}

/// Epilogue of `propwash add --help`.
pub const ADD_EXAMPLES: &str = "\
Examples:
  propwash add rotor_drag --vehicle my_quad.toml --fit flight.csv --out better.toml
  propwash add payload weak_rotor.2 --vehicle my_quad.toml --fit a.csv b.csv --out better.toml
  propwash add --from-diagnosis diagnosis.json --vehicle my_quad.toml --out better.toml
  propwash add --set rotor_drag:drag_n_s2_per_rad_m=6.5e-5+-3e-6 --vehicle my_quad.toml \
    --fit flight.csv --out better.toml

The file gets values, standard deviations, the logs' SHA-256 and the date, in SI units. Nothing is
written that raises the error on flight that the fit has not seen. Exit codes: 0 the file was
written, 1 nothing makes the vehicle better and no file was written, 2 error.";

/// `propwash add`.
#[derive(Clone, Debug, ClapArgs)]
pub struct AddArgs {
    /// Effects, by the ids that diagnose names (rotor_drag, weak_rotor.2). With --from-diagnosis: all of it if not given.
    #[arg(value_name = "EFFECT", required_unless_present_any = ["from_diagnosis", "set", "adjust", "network"])]
    pub effects: Vec<String>,
    /// Write this value of a parameter of an effect, SI, with its standard deviation where it has one; nothing is fitted, and
    /// the flights of --fit are named as its source. Repeat it for several. `propwash lab` writes such commands.
    #[arg(long, value_name = "EFFECT:PARAMETER=VALUE[+-SIGMA]", conflicts_with_all = ["effects", "from_diagnosis", "calibrate", "report"])]
    pub set: Vec<Put>,
    /// The same of a parameter within its tolerance, which is no missing effect.
    #[arg(long, value_name = "EFFECT:PARAMETER=VALUE[+-SIGMA]", conflicts_with_all = ["effects", "from_diagnosis", "calibrate", "report"])]
    pub adjust: Vec<Put>,
    /// Write an effect of your own for --set: its name, what it acts on (force_body_x …, force_world_x …, torque_x …), the plausible
    /// size of its coefficient `k`, and its text (docs/effects/expression.md).
    #[arg(long, value_name = "NAME:AXIS:SIZE:TEXT", requires = "set")]
    pub expression: Vec<String>,
    /// Also fit a small neural network to what is left beside the effects, and write it where that makes unseen flight better; its file
    /// goes beside --out. With --from-diagnosis the one that was found there is written anyway.
    #[arg(long, conflicts_with_all = ["set", "adjust", "from_diagnosis"])]
    pub network: bool,
    /// Flights to fit the effects to: .csv, .parquet, .ulg, .mcap, or the folder of a ROS 2 bag.
    #[arg(long, value_name = "LOG", num_args = 1.., required_unless_present = "from_diagnosis")]
    pub fit: Vec<PathBuf>,
    /// A diagnosis written by `propwash diagnose --out`; nothing is fitted again.
    #[arg(long, value_name = "FILE.json",
          conflicts_with_all = ["fit", "held_out", "drive", "ground_z", "ceiling_z", "neighbour", "load", "mapping", "report"])]
    pub from_diagnosis: Option<PathBuf>,
    /// The vehicle, and how the flights are read.
    #[command(flatten)]
    pub reading: ReadingArgs,
    /// Which flights are held out of the fit.
    #[command(flatten)]
    pub held_out: HeldOutArgs,
    /// Vehicle file to write.
    #[arg(long, value_name = "V2.toml")]
    pub out: PathBuf,
    /// Replace files that are there already, that of --vehicle too; write effects that the flights cannot determine too.
    #[arg(long)]
    pub force: bool,
    /// Also write calibrated parameters (those within tolerance) at their estimates, for the groups that lower the held-out
    /// error.
    #[arg(long)]
    pub calibrate: bool,
    /// Write a report page (HTML): error ladder, overlays, residuals before and after.
    #[arg(long, value_name = "FILE.html")]
    pub report: Option<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}
