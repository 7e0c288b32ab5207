//! Blocks of worlds as the equations see them, and the step that advances one.

use super::quarantine::Quarantine;
use crate::physics::controllers::{COMMAND_WIDTH, ControlMode, Memory, Rates, mellinger};
use crate::physics::drone::{Drone, Dynamics};
use crate::physics::effects::Command;
use crate::physics::integrate::Integrator;
use crate::physics::rigid_body::{MAX_ROTORS, Rate, State};
use crate::physics::surroundings::{
    AIR_DENSITY_KG_M3, Load, NO_CEILING_M, NO_GROUND_M, Neighbour, Surroundings,
};
use crate::random::{Key, purpose};
use crate::scalar::Real;

/// A number type that holds one number for each of several worlds.
pub(super) trait Pack: Real {
    /// Worlds in one number.
    const WIDTH: usize;
    /// `get(lane)` of every lane.
    fn gather(get: impl FnMut(usize) -> f64) -> Self;
    /// Number of one lane.
    fn lane(self, lane: usize) -> f64;
}

impl Pack for f64 {
    const WIDTH: usize = 1;
    #[inline(always)]
    fn gather(mut get: impl FnMut(usize) -> f64) -> Self {
        get(0)
    }
    #[inline(always)]
    fn lane(self, _: usize) -> f64 {
        self
    }
}

/// What is the same for all blocks during one call.
#[derive(Clone, Debug)]
pub(super) struct Plan {
    pub mode: ControlMode,
    pub integrator: Integrator,
    pub sim_hz: u32,
    pub rates: Vec<Rates>,
    pub reads_neighbours: bool,
    /// Per drone slot: whether an effect wants random numbers.
    pub noises: Vec<bool>,
    pub seed: u64,
}

/// Purposes of the random numbers that effects may read.
const NORMALS: [u32; 3] =
    [purpose("effects.normal.0"), purpose("effects.normal.1"), purpose("effects.normal.2")];

/// Names the random numbers of a block.
#[derive(Clone, Debug)]
pub(super) struct Source {
    /// First world, counted over the whole run.
    pub world: u64,
    /// Episodes begun, per lane.
    pub episodes: Vec<u64>,
}

impl Source {
    /// Standard normal numbers of one drone in one step.
    fn normals<S: Pack>(&self, seed: u64, drone: usize, step: u64) -> [S; 3] {
        core::array::from_fn(|i| {
            S::gather(|lane| {
                // Episodes count from the top bits down, so that steps of two episodes never share a number.
                let step = self.episodes[lane].rotate_left(40) ^ step;
                let world = self.world + lane as u64;
                Key { seed, world, drone: drone as u32, step, purpose: NORMALS[i] }.stream().normal()
            })
        })
    }
}

/// Which part of a step to run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Phase {
    Controllers,
    Integration,
    Both,
}

/// One drone slot of a block.
#[derive(Clone, Debug)]
pub(super) struct Slot<S> {
    pub state: State<S>,
    pub command: [S; COMMAND_WIDTH],
    pub memory: Memory<S>,
    pub rotor_command: [S; MAX_ROTORS],
    pub attitude_command: [S; 4],
    pub disturbance_force: [S; 3],
    pub disturbance_torque: [S; 3],
    pub wind: [S; 3],
    pub ground_z: S,
    pub ceiling_z: S,
    pub effect_memory: Vec<S>,
}

/// Some worlds, all their drones.
#[derive(Clone, Debug)]
pub(super) struct Block<S> {
    pub step: u64,
    pub slots: Vec<Slot<S>>,
    source: Source,
    next: Vec<State<S>>,
    neighbours: Vec<Neighbour<S>>,
}

impl<S: Pack> Block<S> {
    pub fn new(step: u64, slots: Vec<Slot<S>>, source: Source) -> Self {
        let next = slots.iter().map(|s| s.state).collect();
        Self { step, neighbours: Vec::with_capacity(slots.len()), slots, source, next }
    }

    /// Advances the block by `n_steps`, or until a lane turns non-finite: then the step is undone and its place returned.
    pub fn advance(
        &mut self,
        plan: &Plan,
        drones: &[&Drone<S>],
        n_steps: usize,
        phase: Phase,
    ) -> Option<Quarantine> {
        let dt = S::lit(1.0) / S::lit(f64::from(plan.sim_hz));
        for _ in 0..n_steps {
            if phase != Phase::Integration {
                self.control(plan, drones);
            }
            if phase != Phase::Controllers {
                if let Some((drone, quantity)) = self.integrate(plan, drones, dt) {
                    let (step, quantity) = (self.step, quantity.into());
                    return Some(Quarantine { world: 0, drone, step, quantity, stage: None });
                }
                self.step += 1;
            }
        }
        None
    }

    /// The on-board controllers, as far as they tick in this step.
    fn control(&mut self, plan: &Plan, drones: &[&Drone<S>]) {
        for (d, slot) in self.slots.iter_mut().enumerate() {
            let rates = &plan.rates[d];
            let due = rates.due(plan.mode, self.step, plan.sim_hz);
            let period = |hz: u32| S::lit(1.0) / S::lit(f64::from(hz));
            let periods = mellinger::Periods {
                state: period(rates.state_hz),
                attitude: period(rates.attitude_hz),
                body_rate: period(rates.body_rate_hz),
            };
            let gravity = drones[d].body.gravity_m_s2;
            let controller = &drones[d].controller;
            mellinger::run(
                controller,
                gravity,
                plan.mode,
                due,
                &periods,
                &slot.state,
                &slot.command,
                &mut slot.memory,
            );
            slot.rotor_command = slot.memory.rotor_cmd;
            mellinger::limit_rotor_vel(controller, &mut slot.rotor_command);
            slot.attitude_command = slot.memory.attitude_cmd;
            slot.attitude_command[3] = mellinger::limit_thrust(controller, slot.attitude_command[3]);
        }
    }

    /// The other drones of slot `d`, where some effect reads them.
    fn fill_neighbours(&mut self, plan: &Plan, drones: &[&Drone<S>], d: usize) {
        self.neighbours.clear();
        if !plan.reads_neighbours {
            return;
        }
        for (other, slot) in self.slots.iter().enumerate() {
            if other != d {
                self.neighbours.push(Neighbour {
                    pos: slot.state.pos,
                    vel: slot.state.vel,
                    weight_n: drones[other].hover_thrust(),
                    disc_radius_m: drones[other].disc_radius_m(),
                });
            }
        }
    }

    /// Surroundings of slot `d` in this step; `neighbours` must be filled.
    fn surroundings<'a>(&'a self, plan: &Plan, d: usize) -> Surroundings<'a, S> {
        let slot = &self.slots[d];
        Surroundings {
            time_s: S::lit(self.step as f64 / f64::from(plan.sim_hz)),
            air_density_kg_m3: S::lit(AIR_DENSITY_KG_M3),
            wind_m_s: slot.wind,
            ground_distance_m: ground_distance(&slot.state, slot.ground_z),
            ceiling_distance_m: ceiling_distance(&slot.state, slot.ceiling_z),
            disturbance_force_n: slot.disturbance_force,
            disturbance_torque_n_m: slot.disturbance_torque,
            neighbours: &self.neighbours,
            load: Load::absent(),
            normals: if plan.noises[d] {
                self.source.normals(plan.seed, d, self.step)
            } else {
                [S::zero(); 3]
            },
        }
    }

    /// The command in force of slot `d`.
    fn command(&self, drone: &Drone<S>, d: usize) -> Command<S> {
        match drone.dynamics {
            Dynamics::Rotors => Command::Rotors(self.slots[d].rotor_command),
            Dynamics::AttitudeResponse(_) => Command::Attitude(self.slots[d].attitude_command),
        }
    }

    /// Time derivative of slot `d` under the command in force.
    pub fn rate(&mut self, plan: &Plan, drones: &[&Drone<S>], d: usize) -> Rate<S> {
        self.fill_neighbours(plan, drones, d);
        let command = self.command(drones[d], d);
        drones[d].rate(&self.slots[d].state, &command, &self.surroundings(plan, d))
    }

    /// Velocity of the air at slot `d`, m/s, world, with what effects add.
    pub fn wind_m_s(&mut self, plan: &Plan, drones: &[&Drone<S>], d: usize) -> [S; 3] {
        self.fill_neighbours(plan, drones, d);
        let command = self.command(drones[d], d);
        drones[d].wind_m_s(&self.slots[d].state, &command, &self.surroundings(plan, d))
    }

    /// Voltage of the battery of slot `d` in the step to come, V; `None` without one.
    pub fn battery_v(&mut self, plan: &Plan, drones: &[&Drone<S>], d: usize) -> Option<S> {
        self.fill_neighbours(plan, drones, d);
        let dt_f64 = 1.0 / f64::from(plan.sim_hz);
        let dt = S::lit(1.0) / S::lit(f64::from(plan.sim_hz));
        let mut command = self.command(drones[d], d);
        let mut memory = self.slots[d].effect_memory.clone();
        let state = &self.slots[d].state;
        drones[d].battery_v(state, &self.surroundings(plan, d), (dt, dt_f64), &mut command, &mut memory)
    }

    /// All drones from the same instant to the next. On a non-finite result nothing changes.
    fn integrate(&mut self, plan: &Plan, drones: &[&Drone<S>], dt: S) -> Option<(usize, &'static str)> {
        let dt_f64 = 1.0 / f64::from(plan.sim_hz);
        for d in 0..self.slots.len() {
            self.fill_neighbours(plan, drones, d);
            let drone = drones[d];
            let mut command = self.command(drone, d);
            let mut memory = core::mem::take(&mut self.slots[d].effect_memory);
            let mut surroundings = self.surroundings(plan, d);
            let slot = &self.slots[d];
            drone.transmit(&slot.state, &mut surroundings, (dt, dt_f64), &mut command, &mut memory);
            let next = plan.integrator.step(&slot.state, dt, |s| {
                surroundings.ground_distance_m = ground_distance(s, slot.ground_z);
                surroundings.ceiling_distance_m = ceiling_distance(s, slot.ceiling_z);
                drone.rate(s, &command, &surroundings)
            });
            self.slots[d].effect_memory = memory;
            self.next[d] = next;
        }
        for (d, next) in self.next.iter().enumerate() {
            if let Some(quantity) = non_finite(next) {
                return Some((d, quantity));
            }
        }
        for (slot, next) in self.slots.iter_mut().zip(&self.next) {
            slot.state = *next;
        }
        None
    }
}

/// Height over the ground, m, held at [`NO_GROUND_M`].
#[inline(always)]
fn ground_distance<S: Real>(state: &State<S>, ground_z: S) -> S {
    (state.pos[2] - ground_z).min(S::lit(NO_GROUND_M))
}

/// Distance to the ceiling, m, held at [`NO_CEILING_M`].
#[inline(always)]
fn ceiling_distance<S: Real>(state: &State<S>, ceiling_z: S) -> S {
    (ceiling_z - state.pos[2]).min(S::lit(NO_CEILING_M))
}

/// The first quantity of a state with a lane that is not finite.
pub(super) fn non_finite<S: Pack>(state: &State<S>) -> Option<&'static str> {
    let bad = |numbers: &[S]| numbers.iter().any(|v| (0..S::WIDTH).any(|lane| !v.lane(lane).is_finite()));
    [
        ("position", bad(&state.pos)),
        ("attitude", bad(&state.quat)),
        ("velocity", bad(&state.vel)),
        ("angular velocity", bad(&state.ang_vel)),
        ("rotor speed", bad(&state.rotor_vel)),
        ("thrust", bad(&[state.thrust])),
    ]
    .into_iter()
    .find_map(|(name, is_bad)| is_bad.then_some(name))
}
