//! One clock for all topics of a bag: the stamps of their messages, or the times at which they were recorded.

use super::topic::Topic;
use crate::clean::median;
use crate::{ClockFault, FlightError, FlightLog, Mapping, Result};
use std::collections::BTreeMap;

/// Most time by which stamps and recording may differ between topics, s: what is more is no delay but another clock.
const ONE_CLOCK_S: f64 = 1.0;

/// Which times a mapping asks for.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Wanted {
    Whatever,
    Recorded,
    Stamps,
}

/// Times of messages.
pub(super) struct Clock {
    /// What they count from, ns.
    base_ns: i64,
    /// By topic, s from the base; NaN where a message repeats the time of the one before.
    times: BTreeMap<String, Vec<f64>>,
    /// By topic, whether they are its stamps.
    stamped: BTreeMap<String, bool>,
}

impl Clock {
    /// Puts topics on one clock, and says in the log's notes and faults what is odd about it.
    ///
    /// # Errors
    /// [`FlightError::Mapping`] where a mapping asks for times that there are none of.
    pub fn new(log: &mut FlightLog, topics: &[&Topic], mapping: &Mapping) -> Result<Self> {
        let wanted = wanted(mapping)?;
        let mut stamps: BTreeMap<&str, Vec<i64>> = BTreeMap::new();
        if wanted != Wanted::Recorded {
            for topic in topics {
                match topic.stamps_ns() {
                    Some(of) if wanted == Wanted::Stamps || !stands_still(log, topic, &of) => {
                        stamps.insert(&topic.name, of);
                    }
                    None if wanted == Wanted::Stamps => {
                        let found = format!("messages of `{}` that have none", topic.name);
                        return Err(wrong(mapping, &found));
                    }
                    _ => {}
                }
            }
        }
        if wanted == Wanted::Whatever && !agree(log, topics, &stamps) {
            stamps.clear();
        }
        let of = |topic: &Topic| stamps.get(topic.name.as_str()).unwrap_or(&topic.log_ns).clone();
        let first = topics.iter().filter_map(|t| of(t).into_iter().min()).min();
        let mut clock =
            Self { base_ns: first.unwrap_or(0), times: BTreeMap::new(), stamped: BTreeMap::new() };
        for topic in topics {
            let stamped = stamps.contains_key(topic.name.as_str());
            let times = clock.rising(log, topic, &of(topic), stamped);
            clock.times.insert(topic.name.clone(), times);
            clock.stamped.insert(topic.name.clone(), stamped);
        }
        Ok(clock)
    }

    /// What times count from, s on the clock of the bag.
    pub fn base_s(&self) -> f64 {
        self.base_ns as f64 * 1e-9
    }

    /// Times of a topic, shape `(message,)`, s.
    pub fn times(&self, topic: &str) -> &[f64] {
        self.times.get(topic).map_or(&[], Vec::as_slice)
    }

    /// Where the times of a topic come from.
    pub fn source(&self, topic: &str) -> &'static str {
        if self.stamped.get(topic) == Some(&true) {
            "stamps of its messages"
        } else {
            "times of the recorder"
        }
    }

    fn rising(&self, log: &mut FlightLog, topic: &Topic, ns: &[i64], stamped: bool) -> Vec<f64> {
        let seconds = |ns: i64| ns.saturating_sub(self.base_ns) as f64 * 1e-9;
        let mut times: Vec<f64> = ns.iter().map(|ns| seconds(*ns)).collect();
        let (mut repeated, mut backwards) = (0usize, 0usize);
        for i in 1..ns.len() {
            if ns[i] == ns[i - 1] {
                times[i] = f64::NAN;
                repeated += 1;
            } else if ns[i] < ns[i - 1] {
                backwards += 1;
                log.clock_faults.push(ClockFault {
                    row: i + 1,
                    before_s: seconds(ns[i - 1]),
                    time_s: seconds(ns[i]),
                    topic: Some(topic.name.clone()),
                });
            }
        }
        if repeated > 0 {
            let name = &topic.name;
            log.warnings.push(format!(
                "{repeated} messages of {name} repeat the time of the one before and were left out"
            ));
        }
        if backwards > 0 && stamped {
            log.warnings.push(format!(
                "stamps of {} run backwards {backwards} times: `t = \"log_time\"` under [columns] of a mapping file takes the times of the recorder",
                topic.name
            ));
        }
        times
    }
}

fn wrong(mapping: &Mapping, found: &str) -> FlightError {
    FlightError::Mapping {
        path: mapping.path().to_path_buf(),
        key: "columns.t".into(),
        expected: "`log_time` (when a message was recorded) or `header.stamp` (when it was measured, in every message)".into(),
        found: found.into(),
        remedy: "name one of them, or leave `t` out",
    }
}

fn wanted(mapping: &Mapping) -> Result<Wanted> {
    match mapping.named("t") {
        None => Ok(Wanted::Whatever),
        Some(source) if source.convert(1.0) != 1.0 || source.convert(0.0) != 0.0 => {
            Err(wrong(mapping, "another unit: times of a bag are s"))
        }
        Some(source) => match source.column.as_str() {
            "log_time" => Ok(Wanted::Recorded),
            "header.stamp" => Ok(Wanted::Stamps),
            other => Err(wrong(mapping, other)),
        },
    }
}

/// Whether stamps hardly ever change, so that they are no times.
fn stands_still(log: &mut FlightLog, topic: &Topic, ns: &[i64]) -> bool {
    let repeats = ns.windows(2).filter(|w| w[0] == w[1]).count();
    let still = ns.len() > 2 && 2 * repeats > ns.len();
    if still {
        log.warnings
            .push(format!("stamps of {} stand still: its times are those of the recorder", topic.name));
    }
    still
}

/// Whether stamps and times of the recorder differ by the same in all topics.
fn agree(log: &mut FlightLog, topics: &[&Topic], stamps: &BTreeMap<&str, Vec<i64>>) -> bool {
    let mut apart: Vec<(f64, &str)> = topics
        .iter()
        .filter(|t| !t.log_ns.is_empty())
        .map(|topic| {
            let Some(stamps) = stamps.get(topic.name.as_str()) else { return (0.0, topic.name.as_str()) };
            let late = stamps.iter().zip(&topic.log_ns).map(|(s, l)| s.saturating_sub(*l) as f64 * 1e-9);
            (median(late.collect()).unwrap_or(0.0), topic.name.as_str())
        })
        .collect();
    apart.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (Some(least), Some(most)) = (apart.first(), apart.last()) else { return true };
    if stamps.is_empty() || most.0 - least.0 <= ONE_CLOCK_S {
        return true;
    }
    log.warnings.push(format!(
        "the clocks of {} and {} are {:.1} s apart, so all times are those of the recorder, with whatever delay messages had on their way: \
         set the clocks of the machines, or take `t = \"header.stamp\"` under [columns] of a mapping file if stamps are right",
        least.1,
        most.1,
        most.0 - least.0
    ));
    false
}
