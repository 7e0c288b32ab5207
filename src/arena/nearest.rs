//! How near the drones of a flight come to what stands still, found while it is flown.

use std::sync::atomic::{AtomicU32, Ordering};

use super::{Arena, ArenaError};
use crate::geometry::DistanceField;
use crate::rollout::watch::{Watched, Watcher};
use crate::scalar::lanes::{Cell, F32x16, Number};

/// How near each drone came, (world, drone).
#[derive(Clone, Debug, PartialEq)]
pub struct Nearest {
    /// Least distance of its place to anything, after any of the commands, m.
    pub distance_m: Vec<f32>,
    /// Number of the first command after which it was nearer than the radius, from 0; that of all commands where it never was.
    pub first: Vec<u32>,
}

/// Asks a field where the drones are after each command. Worlds are seen by one thread at a time.
struct Near<'a> {
    field: &'a DistanceField,
    radius_m: f32,
    drones: usize,
    /// Bits of a number each.
    distance_m: Vec<AtomicU32>,
    first: Vec<AtomicU32>,
}

impl<N: Number> Watcher<N> for Near<'_> {
    fn look(&self, seen: Watched<N>) {
        const LANES: usize = F32x16::LANES;
        let rows = seen.n_worlds * self.drones;
        for from in (0..rows).step_by(LANES) {
            let mut pos = [F32x16::splat(0.0); 3];
            for lane in 0..LANES {
                // Lanes behind the last repeat it.
                let row = (from + lane).min(rows - 1);
                let states = seen.world(row / self.drones);
                let at = row % self.drones * (states.len() / self.drones);
                (0..3).for_each(|k| pos[k].set(lane, states[at + k].wide() as f32));
            }
            let (distance, _) = self.field.at_lanes(&pos);
            for lane in 0..LANES.min(rows - from) {
                let row = seen.first_world * self.drones + from + lane;
                let d = distance.get(lane);
                let best = f32::from_bits(self.distance_m[row].load(Ordering::Relaxed));
                self.distance_m[row].store(best.min(d).to_bits(), Ordering::Relaxed);
                if d < self.radius_m {
                    let first = self.first[row].load(Ordering::Relaxed).min(seen.t as u32);
                    self.first[row].store(first, Ordering::Relaxed);
                }
            }
        }
    }
}

impl<N: Number> Arena<N> {
    /// Flies a sequence of commands as [`Arena::rollout`], and says how near the drones came to what a field holds, where they were after each command. The states are
    /// returned only where `keep` says so; else the list is empty, and they are never stored.
    ///
    /// # Errors
    /// As there, and [`ArenaError::Option`] for a radius that is not finite or below 0.
    pub fn rollout_near(
        &mut self,
        commands: &[N],
        substeps: usize,
        (field, radius_m): (&DistanceField, f64),
        keep: bool,
    ) -> Result<(Vec<N>, Nearest), ArenaError> {
        if !(radius_m.is_finite() && radius_m >= 0.0) {
            return Err(ArenaError::option("radius_m", "a finite number, 0 or more", radius_m));
        }
        let times = self.sim().times_of(commands, substeps)? as u32;
        let drones = self.sim().data.n_drones;
        let rows = self.sim().data.n_worlds * drones;
        let all = |v: u32| (0..rows).map(|_| AtomicU32::new(v)).collect();
        let near = Near {
            field,
            radius_m: radius_m as f32,
            drones,
            distance_m: all(f32::INFINITY.to_bits()),
            first: all(times),
        };
        let states = self.rollout_watched(commands, substeps, &near, keep)?;
        Ok((
            states,
            Nearest {
                distance_m: near.distance_m.into_iter().map(|v| f32::from_bits(v.into_inner())).collect(),
                first: near.first.into_iter().map(AtomicU32::into_inner).collect(),
            },
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arena::SimConfig;
    use crate::geometry::FieldGrid;
    use crate::physics::controllers::ControlMode;
    use crate::rollout::{Engine, SimOptions};

    /// The distance to the plane x = 0.3 from its lower side.
    fn wall() -> DistanceField {
        let grid = FieldGrid { origin_m: [-1.0, -1.0, -1.0], resolution_m: 1.0, counts: [3, 3, 4] };
        let data = (0..grid.len()).map(|i| 0.3 - (-1.0 + (i / 12) as f32)).collect();
        DistanceField::new(grid, data, vec![], vec![]).unwrap()
    }

    fn arena<N: Number>(engine: Engine) -> Arena<N> {
        let options =
            SimOptions { n_worlds: 37, control: ControlMode::Attitude, engine, ..SimOptions::default() };
        let config = SimConfig { options, n_drones: Some(2), ..SimConfig::default() };
        Arena::from_config(&config).unwrap()
    }

    /// In lanes and one by one, with states kept and not; a world goes astray on its way.
    #[test]
    fn what_is_seen_on_the_way_is_what_the_states_say_afterwards() {
        check::<f32>(Engine::Lanes);
        check::<f64>(Engine::Lanes);
        check::<f64>(Engine::Reference);
    }

    fn check<N: Number>(engine: Engine) {
        let (field, radius_m, times) = (wall(), 0.25, 30);
        let commands: Vec<N> = (0..37 * times * 2)
            .flat_map(|i| [0.0, 0.5 * ((i % 7) as f64 / 6.0), 0.0, 0.33].map(N::of))
            .collect();
        let flown = |keep: bool| {
            let mut arena = arena::<N>(engine);
            arena.data_mut().vel[6 * 5] = N::of(3e9);
            arena.rollout_near(&commands, 10, (&field, radius_m), keep).unwrap()
        };
        let (states, near) = flown(true);
        let (none, same) = flown(false);
        assert!(none.is_empty() && same == near);
        let width = states.len() / (37 * times * 2);
        let mut hits = 0;
        for row in 0..74 {
            let at = |t: usize| {
                let from = ((row / 2 * times + t) * 2 + row % 2) * width;
                field.at([0, 1, 2].map(|k| states[from + k].wide())).0
            };
            let distances: Vec<f64> = (0..times).map(at).collect();
            let least = distances.iter().copied().fold(f64::INFINITY, f64::min);
            assert!((least - f64::from(near.distance_m[row])).abs() < 1e-5, "{row}");
            let first = near.first[row] as usize;
            let below = distances.iter().position(|d| *d < radius_m).unwrap_or(times);
            let close = distances.get(first.min(below)).is_none_or(|d| (d - radius_m).abs() < 1e-5);
            assert!(first == below || close, "{row}: {first} {below}");
            hits += usize::from(first < times);
        }
        assert!(hits > 5 && hits < 70, "{hits}");
    }

    #[test]
    fn a_radius_that_is_none_is_refused() {
        let mut arena = arena::<f32>(Engine::Lanes);
        let commands = vec![0.1; 37 * 2 * 4];
        for radius_m in [-1.0, f64::NAN] {
            let e = arena.rollout_near(&commands, 1, (&wall(), radius_m), false).unwrap_err();
            assert!(e.to_string().contains("radius_m"), "{e}");
        }
    }
}
