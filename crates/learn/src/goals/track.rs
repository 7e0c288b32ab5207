//! Follow a figure of eight: the one of Crazyflow 0.4.0, `envs/figure_8_env.py`, in continuous time.

use crate::goal::{Goal, Seen};
use propwash_physics::rigid_body::State;
use propwash_rollout::random::Stream;
use propwash_trace::Real;
use std::f64::consts::PI;

/// What points ahead, velocities and angular velocities are multiplied by in observations, 1/m, s/m, s/rad.
pub const SCALES: [f64; 3] = [2.0, 1.0, 0.3];

/// An upright eight, x = sin φ, z = 1 + ½ sin 2φ (m), once in `period_s`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Track {
    /// Time for all of it, s.
    pub period_s: f64,
    /// Points ahead that are observed, and the time between them, s.
    pub points: usize,
    /// Time between points, s.
    pub every_s: f64,
}

impl Default for Track {
    fn default() -> Self {
        Self { period_s: 10.0, points: 10, every_s: 0.1 }
    }
}

impl Track {
    /// Where the flight should be, m.
    pub fn at<S: Real>(&self, time_s: S) -> [S; 3] {
        let turn = time_s * S::lit(2.0 * PI / self.period_s);
        let (sin, cos) = turn.sin_cos();
        [sin, S::zero(), S::one() + sin * cos]
    }

    /// How fast, m/s.
    pub fn velocity<S: Real>(&self, time_s: S) -> [S; 3] {
        let rate = S::lit(2.0 * PI / self.period_s);
        let (sin, cos) = (time_s * rate).sin_cos();
        [rate * cos, S::zero(), rate * (cos * cos - sin * sin)]
    }
}

impl Goal for Track {
    fn observations(&self) -> usize {
        3 * self.points + 10
    }

    fn observe<S: Real>(&self, seen: &Seen<S>, out: &mut Vec<S>) {
        for k in 0..self.points {
            let ahead = self.at(seen.time_s + S::lit(k as f64 * self.every_s));
            out.extend((0..3).map(|i| S::lit(SCALES[0]) * (ahead[i] - seen.pos_m[i])));
        }
        out.extend(seen.vel_m_s.map(|v| S::lit(SCALES[1]) * v));
        out.extend(seen.quat_xyzw);
        out.extend(seen.ang_vel_rad_s.map(|v| S::lit(SCALES[2]) * v));
    }

    fn cost<S: Real>(&self, seen: &Seen<S>, action: &[S], before: &[S]) -> S {
        let (point, velocity) = (self.at(seen.time_s), self.velocity(seen.time_s));
        let mut sum = S::zero();
        for k in 0..3 {
            sum = sum + S::lit(20.0) * (seen.pos_m[k] - point[k]).square();
            sum = sum + S::lit(0.5) * (seen.vel_m_s[k] - velocity[k]).square();
            sum = sum + S::lit(0.002) * seen.ang_vel_rad_s[k].square();
        }
        for (a, b) in action.iter().zip(before) {
            sum = sum + S::lit(0.01) * (*a - *b).square();
        }
        sum
    }

    fn start(&self, random: &mut Stream, _: &mut [f64]) -> (State<f64>, f64) {
        let time_s = random.uniform(0.0, self.period_s);
        let (point, velocity) = (self.at(time_s), self.velocity(time_s));
        let state = State {
            pos: point.map(|v| v + random.uniform(-0.1, 0.1)),
            vel: velocity.map(|v| v + random.uniform(-0.2, 0.2)),
            ..State::rest()
        };
        (state, time_s)
    }

    fn episode_s(&self) -> f64 {
        self.period_s
    }

    fn off_m(&self, seen: &Seen<f64>) -> f64 {
        let point = self.at(seen.time_s);
        (0..3).map(|k| (seen.pos_m[k] - point[k]).powi(2)).sum::<f64>().sqrt()
    }

    fn reached(&self, seen: &Seen<f64>) -> bool {
        self.off_m(seen) < 0.1
    }

    fn far_off_m(&self) -> f64 {
        1.0
    }
}
