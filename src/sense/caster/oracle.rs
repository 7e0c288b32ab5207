//! MuJoCo's own rays: the reference, and the only ones that know signed distance fields.

use super::super::SenseError;
use super::pattern::RayPattern;
use super::world::World;
use super::{Query, unit};
use crate::math::quat;
use crate::scene::{Pose, RayHit, RayScratch, Scene, Worker};

/// How far behind a surface of its own drone a ray starts anew, m.
const STEP_BEYOND_M: f64 = 1e-9;

fn own(scene: &Scene, query: &Query, geom: i32) -> bool {
    query.own_drone.is_some()
        && usize::try_from(geom).is_ok_and(|g| scene.geoms()[g].drone == query.own_drone)
}

/// Casts `scratch.directions` (world, unit) from one point; distances (−1 for none), geoms and, where wanted, normals
/// stand in `scratch` afterwards.
pub(in super::super) fn many(
    worker: &mut Worker,
    query: &Query,
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
        Some(&query.groups),
        query.own_body,
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
    query: &Query,
    origin: [f64; 3],
    direction: [f64; 3],
    mut travelled: f64,
) -> Result<Option<RayHit>, SenseError> {
    loop {
        travelled += STEP_BEYOND_M;
        let from = [0, 1, 2].map(|k| origin[k] + travelled * direction[k]);
        let Some(hit) = worker.ray(from, direction, Some(&query.groups), query.own_body)? else {
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
    query: &Query,
    origin: [f64; 3],
    direction: [f64; 3],
) -> Result<Option<RayHit>, SenseError> {
    let hit = worker.ray(origin, direction, Some(&query.groups), query.own_body)?;
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

/// Adds to a frame what only MuJoCo's rays see: rays that may meet such a geom are cast by MuJoCo, and its answer stands
/// where it is such a geom.
pub(super) fn foreign(
    worker: &mut Worker,
    world: &World,
    query: &Query,
    pose: &Pose,
    pattern: &RayPattern,
    ranges: &mut [f32],
    geoms: &mut [i32],
    mut normals: Option<&mut [[f32; 3]]>,
) -> Result<(), SenseError> {
    let mut scratch = std::mem::take(&mut worker.scratch);
    let done = foreign_with(worker, world, query, pose, pattern, ranges, geoms, &mut normals, &mut scratch);
    worker.scratch = scratch;
    done
}

fn foreign_with(
    worker: &mut Worker,
    world: &World,
    query: &Query,
    pose: &Pose,
    pattern: &RayPattern,
    ranges: &mut [f32],
    geoms: &mut [i32],
    normals: &mut Option<&mut [[f32; 3]]>,
    scratch: &mut RayScratch,
) -> Result<(), SenseError> {
    let r = quat::matrix(pose.quat_xyzw);
    scratch.directions.clear();
    scratch.bounds.clear();
    {
        let (pos, mat) = worker.geom_poses()?;
        for i in 0..pattern.len() {
            let d = pattern.direction(i);
            let d = unit([0, 1, 2].map(|k| r[k][0] * d[0] + r[k][1] * d[1] + r[k][2] * d[2]));
            let meets = world.foreign.iter().any(|id| {
                let id = *id as usize;
                let shape = &world.shapes[id];
                let hull = shape.hull.placed(pos[id], &mat[id]);
                let c = [0, 1, 2].map(|k| hull.centre[k] - pose.pos_m[k]);
                let reach = hull.reach();
                let ahead = c[0] * d[0] + c[1] * d[1] + c[2] * d[2];
                let square = c[0] * c[0] + c[1] * c[1] + c[2] * c[2];
                query.sees(shape)
                    && square - ahead * ahead <= reach * reach
                    && ahead >= -reach
                    && ahead - reach <= f64::from(ranges[i])
            });
            if meets {
                scratch.directions.push(d);
                scratch.bounds.push((0.0, i));
            }
        }
    }
    many(worker, query, pose.pos_m, scratch, normals.is_some())?;
    for (k, (_, i)) in scratch.bounds.iter().enumerate() {
        let t = scratch.distances[k];
        let Ok(geom) = usize::try_from(scratch.geoms[k]) else { continue };
        // An infinite range is a ray that met nothing of ours.
        if t >= 0.0 && world.shapes[geom].foreign && t as f32 <= ranges[*i] {
            ranges[*i] = t as f32 + 0.0;
            geoms[*i] = scratch.geoms[k];
            if let Some(normals) = normals {
                normals[*i] = scratch.normals[k].map(|x| x as f32);
            }
        }
    }
    Ok(())
}
