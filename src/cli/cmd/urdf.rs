//! `propwash urdf`: a vehicle file and a shell, or an obstacle, from a URDF.

use super::{io_error, print};
use crate::Result;
use crate::cli::args::UrdfArgs;
use crate::cli::exit::{Outcome, warn};
use crate::cli::output;
use crate::vehicle::urdf::{UrdfOptions, from_urdf, obstacle_from_urdf};

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
    let (xml, toml) = (args.out.join(format!("{name}.xml")), args.out.join(format!("{name}.toml")));
    let (files, warnings) = if args.obstacle {
        let obstacle = obstacle_from_urdf(&args.file, &options)?;
        (vec![(xml, obstacle.mjcf)], obstacle.warnings)
    } else {
        let import = from_urdf(&args.file, &options)?;
        let vehicle = import.vehicle_toml.map(|text| (toml, text));
        ([(xml, import.shell_mjcf)].into_iter().chain(vehicle).collect(), import.warnings)
    };
    std::fs::create_dir_all(&args.out).map_err(io_error(&args.out))?;
    // All of them or none.
    for (path, _) in &files {
        output::check(&[("--out", Some(path))], args.force)?;
    }
    for (path, text) in &files {
        output::write("--out", path, text.as_bytes(), args.force)?;
        print(format_args!("wrote {}", path.display()))?;
    }
    for warning in warnings {
        warn(&warning);
    }
    Ok(Outcome::Fine)
}
