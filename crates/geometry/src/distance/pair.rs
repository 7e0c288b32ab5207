//! Signed distance of two geoms.

use super::foot::{Foot, foot};
use super::gjk::{Convex, Gap, Points};
use crate::kind::GeomType;
use crate::shape::hull::Hull;
use crate::shape::round::Round;
use crate::shape::surface::Surface;
use crate::table::{Geom, Table};
use crate::vec3::{cross, dot, sub};

/// What two geoms are to each other, in the world's directions about some origin.
#[derive(Clone, Copy, Debug)]
pub struct Meeting {
    /// Signed distance, m. Where `deep` it is an upper bound.
    pub distance: f64,
    /// Nearest point of the first.
    pub on_first: [f64; 3],
    /// Nearest point of the second.
    pub on_second: [f64; 3],
    /// Unit normal from the second to the first, where a closed form gives it.
    pub normal: Option<[f64; 3]>,
    /// They overlap and how deep is not known here.
    pub deep: bool,
    /// The distance is no more than a lower bound.
    pub bound: bool,
}

impl Meeting {
    /// Nothing near.
    pub const fn far() -> Self {
        Self {
            distance: f64::INFINITY,
            on_first: [0.0; 3],
            on_second: [0.0; 3],
            normal: None,
            deep: false,
            bound: false,
        }
    }

    fn of_gap(gap: &Gap) -> Self {
        Self {
            distance: gap.distance,
            on_first: gap.on_shape,
            on_second: gap.on_points,
            deep: gap.overlap,
            ..Self::far()
        }
    }
}

/// Signed distance of a drone's geom and another geom.
#[derive(Clone, Copy, Debug)]
pub struct PairDistance {
    /// Signed distance, m; at most the limit that was asked for.
    pub distance_m: f64,
    /// Nearest point of the drone's geom, world, m.
    pub on_drone_m: [f64; 3],
    /// Nearest point of the other geom, world, m.
    pub on_other_m: [f64; 3],
    /// False for a lower bound.
    pub exact: bool,
}

/// Where a geom is.
#[derive(Clone, Copy)]
pub(crate) struct Place<'a> {
    pub pos: [f64; 3],
    /// Row major.
    pub mat: &'a [f64; 9],
}

#[inline]
fn into(m: &[f64; 9], d: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|k| m[k] * d[0] + m[3 + k] * d[1] + m[6 + k] * d[2])
}

#[inline]
fn out_of(m: &[f64; 9], d: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|k| m[3 * k] * d[0] + m[3 * k + 1] * d[1] + m[3 * k + 2] * d[2])
}

impl Table {
    /// The convex geom `id`, at `pos`.
    #[inline]
    pub(crate) fn convex(&self, id: usize, pos: [f64; 3], mat: &[f64; 9]) -> Option<Convex<'_>> {
        let g = &self.geoms[id];
        Convex::new(g.kind, g.size, pos, *mat, self.hull(g))
    }

    #[inline]
    fn hull(&self, g: &Geom) -> Option<&Hull> {
        if g.kind == GeomType::Mesh { self.hulls.get(g.solid? as usize) } else { None }
    }

    /// Signed distance of a convex geom and any other, where it is less than `limit`; else any number of at least that.
    /// Points are relative to the place of the first.
    pub(crate) fn meet(&self, first: usize, a: Place, second: usize, b: Place, limit: f64) -> Meeting {
        let Some(shape) = self.convex(first, [0.0; 3], a.mat) else { return Meeting::far() };
        let (g, h) = (&self.geoms[first], &self.geoms[second]);
        let p = sub(b.pos, a.pos);
        match h.kind {
            GeomType::Plane => {
                let n = [b.mat[2], b.mat[5], b.mat[8]];
                let lowest = shape.extreme(n.map(|x| -x));
                let distance = dot(sub(lowest, p), n);
                let on_second = [0, 1, 2].map(|k| lowest[k] - distance * n[k]);
                let normal = (g.kind == GeomType::Sphere).then_some(n);
                Meeting { distance, on_first: lowest, on_second, normal, ..Meeting::far() }
            }
            GeomType::Hfield | GeomType::Sdf => self.meet_field(g, &shape, h, p, b.mat, limit),
            _ if g.kind == GeomType::Sphere => {
                let Some(f) = self.foot(h, into(b.mat, p.map(|x| -x))) else {
                    return self.meet_convex(&shape, second, p, b.mat, limit);
                };
                let normal = out_of(b.mat, f.normal);
                let at = out_of(b.mat, f.at);
                Meeting {
                    distance: f.distance - g.size[0],
                    on_first: normal.map(|x| -g.size[0] * x),
                    on_second: [0, 1, 2].map(|k| p[k] + at[k]),
                    normal: Some(normal),
                    ..Meeting::far()
                }
            }
            GeomType::Sphere => {
                let Some(f) = self.foot(g, into(a.mat, p)) else {
                    return self.meet_convex(&shape, second, p, b.mat, limit);
                };
                let normal = out_of(a.mat, f.normal);
                Meeting {
                    distance: f.distance - h.size[0],
                    on_first: out_of(a.mat, f.at),
                    on_second: [0, 1, 2].map(|k| p[k] - h.size[0] * normal[k]),
                    normal: Some(normal.map(|x| -x)),
                    ..Meeting::far()
                }
            }
            _ => self.meet_convex(&shape, second, p, b.mat, limit),
        }
    }

    /// Signed distance from a point to a geom where it is less than `limit`, else any number of at least that. 0 inside of what does not
    /// [tell](Self::tells_depth) how deep.
    pub(crate) fn point_distance(&self, id: usize, at: Place, point: [f64; 3], limit: f64) -> f64 {
        let (h, p) = (&self.geoms[id], sub(at.pos, point));
        let met = match h.kind {
            GeomType::Hfield | GeomType::Sdf => {
                let Some(shape) = Convex::new(GeomType::Sphere, [0.0; 3], [0.0; 3], LEVEL, None) else {
                    return f64::INFINITY;
                };
                self.meet_field(&POINT, &shape, h, p, at.mat, limit)
            }
            _ => {
                if let Some(foot) = self.foot(h, into(at.mat, p.map(|x| -x))) {
                    return foot.distance;
                }
                let Some(shape) = Convex::new(GeomType::Sphere, [0.0; 3], [0.0; 3], LEVEL, None) else {
                    return f64::INFINITY;
                };
                self.meet_convex(&shape, id, p, at.mat, limit.max(0.0))
            }
        };
        if met.deep { 0.0 } else { met.distance }
    }

    /// It is known how deep a point is inside a geom.
    pub(crate) fn tells_depth(&self, id: usize) -> bool {
        let g = &self.geoms[id];
        match g.kind {
            GeomType::Hfield => false,
            GeomType::Sdf => g.solid.is_some(),
            GeomType::Mesh => self.hull(g).is_some_and(Hull::has_faces),
            _ => true,
        }
    }

    fn foot(&self, g: &Geom, p: [f64; 3]) -> Option<Foot> {
        foot(g.kind, g.size, self.hull(g), p)
    }

    fn meet_convex(&self, shape: &Convex, second: usize, p: [f64; 3], mat: &[f64; 9], limit: f64) -> Meeting {
        let Some(other) = self.convex(second, p, mat) else { return Meeting::far() };
        Meeting::of_gap(&shape.distance_to(&other, limit))
    }

    /// With a height field: its prisms. With a signed distance field: the triangles of its mesh, or a bounding box.
    fn meet_field(
        &self,
        g: &Geom,
        shape: &Convex,
        h: &Geom,
        p: [f64; 3],
        mat: &[f64; 9],
        limit: f64,
    ) -> Meeting {
        // The shape in the frame of the field.
        let centre = into(mat, p.map(|x| -x));
        let mut turned = [0.0; 9];
        for i in 0..3 {
            for j in 0..3 {
                let r = &shape.rot;
                turned[3 * i + j] = mat[i] * r[j] + mat[3 + i] * r[3 + j] + mat[6 + i] * r[6 + j];
            }
        }
        let mut local = shape.clone();
        (local.pos, local.rot) = (centre, turned);
        // What overlaps has a gap of zero, which must be found however deep the best so far is.
        let mut best = Gap::none(limit.max(0.0) + TOUCH_M);
        let reach = |best: &Gap| best.distance.max(0.0) + g.radius;
        let start = reach(&best);
        let nearer = |best: &mut Gap, points: &[[f64; 3]]| {
            let gap = local.distance_to(&Points(points), best.distance);
            if gap.distance < best.distance {
                *best = gap;
            }
            reach(best)
        };
        match (h.kind, h.solid.and_then(|s| self.surfaces.get(s as usize))) {
            (GeomType::Hfield, _) => match self.hfields.get(h.asset as usize).filter(|_| !h.foreign) {
                Some(field) => field.near(centre, start, |prism| nearer(&mut best, prism)),
                None => return Meeting::far(),
            },
            (_, Some(surface)) => {
                surface.mesh.near(centre, start, |triangle| nearer(&mut best, triangle));
                if best.overlap {
                    // The shell of the mesh is crossed.
                } else if best.distance > 0.0 && h.holds(centre) && surface.winding_number(centre) > 0.5 {
                    // Wholly inside: as deep as it is far from the surface, be that farther than the best so far.
                    best = Gap::none(2.0 * (h.radius + g.radius));
                    surface.mesh.near(centre, reach(&best), |triangle| nearer(&mut best, triangle));
                    let core =
                        if matches!(g.kind, GeomType::Sphere | GeomType::Capsule) { g.size[0] } else { 0.0 };
                    best.distance = -best.distance - 2.0 * core;
                }
            }
            _ => {
                // Without triangles the bounding box is a lower bound.
                let distance = h.box_distance(centre) - g.radius;
                return Meeting { distance: distance.min(limit), bound: true, ..Meeting::far() };
            }
        }
        let world = |q: [f64; 3]| {
            let q = out_of(mat, q);
            [0, 1, 2].map(|k| p[k] + q[k])
        };
        (best.on_shape, best.on_points) = (world(best.on_shape), world(best.on_points));
        Meeting::of_gap(&best)
    }
}

const LEVEL: [f64; 9] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];

/// A ball without size.
const POINT: Geom = Geom {
    kind: GeomType::Sphere,
    collides: true,
    opaque: false,
    foreign: false,
    group: 0,
    asset: 0,
    solid: None,
    body: 0,
    drone: None,
    size: [0.0; 3],
    round: Round::POINT,
    aabb: [0.0; 6],
    radius: 0.0,
    margin: 0.0,
};

/// Gaps below this count as touching where a search begins, m.
const TOUCH_M: f64 = 1e-6;

impl Surface {
    /// How often a closed mesh winds around a point: 1 inside, 0 outside (van Oosterom and Strackee, "The solid angle of a
    /// plane triangle", IEEE Trans. Biomed. Eng. 30(2), 1983).
    fn winding_number(&self, point: [f64; 3]) -> f64 {
        let mut sum = 0.0;
        for corners in &self.triangles {
            let [a, b, c] = corners.map(|v| sub(v, point));
            let (la, lb, lc) = (dot(a, a).sqrt(), dot(b, b).sqrt(), dot(c, c).sqrt());
            let down = la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb;
            sum += 2.0 * dot(a, cross(b, c)).atan2(down);
        }
        sum / (4.0 * std::f64::consts::PI)
    }
}
