//! Which of a log's tracked objects is the load and which are other vehicles.

use super::Options;
use crate::GapError;
use propwash_flight::FlightLog;

/// Name of the tracked load.
pub(super) fn load(log: &FlightLog, options: &Options) -> Result<Option<String>, GapError> {
    Ok(match &options.load {
        Some(wanted) => Some(known_object(log, wanted)?),
        None => log.objects_m.keys().find(|n| is_load(n)).cloned(),
    })
}

/// Names of tracked vehicles.
pub(super) fn neighbours(
    log: &FlightLog,
    options: &Options,
    load: Option<&String>,
) -> Result<Vec<String>, GapError> {
    match &options.neighbours {
        Some(list) => list.iter().map(|n| known_object(log, n)).collect(),
        None => Ok(log.objects_m.keys().filter(|n| !is_load(n) && Some(*n) != load).cloned().collect()),
    }
}

fn is_load(name: &str) -> bool {
    let name = name.to_lowercase();
    name.contains("load") || name.contains("cargo") || name.contains("weight")
}

fn known_object(log: &FlightLog, name: &str) -> Result<String, GapError> {
    if log.objects_m.contains_key(name) {
        return Ok(name.into());
    }
    let list: Vec<&str> = log.objects_m.keys().map(String::as_str).collect();
    let known = if list.is_empty() { "no tracked objects in this log".into() } else { list.join(", ") };
    Err(GapError::Unknown { name: name.into(), what: "tracked object", known })
}
