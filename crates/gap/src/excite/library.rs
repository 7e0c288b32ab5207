//! Library of exciting manoeuvres, as knots of a spline. All start and end at rest in the middle of the room, heading along
//! x, so that they can be flown in any order.

use core::f64::consts::{PI, TAU};
use serde::{Deserialize, Serialize};

/// Time (s), position (m, world) and heading (rad) of a waypoint.
pub type Knot = (f64, [f64; 3], f64);

/// Knot spacing, s: fine enough for the fastest sine of the library (3 Hz).
const KNOT_S: f64 = 0.025;
/// Rest before and after every manoeuvre, s.
const REST_S: f64 = 0.4;

/// The flight space: x and y from −half to half of their size, z from 0 up.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Room {
    /// Length, width and height, m.
    pub size_m: [f64; 3],
    /// Whether z = 0 is ground that can be flown over.
    pub ground: bool,
    /// Height of a ceiling that can be flown under, m.
    pub ceiling_z_m: Option<f64>,
    /// Height above ground, and distance below the ceiling, of close passes, m.
    pub close_m: f64,
}

impl Room {
    /// Margin of the references from the walls.
    fn margin_m(&self) -> [f64; 3] {
        self.size_m.map(|s| (0.15 * s).min(0.5))
    }

    /// Largest offset of the references from the middle, m.
    fn half_m(&self) -> [f64; 3] {
        let margin = self.margin_m();
        core::array::from_fn(|k| 0.5 * self.size_m[k] - margin[k])
    }

    /// Where manoeuvres begin and end, m.
    pub fn middle_m(&self) -> [f64; 3] {
        [0.0, 0.0, 0.5 * self.size_m[2]]
    }

    /// Distance outside the room, m; 0 inside.
    pub fn outside_m(&self, p: [f64; 3]) -> f64 {
        let [x, y, z] = self.size_m;
        let beyond = [p[0].abs() - 0.5 * x, p[1].abs() - 0.5 * y, p[2] - z, -p[2]];
        beyond.into_iter().fold(0.0, f64::max)
    }
}

/// Requirements of a manoeuvre on the room.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Needs {
    Nothing,
    Ground,
    Ceiling,
}

/// A manoeuvre of the library.
pub(super) struct Manoeuvre {
    pub name: &'static str,
    /// Description.
    pub title: &'static str,
    pub needs: Needs,
    shape: fn(&mut Path),
}

impl Manoeuvre {
    /// Whether a room meets its requirements.
    pub fn fits(&self, room: &Room) -> bool {
        match self.needs {
            Needs::Nothing => true,
            Needs::Ground => room.ground,
            Needs::Ceiling => room.ceiling_z_m.is_some_and(|z| z <= room.size_m[2]),
        }
    }

    /// Its knots from time 0 on; `intensity` scales speeds and accelerations, 1 is full.
    pub fn knots(&self, room: &Room, intensity: f64) -> Vec<Knot> {
        let mut path = Path::new(room, intensity);
        path.hold(REST_S);
        (self.shape)(&mut path);
        path.leg(room.middle_m(), 0.0, 2.0);
        path.hold(REST_S);
        path.knots
    }
}

/// A path under construction.
struct Path {
    room: Room,
    half: [f64; 3],
    middle: [f64; 3],
    /// Accelerations, m/s²: lateral, vertical.
    lateral: f64,
    vertical: f64,
    /// Factor on speeds.
    speed: f64,
    pos: [f64; 3],
    yaw: f64,
    knots: Vec<Knot>,
}

/// 10 s³ − 15 s⁴ + 6 s⁵: from 0 to 1 with zero velocity and acceleration at the ends.
fn smooth(s: f64) -> f64 {
    s * s * s * (10.0 + s * (6.0 * s - 15.0))
}

/// 0 at both ends of [0, `length`], 1 in between, smooth over `edge`.
fn window(t: f64, length: f64, edge: f64) -> f64 {
    smooth((t / edge).clamp(0.0, 1.0)) * smooth(((length - t) / edge).clamp(0.0, 1.0))
}

impl Path {
    fn new(room: &Room, intensity: f64) -> Self {
        let middle = room.middle_m();
        Self {
            room: *room,
            half: room.half_m(),
            middle,
            lateral: 6.0 * intensity,
            vertical: 5.0 * intensity,
            speed: intensity,
            pos: middle,
            yaw: 0.0,
            knots: vec![(0.0, middle, 0.0)],
        }
    }

    /// Follows `f(t)` = (offset from here in m, turn from here in rad) for `seconds`.
    fn follow(&mut self, seconds: f64, f: impl Fn(f64) -> ([f64; 3], f64)) {
        let begin = self.knots.last().map_or(0.0, |k| k.0);
        let n = (seconds / KNOT_S).ceil().max(1.0) as usize;
        let (from, yaw) = (self.pos, self.yaw);
        for i in 1..=n {
            let (offset, turn) = f((i as f64 * KNOT_S).min(seconds));
            self.pos = core::array::from_fn(|k| from[k] + offset[k]);
            self.yaw = yaw + turn;
            self.knots.push((begin + i as f64 * KNOT_S, self.pos, self.yaw));
        }
    }

    fn hold(&mut self, seconds: f64) {
        self.follow(seconds, |_| ([0.0; 3], 0.0));
    }

    /// Straight to a point and a heading, at most at `speed` m/s.
    fn leg(&mut self, to: [f64; 3], yaw: f64, speed: f64) {
        let way: [f64; 3] = core::array::from_fn(|k| to[k] - self.pos[k]);
        let turn = yaw - self.yaw;
        let length = way.iter().map(|d| d * d).sum::<f64>().sqrt();
        let rise = way[2].abs();
        // The peak speed of the polynomial is 15/8 of the mean; its peak acceleration is 5.774 length/time².
        let seconds = (1.875 * length / (speed * self.speed))
            .max((5.774 * length / self.lateral).sqrt())
            .max((5.774 * rise / self.vertical).sqrt())
            .max(1.875 * turn.abs() / 2.5);
        if seconds > 1e-6 {
            self.follow(seconds, |t| {
                let s = smooth((t / seconds).min(1.0));
                (way.map(|d| s * d), s * turn)
            });
        }
    }

    fn turn(&mut self, by: f64, rate: f64) {
        let seconds = 1.875 * by.abs() / rate;
        self.follow(seconds, |t| ([0.0; 3], by * smooth((t / seconds).min(1.0))));
    }

    /// Subtracts a whole turn from later headings, which leaves them equivalent.
    fn whole_turn(&mut self) {
        self.yaw -= TAU;
    }

    /// Accelerations of +a, −a, −a, +a, each for `each` s: out and back, with steps of thrust or tilt.
    fn steps(&mut self, axis: usize, acc: f64, each: f64) {
        let each = (each / KNOT_S).round() * KNOT_S;
        let each = each.min((self.half[axis] / acc.abs()).sqrt());
        self.follow(4.0 * each, |t| {
            let (mut p, mut v, mut at) = (0.0, 0.0, 0.0);
            for sign in [1.0, -1.0, -1.0, 1.0] {
                let dt = (t - at).clamp(0.0, each);
                let a = sign * acc;
                p += v * dt + 0.5 * a * dt * dt;
                v += a * dt;
                at += each;
            }
            let mut out = [0.0; 3];
            out[axis] = p;
            (out, 0.0)
        });
    }

    /// Up with an acceleration of `acc` for `each` s, then half of it in the other direction for twice as long, and down
    /// again.
    fn climb(&mut self, acc: f64, each: f64) {
        let each = (each / KNOT_S).round() * KNOT_S;
        // It ends 1.5 acc each² higher.
        let each = each.min((self.half[2] / (1.5 * acc)).sqrt());
        self.follow(3.0 * each, |t| {
            let up = t.min(each);
            let after = (t - each).max(0.0);
            let z = 0.5 * acc * up * up + acc * up * after - 0.25 * acc * after * after;
            ([0.0, 0.0, z], 0.0)
        });
        self.leg(self.middle, self.yaw, 2.0);
    }

    /// A sine of rising frequency along an axis (3: heading) with accelerations of at most `acc` (m/s², rad/s²).
    fn chirp(&mut self, axis: usize, acc: f64, hz: [f64; 2], seconds: f64) {
        let most = self.half.get(axis).copied().unwrap_or(1.0) * 0.8;
        let growth = (hz[1] / hz[0]).ln();
        self.follow(seconds, |t| {
            let f = hz[0] * (growth * t / seconds).exp();
            let phase = TAU * hz[0] * seconds / growth * ((growth * t / seconds).exp() - 1.0);
            let size = (acc / (TAU * f).powi(2)).min(most);
            let value = size * phase.sin() * window(t, seconds, 0.5);
            let mut out = [0.0; 3];
            if axis < 3 {
                out[axis] = value;
                (out, 0.0)
            } else {
                (out, value)
            }
        });
    }

    /// Sines on all axes and the heading at once, each at its own frequency.
    fn multi_sine(&mut self, seconds: f64) {
        const HZ: [[f64; 3]; 4] = [[0.5, 1.1, 1.9], [0.6, 1.3, 2.2], [0.7, 1.5, 2.6], [0.4, 0.9, 1.7]];
        let acc = [0.35 * self.lateral, 0.35 * self.lateral, 0.4 * self.vertical, 1.5 * self.speed];
        let half = self.half;
        self.follow(seconds, |t| {
            let value = |axis: usize| -> f64 {
                let most = half.get(axis).copied().unwrap_or(1.0) * 0.25;
                let sum: f64 = HZ[axis]
                    .iter()
                    .enumerate()
                    .map(|(i, hz)| {
                        let w = TAU * hz;
                        (acc[axis] / (w * w)).min(most) * (w * t + 2.0 * i as f64 + axis as f64).sin()
                    })
                    .sum();
                sum * window(t, seconds, 0.8)
            };
            ([value(0), value(1), value(2)], value(3))
        });
    }

    /// Follows a closed curve: the phase accelerates, runs at `rate` rad/s, and decelerates after `turns`.
    fn around(&mut self, turns: f64, rate: f64, f: impl Fn(f64) -> ([f64; 3], f64)) {
        // Accelerating takes 1 s, in which half the distance is covered.
        let seconds = turns * TAU / rate + 1.0;
        let angle = |t: f64| {
            let up = |t: f64| {
                let s = t.clamp(0.0, 1.0);
                // Integral of the smooth step 3s² − 2s³, then at full rate.
                s * s * s - 0.5 * s * s * s * s + (t - 1.0).max(0.0)
            };
            let total = seconds - 1.0;
            if t < 0.5 * seconds { rate * up(t) } else { rate * (total - up(seconds - t)) }
        };
        self.follow(seconds, |t| f(angle(t)));
    }

    /// A figure of eight through the middle, at most `speed` m/s, optionally with the nose along the path.
    fn eight(&mut self, speed: f64, nose_first: bool) {
        let x = self.half[0].min(0.5 + 0.5 * speed);
        let y = (0.5 * x).min(self.half[1]);
        let rate =
            (speed * self.speed / (x * x + 4.0 * y * y).sqrt()).min((self.lateral / x.max(4.0 * y)).sqrt());
        // The nose turns nearly three times as fast as the phase.
        let rate = if nose_first { rate.min(1.2) } else { rate };
        let first = (2.0 * y).atan2(x);
        self.around(1.0, rate, |a| {
            let place = [x * a.sin(), y * (2.0 * a).sin(), 0.0];
            let heading = (2.0 * y * (2.0 * a).cos()).atan2(x * a.cos());
            (place, if nose_first { unwrapped(heading - first) } else { 0.0 })
        });
    }

    fn end(&self, x: f64, y: f64, z: f64) -> [f64; 3] {
        let share = [x, y, z];
        core::array::from_fn(|k| self.middle[k] + share[k] * self.half[k])
    }
}

/// Continuous heading of a figure of eight: it turns right over at most three quarters of a turn and comes back.
fn unwrapped(heading: f64) -> f64 {
    heading - TAU * ((heading - 0.3) / TAU).ceil()
}

/// All manoeuvres.
pub(super) const ALL: &[Manoeuvre] = &[
    Manoeuvre {
        name: "hover",
        title: "hover for two seconds",
        needs: Needs::Nothing,
        shape: |p| p.hold(1.6),
    },
    Manoeuvre {
        name: "pitch steps",
        title: "steps of acceleration to and fro along x",
        needs: Needs::Nothing,
        shape: |p| {
            p.steps(0, p.lateral, 0.35);
            p.steps(0, -p.lateral, 0.25);
        },
    },
    Manoeuvre {
        name: "roll steps",
        title: "steps of acceleration to and fro along y",
        needs: Needs::Nothing,
        shape: |p| {
            p.steps(1, p.lateral, 0.35);
            p.steps(1, -p.lateral, 0.25);
        },
    },
    Manoeuvre {
        name: "thrust steps",
        title: "steps of acceleration up and down",
        needs: Needs::Nothing,
        shape: |p| {
            p.steps(2, p.vertical, 0.3);
            p.steps(2, -p.vertical, 0.3);
            p.steps(2, p.vertical, 0.2);
        },
    },
    Manoeuvre {
        name: "hard climbs",
        title: "up with more than twice the thrust of hover, twice",
        needs: Needs::Nothing,
        shape: |p| {
            // The spline rings before a step of acceleration; the pause lets it die out.
            p.hold(0.1);
            p.climb(2.4 * p.vertical, 0.2);
            p.climb(2.8 * p.vertical, 0.15);
        },
    },
    Manoeuvre {
        name: "drop",
        title: "fall with little thrust and catch, twice",
        needs: Needs::Nothing,
        shape: |p| {
            for _ in 0..2 {
                p.leg(p.end(0.0, 0.0, 0.8), 0.0, 2.0);
                p.steps(2, -1.5 * p.vertical, 0.3);
            }
        },
    },
    Manoeuvre {
        name: "chirp x",
        title: "to and fro along x, from slow to quick",
        needs: Needs::Nothing,
        shape: |p| p.chirp(0, 0.8 * p.lateral, [0.6, 3.0], 4.0),
    },
    Manoeuvre {
        name: "chirp y",
        title: "to and fro along y, from slow to quick",
        needs: Needs::Nothing,
        shape: |p| p.chirp(1, 0.8 * p.lateral, [0.6, 3.0], 4.0),
    },
    Manoeuvre {
        name: "chirp z",
        title: "up and down, from slow to quick",
        needs: Needs::Nothing,
        shape: |p| p.chirp(2, p.vertical, [0.6, 3.0], 4.0),
    },
    Manoeuvre {
        name: "chirp yaw",
        title: "turn to and fro about yaw, from slow to quick",
        needs: Needs::Nothing,
        shape: |p| p.chirp(3, 5.0 * p.speed, [0.4, 1.8], 4.0),
    },
    Manoeuvre {
        name: "multi-sine",
        title: "sines on all axes and the heading at once",
        needs: Needs::Nothing,
        shape: |p| p.multi_sine(7.0),
    },
    Manoeuvre {
        name: "yaw spin",
        title: "one turn about yaw each way, on the spot",
        needs: Needs::Nothing,
        shape: |p| {
            p.turn(TAU, 4.0 * p.speed);
            p.turn(-TAU, 4.0 * p.speed);
        },
    },
    Manoeuvre {
        name: "hover at four headings",
        title: "hover for a second at headings of 0, 90, 180 and 270°",
        needs: Needs::Nothing,
        shape: |p| {
            for _ in 0..4 {
                p.hold(0.8);
                p.turn(0.5 * PI, 2.5);
            }
            p.whole_turn();
        },
    },
    Manoeuvre {
        name: "slow legs",
        title: "level legs along x and y at up to 1.2 m/s",
        needs: Needs::Nothing,
        shape: |p| {
            p.leg(p.end(0.6, 0.0, 0.0), 0.0, 1.2);
            p.leg(p.end(0.0, 0.6, 0.0), 0.0, 1.2);
        },
    },
    Manoeuvre {
        name: "fast legs x",
        title: "level legs along x as fast as the room lets",
        needs: Needs::Nothing,
        shape: |p| {
            p.leg(p.end(1.0, 0.0, 0.0), 0.0, 5.0);
            p.leg(p.end(-1.0, 0.0, 0.0), 0.0, 5.0);
        },
    },
    Manoeuvre {
        name: "fast legs y",
        title: "level legs along y as fast as the room lets",
        needs: Needs::Nothing,
        shape: |p| {
            p.leg(p.end(0.0, 1.0, 0.0), 0.0, 5.0);
            p.leg(p.end(0.0, -1.0, 0.0), 0.0, 5.0);
        },
    },
    Manoeuvre {
        name: "legs at four headings",
        title: "fast level legs along x at headings of 0, 90, 180 and 270°",
        needs: Needs::Nothing,
        shape: |p| {
            let mut side = 1.0;
            for heading in [0.0, 0.5, 1.0, 1.5] {
                p.leg(p.end(side, 0.0, 0.0), PI * heading, 4.0);
                side = -side;
            }
            p.whole_turn();
        },
    },
    Manoeuvre {
        name: "climbing diagonals",
        title: "fast legs that climb and sink across the room",
        needs: Needs::Nothing,
        shape: |p| {
            p.leg(p.end(0.9, 0.9, 0.9), 0.0, 5.0);
            p.leg(p.end(-0.9, -0.9, -0.7), 0.0, 5.0);
            p.leg(p.end(-0.9, 0.9, 0.9), 0.0, 5.0);
            p.leg(p.end(0.9, -0.9, -0.7), 0.0, 5.0);
        },
    },
    Manoeuvre {
        name: "climb and sink",
        title: "straight up and down through the whole height",
        needs: Needs::Nothing,
        shape: |p| {
            p.leg(p.end(0.0, 0.0, 1.0), 0.0, 4.0);
            p.leg(p.end(0.0, 0.0, -0.8), 0.0, 4.0);
            p.leg(p.end(0.0, 0.0, 1.0), 0.0, 4.0);
        },
    },
    Manoeuvre {
        name: "vertical oscillation",
        title: "up and down about once a second",
        needs: Needs::Nothing,
        shape: |p| p.chirp(2, p.vertical, [0.8, 1.2], 4.0),
    },
    Manoeuvre {
        name: "slow eight",
        title: "a figure of eight at up to 1.2 m/s",
        needs: Needs::Nothing,
        shape: |p| p.eight(1.2, false),
    },
    Manoeuvre {
        name: "quick eight",
        title: "a figure of eight at up to 2.5 m/s",
        needs: Needs::Nothing,
        shape: |p| p.eight(2.5, false),
    },
    Manoeuvre {
        name: "fast eight",
        title: "a figure of eight at up to 4 m/s",
        needs: Needs::Nothing,
        shape: |p| p.eight(4.0, false),
    },
    Manoeuvre {
        name: "eight nose first",
        title: "a figure of eight at up to 2.5 m/s with the nose along the path",
        needs: Needs::Nothing,
        shape: |p| p.eight(2.5, true),
    },
    Manoeuvre {
        name: "circle nose first",
        title: "a circle at up to 2.5 m/s with the nose along the path",
        needs: Needs::Nothing,
        shape: |p| {
            let r = (0.5 * p.half[1]).min(p.half[0]).min(1.0);
            let rate = (2.5 * p.speed / r).min((p.lateral / r).sqrt()).min(2.5);
            p.around(1.0, rate, |a| ([r * a.sin(), r * (1.0 - a.cos()), 0.0], a));
            p.whole_turn();
        },
    },
    Manoeuvre {
        name: "low passes",
        title: "close over the ground, along x, at two heights",
        needs: Needs::Ground,
        shape: |p| {
            let at = |p: &Path, x: f64, height: f64| {
                let mut to = p.end(x, 0.0, 0.0);
                to[2] = height;
                to
            };
            let low = p.room.close_m;
            p.leg(at(p, 0.5, 3.0 * low), 0.0, 2.0);
            p.leg(at(p, 0.5, low), 0.0, 0.6);
            p.leg(at(p, -0.5, low), 0.0, 1.5);
            p.leg(at(p, -0.5, 2.0 * low), 0.0, 0.6);
            p.leg(at(p, 0.0, 2.0 * low), 0.0, 1.5);
        },
    },
    Manoeuvre {
        name: "under the ceiling",
        title: "close under the ceiling, along x, at two distances",
        needs: Needs::Ceiling,
        shape: |p| {
            let Some(ceiling) = p.room.ceiling_z_m else { return };
            let at = |p: &Path, x: f64, below: f64| {
                let mut to = p.end(x, 0.0, 0.0);
                to[2] = ceiling - below;
                to
            };
            let close = p.room.close_m;
            p.leg(at(p, 0.5, 3.0 * close), 0.0, 2.0);
            p.leg(at(p, 0.5, close), 0.0, 0.6);
            p.leg(at(p, -0.5, close), 0.0, 1.5);
            p.leg(at(p, -0.5, 2.0 * close), 0.0, 0.6);
            p.leg(at(p, 0.0, 2.0 * close), 0.0, 1.5);
        },
    },
];
