//! What is flown: reference tracks, dither, and a geometric controller that believes in the vehicle file.

use super::hidden::{CEILING_Z_M, stream};
use super::linear::{V, add, cross, dot, mat_t_vec, mat_vec, matrix, mul, norm, quat_exp, solve4, sub, unit};
use super::world::{Nominal, Speeds, State, TrueRotor, attitude, part, speed_for};
use propwash::random::Stream;
use propwash::rollout::trajectory::Spline;
use serde::Serialize;
use std::f64::consts::{PI, TAU};

/// What the pilot does, for the whole flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Excitation {
    /// Fast and slow legs, steps, turns about yaw, with multi-sine dither on all rates and on thrust.
    MultiSine,
    /// The same without dither.
    Steps,
    /// A figure of eight, once in about 8 s.
    Lissajous,
    /// A level circle at one speed.
    Circle,
    /// Hover while turning about yaw.
    HoverYaw,
    /// Random way-points at moderate speed, no dither.
    Waypoints,
    /// As [`Excitation::MultiSine`], mostly 0.15 to 0.4 m above the ground.
    LowPass,
    /// As [`Excitation::MultiSine`], mostly 0.1 to 0.4 m below the ceiling.
    NearCeiling,
    /// As [`Excitation::MultiSine`] in a small space, with another vehicle above.
    BelowNeighbour,
    /// The way-points of the plan.
    Planned,
}

impl Excitation {
    /// All of them but the planned one, by the name on the command line.
    pub const ALL: &[(&'static str, Excitation)] = &[
        ("multi-sine", Excitation::MultiSine),
        ("steps", Excitation::Steps),
        ("lissajous", Excitation::Lissajous),
        ("circle", Excitation::Circle),
        ("hover-yaw", Excitation::HoverYaw),
        ("waypoints", Excitation::Waypoints),
        ("low-pass", Excitation::LowPass),
        ("near-ceiling", Excitation::NearCeiling),
        ("below-neighbour", Excitation::BelowNeighbour),
    ];

    /// The one with that name.
    ///
    /// # Errors
    /// A sentence with all names.
    pub fn by_name(name: &str) -> Result<Self, String> {
        Self::ALL.iter().find(|(known, _)| *known == name).map(|(_, e)| *e).ok_or_else(|| {
            let names: Vec<&str> = Self::ALL.iter().map(|(n, _)| *n).collect();
            format!("expected an excitation, found `{name}`: take one of {}", names.join(", "))
        })
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        Self::ALL.iter().find(|(_, e)| *e == self).map_or("planned", |(n, _)| n)
    }

    /// The exciting flight in which the effect `id` can be seen.
    pub fn exciting(id: &str) -> Self {
        match id {
            "ground_effect" => Self::LowPass,
            "ceiling_effect" => Self::NearCeiling,
            "downwash" => Self::BelowNeighbour,
            _ => Self::MultiSine,
        }
    }
}

/// Where the vehicle is to be.
#[derive(Clone, Copy, Debug, Default)]
pub struct Reference {
    /// Position, m.
    pub p: V,
    /// Velocity, m/s.
    pub v: V,
    /// Acceleration, m/s².
    pub a: V,
    /// Yaw, rad.
    pub yaw: f64,
    /// Its rate, rad/s.
    pub yaw_rate: f64,
    /// Share of the dither.
    pub dither: f64,
}

/// A stretch of the track: from one place to another, by a polynomial of order five or at once.
#[derive(Clone, Copy, Debug)]
struct Leg {
    start_s: f64,
    end_s: f64,
    from: V,
    to: V,
    yaw: [f64; 2],
    jump: bool,
    dither: f64,
}

#[derive(Clone, Debug)]
enum Shape {
    Legs(Vec<Leg>),
    Lissajous { size: V, period_s: f64, at: V, turn: f64 },
    Circle { radius: f64, period_s: f64, at: V },
    Planned(Spline),
}

/// The track of a flight.
#[derive(Clone, Debug)]
pub struct Track {
    shape: Shape,
}

/// The box and the manner of random legs.
struct Manner {
    half_m: f64,
    height_m: [f64; 2],
    speed_m_s: [f64; 2],
    dither: f64,
    /// Share of legs in the box of heights; others go to `else_m`.
    inside: f64,
    else_m: [f64; 2],
}

impl Track {
    /// The track along way-points: time (s), place (m), heading (rad).
    pub fn along(points: &[(f64, V, f64)]) -> Result<Self, String> {
        Ok(Self { shape: Shape::Planned(Spline::new(points).map_err(|e| e.to_string())?) })
    }

    /// The track of the flight number `flight` with `seed`.
    pub fn new(excitation: Excitation, seconds: f64, seed: u64, flight: u64) -> Self {
        let mut s = stream(seed, flight, "track");
        let plain = Manner {
            half_m: 3.6,
            height_m: [1.2, 3.8],
            speed_m_s: [0.5, 6.0],
            dither: 1.0,
            inside: 1.0,
            else_m: [1.0, 2.0],
        };
        let shape = match excitation {
            Excitation::MultiSine => legs(&mut s, seconds, &plain),
            Excitation::Steps => legs(&mut s, seconds, &Manner { dither: 0.0, ..plain }),
            Excitation::LowPass => {
                let low = Manner {
                    height_m: [0.16, 0.4],
                    speed_m_s: [0.5, 3.0],
                    dither: 0.5,
                    inside: 0.75,
                    ..plain
                };
                legs(&mut s, seconds, &low)
            }
            Excitation::NearCeiling => {
                let high = Manner {
                    height_m: [CEILING_Z_M - 0.4, CEILING_Z_M - 0.16],
                    speed_m_s: [0.5, 3.0],
                    dither: 0.5,
                    inside: 0.75,
                    ..plain
                };
                legs(&mut s, seconds, &high)
            }
            Excitation::BelowNeighbour => {
                legs(&mut s, seconds, &Manner { half_m: 0.9, height_m: [1.0, 2.2], ..plain })
            }
            Excitation::HoverYaw => {
                let at = [s.uniform(-0.3, 0.3), s.uniform(-0.3, 0.3), s.uniform(1.0, 1.5)];
                let (mut out, mut t, mut yaw) = (Vec::new(), 0.0, 0.0);
                while t < seconds {
                    let to = yaw + s.uniform(-PI, PI);
                    let time = (to - yaw).abs() / s.uniform(0.3, 0.8) + 0.5;
                    let leg = Leg {
                        start_s: t,
                        end_s: t + time,
                        from: at,
                        to: at,
                        yaw: [yaw, to],
                        jump: false,
                        dither: 0.0,
                    };
                    out.push(leg);
                    (t, yaw) = (t + time + s.uniform(0.2, 1.0), to);
                }
                Shape::Legs(out)
            }
            Excitation::Waypoints => {
                let calm =
                    Manner { half_m: 2.0, height_m: [0.8, 2.2], speed_m_s: [0.5, 2.0], dither: 0.0, ..plain };
                legs(&mut s, seconds, &calm)
            }
            // Without way-points there is nowhere to go.
            Excitation::Planned => Shape::Circle { radius: 0.0, period_s: 1.0, at: [0.0, 0.0, 1.5] },
            Excitation::Lissajous => Shape::Lissajous {
                size: [s.uniform(1.0, 1.6), s.uniform(0.7, 1.2), s.uniform(0.15, 0.4)],
                period_s: s.uniform(6.5, 9.0),
                at: [0.0, 0.0, s.uniform(1.2, 1.8)],
                turn: if s.below(2) == 0 { 0.0 } else { s.uniform(0.3, 0.8) },
            },
            Excitation::Circle => Shape::Circle {
                radius: s.uniform(1.0, 1.8),
                period_s: s.uniform(4.0, 6.0),
                at: [0.0, 0.0, s.uniform(1.2, 1.8)],
            },
        };
        Self { shape }
    }

    /// The reference at time `t`; before 0 that of rest at the start.
    pub fn at(&self, t: f64) -> Reference {
        match &self.shape {
            Shape::Legs(legs) => {
                let k = legs.partition_point(|l| l.start_s <= t).saturating_sub(1);
                let l = &legs[k];
                let time = l.end_s - l.start_s;
                let s = ((t - l.start_s) / time).clamp(0.0, 1.0);
                let way = sub(l.to, l.from);
                let turn = l.yaw[1] - l.yaw[0];
                // 10 s³ − 15 s⁴ + 6 s⁵ and its derivatives.
                let smooth = s * s * s * (10.0 + s * (6.0 * s - 15.0));
                let first = 30.0 * s * s * (1.0 - s) * (1.0 - s) / time;
                let second = 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / (time * time);
                let mut r = Reference {
                    yaw: l.yaw[0] + smooth * turn,
                    yaw_rate: first * turn,
                    dither: if t < 0.0 { 0.0 } else { l.dither },
                    ..Reference::default()
                };
                if l.jump {
                    r.p = if t < l.start_s { l.from } else { l.to };
                } else {
                    r.p = add(l.from, mul(way, smooth));
                    r.v = mul(way, first);
                    r.a = mul(way, second);
                }
                r
            }
            Shape::Planned(spline) => {
                const STEP: f64 = 1e-3;
                let (before, r, after) = (spline.at(t - STEP), spline.at(t), spline.at(t + STEP));
                let yaw_rate = (after.yaw_rad - before.yaw_rad) * 0.5 / STEP;
                Reference { p: r.pos_m, v: r.vel_m_s, a: r.acc_m_s2, yaw: r.yaw_rad, yaw_rate, dither: 0.0 }
            }
            _ => {
                const STEP: f64 = 1e-3;
                let (before, now, after) = (self.curve(t - STEP), self.curve(t), self.curve(t + STEP));
                Reference {
                    p: now.0,
                    v: mul(sub(after.0, before.0), 0.5 / STEP),
                    a: mul(sub(add(after.0, before.0), mul(now.0, 2.0)), 1.0 / (STEP * STEP)),
                    yaw: now.1,
                    yaw_rate: (after.1 - before.1) * 0.5 / STEP,
                    dither: 0.0,
                }
            }
        }
    }

    /// Place and yaw on a closed curve, which is entered within 2 s from rest.
    fn curve(&self, t: f64) -> (V, f64) {
        const ENTRY_S: f64 = 2.0;
        let run = if t < 0.0 {
            0.0
        } else if t < ENTRY_S {
            t * t / (2.0 * ENTRY_S)
        } else {
            t - 0.5 * ENTRY_S
        };
        match &self.shape {
            Shape::Lissajous { size, period_s, at, turn } => {
                let angle = TAU * run / period_s;
                let p = [
                    size[0] * angle.sin(),
                    size[1] * (2.0 * angle).sin(),
                    size[2] * (1.0 - (2.0 * angle).cos()),
                ];
                (add(*at, p), turn * (0.5 * angle).sin())
            }
            Shape::Circle { radius, period_s, at } => {
                let angle = TAU * run / period_s;
                (add(*at, [radius * angle.cos(), radius * angle.sin(), 0.0]), 0.0)
            }
            Shape::Legs(_) | Shape::Planned(_) => ([0.0; 3], 0.0),
        }
    }
}

impl Manner {
    /// Whether legs are fast enough to see the effects of the air.
    fn is_exciting(&self) -> bool {
        self.speed_m_s[1] > 2.5
    }

    fn height(&self, s: &mut Stream) -> f64 {
        let range = if s.unit() < self.inside { self.height_m } else { self.else_m };
        s.uniform(range[0], range[1])
    }

    fn place(&self, s: &mut Stream) -> V {
        [s.uniform(-self.half_m, self.half_m), s.uniform(-self.half_m, self.half_m), self.height(s)]
    }
}

/// What the next leg does, from a place and a yaw on.
struct Move {
    to: V,
    yaw_to: f64,
    time_s: f64,
    jump: bool,
    /// Share of the dither.
    share: f64,
}

/// A fast run through the box.
fn fast_run(s: &mut Stream, manner: &Manner, at: V, yaw: f64) -> Move {
    let mut to = manner.place(s);
    for _ in 0..6 {
        let other = manner.place(s);
        if norm(sub(other, at)) > norm(sub(to, at)) {
            to = other;
        }
    }
    let way = norm(sub(to, at));
    let low = 0.5 * (manner.speed_m_s[0] + manner.speed_m_s[1]);
    let peak = s.uniform(low, manner.speed_m_s[1]);
    // Peak speed 1.875 d/T, peak acceleration 5.77 d/T² of at most 7 m/s².
    let time_s = (1.875 * way / peak).max((5.77 * way / 7.0).sqrt());
    Move { to, yaw_to: yaw + s.uniform(-1.0, 1.0), time_s, jump: false, share: 0.6 }
}

/// A jump of the reference.
fn jump(s: &mut Stream, manner: &Manner, at: V, yaw: f64) -> Move {
    let mut to = at;
    let reach = 0.7f64.min(0.5 * manner.half_m);
    for i in 0..2 {
        to[i] = (at[i] + s.uniform(-reach, reach)).clamp(-manner.half_m, manner.half_m);
    }
    let low = manner.height_m[1] < 0.6 || manner.height_m[0] > 2.0;
    to[2] = if low { manner.height(s) } else { (at[2] + s.uniform(-0.6, 0.6)).clamp(1.0, 3.9) };
    // A jump down to the ground or up to the ceiling would end in it.
    let jump = (to[2] - at[2]).abs() < 0.7 && !low;
    Move { to, yaw_to: yaw + s.uniform(-0.6, 0.6), time_s: s.uniform(0.9, 1.4), jump, share: 1.0 }
}

/// A turn about yaw on the spot.
fn turn(s: &mut Stream, manner: &Manner, at: V, yaw: f64) -> Move {
    let rate = if manner.is_exciting() { s.uniform(1.0, 2.0) } else { s.uniform(0.3, 1.0) };
    let turn = s.uniform(0.8, 1.6) * PI;
    let yaw_to = if s.below(2) == 0 { yaw + turn } else { yaw - turn };
    Move { to: at, yaw_to, time_s: 1.875 * turn / rate * 0.6, jump: false, share: 1.0 }
}

fn slow_run(s: &mut Stream, manner: &Manner, at: V, yaw: f64) -> Move {
    let other = manner.place(s);
    let way = sub(other, at);
    let mut to = add(at, mul(way, (2.0 / norm(way).max(1e-9)).min(1.0)));
    to[2] = other[2];
    let peak = s.uniform(manner.speed_m_s[0], 0.35 * manner.speed_m_s[1].max(2.5));
    let time_s = (1.875 * norm(sub(to, at)) / peak).max(0.6);
    Move { to, yaw_to: yaw + s.uniform(-0.8, 0.8), time_s, jump: false, share: 1.0 }
}

/// Random legs: fast and slow runs, jumps of the reference, and turns on the spot.
fn legs(s: &mut Stream, seconds: f64, manner: &Manner) -> Shape {
    let mut at =
        [s.uniform(-0.5, 0.5), s.uniform(-0.5, 0.5), 0.5 * (manner.height_m[0] + manner.height_m[1])];
    let mut yaw: f64 = s.uniform(-PI, PI);
    let (mut out, mut t) = (Vec::new(), 0.0);
    let mut round = s.below(4);
    while t < seconds {
        let next = match round % 4 {
            0 => fast_run(s, manner, at, yaw),
            1 if manner.is_exciting() => jump(s, manner, at, yaw),
            2 => turn(s, manner, at, yaw),
            _ => slow_run(s, manner, at, yaw),
        };
        round += 1;
        out.push(Leg {
            start_s: t,
            end_s: t + next.time_s,
            from: at,
            to: next.to,
            yaw: [yaw, next.yaw_to],
            jump: next.jump,
            dither: manner.dither * next.share,
        });
        t += next.time_s + s.uniform(0.1, 0.5);
        at = next.to;
        yaw = next.yaw_to;
    }
    Shape::Legs(out)
}

/// Sums of sines on the body rates and on the collective thrust.
#[derive(Clone, Debug)]
pub struct Dither {
    /// (rad/s of the tone, amplitude, phase) for roll, pitch, yaw rate and thrust.
    tones: [Vec<[f64; 3]>; 4],
}

impl Dither {
    /// The dither of one flight; `low` leaves out slow tones of thrust, which would move the height.
    pub fn new(seed: u64, flight: u64, low: bool) -> Self {
        let mut s = stream(seed, flight, "dither");
        let floor = if low { 1.6 } else { 0.7 };
        // Lowest and highest tone (Hz), number of tones, amplitude of each (rad/s, or share of thrust).
        let make = [(0.5, 8.0, 8, 0.55), (0.5, 8.0, 8, 0.55), (0.3, 4.0, 7, 0.55), (floor, 8.0, 7, 0.075)];
        let tones = make.map(|(low, high, n, amplitude): (f64, f64, usize, f64)| {
            (0..n)
                .map(|k| {
                    let place = (k as f64 + s.uniform(0.1, 0.9)) / n as f64;
                    let hz = low * (high / low).powf(place);
                    [TAU * hz, amplitude * s.uniform(0.8, 1.2), s.uniform(0.0, TAU)]
                })
                .collect()
        });
        Self { tones }
    }

    /// The sum number `k` integrated over time, an angle.
    fn angle(&self, k: usize, t: f64) -> f64 {
        self.tones[k].iter().map(|[w, a, phase]| -a / w * (w * t + phase).cos()).sum()
    }

    /// Value and derivative of the sum number `k`.
    fn at(&self, k: usize, t: f64) -> (f64, f64) {
        self.tones[k].iter().fold((0.0, 0.0), |(v, d), [w, a, phase]| {
            let (sin, cos) = (w * t + phase).sin_cos();
            (v + a * sin, d + a * w * cos)
        })
    }
}

/// Motors that are quicker than this get the full gains; gains of slower ones fall with their time, s.
const QUICK_S: f64 = 0.036;

/// Angular acceleration about x, y, z (rad/s²) that all rotors together make at hover, of a vehicle that dither and gains were
/// tuned for; less nimble vehicles get less dither and are not asked for more than [`ASKED`] of what they can.
const NIMBLE_RAD_S2: V = [200.0, 200.0, 20.0];
/// Share of that angular acceleration about x, y, z; together with a thrust that comes down it is about all that there is.
const ASKED: V = [0.5, 0.5, 0.25];
/// Share of it that a trim may take.
const TRIM: f64 = 0.3;

/// The on-board controller: position, attitude and rate errors to rotor speeds through the nominal vehicle.
#[derive(Clone, Debug)]
pub struct Pilot {
    mass_kg: f64,
    inertia: [V; 3],
    gravity: V,
    /// Thrust of each rotor per collective thrust and torque about x, y, z.
    mix: Vec<[f64; 4]>,
    curves: Vec<V>,
    /// Share of the gains of a vehicle with quick motors.
    pace: f64,
    /// Share of the dither about x, y, z of a nimble vehicle, and greatest angular acceleration that is asked for, rad/s².
    nimble: V,
    most: V,
    /// What all rotors together make at hover, rad/s².
    can: V,
    /// Angular acceleration that holds against what the vehicle file does not know, rad/s²; only of vehicles with slow motors,
    /// whose gains are too low to do without.
    trim: V,
    thrust_n: [f64; 2],
    limits: [f64; 2],
    dither: Option<Dither>,
    integral: V,
    stream: Stream,
    /// Whether the dither goes through the attitude commands, so that all that moves the vehicle stands in them.
    through_attitude: bool,
    /// What was wanted last.
    pub wanted: Wanted,
}

/// What the outer loop wants of the inner one.
#[derive(Clone, Copy, Debug, Default)]
pub struct Wanted {
    /// Roll, pitch, yaw, rad.
    pub attitude_rad: V,
    /// Collective thrust, N.
    pub thrust_n: f64,
}

impl Pilot {
    /// The controller of a vehicle as filed.
    ///
    /// # Errors
    /// A sentence where the rotors cannot make thrust and torque about all axes.
    pub fn new(
        nominal: &Nominal,
        dither: Option<Dither>,
        through_attitude: bool,
        stream: Stream,
    ) -> Result<Self, String> {
        let one = |r: &TrueRotor| {
            let hover = nominal.hover_rad_s();
            let ratio = (r.torque[1] * hover + r.torque[2] * hover * hover) / nominal.hover_n();
            let arm = cross(r.at_m, r.axis);
            let torque = add(arm, mul(r.axis, r.spin * ratio));
            [r.axis[2], torque[0], torque[1], torque[2]]
        };
        let effect: Vec<[f64; 4]> = nominal.rotors.iter().map(one).collect();
        let can: V = std::array::from_fn(|k| {
            let torque: f64 = effect.iter().map(|e| e[k + 1].abs()).sum::<f64>() * nominal.hover_n();
            torque / nominal.inertia[k][k]
        });
        let nimble: V = std::array::from_fn(|k| (can[k] / NIMBLE_RAD_S2[k]).min(1.0));
        let most = std::array::from_fn(|k| if nimble[k] < 1.0 { ASKED[k] * can[k] } else { f64::INFINITY });
        Ok(Self {
            mass_kg: nominal.mass_kg,
            inertia: nominal.inertia,
            gravity: nominal.gravity,
            mix: mix(&effect)?,
            curves: nominal.rotors.iter().map(|r| r.thrust).collect(),
            pace: (QUICK_S / nominal.lag_s()).min(1.0),
            thrust_n: nominal.limits.map(|w| super::world::curve(nominal.rotors[0].thrust, w)),
            limits: nominal.limits,
            dither,
            integral: [0.0; 3],
            stream,
            nimble,
            most,
            can,
            trim: [0.0; 3],
            through_attitude,
            wanted: Wanted::default(),
        })
    }

    /// Share of the turns of a nimble vehicle that this one can fly.
    pub fn turns(&self) -> f64 {
        self.nimble[2]
    }

    /// Trims a vehicle that turns with `ang` (rad/s²) under the rotor speeds of hover, as one that has flown before.
    pub fn trim(&mut self, ang: V) {
        if self.pace < 1.0 {
            self.trim = mul(ang, -1.0);
        }
    }

    /// Rotor speeds for one tick of `dt` s.
    pub fn command(&mut self, t: f64, dt: f64, x: &State, r: &Reference) -> Speeds {
        let mut noise = |sigma: f64| -> V { std::array::from_fn(|_| sigma * self.stream.normal()) };
        let p = add(part(x, 0), noise(1e-3));
        let w = add(part(x, 10), noise(0.01));
        let turn = matrix(attitude(x));
        let e = sub(r.p, p).map(|e| e.clamp(-1.2, 1.2));
        for i in 0..3 {
            self.integral[i] = (self.integral[i] + e[i] * dt).clamp(-3.0, 3.0);
        }
        let e_v = sub(r.v, part(x, 7)).map(|e| e.clamp(-4.0, 4.0));
        let pace = self.pace;
        let (k_p, k_v, k_i) = (5.0 * pace * pace, 3.6 * pace, 1.2 * pace * pace * pace);
        let mut acc: V = std::array::from_fn(|i| r.a[i] + k_p * e[i] + k_v * e_v[i] + k_i * self.integral[i]);
        let level = acc[0].hypot(acc[1]);
        if level > 9.0 {
            acc[0] *= 9.0 / level;
            acc[1] *= 9.0 / level;
        }
        acc[2] = acc[2].clamp(-5.5, 7.5);
        let push = sub(acc, self.gravity);

        // The wanted attitude: z along the wanted force, x towards the wanted yaw.
        let z = unit(push);
        let y = unit(cross(z, [r.yaw.cos(), r.yaw.sin(), 0.0]));
        let x_axis = cross(y, z);
        let dither = self.dither.as_ref().filter(|_| r.dither > 0.0);
        let (x_axis, y, z) = match dither.filter(|_| self.through_attitude) {
            Some(dither) => {
                let by: V = std::array::from_fn(|k| r.dither * pace * self.nimble[k] * dither.angle(k, t));
                let turned = matrix(quat_exp(by));
                let column = |k: usize| {
                    let [a, b, c] = [turned[0][k], turned[1][k], turned[2][k]];
                    add(add(mul(x_axis, a), mul(y, b)), mul(z, c))
                };
                (column(0), column(1), column(2))
            }
            None => (x_axis, y, z),
        };
        self.wanted.attitude_rad =
            [y[2].atan2(z[2]), -x_axis[2].clamp(-1.0, 1.0).asin(), x_axis[1].atan2(x_axis[0])];
        let wanted = |v: V| add(add(mul(x_axis, v[0]), mul(y, v[1])), mul(z, v[2]));
        // Half of vee(Rdᵀ R − Rᵀ Rd), by columns.
        let columns: [V; 3] =
            [mat_vec(turn, [1.0, 0.0, 0.0]), mat_vec(turn, [0.0, 1.0, 0.0]), mat_vec(turn, [0.0, 0.0, 1.0])];
        let goals = [wanted([1.0, 0.0, 0.0]), wanted([0.0, 1.0, 0.0]), wanted([0.0, 0.0, 1.0])];
        let entry = |i: usize, j: usize| dot(goals[i], columns[j]) - dot(columns[i], goals[j]);
        let error = [0.5 * entry(2, 1), 0.5 * entry(0, 2), 0.5 * entry(1, 0)];

        let mut rate = [-5.5 * pace * error[0], -5.5 * pace * error[1], -2.5 * pace * error[2]];
        rate = add(rate, mat_t_vec(turn, [0.0, 0.0, r.yaw_rate]));
        let (mut spin_up, mut gain) = ([0.0; 3], 1.0);
        if let Some(dither) = dither {
            for k in 0..if self.through_attitude { 0 } else { 3 } {
                let (v, d) = dither.at(k, t);
                rate[k] += r.dither * pace * self.nimble[k] * v;
                spin_up[k] = r.dither * pace * self.nimble[k] * d;
            }
            gain += r.dither * dither.at(3, t).0;
        }
        rate = [rate[0].clamp(-6.0, 6.0), rate[1].clamp(-6.0, 6.0), rate[2].clamp(-3.0, 3.0)];
        const RATE_GAIN_PER_S: V = [15.0, 15.0, 8.0];
        let ang: V = std::array::from_fn(|i| spin_up[i] + RATE_GAIN_PER_S[i] * pace * (rate[i] - w[i]));
        if pace < 1.0 {
            // Proportional and integral, with an integral time of half a second.
            for i in 0..3 {
                // Where more is wanted than there is, a trim would only wind up.
                if (ang[i] + self.trim[i]).abs() < self.most[i] {
                    let more = 2.0 * dt * RATE_GAIN_PER_S[i] * pace * (rate[i] - w[i]);
                    self.trim[i] = (self.trim[i] + more).clamp(-TRIM * self.can[i], TRIM * self.can[i]);
                }
            }
        }
        let ang: V = std::array::from_fn(|i| (ang[i] + self.trim[i]).clamp(-self.most[i], self.most[i]));
        let torque = add(mat_vec(self.inertia, ang), cross(w, mat_vec(self.inertia, w)));
        let weight = self.mass_kg * norm(self.gravity);
        let collective = (gain * self.mass_kg * dot(push, columns[2])).clamp(0.25 * weight, 1.8 * weight);
        self.wanted.thrust_n = collective;
        self.share(collective, torque)
    }

    /// Thrust and torque to rotor speeds; where rotors come to their limits, yaw gives way first.
    fn share(&self, collective: f64, torque: V) -> Speeds {
        let n = self.curves.len();
        let of = |yaw: f64| -> Speeds {
            let wanted = [collective, torque[0], torque[1], yaw * torque[2]];
            let one = |mix: &[f64; 4]| (0..4).map(|k| mix[k] * wanted[k]).sum::<f64>();
            std::array::from_fn(|i| self.mix.get(i).map_or(0.0, one))
        };
        let inside = |all: &Speeds| all[..n].iter().all(|n| *n >= self.thrust_n[0] && *n <= self.thrust_n[1]);
        let mut thrusts = of(1.0);
        for yaw in [0.6, 0.3, 0.0] {
            if inside(&thrusts) {
                break;
            }
            thrusts = of(yaw);
        }
        let speed =
            |i: usize| speed_for(self.curves[i], thrusts[i].max(0.0)).clamp(self.limits[0], self.limits[1]);
        std::array::from_fn(|i| if i < n { speed(i) } else { 0.0 })
    }
}

/// Thrusts of least squares for a wanted collective thrust and torque, by what each rotor does.
fn mix(effect: &[[f64; 4]]) -> Result<Vec<[f64; 4]>, String> {
    let n = effect.len();
    // With four rotors the square matrix itself, else E Eᵀ: thrusts = Eᵀ (E Eᵀ)⁻¹ wanted.
    let gram =
        |j: usize, k: usize| if n == 4 { effect[k][j] } else { effect.iter().map(|e| e[j] * e[k]).sum() };
    let square: [[f64; 4]; 4] = std::array::from_fn(|j| std::array::from_fn(|k| gram(j, k)));
    let mut mix = vec![[0.0; 4]; n];
    for k in 0..4 {
        let mut wanted = [0.0; 4];
        wanted[k] = 1.0;
        let column = solve4(square, wanted).ok_or_else(|| {
            "expected rotors that can make thrust and torque about all axes, found others: choose another vehicle"
                .to_string()
        })?;
        for (i, row) in mix.iter_mut().enumerate() {
            row[k] = if n == 4 { column[i] } else { (0..4).map(|j| effect[i][j] * column[j]).sum() };
        }
    }
    Ok(mix)
}
