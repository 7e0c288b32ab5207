//! What drones sense: depth images, contacts, clearances, inertial readings.

pub mod batch;
pub mod caster;
pub mod clearance;
mod collide;
pub mod contact;
pub mod depth;
pub mod device;
mod error;
pub mod noise;
pub mod sensor;
pub mod sensors;
pub mod swept;

pub use batch::{
    DepthBatch, WorldPoses, Worlds, clearance_batch, clearance_worlds, contacts_batch, contacts_worlds,
    render_batch, render_batch_into, render_worlds,
};
pub use caster::{Caster, RayHits, RayPattern, RayPlanes, RayQuery, cast_pattern, cast_rays};
pub use clearance::{Clearance, clearance, clearance_by};
pub use collide::Collider;
pub use contact::{Contact, MAX_PER_PAIR, contacts, contacts_by};
pub use depth::{Camera, DepthFrame, DepthKind, DepthPlanes, Lens, Mount, PixelStatus, STATUS_NOT_RENDERED};
pub use device::{DEVICES, DepthDevice};
pub use error::SenseError;
pub use noise::{DepthNoise, NoiseKey};
pub use sensor::{ChannelType, Moment, Sensor, SensorChannel};
pub use sensors::ImuNoise;
pub use swept::{SweptHit, TOUCH_M, swept, swept_by, swept_pair, swept_scene};
