//! What is written of one world while it flies, whoever flies it: `propwash fly` or a loop of the user's.

use std::sync::Arc;

use serde_json::{Value, json};

use super::{
    ClearanceRow, ContactRow, FrameInput, Nearest, NoisyDepth, Quarantine, SensorRecord, StateRow, View,
    WorldWriter,
};
use crate::arena::Look;
use crate::error::Result;
use crate::math::{quat, vec3};
use crate::physics::controllers::{ControlMode, ticks};
use crate::physics::drone::Dynamics;
use crate::physics::measure;
use crate::rollout::Equations;
use crate::rollout::trajectory::Trajectory;
use crate::scalar::lanes::Number;
use crate::scene::{MAX_COORDINATE_M, Pose, Scene, Worker};
use crate::sense::{self, Camera, Contact, DepthFrame, DepthNoise, NoiseKey, SweptHit};

/// What is written, and how often: the same for all worlds of a data set.
#[derive(Debug)]
pub(super) struct Content {
    /// None: drones neither see nor touch.
    pub scene: Option<Scene>,
    /// The scene as MuJoCo saves it.
    pub mjb: Option<Vec<u8>>,
    /// The camera of each drone; none without frames.
    pub cameras: Vec<Camera>,
    /// Names of the movable obstacles, whose places are written with each frame.
    pub obstacles: Vec<String>,
    pub noise: Option<DepthNoise>,
    pub sensors: Vec<SensorRecord>,
    pub seed: u64,
    pub sim_hz: u32,
    pub fps: u32,
    pub log_hz: u32,
    pub clearance_max_m: f64,
}

impl Content {
    /// Sensors that sample at a step.
    pub fn due(&self, step: u64) -> Vec<usize> {
        let is_due = |(_, s): &(usize, &SensorRecord)| ticks(step, s.sample_hz, self.sim_hz);
        self.sensors.iter().enumerate().filter(is_due).map(|(i, _)| i).collect()
    }
}

/// One world on its way into its files.
pub(super) struct WorldLog {
    content: Arc<Content>,
    /// Number of the world in its arena.
    index: usize,
    /// Number of the world over the whole run, which keys of random numbers have.
    number: u64,
    start_clearance_m: f64,
    frames: Vec<DepthFrame>,
    noisy: Vec<DepthFrame>,
    contacts: Vec<Contact>,
    /// Pose of each drone at the last step.
    last: Vec<Pose>,
    /// Where obstacles were then.
    obstacles: (Vec<[f64; 3]>, Vec<[f64; 4]>),
    /// Distance that each drone may still travel before anything can touch it, m.
    slack: Vec<f64>,
    /// Pairs of geoms that touched at the last step.
    touching: Vec<(i32, i32)>,
    /// Steps in which a pair of geoms had as many contacts as MuJoCo reports at most, so that some may be missing.
    crowded_steps: u64,
    /// Whether the scene has flexes: contacts find them, clearance does not, so that no slack is known.
    has_flexes: bool,
}

impl WorldLog {
    /// World `index` of an arena, at its start.
    pub fn new<N: Number>(content: &Arc<Content>, look: Look<N>, index: usize, number: u64) -> Result<Self> {
        let n = look.data().n_drones;
        let frames: Vec<DepthFrame> = content.cameras.iter().map(|_| DepthFrame::new()).collect();
        let last: Vec<Pose> = (0..n).map(|d| look.pose(index, d)).collect();
        let inside = |p: &Pose| p.pos_m.iter().all(|x| x.abs() <= MAX_COORDINATE_M);
        let mut start_clearance_m = f64::INFINITY;
        if content.scene.is_some() && last.iter().all(inside) {
            let mut worker = look.world(index)?;
            for d in 0..n {
                let clear = sense::Queries::at(&mut worker).clearance(d, content.clearance_max_m)?;
                start_clearance_m = start_clearance_m.min(clear.distance_m);
            }
        }
        Ok(Self {
            index,
            number,
            start_clearance_m,
            noisy: if content.noise.is_some() { frames.clone() } else { Vec::new() },
            frames,
            contacts: Vec::new(),
            last,
            obstacles: (look.obstacle_pos_m(index).to_vec(), look.obstacle_quat(index).to_vec()),
            slack: vec![0.0; n],
            touching: Vec::new(),
            crowded_steps: 0,
            has_flexes: content.scene.as_ref().is_some_and(|scene| scene.n_flex() > 0),
            content: content.clone(),
        })
    }

    /// Writes what is seen and touched at a step, before its commands. False: the world cannot go on, and its record says why.
    pub fn before<N: Number>(&mut self, look: Look<N>, step: u64, out: &mut WorldWriter) -> Result<bool> {
        let content = self.content.clone();
        let t = step as f64 / f64::from(content.sim_hz);
        if let Some(scene) = &content.scene {
            if let Some((drone, reason)) = self.out_of_bounds(look) {
                out.quarantine(Quarantine { step: step.saturating_sub(1), drone, reason });
                return Ok(false);
            }
            let log = ticks(step, content.log_hz, content.sim_hz);
            self.watch(scene, look, (t, step), log, out)?;
            if log {
                self.log_clearance(look, t, step, out)?;
            }
            if !content.cameras.is_empty() && ticks(step, content.fps, content.sim_hz) {
                self.see(look, t, step, out)?;
            }
        }
        Ok(true)
    }

    /// Writes states, when they are due, and what sensors have sampled, after the controllers of the step. `sampled`: sensors whose
    /// samples are of this step; `paths`: the trajectories that drones follow, if they follow some.
    pub fn after_controllers<N: Number>(
        &mut self,
        (look, sim): (Look<N>, Equations<N>),
        step: u64,
        sampled: &[usize],
        paths: &[Trajectory],
        out: &mut WorldWriter,
    ) -> Result<()> {
        let t = step as f64 / f64::from(self.content.sim_hz);
        if ticks(step, self.content.log_hz, self.content.sim_hz) {
            self.log_states(sim, t, step, paths, out)?;
        }
        for sensor in sampled {
            let record = &self.content.sensors[*sensor];
            let of = |c: &sense::SensorChannel| look.samples(self.index, &record.name, &c.name);
            let values: Vec<&[f32]> = record.channels.iter().filter_map(of).collect();
            out.sample(*sensor, t, step, &values)?;
        }
        Ok(())
    }

    /// Remembers where drones are before they move.
    pub fn before_integration<N: Number>(&mut self, look: Look<N>) {
        for (d, last) in self.last.iter_mut().enumerate() {
            *last = look.pose(self.index, d);
        }
    }

    /// False: the step made the state of the world something else than numbers, and its record says so.
    pub fn after_integration<N: Number>(&self, look: Look<N>, out: &mut WorldWriter) -> bool {
        let Some(fault) = &look.data().quarantine[self.index] else { return true };
        let reason = match &fault.stage {
            None => fault.reason(),
            Some(_) => fault.to_string(),
        };
        out.quarantine(Quarantine { step: fault.step, drone: fault.drone, reason });
        false
    }

    /// What `world.json` says of it.
    pub fn info<N: Number>(&self, (look, sim): (Look<N>, Equations<N>)) -> Value {
        let mass = |d: usize| sim.drone(self.index, d).parts().body.mass_kg;
        json!({
            "obstacles_m": look.obstacle_pos_m(self.index),
            "masses_kg": (0..self.last.len()).map(mass).collect::<Vec<_>>(),
            "start_clearance_m": self.start_clearance_m,
            "crowded_steps": self.crowded_steps,
        })
    }

    /// The first drone that has left what a scene can hold: such a world ends there, and the others go on.
    fn out_of_bounds<N: Number>(&self, look: Look<N>) -> Option<(usize, String)> {
        let far = |d: &usize| look.pose(self.index, *d).pos_m.iter().any(|x| x.abs() > MAX_COORDINATE_M);
        let reason = format!("position left the ±{MAX_COORDINATE_M:e} m of a scene");
        (0..self.last.len()).find(far).map(|d| (d, reason))
    }

    /// Contacts and swept hits of the step that led here, looked for only where something may be near.
    fn watch<N: Number>(
        &mut self,
        scene: &Scene,
        look: Look<N>,
        (t, step): (f64, u64),
        log: bool,
        out: &mut WorldWriter,
    ) -> Result<()> {
        let n = self.last.len();
        let mut moved = Vec::with_capacity(n);
        for d in 0..n {
            let (from, to) = (self.last[d], look.pose(self.index, d));
            let turn = quat::mul(quat::conjugate(from.quat_xyzw), to.quat_xyzw);
            let angle = 2.0 * vec3::norm([turn[0], turn[1], turn[2]]).atan2(turn[3].abs());
            let radius = scene.drone_radius_m(d)?;
            moved.push(vec3::norm(vec3::sub(to.pos_m, from.pos_m)) + angle * radius);
        }
        let mut near = Vec::new();
        let obstacles_moved = self.obstacles_moved(look);
        for d in 0..n {
            let others = (0..n).filter(|e| *e != d).map(|e| moved[e]).fold(obstacles_moved, f64::max);
            self.slack[d] -= moved[d] + others;
            if self.has_flexes || self.slack[d] <= sense::TOUCH_M {
                near.push(d);
            }
        }
        if near.is_empty() {
            self.touching.clear();
            return Ok(());
        }
        let mut worker = look.world(self.index)?;
        self.crowded_steps += u64::from(sense::Queries::at(&mut worker).contacts(&mut self.contacts)? > 0);
        let mut now = Vec::new();
        for c in self.contacts.iter().filter(|c| c.touches()) {
            let pair = (c.drone_geom, c.other_geom);
            if log || !self.touching.contains(&pair) {
                out.contact(&touch(t, step, c))?;
            }
            now.push(pair);
        }
        let mut met = vec![false; self.last.len()];
        for d in near {
            if step > 0 {
                self.find_jumped((scene, &mut worker), look, (t, step), d, &mut met, out)?;
            }
            let clear = sense::Queries::at(&mut worker).clearance(d, self.content.clearance_max_m)?;
            self.slack[d] = clear.distance_m.max(0.0);
        }
        self.touching = now;
        Ok(())
    }

    /// The furthest that an obstacle has moved since the last step, m; without end for one that was turned, whose parts may be anywhere.
    fn obstacles_moved<N: Number>(&mut self, look: Look<N>) -> f64 {
        let (pos, quat) = (look.obstacle_pos_m(self.index), look.obstacle_quat(self.index));
        // Rows that the scene does not have are NaN, and differ from themselves.
        let is_turned = |(a, b): (&[f64; 4], &[f64; 4])| a != b && !a[0].is_nan();
        let most = match quat.iter().zip(&self.obstacles.1).any(is_turned) {
            true => f64::INFINITY,
            false => {
                let far = pos.iter().zip(&self.obstacles.0).map(|(a, b)| vec3::norm(vec3::sub(*a, *b)));
                far.fold(0.0, f64::max)
            }
        };
        if most > 0.0 {
            self.obstacles.0.copy_from_slice(pos);
            self.obstacles.1.copy_from_slice(quat);
        }
        most
    }

    /// What drone `d` touched between the last step and this one, and neither then nor now. `seen`: drones whose
    /// pairs were looked at in this step.
    fn find_jumped<N: Number>(
        &self,
        (scene, worker): (&Scene, &mut Worker),
        look: Look<N>,
        (t, step): (f64, u64),
        d: usize,
        seen: &mut [bool],
        out: &mut WorldWriter,
    ) -> Result<()> {
        let drone_of =
            |g: i32| usize::try_from(g).ok().and_then(|g| scene.geoms().get(g)).and_then(|g| g.drone);
        // What it touches anyway: geoms of the scene, and drones.
        let (mut known, mut touched): (Vec<i32>, Vec<bool>) = (Vec::new(), vec![false; self.last.len()]);
        let now = self.contacts.iter().filter(|c| c.touches()).map(|c| (c.drone_geom, c.other_geom));
        for (a, b) in now.chain(self.touching.iter().copied()) {
            for (own, other) in [(a, b), (b, a)] {
                if drone_of(own) == Some(d) {
                    match drone_of(other) {
                        Some(e) => touched[e] = true,
                        None => known.push(other),
                    }
                }
            }
        }
        let (from, to) = (self.last[d], look.pose(self.index, d));
        for e in (0..self.last.len()).filter(|e| *e != d) {
            if touched[e] || seen[e] {
                continue;
            }
            if let Some(hit) =
                sense::Queries::at(worker).swept(&sense::Sweep::new(d, from, to).of_drone(e, self.last[e]))?
            {
                out.contact(&jumped(t, step, d, &hit, scene))?;
            }
        }
        seen[d] = true;
        while let Some(hit) =
            sense::Queries::at(worker).swept(&sense::Sweep::new(d, from, to).of_scene().without(&known))?
        {
            out.contact(&jumped(t, step, d, &hit, scene))?;
            known.push(hit.other_geom);
        }
        Ok(())
    }

    /// Clearance of every drone.
    fn log_clearance<N: Number>(
        &mut self,
        look: Look<N>,
        t: f64,
        step: u64,
        out: &mut WorldWriter,
    ) -> Result<()> {
        let mut worker = look.world(self.index)?;
        for d in 0..self.last.len() {
            let clear = sense::Queries::at(&mut worker).clearance(d, self.content.clearance_max_m)?;
            self.slack[d] = clear.distance_m.max(0.0);
            let nearest = clear.found.then_some(Nearest {
                distance_m: clear.distance_m,
                from_m: clear.on_drone_m,
                to_m: clear.on_other_m,
                drone_geom: clear.drone_geom,
                geom: clear.other_geom,
                body: clear.other_body,
                other_drone: clear.other_drone,
                exact: clear.exact,
            });
            out.clearance(&ClearanceRow { t_s: t, step, drone: d, nearest })?;
        }
        Ok(())
    }

    /// One depth frame of every drone.
    fn see<N: Number>(&mut self, look: Look<N>, t: f64, step: u64, out: &mut WorldWriter) -> Result<()> {
        let mut worker = look.world(self.index)?;
        for (camera, frame) in self.content.cameras.iter().zip(&mut self.frames) {
            camera.render(&mut worker, frame)?;
        }
        if let Some(noise) = &self.content.noise {
            for (d, (clean, noisy)) in self.frames.iter().zip(&mut self.noisy).enumerate() {
                let key = NoiseKey {
                    seed: self.content.seed,
                    world: self.number,
                    drone: d as u32,
                    step,
                    camera: 0,
                };
                noise.apply(&self.content.cameras[d], clean, key, noisy)?;
            }
        }
        let views: Vec<View> = self
            .frames
            .iter()
            .enumerate()
            .map(|(d, f)| View {
                depth_m: &f.depth_m,
                status: &f.status,
                geom_id: &f.geom_id,
                body_id: &f.body_id,
                normal: f.normal.as_deref(),
                noisy: self.noisy.get(d).map(|n| NoisyDepth { depth_m: &n.depth_m, status: &n.status }),
                pos_m: f.pos_m,
                quat_xyzw: f.quat_xyzw,
                k: f.k,
            })
            .collect();
        let n = self.content.obstacles.len();
        let obstacles = (&look.obstacle_pos_m(self.index)[..n], &look.obstacle_quat(self.index)[..n]);
        Ok(out.frame(&FrameInput { t_s: t, step, views: &views, obstacles })?)
    }

    /// State, command and reference of every drone.
    fn log_states<N: Number>(
        &self,
        sim: Equations<N>,
        t: f64,
        step: u64,
        paths: &[Trajectory],
        out: &mut WorldWriter,
    ) -> Result<()> {
        let w = self.index;
        let (data, mode) = (sim.data(), sim.options().control);
        let mut world = sim.of_world(w);
        for d in 0..data.n_drones {
            let drone = sim.drone(w, d);
            let row = data.row(w, d);
            let wide = |numbers: &[N]| numbers.iter().map(|v| v.wide()).collect::<Vec<f64>>();
            let n = drone.airframe.n_rotors;
            let rotors = matches!(drone.dynamics, Dynamics::Rotors);
            let s = data.state(w, d);
            let rate = world.rate(d);
            let reference = paths.get(d).map(|path| path.at(t));
            let width = if mode == ControlMode::RotorVel { n } else { data.command_width };
            let command = match &reference {
                Some(reference) => reference.command().to_vec(),
                None => wide(&data.command[data.command_width * row..][..width]),
            };
            let attitude = wide(&data.attitude_command[4 * row..4 * row + 4]);
            let rotor_command = wide(&data.rotor_command[data.n_rotors * row..][..n]);
            out.state(&StateRow {
                t_s: t,
                step,
                drone: d,
                pos_m: s.pos,
                quat_xyzw: s.quat,
                vel_m_s: s.vel,
                ang_vel_rad_s: s.ang_vel,
                specific_force_m_s2: Some(measure::accelerometer(&s, &rate, drone.body.gravity_m_s2)),
                rotor_rad_s: if rotors { &s.rotor_vel[..n] } else { &[] },
                thrust_n: Some(sim.thrust_n(w, d)),
                command: &command,
                // Only where it comes from a controller.
                attitude_command: (mode == ControlMode::State)
                    .then(|| [attitude[0], attitude[1], attitude[2], attitude[3]]),
                rotor_command_rad_s: if rotors && mode != ControlMode::RotorVel {
                    &rotor_command
                } else {
                    &[]
                },
                reference,
                battery_v: world.battery_v(d),
                wind_m_s: Some(world.wind_m_s(d)),
            })?;
        }
        Ok(())
    }
}

/// A contact as a row; normals of the table point from the drone to what it touches.
fn touch(t: f64, step: u64, c: &Contact) -> ContactRow {
    ContactRow {
        t_s: t,
        step,
        drone: c.drone,
        other_drone: c.other_drone,
        geoms: [c.drone_geom, c.other_geom],
        bodies: [c.drone_body, c.other_body],
        other_flex: c.other_flex,
        distance_m: c.distance_m,
        point_m: c.point_m,
        normal: c.normal.map(|v| -v),
        exact: true,
        swept_fraction: None,
    }
}

/// A hit between two steps as a row.
fn jumped(t: f64, step: u64, drone: usize, hit: &SweptHit, scene: &Scene) -> ContactRow {
    let body = usize::try_from(hit.drone_geom)
        .ok()
        .and_then(|g| scene.geoms().get(g))
        .map_or(-1, |g| g.body_id as i32);
    let mut row = ContactRow {
        t_s: t,
        step,
        drone,
        other_drone: hit.other_drone,
        geoms: [hit.drone_geom, hit.other_geom],
        bodies: [body, hit.other_body],
        other_flex: -1,
        distance_m: hit.distance_m,
        point_m: hit.point_m,
        normal: hit.normal.map(|v| -v),
        exact: hit.exact,
        swept_fraction: Some(hit.fraction),
    };
    // Of two drones the one with the lower number comes first, as in all contacts.
    if let Some(other) = hit.other_drone
        && other < drone
    {
        (row.drone, row.other_drone) = (other, Some(drone));
        row.geoms.reverse();
        row.bodies.reverse();
        row.normal = hit.normal;
    }
    row
}
