//! MuJoCo's own rays: the reference, and the only ones that know signed distance fields.

use super::RayQuery;
use crate::geometry::ray::{DepthRule, Planes, RayPattern, Rays};
use crate::math::quat;
use crate::scene::{Pose, RayHit, RayScratch, Scene, Worker};
use crate::sense::SenseError;

/// How far behind a surface of its own drone a ray starts anew, m.
const STEP_BEYOND_M: f64 = 1e-9;

fn own(scene: &Scene, query: &RayQuery, geom: i32) -> bool {
    query.filter.own_drone.is_some()
        && usize::try_from(geom).is_ok_and(|g| scene.geoms()[g].drone == query.filter.own_drone)
}

/// Casts `scratch.directions` (world, unit) from one point; distances (−1 for none), geoms and, where wanted, normals
/// stand in `scratch` afterwards.
pub(in super::super) fn many(
    worker: &mut Worker,
    query: &RayQuery,
    origin: [f64; 3],
    scratch: &mut RayScratch,
    want_normals: bool,
) -> Result<(), SenseError> {
    let n = scratch.directions.len();
    scratch.distances.resize(n, 0.0);
    scratch.geoms.resize(n, 0);
    scratch.normals.resize(n, [0.0; 3]);
    worker.rays(
        origin,
        &scratch.directions,
        Some(&query.filter.groups.map(u8::from)),
        query.filter.own_body,
        &mut scratch.distances,
        &mut scratch.geoms,
        want_normals.then_some(&mut scratch.normals[..]),
    )?;
    if !query.compound {
        return Ok(());
    }
    // Rays that met another body of their own drone are cast again from behind the hit.
    let scene = worker.scene().clone();
    for i in 0..n {
        if scratch.distances[i] < 0.0 || !own(&scene, query, scratch.geoms[i]) {
            continue;
        }
        match beyond(worker, &scene, query, origin, scratch.directions[i], scratch.distances[i])? {
            None => {
                scratch.distances[i] = -1.0;
                scratch.geoms[i] = -1;
            }
            Some(hit) => {
                scratch.distances[i] = hit.distance;
                scratch.geoms[i] = hit.geom_id;
                scratch.normals[i] = hit.normal;
            }
        }
    }
    Ok(())
}

/// The first hit behind `travelled` that is not the own drone's.
fn beyond(
    worker: &mut Worker,
    scene: &Scene,
    query: &RayQuery,
    origin: [f64; 3],
    direction: [f64; 3],
    mut travelled: f64,
) -> Result<Option<RayHit>, SenseError> {
    loop {
        travelled += STEP_BEYOND_M;
        let from = [0, 1, 2].map(|k| origin[k] + travelled * direction[k]);
        let Some(hit) =
            worker.ray(from, direction, Some(&query.filter.groups.map(u8::from)), query.filter.own_body)?
        else {
            return Ok(None);
        };
        travelled += hit.distance;
        if !own(scene, query, hit.geom_id) {
            return Ok(Some(RayHit { distance: travelled, ..hit }));
        }
    }
}

/// One ray (unit direction).
pub(super) fn one(
    worker: &mut Worker,
    query: &RayQuery,
    origin: [f64; 3],
    direction: [f64; 3],
) -> Result<Option<RayHit>, SenseError> {
    let hit =
        worker.ray(origin, direction, Some(&query.filter.groups.map(u8::from)), query.filter.own_body)?;
    match hit {
        Some(hit) if query.compound => {
            let scene = worker.scene().clone();
            if own(&scene, query, hit.geom_id) {
                beyond(worker, &scene, query, origin, direction, hit.distance)
            } else {
                Ok(Some(hit))
            }
        }
        other => Ok(other),
    }
}

/// Whether only MuJoCo's rays know a geom.
pub(super) fn is_foreign(worker: &Worker, geom: usize) -> bool {
    worker.table().is_ok_and(|table| table.geoms()[geom].foreign)
}

/// One frame in which there may be geoms that only MuJoCo's rays know: rays that may meet one are cast by MuJoCo too, and its answer
/// stands where it is such a geom.
pub(super) fn render(
    worker: &mut Worker,
    pose: &Pose,
    pattern: &RayPattern,
    query: &RayQuery,
    rule: DepthRule,
    mut planes: Planes,
) -> Result<(), SenseError> {
    let mut scratch = std::mem::take(&mut worker.scratch);
    let done = render_with(worker, pose, pattern, query, rule, &mut planes, &mut scratch);
    worker.scratch = scratch;
    done
}

fn render_with(
    worker: &mut Worker,
    pose: &Pose,
    pattern: &RayPattern,
    query: &RayQuery,
    rule: DepthRule,
    planes: &mut Planes,
    scratch: &mut RayScratch,
) -> Result<(), SenseError> {
    let (origin_m, frame, filter) = (pose.pos_m, quat::matrix(pose.quat_xyzw), &query.filter);
    scratch.directions.clear();
    scratch.bounds.clear();
    let (table, poses, memory) = worker.geometry()?;
    let rays = Rays { table, poses, filter, origin_m, frame, pattern, rule };
    rays.ranges(&mut memory.rays, planes.normal.as_deref_mut());
    for i in 0..pattern.len() {
        let d = rays.direction(i);
        if rays.may_meet_foreign(d, memory.rays.ranges[i]) {
            scratch.directions.push(d);
            scratch.bounds.push((0.0, i));
        }
    }
    many(worker, query, origin_m, scratch, planes.normal.is_some())?;
    let (table, poses, memory) = worker.geometry()?;
    let (ranges, geoms) = (&mut memory.rays.ranges, &mut memory.rays.geoms);
    for (k, (_, i)) in scratch.bounds.iter().enumerate() {
        let t = scratch.distances[k];
        let Ok(geom) = usize::try_from(scratch.geoms[k]) else { continue };
        // An infinite range is a ray that met nothing of ours.
        if t >= 0.0 && table.geoms()[geom].foreign && t as f32 <= ranges[*i] {
            ranges[*i] = t as f32 + 0.0;
            geoms[*i] = scratch.geoms[k];
            if let Some(normals) = planes.normal.as_deref_mut() {
                normals[*i] = scratch.normals[k].map(|x| x as f32);
            }
        }
    }
    let rays = Rays { table, poses, filter, origin_m, frame, pattern, rule };
    rays.state(ranges, geoms, planes.reborrow());
    Ok(())
}
