//! Box.

use super::lanes::{Lanes, away_from_zero, none};
use super::placed::{Placed, turned};

/// Distance of the surface along the directions.
#[inline(always)]
pub(crate) fn hit<L: Lanes>(g: &Placed<L::Real>, d: [L; 3]) -> L {
    hit_local::<L>(&Faces { at: g.at, size: g.size, up: g.up, down: g.down, inside: g.inside }, turned(g, d))
}

/// A box about the origin of its frame, and a point in it.
pub(crate) struct Faces<R> {
    pub at: [R; 3],
    pub size: [R; 3],
    /// From the point to the faces at +size and −size.
    pub up: [R; 3],
    pub down: [R; 3],
    pub inside: bool,
}

/// The same for directions in the box's frame.
#[inline(always)]
pub(crate) fn hit_local<L: Lanes>(g: &Faces<L::Real>, d: [L; 3]) -> L {
    let like = d[0];
    let zero = like.lit(0.0);
    let mut t = none(like);
    if g.inside {
        for i in 0..3 {
            let face = L::pick(zero.lt(d[i]), like.all(g.up[i]), like.all(g.down[i]));
            t = t.min((face / away_from_zero(d[i])).abs());
        }
        return t;
    }
    // Of a box that is seen from outside, at most three faces are in sight: those beyond which the origin lies.
    for i in 0..3 {
        let above = g.at[i] >= g.size[i];
        if !above && g.at[i] > -g.size[i] {
            continue;
        }
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        let face = if above { g.up[i] } else { g.down[i] };
        let towards = if above { d[i].lt(zero) } else { zero.lt(d[i]) };
        let x = like.all(face) / away_from_zero(d[i]);
        let y = x.fma(d[j], like.all(g.at[j])).abs();
        let z = x.fma(d[k], like.all(g.at[k])).abs();
        let ok = towards & y.le(like.all(g.size[j])) & z.le(like.all(g.size[k]));
        t = L::pick(ok, x.min(t), t);
    }
    t
}

/// Outward normal at a point of the surface.
pub(crate) fn normal(x: [f64; 3], size: [f64; 3]) -> [f64; 3] {
    let mut face = 0;
    for i in 1..3 {
        if (x[i].abs() - size[i]).abs() < (x[face].abs() - size[face]).abs() {
            face = i;
        }
    }
    let mut n = [0.0; 3];
    n[face] = 1f64.copysign(x[face]);
    n
}
