//! Rays of a sensor: by the ray caster of `geometry`, or by MuJoCo's rays.
//!
//! What rays see and how they are cast: [`geometry::ray`](crate::geometry::ray). Signed distance fields, which it does not know, are left to
//! MuJoCo's own rays, for those pixels that may see one. Flexes and skins are not seen, as by `mj_ray`.

mod oracle;

use serde::{Deserialize, Serialize};

pub(super) use oracle::many as oracle_rays;

use super::SenseError;
use crate::geometry::ray::{self, DepthRule, MAX_GEOMS, Planes, RayFilter, Rays};
pub use crate::geometry::ray::{RayPattern, lanes_in_use};
use crate::math::quat;
use crate::scene::{Pose, Scene, SceneError, Worker, checked_pose};

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
    pub(super) filter: RayFilter,
    /// Bodies of the own drone beyond the root carry geoms: MuJoCo's rays have to pass through them one by one.
    pub(super) compound: bool,
}

impl Default for RayQuery {
    /// Groups 0, 1 and 2, all bodies.
    fn default() -> Self {
        let groups = [true, true, true, false, false, false];
        Self { filter: RayFilter { groups, own_drone: None, own_body: None }, compound: false }
    }
}

impl RayQuery {
    /// Sets which of the six geom groups are seen.
    #[must_use]
    pub fn with_groups(mut self, groups: [bool; 6]) -> Self {
        self.filter.groups = groups;
        self
    }

    /// Does not see a drone.
    ///
    /// # Errors
    /// [`SceneError::NoSuch`].
    pub fn without_drone(mut self, scene: &Scene, drone: usize) -> Result<Self, SceneError> {
        let root = scene.drone_body(drone)?;
        self.filter.own_drone = Some(drone);
        self.filter.own_body = Some(root);
        self.compound = scene.drone_geoms(drone)?.iter().any(|g| scene.geoms()[*g].body_id != root);
        Ok(self)
    }

    /// Does not see a body (its children are seen). Casting is an error where the scene has no such body.
    #[must_use]
    pub fn without_body(mut self, body: usize) -> Self {
        self.filter.own_drone = None;
        self.filter.own_body = Some(body);
        self.compound = false;
        self
    }

    /// Sees all bodies.
    #[must_use]
    pub fn with_all_bodies(mut self) -> Self {
        self.filter.own_drone = None;
        self.filter.own_body = None;
        self.compound = false;
        self
    }

    /// What it does not see exists in this scene.
    fn check(&self, scene: &Scene) -> Result<(), SceneError> {
        if let Some(drone) = self.filter.own_drone {
            scene.drone_body(drone)?;
        }
        let count = scene.bodies().len();
        match self.filter.own_body {
            Some(index) if index >= count => Err(SceneError::NoSuch { what: "excluded body", index, count }),
            _ => Ok(()),
        }
    }
}

/// Where [`Queries::pattern`](super::Queries::pattern) writes; each plane is optional and has one entry for each ray.
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

/// Casts the rays of a pattern; see [`Queries::pattern`](super::Queries::pattern).
pub(super) fn cast_pattern(
    worker: &mut Worker,
    pose: &Pose,
    pattern: &RayPattern,
    query: &RayQuery,
    out: RayPlanes,
) -> Result<(), SenseError> {
    let pose = checked_pose(|| "a pattern of rays".into(), pose.pos_m, pose.quat_xyzw)?;
    let rule = DepthRule { z_depth: false, near: 0.0, far: f32::INFINITY };
    let planes =
        Planes { depth: out.range_m, status: None, geom: out.geom_id, body: out.body_id, normal: out.normal };
    render(worker, &pose, pattern, query, rule, planes)
}

/// What [`Queries::rays`](super::Queries::rays) found, in buffers that are reused.
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

/// Casts rays one by one; see [`Queries::rays`](super::Queries::rays).
pub(super) fn cast_rays(
    worker: &mut Worker,
    origins_m: &[[f64; 3]],
    directions: &[[f64; 3]],
    query: &RayQuery,
    hits: &mut RayHits,
) -> Result<(), SenseError> {
    if origins_m.len() != directions.len() {
        return Err(SenseError::Parameter {
            what: format!(
                "rays need a direction for each origin, got {} origins and {} directions",
                origins_m.len(),
                directions.len()
            ),
        });
    }
    query.check(worker.scene())?;
    let n = origins_m.len();
    hits.range_m.clear();
    hits.range_m.resize(n, f64::INFINITY);
    hits.geom_id.clear();
    hits.geom_id.resize(n, -1);
    hits.body_id.clear();
    hits.body_id.resize(n, -1);
    hits.normal.clear();
    hits.normal.resize(n, [0.0; 3]);
    let foreign = query.filter.sees_foreign(worker.table()?);
    for ray in 0..n {
        let (o, v) = (origins_m[ray], directions[ray]);
        let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
        if !(length > 1e-12 && length < 1e12) || o.iter().any(|x| !x.is_finite()) {
            return Err(SenseError::Parameter {
                what: format!(
                    "ray {ray} needs a finite origin and a direction that is not zero, got {o:?} and {v:?}"
                ),
            });
        }
        let d = v.map(|x| x / length);
        let (table, poses, memory) = worker.geometry()?;
        if let Some(hit) = ray::one(table, &poses, &query.filter, &mut memory.rays, o, d) {
            hits.range_m[ray] = hit.range_m;
            hits.geom_id[ray] = hit.geom as i32;
            hits.normal[ray] = hit.normal;
        }
        if foreign
            && let Some(hit) = oracle::one(worker, query, o, d)?
            && usize::try_from(hit.geom_id).is_ok_and(|g| oracle::is_foreign(worker, g))
            && hit.distance < hits.range_m[ray]
        {
            hits.range_m[ray] = hit.distance + 0.0;
            hits.geom_id[ray] = hit.geom_id;
            hits.normal[ray] = hit.normal;
        }
        hits.body_id[ray] = worker.table()?.body_of(hits.geom_id[ray]);
    }
    Ok(())
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
    rule: DepthRule,
    planes: Planes,
) -> Result<(), SenseError> {
    planes.check(pattern.len())?;
    query.check(worker.scene())?;
    check_count(worker.scene().geoms().len())?;
    let frame = quat::matrix(pose.quat_xyzw);
    let filter = &query.filter;
    let (table, poses, memory) = worker.geometry()?;
    let rays = Rays { table, poses, filter, origin_m: pose.pos_m, frame, pattern, rule };
    if filter.sees_foreign(table) {
        return oracle::render(worker, pose, pattern, query, rule, planes);
    }
    rays.cast(&mut memory.rays, planes);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn too_many_geoms_are_refused_with_a_way_out() {
        assert!(check_count(MAX_GEOMS - 1).is_ok());
        let message = check_count(MAX_GEOMS).unwrap_err().to_string();
        assert!(message.contains("16777216") && message.contains("--caster mujoco"), "{message}");
    }
}
