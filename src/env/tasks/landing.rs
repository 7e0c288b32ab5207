//! Come to rest just above a place. Starts, goal, reward and observation are those of Crazyflow 0.4.0, `envs/landing_env.py`.

use serde::{Deserialize, Serialize};

use super::{
    Channel, EnvConfig, EnvError, EpisodeStart, Formulas, Outcome, Seen, Task, TracedTask, Verdict,
    WorldView, distance, formulas, in_order, in_range, one_drone, or_crash, store,
};
use crate::math::vec3;
use crate::scalar::Real;

/// Options.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Landing {
    /// Corners of the box in which episodes start, m.
    pub start_m: [[f64; 3]; 2],
    /// Start velocities lie within ± this along each axis, m/s.
    pub start_speed_m_s: f64,
    /// The place, m.
    pub goal_m: [f64; 3],
    /// The reward is exp(−this · distance − …
    pub steepness_per_m: f64,
    /// … − this · speed).
    pub steepness_s_per_m: f64,
}

impl Default for Landing {
    fn default() -> Self {
        Self {
            start_m: [[-1.0, -1.0, 1.0], [1.0, 1.0, 2.0]],
            start_speed_m_s: 1.0,
            goal_m: [0.0, 0.0, 0.1],
            steepness_per_m: 2.0,
            steepness_s_per_m: 2.0,
        }
    }
}

impl Landing {
    /// The place, m: that given at the reset, which the memory then holds behind a one, or that of the options.
    fn goal<S: Real>(&self, memory: &[S]) -> [S; 3] {
        let own = memory[0].lt(S::lit(0.5));
        core::array::from_fn(|k| S::select(own, S::lit(self.goal_m[k]), memory[1 + k]))
    }
}

impl Task for Landing {
    fn check(&self, config: &EnvConfig) -> Result<(), EnvError> {
        one_drone("landing", config)?;
        in_order("start_m", self.start_m)?;
        in_order("goal_m", [self.goal_m; 2])?;
        in_range("start_speed_m_s", self.start_speed_m_s, 0.0, 100.0)?;
        in_range("steepness_per_m", self.steepness_per_m, 1e-6, 1e6)?;
        in_range("steepness_s_per_m", self.steepness_s_per_m, 0.0, 1e6)
    }

    fn channels(&self) -> Vec<Channel> {
        vec![Channel::new("difference_to_goal", 3)]
    }

    fn memory_len(&self, _: usize) -> usize {
        4
    }

    fn has_goal(&self) -> bool {
        true
    }

    fn begin(&self, b: &mut EpisodeStart) -> Result<(), EnvError> {
        b.start_within(self.start_m, self.start_speed_m_s);
        if let Some([x, y, z]) = b.given_goal(0) {
            store(b.memory, &[1.0, x, y, z]);
        }
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

impl Formulas for Landing {
    fn verdict<S: Real>(&self, seen: &Seen<S>, memory: &[S]) -> Verdict<S> {
        let off = S::lit(self.steepness_per_m) * distance(seen.pos_m, self.goal(memory));
        let fast = S::lit(self.steepness_s_per_m) * vec3::norm(seen.vel_m_s);
        or_crash(seen, Verdict::going_on((-off - fast).exp()))
    }

    fn observation<S: Real>(&self, seen: &Seen<S>, memory: &[S], out: &mut [S]) {
        out.copy_from_slice(&vec3::sub(self.goal(memory), seen.pos_m));
    }
}
