//! Why a verdict came out as it did: the rule that decided about each effect, and what the rule states.

use super::html::{Page, esc};
use super::text::Out;
use crate::decide::rules::Rule;
use crate::verdict::Diagnosis;
use std::fmt::Write as _;

/// Statements of the rules that decided something, in the order in which they are applied.
fn rules(d: &Diagnosis) -> Vec<String> {
    let used = Rule::ALL.into_iter().filter(|r| d.why.iter().any(|w| w.rule == *r));
    used.map(|r| format!("{}: {}. Set by {}", r.name(), r.statement(), r.set_by())).collect()
}

/// The rule that decided about each effect, and what the rules state, as text.
pub fn why(d: &Diagnosis) -> String {
    let mut out = Out::default();
    if d.why.is_empty() {
        return "\nWhy\n  no effect came near to being named\n".into();
    }
    let decided: Vec<String> =
        d.why.iter().map(|w| format!("{}: {} [{}]", w.id, w.text, w.rule.name())).collect();
    out.list("Why", &decided);
    out.list("The rules that decided", &rules(d));
    out.0
}

impl Page {
    pub(super) fn why(&mut self, d: &Diagnosis) {
        if d.why.is_empty() {
            return;
        }
        self.folded("why", "Why", "Why each effect is named or not", "");
        self.body.push_str(
            "<table class=\"stack\"><thead><tr><th>effect</th><th>decided</th><th>rule</th></tr></thead><tbody>",
        );
        for w in &d.why {
            let _ = writeln!(
                self.body,
                "<tr><td data-label=\"effect\"><code>{}</code></td><td data-label=\"decided\">{}</td>\
                 <td data-label=\"rule\">{}</td></tr>",
                esc(&w.id),
                esc(&w.text),
                esc(w.rule.name())
            );
        }
        self.body.push_str("</tbody></table>\n");
        self.list("ul", "ul", &rules(d));
    }
}
