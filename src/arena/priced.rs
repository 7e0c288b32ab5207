//! What flights cost: an expression of states and commands, summed up while they are flown.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

use super::{Arena, ArenaError};
use crate::geometry::DistanceField;
use crate::rollout::watch::{Watched, Watcher};
use crate::scalar::formula::Registers;
use crate::scalar::lanes::{Cell, F32x16, Number};
pub use crate::vehicle::expression::Cost;
use crate::vehicle::expression::Read;

/// Lanes in which costs are computed, in f64: sixteen, as a field has.
type Lanes = <f64 as Number>::Two;

/// What a flight is priced by.
#[derive(Clone, Copy, Debug)]
pub struct Priced<'a> {
    /// The cost of a drone after each command.
    pub cost: &'a Cost,
    /// Numbers that are given: those of every command, (time, number), or the same for all, (number).
    pub given: &'a [f64],
    /// Where distances come from.
    pub field: Option<&'a DistanceField>,
}

/// Adds up what the drones of a flight cost. Worlds are seen by one thread at a time, each command in order.
struct Pricing<'a, N> {
    asked: Priced<'a>,
    commands: &'a [N],
    /// The command in force when the flight began.
    first: Vec<N>,
    times: usize,
    drones: usize,
    /// Time of a command, s.
    step_s: f64,
    /// Bits of a number each. (world, drone)
    sums: Vec<AtomicU64>,
    /// Memory to compute in that no thread uses now.
    free: Mutex<Vec<Registers<Lanes>>>,
}

/// Where the numbers of some rows stand, one for each lane; lanes behind the last row repeat it.
struct Block<'a, N> {
    states: [&'a [N]; Lanes::LANES],
    commands: [&'a [N]; Lanes::LANES],
    before: [&'a [N]; Lanes::LANES],
}

impl<N: Number> Pricing<'_, N> {
    /// The rows from `from` on of those that are seen.
    fn block<'a>(&'a self, seen: &Watched<'a, N>, from: usize) -> Block<'a, N> {
        let (rows, width) = (seen.n_worlds * self.drones, self.asked.cost.sizes().1);
        let own = |lane: usize| {
            let row = (from + lane).min(rows - 1);
            (row / self.drones, row % self.drones)
        };
        let command = |lane: usize, t: usize| {
            let (w, d) = own(lane);
            &self.commands[(((seen.first_world + w) * self.times + t) * self.drones + d) * width..][..width]
        };
        Block {
            states: core::array::from_fn(|lane| {
                let (w, d) = own(lane);
                let states = seen.world(w);
                let each = states.len() / self.drones;
                &states[d * each..(d + 1) * each]
            }),
            commands: core::array::from_fn(|lane| command(lane, seen.t)),
            before: core::array::from_fn(|lane| match seen.t {
                0 => {
                    let (w, d) = own(lane);
                    &self.first[((seen.first_world + w) * self.drones + d) * width..][..width]
                }
                t => command(lane, t - 1),
            }),
        }
    }

    /// Writes what the cost reads of a block into lanes.
    fn fill(&self, t: usize, block: &Block<N>, registers: &mut Registers<Lanes>) {
        for (input, read) in self.asked.cost.reads() {
            let cell = registers.input(*input);
            let mut from = |rows: &[&[N]; Lanes::LANES], k: usize| cell.fill(0, |lane| rows[lane][k].wide());
            match *read {
                Read::State(k) => from(&block.states, k),
                Read::Command(k) => from(&block.commands, k),
                Read::Before(k) => from(&block.before, k),
                Read::Time => *cell = Lanes::splat((t + 1) as f64 * self.step_s),
                Read::Last => *cell = Lanes::splat(f64::from(u8::from(t + 1 == self.times))),
                Read::Distance => {
                    let mut pos = [F32x16::splat(0.0); 3];
                    for (k, axis) in pos.iter_mut().enumerate() {
                        axis.fill(0, |lane| block.states[lane][k].wide() as f32);
                    }
                    let field = self.asked.field.map(|field| field.distance_lanes(&pos));
                    cell.fill(0, |lane| field.map_or(f64::INFINITY, |d| f64::from(d.get(lane))));
                }
                Read::Given(k) => {
                    let n = self.asked.cost.n_given();
                    let of = if self.asked.given.len() == n { 0 } else { t };
                    *cell = Lanes::splat(self.asked.given[of * n + k]);
                }
            }
        }
    }
}

impl<N: Number> Watcher<N> for Pricing<'_, N> {
    fn look(&self, seen: Watched<N>) {
        let formula = self.asked.cost.formula();
        let lent = self.free.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let mut registers = lent.unwrap_or_else(|| Registers::new(formula));
        let rows = seen.n_worlds * self.drones;
        for from in (0..rows).step_by(Lanes::LANES) {
            self.fill(seen.t, &self.block(&seen, from), &mut registers);
            registers.run(formula);
            let cost = registers.output(formula, 0);
            for lane in 0..Lanes::LANES.min(rows - from) {
                let sum = &self.sums[seen.first_world * self.drones + from + lane];
                // A flight that is flown once more begins its sum anew.
                let before = if seen.t == 0 { 0.0 } else { f64::from_bits(sum.load(Ordering::Relaxed)) };
                sum.store((before + cost.get(lane)).to_bits(), Ordering::Relaxed);
            }
        }
        self.free.lock().unwrap_or_else(PoisonError::into_inner).push(registers);
    }
}

impl<N: Number> Arena<N> {
    /// Flies a sequence of commands as [`Arena::rollout`], and adds up what each drone costs after each command: (world, drone). Worlds that are quarantined cost infinity. The states
    /// are returned only where `keep` says so; else the list is empty, and they are never stored.
    ///
    /// # Errors
    /// As there, and [`ArenaError::Option`] for a cost of another vehicle or command, for given numbers of another length, for a cost that reads distances without a field, and for
    /// costs that are no numbers.
    pub fn rollout_priced(
        &mut self,
        commands: &[N],
        substeps: usize,
        asked: Priced,
        keep: bool,
    ) -> Result<(Vec<N>, Vec<f64>), ArenaError> {
        let times = self.sim().times_of(commands, substeps)?;
        let data = &self.sim().data;
        let (drones, rows) = (data.n_drones, data.n_worlds * data.n_drones);
        let cost = asked.cost;
        let sizes = (data.n_rotors, data.command_width);
        if cost.sizes() != sizes {
            let (expected, got) =
                (format!("one for {sizes:?} rotors and numbers of a command"), cost.sizes());
            return Err(ArenaError::option("cost", expected, format!("{got:?}")));
        }
        let n = cost.n_given();
        if asked.given.len() != n && asked.given.len() != n * times {
            let expected = format!("{n} numbers, or {n} for each of {times} commands");
            return Err(ArenaError::option("given", expected, asked.given.len()));
        }
        if let Some(i) = asked.given.iter().position(|v| !v.is_finite()) {
            return Err(ArenaError::option("given", "finite numbers", asked.given[i]));
        }
        if cost.reads_distance() && asked.field.is_none() {
            return Err(ArenaError::option(
                "field",
                "a distance field, since the cost reads distances",
                "none",
            ));
        }
        let pricing = Pricing {
            asked,
            commands,
            first: data.command.clone(),
            times,
            drones,
            step_s: substeps as f64 / f64::from(self.sim().options().sim_hz),
            sums: (0..rows).map(|_| AtomicU64::new(0.0f64.to_bits())).collect(),
            free: Mutex::default(),
        };
        let states = self.rollout_watched(commands, substeps, &pricing, keep)?;
        let mut sums: Vec<f64> = pricing.sums.into_iter().map(|v| f64::from_bits(v.into_inner())).collect();
        let quarantine = &self.sim().data.quarantine;
        for (row, sum) in sums.iter_mut().enumerate() {
            if quarantine[row / drones].is_some() {
                *sum = f64::INFINITY;
            } else if sum.is_nan() {
                let got = format!("{sum} in world {}, drone {}", row / drones, row % drones);
                return Err(ArenaError::option(
                    "cost",
                    "numbers: look for roots and quotients of what may be below or at 0",
                    got,
                ));
            }
        }
        Ok((states, sums))
    }
}
