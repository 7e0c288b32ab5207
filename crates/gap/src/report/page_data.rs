//! The charts of a page as plain JSON: traces have a role instead of a colour, which the page's script draws in the colours
//! of its theme.

use super::quantity::{HALF_95, Scale};
use super::{Against, Bin, Overlay, ResidualSeries};
use propwash_page::Array;
use serde::Serialize;

/// Most points of a plotted line.
pub(super) const MOST_POINTS: usize = 3000;
/// Longest stretch whose moments are told by 16 bits, s.
const SHORT_S: f64 = 30.0;

/// One chart.
#[derive(Serialize)]
pub(super) struct Chart {
    /// Id of its element in the page.
    pub id: String,
    /// Text alternative for screen readers.
    pub title: String,
    pub x_title: String,
    pub y_title: String,
    pub traces: Vec<Trace>,
    /// Marked intervals of x: from, to, label.
    pub marks: Vec<(f64, f64, String)>,
    /// Half-height of the noise band about zero.
    pub noise: Option<f64>,
    /// Whether lines were thinned for plotting.
    #[serde(skip)]
    pub thinned: bool,
    /// Places of the last line.
    #[serde(skip)]
    last_x: Option<Array>,
}

/// One line of a chart.
#[derive(Serialize)]
pub(super) struct Trace {
    pub name: String,
    /// `ink`, `filed`, `found`, `c0` … : name of a colour in the page's style sheet.
    pub role: String,
    /// `lines`, `markers` or `lines+markers`.
    pub mode: &'static str,
    /// Number of the marker's shape.
    pub symbol: usize,
    pub width: f64,
    /// As with the line before it, where there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub x: Option<Array>,
    pub y: Array,
    /// Half-lengths of error bars.
    pub bars: Vec<f64>,
}

/// Scale that keeps SI units, except for angles, which are shown in degrees.
fn shown(unit: &str) -> Scale {
    Scale::for_size(1.0, unit)
}

/// Scale that suits the largest of some values.
fn fitting<'a>(unit: &str, values: impl Iterator<Item = &'a f64>) -> Scale {
    let most = values.filter(|v| v.is_finite()).fold(0.0f64, |most, v| most.max(v.abs()));
    Scale::for_size(most, unit)
}

fn axis(name: &str, unit: &str) -> String {
    if unit.is_empty() { name.to_string() } else { format!("{name}, {unit}") }
}

/// Seven digits are enough for a screen.
fn short(v: f64) -> Option<f64> {
    v.is_finite().then(|| format!("{v:.6e}").parse().unwrap_or(v))
}

/// Measured against simulated.
pub(super) fn overlay(k: usize, o: &Overlay) -> Chart {
    let scale = shown(&o.unit);
    let mut chart = over_time(format!("overlay-{k}"), &o.channel, &scale);
    chart.line("measured", "ink", 2.6, &o.t_s, &o.measured, scale.factor);
    chart.line("your model", "filed", 1.6, &o.t_s, &o.as_filed, scale.factor);
    chart.line("after", "found", 1.6, &o.t_s, &o.with_effects, scale.factor);
    chart
}

/// A residual over time, with its worst segments.
pub(super) fn residual(k: usize, r: &ResidualSeries) -> Chart {
    let scale = fitting(&r.unit, r.before.iter().chain(&r.after));
    let mut chart = over_time(format!("residual-{k}"), &r.name, &scale);
    chart.line("your model", "filed", 1.4, &r.t_s, &r.before, scale.factor);
    chart.line("after", "found", 1.4, &r.t_s, &r.after, scale.factor);
    chart.marks = r.worst.iter().enumerate().map(|(i, w)| (w.from_s, w.to_s, (i + 1).to_string())).collect();
    chart.noise = r.sigma.filter(|s| s.is_finite() && *s > 0.0).map(|s| HALF_95 * s * scale.factor);
    chart
}

/// A residual against its cause.
pub(super) fn against(k: usize, a: &Against) -> Chart {
    let y = fitting(&a.unit, a.before.iter().chain(&a.after).map(|b| &b.mean));
    let x = shown(&a.cause_unit);
    let trace = |name: &str, role: &str, symbol, bins: &[Bin]| Trace {
        name: name.into(),
        role: role.into(),
        mode: "lines+markers",
        symbol,
        width: 1.6,
        x: Some(Array::f32(bins.iter().map(|b| (b.cause * x.factor) as f32))),
        y: Array::f32(bins.iter().map(|b| (b.mean * y.factor) as f32)),
        bars: bins.iter().map(|b| short(HALF_95 * b.sigma * y.factor).unwrap_or(0.0)).collect(),
    };
    // A bin without a finite position on the axis cannot be plotted.
    let placed = |bins: &[Bin]| bins.iter().copied().filter(|b| b.cause.is_finite()).collect::<Vec<_>>();
    let (before, after) = (placed(&a.before), placed(&a.after));
    let mut traces = vec![trace("your model", "filed", 0, &before)];
    if !after.is_empty() {
        traces.push(trace("after", "found", 1, &after));
    }
    Chart {
        id: format!("cause-{k}"),
        title: format!("{} against {}", a.residual, a.cause),
        x_title: axis(&a.cause, &x.unit),
        y_title: y.unit,
        traces,
        marks: Vec::new(),
        noise: None,
        thinned: false,
        last_x: None,
    }
}

fn over_time(id: String, name: &str, scale: &Scale) -> Chart {
    Chart {
        id,
        title: name.to_string(),
        x_title: "time, s".into(),
        y_title: scale.unit.clone(),
        traces: Vec::new(),
        marks: Vec::new(),
        noise: None,
        thinned: false,
        last_x: None,
    }
}

impl Chart {
    fn line(&mut self, name: &str, role: &str, width: f64, t: &[f64], y: &[f64], factor: f64) {
        if y.is_empty() {
            return;
        }
        let kept = thin(t, y);
        self.thinned |= kept.len() < t.len().min(y.len());
        let times: Vec<f64> = kept.iter().map(|k| t[*k]).collect();
        let span = times.last().zip(times.first()).map_or(0.0, |(b, a)| b - a);
        // Over a short stretch 16 bits tell moments apart.
        let x = match span < SHORT_S {
            true => Array::i16(&times),
            false => Array::f32(times.iter().map(|t| *t as f32)),
        };
        let same = self.last_x.as_ref() == Some(&x);
        self.last_x = Some(x.clone());
        self.traces.push(Trace {
            name: name.into(),
            role: role.into(),
            mode: "lines",
            symbol: 0,
            width,
            x: (!same).then_some(x),
            y: Array::i16(&kept.iter().map(|k| y[*k] * factor).collect::<Vec<_>>()),
            bars: Vec::new(),
        });
    }
}

/// Indices of the samples to plot: of each group the minimum, the maximum and a gap, in order; all of them if there are
/// few. Samples without a time are left out.
fn thin(t: &[f64], y: &[f64]) -> Vec<usize> {
    let n = t.len().min(y.len());
    let all: Vec<usize> = (0..n).filter(|k| t[*k].is_finite()).collect();
    if all.len() <= MOST_POINTS {
        return all;
    }
    let mut out = Vec::new();
    for stretch in all.chunks(all.len().div_ceil(MOST_POINTS / 3)) {
        let finite = || stretch.iter().copied().filter(|k| y[*k].is_finite());
        let mut kept: Vec<usize> = [
            finite().min_by(|a, b| y[*a].total_cmp(&y[*b])),
            finite().max_by(|a, b| y[*a].total_cmp(&y[*b])),
            stretch.iter().copied().find(|k| !y[*k].is_finite()),
        ]
        .into_iter()
        .flatten()
        .collect();
        kept.sort_unstable();
        kept.dedup();
        out.extend(kept);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thinned_line_keeps_its_peaks_and_its_gaps() {
        let n = 100_000;
        let t: Vec<f64> = (0..n).map(|k| k as f64 * 0.01).collect();
        let mut y: Vec<f64> = t.iter().map(|t| t.sin()).collect();
        y[43_210] = 7.0;
        y[60_001] = -9.0;
        y[77_777] = f64::NAN;
        let kept = thin(&t, &y);
        assert!(kept.len() <= MOST_POINTS, "{}", kept.len());
        for k in [43_210, 60_001, 77_777] {
            assert!(kept.contains(&k), "{k}");
        }
        assert!(kept.windows(2).all(|w| w[0] < w[1]));
        assert_eq!(thin(&t[..10], &y[..10]).len(), 10);
    }
}
