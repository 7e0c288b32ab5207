//! What is measured: worlds in flight, and what their drones see and touch.

use super::measure::seconds;
use crate::cli::args::BenchArgs;
use crate::cli::cmd::drones::find;
use crate::cli::cmd::fly::{camera, shell};
use crate::math::quat;
use crate::physics::controllers::{ControlMode, Rates};
use crate::physics::drone::Drone;
use crate::physics::rigid_body::State;
use crate::rollout::{Engine, Sim, SimOptions};
use crate::scalar::lanes::Number;
use crate::scene::generate::{self, ForestOptions};
use crate::scene::{Scene, SceneSource, WorkerPool};
use crate::sense::{
    Camera, Clearance, Contact, DepthBatch, WorldPoses, clearance_batch, contacts_batch, render_batch,
};
use crate::{Error, Result};

/// Steps of one call.
pub const STEPS: usize = 50;
/// Steps between two depth images: 20 a second.
pub const STEPS_PER_FRAME: usize = 25;
/// Steps of an episode. What rests for longer decays to numbers that processors are slow with.
const EPISODE_STEPS: usize = 2000;
/// Clearances beyond this are not looked for, m.
const CLEARANCE_MAX_M: f64 = 5.0;

/// What the arguments name, loaded and checked.
pub struct Job {
    drone: Drone<f64>,
    rates: Rates,
    control: ControlMode,
    spawn: [f64; 3],
    spawn_radius: f64,
    /// The scene with one drone.
    pub scene: Scene,
    camera: Camera,
}

impl Job {
    /// Loads the vehicle and the scene.
    pub fn load(args: &BenchArgs) -> Result<Self> {
        let vehicle = find(&args.drone)?;
        let drone = vehicle.drone(&args.dynamics)?;
        let modes = vehicle.modes(&args.dynamics)?;
        let Some(control) = modes.iter().find(|mode| mode.name() == args.control) else {
            let names: Vec<&str> = modes.iter().map(|mode| mode.name()).collect();
            return Err(Error::Usage {
                flag: "--control",
                expected: format!("{} for {} of {}", names.join(", "), args.dynamics, args.drone),
                got: args.control.clone(),
            });
        };
        let source = match &args.scene {
            Some(path) => SceneSource::file(path),
            None => SceneSource::text("forest", generate::forest(&ForestOptions::default())?),
        };
        let scene = Scene::build(&source, &[shell(args.shell.as_deref(), &vehicle)?])?;
        let camera = camera(&args.camera, &args.view, &scene, 0)?;
        Ok(Self {
            drone,
            rates: vehicle.rates,
            control: *control,
            spawn: args.spawn,
            spawn_radius: args.spawn_radius,
            scene,
            camera,
        })
    }

    /// Start and command of a world: no two alike.
    fn world(&self, world: usize) -> (State<f64>, Vec<f64>) {
        let wave = |k: f64| ((world + 1) as f64 * k).sin();
        let [a, b, c, d] = [wave(12.9898), wave(78.233), wave(37.719), wave(4.581)];
        let yaw = 3.0 * wave(1.7);
        let [x, y, z] = self.spawn;
        let state = State {
            pos: [x + self.spawn_radius * b, y + self.spawn_radius * c, z],
            quat: quat::exp([0.0, 0.0, yaw]),
            ..State::rest()
        };
        let thrust = self.drone.hover_thrust() * (1.0 + 0.01 * d);
        let command = match self.control {
            ControlMode::State => {
                [&[x + 2.0 * a, y + 2.0 * b, z + 0.3 * c][..], &[0.0; 6], &state.quat, &[0.0; 3]].concat()
            }
            ControlMode::Attitude => vec![0.1 * a, 0.1 * b, yaw + 0.1 * c, thrust],
            ControlMode::BodyRate => vec![0.05 * a, 0.05 * b, 0.05 * c, thrust],
            ControlMode::ForceTorque => {
                // As of a thrust that acts beside the centre of mass by up to a micrometre.
                let torque = [a, b, c].map(|wave| 1e-6 * thrust * wave);
                [&[thrust][..], &torque].concat()
            }
            ControlMode::RotorVel => {
                let n = self.drone.airframe.n_rotors;
                let hover = self.drone.hover_rotor_vel();
                (0..n).map(|k| hover[k] * (1.0 + 2e-4 * wave(12.9898 + k as f64))).collect()
            }
        };
        (state, command)
    }
}

/// Worlds with one drone each.
pub struct Fleet<N: Number> {
    sim: Sim<N>,
    commands: Vec<f64>,
    /// Steps of the episode.
    flown: usize,
}

impl<N: Number> Fleet<N> {
    /// Worlds at their starts.
    pub fn new(job: &Job, worlds: usize) -> Result<Self> {
        let options = SimOptions {
            n_worlds: worlds,
            control: job.control,
            engine: Engine::Lanes,
            ..SimOptions::default()
        };
        let mut sim = Sim::<N>::storing(options, vec![(job.drone.clone(), job.rates)])?;
        let mut commands = Vec::with_capacity(worlds * sim.command_width());
        for world in 0..worlds {
            let (start, command) = job.world(world);
            sim.set_initial(world, 0, start)?;
            commands.extend(command);
        }
        let mut fleet = Self { sim, commands, flown: 0 };
        fleet.begin()?;
        Ok(fleet)
    }

    fn begin(&mut self) -> Result<()> {
        self.flown = 0;
        self.sim.reset(None)?;
        Ok(self.sim.set_command(&self.commands)?)
    }

    /// Advances all worlds; returns the seconds that it took. A new episode begins before, where one is over; that is not
    /// counted.
    pub fn fly(&mut self, steps: usize) -> Result<f64> {
        if self.flown + steps > EPISODE_STEPS {
            self.begin()?;
        }
        self.flown += steps;
        seconds(|| Ok(self.sim.step(steps)?))
    }

    /// Worlds that were stopped since their states were not finite.
    pub fn stopped(&self) -> usize {
        self.sim.data.quarantine.iter().flatten().count()
    }
}

/// Depth, contacts and clearances of many worlds.
pub struct Senses {
    pool: WorkerPool,
    camera: Camera,
    pos: Vec<f64>,
    quat: Vec<f64>,
    depth: DepthBatch,
    contacts: Vec<Vec<Contact>>,
    limited: Vec<usize>,
    clearances: Vec<Clearance>,
}

impl Senses {
    /// Nothing seen yet.
    pub fn new(job: &Job) -> Self {
        Self {
            pool: WorkerPool::new(&job.scene),
            camera: job.camera.clone(),
            pos: Vec::new(),
            quat: Vec::new(),
            depth: DepthBatch::default(),
            contacts: Vec::new(),
            limited: Vec::new(),
            clearances: Vec::new(),
        }
    }

    /// Takes over the poses of all drones.
    pub fn follow<N: Number>(&mut self, fleet: &Fleet<N>) {
        self.pos.clear();
        self.pos.extend(fleet.sim.data.pos.iter().map(|v| v.wide()));
        self.quat.clear();
        self.quat.extend(fleet.sim.data.quat.iter().map(|v| v.wide()));
    }

    fn poses(&self) -> WorldPoses<'_> {
        WorldPoses {
            n_worlds: self.pos.len() / 3,
            drone_pos_m: &self.pos,
            drone_quat_xyzw: &self.quat,
            obstacle_pos_m: None,
            obstacle_quat_xyzw: None,
        }
    }

    /// One depth image of every world.
    pub fn depth(&mut self) -> Result<()> {
        let mut out = std::mem::take(&mut self.depth);
        let done = render_batch(&self.pool, std::slice::from_ref(&self.camera), &self.poses(), &mut out);
        self.depth = out;
        Ok(done?)
    }

    /// Contacts of every drone.
    pub fn contacts(&mut self) -> Result<()> {
        let (mut out, mut limited) = (std::mem::take(&mut self.contacts), std::mem::take(&mut self.limited));
        let done = contacts_batch(&self.pool, &self.poses(), &mut out, &mut limited);
        (self.contacts, self.limited) = (out, limited);
        Ok(done?)
    }

    /// Clearance of every drone.
    pub fn clearances(&mut self) -> Result<()> {
        let mut out = std::mem::take(&mut self.clearances);
        let done = clearance_batch(&self.pool, &self.poses(), CLEARANCE_MAX_M, &mut out);
        self.clearances = out;
        Ok(done?)
    }
}
