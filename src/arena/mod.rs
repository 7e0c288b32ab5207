//! Fly, see, touch: worlds of drones in their scenes, as one thing.
//!
//! An [`Arena`] holds a simulation, the scenes that its worlds are in, and where their obstacles are. It is the one place where
//! motion meets geometry:
//!
//! - Before every simulation step it measures what effects of some drone declare that they read of the scene
//!   ([`Reads`]): the height of the ground below each drone, and of the ceiling above. So no
//!   effect flies without what it needs, whether in a data set, a learning environment or a loop of the user. Where no effect
//!   reads any of it, steps cost what they cost without a scene.
//! - It puts the poses of drones and obstacles into workers of the scene and asks them: depth ([`Arena::render`]), contacts,
//!   clearances, what was touched on the way ([`Arena::swept`]), or, through [`Arena::look`], anything that `sense` can say.
//! - It keeps the whole state and puts it back, to the bit ([`Arena::save`]).
//!
//! A [`SimConfig`] says all of it in one table; [`Arena::from_config`] makes the arena.
//!
//! Without a scene the ground is what the arena is told ([`Arena::open`]): at one height everywhere, or whatever the caller writes
//! into the arrays.

mod builder;
mod camera;
mod config;
mod error;
mod motion;
mod nearest;
mod pattern;
mod places;
mod priced;
mod scenes;
mod senses;
mod sensor_config;
mod sensors;
mod state;

use std::sync::Arc;

use rayon::prelude::*;

pub use builder::Builder;
pub use camera::CameraConfig;
pub use config::{
    BodyRateLaw, DroneConfig, MountedSensor, Precision, RatesConfig, Setup, SimConfig, VehicleSource,
    read_text, read_value,
};
pub use error::ArenaError;
use motion::Motion;
pub use motion::{MotionKind, ObstacleMotion};
pub use nearest::Nearest;
pub use pattern::FlightPattern;
pub use places::Look;
pub use priced::{Cost, Priced};
pub use scenes::SceneConfig;
pub use senses::Way;
pub use sensor_config::{
    DepthCameraConfig, ImuConfig, LidarConfig, MountConfig, OpticalFlowConfig, RangeFinderConfig,
    SensorConfig,
};
use sensors::Mounted;
pub use state::ArenaState;

use crate::physics::rigid_body::State;
use crate::physics::surroundings::Reads;
use crate::rollout::pipeline::Pipeline;
use crate::rollout::quarantine::Quarantine;
use crate::rollout::tape::{Tape, state_width};
use crate::rollout::trajectory::Trajectory;
use crate::rollout::watch::Watcher;
use crate::rollout::{RolloutError, Sim, SimData};
use crate::scalar::lanes::Number;
use crate::scene::{Lent, Scene, WorkerPool};
use places::Places;

/// Worlds whose ground and ceilings one thread measures at a time, with one worker for each scene; a world takes under a microsecond.
const WORLDS_AT_ONCE: usize = 64;

/// Worlds of drones in their scenes. `N` is the number that the simulation stores, f64 or f32.
pub struct Arena<N: Number = f64> {
    sim: Sim<N>,
    places: Places,
    /// Height of the ground where there is no scene, m; none: what the caller writes.
    open_ground_m: Option<f64>,
    /// What effects read, by drone.
    reads: Vec<Reads>,
    /// Gravity of the vehicles, which holds where the scene states none, m/s², by drone.
    gravity_m_s2: Vec<[f64; 3]>,
    /// The pattern that drones follow, (world, drone); empty without one.
    trajectories: Vec<Trajectory>,
    sensors: Vec<Mounted>,
    motion: Motion,
    /// Obstacles are shifted by up to this much, m; see [`SimConfig::obstacle_jitter_m`].
    jitter_m: f64,
}

impl<N: Number> std::fmt::Debug for Arena<N> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Arena")
            .field("sim", &self.sim)
            .field("scenes", &self.places.pools.len())
            .field("reads", &self.reads)
            .finish_non_exhaustive()
    }
}

impl<N: Number> Arena<N> {
    /// A simulation without a scene. `ground_z_m`: the height of the ground everywhere, m, for effects that read it; none leaves
    /// `ground_z` of the arrays to the caller, which says that there is no ground until it is written. There is no ceiling but what
    /// the caller writes.
    pub fn open(sim: Sim<N>, ground_z_m: Option<f64>) -> Self {
        let reads = (0..sim.data.n_drones).map(|d| sim.drone(0, d).reads()).collect();
        let gravity_m_s2 = (0..sim.data.n_drones).map(|d| sim.drone(0, d).body.gravity_m_s2).collect();
        let (trajectories, sensors) = (Vec::new(), Vec::new());
        Self {
            places: Places::none(),
            open_ground_m: ground_z_m,
            reads,
            gravity_m_s2,
            trajectories,
            sensors,
            motion: Motion::default(),
            jitter_m: 0.0,
            sim,
        }
    }

    /// A simulation in scenes, of which `layout` names the one of each world by number; the drones of each scene are those of
    /// the simulation.
    ///
    /// # Errors
    /// [`ArenaError::Option`] for scenes that do not fit the simulation, naming them.
    pub fn within(sim: Sim<N>, scenes: &[Scene], layout: &[usize]) -> Result<Self, ArenaError> {
        let pools: Vec<_> = scenes.iter().map(|scene| Arc::new(WorkerPool::new(scene))).collect();
        Self::sharing(sim, &pools, layout)
    }

    /// As [`Arena::within`], with workers that arenas of the same scenes share: each keeps those that it took until it is dropped.
    ///
    /// # Errors
    /// As [`Arena::within`].
    pub fn sharing(sim: Sim<N>, pools: &[Arc<WorkerPool>], layout: &[usize]) -> Result<Self, ArenaError> {
        let places = Places::new(pools, layout, sim.data.n_worlds, sim.data.n_drones)?;
        let mut arena = Self { places, ..Self::open(sim, None) };
        // Where all scenes state the same gravity, worlds go on sharing their vehicles: one for each costs memory and time.
        let first = arena.scenes().next().and_then(Scene::gravity_m_s2);
        if let Some(gravity) = first.filter(|g| arena.scenes().all(|scene| scene.gravity_m_s2() == Some(*g)))
        {
            arena.set_gravity(None, |_| gravity)?;
        }
        arena.take_over_physics(|_| true)?;
        Ok(arena)
    }

    /// Lets the gravity and the wind that scenes state hold in their worlds, in place of the gravity of the vehicles: in worlds that
    /// have come to another scene.
    fn take_over_physics(&mut self, is_new: impl Fn(usize) -> bool) -> Result<(), ArenaError> {
        let stated = |scene: &Scene| scene.gravity_m_s2().is_some() || scene.wind_m_s() != [0.0; 3];
        if !self.scenes().any(stated) {
            return Ok(());
        }
        let own = self.gravity_m_s2.clone();
        for world in (0..self.sim.data.n_worlds).filter(|w| is_new(*w)) {
            let Some(scene) = self.places.scene(world) else { break };
            let (gravity, wind) = (scene.gravity_m_s2(), scene.wind_m_s());
            self.set_gravity(Some(world), |drone| gravity.unwrap_or(own[drone]))?;
            for drone in 0..self.sim.data.n_drones {
                let at = 3 * self.sim.data.row(world, drone);
                self.sim.data.wind[at..at + 3].copy_from_slice(&wind.map(N::of));
            }
        }
        Ok(())
    }

    /// Sets the gravity of each drone, m/s², in one world or in all, where it is another now.
    fn set_gravity(
        &mut self,
        world: Option<usize>,
        gravity: impl Fn(usize) -> [f64; 3],
    ) -> Result<(), ArenaError> {
        for drone in 0..self.sim.data.n_drones {
            let now = self.sim.drone(world.unwrap_or(0), drone).body.gravity_m_s2;
            for (k, g) in gravity(drone).into_iter().enumerate().filter(|(k, g)| now[*k] != *g) {
                self.sim.set_parameter(world, drone, &format!("body.gravity_m_s2.{k}"), g)?;
            }
        }
        Ok(())
    }

    /// The simulation: its arrays, options, vehicles and derivatives.
    pub fn sim(&self) -> &Sim<N> {
        &self.sim
    }

    /// The arrays, to be written between steps.
    pub fn data_mut(&mut self) -> &mut SimData<N> {
        &mut self.sim.data
    }

    /// The stages of a step.
    pub fn pipeline_mut(&mut self) -> &mut Pipeline<N> {
        &mut self.sim.pipeline
    }

    /// The scenes, by number.
    pub fn scenes(&self) -> impl ExactSizeIterator<Item = &Scene> {
        self.places.pools.iter().map(WorkerPool::scene)
    }

    /// Whether drones can see and touch.
    pub fn has_scene(&self) -> bool {
        !self.places.pools.is_empty()
    }

    /// The scene that a world is in; none without one.
    pub fn scene(&self, world: usize) -> Option<&Scene> {
        self.places.scene(world)
    }

    /// Number of the scene of each world, (world); empty without a scene.
    pub fn layout(&self) -> &[usize] {
        &self.places.layout
    }

    /// Moves worlds to other scenes; obstacles of those that moved stand where their new scene places them, and its gravity and wind hold.
    ///
    /// # Errors
    /// [`ArenaError::Option`] for a list of another length and for numbers of scenes that there are not; nothing is changed then.
    pub fn set_layout(&mut self, layout: &[usize]) -> Result<(), ArenaError> {
        let before = self.places.layout.clone();
        self.move_to_layouts(layout)?;
        let moved: Vec<bool> = before.iter().zip(layout).map(|(a, b)| a != b).collect();
        self.begin_motion(Some(&moved))
    }

    /// The same; obstacles of worlds that moved stand still until [`Arena::begin_motion`].
    pub(crate) fn move_to_layouts(&mut self, layout: &[usize]) -> Result<(), ArenaError> {
        let before = self.places.layout.clone();
        self.places.set_layout(layout)?;
        self.take_over_physics(|world| before[world] != layout[world])
    }

    /// Number of obstacles in the scene with most.
    pub fn n_obstacles(&self) -> usize {
        self.places.n_obstacles
    }

    /// Positions of obstacles, m, world frame, to be written: (world, obstacle, 3); NaN in rows that the scene of a world does not
    /// have.
    pub fn obstacle_pos_mut(&mut self) -> &mut [f64] {
        &mut self.places.obstacle_pos
    }

    /// Orientations x y z w of obstacles, to be written: (world, obstacle, 4).
    pub fn obstacle_quat_mut(&mut self) -> &mut [f64] {
        &mut self.places.obstacle_quat
    }

    /// The trajectory of every drone in the pattern of its description, (world, drone); empty where it has none.
    pub fn trajectories(&self) -> &[Trajectory] {
        &self.trajectories
    }

    /// As [`Arena::obstacle_pos_mut`] and [`Arena::obstacle_quat_mut`], both.
    pub fn obstacles_mut(&mut self) -> (&mut [f64], &mut [f64]) {
        (&mut self.places.obstacle_pos, &mut self.places.obstacle_quat)
    }

    /// Puts the obstacles of worlds whose entry is true back to where their scenes place them, but for the shift of
    /// [`SimConfig::obstacle_jitter_m`], which is drawn anew in every episode; worlds without an entry are left alone. Obstacles that move
    /// by themselves begin from there.
    ///
    /// # Errors
    /// [`ArenaError::Scene`] where the room around obstacles that move cannot be looked at.
    pub fn reset_obstacles(&mut self, worlds: &[bool]) -> Result<(), ArenaError> {
        self.places.reset_obstacles(worlds);
        self.jitter_obstacles(Some(worlds));
        self.begin_motion(Some(worlds))
    }

    /// What effects of some drone read.
    pub fn reads(&self) -> Reads {
        self.reads.iter().fold(Reads::NOTHING, |all, reads| all.or(*reads))
    }

    /// Whether ground or ceiling are measured before every simulation step.
    pub fn measures(&self) -> bool {
        let reads = self.reads();
        self.has_scene() && (reads.ground || reads.ceiling)
    }

    /// Whether a step is shared by threads of the pool that calls it.
    pub fn is_parallel(&self, n_steps: usize) -> bool {
        match self.measures() {
            true => self.sim.data.n_worlds > WORLDS_AT_ONCE || self.sim.is_parallel(1),
            false => self.sim.is_parallel(n_steps),
        }
    }

    /// Whether all of a step heeds [`alone`](crate::rollout::pool::alone): what scenes measure is shared by threads of the pool.
    pub fn can_be_alone(&self) -> bool {
        !self.measures()
    }

    /// As [`Sim::set_command`].
    ///
    /// # Errors
    /// As there.
    pub fn set_command(&mut self, command: &[f64]) -> Result<(), RolloutError> {
        self.sim.set_command(command)
    }

    /// As [`Sim::set_initial`].
    ///
    /// # Errors
    /// As there.
    pub fn set_initial(&mut self, world: usize, drone: usize, state: State<f64>) -> Result<(), RolloutError> {
        self.sim.set_initial(world, drone, state)
    }

    /// As [`Sim::set_parameter`].
    ///
    /// # Errors
    /// As there.
    pub fn set_parameter(
        &mut self,
        world: Option<usize>,
        drone: usize,
        name: &str,
        value: f64,
    ) -> Result<(), RolloutError> {
        self.sim.set_parameter(world, drone, name, value)
    }

    /// As [`Sim::reseed`].
    pub fn reseed(&mut self, seed: u64) {
        self.sim.reseed(seed);
    }

    /// As [`Sim::reseed_each`].
    ///
    /// # Errors
    /// As there.
    pub fn reseed_each(&mut self, seeds: &[u64]) -> Result<(), RolloutError> {
        self.sim.reseed_each(seeds)
    }

    /// As [`Sim::reset`]. Layouts stay, and so do obstacles but for those that move by themselves, whose ways are drawn anew.
    ///
    /// # Errors
    /// [`ArenaError::Rollout`] as there, and as [`Arena::reset_obstacles`].
    pub fn reset(&mut self, worlds: Option<&[bool]>) -> Result<(), ArenaError> {
        self.reset_flight(worlds)?;
        self.take_obstacles_back(worlds);
        self.begin_motion(worlds)
    }

    /// As [`Arena::reset`], but obstacles stay wherever they are.
    pub(crate) fn reset_flight(&mut self, worlds: Option<&[bool]>) -> Result<(), RolloutError> {
        self.sim.reset(worlds)
    }

    /// Advances every world that is not quarantined by `n_steps`; effects read the ground and the ceiling of the place where
    /// each of the steps begins.
    ///
    /// # Errors
    /// [`ArenaError::Rollout`] as [`Sim::step`], [`ArenaError::Scene`] for obstacles whose poses are not finite.
    pub fn step(&mut self, n_steps: usize) -> Result<(), ArenaError> {
        // What was written into the arrays of obstacles that move by themselves does not count.
        self.move_obstacles();
        let (times, each) = if self.measures() { (n_steps, 1) } else { (1, n_steps) };
        for _ in 0..times {
            self.measure()?;
            let flown = self.sim.step(each);
            self.move_obstacles();
            flown?;
        }
        Ok(())
    }

    /// Flies a sequence of commands and returns the states after each, as [`Sim::rollout`]; effects read the ground and the ceiling of the
    /// place where each step begins.
    ///
    /// # Errors
    /// As there, and as [`Arena::step`].
    pub fn rollout(&mut self, commands: &[N], substeps: usize) -> Result<Vec<N>, ArenaError> {
        self.fly(commands, substeps, None)
    }

    /// The same, while `watcher` sees the states after each command, as [`Sim::rollout_watched`].
    ///
    /// # Errors
    /// As [`Arena::rollout`].
    pub fn rollout_watched(
        &mut self,
        commands: &[N],
        substeps: usize,
        watcher: &dyn Watcher<N>,
        keep: bool,
    ) -> Result<Vec<N>, ArenaError> {
        self.fly(commands, substeps, Some((watcher, keep)))
    }

    fn fly(
        &mut self,
        commands: &[N],
        substeps: usize,
        watched: Option<(&dyn Watcher<N>, bool)>,
    ) -> Result<Vec<N>, ArenaError> {
        if !self.measures() {
            self.move_obstacles();
            let flown = match watched {
                Some((watcher, keep)) => self.sim.rollout_watched(commands, substeps, watcher, keep),
                None => self.sim.rollout(commands, substeps),
            };
            self.move_obstacles();
            return Ok(flown?);
        }
        let times = self.sim.times_of(commands, substeps)?;
        let keep = watched.is_none_or(|(_, keep)| keep);
        let (worlds, drones) = (self.sim.data.n_worlds, self.sim.data.n_drones);
        let kept = if keep { times } else { 1 };
        let mut states = vec![N::zero(); worlds * kept * drones * state_width(self.sim.data.n_rotors)];
        for t in 0..times {
            self.sim.data.take_command(commands, t);
            self.step(substeps)?;
            self.sim.data.give_states(&mut states, if keep { t } else { 0 });
            if let Some((watcher, _)) = watched {
                self.sim.data.show(&states, t, watcher);
            }
        }
        Ok(if keep { states } else { Vec::new() })
    }

    /// Time derivatives of states under commands, as [`Sim::rate_at`].
    ///
    /// # Errors
    /// As there, and [`ArenaError::Option`] where ground or ceiling are measured in a scene: they would be those of another place.
    pub fn rate_at(&self, at: (usize, usize), x: &[f64], u: &[f64]) -> Result<Vec<f64>, ArenaError> {
        self.check_unmeasured()?;
        Ok(self.sim.rate_at(at, x, u)?)
    }

    /// States after steps from states under commands, as [`Sim::steps_from`].
    ///
    /// # Errors
    /// As [`Arena::rate_at`].
    pub fn steps_from(
        &self,
        at: (usize, usize),
        x: &[f64],
        u: &[f64],
        n_steps: usize,
    ) -> Result<Vec<f64>, ArenaError> {
        self.check_unmeasured()?;
        Ok(self.sim.steps_from(at, x, u, n_steps)?)
    }

    /// Refuses scenes in which ground or ceiling are measured before every step.
    fn check_unmeasured(&self) -> Result<(), ArenaError> {
        if !self.measures() {
            return Ok(());
        }
        let expected = "none in which effects of a drone read the ground or the ceiling, which are measured where drones are: without the scene the ground is level (ground_z of the arrays)";
        Err(ArenaError::option("scene", expected, "one in which they are measured before every step"))
    }

    /// As [`Arena::rollout`], and remembers the flight for gradients, as [`Sim::record`].
    ///
    /// # Errors
    /// As there; [`RolloutError::Gradient`] where ground or ceiling are measured in a scene before every step, since the slopes of what is
    /// measured are unknown.
    pub fn record(&mut self, commands: &[N], substeps: usize) -> Result<Tape<N>, ArenaError> {
        if self.measures() {
            return Err(ArenaError::Rollout(RolloutError::Gradient {
                what: "steps before which the ground or the ceiling is measured in the scene, as effects of a drone ask".into(),
                remedy: "fly without the scene: the ground is then level (ground_z of the arrays)".into(),
            }));
        }
        self.move_obstacles();
        let flown = self.sim.record(commands, substeps);
        self.move_obstacles();
        Ok(flown?)
    }

    /// The first half of a step, as [`Sim::run_controllers`]; what effects read is measured here, so that
    /// [`Sim::rate`] tells of it between the halves.
    ///
    /// # Errors
    /// As [`Arena::step`].
    pub fn run_controllers(&mut self) -> Result<(), ArenaError> {
        self.measure()?;
        Ok(self.sim.run_controllers()?)
    }

    /// The second half, as [`Sim::run_integration`].
    ///
    /// # Errors
    /// As [`Arena::step`].
    pub fn run_integration(&mut self) -> Result<(), ArenaError> {
        let flown = self.sim.run_integration();
        self.move_obstacles();
        Ok(flown?)
    }

    /// Writes the heights of ground and ceiling that effects read into the arrays, as every step does first.
    ///
    /// # Errors
    /// As [`Arena::step`].
    pub fn measure(&mut self) -> Result<(), ArenaError> {
        if self.measures() {
            let reads = std::mem::take(&mut self.reads);
            let done = self.measure_for(&reads, None);
            self.reads = reads;
            return done;
        }
        if let Some(z) = self.open_ground_m {
            let n = self.reads.len();
            for (row, ground) in self.sim.data.ground_z.iter_mut().enumerate() {
                if self.reads[row % n].ground {
                    *ground = N::of(z);
                }
            }
        }
        Ok(())
    }

    /// Writes the height of the scene below every drone into `ground_z`, whatever its effects read: in all worlds, or in those of
    /// the list.
    ///
    /// # Errors
    /// [`ArenaError::NoScene`], [`ArenaError::Option`] for a world that there is not, and the errors of [`Arena::step`].
    pub fn measure_ground(&mut self, worlds: Option<&[usize]>) -> Result<(), ArenaError> {
        if !self.has_scene() {
            return Err(ArenaError::NoScene { asked: "measuring the ground" });
        }
        check_worlds(worlds, self.sim.data.n_worlds)?;
        let wanted = worlds.map(|list| {
            let mut wanted = vec![false; self.sim.data.n_worlds];
            list.iter().for_each(|w| wanted[*w] = true);
            wanted
        });
        self.measure_for(&vec![Reads::GROUND; self.sim.data.n_drones], wanted.as_deref())
    }

    /// Measures what drones read, in the worlds whose entry is true or in all that are not quarantined.
    fn measure_for(&mut self, reads: &[Reads], wanted: Option<&[bool]>) -> Result<(), ArenaError> {
        // The arrays are open to the caller: rows must have their lengths before threads go through them.
        self.sim.check_data()?;
        let (rows, places) = (reads.len() * WORLDS_AT_ONCE, &self.places);
        let data = &mut self.sim.data;
        let quarantine = &data.quarantine;
        let is_wanted = |w: usize| wanted.map_or(quarantine[w].is_none(), |wanted| wanted[w]);
        let some = |(k, (pos, (ground, ceiling))): (usize, Rows<N>)| {
            measure_worlds(places, k * WORLDS_AT_ONCE, is_wanted, reads, (pos, (ground, ceiling)))
        };
        if data.n_worlds > WORLDS_AT_ONCE {
            let heights = data.ground_z.par_chunks_mut(rows).zip(data.ceiling_z.par_chunks_mut(rows));
            data.pos.par_chunks(3 * rows).zip(heights).enumerate().try_for_each(some)
        } else {
            some((0, (&data.pos, (&mut data.ground_z, &mut data.ceiling_z))))
        }
    }

    /// Quarantines worlds with a drone that stands in no scene, since a pose was written for it that is not finite, beyond
    /// [`MAX_COORDINATE_M`](crate::scene::MAX_COORDINATE_M) or whose quaternion has no length. Senses leave quarantined worlds without a
    /// place out and look at the others, where they would fail for one that is not marked. The number of worlds that it found.
    pub fn set_aside_unplaceable(&mut self) -> usize {
        let data = &self.sim.data;
        let look = self.look();
        let fault = |w: usize| {
            let drones = 0..data.n_drones;
            drones.filter(|_| data.quarantine[w].is_none()).find_map(|d| Some((d, look.fault(w, d)?)))
        };
        let found: Vec<_> = (0..data.n_worlds).filter_map(|w| Some((w, fault(w)?))).collect();
        let first_world = self.sim.options().first_world;
        let data = &mut self.sim.data;
        for (w, (drone, quantity)) in &found {
            let (world, step) = (first_world + *w as u64, data.steps[*w]);
            let quarantine =
                Quarantine { world, drone: *drone, step, quantity: (*quantity).into(), stage: None };
            data.quarantine[*w] = Some(Box::new(quarantine));
        }
        found.len()
    }

    /// The worlds as they are now, to be looked at; the result can be shared by threads.
    pub fn look(&self) -> Look<'_, N> {
        Look { places: &self.places, data: &self.sim.data, sensors: &self.sensors, worlds: None }
    }

    /// A worker of a scene, by its number, with whatever poses it was left with: set all that matter.
    ///
    /// # Errors
    /// [`ArenaError::Option`] for a scene that there is not, [`ArenaError::Scene`] where a worker cannot be made.
    pub fn lend(&self, scene: usize) -> Result<Lent<'_>, ArenaError> {
        match self.places.pools.get(scene) {
            Some(pool) => Ok(pool.lend()?),
            None => {
                let expected = format!("less than {}, the number of scenes", self.places.pools.len());
                Err(ArenaError::option("scene", expected, scene))
            }
        }
    }
}

/// Refuses numbers of worlds that there are not.
fn check_worlds(worlds: Option<&[usize]>, n_worlds: usize) -> Result<(), ArenaError> {
    match worlds.unwrap_or_default().iter().find(|w| **w >= n_worlds) {
        None => Ok(()),
        Some(odd) => {
            let expected = format!("numbers below {n_worlds}, the number of worlds");
            Err(ArenaError::option("worlds", expected, odd))
        }
    }
}

/// Rows of some worlds: positions, (world, drone, 3), and the heights of ground and ceiling, (world, drone).
type Rows<'a, N> = (&'a [N], (&'a mut [N], &'a mut [N]));

/// Writes what drones read into the rows of consecutive worlds, as far as they are wanted.
fn measure_worlds<N: Number>(
    places: &Places,
    first: usize,
    is_wanted: impl Fn(usize) -> bool,
    reads: &[Reads],
    (pos, (ground, ceiling)): Rows<N>,
) -> Result<(), ArenaError> {
    let n = reads.len();
    // The worker of the scene that the last world was in.
    let mut last: Option<(usize, Lent)> = None;
    for k in 0..ground.len() / n {
        let world = first + k;
        if !is_wanted(world) {
            continue;
        }
        let scene = places.layout[world];
        let mut worker = match last.take() {
            Some((known, worker)) if known == scene => worker,
            _ => places.pools[scene].lend()?,
        };
        places.set_obstacles(world, &mut worker)?;
        worker.update()?;
        for (d, reads) in reads.iter().enumerate() {
            let row = k * n + d;
            let at: [f64; 3] = core::array::from_fn(|i| pos[3 * row + i].wide());
            if reads.ground {
                let below = worker.ground_below(at)?;
                ground[row] = N::of(below.map_or(f64::NEG_INFINITY, |height| at[2] - height));
            }
            if reads.ceiling {
                let above = worker.ceiling_above(at)?;
                ceiling[row] = N::of(above.map_or(f64::INFINITY, |distance| at[2] + distance));
            }
        }
        last = Some((scene, worker));
    }
    Ok(())
}
