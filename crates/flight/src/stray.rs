//! Samples far from where their neighbours say that they must be: single ones, short runs, flips that come and go, jumps
//! that stay.
//!
//! A sample is suspicious where the cubic through the two samples on either side misses it. What is suspicious together is
//! then judged by a cubic through sound samples around it, so that the neighbours of an outlier are not marked with it. The
//! scale is the usual miss nearby, so that a stretch of fast flight, or of vibration, is its own measure.

use super::channel::Channel;
use super::clean::median;
use super::resample::rotation_vector;
use nalgebra::{DMatrix, DVector};
use propwash_trace::math::{quat, vec3};

/// Misses beyond this many times the usual one are suspicious. The usual one is a median of lengths in three dimensions, about 1.5
/// standard deviations of an axis. No sample of thirteen real logs (`tests/flight_logs.rs`) comes to 0.6 of that, but for two in
/// a place where an estimator jumps by 6 cm.
const TIMES_USUAL: f64 = 8.0;
/// Samples over which the usual miss is taken.
const BLOCK: usize = 32;
/// Suspicious samples with at most this many others between them belong together: the cubics of four neighbours reach as far.
const TOGETHER: usize = 3;
/// Longest run that is judged by what is around it, samples. Longer ones are events, not outliers.
const LONGEST_RUN: usize = 10;
/// Sound samples on either side by which a run is judged, and how many there must be.
const SIDE: usize = 5;
const LEAST_SIDE: usize = 3;
/// Reach of a judgement, in periods: over gaps nothing is judged.
const REACH_PERIODS: f64 = 30.0;
/// Longest time after which a flip is back, s: motion capture that confuses its markers finds them again within frames.
const LONGEST_FLIP_S: f64 = 0.5;
/// Share of a jump by which the jump back may differ from it.
const JUMP_BACK: f64 = 0.4;

/// What was found in a channel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Strays {
    /// For every sample whether it is an outlier.
    pub marks: Vec<bool>,
    /// Spans, s, over which the channel jumps and stays.
    pub jumps_s: Vec<[f64; 2]>,
}

impl Strays {
    /// Number of outliers.
    pub fn count(&self) -> usize {
        self.marks.iter().filter(|m| **m).count()
    }
}

/// Outliers of a channel of vectors that are off by more than `floor` (its unit).
pub fn of_vectors(c: &Channel<3>, floor: f64) -> Strays {
    look(&c.t_s, &|base, i| vec3::sub(c.values[i], c.values[base]), floor)
}

/// Outliers of attitudes that are off by more than `floor_rad`.
pub fn of_attitudes(c: &Channel<4>, floor_rad: f64) -> Strays {
    let unit: Vec<[f64; 4]> = c.values.iter().map(|q| quat::normalize(*q)).collect();
    let turn = |base: usize, i: usize| rotation_vector(quat::mul(quat::conjugate(unit[base]), unit[i]));
    look(&c.t_s, &turn, floor_rad)
}

/// Way from the sample `base` to another.
type Way<'a> = &'a dyn Fn(usize, usize) -> [f64; 3];

fn look(t: &[f64], way: Way, floor: f64) -> Strays {
    let n = t.len();
    let mut out = Strays { marks: vec![false; n], jumps_s: Vec::new() };
    let Some(period) = median(t.windows(2).map(|w| w[1] - w[0]).collect()) else { return out };
    // Times that do not rise are for the checker of clocks.
    if n < BLOCK || !(period > 0.0) || t.windows(2).any(|w| !(w[1] > w[0])) {
        return out;
    }
    let reach = REACH_PERIODS * period;
    let misses: Vec<f64> = (0..n).map(|i| miss(t, way, i, reach)).collect();
    let limits = limits(&misses, floor);
    let odd: Vec<bool> = (0..n).map(|i| misses[i] > limits[i]).collect();
    let mut jumps: Vec<Jump> = Vec::new();
    for (first, last) in runs(&odd) {
        if last - first + 1 > LONGEST_RUN {
            continue;
        }
        let Some(side) = Side::around(t, &odd, first, last, reach) else { continue };
        let limit = limits[first..=last].iter().copied().fold(0.0, f64::max);
        if side.worst(way) <= limit {
            for i in first..=last {
                let off = vec3::sub(way(side.base, i), side.curve(way, t[i]));
                out.marks[i] |= vec3::norm(off) > limits[i];
            }
        } else if let Some(by) = side.jump(way, t[last + 1], last + 1) {
            jumps.push(Jump { first, last, by, limit });
        }
    }
    flips(t, &jumps, &mut out);
    out
}

/// A run after which the channel goes on elsewhere, by so much.
struct Jump {
    first: usize,
    last: usize,
    by: [f64; 3],
    limit: f64,
}

/// Marks what lies between a jump and the jump back; other jumps become spans.
fn flips(t: &[f64], jumps: &[Jump], out: &mut Strays) {
    let mut k = 0;
    while k < jumps.len() {
        let a = &jumps[k];
        let size = vec3::norm(a.by);
        let back = jumps.get(k + 1).filter(|b| {
            t[b.last] - t[a.first] <= LONGEST_FLIP_S && vec3::norm(vec3::add(a.by, b.by)) <= JUMP_BACK * size
        });
        if let Some(b) = back {
            out.marks[a.first..=b.last].fill(true);
            k += 2;
        } else {
            if size > a.limit {
                out.jumps_s.push([t[a.first.saturating_sub(1)], t[(a.last + 1).min(t.len() - 1)]]);
            }
            k += 1;
        }
    }
}

/// Distance of a sample from the cubic through its four neighbours; 0 where there are none or they are too far.
fn miss(t: &[f64], way: Way, i: usize, reach: f64) -> f64 {
    if i < 2 || i + 2 >= t.len() || t[i + 2] - t[i - 2] > reach {
        return 0.0;
    }
    let near = [i - 2, i - 1, i + 1, i + 2];
    let mut off = way(i - 1, i);
    for a in near {
        let mut weight = 1.0;
        for b in near.into_iter().filter(|b| *b != a) {
            weight *= (t[i] - t[b]) / (t[a] - t[b]);
        }
        off = vec3::sub(off, vec3::scale(way(i - 1, a), weight));
    }
    vec3::norm(off)
}

/// For every sample the miss from which on it is suspicious.
fn limits(misses: &[f64], floor: f64) -> Vec<f64> {
    let usual = |part: &[f64]| median(part.iter().copied().filter(|m| *m > 0.0).collect()).unwrap_or(0.0);
    let all = usual(misses);
    let blocks: Vec<f64> = misses.chunks(BLOCK).map(usual).collect();
    (0..misses.len())
        .map(|i| {
            let b = i / BLOCK;
            let near = &blocks[b.saturating_sub(1)..(b + 2).min(blocks.len())];
            (TIMES_USUAL * near.iter().copied().fold(all, f64::max)).max(floor)
        })
        .collect()
}

/// First and last of what is suspicious together.
fn runs(odd: &[bool]) -> Vec<(usize, usize)> {
    let mut out: Vec<(usize, usize)> = Vec::new();
    for i in (0..odd.len()).filter(|i| odd[*i]) {
        match out.last_mut() {
            Some((_, last)) if i - *last <= TOGETHER => *last = i,
            _ => out.push((i, i)),
        }
    }
    out
}

/// Sound samples around a run.
struct Side {
    before: Vec<usize>,
    after: Vec<usize>,
    /// Sample from which ways are counted.
    base: usize,
    /// Times of `before`, then `after`.
    times: Vec<f64>,
}

impl Side {
    fn around(t: &[f64], odd: &[bool], first: usize, last: usize, reach: f64) -> Option<Self> {
        let near = |i: &usize| !odd[*i] && (t[*i] - t[first]).abs() <= reach;
        let mut before: Vec<usize> = (0..first).rev().take(2 * SIDE).filter(near).take(SIDE).collect();
        before.reverse();
        let after: Vec<usize> = (last + 1..t.len()).take(2 * SIDE).filter(near).take(SIDE).collect();
        if before.len() < LEAST_SIDE || after.len() < LEAST_SIDE {
            return None;
        }
        let base = *before.last()?;
        let times = before.iter().chain(&after).map(|i| t[*i]).collect();
        Some(Self { before, after, base, times })
    }

    fn members(&self) -> impl Iterator<Item = &usize> {
        self.before.iter().chain(&self.after)
    }

    /// The cubic through all of them, at a time.
    fn curve(&self, way: Way, at: f64) -> [f64; 3] {
        let values: Vec<[f64; 3]> = self.members().map(|i| way(self.base, *i)).collect();
        polynomial(&self.times, &values, 3, at)
    }

    /// Largest distance of them from that cubic.
    fn worst(&self, way: Way) -> f64 {
        self.members()
            .zip(&self.times)
            .map(|(i, t)| vec3::norm(vec3::sub(way(self.base, *i), self.curve(way, *t))))
            .fold(0.0, f64::max)
    }

    /// How far sample `i` at time `at` is from where those before the run were going.
    fn jump(&self, way: Way, at: f64, i: usize) -> Option<[f64; 3]> {
        let values: Vec<[f64; 3]> = self.before.iter().map(|i| way(self.base, *i)).collect();
        let going = polynomial(&self.times[..self.before.len()], &values, 1, at);
        let by = vec3::sub(way(self.base, i), going);
        by.iter().all(|x| x.is_finite()).then_some(by)
    }
}

/// Value at `at` of the polynomial of a degree through points, by least squares.
fn polynomial(t: &[f64], values: &[[f64; 3]], degree: usize, at: f64) -> [f64; 3] {
    let span = (t[t.len() - 1] - t[0]).max(1e-9);
    let powers = |t: f64| -> Vec<f64> { (0..=degree).map(|k| ((t - at) / span).powi(k as i32)).collect() };
    let rows: Vec<Vec<f64>> = t.iter().map(|t| powers(*t)).collect();
    let a = DMatrix::from_fn(t.len(), degree + 1, |i, k| rows[i][k]);
    let Some(normal) = (a.transpose() * &a).cholesky() else { return [f64::NAN; 3] };
    std::array::from_fn(|axis| {
        let y = DVector::from_fn(t.len(), |i, _| values[i][axis]);
        normal.solve(&(a.transpose() * y))[0]
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A fast figure with noise of 0.3 mm at 240 Hz.
    fn figure() -> Channel<3> {
        let noise = |i: usize, k: usize| 3e-4 * ((i * 7919 + k * 104_729) as f64 * 0.618).sin();
        let mut out = Channel::default();
        for i in 0..6000 {
            let t = i as f64 / 240.0;
            let p = [3.0 * (4.0 * t).sin(), 2.0 * (5.3 * t).cos(), 1.5 + 0.8 * (7.1 * t).sin()];
            out.push(t, std::array::from_fn(|k| p[k] + noise(i, k)));
        }
        out
    }

    #[test]
    fn single_samples_runs_and_flips_are_marked_and_nothing_beside_them() {
        let mut c = figure();
        assert_eq!(of_vectors(&c, 4e-3).count(), 0, "fast flight is no outlier");
        let mut planted = Vec::new();
        for i in (150..5800).step_by(300) {
            c.values[i][i % 3] += 0.03;
            planted.push(i);
        }
        for i in [1000, 1001, 2000, 2001, 2002] {
            c.values[i][0] -= 0.08;
            planted.push(i);
        }
        planted.sort_unstable();
        let found = of_vectors(&c, 4e-3);
        let marked: Vec<usize> = (0..c.len()).filter(|i| found.marks[*i]).collect();
        assert_eq!(marked, planted);
        // A flip of 0.2 s.
        let mut c = figure();
        c.values[3000..3048].iter_mut().for_each(|v| v[1] += 0.2);
        let found = of_vectors(&c, 4e-3);
        assert!(found.marks[3000..3048].iter().all(|m| *m) && found.count() <= 52, "{}", found.count());
        assert!(found.jumps_s.is_empty());
        // A jump that stays.
        let mut c = figure();
        c.values[3000..].iter_mut().for_each(|v| v[2] += 0.2);
        let found = of_vectors(&c, 4e-3);
        assert_eq!((found.count(), found.jumps_s.len()), (0, 1), "{:?}", found.jumps_s);
        assert!(found.jumps_s[0][0] < 12.5 && found.jumps_s[0][1] >= 12.5 && found.jumps_s[0][1] < 12.53);
    }

    #[test]
    fn an_attitude_that_is_turned_over_for_a_frame_is_marked_and_a_changed_sign_is_not() {
        let mut c = Channel::<4>::default();
        for i in 0..2000 {
            let t = i as f64 * 0.005;
            let q = quat::mul(quat::exp([0.9 * (5.0 * t).sin(), 0.0, 0.0]), quat::exp([0.0, 0.0, 4.0 * t]));
            c.push(t, if i % 2 == 0 { q } else { q.map(|x| -x) });
        }
        assert_eq!(of_attitudes(&c, 0.01).count(), 0);
        for (i, turn) in [(500, [3.1, 0.0, 0.0]), (900, [0.0, 0.06, 0.0]), (901, [0.0, 0.06, 0.0])] {
            c.values[i] = quat::mul(c.values[i], quat::exp(turn));
        }
        let marks = of_attitudes(&c, 0.01).marks;
        assert_eq!((0..2000).filter(|i| marks[*i]).collect::<Vec<_>>(), [500, 900, 901]);
    }
}
