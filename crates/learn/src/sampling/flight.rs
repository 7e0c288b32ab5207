//! Flights under sampled commands, in lanes: each block of worlds draws its commands as it flies, and keeps nothing but what they cost.

use super::{Distance, Options};
use propwash_rollout::pilot::{Commander, Place};
use propwash_rollout::random::{Key, lasting_normals, purpose};
use propwash_trace::formula::Registers;
use propwash_trace::lanes::{Cell, F32x16};
use propwash_vehicle::expression::{Cost, Read};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// How commands are drawn about the means.
pub(super) struct Draws<'a> {
    pub options: &'a Options,
    /// Means of all modes, in the units of commands. (mode, time, number)
    pub means: &'a [f32],
    /// Numbers of a command that are drawn.
    pub drawn: &'a [usize],
    /// Number of the update: other draws in each.
    pub update: u64,
}

impl Draws<'_> {
    /// Draws the commands of sixteen samples of a mode at time `t`, and moves their `noise` on, one block for each number that is drawn.
    pub fn command(
        &self,
        (mode, t): (usize, usize),
        samples: &[u32; F32x16::LANES],
        noise: &mut [F32x16],
        command: &mut [F32x16],
    ) {
        let Options { horizon, lasting, .. } = *self.options;
        let step = self.update.wrapping_mul(horizon as u64).wrapping_add(t as u64);
        let key = Key { seed: self.options.seed, world: 0, drone: 0, step, purpose: purpose("learn.sample") };
        // The first draws are of full size at once.
        lasting_normals(key, samples, if t == 0 { 0.0 } else { lasting as f32 }, noise);
        let n = command.len();
        let mean = &self.means[(mode * horizon + t) * n..][..n];
        for (cell, mean) in command.iter_mut().zip(mean) {
            *cell = F32x16::splat(*mean);
        }
        let first = self.first_of(mode) as u32;
        // The first sample of each mode flies its mean.
        let mut share = F32x16::splat(1.0);
        for (share, sample) in share.0.iter_mut().zip(samples) {
            *share = if *sample == first { 0.0 } else { 1.0 };
        }
        for (noise, k) in noise.iter().zip(self.drawn) {
            let [spread, low, high] =
                [&self.options.spread, &self.options.low, &self.options.high].map(|list| list[*k] as f32);
            moved(&mut command[*k], noise, &share, [spread, low, high]);
        }
    }

    /// The first sample of a mode.
    pub fn first_of(&self, mode: usize) -> usize {
        mode * self.options.of_mode()
    }
}

/// Adds `share` × `spread` × noise to a number of a command, and holds it within its bounds.
fn moved(cell: &mut F32x16, noise: &F32x16, share: &F32x16, [spread, low, high]: [f32; 3]) {
    for i in 0..F32x16::LANES {
        let v = cell.0[i] + share.0[i] * (spread * noise.0[i]);
        let v = if v < low { low } else { v };
        cell.0[i] = if v > high { high } else { v };
    }
}

fn add(sum: &mut F32x16, cost: &F32x16) {
    for i in 0..F32x16::LANES {
        sum.0[i] += cost.0[i];
    }
}

/// What one block of worlds keeps as it flies.
pub(super) struct Block {
    registers: Registers<F32x16>,
    noise: Vec<F32x16>,
    command: Vec<F32x16>,
    before: Vec<F32x16>,
    /// What the commands so far cost.
    pub sum: F32x16,
}

impl Block {
    pub fn new(cost: &Cost, drawn: usize, width: usize) -> Self {
        let zero = F32x16::splat(0.0);
        Self {
            registers: Registers::new(cost.formula()),
            noise: vec![zero; drawn],
            command: vec![zero; width],
            before: vec![zero; width],
            sum: zero,
        }
    }

    /// Begins an update: what is given with it, and the command in force before.
    pub fn begin(&mut self, cost: &Cost, given: &[f32], in_force: &[f32]) {
        for (input, read) in cost.reads() {
            if let Read::Given(k) = read {
                *self.registers.input(*input) = F32x16::splat(given[*k]);
            }
        }
        for (cell, v) in self.command.iter_mut().zip(in_force) {
            *cell = F32x16::splat(*v);
        }
    }
}

/// Flies one round of samples, as many as there are worlds.
pub(super) struct Round<'a> {
    pub draws: Draws<'a>,
    pub cost: &'a Cost,
    pub reads_before: bool,
    pub blocks: &'a [Mutex<Block>],
    /// The first sample of the round.
    pub first: usize,
    /// Time at its start, and under each command, s.
    pub time_s: [f64; 2],
    pub distance: Option<&'a Distance<'a>>,
}

impl Round<'_> {
    fn block(&self, at: Place) -> MutexGuard<'_, Block> {
        self.blocks[at.first_world / F32x16::LANES].lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Commander<f32> for Round<'_> {
    fn command(&self, at: Place, _: &[F32x16], command: &mut [F32x16]) {
        let mut guard = self.block(at);
        let block = &mut *guard;
        if at.t == 0 {
            block.sum = F32x16::splat(0.0);
        }
        if self.reads_before {
            block.before.copy_from_slice(&block.command);
        }
        let first = (self.first + at.first_world) as u32;
        let samples = core::array::from_fn(|lane| first + lane as u32);
        let mode = (first as usize / self.draws.options.of_mode()).min(self.draws.options.modes - 1);
        self.draws.command((mode, at.t), &samples, &mut block.noise, command);
        block.command.copy_from_slice(command);
    }

    fn look(&self, at: Place, state: &[F32x16]) {
        let mut guard = self.block(at);
        let Block { registers, command, before, sum, .. } = &mut *guard;
        let last = at.t + 1 == self.draws.options.horizon;
        for (input, read) in self.cost.reads() {
            let cell = match *read {
                Read::State(k) => state[k],
                Read::Command(k) => command[k],
                Read::Before(k) => before[k],
                Read::Time => F32x16::splat((self.time_s[0] + (at.t + 1) as f64 * self.time_s[1]) as f32),
                Read::Last => F32x16::splat(f32::from(u8::from(last))),
                Read::Distance => match self.distance {
                    Some(of) => of(&[state[0], state[1], state[2]]),
                    None => F32x16::splat(f32::INFINITY),
                },
                // Since the update began.
                Read::Given(_) => continue,
            };
            *registers.input(*input) = cell;
        }
        registers.run(self.cost.formula());
        add(sum, registers.output(self.cost.formula(), 0));
    }

    fn lost(&self, at: Place) {
        self.block(at).sum = F32x16::splat(f32::INFINITY);
    }
}
