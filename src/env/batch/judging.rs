//! Worlds that are observed, and judged by the formulas of their task, many at once.

use std::sync::{Mutex, PoisonError};

use super::rows::ROWS_AT_ONCE;
use super::world::{OPEN_GROUND_M, Plan, World, check_rewards};
use super::{Ending, Env, SERIAL};
use crate::env::EnvError;
use crate::env::formulas::{TracedTask, input, result};
use crate::env::task::STATE_WIDTH;
use crate::rollout::SimData;
use crate::rollout::pool::threads;
use crate::scalar::bytecode::Interpret;
use crate::scalar::formula::{Formula, Registers};
use crate::scalar::lanes::{Cell, Number};

/// Blocks of lanes in which formulas run: small ones for few worlds. Numbers are those of the reference, f64; results are rounded to
/// the f32 of the arrays.
type Narrow = <f64 as Number>::Cell;
type Wide = <f64 as Number>::Four;

/// The formulas of a task, and memory to run them in.
#[derive(Debug)]
pub(super) struct Formulas {
    formula: Formula,
    /// Inputs that it reads.
    reads: Vec<usize>,
    /// Where what is remembered stands among the results, where steps change it.
    remembered: Option<usize>,
    /// Registers that no thread works with now.
    narrow: Mutex<Vec<Registers<Narrow>>>,
    wide: Mutex<Vec<Registers<Wide>>>,
}

impl Formulas {
    /// Those of a task in an environment whose observed states are noisy or not.
    pub fn new(task: &TracedTask, is_noisy: bool) -> Self {
        let formula = if is_noisy { &task.noisy } else { &task.exact }.clone();
        let reads = formula.reads();
        let remembered = task.remembered;
        Self { formula, reads, remembered, narrow: Mutex::default(), wide: Mutex::default() }
    }

    /// Whether they look at how much the action changed.
    pub fn reads_action_change(&self) -> bool {
        self.reads.contains(&input::ACTION_CHANGE)
    }

    /// Whether they look at the actions.
    pub fn reads_actions(&self) -> bool {
        self.reads.iter().any(|i| (input::ACTION..input::TIME).contains(i))
    }

    /// Whether they look at where the drone was before.
    pub fn reads_previous(&self) -> bool {
        self.reads.iter().any(|i| (input::PREVIOUS..input::PREVIOUS + 3).contains(i))
    }
}

/// What is the same for all parts of the worlds.
struct Shared<'a> {
    plan: &'a Plan,
    data: &'a SimData<f32>,
    formulas: Option<&'a Formulas>,
    /// Which worlds are looked at; all where there is none.
    mask: Option<&'a [bool]>,
    judge: bool,
    /// The worlds have been looked at one by one: what is left are the formulas.
    looked: bool,
    parallel: bool,
    action_change: &'a [f32],
    clearance: &'a [f32],
    step: &'a [u64],
    acted: &'a [Vec<f32>; 2],
    memory_len: usize,
    memory_stride: usize,
    worlds: &'a [World],
}

/// Some consecutive worlds, and where what is said of them goes.
struct Part<'a> {
    /// Number of the first.
    first: usize,
    observation: &'a mut [f32],
    reward: &'a mut [f32],
    terminated: &'a mut [bool],
    truncated: &'a mut [bool],
    ending: &'a mut [u8],
    crashed: &'a mut [bool],
    ended: &'a mut [bool],
    last_pos: &'a mut [f32],
    previous_pos: &'a mut [f32],
    memory: &'a mut [f32],
}

impl<'a> Part<'a> {
    fn len(&self) -> usize {
        self.terminated.len()
    }

    /// The first `n` worlds and the others.
    fn split(self, n: usize) -> (Self, Self) {
        let all = self.len();
        // Arrays may be empty, or have several numbers of each world.
        fn cut<T>(array: &mut [T], n: usize, all: usize) -> (&mut [T], &mut [T]) {
            array.split_at_mut(array.len() / all * n)
        }
        let (observation, more_observation) = cut(self.observation, n, all);
        let (reward, more_reward) = cut(self.reward, n, all);
        let (terminated, more_terminated) = cut(self.terminated, n, all);
        let (truncated, more_truncated) = cut(self.truncated, n, all);
        let (ending, more_ending) = cut(self.ending, n, all);
        let (crashed, more_crashed) = cut(self.crashed, n, all);
        let (ended, more_ended) = cut(self.ended, n, all);
        let (last_pos, more_last) = cut(self.last_pos, n, all);
        let (previous_pos, more_previous) = cut(self.previous_pos, n, all);
        let (memory, more_memory) = cut(self.memory, n, all);
        let low = Self {
            first: self.first,
            observation,
            reward,
            terminated,
            truncated,
            ending,
            crashed,
            ended,
            last_pos,
            previous_pos,
            memory,
        };
        let high = Self {
            first: self.first + n,
            observation: more_observation,
            reward: more_reward,
            terminated: more_terminated,
            truncated: more_truncated,
            ending: more_ending,
            crashed: more_crashed,
            ended: more_ended,
            last_pos: more_last,
            previous_pos: more_previous,
            memory: more_memory,
        };
        (low, high)
    }
}

impl Env {
    /// Looks at worlds all at once, where nothing must be asked of each, and lets formulas judge and observe. `looked`: as in [`Shared`].
    pub(super) fn look_at_rows(
        &mut self,
        mask: Option<&[bool]>,
        judge: bool,
        looked: bool,
    ) -> Result<(), EnvError> {
        if looked && self.formulas.is_none() {
            return Ok(());
        }
        let n = self.worlds.len();
        let shared = Shared {
            plan: &self.plan,
            data: &self.arena.sim().data,
            formulas: self.formulas.as_ref(),
            mask,
            judge,
            looked,
            parallel: n >= SERIAL[0] && threads() > 1,
            action_change: &self.action_change,
            clearance: &self.clearance,
            step: &self.rows.step,
            acted: &self.rows.acted,
            memory_len: self.rows.memory_len,
            memory_stride: self.rows.memory_stride,
            worlds: &self.worlds,
        };
        let part = Part {
            first: 0,
            observation: &mut self.observation,
            reward: &mut self.reward,
            terminated: &mut self.terminated,
            truncated: &mut self.truncated,
            ending: &mut self.ending,
            crashed: &mut self.crashed,
            ended: &mut self.rows.ended,
            last_pos: &mut self.rows.last_pos,
            previous_pos: &mut self.rows.previous_pos,
            memory: &mut self.rows.memory,
        };
        shared.spread(part)
    }
}

impl Shared<'_> {
    /// Halves the worlds until few enough are left for one thread.
    fn spread(&self, part: Part) -> Result<(), EnvError> {
        if part.len() <= ROWS_AT_ONCE {
            return self.look(part);
        }
        let half = half_of(part.len());
        let (low, high) = part.split(half);
        if self.parallel {
            let (low, high) = rayon::join(|| self.spread(low), || self.spread(high));
            // The error of the first world counts, as where one thread does all.
            return low.and(high);
        }
        self.spread(low)?;
        self.spread(high)
    }

    fn is_wanted(&self, world: usize) -> bool {
        self.mask.is_none_or(|m| m[world])
    }

    fn look(&self, mut part: Part) -> Result<(), EnvError> {
        let worlds = part.first..part.first + part.len();
        if self.mask.is_some_and(|m| !m[worlds].contains(&true)) {
            return Ok(());
        }
        if !self.looked {
            self.see(&mut part);
        }
        let Some(formulas) = self.formulas else { return Ok(()) };
        if !part.last_pos.is_empty() {
            self.remember_places(&mut part);
        }
        if part.len() <= Narrow::LANES {
            return self.judge(formulas, &mut part, &formulas.narrow);
        }
        self.judge(formulas, &mut part, &formulas.wide)
    }

    /// What drones without a scene touch, and the state that is observed.
    fn see(&self, part: &mut Part) {
        let (d, width, data) = (self.plan.config.sim.n_drones(), self.plan.width, self.data);
        let first = part.first * d;
        let motion = data.pos.as_chunks::<3>().0[first..].iter().zip(&data.quat.as_chunks::<4>().0[first..]);
        let motion = motion.zip(&data.vel.as_chunks::<3>().0[first..]);
        let motion = motion.zip(&data.ang_vel.as_chunks::<3>().0[first..]);
        let rows = part.observation.chunks_exact_mut(width).zip(&mut *part.crashed);
        for (i, ((row, crashed), (((pos, quat), vel), ang_vel))) in rows.zip(motion).enumerate() {
            if self.mask.is_some_and(|m| !m[part.first + i / d]) {
                continue;
            }
            *crashed = f64::from(pos[2]) < OPEN_GROUND_M;
            let Some(state) = row.first_chunk_mut::<STATE_WIDTH>() else { continue };
            state[0..3].copy_from_slice(pos);
            state[3..7].copy_from_slice(quat);
            state[7..10].copy_from_slice(vel);
            state[10..13].copy_from_slice(ang_vel);
        }
    }

    /// Where drones were before this look at them.
    fn remember_places(&self, part: &mut Part) {
        let places =
            part.last_pos.as_chunks_mut::<3>().0.iter_mut().zip(part.previous_pos.as_chunks_mut::<3>().0);
        for (i, (last, previous)) in places.enumerate() {
            let w = part.first + i;
            if !self.is_wanted(w) {
                continue;
            }
            let now = core::array::from_fn(|k| self.data.pos[3 * w + k]);
            *previous = if self.data.steps[w] == 0 { now } else { *last };
            *last = now;
        }
    }

    /// Lets formulas judge and observe, block by block.
    fn judge<C: Interpret<Number = f64>>(
        &self,
        formulas: &Formulas,
        part: &mut Part,
        free: &Mutex<Vec<Registers<C>>>,
    ) -> Result<(), EnvError> {
        let lent = free.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let mut registers = lent.unwrap_or_else(|| Registers::new(&formulas.formula));
        let mut outcome = Ok(());
        for from in (0..part.len()).step_by(C::LANES) {
            let to = (from + C::LANES).min(part.len());
            let worlds = part.first + from..part.first + to;
            if self.mask.is_some_and(|m| !m[worlds].contains(&true)) {
                continue;
            }
            self.fill(formulas, part, from..to, &mut registers);
            registers.run(&formulas.formula);
            self.write_channels(formulas, part, from..to, &registers);
            if self.judge {
                outcome = outcome.and(self.conclude(formulas, part, from..to, &registers));
                if let Some(first) = formulas.remembered {
                    outcome = outcome.and(self.remember((formulas, first), part, from..to, &registers));
                }
            }
        }
        free.lock().unwrap_or_else(PoisonError::into_inner).push(registers);
        outcome
    }

    /// Writes what formulas read of the worlds `own` of a part into lanes; lanes without a world repeat the last.
    fn fill<C: Interpret<Number = f64>>(
        &self,
        formulas: &Formulas,
        part: &Part,
        own: std::ops::Range<usize>,
        registers: &mut Registers<C>,
    ) {
        let (data, n) = (self.data, own.len());
        let first = part.first + own.start;
        let of = |lane: usize| lane.min(n - 1);
        for i in &formulas.reads {
            let cell = registers.input(*i);
            let mut from = |numbers: &[f32], width: usize, k: usize| {
                column(cell, &numbers[first * width..], width, k, n)
            };
            match *i {
                k @ 0..3 => from(&data.pos, 3, k),
                k @ 3..7 => from(&data.quat, 4, k - 3),
                k @ 7..10 => from(&data.vel, 3, k - 7),
                k @ 10..STATE_WIDTH => from(&data.ang_vel, 3, k - 10),
                input::CLEARANCE => from(self.clearance, 1, 0),
                input::ACTION_CHANGE => from(self.action_change, 1, 0),
                k @ input::ACTION..input::TIME => {
                    let (list, k) = match k < input::ACTION_BEFORE {
                        true => (&self.acted[0], k - input::ACTION),
                        false => (&self.acted[1], k - input::ACTION_BEFORE),
                    };
                    match self.plan.action_width {
                        width if k < width => from(list, width, k),
                        _ => *cell = C::splat(0.0),
                    }
                }
                k @ input::MEMORY.. => {
                    let own_memory = &part.memory[own.start * self.memory_stride..];
                    column(cell, own_memory, self.memory_stride, k - input::MEMORY, n);
                }
                input::FLOWN => {
                    cell.fill(0, |lane| f64::from(u8::from(self.judge && self.has_flown(first + of(lane)))));
                }
                input::CRASHED => {
                    cell.fill(0, |lane| f64::from(u8::from(part.crashed[own.start + of(lane)])));
                }
                input::TIME => {
                    let step_s = self.plan.config.step_s();
                    cell.fill(0, |lane| self.step[first + of(lane)] as f64 * step_s);
                }
                input::STEP => *cell = C::splat(self.plan.config.step_s()),
                k @ input::OBSERVED..input::MEMORY => {
                    cell.fill(0, |lane| self.worlds[first + of(lane)].shown(k - input::OBSERVED));
                }
                k => {
                    let previous = &part.previous_pos[3 * own.start..];
                    cell.fill(0, |lane| f64::from(previous[3 * of(lane) + k - input::PREVIOUS]));
                }
            }
        }
    }

    /// Writes the channels of the task.
    fn write_channels<C: Interpret<Number = f64>>(
        &self,
        formulas: &Formulas,
        part: &mut Part,
        own: std::ops::Range<usize>,
        registers: &Registers<C>,
    ) {
        let (width, n) = (self.plan.width, self.plan.width - STATE_WIDTH);
        let rows = &mut part.observation[own.start * width..own.end * width];
        let wanted = |lane: usize| self.is_wanted(part.first + own.start + lane);
        let channel = |k: usize| registers.output(&formulas.formula, result::CHANNELS + k);
        // Most channels are vectors: three numbers of a row at a time.
        for k in (0..n / 3).map(|k| 3 * k) {
            let cells = [channel(k), channel(k + 1), channel(k + 2)];
            for (lane, row) in rows.chunks_exact_mut(width).enumerate().filter(|(lane, _)| wanted(*lane)) {
                if let Some(to) = row[STATE_WIDTH + k..].first_chunk_mut() {
                    *to = cells.map(|cell| cell.get(lane) as f32);
                }
            }
        }
        for k in n / 3 * 3..n {
            let cell = channel(k);
            for (lane, row) in rows.chunks_exact_mut(width).enumerate().filter(|(lane, _)| wanted(*lane)) {
                row[STATE_WIDTH + k] = cell.get(lane) as f32;
            }
        }
    }

    /// Whether a world has flown in this step, and its state is one.
    fn has_flown(&self, world: usize) -> bool {
        self.data.steps[world] != 0 && self.data.quarantine[world].is_none()
    }

    /// Writes what the task remembers of worlds that have flown.
    fn remember<C: Interpret<Number = f64>>(
        &self,
        (formulas, results): (&Formulas, usize),
        part: &mut Part,
        own: std::ops::Range<usize>,
        registers: &Registers<C>,
    ) -> Result<(), EnvError> {
        for (lane, i) in own.enumerate().filter(|(_, i)| self.has_flown(part.first + i)) {
            let row = &mut part.memory[i * self.memory_stride..][..self.memory_len];
            for (k, to) in row.iter_mut().enumerate() {
                *to = registers.output(&formulas.formula, results + k).get(lane) as f32;
            }
            if let Some(got) = row.iter().find(|v| !v.is_finite()) {
                let (world, what) = (part.first + i, "what is remembered".into());
                return Err(EnvError::NotFinite { what, world, drone: 0, got: *got });
            }
        }
        Ok(())
    }

    /// Writes rewards, and ends the episodes of worlds or lets them go on.
    fn conclude<C: Interpret<Number = f64>>(
        &self,
        formulas: &Formulas,
        part: &mut Part,
        own: std::ops::Range<usize>,
        registers: &Registers<C>,
    ) -> Result<(), EnvError> {
        let reward = registers.output(&formulas.formula, result::REWARD);
        let ending = registers.output(&formulas.formula, result::ENDING);
        for (lane, i) in own.enumerate() {
            let w = part.first + i;
            let ending = match (self.data.quarantine[w].is_some(), self.data.steps[w] == 0) {
                (true, _) => Ending::Quarantined,
                (false, true) => Ending::None,
                (false, false) => {
                    part.reward[i] = reward.get(lane) as f32;
                    if !part.reward[i].is_finite() {
                        check_rewards(w, &part.reward[i..=i])?;
                    }
                    Ending::by_task(ending.get(lane) as u8)
                }
            };
            if matches!(ending, Ending::Quarantined) || self.data.steps[w] == 0 {
                part.reward[i] = 0.0;
            }
            let out = (&mut part.terminated[i], &mut part.truncated[i], &mut part.ending[i]);
            part.ended[i] = self.plan.conclude(self.step[w], ending, out);
        }
        Ok(())
    }
}

/// Where some worlds are cut in two, so that parts are whole blocks of lanes.
fn half_of(n: usize) -> usize {
    n.div_ceil(ROWS_AT_ONCE) / 2 * ROWS_AT_ONCE
}

/// Writes a column of the first `n` rows of an array into lanes; lanes without a row repeat the last.
#[inline(always)]
fn column<C: Cell<Number = f64>>(cell: &mut C, numbers: &[f32], width: usize, k: usize, n: usize) {
    if n == C::LANES {
        // One check for all lanes.
        let numbers = &numbers[k..=(C::LANES - 1) * width + k];
        return cell.fill(0, |lane| f64::from(numbers[lane * width]));
    }
    cell.fill(0, |lane| f64::from(numbers[lane.min(n - 1) * width + k]));
}
