//! A geom as the rays of one frame see it.

use super::lanes::{Lanes, Real, dot_all};
use crate::kind::GeomType;
use crate::table::Geom;

/// A geom in terms of the rays' common origin and of the frame in which their directions are given. What all rays share is
/// computed once, in f64.
#[derive(Clone, Copy)]
pub(crate) struct Placed<R> {
    pub kind: GeomType,
    /// The origin lies inside (solids only).
    pub inside: bool,
    /// Mesh or height field.
    pub asset: u32,
    /// Geom id; exact in f32 up to 2²⁴.
    pub id: R,
    /// From a direction of the rays to the geom's frame; scaled by the half axes for an ellipsoid; unused for a sphere.
    pub turn: [[R; 3]; 3],
    /// Origin of the rays in the geom's frame, m; in half axes for an ellipsoid; in the rays' frame for a sphere.
    pub at: [R; 3],
    /// What rounding took from `at`.
    pub at_rest: [R; 3],
    pub at64: [f64; 3],
    /// Third row of `turn`.
    pub up64: [f64; 3],
    pub size: [R; 3],
    /// From the origin to the faces at +size and at −size.
    pub up: [R; 3],
    pub down: [R; 3],
    /// Powers of the origin, |p|² − r² and the like: its circle or sphere, upper and lower end of a capsule.
    pub power: [R; 3],
}

impl<R: Real> Placed<R> {
    /// `pos`, `mat`: pose of the geom (row major); `origin`, `frame`: common origin, and rotation from the frame of the
    /// directions to the world.
    pub fn new(
        shape: &Geom,
        pos: [f64; 3],
        mat: &[f64; 9],
        origin: [f64; 3],
        frame: &[[f64; 3]; 3],
        id: usize,
    ) -> Self {
        let d = [origin[0] - pos[0], origin[1] - pos[1], origin[2] - pos[2]];
        let mut at = [0.0; 3];
        let mut turn = [[0.0; 3]; 3];
        for i in 0..3 {
            at[i] = mat[i] * d[0] + mat[3 + i] * d[1] + mat[6 + i] * d[2];
            for j in 0..3 {
                turn[i][j] = mat[i] * frame[0][j] + mat[3 + i] * frame[1][j] + mat[6 + i] * frame[2][j];
            }
        }
        let mut s = shape.size;
        let square = |v: [f64; 3]| v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
        let mut power = [0.0; 3];
        let mut inside = false;
        match shape.kind {
            GeomType::Sphere => {
                for i in 0..3 {
                    at[i] = frame[0][i] * d[0] + frame[1][i] * d[1] + frame[2][i] * d[2];
                }
                power[0] = square(at) - s[0] * s[0];
                inside = power[0] < 0.0;
            }
            GeomType::Ellipsoid => {
                for i in 0..3 {
                    at[i] /= s[i];
                    for j in 0..3 {
                        turn[i][j] /= s[i];
                    }
                }
                power[0] = square(at) - 1.0;
                inside = power[0] < 0.0;
            }
            GeomType::Capsule => {
                power[0] = at[0] * at[0] + at[1] * at[1] - s[0] * s[0];
                power[1] = power[0] + (at[2] - s[1]) * (at[2] - s[1]);
                power[2] = power[0] + (at[2] + s[1]) * (at[2] + s[1]);
                inside = (power[0] < 0.0 && at[2].abs() <= s[1]) || power[1] < 0.0 || power[2] < 0.0;
            }
            GeomType::Cylinder => {
                // Its ends, in the place of the faces along z.
                s = [s[0], s[1], s[1]];
                power[0] = at[0] * at[0] + at[1] * at[1] - s[0] * s[0];
                inside = power[0] < 0.0 && at[2].abs() < s[1];
            }
            GeomType::Box => inside = (0..3).all(|i| at[i].abs() < s[i]),
            GeomType::Plane | GeomType::Hfield | GeomType::Mesh | GeomType::Sdf => {}
        }
        let of3 = |v: [f64; 3]| [R::of(v[0]), R::of(v[1]), R::of(v[2])];
        // Only f32 rounds; f64 keeps nothing back.
        let kept = [0, 1, 2].map(|i| if R::IS_F32 { f64::from(at[i] as f32) } else { at[i] });
        Self {
            kind: shape.kind,
            inside,
            asset: shape.asset,
            id: R::of(id as f64),
            turn: [of3(turn[0]), of3(turn[1]), of3(turn[2])],
            at: of3(at),
            at_rest: of3([at[0] - kept[0], at[1] - kept[1], at[2] - kept[2]]),
            at64: at,
            up64: turn[2],
            size: of3(s),
            up: of3([s[0] - at[0], s[1] - at[1], s[2] - at[2]]),
            down: of3([-s[0] - at[0], -s[1] - at[1], -s[2] - at[2]]),
            power: of3(power),
        }
    }
}

/// A direction in the geom's frame.
#[inline(always)]
pub(crate) fn turned<L: Lanes>(g: &Placed<L::Real>, d: [L; 3]) -> [L; 3] {
    [dot_all(g.turn[0], d), dot_all(g.turn[1], d), dot_all(g.turn[2], d)]
}
