//! Page sections of comparisons: where the model fails, roll-outs by horizon, residual statistics, whole flights.

use super::comparison::same_log;
use super::html::{Page, esc, put};
use super::quantity::{percent, quantity, significant};
use super::text::LADDER_CHANNELS;
use crate::compare::{Axes, Comparison, LogComparison};
use std::fmt::Write as _;

/// A number and, if available, its value afterwards.
fn then(before: String, after: Option<String>) -> String {
    after.map_or(before.clone(), |after| format!("{before} → {after}"))
}

impl Page {
    /// The sections of a comparison; `after` is the one with the findings.
    pub(super) fn comparison(&mut self, before: &Comparison, after: Option<&Comparison>) {
        let lead =
            if after.is_some() { "Your model, and after what was found is added." } else { "Your model." };
        self.folded("compared", "Model and flight", "Model against flight", lead);
        for c in [Some(before), after].into_iter().flatten() {
            put!(self, "<p>{}</p>\n", esc(&super::html::sentence(&c.verdict)));
        }
        for log in &before.logs {
            let new = same_log(log, after);
            put!(self, "<h3>{}</h3>\n", esc(&log.log.name));
            if !log.findings.is_empty() {
                self.list("ul", "ul", &log.findings);
            }
            self.roll_outs(log, new);
            self.one_step(log, new);
            match (&log.closed_loop, &log.closed_loop_missing) {
                (Some(flight), _) => {
                    let then_m = |of: fn(&crate::compare::ClosedLoop) -> f64| {
                        let new = new.and_then(|n| n.closed_loop.as_ref()).map(|n| quantity(of(n), "m", 3));
                        then(quantity(of(flight), "m", 3), new)
                    };
                    put!(
                        self,
                        "<p>Flown by its own controller along the logged references for {}: {} away from the measured flight. \
                         The measured flight was {} away from the references, the simulated one {}.</p>\n",
                        quantity(flight.duration_s, "s", 3),
                        then_m(|c| c.position_m),
                        quantity(flight.tracking_measured_m, "m", 3),
                        then_m(|c| c.tracking_model_m)
                    );
                    for note in &flight.notes {
                        put!(self, "<p class=\"small\">{}</p>\n", esc(note));
                    }
                }
                (None, Some(why)) => put!(self, "<p class=\"small\">No whole flight: {}</p>\n", esc(why)),
                (None, None) => {}
            }
        }
    }

    fn roll_outs(&mut self, log: &LogComparison, new: Option<&LogComparison>) {
        if log.horizons.is_empty() {
            return;
        }
        self.body.push_str(
            "<div class=\"scroll\" tabindex=\"0\" role=\"group\" aria-label=\"table\"><table><thead><tr><th>error of roll-outs, RMS (multiples of what noise makes)</th>",
        );
        for h in &log.horizons {
            put!(self, "<th class=\"n\">{}</th>", quantity(h.error.horizon_s, "s", 2));
        }
        self.body.push_str("</tr></thead><tbody>");
        // Attitude and body rate are no results where they are inputs.
        let fed_in = |k: usize| log.horizons.iter().all(|h| h.times_expected[k].is_none());
        for (k, (name, unit, error)) in LADDER_CHANNELS.iter().enumerate().filter(|(k, _)| !fed_in(*k)) {
            put!(self, "<tr><td>{name}</td>");
            for h in &log.horizons {
                let cell = |h: &crate::compare::Horizon| {
                    let times = h.times_expected[k].map(|t| format!(" ({} ×)", significant(t, 2)));
                    format!("{}{}", quantity(error(&h.error), unit, 3), times.unwrap_or_default())
                };
                let same = new.and_then(|n| {
                    n.horizons.iter().find(|n| (n.error.horizon_s - h.error.horizon_s).abs() < 1e-9)
                });
                put!(self, "<td class=\"n\">{}</td>", then(cell(h), same.map(cell)).replace(" → ", "<br>→ "));
            }
            self.body.push_str("</tr>");
        }
        self.body.push_str("</tbody></table></div>\n");
    }

    fn one_step(&mut self, log: &LogComparison, new: Option<&LogComparison>) {
        self.body.push_str(
            "<div class=\"scroll\" tabindex=\"0\" role=\"group\" aria-label=\"table\"><table><thead><tr><th>residual at every instant</th><th class=\"n\">RMS</th>\
             <th class=\"n\">multiples of noise</th><th class=\"n\">mean</th><th class=\"n\">explained</th></tr></thead><tbody>",
        );
        let mut rows = |name: &str, unit: &str, old: &Axes, new: Option<&Axes>| {
            for (k, axis) in ["x", "y", "z"].iter().enumerate() {
                let row = |show: &dyn Fn(&Axes) -> String| then(show(old), new.map(show));
                put!(
                    self,
                    "<tr><td>{name} {axis}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td></tr>",
                    row(&|a| quantity(a.rms[k], unit, 3)),
                    row(&|a| significant(a.in_sigmas[k], 2)),
                    row(&|a| quantity(a.mean[k], unit, 2)),
                    row(&|a| a.explained[k].map_or("–".into(), percent))
                );
            }
        };
        rows("force along body", "N", &log.one_step.force, new.map(|n| &n.one_step.force));
        if let Some(torque) = &log.one_step.torque {
            rows("torque about body", "N·m", torque, new.and_then(|n| n.one_step.torque.as_ref()));
        }
        self.body.push_str("</tbody></table></div>\n");
        put!(self, "<p class=\"small\">{}</p>\n", esc(&log.one_step.certainty));
    }
}
