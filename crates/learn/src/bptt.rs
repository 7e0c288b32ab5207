//! Backpropagation through time: short flights of many worlds, and the exact gradient of what they cost by the weights of the network that commands them
//! (Mozer, "A focused backpropagation algorithm for temporal pattern recognition", 1989; through a simulator Suh et al., "Do differentiable simulators
//! give better policy gradients?", 2022).

use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::LearnError;
use crate::adam::Adam;
use crate::goal::{Actions, Goal, Seen};
use crate::network::Network;
use crate::policy::Policy;
use propwash_rollout::pilot::{Pilot, Place};
use propwash_rollout::random::{Key, Stream, purpose};
use propwash_rollout::tape::state_width;
use propwash_rollout::{Engine, Sim, SimOptions};
use propwash_trace::Real;
use propwash_trace::adjoint::{evaluate, pull_back};
use propwash_trace::formula::{Formula, Registers};
use propwash_trace::lanes::{Cell, F32x16};
use propwash_trace::trace::{Sym, trace};
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
    /// Seed of weights and starts.
    pub seed: u64,
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

/// Formulas of a goal in lanes.
struct Traced {
    /// From the state and the time to the observation.
    observe: Formula,
    /// From these and what a loss gains by the observation to what it gains by the state.
    observe_back: Formula,
    /// From state, time, action and action before to the cost, and to its gains by state, action and action before.
    cost: Formula,
}

impl Traced {
    fn new<G: Goal>(goal: &G, width: usize, actions: usize) -> Self {
        let observe = |x: &[Sym]| {
            let mut out = Vec::new();
            goal.observe(&Seen::of(x, x[width]), &mut out);
            out
        };
        let graph = trace(width + 1, observe);
        let inputs = width + 1;
        let observe_back = Formula::new(inputs + graph.outputs.len(), |x| {
            pull_back::<Sym>(&graph, &x[..inputs], &x[inputs..])[..width].to_vec()
        });
        let inputs = width + 1 + 2 * actions;
        let price = trace(inputs, |x| {
            let (action, before) = x[width + 1..].split_at(actions);
            vec![goal.cost(&Seen::of(x, x[width]), action, before)]
        });
        let cost = Formula::new(inputs, |x| {
            let gains = pull_back::<Sym>(&price, x, &[Sym::one()]);
            let value = evaluate::<Sym>(&price, x)[0];
            [&[value], &gains[..width], &gains[width + 1..]].concat()
        });
        Self { observe: Formula::new(width + 1, observe), observe_back, cost }
    }
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
    /// What the loss gains by each action but for the flight. (time, action)
    by_action: Vec<F32x16>,
    /// The action before the flight.
    last_action: Vec<F32x16>,
    gains: Vec<F32x16>,
    by_weights: Vec<F32x16>,
    /// Time of each world when the flight began, s.
    time_s: F32x16,
    cost_sum: f64,
    lost: bool,
}

/// Flies and undoes, and keeps what is needed in between.
struct Learner<'a> {
    network: &'a Network,
    actions: &'a Actions,
    traced: &'a Traced,
    blocks: &'a [Mutex<Block>],
    width: usize,
    step_s: f32,
    /// What each command of each world counts in the loss.
    share: f32,
}

impl Learner<'_> {
    fn block(&self, at: Place) -> MutexGuard<'_, Block> {
        self.blocks[at.first_world / F32x16::LANES].lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Time of the worlds of a block after `t` commands.
    fn time(&self, block: &Block, t: usize) -> F32x16 {
        let mut cell = block.time_s;
        (0..F32x16::LANES).for_each(|lane| cell.set(lane, cell.get(lane) + t as f32 * self.step_s));
        cell
    }
}

impl Pilot<f32> for Learner<'_> {
    fn command(&self, at: Place, state: &[F32x16], command: &mut [F32x16]) {
        let mut guard = self.block(at);
        let block = &mut *guard;
        let (width, size) = (self.width, self.network.kept());
        block.before[at.t * width..(at.t + 1) * width].copy_from_slice(state);
        let time = self.time(block, at.t);
        for (i, cell) in state.iter().chain([&time]).enumerate() {
            *block.observe.input(i) = *cell;
        }
        block.observe.run(&self.traced.observe);
        let kept = &mut block.kept[at.t * size..(at.t + 1) * size];
        for (k, cell) in kept[..self.network.widths()[0]].iter_mut().enumerate() {
            *cell = *block.observe.output(&self.traced.observe, k);
        }
        self.network.forward(kept);
        let action = &kept[size - self.actions.len()..];
        for (k, (cell, a)) in command.iter_mut().zip(action).enumerate() {
            let (middle, reach) = (self.actions.middle[k] as f32, self.actions.reach[k] as f32);
            cell.fill(0, |lane| middle + reach * a.get(lane));
        }
    }

    fn look(&self, at: Place, state: &[F32x16]) {
        let from = at.t * self.width;
        self.block(at).after[from..from + self.width].copy_from_slice(state);
    }

    fn seed(&self, at: Place, by_state: &mut [F32x16]) {
        let mut guard = self.block(at);
        let block = &mut *guard;
        let (width, size, n) = (self.width, self.network.kept(), self.actions.len());
        let time = self.time(block, at.t + 1);
        let action = |t: usize| &block.kept[(t + 1) * size - n..(t + 1) * size];
        let before = if at.t == 0 { &block.last_action[..] } else { action(at.t - 1) };
        let inputs = block.after[at.t * width..(at.t + 1) * width].iter().chain([&time]);
        for (i, cell) in inputs.chain(action(at.t)).chain(before).enumerate() {
            *block.cost.input(i) = *cell;
        }
        block.cost.run(&self.traced.cost);
        let cost = block.cost.output(&self.traced.cost, 0);
        block.cost_sum += (0..at.n_worlds).map(|lane| f64::from(cost.get(lane))).sum::<f64>();
        let share = |lane: usize| if lane < at.n_worlds { self.share } else { 0.0 };
        for (k, gain) in by_state.iter_mut().enumerate() {
            let own = block.cost.output(&self.traced.cost, 1 + k);
            (0..F32x16::LANES).for_each(|lane| gain.set(lane, gain.get(lane) + share(lane) * own.get(lane)));
        }
        for (t, first) in [(Some(at.t), 1 + width), (at.t.checked_sub(1), 1 + width + n)] {
            let Some(t) = t else { continue };
            for k in 0..n {
                let own = block.cost.output(&self.traced.cost, first + k);
                let gain = &mut block.by_action[t * n + k];
                (0..F32x16::LANES)
                    .for_each(|lane| gain.set(lane, gain.get(lane) + share(lane) * own.get(lane)));
            }
        }
    }

    fn pull_back(&self, at: Place, by_command: &[F32x16], by_state: &mut [F32x16]) {
        let mut guard = self.block(at);
        let block = &mut *guard;
        let (width, size, n) = (self.width, self.network.kept(), self.actions.len());
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
        let time = self.time(block, at.t);
        let inputs = block.before[at.t * width..(at.t + 1) * width].iter().chain([&time]);
        for (i, cell) in inputs.chain(&block.gains).enumerate() {
            *block.observe_back.input(i) = *cell;
        }
        block.observe_back.run(&self.traced.observe_back);
        for (k, gain) in by_state.iter_mut().enumerate() {
            let own = block.observe_back.output(&self.traced.observe_back, k);
            (0..F32x16::LANES).for_each(|lane| gain.set(lane, gain.get(lane) + own.get(lane)));
        }
    }

    fn lost(&self, at: Place) {
        self.block(at).lost = true;
    }
}

pub(crate) fn stream(seed: u64, world: usize, episode: u64, what: &str) -> Stream {
    Key { seed, world: world as u64, drone: 0, step: episode, purpose: purpose(what) }.stream()
}

/// A training as it goes.
struct Training<'a, G: Goal> {
    goal: &'a G,
    options: &'a Options,
    sim: Sim<f32>,
    actions: Actions,
    traced: Traced,
    blocks: Vec<Mutex<Block>>,
    /// Time of each world, time at which its episode ends, s, and episodes begun.
    time_s: Vec<f64>,
    ends_s: Vec<f64>,
    episodes: Vec<u64>,
    width: usize,
    lost: usize,
}

impl<'a, G: Goal> Training<'a, G> {
    fn new(goal: &'a G, options: &'a Options, sim: Sim<f32>, actions: &Actions, network: &Network) -> Self {
        let (width, n, zero) = (state_width(sim.data.n_rotors), actions.len(), F32x16::splat(0.0));
        let traced = Traced::new(goal, width, n);
        let block = || {
            Mutex::new(Block {
                observe: Registers::new(&traced.observe),
                observe_back: Registers::new(&traced.observe_back),
                cost: Registers::new(&traced.cost),
                kept: vec![zero; options.horizon * network.kept()],
                before: vec![zero; options.horizon * width],
                after: vec![zero; options.horizon * width],
                by_action: vec![zero; options.horizon * n],
                last_action: vec![zero; n],
                gains: Vec::new(),
                by_weights: vec![zero; network.weights().len()],
                time_s: zero,
                cost_sum: 0.0,
                lost: false,
            })
        };
        let blocks = (0..options.worlds.div_ceil(F32x16::LANES)).map(|_| block()).collect();
        Self {
            goal,
            options,
            sim,
            actions: actions.clone(),
            traced,
            blocks,
            time_s: vec![0.0; options.worlds],
            ends_s: vec![0.0; options.worlds],
            episodes: vec![0; options.worlds],
            width,
            lost: 0,
        }
    }

    fn step_s(&self) -> f64 {
        self.options.substeps as f64 / f64::from(self.options.sim_hz)
    }

    /// Begins episodes in these worlds.
    fn begin(&mut self, worlds: &[bool]) -> Result<(), LearnError> {
        for w in (0..worlds.len()).filter(|w| worlds[*w]) {
            let mut random = stream(self.options.seed, w, self.episodes[w], "learn.start");
            let (state, time_s) = self.goal.start(&mut random);
            self.sim.set_initial(w, 0, state)?;
            self.episodes[w] += 1;
            (self.time_s[w], self.ends_s[w]) = (time_s, time_s + self.goal.episode_s());
            let mut block = self.blocks[w / F32x16::LANES].lock().unwrap_or_else(PoisonError::into_inner);
            block.last_action.iter_mut().for_each(|cell| cell.set(w % F32x16::LANES, 0.0));
        }
        Ok(self.sim.reset(Some(worlds))?)
    }

    /// Flies all worlds once; the gradient by the weights, and the mean cost.
    fn fly(&mut self, network: &Network) -> Result<(Vec<f32>, f64), LearnError> {
        let (worlds, horizon) = (self.options.worlds, self.options.horizon);
        let zero = F32x16::splat(0.0);
        for (k, block) in self.blocks.iter_mut().enumerate() {
            let block = block.get_mut().unwrap_or_else(PoisonError::into_inner);
            block.by_action.fill(zero);
            block.by_weights.fill(zero);
            (block.cost_sum, block.lost) = (0.0, false);
            let first = k * F32x16::LANES;
            block.time_s.fill(0, |lane| self.time_s[(first + lane).min(worlds - 1)] as f32);
        }
        let share = 1.0 / (worlds * horizon) as f32;
        let learner = Learner {
            network,
            actions: &self.actions,
            traced: &self.traced,
            blocks: &self.blocks,
            width: self.width,
            step_s: self.step_s() as f32,
            share,
        };
        self.sim.fly_piloted(&learner, horizon, self.options.substeps)?;
        let (mut gradient, mut cost) = (vec![0.0; network.weights().len()], 0.0);
        let (size, n) = (network.kept(), self.actions.len());
        for block in &mut self.blocks {
            let block = block.get_mut().unwrap_or_else(PoisonError::into_inner);
            let own: Vec<f32> = Network::gathered(&block.by_weights).collect();
            block.lost |= own.iter().any(|v| !v.is_finite());
            if block.lost {
                continue;
            }
            gradient.iter_mut().zip(own).for_each(|(sum, v)| *sum += v);
            cost += block.cost_sum * f64::from(share);
            let last = &block.kept[horizon * size - n..];
            block.last_action.copy_from_slice(last);
        }
        Ok((gradient, cost))
    }

    /// Moves time on, and begins episodes where they ended or went astray.
    fn go_on(&mut self) -> Result<(), LearnError> {
        let worlds = self.options.worlds;
        let flown_s = self.options.horizon as f64 * self.step_s();
        let mut anew = vec![false; worlds];
        let mut numbers = vec![0.0f32; self.width];
        for (w, anew) in anew.iter_mut().enumerate() {
            self.time_s[w] += flown_s;
            let block = self.blocks[w / F32x16::LANES].get_mut().unwrap_or_else(PoisonError::into_inner);
            self.sim.data.copy_state(w, &mut numbers);
            let state: Vec<f64> = numbers.iter().map(|v| f64::from(*v)).collect();
            let off = self.goal.off_m(&Seen::of(&state, self.time_s[w]));
            let astray = block.lost || off.is_nan() || off > self.goal.far_off_m();
            self.lost += usize::from(astray);
            *anew = astray || self.time_s[w] >= self.ends_s[w];
        }
        if anew.contains(&true) { self.begin(&anew) } else { Ok(()) }
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
    let sim_options = SimOptions {
        n_worlds: options.worlds,
        seed: options.seed,
        sim_hz: options.sim_hz,
        control: actions.mode,
        engine: Engine::Lanes,
        ..SimOptions::default()
    };
    let sim = Sim::<f32>::storing(sim_options, vec![(vehicle.drone(dynamics)?, vehicle.rates)])?;
    let widths: Vec<usize> = [goal.observations()]
        .into_iter()
        .chain(options.hidden.iter().copied())
        .chain([actions.len()])
        .collect();
    let mut network = Network::new(&widths, &mut stream(options.seed, 0, 0, "learn.weights"));
    let mut training = Training::new(goal, options, sim, actions, &network);
    training.begin(&vec![true; options.worlds])?;
    // First episodes end at different times, so that later ones do not all begin together.
    for (w, ends) in training.ends_s.iter_mut().enumerate() {
        *ends -= goal.episode_s() * w as f64 / options.worlds as f64;
    }
    let mut adam = Adam::new(network.weights().len());
    let mut curve = Curve::default();
    let each = options.worlds * options.horizon;
    let updates = options.commands.div_ceil(each);
    for update in 0..updates {
        let (mut gradient, cost) = training.fly(&network)?;
        shorten(&mut gradient, options.longest);
        adam.step(network.weights_mut(), &gradient, annealed(options.rate, update, updates));
        curve.commands.push((update + 1) * each);
        curve.cost.push(cost);
        training.go_on()?;
    }
    let (substeps, sim_hz) = (options.substeps, options.sim_hz);
    let policy = Policy { network, actions: actions.clone(), substeps, sim_hz };
    Ok(Trained { policy, curve, lost: training.lost })
}

/// Shortens a gradient that is longer than `longest` to that.
pub(crate) fn shorten(gradient: &mut [f32], longest: f32) {
    let length = gradient.iter().map(|g| g * g).sum::<f32>().sqrt();
    if length > longest {
        gradient.iter_mut().for_each(|g| *g *= longest / length);
    }
}

/// The size of steps along half a cosine, from `rate` to nothing.
pub(crate) fn annealed(rate: f32, update: usize, updates: usize) -> f32 {
    let done = update as f32 / updates as f32;
    rate * 0.5 * (1.0 + (done * std::f32::consts::PI).cos())
}

pub(crate) fn check(options: &Options) -> Result<(), LearnError> {
    let least = [
        ("worlds", options.worlds),
        ("horizon", options.horizon),
        ("substeps", options.substeps),
        ("commands", options.commands),
        ("hidden", options.hidden.iter().copied().min().unwrap_or(1)),
    ];
    if let Some((name, _)) = least.into_iter().find(|(_, v)| *v == 0) {
        return Err(LearnError::Option { name, expected: "at least 1".into(), got: "0".into() });
    }
    if !(options.sim_hz as usize).is_multiple_of(options.substeps) {
        return Err(LearnError::Option {
            name: "substeps",
            expected: format!(
                "a divisor of {} steps a second, so that commands are a whole number a second",
                options.sim_hz
            ),
            got: options.substeps.to_string(),
        });
    }
    for (name, v) in [("rate", options.rate), ("longest", options.longest)] {
        if !(v.is_finite() && v > 0.0) {
            let expected = "a finite number above 0".into();
            return Err(LearnError::Option { name, expected, got: v.to_string() });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::goals::Track;

    /// Mean cost of a flight, in f64 by the simulation itself, and by formulas over f64.
    fn cost_of<G: Goal>(
        goal: &G,
        sim: &mut Sim<f64>,
        policy: &Policy,
        options: &Options,
        time_s: &[f64],
    ) -> f64 {
        let (worlds, n) = (options.worlds, policy.actions.len());
        let step_s = options.substeps as f64 / f64::from(options.sim_hz);
        let mut numbers = vec![0.0; state_width(sim.data.n_rotors)];
        let mut before = vec![0.0; worlds * n];
        let mut sum = 0.0;
        for t in 0..options.horizon {
            let mut commands = Vec::new();
            let mut actions = Vec::new();
            for (w, begun) in time_s.iter().enumerate() {
                sim.data.copy_state(w, &mut numbers);
                let mut observation = Vec::new();
                goal.observe(&Seen::of(&numbers, begun + t as f64 * step_s), &mut observation);
                let observation: Vec<f32> = observation.into_iter().map(|v| v as f32).collect();
                let action = policy.network.act(&observation);
                commands.extend(policy.actions.command(&action));
                actions.extend(action.into_iter().map(f64::from));
            }
            sim.set_command(&commands).unwrap();
            sim.step(options.substeps).unwrap();
            for (w, begun) in time_s.iter().enumerate() {
                sim.data.copy_state(w, &mut numbers);
                let seen = Seen::of(&numbers, begun + (t + 1) as f64 * step_s);
                let own = w * n..(w + 1) * n;
                sum += goal.cost(&seen, &actions[own.clone()], &before[own]);
            }
            before = actions;
        }
        sum / (worlds * options.horizon) as f64
    }

    /// 19 worlds, so that lanes stay empty; by attitudes and by rotor speeds; in one group of steps and in several.
    #[test]
    fn the_gradient_by_weights_is_that_of_differences() {
        let vehicle = Vehicle::builtin("cf21B_500").unwrap();
        let drone = vehicle.drone("first_principles").unwrap();
        let goal = Track::default();
        for (actions, horizon) in
            [(Actions::attitude(&drone), 8), (Actions::rotors(&drone), 5), (Actions::attitude(&drone), 60)]
        {
            let options = Options { worlds: 19, horizon, hidden: vec![9, 7], ..Options::default() };
            let sim_options = SimOptions {
                n_worlds: 19,
                control: actions.mode,
                engine: Engine::Lanes,
                ..SimOptions::default()
            };
            let drones = vec![(drone.clone(), vehicle.rates)];
            let sim = Sim::<f32>::storing(sim_options.clone(), drones.clone()).unwrap();
            let widths = [goal.observations(), 9, 7, actions.len()];
            let network = Network::new(&widths, &mut stream(3, 0, 0, "learn.weights"));
            let mut training = Training::new(&goal, &options, sim, &actions, &network);
            training.begin(&[true; 19]).unwrap();
            let (time_s, start) = (training.time_s.clone(), training.sim.save());
            let (gradient, cost) = training.fly(&network).unwrap();
            let mut same = Sim::<f64>::storing(sim_options, drones).unwrap();
            let mut at = |weights: &[f32]| {
                for w in 0..19 {
                    same.set_initial(w, 0, start.data().state(w, 0)).unwrap();
                }
                same.reset(None).unwrap();
                let mut network = network.clone();
                network.weights_mut().copy_from_slice(weights);
                let (substeps, sim_hz) = (options.substeps, options.sim_hz);
                let policy = Policy { network, actions: actions.clone(), substeps, sim_hz };
                cost_of(&goal, &mut same, &policy, &options, &time_s)
            };
            let wanted = at(network.weights());
            assert!((cost - wanted).abs() < 1e-4 * wanted, "{horizon}: {cost} {wanted}");
            let size = gradient.iter().fold(0.0f32, |most, g| most.max(g.abs()));
            for k in (0..gradient.len()).step_by(23) {
                let step = 2e-3;
                let moved = |by: f32| {
                    let mut weights = network.weights().to_vec();
                    weights[k] += by;
                    weights
                };
                let slope = (at(&moved(step)) - at(&moved(-step))) / f64::from(2.0 * step);
                let off = (slope - f64::from(gradient[k])).abs();
                assert!(off < 0.01 * f64::from(size), "{horizon} {k}: {slope} {} of {size}", gradient[k]);
            }
        }
    }
}
