//! Triangle mesh: its triangles, seen from both sides, as MuJoCo's rays see them.

use super::bvh::{Bvh, Leaves, Slabs, Stack};
use super::lanes::{Lanes, Real, cross, dot_all, none, sub};
use super::placed::{Placed, turned};

/// A mesh with its tree.
#[derive(Debug)]
pub(in super::super) struct Mesh {
    bvh: Bvh,
    /// Corners in the order of the leaves, each triangle's corners sorted by their coordinates: neighbours then compute
    /// their common edge from the same numbers, and no ray slips between them.
    triangles: Vec<[[f32; 3]; 3]>,
    /// Outward normals, not of unit length, in the order of the leaves.
    normals: Vec<[f64; 3]>,
    /// Largest coordinate.
    reach: f64,
}

impl Mesh {
    /// From vertices and faces; faces with a vertex that does not exist are left out.
    pub fn new(vertices: &[[f32; 3]], faces: &[[i32; 3]]) -> Self {
        let mut corners = Vec::with_capacity(faces.len());
        for face in faces {
            let get = |k: usize| usize::try_from(face[k]).ok().and_then(|v| vertices.get(v)).copied();
            if let (Some(a), Some(b), Some(c)) = (get(0), get(1), get(2)) {
                corners.push([a, b, c]);
            }
        }
        let bvh = Bvh::new(&corners);
        let mut triangles = Vec::with_capacity(corners.len());
        let mut normals = Vec::with_capacity(corners.len());
        let mut reach = 0.0f64;
        for &t in &bvh.order {
            let mut v = corners[t as usize];
            let wide = v.map(|p| p.map(f64::from));
            normals.push(cross(sub(wide[1], wide[0]), sub(wide[2], wide[0])));
            reach = wide.iter().flatten().fold(reach, |a, x| a.max(x.abs()));
            v.sort_unstable_by(|a, b| {
                a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])).then(a[2].total_cmp(&b[2]))
            });
            triangles.push(v);
        }
        Self { bvh, triangles, normals, reach }
    }

    /// Hands triangles to `visit`, near ones first, as long as their box comes nearer to a point than `reach`; `visit`
    /// gives the new reach.
    pub fn near(&self, at: [f64; 3], reach: f64, mut visit: impl FnMut(&[[f64; 3]; 3]) -> f64) {
        self.bvh.near(at, reach, |k, _| visit(&self.triangles[k].map(|v| v.map(f64::from))));
    }

    /// Normal of a triangle in the order of the leaves.
    pub fn normal(&self, triangle: usize) -> [f64; 3] {
        super::unit(self.normals.get(triangle).copied().unwrap_or([0.0, 0.0, 1.0]))
    }

    /// First of the triangles along the rays, nearer than `best`. `found`: its number, where a ray has one.
    #[inline(always)]
    pub(super) fn hit<L: Lanes>(
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
pub(super) fn triangle<L: Lanes>(a: [L::Real; 3], b: [L::Real; 3], c: [L::Real; 3], d: [L; 3], best: L) -> L {
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
