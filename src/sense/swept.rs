//! Swept check: does a drone touch anything between two poses? A fast drone cannot tunnel through a thin wall.
//!
//! Conservative advancement (Mirtich, "Impulse-based dynamic simulation of rigid body systems", PhD thesis, Berkeley,
//! 1996, section 2.3.2): at each pose between the two, the distance of a pair of geoms bounds from below how far the
//! drone can move before they touch. Between convex shapes the plane between the closest points bounds it by the
//! speed along the normal only, so flight along a wall takes few steps.

use serde::Serialize;

use super::SenseError;
use super::caster::world::World;
use super::clearance::{PairDistance, box_distance, pair_distance};
use super::collide::{Collider, Finder, Movers};
use crate::math::{quat, vec3};
use crate::scene::{GeomType, Pose, Scene, Worker, checked_pose};

/// The first touch on the way.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SweptHit {
    /// Where on the way, 0 (from) to 1 (to); 0 when the drone touched at the start.
    pub fraction: f64,
    /// Position of the drone there, m.
    pub pos_m: [f64; 3],
    /// Orientation of the drone there, x y z w.
    pub quat_xyzw: [f64; 4],
    /// Geom of the drone.
    pub drone_geom: i32,
    /// What it touched.
    pub other_geom: i32,
    /// Its body.
    pub other_body: i32,
    /// The drone that it belongs to.
    pub other_drone: Option<usize>,
    /// Touching point, world, m.
    pub point_m: [f64; 3],
    /// Unit normal from the obstacle to the drone; zero where the two penetrated at the start.
    pub normal: [f64; 3],
    /// Signed distance there, m: about [`TOUCH_M`], or less when the drone touched at the start.
    pub distance_m: f64,
    /// False when the touch is reckoned by a lower bound of the distance (signed distance fields) and may be early.
    pub exact: bool,
}

/// Surfaces nearer than this touch, m (plus twice the scene's `ccd_tolerance`, 1e-6 m by default).
pub const TOUCH_M: f64 = 1e-5;

/// Steps after which a way along a surface, a hair beyond [`TOUCH_M`], counts as a touch.
const MAX_STEPS: usize = 10_000;

/// First touch of a drone that moves from one pose to another, positions along a line, rotation about one axis at a
/// constant rate (the shorter way). All else stays where the worker has it: with moving obstacles sweep against their poses at the
/// end of the step; [`swept_pair`] is for two drones.
///
/// The worker's own poses are left as they were.
///
/// # Errors
/// [`SenseError::Scene`] for an unknown drone, bad poses, or a failure of MuJoCo.
pub fn swept(
    worker: &mut Worker,
    drone: usize,
    from: Pose,
    to: Pose,
) -> Result<Option<SweptHit>, SenseError> {
    swept_by(Collider::default(), worker, drone, from, to, &[])
}

/// As [`swept`], of what belongs to no drone, as if the geoms `ignored` were not there: asked again with what was found, it finds what
/// comes next.
///
/// # Errors
/// As [`swept`].
pub fn swept_scene(
    worker: &mut Worker,
    drone: usize,
    from: Pose,
    to: Pose,
    ignored: &[i32],
) -> Result<Option<SweptHit>, SenseError> {
    let scene = worker.scene().clone();
    let leave = |g: usize| scene.geoms()[g].drone.is_some() || ignored.contains(&(g as i32));
    swept_without(Collider::default(), worker, drone, from, to, &leave)
}

/// First touch of two drones that move both, from poses at the same time to poses at the same time; `to` of the other is where the
/// worker has it. Exact for positions along lines; the other's rotation counts as done at the start, which for a part of it at
/// radius r shifts the touch by less than r times the angle. Position, point and fraction are those of the touch.
///
/// # Errors
/// As [`swept`].
pub fn swept_pair(
    worker: &mut Worker,
    drone: usize,
    from: Pose,
    to: Pose,
    other: usize,
    other_from: Pose,
) -> Result<Option<SweptHit>, SenseError> {
    let scene = worker.scene().clone();
    let other_to = worker.drone_pose(other)?;
    let who = || format!("drone {other} in a swept check");
    let other_from = checked_pose(who, other_from.pos_m, other_from.quat_xyzw)?;
    // Seen from the other, which then stands still.
    let shift = vec3::sub(other_to.pos_m, other_from.pos_m);
    let seen = Pose { pos_m: vec3::add(from.pos_m, shift), ..from };
    let (way, start) = (vec3::sub(to.pos_m, seen.pos_m), vec3::sub(seen.pos_m, other_to.pos_m));
    let square = vec3::dot(way, way);
    let nearest = if square > 0.0 { (-vec3::dot(start, way) / square).clamp(0.0, 1.0) } else { 0.0 };
    let apart = vec3::norm(vec3::add(start, vec3::scale(way, nearest)));
    let touch = TOUCH_M + 2.0 * scene.ccd_tolerance();
    if apart > scene.drone_radius_m(drone)? + scene.drone_radius_m(other)? + 2.0 * touch {
        return Ok(None);
    }
    let leave = |g: usize| scene.geoms()[g].drone != Some(other);
    let hit = swept_without(Collider::default(), worker, drone, seen, to, &leave)?;
    Ok(hit.map(|mut hit| {
        let back = vec3::scale(shift, 1.0 - hit.fraction);
        hit.pos_m = vec3::sub(hit.pos_m, back);
        hit.point_m = vec3::sub(hit.point_m, back);
        hit
    }))
}

/// As [`swept`], by either collider, as if the geoms `ignored` were not there.
///
/// # Errors
/// As [`swept`].
pub fn swept_by(
    collider: Collider,
    worker: &mut Worker,
    drone: usize,
    from: Pose,
    to: Pose,
    ignored: &[i32],
) -> Result<Option<SweptHit>, SenseError> {
    swept_without(collider, worker, drone, from, to, &|g| ignored.contains(&(g as i32)))
}

/// The same without the geoms of which `leave` says so.
fn swept_without(
    collider: Collider,
    worker: &mut Worker,
    drone: usize,
    from: Pose,
    to: Pose,
    leave: &dyn Fn(usize) -> bool,
) -> Result<Option<SweptHit>, SenseError> {
    let scene = worker.scene().clone();
    let world = World::of(worker)?;
    scene.drone_body(drone)?;
    let who = || format!("drone {drone} in a swept check");
    let from = checked_pose(who, from.pos_m, from.quat_xyzw)?;
    let to = checked_pose(who, to.pos_m, to.quat_xyzw)?;
    let way = Way::new(from, to);
    let radius = scene.drone_radius_m(drone)?;

    // Whatever is farther from the middle of the way than half the way plus the drone is never reached.
    let middle = [0, 1, 2].map(|k| 0.5 * (from.pos_m[k] + to.pos_m[k]));
    let touch = TOUCH_M + 2.0 * scene.ccd_tolerance();
    let reach = 0.5 * way.length + radius + 2.0 * touch;
    let mut near = std::mem::take(&mut worker.scratch.bounds);
    let mut places = std::mem::take(&mut worker.scratch.places);
    near.clear();
    let result = if collider == Collider::Native && world.solids.alone.is_none() {
        let mut movers = Movers::take(worker);
        let result = Finder::new(&scene, &world, worker, &mut movers).map_err(SenseError::from);
        let result = result.and_then(|finder| {
            worker.drone_geom_places(drone, &mut places)?;
            finder.within(&movers, drone, middle, reach, &mut near)?;
            let measure = |pose: &Pose, number: usize, own, other, limit| {
                let (local, turned) = &places[number];
                Ok(finder.distance_at(pose, local, turned, own, other, limit))
            };
            first_touch(&scene, drone, &way, &mut near, leave, &places, measure)
        });
        movers.put(worker);
        match result {
            // How deep they overlap only MuJoCo says.
            Ok(Some(hit)) if hit.distance_m <= 0.0 => deepened(worker, &scene, drone, hit, &places).map(Some),
            other => other,
        }
    } else {
        swept_mujoco(worker, &scene, drone, &way, middle, reach, &mut near, leave, &mut places)
    };
    worker.scratch.bounds = near;
    worker.scratch.places = places;
    result
}

fn swept_mujoco(
    worker: &mut Worker,
    scene: &Scene,
    drone: usize,
    way: &Way,
    middle: [f64; 3],
    reach: f64,
    near: &mut Vec<(f64, usize)>,
    leave: &dyn Fn(usize) -> bool,
    places: &mut Vec<([f64; 3], [f64; 9])>,
) -> Result<Option<SweptHit>, SenseError> {
    worker.drone_geom_places(drone, places)?;
    for geom in scene.geoms() {
        if geom.drone == Some(drone) || !geom.can_collide() {
            continue;
        }
        let d = box_distance(worker, scene, geom.id, middle)?;
        if d < reach {
            near.push((d, geom.id));
        }
    }
    if near.is_empty() {
        return Ok(None);
    }
    let measure = |pose: &Pose, _: usize, own, other, limit| {
        worker.move_drone_geoms(drone, pose, places)?;
        pair_distance(worker, scene, own, other, limit)
    };
    let result = first_touch(scene, drone, way, near, leave, places, measure);
    // Puts the geoms back.
    let back = worker.update();
    let hit = result?;
    back?;
    Ok(hit)
}

/// A hit with the depth and the points that MuJoCo finds.
fn deepened(
    worker: &mut Worker,
    scene: &Scene,
    drone: usize,
    mut hit: SweptHit,
    places: &[([f64; 3], [f64; 9])],
) -> Result<SweptHit, SenseError> {
    let pose = Pose { pos_m: hit.pos_m, quat_xyzw: hit.quat_xyzw };
    let (Ok(own), Ok(other)) = (usize::try_from(hit.drone_geom), usize::try_from(hit.other_geom)) else {
        return Ok(hit);
    };
    worker.move_drone_geoms(drone, &pose, places)?;
    let pair = pair_distance(worker, scene, own, other, 1.0);
    worker.update()?;
    let pair = pair?;
    hit.distance_m = pair.distance_m;
    hit.point_m = [0, 1, 2].map(|k| 0.5 * (pair.on_drone_m[k] + pair.on_other_m[k]));
    Ok(hit)
}

/// A motion between two poses.
struct Way {
    from: Pose,
    delta: [f64; 3],
    length: f64,
    /// Rotation vector in the body frame, rad.
    turn: [f64; 3],
    angle: f64,
}

impl Way {
    fn new(from: Pose, to: Pose) -> Self {
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
}

fn is_convex(kind: GeomType) -> bool {
    !matches!(kind, GeomType::Hfield | GeomType::Sdf)
}

/// First touch with the geoms `near` (sorted here), by a `measure` of the distance of two geoms below a limit: at a pose of
/// the drone, for its geom of that number.
fn first_touch(
    scene: &Scene,
    drone: usize,
    way: &Way,
    near: &mut [(f64, usize)],
    leave: &dyn Fn(usize) -> bool,
    places: &[([f64; 3], [f64; 9])],
    mut measure: impl FnMut(&Pose, usize, usize, usize, f64) -> Result<PairDistance, SenseError>,
) -> Result<Option<SweptHit>, SenseError> {
    near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut best: Option<SweptHit> = None;
    for &(_, other) in near.iter().filter(|(_, other)| !leave(*other)) {
        for (n, &own) in scene.drone_geoms(drone)?.iter().enumerate() {
            let info = &scene.geoms()[own];
            if !info.can_collide() {
                continue;
            }
            let offset = places[n].0.iter().map(|x| x * x).sum::<f64>().sqrt();
            let arm = offset + info.bounding_radius_m;
            let end = best.map_or(1.0, |b| b.fraction);
            let gap = |pose: &Pose, limit: f64| measure(pose, n, own, other, limit);
            if let Some(hit) = touch_of_pair(scene, way, own, other, arm, end, gap)? {
                let earlier = best.is_none_or(|b| hit.fraction < b.fraction);
                if earlier {
                    best = Some(hit);
                }
            }
        }
    }
    Ok(best)
}

/// First touch of one pair before `end`.
fn touch_of_pair(
    scene: &Scene,
    way: &Way,
    own: usize,
    other: usize,
    arm: f64,
    end: f64,
    mut measure: impl FnMut(&Pose, f64) -> Result<PairDistance, SenseError>,
) -> Result<Option<SweptHit>, SenseError> {
    let convex = is_convex(scene.geoms()[own].kind) && is_convex(scene.geoms()[other].kind);
    let fastest = way.length + way.angle * arm;
    let tolerance = scene.ccd_tolerance();
    let touch = TOUCH_M + 2.0 * tolerance;
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
            return Ok(Some(SweptHit {
                fraction: s,
                pos_m: pose.pos_m,
                quat_xyzw: pose.quat_xyzw,
                drone_geom: own as i32,
                other_geom: other as i32,
                other_body: scene.geoms()[other].body_id as i32,
                other_drone: scene.geoms()[other].drone,
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
