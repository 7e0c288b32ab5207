//! Policies that see, trained by backpropagation through time in which what is seen has no slope.
//!
//! Several drones can fly together in one world, under one policy, and each see the nearest others ([`Other`]): then lanes are drones, and what one sees of others is given
//! from outside, as things are. A slope goes through its own motion towards and away from them alone, not through what they make of it.
//!
//! A policy is given what a drone sees, most often a small depth image, as numbers from outside. What it costs to come near things goes through their exact distance
//! and its slope, not through pixels, whose slopes are zero between silhouettes and unknown at them (Zhang et al., "Learning vision-based agile flight via differentiable physics",
//! Nature Machine Intelligence, 2025, train so with points near to the drone).

use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::LearnError;
use crate::adam::Adam;
use crate::batch::{annealed, shorten};
use crate::bptt::{Curve, Options, Trained, check};
use crate::episodes::stream;
use crate::goal::{Actions, Seen};
use crate::network::Network;
use crate::policy::Policy;
use propwash_physics::rigid_body::State;
use propwash_rollout::pilot::{Commander, Pilot, Place};
use propwash_rollout::random::Stream;
use propwash_rollout::tape::state_width;
use propwash_rollout::{Engine, Sim, SimOptions};
use propwash_trace::Real;
use propwash_trace::adjoint::{evaluate, pull_back};
use propwash_trace::formula::{Formula, Registers};
use propwash_trace::lanes::{Cell, F32x16};
use propwash_trace::trace::{Sym, trace};
use propwash_vehicle::Vehicle;

mod company;

pub use company::Other;

/// How near things are.
#[derive(Clone, Copy, Debug)]
pub struct Near<S> {
    /// Distance to the nearest thing, m; negative inside.
    pub distance_m: S,
    /// Its slopes by the position: where it is away from things. No slope goes through them.
    pub away: [S; 3],
}

/// What there is around a drone.
#[derive(Clone, Copy, Debug)]
pub struct Around<'a, S> {
    /// How near things are.
    pub near: Near<S>,
    /// What is to be added to the straight direction to the target, of length 1, for that around things ([`Surroundings::detour`]). No slope goes through it.
    pub detour: [S; 3],
    /// The nearest drones of the same world, nearest first ([`SightedGoal::others`]).
    pub others: &'a [Other<S>],
}

/// What a policy that sees shall do.
pub trait SightedGoal: Sync {
    /// Numbers of an observation beside those that are seen.
    fn observations(&self) -> usize;

    /// Of how many other drones of the same world a drone knows, the nearest ones.
    fn others(&self) -> usize {
        0
    }

    /// Writes these, each of about size 1; `target_m` is where the episode leads to, world.
    fn observe<S: Real>(&self, seen: &Seen<S>, others: &[Other<S>], target_m: [S; 3], out: &mut Vec<S>);

    /// What a step costs, seen at its end: the action of the step and the one before, each number of −1 to 1.
    fn cost<S: Real>(&self, seen: &Seen<S>, around: &Around<S>, target_m: [S; 3], actions: [&[S]; 2]) -> S;

    /// Length of an episode, s.
    fn episode_s(&self) -> f64;

    /// An episode ends within this distance of its target, m.
    fn arrive_m(&self) -> f64;

    /// A drone nearer to things than this has touched them, m: the episode ends. Two drones touch within twice of it.
    fn touch_m(&self) -> f64;
}

/// Where policies that see fly. Worlds are seen by several threads at once.
pub trait Surroundings: Sync {
    /// Numbers of what is seen, each of about size 1.
    fn sights(&self) -> usize;

    /// Drones that fly together in a world: 1, 2, 4, 8 or 16, whose episodes begin and end together. With more than one, `world` counts drones in all that
    /// follows; those of a world follow each other.
    fn drones(&self) -> usize {
        1
    }

    /// Begins an episode in a world: where the drone starts (its rotors are set to hover), and where it should go, m. Drones of a world are asked for in their order.
    ///
    /// # Errors
    /// What is wrong, in words.
    fn begin(
        &mut self,
        world: usize,
        episode: u64,
        random: &mut Stream,
    ) -> Result<(State<f64>, [f64; 3]), String>;

    /// What a drone sees from a position (m) in an attitude (x y z w).
    fn see(&self, world: usize, pos_m: [f32; 3], quat_xyzw: [f32; 4], out: &mut [f32]);

    /// What went wrong since the last time that this was asked, in words.
    fn fault(&self) -> Option<String>;

    /// Distance from a position to the nearest thing, m, and its slopes.
    fn distance(&self, world: usize, pos_m: [f32; 3]) -> (f32, [f32; 3]);

    /// What is to be added to the straight direction from a position to the target, of length 1, for that of the way around things. Only costs know it: a policy
    /// learns by it where ways go that it must find by what it sees.
    fn detour(&self, _world: usize, _pos_m: [f32; 3]) -> [f32; 3] {
        [0.0; 3]
    }
}

/// Formulas of a goal in lanes.
struct Traced {
    /// From state, time, target and other drones to the observation.
    observe: Formula,
    /// From these and what a loss gains by the observation to what it gains by the state.
    observe_back: Formula,
    /// From state, time, target, other drones, nearness, detour, action and action before to the cost, and to its gains by state, distance, action and action before.
    cost: Formula,
}

impl Traced {
    fn new<G: SightedGoal>(goal: &G, width: usize, actions: usize) -> Self {
        let known = Other::<Sym>::WIDTH * goal.others();
        let inputs = width + 4 + known;
        let observe = |x: &[Sym]| {
            let mut out = Vec::new();
            let target = [x[width + 1], x[width + 2], x[width + 3]];
            goal.observe(&Seen::of(x, x[width], &[]), &Other::all(&x[width + 4..inputs]), target, &mut out);
            out
        };
        let graph = trace(inputs, observe);
        let observe_back = Formula::new(inputs + graph.outputs.len(), |x| {
            pull_back::<Sym>(&graph, &x[..inputs], &x[inputs..])[..width].to_vec()
        });
        let first = inputs + 7;
        let price = trace(first + 2 * actions, |x| {
            let (action, before) = x[first..].split_at(actions);
            let target = [x[width + 1], x[width + 2], x[width + 3]];
            let [distance_m, away @ ..] = [0, 1, 2, 3].map(|k| x[inputs + k]);
            let detour = [4, 5, 6].map(|k| x[inputs + k]);
            let others = Other::all(&x[width + 4..inputs]);
            let around = Around { near: Near { distance_m, away }, detour, others: &others };
            vec![goal.cost(&Seen::of(x, x[width], &[]), &around, target, [action, before])]
        });
        let cost = Formula::new(first + 2 * actions, |x| {
            let gains = pull_back::<Sym>(&price, x, &[Sym::one()]);
            let value = evaluate::<Sym>(&price, x)[0];
            [&[value], &gains[..width], &[gains[inputs]], &gains[first..]].concat()
        });
        Self { observe: Formula::new(inputs, observe), observe_back, cost }
    }
}

/// What is kept of one block of worlds during a flight.
struct Block {
    observe: Registers<F32x16>,
    observe_back: Registers<F32x16>,
    cost: Registers<F32x16>,
    /// What the network keeps, of each command.
    kept: Vec<F32x16>,
    /// What the loss gains by the numbers before each tanh, of each command.
    by_sums: Vec<F32x16>,
    /// Commands that were given so far; earlier ones are asked for again, and looked up.
    known: usize,
    /// States for which and after which commands were given. (time, number of a state)
    before: Vec<F32x16>,
    after: Vec<F32x16>,
    /// What the loss gains by each action but for the flight. (time, action)
    by_action: Vec<F32x16>,
    /// The action before the flight.
    last_action: Vec<F32x16>,
    gains: Vec<F32x16>,
    /// What one drone sees.
    sight: Vec<f32>,
    /// The other drones of each, as formulas take them.
    others: Vec<F32x16>,
    target_m: [F32x16; 3],
    /// Time of each world when the flight began, s.
    time_s: F32x16,
    cost_sum: f64,
    /// Worlds that touched something, and that arrived.
    touched: [bool; F32x16::LANES],
    arrived: [bool; F32x16::LANES],
    lost: bool,
}

impl Block {
    fn new(
        traced: &Traced,
        network: &Network,
        (horizon, width): (usize, usize),
        (sights, others): (usize, usize),
    ) -> Self {
        let zero = F32x16::splat(0.0);
        let n = network.widths().last().copied().unwrap_or(0);
        Self {
            observe: Registers::new(&traced.observe),
            observe_back: Registers::new(&traced.observe_back),
            cost: Registers::new(&traced.cost),
            kept: vec![zero; horizon * network.kept()],
            by_sums: vec![zero; horizon * network.sums()],
            known: 0,
            before: vec![zero; horizon * width],
            after: vec![zero; horizon * width],
            by_action: vec![zero; horizon * n],
            last_action: vec![zero; n],
            gains: Vec::new(),
            sight: vec![0.0; sights],
            others: vec![zero; Other::<f32>::WIDTH * others],
            target_m: [zero; 3],
            time_s: zero,
            cost_sum: 0.0,
            touched: [false; F32x16::LANES],
            arrived: [false; F32x16::LANES],
            lost: false,
        }
    }
}

/// Adds `share(lane) × own` to a cell.
fn add(to: &mut F32x16, own: &F32x16, share: impl Fn(usize) -> f32) {
    (0..F32x16::LANES).for_each(|lane| to.set(lane, to.get(lane) + share(lane) * own.get(lane)));
}

/// Flies and undoes, and keeps what is needed in between.
struct Learner<'a, W> {
    around: &'a W,
    network: &'a Network,
    actions: &'a Actions,
    traced: &'a Traced,
    blocks: &'a [Mutex<Block>],
    width: usize,
    /// Numbers of the observation beside those that are seen.
    observed: usize,
    step_s: f32,
    /// Drones of a world.
    drones: usize,
    /// What each command of each world counts in the loss.
    share: f32,
    touch_m: f32,
    arrive_m: f32,
}

impl<W: Surroundings> Learner<'_, W> {
    fn block(&self, at: Place) -> MutexGuard<'_, Block> {
        self.blocks[at.first_world / F32x16::LANES].lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Time of the worlds of a block after `t` commands, and their targets: what formulas take after the state.
    fn given(&self, block: &Block, t: usize) -> [F32x16; 4] {
        let mut time = block.time_s;
        (0..F32x16::LANES).for_each(|lane| time.set(lane, time.get(lane) + t as f32 * self.step_s));
        [time, block.target_m[0], block.target_m[1], block.target_m[2]]
    }

    /// What the drones see, behind the other observations of the network's input.
    fn see(&self, at: Place, state: &[F32x16], block: &mut Block) {
        let from = at.t * self.network.kept() + self.observed;
        for lane in 0..F32x16::LANES {
            if lane < at.n_worlds {
                let pos = [0, 1, 2].map(|k| state[k].get(lane));
                let quat = [3, 4, 5, 6].map(|k| state[k].get(lane));
                if pos.iter().chain(&quat).all(|v| v.is_finite()) {
                    self.around.see(at.first_world + lane, pos, quat, &mut block.sight);
                } else {
                    // Nothing will be made of this flight.
                    block.sight.fill(0.0);
                }
            }
            // Lanes behind the last repeat it.
            for (cell, v) in block.kept[from..].iter_mut().zip(&block.sight) {
                cell.set(lane, *v);
            }
        }
    }

    /// Distances of the drones after a command and their detours, and what became of them.
    fn near(&self, at: Place, block: &mut Block) -> [F32x16; 7] {
        let mut near = [F32x16::splat(0.0); 7];
        let after = &block.after[at.t * self.width..];
        for lane in 0..at.n_worlds {
            let pos = [0, 1, 2].map(|k| after[k].get(lane));
            let (distance, away) = self.around.distance(at.first_world + lane, pos);
            near[0].set(lane, distance);
            let detour = self.around.detour(at.first_world + lane, pos);
            (0..3).for_each(|k| near[1 + k].set(lane, away[k]));
            (0..3).for_each(|k| near[4 + k].set(lane, detour[k]));
            let off: f32 = (0..3).map(|k| (pos[k] - block.target_m[k].get(lane)).powi(2)).sum();
            block.touched[lane] |= distance < self.touch_m;
            block.arrived[lane] |= off.sqrt() < self.arrive_m;
        }
        if self.drones > 1 {
            let before = &block.before[at.t * self.width..];
            let gap_m = 2.0 * self.touch_m;
            company::meetings((before, after), (self.drones, at.n_worlds), gap_m, &mut block.touched);
        }
        near
    }
}

impl<W: Surroundings> Commander<f32> for Learner<'_, W> {
    fn command(&self, at: Place, state: &[F32x16], command: &mut [F32x16]) {
        let mut guard = self.block(at);
        let block = &mut *guard;
        let (width, size) = (self.width, self.network.kept());
        if at.t >= block.known {
            block.known = at.t + 1;
            block.before[at.t * width..(at.t + 1) * width].copy_from_slice(state);
            let given = self.given(block, at.t);
            company::nearest(state, (self.drones, at.n_worlds), &mut block.others);
            for (i, cell) in state.iter().chain(&given).chain(&block.others).enumerate() {
                *block.observe.input(i) = *cell;
            }
            block.observe.run(&self.traced.observe);
            for k in 0..self.observed {
                block.kept[at.t * size + k] = *block.observe.output(&self.traced.observe, k);
            }
            self.see(at, state, block);
            self.network.forward(&mut block.kept[at.t * size..(at.t + 1) * size]);
        }
        let action = &block.kept[(at.t + 1) * size - self.actions.len()..(at.t + 1) * size];
        for (k, (cell, a)) in command.iter_mut().zip(action).enumerate() {
            let (middle, reach) = (self.actions.middle[k] as f32, self.actions.reach[k] as f32);
            cell.fill(0, |lane| middle + reach * a.get(lane));
        }
    }

    fn look(&self, at: Place, state: &[F32x16]) {
        let from = at.t * self.width;
        self.block(at).after[from..from + self.width].copy_from_slice(state);
    }

    fn lost(&self, at: Place) {
        self.block(at).lost = true;
    }
}

impl<W: Surroundings> Pilot<f32> for Learner<'_, W> {
    fn seed(&self, at: Place, by_state: &mut [F32x16]) {
        let mut guard = self.block(at);
        let block = &mut *guard;
        let (width, size, n) = (self.width, self.network.kept(), self.actions.len());
        let (given, near) = (self.given(block, at.t + 1), self.near(at, block));
        let action = |t: usize| &block.kept[(t + 1) * size - n..(t + 1) * size];
        let before = if at.t == 0 { &block.last_action[..] } else { action(at.t - 1) };
        let after = &block.after[at.t * width..(at.t + 1) * width];
        company::nearest(after, (self.drones, at.n_worlds), &mut block.others);
        let inputs = after.iter().chain(&given).chain(&block.others).chain(&near);
        for (i, cell) in inputs.chain(action(at.t)).chain(before).enumerate() {
            *block.cost.input(i) = *cell;
        }
        block.cost.run(&self.traced.cost);
        let out = |k: usize| block.cost.output(&self.traced.cost, k);
        block.cost_sum += (0..at.n_worlds).map(|lane| f64::from(out(0).get(lane))).sum::<f64>();
        let share = |lane: usize| if lane < at.n_worlds { self.share } else { 0.0 };
        for (k, gain) in by_state.iter_mut().enumerate() {
            add(gain, out(1 + k), share);
        }
        // Through the distance to the position.
        for k in 0..3 {
            add(&mut by_state[k], out(1 + width), |lane| share(lane) * near[1 + k].get(lane));
        }
        for (t, first) in [(Some(at.t), 2 + width), (at.t.checked_sub(1), 2 + width + n)] {
            let Some(t) = t else { continue };
            for k in 0..n {
                let own = *block.cost.output(&self.traced.cost, first + k);
                add(&mut block.by_action[t * n + k], &own, share);
            }
        }
    }

    fn pull_back(&self, at: Place, by_command: &[F32x16], by_state: &mut [F32x16]) {
        let mut guard = self.block(at);
        let block = &mut *guard;
        let (width, size, n) = (self.width, self.network.kept(), self.actions.len());
        block.gains.clear();
        for k in 0..n {
            let mut cell = block.by_action[at.t * n + k];
            let reach = self.actions.reach[k] as f32;
            add(&mut cell, &by_command[k], |_| reach);
            block.gains.push(cell);
        }
        let sums = self.network.sums();
        let kept = &block.kept[at.t * size..(at.t + 1) * size];
        let by_sums = &mut block.by_sums[at.t * sums..(at.t + 1) * sums];
        self.network.backward_inputs(kept, &mut block.gains, by_sums, self.observed);
        let given = self.given(block, at.t);
        let before = &block.before[at.t * width..(at.t + 1) * width];
        company::nearest(before, (self.drones, at.n_worlds), &mut block.others);
        let inputs = before.iter().chain(&given).chain(&block.others);
        for (i, cell) in inputs.chain(&block.gains).enumerate() {
            *block.observe_back.input(i) = *cell;
        }
        block.observe_back.run(&self.traced.observe_back);
        for (k, gain) in by_state.iter_mut().enumerate() {
            add(gain, block.observe_back.output(&self.traced.observe_back, k), |_| 1.0);
        }
    }
}

/// A training as it goes.
struct Training<'a, G, W> {
    goal: &'a G,
    around: &'a mut W,
    options: &'a Options,
    sim: Sim<f32>,
    actions: Actions,
    traced: Traced,
    blocks: Vec<Mutex<Block>>,
    /// Time of each world since its episode began, s, and episodes begun.
    time_s: Vec<f64>,
    episodes: Vec<u64>,
    width: usize,
    lost: usize,
}

impl<G: SightedGoal, W: Surroundings> Training<'_, G, W> {
    fn step_s(&self) -> f64 {
        self.options.substeps as f64 / f64::from(self.options.sim_hz)
    }

    /// Begins episodes in these worlds.
    fn begin(&mut self, worlds: &[bool]) -> Result<(), LearnError> {
        for w in (0..worlds.len()).filter(|w| worlds[*w]) {
            let mut random = stream(self.options.seed, w, self.episodes[w], "learn.start");
            let begun = self.around.begin(w, self.episodes[w], &mut random);
            let (state, target_m) =
                begun.map_err(|what| LearnError::Surroundings { what: format!("world {w}: {what}") })?;
            self.sim.set_initial(w, 0, state)?;
            self.episodes[w] += 1;
            self.time_s[w] = 0.0;
            let lane = w % F32x16::LANES;
            let block = self.blocks[w / F32x16::LANES].get_mut().unwrap_or_else(PoisonError::into_inner);
            block.last_action.iter_mut().for_each(|cell| cell.set(lane, 0.0));
            (0..3).for_each(|k| block.target_m[k].set(lane, target_m[k] as f32));
        }
        Ok(self.sim.reset(Some(worlds))?)
    }

    /// Flies all worlds once; the gradient by the weights, and the mean cost.
    fn fly(&mut self, network: &Network) -> Result<(Vec<f32>, f64), LearnError> {
        let (worlds, horizon) = (self.options.worlds, self.options.horizon);
        for (k, block) in self.blocks.iter_mut().enumerate() {
            let block = block.get_mut().unwrap_or_else(PoisonError::into_inner);
            block.by_action.fill(F32x16::splat(0.0));
            (block.cost_sum, block.lost, block.known) = (0.0, false, 0);
            (block.touched, block.arrived) = ([false; F32x16::LANES], [false; F32x16::LANES]);
            let first = k * F32x16::LANES;
            block.time_s.fill(0, |lane| self.time_s[(first + lane).min(worlds - 1)] as f32);
        }
        let share = 1.0 / (worlds * horizon) as f32;
        let learner = Learner {
            around: &*self.around,
            network,
            actions: &self.actions,
            traced: &self.traced,
            blocks: &self.blocks,
            width: self.width,
            observed: self.goal.observations(),
            drones: self.around.drones(),
            step_s: self.step_s() as f32,
            share,
            touch_m: self.goal.touch_m() as f32,
            arrive_m: self.goal.arrive_m() as f32,
        };
        self.sim.fly_piloted(&learner, horizon, self.options.substeps)?;
        if let Some(what) = self.around.fault() {
            return Err(LearnError::Surroundings { what });
        }
        let (mut gradient, mut cost) = (vec![0.0; network.weights().len()], 0.0);
        let (size, n) = (network.kept(), self.actions.len());
        for block in &mut self.blocks {
            let block = block.get_mut().unwrap_or_else(PoisonError::into_inner);
            if block.lost {
                continue;
            }
            let mut own = vec![0.0; gradient.len()];
            network.weight_gains(&block.kept, &block.by_sums, horizon, &mut own);
            block.lost = own.iter().any(|v| !v.is_finite());
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

    /// Moves time on, and begins episodes where they ended, by touching something or otherwise.
    fn go_on(&mut self) -> Result<(), LearnError> {
        let (drones, worlds) = (self.around.drones(), self.options.worlds);
        let flown_s = self.options.horizon as f64 * self.step_s();
        let mut anew = vec![false; worlds];
        for (k, anew) in anew.chunks_mut(drones).enumerate() {
            let first = k * drones;
            let block = self.blocks[first / F32x16::LANES].get_mut().unwrap_or_else(PoisonError::into_inner);
            let lanes = first % F32x16::LANES..first % F32x16::LANES + drones;
            let touched = block.touched[lanes.clone()].iter().filter(|t| **t).count();
            let lost = if block.lost { drones } else { touched };
            self.lost += lost;
            self.time_s[first..first + drones].iter_mut().for_each(|time| *time += flown_s);
            // All that fly together are there: each was, in this flight.
            let arrived = block.arrived[lanes].iter().all(|a| *a);
            anew.fill(lost > 0 || arrived || self.time_s[first] >= self.goal.episode_s());
        }
        if anew.contains(&true) { self.begin(&anew) } else { Ok(()) }
    }
}

/// Trains a policy that sees, to fly a vehicle towards a goal in its surroundings.
///
/// # Errors
/// [`LearnError::Option`] for options that make no sense, [`LearnError::Surroundings`] for an episode that cannot begin, and what the vehicle and the simulation
/// refuse.
pub fn train_sighted<G: SightedGoal, W: Surroundings>(
    goal: &G,
    around: &mut W,
    (vehicle, dynamics): (&Vehicle, &str),
    actions: &Actions,
    options: &Options,
) -> Result<Trained, LearnError> {
    check(options)?;
    company::check(goal.others(), around.drones(), options.worlds)?;
    let sim_options = SimOptions {
        n_worlds: options.worlds,
        seed: options.seed,
        sim_hz: options.sim_hz,
        control: actions.mode,
        engine: Engine::Lanes,
        ..SimOptions::default()
    };
    let sim = Sim::<f32>::storing(sim_options, vec![(vehicle.drone(dynamics)?, vehicle.rates)])?;
    let widths: Vec<usize> = [goal.observations() + around.sights()]
        .into_iter()
        .chain(options.hidden.iter().copied())
        .chain([actions.len()])
        .collect();
    let mut network = Network::new(&widths, &mut stream(options.seed, 0, 0, "learn.weights"));
    let width = state_width(sim.data.n_rotors);
    let traced = Traced::new(goal, width, actions.len());
    let (long, seen) = ((options.horizon, width), (around.sights(), goal.others()));
    let block = || Mutex::new(Block::new(&traced, &network, long, seen));
    let blocks = (0..options.worlds.div_ceil(F32x16::LANES)).map(|_| block()).collect();
    let (time_s, episodes) = (vec![0.0; options.worlds], vec![0; options.worlds]);
    let actions = actions.clone();
    let mut training =
        Training { goal, around, options, sim, actions, traced, blocks, time_s, episodes, width, lost: 0 };
    training.begin(&vec![true; options.worlds])?;
    let mut adam = Adam::new(network.weights().len());
    let mut curve = Curve::default();
    let each = options.worlds * options.horizon;
    let updates = options.commands.div_ceil(each);
    for update in 0..updates {
        let (mut gradient, cost) = training.fly(&network)?;
        shorten(&mut gradient, options.longest);
        adam.step(network.weights_mut(), &gradient, annealed(options.rate, update as f32 / updates as f32));
        curve.commands.push((update + 1) * each);
        curve.cost.push(cost);
        training.go_on()?;
    }
    let (substeps, sim_hz) = (options.substeps, options.sim_hz);
    let policy = Policy { network, actions: training.actions, substeps, sim_hz };
    Ok(Trained { policy, curve, lost: training.lost })
}

#[cfg(test)]
mod tests;
