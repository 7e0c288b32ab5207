//! Signed distance of a point to the surface of a geom, in the geom's frame: what balls touch.

use super::gjk::{Convex, Points};
use crate::kind::GeomType;
use crate::shape::hull::Hull;
use crate::vec3::{dot, sub};

/// Signed distance, the nearest point of the surface, and the unit normal there, outward.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Foot {
    pub distance: f64,
    pub at: [f64; 3],
    pub normal: [f64; 3],
}

impl Foot {
    /// Of a surface at `at` whose outside is along `normal`.
    fn on(p: [f64; 3], at: [f64; 3], normal: [f64; 3]) -> Self {
        Self { distance: dot(sub(p, at), normal), at, normal }
    }

    /// Nearest point `core` of what lies inside the surface by `radius`; `spare` is the normal where the two coincide.
    fn about(p: [f64; 3], core: [f64; 3], radius: f64, spare: [f64; 3]) -> Self {
        let d = sub(p, core);
        let length = dot(d, d).sqrt();
        let normal = if length > 1e-15 { d.map(|x| x / length) } else { spare };
        Self { distance: length - radius, at: [0, 1, 2].map(|k| core[k] + radius * normal[k]), normal }
    }
}

/// Foot of `p` on a plane, sphere, capsule, ellipsoid, cylinder, box or convex hull; none for fields, and for hulls of whose
/// inside nothing is known.
pub(crate) fn foot(kind: GeomType, size: [f64; 3], hull: Option<&Hull>, p: [f64; 3]) -> Option<Foot> {
    Some(match kind {
        GeomType::Plane => Foot::on(p, [p[0], p[1], 0.0], [0.0, 0.0, 1.0]),
        GeomType::Sphere => Foot::about(p, [0.0; 3], size[0], [1.0, 0.0, 0.0]),
        GeomType::Capsule => {
            let core = [0.0, 0.0, p[2].clamp(-size[1], size[1])];
            Foot::about(p, core, size[0], [1.0, 0.0, 0.0])
        }
        GeomType::Ellipsoid => ellipsoid(size, p),
        GeomType::Cylinder => cylinder(size, p),
        GeomType::Box => cuboid(size, p),
        GeomType::Mesh => return polytope(hull?, p),
        GeomType::Hfield | GeomType::Sdf => return None,
    })
}

fn cuboid(s: [f64; 3], p: [f64; 3]) -> Foot {
    let inner = [0, 1, 2].map(|k| p[k].clamp(-s[k], s[k]));
    if inner != p {
        return Foot::about(p, inner, 0.0, [0.0, 0.0, 1.0]);
    }
    let face = (0..3).fold(0, |a, k| if s[k] - p[k].abs() < s[a] - p[a].abs() { k } else { a });
    let (mut at, mut normal) = (p, [0.0; 3]);
    at[face] = s[face].copysign(p[face]);
    normal[face] = 1f64.copysign(p[face]);
    Foot::on(p, at, normal)
}

fn cylinder([r, h, _]: [f64; 3], p: [f64; 3]) -> Foot {
    let rho = (p[0] * p[0] + p[1] * p[1]).sqrt();
    let radial = if rho > 1e-15 { [p[0] / rho, p[1] / rho, 0.0] } else { [1.0, 0.0, 0.0] };
    if rho > r || p[2].abs() > h {
        let to = rho.min(r);
        let inner = [to * radial[0], to * radial[1], p[2].clamp(-h, h)];
        return Foot::about(p, inner, 0.0, radial);
    }
    if r - rho < h - p[2].abs() {
        Foot::on(p, [r * radial[0], r * radial[1], p[2]], radial)
    } else {
        Foot::on(p, [p[0], p[1], h.copysign(p[2])], [0.0, 0.0, 1f64.copysign(p[2])])
    }
}

/// The foot x solves x_k = s_k² p_k / (s_k² + t) with Σ (x_k / s_k)² = 1 (Eberly, "Distance from a point to an ellipse, an
/// ellipsoid, or a hyperellipsoid", 2013). The sum falls and is convex in t right of its last pole, so that Newton's
/// method from the left of the root never oversteps it.
fn ellipsoid(s: [f64; 3], p: [f64; 3]) -> Foot {
    // A point in a plane of symmetry may have two feet: moved off it by less than is measured, it has one.
    let least = s[0].min(s[1]).min(s[2]);
    let q = p.map(|x| x.abs().max(1e-10 * least).copysign(x));
    // Counted from the last pole, u = t + min s²: near it t itself would have no digits left.
    let beyond = s.map(|x| (x - least) * (x + least));
    let mut u = (0..3).map(|k| s[k] * q[k].abs() - beyond[k]).fold(f64::NEG_INFINITY, f64::max);
    for _ in 0..200 {
        let (mut f, mut slope) = (-1.0, 0.0);
        for k in 0..3 {
            let d = beyond[k] + u;
            let x = s[k] * q[k] / d;
            f += x * x;
            slope -= 2.0 * x * x / d;
        }
        let step = -f / slope;
        u += step;
        if !(step > 1e-15 * u) {
            break;
        }
    }
    let at = [0, 1, 2].map(|k| s[k] * s[k] * q[k] / (beyond[k] + u));
    let n = [0, 1, 2].map(|k| at[k] / (s[k] * s[k]));
    let length = dot(n, n).sqrt();
    Foot::on(p, at, n.map(|x| x / length))
}

fn polytope(hull: &Hull, p: [f64; 3]) -> Option<Foot> {
    const LEVEL: [f64; 9] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let shape = Convex::new(GeomType::Mesh, [0.0; 3], [0.0; 3], LEVEL, Some(hull))?;
    let gap = shape.distance_to(&Points(&[p]), f64::INFINITY);
    if !gap.overlap && gap.distance > 0.0 {
        let normal = sub(p, gap.on_shape).map(|x| x / gap.distance);
        return Some(Foot { distance: gap.distance, at: gap.on_shape, normal });
    }
    let (distance, normal) = hull.depth(p)?;
    Some(Foot { distance, at: [0, 1, 2].map(|k| p[k] - distance * normal[k]), normal })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Key, purpose};

    /// The foot lies on the surface, the normal leads from it to the point, and no other point of the surface is nearer.
    #[test]
    fn feet_are_the_nearest_points_of_surfaces() {
        let mut s = Key { seed: 1, world: 0, drone: 0, step: 0, purpose: purpose("feet") }.stream();
        for kind in
            [GeomType::Sphere, GeomType::Capsule, GeomType::Ellipsoid, GeomType::Cylinder, GeomType::Box]
        {
            let mut inside = 0;
            for case in 0..4000 {
                let size = [0; 3].map(|_| s.uniform(0.05, 0.8));
                let mut p = [0; 3].map(|_| s.uniform(-1.2, 1.2));
                if case % 10 == 0 {
                    // Planes of symmetry.
                    p[s.below(3) as usize] = 0.0;
                }
                let f = foot(kind, size, None, p).unwrap();
                inside += usize::from(f.distance < 0.0);
                let gap = sub(p, f.at);
                assert!((dot(f.normal, f.normal) - 1.0).abs() < 1e-12, "{kind}");
                for k in 0..3 {
                    assert!((gap[k] - f.distance * f.normal[k]).abs() < 1e-8, "{kind} {size:?} {p:?} {f:?}");
                }
                // On the surface: a step out is outside, a step in is inside.
                let out =
                    |d: f64| foot(kind, size, None, [0, 1, 2].map(|k| f.at[k] + d * f.normal[k])).unwrap();
                let (above, here) = (out(1e-4).distance - 1e-4, out(0.0).distance);
                assert!(above.abs() < 1e-7 && here.abs() < 1e-8, "{kind} {size:?} {p:?} {above} {here}");
                // Signed distances change no faster than the point moves: another point of the surface that were
                // nearer would break this.
                let q = [0, 1, 2].map(|k| p[k] + s.uniform(-0.2, 0.2));
                let (d, other) = (sub(q, p), foot(kind, size, None, q).unwrap());
                assert!(
                    (other.distance - f.distance).abs() <= dot(d, d).sqrt() + 1e-8,
                    "{kind} {size:?} {p:?}"
                );
            }
            assert!(inside > 100, "{kind} {inside}");
        }
    }
}
