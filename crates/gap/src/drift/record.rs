//! The record of a series: lines of JSON, the first about vehicle and settings, then one for each file. A later run goes on from it and
//! diagnoses no log again.

use super::{Entry, Series};
use crate::error::GapError;
use propwash_flight::files;
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::path::Path;

/// Version of the lines; another one is refused.
const VERSION: u32 = 1;
const WHAT: &str = "propwash watch";

/// The first line.
#[derive(Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Head {
    record: String,
    version: u32,
    vehicle: String,
    vehicle_sha256: String,
    settings: String,
}

impl Series {
    fn head(&self) -> Head {
        let r = &self.reading;
        // What a log says follows from all of these.
        let settings = format!("{:?} {:?} {}", r.mapping, r.options, r.hold_out);
        Head {
            record: WHAT.into(),
            version: VERSION,
            vehicle: self.label.clone(),
            vehicle_sha256: self.vehicle.sha256(),
            settings,
        }
    }

    /// Goes on from a record; a file that is not there yet is an empty one. Returns the number of files that it knows.
    ///
    /// # Errors
    /// [`GapError::Log`] where the file is no record, or that of another vehicle, other settings or another version.
    pub fn resume(&mut self, path: &Path) -> Result<usize, GapError> {
        if !path.exists() {
            return Ok(0);
        }
        let wrong = |expected: &str, found: String| GapError::Log {
            log: path.display().to_string(),
            expected: expected.into(),
            found,
            remedy: "name another file with --record, or remove this one to begin anew".into(),
        };
        let text = files::read_text(path).map_err(|e| wrong("a record of propwash watch", e.to_string()))?;
        let mut lines = text.lines();
        let head: Head = serde_json::from_str(lines.next().unwrap_or_default())
            .map_err(|_| wrong("a record of propwash watch", "a file without its first line".into()))?;
        let own = self.head();
        if head.record != WHAT || head.version != VERSION {
            let found = format!("{} {}", head.record, head.version);
            return Err(wrong(&format!("{WHAT} {VERSION}"), found));
        }
        if head.vehicle_sha256 != own.vehicle_sha256 {
            let found = format!("that of {} with SHA-256 {}", head.vehicle, head.vehicle_sha256);
            let expected = format!("a record of {} with SHA-256 {}", own.vehicle, own.vehicle_sha256);
            return Err(wrong(&expected, found));
        }
        if head.settings != own.settings {
            return Err(wrong(&format!("a record with the settings {}", own.settings), head.settings));
        }
        let entries = lines
            .enumerate()
            .map(|(i, line)| {
                serde_json::from_str::<Entry>(line).map_err(|e| {
                    wrong("a record of propwash watch", format!("line {} with an error ({e})", i + 2))
                })
            })
            .collect::<Result<Vec<_>, _>>()?;
        self.entries = entries;
        Ok(self.entries.len())
    }

    /// Writes the record whole; one that is there is replaced.
    ///
    /// # Errors
    /// Those of the system.
    pub fn record(&self, path: &Path) -> std::io::Result<()> {
        files::write(path, true, |file| {
            serde_json::to_writer(&mut *file, &self.head())?;
            for entry in &self.entries {
                file.write_all(b"\n")?;
                serde_json::to_writer(&mut *file, entry)?;
            }
            file.write_all(b"\n")
        })
    }
}
