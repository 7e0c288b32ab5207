//! Tasks that see all worlds at once, as arrays: what Python's tasks are made of.

use super::config::EnvConfig;
use super::layouts::Course;
use super::task::{Channel, EpisodeStart, Outcome, Start, Task, WorldView, store};
use super::tasks::{in_order, in_range};
use super::{Ending, EnvError};
use crate::arena::{CameraConfig, SceneConfig};
use crate::random::{Key, Stream, purpose};
use crate::rollout::origin;

/// What the random numbers of [`Batch::stream`] are for, which makes streams differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Draw {
    /// The beginning of an episode.
    Reset,
    /// Moving obstacles.
    Step,
    /// Judging.
    Judge,
    /// Observing.
    Observe,
}

impl Draw {
    fn purpose(self) -> u32 {
        match self {
            // That of the built-in tasks, so that one written again as a batch task draws the same episodes.
            Self::Reset => BEGIN,
            Self::Step => purpose("env.task.step"),
            Self::Judge => purpose("env.task.judge"),
            Self::Observe => purpose("env.task.observe"),
        }
    }
}

/// Where episodes start.
pub(super) const BEGIN: u32 = purpose("env.begin");

/// Which random numbers a world takes, by its seed and its number.
pub(super) fn episode_key((seed, world): (u64, u64), episode: u64, step: u64, purpose: u32) -> Key {
    // Episodes count from the top bits down, so that steps of two episodes never share a number.
    Key { seed, world, drone: 0, step: episode.rotate_left(40) ^ step, purpose }
}

/// Random numbers of one world at one step of one episode: the same whatever else is in the batch. `origin`: the world's seed and its number
/// ([`Batch::origin`]); `episode` counts from zero; `step` is zero for [`Draw::Reset`].
pub fn episode_stream(origin: (u64, u64), episode: u64, step: u64, what: Draw) -> Stream {
    episode_key(origin, episode, step, what.purpose()).stream()
}

/// A random place with some distance to everything: uniform in a box, taken when it is free.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FreePlace {
    /// Corners of the box, m, world frame, the lower first.
    pub space_m: [[f64; 3]; 2],
    /// Least distance to everything in the scene, m.
    pub clearance_m: f64,
}

/// All worlds of an environment, as arrays in the order of worlds, drones and numbers. Lengths never change.
#[derive(Clone, Debug, Default)]
pub struct Batch {
    /// Number of worlds.
    pub n_worlds: usize,
    /// Drones in each.
    pub n_drones: usize,
    /// Number of the first world over a batch that is split.
    pub first_world: u64,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Seeds of worlds that have their own; else empty. (world)
    pub seeds: Vec<u64>,
    /// Seconds of a step of the environment.
    pub step_s: f64,
    /// Position, m, world frame. (world, drone, 3)
    pub pos: Vec<f32>,
    /// Attitude x y z w, body to world. (world, drone, 4)
    pub quat: Vec<f32>,
    /// Velocity, m/s, world frame. (world, drone, 3)
    pub vel: Vec<f32>,
    /// Angular velocity, rad/s, body frame. (world, drone, 3)
    pub ang_vel: Vec<f32>,
    /// Position a step ago, m; in a new episode that of the start. (world, drone, 3)
    pub previous_pos: Vec<f32>,
    /// As `pos`, with the noise of the environment: what to observe from. Empty where the environment has no noise.
    pub observed_pos: Vec<f32>,
    /// As `quat`, with noise.
    pub observed_quat: Vec<f32>,
    /// As `vel`, with noise.
    pub observed_vel: Vec<f32>,
    /// As `ang_vel`, with noise.
    pub observed_ang_vel: Vec<f32>,
    /// Distance to the nearest thing, m, at most the environment's `look_m`. (world, drone)
    pub clearance: Vec<f32>,
    /// Touched something on its way in the last step; without a scene, is below height zero. (world, drone)
    pub crashed: Vec<bool>,
    /// Depth without noise and delay, m. Empty without cameras. (world, drone, height, width)
    pub depth: Vec<f32>,
    /// The last action, as the caller gave it. (world, drone, action)
    pub action: Vec<f32>,
    /// How much it changed, 0 to 1; see [`WorldView::action_change`]. (world, drone)
    pub action_change: Vec<f32>,
    /// Seconds since the episode began. (world)
    pub time: Vec<f32>,
    /// Steps of the environment since the episode began; 0 in worlds that have just begun, of which what [`BatchTask::judge`] says is
    /// not used. (world)
    pub step: Vec<i64>,
    /// Episodes before this one. (world)
    pub episode: Vec<i64>,
    /// Number of the layout that the world is in. (world)
    pub layout: Vec<i64>,
    /// Worlds that begin an episode, in [`BatchTask::on_reset`]. (world)
    pub begins: Vec<bool>,
    /// Where drones start, m, to be filled in by [`BatchTask::on_reset`] for the worlds that begin: NaN before, or a free place where the
    /// task has a [`BatchTask::start_place`]. (world, drone, 3)
    pub start_pos: Vec<f32>,
    /// Velocities at the start, m/s, world frame, zero before. (world, drone, 3)
    pub start_vel: Vec<f32>,
    /// Headings at the start, rad, zero before. (world, drone)
    pub start_yaw: Vec<f32>,
    /// Goals of tasks that have some ([`BatchTask::has_goal`]), which stay through an episode; empty for others. In worlds that begin:
    /// what the caller of the reset asked for, or else a free place by [`BatchTask::goal_place`], or else NaN, to be filled in by
    /// [`BatchTask::on_reset`]. (world, drone, 3)
    pub goal_pos: Vec<f32>,
    /// In worlds that begin: the caller of the reset asked for their goals. (world)
    pub goal_given: Vec<bool>,
    /// Rewards, to be filled in by [`BatchTask::judge`]; zero before. (world, drone)
    pub reward: Vec<f32>,
    /// How worlds go on, to be filled in by [`BatchTask::judge`]: numbers of [`Ending`], of which `None` (before), `Crashed`, `Left` and
    /// `Done` are a task's to give. (world)
    pub ending: Vec<u8>,
    /// What is observed, to be filled in by [`BatchTask::observe`]: the task's channels side by side. (world, drone, channels)
    pub channels: Vec<f32>,
}

/// How long the arrays of a [`Batch`] are, as far as environments differ in it.
#[derive(Clone, Copy, Debug)]
pub(super) struct BatchSize {
    pub n_worlds: usize,
    pub n_drones: usize,
    pub action_width: usize,
    pub own_width: usize,
    /// Pixels of an image; 0 without cameras.
    pub pixels: usize,
    pub is_noisy: bool,
    pub has_goal: bool,
}

impl Batch {
    pub(super) fn new(config: &EnvConfig, size: BatchSize) -> Self {
        let (n, rows) = (size.n_worlds, size.n_worlds * size.n_drones);
        let numbers = |width: usize| vec![0.0f32; rows * width];
        let noisy = |width: usize| numbers(if size.is_noisy { width } else { 0 });
        Self {
            n_worlds: n,
            n_drones: size.n_drones,
            first_world: config.sim.options.first_world,
            seed: config.sim.options.seed,
            seeds: config.sim.options.seeds.clone(),
            step_s: config.step_s(),
            pos: numbers(3),
            quat: numbers(4),
            vel: numbers(3),
            ang_vel: numbers(3),
            previous_pos: numbers(3),
            observed_pos: noisy(3),
            observed_quat: noisy(4),
            observed_vel: noisy(3),
            observed_ang_vel: noisy(3),
            clearance: numbers(1),
            crashed: vec![false; rows],
            depth: numbers(size.pixels),
            action: numbers(size.action_width),
            action_change: numbers(1),
            time: vec![0.0; n],
            step: vec![0; n],
            episode: vec![0; n],
            layout: vec![0; n],
            begins: vec![false; n],
            start_pos: numbers(3),
            start_vel: numbers(3),
            start_yaw: numbers(1),
            goal_pos: numbers(if size.has_goal { 3 } else { 0 }),
            goal_given: vec![false; n],
            reward: numbers(1),
            ending: vec![0; n],
            channels: numbers(size.own_width),
        }
    }

    /// Lengths of the arrays that a task writes.
    pub(super) fn written(&self) -> [usize; 7] {
        let (pos, vel, yaw) = (self.start_pos.len(), self.start_vel.len(), self.start_yaw.len());
        [pos, vel, yaw, self.goal_pos.len(), self.reward.len(), self.ending.len(), self.channels.len()]
    }

    /// Seed and number by which the random numbers of a world are named.
    pub fn origin(&self, world: usize) -> (u64, u64) {
        origin(self.seed, &self.seeds, self.first_world + world as u64, world)
    }

    /// Random numbers of a world now: the same whatever else is in the batch.
    pub fn stream(&self, world: usize, what: Draw) -> Stream {
        let step = if what == Draw::Reset { 0 } else { self.step[world] as u64 };
        episode_stream(self.origin(world), self.episode[world] as u64, step, what)
    }

    /// Says how a world goes on.
    pub fn end(&mut self, world: usize, outcome: Outcome) {
        self.ending[world] = Ending::from(outcome) as u8;
    }
}

/// Where the obstacles of all worlds stand: the bodies of scenes with `mocap="true"`, in their order there. Rows that the scene of a
/// world does not have are NaN.
pub struct BatchObstacles<'a> {
    /// Rows of each world: those of the scene with most.
    pub n_obstacles: usize,
    /// Positions, m, world frame. (world, obstacle, 3)
    pub pos_m: &'a mut [f64],
    /// Orientations x y z w, body to world. (world, obstacle, 4)
    pub quat_xyzw: &'a mut [f64],
}

/// A task that sees all worlds at once, as arrays, and keeps what it remembers itself.
///
/// Its methods are called one at a time, by one thread, between parts of a step that threads share. What it says of one world must
/// not depend on the others, if results shall not depend on how a batch is split. [`Env::with_batch_task`] makes an environment
/// with it; [`Task`] is simpler where a task looks at one world at a time.
///
/// An error of any method is returned by the reset or the step in which it was called; then all worlds must be reset before the next step.
///
/// [`Env::with_batch_task`]: super::Env::with_batch_task
pub trait BatchTask: Send {
    /// Its name in descriptions and messages.
    fn name(&self) -> &str {
        std::any::type_name::<Self>()
    }

    /// As [`Task::check`].
    ///
    /// # Errors
    /// As there.
    fn check(&self, _config: &EnvConfig) -> Result<(), EnvError> {
        Ok(())
    }

    /// As [`Task::check_course`].
    ///
    /// # Errors
    /// As there.
    fn check_course(&self, _course: &Course, _scene: &str) -> Result<(), EnvError> {
        Ok(())
    }

    /// As [`Task::scene`].
    fn scene(&self) -> (SceneConfig, Option<usize>) {
        (SceneConfig::None, None)
    }

    /// As [`Task::camera`].
    fn camera(&self) -> Option<CameraConfig> {
        None
    }

    /// As [`Task::channels`].
    fn channels(&self) -> Vec<Channel>;

    /// Where drones start unless `on_reset` says otherwise; none: `on_reset` must.
    fn start_place(&self) -> Option<FreePlace> {
        None
    }

    /// Free places that are drawn for each drone into [`Batch::goal_pos`], unless the caller of the reset gives goals.
    fn goal_place(&self) -> Option<FreePlace> {
        None
    }

    /// Whether drones have goals, which may be given at a reset and stand in [`Batch::goal_pos`].
    fn has_goal(&self) -> bool {
        self.goal_place().is_some()
    }

    /// Begins episodes in the worlds of [`Batch::begins`]: fills in where drones start. Their obstacles stand where the scene has them.
    /// Of worlds that begin, arrays other than `begins`, `episode`, `layout`, `start_…` and `goal_pos` still tell of the episode before.
    ///
    /// # Errors
    /// Whatever fails.
    fn on_reset(&mut self, batch: &mut Batch, obstacles: &mut BatchObstacles) -> Result<(), EnvError>;

    /// Moves obstacles before a step; they stand there through the whole step. Called only where a scene has some.
    ///
    /// # Errors
    /// Whatever fails.
    fn before_step(&mut self, _batch: &mut Batch, _obstacles: &mut BatchObstacles) -> Result<(), EnvError> {
        Ok(())
    }

    /// Judges a step: fills in [`Batch::reward`] and [`Batch::ending`]. Called once in each step.
    ///
    /// # Errors
    /// Whatever fails.
    fn judge(&mut self, batch: &mut Batch) -> Result<(), EnvError>;

    /// Fills in [`Batch::channels`], from the observed state where there is noise. Called after every reset and every step, and once more
    /// in steps that begin episodes ([`Autoreset::SameStep`](super::Autoreset::SameStep)), of which rows of other worlds are not used.
    ///
    /// # Errors
    /// Whatever fails.
    fn observe(&mut self, batch: &mut Batch) -> Result<(), EnvError>;
}

/// The places of a batch task, looked for world by world: goals into the memory, then starts; NaN where the task has none.
pub(super) struct Places {
    pub start: Option<FreePlace>,
    pub goal: Option<FreePlace>,
    pub has_goal: bool,
}

impl Places {
    pub fn of(task: &dyn BatchTask) -> Result<Self, EnvError> {
        let places = Self { start: task.start_place(), goal: task.goal_place(), has_goal: task.has_goal() };
        for (name, place) in [("start", places.start), ("goal", places.goal)] {
            if let Some(place) = place {
                in_order(&format!("{name}_space"), place.space_m)?;
                in_range(&format!("{name}_clearance"), place.clearance_m, 0.0, 100.0)?;
            }
        }
        if places.goal.is_some() && !places.has_goal {
            return Err(EnvError::option("task has_goal", "true for a task with a goal_space", false));
        }
        Ok(places)
    }
}

impl Task for Places {
    fn channels(&self) -> Vec<Channel> {
        Vec::new()
    }

    fn memory_len(&self, n_drones: usize) -> usize {
        if self.has_goal { 3 * n_drones } else { 0 }
    }

    fn has_goal(&self) -> bool {
        self.has_goal
    }

    fn begin(&self, b: &mut EpisodeStart) -> Result<(), EnvError> {
        b.scatter()?;
        for d in 0..if self.has_goal { b.starts.len() } else { 0 } {
            let drawn = match self.goal {
                Some(place) => b.free_place(d, "goal", place.space_m, place.clearance_m)?,
                None => [f64::NAN; 3],
            };
            let goal = b.given_goal(d).unwrap_or(drawn);
            store(&mut b.memory[3 * d..3 * d + 3], &goal);
            b.scatter()?;
        }
        for d in 0..b.starts.len() {
            b.starts[d] = match self.start {
                Some(place) => Start::at(b.free_place(d, "start", place.space_m, place.clearance_m)?),
                None => Start::at([f64::NAN; 3]),
            };
        }
        Ok(())
    }

    fn judge(&self, _: &WorldView, _: &mut [f32], _: &mut [f32]) -> Outcome {
        Outcome::Continue
    }

    fn observe(&self, _: &WorldView, _: &[f32], _: usize, _: &mut [f32]) {}
}
