//! Distance of two convex shapes by the algorithm of Gilbert, Johnson and Keerthi ("A fast procedure for computing the
//! distance between complex objects in three-dimensional space", IEEE J. Robotics and Automation 4(2), 1988): of two
//! geoms, or of a geom and a few points' convex hull (a triangle, a prism).

use crate::kind::GeomType;
use crate::shape::hull::Hull;
use crate::vec3::{cross, dot, sub};

/// What a convex shape must tell: how far it reaches along a direction.
pub(crate) trait Support {
    /// Some point of it.
    fn middle(&self) -> [f64; 3];
    /// Radius by which its core is blown up.
    fn margin(&self) -> f64;
    /// Farthest point of the core along `d`.
    fn support(&self, d: [f64; 3]) -> [f64; 3];
}

/// A convex geom, placed in some frame.
#[derive(Clone)]
pub(crate) struct Convex<'a> {
    pub kind: GeomType,
    pub size: [f64; 3],
    pub pos: [f64; 3],
    /// Rotation from the shape's frame, row major.
    pub rot: [f64; 9],
    /// Of meshes.
    pub hull: Option<&'a Hull>,
    /// Where the last search of a mesh ended.
    last: std::cell::Cell<u32>,
}

/// The convex hull of some points.
pub(crate) struct Points<'a>(pub &'a [[f64; 3]]);

impl Support for Points<'_> {
    fn middle(&self) -> [f64; 3] {
        self.0.first().copied().unwrap_or_default()
    }

    fn margin(&self) -> f64 {
        0.0
    }

    #[inline]
    fn support(&self, d: [f64; 3]) -> [f64; 3] {
        let mut best = (f64::NEG_INFINITY, [0.0; 3]);
        for p in self.0 {
            let along = dot(*p, d);
            if along > best.0 {
                best = (along, *p);
            }
        }
        best.1
    }
}

/// Distance and closest points; 0 where the shapes overlap.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Gap {
    pub distance: f64,
    pub on_shape: [f64; 3],
    pub on_points: [f64; 3],
    /// The cores overlap: the true depth is unknown, the distance is minus both radii.
    pub overlap: bool,
}

impl Gap {
    /// Nothing nearer than `distance`.
    pub fn none(distance: f64) -> Self {
        Self { distance, on_shape: [0.0; 3], on_points: [0.0; 3], overlap: false }
    }
}

fn add(a: [f64; 3], b: [f64; 3], s: f64) -> [f64; 3] {
    [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]]
}

impl<'a> Convex<'a> {
    /// A shape of the given type and size; none for planes, height fields, signed distance fields and meshes without hull.
    #[inline]
    pub fn new(
        kind: GeomType,
        size: [f64; 3],
        pos: [f64; 3],
        rot: [f64; 9],
        hull: Option<&'a Hull>,
    ) -> Option<Self> {
        match kind {
            GeomType::Plane | GeomType::Hfield | GeomType::Sdf => None,
            GeomType::Mesh if hull.is_none_or(Hull::is_empty) => None,
            _ => Some(Self { kind, size, pos, rot, hull, last: std::cell::Cell::new(0) }),
        }
    }

    /// A direction in the shape's frame.
    #[inline]
    pub fn inward(&self, d: [f64; 3]) -> [f64; 3] {
        let r = &self.rot;
        // Written out: `map` over places became a call of its own here, and as dear as the product.
        [
            r[0] * d[0] + r[3] * d[1] + r[6] * d[2],
            r[1] * d[0] + r[4] * d[1] + r[7] * d[2],
            r[2] * d[0] + r[5] * d[1] + r[8] * d[2],
        ]
    }

    /// A direction of the shape's frame.
    #[inline]
    pub fn outward(&self, d: [f64; 3]) -> [f64; 3] {
        let r = &self.rot;
        [
            r[0] * d[0] + r[1] * d[1] + r[2] * d[2],
            r[3] * d[0] + r[4] * d[1] + r[5] * d[2],
            r[6] * d[0] + r[7] * d[1] + r[8] * d[2],
        ]
    }

    /// Farthest point along a unit vector, of the whole shape.
    #[inline]
    pub fn extreme(&self, d: [f64; 3]) -> [f64; 3] {
        add(self.support(d), d, self.margin())
    }

    /// Distance to another shape where it is less than `limit`, else any number of at least `limit`.
    ///
    /// Exact to rounding for shapes with corners, balls and capsules; to [`TOLERANCE_M`] where ellipsoids and cylinders
    /// converge, which they do within 1e-5 m of the sizes in the test below.
    pub fn distance_to(&self, other: &impl Support, limit: f64) -> Gap {
        let (own, others) = (self.margin(), other.margin());
        let margin = own + others;
        let mut best = Gap::none(f64::INFINITY);
        (best.on_shape, best.on_points) = (self.pos, other.middle());
        let mut v = sub(self.pos, other.middle());
        if dot(v, v) < 1e-24 {
            v = [0.0, 0.0, 1.0];
        }
        // Near the end a simplex on a round shape gets so thin that rounding stalls it: begin anew from where it was.
        for _ in 0..MAX_STARTS {
            let before = best.distance;
            match self.descend(other, &mut v, limit.max(0.0) + margin, &mut best) {
                End::Far => return Gap::none(f64::INFINITY),
                End::Proven => break,
                End::Stalled if before - best.distance < 1e-9 * before => break,
                End::Stalled => {}
            }
        }
        if margin > 0.0 && best.distance > 0.0 {
            let n = sub(best.on_points, best.on_shape).map(|x| x / best.distance);
            best.on_shape = add(best.on_shape, n, own);
            best.on_points = add(best.on_points, n, -others);
        }
        best.distance -= margin;
        best
    }

    /// Follows one chain of simplices from direction `v`.
    fn descend(&self, other: &impl Support, v: &mut [f64; 3], limit: f64, best: &mut Gap) -> End {
        let mut simplex = Simplex::default();
        let mut last = f64::INFINITY;
        for _ in 0..MAX_ROUNDS {
            let a = self.support(v.map(|x| -x));
            let b = other.support(*v);
            let w = sub(a, b);
            let v2 = dot(*v, *v);
            // The support plane says how much nearer the shapes can be at most.
            let vw = dot(*v, w);
            if vw > 0.0 && vw * vw >= limit * limit * v2 {
                return End::Far;
            }
            if last.is_finite() && v2 - vw <= (1e-12 * v2).max(TOLERANCE_M * v2.sqrt()) {
                return End::Proven;
            }
            if !simplex.push(w, a, b) {
                return End::Stalled;
            }
            let Some((nearest, on_shape, on_points)) = simplex.reduce() else {
                *best = Gap { distance: 0.0, on_shape: a, on_points: a, overlap: true };
                return End::Proven;
            };
            let d2 = dot(nearest, nearest);
            if d2 <= OVERLAP_M * OVERLAP_M {
                *best = Gap { distance: 0.0, on_shape, on_points, overlap: true };
                return End::Proven;
            }
            if d2 >= last {
                return End::Stalled;
            }
            if d2 < best.distance * best.distance {
                *best = Gap { distance: d2.sqrt(), on_shape, on_points, overlap: false };
            }
            last = d2;
            *v = nearest;
        }
        End::Stalled
    }
}

impl Support for Convex<'_> {
    #[inline]
    fn middle(&self) -> [f64; 3] {
        self.pos
    }

    /// Spheres are points, capsules are segments.
    #[inline]
    fn margin(&self) -> f64 {
        match self.kind {
            GeomType::Sphere | GeomType::Capsule => self.size[0],
            _ => 0.0,
        }
    }

    #[inline]
    fn support(&self, d: [f64; 3]) -> [f64; 3] {
        let r = &self.rot;
        let s = self.size;
        let p = match self.kind {
            GeomType::Sphere => return self.pos,
            GeomType::Capsule => {
                let up = r[2] * d[0] + r[5] * d[1] + r[8] * d[2];
                let h = s[1].copysign(up);
                return [self.pos[0] + h * r[2], self.pos[1] + h * r[5], self.pos[2] + h * r[8]];
            }
            _ => self.inward(d),
        };
        let p = match self.kind {
            GeomType::Box => [s[0].copysign(p[0]), s[1].copysign(p[1]), s[2].copysign(p[2])],
            GeomType::Ellipsoid => {
                let l = [s[0] * p[0], s[1] * p[1], s[2] * p[2]];
                let n = dot(l, l).sqrt().max(1e-300);
                [s[0] * l[0] / n, s[1] * l[1] / n, s[2] * l[2] / n]
            }
            GeomType::Cylinder => {
                let n = (p[0] * p[0] + p[1] * p[1]).sqrt();
                let scale = if n > 1e-300 { s[0] / n } else { 0.0 };
                [scale * p[0], scale * p[1], s[1].copysign(p[2])]
            }
            GeomType::Mesh => self.hull.map_or([0.0; 3], |hull| {
                let (at, number) = hull.farthest(p, self.last.get());
                self.last.set(number);
                at
            }),
            _ => [0.0; 3],
        };
        let p = self.outward(p);
        [self.pos[0] + p[0], self.pos[1] + p[1], self.pos[2] + p[2]]
    }
}

/// How a chain of simplices ended.
enum End {
    /// Nothing is nearer than the limit.
    Far,
    /// The distance is proven.
    Proven,
    /// Rounding stopped it.
    Stalled,
}

/// Distances are followed until they are proven to this, m.
pub(crate) const TOLERANCE_M: f64 = 1e-9;
const MAX_STARTS: usize = 8;
const MAX_ROUNDS: usize = 200;
/// Cores nearer than this overlap, m.
const OVERLAP_M: f64 = 1e-12;

#[derive(Default)]
struct Simplex {
    n: usize,
    w: [[f64; 3]; 4],
    a: [[f64; 3]; 4],
    b: [[f64; 3]; 4],
}

impl Simplex {
    /// Adds a vertex; false if it is there already.
    fn push(&mut self, w: [f64; 3], a: [f64; 3], b: [f64; 3]) -> bool {
        if self.n == 4 || self.w[..self.n].contains(&w) {
            return false;
        }
        self.w[self.n] = w;
        self.a[self.n] = a;
        self.b[self.n] = b;
        self.n += 1;
        true
    }

    /// Keeps the vertices that span the point nearest to the origin; that point and where it lies on both shapes. None
    /// when the origin is inside a tetrahedron.
    fn reduce(&mut self) -> Option<([f64; 3], [f64; 3], [f64; 3])> {
        let weights = match self.n {
            1 => [1.0, 0.0, 0.0, 0.0],
            2 => {
                let [s, t] = segment(self.w[0], self.w[1]);
                [s, t, 0.0, 0.0]
            }
            3 => {
                let [x, y, z] = triangle(self.w[0], self.w[1], self.w[2]);
                [x, y, z, 0.0]
            }
            _ => self.tetrahedron()?,
        };
        let (mut p, mut a, mut b) = ([0.0; 3], [0.0; 3], [0.0; 3]);
        let mut n = 0;
        for (i, weight) in weights.iter().enumerate().take(self.n) {
            if *weight > 0.0 {
                p = add(p, self.w[i], *weight);
                a = add(a, self.a[i], *weight);
                b = add(b, self.b[i], *weight);
                self.w[n] = self.w[i];
                self.a[n] = self.a[i];
                self.b[n] = self.b[i];
                n += 1;
            }
        }
        self.n = n;
        Some((p, a, b))
    }

    fn tetrahedron(&self) -> Option<[f64; 4]> {
        let w = &self.w;
        let mut best: Option<(f64, [f64; 4])> = None;
        let mut inside = true;
        for (i, j, k, l) in [(0, 1, 2, 3), (0, 1, 3, 2), (0, 2, 3, 1), (1, 2, 3, 0)] {
            let n = cross(sub(w[j], w[i]), sub(w[k], w[i]));
            let here = -dot(n, w[i]);
            let there = dot(n, sub(w[l], w[i]));
            let flat = there.abs() <= 1e-14 * dot(n, n).sqrt() * (dot(w[l], w[l]).sqrt() + 1e-30);
            if !flat && here * there > 0.0 {
                continue;
            }
            inside = false;
            let bary = triangle(w[i], w[j], w[k]);
            let p = add(add(w[i].map(|x| x * bary[0]), w[j], bary[1]), w[k], bary[2]);
            let d2 = dot(p, p);
            if best.is_none_or(|(least, _)| d2 < least) {
                let mut weights = [0.0; 4];
                weights[i] = bary[0];
                weights[j] = bary[1];
                weights[k] = bary[2];
                best = Some((d2, weights));
            }
        }
        if inside { None } else { best.map(|b| b.1) }
    }
}

/// Weights of the point of a segment that is nearest to the origin.
fn segment(a: [f64; 3], b: [f64; 3]) -> [f64; 2] {
    let ab = sub(b, a);
    let t = (-dot(a, ab) / dot(ab, ab).max(1e-300)).clamp(0.0, 1.0);
    [1.0 - t, t]
}

/// Weights of the point of a triangle that is nearest to the origin (Ericson, "Real-time collision detection", 2005,
/// section 5.1.5).
fn triangle(a: [f64; 3], b: [f64; 3], c: [f64; 3]) -> [f64; 3] {
    let (ab, ac) = (sub(b, a), sub(c, a));
    let (d1, d2) = (-dot(ab, a), -dot(ac, a));
    if d1 <= 0.0 && d2 <= 0.0 {
        return [1.0, 0.0, 0.0];
    }
    let (d3, d4) = (-dot(ab, b), -dot(ac, b));
    if d3 >= 0.0 && d4 <= d3 {
        return [0.0, 1.0, 0.0];
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        let t = d1 / (d1 - d3);
        return [1.0 - t, t, 0.0];
    }
    let (d5, d6) = (-dot(ab, c), -dot(ac, c));
    if d6 >= 0.0 && d5 <= d6 {
        return [0.0, 0.0, 1.0];
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        let t = d2 / (d2 - d6);
        return [1.0 - t, 0.0, t];
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        let t = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return [0.0, 1.0 - t, t];
    }
    let sum = va + vb + vc;
    if sum <= 0.0 {
        // A triangle without area: its longest side.
        let sides = [(a, b, [0, 1]), (b, c, [1, 2]), (a, c, [0, 2])];
        let mut best = (f64::INFINITY, [1.0, 0.0, 0.0]);
        for (p, q, at) in sides {
            let [s, t] = segment(p, q);
            let x = add(p.map(|x| x * s), q, t);
            if dot(x, x) < best.0 {
                let mut weights = [0.0; 3];
                weights[at[0]] = s;
                weights[at[1]] = t;
                best = (dot(x, x), weights);
            }
        }
        return best.1;
    }
    [va / sum, vb / sum, vc / sum]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quat;
    use crate::random::{Key, Stream, purpose};

    fn hull(s: &mut Stream) -> Hull {
        Hull::new((0..12).map(|_| [0; 3].map(|_| s.uniform(-0.5, 0.5))).collect(), &[])
    }

    fn shape<'a>(kind: GeomType, hull: &'a Hull, s: &mut Stream) -> Convex<'a> {
        let q = quat::normalize([s.normal(), s.normal(), s.normal(), s.normal()]);
        let m = quat::matrix(q);
        let rot = [m[0][0], m[0][1], m[0][2], m[1][0], m[1][1], m[1][2], m[2][0], m[2][1], m[2][2]];
        let size = [0; 3].map(|_| s.uniform(0.05, 0.6));
        Convex::new(kind, size, [0; 3].map(|_| s.uniform(-1.5, 1.5)), rot, Some(hull)).unwrap()
    }

    /// The distance is right when the closest points are in the shapes and the plane between them separates both: no
    /// pair of points is nearer then.
    #[test]
    fn the_closest_points_are_separated_by_the_plane_between_them() {
        let mut worst = 0.0f64;
        let mut far = 0;
        let kinds = [
            GeomType::Sphere,
            GeomType::Capsule,
            GeomType::Ellipsoid,
            GeomType::Cylinder,
            GeomType::Box,
            GeomType::Mesh,
        ];
        for (n, kind) in kinds.into_iter().enumerate() {
            let mut s = Key { seed: 1, world: 0, drone: 0, step: n as u64, purpose: purpose("gjk") }.stream();
            for _ in 0..3000 {
                let vertices = hull(&mut s);
                let a = shape(kind, &vertices, &mut s);
                let count = 1 + s.below(6) as usize;
                let points: Vec<_> = (0..count).map(|_| [0; 3].map(|_| s.uniform(-1.0, 1.0))).collect();
                let gap = a.distance_to(&Points(&points), f64::INFINITY);
                if gap.distance <= 1e-6 {
                    continue;
                }
                far += 1;
                let n = sub(gap.on_points, gap.on_shape).map(|x| x / gap.distance);
                let top = a.extreme(n);
                let low = points.iter().map(|p| dot(*p, n)).fold(f64::INFINITY, f64::min);
                // Lower bound of the true distance by the plane.
                let bound = low - dot(top, n);
                let slack = gap.distance - bound;
                assert!(slack > -1e-9, "{kind} {slack}");
                worst = worst.max(slack);
                let size = sub(gap.on_points, gap.on_shape);
                assert!((dot(size, size).sqrt() - gap.distance).abs() < 1e-9);
            }
        }
        assert!(far > 9000 && worst < 1e-5, "{far} {worst}");
    }

    #[test]
    fn overlapping_shapes_have_no_distance() {
        let mut s = Key { seed: 2, world: 0, drone: 0, step: 0, purpose: purpose("gjk") }.stream();
        let prism = |z: f64| {
            [
                [-2.0, -2.0, z],
                [2.0, -2.0, z],
                [0.0, 3.0, z],
                [-2.0, -2.0, -9.0],
                [2.0, -2.0, -9.0],
                [0.0, 3.0, -9.0],
            ]
        };
        for kind in [GeomType::Box, GeomType::Ellipsoid, GeomType::Cylinder, GeomType::Mesh, GeomType::Sphere]
        {
            for _ in 0..200 {
                let vertices = hull(&mut s);
                let mut a = shape(kind, &vertices, &mut s);
                a.pos = [0.0, 0.0, -1.0];
                assert!(a.distance_to(&Points(&prism(0.5)), 1.0).overlap, "{kind}");
            }
        }
    }
}
