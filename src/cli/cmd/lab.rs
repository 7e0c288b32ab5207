//! `propwash lab`: the way from a log to a better vehicle file, in the browser.

use crate::Result;
use crate::cli::exit::Outcome;
use crate::cli::lab_args::LabArgs;

/// Runs the command.
#[cfg(feature = "lab")]
pub fn run(args: &LabArgs) -> Result<Outcome> {
    use crate::lab::{Lab, Options};

    let options = Options {
        logs: args.logs.clone(),
        vehicle: args.vehicle.clone(),
        scene: args.scene.clone(),
        port: args.port,
    };
    let lab = super::super::progress::waiting("starting", || Lab::bind(options))?;
    let address = lab.address();
    super::print(format_args!("lab  {address}\n     this address is for you alone; Ctrl-C ends the lab"))?;
    if !args.no_open {
        super::view::start(address.as_ref())?;
    }
    lab.run()?;
    super::print("the lab has ended")?;
    Ok(Outcome::Fine)
}

/// Says that this build has none.
#[cfg(not(feature = "lab"))]
pub fn run(_: &LabArgs) -> Result<Outcome> {
    Err(crate::Error::Usage {
        flag: "lab",
        expected: "the program `propwash` (cargo build, or its archive), which brings the lab's server"
            .into(),
        got: "the Python package, which is built without; in notebooks propwash.Lab has the same verbs"
            .into(),
    })
}
