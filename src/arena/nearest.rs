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
            let distance = self.field.distance_lanes(&pos);
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
