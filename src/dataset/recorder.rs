//! The main job: worlds of drones fly through a scene, are sensed, and become a data set.

use super::{
    BodyRecord, CameraRecord, ClearanceRow, ContactRow, Dataset, DepthMeaning, DepthPng, FlightRecord,
    FrameInput, GeomRecord, Manifest, Nearest, NoisyDepth, Quarantine, SceneRecord, StateRow, Summary,
    VehicleRecord, View, WorldWriter, create_or_resume,
};
use crate::arena::Arena;
use crate::error::Result;
use crate::math::{quat, vec3};
use crate::physics::controllers::{ControlMode, ticks};
use crate::physics::drone::{Drone, Dynamics};
use crate::physics::integrate::Integrator;
use crate::physics::measure;
use crate::physics::rigid_body::State;
use crate::random::{Key, purpose};
use crate::rollout::randomize::Randomization;
use crate::rollout::trajectory::{Spline, Trajectory};
use crate::rollout::{RolloutError, RotorStart, Sim, SimOptions};
use crate::scene::{MAX_COORDINATE_M, ObstacleInfo, Pose, Scene, Worker, WorkerPool};
use crate::sense::contact::MAX_PER_PAIR;
use crate::sense::{self, Camera, Collider, Contact, DepthFrame, DepthKind, DepthNoise, NoiseKey, SweptHit};
use crate::vehicle::Vehicle;
use rayon::prelude::*;
use serde_json::json;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Which way the drones fly.
#[derive(Clone, Debug, PartialEq)]
pub enum Course {
    /// [`Trajectory::lissajous`], drawn for each world and drone.
    Lissajous,
    /// [`Trajectory::circle`], drawn for each world; several drones share it evenly.
    Circle,
    /// Stay 1 m above the origin; several drones in a grid.
    Hover,
    /// Through given points; several drones in a grid around them.
    Waypoints(Spline),
}

/// Distance between the drones of a grid, m.
const GRID_M: f64 = 0.6;

impl Course {
    /// The trajectory of one drone.
    fn trajectory(&self, seed: u64, world: u64, drone: usize, n_drones: usize, attempt: u64) -> Trajectory {
        // A square grid around the centre.
        let side = (n_drones as f64).sqrt().ceil().max(1.0);
        let place = |i: f64| (i - 0.5 * (side - 1.0)) * GRID_M;
        let offset = match n_drones {
            1 => [0.0; 3],
            _ => [place((drone as f64 / side).floor()), place(drone as f64 % side), 0.0],
        };
        match self {
            Self::Lissajous => Trajectory::lissajous(seed, world, drone as u32, attempt),
            Self::Circle => match Trajectory::circle(seed, world, 0, attempt) {
                Trajectory::Circle { center_m, radius_m, phase_rad, rate_rad_s } => Trajectory::Circle {
                    center_m,
                    radius_m,
                    phase_rad: phase_rad + core::f64::consts::TAU * drone as f64 / n_drones as f64,
                    rate_rad_s,
                },
                other => other,
            },
            Self::Hover => Trajectory::Hover { at_m: vec3::add([0.0, 0.0, 1.0], offset) },
            Self::Waypoints(spline) => Trajectory::Waypoints(spline.shifted(offset)),
        }
    }

    /// How far from the origin the drones fly, m, seen from above.
    pub(super) fn reach_m(&self, n_drones: usize) -> f64 {
        let grid = (n_drones as f64).sqrt() * GRID_M;
        match self {
            Self::Lissajous => 2.3,
            Self::Circle => 1.0,
            Self::Hover => grid,
            Self::Waypoints(spline) => {
                let far = |most: f64, (_, p, _): &(f64, [f64; 3], f64)| most.max(p[0].abs()).max(p[1].abs());
                spline.points().iter().fold(0.0, far) + grid
            }
        }
    }

    fn record(&self) -> serde_json::Value {
        match self {
            Self::Lissajous => json!({ "kind": "lissajous" }),
            Self::Circle => json!({ "kind": "circle" }),
            Self::Hover => json!({ "kind": "hover" }),
            Self::Waypoints(spline) => json!({ "kind": "waypoints", "points": spline.points() }),
        }
    }
}

/// Everything that decides what a data set holds.
#[derive(Clone, Debug)]
pub struct Flight {
    /// The compiled scene, drones attached.
    pub scene: Scene,
    /// Vehicle of each drone.
    pub vehicles: Vec<Vehicle>,
    /// Name of the dynamics; see [`crate::vehicle::DYNAMICS`].
    pub dynamics: String,
    /// Number of worlds.
    pub n_worlds: usize,
    /// Length, s.
    pub seconds: f64,
    /// Simulation steps per second.
    pub sim_hz: u32,
    /// Depth frames per second.
    pub fps: u32,
    /// Rows of states, contacts and clearances per second; must divide `sim_hz`.
    pub log_hz: u32,
    /// Integration scheme.
    pub integrator: Integrator,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Which way the drones fly.
    pub course: Course,
    /// Camera of each drone.
    pub cameras: Vec<Camera>,
    /// What is drawn anew for every world.
    pub randomization: Randomization,
    /// Movable obstacles are shifted by up to this much in x and y, anew for every world, m.
    pub obstacle_jitter_m: f64,
    /// Noise of the depth cameras.
    pub noise: Option<DepthNoise>,
    /// Whether surface normals are stored.
    pub normals: bool,
    /// Largest clearance that is looked for, m.
    pub clearance_max_m: f64,
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
    flight.check()?;
    let drones = flight.drones()?;
    // What a simulation refuses is refused before there is a folder.
    flight.sim(&drones, 0)?;
    let manifest = flight.manifest(&drones);
    let (writer, done) = create_or_resume(out, &manifest)?;
    let mut warnings = flight.scene.warnings().to_vec();
    warnings.extend(writer.warnings().iter().cloned());
    for vehicle in &flight.vehicles {
        for warning in vehicle.warnings() {
            if !warnings.contains(warning) {
                warnings.push(warning.clone());
            }
        }
    }
    if flight.scene.geoms().iter().all(|g| g.drone.is_some()) {
        let name = flight.scene.name();
        warnings.push(format!("{name} has no geoms: nothing but drones can be seen or touched in it"));
    }
    let n_resumed = done.iter().filter(|d| **d).count();
    let finished = AtomicUsize::new(n_resumed);
    progress(n_resumed, flight.n_worlds);
    let pool = Arc::new(WorkerPool::new(&flight.scene));
    (0..flight.n_worlds).into_par_iter().filter(|w| !done[*w]).try_for_each(|w| -> Result<()> {
        World::new(flight, &drones, &pool, w)?.fly(writer.world(w)?)?;
        progress(finished.fetch_add(1, Ordering::SeqCst) + 1, flight.n_worlds);
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

/// Most steps per second of a flight.
const MAX_SIM_HZ: u32 = 1_000_000;

impl Flight {
    fn check(&self) -> Result<()> {
        let n = self.scene.n_drones();
        let option = |name, expected: String, got: String| {
            Err(crate::Error::from(RolloutError::Option { name, expected, got }))
        };
        if self.vehicles.len() != n || self.cameras.len() != n {
            let got = format!("{} vehicles, {} cameras", self.vehicles.len(), self.cameras.len());
            return option(
                "drones",
                format!("one vehicle and one camera for each of the scene's {n} drones"),
                got,
            );
        }
        if !(1..=MAX_SIM_HZ).contains(&self.sim_hz) {
            return option("sim_hz", format!("1 to {MAX_SIM_HZ} Hz"), self.sim_hz.to_string());
        }
        for vehicle in &self.vehicles {
            let r = vehicle.rates;
            let fastest = r.state_hz.max(r.attitude_hz).max(r.force_torque_hz);
            if self.sim_hz < fastest {
                let expected =
                    format!("at least {fastest} Hz, the fastest control stage of {}", vehicle.name);
                return option("sim_hz", expected, self.sim_hz.to_string());
            }
        }
        if self.fps == 0 || self.fps > self.sim_hz {
            return option(
                "fps",
                format!("1 to {} Hz, at most one frame per step of the simulation", self.sim_hz),
                self.fps.to_string(),
            );
        }
        if self.log_hz == 0 || !self.sim_hz.is_multiple_of(self.log_hz) {
            let expected = format!("a divisor of the simulation's {} Hz (sim_hz)", self.sim_hz);
            return option("log_hz", expected, self.log_hz.to_string());
        }
        let steps = self.seconds * f64::from(self.sim_hz);
        if !(self.seconds.is_finite() && (1.0..=1e9).contains(&steps)) {
            return option(
                "seconds",
                "at least one step and at most 1e9 steps".into(),
                self.seconds.to_string(),
            );
        }
        Ok(())
    }

    fn drones(&self) -> Result<Vec<Drone<f64>>> {
        for v in &self.vehicles {
            if !v.modes(&self.dynamics)?.contains(&ControlMode::State) {
                return Err(crate::Error::from(RolloutError::Option {
                    name: "drone",
                    expected:
                        "a vehicle with an on-board controller that follows states ([controller.mellinger])"
                            .into(),
                    got: format!("{}, which has none", v.name),
                }));
            }
        }
        self.vehicles.iter().map(|v| Ok(v.drone(&self.dynamics)?)).collect()
    }

    /// Where the movable obstacles of one world are.
    fn obstacle_poses(&self, world: u64) -> Vec<Pose> {
        let j = self.obstacle_jitter_m;
        let shifted = |(i, o): (usize, &ObstacleInfo)| {
            let key = Key { seed: self.seed, world, drone: i as u32, step: 0, purpose: purpose("obstacle") };
            let mut stream = key.stream();
            let shift = [stream.uniform(-j, j), stream.uniform(-j, j), 0.0];
            Pose::new(vec3::add(o.pos_m, shift), o.quat_xyzw)
        };
        self.scene.obstacles().iter().enumerate().map(shifted).collect()
    }

    /// The simulation of one world.
    fn sim(&self, drones: &[Drone<f64>], world: usize) -> Result<Sim> {
        let slots = drones.iter().zip(&self.vehicles).map(|(d, v)| (d.clone(), v.rates)).collect();
        let options = SimOptions {
            n_worlds: 1,
            first_world: world as u64,
            seed: self.seed,
            sim_hz: self.sim_hz,
            integrator: self.integrator,
            control: ControlMode::State,
            rotor_start: RotorStart::Hover,
            randomization: self.randomization.clone(),
            engine: Default::default(),
        };
        Ok(Sim::new(options, slots)?)
    }

    fn manifest(&self, drones: &[Drone<f64>]) -> Manifest {
        let scene = &self.scene;
        let log_every = self.sim_hz / self.log_hz;
        Manifest {
            mujoco_version: crate::scene::mujoco_version(),
            seed: self.seed,
            n_worlds: self.n_worlds,
            n_drones: scene.n_drones(),
            seconds: self.seconds,
            fps: f64::from(self.fps),
            scene: SceneRecord { name: scene.name().into(), sha256: scene.hash() },
            vehicles: self
                .vehicles
                .iter()
                .zip(drones)
                .zip(scene.shells())
                .map(|((v, d), shell)| VehicleRecord {
                    name: v.name.clone(),
                    dynamics: self.dynamics.clone(),
                    shell: shell.clone(),
                    sha256: v.sha256(),
                    n_rotors: d.airframe.n_rotors,
                    rates_hz: [
                        ("state", v.rates.state_hz),
                        ("attitude", v.rates.attitude_hz),
                        ("force_torque", v.rates.force_torque_hz),
                    ]
                    .map(|(name, hz)| (name.to_string(), hz))
                    .into(),
                })
                .collect(),
            flight: FlightRecord {
                control_mode: ControlMode::State.name().into(),
                integrator: match self.integrator {
                    Integrator::Euler => "euler",
                    Integrator::SemiImplicitEuler => "semi_implicit_euler",
                    Integrator::Rk4 => "rk4",
                }
                .into(),
                sim_hz: self.sim_hz,
                state_every_steps: log_every,
                clearance_every_steps: log_every,
                clearance_max_m: self.clearance_max_m,
                contact_every_steps: 1,
                swept: true,
                collider: Some(Collider::default()),
                trajectory: {
                    let mut record = self.course.record();
                    record["randomization"] = json!(self.randomization);
                    record["obstacle_jitter_m"] = json!(self.obstacle_jitter_m);
                    record
                },
            },
            cameras: self.cameras.iter().map(camera_record).collect(),
            depth_png: DepthPng::default(),
            normals: self.normals,
            noise: self.noise.as_ref().map(|n| json!(n)),
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
        }
    }
}

/// One world on its way.
struct World<'a> {
    flight: &'a Flight,
    arena: Arena,
    world: usize,
    trajectories: Vec<Trajectory>,
    obstacles: Vec<Pose>,
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
    fn new(flight: &'a Flight, drones: &[Drone<f64>], pool: &Arc<WorkerPool>, world: usize) -> Result<Self> {
        let n = drones.len();
        let mut arena = Arena::sharing(flight.sim(drones, world)?, std::slice::from_ref(pool), &[0])?;
        let obstacles = flight.obstacle_poses(world as u64);
        for (i, obstacle) in obstacles.iter().enumerate() {
            arena.obstacle_pos_mut()[3 * i..3 * i + 3].copy_from_slice(&obstacle.pos_m);
            arena.obstacle_quat_mut()[4 * i..4 * i + 4].copy_from_slice(&obstacle.quat_xyzw);
        }
        let (trajectories, mut start_clearance_m) =
            free_start(flight, &mut *arena.look().surroundings(0)?, world as u64, n)?;
        for (d, trajectory) in trajectories.iter().enumerate() {
            let start = start_pose(trajectory);
            arena.set_initial(0, d, State { pos: start.pos_m, quat: start.quat_xyzw, ..State::rest() })?;
        }
        arena.reset(None)?;
        let frames: Vec<DepthFrame> = flight.cameras.iter().map(|_| DepthFrame::new()).collect();
        let last: Vec<Pose> = arena.poses();
        let inside = |p: &Pose| p.pos_m.iter().all(|x| x.abs() <= MAX_COORDINATE_M);
        // Where starts are drawn anew, what counts is where they came to lie.
        if flight.randomization.rules.iter().any(|r| r.parameter.starts_with("initial."))
            && last.iter().all(inside)
        {
            let mut clear = Vec::new();
            arena.clearances(None, flight.clearance_max_m, &mut clear)?;
            start_clearance_m = clear.iter().map(|c| c.distance_m).fold(f64::INFINITY, f64::min);
        }
        Ok(Self {
            flight,
            arena,
            world,
            trajectories,
            obstacles,
            start_clearance_m,
            noisy: if flight.noise.is_some() { frames.clone() } else { Vec::new() },
            frames,
            contacts: Vec::new(),
            last,
            slack: vec![0.0; n],
            touching: Vec::new(),
            crowded_steps: 0,
            has_flexes: flight.scene.n_flex() > 0,
        })
    }

    /// From the first step to the last, everything written.
    fn fly(mut self, mut out: WorldWriter) -> Result<()> {
        let steps = (self.flight.seconds * f64::from(self.flight.sim_hz)).round() as u64;
        for step in 0..=steps {
            let t = step as f64 / f64::from(self.flight.sim_hz);
            let log = ticks(step, self.flight.log_hz, self.flight.sim_hz);
            let frame = ticks(step, self.flight.fps, self.flight.sim_hz);
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
            let command: Vec<f64> = self.trajectories.iter().flat_map(|tr| tr.at(t).command()).collect();
            self.arena.set_command(&command)?;
            self.arena.run_controllers()?;
            if log {
                self.log_states(t, step, &mut out)?;
            }
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
        let places: Vec<_> = self.obstacles.iter().map(|p| p.pos_m).collect();
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
            let radius = self.flight.scene.drone_radius_m(d)?;
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
            let clear = sense::clearance(&mut worker, d, self.flight.clearance_max_m)?;
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
        let scene = &self.flight.scene;
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
            let clear = sense::clearance(&mut worker, d, self.flight.clearance_max_m)?;
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
        if let Some(noise) = &self.flight.noise {
            for (d, (clean, noisy)) in self.frames.iter().zip(&mut self.noisy).enumerate() {
                let key = NoiseKey {
                    seed: self.flight.seed,
                    world: self.world as u64,
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

    /// State, command and reference of every drone.
    fn log_states(&mut self, t: f64, step: u64, out: &mut WorldWriter) -> Result<()> {
        let sim = self.arena.sim();
        for (d, trajectory) in self.trajectories.iter().enumerate() {
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

/// Clearance that drawn trajectories leave at the start, m.
const START_CLEARANCE_M: f64 = 0.15;

/// Draws of a trajectory before the best of them is taken as it is.
const START_ATTEMPTS: u64 = 64;

/// Pose at the start of a trajectory.
fn start_pose(trajectory: &Trajectory) -> Pose {
    let start = trajectory.at(0.0);
    Pose::new(start.pos_m, quat::exp([0.0, 0.0, start.yaw_rad]))
}

/// Trajectories of all drones of a world: the first draw that starts with [`START_CLEARANCE_M`] around every drone, and
/// the least clearance of its drones. Where no draw does, and for courses that are not drawn, what comes nearest to it.
fn free_start(flight: &Flight, worker: &mut Worker, world: u64, n: usize) -> Result<(Vec<Trajectory>, f64)> {
    let drawn = matches!(flight.course, Course::Lissajous | Course::Circle);
    let mut best = (Vec::new(), f64::NEG_INFINITY);
    for attempt in 0..if drawn { START_ATTEMPTS } else { 1 } {
        let trajectories: Vec<Trajectory> =
            (0..n).map(|d| flight.course.trajectory(flight.seed, world, d, n, attempt)).collect();
        for (d, trajectory) in trajectories.iter().enumerate() {
            let start = start_pose(trajectory);
            worker.set_drone(d, start.pos_m, start.quat_xyzw)?;
        }
        worker.update()?;
        let mut least = f64::INFINITY;
        for d in 0..n {
            least = least.min(sense::clearance(worker, d, flight.clearance_max_m)?.distance_m);
        }
        if least > best.1 {
            best = (trajectories, least);
        }
        if best.1 >= START_CLEARANCE_M {
            break;
        }
    }
    Ok(best)
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
        kind: match camera.kind() {
            DepthKind::Range => DepthMeaning::Range,
            DepthKind::ZDepth => DepthMeaning::ZDepth,
        },
        near_m,
        far_m,
        caster: Some(camera.caster()),
        k: camera.k(),
    }
}
