//! Work over worlds: in parallel when there is enough of it.

use std::cell::Cell;

use rayon::prelude::*;

thread_local! {
    static ALONE: Cell<bool> = const { Cell::new(false) };
}

/// Runs `work` on this thread without the help of others, whatever pool they belong to. Handing work to a pool of one thread costs
/// more than it saves where a call takes microseconds.
pub fn alone<T>(work: impl FnOnce() -> T) -> T {
    // Put back even where the work panics.
    struct Before(bool);
    impl Drop for Before {
        fn drop(&mut self) {
            ALONE.set(self.0);
        }
    }
    let _before = Before(ALONE.replace(true));
    work()
}

/// Threads that share work which this thread begins.
pub fn threads() -> usize {
    if ALONE.get() { 1 } else { rayon::current_num_threads() }
}

/// Drone-steps below which waking other threads costs more than it saves (about 10 µs against 1 µs a step).
pub(super) const SERIAL_LIMIT: usize = 200;

/// `f` on every item; `work` is the number of drone-steps altogether.
pub fn for_each<T: Send>(items: &mut [T], work: usize, f: impl Fn(&mut T) + Sync + Send) {
    if work < SERIAL_LIMIT || threads() == 1 {
        items.iter_mut().for_each(f);
    } else {
        items.par_iter_mut().for_each(f);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_alone_has_one_thread_and_the_others_come_back_after_a_panic() {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
        pool.install(|| {
            assert_eq!((threads(), alone(|| (threads(), alone(threads)))), (3, (1, 1)));
            let failed = std::panic::catch_unwind(|| alone(|| panic!("it fails")));
            assert!(failed.is_err() && threads() == 3);
        });
    }
}
