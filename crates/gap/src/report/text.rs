//! A diagnosis as text for a terminal.

use super::quantity::{HALF_95, Scale, interval, percent, quantity, significant};
use super::rungs::{measures, turns};
use crate::headline::{before_after, evidence, nats};
use crate::verdict::{Calibration, Diagnosis, Finding, HorizonError, LogSummary, LookAlike, OfOneLog, Rung};
use propwash_physics::effects::Area;
use std::fmt::Write as _;

/// Width of the text: no line is longer, except for a single long name.
pub const TEXT_COLUMNS: usize = 100;

/// Most candidates shown in the list of all that were tried alone.
const MOST_SINGLES: usize = 8;

/// A channel of the ladder: name, unit, error.
pub(super) type LadderChannel = (&'static str, &'static str, fn(&HorizonError) -> f64);

/// The channels of the ladder.
pub(super) static LADDER_CHANNELS: [LadderChannel; 4] = [
    ("position", "m", |e| e.position_m),
    ("velocity", "m/s", |e| e.velocity_m_s),
    ("attitude", "rad", |e| e.attitude_rad),
    ("body rate", "rad/s", |e| e.rate_rad_s),
];

/// The channels that are results of the model: without attitude and body rate where these are inputs.
pub(super) fn ladder_channels(ladder: &[Rung]) -> &'static [LadderChannel] {
    if turns(ladder) { &LADDER_CHANNELS } else { &LADDER_CHANNELS[..2] }
}

/// A difference in evidence that nobody would bet on, nats.
const AS_WELL_NATS: f64 = 0.5;

/// How well a look-alike fits, in words.
pub(super) fn compared(l: &LookAlike) -> String {
    if l.worse_by_nats.abs() < AS_WELL_NATS {
        return "fits as well".into();
    }
    let nats = significant(l.worse_by_nats.abs(), 2);
    if l.worse_by_nats < 0.0 {
        format!("fits better by {nats}\u{a0}nats, less plausible")
    } else {
        format!("fits worse by {nats}\u{a0}nats")
    }
}

/// All horizons of the ladder, in rising order, s.
pub(super) fn horizons(ladder: &[Rung]) -> Vec<f64> {
    let mut all: Vec<f64> =
        ladder.iter().flat_map(|r| r.training.iter().chain(&r.held_out)).map(|e| e.horizon_s).collect();
    all.sort_by(f64::total_cmp);
    all.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
    all
}

/// The error at one horizon, if the step has it.
pub(super) fn at(errors: &[HorizonError], horizon_s: f64) -> Option<&HorizonError> {
    errors.iter().find(|e| (e.horizon_s - horizon_s).abs() < 1e-9)
}

/// Where an effect acts, in a word.
pub(super) fn area(area: Area) -> &'static str {
    match area {
        Area::Airframe => "airframe",
        Area::Mass => "mass",
        Area::Drive => "drive",
        Area::Measurement => "measurement",
    }
}

/// Effects that would look like a finding, with the reason.
pub(super) fn stands_for(f: &Finding) -> Option<String> {
    let names = f.stands_for.join(", ");
    (!names.is_empty()).then(|| format!("{names}: without rotor speeds the same"))
}

/// The diagnosis in at most [`TEXT_COLUMNS`] columns: verdict, effects, look-alikes, ladder, calibration, remainder,
/// advice, logs, warnings.
pub fn text(diagnosis: &Diagnosis) -> String {
    let d = diagnosis;
    let mut out = Out::default();
    out.paragraph(0, &format!("{}: {}", d.vehicle, d.headline));
    out.paragraph(0, &evidence(d));
    out.moments(d);
    for (k, finding) in d.findings.iter().enumerate() {
        out.finding(k + 1, finding, d.judged_on());
    }
    if let Some(network) = &d.network {
        out.heading("Network");
        out.paragraph(4, &network.text);
    }
    out.ladder(&d.ladder);
    out.calibration(&d.calibration);
    out.remainder(d);
    out.singles(&d.singles);
    let advice: Vec<String> = d.advice.iter().map(|a| a.text.clone()).collect();
    out.list("Next flight", &advice);
    out.differences(&d.per_log);
    out.logs(&d.logs, d.dispersion);
    let not_tried: Vec<String> = d.not_tried.iter().map(|(id, why)| format!("{id}: {why}")).collect();
    out.list("Not tried", &not_tried);
    out.list("Mind", &d.warnings);
    out.0
}

/// Text under construction.
#[derive(Default)]
pub(super) struct Out(pub(super) String);

impl Out {
    pub(super) fn heading(&mut self, title: &str) {
        let _ = write!(self.0, "\n{title}\n");
    }

    /// Words wrapped to the width, every line indented.
    pub(super) fn paragraph(&mut self, indent: usize, words: &str) {
        self.hanging(&" ".repeat(indent), indent, words);
    }

    /// Words wrapped to the width, the first line after `first`, the others indented.
    pub(super) fn hanging(&mut self, first: &str, indent: usize, words: &str) {
        for (k, line) in wrap(words, TEXT_COLUMNS - indent).iter().enumerate() {
            let lead = if k == 0 { first.to_string() } else { " ".repeat(indent) };
            let _ = writeln!(self.0, "{}", format!("{lead}{line}").trim_end());
        }
    }

    pub(super) fn list(&mut self, title: &str, entries: &[String]) {
        if !entries.is_empty() {
            self.heading(title);
            for entry in entries {
                self.hanging("  - ", 4, entry);
            }
        }
    }

    fn finding(&mut self, number: usize, f: &Finding, judged_on: &str) {
        let certain = match (f.doubt(), f.certain) {
            (Some(_), _) => ", in doubt, not written",
            (None, true) if f.unwritten().is_some() => ", not written",
            (None, true) => "",
            (None, false) if f.one_of_several() => ", one of several",
            (None, false) => ", not certain",
        };
        self.heading(&format!("{number}. {}", f.id));
        self.paragraph(4, &format!("{} ({}{certain})", f.title, area(f.area)));
        let rows: Vec<Vec<String>> = f
            .parameters
            .iter()
            .map(|p| {
                vec![
                    p.name.clone(),
                    interval(p.value, p.sigma, &p.unit),
                    format!("filed {}", quantity(p.filed, &p.unit, 4)),
                ]
            })
            .collect();
        self.table(4, &[], &rows, &[false, true, false]);
        if let Some(words) = before_after(f) {
            self.paragraph(4, &format!("without it → with it on {judged_on}: {words}"));
        }
        if let Some(reason) = f.unwritten() {
            self.paragraph(4, reason);
        }
        let verb = if f.removed_share < 0.0 { "adds" } else { "removes" };
        let share = percent(f.removed_share.abs());
        let rest = match f.each_log {
            true => " in one of the logs".to_string(),
            false => format!("; {verb} {share} of the excess error on held-out windows of the fit"),
        };
        self.paragraph(4, &format!("evidence {}{rest}", nats(f.evidence_nats)));
        self.paragraph(4, &format!("second estimator: {}", f.second.text));
        for l in &f.look_alikes {
            let apart = match l.manoeuvre.is_empty() {
                true => String::new(),
                false => format!("; to tell them apart: {}", l.manoeuvre),
            };
            let words = format!("{} ({}): {}{apart}", l.ids.join(" + "), l.title, compared(l));
            self.hanging("    or  ", 8, &words);
        }
        if let Some(words) = stands_for(f) {
            self.hanging("    or  ", 8, &words);
        }
    }

    fn ladder(&mut self, ladder: &[Rung]) {
        let horizons = horizons(ladder);
        if horizons.is_empty() {
            return;
        }
        let unseen = ladder.iter().any(|r| !r.held_out.is_empty());
        let seen = ladder.iter().any(|r| !r.training.is_empty());
        self.instants(ladder, unseen);
        self.heading(match (unseen, seen) {
            (true, true) => {
                "Error of roll-outs, RMS at their end: on unseen flight (on flight used for the fit)"
            }
            (true, false) => "Error of roll-outs, RMS at their end: on unseen flight",
            _ => "Error of roll-outs, RMS at their end: on flight used for the fit",
        });
        for (name, unit, error) in ladder_channels(ladder).iter().copied() {
            let mut header = vec![name.to_string()];
            let mut columns = Vec::new();
            for h in &horizons {
                let scale = ladder_scale(ladder, *h, unit, error);
                let unit = if scale.unit.is_empty() { String::new() } else { format!(", {}", scale.unit) };
                header.push(format!("{}{unit}", quantity(*h, "s", 2)));
                columns.push(scale);
            }
            let rows: Vec<Vec<String>> = ladder
                .iter()
                .map(|r| {
                    let cells = horizons.iter().zip(&columns).map(|(h, scale)| {
                        let number =
                            |e: Option<&HorizonError>| e.map(|e| significant(error(e) * scale.factor, 3));
                        match (number(at(&r.held_out, *h)), number(at(&r.training, *h))) {
                            (Some(a), Some(b)) => format!("{a} ({b})"),
                            (Some(a), None) => a,
                            (None, Some(b)) if unseen => format!("({b})"),
                            (None, Some(b)) => b,
                            (None, None) => "–".into(),
                        }
                    });
                    core::iter::once(r.label.clone()).chain(cells).collect()
                })
                .collect();
            let mut right = vec![true; horizons.len() + 1];
            right[0] = false;
            self.table(2, &header, &rows, &right);
        }
    }

    /// Force and torque at the instants, with their per cent of the first step.
    fn instants(&mut self, ladder: &[Rung], unseen: bool) {
        let shown: Vec<_> = measures(ladder).into_iter().filter(|m| m.name.contains("lacks")).collect();
        if shown.is_empty() {
            return;
        }
        self.heading(if unseen {
            "What the model lacks at the instants, RMS of means over 50 ms, on unseen flight"
        } else {
            "What the model lacks at the instants, RMS of means over 50 ms, on flight used for the fit"
        });
        let mut header = vec![String::new()];
        for m in &shown {
            let what = m.name.split(' ').next().unwrap_or_default();
            header.extend([format!("{what}, {}", m.scale.unit), "of filed".into(), "times noise".into()]);
        }
        let rows: Vec<Vec<String>> = ladder
            .iter()
            .enumerate()
            .map(|(k, r)| {
                let lack = if unseen { r.held_out_lack } else { r.training_lack };
                let times = [lack.map(|l| l.force_times_noise), lack.and_then(|l| l.torque_times_noise)];
                let mut row = vec![r.label.clone()];
                for m in &shown {
                    let value = m.drawn(k).map_or("–".into(), |v| significant(v * m.scale.factor, 3));
                    let which = usize::from(m.name.starts_with("torque"));
                    let noise = times[which].map_or("–".into(), |t| significant(t, 2));
                    row.extend([value, m.share(k), noise]);
                }
                row
            })
            .collect();
        let mut right = vec![true; header.len()];
        right[0] = false;
        self.table(2, &header, &rows, &right);
    }

    fn calibration(&mut self, calibration: &[Calibration]) {
        if calibration.is_empty() {
            return;
        }
        let (far, within): (Vec<_>, Vec<_>) = calibration.iter().partition(|c| c.far());
        for (title, list) in [
            ("Small corrections (within manufacturing tolerance)", within),
            ("Outside tolerance, but not enough evidence for a finding", far),
        ] {
            if list.is_empty() {
                continue;
            }
            self.heading(title);
            let rows: Vec<Vec<String>> = list.iter().map(|c| calibration_row(c)).collect();
            self.table(2, &[], &rows, &[false, false, true, false, false]);
        }
    }

    fn remainder(&mut self, d: &Diagnosis) {
        let r = &d.remainder;
        self.heading(if r.unexplained {
            "What remains: more than a known vehicle leaves"
        } else {
            "What remains"
        });
        if !r.text.is_empty() {
            self.paragraph(2, &r.text);
        }
        let rows = [
            ("force over mass", "m/s²", r.force_before_m_s2, r.force_m_s2),
            ("torque over inertia", "rad/s²", r.torque_before_rad_s2, r.torque_rad_s2),
        ];
        let rows: Vec<Vec<String>> = rows
            .into_iter()
            .filter(|(.., before, after)| *before > 0.0 || *after > 0.0)
            .map(|(name, unit, before, after)| {
                vec![name.into(), quantity(before, unit, 3), "→".into(), quantity(after, unit, 3)]
            })
            .collect();
        self.table(2, &[], &rows, &[false, true, false, true]);
        if !r.terms.is_empty() {
            self.paragraph(
                2,
                "It looks like (accelerations; share of it that each explains on unseen flight):",
            );
            let rows: Vec<Vec<String>> = r
                .terms
                .iter()
                .map(|t| {
                    vec![
                        t.on.clone(),
                        format!("{} · {}", interval(t.coefficient, t.sigma, "1"), t.variable),
                        percent(t.explained_share),
                    ]
                })
                .collect();
            self.table(4, &[], &rows, &[false, false, true]);
        }
    }

    fn singles(&mut self, singles: &[(String, f64)]) {
        if singles.is_empty() {
            return;
        }
        let sorted = sorted_singles(singles);
        self.heading("Each candidate alone, evidence in nats");
        let shown: Vec<String> = sorted
            .iter()
            .take(MOST_SINGLES)
            .map(|(id, nats)| format!("{id}\u{a0}{}", significant(*nats, 3)))
            .collect();
        let more = match sorted.len().saturating_sub(MOST_SINGLES) {
            0 => String::new(),
            n => format!("; {n} more in the page and in JSON"),
        };
        self.paragraph(2, &format!("{}{more}", shown.join(", ")));
    }

    fn differences(&mut self, all: &[OfOneLog]) {
        if all.is_empty() {
            return;
        }
        self.heading("In what the logs differ");
        self.paragraph(
            2,
            "clocks, biases, wind and battery may be others in every log; these differences are not written",
        );
        let header = ["", "", "in this log", "in all", "difference"].map(String::from);
        let rows: Vec<Vec<String>> = all
            .iter()
            .map(|d| {
                let name = format!("{} {}", d.id, d.name);
                let difference = interval(d.value - d.shared, d.sigma, &d.unit);
                let [own, all] = [d.value, d.shared].map(|v| quantity(v, &d.unit, 3));
                vec![d.log.clone(), name, own, all, difference]
            })
            .collect();
        self.table(2, &header, &rows, &[false, false, true, true, true]);
    }

    fn logs(&mut self, logs: &[LogSummary], dispersion: f64) {
        if logs.is_empty() {
            return;
        }
        self.heading("Logs and the noise of one sample");
        let header = ["", "span", "position", "attitude", "gyro", "accelerometer", "driven by", "use"];
        let header: Vec<String> = header.iter().map(|h| (*h).to_string()).collect();
        let rows: Vec<Vec<String>> = logs
            .iter()
            .map(|l| {
                let n = &l.noise;
                vec![
                    l.name.clone(),
                    format!("{} s", significant(l.duration_s, 3)),
                    noise(n.position_m, "m"),
                    noise(n.attitude_rad, "rad"),
                    noise(n.gyro_rad_s, "rad/s"),
                    noise(n.accel_m_s2, "m/s²"),
                    l.drive.clone(),
                    if l.held_out { "check".into() } else { "fit".into() },
                ]
            })
            .collect();
        self.table(2, &header, &rows, &[false, true, true, true, true, true, false, false]);
        self.paragraph(
            2,
            &format!(
                "residuals scatter {} times as much as that noise; intervals allow for it",
                significant(dispersion, 3)
            ),
        );
    }

    /// A table with columns two spaces apart; if it is too wide, the last columns go to a line of their own.
    fn table(&mut self, indent: usize, header: &[String], rows: &[Vec<String>], right: &[bool]) {
        let all = || core::iter::once(header).chain(rows.iter().map(Vec::as_slice)).filter(|r| !r.is_empty());
        let mut widths = vec![0; right.len()];
        for row in all() {
            for (width, cell) in widths.iter_mut().zip(row) {
                *width = (*width).max(cell.chars().count());
            }
        }
        for row in all() {
            let mut line = " ".repeat(indent);
            let mut used = indent;
            for (k, cell) in row.iter().enumerate() {
                let pad = widths[k] - cell.chars().count();
                if used + widths[k] > TEXT_COLUMNS && k > 0 {
                    let _ = writeln!(self.0, "{}", line.trim_end());
                    line = " ".repeat(indent + 4);
                    used = indent + 4;
                }
                let (before, after) = if right[k] { (pad, 0) } else { (0, pad) };
                let _ = write!(line, "{}{cell}{}  ", " ".repeat(before), " ".repeat(after));
                used += widths[k] + 2;
            }
            let _ = writeln!(self.0, "{}", line.trim_end());
        }
    }
}

/// A line about a parameter of the calibration.
fn calibration_row(c: &Calibration) -> Vec<String> {
    let p = &c.parameter;
    vec![
        c.id.clone(),
        p.name.clone(),
        interval(p.value, p.sigma, &p.unit),
        format!("filed {}", quantity(p.filed, &p.unit, 4)),
        if c.far() {
            format!("{} tolerances off", significant(c.times_tolerance(), 2))
        } else {
            String::new()
        },
    ]
}

/// Candidates tried alone, most evidence first.
pub(super) fn sorted_singles(singles: &[(String, f64)]) -> Vec<(String, f64)> {
    let mut sorted = singles.to_vec();
    sorted.sort_by(|a, b| b.1.total_cmp(&a.1));
    sorted
}

/// The noise of a channel, a dash where the log has none of it.
pub(super) fn noise(sigma: f64, unit: &str) -> String {
    if sigma.is_finite() && sigma > 0.0 { quantity(sigma, unit, 2) } else { "–".into() }
}

/// The unit that suits all ladder steps at one horizon: that of three times the geometric mean of the largest and the
/// smallest error, so that most numbers are between 0.3 and 300.
pub(super) fn ladder_scale(
    ladder: &[Rung],
    horizon_s: f64,
    unit: &str,
    error: fn(&HorizonError) -> f64,
) -> Scale {
    let sizes = ladder
        .iter()
        .flat_map(|r| [at(&r.held_out, horizon_s), at(&r.training, horizon_s)])
        .flatten()
        .map(error)
        .filter(|e| e.is_finite() && *e > 0.0);
    let (low, high) = sizes.fold((f64::INFINITY, 0.0f64), |(l, h), e| (l.min(e), h.max(e)));
    Scale::for_size(if high > 0.0 { 3.0 * (low * high).sqrt() } else { 0.0 }, unit)
}

/// The 95 % interval of a normal estimate.
pub(super) fn bounds(value: f64, sigma: f64) -> Option<[f64; 2]> {
    let half = HALF_95 * sigma;
    (half.is_finite() && half > 0.0 && value.is_finite()).then_some([value - half, value + half])
}

/// Breaks words into lines of at most `width` characters; a longer word gets its own line. No-break spaces do not break.
fn wrap(words: &str, width: usize) -> Vec<String> {
    let (mut lines, mut line) = (Vec::new(), String::new());
    for word in words.split([' ', '\n']).filter(|w| !w.is_empty()) {
        if !line.is_empty() && line.chars().count() + 1 + word.chars().count() > width {
            lines.push(core::mem::take(&mut line));
        }
        if !line.is_empty() {
            line.push(' ');
        }
        line.push_str(word);
    }
    lines.push(line);
    lines.into_iter().map(|l| l.replace('\u{a0}', " ")).collect()
}
