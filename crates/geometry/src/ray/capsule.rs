//! Capsule: a cylinder along its z axis with a half ball at each end.

use super::cylinder::side;
use super::lanes::{Lanes, Real, none};
use super::placed::{Placed, turned};

/// Distance of the surface along the directions.
#[inline(always)]
pub(crate) fn hit<L: Lanes>(g: &Placed<L::Real>, d: [L; 3]) -> L {
    let d = turned(g, d);
    let like = d[0];
    let zero = like.lit(0.0);
    let half = like.all(g.size[1]);
    let pz = like.all(g.at[2]);
    let s = side(g, d);
    if g.inside {
        // Origins that lie in an end, beyond the round side's reach along the axis, leave by an end or by the side.
        let at = s.leave(g.power[0]);
        let z = at.fma(d[2], pz);
        let round = z.abs().le(half);
        let (b, root, power) = end(g, d, z);
        let out = L::pick(zero.lt(b), -power / (root.1 + b), root.1 - b);
        return L::pick(round, at, out);
    }
    if g.power[0] >= <L::Real as Real>::of(0.0) {
        let at = s.enter(g.power[0]);
        let z = at.fma(d[2], pz);
        // A ray that misses the endless cylinder misses the ends too.
        let meets = zero.lt(s.disc) & s.b.lt(zero);
        let round = meets & z.abs().le(half);
        let t = L::pick(round, at, none(like));
        let ends = meets & !round;
        if !L::any(ends) {
            return t;
        }
        let (b, root, power) = end(g, d, z);
        let ok = ends & zero.lt(root.0) & b.lt(zero);
        return L::pick(ok, power / (root.1 - b), t);
    }
    let (b, root, power) = end(g, d, pz);
    L::pick(zero.lt(root.0) & b.lt(zero), power / (root.1 - b), none(like))
}

/// The ball at the end towards `z`: p · d, discriminant with its root, power of the origin.
#[inline(always)]
fn end<L: Lanes>(g: &Placed<L::Real>, d: [L; 3], z: L) -> (L, (L, L), L) {
    let like = d[0];
    let zero = like.lit(0.0);
    let up = zero.lt(z);
    let pz = L::pick(up, like.all(g.at[2] - g.size[1]), like.all(g.at[2] + g.size[1]));
    let power = L::pick(up, like.all(g.power[1]), like.all(g.power[2]));
    let (px, py) = (like.all(g.at[0]), like.all(g.at[1]));
    let b = pz.fma(d[2], px.fma(d[0], py * d[1]));
    let x = py * d[2] - pz * d[1];
    let y = pz * d[0] - px * d[2];
    let w = px * d[1] - py * d[0];
    let disc = like.all(g.size[0] * g.size[0]) - w.fma(w, x.fma(x, y * y));
    (b, (disc, disc.max(zero).sqrt()), power)
}

/// Outward normal at a point of the surface.
pub(crate) fn normal(x: [f64; 3], size: [f64; 3]) -> [f64; 3] {
    super::unit([x[0], x[1], x[2] - x[2].clamp(-size[1], size[1])])
}
