//! Worlds that are reset, flown, seen and judged together.

mod act;
mod batched;
mod build;
pub mod crossing;
mod judging;
mod rows;
mod sensors;
pub mod swapping;
mod ways;
mod world;

use std::sync::Arc;

use rayon::prelude::*;

use self::batched::Batched;
use self::judging::Formulas;
use self::rows::Rows;
pub use self::sensors::EnvSensorChannel;
use self::sensors::Sensors;
use self::world::{Acted, FREE_PLACES, Out, Plan, World};
use super::EnvError;
use super::action::{Limits, SetPoint};
use super::batch_task::{BEGIN, BatchObstacles};
use super::config::{Autoreset, EnvConfig};
use super::layouts::{Course, Layout};
use super::randomize::Levels;
use super::task::{Channel, Obstacles, Outcome, STATE, Task, store, yaw};
use crate::arena::{Arena, CameraConfig, Look, SceneConfig};
use crate::math::{quat, vec3};
use crate::rollout::Sim;
use crate::rollout::pool::threads;
use crate::scene::Scene;

/// Why an episode has ended, if it has.
#[repr(u8)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Ending {
    /// It goes on.
    #[default]
    None = 0,
    /// A drone touched something, or the ground at height zero where there is no scene.
    Crashed = 1,
    /// A drone left the space of the task.
    Left = 2,
    /// The task is done.
    Done = 3,
    /// Its time is over.
    TimeUp = 4,
    /// The state stopped being finite, and the world was quarantined.
    Quarantined = 5,
}

impl Ending {
    /// By its number, of those that a task gives; any other number is none.
    fn by_task(number: u8) -> Self {
        [Self::None, Self::Crashed, Self::Left, Self::Done]
            .get(usize::from(number))
            .copied()
            .unwrap_or_default()
    }
}

impl From<Outcome> for Ending {
    fn from(outcome: Outcome) -> Self {
        match outcome {
            Outcome::Continue => Self::None,
            Outcome::Crashed => Self::Crashed,
            Outcome::Left => Self::Left,
            Outcome::Done => Self::Done,
        }
    }
}

/// What is asked of the drones.
enum Asked {
    /// A task that sees one world at a time.
    World(Arc<dyn Task>),
    /// One that sees all at once.
    Batch(Box<Batched>),
}

/// Answers of either kind of task.
macro_rules! either {
    ($asked:expr, $task:ident => $answer:expr) => {
        match $asked {
            Asked::World($task) => $answer,
            Asked::Batch(batched) => {
                let $task = &batched.task;
                $answer
            }
        }
    };
}

impl Asked {
    fn name(&self) -> String {
        either!(self, task => task.name().to_string())
    }

    fn check(&self, config: &EnvConfig) -> Result<(), EnvError> {
        either!(self, task => task.check(config))
    }

    fn check_course(&self, course: &Course, scene: &str) -> Result<(), EnvError> {
        either!(self, task => task.check_course(course, scene))
    }

    fn scene(&self) -> (SceneConfig, Option<usize>) {
        either!(self, task => task.scene())
    }

    fn camera(&self) -> Option<CameraConfig> {
        either!(self, task => task.camera())
    }

    fn channels(&self) -> Vec<Channel> {
        either!(self, task => task.channels())
    }

    fn memory_len(&self, n_drones: usize) -> usize {
        match self {
            Self::World(task) => task.memory_len(n_drones),
            Self::Batch(batched) => batched.places.memory_len(n_drones),
        }
    }

    /// What places drones at the beginning of an episode, and by which random numbers.
    fn places(&self) -> (&dyn Task, u32) {
        match self {
            Self::World(task) => (&**task, BEGIN),
            Self::Batch(batched) => (&batched.places, FREE_PLACES),
        }
    }

    /// The task that judges and observes one world at a time.
    fn of_worlds(&self) -> Option<&dyn Task> {
        match self {
            Self::World(task) => Some(&**task),
            Self::Batch(_) => None,
        }
    }
}

/// A batch of worlds.
///
/// ```
/// use propwash::prelude::*;
///
/// let config = EnvConfig::from_text("n_worlds = 16\ntask = { kind = \"reach_pos\" }")?;
/// let mut env = Env::new(config)?;
/// env.reset(Some(1), None)?;
/// for _ in 0..10 {
///     env.step(&vec![0.0; 16 * env.action_width()])?; // zero hovers
/// }
/// assert_eq!((env.reward().len(), env.observation().len() % 16), (16, 0));
/// # Ok::<(), propwash::Error>(())
/// ```
pub struct Env {
    plan: Plan,
    asked: Asked,
    layouts: Vec<Layout>,
    arena: Arena<f32>,
    worlds: Vec<World>,
    rows: Rows,
    /// Those of the task, where it has some and worlds have one drone.
    formulas: Option<Formulas>,
    /// Which worlds to reset; reused.
    mask: Vec<bool>,
    /// Due times of commands within a step; reused.
    dues: Vec<u64>,
    reset_done: bool,
    /// A first reset was tried.
    begun: bool,
    observation: Vec<f32>,
    depth: Vec<f32>,
    reward: Vec<f32>,
    terminated: Vec<bool>,
    truncated: Vec<bool>,
    ending: Vec<u8>,
    clearance: Vec<f32>,
    crashed: Vec<bool>,
    /// How much actions changed since the step before, 0 to 1. (world, drone)
    action_change: Vec<f32>,
    final_observation: Vec<f32>,
    final_depth: Vec<f32>,
    sensors: Sensors,
}

impl std::fmt::Debug for Env {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Env")
            .field("config", &self.plan.config)
            .field("layouts", &self.layouts.len())
            .finish_non_exhaustive()
    }
}

/// Worlds below which one thread does all, without and with a scene.
const SERIAL: [usize; 2] = [256, 2];

impl Env {
    /// What it was made of, with the scene and the camera that the task chose.
    pub fn config(&self) -> &EnvConfig {
        &self.plan.config
    }

    /// What is observed of every drone, in the order of columns of [`Env::observation`].
    pub fn channels(&self) -> Vec<Channel> {
        let own = self.asked.channels();
        STATE.into_iter().chain(own).collect()
    }

    /// Numbers of one drone's action.
    pub fn action_width(&self) -> usize {
        self.plan.action_width
    }

    /// Least and greatest numbers of actions, (drone, action).
    pub fn action_limits(&self) -> (Vec<f32>, Vec<f32>) {
        if self.plan.config.action.normalized {
            let n = self.plan.config.sim.n_drones() * self.plan.action_width;
            return (vec![-1.0; n], vec![1.0; n]);
        }
        let of = |pick: fn(&Limits) -> &Vec<f64>| {
            self.plan.limits.iter().flat_map(|l| pick(l).iter().map(|v| *v as f32)).collect()
        };
        (of(|l| &l.low), of(|l| &l.high))
    }

    /// Width and height of images, zero without a camera.
    pub fn image_size(&self) -> [usize; 2] {
        self.plan.size
    }

    /// Least and greatest depth of images, m.
    pub fn depth_range_m(&self) -> [f64; 2] {
        self.plan.range_m
    }

    /// What was observed, (world, drone, channels): [`Env::channels`] side by side.
    pub fn observation(&mut self) -> &mut [f32] {
        &mut self.observation
    }

    /// Depth images, m, (world, drone, height, width); where nothing is seen stands the greatest depth. Empty without a camera.
    pub fn depth(&mut self) -> &mut [f32] {
        let n = if self.plan.pixels == 0 { 0 } else { self.depth.len() };
        &mut self.depth[..n]
    }

    /// Rewards of the last step, (world, drone).
    pub fn reward(&mut self) -> &mut [f32] {
        &mut self.reward
    }

    /// Whether the episode ended in the last step by what happened, (world).
    pub fn terminated(&mut self) -> &mut [bool] {
        &mut self.terminated
    }

    /// Whether it ended in the last step since its time was over, (world).
    pub fn truncated(&mut self) -> &mut [bool] {
        &mut self.truncated
    }

    /// [`Ending`] of the last step, (world).
    pub fn ending(&mut self) -> &mut [u8] {
        &mut self.ending
    }

    /// Distance to the nearest thing after the last step, m, at most `look_m`, which it is without a scene too. (world, drone)
    pub fn clearance(&mut self) -> &mut [f32] {
        &mut self.clearance
    }

    /// With [`Autoreset::SameStep`]: what worlds that ended in the last step had observed, as [`Env::observation`]; rows of other
    /// worlds mean nothing.
    pub fn final_observation(&mut self) -> &mut [f32] {
        &mut self.final_observation
    }

    /// As [`Env::final_observation`], images.
    pub fn final_depth(&mut self) -> &mut [f32] {
        let n = if self.plan.pixels == 0 { 0 } else { self.final_depth.len() };
        &mut self.final_depth[..n]
    }

    /// What sensors of the description give, in the order of sensors and channels.
    pub fn sensor_channels(&self) -> &[EnvSensorChannel] {
        &self.sensors.channels
    }

    /// What a sensor sampled last, (world, drone, shape of the channel).
    ///
    /// # Errors
    /// [`EnvError::Option`] for a sensor or a channel that there is not.
    pub fn samples(&mut self, sensor: &str, channel: &str) -> Result<&mut [f32], EnvError> {
        let number = self.arena.sensor(sensor)?;
        Ok(self.arena.samples_mut(number, channel)?)
    }

    /// As [`Env::final_observation`], what a sensor had sampled.
    ///
    /// # Errors
    /// As [`Env::samples`].
    pub fn final_samples(&mut self, sensor: &str, channel: &str) -> Result<&mut [f32], EnvError> {
        let number = self.arena.sensor(sensor)?;
        self.arena.samples(number, channel)?;
        Ok(self.sensors.final_samples(sensor, channel))
    }

    /// Whether an entry of the last action of a world lay outside its limits and was held within them.
    pub fn clipped(&self, world: usize) -> bool {
        self.rows.clipped[world]
    }

    /// Whether an entry of the last action of any world was.
    pub fn any_clipped(&self) -> bool {
        self.rows.clipped.contains(&true)
    }

    /// Layout in which a world flies, by number.
    pub fn layout(&self, world: usize) -> usize {
        self.worlds[world].layout
    }

    /// The scene of a layout.
    pub fn scene(&self, layout: usize) -> Option<&Scene> {
        self.layouts.get(layout).map(|l| &l.scene)
    }

    /// Gates, places and extent of a layout.
    pub fn course(&self, layout: usize) -> Option<&Course> {
        self.layouts.get(layout).map(|l| &l.course)
    }

    /// Levels of a world's episode.
    pub fn levels(&self, world: usize) -> &Levels {
        &self.worlds[world].levels
    }

    /// The simulation.
    pub fn flight(&self) -> &Sim<f32> {
        self.arena.sim()
    }

    /// The worlds as they are now, to be looked at.
    pub fn look(&self) -> Look<'_, f32> {
        self.arena.look()
    }

    /// Whether a step is shared by threads.
    pub fn is_parallel(&self) -> bool {
        let serial = SERIAL[usize::from(!self.layouts.is_empty())];
        self.worlds.len() >= serial || self.arena.is_parallel(self.plan.config.substeps() as usize)
    }

    /// Whether all of a step heeds [`alone`](crate::rollout::pool::alone): what scenes and sensors do is shared by threads of the pool.
    pub fn can_be_alone(&self) -> bool {
        self.layouts.is_empty() && self.sensors.channels.is_empty()
    }

    /// Begins new episodes in all worlds, or in those whose entry is true. A seed, which needs all worlds, starts the random numbers
    /// anew: everything that follows is that of a new batch with this seed.
    ///
    /// # Errors
    /// [`EnvError::Length`] for a mask of another length, [`EnvError::Option`] for a seed with a mask, [`EnvError::Place`] where a task
    /// finds no place to start from; then no world can be stepped before a reset that succeeds.
    pub fn reset(&mut self, seed: Option<u64>, mask: Option<&[bool]>) -> Result<(), EnvError> {
        self.reset_to(seed, mask, None)
    }

    /// Whether [`Env::reset_to`] takes goals.
    pub fn has_goal(&self) -> bool {
        self.asked.places().0.has_goal()
    }

    /// As [`Env::reset`]; the episodes that it begins have these goals, (world, drone), in the units of the task (m or m/s, world
    /// frame). Later ones have drawn goals again.
    ///
    /// # Errors
    /// As [`Env::reset`], [`EnvError::Option`] for goals that are not finite and for a task that has none to be given,
    /// [`EnvError::Length`], and [`EnvError::Place`] for goals outside of the space of a task that drones must not leave.
    pub fn reset_to(
        &mut self,
        seed: Option<u64>,
        mask: Option<&[bool]>,
        goal: Option<&[[f64; 3]]>,
    ) -> Result<(), EnvError> {
        self.begin_by(seed, None, mask, goal)
    }

    /// As [`Env::reset_to`], in all worlds, each with a seed of its own: its episodes are those of the first world of a batch with that seed.
    ///
    /// # Errors
    /// As [`Env::reset_to`], and [`EnvError::Length`] for another number of seeds than worlds.
    pub fn reset_each(&mut self, seeds: &[u64], goal: Option<&[[f64; 3]]>) -> Result<(), EnvError> {
        let n = self.worlds.len();
        if seeds.len() != n {
            let shape = format!("{n} worlds");
            return Err(EnvError::Length { name: "seeds", expected: n, shape, got: seeds.len() });
        }
        self.begin_by(None, Some(seeds), None, goal)
    }

    fn begin_by(
        &mut self,
        seed: Option<u64>,
        seeds: Option<&[u64]>,
        mask: Option<&[bool]>,
        goal: Option<&[[f64; 3]]>,
    ) -> Result<(), EnvError> {
        let n = self.worlds.len();
        self.check_goal(goal, mask)?;
        if let Some(mask) = mask
            && mask.len() != n
        {
            let shape = format!("{n} worlds");
            return Err(EnvError::Length { name: "reset mask", expected: n, shape, got: mask.len() });
        }
        if let Some(seed) = seed {
            if mask.is_some_and(|m| m.iter().any(|v| !v)) {
                return Err(EnvError::option("seed", "none with a mask: a seed is that of all worlds", seed));
            }
            let options = &mut self.plan.config.sim.options;
            options.seed = seed;
            options.seeds.clear();
            self.arena.reseed(seed);
        } else if let Some(seeds) = seeds {
            self.plan.config.sim.options.seeds = seeds.to_vec();
            self.arena.reseed_each(seeds)?;
        } else if !self.begun {
            // The first episodes are those that the seeds of the description give.
            let options = &self.plan.config.sim.options;
            match options.seeds.is_empty() {
                true => self.arena.reseed(options.seed),
                false => self.arena.reseed_each(&options.seeds)?,
            }
        }
        if !self.reset_done && mask.is_some_and(|m| m.iter().any(|v| !v)) {
            return Err(EnvError::option(
                "reset mask",
                "none before the first reset of all worlds",
                "one that leaves worlds out",
            ));
        }
        self.begun = true;
        let mut own = std::mem::take(&mut self.mask);
        match mask {
            Some(mask) => own.copy_from_slice(mask),
            None => own.fill(true),
        }
        let outcome = self.begin(&own, goal);
        let outcome = outcome.and_then(|()| {
            for (w, _) in own.iter().enumerate().filter(|(_, m)| **m) {
                self.terminated[w] = false;
                self.truncated[w] = false;
                self.ending[w] = 0;
                let d = self.plan.config.sim.n_drones();
                self.reward[w * d..(w + 1) * d].fill(0.0);
            }
            self.observe_and_judge(Some(&own), false)
        });
        self.mask = own;
        self.reset_done = outcome.is_ok();
        outcome
    }

    /// Refuses goals that cannot be given.
    fn check_goal(&self, goal: Option<&[[f64; 3]]>, mask: Option<&[bool]>) -> Result<(), EnvError> {
        let Some(goal) = goal else { return Ok(()) };
        if !self.has_goal() {
            let expected = format!("none: the task {} takes no goals", self.plan.config.task.name());
            return Err(EnvError::option("goal", expected, "some"));
        }
        let (n, d) = (self.worlds.len(), self.plan.config.sim.n_drones());
        if goal.len() != n * d {
            let shape = format!("{n} worlds x {d} drones x 3");
            return Err(EnvError::Length { name: "goal", expected: 3 * n * d, shape, got: 3 * goal.len() });
        }
        // Beyond this f32 has no fractions of a metre left.
        let odd = |v: &f64| !(v.abs() < 1e6);
        let is_used = |row: usize| mask.is_none_or(|m| m.get(row / d) == Some(&true));
        let found = goal.iter().enumerate().position(|(row, goal)| is_used(row) && goal.iter().any(odd));
        if let Some(row) = found {
            let name = format!("goal of world {}, drone {}", row / d, row % d);
            return Err(EnvError::option(
                name,
                "three numbers between -1e6 and 1e6",
                format!("{:?}", goal[row]),
            ));
        }
        Ok(())
    }

    /// Flies one step of the environment with `actions`, (world, drone, action), judges and observes.
    ///
    /// # Errors
    /// [`EnvError::Length`] and [`EnvError::Action`] for actions that cannot be flown, [`EnvError::Ended`]; nothing is changed then.
    /// After any other error, such as [`EnvError::NotFinite`] of a task, all worlds must be reset before the next step.
    pub fn step(&mut self, actions: &[f32]) -> Result<(), EnvError> {
        self.check_step(actions)?;
        let outcome = self.fly_and_judge(actions);
        self.reset_done = outcome.is_ok();
        outcome
    }

    /// Refuses actions that cannot be flown, or not now.
    fn check_step(&self, actions: &[f32]) -> Result<(), EnvError> {
        let (n, d, width) = (self.worlds.len(), self.plan.config.sim.n_drones(), self.plan.action_width);
        if actions.len() != n * d * width {
            let shape = format!("{n} worlds x {d} drones x {width}");
            return Err(EnvError::Length {
                name: "action",
                expected: n * d * width,
                shape,
                got: actions.len(),
            });
        }
        if let Some(i) = actions.iter().position(|v| !v.is_finite()) {
            let (world, drone, entry) = (i / (d * width), i / width % d, i % width);
            return Err(EnvError::Action { world, drone, entry, got: actions[i] });
        }
        if !self.reset_done {
            return Err(EnvError::option("step", "a reset of all worlds first", "none"));
        }
        let autoreset = self.plan.config.autoreset;
        if autoreset == Autoreset::Disabled
            && let Some(world) = self.rows.ended.iter().position(|ended| *ended)
        {
            return Err(EnvError::Ended { world });
        }
        Ok(())
    }

    /// A step whose actions have been checked.
    fn fly_and_judge(&mut self, actions: &[f32]) -> Result<(), EnvError> {
        let (d, autoreset) = (self.plan.config.sim.n_drones(), self.plan.config.autoreset);
        self.act(actions);
        if let Asked::Batch(batched) = &mut self.asked {
            batched.batch.action.copy_from_slice(actions);
        }
        if self.arena.n_obstacles() > 0 {
            self.move_obstacles()?;
        }
        self.fly()?;
        if autoreset == Autoreset::NextStep && self.rows.ended.contains(&true) {
            let mut mask = std::mem::take(&mut self.mask);
            mask.copy_from_slice(&self.rows.ended);
            let outcome = self.begin(&mask, None);
            self.mask = mask;
            outcome?;
        }
        self.observe_and_judge(None, true)?;
        if autoreset == Autoreset::SameStep && self.rows.ended.contains(&true) {
            let mut mask = std::mem::take(&mut self.mask);
            let (row, image) = (d * self.plan.width, (d * self.plan.pixels).max(1));
            for (w, (m, ended)) in mask.iter_mut().zip(&self.rows.ended).enumerate() {
                *m = *ended;
                if *ended {
                    let (o, i) = (w * row..(w + 1) * row, w * image..(w + 1) * image);
                    self.final_observation[o.clone()].copy_from_slice(&self.observation[o]);
                    self.final_depth[i.clone()].copy_from_slice(&self.depth[i]);
                }
            }
            self.sensors.keep_final(&self.arena, &mask)?;
            let outcome = self.begin(&mask, None).and_then(|()| self.observe_and_judge(Some(&mask), false));
            self.mask = mask;
            outcome?;
        }
        Ok(())
    }

    /// Flies one step of the environment; commands become those of the controllers when they are due.
    fn fly(&mut self) -> Result<(), EnvError> {
        let plan = &self.plan;
        let each = plan.config.sim.n_drones() * plan.command_width;
        let substeps = u64::from(plan.config.substeps());
        if !plan.is_late() {
            return Ok(self.arena.step(substeps as usize)?);
        }
        self.dues.clear();
        for world in &self.worlds {
            if !self.dues.contains(&world.due) {
                self.dues.push(world.due);
            }
        }
        self.dues.sort_unstable();
        let mut flown = 0;
        for i in 0..self.dues.len() {
            let due = self.dues[i];
            if due > flown {
                self.arena.step((due - flown) as usize)?;
                flown = due;
            }
            let data = self.arena.data_mut();
            let rows = self.rows.step.iter().zip(data.command.chunks_exact_mut(each));
            for (world, (step, row)) in self.worlds.iter().zip(rows) {
                if world.due == due {
                    // Before the first command of an episode the slots hold the neutral one.
                    let ring = plan.command_ring as u64;
                    let slot = ((step + ring - world.late) % ring) as usize;
                    row.copy_from_slice(&world.commands[slot * each..(slot + 1) * each]);
                }
            }
        }
        self.arena.step((substeps - flown) as usize)?;
        Ok(())
    }

    /// Moves obstacles before a step, if the task does.
    fn move_obstacles(&mut self) -> Result<(), EnvError> {
        let n = self.arena.n_obstacles();
        let (pos_m, quat_xyzw) = self.arena.obstacles_mut();
        match &mut self.asked {
            Asked::World(task) => {
                let rows = pos_m.chunks_exact_mut(3 * n).zip(quat_xyzw.chunks_exact_mut(4 * n));
                for (w, (world, (pos, quat))) in self.worlds.iter().zip(rows).enumerate() {
                    let own = self.layouts[world.layout].scene.obstacles().len();
                    let (pos, quat) = (pos.as_chunks_mut::<3>().0, quat.as_chunks_mut::<4>().0);
                    let mut obstacles = Obstacles { pos_m: &mut pos[..own], quat_xyzw: &mut quat[..own] };
                    let time_s = (self.rows.step[w] + 1) as f64 * self.plan.config.step_s();
                    task.move_obstacles(self.rows.memory_of_mut(w), time_s, &mut obstacles);
                }
                Ok(())
            }
            Asked::Batch(batched) => {
                let mut obstacles = BatchObstacles { n_obstacles: n, pos_m, quat_xyzw };
                batched.task.before_step(&mut batched.batch, &mut obstacles)
            }
        }
    }

    /// Begins episodes in the worlds of the mask, with goals if some are given.
    fn begin(&mut self, mask: &[bool], goal: Option<&[[f64; 3]]>) -> Result<(), EnvError> {
        self.arena.reset_flight(Some(mask))?;
        let (plan, layouts) = (&self.plan, &self.layouts);
        // Which scene a world is in comes first: tasks look for a start in it.
        for (w, world) in self.worlds.iter_mut().enumerate().filter(|(w, _)| mask[*w]) {
            plan.begin(w, world, layouts.len(), self.arena.sim().data.episodes[w] - 1);
            self.rows.begin(w);
            let d = plan.config.sim.n_drones();
            self.action_change[w * d..(w + 1) * d].fill(0.0);
        }
        if !layouts.is_empty() {
            let of_worlds: Vec<usize> = self.worlds.iter().map(|world| world.layout).collect();
            self.arena.move_to_layouts(&of_worlds)?;
            self.arena.reset_obstacles(mask)?;
        }
        let (look, places, d) = (self.arena.look(), self.asked.places(), plan.config.sim.n_drones());
        let (stride, memory_len) = (self.rows.memory_stride, self.rows.memory_len);
        let begin = |(w, (world, memory)): (usize, (&mut World, &mut [f32]))| {
            if !mask[w] {
                return Ok(());
            }
            let goal = goal.map(|goals| &goals[w * d..(w + 1) * d]);
            plan.place(w, (world, &mut memory[..memory_len]), layouts, look, places, goal)
        };
        let many = mask.iter().filter(|m| **m).count();
        if many >= SERIAL[usize::from(!layouts.is_empty())] && threads() > 1 {
            let rows = self.worlds.par_iter_mut().zip(self.rows.memory.par_chunks_mut(stride));
            rows.enumerate().map(begin).collect::<Result<Vec<()>, _>>()?;
        } else {
            let mut rows = self.worlds.iter_mut().zip(self.rows.memory.chunks_mut(stride)).enumerate();
            rows.try_for_each(begin)?;
        }
        self.ask_batch_for_starts(mask, goal.is_some())?;
        self.put_at_starts(mask);
        Ok(())
    }

    /// Puts the drones of worlds that begin where they start.
    fn put_at_starts(&mut self, mask: &[bool]) {
        let plan = &self.plan;
        let disturbed = !plan.rules.is_empty() || plan.config.levels.disturb();
        // The wind of a scene blows beside the one that is drawn.
        let wind = |w: usize| self.arena.scene(w).map_or([0.0; 3], Scene::wind_m_s);
        let winds: Vec<_> = (0..mask.len()).filter(|_| disturbed).map(wind).collect();
        let data = self.arena.data_mut();
        for (w, world) in self.worlds.iter_mut().enumerate().filter(|(w, _)| mask[*w]) {
            for d in 0..plan.config.sim.n_drones() {
                // Rules for `initial.…` have moved it from rest at the origin.
                let (mut s, start) = (data.state(w, d), world.starts[d]);
                s.pos = vec3::add(start.pos_m, s.pos);
                s.vel = vec3::add(start.vel_m_s, s.vel);
                s.ang_vel = vec3::add(start.ang_vel_rad_s, s.ang_vel);
                s.quat = quat::normalize(quat::mul(start.quat_xyzw(), s.quat));
                data.set_state(w, d, &s);
                world.set_points[d] = SetPoint { pos_m: s.pos, vel_m_s: s.vel, yaw_rad: yaw(s.quat) };
                if disturbed {
                    let row = data.row(w, d);
                    let wind = vec3::add(world.levels.wind_m_s, winds[w]);
                    store(&mut data.wind[3 * row..3 * row + 3], &wind);
                    store(&mut data.disturbance_force[3 * row..3 * row + 3], &world.levels.force_n);
                }
            }
            let each = plan.config.sim.n_drones() * plan.command_width;
            plan.fill_neutral(world, &mut data.command[w * each..(w + 1) * each]);
        }
    }

    /// Looks at worlds (those of a mask, or all), judges them where they have flown, and observes.
    fn observe_and_judge(&mut self, mask: Option<&[bool]>, judge: bool) -> Result<(), EnvError> {
        // First, so that tasks can see by sensors too.
        self.sensors.sample(&mut self.arena, &self.plan.config, mask)?;
        if judge {
            // A world that has just begun, also within a step, has flown nothing.
            for (step, flown) in self.rows.step.iter_mut().zip(&self.arena.sim().data.steps) {
                *step += u64::from(*flown != 0);
            }
        }
        // Each by itself where something must be asked of it: scenes, noise, a task that sees one world at a time.
        let by_world = matches!(self.asked, Asked::World(_)) && self.formulas.is_none();
        let one_by_one = by_world || !self.layouts.is_empty() || self.plan.is_noisy;
        if one_by_one {
            self.look_at_worlds(mask, judge)?;
        }
        self.look_at_rows(mask, judge, one_by_one)?;
        self.ask_batch(mask, judge)
    }

    /// The part of it that is done world by world.
    fn look_at_worlds(&mut self, mask: Option<&[bool]>, judge: bool) -> Result<(), EnvError> {
        let task = self.asked.of_worlds().filter(|_| self.formulas.is_none());
        let (plan, layouts, look) = (&self.plan, &self.layouts, self.arena.look());
        let d = plan.config.sim.n_drones();
        let (row, image) = (d * plan.width, (d * plan.pixels).max(1));
        let Rows { step, ended, memory, memory_len, memory_stride, acted, .. } = &mut self.rows;
        let n = self.worlds.len();
        let acted = |w: usize| Acted {
            change: &self.action_change[w * d..(w + 1) * d],
            actions: Rows::acted_in(acted, w, n),
        };
        let one = |w: usize, world: &mut World, out: Out| {
            if mask.is_some_and(|m| !m[w]) {
                return Ok(());
            }
            plan.observe_and_judge(task, w, world, layouts.get(world.layout), look, judge, out)
        };
        if self.worlds.len() >= SERIAL[usize::from(!layouts.is_empty())] && threads() > 1 {
            self.worlds
                .par_iter_mut()
                .zip(self.observation.par_chunks_mut(row).zip(self.depth.par_chunks_mut(image)))
                .zip(self.terminated.par_iter_mut().zip(&mut self.truncated).zip(&mut self.ending))
                .zip(self.clearance.par_chunks_mut(d).zip(self.crashed.par_chunks_mut(d)))
                .zip(self.reward.par_chunks_mut(d))
                .zip(step.par_iter().zip(ended).zip(memory.par_chunks_mut(*memory_stride)))
                .enumerate()
                .map(|(w, (((((world, seen), endings), touched), reward), kept))| {
                    let ((observation, depth), ((terminated, truncated), ending)) = (seen, endings);
                    let ((clearance, crashed), ((step, ended), memory)) = (touched, kept);
                    let out = Out {
                        step: *step,
                        memory: &mut memory[..*memory_len],
                        ended,
                        observation,
                        depth,
                        reward,
                        terminated,
                        truncated,
                        ending,
                        clearance,
                        crashed,
                        acted: acted(w),
                    };
                    one(w, world, out)
                })
                .collect::<Result<Vec<()>, _>>()?;
            return Ok(());
        }
        for (w, world) in self.worlds.iter_mut().enumerate() {
            let remembered = w * *memory_stride..w * *memory_stride + *memory_len;
            let out = Out {
                step: step[w],
                memory: &mut memory[remembered],
                ended: &mut ended[w],
                observation: &mut self.observation[w * row..(w + 1) * row],
                depth: &mut self.depth[w * image..(w + 1) * image],
                reward: &mut self.reward[w * d..(w + 1) * d],
                terminated: &mut self.terminated[w],
                truncated: &mut self.truncated[w],
                ending: &mut self.ending[w],
                clearance: &mut self.clearance[w * d..(w + 1) * d],
                crashed: &mut self.crashed[w * d..(w + 1) * d],
                acted: acted(w),
            };
            one(w, world, out)?;
        }
        Ok(())
    }
}
