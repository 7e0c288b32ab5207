//! What a session saves: the vehicle file with what has changed, the report, and the commands that make the same file.

use super::written::{completed_by, expression_words};
use super::{BY, Session, Use};
use crate::error::Result;
use crate::fitted::Filed;
use crate::report::Report;
use propwash_vehicle::Vehicle;
use serde::Serialize;
use std::fmt::Write as _;

/// What has become of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum LineChange {
    /// In both files.
    Kept,
    /// In the new file only.
    Added,
    /// In the old file only.
    Removed,
}

/// A line of a file or of the one before.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Line {
    /// What has become of it.
    pub change: LineChange,
    /// Without its end.
    pub text: String,
}

/// What a session saves.
#[derive(Clone, Debug, Serialize)]
pub struct Saved {
    /// Text of the vehicle file.
    pub vehicle: String,
    /// Its lines beside those of the file before.
    pub diff: Vec<Line>,
    /// The report page; none where it was not asked for.
    pub report: Option<String>,
    /// Commands of a shell that make the same vehicle file, but for its date.
    pub steps: String,
    /// What could not be written as it was.
    pub remarks: Vec<String>,
}

impl Session {
    /// The vehicle file with what is on, and what goes with it. `out` is the name of the file in the commands, `logs` are the
    /// paths of the flights there, in their order, and `flags` what else reading them takes (`--drive …`). With `report` the page
    /// is made as well, which takes some seconds.
    ///
    /// # Errors
    /// [`crate::accept::AcceptError`] where the file cannot hold a value.
    pub fn save(&self, out: &str, logs: &[String], flags: &[String], report: bool) -> Result<Saved> {
        let (puts, own) = (self.puts(), self.expressions());
        let filed = Filed { label: &self.label, vehicle: &self.filed, text: self.text.clone() };
        let (vehicle, after, remarks) = completed_by(&filed, &self.now.parted, BY, &puts, &own)?;
        let changed = vehicle != self.text;
        let report = report.then(|| self.page(changed.then_some(&after))).transpose()?;
        let steps = self.steps(out, logs, flags)?;
        Ok(Saved { diff: diff(&self.text, &vehicle), vehicle, report, steps, remarks })
    }

    /// Own expressions that are on, as the command line takes them.
    fn expressions(&self) -> Vec<String> {
        let base = &self.now.base;
        let on = |name: &str| self.now.setting.on.iter().any(|c| base.model.candidates[*c].id == name);
        base.own.iter().filter(|o| on(&o.name)).map(expression_words).collect()
    }

    fn page(&self, after: Option<&Vehicle>) -> Result<String> {
        let parted = &self.now.parted;
        let report = match self.now.base.fit.as_ref().filter(|f| f.searched) {
            Some(fit) => {
                let mut report = Report::of_diagnosis(&fit.diagnosed, parted, &self.filed, after)?;
                let mut rungs = vec![("as filed".to_string(), self.filed.clone())];
                rungs.extend(after.map(|v| ("with what is on".to_string(), v.clone())));
                if let Some(d) = &mut report.diagnosis {
                    d.ladder = parted.ladder(&rungs)?;
                }
                report.warnings.push(format!("saved after: {}", self.history.words().join("; ")));
                report
            }
            None => {
                let tracks = parted.all();
                let before = crate::compare(&tracks, &self.filed)?;
                let mut report = Report::with_flights(&before, &tracks, &self.filed)?;
                report.comparison_after = after.map(|v| crate::compare(&tracks, v)).transpose()?;
                report
            }
        };
        Ok(report.html())
    }

    /// The commands of a shell.
    fn steps(&self, out: &str, logs: &[String], flags: &[String]) -> Result<String> {
        let quoted = |text: &str| format!("'{}'", text.replace('\'', "'\\''"));
        let of = |wanted: Use| -> Vec<String> {
            let used = self.now.uses.iter().zip(logs);
            used.filter(|(u, _)| **u == wanted).map(|(_, l)| quoted(l)).collect()
        };
        let (fit, check) = (of(Use::Fit).join(" "), of(Use::Check).join(" "));
        let mut text = String::from("#!/bin/sh\n# The steps of a session of the lab:\n");
        for (i, what) in self.history.words().iter().enumerate() {
            // Writing to a string cannot fail.
            let _ = writeln!(text, "# {i}. {}", what.replace(['\n', '\r'], " "));
        }
        text.push_str("set -e\n");
        let reading: String = flags.iter().map(|f| format!(" \\\n  {}", quoted(f))).collect();
        let mut add = format!("propwash add --vehicle {}{reading} \\\n  --fit {fit}", quoted(&self.label));
        if !check.is_empty() {
            let _ = write!(add, " \\\n  --held-out {check}");
        }
        for own in self.expressions() {
            let _ = write!(add, " \\\n  --expression {}", quoted(&own));
        }
        for put in self.puts() {
            let flag = if put.correction { "--adjust" } else { "--set" };
            let _ = write!(add, " \\\n  {flag} {}", quoted(&put.to_string()));
        }
        if self.puts().is_empty() {
            text.push_str("# Nothing is on: the vehicle file stays as it is.\n");
        } else {
            let _ = writeln!(text, "{add} \\\n  --out {}", quoted(out));
        }
        Ok(text)
    }
}

/// Lines of two texts: kept, added, removed, by the longest common part. Removed lines come before those in their place.
pub(super) fn diff(old: &str, new: &str) -> Vec<Line> {
    let (a, b): (Vec<&str>, Vec<&str>) = (old.lines().collect(), new.lines().collect());
    let head = a.iter().zip(&b).take_while(|(x, y)| x == y).count();
    let tail = a[head..].iter().rev().zip(b[head..].iter().rev()).take_while(|(x, y)| x == y).count();
    let (mid_a, mid_b) = (&a[head..a.len() - tail], &b[head..b.len() - tail]);
    // Lengths of the longest common part from (i, j) on.
    let width = mid_b.len() + 1;
    let mut common = vec![0u32; (mid_a.len() + 1) * width];
    for i in (0..mid_a.len()).rev() {
        for j in (0..mid_b.len()).rev() {
            common[i * width + j] = match mid_a[i] == mid_b[j] {
                true => common[(i + 1) * width + j + 1] + 1,
                false => common[(i + 1) * width + j].max(common[i * width + j + 1]),
            };
        }
    }
    let line = |change, text: &&str| Line { change, text: (*text).into() };
    let mut out: Vec<Line> = a[..head].iter().map(|t| line(LineChange::Kept, t)).collect();
    let (mut i, mut j) = (0, 0);
    while i < mid_a.len() || j < mid_b.len() {
        if i < mid_a.len() && j < mid_b.len() && mid_a[i] == mid_b[j] {
            out.push(line(LineChange::Kept, &mid_a[i]));
            (i, j) = (i + 1, j + 1);
        } else if i < mid_a.len()
            && (j == mid_b.len() || common[(i + 1) * width + j] >= common[i * width + j + 1])
        {
            out.push(line(LineChange::Removed, &mid_a[i]));
            i += 1;
        } else {
            out.push(line(LineChange::Added, &mid_b[j]));
            j += 1;
        }
    }
    out.extend(a[a.len() - tail..].iter().map(|t| line(LineChange::Kept, t)));
    out
}
