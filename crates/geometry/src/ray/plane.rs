//! Plane: endless, or the rectangle that MuJoCo draws; seen from above only.

use super::lanes::{Lanes, Real, dot_all, none};
use super::placed::Placed;

/// Distance along the directions. `dz` is their component along the normal: over a floor that reaches to the horizon it
/// decides how many digits the distance has, so the caller computes it in f64.
#[inline(always)]
pub(crate) fn hit<L: Lanes>(g: &Placed<L::Real>, d: [L; 3], dz: L) -> L {
    let like = d[0];
    let zero = <L::Real as Real>::of(0.0);
    if g.at[2] < zero {
        return none(like);
    }
    // mjMINVAL of MuJoCo: flatter rays pass.
    let mut ok = dz.lt(like.lit(-1e-15));
    let t = like.all(-g.at[2]) / dz;
    for i in 0..2 {
        if g.size[i] > zero {
            let x = t.fma(dot_all(g.turn[i], d), like.all(g.at[i]));
            ok = ok & x.abs().le(like.all(g.size[i]));
        }
    }
    L::pick(ok, t, none(like))
}
