//! Flights recorded by ROS 2: MCAP files, and folders of bags with such files.
//!
//! A file holds messages of topics and the definitions of their types, by which any of them can be read: [`container`] finds the messages,
//! [`schema`] reads definitions, [`cdr`] numbers, [`topic`] makes columns of them. What a column means is known for standard types ([`standard`]), else
//! by a mapping file ([`mapped`]).

mod cdr;
mod clock;
mod container;
mod folder;
mod mapped;
mod schema;
mod standard;
#[cfg(test)]
mod tests;
mod topic;

pub(super) use container::MAGIC;
pub use folder::is_bag;
pub(super) use folder::{files, refuse_others};

use super::error::{FlightError, Result};
use super::table::{MAX_ROWS, some};
use super::{FlightLog, Mapping};
use clock::Clock;
use container::Channel;
use schema::{Dialect, short_name};
use standard::Gives;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use topic::Topic;

/// Most numbers that are read: 2 GiB of them.
const MOST_NUMBERS: usize = 1 << 28;
/// Bytes behind the last field that alignment may leave.
const PADDING: usize = 7;

/// All files of a bag so far.
struct Bag<'a> {
    mapping: &'a Mapping,
    /// Topics that the mapping names columns of.
    named: BTreeSet<String>,
    topics: BTreeMap<String, Topic>,
    /// Topics that are not read, with what they hold.
    passed: BTreeMap<String, String>,
    /// Topics that cannot be read, and why.
    unreadable: BTreeMap<String, String>,
    /// Definitions by which topics are read: another one under the same name is another topic.
    definitions: BTreeMap<String, Vec<u8>>,
    numbers: usize,
    messages: usize,
}

impl Bag<'_> {
    /// Whether anyone asks for a topic.
    fn wants(&self, name: &str, kind: &str) -> bool {
        let found = self.mapping.finds_channels() && self.mapping.takes_topic(name) && standard::reads(kind);
        found || self.named.contains(name)
    }

    fn take(&mut self, channel: &Channel, log_ns: u64, message: &[u8]) {
        let name = &channel.topic;
        if self.numbers > MOST_NUMBERS || self.messages > MAX_ROWS || self.unreadable.contains_key(name) {
            return;
        }
        if !self.topics.contains_key(name) {
            let kind = channel.schema.as_ref().map_or(String::new(), |s| short_name(&s.name));
            match self.declared(channel, &kind) {
                Ok(Some(topic)) => drop(self.topics.insert(name.clone(), topic)),
                Ok(None) => {
                    self.passed.entry(name.clone()).or_insert(kind);
                    return;
                }
                Err(why) => {
                    self.unreadable.insert(name.clone(), why);
                    return;
                }
            }
        }
        let same = channel.schema.as_ref().is_some_and(|s| self.definitions.get(name) == Some(&s.text));
        let Some(topic) = self.topics.get_mut(name) else { return };
        if !same {
            let why = "it has several definitions, so its messages are of several kinds".to_string();
            self.topics.remove(name);
            self.unreadable.insert(name.clone(), why);
            return;
        }
        topic.push(i64::try_from(log_ns).unwrap_or(i64::MAX), message);
        self.numbers += topic.width();
        self.messages += 1;
    }

    /// All topics, with what they hold or why they cannot be read.
    fn list(&self) -> Vec<String> {
        let read = self.topics.values().map(|t| match failure(Some(t)) {
            Some(why) => format!("{} ({}: {why})", t.name, t.kind),
            None => format!("{} ({})", t.name, t.kind),
        });
        let passed = self.passed.iter().map(|(name, kind)| format!("{name} ({kind})"));
        let unreadable = self.unreadable.iter().map(|(name, why)| format!("{name} ({why})"));
        read.chain(passed).chain(unreadable).collect()
    }

    /// The topic that a channel declares; none where nobody asks for it.
    fn declared(&mut self, channel: &Channel, kind: &str) -> Result<Option<Topic>, String> {
        let schema = channel.schema.as_ref();
        let encoding = schema.map_or("", |s| s.encoding.as_str());
        let dialect = match (channel.encoding.as_str(), encoding) {
            ("cdr", "ros2msg") => Dialect::Ros2,
            ("ros1", "ros1msg") => Dialect::Ros1,
            ("cdr", "ros2idl") => return Err("its type is defined in IDL (`ros2idl`)".into()),
            ("cdr" | "ros1", "") => {
                return Err(
                    "the file has no definition of its type: record with the package of its messages sourced"
                        .into(),
                );
            }
            (message, _) => return Err(format!("its messages are `{message}`")),
        };
        let Some(schema) = schema.filter(|_| self.wants(&channel.topic, kind)) else { return Ok(None) };
        let text = String::from_utf8_lossy(&schema.text);
        if text.trim().is_empty() && schema.name != "std_msgs/msg/Empty" {
            return Err(
                "the file has no definition of its type: record with the package of its messages sourced"
                    .into(),
            );
        }
        let message = schema::parse(&schema.name, &text, dialect)?;
        self.definitions.insert(channel.topic.clone(), schema.text.clone());
        Topic::new(&channel.topic, kind, &message, dialect).map(Some)
    }
}

/// Reads a bag into `log`: the contents of its files, in order. Returns the time of the bag from which the log's times count, s.
///
/// # Errors
/// [`FlightError`] where nothing in it can be used, several topics could give the pose, or the mapping names what is not there.
pub(super) fn read<'a>(
    log: &mut FlightLog,
    contents: impl Iterator<Item = Result<(&'a Path, Vec<u8>)>>,
    mapping: Option<&Mapping>,
) -> Result<f64> {
    let plain = Mapping::default();
    let mapping = mapping.unwrap_or(&plain);
    let named = mapping.file_names().iter().map(|n| mapped::topic_of(n).to_string()).collect();
    let mut bag = Bag {
        mapping,
        named,
        topics: BTreeMap::new(),
        passed: BTreeMap::new(),
        unreadable: BTreeMap::new(),
        definitions: BTreeMap::new(),
        numbers: 0,
        messages: 0,
    };
    for file in contents {
        let (path, bytes) = file?;
        if !bytes.starts_with(MAGIC) {
            return Err(FlightError::Format {
                path: path.to_path_buf(),
                expected: "an MCAP file, which starts with the bytes 89 4D 43 41 50 30 0D 0A".into(),
                found: if bytes.is_empty() { "an empty file".into() } else { "other bytes".into() },
                remedy: "copy the bag again, or correct its ending".into(),
            });
        }
        let damage = container::read(&bytes, &mut |channel, ns, message| bag.take(channel, ns, message));
        say_damage(log, path, &damage);
    }
    if bag.numbers > MOST_NUMBERS || bag.messages > MAX_ROWS {
        return Err(FlightError::Format {
            path: log.path.clone(),
            expected: format!(
                "at most {MAX_ROWS} messages and {MOST_NUMBERS} numbers in topics that are read"
            ),
            found: "more".into(),
            remedy: "name the topics of the vehicle in a mapping file (`topics = [\"/…\"]`), or part the bag"
                .into(),
        });
    }
    bag.topics.values_mut().for_each(Topic::finish);
    used(log, &bag)
}

fn say_damage(log: &mut FlightLog, path: &Path, damage: &container::Damage) {
    let name = path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    if let Some(at) = damage.cut_at {
        log.warnings.push(format!(
            "{name} ends or is damaged at byte {at}, before its end was written (the recorder was stopped hard, or the copy is not whole): all \
             messages before it were read; `mcap recover {name} -o NEW.mcap` closes the file"
        ));
    }
    for (at, why) in damage.chunks.iter().take(5) {
        log.warnings
            .push(format!("{name}: the chunk at byte {at} is damaged ({why}): its messages were left out"));
    }
    if damage.chunks.len() > 5 {
        log.warnings
            .push(format!("{name}: {} more chunks are damaged and were left out", damage.chunks.len() - 5));
    }
    if damage.orphans > 0 {
        log.warnings.push(format!(
            "{name}: {} records were left out that are too short or belong to no topic",
            damage.orphans
        ));
    }
}

/// Fills the log with what the topics give.
fn used(log: &mut FlightLog, bag: &Bag) -> Result<f64> {
    let mapping = bag.mapping;
    let named =
        mapped::topics(log, &bag.topics, &bag.list(), mapping).map_err(|e| unread_column(log, bag, e))?;
    let choice = match mapping.finds_channels() {
        true => {
            let allowed = |t: &&Topic| mapping.takes_topic(&t.name) && standard::reads(&t.kind);
            standard::choose(log, bag.topics.values().filter(allowed), mapping)?
        }
        false => standard::Choice::default(),
    };
    let mut names: BTreeSet<&str> = named.iter().map(String::as_str).collect();
    names.extend(choice.given.iter().map(|(_, topic)| topic.as_str()));
    let topics: Vec<&Topic> = names.iter().filter_map(|n| bag.topics.get(*n)).collect();
    if topics.is_empty() {
        return Err(nothing(log, bag));
    }
    let clock = Clock::new(log, &topics, mapping)?;
    if !named.is_empty() {
        let of: Vec<&Topic> = topics.iter().copied().filter(|t| named.contains(&t.name)).collect();
        mapped::fill(log, &of, &clock, mapping)?;
    }
    let place = choice.given.iter().find(|(g, _)| *g == Gives::Position).and_then(|(_, t)| bag.topics.get(t));
    let world = place.and_then(Topic::frame);
    for (gives, name) in &choice.given {
        if let Some(topic) = bag.topics.get(name) {
            standard::fill(log, *gives, topic, clock.times(name), mapping, world);
        }
    }
    say(log, bag, &topics, &choice, &clock);
    let mut any = false;
    log.for_each(|_, _| any = true);
    if !any {
        return Err(nothing(log, bag));
    }
    log.n_rows = topics.iter().map(|t| t.log_ns.len()).sum();
    Ok(clock.base_s())
}

/// Tells why a topic that a mapping names has no columns, where it is known.
fn unread_column(log: &FlightLog, bag: &Bag, error: FlightError) -> FlightError {
    let FlightError::MissingColumn { column, .. } = &error else { return error };
    let name = mapped::topic_of(column);
    match bag.unreadable.get(name) {
        Some(why) => FlightError::Format {
            path: log.path.clone(),
            expected: format!("a topic {name} that can be read ({READABLE}), since the mapping names it"),
            found: why.clone(),
            remedy: "record or convert it as such messages".into(),
        },
        None => match failure(bag.topics.get(name)) {
            Some(found) => FlightError::Format {
                path: log.path.clone(),
                expected: format!(
                    "messages of {name} as their definition says, since the mapping names them"
                ),
                found,
                remedy: "record them again with the definition of the version that publishes them".into(),
            },
            None => error,
        },
    }
}

/// What was wrong with the messages of a topic of which none could be read.
fn failure(topic: Option<&Topic>) -> Option<String> {
    let topic = topic.filter(|t| t.log_ns.is_empty())?;
    topic.failed.as_ref().map(|(n, why)| format!("{why} ({n} messages)"))
}

/// What can be read, in the words of the format.
const READABLE: &str = "message encoding `cdr` with schema encoding `ros2msg`, or `ros1` with `ros1msg`";

/// The error of a bag that gives no channel.
fn nothing(log: &FlightLog, bag: &Bag) -> FlightError {
    let found = bag.list();
    let (found, remedy) = if found.is_empty() {
        ("no message".into(), "check that the recorder ran, and that its topics were published")
    } else {
        let remedy = "name columns `/topic.field.subfield` in a mapping file beside the log (docs/logs.md, ROS 2 bags and MCAP)";
        (format!("the topics {}", some(&found)), remedy)
    };
    FlightError::Format {
        path: log.path.clone(),
        expected: format!(
            "messages that say what they are, such as geometry_msgs/msg/PoseStamped, nav_msgs/msg/Odometry, sensor_msgs/msg/Imu ({READABLE})"
        ),
        found,
        remedy: remedy.into(),
    }
}

/// Says what came from where, and what was left out.
fn say(log: &mut FlightLog, bag: &Bag, topics: &[&Topic], choice: &standard::Choice, clock: &Clock) {
    let said = &mut log.warnings;
    for topic in topics {
        let words = Some(choice.words(&topic.name)).filter(|w| !w.is_empty());
        let words = words.unwrap_or_else(|| "columns of the mapping".into());
        said.push(format!("{} ({}): {words}; times: {}", topic.name, topic.kind, clock.source(&topic.name)));
        if let Some((n, why)) = &topic.failed {
            said.push(format!("{n} messages of {} were left out: {why}", topic.name));
        }
        if topic.behind > PADDING {
            said.push(format!(
                "messages of {} have {} bytes behind their last field: the definition in the file may be of another version",
                topic.name, topic.behind
            ));
        }
        for (path, why) in &topic.left_out {
            said.push(format!("{}.{path} was left out: {why}", topic.name));
        }
    }
    said.extend(choice.notes.iter().cloned());
    for topic in bag.topics.values().filter(|t| !topics.iter().any(|u| u.name == t.name)) {
        if let Some(why) = failure(Some(topic)) {
            said.push(format!("{} was left out: {why}", topic.name));
        } else if let Some(which) = topic.mixed() {
            said.push(format!(
                "{} was left out: its messages tell of several bodies or frames ({which} changes); record each on a topic of its own",
                topic.name
            ));
        }
    }
    let mut why: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for (name, of) in &bag.unreadable {
        why.entry(of).or_default().push(name);
    }
    for (why, names) in why {
        said.push(format!("{} left out: {why}; what is read is {READABLE}", some(&names)));
    }
    let ignored = |name: &str| bag.mapping.ignores(name);
    let used = |name: &str| topics.iter().any(|t| t.name == name);
    let mut others: Vec<String> = bag
        .topics
        .values()
        .filter(|t| !used(&t.name) && !ignored(&t.name) && failure(Some(t)).is_none())
        .map(|t| format!("{} ({})", t.name, t.kind))
        .collect();
    others.extend(
        bag.passed.iter().filter(|(n, _)| !ignored(n)).map(|(name, kind)| format!("{name} ({kind})")),
    );
    if !others.is_empty() {
        said.push(format!("topics that nothing uses, ignored: {}", some(&others)));
    }
}
