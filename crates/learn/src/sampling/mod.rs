//! Planning by sampling: many command sequences are flown from where the drone is, and the best of them say what to do next.
//!
//! A plan is a mean of commands for each of the times to come. In an update, samples are drawn about it, flown by a model and judged by a [`Cost`]; the mean becomes that of the
//! best samples (iCEM: Pinneri et al., "Sample-efficient cross-entropy method for real-time planning", 2020), or of all, weighted by exp(−cost / temperature)
//! (MPPI: Williams et al., "Information theoretic MPC for model-based reinforcement learning", 2017). Then it moves on by the time until the next update. Several
//! *modes* are plans side by side, each with samples of its own, so that ways left and right of a pole do not become one way into it; the best is flown.
//!
//! Samples draw their commands in the lanes in which they fly, and nothing is kept of them but what they cost: the draws are counter-based, so the commands of the few samples that
//! count are drawn once more at the end.
//!
//! ```
//! use propwash_learn::sampling::{Cost, Options, Planner};
//! use propwash_vehicle::Vehicle;
//!
//! let vehicle = Vehicle::builtin("cf21B_500")?;
//! // Of a vehicle with four rotors and commands of four numbers.
//! let cost = Cost::new((&[], "(x - 0.5)^2 + y^2 + (z - 1)^2 + 0.1 * (vx^2 + vy^2 + vz^2)"), &[], (4, 4))?;
//! let options = Options::attitude(&vehicle.drone("so_rpy_rotor_drag")?);
//! let mut planner = Planner::new((&vehicle, "so_rpy_rotor_drag"), cost, options)?;
//! let mut state = planner.at_rest();
//! state.pos = [0.0, 0.0, 1.0];
//! let plan = planner.update(&state, 0.0, &[], None)?;
//! // Forwards is where it wants to go: the nose goes down.
//! assert!(plan.command[1] > 0.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod flight;
#[cfg(test)]
mod tests;

use crate::LearnError;
use crate::check::{at_least_one, below_one};
use flight::{Block, Draws, Round};
use propwash_physics::controllers::{ControlMode, Rates};
use propwash_physics::drone::Drone;
use propwash_physics::rigid_body::State;
use propwash_rollout::{Engine, Sim, SimData, SimOptions};
use propwash_trace::lanes::{Cell, F32x16};
use propwash_vehicle::Vehicle;
pub use propwash_vehicle::expression::Cost;
use propwash_vehicle::expression::Read;
use std::sync::{Mutex, PoisonError};

/// Worlds that fly at once where there are more samples: they sit in cache.
const WORLDS: usize = 1024;

/// How near things are, m, at sixteen positions, m.
pub type Distance<'a> = dyn Fn(&[F32x16; 3]) -> F32x16 + Sync + 'a;

/// How samples become a plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Weigh {
    /// The mean of this share of the samples, the best (iCEM).
    Elites(f64),
    /// The mean of all, weighted by exp(−cost / temperature) (MPPI).
    Temperature(f64),
}

/// How a planner plans.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// What commands mean.
    pub mode: ControlMode,
    /// Sequences of an update, over all modes: a multiple of 16 for each mode.
    pub samples: usize,
    /// Plans side by side.
    pub modes: usize,
    /// Commands of a plan.
    pub horizon: usize,
    /// Time under each command, s.
    pub step_s: f64,
    /// Steps of the simulation under each command.
    pub substeps: usize,
    /// Time from one update to the next, s: by so much a plan moves on.
    pub update_s: f64,
    /// The command about which plans begin.
    pub middle: Vec<f64>,
    /// Standard deviation of each number of a command; 0: it is not drawn.
    pub spread: Vec<f64>,
    /// Bounds of each number of a command.
    pub low: Vec<f64>,
    /// See [`Self::low`].
    pub high: Vec<f64>,
    /// Correlation of the draws of one command and the next, 0 to below 1: what lasts moves farther.
    pub lasting: f64,
    /// How samples become a plan.
    pub weigh: Weigh,
    /// Seed of the draws.
    pub seed: u64,
}

impl Options {
    /// Attitude commands of up to 0.6 rad and between 30 and 170 % of the thrust of hover, 25 of them of 40 ms, 50 updates a second.
    pub fn attitude(drone: &Drone<f64>) -> Self {
        let hover = drone.hover_command();
        Self {
            mode: ControlMode::Attitude,
            samples: 8192,
            modes: 1,
            horizon: 25,
            step_s: 0.04,
            substeps: 1,
            update_s: 0.02,
            middle: vec![0.0, 0.0, 0.0, hover],
            spread: vec![0.12, 0.12, 0.0, 0.15 * hover],
            low: vec![-0.6, -0.6, 0.0, 0.3 * hover],
            high: vec![0.6, 0.6, 0.0, 1.7 * hover],
            lasting: 0.8,
            weigh: Weigh::Elites(0.01),
            seed: 0,
        }
    }

    /// Samples of each mode.
    fn of_mode(&self) -> usize {
        self.samples / self.modes
    }

    fn check(&self, width: usize) -> Result<(), LearnError> {
        at_least_one(&[
            ("samples", self.samples),
            ("modes", self.modes),
            ("horizon", self.horizon),
            ("substeps", self.substeps),
        ])?;
        below_one("lasting", self.lasting)?;
        let wrong = |name, expected: &str, got: String| {
            Err(LearnError::Option { name, expected: expected.into(), got })
        };
        if !self.samples.is_multiple_of(F32x16::LANES * self.modes) || u32::try_from(self.samples).is_err() {
            return wrong(
                "samples",
                "a multiple of 16 for each mode, less than 2³²",
                self.samples.to_string(),
            );
        }
        let hz = self.substeps as f64 / self.step_s;
        if !(hz.is_finite() && hz >= 1.0 && (hz - hz.round()).abs() < 1e-6 * hz && hz < 1e6) {
            let got = format!("{} steps in {} s", self.substeps, self.step_s);
            return wrong("step_s", "a whole number of steps a second under each command", got);
        }
        if !(self.update_s >= 0.0 && self.update_s.is_finite()) {
            return wrong("update_s", "a finite number of seconds, 0 or more", self.update_s.to_string());
        }
        for (name, list) in
            [("middle", &self.middle), ("spread", &self.spread), ("low", &self.low), ("high", &self.high)]
        {
            if list.len() != width || list.iter().any(|v| !v.is_finite()) {
                let got = format!("{list:?}");
                return wrong(name, &format!("{width} finite numbers, one for each of a command"), got);
            }
        }
        if let Some(v) = self.spread.iter().find(|v| **v < 0.0) {
            return wrong("spread", "numbers of 0 or more", v.to_string());
        }
        if !(0..width).all(|k| self.low[k] <= self.middle[k] && self.middle[k] <= self.high[k]) {
            let got = format!("low {:?}, middle {:?}, high {:?}", self.low, self.middle, self.high);
            return wrong("low, middle, high", "numbers in this order", got);
        }
        match self.weigh {
            Weigh::Elites(share) if !(share > 0.0 && share <= 1.0) => {
                wrong("elites", "a share above 0, at most 1", share.to_string())
            }
            Weigh::Temperature(t) if !(t > 0.0 && t.is_finite()) => {
                wrong("temperature", "a finite number above 0, in the units of the cost", t.to_string())
            }
            _ => Ok(()),
        }
    }
}

/// What an update decides.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// The command for now, in the units of the control mode.
    pub command: Vec<f64>,
    /// Which mode it is of.
    pub mode: usize,
    /// What the samples cost of which the mode's mean is made, on average, weighted as there.
    pub cost: f64,
    /// What the best sample of all costs.
    pub best: f64,
}

/// Plans by sampling.
pub struct Planner {
    sim: Sim<f32>,
    /// Worlds as they begin, but for the state.
    start: SimData<f32>,
    cost: Cost,
    reads_before: bool,
    options: Options,
    drawn: Vec<usize>,
    /// (mode, time, number of a command)
    means: Vec<f32>,
    in_force: Vec<f32>,
    updates: u64,
    costs: Vec<f32>,
    blocks: Vec<Mutex<Block>>,
    rest: State<f64>,
}

impl Planner {
    /// A planner that flies its samples by a model of a vehicle.
    ///
    /// # Errors
    /// [`LearnError`] for options that make no sense, and for a model that the vehicle does not have.
    pub fn new(
        (vehicle, dynamics): (&Vehicle, &str),
        cost: Cost,
        options: Options,
    ) -> Result<Self, LearnError> {
        let drone = vehicle.drone(dynamics)?;
        let width = options.mode.width(drone.airframe.n_rotors);
        options.check(width)?;
        let sizes = (drone.airframe.n_rotors, width);
        if cost.sizes() != sizes {
            let expected = format!("one of {} rotors and commands of {} numbers", sizes.0, sizes.1);
            let got = format!("one of {} and {}", cost.sizes().0, cost.sizes().1);
            return Err(LearnError::Option { name: "cost", expected, got });
        }
        let sim_hz = (options.substeps as f64 / options.step_s).round() as u32;
        // Stages that tick faster than the model steps tick in every step.
        let r = vehicle.rates;
        let rates = Rates {
            state_hz: r.state_hz.min(sim_hz),
            attitude_hz: r.attitude_hz.min(sim_hz),
            body_rate_hz: r.body_rate_hz.min(sim_hz),
            force_torque_hz: r.force_torque_hz.min(sim_hz),
        };
        let sim_options = SimOptions {
            n_worlds: options.samples.min(WORLDS),
            seed: options.seed,
            sim_hz,
            control: options.mode,
            engine: Engine::Lanes,
            ..SimOptions::default()
        };
        let mut sim = Sim::<f32>::storing(sim_options, vec![(drone, rates)])?;
        sim.reset(None)?;
        let rest = sim.data.state(0, 0);
        let drawn: Vec<usize> = (0..width).filter(|k| options.spread[*k] > 0.0).collect();
        let block = |_| Mutex::new(Block::new(&cost, drawn.len(), width));
        let blocks = (0..sim.data.n_worlds.div_ceil(F32x16::LANES)).map(block).collect();
        let mut planner = Self {
            start: sim.data.clone(),
            sim,
            reads_before: cost.reads().iter().any(|(_, read)| matches!(read, Read::Before(_))),
            cost,
            drawn,
            means: Vec::new(),
            in_force: Vec::new(),
            updates: 0,
            costs: vec![0.0; options.samples],
            blocks,
            rest,
            options,
        };
        planner.begin();
        Ok(planner)
    }

    /// Forgets all plans: those of the first mode are the middle, those of others are drawn about it.
    pub fn begin(&mut self) {
        let Options { horizon, modes, .. } = self.options;
        let middle: Vec<f32> = self.options.middle.iter().map(|v| *v as f32).collect();
        let n = middle.len();
        self.means = middle.repeat(modes * horizon);
        self.in_force = middle;
        let middle = self.means.clone();
        // Draws of an update that never comes.
        let draws =
            Draws { options: &self.options, means: &middle, drawn: &self.drawn, update: u64::MAX / 2 };
        let zero = F32x16::splat(0.0);
        let (mut noise, mut command) = (vec![zero; self.drawn.len()], vec![zero; n]);
        for mode in 1..modes {
            for t in 0..horizon {
                // Not the first sample of the mode, which flies the mean itself.
                let samples = [draws.first_of(mode) as u32 + 1; F32x16::LANES];
                draws.command((mode, t), &samples, &mut noise, &mut command);
                for (mean, cell) in self.means[(mode * horizon + t) * n..][..n].iter_mut().zip(&command) {
                    *mean = cell.0[0];
                }
            }
        }
        self.updates = 0;
    }

    /// How it plans.
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// The vehicle at the origin, its rotors as in hover: what a state for [`Planner::update`] can be made of.
    pub fn at_rest(&self) -> State<f64> {
        self.rest
    }

    /// The plans. (mode, time, number of a command)
    pub fn means(&self) -> &[f32] {
        &self.means
    }

    /// What each sample of the last update cost; infinite where the model did not stay finite.
    pub fn costs(&self) -> &[f32] {
        &self.costs
    }

    /// Plans anew from a state at a time, s, with what the cost is given, and says what to command now. `distance` tells how near things are, where the cost reads it.
    ///
    /// # Errors
    /// [`LearnError::Option`] for a state that is not finite, another number of numbers than the cost is given, and no `distance` for a cost that reads it; [`LearnError::Goal`] where
    /// no sample has a finite cost.
    pub fn update(
        &mut self,
        state: &State<f64>,
        time_s: f64,
        given: &[f64],
        distance: Option<&Distance>,
    ) -> Result<Plan, LearnError> {
        self.check_given(state, time_s, given, distance.is_some())?;
        let distance = distance.filter(|_| self.cost.reads_distance());
        let given: Vec<f32> = given.iter().map(|v| *v as f32).collect();
        for block in &mut self.blocks {
            block.get_mut().unwrap_or_else(PoisonError::into_inner).begin(&self.cost, &given, &self.in_force);
        }
        for w in 0..self.start.n_worlds {
            self.start.set_state(w, 0, state);
        }
        let steps = (time_s * f64::from(self.start.sim_hz)).round().max(0.0) as u64;
        self.start.steps.fill(steps);
        let Options { samples, horizon, substeps, step_s, .. } = self.options;
        let worlds = self.start.n_worlds;
        for first in (0..samples).step_by(worlds) {
            self.sim.data.clone_from(&self.start);
            let round = Round {
                draws: Draws {
                    options: &self.options,
                    means: &self.means,
                    drawn: &self.drawn,
                    update: self.updates,
                },
                cost: &self.cost,
                reads_before: self.reads_before,
                blocks: &self.blocks,
                first,
                time_s: [time_s, step_s],
                distance,
            };
            self.sim.fly_commanded(&round, horizon, substeps)?;
            let n = worlds.min(samples - first);
            for (k, costs) in self.costs[first..first + n].chunks_mut(F32x16::LANES).enumerate() {
                let block = self.blocks[k].get_mut().unwrap_or_else(PoisonError::into_inner);
                costs.copy_from_slice(&block.sum.0[..costs.len()]);
            }
        }
        self.decide()
    }

    fn check_given(
        &self,
        state: &State<f64>,
        time_s: f64,
        given: &[f64],
        distance: bool,
    ) -> Result<(), LearnError> {
        let wrong = |name, expected: String, got: String| Err(LearnError::Option { name, expected, got });
        let numbers = [&state.pos[..], &state.quat, &state.vel, &state.ang_vel, &[time_s]].concat();
        if numbers.iter().chain(given).any(|v| !v.is_finite()) {
            return wrong("state", "finite numbers".into(), format!("{numbers:?} with {given:?}"));
        }
        if given.len() != self.cost.n_given() {
            let expected = format!("{} numbers, as the cost names", self.cost.n_given());
            return wrong("given", expected, given.len().to_string());
        }
        if self.cost.reads_distance() && !distance {
            let expected = "a distance field, since the cost reads `distance`".into();
            return wrong("field", expected, "none".into());
        }
        Ok(())
    }

    /// Makes plans of what the samples cost, and moves them on.
    fn decide(&mut self) -> Result<Plan, LearnError> {
        let (n, all) = (self.options.middle.len(), self.options.of_mode());
        let mut chosen: Option<Plan> = None;
        let mut means = self.means.clone();
        for mode in 0..self.options.modes {
            let costs = &self.costs[mode * all..(mode + 1) * all];
            let weights = weigh(costs, self.options.weigh);
            let Some((cost, best)) = weights.cost else { continue };
            self.mean_of(mode, &weights.list, &mut means);
            let first = mode * self.options.horizon * n;
            let best = chosen.as_ref().map_or(best, |plan| plan.best.min(best));
            match &mut chosen {
                Some(plan) if plan.cost <= cost => plan.best = best,
                _ => {
                    let command = means[first..first + n].iter().map(|v| f64::from(*v)).collect();
                    chosen = Some(Plan { command, mode, cost, best });
                }
            }
        }
        self.means = means;
        self.updates += 1;
        let Some(plan) = chosen else {
            let what = "no sample has a finite cost: the model or the cost does not stay finite".into();
            return Err(LearnError::Goal { what });
        };
        self.in_force = plan.command.iter().map(|v| *v as f32).collect();
        self.move_on();
        Ok(plan)
    }

    /// The weighted mean of samples of a mode, whose commands are drawn once more.
    fn mean_of(&self, mode: usize, weights: &[(u32, f32)], means: &mut [f32]) {
        let (n, horizon) = (self.options.middle.len(), self.options.horizon);
        let draws =
            Draws { options: &self.options, means: &self.means, drawn: &self.drawn, update: self.updates };
        let own = &mut means[mode * horizon * n..(mode + 1) * horizon * n];
        own.fill(0.0);
        let zero = F32x16::splat(0.0);
        let (mut noise, mut command) = (vec![zero; self.drawn.len()], vec![zero; n]);
        for part in weights.chunks(F32x16::LANES) {
            let at = |lane: usize| part[lane.min(part.len() - 1)].0;
            let samples = core::array::from_fn(|lane| draws.first_of(mode) as u32 + at(lane));
            for t in 0..horizon {
                draws.command((mode, t), &samples, &mut noise, &mut command);
                for (mean, cell) in own[t * n..(t + 1) * n].iter_mut().zip(&command) {
                    *mean += part.iter().zip(&cell.0).map(|((_, weight), v)| weight * v).sum::<f32>();
                }
            }
        }
    }

    /// Moves all plans on to the next update; the last command stays.
    fn move_on(&mut self) {
        let (n, horizon) = (self.options.middle.len(), self.options.horizon);
        let by = self.options.update_s / self.options.step_s;
        let (whole, part) = (by.floor() as usize, (by - by.floor()) as f32);
        for plan in self.means.chunks_exact_mut(horizon * n) {
            let before = plan.to_vec();
            let at = |t: usize, k: usize| before[t.min(horizon - 1) * n + k];
            for (i, to) in plan.iter_mut().enumerate() {
                let (t, k) = (i / n + whole, i % n);
                *to = at(t, k) + part * (at(t + 1, k) - at(t, k));
            }
        }
    }
}

/// What samples count in a mean.
struct Weights {
    /// (sample, weight), of sum one, where the weight is not zero.
    list: Vec<(u32, f32)>,
    /// Mean cost, weighted, and the least; `None` where no cost is finite.
    cost: Option<(f64, f64)>,
}

fn weigh(costs: &[f32], by: Weigh) -> Weights {
    let finite = || (0..costs.len() as u32).filter(|i| costs[*i as usize].is_finite());
    let cost = |i: u32| f64::from(costs[i as usize]);
    let best = finite().map(cost).fold(f64::INFINITY, f64::min);
    let mut list: Vec<(u32, f32)> = match by {
        Weigh::Elites(share) => {
            let n = ((share * costs.len() as f64).round() as usize).max(1);
            let mut order: Vec<u32> = finite().collect();
            // Equal costs are told apart by their numbers, so that the same draws give the same plan.
            let rule = |a: &u32, b: &u32| cost(*a).total_cmp(&cost(*b)).then(a.cmp(b));
            if n < order.len() {
                order.select_nth_unstable_by(n - 1, rule);
                order.truncate(n);
            }
            order.sort_unstable();
            order.into_iter().map(|i| (i, 1.0)).collect()
        }
        // What weighs less than the last digit of the best does not change the mean.
        Weigh::Temperature(t) => finite()
            .map(|i| (i, (-(cost(i) - best) / t).exp() as f32))
            .filter(|(_, weight)| *weight > f32::EPSILON)
            .collect(),
    };
    let sum: f64 = list.iter().map(|(_, weight)| f64::from(*weight)).sum();
    let mean = list.iter().map(|(i, weight)| f64::from(*weight) * cost(*i)).sum::<f64>() / sum;
    list.iter_mut().for_each(|(_, weight)| *weight = (f64::from(*weight) / sum) as f32);
    Weights { cost: (!list.is_empty()).then_some((mean, best)), list }
}
