//! The worlds of a simulation as the equations see them, without its stages, so that several threads can ask at once.

use super::blocks::{Block, Plan, Slot, Source, periods};
use super::data::wide;
use super::{SimData, SimOptions};
use propwash_physics::controllers::Rates;
use propwash_physics::drone::Drone;
use propwash_physics::measure::Reading;
use propwash_physics::rigid_body::Rate;
use propwash_physics::surroundings::{Reads, Surroundings};
use propwash_physics::{airframe, attitude_response};
use propwash_trace::lanes::Number;

/// One world of a simulation, read once, to be asked about its drones.
pub struct WorldEquations<'a, N: Number> {
    sim: Equations<'a, N>,
    world: usize,
    plan: Plan,
    drones: Vec<&'a Drone<f64>>,
    block: Block,
}

impl<N: Number> WorldEquations<'_, N> {
    /// As [`Sim::rate`](super::Sim::rate).
    pub fn rate(&mut self, drone: usize) -> Rate<f64> {
        self.block.rate(&self.plan, &self.drones, drone)
    }

    /// As [`Equations::reading`].
    pub fn reading(&mut self, drone: usize) -> Reading<f64> {
        let rate = self.rate(drone);
        self.drones[drone].read(&self.sim.data.state(self.world, drone), &rate)
    }

    /// As [`Sim::wind_m_s`](super::Sim::wind_m_s).
    pub fn wind_m_s(&mut self, drone: usize) -> [f64; 3] {
        self.block.wind_m_s(&self.plan, &self.drones, drone)
    }

    /// As [`Sim::battery_v`](super::Sim::battery_v).
    pub fn battery_v(&mut self, drone: usize) -> Option<f64> {
        self.block.battery_v(&self.plan, &self.drones, drone)
    }
}

/// Vehicles, options and arrays of a simulation, to be read.
#[derive(Clone, Copy)]
pub struct Equations<'a, N: Number> {
    pub(super) options: &'a SimOptions,
    pub(super) nominal: &'a [Drone<f64>],
    /// Where the memory of the effects of each drone begins in that of a world, and where the last one ends.
    pub(super) effect_at: &'a [usize],
    pub(super) own: Option<&'a [Drone<f64>]>,
    pub(super) rates: &'a [Rates],
    pub(super) data: &'a SimData<N>,
}

impl<'a, N: Number> Equations<'a, N> {
    /// The options of the simulation.
    pub fn options(&self) -> &'a SimOptions {
        self.options
    }

    /// The arrays of the simulation.
    pub fn data(&self) -> &'a SimData<N> {
        self.data
    }

    /// As [`Sim::drone`](super::Sim::drone).
    pub fn drone(&self, world: usize, drone: usize) -> &'a Drone<f64> {
        match self.own {
            Some(own) => &own[world * self.nominal.len() + drone],
            None => &self.nominal[drone],
        }
    }

    /// All drones of a world.
    pub(super) fn drones(&self, world: usize) -> Vec<&'a Drone<f64>> {
        (0..self.nominal.len()).map(|d| self.drone(world, d)).collect()
    }

    /// As [`Sim::rate`](super::Sim::rate).
    pub fn rate(&self, world: usize, drone: usize) -> Rate<f64> {
        self.of_world(world).rate(drone)
    }

    /// What the sensors of a drone read now, as its effects let them, without noise.
    pub fn reading(&self, world: usize, drone: usize) -> Reading<f64> {
        self.of_world(world).reading(drone)
    }

    /// As [`Sim::wind_m_s`](super::Sim::wind_m_s).
    pub fn wind_m_s(&self, world: usize, drone: usize) -> [f64; 3] {
        self.of_world(world).wind_m_s(drone)
    }

    /// As [`Sim::battery_v`](super::Sim::battery_v).
    pub fn battery_v(&self, world: usize, drone: usize) -> Option<f64> {
        self.of_world(world).battery_v(drone)
    }

    /// As [`Sim::load_m`](super::Sim::load_m).
    pub fn load_m(&self, world: usize, drone: usize) -> Option<[f64; 3]> {
        let numbers: Vec<f64> =
            self.data.effect_memory[self.effect_memory_of(world, drone)].iter().map(|v| v.wide()).collect();
        let mut around = Surroundings::calm();
        self.drone(world, drone).recall(&numbers, 1.0 / f64::from(self.options.sim_hz), &mut around);
        (around.load.present > 0.0).then_some(around.load.position_m)
    }

    /// As [`Sim::thrust_n`](super::Sim::thrust_n).
    pub fn thrust_n(&self, world: usize, drone: usize) -> f64 {
        let parts = self.drone(world, drone).parts();
        let s = self.data.state(world, drone);
        match &parts.response {
            None => airframe::loads(&parts.airframe, &s.rotor_vel).thrust.iter().sum(),
            Some(p) => {
                let command = self.data.attitude_command[4 * self.data.row(world, drone) + 3].wide();
                attitude_response::thrust(p, s.thrust, command)
            }
        }
    }

    /// What is the same for all worlds.
    pub(super) fn plan(&self) -> Plan {
        let reads: Vec<Reads> = self.nominal.iter().map(Drone::reads).collect();
        Plan {
            mode: self.options.control,
            integrator: self.options.integrator,
            sim_hz: self.options.sim_hz,
            rates: self.rates.to_vec(),
            periods: self.rates.iter().map(periods).collect(),
            reads_neighbours: reads.len() > 1 && reads.iter().any(|r| r.neighbours),
            reads_noise: reads.iter().map(|r| r.noise).collect(),
        }
    }

    /// Where the memory of the effects of one drone stands.
    pub(super) fn effect_memory_of(&self, w: usize, d: usize) -> std::ops::Range<usize> {
        let first = w * self.effect_at[self.nominal.len()];
        first + self.effect_at[d]..first + self.effect_at[d + 1]
    }

    /// One world, to be asked about many of its drones: it is read once.
    pub fn of_world(&self, world: usize) -> WorldEquations<'a, N> {
        WorldEquations {
            sim: *self,
            world,
            plan: self.plan(),
            drones: self.drones(world),
            block: self.load(world),
        }
    }

    /// World `w` as the equations see it.
    pub(super) fn load(&self, w: usize) -> Block {
        let data = self.data;
        let slots = (0..self.nominal.len())
            .map(|d| {
                let row = w * self.nominal.len() + d;
                let at = |a: &[N], n: usize, i: usize| a[row * n + i].wide();
                let effects = &data.effect_memory[self.effect_memory_of(w, d)];
                Slot {
                    state: data.state(w, d),
                    command: wide(&data.command, data.command_width, row),
                    memory: data.memory(w, d),
                    rotor_command: wide(&data.rotor_command, data.n_rotors, row),
                    attitude_command: core::array::from_fn(|i| at(&data.attitude_command, 4, i)),
                    disturbance_force: core::array::from_fn(|i| at(&data.disturbance_force, 3, i)),
                    disturbance_torque: core::array::from_fn(|i| at(&data.disturbance_torque, 3, i)),
                    wind: core::array::from_fn(|i| at(&data.wind, 3, i)),
                    ground_z: at(&data.ground_z, 1, 0),
                    ceiling_z: at(&data.ceiling_z, 1, 0),
                    effect_memory: effects.iter().map(|v| v.wide()).collect(),
                }
            })
            .collect();
        let source = Source { origin: self.options.origin(w), episodes: data.episodes[w] };
        Block::new(data.steps[w], slots, source)
    }
}
