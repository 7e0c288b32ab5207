//! What benchmarks share: statistics, the machine, peers, and tables that people and programs can read.

// Each benchmark uses a part of it.
#![allow(dead_code)]

pub mod machine;
pub mod peer;
pub mod report;
pub mod scenes;

/// Result of anything in a benchmark.
pub type Fallible<T> = Result<T, Box<dyn std::error::Error>>;

/// The middle one; NaN of none.
pub fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    if values.is_empty() { f64::NAN } else { values[values.len() / 2] }
}

/// The exit code of a benchmark; errors go to standard error.
pub fn ended(outcome: Fallible<()>) -> std::process::ExitCode {
    match outcome {
        Ok(()) => std::process::ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            std::process::ExitCode::FAILURE
        }
    }
}
