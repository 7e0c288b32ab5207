//! One set of poses in a scene, and what MuJoCo says about them.
//!
//! MuJoCo ends the process on its own errors, except inside `mjb_apply` (mjbatch.h), which catches them and returns
//! their text. Every call that can fail runs inside it, on a batch of an empty model that serves as a guard only: the
//! model of the scene stays shared by all workers. MuJoCo leaves a failed call by a jump, so what runs inside holds
//! nothing that would have to be dropped.

use std::ffi::{CStr, c_char, c_int, c_void};
use std::mem::ManuallyDrop;
use std::ops::{Deref, DerefMut};
use std::ptr;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use mujoco_rs::mujoco_c as ffi;
use mujoco_rs::prelude::{MjModel, MjSpec};

use super::engine::{self, Building};
use super::kinematics::Moved;
use super::model::{ObstacleKind, slice};
use super::sync;
use super::{GeomType, Pose, Scene, SceneError};
use crate::geometry::sweep::GeomPlace;
use crate::geometry::{Memory, Poses, Table};

#[repr(C)]
struct BatchConfig {
    nthread: c_int,
    persistent: bool,
}

#[repr(C)]
struct Batch {
    _opaque: [u8; 0],
}

type BatchFunc = unsafe extern "C" fn(*const ffi::mjModel, *mut ffi::mjData, c_int, *mut c_void);

// include/mujoco/mjbatch.h of MuJoCo 3.17.0; these five are not in the bindings of mujoco-rs 7.0.0.
unsafe extern "C" {
    fn mjb_makeBatch(
        m: *const ffi::mjModel,
        nsim: c_int,
        config: *const BatchConfig,
        error: *mut c_char,
        error_sz: c_int,
    ) -> *mut Batch;
    fn mjb_deleteBatch(b: *mut Batch);
    fn mjb_apply(
        b: *mut Batch,
        ids: *const c_int,
        nid: c_int,
        func: BatchFunc,
        arg: *mut c_void,
        save: c_int,
    ) -> c_int;
    fn mjb_error(b: *const Batch, sim: c_int) -> *const c_char;
}

/// Catches MuJoCo's errors.
pub(super) struct Guard {
    batch: *mut Batch,
}

impl Guard {
    pub(super) fn new() -> Result<Self, SceneError> {
        static EMPTY: OnceLock<Option<MjModel>> = OnceLock::new();
        let engine = |message: String| SceneError::Engine { call: "mjb_makeBatch", message, remedy: "" };
        let _building = Building::begin();
        let empty = EMPTY
            .get_or_init(|| {
                MjSpec::from_xml_string("<mujoco><size memory=\"64K\"/></mujoco>").ok()?.compile().ok()
            })
            .as_ref()
            .ok_or_else(|| engine("the empty model does not compile".into()))?;
        let mut text = [0 as c_char; 1024];
        let config = BatchConfig { nthread: 1, persistent: true };
        // SAFETY: a compiled model, a config and an error buffer that outlive the call.
        let batch = unsafe { mjb_makeBatch(empty.ffi(), 1, &config, text.as_mut_ptr(), text.len() as c_int) };
        if batch.is_null() {
            // SAFETY: MuJoCo terminates the text that it writes; the buffer was zeroed.
            let message = unsafe { CStr::from_ptr(text.as_ptr()) }.to_string_lossy().into_owned();
            return Err(engine(message));
        }
        Ok(Self { batch })
    }

    /// Runs `work`; MuJoCo's words if it raised an error.
    ///
    /// `F: Copy` keeps everything that would need dropping out of `work`, whose frames a jump may leave.
    ///
    /// # Safety
    /// What `work` does must be sound; its body creates no value that needs dropping and does not unwind.
    pub(super) unsafe fn run<F: Fn() + Copy>(&self, work: F) -> Result<(), String> {
        unsafe extern "C" fn call<F: Fn() + Copy>(
            _: *const ffi::mjModel,
            _: *mut ffi::mjData,
            _: c_int,
            arg: *mut c_void,
        ) {
            // SAFETY: `arg` is the address of `work` below, which lives until mjb_apply returns.
            unsafe { (*arg.cast::<F>())() }
        }
        let mut work = work;
        // SAFETY: the batch lives as long as self and runs the function once, on this thread (nthread = 1).
        let failed = engine::inside(|| unsafe {
            mjb_apply(self.batch, ptr::null(), 0, call::<F>, (&raw mut work).cast(), 0)
        });
        if failed == 0 {
            return Ok(());
        }
        // SAFETY: simulation 0 exists; MuJoCo keeps the text until the next call.
        let text = unsafe { mjb_error(self.batch, 0) };
        if text.is_null() {
            return Err("MuJoCo gave no reason".into());
        }
        // SAFETY: not null, terminated by MuJoCo.
        Err(unsafe { CStr::from_ptr(text) }.to_string_lossy().trim().to_string())
    }
}

impl Drop for Guard {
    fn drop(&mut self) {
        // SAFETY: made by mjb_makeBatch, freed once.
        unsafe { mjb_deleteBatch(self.batch) }
    }
}

/// What a ray met.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayHit {
    /// Distance along the direction, in lengths of the direction.
    pub distance: f64,
    /// The geom, or -1 where the ray met a flex.
    pub geom_id: i32,
    /// Surface normal, world, unit.
    pub normal: [f64; 3],
}

/// A contact as MuJoCo reports it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RawContact {
    /// The two geoms; -1 for the side of a flex.
    pub geom: [i32; 2],
    /// The two flexes; -1 for the side of a geom.
    pub flex: [i32; 2],
    /// Signed distance, m; negative when the two penetrate, positive within a contact margin.
    pub distance_m: f64,
    /// Midpoint of the contact, world, m.
    pub point_m: [f64; 3],
    /// Unit normal, world, from the first to the second.
    pub normal: [f64; 3],
}

/// Signed distance of two geoms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GeomDistance {
    /// Signed distance, m; at most the maximum that was asked for.
    pub distance_m: f64,
    /// Closest point on the first geom, world, m; meaningless when the distance is the maximum.
    pub on_first_m: [f64; 3],
    /// Closest point on the second geom, world, m; meaningless when the distance is the maximum.
    pub on_second_m: [f64; 3],
}

/// Rays are cast in blocks of this many, which bounds MuJoCo's scratch memory.
const RAY_BLOCK: usize = 8192;

/// One set of poses in a [`Scene`], for one thread at a time.
///
/// Set poses, call [`update`](Worker::update), then ask. A failed call resets the worker to the poses it had.
pub struct Worker {
    scene: Scene,
    guard: Guard,
    pub(super) data: *mut ffi::mjData,
    fresh: bool,
    /// What was set since the last update.
    pub(super) moved: Moved,
    /// Changes whenever bodies or geoms are placed anew.
    version: u64,
    collided: bool,
    poisoned: Option<String>,
    drone_poses: Vec<Pose>,
    /// What can stand below or above a drone.
    standing: Vec<Standing>,
    /// Poses of obstacles that were set since the worker was made.
    obstacle_poses: Vec<Option<Pose>>,
    /// What queries of `geometry` remember of these poses.
    memory: Memory,
    /// Buffers that callers of MuJoCo's queries borrow, so that no frame allocates.
    pub(crate) scratch: RayScratch,
}

/// A geom that can collide and is no part of a drone, with what a search along a vertical needs first.
#[derive(Clone, Copy)]
struct Standing {
    geom: usize,
    kind: GeomType,
    bounding_radius_m: f64,
}

impl Standing {
    fn all(scene: &Scene) -> Vec<Self> {
        let geoms = scene.0.geoms.iter().filter(|g| g.drone.is_none() && g.can_collide());
        geoms.map(|g| Self { geom: g.id, kind: g.kind, bounding_radius_m: g.bounding_radius_m }).collect()
    }
}

/// Reusable buffers for MuJoCo's rays and distances.
#[derive(Default)]
pub(crate) struct RayScratch {
    pub directions: Vec<[f64; 3]>,
    pub distances: Vec<f64>,
    pub geoms: Vec<i32>,
    pub normals: Vec<[f64; 3]>,
    /// Lower bound of distance and number of a geom, or number of a ray.
    pub bounds: Vec<(f64, usize)>,
    /// Places of a drone's geoms in its body frame: position and rotation (row major).
    pub places: Vec<GeomPlace>,
}

// SAFETY: mjData and the batch belong to this worker alone and hold nothing tied to a thread (the batch has no threads
// of its own: nthread = 1); methods that change them take &mut self.
unsafe impl Send for Worker {}

impl Drop for Worker {
    fn drop(&mut self) {
        let data = self.data;
        if !data.is_null() {
            // SAFETY: made by mj_makeData, freed once. A failure inside leaks instead of ending the process.
            let _ = unsafe { self.guard.run(|| ffi::mj_deleteData(data)) };
        }
    }
}

impl Worker {
    pub(super) fn new(scene: &Scene) -> Result<Self, SceneError> {
        let guard = Guard::new()?;
        let m: *const ffi::mjModel = scene.0.model.ffi();
        let mut data: *mut ffi::mjData = ptr::null_mut();
        let out = &raw mut data;
        // SAFETY: a compiled model; `out` outlives the call.
        let made = unsafe { guard.run(|| *out = ffi::mj_makeData(m)) };
        let failed = |message: String| SceneError::Engine {
            call: "mj_makeData",
            message,
            remedy: "; the scene may be too large for this machine",
        };
        made.map_err(failed)?;
        if data.is_null() {
            return Err(failed("it returned nothing".into()));
        }
        let mut worker = Self {
            scene: scene.clone(),
            guard,
            data,
            fresh: false,
            moved: Moved::default(),
            version: 0,
            collided: false,
            poisoned: None,
            drone_poses: vec![Pose::default(); scene.n_drones()],
            standing: Standing::all(scene),
            obstacle_poses: vec![None; scene.obstacles().len()],
            memory: Memory::default(),
            scratch: RayScratch::default(),
        };
        worker.moved = Moved::new(&worker);
        for drone in 0..scene.n_drones() {
            let address = scene.0.drone_qpos[drone];
            worker.write_qpos(address, &Pose::default());
        }
        worker.update()?;
        Ok(worker)
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// A body that rays do not see, as MuJoCo counts it: −1 for none.
    fn excluded(&self, body: Option<usize>) -> Result<c_int, SceneError> {
        let count = self.scene().bodies().len();
        match body {
            None => Ok(-1),
            Some(body) if body < count => Ok(body as c_int),
            Some(index) => Err(SceneError::NoSuch { what: "excluded body", index, count }),
        }
    }

    #[inline]
    pub(super) fn m(&self) -> *const ffi::mjModel {
        self.scene.0.model.ffi()
    }

    pub(super) fn alive(&self) -> Result<(), SceneError> {
        match &self.poisoned {
            None => Ok(()),
            Some(message) => Err(SceneError::Poisoned { message: message.clone() }),
        }
    }

    pub(super) fn ready(&self, asked: &'static str) -> Result<(), SceneError> {
        self.alive()?;
        if self.fresh { Ok(()) } else { Err(SceneError::Stale { asked }) }
    }

    /// Runs a call of MuJoCo; after a failure the data is reset and its poses are put back.
    ///
    /// # Safety
    /// As [`Guard::run`].
    pub(super) unsafe fn engine<F: Fn() + Copy>(
        &mut self,
        call: &'static str,
        work: F,
    ) -> Result<(), SceneError> {
        // SAFETY: by the contract of this function.
        let Err(message) = (unsafe { self.guard.run(work) }) else { return Ok(()) };
        self.fresh = false;
        self.collided = false;
        self.moved.everything();
        let remedy = if message.contains("mj_stackAlloc") || message.contains("memory") {
            "; give the scene more memory: <size memory=\"64M\"/>"
        } else {
            ""
        };
        if let Err(second) = self.reset() {
            self.poisoned = Some(format!("{message}; then {second}"));
        }
        Err(SceneError::Engine { call, message, remedy })
    }

    /// Clears MuJoCo's scratch memory, which a failed call leaves half used. Poses stay.
    fn reset(&mut self) -> Result<(), String> {
        let m = self.m();
        let data = self.data;
        // SAFETY: model and data belong together; qpos and mocap arrays have the sizes that the model states.
        unsafe {
            let nq = (*m).nq as usize;
            let nm = (*m).nmocap as usize;
            let qpos = slice((*data).qpos, nq).to_vec();
            let mocap_pos = slice((*data).mocap_pos.cast::<f64>(), 3 * nm).to_vec();
            let mocap_quat = slice((*data).mocap_quat.cast::<f64>(), 4 * nm).to_vec();
            self.guard.run(|| ffi::mj_resetData(m, data))?;
            ptr::copy_nonoverlapping(qpos.as_ptr(), (*data).qpos, nq);
            ptr::copy_nonoverlapping(mocap_pos.as_ptr(), (*data).mocap_pos.cast(), 3 * nm);
            ptr::copy_nonoverlapping(mocap_quat.as_ptr(), (*data).mocap_quat.cast(), 4 * nm);
        }
        Ok(())
    }

    /// Puts a drone somewhere: position (m, world) and quaternion x, y, z, w (body to world; made unit).
    ///
    /// # Errors
    /// [`SceneError::NoSuch`], and [`SceneError::BadPose`] for numbers that are not finite, which names the drone.
    pub fn set_drone(
        &mut self,
        drone: usize,
        pos_m: [f64; 3],
        quat_xyzw: [f64; 4],
    ) -> Result<(), SceneError> {
        self.alive()?;
        let address = *self.scene.0.drone_qpos.get(drone).ok_or_else(|| self.scene.no_drone(drone))?;
        let pose = sync::checked(|| format!("drone {drone}"), pos_m, quat_xyzw)?;
        // It stands there already: what was found out at these poses stays true.
        if same_bits(&self.drone_poses[drone], &pose) {
            return Ok(());
        }
        self.write_qpos(address, &pose);
        self.drone_poses[drone] = pose;
        self.moved.drone(drone);
        Ok(())
    }

    /// Pose of a drone as it was set.
    ///
    /// # Errors
    /// [`SceneError::NoSuch`].
    pub fn drone_pose(&self, drone: usize) -> Result<Pose, SceneError> {
        self.drone_poses.get(drone).copied().ok_or_else(|| self.scene.no_drone(drone))
    }

    fn write_qpos(&mut self, address: usize, pose: &Pose) {
        let q = sync::to_wxyz(pose.quat_xyzw);
        // SAFETY: `address` is the qpos address of a free joint: seven numbers of qpos.
        unsafe {
            let qpos = (*self.data).qpos.add(address);
            ptr::copy_nonoverlapping(pose.pos_m.as_ptr(), qpos, 3);
            ptr::copy_nonoverlapping(q.as_ptr(), qpos.add(3), 4);
        }
        self.fresh = false;
        self.collided = false;
    }

    /// Moves an obstacle (see [`Scene::obstacles`]): position (m, world) and quaternion x, y, z, w.
    ///
    /// # Errors
    /// [`SceneError::NoSuch`] and [`SceneError::BadPose`].
    pub fn set_obstacle(
        &mut self,
        index: usize,
        pos_m: [f64; 3],
        quat_xyzw: [f64; 4],
    ) -> Result<(), SceneError> {
        self.alive()?;
        let inner = &self.scene.0;
        let info = inner.obstacles.get(index).ok_or(SceneError::NoSuch {
            what: "obstacle",
            index,
            count: inner.obstacles.len(),
        })?;
        let pose = sync::checked(|| format!("obstacle '{}'", info.name), pos_m, quat_xyzw)?;
        if self.obstacle_poses[index].is_some_and(|known| same_bits(&known, &pose)) {
            return Ok(());
        }
        self.obstacle_poses[index] = Some(pose);
        let (kind, address) = (info.kind, info.address);
        match kind {
            ObstacleKind::FreeJoint => self.write_qpos(address, &pose),
            ObstacleKind::Mocap => {
                let q = sync::to_wxyz(pose.quat_xyzw);
                // SAFETY: `address` is the number of a mocap body.
                unsafe {
                    let d = &mut *self.data;
                    ptr::copy_nonoverlapping(
                        pose.pos_m.as_ptr(),
                        d.mocap_pos.cast::<f64>().add(3 * address),
                        3,
                    );
                    ptr::copy_nonoverlapping(q.as_ptr(), d.mocap_quat.cast::<f64>().add(4 * address), 4);
                }
                self.fresh = false;
                self.collided = false;
            }
        }
        self.moved.obstacle(self.drone_poses.len(), index);
        Ok(())
    }

    /// Whether everything stands where its pose says.
    pub(super) fn is_fresh(&self) -> bool {
        self.fresh
    }

    /// Notes that everything stands where its pose says.
    pub(super) fn placed(&mut self) {
        self.fresh = true;
        self.version += 1;
        self.collided = false;
    }

    /// The table of the scene's geoms, made where it is first asked for and shared by all workers.
    ///
    /// # Errors
    /// [`SceneError::Stale`].
    pub fn table(&self) -> Result<&Table, SceneError> {
        let poses = self.poses()?;
        Ok(self.scene.0.table.get_or_init(|| super::table::of_scene(&self.scene, &poses)))
    }

    /// Where everything is.
    ///
    /// # Errors
    /// [`SceneError::Stale`].
    pub fn poses(&self) -> Result<Poses<'_>, SceneError> {
        self.ready("the places of geoms")?;
        Ok(self.placed_poses())
    }

    /// Where everything was placed last. The lifetime is the caller's to bound: it must end before the data changes.
    fn placed_poses<'a>(&self) -> Poses<'a> {
        let inner = &self.scene.0;
        // SAFETY: the data holds a position and a matrix for each geom of its model and a position for each body.
        unsafe {
            let d = &*self.data;
            Poses {
                geom_pos_m: slice(d.geom_xpos.cast::<[f64; 3]>(), inner.geoms.len()),
                geom_mat: slice(d.geom_xmat.cast::<[f64; 9]>(), inner.geoms.len()),
                body_pos_m: slice(d.xpos.cast::<[f64; 3]>(), inner.bodies.len()),
                version: self.version,
            }
        }
    }

    /// What queries of `geometry` need: the table, where everything is, and what they remember of it.
    ///
    /// # Errors
    /// [`SceneError::Stale`].
    pub fn geometry(&mut self) -> Result<(&Table, Poses<'_>, &mut Memory), SceneError> {
        self.ready("the places of geoms")?;
        // No method that changes the data can run while the memory is lent.
        let poses = self.placed_poses();
        let table = self.scene.0.table.get_or_init(|| super::table::of_scene(&self.scene, &poses));
        Ok((table, poses, &mut self.memory))
    }

    /// Finds all contacts at these poses; [`Worker::contact`] reads them. Returns how many there are.
    ///
    /// # Errors
    /// [`SceneError::ContactsLost`] when MuJoCo dropped some for want of memory, [`SceneError::Engine`].
    pub fn collide(&mut self) -> Result<usize, SceneError> {
        self.ready("contacts")?;
        let (m, d) = (self.m(), self.data);
        // SAFETY: model and data belong together; warning is a fixed array of mjNWARNING entries.
        unsafe {
            let full = ffi::mjtWarning::mjWARN_CONTACTFULL as usize;
            (*d).warning[full].number = 0;
            self.engine("mj_collision", || ffi::mj_collision(m, d))?;
            let count = (*d).ncon as usize;
            if (*d).warning[full].number > 0 {
                return Err(SceneError::ContactsLost { count, arena_bytes: (*d).narena });
            }
            self.collided = true;
            Ok(count)
        }
    }

    /// Number of contacts that [`Worker::collide`] found.
    pub fn n_contacts(&self) -> usize {
        // SAFETY: the data lives as long as self.
        if self.collided { unsafe { (*self.data).ncon as usize } } else { 0 }
    }

    /// One contact of the last [`Worker::collide`]; none for a number out of range or after poses changed.
    pub fn contact(&self, index: usize) -> Option<RawContact> {
        if index >= self.n_contacts() {
            return None;
        }
        // SAFETY: the data holds ncon contacts.
        let c = unsafe { &*(*self.data).contact.add(index) };
        Some(RawContact {
            geom: c.geom,
            flex: c.flex,
            distance_m: c.dist,
            point_m: c.pos,
            normal: [c.frame[0], c.frame[1], c.frame[2]],
        })
    }

    /// Casts one ray. Geoms whose alpha is 0, whose group is off in `groups`, or whose body is `exclude_body` are not seen.
    ///
    /// The distance counts in lengths of `direction`.
    ///
    /// # Errors
    /// [`SceneError::Argument`] for a direction of length zero or numbers that are not finite; [`SceneError::Engine`].
    pub fn ray(
        &mut self,
        origin_m: [f64; 3],
        direction: [f64; 3],
        groups: Option<&[u8; 6]>,
        exclude_body: Option<usize>,
    ) -> Result<Option<RayHit>, SceneError> {
        self.ready("a ray")?;
        let n = direction.iter().map(|x| x * x).sum::<f64>();
        if !(n > 1e-24 && n < 1e24) || origin_m.iter().any(|x| !x.is_finite()) {
            return Err(SceneError::Argument {
                what: format!(
                    "a ray needs a finite origin and a direction that is not zero, got origin {origin_m:?}, direction \
                     {direction:?}"
                ),
            });
        }
        let (m, d) = (self.m(), self.data);
        let groups = groups.map_or(ptr::null(), |g| g.as_ptr());
        let exclude = self.excluded(exclude_body)?;
        let mut geom = -1;
        let mut normal = [0.0; 3];
        let mut distance = -1.0;
        let (o, v) = (&raw const origin_m, &raw const direction);
        let (g, nrm, dist) = (&raw mut geom, &raw mut normal, &raw mut distance);
        // SAFETY: all pointers are to locals that outlive the call, groups to six bytes.
        unsafe {
            self.engine("mj_ray", || *dist = ffi::mj_ray(m, d, o, v, groups, true, exclude, g, nrm))?;
        }
        Ok((distance >= 0.0).then_some(RayHit { distance, geom_id: geom, normal }))
    }

    /// Casts many rays from one point: `directions` (n × 3), `distances` (n; -1 = nothing), `geoms` (n; -1 = nothing),
    /// `normals` (n × 3, optional). Buffers belong to the caller; nothing is allocated here.
    ///
    /// # Errors
    /// [`SceneError::Argument`] when the buffers disagree; [`SceneError::Engine`].
    #[allow(clippy::too_many_arguments)]
    pub fn rays(
        &mut self,
        origin_m: [f64; 3],
        directions: &[[f64; 3]],
        groups: Option<&[u8; 6]>,
        exclude_body: Option<usize>,
        distances: &mut [f64],
        geoms: &mut [i32],
        mut normals: Option<&mut [[f64; 3]]>,
    ) -> Result<(), SceneError> {
        self.ready("rays")?;
        let n = directions.len();
        let normals_len = normals.as_ref().map_or(n, |v| v.len());
        if distances.len() != n || geoms.len() != n || normals_len != n {
            return Err(SceneError::Argument {
                what: format!(
                    "rays: {n} directions need {n} distances, geoms and normals, got {}, {} and {normals_len}",
                    distances.len(),
                    geoms.len()
                ),
            });
        }
        if origin_m.iter().any(|x| !x.is_finite()) {
            return Err(SceneError::Argument {
                what: format!("rays need a finite origin, got {origin_m:?}"),
            });
        }
        let (m, d) = (self.m(), self.data);
        let groups = groups.map_or(ptr::null(), |g| g.as_ptr());
        let exclude = self.excluded(exclude_body)?;
        let origin = &raw const origin_m;
        for start in (0..n).step_by(RAY_BLOCK) {
            let count = RAY_BLOCK.min(n - start);
            let v = directions[start..].as_ptr().cast::<f64>();
            let dist = distances[start..].as_mut_ptr();
            let geom = geoms[start..].as_mut_ptr();
            let normal = normals.as_mut().map_or(ptr::null_mut(), |v| v[start..].as_mut_ptr().cast::<f64>());
            // SAFETY: each buffer has `count` entries from `start` on, checked above.
            unsafe {
                self.engine("mj_multiRay", || {
                    ffi::mj_multiRay(
                        m,
                        d,
                        origin,
                        v,
                        groups,
                        true,
                        exclude,
                        geom,
                        dist,
                        normal,
                        count as c_int,
                        NO_CUTOFF,
                    );
                })?;
            }
        }
        Ok(())
    }

    /// Distance along `direction` (unit) to one geom, whatever its group and alpha; none for a miss, and for the type
    /// sdf, which MuJoCo casts only through [`Worker::ray`].
    ///
    /// # Errors
    /// [`SceneError::NoSuch`], [`SceneError::Engine`].
    pub fn ray_to_geom(
        &mut self,
        geom: usize,
        origin_m: [f64; 3],
        direction: [f64; 3],
    ) -> Result<Option<f64>, SceneError> {
        self.ready("a ray")?;
        let kind = self.geom_kind(geom)?;
        let (m, d) = (self.m(), self.data);
        let mut distance = -1.0;
        let out = &raw mut distance;
        let (o, v) = (&raw const origin_m, &raw const direction);
        let id = geom as c_int;
        // SAFETY: a valid geom id; pointers to locals and to arrays of the model and the data with that many geoms.
        unsafe {
            self.engine("mj_ray of one geom", || {
                *out = match kind {
                    GeomType::Sdf => -1.0,
                    GeomType::Mesh => ffi::mj_rayMesh(m, d, id, o, v, ptr::null_mut()),
                    GeomType::Hfield => ffi::mj_rayHfield(m, d, id, o, v, ptr::null_mut()),
                    _ => ffi::mju_rayGeom(
                        (*d).geom_xpos.cast::<[f64; 3]>().add(geom),
                        (*d).geom_xmat.cast::<[f64; 9]>().add(geom),
                        (*m).geom_size.cast::<[f64; 3]>().add(geom),
                        o,
                        v,
                        *(*m).geom_type.add(geom),
                        ptr::null_mut(),
                    ),
                };
            })?;
        }
        Ok((distance >= 0.0).then_some(distance))
    }

    /// Signed distance of two geoms by mj_geomDistance, up to `max_m`. MuJoCo 3.17.0 has none for signed distance fields
    /// (it says the maximum) and leaves out cells of height fields; `sense::Queries::clearance` is right for both.
    ///
    /// # Errors
    /// [`SceneError::NoSuch`], [`SceneError::Engine`].
    pub fn geom_distance(
        &mut self,
        first: usize,
        second: usize,
        max_m: f64,
    ) -> Result<GeomDistance, SceneError> {
        self.ready("a distance")?;
        self.geom_kind(first)?;
        self.geom_kind(second)?;
        let (m, d) = (self.m(), self.data);
        let mut segment = [0.0; 6];
        let mut distance = max_m;
        let (out, seg) = (&raw mut distance, &raw mut segment);
        let (a, b) = (first as c_int, second as c_int);
        // SAFETY: valid geom ids, pointers to locals.
        unsafe {
            self.engine("mj_geomDistance", || *out = ffi::mj_geomDistance(m, d, a, b, max_m, seg))?;
        }
        Ok(GeomDistance {
            distance_m: distance,
            on_first_m: [segment[0], segment[1], segment[2]],
            on_second_m: [segment[3], segment[4], segment[5]],
        })
    }

    pub(super) fn geom_kind(&self, geom: usize) -> Result<GeomType, SceneError> {
        let geoms = &self.scene.0.geoms;
        geoms.get(geom).map(|g| g.kind).ok_or(SceneError::NoSuch {
            what: "geom",
            index: geom,
            count: geoms.len(),
        })
    }

    /// Position (m) and rotation matrix (row major) of a geom in the world.
    ///
    /// # Errors
    /// [`SceneError::NoSuch`], [`SceneError::Stale`].
    pub fn geom_pose(&self, geom: usize) -> Result<([f64; 3], [f64; 9]), SceneError> {
        self.ready("the place of a geom")?;
        self.geom_kind(geom)?;
        // SAFETY: a valid geom id.
        unsafe {
            let d = &*self.data;
            Ok((*d.geom_xpos.cast::<[f64; 3]>().add(geom), *d.geom_xmat.cast::<[f64; 9]>().add(geom)))
        }
    }

    /// Where the geoms of a drone are in its body frame, into `places`.
    pub(crate) fn drone_geom_places(
        &self,
        drone: usize,
        places: &mut Vec<GeomPlace>,
    ) -> Result<(), SceneError> {
        self.ready("the place of a geom")?;
        let body = self.body_pose(self.scene.drone_body(drone)?)?;
        let r = crate::math::quat::matrix(body.quat_xyzw);
        places.clear();
        for &geom in self.scene.drone_geoms(drone)? {
            let (x, m) = self.geom_pose(geom)?;
            let d = [0, 1, 2].map(|k| x[k] - body.pos_m[k]);
            let local = [0, 1, 2].map(|k| r[0][k] * d[0] + r[1][k] * d[1] + r[2][k] * d[2]);
            let mut turned = [0.0; 9];
            for i in 0..3 {
                for j in 0..3 {
                    turned[3 * i + j] = r[0][i] * m[j] + r[1][i] * m[3 + j] + r[2][i] * m[6 + j];
                }
            }
            places.push((local, turned));
        }
        Ok(())
    }

    /// Moves only the geoms of a drone, for [`Worker::geom_distance`] at poses between two steps. `places` are those of
    /// [`Worker::drone_geom_places`]. [`Worker::update`] puts everything back to the pose that was set.
    pub(crate) fn move_drone_geoms(
        &mut self,
        drone: usize,
        pose: &Pose,
        places: &[GeomPlace],
    ) -> Result<(), SceneError> {
        self.ready("moving geoms")?;
        let scene = self.scene.clone();
        let geoms = scene.drone_geoms(drone)?;
        if geoms.len() != places.len() {
            return Err(SceneError::Argument {
                what: format!("drone {drone} has {} geoms, got places of {}", geoms.len(), places.len()),
            });
        }
        // The next update places it where its own pose says.
        self.moved.drone(drone);
        let r = crate::math::quat::matrix(pose.quat_xyzw);
        for (&geom, (local, turned)) in geoms.iter().zip(places) {
            let mut x = pose.pos_m;
            let mut m = [0.0; 9];
            for i in 0..3 {
                for k in 0..3 {
                    x[i] += r[i][k] * local[k];
                }
                for j in 0..3 {
                    m[3 * i + j] = r[i][0] * turned[j] + r[i][1] * turned[3 + j] + r[i][2] * turned[6 + j];
                }
            }
            // SAFETY: a valid geom id; these arrays are outputs of mj_kinematics that any caller may write.
            unsafe {
                *(*self.data).geom_xpos.cast::<[f64; 3]>().add(geom) = x;
                *(*self.data).geom_xmat.cast::<[f64; 9]>().add(geom) = m;
            }
        }
        self.version += 1;
        self.collided = false;
        Ok(())
    }

    /// Pose of a body in the world.
    ///
    /// # Errors
    /// [`SceneError::NoSuch`], [`SceneError::Stale`].
    pub fn body_pose(&self, body: usize) -> Result<Pose, SceneError> {
        self.ready("the place of a body")?;
        let count = self.scene.0.bodies.len();
        if body >= count {
            return Err(SceneError::NoSuch { what: "body", index: body, count });
        }
        // SAFETY: a valid body id.
        unsafe {
            let d = &*self.data;
            let quat = *d.xquat.cast::<[f64; 4]>().add(body);
            Ok(Pose { pos_m: *d.xpos.cast::<[f64; 3]>().add(body), quat_xyzw: sync::from_wxyz(quat) })
        }
    }

    /// Pose of a camera as MuJoCo computes it: camera to world; it looks along its −z, y up.
    ///
    /// # Errors
    /// [`SceneError::NoSuch`], [`SceneError::Stale`].
    pub fn camera_pose(&self, camera: usize) -> Result<Pose, SceneError> {
        self.ready("the place of a camera")?;
        let count = self.scene.0.cameras.len();
        if camera >= count {
            return Err(SceneError::NoSuch { what: "camera", index: camera, count });
        }
        // SAFETY: a valid camera id.
        unsafe {
            let d = &*self.data;
            Ok(Pose {
                pos_m: *d.cam_xpos.cast::<[f64; 3]>().add(camera),
                quat_xyzw: sync::quat_of_matrix(&*d.cam_xmat.cast::<[f64; 9]>().add(camera)),
            })
        }
    }

    /// Vertical distance (m) from a drone's origin down to the scene: to the nearest geom under it that is no part of
    /// a drone and that can collide. None where there is nothing below.
    ///
    /// Groups and alpha do not matter here. A plane is endless and counts from the side that its normal points to only.
    ///
    /// # Errors
    /// [`SceneError::NoSuch`], [`SceneError::Stale`], [`SceneError::Engine`].
    pub fn ground_distance(&mut self, drone: usize) -> Result<Option<f64>, SceneError> {
        self.ready("the ground distance")?;
        let origin = self.drone_pose(drone)?.pos_m;
        self.ground_below(origin)
    }

    /// As [`Worker::ground_distance`], from any point; none also for a point whose coordinates are not finite.
    ///
    /// # Errors
    /// [`SceneError::Stale`], [`SceneError::Engine`].
    pub fn ground_below(&mut self, origin_m: [f64; 3]) -> Result<Option<f64>, SceneError> {
        self.ready("the ground distance")?;
        self.straight(origin_m, -1.0)
    }

    /// Vertical distance (m) from any point up to the scene, which is what stands above a drone there; all else as in
    /// [`Worker::ground_distance`].
    ///
    /// # Errors
    /// [`SceneError::Stale`], [`SceneError::Engine`].
    pub fn ceiling_above(&mut self, origin_m: [f64; 3]) -> Result<Option<f64>, SceneError> {
        self.ready("the ceiling distance")?;
        self.straight(origin_m, 1.0)
    }

    /// Distance (m) from a point straight up (`up` = 1) or down (−1) to the nearest geom that can collide and is no part of a drone.
    fn straight(&mut self, origin_m: [f64; 3], up: f64) -> Result<Option<f64>, SceneError> {
        // Nothing is known to stand over or under a place that is none.
        if origin_m.iter().any(|x| !x.is_finite()) {
            return Ok(None);
        }
        let direction = [0.0, 0.0, up];
        let mut best = f64::INFINITY;
        let mut has_sdf = false;
        for i in 0..self.standing.len() {
            let Standing { geom, kind, bounding_radius_m: r } = self.standing[i];
            if kind == GeomType::Plane {
                // Contacts see the whole plane, MuJoCo's rays only its rectangle.
                let (p, r) = self.geom_pose(geom)?;
                let normal = [r[2], r[5], r[8]];
                let above = (0..3).map(|i| (origin_m[i] - p[i]) * normal[i]).sum::<f64>();
                let towards = -up * normal[2];
                if towards > 1e-9 && above >= 0.0 {
                    best = best.min(above / towards);
                }
                continue;
            }
            // SAFETY: a valid geom id.
            let p = unsafe { *(*self.data).geom_xpos.cast::<[f64; 3]>().add(geom) };
            let (dx, dy) = (p[0] - origin_m[0], p[1] - origin_m[1]);
            // How far along the ray the middle of the geom is.
            let ahead = up * (p[2] - origin_m[2]);
            // Beside the ray, behind its start, or farther than what was found.
            if dx * dx + dy * dy > r * r * (1.0 + 1e-9) || ahead + r < 0.0 || ahead - r > best {
                continue;
            }
            if kind == GeomType::Sdf {
                has_sdf = true;
                continue;
            }
            if let Some(t) = self.ray_to_geom(geom, origin_m, direction)? {
                best = best.min(t);
            }
        }
        if has_sdf {
            best = best.min(self.straight_to_any(origin_m, up)?);
        }
        Ok(best.is_finite().then_some(best))
    }

    /// As [`Worker::straight`] by rays that see all geoms, signed distance fields too, one behind the other until one counts; infinity
    /// where none does.
    fn straight_to_any(&mut self, origin_m: [f64; 3], up: f64) -> Result<f64, SceneError> {
        let scene = self.scene.clone();
        let mut from = origin_m;
        for _ in 0..64 {
            let Some(hit) = self.ray(from, [0.0, 0.0, up], None, None)? else { break };
            let Some(geom) = usize::try_from(hit.geom_id).ok().and_then(|g| scene.0.geoms.get(g)) else {
                break;
            };
            from[2] += up * hit.distance;
            if geom.drone.is_none() && geom.can_collide() {
                return Ok(up * (from[2] - origin_m[2]));
            }
            from[2] += up * 1e-9 * from[2].abs().max(1.0);
        }
        Ok(f64::INFINITY)
    }
}

/// Whether two poses are the same to the bit.
fn same_bits(a: &Pose, b: &Pose) -> bool {
    let bits = |p: &Pose| (p.pos_m.map(f64::to_bits), p.quat_xyzw.map(f64::to_bits));
    bits(a) == bits(b)
}

/// Beyond any scene: nothing is cut off, so that "nothing there" and "too far" can be told apart.
const NO_CUTOFF: f64 = 1e10;

/// Workers of one scene for many threads: each task borrows one, so there are as many as tasks that ran at once.
pub struct WorkerPool {
    scene: Scene,
    free: Mutex<Vec<Worker>>,
    /// Where workers come from and go back to, where this pool keeps them for a while only.
    shared: Option<Arc<WorkerPool>>,
}

impl WorkerPool {
    /// An empty pool; workers are made when they are first needed.
    pub fn new(scene: &Scene) -> Self {
        Self { scene: scene.clone(), free: Mutex::new(Vec::new()), shared: None }
    }

    /// A pool that takes its workers from another and gives them back when it is dropped. In between they are its own, so that a
    /// world that is asked often finds its worker as it left it.
    pub fn within(shared: &Arc<WorkerPool>) -> Self {
        Self { scene: shared.scene.clone(), free: Mutex::new(Vec::new()), shared: Some(shared.clone()) }
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    fn free(&self) -> std::sync::MutexGuard<'_, Vec<Worker>> {
        self.free.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Lends a worker, which comes back when what is returned is dropped. It holds whatever poses it was left with: set all that
    /// matter.
    ///
    /// # Errors
    /// [`SceneError::Engine`] when a new worker cannot be made.
    pub fn lend(&self) -> Result<Lent<'_>, SceneError> {
        let own = self.free().pop();
        let free = own.or_else(|| self.shared.as_ref().and_then(|shared| shared.free().pop()));
        let worker = match free {
            Some(worker) => worker,
            None => self.scene.worker()?,
        };
        Ok(Lent { pool: self, worker: ManuallyDrop::new(worker) })
    }

    /// Lends a worker to `task`, as [`WorkerPool::lend`] does.
    ///
    /// # Errors
    /// [`SceneError::Engine`] when a new worker cannot be made.
    pub fn with<T>(&self, task: impl FnOnce(&mut Worker) -> T) -> Result<T, SceneError> {
        Ok(task(&mut *self.lend()?))
    }
}

impl Drop for WorkerPool {
    fn drop(&mut self) {
        if let Some(shared) = &self.shared {
            let mut own = std::mem::take(&mut *self.free());
            shared.free().append(&mut own);
        }
    }
}

/// A worker that belongs to a [`WorkerPool`], to which it goes back when this is dropped.
pub struct Lent<'a> {
    pool: &'a WorkerPool,
    worker: ManuallyDrop<Worker>,
}

impl Deref for Lent<'_> {
    type Target = Worker;
    fn deref(&self) -> &Worker {
        &self.worker
    }
}

impl DerefMut for Lent<'_> {
    fn deref_mut(&mut self) -> &mut Worker {
        &mut self.worker
    }
}

impl Drop for Lent<'_> {
    fn drop(&mut self) {
        // SAFETY: the worker is taken once, and nothing can read it after this.
        let worker = unsafe { ManuallyDrop::take(&mut self.worker) };
        // One that was left in the middle of a panic, or that MuJoCo broke, is not used again.
        if worker.poisoned.is_none() && !std::thread::panicking() {
            self.pool.free().push(worker);
        }
    }
}
