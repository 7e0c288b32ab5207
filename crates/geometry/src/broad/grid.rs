//! Drones in the cells of a grid, for who is near whom.

/// Up to this many drones all are looked at.
const FEW: usize = 8;
/// Rings of cells after which all drones are looked at: this one is far from all others.
const RINGS: i64 = 3;

/// A hashed grid over points. Its memory is kept from one filling to the next.
#[derive(Default)]
pub(crate) struct Grid {
    points: Vec<[f64; 3]>,
    /// Side of a cell, m; 0 where there are few points and no cells.
    side: f64,
    /// Entries of bucket `b` are `entries[start[b]..start[b + 1]]`; the number of buckets is a power of two.
    start: Vec<u32>,
    entries: Vec<([i64; 3], u32)>,
    sorted: Vec<f64>,
}

impl Grid {
    /// Fills the grid with points, in cells of at least `least` m.
    pub fn fill(&mut self, points: impl Iterator<Item = [f64; 3]>, least: f64) {
        self.points.clear();
        self.points.extend(points);
        let n = self.points.len();
        self.side = 0.0;
        if n <= FEW {
            return;
        }
        // About one point for each cell, in the box that holds most: few that are far off do not make cells coarse.
        let mut volume = 1.0;
        for k in 0..3 {
            self.sorted.clear();
            self.sorted.extend(self.points.iter().map(|p| p[k]));
            let (low, high) = (n / 20, n - 1 - n / 20);
            let (_, low, above) = self.sorted.select_nth_unstable_by(low, f64::total_cmp);
            let low = *low;
            let above_high = high - n / 20 - 1;
            let (_, high, _) = above.select_nth_unstable_by(above_high, f64::total_cmp);
            volume *= (*high - low).max(least);
        }
        self.side = (volume / n as f64).cbrt().max(least).max(1e-6);
        let buckets = (2 * n).next_power_of_two();
        self.start.clear();
        self.start.resize(buckets + 1, 0);
        for p in &self.points {
            self.start[bucket(cell_of(*p, self.side), buckets) + 1] += 1;
        }
        for b in 0..buckets {
            self.start[b + 1] += self.start[b];
        }
        self.entries.clear();
        self.entries.resize(n, ([0; 3], 0));
        // Filling moves each start to its end, which is the next one's start: shifted back afterwards.
        for (number, p) in self.points.iter().enumerate() {
            let cell = cell_of(*p, self.side);
            let slot = &mut self.start[bucket(cell, buckets)];
            self.entries[*slot as usize] = (cell, number as u32);
            *slot += 1;
        }
        self.start.copy_within(0..buckets, 1);
        self.start[0] = 0;
    }

    fn visit_cell(&self, cell: [i64; 3], visit: &mut impl FnMut(usize, f64), from: [f64; 3]) {
        let buckets = self.start.len() - 1;
        let b = bucket(cell, buckets);
        for (at, number) in &self.entries[self.start[b] as usize..self.start[b + 1] as usize] {
            if *at == cell {
                visit(*number as usize, distance(self.points[*number as usize], from));
            }
        }
    }

    /// Hands out the points within `reach` of a point (and perhaps others), with their distances.
    pub fn within(&self, from: [f64; 3], reach: f64, mut visit: impl FnMut(usize, f64)) {
        // All cells that a ball of that radius meets, unless they are many.
        let few = self.side > 0.0 && reach <= RINGS as f64 * self.side;
        if !few {
            for (number, p) in self.points.iter().enumerate() {
                visit(number, distance(*p, from));
            }
            return;
        }
        let low = cell_of(from.map(|x| x - reach), self.side);
        let high = cell_of(from.map(|x| x + reach), self.side);
        for i in low[0]..=high[0] {
            for j in low[1]..=high[1] {
                for k in low[2]..=high[2] {
                    self.visit_cell([i, j, k], &mut visit, from);
                }
            }
        }
    }

    /// Hands out points, near cells first, as long as a cell may hold one nearer than `reach`; `visit` gives the new reach.
    /// Points may come twice.
    pub fn near(&self, from: [f64; 3], mut reach: f64, mut visit: impl FnMut(usize, f64) -> f64) {
        if self.side > 0.0 {
            let cell = cell_of(from, self.side);
            // From the point to the nearest side of its own cell.
            let inner = (0..3)
                .map(|k| {
                    let low = from[k] - cell[k] as f64 * self.side;
                    low.min(self.side - low).max(0.0)
                })
                .fold(f64::INFINITY, f64::min);
            for ring in 0..=RINGS {
                if ring > 0 && inner + (ring - 1) as f64 * self.side >= reach {
                    return;
                }
                let mut each = |number: usize, far: f64| {
                    if far < reach {
                        reach = visit(number, far);
                    }
                };
                for i in -ring..=ring {
                    for j in -ring..=ring {
                        // Inside the ring only its two ends.
                        let edge = i.abs() == ring || j.abs() == ring;
                        let step = if edge || ring == 0 { 1 } else { 2 * ring };
                        let mut k = -ring;
                        while k <= ring {
                            self.visit_cell([cell[0] + i, cell[1] + j, cell[2] + k], &mut each, from);
                            k += step;
                        }
                    }
                }
            }
        }
        for (number, p) in self.points.iter().enumerate() {
            let far = distance(*p, from);
            if far < reach {
                reach = visit(number, far);
            }
        }
    }
}

fn cell_of(p: [f64; 3], side: f64) -> [i64; 3] {
    p.map(|x| (x / side).floor() as i64)
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    let d = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt()
}

/// Of `buckets`, a power of two.
fn bucket(cell: [i64; 3], buckets: usize) -> usize {
    // Multiplication by odd numbers with many bits, then the high bits.
    let mut h = 0u64;
    for x in cell {
        h = (h ^ x as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        h ^= h >> 29;
    }
    (h >> 7) as usize & (buckets - 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Key, purpose};

    #[test]
    fn what_is_near_is_found_in_any_crowd() {
        let mut s = Key { seed: 4, world: 0, drone: 0, step: 0, purpose: purpose("grid") }.stream();
        let mut grid = Grid::default();
        for case in 0..60 {
            let n = [3, 9, 50, 400][case % 4];
            let size = [0.3, 5.0, 200.0][case % 3];
            let mut points: Vec<[f64; 3]> = (0..n).map(|_| [0; 3].map(|_| s.uniform(-size, size))).collect();
            // One far off, and two in one place.
            points[0] = [1e8, -1e8, 3.0];
            points[1] = points[2];
            grid.fill(points.iter().copied(), 0.1);
            for (number, p) in points.iter().enumerate() {
                let mut nearest = f64::INFINITY;
                grid.near(*p, f64::INFINITY, |other, far| {
                    if other != number {
                        nearest = nearest.min(far);
                    }
                    nearest
                });
                let expected = points.iter().enumerate().filter(|(k, _)| *k != number);
                let expected = expected.map(|(_, q)| distance(*p, *q)).fold(f64::INFINITY, f64::min);
                assert_eq!(nearest, expected);
                for reach in [0.05, 0.1, 1.0, 30.0] {
                    let mut found: Vec<usize> = Vec::new();
                    grid.within(*p, reach, |other, far| {
                        if far <= reach {
                            found.push(other);
                        }
                    });
                    found.sort_unstable();
                    let all = (0..n).filter(|k| distance(points[*k], *p) <= reach);
                    assert_eq!(found, all.collect::<Vec<_>>());
                }
            }
        }
    }
}
