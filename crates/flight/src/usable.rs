//! What of a log no flight model can explain: the vehicle on the ground, motors off, a crash, gaps, outliers.
//!
//! [`look`] needs the log alone. `log check` says what it finds; the gap finder leaves it out.

use super::clean::{median, quantile};
use super::stray::{self, Strays};
use super::{Channel, FlightLog};
use propwash_trace::math::{quat, vec3};
use propwash_trace::units::STANDARD_GRAVITY_M_S2 as G;
use serde::Serialize;

/// Why a part is left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Reason {
    /// The vehicle stands, takes off or lands.
    OnGround,
    /// Motors are switched off in the air, or their sensors all read nothing.
    MotorsOff,
    /// The vehicle hits something.
    Crash,
    /// A channel jumps and stays.
    Outliers,
    /// A channel has no new samples.
    Dropout,
}

/// A span that is left out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Excluded {
    /// Why.
    pub reason: Reason,
    /// From, s.
    pub from_s: f64,
    /// To, s.
    pub to_s: f64,
    /// Channel that has the fault; empty where the vehicle as a whole is meant.
    pub channel: &'static str,
}

impl Excluded {
    /// Whether nothing of the log counts within the span: in a gap of one channel the others go on.
    pub fn whole(&self) -> bool {
        self.reason != Reason::Dropout
    }

    /// Whether the state of the vehicle is not known within the span.
    pub fn hides_state(&self) -> bool {
        self.whole() || matches!(self.channel, "position" | "attitude" | "angular velocity")
    }
}

/// Outliers of one channel.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ChannelOutliers {
    /// Channel.
    pub channel: &'static str,
    /// Times of the outliers, s.
    pub t_s: Vec<f64>,
    /// Samples of the channel.
    pub of: usize,
}

/// All that is left out of a log.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Unusable {
    /// Spans by reason, then by time.
    pub excluded: Vec<Excluded>,
    /// Outliers of channels that have any.
    pub outliers: Vec<ChannelOutliers>,
}

/// What is known of the vehicle; nothing by default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Known {
    /// Rotor speed in hover, rad/s.
    pub hover_rotor_rad_s: Option<f64>,
    /// Thrust in hover, N.
    pub hover_thrust_n: Option<f64>,
}

/// Distance of the instants that are looked at, s.
const GRID_S: f64 = 0.01;
/// The vehicle stands where it is slower than this, m/s and rad/s, over [`STILL_HALF_S`] each side with motors well below
/// hover. A vehicle that falls is faster after a tenth of a second.
const STILL_M_S: f64 = 0.1;
const STILL_RAD_S: f64 = 0.3;
const STILL_HALF_S: f64 = 0.15;
/// A vehicle that stands still feels its weight: share by which a specific force may differ from 1 g (scale, bias).
const STILL_FORCE: f64 = 0.2;
/// Thrust over that of hover below which nothing flies for long.
const LOW: f64 = 0.5;
/// Shortest time of standing, s.
const SHORTEST_STAND_S: f64 = 0.3;
/// The vehicle still stands, its motors at any speed, while it is still within this of where it stood: m, rad. Legs give.
const SAME_PLACE_M: f64 = 0.03;
const SAME_LEAN_RAD: f64 = 0.06;
/// Before it stands and after: contact, and the ground's effect on the rotors, s.
const MARGIN_S: f64 = 0.3;
/// Thrust of every rotor over that of hover up to which motors count as off: the hardest working rotor of thirteen real logs
/// stays above 0.8, that of hard manoeuvres falls to 0.04 for 18 ms.
const OFF: f64 = 0.15;
/// The same of measured speeds or thrusts, which can be modelled while they are measured: only what reads nothing is left out
/// (5 % of the speed of hover).
const READS_NOTHING: f64 = 0.0025;
/// Shortest time for which motors are off, s; speed controllers need as long again to start them.
const SHORTEST_OFF_S: f64 = 0.05;
const RESTART_S: f64 = 0.1;
/// Times the most that rotors can do beyond which a specific force is a blow.
const BLOW: f64 = 3.0;
/// Rotors are trusted with at least this, g.
const LEAST_MOST_G: f64 = 2.0;
/// Half width of the slopes before and after a blow, s.
const BLOW_HALF_S: f64 = 0.05;
/// Time before and after a crash that is left out where the vehicle flies on, s, and for which it must fly on.
const CRASH_MARGIN_S: [f64; 2] = [0.3, 0.5];
const FLIES_ON_S: f64 = 2.0;
/// A gap is longer than this many times the usual step, and than this many times what 19 of 20 steps stay below (held values
/// make long steps ordinary).
const GAP_PERIODS: f64 = 4.5;
const GAP_OF_MOST: f64 = 2.0;
/// A held value was stuck where it goes on by more than so many usual steps of its channel. In a hover coarse values stay for a
/// tenth of a second because nothing moves (1 mm in the Crazyflie's logs), and go on by one or two.
const HELD_JUMP: f64 = 4.0;
/// Shortest gap, s.
const SHORTEST_GAP_S: f64 = 5e-3;
/// Least size of an outlier: position, m; attitude, rad; body rate, rad/s; specific force, m/s². Below, robust weights do
/// better than cutting.
const LEAST_OUTLIER: [f64; 4] = [4e-3, 0.01, 0.5, 5.0];

/// Finds what of a log cannot be used.
pub fn look(log: &FlightLog, known: &Known) -> Unusable {
    let mut out = Unusable::default();
    let position = distinct(&log.position_m);
    let attitude = distinct(&log.attitude);
    let gyro = distinct(&log.angular_velocity_rad_s);
    let accel = distinct(&log.specific_force_m_s2);
    let rising = |t: &[f64]| t.windows(2).all(|w| w[1] > w[0]);
    if !(rising(&log.position_m.t_s)
        && rising(&log.attitude.t_s)
        && position.len() > 20
        && attitude.len() > 20)
    {
        return out;
    }
    let ((of_position, of_attitude), (of_gyro, of_accel)) = rayon::join(
        || {
            rayon::join(
                || stray::of_vectors(&position, LEAST_OUTLIER[0]),
                || stray::of_attitudes(&attitude, LEAST_OUTLIER[1]),
            )
        },
        || {
            rayon::join(
                || stray::of_vectors(&gyro, LEAST_OUTLIER[2]),
                || stray::of_vectors(&accel, LEAST_OUTLIER[3]),
            )
        },
    );
    let strays = [
        ("position", of_position, &position.t_s),
        ("attitude", of_attitude, &attitude.t_s),
        ("angular velocity", of_gyro, &gyro.t_s),
        ("specific force", of_accel, &accel.t_s),
    ];
    let clean = Clean {
        position: super::clean::without(&position, &strays[0].1.marks),
        attitude: super::clean::without(&attitude, &strays[1].1.marks),
        gyro: super::clean::without(&gyro, &strays[2].1.marks),
        accel: accel.clone(),
        drives: drives(log, known),
    };
    let grid = clean.grid();
    let ground = clean.ground(&grid);
    out.excluded.extend(clean.off(&grid, &ground));
    // The blow of a hard landing is part of it.
    let lands = |e: &Excluded| ground.iter().any(|g| e.from_s >= g.from_s && e.to_s <= g.to_s);
    out.excluded.extend(clean.crash(&grid, &ground).into_iter().filter(|e| !lands(e)));
    out.excluded.extend(ground);
    for (channel, strays, _) in &strays[..2] {
        for [from_s, to_s] in &strays.jumps_s {
            out.excluded.push(Excluded { reason: Reason::Outliers, from_s: *from_s, to_s: *to_s, channel });
        }
    }
    let said = out.excluded.clone();
    let inside =
        |from: f64, to: f64| said.iter().any(|e| from >= e.from_s - MARGIN_S && to <= e.to_s + MARGIN_S);
    let mut add = |channel: &'static str, list: Vec<[f64; 2]>| {
        for [from_s, to_s] in list.into_iter().filter(|[from, to]| !inside(*from, *to)) {
            out.excluded.push(Excluded { reason: Reason::Dropout, from_s, to_s, channel });
        }
    };
    add("position", gaps(&log.position_m, |a, b| vec3::norm(vec3::sub(a, b))));
    add("attitude", gaps(&log.attitude, angle));
    add("angular velocity", gaps(&log.angular_velocity_rad_s, |a, b| vec3::norm(vec3::sub(a, b))));
    add("specific force", gaps(&log.specific_force_m_s2, |a, b| vec3::norm(vec3::sub(a, b))));
    // An input may be constant: only its missing rows are gaps.
    for (channel, list) in inputs(log) {
        add(channel, list.first().map(|c| missing(&c.t_s)).unwrap_or_default());
    }
    for (channel, Strays { marks, .. }, t) in &strays {
        let hit = |at: f64| said.iter().any(|e| e.whole() && at >= e.from_s && at <= e.to_s);
        let t_s: Vec<f64> = (0..marks.len()).filter(|i| marks[*i] && !hit(t[*i])).map(|i| t[i]).collect();
        if !t_s.is_empty() {
            out.outliers.push(ChannelOutliers { channel, t_s, of: marks.len() });
        }
    }
    out.excluded.sort_by(|a, b| a.reason.cmp(&b.reason).then(a.from_s.total_cmp(&b.from_s)));
    out
}

/// The samples that differ from the one before.
fn distinct<const N: usize>(c: &Channel<N>) -> Channel<N> {
    let held: Vec<bool> = (0..c.len()).map(|i| i > 0 && c.values[i] == c.values[i - 1]).collect();
    super::clean::without(c, &held)
}

/// Inputs of a model by name; rotors are sampled together.
fn inputs(log: &FlightLog) -> [(&'static str, &[Channel<1>]); 4] {
    let one = std::slice::from_ref;
    [
        ("thrust", one(&log.thrust_n)),
        ("thrust command", one(&log.cmd_thrust_n)),
        ("rotor speeds", log.rotor_speed_rad_s.as_slice()),
        ("rotor commands", log.cmd_rotor_rad_s.as_slice()),
    ]
}

/// Steps that are much longer than the others.
fn missing(t: &[f64]) -> Vec<[f64; 2]> {
    let steps: Vec<f64> = t.windows(2).map(|w| w[1] - w[0]).collect();
    let (Some(usual), Some(most)) = (median(steps.clone()), quantile(&steps, 0.95)) else {
        return Vec::new();
    };
    let limit = (GAP_PERIODS * usual).max(GAP_OF_MOST * most).max(SHORTEST_GAP_S);
    t.windows(2).filter(|w| w[1] - w[0] > limit).map(|w| [w[0], w[1]]).collect()
}

/// Missing rows, and values that are held for long and then jump. A coarse value that stays because nothing moves goes on by one
/// digit.
fn gaps<const N: usize>(c: &Channel<N>, apart: impl Fn([f64; N], [f64; N]) -> f64) -> Vec<[f64; 2]> {
    let new = distinct(c);
    let moves: Vec<f64> = new.values.windows(2).map(|w| apart(w[0], w[1])).collect();
    let usual = median(moves.clone()).unwrap_or(0.0);
    let rows = missing(&c.t_s);
    let at = |t: f64| new.t_s.partition_point(|x| *x < t).min(moves.len().saturating_sub(1));
    let jumps = |s: &[f64; 2]| moves.get(at(s[0])).is_some_and(|m| *m > HELD_JUMP * usual);
    let mut held: Vec<[f64; 2]> = missing(&new.t_s).into_iter().filter(jumps).collect();
    held.retain(|h| !rows.iter().any(|r| r[0] < h[1] && r[1] > h[0]));
    held.extend(rows);
    held.sort_by(|a, b| a[0].total_cmp(&b[0]));
    held
}

/// One thing that says how hard the motors work.
struct DriveLevel {
    /// Whether it is a command.
    commanded: bool,
    /// Thrust over that of hover: mean of the rotors, and the hardest working one.
    level: Channel<2>,
}

/// All that says how hard the motors work, the most trustworthy first.
fn drives(log: &FlightLog, known: &Known) -> Vec<DriveLevel> {
    let mut out = Vec::new();
    let mut add = |commanded: bool, list: &[Channel<1>], power: i32, hover: Option<f64>| {
        let Some(first) = list.first().filter(|c| c.len() >= 20 && c.is_ordered()) else { return };
        let mut raw = Channel::<2>::default();
        for t in &first.t_s {
            let (mut sum, mut most) = (0.0, f64::NEG_INFINITY);
            for c in list {
                let x = before(c, *t).map_or(0.0, |v| v[0].max(0.0).powi(power));
                sum += x;
                most = f64::max(most, x);
            }
            raw.push(*t, [sum / list.len() as f64, most]);
        }
        let hover = hover.map(|h| h.powi(power));
        if let Some(usual) = usual_in_flight(&raw.component(0), hover) {
            out.push(DriveLevel { commanded, level: raw.map(|v| v.map(|x| x / usual)) });
        }
    };
    let one = std::slice::from_ref;
    add(false, &log.rotor_speed_rad_s, 2, known.hover_rotor_rad_s);
    add(false, one(&log.thrust_n), 1, known.hover_thrust_n);
    add(true, &log.cmd_rotor_rad_s, 2, known.hover_rotor_rad_s);
    add(true, one(&log.cmd_thrust_n), 1, known.hover_thrust_n);
    add(true, &log.cmd_u, 2, None);
    out
}

/// Thrust in the middle of what is flight: a vehicle file may be off by a factor, the middle of a flight is about its weight.
fn usual_in_flight(levels: &[f64], hover: Option<f64>) -> Option<f64> {
    let above = |least: f64| -> Vec<f64> { levels.iter().copied().filter(|x| *x > least).collect() };
    // A hundredth of a log in flight is told by the vehicle, a twentieth without it.
    let flight = hover
        .map(|h| above(0.25 * h))
        .filter(|list| list.len() * 100 > levels.len())
        .unwrap_or_else(|| above(0.25 * quantile(levels, 0.97).unwrap_or(0.0)));
    median(flight).filter(|m| *m > 0.0)
}

/// The sample at or before a time.
fn before<const N: usize>(c: &Channel<N>, at: f64) -> Option<&[f64; N]> {
    c.values.get(c.t_s.partition_point(|t| *t <= at).saturating_sub(1))
}

/// Mean of the samples within a span.
fn mean<const N: usize>(c: &Channel<N>, from: f64, to: f64) -> Option<[f64; N]> {
    let a = c.t_s.partition_point(|t| *t < from);
    let b = c.t_s.partition_point(|t| *t <= to);
    let n = (b > a).then(|| (b - a) as f64)?;
    Some(std::array::from_fn(|k| c.values[a..b].iter().map(|v| v[k]).sum::<f64>() / n))
}

/// Channels without held samples and outliers, with how hard the motors work.
struct Clean {
    position: Channel<3>,
    attitude: Channel<4>,
    gyro: Channel<3>,
    accel: Channel<3>,
    drives: Vec<DriveLevel>,
}

impl Clean {
    fn grid(&self) -> Vec<f64> {
        let t = &self.position.t_s;
        super::resample::grid(t[0], t[t.len() - 1], GRID_S)
    }

    /// Thrust over that of hover at a time.
    fn level(&self, at: f64) -> Option<f64> {
        before(&self.drives.first()?.level, at).map(|v| v[0])
    }

    /// Whether the vehicle does not move around a time. What is held does not change either: then the last value counts.
    fn still(&self, at: f64) -> bool {
        let ends =
            [[at - STILL_HALF_S, at - STILL_HALF_S / 3.0], [at + STILL_HALF_S / 3.0, at + STILL_HALF_S]];
        let place =
            |[from, to]: [f64; 2]| mean(&self.position, from, to).or(before(&self.position, to).copied());
        let apart_s = 4.0 / 3.0 * STILL_HALF_S;
        let (Some(a), Some(b)) = (place(ends[0]), place(ends[1])) else { return false };
        if vec3::norm(vec3::sub(b, a)) > STILL_M_S * apart_s {
            return false;
        }
        let (from, to) = (at - STILL_HALF_S, at + STILL_HALF_S);
        let turning = match mean(&self.gyro, from, to) {
            Some(w) => vec3::norm(w),
            None => match (before(&self.attitude, from), before(&self.attitude, to)) {
                (Some(a), Some(b)) => angle(*a, *b) / (to - from),
                _ => 0.0,
            },
        };
        let weight = mean(&self.accel, from, to).map_or(1.0, |a| vec3::norm(a) / G);
        turning < STILL_RAD_S && (weight - 1.0).abs() < STILL_FORCE
    }

    /// Where the vehicle stands, from when its motors run down to when it has left the place.
    fn ground(&self, grid: &[f64]) -> Vec<Excluded> {
        let low: Vec<bool> = grid.iter().map(|t| self.level(*t).is_some_and(|l| l < LOW)).collect();
        if !low.contains(&true) {
            return Vec::new();
        }
        let still: Vec<bool> = grid.iter().map(|t| self.still(*t)).collect();
        let shortest = (SHORTEST_STAND_S / GRID_S) as usize;
        let n = grid.len();
        let mut spans: Vec<[f64; 2]> = Vec::new();
        for (first, last) in runs(n, shortest, |i| low[i] && still[i]) {
            let middle = grid[(first + last) / 2];
            let place =
                mean(&self.position, grid[first], grid[last]).or(before(&self.position, middle).copied());
            let lean = before(&self.attitude, middle).copied();
            let here = |i: usize| {
                let near = |c: Option<&[f64; 3]>| {
                    c.zip(place).is_some_and(|(a, b)| vec3::norm(vec3::sub(*a, b)) < SAME_PLACE_M)
                };
                let upright = before(&self.attitude, grid[i])
                    .zip(lean)
                    .is_some_and(|(a, b)| tilt(*a, b) < SAME_LEAN_RAD);
                still[i] && near(before(&self.position, grid[i])) && upright
            };
            let (mut a, mut b) = (first, last);
            while a > 0 && (low[a - 1] || here(a - 1)) {
                a -= 1;
            }
            while b + 1 < n && (low[b + 1] || here(b + 1)) {
                b += 1;
            }
            let (from, to) = (grid[a] - MARGIN_S, grid[b] + MARGIN_S);
            match spans.last_mut() {
                Some(s) if from <= s[1] => s[1] = to,
                _ => spans.push([from, to]),
            }
        }
        self.spans(Reason::OnGround, spans)
    }

    fn spans(&self, reason: Reason, spans: Vec<[f64; 2]>) -> Vec<Excluded> {
        let t = &self.position.t_s;
        let (first, last) = (t[0], t[t.len() - 1]);
        // What begins or ends the log is told to its end.
        let clip = |x: f64| x.clamp(first, last);
        spans
            .into_iter()
            .map(|[a, b]| Excluded { reason, from_s: clip(a), to_s: clip(b), channel: "" })
            .collect()
    }

    /// Where motors are switched off in the air. Measured speeds can be modelled however slow they are, as long as the sensors
    /// read something; what a speed controller makes of a command of nothing, and how it starts again, is in no motor model.
    fn off(&self, grid: &[f64], ground: &[Excluded]) -> Vec<Excluded> {
        let stands = |t: f64| ground.iter().any(|e| t >= e.from_s && t <= e.to_s);
        let least = |d: &DriveLevel| if d.commanded { OFF } else { READS_NOTHING };
        let off = |t: f64| {
            self.drives.iter().any(|d| before(&d.level, t).is_some_and(|v| v[1] <= least(d))) && !stands(t)
        };
        let shortest = (SHORTEST_OFF_S / GRID_S) as usize + 1;
        let spans = runs(grid.len(), shortest, |i| off(grid[i]))
            .into_iter()
            .map(|(a, b)| [grid[a], grid[b] + RESTART_S])
            .collect();
        self.spans(Reason::MotorsOff, spans)
    }

    /// The most that the rotors do in this log, m/s².
    fn most(&self) -> f64 {
        let by_drive =
            self.drives.first().and_then(|d| quantile(&d.level.component(0), 0.995)).map(|l| G * l);
        let felt = || {
            let all: Vec<f64> = self.accel.values.iter().map(|a| vec3::norm(*a)).collect();
            quantile(&all, 0.99)
        };
        by_drive.or_else(felt).unwrap_or(0.0).max(LEAST_MOST_G * G)
    }

    /// Change of velocity across a time, m/s, beyond what rotors can do; `None` where it is within that or not known.
    fn blow(&self, at: f64, most: f64) -> Option<f64> {
        let t = &self.position.t_s;
        let period = self.position.period_s().unwrap_or(GRID_S);
        let half = BLOW_HALF_S.max(3.0 * period);
        let slope = |from: f64, to: f64| -> Option<[f64; 3]> {
            let a = t.partition_point(|t| *t < from);
            let b = t.partition_point(|t| *t <= to);
            if b < a + 3 {
                return None;
            }
            let middle = t[a..b].iter().sum::<f64>() / (b - a) as f64;
            let square: f64 = t[a..b].iter().map(|t| (t - middle).powi(2)).sum();
            Some(std::array::from_fn(|k| {
                (a..b).map(|i| (t[i] - middle) * self.position.values[i][k]).sum::<f64>() / square
            }))
        };
        let (before, after) =
            (slope(at - 1.2 * half, at - 0.2 * half)?, slope(at + 0.2 * half, at + 1.2 * half)?);
        let change = vec3::norm(vec3::sub(after, before));
        // Between the middles of the slopes lie 1.4 half widths.
        (change > 1.4 * half * (most + G)).then_some(change)
    }

    /// From shortly before a blow to where the vehicle flies again, or to the end.
    fn crash(&self, grid: &[f64], ground: &[Excluded]) -> Vec<Excluded> {
        let most = self.most();
        let spikes: Vec<f64> = if self.accel.is_empty() {
            grid.iter().copied().filter(|t| self.blow(*t, BLOW * most).is_some()).collect()
        } else {
            let far = |i: &usize| vec3::norm(self.accel.values[*i]) > BLOW * most;
            let t = &self.accel.t_s;
            (0..t.len()).filter(far).map(|i| t[i]).filter(|t| self.blow(*t, most).is_some()).collect()
        };
        let end = grid.last().copied().unwrap_or(0.0);
        let flies = |t: f64| {
            let upright =
                before(&self.attitude, t).is_some_and(|q| quat::rotate(*q, [0.0, 0.0, 1.0])[2] > 0.0);
            self.level(t).is_none_or(|l| l >= LOW)
                && upright
                && !ground.iter().any(|e| t >= e.from_s && t <= e.to_s)
        };
        let mut spans: Vec<[f64; 2]> = Vec::new();
        for at in spikes {
            let [lead, tail] = CRASH_MARGIN_S;
            let later = grid.iter().filter(|t| **t > at + tail && **t <= at + tail + FLIES_ON_S);
            let flying = later.filter(|t| flies(**t)).count() as f64 * GRID_S;
            let to = if flying > 0.9 * FLIES_ON_S { at + tail } else { end };
            match spans.last_mut() {
                Some(s) if at - lead <= s[1] => s[1] = s[1].max(to),
                _ => spans.push([at - lead, to]),
            }
        }
        self.spans(Reason::Crash, spans)
    }
}

/// Angle between two attitudes, rad.
fn angle(a: [f64; 4], b: [f64; 4]) -> f64 {
    let turn = quat::mul(quat::conjugate(quat::normalize(a)), quat::normalize(b));
    vec3::norm(super::resample::rotation_vector(turn))
}

/// Angle between the body's z axes of two attitudes, rad.
fn tilt(a: [f64; 4], b: [f64; 4]) -> f64 {
    let [x, y] = [a, b].map(|q| quat::rotate(quat::normalize(q), [0.0, 0.0, 1.0]));
    vec3::dot(x, y).clamp(-1.0, 1.0).acos()
}

/// Runs of at least `least` indices for which `f` holds: (first, last).
fn runs(n: usize, least: usize, f: impl Fn(usize) -> bool) -> Vec<(usize, usize)> {
    let mut out: Vec<(usize, usize)> = Vec::new();
    for i in (0..n).filter(|i| f(*i)) {
        match out.last_mut() {
            Some((_, last)) if *last + 1 == i => *last = i,
            _ => out.push((i, i)),
        }
    }
    out.retain(|(a, b)| b - a + 1 >= least);
    out
}

impl Unusable {
    /// Whether a time lies where nothing counts.
    pub fn at(&self, t_s: f64) -> bool {
        self.excluded.iter().any(|e| e.whole() && t_s >= e.from_s && t_s <= e.to_s)
    }

    /// Outliers of a channel and everything within spans where nothing counts are left out of it.
    pub fn without<const N: usize>(&self, name: &str, c: &Channel<N>) -> Channel<N> {
        let outliers = self.outliers.iter().find(|o| o.channel == name).map_or(&[][..], |o| &o.t_s);
        let marks: Vec<bool> = c
            .t_s
            .iter()
            .map(|t| self.at(*t) || outliers.binary_search_by(|o| o.total_cmp(t)).is_ok())
            .collect();
        super::clean::without(c, &marks)
    }

    /// What is left out in words, once for every reason; outliers of single samples have none.
    pub fn sentences(&self) -> Vec<(String, Option<Reason>)> {
        let of = |reason: Reason| -> Vec<&Excluded> {
            self.excluded.iter().filter(|e| e.reason == reason).collect()
        };
        let mut out = Vec::new();
        for (reason, what) in [
            (Reason::OnGround, "on the ground"),
            (Reason::MotorsOff, "with motors off in the air"),
            (Reason::Crash, "after a crash"),
            (Reason::Outliers, "around jumps of the pose"),
        ] {
            let list = of(reason);
            if list.is_empty() {
                continue;
            }
            let total: f64 = list.iter().map(|e| e.to_s - e.from_s).sum();
            let mut spans: Vec<String> =
                list.iter().take(MOST_SPANS).map(|e| format!("{:.1}–{:.1} s", e.from_s, e.to_s)).collect();
            if list.len() > MOST_SPANS {
                spans.push(format!("{} more", list.len() - MOST_SPANS));
            }
            out.push((format!("left out: {total:.1} s {what} ({})", spans.join(", ")), Some(reason)));
        }
        out.extend(self.gap_sentence().map(|text| (text, Some(Reason::Dropout))));
        if !self.outliers.is_empty() {
            let list: Vec<String> =
                self.outliers.iter().map(|o| format!("{} of {}", o.t_s.len(), o.channel)).collect();
            let one = self.outliers.iter().map(|o| o.t_s.len()).sum::<usize>() == 1;
            let what = if one { "one outlier" } else { "outliers" };
            out.push((format!("left out: {what}: {}", list.join(", ")), None));
        }
        out
    }

    /// [`Unusable::sentences`] without their reasons.
    pub fn words(&self) -> Vec<String> {
        self.sentences().into_iter().map(|(text, _)| text).collect()
    }

    /// Gaps, those that channels have in common once.
    fn gap_sentence(&self) -> Option<String> {
        let gaps: Vec<&Excluded> = self.excluded.iter().filter(|e| e.reason == Reason::Dropout).collect();
        let mut channels: Vec<(&str, Vec<&Excluded>)> = Vec::new();
        for gap in &gaps {
            match channels.iter_mut().find(|(name, _)| *name == gap.channel) {
                Some((_, list)) => list.push(gap),
                None => channels.push((gap.channel, vec![gap])),
            }
        }
        let mut groups: Vec<(Vec<&str>, Vec<&Excluded>)> = Vec::new();
        for (name, list) in channels {
            let same = |other: &[&Excluded]| {
                other.len() == list.len()
                    && other.iter().zip(&list).all(|(a, b)| (a.from_s - b.from_s).abs() < 0.05)
            };
            match groups.iter_mut().find(|(_, other)| same(other)) {
                Some((names, _)) => names.push(name),
                None => groups.push((vec![name], list)),
            }
        }
        let text = |(names, list): &(Vec<&str>, Vec<&Excluded>)| -> Option<String> {
            let longest = list.iter().max_by(|a, b| (a.to_s - a.from_s).total_cmp(&(b.to_s - b.from_s)))?;
            let names = match &names[..] {
                ["position", "attitude"] => "the pose".into(),
                ["position", "attitude", rest @ ..] if rest.len() > 1 => "all channels".into(),
                names => names.join(" and "),
            };
            let (ms, at) = (1e3 * (longest.to_s - longest.from_s), longest.from_s);
            Some(match list.len() {
                1 => format!("a gap of {names}, {ms:.0} ms at {at:.1} s"),
                n => format!("{n} gaps of {names}, the longest {ms:.0} ms at {at:.1} s"),
            })
        };
        let texts: Vec<String> = groups.iter().filter_map(text).collect();
        (!texts.is_empty()).then(|| format!("left out: {}", texts.join("; ")))
    }
}

/// Spans of a reason that are listed.
const MOST_SPANS: usize = 4;
