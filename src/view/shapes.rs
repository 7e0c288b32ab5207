//! The geoms of a scene for a page: primitives by their sizes, the rest as triangles.

use std::collections::HashMap;

use serde::Serialize;

use super::mesh::{self, Triangles};
use crate::Result;
use crate::math::{quat, vec3};
use crate::page::Array;
use crate::scene::{
    GeomInfo, GeomType, ObstacleInfo, Scene, Worker, contact_verdict, depth_verdict, quat_of_matrix,
};

/// Most triangles of all meshes and height fields of a page.
pub const MAX_TRIANGLES: usize = 200_000;

/// A scene in the data of a page.
#[derive(Clone, Debug, Serialize)]
pub struct Shapes {
    name: String,
    geoms: Vec<Geom>,
    meshes: Vec<Mesh>,
    /// Where the scene has its obstacles: position, m, and attitude x y z w.
    rest: Vec<([f64; 3], [f64; 4])>,
}

/// One geom. Its place is in the frame of what moves it, if anything does: a drone, or an obstacle.
#[derive(Clone, Debug, Serialize)]
struct Geom {
    id: usize,
    name: String,
    kind: GeomType,
    size: [f64; 3],
    pos: [f64; 3],
    quat: [f64; 4],
    rgba: [f32; 4],
    group: i32,
    /// Whether depth images see it, and whether drones can touch it.
    seen: bool,
    touched: bool,
    /// Why not.
    #[serde(skip_serializing_if = "String::is_empty")]
    why: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    mesh: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    drone: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    obstacle: Option<usize>,
}

/// Triangles: vertices, m, by component; faces as numbers of vertices, each less the one before.
#[derive(Clone, Debug, Serialize)]
struct Mesh {
    vertices: Vec<Array>,
    faces: Array,
}

/// The geoms of a scene, with drones at the origin and obstacles where the model places them.
pub(super) fn shapes(scene: &Scene, notes: &mut Vec<String>) -> Result<Shapes> {
    let mut worker = scene.worker()?;
    worker.update()?;
    let (which, mut triangles) = triangles(scene);
    let total: usize = triangles.iter().map(|t| t.faces.len()).sum();
    if total > MAX_TRIANGLES {
        for t in &mut triangles {
            let share = (t.faces.len() as f64 / total as f64 * MAX_TRIANGLES as f64).floor() as usize;
            *t = mesh::decimated(t, share.max(12));
        }
        let left: usize = triangles.iter().map(|t| t.faces.len()).sum();
        notes.push(format!(
            "the scene has {total} triangles; shapes are coarser here, with {left} (sensors use all of them)"
        ));
    }
    let mut geoms = Vec::with_capacity(scene.geoms().len());
    for info in scene.geoms() {
        let (pos, matrix) = worker.geom_pose(info.id)?;
        let place = within(scene, &worker, info, pos, quat_of_matrix(&matrix))?;
        let (depth, contact) = (depth_verdict(info), contact_verdict(info));
        geoms.push(Geom {
            id: info.id,
            name: scene.geom_label(info.id),
            kind: info.kind,
            size: info.size_m.map(rounded),
            pos: place.0.map(rounded),
            quat: place.1.map(rounded),
            rgba: info.rgba,
            group: info.group,
            seen: depth.seen,
            touched: contact.seen,
            why: [depth.reason, contact.reason]
                .into_iter()
                .filter(|r| !r.is_empty())
                .collect::<Vec<_>>()
                .join("; "),
            mesh: which.get(&info.id).copied(),
            drone: info.drone,
            obstacle: scene.bodies()[info.body_id].obstacle,
        });
    }
    let rest = |o: &ObstacleInfo| {
        worker.body_pose(o.body_id).map(|p| (p.pos_m.map(rounded), p.quat_xyzw.map(rounded)))
    };
    let rest = scene.obstacles().iter().map(rest).collect::<Result<_, _>>()?;
    let meshes = triangles.iter().map(encoded).collect();
    // Without the word that messages begin with, and without folders.
    let name = scene.name().trim_start_matches("scene ").trim_matches('\'').trim_start_matches("scene ");
    Ok(Shapes { name: super::title(name.as_ref()), geoms, meshes, rest })
}

/// To the micrometre, so that a page has no digits that nobody sees.
fn rounded(v: f64) -> f64 {
    (v * 1e6).round() / 1e6
}

/// The place of a geom in the frame of the drone or obstacle that carries it; in the world for others.
fn within(
    scene: &Scene,
    worker: &Worker,
    info: &GeomInfo,
    pos: [f64; 3],
    turn: [f64; 4],
) -> Result<([f64; 3], [f64; 4])> {
    let body = match (info.drone, scene.bodies()[info.body_id].obstacle) {
        (Some(drone), _) => scene.drone_body(drone)?,
        (None, Some(obstacle)) => scene.obstacles()[obstacle].body_id,
        (None, None) => return Ok((pos, turn)),
    };
    let frame = worker.body_pose(body)?;
    let from = vec3::sub(pos, frame.pos_m);
    Ok((quat::rotate_inverse(frame.quat_xyzw, from), quat::mul(quat::conjugate(frame.quat_xyzw), turn)))
}

/// The triangles of all geoms that are no primitives, each mesh once, and which geom has which.
fn triangles(scene: &Scene) -> (HashMap<usize, usize>, Vec<Triangles>) {
    let (mut which, mut known, mut all) = (HashMap::new(), HashMap::new(), Vec::new());
    for info in scene.geoms() {
        let made = match info.kind {
            GeomType::Mesh | GeomType::Sdf => scene.mesh(info.id).map(|m| mesh::of_mesh(&m)),
            GeomType::Hfield => scene.hfield(info.id).map(|h| mesh::of_hfield(&h, MAX_TRIANGLES / 2)),
            _ => None,
        };
        let Some(made) = made else { continue };
        let key = (info.kind, info.asset.clone());
        let index = *known.entry(key).or_insert_with(|| {
            all.push(made);
            all.len() - 1
        });
        which.insert(info.id, index);
    }
    (which, all)
}

fn encoded(t: &Triangles) -> Mesh {
    let vertices: Vec<[f64; 3]> = t.vertices.iter().map(|v| v.map(f64::from)).collect();
    let mut before = 0u32;
    let steps = t.faces.iter().flatten().map(|v| {
        let step = v.wrapping_sub(before);
        before = *v;
        step
    });
    Mesh { vertices: super::columns(&vertices), faces: Array::u32(steps).packed() }
}
