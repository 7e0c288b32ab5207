//! Flags of `propwash sitl`.

use super::args::{described, list, not_negative, numbers, positive, triple, whole};
use crate::arena::SensorConfig;
use crate::autopilot::Stack;
use crate::sitl::ThrottleLaw;
use clap::{Args as ClapArgs, ValueEnum};
use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;

/// Ends the help of `propwash sitl`.
pub const SITL_EXAMPLES: &str = "\
Examples:
  propwash sitl hb_x500 --stack px4                   PX4 connects to TCP 4560
  propwash sitl quad.toml --stack ardupilot --scene forest --sensor range_finder
                                                      ArduPilot with --model JSON:127.0.0.1
  propwash sitl cf2x_L250 --stack betaflight --record flight.csv
  propwash sitl hb_x500 --stack px4 --home 52.52,13.4,34 --speed 0 --seconds 60

The stack runs the controller; the vehicle, the world and the sensors are simulated, in lockstep. It
starts on the ground, level, facing north, which is the world's x axis. docs/sitl.md says how each
stack is started and what was tested. Ctrl-C ends it. Units are SI; angles are in degrees.";

/// The flight stacks.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum StackArg {
    /// PX4: HIL messages of MAVLink over TCP.
    Px4,
    /// ArduPilot: its JSON interface over UDP.
    Ardupilot,
    /// Betaflight: the packets of its SITL over UDP.
    Betaflight,
}

impl From<StackArg> for Stack {
    fn from(arg: StackArg) -> Self {
        match arg {
            StackArg::Px4 => Self::Px4,
            StackArg::Ardupilot => Self::ArduPilot,
            StackArg::Betaflight => Self::Betaflight,
        }
    }
}

/// What commands mean.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum ThrottleArg {
    /// Rotor speed in proportion to the command.
    Speed,
    /// Thrust in proportion to the command.
    Thrust,
    /// The [throttle] of the vehicle file.
    Vehicle,
}

impl From<ThrottleArg> for ThrottleLaw {
    fn from(arg: ThrottleArg) -> Self {
        match arg {
            ThrottleArg::Speed => Self::Speed,
            ThrottleArg::Thrust => Self::Thrust,
            ThrottleArg::Vehicle => Self::Vehicle,
        }
    }
}

/// `propwash sitl`.
#[derive(Clone, Debug, ClapArgs)]
pub struct SitlArgs {
    /// Vehicle: a built-in name or a vehicle file.
    #[arg(value_name = "VEHICLE")]
    pub vehicle: String,
    /// The flight stack that flies it.
    #[arg(long, value_enum)]
    pub stack: StackArg,
    /// Scene: the name of one that comes with Propwash (corridor, forest, meshes, room, terrain, zoo), or an MJCF file.
    /// Default: level ground
    #[arg(long, value_name = "NAME|FILE")]
    pub scene: Option<PathBuf>,
    /// The vehicle starts on what is below this point, m, world. Default: 0,0,1
    #[arg(long, value_name = "X,Y,Z", value_parser = triple, allow_hyphen_values = true)]
    pub start: Option<[f64; 3]>,
    /// Where its nose points at the start, degrees from north to the east. Default: 0
    #[arg(long, value_name = "DEG", allow_hyphen_values = true)]
    pub heading: Option<f64>,
    /// Address at which to listen, of IPv4 or IPv6. Default: 127.0.0.1, this machine alone
    #[arg(long, value_name = "IP")]
    pub address: Option<IpAddr>,
    /// Port; 0 for any that is free. Default: 4560 (TCP) for PX4, 9002 (UDP) for the others
    #[arg(long, value_name = "N", value_parser = whole::<u16>)]
    pub port: Option<u16>,
    /// Where Betaflight hears states; it hears sticks at the next port. Default: 127.0.0.1:9003
    #[arg(long, value_name = "IP:PORT")]
    pub firmware: Option<SocketAddr>,
    /// Exchanges per second. Default: 250 for PX4, 1000 for Betaflight, for ArduPilot what it asks for
    #[arg(long, value_name = "HZ", value_parser = whole::<u32>)]
    pub rate: Option<u32>,
    /// Steps of the simulation in each exchange. Default: as many as it needs for 1000 Hz
    #[arg(long, value_name = "N", value_parser = whole::<u32>)]
    pub substeps: Option<u32>,
    /// Where on Earth it starts: latitude and longitude, degrees, height above the sea, m. Default: 47.397742,8.545594,488
    #[arg(long, value_name = "LAT,LON,ALT", value_parser = numbers::<3>, allow_hyphen_values = true)]
    pub home: Option<[f64; 3]>,
    /// Seed of all random numbers. Default: 0
    #[arg(long, value_name = "N", value_parser = whole::<u64>)]
    pub seed: Option<u64>,
    /// Simulated seconds for each second, at most; 0: as fast as the stack answers. Default: 1
    #[arg(long, value_name = "FACTOR", value_parser = not_negative)]
    pub speed: Option<f64>,
    /// How long the stack may say nothing once it has begun, s; 0 is for ever. Default: 30
    #[arg(long, value_name = "S", value_parser = not_negative)]
    pub timeout: Option<f64>,
    /// What a command of 0 to 1 means. Default: the [throttle] of the vehicle file where it has one, else speed
    #[arg(long, value_enum)]
    pub throttle: Option<ThrottleArg>,
    /// Rotor speed at full power, rad/s. Default: that of the greatest thrust in the vehicle file
    #[arg(long, value_name = "RAD_S", value_parser = positive)]
    pub max_speed: Option<f64>,
    /// For each motor of the stack, from the first one, the rotor of the vehicle that it drives, from 0. Default: by where rotors stand
    /// and how they turn
    #[arg(long, value_name = "LIST", value_parser = list::<usize>)]
    pub motors: Option<std::vec::Vec<usize>>,
    /// Pulse widths of ArduPilot's outputs at no and at full power, µs. Default: 1000,2000
    #[arg(long, value_name = "LOW,HIGH", value_parser = list::<u16>)]
    pub pulses: Option<std::vec::Vec<u16>>,
    /// Errors of the sensors (TOML, docs/sitl.md). Default: those of a small autopilot for PX4, none for the others
    #[arg(long, value_name = "FILE", conflicts_with = "no_noise")]
    pub noise: Option<PathBuf>,
    /// Sensors without errors.
    #[arg(long)]
    pub no_noise: bool,
    /// A range finder for ArduPilot, and its fields (docs/sensors.md), such as range_finder:range_m=10. Repeat it for more
    #[arg(long, value_name = "KIND[:KEY=VALUE,...]", value_parser = described::<SensorConfig>)]
    pub sensor: Vec<SensorConfig>,
    /// Ends after so much simulated time, s. Default: never
    #[arg(long, value_name = "S", value_parser = positive)]
    pub seconds: Option<f64>,
    /// When PX4 closes the connection, put the vehicle back and wait for it again.
    #[arg(long)]
    pub again: bool,
    /// Write what flies as a log (CSV, docs/logs.md).
    #[arg(long, value_name = "FILE")]
    pub record: Option<PathBuf>,
    /// Replace the file of --record if there is one.
    #[arg(long)]
    pub force: bool,
    /// Print a JSON summary at the end in place of text.
    #[arg(long)]
    pub json: bool,
}
