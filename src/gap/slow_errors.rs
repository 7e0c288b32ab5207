//! Slow errors of poses, by the inertial data of the same log: no model of the vehicle is asked.
//!
//! What an estimator gives is smooth: neighbouring samples differ by micrometres where the whole path is off by millimetres. Over
//! 0.25 s such an error bends the path as a force would. The accelerometer knows nothing of it, nor the gyroscope of an error
//! of attitudes. So the second difference of poses is fitted by what the inertial unit feels, each with its free scale, skew,
//! offset, lateness and lever arm (nuisance parameters, by least squares), and what stays is an error of one of the two. As large
//! as it is, so much white noise of the poses is assumed: both then say as little about a force that stays over 0.25 s.
//!
//! The lean that an estimator gets by taking manoeuvres for gravity is seen in the same difference, times 9.81 m/s².

use super::policy::CROSS_CHECK_S;
use super::replay::{Around, STEP, STEP_S};
use super::residual::StateNoise;
use super::track::{Measured, Track};
use crate::flight::resample::rotation_vector;
use crate::math::{quat, vec3};
use nalgebra::{Cholesky, DMatrix, DVector};

/// Nuisance parameters: scale and skew (9), offset (3), lateness, lever arm (3, of positions only).
const FORCE_UNKNOWNS: usize = 16;
const TORQUE_UNKNOWNS: usize = 13;
/// Fewest instants per nuisance parameter.
const PER_UNKNOWN: usize = 5;

/// White noise of position (m) and attitude (rad) that says as little over [`CROSS_CHECK_S`] as the slow errors do; `None`
/// where no inertial data tell.
pub(crate) fn slow_errors(track: &Track, around: &Around, gravity_m_s2: [f64; 3]) -> [Option<f64>; 2] {
    let apart = (0.5 * CROSS_CHECK_S / STEP_S).round() as usize;
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
            force.of_force(&span, &felt, apart, gravity_m_s2);
        }
        if !track.gyro.is_empty() {
            torque.of_torque(&span, apart);
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
    let period = |p: Option<f64>| p.unwrap_or(0.01);
    [
        force.left().map(|l| equivalent(l, white(noise.pos_m), period(track.position.period_s()))),
        torque.left().map(|l| equivalent(l, white(noise.att_rad), period(track.attitude.period_s()))),
    ]
}

/// Normal equations of a regression whose rows are three axes of an instant.
struct Regression {
    gram: DMatrix<f64>,
    rows: usize,
}

/// What every nuisance parameter of a sensor adds to what it says of a stretch.
struct Nuisances([[f64; 3]; 13]);

impl Nuisances {
    fn none() -> Self {
        Self([[0.0; 3]; 13])
    }

    /// An instant of the stretch: the frame of the sensor in that of the sum, its reading and how that changes.
    fn add(&mut self, frame: [f64; 4], reading: [f64; 3], slope: [f64; 3], weight: f64) {
        let axes: [[f64; 3]; 3] = core::array::from_fn(|k| {
            quat::rotate(frame, core::array::from_fn(|i| f64::from(u8::from(i == k))))
        });
        for (k, axis) in axes.into_iter().enumerate() {
            for (j, r) in reading.into_iter().enumerate() {
                let entry = &mut self.0[3 * k + j];
                *entry = vec3::add(*entry, vec3::scale(axis, weight * r));
            }
            self.0[9 + k] = vec3::add(self.0[9 + k], vec3::scale(axis, weight));
        }
        self.0[12] = vec3::add(self.0[12], vec3::scale(quat::rotate(frame, slope), weight));
    }
}

impl Regression {
    fn new(unknowns: usize) -> Self {
        Self { gram: DMatrix::zeros(unknowns + 1, unknowns + 1), rows: 0 }
    }

    /// What nuisance parameters explain, and what they are to explain.
    fn add(&mut self, nuisances: impl IntoIterator<Item = [f64; 3]>, target: [f64; 3]) {
        let columns: Vec<[f64; 3]> = nuisances.into_iter().chain([target]).collect();
        for axis in 0..3 {
            let row = DVector::from_iterator(columns.len(), columns.iter().map(|c| c[axis]));
            self.gram.ger(1.0, &row, &row, 1.0);
            self.rows += 1;
        }
    }

    fn of_force(&mut self, span: &[&Measured], felt: &[[f64; 3]], apart: usize, gravity: [f64; 3]) {
        let time = apart as f64 * STEP_S;
        let [a, b, c] = [0, apart, 2 * apart].map(|i| span[i]);
        let bend: [f64; 3] =
            core::array::from_fn(|k| (a.pos[k] - 2.0 * b.pos[k] + c.pos[k]) / (time * time) - gravity[k]);
        let mut nuisances = Nuisances::none();
        // A second difference is the mean of the acceleration under a hat.
        for i in 1..2 * apart {
            let weight = (apart - i.abs_diff(apart)) as f64 / (apart * apart) as f64;
            let frame = quat::mul(quat::conjugate(b.quat), span[i].quat);
            let slope = vec3::scale(vec3::sub(felt[i + 1], felt[i - 1]), 0.5 / STEP_S);
            nuisances.add(frame, felt[i], slope, weight);
        }
        // A point away from where the accelerometer sits bends its path by itself.
        let body = |v: [f64; 3]| quat::rotate_inverse(b.quat, v);
        let arm = (0..3).map(|k| {
            let mut unit = [0.0; 3];
            unit[k] = 1.0;
            let at = |m: &Measured| quat::rotate(m.quat, unit);
            let bend = vec3::add(vec3::sub(at(a), vec3::scale(at(b), 2.0)), at(c));
            body(vec3::scale(bend, 1.0 / (time * time)))
        });
        self.add(nuisances.0.into_iter().chain(arm), body(bend));
    }

    /// What attitudes turn more than the gyroscope says.
    fn of_torque(&mut self, span: &[&Measured], apart: usize) {
        let time = apart as f64 * STEP_S;
        let half = |from: usize| {
            let end = span[from + apart].quat;
            let (mut nuisances, mut turned) = (Nuisances::none(), [0.0, 0.0, 0.0, 1.0]);
            for pair in span[from..=from + apart].windows(2) {
                let rate = vec3::scale(vec3::add(pair[0].ang_vel, pair[1].ang_vel), 0.5);
                let slope = vec3::scale(vec3::sub(pair[1].ang_vel, pair[0].ang_vel), 1.0 / STEP_S);
                let frame = quat::mul(quat::conjugate(end), pair[1].quat);
                nuisances.add(frame, rate, slope, STEP_S / (time * time));
                turned = quat::mul(turned, quat::exp(vec3::scale(rate, STEP_S)));
            }
            let measured = quat::mul(quat::conjugate(span[from].quat), end);
            let more = rotation_vector(quat::mul(quat::conjugate(turned), measured));
            (nuisances.0, vec3::scale(more, 1.0 / (time * time)))
        };
        let (before, after) = (half(0), half(apart));
        self.add(
            before.0.into_iter().zip(after.0).map(|(a, b)| vec3::sub(b, a)),
            vec3::sub(after.1, before.1),
        );
    }

    /// Root mean square of what stays; `None` of too few rows.
    fn left(mut self) -> Option<f64> {
        let n = self.gram.nrows() - 1;
        if self.rows < 3 * PER_UNKNOWN * n {
            return None;
        }
        // A nuisance that the flight does not excite is held where it is.
        let ridge = 1e-9 * self.gram.view((0, 0), (n, n)).trace().max(1e-12);
        for k in 0..n {
            self.gram[(k, k)] += ridge;
        }
        let across = self.gram.view((0, n), (n, 1)).column(0).into_owned();
        let factor = Cholesky::new(self.gram.view((0, 0), (n, n)).into_owned())?;
        let left = self.gram[(n, n)] - across.dot(&factor.solve(&across));
        Some((left.max(0.0) / (self.rows - n) as f64).sqrt())
    }
}
