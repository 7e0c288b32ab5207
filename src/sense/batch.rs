//! Depth images, contacts and clearances of many worlds at once.

use rayon::prelude::*;

use super::SenseError;
use super::clearance::Clearance;
use super::contact::Contact;
use super::depth::{Camera, DepthPlanes, STATUS_NOT_RENDERED};
use super::queries::Queries;
use crate::geometry::ray::Planes;
use crate::scene::{Lent, Pose, Scene, SceneError, Worker, WorkerPool};

/// Worlds that can be looked at, each with a worker of its scene, and the queries of [`Queries`] for all of them in parallel. Results do not
/// depend on the number of threads.
///
/// A world that fails (say, with a pose that is not finite) harms no other: the error names it, and the others are complete.
pub trait Worlds: Sync {
    /// Number of worlds.
    fn n_worlds(&self) -> usize;

    /// Number of drones in each.
    fn n_drones(&self) -> usize;

    /// A worker that holds the poses of a world, updated.
    ///
    /// # Errors
    /// [`SceneError`], e.g. for a pose that is not finite.
    fn worker(&self, world: usize) -> Result<Lent<'_>, SceneError>;

    /// What forbids to look at any world.
    ///
    /// # Errors
    /// [`SenseError::Shape`] for arrays of poses of the wrong size.
    fn check(&self) -> Result<(), SenseError> {
        Ok(())
    }

    /// Finds the contacts of all drones, into one list for each world. `limited`, one number for each world: how many pairs of geoms may
    /// have lost contacts, as [`Queries::contacts`] returns it. The list of a world that fails is empty.
    ///
    /// # Errors
    /// Those of [`Worlds::check`] before anything is looked for; [`SenseError::Worlds`] with all worlds that failed.
    fn contacts(&self, out: &mut Vec<Vec<Contact>>, limited: &mut Vec<usize>) -> Result<(), SenseError>
    where
        Self: Sized,
    {
        self.check()?;
        contacts_of(self, out, limited)
    }

    /// Finds the clearance of all drones, (world, drone), looking no farther than `max_distance_m`. In a world that fails distances
    /// are NaN and not exact.
    ///
    /// # Errors
    /// As [`Worlds::contacts`].
    fn clearances(&self, max_distance_m: f64, out: &mut Vec<Clearance>) -> Result<(), SenseError>
    where
        Self: Sized,
    {
        self.check()?;
        clearances_of(self, max_distance_m, out)
    }

    /// Renders cameras, only the planes that are asked for, (world, camera, height, width), into buffers of the caller; the others cost
    /// nothing. `cameras` names those of a world, as many and of the same size in each; `out_pose`: poses of the cameras, (world, camera).
    ///
    /// In a world that fails depth and pose are NaN, the status is [`STATUS_NOT_RENDERED`], ids are −1 and normals zero.
    ///
    /// # Errors
    /// [`SenseError::Shape`], also for a plane or poses of another length, and [`SenseError::Parameter`], also for worlds whose cameras
    /// differ in number or size, before anything is rendered; [`SenseError::Worlds`] with all worlds that failed.
    fn render<'c>(
        &self,
        cameras: &(dyn Fn(usize) -> &'c [Camera] + Sync),
        planes: DepthPlanes,
        out_pose: &mut [Pose],
    ) -> Result<(), SenseError>
    where
        Self: Sized,
    {
        self.check()?;
        render_of(self, cameras, planes, out_pose)
    }
}

/// Worlds of one scene at given poses.
#[derive(Clone, Copy)]
pub struct PosedWorlds<'a> {
    pool: &'a WorkerPool,
    poses: &'a WorldPoses<'a>,
}

impl Worlds for PosedWorlds<'_> {
    fn n_worlds(&self) -> usize {
        self.poses.n_worlds
    }

    fn n_drones(&self) -> usize {
        self.pool.scene().n_drones()
    }

    fn worker(&self, world: usize) -> Result<Lent<'_>, SceneError> {
        let mut worker = self.pool.lend()?;
        self.poses.apply(world, &mut worker)?;
        Ok(worker)
    }

    fn check(&self) -> Result<(), SenseError> {
        self.poses.check(self.pool.scene())
    }
}

/// Poses of many worlds.
#[derive(Clone, Copy, Debug)]
pub struct WorldPoses<'a> {
    /// Number of worlds.
    pub n_worlds: usize,
    /// Positions of drones, m, (world, drone, 3).
    pub drone_pos_m: &'a [f64],
    /// Orientations of drones, x y z w, (world, drone, 4).
    pub drone_quat_xyzw: &'a [f64],
    /// Positions of all obstacles, m, (world, obstacle, 3); none leaves them where the model places them.
    pub obstacle_pos_m: Option<&'a [f64]>,
    /// Orientations of all obstacles, x y z w, (world, obstacle, 4); none leaves them as the model turns them.
    pub obstacle_quat_xyzw: Option<&'a [f64]>,
}

impl WorldPoses<'_> {
    /// These worlds in the scene of a pool, ready to be looked at.
    pub fn within<'a>(&'a self, pool: &'a WorkerPool) -> PosedWorlds<'a> {
        PosedWorlds { pool, poses: self }
    }

    fn check(&self, scene: &Scene) -> Result<(), SenseError> {
        let (w, d, o) = (self.n_worlds, scene.n_drones(), scene.obstacles().len());
        let check = |what, expected: usize, found: usize, shape: String| {
            if expected == found { Ok(()) } else { Err(SenseError::Shape { what, shape, expected, found }) }
        };
        let rows = |n: usize, width: usize| w.saturating_mul(n).saturating_mul(width);
        check("drone positions", rows(d, 3), self.drone_pos_m.len(), format!("({w} worlds, {d} drones, 3)"))?;
        check(
            "drone quaternions",
            rows(d, 4),
            self.drone_quat_xyzw.len(),
            format!("({w} worlds, {d} drones, 4)"),
        )?;
        if let Some(p) = self.obstacle_pos_m {
            check("obstacle positions", rows(o, 3), p.len(), format!("({w} worlds, {o} obstacles, 3)"))?;
        }
        if let Some(q) = self.obstacle_quat_xyzw {
            check("obstacle quaternions", rows(o, 4), q.len(), format!("({w} worlds, {o} obstacles, 4)"))?;
        }
        Ok(())
    }

    /// Puts the poses of one world into a worker and updates it.
    ///
    /// # Errors
    /// [`SceneError`], e.g. for a pose that is not finite. Arrays that are too short are an error too.
    pub fn apply(&self, world: usize, worker: &mut Worker) -> Result<(), SceneError> {
        let scene = worker.scene().clone();
        let n = scene.n_drones();
        let short = || SceneError::Argument {
            what: format!(
                "world {world}: the arrays of poses are too short for {n} drones and {} obstacles",
                scene.obstacles().len()
            ),
        };
        for drone in 0..n {
            let row = world * n + drone;
            let pos = row3(self.drone_pos_m, row).ok_or_else(short)?;
            let quat = row4(self.drone_quat_xyzw, row).ok_or_else(short)?;
            worker.set_drone(drone, pos, quat)?;
        }
        let n = scene.obstacles().len();
        for (index, info) in scene.obstacles().iter().enumerate() {
            let row = world * n + index;
            let pos = match self.obstacle_pos_m {
                None => info.pos_m,
                Some(p) => row3(p, row).ok_or_else(short)?,
            };
            let quat = match self.obstacle_quat_xyzw {
                None => info.quat_xyzw,
                Some(q) => row4(q, row).ok_or_else(short)?,
            };
            worker.set_obstacle(index, pos, quat)?;
        }
        worker.update()
    }
}

fn row3(data: &[f64], row: usize) -> Option<[f64; 3]> {
    data.get(3 * row..3 * row + 3)?.try_into().ok()
}

fn row4(data: &[f64], row: usize) -> Option<[f64; 4]> {
    data.get(4 * row..4 * row + 4)?.try_into().ok()
}

/// Depth images of many worlds, in buffers that are reused.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DepthBatch {
    /// Number of worlds.
    pub n_worlds: usize,
    /// Number of cameras, in the order in which they were given.
    pub n_cameras: usize,
    /// Pixels of one image.
    pub n_pixels: usize,
    /// Depth, m, (world, camera, height, width).
    pub depth_m: Vec<f32>,
    /// [`PixelStatus`](super::PixelStatus), or [`STATUS_NOT_RENDERED`], (world, camera, height, width).
    pub status: Vec<u8>,
    /// Geom ids, (world, camera, height, width).
    pub geom_id: Vec<i32>,
    /// Body ids, (world, camera, height, width).
    pub body_id: Vec<i32>,
    /// Poses of the cameras, (world, camera); NaN where the world failed.
    pub pose: Vec<Pose>,
}

/// Most pixels of a [`DepthBatch`].
const MAX_BATCH_PIXELS: usize = 1 << 36;

impl DepthBatch {
    /// Renders all cameras, which must have the same image size, in all worlds; see [`Worlds::render`].
    ///
    /// # Errors
    /// As [`Worlds::render`].
    pub fn render(&mut self, worlds: &impl Worlds, cameras: &[Camera]) -> Result<(), SenseError> {
        worlds.check()?;
        let (planes, out_pose) = self.fit(cameras, worlds.n_worlds())?;
        render_of(worlds, &|_| cameras, planes, out_pose)
    }

    /// Makes room for the images of these cameras in `n_worlds` worlds; the planes to render into, and where poses of cameras go.
    ///
    /// # Errors
    /// [`SenseError::Parameter`] for no camera, cameras of several sizes, and more pixels than a batch holds.
    pub fn fit(
        &mut self,
        cameras: &[Camera],
        n_worlds: usize,
    ) -> Result<(DepthPlanes<'_>, &mut [Pose]), SenseError> {
        let (images, pixels) = batch_size(cameras, n_worlds)?;
        self.n_worlds = n_worlds;
        self.n_cameras = cameras.len();
        self.n_pixels = pixels;
        self.depth_m.resize(images * pixels, 0.0);
        self.status.resize(images * pixels, 0);
        self.geom_id.resize(images * pixels, 0);
        self.body_id.resize(images * pixels, 0);
        self.pose.resize(images, Pose::default());
        let planes = DepthPlanes {
            depth_m: Some(&mut self.depth_m),
            status: Some(&mut self.status),
            geom_id: Some(&mut self.geom_id),
            body_id: Some(&mut self.body_id),
            normal: None,
        };
        Ok((planes, &mut self.pose))
    }
}

/// See [`Worlds::render`].
fn render_of<'c>(
    worlds: &impl Worlds,
    cameras: &(dyn Fn(usize) -> &'c [Camera] + Sync),
    planes: DepthPlanes,
    out_pose: &mut [Pose],
) -> Result<(), SenseError> {
    let n_worlds = worlds.n_worlds();
    if n_worlds == 0 {
        return Ok(());
    }
    let first = cameras(0);
    let (images, pixels) = batch_size(first, n_worlds)?;
    for world in 1..n_worlds {
        let own = cameras(world);
        if !std::ptr::eq(own, first) && (own.len() != first.len() || batch_size(own, 1)?.1 != pixels) {
            return Err(SenseError::Parameter {
                what: format!(
                    "cameras of world {world}: expected {} of {pixels} pixels each, as in the first world, got {} of {}; give all \
                     scenes of a batch cameras of one size",
                    first.len(),
                    own.len(),
                    own.first().map_or(0, |c| c.pattern().len())
                ),
            });
        }
    }
    if out_pose.len() != images {
        let shape = format!("({n_worlds} worlds, {} cameras)", first.len());
        let (expected, found) = (images, out_pose.len());
        return Err(SenseError::Shape { what: "poses of cameras", shape, expected, found });
    }
    let planes = Planes {
        depth: planes.depth_m,
        status: planes.status,
        geom: planes.geom_id,
        body: planes.body_id,
        normal: planes.normal,
    };
    planes.check(images * pixels)?;
    let mut out: Vec<(Planes, &mut [Pose])> =
        planes.chunks(first.len() * pixels, n_worlds).zip(out_pose.chunks_mut(first.len())).collect();
    let results: Vec<Result<(), SenseError>> = out
        .par_iter_mut()
        .enumerate()
        .map(|(world, (planes, pose))| {
            let done = worlds.worker(world).map_err(SenseError::from).and_then(|mut worker| {
                let images = planes.reborrow().chunks(pixels, first.len()).zip(pose.iter_mut());
                for (camera, (planes, pose)) in cameras(world).iter().zip(images) {
                    *pose = camera.render_planes(&mut worker, planes)?;
                }
                Ok(())
            });
            if done.is_err() {
                fill_unknown(planes.reborrow());
                pose.fill(Pose { pos_m: [f64::NAN; 3], quat_xyzw: [f64::NAN; 4] });
            }
            done
        })
        .collect();
    all_or_failures(results)
}

/// Images of a batch and pixels of each, or what forbids it.
fn batch_size(cameras: &[Camera], n_worlds: usize) -> Result<(usize, usize), SenseError> {
    let Some(first) = cameras.first() else {
        return Err(SenseError::Parameter { what: "rendering needs at least one camera, got none".into() });
    };
    if let Some(odd) = cameras.iter().find(|c| (c.width(), c.height()) != (first.width(), first.height())) {
        return Err(SenseError::Parameter {
            what: format!(
                "cameras of a batch need one image size: '{}' has {} x {}, '{}' has {} x {}",
                first.name(),
                first.width(),
                first.height(),
                odd.name(),
                odd.width(),
                odd.height()
            ),
        });
    }
    let pixels = first.pattern().len();
    let images = n_worlds.saturating_mul(cameras.len());
    // Four planes come to 13 bytes a pixel; refuse what no machine holds before asking for it.
    if images.saturating_mul(pixels) > MAX_BATCH_PIXELS {
        return Err(SenseError::Parameter {
            what: format!(
                "a batch holds at most {MAX_BATCH_PIXELS} pixels (about 0.9 TB), got {n_worlds} worlds x {} cameras x \
                 {pixels} pixels; render fewer worlds at once",
                cameras.len()
            ),
        });
    }
    Ok((images, pixels))
}

/// Fills the planes of a world that failed.
fn fill_unknown(planes: Planes) {
    planes.depth.into_iter().for_each(|p| p.fill(f32::NAN));
    planes.status.into_iter().for_each(|p| p.fill(STATUS_NOT_RENDERED));
    planes.geom.into_iter().for_each(|p| p.fill(-1));
    planes.body.into_iter().for_each(|p| p.fill(-1));
    planes.normal.into_iter().for_each(|p| p.fill([0.0; 3]));
}

fn all_or_failures(results: Vec<Result<(), SenseError>>) -> Result<(), SenseError> {
    let worlds = results.len();
    let failures: Vec<_> =
        results.into_iter().enumerate().filter_map(|(world, r)| r.err().map(|e| (world, e))).collect();
    if failures.is_empty() { Ok(()) } else { Err(SenseError::Worlds { worlds, failures }) }
}

/// See [`Worlds::contacts`].
fn contacts_of(
    worlds: &impl Worlds,
    out: &mut Vec<Vec<Contact>>,
    limited: &mut Vec<usize>,
) -> Result<(), SenseError> {
    out.resize_with(worlds.n_worlds(), Vec::new);
    limited.clear();
    limited.resize(worlds.n_worlds(), 0);
    let results = out
        .par_iter_mut()
        .zip(limited.par_iter_mut())
        .enumerate()
        .map(|(world, (out, limited))| {
            out.clear();
            let done = worlds.worker(world).map_err(SenseError::from).and_then(|mut worker| {
                *limited = Queries::at(&mut worker).contacts(out)?;
                Ok(())
            });
            if done.is_err() {
                out.clear();
            }
            done
        })
        .collect();
    all_or_failures(results)
}

/// See [`Worlds::clearances`].
fn clearances_of(
    worlds: &impl Worlds,
    max_distance_m: f64,
    out: &mut Vec<Clearance>,
) -> Result<(), SenseError> {
    let n = worlds.n_drones();
    out.clear();
    if n == 0 {
        return Ok(());
    }
    out.resize(worlds.n_worlds() * n, Clearance::unknown(0));
    let results = out
        .par_chunks_mut(n)
        .enumerate()
        .map(|(world, row)| {
            let done = worlds.worker(world).map_err(SenseError::from).and_then(|mut worker| {
                for (drone, out) in row.iter_mut().enumerate() {
                    *out = Queries::at(&mut worker).clearance(drone, max_distance_m)?;
                }
                Ok(())
            });
            if done.is_err() {
                row.iter_mut().enumerate().for_each(|(drone, out)| *out = Clearance::unknown(drone));
            }
            done
        })
        .collect();
    all_or_failures(results)
}
