//! Moments at which something changed, and the flight before and after them: for text and for pages.

use super::html::{Page, esc, put, sentence};
use super::text::Out;
use crate::drift::words::numbers;
use crate::moments::Moment;
use crate::verdict::{Diagnosis, Section};
use std::fmt::Write as _;

/// `at 17.28 s (17.09 to 17.48 s)`, and of which log where there are several.
fn when(m: &Moment, several: bool) -> String {
    if m.between_logs {
        return format!("between {} and the log before", m.log);
    }
    let of = if several { format!(" of {}", m.log) } else { String::new() };
    format!("at {:.2} s ({:.2} to {:.2} s){of}", m.at_s, m.interval_s[0], m.interval_s[1])
}

/// What changed, and what would explain the flight about as well.
fn what(m: &Moment) -> String {
    let or = match m.look_alikes.is_empty() {
        true => String::new(),
        false => format!("; or {}", m.look_alikes.join(", or ")),
    };
    format!("{}{or} ({:.0}\u{a0}nats)", m.title, m.evidence_nats)
}

fn several(d: &Diagnosis) -> bool {
    d.moments.iter().any(|m| m.between_logs || m.index != d.moments[0].index)
}

fn logs(s: &Section) -> String {
    if s.logs.is_empty() { "no part that is long enough".into() } else { s.logs.join(", ") }
}

impl Out {
    pub(super) fn moments(&mut self, d: &Diagnosis) {
        if d.moments.is_empty() {
            return;
        }
        self.heading("What changed in mid-flight (95 % intervals)");
        for m in &d.moments {
            self.hanging("  ", 4, &format!("{} {}: {}", m.id, when(m, several(d)), what(m)));
            for line in numbers(&m.parameters, false) {
                self.hanging("    ", 6, &line);
            }
        }
        if d.sections.is_empty() {
            return;
        }
        self.heading("Each part of the flight by itself");
        for s in &d.sections {
            self.hanging("  ", 4, &format!("{}: {}", logs(s), s.headline));
        }
        self.paragraph(
            2,
            "all that follows but the ladder is about the last part that was diagnosed, and what is written is the vehicle as it flies there",
        );
    }
}

impl Page {
    pub(super) fn moments(&mut self, d: &Diagnosis) {
        if d.moments.is_empty() {
            return;
        }
        let lead = match d.sections.is_empty() {
            true => {
                "The flight is fitted as one all the same: what is found is in doubt. Intervals are 95 %."
            }
            false => {
                "The flight before and after is fitted apart. All else on this page but the ladder is about the last part that was diagnosed, and what is \
                 written is the vehicle as it flies there. Intervals are 95 %."
            }
        };
        self.section("moments", "What changed", "What changed in mid-flight", lead);
        self.body.push_str(
            "<table class=\"stack\"><thead><tr><th>effect</th><th>when</th><th>what</th><th>before → after</th></tr></thead><tbody>",
        );
        for m in &d.moments {
            put!(
                self,
                "<tr><td data-label=\"effect\"><code>{}</code></td><td data-label=\"when\">{}</td><td data-label=\"what\">{}</td>\
                 <td data-label=\"before → after\">{}</td></tr>\n",
                esc(&m.id),
                esc(&when(m, several(d))),
                esc(&what(m)),
                numbers(&m.parameters, false).iter().map(|n| esc(n)).collect::<Vec<_>>().join("<br>")
            );
        }
        self.body.push_str("</tbody></table>\n");
        if d.sections.is_empty() {
            return;
        }
        self.body.push_str(
            "<table class=\"stack\"><thead><tr><th>part</th><th>verdict on it alone</th></tr></thead><tbody>",
        );
        for s in &d.sections {
            put!(
                self,
                "<tr><td data-label=\"part\">{}</td><td data-label=\"verdict on it alone\">{}</td></tr>\n",
                esc(&logs(s)),
                esc(&sentence(&s.headline))
            );
        }
        self.body.push_str("</tbody></table>\n");
    }
}
