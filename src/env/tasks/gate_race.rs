//! Fly through gates, one after the other, as fast as possible. Gates are the sites `gate…` of the scene, in the order of their names.

use serde::{Deserialize, Serialize};

use super::{
    ActionKind, CameraConfig, Channel, Course, EnvConfig, EnvError, EpisodeStart, Outcome, SceneConfig,
    Start, Task, TaskDefaults, Weights, WorldView, distance, in_order, in_range, is_within, one_drone, store,
    task_camera,
};
use crate::env::layouts::Gate;
use crate::math::vec3;
use crate::scene::generate::TrackOptions;

/// Options.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GateRace {
    /// Gates to pass; after the last of the scene comes the first. 0: each once.
    pub gates: usize,
    /// Episodes start before a gate that is drawn; else before the first.
    pub random_start: bool,
    /// How far before the gate they start, m.
    pub before_m: f64,
    /// Within ± this around that place, m.
    pub start_off_m: f64,
    /// Corners of the box that the drone must not leave, m; the scene and 3 m around it.
    pub space_m: Option<[[f64; 3]; 2]>,
    /// For each gate that is passed.
    pub gate_reward: f64,
    /// Weights of the reward; progress is that towards the middle of the next gate.
    pub weights: Weights,
}

impl Default for GateRace {
    fn default() -> Self {
        Self {
            gates: 0,
            random_start: true,
            before_m: 2.0,
            start_off_m: 0.3,
            space_m: None,
            gate_reward: 2.0,
            weights: Weights { proximity: 0.2, safe_m: 0.2, ..Weights::default() },
        }
    }
}

/// How far the space reaches beyond the scene, m.
const BESIDE_M: f64 = 3.0;
/// Places in the memory: next gate, gates passed, distance to the next gate.
const NEXT: usize = 0;
const PASSED: usize = 1;
const LEFT: usize = 2;

impl GateRace {
    fn space(&self, course: &Course) -> [[f64; 3]; 2] {
        self.space_m.unwrap_or_else(|| {
            let [low, high] = course.extent_m.unwrap_or([[-5.0; 3], [5.0; 3]]);
            let m = BESIDE_M;
            [[low[0] - m, low[1] - m, -1.0], [high[0] + m, high[1] + m, high[2] + 0.5 * m]]
        })
    }

    fn gate(course: &Course, index: usize) -> &Gate {
        &course.gates[index % course.gates.len()]
    }
}

impl Task for GateRace {
    fn check(&self, config: &EnvConfig) -> Result<(), EnvError> {
        one_drone("gate_race", config)?;
        self.space_m.map_or(Ok(()), |space| in_order("space_m", space))?;
        in_range("gates", self.gates as f64, 0.0, 1e6)?;
        in_range("before_m", self.before_m, 0.0, 1e3)?;
        in_range("start_off_m", self.start_off_m, 0.0, 1e3)?;
        in_range("gate_reward", self.gate_reward, 0.0, 1e6)?;
        self.weights.check()
    }

    fn check_course(&self, course: &Course, scene: &str) -> Result<(), EnvError> {
        if course.gates.is_empty() {
            let expected = "sites of type box named gate…, which fill the openings and whose x axes point the way through";
            return Err(EnvError::option("scene", expected, format!("{scene}, which has none")));
        }
        Ok(())
    }

    fn scene(&self) -> (SceneConfig, Option<usize>) {
        (SceneConfig::Track(TrackOptions::default()), Some(8))
    }

    fn camera(&self) -> Option<CameraConfig> {
        Some(task_camera())
    }

    fn defaults(&self) -> TaskDefaults {
        TaskDefaults {
            n_drones: None,
            action: Some(ActionKind::Velocity),
            step_hz: Some(25),
            max_episode_s: Some(30.0),
        }
    }

    fn channels(&self) -> Vec<Channel> {
        vec![Channel::new("next_gate", 6), Channel::new("gate_after", 6), Channel::new("vel_heading", 3)]
    }

    fn memory_len(&self, _: usize) -> usize {
        3
    }

    fn begin(&self, b: &mut EpisodeStart) -> Result<(), EnvError> {
        let course = b.course;
        let first = if self.random_start { b.draw.below(course.gates.len() as u64) as usize } else { 0 };
        let gate = Self::gate(course, first);
        let axis = gate.axis();
        let middle = vec3::sub(gate.pos_m, vec3::scale(axis, self.before_m));
        let off = [self.start_off_m; 3];
        b.scatter()?;
        let pos =
            b.free_place(0, "start before the gate", [vec3::sub(middle, off), vec3::add(middle, off)], 0.15)?;
        b.starts[0] = Start::at(pos).facing(axis[1].atan2(axis[0]));
        b.memory[NEXT] = first as f32;
        b.memory[LEFT] = distance(pos, gate.pos_m) as f32;
        Ok(())
    }

    fn judge(&self, view: &WorldView, memory: &mut [f32], reward: &mut [f32]) -> Outcome {
        let (seen, w) = (&view.drones[0], &self.weights);
        let next = memory[NEXT] as usize;
        let gate = Self::gate(view.course, next);
        let left = distance(seen.pos_m, gate.pos_m);
        let mut value = w.progress * (f64::from(memory[LEFT]) - left) - w.cost(view, 0);
        memory[LEFT] = left as f32;
        if seen.crashed || !is_within(seen.pos_m, self.space(view.course)) {
            reward[0] = (value - w.crash) as f32;
            return if seen.crashed { Outcome::Crashed } else { Outcome::Left };
        }
        let mut outcome = Outcome::Continue;
        if gate.is_passed(seen.previous_pos_m, seen.pos_m) {
            value += self.gate_reward;
            let after = (next + 1) % view.course.gates.len();
            memory[NEXT] = after as f32;
            memory[PASSED] += 1.0;
            memory[LEFT] = distance(seen.pos_m, Self::gate(view.course, after).pos_m) as f32;
            let wanted = if self.gates == 0 { view.course.gates.len() } else { self.gates };
            if memory[PASSED] as usize >= wanted {
                value += w.success;
                outcome = Outcome::Done;
            }
        }
        reward[0] = value as f32;
        outcome
    }

    fn observe(&self, view: &WorldView, memory: &[f32], drone: usize, out: &mut [f32]) {
        let seen = &view.drones[drone];
        let next = memory[NEXT] as usize;
        for (k, out) in out[..12].chunks_exact_mut(6).enumerate() {
            let gate = Self::gate(view.course, next + k);
            store(out, &seen.along_heading(vec3::sub(gate.pos_m, seen.pos_m)));
            store(&mut out[3..], &seen.along_heading(gate.axis()));
        }
        store(&mut out[12..], &seen.along_heading(seen.vel_m_s));
    }
}
