//! Spans of a log excluded from an analysis: the parts of [`propwash_flight::usable`], for a vehicle.

use super::track::SHORTEST_S;
use propwash_flight::usable::{self, Excluded, Known, Reason, Unusable};
use propwash_flight::{Channel, FlightLog};
use propwash_vehicle::{DYNAMICS, Vehicle};

/// Spans of a log that are unusable with a vehicle.
pub(crate) fn look(log: &FlightLog, vehicle: &Vehicle) -> Unusable {
    let known = vehicle.drone(DYNAMICS[0]).map_or_else(
        |_| Known::default(),
        |drone| Known {
            hover_rotor_rad_s: Some(drone.hover_rotor_vel()[0]).filter(|w| *w > 0.0),
            hover_thrust_n: Some(drone.hover_thrust()).filter(|f| *f > 0.0),
        },
    );
    usable::look(log, &known)
}

/// The part of an input in flight: its median corresponds to the vehicle's weight.
pub(crate) fn flying<const N: usize>(cut: &Unusable, c: &Channel<N>) -> Channel<N> {
    let marks: Vec<bool> = c.t_s.iter().map(|t| cut.at(*t)).collect();
    propwash_flight::clean::without(c, &marks)
}

/// Remaining time within a span, s.
pub(crate) fn left_s(excluded: &[Excluded], span_s: [f64; 2]) -> f64 {
    let mut list: Vec<[f64; 2]> = excluded
        .iter()
        .filter(|e| e.hides_state())
        .map(|e| [e.from_s.max(span_s[0]), e.to_s.min(span_s[1])])
        .filter(|s| s[1] > s[0])
        .collect();
    list.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let (mut lost, mut until) = (0.0, f64::NEG_INFINITY);
    for [from, to] in list {
        lost += (to - from.max(until)).max(0.0);
        until = until.max(to);
    }
    span_s[1] - span_s[0] - lost
}

/// The span without excluded parts at its ends. A gap of one channel is excluded too: no window may start in it.
pub(crate) fn trimmed(excluded: &[Excluded], mut span_s: [f64; 2]) -> [f64; 2] {
    loop {
        let before = span_s;
        for e in excluded.iter().filter(|e| e.hides_state()) {
            if e.from_s <= span_s[0] && e.to_s > span_s[0] {
                span_s[0] = e.to_s;
            }
            if e.to_s >= span_s[1] && e.from_s < span_s[1] {
                span_s[1] = e.from_s;
            }
        }
        if span_s == before || span_s[1] <= span_s[0] {
            return span_s;
        }
    }
}

/// What is missing in a flight with less than [`SHORTEST_S`] left, in words; `None` where enough is left.
pub(crate) fn too_little(cut: &Unusable, span_s: [f64; 2]) -> Option<String> {
    let left = left_s(&cut.excluded, span_s).max(0.0);
    if left >= SHORTEST_S {
        return None;
    }
    // The longest gap is irrelevant where most of the log is no flight.
    let gap = |reason: &Option<Reason>| *reason == Some(Reason::Dropout);
    let said: Vec<String> =
        cut.sentences().into_iter().filter(|(_, r)| r.is_some() && !gap(r)).map(|(text, _)| text).collect();
    Some(if said.is_empty() { format!("{left:.2} s") } else { format!("{left:.2} s ({})", said.join("; ")) })
}
