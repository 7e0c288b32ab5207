//! Distance from a drone to the nearest obstacle, with closest points.
//!
//! Between convex shapes distances are exact to rounding for spheres, capsules, boxes, planes and meshes, to 1e-9 m for
//! most ellipsoids and cylinders (worst 1e-5 m); of [`Collider::MuJoCo`] (mj_geomDistance) to the scene's `ccd_tolerance`
//! (1e-6 m by default) for ellipsoids, cylinders and meshes. A mesh counts as its convex hull, as in contacts. Distances to
//! height fields and signed distance fields are never MuJoCo's, since MuJoCo 3.17.0 leaves out cells at the edges of the one
//! and has none for the other: height fields count as the solid prisms that contacts use, signed distance fields as the
//! triangles of their meshes. There, the depth of a penetration is that of the deepest contact. Flexes have no distance.

use serde::Serialize;

use super::SenseError;
use super::collide::Collider;
use super::contact::MAX_PER_PAIR;
use crate::geometry::{Found, Meeting, PairDistance, Query};
use crate::scene::{GeomType, PairContacts, Scene, Worker};

/// The nearest obstacle of a drone.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Clearance {
    /// The drone.
    pub drone: usize,
    /// Signed distance, m: negative in penetration; the maximum that was asked for when nothing is nearer; NaN in a world
    /// of a batch that failed.
    pub distance_m: f64,
    /// Whether anything is nearer than the maximum; the rest is meaningless if not.
    pub found: bool,
    /// False when `distance_m` is only a lower bound (between two fields, or to a field without triangles), or when a
    /// height field is penetrated in more places than MuJoCo reports, so that the true depth may be greater.
    pub exact: bool,
    /// Geom of the drone; -1 if nothing was found.
    pub drone_geom: i32,
    /// The nearest geom; -1 if nothing was found.
    pub other_geom: i32,
    /// Its body; -1 if nothing was found.
    pub other_body: i32,
    /// The drone that it belongs to.
    pub other_drone: Option<usize>,
    /// Closest point on the drone, world, m.
    pub on_drone_m: [f64; 3],
    /// Closest point on the obstacle, world, m.
    pub on_other_m: [f64; 3],
}

impl Clearance {
    /// Of a world that failed.
    pub(super) fn unknown(drone: usize) -> Self {
        Self { exact: false, ..Self::nothing(drone, f64::NAN) }
    }

    /// Moves the points apart, along the line through them, until they are as far as the depth says: MuJoCo's search ends
    /// short of the depth of round shapes, by some centimetres, where it is known that their cores overlap.
    fn spread(&mut self) {
        let d = [0, 1, 2].map(|k| self.on_other_m[k] - self.on_drone_m[k]);
        let length = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
        if length > 0.0 {
            for k in 0..3 {
                let middle = 0.5 * (self.on_drone_m[k] + self.on_other_m[k]);
                let half = 0.5 * d[k] * self.distance_m.abs() / length;
                (self.on_drone_m[k], self.on_other_m[k]) = (middle - half, middle + half);
            }
        }
    }

    fn nothing(drone: usize, max_m: f64) -> Self {
        Self {
            drone,
            distance_m: max_m,
            found: false,
            exact: true,
            drone_geom: -1,
            other_geom: -1,
            other_body: -1,
            other_drone: None,
            on_drone_m: [0.0; 3],
            on_other_m: [0.0; 3],
        }
    }
}

/// Distance of a drone to the nearest geom; see [`Queries::clearance`](super::Queries::clearance).
pub(super) fn clearance(
    collider: Collider,
    worker: &mut Worker,
    drone: usize,
    max_distance_m: f64,
) -> Result<Clearance, SenseError> {
    if !(max_distance_m > 0.0 && max_distance_m < 1e9) {
        return Err(SenseError::Parameter {
            what: format!(
                "the largest distance of a clearance must be between 0 and 1e9 m, got {max_distance_m}"
            ),
        });
    }
    let scene = worker.scene().clone();
    let center = worker.body_pose(scene.drone_body(drone)?)?.pos_m;
    if collider.is_native(worker)? {
        return nearest_native(worker, &scene, drone, max_distance_m);
    }
    let radius = scene.drone_radius_m(drone)?;
    let mut bounds = std::mem::take(&mut worker.scratch.bounds);
    let result = nearest(worker, &scene, drone, center, radius, max_distance_m, &mut bounds);
    worker.scratch.bounds = bounds;
    result
}

fn nearest_native(
    worker: &mut Worker,
    scene: &Scene,
    drone: usize,
    max_m: f64,
) -> Result<Clearance, SenseError> {
    let (table, poses, memory) = worker.geometry()?;
    let found = Query::new(table, poses, &mut memory.near).nearest(&mut memory.near, drone, max_m);
    let open = memory.near.pairs.len();
    let mut best = Clearance::nothing(drone, max_m);
    let named = |f: &Found| {
        let m = &f.meeting;
        Clearance {
            drone,
            distance_m: m.distance,
            found: true,
            exact: !m.bound,
            drone_geom: f.own as i32,
            other_geom: f.other as i32,
            other_body: scene.geoms()[f.other].body_id as i32,
            other_drone: scene.geoms()[f.other].drone,
            on_drone_m: m.on_first,
            on_other_m: m.on_second,
        }
    };
    if let Some(found) = found.as_ref().filter(|f| !f.meeting.deep) {
        best = named(found);
    }
    // How deep these overlap only MuJoCo says.
    for k in 0..open {
        let (table, poses, memory) = worker.geometry()?;
        let (own, other) = (memory.near.pairs[k].0 as usize, memory.near.pairs[k].1 as usize);
        let query = Query::new(table, poses, &mut memory.near);
        let mut pair = named(&Found { meeting: query.meet(own, other, max_m), own, other });
        if matches!(scene.geoms()[other].kind, GeomType::Hfield | GeomType::Sdf) {
            deepest_of_field(worker, scene, &mut pair)?;
        } else {
            let d = worker.geom_distance(own, other, max_m)?;
            (pair.on_drone_m, pair.on_other_m) = (d.on_first_m, d.on_second_m);
            if d.distance_m <= pair.distance_m {
                pair.distance_m = d.distance_m;
            } else {
                pair.spread();
            }
        }
        if pair.distance_m < best.distance_m {
            best = pair;
        }
    }
    Ok(best)
}

fn nearest(
    worker: &mut Worker,
    scene: &Scene,
    drone: usize,
    center: [f64; 3],
    radius: f64,
    max_m: f64,
    bounds: &mut Vec<(f64, usize)>,
) -> Result<Clearance, SenseError> {
    bounds.clear();
    for geom in scene.geoms() {
        if geom.drone == Some(drone) || !geom.can_collide() {
            continue;
        }
        let bound = lower_bound(worker, scene, geom.id, center, radius)?;
        if bound < max_m {
            bounds.push((bound, geom.id));
        }
    }
    bounds.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut best = Clearance::nothing(drone, max_m);
    for &(bound, other) in bounds.iter() {
        if bound >= best.distance_m {
            break;
        }
        for &own in scene.drone_geoms(drone)? {
            let info = &scene.geoms()[own];
            if !info.can_collide() {
                continue;
            }
            let (at, _) = worker.geom_pose(own)?;
            let near = lower_bound(worker, scene, other, at, info.bounding_radius_m)?;
            if info.bounding_radius_m > 0.0 && near >= best.distance_m {
                continue;
            }
            // A little beyond the best, so that an equal distance is measured and not cut off.
            let pair = pair_distance(worker, scene, own, other, best.distance_m.max(0.0) + MARGIN_M)?;
            if pair.distance_m < best.distance_m {
                best = Clearance {
                    drone,
                    distance_m: pair.distance_m,
                    found: true,
                    exact: pair.exact,
                    drone_geom: own as i32,
                    other_geom: other as i32,
                    other_body: scene.geoms()[other].body_id as i32,
                    other_drone: scene.geoms()[other].drone,
                    on_drone_m: pair.on_drone_m,
                    on_other_m: pair.on_other_m,
                };
            }
        }
    }
    if best.found && best.distance_m <= 0.0 {
        deepest_of_field(worker, scene, &mut best)?;
    }
    Ok(best)
}

/// Takes the depth of a penetration from MuJoCo's contacts where the nearest geom is a field.
fn deepest_of_field(worker: &mut Worker, scene: &Scene, best: &mut Clearance) -> Result<(), SenseError> {
    let field = |geom: i32| {
        usize::try_from(geom).is_ok_and(|g| matches!(scene.geoms()[g].kind, GeomType::Hfield | GeomType::Sdf))
    };
    if !field(best.other_geom) && !field(best.drone_geom) {
        return Ok(());
    }
    // A ball whose centre is outside has its depth already.
    let solid = if field(best.drone_geom) { best.other_geom } else { best.drone_geom };
    let core =
        usize::try_from(solid).map_or(0.0, |g| inner_radius(scene.geoms()[g].kind, scene.geoms()[g].size_m));
    if best.distance_m.abs() < core * (1.0 - 1e-9) || best.distance_m < -core * (1.0 + 1e-9) {
        return Ok(());
    }
    let (Ok(own), Ok(other)) = (usize::try_from(best.drone_geom), usize::try_from(best.other_geom)) else {
        return Ok(());
    };
    let mut found = PairContacts::default();
    worker.collide_pair(own, other, 0.0, &mut found)?;
    for contact in found.iter() {
        if contact.distance_m < best.distance_m {
            best.distance_m = contact.distance_m;
            // From the first geom to the second, half the depth on either side of the point.
            let sign = if contact.geom[0] == best.drone_geom { 1.0 } else { -1.0 };
            let half = 0.5 * contact.distance_m * sign;
            best.on_drone_m = [0, 1, 2].map(|k| contact.point_m[k] - half * contact.normal[k]);
            best.on_other_m = [0, 1, 2].map(|k| contact.point_m[k] + half * contact.normal[k]);
        }
    }
    // With as many contacts as MuJoCo reports at most, a deeper one may be missing.
    best.exact &= found.len() < MAX_PER_PAIR;
    Ok(())
}

/// Lower bound of the signed distance of a geom to anything within `radius` of a point.
fn lower_bound(
    worker: &Worker,
    scene: &Scene,
    geom: usize,
    center: [f64; 3],
    radius: f64,
) -> Result<f64, SenseError> {
    let distance = box_distance(worker, scene, geom, center)?;
    // In the box nothing is known of the depth.
    Ok(if distance == 0.0 { f64::NEG_INFINITY } else { distance - radius })
}

const MARGIN_M: f64 = 1e-6;

/// Lower bound of the distance from a point to a geom: distance to its oriented bounding box, or to the plane.
/// Negative below a plane.
pub(super) fn box_distance(
    worker: &Worker,
    scene: &Scene,
    geom: usize,
    point: [f64; 3],
) -> Result<f64, SenseError> {
    let info = &scene.geoms()[geom];
    let (p, r) = worker.geom_pose(geom)?;
    let d = [0, 1, 2].map(|k| point[k] - p[k]);
    let local = [0, 1, 2].map(|k| r[k] * d[0] + r[3 + k] * d[1] + r[6 + k] * d[2]);
    if info.kind == GeomType::Plane {
        return Ok(local[2]);
    }
    let a = info.aabb_m;
    let mut sum = 0.0;
    for k in 0..3 {
        let out = ((local[k] - a[k]).abs() - a[3 + k]).max(0.0);
        sum += out * out;
    }
    Ok(sum.sqrt())
}

/// Signed distance of a drone's geom and another geom, up to `max_m`. Where a height field or a signed distance field
/// is penetrated the distance is 0 (for balls and capsules down to minus their radius).
pub(super) fn pair_distance(
    worker: &mut Worker,
    scene: &Scene,
    own: usize,
    other: usize,
    max_m: f64,
) -> Result<PairDistance, SenseError> {
    let field = |geom: usize| matches!(scene.geoms()[geom].kind, GeomType::Sdf | GeomType::Hfield);
    let plane = |geom: usize| scene.geoms()[geom].kind == GeomType::Plane;
    if (field(own) || field(other)) && !plane(own) && !plane(other) {
        return field_distance(worker, scene, own, other, max_m);
    }
    let d = worker.geom_distance(own, other, max_m)?;
    Ok(PairDistance {
        distance_m: d.distance_m,
        on_drone_m: d.on_first_m,
        on_other_m: d.on_second_m,
        exact: true,
    })
}

/// Distance where one of the two is a height field or a signed distance field.
fn field_distance(
    worker: &mut Worker,
    scene: &Scene,
    own: usize,
    other: usize,
    max_m: f64,
) -> Result<PairDistance, SenseError> {
    let own_is_field = matches!(scene.geoms()[own].kind, GeomType::Sdf | GeomType::Hfield);
    let (field, solid) = if own_is_field { (own, other) } else { (other, own) };
    let (table, poses, memory) = worker.geometry()?;
    let query = Query::new(table, poses, &mut memory.near);
    let met = if query.is_convex(solid) {
        query.meet(solid, field, max_m)
    } else {
        // Of two fields: bounding boxes are a lower bound.
        let near =
            query.box_distance(field, poses.geom_pos_m[solid]) - scene.geoms()[solid].bounding_radius_m;
        Meeting { distance: near.min(max_m), bound: true, ..Meeting::far() }
    };
    let (on_drone_m, on_other_m) =
        if own_is_field { (met.on_second, met.on_first) } else { (met.on_first, met.on_second) };
    Ok(PairDistance { distance_m: met.distance.min(max_m), on_drone_m, on_other_m, exact: !met.bound })
}

/// Radius of a shape that is blown up from a core; a ball inside a field is deeper by its diameter than its near side.
fn inner_radius(kind: GeomType, size: [f64; 3]) -> f64 {
    if matches!(kind, GeomType::Sphere | GeomType::Capsule) { size[0] } else { 0.0 }
}
