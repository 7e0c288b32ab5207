//! Propwash: a drone simulator that senses and collides in MuJoCo scenes, and that finds the physics it is missing.
//!
//! The modules in the order in which data flows; this list is the map of the library. Those that are exported from crates of
//! their own need no MuJoCo; `docs/architecture.md` says which uses which.
//!
//! ```text
//! vehicle + command → physics → rollout → scene → sense → arena → dataset | env
//! flight → gap → vehicle
//! ```

pub mod error;

// What a number is, and what is built of numbers.
pub use propwash_trace as scalar;
pub use propwash_trace::{export, math, units};

// The equations, and what they are given and move.
pub use propwash_physics as physics;
pub use propwash_physics::parameters;
pub use propwash_vehicle as vehicle;
// Generated straight-line code of the commonest steps.
pub use propwash_kernels as kernels;
pub use propwash_rollout as rollout;
pub use propwash_rollout::random;

pub mod scene;
pub mod sense;

// Flying, seeing and touching as one thing.
pub mod arena;

// Logs of real flights, and the gap finder that compares models with them.
pub use propwash_flight as flight;
pub use propwash_gap as gap;

pub mod dataset;
pub mod env;

pub mod cli;

pub use error::{Error, Result};

/// Compiles and runs the example of the README.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct ReadmeDoctests;

/// Compiles and runs the example in Rust of the page on learning environments.
#[cfg(doctest)]
#[doc = include_str!("../docs/environments.md")]
pub struct EnvironmentsDoctests;
