//! Geometry of scenes: shapes, and what is asked of them. Knows no MuJoCo: whoever compiles a scene tells of its geoms in arrays
//! ([`GeomSource`]), and whoever moves them lends their poses ([`Poses`]).
//!
//! | part | holds |
//! | --- | --- |
//! | `shape` | data alone: meshes, height fields, convex hulls, trees of boxes |
//! | [`Table`] | all geoms of a scene with their shapes, made once, shared by all threads, worlds and drones |
//! | `broad` | what may be near: static geoms for rays and for distances, and what moves |
//! | [`ray`] | what rays meet, sixteen at a time in f32 or one in f64 |
//! | `distance`, [`Query`] | signed distances, what is nearest to a drone, what it touches |
//! | [`sweep`] | what a moving drone touches first |
//! | [`Baker`], [`DistanceField`] | distances of what stands still, on a grid and between its points |
//!
//! Lengths are in metres, in the frame of the world unless a text says otherwise; rotation matrices are row major, from the frame of
//! the geom to the world. A *drone* is a group of geoms that move together and that are not asked about each other.
//!
//! What is answered is what MuJoCo 3.17.0 answers, to which the tests of the crate `propwash` compare it. What is not known here is
//! said in the answer: geoms that only MuJoCo's rays know ([`Table::foreign`]), how deep two geoms overlap ([`Meeting::deep`]), whole scenes
//! ([`Table::mujoco_only`]).

#![forbid(unsafe_code)]

mod bake;
mod broad;
mod distance;
mod error;
mod field;
mod kind;
mod pose;
mod query;
pub mod ray;
mod shape;
pub mod sweep;
mod table;

pub use bake::Baker;
pub use distance::find::{Found, Touch};
pub use distance::pair::{Meeting, PairDistance};
pub use error::GeometryError;
pub use field::{DistanceField, FieldGrid, trilinear};
pub use kind::GeomType;
pub use pose::Pose;
pub use query::{Memory, NearMemory, Poses, Query};
pub use table::{DroneSource, Geom, GeomSource, ShapeSource, Table};

#[cfg(test)]
use propwash_rollout::random;
use propwash_trace::math::{quat, vec3};
