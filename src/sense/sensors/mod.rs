//! Sensors that are built in, one file each.

mod inertial;
mod lidar;
mod optical_flow;

pub use inertial::InertialSensor;
pub use lidar::Lidar;
pub use optical_flow::OpticalFlow;
