//! What rays meet: sixteen at a time from one point in f32 ([`Rays`]), or one in f64 ([`one`]).
//!
//! It sees what `mj_ray` of MuJoCo 3.17.0 sees: solids from outside and, from inside, their far wall; planes from above
//! and only within their rectangle where they have one; the triangles of meshes (not the hull) and height fields from
//! both sides; nothing of geoms whose alpha is 0, whose group is off or whose body is excluded. Normals point out of the
//! geom, whichever side was seen. Signed distance fields are not seen: [`Rays::may_meet_foreign`] says which rays may see one.
//!
//! How it works: what never moves is kept once for each scene, in groups of sixteen neighbours; what moves is placed for
//! each frame. Of both, a list of what the sensor may see is made, near to far. Every tile of 8 × 8 pixels tests its
//! pyramid against sixteen geoms at a time, and its four packets of 4 × 4 rays meet the geoms that remain, until nothing
//! nearer can come. Meshes have a tree of boxes, height fields a pyramid of heights. Distances are f32; what all rays of
//! a frame share is computed in f64 before it is rounded.
//!
//! Lanes are those of the processor (AVX-512, AVX2, SSE, NEON), chosen at run time. Results do not depend on threads or
//! batches. Processors without fused multiplication and addition round differently.

mod capsule;
mod cuboid;
mod cylinder;
mod ellipsoid;
mod frame;
#[cfg(all(test, target_arch = "x86_64"))]
mod frame_test;
mod hfield;
mod lanes;
mod mesh;
mod pattern;
mod placed;
mod plane;
mod planes;
mod single;
mod sphere;
mod tree;

pub use frame::lanes_in_use;
pub use pattern::RayPattern;
pub use planes::Planes;

use crate::kind::GeomType;
use crate::query::Poses;
use crate::table::{Geom, Table};
use frame::{Buffers, Sink};
use placed::Placed;

/// Geom ids travel in lanes of f32: packets of rays see tables of fewer geoms than this.
pub const MAX_GEOMS: usize = 1 << 24;

/// What rays see.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RayFilter {
    /// Which of the six visibility groups.
    pub groups: [bool; 6],
    /// The drone that is not seen.
    pub own_drone: Option<usize>,
    /// The body that is not seen.
    pub own_body: Option<usize>,
}

impl RayFilter {
    /// Whether rays see a geom.
    pub fn sees(&self, geom: &Geom) -> bool {
        geom.opaque
            && self.groups[geom.group as usize]
            && self.own_body != Some(geom.body as usize)
            && (self.own_drone.is_none() || geom.drone.map(|d| d as usize) != self.own_drone)
    }

    /// Whether rays see a geom that only MuJoCo's rays know.
    pub fn sees_foreign(&self, table: &Table) -> bool {
        table.foreign.iter().any(|id| self.sees(&table.geoms[*id as usize]))
    }
}

/// What a depth states.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthRule {
    /// Along the sensor's −z instead of along the ray.
    pub z_depth: bool,
    /// Least distance that is stated, m.
    pub near: f32,
    /// Greatest distance that is stated, m.
    pub far: f32,
}

/// Buffers of rays, kept from frame to frame.
#[derive(Default)]
pub struct RayMemory {
    buffers: Buffers,
    /// Distance along each ray of [`Rays::ranges`], m; infinite for none.
    pub ranges: Vec<f32>,
    /// What each ray met, −1 for nothing.
    pub geoms: Vec<i32>,
    found: Vec<u32>,
}

/// The rays of a pattern from one pose.
#[derive(Clone, Copy, Debug)]
pub struct Rays<'a> {
    /// All geoms, fewer than [`MAX_GEOMS`].
    pub table: &'a Table,
    /// Where they are.
    pub poses: Poses<'a>,
    /// Which of them are seen.
    pub filter: &'a RayFilter,
    /// Where the rays begin, m.
    pub origin_m: [f64; 3],
    /// Rotation from the sensor's frame to the world.
    pub frame: [[f64; 3]; 3],
    /// Directions in the sensor's frame.
    pub pattern: &'a RayPattern,
    /// What depths state.
    pub rule: DepthRule,
}

impl Rays<'_> {
    /// Casts all rays into planes of one entry for each ray. Nothing is allocated once `memory` has seen a pattern and a table of this size.
    ///
    /// # Panics
    /// Where a plane has fewer entries than the pattern rays; see [`Planes::check`].
    pub fn cast(&self, memory: &mut RayMemory, mut planes: Planes) {
        let RayMemory { buffers, ranges, geoms, .. } = memory;
        let mut sink = Sink {
            depth: planes.depth.as_deref_mut(),
            status: planes.status.as_deref_mut(),
            geom: planes.geom.as_deref_mut(),
            body: planes.body.as_deref_mut(),
            range: None,
        };
        if planes.normal.is_some() {
            ranges.resize(self.pattern.n, 0.0);
            sink.range = Some(ranges);
            if sink.geom.is_none() {
                geoms.resize(self.pattern.n, 0);
                sink.geom = Some(geoms);
            }
        }
        frame::cast(self, buffers, &mut sink);
        if let Some(normal) = planes.normal {
            let geoms = planes.geom.as_deref().unwrap_or(geoms);
            self.normals(geoms, ranges, normal);
        }
    }

    /// Casts all rays into `memory.ranges` and `memory.geoms`, and into a plane of normals where one is wanted, so that what is foreign can be
    /// added before [`Rays::state`] writes what the rays state.
    pub fn ranges(&self, memory: &mut RayMemory, normal: Option<&mut [[f32; 3]]>) {
        let RayMemory { buffers, ranges, geoms, .. } = memory;
        ranges.resize(self.pattern.n, 0.0);
        geoms.resize(self.pattern.n, 0);
        let mut sink = Sink { range: Some(ranges), geom: Some(geoms), ..Sink::default() };
        frame::cast(self, buffers, &mut sink);
        if let Some(normal) = normal {
            self.normals(geoms, ranges, normal);
        }
    }

    /// Writes what ranges and geoms state into planes, all but normals.
    pub fn state(&self, ranges: &[f32], geoms: &[i32], mut planes: Planes) {
        let rule = &self.rule;
        for i in 0..self.pattern.n {
            let t = ranges[i];
            let value =
                if rule.z_depth && t < f32::INFINITY { t * -self.pattern.direction(i)[2] as f32 } else { t };
            let (depth, status) = if !(t < f32::INFINITY) {
                (f32::INFINITY, 1)
            } else if value < rule.near {
                (0.0, 3)
            } else if value > rule.far {
                (f32::INFINITY, 2)
            } else {
                (value, 0)
            };
            if let Some(plane) = planes.depth.as_deref_mut() {
                plane[i] = depth;
            }
            if let Some(plane) = planes.status.as_deref_mut() {
                plane[i] = status;
            }
            if let Some(plane) = planes.geom.as_deref_mut() {
                plane[i] = geoms[i];
            }
            if let Some(plane) = planes.body.as_deref_mut() {
                plane[i] = self.table.body_of(geoms[i]);
            }
        }
    }

    /// Unit direction of a ray in the world.
    pub fn direction(&self, ray: usize) -> [f64; 3] {
        let (r, d) = (&self.frame, self.pattern.direction(ray));
        unit([0, 1, 2].map(|k| r[k][0] * d[0] + r[k][1] * d[1] + r[k][2] * d[2]))
    }

    /// Whether a ray along `direction` (unit, world) may meet a geom that only MuJoCo's rays know, no farther than `range_m`.
    pub fn may_meet_foreign(&self, direction: [f64; 3], range_m: f32) -> bool {
        let d = direction;
        self.table.foreign.iter().any(|id| {
            let id = *id as usize;
            let geom = &self.table.geoms[id];
            let round = geom.round.placed(self.poses.geom_pos_m[id], &self.poses.geom_mat[id]);
            let c = [0, 1, 2].map(|k| round.centre[k] - self.origin_m[k]);
            let reach = round.reach();
            let ahead = c[0] * d[0] + c[1] * d[1] + c[2] * d[2];
            let square = c[0] * c[0] + c[1] * c[1] + c[2] * c[2];
            self.filter.sees(geom)
                && square - ahead * ahead <= reach * reach
                && ahead >= -reach
                && ahead - reach <= f64::from(range_m)
        })
    }

    /// Normals of a frame: each ray meets its geom once more, in f64.
    fn normals(&self, geoms: &[i32], ranges: &[f32], out: &mut [[f32; 3]]) {
        let mut kept: Option<(usize, Placed<f64>)> = None;
        for (i, normal) in out.iter_mut().enumerate() {
            let Ok(id) = usize::try_from(geoms[i]) else {
                *normal = [0.0; 3];
                continue;
            };
            let (pos, mat) = (self.poses.geom_pos_m[id], &self.poses.geom_mat[id]);
            let g = match kept {
                Some((known, g)) if known == id => g,
                _ => Placed::<f64>::new(&self.table.geoms[id], pos, mat, self.origin_m, &self.frame, id),
            };
            kept = Some((id, g));
            let d = self.pattern.direction(i);
            let (t, part) = single::hit(self.table, &g, d, f64::INFINITY);
            let range = f64::from(ranges[i]);
            let same = (t - range).abs() <= OUTLINE * range.max(1e-3);
            let known = !matches!(g.kind, GeomType::Mesh | GeomType::Hfield);
            // At an outline f32 may see what f64 just misses, or the other way round. Then the surface is where f32 saw it; of
            // triangles nobody knows which, and the normal faces the sensor.
            let n = if same || known {
                let t = if same { t } else { range };
                single::normal(self.table, &g, mat, &self.frame, d, t, part)
            } else {
                [0, 1, 2]
                    .map(|k| -(self.frame[k][0] * d[0] + self.frame[k][1] * d[1] + self.frame[k][2] * d[2]))
            };
            *normal = n.map(|x| x as f32);
        }
    }
}

/// Relative difference of two ranges from which on they are those of different surfaces: ten times the worst of one.
const OUTLINE: f64 = 1e-3;

/// What one ray met.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance along the ray, m.
    pub range_m: f64,
    /// The geom.
    pub geom: usize,
    /// Outward unit normal in the world.
    pub normal: [f64; 3],
}

/// Casts one ray in f64, from any point along a unit direction (world). Geoms that only MuJoCo's rays know are not seen.
pub fn one(
    table: &Table,
    poses: &Poses,
    filter: &RayFilter,
    memory: &mut RayMemory,
    origin_m: [f64; 3],
    direction: [f64; 3],
) -> Option<Hit> {
    let (o, d) = (origin_m, direction);
    frame::candidates(table, filter, o, d, &mut memory.found);
    let (pos, mat) = (poses.geom_pos_m, poses.geom_mat);
    let identity = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let mut best: Option<(f64, usize, Placed<f64>, usize)> = None;
    for &id in &memory.found {
        let id = id as usize;
        let g = Placed::<f64>::new(&table.geoms[id], pos[id], &mat[id], o, &identity, id);
        let so_far = best.as_ref().map_or(f64::INFINITY, |b| b.0);
        // Of two at the same distance the one with the lower id, whichever comes first.
        let reach = if best.as_ref().is_some_and(|b| id < b.1) { so_far.next_up() } else { so_far };
        let (t, part) = single::hit(table, &g, d, reach);
        if t < reach {
            best = Some((t, id, g, part));
        }
    }
    best.map(|(t, geom, g, part)| {
        let normal = single::normal(table, &g, &mat[geom], &identity, d, t, part);
        // Zero has no sign.
        Hit { range_m: t + 0.0, geom, normal }
    })
}

fn unit(v: [f64; 3]) -> [f64; 3] {
    let n = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    if n > 0.0 { v.map(|x| x / n) } else { [0.0, 0.0, 1.0] }
}

#[cfg(test)]
mod tests {
    use super::MAX_GEOMS;

    /// All ids below the limit are whole numbers of f32, and one above is not.
    #[test]
    fn ids_below_the_limit_travel_in_f32() {
        assert_eq!((MAX_GEOMS - 1) as f32 as usize, MAX_GEOMS - 1);
        assert_ne!((MAX_GEOMS + 1) as f32 as usize, MAX_GEOMS + 1);
    }
}
