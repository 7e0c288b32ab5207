//! The batched simulation.

use std::sync::{Arc, Mutex};

use super::backend::Backend;
use super::blocks::{Block, Phase, non_finite};
use super::equations::Equations;
use super::lanes::{Ask, Extra, Lanes};
use super::pipeline::{Pipeline, Stage};
use super::quarantine::{NO_ATTITUDE, Quarantine};
use super::randomize::{Randomization, Rule};
use super::tape::{Programs, Version, lane_options};
use super::{RolloutError, SimData, pool};
use crate::random::Key;
use propwash_compile::{Compile, Request, Status};
use propwash_physics::controllers::{ControlMode, Rates};
use propwash_physics::drone::{Drone, Dynamics};
use propwash_physics::effects::{Command, Effect};
use propwash_physics::integrate::Integrator;
use propwash_physics::rigid_body::{MAX_ROTORS, Rate, State};
use propwash_trace::lanes::Number;
use propwash_trace::math::quat;
use propwash_vehicle::effects::out_of_range;

/// How rotors start after a reset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RotorStart {
    /// Standing still.
    Off,
    /// At the speed that carries the weight.
    #[default]
    Hover,
}

/// What computes the steps of a simulation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Engine {
    /// [`Engine::Reference`] for a simulation that stores f64, [`Engine::Lanes`] for one that stores f32.
    #[default]
    Auto,
    /// The equations themselves in f64, one world at a time: what everything else is compared with.
    Reference,
    /// Many worlds at once in the lanes of the processor, in the number that is stored: code generated from the equations for
    /// the built-in vehicles, byte code traced from them for all others.
    Lanes,
}

/// How a simulation runs, whatever flies in it and wherever.
///
/// Its defaults are those of everything that flies: `propwash::arena::SimConfig` contains it.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default)]
pub struct SimOptions {
    /// Number of worlds.
    pub n_worlds: usize,
    /// Number of the first world over the whole run: worlds keep their random numbers when a run is split.
    pub first_world: u64,
    /// Seed of all random numbers.
    pub seed: u64,
    /// A seed for each world, in place of `seed` and of its number: a world then draws what the first world of a simulation with that seed
    /// draws. Empty where worlds have none of their own. (world)
    pub seeds: Vec<u64>,
    /// Steps per second.
    pub sim_hz: u32,
    /// Integration scheme.
    pub integrator: Integrator,
    /// What commands mean.
    pub control: ControlMode,
    /// How rotors start after a reset.
    pub rotor_start: RotorStart,
    /// What is drawn anew at every reset.
    pub randomization: Randomization,
    /// What computes the steps.
    pub engine: Engine,
    /// When lanes compile steps for which there is no kernel. It says how this machine flies, not what: results have the same bits.
    pub compile: Compile,
}

impl Default for SimOptions {
    /// One world, 500 Hz, explicit Euler, state commands, rotors at hover speed.
    fn default() -> Self {
        Self {
            n_worlds: 1,
            first_world: 0,
            seed: 0,
            seeds: Vec::new(),
            sim_hz: 500,
            integrator: Integrator::default(),
            control: ControlMode::default(),
            rotor_start: RotorStart::default(),
            randomization: Randomization::default(),
            engine: Engine::default(),
            compile: Compile::default(),
        }
    }
}

/// Seed and number by which the random numbers of a world are named: of world number `world` of a simulation, which is number `number` over
/// the whole run, under the seed of all or one of its own; see [`SimOptions::seeds`].
pub fn origin(seed: u64, seeds: &[u64], number: u64, world: usize) -> (u64, u64) {
    seeds.get(world).map_or((seed, number), |own| (*own, 0))
}

impl SimOptions {
    /// Seed and number by which the random numbers of world number `world` of this simulation are named.
    pub fn origin(&self, world: usize) -> (u64, u64) {
        origin(self.seed, &self.seeds, self.first_world + world as u64, world)
    }
}

/// Names of what a reset may draw, beside parameters: position (m), velocity (m/s), angular velocity (rad/s), rotation vector (rad).
const INITIAL: [[&str; 3]; 4] = [
    ["initial.pos.0", "initial.pos.1", "initial.pos.2"],
    ["initial.vel.0", "initial.vel.1", "initial.vel.2"],
    ["initial.ang_vel.0", "initial.ang_vel.1", "initial.ang_vel.2"],
    ["initial.rotation.0", "initial.rotation.1", "initial.rotation.2"],
];

/// Worlds × drones, of one or of several vehicle types.
///
/// Drone slots are the same in every world; each slot has its own vehicle. `N` is the number that is stored: f64, or f32,
/// which needs half the memory and flies on lanes.
///
/// ```
/// use propwash_rollout::trajectory::Reference;
/// use propwash_rollout::{Sim, SimOptions};
/// use propwash_vehicle::Vehicle;
///
/// let vehicle = Vehicle::builtin("cf2x_L250")?;
/// let drones = vec![(vehicle.drone("first_principles")?, vehicle.rates)];
/// let mut sim = Sim::<f64>::storing(SimOptions { n_worlds: 3, ..SimOptions::default() }, drones)?;
/// sim.set_command(&Reference::hover([0.0, 0.0, 1.0], 0.0).command().repeat(3))?;
/// sim.step(1000)?; // two seconds at 500 Hz
/// assert!((sim.data.state(2, 0).pos[2] - 1.0).abs() < 0.1);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Sim<N: Number = f64> {
    pub(super) options: SimOptions,
    pub(super) nominal: Vec<Drone<f64>>,
    /// Per (world, drone) where a caller set parameters for single worlds: what resets draw from.
    pub(super) base: Option<Vec<Drone<f64>>>,
    /// Per (world, drone) where parameters differ between worlds.
    pub(super) own: Option<Vec<Drone<f64>>>,
    /// Where drones start from: one per slot, or one per (world, drone) where worlds differ.
    pub(super) initial: Vec<State<f64>>,
    pub(super) rates: Vec<Rates>,
    /// Where the memory of the effects of each drone begins in that of a world, and where the last one ends.
    effect_at: Vec<usize>,
    /// What rules draw.
    draws: Draws,
    /// What the arrays of controllers hold in this control mode.
    memory_columns: Vec<usize>,
    /// States before the stage that runs.
    kept: Vec<State<f64>>,
    /// All arrays.
    pub data: SimData<N>,
    /// The stages of a step.
    pub pipeline: Pipeline<N>,
    /// Where steps are computed in lanes.
    lanes: Option<Box<Lanes<N>>>,
    /// Programs of its tapes, and what their tables must hold.
    pub(super) programs: Arc<Mutex<Programs<N>>>,
    pub(super) version: Version,
}

impl Sim<f64> {
    /// A simulation of `drones` (one per slot, with the rates of its controllers) in every world, already reset: at the
    /// origin, level, at rest. [`Sim::set_initial`] gives other places to start from.
    pub fn new(options: SimOptions, drones: Vec<(Drone<f64>, Rates)>) -> Result<Self, RolloutError> {
        Self::storing(options, drones)
    }
}

impl<N: Number> Sim<N> {
    /// As [`Sim::new`], with the number that is stored as a type: `Sim::<f32>::storing(…)`.
    pub fn storing(options: SimOptions, drones: Vec<(Drone<f64>, Rates)>) -> Result<Self, RolloutError> {
        check(&options, &drones)?;
        let (nominal, rates): (Vec<_>, Vec<_>) = drones.into_iter().unzip();
        let dt = 1.0 / f64::from(options.sim_hz);
        let memory_len: Vec<usize> = nominal.iter().map(|d| d.memory_len(dt)).collect();
        let effect_at = std::iter::once(0).chain(memory_len.iter().scan(0, |end, len| {
            *end += len;
            Some(*end)
        }));
        let effect_at: Vec<usize> = effect_at.collect();
        let n_rotors = nominal.iter().map(|d| d.airframe.n_rotors).max().unwrap_or(0);
        let data = SimData::new(options.n_worlds, &memory_len, options.sim_hz, options.control, n_rotors);
        let initial = vec![State::rest(); data.n_drones];
        let memory_columns = data.memory_columns.clone();
        let pipeline = Pipeline::default();
        let mut sim = Self {
            options,
            nominal,
            base: None,
            own: None,
            initial,
            rates,
            effect_at,
            draws: Draws::default(),
            memory_columns,
            kept: Vec::new(),
            data,
            pipeline,
            lanes: None,
            programs: Arc::new(Mutex::new(Programs::new(Compile::Off))),
            version: Version::default(),
        };
        let wanted = match sim.options.engine {
            Engine::Auto => N::NAME == "f32",
            Engine::Reference => false,
            Engine::Lanes => true,
        };
        let compile = sim.options.compile.or_of_environment().map_err(RolloutError::Compile)?;
        sim.lanes = wanted.then(|| Box::new(Lanes::new(compile)));
        sim.programs = Arc::new(Mutex::new(Programs::new(compile)));
        for rule in &sim.options.randomization.rules.clone() {
            rule.check()?;
            sim.check_rule(rule)?;
        }
        let rules = &sim.options.randomization.rules;
        sim.draws = Draws {
            drones: sim.nominal.iter().map(|drone| drawn(drone, rules)).collect(),
            start: drawn_initial(rules),
        };
        sim.reset(None)?;
        if compile == Compile::Now {
            sim.compile()?;
        }
        Ok(sim)
    }

    /// Compiles the steps for which there is no kernel, all at once, and waits for them: what [`Compile::Now`] does when a simulation is made.
    /// Steps that are computed by the equations need none. Simulations with [`Compile::Off`] are left as they are.
    ///
    /// # Errors
    /// [`RolloutError::Compile`], saying why; the simulation can go on by byte code.
    pub fn compile(&mut self) -> Result<(), RolloutError> {
        let Some(lanes) = &mut self.lanes else { return Ok(()) };
        let options = lane_options(&self.options, Phase::Both, 1);
        lanes.trace(&options, (&self.nominal, self.own.as_deref()), &self.rates, &self.data);
        let requests = lanes.requests();
        requests.iter().for_each(Request::begin);
        requests.iter().try_for_each(|request| request.wait().map(|_| ())).map_err(RolloutError::Compile)
    }

    /// How compiling goes, one entry for each step that was traced so far and has no kernel.
    pub fn compiling(&self) -> Vec<Status> {
        self.lanes.iter().flat_map(|lanes| lanes.requests()).map(|request| request.status()).collect()
    }

    /// Whether lanes compute the steps.
    pub(super) fn in_lanes(&self) -> bool {
        self.lanes.is_some()
    }

    /// The options.
    pub fn options(&self) -> &SimOptions {
        &self.options
    }

    /// Vehicle of one drone as it flies in `world`.
    pub fn drone(&self, world: usize, drone: usize) -> &Drone<f64> {
        self.equations().drone(world, drone)
    }

    /// The worlds as they are now, without the stages: what several threads can ask for derivatives.
    pub fn equations(&self) -> Equations<'_, N> {
        let (own, data, rates) = (self.own.as_deref(), &self.data, &self.rates);
        Equations {
            options: &self.options,
            nominal: &self.nominal,
            effect_at: &self.effect_at,
            own,
            rates,
            data,
        }
    }

    /// Another seed, and counts of episodes that start anew: after the next [`Sim::reset`] of all worlds everything that is random
    /// is that of a new simulation with this seed.
    pub fn reseed(&mut self, seed: u64) {
        self.options.seed = seed;
        self.options.seeds.clear();
        self.data.episodes.fill(0);
    }

    /// As [`Sim::reseed`], with a seed for each world; see [`SimOptions::seeds`].
    ///
    /// # Errors
    /// [`RolloutError::Length`] for another number of seeds than worlds.
    pub fn reseed_each(&mut self, seeds: &[u64]) -> Result<(), RolloutError> {
        check_seeds(seeds, self.data.n_worlds)?;
        self.options.seeds = seeds.to_vec();
        self.data.episodes.fill(0);
        Ok(())
    }

    /// Seconds since the last reset of `world`.
    pub fn time_s(&self, world: usize) -> f64 {
        self.data.time_s(world)
    }

    /// Numbers of one drone's command in the control mode of this simulation.
    pub fn command_width(&self) -> usize {
        self.data.command_width
    }

    /// Sets all commands, shape (world, drone, [`Sim::command_width`]). They stay in force until set again; controllers
    /// take them up at their next tick.
    pub fn set_command(&mut self, command: &[f64]) -> Result<(), RolloutError> {
        let width = self.command_width();
        let (worlds, drones) = (self.data.n_worlds, self.data.n_drones);
        if command.len() != worlds * drones * width {
            return Err(RolloutError::Length {
                name: "command",
                expected: worlds * drones * width,
                shape: format!("{worlds} worlds × {drones} drones × {width}"),
                got: command.len(),
            });
        }
        if let Some(i) = command.iter().position(|v| !v.is_finite()) {
            return Err(RolloutError::NotFinite {
                name: "command",
                world: i / (drones * width),
                drone: i / width % drones,
                entry: i % width,
                got: command[i],
            });
        }
        for (to, v) in self.data.command.iter_mut().zip(command) {
            *to = N::of(*v);
        }
        Ok(())
    }

    /// Where one drone starts from at every reset, before what is drawn is added.
    pub fn initial(&self, world: usize, drone: usize) -> &State<f64> {
        let n = self.nominal.len();
        if self.initial.len() == n { &self.initial[drone] } else { &self.initial[world * n + drone] }
    }

    /// Sets where one drone starts from at every reset. Takes effect at the next [`Sim::reset`].
    pub fn set_initial(&mut self, world: usize, drone: usize, state: State<f64>) -> Result<(), RolloutError> {
        let numbers = [&state.pos[..], &state.quat, &state.vel, &state.ang_vel, &state.rotor_vel].concat();
        let length: f64 = state.quat.iter().map(|v| v * v).sum();
        if let Some((entry, got)) = numbers.iter().enumerate().find(|(_, v)| !v.is_finite()) {
            return Err(RolloutError::NotFinite { name: "initial state", world, drone, entry, got: *got });
        }
        if (length - 1.0).abs() > 1e-6 {
            return Err(RolloutError::Option {
                name: "initial attitude",
                expected: "a unit quaternion xyzw (length 1 within 1e-6)".into(),
                got: format!("{:?} of length {}", state.quat, length.sqrt()),
            });
        }
        let n = self.nominal.len();
        if world >= self.data.n_worlds || drone >= n {
            return Err(RolloutError::Option {
                name: "initial state",
                expected: format!("world < {}, drone < {n}", self.data.n_worlds),
                got: format!("world {world}, drone {drone}"),
            });
        }
        if self.initial.len() < self.data.n_worlds * n {
            self.initial = self.initial.repeat(self.data.n_worlds);
        }
        self.initial[world * n + drone] = state;
        Ok(())
    }

    /// Sets one parameter of one drone in one world, or in all worlds; names are those of [`Drone::visit`]. Resets keep
    /// it; randomisation draws from it.
    pub fn set_parameter(
        &mut self,
        world: Option<usize>,
        drone: usize,
        name: &str,
        value: f64,
    ) -> Result<(), RolloutError> {
        if drone >= self.nominal.len() || world.is_some_and(|w| w >= self.data.n_worlds) {
            return Err(RolloutError::Option {
                name: "parameter",
                expected: format!("world < {}, drone < {}", self.data.n_worlds, self.nominal.len()),
                got: format!("world {}, drone {drone}", world.map_or("all".into(), |w| w.to_string())),
            });
        }
        if !value.is_finite() {
            let world = world.unwrap_or(0);
            return Err(RolloutError::NotFinite { name: "parameter", world, drone, entry: 0, got: value });
        }
        let mut found = false;
        let set = |d: &mut Drone<f64>, found: &mut bool| {
            d.visit(&mut |n, v| {
                if n == name {
                    *v = value;
                    *found = true;
                }
            });
            d.refresh();
        };
        let mut tried = self.nominal[drone].clone();
        set(&mut tried, &mut found);
        if !found {
            let close = close_names(&mut tried, name);
            return Err(RolloutError::NoParameter { drone, name: name.into(), close });
        }
        check_body(&tried, drone)?;
        check_effects(&tried, drone)?;
        self.forget_tables();
        let n = self.nominal.len();
        match world {
            None => {
                self.nominal[drone] = tried;
                for list in [&mut self.base, &mut self.own] {
                    for (_, d) in list.iter_mut().flatten().enumerate().filter(|(i, _)| i % n == drone) {
                        set(d, &mut found);
                    }
                }
            }
            Some(w) => {
                let row = w * n + drone;
                for list in [&mut self.base, &mut self.own] {
                    set(&mut per_world(list, &self.nominal, self.data.n_worlds)[row], &mut found);
                }
            }
        }
        Ok(())
    }

    /// Lets a backend of your own run the steps, or with `None` kernels and byte code again. It takes effect with the next step.
    ///
    /// # Errors
    /// [`RolloutError::Option`] for a simulation that flies by [`Engine::Reference`], whose steps no code is traced from.
    pub fn set_backend(&mut self, backend: Option<Arc<dyn Backend<N>>>) -> Result<(), RolloutError> {
        let Some(lanes) = &mut self.lanes else {
            return Err(RolloutError::Option {
                name: "engine",
                expected: "`lanes`, for a backend to run the steps".into(),
                got: format!("{:?}, which computes them by the equations", self.options.engine),
            });
        };
        lanes.set_backend(backend);
        Ok(())
    }

    /// Lets lanes read the parameters anew.
    pub(super) fn forget_tables(&mut self) {
        self.version.vehicles += 1;
        if let Some(lanes) = &mut self.lanes {
            lanes.forget_tables();
        }
    }

    /// Refuses rules that no drone has a number for.
    fn check_rule(&mut self, rule: &Rule) -> Result<(), RolloutError> {
        let mut found = INITIAL.iter().flatten().any(|name| rule.matches(name));
        for drone in &mut self.nominal {
            drone.visit(&mut |n, _| found |= rule.matches(n));
        }
        if found {
            return Ok(());
        }
        let close = close_names(&mut self.nominal[0], &rule.parameter);
        Err(RolloutError::NoParameter { drone: 0, name: rule.parameter.clone(), close })
    }

    /// Back to the initial states, in all worlds or in those whose entry is true; controllers and effects forget, time
    /// starts anew, randomised parameters and states are drawn for the next episode, quarantine ends. Commands,
    /// disturbances and wind stay.
    pub fn reset(&mut self, worlds: Option<&[bool]>) -> Result<(), RolloutError> {
        let n_worlds = self.data.n_worlds;
        if let Some(mask) = worlds
            && mask.len() != n_worlds
        {
            return Err(RolloutError::Length {
                name: "reset mask",
                expected: n_worlds,
                shape: format!("{n_worlds} worlds"),
                got: mask.len(),
            });
        }
        // Taken out for the time of the reset, which changes everything else.
        let (draws, rules) =
            (std::mem::take(&mut self.draws), std::mem::take(&mut self.options.randomization.rules));
        let wanted = (0..n_worlds).filter(|w| worlds.is_none_or(|mask| mask[*w]));
        // Where all worlds have the same vehicles, these hover alike.
        let alike = self.own.is_none() && rules.iter().all(|r| r.parameter.starts_with("initial."));
        let hovers: Option<Vec<_>> = alike.then(|| self.nominal.iter().map(hover).collect());
        let outcome = wanted.into_iter().try_for_each(|w| {
            self.data.episodes[w] += 1;
            self.data.steps[w] = 0;
            self.data.quarantine[w] = None;
            (0..self.nominal.len()).try_for_each(|d| {
                let hovers = hovers.as_ref().map(|h| h[d]);
                self.reset_drone((w, d), (&rules, &draws.drones[d], &draws.start), hovers)
            })
        });
        (self.draws, self.options.randomization.rules) = (draws, rules);
        outcome
    }

    /// `hovers`: rotor speeds and thrust state at which it hovers, where they are known.
    fn reset_drone(
        &mut self,
        (w, d): (usize, usize),
        (rules, drawn, start): (&[Rule], &[Drawn], &[Drawn]),
        hovers: Option<([f64; MAX_ROTORS], f64)>,
    ) -> Result<(), RolloutError> {
        let row = self.data.row(w, d);
        let (seed, world) = self.options.origin(w);
        let key = Key { seed, world, drone: d as u32, step: self.data.episodes[w] - 1, purpose: 0 };
        if !drawn.is_empty() {
            let mut drone = self.base.as_ref().map_or(&self.nominal[d], |base| &base[row]).clone();
            let (mut at, mut rest) = (0, drawn.iter().peekable());
            drone.numbers_mut(&mut |value| {
                if let Some(number) = rest.next_if(|number| number.at == at) {
                    *value = number.draw(rules, *value, key);
                }
                at += 1;
            });
            drone.refresh();
            check_body(&drone, d)?;
            // Ranges go by names, which takes longer than all else, and what is not drawn is within them.
            if drawn.iter().any(|number| number.name.starts_with("effect.")) {
                check_effects(&drone, d)?;
            }
            let first = self.own.is_none();
            per_world(&mut self.own, &self.nominal, self.data.n_worlds)[row] = drone;
            let changes = if first { &mut self.version.vehicles } else { &mut self.version.worlds };
            *changes += 1;
            if let Some(lanes) = &mut self.lanes {
                if first {
                    lanes.forget_tables();
                } else {
                    lanes.forget_row(row);
                }
            }
        }
        let mut state = self.initial[row % self.initial.len()];
        let mut rotation = [0.0; 3];
        for number in start {
            let of = [&mut state.pos, &mut state.vel, &mut state.ang_vel, &mut rotation];
            for (group, numbers) in of.into_iter().enumerate() {
                if let Some(value) = number.at.checked_sub(3 * group).and_then(|i| numbers.get_mut(i)) {
                    *value = number.draw(rules, *value, key);
                }
            }
        }
        state.quat = quat::normalize(quat::mul(state.quat, quat::exp(rotation)));
        if self.options.rotor_start == RotorStart::Hover {
            (state.rotor_vel, state.thrust) = hovers.unwrap_or_else(|| hover(self.drone(w, d)));
            check_hover(&state, self.drone(w, d), d)?;
        }
        self.data.set_state(w, d, &state);
        let (memory, rotors) = (self.data.memory_columns.len(), self.data.n_rotors);
        self.data.controller_memory[row * memory..(row + 1) * memory].fill(N::zero());
        self.data.rotor_command[row * rotors..(row + 1) * rotors].fill(N::zero());
        self.data.attitude_command[row * 4..(row + 1) * 4].fill(N::zero());
        let at = self.equations().effect_memory_of(w, d);
        if at.is_empty() {
            return Ok(());
        }
        let mut memory = vec![0.0; at.len()];
        let drone = self.drone(w, d);
        let in_force = match drone.dynamics {
            Dynamics::Rotors => Command::Rotors(state.rotor_vel),
            Dynamics::AttitudeResponse(_) => Command::Attitude([0.0, 0.0, 0.0, state.thrust]),
        };
        let dt_s = 1.0 / f64::from(self.options.sim_hz);
        drone.start(&in_force, |effect| effect.memory_len(dt_s), &mut memory);
        for (to, v) in self.data.effect_memory[at].iter_mut().zip(&memory) {
            *to = N::of(*v);
        }
        Ok(())
    }

    /// Advances every world that is not quarantined by `n_steps`.
    ///
    /// A world in which a user's stage writes a state that is not finite is quarantined at once, with the states from
    /// before that stage.
    ///
    /// # Errors
    /// [`RolloutError::Length`] and [`RolloutError::Option`] when the arrays of `data` do not have their shapes any more.
    pub fn step(&mut self, n_steps: usize) -> Result<(), RolloutError> {
        self.check_data()?;
        self.mend_attitudes();
        if self.pipeline.is_plain() {
            self.run(n_steps, Phase::Both);
            return Ok(());
        }
        for _ in 0..n_steps {
            self.run_stages(0..self.pipeline.stages.len())?;
        }
        Ok(())
    }

    /// Runs some of the stages of one step.
    fn run_stages(&mut self, range: core::ops::Range<usize>) -> Result<(), RolloutError> {
        // Taken out meanwhile, since a stage borrows the arrays that the blocks write.
        let mut stages = std::mem::take(&mut self.pipeline.stages);
        let mut outcome = Ok(());
        let mut i = range.start;
        while i < range.end && outcome.is_ok() {
            let both = matches!(stages[i].1, Stage::Controllers)
                && i + 1 < range.end
                && matches!(stages[i + 1].1, Stage::Integration);
            let (name, stage) = &mut stages[i];
            match stage {
                Stage::Controllers if both => {
                    self.run(1, Phase::Both);
                    i += 1;
                }
                Stage::Controllers => self.run(1, Phase::Controllers),
                Stage::Integration => self.run(1, Phase::Integration),
                Stage::User(f) => {
                    self.keep_states();
                    f(&mut self.data);
                    outcome = self.check_data();
                    if outcome.is_ok() {
                        self.set_aside_non_finite(name);
                        self.mend_attitudes();
                    }
                }
            }
            i += 1;
        }
        self.pipeline.stages = stages;
        outcome
    }

    /// Refuses arrays whose lengths, or counts that, were changed.
    ///
    /// # Errors
    /// [`RolloutError::Option`] and [`RolloutError::Length`].
    pub fn check_data(&self) -> Result<(), RolloutError> {
        let n_rotors = self.nominal.iter().map(|d| d.airframe.n_rotors).max().unwrap_or(0);
        let width = self.options.control.width(n_rotors);
        let data = &self.data;
        let expected = (self.options.n_worlds, self.nominal.len(), self.options.sim_hz, n_rotors, width);
        let got = (data.n_worlds, data.n_drones, data.sim_hz, data.n_rotors, data.command_width);
        if got != expected {
            let words = |(w, d, hz, rotors, width)| {
                format!("{w} worlds × {d} drones at {hz} Hz, {rotors} rotors, commands of {width}")
            };
            return Err(RolloutError::Option {
                name: "n_worlds, n_drones, sim_hz, n_rotors, command_width of data",
                expected: format!("{} as the simulation was built", words(expected)),
                got: words(got),
            });
        }
        if data.memory_columns != self.memory_columns {
            let words = |n: usize| format!("{n} numbers that controllers remember");
            return Err(RolloutError::Option {
                name: "control mode of data",
                expected: format!(
                    "that of the simulation, {}: {}",
                    self.options.control.name(),
                    words(self.memory_columns.len())
                ),
                got: format!("the data of another mode: {}", words(data.memory_columns.len())),
            });
        }
        self.data.check_lengths(self.effect_at[self.nominal.len()])
    }

    /// Attitudes that were written into `data` are brought to unit length, which steps then keep. One of length 0 is none: its
    /// world is quarantined.
    pub(super) fn mend_attitudes(&mut self) {
        let n = self.nominal.len();
        for (row, q) in self.data.quat.chunks_exact_mut(4).enumerate() {
            let n2: f64 = q.iter().map(|v| v.wide() * v.wide()).sum();
            if (n2 - 1.0).abs() <= 1e-5 || !n2.is_finite() {
                continue;
            }
            if n2 < 1e-12 {
                let w = row / n;
                self.data.quarantine[w].get_or_insert_with(|| {
                    Box::new(Quarantine {
                        world: self.options.first_world + w as u64,
                        drone: row % n,
                        step: self.data.steps[w],
                        quantity: NO_ATTITUDE.into(),
                        stage: None,
                    })
                });
                continue;
            }
            for v in q {
                *v = N::of(v.wide() / n2.sqrt());
            }
        }
    }

    fn keep_states(&mut self) {
        let n = self.nominal.len();
        self.kept.clear();
        self.kept.extend((0..self.data.n_worlds * n).map(|row| self.data.state(row / n, row % n)));
    }

    /// Quarantines the worlds whose states stage `stage` has made non-finite, and puts their states back.
    fn set_aside_non_finite(&mut self, stage: &str) {
        let n = self.nominal.len();
        for w in 0..self.data.n_worlds {
            let fault = (0..n).find_map(|d| non_finite(&self.data.state(w, d)).map(|quantity| (d, quantity)));
            let Some((drone, quantity)) = fault else { continue };
            for d in 0..n {
                self.data.set_state(w, d, &self.kept[w * n + d]);
            }
            self.data.quarantine[w].get_or_insert_with(|| {
                Box::new(Quarantine {
                    world: self.options.first_world + w as u64,
                    drone,
                    step: self.data.steps[w],
                    quantity: quantity.into(),
                    stage: Some(stage.into()),
                })
            });
        }
    }

    /// The first half of a step: the on-board controllers, as far as they tick, and what other stages there are before integration.
    /// Afterwards `data.rotor_command` and `data.attitude_command` hold what is in force until the next step.
    ///
    /// # Errors
    /// As [`Sim::step`].
    pub fn run_controllers(&mut self) -> Result<(), RolloutError> {
        self.check_data()?;
        self.mend_attitudes();
        self.run_stages(0..self.pipeline.integration())
    }

    /// The second half: integration, and time moves on; then the stages after it.
    ///
    /// # Errors
    /// As [`Sim::step`].
    pub fn run_integration(&mut self) -> Result<(), RolloutError> {
        self.run_stages(self.pipeline.integration()..self.pipeline.stages.len())
    }

    /// Time derivative of one drone's state under the commands in force, as integration would see it at the start of the
    /// next step, but before effects change the command on its way (delay, battery).
    pub fn rate(&self, world: usize, drone: usize) -> Rate<f64> {
        self.equations().rate(world, drone)
    }

    /// Velocity of the air at one drone, m/s, world: `data.wind` with what its effects add (wind, gusts).
    pub fn wind_m_s(&self, world: usize, drone: usize) -> [f64; 3] {
        self.equations().wind_m_s(world, drone)
    }

    /// Voltage of one drone's battery under the load of the next step, V; `None` for a vehicle without one (effect
    /// `battery_sag`).
    pub fn battery_v(&self, world: usize, drone: usize) -> Option<f64> {
        self.equations().battery_v(world, drone)
    }

    /// Where the load of one drone hung when the last step began, m, world; `None` for a vehicle without one (effect
    /// `slung_payload`) and before the first step.
    pub fn load_m(&self, world: usize, drone: usize) -> Option<[f64; 3]> {
        self.equations().load_m(world, drone)
    }

    /// Collective thrust of one drone at its present rotor speeds or thrust state, N: of the rotors as built, before what
    /// the air adds.
    pub fn thrust_n(&self, world: usize, drone: usize) -> f64 {
        self.equations().thrust_n(world, drone)
    }

    /// Runs blocks of worlds, in parallel where it pays.
    fn run(&mut self, n_steps: usize, phase: Phase) {
        if self.lanes.is_some() {
            return self.run_lanes((n_steps, phase), &Ask::Steps, Vec::new());
        }
        let n = self.nominal.len();
        let plan = self.equations().plan();
        let mut blocks: Vec<(usize, Block, Option<Quarantine>)> = (0..self.data.n_worlds)
            .filter(|w| self.data.quarantine[*w].is_none())
            .map(|w| (w, self.equations().load(w), None))
            .collect();
        let work = blocks.len() * n * n_steps;
        let (nominal, own) = (&self.nominal, &self.own);
        pool::for_each(&mut blocks, work, |(w, block, fault)| {
            let drones: Vec<&Drone<f64>> = match own {
                Some(own) => own[*w * n..(*w + 1) * n].iter().collect(),
                None => nominal.iter().collect(),
            };
            *fault = block.advance(&plan, &drones, n_steps, phase);
        });
        for (w, block, fault) in blocks {
            self.store(w, &block);
            self.data.quarantine[w] =
                fault.map(|q| Box::new(Quarantine { world: self.options.first_world + w as u64, ..q }));
        }
    }

    /// The same in lanes, or what else is asked of them; see [`Lanes::run`].
    pub(super) fn run_lanes(&mut self, (n_steps, phase): (usize, Phase), ask: &Ask<N>, extra: Extra<N>) {
        let Some(lanes) = &mut self.lanes else { return };
        let options = lane_options(&self.options, phase, n_steps);
        let drones = (&self.nominal[..], self.own.as_deref());
        lanes.run(&options, &self.options.seeds, drones, &self.rates, (&mut self.data, ask, extra));
    }

    /// Writes a world back.
    fn store(&mut self, w: usize, block: &Block) {
        self.data.steps[w] = block.step;
        for (d, slot) in block.slots.iter().enumerate() {
            let effects = self.equations().effect_memory_of(w, d);
            let data = &mut self.data;
            let row = w * self.nominal.len() + d;
            data.set_state(w, d, &slot.state);
            let put = |a: &mut [N], numbers: &[f64]| {
                let len = numbers.len();
                for (i, v) in numbers.iter().enumerate() {
                    a[row * len + i] = N::of(*v);
                }
            };
            put(&mut data.rotor_command, &slot.rotor_command[..data.n_rotors]);
            put(&mut data.attitude_command, &slot.attitude_command);
            data.set_memory(w, d, &slot.memory);
            for (to, v) in data.effect_memory[effects].iter_mut().zip(&slot.effect_memory) {
                *to = N::of(*v);
            }
        }
    }
}

/// Rotor speeds (rad/s) at which a drone hovers, and the thrust state (N) at which the abstracted model does.
fn hover(drone: &Drone<f64>) -> ([f64; MAX_ROTORS], f64) {
    (drone.hover_rotor_vel(), drone.parts().response.map_or(0.0, |_| drone.hover_command()))
}

/// Refuses rotors that lift nothing at any speed, where they shall start at that of hover.
fn check_hover(state: &State<f64>, drone: &Drone<f64>, slot: usize) -> Result<(), RolloutError> {
    match state.rotor_vel.iter().position(|speed| !speed.is_finite()) {
        None => Ok(()),
        Some(i) => Err(RolloutError::Parameter {
            drone: slot,
            name: format!("rotors.{i}.thrust_curve.2"),
            expected: "a number above 0, since rotors start at the speed of hover".into(),
            got: drone.airframe.rotors[i].thrust_curve[2],
        }),
    }
}

/// A number of a drone, or of how it begins, that rules draw.
#[derive(Debug)]
struct Drawn {
    /// Its place among the numbers that [`Drone::map`] meets, or in [`INITIAL`].
    at: usize,
    name: String,
    /// Places of the rules that speak of it.
    rules: Vec<usize>,
}

/// All that rules draw. Names are looked up once: what they stand for is at the same place in every world and episode.
#[derive(Debug, Default)]
struct Draws {
    /// For each drone slot.
    drones: Vec<Vec<Drawn>>,
    /// Of how drones begin.
    start: Vec<Drawn>,
}

impl Drawn {
    /// The number that is drawn for a nominal one.
    fn draw(&self, rules: &[Rule], nominal: f64, key: Key) -> f64 {
        self.rules.iter().fold(nominal, |value, r| rules[*r].apply(&self.name, value, key))
    }
}

/// The numbers of how drones begin that rules draw.
fn drawn_initial(rules: &[Rule]) -> Vec<Drawn> {
    let all = INITIAL.iter().flatten().enumerate().map(|(at, name)| {
        let of = rules.iter().enumerate().filter(|(_, rule)| rule.matches(name));
        Drawn { at, name: (*name).into(), rules: of.map(|(i, _)| i).collect() }
    });
    all.filter(|number| !number.rules.is_empty()).collect()
}

/// The numbers of a drone that rules draw, in the order of [`Drone::map`].
fn drawn(drone: &Drone<f64>, rules: &[Rule]) -> Vec<Drawn> {
    // A mark that `numbers` shows again: names do not stand for all numbers that it meets. No parameter is such a NaN.
    const MARK: u64 = 0x7ff8_5a5a_0000_0000;
    let (mut marked, mut found) = (drone.clone(), Vec::<Drawn>::new());
    marked.visit(&mut |name, value| {
        let of = rules.iter().enumerate().filter(|(_, rule)| rule.matches(name));
        let own: Vec<usize> = of.map(|(i, _)| i).collect();
        if !own.is_empty() {
            *value = f64::from_bits(MARK | found.len() as u64);
            found.push(Drawn { at: 0, name: name.into(), rules: own });
        }
    });
    let mut at = 0;
    marked.numbers(&mut |v| {
        let bits = v.to_bits();
        if bits & !u64::from(u32::MAX) == MARK
            && let Some(number) = found.get_mut((bits & u64::from(u32::MAX)) as usize)
        {
            number.at = at;
        }
        at += 1;
    });
    found.sort_by_key(|number| number.at);
    found
}

/// The list of drones per (world, drone), begun with the nominal ones.
fn per_world<'a>(
    list: &'a mut Option<Vec<Drone<f64>>>,
    nominal: &[Drone<f64>],
    n_worlds: usize,
) -> &'a mut Vec<Drone<f64>> {
    list.get_or_insert_with(|| {
        (0..n_worlds * nominal.len()).map(|i| nominal[i % nominal.len()].clone()).collect()
    })
}

/// Names of parameters that begin as `wanted` does, or, where none does, what names begin with.
pub(super) fn close_names(drone: &mut Drone<f64>, wanted: &str) -> String {
    let head = wanted.split('.').next().unwrap_or("");
    let (mut close, mut heads): (Vec<String>, Vec<String>) = (Vec::new(), Vec::new());
    drone.visit(&mut |name, _| {
        let own = name.split('.').next().unwrap_or(name);
        if own == head && close.len() < 12 {
            close.push(name.into());
        }
        if !heads.iter().any(|h| h.strip_suffix(".…") == Some(own)) {
            heads.push(format!("{own}.…"));
        }
    });
    if close.is_empty() { heads.join(", ") } else { close.join(", ") }
}

/// Refuses a body that cannot move as one: mass and moments of inertia above zero, gravity finite.
fn check_body(drone: &Drone<f64>, slot: usize) -> Result<(), RolloutError> {
    let body = &drone.body;
    let option = |name, expected: &str, got: f64| {
        Err(RolloutError::Option { name, expected: expected.into(), got: format!("{got} for drone {slot}") })
    };
    if !(body.mass_kg.is_finite() && body.mass_kg > 0.0) {
        return option("body.mass_kg", "a finite mass above 0 kg", body.mass_kg);
    }
    for i in 0..3 {
        let moment = body.inertia_kg_m2[i][i];
        if !(moment.is_finite() && moment > 0.0) {
            return option("body.inertia_kg_m2", "finite moments of inertia above 0 kg m²", moment);
        }
        if !body.gravity_m_s2[i].is_finite() {
            return option("body.gravity_m_s2", "finite numbers", body.gravity_m_s2[i]);
        }
        let (a, b) = (body.inertia_kg_m2[i][(i + 1) % 3], body.inertia_kg_m2[(i + 1) % 3][i]);
        if a != b {
            return option("body.inertia_kg_m2", &format!("a symmetric matrix; {a} stands across from"), b);
        }
    }
    Ok(())
}

/// Refuses effects with a parameter out of its range.
fn check_effects(drone: &Drone<f64>, slot: usize) -> Result<(), RolloutError> {
    for effect in &drone.effects {
        if let Some(fault) = out_of_range(&mut effect.clone()) {
            return Err(RolloutError::Parameter {
                drone: slot,
                name: format!("effect.{}.{}", effect.label(), fault.parameter),
                expected: fault.expected,
                got: fault.found,
            });
        }
    }
    Ok(())
}

/// Refuses another number of seeds than worlds.
fn check_seeds(seeds: &[u64], n_worlds: usize) -> Result<(), RolloutError> {
    if seeds.len() == n_worlds {
        return Ok(());
    }
    let shape = format!("{n_worlds} worlds");
    Err(RolloutError::Length { name: "seeds", expected: n_worlds, shape, got: seeds.len() })
}

/// Refuses options that make no sense.
fn check(options: &SimOptions, drones: &[(Drone<f64>, Rates)]) -> Result<(), RolloutError> {
    let option = |name, expected: &str, got: String| {
        Err(RolloutError::Option { name, expected: expected.into(), got })
    };
    if options.n_worlds == 0 {
        return option("n_worlds", "at least 1", "0".into());
    }
    if drones.is_empty() {
        return option("drones", "at least one drone", "none".into());
    }
    if options.sim_hz == 0 || options.sim_hz > 1_000_000 {
        return option("sim_hz", "1 to 1 000 000 steps per second", options.sim_hz.to_string());
    }
    if !options.seeds.is_empty() {
        check_seeds(&options.seeds, options.n_worlds)?;
    }
    // Arrays of one world and drone come to about 0.6 kB in f64; refuse what no machine holds before asking for it.
    let bytes = options.n_worlds.checked_mul(drones.len()).and_then(|n| n.checked_mul(600));
    if bytes.is_none_or(|b| b > 1 << 40) {
        return option(
            "n_worlds",
            "worlds × drones that fit in 1 TiB of memory (about 0.6 kB each)",
            format!("{} worlds × {} drones", options.n_worlds, drones.len()),
        );
    }
    // What this machine does not have would end the process when the arrays are made one by one.
    if bytes.is_some_and(|b| Vec::<u8>::new().try_reserve_exact(b).is_err()) {
        return option(
            "n_worlds",
            "worlds × drones that fit in the memory of this machine (about 0.6 kB each)",
            format!("{} worlds × {} drones", options.n_worlds, drones.len()),
        );
    }
    for (i, (drone, rates)) in drones.iter().enumerate() {
        let abstracted = matches!(drone.dynamics, Dynamics::AttitudeResponse(_));
        if abstracted && !matches!(options.control, ControlMode::State | ControlMode::Attitude) {
            return Err(RolloutError::ModeNeedsRotors { drone: i, mode: options.control.name() });
        }
        if !(1..=MAX_ROTORS).contains(&drone.airframe.n_rotors) {
            return option("rotors of a drone", "1 to 8", drone.airframe.n_rotors.to_string());
        }
        let used: &[(&'static str, u32)] = match options.control {
            ControlMode::State => &[
                ("state_hz", rates.state_hz),
                ("attitude_hz", rates.attitude_hz),
                ("force_torque_hz", rates.force_torque_hz),
            ],
            ControlMode::Attitude => {
                &[("attitude_hz", rates.attitude_hz), ("force_torque_hz", rates.force_torque_hz)]
            }
            ControlMode::BodyRate => {
                &[("body_rate_hz", rates.body_rate_hz), ("force_torque_hz", rates.force_torque_hz)]
            }
            ControlMode::ForceTorque => &[("force_torque_hz", rates.force_torque_hz)],
            ControlMode::RotorVel => &[],
        };
        for &(name, hz) in used {
            if hz == 0 || hz > options.sim_hz {
                return option(
                    name,
                    &format!("1 to {} Hz, the rate of the simulation", options.sim_hz),
                    format!("{hz} Hz for drone {i}"),
                );
            }
        }
        check_body(drone, i)?;
        check_effects(drone, i)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::{CONTROLLERS, INTEGRATION, rest_on_ground};
    use crate::quarantine::TOO_FAR;
    use crate::randomize::Draw;
    use crate::trajectory::Trajectory;
    use propwash_physics::effects::{
        AnyEffect, command_delay, constant_wind, downwash, linear_drag, turbulence,
    };
    use propwash_physics::sample::{RATES, quad};

    fn attitude() -> SimOptions {
        SimOptions { control: ControlMode::Attitude, ..SimOptions::default() }
    }

    fn hover_command(sim: &Sim, at: [f64; 3]) -> Vec<f64> {
        let one = Trajectory::Hover { at_m: at }.at(0.0).command();
        one.repeat(sim.data.n_worlds * sim.data.n_drones)
    }

    fn state_sim(n_worlds: usize, drones: usize) -> Sim {
        let options = SimOptions { n_worlds, control: ControlMode::State, seed: 5, ..attitude() };
        Sim::new(options, vec![(quad(vec![]), RATES); drones]).unwrap()
    }

    #[test]
    fn a_drone_flies_to_its_set_point() {
        let mut sim = state_sim(1, 1);
        let command = hover_command(&sim, [0.5, -0.3, 1.0]);
        sim.set_command(&command).unwrap();
        sim.step(4000).unwrap();
        let s = sim.data.state(0, 0);
        for (a, b) in s.pos.iter().zip([0.5, -0.3, 1.0]) {
            assert!((a - b).abs() < 0.02, "{:?}", s.pos);
        }
        assert_eq!(sim.time_s(0), 8.0);
    }

    fn randomized(n_worlds: usize, first_world: u64) -> Sim {
        let rule = |name: &str, draw| Rule { parameter: name.into(), draw, shared: false };
        let randomization = Randomization {
            rules: vec![
                rule("body.mass_kg", Draw::Scale([0.9, 1.1])),
                rule("rotors.*.thrust_curve.2", Draw::Scale([0.95, 1.05])),
                rule("initial.pos.*", Draw::Normal(0.1)),
                rule("initial.rotation.2", Draw::Uniform([-0.3, 0.3])),
            ],
        };
        let options = SimOptions {
            n_worlds,
            first_world,
            seed: 11,
            control: ControlMode::State,
            integrator: Integrator::Rk4,
            randomization,
            ..attitude()
        };
        let mut sim = Sim::new(options, vec![(quad(vec![]), RATES); 2]).unwrap();
        let command = hover_command(&sim, [0.0, 0.0, 1.0]);
        sim.set_command(&command).unwrap();
        sim
    }

    #[test]
    fn results_are_the_same_bits_for_any_thread_count_and_any_split_of_the_worlds() {
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut sim = randomized(16, 0);
                for _ in 0..5 {
                    sim.step(50).unwrap();
                }
                sim.data
            })
        };
        let one = run(1);
        assert_eq!(one, run(4));
        let mut half = randomized(8, 8);
        half.step(250).unwrap();
        assert_eq!(half.data.pos, one.pos[8 * 2 * 3..]);
        assert_eq!(half.data.rotor_vel, one.rotor_vel[8 * 2 * 4..]);
    }

    #[test]
    fn rotors_that_never_lift_cannot_start_at_hover_and_may_stand_still() {
        let mut sim = state_sim(2, 1);
        sim.set_parameter(None, 0, "rotors.1.thrust_curve.2", 0.0).unwrap();
        let error = sim.reset(None).unwrap_err().to_string();
        assert!(
            error.contains("rotors.1.thrust_curve.2 of drone 0: expected a number above 0, since"),
            "{error}"
        );
        let options = SimOptions { rotor_start: RotorStart::Off, ..attitude() };
        let mut sim = Sim::<f64>::new(options, vec![(quad(vec![]), RATES)]).unwrap();
        sim.set_parameter(None, 0, "rotors.1.thrust_curve.2", 0.0).unwrap();
        sim.reset(None).unwrap();
        sim.step(10).unwrap();
        assert_eq!(sim.n_quarantined(), 0);
    }

    #[test]
    fn every_episode_and_world_draws_anew_and_a_masked_reset_touches_no_other_world() {
        let mut sim = randomized(3, 0);
        let mass = |sim: &Sim, w: usize| sim.drone(w, 0).body.mass_kg;
        let first = [mass(&sim, 0), mass(&sim, 1), mass(&sim, 2)];
        assert!(first[0] != first[1] && first[1] != first[2]);
        sim.step(100).unwrap();
        let before = sim.data.clone();
        sim.reset(Some(&[false, true, false])).unwrap();
        assert_eq!((mass(&sim, 0), mass(&sim, 2)), (first[0], first[2]));
        assert_ne!(mass(&sim, 1), first[1]);
        assert_eq!(
            (sim.data.steps.clone(), sim.data.pos[..6].to_vec()),
            (vec![100, 0, 100], before.pos[..6].to_vec())
        );
        let again = randomized(3, 0);
        assert_eq!(mass(&again, 1), first[1], "the same seed draws the same");
    }

    #[test]
    fn a_world_that_turns_non_finite_is_named_and_harms_no_neighbour() {
        let mut sim = state_sim(3, 2);
        let mut calm = state_sim(3, 2);
        let command = hover_command(&sim, [0.0, 0.0, 1.0]);
        sim.set_command(&command).unwrap();
        calm.set_command(&command).unwrap();
        sim.step(10).unwrap();
        calm.step(10).unwrap();
        let row = sim.data.row(1, 1);
        sim.data.disturbance_force[3 * row] = f64::INFINITY;
        sim.step(10).unwrap();
        calm.step(10).unwrap();
        let fault = sim.data.quarantine[1].clone().unwrap();
        assert_eq!((fault.world, fault.drone, fault.step), (1, 1, 10));
        assert!(fault.to_string().contains("drone 1 in step 10: its velocity became non-finite"), "{fault}");
        assert!(sim.data.pos.iter().all(|v| v.is_finite()));
        assert_eq!(sim.data.steps, vec![20, 10, 20]);
        assert_eq!(sim.data.state(0, 0), calm.data.state(0, 0));
        assert_eq!(sim.data.state(2, 1), calm.data.state(2, 1));
        sim.data.disturbance_force[3 * row] = 0.0;
        sim.reset(Some(&[false, true, false])).unwrap();
        assert!(sim.data.quarantine[1].is_none());
    }

    #[test]
    fn stages_run_in_order_and_can_stand_between_the_built_in_ones() {
        use std::sync::{Arc, Mutex};
        let mut sim = state_sim(1, 1);
        let order = Arc::new(Mutex::new(Vec::new()));
        let mark = |name: &'static str| {
            let order = order.clone();
            Box::new(move |data: &mut SimData| order.lock().unwrap().push((name, data.steps[0])))
                as super::super::pipeline::StageFn
        };
        sim.pipeline.prepend("first", mark("first")).unwrap();
        sim.pipeline.insert_after(CONTROLLERS, "between", mark("between")).unwrap();
        sim.pipeline.append("last", mark("last")).unwrap();
        assert_eq!(sim.pipeline.names(), ["first", CONTROLLERS, "between", INTEGRATION, "last"]);
        sim.step(2).unwrap();
        let expected = [("first", 0), ("between", 0), ("last", 1), ("first", 1), ("between", 1), ("last", 2)];
        assert_eq!(*order.lock().unwrap(), expected);
        // A stage between controllers and integration owns the motors.
        let stop: super::super::pipeline::StageFn = Box::new(|data| data.rotor_command.fill(0.0));
        sim.pipeline.replace("between", stop).unwrap();
        let before = sim.data.rotor_vel[0];
        sim.step(50).unwrap();
        assert!(sim.data.rotor_vel[0] < 0.5 * before);
        sim.pipeline.remove("between").unwrap();
        assert!(sim.pipeline.remove("between").unwrap_err().to_string().contains("no stage named"));
        assert!(sim.pipeline.remove(INTEGRATION).unwrap_err().to_string().contains("built in"));
        assert!(sim.pipeline.append("last", Box::new(|_| {})).is_err());
    }

    #[test]
    fn one_step_at_a_time_with_idle_stages_gives_the_bits_of_one_call() {
        let mut plain = randomized(2, 0);
        let mut staged = randomized(2, 0);
        staged.pipeline.insert_after(CONTROLLERS, "idle", Box::new(|_| {})).unwrap();
        plain.step(100).unwrap();
        staged.step(100).unwrap();
        assert_eq!(plain.data, staged.data);
    }

    #[test]
    fn a_stage_that_breaks_an_array_is_an_error_and_no_panic() {
        let mut sim = state_sim(1, 1);
        sim.pipeline.append("bad", Box::new(|data| data.pos.truncate(1))).unwrap();
        let message = sim.step(1).unwrap_err().to_string();
        assert!(message.contains("pos") && message.contains("expected 3 numbers"), "{message}");
    }

    #[test]
    fn a_world_that_flies_too_far_is_named_and_stays_where_it_can_be_placed() {
        fn flown<N: Number>(engine: Engine) -> Sim<N> {
            let options = SimOptions { n_worlds: 3, sim_hz: 500, engine, ..attitude() };
            let mut sim = Sim::<N>::storing(options, vec![(quad(Vec::new()), RATES)]).unwrap();
            let row = sim.data.row(1, 0);
            sim.data.vel[3 * row] = N::of(4e8);
            sim.step(5000).unwrap();
            sim
        }
        fn check<N: Number>(engine: Engine) {
            let sim = flown::<N>(engine);
            let fault = sim.data.quarantine[1].clone().unwrap();
            // 2.5 s at 4e8 m/s.
            assert_eq!((fault.world, fault.drone), (1, 0));
            assert!((1248..=1252).contains(&fault.step) && fault.quantity == TOO_FAR, "{fault:?}");
            assert!(fault.to_string().contains("its position went beyond 1e9 m"), "{fault}");
            let x = sim.data.pos[3 * sim.data.row(1, 0)].wide();
            assert!((9.9e8..=1e9).contains(&x), "{x}");
            assert!(sim.data.quarantine[0].is_none() && sim.data.quarantine[2].is_none());
        }
        check::<f64>(Engine::Reference);
        check::<f64>(Engine::Lanes);
        check::<f32>(Engine::Lanes);
    }

    #[test]
    fn a_stage_that_writes_a_number_that_is_none_sets_its_world_aside_at_once_and_no_other() {
        let mut sim = state_sim(3, 2);
        let command = hover_command(&sim, [0.0, 0.0, 1.0]);
        sim.set_command(&command).unwrap();
        let stage: super::super::pipeline::StageFn = Box::new(|data| {
            if data.steps[1] == 5 {
                let row = data.row(1, 1);
                data.pos[3 * row] = f64::NAN;
            }
        });
        sim.pipeline.append("bad", stage).unwrap();
        // The stage is the last of the last step: nothing after it would notice.
        sim.step(5).unwrap();
        let fault = sim.data.quarantine[1].clone().unwrap();
        assert_eq!((fault.world, fault.drone, fault.step, fault.stage.as_deref()), (1, 1, 5, Some("bad")));
        let message = fault.to_string();
        assert!(
            message.contains("drone 1 in step 5: its position") && message.contains("stage bad"),
            "{message}"
        );
        assert!(sim.data.pos.iter().all(|v| v.is_finite()), "the states before the stage are kept");
        assert!(sim.data.quarantine[0].is_none() && sim.data.quarantine[2].is_none());
        sim.step(5).unwrap();
        assert_eq!(sim.data.steps, vec![10, 5, 10]);
    }

    #[test]
    fn arrays_and_counts_that_were_changed_from_outside_are_errors_and_no_panics() {
        let wash = AnyEffect::BatterySag(Default::default());
        let mut sim = Sim::new(attitude(), vec![(quad(vec![wash]), RATES)]).unwrap();
        sim.data.effect_memory.clear();
        let message = sim.step(1).unwrap_err().to_string();
        assert!(message.contains("effect_memory") && message.contains("expected 1 numbers"), "{message}");
        let mut sim = state_sim(2, 1);
        (sim.data.n_worlds, sim.data.n_drones) = (1, 2);
        assert!(sim.step(1).unwrap_err().to_string().contains("2 worlds × 1 drones"));
        let mut sim = state_sim(1, 1);
        sim.data.pos.truncate(1);
        assert!(sim.step(1).unwrap_err().to_string().contains("pos"));
    }

    #[test]
    fn a_parameter_set_for_one_world_stays_at_a_reset_that_draws_others() {
        let mut sim = randomized(2, 0);
        sim.set_parameter(Some(1), 0, "controller.mass_kg", 0.7).unwrap();
        sim.set_parameter(Some(1), 0, "body.mass_kg", 2.0).unwrap();
        sim.reset(None).unwrap();
        assert_eq!(sim.drone(1, 0).controller.mass_kg, 0.7);
        assert!((1.8..2.2).contains(&sim.drone(1, 0).body.mass_kg), "drawn around what was set");
        assert!((0.9..1.1).contains(&sim.drone(0, 0).body.mass_kg));
        sim.set_parameter(None, 0, "controller.mass_kg", 0.8).unwrap();
        sim.reset(None).unwrap();
        assert_eq!((sim.drone(0, 0).controller.mass_kg, sim.drone(1, 0).controller.mass_kg), (0.8, 0.8));
    }

    #[test]
    fn a_parameter_that_this_drone_has_not_is_refused_and_so_is_a_body_without_mass() {
        let wash = AnyEffect::Downwash(downwash::Params { drag_area_m2: 0.02, spread: 0.1 });
        let drones = vec![(quad(vec![wash]), RATES), (quad(vec![]), RATES)];
        let mut sim = Sim::new(attitude(), drones).unwrap();
        sim.set_parameter(None, 0, "effect.downwash.spread", 0.2).unwrap();
        let message = sim.set_parameter(None, 1, "effect.downwash.spread", 0.2).unwrap_err().to_string();
        assert!(message.contains("drone 1 has no parameter") && message.contains("body.…"), "{message}");
        assert!(sim.set_parameter(None, 0, "initial.pos.0", 1.0).is_err());
        assert!(
            sim.set_parameter(None, 0, "body.inertia_inverse.0.0", 1.0).is_err(),
            "it follows from others"
        );
        assert!(sim.set_parameter(Some(0), 0, "body.mass_kg", 0.0).is_err());
        let rule =
            Rule { parameter: "body.mass_kg".into(), draw: Draw::Uniform([-2.0, -1.0]), shared: false };
        let randomization = Randomization { rules: vec![rule] };
        let options = SimOptions { randomization, ..attitude() };
        let message = Sim::new(options, vec![(quad(vec![]), RATES)]).unwrap_err().to_string();
        assert!(message.contains("body.mass_kg") && message.contains("above 0 kg"), "{message}");
    }

    #[test]
    fn a_reset_that_draws_an_effect_out_of_its_range_is_refused_and_leaves_the_drone_as_it_was() {
        let drag = AnyEffect::by_kind("quadratic_drag").unwrap();
        let made = |seed: u64| {
            let rule = Rule {
                parameter: "effect.quadratic_drag.drag_n_s2_per_m2.0".into(),
                draw: Draw::Uniform([-1.0, 1.0]),
                shared: false,
            };
            let randomization = Randomization { rules: vec![rule] };
            Sim::new(SimOptions { seed, randomization, ..attitude() }, vec![(quad(vec![drag]), RATES)])
        };
        // The first draw may be out of range as well.
        let mut sim = (0..20).find_map(|seed| made(seed).ok()).unwrap();
        for _ in 0..40 {
            let before = sim.drone(0, 0).clone();
            let Err(refused) = sim.reset(None) else { continue };
            let message = refused.to_string();
            assert!(message.contains("effect.quadratic_drag.drag_n_s2_per_m2"), "{message}");
            assert_eq!(*sim.drone(0, 0), before);
            return;
        }
        panic!("no draw of forty was below zero");
    }

    #[test]
    fn controllers_reckon_with_the_gravity_of_their_own_world() {
        let mut sim = state_sim(2, 1);
        sim.set_parameter(Some(1), 0, "body.gravity_m_s2.2", -1.62).unwrap();
        sim.reset(None).unwrap();
        let command = hover_command(&sim, [0.0; 3]);
        sim.set_command(&command).unwrap();
        sim.step(250).unwrap();
        for w in 0..2 {
            assert!(sim.data.state(w, 0).pos[2].abs() < 0.01, "world {w}: {}", sim.data.state(w, 0).pos[2]);
        }
    }

    #[test]
    fn motors_off_means_off_and_a_reset_can_start_at_hover_or_standing_still() {
        let options =
            SimOptions { control: ControlMode::RotorVel, rotor_start: RotorStart::Off, ..attitude() };
        let mut sim = Sim::new(options, vec![(quad(vec![]), RATES)]).unwrap();
        sim.set_command(&[0.0; 4]).unwrap();
        sim.step(100).unwrap();
        assert!(sim.data.rotor_vel.iter().all(|v| *v == 0.0));
        // Free fall: explicit Euler after n steps of h falls g h² n (n − 1) / 2.
        assert!((sim.data.pos[2] + 9.81 * 0.002f64.powi(2) * 100.0 * 99.0 / 2.0).abs() < 1e-12);
        let hover = state_sim(1, 1);
        assert!((hover.data.rotor_vel[0] - (9.81f64 / 4.0 / 1e-5).sqrt()).abs() < 1e-9);
    }

    #[test]
    fn drones_rest_on_the_ground_below_them_where_it_is() {
        let options =
            SimOptions { control: ControlMode::RotorVel, rotor_start: RotorStart::Off, ..attitude() };
        let mut sim = Sim::new(options, vec![(quad(vec![]), RATES)]).unwrap();
        sim.data.ground_z[0] = -2.0;
        sim.pipeline.append("ground", rest_on_ground(0.05)).unwrap();
        sim.step(1000).unwrap();
        assert_eq!((sim.data.pos[2], sim.data.vel[2]), (-1.95, 0.0));
    }

    #[test]
    fn vehicles_of_different_types_share_a_world_and_feel_each_other() {
        let wash = AnyEffect::Downwash(downwash::Params { drag_area_m2: 0.02, spread: 0.1 });
        let mut heavy = quad(vec![]);
        heavy.body.mass_kg = 1.5;
        let options = SimOptions { control: ControlMode::State, ..attitude() };
        let mut sim = Sim::new(options, vec![(quad(vec![wash]), RATES), (heavy, RATES)]).unwrap();
        let up = State { pos: [0.0, 0.0, 1.0], ..State::rest() };
        sim.set_initial(0, 1, up).unwrap();
        sim.reset(None).unwrap();
        let low = Trajectory::Hover { at_m: [0.0; 3] }.at(0.0).command();
        let high = Trajectory::Hover { at_m: [0.0, 0.0, 1.0] }.at(0.0).command();
        sim.set_command(&[low, high].concat()).unwrap();
        sim.step(25).unwrap();
        assert!(sim.data.state(0, 0).vel[2] < -0.005, "the lower one is pushed down");
        assert_ne!(sim.data.rotor_vel[0], sim.data.rotor_vel[4], "each hovers at its own speed");
    }

    #[test]
    fn a_parameter_can_differ_between_worlds() {
        let drag = linear_drag::Params { drag_n_s_per_m: [[0.0; 3]; 3] };
        let wind = constant_wind::Params { velocity_m_s: [4.0, 0.0, 0.0] };
        let drone = quad(vec![AnyEffect::LinearDrag(drag), AnyEffect::ConstantWind(wind)]);
        let options = SimOptions { n_worlds: 2, ..attitude() };
        let mut sim = Sim::new(options, vec![(drone, RATES)]).unwrap();
        sim.set_command(&[0.0, 0.0, 0.0, 9.81, 0.0, 0.0, 0.0, 9.81]).unwrap();
        sim.set_parameter(Some(1), 0, "effect.linear_drag.drag_n_s_per_m.0.0", 0.3).unwrap();
        sim.set_parameter(Some(1), 0, "body.inertia_kg_m2.0.0", 0.02).unwrap();
        assert_eq!(sim.drone(1, 0).body.inertia_inverse[0][0], 50.0);
        sim.step(100).unwrap();
        assert!(sim.data.state(0, 0).vel[0].abs() < 1e-9 && sim.data.state(1, 0).vel[0] > 0.1);
        let message = sim.set_parameter(None, 0, "body.mass", 1.0).unwrap_err().to_string();
        assert!(message.contains("body.mass_kg"), "{message}");
    }

    #[test]
    fn the_two_halves_make_a_step_and_the_rate_is_the_slope_of_it() {
        let (mut whole, mut halves) = (state_sim(1, 2), state_sim(1, 2));
        let command = hover_command(&whole, [0.3, 0.0, 1.0]);
        whole.set_command(&command).unwrap();
        halves.set_command(&command).unwrap();
        for _ in 0..40 {
            whole.step(1).unwrap();
            halves.run_controllers().unwrap();
            let (before, rate) = (halves.data.state(0, 1), halves.rate(0, 1));
            halves.run_integration().unwrap();
            let after = halves.data.state(0, 1);
            for i in 0..3 {
                assert!((after.vel[i] - before.vel[i] - 0.002 * rate.acc[i]).abs() < 1e-15);
            }
        }
        assert_eq!(whole.data, halves.data);
    }

    #[test]
    fn turbulence_is_the_same_for_any_thread_count_and_split_and_another_in_every_world_and_episode() {
        let sim = |n_worlds: usize, first_world: u64| {
            let drag = [[0.3, 0.0, 0.0], [0.0, 0.3, 0.0], [0.0, 0.0, 0.3]];
            let drone = quad(vec![
                AnyEffect::LinearDrag(linear_drag::Params { drag_n_s_per_m: drag }),
                AnyEffect::Turbulence(turbulence::Params { sigma_m_s: [2.0; 3], length_m: [3.0; 3] }),
            ]);
            let options = SimOptions { n_worlds, first_world, seed: 3, ..attitude() };
            let mut sim = Sim::new(options, vec![(drone, RATES); 2]).unwrap();
            sim.set_command(&[0.0, 0.0, 0.0, 9.81].repeat(2 * n_worlds)).unwrap();
            sim
        };
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut sim = sim(16, 0);
                for _ in 0..4 {
                    sim.step(50).unwrap();
                }
                sim.data
            })
        };
        let one = run(1);
        assert_eq!(one, run(4));
        let mut part = sim(4, 12);
        part.step(200).unwrap();
        assert_eq!(part.data.vel, one.vel[12 * 2 * 3..]);
        let speeds: Vec<f64> = one.vel.iter().step_by(3).copied().collect();
        assert!(speeds.iter().all(|v| v.abs() > 1e-9), "{speeds:?}");
        for (i, a) in speeds.iter().enumerate() {
            assert!(speeds[..i].iter().all(|b| a != b), "drone and world {i} fly in the air of others");
        }
        part.reset(None).unwrap();
        part.step(200).unwrap();
        assert_ne!(part.data.vel[0], one.vel[12 * 2 * 3], "the next episode has its own wind");
    }

    #[test]
    fn a_world_with_a_seed_of_its_own_flies_in_the_air_of_the_first_world_of_that_seed() {
        let fly = |n_worlds: usize, engine: Engine, seed: u64, seeds: Vec<u64>| {
            let drag = [[0.3, 0.0, 0.0], [0.0, 0.3, 0.0], [0.0, 0.0, 0.3]];
            let drone = quad(vec![
                AnyEffect::LinearDrag(linear_drag::Params { drag_n_s_per_m: drag }),
                AnyEffect::Turbulence(turbulence::Params { sigma_m_s: [2.0; 3], length_m: [3.0; 3] }),
            ]);
            let rule =
                Rule { parameter: "body.mass_kg".into(), draw: Draw::Scale([0.8, 1.2]), shared: false };
            let randomization = Randomization { rules: vec![rule] };
            let options =
                SimOptions { n_worlds, first_world: 5, seed, seeds, engine, randomization, ..attitude() };
            let mut sim = Sim::<f64>::new(options, vec![(drone, RATES); 2]).unwrap();
            sim.set_command(&[0.0, 0.0, 0.0, 9.81].repeat(2 * n_worlds)).unwrap();
            sim.step(40).unwrap();
            sim
        };
        for engine in [Engine::Reference, Engine::Lanes] {
            // More worlds than lanes, so that some are in other packs.
            let seeds: Vec<u64> = (0..23).map(|w| 100 + w % 11).collect();
            let mut all = fly(23, engine, 3, seeds.clone());
            for (w, seed) in seeds.iter().enumerate() {
                let alone = fly(1, engine, 3, vec![*seed]);
                assert_eq!(all.data.vel[6 * w..6 * w + 6], alone.data.vel, "{engine:?}, world {w}");
            }
            assert_ne!(all.data.vel[..6], all.data.vel[6..12]);
            // The first world of a simulation with that seed, not the fifth.
            let first = fly(1, engine, 3, vec![100]);
            let mut plain = fly(1, engine, 100, Vec::new());
            assert_ne!(first.data.vel, plain.data.vel);
            // Kept, put back, and ended by one seed for all.
            let saved = all.save();
            all.reseed(3);
            assert!(all.options().seeds.is_empty());
            all.restore(&saved).unwrap();
            assert_eq!(all.options().seeds, seeds);
            assert!(matches!(all.reseed_each(&[1, 2]), Err(RolloutError::Length { name: "seeds", .. })));
            plain.reseed_each(&[100]).unwrap();
            plain.reset(None).unwrap();
            plain.step(40).unwrap();
            assert_eq!(plain.data.vel, first.data.vel);
        }
    }

    /// Both round once in a x b + c, and no lane depends on another, so their bits are the same.
    #[test]
    #[cfg(target_arch = "x86_64")]
    fn lanes_give_the_same_bits_by_avx2_as_by_avx512() {
        use fearless_simd::Level;
        use propwash_trace::lanes::{Number, level};
        fn run<N: Number>(control: ControlMode, dynamics: &str, level: Level) -> SimData<N> {
            let vehicle = propwash_vehicle::Vehicle::builtin("cf2x_L250").unwrap();
            let drone = vehicle.drone(dynamics).unwrap();
            let n_worlds = 45;
            let options = SimOptions { n_worlds, control, engine: Engine::Lanes, ..attitude() };
            let one: Vec<f64> = match control {
                ControlMode::State => [&[0.3, -0.2, 0.5][..], &[0.0; 9], &[1.0, 0.0, 0.0, 0.0]].concat(),
                ControlMode::RotorVel => drone.hover_rotor_vel()[..4].to_vec(),
                _ => vec![0.1, -0.05, 0.2, drone.hover_thrust()],
            };
            let mut sim = Sim::<N>::storing(options, vec![(drone, vehicle.rates)]).unwrap();
            sim.lanes.as_mut().expect("an engine of lanes").level = level;
            let commands: Vec<f64> =
                (0..n_worlds).flat_map(|w| one.iter().map(move |v| v * (1.0 + 1e-3 * w as f64))).collect();
            sim.set_command(&commands).unwrap();
            for n in [1, 2, 100] {
                sim.step(n).unwrap();
            }
            sim.data
        }
        let (Some(_), Some(avx2)) = (level().as_avx512(), level().as_avx2()) else {
            eprintln!("skipped: this processor has no AVX-512 to compare AVX2 with");
            return;
        };
        for (dynamics, control) in [
            ("first_principles", ControlMode::RotorVel),
            ("first_principles", ControlMode::Attitude),
            ("first_principles", ControlMode::State),
            ("so_rpy_rotor_drag", ControlMode::Attitude),
        ] {
            let narrow = run::<f32>(control, dynamics, Level::Avx2(avx2));
            assert!(narrow.quarantine.iter().all(Option::is_none));
            assert_eq!(run::<f32>(control, dynamics, level()), narrow, "{dynamics} {control:?} f32");
            let narrow = run::<f64>(control, dynamics, Level::Avx2(avx2));
            assert_eq!(run::<f64>(control, dynamics, level()), narrow, "{dynamics} {control:?} f64");
        }
    }

    /// A mixer that ticks less often than the attitude stage hands its command on from tick to tick.
    #[test]
    fn lanes_keep_what_stages_hand_on_where_these_tick_at_different_rates() {
        let vehicle = propwash_vehicle::Vehicle::builtin("cf2x_L250").unwrap();
        let drone = vehicle.drone("first_principles").unwrap();
        let rates = Rates { force_torque_hz: 250, ..vehicle.rates };
        let run = |engine: Engine, calls: &[usize]| {
            let options = SimOptions { n_worlds: 40, control: ControlMode::Attitude, engine, ..attitude() };
            let mut sim = Sim::new(options, vec![(drone.clone(), rates)]).unwrap();
            let command: Vec<f64> =
                (0..40).flat_map(|w| [0.01 * f64::from(w), -0.1, 0.3, drone.hover_thrust()]).collect();
            sim.set_command(&command).unwrap();
            for n in calls {
                sim.step(*n).unwrap();
            }
            sim.data
        };
        for calls in [&[1][..], &[2], &[3], &[50], &[3, 2, 4]] {
            let (want, got) = (run(Engine::Reference, calls), run(Engine::Lanes, calls));
            for (a, b) in want.controller_memory.iter().zip(&got.controller_memory) {
                assert!((a - b).abs() < 1e-9 * (1.0 + a.abs()), "{calls:?}: {b:e}, not {a:e}");
            }
        }
    }

    /// Commands of both modes have four numbers, but their controllers remember different ones.
    #[test]
    fn data_of_another_control_mode_are_refused() {
        for engine in [Engine::Reference, Engine::Lanes] {
            let of = |control: ControlMode| {
                let options = SimOptions { engine, control, ..attitude() };
                Sim::new(options, vec![(quad(vec![]), RATES)]).unwrap()
            };
            let (mut attitude, rates) = (of(ControlMode::Attitude), of(ControlMode::BodyRate));
            attitude.step(1).unwrap();
            attitude.data = rates.data;
            let message = attitude.step(1).unwrap_err().to_string();
            assert!(message.contains("control mode of data") && message.contains("attitude"), "{message}");
        }
    }

    /// The halves of a step may be called in any order.
    #[test]
    fn lanes_that_began_with_integration_alone_still_control() {
        let run = |engine: Engine| {
            let options = SimOptions { engine, ..attitude() };
            let mut sim = Sim::new(options, vec![(quad(vec![]), RATES)]).unwrap();
            sim.set_command(&[0.1, 0.0, 0.0, 9.81]).unwrap();
            sim.run_integration().unwrap();
            sim.step(20).unwrap();
            sim.data.vel
        };
        let (want, got) = (run(Engine::Reference), run(Engine::Lanes));
        assert!(want.iter().zip(&got).all(|(a, b)| (a - b).abs() < 1e-10), "{got:?}, not {want:?}");
        assert!(want[1].abs() > 1e-4, "{want:?}");
    }

    #[test]
    fn attitudes_that_are_written_into_the_data_become_unit_or_set_their_world_aside() {
        for engine in [Engine::Reference, Engine::Lanes] {
            let options = SimOptions { n_worlds: 3, engine, ..attitude() };
            let mut sim = Sim::new(options, vec![(quad(vec![]), RATES)]).unwrap();
            sim.data.quat[..4].copy_from_slice(&[0.0, 1.5, 0.0, 2.0]);
            sim.data.quat[4..8].copy_from_slice(&[0.0; 4]);
            sim.step(1).unwrap();
            let q = sim.data.state(0, 0).quat;
            let want = [0.0, 0.6, 0.0, 0.8];
            assert!((0..4).all(|i| (q[i] - want[i]).abs() < 1e-9), "{q:?}");
            assert!(sim.data.quarantine[0].is_none() && sim.data.quarantine[2].is_none());
            let set_aside = sim.data.quarantine[1].as_ref().unwrap();
            assert_eq!((set_aside.world, set_aside.quantity.as_str()), (1, "length of the attitude"));
        }
    }

    #[test]
    fn a_delayed_drone_that_starts_in_hover_does_not_dip() {
        let late = AnyEffect::CommandDelay(command_delay::Params { delay_s: 0.05 });
        let mut sim = Sim::new(attitude(), vec![(quad(vec![late]), RATES)]).unwrap();
        sim.set_command(&[0.0, 0.0, 0.0, 9.81]).unwrap();
        sim.step(20).unwrap();
        assert!(sim.data.vel[2].abs() < 1e-9, "{}", sim.data.vel[2]);
        let message =
            sim.set_parameter(None, 0, "effect.command_delay.delay_s", 0.7).unwrap_err().to_string();
        assert!(message.contains("delay_s") && message.contains("0.5"), "{message}");
        assert!(sim.set_parameter(None, 0, "body.inertia_kg_m2.0.1", 0.001).is_err(), "not symmetric");
    }

    #[test]
    fn wrong_input_is_refused_with_what_was_expected() {
        let mut sim = state_sim(2, 1);
        let short = sim.set_command(&[0.0; 16]).unwrap_err().to_string();
        assert!(short.contains("expected 32 numbers (2 worlds × 1 drones × 16)"), "{short}");
        let mut command = vec![0.0; 32];
        command[17] = f64::NAN;
        let nan = sim.set_command(&command).unwrap_err().to_string();
        assert!(nan.contains("world 1, drone 0, entry 1"), "{nan}");
        assert!(sim.reset(Some(&[true])).is_err());
        let none = SimOptions { n_worlds: 0, ..attitude() };
        assert!(Sim::new(none, vec![(quad(vec![]), RATES)]).unwrap_err().to_string().contains("at least 1"));
        let absurd = SimOptions { n_worlds: usize::MAX / 2, ..attitude() };
        assert!(Sim::new(absurd, vec![(quad(vec![]), RATES)]).unwrap_err().to_string().contains("1 TiB"));
        let slow = SimOptions { sim_hz: 50, ..attitude() };
        let message = Sim::new(slow, vec![(quad(vec![]), RATES)]).unwrap_err().to_string();
        assert!(message.contains("attitude_hz") && message.contains("1 to 50 Hz"), "{message}");
        let skewed = State { quat: [0.0, 0.0, 0.0, 2.0], ..State::rest() };
        assert!(sim.set_initial(0, 0, skewed).unwrap_err().to_string().contains("unit quaternion"));
        assert!(sim.set_initial(7, 0, State::rest()).is_err());
    }
}
