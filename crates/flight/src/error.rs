//! What can go wrong with a flight log.

use crate::files::suggestion;
use std::path::PathBuf;

/// Errors of reading, mapping and writing flight logs. Each says what was expected, what was found, where, and what
/// to do.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum FlightError {
    /// A file could not be read.
    #[error("{}: cannot be read ({reason}): check the path and its permissions{}", path.display(), suggestion(path))]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        reason: String,
    },
    /// A file could not be written.
    #[error("{}: cannot be written ({reason}): check the path and its permissions", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system said.
        reason: String,
    },
    /// The file is not what its ending or its mapping says.
    #[error("{}: expected {expected}, found {found}: {remedy}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// What would be right.
        expected: String,
        /// What it is.
        found: String,
        /// What to do.
        remedy: String,
    },
    /// A column that is needed is not there.
    #[error(
        "{}: expected a column `{column}` ({why}), found the columns {found}: \
         rename the column, or name it in a mapping file beside the log", path.display()
    )]
    MissingColumn {
        /// The file.
        path: PathBuf,
        /// The column.
        column: String,
        /// What needs it.
        why: String,
        /// Columns that are there.
        found: String,
    },
    /// A cell holds no finite number.
    #[error("{}: row {row}, column `{column}`: expected {expected}, found `{found}`: {remedy}", path.display())]
    Cell {
        /// The file.
        path: PathBuf,
        /// Line of the file, the header being 1; for Parquet the row from 1.
        row: usize,
        /// Name in the file.
        column: Box<str>,
        /// What would be right.
        expected: &'static str,
        /// What stands there.
        found: Box<str>,
        /// What to do.
        remedy: &'static str,
    },
    /// A mapping file is wrong.
    #[error("{}: `{key}`: expected {expected}, found {found}: {remedy}", path.display())]
    Mapping {
        /// The mapping file.
        path: PathBuf,
        /// Key in it.
        key: Box<str>,
        /// What would be right.
        expected: String,
        /// What stands there.
        found: Box<str>,
        /// What to do.
        remedy: &'static str,
    },
    /// The checker refuses the log.
    #[error("{}: cannot be right: {reason}; `propwash log check` gives the whole list", path.display())]
    Refused {
        /// The file.
        path: PathBuf,
        /// Its sentences.
        reason: String,
    },
}

/// Result with [`FlightError`].
pub type Result<T, E = FlightError> = std::result::Result<T, E>;
