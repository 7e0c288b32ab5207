//! Flags and sub-commands, each defined once.

use super::bench_args::BENCH_EXAMPLES;
pub use super::bench_args::BenchArgs;
use super::gap_args::{
    ADD_EXAMPLES, AddArgs, COMPARE_EXAMPLES, CompareArgs, DIAGNOSE_EXAMPLES, DiagnoseArgs,
};
use super::gap_logs::DriveArg;
use super::lab_args::LAB_EXAMPLES;
pub use super::lab_args::LabArgs;
use super::sitl_args::{SITL_EXAMPLES, SitlArgs};
use super::view_args::VIEW_EXAMPLES;
pub use super::view_args::ViewArgs;
use super::watch_args::{WATCH_EXAMPLES, WatchArgs};
use crate::arena::{CameraConfig, MountConfig, ObstacleMotion, SensorConfig, read_value};
use crate::dataset::{MAX_DISTANCE, change_camera, table};
use crate::physics::integrate::Integrator;
use crate::sense::{Caster, DepthKind};
use crate::{Error, Result};
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Args as ClapArgs, Parser, Subcommand, ValueEnum};
use serde::Serialize;
use serde_json::{Map, Value};
use std::path::PathBuf;

/// Drone simulator for any MuJoCo scene that finds the physics a vehicle's model lacks.
#[derive(Debug, Parser)]
#[command(name = "propwash", version, propagate_version = true, after_help = EXAMPLES)]
pub struct Args {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// Ends the help of the program.
const EXAMPLES: &str = "\
Examples:
  propwash drones                        which vehicles there are
  propwash scene new forest --seed 3 --trees 60 --out forest.xml
  propwash scene lint forest.xml         what depth and contacts will and will not see, and why
  propwash depth --scene forest.xml --pos 0,0,1 --look 1,0,0 --out view.png
  propwash fly --scene forest --drone cf2x_L250 --worlds 16 --trajectory lissajous \\
               --seconds 4 --camera fpv --size 64x64 --out data/forest
  propwash view data/forest --open                   the flight in three dimensions, in the browser
  propwash lab                                       from a flight log to a better vehicle, in the browser
  propwash sitl hb_x500 --stack px4                  PX4 flies a vehicle; ArduPilot and Betaflight do, too
  propwash log check flight.csv                      what is wrong with a flight log, in words
  propwash vehicle diff cf2x_L250 mine.toml          what differs between two vehicles
  propwash identify flight.csv --model attitude --vehicle cf2x_L250 --out better.toml
  propwash compare flight.csv --vehicle quad.toml    where the model departs from the flight
  propwash diagnose flight.csv --vehicle quad.toml   which physics the model lacks
  propwash add rotor_drag --vehicle quad.toml --fit flight.csv --out better.toml
  propwash watch logs --vehicle quad.toml            what has drifted from flight to flight
  propwash excite --vehicle quad.toml --want linear_drag --out path.csv    what to fly to find it
  propwash bench                                     how fast this machine flies, sees and touches

Units are SI (m, s, rad, N); angles of view are in degrees. World z is up; a vehicle's x points
forward, y left. Exit codes: 0 fine, 1 a check found a problem, 2 error. No command replaces a file
that is there already without --force.";

/// Ends the help of `propwash fly`.
const FLY_EXAMPLES: &str = "\
Examples:
  propwash fly --scene forest --drone cf2x_L250 --worlds 16 --out data/forest
  propwash fly --scene room --drone cf2x_L250 --drone hb_x500 --out data/two
  propwash fly --scene room --drone cf2x_L250 --trajectory waypoints p.csv --out data/path
  propwash fly --config data/forest/manifest.json --worlds 64 --out data/more

The folder gets a manifest, one folder per world (states, contacts and clearances as Parquet, depth
as 16-bit PNG of millimetres and as exact numbers in frames.npz) and the picture overview.png.
Units are SI: m, s, rad, Hz; angles of view are in degrees. World z is up.
The same options give the same bytes, with any number of threads and after any interruption.";

/// Ends the help of `propwash depth`.
const DEPTH_EXAMPLES: &str = "\
Examples:
  propwash depth --scene forest --pos 0,0,1 --look 1,0,0 --out view.png --preview rgb.png
  propwash depth --scene zoo --camera overview --size 640x480 --out zoo.png --json

Lengths are in m, angles in degrees. World z is up.";

/// Ends the help of `propwash drones`.
const DRONES_EXAMPLES: &str = "\
Examples:
  propwash drones
  propwash drones cf2x_L250              every value with its unit and source
  propwash drones my_drone.toml --json

Units are SI: kg, m, s, N, rad; rotor speeds in this list are in rpm.";

/// Ends the help of `propwash export`.
const EXPORT_EXAMPLES: &str = "\
Examples:
  propwash export cf21B_500 --to casadi --out cf21B_500.py
  propwash export my_drone.toml --what step --control rotor_vel --to c --out step.c
  propwash export cf21B_500 --to latex --parameters body.mass_kg

docs/export.md says what goes in and comes out.";

/// Ends the help of `propwash scene lint`.
const LINT_EXAMPLES: &str = "\
Examples:
  propwash scene lint zoo
  propwash scene lint my_scene.xml --spawn 0,0,2 --spawn-radius 0.5 --json

Lengths are in m. Exit codes: 0 depth images and contacts see every geom and the start is free,
1 they do not, or it is not, 2 the scene cannot be loaded.";

/// Ends the help of `propwash scene` and `propwash scene new`.
const NEW_EXAMPLES: &str = "\
Examples:
  propwash scene new forest --seed 3 --trees 60 --out forest.xml
  propwash scene new corridor --gates 6 --width 2 --out corridor.xml
  propwash scene new boxes --count 40 --moving 4 --out boxes.xml

Lengths are in m. The same options and seed give the same file.";

/// Ends the help of `propwash urdf`.
const URDF_EXAMPLES: &str = "\
Examples:
  propwash urdf quad.urdf --controller-from cf2x_L250 --out vehicles
  propwash urdf gate.urdf --obstacle --search ~/ros_ws/src --out obstacles

Units are SI: m, kg, kg·m². xacro files are refused; run xacro on them first.";

/// The sub-commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Fly drones through a scene and write a data set: states, depth, segmentation, contacts, clearances, overview.
    #[command(after_help = FLY_EXAMPLES, allow_negative_numbers = true)]
    Fly(Box<FlyArgs>),
    /// Render one depth image of a scene.
    #[command(after_help = DEPTH_EXAMPLES, allow_negative_numbers = true)]
    Depth(DepthArgs),
    /// Show a scene, a data set or a flight log in three dimensions: one page that needs no other file and no network.
    #[command(after_help = VIEW_EXAMPLES)]
    View(ViewArgs),
    /// From a flight log to a better vehicle in the browser: see the flight, find what is missing, switch it on, save.
    #[command(after_help = LAB_EXAMPLES)]
    Lab(LabArgs),
    /// Let PX4, ArduPilot or Betaflight fly a vehicle: their controllers, simulated physics and sensors, in lockstep.
    #[command(after_help = SITL_EXAMPLES, allow_negative_numbers = true)]
    Sitl(Box<SitlArgs>),
    /// List the vehicles, or show one with all its values and sources.
    #[command(after_help = DRONES_EXAMPLES, allow_negative_numbers = true)]
    Drones(DronesArgs),
    /// Print a vehicle's equations in another language.
    #[command(after_help = EXPORT_EXAMPLES)]
    Export(ExportArgs),
    /// Check scenes and make new ones.
    #[command(after_help = NEW_EXAMPLES)]
    Scene(SceneArgs),
    /// Turn a drone's URDF into a vehicle file and a shell, or any URDF into an obstacle.
    #[command(after_help = URDF_EXAMPLES, allow_negative_numbers = true)]
    Urdf(UrdfArgs),
    /// Check data sets.
    Dataset(DatasetArgs),
    /// Check flight logs, or convert them to the contract of docs/logs.md.
    Log(LogArgs),
    /// Take an effect out of a vehicle file.
    #[command(after_help = REMOVE_EXAMPLES)]
    Remove(RemoveArgs),
    /// Show what differs between two vehicles.
    #[command(after_help = VEHICLE_EXAMPLES)]
    Vehicle(VehicleArgs),
    /// Identify the parameters of a model from a flight log, with intervals.
    #[command(after_help = IDENTIFY_EXAMPLES)]
    Identify(IdentifyArgs),
    /// Compare a vehicle's model with flights: where it fails, by how much, and what the error depends on.
    #[command(after_help = COMPARE_EXAMPLES, allow_negative_numbers = true)]
    Compare(CompareArgs),
    /// Find the physical effects that a vehicle's model lacks, from flight logs: values, intervals, look-alikes, what to fly next.
    #[command(after_help = DIAGNOSE_EXAMPLES, allow_negative_numbers = true)]
    Diagnose(DiagnoseArgs),
    /// Fit effects to flights and write them into a vehicle file.
    #[command(after_help = ADD_EXAMPLES, allow_negative_numbers = true)]
    Add(AddArgs),
    /// Follow the logs of a folder, flight after flight: what has drifted of a vehicle, since which log, and by how much.
    #[command(after_help = WATCH_EXAMPLES, allow_negative_numbers = true)]
    Watch(WatchArgs),
    /// Plan a flight that makes chosen parameters visible: waypoints, and the intervals to expect.
    #[command(after_help = EXCITE_EXAMPLES, allow_negative_numbers = true)]
    Excite(ExciteArgs),
    /// Measure the speed of this machine: steps, depth images, contacts, clearances, and all of them together.
    #[command(after_help = BENCH_EXAMPLES, allow_negative_numbers = true)]
    Bench(BenchArgs),
    /// Print what completes the words of this program in a shell, to be put where the shell looks for it.
    #[command(after_help = COMPLETIONS_EXAMPLES)]
    Completions(CompletionsArgs),
}

const COMPLETIONS_EXAMPLES: &str = "\
Examples:
  propwash completions bash > ~/.local/share/bash-completion/completions/propwash
  propwash completions zsh > \"${fpath[1]}/_propwash\"
  propwash completions fish > ~/.config/fish/completions/propwash.fish";

/// `propwash completions`.
#[derive(Clone, Debug, ClapArgs)]
pub struct CompletionsArgs {
    /// The shell.
    #[arg(value_enum)]
    pub shell: clap_complete::Shell,
}

/// Ends the help of `propwash identify`.
const IDENTIFY_EXAMPLES: &str = "\
Examples:
  propwash identify flight.csv --model attitude --vehicle cf2x_L250
  propwash identify flight.csv --model attitude --vehicle my.toml --out my2.toml

The log needs position, attitude, cmd_roll cmd_pitch cmd_yaw (rad) and cmd_thrust (N). The mass is
taken from the vehicle file, since motion shows only thrust and drag divided by mass.
docs/identify.md explains.";

/// Which model to identify.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ModelArg {
    /// The abstracted attitude response: roll, pitch, yaw and thrust answer commands.
    Attitude,
}

/// `propwash identify`.
#[derive(Clone, Debug, ClapArgs)]
pub struct IdentifyArgs {
    /// The log: .csv, .parquet, .ulg, .mcap, or the folder of a ROS 2 bag.
    #[arg(value_name = "LOG")]
    pub file: PathBuf,
    /// The model.
    #[arg(long, value_enum, default_value_t = ModelArg::Attitude)]
    pub model: ModelArg,
    /// Setting of the model: so_rpy, so_rpy_rotor (thrust lags) or so_rpy_rotor_drag (with linear drag).
    #[arg(long, default_value = "so_rpy_rotor_drag", value_name = "NAME")]
    pub dynamics: String,
    /// A built-in vehicle or a vehicle file: mass, gravity, and what cannot be identified.
    #[arg(long, visible_alias = "drone", value_name = "NAME|FILE")]
    pub vehicle: String,
    /// Mapping of names, units and frames. Default: the file beside the log that ends in .toml, where there is one.
    #[arg(long, value_name = "FILE")]
    pub mapping: Option<PathBuf>,
    /// Write the vehicle with the identified values.
    #[arg(long, value_name = "V2.toml")]
    pub out: Option<PathBuf>,
    /// Replace files that are there already.
    #[arg(long)]
    pub force: bool,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// Words of the command line for values of the library, with their help.
macro_rules! words {
    ($($type:ty { $($value:path => $word:literal $help:literal,)* })*) => { $(
        impl ValueEnum for $type {
            fn value_variants<'a>() -> &'a [Self] {
                &[$($value),*]
            }
            fn to_possible_value(&self) -> Option<PossibleValue> {
                Some(match self { $($value => PossibleValue::new($word).help($help),)* })
            }
        }
    )* };
}

words! {
    DepthKind {
        DepthKind::Range => "range" "Along the ray, from the camera's centre",
        DepthKind::ZDepth => "z" "Along the optical axis, as depth cameras report",
    }
    Caster {
        Caster::Native => "native" "Propwash's own, sixteen rays at a time in f32",
        Caster::MuJoCo => "mujoco" "MuJoCo's mj_multiRay in f64, the reference",
    }
}

/// Words for integrators, with their help. They are of another crate, which knows no command line.
const INTEGRATORS: [(&str, &str, Integrator); 3] = [
    ("euler", "Explicit Euler", Integrator::Euler),
    ("semi-implicit-euler", "Semi-implicit Euler", Integrator::SemiImplicitEuler),
    ("rk4", "Runge–Kutta of fourth order", Integrator::Rk4),
];

/// A word → [`Integrator`].
fn integrator() -> impl TypedValueParser<Value = Integrator> {
    PossibleValuesParser::new(INTEGRATORS.map(|(word, help, _)| PossibleValue::new(word).help(help)))
        .try_map(|word| INTEGRATORS.iter().find(|i| i.0 == word).map(|i| i.2).ok_or("no integrator"))
}

/// Width × height in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

/// `64x48` → [`Size`].
fn size(text: &str) -> Result<Size, String> {
    let fault = || format!("expected WIDTHxHEIGHT in pixels, such as 64x48, each 1 to 8192; got {text:?}");
    let (w, h) = text.split_once('x').ok_or_else(fault)?;
    let (width, height) = (w.parse().map_err(|_| fault())?, h.parse().map_err(|_| fault())?);
    if (1..=8192).contains(&width) && (1..=8192).contains(&height) {
        Ok(Size { width, height })
    } else {
        Err(fault())
    }
}

/// `1,2,3` → three numbers.
pub fn triple(text: &str) -> Result<[f64; 3], String> {
    let numbers: Vec<f64> = text.split(',').filter_map(|v| v.trim().parse().ok()).collect();
    match numbers[..] {
        [x, y, z] if text.split(',').count() == 3 && x.is_finite() && y.is_finite() && z.is_finite() => {
            Ok([x, y, z])
        }
        _ => Err(format!("expected three finite numbers X,Y,Z, such as 0,0,1.5; got {text:?}")),
    }
}

/// `1,2,3,4` → numbers, finite.
pub fn numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let list: Option<Vec<f64>> = text.split(',').map(|v| v.trim().parse().ok()).collect();
    let list = list.filter(|list| list.iter().all(|v| v.is_finite()));
    let found = list.and_then(|list| <[f64; N]>::try_from(list).ok());
    found.ok_or_else(|| format!("expected {N} finite numbers with commas between them, got {text:?}"))
}

/// `X,Y,Z` or `X,Y,Z,ROLL,PITCH,YAW` → a mount.
fn mount(text: &str) -> Result<MountConfig, String> {
    let list = match text.split(',').count() {
        3 => numbers::<3>(text).map(|[x, y, z]| [x, y, z, 0.0, 0.0, 0.0]),
        6 => numbers::<6>(text),
        _ => {
            return Err(format!("expected X,Y,Z (m) or X,Y,Z,ROLL,PITCH,YAW (m and degrees), got {text:?}"));
        }
    };
    let [x, y, z, roll, pitch, yaw] = list?;
    let [roll, pitch, yaw] = [roll, pitch, yaw].map(f64::to_radians);
    let turn = nalgebra::UnitQuaternion::from_euler_angles(roll, pitch, yaw);
    Ok(MountConfig { pos_m: [x, y, z], quat_xyzw: turn.coords.into() })
}

/// How obstacles move, see [`described`].
fn obstacle_motion(text: &str) -> Result<Box<ObstacleMotion>, String> {
    let motion: ObstacleMotion = described(text)?;
    motion.check().map_err(|e| e.to_string())?;
    Ok(Box::new(motion))
}

/// `KIND` or `KIND:KEY=VALUE,…` → what has these fields; values are those of TOML, and words without quotes are text.
pub fn described<T: serde::de::DeserializeOwned>(text: &str) -> Result<T, String> {
    let (kind, rest) = text.split_once(':').unwrap_or((text, ""));
    let mut table = toml::Table::from_iter([("kind".to_string(), toml::Value::from(kind.trim()))]);
    // Commas within brackets and quotes belong to a value.
    let (mut depth, mut quoted, mut parts) = (0, false, vec![String::new()]);
    for c in rest.chars() {
        match c {
            '"' => quoted = !quoted,
            '[' | '{' if !quoted => depth += 1,
            ']' | '}' if !quoted => depth -= 1,
            ',' if !quoted && depth == 0 => {
                parts.push(String::new());
                continue;
            }
            _ => {}
        }
        if let Some(part) = parts.last_mut() {
            part.push(c);
        }
    }
    for part in parts.iter().map(|part| part.trim()).filter(|_| !rest.trim().is_empty()) {
        let Some((key, value)) = part.split_once('=') else {
            return Err(format!("expected KEY=VALUE after {kind}:, got {part:?}"));
        };
        let read = toml::from_str::<toml::Table>(&format!("value = {value}"));
        let read = read.ok().and_then(|mut one| one.remove("value"));
        table.insert(key.trim().into(), read.unwrap_or_else(|| value.trim().into()));
    }
    table.try_into::<T>().map_err(|e| e.message().trim().to_string())
}

/// A whole number of at least zero.
pub fn whole<T: std::str::FromStr>(text: &str) -> Result<T, String> {
    text.parse().map_err(|_| format!("expected a whole number of at least 0, got {text:?}"))
}

/// Whole numbers of at least zero with commas between them.
pub fn list<T: std::str::FromStr>(text: &str) -> Result<Vec<T>, String> {
    text.split(',').map(|one| whole(one.trim())).collect()
}

/// A MuJoCo geom group.
fn group(text: &str) -> Result<u8, String> {
    match text.trim().parse() {
        Ok(v @ 0..=5) => Ok(v),
        _ => Err(format!("expected MuJoCo's geom groups 0 to 5, such as 0,1,2; got {text:?}")),
    }
}

/// A finite number above zero.
pub fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if v.is_finite() && v > 0.0 => Ok(v),
        _ => Err(format!("expected a number above 0, got {text:?}")),
    }
}

/// A finite number of at least zero.
pub fn not_negative(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if v.is_finite() && v >= 0.0 => Ok(v),
        _ => Err(format!("expected a number of at least 0, got {text:?}")),
    }
}

/// Adds what a flag gives as a field of a description.
///
/// # Errors
/// [`Error::Usage`] for a value that descriptions cannot hold.
pub fn put<T: Serialize>(
    fields: &mut Map<String, Value>,
    flag: &'static str,
    field: &str,
    given: Option<T>,
) -> Result<()> {
    let Some(given) = given else { return Ok(()) };
    let value = serde_json::to_value(given).map_err(|e| Error::Usage {
        flag,
        expected: "what a description can hold, in which paths are UTF-8".into(),
        got: e.to_string(),
    })?;
    fields.insert(field.into(), value);
    Ok(())
}

/// Camera settings that `fly`, `depth` and `bench` share. What is not given stays as the configuration has it.
#[derive(Clone, Debug, Default, ClapArgs)]
pub struct CameraArgs {
    /// Image size in pixels. Default: 64x64.
    #[arg(long, value_name = "WxH", value_parser = size)]
    pub size: Option<Size>,
    /// Vertical angle of view, degrees. Default: the camera's own; 60 for --pos and --look.
    #[arg(long, value_name = "DEG", value_parser = positive)]
    pub fovy: Option<f64>,
    /// Focal lengths and principal point (from the left and the top edge) in pixels of --size, in place of an angle of view.
    #[arg(long, value_name = "FX,FY,CX,CY", value_parser = numbers::<4>, conflicts_with = "fovy")]
    pub intrinsics: Option<[f64; 4]>,
    /// What a depth number measures. Default: z.
    #[arg(long, value_enum)]
    pub depth: Option<DepthKind>,
    /// Nearest depth that counts, m. Default: 0.01.
    #[arg(long, value_name = "M", value_parser = positive)]
    pub near: Option<f64>,
    /// Farthest depth that counts, m. Default: 20.
    #[arg(long, value_name = "M", value_parser = positive)]
    pub far: Option<f64>,
    /// MuJoCo geom groups that the camera sees. Default: 0,1,2.
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = group)]
    pub groups: Option<Vec<u8>>,
    /// Ray caster. Default: native.
    #[arg(long, value_enum)]
    pub caster: Option<Caster>,
}

impl CameraArgs {
    /// What the flags change in a camera.
    ///
    /// # Errors
    /// As [`CameraArgs::fields`].
    pub fn change(&self, camera: &mut CameraConfig) -> Result<()> {
        let mut all = table("camera", camera)?;
        change_camera(&mut all, self.fields(camera)?);
        *camera = read_value(all.into())?;
        Ok(())
    }

    /// The fields of a camera that the flags change; its range has to fit 16 bits of millimetres.
    ///
    /// # Errors
    /// [`Error::Usage`] for a range that does not.
    pub fn fields(&self, camera: &CameraConfig) -> Result<Map<String, Value>> {
        let mut fields = Map::new();
        put(&mut fields, "--size", "width", self.size.map(|size| size.width))?;
        put(&mut fields, "--size", "height", self.size.map(|size| size.height))?;
        put(&mut fields, "--fovy", "fovy_deg", self.fovy)?;
        put(&mut fields, "--intrinsics", "pinhole_px", self.intrinsics)?;
        put(&mut fields, "--depth", "kind", self.depth)?;
        put(&mut fields, "--groups", "groups", self.groups.as_ref())?;
        put(&mut fields, "--caster", "caster", self.caster)?;
        let [near, far] = camera.range()?;
        let (near, far) = (self.near.unwrap_or(near), self.far.unwrap_or(far));
        let farthest = f64::from(MAX_DISTANCE) * 0.001;
        if near < 0.001 || near >= far || far > farthest {
            return Err(Error::Usage {
                flag: "--near, --far",
                expected: format!(
                    "0.001 m <= near < far <= {farthest} m, which is what 16-bit images of millimetres hold"
                ),
                got: format!("{near} m, {far} m"),
            });
        }
        put(&mut fields, "--near, --far", "range_m", self.near.or(self.far).map(|_| [near, far]))?;
        Ok(fields)
    }
}

/// `propwash fly`. What is not given stays as --config has it, or at its default.
#[derive(Clone, Debug, ClapArgs)]
pub struct FlyArgs {
    /// Description of the flight (TOML or JSON), or manifest.json of a data set, which is flown again; flags change it.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Scene: the name of one that comes with Propwash (corridor, forest, meshes, room, terrain, zoo), or an MJCF file.
    #[arg(long, value_name = "NAME|FILE", required_unless_present = "config")]
    pub scene: Option<PathBuf>,
    /// Vehicle: a built-in name or a vehicle file. Repeat it for mixed vehicles in one world.
    #[arg(long, visible_alias = "vehicle", value_name = "NAME|FILE", required_unless_present = "config")]
    pub drone: Vec<String>,
    /// Drones per world; the --drone list is used in turn. Default: as many as --drone names.
    #[arg(long, value_name = "N", value_parser = whole::<usize>)]
    pub drones_per_world: Option<usize>,
    /// Shell (MJCF with a body named "drone") in place of the one that the vehicle file names.
    #[arg(long, value_name = "FILE")]
    pub shell: Option<PathBuf>,
    /// Equations of motion: first_principles, so_rpy, so_rpy_rotor or so_rpy_rotor_drag. Default: first_principles.
    #[arg(long, value_name = "NAME")]
    pub dynamics: Option<String>,
    /// Number of worlds, each with draws of its own. Default: 1.
    #[arg(long, value_name = "N", value_parser = whole::<usize>)]
    pub worlds: Option<usize>,
    /// lissajous, circle, hover, or: waypoints FILE (CSV with t,x,y,z and optionally yaw, world and drone, whose rows then are a way
    /// of their own). Default: lissajous.
    #[arg(long, value_name = "KIND [FILE]", num_args = 1..=2)]
    pub trajectory: Option<Vec<String>>,
    /// Length of the flight, s. Default: 4.
    #[arg(long, value_name = "S", value_parser = positive)]
    pub seconds: Option<f64>,
    /// Camera of the vehicle's shell, or of the scene. Default: fpv.
    #[arg(long, value_name = "NAME")]
    pub camera: Option<String>,
    /// Where the camera sits on every drone, in place of one of the shell: m in the body (x forward, y left, z up), and how it is turned,
    /// degrees; it looks forward without a turn, down with a pitch of 90.
    #[arg(long, value_name = "X,Y,Z[,ROLL,PITCH,YAW]", value_parser = mount, allow_hyphen_values = true, conflicts_with = "camera")]
    pub camera_mount: Option<MountConfig>,
    /// A further sensor of every drone: imu, lidar, range_finder, optical_flow or depth_camera, and its fields (docs/sensors.md), such as
    /// lidar:rings=4,columns=90,sample_hz=10. Repeat it for more.
    #[arg(long, value_name = "KIND[:KEY=VALUE,...]", value_parser = described::<SensorConfig>)]
    pub sensor: Vec<SensorConfig>,
    /// Camera settings.
    #[command(flatten)]
    pub view: CameraArgs,
    /// Depth frames per second. Default: 20.
    #[arg(long, value_name = "HZ", value_parser = whole::<u32>)]
    pub fps: Option<u32>,
    /// Rows of states per second. Default: 100.
    #[arg(long, value_name = "HZ", value_parser = whole::<u32>)]
    pub log_hz: Option<u32>,
    /// Simulation steps per second. Default: 500.
    #[arg(long, value_name = "HZ", value_parser = whole::<u32>)]
    pub sim_hz: Option<u32>,
    /// Integration scheme. Default: euler.
    #[arg(long, value_parser = integrator())]
    pub integrator: Option<Integrator>,
    /// Seed of all random numbers. Default: 0.
    #[arg(long, value_name = "N", value_parser = whole::<u64>)]
    pub seed: Option<u64>,
    /// Randomisation rules (TOML, [[rule]] tables) drawn anew for every world.
    #[arg(long, value_name = "FILE")]
    pub randomize: Option<PathBuf>,
    /// Shift every movable obstacle of the scene by up to this much in x and y, anew for every world, m. Default: 0.
    #[arg(long, value_name = "M", value_parser = not_negative)]
    pub obstacle_jitter: Option<f64>,
    /// Let the movable obstacles of the scene move by themselves, line (there and back) or circle, and its fields
    /// (docs/configuration.md), such as line:speed_m_s=[0.5,1.0],reach_m=[0.5,2.0]. Default: they stand still.
    #[arg(long, value_name = "KIND[:KEY=VALUE,...]", value_parser = obstacle_motion)]
    pub obstacle_motion: Option<Box<ObstacleMotion>>,
    /// Noise model of the depth camera (TOML); the clean depth is kept beside it.
    #[arg(long, value_name = "FILE")]
    pub noise: Option<PathBuf>,
    /// Store surface normals too.
    #[arg(long)]
    pub normals: bool,
    /// Threads. Default: one per core. The output does not depend on it.
    #[arg(long, value_name = "N", value_parser = whole::<usize>)]
    pub threads: Option<usize>,
    /// Page (HTML) that shows the data set in three dimensions, as `propwash view` makes it.
    #[arg(long = "view", value_name = "FILE")]
    pub page: Option<PathBuf>,
    /// Video (mp4) of world 0, made from the data set: the command of the Python package only, with propwash[video]
    /// (docs/pictures.md).
    #[arg(long, value_name = "FILE")]
    pub video: Option<PathBuf>,
    /// Folder of the data set. A run that was stopped goes on where it was.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Print a JSON summary in place of text and progress.
    #[arg(long)]
    pub json: bool,
}

/// `propwash depth`.
#[derive(Clone, Debug, ClapArgs)]
pub struct DepthArgs {
    /// Scene: the name of one that comes with Propwash (corridor, forest, meshes, room, terrain, zoo), or an MJCF file.
    #[arg(long, value_name = "NAME|FILE")]
    pub scene: PathBuf,
    /// Camera of the scene to look through; --pos and --look otherwise.
    #[arg(long, value_name = "NAME", conflicts_with_all = ["pos", "look"])]
    pub camera: Option<String>,
    /// Where the camera is, m, world.
    #[arg(long, value_name = "X,Y,Z", value_parser = triple, allow_hyphen_values = true, default_value = "0,0,1")]
    pub pos: [f64; 3],
    /// Direction in which it looks, world; it is held upright.
    #[arg(long, value_name = "X,Y,Z", value_parser = triple, allow_hyphen_values = true, default_value = "1,0,0")]
    pub look: [f64; 3],
    /// Camera settings.
    #[command(flatten)]
    pub view: CameraArgs,
    /// 16-bit PNG to write, 1 mm per step; 0 = nothing hit, 65535 = beyond --far, 65534 = nearer than --near.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Also write a coloured picture to look at.
    #[arg(long, value_name = "FILE")]
    pub preview: Option<PathBuf>,
    /// Replace files that are there already.
    #[arg(long)]
    pub force: bool,
    /// Print a JSON summary.
    #[arg(long)]
    pub json: bool,
}

/// `propwash drones`.
#[derive(Clone, Debug, ClapArgs)]
pub struct DronesArgs {
    /// Vehicle to show in full: a built-in name or a vehicle file.
    pub name: Option<String>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// `propwash export`.
#[derive(Clone, Debug, ClapArgs)]
pub struct ExportArgs {
    /// Vehicle: a built-in name or a vehicle file.
    pub vehicle: String,
    /// Which equations.
    #[arg(long, value_parser = ["rate", "step", "controller", "gradient"], default_value = "rate")]
    pub what: String,
    /// The language.
    #[arg(long, value_parser = ["c", "c-float", "cuda", "wgsl", "numpy", "jax", "casadi", "latex"], default_value = "c")]
    pub to: String,
    /// The model.
    #[arg(long, default_value = "first_principles")]
    pub dynamics: String,
    /// What commands mean, for all but a rate.
    #[arg(long, default_value = "attitude")]
    pub control: String,
    /// How a step integrates.
    #[arg(long, value_parser = integrator())]
    pub integrator: Option<Integrator>,
    /// Steps per second.
    #[arg(long, value_name = "HZ", default_value_t = 500)]
    pub freq: u32,
    /// Parameters that are inputs, such as body.mass_kg, or all; the others are numbers in the code.
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    pub parameters: Vec<String>,
    /// Forces, wind, heights of ground and ceiling, time and random numbers are inputs, too.
    #[arg(long)]
    pub surroundings: bool,
    /// Where to write it; standard output where there is none.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Replace a file that is there already.
    #[arg(long)]
    pub force: bool,
}

/// `propwash scene`.
#[derive(Clone, Debug, ClapArgs)]
pub struct SceneArgs {
    /// What to do with scenes.
    #[command(subcommand)]
    pub command: SceneCommand,
}

/// The sub-commands of `propwash scene`.
#[derive(Clone, Debug, Subcommand)]
pub enum SceneCommand {
    /// List every geom and whether depth and collision see it, and why not. Exit code 1 when something is unseen.
    #[command(after_help = LINT_EXAMPLES, allow_negative_numbers = true)]
    Lint(LintArgs),
    /// Write a generated scene.
    #[command(subcommand, after_help = NEW_EXAMPLES)]
    New(NewScene),
}

/// Kinds of generated scenes. Options that are not given take the generator's defaults.
#[derive(Clone, Debug, Subcommand)]
pub enum NewScene {
    /// Trees of several shapes, rocks and fallen logs around a clearing.
    #[command(after_help = NEW_EXAMPLES, allow_negative_numbers = true)]
    Forest {
        /// Where it goes and what all kinds share.
        #[command(flatten)]
        common: NewArgs,
        /// Number of trees.
        #[arg(long, value_name = "N", value_parser = whole::<usize>)]
        trees: Option<usize>,
        /// Number of rocks.
        #[arg(long, value_name = "N", value_parser = whole::<usize>)]
        rocks: Option<usize>,
        /// Number of fallen logs.
        #[arg(long, value_name = "N", value_parser = whole::<usize>)]
        logs: Option<usize>,
        /// Edge of the square that holds everything, m.
        #[arg(long, value_name = "M", value_parser = positive)]
        extent: Option<f64>,
        /// Radius around the origin that stays free, m.
        #[arg(long, value_name = "M", value_parser = not_negative)]
        clearing: Option<f64>,
        /// Least distance between trunks, m.
        #[arg(long, value_name = "M", value_parser = not_negative)]
        gap: Option<f64>,
    },
    /// A winding corridor with gates to fly through.
    #[command(after_help = NEW_EXAMPLES, allow_negative_numbers = true)]
    Corridor {
        /// Where it goes and what all kinds share.
        #[command(flatten)]
        common: NewArgs,
        /// Number of gates.
        #[arg(long, value_name = "N", value_parser = whole::<usize>)]
        gates: Option<usize>,
        /// Length of the centre line, m.
        #[arg(long, value_name = "M", value_parser = positive)]
        length: Option<f64>,
        /// Width between the walls, m.
        #[arg(long, value_name = "M", value_parser = positive)]
        width: Option<f64>,
        /// Height of the walls, m.
        #[arg(long, value_name = "M", value_parser = positive)]
        height: Option<f64>,
    },
    /// Gates along a closed course around the start, in the open, and posts.
    #[command(after_help = NEW_EXAMPLES, allow_negative_numbers = true)]
    Track {
        /// Where it goes and what all kinds share.
        #[command(flatten)]
        common: NewArgs,
        /// Number of gates.
        #[arg(long, value_name = "N", value_parser = whole::<usize>)]
        gates: Option<usize>,
        /// Number of posts.
        #[arg(long, value_name = "N", value_parser = whole::<usize>)]
        posts: Option<usize>,
        /// Radius of the course, m.
        #[arg(long, value_name = "M", value_parser = positive)]
        radius: Option<f64>,
        /// How far gates stand off the circle, as a part of its radius.
        #[arg(long, value_name = "PART", value_parser = not_negative)]
        bend: Option<f64>,
    },
    /// Rooms joined by doors, with furniture.
    #[command(after_help = NEW_EXAMPLES, allow_negative_numbers = true)]
    Rooms {
        /// Where it goes and what all kinds share.
        #[command(flatten)]
        common: NewArgs,
        /// Rooms along x.
        #[arg(long, value_name = "N", value_parser = whole::<usize>)]
        columns: Option<usize>,
        /// Rooms along y.
        #[arg(long, value_name = "N", value_parser = whole::<usize>)]
        rows: Option<usize>,
        /// Pieces of furniture in all rooms together.
        #[arg(long, value_name = "N", value_parser = whole::<usize>)]
        things: Option<usize>,
        /// Edge of a room, m.
        #[arg(long, value_name = "M", value_parser = positive)]
        room: Option<f64>,
        /// Width of doors, m.
        #[arg(long, value_name = "M", value_parser = positive)]
        door: Option<f64>,
        /// Height of the walls, m.
        #[arg(long, value_name = "M", value_parser = positive)]
        height: Option<f64>,
    },
    /// Boxes, pillars and slabs, standing and floating.
    #[command(after_help = NEW_EXAMPLES, allow_negative_numbers = true)]
    Boxes {
        /// Where it goes and what all kinds share.
        #[command(flatten)]
        common: NewArgs,
        /// Number of things.
        #[arg(long, value_name = "N", value_parser = whole::<usize>)]
        count: Option<usize>,
        /// Edge of the square that holds everything, m.
        #[arg(long, value_name = "M", value_parser = positive)]
        extent: Option<f64>,
        /// Radius around the origin that stays free, m.
        #[arg(long, value_name = "M", value_parser = not_negative)]
        clearing: Option<f64>,
        /// Least distance between two things, m.
        #[arg(long, value_name = "M", value_parser = not_negative)]
        gap: Option<f64>,
    },
}

/// What all kinds of generated scenes share.
#[derive(Clone, Debug, ClapArgs)]
pub struct NewArgs {
    /// Seed of everything random.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = whole::<u64>)]
    pub seed: u64,
    /// Number of obstacles that can be moved (mocap bodies).
    #[arg(long, value_name = "N", value_parser = whole::<usize>)]
    pub moving: Option<usize>,
    /// MJCF file to write.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Replace files that are there already.
    #[arg(long)]
    pub force: bool,
}

/// `propwash scene lint`.
#[derive(Clone, Debug, ClapArgs)]
pub struct LintArgs {
    /// Scene: the name of one that comes with Propwash (corridor, forest, meshes, room, terrain, zoo), or an MJCF file.
    #[arg(value_name = "SCENE")]
    pub file: PathBuf,
    /// Where drones start, m.
    #[arg(long, value_name = "X,Y,Z", value_parser = triple, allow_hyphen_values = true, default_value = "0,0,1")]
    pub spawn: [f64; 3],
    /// Radius around the start that should be free, m.
    #[arg(long, value_name = "M", default_value_t = 0.3, value_parser = not_negative)]
    pub spawn_radius: f64,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// `propwash urdf`.
#[derive(Clone, Debug, ClapArgs)]
pub struct UrdfArgs {
    /// The URDF file.
    pub file: PathBuf,
    /// Import it as an obstacle (MJCF with a movable body) and not as a vehicle.
    #[arg(long)]
    pub obstacle: bool,
    /// Folders in which package:// paths are looked up; repeat it for several.
    #[arg(long, value_name = "DIR")]
    pub search: Vec<PathBuf>,
    /// Built-in vehicle whose controller the new one takes over.
    #[arg(long, value_name = "NAME")]
    pub controller_from: Option<String>,
    /// Name of the result. Default: the name of the file without its ending.
    #[arg(long, value_name = "NAME")]
    pub name: Option<String>,
    /// Folder for NAME.toml and NAME.xml.
    #[arg(long, value_name = "DIR", default_value = ".")]
    pub out: PathBuf,
    /// Replace files that are there already.
    #[arg(long)]
    pub force: bool,
}

/// Ends the help of `propwash dataset verify`.
const VERIFY_EXAMPLES: &str = "\
Examples:
  propwash dataset verify data/forest
  propwash dataset verify data/forest --json

Of a damaged world the first fault is named; `propwash fly` with the same options makes it anew.
Exit codes: 0 whole, 1 something is damaged or missing, 2 this is no data set, or cannot be read.";

/// `propwash dataset`.
#[derive(Clone, Debug, ClapArgs)]
pub struct DatasetArgs {
    /// What to do with the data set.
    #[command(subcommand)]
    pub command: DatasetCommand,
}

/// Sub-commands of `propwash dataset`.
#[derive(Clone, Debug, Subcommand)]
pub enum DatasetCommand {
    /// Compare every file of a data set with its hash, and name what is damaged, missing or foreign.
    #[command(after_help = VERIFY_EXAMPLES)]
    Verify(VerifyArgs),
    /// Write a world as an MCAP file: poses, depth images, contacts and all other numbers, for Foxglove and PlotJuggler.
    #[command(after_help = MCAP_EXAMPLES)]
    Mcap(McapArgs),
}

/// Ends the help of `propwash dataset mcap`.
const MCAP_EXAMPLES: &str = "\
Examples:
  propwash dataset mcap data/forest --out forest.mcap
  propwash dataset mcap data/forest --world 3 --out third.mcap --force";

/// `propwash dataset mcap`.
#[derive(Clone, Debug, ClapArgs)]
pub struct McapArgs {
    /// Folder of the data set.
    pub dir: PathBuf,
    /// Number of the world.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = whole::<usize>)]
    pub world: usize,
    /// The file.
    #[arg(long, value_name = "FILE.mcap")]
    pub out: PathBuf,
    /// Replace a file that is there already.
    #[arg(long)]
    pub force: bool,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// `propwash dataset verify`.
#[derive(Clone, Debug, ClapArgs)]
pub struct VerifyArgs {
    /// Folder of the data set.
    pub dir: PathBuf,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// Ends the help of `propwash log check`.
const LOG_CHECK_EXAMPLES: &str = "\
Examples:
  propwash log check flight.csv
  propwash log check flight.ulg --json
  propwash log check usd01.csv --mapping crazyflie.toml
  propwash log check flight.csv --write-mapping flight.toml

Exit codes: 0 nothing wrong, 1 warnings or a log that cannot be right, 2 the file cannot be read.";

/// `propwash log`.
#[derive(Clone, Debug, ClapArgs)]
pub struct LogArgs {
    /// What to do with the log.
    #[command(subcommand)]
    pub command: LogCommand,
}

/// Sub-commands of `propwash log`.
#[derive(Clone, Debug, Subcommand)]
pub enum LogCommand {
    /// Check a flight log: what it holds, and what in it cannot be right. Exit code 1 when something is found.
    #[command(after_help = LOG_CHECK_EXAMPLES)]
    Check(LogCheckArgs),
    /// Write a log in the contract's columns and units, as CSV or Parquet.
    Convert(LogConvertArgs),
    /// Write a flight of a data set as a log, to be checked, compared and diagnosed as a real one.
    #[command(after_help = FROM_DATASET_EXAMPLES)]
    FromDataset(FromDatasetArgs),
}

/// `propwash log check`.
#[derive(Clone, Debug, ClapArgs)]
pub struct LogCheckArgs {
    /// Logs: .csv, .parquet, .ulg, .mcap, or the folder of a ROS 2 bag.
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// Mapping of names, units and frames. Default: the file beside the log that ends in .toml, where there is one.
    #[arg(long, value_name = "FILE")]
    pub mapping: Option<PathBuf>,
    /// Write a mapping file with the corrections that the check asks for (units, axes, frames, delays), and check the log again with it.
    #[arg(long, value_name = "FILE")]
    pub write_mapping: Option<PathBuf>,
    /// Replace that file.
    #[arg(long, requires = "write_mapping")]
    pub force: bool,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// Ends the help of `propwash log from-dataset`.
const FROM_DATASET_EXAMPLES: &str = "\
Examples:
  propwash log from-dataset data/forest --out flight.csv
  propwash log from-dataset data/two --world 3 --drone 1 --out flight.parquet

All columns are in SI units (docs/logs.md).";

/// `propwash log from-dataset`.
#[derive(Clone, Debug, ClapArgs)]
pub struct FromDatasetArgs {
    /// Folder of the data set, as `propwash fly` writes it.
    pub dir: PathBuf,
    /// Which of its worlds, from 0.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = whole::<usize>)]
    pub world: usize,
    /// Which drone of that world, from 0.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = whole::<usize>)]
    pub drone: usize,
    /// File to write, .csv or .parquet.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Replace files that are there already.
    #[arg(long)]
    pub force: bool,
}

/// `propwash log convert`.
#[derive(Clone, Debug, ClapArgs)]
pub struct LogConvertArgs {
    /// The log: .csv, .parquet, .ulg, .mcap, or the folder of a ROS 2 bag.
    pub file: PathBuf,
    /// Mapping of names, units and frames. Default: the file beside the log that ends in .toml, where there is one.
    #[arg(long, value_name = "FILE")]
    pub mapping: Option<PathBuf>,
    /// File to write, .csv or .parquet.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Replace files that are there already.
    #[arg(long)]
    pub force: bool,
}

/// Ends the help of `propwash remove`.
const REMOVE_EXAMPLES: &str = "\
Examples:
  propwash remove linear_drag --vehicle cf2x_L250 --out bare.toml
  propwash remove payload --vehicle mine.toml --out mine.toml --force

Comments, order and layout of the file are kept. Values are in the units that their keys name, SI
for effects.";

/// `propwash remove`.
#[derive(Clone, Debug, ClapArgs)]
pub struct RemoveArgs {
    /// Kind of the effect, such as linear_drag; all its entries are removed.
    pub effect: String,
    /// Vehicle to start from: a built-in name or a vehicle file.
    #[arg(long, visible_alias = "drone", value_name = "NAME|FILE")]
    pub vehicle: String,
    /// Vehicle file to write.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Replace the file at --out where there is one, that of --vehicle too.
    #[arg(long)]
    pub force: bool,
}

/// Ends the help of `propwash vehicle new`.
const VEHICLE_NEW_EXAMPLES: &str = "\
Examples:
  propwash vehicle new --mass 0.75 --arm 0.113 --out quad.toml
  propwash vehicle new --mass 2.2 --arm 0.25 --rotors 6 --radius 0.12 --from-log flight.csv --out hexa.toml

Numbers that nobody gave follow laws of scale over published vehicles, with standard deviations as wide as
these differ; a flight with rotor speeds sharpens thrust, torque and inertias. docs/first_vehicle.md
explains. Exit codes: 0 written, 2 error.";

/// Ends the help of `propwash vehicle throttle`.
const VEHICLE_THROTTLE_EXAMPLES: &str = "\
Examples:
  propwash vehicle throttle a.csv b.csv --held-out c.csv --vehicle quad.toml --out motors.toml
  propwash diagnose d.csv --vehicle motors.toml --drive rotor-commands

Logs need throttles of all rotors (cmd_u1…), and rotor speeds, or a pose from which the lift follows; with the
battery's voltage (vbat) the battery is told from the motors. docs/throttle.md explains.
Exit codes: 0 written, 2 error.";

/// Ends the help of `propwash vehicle` and `propwash vehicle diff`.
const VEHICLE_EXAMPLES: &str = "\
Examples:
  propwash vehicle diff cf2x_L250 mine.toml
  propwash vehicle diff before.toml after.toml --json

Values are in SI units, whatever the files are written in. Sources, notes and layout do not count.
Exit codes: 0 the same, 1 different, 2 error.";

/// `propwash vehicle`.
#[derive(Clone, Debug, ClapArgs)]
pub struct VehicleArgs {
    /// What to do with vehicles.
    #[command(subcommand)]
    pub command: VehicleCommand,
}

/// Sub-commands of `propwash vehicle`.
#[derive(Clone, Debug, Subcommand)]
pub enum VehicleCommand {
    /// List every number and effect that differs: old, new, change. Exit code 1 when something does.
    #[command(after_help = VEHICLE_EXAMPLES)]
    Diff(VehicleDiffArgs),
    /// Write a first vehicle file from mass and arm, sharpened by flights; say what to measure next.
    #[command(after_help = VEHICLE_NEW_EXAMPLES)]
    New(Box<VehicleNewArgs>),
    /// Fit how fast the motors turn by throttle and battery voltage, and write it into the vehicle file: logs of throttles then
    /// drive its model.
    #[command(after_help = VEHICLE_THROTTLE_EXAMPLES)]
    Throttle(VehicleThrottleArgs),
}

/// Where the rotors stand, seen from above.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum LayoutArg {
    /// The front lies between two rotors.
    #[default]
    X,
    /// A rotor stands in front.
    Plus,
}

/// `propwash vehicle new`.
#[derive(Clone, Debug, ClapArgs)]
pub struct VehicleNewArgs {
    /// Mass with battery, kg.
    #[arg(long, value_name = "KG")]
    pub mass: f64,
    /// Standard deviation of the mass, kg. Default: a hundredth of it, as by a kitchen scale.
    #[arg(long, value_name = "KG")]
    pub mass_sigma: Option<f64>,
    /// Distance from the centre to each rotor, m.
    #[arg(long, value_name = "M")]
    pub arm: f64,
    /// Number of rotors on the ring: 4, 6 or 8. Rotor 1 stands at the right of the front, the others follow clockwise, as seen from
    /// above.
    #[arg(long, value_name = "N", default_value_t = 4)]
    pub rotors: usize,
    /// Where the rotors stand.
    #[arg(long, value_enum, default_value_t)]
    pub layout: LayoutArg,
    /// Rotor 1 turns clockwise, seen from above. Default: counter-clockwise; neighbours turn opposite ways.
    #[arg(long)]
    pub first_clockwise: bool,
    /// Radius of the propellers, m.
    #[arg(long, value_name = "M")]
    pub radius: Option<f64>,
    /// Inertia about x, y and z, kg·m².
    #[arg(long, value_name = "X,Y,Z", value_delimiter = ',', num_args = 1)]
    pub inertia: Option<Vec<f64>>,
    /// Greatest thrust over weight. Default: 2.
    #[arg(long, value_name = "N")]
    pub thrust_to_weight: Option<f64>,
    /// Flight of the vehicle that sharpens what it can; repeat it for several.
    #[arg(long, value_name = "LOG")]
    pub from_log: Vec<PathBuf>,
    /// Mapping of the logs' names, units and frames. Default: the file beside each log that ends in .toml.
    #[arg(long, value_name = "FILE")]
    pub mapping: Option<PathBuf>,
    /// Vehicle file to write.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Replace the file at --out where there is one.
    #[arg(long)]
    pub force: bool,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// `propwash vehicle throttle`.
#[derive(Clone, Debug, ClapArgs)]
pub struct VehicleThrottleArgs {
    /// Flights to fit.
    #[arg(required = true, value_name = "LOG")]
    pub logs: Vec<PathBuf>,
    /// Vehicle: a built-in name or a vehicle file.
    #[arg(long, visible_alias = "drone", value_name = "NAME|FILE")]
    pub vehicle: String,
    /// Flight that the fit does not see, to be explained by it; repeat it for several. Default: halves of the fitted flights, by a
    /// fit to the other half.
    #[arg(long, value_name = "LOG")]
    pub held_out: Vec<PathBuf>,
    /// Mapping of the logs' names, units and frames. Default: the file beside each log that ends in .toml.
    #[arg(long, value_name = "FILE")]
    pub mapping: Option<PathBuf>,
    /// Vehicle file to write.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Replace the file at --out where there is one, that of --vehicle too.
    #[arg(long)]
    pub force: bool,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// `propwash vehicle diff`.
#[derive(Clone, Debug, ClapArgs)]
pub struct VehicleDiffArgs {
    /// First vehicle: a built-in name or a vehicle file.
    pub a: String,
    /// Second vehicle: a built-in name or a vehicle file.
    pub b: String,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// Ends the help of `propwash excite`.
const EXCITE_EXAMPLES: &str = "\
Examples:
  propwash excite --vehicle quad.toml --want linear_drag --want rotor_drag --out path.csv
  propwash excite --vehicle cf2x_L250 --want com_offset --box 4,4,2.5 --seconds 40
  propwash excite --vehicle quad.toml --want com_offset --from weak_rotor.2

Every manoeuvre is flown in simulation by the vehicle's own controller. The intervals are those that
propwash diagnose would give with the sensors named. docs/excite.md explains. Exit codes: 0 every
interval is as narrow as wanted, 1 at least one is not, 2 error.";

/// `propwash excite`.
#[derive(Clone, Debug, ClapArgs)]
pub struct ExciteArgs {
    /// Vehicle: a built-in name or a vehicle file.
    #[arg(long, visible_alias = "drone", value_name = "NAME|FILE")]
    pub vehicle: String,
    /// Effect to make visible, such as linear_drag or weak_rotor.2; weak_rotor alone means all rotors. Repeat it, or
    /// separate by commas.
    #[arg(
        long,
        value_name = "EFFECT",
        required_unless_present = "fly",
        conflicts_with = "fly",
        num_args = 1..,
        value_delimiter = ','
    )]
    pub want: Vec<String>,
    /// Do not plan: write these manoeuvres to --out, one after the other, as a diagnosis advises: "low passes, yaw spin".
    #[arg(long, value_name = "MANOEUVRE", requires = "out", conflicts_with = "from", num_args = 1.., value_delimiter = ',')]
    pub fly: Vec<String>,
    /// Do not plan: name the manoeuvres that tell the wanted effects from these.
    #[arg(long, value_name = "EFFECT", num_args = 1.., value_delimiter = ',')]
    pub from: Vec<String>,
    /// Longest flight, s.
    #[arg(long, value_name = "S", default_value_t = 60.0, value_parser = positive)]
    pub seconds: f64,
    /// Standard deviation that is wanted, as a share of the effect's plausible size.
    #[arg(long, value_name = "SHARE", default_value_t = 0.1, value_parser = positive)]
    pub share: f64,
    /// Length, width and height of the space, m: x and y from minus to plus half of theirs, z from 0 up.
    #[arg(long = "box", value_name = "X,Y,Z", default_value = "6,6,3")]
    pub room: String,
    /// There is no ground at z = 0: no low passes, no ground effect.
    #[arg(long)]
    pub scene_free: bool,
    /// Height of a ceiling that can be flown under, m. Default: none.
    #[arg(long, value_name = "M", value_parser = positive)]
    pub ceiling_z: Option<f64>,
    /// Which input of the log will drive the model. Default: rotor commands.
    #[arg(long, value_enum)]
    pub drive: Option<DriveArg>,
    /// Poses per second. Default: 240.
    #[arg(long, value_name = "HZ", value_parser = whole::<u32>)]
    pub pose_hz: Option<u32>,
    /// Noise of positions, mm. Default: 1.
    #[arg(long, value_name = "MM", value_parser = positive)]
    pub position_noise: Option<f64>,
    /// Noise of attitudes, deg. Default: 0.2.
    #[arg(long, value_name = "DEG", value_parser = positive)]
    pub attitude_noise: Option<f64>,
    /// Samples of the gyroscope per second, 0 for none. Default: 500.
    #[arg(long, value_name = "HZ", value_parser = whole::<u32>)]
    pub gyro_hz: Option<u32>,
    /// Noise of the gyroscope, rad/s. Default: 0.01.
    #[arg(long, value_name = "RAD/S", value_parser = positive)]
    pub gyro_noise: Option<f64>,
    /// Samples of the accelerometer per second, 0 for none. Default: 500.
    #[arg(long, value_name = "HZ", value_parser = whole::<u32>)]
    pub accel_hz: Option<u32>,
    /// Noise of the accelerometer, m/s². Default: 0.1.
    #[arg(long, value_name = "M/S2", value_parser = positive)]
    pub accel_noise: Option<f64>,
    /// Accelerations by moving air that no model explains, m/s². Default: 0.03.
    #[arg(long, value_name = "M/S2", value_parser = positive)]
    pub air: Option<f64>,
    /// Seed of noise and disturbances.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = whole::<u64>)]
    pub seed: u64,
    /// Where to write the waypoints (CSV with t,x,y,z,yaw).
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Replace files that are there already.
    #[arg(long)]
    pub force: bool,
    /// Print everything as JSON.
    #[arg(long)]
    pub json: bool,
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::Args;
    use crate::scene::SCENES;

    /// Arguments of a command and of those under it that name a scene, with their help.
    fn scenes_of(command: &clap::Command) -> Vec<(String, String)> {
        let help = |arg: &clap::Arg| arg.get_help().map(ToString::to_string).unwrap_or_default();
        let own = command.get_arguments().filter(|arg| help(arg).starts_with("Scene: "));
        let own = own.map(|arg| (format!("{} {}", command.get_name(), arg.get_id()), help(arg)));
        own.chain(command.get_subcommands().flat_map(scenes_of)).collect()
    }

    #[test]
    fn help_names_the_scenes_that_there_are() {
        let found = scenes_of(&Args::command());
        let names: Vec<&str> = found.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["fly scene", "depth scene", "sitl scene", "lint file", "bench scene"]);
        let known = format!("({})", SCENES.join(", "));
        for (name, help) in &found {
            assert!(help.contains(&known), "{name}: expected {known} in {help:?}");
        }
    }
}
