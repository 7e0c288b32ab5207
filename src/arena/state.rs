//! The whole state of an arena: kept, put back, and one world's copied into all.

use super::motion::Way;
use super::sensors::SavedSensors;
use super::{Arena, ArenaError};
use crate::rollout::SimState;
use crate::scalar::lanes::Number;

/// Everything that an arena was when it was saved: the state of its simulation, the scene of each world, where obstacles were and what
/// sensors remember.
#[derive(Clone, Debug)]
pub struct ArenaState<N: Number = f64> {
    sim: SimState<N>,
    layout: Vec<usize>,
    obstacle_pos: Vec<f64>,
    obstacle_quat: Vec<f64>,
    ways: Vec<Option<Way>>,
    sensors: SavedSensors,
}

impl<N: Number> ArenaState<N> {
    /// The state of the simulation.
    pub fn sim(&self) -> &SimState<N> {
        &self.sim
    }

    /// Number of the scene of each world.
    pub fn layout(&self) -> &[usize] {
        &self.layout
    }
}

impl<N: Number> Arena<N> {
    /// Keeps the whole state: what [`SimState`] holds, layouts, obstacles and sensors.
    pub fn save(&self) -> ArenaState<N> {
        ArenaState {
            sim: self.sim.save(),
            layout: self.places.layout.clone(),
            obstacle_pos: self.places.obstacle_pos.clone(),
            obstacle_quat: self.places.obstacle_quat.clone(),
            ways: self.motion.ways.clone(),
            sensors: self.save_sensors(),
        }
    }

    /// Puts back what [`Arena::save`] kept, of this arena or of one that was made in the same way; it goes on from there bit for bit
    /// as it did.
    ///
    /// # Errors
    /// [`ArenaError::Rollout`] as [`Sim::restore`](crate::rollout::Sim::restore), [`ArenaError::Option`] for other scenes; nothing is
    /// changed then.
    pub fn restore(&mut self, state: &ArenaState<N>) -> Result<(), ArenaError> {
        self.check_sensors(&state.sensors)?;
        let places = &mut self.places;
        let scenes = places.pools.len();
        let known = state.layout.iter().all(|scene| *scene < scenes);
        if state.layout.len() != places.layout.len()
            || state.obstacle_pos.len() != places.obstacle_pos.len()
            || state.ways.len() != self.motion.ways.len()
            || !known
        {
            let words = |layout: &[usize], obstacles: &[f64], ways: &[Option<Way>]| {
                let (worlds, numbers, moving) = (layout.len(), obstacles.len(), ways.len());
                format!(
                    "{worlds} worlds in scenes, {numbers} numbers of obstacles, {moving} of them with a motion"
                )
            };
            return Err(ArenaError::option(
                "saved state",
                format!(
                    "{}, {scenes} scenes",
                    words(&places.layout, &places.obstacle_pos, &self.motion.ways)
                ),
                words(&state.layout, &state.obstacle_pos, &state.ways),
            ));
        }
        self.sim.restore(&state.sim)?;
        places.layout.copy_from_slice(&state.layout);
        places.obstacle_pos.copy_from_slice(&state.obstacle_pos);
        places.obstacle_quat.copy_from_slice(&state.obstacle_quat);
        self.motion.ways.copy_from_slice(&state.ways);
        self.restore_sensors(&state.sensors);
        Ok(())
    }

    /// Copies everything of one world into all others, its scene and its obstacles too; see
    /// [`Sim::fork`](crate::rollout::Sim::fork).
    ///
    /// # Errors
    /// [`ArenaError::Rollout`] for a world that there is not.
    pub fn fork(&mut self, world: usize) -> Result<(), ArenaError> {
        self.sim.fork(world)?;
        self.fork_sensors(world);
        let places = &mut self.places;
        if let Some(scene) = places.layout.get(world).copied() {
            places.layout.fill(scene);
        }
        for (list, width) in [(&mut places.obstacle_pos, 3), (&mut places.obstacle_quat, 4)] {
            let each = width * places.n_obstacles;
            if each > 0 {
                let own = list[world * each..(world + 1) * each].to_vec();
                list.chunks_exact_mut(each).for_each(|to| to.copy_from_slice(&own));
            }
        }
        if !self.motion.ways.is_empty() {
            let n = places.n_obstacles;
            let own = self.motion.ways[world * n..(world + 1) * n].to_vec();
            self.motion.ways.chunks_exact_mut(n).for_each(|to| to.copy_from_slice(&own));
        }
        Ok(())
    }
}
