//! A verdict in one line: what is missing, in at most [`HEADLINE_CHARS`] characters, and one sentence of evidence.

use super::policy::{HEADLINE_CHARS, WORTH_CORRECTING};
use super::report::{Scale, significant};
use super::search::THRESHOLD;
use super::verdict::{Diagnosis, Finding, Rung};

/// Short form of the verdict: what is missing and what is in doubt, most important first. `verdict` is the whole sentence,
/// used where nothing was found.
pub fn headline(verdict: &str, findings: &[Finding], unexplained: bool) -> String {
    let name = |f: &Finding, short: bool| match f.look_alikes.len() {
        _ if f.certain => f.id.clone(),
        1 if short => format!("{} (or another)", f.id),
        1 => format!("{} (or {})", f.id, f.look_alikes[0].ids.join(" + ")),
        n => format!("{} (or {n} others)", f.id),
    };
    // In doubt unless the finding or one of its look-alikes is missing for certain.
    let open = |f: &&Finding| f.doubt().is_some() || !(f.certain || f.one_of_several());
    let named = |short: bool| -> Vec<String> {
        findings.iter().filter(|f| !open(f)).map(|f| name(f, short)).collect()
    };
    let mut sure = named(false);
    let mut shortest = false;
    let doubtful: Vec<String> = findings.iter().filter(open).map(|f| f.id.clone()).collect();
    if findings.is_empty() {
        // What follows these marks is left to the full sentence.
        let end = [" (nearest", "; "].iter().filter_map(|stop| verdict.find(stop)).min();
        return shortened(&verdict[..end.unwrap_or(verdict.len())]);
    }
    let rest = if unexplained { "; something unexplained is left" } else { "" };
    let listed = |names: &[String], shown: usize| match names.len() - shown {
        0 => names.join("; "),
        1 if shown == 0 => "1 effect".into(),
        more if shown == 0 => format!("{more} effects"),
        more => format!("{} and {more} more", names[..shown].join("; ")),
    };
    // The names of look-alikes are dropped first, then the last names, those in doubt before the others.
    let mut shown = [sure.len(), doubtful.len()];
    loop {
        let mut parts = Vec::new();
        if !sure.is_empty() {
            parts.push(format!("missing: {}", listed(&sure, shown[0])));
        }
        if !doubtful.is_empty() {
            parts.push(format!("in doubt: {}", listed(&doubtful, shown[1])));
        }
        let line = format!("{}{rest}", parts.join("; "));
        if line.chars().count() <= HEADLINE_CHARS || shown == [0, 0] {
            return shortened(&line);
        }
        if !shortest {
            (sure, shortest) = (named(true), true);
            continue;
        }
        let from = if shown[1] > 0 { 1 } else { 0 };
        shown[from] -= 1;
    }
}

/// A headline after what changed at `n` moments, `changed`: of both as much as there is room for.
pub(crate) fn since(n: usize, changed: &str, then: &str) -> String {
    let first = then.split("; ").next().unwrap_or(then);
    let (many, none) =
        (if n == 1 { "1 change".into() } else { format!("{n} changes") }, "nothing is missing");
    let short = first.find(none).map_or(first, |at| &first[..at + none.len()]);
    let lines = [(changed, then), (changed, first), (changed, short), (&many, first), (&many, short)];
    let lines = lines.map(|(changed, then)| format!("{changed}; {then}"));
    shortened(lines.iter().find(|l| l.chars().count() <= HEADLINE_CHARS).unwrap_or(&lines[4]))
}

/// At most [`HEADLINE_CHARS`] characters, with an ellipsis where words are cut.
pub(crate) fn shortened(line: &str) -> String {
    if line.chars().count() <= HEADLINE_CHARS {
        return line.to_string();
    }
    let kept: String = line.chars().take(HEADLINE_CHARS - 1).collect();
    format!("{}…", kept.trim_end())
}

/// Splits a sentence into a beginning of at most [`HEADLINE_CHARS`] characters and the rest: at its first semicolon if that
/// is short enough, else at the last comma or colon that is.
pub(crate) fn parted(sentence: &str) -> (&str, &str) {
    let ends: Vec<(usize, &str)> = ["; ", ", ", ": "]
        .into_iter()
        .flat_map(|mark| sentence.match_indices(mark))
        .filter(|(at, _)| sentence[..*at].chars().count() <= HEADLINE_CHARS)
        .collect();
    let whole = sentence.chars().count() <= HEADLINE_CHARS;
    let first = ends.iter().filter(|(_, mark)| *mark == "; ").min();
    let last = ends.iter().max().filter(|_| !whole);
    match first.or(last) {
        Some((at, mark)) => (&sentence[..*at], &sentence[at + mark.len()..]),
        None => (sentence, ""),
    }
}

/// One sentence of evidence for a headline: how the first finding changes the error, or what remains without findings.
pub fn evidence(d: &Diagnosis) -> String {
    let first = d.findings.iter().find(|f| f.doubt().is_none()).or(d.findings.first());
    let by_network = || {
        let network = d.network.as_ref()?;
        let (found, h) = (network.found.as_ref()?, network.held_out.as_ref()?);
        let numbers = pair(h.without, h.with, &h.unit);
        Some(format!("without and with {} on {}: {} {numbers}", found.id, d.judged_on(), h.channel))
    };
    let Some(f) = first else {
        return by_network().or_else(|| corrections(d)).unwrap_or_else(|| d.remainder.text.clone());
    };
    if let Some(doubt) = f.doubt() {
        return format!("{}: {doubt}", f.id);
    }
    match before_after(f) {
        Some(words) => format!("without and with {} on {}: {words}", f.id, d.judged_on()),
        None => format!("{}: evidence {}", f.id, nats(f.evidence_nats)),
    }
}

/// Evidence with what is required of it. The last fit, at all estimates, may take back a little of what a finding was named by.
pub(crate) fn nats(evidence: f64) -> String {
    let required = if evidence < THRESHOLD { "were required, before the last fit" } else { "are required" };
    format!("{}\u{a0}nats ({THRESHOLD} {required})", significant(evidence, 3))
}

/// How much calibration improves a model in which nothing is missing; `None` if little, or if something is unexplained.
fn corrections(d: &Diagnosis) -> Option<String> {
    let position_m = |rung: &Rung| rung.judged().0.last().map(|e| (e.horizon_s, e.position_m));
    let (horizon_s, before) = position_m(d.ladder.first()?)?;
    let (_, after) = position_m(d.ladder.last()?)?;
    let small = d.remainder.unexplained || after > WORTH_CORRECTING * before;
    if small {
        return None;
    }
    let numbers = pair(before, after, "m");
    let labels = d.ladder[1..].iter().map(|r| r.label.as_str());
    let mut far: Vec<&str> = d.calibration.iter().filter(|c| c.far()).map(|c| c.id.as_str()).collect();
    far.dedup();
    let (which, but) = corrected(labels, &far);
    Some(format!("{which} do the rest: position after {horizon_s} s {numbers} (add --calibrate){but}"))
}

/// What ends the label of the step of a ladder with corrections that lower no error.
pub(crate) const NO_HELP: &str = "no help";

/// Which corrections help, by the labels of a ladder, and which of them are outside tolerance.
fn corrected<'a>(labels: impl Iterator<Item = &'a str>, far: &[&str]) -> (String, String) {
    let helped = labels.filter(|label| !label.ends_with(NO_HELP)).map(|label| label.trim_start_matches("+ "));
    let helped: Vec<&str> = helped.collect();
    let which = if helped.is_empty() { String::new() } else { format!(" ({})", helped.join(", ")) };
    match far.is_empty() {
        true => (format!("small corrections within tolerance{which}"), String::new()),
        false => {
            let but = format!("; outside tolerance, on too little evidence: {}", far.join(", "));
            (format!("corrections{which}"), but)
        }
    }
}

/// `force across the rotors 395 → 45 mN, 8.7 → 1.2 times noise`; `None` where it was not measured.
pub fn before_after(f: &Finding) -> Option<String> {
    let h = f.held_out.as_ref()?;
    let numbers = pair(h.without, h.with, &h.unit);
    let times = h.times_noise.map_or_else(String::new, |[a, b]| {
        format!(", {} → {} times noise", significant(a, 2), significant(b, 2))
    });
    Some(format!("{} {numbers}{times}", h.channel))
}

/// `395 → 45 mN`: both in the unit that suits the larger.
pub fn pair(before: f64, after: f64, unit: &str) -> String {
    let scale = Scale::for_size(before.max(after), unit);
    let digits = if (before / after).ln().abs() < 0.1 { 4 } else { 3 };
    let mark = if scale.unit.is_empty() || scale.unit == "°" { "" } else { " " };
    format!(
        "{} → {}{mark}{}",
        significant(before * scale.factor, digits),
        significant(after * scale.factor, digits),
        scale.unit
    )
}

/// A number with three significant digits and its unit.
pub(crate) fn number(value: f64, unit: &str) -> String {
    Scale::for_size(value, unit).show(value, 3)
}

#[cfg(test)]
mod tests {
    use super::*;

    use crate::verdict::{HeldOut, LookAlike, Said};
    use propwash_physics::effects::Area;

    #[test]
    fn corrections_outside_tolerance_are_not_called_small() {
        let labels = ["+ inertia", "+ clocks", "+ the other 6, no help"];
        let (which, but) = corrected(labels.into_iter(), &[]);
        assert_eq!(
            (which.as_str(), but.as_str()),
            ("small corrections within tolerance (inertia, clocks)", "")
        );
        let (which, but) = corrected(labels.into_iter(), &["wrong_inertia.x"]);
        assert_eq!(which, "corrections (inertia, clocks)");
        assert!(but.ends_with("evidence: wrong_inertia.x"), "{but}");
    }

    fn finding(id: &str, alike: usize, doubt: bool) -> Finding {
        let look = LookAlike {
            ids: vec!["com_offset".into(), "torque_scale".into()],
            title: String::new(),
            worse_by_nats: 1.0,
            manoeuvre: String::new(),
        };
        Finding {
            id: id.into(),
            kind: id.into(),
            title: String::new(),
            area: Area::Airframe,
            parameters: Vec::new(),
            set: Vec::new(),
            evidence_nats: 100.0,
            removed_share: 0.5,
            certain: alike == 0,
            second: crate::opinion::weather(),
            look_alikes: vec![look; alike],
            stands_for: Vec::new(),
            held_out: Some(HeldOut {
                channel: "force across the rotors".into(),
                unit: "N".into(),
                without: 0.395,
                with: 0.045,
                times_noise: Some([8.7, 1.2]),
                roll_outs: 0.8,
                written: !doubt,
                doubt: doubt.then(|| "it harms".to_string()),
                little: false,
            }),
            each_log: false,
        }
    }

    #[test]
    fn a_headline_is_short_and_begins_with_what_is_missing() {
        let of = |list: &[Finding], unexplained| headline("a sentence", list, unexplained);
        assert_eq!(of(&[finding("rotor_drag", 0, false)], false), "missing: rotor_drag");
        assert_eq!(
            of(&[finding("rotor_drag", 0, false), finding("payload", 3, false)], true),
            "missing: rotor_drag; payload (or 3 others); something unexplained is left"
        );
        assert_eq!(
            of(&[finding("rotor_drag", 0, false), finding("linear_drag", 0, true)], false),
            "missing: rotor_drag; in doubt: linear_drag"
        );
        assert_eq!(of(&[finding("linear_drag", 0, true)], false), "in doubt: linear_drag");
        // Doubted by the second estimator only.
        // What looks like another effect is missing only where one of them is for certain.
        let mut unsure = finding("thrust_curve", 1, false);
        unsure.second.said = Said::Answer;
        assert_eq!(of(std::slice::from_ref(&unsure), false), "in doubt: thrust_curve");
        unsure.second.said = Said::Agrees;
        assert_eq!(
            of(std::slice::from_ref(&unsure), false),
            "missing: thrust_curve (or com_offset + torque_scale)"
        );
        // What it looks like gives way to the name of another finding.
        let long = "an_effect_in_doubt_that_has_a_long_name";
        assert_eq!(
            of(&[unsure, finding(long, 0, true)], false),
            format!("missing: thrust_curve (or another); in doubt: {long}")
        );
        let doubted = Finding { certain: false, ..finding("wrong_mass", 0, false) };
        assert_eq!(of(std::slice::from_ref(&doubted), false), "in doubt: wrong_mass");
        assert_eq!(
            of(&[doubted, finding("rotor_drag", 0, false)], false),
            "missing: rotor_drag; in doubt: wrong_mass"
        );
        let many: Vec<Finding> =
            (0..12).map(|i| finding(&format!("an_effect_with_a_long_name.{i}"), i % 3, i > 8)).collect();
        for n in 1..=many.len() {
            let line = of(&many[..n], n % 2 == 0);
            assert!(line.chars().count() <= HEADLINE_CHARS, "{line}");
            assert!(line.starts_with("missing: "), "{line}");
        }
        let one_more: Vec<Finding> = ["a", "b", "c"]
            .map(|end| finding(&format!("an_effect_with_a_very_long_name_indeed.{end}"), 0, end == "c"))
            .into();
        let line = of(&one_more, true);
        assert!(line.contains("in doubt: 1 effect;"), "{line}");
        assert!(
            of(&many, false).contains("more") || of(&many, false).contains("effects"),
            "{}",
            of(&many, false)
        );
    }

    #[test]
    fn a_long_sentence_is_parted_where_it_pauses() {
        let short = "the model departs from the flight: 17.3 times what noise makes";
        assert_eq!(parted(short), (short, ""));
        let (head, rest) = parted("the model departs from 2 of 5 logs; worst on a.csv: after 1 s, and so on");
        assert_eq!(
            (head, rest),
            ("the model departs from 2 of 5 logs", "worst on a.csv: after 1 s, and so on")
        );
        let long = "the model departs from the log: after 1 s body rate is off by 1.47 rad/s, 137 times what the \
                    sensors' noise makes (threshold 2); a torque is missing";
        let (head, rest) = parted(long);
        assert_eq!(head, "the model departs from the log: after 1 s body rate is off by 1.47 rad/s");
        assert!(rest.starts_with("137 times") && rest.ends_with("missing"), "{rest}");
        let agrees = "the model agrees with the log: nothing is off by more than 1.3 times what the sensors' noise makes (threshold 2)";
        assert_eq!(parted(agrees).0, "the model agrees with the log");
    }

    #[test]
    fn without_findings_the_sentence_speaks_in_short() {
        let long =
            "unexplained: something is missing that is not in the list (nearest, but not enough: a, b, c)";
        assert_eq!(headline(long, &[], true), "unexplained: something is missing that is not in the list");
        let hidden =
            "nothing is missing that these logs could show; 12 effects of usual size could hide in them";
        assert_eq!(headline(hidden, &[], false), "nothing is missing that these logs could show");
        assert_eq!(headline("nothing is missing", &[], false), "nothing is missing");
    }

    #[test]
    fn after_a_change_the_verdict_is_said_as_far_as_there_is_room() {
        let one = "wrong_mass changed at 25.0 s";
        let nothing = "since then: nothing is missing that these logs could show";
        assert_eq!(since(1, one, nothing), format!("{one}; {nothing}"));
        let two = "quadratic_drag changed at 1.95 s; wrong_inertia.x changed at 3.23 s";
        assert_eq!(
            since(
                2,
                two,
                "since then: missing: rotor_drag; in doubt: a_long_name; something unexplained is left"
            ),
            "2 changes; since then: missing: rotor_drag"
        );
        assert_eq!(
            since(1, one, "since then: missing: payload"),
            format!("{one}; since then: missing: payload")
        );
        let long = "since then: nothing is missing that these logs could show".repeat(3);
        assert!(since(3, two, &long).chars().count() <= HEADLINE_CHARS);
    }

    #[test]
    fn evidence_below_what_is_required_says_that_it_was_there() {
        assert_eq!(nats(45.34), "45.3\u{a0}nats (6 are required)");
        assert_eq!(nats(5.678), "5.68\u{a0}nats (6 were required, before the last fit)");
    }

    #[test]
    fn what_a_finding_does_is_told_in_its_own_channel() {
        let words = before_after(&finding("rotor_drag", 0, false));
        assert_eq!(words.as_deref(), Some("force across the rotors 395 → 45.0 mN, 8.7 → 1.2 times noise"));
    }
}
