//! Slow errors of poses, from the inertial data of the same log, without a model of the vehicle.
//!
//! An estimator's output is smooth: neighbouring samples differ by micrometres where the whole path is off by millimetres.
//! Over 0.25 s such an error bends the path as a force would. The accelerometer does not see it, nor does the gyroscope see
//! an error of the attitudes. So the second difference of poses is regressed on the inertial readings, with scale, skew,
//! offset, lateness and lever arm within typical sensor errors (nuisance parameters, by least squares); the residual is an
//! error of one of the two. Poses are assigned equivalent white noise: noise that leaves the same uncertainty of a force
//! that is constant over 0.25 s.
//!
//! The lean of an estimator that takes manoeuvres for gravity appears in the same difference, times 9.81 m/s².

use super::policy::CROSS_CHECK_S;
use super::replay::{Around, STEP, STEP_S};
use super::residual::StateNoise;
use super::sensor_regression::{Nuisances, Regression, bend_of, half_stretch, turned_more, widths};
use super::track::{Measured, Track};
use propwash_trace::math::{quat, vec3};

/// Scale and skew (9), offset (3), lateness; for positions also the lever arm (3).
const FORCE_UNKNOWNS: usize = 16;
const TORQUE_UNKNOWNS: usize = 13;

/// White noise of position (m) and attitude (rad) equivalent over [`CROSS_CHECK_S`] to the slow errors; `None` without
/// inertial data.
pub(crate) fn slow_errors(track: &Track, around: &Around, gravity_m_s2: [f64; 3]) -> [Option<f64>; 2] {
    let apart = half_stretch();
    let n = around.measured.len();
    let known = |i: usize| around.measured[i].as_ref();
    let at: Vec<f64> = (0..n).map(|i| around.time_s(i * STEP)).collect();
    let felt = track.felt(&at);
    let (mut force, mut torque) = (Regression::new(FORCE_UNKNOWNS), Regression::new(TORQUE_UNKNOWNS));
    // Half-overlapping spans: neighbours share a point, but are cheap.
    for from in (0..n.saturating_sub(2 * apart)).step_by(apart / 2) {
        let span: Option<Vec<&Measured>> = (from..=from + 2 * apart).map(known).collect();
        let Some(span) = span else { continue };
        if let Some(felt) = felt[from..=from + 2 * apart].iter().copied().collect::<Option<Vec<_>>>() {
            let bend = bend_of(&span, &felt, apart, gravity_m_s2);
            force.add(bend.columns, bend.more);
        }
        if !track.gyro.is_empty() {
            let (columns, turn) = turn_of(&span, apart);
            torque.add(columns, turn);
        }
    }
    let noise = StateNoise::of(track);
    let half_s = apart as f64 * STEP_S;
    // White noise of three poses gives √6 of itself in a second difference.
    let white = |sigma: f64| 6f64.sqrt() * sigma / (half_s * half_s);
    let equivalent = |left: f64, white: f64, period_s: f64| {
        let slow = (left * left - white * white).max(0.0).sqrt();
        // Second derivative from n samples over T with white noise σ: σ √(720/n) / T².
        let samples = CROSS_CHECK_S / period_s;
        slow * CROSS_CHECK_S.powi(2) * (samples / 720.0).sqrt()
    };
    let left = |of: &Regression, n: usize| {
        let all: Vec<usize> = (0..n).collect();
        Some(of.fit(&all, &widths()[..n])?.left)
    };
    let period = |p: Option<f64>| p.unwrap_or(0.01);
    [
        left(&force, FORCE_UNKNOWNS)
            .map(|l| equivalent(l, white(noise.pos_m), period(track.position.period_s()))),
        left(&torque, TORQUE_UNKNOWNS)
            .map(|l| equivalent(l, white(noise.att_rad), period(track.attitude.period_s()))),
    ]
}

/// Rotation of attitudes beyond the gyroscope's, rad/s², and its derivatives by the gyroscope's error parameters.
fn turn_of(span: &[&Measured], apart: usize) -> (Vec<[f64; 3]>, [f64; 3]) {
    let time = apart as f64 * STEP_S;
    let half = |from: usize| {
        let end = span[from + apart].quat;
        let mut nuisances = Nuisances::none();
        for pair in span[from..=from + apart].windows(2) {
            let rate = vec3::scale(vec3::add(pair[0].ang_vel, pair[1].ang_vel), 0.5);
            let slope = vec3::scale(vec3::sub(pair[1].ang_vel, pair[0].ang_vel), 1.0 / STEP_S);
            let frame = quat::mul(quat::conjugate(end), pair[1].quat);
            nuisances.add(frame, rate, slope, STEP_S / (time * time));
        }
        let more = turned_more(&span[from..=from + apart]);
        (nuisances.0, vec3::scale(more, 1.0 / (time * time)))
    };
    let (before, after) = (half(0), half(apart));
    let columns = before.0.into_iter().zip(after.0).map(|(a, b)| vec3::sub(b, a)).collect();
    (columns, vec3::sub(after.1, before.1))
}
