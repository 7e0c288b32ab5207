//! What programs around a simulation ask of it beside its arrays.

use super::sim::Sim;
use super::{lanes, pool};
use propwash_trace::lanes::Number;

impl<N: Number> Sim<N> {
    /// Whether a call of `n_steps` wakes other threads, as far as there are any. One that does not runs on the thread that
    /// calls, and pays for no hand-over to a pool.
    pub fn is_parallel(&self, n_steps: usize) -> bool {
        let n_drones = self.data.n_worlds.saturating_mul(self.data.n_drones);
        match self.in_lanes() {
            true => lanes::work(n_drones, n_steps) >= lanes::SERIAL_LIMIT,
            false => n_drones.saturating_mul(n_steps) >= pool::SERIAL_LIMIT,
        }
    }

    /// Worlds that stand still because their numbers stopped being numbers.
    pub fn n_quarantined(&self) -> usize {
        self.data.quarantine.iter().filter(|q| q.is_some()).count()
    }
}
