//! Backpropagation through time: short flights of many worlds, and the exact gradient of what they cost by the weights of the network that commands them
//! (Mozer, "A focused backpropagation algorithm for temporal pattern recognition", 1989; through a simulator Suh et al., "Do differentiable simulators
//! give better policy gradients?", 2022).

use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::LearnError;
use crate::adam::Adam;
use crate::batch::{annealed, shorten, shuffle};
use crate::check::{above_zero, at_least_one, below_one, divides, up_to_one};
use crate::episodes::{Episodes, Lives, stream};
use crate::goal::{Actions, Goal, Outcome};
use crate::network::Network;
use crate::policy::Policy;
use crate::traced::Traced;
use crate::value::{Sample, Value};
use propwash_rollout::pilot::{Commander, Pilot, Place};
use propwash_trace::formula::Registers;
use propwash_trace::lanes::{Cell, F32x16};
use propwash_vehicle::Vehicle;

/// How a policy is trained.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Worlds that fly at once.
    pub worlds: usize,
    /// Commands of a flight, before its gradient is taken.
    pub horizon: usize,
    /// Steps of the simulation under each command, and steps per second.
    pub substeps: usize,
    /// Steps per second.
    pub sim_hz: u32,
    /// Commands in all, over all worlds.
    pub commands: usize,
    /// Widths of the layers between observation and action.
    pub hidden: Vec<usize>,
    /// Size of the first steps of Adam; it falls to nothing along half a cosine.
    pub rate: f32,
    /// Gradients that are longer are shortened to this.
    pub longest: f32,
    /// What comes after a flight's end is estimated by a value network and its slopes enter the gradient there; without it flights are taken as if
    /// nothing came after them.
    pub critic: Option<Critic>,
    /// Seed of weights and starts.
    pub seed: u64,
}

/// How the value network of short-horizon actor-critic learns (Xu et al., "Accelerated policy learning with parallel differentiable simulation", 2022).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Critic {
    /// What a cost counts one command later, below one.
    pub discount: f64,
    /// Share of longer returns in what the value network is taught (λ of TD(λ)).
    pub lambda: f64,
    /// Share of the way that the network whose slopes are used goes towards the one that learns, after each flight.
    pub follow: f32,
    /// Size of the first steps of Adam, which falls as that of the policy.
    pub rate: f32,
    /// How often the samples of a flight are gone through, and in how many parts.
    pub epochs: usize,
    /// Parts of the samples, each a step of Adam.
    pub parts: usize,
}

impl Default for Critic {
    fn default() -> Self {
        Self { discount: 0.97, lambda: 0.95, follow: 0.2, rate: 0.003, epochs: 4, parts: 4 }
    }
}

impl Default for Options {
    /// 16 worlds, 40 commands of 20 ms at 500 steps per second, 100,000 commands, two layers of 64.
    fn default() -> Self {
        Self {
            worlds: 16,
            horizon: 40,
            substeps: 10,
            sim_hz: 500,
            commands: 100_000,
            hidden: vec![64, 64],
            rate: 0.01,
            longest: 0.2,
            critic: None,
            seed: 0,
        }
    }
}

/// What a training cost along its way.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Curve {
    /// Commands flown so far.
    pub commands: Vec<usize>,
    /// Mean cost of a command since the last entry.
    pub cost: Vec<f64>,
}

/// A policy and how it came to be.
#[derive(Clone, Debug)]
pub struct Trained {
    /// The policy.
    pub policy: Policy,
    /// What it cost.
    pub curve: Curve,
    /// Worlds that began anew since their numbers stopped being numbers or they came too far off.
    pub lost: usize,
}

/// What is kept of one block of worlds during a flight.
struct Block {
    observe: Registers<F32x16>,
    observe_back: Registers<F32x16>,
    cost: Registers<F32x16>,
    /// What the network keeps, of each command.
    kept: Vec<F32x16>,
    /// States for which and after which commands were given. (time, number of a state)
    before: Vec<F32x16>,
    after: Vec<F32x16>,
    /// What is remembered, and which episodes are over.
    lives: Lives,
    /// What each command cost. (time)
    costs: Vec<F32x16>,
    /// What the loss gains by each action but for the flight. (time, action)
    by_action: Vec<F32x16>,
    /// The action before the flight.
    last_action: Vec<F32x16>,
    gains: Vec<F32x16>,
    by_weights: Vec<F32x16>,
    /// What the value network keeps for the end of the flight, and the cost to go that it says there.
    end: Vec<F32x16>,
    to_go: F32x16,
    /// Time of each world when the flight began, s.
    time_s: F32x16,
    cost_sum: f64,
    lost: bool,
}

impl Block {
    fn new(
        traced: &Traced,
        (horizon, width, n): (usize, usize, usize),
        memory: usize,
        network: &Network,
    ) -> Self {
        let zero = F32x16::splat(0.0);
        Self {
            observe: Registers::new(&traced.observe),
            observe_back: Registers::new(&traced.observe_back),
            cost: Registers::new(&traced.cost),
            kept: vec![zero; horizon * network.kept()],
            before: vec![zero; horizon * width],
            after: vec![zero; horizon * width],
            lives: Lives::new(horizon, memory),
            costs: vec![zero; horizon],
            by_action: vec![zero; horizon * n],
            last_action: vec![zero; n],
            gains: Vec::new(),
            by_weights: vec![zero; network.weights().len()],
            end: Vec::new(),
            to_go: zero,
            time_s: zero,
            cost_sum: 0.0,
            lost: false,
        }
    }
}

/// Flies and undoes, and keeps what is needed in between.
struct Learner<'a, G> {
    goal: &'a G,
    network: &'a Network,
    /// The value network and what a cost counts one command later.
    critic: Option<(&'a Value, f32)>,
    actions: &'a Actions,
    traced: &'a Traced,
    blocks: &'a [Mutex<Block>],
    width: usize,
    horizon: usize,
    step_s: f64,
    /// What each command of each world counts in the loss.
    share: f32,
}

impl<G> Learner<'_, G> {
    fn block(&self, at: Place) -> MutexGuard<'_, Block> {
        self.blocks[at.first_world / F32x16::LANES].lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Time of the worlds of a block after `t` commands.
    fn time(&self, block: &Block, t: usize) -> F32x16 {
        let mut cell = block.time_s;
        (0..F32x16::LANES).for_each(|lane| cell.set(lane, cell.get(lane) + t as f32 * self.step_s as f32));
        cell
    }

    /// What a cost after `t` commands counts, in a lane.
    fn weight(&self, block: &Block, at: Place, t: usize, lane: usize) -> f32 {
        if lane >= at.n_worlds {
            return 0.0;
        }
        let discount = self.critic.map_or(1.0, |(_, discount)| discount.powi(t as i32));
        self.share * discount * block.lives.alive(t, lane)
    }

    /// Writes the observation of a state after `t` commands.
    fn observe(&self, block: &mut Block, t: usize, state: &[F32x16], to: &mut [F32x16]) {
        let time = self.time(block, t);
        for (i, cell) in state.iter().chain([&time]).chain(block.lives.memory(t)).enumerate() {
            *block.observe.input(i) = *cell;
        }
        block.observe.run(&self.traced.observe);
        for (k, cell) in to.iter_mut().enumerate() {
            *cell = *block.observe.output(&self.traced.observe, k);
        }
    }

    /// Takes what a loss gains by the observation of a state after `t` commands (`block.gains`) to what it gains by the state, which is added.
    fn observe_back(&self, block: &mut Block, t: usize, after: bool, by_state: &mut [F32x16]) {
        let time = self.time(block, t);
        let width = self.width;
        let state = match after {
            true => &block.after[(t - 1) * width..t * width],
            false => &block.before[t * width..(t + 1) * width],
        };
        let inputs = state.iter().chain([&time]).chain(block.lives.memory(t));
        for (i, cell) in inputs.chain(&block.gains).enumerate() {
            *block.observe_back.input(i) = *cell;
        }
        block.observe_back.run(&self.traced.observe_back);
        for (k, gain) in by_state.iter_mut().enumerate() {
            let own = block.observe_back.output(&self.traced.observe_back, k);
            (0..F32x16::LANES).for_each(|lane| gain.set(lane, gain.get(lane) + own.get(lane)));
        }
    }

    /// Adds what the loss gains by the state at the flight's end through the cost to go there.
    fn seed_end(&self, block: &mut Block, at: Place, by_state: &mut [F32x16]) {
        let Some((value, _)) = self.critic else { return };
        let after = block.after[at.t * self.width..(at.t + 1) * self.width].to_vec();
        let mut end = std::mem::take(&mut block.end);
        end.resize(value.kept(), F32x16::splat(0.0));
        self.observe(block, at.t + 1, &after, &mut end[..self.network.widths()[0]]);
        block.to_go = value.estimate(&mut end);
        block.gains = value.slopes(&end);
        for cell in &mut block.gains {
            let mut weighed = *cell;
            for lane in 0..F32x16::LANES {
                // A sum over all later commands, each of which counts as one of this flight.
                let weight = if lane < at.n_worlds { block.lives.alive(at.t + 1, lane) } else { 0.0 };
                let discount = self.critic.map_or(1.0, |(_, d)| d.powi(at.t as i32 + 1));
                weighed.set(lane, self.share * discount * weight * cell.get(lane));
            }
            *cell = weighed;
        }
        block.end = end;
        self.observe_back(block, at.t + 1, true, by_state);
    }
}

impl<G: Goal> Commander<f32> for Learner<'_, G> {
    fn command(&self, at: Place, state: &[F32x16], command: &mut [F32x16]) {
        let mut guard = self.block(at);
        let block = &mut *guard;
        let (width, size) = (self.width, self.network.kept());
        block.before[at.t * width..(at.t + 1) * width].copy_from_slice(state);
        let mut all = std::mem::take(&mut block.kept);
        let kept = &mut all[at.t * size..(at.t + 1) * size];
        self.observe(block, at.t, state, &mut kept[..self.network.widths()[0]]);
        self.network.forward(kept);
        let action = &kept[size - self.actions.len()..];
        for (k, (cell, a)) in command.iter_mut().zip(action).enumerate() {
            let (middle, reach) = (self.actions.middle[k] as f32, self.actions.reach[k] as f32);
            cell.fill(0, |lane| middle + reach * a.get(lane));
        }
        block.kept = all;
    }

    fn look(&self, at: Place, state: &[F32x16]) {
        let mut guard = self.block(at);
        let block = &mut *guard;
        let (from, time) = (at.t * self.width, self.time(block, at.t));
        block.after[from..from + self.width].copy_from_slice(state);
        let before = &block.before[from..from + self.width];
        block.lives.judge(self.goal, at, (before, state), (time, self.step_s), false);
    }

    fn lost(&self, at: Place) {
        self.block(at).lost = true;
    }
}

impl<G: Goal> Pilot<f32> for Learner<'_, G> {
    fn seed(&self, at: Place, by_state: &mut [F32x16]) {
        let mut guard = self.block(at);
        let block = &mut *guard;
        let (width, size, n) = (self.width, self.network.kept(), self.actions.len());
        let time = self.time(block, at.t + 1);
        let action = |t: usize| &block.kept[(t + 1) * size - n..(t + 1) * size];
        let before = if at.t == 0 { &block.last_action[..] } else { action(at.t - 1) };
        let inputs = block.after[at.t * width..(at.t + 1) * width].iter().chain([&time]);
        let inputs = inputs.chain(block.lives.memory(at.t + 1));
        for (i, cell) in inputs.chain(action(at.t)).chain(before).enumerate() {
            *block.cost.input(i) = *cell;
        }
        block.cost.run(&self.traced.cost);
        let cost = *block.cost.output(&self.traced.cost, 0);
        block.costs[at.t] = cost;
        let alive = |lane: usize| block.lives.alive(at.t, lane);
        block.cost_sum += (0..at.n_worlds).map(|lane| f64::from(alive(lane) * cost.get(lane))).sum::<f64>();
        let share: [f32; F32x16::LANES] = std::array::from_fn(|lane| self.weight(block, at, at.t, lane));
        for (k, gain) in by_state.iter_mut().enumerate() {
            let own = block.cost.output(&self.traced.cost, 1 + k);
            (0..F32x16::LANES).for_each(|lane| gain.set(lane, gain.get(lane) + share[lane] * own.get(lane)));
        }
        for (t, first) in [(Some(at.t), 1 + width), (at.t.checked_sub(1), 1 + width + n)] {
            let Some(t) = t else { continue };
            for k in 0..n {
                let own = block.cost.output(&self.traced.cost, first + k);
                let gain = &mut block.by_action[t * n + k];
                (0..F32x16::LANES)
                    .for_each(|lane| gain.set(lane, gain.get(lane) + share[lane] * own.get(lane)));
            }
        }
        if at.t + 1 == self.horizon {
            self.seed_end(block, at, by_state);
        }
    }

    fn pull_back(&self, at: Place, by_command: &[F32x16], by_state: &mut [F32x16]) {
        let mut guard = self.block(at);
        let block = &mut *guard;
        let (size, n) = (self.network.kept(), self.actions.len());
        block.gains.clear();
        for k in 0..n {
            let reach = self.actions.reach[k] as f32;
            let mut cell = block.by_action[at.t * n + k];
            (0..F32x16::LANES)
                .for_each(|lane| cell.set(lane, cell.get(lane) + reach * by_command[k].get(lane)));
            block.gains.push(cell);
        }
        let kept = &block.kept[at.t * size..(at.t + 1) * size];
        self.network.backward(kept, &mut block.gains, &mut block.by_weights);
        self.observe_back(block, at.t, false, by_state);
    }
}

/// A training as it goes.
struct Training<'a, G: Goal> {
    episodes: Episodes<'a, G>,
    options: &'a Options,
    actions: Actions,
    traced: Traced,
    blocks: Vec<Mutex<Block>>,
    critic: Option<Taught>,
}

/// The value network that learns and the one that follows it, whose slopes are used.
struct Taught {
    how: Critic,
    learns: Value,
    used: Value,
    flights: u64,
}

fn own(block: &mut Mutex<Block>) -> &mut Block {
    block.get_mut().unwrap_or_else(PoisonError::into_inner)
}

impl<'a, G: Goal> Training<'a, G> {
    fn new(episodes: Episodes<'a, G>, options: &'a Options, actions: &Actions, network: &Network) -> Self {
        let (goal, n) = (episodes.goal, actions.len());
        let traced = Traced::new(goal, episodes.width, n);
        let sizes = (options.horizon, episodes.width, n);
        let block = || Mutex::new(Block::new(&traced, sizes, goal.memory(), network));
        let blocks = (0..options.worlds.div_ceil(F32x16::LANES)).map(|_| block()).collect();
        let critic = options.critic.map(|how| {
            let value = Value::new(goal.observations(), &options.hidden, options.seed);
            Taught { how, learns: value.clone(), used: value, flights: 0 }
        });
        Self { episodes, options, actions: actions.clone(), traced, blocks, critic }
    }

    /// Flies all worlds once; the gradient by the weights, and the mean cost.
    fn fly(&mut self, network: &Network) -> Result<(Vec<f32>, f64), LearnError> {
        let (worlds, horizon) = (self.options.worlds, self.options.horizon);
        let zero = F32x16::splat(0.0);
        for (k, block) in self.blocks.iter_mut().enumerate() {
            let block = own(block);
            block.by_action.fill(zero);
            block.by_weights.fill(zero);
            (block.cost_sum, block.lost) = (0.0, false);
            let first = k * F32x16::LANES;
            block.time_s.fill(0, |lane| self.episodes.time_s[(first + lane).min(worlds - 1)] as f32);
            block.lives.begin(&self.episodes, first);
        }
        let share = 1.0 / (worlds * horizon) as f32;
        let learner = Learner {
            goal: self.episodes.goal,
            network,
            critic: self.critic.as_ref().map(|taught| (&taught.used, taught.how.discount as f32)),
            actions: &self.actions,
            traced: &self.traced,
            blocks: &self.blocks,
            width: self.episodes.width,
            horizon,
            step_s: self.episodes.step_s,
            share,
        };
        self.episodes.sim.fly_piloted(&learner, horizon, self.options.substeps)?;
        let (mut gradient, mut cost) = (vec![0.0; network.weights().len()], 0.0);
        let (size, n) = (network.kept(), self.actions.len());
        for (k, block) in self.blocks.iter_mut().enumerate() {
            let block = own(block);
            let gains: Vec<f32> = Network::gathered(&block.by_weights).collect();
            block.lost |= gains.iter().any(|v| !v.is_finite());
            if block.lost {
                continue;
            }
            gradient.iter_mut().zip(gains).for_each(|(sum, v)| *sum += v);
            cost += block.cost_sum * f64::from(share);
            let last = &block.kept[horizon * size - n..];
            block.last_action.copy_from_slice(last);
            block.lives.end(&mut self.episodes, k * F32x16::LANES);
        }
        Ok((gradient, cost))
    }

    /// Moves time on, and begins episodes where they ended or went astray.
    fn go_on(&mut self) -> Result<(), LearnError> {
        let blocks: Vec<&Block> = self.blocks.iter_mut().map(|block| &*own(block)).collect();
        let over = |w: usize| {
            let block = blocks[w / F32x16::LANES];
            (block.lives.outcome(w % F32x16::LANES), block.lost)
        };
        let anew = self.episodes.go_on(self.options.horizon, over)?;
        for w in (0..anew.len()).filter(|w| anew[*w]) {
            let block = own(&mut self.blocks[w / F32x16::LANES]);
            block.last_action.iter_mut().for_each(|cell| cell.set(w % F32x16::LANES, 0.0));
        }
        Ok(())
    }

    /// Teaches the value network what the flight cost, by the discounted sum of its costs and of the cost to go at its end (TD(λ)).
    fn teach(&mut self, observations: usize, done: f32) {
        let (worlds, horizon) = (self.options.worlds, self.options.horizon);
        let lost_cost = self.episodes.goal.lost_cost() as f32;
        let Some(taught) = &mut self.critic else { return };
        let how = taught.how;
        let blocks: Vec<&Block> = self.blocks.iter_mut().map(|block| &*own(block)).collect();
        let size = blocks[0].kept.len() / horizon;
        let mut targets = Vec::new();
        for (k, block) in blocks.iter().enumerate() {
            let lanes = (worlds - k * F32x16::LANES).min(F32x16::LANES);
            let before = targets.len();
            targets.resize(before + horizon, [F32x16::splat(0.0); 2]);
            if block.lost {
                continue;
            }
            let mut kept = vec![F32x16::splat(0.0); taught.used.kept()];
            let (mut next, mut sum) = (block.to_go, block.to_go);
            for t in (0..horizon).rev() {
                let observation = &block.kept[t * size..t * size + observations];
                kept[..observations].copy_from_slice(observation);
                let said = taught.used.estimate(&mut kept);
                let to = &mut targets[before + t];
                for lane in 0..lanes {
                    let alive = block.lives.alive(t + 1, lane);
                    let ended = block.lives.alive(t, lane) - alive;
                    let lost =
                        if block.lives.outcome(lane) == Outcome::Lost { ended * lost_cost } else { 0.0 };
                    let (lambda, discount) = (how.lambda as f32, how.discount as f32);
                    let later = lambda * sum.get(lane) + (1.0 - lambda) * next.get(lane);
                    sum.set(lane, block.costs[t].get(lane) + lost + alive * discount * later);
                    to[1].set(lane, block.lives.alive(t, lane));
                }
                to[0] = sum;
                next = said;
            }
        }
        let count: f64 = targets.iter().flat_map(|t| t[1].0).map(f64::from).sum();
        let each = || targets.iter().flat_map(|t| t[0].0.into_iter().zip(t[1].0)).filter(|(_, w)| *w > 0.0);
        if count == 0.0 {
            return;
        }
        let mean = each().map(|(v, _)| f64::from(v)).sum::<f64>() / count;
        let variance = each().map(|(v, _)| (f64::from(v) - mean).powi(2)).sum::<f64>() / count;
        taught.learns.note(mean, variance);
        let sample = |i: usize| {
            let at = i % horizon * size;
            let observation = &blocks[i / horizon].kept[at..at + observations];
            Sample { observation, target: targets[i][0], weight: targets[i][1] }
        };
        let mut order: Vec<usize> = (0..targets.len()).collect();
        let rate = annealed(how.rate, done);
        for epoch in 0..how.epochs {
            let number = taught.flights * how.epochs as u64 + epoch as u64;
            shuffle(&mut order, &mut stream(self.options.seed, 0, number, "learn.order"));
            for part in order.chunks(order.len().div_ceil(how.parts)) {
                taught.learns.teach(part, sample, (rate, 1.0));
            }
        }
        taught.flights += 1;
        taught.used.follow(&taught.learns, how.follow);
    }
}

/// Trains a policy that flies a vehicle towards a goal.
///
/// # Errors
/// [`LearnError::Option`] for options that make no sense, and what the vehicle and the simulation refuse.
pub fn train<G: Goal>(
    goal: &G,
    (vehicle, dynamics): (&Vehicle, &str),
    actions: &Actions,
    options: &Options,
) -> Result<Trained, LearnError> {
    check(options)?;
    let (worlds, seed) = (options.worlds, options.seed);
    let rates = (options.substeps, options.sim_hz);
    let episodes = Episodes::new(goal, (vehicle, dynamics), actions, (worlds, seed), rates)?;
    let widths: Vec<usize> = [goal.observations()]
        .into_iter()
        .chain(options.hidden.iter().copied())
        .chain([actions.len()])
        .collect();
    let mut network = Network::new(&widths, &mut stream(options.seed, 0, 0, "learn.weights"));
    let mut training = Training::new(episodes, options, actions, &network);
    let mut adam = Adam::new(network.weights().len());
    let mut curve = Curve::default();
    let each = options.worlds * options.horizon;
    let updates = options.commands.div_ceil(each);
    for update in 0..updates {
        let done = update as f32 / updates as f32;
        let (mut gradient, cost) = training.fly(&network)?;
        shorten(&mut gradient, options.longest);
        adam.step(network.weights_mut(), &gradient, annealed(options.rate, done));
        curve.commands.push((update + 1) * each);
        curve.cost.push(cost);
        training.teach(widths[0], done);
        training.go_on()?;
    }
    let (substeps, sim_hz) = (options.substeps, options.sim_hz);
    let policy = Policy { network, actions: actions.clone(), substeps, sim_hz };
    Ok(Trained { policy, curve, lost: training.episodes.lost })
}

pub(crate) fn check(options: &Options) -> Result<(), LearnError> {
    let hidden = options.hidden.iter().copied().min().unwrap_or(1);
    let (epochs, parts) = options.critic.map_or((1, 1), |critic| (critic.epochs, critic.parts));
    at_least_one(&[
        ("worlds", options.worlds),
        ("horizon", options.horizon),
        ("substeps", options.substeps),
        ("commands", options.commands),
        ("hidden", hidden),
        ("critic epochs", epochs),
        ("critic parts", parts),
    ])?;
    divides(options.substeps, options.sim_hz)?;
    above_zero(&[("rate", options.rate), ("longest", options.longest)])?;
    let Some(critic) = options.critic else { return Ok(()) };
    above_zero(&[("critic rate", critic.rate)])?;
    below_one("critic discount", critic.discount)?;
    up_to_one(&[("critic lambda", critic.lambda), ("critic follow", f64::from(critic.follow))])
}

#[cfg(test)]
mod tests;
