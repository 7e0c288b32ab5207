//! The built-in tasks, one file each.
//!
//! To add one, write its file here, whose type holds its options and implements [`Task`], and name it in the two lists
//! below: `mod` and [`TaskConfig`]. Its name in descriptions, in Python and in Gymnasium follows from that.

mod forest_depth;
mod gate_race;
mod landing;
mod reach_pos;
mod reach_vel;
mod room_explore;
mod swarm_cross;
mod trajectory;

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::EnvError;
use super::action::ActionKind;
use super::config::EnvConfig;
use super::formulas::{self, Formulas, Seen, TracedTask, Verdict};
use super::layouts::Course;
use super::task::{Channel, EpisodeStart, Outcome, Start, Task, TaskDefaults, WorldView, store, yaw};
use crate::arena::{CameraConfig, SceneConfig};
use crate::math::vec3;
use crate::scalar::Real;

/// A task that is built in.
#[derive(Clone, Debug, PartialEq)]
pub struct BuiltInTask {
    /// Its name, the `kind` of a [`TaskConfig`].
    pub name: &'static str,
    /// Its name in camel case.
    pub title: &'static str,
    /// What it is made for.
    pub defaults: TaskDefaults,
}

/// Makes [`TaskConfig`] of a list of types, each with the module that it stands in, which names it.
macro_rules! built_in_tasks {
    ($($(#[doc = $doc:literal])* $name:ident in $module:ident),* $(,)?) => {
        $(pub use $module::$name;)*

        /// A task and its options.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        #[serde(tag = "kind", rename_all = "snake_case")]
        pub enum TaskConfig {
            $($(#[doc = $doc])* $name($name),)*
            /// A task that is not built in: see [`Env::with_task`](crate::env::Env::with_task).
            Own(OwnTask),
        }

        impl TaskConfig {
            /// All built-in tasks.
            pub fn built_in() -> Vec<BuiltInTask> {
                vec![$(BuiltInTask {
                    name: stringify!($module),
                    title: stringify!($name),
                    defaults: $name::default().defaults(),
                }),*]
            }

            /// Its name: the `kind` of one that is built in.
            pub fn name(&self) -> &str {
                match self {
                    $(Self::$name(_) => stringify!($module),)*
                    Self::Own(task) => &task.name,
                }
            }

            /// What does it.
            pub(super) fn task(&self) -> Result<Arc<dyn Task>, EnvError> {
                match self {
                    $(Self::$name(task) => Ok(Arc::new(*task)),)*
                    Self::Own(task) => {
                        let names: Vec<_> = Self::built_in().iter().map(|task| task.name).collect();
                        let expected = format!("one of {}, or the task itself by Env::with_task", names.join(", "));
                        Err(EnvError::option("task", expected, format!("the task {:?}, which is not built in", task.name)))
                    }
                }
            }
        }
    };
}

built_in_tasks! {
    /// Reach a position and stay there.
    ReachPos in reach_pos,
    /// Reach a velocity and keep it.
    ReachVel in reach_vel,
    /// Land at a place, slowly.
    Landing in landing,
    /// Follow a trajectory.
    Trajectory in trajectory,
    /// Cross a forest to a goal by a depth camera.
    ForestDepth in forest_depth,
    /// Fly through gates, one after the other.
    GateRace in gate_race,
    /// See as much of some rooms as there is time for.
    RoomExplore in room_explore,
    /// Change places with the drone on the other side, all at once.
    SwarmCross in swarm_cross,
}

impl Default for TaskConfig {
    fn default() -> Self {
        Self::ReachPos(ReachPos::default())
    }
}

/// A task that is not built in, as the description of an environment names it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OwnTask {
    /// Its name.
    pub name: String,
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

/// The first three of a list of numbers.
pub(super) fn first3<S: Real>(list: &[S]) -> [S; 3] {
    [list[0], list[1], list[2]]
}

/// Distance of two points, m.
pub(super) fn distance<S: Real>(a: [S; 3], b: [S; 3]) -> S {
    vec3::norm(vec3::sub(a, b))
}

/// Whether a point lies in a box.
pub(super) fn is_within<S: Real>(p: [S; 3], [low, high]: [[f64; 3]; 2]) -> S::Mask {
    let along = |k: usize| S::lit(low[k]).le(p[k]) & p[k].le(S::lit(high[k]));
    along(0) & along(1) & along(2)
}

/// A verdict, or, where the drone crashed, reward −1 and the end of the episode.
pub(super) fn or_crash<S: Real>(seen: &Seen<S>, verdict: Verdict<S>) -> Verdict<S> {
    let crashed = seen.crashed.gt(S::lit(0.5));
    Verdict { reward: S::select(crashed, S::lit(-1.0), verdict.reward), crashed, ..verdict }
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
            Outcome::Continue => 0.0,
        }
    }

    /// What nearness and a changing action cost in one step.
    pub(super) fn cost(&self, view: &WorldView, drone: usize) -> f64 {
        let near = (1.0 - view.drones[drone].clearance_m / self.safe_m).clamp(0.0, 1.0);
        self.proximity * near * view.step_s + self.jerk * f64::from(view.action_change[drone])
    }
}
