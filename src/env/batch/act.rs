//! From the actions of a step to commands.

use rayon::prelude::*;

use super::rows::ROWS_AT_ONCE;
use super::world::{Plan, World};
use super::{Env, SERIAL};
use crate::env::action::ActionKind;
use crate::env::task::yaw;
use crate::rollout::SimData;
use crate::rollout::pool::threads;

/// What some consecutive worlds are told, and where it goes.
struct Told<'a> {
    /// Number of the first of them.
    first: usize,
    worlds: &'a mut [World],
    step: &'a [u64],
    action: &'a [f32],
    last_action: &'a mut [f32],
    action_change: &'a mut [f32],
    clipped: &'a mut [bool],
    /// Commands that are flown from now on; where some are flown late, those of worlds are kept by them instead.
    command: &'a mut [f32],
}

impl Env {
    /// Turns actions into commands, and says how much each drone's changed.
    pub(super) fn act(&mut self, actions: &[f32]) {
        let plan = &self.plan;
        let d = plan.config.sim.n_drones();
        if plan.reads_actions {
            plan.keep_actions(actions, &mut self.rows.acted);
        }
        let SimData { command, pos, quat, .. } = self.arena.data_mut();
        let (rows, at) = (&mut self.rows, (&pos[..], &quat[..]));
        if self.worlds.len() < SERIAL[0] || threads() == 1 {
            let told = Told {
                first: 0,
                worlds: &mut self.worlds,
                step: &rows.step,
                action: actions,
                last_action: &mut rows.last_action,
                action_change: &mut self.action_change,
                clipped: &mut rows.clipped,
                command,
            };
            return plan.act(told, at);
        }
        let n = ROWS_AT_ONCE;
        let (numbers, commands) = (n * d * plan.action_width, n * d * plan.command_width);
        self.worlds
            .par_chunks_mut(n)
            .zip(rows.step.par_chunks(n).zip(actions.par_chunks(numbers)))
            .zip(rows.last_action.par_chunks_mut(numbers).zip(self.action_change.par_chunks_mut(n * d)))
            .zip(rows.clipped.par_chunks_mut(n).zip(command.par_chunks_mut(commands)))
            .enumerate()
            .for_each(
                |(i, (((worlds, (step, action)), (last_action, action_change)), (clipped, command)))| {
                    let first = i * n;
                    let told =
                        Told { first, worlds, step, action, last_action, action_change, clipped, command };
                    plan.act(told, at);
                },
            );
    }
}

impl Plan {
    /// Turns the actions of some worlds into their next commands, of drones that are at `at`: positions and attitudes of all worlds.
    fn act(&self, told: Told, at: (&[f32], &[f32])) {
        let (d, width) = (self.config.sim.n_drones(), self.action_width);
        let each = d * width;
        if self.compares_actions {
            for (w, action) in told.action.chunks_exact(each).enumerate() {
                let last = &mut told.last_action[w * each..(w + 1) * each];
                let change = &mut told.action_change[w * d..(w + 1) * d];
                self.compare(action, last, change, told.step[w] == 0);
            }
        }
        let is_plain = !self.is_late() && self.config.action.kind != ActionKind::Velocity;
        let (limits, normalized) = (&self.limits[0], self.config.action.normalized);
        if is_plain && d == 1 {
            let rows = told.action.chunks_exact(width).zip(told.command.chunks_exact_mut(self.command_width));
            for ((action, command), clipped) in rows.zip(told.clipped) {
                *clipped = limits.command(normalized, action, command);
            }
            return;
        }
        for (w, action) in told.action.chunks_exact(each).enumerate() {
            let own = w * d * self.command_width..(w + 1) * d * self.command_width;
            let world = &mut told.worlds[w];
            let mut kept = std::mem::take(&mut world.commands);
            let command = match kept.len() / (d * self.command_width) {
                0 => &mut told.command[own],
                ring => {
                    let slot = (told.step[w] % ring as u64) as usize * d * self.command_width;
                    &mut kept[slot..slot + d * self.command_width]
                }
            };
            told.clipped[w] = self.act_one(told.first + w, world, action, at, command);
            world.commands = kept;
        }
    }

    /// The command of one world. Returns whether an entry of its action was held within its limits.
    fn act_one(
        &self,
        w: usize,
        world: &mut World,
        action: &[f32],
        (pos, quat): (&[f32], &[f32]),
        command: &mut [f32],
    ) -> bool {
        let mut clipped = false;
        let of_drones =
            action.chunks_exact(self.action_width).zip(command.chunks_exact_mut(self.command_width));
        for (d, (action, command)) in of_drones.enumerate() {
            let limits = &self.limits[d];
            if self.config.action.kind != ActionKind::Velocity {
                clipped |= limits.command(self.config.action.normalized, action, command);
                continue;
            }
            let normalized = self.config.action.normalized;
            let values: [f64; 4] = core::array::from_fn(|i| {
                let (value, held) = limits.value(normalized, i, f64::from(action[i]));
                clipped |= held;
                value
            });
            let row = w * self.config.sim.n_drones() + d;
            let pos = core::array::from_fn(|k| f64::from(pos[3 * row + k]));
            let quat = core::array::from_fn(|k| f64::from(quat[4 * row + k]));
            let accel = self.config.action.max_accel_m_s2;
            world.set_points[d].follow(values, (pos, yaw(quat)), accel, self.config.step_s(), command);
        }
        clipped
    }

    /// How much the action of each drone of a world changed.
    fn compare(&self, action: &[f32], last: &mut [f32], change: &mut [f32], is_first: bool) {
        let width = self.action_width;
        for (d, (action, last)) in action.chunks_exact(width).zip(last.chunks_exact(width)).enumerate() {
            let limits = &self.limits[d];
            let mut sum = 0.0;
            for (i, (a, last)) in action.iter().zip(last).enumerate() {
                let range = if self.config.action.normalized {
                    2.0
                } else {
                    (limits.high[i] - limits.low[i]).max(f64::MIN_POSITIVE)
                };
                sum += (f64::from(a - last).abs() / range).min(1.0);
            }
            change[d] = if is_first { 0.0 } else { (sum / width as f64) as f32 };
        }
        last.copy_from_slice(action);
    }

    /// Keeps the actions as numbers from −1 to 1, and those before.
    fn keep_actions(&self, actions: &[f32], kept: &mut [Vec<f32>; 2]) {
        kept.swap(0, 1);
        let (d, width) = (self.config.sim.n_drones(), self.action_width);
        let rows = actions.chunks_exact(width).zip(kept[0].chunks_exact_mut(width));
        for (row, (action, to)) in rows.enumerate() {
            let limits = &self.limits[row % d];
            for (i, (a, to)) in action.iter().zip(to).enumerate() {
                *to = limits.unit(self.config.action.normalized, i, f64::from(*a)) as f32;
            }
        }
    }

    /// Whether commands may be flown later than they are given.
    pub(super) fn is_late(&self) -> bool {
        self.command_ring > 0
    }

    /// Every command that is kept becomes the neutral one, and so does the one in `command`, which is flown now.
    pub(super) fn fill_neutral(&self, world: &mut World, command: &mut [f32]) {
        command.copy_from_slice(&self.neutral);
        if self.config.action.kind == ActionKind::Velocity {
            for (point, command) in world.set_points.iter().zip(command.chunks_exact_mut(self.command_width))
            {
                let mut point = *point;
                let at = (point.pos_m, point.yaw_rad);
                point.follow([0.0; 4], at, 1.0, 0.0, command);
            }
        }
        for kept in world.commands.chunks_exact_mut(command.len()) {
            kept.copy_from_slice(command);
        }
    }
}
