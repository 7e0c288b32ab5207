//! Shortest ways around the things of a scene, at one height.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use crate::geometry::DistanceField;

/// Edge of a cell, m.
const CELL_M: f64 = 0.2;

/// How much slower it is to fly where things are nearer than is wanted: so many times at most, in things.
const SLOWEST: f64 = 30.0;

/// Nearer to the target than this the straight way is taken, m.
const STRAIGHT_M: f64 = 0.8;

/// How long it takes to a target from everywhere around it, at unit speed far from things and slower near them.
#[derive(Clone, Debug)]
pub(super) struct Way {
    target_m: [f64; 3],
    low_m: [f64; 2],
    /// Cells along x and y; y runs fastest.
    counts: [usize; 2],
    time: Vec<f64>,
}

impl Way {
    /// To a target, in a box, at the height of the target: ways keep `keep_m` off things where they can. Fast marching (Sethian, "A fast marching level set
    /// method for monotonically advancing fronts", 1996) with the upwind differences of the eikonal equation |∇t| = slowness.
    pub fn to(target_m: [f64; 3], field: &DistanceField, [low, high]: [[f64; 3]; 2], keep_m: f64) -> Self {
        let counts = [0, 1].map(|k| ((high[k] - low[k]) / CELL_M).ceil().max(2.0) as usize);
        let low_m = [low[0], low[1]];
        let slowness = |cell: usize| {
            let at = [cell / counts[1], cell % counts[1]];
            let [x, y] = [0, 1].map(|k| low_m[k] + (at[k] as f64 + 0.5) * CELL_M);
            let short = ((keep_m - field.at([x, y, target_m[2]]).0) / keep_m).clamp(0.0, 1.0);
            1.0 + (SLOWEST - 1.0) * short * short
        };
        let mut way = Self { target_m, low_m, counts, time: vec![f64::INFINITY; counts[0] * counts[1]] };
        let first = [0, 1].map(|k| way.cell(target_m[k], k));
        let first = first[0] * counts[1] + first[1];
        let mut known = vec![false; way.time.len()];
        // Times are not negative, so their bits are in their order.
        let mut front = BinaryHeap::from([(Reverse(0u64), first)]);
        way.time[first] = 0.0;
        while let Some((_, cell)) = front.pop() {
            if std::mem::replace(&mut known[cell], true) {
                continue;
            }
            for near in way.beside(cell).into_iter().flatten().filter(|near| !known[*near]) {
                let [a, b] = way.upwind(near);
                let step = CELL_M * slowness(near);
                let (a, b) = (a.min(b), a.max(b));
                let time = if b - a >= step {
                    a + step
                } else {
                    0.5 * (a + b + (2.0 * step * step - (b - a) * (b - a)).sqrt())
                };
                if time < way.time[near] {
                    way.time[near] = time;
                    front.push((Reverse(time.to_bits()), near));
                }
            }
        }
        way
    }

    /// The cell along an axis that a coordinate lies in, the nearest where it lies in none.
    fn cell(&self, v: f64, axis: usize) -> usize {
        (((v - self.low_m[axis]) / CELL_M).max(0.0) as usize).min(self.counts[axis] - 1)
    }

    /// Neighbours of a cell: before and after it along x, and along y.
    fn beside(&self, cell: usize) -> [Option<usize>; 4] {
        let [nx, ny] = self.counts;
        let (x, y) = (cell / ny, cell % ny);
        [
            (x > 0).then(|| cell - ny),
            (x + 1 < nx).then(|| cell + ny),
            (y > 0).then(|| cell - 1),
            (y + 1 < ny).then(|| cell + 1),
        ]
    }

    /// The lesser time of the neighbours along each axis.
    fn upwind(&self, cell: usize) -> [f64; 2] {
        let [a, b, c, d] = self.beside(cell).map(|near| near.map_or(f64::INFINITY, |near| self.time[near]));
        [a.min(b), c.min(d)]
    }

    /// Slope of the time in a cell, one-sided at the border.
    fn slope(&self, cell: usize) -> [f64; 2] {
        let [a, b, c, d] = self.beside(cell);
        [(a, b), (c, d)].map(|(before, after)| {
            let of = |near: Option<usize>| self.time[near.unwrap_or(cell)];
            of(after) - of(before)
        })
    }

    /// What is to be added to the straight direction from a position to the target, of length 1, for that of the shortest way.
    pub fn detour(&self, pos_m: [f64; 3]) -> [f64; 3] {
        let off: [f64; 3] = core::array::from_fn(|k| self.target_m[k] - pos_m[k]);
        let beside = off[0].hypot(off[1]);
        let length = beside.hypot(off[2]);
        if !(length > STRAIGHT_M && beside > 0.5 * STRAIGHT_M) {
            return [0.0; 3];
        }
        // Between the middles of four cells.
        let at = [0, 1].map(|k| {
            let v = (pos_m[k] - self.low_m[k]) / CELL_M - 0.5;
            let v = v.clamp(0.0, (self.counts[k] - 1) as f64 - 1e-9);
            (v as usize, v.fract())
        });
        let mut slope = [0.0; 2];
        for (dx, dy) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            let share = |(_, part): (usize, f64), d: usize| if d == 0 { 1.0 - part } else { part };
            let own = self.slope((at[0].0 + dx) * self.counts[1] + at[1].0 + dy);
            let weight = share(at[0], dx) * share(at[1], dy);
            (0..2).for_each(|k| slope[k] += weight * own[k]);
        }
        let steep = slope[0].hypot(slope[1]);
        if !(steep > 1e-9 && steep.is_finite()) {
            return [0.0; 3];
        }
        let along = |k: usize| (-slope[k] / steep * beside - off[k]) / length;
        [along(0), along(1), 0.0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{FIELD_MOST_BYTES, Scene, SceneSource};

    #[test]
    fn the_way_leads_through_the_door() {
        // A wall along y at x = 0 with a door at y = 2.
        let xml = "<mujoco><worldbody><geom type='box' size='.05 2.2 2' pos='0 -0.7 1'/><geom type='box' size='.05 .5 2' pos='0 3 1'/></worldbody></mujoco>";
        let scene = Scene::build(&SceneSource::text("door", xml), &[]).unwrap();
        let space = [[-3.0, -3.0, 0.0], [3.0, 3.5, 2.0]];
        let field = scene.distance_field(0.1, Some(space), FIELD_MOST_BYTES).unwrap();
        let way = Way::to([2.0, 0.0, 1.0], &field, space, 0.4);
        // Following the directions leads there, without coming into the wall.
        let mut pos = [-2.0, -1.0, 1.0];
        let mut nearest = f64::INFINITY;
        for step in 0.. {
            assert!(step < 400, "stuck at {pos:?}");
            let off: [f64; 3] = core::array::from_fn(|k| way.target_m[k] - pos[k]);
            let length = off.iter().map(|v| v * v).sum::<f64>().sqrt();
            if length < 0.3 {
                break;
            }
            let detour = way.detour(pos);
            let along: [f64; 3] = core::array::from_fn(|k| off[k] / length + detour[k]);
            let size = along.iter().map(|v| v * v).sum::<f64>().sqrt();
            assert!((size - 1.0).abs() < 1e-9, "{size}");
            (0..3).for_each(|k| pos[k] += 0.05 * along[k]);
            nearest = nearest.min(field.at(pos).0);
        }
        assert!(nearest > 0.2, "{nearest}");
        // Behind the wall it is straight, but for what cells are rough.
        let detour = way.detour([1.0, -1.0, 1.0]);
        assert!(detour.iter().all(|v| v.abs() < 0.1), "{detour:?}");
        assert_eq!(way.detour([1.9, 0.1, 1.0]), [0.0; 3], "near the target");
    }
}
