//! Ctrl-C as a wish to end: work ends where it is whole, and the program says what it has.

use std::sync::atomic::AtomicBool;

static WISHED: AtomicBool = AtomicBool::new(false);

/// Is set once the user presses Ctrl-C. Without the feature `lab` there is nobody to hear it, and the process ends at once.
pub fn flag() -> &'static AtomicBool {
    #[cfg(feature = "lab")]
    std::thread::spawn(|| {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        if let Ok(runtime) = runtime
            && runtime.block_on(tokio::signal::ctrl_c()).is_ok()
        {
            WISHED.store(true, std::sync::atomic::Ordering::Relaxed);
        }
    });
    &WISHED
}
