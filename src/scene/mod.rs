//! The MuJoCo boundary: scenes in, poses in, the table of geoms for `geometry` out, and MuJoCo's own rays, contacts and distances. The
//! crate's only `unsafe` code.
//!
//! A [`Scene`] is a compiled model with the shells of the drones attached, shared by all threads. A [`Worker`] is one
//! set of poses in it, owned by one thread at a time. The constraint solver never runs.

mod engine;
mod error;
mod field;
pub mod generate;
mod kinematics;
pub mod lint;
mod model;
mod pair;
mod shells;
mod shipped;
mod sizes;
mod sync;
mod table;
mod workers;

pub use crate::geometry::GeomType;
pub use engine::load_plugin_library;
pub use error::SceneError;
pub use field::{FIELD_BESIDE_M, FIELD_MOST_BYTES};
pub use lint::{GeomLint, LintReport, Verdict, lint, lint_source};
pub(crate) use lint::{contact_verdict, depth_verdict};
pub use model::{
    BodyInfo, BuildOptions, CameraInfo, CameraMode, GeomInfo, HfieldView, MeshView, ObstacleInfo,
    ObstacleKind, Scene, SceneSource, Shell, SiteInfo,
};
pub(crate) use pair::{MAX_PAIR_CONTACTS, PairContacts};
pub use shells::SHELLS;
pub use shipped::SCENES;
pub(crate) use sync::quat_of_matrix;
pub use sync::{MAX_COORDINATE_M, Pose, checked as checked_pose};
pub(crate) use workers::RayScratch;
pub use workers::{GeomDistance, Lent, RawContact, RayHit, Worker, WorkerPool};

/// Version of the MuJoCo library in use, such as `3.17.0`.
pub fn mujoco_version() -> String {
    mujoco_rs::mujoco_version().to_string()
}
