//! `propwash export`: a vehicle's equations in another language.

use super::drones::find;
use super::print;
use crate::Result;
use crate::cli::args::ExportArgs;
use crate::cli::exit::Outcome;
use crate::cli::output;
use crate::export::text::Language;
use crate::flight::files;
use crate::physics::controllers::ControlMode;
use crate::rollout::RolloutError;
use crate::rollout::function::{Asked, What, function};
use std::io::Write as _;

/// Runs the command.
pub fn run(args: &ExportArgs) -> Result<Outcome> {
    output::check(&[("--out", args.out.as_deref())], args.force)?;
    let vehicle = find(&args.vehicle)?;
    let wrong = |name, expected: &[&str], got: &str| RolloutError::Option {
        name,
        expected: expected.join(", "),
        got: got.to_string(),
    };
    let modes = ControlMode::ALL.map(ControlMode::name);
    let control = ControlMode::ALL
        .into_iter()
        .find(|mode| mode.name() == args.control)
        .ok_or_else(|| wrong("control", &modes, &args.control))?;
    let (whats, languages) = (What::ALL.map(|(name, _)| name), Language::ALL.map(|(name, _)| name));
    let asked = Asked {
        what: What::named(&args.what).ok_or_else(|| wrong("what", &whats, &args.what))?,
        dynamics: args.dynamics.clone(),
        control,
        integrator: args.integrator.unwrap_or_default(),
        sim_hz: args.freq,
        parameters: args.parameters.clone(),
        surroundings: args.surroundings,
    };
    let language = Language::named(&args.to).ok_or_else(|| wrong("to", &languages, &args.to))?;
    let text = function(&vehicle, &asked)?.print(language);
    match &args.out {
        Some(path) => {
            let written = files::write(path, args.force, |file| file.write_all(text.as_bytes()));
            written.map_err(|e| output::refused("--out", path, e))?;
            print(format_args!("wrote {}", path.display()))?;
        }
        None => print(format_args!("{}", text.trim_end()))?,
    }
    Ok(Outcome::Fine)
}
