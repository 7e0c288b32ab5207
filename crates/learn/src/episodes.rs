//! Episodes of many worlds: where each is in time, what it remembers, when it ends and begins anew.

use crate::LearnError;
use crate::goal::{Actions, Goal, Outcome, Seen};
use propwash_rollout::pilot::Place;
use propwash_rollout::random::{Key, Stream, purpose};
use propwash_rollout::tape::state_width;
use propwash_rollout::{Engine, Sim, SimOptions};
use propwash_trace::lanes::{Cell, F32x16};
use propwash_vehicle::Vehicle;

/// Numbers that are drawn for one purpose: a world's, in an episode or an update.
pub(crate) fn stream(seed: u64, world: usize, number: u64, what: &str) -> Stream {
    Key { seed, world: world as u64, drone: 0, step: number, purpose: purpose(what) }.stream()
}

/// Worlds that fly episodes of a goal.
pub(crate) struct Episodes<'a, G> {
    pub goal: &'a G,
    pub sim: Sim<f32>,
    /// Numbers of a state.
    pub width: usize,
    /// Time under each command, s.
    pub step_s: f64,
    /// Time of each world, and time at which its episode ends, s.
    pub time_s: Vec<f64>,
    ends_s: Vec<f64>,
    /// What each remembers. (world, number)
    pub memory: Vec<f64>,
    /// Episodes that were lost.
    pub lost: usize,
    seed: u64,
    begun: Vec<u64>,
}

impl<'a, G: Goal> Episodes<'a, G> {
    /// Worlds in which first episodes begin: they end at different times, so that later ones do not all begin together.
    pub fn new(
        goal: &'a G,
        (vehicle, dynamics): (&Vehicle, &str),
        actions: &Actions,
        (worlds, seed): (usize, u64),
        (substeps, sim_hz): (usize, u32),
    ) -> Result<Self, LearnError> {
        let options = SimOptions {
            n_worlds: worlds,
            seed,
            sim_hz,
            control: actions.mode,
            engine: Engine::Lanes,
            ..SimOptions::default()
        };
        let sim = Sim::<f32>::storing(options, vec![(vehicle.drone(dynamics)?, vehicle.rates)])?;
        let mut made = Self {
            goal,
            width: state_width(sim.data.n_rotors),
            sim,
            step_s: substeps as f64 / f64::from(sim_hz),
            time_s: vec![0.0; worlds],
            ends_s: vec![0.0; worlds],
            memory: vec![0.0; worlds * goal.memory()],
            lost: 0,
            seed,
            begun: vec![0; worlds],
        };
        made.begin(&vec![true; worlds])?;
        for (w, ends) in made.ends_s.iter_mut().enumerate() {
            *ends -= goal.episode_s() * w as f64 / worlds as f64;
        }
        Ok(made)
    }

    /// Begins episodes in these worlds.
    pub fn begin(&mut self, worlds: &[bool]) -> Result<(), LearnError> {
        let m = self.goal.memory();
        for w in (0..worlds.len()).filter(|w| worlds[*w]) {
            let mut random = stream(self.seed, w, self.begun[w], "learn.start");
            let memory = &mut self.memory[w * m..(w + 1) * m];
            memory.fill(0.0);
            let (state, time_s) = self.goal.start(&mut random, memory);
            self.sim.set_initial(w, 0, state)?;
            self.begun[w] += 1;
            (self.time_s[w], self.ends_s[w]) = (time_s, time_s + self.goal.episode_s());
        }
        Ok(self.sim.reset(Some(worlds))?)
    }

    /// Moves time on after a flight of so many commands, and begins episodes where they ended or went astray; says where. `over` tells how the episode of
    /// each world stands, and whether its numbers are void.
    pub fn go_on(
        &mut self,
        commands: usize,
        over: impl Fn(usize) -> (Outcome, bool),
    ) -> Result<Vec<bool>, LearnError> {
        let (worlds, m) = (self.time_s.len(), self.goal.memory());
        let mut anew = vec![false; worlds];
        let mut numbers = vec![0.0f32; self.width];
        for (w, anew) in anew.iter_mut().enumerate() {
            self.time_s[w] += commands as f64 * self.step_s;
            self.sim.data.copy_state(w, &mut numbers);
            let state: Vec<f64> = numbers.iter().map(|v| f64::from(*v)).collect();
            let memory = &self.memory[w * m..(w + 1) * m];
            let off = self.goal.off_m(&Seen::of(&state, self.time_s[w], memory));
            let (outcome, void) = over(w);
            let far = outcome == Outcome::On && (off.is_nan() || off > self.goal.far_off_m());
            let astray = void || far || outcome == Outcome::Lost;
            self.lost += usize::from(astray);
            *anew = astray || outcome == Outcome::Done || self.time_s[w] >= self.ends_s[w];
        }
        if anew.contains(&true) {
            self.begin(&anew)?;
        }
        Ok(anew)
    }
}

/// What one block of worlds remembers along a flight, in lanes, and how its episodes stand.
#[derive(Clone, Debug)]
pub(crate) struct Lives {
    /// What is remembered for each command, and after the last. (time, number)
    memory: Vec<F32x16>,
    /// One for each command before which the episode is not over, and after the last, else zero. (time)
    alive: Vec<F32x16>,
    /// How the episode stands, of each lane.
    outcome: [Outcome; F32x16::LANES],
    m: usize,
}

impl Lives {
    /// Of flights of `horizon` commands, with `m` numbers to be remembered.
    pub fn new(horizon: usize, m: usize) -> Self {
        let zero = F32x16::splat(0.0);
        let (memory, alive) = (vec![zero; (horizon + 1) * m], vec![zero; horizon + 1]);
        Self { memory, alive, outcome: [Outcome::On; F32x16::LANES], m }
    }

    /// Begins a flight of the block's worlds, of which this is the first.
    pub fn begin<G: Goal>(&mut self, episodes: &Episodes<G>, first: usize) {
        let (m, last) = (self.m, episodes.time_s.len() - 1);
        for (k, cell) in self.memory[..m].iter_mut().enumerate() {
            cell.fill(0, |lane| episodes.memory[(first + lane).min(last) * m + k] as f32);
        }
        self.alive.fill(F32x16::splat(1.0));
        self.outcome = [Outcome::On; F32x16::LANES];
    }

    /// Hands on what is remembered after the flight.
    pub fn end<G: Goal>(&self, episodes: &mut Episodes<G>, first: usize) {
        let m = self.m;
        let last = &self.memory[self.memory.len() - m..];
        let rows = episodes.memory[first * m..].chunks_exact_mut(m.max(1)).take(F32x16::LANES);
        for (lane, row) in rows.enumerate() {
            row.iter_mut().zip(last).for_each(|(v, cell)| *v = f64::from(cell.get(lane)));
        }
    }

    /// What is remembered after `t` commands.
    pub fn memory(&self, t: usize) -> &[F32x16] {
        &self.memory[t * self.m..(t + 1) * self.m]
    }

    /// Whether the episode of a lane was not over after `t` commands: one, else zero.
    pub fn alive(&self, t: usize, lane: usize) -> f32 {
        self.alive[t].0[lane]
    }

    /// How the episode of a lane stands.
    pub fn outcome(&self, lane: usize) -> Outcome {
        self.outcome[lane]
    }

    /// Judges command `at.t`, by the states before and after it and the time before it; where `far` is true, flights that are too far off are lost, too.
    pub fn judge<G: Goal>(
        &mut self,
        goal: &G,
        at: Place,
        (before, after): (&[F32x16], &[F32x16]),
        (time_s, step_s): (F32x16, f64),
        far: bool,
    ) {
        let m = self.m;
        if m == 0 && !far {
            return;
        }
        self.memory.copy_within(at.t * m..(at.t + 1) * m, (at.t + 1) * m);
        self.alive[at.t + 1] = self.alive[at.t];
        for lane in 0..at.n_worlds {
            if self.alive[at.t].0[lane] == 0.0 {
                continue;
            }
            let of = |state: &[F32x16]| -> [f64; 13] { std::array::from_fn(|i| f64::from(state[i].0[lane])) };
            let memory: Vec<f64> = self.memory(at.t).iter().map(|cell| f64::from(cell.0[lane])).collect();
            let (before, after) = (of(before), of(after));
            let time_s = f64::from(time_s.0[lane]);
            let end = Seen::of(&after, time_s + step_s, &memory);
            let off = if far { goal.off_m(&end) } else { 0.0 };
            let outcome = if off.is_nan() || off > goal.far_off_m() {
                Outcome::Lost
            } else if m > 0 {
                let mut changed = memory.clone();
                let outcome = goal.judge(&Seen::of(&before, time_s, &memory), &end, &mut changed);
                let to = &mut self.memory[(at.t + 1) * m..(at.t + 2) * m];
                to.iter_mut().zip(changed).for_each(|(cell, v)| cell.0[lane] = v as f32);
                outcome
            } else {
                Outcome::On
            };
            if outcome != Outcome::On {
                self.alive[at.t + 1].0[lane] = 0.0;
                self.outcome[lane] = outcome;
            }
        }
    }
}
