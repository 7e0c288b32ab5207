//! Reach a velocity and keep it. Starts, goals, reward and observation are those of Crazyflow 0.4.0, `envs/reach_vel_env.py`.

use serde::{Deserialize, Serialize};

use super::{
    Channel, EnvConfig, EnvError, EpisodeStart, Formulas, Outcome, Seen, Task, TracedTask, Verdict,
    WorldView, distance, first3, formulas, in_order, in_range, one_drone, or_crash, store,
};
use crate::math::vec3;
use crate::scalar::Real;

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
        formulas::judge(self, view, memory, reward)
    }

    fn observe(&self, view: &WorldView, memory: &[f32], drone: usize, out: &mut [f32]) {
        formulas::observe(self, view, memory, drone, out);
    }

    fn formulas(&self) -> Option<TracedTask> {
        Some(TracedTask::of(self))
    }
}

impl Formulas for ReachVel {
    fn verdict<S: Real>(&self, seen: &Seen<S>, memory: &[S]) -> Verdict<S> {
        let off = distance(seen.vel_m_s, first3(memory));
        or_crash(seen, Verdict::going_on((S::lit(-self.steepness_s_per_m) * off).exp()))
    }

    fn observation<S: Real>(&self, seen: &Seen<S>, memory: &[S], out: &mut [S]) {
        out.copy_from_slice(&vec3::sub(first3(memory), seen.vel_m_s));
    }
}
