//! Residual force and torque: statistics and time series.

use super::{Axes, OneStep, Series};
use crate::causes::short;
use crate::replay::STEP_S;
use crate::residual::{self, Replay, Residuals};
use propwash_trace::math::{quat, vec3};

/// Interval between points of a series, s.
const SERIES_S: f64 = 0.05;

fn axes(residual: &[[f64; 3]], measured: &[[f64; 3]], sigma: [f64; 3]) -> Axes {
    let n = residual.len().max(1) as f64;
    let mean = |list: &[[f64; 3]], k: usize| list.iter().map(|v| v[k]).sum::<f64>() / n;
    let square = |list: &[[f64; 3]], k: usize, about: f64| {
        list.iter().map(|v| (v[k] - about).powi(2)).sum::<f64>() / n
    };
    let rms: [f64; 3] = std::array::from_fn(|k| square(residual, k, 0.0).sqrt());
    Axes {
        rms,
        mean: std::array::from_fn(|k| mean(residual, k)),
        sigma,
        in_sigmas: std::array::from_fn(|k| if sigma[k] > 0.0 { rms[k] / sigma[k] } else { 0.0 }),
        explained: std::array::from_fn(|k| {
            let all = square(measured, k, mean(measured, k));
            (all > (2.0 * sigma[k]).powi(2)).then(|| 1.0 - square(residual, k, mean(residual, k)) / all)
        }),
    }
}

pub(super) fn one_step(replay: &Replay, residuals: &Residuals) -> OneStep {
    let list = &residuals.samples;
    let forces: Vec<[f64; 3]> = list.iter().map(|s| s.force_n).collect();
    let measured: Vec<[f64; 3]> = list.iter().map(|s| s.measured_force_n).collect();
    let torques: Vec<[f64; 3]> = list.iter().filter_map(|s| s.torque_n_m).collect();
    let torques_read: Vec<[f64; 3]> = list.iter().filter_map(|s| s.measured_torque_n_m).collect();
    let mut series = Series::default();
    let per = (SERIES_S / STEP_S).round() as usize;
    let mut from = 0;
    while from < list.len() {
        // Blocks lie on a fixed grid, so that two comparisons of a log share their times.
        let number = list[from].step / per;
        let to = from + list[from..].partition_point(|s| s.step / per == number);
        let part = &list[from..to];
        from = to;
        let n = part.len() as f64;
        let mean = |f: &dyn Fn(&residual::Sample) -> [f64; 3]| -> [f64; 3] {
            let sum = part.iter().fold([0.0; 3], |sum, s| vec3::add(sum, f(s)));
            vec3::scale(sum, 1.0 / n)
        };
        series.t_s.push(part.iter().map(|s| replay.time_s(s.step)).sum::<f64>() / n);
        series.force_body_n.push(mean(&|s| s.force_n));
        series.force_world_n.push(mean(&|s| quat::rotate(s.quat, s.force_n)));
        if !torques.is_empty() {
            let all = part.iter().all(|s| s.torque_n_m.is_some());
            series.torque_n_m.push(all.then(|| mean(&|s| s.torque_n_m.unwrap_or_default())));
        }
    }
    // Averaging reduces the noise only as far as it is uncorrelated within a block.
    let averaged = |memory_s: f64| (memory_s / SERIES_S).min(1.0).sqrt();
    series.force_sigma_n = residuals.force_sigma_n.map(|s| s * averaged(residuals.force_memory_s));
    series.torque_sigma_n_m = residuals.torque_sigma_n_m.map(|s| s * averaged(residuals.torque_memory_s));
    let mass = replay.plant().parts.body.mass_kg;
    let sigma = residuals.force_sigma_n.iter().fold(0.0, |a: f64, b| a.max(*b));
    let force = if residuals.from_accelerometer {
        format!("forces from the accelerometer, smoothed over ±{:.0} ms", 1e3 * residuals.force_half_s)
    } else {
        format!(
            "no accelerometer: forces from the second derivative of positions over ±{:.0} ms, in which nothing faster \
             is seen",
            1e3 * residuals.force_half_s
        )
    };
    let torque = match (torques.is_empty(), residuals.from_gyroscope) {
        (true, _) => "no torques: the attitude is an input".to_string(),
        (false, true) => format!("torques from the gyroscope over ±{:.0} ms", 1e3 * residuals.torque_half_s),
        (false, false) => format!(
            "no gyroscope: torques from the second derivative of attitudes over ±{:.0} ms",
            1e3 * residuals.torque_half_s
        ),
    };
    OneStep {
        n: list.len(),
        force_from: if residuals.from_accelerometer { "accelerometer" } else { "poses" },
        torque_from: if residuals.from_gyroscope { "gyroscope" } else { "attitudes" },
        certainty: format!(
            "{force}; one standard deviation by noise {} N ({} m/s²); {torque}",
            short(sigma),
            short(sigma / mass)
        ),
        force: axes(&forces, &measured, residuals.force_sigma_n),
        torque: (!torques.is_empty()).then(|| axes(&torques, &torques_read, residuals.torque_sigma_n_m)),
        series,
    }
}
