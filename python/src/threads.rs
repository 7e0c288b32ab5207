//! Threads that outlive no process: pools of our own, made anew after a fork.

use std::sync::{Arc, Mutex, PoisonError};

use pyo3::prelude::*;
use rayon::ThreadPool;

use crate::errors::Error;

/// A pool of so many threads, made by process number so many.
type Known = (u32, Option<usize>, Arc<ThreadPool>);

/// The pools of this process. They are never dropped: after a fork those of the parent have no threads here, and waiting
/// for them would never end.
static KNOWN: Mutex<Vec<Known>> = Mutex::new(Vec::new());

/// The pool of `threads` threads (one for each processor where it is `None`), shared by all that ask for as many.
pub fn pool(threads: Option<usize>) -> PyResult<Arc<ThreadPool>> {
    let process = std::process::id();
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((.., pool)) = known.iter().find(|(p, n, _)| *p == process && *n == threads) {
        return Ok(pool.clone());
    }
    let made = rayon::ThreadPoolBuilder::new()
        .num_threads(threads.unwrap_or(0))
        .thread_name(|i| format!("propwash-{i}"))
        // Fits of a diagnosis nest deeply; pages are taken only when they are used.
        .stack_size(16 << 20)
        .build();
    let pool = Arc::new(made.map_err(|e| Error::new_err(format!("threads: they do not start: {e}")))?);
    known.push((process, threads, pool.clone()));
    Ok(pool)
}
