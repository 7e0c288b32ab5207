//! A field of signed distances on a regular grid, and its interpolation.

use crate::GeometryError;
use fearless_simd::{Simd, dispatch};
use propwash_trace::Real;
use propwash_trace::lanes::{Cell, F32x16, level, vectorize};

/// A regular grid of points along the world's axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FieldGrid {
    /// First point, with the lowest coordinates, m.
    pub origin_m: [f64; 3],
    /// Distance of neighbours along each axis, m.
    pub resolution_m: f64,
    /// Points along x, y and z; at least 2 each.
    pub counts: [usize; 3],
}

impl FieldGrid {
    /// The grid from the lower corner of a box to its upper corner or, where the resolution does not divide it, less than one cell beyond.
    ///
    /// # Errors
    /// [`GeometryError::Parameter`] for corners that are no box, a resolution that is not above 0, and a grid of more than `most_bytes` bytes, four for each
    /// point.
    pub fn over(bounds_m: [[f64; 3]; 2], resolution_m: f64, most_bytes: u64) -> Result<Self, GeometryError> {
        let fail = |what: String| Err(GeometryError::Parameter { what });
        if !(resolution_m.is_finite() && resolution_m > 0.0) {
            return fail(format!(
                "resolution: expected a finite number of metres above 0, got {resolution_m}"
            ));
        }
        let [low, high] = bounds_m;
        if !(0..3).all(|k| low[k].is_finite() && high[k].is_finite() && low[k] < high[k]) {
            return fail(format!(
                "bounds: expected two corners of a box, the lower one first, finite and in m; got {low:?} and {high:?}"
            ));
        }
        let cells = [0, 1, 2].map(|k| ((high[k] - low[k]) / resolution_m - 1e-6).ceil().max(1.0));
        let bytes = 4.0 * cells.iter().map(|n| n + 1.0).product::<f64>();
        if bytes > most_bytes as f64 {
            let (mib, most) = (bytes / 1_048_576.0, most_bytes as f64 / 1_048_576.0);
            return fail(format!(
                "a field of {} x {} x {} points takes {mib:.0} MiB, more than the {most:.0} MiB that are allowed; give smaller bounds, a coarser resolution, or \
                 allow more memory",
                cells[0] + 1.0,
                cells[1] + 1.0,
                cells[2] + 1.0
            ));
        }
        Ok(Self { origin_m: low, resolution_m, counts: cells.map(|n| n as usize + 1) })
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.counts.iter().product()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// A point, m.
    pub fn point(&self, index: [usize; 3]) -> [f64; 3] {
        [0, 1, 2].map(|k| self.origin_m[k] + self.resolution_m * index[k] as f64)
    }

    /// Upper corner, m.
    pub fn end_m(&self) -> [f64; 3] {
        self.point(self.counts.map(|n| n.saturating_sub(1)))
    }
}

/// Value and slopes of the trilinear interpolation between the eight corners of a cell, by its coordinates `at`, 0 to 1 along x, y and z.
/// Corners are in the order 000, 001, 010, 011, 100 … of (x, y, z).
#[inline(always)]
pub fn trilinear<S: Real>(corners: [S; 8], at: [S; 3]) -> (S, [S; 3]) {
    let mix = |a: S, b: S, t: S| a + t * (b - a);
    let [c0, c1, c2, c3, c4, c5, c6, c7] = corners;
    let [x, y, z] = at;
    // Along x first, then y, then z.
    let (e0, e1, e2, e3) = (mix(c0, c4, x), mix(c1, c5, x), mix(c2, c6, x), mix(c3, c7, x));
    let (f0, f1) = (mix(e0, e2, y), mix(e1, e3, y));
    let by_x = mix(mix(c4 - c0, c6 - c2, y), mix(c5 - c1, c7 - c3, y), z);
    let by_y = mix(e2 - e0, e3 - e1, z);
    (mix(f0, f1, z), [by_x, by_y, f1 - f0])
}

/// Signed distances on a grid: how far it is to the nearest thing, negative inside of it.
///
/// Between the points of the grid it is their trilinear interpolation. Since a distance changes no faster than the point moves, that is at most √3/2
/// cells off, and exact near flat surfaces that no edge is near to.
///
/// Outside of the grid it is √(d² + g²), or d + g where d < 0, with the distance d at the nearest point of the grid's border and the distance g to there: never more than the true
/// distance to anything that lies within the grid, and never less than its √½. Endless planes are known everywhere. What else lies outside is not known.
#[derive(Clone, Debug, PartialEq)]
pub struct DistanceField {
    grid: FieldGrid,
    /// (x, y, z), z fastest.
    data: Vec<f32>,
    planes: Vec<[f64; 4]>,
    zero_inside: Vec<u32>,
}

impl DistanceField {
    /// From distances at the points of a grid, (x, y, z) with z fastest, m; endless planes, each as its upward unit normal and the distance of the origin below
    /// it (n · p − offset is the distance); and the geoms of whose inside nothing but 0 is known.
    ///
    /// # Errors
    /// [`GeometryError::Parameter`] for numbers that are not finite, another number of distances than points, and fewer than two points along an axis.
    pub fn new(
        grid: FieldGrid,
        data: Vec<f32>,
        planes: Vec<[f64; 4]>,
        zero_inside: Vec<u32>,
    ) -> Result<Self, GeometryError> {
        let fail = |what: String| Err(GeometryError::Parameter { what });
        if grid.counts.iter().any(|n| *n < 2) {
            return fail(format!(
                "a field needs at least 2 points along each axis, got {} x {} x {}",
                grid.counts[0], grid.counts[1], grid.counts[2]
            ));
        }
        if !(grid.resolution_m.is_finite() && grid.resolution_m > 0.0) {
            return fail(format!(
                "resolution: expected a finite number of metres above 0, got {}",
                grid.resolution_m
            ));
        }
        if !grid.origin_m.iter().chain(planes.iter().flatten()).all(|v| v.is_finite()) {
            return fail(format!(
                "origin and planes: expected finite numbers, got {:?} and {planes:?}",
                grid.origin_m
            ));
        }
        if data.len() != grid.len() {
            return fail(format!(
                "distances: expected {} of {:?}, got {}",
                grid.len(),
                grid.counts,
                data.len()
            ));
        }
        if u32::try_from(data.len()).is_err() {
            return fail(format!("distances: expected less than 2^32, got {}", data.len()));
        }
        if let Some(at) = data.iter().position(|d| !d.is_finite()) {
            return fail(format!("distances: expected finite numbers, got {} at place {at}", data[at]));
        }
        Ok(Self { grid, data, planes, zero_inside })
    }

    /// Where its points are.
    pub fn grid(&self) -> &FieldGrid {
        &self.grid
    }

    /// Distances at the points, (x, y, z) with z fastest, m.
    pub fn data(&self) -> &[f32] {
        &self.data
    }

    /// Endless planes: unit normal and offset each, m.
    pub fn planes(&self) -> &[[f64; 4]] {
        &self.planes
    }

    /// Geoms inside of which the distance is 0, since how deep a point is there is not known: height fields, and meshes whose hull has no faces.
    pub fn zero_inside(&self) -> &[u32] {
        &self.zero_inside
    }

    /// Place of the first of the corners of cell (i, j, k), and steps to the next along x and y.
    #[inline(always)]
    fn corner(&self, cell: [usize; 3]) -> (usize, usize, usize) {
        let [_, ny, nz] = self.grid.counts;
        ((cell[0] * ny + cell[1]) * nz + cell[2], ny * nz, nz)
    }

    /// Distance at a point, m, and its slopes along x, y and z: those of the interpolation, exactly. NaN for a point that is not a number.
    pub fn at(&self, point_m: [f64; 3]) -> (f64, [f64; 3]) {
        let grid = &self.grid;
        let (mut cell, mut t, mut gap) = ([0usize; 3], [0.0; 3], [0.0; 3]);
        for k in 0..3 {
            let u = (point_m[k] - grid.origin_m[k]) / grid.resolution_m;
            let held = u.clamp(0.0, (grid.counts[k] - 1) as f64);
            cell[k] = (held as usize).min(grid.counts[k] - 2);
            (t[k], gap[k]) = (held - cell[k] as f64, (u - held) * grid.resolution_m);
        }
        let (at, x, y) = self.corner(cell);
        let d = &self.data;
        let corners = [0, 1, y, y + 1, x, x + 1, x + y, x + y + 1].map(|step| f64::from(d[at + step]));
        let (value, slopes) = trilinear(corners, t);
        let mut slopes = slopes.map(|s| s / grid.resolution_m);
        let square: f64 = gap.iter().map(|g| g * g).sum();
        if square == 0.0 {
            return (value, slopes);
        }
        // Outside: the border's value changes along the axes in which the point is not outside.
        let far = if value > 0.0 { (value * value + square).sqrt() } else { value + square.sqrt() };
        for k in 0..3 {
            let inner = if gap[k] == 0.0 { slopes[k] } else { 0.0 };
            slopes[k] = match value > 0.0 {
                true => (value * inner + gap[k]) / far,
                false => inner + gap[k] / square.sqrt(),
            };
        }
        self.planes.iter().fold((far, slopes), |best, [a, b, c, offset]| {
            let d = a * point_m[0] + b * point_m[1] + c * point_m[2] - offset;
            if d < best.0 { (d, [*a, *b, *c]) } else { best }
        })
    }

    /// The same for sixteen points, in f32.
    pub fn at_lanes(&self, pos_m: &[F32x16; 3]) -> (F32x16, [F32x16; 3]) {
        dispatch!(level(), simd => self.lanes_at(simd, pos_m))
    }

    /// The distances alone.
    pub fn distance_lanes(&self, pos_m: &[F32x16; 3]) -> F32x16 {
        dispatch!(level(), simd => self.distance_at(simd, pos_m))
    }

    #[inline(always)]
    fn distance_at<S: Simd>(&self, simd: S, pos_m: &[F32x16; 3]) -> F32x16 {
        vectorize(
            simd,
            #[inline(always)]
            || self.lanes(pos_m).0,
        )
    }

    #[inline(always)]
    fn lanes_at<S: Simd>(&self, simd: S, pos_m: &[F32x16; 3]) -> (F32x16, [F32x16; 3]) {
        vectorize(
            simd,
            #[inline(always)]
            || self.lanes(pos_m),
        )
    }

    #[inline(always)]
    fn lanes(&self, pos_m: &[F32x16; 3]) -> (F32x16, [F32x16; 3]) {
        const N: usize = F32x16::LANES;
        let grid = &self.grid;
        let inverse = (1.0 / grid.resolution_m) as f32;
        let (mut cell, mut t, mut inside) = ([[0u32; N]; 3], [[0f32; N]; 3], true);
        for k in 0..3 {
            let (origin, most) = (grid.origin_m[k] as f32, (grid.counts[k] - 1) as f32);
            for lane in 0..N {
                let u = (pos_m[k].0[lane] - origin) * inverse;
                inside &= u >= 0.0 && u <= most;
                let whole = u.max(0.0).min(most - 1.0).floor();
                cell[k][lane] = whole as u32;
                t[k][lane] = u - whole;
            }
        }
        let (mut value, mut slopes) = (F32x16::splat(0.0), [F32x16::splat(0.0); 3]);
        if !inside {
            // Rare: one by one.
            for lane in 0..N {
                let (d, g) = self.at([0, 1, 2].map(|k| f64::from(pos_m[k].0[lane])));
                value.0[lane] = d as f32;
                (0..3).for_each(|k| slopes[k].0[lane] = g[k] as f32);
            }
            return (value, slopes);
        }
        let [_, ny, nz] = grid.counts.map(|n| n as u32);
        let mut at = [0u32; N];
        for lane in 0..N {
            at[lane] = (cell[0][lane] * ny + cell[1][lane]) * nz + cell[2][lane];
        }
        // Four columns of two neighbours along z each.
        let (x, y) = ((ny * nz) as usize, nz as usize);
        let mut corners = [[0f32; N]; 8];
        for (pair, step) in [0, y, x, x + y].into_iter().enumerate() {
            let column = &self.data[step..];
            for lane in 0..N {
                let from = at[lane] as usize;
                let two = &column[from..from + 2];
                (corners[2 * pair][lane], corners[2 * pair + 1][lane]) = (two[0], two[1]);
            }
        }
        // Spelled out: what a closure returns is not computed in lanes.
        let [c0, c1, c2, c3, c4, c5, c6, c7] = &corners;
        let [tx, ty, tz] = &t;
        for i in 0..N {
            let all = [c0[i], c1[i], c2[i], c3[i], c4[i], c5[i], c6[i], c7[i]];
            let (d, g) = trilinear(all, [tx[i], ty[i], tz[i]]);
            value.0[i] = d;
            slopes[0].0[i] = g[0] * inverse;
            slopes[1].0[i] = g[1] * inverse;
            slopes[2].0[i] = g[2] * inverse;
        }
        (value, slopes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Key, purpose};

    fn wavy() -> DistanceField {
        let grid = FieldGrid { origin_m: [-1.0, 0.5, 2.0], resolution_m: 0.1, counts: [7, 5, 9] };
        let data = (0..grid.len()).map(|i| 0.1 + 0.2 * ((i as f32) * 0.61).sin()).collect();
        DistanceField::new(grid, data, vec![[0.0, 0.0, 1.0, 1.2]], vec![]).unwrap()
    }

    #[test]
    fn slopes_are_those_of_differences_inside_and_outside_of_the_grid() {
        let field = wavy();
        let mut s = Key { seed: 1, world: 0, drone: 0, step: 0, purpose: purpose("field") }.stream();
        let (mut outside, mut planes) = (0, 0);
        for _ in 0..4000 {
            let p = [s.uniform(-1.4, -0.1), s.uniform(0.1, 1.3), s.uniform(1.0, 3.2)];
            let (value, slopes) = field.at(p);
            let end = field.grid().end_m();
            outside += usize::from((0..3).any(|k| p[k] < field.grid().origin_m[k] || p[k] > end[k]));
            planes += usize::from((value - (p[2] - 1.2)).abs() < 1e-12);
            for k in 0..3 {
                let step = 1e-6;
                let moved = |by: f64| {
                    let mut q = p;
                    q[k] += by;
                    field.at(q).0
                };
                let (back, on) = ((value - moved(-step)) / step, (moved(step) - value) / step);
                // Where cells meet the slope is that of one of them.
                let off = (back - slopes[k]).abs().min((on - slopes[k]).abs());
                assert!(off < 1e-3 + 0.1 * (back - on).abs(), "{p:?} {k}: {slopes:?} {back} {on}");
            }
        }
        assert!(outside > 1000 && planes > 100, "{outside} {planes}");
    }

    #[test]
    fn sixteen_points_at_once_are_the_same_as_one_by_one() {
        let field = wavy();
        let mut s = Key { seed: 2, world: 0, drone: 0, step: 0, purpose: purpose("field") }.stream();
        for round in 0..200 {
            let spread = if round % 2 == 0 { 0.0 } else { 0.5 };
            let (low, high) = (field.grid().origin_m, field.grid().end_m());
            let mut pos = [F32x16::splat(0.0); 3];
            for k in 0..3 {
                for lane in 0..F32x16::LANES {
                    pos[k].set(lane, s.uniform(low[k] - spread + 1e-3, high[k] + spread - 1e-3) as f32);
                }
            }
            let (value, slopes) = field.at_lanes(&pos);
            assert_eq!(value.0, field.distance_lanes(&pos).0);
            for lane in 0..F32x16::LANES {
                let (d, g) = field.at([0, 1, 2].map(|k| f64::from(pos[k].get(lane))));
                assert!((f64::from(value.get(lane)) - d).abs() < 1e-5, "{d} {value:?}");
                for k in 0..3 {
                    // Slopes jump where cells meet, where f32 may take the other one.
                    let off = (f64::from(slopes[k].get(lane)) - g[k]).abs();
                    assert!(off < 2e-3 || near_border(&field, &pos, lane), "{g:?} {slopes:?}");
                }
            }
        }
        let mut pos = [F32x16::splat(0.7); 3];
        pos[1].set(3, f32::NAN);
        let (value, _) = field.at_lanes(&pos);
        assert!(value.get(3).is_nan() && value.get(2).is_finite());
    }

    fn near_border(field: &DistanceField, pos: &[F32x16; 3], lane: usize) -> bool {
        (0..3).any(|k| {
            let u = (f64::from(pos[k].get(lane)) - field.grid().origin_m[k]) / field.grid().resolution_m;
            (u - u.round()).abs() < 1e-4
        })
    }

    #[test]
    fn a_field_is_continuous_and_refuses_what_is_none() {
        let field = wavy();
        // Across the border of the grid.
        for (x, out) in [(-1.0, -1e-9), (-0.4, 1e-9)] {
            let at = |x: f64| field.at([x, 0.77, 2.31]).0;
            assert!((at(x) - at(x + out)).abs() < 1e-8);
        }
        let grid = FieldGrid::over([[0.0; 3], [1.0, 0.5, 0.2]], 0.1, 1 << 20).unwrap();
        assert_eq!((grid.counts, grid.len()), ([11, 6, 3], 198));
        assert!(!grid.is_empty());
        let refused = [
            FieldGrid::over([[0.0; 3], [1.0; 3]], 0.001, 1 << 20).map(|_| ()),
            FieldGrid::over([[0.0; 3], [1.0; 3]], 1e-300, 1 << 20).map(|_| ()),
            FieldGrid::over([[0.0; 3], [1.0; 3]], f64::NAN, 1 << 20).map(|_| ()),
            FieldGrid::over([[0.0, 1.0, 0.0], [1.0; 3]], 0.1, 1 << 20).map(|_| ()),
            DistanceField::new(grid, vec![0.0; 197], vec![], vec![]).map(|_| ()),
            DistanceField::new(grid, vec![f32::INFINITY; 198], vec![], vec![]).map(|_| ()),
            DistanceField::new(grid, vec![0.0; 198], vec![[f64::NAN; 4]], vec![]).map(|_| ()),
            DistanceField::new(FieldGrid { counts: [198, 1, 1], ..grid }, vec![0.0; 198], vec![], vec![])
                .map(|_| ()),
        ];
        for (k, result) in refused.into_iter().enumerate() {
            let Err(GeometryError::Parameter { what }) = result else { panic!("{k} was taken") };
            assert!(what.contains("expected") || what.contains("needs") || what.contains("MiB"), "{what}");
        }
    }
}
