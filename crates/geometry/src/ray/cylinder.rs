//! Cylinder with flat ends along its z axis.

use super::lanes::{Lanes, none};
use super::placed::{Placed, turned};

/// What the endless round side says about rays.
pub(crate) struct Side<L: Lanes> {
    /// |d|² across the axis, not zero.
    pub a: L,
    /// p · d across the axis.
    pub b: L,
    /// Discriminant.
    pub disc: L,
    /// Its root, zero where there is none.
    pub root: L,
}

#[inline(always)]
pub(crate) fn side<L: Lanes>(g: &Placed<L::Real>, d: [L; 3]) -> Side<L> {
    let (px, py) = (d[0].all(g.at[0]), d[0].all(g.at[1]));
    let a = d[0].fma(d[0], d[1] * d[1]).max(d[0].lit(1e-30));
    let b = px.fma(d[0], py * d[1]);
    let across = px * d[1] - py * d[0];
    let disc = a * d[0].all(g.size[0] * g.size[0]) - across * across;
    let root = disc.max(d[0].lit(0.0)).sqrt();
    Side { a, b, disc, root }
}

impl<L: Lanes> Side<L> {
    /// Where rays from outside enter: valid where the discriminant is positive and b negative.
    #[inline(always)]
    pub fn enter(&self, power: L::Real) -> L {
        self.b.all(power) / (self.root - self.b)
    }

    /// Where rays from inside leave.
    #[inline(always)]
    pub fn leave(&self, power: L::Real) -> L {
        let zero = self.b.lit(0.0);
        L::pick(zero.lt(self.b), -self.b.all(power) / (self.root + self.b), (self.root - self.b) / self.a)
    }
}

/// Distance of the surface along the directions.
#[inline(always)]
pub(crate) fn hit<L: Lanes>(g: &Placed<L::Real>, d: [L; 3]) -> L {
    let d = turned(g, d);
    let like = d[0];
    let zero = like.lit(0.0);
    let half = like.all(g.size[1]);
    let pz = like.all(g.at[2]);
    if g.inside {
        let end = L::pick(zero.lt(d[2]), like.all(g.up[2]), like.all(g.down[2]));
        let end = (end / super::lanes::away_from_zero(d[2])).abs();
        return side(g, d).leave(g.power[0]).min(end);
    }
    let mut t = none(like);
    let no = <L::Real as super::lanes::Real>::of(0.0);
    let round = g.power[0] >= no;
    if round {
        let s = side(g, d);
        let at = s.enter(g.power[0]);
        let z = at.fma(d[2], pz);
        let ok = zero.lt(s.disc) & s.b.lt(zero) & z.abs().le(half);
        t = L::pick(ok, at, t);
    }
    let above = g.at[2] >= g.size[1];
    if above || g.at[2] <= -g.size[1] {
        let face = if above { g.up[2] } else { g.down[2] };
        let towards = if above { d[2].lt(zero) } else { zero.lt(d[2]) };
        let at = like.all(face) / super::lanes::away_from_zero(d[2]);
        let x = at.fma(d[0], like.all(g.at[0]));
        let y = at.fma(d[1], like.all(g.at[1]));
        let ok = towards & x.fma(x, y * y).le(like.all(g.size[0] * g.size[0]));
        t = L::pick(ok, at.min(t), t);
    }
    t
}

/// Outward normal at a point of the surface.
pub(crate) fn normal(x: [f64; 3], size: [f64; 3]) -> [f64; 3] {
    let from_side = (x[0].hypot(x[1]) - size[0]).abs();
    if (x[2].abs() - size[1]).abs() < from_side {
        [0.0, 0.0, 1f64.copysign(x[2])]
    } else {
        super::unit([x[0], x[1], 0.0])
    }
}
