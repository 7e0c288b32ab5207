//! Distance from a drone to the nearest obstacle, with closest points.
//!
//! Between convex shapes distances are those of MuJoCo (mj_geomDistance): exact to rounding for spheres, capsules, boxes
//! and planes, to the scene's `ccd_tolerance` (1e-6 m by default) for ellipsoids, cylinders and meshes. A mesh counts
//! as its convex hull, as in contacts. Distances to height fields and signed distance fields are computed here, since
//! MuJoCo 3.17.0 leaves out cells at the edges of the one and has none for the other: height fields as the solid
//! prisms that contacts use, signed distance fields as the triangles of their meshes. There, the depth of a penetration
//! is that of the deepest contact. Flexes have no distance.

use serde::Serialize;

use super::SenseError;
use super::contact::MAX_PER_PAIR;
use super::gjk::{Convex, Gap};
use crate::math::vec3::{dot, sub};
use crate::scene::{GeomType, HfieldView, MeshView, Scene, Worker};

/// The nearest obstacle of a drone.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Clearance {
    /// The drone.
    pub drone: usize,
    /// Signed distance, m: negative in penetration; the maximum that was asked for when nothing is nearer.
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

/// Signed distance of a drone's geom and another geom.
#[derive(Clone, Copy, Debug)]
pub(super) struct PairDistance {
    pub distance_m: f64,
    pub on_drone_m: [f64; 3],
    pub on_other_m: [f64; 3],
    pub exact: bool,
}

/// Distance of a drone to the nearest geom of the scene or of another drone, looking no farther than `max_distance_m`.
///
/// Only geoms that can collide count (contype or conaffinity not 0), on both sides.
///
/// # Errors
/// [`SenseError::Scene`] for an unknown drone, a worker that was not updated, or a failure of MuJoCo;
/// [`SenseError::Parameter`] for a maximum that is not positive and finite.
pub fn clearance(worker: &mut Worker, drone: usize, max_distance_m: f64) -> Result<Clearance, SenseError> {
    if !(max_distance_m > 0.0 && max_distance_m < 1e9) {
        return Err(SenseError::Parameter {
            what: format!(
                "the largest distance of a clearance must be between 0 and 1e9 m, got {max_distance_m}"
            ),
        });
    }
    let scene = worker.scene().clone();
    let center = worker.body_pose(scene.drone_body(drone)?)?.pos_m;
    let radius = scene.drone_radius_m(drone)?;
    let mut bounds = std::mem::take(&mut worker.scratch.bounds);
    let result = nearest(worker, &scene, drone, center, radius, max_distance_m, &mut bounds);
    worker.scratch.bounds = bounds;
    result
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
    let mut of_pair = 0;
    for index in 0..worker.collide()? {
        let Some(contact) = worker.contact(index) else { break };
        let [a, b] = contact.geom;
        let same =
            [a, b] == [best.drone_geom, best.other_geom] || [b, a] == [best.drone_geom, best.other_geom];
        of_pair += usize::from(same);
        if same && contact.distance_m < best.distance_m {
            best.distance_m = contact.distance_m;
            // From the first geom to the second, half the depth on either side of the point.
            let sign = if a == best.drone_geom { 1.0 } else { -1.0 };
            let half = 0.5 * contact.distance_m * sign;
            best.on_drone_m = [0, 1, 2].map(|k| contact.point_m[k] - half * contact.normal[k]);
            best.on_other_m = [0, 1, 2].map(|k| contact.point_m[k] + half * contact.normal[k]);
        }
    }
    // With as many contacts as MuJoCo reports at most, a deeper one may be missing.
    best.exact &= of_pair < MAX_PER_PAIR;
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
    let info = &scene.geoms()[solid];
    let (p, r) = worker.geom_pose(field)?;
    let (x, m) = worker.geom_pose(solid)?;
    // The solid in the frame of the field.
    let d = sub(x, p);
    let center = [0, 1, 2].map(|k| r[k] * d[0] + r[3 + k] * d[1] + r[6 + k] * d[2]);
    let mut turned = [0.0; 9];
    for i in 0..3 {
        for j in 0..3 {
            turned[3 * i + j] = r[i] * m[j] + r[3 + i] * m[3 + j] + r[6 + i] * m[6 + j];
        }
    }
    let shape = Convex::new(info.kind, info.size_m, center, turned, hull_vertices(scene, solid));
    let mut best = Gap { distance: max_m, on_shape: center, on_points: center };
    let exact = match (&shape, scene.hfield(field), scene.mesh(field)) {
        (Some(shape), Some(heights), _) => {
            nearest_on_heights(&heights, shape, center, info.bounding_radius_m, &mut best);
            true
        }
        (Some(shape), None, Some(mesh)) => {
            nearest_on_triangles(&mesh, shape, center, info.bounding_radius_m, &mut best);
            if best.distance > 0.0 && winding_number(&mesh, center) > 0.5 {
                // Wholly inside: as deep as it is far from the surface.
                best.distance = -best.distance - 2.0 * inner_radius(info.kind, info.size_m);
            }
            true
        }
        _ => {
            // Two fields, or one without triangles: bounding boxes are a lower bound.
            let near = box_distance(worker, scene, field, x)? - info.bounding_radius_m;
            best.distance = near.min(max_m);
            false
        }
    };
    let out =
        |q: [f64; 3]| [0, 1, 2].map(|k| p[k] + r[3 * k] * q[0] + r[3 * k + 1] * q[1] + r[3 * k + 2] * q[2]);
    let (on_solid, on_field) = (out(best.on_shape), out(best.on_points));
    let (on_drone_m, on_other_m) = if own_is_field { (on_field, on_solid) } else { (on_solid, on_field) };
    Ok(PairDistance { distance_m: best.distance, on_drone_m, on_other_m, exact })
}

/// Radius of a shape that is blown up from a core; a ball inside a field is deeper by its diameter than its near side.
fn inner_radius(kind: GeomType, size: [f64; 3]) -> f64 {
    if matches!(kind, GeomType::Sphere | GeomType::Capsule) { size[0] } else { 0.0 }
}

fn hull_vertices(scene: &Scene, geom: usize) -> Vec<[f64; 3]> {
    let (Some(mesh), Some(hull)) = (scene.mesh(geom), scene.mesh_hull(geom)) else { return Vec::new() };
    let mut ids: Vec<i32> = hull.iter().flatten().copied().collect();
    ids.sort_unstable();
    ids.dedup();
    ids.into_iter().map(|v| mesh.vertices_m[v as usize].map(f64::from)).collect()
}

/// The nearest prism of a height field. MuJoCo's own distance (3.17.0) leaves out cells at the far edges, so it is not
/// used; its contacts are right and have the same prisms: two for each cell, split from (row, column) to (row + 1,
/// column + 1), from the base up to the heights.
fn nearest_on_heights(h: &HfieldView, shape: &Convex, center: [f64; 3], radius: f64, best: &mut Gap) {
    let [rx, ry, rz, base] = h.size_m;
    let (rows, cols) = (h.n_row - 1, h.n_col - 1);
    let (dx, dy) = (2.0 * rx / cols as f64, 2.0 * ry / rows as f64);
    let at = |row: usize, col: usize| {
        [dx * col as f64 - rx, dy * row as f64 - ry, rz * f64::from(h.data[row * h.n_col + col])]
    };
    let cell = |value: f64, step: f64, n: usize| ((value / step).floor().max(0.0) as usize).min(n - 1);
    let (row0, col0) = (cell(center[1] + ry, dy, rows), cell(center[0] + rx, dx, cols));
    // Rings of cells around the nearest one, until a whole ring is too far.
    for ring in 0..rows.max(cols) {
        let (mut any, mut open) = (false, false);
        let (r_low, r_high) = (row0.saturating_sub(ring), (row0 + ring).min(rows - 1));
        let (c_low, c_high) = (col0.saturating_sub(ring), (col0 + ring).min(cols - 1));
        for row in r_low..=r_high {
            let edge_row = row + ring == row0 || row == row0 + ring;
            for col in c_low..=c_high {
                let edge_col = col + ring == col0 || col == col0 + ring;
                if !edge_row && !edge_col {
                    continue;
                }
                any = true;
                let (a, b) = (at(row, col), at(row, col + 1));
                let (c, d) = (at(row + 1, col), at(row + 1, col + 1));
                let gap = |low: f64, high: f64, x: f64| (low - x).max(x - high).max(0.0);
                let (gx, gy) = (gap(a[0], d[0], center[0]), gap(a[1], d[1], center[1]));
                let reach = best.distance.max(0.0) + radius;
                let flat = gx * gx + gy * gy;
                if flat >= reach * reach {
                    continue;
                }
                open = true;
                let gz = gap(-base, a[2].max(b[2]).max(c[2]).max(d[2]), center[2]);
                if flat + gz * gz >= reach * reach {
                    continue;
                }
                for t in [[a, b, d], [a, c, d]] {
                    let foot = |v: [f64; 3]| [v[0], v[1], -base];
                    let prism = [t[0], t[1], t[2], foot(t[0]), foot(t[1]), foot(t[2])];
                    let gap = shape.distance_to(&prism);
                    if gap.distance < best.distance {
                        *best = gap;
                    }
                }
            }
        }
        if !any || !open {
            break;
        }
    }
}

fn nearest_on_triangles(mesh: &MeshView, shape: &Convex, center: [f64; 3], radius: f64, best: &mut Gap) {
    for face in mesh.faces {
        let t = triangle(mesh, face);
        let reach = best.distance.max(0.0) + radius;
        let mut d2 = 0.0;
        for k in 0..3 {
            let (low, high) = (t[0][k].min(t[1][k]).min(t[2][k]), t[0][k].max(t[1][k]).max(t[2][k]));
            d2 += (low - center[k]).max(center[k] - high).max(0.0).powi(2);
        }
        if d2 >= reach * reach {
            continue;
        }
        let gap = shape.distance_to(&t);
        if gap.distance < best.distance {
            *best = gap;
        }
    }
}

fn triangle(mesh: &MeshView, face: &[i32; 3]) -> [[f64; 3]; 3] {
    face.map(|v| mesh.vertices_m[v as usize].map(f64::from))
}

/// How often a closed mesh winds around a point: 1 inside, 0 outside (van Oosterom and Strackee, "The solid angle of a
/// plane triangle", IEEE Trans. Biomed. Eng. 30(2), 1983).
fn winding_number(mesh: &MeshView, point: [f64; 3]) -> f64 {
    let mut sum = 0.0;
    for face in mesh.faces {
        let [a, b, c] = triangle(mesh, face).map(|v| sub(v, point));
        let (la, lb, lc) = (dot(a, a).sqrt(), dot(b, b).sqrt(), dot(c, c).sqrt());
        let cross = [b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]];
        let down = la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb;
        sum += 2.0 * dot(a, cross).atan2(down);
    }
    sum / (4.0 * std::f64::consts::PI)
}
