//! Propwash: a drone simulator that senses and collides in MuJoCo scenes, and that finds the physics it is missing.
//!
//! The modules in the order in which data flows; this list is the map of the crate.
//!
//! ```text
//! vehicle + command → physics → rollout → scene → sense → arena → dataset | env
//! flight → gap → vehicle
//! ```

pub mod error;
pub mod random;

// What a number is, and what is built of numbers.
pub use propwash_trace as scalar;
pub use propwash_trace::{export, math, units};

pub mod physics;

pub mod vehicle;

// Generated straight-line code of the commonest steps.
pub mod kernels;
pub mod rollout;

pub mod scene;
pub mod sense;

// Flying, seeing and touching as one thing.
pub mod arena;

pub mod flight;
pub mod gap;

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
