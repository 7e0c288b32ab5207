//! The surface of a signed distance field that has a mesh.

use super::mesh::Mesh;

/// Triangles with their tree, and as they are wound.
#[derive(Debug)]
pub(crate) struct Surface {
    pub mesh: Mesh,
    /// Triangles as the mesh winds them.
    pub triangles: Vec<[[f64; 3]; 3]>,
}

impl Surface {
    /// From vertices and faces; faces with a vertex that does not exist are left out.
    pub fn new(vertices: &[[f32; 3]], faces: &[[i32; 3]]) -> Self {
        let corner = |v: i32| usize::try_from(v).ok().and_then(|v| vertices.get(v));
        let triangle = |f: &[i32; 3]| Some([*corner(f[0])?, *corner(f[1])?, *corner(f[2])?]);
        Self {
            mesh: Mesh::new(vertices, faces),
            triangles: faces.iter().filter_map(triangle).map(|t| t.map(|v| v.map(f64::from))).collect(),
        }
    }
}
