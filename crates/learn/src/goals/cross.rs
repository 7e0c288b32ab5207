//! Cross a place full of things, seeing by a depth camera: to a target on its other side, touching nothing.

use crate::goal::Seen;
use crate::sighted::{Around, Other, SightedGoal};
use propwash_trace::Real;
use propwash_trace::math::quat;

/// What the distance to the target (1/m), velocities (s/m) and heights (1/m, m) are multiplied by in observations, and the height of zero.
pub const SCALES: [f64; 4] = [0.1, 0.5, 1.0, 1.2];

/// Directions of targets nearer than this fade away, m.
pub const LEAST_M: f64 = 0.1;

/// A crossing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cross {
    /// Speed that is wanted, m/s.
    pub speed_m_s: f64,
    /// Nearer to things than this costs more and more, m.
    pub keep_m: f64,
    /// Higher than this costs more and more, m.
    pub ceiling_m: f64,
    /// The target is reached within this distance, m.
    pub arrive_m: f64,
    /// How near the middle of the drone may come to things, m.
    pub touch_m: f64,
    /// Flies the shortest way around things that keeps so far from them, m; zero: straight to the target, off things as they come. Walls with doors need it. Only
    /// costs know that way, the policy finds it by what it sees.
    pub detour_m: f64,
    /// Length of an episode, s.
    pub episode_s: f64,
}

impl Default for Cross {
    /// 1.8 m/s, 0.6 m from things, below 2 m; 12 s.
    fn default() -> Self {
        Self {
            speed_m_s: 1.8,
            keep_m: 0.6,
            ceiling_m: 2.0,
            arrive_m: 0.6,
            touch_m: 0.1,
            detour_m: 0.0,
            episode_s: 12.0,
        }
    }
}

/// Forward of the drone, level, and its length before it was made 1.
pub(super) fn heading<S: Real>(q: [S; 4]) -> [S; 2] {
    let x = quat::rotate(q, [S::one(), S::zero(), S::zero()]);
    let length = (x[0].square() + x[1].square() + S::lit(1e-12)).sqrt();
    [x[0] / length, x[1] / length]
}

pub(super) fn along<S: Real>([cos, sin]: [S; 2], v: [S; 3]) -> [S; 3] {
    [cos * v[0] + sin * v[1], cos * v[1] - sin * v[0], v[2]]
}

/// The way to the target, and its length.
pub(super) fn way<S: Real>(seen: &Seen<S>, target_m: [S; 3]) -> ([S; 3], S) {
    let way: [S; 3] = core::array::from_fn(|k| target_m[k] - seen.pos_m[k]);
    let square = way[0].square() + way[1].square() + way[2].square();
    (way, (square + S::lit(1e-12)).sqrt())
}

impl SightedGoal for Cross {
    fn observations(&self) -> usize {
        12
    }

    fn observe<S: Real>(&self, seen: &Seen<S>, _: &[Other<S>], target_m: [S; 3], out: &mut Vec<S>) {
        let (way, length) = way(seen, target_m);
        let ahead = heading(seen.quat_xyzw);
        let near = length.max(S::lit(LEAST_M));
        out.extend(along(ahead, way).map(|v| v / near));
        out.push(S::lit(SCALES[0]) * length);
        out.extend(along(ahead, seen.vel_m_s).map(|v| S::lit(SCALES[1]) * v));
        out.push(S::lit(SCALES[2]) * (seen.pos_m[2] - S::lit(SCALES[3])));
        out.extend(seen.quat_xyzw);
    }

    fn cost<S: Real>(&self, seen: &Seen<S>, around: &Around<S>, target_m: [S; 3], actions: [&[S]; 2]) -> S {
        let near = &around.near;
        let (way, length) = way(seen, target_m);
        let over = |v: S| v.max(S::zero());
        // Towards the target, around things where that way is known, slower over the last metre.
        let way: [S; 3] = core::array::from_fn(|k| way[k] + length * around.detour[k]);
        let scale = S::lit(self.speed_m_s) / length.max(S::one());
        let mut sum = S::zero();
        for k in 0..3 {
            sum = sum + S::lit(0.5) * (seen.vel_m_s[k] - scale * way[k]).square();
            sum = sum + S::lit(0.005) * seen.ang_vel_rad_s[k].square();
        }
        // Looks where it goes.
        let ahead = heading(seen.quat_xyzw);
        sum = sum + S::lit(0.5) * (S::one() - (ahead[0] * way[0] + ahead[1] * way[1]) / length);
        // Away from things: the nearer the dearer, dearest where it touches, and dearer still towards them.
        let d = near.distance_m.max(S::lit(-0.1));
        let short = over(S::lit(self.keep_m) - d);
        let touching = ((S::lit(self.touch_m + 0.02) - d) * S::lit(1.0 / 0.05)).exp();
        let towards = over(
            -(near.away[0] * seen.vel_m_s[0]
                + near.away[1] * seen.vel_m_s[1]
                + near.away[2] * seen.vel_m_s[2]),
        );
        let close = over(S::lit(self.keep_m + 0.3) - d).square();
        sum = sum + S::lit(20.0) * short.square() + S::lit(4.0) * touching + S::lit(4.0) * towards * close;
        sum = sum + S::lit(10.0) * over(seen.pos_m[2] - S::lit(self.ceiling_m)).square();
        for (a, b) in actions[0].iter().zip(actions[1]) {
            sum = sum + S::lit(0.1) * (*a - *b).square();
        }
        sum
    }

    fn episode_s(&self) -> f64 {
        self.episode_s
    }

    fn arrive_m(&self) -> f64 {
        self.arrive_m
    }

    fn touch_m(&self) -> f64 {
        self.touch_m
    }
}
