//! `propwash vehicle new`: a first vehicle file from mass, arm and flights.

use super::diagnose::refuse_log;
use super::{print, print_json};
use crate::cli::args::{LayoutArg, VehicleNewArgs};
use crate::cli::exit::Outcome;
use crate::cli::output;
use crate::cli::progress::waiting;
use crate::gap::first_flight::first_vehicle;
use crate::vehicle::first::{Given, Layout};
use crate::{Error, Result};
use serde_json::json;

/// Runs the command.
pub(super) fn run(args: &VehicleNewArgs) -> Result<Outcome> {
    refuse_log("--out", Some(&args.out), &args.from_log, &[])?;
    output::check(&[("--out", Some(&args.out))], args.force)?;
    let given = given(args)?;
    let name = args.out.file_stem().map_or_else(|| "vehicle".into(), |s| s.to_string_lossy().into_owned());
    let (vehicle, told) =
        waiting("looking", || first_vehicle(&given, &args.from_log, args.mapping.as_deref(), &name))?;
    output::write("--out", &args.out, vehicle.to_toml().as_bytes(), args.force)?;
    if args.json {
        print_json(&json!({ "file": args.out, "vehicle": told }))?;
        return Ok(Outcome::Fine);
    }
    print(format_args!("wrote {}", args.out.display()))?;
    print(told.to_string().trim_end())?;
    print(format_args!("\nnext: propwash compare LOG --vehicle {}", args.out.display()))?;
    Ok(Outcome::Fine)
}

fn given(args: &VehicleNewArgs) -> Result<Given> {
    let inertia_kg_m2 = match &args.inertia {
        None => None,
        Some(list) => Some(<[f64; 3]>::try_from(&list[..]).map_err(|_| Error::Usage {
            flag: "--inertia",
            expected: "three numbers X,Y,Z in kg·m²".into(),
            got: format!("{} of them", list.len()),
        })?),
    };
    Ok(Given {
        mass_kg: args.mass,
        mass_sigma_kg: args.mass_sigma,
        arm_m: args.arm,
        rotors: args.rotors,
        layout: match args.layout {
            LayoutArg::X => Layout::X,
            LayoutArg::Plus => Layout::Plus,
        },
        first_clockwise: args.first_clockwise,
        radius_m: args.radius,
        inertia_kg_m2,
        thrust_to_weight: args.thrust_to_weight,
    })
}
