//! Ellipsoid: a unit ball after division by its half axes.

use super::lanes::{Lanes, dot};
use super::placed::{Placed, turned};
use super::sphere;

/// Distance of the surface along the directions.
#[inline(always)]
pub(crate) fn hit<L: Lanes>(g: &Placed<L::Real>, d: [L; 3]) -> L {
    let d = turned(g, d);
    let a = dot(d, d);
    if g.inside { sphere::leave(g.at, d, g.power[0], a, a) } else { sphere::enter(g.at, d, g.power[0], a) }
}

/// Outward normal at a point of the surface in half axes.
pub(crate) fn normal(x: [f64; 3], size: [f64; 3]) -> [f64; 3] {
    super::unit([x[0] / size[0], x[1] / size[1], x[2] / size[2]])
}
