//! A ray caster of our own over the geometry of the compiled model, sixteen rays at a time.
//!
//! It sees what `mj_ray` of MuJoCo 3.17.0 sees: solids from outside and, from inside, their far wall; planes from above
//! and only within their rectangle where they have one; the triangles of meshes (not the hull) and height fields from
//! both sides; nothing of geoms whose alpha is 0, whose group is off or whose body is excluded. Normals point out of the
//! geom, whichever side was seen. Flexes and skins are not seen, as by `mj_ray`. Signed distance fields are left to
//! MuJoCo's own rays, for those pixels that may see one.
//!
//! How it works: what never moves is kept once for each scene, in groups of sixteen neighbours; what moves is placed for
//! each frame. Of both, a list of what the sensor may see is made, near to far. Every tile of 8 × 8 pixels tests its
//! pyramid against sixteen geoms at a time, and its four packets of 4 × 4 rays meet the geoms that remain, until nothing
//! nearer can come. Meshes have a tree of boxes, height fields a pyramid of heights. Distances are f32; what all rays of
//! a frame share is computed in f64 before it is rounded. Single rays from many points ([`cast_rays`]) are f64 throughout.
//!
//! Lanes are those of the processor (AVX-512, AVX2, SSE, NEON), chosen at run time. Results do not depend on threads or
//! batches. Processors without fused multiplication and addition round differently.

pub(super) mod bvh;
mod capsule;
mod cuboid;
mod cylinder;
mod ellipsoid;
mod frame;
pub(super) mod hfield;
mod lanes;
pub(super) mod mesh;
mod oracle;
mod pattern;
mod placed;
mod plane;
mod single;
mod sphere;
pub(super) mod world;

use serde::{Deserialize, Serialize};

pub(super) use frame::Rule;
pub(super) use oracle::many as oracle_rays;
pub use pattern::RayPattern;

use super::SenseError;
use crate::math::quat;
use crate::scene::{GeomType, Pose, Scene, SceneError, Worker};
use frame::{Buffers, Job, Sink};
use placed::Placed;
use world::{MAX_GEOMS, Shape, World};

/// Who casts the rays of a depth image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Caster {
    /// Propwash's own, sixteen rays at a time in f32.
    #[default]
    Native,
    /// `mj_multiRay` of MuJoCo, one ray after the other in f64: the reference.
    MuJoCo,
}

/// What rays see.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RayQuery {
    pub(super) groups: [u8; 6],
    pub(super) own_drone: Option<usize>,
    pub(super) own_body: Option<usize>,
    /// Bodies of the own drone beyond the root carry geoms: MuJoCo's rays have to pass through them one by one.
    pub(super) compound: bool,
}

type Query = RayQuery;

impl Default for RayQuery {
    /// Groups 0, 1 and 2, all bodies.
    fn default() -> Self {
        Self { groups: [1, 1, 1, 0, 0, 0], own_drone: None, own_body: None, compound: false }
    }
}

impl RayQuery {
    /// Sets which of the six geom groups are seen.
    #[must_use]
    pub fn with_groups(mut self, groups: [bool; 6]) -> Self {
        self.groups = groups.map(u8::from);
        self
    }

    /// Does not see a drone.
    ///
    /// # Errors
    /// [`SceneError::NoSuch`].
    pub fn without_drone(mut self, scene: &Scene, drone: usize) -> Result<Self, SceneError> {
        let root = scene.drone_body(drone)?;
        self.own_drone = Some(drone);
        self.own_body = Some(root);
        self.compound = scene.drone_geoms(drone)?.iter().any(|g| scene.geoms()[*g].body_id != root);
        Ok(self)
    }

    /// Does not see a body (its children are seen). Casting is an error where the scene has no such body.
    #[must_use]
    pub fn without_body(mut self, body: usize) -> Self {
        self.own_drone = None;
        self.own_body = Some(body);
        self.compound = false;
        self
    }

    /// Sees all bodies.
    #[must_use]
    pub fn with_all_bodies(mut self) -> Self {
        self.own_drone = None;
        self.own_body = None;
        self.compound = false;
        self
    }

    /// What it does not see exists in this scene.
    fn check(&self, scene: &Scene) -> Result<(), SceneError> {
        if let Some(drone) = self.own_drone {
            scene.drone_body(drone)?;
        }
        let count = scene.bodies().len();
        match self.own_body {
            Some(index) if index >= count => Err(SceneError::NoSuch { what: "excluded body", index, count }),
            _ => Ok(()),
        }
    }

    fn sees(&self, shape: &Shape) -> bool {
        shape.opaque
            && self.groups[shape.group] != 0
            && self.own_body != Some(shape.body)
            && (self.own_drone.is_none() || shape.drone != self.own_drone)
    }
}

/// Where [`cast_pattern`] writes; each plane is optional and has one entry for each ray.
#[derive(Debug, Default)]
pub struct RayPlanes<'a> {
    /// Distance along the ray, m; infinite where nothing was met.
    pub range_m: Option<&'a mut [f32]>,
    /// Geom that was met, −1 for none.
    pub geom_id: Option<&'a mut [i32]>,
    /// Its body, −1 for none.
    pub body_id: Option<&'a mut [i32]>,
    /// Outward unit normal in the world, zero for none.
    pub normal: Option<&'a mut [[f32; 3]]>,
}

/// Casts the rays of a pattern from `pose` (sensor to world) at the worker's poses.
///
/// Nothing is allocated once the worker has seen a pattern of this size.
///
/// # Errors
/// [`SenseError::Shape`] for a plane of another size; [`SenseError::Scene`] for a bad pose, a body or drone that does not
/// exist, and where the worker was not updated; [`SenseError::Parameter`] for a scene of 2²⁴ geoms or more.
pub fn cast_pattern(
    worker: &mut Worker,
    pose: &Pose,
    pattern: &RayPattern,
    query: &RayQuery,
    out: RayPlanes,
) -> Result<(), SenseError> {
    let pose = Pose::checked("a pattern of rays", pose.pos_m, pose.quat_xyzw)?;
    let rule = Rule { z_depth: false, near: 0.0, far: f32::INFINITY };
    let planes =
        Planes { depth: out.range_m, status: None, geom: out.geom_id, body: out.body_id, normal: out.normal };
    render(worker, &pose, pattern, query, rule, planes)
}

/// What [`cast_rays`] found, in buffers that are reused.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RayHits {
    /// Distance along the ray, m; infinite where nothing was met.
    pub range_m: Vec<f64>,
    /// Geom that was met, −1 for none.
    pub geom_id: Vec<i32>,
    /// Its body, −1 for none.
    pub body_id: Vec<i32>,
    /// Outward unit normal in the world, zero for none.
    pub normal: Vec<[f64; 3]>,
}

/// Casts rays from any points in any directions (n × 3 each, world, directions of any length but zero), one by one in
/// f64.
///
/// # Errors
/// [`SenseError::Parameter`] for arrays of different lengths and for rays that are not finite or have no direction;
/// [`SenseError::Scene`] for a body or drone that does not exist, and where the worker was not updated.
pub fn cast_rays(
    worker: &mut Worker,
    origins_m: &[[f64; 3]],
    directions: &[[f64; 3]],
    query: &RayQuery,
    hits: &mut RayHits,
) -> Result<(), SenseError> {
    if origins_m.len() != directions.len() {
        return Err(SenseError::Parameter {
            what: format!(
                "cast_rays needs a direction for each origin, got {} origins and {} directions",
                origins_m.len(),
                directions.len()
            ),
        });
    }
    query.check(worker.scene())?;
    let world = World::of(worker)?;
    let n = origins_m.len();
    hits.range_m.clear();
    hits.range_m.resize(n, f64::INFINITY);
    hits.geom_id.clear();
    hits.geom_id.resize(n, -1);
    hits.body_id.clear();
    hits.body_id.resize(n, -1);
    hits.normal.clear();
    hits.normal.resize(n, [0.0; 3]);
    let identity = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let mut scratch = take_scratch(worker);
    for ray in 0..n {
        let (o, v) = (origins_m[ray], directions[ray]);
        let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
        if !(length > 1e-12 && length < 1e12) || o.iter().any(|x| !x.is_finite()) {
            put_scratch(worker, scratch);
            return Err(SenseError::Parameter {
                what: format!(
                    "ray {ray} needs a finite origin and a direction that is not zero, got {o:?} and {v:?}"
                ),
            });
        }
        let d = v.map(|x| x / length);
        frame::candidates(&world, query, o, d, &mut scratch.found);
        let (pos, mat) = worker.geom_poses()?;
        let mut best: Option<(f64, usize, Placed<f64>, usize)> = None;
        for &id in &scratch.found {
            let id = id as usize;
            let g = Placed::<f64>::new(&world.shapes[id], pos[id], &mat[id], o, &identity, id);
            let so_far = best.as_ref().map_or(f64::INFINITY, |b| b.0);
            let reach = if best.as_ref().is_some_and(|b| id < b.1) { so_far.next_up() } else { so_far };
            let (t, part) = single::hit(&world, &g, d, reach);
            if t < reach {
                best = Some((t, id, g, part));
            }
        }
        if let Some((t, id, g, part)) = best {
            // Zero has no sign.
            hits.range_m[ray] = t + 0.0;
            hits.geom_id[ray] = id as i32;
            hits.normal[ray] = single::normal(&world, &g, &mat[id], &identity, d, t, part);
        }
        if world.foreign.iter().any(|id| query.sees(&world.shapes[*id as usize]))
            && let Some(hit) = oracle::one(worker, query, o, d)?
            && usize::try_from(hit.geom_id).is_ok_and(|g| world.shapes[g].foreign)
            && hit.distance < hits.range_m[ray]
        {
            hits.range_m[ray] = hit.distance + 0.0;
            hits.geom_id[ray] = hit.geom_id;
            hits.normal[ray] = hit.normal;
        }
        hits.body_id[ray] = world.bodies[(hits.geom_id[ray] + 1) as usize];
    }
    put_scratch(worker, scratch);
    Ok(())
}

/// Name of the processor's lanes in use, e.g. `Avx512`.
pub fn lanes_in_use() -> String {
    frame::lanes_in_use()
}

/// Buffers of a worker.
#[derive(Default)]
struct Scratch {
    buffers: Buffers,
    ranges: Vec<f32>,
    geoms: Vec<i32>,
    found: Vec<u32>,
}

fn take_scratch(worker: &mut Worker) -> Box<Scratch> {
    worker.scratch.caster.take().and_then(|kept| kept.downcast().ok()).unwrap_or_default()
}

fn put_scratch(worker: &mut Worker, scratch: Box<Scratch>) {
    worker.scratch.caster = Some(scratch);
}

/// Where a frame goes; each plane is optional.
#[derive(Default)]
pub(super) struct Planes<'a> {
    pub depth: Option<&'a mut [f32]>,
    pub status: Option<&'a mut [u8]>,
    pub geom: Option<&'a mut [i32]>,
    pub body: Option<&'a mut [i32]>,
    pub normal: Option<&'a mut [[f32; 3]]>,
}

impl Planes<'_> {
    /// Every plane has one entry for each ray.
    pub fn check(&self, rays: usize) -> Result<(), SenseError> {
        let check = |what, found: Option<usize>| match found {
            Some(found) if found != rays => {
                Err(SenseError::Shape { what, shape: format!("({rays} rays)"), expected: rays, found })
            }
            _ => Ok(()),
        };
        check("depths", self.depth.as_ref().map(|p| p.len()))?;
        check("states", self.status.as_ref().map(|p| p.len()))?;
        check("geoms", self.geom.as_ref().map(|p| p.len()))?;
        check("bodies", self.body.as_ref().map(|p| p.len()))?;
        check("normals", self.normal.as_ref().map(|p| p.len()))
    }
}

/// Geom ids travel in lanes of f32, which count to 2²⁴.
fn check_count(geoms: usize) -> Result<(), SenseError> {
    if geoms < MAX_GEOMS {
        return Ok(());
    }
    Err(SenseError::Parameter {
        what: format!(
            "the native ray caster sees scenes of fewer than {MAX_GEOMS} geoms, this one has {geoms}; use Caster::MuJoCo \
             (--caster mujoco)"
        ),
    })
}

/// One frame.
pub(super) fn render(
    worker: &mut Worker,
    pose: &Pose,
    pattern: &RayPattern,
    query: &RayQuery,
    rule: Rule,
    planes: Planes,
) -> Result<(), SenseError> {
    planes.check(pattern.len())?;
    query.check(worker.scene())?;
    check_count(worker.scene().geoms().len())?;
    let world = World::of(worker)?;
    let mut scratch = take_scratch(worker);
    let done = render_with(worker, &world, &mut scratch, pose, pattern, query, rule, planes);
    put_scratch(worker, scratch);
    done
}

fn render_with(
    worker: &mut Worker,
    world: &World,
    scratch: &mut Scratch,
    pose: &Pose,
    pattern: &RayPattern,
    query: &RayQuery,
    rule: Rule,
    mut planes: Planes,
) -> Result<(), SenseError> {
    let (pos, mat) = worker.geom_poses()?;
    let frame = quat::matrix(pose.quat_xyzw);
    let job = Job { world, pos, mat, query, origin: pose.pos_m, frame, pattern, rule };
    let Scratch { buffers, ranges, geoms, .. } = scratch;
    if !world.foreign.iter().any(|id| query.sees(&world.shapes[*id as usize])) {
        let mut sink = Sink {
            depth: planes.depth.as_deref_mut(),
            status: planes.status.as_deref_mut(),
            geom: planes.geom.as_deref_mut(),
            body: planes.body.as_deref_mut(),
            range: None,
        };
        if planes.normal.is_some() {
            ranges.resize(pattern.n, 0.0);
            sink.range = Some(ranges);
            if sink.geom.is_none() {
                geoms.resize(pattern.n, 0);
                sink.geom = Some(geoms);
            }
        }
        frame::cast(&job, buffers, &mut sink);
        if let Some(normal) = planes.normal {
            let geoms = planes.geom.as_deref().unwrap_or(geoms);
            normals(&job, geoms, ranges, normal);
        }
        return Ok(());
    }
    ranges.resize(pattern.n, 0.0);
    geoms.resize(pattern.n, 0);
    let mut sink = Sink { range: Some(ranges), geom: Some(geoms), ..Sink::default() };
    frame::cast(&job, buffers, &mut sink);
    let mut normal = planes.normal;
    if let Some(normal) = normal.as_deref_mut() {
        normals(&job, geoms, ranges, normal);
    }
    oracle::foreign(worker, world, query, pose, pattern, ranges, geoms, normal)?;
    for i in 0..pattern.n {
        let t = ranges[i];
        let value = if rule.z_depth && t < f32::INFINITY { t * -pattern.direction(i)[2] as f32 } else { t };
        let (depth, status) = if !(t < f32::INFINITY) {
            (f32::INFINITY, 1)
        } else if value < rule.near {
            (0.0, 3)
        } else if value > rule.far {
            (f32::INFINITY, 2)
        } else {
            (value, 0)
        };
        if let Some(plane) = planes.depth.as_deref_mut() {
            plane[i] = depth;
        }
        if let Some(plane) = planes.status.as_deref_mut() {
            plane[i] = status;
        }
        if let Some(plane) = planes.geom.as_deref_mut() {
            plane[i] = geoms[i];
        }
        if let Some(plane) = planes.body.as_deref_mut() {
            plane[i] = world.bodies[(geoms[i] + 1) as usize];
        }
    }
    Ok(())
}

/// Relative difference of two ranges from which on they are those of different surfaces: ten times the worst of one.
const OUTLINE: f64 = 1e-3;

/// Normals of a frame: each ray meets its geom once more, in f64.
fn normals(job: &Job, geoms: &[i32], ranges: &[f32], out: &mut [[f32; 3]]) {
    let mut kept: Option<(usize, Placed<f64>)> = None;
    for (i, normal) in out.iter_mut().enumerate() {
        let Ok(id) = usize::try_from(geoms[i]) else {
            *normal = [0.0; 3];
            continue;
        };
        let g = match kept {
            Some((known, g)) if known == id => g,
            _ => Placed::<f64>::new(
                &job.world.shapes[id],
                job.pos[id],
                &job.mat[id],
                job.origin,
                &job.frame,
                id,
            ),
        };
        kept = Some((id, g));
        let d = job.pattern.direction(i);
        let (t, part) = single::hit(job.world, &g, d, f64::INFINITY);
        let range = f64::from(ranges[i]);
        let same = (t - range).abs() <= OUTLINE * range.max(1e-3);
        let known = !matches!(g.kind, GeomType::Mesh | GeomType::Hfield);
        // At an outline f32 may see what f64 just misses, or the other way round. Then the surface is where f32 saw it; of
        // triangles nobody knows which, and the normal faces the sensor.
        let n = if same || known {
            let t = if same { t } else { range };
            single::normal(job.world, &g, &job.mat[id], &job.frame, d, t, part)
        } else {
            [0, 1, 2].map(|k| -(job.frame[k][0] * d[0] + job.frame[k][1] * d[1] + job.frame[k][2] * d[2]))
        };
        *normal = n.map(|x| x as f32);
    }
}

fn unit(v: [f64; 3]) -> [f64; 3] {
    let n = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    if n > 0.0 { v.map(|x| x / n) } else { [0.0, 0.0, 1.0] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn too_many_geoms_are_refused_with_a_way_out() {
        assert!(check_count(MAX_GEOMS - 1).is_ok());
        let message = check_count(MAX_GEOMS).unwrap_err().to_string();
        assert!(message.contains("16777216") && message.contains("--caster mujoco"), "{message}");
        // All ids below the limit are whole numbers of f32, and the next is not.
        assert_eq!((MAX_GEOMS - 1) as f32 as usize, MAX_GEOMS - 1);
        assert_ne!((MAX_GEOMS + 1) as f32 as usize, MAX_GEOMS + 1);
    }
}
