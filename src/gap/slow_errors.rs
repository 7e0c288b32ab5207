//! Slow errors of poses, by the inertial data of the same log: no model of the vehicle is asked.
//!
//! What an estimator gives is smooth: neighbouring samples differ by micrometres where the whole path is off by millimetres. Over
//! 0.25 s such an error bends the path as a force would. The accelerometer knows nothing of it, nor the gyroscope of an error
//! of attitudes. So the second difference of poses is fitted by what the inertial unit feels, each with scale, skew,
//! offset, lateness and lever arm within what sensors have (nuisance parameters, by least squares), and what stays is an error of one of the two. As large
//! as it is, so much white noise of the poses is assumed: both then say as little about a force that stays over 0.25 s.
//!
//! The lean that an estimator gets by taking manoeuvres for gravity is seen in the same difference, times 9.81 m/s².

use super::policy::CROSS_CHECK_S;
use super::replay::{Around, STEP, STEP_S};
use super::residual::StateNoise;
use super::sensor_regression::{Nuisances, Regression, bend_of, half_stretch, turned_more, widths};
use super::track::{Measured, Track};
use crate::math::{quat, vec3};

/// Scale and skew (9), offset (3), lateness; of positions the lever arm (3) too.
const FORCE_UNKNOWNS: usize = 16;
const TORQUE_UNKNOWNS: usize = 13;

/// White noise of position (m) and attitude (rad) that says as little over [`CROSS_CHECK_S`] as the slow errors do; `None`
/// where no inertial data tell.
pub(crate) fn slow_errors(track: &Track, around: &Around, gravity_m_s2: [f64; 3]) -> [Option<f64>; 2] {
    let apart = half_stretch();
    let n = around.measured.len();
    let known = |i: usize| around.measured[i].as_ref();
    let at: Vec<f64> = (0..n).map(|i| around.time_s(i * STEP)).collect();
    let felt = track.felt(&at);
    let (mut force, mut torque) = (Regression::new(FORCE_UNKNOWNS), Regression::new(TORQUE_UNKNOWNS));
    // Every second instant between two hats: neighbours share a point, and are cheap.
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
    // White noise of three poses makes √6 of itself in a second difference.
    let white = |sigma: f64| 6f64.sqrt() * sigma / (half_s * half_s);
    let equivalent = |left: f64, white: f64, period_s: f64| {
        let slow = (left * left - white * white).max(0.0).sqrt();
        // Slope of a slope by n samples over T with white noise σ: σ √(720/n) / T².
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

/// What attitudes turn more than the gyroscope says, rad/s², and what the gyroscope's numbers add to it.
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
