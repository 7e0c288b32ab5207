//! `propwash vehicle`: what differs between two vehicles; and the reading and writing of vehicle files that commands
//! change.

use super::drones::{find, is_file};
use super::{io_error, print, print_json};
use crate::Result;
use crate::cli::args::{VehicleArgs, VehicleCommand, VehicleDiffArgs};
use crate::cli::exit::{Outcome, warn};
use crate::gap::accept;
use crate::physics::effects::AnyEffect;
use crate::vehicle::effects::named_parameters;
use crate::vehicle::{EffectDiff, ParameterDiff, Vehicle, VehicleDiff, diff};
use serde_json::json;
use std::path::Path;

/// Runs the command.
pub fn run(args: &VehicleArgs) -> Result<Outcome> {
    match &args.command {
        VehicleCommand::Diff(a) => compare(a),
        VehicleCommand::New(a) => super::vehicle_new::run(a),
        VehicleCommand::Throttle(a) => super::vehicle_throttle::run(a),
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
        rows(&told(effect))?;
    }
    Ok(())
}

/// What is worth a line of an effect: of one that was added or removed not what it leaves as it is without a deviation, such as the factors
/// of rotors that the vehicle has not. Unless that is all.
fn told(effect: &EffectDiff) -> Vec<ParameterDiff> {
    let whole = AnyEffect::by_kind(&effect.kind).map(|e| named_parameters(&e)).unwrap_or_default();
    let idle = |p: &&ParameterDiff| {
        let value = p.new.or(p.old);
        let default = whole.iter().find(|(name, _)| *name == p.name).map(|(_, v)| *v);
        effect.change != "changed" && p.new_sigma.or(p.old_sigma).is_none() && value == default
    };
    let telling: Vec<ParameterDiff> = effect.parameters.iter().filter(|p| !idle(p)).cloned().collect();
    if telling.is_empty() { effect.parameters.clone() } else { telling }
}

/// One line per number: name, old, new, unit, change.
fn rows(parameters: &[ParameterDiff]) -> Result<()> {
    let value = |v: Option<f64>, sigma: Option<f64>| match (v, sigma) {
        (None, _) => "-".to_string(),
        (Some(v), None) => short(v),
        (Some(v), Some(s)) => interval(v, s),
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

/// A value in the digits that its standard deviation leaves, two of the deviation, or as it stands in the file where that is shorter.
fn interval(v: f64, sigma: f64) -> String {
    let whole = format!("{} ± {}", short(v), short(sigma));
    if !(sigma.is_finite() && sigma > 0.0) {
        return whole;
    }
    let rounded = rounded_interval(v, sigma);
    if rounded.chars().count() < whole.chars().count() { rounded } else { whole }
}

fn rounded_interval(v: f64, sigma: f64) -> String {
    // The place of the second digit after rounding: 0.0996 has it at 0.001.
    let rounded = format!("{sigma:.1e}");
    let exponent: i32 = rounded.split_once('e').and_then(|(_, e)| e.parse().ok()).unwrap_or(0);
    let size = v.abs().max(sigma);
    if (1e-3..1e6).contains(&size) {
        let decimals = usize::try_from(1 - exponent).unwrap_or(0);
        return format!("{v:.decimals$} ± {sigma:.decimals$}");
    }
    let leading = size.log10().floor() as i32;
    let decimals = usize::try_from(leading - exponent + 1).unwrap_or(0);
    let by = 10f64.powi(-leading);
    format!("({:.decimals$} ± {:.decimals$})e{leading}", v * by, sigma * by)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fitted_values_have_the_digits_that_are_known() {
        assert_eq!(interval(0.20059267, 0.0032037245), "0.2006 ± 0.0032");
        assert_eq!(interval(6.4913646e-5, 1.3779378e-6), "(6.49 ± 0.14)e-5");
        assert_eq!(interval(8.2754947e-5, 7.3675177e-4), "(0.8 ± 7.4)e-4");
        assert_eq!(interval(0.98738092, 0.0996), "0.99 ± 0.10");
        assert_eq!(interval(-1234.5678, 321.987), "-1235 ± 322");
        // What a person wrote stays as it was written.
        assert_eq!(interval(0.0361, 0.0002), "0.0361 ± 0.0002");
        assert_eq!(interval(0.25, 0.0), "0.25 ± 0");
    }
}
