//! Contacts of drones with the scene and with each other.
//!
//! [`Collider::Native`] finds what touches and computes contacts in which a ball takes part; of other pairs that touch it
//! takes the contact points from MuJoCo's function for that pair. [`Collider::MuJoCo`] runs `mj_collision` over the scene.
//! A mesh collides as its convex hull, a plane as a whole half space.
//!
//! Limits that are MuJoCo's own (3.17.0): it reports at most [`MAX_PER_PAIR`] contacts for one pair of geoms. Convex
//! shapes stay far below; a large shape on a fine height field reaches it, and then which contacts are missing, and
//! whether the deepest is among them, is up to MuJoCo: [`Queries::contacts`](super::Queries::contacts) returns how many pairs did. The number of pairs has
//! no limit but memory: when the arena of a worker is full `mj_collision` fails instead of finding fewer
//! ([`SceneError::ContactsLost`](crate::scene::SceneError::ContactsLost)).

use serde::Serialize;

use super::SenseError;
use super::collide::Collider;
use crate::geometry::Query;
use crate::scene::{MAX_PAIR_CONTACTS, PairContacts, RawContact, Scene, Worker};

/// Most contacts that MuJoCo reports for one pair of geoms (mjMAXCONPAIR).
pub const MAX_PER_PAIR: usize = MAX_PAIR_CONTACTS;

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

/// Finds all contacts of drones at the worker's poses; see [`Queries::contacts`](super::Queries::contacts).
pub(super) fn contacts(
    collider: Collider,
    worker: &mut Worker,
    out: &mut Vec<Contact>,
) -> Result<usize, SenseError> {
    out.clear();
    if collider.is_native(worker)? {
        let scene = worker.scene().clone();
        return contacts_native(worker, &scene, out);
    }
    let count = worker.collide()?;
    let scene = worker.scene();
    let (mut limited, mut run, mut pair) = (0, 0, [-1; 2]);
    for index in 0..count {
        let Some(raw) = worker.contact(index) else { break };
        let Some(contact) = of_drone(scene, &raw) else { continue };
        run = if raw.geom == pair { run + 1 } else { 1 };
        pair = raw.geom;
        limited += usize::from(run == MAX_PER_PAIR);
        out.push(contact);
    }
    Ok(limited)
}

fn contacts_native(worker: &mut Worker, scene: &Scene, out: &mut Vec<Contact>) -> Result<usize, SenseError> {
    let (table, poses, memory) = worker.geometry()?;
    let memory = &mut memory.near;
    let query = Query::new(table, poses, memory);
    memory.touches.clear();
    for drone in 0..scene.n_drones() {
        query.touching(memory, drone);
    }
    memory.touches.sort_unstable_by_key(|t| (t.drone, t.own, t.other));
    let n_touches = memory.touches.len();
    if n_touches == 0 {
        // The buffer below is large.
        return Ok(0);
    }
    let mut limited = 0;
    let mut found = PairContacts::default();
    for k in 0..n_touches {
        let (table, _, memory) = worker.geometry()?;
        let t = memory.near.touches[k];
        if let Some(met) = &t.ball {
            // From the first to the second.
            let raw = RawContact {
                geom: [t.own as i32, t.other as i32],
                flex: [-1; 2],
                distance_m: met.distance,
                point_m: [0, 1, 2].map(|k| 0.5 * (met.on_first[k] + met.on_second[k])),
                normal: met.normal.unwrap_or_default().map(|x| -x),
            };
            out.extend(of_drone(scene, &raw));
            continue;
        }
        let margin = table.geoms()[t.own].margin + table.geoms()[t.other].margin;
        worker.collide_pair(t.own, t.other, margin, &mut found)?;
        limited += usize::from(found.len() == MAX_PER_PAIR);
        out.extend(found.iter().filter_map(|raw| of_drone(scene, &raw)));
    }
    Ok(limited)
}

/// The contact as one of a drone, if it is one.
fn of_drone(scene: &Scene, raw: &RawContact) -> Option<Contact> {
    let geom = |id: i32| usize::try_from(id).ok().and_then(|g| scene.geoms().get(g));
    let sides = raw.geom.map(|g| geom(g).and_then(|g| g.drone));
    let side = match sides {
        [None, None] => return None,
        [Some(a), Some(b)] if a == b => return None,
        [Some(a), Some(b)] => usize::from(b < a),
        [Some(_), None] => 0,
        [None, Some(_)] => 1,
    };
    let other = 1 - side;
    let body = |id: i32| geom(id).map_or(-1, |g| g.body_id as i32);
    let sign = if side == 1 { 1.0 } else { -1.0 };
    Some(Contact {
        drone: sides[side]?,
        other_drone: sides[other],
        drone_geom: raw.geom[side],
        drone_body: body(raw.geom[side]),
        other_geom: raw.geom[other],
        other_body: body(raw.geom[other]),
        other_flex: raw.flex[other],
        distance_m: raw.distance_m,
        point_m: raw.point_m,
        normal: raw.normal.map(|x| sign * x),
    })
}
