//! Geoms in groups of sixteen neighbours, for rays: their lanes test a whole group at once.

use crate::shape::round::{Round, norm};

/// A number for each of many geoms, in arrays of whole lanes.
#[derive(Debug, Default)]
pub(crate) struct Rounds {
    /// Centre, half segment, radius; filled up with what is nowhere.
    pub data: [Vec<f32>; 7],
}

impl Rounds {
    pub fn clear(&mut self) {
        for column in &mut self.data {
            column.clear();
        }
    }

    /// Room for so many more, and for what [`Rounds::pad`] adds.
    pub fn reserve(&mut self, geoms: usize) {
        for column in &mut self.data {
            column.reserve(geoms.next_multiple_of(16));
        }
    }

    pub fn push(&mut self, round: &Round) {
        let row = [
            round.centre[0],
            round.centre[1],
            round.centre[2],
            round.half[0],
            round.half[1],
            round.half[2],
            round.radius,
        ];
        for (column, x) in self.data.iter_mut().zip(row) {
            column.push(x as f32);
        }
    }

    /// Fills up the last group of sixteen.
    pub fn pad(&mut self) {
        while !self.data[0].len().is_multiple_of(16) {
            for column in &mut self.data[..6] {
                column.push(0.0);
            }
            self.data[6].push(f32::NEG_INFINITY);
        }
    }

    pub fn groups(&self) -> usize {
        self.data[0].len() / 16
    }
}

/// The static level: geoms that no pose moves, in groups of sixteen that lie close together.
#[derive(Debug, Default)]
pub(crate) struct RayGroups {
    /// Geom ids, in the order of `rounds`.
    pub ids: Vec<u32>,
    pub rounds: Rounds,
    /// One ball for each group of sixteen.
    pub groups: Rounds,
}

impl RayGroups {
    /// Of geoms with what holds them in the world.
    pub fn new(mut geoms: Vec<(u32, Round)>) -> Self {
        let (mut lo, mut hi) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for (_, h) in &geoms {
            for k in 0..3 {
                lo[k] = lo[k].min(h.centre[k]);
                hi[k] = hi[k].max(h.centre[k]);
            }
        }
        // Along a curve that keeps neighbours together (Morton, 1966): bits of the coordinates in turn.
        geoms.sort_by_cached_key(|(id, h)| {
            let mut code = 0u64;
            for k in 0..3 {
                let width = hi[k] - lo[k];
                let u = if width > 0.0 { (h.centre[k] - lo[k]) / width } else { 0.0 };
                let cell = (u * 1023.0) as u64;
                for bit in 0..10 {
                    code |= (cell >> bit & 1) << (3 * bit + k as u64);
                }
            }
            (code, *id)
        });
        let mut own = Self::default();
        for group in geoms.chunks(16) {
            let n = group.len() as f64;
            let mut centre = [0.0; 3];
            for (id, round) in group {
                own.ids.push(*id);
                own.rounds.push(round);
                for k in 0..3 {
                    centre[k] += round.centre[k] / n;
                }
            }
            let reach = group.iter().fold(0.0f64, |a, (_, h)| {
                a.max(norm([0, 1, 2].map(|k| h.centre[k] - centre[k])) + h.reach())
            });
            let ball = Round { centre, half: [0.0; 3], radius: reach };
            own.groups.push(&ball.placed([0.0; 3], &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]));
        }
        own.rounds.pad();
        own.groups.pad();
        own
    }
}
