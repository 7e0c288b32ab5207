//! Signed distances at the points of a grid: what a [`DistanceField`](crate::DistanceField) is made of.

use crate::distance::pair::Place;
use crate::field::FieldGrid;
use crate::kind::GeomType;
use crate::query::{Poses, lower_bound};
use crate::shape::bvh::{Bounds, Bvh};
use crate::table::Table;

/// Finds distances of points to some geoms, which stand still meanwhile.
pub struct Baker<'a> {
    table: &'a Table,
    poses: Poses<'a>,
    /// Those that are no planes, and the tree of their boxes.
    ids: Vec<u32>,
    tree: Bvh,
    planes: Vec<u32>,
}

impl<'a> Baker<'a> {
    /// For geoms of a table, by their numbers, at their poses.
    ///
    /// # Panics
    /// For a number that the table does not hold.
    pub fn new(table: &'a Table, poses: Poses<'a>, geoms: &[usize]) -> Self {
        let (mut ids, mut planes, mut boxes) = (Vec::new(), Vec::new(), Vec::<Bounds>::new());
        for &id in geoms {
            let geom = &table.geoms[id];
            if geom.kind == GeomType::Plane {
                planes.push(id as u32);
            } else {
                ids.push(id as u32);
                boxes.push(geom.bounds(poses.geom_pos_m[id], &poses.geom_mat[id]));
            }
        }
        let mut tree = Bvh::default();
        tree.build(&boxes);
        Self { table, poses, ids, tree, planes }
    }

    /// Planes: unit normal, and offset (n · p − offset is the distance of a point p), m.
    pub fn planes(&self) -> Vec<[f64; 4]> {
        let plane = |id: &u32| {
            let (p, m) = (self.poses.geom_pos_m[*id as usize], &self.poses.geom_mat[*id as usize]);
            let n = [m[2], m[5], m[8]];
            [n[0], n[1], n[2], n[0] * p[0] + n[1] * p[1] + n[2] * p[2]]
        };
        self.planes.iter().map(plane).collect()
    }

    /// Geoms of which it is not known how deep a point is inside; their distance is 0 there.
    pub fn zero_inside(&self) -> Vec<u32> {
        self.ids.iter().copied().filter(|id| !self.table.tells_depth(*id as usize)).collect()
    }

    /// Signed distance from a point to the nearest of the geoms where it is less than `limit`, else `limit`; m.
    pub fn distance(&self, point_m: [f64; 3], limit: f64) -> f64 {
        let table = self.table;
        let place = |id: usize| Place { pos: self.poses.geom_pos_m[id], mat: &self.poses.geom_mat[id] };
        let mut best = limit;
        for id in &self.planes {
            let id = *id as usize;
            best = best.min(table.point_distance(id, place(id), point_m, best));
        }
        self.tree.near(point_m, best, |k, _| {
            let id = self.ids[self.tree.order[k] as usize] as usize;
            if lower_bound(&table.geoms[id], place(id), point_m, 0.0) < best {
                best = best.min(table.point_distance(id, place(id), point_m, best));
            }
            best
        });
        best
    }

    /// Distances at all points of a grid with number `x` along x, (y, z) with z fastest, m.
    ///
    /// # Panics
    /// Where `out` has another number of places than the layer has points.
    pub fn layer(&self, grid: &FieldGrid, x: usize, out: &mut [f32]) {
        let [_, ny, nz] = grid.counts;
        assert_eq!(out.len(), ny * nz, "one place for each point of the layer");
        for (y, row) in out.chunks_exact_mut(nz).enumerate() {
            // Next to a point nothing is farther than from there by more than the way between.
            let mut limit = f64::INFINITY;
            for (z, to) in row.iter_mut().enumerate() {
                let d = self.distance(grid.point([x, y, z]), limit);
                *to = d as f32;
                limit = d + 1.000_001 * grid.resolution_m + 1e-6;
            }
        }
    }
}
