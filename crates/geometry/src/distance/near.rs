//! What of a shape comes near a point: ways down its tree or pyramid.

use crate::shape::bvh::{Bvh, MAX_DEPTH, Node};
use crate::shape::hfield::{Hfield, STACK};
use crate::shape::mesh::Mesh;

impl Bvh {
    /// Hands numbers in `order` to `visit`, near ones first, as long as their box comes nearer to a point than `reach`;
    /// `visit` gives the new reach. Boxes that
    /// hold the point always come. A number may come twice.
    pub fn near(&self, at: [f64; 3], mut reach: f64, mut visit: impl FnMut(usize, f64) -> f64) {
        if self.nodes.is_empty() {
            return;
        }
        let distance = |node: &Node, side: usize| {
            let mut sum = 0.0;
            for k in 0..3 {
                let low = f64::from(node.min[side][k]) - at[k];
                let high = at[k] - f64::from(node.max[side][k]);
                let out = low.max(high).max(0.0);
                sum += out * out;
            }
            sum
        };
        let mut stack = [(0.0, 0u32, 0u8); MAX_DEPTH + 8];
        let mut depth = 1;
        while depth > 0 {
            depth -= 1;
            let (square, child, count) = stack[depth];
            // In a box that holds the point nothing is known of how deep it is.
            if square > 0.0 && !(reach > 0.0 && square < reach * reach) {
                continue;
            }
            if count > 0 {
                for k in child as usize..child as usize + count as usize {
                    reach = visit(k, reach);
                }
                continue;
            }
            let node = &self.nodes[child as usize];
            let near = [distance(node, 0), distance(node, 1)];
            let first = usize::from(near[1] < near[0]);
            // The tree is at most MAX_DEPTH deep.
            for side in [1 - first, first] {
                stack[depth] = (near[side], node.child[side], node.count[side]);
                depth += 1;
            }
        }
    }
}

impl Mesh {
    /// Hands triangles to `visit`, near ones first, as long as their box comes nearer to a point than `reach`; `visit`
    /// gives the new reach.
    pub fn near(&self, at: [f64; 3], reach: f64, mut visit: impl FnMut(&[[f64; 3]; 3]) -> f64) {
        self.bvh.near(at, reach, |k, _| visit(&self.triangles[k].map(|v| v.map(f64::from))));
    }
}

impl Hfield {
    /// Hands the solid prisms below triangles of the ground to `visit`, near ones first, as long as their box comes nearer
    /// to a point than `reach`; `visit` gives the new reach.
    ///
    /// They are what MuJoCo's contacts collide with: two for each cell, from the base up to the heights.
    pub fn near(&self, at: [f64; 3], mut reach: f64, mut visit: impl FnMut(&[[f64; 3]; 6]) -> f64) {
        let base = -self.size[3];
        let square = |n: u8, r: u32, c: u32| {
            let level = &self.levels[n as usize];
            let (r0, c0) = ((r as usize) << n, (c as usize) << n);
            let (r1, c1) = ((r0 + (1 << n)).min(self.n_row - 1), (c0 + (1 << n)).min(self.n_col - 1));
            let top = f64::from(level.range[r as usize * level.cols + c as usize][1]);
            let out = |low: f64, high: f64, x: f64| (low - x).max(x - high).max(0.0);
            let d = [
                out(self.x[c0], self.x[c1], at[0]),
                out(self.y[r0], self.y[r1], at[1]),
                out(base, top, at[2]),
            ];
            d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
        };
        let mut stack = [(0u8, 0u32, 0u32, 0.0); STACK];
        stack[0] = ((self.levels.len() - 1) as u8, 0, 0, 0.0);
        let mut depth = 1;
        while depth > 0 {
            depth -= 1;
            let (n, r, c, far) = stack[depth];
            if !(reach > 0.0 && far < reach * reach) {
                continue;
            }
            if n == 0 {
                let (r, c) = (r as usize, c as usize);
                let corner = |r: usize, c: usize| [self.x[c], self.y[r], self.z[r * self.n_col + c]];
                let (a, d) = (corner(r, c), corner(r + 1, c + 1));
                for other in [corner(r, c + 1), corner(r + 1, c)] {
                    let foot = |v: [f64; 3]| [v[0], v[1], base];
                    reach = visit(&[a, other, d, foot(a), foot(other), foot(d)]);
                }
                continue;
            }
            let below = &self.levels[n as usize - 1];
            let mut parts = [(0u32, 0u32, f64::INFINITY); 4];
            let mut count = 0;
            for k in 0..4 {
                let (rr, cc) = (2 * r + k / 2, 2 * c + k % 2);
                if (rr as usize) < below.rows && (cc as usize) < below.cols {
                    parts[count] = (rr, cc, square(n - 1, rr, cc));
                    count += 1;
                }
            }
            // The nearest goes on top.
            parts[..count].sort_unstable_by(|a, b| b.2.total_cmp(&a.2));
            for &(rr, cc, far) in &parts[..count] {
                if depth < STACK {
                    stack[depth] = (n - 1, rr, cc, far);
                    depth += 1;
                }
            }
        }
    }
}
