//! What can go wrong when drones sense.

use crate::geometry::GeometryError;
use crate::scene::SceneError;

/// Errors of cameras, contacts, clearances and swept checks.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SenseError {
    /// The scene or MuJoCo.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A camera cannot give depth as it is.
    #[error("camera '{camera}': {message}")]
    Camera {
        /// Name of the camera.
        camera: String,
        /// What was expected, what was found, what to do.
        message: String,
    },
    /// Buffers or arrays have the wrong size.
    #[error("{what} must have {expected} numbers {shape}, got {found}")]
    Shape {
        /// Which array.
        what: &'static str,
        /// Its shape in words.
        shape: String,
        /// Numbers expected.
        expected: usize,
        /// Numbers found.
        found: usize,
    },
    /// A parameter of a sensor makes no sense.
    #[error("{what}")]
    Parameter {
        /// What was expected, what was found, what to do.
        what: String,
    },
    /// Some worlds of a batch failed; the others are complete.
    #[error("{} of {worlds} worlds failed; world {}: {}", failures.len(), failures[0].0, failures[0].1)]
    Worlds {
        /// Worlds in the batch.
        worlds: usize,
        /// World and what happened in it, in the order of worlds; at least one.
        failures: Vec<(usize, SenseError)>,
    },
}

impl From<GeometryError> for SenseError {
    fn from(error: GeometryError) -> Self {
        match error {
            GeometryError::Shape { what, shape, expected, found } => {
                Self::Shape { what, shape, expected, found }
            }
            other => Self::Parameter { what: other.to_string() },
        }
    }
}
