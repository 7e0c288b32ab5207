//! Learning environments: many worlds that are reset, flown, seen and judged in one call.
//!
//! An [`Env`] holds a batch of worlds with one or more drones each. [`Env::step`] turns actions into commands, flies, looks for
//! collisions, renders depth, judges and observes, all in parallel over worlds, into arrays of shape (world, drone, n) that a caller
//! reads in place. What is asked of the drones is a [`Task`], one of those built in ([`TaskConfig`]) or the caller's own, and where they do
//! it a set of scenes, one for each world. A [`BatchTask`] sees all worlds at once.
//!
//! Every random number is keyed by (seed, world, drone, step, purpose): the same seed gives the same episodes bit for bit, for any number
//! of threads and of worlds beside.

mod action;
mod batch;
mod batch_task;
mod config;
mod error;
pub mod formulas;
mod layouts;
mod randomize;
mod sensing;
mod task;
pub mod tasks;
mod written;

pub use action::{ActionConfig, ActionKind};
pub use batch::crossing::{self, train_crossing};
pub use batch::swapping::train_swapping;
pub use batch::{Ending, Env, EnvSensorChannel};
pub use batch_task::{Batch, BatchObstacles, BatchTask, Draw, FreePlace, episode_stream};
pub use config::{Autoreset, EnvConfig};
pub use error::EnvError;
pub use formulas::{Formulas, MAX_ACTIONS, Seen, TracedTask, Verdict};
pub use layouts::{Course, Gate};
pub use randomize::{LEVELS, Levels};
pub use task::{
    Channel, DroneView, EpisodeStart, Images, Obstacles, Outcome, Start, Task, TaskDefaults, WorldView,
};
pub use tasks::TaskConfig;
pub use written::{SEEN_NAMES, TaskTexts, WrittenTask};
