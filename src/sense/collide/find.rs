//! What is near a drone, and what touches it.

use super::grid::Grid;
use super::pair::{Meeting, Place};
use super::{Solids, bounds, lower_bound};
use crate::math::quat;
use crate::math::vec3::{dot, sub};
use crate::scene::{GeomType, Pose, Scene, SceneError, Worker};
use crate::sense::caster::bvh::{Bounds, Bvh};
use crate::sense::caster::world::World;
use crate::sense::clearance::PairDistance;

/// What moves, for one set of poses; its memory is kept from one to the next.
#[derive(Default)]
pub(in super::super) struct Movers {
    /// State of the worker's poses; 0 before the first.
    version: u64,
    boxes: Vec<Bounds>,
    tree: Bvh,
    grid: Grid,
    /// Lower bounds of distance and geoms of a drone.
    own: Vec<(f64, u32)>,
    /// Pairs of geoms, the drone's first, of whose depth only MuJoCo knows.
    pub pairs: Vec<(u32, u32)>,
    /// Pairs of geoms that touch.
    pub touches: Vec<Touch>,
    /// Largest radius of a drone.
    radius: f64,
}

/// Two geoms that touch.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct Touch {
    pub drone: usize,
    /// Of the drone.
    pub own: usize,
    pub other: usize,
    /// Where one is a ball. The contacts of others are MuJoCo's to tell, and whether there are any.
    pub ball: Option<Meeting>,
}

impl Movers {
    /// Those of a worker, taken out of it.
    pub fn take(worker: &mut Worker) -> Box<Self> {
        worker.scratch.collider.take().and_then(|kept| kept.downcast().ok()).unwrap_or_default()
    }

    /// Gives them back to their worker.
    pub fn put(self: Box<Self>, worker: &mut Worker) {
        worker.scratch.collider = Some(self);
    }
}

/// The nearest pair of geoms.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct Found {
    pub meeting: Meeting,
    /// Of the drone.
    pub own: usize,
    pub other: usize,
}

/// Poses and what to look among.
pub(in super::super) struct Finder<'a> {
    pub scene: &'a Scene,
    pub world: &'a World,
    pub pos: &'a [[f64; 3]],
    pub mat: &'a [[f64; 9]],
    worker: &'a Worker,
}

impl<'a> Finder<'a> {
    /// At the worker's poses.
    pub fn new(
        scene: &'a Scene,
        world: &'a World,
        worker: &'a Worker,
        movers: &mut Movers,
    ) -> Result<Self, SceneError> {
        let (pos, mat) = worker.geom_poses()?;
        let finder = Self { scene, world, pos, mat, worker };
        if movers.version != worker.version() {
            let solids = &world.solids;
            movers.boxes.clear();
            movers.boxes.extend(solids.moving.iter().map(|id| {
                let id = *id as usize;
                bounds(&solids.geoms[id], pos[id], &mat[id])
            }));
            movers.tree.build(&movers.boxes);
            movers.radius = 0.0;
            for drone in 0..scene.n_drones() {
                movers.radius = movers.radius.max(scene.drone_radius_m(drone)?);
            }
            let least = 2.0 * (movers.radius + solids.margin);
            let centre = |drone| finder.centre(drone).unwrap_or([f64::NAN; 3]);
            movers.grid.fill((0..scene.n_drones()).map(centre), least);
            movers.version = worker.version();
        }
        Ok(finder)
    }

    pub fn solids(&self) -> &'a Solids {
        &self.world.solids
    }

    pub fn centre(&self, drone: usize) -> Result<[f64; 3], SceneError> {
        Ok(self.worker.body_pose(self.scene.drone_body(drone)?)?.pos_m)
    }

    /// A geom that is convex, and no plane.
    pub fn is_convex(&self, geom: usize) -> bool {
        self.solids().convex(geom, [0.0; 3], &self.mat[geom]).is_some()
    }

    /// Signed distance from a point to a plane, distance to the bounding box of any other geom.
    pub fn box_distance(&self, geom: usize, point: [f64; 3]) -> f64 {
        lower_bound(&self.solids().geoms[geom], self.place(geom), point, 0.0).max(0.0)
    }

    /// Signed distance of two geoms below `limit`, the first at its place in a drone (position, rotation) at a pose of the
    /// drone.
    pub fn distance_at(
        &self,
        pose: &Pose,
        local: &[f64; 3],
        turned: &[f64; 9],
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
        let solids = self.solids();
        let bound = lower_bound(&solids.geoms[other], self.place(other), pos, solids.geoms[own].radius);
        let m = if bound >= limit {
            Meeting { distance: bound, ..Meeting::far() }
        } else {
            let at = Place { pos, mat: &mat };
            solids.meet(&self.world.hfields, own, at, other, self.place(other), limit)
        };
        let out = |p: [f64; 3]| [0, 1, 2].map(|k| p[k] + pos[k]);
        PairDistance {
            distance_m: m.distance.min(limit),
            on_drone_m: out(m.on_first),
            on_other_m: out(m.on_second),
            exact: !m.bound,
        }
    }

    /// Geoms that can collide and whose box comes nearer to a point than `reach`, with that distance; planes with their
    /// signed distance. Without those of `drone`.
    pub fn within(
        &self,
        movers: &Movers,
        drone: usize,
        point: [f64; 3],
        reach: f64,
        out: &mut Vec<(f64, usize)>,
    ) -> Result<(), SceneError> {
        let solids = self.solids();
        let mut add = |id: usize| {
            let g = &solids.geoms[id];
            let bound = lower_bound(g, self.place(id), point, 0.0);
            let distance = if g.kind == GeomType::Plane { bound } else { bound.max(0.0) };
            if g.collides && distance < reach {
                out.push((distance, id));
            }
        };
        solids.planes.iter().for_each(|id| add(*id as usize));
        solids.fixed.near(point, reach, |k, reach| {
            add(solids.fixed_ids[solids.fixed.order[k] as usize] as usize);
            reach
        });
        movers.tree.near(point, reach, |k, reach| {
            add(solids.moving[movers.tree.order[k] as usize] as usize);
            reach
        });
        let mut failed = None;
        movers.grid.within(point, reach + movers.radius, |k, _| {
            if k != drone {
                match self.scene.drone_geoms(k) {
                    Ok(geoms) => geoms.iter().for_each(|id| add(*id)),
                    Err(e) => failed = Some(e),
                }
            }
        });
        // A tree may hand out a number twice.
        out.sort_unstable_by_key(|(_, id)| *id);
        out.dedup_by_key(|(_, id)| *id);
        failed.map_or(Ok(()), Err)
    }

    fn place(&self, geom: usize) -> Place<'a> {
        Place { pos: self.pos[geom], mat: &self.mat[geom] }
    }

    /// Signed distance of two geoms below `limit`, with points in the world.
    pub fn meet(&self, own: usize, other: usize, limit: f64) -> Meeting {
        let at = self.place(own);
        let hfields = &self.world.hfields;
        let mut m = self.solids().meet(hfields, own, at, other, self.place(other), limit);
        for k in 0..3 {
            m.on_first[k] += at.pos[k];
            m.on_second[k] += at.pos[k];
        }
        m
    }

    /// The nearest geom below `max`, as far as it is known here; pairs that overlap and may be the deepest are put into
    /// `movers.pairs`.
    pub fn nearest(&self, movers: &mut Movers, drone: usize, max: f64) -> Result<Option<Found>, SceneError> {
        let solids = self.solids();
        let own = self.scene.drone_geoms(drone)?;
        let (centre, radius) = (self.centre(drone)?, self.scene.drone_radius_m(drone)?);
        let Movers { tree, grid, own: order, pairs, radius: widest, .. } = movers;
        pairs.clear();
        let mut search = Search { finder: self, own, centre, radius, max, best: None, order, pairs };
        for id in &solids.planes {
            search.consider(*id as usize);
        }
        let reach = search.reach();
        solids.fixed.near(centre, reach, |k, _| {
            search.consider(solids.fixed_ids[solids.fixed.order[k] as usize] as usize);
            search.reach()
        });
        let reach = search.reach();
        tree.near(centre, reach, |k, _| {
            search.consider(solids.moving[tree.order[k] as usize] as usize);
            search.reach()
        });
        if self.scene.n_drones() > 1 {
            let reach = (search.reach() + *widest).max(radius + *widest);
            grid.near(centre, reach, |other, far| {
                if other != drone {
                    search.consider_drone(other, far);
                }
                (search.reach() + *widest).max(radius + *widest)
            });
        }
        Ok(search.best)
    }

    /// Adds what a drone touches to `movers.touches`, of other drones those with higher numbers only.
    pub fn touching(&self, movers: &mut Movers, drone: usize) -> Result<(), SceneError> {
        let solids = self.solids();
        let own = self.scene.drone_geoms(drone)?;
        let (centre, radius) = (self.centre(drone)?, self.scene.drone_radius_m(drone)?);
        let Movers { tree, grid, touches, radius: widest, .. } = movers;
        let mut other = |id: usize| self.touch(drone, own, id, centre, radius, touches);
        for id in &solids.planes {
            other(*id as usize);
        }
        let reach = radius + solids.margin;
        solids.fixed.near(centre, reach, |k, reach| {
            other(solids.fixed_ids[solids.fixed.order[k] as usize] as usize);
            reach
        });
        tree.near(centre, reach, |k, reach| {
            other(solids.moving[tree.order[k] as usize] as usize);
            reach
        });
        let mut failed = None;
        grid.within(centre, radius + *widest + 2.0 * solids.margin, |k, far| {
            if k <= drone {
                return;
            }
            match (self.scene.drone_radius_m(k), self.scene.drone_geoms(k)) {
                (Ok(its), Ok(geoms)) if far <= radius + its + 2.0 * solids.margin => {
                    geoms.iter().for_each(|id| other(*id));
                }
                (Ok(_), Ok(_)) => {}
                (Err(e), _) | (_, Err(e)) => failed = Some(e),
            }
        });
        failed.map_or(Ok(()), Err)
    }

    fn touch(
        &self,
        drone: usize,
        own: &[usize],
        other: usize,
        centre: [f64; 3],
        radius: f64,
        touches: &mut Vec<Touch>,
    ) {
        let solids = self.solids();
        let h = &solids.geoms[other];
        if !h.collides || lower_bound(h, self.place(other), centre, radius) > h.margin + solids.margin {
            return;
        }
        for &id in own {
            let g = &solids.geoms[id];
            let margin = g.margin + h.margin;
            if !g.collides || lower_bound(h, self.place(other), self.pos[id], g.radius) > margin {
                continue;
            }
            if h.kind == GeomType::Sdf {
                // Its contacts know the field only, which is not quite the surface of its mesh.
                touches.push(Touch { drone, own: id, other, ball: None });
                continue;
            }
            // MuJoCo knows its distances to the tolerance only.
            let slack = 2.0 * self.scene.ccd_tolerance() + 1e-9;
            let m = self.meet(id, other, margin + 2.0 * slack);
            let ball = m.normal.map(|_| m);
            if m.deep || m.distance <= if ball.is_some() { margin } else { margin + slack } {
                touches.push(Touch { drone, own: id, other, ball });
            }
        }
    }
}

/// A search for the nearest geom.
struct Search<'f, 'a, 'b> {
    finder: &'f Finder<'a>,
    own: &'f [usize],
    centre: [f64; 3],
    radius: f64,
    max: f64,
    best: Option<Found>,
    order: &'b mut Vec<(f64, u32)>,
    pairs: &'b mut Vec<(u32, u32)>,
}

impl Search<'_, '_, '_> {
    fn distance(&self) -> f64 {
        self.best.map_or(self.max, |b| b.meeting.distance)
    }

    /// Boxes beyond this from the drone's centre hold nothing nearer.
    fn reach(&self) -> f64 {
        self.distance() + self.radius + TIE_M
    }

    fn consider_drone(&mut self, drone: usize, far: f64) {
        let scene = self.finder.scene;
        // Numbers come from the grid, which holds the drones of this scene.
        let (Ok(radius), Ok(geoms)) = (scene.drone_radius_m(drone), scene.drone_geoms(drone)) else { return };
        if far - self.radius - radius <= self.distance() {
            for &geom in geoms {
                self.consider(geom);
            }
        }
    }

    fn consider(&mut self, other: usize) {
        let finder = self.finder;
        let solids = finder.solids();
        let h = &solids.geoms[other];
        let there = finder.place(other);
        if !h.collides || lower_bound(h, there, self.centre, self.radius) > self.distance() {
            return;
        }
        self.order.clear();
        for &id in self.own {
            let g = &solids.geoms[id];
            if g.collides {
                let bound = lower_bound(h, there, finder.pos[id], g.radius);
                if bound <= self.distance() {
                    self.order.push((bound, id as u32));
                }
            }
        }
        // Two of the nearest by their balls, then whatever the plane before the obstacle leaves.
        self.order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut plane: Option<([f64; 3], f64)> = None;
        for k in 0..self.order.len() {
            let (bound, id) = self.order[k];
            let id = id as usize;
            if bound > self.distance() {
                break;
            }
            if let Some((n, offset)) = plane {
                // The obstacle lies wholly behind the plane; this geom may lie wholly before it.
                let Some(shape) = solids.convex(id, finder.pos[id], &finder.mat[id]) else { continue };
                if dot(shape.extreme(n.map(|x| -x)), n) - offset - TIE_M > self.distance() {
                    continue;
                }
            }
            // A little beyond the best, so that an equal distance is measured and not cut off.
            let m = finder.meet(id, other, self.distance() + TIE_M);
            if m.deep {
                self.pairs.push((id as u32, other as u32));
            }
            if m.distance > self.distance() {
                continue;
            }
            let apart = sub(m.on_first, m.on_second);
            let length = dot(apart, apart).sqrt();
            if m.distance > 1e-6 && !m.bound {
                let n = apart.map(|x| x / length);
                let edge = match solids.convex(other, there.pos, there.mat) {
                    Some(shape) => Some(shape.extreme(n)),
                    None => (h.kind == GeomType::Plane).then_some(m.on_second),
                };
                plane = edge.map(|p| (n, dot(n, p)));
            }
            // Of equals the one with the lower numbers, whatever the order in which they come.
            let name = |f: &Found| (f.other, f.own);
            let found = Found { meeting: m, own: id, other };
            if m.distance < self.distance() || self.best.as_ref().is_some_and(|b| name(&found) < name(b)) {
                self.best = Some(found);
            }
        }
    }
}

/// Distances are equal to this, m: a little more than what the algorithm leaves open.
const TIE_M: f64 = 2e-9;
