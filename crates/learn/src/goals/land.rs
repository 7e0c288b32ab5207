//! Touch down softly at a place of a given height.

use crate::goal::{Goal, Outcome, Seen};
use propwash_physics::rigid_body::State;
use propwash_rollout::random::Stream;
use propwash_trace::Real;
use propwash_trace::math::quat;

/// What the way to the place, velocities and angular velocities are multiplied by in observations, 1/m, s/m, s/rad.
pub const SCALES: [f64; 3] = [1.0, 1.0, 0.3];

/// A touch-down is soft where the drone comes down slower than the first and moves sideways slower than the second (m/s), leans less than the third (rad), and
/// is within the last of the place (m).
pub const SOFT: [f64; 4] = [0.3, 0.2, 0.174_533, 0.2];

/// A landing. Flights end where the drone's origin comes down to the height; nothing stands there, so it is the flight before the touch that counts. Episodes
/// remember whether it has touched down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Land {
    /// Height at which the drone's origin is when it stands there, m; the place is (0, 0, this).
    pub height_m: f64,
    /// Starts lie within ± this of the place along each horizontal axis, m.
    pub beside_m: f64,
    /// Starts are at least half of this above the place and up to one and a half of it, m.
    pub above_m: f64,
    /// Time of an episode, s.
    pub time_s: f64,
}

impl Default for Land {
    /// At height 0, from within 1 m beside and 0.5 to 1.5 m above, in 6 s.
    fn default() -> Self {
        Self { height_m: 0.0, beside_m: 1.0, above_m: 1.0, time_s: 6.0 }
    }
}

fn up<S: Real>(q: [S; 4]) -> S {
    quat::rotate(q, [S::zero(), S::zero(), S::one()])[2]
}

impl Land {
    /// How fast the drone should sink at a height above the place, m/s: 0.15 at the place, faster above, up to 0.6.
    fn sinking<S: Real>(&self, height_m: S) -> S {
        let faster = S::lit(0.15) + S::lit(0.8) * height_m.max(S::zero());
        faster.min(S::lit(0.6))
    }

    fn is_soft(&self, seen: &Seen<f64>) -> bool {
        let [sink, slide, lean, beside] = SOFT;
        seen.vel_m_s[2].abs() < sink
            && seen.vel_m_s[0].hypot(seen.vel_m_s[1]) < slide
            && up(seen.quat_xyzw) > lean.cos()
            && self.off_m(seen) < beside
    }
}

impl Goal for Land {
    fn observations(&self) -> usize {
        13
    }

    fn observe<S: Real>(&self, seen: &Seen<S>, out: &mut Vec<S>) {
        let place = [S::zero(), S::zero(), S::lit(self.height_m)];
        out.extend((0..3).map(|k| S::lit(SCALES[0]) * (place[k] - seen.pos_m[k])));
        out.extend(seen.vel_m_s.map(|v| S::lit(SCALES[1]) * v));
        out.extend(seen.quat_xyzw);
        out.extend(seen.ang_vel_rad_s.map(|v| S::lit(SCALES[2]) * v));
    }

    fn cost<S: Real>(&self, seen: &Seen<S>, action: &[S], before: &[S]) -> S {
        let [x, y, z] = seen.pos_m;
        let [vx, vy, vz] = seen.vel_m_s;
        let above = z - S::lit(self.height_m);
        // Near the ground what a soft touch-down asks for counts more than elsewhere.
        let near = S::one() + S::lit(4.0) * (-(above * S::lit(4.0)).max(S::zero())).exp();
        let beside = (x.square() + y.square() + S::lit(0.01)).sqrt() - S::lit(0.1);
        let mut sum = S::lit(2.0) * (vz + self.sinking(above)).square() + S::lit(2.0) * beside;
        sum = sum + near * (S::lit(0.5) * (vx.square() + vy.square()) + S::one() - up(seen.quat_xyzw));
        for v in seen.ang_vel_rad_s {
            sum = sum + S::lit(0.01) * v.square();
        }
        for (a, b) in action.iter().zip(before) {
            sum = sum + S::lit(0.02) * (*a - *b).square();
        }
        sum
    }

    fn start(&self, random: &mut Stream, _: &mut [f64]) -> (State<f64>, f64) {
        let beside = self.beside_m;
        let above = random.uniform(0.5, 1.5) * self.above_m;
        let pos = [random.uniform(-beside, beside), random.uniform(-beside, beside), self.height_m + above];
        let vel = core::array::from_fn(|_| random.uniform(-0.5, 0.5));
        (State { pos, vel, ..State::rest() }, 0.0)
    }

    fn memory(&self) -> usize {
        1
    }

    fn judge(&self, _: &Seen<f64>, after: &Seen<f64>, memory: &mut [f64]) -> Outcome {
        if after.pos_m[2] > self.height_m {
            return Outcome::On;
        }
        memory[0] = 1.0;
        if self.is_soft(after) { Outcome::Done } else { Outcome::Lost }
    }

    fn episode_s(&self) -> f64 {
        self.time_s
    }

    /// Beside the place, m.
    fn off_m(&self, seen: &Seen<f64>) -> f64 {
        seen.pos_m[0].hypot(seen.pos_m[1])
    }

    fn reached(&self, seen: &Seen<f64>) -> bool {
        seen.memory[0] > 0.0 && self.is_soft(seen)
    }

    fn far_off_m(&self) -> f64 {
        5.0
    }

    fn lost_cost(&self) -> f64 {
        20.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn soft_landings_are_done_and_hard_ones_lost() {
        let goal = Land { height_m: 0.5, ..Land::default() };
        let judged = |height: f64, change: &dyn Fn(&mut [f64])| {
            let mut state = [0.0, 0.0, height, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, -0.2, 0.0, 0.0, 0.0];
            change(&mut state);
            let (before, mut memory) = ([0.0], [0.0]);
            let seen = Seen::of(&state, 1.0, &before);
            let outcome = goal.judge(&seen, &seen, &mut memory);
            assert_eq!(outcome == Outcome::On, memory[0] == 0.0);
            (outcome, goal.reached(&Seen::of(&state, 1.0, &memory)))
        };
        assert_eq!(judged(0.51, &|_| {}), (Outcome::On, false));
        assert_eq!(judged(0.499, &|_| {}), (Outcome::Done, true));
        for (number, value) in [(9, -0.31), (7, 0.21), (8, -0.21), (0, 0.21)] {
            assert_eq!(judged(0.499, &|state| state[number] = value), (Outcome::Lost, false), "{number}");
        }
        let leaning = quat::exp([0.18, 0.0, 0.0]);
        assert_eq!(judged(0.499, &|state| state[3..7].copy_from_slice(&leaning)).0, Outcome::Lost);
    }
}
