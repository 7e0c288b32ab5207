//! Flights under a sequence of commands in one call, and their exact gradients.
//!
//! A [`Tape`] remembers how a recorded flight began and what it was told. [`Tape::pull_back`] takes what a loss gains by the states after the
//! commands to what it gains by everything before: the state at the start, the commands, what disturbs, the wind, parameters by name.
//! Gradients are those of the discrete steps that were flown, through effects and on-board controllers with what both remember, by reverse-mode
//! differentiation of the traced step ([`propwash_trace::adjoint`]). At a limit (a saturated rotor, a clamp) the gradient is that of the
//! side on which the flight is, as of a `select` between both.

mod forward;

use std::sync::{Arc, Mutex, PoisonError};

use super::blocks::Phase;
use super::lanes::{Ask, Commands, Lanes, Looks, Options as LaneOptions};
use super::quarantine::Quarantine;
use super::traced::fixed;
use super::watch::Watcher;
use super::{RolloutError, Sim, SimData, SimOptions};
use propwash_compile::Compile;
use propwash_physics::controllers::Rates;
use propwash_physics::drone::Drone;
use propwash_trace::Real;
use propwash_trace::dual::Dual;
use propwash_trace::lanes::Number;

/// Numbers of a state for vehicles of at most `n_rotors` rotors: position (3), attitude xyzw (4), velocity (3), angular velocity (3), rotor
/// speeds (`n_rotors`), thrust of the abstracted model (1).
pub fn state_width(n_rotors: usize) -> usize {
    14 + n_rotors
}

/// Which parameters the lanes' tables were filled with: counts of changes of vehicles and of single worlds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Version {
    pub vehicles: u64,
    pub worlds: u64,
}

/// Programs that fly sequences of commands and undo them, shared by a simulation and its tapes.
#[derive(Debug)]
pub(super) struct Programs<N: Number> {
    lanes: Lanes<N>,
    filled_for: Option<Version>,
}

impl<N: Number> Programs<N> {
    /// Programs that are compiled then.
    pub fn new(compile: Compile) -> Self {
        Self { lanes: Lanes::new(compile), filled_for: None }
    }

    /// The lanes with the tables of this version.
    fn of(&mut self, version: Version, n_rows: usize) -> &mut Lanes<N> {
        match self.filled_for.replace(version) {
            Some(before) if before == version => {}
            Some(before) if before.vehicles == version.vehicles => {
                (0..n_rows).for_each(|row| self.lanes.forget_row(row));
            }
            _ => self.lanes.forget_tables(),
        }
        &mut self.lanes
    }
}

/// A recorded flight; made by [`Sim::record`].
#[derive(Debug)]
pub struct Tape<N: Number = f64> {
    programs: Arc<Mutex<Programs<N>>>,
    version: Version,
    options: SimOptions,
    nominal: Vec<Drone<f64>>,
    own: Option<Vec<Drone<f64>>>,
    rates: Vec<Rates>,
    start: SimData<N>,
    commands: Vec<N>,
    times: usize,
    substeps: usize,
    states: Vec<N>,
    faults: Vec<Quarantine>,
}

/// One number for everything that a recorded flight began with and was told: what a loss gains by it ([`Tape::pull_back`]), or how far it moves
/// ([`Tape::push_forward`]).
#[derive(Clone, Debug, PartialEq)]
pub struct Partials<N> {
    /// The state at the start, each of its numbers taken for itself, also the four of the attitude. (world, drone, [`state_width`])
    pub state: Vec<N>,
    /// The commands. (world, time, drone, number of a command)
    pub commands: Vec<N>,
    /// The disturbance force, N, world, the same in all steps. (world, drone, 3)
    pub disturbance_force: Vec<N>,
    /// The disturbance torque, N·m, world. (world, drone, 3)
    pub disturbance_torque: Vec<N>,
    /// The velocity of the air, m/s, world. (world, drone, 3)
    pub wind: Vec<N>,
    /// What the on-board controllers remembered at the start, as [`SimData::controller_memory`].
    pub controller_memory: Vec<N>,
    /// What effects remembered at the start, as [`SimData::effect_memory`].
    pub effect_memory: Vec<N>,
    /// Parameters by name, (world, drone) each; zero for drones without it.
    pub parameters: Vec<(String, Vec<N>)>,
}

impl<N> Partials<N> {
    /// That of a parameter, (world, drone); `None` for one that was not asked for.
    pub fn parameter(&self, name: &str) -> Option<&[N]> {
        self.parameters.iter().find(|(known, _)| known == name).map(|(_, gains)| &gains[..])
    }
}

impl<N: Number> Sim<N> {
    /// Flies a sequence of commands, shape (world, time, drone, [`Sim::command_width`]), each in force for `substeps` steps, and returns the
    /// states after each: (world, time, drone, [`state_width`]).
    ///
    /// It does what setting each command and stepping does, in one call: in lanes, and without stages of the user's, all commands are
    /// flown while a few worlds sit in cache. The last command stays in force. A world that turns non-finite stands still from the
    /// command under which it did, as in [`Sim::step`].
    ///
    /// # Errors
    /// [`RolloutError::Length`] for a number of commands that is no multiple of (world, drone, command), [`RolloutError::NotFinite`] and
    /// [`RolloutError::Option`] for bad numbers, and the errors of [`Sim::step`].
    ///
    /// ```
    /// use propwash_rollout::{Sim, SimOptions};
    /// use propwash_physics::controllers::ControlMode;
    /// use propwash_vehicle::Vehicle;
    ///
    /// let vehicle = Vehicle::builtin("cf2x_L250")?;
    /// let drone = vehicle.drone("first_principles")?;
    /// let hover = [0.0, 0.0, 0.0, drone.hover_command()];
    /// let options = SimOptions { control: ControlMode::Attitude, ..SimOptions::default() };
    /// let mut sim = Sim::<f64>::storing(options, vec![(drone, vehicle.rates)])?;
    /// // 25 commands of 10 steps each, in one world with one drone.
    /// let mut tape = sim.record(&hover.repeat(25), 10)?;
    /// let states = tape.states();
    /// assert_eq!(states.len(), 25 * tape.state_width());
    /// // What the last height gains by the thrust of each command.
    /// let mut seeds = vec![0.0; states.len()];
    /// seeds[24 * tape.state_width() + 2] = 1.0;
    /// let gains = tape.pull_back(&seeds, &["body.mass_kg"])?;
    /// assert!(gains.commands[3] > gains.commands[4 * 23 + 3]);
    /// assert!(gains.parameter("body.mass_kg").unwrap()[0] < 0.0);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn rollout(&mut self, commands: &[N], substeps: usize) -> Result<Vec<N>, RolloutError> {
        self.fly(commands, substeps, Looks { watcher: None, keep: true })
    }

    /// As [`Sim::rollout`], while `watcher` sees the states after each command, in the threads and while the numbers sit in cache. They are
    /// returned only where `keep` says so; else the list is empty, and nothing of their size is allocated.
    ///
    /// # Errors
    /// Those of [`Sim::rollout`].
    pub fn rollout_watched(
        &mut self,
        commands: &[N],
        substeps: usize,
        watcher: &dyn Watcher<N>,
        keep: bool,
    ) -> Result<Vec<N>, RolloutError> {
        let states = self.fly(commands, substeps, Looks { watcher: Some(watcher), keep })?;
        Ok(if keep { states } else { Vec::new() })
    }

    /// The states of all commands, or of the last alone.
    fn fly(&mut self, commands: &[N], substeps: usize, looks: Looks<N>) -> Result<Vec<N>, RolloutError> {
        let times = self.times_of(commands, substeps)?;
        let per_time = self.data.n_drones * state_width(self.data.n_rotors);
        let per_world = per_time * if looks.keep { times } else { 1 };
        let mut states = vec![N::zero(); self.data.n_worlds * per_world];
        if self.in_lanes() && self.pipeline.is_plain() {
            self.check_data()?;
            self.mend_attitudes();
            let sequence = Commands { numbers: commands, times, substeps };
            let extra = vec![(&mut states[..], per_world)];
            self.run_lanes((times * substeps, Phase::Both), &Ask::Record(sequence, looks), extra);
            self.data.take_command(commands, times - 1);
            return Ok(states);
        }
        for t in 0..times {
            self.data.take_command(commands, t);
            self.step(substeps)?;
            self.data.give_states(&mut states, if looks.keep { t } else { 0 });
            if let Some(watcher) = looks.watcher {
                self.data.show(&states, t, watcher);
            }
        }
        Ok(states)
    }

    /// As [`Sim::rollout`], and remembers the flight, so that gradients can be taken of it.
    ///
    /// The simulation goes on from the end of the flight. The tape is independent of it.
    ///
    /// # Errors
    /// Those of [`Sim::rollout`]; [`RolloutError::Gradient`] for a simulation with stages of the user's, whose slopes are unknown.
    pub fn record(&mut self, commands: &[N], substeps: usize) -> Result<Tape<N>, RolloutError> {
        self.check_slopes()?;
        let times = self.times_of(commands, substeps)?;
        self.check_data()?;
        self.mend_attitudes();
        let start = self.data.clone();
        let states = self.rollout(commands, substeps)?;
        let faults = self.data.quarantine.iter().flatten().map(|fault| (**fault).clone()).collect();
        Ok(Tape {
            programs: Arc::clone(&self.programs),
            version: self.version,
            options: self.options.clone(),
            nominal: self.nominal.clone(),
            own: self.own.clone(),
            rates: self.rates.clone(),
            start,
            commands: commands.to_vec(),
            times,
            substeps,
            states,
            faults,
        })
    }

    /// Refuses steps whose slopes are unknown.
    pub(super) fn check_slopes(&self) -> Result<(), RolloutError> {
        if !self.pipeline.is_plain() {
            let names: Vec<&str> = self.pipeline.user_names();
            return Err(RolloutError::Gradient {
                what: format!("steps with stages written as code ({})", names.join(", ")),
                remedy: "take them out of the pipeline, or write them as effects (expressions have slopes)"
                    .into(),
            });
        }
        Ok(())
    }

    /// Number of commands in a sequence for all drones.
    ///
    /// # Errors
    /// Those of [`Sim::rollout`] for what it is given.
    pub fn times_of(&self, commands: &[N], substeps: usize) -> Result<usize, RolloutError> {
        let (worlds, drones, width) = (self.data.n_worlds, self.data.n_drones, self.data.command_width);
        let each = worlds * drones * width;
        let times = commands.len() / each.max(1);
        if times == 0 || times * each != commands.len() {
            return Err(RolloutError::Length {
                name: "commands",
                expected: times.max(1) * each,
                shape: format!("{worlds} worlds × times × {drones} drones × {width}, at least one time"),
                got: commands.len(),
            });
        }
        if substeps == 0 {
            return Err(RolloutError::Option {
                name: "substeps",
                expected: "at least one step under each command".into(),
                got: "0".into(),
            });
        }
        if let Some(i) = not_finite(commands) {
            return Err(RolloutError::NotFinite {
                name: "commands",
                world: i / (each / worlds * times),
                drone: i / width % drones,
                entry: i % width,
                got: commands[i].wide(),
            });
        }
        Ok(times)
    }
}

impl<N: Number> Tape<N> {
    /// States after each command, (world, time, drone, [`state_width`]); empty once they were taken.
    pub fn states(&self) -> &[N] {
        &self.states
    }

    /// Hands the states over, which gradients do not need.
    pub fn take_states(&mut self) -> Vec<N> {
        std::mem::take(&mut self.states)
    }

    /// Numbers of a state.
    pub fn state_width(&self) -> usize {
        state_width(self.start.n_rotors)
    }

    /// Number of worlds, of commands, of drones, and of numbers of a command.
    pub fn shape(&self) -> [usize; 4] {
        [self.start.n_worlds, self.times, self.start.n_drones, self.start.command_width]
    }

    /// What the flight began with.
    pub fn start(&self) -> &SimData<N> {
        &self.start
    }

    /// Worlds that turned non-finite, or stood still when the recording began.
    pub fn faults(&self) -> &[Quarantine] {
        &self.faults
    }

    /// Takes what a loss gains by the states after each command, (world, time, drone, [`Tape::state_width`]), to what it gains by
    /// everything before, with gains by `parameters`, of the names of [`Drone::visit`].
    ///
    /// It flies the worlds again, a few at a time, and keeps what it undoes in between: its memory does not grow with the number of worlds,
    /// and with the root of the number of steps.
    ///
    /// # Errors
    /// [`RolloutError::Length`] and [`RolloutError::NotFinite`] for bad seeds, [`RolloutError::NoParameter`] for a name that no drone has;
    /// [`RolloutError::Gradient`] for a seed of a world that stood still, for gains that are not finite, and for parameters that
    /// other drones feel (downwash of a mass).
    pub fn pull_back(&mut self, seeds: &[N], parameters: &[&str]) -> Result<Partials<N>, RolloutError> {
        self.check_seeds(seeds)?;
        let chains = self.chains(parameters)?;
        let wanted: Vec<Vec<usize>> = chains.iter().map(|c| c.fixed.clone()).collect();
        let most = wanted.iter().map(Vec::len).max().unwrap_or(0);
        let data = &mut self.start;
        let (worlds, drones) = (data.n_worlds, data.n_drones);
        let rows = worlds * drones;
        let (width, memory) = (state_width(data.n_rotors), data.controller_memory.len() / rows);
        let effects = data.effect_memory.len() / worlds;
        let own = [
            drones * width,
            self.times * drones * data.command_width,
            drones * 3,
            drones * 3,
            drones * 3,
            drones * memory,
            effects,
            drones * most,
        ];
        let mut arrays = own.map(|per_world| vec![N::zero(); worlds * per_world]);
        let extra = arrays.iter_mut().zip(own).map(|(array, n)| (&mut array[..], n)).collect();
        // Steps that turned non-finite cannot be undone; nothing is wanted of them.
        let mut faulty = vec![None; worlds];
        for fault in &self.faults {
            faulty[(fault.world - self.options.first_world) as usize] = Some(Box::new(fault.clone()));
        }
        data.quarantine = faulty;
        let sequence = Commands { numbers: &self.commands, times: self.times, substeps: self.substeps };
        let options = lane_options(&self.options, Phase::Both, self.times * self.substeps);
        let mut programs = self.programs.lock().unwrap_or_else(PoisonError::into_inner);
        let lanes = programs.of(self.version, rows);
        let vehicles = (&self.nominal[..], self.own.as_deref());
        let ask = Ask::Sweep(sequence, seeds, &wanted);
        lanes.run(&options, &self.options.seeds, vehicles, &self.rates, (data, &ask, extra));
        drop(programs);
        let [
            state,
            commands,
            disturbance_force,
            disturbance_torque,
            wind,
            controller_memory,
            effect_memory,
            by_fixed,
        ] = arrays;
        let parameters = self.named(parameters, &chains, &by_fixed, most);
        let gains = Partials {
            state,
            commands,
            disturbance_force,
            disturbance_torque,
            wind,
            controller_memory,
            effect_memory,
            parameters,
        };
        self.check_gains(&gains)?;
        Ok(gains)
    }

    /// The last state's slopes by the state at the start, (world, drone, n, n) with n = [`Tape::state_width`], and by the first command, (world,
    /// drone, n, number of a command): `A` and `B` of x' = A x + B u about a recorded flight under one command. What controllers and effects
    /// remember is held as it was.
    ///
    /// # Errors
    /// [`RolloutError::Gradient`] for drones that feel each other, for worlds that stood still, and as [`Tape::pull_back`].
    pub fn linearize(&mut self) -> Result<(Vec<N>, Vec<N>), RolloutError> {
        let [worlds, times, drones, command] = self.shape();
        if drones > 1 && self.nominal.iter().any(|d| d.reads().neighbours) {
            return Err(RolloutError::Gradient {
                what: "one drone alone: effects let drones feel each other".into(),
                remedy: "linearise a simulation of one drone, or without that effect".into(),
            });
        }
        let (width, rows) = (self.state_width(), worlds * drones);
        let mut by_state = vec![N::zero(); rows * width * width];
        let mut by_command = vec![N::zero(); rows * width * command];
        let mut seeds = vec![N::zero(); self.n_seeds()];
        for col in 0..width {
            let last =
                |row: usize| ((row / drones * times + times - 1) * drones + row % drones) * width + col;
            (0..rows).for_each(|row| seeds[last(row)] = N::one());
            let gains = self.pull_back(&seeds, &[])?;
            for row in 0..rows {
                seeds[last(row)] = N::zero();
                let to = (row * width + col) * width;
                by_state[to..to + width].copy_from_slice(&gains.state[row * width..][..width]);
                let (to, from) =
                    ((row * width + col) * command, (row / drones * times * drones + row % drones) * command);
                by_command[to..to + command].copy_from_slice(&gains.commands[from..][..command]);
            }
        }
        Ok((by_state, by_command))
    }

    /// All zero, with these parameters: what a direction for [`Tape::push_forward`] begins as.
    pub fn zero(&self, parameters: &[&str]) -> Partials<N> {
        let [worlds, _, drones, _] = self.shape();
        let rows = worlds * drones;
        let zeros = |n: usize| vec![N::zero(); n];
        Partials {
            state: zeros(rows * self.state_width()),
            commands: zeros(self.commands.len()),
            disturbance_force: zeros(rows * 3),
            disturbance_torque: zeros(rows * 3),
            wind: zeros(rows * 3),
            controller_memory: zeros(self.start.controller_memory.len()),
            effect_memory: zeros(self.start.effect_memory.len()),
            parameters: parameters.iter().map(|name| (name.to_string(), zeros(rows))).collect(),
        }
    }

    /// Numbers of all states.
    fn n_seeds(&self) -> usize {
        let [worlds, times, drones, _] = self.shape();
        worlds * times * drones * self.state_width()
    }

    fn check_seeds(&self, seeds: &[N]) -> Result<(), RolloutError> {
        let [worlds, times, drones, _] = self.shape();
        let width = self.state_width();
        if seeds.len() != self.n_seeds() {
            return Err(RolloutError::Length {
                name: "seeds",
                expected: self.n_seeds(),
                shape: format!("{worlds} worlds × {times} times × {drones} drones × {width}, as the states"),
                got: seeds.len(),
            });
        }
        if let Some(i) = not_finite(seeds) {
            return Err(RolloutError::NotFinite {
                name: "seeds",
                world: i / (times * drones * width),
                drone: i / width % drones,
                entry: i % width,
                got: seeds[i].wide(),
            });
        }
        for fault in &self.faults {
            let w = (fault.world - self.options.first_world) as usize;
            if seeds[w * times * drones * width..][..times * drones * width].iter().any(|v| *v != N::zero()) {
                return Err(RolloutError::Gradient {
                    what: format!(
                        "a flight that stood still: world {}, drone {}, whose {} was not finite in step {}",
                        fault.world, fault.drone, fault.quantity, fault.step
                    ),
                    remedy: "give that world seeds of zero, or keep it from flying away (gentler commands, a shorter flight)"
                        .into(),
                });
            }
        }
        Ok(())
    }

    fn check_gains(&self, gains: &Partials<N>) -> Result<(), RolloutError> {
        let worlds = self.start.n_worlds;
        let of = |name: &str, list: &[N]| {
            let bad = not_finite(list)?;
            Some((name.to_string(), bad / (list.len() / worlds)))
        };
        let lists = [
            ("state at the start", &gains.state),
            ("commands", &gains.commands),
            ("disturbance force", &gains.disturbance_force),
            ("disturbance torque", &gains.disturbance_torque),
            ("wind", &gains.wind),
            ("controllers' memory", &gains.controller_memory),
            ("effects' memory", &gains.effect_memory),
        ];
        let lists = lists.into_iter().map(|(name, list)| (name, &list[..]));
        let named = gains.parameters.iter().map(|(name, list)| (&name[..], &list[..]));
        match lists.chain(named).find_map(|(name, list)| of(name, list)) {
            None => Ok(()),
            Some((name, world)) => Err(RolloutError::Gradient {
                what: format!(
                    "by {name} of world {world}: it is not finite, the flight is too long or too steep for {}",
                    N::NAME
                ),
                remedy: "use a shorter flight, smaller seeds, or f64".into(),
            }),
        }
    }

    /// Refuses names that no drone has.
    fn check_names(&self, names: &[&str]) -> Result<(), RolloutError> {
        for name in names {
            let mut found = false;
            for drone in &self.nominal {
                drone.clone().visit(&mut |known, _| found |= known == *name);
            }
            if !found {
                return Err(no_parameter(&self.nominal[0], name));
            }
        }
        Ok(())
    }

    /// What follows of the named parameters, for each drone slot.
    fn chains(&self, names: &[&str]) -> Result<Vec<Chain>, RolloutError> {
        self.check_names(names)?;
        for name in names {
            let near = self.nominal.len() > 1 && self.nominal.iter().any(|d| d.reads().neighbours);
            if near && self.nominal.iter().any(|drone| felt_by_others(drone, name)) {
                return Err(RolloutError::Gradient {
                    what: format!("by {name}, which other drones feel through what they read of each other"),
                    remedy: "ask for it in a simulation of one drone, or without that effect".into(),
                });
            }
        }
        let chain = |(drone, rates): (&Drone<f64>, &Rates)| {
            let slopes: Vec<Vec<f64>> =
                names.iter().map(|name| slopes(drone, rates, self.options.sim_hz, name)).collect();
            let n = slopes.first().map_or(0, Vec::len);
            Chain { fixed: (0..n).filter(|k| slopes.iter().any(|list| list[*k] != 0.0)).collect() }
        };
        Ok(self.nominal.iter().zip(&self.rates).map(chain).collect())
    }

    /// Gains by named parameters, of those by the fixed numbers of steps.
    fn named(&self, names: &[&str], chains: &[Chain], by_fixed: &[N], most: usize) -> Vec<(String, Vec<N>)> {
        let drones = self.nominal.len();
        let rows = self.start.n_worlds * drones;
        let of_row = |name: &str, row: usize| {
            let slot = row % drones;
            let drone = self.own.as_ref().map_or(&self.nominal[slot], |own| &own[row]);
            let slopes = slopes(drone, &self.rates[slot], self.options.sim_hz, name);
            let gains = by_fixed[row * most..].iter().zip(&chains[slot].fixed);
            N::of(gains.map(|(gain, k)| gain.wide() * slopes[*k]).sum())
        };
        let list = |name: &&str| (name.to_string(), (0..rows).map(|row| of_row(name, row)).collect());
        names.iter().map(list).collect()
    }
}

/// Which fixed numbers of the steps of a drone change with the parameters that are asked for.
#[derive(Debug)]
struct Chain {
    fixed: Vec<usize>,
}

type Slope = Dual<f64, 1>;

/// A drone over duals with one parameter seeded, what follows from it computed anew.
fn seeded(drone: &Drone<f64>, name: &str) -> Drone<Slope> {
    let mut drone = drone.map(&mut Slope::lit);
    drone.visit(&mut |known, value| {
        if known == name {
            *value = Slope::input(value.value, 0);
        }
    });
    drone.refresh();
    drone
}

/// Slopes of the fixed numbers of a step by a parameter.
fn slopes(drone: &Drone<f64>, rates: &Rates, sim_hz: u32, name: &str) -> Vec<f64> {
    let mut out = Vec::new();
    seeded(drone, name).map(&mut |v| {
        out.push(v.partials[0]);
        v
    });
    out.resize(fixed(drone, rates, sim_hz).len(), 0.0);
    out
}

/// Whether other drones feel a parameter: through the weight and the size that they read.
fn felt_by_others(drone: &Drone<f64>, name: &str) -> bool {
    let drone = seeded(drone, name);
    drone.hover_thrust().partials[0] != 0.0 || drone.disc_radius_m().partials[0] != 0.0
}

fn no_parameter(drone: &Drone<f64>, name: &str) -> RolloutError {
    let close = super::sim::close_names(&mut drone.clone(), name);
    RolloutError::NoParameter { drone: 0, name: name.into(), close }
}

/// The first number that is not finite; nearly always there is none, which sums without a branch tell quickest.
fn not_finite<N: Number>(list: &[N]) -> Option<usize> {
    let clean = list.iter().fold(N::zero(), |sum, v| sum + *v * N::zero());
    if clean == N::zero() { None } else { list.iter().position(|v| !v.finite()) }
}

/// What a call in lanes is told.
pub(super) fn lane_options(options: &SimOptions, phase: Phase, n_steps: usize) -> LaneOptions {
    LaneOptions {
        mode: options.control,
        integrator: options.integrator,
        sim_hz: options.sim_hz,
        seed: options.seed,
        first_world: options.first_world,
        phase,
        n_steps,
    }
}
