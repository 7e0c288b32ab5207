//! The main job: worlds of drones fly through a scene, are sensed, and become a data set.

use super::files::sha256;
use super::world_log::{Content, WorldLog};
use super::{
    BodyRecord, CameraRecord, Dataset, DatasetError, DepthPng, FlightRecord, GeomRecord, Manifest, Overview,
    SceneRecord, SensorRecord, Summary, VehicleRecord, WorldWriter, create_or_resume, map,
};
use crate::arena::{
    Arena, ArenaError, CameraConfig, FlightPattern, MountedSensor, Precision, Setup, SimConfig, read_text,
};
use crate::error::{Error, Result};
use crate::physics::controllers::ControlMode;
use crate::scene::Scene;
use crate::sense::contact::MAX_PER_PAIR;
use crate::sense::{Camera, Collider, Sensor};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// A flight to be recorded: the simulation, and what is written of it. In files both lie in one table.
///
/// ```
/// use propwash::dataset::recorder::{FlightConfig, record};
///
/// let text = "scene = { files = [\"xml/room.xml\"] }\nseconds = 0.2\nfps = 10\n[camera]\nwidth = 8\nheight = 6";
/// let flight = FlightConfig::from_text(text)?.load()?;
/// let folder = tempfile::tempdir().unwrap();
/// let made = record(&flight, &folder.path().join("set"), &|done, all| println!("{done} of {all} worlds"))?;
/// assert_eq!((made.summary.n_worlds, made.summary.n_images), (1, 3));
/// # Ok::<(), propwash::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct FlightConfig {
    /// What flies, where and how. Data sets are flown in f64 under state commands, on a pattern, with a camera on every drone.
    #[serde(flatten)]
    pub sim: SimConfig,
    /// Length, s.
    pub seconds: f64,
    /// Depth frames per second.
    pub fps: u32,
    /// Rows of states, contacts and clearances per second; must divide `sim_hz`.
    pub log_hz: u32,
    /// Whether surface normals are stored.
    pub normals: bool,
    /// Largest clearance that is looked for, m.
    pub clearance_max_m: f64,
    /// Flown by a program of the user's ([`Recorder`](super::Recorder)), whose commands are not part of the description.
    pub by_user: bool,
}

impl Default for FlightConfig {
    /// 4 s with 20 frames and 100 rows of states a second.
    fn default() -> Self {
        let sim = SimConfig::default();
        Self { sim, seconds: 4.0, fps: 20, log_hz: 100, normals: false, clearance_max_m: 5.0, by_user: false }
    }
}

/// Everything that decides what a data set holds, read and compiled.
#[derive(Debug)]
pub struct Flight {
    config: FlightConfig,
    setup: Setup,
    cameras: Vec<Camera>,
}

/// What a run gave.
#[derive(Clone, Debug)]
pub struct Recorded {
    /// The data set.
    pub summary: Summary,
    /// Worlds that were there already.
    pub n_resumed: usize,
    /// What the user should know, in words.
    pub warnings: Vec<String>,
}

/// Whoever waits for a data set.
pub trait Progress: Sync {
    /// So many of all worlds are there: told before the first one is flown, and after each.
    fn tell(&self, done: usize, all: usize);

    /// Whether nobody waits any more. Worlds that are being flown end then, and those that are there are kept.
    fn is_stopped(&self) -> bool {
        false
    }
}

impl<F: Fn(usize, usize) + Sync> Progress for F {
    fn tell(&self, done: usize, all: usize) {
        self(done, all);
    }
}

impl Recorded {
    /// What became of the data set in `out`, in numbers.
    pub fn details(&self, out: &Path) -> Value {
        let s = &self.summary;
        json!({
            "out": out.display().to_string(), "overview": out.join("overview.png").display().to_string(),
            "worlds": s.n_worlds, "resumed_worlds": self.n_resumed, "quarantined_worlds": s.n_quarantined,
            "state_rows": s.n_states, "contact_rows": s.n_contacts, "clearance_rows": s.n_clearances,
            "images": s.n_images, "bytes": s.bytes, "warnings": self.warnings,
        })
    }
}

/// Flies as [`record`] does, and draws the picture `overview.png` of what is there then.
///
/// # Errors
/// As [`record`], and for a picture that cannot be written.
pub fn fly(flight: &Flight, out: &Path, progress: &dyn Progress) -> Result<Recorded> {
    let recorded = record(flight, out, progress)?;
    let map = map::height_map(flight)?;
    Overview::from_dataset(&Dataset::open(out)?, map)?.draw()?.save(&out.join("overview.png"))?;
    Ok(recorded)
}

/// Flies all worlds that are not in `out` yet and seals the data set. `progress(done, all)` is called before the first world
/// and after each, from any thread.
///
/// The bytes written depend on `flight` alone, not on threads, interruptions or order.
pub fn record(flight: &Flight, out: &Path, progress: &dyn Progress) -> Result<Recorded> {
    let n_worlds = flight.config.sim.options.n_worlds;
    // What a simulation refuses is refused before there is a folder.
    flight.setup.worlds::<f64>(0, 1)?;
    let content = Arc::new(flight.content()?);
    let (writer, done) = create_or_resume(out, &flight.manifest(&content)?)?;
    writer.put_scene(content.mjb.as_deref())?;
    let mut warnings = flight.scene().warnings().to_vec();
    warnings.extend(writer.warnings().iter().cloned());
    for vehicle in flight.setup.vehicles() {
        for warning in vehicle.warnings() {
            if !warnings.contains(warning) {
                warnings.push(warning.clone());
            }
        }
    }
    if flight.scene().geoms().iter().all(|g| g.drone.is_some()) {
        let name = flight.scene().name();
        warnings.push(format!("{name} has no geoms: nothing but drones can be seen or touched in it"));
    }
    let n_resumed = done.iter().filter(|d| **d).count();
    let finished = AtomicUsize::new(n_resumed);
    progress.tell(n_resumed, n_worlds);
    (0..n_worlds).into_par_iter().filter(|w| !done[*w]).try_for_each(|w| -> Result<()> {
        let is_whole = fly_world(flight, &content, w, writer.world(w)?, progress)?;
        let done = finished.fetch_add(usize::from(is_whole), Ordering::SeqCst) + usize::from(is_whole);
        if !is_whole {
            return Err(DatasetError::Stopped { done, all: n_worlds }.into());
        }
        progress.tell(done, n_worlds);
        Ok(())
    })?;
    let summary = writer.finish()?;
    // From the files, so that worlds of an earlier, interrupted run count too.
    let data = Dataset::open(out)?;
    let (mut blocked, mut crowded) = (0, 0);
    for w in data.worlds() {
        let world = data.world(w)?;
        let number = |name: &str| world.record().info[name].as_f64().unwrap_or(f64::NAN);
        blocked += usize::from(number("start_clearance_m") <= 0.0);
        crowded += usize::from(number("crowded_steps") > 0.0);
    }
    if crowded > 0 {
        warnings.push(format!(
            "in {crowded} worlds a pair of geoms had {MAX_PER_PAIR} contacts at once, the most that MuJoCo reports; some \
             of theirs may be missing (crowded_steps in world.json)"
        ));
    }
    if blocked > 0 {
        warnings.push(format!(
            "{blocked} worlds start with a drone in contact; move the trajectory or the obstacles (info of world.json)"
        ));
    }
    Ok(Recorded { summary, n_resumed, warnings })
}

impl FlightConfig {
    /// Reads a description in JSON or TOML: one of a flight, or the manifest of a data set, which holds one.
    ///
    /// # Errors
    /// [`DatasetError`] for a manifest without one, [`ArenaError`] saying which field is
    /// wrong and why.
    pub fn from_text(text: &str) -> Result<Self> {
        match serde_json::from_str::<Value>(text) {
            Ok(value) if value.get("format").is_some() => Ok(super::manifest::config_of(&value)?),
            _ => Ok(read_text(text)?),
        }
    }

    /// Reads such a file.
    ///
    /// # Errors
    /// As [`FlightConfig::from_text`], naming the file, and [`Error::Io`] for one that cannot be read.
    pub fn from_file(path: &Path) -> Result<Self> {
        let text = crate::flight::files::read_text(path)
            .map_err(|source| Error::Io { path: path.into(), source })?;
        Self::from_text(&text).map_err(|e| match e {
            Error::Arena(e) => Error::Arena(Box::new(e.in_file(path))),
            e => e,
        })
    }

    /// The pattern that is flown.
    pub fn pattern(&self) -> &FlightPattern {
        self.sim.pattern.as_ref().unwrap_or(&FlightPattern::Lissajous)
    }

    /// Reads vehicles, compiles the scene and builds cameras.
    ///
    /// # Errors
    /// [`Error`] for numbers that make no sense, naming them, and for vehicles, scenes and cameras that cannot be used.
    pub fn load(mut self) -> Result<Flight> {
        if self.by_user {
            let expected = "false: a description of a flight along a pattern; this one was flown by a program of the user's, which has to \
                            be run again";
            return refuse("by_user", expected, true);
        }
        self.sim.precision = match self.sim.precision {
            Precision::F32 => return refuse("precision", "f64, in which data sets are flown", "f32"),
            _ => Precision::F64,
        };
        if self.sim.options.control != ControlMode::State {
            let got = self.sim.options.control.name();
            return refuse("control", "state: data sets are flown along a pattern", got);
        }
        self.sim.pattern = Some(self.pattern().clone());
        self.sim.camera = Some(self.sim.camera.unwrap_or_default());
        let setup = self.sim.load()?;
        if setup.scenes().len() != 1 {
            return refuse("scene", "one scene", setup.scenes().len());
        }
        self.sim = setup.config().clone();
        self.sim.scene_sha256 = vec![setup.scenes()[0].hash()];
        self.check(&setup)?;
        self.check_rates()?;
        let cameras = setup.cameras()[0].iter().map(|c| c.clone().with_normals(self.normals)).collect();
        Ok(Flight { config: self, setup, cameras })
    }

    fn check(&self, setup: &Setup) -> Result<()> {
        let sim_hz = self.sim.options.sim_hz;
        for (vehicle, (_, r)) in setup.vehicles().iter().zip(setup.drones()) {
            let fastest = r.state_hz.max(r.attitude_hz).max(r.force_torque_hz);
            if sim_hz < fastest {
                let expected =
                    format!("at least {fastest} Hz, the fastest control stage of {}", vehicle.name);
                return refuse("sim_hz", expected, sim_hz);
            }
        }
        Ok(())
    }

    /// Refuses lengths and rates that the simulation cannot have.
    pub(super) fn check_rates(&self) -> Result<()> {
        if !self.sim.options.seeds.is_empty() {
            let expected = "none: worlds of a data set have random numbers by one seed and their numbers";
            return refuse("seeds", expected, self.sim.options.seeds.len());
        }
        let sim_hz = self.sim.options.sim_hz;
        if self.fps == 0 || self.fps > sim_hz {
            let expected = format!("1 to {sim_hz} Hz, at most one frame per step of the simulation");
            return refuse("fps", expected, self.fps);
        }
        if self.log_hz == 0 || !sim_hz.is_multiple_of(self.log_hz) {
            let expected = format!("a divisor of the simulation's {sim_hz} Hz (sim_hz)");
            return refuse("log_hz", expected, self.log_hz);
        }
        let steps = self.seconds * f64::from(sim_hz);
        if !(self.seconds.is_finite() && (1.0..=1e9).contains(&steps)) {
            return refuse("seconds", "at least one step and at most 1e9 steps", self.seconds);
        }
        Ok(())
    }
}

/// An option that makes no sense.
pub(super) fn refuse<T>(name: &'static str, expected: impl Into<String>, got: impl ToString) -> Result<T> {
    Err(ArenaError::Option { name, expected: expected.into(), got: got.to_string() }.into())
}

impl Flight {
    /// The description, complete.
    pub fn config(&self) -> &FlightConfig {
        &self.config
    }

    /// The compiled scene, drones attached.
    pub fn scene(&self) -> &Scene {
        &self.setup.scenes()[0]
    }

    /// What is written of every world.
    fn content(&self) -> Result<Content> {
        content(&self.config, &self.setup, self.cameras.clone())
    }

    fn manifest(&self, content: &Content) -> Result<Manifest> {
        Ok(manifest(&self.config, &self.setup, content, self.config.sim.options.n_worlds))
    }

    /// Mounts a sensor of the caller's on every drone, beside those of the description. Where it has no rate it samples with the rows of
    /// states.
    ///
    /// A data set with such a sensor cannot be flown again from its manifest alone.
    ///
    /// # Errors
    /// [`ArenaError::Option`] for a rate that the simulation has no steps for.
    pub fn mount(&mut self, sensor: Arc<dyn Sensor>, sample_hz: Option<u32>) -> Result<()> {
        Ok(self.setup.mount(sensor, sample_hz)?)
    }
}

/// What is written of every world of a simulation.
pub(super) fn content(config: &FlightConfig, setup: &Setup, cameras: Vec<Camera>) -> Result<Content> {
    let noise = config.sim.camera.as_ref().map_or(Ok(None), CameraConfig::errors)?;
    Ok(Content {
        mjb: setup.scenes().first().map(Scene::to_mjb),
        scene: setup.scenes().first().cloned(),
        noise: noise.filter(|_| !cameras.is_empty()),
        obstacles: obstacles(setup),
        cameras,
        sensors: sensor_records(config, setup),
        seed: config.sim.options.seed,
        sim_hz: config.sim.options.sim_hz,
        fps: config.fps,
        log_hz: config.log_hz,
        clearance_max_m: config.clearance_max_m,
    })
}

/// Names of the movable obstacles of the scene.
fn obstacles(setup: &Setup) -> Vec<String> {
    setup.scenes().first().into_iter().flat_map(|s| s.obstacles().iter().map(|o| o.name.clone())).collect()
}

/// Sensors with their rates: where none is said, that of frames for images and that of states for all else.
fn sensor_records(config: &FlightConfig, setup: &Setup) -> Vec<SensorRecord> {
    let record = |mounted: &MountedSensor| {
        let channels = mounted.sensor.channels();
        let is_image = channels.iter().any(|c| c.name == "depth" && c.shape.len() == 2);
        let default = if is_image { config.fps } else { config.log_hz };
        let sample_hz = mounted.sample_hz.unwrap_or(default);
        SensorRecord { name: mounted.sensor.name().into(), sample_hz, channels }
    };
    setup.sensors().iter().map(record).collect()
}

/// The manifest of `n_worlds` worlds.
pub(super) fn manifest(config: &FlightConfig, setup: &Setup, content: &Content, n_worlds: usize) -> Manifest {
    let (sim, options, scene) = (&config.sim, &config.sim.options, content.scene.as_ref());
    let log_every = options.sim_hz / config.log_hz;
    let has_scene = scene.is_some();
    let mut trajectory = match config.pattern() {
        _ if config.by_user => json!({ "kind": "user" }),
        FlightPattern::Waypoints(spline) => json!({ "kind": "waypoints", "points": spline.points() }),
        FlightPattern::Tracks(tracks) => json!({ "kind": "tracks", "tracks": tracks }),
        drawn => json!({ "kind": drawn }),
    };
    trajectory["randomization"] = json!(options.randomization);
    trajectory["obstacle_jitter_m"] = json!(sim.obstacle_jitter_m);
    Manifest {
        mujoco_version: crate::scene::mujoco_version(),
        seed: options.seed,
        n_worlds,
        n_drones: setup.vehicles().len(),
        seconds: config.seconds,
        fps: if content.cameras.is_empty() { 0.0 } else { f64::from(config.fps) },
        scene: SceneRecord {
            name: scene.map_or("none", |scene| scene.name()).into(),
            sha256: scene.map_or(String::new(), Scene::hash),
            mjb_sha256: content.mjb.as_deref().map(sha256),
        },
        vehicles: (0..setup.vehicles().len()).map(|d| vehicle_record(config, setup, d)).collect(),
        flight: FlightRecord {
            control_mode: options.control.name().into(),
            integrator: options.integrator.name().into(),
            sim_hz: options.sim_hz,
            state_every_steps: log_every,
            clearance_every_steps: if has_scene { log_every } else { 0 },
            clearance_max_m: config.clearance_max_m,
            contact_every_steps: u32::from(has_scene),
            swept: has_scene,
            collider: Some(Collider::default()),
            trajectory,
        },
        config: Some(json!(config)),
        cameras: content.cameras.iter().map(camera_record).collect(),
        sensors: content.sensors.clone(),
        obstacles: content.obstacles.clone(),
        depth_png: DepthPng::default(),
        normals: config.normals,
        noise: content.noise.map(|n| json!(n)),
        geoms: scene
            .map_or(&[][..], Scene::geoms)
            .iter()
            .map(|g| GeomRecord {
                id: g.id as i32,
                name: g.name.clone(),
                kind: g.kind.name().into(),
                body: g.body_id as i32,
            })
            .collect(),
        bodies: scene
            .map_or(&[][..], Scene::bodies)
            .iter()
            .map(|b| BodyRecord {
                id: b.id as i32,
                name: b.name.clone(),
                drone: b.drone.map_or(-1, |d| d as i32),
            })
            .collect(),
    }
}

fn vehicle_record(config: &FlightConfig, setup: &Setup, d: usize) -> VehicleRecord {
    let (vehicle, (drone, rates)) = (&setup.vehicles()[d], &setup.drones()[d]);
    let rates =
        [("state", rates.state_hz), ("attitude", rates.attitude_hz), ("force_torque", rates.force_torque_hz)];
    let shell = setup.scenes().first().map(|scene| scene.shells()[d].clone());
    VehicleRecord {
        name: vehicle.name.clone(),
        dynamics: config.sim.drone(d).dynamics.clone(),
        shell: shell.unwrap_or_else(|| vehicle.shell.clone()),
        sha256: vehicle.sha256(),
        n_rotors: drone.airframe.n_rotors,
        rates_hz: rates.map(|(name, hz)| (name.to_string(), hz)).into(),
    }
}

/// One world, from the first step to the last, everything written.
/// Flies a world, and writes it; false where it was stopped before its end.
fn fly_world(
    flight: &Flight,
    content: &Arc<Content>,
    world: usize,
    mut out: WorldWriter,
    progress: &dyn Progress,
) -> Result<bool> {
    let mut arena: Arena = flight.setup.worlds(world, 1)?;
    let (config, options) = (&flight.config, &flight.config.sim.options);
    let mut log = WorldLog::new(content, arena.look(), 0, options.first_world + world as u64)?;
    let steps = (config.seconds * f64::from(options.sim_hz)).round() as u64;
    for step in 0..=steps {
        if progress.is_stopped() {
            return Ok(false);
        }
        if !log.before(arena.look(), step, &mut out)? {
            break;
        }
        let t = step as f64 / f64::from(options.sim_hz);
        let command: Vec<f64> = arena.trajectories().iter().flat_map(|path| path.at(t).command()).collect();
        arena.set_command(&command)?;
        arena.run_controllers()?;
        let sampled = content.due(step);
        for sensor in &sampled {
            arena.sample(*sensor, None)?;
        }
        let at = (arena.look(), arena.sim().equations());
        log.after_controllers(at, step, &sampled, arena.trajectories(), &mut out)?;
        if step < steps {
            log.before_integration(arena.look());
            arena.run_integration()?;
            if !log.after_integration(arena.look(), &mut out) {
                break;
            }
        }
    }
    out.set_info(log.info((arena.look(), arena.sim().equations())));
    out.finish()?;
    Ok(true)
}

fn camera_record(camera: &Camera) -> CameraRecord {
    let (near_m, far_m) = camera.range_m();
    CameraRecord {
        name: camera.name().into(),
        width: camera.width(),
        height: camera.height(),
        kind: camera.kind(),
        near_m,
        far_m,
        caster: Some(camera.caster()),
        k: camera.k(),
    }
}
