//! The main job: worlds of drones fly through a scene, are sensed, and become a data set.

use super::{
    BodyRecord, CameraRecord, ClearanceRow, ContactRow, Dataset, DepthPng, FlightRecord, FrameInput,
    GeomRecord, Manifest, Nearest, NoisyDepth, Quarantine, SceneRecord, SensorRecord, StateRow, Summary,
    VehicleRecord, View, WorldWriter, create_or_resume,
};
use crate::arena::{
    Arena, ArenaError, CameraConfig, FlightPattern, MountedSensor, Precision, Setup, SimConfig, read_text,
};
use crate::error::{Error, Result};
use crate::math::{quat, vec3};
use crate::physics::controllers::{ControlMode, ticks};
use crate::physics::drone::Dynamics;
use crate::physics::measure;
use crate::scene::{MAX_COORDINATE_M, Pose, Scene, Worker};
use crate::sense::contact::MAX_PER_PAIR;
use crate::sense::{self, Camera, Collider, Contact, DepthFrame, DepthNoise, NoiseKey, Sensor, SweptHit};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// A flight to be recorded: the simulation, and what is written of it. In files both lie in one table.
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
}

impl Default for FlightConfig {
    /// 4 s with 20 frames and 100 rows of states a second.
    fn default() -> Self {
        let sim = SimConfig::default();
        Self { sim, seconds: 4.0, fps: 20, log_hz: 100, normals: false, clearance_max_m: 5.0 }
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

/// Flies all worlds that are not in `out` yet and seals the data set. `progress(done, all)` is called after each world,
/// from any thread.
///
/// The bytes written depend on `flight` alone, not on threads, interruptions or order.
pub fn record(flight: &Flight, out: &Path, progress: &(dyn Fn(usize, usize) + Sync)) -> Result<Recorded> {
    let n_worlds = flight.config.sim.options.n_worlds;
    // What a simulation refuses is refused before there is a folder.
    flight.setup.worlds::<f64>(0, 1)?;
    let manifest = flight.manifest()?;
    let (writer, done) = create_or_resume(out, &manifest)?;
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
    progress(n_resumed, n_worlds);
    (0..n_worlds).into_par_iter().filter(|w| !done[*w]).try_for_each(|w| -> Result<()> {
        World::new(flight, w)?.fly(writer.world(w)?)?;
        progress(finished.fetch_add(1, Ordering::SeqCst) + 1, n_worlds);
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
    /// [`DatasetError`](super::DatasetError) for a manifest without one, [`ArenaError`] saying which field is wrong and why.
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
        let text = std::fs::read_to_string(path).map_err(|source| Error::Io { path: path.into(), source })?;
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
fn refuse<T>(name: &'static str, expected: impl Into<String>, got: impl ToString) -> Result<T> {
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

    /// Noise of the depth cameras.
    fn noise(&self) -> Result<Option<DepthNoise>> {
        Ok(self.config.sim.camera.as_ref().map_or(Ok(None), CameraConfig::errors)?)
    }

    fn manifest(&self) -> Result<Manifest> {
        let (config, scene) = (&self.config, self.scene());
        let (sim, options) = (&config.sim, &config.sim.options);
        let log_every = options.sim_hz / config.log_hz;
        Ok(Manifest {
            mujoco_version: crate::scene::mujoco_version(),
            seed: options.seed,
            n_worlds: options.n_worlds,
            n_drones: scene.n_drones(),
            seconds: config.seconds,
            fps: f64::from(config.fps),
            scene: SceneRecord { name: scene.name().into(), sha256: scene.hash() },
            vehicles: (0..scene.n_drones()).map(|d| self.vehicle_record(d)).collect(),
            flight: FlightRecord {
                control_mode: options.control.name().into(),
                integrator: options.integrator.name().into(),
                sim_hz: options.sim_hz,
                state_every_steps: log_every,
                clearance_every_steps: log_every,
                clearance_max_m: config.clearance_max_m,
                contact_every_steps: 1,
                swept: true,
                collider: Some(Collider::default()),
                trajectory: {
                    let mut record = match config.pattern() {
                        FlightPattern::Waypoints(spline) => {
                            json!({ "kind": "waypoints", "points": spline.points() })
                        }
                        drawn => json!({ "kind": drawn }),
                    };
                    record["randomization"] = json!(options.randomization);
                    record["obstacle_jitter_m"] = json!(sim.obstacle_jitter_m);
                    record
                },
            },
            config: Some(json!(config)),
            cameras: self.cameras.iter().map(camera_record).collect(),
            sensors: self.sensor_records(),
            depth_png: DepthPng::default(),
            normals: config.normals,
            noise: self.noise()?.map(|n| json!(n)),
            geoms: scene
                .geoms()
                .iter()
                .map(|g| GeomRecord {
                    id: g.id as i32,
                    name: g.name.clone(),
                    kind: g.kind.name().into(),
                    body: g.body_id as i32,
                })
                .collect(),
            bodies: scene
                .bodies()
                .iter()
                .map(|b| BodyRecord {
                    id: b.id as i32,
                    name: b.name.clone(),
                    drone: b.drone.map_or(-1, |d| d as i32),
                })
                .collect(),
        })
    }

    /// Sensors with their rates: where none is said, that of frames for images and that of states for all else.
    fn sensor_records(&self) -> Vec<SensorRecord> {
        let record = |mounted: &MountedSensor| {
            let channels = mounted.sensor.channels();
            let is_image = channels.iter().any(|c| c.name == "depth" && c.shape.len() == 2);
            let default = if is_image { self.config.fps } else { self.config.log_hz };
            let sample_hz = mounted.sample_hz.unwrap_or(default);
            SensorRecord { name: mounted.sensor.name().into(), sample_hz, channels }
        };
        self.setup.sensors().iter().map(record).collect()
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

    fn vehicle_record(&self, d: usize) -> VehicleRecord {
        let (vehicle, (drone, rates)) = (&self.setup.vehicles()[d], &self.setup.drones()[d]);
        let rates = [
            ("state", rates.state_hz),
            ("attitude", rates.attitude_hz),
            ("force_torque", rates.force_torque_hz),
        ];
        VehicleRecord {
            name: vehicle.name.clone(),
            dynamics: self.config.sim.drone(d).dynamics.clone(),
            shell: self.scene().shells()[d].clone(),
            sha256: vehicle.sha256(),
            n_rotors: drone.airframe.n_rotors,
            rates_hz: rates.map(|(name, hz)| (name.to_string(), hz)).into(),
        }
    }
}

/// One world on its way.
struct World<'a> {
    flight: &'a Flight,
    arena: Arena,
    sensors: Vec<SensorRecord>,
    world: u64,
    noise: Option<DepthNoise>,
    start_clearance_m: f64,
    frames: Vec<DepthFrame>,
    noisy: Vec<DepthFrame>,
    contacts: Vec<Contact>,
    /// Pose of each drone at the last step.
    last: Vec<Pose>,
    /// Distance that each drone may still travel before anything can touch it, m.
    slack: Vec<f64>,
    /// Pairs of geoms that touched at the last step.
    touching: Vec<(i32, i32)>,
    /// Steps in which a pair of geoms had as many contacts as MuJoCo reports at most, so that some may be missing.
    crowded_steps: u64,
    /// Whether the scene has flexes: contacts find them, clearance does not, so that no slack is known.
    has_flexes: bool,
}

impl<'a> World<'a> {
    fn new(flight: &'a Flight, world: usize) -> Result<Self> {
        let arena: Arena = flight.setup.worlds(world, 1)?;
        let (config, n) = (&flight.config, arena.sim().data.n_drones);
        let frames: Vec<DepthFrame> = flight.cameras.iter().map(|_| DepthFrame::new()).collect();
        let last: Vec<Pose> = arena.poses();
        let inside = |p: &Pose| p.pos_m.iter().all(|x| x.abs() <= MAX_COORDINATE_M);
        let mut start_clearance_m = f64::INFINITY;
        if last.iter().all(inside) {
            let mut clear = Vec::new();
            arena.clearances(None, config.clearance_max_m, &mut clear)?;
            start_clearance_m = clear.iter().map(|c| c.distance_m).fold(f64::INFINITY, f64::min);
        }
        let noise = flight.noise()?;
        Ok(Self {
            flight,
            arena,
            sensors: flight.sensor_records(),
            // Keys of random numbers are those of the world over the whole run.
            world: config.sim.options.first_world + world as u64,
            start_clearance_m,
            noisy: if noise.is_some() { frames.clone() } else { Vec::new() },
            noise,
            frames,
            contacts: Vec::new(),
            last,
            slack: vec![0.0; n],
            touching: Vec::new(),
            crowded_steps: 0,
            has_flexes: flight.scene().n_flex() > 0,
        })
    }

    /// From the first step to the last, everything written.
    fn fly(mut self, mut out: WorldWriter) -> Result<()> {
        let (config, sim_hz) = (&self.flight.config, self.flight.config.sim.options.sim_hz);
        let steps = (config.seconds * f64::from(sim_hz)).round() as u64;
        for step in 0..=steps {
            let t = step as f64 / f64::from(sim_hz);
            let log = ticks(step, config.log_hz, sim_hz);
            let frame = ticks(step, config.fps, sim_hz);
            if let Some((drone, reason)) = self.out_of_bounds() {
                out.quarantine(Quarantine { step: step.saturating_sub(1), drone, reason });
                break;
            }
            self.watch(t, step, log, &mut out)?;
            if log {
                self.log_clearance(t, step, &mut out)?;
            }
            if frame {
                self.see(t, step, &mut out)?;
            }
            let command: Vec<f64> =
                self.arena.trajectories().iter().flat_map(|tr| tr.at(t).command()).collect();
            self.arena.set_command(&command)?;
            self.arena.run_controllers()?;
            if log {
                self.log_states(t, step, &mut out)?;
            }
            self.sample_sensors(t, step, &mut out)?;
            if step < steps {
                for d in 0..self.last.len() {
                    self.last[d] = self.pose(d);
                }
                self.arena.run_integration();
                if let Some(fault) = self.arena.sim().data.quarantine[0].clone() {
                    let reason = format!("{} became non-finite", fault.quantity);
                    out.quarantine(Quarantine { step: fault.step, drone: fault.drone, reason });
                    break;
                }
            }
        }
        let places: Vec<_> = self.arena.obstacle_pos_mut().chunks_exact(3).map(<[f64]>::to_vec).collect();
        out.set_info(json!({
            "obstacles_m": places,
            "masses_kg": self.masses(),
            "start_clearance_m": self.start_clearance_m,
            "crowded_steps": self.crowded_steps,
        }));
        out.finish()?;
        Ok(())
    }

    /// The first drone that has left what a scene can hold: such a world ends there, and the others go on.
    fn out_of_bounds(&self) -> Option<(usize, String)> {
        let far = |d: &usize| self.pose(*d).pos_m.iter().any(|x| x.abs() > MAX_COORDINATE_M);
        let reason = format!("position left the ±{MAX_COORDINATE_M:e} m of a scene");
        (0..self.last.len()).find(far).map(|d| (d, reason))
    }

    fn masses(&self) -> Vec<f64> {
        (0..self.last.len()).map(|d| self.arena.sim().drone(0, d).parts().body.mass_kg).collect()
    }

    /// Where drone `d` is.
    fn pose(&self, d: usize) -> Pose {
        self.arena.look().pose(0, d)
    }

    /// Contacts and swept hits of the step that led here, looked for only where something may be near.
    fn watch(&mut self, t: f64, step: u64, log: bool, out: &mut WorldWriter) -> Result<()> {
        let n = self.last.len();
        let mut moved = Vec::with_capacity(n);
        for d in 0..n {
            let (from, to) = (self.last[d], self.pose(d));
            let turn = quat::mul(quat::conjugate(from.quat_xyzw), to.quat_xyzw);
            let angle = 2.0 * vec3::norm([turn[0], turn[1], turn[2]]).atan2(turn[3].abs());
            let radius = self.flight.scene().drone_radius_m(d)?;
            moved.push(vec3::norm(vec3::sub(to.pos_m, from.pos_m)) + angle * radius);
        }
        let mut near = Vec::new();
        for d in 0..n {
            let others = (0..n).filter(|e| *e != d).map(|e| moved[e]).fold(0.0, f64::max);
            self.slack[d] -= moved[d] + others;
            if self.has_flexes || self.slack[d] <= sense::TOUCH_M {
                near.push(d);
            }
        }
        if near.is_empty() {
            self.touching.clear();
            return Ok(());
        }
        let mut worker = self.arena.look().world(0)?;
        self.crowded_steps += u64::from(sense::contacts(&mut worker, &mut self.contacts)? > 0);
        let mut now = Vec::new();
        for c in self.contacts.iter().filter(|c| c.touches()) {
            let pair = (c.drone_geom, c.other_geom);
            if log || !self.touching.contains(&pair) {
                out.contact(&touch(t, step, c))?;
            }
            now.push(pair);
        }
        let mut met: Vec<[usize; 2]> = Vec::new();
        for d in near {
            if step > 0 {
                self.find_jumped(&mut worker, (t, step), d, &mut met, out)?;
            }
            let clear = sense::clearance(&mut worker, d, self.flight.config.clearance_max_m)?;
            self.slack[d] = clear.distance_m.max(0.0);
        }
        self.touching = now;
        Ok(())
    }

    /// What drone `d` touched between the last step and this one, and neither then nor now. `seen` holds the pairs of
    /// drones that were looked at in this step.
    fn find_jumped(
        &self,
        worker: &mut Worker,
        (t, step): (f64, u64),
        d: usize,
        seen: &mut Vec<[usize; 2]>,
        out: &mut WorldWriter,
    ) -> Result<()> {
        let scene = self.flight.scene();
        let drone_of =
            |g: i32| usize::try_from(g).ok().and_then(|g| scene.geoms().get(g)).and_then(|g| g.drone);
        let geoms_of =
            |e: usize| scene.geoms().iter().filter(move |g| g.drone == Some(e)).map(|g| g.id as i32);
        let now = self.contacts.iter().filter(|c| c.touches()).map(|c| (c.drone_geom, c.other_geom));
        let mut known: Vec<i32> = Vec::new();
        for (a, b) in now.chain(self.touching.iter().copied()) {
            for (own, other) in [(a, b), (b, a)] {
                if drone_of(own) == Some(d) {
                    match drone_of(other) {
                        Some(e) => known.extend(geoms_of(e)),
                        None => known.push(other),
                    }
                }
            }
        }
        let (from, to) = (self.last[d], self.pose(d));
        for e in (0..self.last.len()).filter(|e| *e != d) {
            let pair = [d.min(e), d.max(e)];
            let touched = geoms_of(e).any(|g| known.contains(&g));
            known.extend(geoms_of(e));
            if touched || seen.contains(&pair) {
                continue;
            }
            seen.push(pair);
            if let Some(hit) = sense::swept_pair(worker, d, from, to, e, self.last[e])? {
                out.contact(&jumped(t, step, d, &hit, scene))?;
            }
        }
        while let Some(hit) = sense::swept_beyond(worker, d, from, to, &known)? {
            out.contact(&jumped(t, step, d, &hit, scene))?;
            known.push(hit.other_geom);
        }
        Ok(())
    }

    /// Clearance of every drone.
    fn log_clearance(&mut self, t: f64, step: u64, out: &mut WorldWriter) -> Result<()> {
        let mut worker = self.arena.look().world(0)?;
        for d in 0..self.last.len() {
            let clear = sense::clearance(&mut worker, d, self.flight.config.clearance_max_m)?;
            self.slack[d] = clear.distance_m.max(0.0);
            let nearest = clear.found.then_some(Nearest {
                distance_m: clear.distance_m,
                from_m: clear.on_drone_m,
                to_m: clear.on_other_m,
                drone_geom: clear.drone_geom,
                geom: clear.other_geom,
                body: clear.other_body,
                other_drone: clear.other_drone,
                exact: clear.exact,
            });
            out.clearance(&ClearanceRow { t_s: t, step, drone: d, nearest })?;
        }
        Ok(())
    }

    /// One depth frame of every drone.
    fn see(&mut self, t: f64, step: u64, out: &mut WorldWriter) -> Result<()> {
        let mut worker = self.arena.look().world(0)?;
        for (camera, frame) in self.flight.cameras.iter().zip(&mut self.frames) {
            camera.render(&mut worker, frame)?;
        }
        if let Some(noise) = &self.noise {
            for (d, (clean, noisy)) in self.frames.iter().zip(&mut self.noisy).enumerate() {
                let key = NoiseKey {
                    seed: self.flight.config.sim.options.seed,
                    world: self.world,
                    drone: d as u32,
                    step,
                    camera: 0,
                };
                noise.apply(&self.flight.cameras[d], clean, key, noisy)?;
            }
        }
        let views: Vec<View> = self
            .frames
            .iter()
            .enumerate()
            .map(|(d, f)| View {
                depth_m: &f.depth_m,
                status: &f.status,
                geom_id: &f.geom_id,
                body_id: &f.body_id,
                normal: f.normal.as_deref(),
                noisy: self.noisy.get(d).map(|n| NoisyDepth { depth_m: &n.depth_m, status: &n.status }),
                pos_m: f.pos_m,
                quat_xyzw: f.quat_xyzw,
                k: f.k,
            })
            .collect();
        Ok(out.frame(&FrameInput { t_s: t, step, views: &views })?)
    }

    /// Samples of the sensors for which this is the time; commands are those of the coming step, as in the rows of states.
    fn sample_sensors(&mut self, t: f64, step: u64, out: &mut WorldWriter) -> Result<()> {
        let sim_hz = self.flight.config.sim.options.sim_hz;
        for (i, sensor) in self.sensors.iter().enumerate() {
            if !ticks(step, sensor.sample_hz, sim_hz) {
                continue;
            }
            self.arena.sample(i, None)?;
            let values = sensor.channels.iter().map(|c| self.arena.samples(i, &c.name));
            let values = values.collect::<std::result::Result<Vec<_>, _>>()?;
            out.sample(i, t, step, &values)?;
        }
        Ok(())
    }

    /// State, command and reference of every drone.
    fn log_states(&mut self, t: f64, step: u64, out: &mut WorldWriter) -> Result<()> {
        let sim = self.arena.sim();
        for (d, trajectory) in self.arena.trajectories().iter().enumerate() {
            let drone = sim.drone(0, d);
            let n = drone.airframe.n_rotors;
            let rotors = matches!(drone.dynamics, Dynamics::Rotors);
            let s = sim.data.state(0, d);
            let rate = sim.rate(0, d);
            let data = &sim.data;
            let reference = trajectory.at(t);
            let attitude = &data.attitude_command[4 * d..4 * d + 4];
            let row = StateRow {
                t_s: t,
                step,
                drone: d,
                pos_m: s.pos,
                quat_xyzw: s.quat,
                vel_m_s: s.vel,
                ang_vel_rad_s: s.ang_vel,
                specific_force_m_s2: Some(measure::accelerometer(&s, &rate, drone.body.gravity_m_s2)),
                rotor_rad_s: if rotors { &s.rotor_vel[..n] } else { &[] },
                thrust_n: Some(sim.thrust_n(0, d)),
                command: &reference.command(),
                attitude_command: Some([attitude[0], attitude[1], attitude[2], attitude[3]]),
                rotor_command_rad_s: if rotors { &data.rotor_command[data.n_rotors * d..][..n] } else { &[] },
                reference: Some(reference),
                battery_v: sim.battery_v(0, d),
                wind_m_s: Some(sim.wind_m_s(0, d)),
            };
            out.state(&row)?;
        }
        Ok(())
    }
}

/// A contact as a row; normals of the table point from the drone to what it touches.
fn touch(t: f64, step: u64, c: &Contact) -> ContactRow {
    ContactRow {
        t_s: t,
        step,
        drone: c.drone,
        other_drone: c.other_drone,
        geoms: [c.drone_geom, c.other_geom],
        bodies: [c.drone_body, c.other_body],
        other_flex: c.other_flex,
        distance_m: c.distance_m,
        point_m: c.point_m,
        normal: c.normal.map(|v| -v),
        exact: true,
        swept_fraction: None,
    }
}

/// A hit between two steps as a row.
fn jumped(t: f64, step: u64, drone: usize, hit: &SweptHit, scene: &Scene) -> ContactRow {
    let body = usize::try_from(hit.drone_geom)
        .ok()
        .and_then(|g| scene.geoms().get(g))
        .map_or(-1, |g| g.body_id as i32);
    let mut row = ContactRow {
        t_s: t,
        step,
        drone,
        other_drone: hit.other_drone,
        geoms: [hit.drone_geom, hit.other_geom],
        bodies: [body, hit.other_body],
        other_flex: -1,
        distance_m: hit.distance_m,
        point_m: hit.point_m,
        normal: hit.normal.map(|v| -v),
        exact: hit.exact,
        swept_fraction: Some(hit.fraction),
    };
    // Of two drones the one with the lower number comes first, as in all contacts.
    if let Some(other) = hit.other_drone
        && other < drone
    {
        (row.drone, row.other_drone) = (other, Some(drone));
        row.geoms.reverse();
        row.bodies.reverse();
        row.normal = hit.normal;
    }
    row
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
