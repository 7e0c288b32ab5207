//! The public arrays of a simulation.

use super::RolloutError;
use super::quarantine::Quarantine;
use crate::physics::controllers::{COMMAND_WIDTH, Memory};
use crate::physics::rigid_body::{MAX_ROTORS, State};
use crate::scalar::lanes::Number;

/// Everything that changes while a simulation runs, in plain arrays of shape (world, drone, n).
///
/// Stages of the pipeline read and write it between steps. `N` is the number that is stored, f64 or f32.
#[derive(Clone, Debug, PartialEq)]
pub struct SimData<N = f64> {
    /// Number of worlds.
    pub n_worlds: usize,
    /// Drones per world.
    pub n_drones: usize,
    /// Steps per second.
    pub sim_hz: u32,
    /// Position, m, world frame. (world, drone, 3)
    pub pos: Vec<N>,
    /// Attitude xyzw, body to world. (world, drone, 4)
    pub quat: Vec<N>,
    /// Velocity, m/s, world frame. (world, drone, 3)
    pub vel: Vec<N>,
    /// Angular velocity, rad/s, body frame. (world, drone, 3)
    pub ang_vel: Vec<N>,
    /// Rotor speeds, rad/s. (world, drone, 8)
    pub rotor_vel: Vec<N>,
    /// Collective thrust state of the abstracted model, N. (world, drone)
    pub thrust: Vec<N>,
    /// Commands, in the units of the control mode; entries past its width are unused. (world, drone, 16)
    pub command: Vec<N>,
    /// Rotor speeds that the controllers ask for, rad/s. (world, drone, 8)
    pub rotor_command: Vec<N>,
    /// Attitude command in force: roll, pitch, yaw (rad), thrust (N). (world, drone, 4)
    pub attitude_command: Vec<N>,
    /// Disturbance force, N, world frame. (world, drone, 3)
    pub disturbance_force: Vec<N>,
    /// Disturbance torque, N·m, world frame. (world, drone, 3)
    pub disturbance_torque: Vec<N>,
    /// Velocity of the air, m/s, world frame. (world, drone, 3)
    pub wind: Vec<N>,
    /// Height of the ground below each drone, m, world frame; −∞ where there is none. (world, drone)
    pub ground_z: Vec<N>,
    /// Height of the ceiling above each drone, m, world frame; ∞ where there is none. The caller fills it; scenes do not.
    /// (world, drone)
    pub ceiling_z: Vec<N>,
    /// Steps since the last reset. (world)
    pub steps: Vec<u64>,
    /// Episodes begun so far: resets, the first included. (world)
    pub episodes: Vec<u64>,
    /// Worlds that turned non-finite and stand still. (world)
    pub quarantine: Vec<Option<Quarantine>>,
    /// What the on-board controllers remember. (world, drone, [`Memory::LEN`])
    pub controller_memory: Vec<N>,
    /// What effects remember: (world, memory of the effects of every drone in order)
    pub effect_memory: Vec<N>,
}

impl<N: Number> SimData<N> {
    /// All drones at rest at the origin; `effect_memory_len` per drone slot.
    pub(super) fn new(n_worlds: usize, effect_memory_len: &[usize], sim_hz: u32) -> Self {
        let n_drones = effect_memory_len.len();
        let n = n_worlds * n_drones;
        let zeros = |len: usize| vec![N::zero(); len];
        let mut quat = zeros(n * 4);
        for q in quat.chunks_exact_mut(4) {
            q[3] = N::one();
        }
        Self {
            n_worlds,
            n_drones,
            sim_hz,
            pos: zeros(n * 3),
            quat,
            vel: zeros(n * 3),
            ang_vel: zeros(n * 3),
            rotor_vel: zeros(n * MAX_ROTORS),
            thrust: zeros(n),
            command: zeros(n * COMMAND_WIDTH),
            rotor_command: zeros(n * MAX_ROTORS),
            attitude_command: zeros(n * 4),
            disturbance_force: zeros(n * 3),
            disturbance_torque: zeros(n * 3),
            wind: zeros(n * 3),
            ground_z: vec![N::of(f64::NEG_INFINITY); n],
            ceiling_z: vec![N::of(f64::INFINITY); n],
            steps: vec![0; n_worlds],
            episodes: vec![0; n_worlds],
            quarantine: vec![None; n_worlds],
            controller_memory: zeros(n * Memory::<f64>::LEN),
            effect_memory: zeros(effect_memory_len.iter().sum::<usize>() * n_worlds),
        }
    }

    /// Row of (world, drone) in arrays of shape (world, drone, n).
    #[inline(always)]
    pub fn row(&self, world: usize, drone: usize) -> usize {
        world * self.n_drones + drone
    }

    /// Seconds since the last reset of `world`.
    pub fn time_s(&self, world: usize) -> f64 {
        self.steps[world] as f64 / f64::from(self.sim_hz)
    }

    /// Refuses arrays whose length was changed; effects remember `per_world` numbers in each world.
    pub(super) fn check_lengths(&self, per_world: usize) -> Result<(), RolloutError> {
        let n = self.n_worlds * self.n_drones;
        for (name, got, width) in [
            ("pos", self.pos.len(), 3),
            ("quat", self.quat.len(), 4),
            ("vel", self.vel.len(), 3),
            ("ang_vel", self.ang_vel.len(), 3),
            ("rotor_vel", self.rotor_vel.len(), MAX_ROTORS),
            ("thrust", self.thrust.len(), 1),
            ("command", self.command.len(), COMMAND_WIDTH),
            ("rotor_command", self.rotor_command.len(), MAX_ROTORS),
            ("attitude_command", self.attitude_command.len(), 4),
            ("disturbance_force", self.disturbance_force.len(), 3),
            ("disturbance_torque", self.disturbance_torque.len(), 3),
            ("wind", self.wind.len(), 3),
            ("ground_z", self.ground_z.len(), 1),
            ("ceiling_z", self.ceiling_z.len(), 1),
            ("controller_memory", self.controller_memory.len(), Memory::<f64>::LEN),
        ] {
            if got != n * width {
                let shape = format!("{} worlds × {} drones × {width}", self.n_worlds, self.n_drones);
                return Err(RolloutError::Length { name, expected: n * width, shape, got });
            }
        }
        for (name, got) in [
            ("steps", self.steps.len()),
            ("episodes", self.episodes.len()),
            ("quarantine", self.quarantine.len()),
        ] {
            if got != self.n_worlds {
                let shape = format!("{} worlds", self.n_worlds);
                return Err(RolloutError::Length { name, expected: self.n_worlds, shape, got });
            }
        }
        if self.effect_memory.len() != per_world * self.n_worlds {
            return Err(RolloutError::Length {
                name: "effect_memory",
                expected: per_world * self.n_worlds,
                shape: format!("{} worlds × {per_world}", self.n_worlds),
                got: self.effect_memory.len(),
            });
        }
        Ok(())
    }

    /// State of one drone.
    pub fn state(&self, world: usize, drone: usize) -> State<f64> {
        let r = self.row(world, drone);
        let at = |a: &[N], n: usize, i: usize| a[n * r + i].wide();
        State {
            pos: core::array::from_fn(|i| at(&self.pos, 3, i)),
            quat: core::array::from_fn(|i| at(&self.quat, 4, i)),
            vel: core::array::from_fn(|i| at(&self.vel, 3, i)),
            ang_vel: core::array::from_fn(|i| at(&self.ang_vel, 3, i)),
            rotor_vel: core::array::from_fn(|i| at(&self.rotor_vel, MAX_ROTORS, i)),
            thrust: at(&self.thrust, 1, 0),
        }
    }

    /// Sets the state of one drone.
    pub fn set_state(&mut self, world: usize, drone: usize, state: &State<f64>) {
        let r = self.row(world, drone);
        let put = |a: &mut [N], numbers: &[f64]| {
            let n = numbers.len();
            for (i, v) in numbers.iter().enumerate() {
                a[n * r + i] = N::of(*v);
            }
        };
        put(&mut self.pos, &state.pos);
        put(&mut self.quat, &state.quat);
        put(&mut self.vel, &state.vel);
        put(&mut self.ang_vel, &state.ang_vel);
        put(&mut self.rotor_vel, &state.rotor_vel);
        put(&mut self.thrust, &[state.thrust]);
    }
}
