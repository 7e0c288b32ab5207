//! Fly to a place that is drawn for each episode, and hover there.

use crate::goal::{Goal, Seen};
use propwash_physics::rigid_body::State;
use propwash_rollout::random::Stream;
use propwash_trace::Real;
use propwash_trace::math::vec3;

/// What the way to the place, velocities and angular velocities are multiplied by in observations, 1/m, s/m, s/rad.
pub const SCALES: [f64; 3] = [1.0, 0.5, 0.3];

/// Within this the cost grows with the square of the distance, beyond it with the distance itself, m.
const NEAR_M: f64 = 0.1;

/// Places to be reached. Episodes remember theirs: x, y, z in m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reach {
    /// Starts and places lie within ± this of (0, 0, 1.5) along each horizontal axis, and within ± 1 m in height, m.
    pub far_m: f64,
    /// Starts are up to this fast along each axis, m/s.
    pub speed_m_s: f64,
    /// Time of an episode, s.
    pub time_s: f64,
}

impl Default for Reach {
    /// Within ± 1.5 m, starts up to 1 m/s, 4 s.
    fn default() -> Self {
        Self { far_m: 1.5, speed_m_s: 1.0, time_s: 4.0 }
    }
}

impl Reach {
    fn place(&self, random: &mut Stream) -> [f64; 3] {
        let far = self.far_m;
        [random.uniform(-far, far), random.uniform(-far, far), random.uniform(0.5, 2.5)]
    }
}

impl Goal for Reach {
    fn observations(&self) -> usize {
        13
    }

    fn observe<S: Real>(&self, seen: &Seen<S>, out: &mut Vec<S>) {
        out.extend((0..3).map(|k| S::lit(SCALES[0]) * (seen.memory[k] - seen.pos_m[k])));
        out.extend(seen.vel_m_s.map(|v| S::lit(SCALES[1]) * v));
        out.extend(seen.quat_xyzw);
        out.extend(seen.ang_vel_rad_s.map(|v| S::lit(SCALES[2]) * v));
    }

    fn cost<S: Real>(&self, seen: &Seen<S>, action: &[S], before: &[S]) -> S {
        let way: [S; 3] = core::array::from_fn(|k| seen.memory[k] - seen.pos_m[k]);
        // Near the place as a square, far from it as a length: a far place must not count as much more than all that is near.
        let far = (vec3::dot(way, way) + S::lit(NEAR_M * NEAR_M)).sqrt() - S::lit(NEAR_M);
        let mut sum = S::lit(2.0) * far + S::lit(0.1) * vec3::dot(seen.vel_m_s, seen.vel_m_s);
        sum = sum + S::lit(0.005) * vec3::dot(seen.ang_vel_rad_s, seen.ang_vel_rad_s);
        for (a, b) in action.iter().zip(before) {
            sum = sum + S::lit(0.02) * (*a - *b).square();
        }
        sum
    }

    fn start(&self, random: &mut Stream, memory: &mut [f64]) -> (State<f64>, f64) {
        memory.copy_from_slice(&self.place(random));
        let state = State {
            pos: self.place(random),
            vel: core::array::from_fn(|_| random.uniform(-self.speed_m_s, self.speed_m_s)),
            ..State::rest()
        };
        (state, 0.0)
    }

    fn memory(&self) -> usize {
        3
    }

    fn episode_s(&self) -> f64 {
        self.time_s
    }

    fn off_m(&self, seen: &Seen<f64>) -> f64 {
        (0..3).map(|k| (seen.memory[k] - seen.pos_m[k]).powi(2)).sum::<f64>().sqrt()
    }

    fn reached(&self, seen: &Seen<f64>) -> bool {
        self.off_m(seen) < 0.05 && vec3::norm(seen.vel_m_s) < 0.1
    }

    fn far_off_m(&self) -> f64 {
        10.0
    }
}
