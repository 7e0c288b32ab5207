//! How do I get a flight log in which an effect is hidden that the vehicle file does not know?
//!
//! The flight is made by equations, a controller and sensors that are independent of the simulator
//! (`tests/common/planted`); the vehicle differs from its file by tolerances of manufacture as well. Same arguments, same
//! bytes.
//! `cargo run --release --example hidden_flight -- --effect rotor_drag,payload --seed 3 --out flight.csv --truth truth.json`

#[path = "../tests/common/planted/mod.rs"]
mod planted;

use clap::{Parser, ValueEnum};
use planted::{Build, Excitation, Flight, Inputs, Marker, NoiseLevel, Plan, Sensors};
use propwash::vehicle::Vehicle;
use std::path::PathBuf;
use std::process::ExitCode;

/// The vehicle whose flights these are, unless another is named.
const VEHICLE: &str = include_str!("../tests/data/planted_quad.toml");

#[derive(Parser)]
#[command(about = "Writes a flight log in which effects are hidden that the vehicle file does not know")]
struct Args {
    /// Ids of the hidden effects, separated by commas, or `none`; --list names them all.
    #[arg(long, default_value = "none", value_delimiter = ',')]
    effect: Vec<String>,
    /// The vehicle: tolerances, and signs and sizes of the effects.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Number of the flight with this vehicle: track, turbulence and noise.
    #[arg(long, default_value_t = 0)]
    flight: u64,
    /// Length, s.
    #[arg(long, default_value_t = 50.0)]
    seconds: f64,
    /// What the pilot does; the exciting flight in which the effects can be seen if absent.
    #[arg(long)]
    excitation: Option<String>,
    /// How good the sensors and how calm the air are.
    #[arg(long, default_value = "fine")]
    noise: Level,
    /// What of the log drives the model, in place of rotor commands: measured rotor speeds, thrust, or attitude commands.
    #[arg(long, default_value = "commands")]
    inputs: Drive,
    /// Tolerances, mounts and clocks that do not know the priors of the diagnosis.
    #[arg(long)]
    fair: bool,
    /// Vehicle file: four to eight rotors, no filed effect but linear drag; an invented quadrotor of 0.75 kg if absent.
    #[arg(long)]
    vehicle: Option<PathBuf>,
    /// What is not logged.
    #[arg(long, value_delimiter = ',')]
    without: Vec<Channel>,
    /// Log measured rotor speeds too.
    #[arg(long)]
    rotors: bool,
    /// The position system follows the airframe instead of the true centre of mass.
    #[arg(long)]
    marker_on_airframe: bool,
    /// Time of the log at which the effects come, s; they are there from the beginning if absent.
    #[arg(long)]
    begins: Option<f64>,
    /// Size of the effects: 1 as drawn.
    #[arg(long, default_value_t = 1.0)]
    size: f64,
    /// Where to write the log (CSV).
    #[arg(long, required_unless_present = "list")]
    out: Option<PathBuf>,
    /// Where to write what was hidden (JSON).
    #[arg(long)]
    truth: Option<PathBuf>,
    /// Where to write the vehicle file that the log belongs to.
    #[arg(long)]
    vehicle_out: Option<PathBuf>,
    /// Name all effects and excitations.
    #[arg(long)]
    list: bool,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Level {
    Fine,
    Rough,
    Filtered,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Drive {
    Commands,
    Rotors,
    Thrust,
    Attitude,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Channel {
    Poses,
    Gyro,
    Accel,
    Commands,
    Battery,
    References,
    Load,
}

fn main() -> ExitCode {
    match run(&Args::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(sentence) => {
            eprintln!("error: {sentence}");
            ExitCode::FAILURE
        }
    }
}

/// Names all effects and excitations.
fn list() {
    println!("effects: {}", planted::HIDDEN.join(" "));
    println!("effects of vehicles with more than four rotors: {}", planted::MORE_ROTORS.join(" "));
    println!("effects that no list of candidates has: {}", planted::UNLISTED.join(" "));
    println!("effects that no formula has: {}", planted::RUGGED.join(" "));
    let names: Vec<&str> = Excitation::ALL.iter().map(|(name, _)| *name).collect();
    println!("excitations: {}", names.join(" "));
}

/// What the arguments ask for.
fn plan_of<'a>(args: &Args, vehicle: &'a Vehicle) -> Result<Plan<'a>, String> {
    if !(args.size >= 0.0 && args.size <= 3.0) {
        return Err(format!("expected a size from 0 to 3, found {}: give another --size", args.size));
    }
    if let Some(t) = args.begins.filter(|t| !(*t > 0.0 && *t < args.seconds)) {
        let most = args.seconds;
        return Err(format!("expected a time between 0 and {most} s, found {t}: give another --begins"));
    }
    let mut hidden = Vec::new();
    if args.effect != ["none"] {
        for name in &args.effect {
            hidden.push(planted::id(name)?);
        }
    }
    let mut plan = Plan::exciting(vehicle, &hidden, args.seconds, args.seed);
    if let Some(name) = &args.excitation {
        plan.excitation = Excitation::by_name(name)?;
    }
    let with = |channel| !args.without.contains(&channel);
    let driven = Sensors::with(match args.inputs {
        Drive::Commands => Inputs::Commands,
        Drive::Rotors => Inputs::Rotors,
        Drive::Thrust => Inputs::Thrust,
        Drive::Attitude => Inputs::Attitude,
    });
    if args.fair {
        plan.build = Build::fair(args.seed);
    }
    plan.sensors = Sensors {
        poses: with(Channel::Poses),
        gyro: with(Channel::Gyro),
        accel: with(Channel::Accel),
        commands: driven.commands && with(Channel::Commands),
        battery: with(Channel::Battery),
        references: with(Channel::References),
        load: with(Channel::Load),
        rotors: driven.rotors || args.rotors,
        ..driven
    };
    plan.flight = args.flight;
    plan.size = args.size;
    plan.begins_s = args.begins;
    plan.noise = match args.noise {
        Level::Fine => NoiseLevel::Fine,
        Level::Rough => NoiseLevel::Rough,
        Level::Filtered => NoiseLevel::Filtered,
    };
    if args.marker_on_airframe {
        plan.marker = Marker::Airframe;
    }
    Ok(plan)
}

/// Writes the files that were asked for: log, truth, vehicle.
fn write(args: &Args, flight: &Flight, vehicle: &Vehicle) -> Result<(), String> {
    let write = |path: &PathBuf, text: &str| {
        std::fs::write(path, text)
            .map_err(|e| format!("expected to write {}, but {e}: choose another place", path.display()))
    };
    if let Some(path) = &args.out {
        write(path, flight.csv())?;
        println!("{}: {} rows, {} s", path.display(), flight.csv().lines().count() - 1, args.seconds);
    }
    if let Some(path) = &args.truth {
        let text = serde_json::to_string_pretty(&flight.truth).map_err(|e| e.to_string())?;
        write(path, &text)?;
        println!("{}: what was hidden", path.display());
    }
    if let Some(path) = &args.vehicle_out {
        write(path, vehicle.to_toml())?;
        println!("{}: the vehicle as filed", path.display());
    }
    Ok(())
}

fn run(args: &Args) -> Result<(), String> {
    if args.list {
        list();
        return Ok(());
    }
    let vehicle = match &args.vehicle {
        Some(path) => Vehicle::load(path),
        None => Vehicle::from_toml("planted_quad", VEHICLE),
    }
    .map_err(|e| e.to_string())?;
    let flight = planted::fly(&plan_of(args, &vehicle)?)?;
    write(args, &flight, &vehicle)?;
    if flight.truth.size < args.size {
        println!(
            "hidden effects are {:.0} % as large as drawn; more could not be flown",
            100.0 * flight.truth.size
        );
    }
    Ok(())
}
