//! What is near a drone, and what touches it.

use super::pair::Meeting;
use crate::kind::GeomType;
use crate::query::{NearMemory, Query, lower_bound};
use crate::vec3::{dot, sub};

/// Two geoms that touch.
#[derive(Clone, Copy, Debug)]
pub struct Touch {
    /// The drone.
    pub drone: usize,
    /// Its geom.
    pub own: usize,
    /// The other geom.
    pub other: usize,
    /// Where one is a ball. The contacts of others are MuJoCo's to tell, and whether there are any.
    pub ball: Option<Meeting>,
}

/// The nearest pair of geoms.
#[derive(Clone, Copy, Debug)]
pub struct Found {
    /// What the two are to each other, points in the world.
    pub meeting: Meeting,
    /// The drone's.
    pub own: usize,
    /// The other.
    pub other: usize,
}

impl Query<'_> {
    /// A geom that is convex, and no plane.
    pub fn is_convex(&self, geom: usize) -> bool {
        self.table.convex(geom, [0.0; 3], &self.poses.geom_mat[geom]).is_some()
    }

    /// Signed distance from a point to a plane, distance to the bounding box of any other geom.
    pub fn box_distance(&self, geom: usize, point: [f64; 3]) -> f64 {
        lower_bound(&self.table.geoms[geom], self.place(geom), point, 0.0).max(0.0)
    }

    /// Geoms that can collide and whose box comes nearer to a point than `reach`, with that distance; planes with their
    /// signed distance. Without those of `drone`.
    pub(crate) fn within(
        &self,
        memory: &NearMemory,
        drone: usize,
        point: [f64; 3],
        reach: f64,
        out: &mut Vec<(f64, usize)>,
    ) {
        let table = self.table;
        let mut add = |id: usize| {
            let g = &table.geoms[id];
            let bound = lower_bound(g, self.place(id), point, 0.0);
            let distance = if g.kind == GeomType::Plane { bound } else { bound.max(0.0) };
            if g.collides && distance < reach {
                out.push((distance, id));
            }
        };
        table.planes.iter().for_each(|id| add(*id as usize));
        table.still.tree.near(point, reach, |k, reach| {
            add(table.still.ids[table.still.tree.order[k] as usize] as usize);
            reach
        });
        memory.tree.near(point, reach, |k, reach| {
            add(table.obstacles[memory.tree.order[k] as usize] as usize);
            reach
        });
        memory.grid.within(point, reach + memory.radius, |k, _| {
            if k != drone {
                table.drones[k].geoms.iter().for_each(|id| add(*id));
            }
        });
        // A tree may hand out a number twice.
        out.sort_unstable_by_key(|(_, id)| *id);
        out.dedup_by_key(|(_, id)| *id);
    }

    /// Signed distance of a convex geom and any other below `limit`, with points in the world; else any number of at least that.
    pub fn meet(&self, own: usize, other: usize, limit: f64) -> Meeting {
        let at = self.place(own);
        let mut m = self.table.meet(own, at, other, self.place(other), limit);
        for k in 0..3 {
            m.on_first[k] += at.pos[k];
            m.on_second[k] += at.pos[k];
        }
        m
    }

    /// The geom nearest to a drone below `max` m, as far as it is known here; pairs that overlap and may be the deepest are put into
    /// `memory.pairs`.
    ///
    /// # Panics
    /// For a drone that the table does not hold.
    pub fn nearest(&self, memory: &mut NearMemory, drone: usize, max: f64) -> Option<Found> {
        let table = self.table;
        let (own, radius) = (&table.drones[drone].geoms[..], table.drones[drone].radius_m);
        let centre = self.centre(drone);
        let NearMemory { tree, grid, own: order, pairs, radius: widest, .. } = memory;
        pairs.clear();
        let mut search = Search { query: self, own, centre, radius, max, best: None, order, pairs };
        for id in &table.planes {
            search.consider(*id as usize);
        }
        let reach = search.reach();
        table.still.tree.near(centre, reach, |k, _| {
            search.consider(table.still.ids[table.still.tree.order[k] as usize] as usize);
            search.reach()
        });
        let reach = search.reach();
        tree.near(centre, reach, |k, _| {
            search.consider(table.obstacles[tree.order[k] as usize] as usize);
            search.reach()
        });
        if table.drones.len() > 1 {
            let reach = (search.reach() + *widest).max(radius + *widest);
            grid.near(centre, reach, |other, far| {
                if other != drone {
                    search.consider_drone(other, far);
                }
                (search.reach() + *widest).max(radius + *widest)
            });
        }
        search.best
    }

    /// Adds what a drone touches to `memory.touches`, of other drones those with higher numbers only.
    ///
    /// # Panics
    /// For a drone that the table does not hold.
    pub fn touching(&self, memory: &mut NearMemory, drone: usize) {
        let table = self.table;
        let (own, radius) = (&table.drones[drone].geoms[..], table.drones[drone].radius_m);
        let centre = self.centre(drone);
        let NearMemory { tree, grid, touches, radius: widest, .. } = memory;
        let mut other = |id: usize| self.touch(drone, own, id, centre, radius, touches);
        for id in &table.planes {
            other(*id as usize);
        }
        let reach = radius + table.margin;
        table.still.tree.near(centre, reach, |k, reach| {
            other(table.still.ids[table.still.tree.order[k] as usize] as usize);
            reach
        });
        tree.near(centre, reach, |k, reach| {
            other(table.obstacles[tree.order[k] as usize] as usize);
            reach
        });
        grid.within(centre, radius + *widest + 2.0 * table.margin, |k, far| {
            if k > drone && far <= radius + table.drones[k].radius_m + 2.0 * table.margin {
                table.drones[k].geoms.iter().for_each(|id| other(*id));
            }
        });
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
        let table = self.table;
        let h = &table.geoms[other];
        let there = self.place(other);
        if !h.collides || lower_bound(h, there, centre, radius) > h.margin + table.margin {
            return;
        }
        for &id in own {
            let g = &table.geoms[id];
            let margin = g.margin + h.margin;
            if !g.collides || lower_bound(h, there, self.poses.geom_pos_m[id], g.radius) > margin {
                continue;
            }
            if h.kind == GeomType::Sdf {
                // Its contacts know the field only, which is not quite the surface of its mesh.
                touches.push(Touch { drone, own: id, other, ball: None });
                continue;
            }
            // Whoever finds the contact points knows distances to the tolerance only.
            let slack = 2.0 * table.tolerance + 1e-9;
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
    query: &'f Query<'a>,
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
        let other = &self.query.table.drones[drone];
        if far - self.radius - other.radius_m <= self.distance() {
            for &geom in &other.geoms {
                self.consider(geom);
            }
        }
    }

    fn consider(&mut self, other: usize) {
        let query = self.query;
        let table = query.table;
        let h = &table.geoms[other];
        let there = query.place(other);
        if !h.collides || lower_bound(h, there, self.centre, self.radius) > self.distance() {
            return;
        }
        self.order.clear();
        for &id in self.own {
            let g = &table.geoms[id];
            if g.collides {
                let bound = lower_bound(h, there, query.poses.geom_pos_m[id], g.radius);
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
                let Some(shape) = table.convex(id, query.poses.geom_pos_m[id], &query.poses.geom_mat[id])
                else {
                    continue;
                };
                if dot(shape.extreme(n.map(|x| -x)), n) - offset - TIE_M > self.distance() {
                    continue;
                }
            }
            // A little beyond the best, so that an equal distance is measured and not cut off.
            let m = query.meet(id, other, self.distance() + TIE_M);
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
                let edge = match table.convex(other, there.pos, there.mat) {
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
