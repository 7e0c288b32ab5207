//! Triangles of meshes and height fields, and coarser ones of the same shape.

use std::collections::{HashMap, HashSet};

use crate::scene::{HfieldView, MeshView};

/// Triangles in the frame of a geom.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Triangles {
    /// m.
    pub(super) vertices: Vec<[f32; 3]>,
    /// Numbers of vertices.
    pub(super) faces: Vec<[u32; 3]>,
}

pub(super) fn of_mesh(mesh: &MeshView) -> Triangles {
    // In a compiled mesh all are; a damaged file may have others.
    let is_whole =
        |f: &&[i32; 3]| f.iter().all(|v| usize::try_from(*v).is_ok_and(|v| v < mesh.vertices_m.len()));
    let faces = mesh.faces.iter().filter(is_whole).map(|f| f.map(|v| v as u32)).collect();
    Triangles { vertices: mesh.vertices_m.to_vec(), faces }
}

/// Top, sides and bottom of a height field, by every row and column, or by fewer so that there are at most so many triangles.
pub(super) fn of_hfield(field: &HfieldView, most: usize) -> Triangles {
    let cells = 2 * field.n_row.saturating_sub(1) * field.n_col.saturating_sub(1);
    let step = ((cells as f64 / most as f64).sqrt().ceil() as usize).max(1);
    let picked = |n: usize| -> Vec<usize> {
        let mut all: Vec<usize> = (0..n).step_by(step).collect();
        if all.last() != Some(&(n - 1)) {
            all.push(n - 1);
        }
        all
    };
    let (rows, columns) = (picked(field.n_row), picked(field.n_col));
    let [half_x, half_y, top, base] = field.size_m;
    let mut vertices = Vec::new();
    for low in [false, true] {
        for r in &rows {
            for c in &columns {
                let x = half_x * (2.0 * *c as f64 / (field.n_col - 1).max(1) as f64 - 1.0);
                let y = half_y * (2.0 * *r as f64 / (field.n_row - 1).max(1) as f64 - 1.0);
                let height = top * f64::from(field.data[r * field.n_col + c]);
                vertices.push([x as f32, y as f32, if low { -base } else { height } as f32]);
            }
        }
    }
    let (n_rows, n_columns) = (rows.len(), columns.len());
    let at = |r: usize, c: usize| (r * n_columns + c) as u32;
    let under = (n_rows * n_columns) as u32;
    let mut faces = Vec::new();
    for r in 0..n_rows - 1 {
        for c in 0..n_columns - 1 {
            let [a, b, d, e] = [at(r, c), at(r, c + 1), at(r + 1, c), at(r + 1, c + 1)];
            faces.extend([[a, b, e], [a, e, d]]);
        }
    }
    let mut wall = |a: u32, b: u32| faces.extend([[a, a + under, b + under], [a, b + under, b]]);
    for c in 0..n_columns - 1 {
        wall(at(0, c), at(0, c + 1));
        wall(at(n_rows - 1, c + 1), at(n_rows - 1, c));
    }
    for r in 0..n_rows - 1 {
        wall(at(r + 1, 0), at(r, 0));
        wall(at(r, n_columns - 1), at(r + 1, n_columns - 1));
    }
    let corners = [at(0, 0), at(0, n_columns - 1), at(n_rows - 1, 0), at(n_rows - 1, n_columns - 1)];
    let [a, b, d, e] = corners.map(|v| v + under);
    faces.extend([[a, e, b], [a, d, e]]);
    Triangles { vertices, faces }
}

/// The same shape by at most about so many triangles: vertices of one cell of a grid become one in their middle, triangles that fall
/// together go. The grid is made coarser until it is enough.
pub(super) fn decimated(of: &Triangles, most: usize) -> Triangles {
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for v in &of.vertices {
        for k in 0..3 {
            low[k] = low[k].min(v[k]);
            high[k] = high[k].max(v[k]);
        }
    }
    let size = (0..3).map(|k| high[k] - low[k]).fold(0.0, f32::max).max(1e-9);
    // A surface of n × n cells has about 2 n² triangles.
    let mut cells = (most as f32).sqrt().max(2.0);
    let mut best = of.clone();
    while best.faces.len() > most && cells >= 1.0 {
        best = clustered(of, low, size / cells);
        cells *= 0.8;
    }
    best
}

fn clustered(of: &Triangles, low: [f32; 3], edge: f32) -> Triangles {
    let mut cells: HashMap<[i32; 3], u32> = HashMap::new();
    let mut sums: Vec<([f64; 3], f64)> = Vec::new();
    let number: Vec<u32> = of
        .vertices
        .iter()
        .map(|v| {
            let key = [0, 1, 2].map(|k| ((v[k] - low[k]) / edge) as i32);
            let n = *cells.entry(key).or_insert_with(|| {
                sums.push(([0.0; 3], 0.0));
                (sums.len() - 1) as u32
            });
            let (sum, count) = &mut sums[n as usize];
            (0..3).for_each(|k| sum[k] += f64::from(v[k]));
            *count += 1.0;
            n
        })
        .collect();
    let mut there = HashSet::new();
    let faces = of
        .faces
        .iter()
        .map(|f| f.map(|v| number[v as usize]))
        .filter(|[a, b, c]| a != b && b != c && a != c)
        .filter(|f| {
            let mut sorted = *f;
            sorted.sort_unstable();
            there.insert(sorted)
        })
        .collect();
    let vertices = sums.iter().map(|(sum, n)| sum.map(|s| (s / n) as f32)).collect();
    Triangles { vertices, faces }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn volume(t: &Triangles) -> f64 {
        let at = |v: u32| t.vertices[v as usize].map(f64::from);
        let part = |f: &[u32; 3]| {
            let [a, b, c] = f.map(at);
            let cross = [b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]];
            (a[0] * cross[0] + a[1] * cross[1] + a[2] * cross[2]) / 6.0
        };
        t.faces.iter().map(part).sum()
    }

    #[test]
    fn a_height_field_is_a_closed_body_of_its_volume() {
        let data = vec![0.5f32; 12];
        let field = HfieldView { name: "h", n_row: 3, n_col: 4, size_m: [2.0, 1.0, 0.4, 0.1], data: &data };
        let whole = of_hfield(&field, 1000);
        assert!((volume(&whole) - 4.0 * 2.0 * 0.3).abs() < 1e-6, "{}", volume(&whole));
        let coarse = of_hfield(&field, 4);
        assert!(coarse.faces.len() < whole.faces.len());
        assert!((volume(&coarse) - 4.0 * 2.0 * 0.3).abs() < 1e-6, "{}", volume(&coarse));
    }

    #[test]
    fn a_coarser_mesh_keeps_its_shape() {
        let (n, data) = (101usize, vec![0.5f32; 101 * 101]);
        let field = HfieldView { name: "h", n_row: n, n_col: n, size_m: [1.0, 1.0, 1.0, 0.5], data: &data };
        let whole = of_hfield(&field, 1_000_000);
        let coarse = decimated(&whole, 2000);
        assert!(coarse.faces.len() <= 2000 && coarse.faces.len() > 200, "{}", coarse.faces.len());
        assert!((volume(&coarse) / volume(&whole) - 1.0).abs() < 0.15, "{}", volume(&coarse));
    }
}
