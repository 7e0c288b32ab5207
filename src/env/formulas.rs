//! Tasks as formulas over numbers: written once, they are computed for one world over `f64`, for whole batches in lanes, and over any
//! other [`Real`], such as numbers with derivatives.

use super::task::{DroneView, Outcome, STATE_WIDTH, Task, WorldView};
use crate::scalar::Real;
use crate::scalar::formula::Formula;
use crate::scalar::trace::Sym;

/// Most numbers of an action.
pub const MAX_ACTIONS: usize = 8;

/// One drone after a step, as formulas see it.
#[derive(Clone, Copy, Debug)]
pub struct Seen<S> {
    /// Position, m, world frame.
    pub pos_m: [S; 3],
    /// Attitude x y z w, body to world.
    pub quat_xyzw: [S; 4],
    /// Velocity, m/s, world frame.
    pub vel_m_s: [S; 3],
    /// Angular velocity, rad/s, body frame.
    pub ang_vel_rad_s: [S; 3],
    /// Position a step ago, m, world frame; in a new episode that of the start.
    pub previous_pos_m: [S; 3],
    /// Distance to the nearest thing, m, at most the environment's `look_m`; that without a scene.
    pub clearance_m: S,
    /// 1 where it touched something on its way in this step, or is below height zero without a scene; else 0.
    pub crashed: S,
    /// How much the action changed since the step before, 0 to 1: see [`WorldView::action_change`].
    pub action_change: S,
    /// The action of the step, each number from −1 to 1, where 0 hovers, whatever units it was given in; zeros behind its numbers.
    pub action: [S; MAX_ACTIONS],
    /// That of the step before; zeros in the first step of an episode.
    pub action_before: [S; MAX_ACTIONS],
    /// Seconds since the episode began.
    pub time_s: S,
    /// Seconds of a step of the environment.
    pub step_s: S,
}

/// What a task says of a step. Of several endings the first in this order counts.
#[derive(Clone, Copy, Debug)]
pub struct Verdict<S: Real> {
    /// The reward.
    pub reward: S,
    /// The episode ends: [`Outcome::Crashed`].
    pub crashed: S::Mask,
    /// [`Outcome::Left`].
    pub left: S::Mask,
    /// [`Outcome::Done`].
    pub done: S::Mask,
}

impl<S: Real> Verdict<S> {
    /// The reward, and an episode that goes on.
    pub fn going_on(reward: S) -> Self {
        let never = S::one().lt(S::zero());
        Self { reward, crashed: never, left: never, done: never }
    }

    /// Number of its [`Ending`](super::Ending).
    fn ending(&self) -> S {
        let done = S::select(self.done, S::lit(3.0), S::zero());
        let left = S::select(self.left, S::lit(2.0), done);
        S::select(self.crashed, S::one(), left)
    }
}

/// Reward, ending and observation of a task as formulas: for tasks of worlds with one drone that look at its state and at what they
/// remember of the episode.
///
/// A type that implements it has [`Task::judge`], [`Task::observe`] and [`Task::formulas`] by [`judge`], [`observe`] and
/// [`TracedTask::of`]; the built-in `reach_pos` shows how.
pub trait Formulas {
    /// Judges a step. `memory` holds the numbers of [`Task::memory_len`].
    fn verdict<S: Real>(&self, seen: &Seen<S>, memory: &[S]) -> Verdict<S>;

    /// Writes the channels side by side. `seen` may be noisy.
    fn observation<S: Real>(&self, seen: &Seen<S>, memory: &[S], out: &mut [S]);

    /// Whether steps change what is remembered.
    fn remembers(&self) -> bool {
        false
    }

    /// Changes what is remembered after a step, where it [remembers](Formulas::remembers): the verdict on the step goes by what was remembered before it, the observation by
    /// what is after.
    fn remember<S: Real>(&self, _seen: &Seen<S>, _memory: &mut [S]) {}
}

/// What formulas see of the first drone of a world.
fn seen(view: &WorldView, drone: usize) -> Seen<f64> {
    let of: &DroneView = &view.drones[drone];
    Seen {
        pos_m: of.pos_m,
        quat_xyzw: of.quat_xyzw,
        vel_m_s: of.vel_m_s,
        ang_vel_rad_s: of.ang_vel_rad_s,
        previous_pos_m: of.previous_pos_m,
        clearance_m: of.clearance_m,
        crashed: f64::from(u8::from(of.crashed)),
        action_change: f64::from(view.action_change[drone]),
        action: view.action(drone),
        action_before: view.action_before(drone),
        time_s: view.time_s,
        step_s: view.step_s,
    }
}

fn wide(memory: &[f32]) -> Vec<f64> {
    memory.iter().map(|v| f64::from(*v)).collect()
}

/// [`Task::judge`] by the formulas of a task.
pub fn judge(task: &impl Formulas, view: &WorldView, memory: &mut [f32], reward: &mut [f32]) -> Outcome {
    let (seen, mut numbers) = (seen(view, 0), wide(memory));
    let verdict = task.verdict(&seen, &numbers);
    reward[0] = verdict.reward as f32;
    if task.remembers() {
        task.remember(&seen, &mut numbers);
        super::task::store(memory, &numbers);
    }
    match verdict {
        Verdict { crashed: true, .. } => Outcome::Crashed,
        Verdict { left: true, .. } => Outcome::Left,
        Verdict { done: true, .. } => Outcome::Done,
        _ => Outcome::Continue,
    }
}

/// [`Task::observe`] by the formulas of a task.
pub fn observe(task: &impl Formulas, view: &WorldView, memory: &[f32], drone: usize, out: &mut [f32]) {
    let mut numbers = vec![0.0; out.len()];
    task.observation(&seen(view, drone), &wide(memory), &mut numbers);
    super::task::store(out, &numbers);
}

/// Where the inputs of a traced task begin: what it sees in the order of the fields of [`Seen`], the state again as observed, and what it
/// remembers.
pub(super) mod input {
    use super::{MAX_ACTIONS, STATE_WIDTH};

    pub const STATE: usize = 0;
    pub const PREVIOUS: usize = STATE + STATE_WIDTH;
    pub const CLEARANCE: usize = PREVIOUS + 3;
    pub const CRASHED: usize = CLEARANCE + 1;
    pub const ACTION_CHANGE: usize = CRASHED + 1;
    pub const ACTION: usize = ACTION_CHANGE + 1;
    pub const ACTION_BEFORE: usize = ACTION + MAX_ACTIONS;
    pub const TIME: usize = ACTION_BEFORE + MAX_ACTIONS;
    pub const STEP: usize = TIME + 1;
    /// 1 where a step is judged that was flown, else 0.
    pub const FLOWN: usize = STEP + 1;
    pub const OBSERVED: usize = FLOWN + 1;
    pub const MEMORY: usize = OBSERVED + STATE_WIDTH;
}

/// Results of a traced task: the reward, the number of its ending, and behind them the channels and, where steps change it, what is
/// remembered.
pub(super) mod result {
    pub const REWARD: usize = 0;
    pub const ENDING: usize = 1;
    pub const CHANNELS: usize = 2;
}

/// The formulas of a task, traced so that they run for many worlds at once.
#[derive(Clone, Debug)]
pub struct TracedTask {
    /// Where the observed state is the true one: what judging and observing share is computed once.
    pub(super) exact: Formula,
    /// Where it has noise.
    pub(super) noisy: Formula,
    /// Where what is remembered stands among the results; none where steps do not change it.
    pub(super) remembered: Option<usize>,
}

impl TracedTask {
    /// Those of `task`.
    pub fn of<T: Task + Formulas>(task: &T) -> Self {
        let (memory_len, width) = (task.memory_len(1), task.channels().iter().map(|c| c.width).sum());
        let traced = |observed: usize| {
            Formula::new(input::MEMORY + memory_len, |v| {
                let (memory, seen) = (&v[input::MEMORY..], seen_in(v, input::STATE));
                let verdict = task.verdict(&seen, memory);
                let mut after = memory.to_vec();
                if task.remembers() {
                    task.remember(&seen, &mut after);
                    // A world that has just begun remembers what it began with.
                    let flown = v[input::FLOWN].gt(Sym::lit(0.5));
                    for (after, before) in after.iter_mut().zip(memory) {
                        *after = Sym::select(flown, *after, *before);
                    }
                }
                let mut channels = vec![Sym::zero(); width];
                task.observation(&seen_in(v, observed), &after, &mut channels);
                let kept = if task.remembers() { after } else { Vec::new() };
                [vec![verdict.reward, verdict.ending()], channels, kept].concat()
            })
        };
        let remembered = task.remembers().then_some(result::CHANNELS + width);
        Self { exact: traced(input::STATE), noisy: traced(input::OBSERVED), remembered }
    }
}

/// What formulas see in the inputs `v`, whose state begins at `state`.
fn seen_in(v: &[Sym], state: usize) -> Seen<Sym> {
    let three = |from: usize| core::array::from_fn(|k| v[from + k]);
    Seen {
        pos_m: three(state),
        quat_xyzw: core::array::from_fn(|k| v[state + 3 + k]),
        vel_m_s: three(state + 7),
        ang_vel_rad_s: three(state + 10),
        previous_pos_m: three(input::PREVIOUS),
        clearance_m: v[input::CLEARANCE],
        crashed: v[input::CRASHED],
        action_change: v[input::ACTION_CHANGE],
        action: core::array::from_fn(|k| v[input::ACTION + k]),
        action_before: core::array::from_fn(|k| v[input::ACTION_BEFORE + k]),
        time_s: v[input::TIME],
        step_s: v[input::STEP],
    }
}
