//! The scenes of an arena: which of them each world is in, and where its obstacles are.

use std::sync::Arc;

use super::ArenaError;
use super::sensors::Mounted;
use crate::rollout::SimData;
use crate::rollout::quarantine::{MAX_POSITION_M, NO_ATTITUDE, TOO_FAR};
use crate::scalar::lanes::Number;
use crate::scene::{Lent, MAX_COORDINATE_M, Pose, Scene, SceneError, Worker, WorkerPool, checked_pose};
use crate::sense::{SenseError, Worlds};

// What flies can be placed.
const _: () = assert!(MAX_POSITION_M <= MAX_COORDINATE_M);

/// Scenes with their workers, and what differs from world to world.
pub(super) struct Places {
    /// Workers of each scene.
    pub pools: Vec<WorkerPool>,
    /// Number of the scene of each world. (world)
    pub layout: Vec<usize>,
    /// Most obstacles that a scene has.
    pub n_obstacles: usize,
    /// Positions, m, world frame; NaN in rows that the scene of a world does not have. (world, obstacle, 3)
    pub obstacle_pos: Vec<f64>,
    /// Orientations x y z w. (world, obstacle, 4)
    pub obstacle_quat: Vec<f64>,
}

impl Places {
    /// No scene at all.
    pub fn none() -> Self {
        Self {
            pools: Vec::new(),
            layout: Vec::new(),
            n_obstacles: 0,
            obstacle_pos: Vec::new(),
            obstacle_quat: Vec::new(),
        }
    }

    /// Scenes by their workers, and the scene of each world; obstacles stand where the scenes place them.
    pub fn new(
        shared: &[Arc<WorkerPool>],
        layout: &[usize],
        n_worlds: usize,
        n_drones: usize,
    ) -> Result<Self, ArenaError> {
        if shared.is_empty() {
            return Err(ArenaError::option("scenes", "at least one", "none"));
        }
        for (i, pool) in shared.iter().enumerate() {
            let own = pool.scene().n_drones();
            if own != n_drones {
                let expected = format!("{n_drones} drones, as in the simulation");
                return Err(ArenaError::option("scenes", expected, format!("{own} drones in scene {i}")));
            }
        }
        let n_obstacles = shared.iter().map(|p| p.scene().obstacles().len()).max().unwrap_or(0);
        let mut places = Self {
            pools: shared.iter().map(WorkerPool::within).collect(),
            layout: vec![0; n_worlds],
            n_obstacles,
            obstacle_pos: vec![f64::NAN; n_worlds * n_obstacles * 3],
            obstacle_quat: vec![f64::NAN; n_worlds * n_obstacles * 4],
        };
        places.set_layout(layout)?;
        for world in 0..n_worlds {
            places.place_obstacles(world);
        }
        Ok(places)
    }

    /// Moves worlds to other scenes; obstacles of those that moved stand where their new scene places them.
    pub fn set_layout(&mut self, layout: &[usize]) -> Result<(), ArenaError> {
        let (worlds, scenes) = (self.layout.len(), self.pools.len());
        if layout.len() != worlds {
            let expected = format!("the scene of each of {worlds} worlds");
            return Err(ArenaError::option("layout", expected, format!("{} numbers", layout.len())));
        }
        if let Some((world, odd)) = layout.iter().enumerate().find(|(_, i)| **i >= scenes) {
            let expected = format!("numbers below {scenes}, the number of scenes");
            return Err(ArenaError::option("layout", expected, format!("{odd} for world {world}")));
        }
        for (world, scene) in layout.iter().enumerate() {
            if self.layout[world] != *scene {
                self.layout[world] = *scene;
                self.place_obstacles(world);
            }
        }
        Ok(())
    }

    /// Puts the obstacles of a world where its scene has them.
    fn place_obstacles(&mut self, world: usize) {
        let (n, pool) = (self.n_obstacles, &self.pools[self.layout[world]]);
        let pos = &mut self.obstacle_pos[3 * n * world..3 * n * (world + 1)];
        let quat = &mut self.obstacle_quat[4 * n * world..4 * n * (world + 1)];
        pos.fill(f64::NAN);
        quat.fill(f64::NAN);
        for (i, obstacle) in pool.scene().obstacles().iter().enumerate() {
            pos[3 * i..3 * i + 3].copy_from_slice(&obstacle.pos_m);
            quat[4 * i..4 * i + 4].copy_from_slice(&obstacle.quat_xyzw);
        }
    }

    /// Puts the obstacles of worlds whose entry is true where their scenes have them.
    pub fn reset_obstacles(&mut self, worlds: &[bool]) {
        if self.n_obstacles > 0 {
            let n_worlds = self.layout.len();
            (0..n_worlds).filter(|w| worlds.get(*w) == Some(&true)).for_each(|w| self.place_obstacles(w));
        }
    }

    /// The scene of a world.
    pub fn scene(&self, world: usize) -> Option<&Scene> {
        self.layout.get(world).map(|i| self.pools[*i].scene())
    }

    /// Puts the obstacles of a worker where those of a world are.
    pub fn set_obstacles(&self, world: usize, worker: &mut Worker) -> Result<(), SceneError> {
        let first = world * self.n_obstacles;
        for i in 0..self.pools[self.layout[world]].scene().obstacles().len() {
            let pos = core::array::from_fn(|k| self.obstacle_pos[3 * (first + i) + k]);
            let quat = core::array::from_fn(|k| self.obstacle_quat[4 * (first + i) + k]);
            worker.set_obstacle(i, pos, quat)?;
        }
        Ok(())
    }

    /// A worker of the scene of a world in which its obstacles are placed, and drones are anywhere.
    pub fn surroundings(&self, world: usize) -> Result<Lent<'_>, SceneError> {
        let mut worker = self.pools[self.layout[world]].lend()?;
        self.set_obstacles(world, &mut worker)?;
        worker.update()?;
        Ok(worker)
    }
}

/// Worlds of an arena as they are now, to be looked at from any thread.
#[derive(Clone, Copy)]
pub struct Look<'a, N: Number> {
    pub(super) places: &'a Places,
    pub(super) data: &'a SimData<N>,
    pub(super) sensors: &'a [Mounted],
    /// Which worlds, in the order in which they are looked at; none: all.
    pub(super) worlds: Option<&'a [usize]>,
}

impl<'a, N: Number> Look<'a, N> {
    /// The arrays of the simulation.
    pub fn data(&self) -> &'a SimData<N> {
        self.data
    }

    /// Positions of the obstacles of a world, m, world frame; NaN in rows that its scene does not have. (obstacle, 3)
    pub fn obstacle_pos_m(&self, world: usize) -> &'a [[f64; 3]] {
        let n = self.places.n_obstacles;
        &self.places.obstacle_pos.as_chunks::<3>().0[world * n..(world + 1) * n]
    }

    /// Orientations x y z w of the obstacles of a world, as [`Look::obstacle_pos_m`]. (obstacle, 4)
    pub fn obstacle_quat(&self, world: usize) -> &'a [[f64; 4]] {
        let n = self.places.n_obstacles;
        &self.places.obstacle_quat.as_chunks::<4>().0[world * n..(world + 1) * n]
    }

    /// What a sensor sampled last in a world, (drone, shape of the channel); none for a sensor or a channel that there is not.
    pub fn samples(&self, world: usize, sensor: &str, channel: &str) -> Option<&'a [f32]> {
        self.sensors.iter().find(|m| m.name() == sensor)?.of_world(world, channel)
    }

    /// Number of the scene that a world is in; none without a scene.
    pub fn layout(&self, world: usize) -> Option<usize> {
        self.places.layout.get(world).copied()
    }

    /// A worker of the scene of a world in which its obstacles and its drones stand where they are now.
    ///
    /// # Errors
    /// [`ArenaError::NoScene`], and [`ArenaError::Scene`] for poses that are not finite or beyond all scenes, which it names.
    pub fn world(&self, world: usize) -> Result<Lent<'a>, ArenaError> {
        self.check(world)?;
        Ok(self.placed(world)?)
    }

    /// As [`Look::world`], but drones stand wherever the worker was left with them: for whoever places them.
    ///
    /// # Errors
    /// As [`Look::world`].
    pub fn surroundings(&self, world: usize) -> Result<Lent<'a>, ArenaError> {
        self.check(world)?;
        Ok(self.places.surroundings(world)?)
    }

    fn check(&self, world: usize) -> Result<(), ArenaError> {
        if self.places.layout.is_empty() {
            return Err(ArenaError::NoScene { asked: "looking at a world" });
        }
        if world >= self.places.layout.len() {
            let expected = format!("less than {}", self.places.layout.len());
            return Err(ArenaError::option("world", expected, world));
        }
        Ok(())
    }

    fn placed(&self, world: usize) -> Result<Lent<'a>, SceneError> {
        let mut worker = self.places.pools[self.places.layout[world]].lend()?;
        for drone in 0..self.data.n_drones {
            let at = self.pose(world, drone);
            worker.set_drone(drone, at.pos_m, at.quat_xyzw)?;
        }
        self.places.set_obstacles(world, &mut worker)?;
        worker.update()?;
        Ok(worker)
    }

    /// Where a drone is.
    pub fn pose(&self, world: usize, drone: usize) -> Pose {
        let row = self.data.row(world, drone);
        Pose::new(
            core::array::from_fn(|k| self.data.pos[3 * row + k].wide()),
            core::array::from_fn(|k| self.data.quat[4 * row + k].wide()),
        )
    }

    /// What keeps a drone from being placed in a scene.
    pub(super) fn fault(&self, world: usize, drone: usize) -> Option<&'static str> {
        let at = self.pose(world, drone);
        if at.pos_m.iter().chain(&at.quat_xyzw).any(|v| !v.is_finite()) {
            return Some(if at.quat_xyzw.iter().all(|v| v.is_finite()) { "position" } else { "attitude" });
        }
        if at.pos_m.iter().any(|v| v.abs() > MAX_COORDINATE_M) {
            return Some(TOO_FAR);
        }
        checked_pose(|| "a drone".into(), at.pos_m, at.quat_xyzw).is_err().then_some(NO_ATTITUDE)
    }

    /// What came of looking at worlds, without the failures of those that are quarantined: they are marked already.
    pub(super) fn but_quarantined(&self, outcome: Result<(), SenseError>) -> Result<(), SenseError> {
        match outcome {
            Err(SenseError::Worlds { worlds, mut failures }) => {
                failures.retain(|(k, _)| self.data.quarantine[self.number(*k)].is_none());
                if failures.is_empty() { Ok(()) } else { Err(SenseError::Worlds { worlds, failures }) }
            }
            other => other,
        }
    }

    /// World number `k` of those that are looked at.
    pub(super) fn number(&self, k: usize) -> usize {
        self.worlds.map_or(k, |list| list[k])
    }
}

impl<N: Number> Worlds for Look<'_, N> {
    fn n_worlds(&self) -> usize {
        self.worlds.map_or(self.data.n_worlds, <[usize]>::len)
    }

    fn n_drones(&self) -> usize {
        self.data.n_drones
    }

    fn worker(&self, world: usize) -> Result<Lent<'_>, SceneError> {
        self.placed(self.number(world))
    }
}
