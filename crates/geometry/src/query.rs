//! A set of poses, ready to be asked.

use crate::broad::grid::Grid;
use crate::distance::find::Touch;
use crate::distance::pair::Place;
use crate::ray::RayMemory;
use crate::shape::bvh::{Bounds, Bvh};
use crate::table::{Geom, Table};

/// Where everything is.
#[derive(Clone, Copy, Debug)]
pub struct Poses<'a> {
    /// Position of each geom, m.
    pub geom_pos_m: &'a [[f64; 3]],
    /// Rotation of each geom.
    pub geom_mat: &'a [[f64; 9]],
    /// Position of each body, m.
    pub body_pos_m: &'a [[f64; 3]],
    /// Another number for other poses; never 0.
    pub version: u64,
}

/// What queries at the poses of one owner remember: buffers that grow once, and where moving things are, which is found out once for each
/// set of poses.
#[derive(Default)]
pub struct Memory {
    /// Of rays.
    pub rays: RayMemory,
    /// Of distances, contacts and sweeps.
    pub near: NearMemory,
}

/// Where what moves is, for one set of poses, and what was found there.
#[derive(Default)]
pub struct NearMemory {
    /// That of the poses; 0 before the first.
    version: u64,
    boxes: Vec<Bounds>,
    /// Of geoms of obstacles.
    pub(crate) tree: Bvh,
    /// Of drones.
    pub(crate) grid: Grid,
    /// Largest radius of a drone.
    pub(crate) radius: f64,
    /// Lower bounds of distance and geoms of a drone.
    pub(crate) own: Vec<(f64, u32)>,
    /// Pairs of geoms, the drone's first, of whose depth only MuJoCo knows: what [`Query::nearest`] left open.
    pub pairs: Vec<(u32, u32)>,
    /// Pairs of geoms that touch: what [`Query::touching`] found.
    pub touches: Vec<Touch>,
}

/// Asks a table of geoms at a set of poses.
#[derive(Clone, Copy, Debug)]
pub struct Query<'a> {
    pub(crate) table: &'a Table,
    pub(crate) poses: Poses<'a>,
}

impl<'a> Query<'a> {
    /// At these poses; finds out where moving things are, where `memory` holds it of other poses. A memory belongs to one table and one
    /// owner of poses.
    pub fn new(table: &'a Table, poses: Poses<'a>, memory: &mut NearMemory) -> Self {
        let query = Self { table, poses };
        if memory.version != poses.version {
            memory.boxes.clear();
            memory.boxes.extend(table.obstacles.iter().map(|id| {
                let id = *id as usize;
                table.geoms[id].bounds(poses.geom_pos_m[id], &poses.geom_mat[id])
            }));
            memory.tree.build(&memory.boxes);
            memory.radius = table.drones.iter().fold(0.0, |a: f64, d| a.max(d.radius_m));
            let least = 2.0 * (memory.radius + table.margin);
            memory.grid.fill((0..table.drones.len()).map(|drone| query.centre(drone)), least);
            memory.version = poses.version;
        }
        query
    }

    /// Place of a drone, m.
    pub(crate) fn centre(&self, drone: usize) -> [f64; 3] {
        self.poses.body_pos_m[self.table.drones[drone].body]
    }

    #[inline]
    pub(crate) fn place(&self, geom: usize) -> Place<'a> {
        Place { pos: self.poses.geom_pos_m[geom], mat: &self.poses.geom_mat[geom] }
    }
}

/// Signed distance from a ball to the bounding box of a geom at its place, or to a plane: nothing of the two is nearer than that.
#[inline(always)]
pub(crate) fn lower_bound(g: &Geom, place: Place, centre: [f64; 3], radius: f64) -> f64 {
    let m = place.mat;
    let d = [centre[0] - place.pos[0], centre[1] - place.pos[1], centre[2] - place.pos[2]];
    let local = [
        m[0] * d[0] + m[3] * d[1] + m[6] * d[2],
        m[1] * d[0] + m[4] * d[1] + m[7] * d[2],
        m[2] * d[0] + m[5] * d[1] + m[8] * d[2],
    ];
    let distance = g.box_distance(local);
    // In the box nothing is known of the depth.
    if distance == 0.0 { f64::NEG_INFINITY } else { distance - radius }
}
