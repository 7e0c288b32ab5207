//! Errors of Rust as exceptions of Python. The words stay as they are.

use propwash::arena::ArenaError;
use propwash::env::EnvError;
use propwash::rollout::RolloutError;
use propwash::scene::SceneError;
use propwash::sense::SenseError;
use propwash::vehicle::VehicleError;
use pyo3::create_exception;
use pyo3::exceptions::{
    PyFileNotFoundError, PyIndexError, PyKeyError, PyOSError, PyRuntimeError, PyValueError,
};
use pyo3::prelude::*;
use serde::de::DeserializeOwned;
use serde_json::Value;

create_exception!(
    propwash,
    Error,
    PyRuntimeError,
    "Something that failed while Propwash worked, or that cannot be done in the present state."
);

/// What has words of its own and a kind in Python.
pub trait IntoPython {
    /// The exception.
    fn into_python(self) -> PyErr;
}

impl IntoPython for VehicleError {
    fn into_python(self) -> PyErr {
        match self {
            VehicleError::Read { .. } => PyOSError::new_err(self.to_string()),
            _ => PyValueError::new_err(self.to_string()),
        }
    }
}

impl IntoPython for RolloutError {
    fn into_python(self) -> PyErr {
        let words = self.to_string();
        match self {
            RolloutError::NoStage { .. } | RolloutError::NoParameter { .. } => PyKeyError::new_err(words),
            _ => PyValueError::new_err(words),
        }
    }
}

impl IntoPython for SceneError {
    fn into_python(self) -> PyErr {
        let words = self.to_string();
        match self {
            SceneError::Read { .. } => PyOSError::new_err(words),
            SceneError::NoSuchScene { .. } => PyFileNotFoundError::new_err(words),
            SceneError::NoSuchName { .. } => PyKeyError::new_err(words),
            SceneError::NoSuch { .. } => PyIndexError::new_err(words),
            SceneError::Parse { .. }
            | SceneError::Compile { .. }
            | SceneError::Shell { .. }
            | SceneError::NameClash { .. }
            | SceneError::BadPose { .. }
            | SceneError::Argument { .. } => PyValueError::new_err(words),
            _ => Error::new_err(words),
        }
    }
}

impl IntoPython for SenseError {
    fn into_python(self) -> PyErr {
        match self {
            SenseError::Scene(e) => e.into_python(),
            SenseError::Camera { .. } | SenseError::Shape { .. } | SenseError::Parameter { .. } => {
                PyValueError::new_err(self.to_string())
            }
            _ => Error::new_err(self.to_string()),
        }
    }
}

impl IntoPython for ArenaError {
    fn into_python(self) -> PyErr {
        match self {
            ArenaError::Rollout(e) => e.into_python(),
            ArenaError::Scene(e) => e.into_python(),
            ArenaError::Sense(e) => e.into_python(),
            ArenaError::Vehicle(e) => e.into_python(),
            ArenaError::Option { .. } | ArenaError::Config { .. } | ArenaError::Generate(_) => {
                PyValueError::new_err(self.to_string())
            }
            _ => Error::new_err(self.to_string()),
        }
    }
}

impl IntoPython for EnvError {
    fn into_python(self) -> PyErr {
        match self {
            EnvError::Vehicle(e) => e.into_python(),
            EnvError::Rollout(e) => e.into_python(),
            EnvError::Scene(e) => e.into_python(),
            EnvError::Sense(e) => e.into_python(),
            // What the user's own code raised goes on as it was.
            EnvError::Failed(e) => match e.downcast::<PyErr>() {
                Ok(raised) => *raised,
                Err(e) => Error::new_err(e.to_string()),
            },
            EnvError::Place { .. } | EnvError::Ended { .. } | EnvError::Learn { .. } => {
                Error::new_err(self.to_string())
            }
            _ => PyValueError::new_err(self.to_string()),
        }
    }
}

/// `?` from an error of Rust to an exception.
pub trait OrRaise<T> {
    /// The value, or the exception.
    fn or_raise(self) -> PyResult<T>;
}

impl<T, E: IntoPython> OrRaise<T> for Result<T, E> {
    fn or_raise(self) -> PyResult<T> {
        self.map_err(IntoPython::into_python)
    }
}

/// What the package wrote as JSON, where its user's options stand in it. Errors name the field; places in a text that the user never
/// wrote would say nothing.
///
/// # Errors
/// ValueError for what is not known, or has another form.
pub fn read_json<T: DeserializeOwned>(field: &str, text: &str) -> PyResult<T> {
    let value = serde_json::from_str(text).map_err(|_| {
        PyValueError::new_err(format!("{field}: expected numbers, texts, lists and dicts of finite numbers"))
    })?;
    read_value(field, value)
}

/// As [`read_json`].
///
/// # Errors
/// As there.
pub fn read_value<T: DeserializeOwned>(field: &str, value: Value) -> PyResult<T> {
    serde_json::from_value(value).map_err(|e| PyValueError::new_err(format!("{field}: {e}")))
}
