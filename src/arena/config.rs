//! One description of a simulation, by whatever door it is flown: `propwash fly`, learning environments, `propwash bench`, Python.
//!
//! Every field has a default, and defaults stand here, in [`SimOptions`] and in [`CameraConfig`] only. In files a description is a
//! flat table in JSON or TOML; unknown fields are refused. What a door needs beside it (how long to record, what to reward) is a
//! struct that contains a [`SimConfig`] and lies in the same table.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use rayon::prelude::*;
use serde::de::{DeserializeOwned, IgnoredAny};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use toml::Spanned;

use super::camera::CameraConfig;
use super::motion::ObstacleMotion;
use super::pattern::{FlightPattern, free_start};
use super::scenes::SceneConfig;
use super::sensor_config::SensorConfig;
use super::{Arena, ArenaError};
use crate::math::quat;
use crate::physics::controllers::Rates;
use crate::physics::drone::Drone;
use crate::physics::rigid_body::State;
use crate::rollout::{Sim, SimOptions};
use crate::scalar::lanes::Number;
use crate::scene::{Scene, Shell, WorkerPool};
use crate::sense::{Camera, Sensor};
use crate::vehicle::{BUILTIN, DYNAMICS, Vehicle};

/// The number in which states are kept and advanced.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Precision {
    /// f64 for data sets, which are flown by the reference; f32 for all that flies many worlds at once.
    #[default]
    Auto,
    /// Single precision.
    F32,
    /// Double precision.
    F64,
}

/// Where a vehicle comes from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(
    untagged,
    expecting = "expected the name of a built-in vehicle, the path of a vehicle file, or a table of name and toml, the text of a \
                 vehicle file"
)]
pub enum VehicleSource {
    /// A built-in vehicle by name, or a vehicle file by path, from the current folder.
    Named(String),
    /// The text of a vehicle file.
    Text {
        /// Name of the vehicle.
        name: String,
        /// The text.
        toml: String,
    },
}

impl VehicleSource {
    /// Reads the vehicle. A file goes before a name.
    ///
    /// # Errors
    /// [`ArenaError::Vehicle`] for a name that is not known and for a file that is wrong.
    pub fn load(&self) -> Result<Vehicle, ArenaError> {
        Ok(match self {
            Self::Named(name) if is_path(name) => Vehicle::load(name)?,
            Self::Named(name) => Vehicle::builtin(name)?,
            Self::Text { name, toml } => Vehicle::from_toml(name, toml)?,
        })
    }
}

/// Whether the name of a vehicle is a path.
fn is_path(name: &str) -> bool {
    let path = std::path::Path::new(name);
    path.is_file() || path.extension().is_some() || path.components().count() > 1
}

impl From<&Vehicle> for VehicleSource {
    /// A description that needs no other file: the name of a built-in vehicle that is as it was built in, else the whole text.
    fn from(vehicle: &Vehicle) -> Self {
        let name = vehicle.name.clone();
        let known = BUILTIN.contains(&name.as_str());
        if known && Vehicle::builtin(&name).is_ok_and(|own| own.to_toml() == vehicle.to_toml()) {
            return Self::Named(name);
        }
        Self::Text { name, toml: vehicle.to_toml().into() }
    }
}

/// One drone.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DroneConfig {
    /// Its vehicle.
    pub vehicle: VehicleSource,
    /// Model of motion: one of [`DYNAMICS`].
    pub dynamics: String,
    /// Path of another shell (MJCF) than the vehicle's, from the current folder.
    pub shell: Option<PathBuf>,
}

impl Default for DroneConfig {
    /// The built-in vehicle `cf2x_L250` by first principles.
    fn default() -> Self {
        Self { vehicle: VehicleSource::Named(BUILTIN[0].into()), dynamics: DYNAMICS[0].into(), shell: None }
    }
}

impl From<&Vehicle> for DroneConfig {
    /// A vehicle by first principles, by a description that needs no vehicle file.
    fn from(vehicle: &Vehicle) -> Self {
        let shell = vehicle.shell_path();
        Self { vehicle: vehicle.into(), shell, ..Self::default() }
    }
}

/// Rates of the on-board controllers' stages, Hz, for all drones; those of the vehicle where there is none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RatesConfig {
    /// State stage.
    pub state_hz: Option<u32>,
    /// Attitude stage.
    pub attitude_hz: Option<u32>,
    /// Body-rate stage.
    pub body_rate_hz: Option<u32>,
    /// Mixer.
    pub force_torque_hz: Option<u32>,
}

impl RatesConfig {
    /// Rates of a drone whose vehicle has those of `own`.
    fn of(&self, own: Rates) -> Rates {
        Rates {
            state_hz: self.state_hz.unwrap_or(own.state_hz),
            attitude_hz: self.attitude_hz.unwrap_or(own.attitude_hz),
            body_rate_hz: self.body_rate_hz.unwrap_or(own.body_rate_hz),
            force_torque_hz: self.force_torque_hz.unwrap_or(own.force_torque_hz),
        }
    }
}

/// What the on-board law of commanded body rates does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BodyRateLaw {
    /// That of the Crazyflie firmware, as the vehicle file has its gains: beside the rates it holds the level attitude, so that roll and
    /// pitch rates die away and the drone comes to rest askew.
    #[default]
    Firmware,
    /// The same law without its gains on the attitude and its integral: roll, pitch and yaw rates follow the command.
    Tracking,
}

/// A simulation, complete: who flies, where, how it is computed, what is drawn at random and what cameras see.
///
/// ```
/// use propwash::prelude::*;
///
/// let config = SimConfig::from_text("n_worlds = 4\nseed = 7\ncontrol = \"attitude\"\n[[sensors]]\nkind = \"imu\"")?;
/// let mut arena = Arena::<f64>::from_config(&config)?;
/// arena.step(10)?;
/// arena.sample(0, None)?;
/// assert_eq!(arena.samples(0, "gyroscope")?.len(), 4 * 3);
/// # Ok::<(), propwash::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct SimConfig {
    /// Worlds, seed, rate, integrator, control mode, rotors at the start, randomisation, engine.
    #[serde(flatten)]
    pub options: SimOptions,
    /// The number that is stored and computed with.
    pub precision: Precision,
    /// Drones in each world; as many as `drones` lists where there is none.
    pub n_drones: Option<usize>,
    /// The drones, used in turn where there are more of them.
    pub drones: Vec<DroneConfig>,
    /// Rates of on-board controllers.
    pub rates: RatesConfig,
    /// What they make of commanded body rates.
    pub body_rate_law: BodyRateLaw,
    /// Where they fly. None is no scene, or the choice of the task of an environment.
    pub scene: Option<SceneConfig>,
    /// Hash of each compiled scene, where it has to be the one that a data set was recorded in; empty: it may be any.
    pub scene_sha256: Vec<String>,
    /// How many scenes to generate, which differ in their seeds; none is 1, or the choice of the task of an environment.
    pub layouts: Option<usize>,
    /// Which scene each world is in, (world); by turns where there is none.
    pub layout: Option<Vec<usize>>,
    /// Height of the ground for effects where there is no scene, m; none is no ground.
    pub open_ground_z_m: Option<f64>,
    /// Movable obstacles are shifted by up to this much in x and y, anew for every world, m.
    pub obstacle_jitter_m: f64,
    /// How movable obstacles move by themselves; they stand still where there is none.
    pub obstacle_motion: Option<ObstacleMotion>,
    /// The pattern that drones start on, and that recordings fly; at the origin, level, where there is none.
    pub pattern: Option<FlightPattern>,
    /// The depth camera of every drone.
    pub camera: Option<CameraConfig>,
    /// Further sensors of every drone.
    pub sensors: Vec<SensorConfig>,
}

impl Default for SimConfig {
    /// One world of one `cf2x_L250`, without a scene.
    fn default() -> Self {
        Self {
            options: SimOptions::default(),
            precision: Precision::default(),
            n_drones: None,
            drones: vec![DroneConfig::default()],
            rates: RatesConfig::default(),
            body_rate_law: BodyRateLaw::default(),
            scene: None,
            scene_sha256: Vec::new(),
            layouts: None,
            layout: None,
            open_ground_z_m: None,
            obstacle_jitter_m: 0.0,
            obstacle_motion: None,
            pattern: None,
            camera: None,
            sensors: Vec::new(),
        }
    }
}

/// Most worlds; what fits into memory is less.
const MOST_WORLDS: usize = 1 << 40;
/// Most drones in a world.
const MOST_DRONES: usize = 1 << 20;
/// Most steps per second.
const MOST_HZ: u32 = 1_000_000;

impl SimConfig {
    /// Reads a description in JSON or TOML.
    ///
    /// # Errors
    /// [`ArenaError::Config`], saying where, what was expected and what was found.
    pub fn from_text(text: &str) -> Result<Self, ArenaError> {
        read_text(text)
    }

    /// Drones in each world.
    pub fn n_drones(&self) -> usize {
        self.n_drones.unwrap_or(self.drones.len())
    }

    /// The description of one drone.
    pub fn drone(&self, drone: usize) -> &DroneConfig {
        &self.drones[drone % self.drones.len()]
    }

    /// Refuses numbers that make no sense; files are looked at by [`SimConfig::load`].
    ///
    /// # Errors
    /// [`ArenaError::Option`], naming the field.
    pub fn check(&self) -> Result<(), ArenaError> {
        let whole = |name, got: usize, most: usize| match (1..=most).contains(&got) {
            true => Ok(()),
            false => Err(ArenaError::option(name, format!("1 to {most}"), got)),
        };
        whole("n_worlds", self.options.n_worlds, MOST_WORLDS)?;
        whole("sim_hz", self.options.sim_hz as usize, MOST_HZ as usize)?;
        if self.drones.is_empty() {
            return Err(ArenaError::option("drones", "at least one", "an empty list"));
        }
        whole("n_drones", self.n_drones(), MOST_DRONES)?;
        if self.drones.len() > self.n_drones() {
            let expected = format!("at most {}, the number of drones (n_drones)", self.n_drones());
            return Err(ArenaError::option("drones", expected, self.drones.len()));
        }
        let jitter = self.obstacle_jitter_m;
        if !(jitter.is_finite() && jitter >= 0.0) {
            return Err(ArenaError::option("obstacle_jitter_m", "a finite number of at least 0", jitter));
        }
        if let Some(motion) = &self.obstacle_motion {
            motion.check()?;
        }
        match self.open_ground_z_m {
            Some(z) if !z.is_finite() => {
                Err(ArenaError::option("open_ground_z_m", "a finite number, or none", z))
            }
            _ => Ok(()),
        }
    }

    /// Reads vehicles and compiles scenes, in parallel.
    ///
    /// # Errors
    /// [`ArenaError`] for numbers that make no sense, naming them, and for vehicles, scenes and cameras that cannot be used.
    pub fn load(&self) -> Result<Setup, ArenaError> {
        self.check()?;
        let mut config = self.clone();
        let n = self.n_drones();
        let listed = self.drones.iter().map(|d| d.vehicle.load()).collect::<Result<Vec<_>, _>>()?;
        for (drone, vehicle) in config.drones.iter_mut().zip(&listed) {
            drone.shell = drone.shell.take().or(vehicle.shell_path());
            drone.vehicle = vehicle.into();
        }
        config.n_drones = Some(n);
        let vehicles: Vec<Vehicle> = (0..n).map(|d| listed[d % listed.len()].clone()).collect();
        let drones = drones(&config, &vehicles)?;
        let shell = |d: usize| match &config.drone(d).shell {
            Some(path) => Shell::load(path),
            None => Shell::builtin(&vehicles[d].shell),
        };
        let sources = config.scene.as_ref().map_or(Ok(Vec::new()), |scene| scene.sources(self.layouts))?;
        let mut scenes = Vec::new();
        if !sources.is_empty() {
            let shells = (0..n).map(shell).collect::<Result<Vec<_>, _>>()?;
            let built: Result<_, _> =
                sources.par_iter().map(|source| Scene::build(source, &shells)).collect();
            scenes = built?;
        }
        check_hashes(&config.scene_sha256, &scenes)?;
        let cameras = match &config.camera {
            Some(_) if scenes.is_empty() => {
                let expected = "none without a scene, in which there is nothing to see";
                return Err(ArenaError::option("camera", expected, "a camera"));
            }
            Some(camera) => {
                let of = |scene: &Scene| (0..n).map(|d| camera.build(scene, d)).collect();
                scenes.iter().map(of).collect::<Result<_, _>>()?
            }
            None => vec![Vec::new(); scenes.len()],
        };
        if let Some(pattern) = &config.pattern {
            pattern.check(config.options.first_world, config.options.n_worlds, n)?;
        }
        check_layout(self.layout.as_deref(), config.options.n_worlds, scenes.len())?;
        let pools = scenes.iter().map(|scene| Arc::new(WorkerPool::new(scene))).collect();
        let mut setup = Setup { config, vehicles, drones, scenes, pools, cameras, sensors: Vec::new() };
        for sensor in &self.sensors {
            setup.mount(sensor.build(&setup.scenes)?, sensor.sample_hz())?;
        }
        Ok(setup)
    }
}

/// Refuses lists of scenes that are not one of those there are for each world.
fn check_layout(layout: Option<&[usize]>, n_worlds: usize, n_scenes: usize) -> Result<(), ArenaError> {
    match layout {
        Some(list) if list.len() != n_worlds || list.iter().any(|i| *i >= n_scenes) => {
            let expected =
                format!("numbers below {n_scenes}, the number of scenes, one for each of {n_worlds} worlds");
            Err(ArenaError::option("layout", expected, format!("{list:?}")))
        }
        _ => Ok(()),
    }
}

/// Refuses scenes that are not those of the description.
fn check_hashes(wanted: &[String], scenes: &[Scene]) -> Result<(), ArenaError> {
    let found: Vec<String> = scenes.iter().map(Scene::hash).collect();
    if wanted.is_empty() || wanted == found {
        return Ok(());
    }
    let expected = format!(
        "{}, of the scene and the shells that were flown in; restore their files, or empty scene_sha256 to fly in what is \
         there now",
        wanted.join(", ")
    );
    Err(ArenaError::option("scene_sha256", expected, found.join(", ")))
}

/// Parameters and rates of the drones, which have to know the control mode.
fn drones(config: &SimConfig, vehicles: &[Vehicle]) -> Result<Vec<(Drone<f64>, Rates)>, ArenaError> {
    let mode = config.options.control;
    let each = |(d, vehicle): (usize, &Vehicle)| {
        let dynamics = &config.drone(d).dynamics;
        let modes = vehicle.modes(dynamics)?;
        if !modes.contains(&mode) {
            let names: Vec<_> = modes.iter().map(|m| m.name()).collect();
            let (names, name) = (names.join(", "), &vehicle.name);
            let expected = format!("one of {names} for drone {d} ({name} with dynamics {dynamics})");
            return Err(ArenaError::option("control", expected, mode.name()));
        }
        let mut drone = vehicle.drone(dynamics)?;
        if config.body_rate_law == BodyRateLaw::Tracking {
            let gains = &mut drone.controller.body_rate;
            (gains.kr, gains.ki) = ([0.0; 3], [0.0; 3]);
        }
        Ok((drone, config.rates.of(vehicle.rates)))
    };
    vehicles.iter().enumerate().map(each).collect()
}

/// What a [`SimConfig`] names, read and compiled: arenas are made of it, as many as are wanted.
pub struct Setup {
    config: SimConfig,
    vehicles: Vec<Vehicle>,
    drones: Vec<(Drone<f64>, Rates)>,
    scenes: Vec<Scene>,
    pools: Vec<Arc<WorkerPool>>,
    cameras: Vec<Vec<Camera>>,
    sensors: Vec<MountedSensor>,
}

/// A sensor on every drone, and how often it samples.
#[derive(Clone)]
pub struct MountedSensor {
    /// The sensor.
    pub sensor: Arc<dyn Sensor>,
    /// Samples per second; none: as [`SensorConfig::sample_hz`] says.
    pub sample_hz: Option<u32>,
}

impl std::fmt::Debug for Setup {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Setup").field("config", &self.config).finish_non_exhaustive()
    }
}

impl Setup {
    /// The description, complete: it needs no vehicle file, since vehicles that are not built in stand in it as text.
    pub fn config(&self) -> &SimConfig {
        &self.config
    }

    /// The vehicle of each drone.
    pub fn vehicles(&self) -> &[Vehicle] {
        &self.vehicles
    }

    /// Parameters of each drone, and the rates of its controller.
    pub fn drones(&self) -> &[(Drone<f64>, Rates)] {
        &self.drones
    }

    /// The scenes.
    pub fn scenes(&self) -> &[Scene] {
        &self.scenes
    }

    /// The camera of each drone in each scene, (scene, drone); no drones without a camera.
    pub fn cameras(&self) -> &[Vec<Camera>] {
        &self.cameras
    }

    /// Mounts a sensor of the caller's on every drone of the arenas that are made from here on, beside those of the description.
    ///
    /// # Errors
    /// [`ArenaError::Option`] for a rate that the simulation has no steps for; what [`Arena::add_sensor`] refuses is refused with the arena.
    pub fn mount(&mut self, sensor: Arc<dyn Sensor>, sample_hz: Option<u32>) -> Result<(), ArenaError> {
        let sim_hz = self.config.options.sim_hz;
        if let Some(hz) = sample_hz.filter(|hz| !(1..=sim_hz).contains(hz)) {
            let expected = format!("1 to {sim_hz} Hz, at most one sample in each step of the simulation");
            return Err(ArenaError::option("sample_hz of a sensor", expected, hz));
        }
        self.sensors.push(MountedSensor { sensor, sample_hz });
        Ok(())
    }

    /// The sensors, by the numbers that they have in arenas.
    pub fn sensors(&self) -> &[MountedSensor] {
        &self.sensors
    }

    /// All worlds, at their starts.
    ///
    /// # Errors
    /// [`ArenaError::Rollout`] for options that the simulation refuses, [`ArenaError::Sense`] and [`ArenaError::Scene`] where a start
    /// of the pattern cannot be looked at.
    pub fn arena<N: Number>(&self) -> Result<Arena<N>, ArenaError> {
        self.worlds(0, self.config.options.n_worlds)
    }

    /// Some consecutive worlds, which fly as they do among the others.
    ///
    /// # Errors
    /// As [`Setup::arena`], and [`ArenaError::Option`] for worlds that there are not.
    pub fn worlds<N: Number>(&self, first: usize, n_worlds: usize) -> Result<Arena<N>, ArenaError> {
        let all = self.config.options.n_worlds;
        if n_worlds > all || first > all - n_worlds {
            let got = format!("{n_worlds} from {first} on");
            return Err(ArenaError::option("worlds", format!("numbers below {all}"), got));
        }
        let first_world = self.config.options.first_world + first as u64;
        let seeds = self.config.options.seeds.get(first..first + n_worlds).unwrap_or_default().to_vec();
        let options = SimOptions { n_worlds, first_world, seeds, ..self.config.options.clone() };
        let sim = Sim::<N>::storing(options, self.drones.clone())?;
        let mut arena = match self.scenes.is_empty() {
            true => Arena::open(sim, self.config.open_ground_z_m),
            false => {
                let worlds = first..first + n_worlds;
                let layout: Vec<usize> = match &self.config.layout {
                    Some(layout) => layout[worlds].to_vec(),
                    None => worlds.map(|w| w % self.scenes.len()).collect(),
                };
                Arena::sharing(sim, &self.pools, &layout)?
            }
        };
        for mounted in &self.sensors {
            arena.add_sensor(mounted.sensor.clone())?;
        }
        if !self.scenes.is_empty() {
            arena.shift_obstacles(self.config.obstacle_jitter_m);
        }
        arena.set_obstacle_motion(self.config.obstacle_motion.clone())?;
        if let Some(pattern) = &self.config.pattern {
            self.start(&mut arena, pattern)?;
        }
        Ok(arena)
    }

    /// Puts drones where their pattern begins.
    fn start<N: Number>(&self, arena: &mut Arena<N>, pattern: &FlightPattern) -> Result<(), ArenaError> {
        let (n_worlds, n) = (arena.sim().data.n_worlds, self.drones.len());
        let (look, options) = (arena.look(), arena.sim().options());
        let found: Result<Vec<_>, ArenaError> =
            (0..n_worlds).into_par_iter().map(|w| free_start(pattern, &look, options, w, n)).collect();
        let trajectories = found?.concat();
        for (row, trajectory) in trajectories.iter().enumerate() {
            let start = trajectory.at(0.0);
            let quat = quat::exp([0.0, 0.0, start.yaw_rad]);
            arena.set_initial(row / n, row % n, State { pos: start.pos_m, quat, ..State::rest() })?;
        }
        arena.trajectories = trajectories;
        // Obstacles stay where these starts are clear of them.
        arena.reset_flight(None)?;
        Ok(())
    }
}

impl<N: Number> Arena<N> {
    /// The arena that a description asks for. [`SimConfig::load`] gives vehicles and cameras too.
    ///
    /// # Errors
    /// As [`SimConfig::load`] and [`Setup::arena`].
    pub fn from_config(config: &SimConfig) -> Result<Self, ArenaError> {
        config.load()?.arena()
    }
}

/// Reads a description in JSON, which begins with `{`, or TOML.
///
/// # Errors
/// [`ArenaError::Config`] for text that is neither, and as [`read_value`].
pub fn read_text<T: Serialize + DeserializeOwned + Default>(text: &str) -> Result<T, ArenaError> {
    if text.trim_start().starts_with('{') {
        return read_value(serde_json::from_str(text).map_err(|e| ArenaError::config("JSON", e))?);
    }
    let line = |at: usize| 1 + text[..at.min(text.len())].matches('\n').count();
    let span_of = |e: &toml::de::Error| e.span().map(|at| line(at.start));
    let value = toml::from_str(text).map_err(|e| {
        ArenaError::config(format!("TOML, line {}", span_of(&e).unwrap_or(1)), e.message().trim())
    })?;
    read_value(value).map_err(|e| match e {
        ArenaError::Config { place, reason } => {
            // The field, or what is wrong in it where that can be told: some errors are told of the whole text.
            let fields: BTreeMap<Spanned<String>, IgnoredAny> = toml::from_str(text).unwrap_or_default();
            let field = fields.keys().find(|name| place.split('[').next() == Some(name.get_ref()));
            let value = toml::from_str::<T>(text).err().and_then(|e| span_of(&e));
            match value.max(field.map(|name| line(name.span().start))) {
                Some(line) => ArenaError::Config { place: format!("{place}, line {line}"), reason },
                None => ArenaError::Config { place, reason },
            }
        }
        e => e,
    })
}

/// Reads a description from a table, of which every field has a default.
///
/// # Errors
/// [`ArenaError::Config`], naming the field that is not known, or that cannot have its value.
pub fn read_value<T: Serialize + DeserializeOwned + Default>(value: Value) -> Result<T, ArenaError> {
    let Value::Object(fields) = value else {
        return Err(ArenaError::config("all of it", format!("expected a table of options, got {value}")));
    };
    let known = serde_json::to_value(T::default()).map_err(|e| ArenaError::config("defaults", e))?;
    // A field alone can be read, since all others have defaults: so the one that is wrong is named.
    let alone = |key: &str, value: Value| {
        serde_json::from_value::<T>(Value::Object(Map::from_iter([(key.to_string(), value)])))
    };
    for (key, value) in &fields {
        if known.get(key).is_none() {
            let names: Vec<&str> = known.as_object().into_iter().flatten().map(|(k, _)| k.as_str()).collect();
            let reason = format!("unknown field `{key}`, expected one of {}", names.join(", "));
            return Err(ArenaError::config(key, reason));
        }
        if let Err(e) = alone(key, value.clone()) {
            let entries = value.as_array().into_iter().flatten();
            let odd = entries
                .enumerate()
                .find(|(_, entry)| alone(key, Value::Array(vec![(*entry).clone()])).is_err());
            let place = odd.map_or(key.clone(), |(i, _)| format!("{key}[{i}]"));
            return Err(ArenaError::config(place, e));
        }
    }
    serde_json::from_value(Value::Object(fields)).map_err(|e| ArenaError::config("all of it", e))
}
