//! A task that is written down as expressions: what a Python class of the user becomes (`propwash.learn.Goal` in an environment).

use super::config::EnvConfig;
use super::formulas::{self, Formulas, MAX_ACTIONS, Seen, TracedTask, Verdict};
use super::task::{Channel, EpisodeStart, Outcome, Start, Task, WorldView, store};
use super::{EnvError, tasks};
use crate::learn::goals::written::{Remembered, STATE, Starts, check_bounds};
use crate::scalar::Real;
use crate::scalar::program::Program;
use crate::vehicle::expression::{ExpressionError, Sheet};

/// Names of what a task sees beside [`STATE`], what it remembers and `action1` … `before8`: the position a step ago (m), the distance to the nearest thing (m), 1 where the
/// drone touched something, how much the action changed (0 to 1), and the time of a step (s); see [`Seen`].
pub const SEEN_NAMES: [&str; 7] = ["px", "py", "pz", "clearance", "crashed", "action_change", "step"];

/// What is written down. Expressions read [`STATE`] (of which `t` counts from where the episode begins), what is remembered, `action1` … and `before1` … (−1 to 1), [`SEEN_NAMES`],
/// and named values before them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TaskTexts {
    /// The task's name.
    pub name: String,
    /// Values with names, in order.
    pub lets: Vec<(String, String)>,
    /// Channels by name, a number of each expression.
    pub observe: Vec<(String, Vec<String>)>,
    /// What a step is worth, seen at its end.
    pub reward: String,
    /// Not 0 where an episode ends, and the task failed; empty: never.
    pub left: String,
    /// Not 0 where it ends, and is done; empty: never.
    pub done: String,
    /// Whether an episode ends where the drone touches something.
    pub crash_ends: bool,
    /// What episodes remember.
    pub memory: Vec<Remembered>,
    /// The first of three numbers that are remembered and that the caller of a reset may give as a goal.
    pub goal: Option<usize>,
}

/// A task of expressions.
#[derive(Clone, Debug)]
pub struct WrittenTask {
    texts: TaskTexts,
    starts: Starts,
    sheet: Sheet,
    observe: Vec<Program>,
    reward: Program,
    left: Option<Program>,
    done: Option<Program>,
    next: Vec<Option<Program>>,
}

/// What is wrong with a task, in words.
fn wrong(what: impl std::fmt::Display) -> EnvError {
    EnvError::Task { what: what.to_string() }
}

impl WrittenTask {
    /// From what is written down, and where episodes begin.
    ///
    /// # Errors
    /// [`EnvError::Task`] for what is no expression, and for bounds that are not in order.
    pub fn new(texts: TaskTexts, starts: Starts) -> Result<Self, EnvError> {
        starts.check().map_err(wrong)?;
        texts.memory.iter().try_for_each(|m| check_bounds(m.between)).map_err(wrong)?;
        if texts.goal.is_some_and(|first| first + 3 > texts.memory.len()) {
            return Err(wrong("a goal: expected three numbers that are remembered"));
        }
        let mut names: Vec<String> = STATE.iter().map(ToString::to_string).collect();
        names.extend(texts.memory.iter().map(|m| m.name.clone()));
        for of in ["action", "before"] {
            names.extend((1..=MAX_ACTIONS).map(|k| format!("{of}{k}")));
        }
        names.extend(SEEN_NAMES.iter().map(ToString::to_string));
        let mut sheet = Sheet::over(names);
        let odd = |what: &str, e: ExpressionError| wrong(format!("{what}: {e}"));
        texts.lets.iter().try_for_each(|(name, text)| sheet.add(name, text).map_err(|e| odd(name, e)))?;
        let one = |what: &str, text: &str| sheet.program(text).map_err(|e| odd(what, e));
        let maybe =
            |what: &str, text: &str| if text.is_empty() { Ok(None) } else { one(what, text).map(Some) };
        let observe = texts.observe.iter().flat_map(|(name, list)| list.iter().map(move |text| (name, text)));
        let observe = observe.map(|(name, text)| one(name, text)).collect::<Result<_, _>>()?;
        let next = texts.memory.iter().map(|m| maybe(&m.name, &m.next)).collect::<Result<_, _>>()?;
        let (left, done) = (maybe("lost", &texts.left)?, maybe("done", &texts.done)?);
        Ok(Self { observe, reward: one("reward", &texts.reward)?, left, done, next, sheet, texts, starts })
    }

    /// Whether the time at the start is drawn, and is then remembered behind everything else.
    fn draws_time(&self) -> bool {
        let [low, high] = self.starts.time_s;
        low < high
    }

    /// All numbers that expressions may read.
    fn numbers<S: Real>(&self, seen: &Seen<S>, memory: &[S]) -> Vec<S> {
        let (own, rest) = memory.split_at(self.texts.memory.len());
        let begin = rest.first().copied().unwrap_or(S::lit(self.starts.time_s[0]));
        let time =
            if self.draws_time() || self.starts.time_s[0] != 0.0 { begin + seen.time_s } else { seen.time_s };
        let mut out =
            [&seen.pos_m[..], &seen.quat_xyzw, &seen.vel_m_s, &seen.ang_vel_rad_s, &[time], own].concat();
        out.extend(seen.action.iter().chain(&seen.action_before));
        out.extend(seen.previous_pos_m);
        out.extend([seen.clearance_m, seen.crashed, seen.action_change, seen.step_s]);
        self.sheet.numbers(out)
    }
}

impl Formulas for WrittenTask {
    fn verdict<S: Real>(&self, seen: &Seen<S>, memory: &[S]) -> Verdict<S> {
        let numbers = self.numbers(seen, memory);
        let mut verdict = Verdict::going_on(Sheet::value(&self.reward, &numbers));
        let says = |program: &Program| {
            let value = Sheet::value(program, &numbers);
            value.lt(S::zero()) | value.gt(S::zero())
        };
        if self.texts.crash_ends {
            verdict.crashed = seen.crashed.gt(S::lit(0.5));
        }
        if let Some(program) = &self.left {
            verdict.left = says(program);
        }
        if let Some(program) = &self.done {
            verdict.done = says(program);
        }
        verdict
    }

    fn observation<S: Real>(&self, seen: &Seen<S>, memory: &[S], out: &mut [S]) {
        let numbers = self.numbers(seen, memory);
        for (to, program) in out.iter_mut().zip(&self.observe) {
            *to = Sheet::value(program, &numbers);
        }
    }

    fn remembers(&self) -> bool {
        self.next.iter().any(Option::is_some)
    }

    fn remember<S: Real>(&self, seen: &Seen<S>, memory: &mut [S]) {
        let numbers = self.numbers(seen, memory);
        for (to, program) in memory.iter_mut().zip(&self.next) {
            if let Some(program) = program {
                *to = Sheet::value(program, &numbers);
            }
        }
    }
}

impl Task for WrittenTask {
    fn name(&self) -> &str {
        &self.texts.name
    }

    fn check(&self, config: &EnvConfig) -> Result<(), EnvError> {
        tasks::one_drone(&self.texts.name, config)
    }

    fn channels(&self) -> Vec<Channel> {
        self.texts.observe.iter().map(|(name, list)| Channel::new(name.clone(), list.len())).collect()
    }

    fn memory_len(&self, _: usize) -> usize {
        self.texts.memory.len() + usize::from(self.draws_time())
    }

    fn has_goal(&self) -> bool {
        self.texts.goal.is_some()
    }

    fn begin(&self, start: &mut EpisodeStart) -> Result<(), EnvError> {
        let Starts { pos_m, vel_m_s, ang_vel_rad_s, turn_rad, time_s } = self.starts;
        let mut draw = |[low, high]: [f64; 2]| start.draw.uniform(low, high);
        let (pos_m, vel_m_s) = (pos_m.map(&mut draw), vel_m_s.map(&mut draw));
        let mut memory: Vec<f64> = self.texts.memory.iter().map(|m| draw(m.between)).collect();
        let (ang_vel_rad_s, turn_rad) = (ang_vel_rad_s.map(&mut draw), turn_rad.map(&mut draw));
        if self.draws_time() {
            memory.push(draw(time_s));
        }
        if let (Some(first), Some(goal)) = (self.texts.goal, start.given_goal(0)) {
            memory[first..first + 3].copy_from_slice(&goal);
        }
        start.starts[0] = Start { pos_m, vel_m_s, ang_vel_rad_s, turn_rad };
        store(start.memory, &memory);
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
