//! One ray in f64: for rays from many points, and for the surface normals of a frame.

use super::lanes::none;
use super::placed::{Placed, turned};
use super::tree::Stack;
use super::{capsule, cuboid, cylinder, ellipsoid, plane, sphere};
use crate::kind::GeomType;
use crate::table::Table;

/// Distance of a geom along a unit direction, infinite for none nearer than `best`; and which triangle of a mesh it was.
pub(crate) fn hit(table: &Table, g: &Placed<f64>, d: [f64; 3], best: f64) -> (f64, usize) {
    let mut part = 0;
    let t = match g.kind {
        GeomType::Plane => {
            let dz = turned(g, d)[2];
            plane::hit(g, d, dz)
        }
        GeomType::Sphere => sphere::hit(g, d),
        GeomType::Capsule => capsule::hit(g, d),
        GeomType::Ellipsoid => ellipsoid::hit(g, d),
        GeomType::Cylinder => cylinder::hit(g, d),
        GeomType::Box => cuboid::hit(g, d),
        GeomType::Mesh => {
            let mut stack = Stack::new(0.0);
            table.meshes[g.asset as usize].hit(g, d, best, &mut stack, Some(&mut part))
        }
        GeomType::Hfield => table.hfields[g.asset as usize].hit(g, d, best),
        GeomType::Sdf => none(best),
    };
    (if t < best { t } else { f64::INFINITY }, part)
}

/// Outward unit normal in the world where a ray meets a geom at the distance `t`.
pub(crate) fn normal(
    table: &Table,
    g: &Placed<f64>,
    mat: &[f64; 9],
    frame: &[[f64; 3]; 3],
    d: [f64; 3],
    t: f64,
    part: usize,
) -> [f64; 3] {
    if g.kind == GeomType::Sphere {
        let n = sphere::normal([0, 1, 2].map(|k| g.at[k] + t * d[k]));
        return [0, 1, 2].map(|i| frame[i][0] * n[0] + frame[i][1] * n[1] + frame[i][2] * n[2]);
    }
    let local = turned(g, d);
    let x = [0, 1, 2].map(|k| g.at[k] + t * local[k]);
    let n = match g.kind {
        GeomType::Capsule => capsule::normal(x, g.size),
        GeomType::Ellipsoid => ellipsoid::normal(x, g.size),
        GeomType::Cylinder => cylinder::normal(x, g.size),
        GeomType::Box => cuboid::normal(x, g.size),
        GeomType::Mesh => table.meshes[g.asset as usize].normal(part),
        GeomType::Hfield => table.hfields[g.asset as usize].normal(x),
        GeomType::Plane | GeomType::Sphere | GeomType::Sdf => [0.0, 0.0, 1.0],
    };
    [0, 1, 2].map(|i| mat[3 * i] * n[0] + mat[3 * i + 1] * n[1] + mat[3 * i + 2] * n[2])
}
