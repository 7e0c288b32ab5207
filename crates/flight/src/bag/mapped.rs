//! Channels that a mapping file takes from columns `/topic.field.subfield`.

use super::clock::Clock;
use super::topic::Topic;
use crate::contract;
use crate::table::{Table, some};
use crate::{FlightError, FlightLog, Mapping, Result};
use std::collections::{BTreeMap, BTreeSet};

/// Columns that belong together, and so have to come from messages of one topic.
const GROUPS: [[&str; 3]; 10] = [
    ["px", "py", "pz"],
    ["qx", "qy", "qz"],
    ["vx", "vy", "vz"],
    ["wx", "wy", "wz"],
    ["ax", "ay", "az"],
    ["wind_x", "wind_y", "wind_z"],
    ["ref_x", "ref_y", "ref_z"],
    ["ref_vx", "ref_vy", "ref_vz"],
    ["ref_ax", "ref_ay", "ref_az"],
    ["cmd_roll", "cmd_pitch", "cmd_yaw"],
];

/// The topic of a column; topics have no dots in their names.
pub(super) fn topic_of(column: &str) -> &str {
    column.split('.').next().unwrap_or(column)
}

/// The topics that a mapping names columns of; `all` lists those of the bag for messages.
///
/// # Errors
/// Where what belongs together comes from several topics, or a column is not there.
pub(super) fn topics(
    log: &FlightLog,
    topics: &BTreeMap<String, Topic>,
    all: &[String],
    mapping: &Mapping,
) -> Result<BTreeSet<String>> {
    let names = mapping.file_names();
    for name in &names {
        let topic = topics.get(topic_of(name)).filter(|t| !t.log_ns.is_empty());
        let is_there =
            topic.is_some_and(|t| name.len() > t.name.len() && t.column(&name[t.name.len() + 1..]).is_some());
        if !is_there {
            let found: Vec<String> = match topic {
                Some(topic) => {
                    let left = topic.left_out.iter().map(|(path, why)| format!("(not {path}: {why})"));
                    topic.paths.iter().map(|p| format!("{}.{p}", topic.name)).chain(left).collect()
                }
                None => all.iter().map(|topic| format!("of {topic}")).collect(),
            };
            return Err(FlightError::MissingColumn {
                path: log.path.clone(),
                column: name.to_string(),
                why: "the mapping names it; columns of a bag are called `/topic.field.subfield`".into(),
                found: if found.is_empty() { "of no topic".into() } else { some(&found) },
            });
        }
    }
    let mut groups: Vec<Vec<&str>> = GROUPS
        .iter()
        .map(|g| g.iter().filter_map(|n| mapping.named(n)).map(|s| s.column.as_str()).collect())
        .collect();
    groups.push(mapping.attitude_columns());
    for group in groups {
        let of: BTreeSet<&str> = group.iter().map(|c| topic_of(c)).collect();
        if of.len() > 1 {
            return Err(FlightError::Mapping {
                path: mapping.path().to_path_buf(),
                key: "columns".into(),
                expected: format!(
                    "{} from messages of one topic, since they are of one time",
                    group.join(", ")
                ),
                found: of.into_iter().collect::<Vec<_>>().join(" and ").into(),
                remedy: "take them from one topic",
            });
        }
    }
    Ok(names.iter().map(|n| topic_of(n).to_string()).collect())
}

/// Fills the channels that a mapping names.
///
/// # Errors
/// Those of the contract.
pub(super) fn fill(log: &mut FlightLog, topics: &[&Topic], clock: &Clock, mapping: &Mapping) -> Result<()> {
    let wanted = mapping.file_names();
    let (mut names, mut places) = (Vec::new(), Vec::new());
    for (k, topic) in topics.iter().enumerate() {
        for (i, path) in topic.paths.iter().enumerate() {
            let name = format!("{}.{path}", topic.name);
            if wanted.contains(&name.as_str()) {
                names.push(name);
                places.push((k, i));
            }
        }
    }
    // One topic after the other: a row has the numbers of one message, and a channel those of one topic in its order.
    let mut columns: Vec<Vec<f64>> = vec![Vec::new(); names.len()];
    let (mut times, mut rows) = (Vec::new(), Vec::new());
    for (k, topic) in topics.iter().enumerate() {
        let t = clock.times(&topic.name);
        let kept: Vec<usize> =
            (0..t.len()).filter(|i| t[*i].is_finite() && passes(topic, *i, mapping)).collect();
        times.extend(kept.iter().map(|i| t[*i]));
        rows.extend(kept.iter().map(|i| i + 1));
        for (column, (of, place)) in columns.iter_mut().zip(&places) {
            match *of == k {
                // What is no number was not measured.
                true => column.extend(
                    kept.iter()
                        .map(|i| topic.columns[*place][*i])
                        .map(|v| if v.is_finite() { v } else { f64::NAN }),
                ),
                false => column.extend(kept.iter().map(|_| f64::NAN)),
            }
        }
    }
    let table = Table::new(names, columns.into_iter().map(Some).collect(), rows);
    contract::fill_named(log, &table, &times, mapping)
}

/// Whether a message is one that `where` asks for.
fn passes(topic: &Topic, i: usize, mapping: &Mapping) -> bool {
    mapping.filter().iter().all(|(name, value)| {
        let path = name.strip_prefix(topic.name.as_str()).and_then(|p| p.strip_prefix('.'));
        path.and_then(|p| topic.column(p)).is_none_or(|column| column[i] == *value)
    })
}
