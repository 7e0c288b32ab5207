//! Vehicles: files of numbers with units and sources, read into the parameters of [`propwash_physics`].
//!
//! ```
//! use propwash_vehicle::Vehicle;
//! let vehicle = Vehicle::builtin("cf2x_L250")?;
//! let drone = vehicle.drone("first_principles")?;
//! assert_eq!(drone.body.mass_kg, 0.0328);
//! assert_eq!(vehicle.shell, "cf2x");
//! # Ok::<(), propwash_vehicle::VehicleError>(())
//! ```

#![forbid(unsafe_code)]

mod diff;
pub mod effects;
mod error;
pub mod expression;
mod file;
pub mod first;
mod mixer;
pub mod network;
pub mod provenance;
pub mod schema;
mod similar;
pub mod urdf;

pub use diff::{EffectDiff, ParameterDiff, VehicleDiff, diff};
pub use error::VehicleError;
pub use provenance::Provenance;
pub use schema::VehicleFile;

use propwash_physics::controllers::{ControlMode, Rates};
use propwash_physics::drone::{Drone, Dynamics};
use sha2::{Digest, Sha256};
use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};

const SO_RPY: &str = "so_rpy";

/// Names of the dynamics: rotors by first principles, and three settings of the abstracted attitude response.
pub const DYNAMICS: [&str; 4] = ["first_principles", SO_RPY, "so_rpy_rotor", "so_rpy_rotor_drag"];

macro_rules! builtin {
    ($($name:literal,)*) => {
        /// Names of the built-in vehicles, whose files are in `params/`.
        pub const BUILTIN: &[&str] = &[$($name),*];

        fn builtin_text(name: &str) -> Option<&'static str> {
            match name {
                $($name => Some(include_str!(concat!("../../../params/", $name, ".toml"))),)*
                _ => None,
            }
        }
    };
}

builtin! {
    "cf2x_L250",
    "cf2x_P250",
    "cf2x_T350",
    "cf21B_500",
    "hb_x500",
}

/// One vehicle: its file, checked, and what follows from it.
#[derive(Clone, Debug, PartialEq)]
pub struct Vehicle {
    /// Name: that of the built-in vehicle, or the file name without its ending.
    pub name: String,
    /// Name of a shell in `xml/shells`, or path of a shell's MJCF file (see [`Vehicle::shell_path`]).
    pub shell: String,
    /// Rates of the on-board controller's stages.
    pub rates: Rates,
    file: VehicleFile,
    contents: file::Contents,
    text: String,
    dir: Option<PathBuf>,
}

/// Size of the largest text that is read, bytes: descriptions of vehicles have some thousands.
const MAX_BYTES: u64 = 16 << 20;

/// The text of a description, a file or what a pipe gives.
fn read_text(path: &Path) -> Result<String, VehicleError> {
    let fault = |reason: String| VehicleError::Read { path: path.into(), reason };
    let file = File::open(path).map_err(|e| fault(e.to_string()))?;
    let mut text = String::new();
    file.take(MAX_BYTES + 1).read_to_string(&mut text).map_err(|e| fault(e.to_string()))?;
    if text.len() as u64 > MAX_BYTES {
        let words = "expected the description of a vehicle; it has more than";
        return Err(fault(format!("{words} {MAX_BYTES} bytes")));
    }
    Ok(text)
}

impl Vehicle {
    /// A built-in vehicle, one of [`BUILTIN`].
    pub fn builtin(name: &str) -> Result<Self, VehicleError> {
        Self::from_toml(name, Self::builtin_file(name)?)
    }

    /// Text of a built-in vehicle's file, with its comments.
    pub fn builtin_file(name: &str) -> Result<&'static str, VehicleError> {
        builtin_text(name)
            .ok_or_else(|| VehicleError::UnknownVehicle { name: name.into(), known: BUILTIN.join(", ") })
    }

    /// A vehicle file (TOML, see `docs/vehicles.md`), with the networks beside it that it names.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, VehicleError> {
        let path = path.as_ref();
        let text = read_text(path)?;
        let name = path.file_stem().map_or_else(|| "vehicle".into(), |s| s.to_string_lossy().into_owned());
        let file = path.display().to_string();
        // A path without a folder is one in the folder of the process.
        let dir = path.parent().unwrap_or(Path::new(""));
        let mut vehicle = Self::build(name, &file, file::parse(&file, &text)?, Some(dir))?;
        vehicle.dir = path.parent().map(Path::to_path_buf);
        Ok(vehicle)
    }

    /// The text of a vehicle file. Networks that it names without their content must have been read before
    /// ([`network::kept`]).
    pub fn from_toml(name: &str, text: &str) -> Result<Self, VehicleError> {
        Self::build(name.into(), name, file::parse(name, text)?, None)
    }

    /// A vehicle from its file's contents, as read before or put together in code.
    pub fn from_file(name: &str, file: VehicleFile) -> Result<Self, VehicleError> {
        Self::build(name.into(), name, file, None)
    }

    /// `dir` is the folder of the file, where it was read from one.
    fn build(
        name: String,
        label: &str,
        mut file: VehicleFile,
        dir: Option<&Path>,
    ) -> Result<Self, VehicleError> {
        network::resolve(label, dir, &mut file)?;
        let contents = file::contents(label, &file)?;
        let text = file::to_text(label, &file)?;
        let r = &file.rates;
        Ok(Self {
            name,
            shell: file.shell.clone(),
            rates: Rates {
                state_hz: r.state_hz,
                attitude_hz: r.attitude_hz,
                body_rate_hz: r.body_rate_hz,
                force_torque_hz: r.force_torque_hz,
            },
            file,
            contents,
            text,
            dir: None,
        })
    }

    /// What the file says, in its own units. A changed copy becomes a vehicle again by [`Vehicle::from_file`].
    pub fn file(&self) -> &VehicleFile {
        &self.file
    }

    /// Motors by throttle and voltage, where the file has `[throttle]`.
    pub fn throttle(&self) -> Option<propwash_physics::throttle::Params<f64>> {
        let t = self.file.throttle.as_ref()?;
        Some(propwash_physics::throttle::Params {
            offset_v: t.offset_v,
            back_emf_v_s_per_rad: t.back_emf_v_s_per_rad,
            load_v_s2_per_rad2: t.load_v_s2_per_rad2,
        })
    }

    /// All parameters in SI for one of [`DYNAMICS`], with the effects that belong to it.
    ///
    /// Errors when the name is none of them, or when the file has no fit for it.
    pub fn drone(&self, dynamics: &str) -> Result<Drone<f64>, VehicleError> {
        let mut drone = self.contents.base.clone();
        drone.dynamics = self.dynamics(dynamics)?;
        let effects = self.contents.effects.iter();
        drone.effects = effects.filter(|e| e.belongs_to(dynamics)).map(|e| e.effect).collect();
        Ok(drone)
    }

    fn dynamics(&self, name: &str) -> Result<Dynamics<f64>, VehicleError> {
        if !DYNAMICS.contains(&name) {
            return Err(VehicleError::UnknownDynamics { name: name.into(), known: DYNAMICS.join(", ") });
        }
        if name == DYNAMICS[0] {
            return Ok(Dynamics::Rotors);
        }
        let fits = &self.contents.responses;
        let fit = fits.iter().find(|(of, _)| *of == name).map(|(_, p)| *p);
        fit.map(Dynamics::AttitudeResponse).ok_or_else(|| {
            let has: Vec<&str> = std::iter::once(DYNAMICS[0]).chain(fits.iter().map(|(of, _)| *of)).collect();
            VehicleError::value(
                &self.name,
                format!("attitude_response.{name}"),
                format!("the fitted attitude response for the dynamics `{name}`"),
                format!("nothing (this vehicle has {})", has.join(", ")),
                "choose dynamics that the vehicle has, or add the table to its file",
            )
        })
    }

    /// Names of those [`DYNAMICS`] for which the file has parameters.
    pub fn available_dynamics(&self) -> Vec<&'static str> {
        DYNAMICS.into_iter().filter(|name| self.dynamics(name).is_ok()).collect()
    }

    /// Control modes that make sense for one of [`DYNAMICS`]: the abstracted response takes attitude commands only, and a
    /// vehicle without a control law takes forces and rotor speeds only.
    pub fn modes(&self, dynamics: &str) -> Result<Vec<ControlMode>, VehicleError> {
        let law = self.file.controller.mellinger.is_some();
        let rotors = matches!(self.dynamics(dynamics)?, Dynamics::Rotors);
        Ok(ControlMode::ALL
            .into_iter()
            .filter(|mode| match mode {
                ControlMode::State => law,
                ControlMode::Attitude => law || !rotors,
                ControlMode::BodyRate => law && rotors,
                ControlMode::ForceTorque => rotors && self.contents.full_rank,
                ControlMode::RotorVel => rotors,
            })
            .collect())
    }

    /// Doubtful but allowed values of the file.
    pub fn warnings(&self) -> &[String] {
        &self.contents.warnings
    }

    /// Every value of the file with its unit, source, note and sigma.
    pub fn provenance(&self) -> Vec<Provenance> {
        provenance::provenance(&self.file)
    }

    /// The file as TOML that reads back equal. Comments of the original are not kept, sources and notes are.
    pub fn to_toml(&self) -> &str {
        &self.text
    }

    /// SHA-256 (hex) of [`Vehicle::to_toml`]: the same for two files that differ in comments and layout only.
    pub fn sha256(&self) -> String {
        Sha256::digest(self.text.as_bytes()).iter().map(|byte| format!("{byte:02x}")).collect()
    }

    /// Path of the shell's MJCF file if `shell` is a path (it ends in `.xml`); relative ones start at the vehicle file.
    pub fn shell_path(&self) -> Option<PathBuf> {
        let path = Path::new(&self.shell);
        let is_path = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("xml"));
        is_path.then(|| self.dir.as_deref().unwrap_or(Path::new("")).join(path))
    }
}

#[cfg(test)]
mod tests;
