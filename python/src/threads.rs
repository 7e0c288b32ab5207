//! Threads that outlive no process: pools of our own, made anew after a fork; and work that Ctrl-C ends.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

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

/// How long a thread works before it looks for signals. Python sees a Ctrl-C at the next look.
pub const LOOK: Duration = Duration::from_millis(50);

/// Runs `work` in a thread of its own, while this one looks for signals. A signal whose handler raises, as that of Ctrl-C does, ends the
/// call with the exception. Work that looks at the flag which it is given stops soon after; other work, whose result nobody will see,
/// ends in its thread.
pub fn interruptible<T: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce(&Arc<AtomicBool>) -> T + Send + 'static,
) -> PyResult<T> {
    let stop = Arc::new(AtomicBool::new(false));
    let (send, mut receive) = mpsc::channel();
    let flag = stop.clone();
    let thread = std::thread::Builder::new()
        .name("propwash-job".into())
        .stack_size(16 << 20)
        // Nobody listens any more where the call was ended.
        .spawn(move || drop(send.send(work(&flag))))
        .map_err(|e| Error::new_err(format!("a thread does not start: {e}")))?;
    let mut raised: Option<PyErr> = None;
    loop {
        // The receiver goes along, since a reference to it may not.
        let (back, got) = py.detach(move || {
            let got = receive.recv_timeout(LOOK);
            (receive, got)
        });
        receive = back;
        match (got, raised.take()) {
            // One more look after the flag was set.
            (_, Some(e)) => return Err(e),
            (Ok(done), None) => return Ok(done),
            (Err(RecvTimeoutError::Timeout), None) => {
                if let Err(e) = py.check_signals() {
                    stop.store(true, Ordering::Relaxed);
                    raised = Some(e);
                }
            }
            (Err(RecvTimeoutError::Disconnected), None) => match py.detach(|| thread.join()) {
                Err(panic) => std::panic::resume_unwind(panic),
                Ok(()) => return Err(Error::new_err("a thread ended without a result")),
            },
        }
    }
}
