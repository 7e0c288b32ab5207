//! The series and bins of a comparison shown on a page, before and after effects were added.

use super::{Against, Bin, ResidualSeries, WorstSegment};
use crate::causes::Cause;
use crate::compare::{Comparison, LogComparison, Series};

/// Least share of variance explained by a plotted cause, and its significance in standard deviations.
const DRAWN: (f64, f64) = (0.05, 5.0);
/// Most plots of a residual against a cause.
const MOST_DRAWN: usize = 8;

const AXES: [&str; 3] = ["x", "y", "z"];

/// The same log in the other comparison.
pub(super) fn same_log<'a>(log: &LogComparison, other: Option<&'a Comparison>) -> Option<&'a LogComparison> {
    other?.logs.iter().find(|l| l.log.sha256 == log.log.sha256 && l.log.name == log.log.name)
}

/// Residual force and torque of every log over time.
pub(super) fn residuals(before: &Comparison, after: Option<&Comparison>) -> Vec<ResidualSeries> {
    let mut out = Vec::new();
    for log in &before.logs {
        let (old, new) = (&log.one_step.series, same_log(log, after).map(|l| &l.one_step.series));
        let worst: Vec<WorstSegment> = log
            .worst
            .iter()
            .map(|s| WorstSegment {
                from_s: s.from_s,
                to_s: s.to_s,
                rms_before: s.force_rms_n,
                rms_after: new.and_then(|n| force_rms(n, s.from_s, s.to_s)),
                what: s.text.clone(),
            })
            .collect();
        for k in 0..3 {
            let force = |s: &Series| s.force_body_n.iter().map(|f| f[k]).collect::<Vec<f64>>();
            out.push(ResidualSeries {
                log: log.log.name.clone(),
                name: format!("force along body {}", AXES[k]),
                unit: "N".into(),
                t_s: old.t_s.clone(),
                before: force(old),
                after: on_times(old, new, &force),
                sigma: Some(old.force_sigma_n[k]),
                worst: worst.clone(),
            });
            let torque =
                |s: &Series| s.torque_n_m.iter().map(|t| t.map_or(f64::NAN, |t| t[k])).collect::<Vec<f64>>();
            if old.torque_n_m.iter().all(Option::is_none) {
                continue;
            }
            out.push(ResidualSeries {
                log: log.log.name.clone(),
                name: format!("torque about body {}", AXES[k]),
                unit: "N·m".into(),
                t_s: old.t_s.clone(),
                before: torque(old),
                after: on_times(old, new, &torque),
                sigma: Some(old.torque_sigma_n_m[k]),
                worst: worst.clone(),
            });
        }
    }
    out
}

/// A series of the other comparison at the times of this one: both are on one grid, but may start at different times. NaN
/// where the other has no value; empty without another.
fn on_times(old: &Series, new: Option<&Series>, of: &dyn Fn(&Series) -> Vec<f64>) -> Vec<f64> {
    let Some(new) = new else { return Vec::new() };
    let values = of(new);
    if values.len() < new.t_s.len() {
        return Vec::new();
    }
    let mut k = 0;
    let at = |t: &f64| {
        while k + 1 < new.t_s.len() && (new.t_s[k + 1] - t).abs() <= (new.t_s[k] - t).abs() {
            k += 1;
        }
        let near = new.t_s.get(k).is_some_and(|at| (at - t).abs() < 0.03);
        if near { values[k] } else { f64::NAN }
    };
    old.t_s.iter().map(at).collect()
}

/// Root mean square of the residual force's length in a segment.
fn force_rms(series: &Series, from_s: f64, to_s: f64) -> Option<f64> {
    let inside = series.t_s.iter().zip(&series.force_body_n).filter(|(t, _)| **t >= from_s && **t <= to_s);
    let (sum, n) = inside.fold((0.0, 0), |(s, n), (_, f)| (s + f.iter().map(|v| v * v).sum::<f64>(), n + 1));
    (n > 0).then(|| (sum / f64::from(n)).sqrt())
}

/// The residuals that depend most on a cause, strongest first, and how many more there are.
pub(super) fn causes(before: &Comparison, after: Option<&Comparison>) -> (Vec<Against>, usize) {
    fn of(c: &Comparison) -> &[Cause] {
        match (&c.pooled, c.logs.first()) {
            (Some(p), _) => &p.causes,
            (None, Some(l)) => &l.causes,
            (None, None) => &[],
        }
    }
    let mut all: Vec<(f64, Against)> = Vec::new();
    for cause in of(before) {
        let same = after.and_then(|a| of(a).iter().find(|c| c.name == cause.name));
        for r in &cause.responses {
            if !(r.share >= DRAWN.0 && r.significance >= DRAWN.1) {
                continue;
            }
            let bins = |c: &Cause, name: &str| -> Vec<Bin> {
                let Some(r) = c.responses.iter().find(|r| r.name == name) else { return Vec::new() };
                c.values
                    .iter()
                    .zip(&c.counts)
                    .zip(r.means.iter().zip(&r.standard_errors))
                    .map(|((cause, n), (mean, sigma))| Bin {
                        cause: *cause,
                        mean: *mean,
                        sigma: *sigma,
                        n: *n,
                    })
                    .collect()
            };
            all.push((
                r.share,
                Against {
                    residual: r.title.clone(),
                    unit: r.unit.clone(),
                    cause: cause.title.clone(),
                    cause_unit: cause.unit.clone(),
                    before: bins(cause, &r.name),
                    after: same.map_or_else(Vec::new, |c| bins(c, &r.name)),
                },
            ));
        }
    }
    all.sort_by(|a, b| b.0.total_cmp(&a.0));
    let more = all.len().saturating_sub(MOST_DRAWN);
    (all.into_iter().take(MOST_DRAWN).map(|(_, a)| a).collect(), more)
}
