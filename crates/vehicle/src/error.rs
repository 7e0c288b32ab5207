//! What can go wrong with a vehicle.

use propwash_trace::names::of_list;
use std::path::PathBuf;

/// Errors of vehicle files and of URDF import. Each says what was expected, what was found, where, and what to do.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum VehicleError {
    /// A file could not be read.
    #[error("{}: cannot be read ({reason}): check the path and its permissions", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        reason: String,
    },
    /// No vehicle of that name is built in.
    #[error(
        "no built-in vehicle is called `{name}`: expected one of {known}; a vehicle file of your own is loaded by its path{}",
        of_list(name, known)
    )]
    UnknownVehicle {
        /// The name asked for.
        name: String,
        /// Names of the built-in vehicles.
        known: String,
    },
    /// No dynamics of that name exist.
    #[error(
        "no dynamics are called `{name}`: expected one of {known}; correct the name{}",
        of_list(name, known)
    )]
    UnknownDynamics {
        /// The name asked for.
        name: String,
        /// Names of the dynamics.
        known: String,
    },
    /// The text is no TOML, or its keys and types are not those of a vehicle file.
    #[error("{file}, line {line}: {message}\n  {excerpt}\n{remedy}")]
    Text {
        /// File or name of the vehicle.
        file: String,
        /// Line, from 1.
        line: usize,
        /// What was expected and what was found.
        message: String,
        /// The line itself.
        excerpt: String,
        /// What to do.
        remedy: String,
    },
    /// A value is missing or cannot be.
    #[error("{file}: `{key}`: expected {expected}, found {found}: {remedy}")]
    Value {
        /// File or name of the vehicle.
        file: String,
        /// Key in a vehicle file, element in a URDF.
        key: String,
        /// What would be right.
        expected: String,
        /// What stands there.
        found: String,
        /// What to do.
        remedy: String,
    },
}

impl VehicleError {
    /// A missing or impossible value.
    pub(super) fn value(
        file: &str,
        key: impl Into<String>,
        expected: impl Into<String>,
        found: impl ToString,
        remedy: impl Into<String>,
    ) -> Self {
        Self::Value {
            file: file.into(),
            key: key.into(),
            expected: expected.into(),
            found: found.to_string(),
            remedy: remedy.into(),
        }
    }
}
