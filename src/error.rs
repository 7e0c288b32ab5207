//! One error for the whole crate, around each area's own.

use std::path::PathBuf;

/// What can go wrong anywhere in Propwash. Messages say what was expected, what was found, where, and what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be read or written.
    #[error("{}: {source}; check the path and its permissions{}", path.display(), crate::flight::files::suggestion(path))]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The command line asks for something that does not exist.
    #[error("{flag}: expected {expected}, got {got}")]
    Usage {
        /// The flag.
        flag: &'static str,
        /// What it may be.
        expected: String,
        /// What it was.
        got: String,
    },
    /// A vehicle file or a URDF is wrong.
    #[error(transparent)]
    Vehicle(#[from] crate::vehicle::VehicleError),
    /// Building or running a simulation.
    #[error(transparent)]
    Rollout(#[from] crate::rollout::RolloutError),
    /// Scenes.
    #[error(transparent)]
    Scene(#[from] crate::scene::SceneError),
    /// Options of a generated scene.
    #[error(transparent)]
    Generate(#[from] crate::scene::generate::GenerateError),
    /// A flight log could not be read, or cannot be right.
    #[error(transparent)]
    Flight(#[from] crate::flight::FlightError),
    /// Comparing a model with a measurement.
    #[error(transparent)]
    Gap(#[from] crate::gap::GapError),
    /// A fitted effect could not be written into a vehicle file, or removed from it.
    #[error(transparent)]
    Accept(#[from] crate::gap::accept::AcceptError),
    /// The attitude model could not be identified.
    #[error(transparent)]
    AttitudeModel(#[from] crate::gap::attitude_model::AttitudeModelError),
    /// Cameras, contacts, clearances.
    #[error(transparent)]
    Sense(#[from] crate::sense::SenseError),
    /// An effect of another crate.
    #[error(transparent)]
    Effect(#[from] crate::physics::effects::RegisterError),
    /// Worlds in scenes.
    #[error(transparent)]
    Arena(Box<crate::arena::ArenaError>),
    /// Learning environments.
    #[error(transparent)]
    Env(Box<crate::env::EnvError>),
    /// Flight stacks in the loop.
    #[error(transparent)]
    Sitl(Box<crate::sitl::SitlError>),
    /// A data set could not be written or read.
    #[error(transparent)]
    Dataset(#[from] crate::dataset::DatasetError),
}

impl From<crate::env::EnvError> for Error {
    fn from(error: crate::env::EnvError) -> Self {
        Self::Env(Box::new(error))
    }
}

impl From<crate::sitl::SitlError> for Error {
    fn from(error: crate::sitl::SitlError) -> Self {
        use crate::sitl::SitlError;
        match error {
            SitlError::Arena(e) => (*e).into(),
            SitlError::Record { path, source } => Self::Io { path, source },
            e => Self::Sitl(Box::new(e)),
        }
    }
}

impl From<crate::geometry::GeometryError> for Error {
    fn from(error: crate::geometry::GeometryError) -> Self {
        Self::Sense(error.into())
    }
}

impl From<crate::gap::Error> for Error {
    fn from(error: crate::gap::Error) -> Self {
        use crate::gap::Error as Of;
        match error {
            Of::Vehicle(e) => e.into(),
            Of::Flight(e) => e.into(),
            Of::Gap(e) => e.into(),
            Of::Accept(e) => e.into(),
        }
    }
}

/// Result with [`Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl From<crate::arena::ArenaError> for Error {
    fn from(e: crate::arena::ArenaError) -> Self {
        use crate::arena::ArenaError;
        match e {
            ArenaError::Vehicle(e) => e.into(),
            ArenaError::Generate(e) => e.into(),
            ArenaError::Rollout(e) => e.into(),
            ArenaError::Scene(e) => e.into(),
            ArenaError::Sense(e) => e.into(),
            e => Self::Arena(Box::new(e)),
        }
    }
}
