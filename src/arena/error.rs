//! What can go wrong in an arena.

use crate::rollout::RolloutError;
use crate::scene::SceneError;
use crate::scene::generate::GenerateError;
use crate::sense::SenseError;
use crate::vehicle::VehicleError;

/// Errors of an [`Arena`](super::Arena).
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ArenaError {
    /// Something that does not fit the simulation or its scenes.
    #[error("arena: {name}: expected {expected}, got {got}")]
    Option {
        /// What it is about.
        name: &'static str,
        /// What it may be.
        expected: String,
        /// What it was.
        got: String,
    },
    /// Something was asked for that only a scene has.
    #[error(
        "arena: {asked} needs a scene, in which drones see and touch, and this arena has none; make it with Arena::within"
    )]
    NoScene {
        /// What was asked for.
        asked: &'static str,
    },
    /// A description of a simulation cannot be read.
    #[error("{place}: {reason}; docs/configuration.md lists all fields")]
    Config {
        /// The field, and where it stands.
        place: String,
        /// What was expected, and what was found.
        reason: String,
    },
    /// The vehicle.
    #[error(transparent)]
    Vehicle(#[from] VehicleError),
    /// A generated scene.
    #[error(transparent)]
    Generate(#[from] GenerateError),
    /// Flying.
    #[error(transparent)]
    Rollout(#[from] RolloutError),
    /// The scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// Seeing and touching.
    #[error(transparent)]
    Sense(#[from] SenseError),
}

impl ArenaError {
    /// A description that cannot be read.
    pub(super) fn config(place: impl Into<String>, reason: impl ToString) -> Self {
        Self::Config { place: place.into(), reason: reason.to_string() }
    }

    /// The same, naming the file that cannot be read.
    #[must_use]
    pub fn in_file(self, path: &std::path::Path) -> Self {
        match self {
            Self::Config { place, reason } => {
                Self::Config { place: format!("{}, {place}", path.display()), reason }
            }
            e => e,
        }
    }

    /// Something that does not fit.
    pub(super) fn option(name: &'static str, expected: impl Into<String>, got: impl ToString) -> Self {
        Self::Option { name, expected: expected.into(), got: got.to_string() }
    }
}
