//! The only equations. Every formula of flight physics is here once, generic over [`propwash_trace::Real`], without I/O
//! and without allocation; sources stand where the formula stands.

#![forbid(unsafe_code)]

pub mod airframe;
pub mod attitude_response;
pub mod controllers;
pub mod drone;
pub mod effects;
pub mod integrate;
pub mod measure;
pub mod rigid_body;
pub mod rotor;
pub mod surroundings;
pub mod throttle;

pub use propwash_trace::{parameters, params};

// For tests, also those of the crates above.
#[doc(hidden)]
pub mod sample;
