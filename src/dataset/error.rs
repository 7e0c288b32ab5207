//! What can go wrong with a data set.

use std::path::{Path, PathBuf};

/// A data set could not be written or read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DatasetError {
    /// The system refused a file operation.
    #[error("{}: {source}; check the path, its permissions and the space on the disk", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file of another format could not be made.
    #[error("{what}")]
    Export {
        /// The format, and what went wrong.
        what: String,
    },
    /// The output folder holds something else.
    #[error(
        "{}: expected an empty folder or a data set, found {found}; choose another --out or empty the folder",
        path.display()
    )]
    NotADataset {
        /// The folder.
        path: PathBuf,
        /// What lies there.
        found: String,
    },
    /// The manifest is of another format or version.
    #[error(
        "{}: expected format \"{}\" version {}, found {found}; read it with the program that wrote it",
        path.display(), super::FORMAT, super::FORMAT_VERSION
    )]
    ForeignFormat {
        /// The manifest.
        path: PathBuf,
        /// Its format and version.
        found: String,
    },
    /// The folder holds a data set of another run.
    #[error(
        "{}: holds a data set that was made with other settings, so it cannot be continued:\n{differences}\n\
         use these settings again, choose another --out, or delete the folder",
        path.display()
    )]
    ManifestMismatch {
        /// The data set's folder.
        path: PathBuf,
        /// One line per field: name, value in the folder, value asked for.
        differences: String,
    },
    /// A manifest asks for something impossible.
    #[error("manifest field {field}: expected {expected}, found {found}; {remedy}")]
    Manifest {
        /// Dotted name of the field.
        field: String,
        /// What it may be.
        expected: String,
        /// What it is.
        found: String,
        /// What to do.
        remedy: &'static str,
    },
    /// Another process writes the same folder.
    #[error("{}: another process is writing this data set; wait for it or choose another --out", path.display())]
    Busy {
        /// The folder.
        path: PathBuf,
    },
    /// A world number is out of range, finished already, or open elsewhere.
    #[error("world {world}: {problem}")]
    World {
        /// The world.
        world: usize,
        /// What is wrong and what to do.
        problem: String,
    },
    /// A row or a frame does not fit the manifest.
    #[error("world {world}, {item}: expected {expected}, found {found}; {remedy}")]
    Input {
        /// The world.
        world: usize,
        /// Which row or frame, and which part of it.
        item: String,
        /// What the manifest promises.
        expected: String,
        /// What was given.
        found: String,
        /// What to do.
        remedy: &'static str,
    },
    /// A file is absent, cut short, or has other contents than were written.
    #[error("{}: expected {expected}, found {found}; restore the file or write the data set anew", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What should be there.
        expected: String,
        /// What is there.
        found: String,
    },
    /// Whoever asked for the data set wanted it to stop.
    #[error("stopped with {done} of {all} worlds written; the same command again goes on from there")]
    Stopped {
        /// Worlds that are there.
        done: usize,
        /// All of them.
        all: usize,
    },
    /// Not all worlds are there.
    #[error(
        "{}: expected {expected} worlds, {missing} of them not finished (first: world {first}); \
         run the command that made it again, it continues where it stopped",
        path.display()
    )]
    Incomplete {
        /// The data set's folder.
        path: PathBuf,
        /// Worlds in the manifest.
        expected: usize,
        /// Worlds that are not there.
        missing: usize,
        /// The first of them.
        first: usize,
    },
    /// No such column or array.
    #[error("{}: expected one of {available}, found a request for \"{name}\"; correct the name", path.display())]
    NoSuchName {
        /// The file.
        path: PathBuf,
        /// What was asked for.
        name: String,
        /// What there is.
        available: String,
    },
    /// The overview picture cannot be drawn from this input.
    #[error("overview picture, {item}: expected {expected}, found {found}; correct the input")]
    Overview {
        /// Which part.
        item: String,
        /// What it should be.
        expected: String,
        /// What it is.
        found: String,
    },
}

impl DatasetError {
    /// An I/O error at `path`, for `map_err`.
    pub(super) fn io(path: impl AsRef<Path>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.as_ref().to_path_buf();
        move |source| Self::Io { path, source }
    }

    /// Damage at `path`.
    pub(super) fn damaged(
        path: impl AsRef<Path>,
        expected: impl Into<String>,
        found: impl std::fmt::Display,
    ) -> Self {
        Self::Damaged {
            path: path.as_ref().to_path_buf(),
            expected: expected.into(),
            found: found.to_string(),
        }
    }
}

/// Result with [`DatasetError`].
pub type Result<T, E = DatasetError> = std::result::Result<T, E>;
