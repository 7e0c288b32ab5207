//! From a compiled model to the table of geoms that `geometry` asks.

use super::{GeomInfo, GeomType, Scene};
use crate::geometry::{DroneSource, GeomSource, Poses, ShapeSource, Table};

/// The table of a scene whose geoms stand at `poses`.
pub(super) fn of_scene(scene: &Scene, poses: &Poses) -> Table {
    let inner = &scene.0;
    let drones = inner.drone_body.iter().zip(&inner.drone_geoms).zip(&inner.drone_radius);
    let drones = drones.map(|((body, geoms), radius)| DroneSource {
        body: *body,
        geoms: geoms.clone(),
        radius_m: *radius,
    });
    let geoms = inner.geoms.iter().map(|geom| GeomSource {
        kind: geom.kind,
        size_m: geom.size_m,
        body: geom.body_id,
        drone: geom.drone,
        moves: inner.bodies[geom.body_id].obstacle.is_some(),
        group: geom.group.clamp(0, 5) as usize,
        opaque: geom.alpha != 0.0,
        collides: geom.can_collide(),
        aabb_m: geom.aabb_m,
        bounding_radius_m: geom.bounding_radius_m,
        margin_m: geom.margin_m + geom.gap_m,
        pos_m: poses.geom_pos_m[geom.id],
        mat: &poses.geom_mat[geom.id],
        shape: shape(scene, geom),
    });
    Table::new(geoms, drones.collect(), scene.ccd_tolerance(), mujoco_only(scene))
}

fn shape<'a>(scene: &'a Scene, geom: &GeomInfo) -> ShapeSource<'a> {
    if let Some(mesh) = scene.mesh(geom.id) {
        let hull = scene.mesh_hull(geom.id).unwrap_or_default();
        return ShapeSource::Mesh { vertices_m: mesh.vertices_m, faces: mesh.faces, hull };
    }
    match scene.hfield(geom.id) {
        Some(f) => ShapeSource::Hfield { n_row: f.n_row, n_col: f.n_col, size_m: f.size_m, data: f.data },
        None => ShapeSource::Sizes,
    }
}

/// Why a scene's contacts and distances are left to MuJoCo, if they are.
fn mujoco_only(scene: &Scene) -> Option<&'static str> {
    let odd = |id: &usize| {
        let g = &scene.geoms()[*id];
        g.can_collide() && matches!(g.kind, GeomType::Plane | GeomType::Hfield | GeomType::Sdf)
    };
    if scene.n_flex() > 0 {
        Some("it has flexes")
    } else if scene.0.drone_geoms.iter().flatten().any(odd) {
        Some("a shell has a plane or a field")
    } else {
        scene.special_contacts()
    }
}
