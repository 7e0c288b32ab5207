//! Compiled steps on disk: `NAME.so` beside `NAME.sum`, the hash of its bytes.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime};

use propwash_trace::kernel::hash;

use crate::CompileError;

/// Files of builds that were cut off are removed after this time.
const STALE: Duration = Duration::from_hours(1);

/// Counts the builds of this process, so that no two write the same file.
static BUILDS: AtomicU64 = AtomicU64::new(0);

/// The cache folder, which need not exist yet.
pub(crate) fn folder() -> Result<PathBuf, CompileError> {
    if let Some(own) = std::env::var_os("PROPWASH_CACHE").filter(|v| !v.is_empty()) {
        return Ok(PathBuf::from(own).join("steps"));
    }
    let named = |name| std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from);
    let home = || {
        let below = if cfg!(target_os = "macos") { "Library/Caches" } else { ".cache" };
        named("HOME").map(|home| home.join(below))
    };
    named("XDG_CACHE_HOME")
        .or_else(home)
        .map(|folder| folder.join("propwash").join("steps"))
        .ok_or_else(|| CompileError::Cache { folder: "~/.cache".into(), why: "HOME is not set".into() })
}

/// The library of that name, if it is there and whole.
pub(crate) fn find(folder: &Path, name: &str) -> Option<PathBuf> {
    let file = folder.join(format!("{name}.so"));
    let sum = fs::read_to_string(file.with_extension("sum")).ok()?;
    let bytes = fs::read(&file).ok()?;
    (sum.trim() == checksum(&bytes)).then_some(file)
}

fn checksum(bytes: &[u8]) -> String {
    format!("{:032x}", hash(bytes.iter().copied()))
}

/// Makes the folder, for its owner alone. Code is loaded from it, so nobody else may be able to write there.
fn prepared(folder: &Path) -> Result<(), CompileError> {
    let failed = |why: String| CompileError::Cache { folder: folder.display().to_string(), why };
    let mut builder = fs::DirBuilder::new();
    builder.recursive(true);
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    builder.create(folder).map_err(|e| failed(e.to_string()))?;
    #[cfg(unix)]
    {
        let mode = fs::metadata(folder).map_err(|e| failed(e.to_string()))?;
        if std::os::unix::fs::PermissionsExt::mode(&mode.permissions()) & 0o022 != 0 {
            return Err(failed("others may write to it (chmod go-w would mend that)".into()));
        }
    }
    Ok(())
}

/// Puts a library into the cache: `build` writes it to a file of its own, which then takes its name in one step, so that another process finds a whole
/// one or none.
pub(crate) fn put(
    folder: &Path,
    name: &str,
    build: impl FnOnce(&Path) -> Result<(), CompileError>,
) -> Result<PathBuf, CompileError> {
    prepared(folder)?;
    sweep(folder);
    let failed =
        |e: std::io::Error| CompileError::Cache { folder: folder.display().to_string(), why: e.to_string() };
    let own = format!("{name}.{}.{}.tmp", std::process::id(), BUILDS.fetch_add(1, Ordering::Relaxed));
    let (own, file) = (folder.join(own), folder.join(format!("{name}.so")));
    let made = build(&own).and_then(|()| {
        let sum = checksum(&fs::read(&own).map_err(failed)?);
        let own_sum = own.with_extension("sum.tmp");
        fs::write(&own_sum, sum).map_err(failed)?;
        fs::rename(&own_sum, file.with_extension("sum")).map_err(failed)?;
        fs::rename(&own, &file).map_err(failed)
    });
    if made.is_err() {
        // What a failed build left; that there is nothing is no second error.
        let _ = fs::remove_file(&own);
        let _ = fs::remove_file(own.with_extension("sum.tmp"));
    }
    made.map(|()| file)
}

/// Removes what builds left that were cut off.
fn sweep(folder: &Path) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        let is_build = entry.path().extension().is_some_and(|e| e == "tmp");
        let age = entry
            .metadata()
            .and_then(|m| m.modified())
            .ok()
            .and_then(|t| SystemTime::now().duration_since(t).ok());
        if is_build && age.is_some_and(|age| age > STALE) {
            // Another process may have been faster.
            let _ = fs::remove_file(entry.path());
        }
    }
}
