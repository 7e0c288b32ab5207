//! Residuals of all logs together.

use super::{Axes, HORIZONS_S, LogComparison, Part, Pooled, cause_list, sentences};
use crate::causes::{Block, Label};
use crate::verdict::HorizonError;

pub(super) fn pool(parts: &[Part]) -> Pooled {
    let root = |pick: fn(&LogComparison) -> Option<&Axes>| -> Option<[f64; 3]> {
        let (mut sum, mut n) = ([0.0; 3], 0.0);
        for (axes, count) in parts.iter().filter_map(|(log, ..)| Some((pick(log)?, log.one_step.n as f64))) {
            (0..3).for_each(|k| sum[k] += axes.rms[k] * axes.rms[k] * count);
            n += count;
        }
        (n > 0.0).then(|| sum.map(|s| (s / n).sqrt()))
    };
    let horizons = (0..HORIZONS_S.len())
        .map(|i| {
            let list = parts.iter().map(|(log, ..)| &log.horizons[i].error);
            let n: usize = list.clone().map(|e| e.n).sum();
            let pooled = |f: &dyn Fn(&HorizonError) -> f64| {
                let sum: f64 = list.clone().map(|e| f(e).powi(2) * e.n as f64).sum();
                (sum / n.max(1) as f64).sqrt()
            };
            HorizonError {
                horizon_s: HORIZONS_S[i],
                position_m: pooled(&|e| e.position_m),
                velocity_m_s: pooled(&|e| e.velocity_m_s),
                attitude_rad: pooled(&|e| e.attitude_rad),
                rate_rad_s: pooled(&|e| e.rate_rad_s),
                n,
            }
        })
        .collect();
    // Causes of any log, in the order of their first appearance.
    let mut labels: Vec<Label> = Vec::new();
    for label in parts.iter().flat_map(|(_, _, own)| own) {
        if !labels.contains(label) {
            labels.push(label.clone());
        }
    }
    let mut blocks = Vec::new();
    let mut offset = 0;
    for (_, list, own) in parts {
        for b in list {
            let value = |l: &Label| own.iter().position(|o| o == l).map_or(f64::NAN, |i| b.causes[i]);
            blocks.push(Block {
                number: offset + b.number,
                causes: labels.iter().map(value).collect(),
                ..b.clone()
            });
        }
        offset += list.last().map_or(0, |b| b.number) + 2;
    }
    let causes = cause_list(&blocks, &labels, true);
    Pooled {
        force_rms_n: root(|l| Some(&l.one_step.force)).unwrap_or_default(),
        torque_rms_n_m: root(|l| l.one_step.torque.as_ref()),
        horizons,
        findings: sentences(&causes),
        causes,
    }
}
