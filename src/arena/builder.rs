//! An arena in a few words.

use std::path::PathBuf;

use super::pattern::FlightPattern;
use super::{
    Arena, ArenaError, CameraConfig, DroneConfig, SceneConfig, SensorConfig, SimConfig, VehicleSource,
};
use crate::physics::controllers::ControlMode;
use crate::physics::integrate::Integrator;
use crate::rollout::randomize::Randomization;
use crate::scalar::lanes::Number;

/// Puts a [`SimConfig`] together. What is not said has its default.
///
/// ```
/// use propwash::prelude::*;
///
/// let mut arena: Arena<f32> = Arena::builder()
///     .scene("xml/forest.xml")
///     .drone("cf2x_L250")
///     .worlds(8)
///     .seed(1)
///     .build()?;
/// arena.set_command(&Reference::hover([0.0, 0.0, 1.0], 0.0).command().repeat(8))?;
/// arena.step(100)?;
/// assert!(arena.sim().data.state(7, 0).pos[2] > 0.0);
/// # Ok::<(), propwash::Error>(())
/// ```
#[derive(Clone, Debug, Default)]
#[must_use]
pub struct Builder {
    config: SimConfig,
    drones: Vec<DroneConfig>,
}

impl Builder {
    /// The scene: the path of an MJCF or URDF file.
    pub fn scene(mut self, path: impl Into<PathBuf>) -> Self {
        self.config.scene = Some(SceneConfig::Files(vec![path.into()]));
        self
    }

    /// The scene as MJCF text.
    pub fn scene_xml(mut self, text: impl Into<String>) -> Self {
        self.config.scene = Some(SceneConfig::Xml(text.into()));
        self
    }

    /// Generated scenes, or any other description; `layouts` of those that are generated.
    pub fn scenes(mut self, scene: SceneConfig, layouts: usize) -> Self {
        (self.config.scene, self.config.layouts) = (Some(scene), Some(layouts));
        self
    }

    /// One more drone in each world: a built-in vehicle by name, or a vehicle file by path. The first call replaces the default.
    pub fn drone(mut self, vehicle: impl Into<String>) -> Self {
        let vehicle = VehicleSource::Named(vehicle.into());
        self.drones.push(DroneConfig { vehicle, ..DroneConfig::default() });
        self
    }

    /// Drones in each world; those that are named take turns.
    pub fn drones_per_world(mut self, n: usize) -> Self {
        self.config.n_drones = Some(n);
        self
    }

    /// Number of worlds.
    pub fn worlds(mut self, n: usize) -> Self {
        self.config.options.n_worlds = n;
        self
    }

    /// Seed of all random numbers.
    pub fn seed(mut self, seed: u64) -> Self {
        self.config.options.seed = seed;
        self
    }

    /// Steps per second.
    pub fn rate_hz(mut self, hz: u32) -> Self {
        self.config.options.sim_hz = hz;
        self
    }

    /// What commands mean.
    pub fn control(mut self, mode: ControlMode) -> Self {
        self.config.options.control = mode;
        self
    }

    /// How states are integrated.
    pub fn integrator(mut self, integrator: Integrator) -> Self {
        self.config.options.integrator = integrator;
        self
    }

    /// What is drawn anew at every reset.
    pub fn randomize(mut self, rules: Randomization) -> Self {
        self.config.options.randomization = rules;
        self
    }

    /// Where drones start, and the way of recordings.
    pub fn pattern(mut self, pattern: FlightPattern) -> Self {
        self.config.pattern = Some(pattern);
        self
    }

    /// The depth camera of every drone.
    pub fn camera(mut self, camera: CameraConfig) -> Self {
        self.config.camera = Some(camera);
        self
    }

    /// One more sensor on every drone.
    pub fn sensor(mut self, sensor: SensorConfig) -> Self {
        self.config.sensors.push(sensor);
        self
    }

    /// What has been said, as a description.
    pub fn config(mut self) -> SimConfig {
        if !self.drones.is_empty() {
            self.config.drones = self.drones;
        }
        self.config
    }

    /// The arena.
    ///
    /// # Errors
    /// As [`Arena::from_config`].
    pub fn build<N: Number>(self) -> Result<Arena<N>, ArenaError> {
        Arena::from_config(&self.config())
    }
}

impl Arena {
    /// Begins the description of an arena; [`Builder::build`] makes it, of f32 or f64.
    pub fn builder() -> Builder {
        Builder::default()
    }
}
