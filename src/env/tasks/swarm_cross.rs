//! Drones on a circle change places with those on the other side, all at once, between obstacles.

use std::f64::consts::PI;

use serde::{Deserialize, Serialize};

use super::{
    ActionKind, CameraConfig, Channel, Course, EnvConfig, EnvError, EpisodeStart, Outcome, SceneConfig,
    Start, Task, TaskDefaults, Weights, WorldView, distance, in_range, load3, store, task_camera,
};
use crate::math::vec3;
use crate::scene::generate::BoxesOptions;

/// Options.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SwarmCross {
    /// Radius of the circle, m.
    pub radius_m: f64,
    /// Heights between which drones start, m; goals have the height of the start.
    pub height_m: [f64; 2],
    /// Starts lie within ± this around their places on the circle, m.
    pub start_off_m: f64,
    /// Free distance around starts and goals, m.
    pub free_m: f64,
    /// A goal is reached within this distance, m.
    pub arrive_m: f64,
    /// A drone farther than this from the axis of the circle, or higher, has left, m.
    pub space_m: [f64; 2],
    /// Nearest drones that each observes.
    pub neighbours: usize,
    /// Weights of the reward.
    pub weights: Weights,
}

impl Default for SwarmCross {
    fn default() -> Self {
        Self {
            radius_m: 4.0,
            height_m: [0.8, 1.6],
            start_off_m: 0.5,
            free_m: 0.25,
            arrive_m: 0.5,
            space_m: [8.0, 3.0],
            neighbours: 4,
            weights: Weights::default(),
        }
    }
}

/// Numbers that are remembered of each drone: its goal, its distance to it, whether it has arrived.
const EACH: usize = 5;

impl Task for SwarmCross {
    fn check(&self, config: &EnvConfig) -> Result<(), EnvError> {
        if config.sim.n_drones() < 2 {
            return Err(EnvError::option(
                "n_drones",
                "2 or more for the task swarm_cross",
                config.sim.n_drones(),
            ));
        }
        in_range("radius_m", self.radius_m, 0.1, 1e4)?;
        in_range("height_m", self.height_m[0], 0.0, self.height_m[1])?;
        in_range("height_m", self.height_m[1], self.height_m[0], 1e4)?;
        in_range("start_off_m", self.start_off_m, 0.0, 1e3)?;
        in_range("free_m", self.free_m, 0.0, 1e2)?;
        in_range("arrive_m", self.arrive_m, 1e-3, 1e3)?;
        in_range("space_m", self.space_m[0], self.radius_m, 1e5)?;
        in_range("space_m", self.space_m[1], self.height_m[1], 1e5)?;
        in_range("neighbours", self.neighbours as f64, 0.0, 1e3)?;
        self.weights.check()
    }

    fn check_course(&self, _: &Course, scene: &str) -> Result<(), EnvError> {
        if scene == "none" {
            return Err(EnvError::option(
                "scene",
                "any scene: without one drones do not touch each other",
                scene,
            ));
        }
        Ok(())
    }

    fn scene(&self) -> (SceneConfig, Option<usize>) {
        let options =
            BoxesOptions { count: 8, moving: 0, size_m: 6.5, min_gap_m: 0.6, ..BoxesOptions::default() };
        (SceneConfig::Boxes(options), Some(8))
    }

    fn camera(&self) -> Option<CameraConfig> {
        Some(task_camera())
    }

    fn defaults(&self) -> TaskDefaults {
        TaskDefaults {
            n_drones: Some(8),
            action: Some(ActionKind::Velocity),
            step_hz: Some(20),
            max_episode_s: Some(12.0),
        }
    }

    fn channels(&self) -> Vec<Channel> {
        vec![
            Channel::new("goal", 3),
            Channel::new("vel_heading", 3),
            Channel::new("neighbours", 6 * self.neighbours),
        ]
    }

    fn memory_len(&self, n_drones: usize) -> usize {
        EACH * n_drones
    }

    fn has_goal(&self) -> bool {
        true
    }

    fn begin(&self, b: &mut EpisodeStart) -> Result<(), EnvError> {
        let n = b.starts.len();
        b.scatter()?;
        let turn = b.draw.uniform(0.0, 2.0 * PI);
        let box_at =
            |x: f64, y: f64, z: [f64; 2], off: f64| [[x - off, y - off, z[0]], [x + off, y + off, z[1]]];
        // Goals first, while no drone is in the way.
        let mut goals = Vec::with_capacity(n);
        let [reach, top] = self.space_m;
        for d in 0..n {
            if let Some(given) = b.given_goal_within(d, [[-reach, -reach, 0.0], [reach, reach, top]])? {
                goals.push(given);
                continue;
            }
            let (sin, cos) = (turn + 2.0 * PI * d as f64 / n as f64 + PI).sin_cos();
            let r = self.radius_m;
            let space = box_at(r * cos, r * sin, self.height_m, self.start_off_m);
            goals.push(b.free_place(d, "goal", space, self.free_m)?);
            b.scatter()?;
        }
        for d in 0..n {
            let (sin, cos) = (turn + 2.0 * PI * d as f64 / n as f64).sin_cos();
            let r = self.radius_m;
            let pos = b.free_place(
                d,
                "start",
                box_at(r * cos, r * sin, self.height_m, self.start_off_m),
                self.free_m,
            )?;
            let way = vec3::sub(goals[d], pos);
            b.starts[d] = Start::at(pos).facing(way[1].atan2(way[0]));
            let [x, y, z] = goals[d];
            store(&mut b.memory[EACH * d..], &[x, y, z, vec3::norm(way), 0.0]);
        }
        Ok(())
    }

    fn judge(&self, view: &WorldView, memory: &mut [f32], reward: &mut [f32]) -> Outcome {
        let w = &self.weights;
        let mut outcome = Outcome::Continue;
        let mut all_there = true;
        for (d, seen) in view.drones.iter().enumerate() {
            let own = &mut memory[EACH * d..EACH * (d + 1)];
            let left = distance(seen.pos_m, load3(own));
            let mut value = w.progress * (f64::from(own[3]) - left) - w.cost(view, d);
            own[3] = left as f32;
            let off = (seen.pos_m[0] * seen.pos_m[0] + seen.pos_m[1] * seen.pos_m[1]).sqrt();
            let has_left = off > self.space_m[0] || seen.pos_m[2] > self.space_m[1];
            if seen.crashed || has_left {
                value -= w.crash;
                if outcome != Outcome::Crashed {
                    outcome = if seen.crashed { Outcome::Crashed } else { Outcome::Left };
                }
            }
            let there = left <= self.arrive_m;
            if there && own[4] == 0.0 {
                own[4] = 1.0;
                value += w.success;
            }
            all_there &= there;
            reward[d] = value as f32;
        }
        if outcome == Outcome::Continue && all_there { Outcome::Done } else { outcome }
    }

    fn observe(&self, view: &WorldView, memory: &[f32], drone: usize, out: &mut [f32]) {
        let seen = &view.drones[drone];
        store(out, &seen.along_heading(vec3::sub(load3(&memory[EACH * drone..]), seen.pos_m)));
        store(&mut out[3..], &seen.along_heading(seen.vel_m_s));
        let out = &mut out[6..];
        out.fill(0.0);
        // The nearest by selection: few are wanted, and nothing is allocated.
        let mut last = (f64::NEG_INFINITY, 0);
        for out in out.chunks_exact_mut(6) {
            let mut best: Option<(f64, usize)> = None;
            for (j, other) in view.drones.iter().enumerate().filter(|(j, _)| *j != drone) {
                let key = (distance(other.pos_m, seen.pos_m), j);
                let later = key.0 > last.0 || (key.0 == last.0 && key.1 > last.1);
                if later && best.is_none_or(|b| key.0 < b.0 || (key.0 == b.0 && key.1 < b.1)) {
                    best = Some(key);
                }
            }
            let Some(found) = best else { break };
            last = found;
            let other = &view.drones[found.1];
            store(out, &seen.along_heading(vec3::sub(other.pos_m, seen.pos_m)));
            store(&mut out[3..], &seen.along_heading(vec3::sub(other.vel_m_s, seen.vel_m_s)));
        }
    }
}
