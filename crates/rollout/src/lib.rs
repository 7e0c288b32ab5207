//! Many worlds of many drones, advanced together.
//!
//! Public state is plain arrays in the order (world, drone, n). A step takes one block of worlds at a time through all
//! steps of a call while it sits in cache; blocks run in parallel and share nothing, so results do not depend on the
//! number of threads.

#![forbid(unsafe_code)]

mod backend;
mod blocks;
mod data;
mod equations;
mod error;
pub mod function;
mod lanes;
pub mod pilot;
pub mod pipeline;
mod plain;
pub mod pool;
pub mod quarantine;
pub mod random;
pub mod randomize;
mod sim;
mod state;
pub mod tape;
mod traced;
pub mod trajectory;
mod views;
pub mod watch;

pub use backend::{Backend, PreparedStep};
pub use data::SimData;
pub use equations::{Equations, WorldEquations};
pub use error::RolloutError;
pub use propwash_compile::{Compile, CompileError, Status as CompileStatus};
pub use sim::{Engine, RotorStart, Sim, SimOptions, origin};
pub use state::SimState;
pub use traced::{CommonStep, common_steps};
