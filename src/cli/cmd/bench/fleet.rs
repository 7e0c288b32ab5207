//! What is measured: worlds in flight, and what their drones see and touch.

use super::measure::seconds;
use crate::arena::{Arena, CameraConfig, DroneConfig, SceneConfig, Setup, SimConfig, VehicleSource};
use crate::cli::args::BenchArgs;
use crate::cli::cmd::drones::find;
use crate::math::quat;
use crate::physics::controllers::ControlMode;
use crate::physics::rigid_body::State;
use crate::rollout::{Engine, SimOptions};
use crate::scalar::lanes::Number;
use crate::scene::Scene;
use crate::scene::generate::ForestOptions;
use crate::sense::{Camera, Clearance, Contact, DepthBatch};
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
    setup: Setup,
    spawn: [f64; 3],
    spawn_radius: f64,
}

impl Job {
    /// Loads the vehicle and the scene.
    pub fn load(args: &BenchArgs) -> Result<Self> {
        let vehicle = find(&args.drone)?;
        let modes = vehicle.modes(&args.dynamics)?;
        let Some(control) = modes.iter().find(|mode| mode.name() == args.control) else {
            let names: Vec<&str> = modes.iter().map(|mode| mode.name()).collect();
            return Err(Error::Usage {
                flag: "--control",
                expected: format!("{} for {} of {}", names.join(", "), args.dynamics, args.drone),
                got: args.control.clone(),
            });
        };
        let mut camera = CameraConfig { name: args.camera.clone(), ..CameraConfig::default() };
        args.view.change(&mut camera)?;
        let n_worlds = args.worlds.iter().copied().max().unwrap_or(1).max(args.sensing_worlds);
        let config = SimConfig {
            options: SimOptions {
                n_worlds,
                control: *control,
                engine: Engine::Lanes,
                ..SimOptions::default()
            },
            drones: vec![DroneConfig {
                vehicle: VehicleSource::Named(args.drone.clone()),
                dynamics: args.dynamics.clone(),
                shell: args.shell.clone(),
            }],
            scene: Some(match &args.scene {
                Some(path) => SceneConfig::Files(vec![path.clone()]),
                None => SceneConfig::Forest(ForestOptions::default()),
            }),
            camera: Some(camera),
            ..SimConfig::default()
        };
        let setup = config.load()?;
        Ok(Self { setup, spawn: args.spawn, spawn_radius: args.spawn_radius })
    }

    /// The scene with one drone.
    pub fn scene(&self) -> &Scene {
        &self.setup.scenes()[0]
    }

    /// Width and height of images, pixels.
    pub fn size(&self) -> [usize; 2] {
        let camera = &self.setup.cameras()[0][0];
        [camera.width(), camera.height()]
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
        let drone = &self.setup.drones()[0].0;
        let thrust = drone.hover_command() * (1.0 + 0.01 * d);
        let command = match self.setup.config().options.control {
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
                let n = drone.airframe.n_rotors;
                let hover = drone.hover_rotor_vel();
                (0..n).map(|k| hover[k] * (1.0 + 2e-4 * wave(12.9898 + k as f64))).collect()
            }
        };
        (state, command)
    }
}

/// Worlds with one drone each, in the scene, and what their drones saw and touched last.
pub struct Fleet<N: Number> {
    arena: Arena<N>,
    camera: Camera,
    commands: Vec<f64>,
    /// Steps of the episode.
    flown: usize,
    depth: DepthBatch,
    contacts: Vec<Vec<Contact>>,
    limited: Vec<usize>,
    clearances: Vec<Clearance>,
}

impl<N: Number> Fleet<N> {
    /// Worlds at their starts.
    pub fn new(job: &Job, worlds: usize) -> Result<Self> {
        let mut arena: Arena<N> = job.setup.worlds(0, worlds)?;
        let mut commands = Vec::with_capacity(worlds * arena.sim().command_width());
        for world in 0..worlds {
            let (start, command) = job.world(world);
            arena.set_initial(world, 0, start)?;
            commands.extend(command);
        }
        let mut fleet = Self {
            arena,
            camera: job.setup.cameras()[0][0].clone(),
            commands,
            flown: 0,
            depth: DepthBatch::default(),
            contacts: Vec::new(),
            limited: Vec::new(),
            clearances: Vec::new(),
        };
        fleet.begin()?;
        Ok(fleet)
    }

    fn begin(&mut self) -> Result<()> {
        self.flown = 0;
        self.arena.reset(None)?;
        Ok(self.arena.set_command(&self.commands)?)
    }

    /// Advances all worlds; returns the seconds that it took. A new episode begins before, where one is over; that is not
    /// counted.
    pub fn fly(&mut self, steps: usize) -> Result<f64> {
        if self.flown + steps > EPISODE_STEPS {
            self.begin()?;
        }
        self.flown += steps;
        seconds(|| Ok(self.arena.step(steps)?))
    }

    /// Worlds that were stopped since their states were not finite.
    pub fn stopped(&self) -> usize {
        self.arena.sim().n_quarantined()
    }

    /// One depth image of every world.
    pub fn see(&mut self) -> Result<()> {
        let cameras = [std::slice::from_ref(&self.camera)];
        Ok(self.arena.look().frames(&cameras, None, &mut self.depth)?)
    }

    /// Contacts of every drone.
    pub fn touch(&mut self) -> Result<()> {
        Ok(self.arena.contacts(None, &mut self.contacts, &mut self.limited)?)
    }

    /// Clearance of every drone.
    pub fn keep_clear(&mut self) -> Result<()> {
        Ok(self.arena.clearances(None, CLEARANCE_MAX_M, &mut self.clearances)?)
    }
}
