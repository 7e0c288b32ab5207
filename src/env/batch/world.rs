//! One world between steps: what it remembers, and how it is commanded, looked at, judged and observed.

use super::Ending;
use crate::arena::Look;
use crate::env::EnvError;
use crate::env::action::{Limits, SetPoint};
use crate::env::batch_task::episode_key;
use crate::env::config::EnvConfig;
use crate::env::layouts::{Course, Layout};
use crate::env::randomize::{LevelRules, Levels};
use crate::env::sensing::{Flown, NoisySensor, render_depth, update_collisions};
use crate::env::task::{DroneView, EpisodeStart, Images, STATE_WIDTH, Start, Task, WorldView, store};
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
    pub starts: Vec<Start>,
    pub drones: Vec<Flown>,
    /// True states, and as observed.
    pub seen: Vec<DroneView>,
    pub observed: Vec<DroneView>,
    pub set_points: Vec<SetPoint>,
    /// Commands of the last steps, where some may be late; else empty. (age, drone, command)
    pub commands: Vec<f32>,
    pub camera_poses: Vec<Pose>,
    /// Images without noise, where those observed differ. (drone, height, width)
    pub clean: Vec<f32>,
    /// Images of the last steps, where they are observed late. (age, drone, height, width)
    pub ring: Vec<f32>,
    /// Episodes before this one.
    pub episode: u64,
}

impl World {
    /// A world that has not begun.
    pub(super) fn new(plan: &Plan) -> Self {
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
            starts: vec![Start::at([0.0; 3]); d],
            drones: vec![Flown { clearance_m: config.look_m, ..Flown::default() }; d],
            seen: vec![rest; d],
            observed: vec![rest; d],
            set_points: vec![SetPoint::default(); d],
            commands: vec![0.0; plan.command_ring * d * plan.command_width],
            camera_poses: vec![Pose::default(); if pixels == 0 { 0 } else { d }],
            clean: vec![0.0; if apart { d * pixels } else { 0 }],
            ring: vec![0.0; if rings > 1 { rings * d * pixels } else { 0 }],
            episode: 0,
        }
    }

    /// Number `k` of the observed state of its first drone: position, attitude, velocity, angular velocity.
    pub(super) fn shown(&self, k: usize) -> f64 {
        let of = if self.levels.is_noisy() { &self.observed[0] } else { &self.seen[0] };
        match k {
            0..3 => of.pos_m[k],
            3..7 => of.quat_xyzw[k - 3],
            7..10 => of.vel_m_s[k - 7],
            _ => of.ang_vel_rad_s[k - 10],
        }
    }
}

/// Where the results of one world go, and what is kept of it elsewhere.
pub(super) struct Out<'a> {
    /// Steps of the environment since the reset.
    pub step: u64,
    /// What the task remembers.
    pub memory: &'a mut [f32],
    pub ended: &'a mut bool,
    pub observation: &'a mut [f32],
    pub depth: &'a mut [f32],
    pub reward: &'a mut [f32],
    pub terminated: &'a mut bool,
    pub truncated: &'a mut bool,
    pub ending: &'a mut u8,
    pub clearance: &'a mut [f32],
    pub crashed: &'a mut [bool],
    pub acted: Acted<'a>,
}

/// What the drones of a world were told.
#[derive(Clone, Copy)]
pub(super) struct Acted<'a> {
    /// How much the action of this step changed. (drone)
    pub change: &'a [f32],
    /// Actions of this step and of the one before, −1 to 1; see [`WorldView`]. (drone, action)
    pub actions: [&'a [f32]; 2],
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
    /// Commands that are kept; 0: none is late.
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
    /// Observed states may have noise.
    pub is_noisy: bool,
    /// Something may look at how much actions change.
    pub compares_actions: bool,
    /// Formulas of the task look at where drones were before.
    pub reads_previous: bool,
    /// Something may look at the actions.
    pub reads_actions: bool,
    /// Steps after which the time of an episode is over.
    pub most_steps: u64,
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
    pub(super) fn key(&self, w: usize, world: &World, step: u64, purpose: u32) -> Key {
        episode_key(self.config.sim.options.origin(w), world.episode, step, purpose)
    }

    /// What a command takes to the drones: whole steps of the environment, and further steps of the simulation.
    fn delay(&self, levels: &Levels) -> [u64; 2] {
        let steps = levels.action_delay_s * f64::from(self.config.sim.options.sim_hz);
        let steps = steps.round().clamp(0.0, f64::from(self.config.sim.options.sim_hz)) as u64;
        let substeps = u64::from(self.config.substeps());
        [steps / substeps, steps % substeps]
    }

    /// Draws an episode: everything but where drones start.
    pub(super) fn begin(&self, w: usize, world: &mut World, n_layouts: usize, episode: u64) {
        world.episode = episode;
        world.levels = self.rules.draw(&self.config.levels, self.key(w, world, 0, LEVELS_OF));
        [world.late, world.due] = self.delay(&world.levels);
        if n_layouts > 0 {
            world.layout = self.key(w, world, 0, LAYOUT).stream().below(n_layouts as u64) as usize;
        }
    }

    /// Lets the task place the drones of an episode that has begun, with goals if some are given.
    pub(super) fn place(
        &self,
        w: usize,
        (world, memory): (&mut World, &mut [f32]),
        layouts: &[Layout],
        look: Look<f32>,
        (task, purpose): (&dyn Task, u32),
        goal: Option<&[[f64; 3]]>,
    ) -> Result<(), EnvError> {
        let draw = self.key(w, world, 0, purpose).stream();
        let course = layouts.get(world.layout).map_or(&self.no_course, |l| &l.course);
        let mut worker = if layouts.is_empty() { None } else { Some(look.surroundings(w)?) };
        let starts = &mut world.starts[..];
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
        self.sense((w, out.step), world, layout, at, fresh || quarantined, out.depth)?;
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
                    let told = (&mut *out.memory, out.acted, out.reward);
                    self.judge(task, (w, out.step, &*world), (layout, at), out.depth, told)?
                }
            };
            *out.ended = self.conclude(out.step, ending, (out.terminated, out.truncated, out.ending));
        }
        let told = (&*out.memory, out.acted, out.observation);
        self.observe(task, (w, out.step, world), (layout, at), told);
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
        (w, step): (usize, u64),
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
                let key = self.key(w, world, step, DEPTH);
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
                self.keep_image(world, step, depth);
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
        (w, step): (usize, u64),
        look: Look<'a, f32>,
        (drones, acted): (&'a [DroneView], Acted<'a>),
        images: Option<Images<'a>>,
        course: &'a Course,
    ) -> WorldView<'a> {
        WorldView {
            time_s: step as f64 * self.config.step_s(),
            step_s: self.config.step_s(),
            drones,
            images,
            course,
            action_change: acted.change,
            acted: acted.actions,
            world: w,
            look,
        }
    }

    /// What a task says of a step.
    pub(super) fn judge(
        &self,
        task: &dyn Task,
        (w, step, world): (usize, u64, &World),
        (layout, look): (Option<&Layout>, Look<f32>),
        depth: &[f32],
        (memory, acted, reward): (&mut [f32], Acted, &mut [f32]),
    ) -> Result<Ending, EnvError> {
        let course = layout.map_or(&self.no_course, |l| &l.course);
        let images = layout.filter(|_| self.pixels > 0).map(|layout| Images {
            depth_m: if world.clean.is_empty() { depth } else { &world.clean },
            cameras: &layout.cameras,
            poses: &world.camera_poses,
        });
        let view = self.view((w, step), look, (&world.seen, acted), images, course);
        let outcome = task.judge(&view, memory, reward);
        check_rewards(w, reward)?;
        Ok(outcome.into())
    }

    /// Ends an episode after `step` steps, or lets it go on: writes whether it was terminated or truncated, and why it ended. Returns
    /// whether it has ended.
    #[inline]
    pub(super) fn conclude(&self, step: u64, ending: Ending, out: (&mut bool, &mut bool, &mut u8)) -> bool {
        let (terminated, truncated, number) = out;
        *terminated = ending != Ending::None;
        *truncated = ending == Ending::None && step >= self.most_steps;
        *number = if *truncated { Ending::TimeUp } else { ending } as u8;
        *terminated || *truncated
    }

    /// Writes what is observed of a world: the state, with noise where there is some, and what the task adds.
    pub(super) fn observe(
        &self,
        task: Option<&dyn Task>,
        (w, step, world): (usize, u64, &mut World),
        (layout, look): (Option<&Layout>, Look<f32>),
        (memory, acted, out): (&[f32], Acted, &mut [f32]),
    ) {
        let noisy = world.levels.is_noisy();
        if noisy {
            let key = self.key(w, world, step, STATE_NOISE);
            world.observed.copy_from_slice(&world.seen);
            for (d, seen) in world.observed.iter_mut().enumerate() {
                blur(seen, &world.levels, Key { drone: d as u32, ..key });
            }
        }
        let drones = if noisy { &world.observed } else { &world.seen };
        let course = layout.map_or(&self.no_course, |l| &l.course);
        let view = self.view((w, step), look, (drones, acted), None, course);
        for (d, (row, s)) in out.chunks_exact_mut(self.width).zip(drones).enumerate() {
            store(&mut row[0..], &s.pos_m);
            store(&mut row[3..], &s.quat_xyzw);
            store(&mut row[7..], &s.vel_m_s);
            store(&mut row[10..], &s.ang_vel_rad_s);
            if let Some(task) = task {
                task.observe(&view, memory, d, &mut row[STATE_WIDTH..]);
            }
        }
    }

    /// Keeps the newest image and puts the one that is observed now in its place.
    pub(super) fn keep_image(&self, world: &mut World, step: u64, depth: &mut [f32]) {
        if self.depth_ring == 1 {
            return;
        }
        let n = depth.len();
        let ring = self.depth_ring as u64;
        let late = (world.levels.depth_delay_s / self.config.step_s()).round() as u64;
        let newest = (step % ring) as usize;
        world.ring[newest * n..(newest + 1) * n].copy_from_slice(depth);
        let shown = (step.saturating_sub(late.min(ring - 1)) % ring) as usize;
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
