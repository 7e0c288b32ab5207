//! The distance field of a scene.

use rayon::prelude::*;

use super::{Scene, SceneError};
use crate::geometry::{Baker, DistanceField, FieldGrid, GeomType, GeometryError};

/// How far fields reach beyond the things of a scene where nothing else is asked for, m.
pub const FIELD_BESIDE_M: f64 = 1.0;

/// Memory that a field may take where nothing else is said, bytes: a gibibyte, 65 m × 65 m × 8 m at 5 cm.
pub const FIELD_MOST_BYTES: u64 = 1 << 30;

impl Scene {
    /// Signed distances to everything that stands still and can collide, at the points of a regular grid: baked once, in parallel, from the exact distances that
    /// contacts and clearances have. Drones and obstacles, which move, are not in it.
    ///
    /// `bounds_m` are two corners of a box; none: around all these things but planes, and [`FIELD_BESIDE_M`] beyond. `most_bytes` is asked before anything is
    /// allocated; a point takes four bytes.
    ///
    /// Meshes are their convex hulls, as for contacts. Where things overlap, inside of both, the distance is that to the farther surface of the two.
    ///
    /// # Errors
    /// [`SceneError::Argument`] for bounds and resolutions that make no sense, fields that take too much memory, scenes in which nothing stands still, or planes
    /// alone without bounds, and scenes with flexes; [`SceneError::Engine`].
    pub fn distance_field(
        &self,
        resolution_m: f64,
        bounds_m: Option<[[f64; 3]; 2]>,
        most_bytes: u64,
    ) -> Result<DistanceField, SceneError> {
        let fail = |what: String| SceneError::Argument { what };
        if self.n_flex() > 0 {
            return Err(fail(format!(
                "distance field of {}: it has flexes, whose distances are not known; take them out of the scene",
                self.name()
            )));
        }
        let still: Vec<usize> = (self.geoms().iter())
            .filter(|g| g.drone.is_none() && g.can_collide() && self.bodies()[g.body_id].obstacle.is_none())
            .map(|g| g.id)
            .collect();
        if still.is_empty() {
            return Err(fail(format!(
                "distance field of {}: nothing in it stands still and can collide; give geoms contype or conaffinity",
                self.name()
            )));
        }
        let mut worker = self.worker()?;
        worker.update()?;
        let bounds = match bounds_m {
            Some(bounds) => bounds,
            None => self.around(&worker, &still)?,
        };
        let told = |e: GeometryError| fail(format!("distance field of {}: {e}", self.name()));
        let grid = FieldGrid::over(bounds, resolution_m, most_bytes).map_err(told)?;
        let (table, poses, _) = worker.geometry()?;
        let baker = Baker::new(table, poses, &still);
        let mut data = vec![0.0f32; grid.len()];
        let layer = grid.counts[1] * grid.counts[2];
        data.par_chunks_exact_mut(layer).enumerate().for_each(|(x, out)| baker.layer(&grid, x, out));
        DistanceField::new(grid, data, baker.planes(), baker.zero_inside()).map_err(told)
    }

    /// The box around geoms that are no planes, and a little more.
    fn around(&self, worker: &super::Worker, geoms: &[usize]) -> Result<[[f64; 3]; 2], SceneError> {
        let mut bounds = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
        for geom in geoms.iter().map(|id| &self.geoms()[*id]).filter(|g| g.kind != GeomType::Plane) {
            let (pos, mat) = worker.geom_pose(geom.id)?;
            let [cx, cy, cz, hx, hy, hz] = geom.aabb_m;
            for k in 0..3 {
                let row = &mat[3 * k..3 * k + 3];
                let middle = pos[k] + row[0] * cx + row[1] * cy + row[2] * cz;
                let half = row[0].abs() * hx + row[1].abs() * hy + row[2].abs() * hz + FIELD_BESIDE_M;
                bounds[0][k] = bounds[0][k].min(middle - half);
                bounds[1][k] = bounds[1][k].max(middle + half);
            }
        }
        if bounds[0][0] > bounds[1][0] {
            return Err(SceneError::Argument {
                what: format!(
                    "distance field of {}: it has planes alone, which have no end; give bounds",
                    self.name()
                ),
            });
        }
        Ok(bounds)
    }
}
