//! What programs around a simulation ask of it beside its arrays.

use super::sim::Sim;
use super::{lanes, pool};
use propwash_trace::lanes::Number;

impl<N: Number> Sim<N> {
    /// Whether a call of `n_steps` wakes other threads, as far as there are any. One that does not runs on the thread that
    /// calls, and pays for no hand-over to a pool.
    pub fn is_parallel(&self, n_steps: usize) -> bool {
        let limit = if self.in_lanes() { lanes::SERIAL_LIMIT } else { pool::SERIAL_LIMIT };
        self.data.n_worlds.saturating_mul(self.data.n_drones).saturating_mul(n_steps) >= limit
    }

    /// Worlds that stand still because their numbers stopped being numbers.
    pub fn n_quarantined(&self) -> usize {
        self.data.quarantine.iter().filter(|q| q.is_some()).count()
    }
}
