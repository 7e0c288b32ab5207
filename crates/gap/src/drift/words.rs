//! A series in words: a block for each file, and a table of parameters over logs.

use super::changes::{Change, ChangeKind, ChangedParameter, Space};
use super::sight::{OfTheFlight, Sight};
use super::{Entry, Series};
use crate::report::quantity::{interval, quantity};
use crate::report::significant;

/// One file in a few lines.
pub fn block(entry: &Entry) -> String {
    let when = if entry.changed_utc.is_empty() { "" } else { "  " };
    let head = format!("{}{when}{}", entry.name, entry.changed_utc);
    if let Some(reason) = &entry.left_out {
        return format!("{head}  left out: {reason}");
    }
    let mut out = vec![format!("{head}  {:.1} s, driven by {}", entry.duration_s, entry.drive)];
    out.extend(entry.changes.iter().map(|c| format!("  {}", sentence(entry, c))));
    let mut reasons: Vec<&str> = entry.doubtful.iter().filter_map(|c| c.doubt.as_deref()).collect();
    reasons.dedup();
    for reason in reasons {
        let own = entry.doubtful.iter().filter(|c| c.doubt.as_deref() == Some(reason));
        let ids: Vec<&str> = own.map(|c| c.id.as_str()).collect();
        out.push(format!("  in doubt, not accepted: {} ({reason})", ids.join(", ")));
    }
    if !entry.still.is_empty() {
        let all: Vec<String> =
            entry.still.iter().map(|(id, since)| format!("{id} (since {since})")).collect();
        out.push(format!("  still there: {}", all.join(", ")));
    }
    if entry.changes.is_empty() && entry.doubtful.is_empty() {
        out.push("  nothing has drifted".into());
    }
    out.push(format!("  this log alone: {}", entry.headline));
    if !entry.of_the_flight.is_empty() {
        let all: Vec<String> = entry.of_the_flight.iter().map(of_flight).collect();
        out.push(format!("  of this flight, no drift: {}", all.join(", ")));
    }
    let errors =
        [("as accepted before", entry.forecast_over_file), ("as accepted now", entry.errors_over_file)];
    let errors: Vec<String> = errors
        .iter()
        .filter_map(|(words, ratio)| Some(format!("{} {words}", significant((*ratio)?, 3))))
        .collect();
    if !errors.is_empty() {
        out.push(format!("  errors on its held-out end, the file's being 1: {}", errors.join(", ")));
    }
    out.join("\n")
}

fn of_flight(of: &OfTheFlight) -> String {
    format!("{} {} {}", of.id, of.name, interval(of.value, of.sigma, &of.unit))
}

/// A drift in one sentence.
fn sentence(entry: &Entry, c: &Change) -> String {
    let since = if c.since == entry.name { "in this log".into() } else { format!("since {}", c.since) };
    let how = if c.until > c.from { "little by little " } else { "" };
    let what = match c.kind {
        ChangeKind::DiffersFromFile => format!(
            "not as the file says, {}",
            if c.since == entry.name { "from this log on" } else { &since }
        ),
        ChangeKind::New => format!("new {since}"),
        ChangeKind::Drifted => format!("drifted {how}{since}"),
        ChangeKind::GoesOn => format!("goes on drifting {how}{since}"),
        ChangeKind::Returned => format!("back to what it was, {how}{since}"),
    };
    let or = match c.look_alikes.is_empty() {
        true => String::new(),
        false => format!("; or {}", c.look_alikes.join(", or ")),
    };
    let ratio = c
        .errors_ratio
        .map_or_else(String::new, |r| format!(", {} times the errors on unseen flight", significant(r, 3)));
    format!(
        "{}: {what}: {} ({}; {:.0} nats{ratio}{or})",
        c.id,
        numbers(&c.parameters, c.kind == ChangeKind::New).join(", "),
        c.title,
        c.evidence_nats
    )
}

/// Parameters that changed with the values before and after, 95 % intervals, only after for what is `new`; those that hardly move are left
/// out.
pub(crate) fn numbers(parameters: &[ChangedParameter], new: bool) -> Vec<String> {
    let most = parameters.iter().map(ChangedParameter::sigmas).fold(0.0, f64::max);
    let one = |p: &ChangedParameter| {
        let values = [(p.before, p.before_sigma), (p.after, p.after_sigma)];
        let of = |(value, sigma): (f64, f64)| interval(value, sigma, &p.unit);
        let absolute = p.of.as_ref().map_or_else(String::new, |(of, unit)| {
            let [before, after] = values.map(|v| quantity(v.0 * of, unit, 3));
            format!(" ({before} → {after})")
        });
        match new {
            true => format!("{} {}", p.name, of(values[1])),
            false => format!("{} {} → {}{absolute}", p.name, of(values[0]), of(values[1])),
        }
    };
    parameters.iter().filter(|p| p.sigmas() > 0.25 * most).map(one).collect()
}

/// Parameters that have drifted, over the logs: what each log by itself says of them, and what is accepted at the end.
pub fn table(series: &Series) -> String {
    let flights: Vec<(&Entry, &Sight)> = series.flights().collect();
    let left = series.entries().iter().filter(|e| e.left_out.is_some()).count();
    let mut out = vec![format!("{} logs diagnosed, {left} left out", flights.len())];
    // In the order in which they were said.
    let mut ids: Vec<&str> = Vec::new();
    for c in flights.iter().flat_map(|(e, _)| &e.changes) {
        if !ids.contains(&c.id.as_str()) {
            ids.push(&c.id);
        }
    }
    if ids.is_empty() {
        out.push("nothing has drifted".into());
        return out.join("\n");
    }
    let space = Space::new(&flights.iter().map(|f| f.1).collect::<Vec<_>>());
    let accepted = series.accepted();
    let width = flights.iter().map(|(e, _)| e.name.chars().count()).max().unwrap_or(0).max(8);
    for effect in ids.iter().filter_map(|id| space.effect(id)) {
        let id = &space.effects()[effect].id;
        for (i, p) in space.parameters_of(effect).into_iter().enumerate() {
            let Some(now) = accepted.iter().find(|a| a.id == *id && a.name == p.name) else { continue };
            out.push(format!("{id} {}", p.name));
            out.push(format!("  {:width$}  {}", "file", quantity(p.filed, &p.unit, 4)));
            for (log, (entry, _)) in flights.iter().enumerate() {
                let Some((value, sigma)) = space.alone(log, effect).get(i).copied() else { continue };
                let said = entry.changes.iter().any(|c| c.id == *id);
                let mark = if said { "  ← said here" } else { "" };
                out.push(format!("  {:width$}  {}{mark}", entry.name, interval(value, sigma, &p.unit)));
            }
            out.push(format!("  {:width$}  {}", "accepted", interval(now.value, now.sigma, &now.unit)));
        }
    }
    out.join("\n")
}
