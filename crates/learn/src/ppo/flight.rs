//! Flights under drawn actions, and what is kept of them.

use std::sync::{Mutex, MutexGuard, PoisonError};

use super::Options;
use super::update::Samples;
use crate::LearnError;
use crate::episodes::{Episodes, Lives, stream};
use crate::goal::{Actions, Goal};
use crate::network::Network;
use crate::traced::Traced;
use propwash_rollout::pilot::{Commander, Place};
use propwash_rollout::random::Stream;
use propwash_trace::formula::Registers;
use propwash_trace::lanes::{Cell, F32x16};

/// What is kept of one block of worlds during a flight.
pub(super) struct Block {
    observe: Registers<F32x16>,
    price: Registers<F32x16>,
    /// What the network keeps for one observation.
    kept: Vec<F32x16>,
    /// Draws of each lane.
    draws: Vec<Stream>,
    /// The state for which the last command was given.
    before: Vec<F32x16>,
    /// The action before the flight, and those that were flown, held between −1 and 1. (time, action)
    flown: Vec<F32x16>,
    /// Time of each world when the flight began, s.
    time_s: F32x16,
    /// Observations before each command and after the last. (time, number)
    pub observations: Vec<F32x16>,
    /// Actions as they were drawn. (time, action)
    pub actions: Vec<F32x16>,
    /// Logarithms of their likelihoods, but for what is the same for all. (time)
    pub likelihoods: Vec<F32x16>,
    /// What each command cost. (time)
    pub costs: Vec<F32x16>,
    pub lives: Lives,
    /// Worlds in the block.
    pub worlds: usize,
    /// Its numbers stopped being numbers.
    pub void: bool,
}

/// Commands the worlds by actions that are drawn around those of the network.
struct Explorer<'a, G> {
    goal: &'a G,
    network: &'a Network,
    std: Vec<f32>,
    actions: &'a Actions,
    traced: &'a Traced,
    blocks: &'a [Mutex<Block>],
    horizon: usize,
    step_s: f64,
}

impl<G> Explorer<'_, G> {
    fn block(&self, at: Place) -> MutexGuard<'_, Block> {
        self.blocks[at.first_world / F32x16::LANES].lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn time(&self, block: &Block, t: usize) -> F32x16 {
        F32x16(block.time_s.0.map(|v| v + t as f32 * self.step_s as f32))
    }

    fn observe(&self, block: &mut Block, t: usize, state: &[F32x16]) {
        let time = self.time(block, t);
        for (i, cell) in state.iter().chain([&time]).chain(block.lives.memory(t)).enumerate() {
            *block.observe.input(i) = *cell;
        }
        block.observe.run(&self.traced.observe);
        let n = self.network.widths()[0];
        for (k, cell) in block.observations[t * n..(t + 1) * n].iter_mut().enumerate() {
            *cell = *block.observe.output(&self.traced.observe, k);
        }
    }
}

/// The logarithm of the likelihood of an action under normal draws, but for what does not depend on it or on the network: −½ Σ z² − Σ log σ, z in standard
/// deviations.
pub(super) fn likelihood(action: &[F32x16], middle: &[F32x16], std: &[f32], lane: usize) -> f32 {
    let mut sum = 0.0;
    for ((a, m), s) in action.iter().zip(middle).zip(std) {
        let z = (a.0[lane] - m.0[lane]) / s;
        sum -= 0.5 * z * z + s.ln();
    }
    sum
}

impl<G: Goal> Commander<f32> for Explorer<'_, G> {
    fn command(&self, at: Place, state: &[F32x16], command: &mut [F32x16]) {
        let mut guard = self.block(at);
        let block = &mut *guard;
        block.before.clear();
        block.before.extend_from_slice(state);
        self.observe(block, at.t, state);
        let (observations, n) = (self.network.widths()[0], self.actions.len());
        let own = &block.observations[at.t * observations..(at.t + 1) * observations];
        block.kept[..observations].copy_from_slice(own);
        self.network.forward(&mut block.kept);
        let middle = &block.kept[block.kept.len() - n..];
        let drawn = &mut block.actions[at.t * n..(at.t + 1) * n];
        drawn.copy_from_slice(middle);
        for (lane, draws) in block.draws.iter_mut().enumerate() {
            for (cell, std) in drawn.iter_mut().zip(&self.std) {
                cell.0[lane] += std * draws.normal() as f32;
            }
        }
        block.likelihoods[at.t].fill(0, |lane| likelihood(drawn, middle, &self.std, lane));
        let flown = &mut block.flown[(at.t + 1) * n..(at.t + 2) * n];
        for (k, cell) in command.iter_mut().enumerate() {
            let (low, high) = (self.actions.middle[k] as f32, self.actions.reach[k] as f32);
            flown[k] = F32x16(drawn[k].0.map(|a| a.clamp(-1.0, 1.0)));
            *cell = F32x16(flown[k].0.map(|a| low + high * a));
        }
    }

    fn look(&self, at: Place, state: &[F32x16]) {
        let mut guard = self.block(at);
        let block = &mut *guard;
        let n = self.actions.len();
        let time = self.time(block, at.t);
        block.lives.judge(self.goal, at, (&block.before, state), (time, self.step_s), true);
        let time = self.time(block, at.t + 1);
        let inputs = state.iter().chain([&time]).chain(block.lives.memory(at.t + 1));
        let (before, action) = block.flown[at.t * n..(at.t + 2) * n].split_at(n);
        for (i, cell) in inputs.chain(action).chain(before).enumerate() {
            *block.price.input(i) = *cell;
        }
        block.price.run(&self.traced.price);
        block.costs[at.t] = *block.price.output(&self.traced.price, 0);
        if at.t + 1 == self.horizon {
            self.observe(block, at.t + 1, state);
        }
    }

    fn lost(&self, at: Place) {
        self.block(at).void = true;
    }
}

/// Flights of all worlds.
pub(super) struct Flights {
    traced: Traced,
    blocks: Vec<Mutex<Block>>,
    options: Options,
}

fn own(block: &mut Mutex<Block>) -> &mut Block {
    block.get_mut().unwrap_or_else(PoisonError::into_inner)
}

impl Flights {
    pub fn new<G: Goal>(episodes: &Episodes<G>, actions: &Actions, options: &Options) -> Self {
        let (goal, n, times) = (episodes.goal, actions.len(), options.horizon);
        let (observations, zero) = (goal.observations(), F32x16::splat(0.0));
        let traced = Traced::new(goal, episodes.width, n);
        let kept = observations + options.hidden.iter().sum::<usize>() + n;
        let block = |k: usize| {
            Mutex::new(Block {
                observe: Registers::new(&traced.observe),
                price: Registers::new(&traced.price),
                kept: vec![zero; kept],
                draws: Vec::new(),
                before: Vec::new(),
                flown: vec![zero; (times + 1) * n],
                time_s: zero,
                observations: vec![zero; (times + 1) * observations],
                actions: vec![zero; times * n],
                likelihoods: vec![zero; times],
                costs: vec![zero; times],
                lives: Lives::new(times, goal.memory()),
                worlds: (options.worlds - k * F32x16::LANES).min(F32x16::LANES),
                void: false,
            })
        };
        let blocks = (0..options.worlds.div_ceil(F32x16::LANES)).map(block).collect();
        Self { traced, blocks, options: options.clone() }
    }

    /// Flies all worlds once; returns the mean cost of a command.
    pub fn fly<G: Goal>(
        &mut self,
        episodes: &mut Episodes<G>,
        actions: &Actions,
        (network, log_std): (&Network, &[f32]),
        number: u64,
    ) -> Result<f64, LearnError> {
        let worlds = self.options.worlds;
        for (k, block) in self.blocks.iter_mut().enumerate() {
            let (block, first) = (own(block), k * F32x16::LANES);
            block.void = false;
            block.time_s.fill(0, |lane| episodes.time_s[(first + lane).min(worlds - 1)] as f32);
            block.lives.begin(episodes, first);
            let draws = |lane| stream(self.options.seed, first + lane, number, "learn.action");
            block.draws = (0..block.worlds).map(draws).collect();
        }
        let explorer = Explorer {
            goal: episodes.goal,
            network,
            std: log_std.iter().map(|v| v.exp()).collect(),
            actions,
            traced: &self.traced,
            blocks: &self.blocks,
            horizon: self.options.horizon,
            step_s: episodes.step_s,
        };
        episodes.sim.fly_commanded(&explorer, self.options.horizon, self.options.substeps)?;
        let (mut cost, mut count, n) = (0.0, 0.0, actions.len());
        for (k, block) in self.blocks.iter_mut().enumerate() {
            let block = own(block);
            if block.void {
                continue;
            }
            block.lives.end(episodes, k * F32x16::LANES);
            let last = block.flown.len() - n;
            block.flown.copy_within(last.., 0);
            for (t, costs) in block.costs.iter().enumerate() {
                for lane in (0..block.worlds).filter(|l| block.lives.alive(t, *l) > 0.0) {
                    (cost, count) = (cost + f64::from(costs.0[lane]), count + 1.0);
                }
            }
        }
        Ok(if count > 0.0 { cost / count } else { 0.0 })
    }

    /// What the flights gave.
    pub fn samples(&mut self) -> Samples<'_> {
        let blocks: Vec<&Block> = self.blocks.iter_mut().map(|block| &*own(block)).collect();
        let actions = blocks[0].actions.len() / self.options.horizon;
        let observations = blocks[0].observations.len() / (self.options.horizon + 1);
        Samples { blocks, times: self.options.horizon, actions, observations }
    }

    /// Moves time on, and begins episodes where they ended.
    pub fn go_on<G: Goal>(&mut self, episodes: &mut Episodes<G>) -> Result<(), LearnError> {
        let blocks: Vec<&Block> = self.blocks.iter_mut().map(|block| &*own(block)).collect();
        let over = |w: usize| {
            let block = blocks[w / F32x16::LANES];
            (block.lives.outcome(w % F32x16::LANES), block.void)
        };
        let anew = episodes.go_on(self.options.horizon, over)?;
        let n = blocks[0].actions.len() / self.options.horizon;
        for w in (0..anew.len()).filter(|w| anew[*w]) {
            let block = own(&mut self.blocks[w / F32x16::LANES]);
            block.flown[..n].iter_mut().for_each(|cell| cell.set(w % F32x16::LANES, 0.0));
        }
        Ok(())
    }
}
