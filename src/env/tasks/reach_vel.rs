//! Reach a velocity and keep it. Starts, goals, reward and observation are those of Crazyflow 0.4.0, `envs/reach_vel_env.py`.

use serde::{Deserialize, Serialize};

use super::{
    Channel, EnvConfig, EnvError, EpisodeStart, Outcome, Task, WorldView, distance, in_order, in_range,
    load3, one_drone, store,
};
use crate::math::vec3;

/// Options.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ReachVel {
    /// Corners of the box in which episodes start, m.
    pub start_m: [[f64; 3]; 2],
    /// Start velocities lie within ± this along each axis, m/s.
    pub start_speed_m_s: f64,
    /// Goals lie within ± this along each axis, m/s.
    pub goal_speed_m_s: f64,
    /// The reward is exp(−this · difference of velocities).
    pub steepness_s_per_m: f64,
}

impl Default for ReachVel {
    fn default() -> Self {
        Self {
            start_m: [[-1.0, -1.0, 1.0], [1.0, 1.0, 2.0]],
            start_speed_m_s: 1.0,
            goal_speed_m_s: 1.0,
            steepness_s_per_m: 1.0,
        }
    }
}

impl Task for ReachVel {
    fn check(&self, config: &EnvConfig) -> Result<(), EnvError> {
        one_drone("reach_vel", config)?;
        in_order("start_m", self.start_m)?;
        in_range("start_speed_m_s", self.start_speed_m_s, 0.0, 100.0)?;
        in_range("goal_speed_m_s", self.goal_speed_m_s, 0.0, 100.0)?;
        in_range("steepness_s_per_m", self.steepness_s_per_m, 1e-6, 1e6)
    }

    fn channels(&self) -> Vec<Channel> {
        vec![Channel::new("difference_to_target_vel", 3)]
    }

    fn memory_len(&self, _: usize) -> usize {
        3
    }

    fn has_goal(&self) -> bool {
        true
    }

    fn begin(&self, b: &mut EpisodeStart) -> Result<(), EnvError> {
        b.start_within(self.start_m, self.start_speed_m_s);
        let goal = self.goal_speed_m_s;
        let drawn = b.within([[-goal; 3], [goal; 3]]);
        let goal = b.given_goal(0).unwrap_or(drawn);
        store(b.memory, &goal);
        Ok(())
    }

    fn judge(&self, view: &WorldView, memory: &mut [f32], reward: &mut [f32]) -> Outcome {
        let seen = &view.drones[0];
        if seen.crashed {
            reward[0] = -1.0;
            return Outcome::Crashed;
        }
        reward[0] = (-self.steepness_s_per_m * distance(seen.vel_m_s, load3(memory))).exp() as f32;
        Outcome::Continue
    }

    fn observe(&self, view: &WorldView, memory: &[f32], drone: usize, out: &mut [f32]) {
        store(out, &vec3::sub(load3(memory), view.drones[drone].vel_m_s));
    }
}
