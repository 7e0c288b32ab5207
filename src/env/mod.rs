//! Learning environments: many worlds that are reset, flown, seen and judged in one call.
//!
//! An [`Env`] holds a batch of worlds with one or more drones each. [`Env::step`] turns actions into commands, flies, looks for
//! collisions, renders depth, judges and observes, all in parallel over worlds, into arrays of shape (world, drone, n) that a caller
//! reads in place. What is asked of the drones is a [`Task`](TaskConfig), where they do it a set of scenes, one for each world.
//!
//! Every random number is keyed by (seed, world, drone, step, purpose): the same seed gives the same episodes bit for bit, for any number
//! of threads and of worlds beside.

mod action;
mod batch;
mod config;
mod error;
mod layouts;
mod randomize;
mod sensing;
mod tasks;

pub use action::{ActionConfig, ActionKind};
pub use batch::{Ending, Env};
pub use config::{Autoreset, EnvConfig};
pub use error::EnvError;
pub use layouts::Course;
pub use randomize::{LEVELS, Levels};
pub use tasks::{Channel, TaskConfig};
