//! Sphere, and every ball in other coordinates.

use super::lanes::{Lanes, cross_all, dot, dot_all, none};
use super::placed::Placed;

/// First surface of |p + t d| = r with `power` = |p|² − r² and `r2` = r², from outside: t ≥ 0 or infinite.
///
/// The discriminant r²|d|² − |p × d|² measures the distance between ray and centre directly: b² − a c would lose it
/// in rounding far away. The root c / (√ − b) keeps its digits close to the surface, where −b − √ cancels.
#[inline(always)]
pub(crate) fn enter<L: Lanes>(p: [L::Real; 3], d: [L; 3], power: L::Real, r2: L) -> L {
    let b = dot_all(p, d);
    let c = cross_all(p, d);
    let disc = r2 - dot(c, c);
    let zero = b.lit(0.0);
    let t = b.all(power) / (disc.max(zero).sqrt() - b);
    L::pick(zero.lt(disc) & b.lt(zero), t, none(b))
}

/// The surface from inside; `a` = |d|².
#[inline(always)]
pub(crate) fn leave<L: Lanes>(p: [L::Real; 3], d: [L; 3], power: L::Real, r2: L, a: L) -> L {
    let b = dot_all(p, d);
    let c = cross_all(p, d);
    let zero = b.lit(0.0);
    let s = (r2 - dot(c, c)).max(zero).sqrt();
    L::pick(zero.lt(b), -b.all(power) / (s + b), (s - b) / a)
}

/// Distance of the surface along unit directions in the rays' own frame.
#[inline(always)]
pub(crate) fn hit<L: Lanes>(g: &Placed<L::Real>, d: [L; 3]) -> L {
    let r2 = d[0].all(g.size[0] * g.size[0]);
    if g.inside { leave(g.at, d, g.power[0], r2, d[0].lit(1.0)) } else { enter(g.at, d, g.power[0], r2) }
}

/// Outward normal at a point relative to the centre.
pub(crate) fn normal(x: [f64; 3]) -> [f64; 3] {
    super::unit(x)
}
