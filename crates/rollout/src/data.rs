//! The public arrays of a simulation.

use super::RolloutError;
use super::quarantine::Quarantine;
use super::state::spread;
use super::watch::{Watched, Watcher};
use propwash_physics::controllers::{ControlMode, Memory};
use propwash_physics::rigid_body::State;
use propwash_trace::lanes::Number;

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
    /// Rotors of the drone with most.
    pub n_rotors: usize,
    /// Numbers of a command in the control mode.
    pub command_width: usize,
    /// Position, m, world frame. (world, drone, 3)
    pub pos: Vec<N>,
    /// Attitude xyzw, body to world. (world, drone, 4)
    pub quat: Vec<N>,
    /// Velocity, m/s, world frame. (world, drone, 3)
    pub vel: Vec<N>,
    /// Angular velocity, rad/s, body frame. (world, drone, 3)
    pub ang_vel: Vec<N>,
    /// Rotor speeds, rad/s; zero past a drone's own rotors. (world, drone, n_rotors)
    pub rotor_vel: Vec<N>,
    /// Collective thrust state of the abstracted model, N. (world, drone)
    pub thrust: Vec<N>,
    /// Commands, in the units of the control mode. (world, drone, command_width)
    pub command: Vec<N>,
    /// Rotor speeds that the controllers ask for, rad/s. (world, drone, n_rotors)
    pub rotor_command: Vec<N>,
    /// Attitude command in force: roll, pitch, yaw (rad), thrust (N). (world, drone, 4)
    pub attitude_command: Vec<N>,
    /// Disturbance force, N, world frame. (world, drone, 3)
    pub disturbance_force: Vec<N>,
    /// Disturbance torque, N·m, world frame. (world, drone, 3)
    pub disturbance_torque: Vec<N>,
    /// Velocity of the air, m/s, world frame. (world, drone, 3)
    pub wind: Vec<N>,
    /// Height of the ground below each drone, m, world frame; −∞ where there is none. In a scene it and the ceiling are measured
    /// before every step where effects read them; else they are what the caller writes. (world, drone)
    pub ground_z: Vec<N>,
    /// Height of the ceiling above each drone, m, world frame; ∞ where there is none. (world, drone)
    pub ceiling_z: Vec<N>,
    /// Steps since the last reset. (world)
    pub steps: Vec<u64>,
    /// Episodes begun so far: resets, the first included. (world)
    pub episodes: Vec<u64>,
    /// Worlds that turned non-finite and stand still. (world)
    pub quarantine: Vec<Option<Box<Quarantine>>>,
    /// What the on-board controllers remember, as far as the control mode uses it: see [`SimData::memory`].
    /// (world, drone, numbers that it uses)
    pub controller_memory: Vec<N>,
    /// Which number of a [`Memory`] stands in each column of `controller_memory`.
    pub(super) memory_columns: Vec<usize>,
    /// What effects remember: (world, memory of the effects of every drone in order)
    pub effect_memory: Vec<N>,
}

/// The arrays of numbers of a [`SimData`], borrowed one way or the other.
macro_rules! all_arrays {
    ($data:expr, $($borrow:tt)+) => {
        [
            $($borrow)+ $data.pos,
            $($borrow)+ $data.quat,
            $($borrow)+ $data.vel,
            $($borrow)+ $data.ang_vel,
            $($borrow)+ $data.rotor_vel,
            $($borrow)+ $data.thrust,
            $($borrow)+ $data.command,
            $($borrow)+ $data.rotor_command,
            $($borrow)+ $data.attitude_command,
            $($borrow)+ $data.disturbance_force,
            $($borrow)+ $data.disturbance_torque,
            $($borrow)+ $data.wind,
            $($borrow)+ $data.ground_z,
            $($borrow)+ $data.ceiling_z,
            $($borrow)+ $data.controller_memory,
            $($borrow)+ $data.effect_memory,
        ]
    };
}

impl<N: Number> SimData<N> {
    /// All drones at rest at the origin; `effect_memory_len` per drone slot.
    pub(super) fn new(
        n_worlds: usize,
        effect_memory_len: &[usize],
        sim_hz: u32,
        mode: ControlMode,
        n_rotors: usize,
    ) -> Self {
        let command_width = mode.width(n_rotors);
        let memory_columns = Memory::<f64>::used(mode, n_rotors);
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
            n_rotors,
            command_width,
            pos: zeros(n * 3),
            quat,
            vel: zeros(n * 3),
            ang_vel: zeros(n * 3),
            rotor_vel: zeros(n * n_rotors),
            thrust: zeros(n),
            command: zeros(n * command_width),
            rotor_command: zeros(n * n_rotors),
            attitude_command: zeros(n * 4),
            disturbance_force: zeros(n * 3),
            disturbance_torque: zeros(n * 3),
            wind: zeros(n * 3),
            ground_z: vec![N::of(f64::NEG_INFINITY); n],
            ceiling_z: vec![N::of(f64::INFINITY); n],
            steps: vec![0; n_worlds],
            episodes: vec![0; n_worlds],
            quarantine: vec![None; n_worlds],
            controller_memory: zeros(n * memory_columns.len()),
            memory_columns,
            effect_memory: zeros(effect_memory_len.iter().sum::<usize>() * n_worlds),
        }
    }

    /// Copies the state of a row (world, drone): position, attitude, velocity, angular velocity, rotor speeds, thrust; see
    /// [`crate::tape::state_width`].
    pub fn copy_state(&self, row: usize, to: &mut [N]) {
        let parts = [
            (&self.pos, 3),
            (&self.quat, 4),
            (&self.vel, 3),
            (&self.ang_vel, 3),
            (&self.rotor_vel, self.n_rotors),
            (&self.thrust, 1),
        ];
        let mut col = 0;
        for (array, width) in parts {
            to[col..col + width].copy_from_slice(&array[row * width..(row + 1) * width]);
            col += width;
        }
    }

    /// Takes command number `t` of each world out of a sequence, (world, time, drone, command).
    pub fn take_command(&mut self, sequence: &[N], t: usize) {
        let own = self.n_drones * self.command_width;
        let times = sequence.len() / (own * self.n_worlds);
        for (w, to) in self.command.chunks_exact_mut(own).enumerate() {
            to.copy_from_slice(&sequence[(w * times + t) * own..][..own]);
        }
    }

    /// Writes the states of all drones to time `t` of an array, (world, time, drone, number of a state).
    pub fn give_states(&self, array: &mut [N], t: usize) {
        let width = crate::tape::state_width(self.n_rotors);
        let times = array.len() / (self.n_worlds * self.n_drones * width);
        for row in 0..self.n_worlds * self.n_drones {
            let (w, d) = (row / self.n_drones, row % self.n_drones);
            self.copy_state(row, &mut array[((w * times + t) * self.n_drones + d) * width..][..width]);
        }
    }

    /// Lets a watcher see the states after command `t`, which stand in an array of shape (world, time, drone, number of a state) with all times or with this one
    /// alone.
    pub fn show(&self, array: &[N], t: usize, watcher: &dyn Watcher<N>) {
        let width = self.n_drones * crate::tape::state_width(self.n_rotors);
        let stride = array.len() / self.n_worlds;
        let from = if stride == width { 0 } else { t * width };
        watcher.look(Watched::new((0, self.n_worlds, t), &array[from..], (stride, width)));
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
            ("rotor_vel", self.rotor_vel.len(), self.n_rotors),
            ("thrust", self.thrust.len(), 1),
            ("command", self.command.len(), self.command_width),
            ("rotor_command", self.rotor_command.len(), self.n_rotors),
            ("attitude_command", self.attitude_command.len(), 4),
            ("disturbance_force", self.disturbance_force.len(), 3),
            ("disturbance_torque", self.disturbance_torque.len(), 3),
            ("wind", self.wind.len(), 3),
            ("ground_z", self.ground_z.len(), 1),
            ("ceiling_z", self.ceiling_z.len(), 1),
            ("controller_memory", self.controller_memory.len(), self.memory_columns.len()),
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

    /// Takes over all numbers of arrays of the same shape; the vectors stay where they are in memory, since views may show them.
    pub(super) fn copy_from(&mut self, other: &Self) {
        for (to, from) in self.arrays_mut().into_iter().zip(other.arrays()) {
            to.copy_from_slice(from);
        }
        self.steps.copy_from_slice(&other.steps);
        self.episodes.copy_from_slice(&other.episodes);
        self.quarantine.clone_from_slice(&other.quarantine);
    }

    /// Copies what one world holds into all others.
    pub(super) fn fork(&mut self, world: usize) {
        let n_worlds = self.n_worlds;
        for array in self.arrays_mut() {
            spread(array, array.len() / n_worlds, world);
        }
        spread(&mut self.steps, 1, world);
        spread(&mut self.episodes, 1, world);
        spread(&mut self.quarantine, 1, world);
    }

    /// All arrays of numbers, to read.
    fn arrays(&self) -> [&[N]; 16] {
        all_arrays!(self, &)
    }

    /// All arrays of numbers, to write.
    fn arrays_mut(&mut self) -> [&mut [N]; 16] {
        all_arrays!(self, &mut)
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
            rotor_vel: wide(&self.rotor_vel, self.n_rotors, r),
            thrust: at(&self.thrust, 1, 0),
        }
    }

    /// What the controllers of one drone remember.
    pub fn memory(&self, world: usize, drone: usize) -> Memory<f64> {
        let mut all = [0.0; Memory::<f64>::LEN];
        let first = self.row(world, drone) * self.memory_columns.len();
        for (column, i) in self.memory_columns.iter().enumerate() {
            all[*i] = self.controller_memory[first + column].wide();
        }
        Memory::load(|i| all[i])
    }

    /// Sets what the controllers of one drone remember. Numbers that the control mode does not use are left out.
    pub fn set_memory(&mut self, world: usize, drone: usize, memory: &Memory<f64>) {
        let mut all = [0.0; Memory::<f64>::LEN];
        memory.store(|i, v| all[i] = v);
        let first = self.row(world, drone) * self.memory_columns.len();
        for (column, i) in self.memory_columns.iter().enumerate() {
            self.controller_memory[first + column] = N::of(all[*i]);
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
        put(&mut self.rotor_vel, &state.rotor_vel[..self.n_rotors]);
        put(&mut self.thrust, &[state.thrust]);
    }
}

/// The `n` numbers of a row, and zeros.
pub(super) fn wide<N: Number, const M: usize>(array: &[N], n: usize, row: usize) -> [f64; M] {
    core::array::from_fn(|i| if i < n { array[n * row + i].wide() } else { 0.0 })
}
