//! What can go wrong in an arena.

use crate::rollout::RolloutError;
use crate::scene::SceneError;
use crate::sense::SenseError;

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
    /// Something that does not fit.
    pub(super) fn option(name: &'static str, expected: impl Into<String>, got: impl ToString) -> Self {
        Self::Option { name, expected: expected.into(), got: got.to_string() }
    }
}
