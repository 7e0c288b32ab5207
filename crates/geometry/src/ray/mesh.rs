//! Triangle mesh: its triangles, seen from both sides, as MuJoCo's rays see them.

use super::lanes::{Lanes, Real, cross, dot_all, none, sub};
use super::placed::{Placed, turned};
use super::tree::{Leaves, Slabs, Stack};
use super::unit;
use crate::shape::mesh::Mesh;

impl Mesh {
    /// Normal of a triangle in the order of the leaves.
    pub fn normal(&self, triangle: usize) -> [f64; 3] {
        unit(self.normals.get(triangle).copied().unwrap_or([0.0, 0.0, 1.0]))
    }

    /// First of the triangles along the rays, nearer than `best`. `found`: its number, where a ray has one.
    #[inline(always)]
    pub(crate) fn hit<L: Lanes>(
        &self,
        g: &Placed<L::Real>,
        d: [L; 3],
        best: L,
        stack: &mut Stack<L>,
        found: Option<&mut usize>,
    ) -> L {
        let d = turned(g, d);
        // Half a step of f32 at the origin and at the boxes' faces, and some.
        let size = self.reach + g.at64[0].abs() + g.at64[1].abs() + g.at64[2].abs();
        let pad = <L::Real as Real>::of(if <L::Real as Real>::IS_F32 { 1e-6 * size } else { 1e-12 * size });
        let slabs = Slabs::new(g.at, d, pad);
        let mut t = best;
        let leaves = Triangles { mesh: self, at: g.at, rest: g.at_rest, d };
        self.bvh.walk(&slabs, &leaves, stack, &mut t);
        if let Some(found) = found {
            *found = leaves.find(&slabs, stack, best, t);
        }
        L::pick(t.lt(best), t, none(t))
    }
}

struct Triangles<'a, L: Lanes> {
    mesh: &'a Mesh,
    at: [L::Real; 3],
    rest: [L::Real; 3],
    d: [L; 3],
}

impl<L: Lanes> Triangles<'_, L> {
    /// The triangle at the distance that a walk found. One ray only.
    #[inline(always)]
    fn find(&self, slabs: &Slabs<L>, stack: &mut Stack<L>, best: L, t: L) -> usize {
        if !L::any(t.lt(best)) {
            return 0;
        }
        let seeker = Seeker { triangles: self, t, found: std::cell::Cell::new(0) };
        let mut reach = t + t * t.lit(1e-9) + t.lit(1e-12);
        self.mesh.bvh.walk(slabs, &seeker, stack, &mut reach);
        seeker.found.get()
    }

    #[inline(always)]
    fn one(&self, index: usize, best: L) -> L {
        let v = &self.mesh.triangles[index];
        triangle(
            relative::<L>(v[0], self.at, self.rest),
            relative::<L>(v[1], self.at, self.rest),
            relative::<L>(v[2], self.at, self.rest),
            self.d,
            best,
        )
    }
}

impl<L: Lanes> Leaves<L> for Triangles<'_, L> {
    #[inline(always)]
    fn test(&self, first: usize, count: usize, best: &mut L) {
        for index in first..first + count {
            *best = self.one(index, *best);
        }
    }
}

/// Looks for the triangle that gave a distance.
struct Seeker<'a, 'b, L: Lanes> {
    triangles: &'a Triangles<'b, L>,
    t: L,
    found: std::cell::Cell<usize>,
}

impl<L: Lanes> Leaves<L> for Seeker<'_, '_, L> {
    #[inline(always)]
    fn test(&self, first: usize, count: usize, best: &mut L) {
        for index in first..first + count {
            if L::any(self.triangles.one(index, *best).le(self.t)) {
                self.found.set(index);
            }
        }
    }
}

/// A corner relative to the origin of the rays, which is known to more digits than one number holds.
#[inline(always)]
fn relative<L: Lanes>(v: [f32; 3], at: [L::Real; 3], rest: [L::Real; 3]) -> [L::Real; 3] {
    let mut out = at;
    for k in 0..3 {
        out[k] = (L::Real::of(f64::from(v[k])) - at[k]) - rest[k];
    }
    out
}

/// The nearer of `best` and a triangle whose corners are relative to the origin, in an order that all its neighbours
/// share for common corners. Both sides count, and so do edges.
#[inline(always)]
pub(crate) fn triangle<L: Lanes>(a: [L::Real; 3], b: [L::Real; 3], c: [L::Real; 3], d: [L; 3], best: L) -> L {
    let zero = d[0].lit(0.0);
    // Six times the volumes between the ray and the edges; their signs say on which side it passes. Corner × edge keeps
    // digits that corner × corner would lose far away.
    let ab = sub(b, a);
    let ac = sub(c, a);
    let bc = sub(c, b);
    let u = dot_all(cross(a, ab), d);
    let v = dot_all(cross(b, bc), d);
    let w = -dot_all(cross(a, ac), d);
    let inside = (zero.le(u) & zero.le(v) & zero.le(w)) | (u.le(zero) & v.le(zero) & w.le(zero));
    if !L::any(inside) {
        return best;
    }
    let n = cross(ab, ac);
    let height = n[0] * a[0] + n[1] * a[1] + n[2] * a[2];
    let t = d[0].all(height) / dot_all(n, d);
    // A ray in the triangle's plane gives no number, and no comparison with that is true.
    L::pick(inside & zero.le(t) & t.lt(best), t, best)
}
