//! Worlds that are reset, flown, seen and judged together.

use rayon::prelude::*;

use super::EnvError;
use super::action::{ActionKind, Limits, SetPoint};
use super::config::{Autoreset, EnvConfig};
use super::layouts::{Course, Layout};
use super::randomize::{LevelRules, Levels};
use super::sensing::{Flown, NoisySensor, feel, look};
use super::tasks::{Beginning, Channel, Images, Outcome, STATE, STATE_WIDTH, Seen, Start, View, store, yaw};
use crate::arena::{Arena, Look, Precision, SceneConfig};
use crate::math::{quat, vec3};
use crate::physics::controllers::{ControlMode, Rates};
use crate::physics::drone::Drone;
use crate::random::{Key, purpose};
use crate::rollout::{Sim, SimData};
use crate::scene::{Pose, Scene};
use crate::sense::NoiseKey;

/// Why an episode has ended, if it has.
#[repr(u8)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Ending {
    /// It goes on.
    #[default]
    None = 0,
    /// A drone touched something, or the ground at height zero where there is no scene.
    Crashed = 1,
    /// A drone left the space of the task.
    Left = 2,
    /// The task is done.
    Done = 3,
    /// Its time is over.
    TimeUp = 4,
    /// The state stopped being finite, and the world was quarantined.
    Quarantined = 5,
}

/// Everything about one world between steps.
#[derive(Clone, Debug)]
struct World {
    layout: usize,
    levels: Levels,
    memory: Vec<f32>,
    starts: Vec<Start>,
    drones: Vec<Flown>,
    /// True states, and as observed.
    seen: Vec<Seen>,
    observed: Vec<Seen>,
    /// (drone, action)
    last_action: Vec<f32>,
    jerk: Vec<f32>,
    set_points: Vec<SetPoint>,
    /// Commands of the last steps, (age, drone, command).
    commands: Vec<f32>,
    camera_poses: Vec<Pose>,
    /// Images without noise, where those observed differ. (drone, height, width)
    clean: Vec<f32>,
    /// Images of the last steps, where they are observed late. (age, drone, height, width)
    ring: Vec<f32>,
    /// Steps of the environment since the reset.
    step: u64,
    /// Episodes before this one.
    episode: u64,
    ended: bool,
    clipped: bool,
}

impl World {
    /// A world of `d` drones before its first episode.
    fn at_rest(plan: &Plan, d: usize) -> Self {
        let apart = plan.pixels > 0 && (plan.sensor.is_some() || plan.depth_ring > 1);
        let rest = Seen {
            pos_m: [0.0; 3],
            quat_xyzw: quat::identity(),
            vel_m_s: [0.0; 3],
            ang_vel_rad_s: [0.0; 3],
            before_m: [0.0; 3],
            clearance_m: plan.config.look_m,
            crashed: false,
        };
        World {
            layout: 0,
            levels: plan.config.levels,
            memory: vec![0.0; plan.config.task.task().memory_len(d)],
            starts: vec![Start::at([0.0; 3]); d],
            drones: vec![Flown { clearance_m: plan.config.look_m, ..Flown::default() }; d],
            seen: vec![rest; d],
            observed: vec![rest; d],
            last_action: vec![0.0; d * plan.action_width],
            jerk: vec![0.0; d],
            set_points: vec![SetPoint::default(); d],
            commands: vec![0.0; plan.command_ring * d * plan.command_width],
            camera_poses: vec![Pose::default(); if plan.pixels == 0 { 0 } else { d }],
            clean: vec![0.0; if apart { d * plan.pixels } else { 0 }],
            ring: vec![0.0; if plan.depth_ring > 1 { plan.depth_ring * d * plan.pixels } else { 0 }],
            step: 0,
            episode: 0,
            ended: false,
            clipped: false,
        }
    }
}

/// Where the results of one world go.
struct Out<'a> {
    observation: &'a mut [f32],
    depth: &'a mut [f32],
    reward: &'a mut [f32],
    terminated: &'a mut bool,
    truncated: &'a mut bool,
    ending: &'a mut u8,
    clearance: &'a mut [f32],
}

/// What is the same for all worlds.
#[derive(Debug)]
struct Plan {
    config: EnvConfig,
    limits: Vec<Limits>,
    action_width: usize,
    command_width: usize,
    /// Numbers observed of one drone.
    width: usize,
    rules: LevelRules,
    /// Commands that are kept.
    command_ring: usize,
    /// Images that are kept; 1: none is late.
    depth_ring: usize,
    /// Pixels of one image; 0 without a camera.
    pixels: usize,
    sensor: Option<NoisySensor>,
    neutral: Vec<f32>,
}

/// A batch of worlds.
pub struct Env {
    plan: Plan,
    layouts: Vec<Layout>,
    arena: Arena<f32>,
    worlds: Vec<World>,
    /// Which worlds to reset; reused.
    mask: Vec<bool>,
    /// Due times of commands within a step; reused.
    dues: Vec<u64>,
    reset_done: bool,
    /// A first reset was tried.
    begun: bool,
    size: [usize; 2],
    range_m: [f64; 2],
    observation: Vec<f32>,
    depth: Vec<f32>,
    reward: Vec<f32>,
    terminated: Vec<bool>,
    truncated: Vec<bool>,
    ending: Vec<u8>,
    clearance: Vec<f32>,
    final_observation: Vec<f32>,
    final_depth: Vec<f32>,
}

impl std::fmt::Debug for Env {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Env")
            .field("config", &self.plan.config)
            .field("layouts", &self.layouts.len())
            .finish_non_exhaustive()
    }
}

/// Height of the ground where there is no scene, m: what drones crash into and what their effects read.
const OPEN_GROUND_M: f64 = 0.0;

/// What random numbers are for.
const BEGIN: u32 = purpose("env.begin");
const LEVELS_OF: u32 = purpose("env.levels");
const LAYOUT: u32 = purpose("env.layout");
const DEPTH: u32 = purpose("env.depth");
const STATE_NOISE: u32 = purpose("env.state");

/// Worlds below which one thread does all, without and with a scene.
const SERIAL: [usize; 2] = [256, 2];

impl Env {
    /// A batch as `config` says. Not yet reset.
    ///
    /// # Errors
    /// [`EnvError`] for options that make no sense, naming them, and for vehicles and scenes that cannot be used.
    pub fn new(mut config: EnvConfig) -> Result<Self, EnvError> {
        config.check()?;
        config.action.check()?;
        config.task.task().check(&config)?;
        complete(&mut config)?;
        let task = config.task.task();
        let (rest, rules) = LevelRules::part(&config.sim.options.randomization, &config.levels)?;
        let mut flown = config.sim.clone();
        flown.options.randomization = rest;
        let setup = flown.load()?;
        let drones = setup.drones();
        let arena: Arena<f32> = setup.arena()?;
        config.sim.drones = setup.config().drones.clone();
        let n_rotors = arena.sim().data.n_rotors;
        let limits: Vec<Limits> = drones.iter().map(|(d, _)| config.action.limits(d, n_rotors)).collect();
        let layouts = Layout::all(&setup)?;
        for layout in &layouts {
            task.check_course(&layout.course, layout.scene.name())?;
        }
        if layouts.is_empty() {
            task.check_course(&Course::default(), "none")?;
        }
        let camera = &config.sim.camera;
        let (size, range_m, noise) = match camera {
            Some(c) => (c.size()?, c.range()?, c.errors()?),
            None => ([0; 2], [0.0; 2], None),
        };
        let pixels = size[0] * size[1];

        let (n, d) = (config.sim.options.n_worlds, drones.len());
        let command_width = arena.sim().data.command_width;
        let own: usize = task.channels().iter().map(|c| c.width).sum();
        let width = STATE_WIDTH + own;
        let action_width = config.action.kind.width(n_rotors);
        let step_s = config.step_s();
        let late = |name: &str, level: f64| (rules.most(name, level).min(1.0) / step_s).round() as usize;
        let command_ring = late("env.action_delay_s", config.levels.action_delay_s) + 2;
        let depth_ring =
            if pixels == 0 { 1 } else { late("env.depth_delay_s", config.levels.depth_delay_s) + 1 };
        let neutral = neutral_commands(config.action.kind, drones, command_width, n_rotors);
        let plan = Plan {
            limits,
            action_width,
            command_width,
            width,
            rules,
            command_ring,
            depth_ring,
            pixels,
            sensor: noise.map(NoisySensor::new),
            neutral,
            config,
        };
        let world = World::at_rest(&plan, d);
        let substeps = plan.config.substeps() as usize;
        let kept = if plan.config.autoreset == Autoreset::SameStep { n } else { 0 };
        let image = (d * pixels).max(1);
        Ok(Self {
            mask: vec![false; n],
            dues: Vec::with_capacity(substeps),
            reset_done: false,
            begun: false,
            size,
            range_m,
            observation: vec![0.0; n * d * width],
            depth: vec![0.0; n * image],
            reward: vec![0.0; n * d],
            terminated: vec![false; n],
            truncated: vec![false; n],
            ending: vec![0; n],
            clearance: vec![0.0; n * d],
            final_observation: vec![0.0; kept * d * width],
            final_depth: vec![0.0; kept * image],
            worlds: vec![world; n],
            layouts,
            arena,
            plan,
        })
    }

    /// What it was made of, with the scene and the camera that the task chose.
    pub fn config(&self) -> &EnvConfig {
        &self.plan.config
    }

    /// What is observed of every drone, in the order of columns of [`Env::observation`].
    pub fn channels(&self) -> Vec<Channel> {
        let own = self.plan.config.task.task().channels();
        STATE.into_iter().chain(own).collect()
    }

    /// Numbers of one drone's action.
    pub fn action_width(&self) -> usize {
        self.plan.action_width
    }

    /// Least and greatest numbers of actions, (drone, action).
    pub fn action_limits(&self) -> (Vec<f32>, Vec<f32>) {
        if self.plan.config.action.normalized {
            let n = self.plan.config.sim.n_drones() * self.plan.action_width;
            return (vec![-1.0; n], vec![1.0; n]);
        }
        let of = |pick: fn(&Limits) -> &Vec<f64>| {
            self.plan.limits.iter().flat_map(|l| pick(l).iter().map(|v| *v as f32)).collect()
        };
        (of(|l| &l.low), of(|l| &l.high))
    }

    /// Width and height of images, zero without a camera.
    pub fn image_size(&self) -> [usize; 2] {
        self.size
    }

    /// Least and greatest depth of images, m.
    pub fn depth_range_m(&self) -> [f64; 2] {
        self.range_m
    }

    /// What was observed, (world, drone, channels): [`Env::channels`] side by side.
    pub fn observation(&mut self) -> &mut [f32] {
        &mut self.observation
    }

    /// Depth images, m, (world, drone, height, width); where nothing is seen stands the greatest depth. Empty without a camera.
    pub fn depth(&mut self) -> &mut [f32] {
        let n = if self.plan.pixels == 0 { 0 } else { self.depth.len() };
        &mut self.depth[..n]
    }

    /// Rewards of the last step, (world, drone).
    pub fn reward(&mut self) -> &mut [f32] {
        &mut self.reward
    }

    /// Whether the episode ended in the last step by what happened, (world).
    pub fn terminated(&mut self) -> &mut [bool] {
        &mut self.terminated
    }

    /// Whether it ended in the last step since its time was over, (world).
    pub fn truncated(&mut self) -> &mut [bool] {
        &mut self.truncated
    }

    /// [`Ending`] of the last step, (world).
    pub fn ending(&mut self) -> &mut [u8] {
        &mut self.ending
    }

    /// Distance to the nearest thing after the last step, m, at most `look_m`, which it is without a scene too. (world, drone)
    pub fn clearance(&mut self) -> &mut [f32] {
        &mut self.clearance
    }

    /// With [`Autoreset::SameStep`]: what worlds that ended in the last step had observed, as [`Env::observation`]; rows of other
    /// worlds mean nothing.
    pub fn final_observation(&mut self) -> &mut [f32] {
        &mut self.final_observation
    }

    /// As [`Env::final_observation`], images.
    pub fn final_depth(&mut self) -> &mut [f32] {
        let n = if self.plan.pixels == 0 { 0 } else { self.final_depth.len() };
        &mut self.final_depth[..n]
    }

    /// Whether an entry of the last action of a world lay outside its limits and was held within them.
    pub fn clipped(&self, world: usize) -> bool {
        self.worlds[world].clipped
    }

    /// Layout in which a world flies, by number.
    pub fn layout(&self, world: usize) -> usize {
        self.worlds[world].layout
    }

    /// The scene of a layout.
    pub fn scene(&self, layout: usize) -> Option<&Scene> {
        self.layouts.get(layout).map(|l| &l.scene)
    }

    /// Gates, places and extent of a layout.
    pub fn course(&self, layout: usize) -> Option<&Course> {
        self.layouts.get(layout).map(|l| &l.course)
    }

    /// Levels of a world's episode.
    pub fn levels(&self, world: usize) -> &Levels {
        &self.worlds[world].levels
    }

    /// The simulation.
    pub fn flight(&self) -> &Sim<f32> {
        self.arena.sim()
    }

    /// The worlds as they are now, to be looked at.
    pub fn look(&self) -> Look<'_, f32> {
        self.arena.look()
    }

    /// Whether a step is shared by threads.
    pub fn is_parallel(&self) -> bool {
        let serial = SERIAL[usize::from(!self.layouts.is_empty())];
        self.worlds.len() >= serial || self.arena.is_parallel(self.plan.config.substeps() as usize)
    }

    /// Begins new episodes in all worlds, or in those whose entry is true. A seed, which needs all worlds, starts the random numbers
    /// anew: everything that follows is that of a new batch with this seed.
    ///
    /// # Errors
    /// [`EnvError::Length`] for a mask of another length, [`EnvError::Option`] for a seed with a mask, [`EnvError::Place`] where a task
    /// finds no place to start from; then no world can be stepped before a reset that succeeds.
    pub fn reset(&mut self, seed: Option<u64>, mask: Option<&[bool]>) -> Result<(), EnvError> {
        let n = self.worlds.len();
        if let Some(mask) = mask
            && mask.len() != n
        {
            let shape = format!("{n} worlds");
            return Err(EnvError::Length { name: "reset mask", expected: n, shape, got: mask.len() });
        }
        if let Some(seed) = seed {
            if mask.is_some_and(|m| m.iter().any(|v| !v)) {
                return Err(EnvError::option("seed", "none with a mask: a seed is that of all worlds", seed));
            }
            self.plan.config.sim.options.seed = seed;
            self.arena.reseed(seed);
        }
        if seed.is_none() && !self.begun {
            // The first episodes are those that the seed of the description gives.
            self.arena.reseed(self.plan.config.sim.options.seed);
        }
        if !self.reset_done && mask.is_some_and(|m| m.iter().any(|v| !v)) {
            return Err(EnvError::option(
                "reset mask",
                "none before the first reset of all worlds",
                "one that leaves worlds out",
            ));
        }
        self.begun = true;
        let mut own = std::mem::take(&mut self.mask);
        match mask {
            Some(mask) => own.copy_from_slice(mask),
            None => own.fill(true),
        }
        let outcome = self.begin(&own);
        let outcome = outcome.and_then(|()| {
            for (w, _) in own.iter().enumerate().filter(|(_, m)| **m) {
                self.terminated[w] = false;
                self.truncated[w] = false;
                self.ending[w] = 0;
                let d = self.plan.config.sim.n_drones();
                self.reward[w * d..(w + 1) * d].fill(0.0);
            }
            self.settle(Some(&own), false)
        });
        self.mask = own;
        self.reset_done = outcome.is_ok();
        outcome
    }

    /// Flies one step of the environment with `actions`, (world, drone, action), judges and observes.
    ///
    /// # Errors
    /// [`EnvError::Length`] and [`EnvError::Action`] for actions that cannot be flown, [`EnvError::Ended`]; nothing is changed then.
    pub fn step(&mut self, actions: &[f32]) -> Result<(), EnvError> {
        let (n, d, width) = (self.worlds.len(), self.plan.config.sim.n_drones(), self.plan.action_width);
        if actions.len() != n * d * width {
            let shape = format!("{n} worlds x {d} drones x {width}");
            return Err(EnvError::Length {
                name: "action",
                expected: n * d * width,
                shape,
                got: actions.len(),
            });
        }
        if let Some(i) = actions.iter().position(|v| !v.is_finite()) {
            let (world, drone, entry) = (i / (d * width), i / width % d, i % width);
            return Err(EnvError::Action { world, drone, entry, got: actions[i] });
        }
        if !self.reset_done {
            return Err(EnvError::option("step", "a reset of all worlds first", "none"));
        }
        let autoreset = self.plan.config.autoreset;
        if autoreset == Autoreset::Disabled
            && let Some(world) = self.worlds.iter().position(|w| w.ended)
        {
            return Err(EnvError::Ended { world });
        }
        let each = d * width;
        let (plan, data) = (&self.plan, &self.arena.sim().data);
        let parallel = self.worlds.len() >= SERIAL[0];
        let act = |(w, (world, action)): (usize, (&mut World, &[f32]))| plan.act(w, world, data, action);
        if parallel {
            self.worlds.par_iter_mut().zip(actions.par_chunks(each)).enumerate().for_each(act);
        } else {
            self.worlds.iter_mut().zip(actions.chunks(each)).enumerate().for_each(act);
        }
        self.fly()?;
        if autoreset == Autoreset::NextStep && self.worlds.iter().any(|w| w.ended) {
            let mut mask = std::mem::take(&mut self.mask);
            for (m, world) in mask.iter_mut().zip(&self.worlds) {
                *m = world.ended;
            }
            let outcome = self.begin(&mask);
            self.mask = mask;
            outcome.inspect_err(|_| self.reset_done = false)?;
        }
        self.settle(None, true)?;
        if autoreset == Autoreset::SameStep && self.worlds.iter().any(|w| w.ended) {
            let mut mask = std::mem::take(&mut self.mask);
            let (row, image) = (d * self.plan.width, (d * self.plan.pixels).max(1));
            for (w, (m, world)) in mask.iter_mut().zip(&self.worlds).enumerate() {
                *m = world.ended;
                if world.ended {
                    let (o, i) = (w * row..(w + 1) * row, w * image..(w + 1) * image);
                    self.final_observation[o.clone()].copy_from_slice(&self.observation[o]);
                    self.final_depth[i.clone()].copy_from_slice(&self.depth[i]);
                }
            }
            let outcome = self.begin(&mask).and_then(|()| self.settle(Some(&mask), false));
            self.mask = mask;
            outcome.inspect_err(|_| self.reset_done = false)?;
        }
        Ok(())
    }

    /// Flies one step of the environment; commands become those of the controllers when they are due.
    fn fly(&mut self) -> Result<(), EnvError> {
        let plan = &self.plan;
        let each = plan.config.sim.n_drones() * plan.command_width;
        let substeps = u64::from(plan.config.substeps());
        self.dues.clear();
        for world in &self.worlds {
            let due = plan.delay(world) % substeps;
            if !self.dues.contains(&due) {
                self.dues.push(due);
            }
        }
        self.dues.sort_unstable();
        let mut flown = 0;
        for i in 0..self.dues.len() {
            let due = self.dues[i];
            if due > flown {
                self.arena.step((due - flown) as usize)?;
                flown = due;
            }
            let data = self.arena.data_mut();
            for (world, row) in self.worlds.iter().zip(data.command.chunks_exact_mut(each)) {
                let delay = plan.delay(world);
                if delay % substeps == due {
                    // Before the first command of an episode the slots hold the neutral one.
                    let ring = plan.command_ring as u64;
                    let slot = ((world.step + ring - delay / substeps) % ring) as usize;
                    row.copy_from_slice(&world.commands[slot * each..(slot + 1) * each]);
                }
            }
        }
        self.arena.step((substeps - flown) as usize)?;
        Ok(())
    }

    /// Begins episodes in the worlds of the mask.
    fn begin(&mut self, mask: &[bool]) -> Result<(), EnvError> {
        self.arena.reset(Some(mask))?;
        let (plan, layouts) = (&self.plan, &self.layouts);
        // Which scene a world is in comes first: tasks look for a start in it.
        for (w, world) in self.worlds.iter_mut().enumerate().filter(|(w, _)| mask[*w]) {
            plan.begin(w, world, layouts.len(), self.arena.sim().data.episodes[w] - 1);
        }
        if !layouts.is_empty() {
            let of_worlds: Vec<usize> = self.worlds.iter().map(|world| world.layout).collect();
            self.arena.set_layout(&of_worlds)?;
        }
        let look = self.arena.look();
        let begin = |(w, world): (usize, &mut World)| {
            if mask[w] { plan.place(w, world, layouts, look) } else { Ok(()) }
        };
        let many = mask.iter().filter(|m| **m).count();
        if many >= SERIAL[usize::from(!layouts.is_empty())] {
            self.worlds.par_iter_mut().enumerate().map(begin).collect::<Result<Vec<()>, _>>()?;
        } else {
            self.worlds.iter_mut().enumerate().try_for_each(begin)?;
        }
        let disturbed = !plan.rules.is_empty() || plan.config.levels.disturb();
        let data = self.arena.data_mut();
        for (w, world) in self.worlds.iter_mut().enumerate().filter(|(w, _)| mask[*w]) {
            for d in 0..plan.config.sim.n_drones() {
                // Rules for `initial.…` have moved it from rest at the origin.
                let (mut s, start) = (data.state(w, d), world.starts[d]);
                s.pos = vec3::add(start.pos_m, s.pos);
                s.vel = vec3::add(start.vel_m_s, s.vel);
                s.quat = quat::normalize(quat::mul(quat::exp([0.0, 0.0, start.yaw_rad]), s.quat));
                data.set_state(w, d, &s);
                world.set_points[d] = SetPoint { pos_m: s.pos, vel_m_s: s.vel, yaw_rad: yaw(s.quat) };
                if disturbed {
                    let row = data.row(w, d);
                    store(&mut data.wind[3 * row..3 * row + 3], &world.levels.wind_m_s);
                    store(&mut data.disturbance_force[3 * row..3 * row + 3], &world.levels.force_n);
                }
            }
            plan.fill_neutral(world);
            let each = world.commands.len() / plan.command_ring;
            data.command[w * each..(w + 1) * each].copy_from_slice(&world.commands[..each]);
        }
        Ok(())
    }

    /// Looks at worlds (those of a mask, or all), judges them where they have flown, and observes.
    fn settle(&mut self, mask: Option<&[bool]>, judge: bool) -> Result<(), EnvError> {
        let (plan, layouts, look) = (&self.plan, &self.layouts, self.arena.look());
        let d = plan.config.sim.n_drones();
        let (row, image) = (d * plan.width, (d * plan.pixels).max(1));
        let one = |w: usize, world: &mut World, out: Out| {
            if mask.is_some_and(|m| !m[w]) {
                return Ok(());
            }
            plan.settle(w, world, layouts.get(world.layout), look, judge, out)
        };
        if self.worlds.len() >= SERIAL[usize::from(!layouts.is_empty())] {
            self.worlds
                .par_iter_mut()
                .zip(self.observation.par_chunks_mut(row))
                .zip(self.depth.par_chunks_mut(image))
                .zip(self.reward.par_chunks_mut(d))
                .zip(self.terminated.par_iter_mut().zip(&mut self.truncated))
                .zip(self.ending.par_iter_mut())
                .zip(self.clearance.par_chunks_mut(d))
                .enumerate()
                .map(
                    |(
                        w,
                        (
                            (((((world, observation), depth), reward), (terminated, truncated)), ending),
                            clearance,
                        ),
                    )| {
                        one(
                            w,
                            world,
                            Out { observation, depth, reward, terminated, truncated, ending, clearance },
                        )
                    },
                )
                .collect::<Result<Vec<()>, _>>()?;
            return Ok(());
        }
        for (w, world) in self.worlds.iter_mut().enumerate() {
            let out = Out {
                observation: &mut self.observation[w * row..(w + 1) * row],
                depth: &mut self.depth[w * image..(w + 1) * image],
                reward: &mut self.reward[w * d..(w + 1) * d],
                terminated: &mut self.terminated[w],
                truncated: &mut self.truncated[w],
                ending: &mut self.ending[w],
                clearance: &mut self.clearance[w * d..(w + 1) * d],
            };
            one(w, world, out)?;
        }
        Ok(())
    }
}

/// Fills in what the action and the task decide, and refuses what an environment has no use for.
fn complete(config: &mut EnvConfig) -> Result<(), EnvError> {
    let task = config.task.task();
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
        ("obstacle_jitter_m", sim.obstacle_jitter_m != 0.0),
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
        let (scene, layouts) = task.scene();
        sim.layouts = sim.layouts.or((scene != SceneConfig::None).then_some(layouts));
        sim.scene = Some(scene);
    }
    let own = task.camera().filter(|_| sim.scene != Some(SceneConfig::None));
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
        let thrust = drone.hover_thrust();
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
    /// Which random numbers a world takes.
    fn key(&self, w: usize, world: &World, purpose: u32) -> Key {
        Key {
            seed: self.config.sim.options.seed,
            world: self.config.sim.options.first_world + w as u64,
            drone: 0,
            // Episodes count from the top bits down, so that steps of two episodes never share a number.
            step: world.episode.rotate_left(40) ^ world.step,
            purpose,
        }
    }

    /// Steps of the simulation that a command takes to a world's drones.
    fn delay(&self, world: &World) -> u64 {
        let steps = world.levels.action_delay_s * f64::from(self.config.sim.options.sim_hz);
        steps.round().clamp(0.0, f64::from(self.config.sim.options.sim_hz)) as u64
    }

    /// Turns the action of a world into its next command.
    fn act(&self, w: usize, world: &mut World, data: &SimData<f32>, action: &[f32]) {
        let each = self.config.sim.n_drones() * self.command_width;
        let slot = world.step as usize % self.command_ring * each;
        let normalized = self.config.action.normalized;
        world.clipped = false;
        for (d, action) in action.chunks_exact(self.action_width).enumerate() {
            let limits = &self.limits[d];
            let last = &mut world.last_action[d * self.action_width..(d + 1) * self.action_width];
            let command =
                &mut world.commands[slot + d * self.command_width..slot + (d + 1) * self.command_width];
            let mut values = [0.0; crate::physics::rigid_body::MAX_ROTORS];
            let mut jerk = 0.0;
            for (i, a) in action.iter().enumerate() {
                let (value, clipped) = limits.value(normalized, i, f64::from(*a));
                values[i] = value;
                world.clipped |= clipped;
                let range =
                    if normalized { 2.0 } else { (limits.high[i] - limits.low[i]).max(f64::MIN_POSITIVE) };
                jerk += (f64::from(a - last[i]).abs() / range).min(1.0);
            }
            last.copy_from_slice(action);
            world.jerk[d] = if world.step == 0 { 0.0 } else { (jerk / self.action_width as f64) as f32 };
            if self.config.action.kind == ActionKind::Velocity {
                let row = data.row(w, d);
                let pos = core::array::from_fn(|k| f64::from(data.pos[3 * row + k]));
                let quat = core::array::from_fn(|k| f64::from(data.quat[4 * row + k]));
                let four = [values[0], values[1], values[2], values[3]];
                let accel = self.config.action.max_accel_m_s2;
                world.set_points[d].follow(four, (pos, yaw(quat)), accel, self.config.step_s(), command);
            } else {
                store(command, &values[..self.command_width]);
            }
        }
    }

    /// Every kept command becomes the neutral one.
    fn fill_neutral(&self, world: &mut World) {
        let each = self.config.sim.n_drones() * self.command_width;
        for commands in world.commands.chunks_exact_mut(each) {
            commands.copy_from_slice(&self.neutral);
            if self.config.action.kind == ActionKind::Velocity {
                for (point, command) in
                    world.set_points.iter().zip(commands.chunks_exact_mut(self.command_width))
                {
                    let mut point = *point;
                    let at = (point.pos_m, point.yaw_rad);
                    point.follow([0.0; 4], at, 1.0, 0.0, command);
                }
            }
        }
    }

    /// Draws an episode: everything but where drones start.
    fn begin(&self, w: usize, world: &mut World, n_layouts: usize, episode: u64) {
        world.episode = episode;
        world.step = 0;
        world.ended = false;
        world.clipped = false;
        world.memory.fill(0.0);
        world.jerk.fill(0.0);
        world.last_action.fill(0.0);
        world.levels = self.rules.draw(&self.config.levels, self.key(w, world, LEVELS_OF));
        if n_layouts > 0 {
            world.layout = self.key(w, world, LAYOUT).stream().below(n_layouts as u64) as usize;
        }
    }

    /// Lets the task place the drones of an episode that has begun.
    fn place(
        &self,
        w: usize,
        world: &mut World,
        layouts: &[Layout],
        look: Look<f32>,
    ) -> Result<(), EnvError> {
        let draw = self.key(w, world, BEGIN).stream();
        let task = self.config.task.task();
        if layouts.is_empty() {
            let course = Course::default();
            let (starts, memory) = (&mut world.starts[..], &mut world.memory[..]);
            return task.begin(&mut Beginning {
                draw,
                world: w,
                course: &course,
                worker: None,
                starts,
                memory,
            });
        }
        let mut worker = look.surroundings(w)?;
        let (starts, memory) = (&mut world.starts[..], &mut world.memory[..]);
        let course = &layouts[world.layout].course;
        task.begin(&mut Beginning { draw, world: w, course, worker: Some(&mut *worker), starts, memory })
    }

    /// Looks at one world, judges it where it has flown, and observes.
    fn settle(
        &self,
        w: usize,
        world: &mut World,
        layout: Option<&Layout>,
        at: Look<f32>,
        judge: bool,
        out: Out,
    ) -> Result<(), EnvError> {
        let data = at.data();
        // A world that has just begun, also within a step, has flown nothing.
        let fresh = data.steps[w] == 0;
        let quarantined = data.quarantine[w].is_some();
        for d in 0..self.config.sim.n_drones() {
            let s = data.state(w, d);
            let drone = &mut world.drones[d];
            drone.before = if fresh { Pose::new(s.pos, s.quat) } else { drone.now };
            drone.now = Pose::new(s.pos, s.quat);
            world.seen[d] = Seen {
                pos_m: s.pos,
                quat_xyzw: s.quat,
                vel_m_s: s.vel,
                ang_vel_rad_s: s.ang_vel,
                before_m: drone.before.pos_m,
                clearance_m: drone.clearance_m,
                crashed: false,
            };
        }
        if judge && !fresh {
            world.step += 1;
        }
        let key = self.key(w, world, DEPTH);
        if let Some(layout) = layout {
            let mut worker = at.world(w)?;
            feel(layout, &mut worker, &mut world.drones, self.config.look_m, fresh || quarantined)?;
            if self.pixels > 0 {
                let apart = !world.clean.is_empty();
                let key = NoiseKey { seed: key.seed, world: key.world, drone: 0, step: key.step, camera: 0 };
                let clean = if apart { &mut world.clean[..] } else { &mut out.depth[..] };
                match &self.sensor {
                    None => look(layout, &mut worker, &mut world.camera_poses, clean, None)?,
                    Some(sensor) => {
                        let noisy = Some((sensor, world.levels.depth_noise, key, &mut out.depth[..]));
                        look(layout, &mut worker, &mut world.camera_poses, &mut world.clean, noisy)?;
                    }
                }
            }
            drop(worker);
            if self.pixels > 0 && !world.clean.is_empty() {
                if self.sensor.is_none() {
                    out.depth.copy_from_slice(&world.clean);
                }
                self.keep_image(world, out.depth);
            }
        } else {
            for drone in &mut world.drones {
                drone.crashed = drone.now.pos_m[2] < OPEN_GROUND_M;
            }
        }
        for (seen, drone) in world.seen.iter_mut().zip(&world.drones) {
            seen.crashed = drone.crashed;
            seen.clearance_m = drone.clearance_m;
        }
        for (to, drone) in out.clearance.iter_mut().zip(&world.drones) {
            *to = drone.clearance_m as f32;
        }
        let none = Course::default();
        let course = layout.map_or(&none, |l| &l.course);
        let view = |drones, images| View {
            time_s: world.step as f64 * self.config.step_s(),
            step_s: self.config.step_s(),
            drones,
            images,
            course,
            jerk: &world.jerk,
        };
        let task = self.config.task.task();
        if judge {
            out.reward.fill(0.0);
            let mut ending = Ending::None;
            if quarantined {
                ending = Ending::Quarantined;
            } else if !fresh {
                let images = layout.filter(|_| self.pixels > 0).map(|layout| Images {
                    depth_m: if world.clean.is_empty() { &*out.depth } else { &world.clean },
                    cameras: &layout.cameras,
                    poses: &world.camera_poses,
                });
                ending = match task.judge(&view(&world.seen, images), &mut world.memory, out.reward) {
                    Outcome::Goes => Ending::None,
                    Outcome::Crashed => Ending::Crashed,
                    Outcome::Left => Ending::Left,
                    Outcome::Done => Ending::Done,
                };
            }
            let time_up = world.step as f64 * self.config.step_s() >= self.config.max_episode_s - 1e-9;
            *out.terminated = ending != Ending::None;
            *out.truncated = ending == Ending::None && time_up;
            *out.ending = if *out.truncated { Ending::TimeUp } else { ending } as u8;
            world.ended = *out.terminated || *out.truncated;
        }
        let noisy = world.levels.is_noisy();
        if noisy {
            let key = self.key(w, world, STATE_NOISE);
            world.observed.copy_from_slice(&world.seen);
            for (d, seen) in world.observed.iter_mut().enumerate() {
                blur(seen, &world.levels, Key { drone: d as u32, ..key });
            }
        }
        let drones = if noisy { &world.observed } else { &world.seen };
        let seen = view(drones, None);
        for (d, (row, s)) in out.observation.chunks_exact_mut(self.width).zip(drones).enumerate() {
            store(&mut row[0..], &s.pos_m);
            store(&mut row[3..], &s.quat_xyzw);
            store(&mut row[7..], &s.vel_m_s);
            store(&mut row[10..], &s.ang_vel_rad_s);
            task.observe(&seen, &world.memory, d, &mut row[STATE_WIDTH..]);
        }
        Ok(())
    }

    /// Keeps the newest image and puts the one that is observed now in its place.
    fn keep_image(&self, world: &mut World, depth: &mut [f32]) {
        if self.depth_ring == 1 {
            return;
        }
        let n = depth.len();
        let ring = self.depth_ring as u64;
        let late = (world.levels.depth_delay_s / self.config.step_s()).round() as u64;
        let newest = (world.step % ring) as usize;
        world.ring[newest * n..(newest + 1) * n].copy_from_slice(depth);
        let shown = (world.step.saturating_sub(late.min(ring - 1)) % ring) as usize;
        depth.copy_from_slice(&world.ring[shown * n..(shown + 1) * n]);
    }
}

/// Adds noise to an observed state.
fn blur(seen: &mut Seen, levels: &Levels, key: Key) {
    let mut draw = key.stream();
    let mut add = |v: [f64; 3], sigma: f64| v.map(|v| v + sigma * draw.normal());
    seen.pos_m = add(seen.pos_m, levels.pos_sigma_m);
    seen.vel_m_s = add(seen.vel_m_s, levels.vel_sigma_m_s);
    seen.ang_vel_rad_s = add(seen.ang_vel_rad_s, levels.ang_vel_sigma_rad_s);
    let turn = add([0.0; 3], levels.attitude_sigma_rad);
    seen.quat_xyzw = quat::normalize(quat::mul(seen.quat_xyzw, quat::exp(turn)));
}
