//! Sensors that are built in, one file each.

mod depth_camera;
mod inertial;
mod lidar;
mod optical_flow;

pub use depth_camera::DepthCamera;
pub use inertial::{ImuNoise, InertialSensor};
pub use lidar::Lidar;
pub use optical_flow::OpticalFlow;
