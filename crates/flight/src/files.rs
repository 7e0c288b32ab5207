//! Files: read within limits, written whole or not at all, and replacing no other unasked.

use sha2::{Digest, Sha256};
use std::cell::Cell;
use std::fs::{self, File, OpenOptions};
use std::io::{Error, ErrorKind, Result};
use std::panic::{self, AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Once;

/// How the name of a file begins that is not whole yet.
pub const PARTIAL: &str = ".partial_";

/// Size of the largest file that is read at once, bytes: 4 GiB.
pub const MAX_BYTES: u64 = 4 << 30;

/// What a file holds.
///
/// # Errors
/// Those of the system; and for what is no file on a disk, or larger than [`MAX_BYTES`], before a byte of it is read.
pub fn read(path: &Path) -> Result<Vec<u8>> {
    let found = fs::metadata(path)?;
    if !found.is_file() && !found.is_dir() {
        let words = "it is a device or a pipe; expected a file: write what comes of it into one";
        return Err(Error::new(ErrorKind::InvalidInput, words));
    }
    if found.len() > MAX_BYTES {
        let words =
            format!("it has {} bytes; expected at most {MAX_BYTES}: part it into several", found.len());
        return Err(Error::new(ErrorKind::FileTooLarge, words));
    }
    fs::read(path)
}

/// SHA-256 of a file, lower-case hexadecimal.
///
/// # Errors
/// As [`read`].
pub fn sha256(path: &Path) -> Result<String> {
    Ok(Sha256::digest(read(path)?).iter().map(|b| format!("{b:02x}")).collect())
}

/// The text that a file holds.
///
/// # Errors
/// As [`read`], and where it is no UTF-8.
pub fn read_text(path: &Path) -> Result<String> {
    String::from_utf8(read(path)?).map_err(|e| Error::new(ErrorKind::InvalidData, e.utf8_error()))
}

/// Whether a file can be written at `path`: its folder is there and takes files, and there is none at `path` yet or `replace`
/// allows it to go. Devices and pipes are never replaced. Call it before long work.
///
/// # Errors
/// Of the kind [`ErrorKind::AlreadyExists`] only where `replace` would help.
pub fn may_write(path: &Path, replace: bool) -> Result<()> {
    match fs::metadata(path) {
        Ok(found) if found.is_dir() => {
            return Err(Error::new(ErrorKind::IsADirectory, "it is a folder; expected the path of a file"));
        }
        Ok(found) if !found.is_file() => return Ok(()),
        _ if !replace && path.symlink_metadata().is_ok() => {
            return Err(Error::new(ErrorKind::AlreadyExists, "there is a file already"));
        }
        _ => {}
    }
    partial(&target(path)).map(drop)
}

/// Writes a file with `fill`. Until it is whole it has another name beside `path`, so that neither a full disk nor an error leaves
/// a part of it or harms a file that it replaces. Links are followed; devices and pipes are written to as they are.
///
/// # Errors
/// Those of [`may_write`], of `fill`, and of the system.
pub fn write(path: &Path, replace: bool, fill: impl FnOnce(&mut File) -> Result<()>) -> Result<()> {
    may_write(path, replace)?;
    let before = fs::metadata(path).ok();
    if before.as_ref().is_some_and(|found| !found.is_file()) {
        return fill(&mut OpenOptions::new().write(true).open(path)?);
    }
    let target = target(path);
    let (mut file, partial) = partial(&target)?;
    fill(&mut file)?;
    if let Some(before) = before {
        file.set_permissions(before.permissions())?;
    }
    file.sync_all()?;
    fs::rename(&partial.0, &target)
}

/// Where a path leads.
fn target(path: &Path) -> PathBuf {
    fs::canonicalize(path).unwrap_or_else(|_| path.to_path_buf())
}

/// A file that goes with its owner, where it was not renamed.
struct Partial(PathBuf);

impl Drop for Partial {
    fn drop(&mut self) {
        // It is gone where all went well; where it cannot be removed, the error that led here is told already.
        let _ = fs::remove_file(&self.0);
    }
}

/// A new file beside `target`, in which it grows.
fn partial(target: &Path) -> Result<(File, Partial)> {
    let folder = match target.parent() {
        Some(parent) if parent.as_os_str().is_empty() => Path::new("."),
        Some(parent) => parent,
        None => Path::new("/"),
    };
    if !folder.is_dir() {
        let what = if folder.exists() { "is no folder" } else { "is not there: make that folder first" };
        return Err(Error::new(ErrorKind::NotFound, format!("{} {what}", folder.display())));
    }
    let slash = target.as_os_str().as_encoded_bytes().ends_with(b"/");
    let Some(name) = target.file_name().filter(|_| !slash) else {
        return Err(Error::new(
            ErrorKind::InvalidInput,
            "expected the name of a file at the end of the path",
        ));
    };
    let name = format!("{PARTIAL}{}.{}", name.to_string_lossy(), std::process::id());
    let path = folder.join(name);
    let file = OpenOptions::new().write(true).create(true).truncate(true).open(&path)?;
    Ok((file, Partial(path)))
}

/// `; did you mean …?` with the nearest name in the folder of a file that does not exist, else nothing.
pub fn suggestion(path: &Path) -> String {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let (Some(name), Ok(entries), false) = (path.file_name(), std::fs::read_dir(folder), path.exists())
    else {
        return String::new();
    };
    let mut known: Vec<String> =
        entries.flatten().map(|e| e.file_name().to_string_lossy().into_owned()).collect();
    // The order of a folder is any.
    known.sort();
    propwash_trace::names::nearest(&name.to_string_lossy(), known.iter().map(String::as_str))
        .map_or_else(String::new, |k| format!("; did you mean `{}`?", path.with_file_name(k).display()))
}

thread_local! {
    /// True while a parser that is not ours runs in this thread.
    static PARSING: Cell<bool> = const { Cell::new(false) };
}

/// Runs a parser that is not ours, which may panic on an odd file; words for the error where it does. Such a panic prints nothing: the
/// file is at fault, and the error says so. Panics of other code are told as before.
///
/// # Errors
/// What to say that was found.
pub fn parsed<T>(parse: impl FnOnce() -> T) -> std::result::Result<T, String> {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let before = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            if !PARSING.get() {
                before(info);
            }
        }));
    });
    PARSING.set(true);
    let done = catch_unwind(AssertUnwindSafe(parse));
    PARSING.set(false);
    done.map_err(|_| "a record on which the parser gives up".into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write as _;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_is_replaced_whole_on_request_and_not_at_all_otherwise() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        write(&path, false, |f| f.write_all(b"old")).unwrap();
        let error = write(&path, false, |f| f.write_all(b"new")).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::AlreadyExists);
        // A disk that fills up after some bytes.
        let full = |f: &mut File| f.write_all(b"ne").and(Err(Error::other("no space")));
        assert_eq!(write(&path, true, full).unwrap_err().to_string(), "no space");
        assert_eq!(fs::read(&path).unwrap(), b"old");
        write(&path, true, |f| f.write_all(b"new")).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(names(folder.path()), ["a.csv"], "nothing else is left");
    }

    #[test]
    fn what_cannot_be_written_is_said_before_the_work() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        fs::write(&file, "").unwrap();
        let said = |path: &Path| may_write(path, true).unwrap_err().to_string();
        assert!(said(folder.path()).contains("it is a folder"));
        assert!(said(&folder.path().join("no/a.csv")).contains("no is not there: make that folder first"));
        assert!(said(&file.join("a.csv")).contains("file is no folder"));
        assert!(said(&folder.path().join("a/")).contains("name of a file"));
        assert!(may_write(&folder.path().join("a.csv"), false).is_ok());
        assert_eq!(names(folder.path()), ["file"], "asking leaves nothing behind");
    }

    #[cfg(unix)]
    #[test]
    fn endless_and_huge_files_are_refused_unread() {
        let said = read(Path::new("/dev/zero")).unwrap_err().to_string();
        assert!(said.contains("a device or a pipe; expected a file"), "{said}");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("huge.csv");
        // A hole: it takes no space.
        File::create(&path).unwrap().set_len(MAX_BYTES + 1).unwrap();
        let said = read_text(&path).unwrap_err().to_string();
        assert!(said.contains("4294967297 bytes; expected at most 4294967296"), "{said}");
    }

    #[cfg(unix)]
    #[test]
    fn links_are_followed_and_devices_stay_devices() {
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("file"), folder.path().join("link"));
        fs::write(&file, "old").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        assert!(may_write(&link, false).is_err());
        write(&link, true, |f| f.write_all(b"new")).unwrap();
        assert!(link.is_symlink() && fs::read(&file).unwrap() == b"new");
        write(Path::new("/dev/null"), false, |f| f.write_all(b"away")).unwrap();
        assert!(!fs::metadata("/dev/null").unwrap().is_file());
    }

    #[test]
    fn the_file_that_was_meant_is_found() {
        assert_eq!(suggestion(Path::new("cargo.tml")), "; did you mean `Cargo.toml`?");
        assert_eq!(suggestion(Path::new("Cargo.toml")), "", "it is there");
        assert_eq!(suggestion(Path::new("no/such/folder")), "");
    }
}
