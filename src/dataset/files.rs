//! Files that are either whole or absent.

use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::path::Path;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::error::{DatasetError, Result};
use crate::flight::files;

/// A file of a world, as listed in `world.json`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileRecord {
    /// Path inside the world's folder, with `/`.
    pub path: String,
    /// Size.
    pub bytes: u64,
    /// SHA-256 of the contents, hexadecimal.
    pub sha256: String,
}

/// SHA-256 in hexadecimal.
pub(super) fn hex(digest: impl AsRef<[u8]>) -> String {
    digest.as_ref().iter().map(|b| format!("{b:02x}")).collect()
}

/// SHA-256 of bytes, hexadecimal.
pub(super) fn sha256(bytes: &[u8]) -> String {
    hex(Sha256::digest(bytes))
}

/// Size and hash of the file at `folder/path`.
pub(super) fn record(folder: &Path, path: &str) -> Result<FileRecord> {
    let full = folder.join(path);
    let mut file = File::open(&full).map_err(DatasetError::io(&full))?;
    let (mut hash, mut bytes, mut buffer) = (Sha256::new(), 0, vec![0; 1 << 16]);
    loop {
        match file.read(&mut buffer) {
            Ok(0) => break,
            Ok(n) => {
                bytes += n as u64;
                hash.update(&buffer[..n]);
            }
            Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
            Err(e) => return Err(DatasetError::Io { path: full, source: e }),
        }
    }
    Ok(FileRecord { path: path.to_owned(), bytes, sha256: hex(hash.finalize()) })
}

/// Errors unless the file at `folder/path` has the size, and where `contents` the hash, of `wanted`.
pub(super) fn check(folder: &Path, wanted: &FileRecord, contents: bool) -> Result<()> {
    let full = folder.join(&wanted.path);
    let size = match fs::metadata(&full) {
        Ok(data) => data.len(),
        Err(e) if e.kind() == io::ErrorKind::NotFound => {
            return Err(DatasetError::damaged(&full, "a file that the list names", "none"));
        }
        Err(e) => return Err(DatasetError::Io { path: full, source: e }),
    };
    if size != wanted.bytes {
        return Err(DatasetError::damaged(&full, format!("{} bytes", wanted.bytes), format!("{size} bytes")));
    }
    if contents {
        let found = record(folder, &wanted.path)?.sha256;
        if found != wanted.sha256 {
            return Err(DatasetError::damaged(
                &full,
                format!("sha256 {}", wanted.sha256),
                format!("sha256 {found}"),
            ));
        }
    }
    Ok(())
}

/// Paths of all files below a folder, relative to it, with `/`, sorted. Links are files, wherever they lead.
pub(super) fn names(folder: &Path) -> Result<Vec<String>> {
    let mut all = Vec::new();
    for entry in fs::read_dir(folder).map_err(DatasetError::io(folder))? {
        let entry = entry.map_err(DatasetError::io(folder))?;
        let name = entry.file_name().to_string_lossy().into_owned();
        let kind = entry.file_type().map_err(DatasetError::io(entry.path()))?;
        if kind.is_dir() {
            all.extend(names(&entry.path())?.into_iter().map(|inner| format!("{name}/{inner}")));
        } else {
            all.push(name);
        }
    }
    all.sort();
    Ok(all)
}

/// Asks the system to bring a file or folder to the disk.
pub(super) fn sync(path: &Path) -> Result<()> {
    File::open(path).and_then(|f| f.sync_all()).map_err(DatasetError::io(path))
}

pub(super) use files::PARTIAL;

/// Writes `folder/name` so that it is there either whole or not at all.
pub(super) fn write_atomic(folder: &Path, name: &str, bytes: &[u8]) -> Result<()> {
    let path = folder.join(name);
    files::write(&path, true, |file| file.write_all(bytes)).map_err(DatasetError::io(&path))?;
    sync(folder)
}
