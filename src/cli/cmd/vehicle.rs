//! `propwash vehicle`: what differs between two vehicles; and the reading and writing of vehicle files that commands
//! change.

use super::drones::{find, is_file};
use super::{io_error, print, print_json};
use crate::Result;
use crate::cli::args::{VehicleArgs, VehicleCommand, VehicleDiffArgs};
use crate::cli::exit::{Outcome, warn};
use crate::gap::accept;
use crate::vehicle::{ParameterDiff, Vehicle, VehicleDiff, diff};
use serde_json::json;
use std::path::Path;

/// Runs the command.
pub fn run(args: &VehicleArgs) -> Result<Outcome> {
    match &args.command {
        VehicleCommand::Diff(a) => compare(a),
    }
}

/// The text of a vehicle's file, by a built-in name or a path, with its comments; `name` also labels it in messages.
pub fn text_of(name: &str) -> Result<String> {
    if is_file(name) {
        // Read as a vehicle first, so that a file that is none is refused in the words of all commands.
        Vehicle::load(name)?;
        return crate::flight::files::read_text(Path::new(name)).map_err(io_error(Path::new(name)));
    }
    Ok(Vehicle::builtin_file(name)?.to_string())
}

/// Writes the changed text of vehicle `from` and says so; a shell that is named relative to the file is pointed out when
/// the folder changes.
pub fn save(from: &str, text: &str, out: &Path, force: bool) -> Result<()> {
    accept::write(out, text, force)?;
    let shell = Vehicle::load(out)?.shell_path();
    if let Some(shell) = shell.filter(|shell| !shell.exists()) {
        warn(&format!(
            "the shell of {from} is named relative to its file and is not at {}: copy it there, or write its \
             path into {}",
            shell.display(),
            out.display()
        ));
    }
    print(format_args!("wrote {}", out.display()))
}

fn compare(args: &VehicleDiffArgs) -> Result<Outcome> {
    let found = diff(&find(&args.a)?, &find(&args.b)?);
    if args.json {
        print_json(&json!({ "a": args.a, "b": args.b, "same": found.is_same(), "diff": found }))?;
    } else {
        show(args, &found)?;
    }
    Ok(if found.is_same() { Outcome::Fine } else { Outcome::Found })
}

fn show(args: &VehicleDiffArgs, found: &VehicleDiff) -> Result<()> {
    if found.is_same() {
        return print(format_args!("{} and {} are the same", args.a, args.b));
    }
    print(format_args!("{} → {}", args.a, args.b))?;
    for line in &found.other {
        print(format_args!("  {line}"))?;
    }
    rows(&found.parameters)?;
    for effect in &found.effects {
        let all = effect.dynamics.len() == crate::vehicle::DYNAMICS.len();
        let of = if all { String::new() } else { format!(" in {}", effect.dynamics.join(", ")) };
        print(format_args!("effect {} {}{of}", effect.kind, effect.change))?;
        rows(&effect.parameters)?;
    }
    Ok(())
}

/// One line per number: name, old, new, unit, change.
fn rows(parameters: &[ParameterDiff]) -> Result<()> {
    let value = |v: Option<f64>, sigma: Option<f64>| match (v, sigma) {
        (None, _) => "-".to_string(),
        (Some(v), None) => short(v),
        (Some(v), Some(s)) => format!("{} ± {}", short(v), short(s)),
    };
    let cells: Vec<[String; 4]> = parameters
        .iter()
        .map(|p| {
            let change = p.change_percent.map_or(String::new(), |c| format!("{c:+.2} %"));
            let unit = p.unit.unwrap_or("").to_string();
            [
                p.name.clone(),
                value(p.old, p.old_sigma),
                value(p.new, p.new_sigma),
                format!("{unit}\t{change}"),
            ]
        })
        .collect();
    let width = |i: usize| cells.iter().map(|c| c[i].chars().count()).max().unwrap_or(0);
    let (name, old, new) = (width(0), width(1), width(2));
    for c in &cells {
        let (unit, change) = c[3].split_once('\t').unwrap_or((&c[3], ""));
        let line = format!("  {:<name$}  {:>old$} → {:<new$}  {unit:<10} {change}", c[0], c[1], c[2]);
        print(line.trim_end())?;
    }
    Ok(())
}

/// A number in as many digits as tell it from others, at most eight.
fn short(v: f64) -> String {
    let exact = v.to_string();
    if v == 0.0 || (exact.len() <= 10 && (1e-4..1e6).contains(&v.abs())) {
        return exact;
    }
    let rounded: f64 = format!("{v:.7e}").parse().unwrap_or(v);
    if (1e-3..1e6).contains(&v.abs()) { rounded.to_string() } else { format!("{rounded:e}") }
}
