//! What drones are asked to do, one file for each task.

mod forest_depth;
mod gate_race;
mod landing;
mod reach_pos;
mod reach_vel;
mod room_explore;
mod swarm_cross;
mod trajectory;

use serde::{Deserialize, Serialize};

pub use forest_depth::ForestDepth;
pub use gate_race::GateRace;
pub use landing::Landing;
pub use reach_pos::ReachPos;
pub use reach_vel::ReachVel;
pub use room_explore::RoomExplore;
pub use swarm_cross::SwarmCross;
pub use trajectory::Trajectory;

use super::EnvError;
use super::config::EnvConfig;
use super::layouts::Course;
use crate::arena::{CameraConfig, SceneConfig};
use crate::math::{quat, vec3};
use crate::random::Stream;
use crate::scene::{Pose, Worker};
use crate::sense::{Camera, clearance};

/// A task and its options.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum TaskConfig {
    /// Reach a position and stay there.
    ReachPos(ReachPos),
    /// Reach a velocity and keep it.
    ReachVel(ReachVel),
    /// Land at a place, slowly.
    Landing(Landing),
    /// Follow a trajectory.
    Trajectory(Trajectory),
    /// Cross a forest to a goal by a depth camera.
    ForestDepth(ForestDepth),
    /// Fly through gates, one after the other.
    GateRace(GateRace),
    /// See as much of some rooms as there is time for.
    RoomExplore(RoomExplore),
    /// Change places with the drone on the other side, all at once.
    SwarmCross(SwarmCross),
}

impl Default for TaskConfig {
    fn default() -> Self {
        Self::ReachPos(ReachPos::default())
    }
}

impl TaskConfig {
    /// What it does.
    pub(super) fn task(&self) -> &dyn Task {
        match self {
            Self::ReachPos(t) => t,
            Self::ReachVel(t) => t,
            Self::Landing(t) => t,
            Self::Trajectory(t) => t,
            Self::ForestDepth(t) => t,
            Self::GateRace(t) => t,
            Self::RoomExplore(t) => t,
            Self::SwarmCross(t) => t,
        }
    }
}

/// Numbers that are observed together.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Channel {
    /// Name.
    pub name: &'static str,
    /// How many numbers each drone has.
    pub width: usize,
}

/// Observed of every drone in every task: position (m, world), attitude (x y z w, body to world), velocity (m/s, world), angular
/// velocity (rad/s, body).
pub(super) const STATE: [Channel; 4] = [
    Channel { name: "pos", width: 3 },
    Channel { name: "quat", width: 4 },
    Channel { name: "vel", width: 3 },
    Channel { name: "ang_vel", width: 3 },
];

/// Numbers of [`STATE`].
pub(super) const STATE_WIDTH: usize = 13;

/// How a world goes on after a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Outcome {
    #[default]
    Goes,
    /// A drone touched something.
    Crashed,
    /// A drone left the space of the task.
    Left,
    /// The task is done.
    Done,
}

/// Where a drone starts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Start {
    pub pos_m: [f64; 3],
    pub vel_m_s: [f64; 3],
    pub yaw_rad: f64,
}

impl Start {
    pub fn at(pos_m: [f64; 3]) -> Self {
        Self { pos_m, vel_m_s: [0.0; 3], yaw_rad: 0.0 }
    }
}

/// A new episode of one world.
pub(super) struct Beginning<'a> {
    /// Random numbers of this episode.
    pub draw: Stream,
    /// World, for messages.
    pub world: usize,
    /// Gates, places and extent of its scene.
    pub course: &'a Course,
    /// Poses in its scene, where it has one.
    pub worker: Option<&'a mut Worker>,
    /// Where the drones start, to be filled in.
    pub starts: &'a mut [Start],
    /// What the task remembers, zero.
    pub memory: &'a mut [f32],
}

impl Beginning<'_> {
    /// Uniform in a box.
    pub fn within(&mut self, [low, high]: [[f64; 3]; 2]) -> [f64; 3] {
        core::array::from_fn(|k| self.draw.uniform(low[k], high[k]))
    }

    /// The first drone starts in a box, m, with a velocity within ± `speed_m_s` along each axis.
    pub fn start_within(&mut self, space: [[f64; 3]; 2], speed_m_s: f64) {
        let pos_m = self.within(space);
        let vel_m_s = self.within([[-speed_m_s; 3], [speed_m_s; 3]]);
        self.starts[0] = Start { pos_m, vel_m_s, yaw_rad: 0.0 };
    }

    /// Distance from drone `drone`, level at `pos_m`, to the nearest thing but other drones, m, at most `look_m`; `look_m`
    /// without a scene. Drones that have a start stand there; the others are far away.
    pub fn clearance(&mut self, drone: usize, pos_m: [f64; 3], look_m: f64) -> Result<f64, EnvError> {
        let Some(worker) = self.worker.as_deref_mut() else { return Ok(look_m) };
        worker.set_drone(drone, pos_m, [0.0, 0.0, 0.0, 1.0])?;
        worker.update()?;
        Ok(clearance(worker, drone, look_m)?.distance_m)
    }

    /// Puts all drones out of each other's way before places are looked for.
    pub fn scatter(&mut self) -> Result<(), EnvError> {
        let Some(worker) = self.worker.as_deref_mut() else { return Ok(()) };
        for d in 0..self.starts.len() {
            worker.set_drone(d, [0.0, 0.0, 1e4 + 10.0 * d as f64], [0.0, 0.0, 0.0, 1.0])?;
        }
        Ok(())
    }

    /// A random place in a box with at least `least_m` to everything, for drone `drone`, which stays there.
    ///
    /// # Errors
    /// [`EnvError::Place`] when a hundred places were closer.
    pub fn free_place(
        &mut self,
        drone: usize,
        what: &str,
        space: [[f64; 3]; 2],
        least_m: f64,
    ) -> Result<[f64; 3], EnvError> {
        let mut best = f64::NEG_INFINITY;
        for _ in 0..100 {
            let pos = self.within(space);
            let clear = self.clearance(drone, pos, least_m.max(1e-3) * 1.01)?;
            if clear >= least_m {
                return Ok(pos);
            }
            best = best.max(clear);
        }
        Err(EnvError::Place {
            world: self.world,
            what: format!(
                "no {what} with {least_m} m to everything in {space:?} m after 100 tries, the best had {best:.3} m; ask for less \
                 clearance or another space"
            ),
        })
    }
}

/// One drone as a task sees it after a step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    pub pos_m: [f64; 3],
    pub quat_xyzw: [f64; 4],
    pub vel_m_s: [f64; 3],
    pub ang_vel_rad_s: [f64; 3],
    /// Position a step ago.
    pub before_m: [f64; 3],
    /// Distance to the nearest thing, m, at most the environment's `look_m`; that without a scene.
    pub clearance_m: f64,
    /// Touched something in this step.
    pub crashed: bool,
}

impl Seen {
    /// A vector of the world as seen along the drone's heading: forward, left, up.
    pub fn along_heading(&self, v: [f64; 3]) -> [f64; 3] {
        let (sin, cos) = yaw(self.quat_xyzw).sin_cos();
        [cos * v[0] + sin * v[1], -sin * v[0] + cos * v[1], v[2]]
    }
}

/// Heading of the body's x axis, rad.
pub(super) fn yaw(quat_xyzw: [f64; 4]) -> f64 {
    let x = quat::rotate(quat_xyzw, [1.0, 0.0, 0.0]);
    x[1].atan2(x[0])
}

/// Images of a world, without noise.
pub(super) struct Images<'a> {
    /// (drone, height, width), m.
    pub depth_m: &'a [f32],
    pub cameras: &'a [Camera],
    /// (drone)
    pub poses: &'a [Pose],
}

/// A world after a step.
pub(super) struct View<'a> {
    /// Seconds since the episode began.
    pub time_s: f64,
    /// Seconds of a step.
    pub step_s: f64,
    pub drones: &'a [Seen],
    pub images: Option<Images<'a>>,
    pub course: &'a Course,
    /// How much the action changed, 0..=1, mean over entries. (drone)
    pub jerk: &'a [f32],
}

/// A task: functions of what one world shows and of what it remembered about it.
pub(super) trait Task: Send + Sync {
    /// Refuses options that make no sense for this environment.
    fn check(&self, config: &EnvConfig) -> Result<(), EnvError>;

    /// Refuses scenes that lack what the task needs.
    fn check_course(&self, _course: &Course, _scene: &str) -> Result<(), EnvError> {
        Ok(())
    }

    /// Where it takes place unless the user says otherwise, and in how many layouts.
    fn scene(&self) -> (SceneConfig, usize) {
        (SceneConfig::None, 1)
    }

    /// The camera that it is made for.
    fn camera(&self) -> Option<CameraConfig> {
        None
    }

    /// What it observes beside [`STATE`].
    fn channels(&self) -> Vec<Channel>;

    /// Numbers that it remembers of each world with `n_drones`.
    fn memory_len(&self, n_drones: usize) -> usize;

    /// Begins an episode: fills in where drones start, and its memory.
    fn begin(&self, beginning: &mut Beginning) -> Result<(), EnvError>;

    /// Judges a step: a reward for each drone.
    fn judge(&self, view: &View, memory: &mut [f32], reward: &mut [f32]) -> Outcome;

    /// Writes its channels of drone `drone`, in order. `view` may be noisy.
    fn observe(&self, view: &View, memory: &[f32], drone: usize, out: &mut [f32]);
}

/// Refuses options by name.
pub(super) fn in_range(name: &str, got: f64, low: f64, high: f64) -> Result<(), EnvError> {
    if (low..=high).contains(&got) {
        return Ok(());
    }
    Err(EnvError::option(format!("task {name}"), format!("{low} to {high}"), got))
}

/// Refuses boxes whose corners are not in order.
pub(super) fn in_order(name: &str, [low, high]: [[f64; 3]; 2]) -> Result<(), EnvError> {
    if (0..3).all(|k| low[k] <= high[k] && low[k].abs() < 1e6 && high[k].abs() < 1e6) {
        return Ok(());
    }
    Err(EnvError::option(
        format!("task {name}"),
        "two corners (m), the lower first",
        format!("{low:?}, {high:?}"),
    ))
}

/// The camera of tasks that are done by seeing: policies read depths up to 10 m.
pub(super) fn task_camera() -> CameraConfig {
    CameraConfig { range_m: Some([0.02, 10.0]), ..CameraConfig::default() }
}

/// Refuses more than one drone.
pub(super) fn one_drone(task: &str, config: &EnvConfig) -> Result<(), EnvError> {
    if config.sim.n_drones() == 1 {
        return Ok(());
    }
    let expected = format!("1: in the task {task} every world has one drone; swarm_cross has many");
    Err(EnvError::option("n_drones", expected, config.sim.n_drones()))
}

/// Three numbers of the memory.
pub(super) fn load3(memory: &[f32]) -> [f64; 3] {
    core::array::from_fn(|k| f64::from(memory[k]))
}

/// Writes numbers as f32.
pub(super) fn store(out: &mut [f32], values: &[f64]) {
    for (to, v) in out.iter_mut().zip(values) {
        *to = *v as f32;
    }
}

/// Distance of two points, m.
pub(super) fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    vec3::norm(vec3::sub(a, b))
}

/// Whether a point lies in a box.
pub(super) fn is_within(p: [f64; 3], [low, high]: [[f64; 3]; 2]) -> bool {
    (0..3).all(|k| (low[k]..=high[k]).contains(&p[k]))
}

/// Weights that the obstacle tasks share.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Weights {
    /// For each metre nearer to the goal, or along the way.
    pub progress: f64,
    /// For being as near as touching, in each second; falls to zero at `safe_m`.
    pub proximity: f64,
    /// Clearance that costs nothing, m.
    pub safe_m: f64,
    /// For a crash, or for leaving the space.
    pub crash: f64,
    /// For the end of the task.
    pub success: f64,
    /// For an action that changes by its whole range, in each step.
    pub jerk: f64,
}

impl Default for Weights {
    fn default() -> Self {
        Self { progress: 1.0, proximity: 1.0, safe_m: 0.4, crash: 10.0, success: 10.0, jerk: 0.02 }
    }
}

impl Weights {
    pub(super) fn check(&self) -> Result<(), EnvError> {
        for (name, got) in [
            ("weights.progress", self.progress),
            ("weights.proximity", self.proximity),
            ("weights.crash", self.crash),
            ("weights.success", self.success),
            ("weights.jerk", self.jerk),
        ] {
            in_range(name, got, 0.0, 1e6)?;
        }
        in_range("weights.safe_m", self.safe_m, 1e-3, 1e3)
    }

    /// What the end of a task is worth.
    pub(super) fn end(&self, outcome: Outcome) -> f64 {
        match outcome {
            Outcome::Crashed | Outcome::Left => -self.crash,
            Outcome::Done => self.success,
            Outcome::Goes => 0.0,
        }
    }

    /// What nearness and a changing action cost in one step.
    pub(super) fn cost(&self, view: &View, drone: usize) -> f64 {
        let near = (1.0 - view.drones[drone].clearance_m / self.safe_m).clamp(0.0, 1.0);
        self.proximity * near * view.step_s + self.jerk * f64::from(view.jerk[drone])
    }
}
