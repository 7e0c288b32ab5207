//! Where in a flight the model departs most.

use super::Segment;
use super::context::Context;
use crate::causes::short;
use crate::replay::STEP_S;
use crate::residual::{self, Replay, Residuals};
use propwash_flight::clean;
use propwash_trace::math::vec3;

/// Number of worst segments reported, and their length, s.
const WORST: usize = 5;
const SEGMENT_S: f64 = 1.0;

/// The segments of [`SEGMENT_S`] with the largest residuals, worst first.
pub(super) fn worst(replay: &Replay, residuals: &Residuals, context: &Context) -> Vec<Segment> {
    let list = &residuals.samples;
    let (per, stride) = ((SEGMENT_S / STEP_S).round() as usize, (0.25 / STEP_S).round() as usize);
    let total = |sigma: [f64; 3]| vec3::dot(sigma, sigma).max(1e-300);
    let sigmas = [total(residuals.force_sigma_n), total(residuals.torque_sigma_n_m)];
    let mut all: Vec<(f64, usize, usize)> = Vec::new();
    let mut at = 0;
    while at + per <= replay.n_steps() {
        let (a, b) = (list.partition_point(|s| s.step < at), list.partition_point(|s| s.step < at + per));
        at += stride;
        // Segments that are mostly gaps are not judged.
        if (b - a) * 2 < per {
            continue;
        }
        let (force, torque) = squares(&list[a..b]);
        let score = force / sigmas[0] + torque.map_or(0.0, |t| t / sigmas[1]);
        all.push((score, a, b));
    }
    all.sort_by(|x, y| y.0.total_cmp(&x.0));
    // Without overlap: neighbouring segments would report the same event.
    let mut chosen: Vec<(f64, usize, usize)> = Vec::new();
    for one in all {
        let apart = |c: &(f64, usize, usize)| one.2 <= c.1 || one.1 >= c.2;
        if chosen.len() < WORST && chosen.iter().all(apart) {
            chosen.push(one);
        }
    }
    // Typical values of this flight, to say what is unusual about a segment.
    let usual: Vec<[f64; 2]> = context
        .values
        .iter()
        .map(|v| [0.1, 0.9].map(|p| clean::quantile(v, p).unwrap_or(f64::NAN)))
        .collect();
    chosen
        .into_iter()
        .map(|(score, a, b)| {
            let part = &list[a..b];
            let (force, torque) = squares(part);
            let mut seen = Vec::new();
            let mut special = Vec::new();
            for ((label, values), usual) in context.labels.iter().zip(&context.values).zip(&usual) {
                let mean = part.iter().map(|s| values[s.step]).sum::<f64>() / part.len() as f64;
                if !mean.is_finite() {
                    continue;
                }
                seen.push((label.0.clone(), mean, label.2.to_string()));
                if label.0 != "time" && usual[1] > usual[0] && (mean < usual[0] || mean > usual[1]) {
                    let word = if mean > usual[1] { "high" } else { "low" };
                    special.push(format!("{word} {} ({} {})", label.1, short(mean), label.2));
                }
            }
            let text =
                if special.is_empty() { "nothing unusual going on".into() } else { special.join(", ") };
            let from_s = replay.time_s(part[0].step);
            Segment {
                from_s,
                to_s: replay.time_s(part[part.len() - 1].step),
                force_rms_n: force.sqrt(),
                torque_rms_n_m: torque.map(f64::sqrt),
                in_sigmas: (score / if torque.is_some() { 2.0 } else { 1.0 }).sqrt(),
                context: seen,
                text,
            }
        })
        .collect()
}

/// Mean squares of the lengths of residual force and torque.
fn squares(part: &[residual::Sample]) -> (f64, Option<f64>) {
    let n = part.len().max(1) as f64;
    let force = part.iter().map(|s| vec3::dot(s.force_n, s.force_n)).sum::<f64>() / n;
    let torques: Vec<f64> = part.iter().filter_map(|s| s.torque_n_m.map(|t| vec3::dot(t, t))).collect();
    let torque = (!torques.is_empty()).then(|| torques.iter().sum::<f64>() / torques.len() as f64);
    (force, torque)
}
