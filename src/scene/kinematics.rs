//! Placing what moved: drones and obstacles that were set since the last update, by the functions that `mj_kinematics` is made of.
//! Geoms that stand still cost nothing then, however many the scene has.

use std::ops::Range;

use mujoco_rs::mujoco_c as ffi;

use super::SceneError;
use super::model::ObstacleKind;
use super::workers::Worker;

/// Bodies that move as one: a drone, or an obstacle.
#[derive(Debug)]
pub(super) struct Movable {
    /// The root and the bodies below it, which stand one after the other.
    bodies: Range<usize>,
    place: Place,
    geoms: Vec<usize>,
    sites: Vec<usize>,
    cameras: Vec<usize>,
    /// Whether nothing in it moves against the root, and no light is on it.
    rigid: bool,
}

/// Where the pose of a root stands.
#[derive(Clone, Copy, Debug)]
enum Place {
    /// At this address of qpos.
    FreeJoint(usize),
    /// With this number among mocap bodies.
    Mocap(usize),
}

/// What was set since everything was placed last.
#[derive(Debug, Default)]
pub(super) struct Moved {
    movables: Vec<Movable>,
    /// Drones by number, then obstacles.
    which: Vec<bool>,
    /// Whether everything must be placed anew.
    all: bool,
    /// Whether a camera follows or faces something, so that cameras must be placed all together.
    turning_cameras: bool,
}

impl Moved {
    /// Of a worker whose poses were not placed yet.
    pub fn new(worker: &Worker) -> Self {
        let scene = &worker.scene().0;
        let drones = scene.drone_body.iter().zip(&scene.drone_qpos).map(|(b, a)| (*b, Place::FreeJoint(*a)));
        let obstacles = scene.obstacles.iter().map(|o| {
            let place = match o.kind {
                ObstacleKind::FreeJoint => Place::FreeJoint(o.address),
                ObstacleKind::Mocap => Place::Mocap(o.address),
            };
            (o.body_id, place)
        });
        // SAFETY: a compiled model; its arrays have the sizes that it states.
        unsafe {
            let m = &*worker.m();
            let movables =
                drones.chain(obstacles).map(|(root, place)| movable(m, root, place)).collect::<Vec<_>>();
            let turning_cameras = (0..m.ncam as usize).any(|c| *m.cam_mode.add(c) != 0);
            Self { which: vec![false; movables.len()], movables, all: true, turning_cameras }
        }
    }

    /// Notes that a drone was set.
    pub fn drone(&mut self, drone: usize) {
        self.which[drone] = true;
    }

    /// Notes that an obstacle was set; `n_drones` as in the scene.
    pub fn obstacle(&mut self, n_drones: usize, index: usize) {
        self.which[n_drones + index] = true;
    }

    /// Notes that nothing may be relied on.
    pub fn everything(&mut self) {
        self.all = true;
    }
}

/// # Safety
/// A compiled model.
unsafe fn movable(m: &ffi::mjModel, root: usize, place: Place) -> Movable {
    // SAFETY: indices stay below the counts of the model that owns the arrays.
    unsafe {
        let parent = |b: usize| *m.body_parentid.add(b) as usize;
        let mut end = root + 1;
        while end < m.nbody as usize && parent(end) >= root {
            end += 1;
        }
        let bodies = root..end;
        let on = |b: i32| bodies.contains(&(b as usize));
        let geoms = (0..m.ngeom as usize).filter(|g| on(*m.geom_bodyid.add(*g))).collect();
        let sites = (0..m.nsite as usize).filter(|s| on(*m.site_bodyid.add(*s))).collect();
        let cameras = (0..m.ncam as usize).filter(|c| on(*m.cam_bodyid.add(*c))).collect();
        let still = (root + 1..end).all(|b| *m.body_jntnum.add(b) == 0 && *m.body_mocapid.add(b) < 0);
        let dark = !(0..m.nlight as usize).any(|l| on(*m.light_bodyid.add(l)));
        Movable { bodies, place, geoms, sites, cameras, rigid: still && dark && parent(root) == 0 }
    }
}

impl Worker {
    /// Computes where all bodies, geoms and cameras are. Hinges and slides keep their reference position.
    ///
    /// # Errors
    /// [`SceneError::Engine`], [`SceneError::Poisoned`].
    pub fn update(&mut self) -> Result<(), SceneError> {
        self.alive()?;
        // Nothing was set: all stands where its pose says.
        if self.is_fresh() && !self.moved.all && !self.moved.which.contains(&true) {
            return Ok(());
        }
        let (com, flex) = (self.scene().0.needs_com, self.scene().0.n_flex > 0);
        let moved = &self.moved;
        let rigid = moved.movables.iter().zip(&moved.which).all(|(movable, moved)| movable.rigid || !moved);
        if moved.all || com || flex || moved.turning_cameras || !rigid {
            self.place_all()?;
        } else {
            for (movable, _) in moved.movables.iter().zip(&moved.which).filter(|(_, moved)| **moved) {
                // SAFETY: the movable is of this model.
                unsafe { self.place(movable) }
            }
        }
        self.moved.all = false;
        self.moved.which.fill(false);
        self.placed();
        Ok(())
    }

    fn place_all(&mut self) -> Result<(), SceneError> {
        let (m, d) = (self.m(), self.data);
        let (cameras, com) = (!self.scene().0.cameras.is_empty(), self.scene().0.needs_com);
        let flex = self.scene().0.n_flex > 0;
        // SAFETY: model and data belong together; the closure only calls MuJoCo.
        unsafe {
            self.engine("mj_kinematics", || {
                ffi::mj_kinematics(m, d);
                if com {
                    ffi::mj_comPos(m, d);
                }
                if cameras {
                    ffi::mj_camlight(m, d);
                }
                if flex {
                    ffi::mj_flex(m, d);
                }
            })
        }
    }

    /// Places what moves with one root as `mj_kinematics` and `mj_camlight` do, to the bit.
    ///
    /// # Safety
    /// The movable is of this worker's model.
    unsafe fn place(&self, movable: &Movable) {
        // SAFETY: bodies, geoms, sites and cameras are numbers of this model, whose arrays and whose data have room for all of
        // them; the functions of MuJoCo that are called read and write these alone and raise no errors.
        unsafe {
            let m = &*self.m();
            let data = self.data;
            let d = &*data;
            let (xpos, xquat) = (d.xpos.cast::<[f64; 3]>(), d.xquat.cast::<[f64; 4]>());
            let xmat = d.xmat.cast::<[f64; 9]>();
            for b in movable.bodies.clone() {
                let (mut pos, mut quat) = ([0.0; 3], [0.0; 4]);
                if b > movable.bodies.start {
                    let parent = *m.body_parentid.add(b) as usize;
                    let local = *m.body_pos.cast::<[f64; 3]>().add(b);
                    ffi::mju_mulMatVec3(&mut pos, xmat.add(parent), &local);
                    for (to, from) in pos.iter_mut().zip(*xpos.add(parent)) {
                        *to += from;
                    }
                    ffi::mju_mulQuat(&mut quat, xquat.add(parent), m.body_quat.cast::<[f64; 4]>().add(b));
                } else {
                    match movable.place {
                        Place::FreeJoint(address) => {
                            pos = *d.qpos.add(address).cast::<[f64; 3]>();
                            quat = *d.qpos.add(address + 3).cast::<[f64; 4]>();
                        }
                        Place::Mocap(number) => {
                            pos = *d.mocap_pos.cast::<[f64; 3]>().add(number);
                            quat = *d.mocap_quat.cast::<[f64; 4]>().add(number);
                            ffi::mju_normalize4(&mut quat);
                        }
                    }
                }
                ffi::mju_normalize4(&mut quat);
                (*xpos.add(b), *xquat.add(b)) = (pos, quat);
                ffi::mju_quat2Mat(xmat.add(b), &quat);
                ffi::mj_local2Global(
                    data,
                    d.xipos.cast::<[f64; 3]>().add(b),
                    d.ximat.cast::<[f64; 9]>().add(b),
                    m.body_ipos.cast::<[f64; 3]>().add(b),
                    m.body_iquat.cast::<[f64; 4]>().add(b),
                    b as i32,
                    *m.body_sameframe.add(b),
                );
            }
            for &g in &movable.geoms {
                ffi::mj_local2Global(
                    data,
                    d.geom_xpos.cast::<[f64; 3]>().add(g),
                    d.geom_xmat.cast::<[f64; 9]>().add(g),
                    m.geom_pos.cast::<[f64; 3]>().add(g),
                    m.geom_quat.cast::<[f64; 4]>().add(g),
                    *m.geom_bodyid.add(g),
                    *m.geom_sameframe.add(g),
                );
            }
            for &s in &movable.sites {
                ffi::mj_local2Global(
                    data,
                    d.site_xpos.cast::<[f64; 3]>().add(s),
                    d.site_xmat.cast::<[f64; 9]>().add(s),
                    m.site_pos.cast::<[f64; 3]>().add(s),
                    m.site_quat.cast::<[f64; 4]>().add(s),
                    *m.site_bodyid.add(s),
                    *m.site_sameframe.add(s),
                );
            }
            for &c in &movable.cameras {
                ffi::mj_local2Global(
                    data,
                    d.cam_xpos.cast::<[f64; 3]>().add(c),
                    d.cam_xmat.cast::<[f64; 9]>().add(c),
                    m.cam_pos.cast::<[f64; 3]>().add(c),
                    m.cam_quat.cast::<[f64; 4]>().add(c),
                    *m.cam_bodyid.add(c),
                    0,
                );
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Scene, SceneSource, Shell};
    use super::*;
    use crate::random::{Key, purpose};

    /// All places that a worker holds, by their bits.
    fn places(worker: &Worker) -> Vec<u64> {
        let mut out = Vec::new();
        // SAFETY: the arrays have the sizes that the model states.
        unsafe {
            let (m, d) = (&*worker.m(), &*worker.data);
            let mut add = |from: *const f64, n: usize| {
                out.extend(super::super::model::slice(from, n).iter().map(|v| v.to_bits()));
            };
            let (bodies, geoms) = (m.nbody as usize, m.ngeom as usize);
            let (sites, cameras) = (m.nsite as usize, m.ncam as usize);
            add(d.xpos.cast(), 3 * bodies);
            add(d.xquat.cast(), 4 * bodies);
            add(d.xmat.cast(), 9 * bodies);
            add(d.xipos.cast(), 3 * bodies);
            add(d.ximat.cast(), 9 * bodies);
            add(d.geom_xpos.cast(), 3 * geoms);
            add(d.geom_xmat.cast(), 9 * geoms);
            add(d.site_xpos.cast(), 3 * sites);
            add(d.site_xmat.cast(), 9 * sites);
            add(d.cam_xpos.cast(), 3 * cameras);
            add(d.cam_xmat.cast(), 9 * cameras);
        }
        out
    }

    /// Flies drones and moves obstacles at random; after every update all is where MuJoCo puts it, to the bit. Returns how often
    /// only what moved was placed.
    fn compare(scene: &str, rounds: u64) -> usize {
        let body = "<body name='drone'><geom type='box' size='.1 .1 .02' pos='.01 0 .02' euler='10 20 30'/><site name='s' pos='0 0 .1'/>
            <camera name='fpv' pos='.05 0 0' euler='80 0 -90'/>
            <body name='arm' pos='.1 0 .05' euler='0 30 5'><geom type='sphere' size='.02'/>
            <body name='tip' pos='0 .1 0' quat='.3 .2 .1 .9'><geom type='capsule' size='.01 .05' mass='.3'/></body></body></body>";
        let shell = Shell {
            name: "test".into(),
            xml: format!("<mujoco><worldbody>{body}</worldbody></mujoco>"),
            dir: None,
        };
        let scene = Scene::build(&SceneSource::text("test", scene), &[shell.clone(), shell]).unwrap();
        let mut worker = Worker::new(&scene).unwrap();
        let mut few = 0;
        for round in 0..rounds {
            let mut s = Key { seed: 3, world: 0, drone: 0, step: round, purpose: purpose("test.kinematics") }
                .stream();
            let mut pose = || {
                let q: [f64; 4] = std::array::from_fn(|_| s.normal());
                (std::array::from_fn(|_| 3.0 * s.normal()), q)
            };
            for drone in 0..2 {
                let (pos, quat) = pose();
                if round % 3 != drone as u64 {
                    worker.set_drone(drone, pos, quat).unwrap();
                }
            }
            for obstacle in 0..scene.obstacles().len() {
                let (pos, quat) = pose();
                if round % 2 == 0 {
                    worker.set_obstacle(obstacle, pos, quat).unwrap();
                }
            }
            let moved = &worker.moved;
            let rigid = moved.movables.iter().zip(&moved.which).all(|(m, moved)| m.rigid || !moved);
            few += usize::from(rigid && !moved.all && !moved.turning_cameras && !scene.0.needs_com);
            worker.update().unwrap();
            let got = places(&worker);
            worker.moved.everything();
            worker.update().unwrap();
            assert!(got == places(&worker), "round {round}");
        }
        few
    }

    #[test]
    fn placing_what_moved_gives_the_bits_of_mj_kinematics() {
        let still = "<geom type='plane' size='5 5 .1'/><body pos='1 2 0'><geom size='.3'/></body>";
        let free = "<body name='crate' pos='0 1 1'><freejoint/><geom type='box' size='.2 .1 .3'/>
            <body pos='.3 0 0' euler='0 0 45'><geom size='.1'/><site name='top'/></body></body>";
        let mocap =
            "<body name='gate' mocap='true' pos='1 0 1'><geom type='box' size='.1 1 1' pos='0 1 0'/></body>";
        let hinge = "<body name='door' pos='3 0 1'><freejoint/><geom size='.1'/><body><joint type='hinge'/><geom size='.2'/></body></body>";
        let world = |parts: &[&str]| format!("<mujoco><worldbody>{}</worldbody></mujoco>", parts.concat());
        assert_eq!(compare(&world(&[still]), 40), 40);
        assert_eq!(compare(&world(&[still, free, mocap]), 40), 40);
        // A hinge is left to MuJoCo whenever its body was moved, and so are cameras that follow.
        assert_eq!(compare(&world(&[still, hinge, mocap]), 40), 20);
        let follows = "<camera name='c' mode='trackcom' pos='0 0 9'/>";
        assert_eq!(compare(&world(&[still, free, follows]), 10), 0);
    }
}
