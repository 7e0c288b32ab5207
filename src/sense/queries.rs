//! What is asked of one set of poses: rays, contacts, clearances, sweeps. [`Worlds`](super::Worlds) asks many at once.

use super::SenseError;
use super::caster::{self, RayHits, RayPattern, RayPlanes, RayQuery};
use super::clearance::{self, Clearance};
use super::collide::Collider;
use super::contact::{self, Contact};
use super::swept::{self, Sweep, SweptHit};
use crate::scene::{Pose, Worker};

/// Queries at the poses that a worker holds.
///
/// ```
/// use propwash::prelude::*;
/// use propwash::sense::{Queries, Sweep};
///
/// let scene = Scene::build(&SceneSource::file("xml/forest.xml"), &[Shell::builtin("cf2x")?])?;
/// let mut worker = scene.worker()?;
/// worker.set_drone(0, [0.0, 0.0, 1.5], [0.0, 0.0, 0.0, 1.0])?;
/// worker.update()?;
/// let mut touching = Vec::new();
/// Queries::at(&mut worker).contacts(&mut touching)?;
/// let near = Queries::at(&mut worker).clearance(0, 5.0)?;
/// let from = worker.drone_pose(0)?;
/// let to = Pose { pos_m: [0.0, 0.0, -1.0], ..from };
/// let hit = Queries::at(&mut worker).swept(&Sweep::new(0, from, to))?;
/// assert!(touching.is_empty() && near.distance_m > 0.0 && hit.is_some());
/// # Ok::<(), propwash::Error>(())
/// ```
pub struct Queries<'w> {
    worker: &'w mut Worker,
    collider: Collider,
}

impl<'w> Queries<'w> {
    /// By [`Collider::Native`].
    pub fn at(worker: &'w mut Worker) -> Self {
        Self::by(Collider::default(), worker)
    }

    /// Contacts, clearances and sweeps by either collider. Rays are always native.
    pub fn by(collider: Collider, worker: &'w mut Worker) -> Self {
        Self { worker, collider }
    }

    /// Finds all contacts of drones into `out` (cleared first): in the order of drones, of their geoms, and of what they touch; those of
    /// [`Collider::MuJoCo`] in its order.
    ///
    /// Contacts of a drone with itself and of scene geoms with each other are left out. Returns the number of pairs of geoms
    /// that reached [`MAX_PER_PAIR`](super::MAX_PER_PAIR): 0 means that no contact is missing. Nothing is allocated once the worker and
    /// `out` have seen as many contacts.
    ///
    /// # Errors
    /// [`SenseError::Scene`] where the worker was not updated, or MuJoCo fails, and when contacts would be lost for want of memory.
    pub fn contacts(&mut self, out: &mut Vec<Contact>) -> Result<usize, SenseError> {
        contact::contacts(self.collider, self.worker, out)
    }

    /// Distance of a drone to the nearest geom of the scene or of another drone, looking no farther than `max_distance_m`.
    ///
    /// Only geoms that can collide count (contype or conaffinity not 0), on both sides. Nothing is allocated once the worker
    /// has seen as many geoms near a drone.
    ///
    /// # Errors
    /// [`SenseError::Scene`] for an unknown drone, a worker that was not updated, or a failure of MuJoCo;
    /// [`SenseError::Parameter`] for a maximum that is not positive and finite.
    pub fn clearance(&mut self, drone: usize, max_distance_m: f64) -> Result<Clearance, SenseError> {
        clearance::clearance(self.collider, self.worker, drone, max_distance_m)
    }

    /// First touch of a drone on its way between two poses. The worker's own poses are left as they were.
    ///
    /// # Errors
    /// [`SenseError::Scene`] for an unknown drone, bad poses, or a failure of MuJoCo.
    pub fn swept(&mut self, sweep: &Sweep) -> Result<Option<SweptHit>, SenseError> {
        swept::swept(self.collider, self.worker, sweep)
    }

    /// Casts the rays of a pattern from `pose` (sensor to world), sixteen at a time in f32.
    ///
    /// Nothing is allocated once the worker has seen a pattern of this size.
    ///
    /// # Errors
    /// [`SenseError::Shape`] for a plane of another size; [`SenseError::Scene`] for a bad pose, a body or drone that does not
    /// exist, and where the worker was not updated; [`SenseError::Parameter`] for a scene of 2²⁴ geoms or more.
    pub fn pattern(
        &mut self,
        pose: &Pose,
        pattern: &RayPattern,
        query: &RayQuery,
        out: RayPlanes,
    ) -> Result<(), SenseError> {
        caster::cast_pattern(self.worker, pose, pattern, query, out)
    }

    /// Casts rays from any points in any directions (n × 3 each, world, directions of any length but zero), one by one in
    /// f64.
    ///
    /// # Errors
    /// [`SenseError::Parameter`] for arrays of different lengths and for rays that are not finite or have no direction;
    /// [`SenseError::Scene`] for a body or drone that does not exist, and where the worker was not updated.
    pub fn rays(
        &mut self,
        origins_m: &[[f64; 3]],
        directions: &[[f64; 3]],
        query: &RayQuery,
        hits: &mut RayHits,
    ) -> Result<(), SenseError> {
        caster::cast_rays(self.worker, origins_m, directions, query, hits)
    }
}
