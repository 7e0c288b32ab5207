//! Flags shared by the commands that compare a vehicle with flight logs, and the vehicle and tracks made from them.

use super::cmd::drones;
use crate::gap::StatedNoise;
use crate::gap::{Drive, Options, Track, fitted};
use crate::vehicle::Vehicle;
use crate::{Error, Result};
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// What drives the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum DriveArg {
    /// Measured rotor speeds.
    RotorSpeeds,
    /// Commanded rotor speeds, or throttles by the file's [throttle], through the model's motors.
    RotorCommands,
    /// Commanded attitude and thrust, through the abstracted response.
    AttitudeCommands,
    /// Collective thrust, logged or of the measured rotor speeds, with the measured attitude: forces only.
    Thrust,
}

impl From<DriveArg> for Drive {
    fn from(arg: DriveArg) -> Self {
        match arg {
            DriveArg::RotorSpeeds => Self::RotorSpeeds,
            DriveArg::RotorCommands => Self::RotorCommands,
            DriveArg::AttitudeCommands => Self::AttitudeCommands,
            DriveArg::Thrust => Self::Thrust,
        }
    }
}

/// Flights, the vehicle, and how to read both.
#[derive(Clone, Debug, Args)]
pub struct GapLogArgs {
    /// Flight logs of one vehicle: .csv, .parquet, .ulg, .mcap, or the folder of a ROS 2 bag (docs/logs.md).
    #[arg(required = true, value_name = "LOG")]
    pub logs: Vec<PathBuf>,
    /// The vehicle, and how the flights are read.
    #[command(flatten)]
    pub reading: ReadingArgs,
}

/// The vehicle, and how flights are read for it.
#[derive(Clone, Debug, Args)]
pub struct ReadingArgs {
    /// Vehicle: a built-in name or a vehicle file.
    #[arg(long, visible_alias = "drone", value_name = "NAME|FILE")]
    pub vehicle: String,
    /// What drives the model. Default: the first that log and vehicle have of rotor commands, measured rotor speeds,
    /// attitude and thrust commands, thrust.
    #[arg(long, value_enum)]
    pub drive: Option<DriveArg>,
    /// Height of the ground, m, world. Default: 0.
    #[arg(long, value_name = "M", value_parser = finite, allow_hyphen_values = true)]
    pub ground_z: Option<f64>,
    /// Height of the ceiling, m, world. Default: none.
    #[arg(long, value_name = "M", value_parser = finite, allow_hyphen_values = true)]
    pub ceiling_z: Option<f64>,
    /// Tracked object that is another vehicle; repeat it for several. Default: every tracked object that is not a load.
    #[arg(long, value_name = "NAME")]
    pub neighbour: Vec<String>,
    /// Tracked object that hangs on a cable. Default: the first whose name contains "load", "cargo" or
    /// "weight".
    #[arg(long, value_name = "NAME")]
    pub load: Option<String>,
    /// Noise of a channel (standard deviation of one sample, SI), used instead of the estimate from the log: position=0.002
    /// (m), attitude=0.01 (rad), gyro=0.05 (rad/s), accel=0.3 (m/s²). Repeat it for several.
    #[arg(long, value_name = "CHANNEL=VALUE", value_parser = stated_noise)]
    pub noise: Vec<(String, f64)>,
    /// Mapping of the logs' names, units and frames. Default: the file beside each log that ends in .toml.
    #[arg(long, value_name = "FILE")]
    pub mapping: Option<PathBuf>,
}

/// A finite number.
fn finite(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if v.is_finite() => Ok(v),
        _ => Err(format!("expected a finite number, got {text:?}")),
    }
}

/// Parses `CHANNEL=VALUE`.
fn stated_noise(text: &str) -> Result<(String, f64), String> {
    let (channel, value) =
        text.split_once('=').ok_or_else(|| format!("expected CHANNEL=VALUE, got {text:?}"))?;
    let value = finite(value)?;
    StatedNoise::default().set(channel, value).map_err(|e| format!("expected {e}, got {text:?}"))?;
    Ok((channel.into(), value))
}

impl GapLogArgs {
    /// Opens the vehicle and prepares the logs for it, as [`ReadingArgs::open`].
    pub fn open(&self) -> Result<(Vehicle, Vec<Track>)> {
        self.reading.open(&self.logs)
    }
}

impl ReadingArgs {
    /// Opens the vehicle and prepares the logs for it. Every log is checked first: an invalid one is refused, and the
    /// checker's other messages become warnings of its track.
    ///
    /// # Errors
    /// Those of vehicle files and of [`fitted::read`]; [`Error::Usage`] for a ceiling that is not above the ground or a log
    /// that is given twice.
    pub fn open(&self, logs: &[PathBuf]) -> Result<(Vehicle, Vec<Track>)> {
        if let Some(twice) = logs.iter().enumerate().find(|(i, l)| logs[..*i].contains(l)) {
            return Err(Error::Usage {
                flag: "LOG",
                expected: "each log once".into(),
                got: format!("{} twice", twice.1.display()),
            });
        }
        let vehicle = drones::find(&self.vehicle)?;
        let tracks = fitted::read(logs, self.mapping.as_deref(), &vehicle, &self.options()?)?;
        Ok((vehicle, tracks))
    }

    /// How logs are read, beside their mapping.
    ///
    /// # Errors
    /// [`Error::Usage`] for a ceiling that is not above the ground.
    pub fn options(&self) -> Result<Options> {
        let ground = self.ground_z.unwrap_or(0.0);
        if let Some(ceiling) = self.ceiling_z.filter(|c| *c <= ground) {
            return Err(Error::Usage {
                flag: "--ceiling-z",
                expected: format!("a height above the ground at {ground} m"),
                got: format!("{ceiling} m"),
            });
        }
        let mut noise = StatedNoise::default();
        for (channel, value) in &self.noise {
            let got = format!("{channel}={value}");
            noise.set(channel, *value).map_err(|expected| Error::Usage { flag: "--noise", expected, got })?;
        }
        Ok(Options {
            noise,
            drive: self.drive.map(Drive::from),
            ground_z_m: self.ground_z,
            ceiling_z_m: self.ceiling_z,
            neighbours: (!self.neighbour.is_empty()).then(|| self.neighbour.clone()),
            load: self.load.clone(),
        })
    }
}
