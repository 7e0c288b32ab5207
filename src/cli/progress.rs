//! What a terminal shows while one waits.

use indicatif::{ProgressBar, ProgressStyle};
use std::time::Duration;

/// Runs `work`; where it takes more than a moment and standard error is a terminal, a line there says what is done and since when.
pub fn waiting<T>(what: &'static str, work: impl FnOnce() -> T) -> T {
    let style = ProgressStyle::with_template("{spinner} {msg}, {elapsed} elapsed");
    let bar = ProgressBar::new_spinner()
        .with_style(style.unwrap_or_else(|_| ProgressStyle::default_spinner()))
        .with_message(what);
    bar.enable_steady_tick(Duration::from_millis(200));
    let done = work();
    bar.finish_and_clear();
    done
}
