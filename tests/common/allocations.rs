//! An allocator that counts. The program that includes it must hold nothing else, since it counts all allocations of Rust's;
//! MuJoCo's own are not seen.

#![allow(dead_code, reason = "every program that includes this uses its own part of it")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicIsize, AtomicUsize, Ordering};

struct Counting;

static COUNT: AtomicUsize = AtomicUsize::new(0);
static LIVE: AtomicIsize = AtomicIsize::new(0);
static PEAK: AtomicIsize = AtomicIsize::new(0);

// SAFETY: every call goes on to the system's allocator as it came.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        COUNT.fetch_add(1, Ordering::Relaxed);
        let size = layout.size() as isize;
        let live = LIVE.fetch_add(size, Ordering::Relaxed) + size;
        PEAK.fetch_max(live, Ordering::Relaxed);
        // SAFETY: as for `alloc` itself.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        LIVE.fetch_sub(layout.size() as isize, Ordering::Relaxed);
        // SAFETY: as for `dealloc` itself.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Allocations so far.
pub fn allocations() -> usize {
    COUNT.load(Ordering::Relaxed)
}

/// Most bytes that were in use at once while `work` ran, beyond those before; and its allocations.
pub fn used<T>(work: impl FnOnce() -> T) -> (T, isize, usize) {
    let (live, count) = (LIVE.load(Ordering::Relaxed), allocations());
    PEAK.store(live, Ordering::Relaxed);
    let done = work();
    (done, PEAK.load(Ordering::Relaxed) - live, allocations() - count)
}
