//! Follow a trajectory. The figure of eight, its observation and its reward are those of Crazyflow 0.4.0, `envs/figure_8_env.py`, in
//! continuous time.

use std::f64::consts::{FRAC_PI_2, PI};

use serde::{Deserialize, Serialize};

use super::{
    Channel, EnvConfig, EnvError, EpisodeStart, Formulas, Outcome, Seen, Task, TracedTask, Verdict,
    WorldView, distance, first3, formulas, in_order, in_range, is_within, one_drone, or_crash, store,
};
use crate::math::vec3;
use crate::scalar::Real;

/// What the trajectory looks like.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Shape {
    /// An upright eight: x = r sin φ, z = 1 + r/2 sin 2φ.
    #[default]
    FigureEight,
    /// A level circle around (0, 0, 1).
    Circle,
    /// Sines of all three axes, whose phases, sizes and numbers of cycles (1 or 2) are drawn for each episode.
    Lissajous,
}

/// Options.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Trajectory {
    /// What it looks like.
    pub shape: Shape,
    /// Its radius, m.
    pub radius_m: f64,
    /// Time for all of it, s.
    pub period_s: f64,
    /// Points ahead that are observed.
    pub n_samples: usize,
    /// Time between them, s.
    pub samples_dt_s: f64,
    /// Episodes start within ± this around its first point, m.
    pub start_off_m: f64,
    /// Start velocities lie within ± this along each axis, m/s.
    pub start_speed_m_s: f64,
    /// Corners of the box that the drone must not leave, m.
    pub space_m: [[f64; 3]; 2],
    /// The reward is exp(−this · distance).
    pub steepness_per_m: f64,
}

impl Default for Trajectory {
    fn default() -> Self {
        Self {
            shape: Shape::FigureEight,
            radius_m: 1.0,
            period_s: 10.0,
            n_samples: 10,
            samples_dt_s: 0.1,
            start_off_m: 0.1,
            start_speed_m_s: 0.5,
            space_m: [[-2.0, -2.0, 0.0], [2.0, 2.0, 2.0]],
            steepness_per_m: 2.0,
        }
    }
}

/// Height of the middle, m.
const MIDDLE_M: f64 = 1.0;

impl Trajectory {
    /// The point at `time_s`, m; the memory holds amplitudes (m), cycles and phases (rad) of the three axes.
    fn at<S: Real>(&self, memory: &[S], time_s: S) -> [S; 3] {
        let (size, cycles, phase) = (first3(memory), first3(&memory[3..]), first3(&memory[6..]));
        let turn = S::lit(2.0 * PI) * time_s / S::lit(self.period_s);
        let mut out: [S; 3] = core::array::from_fn(|k| size[k] * (cycles[k] * turn + phase[k]).sin_cos().0);
        out[2] = out[2] + S::lit(MIDDLE_M);
        out
    }
}

impl Task for Trajectory {
    fn check(&self, config: &EnvConfig) -> Result<(), EnvError> {
        one_drone("trajectory", config)?;
        in_order("space_m", self.space_m)?;
        in_range("radius_m", self.radius_m, 1e-3, 1e3)?;
        in_range("period_s", self.period_s, 0.1, 1e6)?;
        in_range("n_samples", self.n_samples as f64, 1.0, 1000.0)?;
        in_range("samples_dt_s", self.samples_dt_s, 1e-6, 1e6)?;
        in_range("start_off_m", self.start_off_m, 0.0, 100.0)?;
        in_range("start_speed_m_s", self.start_speed_m_s, 0.0, 100.0)?;
        in_range("steepness_per_m", self.steepness_per_m, 1e-6, 1e6)
    }

    fn channels(&self) -> Vec<Channel> {
        vec![Channel::new("local_samples", 3 * self.n_samples)]
    }

    fn memory_len(&self, _: usize) -> usize {
        9
    }

    fn begin(&self, b: &mut EpisodeStart) -> Result<(), EnvError> {
        let r = self.radius_m;
        let numbers = match self.shape {
            Shape::FigureEight => [r, 0.0, 0.5 * r, 1.0, 0.0, 2.0, 0.0, 0.0, 0.0],
            Shape::Circle => [r, r, 0.0, 1.0, 1.0, 0.0, FRAC_PI_2, 0.0, 0.0],
            Shape::Lissajous => core::array::from_fn(|i| match i {
                0 | 1 => b.draw.uniform(0.3 * r, r),
                2 => b.draw.uniform(0.1 * r, 0.5 * r),
                3..=5 => 1.0 + b.draw.below(2) as f64,
                _ => b.draw.uniform(0.0, 2.0 * PI),
            }),
        };
        store(b.memory, &numbers);
        let remembered: Vec<f64> = b.memory.iter().map(|v| f64::from(*v)).collect();
        let first = self.at(&remembered, 0.0);
        let off = [self.start_off_m; 3];
        b.start_within([vec3::sub(first, off), vec3::add(first, off)], self.start_speed_m_s);
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

impl Formulas for Trajectory {
    fn verdict<S: Real>(&self, seen: &Seen<S>, memory: &[S]) -> Verdict<S> {
        let off = distance(seen.pos_m, self.at(memory, seen.time_s));
        let left = !is_within(seen.pos_m, self.space_m);
        let reward = (S::lit(-self.steepness_per_m) * off).exp();
        let reward = S::select(left, S::lit(-1.0), reward);
        or_crash(seen, Verdict { left, ..Verdict::going_on(reward) })
    }

    fn observation<S: Real>(&self, seen: &Seen<S>, memory: &[S], out: &mut [S]) {
        for (k, out) in out.chunks_exact_mut(3).enumerate() {
            let time_s = seen.time_s + S::lit(k as f64 * self.samples_dt_s);
            out.copy_from_slice(&vec3::sub(self.at(memory, time_s), seen.pos_m));
        }
    }
}
