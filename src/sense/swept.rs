//! Swept check: does a drone touch anything between two poses? A fast drone cannot tunnel through a thin wall.
//!
//! How: [`geometry::sweep`](crate::geometry::sweep).

use serde::Serialize;

use super::SenseError;
use super::clearance::{box_distance, pair_distance};
use super::collide::Collider;
use crate::geometry::Query;
pub use crate::geometry::sweep::TOUCH_M;
use crate::geometry::sweep::{GeomPlace, Touch, Way, first_touch};
use crate::math::vec3;
use crate::scene::{Pose, Scene, SceneError, Worker, checked_pose};

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

impl SweptHit {
    fn of(touch: &Touch, scene: &Scene) -> Self {
        let other = &scene.geoms()[touch.other];
        Self {
            fraction: touch.fraction,
            pos_m: touch.pose.pos_m,
            quat_xyzw: touch.pose.quat_xyzw,
            drone_geom: touch.own as i32,
            other_geom: touch.other as i32,
            other_body: other.body_id as i32,
            other_drone: other.drone,
            point_m: touch.point_m,
            normal: touch.normal,
            distance_m: touch.distance_m,
            exact: touch.exact,
        }
    }
}

/// A motion of a drone whose first touch is looked for, from one pose to another: positions along a line, rotation about one axis at a
/// constant rate (the shorter way). All else stays where the worker has it: with moving obstacles sweep against their poses at the end of
/// the step; [`Sweep::of_drone`] is for two drones.
#[derive(Clone, Copy, Debug)]
pub struct Sweep<'a> {
    drone: usize,
    from: Pose,
    to: Pose,
    against: Against,
    ignored: &'a [i32],
}

/// What a sweep looks for.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Against {
    All,
    /// What belongs to no drone.
    Scene,
    /// A drone that comes from a pose.
    Drone(usize, Pose),
}

impl<'a> Sweep<'a> {
    /// Against everything but the drone itself.
    pub fn new(drone: usize, from: Pose, to: Pose) -> Self {
        Self { drone, from, to, against: Against::All, ignored: &[] }
    }

    /// Against what belongs to no drone.
    #[must_use]
    pub fn of_scene(self) -> Self {
        Self { against: Against::Scene, ..self }
    }

    /// Against one drone that moves too, from a pose at the same time to where the worker has it. Exact for positions along lines; the
    /// other's rotation counts as done at the start, which for a part of it at radius r shifts the touch by less than r times the
    /// angle. Position, point and fraction are those of the touch.
    #[must_use]
    pub fn of_drone(self, other: usize, other_from: Pose) -> Self {
        Self { against: Against::Drone(other, other_from), ..self }
    }

    /// As if these geoms were not there: asked again with what was found, it finds what comes next.
    #[must_use]
    pub fn without(self, ignored: &'a [i32]) -> Self {
        Self { ignored, ..self }
    }
}

/// First touch of a drone on its way; see [`Queries::swept`](super::Queries::swept).
pub(super) fn swept(
    collider: Collider,
    worker: &mut Worker,
    sweep: &Sweep,
) -> Result<Option<SweptHit>, SenseError> {
    let Sweep { drone, from, to, against, ignored } = *sweep;
    let scene = worker.scene().clone();
    let ignores = |g: usize| ignored.contains(&(g as i32));
    match against {
        Against::All => swept_without(collider, worker, drone, from, to, &ignores),
        Against::Scene => {
            let leave = |g: usize| scene.geoms()[g].drone.is_some() || ignores(g);
            swept_without(collider, worker, drone, from, to, &leave)
        }
        Against::Drone(other, other_from) => {
            let leave = |g: usize| scene.geoms()[g].drone != Some(other) || ignores(g);
            swept_pair(collider, worker, drone, from, to, other, other_from, &leave)
        }
    }
}

/// First touch of two drones that move both.
fn swept_pair(
    collider: Collider,
    worker: &mut Worker,
    drone: usize,
    from: Pose,
    to: Pose,
    other: usize,
    other_from: Pose,
    leave: &dyn Fn(usize) -> bool,
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
    let hit = swept_without(collider, worker, drone, seen, to, leave)?;
    Ok(hit.map(|mut hit| {
        let back = vec3::scale(shift, 1.0 - hit.fraction);
        hit.pos_m = vec3::sub(hit.pos_m, back);
        hit.point_m = vec3::sub(hit.point_m, back);
        hit
    }))
}

/// First touch without the geoms of which `leave` says so.
fn swept_without(
    collider: Collider,
    worker: &mut Worker,
    drone: usize,
    from: Pose,
    to: Pose,
    leave: &dyn Fn(usize) -> bool,
) -> Result<Option<SweptHit>, SenseError> {
    let scene = worker.scene().clone();
    let native = collider.is_native(worker)?;
    scene.drone_body(drone)?;
    let who = || format!("drone {drone} in a swept check");
    let from = checked_pose(who, from.pos_m, from.quat_xyzw)?;
    let to = checked_pose(who, to.pos_m, to.quat_xyzw)?;
    let way = Way::new(from, to);
    let mut near = std::mem::take(&mut worker.scratch.bounds);
    let mut places = std::mem::take(&mut worker.scratch.places);
    let result = if native {
        swept_native(worker, &scene, drone, &way, &mut near, leave, &mut places)
    } else {
        swept_mujoco(worker, &scene, drone, &way, &mut near, leave, &mut places)
    };
    worker.scratch.bounds = near;
    worker.scratch.places = places;
    result
}

fn swept_native(
    worker: &mut Worker,
    scene: &Scene,
    drone: usize,
    way: &Way,
    near: &mut Vec<(f64, usize)>,
    leave: &dyn Fn(usize) -> bool,
    places: &mut Vec<GeomPlace>,
) -> Result<Option<SweptHit>, SenseError> {
    worker.drone_geom_places(drone, places)?;
    let (table, poses, memory) = worker.geometry()?;
    let query = Query::new(table, poses, &mut memory.near);
    let hit = query.sweep(&memory.near, drone, way, places, near, leave);
    match hit.map(|touch| SweptHit::of(&touch, scene)) {
        // How deep they overlap only MuJoCo says.
        Some(hit) if hit.distance_m <= 0.0 => deepened(worker, scene, drone, hit, places).map(Some),
        other => Ok(other),
    }
}

fn swept_mujoco(
    worker: &mut Worker,
    scene: &Scene,
    drone: usize,
    way: &Way,
    near: &mut Vec<(f64, usize)>,
    leave: &dyn Fn(usize) -> bool,
    places: &mut Vec<GeomPlace>,
) -> Result<Option<SweptHit>, SenseError> {
    // Whatever is farther from the middle of the way than half the way plus the drone is never reached.
    let (middle, reach) = way.reach(worker.table()?, scene.drone_radius_m(drone)?);
    worker.drone_geom_places(drone, places)?;
    near.clear();
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
    // As the scene lends it, since the closure below moves the worker's geoms; it was made above.
    let table = scene.table().ok_or(SceneError::Stale { asked: "a swept check" })?;
    let measure = |pose: &Pose, _: usize, own, other, limit| {
        worker.move_drone_geoms(drone, pose, places)?;
        pair_distance(worker, scene, own, other, limit)
    };
    let result = first_touch(table, drone, way, near, leave, places, measure);
    // Puts the geoms back.
    let back = worker.update();
    let touch = result?;
    back?;
    Ok(touch.map(|touch| SweptHit::of(&touch, scene)))
}

/// A hit with the depth and the points that MuJoCo finds.
fn deepened(
    worker: &mut Worker,
    scene: &Scene,
    drone: usize,
    mut hit: SweptHit,
    places: &[GeomPlace],
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
