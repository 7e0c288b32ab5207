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
mod queries;
pub mod sensor;
pub mod sensors;
pub mod slopes;
pub mod swept;

pub use batch::{DepthBatch, PosedWorlds, WorldPoses, Worlds};
pub use caster::{Caster, RayHits, RayPattern, RayPlanes, RayQuery};
pub use clearance::Clearance;
pub use collide::Collider;
pub use contact::{Contact, MAX_PER_PAIR};
pub use depth::{
    Camera, Carrier, DepthFrame, DepthKind, DepthPlanes, Lens, Mount, PixelStatus, STATUS_NOT_RENDERED,
};
pub use device::{DEVICES, DepthDevice};
pub use error::SenseError;
pub use noise::{DepthNoise, NoiseKey};
pub use queries::Queries;
pub use sensor::{ChannelType, Moment, Sensor, SensorChannel};
pub use sensors::ImuNoise;
pub use slopes::{PixelSlope, PoseGain, SlopedImage};
pub use swept::{Sweep, SweptHit, TOUCH_M};
