//! Cross a forest, or any other scene, to a goal on its far side, seeing by a depth camera.

use serde::{Deserialize, Serialize};

use super::{
    ActionKind, CameraConfig, Channel, Course, EnvConfig, EnvError, EpisodeStart, Outcome, SceneConfig,
    Start, Task, TaskDefaults, Weights, WorldView, distance, in_order, in_range, is_within, load3, one_drone,
    store, task_camera,
};
use crate::math::vec3;
use crate::scene::generate::ForestOptions;

/// Options. Boxes that are not given are those of the sites `start…` and `goal…` of the scene; a scene without them is crossed along x,
/// from beside its lower to beside its upper end.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ForestDepth {
    /// Corners of the box in which episodes start, m.
    pub start_m: Option<[[f64; 3]; 2]>,
    /// Corners of the box of goals, m.
    pub goal_m: Option<[[f64; 3]; 2]>,
    /// Corners of the box that the drone must not leave, m; the scene and 2 m around it, up to `ceiling_m`.
    pub space_m: Option<[[f64; 3]; 2]>,
    /// Height above which a drone has left, where `space_m` is not given, m: a forest is not to be flown over.
    pub ceiling_m: f64,
    /// Free distance around starts and goals, m.
    pub free_m: f64,
    /// The goal is reached within this distance, m.
    pub arrive_m: f64,
    /// Weights of the reward.
    pub weights: Weights,
}

impl Default for ForestDepth {
    fn default() -> Self {
        Self {
            start_m: None,
            goal_m: None,
            space_m: None,
            ceiling_m: 2.5,
            free_m: 0.4,
            arrive_m: 0.6,
            weights: Weights::default(),
        }
    }
}

/// How far outside of the scene starts, goals and the end of the space lie, m.
const BESIDE_M: [f64; 3] = [0.6, 1.0, 2.0];

impl ForestDepth {
    fn space(&self, course: &Course) -> [[f64; 3]; 2] {
        self.space_m.unwrap_or_else(|| {
            let [low, high] = course.extent_m.unwrap_or([[-5.0; 3], [5.0; 3]]);
            let m = BESIDE_M[2];
            [[low[0] - m, low[1] - m, -1.0], [high[0] + m, high[1] + m, self.ceiling_m]]
        })
    }

    /// Box at one end of the scene.
    fn end(&self, course: &Course, upper: bool) -> [[f64; 3]; 2] {
        let [low, high] = course.extent_m.unwrap_or([[-5.0; 3], [5.0; 3]]);
        let (middle, half) = (0.5 * (low[1] + high[1]), 0.35 * (high[1] - low[1]));
        let z = [0.4 * self.ceiling_m, 0.7 * self.ceiling_m];
        let x = if upper {
            [high[0] + BESIDE_M[0], high[0] + BESIDE_M[1]]
        } else {
            [low[0] - BESIDE_M[1], low[0] - BESIDE_M[0]]
        };
        [[x[0], middle - half, z[0]], [x[1], middle + half, z[1]]]
    }
}

/// One of the places of a list, drawn; as corners.
pub(super) fn one_of(b: &mut EpisodeStart, places: &[([f64; 3], [f64; 3])]) -> Option<[[f64; 3]; 2]> {
    if places.is_empty() {
        return None;
    }
    let (middle, half) = places[b.draw.below(places.len() as u64) as usize];
    Some([vec3::sub(middle, half), vec3::add(middle, half)])
}

impl Task for ForestDepth {
    fn check(&self, config: &EnvConfig) -> Result<(), EnvError> {
        one_drone("forest_depth", config)?;
        for (name, space) in [("start_m", self.start_m), ("goal_m", self.goal_m), ("space_m", self.space_m)] {
            space.map_or(Ok(()), |space| in_order(name, space))?;
        }
        in_range("ceiling_m", self.ceiling_m, 0.5, 1e4)?;
        in_range("free_m", self.free_m, 0.0, 100.0)?;
        in_range("arrive_m", self.arrive_m, 1e-3, 1e3)?;
        self.weights.check()
    }

    fn check_course(&self, course: &Course, scene: &str) -> Result<(), EnvError> {
        let known = self.start_m.is_some() && self.goal_m.is_some() && self.space_m.is_some();
        if known || course.extent_m.is_some() {
            return Ok(());
        }
        let expected = "start_m, goal_m and space_m of the task for a scene without any geom but planes";
        Err(EnvError::option("scene", expected, scene))
    }

    fn scene(&self) -> (SceneConfig, Option<usize>) {
        let options = ForestOptions {
            trees: 36,
            rocks: 6,
            logs: 3,
            moving: 0,
            size_m: 12.0,
            ..ForestOptions::default()
        };
        (SceneConfig::Forest(options), Some(16))
    }

    fn camera(&self) -> Option<CameraConfig> {
        Some(task_camera())
    }

    fn defaults(&self) -> TaskDefaults {
        TaskDefaults {
            n_drones: None,
            action: Some(ActionKind::Velocity),
            step_hz: Some(20),
            max_episode_s: Some(12.0),
        }
    }

    fn channels(&self) -> Vec<Channel> {
        vec![Channel::new("goal", 3), Channel::new("vel_heading", 3)]
    }

    fn memory_len(&self, _: usize) -> usize {
        4
    }

    fn has_goal(&self) -> bool {
        true
    }

    fn begin(&self, b: &mut EpisodeStart) -> Result<(), EnvError> {
        let course = b.course;
        let start =
            self.start_m.or_else(|| one_of(b, &course.starts)).unwrap_or_else(|| self.end(course, false));
        let goal = self.goal_m.or_else(|| one_of(b, &course.goals)).unwrap_or_else(|| self.end(course, true));
        b.scatter()?;
        let goal = match b.given_goal_within(0, self.space(course))? {
            Some(given) => given,
            None => b.free_place(0, "goal", goal, self.free_m)?,
        };
        let pos = b.free_place(0, "start", start, self.free_m)?;
        let way = vec3::sub(goal, pos);
        b.starts[0] = Start::at(pos).facing(way[1].atan2(way[0]));
        store(b.memory, &[goal[0], goal[1], goal[2], vec3::norm(way)]);
        Ok(())
    }

    fn judge(&self, view: &WorldView, memory: &mut [f32], reward: &mut [f32]) -> Outcome {
        let (seen, w) = (&view.drones[0], &self.weights);
        let left = distance(seen.pos_m, load3(memory));
        let gained = f64::from(memory[3]) - left;
        memory[3] = left as f32;
        let mut value = w.progress * gained - w.cost(view, 0);
        let outcome = if seen.crashed {
            Outcome::Crashed
        } else if !is_within(seen.pos_m, self.space(view.course)) {
            Outcome::Left
        } else if left <= self.arrive_m {
            Outcome::Done
        } else {
            Outcome::Continue
        };
        value += w.end(outcome);
        reward[0] = value as f32;
        outcome
    }

    fn observe(&self, view: &WorldView, memory: &[f32], drone: usize, out: &mut [f32]) {
        let seen = &view.drones[drone];
        store(out, &seen.along_heading(vec3::sub(load3(memory), seen.pos_m)));
        store(&mut out[3..], &seen.along_heading(seen.vel_m_s));
    }
}
