//! The report page: one HTML file with embedded style, script and charts.

use super::comparison;
use super::page_data::{self, Chart, MOST_POINTS};
use super::page_live;
use super::quantity::{Scale, interval, percent, quantity, significant};
use super::rungs::measures;
use super::text::{
    area, at, bounds, compared, horizons, ladder_channels, ladder_scale, noise, sorted_singles, stands_for,
};
use super::{Against, Overlay, Report, ResidualSeries};
use crate::headline::{evidence, nats, pair, parted};
use crate::live::Live;
use crate::verdict::{Calibration, Diagnosis, Finding, HorizonError, Limit, OfOneLog, ParameterFit, Rung};
pub(super) use propwash_page::escape as esc;
use propwash_page::{Page as Skeleton, Part};
use std::fmt::Write as _;

const STYLE: &str = include_str!("../../../../assets/page/report.css");
const SCRIPT: &str = include_str!("../../../../assets/page/report.js");
const LIVE: &str = include_str!("../../../../assets/page/live.js");

/// The page of a report.
pub(super) fn page(report: &Report) -> String {
    let mut page = Page::default();
    page.header(report);
    let (mut residuals, mut causes, mut more_causes) = (Vec::new(), Vec::new(), 0);
    if let Some(live) = report.live.as_ref().filter(|l| !l.flights.is_empty()) {
        page.living(live, report);
    } else if let Some(before) = &report.comparison_before {
        let after = report.comparison_after.as_ref();
        residuals = comparison::residuals(before, after);
        (causes, more_causes) = comparison::causes(before, after);
    }
    if let Some(d) = &report.diagnosis {
        page.moments(d);
        page.findings(d);
        page.ladder(&d.ladder);
    }
    residuals.extend(report.residuals.iter().cloned());
    causes.extend(report.causes.iter().cloned());
    page.residuals(&residuals);
    page.causes(&causes, more_causes);
    page.overlays(&report.overlays);
    if let Some(before) = &report.comparison_before {
        page.comparison(before, report.comparison_after.as_ref());
    }
    if let Some(d) = &report.diagnosis {
        page.parameters(d);
        page.look_alikes(d);
        page.remainder(d);
        page.advice(d);
        page.singles(d);
        page.why(d);
    }
    page.logs(report);
    page.how_to_read(report, !residuals.is_empty(), !causes.is_empty());
    page.finish(report)
}

#[derive(Default)]
pub(super) struct Page {
    pub(super) body: String,
    contents: Vec<(&'static str, &'static str)>,
    charts: Vec<Chart>,
    /// Whether a folded section is open in the text.
    folded: bool,
}

/// Appends formatted HTML.
macro_rules! put {
    ($page:expr, $($arg:tt)*) => {{
        let _ = write!($page.body, $($arg)*);
    }};
}
pub(super) use put;

impl Page {
    pub(super) fn section(&mut self, id: &'static str, short: &'static str, title: &str, lead: &str) {
        self.unfold();
        self.contents.push((id, short));
        put!(self, "<h2 id=\"{id}\">{}</h2>\n", esc(title));
        if !lead.is_empty() {
            put!(self, "<p class=\"lead\">{}</p>\n", esc(lead));
        }
    }

    /// A section that is folded at first.
    pub(super) fn folded(&mut self, id: &'static str, short: &'static str, title: &str, lead: &str) {
        self.unfold();
        self.contents.push((id, short));
        put!(self, "<details class=\"fold\"><summary><h2 id=\"{id}\">{}</h2></summary>\n", esc(title));
        if !lead.is_empty() {
            put!(self, "<p class=\"lead\">{}</p>\n", esc(lead));
        }
        self.folded = true;
    }

    /// Ends a folded section.
    fn unfold(&mut self) {
        if std::mem::take(&mut self.folded) {
            self.body.push_str("</details>\n");
        }
    }

    /// The living part: the script fills it from the data.
    fn living(&mut self, live: &Live, report: &Report) {
        let lead = if live.effects.is_empty() {
            "Force and torque that the model lacks, along the flight."
        } else {
            "Turn an effect on, or move its slider: figures, curves, dots and the colours of the flight follow."
        };
        self.section("flight", "Flight and effects", "Flight and effects", lead);
        self.body.push_str(
            "<div id=\"lab\"><noscript><p class=\"note\">This part needs JavaScript, which this browser does not run.</p></noscript></div>\n",
        );
        if report.diagnosis.as_ref().is_some_and(|d| !d.ladder.is_empty()) {
            self.body.push_str(
                "<p class=\"small\">These are residuals at the instants. Errors of roll-outs do not follow the sliders; \
                 <a href=\"#ladder\">the error ladder</a> has them with each step and without.</p>\n",
            );
        }
        self.section(
            "residuals",
            "Residual over time",
            "What the model lacks, over time",
            "Measured minus simulated, means over 50 ms. Drag over a stretch: figures, plots and dots then show that stretch alone.",
        );
        let mut legend = match live.effects.is_empty() {
            true => vec![("found", "", "your model")],
            false => {
                vec![("filed", "", "your model (before)"), ("found", "", "now, with the effects that are on")]
            }
        };
        legend.extend([("mark", "block", "worst stretches"), ("soft", "block", "95 % of noise")]);
        self.legend(&legend);
        self.body.push_str("<div id=\"lab-time\"></div>\n");
        self.stretches(report);
        self.section(
            "causes",
            "Residual and cause",
            "What the error depends on",
            "Each dot is 50 ms of flight. A model that lacks nothing lies on the line of zero.",
        );
        if !live.effects.is_empty() {
            self.legend(&[("filed", "block", "your model (before)"), ("found", "block", "now")]);
        }
        self.body.push_str("<div id=\"lab-causes\"></div>\n");
    }

    /// The worst stretches of the flights, each with a button that goes there.
    fn stretches(&mut self, report: &Report) {
        let (before, after) = (report.comparison_before.as_ref(), report.comparison_after.as_ref());
        let Some(before) = before else { return };
        let all = comparison::residuals(before, after);
        for of_log in all.chunk_by(|a, b| a.log == b.log) {
            if before.logs.len() > 1 {
                put!(self, "<h3>{}</h3>\n", esc(&of_log[0].log));
            }
            self.worst(&of_log[0], before.logs.len() == 1);
        }
    }

    fn header(&mut self, report: &Report) {
        put!(
            self,
            "<header>\n<div class=\"top\"><h1>{}</h1><span class=\"tools\"></span></div>\n",
            esc(&report.title)
        );
        if let Some(d) = &report.diagnosis {
            put!(self, "<p class=\"verdict\">{}</p>\n", esc(&sentence(&d.headline)));
            put!(self, "<p class=\"lead\">{}</p>\n", esc(&sentence(&evidence(d))));
            let fact = |name: &str, value: String| format!("<span>{name} <b>{}</b></span>", esc(&value));
            let fit = d.logs.iter().filter(|l| !l.held_out).count();
            let seconds: f64 = d.logs.iter().map(|l| l.duration_s).sum();
            put!(
                self,
                "<p class=\"facts\">{}{}{}{}</p>\n",
                fact("vehicle", d.vehicle.clone()),
                fact("file", d.vehicle_sha256.chars().take(12).collect()),
                fact("logs", format!("{fit} to fit, {} to check", d.logs.len() - fit)),
                fact("flight", format!("{} s", significant(seconds, 3)))
            );
        }
        if let (None, Some(c)) = (&report.diagnosis, &report.comparison_before) {
            let (head, rest) = parted(&c.verdict);
            put!(self, "<p class=\"verdict\">{}</p>\n", esc(&sentence(head)));
            if !rest.is_empty() {
                put!(self, "<p class=\"lead\">{}</p>\n", esc(&sentence(rest)));
            }
        }
        self.body.push_str("</header>\n");
    }

    fn findings(&mut self, d: &Diagnosis) {
        if d.findings.is_empty() {
            return;
        }
        self.section(
            "missing",
            "What is missing",
            "What is missing",
            &format!("Most important first. Each is judged in the channel on which it acts, on {}; intervals are 95 %.", d.judged_on()),
        );
        self.body.push_str("<div class=\"cards\">\n");
        for f in &d.findings {
            let (class, word) = match (f.doubt(), f.certain) {
                (Some(_), _) => ("doubt", "in doubt, not written"),
                (None, true) if f.unwritten().is_some() => ("sure", "certain, not written"),
                (None, true) => ("sure", "certain"),
                (None, false) if f.one_of_several() => ("doubt", "one of several"),
                (None, false) => ("doubt", "not certain"),
            };
            put!(
                self,
                "<section class=\"card\"><h3><code>{}</code> <span class=\"tag {class}\">{word}</span></h3>\
                 <p class=\"small\">{} · {}</p>",
                esc(&f.id),
                esc(&f.title),
                area(f.area)
            );
            self.before_after(f);
            let of = if f.each_log { " in one of the logs" } else { "" };
            put!(self, "<dt>evidence</dt><dd>{}{of}</dd>", nats(f.evidence_nats));
            for p in &f.parameters {
                put!(self, "<dt>{}</dt><dd>{}</dd>", esc(&p.name), esc(&interval(p.value, p.sigma, &p.unit)));
            }
            self.body.push_str("</dl>");
            put!(self, "<p class=\"small\">second estimator: {}</p>", esc(&f.second.text));
            if let Some(reason) = f.unwritten() {
                put!(self, "<p class=\"small\">{}</p>", esc(&sentence(reason)));
            }
            for l in &f.look_alikes {
                put!(
                    self,
                    "<p class=\"small\">or <code>{}</code>: {}, {}</p>",
                    esc(&l.ids.join(" + ")),
                    esc(&l.title),
                    esc(&compared(l))
                );
            }
            if let Some(words) = stands_for(f) {
                put!(self, "<p class=\"small\">or {}</p>", esc(&words));
            }
            self.body.push_str("</section>\n");
        }
        self.body.push_str("</div>\n");
    }

    /// The change by a finding in its own channel: a bar, the numbers, and the beginning of a list.
    fn before_after(&mut self, f: &Finding) {
        let Some(h) = &f.held_out else {
            put!(
                self,
                "<dl><dt>excess error {}</dt><dd>{}</dd>",
                if f.removed_share < 0.0 { "added" } else { "removed" },
                percent(f.removed_share.abs())
            );
            return;
        };
        let worse = h.with > h.without;
        let share =
            if h.without.max(h.with) > 0.0 { h.with.min(h.without) / h.with.max(h.without) } else { 1.0 };
        put!(
            self,
            "<div class=\"meter\"><i{} style=\"width:{:.1}%\"></i></div><dl><dt>{}</dt><dd>{}</dd>",
            if worse { " class=\"worse\"" } else { "" },
            100.0 * (1.0 - share).clamp(0.0, 1.0),
            esc(&h.channel),
            esc(&pair(h.without, h.with, &h.unit))
        );
        if let Some([a, b]) = h.times_noise {
            put!(self, "<dt>times noise</dt><dd>{} → {}</dd>", significant(a, 2), significant(b, 2));
        }
        put!(self, "<dt>roll-outs</dt><dd>{} of the error without it</dd>", percent(h.roll_outs));
    }

    fn figure(&mut self, chart: Chart, caption: &str, aside: &str) {
        put!(
            self,
            "<figure><figcaption>{} <span>{}</span></figcaption><div class=\"plot\" id=\"{}\" role=\"img\" aria-label=\"{}\"></div></figure>\n",
            esc(caption),
            esc(aside),
            esc(&chart.id),
            esc(&chart.title)
        );
        self.charts.push(chart);
    }

    fn legend(&mut self, entries: &[(&str, &str, &str)]) {
        self.body.push_str("<ul class=\"legend\">");
        for (role, class, words) in entries {
            put!(self, "<li><i class=\"{class}\" style=\"--role:var(--{role})\"></i>{}</li>", esc(words));
        }
        self.body.push_str("</ul>\n");
    }

    fn ladder(&mut self, rungs: &[Rung]) {
        let horizons = horizons(rungs);
        if horizons.is_empty() {
            return;
        }
        let unseen = rungs.iter().any(|r| !r.held_out.is_empty());
        let (on, marks) = match unseen {
            true => ("on flight that the fit has not seen", " Upright marks: flight used for the fit."),
            false => ("on flight used for the fit", ""),
        };
        self.section(
            "ladder",
            "Error ladder",
            "Error ladder",
            &format!("Root mean squares {on}: force and torque that the model lacks at the instants, then errors at the end of roll-outs from measured states.{marks}"),
        );
        self.body.push_str("<div class=\"rungs\">\n");
        for measure in measures(rungs) {
            put!(self, "<figure><figcaption>{}</figcaption>\n", esc(&measure.name));
            for (k, rung) in rungs.iter().enumerate() {
                let length = |v: Option<f64>| v.map_or(0.0, |v| 100.0 * measure.length(v));
                // The bar shows held-out flight if there is any; the fit's own flight is then only a mark.
                let [unseen, seen] = measure.values[k];
                let mark = match (unseen, seen) {
                    (Some(_), Some(_)) => format!("<b style=\"left:{:.1}%\"></b>", length(seen)),
                    _ => String::new(),
                };
                put!(
                    self,
                    "<div class=\"rung\"><span>{}</span><div><i{} style=\"width:{:.1}%\"></i>{mark}</div><span>{}</span><span>{}</span></div>\n",
                    esc(&rung.label),
                    if k == 0 { " class=\"first\"" } else { "" },
                    length(measure.drawn(k)),
                    esc(&measure.words(k)),
                    esc(&measure.share(k))
                );
            }
            self.body.push_str("</figure>\n");
        }
        self.body.push_str("</div>\n<details><summary>The same in numbers</summary>\n");
        for (name, unit, error) in ladder_channels(rungs).iter().copied() {
            put!(
                self,
                "<div class=\"scroll\" tabindex=\"0\" role=\"group\" aria-label=\"table\"><table><thead><tr><th>{name}: unseen flight (flight used for the fit)</th>"
            );
            let scales: Vec<Scale> = horizons.iter().map(|h| ladder_scale(rungs, *h, unit, error)).collect();
            for (h, scale) in horizons.iter().zip(&scales) {
                put!(self, "<th class=\"n\">{}, {}</th>", quantity(*h, "s", 2), esc(&scale.unit));
            }
            self.body.push_str("</tr></thead><tbody>");
            for rung in rungs {
                put!(self, "<tr><td>{}</td>", esc(&rung.label));
                for (h, scale) in horizons.iter().zip(&scales) {
                    let cell = |e: Option<&HorizonError>| {
                        e.map_or("–".into(), |e| significant(error(e) * scale.factor, 3))
                    };
                    let (unseen, seen) = (cell(at(&rung.held_out, *h)), cell(at(&rung.training, *h)));
                    put!(self, "<td class=\"n\">{unseen} ({seen})</td>");
                }
                self.body.push_str("</tr>");
            }
            self.body.push_str("</tbody></table></div>\n");
        }
        self.body.push_str("</details>\n");
    }

    fn overlays(&mut self, overlays: &[Overlay]) {
        if overlays.is_empty() {
            return;
        }
        self.folded(
            "overlays",
            "Measured and simulated",
            "Measured and simulated",
            "Drag over a stretch to look closer; double-click to go back.",
        );
        let found = overlays.iter().any(|o| !o.with_effects.is_empty());
        let legend = [("ink", "", "measured"), ("filed", "", "your model"), ("found", "", "after")];
        self.legend(&legend[..if found { 3 } else { 2 }]);
        let charts = overlays.iter().enumerate().map(|(k, o)| {
            let chart = page_data::overlay(k, o);
            let unit = chart.y_title.clone();
            (chart, o.log.as_str(), o.channel.clone(), unit)
        });
        self.by_log(charts.collect(), "plots");
    }

    /// Figures grouped by log, where there are several logs.
    fn by_log(&mut self, figures: Vec<(Chart, &str, String, String)>, class: &str) {
        let several = figures.windows(2).any(|w| w[0].1 != w[1].1);
        let mut thinned = false;
        let mut current = None;
        for (chart, log, caption, aside) in figures {
            thinned |= chart.thinned;
            if current != Some(log) {
                if current.is_some() {
                    self.body.push_str("</div>\n");
                }
                if several {
                    put!(self, "<h3>{}</h3>\n", esc(log));
                }
                put!(self, "<div class=\"{class}\">\n");
                current = Some(log);
            }
            self.figure(chart, &caption, &aside);
        }
        if current.is_some() {
            self.body.push_str("</div>\n");
        }
        if thinned {
            put!(
                self,
                "<p class=\"small\">Lines of more than {MOST_POINTS} points are drawn by the smallest and the largest value of each stretch.</p>\n"
            );
        }
    }

    fn residuals(&mut self, residuals: &[ResidualSeries]) {
        if residuals.is_empty() {
            return;
        }
        self.section(
            "residuals",
            "Residual over time",
            "Residual over time",
            "Measured minus simulated. The numbered stretches are those in which your model fails most.",
        );
        let found = residuals.iter().any(|r| !r.after.is_empty());
        let mut legend = vec![("filed", "", "your model")];
        if found {
            legend.push(("found", "", "after"));
        }
        legend.push(("mark", "block", "worst stretches"));
        if residuals.iter().any(|r| r.sigma.is_some()) {
            legend.push(("soft", "block", "95 % of noise"));
        }
        self.legend(&legend);
        let mut next = 0;
        // Series with the same worst segments share their table.
        for alike in residuals.chunk_by(|a, b| a.log == b.log && a.worst == b.worst) {
            let figures = alike.iter().enumerate().map(|(k, r)| {
                let chart = page_data::residual(next + k, r);
                let aside = format!("{} · {}", chart.y_title, r.log);
                (chart, r.log.as_str(), r.name.clone(), aside)
            });
            self.by_log(figures.collect(), if alike.len() == 1 { "plots one" } else { "plots" });
            next += alike.len();
            self.worst(&alike[0], false);
        }
    }

    /// A table of the worst stretches; with `jump` each has a button that goes there.
    fn worst(&mut self, r: &ResidualSeries, jump: bool) {
        if r.worst.is_empty() {
            return;
        }
        self.body.push_str(
            "<table class=\"stack\"><thead><tr><th>stretch</th><th class=\"n\">time, s</th><th class=\"n\">your model</th>\
             <th class=\"n\">after</th><th>there</th></tr></thead><tbody>",
        );
        for (i, w) in r.worst.iter().enumerate() {
            let after = w.rms_after.map_or("–".into(), |v| quantity(v, &r.unit, 3));
            let number = match jump {
                true => format!(
                    "<button type=\"button\" class=\"jump\" data-at=\"{:.2}\" aria-label=\"play stretch {1}\">{1} ▶</button>",
                    w.from_s,
                    i + 1
                ),
                false => (i + 1).to_string(),
            };
            put!(
                self,
                "<tr><td data-label=\"stretch\">{number}</td><td class=\"n\" data-label=\"time, s\">{:.2} – {:.2}</td><td class=\"n\" data-label=\"your model\">{}</td><td class=\"n\" data-label=\"after\">{}</td><td data-label=\"there\">{}</td></tr>",
                w.from_s,
                w.to_s,
                esc(&quantity(w.rms_before, &r.unit, 3)),
                esc(&after),
                esc(&w.what)
            );
        }
        self.body.push_str("</tbody></table>\n");
    }

    fn causes(&mut self, causes: &[Against], more: usize) {
        if causes.is_empty() {
            return;
        }
        self.section(
            "causes",
            "Residual and cause",
            "Residual against its cause",
            "Means in bins of the cause; bars are 95 % intervals of the mean. A model that lacks nothing lies on zero.",
        );
        let found = causes.iter().any(|c| !c.after.is_empty());
        let legend = [("filed", "", "your model"), ("found", "", "after")];
        self.legend(&legend[..if found { 2 } else { 1 }]);
        self.body.push_str("<div class=\"plots\">\n");
        for (k, c) in causes.iter().enumerate() {
            let chart = page_data::against(k, c);
            let aside = format!("{} · against {}", chart.y_title, c.cause);
            self.figure(chart, &c.residual, &aside);
        }
        self.body.push_str("</div>\n");
        if more > 0 {
            put!(
                self,
                "<p class=\"small\">The strongest are drawn; {more} more stand in the JSON output.</p>\n"
            );
        }
    }

    fn parameters(&mut self, d: &Diagnosis) {
        let found: Vec<(&str, &ParameterFit)> =
            d.findings.iter().flat_map(|f| f.parameters.iter().map(|p| (f.id.as_str(), p))).collect();
        let known = |c: &&Calibration| {
            d.calibration.iter().any(|k| k.id == c.id && k.parameter.name == c.parameter.name)
        };
        let others: Vec<&Calibration> = d.adjusted.iter().filter(|c| !known(c)).collect();
        let (far, calibration): (Vec<&Calibration>, Vec<&Calibration>) =
            d.calibration.iter().partition(|c| c.far());
        if found.is_empty() && d.calibration.is_empty() && others.is_empty() {
            return;
        }
        self.section(
            "parameters",
            "Parameters",
            "Parameters",
            "Estimates with 95 % intervals. In the drawings the upright line is the value of your model, the bar the interval; each has its own scale.",
        );
        if !found.is_empty() {
            self.parameter_table(found.into_iter());
        }
        let rows = |list: &[&'_ Calibration]| -> Vec<(String, ParameterFit)> {
            list.iter().map(|c| (c.id.clone(), c.parameter.clone())).collect()
        };
        for (list, title, words) in [
            (
                &calibration,
                "Small corrections (within manufacturing tolerance)",
                "More than two standard deviations from the vehicle file, less than a missing effect.",
            ),
            (
                &far,
                "Outside tolerance, but not enough evidence for a finding",
                "More than three tolerances from the vehicle file: look at these numbers, or fly more.",
            ),
        ] {
            if !list.is_empty() {
                put!(self, "<h3>{title}</h3><p class=\"small\">{words}</p>\n");
                self.parameter_table(rows(list).iter().map(|(id, p)| (id.as_str(), p)));
            }
        }
        if !others.is_empty() {
            put!(
                self,
                "<details><summary>The other {} tolerance parameters at their estimates</summary>\n",
                others.len()
            );
            self.parameter_table(rows(&others).iter().map(|(id, p)| (id.as_str(), p)));
            self.body.push_str("</details>\n");
        }
    }

    fn parameter_table<'a>(&mut self, rows: impl Iterator<Item = (&'a str, &'a ParameterFit)>) {
        self.body.push_str(
            "<table class=\"stack\"><thead><tr><th>effect</th><th>parameter</th><th class=\"n\">your model</th>\
             <th class=\"n\">estimate</th><th style=\"width:34%\">interval</th></tr></thead><tbody>\n",
        );
        for (id, p) in rows {
            put!(
                self,
                "<tr><td data-label=\"effect\"><code>{}</code></td><td data-label=\"parameter\"><code>{}</code></td>\
                 <td class=\"n\" data-label=\"your model\">{}</td><td class=\"n\" data-label=\"estimate\">{}</td>\
                 <td class=\"wide\">{}</td></tr>\n",
                esc(id),
                esc(&p.name),
                esc(&quantity(p.filed, &p.unit, 4)),
                esc(&interval(p.value, p.sigma, &p.unit)),
                interval_drawing(p)
            );
        }
        self.body.push_str("</tbody></table>\n");
    }

    fn look_alikes(&mut self, d: &Diagnosis) {
        if d.findings.is_empty() {
            return;
        }
        let doubtful: Vec<&Finding> = d.findings.iter().filter(|f| !f.look_alikes.is_empty()).collect();
        self.section(
            "alike",
            "What looks alike",
            "What the log cannot tell apart",
            if doubtful.is_empty() {
                "No other effect explains these logs about as well as those that were found."
            } else {
                "These explain the logs almost as well. Less than about 6 nats between two of them decides nothing; the manoeuvre would."
            },
        );
        for f in doubtful {
            put!(
                self,
                "<div class=\"group\"><b><code>{}</code></b> {} – or one of<ul>",
                esc(&f.id),
                esc(&f.title)
            );
            for l in &f.look_alikes {
                put!(
                    self,
                    "<li><code>{}</code> {} <span class=\"small\">It {}.</span> To tell them apart: {}</li>",
                    esc(&l.ids.join(" + ")),
                    esc(&l.title),
                    esc(&compared(l)),
                    esc(&l.manoeuvre)
                );
            }
            self.body.push_str("</ul></div>\n");
        }
    }

    fn remainder(&mut self, d: &Diagnosis) {
        let r = &d.remainder;
        self.section("rest", "What remains", "What remains", "");
        if let Some(network) = &d.network {
            put!(self, "<p>{}</p>\n", esc(&sentence(&network.text)));
        }
        if r.unexplained {
            self.body.push_str(
                "<p class=\"note\">More is left than a well-known vehicle leaves: something is missing that is not in the list of effects.</p>\n",
            );
        }
        if !r.text.is_empty() {
            put!(self, "<p>{}</p>\n", esc(&r.text));
        }
        self.body.push_str(
            "<div class=\"scroll\" tabindex=\"0\" role=\"group\" aria-label=\"table\"><table><thead><tr><th>unexplained, standard deviation</th><th class=\"n\">your model</th>\
             <th class=\"n\">after</th></tr></thead><tbody>",
        );
        for (name, unit, before, after) in [
            ("force over mass", "m/s²", r.force_before_m_s2, r.force_m_s2),
            ("torque over inertia", "rad/s²", r.torque_before_rad_s2, r.torque_rad_s2),
        ] {
            // Torques are unknown where the attitude is an input.
            if before == 0.0 && after == 0.0 {
                continue;
            }
            put!(
                self,
                "<tr><td>{name}</td><td class=\"n\">{}</td><td class=\"n\">{}</td></tr>",
                quantity(before, unit, 3),
                quantity(after, unit, 3)
            );
        }
        self.body.push_str("</tbody></table></div>\n");
        if r.terms.is_empty() {
            self.body.push_str(
                "<p class=\"small\">No free-form term describes it on flight that it has not seen.</p>\n",
            );
            return;
        }
        self.body.push_str(
            "<h3>What it looks like</h3><p class=\"small\">Free-form terms, fitted to what is left: accelerations per SI unit of the variable.</p>\
             <table class=\"stack\"><thead><tr><th>on</th><th>variable</th><th class=\"n\">coefficient</th>\
             <th class=\"n\">explains, unseen</th></tr></thead><tbody>",
        );
        for t in &r.terms {
            put!(
                self,
                "<tr><td data-label=\"on\">{}</td><td data-label=\"variable\"><code>{}</code></td>\
                 <td class=\"n\" data-label=\"coefficient\">{}</td><td class=\"n\" data-label=\"explains\">{}</td></tr>",
                esc(&t.on),
                esc(&t.variable),
                esc(&interval(t.coefficient, t.sigma, "1")),
                percent(t.explained_share)
            );
        }
        self.body.push_str("</tbody></table>\n");
    }

    fn advice(&mut self, d: &Diagnosis) {
        if !d.advice.is_empty() {
            self.section("next", "Next flight", "Advice for the next flight", "");
            let texts: Vec<String> = d.advice.iter().map(|a| a.text.clone()).collect();
            self.list("ol class=\"steps\"", "ol", &texts);
        }
    }

    pub(super) fn list(&mut self, open: &str, close: &str, entries: &[String]) {
        put!(self, "<{open}>");
        for entry in entries {
            put!(self, "<li>{}</li>", esc(entry));
        }
        put!(self, "</{close}>\n");
    }

    fn singles(&mut self, d: &Diagnosis) {
        if d.singles.is_empty() && d.not_tried.is_empty() {
            return;
        }
        self.folded(
            "tried",
            "What was tried",
            "Each candidate alone",
            "Evidence for one effect alone against none. Effects that look alike share it, so several can stand high where one is missing.",
        );
        let sorted = sorted_singles(&d.singles);
        let most = sorted.iter().map(|s| s.1).filter(|v| v.is_finite()).fold(0.0, f64::max);
        let bar = |(id, nats): &(String, f64)| {
            let share = if most > 0.0 { (nats / most).clamp(0.0, 1.0) } else { 0.0 };
            let class = if *nats > 0.0 { "" } else { " class=\"against\"" };
            format!(
                "<div class=\"bar\"><code>{}</code><div><i{class} style=\"width:{:.1}%\"></i></div><span>{}</span></div>\n",
                esc(id),
                100.0 * share,
                significant(*nats, 3)
            )
        };
        let (shown, hidden) = sorted.split_at(sorted.len().min(12));
        shown.iter().for_each(|s| self.body.push_str(&bar(s)));
        if !hidden.is_empty() {
            put!(self, "<details><summary>{} more</summary>\n", hidden.len());
            hidden.iter().for_each(|s| self.body.push_str(&bar(s)));
            self.body.push_str("</details>\n");
        }
        let hidden: Vec<&Limit> = d.limits.iter().filter(|l| !l.visible).collect();
        if !hidden.is_empty() {
            self.body.push_str(
                "<h3>What could hide in these logs</h3><p>Effects that 95 of 100 such flights would show only from these sizes on.</p>\
                 <table class=\"stack\"><thead><tr><th>candidate</th><th>parameter</th><th class=\"n\">shows from</th>\
                 <th class=\"n\">times its usual size</th></tr></thead><tbody>",
            );
            for l in hidden {
                let size = l.size.map_or_else(|| "never".to_string(), |v| quantity(v, &l.unit, 2));
                put!(
                    self,
                    "<tr><td data-label=\"candidate\"><code>{}</code></td><td data-label=\"parameter\"><code>{}</code></td>\
                     <td class=\"n\" data-label=\"shows from\">{}</td><td class=\"n\" data-label=\"times its usual size\">{}</td></tr>",
                    esc(&l.id),
                    esc(&l.parameter),
                    esc(&size),
                    l.share.map_or_else(|| "–".to_string(), |v| significant(v, 2))
                );
            }
            self.body.push_str("</tbody></table>\n");
        }
        if !d.not_tried.is_empty() {
            self.body.push_str("<h3>Not tried</h3><ul>");
            for (id, why) in &d.not_tried {
                put!(self, "<li><code>{}</code> {}</li>", esc(id), esc(why));
            }
            self.body.push_str("</ul>\n");
        }
    }

    fn logs(&mut self, report: &Report) {
        let (mut logs, mut warnings) = (Vec::new(), Vec::new());
        if let Some(d) = &report.diagnosis {
            logs.extend(d.logs.iter().cloned());
            warnings.extend(d.warnings.iter().cloned());
        }
        for log in report.comparison_before.iter().flat_map(|c| &c.logs) {
            if !logs.iter().any(|l| l.sha256 == log.log.sha256 && l.name == log.log.name) {
                logs.push(log.log.clone());
            }
            for w in &log.warnings {
                let named = format!("{}: {w}", log.log.name);
                // The diagnosis of a single log has the same warning without its name.
                if !warnings.contains(w) && !warnings.contains(&named) {
                    warnings.push(named);
                }
            }
        }
        warnings.extend(report.warnings.iter().cloned());
        if logs.is_empty() && warnings.is_empty() {
            return;
        }
        self.folded("logs", "Logs and warnings", "Logs, noise and warnings", "");
        if !logs.is_empty() {
            self.body.push_str(
                "<table class=\"stack\"><thead><tr><th>log</th><th>use</th><th>driven by</th><th class=\"n\">span</th><th class=\"n\">position</th>\
                 <th class=\"n\">attitude</th><th class=\"n\">gyro</th><th class=\"n\">accelerometer</th><th>SHA-256</th></tr></thead><tbody>",
            );
            for l in &logs {
                let n = &l.noise;
                let mut cells = vec![
                    ("log", "", esc(&l.name)),
                    ("use", "", if l.held_out { "check".to_string() } else { "fit".to_string() }),
                    ("driven by", "", esc(&l.drive)),
                    ("span", "n", format!("{} s", significant(l.duration_s, 3))),
                ];
                for (name, sigma, unit) in [
                    ("position", n.position_m, "m"),
                    ("attitude", n.attitude_rad, "rad"),
                    ("gyro", n.gyro_rad_s, "rad/s"),
                    ("accelerometer", n.accel_m_s2, "m/s²"),
                ] {
                    cells.push((name, "n", noise(sigma, unit)));
                }
                let sha: String = l.sha256.chars().take(12).collect();
                cells.push(("SHA-256", "", format!("<code>{}</code>", esc(&sha))));
                self.body.push_str("<tr>");
                for (label, class, cell) in cells {
                    put!(self, "<td class=\"{class}\" data-label=\"{label}\">{cell}</td>");
                }
                self.body.push_str("</tr>\n");
            }
            self.body.push_str("</tbody></table>\n");
        }
        if let Some(d) = &report.diagnosis {
            put!(
                self,
                "<p class=\"small\">Noise is the standard deviation of one sample. Residuals scatter {} times as much; evidence and intervals allow for it.</p>\n",
                significant(d.dispersion, 3)
            );
        }
        if let Some(d) = report.diagnosis.as_ref().filter(|d| !d.per_log.is_empty()) {
            self.differences(&d.per_log);
        }
        if !warnings.is_empty() {
            self.list("ul", "ul", &warnings);
        }
    }

    fn differences(&mut self, all: &[OfOneLog]) {
        self.body.push_str(
            "<h3>In what the logs differ</h3><p class=\"small\">Clocks, biases, wind and battery may be others in every log; \
             these differences are not written.</p>\n<table class=\"stack\"><thead><tr><th>log</th><th>number</th>\
             <th class=\"n\">in this log</th><th class=\"n\">in all</th><th class=\"n\">difference</th></tr></thead><tbody>",
        );
        for d in all {
            put!(
                self,
                "<tr><td data-label=\"log\">{}</td><td data-label=\"number\"><code>{}</code> {}</td>\
                 <td class=\"n\" data-label=\"in this log\">{}</td><td class=\"n\" data-label=\"in all\">{}</td>\
                 <td class=\"n\" data-label=\"difference\">{}</td></tr>\n",
                esc(&d.log),
                esc(&d.id),
                esc(&d.name),
                quantity(d.value, &d.unit, 3),
                quantity(d.shared, &d.unit, 3),
                interval(d.value - d.shared, d.sigma, &d.unit)
            );
        }
        self.body.push_str("</tbody></table>\n");
    }

    fn how_to_read(&mut self, report: &Report, residuals: bool, causes: bool) {
        self.folded("read", "How to read this", "How to read this page", "");
        let mut notes: Vec<&str> = Vec::new();
        if report.diagnosis.is_some() {
            notes.extend([
                "An effect counts as missing when the log holds at least 6 nats of evidence that its parameters lie outside the tolerance of a carefully built vehicle. One nat is a factor e in probability; 6 are a factor 400.",
                "“Absent” does not mean zero: every parameter of a real vehicle is a little off. What stays within tolerance stands under “small corrections”.",
                "“Unseen” is flight that took no part in the fit. An effect that helps only where it was fitted is not believed.",
                "Errors of roll-outs cannot fall below the noise of the measured states that they start from.",
            ]);
        }
        if residuals {
            notes.push("A residual that keeps its shape after an effect was added has another cause. A residual inside the grey band is noise.");
        }
        if causes {
            notes.push("A residual that bends with a variable names its suspects: with speed, drag; with height, the ground; with voltage or time, the battery; with yaw rate, torque or inertia.");
        }
        if !report.overlays.is_empty() {
            notes.push("Simulated lines restart from measured states where they break off, so that one mistake does not hide the next.");
        }
        if notes.is_empty() {
            notes.push("This report holds no comparison and no diagnosis.");
        }
        let notes: Vec<String> = notes.into_iter().map(String::from).collect();
        self.list("ul", "ul", &notes);
    }

    fn finish(mut self, report: &Report) -> String {
        self.unfold();
        let live = report.live.as_ref().filter(|l| !l.flights.is_empty());
        let mut out = Skeleton::new(format!("{} – Propwash", report.title));
        out.part(Part::Base).style(STYLE);
        let mut frame = String::from("<div class=\"frame\">\n<nav aria-label=\"Contents\">\n");
        for (id, short) in &self.contents {
            let _ = writeln!(frame, "<a href=\"#{id}\">{}</a>", esc(short));
        }
        let libraries = match (live.is_some(), self.charts.is_empty()) {
            (true, _) => " Plots by uPlot, the flight by three.js, both MIT licence.",
            (false, false) => " Plots by uPlot, MIT licence.",
            (false, true) => "",
        };
        let _ = write!(
            frame,
            "</nav>\n<main>\n{}<footer>Written by Propwash {}.{libraries}</footer>\n</main>\n</div>\n",
            self.body,
            env!("CARGO_PKG_VERSION")
        );
        out.body(&frame).data("diagnosis", &report.diagnosis);
        if !self.charts.is_empty() || live.is_some() {
            out.part(Part::UPlot).data("charts", &self.charts);
        }
        if let Some(live) = live {
            let data = page_live::data(live, report.diagnosis.as_ref(), report.comparison_before.as_ref());
            out.data("live", &data);
            out.part(Part::Three).part(Part::Player).part(Part::Plots).part(Part::Scene3D);
        }
        out.script(SCRIPT);
        if live.is_some() {
            out.script(LIVE);
        }
        out.finish()
    }
}

/// A verdict as a sentence: capitalised, with a full stop.
pub(super) fn sentence(verdict: &str) -> String {
    let mut chars = verdict.chars();
    let first: String = chars.next().map(|c| c.to_uppercase().collect()).unwrap_or_default();
    let rest = chars.as_str().trim_end();
    let stop = if rest.ends_with(['.', '!', '?']) { "" } else { "." };
    format!("{first}{rest}{stop}")
}

/// A parameter's interval beside its nominal value, on its own scale.
fn interval_drawing(p: &ParameterFit) -> String {
    let Some([low, high]) = bounds(p.value, p.sigma) else {
        return "<span class=\"small\">no interval</span>".into();
    };
    let (mut from, mut to) = (low.min(p.filed), high.max(p.filed));
    let margin = 0.06 * (to - from);
    (from, to) = (from - margin, to + margin);
    let x = |v: f64| 100.0 * (v - from) / (to - from);
    let (l, h, v, f) = (x(low), x(high), x(p.value), x(p.filed));
    format!(
        "<svg class=\"interval\" role=\"img\" aria-label=\"{}\">\
         <line x1=\"0\" x2=\"100%\" y1=\"13\" y2=\"13\" stroke=\"var(--faint)\" stroke-width=\"2\"/>\
         <line x1=\"{f:.2}%\" x2=\"{f:.2}%\" y1=\"2\" y2=\"24\" stroke=\"var(--filed)\" stroke-width=\"2.5\"/>\
         <line x1=\"{l:.2}%\" x2=\"{h:.2}%\" y1=\"13\" y2=\"13\" stroke=\"var(--found)\" stroke-width=\"5\" opacity=\"0.55\"/>\
         <line x1=\"{l:.2}%\" x2=\"{l:.2}%\" y1=\"8\" y2=\"18\" stroke=\"var(--found)\" stroke-width=\"1.5\"/>\
         <line x1=\"{h:.2}%\" x2=\"{h:.2}%\" y1=\"8\" y2=\"18\" stroke=\"var(--found)\" stroke-width=\"1.5\"/>\
         <circle cx=\"{v:.2}%\" cy=\"13\" r=\"5\" fill=\"var(--found)\"/></svg>",
        esc(&format!(
            "filed {}, estimate {}",
            quantity(p.filed, &p.unit, 4),
            interval(p.value, p.sigma, &p.unit)
        ))
    )
}
