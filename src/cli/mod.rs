//! The command line.

mod args;
mod cmd;
mod exit;

use clap::Parser;
use std::process::ExitCode;

/// Parses the command line, runs the command and gives the exit code: 0 fine, 1 a check found a problem, 2 error.
pub fn run() -> ExitCode {
    let args = args::Args::parse();
    let outcome = match args.command {
        args::Command::Fly(a) => cmd::fly::run(&a),
        args::Command::Depth(a) => cmd::depth::run(&a),
        args::Command::Drones(a) => cmd::drones::run(&a),
        args::Command::Scene(a) => cmd::scene::run(&a),
        args::Command::Urdf(a) => cmd::urdf::run(&a),
    };
    exit::code(outcome)
}
