//! The convex hull with which a mesh collides.

use crate::vec3::{cross, dot, sub};

/// Up to this many vertices all are looked at; beyond, a search climbs from neighbour to neighbour.
const SCAN: usize = 24;

/// Vertices, who is whose neighbour, and the planes of the faces.
#[derive(Debug, Default)]
pub(crate) struct Hull {
    vertices: Vec<[f64; 3]>,
    /// Neighbours of vertex `v` are `next[first[v]..first[v + 1]]`; both empty where they are not known.
    first: Vec<u32>,
    next: Vec<u32>,
    /// Outward unit normal and offset of each face with area.
    planes: Vec<([f64; 3], f64)>,
}

impl Hull {
    /// From points and the triangles of their convex hull. Without triangles all points are kept, and nothing is known of
    /// the inside.
    pub fn new(points: Vec<[f64; 3]>, faces: &[[i32; 3]]) -> Self {
        let mut used: Vec<i32> = faces.iter().flatten().copied().collect();
        used.sort_unstable();
        used.dedup();
        used.retain(|v| usize::try_from(*v).is_ok_and(|v| v < points.len()));
        if used.is_empty() {
            return Self { vertices: points, ..Self::default() };
        }
        let vertices: Vec<[f64; 3]> = used.iter().map(|v| points[*v as usize]).collect();
        let faces: Vec<[u32; 3]> = faces
            .iter()
            .filter_map(|f| {
                let at = |k: usize| used.binary_search(&f[k]).ok().map(|i| i as u32);
                Some([at(0)?, at(1)?, at(2)?])
            })
            .collect();
        let mut edges: Vec<(u32, u32)> = Vec::with_capacity(6 * faces.len());
        for f in &faces {
            for (a, b) in [(f[0], f[1]), (f[1], f[2]), (f[2], f[0])] {
                edges.push((a, b));
                edges.push((b, a));
            }
        }
        edges.sort_unstable();
        edges.dedup();
        let mut first = vec![0u32; vertices.len() + 1];
        for (a, _) in &edges {
            first[*a as usize + 1] += 1;
        }
        for v in 0..vertices.len() {
            first[v + 1] += first[v];
        }
        let next = edges.iter().map(|e| e.1).collect();
        let n = vertices.len() as f64;
        let middle = vertices.iter().fold([0.0; 3], |m, v| [0, 1, 2].map(|k| m[k] + v[k] / n));
        let planes = faces
            .iter()
            .filter_map(|f| {
                let [a, b, c] = f.map(|v| vertices[v as usize]);
                let normal = cross(sub(b, a), sub(c, a));
                let length = dot(normal, normal).sqrt();
                if !(length > 1e-18) {
                    return None;
                }
                let out = if dot(normal, sub(a, middle)) < 0.0 { -1.0 } else { 1.0 };
                let normal = normal.map(|x| out * x / length);
                Some((normal, dot(normal, a)))
            })
            .collect();
        Self { vertices, first, next, planes }
    }

    pub fn is_empty(&self) -> bool {
        self.vertices.is_empty()
    }

    /// Vertex that is farthest along `d`, and its number; `start` is where the search begins.
    #[inline]
    pub fn farthest(&self, d: [f64; 3], start: u32) -> ([f64; 3], u32) {
        let n = self.vertices.len();
        let mut number = if (start as usize) < n { start } else { 0 };
        let Some(v) = self.vertices.get(number as usize) else { return ([0.0; 3], 0) };
        let mut best = dot(*v, d);
        if n <= SCAN || self.next.is_empty() {
            for (k, v) in self.vertices.iter().enumerate() {
                let along = dot(*v, d);
                if along > best {
                    best = along;
                    number = k as u32;
                }
            }
            return (self.vertices[number as usize], number);
        }
        loop {
            let here = number as usize;
            for &k in &self.next[self.first[here] as usize..self.first[here + 1] as usize] {
                let along = dot(self.vertices[k as usize], d);
                if along > best {
                    best = along;
                    number = k;
                }
            }
            if number as usize == here {
                return (self.vertices[here], number);
            }
        }
    }

    /// Its faces are known, and with them how deep a point is inside.
    pub fn has_faces(&self) -> bool {
        !self.planes.is_empty()
    }

    /// How deep a point is inside: its signed distance to the nearest face and that face's outward normal; none where the
    /// point is outside or the faces are not known.
    pub fn depth(&self, p: [f64; 3]) -> Option<(f64, [f64; 3])> {
        let mut best: Option<(f64, [f64; 3])> = None;
        for (normal, offset) in &self.planes {
            let d = dot(*normal, p) - offset;
            if d > 0.0 {
                return None;
            }
            if best.is_none_or(|b| d > b.0) {
                best = Some((d, *normal));
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Key, purpose};

    /// On an ellipsoid of triangles.
    #[test]
    fn climbing_finds_what_looking_at_all_vertices_finds() {
        let mut points = vec![[0.0, 0.0, 1.4]];
        let mut faces = Vec::new();
        let (rows, cols) = (14, 20);
        for r in 1..rows {
            for c in 0..cols {
                let (a, b) = (
                    std::f64::consts::PI * f64::from(r) / f64::from(rows),
                    std::f64::consts::TAU * f64::from(c) / f64::from(cols),
                );
                points.push([a.sin() * b.cos(), 0.6 * a.sin() * b.sin(), 1.4 * a.cos()]);
            }
        }
        points.push([0.0, 0.0, -1.4]);
        let at = |r: i32, c: i32| match r {
            0 => 0,
            _ if r == rows => 1 + (rows - 1) * cols,
            _ => 1 + (r - 1) * cols + c % cols,
        };
        for r in 0..rows {
            for c in 0..cols {
                if r + 1 < rows {
                    faces.push([at(r, c), at(r + 1, c), at(r + 1, c + 1)]);
                }
                if r > 0 {
                    faces.push([at(r, c), at(r + 1, c + 1), at(r, c + 1)]);
                }
            }
        }
        let climbing = Hull::new(points.clone(), &faces);
        let scanning = Hull::new(points, &[]);
        let mut s = Key { seed: 3, world: 0, drone: 0, step: 0, purpose: purpose("hull") }.stream();
        let mut start = 0;
        for _ in 0..5000 {
            let d = [s.normal(), s.normal(), s.normal()];
            let (a, at) = climbing.farthest(d, start);
            let (b, _) = scanning.farthest(d, 0);
            assert!(dot(a, d) >= dot(b, d) - 1e-12, "{d:?}");
            start = at;
        }
        let (depth, normal) = climbing.depth([0.0, 0.5, 0.0]).unwrap();
        assert!(depth < 0.0 && depth > -0.11 && normal[1] > 0.9, "{depth} {normal:?}");
        assert!(climbing.depth([0.0, 0.7, 0.0]).is_none() && scanning.depth([0.0; 3]).is_none());
    }
}
