//! How an environment is made of its description and its task.

use std::sync::Arc;

use super::batched::Batched;
use super::judging::Formulas;
use super::rows::Rows;
use super::sensors::Sensors;
use super::world::{OPEN_GROUND_M, Plan, World};
use super::{Asked, Env};
use crate::arena::{Arena, Precision, SceneConfig, Setup};
use crate::env::EnvError;
use crate::env::action::ActionKind;
use crate::env::batch_task::{Batch, BatchTask, Places};
use crate::env::config::{Autoreset, EnvConfig};
use crate::env::layouts::{Course, Layout};
use crate::env::randomize::{LevelRules, Levels};
use crate::env::sensing::NoisySensor;
use crate::env::task::{Channel, STATE, STATE_WIDTH, Task, store};
use crate::env::tasks::{OwnTask, TaskConfig};
use crate::physics::controllers::{ControlMode, Rates};
use crate::physics::drone::Drone;

impl Env {
    /// A batch as `config` says. Not yet reset.
    ///
    /// # Errors
    /// [`EnvError`] for options that make no sense, naming them, and for vehicles and scenes that cannot be used.
    pub fn new(config: EnvConfig) -> Result<Self, EnvError> {
        let task = config.task.task()?;
        Self::build(config, Asked::World(task))
    }

    /// As [`Env::new`], with a task of the caller's instead of that of `config`.
    ///
    /// # Errors
    /// As [`Env::new`], and [`EnvError::Option`] for channels that have no width or no name of their own.
    pub fn with_task(config: EnvConfig, task: Arc<dyn Task>) -> Result<Self, EnvError> {
        Self::own(config, Asked::World(task))
    }

    /// As [`Env::with_task`], with a task that sees all worlds at once.
    ///
    /// # Errors
    /// As [`Env::with_task`].
    pub fn with_batch_task(config: EnvConfig, task: Box<dyn BatchTask>) -> Result<Self, EnvError> {
        let places = Places::of(&*task)?;
        let batched = Batched { task, places, batch: Batch::default() };
        Self::own(config, Asked::Batch(Box::new(batched)))
    }

    /// With a task that is not built in.
    fn own(mut config: EnvConfig, asked: Asked) -> Result<Self, EnvError> {
        config.task = TaskConfig::Own(OwnTask { name: asked.name() });
        let known: Vec<Channel> = STATE.into_iter().chain([Channel::new("depth", 1)]).collect();
        let own = asked.channels();
        for (i, channel) in own.iter().enumerate() {
            let name = &channel.name;
            if name.is_empty() || known.iter().chain(&own[..i]).any(|c| c.name == *name) {
                let expected = "names that differ from each other and from pos, quat, vel, ang_vel and depth";
                return Err(EnvError::option("channels of the task", expected, format!("{name:?}")));
            }
            if channel.width == 0 {
                return Err(EnvError::option(format!("width of the channel {name}"), "at least 1", 0));
            }
        }
        Self::build(config, asked)
    }

    fn build(mut config: EnvConfig, mut asked: Asked) -> Result<Self, EnvError> {
        config.check()?;
        config.action.check()?;
        asked.check(&config)?;
        complete(&mut config, &asked)?;
        let (rest, rules) = LevelRules::part(&config.sim.options.randomization, &config.levels)?;
        let mut flown = config.sim.clone();
        flown.options.randomization = rest;
        let setup = flown.load()?;
        let arena: Arena<f32> = setup.arena()?;
        config.sim.drones = setup.config().drones.clone();
        let layouts = Layout::all(&setup)?;
        for layout in &layouts {
            asked.check_course(&layout.course, layout.scene.name())?;
        }
        if layouts.is_empty() {
            asked.check_course(&Course::default(), "none")?;
        }
        let mut plan = Plan::new(config, &asked, &setup, &arena, rules)?;
        let task = asked.of_worlds().filter(|_| plan.config.sim.n_drones() == 1);
        let formulas = task.and_then(|task| task.formulas()).map(|task| Formulas::new(&task, plan.is_noisy));
        if let Some(formulas) = &formulas {
            plan.compares_actions = formulas.reads_action_change();
            plan.reads_previous = formulas.reads_previous();
            plan.reads_actions = formulas.reads_actions();
        }
        if let Asked::Batch(batched) = &mut asked {
            batched.batch = Batch::new(&plan.config, plan.batch_size(&batched.places));
        }
        let mut env = Self::empty(plan, (asked, formulas), layouts, arena);
        for (number, mounted) in setup.sensors().iter().enumerate() {
            env.take_sensor(number, mounted.sample_hz)?;
        }
        Ok(env)
    }

    /// An environment whose arrays hold nothing yet.
    fn empty(
        plan: Plan,
        (asked, formulas): (Asked, Option<Formulas>),
        layouts: Vec<Layout>,
        arena: Arena<f32>,
    ) -> Self {
        let (n, d) = (plan.config.sim.options.n_worlds, plan.config.sim.n_drones());
        let kept = if plan.config.autoreset == Autoreset::SameStep { n } else { 0 };
        let (row, image) = (d * plan.width, (d * plan.pixels).max(1));
        let world = World::new(&plan);
        Self {
            mask: vec![false; n],
            dues: Vec::with_capacity(plan.config.substeps() as usize),
            reset_done: false,
            begun: false,
            observation: vec![0.0; n * row],
            depth: vec![0.0; n * image],
            reward: vec![0.0; n * d],
            terminated: vec![false; n],
            truncated: vec![false; n],
            ending: vec![0; n],
            // Without a scene nothing is near.
            clearance: vec![plan.config.look_m as f32; n * d],
            crashed: vec![false; n * d],
            action_change: vec![0.0; n * d],
            final_observation: vec![0.0; kept * row],
            final_depth: vec![0.0; kept * image],
            worlds: vec![world; n],
            rows: Rows::new(&plan, asked.memory_len(d)),
            formulas,
            sensors: Sensors::default(),
            layouts,
            arena,
            asked,
            plan,
        }
    }
}

/// Fills in what the action and the task decide, and refuses what an environment has no use for.
pub(super) fn complete(config: &mut EnvConfig, asked: &Asked) -> Result<(), EnvError> {
    let sim = &mut config.sim;
    let (mode, wanted) = (config.action.kind.mode(), sim.options.control);
    if wanted != mode && wanted != ControlMode::default() {
        let expected = format!("{}, which the action commands, or nothing", mode.name());
        return Err(EnvError::option("control", expected, wanted.name()));
    }
    sim.options.control = mode;
    for d in 0..sim.n_drones() {
        let drone = sim.drone(d);
        let modes = drone.vehicle.load()?.modes(&drone.dynamics)?;
        if !modes.contains(&mode) {
            let names: Vec<&str> = modes.iter().map(|m| m.name()).collect();
            let (dynamics, names) = (&drone.dynamics, names.join(", "));
            let expected = format!("one that flies by a control mode of {dynamics} ({names})");
            return Err(EnvError::option("action kind", expected, mode.name()));
        }
    }
    if sim.precision == Precision::F64 {
        return Err(EnvError::option("precision", "f32: environments fly in single precision", "f64"));
    }
    for (name, given) in [
        ("pattern", sim.pattern.is_some()),
        ("layout", sim.layout.is_some()),
        ("open_ground_z_m", sim.open_ground_z_m.is_some_and(|z| z != OPEN_GROUND_M)),
    ] {
        if given {
            let expected = "nothing: in an environment the task says where drones, scenes and the ground are";
            return Err(EnvError::option(name, expected, "one"));
        }
    }
    sim.precision = Precision::F32;
    sim.open_ground_z_m = Some(OPEN_GROUND_M);
    if sim.scene.is_none() {
        let (scene, layouts) = asked.scene();
        sim.layouts = sim.layouts.or(layouts);
        sim.scene = Some(scene);
    }
    let own = asked.camera().filter(|_| sim.scene != Some(SceneConfig::None));
    if let (Some(camera), Some(own)) = (&mut sim.camera, &own)
        && camera.device.is_none()
    {
        // Policies of a task see as far as it is made for, whatever else the camera is.
        camera.range_m = camera.range_m.or(own.range_m);
    }
    sim.camera = sim.camera.take().or(own).filter(|_| config.with_camera);
    Ok(())
}

/// Commands under which a drone at rest stays about where it is, (drone, command); those of set-points are written at the reset.
fn neutral_commands(
    kind: ActionKind,
    drones: &[(Drone<f64>, Rates)],
    width: usize,
    n_rotors: usize,
) -> Vec<f32> {
    let mut out = vec![0.0; drones.len() * width];
    for ((drone, _), out) in drones.iter().zip(out.chunks_exact_mut(width)) {
        let thrust = drone.hover_command();
        match kind {
            ActionKind::Attitude | ActionKind::BodyRate => store(out, &[0.0, 0.0, 0.0, thrust]),
            ActionKind::ForceTorque => store(out, &[thrust, 0.0, 0.0, 0.0]),
            ActionKind::RotorVel => store(out, &drone.hover_rotor_vel()[..n_rotors]),
            ActionKind::Velocity => {}
        }
    }
    out
}

impl Plan {
    /// What `config`, whose scene and camera are chosen, asks for.
    pub(super) fn new(
        config: EnvConfig,
        asked: &Asked,
        setup: &Setup,
        arena: &Arena<f32>,
        rules: LevelRules,
    ) -> Result<Self, EnvError> {
        let (size, range_m, noise) = match &config.sim.camera {
            Some(c) => (c.size()?, c.range()?, c.errors()?),
            None => ([0; 2], [0.0; 2], None),
        };
        let pixels = size[0] * size[1];
        let (drones, data) = (setup.drones(), &arena.sim().data);
        let (command_width, n_rotors) = (data.command_width, data.n_rotors);
        let own: usize = asked.channels().iter().map(|c| c.width).sum();
        let step_s = config.step_s();
        let late = |name: &str, level: f64| (rules.most(name, level).min(1.0) / step_s).round() as usize;
        let delay_s = rules.most("env.action_delay_s", config.levels.action_delay_s);
        let is_late = (delay_s * f64::from(config.sim.options.sim_hz)).round() > 0.0;
        let command_ring =
            if is_late { late("env.action_delay_s", config.levels.action_delay_s) + 2 } else { 0 };
        let depth_ring =
            if pixels == 0 { 1 } else { late("env.depth_delay_s", config.levels.depth_delay_s) + 1 };
        Ok(Self {
            limits: drones.iter().map(|(d, _)| config.action.limits(d, n_rotors)).collect(),
            action_width: config.action.kind.width(n_rotors),
            command_width,
            width: STATE_WIDTH + own,
            command_ring,
            depth_ring,
            pixels,
            size,
            range_m,
            sensor: noise.map(NoisySensor::new),
            neutral: neutral_commands(config.action.kind, drones, command_width, n_rotors),
            no_course: Course::default(),
            is_noisy: rules_may_blur(&rules, &config.levels),
            compares_actions: true,
            reads_previous: false,
            reads_actions: asked.of_worlds().is_some(),
            most_steps: steps_of(config.max_episode_s, step_s),
            rules,
            config,
        })
    }
}

/// Whether the observed state of some episode may differ from the true one.
fn rules_may_blur(rules: &LevelRules, levels: &Levels) -> bool {
    [
        ("env.pos_sigma_m", levels.pos_sigma_m),
        ("env.vel_sigma_m_s", levels.vel_sigma_m_s),
        ("env.attitude_sigma_rad", levels.attitude_sigma_rad),
        ("env.ang_vel_sigma_rad_s", levels.ang_vel_sigma_rad_s),
    ]
    .into_iter()
    .any(|(name, level)| rules.most(name, level) > 0.0)
}

/// Steps after which `time_s` is over: the first that ends within a nanosecond of it, or later.
fn steps_of(time_s: f64, step_s: f64) -> u64 {
    let mut steps = ((time_s / step_s) as u64).saturating_sub(2);
    while (steps as f64 * step_s) < time_s - 1e-9 {
        steps += 1;
    }
    steps
}
