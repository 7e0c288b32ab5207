//! How an environment asks a task that sees all worlds at once.

use std::ops::Range;

use super::world::{Plan, check_rewards};
use super::{Asked, Ending, Env};
use crate::arena::Arena;
use crate::env::EnvError;
use crate::env::batch_task::{Batch, BatchObstacles, BatchSize, BatchTask, Places};
use crate::env::task::{Channel, STATE_WIDTH, Start, store};
use crate::rollout::SimData;

/// A task that sees all worlds at once, with what it sees.
pub(super) struct Batched {
    pub task: Box<dyn BatchTask>,
    pub places: Places,
    pub batch: Batch,
}

impl Plan {
    /// How long the arrays of a batch task are.
    pub(super) fn batch_size(&self, places: &Places) -> BatchSize {
        BatchSize {
            n_worlds: self.config.sim.options.n_worlds,
            n_drones: self.config.sim.n_drones(),
            action_width: self.action_width,
            own_width: self.width - STATE_WIDTH,
            pixels: self.pixels,
            is_noisy: self.config.levels.is_noisy() || !self.rules.is_empty(),
            has_goal: places.has_goal,
        }
    }
}

/// Whether all are numbers. It looks at all of them, which takes less time than to stop at the first that is none.
fn all_finite(list: &[f32]) -> bool {
    !list.iter().fold(false, |odd, v| odd | !v.is_finite())
}

/// Refuses arrays that a task has replaced by shorter or longer ones.
fn check_lengths(before: [usize; 7], batch: &Batch) -> Result<(), EnvError> {
    let after = batch.written();
    let names = ["start_pos", "start_vel", "start_yaw", "goal_pos", "reward", "ending", "channels"];
    match (0..7).find(|k| before[*k] != after[*k]) {
        None => Ok(()),
        Some(k) => {
            let what =
                format!("{}: expected {} numbers, as there were, got {}", names[k], before[k], after[k]);
            Err(EnvError::Task { what })
        }
    }
}

impl Env {
    /// The arrays of the task that sees all worlds at once; none for another task.
    pub fn batch(&mut self) -> Option<&mut Batch> {
        match &mut self.asked {
            Asked::World(_) => None,
            Asked::Batch(batched) => Some(&mut batched.batch),
        }
    }

    /// Where obstacles stand: positions, m, (world, obstacle, 3), and orientations x y z w, (world, obstacle, 4), world frame; NaN in
    /// rows that the scene of a world does not have. Empty without obstacles: bodies with `mocap="true"`.
    pub fn obstacles(&mut self) -> BatchObstacles<'_> {
        obstacles_of(&mut self.arena)
    }

    /// Asks the task where the drones of worlds that begin start, whose free places have been found; with goals if some are given.
    pub(super) fn ask_batch_for_starts(&mut self, mask: &[bool], has_goals: bool) -> Result<(), EnvError> {
        let Asked::Batch(batched) = &mut self.asked else { return Ok(()) };
        let Batched { task, batch, .. } = &mut **batched;
        let d = self.plan.config.sim.n_drones();
        batch.seed = self.plan.config.sim.options.seed;
        batch.seeds.clone_from(&self.plan.config.sim.options.seeds);
        batch.begins.copy_from_slice(mask);
        for (w, world) in self.worlds.iter().enumerate().filter(|(w, _)| mask[*w]) {
            (batch.episode[w], batch.layout[w]) = (world.episode as i64, world.layout as i64);
            for (row, start) in (w * d..).zip(&world.starts) {
                store(&mut batch.start_pos[3 * row..3 * row + 3], &start.pos_m);
                batch.start_vel[3 * row..3 * row + 3].fill(0.0);
                batch.start_yaw[row] = 0.0;
            }
            batch.goal_given[w] = has_goals;
            if !batch.goal_pos.is_empty() {
                batch.goal_pos[3 * w * d..3 * (w + 1) * d].copy_from_slice(self.rows.memory_of(w));
            }
        }
        let lengths = batch.written();
        task.on_reset(batch, &mut obstacles_of(&mut self.arena))?;
        check_lengths(lengths, batch)?;
        for (w, world) in self.worlds.iter_mut().enumerate().filter(|(w, _)| mask[*w]) {
            for (drone, start) in world.starts.iter_mut().enumerate() {
                *start = start_of(batch, w, drone)?;
            }
        }
        Ok(())
    }

    /// Asks the task to judge the worlds, where they have flown, and to observe them: all, or those of a mask.
    pub(super) fn ask_batch(&mut self, mask: Option<&[bool]>, judge: bool) -> Result<(), EnvError> {
        let Asked::Batch(batched) = &mut self.asked else { return Ok(()) };
        let Batched { task, batch, .. } = &mut **batched;
        let is_wanted = |w: usize| mask.is_none_or(|m| m[w]);
        let (plan, data) = (&self.plan, &self.arena.sim().data);
        let (d, lengths) = (plan.config.sim.n_drones(), batch.written());
        let shown = Shown {
            plan,
            data,
            observation: &self.observation,
            clearance: &self.clearance,
            crashed: &self.crashed,
            action_change: &self.action_change,
        };
        match mask {
            None => batch.read(0..self.worlds.len(), &shown),
            Some(_) => {
                (0..self.worlds.len()).filter(|w| is_wanted(*w)).for_each(|w| batch.read(w..w + 1, &shown));
            }
        }
        let image = d * plan.pixels;
        for (w, world) in self.worlds.iter().enumerate().filter(|(w, _)| image > 0 && is_wanted(*w)) {
            let own = w * image..(w + 1) * image;
            let clean = if world.clean.is_empty() { &self.depth[own.clone()] } else { &world.clean[..] };
            batch.depth[own].copy_from_slice(clean);
        }
        if judge {
            batch.reward.fill(0.0);
            batch.ending.fill(0);
            task.judge(batch)?;
            check_lengths(lengths, batch)?;
            self.reward.copy_from_slice(&batch.reward);
            let is_sound = all_finite(&batch.reward);
            for w in 0..self.worlds.len() {
                let rows = w * d..(w + 1) * d;
                let ending = match (data.quarantine[w].is_some(), data.steps[w] == 0) {
                    (false, false) => {
                        if !is_sound {
                            check_rewards(w, &batch.reward[rows])?;
                        }
                        ending_of(w, batch.ending[w])?
                    }
                    (quarantined, _) => {
                        self.reward[rows].fill(0.0);
                        if quarantined { Ending::Quarantined } else { Ending::None }
                    }
                };
                let out = (&mut self.terminated[w], &mut self.truncated[w], &mut self.ending[w]);
                self.rows.ended[w] = plan.conclude(self.rows.step[w], ending, out);
            }
        }
        let own = plan.width - STATE_WIDTH;
        if own == 0 {
            return Ok(());
        }
        task.observe(batch)?;
        check_lengths(lengths, batch)?;
        let is_sound = all_finite(&batch.channels);
        for w in (0..self.worlds.len()).filter(|w| is_wanted(*w)) {
            for row in w * d..(w + 1) * d {
                let from = &batch.channels[row * own..(row + 1) * own];
                if !is_sound
                    && let Some(k) = from.iter().position(|v| !v.is_finite())
                    && data.quarantine[w].is_none()
                {
                    return Err(not_finite(&task.channels(), w, row % d, k, from[k]));
                }
                let row = row * plan.width;
                self.observation[row + STATE_WIDTH..row + plan.width].copy_from_slice(from);
            }
        }
        Ok(())
    }
}

/// What worlds show, beside depth. Arrays, and no worlds: to look up each would cost as much as to judge it.
struct Shown<'a> {
    plan: &'a Plan,
    data: &'a SimData<f32>,
    observation: &'a [f32],
    clearance: &'a [f32],
    crashed: &'a [bool],
    action_change: &'a [f32],
}

impl Batch {
    /// Takes over what some consecutive worlds show.
    fn read(&mut self, worlds: Range<usize>, shown: &Shown) {
        let (plan, data, d) = (shown.plan, shown.data, self.n_drones);
        let rows = worlds.start * d..worlds.end * d;
        let of = |width: usize| rows.start * width..rows.end * width;
        self.previous_pos[of(3)].copy_from_slice(&self.pos[of(3)]);
        self.pos[of(3)].copy_from_slice(&data.pos[of(3)]);
        self.quat[of(4)].copy_from_slice(&data.quat[of(4)]);
        self.vel[of(3)].copy_from_slice(&data.vel[of(3)]);
        self.ang_vel[of(3)].copy_from_slice(&data.ang_vel[of(3)]);
        self.clearance[of(1)].copy_from_slice(&shown.clearance[of(1)]);
        self.crashed[of(1)].copy_from_slice(&shown.crashed[of(1)]);
        self.action_change[of(1)].copy_from_slice(&shown.action_change[of(1)]);
        let (substeps, step_s) = (plan.config.substeps(), plan.config.step_s());
        for w in worlds {
            // 64 bits divide several times slower, and few episodes need them.
            let step = match u32::try_from(data.steps[w]) {
                Ok(steps) => u64::from(steps / substeps),
                Err(_) => data.steps[w] / u64::from(substeps),
            };
            self.step[w] = step as i64;
            self.time[w] = (step as f64 * step_s) as f32;
            if step == 0 {
                let (pos, action) = (3 * d * w..3 * d * (w + 1), d * plan.action_width);
                self.previous_pos[pos.clone()].copy_from_slice(&self.pos[pos]);
                self.action[action * w..action * (w + 1)].fill(0.0);
            }
        }
        if !self.observed_pos.is_empty() {
            for row in rows {
                let seen = &shown.observation[row * plan.width..][..STATE_WIDTH];
                self.observed_pos[3 * row..3 * row + 3].copy_from_slice(&seen[..3]);
                self.observed_quat[4 * row..4 * row + 4].copy_from_slice(&seen[3..7]);
                self.observed_vel[3 * row..3 * row + 3].copy_from_slice(&seen[7..10]);
                self.observed_ang_vel[3 * row..3 * row + 3].copy_from_slice(&seen[10..]);
            }
        }
    }
}

/// Where the obstacles of an arena stand.
pub(super) fn obstacles_of(arena: &mut Arena<f32>) -> BatchObstacles<'_> {
    let n_obstacles = arena.n_obstacles();
    let (pos_m, quat_xyzw) = arena.obstacles_mut();
    BatchObstacles { n_obstacles, pos_m, quat_xyzw }
}

/// Where a task starts a drone, refused unless all of it are numbers near enough to fly from.
fn start_of(batch: &Batch, world: usize, drone: usize) -> Result<Start, EnvError> {
    let row = world * batch.n_drones + drone;
    let three = |list: &[f32]| core::array::from_fn(|k| f64::from(list[3 * row + k]));
    let start = Start {
        vel_m_s: three(&batch.start_vel),
        ..Start::at(three(&batch.start_pos)).facing(f64::from(batch.start_yaw[row]))
    };
    for (name, numbers) in
        [("start_pos", &start.pos_m[..]), ("start_vel", &start.vel_m_s), ("start_yaw", &start.turn_rad[2..])]
    {
        // Beyond this f32 has no fractions of a metre left.
        if !numbers.iter().all(|v| v.abs() < 1e6) {
            let what = format!(
                "{name} of world {world}, drone {drone}, after on_reset: expected numbers between -1e6 and 1e6, got {numbers:?}; fill \
                 it in for all worlds that begin, or give the task a start_space"
            );
            return Err(EnvError::Task { what });
        }
    }
    Ok(start)
}

/// How a world goes on, by the number that a task gave.
fn ending_of(world: usize, number: u8) -> Result<Ending, EnvError> {
    let own = [Ending::None, Ending::Crashed, Ending::Left, Ending::Done];
    own.into_iter().find(|ending| *ending as u8 == number).ok_or_else(|| EnvError::Task {
        what: format!(
            "ending of world {world}: expected 0 (it goes on), 1 (crashed), 2 (left) or 3 (done), got {number}"
        ),
    })
}

/// A channel that holds something else than numbers.
fn not_finite(channels: &[Channel], world: usize, drone: usize, entry: usize, got: f32) -> EnvError {
    let mut first = 0;
    let found = channels.iter().find(|channel| {
        first += channel.width;
        entry < first
    });
    let what = format!("channel {} (observe)", found.map_or("", |channel| &channel.name));
    EnvError::NotFinite { what, world, drone, got }
}
