//! The public arrays of a simulation.

use super::RolloutError;
use super::quarantine::Quarantine;
use crate::physics::controllers::{COMMAND_WIDTH, Memory};
use crate::physics::rigid_body::{MAX_ROTORS, State};

/// Everything that changes while a simulation runs, in plain arrays of shape (world, drone, n).
///
/// Stages of the pipeline read and write it between steps.
#[derive(Clone, Debug, PartialEq)]
pub struct SimData {
    /// Number of worlds.
    pub n_worlds: usize,
    /// Drones per world.
    pub n_drones: usize,
    /// Steps per second.
    pub sim_hz: u32,
    /// Position, m, world frame. (world, drone, 3)
    pub pos: Vec<f64>,
    /// Attitude xyzw, body to world. (world, drone, 4)
    pub quat: Vec<f64>,
    /// Velocity, m/s, world frame. (world, drone, 3)
    pub vel: Vec<f64>,
    /// Angular velocity, rad/s, body frame. (world, drone, 3)
    pub ang_vel: Vec<f64>,
    /// Rotor speeds, rad/s. (world, drone, 8)
    pub rotor_vel: Vec<f64>,
    /// Collective thrust state of the abstracted model, N. (world, drone)
    pub thrust: Vec<f64>,
    /// Commands, in the units of the control mode; entries past its width are unused. (world, drone, 16)
    pub command: Vec<f64>,
    /// Rotor speeds that the controllers ask for, rad/s. (world, drone, 8)
    pub rotor_command: Vec<f64>,
    /// Attitude command in force: roll, pitch, yaw (rad), thrust (N). (world, drone, 4)
    pub attitude_command: Vec<f64>,
    /// Disturbance force, N, world frame. (world, drone, 3)
    pub disturbance_force: Vec<f64>,
    /// Disturbance torque, N·m, world frame. (world, drone, 3)
    pub disturbance_torque: Vec<f64>,
    /// Velocity of the air, m/s, world frame. (world, drone, 3)
    pub wind: Vec<f64>,
    /// Height of the ground below each drone, m, world frame; −∞ where there is none. (world, drone)
    pub ground_z: Vec<f64>,
    /// Height of the ceiling above each drone, m, world frame; ∞ where there is none. The caller fills it; scenes do not.
    /// (world, drone)
    pub ceiling_z: Vec<f64>,
    /// Steps since the last reset. (world)
    pub steps: Vec<u64>,
    /// Episodes begun so far: resets, the first included. (world)
    pub episodes: Vec<u64>,
    /// Worlds that turned non-finite and stand still. (world)
    pub quarantine: Vec<Option<Quarantine>>,
    /// What the on-board controllers remember. (world, drone, [`Memory::LEN`])
    pub controller_memory: Vec<f64>,
    /// What effects remember, for each drone slot: (world, memory of that drone's effects)
    pub effect_memory: Vec<Vec<f64>>,
}

impl SimData {
    /// All drones at rest at the origin; `effect_memory_len` per drone slot.
    pub(super) fn new(n_worlds: usize, effect_memory_len: &[usize], sim_hz: u32) -> Self {
        let n_drones = effect_memory_len.len();
        let n = n_worlds * n_drones;
        let mut quat = vec![0.0; n * 4];
        for q in quat.chunks_exact_mut(4) {
            q[3] = 1.0;
        }
        Self {
            n_worlds,
            n_drones,
            sim_hz,
            pos: vec![0.0; n * 3],
            quat,
            vel: vec![0.0; n * 3],
            ang_vel: vec![0.0; n * 3],
            rotor_vel: vec![0.0; n * MAX_ROTORS],
            thrust: vec![0.0; n],
            command: vec![0.0; n * COMMAND_WIDTH],
            rotor_command: vec![0.0; n * MAX_ROTORS],
            attitude_command: vec![0.0; n * 4],
            disturbance_force: vec![0.0; n * 3],
            disturbance_torque: vec![0.0; n * 3],
            wind: vec![0.0; n * 3],
            ground_z: vec![f64::NEG_INFINITY; n],
            ceiling_z: vec![f64::INFINITY; n],
            steps: vec![0; n_worlds],
            episodes: vec![0; n_worlds],
            quarantine: vec![None; n_worlds],
            controller_memory: vec![0.0; n * Memory::<f64>::LEN],
            effect_memory: effect_memory_len.iter().map(|len| vec![0.0; len * n_worlds]).collect(),
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

    /// Refuses arrays whose length was changed; `effect_memory_len` per drone slot.
    pub(super) fn check_lengths(&self, effect_memory_len: &[usize]) -> Result<(), RolloutError> {
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
        let effects: Vec<usize> = self.effect_memory.iter().map(Vec::len).collect();
        let wanted: Vec<usize> = effect_memory_len.iter().map(|len| len * self.n_worlds).collect();
        if effects != wanted {
            return Err(RolloutError::Length {
                name: "effect_memory",
                expected: wanted.iter().sum(),
                shape: format!("{} drones, {} worlds each", self.n_drones, self.n_worlds),
                got: effects.iter().sum(),
            });
        }
        Ok(())
    }

    /// State of one drone.
    pub fn state(&self, world: usize, drone: usize) -> State<f64> {
        let r = self.row(world, drone);
        let three = |a: &[f64]| [a[3 * r], a[3 * r + 1], a[3 * r + 2]];
        State {
            pos: three(&self.pos),
            quat: [self.quat[4 * r], self.quat[4 * r + 1], self.quat[4 * r + 2], self.quat[4 * r + 3]],
            vel: three(&self.vel),
            ang_vel: three(&self.ang_vel),
            rotor_vel: core::array::from_fn(|i| self.rotor_vel[MAX_ROTORS * r + i]),
            thrust: self.thrust[r],
        }
    }

    /// Sets the state of one drone.
    pub fn set_state(&mut self, world: usize, drone: usize, state: &State<f64>) {
        let r = self.row(world, drone);
        self.pos[3 * r..3 * r + 3].copy_from_slice(&state.pos);
        self.quat[4 * r..4 * r + 4].copy_from_slice(&state.quat);
        self.vel[3 * r..3 * r + 3].copy_from_slice(&state.vel);
        self.ang_vel[3 * r..3 * r + 3].copy_from_slice(&state.ang_vel);
        self.rotor_vel[MAX_ROTORS * r..MAX_ROTORS * (r + 1)].copy_from_slice(&state.rotor_vel);
        self.thrust[r] = state.thrust;
    }
}
