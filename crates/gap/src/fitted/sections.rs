//! Flights in which something changed: the flight before and after each moment, fitted by itself.
//!
//! The interval that holds a moment belongs to neither side. What is written is the vehicle after the last moment: as it is now.

use super::{Calibrate, Filed, Fitted, fit};
use crate::decide::rules::{Rule, Why};
use crate::decide::sentence;
use crate::diagnose::{Diagnosed, Moments, Settings};
use crate::error::{Error, GapError, Result};
use crate::formula::{Formula, vehicle_with, with_formulas};
use crate::headline::{headline, since};
use crate::ladder::{Flights, together};
use crate::moments::{Moment, moments, words};
use crate::replay::drone_for;
use crate::track::{SHORTEST_S, Track};
use crate::verdict::{Diagnosis, Finding, Rung, Section};

/// Fits the flight before, between and after the moments of `whole`, the diagnosis as if nothing had changed.
///
/// # Errors
/// [`GapError::Cancelled`] at the watcher's wish.
pub(super) fn fit_each(
    filed: &Filed,
    flights: &Flights,
    settings: &Settings,
    (by, calibrate): (&str, Calibrate),
    whole: Diagnosed,
) -> Result<Fitted> {
    let mut moments = whole.verdict.moments.clone();
    let mut parts = parts(&flights.whole, &moments);
    let last = parts.len() - 1;
    let mut sections: Vec<Section> = Vec::new();
    let mut fitted: Vec<(usize, Flights, Fitted)> = Vec::new();
    for (i, part) in parts.iter_mut().enumerate() {
        let logs: Vec<String> = part.tracks.iter().map(|t| t.name.clone()).collect();
        // Held-out logs are flights of the vehicle as it is now; of an earlier one only what was missing is shown.
        let held_out = if i == last { flights.held_out.clone() } else { Vec::new() };
        let calibrate = if i == last { calibrate } else { Calibrate::No };
        let flown = Flights::new(std::mem::take(&mut part.tracks), held_out, flights.share);
        match alone(filed, &flown, settings, (by, calibrate)) {
            Ok(mut one) => {
                let earlier = sections.last().map_or(&[][..], |s| &s.findings);
                if let Some(m) = i.checked_sub(1).map(|m| &mut moments[m]) {
                    m.look_alikes.extend(instead(&one.diagnosed.verdict, m, earlier));
                    tell_apart(&mut one.diagnosed.verdict, m, earlier);
                }
                sections.push(Section::of(logs, &one.diagnosed.verdict));
                fitted.push((i, flown, one));
            }
            Err(Error::Gap(GapError::Cancelled)) => return Err(GapError::Cancelled.into()),
            Err(error) => sections.push(Section::left_out(logs, &error)),
        }
    }
    let ladders: Vec<(String, Vec<Rung>)> = fitted
        .iter_mut()
        .map(|(i, _, f)| (parts[*i].name.clone(), std::mem::take(&mut f.diagnosed.verdict.ladder)))
        .collect();
    let earlier: Vec<String> =
        fitted.iter().flat_map(|(.., f)| f.diagnosed.verdict.warnings.iter().cloned()).collect();
    let Some((now, flown, mut out)) = fitted.pop() else {
        let mut verdict = whole.verdict.clone();
        verdict.sections = sections;
        verdict.warnings.push("no part of the flight is long enough to be fitted by itself".into());
        return Ok(Fitted {
            diagnosed: Diagnosed { verdict, ..whole },
            after: None,
            text: filed.text.clone(),
            calibrated: 0,
            unwritable: Vec::new(),
            at_best: None,
            now: None,
            helped: None,
        });
    };
    let verdict = &mut out.diagnosed.verdict;
    verdict.ladder = together(&ladders);
    verdict.warnings = earlier;
    verdict.warnings.sort();
    verdict.warnings.dedup();
    for m in &moments {
        verdict.why.push(Why::new(
            &m.id,
            Rule::Moment,
            format!("{:.1} nats: {}", m.evidence_nats, words::sentence(m)),
        ));
    }
    say(verdict, moments, sections, &parts.iter().map(|p| p.name.as_str()).collect::<Vec<_>>(), now);
    out.now = Some(flown);
    Ok(out)
}

/// The flight as one, where a formula explains what seemed to change in it: a force that acts in one direction only, or near the ground,
/// comes and goes with the path, and what the list has for it differs from one part of the flight to the next. `None` where none does,
/// or where one change leaves nothing unexplained: `changed` is the flight by parts.
///
/// # Errors
/// [`GapError::Cancelled`] at the watcher's wish.
pub(super) fn by_formula(
    filed: &Filed,
    flights: &Flights,
    settings: &Settings,
    (by, calibrate): (&str, Calibrate),
    changed: &Diagnosis,
) -> Result<Option<Fitted>> {
    let open = changed.sections.iter().any(|s| s.unexplained) || !changed.formulas.is_empty();
    let doubtful = changed.moments.len() > 1 || open;
    if settings.no_formulas || !doubtful || changed.moments.iter().any(|m| m.between_logs) {
        return Ok(None);
    }
    let one = Settings { moments: Moments::No, ..settings.copied() };
    let own = Filed { label: filed.label, vehicle: filed.vehicle, text: filed.text.clone() };
    let mut fitted = match fit(own, flights, &one, by, calibrate) {
        Ok(fitted) => fitted,
        Err(Error::Gap(GapError::Cancelled)) => return Err(GapError::Cancelled.into()),
        // What changed is still told.
        Err(_) => return Ok(None),
    };
    let Diagnosed { verdict, solution, model, .. } = &mut fitted.diagnosed;
    // A formula that goes with time is a change itself, and a change has a name.
    let steady = !verdict.formulas.is_empty() && !verdict.formulas.iter().any(Formula::goes_with_time);
    if !steady {
        return Ok(None);
    }
    let vehicle = vehicle_with(filed.vehicle, &with_formulas(&filed.text, &verdict.formulas))?;
    let Some(first) = flights.fit.first() else { return Ok(None) };
    let drone = drone_for(first, &vehicle)?;
    let unexplained = verdict.remainder.unexplained;
    let left = moments(&flights.whole, &drone, (model, solution), unexplained, &settings.watch)?;
    if !left.is_empty() {
        return Ok(None);
    }
    for m in &changed.moments {
        // Without what else it could be: a part of the flight may have had a formula of its own, which is none here.
        let text = format!("not told: {}; with {} nothing changes", words::short(m), verdict.formulas[0].id);
        verdict.why.push(Why::new(&m.id, Rule::Moment, text));
    }
    Ok(Some(fitted))
}

/// A stretch of flight as a flight of its own.
fn alone(
    filed: &Filed,
    flown: &Flights,
    settings: &Settings,
    (by, calibrate): (&str, Calibrate),
) -> Result<Fitted> {
    if flown.whole.is_empty() {
        let reason = format!("it is shorter than {SHORTEST_S} s");
        return Err(Error::Gap(GapError::Numbers { what: "a stretch of flight", reason }));
    }
    let own = Settings { moments: Moments::No, whole: None, ..settings.copied() };
    let filed = Filed { label: filed.label, vehicle: filed.vehicle, text: filed.text.clone() };
    fit(filed, flown, &own, by, calibrate)
}

impl Section {
    fn of(logs: Vec<String>, verdict: &Diagnosis) -> Self {
        let unexplained = verdict.remainder.unexplained;
        let Diagnosis { headline, verdict, findings, .. } = verdict.clone();
        Self { logs, headline, verdict, findings, unexplained, fitted: true }
    }

    fn left_out(logs: Vec<String>, error: &Error) -> Self {
        let words = format!("not diagnosed: {error}");
        Self {
            logs,
            headline: words.clone(),
            verdict: words,
            findings: Vec::new(),
            unexplained: true,
            fitted: false,
        }
    }
}

/// What the flight after a moment names in the place of its effect: it may be what changed.
fn instead(after: &Diagnosis, m: &Moment, earlier: &[Finding]) -> Vec<String> {
    let like = |f: &Finding| f.look_alikes.iter().any(|l| l.ids == [m.id.as_str()]);
    if after.findings.iter().chain(earlier).any(|f| f.id == m.id) {
        return Vec::new();
    }
    let new = after.findings.iter().filter(|f| !earlier.iter().any(|e| e.id == f.id));
    let new = new.filter(|f| like(f) || f.certain).map(|f| f.id.clone());
    new.filter(|id| !m.look_alikes.contains(id)).collect()
}

/// Of what looks like an effect that came with a moment, what was tried as the change and ruled out is taken away; it is certain where
/// nothing is left. A mass or a thrust within tolerance is the same before and after.
fn tell_apart(verdict: &mut Diagnosis, m: &Moment, earlier: &[Finding]) {
    if !m.look_alikes.is_empty() || earlier.iter().any(|f| f.id == m.id) {
        return;
    }
    let Some(f) = verdict.findings.iter_mut().find(|f| f.id == m.id && !f.certain && f.doubt().is_none())
    else {
        return;
    };
    let before = f.look_alikes.len();
    f.look_alikes.retain(|l| l.ids.len() != 1 || !m.ruled_out.contains(&l.ids[0]));
    if f.look_alikes.len() == before {
        return;
    }
    f.certain = f.look_alikes.is_empty();
    let words = format!("{} were tried as the change and explain it clearly worse", m.ruled_out.join(", "));
    verdict.why.push(Why::new(&m.id, Rule::Moment, words));
    verdict.verdict = sentence(&verdict.findings, &verdict.remainder, &[], 0);
    verdict.headline = headline(&verdict.verdict, &verdict.findings, verdict.remainder.unexplained);
}

/// The sentence and the headline of a flight with moments; `now` is the section that the rest of the verdict is about.
fn say(verdict: &mut Diagnosis, moments: Vec<Moment>, sections: Vec<Section>, names: &[&str], now: usize) {
    let each = |of: fn(&Section) -> &str| {
        let one = |(name, s): (&&str, &Section)| format!("{name}: {}", of(s));
        names.iter().zip(&sections).map(one).collect::<Vec<_>>().join("; ")
    };
    verdict.verdict = format!("{}; {}", words::list(&moments, words::sentence), each(|s| &s.verdict));
    let changed = words::list(&moments, words::short);
    let now = if now + 1 == names.len() { "since then" } else { names[now] };
    verdict.headline = since(moments.len(), &changed, &format!("{now}: {}", verdict.headline));
    (verdict.moments, verdict.sections) = (moments, sections);
}

/// A stretch of flight in which nothing changed.
struct Part {
    /// `before 17.3 s`, `from 17.3 s on`.
    name: String,
    tracks: Vec<Track>,
}

/// The flights before, between and after moments, which are in the order of the logs and of time.
fn parts(tracks: &[Track], moments: &[Moment]) -> Vec<Part> {
    let at = |m: &Moment| match m.between_logs {
        true => m.log.clone(),
        false => format!("{:.1} s", m.at_s),
    };
    let mut names = Vec::new();
    for i in 0..=moments.len() {
        names.push(match (i.checked_sub(1).map(|b| &moments[b]), moments.get(i)) {
            (None, Some(end)) => format!("before {}", at(end)),
            (Some(from), Some(end)) => format!("from {} to {}", at(from), at(end)),
            (Some(from), None) => format!("from {} on", at(from)),
            (None, None) => "all".into(),
        });
    }
    let mut out: Vec<Part> = names.into_iter().map(|name| Part { name, tracks: Vec::new() }).collect();
    let mut now = 0;
    for (index, track) in tracks.iter().enumerate() {
        let [begin, end] = track.span_s;
        let mut from = begin;
        for m in moments.iter().filter(|m| m.index == index) {
            let [last, first] = if m.between_logs { [begin, begin] } else { m.interval_s };
            out[now].tracks.extend(part(track, [from, last]));
            now += 1;
            from = first;
        }
        out[now].tracks.extend(part(track, [from, end]));
    }
    out
}

/// A stretch of a log under its own name; `None` where it is too short for a fit.
fn part(track: &Track, [from, to]: [f64; 2]) -> Option<Track> {
    let [begin, end] = track.span_s;
    if to - from < SHORTEST_S {
        return None;
    }
    let mut out = track.cut([from, to]);
    let name = &track.name;
    out.name = match (from > begin, to < end) {
        (false, false) => name.clone(),
        (false, true) => format!("{name} to {to:.1} s"),
        (true, false) => format!("{name} from {from:.1} s"),
        (true, true) => format!("{name} {from:.1} to {to:.1} s"),
    };
    Some(out)
}
