//! Triangle mesh.

use super::bvh::Bvh;
use crate::vec3::{cross, sub};

/// A mesh with its tree.
#[derive(Debug)]
pub(crate) struct Mesh {
    pub bvh: Bvh,
    /// Corners in the order of the leaves, each triangle's corners sorted by their coordinates: neighbours then compute
    /// their common edge from the same numbers, and no ray slips between them.
    pub triangles: Vec<[[f32; 3]; 3]>,
    /// Outward normals, not of unit length, in the order of the leaves.
    pub normals: Vec<[f64; 3]>,
    /// Largest coordinate.
    pub reach: f64,
}

impl Mesh {
    /// From vertices and faces; faces with a vertex that does not exist are left out.
    pub fn new(vertices: &[[f32; 3]], faces: &[[i32; 3]]) -> Self {
        let mut corners = Vec::with_capacity(faces.len());
        for face in faces {
            let get = |k: usize| usize::try_from(face[k]).ok().and_then(|v| vertices.get(v)).copied();
            if let (Some(a), Some(b), Some(c)) = (get(0), get(1), get(2)) {
                corners.push([a, b, c]);
            }
        }
        let bvh = Bvh::new(&corners);
        let mut triangles = Vec::with_capacity(corners.len());
        let mut normals = Vec::with_capacity(corners.len());
        let mut reach = 0.0f64;
        for &t in &bvh.order {
            let mut v = corners[t as usize];
            let wide = v.map(|p| p.map(f64::from));
            normals.push(cross(sub(wide[1], wide[0]), sub(wide[2], wide[0])));
            reach = wide.iter().flatten().fold(reach, |a, x| a.max(x.abs()));
            v.sort_unstable_by(|a, b| {
                a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])).then(a[2].total_cmp(&b[2]))
            });
            triangles.push(v);
        }
        Self { bvh, triangles, normals, reach }
    }
}
