//! What a task is: functions of what one world shows and of what is remembered about it.

use std::borrow::Cow;

use serde::Serialize;

use super::EnvError;
use super::action::ActionKind;
use super::config::EnvConfig;
use super::formulas::{MAX_ACTIONS, TracedTask};
use super::layouts::Course;
use crate::arena::{CameraConfig, Look, SceneConfig};
use crate::math::quat;
use crate::random::Stream;
use crate::scene::{Pose, Worker};
use crate::sense::{Camera, Queries};

/// Numbers that are observed together.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Channel {
    /// Name.
    pub name: Cow<'static, str>,
    /// How many numbers each drone has.
    pub width: usize,
}

impl Channel {
    /// `width` numbers of each drone under a name.
    pub fn new(name: impl Into<Cow<'static, str>>, width: usize) -> Self {
        Self { name: name.into(), width }
    }
}

const fn channel(name: &'static str, width: usize) -> Channel {
    Channel { name: Cow::Borrowed(name), width }
}

/// Observed of every drone in every task: position (m, world), attitude (x y z w, body to world), velocity (m/s, world), angular
/// velocity (rad/s, body).
pub(super) const STATE: [Channel; 4] =
    [channel("pos", 3), channel("quat", 4), channel("vel", 3), channel("ang_vel", 3)];

/// Numbers of [`STATE`].
pub(super) const STATE_WIDTH: usize = 13;

/// How a world goes on after a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Outcome {
    /// The episode goes on.
    #[default]
    Continue,
    /// It ends: a drone touched something.
    Crashed,
    /// It ends: a drone left the space of the task.
    Left,
    /// It ends: the task is done.
    Done,
}

/// Where a drone starts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start {
    /// Position, m, world frame.
    pub pos_m: [f64; 3],
    /// Velocity, m/s, world frame.
    pub vel_m_s: [f64; 3],
    /// Angular velocity, rad/s, body frame.
    pub ang_vel_rad_s: [f64; 3],
    /// Attitude, as the rotation vector from level with the body's x axis along the world's, rad, body to world.
    pub turn_rad: [f64; 3],
}

impl Start {
    /// At rest at a place (m, world frame), heading along x.
    pub fn at(pos_m: [f64; 3]) -> Self {
        Self { pos_m, vel_m_s: [0.0; 3], ang_vel_rad_s: [0.0; 3], turn_rad: [0.0; 3] }
    }

    /// The same, level, with this heading of the body's x axis, rad, from the world's x axis to its y axis.
    pub fn facing(self, yaw_rad: f64) -> Self {
        Self { turn_rad: [0.0, 0.0, yaw_rad], ..self }
    }

    /// Its attitude x y z w, body to world.
    pub fn quat_xyzw(&self) -> [f64; 4] {
        quat::exp(self.turn_rad)
    }
}

/// A new episode of one world.
pub struct EpisodeStart<'a> {
    /// Random numbers of this episode: the same for the same seed, world and episode, whatever else is in the batch.
    pub draw: Stream,
    /// Number of the world in its batch, for messages.
    pub world: usize,
    /// Gates, places and extent of its scene.
    pub course: &'a Course,
    /// Poses in its scene, where it has one.
    pub worker: Option<&'a mut Worker>,
    /// Goals that the caller of the reset asks for, finite, m or m/s in the world frame, where the task takes goals and
    /// some were given. (drone)
    pub goal: Option<&'a [[f64; 3]]>,
    /// Where the drones start, to be filled in. (drone)
    pub starts: &'a mut [Start],
    /// What the task remembers of this world, zero: [`Task::memory_len`] numbers.
    pub memory: &'a mut [f32],
}

impl EpisodeStart<'_> {
    /// A random point in a box with the corners `low` and `high`, uniform.
    pub fn within(&mut self, [low, high]: [[f64; 3]; 2]) -> [f64; 3] {
        core::array::from_fn(|k| self.draw.uniform(low[k], high[k]))
    }

    /// The first drone starts in a box, m, with a velocity within ± `speed_m_s` along each axis.
    pub fn start_within(&mut self, space: [[f64; 3]; 2], speed_m_s: f64) {
        let pos_m = self.within(space);
        let vel_m_s = self.within([[-speed_m_s; 3], [speed_m_s; 3]]);
        self.starts[0] = Start { vel_m_s, ..Start::at(pos_m) };
    }

    /// The goal of a drone that the caller of the reset asks for.
    pub fn given_goal(&self, drone: usize) -> Option<[f64; 3]> {
        self.goal.map(|goals| goals[drone])
    }

    /// The goal of a drone that was asked for, refused unless it lies in `space`, m, which drones must not leave.
    ///
    /// # Errors
    /// [`EnvError::Place`], naming the goal and the space.
    pub fn given_goal_within(
        &self,
        drone: usize,
        space: [[f64; 3]; 2],
    ) -> Result<Option<[f64; 3]>, EnvError> {
        let Some(goal) = self.given_goal(drone) else { return Ok(None) };
        if (0..3).all(|k| (space[0][k]..=space[1][k]).contains(&goal[k])) {
            return Ok(Some(goal));
        }
        Err(EnvError::Place {
            world: self.world,
            what: format!(
                "goal: expected a place in the space of the task, {space:?} m, which drones must not leave, got {goal:?}"
            ),
        })
    }

    /// Distance from drone `drone`, level at `pos_m`, to the nearest thing but other drones, m, at most `range_m`; `range_m`
    /// without a scene. Drones that have a start stand there; the others are far away.
    ///
    /// # Errors
    /// [`EnvError::Scene`] and [`EnvError::Sense`] for a place that is not finite or beyond all scenes.
    pub fn clearance(&mut self, drone: usize, pos_m: [f64; 3], range_m: f64) -> Result<f64, EnvError> {
        let Some(worker) = self.worker.as_deref_mut() else { return Ok(range_m) };
        worker.set_drone(drone, pos_m, [0.0, 0.0, 0.0, 1.0])?;
        worker.update()?;
        Ok(Queries::at(worker).clearance(drone, range_m)?.distance_m)
    }

    /// Puts all drones out of each other's way before places are looked for.
    ///
    /// # Errors
    /// [`EnvError::Scene`].
    pub fn scatter(&mut self) -> Result<(), EnvError> {
        let Some(worker) = self.worker.as_deref_mut() else { return Ok(()) };
        for d in 0..self.starts.len() {
            worker.set_drone(d, [0.0, 0.0, 1e4 + 10.0 * d as f64], [0.0, 0.0, 0.0, 1.0])?;
        }
        Ok(())
    }

    /// A random place in a box with at least `least_m` to everything, for drone `drone`, which stays there. `what` names it in errors.
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
pub struct DroneView {
    /// Position, m, world frame.
    pub pos_m: [f64; 3],
    /// Attitude x y z w, body to world.
    pub quat_xyzw: [f64; 4],
    /// Velocity, m/s, world frame.
    pub vel_m_s: [f64; 3],
    /// Angular velocity, rad/s, body frame.
    pub ang_vel_rad_s: [f64; 3],
    /// Position a step ago, m, world frame; in a new episode that of the start.
    pub previous_pos_m: [f64; 3],
    /// Distance to the nearest thing, m, at most the environment's `look_m`; that without a scene.
    pub clearance_m: f64,
    /// It touched something on its way in this step; without a scene, it is below height zero.
    pub crashed: bool,
}

impl DroneView {
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

/// Depth images of a world, without noise and without delay.
pub struct Images<'a> {
    /// Depth, m; where nothing is seen stands the greatest depth of the camera. (drone, height, width)
    pub depth_m: &'a [f32],
    /// The cameras. (drone)
    pub cameras: &'a [Camera],
    /// Where the cameras were, world frame. (drone)
    pub poses: &'a [Pose],
}

/// A world after a step.
pub struct WorldView<'a> {
    /// Seconds since the episode began.
    pub time_s: f64,
    /// Seconds of a step of the environment.
    pub step_s: f64,
    /// Its drones: as they are in [`Task::judge`], with the noise of the environment in [`Task::observe`].
    pub drones: &'a [DroneView],
    /// What they see, where there are cameras; none in [`Task::observe`].
    pub images: Option<Images<'a>>,
    /// Gates, places and extent of the scene.
    pub course: &'a Course,
    /// How much the action changed since the step before, 0 to 1: the mean over its entries of their change relative to their range,
    /// each at most 1. (drone)
    pub action_change: &'a [f32],
    /// Actions of this step and of the one before, −1 to 1, (drone, action); empty where nobody asks for them.
    pub(super) acted: [&'a [f32]; 2],
    /// Number of the world in its batch.
    pub(super) world: usize,
    pub(super) look: Look<'a, f32>,
}

impl WorldView<'_> {
    /// The action of a drone in this step, each number from −1 to 1, where 0 hovers, whatever units it was given in; zeros behind its numbers.
    pub fn action(&self, drone: usize) -> [f64; MAX_ACTIONS] {
        self.acted_by(self.acted[0], drone)
    }

    /// That of the step before; zeros in the first step of an episode.
    pub fn action_before(&self, drone: usize) -> [f64; MAX_ACTIONS] {
        self.acted_by(self.acted[1], drone)
    }

    fn acted_by(&self, list: &[f32], drone: usize) -> [f64; MAX_ACTIONS] {
        let width = list.len() / self.drones.len().max(1);
        let own = &list[drone * width..(drone + 1) * width];
        core::array::from_fn(|k| own.get(k).map_or(0.0, |v| f64::from(*v)))
    }

    /// What a sensor of the description sampled last, (drone, shape of the channel); none for a sensor or a channel that there is not.
    pub fn samples(&self, sensor: &str, channel: &str) -> Option<&[f32]> {
        self.look.samples(self.world, sensor, channel)
    }
}

/// Where the obstacles of a world stand: the bodies of its scene with `mocap="true"`, in their order there.
pub struct Obstacles<'a> {
    /// Positions, m, world frame. (obstacle)
    pub pos_m: &'a mut [[f64; 3]],
    /// Orientations x y z w, body to world. (obstacle)
    pub quat_xyzw: &'a mut [[f64; 4]],
}

/// What an environment is made with for a task unless its user says otherwise; none: as [`EnvConfig::default`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct TaskDefaults {
    /// Drones in each world.
    pub n_drones: Option<usize>,
    /// Kind of actions.
    pub action: Option<ActionKind>,
    /// Steps of the environment per second.
    pub step_hz: Option<u32>,
    /// Greatest time of an episode, s.
    pub max_episode_s: Option<f64>,
}

/// A task for drones: where episodes start, what is observed beside the state, rewards, and when episodes end.
///
/// A task looks at one world at a time and is shared by threads. What it remembers of a world stands in a row of numbers that the
/// environment keeps, so that results do not depend on threads. `examples/own_task.rs` is a whole one; [`Env::with_task`]
/// makes an environment with it. [`BatchTask`] sees all worlds at once.
///
/// [`Env::with_task`]: super::Env::with_task
/// [`BatchTask`]: super::BatchTask
pub trait Task: Send + Sync {
    /// Its name in descriptions and messages.
    fn name(&self) -> &str {
        std::any::type_name::<Self>()
    }

    /// Refuses options that make no sense for this environment.
    ///
    /// # Errors
    /// Whatever it refuses, such as [`EnvError::Option`].
    fn check(&self, _config: &EnvConfig) -> Result<(), EnvError> {
        Ok(())
    }

    /// Refuses scenes that lack what the task needs; called for each layout, with the name of its scene, and once with an empty course
    /// and the name "none" where there is no scene.
    ///
    /// # Errors
    /// Whatever it refuses, such as [`EnvError::Option`].
    fn check_course(&self, _course: &Course, _scene: &str) -> Result<(), EnvError> {
        Ok(())
    }

    /// Where it takes place unless the user says otherwise, and in how many layouts where scenes are generated.
    fn scene(&self) -> (SceneConfig, Option<usize>) {
        (SceneConfig::None, None)
    }

    /// The camera that it is made for; rendered where there is a scene.
    fn camera(&self) -> Option<CameraConfig> {
        None
    }

    /// What else an environment for it is made with, where a registry of names such as Gymnasium's makes it.
    fn defaults(&self) -> TaskDefaults {
        TaskDefaults::default()
    }

    /// What it observes of every drone beside position, attitude, velocity and angular velocity.
    fn channels(&self) -> Vec<Channel>;

    /// How many numbers it remembers of each world with `n_drones`.
    fn memory_len(&self, _n_drones: usize) -> usize {
        0
    }

    /// Whether goals may be given at a reset: [`EpisodeStart::goal`], three numbers for each drone.
    fn has_goal(&self) -> bool {
        false
    }

    /// Begins an episode: fills in where drones start, and its memory.
    ///
    /// # Errors
    /// [`EnvError::Place`] where no place suits; the reset fails then.
    fn begin(&self, start: &mut EpisodeStart) -> Result<(), EnvError>;

    /// Moves obstacles before a step that ends `time_s` after the episode began; they stand there through the whole step. At a reset they
    /// stand where the scene has them. Called only where the scene has some.
    fn move_obstacles(&self, _memory: &mut [f32], _time_s: f64, _obstacles: &mut Obstacles) {}

    /// Judges a step: writes a finite reward for each drone, zero before, and says how the episode goes on. Called neither for worlds
    /// that have just been reset nor for those whose state stopped being finite.
    fn judge(&self, view: &WorldView, memory: &mut [f32], reward: &mut [f32]) -> Outcome;

    /// Writes its channels of drone `drone`, side by side in their order. `view` may be noisy.
    fn observe(&self, view: &WorldView, memory: &[f32], drone: usize, out: &mut [f32]);

    /// The task as formulas ([`TracedTask::of`]), where it implements [`Formulas`](super::Formulas): an environment whose worlds have one
    /// drone then judges and observes many worlds at once by them, and calls neither [`Task::judge`] nor [`Task::observe`].
    fn formulas(&self) -> Option<TracedTask> {
        None
    }
}

/// Writes numbers as f32.
pub(super) fn store(out: &mut [f32], values: &[f64]) {
    for (to, v) in out.iter_mut().zip(values) {
        *to = *v as f32;
    }
}
