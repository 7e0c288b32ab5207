//! The scene from above, as the overview picture shows it.

use super::HeightMap;
use super::recorder::Flight;
use crate::error::Result;
use crate::scene::{GeomType, Worker};

/// Cells along the longer side of [`height_map`].
const MAP_CELLS: usize = 360;

/// The scene from above, cut at this height so that ceilings and crowns do not hide what drones fly through, m.
const MAP_CUT_M: f64 = 2.5;

/// Room around the drones' paths that the map shows, m.
const MAP_MARGIN_M: f64 = 4.0;

/// Heights of the scene (at its model poses, without the drones) on a grid seen from above, cut at 2.5 m, by vertical
/// rays. The map spans all geoms of limited size, at least ±3 m and at most 4 m more than the drones' reach.
pub fn height_map(flight: &Flight) -> Result<HeightMap> {
    let scene = flight.scene();
    let most = flight.config().pattern().reach_m(scene.n_drones()) + MAP_MARGIN_M;
    let mut worker = scene.worker()?;
    // Drones out of the way.
    for d in 0..scene.n_drones() {
        worker.set_drone(d, [0.0, 0.0, 1e4 + 100.0 * d as f64], [0.0, 0.0, 0.0, 1.0])?;
    }
    worker.update()?;
    let mut half = [3.0f64; 2];
    for geom in scene.geoms().iter().filter(|g| g.drone.is_none() && g.kind != GeomType::Plane) {
        let center = worker.geom_pose(geom.id)?.0;
        for k in 0..2 {
            half[k] = half[k].max(center[k].abs() + geom.bounding_radius_m.min(3.0));
        }
    }
    let half = half.map(|h| h.min(most));
    let cell = 2.0 * half[0].max(half[1]) / MAP_CELLS as f64;
    let columns = (2.0 * half[0] / cell).round() as usize;
    let rows = (2.0 * half[1] / cell).round() as usize;
    let mut heights_m = Vec::with_capacity(columns * rows);
    for row in 0..rows {
        // First row is the farthest in y: north is up.
        let y = half[1] - (row as f64 + 0.5) * cell;
        for column in 0..columns {
            let x = -half[0] + (column as f64 + 0.5) * cell;
            heights_m.push(surface_below_cut(&mut worker, x, y)?);
        }
    }
    Ok(HeightMap { x_m: [-half[0], half[0]], y_m: [-half[1], half[1]], columns, rows, heights_m })
}

/// Height of the highest surface at or below the cut, the cut itself inside solids that it goes through, NaN for nothing.
fn surface_below_cut(worker: &mut Worker, x: f64, y: f64) -> Result<f32> {
    let mut z = 200.0;
    let mut inside: Vec<i32> = Vec::new();
    // A ray passes each surface once; more than this means that it does not get on.
    for _ in 0..64 {
        let Some(hit) = worker.ray([x, y, z], [0.0, 0.0, -1.0], Some(&MAP_GROUPS), None)? else {
            return Ok(f32::NAN);
        };
        let at = z - hit.distance;
        if at <= MAP_CUT_M {
            return Ok(if inside.is_empty() { at as f32 } else { MAP_CUT_M as f32 });
        }
        match inside.iter().position(|g| *g == hit.geom_id) {
            Some(i) => drop(inside.swap_remove(i)),
            None => inside.push(hit.geom_id),
        }
        z = at - 1e-6;
    }
    Ok(f32::NAN)
}

/// Groups that the map shows: those that cameras see by default.
const MAP_GROUPS: [u8; 6] = [1, 1, 1, 0, 0, 0];
