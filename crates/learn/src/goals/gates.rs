//! Race through gates: an ordered ring of round openings, each to be crossed in its direction without touching its rim or missing it.

use crate::goal::{Goal, Outcome, Seen};
use propwash_physics::rigid_body::State;
use propwash_rollout::random::Stream;
use propwash_trace::Real;
use propwash_trace::math::vec3;

/// What ways to gates, velocities and angular velocities are multiplied by in observations, 1/m, s/m, s/rad.
pub const SCALES: [f64; 3] = [0.5, 0.5, 0.3];

/// A gate: a round opening in a plane, with a rim around it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gate {
    /// Middle of the opening, m.
    pub centre_m: [f64; 3],
    /// The way through it, of length 1.
    pub normal: [f64; 3],
    /// Radius of the opening, m.
    pub radius_m: f64,
}

/// A race. Each episode begins before a gate that is drawn, with all gates moved and turned a little, and is over once every gate was passed `laps` times. Rims have no
/// thickness.
///
/// Episodes remember: gates passed; which is next; the next gate and the one after (centre, normal); all gates as they stand (centre, normal).
#[derive(Clone, Debug, PartialEq)]
pub struct Gates {
    /// The gates in their order; after the last comes the first.
    pub gates: Vec<Gate>,
    /// Width of the rims, m.
    pub rim_m: f64,
    /// Radius of the drone: it must stay so far inside an opening, and outside a rim, m.
    pub body_m: f64,
    /// Gates are moved by up to this along each axis, m.
    pub moved_m: f64,
    /// Gates are turned by up to this about the vertical, rad.
    pub turned_rad: f64,
    /// Speed that costs least, m/s.
    pub speed_m_s: f64,
    /// How often each gate is to be passed.
    pub laps: usize,
    /// Time of an episode, s.
    pub time_s: f64,
}

impl Default for Gates {
    /// Five gates on a ring of 2 m radius, 0.3 m in radius, at different heights; moved by up to 0.2 m and turned by up to 0.2 rad; one lap at 2.5 m/s, at most 10 s.
    fn default() -> Self {
        let gate = |(k, height): (usize, f64)| {
            let (sin, cos) = (k as f64 * 0.4 * std::f64::consts::PI).sin_cos();
            Gate { centre_m: [2.0 * cos, 2.0 * sin, height], normal: [-sin, cos, 0.0], radius_m: 0.3 }
        };
        Self {
            gates: [1.0, 1.4, 0.9, 1.6, 1.2].into_iter().enumerate().map(gate).collect(),
            rim_m: 0.1,
            body_m: 0.07,
            moved_m: 0.2,
            turned_rad: 0.2,
            speed_m_s: 2.5,
            laps: 1,
            time_s: 10.0,
        }
    }
}

/// Places in the memory.
const PASSED: usize = 0;
const NEXT: usize = 1;
const NEAR: usize = 2;
const ALL: usize = 14;

/// A gate as an episode remembers it, from a place on: centre, m, and normal.
fn gate<S: Real>(memory: &[S], from: usize) -> [[S; 3]; 2] {
    [core::array::from_fn(|k| memory[from + k]), core::array::from_fn(|k| memory[from + 3 + k])]
}

/// How far the drone is before a gate's plane, and how far beside its axis, as a vector from the drone to the axis, m.
fn ahead<S: Real>(pos_m: [S; 3], [centre, normal]: [[S; 3]; 2]) -> (S, [S; 3]) {
    let way = vec3::sub(centre, pos_m);
    let along = vec3::dot(way, normal);
    (along, vec3::sub(way, vec3::scale(normal, along)))
}

/// How far beside the axis a move crosses a gate's plane, m, and whether in its direction; `None` where it does not cross it.
fn crossed(from: [f64; 3], to: [f64; 3], gate: [[f64; 3]; 2]) -> Option<(f64, bool)> {
    let ((before, aside), (after, then)) = (ahead(from, gate), ahead(to, gate));
    if (before > 0.0) == (after > 0.0) {
        return None;
    }
    let share = before / (before - after);
    let at: [f64; 3] = core::array::from_fn(|k| aside[k] + share * (then[k] - aside[k]));
    Some((vec3::norm(at), before > 0.0))
}

impl Gates {
    fn wanted(&self) -> f64 {
        (self.gates.len() * self.laps) as f64
    }

    /// Puts the next gate and the one after where observations and costs see them.
    fn show(&self, memory: &mut [f64]) {
        let (n, next) = (self.gates.len(), memory[NEXT] as usize);
        for k in 0..2 {
            let from = ALL + 6 * ((next + k) % n);
            memory.copy_within(from..from + 6, NEAR + 6 * k);
        }
    }
}

impl Goal for Gates {
    fn observations(&self) -> usize {
        22
    }

    fn observe<S: Real>(&self, seen: &Seen<S>, out: &mut Vec<S>) {
        for k in 0..2 {
            let [centre, normal] = gate(seen.memory, NEAR + 6 * k);
            out.extend(vec3::sub(centre, seen.pos_m).map(|v| S::lit(SCALES[0]) * v));
            out.extend(normal);
        }
        out.extend(seen.vel_m_s.map(|v| S::lit(SCALES[1]) * v));
        out.extend(seen.quat_xyzw);
        out.extend(seen.ang_vel_rad_s.map(|v| S::lit(SCALES[2]) * v));
    }

    fn cost<S: Real>(&self, seen: &Seen<S>, action: &[S], before: &[S]) -> S {
        let next = gate(seen.memory, NEAR);
        let (along, aside) = ahead(seen.pos_m, next);
        // The way to fly: through the gate along its axis, and to the axis the sooner the nearer the gate is.
        let way = vec3::add(vec3::scale(next[1], along.max(S::lit(0.3))), vec3::scale(aside, S::lit(1.5)));
        let wanted = vec3::scale(way, S::lit(self.speed_m_s) / vec3::dot(way, way).sqrt());
        let off = vec3::sub(seen.vel_m_s, wanted);
        let near = (-(along * S::lit(2.0)).square()).exp();
        let mut sum = S::lit(0.3) * vec3::dot(off, off) + S::lit(20.0) * near * vec3::dot(aside, aside);
        sum = sum + S::lit(0.005) * vec3::dot(seen.ang_vel_rad_s, seen.ang_vel_rad_s);
        for (a, b) in action.iter().zip(before) {
            sum = sum + S::lit(0.02) * (*a - *b).square();
        }
        sum
    }

    fn start(&self, random: &mut Stream, memory: &mut [f64]) -> (State<f64>, f64) {
        for (k, gate) in self.gates.iter().enumerate() {
            let (sin, cos) = random.uniform(-self.turned_rad, self.turned_rad).sin_cos();
            let [x, y, z] = gate.normal;
            let own = &mut memory[ALL + 6 * k..ALL + 6 * k + 6];
            for (to, v) in own.iter_mut().zip(gate.centre_m) {
                *to = v + random.uniform(-self.moved_m, self.moved_m);
            }
            own[3..].copy_from_slice(&[cos * x - sin * y, sin * x + cos * y, z]);
        }
        memory[NEXT] = random.below(self.gates.len() as u64) as f64;
        self.show(memory);
        let [centre, normal] = gate(memory, NEAR);
        let (before, speed) = (random.uniform(0.6, 1.4), random.uniform(0.0, self.speed_m_s));
        let state = State {
            pos: core::array::from_fn(|k| centre[k] - before * normal[k] + random.uniform(-0.2, 0.2)),
            vel: core::array::from_fn(|k| speed * normal[k] + random.uniform(-0.2, 0.2)),
            ..State::rest()
        };
        (state, 0.0)
    }

    fn memory(&self) -> usize {
        ALL + 6 * self.gates.len()
    }

    /// Passed: the next gate's plane crossed in its direction inside the opening. Lost: the same outside of it, or the rim of any gate met from either side.
    fn judge(&self, before: &Seen<f64>, after: &Seen<f64>, memory: &mut [f64]) -> Outcome {
        let next = memory[NEXT] as usize;
        let mut passed = false;
        for (k, own) in self.gates.iter().enumerate() {
            let stands = gate(memory, ALL + 6 * k);
            let Some((beside, forwards)) = crossed(before.pos_m, after.pos_m, stands) else { continue };
            let inside = beside < own.radius_m - self.body_m;
            let touches = !inside && beside < own.radius_m + self.rim_m + self.body_m;
            if touches || (k == next && forwards && !inside) {
                return Outcome::Lost;
            }
            passed |= k == next && forwards;
        }
        if !passed {
            return Outcome::On;
        }
        memory[PASSED] += 1.0;
        memory[NEXT] = ((next + 1) % self.gates.len()) as f64;
        self.show(memory);
        if memory[PASSED] < self.wanted() { Outcome::On } else { Outcome::Done }
    }

    fn episode_s(&self) -> f64 {
        self.time_s
    }

    /// From the next gate's middle, m.
    fn off_m(&self, seen: &Seen<f64>) -> f64 {
        vec3::norm(vec3::sub(gate(seen.memory, NEAR)[0], seen.pos_m))
    }

    fn reached(&self, seen: &Seen<f64>) -> bool {
        seen.memory[PASSED] >= self.wanted()
    }

    fn far_off_m(&self) -> f64 {
        6.0
    }

    /// Less than what it costs to stay away from the gates for good.
    fn lost_cost(&self) -> f64 {
        10.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::episodes::stream;

    /// Moves through, beside, backwards and far around gates, and what becomes of the episode.
    #[test]
    fn gates_are_passed_through_their_openings_and_not_otherwise() {
        let goal = Gates { moved_m: 0.0, turned_rad: 0.0, ..Gates::default() };
        let mut memory = vec![0.0; goal.memory()];
        goal.start(&mut stream(1, 0, 0, "test"), &mut memory);
        memory[NEXT] = 0.0;
        goal.show(&mut memory);
        let at = |pos: [f64; 3]| [&pos[..], &[0.0, 0.0, 0.0, 1.0], &[0.0; 6]].concat();
        let judged = |memory: &[f64], from: [f64; 3], to: [f64; 3]| {
            let (before, after, mut changed) = (at(from), at(to), memory.to_vec());
            let outcome =
                goal.judge(&Seen::of(&before, 0.0, memory), &Seen::of(&after, 0.02, memory), &mut changed);
            (outcome, changed)
        };
        // The first gate stands at (2, 0, 1) and is passed along y.
        let (outcome, changed) = judged(&memory, [2.1, -0.1, 1.1], [2.1, 0.1, 1.1]);
        assert_eq!((outcome, changed[PASSED], changed[NEXT]), (Outcome::On, 1.0, 1.0));
        assert_eq!(changed[NEAR..NEAR + 3], changed[ALL + 6..ALL + 9]);
        for (beside, forwards, wanted) in [
            (0.22, true, Outcome::On),
            (0.24, true, Outcome::Lost), // the body touches the rim from inside
            (0.46, true, Outcome::Lost),
            (0.48, true, Outcome::Lost), // past it
            (3.0, true, Outcome::Lost),
            (0.1, false, Outcome::On), // backwards through the opening
            (0.46, false, Outcome::Lost),
            (0.48, false, Outcome::On),
        ] {
            let y = if forwards { 0.1 } else { -0.1 };
            let (outcome, changed) = judged(&memory, [2.0 + beside, -y, 1.0], [2.0 + beside, y, 1.0]);
            assert_eq!(outcome, wanted, "{beside} {forwards}");
            assert_eq!(changed[PASSED] > 0.0, forwards && beside < 0.23);
        }
        // A rim of another gate; and the last gate, after which nothing is left to do.
        let (far, last) = (memory[ALL + 12..ALL + 18].to_vec(), memory.clone());
        let rim =
            |by: f64| core::array::from_fn(|k| far[k] + by * far[3 + k] + if k == 2 { 0.35 } else { 0.0 });
        assert_eq!(judged(&memory, rim(-0.1), rim(0.1)).0, Outcome::Lost);
        let mut last = last;
        last[PASSED] = 4.0;
        let (outcome, changed) = judged(&last, [2.0, -0.1, 1.0], [2.0, 0.1, 1.0]);
        assert_eq!(outcome, Outcome::Done);
        assert!(goal.reached(&Seen::of(&at([0.0; 3]), 0.0, &changed)));
        // Between one point and the next that both lie before the plane nothing happens, however far beside.
        assert_eq!(judged(&memory, [2.4, -0.2, 1.0], [2.4, -0.01, 1.0]).0, Outcome::On);
    }
}
