//! Recover from a throw: whatever attitude, velocity and spin it begins with, come to rest, level, near where it was thrown.

use crate::goal::{Goal, Seen};
use propwash_physics::rigid_body::State;
use propwash_rollout::random::Stream;
use propwash_trace::Real;
use propwash_trace::math::quat;

/// What positions, velocities and angular velocities are multiplied by in observations, 1/m, s/m, s/rad.
pub const SCALES: [f64; 3] = [0.5, 0.5, 0.15];

/// A throw.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Recover {
    /// Throws are up to this fast in any direction, m/s.
    pub speed_m_s: f64,
    /// They spin by up to this about each axis, rad/s.
    pub spin_rad_s: f64,
    /// They lean by up to this about any axis, rad; π is any attitude.
    pub lean_rad: f64,
    /// Time until the drone should be at rest, s.
    pub time_s: f64,
}

impl Default for Recover {
    /// Up to 4 m/s and 8 rad/s, leaning by up to 90°; 2.5 s.
    fn default() -> Self {
        Self { speed_m_s: 4.0, spin_rad_s: 8.0, lean_rad: std::f64::consts::FRAC_PI_2, time_s: 2.5 }
    }
}

/// A vector of a random direction, up to this long.
fn within(random: &mut Stream, most: f64) -> [f64; 3] {
    let v: [f64; 3] = core::array::from_fn(|_| random.normal());
    let length = v.iter().map(|v| v * v).sum::<f64>().sqrt().max(1e-9);
    let wanted = random.uniform(0.0, most);
    v.map(|v| v * wanted / length)
}

/// How far the body's z axis points up, −1 to 1.
fn up<S: Real>(q: [S; 4]) -> S {
    quat::rotate(q, [S::zero(), S::zero(), S::one()])[2]
}

impl Goal for Recover {
    fn observations(&self) -> usize {
        13
    }

    fn observe<S: Real>(&self, seen: &Seen<S>, out: &mut Vec<S>) {
        out.extend(seen.pos_m.map(|v| S::lit(SCALES[0]) * v));
        out.extend(seen.quat_xyzw);
        out.extend(seen.vel_m_s.map(|v| S::lit(SCALES[1]) * v));
        out.extend(seen.ang_vel_rad_s.map(|v| S::lit(SCALES[2]) * v));
    }

    fn cost<S: Real>(&self, seen: &Seen<S>, action: &[S], before: &[S]) -> S {
        let mut sum = S::lit(1.0) * (S::one() - up(seen.quat_xyzw));
        for k in 0..3 {
            sum = sum + S::lit(0.3) * seen.pos_m[k].square() + S::lit(0.5) * seen.vel_m_s[k].square();
            sum = sum + S::lit(0.01) * seen.ang_vel_rad_s[k].square();
        }
        for (a, b) in action.iter().zip(before) {
            sum = sum + S::lit(0.02) * (*a - *b).square();
        }
        sum
    }

    fn start(&self, random: &mut Stream, _: &mut [f64]) -> (State<f64>, f64) {
        let state = State {
            quat: quat::exp(within(random, self.lean_rad)),
            vel: within(random, self.speed_m_s),
            ang_vel: core::array::from_fn(|_| random.uniform(-self.spin_rad_s, self.spin_rad_s)),
            ..State::rest()
        };
        (state, 0.0)
    }

    fn episode_s(&self) -> f64 {
        self.time_s
    }

    fn off_m(&self, seen: &Seen<f64>) -> f64 {
        seen.pos_m.iter().map(|v| v * v).sum::<f64>().sqrt()
    }

    fn reached(&self, seen: &Seen<f64>) -> bool {
        let size = |v: [f64; 3]| v.iter().map(|v| v * v).sum::<f64>().sqrt();
        let level = up(seen.quat_xyzw) > 15f64.to_radians().cos();
        level && size(seen.vel_m_s) < 0.3 && size(seen.ang_vel_rad_s) < 1.0
    }

    fn far_off_m(&self) -> f64 {
        10.0
    }
}
