//! Where results go: looked at before the work, written whole, and never over another file unasked.

use crate::flight::files;
use crate::{Error, Result};
use std::io::{ErrorKind, Write};
use std::path::Path;

/// Refuses outputs that cannot be written, that are there already without --force, or that are named twice. Call it before the work.
pub fn check(outputs: &[(&'static str, Option<&Path>)], force: bool) -> Result<()> {
    for (i, (flag, path)) in outputs.iter().enumerate() {
        let Some(path) = path else { continue };
        if let Some((other, _)) = outputs[..i].iter().find(|(_, other)| *other == Some(path)) {
            let got = format!("{}, which {other} names too", path.display());
            return Err(Error::Usage { flag, expected: "a file of its own".into(), got });
        }
        files::may_write(path, force).map_err(|e| refused(flag, path, e))?;
    }
    Ok(())
}

/// Writes a file.
pub fn write(flag: &'static str, path: &Path, bytes: &[u8], force: bool) -> Result<()> {
    files::write(path, force, |file| file.write_all(bytes)).map_err(|e| refused(flag, path, e))
}

/// Writes a page or a picture for people, and says so on standard error, where `--json` does not read.
pub fn report(flag: &'static str, path: &Path, bytes: &[u8], force: bool) -> Result<()> {
    write(flag, path, bytes, force)?;
    eprintln!("wrote {}", path.display());
    Ok(())
}

/// What is wrong with an output that the system refused.
pub fn refused(flag: &'static str, path: &Path, error: std::io::Error) -> Error {
    if error.kind() == ErrorKind::AlreadyExists {
        let expected = "a path at which there is no file yet, or --force to replace it".into();
        return Error::Usage { flag, expected, got: path.display().to_string() };
    }
    Error::Io { path: path.to_path_buf(), source: error }
}
