//! One world as the equations see it, and the step that advances it: in f64 the reference, over symbols what lanes are traced
//! from.

use super::quarantine::{MAX_POSITION_M, Quarantine, TOO_FAR};
use crate::random::{Key, purpose, step_normals};
use propwash_physics::controllers::{COMMAND_WIDTH, ControlMode, Due, Memory, Rates, mellinger};
use propwash_physics::drone::{Drone, Dynamics};
use propwash_physics::effects::Command;
use propwash_physics::integrate::Integrator;
use propwash_physics::rigid_body::{MAX_ROTORS, Rate, State};
use propwash_physics::surroundings::{
    AIR_DENSITY_KG_M3, Load, NO_CEILING_M, NO_GROUND_M, Neighbour, Remembered, Surroundings,
};
use propwash_trace::Real;

/// What is the same for all blocks during one call.
#[derive(Clone, Debug)]
pub(super) struct Plan {
    pub mode: ControlMode,
    pub integrator: Integrator,
    pub sim_hz: u32,
    pub rates: Vec<Rates>,
    /// Periods of the same.
    pub periods: Vec<mellinger::Periods<f64>>,
    pub reads_neighbours: bool,
    /// Per drone slot: whether an effect reads random numbers.
    pub reads_noise: Vec<bool>,
}

/// Names the random numbers of a world.
#[derive(Clone, Debug)]
pub(super) struct Source {
    /// Seed and number of the world, as random numbers are named by them.
    pub origin: (u64, u64),
    /// Episodes begun.
    pub episodes: u64,
}

impl Source {
    /// Standard normal numbers of one drone in one step, which effects may read.
    pub fn normals(&self, drone: usize, step: u64) -> [f64; 6] {
        let (key, episode) = self.named(drone, step);
        let key = Key { step: key.step ^ episode, ..key };
        let blocks = [0, 1].map(|block| step_normals(key, block));
        core::array::from_fn(|i| {
            let (block, k) = place_of(i);
            f64::from(blocks[block as usize][k])
        })
    }

    /// What they are named by: key, and what the number of the episode sets in that of the step. Episodes count from the top bits down, so that steps of two
    /// episodes never share a number.
    pub fn named(&self, drone: usize, step: u64) -> (Key, u64) {
        const PURPOSE: u32 = purpose("effects.normals");
        let (seed, world) = self.origin;
        let key = Key { seed, world, drone: drone as u32, step, purpose: PURPOSE };
        (key, self.episodes.rotate_left(40))
    }
}

/// Where number `i` of [`Source::normals`] stands: three of the four of a block, since what reads one most often reads the other two.
pub(super) fn place_of(i: usize) -> (u32, usize) {
    ((i / 3) as u32, i % 3)
}

/// Which part of a step to run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Phase {
    Controllers,
    Integration,
    Both,
}

/// Time (s), standard normal random numbers and the other drones, in one step.
pub(super) type Around<'a, S> = (S, [S; 6], &'a [Neighbour<S>]);

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

/// Periods of the on-board controllers, s.
pub(super) fn periods(rates: &Rates) -> mellinger::Periods<f64> {
    let period = |hz: u32| 1.0 / f64::from(hz);
    mellinger::Periods {
        state: period(rates.state_hz),
        attitude: period(rates.attitude_hz),
        body_rate: period(rates.body_rate_hz),
    }
}

impl<S: Real> Slot<S> {
    /// The same over another number type.
    pub fn map<T: Real>(&self, f: &mut dyn FnMut(S) -> T) -> Slot<T> {
        let State { pos, quat, vel, ang_vel, rotor_vel, thrust } = self.state;
        let mut memory = Vec::new();
        self.memory.store(|_, v| memory.push(f(v)));
        Slot {
            state: State {
                pos: pos.map(&mut *f),
                quat: quat.map(&mut *f),
                vel: vel.map(&mut *f),
                ang_vel: ang_vel.map(&mut *f),
                rotor_vel: rotor_vel.map(&mut *f),
                thrust: f(thrust),
            },
            command: self.command.map(&mut *f),
            memory: Memory::load(|i| memory[i]),
            rotor_command: self.rotor_command.map(&mut *f),
            attitude_command: self.attitude_command.map(&mut *f),
            disturbance_force: self.disturbance_force.map(&mut *f),
            disturbance_torque: self.disturbance_torque.map(&mut *f),
            wind: self.wind.map(&mut *f),
            ground_z: f(self.ground_z),
            ceiling_z: f(self.ceiling_z),
            effect_memory: self.effect_memory.iter().map(|v| f(*v)).collect(),
        }
    }

    /// The on-board controllers, as far as they tick in this step, or the effect that takes their place, which runs in every step.
    pub fn control(
        &mut self,
        drone: &Drone<S>,
        (mode, due, periods): (ControlMode, Due, &mellinger::Periods<S>),
        dt_s: (S, f64),
        around: Around<S>,
    ) {
        let gravity = drone.body.gravity_m_s2;
        let controller = &drone.controller;
        if drone.controls_itself() {
            let told = self.command;
            let surroundings = self.surroundings(&told, around);
            match drone.own_command(&self.state, &surroundings, dt_s, &mut self.effect_memory) {
                Some(Command::Rotors(speeds)) => {
                    self.rotor_command = speeds;
                    mellinger::limit_rotor_vel(controller, &mut self.rotor_command);
                }
                Some(Command::Attitude([roll, pitch, yaw, thrust])) => {
                    self.attitude_command = [roll, pitch, yaw, mellinger::limit_thrust(controller, thrust)];
                }
                None => {}
            }
            return;
        }
        mellinger::run(controller, gravity, mode, due, periods, &self.state, &self.command, &mut self.memory);
        self.rotor_command = self.memory.rotor_cmd;
        // What the mixer stage commands in this step is within these limits.
        if mode == ControlMode::RotorVel || !due.force_torque {
            mellinger::limit_rotor_vel(controller, &mut self.rotor_command);
        }
        self.attitude_command = self.memory.attitude_cmd;
        self.attitude_command[3] = mellinger::limit_thrust(controller, self.attitude_command[3]);
    }

    /// Surroundings in this step, under these commands.
    pub(super) fn surroundings<'a>(
        &self,
        command: &'a [S],
        (time_s, normals, neighbours): Around<'a, S>,
    ) -> Surroundings<'a, S> {
        Surroundings {
            time_s,
            air_density_kg_m3: S::lit(AIR_DENSITY_KG_M3),
            wind_m_s: self.wind,
            ground_distance_m: ground_distance(&self.state, self.ground_z),
            ceiling_distance_m: ceiling_distance(&self.state, self.ceiling_z),
            disturbance_force_n: self.disturbance_force,
            disturbance_torque_n_m: self.disturbance_torque,
            battery_v: S::zero(),
            neighbours,
            load: Load::absent(),
            command,
            normals,
            memory: Remembered { numbers: &[], step_s: 0.0 },
        }
    }

    /// The command in force.
    fn command(&self, drone: &Drone<S>) -> Command<S> {
        match drone.dynamics {
            Dynamics::Rotors => Command::Rotors(self.rotor_command),
            Dynamics::AttitudeResponse(_) => Command::Attitude(self.attitude_command),
        }
    }

    /// State after a step of `dt_s`; only the memory of effects changes.
    pub fn moved(
        &mut self,
        drone: &Drone<S>,
        integrator: Integrator,
        dt_s: (S, f64),
        around: Around<S>,
    ) -> State<S> {
        let mut command = self.command(drone);
        let told = self.command;
        let mut surroundings = self.surroundings(&told, around);
        drone.transmit(&self.state, &mut surroundings, dt_s, &mut command, &mut self.effect_memory);
        surroundings.memory = Remembered { numbers: &self.effect_memory, step_s: dt_s.1 };
        integrator.step(&self.state, dt_s.0, |s| {
            surroundings.ground_distance_m = ground_distance(s, self.ground_z);
            surroundings.ceiling_distance_m = ceiling_distance(s, self.ceiling_z);
            drone.rate(s, &command, &surroundings)
        })
    }
}

/// One world, all its drones.
#[derive(Clone, Debug)]
pub(super) struct Block {
    pub step: u64,
    pub slots: Vec<Slot<f64>>,
    pub source: Source,
    next: Vec<State<f64>>,
    neighbours: Vec<Neighbour<f64>>,
}

impl Block {
    pub fn new(step: u64, slots: Vec<Slot<f64>>, source: Source) -> Self {
        let next = slots.iter().map(|s| s.state).collect();
        Self { step, neighbours: Vec::with_capacity(slots.len()), slots, source, next }
    }

    /// Advances the world by `n_steps`, or until it turns non-finite: then the step is undone and its place returned.
    pub fn advance(
        &mut self,
        plan: &Plan,
        drones: &[&Drone<f64>],
        n_steps: usize,
        phase: Phase,
    ) -> Option<Quarantine> {
        let dt = 1.0 / f64::from(plan.sim_hz);
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
    fn control(&mut self, plan: &Plan, drones: &[&Drone<f64>]) {
        for d in 0..self.slots.len() {
            // Nobody moves before all have been controlled, so that it does not matter in which order.
            let due = plan.rates[d].due(plan.mode, self.step, plan.sim_hz);
            self.control_one(plan, drones, d, due);
        }
    }

    /// Those of slot `d`, of which these stages tick.
    pub fn control_one(&mut self, plan: &Plan, drones: &[&Drone<f64>], d: usize, due: Due) {
        let dt = 1.0 / f64::from(plan.sim_hz);
        self.fill_neighbours(plan, drones, d);
        let (time_s, normals) = (self.time_s(plan), self.normals(plan, d));
        let around = (time_s, normals, &self.neighbours[..]);
        self.slots[d].control(drones[d], (plan.mode, due, &plan.periods[d]), (dt, dt), around);
    }

    /// The other drones of slot `d`, where some effect reads them.
    fn fill_neighbours(&mut self, plan: &Plan, drones: &[&Drone<f64>], d: usize) {
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

    fn time_s(&self, plan: &Plan) -> f64 {
        self.step as f64 / f64::from(plan.sim_hz)
    }

    fn normals(&self, plan: &Plan, d: usize) -> [f64; 6] {
        if plan.reads_noise[d] { self.source.normals(d, self.step) } else { [0.0; 6] }
    }

    /// Surroundings of slot `d` in this step; `neighbours` must be filled.
    fn surroundings<'a>(&'a self, plan: &Plan, d: usize) -> Surroundings<'a, f64> {
        let around = (self.time_s(plan), self.normals(plan, d), &self.neighbours[..]);
        self.slots[d].surroundings(&self.slots[d].command, around)
    }

    /// The same with what effects remember of the last step: gusts, a load on a cable.
    fn surroundings_now<'a>(&'a self, plan: &Plan, drone: &Drone<f64>, d: usize) -> Surroundings<'a, f64> {
        let (mut around, step_s) = (self.surroundings(plan, d), 1.0 / f64::from(plan.sim_hz));
        let numbers = &self.slots[d].effect_memory[..];
        drone.recall(numbers, step_s, &mut around);
        around.memory = Remembered { numbers, step_s };
        around
    }

    /// Time derivative of slot `d` under the command in force.
    pub fn rate(&mut self, plan: &Plan, drones: &[&Drone<f64>], d: usize) -> Rate<f64> {
        self.fill_neighbours(plan, drones, d);
        let command = self.slots[d].command(drones[d]);
        drones[d].rate(&self.slots[d].state, &command, &self.surroundings_now(plan, drones[d], d))
    }

    /// Velocity of the air at slot `d`, m/s, world, with what effects add.
    pub fn wind_m_s(&mut self, plan: &Plan, drones: &[&Drone<f64>], d: usize) -> [f64; 3] {
        self.fill_neighbours(plan, drones, d);
        let command = self.slots[d].command(drones[d]);
        drones[d].wind_m_s(&self.slots[d].state, &command, &self.surroundings_now(plan, drones[d], d))
    }

    /// Voltage of the battery of slot `d` in the step to come, V; `None` without one.
    pub fn battery_v(&mut self, plan: &Plan, drones: &[&Drone<f64>], d: usize) -> Option<f64> {
        self.fill_neighbours(plan, drones, d);
        let dt = 1.0 / f64::from(plan.sim_hz);
        let mut command = self.slots[d].command(drones[d]);
        let mut memory = self.slots[d].effect_memory.clone();
        let state = &self.slots[d].state;
        drones[d].battery_v(state, &self.surroundings(plan, d), (dt, dt), &mut command, &mut memory)
    }

    /// All drones from the same instant to the next. On a non-finite result nothing changes.
    fn integrate(&mut self, plan: &Plan, drones: &[&Drone<f64>], dt: f64) -> Option<(usize, &'static str)> {
        for d in 0..self.slots.len() {
            self.fill_neighbours(plan, drones, d);
            let (time_s, normals) = (self.time_s(plan), self.normals(plan, d));
            let around = (time_s, normals, &self.neighbours[..]);
            self.next[d] = self.slots[d].moved(drones[d], plan.integrator, (dt, dt), around);
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

/// The first quantity of a state that is not finite, or a position beyond [`MAX_POSITION_M`].
pub(super) fn non_finite(state: &State<f64>) -> Option<&'static str> {
    let bad = |numbers: &[f64]| numbers.iter().any(|v| !v.is_finite());
    // Nearly every state is good, which comparisons without a branch tell quickest.
    let within = |numbers: &[f64], most: f64| numbers.iter().fold(true, |all, v| all & (v.abs() <= most));
    let State { pos, quat, vel, ang_vel, rotor_vel, thrust } = state;
    let finite = |numbers: &[f64]| within(numbers, f64::MAX);
    if within(pos, MAX_POSITION_M)
        & finite(quat)
        & finite(vel)
        & finite(ang_vel)
        & finite(rotor_vel)
        & finite(&[*thrust])
    {
        return None;
    }
    [
        ("position", bad(&state.pos)),
        (TOO_FAR, state.pos.iter().any(|v| v.abs() > MAX_POSITION_M)),
        ("attitude", bad(&state.quat)),
        ("velocity", bad(&state.vel)),
        ("angular velocity", bad(&state.ang_vel)),
        ("rotor speed", bad(&state.rotor_vel)),
        ("thrust", bad(&[state.thrust])),
    ]
    .into_iter()
    .find_map(|(name, is_bad)| is_bad.then_some(name))
}
