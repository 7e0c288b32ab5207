//! The scene from above, as the overview picture shows it.

use super::HeightMap;
use super::recorder::Flight;
use crate::error::Result;
use crate::scene::{GeomType, Scene, Worker};
use crate::sense::{Queries, RayHits, RayQuery};

/// Cells along the longer side of [`height_map`].
const MAP_CELLS: usize = 360;

/// The scene from above, cut at this height so that ceilings and crowns do not hide what drones fly through, m.
const MAP_CUT_M: f64 = 2.5;

/// Room around the drones' paths that the map shows, m.
const MAP_MARGIN_M: f64 = 4.0;

/// Heights of the scene (at its model poses, without the drones) on a grid seen from above, cut at 2.5 m, by vertical
/// rays. The map spans all geoms of limited size, at least ±3 m and at most 4 m more than the drones' reach.
pub fn height_map(flight: &Flight) -> Result<HeightMap> {
    let most = flight.config().pattern().reach_m(flight.scene().n_drones()) + MAP_MARGIN_M;
    // Built again without the drones, of which there may be hundreds.
    let config = &flight.config().sim;
    let sources = config.scene.as_ref().map_or(Ok(Vec::new()), |scene| scene.sources(config.layouts))?;
    let scene = match sources.first() {
        Some(source) => Scene::build(source, &[])?,
        None => flight.scene().clone(),
    };
    let mut worker = scene.worker()?;
    worker.update()?;
    let mut half = [3.0f64; 2];
    for geom in scene.geoms().iter().filter(|g| g.kind != GeomType::Plane) {
        let center = worker.geom_pose(geom.id)?.0;
        for k in 0..2 {
            half[k] = half[k].max(center[k].abs() + geom.bounding_radius_m.min(3.0));
        }
    }
    let half = half.map(|h| h.min(most));
    let cell = 2.0 * half[0].max(half[1]) / MAP_CELLS as f64;
    let columns = (2.0 * half[0] / cell).round() as usize;
    let rows = (2.0 * half[1] / cell).round() as usize;
    let cells: Vec<[f64; 2]> = (0..rows * columns)
        .map(|i| {
            let (row, column) = ((i / columns) as f64 + 0.5, (i % columns) as f64 + 0.5);
            // First row is the farthest in y: north is up.
            [column * cell - half[0], half[1] - row * cell]
        })
        .collect();
    let heights_m = surfaces_below_cut(&mut worker, &cells)?;
    Ok(HeightMap { x_m: [-half[0], half[0]], y_m: [-half[1], half[1]], columns, rows, heights_m })
}

/// Height at each point of the highest surface at or below the cut, the cut itself inside solids that it goes through, NaN for nothing.
fn surfaces_below_cut(worker: &mut Worker, points: &[[f64; 2]]) -> Result<Vec<f32>> {
    let mut heights = vec![f32::NAN; points.len()];
    // Points whose ray has not come below the cut: their number, the height that it has come to, and the geoms that it is inside of.
    let mut above: Vec<(usize, f64, Vec<i32>)> = (0..points.len()).map(|i| (i, 200.0, Vec::new())).collect();
    let mut hits = RayHits::default();
    // A ray passes each surface once; more than this means that it does not get on.
    for _ in 0..64 {
        if above.is_empty() {
            break;
        }
        let origins: Vec<[f64; 3]> =
            above.iter().map(|(i, z, _)| [points[*i][0], points[*i][1], *z]).collect();
        Queries::at(worker).rays(
            &origins,
            &vec![[0.0, 0.0, -1.0]; origins.len()],
            &RayQuery::default(),
            &mut hits,
        )?;
        let mut ray = 0..;
        above.retain_mut(|(i, z, inside)| {
            let k = ray.next().unwrap_or_default();
            let at = *z - hits.range_m[k];
            if at == f64::NEG_INFINITY {
                return false;
            }
            if at <= MAP_CUT_M {
                heights[*i] = if inside.is_empty() { at as f32 } else { MAP_CUT_M as f32 };
                return false;
            }
            match inside.iter().position(|g| *g == hits.geom_id[k]) {
                Some(known) => drop(inside.swap_remove(known)),
                None => inside.push(hits.geom_id[k]),
            }
            *z = at - 1e-6;
            true
        });
    }
    Ok(heights)
}
