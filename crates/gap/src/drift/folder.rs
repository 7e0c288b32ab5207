//! The logs of a folder, oldest first.

use crate::error::GapError;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

/// Endings of files that are logs. Text files with another ending are none, whatever they hold: a README is not tried.
const ENDINGS: [&str; 5] = ["csv", "parquet", "ulg", "ulog", "mcap"];
/// Deepest sub-folder: PX4 writes one for each day.
const DEEPEST: usize = 4;
/// Most files of a folder: more is a disk.
const MOST: usize = 100_000;

/// In which order logs are taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Order {
    /// By the time at which the file was last changed; by name where two are the same.
    #[default]
    Time,
    /// By name.
    Name,
}

/// A log that was found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Found {
    /// Where it is.
    pub path: PathBuf,
    /// Path relative to the folder, with `/`.
    pub name: String,
    /// Size, bytes.
    pub bytes: u64,
    /// When it was last changed, s since 1970-01-01 UTC.
    pub changed_unix_s: Option<u64>,
    /// The same, ns, to see that it is still written.
    changed_unix_ns: u128,
}

/// What a look at a folder found.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Listing {
    /// Logs, oldest first.
    pub logs: Vec<Found>,
    /// Number of other files.
    pub others: usize,
}

impl Listing {
    /// The logs that are as they were in an earlier look, and those that are still written.
    pub fn still(self, before: &Self) -> (Vec<Found>, Vec<Found>) {
        self.logs.into_iter().partition(|log| before.logs.contains(log))
    }
}

/// Looks at a folder with its sub-folders; hidden files and folders are left out, and links to folders are not followed.
///
/// # Errors
/// [`GapError::Log`] where it is no folder or cannot be read.
pub fn look(folder: &Path, order: Order) -> Result<Listing, GapError> {
    let mut out = Listing::default();
    let wrong = |e: std::io::Error| GapError::Log {
        log: folder.display().to_string(),
        expected: "a folder with flight logs".into(),
        found: e.to_string(),
        remedy: "check the path and its permissions".into(),
    };
    // What a sub-folder refuses is no reason to miss the others.
    let mut open = vec![(folder.to_path_buf(), 0)];
    while let Some((at, depth)) = open.pop() {
        let entries = match fs::read_dir(&at) {
            Ok(entries) => entries,
            Err(error) if depth == 0 => return Err(wrong(error)),
            Err(_) => continue,
        };
        for entry in entries.flatten() {
            if entry.file_name().to_string_lossy().starts_with('.') || out.logs.len() + out.others >= MOST {
                continue;
            }
            match entry.file_type() {
                Ok(kind) if kind.is_dir() && depth < DEEPEST => open.push((entry.path(), depth + 1)),
                Ok(kind) if !kind.is_dir() => match found(folder, entry.path()) {
                    Some(log) => out.logs.push(log),
                    None => out.others += 1,
                },
                _ => {}
            }
        }
    }
    out.logs.sort_by(|a, b| {
        let by_name = a.name.cmp(&b.name);
        if order == Order::Name { by_name } else { a.changed_unix_ns.cmp(&b.changed_unix_ns).then(by_name) }
    });
    Ok(out)
}

/// The log at a path, where it is one.
fn found(folder: &Path, path: PathBuf) -> Option<Found> {
    let ending = path.extension()?.to_string_lossy().to_lowercase();
    let about = fs::metadata(&path).ok().filter(fs::Metadata::is_file)?;
    if !ENDINGS.contains(&ending.as_str()) {
        return None;
    }
    let changed = about.modified().ok().and_then(|t| t.duration_since(UNIX_EPOCH).ok());
    let relative = path.strip_prefix(folder).unwrap_or(&path);
    let name: Vec<String> =
        relative.components().map(|c| c.as_os_str().to_string_lossy().into_owned()).collect();
    Some(Found {
        name: name.join("/"),
        bytes: about.len(),
        changed_unix_s: changed.map(|t| t.as_secs()),
        changed_unix_ns: changed.map_or(0, |t| t.as_nanos()),
        path,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::{Duration, SystemTime};

    #[test]
    fn logs_come_by_time_or_by_name_and_others_are_counted() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::create_dir_all(at("2026-11-26/deep")).unwrap();
        fs::create_dir(at(".hidden")).unwrap();
        let now = SystemTime::now();
        for (i, name) in
            ["b.csv", "2026-11-26/a.ULG", "a.parquet", "README.md", "c.txt", ".hidden/d.csv", ".x.csv"]
                .iter()
                .enumerate()
        {
            let file = fs::File::create(at(name)).unwrap();
            file.set_modified(now + Duration::from_secs(60 * i as u64)).unwrap();
        }
        let names = |order| {
            let listing = look(folder.path(), order).unwrap();
            assert_eq!(listing.others, 2);
            listing.logs.into_iter().map(|l| l.name).collect::<Vec<_>>()
        };
        assert_eq!(names(Order::Time), ["b.csv", "2026-11-26/a.ULG", "a.parquet"]);
        assert_eq!(names(Order::Name), ["2026-11-26/a.ULG", "a.parquet", "b.csv"]);
        assert!(
            look(&at("none"), Order::Time).unwrap_err().to_string().contains("a folder with flight logs")
        );
    }

    #[test]
    fn a_log_that_grows_between_two_looks_is_not_still() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        fs::write(&path, "t,px").unwrap();
        let before = look(folder.path(), Order::Time).unwrap();
        fs::write(&path, "t,px\n0,1").unwrap();
        let now = look(folder.path(), Order::Time).unwrap();
        let (still, grows) = now.clone().still(&before);
        assert!(still.is_empty() && grows.len() == 1);
        assert_eq!(now.clone().still(&now).0.len(), 1);
    }
}
