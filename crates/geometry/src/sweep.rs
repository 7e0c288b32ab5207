//! What a drone touches first on its way between two poses. A fast drone cannot tunnel through a thin wall.
//!
//! Conservative advancement (Mirtich, "Impulse-based dynamic simulation of rigid body systems", PhD thesis, Berkeley,
//! 1996, section 2.3.2): at each pose between the two, the distance of a pair of geoms bounds from below how far the
//! drone can move before they touch. Between convex shapes the plane between the closest points bounds it by the
//! speed along the normal only, so flight along a wall takes few steps.

use crate::distance::pair::{Meeting, PairDistance, Place};
use crate::kind::GeomType;
use crate::pose::Pose;
use crate::quat;
use crate::query::{NearMemory, Query, lower_bound};
use crate::table::Table;

/// Surfaces nearer than this touch, m (plus twice the tolerance of the table, 1e-6 m by default).
pub const TOUCH_M: f64 = 1e-5;

/// Steps after which a way along a surface, a hair beyond [`TOUCH_M`], counts as a touch.
const MAX_STEPS: usize = 10_000;

/// Where a geom of a drone is in the drone's body frame: position, m, and rotation (row major).
pub type GeomPlace = ([f64; 3], [f64; 9]);

/// The first touch on the way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Touch {
    /// Where on the way, 0 (from) to 1 (to).
    pub fraction: f64,
    /// Pose of the drone there.
    pub pose: Pose,
    /// Geom of the drone.
    pub own: usize,
    /// What it touched.
    pub other: usize,
    /// Touching point, world, m.
    pub point_m: [f64; 3],
    /// Unit normal from the obstacle to the drone; zero where the two penetrated at the start.
    pub normal: [f64; 3],
    /// Signed distance there, m.
    pub distance_m: f64,
    /// False when the touch is reckoned by a lower bound of the distance and may be early.
    pub exact: bool,
}

/// A motion between two poses: positions along a line, rotation about one axis at a constant rate (the shorter way).
#[derive(Clone, Copy, Debug)]
pub struct Way {
    from: Pose,
    to: Pose,
    delta: [f64; 3],
    length: f64,
    /// Rotation vector in the body frame, rad.
    turn: [f64; 3],
    angle: f64,
}

impl Way {
    /// Between two poses with unit quaternions.
    pub fn new(from: Pose, to: Pose) -> Self {
        let delta = [0, 1, 2].map(|k| to.pos_m[k] - from.pos_m[k]);
        let mut q = quat::mul(quat::conjugate(from.quat_xyzw), to.quat_xyzw);
        if q[3] < 0.0 {
            q = q.map(|x| -x);
        }
        let sine = (q[0] * q[0] + q[1] * q[1] + q[2] * q[2]).sqrt();
        let angle = 2.0 * sine.atan2(q[3]);
        let scale = if sine > 1e-12 { angle / sine } else { 2.0 };
        Self {
            from,
            to,
            delta,
            length: delta.iter().map(|x| x * x).sum::<f64>().sqrt(),
            turn: [q[0] * scale, q[1] * scale, q[2] * scale],
            angle,
        }
    }

    fn at(&self, s: f64) -> Pose {
        let turned = quat::exp(self.turn.map(|x| x * s));
        Pose {
            pos_m: [0, 1, 2].map(|k| self.from.pos_m[k] + s * self.delta[k]),
            quat_xyzw: quat::normalize(quat::mul(self.from.quat_xyzw, turned)),
        }
    }

    /// A point and a distance from it, m, beyond which a drone of this radius (m) never touches anything: the middle of the way, and half
    /// the way plus the drone.
    pub fn reach(&self, table: &Table, radius_m: f64) -> ([f64; 3], f64) {
        let middle = [0, 1, 2].map(|k| 0.5 * (self.from.pos_m[k] + self.to.pos_m[k]));
        (middle, 0.5 * self.length + radius_m + 2.0 * touch_m(table))
    }
}

/// Signed distance that counts as a touch, m.
pub fn touch_m(table: &Table) -> f64 {
    TOUCH_M + 2.0 * table.tolerance
}

impl Query<'_> {
    /// First touch of a drone on its way with what belongs not to it, without the geoms of which `leave` says so. `near` is a buffer;
    /// `places` are those of the drone's geoms, in the order of the table.
    ///
    /// # Panics
    /// For a drone that the table does not hold, and for fewer places than it has geoms.
    pub fn sweep(
        &self,
        memory: &NearMemory,
        drone: usize,
        way: &Way,
        places: &[GeomPlace],
        near: &mut Vec<(f64, usize)>,
        leave: &dyn Fn(usize) -> bool,
    ) -> Option<Touch> {
        let (middle, reach) = way.reach(self.table, self.table.drones[drone].radius_m);
        near.clear();
        self.within(memory, drone, middle, reach, near);
        let measure = |pose: &Pose, number: usize, own, other, limit| {
            Ok::<_, std::convert::Infallible>(self.distance_at(pose, &places[number], own, other, limit))
        };
        match first_touch(self.table, drone, way, near, leave, places, measure) {
            Ok(touch) => touch,
            Err(never) => match never {},
        }
    }

    /// Signed distance of two geoms below `limit`, the first at its place in a drone at a pose of the drone.
    fn distance_at(
        &self,
        pose: &Pose,
        (local, turned): &GeomPlace,
        own: usize,
        other: usize,
        limit: f64,
    ) -> PairDistance {
        let r = quat::matrix(pose.quat_xyzw);
        let mut pos = pose.pos_m;
        let mut mat = [0.0; 9];
        for i in 0..3 {
            for k in 0..3 {
                pos[i] += r[i][k] * local[k];
            }
            for j in 0..3 {
                mat[3 * i + j] = r[i][0] * turned[j] + r[i][1] * turned[3 + j] + r[i][2] * turned[6 + j];
            }
        }
        let bound =
            lower_bound(&self.table.geoms[other], self.place(other), pos, self.table.geoms[own].radius);
        let m = if bound >= limit {
            Meeting { distance: bound, ..Meeting::far() }
        } else {
            self.table.meet(own, Place { pos, mat: &mat }, other, self.place(other), limit)
        };
        let out = |p: [f64; 3]| [0, 1, 2].map(|k| p[k] + pos[k]);
        PairDistance {
            distance_m: m.distance.min(limit),
            on_drone_m: out(m.on_first),
            on_other_m: out(m.on_second),
            exact: !m.bound,
        }
    }
}

/// First touch with the geoms `near` (sorted here), without those of which `leave` says so, by a `measure` of the distance of two geoms
/// below a limit: at a pose of the drone, for its geom of that number.
///
/// # Errors
/// Those of `measure`.
pub fn first_touch<E>(
    table: &Table,
    drone: usize,
    way: &Way,
    near: &mut [(f64, usize)],
    leave: &dyn Fn(usize) -> bool,
    places: &[GeomPlace],
    mut measure: impl FnMut(&Pose, usize, usize, usize, f64) -> Result<PairDistance, E>,
) -> Result<Option<Touch>, E> {
    near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut best: Option<Touch> = None;
    for &(_, other) in near.iter().filter(|(_, other)| !leave(*other)) {
        for (n, &own) in table.drones[drone].geoms.iter().enumerate() {
            let g = &table.geoms[own];
            if !g.collides {
                continue;
            }
            let offset = places[n].0.iter().map(|x| x * x).sum::<f64>().sqrt();
            let arm = offset + g.radius;
            let end = best.map_or(1.0, |b| b.fraction);
            let gap = |pose: &Pose, limit: f64| measure(pose, n, own, other, limit);
            if let Some(touch) = touch_of_pair(table, way, own, other, arm, end, gap)? {
                let earlier = best.is_none_or(|b| touch.fraction < b.fraction);
                if earlier {
                    best = Some(touch);
                }
            }
        }
    }
    Ok(best)
}

/// First touch of one pair before `end`. No point of the drone's geom is farther from the drone's place than `arm`.
fn touch_of_pair<E>(
    table: &Table,
    way: &Way,
    own: usize,
    other: usize,
    arm: f64,
    end: f64,
    mut measure: impl FnMut(&Pose, f64) -> Result<PairDistance, E>,
) -> Result<Option<Touch>, E> {
    let convex = is_convex(table.geoms[own].kind) && is_convex(table.geoms[other].kind);
    let fastest = way.length + way.angle * arm;
    let tolerance = table.tolerance;
    let touch = touch_m(table);
    let mut s = 0.0;
    for step in 0..MAX_STEPS {
        let pose = way.at(s);
        let horizon = fastest * (end - s) + 2.0 * touch;
        let pair = measure(&pose, horizon)?;
        let gap = pair.distance_m;
        if gap >= horizon {
            return Ok(None);
        }
        let apart = [0, 1, 2].map(|k| pair.on_drone_m[k] - pair.on_other_m[k]);
        let size = apart.iter().map(|x| x * x).sum::<f64>().sqrt();
        if gap <= touch || step + 1 == MAX_STEPS {
            let normal = if size > 0.0 && gap > 0.0 { apart.map(|x| x / size) } else { [0.0; 3] };
            return Ok(Some(Touch {
                fraction: s,
                pose,
                own,
                other,
                point_m: [0, 1, 2].map(|k| 0.5 * (pair.on_drone_m[k] + pair.on_other_m[k])),
                normal,
                distance_m: gap,
                exact: pair.exact,
            }));
        }
        let closing = if convex && pair.exact && size > 0.0 {
            let along = (0..3).map(|k| apart[k] * way.delta[k]).sum::<f64>() / size;
            // Closest points are known to the tolerance, the normal to the tolerance over the gap.
            (-along).max(0.0) + way.length * (2.0 * tolerance / size).min(1.0) + way.angle * arm
        } else {
            fastest
        };
        // Stop half a touch short, so that neither rounding nor tolerance steps over the surface.
        let free = gap - tolerance - 0.5 * TOUCH_M;
        if closing * (end - s) <= free {
            return Ok(None);
        }
        s += free / closing;
    }
    Ok(None)
}

fn is_convex(kind: GeomType) -> bool {
    !matches!(kind, GeomType::Hfield | GeomType::Sdf)
}
