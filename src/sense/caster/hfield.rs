//! Height field: two triangles for each cell of the grid, walls down from its border, and the box below it.
//!
//! As MuJoCo's rays see it: triangles from both sides, split along the diagonal from (row, column) to (row + 1,
//! column + 1); the base box, whose upper face at height 0 is seen from inside the ground too; walls up to the line
//! between the heights of two border points.
//!
//! The walk descends a pyramid of least and greatest heights over blocks of 2ⁿ × 2ⁿ cells: eight bytes for a cell and a
//! third more for all coarser levels, where a tree over triangles would take some sixty.

use super::bvh::Slabs;
use super::cuboid;
use super::lanes::{Lanes, Real, none};
use super::mesh::triangle;
use super::placed::{Placed, turned};

/// A height field with its pyramid.
#[derive(Debug)]
pub(in super::super) struct Hfield {
    n_row: usize,
    n_col: usize,
    /// Half size in x and y, top and depth of the base, m.
    size: [f64; 4],
    /// Places of the columns and rows, m.
    x: Vec<f64>,
    y: Vec<f64>,
    /// Heights, m, (row, column).
    z: Vec<f64>,
    levels: Vec<Level>,
}

/// Least and greatest height of blocks of cells.
#[derive(Debug)]
struct Level {
    rows: usize,
    cols: usize,
    range: Vec<[f32; 2]>,
}

/// Blocks that wait: at most three for each level, and one; enough for 2²⁰ cells in a row.
const STACK: usize = 64;

impl Hfield {
    /// `size`: half sizes, height of 1, depth of the base. None for a grid without cells.
    pub fn new(n_row: usize, n_col: usize, size: [f64; 4], data: &[f32]) -> Option<Self> {
        if n_row < 2 || n_col < 2 || data.len() != n_row * n_col {
            return None;
        }
        let (dx, dy) = (2.0 * size[0] / (n_col - 1) as f64, 2.0 * size[1] / (n_row - 1) as f64);
        let x: Vec<f64> = (0..n_col).map(|c| dx * c as f64 - size[0]).collect();
        let y: Vec<f64> = (0..n_row).map(|r| dy * r as f64 - size[1]).collect();
        let z: Vec<f64> = data.iter().map(|h| f64::from(*h) * size[2]).collect();
        let mut range = Vec::with_capacity((n_row - 1) * (n_col - 1));
        for r in 0..n_row - 1 {
            for c in 0..n_col - 1 {
                let k = r * n_col + c;
                let four = [z[k], z[k + 1], z[k + n_col], z[k + n_col + 1]];
                let lo = four.iter().fold(f64::INFINITY, |a, h| a.min(*h)) as f32;
                let hi = four.iter().fold(f64::NEG_INFINITY, |a, h| a.max(*h)) as f32;
                range.push([lo.next_down(), hi.next_up()]);
            }
        }
        let mut levels = vec![Level { rows: n_row - 1, cols: n_col - 1, range }];
        loop {
            let below = &levels[levels.len() - 1];
            if below.rows == 1 && below.cols == 1 {
                break;
            }
            let (rows, cols) = (below.rows.div_ceil(2), below.cols.div_ceil(2));
            let mut range = vec![[f32::INFINITY, f32::NEG_INFINITY]; rows * cols];
            for r in 0..below.rows {
                for c in 0..below.cols {
                    let from = below.range[r * below.cols + c];
                    let to = &mut range[(r / 2) * cols + c / 2];
                    *to = [to[0].min(from[0]), to[1].max(from[1])];
                }
            }
            levels.push(Level { rows, cols, range });
        }
        Some(Self { n_row, n_col, size, x, y, z, levels })
    }

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

    /// First surface along the rays nearer than `best`.
    #[inline(always)]
    pub(super) fn hit<L: Lanes>(&self, g: &Placed<L::Real>, d: [L; 3], best: L) -> L {
        let d = turned(g, d);
        let mut t = best;
        self.base(g, d, &mut t);
        self.walls(g, d, &mut t);
        self.ground(g, d, &mut t);
        L::pick(t.lt(best), t, none(t))
    }

    #[inline(always)]
    fn base<L: Lanes>(&self, g: &Placed<L::Real>, d: [L; 3], best: &mut L) {
        let half = 0.5 * self.size[3];
        let at = [g.at64[0], g.at64[1], g.at64[2] + half];
        let size = [self.size[0], self.size[1], half];
        let inside = at[0].abs() < size[0] && at[1].abs() < size[1] && at[2].abs() < size[2];
        let faces = cuboid::Faces {
            at: real3(at),
            size: real3(size),
            up: real3([size[0] - at[0], size[1] - at[1], size[2] - at[2]]),
            down: real3([-size[0] - at[0], -size[1] - at[1], -size[2] - at[2]]),
            inside,
        };
        let t = cuboid::hit_local::<L>(&faces, d);
        *best = best.min(t);
    }

    /// The four sides above height 0.
    #[inline(always)]
    fn walls<L: Lanes>(&self, g: &Placed<L::Real>, d: [L; 3], best: &mut L) {
        let zero = d[0].lit(0.0);
        for side in 0..4 {
            let (i, j) = (side / 2, 1 - side / 2);
            let face = if side % 2 == 0 { -self.size[i] } else { self.size[i] };
            let t = d[0].lit(face - g.at64[i]) / super::lanes::away_from_zero(d[i]);
            let along = t.fma(d[j], d[0].all(g.at[j]));
            let z = t.fma(d[2], d[0].all(g.at[2]));
            let ok = zero.le(t)
                & t.lt(*best)
                & along.abs().le(d[0].lit(self.size[j]))
                & zero.le(z)
                & z.le(d[0].lit(self.size[2]));
            let bits = L::bits(ok);
            for k in 0..L::N {
                if bits & (1 << k) != 0 && z.lane(k) < L::Real::of(self.border(side, along.lane(k))) {
                    best.set(k, t.lane(k));
                }
            }
        }
    }

    /// Height of the border at a place along it.
    #[inline(always)]
    fn border<R: Real>(&self, side: usize, along: R) -> f64 {
        let (places, j) = if side < 2 { (&self.y, 1) } else { (&self.x, 0) };
        let cells = places.len() - 1;
        let step = 2.0 * self.size[j] / cells as f64;
        let u = (along.wide() + self.size[j]) / step;
        let k = (u.max(0.0) as usize).min(cells - 1);
        let f = u - k as f64;
        let (a, b) = match side {
            0 => (k * self.n_col, (k + 1) * self.n_col),
            1 => (k * self.n_col + self.n_col - 1, (k + 1) * self.n_col + self.n_col - 1),
            2 => (k, k + 1),
            _ => ((self.n_row - 1) * self.n_col + k, (self.n_row - 1) * self.n_col + k + 1),
        };
        self.z[a] * (1.0 - f) + self.z[b] * f
    }

    #[inline(always)]
    fn ground<L: Lanes>(&self, g: &Placed<L::Real>, d: [L; 3], best: &mut L) {
        let size = self.size[0].abs() + self.size[1].abs() + self.size[2].abs();
        let size = size + g.at64[0].abs() + g.at64[1].abs() + g.at64[2].abs();
        let pad = if <L::Real as Real>::IS_F32 { 1e-6 * size } else { 1e-12 * size };
        // Boxes are made relative to the origin in f64 already.
        let nought = <L::Real as Real>::of(0.0);
        let slabs = Slabs::<L>::new([nought; 3], d, L::Real::of(pad));
        let mut stack = [(0u8, 0u32, 0u32); STACK];
        let top = self.levels.len() - 1;
        stack[0] = (top as u8, 0, 0);
        let mut depth = 1;
        // The block that a leading ray meets first is pushed last.
        let (back_x, back_y) = (u32::from(!slabs.runs_back(0)), u32::from(!slabs.runs_back(1)));
        while depth > 0 {
            depth -= 1;
            let (n, r, c) = stack[depth];
            let level = &self.levels[n as usize];
            let range = level.range[r as usize * level.cols + c as usize];
            let (r0, c0) = ((r as usize) << n, (c as usize) << n);
            let (r1, c1) = ((r0 + (1 << n)).min(self.n_row - 1), (c0 + (1 << n)).min(self.n_col - 1));
            let min = [self.x[c0] - g.at64[0], self.y[r0] - g.at64[1], f64::from(range[0]) - g.at64[2]];
            let max = [self.x[c1] - g.at64[0], self.y[r1] - g.at64[1], f64::from(range[1]) - g.at64[2]];
            let (_, meets) = slabs.enter(real3::<L::Real>(min), real3::<L::Real>(max), *best);
            if !L::any(meets) {
                continue;
            }
            if n == 0 {
                self.cell(g, d, r0, c0, best);
                continue;
            }
            let below = &self.levels[n as usize - 1];
            for k in 0..4u32 {
                let rr = 2 * r + ((k >> 1) ^ back_y);
                let cc = 2 * c + ((k & 1) ^ back_x);
                if (rr as usize) < below.rows && (cc as usize) < below.cols && depth < STACK {
                    stack[depth] = (n - 1, rr, cc);
                    depth += 1;
                }
            }
        }
    }

    #[inline(always)]
    fn corner<R: Real>(&self, g: &Placed<R>, r: usize, c: usize) -> [R; 3] {
        real3([self.x[c] - g.at64[0], self.y[r] - g.at64[1], self.z[r * self.n_col + c] - g.at64[2]])
    }

    #[inline(always)]
    fn cell<L: Lanes>(&self, g: &Placed<L::Real>, d: [L; 3], r: usize, c: usize, best: &mut L) {
        let a = self.corner(g, r, c);
        let b = self.corner(g, r, c + 1);
        let e = self.corner(g, r + 1, c);
        let f = self.corner(g, r + 1, c + 1);
        // Corners in the order of the grid, which neighbours share.
        *best = triangle(a, b, f, d, *best);
        *best = triangle(a, e, f, d, *best);
    }

    /// Outward normal of what a ray meets at a distance.
    pub fn normal(&self, x: [f64; 3]) -> [f64; 3] {
        let [sx, sy, top, depth] = self.size;
        let tight = 1e-9 * (sx + sy + top + depth);
        let (u, v) = (
            (x[0] + sx) / (2.0 * sx) * (self.n_col - 1) as f64,
            (x[1] + sy) / (2.0 * sy) * (self.n_row - 1) as f64,
        );
        let c = (u.max(0.0) as usize).min(self.n_col - 2);
        let r = (v.max(0.0) as usize).min(self.n_row - 2);
        let (fu, fv) = (u - c as f64, v - r as f64);
        let k = r * self.n_col + c;
        let (a, b, e, f) = (self.z[k], self.z[k + 1], self.z[k + self.n_col], self.z[k + self.n_col + 1]);
        let (slope_u, slope_v) = if fu >= fv { (b - a, f - b) } else { (f - e, e - a) };
        let height = a + slope_u * fu + slope_v * fv;
        if (x[2] - height).abs() <= tight {
            let (dx, dy) = (self.x[c + 1] - self.x[c], self.y[r + 1] - self.y[r]);
            return super::unit([-slope_u / dx, -slope_v / dy, 1.0]);
        }
        if (x[0].abs() - sx).abs() <= tight {
            return [1f64.copysign(x[0]), 0.0, 0.0];
        }
        if (x[1].abs() - sy).abs() <= tight {
            return [0.0, 1f64.copysign(x[1]), 0.0];
        }
        [0.0, 0.0, if x[2] < -0.5 * depth { -1.0 } else { 1.0 }]
    }
}

#[inline(always)]
fn real3<R: Real>(v: [f64; 3]) -> [R; 3] {
    [R::of(v[0]), R::of(v[1]), R::of(v[2])]
}
