//! `propwash drones`: which vehicles there are, and every value of one with its source.

use super::{print, print_json};
use crate::Result;
use crate::cli::args::DronesArgs;
use crate::cli::exit::Outcome;
use crate::vehicle::{BUILTIN, Vehicle};
use serde_json::{Value, json};
use std::path::Path;

/// Whether a vehicle is meant by its path, and not by a built-in name.
pub fn is_file(name: &str) -> bool {
    name.ends_with(".toml") || Path::new(name).components().count() > 1
}

/// A built-in vehicle by name, or a vehicle file by path.
pub fn find(name: &str) -> Result<Vehicle> {
    Ok(if is_file(name) { Vehicle::load(name)? } else { Vehicle::builtin(name)? })
}

/// Runs the command.
pub fn run(args: &DronesArgs) -> Result<Outcome> {
    match &args.name {
        Some(name) => show(&find(name)?, args.json)?,
        None => list(args.json)?,
    }
    Ok(Outcome::Fine)
}

fn list(as_json: bool) -> Result<()> {
    let mut rows = Vec::new();
    for name in BUILTIN {
        let vehicle = Vehicle::builtin(name)?;
        let drone = vehicle.drone("first_principles")?;
        let hover = drone.hover_rotor_vel()[0];
        rows.push(json!({
            "name": name,
            "mass_kg": drone.body.mass_kg,
            "rotors": drone.airframe.n_rotors,
            "hover_rad_s": hover,
            "shell": vehicle.shell,
            "dynamics": vehicle.available_dynamics(),
            "effects": drone.effects.iter().map(|e| e.label()).collect::<Vec<_>>(),
            "description": vehicle.file().description,
        }));
    }
    if as_json {
        return print_json(&json!(rows));
    }
    print(format_args!(
        "{:<11} {:>8} {:>6} {:>11}  {:<8} {}",
        "name", "mass kg", "rotors", "hover rad/s", "shell", "description"
    ))?;
    for row in &rows {
        print(format_args!(
            "{:<11} {:>8.4} {:>6} {:>11.0}  {:<8} {}",
            row["name"].as_str().unwrap_or(""),
            row["mass_kg"].as_f64().unwrap_or(f64::NAN),
            row["rotors"].as_u64().unwrap_or(0),
            row["hover_rad_s"].as_f64().unwrap_or(f64::NAN),
            row["shell"].as_str().unwrap_or(""),
            row["description"].as_str().unwrap_or(""),
        ))?;
    }
    print("\npropwash drones NAME shows every value with its unit and source.")
}

fn show(vehicle: &Vehicle, as_json: bool) -> Result<()> {
    let values = vehicle.provenance();
    if as_json {
        return print_json(&json!({
            "name": vehicle.name,
            "shell": vehicle.shell,
            "sha256": vehicle.sha256(),
            "dynamics": vehicle.available_dynamics(),
            "warnings": vehicle.warnings(),
            "values": values,
        }));
    }
    print(format_args!("{}  (shell {}, sha256 {})", vehicle.name, vehicle.shell, &vehicle.sha256()[..16]))?;
    print(format_args!("dynamics: {}", vehicle.available_dynamics().join(", ")))?;
    for warning in vehicle.warnings() {
        print(format_args!("warning: {warning}"))?;
    }
    let mut source = None;
    let mut noted = None;
    for value in values {
        if source.as_ref() != Some(&value.source) {
            print(format_args!("\nsource: {}", value.source.as_deref().unwrap_or("not stated")))?;
            source = Some(value.source.clone());
            noted = None;
        }
        let number = serde_json::to_value(&value.value).unwrap_or(Value::Null);
        let unit = value.unit.map_or(String::new(), |u| format!(" {u}"));
        let sigma = value.sigma.map_or(String::new(), |s| format!("  (sigma {s})"));
        print(format_args!("  {:<52} {number}{unit}{sigma}", value.key))?;
        // A note that holds for several values in a row is said once.
        if value.note != noted
            && let Some(note) = &value.note
        {
            print(format_args!("    note: {note}"))?;
        }
        noted = value.note;
    }
    Ok(())
}
