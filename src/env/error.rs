//! What can go wrong with a learning environment.

use crate::arena::ArenaError;
use crate::rollout::RolloutError;
use crate::scene::SceneError;
use crate::scene::generate::GenerateError;
use crate::sense::SenseError;
use crate::vehicle::VehicleError;

/// Errors of learning environments.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EnvError {
    /// An option makes no sense.
    #[error("{name}: expected {expected}, got {got}")]
    Option {
        /// The option.
        name: String,
        /// What it may be.
        expected: String,
        /// What it was.
        got: String,
    },
    /// The description of the environment could not be read.
    #[error("environment: {reason}")]
    Config {
        /// Where and why.
        reason: String,
    },
    /// Actions are not what the environment takes; nothing was flown.
    #[error(
        "action of world {world}, drone {drone}, entry {entry}: expected a finite number, got {got}; nothing was flown"
    )]
    Action {
        /// World.
        world: usize,
        /// Drone.
        drone: usize,
        /// Entry of its action.
        entry: usize,
        /// The number.
        got: f32,
    },
    /// An array has another length.
    #[error("{name}: expected {expected} numbers ({shape}), got {got}")]
    Length {
        /// The array.
        name: &'static str,
        /// Numbers expected.
        expected: usize,
        /// Their shape in words.
        shape: String,
        /// Numbers found.
        got: usize,
    },
    /// A world that has ended was stepped without having been reset.
    #[error(
        "world {world} has ended and was not reset: with autoreset \"disabled\", reset the worlds that end before the next step"
    )]
    Ended {
        /// The first such world.
        world: usize,
    },
    /// No place was found that suits a task.
    #[error("world {world}: {what}")]
    Place {
        /// World.
        world: usize,
        /// What was looked for and not found, and what to do.
        what: String,
    },
    /// A task gave a number that is none.
    #[error(
        "{what} of world {world}, drone {drone}: expected a finite number from the task, got {got}; reset all worlds before the next step"
    )]
    NotFinite {
        /// What it is.
        what: String,
        /// World.
        world: usize,
        /// Drone.
        drone: usize,
        /// The number.
        got: f32,
    },
    /// A policy cannot be trained in its surroundings.
    #[error("{what}")]
    Learn {
        /// What is wrong.
        what: String,
    },
    /// A task gave something else that cannot be used.
    #[error("task: {what}")]
    Task {
        /// What was expected, what it gave and where.
        what: String,
    },
    /// A task failed in a way of its own.
    #[error(transparent)]
    Failed(Box<dyn std::error::Error + Send + Sync>),
    /// The vehicle.
    #[error(transparent)]
    Vehicle(#[from] VehicleError),
    /// Flying.
    #[error(transparent)]
    Rollout(#[from] RolloutError),
    /// The scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A generated scene.
    #[error(transparent)]
    Generate(#[from] GenerateError),
    /// Seeing and touching.
    #[error(transparent)]
    Sense(#[from] SenseError),
}

impl From<ArenaError> for EnvError {
    fn from(e: ArenaError) -> Self {
        match e {
            ArenaError::Vehicle(e) => e.into(),
            ArenaError::Generate(e) => e.into(),
            ArenaError::Rollout(e) => e.into(),
            ArenaError::Scene(e) => e.into(),
            ArenaError::Sense(e) => e.into(),
            ArenaError::Option { name, expected, got } => Self::Option { name: name.into(), expected, got },
            e => Self::Config { reason: e.to_string() },
        }
    }
}

impl EnvError {
    /// An option that makes no sense.
    pub(super) fn option(name: impl Into<String>, expected: impl Into<String>, got: impl ToString) -> Self {
        Self::Option { name: name.into(), expected: expected.into(), got: got.to_string() }
    }
}
