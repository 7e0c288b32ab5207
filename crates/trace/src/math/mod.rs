//! Vectors, quaternions and rotations over plain arrays, guarded at their singularities.
//!
//! Vectors are `[S; 3]`, matrices `[[S; 3]; 3]` (rows), quaternions `[S; 4]` in the order x, y, z, w, turning
//! body vectors into world vectors.

pub mod euler;
pub mod quat;
pub mod vec3;
