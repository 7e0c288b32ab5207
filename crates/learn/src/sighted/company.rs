//! Drones that fly together in one world: which are near to each, and whether any two meet.

use std::ops::Range;

use crate::LearnError;
use propwash_trace::lanes::{Cell, F32x16};
use propwash_trace::math::vec3;

/// Another drone of the same world. No slope goes through it.
#[derive(Clone, Copy, Debug)]
pub struct Other<S> {
    /// Where it is, m, world.
    pub pos_m: [S; 3],
    /// Its velocity, m/s, world.
    pub vel_m_s: [S; 3],
}

impl<S: Copy> Other<S> {
    /// Numbers of one.
    pub(super) const WIDTH: usize = 6;

    /// From their numbers in order.
    pub(super) fn all(numbers: &[S]) -> Vec<Self> {
        let of = |n: &[S]| Self { pos_m: [n[0], n[1], n[2]], vel_m_s: [n[3], n[4], n[5]] };
        numbers.chunks_exact(Self::WIDTH).map(of).collect()
    }
}

/// Where velocities stand in a state.
const VEL: usize = 7;

fn three(state: &[F32x16], from: usize, lane: usize) -> [f32; 3] {
    [0, 1, 2].map(|k| state[from + k].get(lane))
}

/// Lanes of the drones that fly with that of a lane, itself among them.
fn world(lane: usize, drones: usize, n: usize) -> Range<usize> {
    let first = lane / drones * drones;
    first..(first + drones).min(n)
}

/// Writes the nearest other drones of each lane of `n`, nearest first, of equal ones the first: six numbers for each, and as many drones as there is room for.
pub(super) fn nearest(state: &[F32x16], (drones, n): (usize, usize), others: &mut [F32x16]) {
    if others.is_empty() {
        return;
    }
    for lane in 0..n {
        let own = three(state, 0, lane);
        let mut by_distance: Vec<(f32, usize)> = world(lane, drones, n)
            .filter(|other| *other != lane)
            .map(|other| {
                let off = vec3::sub(three(state, 0, other), own);
                (vec3::dot(off, off), other)
            })
            .collect();
        by_distance.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        for (cells, (_, other)) in others.chunks_exact_mut(Other::<f32>::WIDTH).zip(by_distance) {
            let numbers = [three(state, 0, other), three(state, VEL, other)];
            cells.iter_mut().zip(numbers.as_flattened()).for_each(|(cell, v)| cell.set(lane, *v));
        }
    }
    // Lanes behind the last repeat it.
    for cell in others {
        let last = cell.get(n - 1);
        (n..F32x16::LANES).for_each(|lane| cell.set(lane, last));
    }
}

/// Notes which drones come nearer to another than `gap_m` on the straight way between two states, both at the same time.
pub(super) fn meetings(
    (before, after): (&[F32x16], &[F32x16]),
    (drones, n): (usize, usize),
    gap_m: f32,
    touched: &mut [bool; F32x16::LANES],
) {
    for lane in 0..n {
        for other in world(lane, drones, n).filter(|other| *other > lane) {
            let off = |state: &[F32x16]| vec3::sub(three(state, 0, other), three(state, 0, lane));
            if nearest_m(off(before), off(after)) < gap_m {
                (touched[lane], touched[other]) = (true, true);
            }
        }
    }
}

/// How near something comes to the origin on a straight way.
fn nearest_m(from: [f32; 3], to: [f32; 3]) -> f32 {
    let way = vec3::sub(to, from);
    let share = (-vec3::dot(from, way) / vec3::dot(way, way).max(1e-12)).clamp(0.0, 1.0);
    vec3::norm(vec3::add(from, vec3::scale(way, share)))
}

/// Refuses drones that do not fill worlds, worlds that do not fit into lanes, and more neighbours than there are.
pub(super) fn check(others: usize, drones: usize, lanes: usize) -> Result<(), LearnError> {
    let wrong =
        |name, expected: String, got: usize| Err(LearnError::Option { name, expected, got: got.to_string() });
    if drones == 0 || !F32x16::LANES.is_multiple_of(drones) {
        return wrong("drones", "1, 2, 4, 8 or 16 in a world".into(), drones);
    }
    if !lanes.is_multiple_of(drones) {
        return wrong("worlds", format!("a multiple of the {drones} drones that fly together"), lanes);
    }
    if others >= drones.max(1) && others > 0 {
        return wrong("neighbours", format!("fewer than the {drones} drones that fly together"), others);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two worlds of four drones on a line, the last one of the first far away.
    fn state() -> Vec<F32x16> {
        let mut state = vec![F32x16::splat(0.0); 13];
        for (lane, x) in [0.0, 1.0, 3.0, 50.0, 0.1, 0.2, 0.4, 0.8].into_iter().enumerate() {
            state[0].set(lane, x);
            state[VEL].set(lane, lane as f32);
        }
        state
    }

    #[test]
    fn the_nearest_of_the_same_world_come_first() {
        let mut others = vec![F32x16::splat(f32::NAN); 2 * Other::<f32>::WIDTH];
        nearest(&state(), (4, 8), &mut others);
        let of = |lane: usize| [others[3].get(lane), others[9].get(lane)];
        assert_eq!(of(0), [1.0, 2.0]);
        assert_eq!(of(2), [1.0, 0.0]);
        assert_eq!(of(3), [2.0, 1.0]);
        assert_eq!(of(4), [5.0, 6.0], "not those of the other world");
        assert_eq!(of(15), of(7), "lanes behind the last repeat it");
        assert!(others.iter().all(|cell| (0..16).all(|lane| cell.get(lane).is_finite())));
    }

    #[test]
    fn drones_that_fly_through_each_other_meet() {
        let (before, mut after) = (state(), state());
        // The first flies from 0 to 2, through the second; both worlds' others stay.
        after[0].set(0, 2.0);
        let mut touched = [false; F32x16::LANES];
        meetings((&before, &after), (4, 4), 0.2, &mut touched);
        assert_eq!(touched[..4], [true, true, false, false]);
        // 0.3 m beside it they do not.
        let (mut before, mut touched) = (before, [false; F32x16::LANES]);
        before[1].set(0, 0.3);
        after[1].set(0, 0.3);
        meetings((&before, &after), (4, 4), 0.2, &mut touched);
        assert_eq!(touched, [false; F32x16::LANES]);
    }

    #[test]
    fn worlds_that_do_not_fill_lanes_are_refused() {
        assert!(check(0, 1, 19).is_ok() && check(4, 8, 32).is_ok());
        for (others, drones, lanes, words) in
            [(0, 3, 12, "1, 2, 4, 8 or 16"), (0, 8, 20, "multiple of the 8"), (4, 4, 16, "fewer than the 4")]
        {
            let told = check(others, drones, lanes).unwrap_err().to_string();
            assert!(told.contains(words), "{told}");
        }
    }
}
