//! The only equations. Every formula of flight physics is here once, generic over [`crate::scalar::Real`], without I/O
//! and without allocation; sources stand where the formula stands.

pub mod airframe;
pub mod attitude_response;
pub mod controllers;
pub mod drone;
pub mod effects;
pub mod integrate;
pub mod measure;
pub mod params;
pub mod rigid_body;
pub mod rotor;
pub mod surroundings;

#[cfg(test)]
pub(crate) mod sample;
