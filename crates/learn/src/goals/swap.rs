//! Change places with other drones of the same world, all at once, touching none: one policy flies each of them, by what it knows of the nearest others.

use super::cross::{along, heading, way};
use crate::goal::Seen;
use crate::sighted::{Around, Other, SightedGoal};
use propwash_trace::Real;
use propwash_trace::math::vec3;

/// What the distance to the target and to others (1/m), velocities (s/m) and heights (1/m, m) are multiplied by in observations, and the height of zero.
pub const SCALES: [f64; 4] = [0.1, 0.5, 1.0, 1.2];

/// Directions of targets and of others nearer than this fade away, m.
pub const LEAST_M: [f64; 2] = [0.5, 0.1];

/// How near another drone is: `factor` (1 / max(d, near) − 1 / far) / (1 / near − 1 / far), of at least 0, as (near m, far m, factor).
pub const NEARNESS: [f64; 3] = [0.2, 6.0, 3.0];

/// An exchange of places.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Swap {
    /// Speed that is wanted, m/s.
    pub speed_m_s: f64,
    /// Nearer to another drone than this costs more and more, m, from middle to middle: now, and where both come if they fly on.
    pub keep_m: f64,
    /// How far ahead meetings are foreseen, s.
    pub foresee_s: f64,
    /// Lower and higher than this costs more and more, m.
    pub height_m: [f64; 2],
    /// Nearest drones that each knows of.
    pub neighbours: usize,
    /// The target is reached within this distance, m.
    pub arrive_m: f64,
    /// Radius of a drone, m: two that come nearer than twice of it touch.
    pub touch_m: f64,
    /// Length of an episode, s.
    pub episode_s: f64,
}

impl Default for Swap {
    /// 1.8 m/s, 0.7 m from others, 1.5 s ahead, between 0.4 and 2.2 m; 10 s.
    fn default() -> Self {
        Self {
            speed_m_s: 1.8,
            keep_m: 0.7,
            foresee_s: 1.5,
            height_m: [0.4, 2.2],
            neighbours: 4,
            arrive_m: 0.3,
            touch_m: 0.1,
            episode_s: 10.0,
        }
    }
}

fn over<S: Real>(v: S) -> S {
    v.max(S::zero())
}

fn length<S: Real>(v: [S; 3]) -> S {
    (vec3::dot(v, v) + S::lit(1e-12)).sqrt()
}

impl Swap {
    /// What one other drone costs.
    fn beside<S: Real>(&self, seen: &Seen<S>, other: &Other<S>) -> S {
        let off = vec3::sub(seen.pos_m, other.pos_m);
        let moved = vec3::sub(seen.vel_m_s, other.vel_m_s);
        // Now: the nearer the dearer, dearest where they touch.
        let distance = length(off);
        let short = over(S::lit(self.keep_m) - distance);
        let touching = ((S::lit(2.0 * self.touch_m + 0.04) - distance) * S::lit(1.0 / 0.08)).exp();
        // Where they are nearest if both fly on: the sooner the dearer.
        let ahead = S::lit(self.foresee_s);
        let time =
            (-vec3::dot(off, moved) / (vec3::dot(moved, moved) + S::lit(0.01))).clamp(S::zero(), ahead);
        let miss = length(vec3::add(off, vec3::scale(moved, time)));
        let soon = S::one() - time / ahead;
        let met = over(S::lit(self.keep_m) - miss);
        S::lit(20.0) * short.square() + S::lit(4.0) * touching + S::lit(10.0) * soon * met.square()
    }
}

impl SightedGoal for Swap {
    fn observations(&self) -> usize {
        12 + 8 * self.neighbours
    }

    fn others(&self) -> usize {
        self.neighbours
    }

    fn observe<S: Real>(&self, seen: &Seen<S>, others: &[Other<S>], target_m: [S; 3], out: &mut Vec<S>) {
        let (way, far) = way(seen, target_m);
        let ahead = heading(seen.quat_xyzw);
        let near = far.max(S::lit(LEAST_M[0]));
        out.extend(along(ahead, way).map(|v| v / near));
        out.push(S::lit(SCALES[0]) * far);
        out.extend(along(ahead, seen.vel_m_s).map(|v| S::lit(SCALES[1]) * v));
        out.push(S::lit(SCALES[2]) * (seen.pos_m[2] - S::lit(SCALES[3])));
        out.extend(seen.quat_xyzw);
        let [least, most, factor] = NEARNESS;
        let (low, high) = (most.recip(), least.recip());
        for other in others {
            let off = along(ahead, vec3::sub(other.pos_m, seen.pos_m));
            let distance = length(off);
            let near = distance.max(S::lit(LEAST_M[1]));
            out.extend(off.map(|v| v / near));
            let inverse = S::one() / distance.max(S::lit(least));
            out.push(over((inverse - S::lit(low)) * S::lit(factor / (high - low))));
            out.push(S::lit(SCALES[0]) * distance);
            let moved = along(ahead, vec3::sub(other.vel_m_s, seen.vel_m_s));
            out.extend(moved.map(|v| S::lit(SCALES[1]) * v));
        }
    }

    fn cost<S: Real>(&self, seen: &Seen<S>, around: &Around<S>, target_m: [S; 3], actions: [&[S]; 2]) -> S {
        let (way, far) = way(seen, target_m);
        // Towards the target, slower over the last metre.
        let scale = S::lit(self.speed_m_s) / far.max(S::one());
        let mut sum = S::zero();
        for k in 0..3 {
            sum = sum + S::lit(0.5) * (seen.vel_m_s[k] - scale * way[k]).square();
            sum = sum + S::lit(0.005) * seen.ang_vel_rad_s[k].square();
        }
        for other in around.others {
            sum = sum + self.beside(seen, other);
        }
        // Above things, and not too high.
        sum = sum + S::lit(20.0) * over(S::lit(self.height_m[0]) - around.near.distance_m).square();
        sum = sum + S::lit(10.0) * over(seen.pos_m[2] - S::lit(self.height_m[1])).square();
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
