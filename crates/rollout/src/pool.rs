//! Work over worlds: in parallel when there is enough of it.

use rayon::prelude::*;

/// Drone-steps below which waking other threads costs more than it saves (about 10 µs against 1 µs a step).
pub(super) const SERIAL_LIMIT: usize = 200;

/// `f` on every item; `work` is the number of drone-steps altogether.
pub(super) fn for_each<T: Send>(items: &mut [T], work: usize, f: impl Fn(&mut T) + Sync + Send) {
    if work < SERIAL_LIMIT {
        items.iter_mut().for_each(f);
    } else {
        items.par_iter_mut().for_each(f);
    }
}
