//! The exchange of places of a swarm task, in which a policy is trained by gradients that flies every drone by what it knows of the nearest others.

use std::sync::Arc;
use std::time::Instant;

use super::Asked;
use super::crossing::{Crossed, actions_of, options_of, ready};
use crate::env::EnvError;
use crate::env::config::EnvConfig;
use crate::env::layouts::Layout;
use crate::env::task::{EpisodeStart, Start, Task};
use crate::env::tasks::{SwarmCross, TaskConfig};
use crate::learn::goals::Swap;
use crate::learn::{Options, Surroundings, train_sighted};
use crate::physics::rigid_body::State;
use crate::random::{Key, Stream, purpose};
use crate::scene::WorkerPool;

/// Open air in which drones change places.
struct Open {
    task: SwarmCross,
    layout: Layout,
    pool: WorkerPool,
    drones: usize,
    /// Where those of the world that begins start and go.
    begun: Vec<(State<f64>, [f64; 3])>,
}

impl Open {
    /// Places of all drones of a world, as in the environment.
    fn places(&mut self, key: Key, world: usize) -> Result<(), EnvError> {
        let mut worker = self.pool.lend()?;
        let each = self.task.memory_len(1);
        let (mut starts, mut memory) =
            (vec![Start::at([0.0; 3]); self.drones], vec![0.0; self.drones * each]);
        let mut start = EpisodeStart {
            draw: key.stream(),
            world,
            course: &self.layout.course,
            worker: Some(&mut worker),
            goal: None,
            starts: &mut starts,
            memory: &mut memory,
        };
        self.task.begin(&mut start)?;
        let of = |(start, memory): (&Start, &[f32])| {
            let quat = start.quat_xyzw();
            let state = State { pos: start.pos_m, vel: start.vel_m_s, quat, ..State::rest() };
            (state, [0, 1, 2].map(|k| f64::from(memory[k])))
        };
        self.begun = starts.iter().zip(memory.chunks_exact(each)).map(of).collect();
        Ok(())
    }
}

impl Surroundings for Open {
    fn sights(&self) -> usize {
        0
    }

    fn drones(&self) -> usize {
        self.drones
    }

    fn begin(
        &mut self,
        drone: usize,
        episode: u64,
        random: &mut Stream,
    ) -> Result<(State<f64>, [f64; 3]), String> {
        let (world, number) = (drone / self.drones, drone % self.drones);
        if number == 0 {
            let key = Key {
                seed: random.below(1 << 62),
                world: world as u64,
                drone: 0,
                step: episode,
                purpose: purpose("env.swapping"),
            };
            self.places(key, world).map_err(|e| e.to_string())?;
        }
        Ok(self.begun[number])
    }

    fn see(&self, _: usize, _: [f32; 3], _: [f32; 4], _: &mut [f32]) {}

    fn fault(&self) -> Option<String> {
        None
    }

    /// Above the ground.
    fn distance(&self, _: usize, pos_m: [f32; 3]) -> (f32, [f32; 3]) {
        (pos_m[2], [0.0, 0.0, 1.0])
    }
}

/// Trains a policy by which each drone of a swarm flies to its place on the other side ([`TaskConfig::SwarmCross`], with attitude actions, 2, 4, 8 or 16 drones of one
/// vehicle), by what it knows of the nearest others, by backpropagation through time. The environment says what flies, from where to where, how many others each knows of,
/// how often it acts and how far actions reach; `options` the rest, as in [`train_crossing`](super::crossing::train_crossing), with a lane for each drone. Drones are trained as if none felt
/// the air of another.
///
/// # Errors
/// [`EnvError::Option`] for another task and other actions, for several vehicles, and for scenes in which anything but the ground stands; those of
/// [`Env::new`](crate::env::Env::new) and of [`train_sighted`].
pub fn train_swapping(mut config: EnvConfig, goal: &Swap, options: &Options) -> Result<Crossed, EnvError> {
    let began = Instant::now();
    let TaskConfig::SwarmCross(task) = config.task else {
        return Err(EnvError::option("task", "swarm_cross", config.task.name()));
    };
    config.with_camera = false;
    let (setup, mut layouts) = ready(&mut config, &Asked::World(Arc::new(task)))?;
    let layout = layouts.swap_remove(0);
    if layout.course.extent_m.is_some() {
        let expected = "one in which nothing but the ground stands: the policy knows of other drones alone";
        return Err(EnvError::option("scene", expected, layout.scene.name()));
    }
    let drone = config.sim.drone(0);
    let drones = config.sim.n_drones();
    if let Some(other) = (1..drones).find(|d| config.sim.drone(*d) != drone) {
        let expected = "one vehicle with the same dynamics for all drones, which one policy flies";
        return Err(EnvError::option("drones", expected, format!("another one for drone {other}")));
    }
    let (actions, options) = (actions_of(&config, &setup), options_of(&config, options));
    let pool = WorkerPool::new(&layout.scene);
    let mut open = Open { task, layout, pool, drones, begun: Vec::new() };
    let prepared = began.elapsed().as_secs_f64();
    let vehicle = setup.vehicles()[0].clone();
    let goal = Swap { neighbours: task.neighbours, ..*goal };
    let trained = train_sighted(&goal, &mut open, (&vehicle, &drone.dynamics), &actions, &options)
        .map_err(EnvError::from)?;
    Ok(Crossed { trained, seconds: [prepared, began.elapsed().as_secs_f64()] })
}
