//! Distance from a drone to the nearest obstacle, with closest points.
//!
//! Distances are those of MuJoCo (mj_geomDistance): exact to rounding for spheres, capsules, boxes and planes, to the
//! scene's `ccd_tolerance` (1e-6 m by default) for ellipsoids, cylinders, meshes and height fields. A mesh counts as
//! its convex hull, as in contacts; a height field as its triangles. MuJoCo has no distance for signed distance
//! fields: there the distance to the triangles of the field's mesh is computed here, exact for a drone's spheres, and
//! a lower bound (by the bounding sphere of the geom) for its other shapes. Flexes have no distance.

use serde::Serialize;

use super::SenseError;
use crate::scene::{GeomType, MeshView, Scene, Worker};

/// The nearest obstacle of a drone.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Clearance {
    /// The drone.
    pub drone: usize,
    /// Signed distance, m: negative in penetration; the maximum that was asked for when nothing is nearer.
    pub distance_m: f64,
    /// Whether anything is nearer than the maximum; the rest is meaningless if not.
    pub found: bool,
    /// False when `distance_m` is only a lower bound (signed distance fields).
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
        let bound = box_distance(worker, scene, geom.id, center)? - radius;
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
            let near = box_distance(worker, scene, other, at)? - info.bounding_radius_m;
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
    Ok(best)
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

/// Signed distance of a drone's geom and another geom, up to `max_m`.
pub(super) fn pair_distance(
    worker: &mut Worker,
    scene: &Scene,
    own: usize,
    other: usize,
    max_m: f64,
) -> Result<PairDistance, SenseError> {
    let kinds = [scene.geoms()[own].kind, scene.geoms()[other].kind];
    if kinds.contains(&GeomType::Sdf) && !kinds.contains(&GeomType::Plane) {
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

/// Distance where one of the two is a signed distance field, by the triangles of its mesh and the other's bounding
/// sphere.
fn field_distance(
    worker: &mut Worker,
    scene: &Scene,
    own: usize,
    other: usize,
    max_m: f64,
) -> Result<PairDistance, SenseError> {
    let own_is_field = scene.geoms()[own].kind == GeomType::Sdf;
    let (field, ball) = if own_is_field { (own, other) } else { (other, own) };
    let info = &scene.geoms()[ball];
    let far = PairDistance { distance_m: max_m, on_drone_m: [0.0; 3], on_other_m: [0.0; 3], exact: false };
    let Some(mesh) = scene.mesh(field) else {
        // No triangles to measure: the bounding box is a lower bound.
        let (at, _) = worker.geom_pose(ball)?;
        let distance_m = (box_distance(worker, scene, field, at)? - info.bounding_radius_m).min(max_m);
        return Ok(PairDistance { distance_m, ..far });
    };
    let (p, r) = worker.geom_pose(field)?;
    let (x, _) = worker.geom_pose(ball)?;
    let radius = info.bounding_radius_m;
    let d = [0, 1, 2].map(|k| x[k] - p[k]);
    let local = [0, 1, 2].map(|k| r[k] * d[0] + r[3 + k] * d[1] + r[6 + k] * d[2]);
    let (nearest, distance) = nearest_on_mesh(&mesh, local);
    let inside = winding_number(&mesh, local) > 0.5;
    let signed = if inside { -distance } else { distance } - radius;
    if signed >= max_m {
        return Ok(far);
    }
    let on_field = [0, 1, 2]
        .map(|k| p[k] + r[3 * k] * nearest[0] + r[3 * k + 1] * nearest[1] + r[3 * k + 2] * nearest[2]);
    let towards = if distance > 0.0 { radius / distance * if inside { -1.0 } else { 1.0 } } else { 0.0 };
    let on_ball = [0, 1, 2].map(|k| x[k] + (on_field[k] - x[k]) * towards);
    let (on_drone_m, on_other_m) = if own_is_field { (on_field, on_ball) } else { (on_ball, on_field) };
    Ok(PairDistance { distance_m: signed, on_drone_m, on_other_m, exact: info.kind == GeomType::Sphere })
}

fn triangle(mesh: &MeshView, face: &[i32; 3]) -> [[f64; 3]; 3] {
    face.map(|v| mesh.vertices_m[v as usize].map(f64::from))
}

fn nearest_on_mesh(mesh: &MeshView, point: [f64; 3]) -> ([f64; 3], f64) {
    let mut best = ([0.0; 3], f64::INFINITY);
    for face in mesh.faces {
        let on = nearest_on_triangle(point, triangle(mesh, face));
        let d2 = (0..3).map(|k| (on[k] - point[k]).powi(2)).sum::<f64>();
        if d2 < best.1 {
            best = (on, d2);
        }
    }
    (best.0, best.1.sqrt())
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Closest point of a triangle (Ericson, "Real-time collision detection", 2005, section 5.1.5: by Voronoi regions).
pub(super) fn nearest_on_triangle(p: [f64; 3], [a, b, c]: [[f64; 3]; 3]) -> [f64; 3] {
    let along =
        |o: [f64; 3], u: [f64; 3], s: f64, v: [f64; 3], t: f64| [0, 1, 2].map(|k| o[k] + s * u[k] + t * v[k]);
    let (ab, ac, ap) = (sub(b, a), sub(c, a), sub(p, a));
    let (d1, d2) = (dot(ab, ap), dot(ac, ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let bp = sub(p, b);
    let (d3, d4) = (dot(ab, bp), dot(ac, bp));
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return along(a, ab, d1 / (d1 - d3), ac, 0.0);
    }
    let cp = sub(p, c);
    let (d5, d6) = (dot(ab, cp), dot(ac, cp));
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return along(a, ab, 0.0, ac, d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        let w = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return along(b, sub(c, b), w, ac, 0.0);
    }
    let sum = va + vb + vc;
    if sum == 0.0 {
        return a;
    }
    along(a, ab, vb / sum, ac, vc / sum)
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

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn no_point_of_a_triangle_is_nearer_than_the_nearest(
            t in prop::array::uniform9(-1.0..1.0f64), p in prop::array::uniform3(-2.0..2.0f64)
        ) {
            let tri = [[t[0], t[1], t[2]], [t[3], t[4], t[5]], [t[6], t[7], t[8]]];
            let on = nearest_on_triangle(p, tri);
            let d = |q: [f64; 3]| dot(sub(p, q), sub(p, q)).sqrt();
            let mut sampled = f64::INFINITY;
            for i in 0..=60 {
                for j in 0..=(60 - i) {
                    let (u, v) = (i as f64 / 60.0, j as f64 / 60.0);
                    let q = [0, 1, 2].map(|k| tri[0][k] + u * (tri[1][k] - tri[0][k]) + v * (tri[2][k] - tri[0][k]));
                    sampled = sampled.min(d(q));
                }
            }
            prop_assert!(d(on) <= sampled + 1e-12);
            // Samples are at most 1/60 of two sides of length < 2√3 apart.
            prop_assert!(d(on) >= sampled - 0.12, "{} {}", d(on), sampled);
        }
    }
}
