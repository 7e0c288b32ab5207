//! The whole state of a simulation: kept, put back, and one world's copied into all.

use super::traced::bare;
use super::{RolloutError, Sim, SimData};
use propwash_physics::drone::Drone;
use propwash_physics::rigid_body::State;
use propwash_trace::lanes::Number;

/// Everything that a simulation was and knew when it was saved: its arrays (states, commands, disturbances, wind, ground,
/// what controllers and effects remember, counts of steps and episodes, quarantine), parameters of the vehicles, what resets
/// start from, and the seed. Stages of the pipeline are functions and are not part of it.
#[derive(Clone, Debug, PartialEq)]
pub struct SimState<N: Number = f64> {
    seed: u64,
    seeds: Vec<u64>,
    nominal: Vec<Drone<f64>>,
    base: Option<Vec<Drone<f64>>>,
    own: Option<Vec<Drone<f64>>>,
    initial: Vec<State<f64>>,
    data: SimData<N>,
}

impl<N: Number> SimState<N> {
    /// The arrays.
    pub fn data(&self) -> &SimData<N> {
        &self.data
    }
}

impl<N: Number> Sim<N> {
    /// Keeps the whole state. [`Sim::restore`] puts it back, and the simulation goes on from there bit for bit as it did.
    pub fn save(&self) -> SimState<N> {
        SimState {
            seed: self.options.seed,
            seeds: self.options.seeds.clone(),
            nominal: self.nominal.clone(),
            base: self.base.clone(),
            own: self.own.clone(),
            initial: self.initial.clone(),
            data: self.data.clone(),
        }
    }

    /// Puts back what [`Sim::save`] kept, of this simulation or of one that was made in the same way. The arrays of `data` keep
    /// their places in memory.
    ///
    /// # Errors
    /// [`RolloutError::Option`] for the state of a simulation with other worlds, drones, rates, control mode or effects, and the errors
    /// of [`Sim::step`] for arrays whose length was changed; nothing is changed then.
    pub fn restore(&mut self, state: &SimState<N>) -> Result<(), RolloutError> {
        let option = |name, expected: String, got: String| Err(RolloutError::Option { name, expected, got });
        let shape = |data: &SimData<N>| {
            format!(
                "{} worlds x {} drones at {} Hz, {} rotors, commands of {}, {} numbers that controllers and {} that effects \
                 remember",
                data.n_worlds,
                data.n_drones,
                data.sim_hz,
                data.n_rotors,
                data.command_width,
                data.controller_memory.len(),
                data.effect_memory.len()
            )
        };
        let same_memory = state.data.memory_columns == self.data.memory_columns;
        if shape(&state.data) != shape(&self.data) || !same_memory {
            return option("saved state", shape(&self.data), shape(&state.data));
        }
        let parts = |drones: &[Drone<f64>]| drones.iter().map(bare).collect::<Vec<_>>();
        if parts(&state.nominal) != parts(&self.nominal) {
            let names = |drones: &[Drone<f64>]| {
                let of = |d: &Drone<f64>| d.effects.iter().map(|e| e.label()).collect::<Vec<_>>().join(", ");
                drones.iter().map(|d| format!("[{}]", of(d))).collect::<Vec<_>>().join(" ")
            };
            let (expected, got) = (names(&self.nominal), names(&state.nominal));
            return option(
                "saved state",
                format!("vehicles made of the same parts, with effects {expected}"),
                format!("other vehicles, with effects {got}"),
            );
        }
        self.check_data()?;
        let per_world = state.data.effect_memory.len() / state.data.n_worlds;
        state.data.check_lengths(per_world)?;
        self.options.seed = state.seed;
        self.options.seeds.clone_from(&state.seeds);
        let same = self.nominal == state.nominal && self.base == state.base && self.own == state.own;
        if !same {
            self.nominal.clone_from(&state.nominal);
            self.base.clone_from(&state.base);
            self.own.clone_from(&state.own);
            self.forget_tables();
        }
        self.initial.clone_from(&state.initial);
        self.data.copy_from(&state.data);
        Ok(())
    }

    /// Copies everything of one world into all others: state, commands, memories, parameters, what resets start from, counts of
    /// steps and episodes. From then on worlds differ by what they are commanded, and by the random numbers of effects, of which
    /// every world draws its own.
    ///
    /// # Errors
    /// [`RolloutError::Option`] for a world that there is not.
    pub fn fork(&mut self, world: usize) -> Result<(), RolloutError> {
        let (worlds, n) = (self.data.n_worlds, self.nominal.len());
        if world >= worlds {
            return Err(RolloutError::Option {
                name: "world to fork",
                expected: format!("less than {worlds}, the number of worlds"),
                got: world.to_string(),
            });
        }
        self.check_data()?;
        self.data.fork(world);
        for (w, quarantine) in self.data.quarantine.iter_mut().enumerate() {
            if let Some(fault) = quarantine {
                fault.world = self.options.first_world + w as u64;
            }
        }
        for list in [&mut self.base, &mut self.own].into_iter().flatten() {
            spread(list, n, world);
        }
        if self.initial.len() == worlds * n {
            spread(&mut self.initial, n, world);
        }
        self.forget_tables();
        Ok(())
    }
}

/// Copies row number `from` of `width` entries into all others.
pub(super) fn spread<T: Clone>(list: &mut [T], width: usize, from: usize) {
    if width == 0 {
        return;
    }
    let row = list[from * width..(from + 1) * width].to_vec();
    list.chunks_exact_mut(width).for_each(|to| to.clone_from_slice(&row));
}
