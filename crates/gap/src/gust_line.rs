//! Frequency of a gust: the strongest line in the spectrum of the windows' disturbances.

use super::disturbance::Disturbance;
use super::fit::{Linear, Prepared};
use super::policy::GUST_BESIDE_MOTION;
use super::track::Drive;
use nalgebra::DMatrix;
use propwash_flight::clean;

/// Frequency (Hz) of the largest oscillation in the windows' disturbances, all three axes together: the highest peak of the
/// least-squares spectrum (Lomb, Astrophysics and Space Science 39, 1976) between two periods per log and 3 Hz. `None`
/// where no peak stands out.
pub(super) fn loudest_hz(logs: &[Prepared], linear: &Linear, disturbance: &Disturbance) -> Option<f64> {
    let nothing = vec![0.0; linear.at.len()];
    let mut samples: Vec<(f64, [f64; 3])> = Vec::new();
    for w in linear.windows.iter().filter(|w| w.log == 0) {
        let (mean, _) = w.push_estimate(disturbance, &nothing)?;
        samples.push((logs[0].around.time_s(w.from) + 0.5 * linear.horizon_s, [mean[0], mean[1], mean[2]]));
    }
    let own: Vec<(f64, [f64; 3])> = linear
        .windows
        .iter()
        .filter(|w| w.log == 0)
        .zip(&samples)
        .map(|(w, (t, _))| (*t, w.start.vel))
        .collect();
    let (first, last) = (samples.first()?.0, samples.last()?.0);
    let length = last - first;
    if samples.len() < 40 || length < 4.0 {
        return None;
    }
    let step = 0.2 / length;
    let power_of = |samples: &[(f64, [f64; 3])], hz: f64| -> f64 {
        let turn = 2.0 * core::f64::consts::PI * hz;
        let (mut cc, mut ss, mut cs) = (0.0, 0.0, 0.0);
        let mut y = [[0.0; 2]; 3];
        for (t, a) in samples {
            let (s, c) = (turn * t).sin_cos();
            cc += c * c;
            ss += s * s;
            cs += c * s;
            for k in 0..3 {
                y[k][0] += c * a[k];
                y[k][1] += s * a[k];
            }
        }
        let det = cc * ss - cs * cs;
        y.iter().map(|[c, s]| (ss * c * c - 2.0 * cs * c * s + cc * s * s) / det).sum()
    };
    let power = |hz: f64| power_of(&samples, hz);
    let n = ((3.0 - 2.0 / length) / step) as usize;
    let spectrum: Vec<(f64, f64)> =
        (0..n).map(|i| 2.0 / length + i as f64 * step).map(|hz| (hz, power(hz))).collect();
    let (hz, peak) = *spectrum.iter().max_by(|a, b| a.1.total_cmp(&b.1))?;
    let usual = clean::median(spectrum.iter().map(|s| s.1).collect())?;
    // At a frequency of the vehicle's own motion, any model error appears as a line too.
    let moves: Vec<f64> = spectrum.iter().map(|s| power_of(&own, s.0)).collect();
    // Where the path itself is periodic, so are its errors: most of them, and the line, correlate with velocity and
    // acceleration. Only a log without torques needs this test: elsewhere motion and disturbance are separable.
    let doubtful = logs[0].track.drive == Drive::Thrust;
    let repeats = doubtful
        && power_of(&own, hz) > 8.0 * clean::median(moves)?
        && power_of(&beside_motion(&samples, &own)?, hz) < GUST_BESIDE_MOTION * peak;
    (peak > 8.0 * usual && !repeats).then_some(hz)
}

/// Samples with their regression on velocity and acceleration subtracted, by least squares in each component.
fn beside_motion(samples: &[(f64, [f64; 3])], own: &[(f64, [f64; 3])]) -> Option<Vec<(f64, [f64; 3])>> {
    let n = samples.len();
    let slope = |i: usize, k: usize| {
        let (a, b) = (i.saturating_sub(1), (i + 1).min(n - 1));
        (own[b].1[k] - own[a].1[k]) / (own[b].0 - own[a].0).max(1e-6)
    };
    let row = |i: usize, c: usize| match c {
        0 => 1.0,
        1..=3 => own[i].1[c - 1],
        _ => slope(i, c - 4),
    };
    let motion = DMatrix::from_fn(n, 7, row);
    let forces = DMatrix::from_fn(n, 3, |i, k| samples[i].1[k]);
    let coefficients = (motion.transpose() * &motion).cholesky()?.solve(&(motion.transpose() * &forces));
    let left = forces - motion * coefficients;
    Some((0..n).map(|i| (samples[i].0, [left[(i, 0)], left[(i, 1)], left[(i, 2)]])).collect())
}
