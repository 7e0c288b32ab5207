//! The scenes of a forest task as surroundings in which a policy is trained by gradients: what its camera shows, and how far it is to things.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use rayon::prelude::*;

use super::Asked;
use super::build::complete;
use super::ways::Way;
use crate::arena::Setup;
use crate::env::EnvError;
use crate::env::config::EnvConfig;
use crate::env::layouts::{Course, Layout};
use crate::env::randomize::Levels;
use crate::env::task::{EpisodeStart, Start, Task};
use crate::env::tasks::{ForestDepth, TaskConfig};
use crate::geometry::DistanceField;
use crate::learn::goals::Cross;
use crate::learn::{Actions, LearnError, Options, Surroundings, Trained, train_sighted};
use crate::physics::controllers::ControlMode;
use crate::physics::rigid_body::State;
use crate::random::{Key, Stream, purpose};
use crate::scene::{FIELD_MOST_BYTES, WorkerPool};
use crate::sense::{DepthPlanes, SenseError};

/// How a depth image becomes numbers of a policy: the nearest thing in each of the blocks, as [`NEARNESS`] says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sight {
    /// Height and width of blocks, pixels; they divide those of the camera.
    pub block: [usize; 2],
}

/// Nearness of a depth d: 3 (1 / max(d, 0.2 m) − 1 / far) / (1 / 0.2 m − 1 / far), from 3 to 0 at the greatest depth of the camera.
pub const NEARNESS: [f64; 2] = [0.2, 3.0];

/// Distance of neighbours of the fields that costs come from, m: far below what drones keep from things.
const RESOLUTION_M: f64 = 0.125;

/// How far fields reach beside the scene and above the ceiling, m.
const BESIDE_M: [f64; 2] = [2.5, 0.7];

/// A trained policy, and what it took.
#[derive(Clone, Debug)]
pub struct Crossed {
    /// The policy and how it came to be.
    pub trained: Trained,
    /// Time to compile the scenes and to bake their fields, and time in all, s.
    pub seconds: [f64; 2],
}

/// Scenes with their fields, and which of them each world is in.
struct Scenes {
    task: ForestDepth,
    layouts: Vec<Layout>,
    pools: Vec<WorkerPool>,
    fields: Vec<DistanceField>,
    /// Boxes in which ways are looked for, and how far these keep from things, m; zero where there are none.
    boxes: Vec<[[f64; 3]; 2]>,
    detour_m: f64,
    layout: Vec<usize>,
    /// The way of each world.
    ways: Vec<Option<Way>>,
    block: [usize; 2],
    /// Of the camera: width, height, and 1 / greatest depth.
    size: [usize; 2],
    far: f32,
    fault: Mutex<Option<String>>,
}

impl Scenes {
    fn new(
        task: ForestDepth,
        layouts: Vec<Layout>,
        (sight, detour_m): (Sight, f64),
        n_worlds: usize,
    ) -> Result<Self, EnvError> {
        let camera = layouts.first().and_then(|l| l.cameras.first()).ok_or_else(|| {
            EnvError::option("camera", "a depth camera on the drone, and a scene that it sees", "none")
        })?;
        let (size, far) = ([camera.width(), camera.height()], camera.range_m().1);
        let [h, w] = sight.block;
        if h == 0 || w == 0 || !size[1].is_multiple_of(h) || !size[0].is_multiple_of(w) {
            let expected = format!("block sides that divide {} x {} pixels", size[1], size[0]);
            return Err(EnvError::option("sight.block", expected, format!("{h} x {w}")));
        }
        if !far.is_finite() || far <= NEARNESS[0] {
            let expected = format!("a greatest depth, more than {} m", NEARNESS[0]);
            return Err(EnvError::option("camera.range_m", expected, far));
        }
        let around = |layout: &Layout| {
            let [low, high] = layout.course.extent_m.unwrap_or([[-5.0; 3], [5.0; 3]]);
            let low = [low[0] - BESIDE_M[0], low[1] - BESIDE_M[0], -0.2];
            let high = [high[0] + BESIDE_M[0], high[1] + BESIDE_M[0], task.ceiling_m + BESIDE_M[1]];
            [low, high]
        };
        let boxes: Vec<[[f64; 3]; 2]> = layouts.iter().map(around).collect();
        let field = |(layout, space): (&Layout, &[[f64; 3]; 2])| {
            layout.scene.distance_field(RESOLUTION_M, Some(*space), FIELD_MOST_BYTES)
        };
        let fields = layouts.par_iter().zip(&boxes).map(field).collect::<Result<_, _>>()?;
        let pools = layouts.iter().map(|l| WorkerPool::new(&l.scene)).collect();
        let fault = Mutex::new(None);
        let (layout, ways) = (vec![0; n_worlds], vec![None; n_worlds]);
        let (block, far) = (sight.block, far as f32);
        Ok(Self { task, layouts, pools, fields, boxes, detour_m, layout, ways, block, size, far, fault })
    }

    fn render(&self, layout: usize, pos: [f32; 3], q: [f32; 4], depth: &mut [f32]) -> Result<(), SenseError> {
        let mut worker = self.pools[layout].lend()?;
        worker.set_drone(0, pos.map(f64::from), q.map(f64::from))?;
        worker.update()?;
        let camera = &self.layouts[layout].cameras[0];
        camera
            .render_into(&mut worker, DepthPlanes { depth_m: Some(&mut *depth), ..DepthPlanes::default() })?;
        camera.fill_unseen(depth);
        Ok(())
    }
}

impl Surroundings for Scenes {
    fn sights(&self) -> usize {
        (self.size[0] / self.block[1]) * (self.size[1] / self.block[0])
    }

    fn begin(
        &mut self,
        world: usize,
        episode: u64,
        random: &mut Stream,
    ) -> Result<(State<f64>, [f64; 3]), String> {
        let number = random.below(self.layouts.len() as u64) as usize;
        self.layout[world] = number;
        let key = Key {
            seed: random.below(1 << 62),
            world: world as u64,
            drone: 0,
            step: episode,
            purpose: purpose("env.crossing"),
        };
        let mut worker = self.pools[number].lend().map_err(|e| e.to_string())?;
        let (mut starts, mut memory) = ([Start::at([0.0; 3])], vec![0.0; self.task.memory_len(1)]);
        let mut start = EpisodeStart {
            draw: key.stream(),
            world,
            course: &self.layouts[number].course,
            worker: Some(&mut worker),
            goal: None,
            starts: &mut starts,
            memory: &mut memory,
        };
        self.task.begin(&mut start).map_err(|e| e.to_string())?;
        let [start] = starts;
        let state = State { pos: start.pos_m, vel: start.vel_m_s, quat: start.quat_xyzw(), ..State::rest() };
        let target_m = [0, 1, 2].map(|k| f64::from(memory[k]));
        if self.detour_m > 0.0 {
            let way = Way::to(target_m, &self.fields[number], self.boxes[number], self.detour_m);
            self.ways[world] = Some(way);
        }
        Ok((state, target_m))
    }

    fn see(&self, world: usize, pos_m: [f32; 3], quat_xyzw: [f32; 4], out: &mut [f32]) {
        let [width, height] = self.size;
        let mut depth = vec![0.0f32; width * height];
        if let Err(e) = self.render(self.layout[world], pos_m, quat_xyzw, &mut depth) {
            let mut fault = self.fault.lock().unwrap_or_else(PoisonError::into_inner);
            fault.get_or_insert_with(|| format!("world {world}: {e}"));
            return out.fill(0.0);
        }
        let ([h, w], near, factor) = (self.block, NEARNESS[0] as f32, NEARNESS[1] as f32);
        let (low, high) = (1.0 / self.far, 1.0 / near);
        for (i, to) in out.iter_mut().enumerate() {
            let (row, col) = (i / (width / w) * h, i % (width / w) * w);
            let rows = (row..row + h).map(|r| &depth[r * width + col..][..w]);
            let least = rows.flatten().copied().fold(f32::INFINITY, f32::min);
            *to = factor * ((1.0 / least.max(near) - low) / (high - low)).clamp(0.0, 1.0);
        }
    }

    fn fault(&self) -> Option<String> {
        self.fault.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    fn distance(&self, world: usize, pos_m: [f32; 3]) -> (f32, [f32; 3]) {
        let (distance, away) = self.fields[self.layout[world]].at(pos_m.map(f64::from));
        (distance as f32, away.map(|v| v as f32))
    }

    fn detour(&self, world: usize, pos_m: [f32; 3]) -> [f32; 3] {
        self.ways[world].as_ref().map_or([0.0; 3], |way| way.detour(pos_m.map(f64::from)).map(|v| v as f32))
    }
}

/// Trains a policy that crosses the forests of an environment by its depth camera ([`TaskConfig::ForestDepth`], with attitude actions), by backpropagation through time
/// in the same scenes, from the same starts to the same goals. The environment says what flies, where, what it sees, how often it acts and how far actions
/// reach; `options` the rest (its substeps, rate of the simulation and seed are those of the environment). Nothing moves in the forests, and drones fly without noise, delay
/// and randomisation, so that an environment that has them is refused.
///
/// # Errors
/// [`EnvError::Option`] for another task and other actions, for several drones, without a camera, and for scenes in which something moves; those of
/// [`Env::new`](crate::env::Env::new) and of [`train_sighted`].
pub fn train_crossing(
    mut config: EnvConfig,
    goal: &Cross,
    sight: Sight,
    options: &Options,
) -> Result<Crossed, EnvError> {
    let began = Instant::now();
    let TaskConfig::ForestDepth(task) = config.task else {
        return Err(EnvError::option("task", "forest_depth", config.task.name()));
    };
    if !(goal.detour_m >= 0.0 && goal.detour_m.is_finite()) {
        return Err(EnvError::option("goal.detour_m", "a finite number of at least 0", goal.detour_m));
    }
    let (setup, layouts) = ready(&mut config, &Asked::World(Arc::new(task)))?;
    let (actions, options) = (actions_of(&config, &setup), options_of(&config, options));
    let sees = (sight, goal.detour_m);
    let mut scenes = Scenes::new(task, layouts, sees, options.worlds)?;
    let prepared = began.elapsed().as_secs_f64();
    let (vehicle, drone) = (setup.vehicles()[0].clone(), config.sim.drone(0));
    let trained = train_sighted(goal, &mut scenes, (&vehicle, &drone.dynamics), &actions, &options)
        .map_err(EnvError::from)?;
    Ok(Crossed { trained, seconds: [prepared, began.elapsed().as_secs_f64()] })
}

/// The scenes of an environment that a policy can be trained in by gradients, or what stands in the way.
pub(super) fn ready(config: &mut EnvConfig, asked: &Asked) -> Result<(Setup, Vec<Layout>), EnvError> {
    config.check()?;
    config.action.check()?;
    asked.check(config)?;
    if config.action.kind.mode() != ControlMode::Attitude {
        let got = config.action.kind.mode().name();
        return Err(EnvError::option("action kind", "attitude, whose slopes have kernels", got));
    }
    if config.levels != Levels::default() || !config.sim.options.randomization.rules.is_empty() {
        let expected = "an environment without disturbances, delays, noise and randomisation, which this training does not fly with; fly the policy in another one that has them";
        return Err(EnvError::option("env", expected, "one with some"));
    }
    complete(config, asked)?;
    let setup = config.sim.load()?;
    let layouts = Layout::all(&setup)?;
    for layout in &layouts {
        asked.check_course(&layout.course, layout.scene.name())?;
        if !layout.scene.obstacles().is_empty() {
            let expected = "scenes in which nothing moves";
            return Err(EnvError::option("scene", expected, layout.scene.name()));
        }
    }
    if layouts.is_empty() {
        asked.check_course(&Course::default(), "none")?;
    }
    Ok((setup, layouts))
}

/// What actions mean in an environment in which drones act by attitudes.
pub(super) fn actions_of(config: &EnvConfig, setup: &Setup) -> Actions {
    let usual = Actions::attitude(&setup.drones()[0].0);
    let [tilt, yaw] = [config.action.max_tilt_rad, config.action.max_yaw_rad];
    Actions { reach: vec![tilt, tilt, yaw, usual.reach[3]], ..usual }
}

/// Options of a training in an environment, which says its times and its seed.
pub(super) fn options_of(config: &EnvConfig, options: &Options) -> Options {
    let (sim_hz, seed) = (config.sim.options.sim_hz, config.sim.options.seed);
    Options { sim_hz, substeps: config.substeps() as usize, seed, ..options.clone() }
}

impl From<LearnError> for EnvError {
    fn from(error: LearnError) -> Self {
        match error {
            LearnError::Rollout(e) => e.into(),
            LearnError::Vehicle(e) => e.into(),
            LearnError::Option { name, expected, got } => Self::Option { name: name.into(), expected, got },
            other => Self::Learn { what: other.to_string() },
        }
    }
}
