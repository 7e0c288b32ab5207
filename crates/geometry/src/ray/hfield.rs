//! Height field: two triangles for each cell of the grid, walls down from its border, and the box below it.
//!
//! As MuJoCo's rays see it: triangles from both sides, split along the diagonal from (row, column) to (row + 1,
//! column + 1); the base box, whose upper face at height 0 is seen from inside the ground too; walls up to the line
//! between the heights of two border points.

use super::lanes::{Lanes, Real, none};
use super::mesh::triangle;
use super::placed::{Placed, turned};
use super::tree::Slabs;
use super::{cuboid, unit};
use crate::shape::hfield::{Hfield, STACK};

impl Hfield {
    /// First surface along the rays nearer than `best`.
    #[inline(always)]
    pub(crate) fn hit<L: Lanes>(&self, g: &Placed<L::Real>, d: [L; 3], best: L) -> L {
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
            return unit([-slope_u / dx, -slope_v / dy, 1.0]);
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
