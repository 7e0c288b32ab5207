//! Flags of `propwash bench`.

use super::args::{CameraArgs, not_negative, positive, triple, whole};
use clap::{Args as ClapArgs, ValueEnum};
use std::path::PathBuf;

/// Ends the help of `propwash bench`.
pub const BENCH_EXAMPLES: &str = "\
Examples:
  propwash bench
  propwash bench --scene my_scene.xml --drone my_quad.toml --control state --size 128x96
  propwash bench --worlds 1,1024 --threads 4 --precision f64 --seconds 3 --out speed.json

Every world has its own start and command and begins a new episode every 4 s of flight at 500 Hz.
Figures are medians; 90 % of the calls fall between the two values beside them. Units are SI (m, s);
angles of view are in degrees. Other programs that run at the same time make everything slower.
As the Python package brings it, the start to the first image includes Python's own.";

/// The number that states are kept and advanced in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PrecisionArg {
    /// Single precision.
    F32,
    /// Double precision.
    F64,
}

/// What a process measures of itself, from its start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PartArg {
    /// The first depth image.
    FirstFrame,
    /// Memory of the largest number of worlds.
    Memory,
}

/// `propwash bench`.
#[derive(Clone, Debug, ClapArgs)]
pub struct BenchArgs {
    /// Scene: a name (corridor, forest, meshes, room, terrain, zoo) or an MJCF file. Default: what `propwash scene new forest` makes.
    #[arg(long, value_name = "NAME|FILE")]
    pub scene: Option<PathBuf>,
    /// Vehicle: a built-in name or a vehicle file.
    #[arg(long, visible_alias = "vehicle", value_name = "NAME|FILE", default_value = "cf2x_L250")]
    pub drone: String,
    /// Shell (MJCF with a body named "drone") in place of the one that the vehicle file names.
    #[arg(long, value_name = "FILE")]
    pub shell: Option<PathBuf>,
    /// Equations of motion: first_principles, so_rpy, so_rpy_rotor or so_rpy_rotor_drag.
    #[arg(long, value_name = "NAME", default_value = "first_principles")]
    pub dynamics: String,
    /// What commands mean: state, attitude, body_rate, force_torque or rotor_vel.
    #[arg(long, value_name = "MODE", default_value = "state")]
    pub control: String,
    /// Numbers of worlds for which steps are measured.
    #[arg(long, value_name = "N[,N..]", value_delimiter = ',', default_value = "1,64,1024,65536", value_parser = whole::<usize>)]
    pub worlds: Vec<usize>,
    /// Number of worlds for depth, contacts, clearances and the whole loop.
    #[arg(long, value_name = "N", default_value_t = 256, value_parser = whole::<usize>)]
    pub sensing_worlds: usize,
    /// Camera of the vehicle's shell, or of the scene.
    #[arg(long, value_name = "NAME", default_value = "fpv")]
    pub camera: String,
    /// Camera settings.
    #[command(flatten)]
    pub view: CameraArgs,
    /// Drones start near here, m.
    #[arg(long, value_name = "X,Y,Z", default_value = "0,0,1", value_parser = triple)]
    pub spawn: [f64; 3],
    /// Greatest distance from there in x and in y, m.
    #[arg(long, value_name = "M", default_value_t = 0.5, value_parser = not_negative)]
    pub spawn_radius: f64,
    /// Threads of the multi-threaded rows. Default: one per core.
    #[arg(long, value_name = "N", value_parser = whole::<usize>)]
    pub threads: Option<usize>,
    /// Precision of states and arithmetic.
    #[arg(long, value_enum, default_value_t = PrecisionArg::F32)]
    pub precision: PrecisionArg,
    /// Measuring time of each row, s.
    #[arg(long, value_name = "S", default_value_t = 1.0, value_parser = positive)]
    pub seconds: f64,
    /// Write the figures as JSON into a file too.
    #[arg(long, value_name = "FILE.json")]
    pub out: Option<PathBuf>,
    /// Print the figures as JSON in place of text.
    #[arg(long)]
    pub json: bool,
    /// Replace files that are there already.
    #[arg(long)]
    pub force: bool,
    /// What a process of its own measures.
    #[arg(long, value_enum, hide = true)]
    pub part: Option<PartArg>,
}
