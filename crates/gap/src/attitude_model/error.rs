//! Errors of identifying the attitude model.

use propwash_vehicle::VehicleError;
use std::path::PathBuf;

/// Errors of the identification. Each says what was expected, what was found, where, and what to do.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum AttitudeModelError {
    /// The log cannot be used for this model.
    #[error("{}: expected {expected}, found {found}: {remedy}", path.display())]
    Log {
        /// The log.
        path: PathBuf,
        /// What the identification needs.
        expected: String,
        /// What the log has.
        found: String,
        /// What to do.
        remedy: String,
    },
    /// An axis was not excited enough, and the vehicle file has no gains to hold it at.
    #[error(
        "{}: the {axis} axis was not excited enough to identify its response ({found}), and the vehicle file has no attitude \
         response to hold it at: fly steps or a multi-sine of several degrees in {axis}", path.display()
    )]
    NotExcited {
        /// The log.
        path: PathBuf,
        /// roll, pitch, yaw.
        axis: &'static str,
        /// How much it moved.
        found: String,
    },
    /// The model does not describe the log.
    #[error("{}: the attitude model does not fit this log: {reason}: {remedy}", path.display())]
    Unfit {
        /// The log.
        path: PathBuf,
        /// What came out of the fit.
        reason: String,
        /// What to do.
        remedy: String,
    },
    /// The name of the vehicle file to write.
    #[error("out: expected a file name that ends in .toml, got {}", path.display())]
    Out {
        /// The name.
        path: PathBuf,
    },
    /// Unknown variant of the model.
    #[error(
        "no attitude model is called `{name}`: expected one of so_rpy, so_rpy_rotor, so_rpy_rotor_drag; correct the name"
    )]
    Dynamics {
        /// The requested name.
        name: String,
    },
    /// Error of the vehicle file.
    #[error(transparent)]
    Vehicle(Box<VehicleError>),
}

impl From<VehicleError> for AttitudeModelError {
    fn from(error: VehicleError) -> Self {
        Self::Vehicle(Box::new(error))
    }
}
