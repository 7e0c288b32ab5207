//! The program `propwash` inside Python: what the console script of the package runs.

use std::ffi::OsString;

use pyo3::prelude::*;

/// Runs the command line whose words follow `propwash`, with the input and output of this process; gives the exit code. `again` starts
/// it anew where words are put behind it.
#[pyfunction]
pub fn run_program(py: Python<'_>, words: Vec<OsString>, again: Vec<OsString>) -> u8 {
    py.detach(|| propwash::cli::run_with(words, again))
}
