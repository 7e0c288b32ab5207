//! `propwash urdf`: a vehicle file and a shell, or an obstacle, from a URDF.

use super::{io_error, print};
use crate::Result;
use crate::cli::args::UrdfArgs;
use crate::cli::exit::Outcome;
use crate::vehicle::urdf::{UrdfOptions, from_urdf, obstacle_from_urdf};
use std::path::Path;

/// Runs the command.
pub fn run(args: &UrdfArgs) -> Result<Outcome> {
    let options = UrdfOptions {
        search: args.search.clone(),
        name: args.name.clone(),
        controller_from: args.controller_from.clone(),
        ..UrdfOptions::default()
    };
    let stem = args.file.file_stem().map_or_else(|| "urdf".into(), |s| s.to_string_lossy().into_owned());
    let name = args.name.clone().unwrap_or(stem);
    std::fs::create_dir_all(&args.out).map_err(io_error(&args.out))?;
    let write = |path: &Path, text: &str| -> Result<()> {
        std::fs::write(path, text).map_err(io_error(path))?;
        print(format_args!("wrote {}", path.display()))
    };
    let warnings = if args.obstacle {
        let obstacle = obstacle_from_urdf(&args.file, &options)?;
        write(&args.out.join(format!("{name}.xml")), &obstacle.mjcf)?;
        obstacle.warnings
    } else {
        let import = from_urdf(&args.file, &options)?;
        write(&args.out.join(format!("{name}.xml")), &import.shell_mjcf)?;
        if let Some(toml) = &import.vehicle_toml {
            write(&args.out.join(format!("{name}.toml")), toml)?;
        }
        import.warnings
    };
    for warning in warnings {
        eprintln!("warning: {warning}");
    }
    Ok(Outcome::Fine)
}
