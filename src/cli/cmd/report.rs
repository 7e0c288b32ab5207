//! Pages and pictures for people, of comparisons and diagnoses.

use super::io_error;
use crate::Result;
use std::path::Path;

/// Writes a file and says so on standard error, where `--json` does not read.
pub fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    std::fs::write(path, bytes).map_err(io_error(path))?;
    eprintln!("wrote {}", path.display());
    Ok(())
}
