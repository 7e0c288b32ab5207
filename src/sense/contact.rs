//! Contacts of drones with the scene and with each other, by MuJoCo's collision detection.
//!
//! Limits that are MuJoCo's own (3.17.0): it reports at most [`MAX_PER_PAIR`] contacts for one pair of geoms. Convex
//! shapes stay far below; a large shape on a fine height field reaches it, and then which contacts are missing, and
//! whether the deepest is among them, is up to MuJoCo: [`contacts`] returns how many pairs did. The number of pairs has
//! no limit but memory: when a worker's arena is full the call fails instead of returning fewer
//! ([`SceneError::ContactsLost`](crate::scene::SceneError::ContactsLost)). A mesh collides as its convex hull, a plane
//! as a whole half space.

use serde::Serialize;

use super::SenseError;
use crate::scene::Worker;

/// Most contacts that MuJoCo reports for one pair of geoms (mjMAXCONPAIR).
pub const MAX_PER_PAIR: usize = 50;

/// One contact of a drone.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Contact {
    /// The drone; of two drones the one with the lower number.
    pub drone: usize,
    /// The other drone, if the contact is between two.
    pub other_drone: Option<usize>,
    /// Geom of the drone.
    pub drone_geom: i32,
    /// Body of the drone.
    pub drone_body: i32,
    /// What it touches; -1 for a flex.
    pub other_geom: i32,
    /// Body of what it touches; -1 for a flex.
    pub other_body: i32,
    /// The flex that it touches; -1 for a geom.
    pub other_flex: i32,
    /// Signed distance, m: negative in penetration; positive only within a contact margin that the scene sets.
    pub distance_m: f64,
    /// Midpoint between the two surfaces, world, m.
    pub point_m: [f64; 3],
    /// Unit normal, world, from the obstacle (or the other drone) to the drone.
    pub normal: [f64; 3],
}

impl Contact {
    /// Whether the drone takes part, on either side.
    pub fn involves(&self, drone: usize) -> bool {
        self.drone == drone || self.other_drone == Some(drone)
    }

    /// Whether the surfaces touch or penetrate (distance ≤ 0), not only come within a margin.
    pub fn touches(&self) -> bool {
        self.distance_m <= 0.0
    }
}

/// Finds all contacts of drones at the worker's poses, in MuJoCo's order, into `out` (cleared first).
///
/// Contacts of a drone with itself and of scene geoms with each other are left out. Returns the number of pairs of geoms
/// that reached [`MAX_PER_PAIR`]: 0 means that no contact is missing.
///
/// # Errors
/// [`SenseError::Scene`] when contacts would be lost for want of memory, or MuJoCo fails.
pub fn contacts(worker: &mut Worker, out: &mut Vec<Contact>) -> Result<usize, SenseError> {
    out.clear();
    let count = worker.collide()?;
    let scene = worker.scene();
    let geoms = scene.geoms();
    let drone_of = |geom: i32| usize::try_from(geom).ok().and_then(|g| geoms.get(g)).and_then(|g| g.drone);
    let body_of =
        |geom: i32| usize::try_from(geom).ok().and_then(|g| geoms.get(g)).map_or(-1, |g| g.body_id as i32);
    let (mut limited, mut run, mut pair) = (0, 0, [-1; 2]);
    for index in 0..count {
        let Some(raw) = worker.contact(index) else { break };
        let sides = [drone_of(raw.geom[0]), drone_of(raw.geom[1])];
        let side = match sides {
            [None, None] => continue,
            [Some(a), Some(b)] if a == b => continue,
            [Some(a), Some(b)] => usize::from(b < a),
            [Some(_), None] => 0,
            [None, Some(_)] => 1,
        };
        let Some(drone) = sides[side] else { continue };
        let other = 1 - side;
        let sign = if side == 1 { 1.0 } else { -1.0 };
        run = if raw.geom == pair { run + 1 } else { 1 };
        pair = raw.geom;
        limited += usize::from(run == MAX_PER_PAIR);
        out.push(Contact {
            drone,
            other_drone: sides[other],
            drone_geom: raw.geom[side],
            drone_body: body_of(raw.geom[side]),
            other_geom: raw.geom[other],
            other_body: body_of(raw.geom[other]),
            other_flex: raw.flex[other],
            distance_m: raw.distance_m,
            point_m: raw.point_m,
            normal: raw.normal.map(|x| sign * x),
        });
    }
    Ok(limited)
}
