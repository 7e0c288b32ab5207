//! Sensors on every drone, as a description names them.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::{ArenaError, CameraConfig};
use crate::math::vec3;
use crate::scene::{Pose, Scene};
use crate::sense::sensors::{DepthCamera, InertialSensor, Lidar, OpticalFlow};
use crate::sense::{ImuNoise, Sensor};

/// Where a sensor sits on a drone.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MountConfig {
    /// Its place in the body (x forward, y left, z up), m.
    pub pos_m: [f64; 3],
    /// Sensor to body, x y z w. The sensor looks along its x axis and has z up, so that the identity looks forward.
    pub quat_xyzw: [f64; 4],
}

impl Default for MountConfig {
    /// At the centre of mass, looking forward.
    fn default() -> Self {
        Self { pos_m: [0.0; 3], quat_xyzw: [0.0, 0.0, 0.0, 1.0] }
    }
}

impl MountConfig {
    /// The pose of the sensor in the body.
    pub fn pose(&self) -> Pose {
        Pose::new(self.pos_m, self.quat_xyzw)
    }
}

/// A sensor on every drone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum SensorConfig {
    /// Accelerometer and gyroscope at the centre of mass.
    Imu(ImuConfig),
    /// Rings of rays all around.
    Lidar(LidarConfig),
    /// One ray.
    RangeFinder(RangeFinderConfig),
    /// Optical flow of the ground below, with a range finder.
    OpticalFlow(OpticalFlowConfig),
    /// A depth camera beside the one that the description has in `camera`.
    DepthCamera(Box<DepthCameraConfig>),
}

/// An inertial sensor. Channels: `accelerometer` (m/s², 3), `gyroscope` (rad/s, 3), `saturated` (1 where an axis reads its limit).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ImuConfig {
    /// Its name, one of its own.
    pub name: String,
    /// Samples per second; as in [`SensorConfig::sample_hz`].
    pub sample_hz: Option<u32>,
    /// Its errors.
    pub noise: ImuNoise,
}

impl Default for ImuConfig {
    /// Without errors.
    fn default() -> Self {
        Self { name: "imu".into(), sample_hz: None, noise: ImuNoise::default() }
    }
}

/// A LiDAR. Channel: `range` (m, rings × columns), forward first and then to the left, the lowest ring first.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LidarConfig {
    /// Its name, one of its own.
    pub name: String,
    /// Samples per second; as in [`SensorConfig::sample_hz`].
    pub sample_hz: Option<u32>,
    /// Number of rings.
    pub rings: usize,
    /// Rays in each ring.
    pub columns: usize,
    /// Elevation of the lowest and the highest ring above the sensor's horizon, rad.
    pub elevation_rad: [f64; 2],
    /// Greatest range, m; it is read where nothing is met.
    pub range_m: f64,
    /// Standard deviation of a range, m.
    pub noise_m: f64,
    /// Where it sits.
    pub mount: MountConfig,
}

impl Default for LidarConfig {
    /// One level ring of 72 rays, one every 5°, up to 12 m.
    fn default() -> Self {
        Self {
            name: "lidar".into(),
            sample_hz: None,
            rings: 1,
            columns: 72,
            elevation_rad: [0.0; 2],
            range_m: 12.0,
            noise_m: 0.0,
            mount: MountConfig::default(),
        }
    }
}

/// A range finder. Channel: `range` (m).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RangeFinderConfig {
    /// Its name, one of its own.
    pub name: String,
    /// Samples per second; as in [`SensorConfig::sample_hz`].
    pub sample_hz: Option<u32>,
    /// Where it looks, in the body, of any length.
    pub direction: [f64; 3],
    /// Its place in the body, m.
    pub pos_m: [f64; 3],
    /// Greatest range, m; it is read where nothing is met.
    pub range_m: f64,
    /// Standard deviation of a range, m.
    pub noise_m: f64,
}

impl Default for RangeFinderConfig {
    /// Down from the centre of mass, up to 4 m.
    fn default() -> Self {
        Self {
            name: "range_finder".into(),
            sample_hz: None,
            direction: [0.0, 0.0, -1.0],
            pos_m: [0.0; 3],
            range_m: 4.0,
            noise_m: 0.0,
        }
    }
}

/// An optical-flow sensor that looks down from the centre of mass. Channels: `flow` (rad/s, 2), `distance` (m), `valid` (1 where it sees the
/// ground, else 0).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OpticalFlowConfig {
    /// Its name, one of its own.
    pub name: String,
    /// Samples per second; as in [`SensorConfig::sample_hz`].
    pub sample_hz: Option<u32>,
    /// Greatest distance at which it sees the ground, m.
    pub range_m: f64,
    /// Standard deviation of the flow, rad/s.
    pub noise_rad_s: f64,
}

impl Default for OpticalFlowConfig {
    /// Up to 4 m, without noise.
    fn default() -> Self {
        Self { name: "optical_flow".into(), sample_hz: None, range_m: 4.0, noise_rad_s: 0.0 }
    }
}

/// A further depth camera. Channels: `depth` (m, height × width), `status` (height × width) and, with labels, `geom_id` (height × width).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DepthCameraConfig {
    /// Its name, one of its own.
    pub name: String,
    /// Samples per second; as in [`SensorConfig::sample_hz`].
    pub sample_hz: Option<u32>,
    /// The camera; with a `mount` it need not be one of the shell.
    pub camera: CameraConfig,
    /// Whether the geom of each pixel is a channel.
    pub labels: bool,
}

impl Default for DepthCameraConfig {
    /// As [`CameraConfig`], without labels.
    fn default() -> Self {
        Self { name: "depth_camera".into(), sample_hz: None, camera: CameraConfig::default(), labels: false }
    }
}

impl SensorConfig {
    /// Its name.
    pub fn name(&self) -> &str {
        match self {
            Self::Imu(c) => &c.name,
            Self::Lidar(c) => &c.name,
            Self::RangeFinder(c) => &c.name,
            Self::OpticalFlow(c) => &c.name,
            Self::DepthCamera(c) => &c.name,
        }
    }

    /// Samples per second, for those who fly at some rate. None: as often as they look, in data sets `fps` of depth cameras and `log_hz` of
    /// others, in environments every step.
    pub fn sample_hz(&self) -> Option<u32> {
        match self {
            Self::Imu(c) => c.sample_hz,
            Self::Lidar(c) => c.sample_hz,
            Self::RangeFinder(c) => c.sample_hz,
            Self::OpticalFlow(c) => c.sample_hz,
            Self::DepthCamera(c) => c.sample_hz,
        }
    }

    /// The sensor in these scenes.
    ///
    /// # Errors
    /// [`ArenaError::Option`] for a name that files and arrays cannot have, and for a sensor that looks, without a scene;
    /// [`ArenaError::Sense`] for numbers that make no sense.
    pub fn build(&self, scenes: &[Scene]) -> Result<Arc<dyn Sensor>, ArenaError> {
        let name = self.name();
        let plain = |c: char| c.is_ascii_alphanumeric() || c == '_';
        if name.is_empty() || name.len() > 64 || !name.chars().all(plain) {
            let expected = "1 to 64 letters, digits and underscores";
            return Err(ArenaError::option("name of a sensor", expected, format!("{name:?}")));
        }
        if scenes.is_empty() && !matches!(self, Self::Imu(_)) {
            let expected = "a scene to look at, or sensors of the kind imu only";
            return Err(ArenaError::option("sensors", expected, format!("{name} without a scene")));
        }
        Ok(match self {
            Self::Imu(c) => Arc::new(InertialSensor::new(name, c.noise)?),
            Self::Lidar(c) => {
                let (size, range) = ((c.rings, c.columns), (c.range_m, c.noise_m));
                Arc::new(Lidar::rings(name, size, c.elevation_rad, c.mount.pose(), range)?)
            }
            Self::RangeFinder(c) => {
                if !(vec3::norm(c.direction) > 0.0 && c.direction.iter().all(|x| x.is_finite())) {
                    let expected = "a finite direction of some length";
                    return Err(ArenaError::option("direction", expected, format!("{:?}", c.direction)));
                }
                let mount = Pose::new(c.pos_m, [0.0, 0.0, 0.0, 1.0]);
                Arc::new(Lidar::new(name, &[c.direction], &[], mount, (c.range_m, c.noise_m))?)
            }
            Self::OpticalFlow(c) => Arc::new(OpticalFlow::down(name, c.range_m, c.noise_rad_s)?),
            Self::DepthCamera(c) => {
                let of = |scene: &Scene| (0..scene.n_drones()).map(|d| c.camera.build(scene, d)).collect();
                let cameras = scenes.iter().map(of).collect::<Result<Vec<Vec<_>>, _>>()?;
                Arc::new(DepthCamera::new(name, cameras, c.camera.errors()?, c.labels)?)
            }
        })
    }
}
