//! One world between steps: what it remembers, and how it is commanded, looked at, judged and observed.

use super::Ending;
use crate::arena::Look;
use crate::env::EnvError;
use crate::env::action::{ActionKind, Limits, SetPoint};
use crate::env::batch_task::episode_key;
use crate::env::config::EnvConfig;
use crate::env::layouts::{Course, Layout};
use crate::env::randomize::{LevelRules, Levels};
use crate::env::sensing::{Flown, NoisySensor, render_depth, update_collisions};
use crate::env::task::{DroneView, EpisodeStart, Images, STATE_WIDTH, Start, Task, WorldView, store, yaw};
use crate::math::quat;
use crate::random::{Key, purpose};
use crate::rollout::SimData;
use crate::scene::Pose;
use crate::sense::NoiseKey;

/// Everything about one world between steps.
#[derive(Clone, Debug)]
pub(super) struct World {
    pub layout: usize,
    pub levels: Levels,
    /// When a command is flown: whole steps of the environment later, and so many steps of the simulation into that step.
    pub late: u64,
    pub due: u64,
    pub memory: Vec<f32>,
    pub starts: Vec<Start>,
    pub drones: Vec<Flown>,
    /// True states, and as observed.
    pub seen: Vec<DroneView>,
    pub observed: Vec<DroneView>,
    /// (drone, action)
    pub last_action: Vec<f32>,
    pub set_points: Vec<SetPoint>,
    /// Commands of the last steps, (age, drone, command).
    pub commands: Vec<f32>,
    pub camera_poses: Vec<Pose>,
    /// Images without noise, where those observed differ. (drone, height, width)
    pub clean: Vec<f32>,
    /// Images of the last steps, where they are observed late. (age, drone, height, width)
    pub ring: Vec<f32>,
    /// Steps of the environment since the reset.
    pub step: u64,
    /// Episodes before this one.
    pub episode: u64,
    pub ended: bool,
    pub clipped: bool,
}

impl World {
    /// A world that has not begun, whose task remembers `memory_len` numbers.
    pub(super) fn new(plan: &Plan, memory_len: usize) -> Self {
        let (config, d) = (&plan.config, plan.config.sim.n_drones());
        let rest = DroneView {
            pos_m: [0.0; 3],
            quat_xyzw: quat::identity(),
            vel_m_s: [0.0; 3],
            ang_vel_rad_s: [0.0; 3],
            previous_pos_m: [0.0; 3],
            clearance_m: config.look_m,
            crashed: false,
        };
        let (rings, pixels) = (plan.depth_ring, plan.pixels);
        let apart = pixels > 0 && (plan.sensor.is_some() || rings > 1);
        let [late, due] = plan.delay(&config.levels);
        Self {
            layout: 0,
            levels: config.levels,
            late,
            due,
            memory: vec![0.0; memory_len],
            starts: vec![Start::at([0.0; 3]); d],
            drones: vec![Flown { clearance_m: config.look_m, ..Flown::default() }; d],
            seen: vec![rest; d],
            observed: vec![rest; d],
            last_action: vec![0.0; d * plan.action_width],
            set_points: vec![SetPoint::default(); d],
            commands: vec![0.0; plan.command_ring * d * plan.command_width],
            camera_poses: vec![Pose::default(); if pixels == 0 { 0 } else { d }],
            clean: vec![0.0; if apart { d * pixels } else { 0 }],
            ring: vec![0.0; if rings > 1 { rings * d * pixels } else { 0 }],
            step: 0,
            episode: 0,
            ended: false,
            clipped: false,
        }
    }
}

/// Where the results of one world go.
pub(super) struct Out<'a> {
    pub observation: &'a mut [f32],
    pub depth: &'a mut [f32],
    pub reward: &'a mut [f32],
    pub terminated: &'a mut bool,
    pub truncated: &'a mut bool,
    pub ending: &'a mut u8,
    pub clearance: &'a mut [f32],
    pub crashed: &'a mut [bool],
    /// What the action of this step changed.
    pub action_change: &'a [f32],
}

/// What is the same for all worlds.
#[derive(Debug)]
pub(super) struct Plan {
    pub config: EnvConfig,
    pub limits: Vec<Limits>,
    pub action_width: usize,
    pub command_width: usize,
    /// Numbers observed of one drone.
    pub width: usize,
    pub rules: LevelRules,
    /// Commands that are kept.
    pub command_ring: usize,
    /// Images that are kept; 1: none is late.
    pub depth_ring: usize,
    /// Pixels of one image; 0 without a camera.
    pub pixels: usize,
    /// Width and height of images, and least and greatest depth, m; zero without a camera.
    pub size: [usize; 2],
    pub range_m: [f64; 2],
    pub sensor: Option<NoisySensor>,
    pub neutral: Vec<f32>,
    /// That of worlds without a scene.
    pub no_course: Course,
}

/// Height of the ground where there is no scene, m: what drones crash into and what their effects read.
pub(super) const OPEN_GROUND_M: f64 = 0.0;

/// What random numbers are for.
pub(super) const FREE_PLACES: u32 = purpose("env.free_places");
const LEVELS_OF: u32 = purpose("env.levels");
const LAYOUT: u32 = purpose("env.layout");
const DEPTH: u32 = purpose("env.depth");
const STATE_NOISE: u32 = purpose("env.state");

impl Plan {
    /// Which random numbers a world takes.
    pub(super) fn key(&self, w: usize, world: &World, purpose: u32) -> Key {
        episode_key(self.config.sim.options.origin(w), world.episode, world.step, purpose)
    }

    /// What a command takes to the drones: whole steps of the environment, and further steps of the simulation.
    fn delay(&self, levels: &Levels) -> [u64; 2] {
        let steps = levels.action_delay_s * f64::from(self.config.sim.options.sim_hz);
        let steps = steps.round().clamp(0.0, f64::from(self.config.sim.options.sim_hz)) as u64;
        let substeps = u64::from(self.config.substeps());
        [steps / substeps, steps % substeps]
    }

    /// Turns the action of a world into its next command, and says how much each drone's changed.
    pub(super) fn act(
        &self,
        w: usize,
        world: &mut World,
        data: &SimData<f32>,
        action: &[f32],
        action_change: &mut [f32],
    ) {
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
            let mut change = 0.0;
            for (i, a) in action.iter().enumerate() {
                let (value, clipped) = limits.value(normalized, i, f64::from(*a));
                values[i] = value;
                world.clipped |= clipped;
                let range =
                    if normalized { 2.0 } else { (limits.high[i] - limits.low[i]).max(f64::MIN_POSITIVE) };
                change += (f64::from(a - last[i]).abs() / range).min(1.0);
            }
            last.copy_from_slice(action);
            action_change[d] = if world.step == 0 { 0.0 } else { (change / self.action_width as f64) as f32 };
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
    pub(super) fn fill_neutral(&self, world: &mut World) {
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
    pub(super) fn begin(&self, w: usize, world: &mut World, n_layouts: usize, episode: u64) {
        world.episode = episode;
        world.step = 0;
        world.ended = false;
        world.clipped = false;
        world.memory.fill(0.0);
        world.last_action.fill(0.0);
        world.levels = self.rules.draw(&self.config.levels, self.key(w, world, LEVELS_OF));
        [world.late, world.due] = self.delay(&world.levels);
        if n_layouts > 0 {
            world.layout = self.key(w, world, LAYOUT).stream().below(n_layouts as u64) as usize;
        }
    }

    /// Lets the task place the drones of an episode that has begun, with goals if some are given.
    pub(super) fn place(
        &self,
        w: usize,
        world: &mut World,
        layouts: &[Layout],
        look: Look<f32>,
        (task, purpose): (&dyn Task, u32),
        goal: Option<&[[f64; 3]]>,
    ) -> Result<(), EnvError> {
        let draw = self.key(w, world, purpose).stream();
        let course = layouts.get(world.layout).map_or(&self.no_course, |l| &l.course);
        let mut worker = if layouts.is_empty() { None } else { Some(look.surroundings(w)?) };
        let (starts, memory) = (&mut world.starts[..], &mut world.memory[..]);
        let worker = worker.as_deref_mut();
        task.begin(&mut EpisodeStart { draw, world: w, course, worker, goal, starts, memory })
    }

    /// Looks at one world, observes it, and, where it has flown, judges it. What a task that sees all worlds at once says of it comes
    /// later, where `task` is none.
    pub(super) fn observe_and_judge(
        &self,
        task: Option<&dyn Task>,
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
        self.update_poses(w, world, data, fresh);
        if judge && !fresh {
            world.step += 1;
        }
        self.sense(w, world, layout, at, fresh || quarantined, out.depth)?;
        for (d, drone) in world.drones.iter().enumerate() {
            out.clearance[d] = drone.clearance_m as f32;
            out.crashed[d] = drone.crashed;
        }
        if judge {
            out.reward.fill(0.0);
        }
        if let Some(task) = task.filter(|_| judge) {
            let ending = match (quarantined, fresh) {
                (true, _) => Ending::Quarantined,
                (_, true) => Ending::None,
                _ => {
                    self.judge(task, (w, world), (layout, at), out.depth, (out.action_change, out.reward))?
                }
            };
            self.conclude(world, ending, (out.terminated, out.truncated, out.ending));
        }
        self.observe(task, (w, world), (layout, at), (out.action_change, out.observation));
        Ok(())
    }

    /// Where the drones of a world are and were.
    pub(super) fn update_poses(&self, w: usize, world: &mut World, data: &SimData<f32>, fresh: bool) {
        for d in 0..self.config.sim.n_drones() {
            let row = data.row(w, d);
            let three = |of: &[f32]| core::array::from_fn(|k| f64::from(of[3 * row + k]));
            let now =
                Pose::new(three(&data.pos), core::array::from_fn(|k| f64::from(data.quat[4 * row + k])));
            let drone = &mut world.drones[d];
            drone.before = if fresh { now } else { drone.now };
            drone.now = now;
            world.seen[d] = DroneView {
                pos_m: now.pos_m,
                quat_xyzw: now.quat_xyzw,
                vel_m_s: three(&data.vel),
                ang_vel_rad_s: three(&data.ang_vel),
                previous_pos_m: drone.before.pos_m,
                clearance_m: drone.clearance_m,
                crashed: false,
            };
        }
    }

    /// What the drones of a world touched and see. `still`: they did not fly here.
    pub(super) fn sense(
        &self,
        w: usize,
        world: &mut World,
        layout: Option<&Layout>,
        at: Look<f32>,
        still: bool,
        depth: &mut [f32],
    ) -> Result<(), EnvError> {
        if let Some(layout) = layout {
            let mut worker = at.world(w)?;
            update_collisions(&mut worker, &mut world.drones, self.config.look_m, still)?;
            if self.pixels > 0 {
                let apart = !world.clean.is_empty();
                let key = self.key(w, world, DEPTH);
                let key = NoiseKey { seed: key.seed, world: key.world, drone: 0, step: key.step, camera: 0 };
                let clean = if apart { &mut world.clean[..] } else { &mut depth[..] };
                match &self.sensor {
                    None => render_depth(layout, &mut worker, &mut world.camera_poses, clean, None)?,
                    Some(sensor) => {
                        let noisy = Some((sensor, world.levels.depth_noise, key, &mut depth[..]));
                        render_depth(layout, &mut worker, &mut world.camera_poses, &mut world.clean, noisy)?;
                    }
                }
            }
            drop(worker);
            if self.pixels > 0 && !world.clean.is_empty() {
                if self.sensor.is_none() {
                    depth.copy_from_slice(&world.clean);
                }
                self.keep_image(world, depth);
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
        Ok(())
    }

    /// What a task sees of a world.
    pub(super) fn view<'a>(
        &self,
        (w, world): (usize, &World),
        look: Look<'a, f32>,
        (drones, action_change): (&'a [DroneView], &'a [f32]),
        images: Option<Images<'a>>,
        course: &'a Course,
    ) -> WorldView<'a> {
        WorldView {
            time_s: world.step as f64 * self.config.step_s(),
            step_s: self.config.step_s(),
            drones,
            images,
            course,
            action_change,
            world: w,
            look,
        }
    }

    /// What a task says of a step.
    pub(super) fn judge(
        &self,
        task: &dyn Task,
        (w, world): (usize, &mut World),
        (layout, look): (Option<&Layout>, Look<f32>),
        depth: &[f32],
        (action_change, reward): (&[f32], &mut [f32]),
    ) -> Result<Ending, EnvError> {
        let course = layout.map_or(&self.no_course, |l| &l.course);
        let images = layout.filter(|_| self.pixels > 0).map(|layout| Images {
            depth_m: if world.clean.is_empty() { depth } else { &world.clean },
            cameras: &layout.cameras,
            poses: &world.camera_poses,
        });
        let mut memory = std::mem::take(&mut world.memory);
        let view = self.view((w, world), look, (&world.seen, action_change), images, course);
        let outcome = task.judge(&view, &mut memory, reward);
        world.memory = memory;
        check_rewards(w, reward)?;
        Ok(outcome.into())
    }

    /// Ends an episode, or lets it go on: writes whether it was terminated or truncated, and why it ended.
    pub(super) fn conclude(&self, world: &mut World, ending: Ending, out: (&mut bool, &mut bool, &mut u8)) {
        let (terminated, truncated, number) = out;
        let time_up = world.step as f64 * self.config.step_s() >= self.config.max_episode_s - 1e-9;
        *terminated = ending != Ending::None;
        *truncated = ending == Ending::None && time_up;
        *number = if *truncated { Ending::TimeUp } else { ending } as u8;
        world.ended = *terminated || *truncated;
    }

    /// Writes what is observed of a world: the state, with noise where there is some, and what the task adds.
    pub(super) fn observe(
        &self,
        task: Option<&dyn Task>,
        (w, world): (usize, &mut World),
        (layout, look): (Option<&Layout>, Look<f32>),
        (action_change, out): (&[f32], &mut [f32]),
    ) {
        let noisy = world.levels.is_noisy();
        if noisy {
            let key = self.key(w, world, STATE_NOISE);
            world.observed.copy_from_slice(&world.seen);
            for (d, seen) in world.observed.iter_mut().enumerate() {
                blur(seen, &world.levels, Key { drone: d as u32, ..key });
            }
        }
        let drones = if noisy { &world.observed } else { &world.seen };
        let course = layout.map_or(&self.no_course, |l| &l.course);
        let view = self.view((w, world), look, (drones, action_change), None, course);
        for (d, (row, s)) in out.chunks_exact_mut(self.width).zip(drones).enumerate() {
            store(&mut row[0..], &s.pos_m);
            store(&mut row[3..], &s.quat_xyzw);
            store(&mut row[7..], &s.vel_m_s);
            store(&mut row[10..], &s.ang_vel_rad_s);
            if let Some(task) = task {
                task.observe(&view, &world.memory, d, &mut row[STATE_WIDTH..]);
            }
        }
    }

    /// Keeps the newest image and puts the one that is observed now in its place.
    pub(super) fn keep_image(&self, world: &mut World, depth: &mut [f32]) {
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

/// Refuses rewards of a world's drones that are no numbers.
pub(super) fn check_rewards(world: usize, reward: &[f32]) -> Result<(), EnvError> {
    match reward.iter().position(|v| !v.is_finite()) {
        None => Ok(()),
        Some(drone) => Err(EnvError::NotFinite { what: "reward".into(), world, drone, got: reward[drone] }),
    }
}

/// Adds noise to an observed state.
fn blur(seen: &mut DroneView, levels: &Levels, key: Key) {
    let mut draw = key.stream();
    let mut add = |v: [f64; 3], sigma: f64| v.map(|v| v + sigma * draw.normal());
    seen.pos_m = add(seen.pos_m, levels.pos_sigma_m);
    seen.vel_m_s = add(seen.vel_m_s, levels.vel_sigma_m_s);
    seen.ang_vel_rad_s = add(seen.ang_vel_rad_s, levels.ang_vel_sigma_rad_s);
    let turn = add([0.0; 3], levels.attitude_sigma_rad);
    seen.quat_xyzw = quat::normalize(quat::mul(seen.quat_xyzw, quat::exp(turn)));
}
