//! Reference trajectories: where a drone should be, how fast, and which way it faces, at any time.

use super::RolloutError;
use crate::random::{Key, purpose};
use core::f64::consts::PI;
use std::collections::BTreeMap;
use std::path::Path;

/// Set-point at one instant, world frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reference {
    /// Position, m.
    pub pos_m: [f64; 3],
    /// Velocity, m/s.
    pub vel_m_s: [f64; 3],
    /// Acceleration, m/s².
    pub acc_m_s2: [f64; 3],
    /// Heading, rad.
    pub yaw_rad: f64,
}

impl Reference {
    /// To stay at a point, m, with a heading, rad.
    ///
    /// ```
    /// use propwash_rollout::trajectory::Reference;
    /// let command = Reference::hover([0.0, 0.0, 1.0], 0.0).command();
    /// assert_eq!((command[2], command[12]), (1.0, 1.0)); // z, and qw of a level attitude
    /// ```
    pub fn hover(pos_m: [f64; 3], yaw_rad: f64) -> Self {
        Self { pos_m, vel_m_s: [0.0; 3], acc_m_s2: [0.0; 3], yaw_rad }
    }

    /// The 16 numbers of a state command.
    pub fn command(&self) -> [f64; 16] {
        let (sin, cos) = (0.5 * self.yaw_rad).sin_cos();
        let mut out = [0.0; 16];
        out[0..3].copy_from_slice(&self.pos_m);
        out[3..6].copy_from_slice(&self.vel_m_s);
        out[6..9].copy_from_slice(&self.acc_m_s2);
        out[11] = sin;
        out[12] = cos;
        out
    }
}

/// A reference trajectory. All but hover start and stay at rest for the first instant and reach their speed smoothly.
#[derive(Clone, Debug, PartialEq)]
pub enum Trajectory {
    /// Stay at a point.
    Hover {
        /// The point, m.
        at_m: [f64; 3],
    },
    /// A horizontal circle, facing along the path.
    Circle {
        /// Centre, m.
        center_m: [f64; 3],
        /// Radius, m.
        radius_m: f64,
        /// Angle at the start, rad.
        phase_rad: f64,
        /// Angular speed, rad/s; its sign is the direction.
        rate_rad_s: f64,
    },
    /// x, y and z swing as sines of their own frequencies, the whole figure turned about the vertical, facing along the
    /// path.
    Lissajous {
        /// Centre, m.
        center_m: [f64; 3],
        /// Amplitudes, m.
        amplitude_m: [f64; 3],
        /// Cycles of x, y and z in one period.
        cycles: [f64; 3],
        /// Phases at the start, rad.
        phase_rad: [f64; 3],
        /// Turn of the figure about the vertical through its centre, rad.
        turn_rad: f64,
        /// Period, s.
        period_s: f64,
    },
    /// Through given points at given times: a cubic spline with continuous acceleration, at rest at both ends.
    Waypoints(Spline),
}

/// Seconds in which a periodic trajectory gets up to speed.
const RAMP_S: f64 = 1.0;

/// Path time and its rate and acceleration: stands at 0, runs at rate 1 after [`RAMP_S`]; twice differentiable.
fn ramp(t: f64) -> (f64, f64, f64) {
    let x = (t / RAMP_S).clamp(0.0, 1.0);
    // The rate is the smooth step 3x² − 2x³.
    let run = RAMP_S * (x * x * x - 0.5 * x * x * x * x) + (t - RAMP_S).max(0.0);
    let accel = if (0.0..RAMP_S).contains(&t) { 6.0 * x * (1.0 - x) / RAMP_S } else { 0.0 };
    (run, 3.0 * x * x - 2.0 * x * x * x, accel)
}

impl Trajectory {
    /// The Lissajous figure of one world: an eight, 4 m long and 2 m wide, 0.6 m to 1.6 m above the origin, whose turn,
    /// start, direction, heights and period are drawn from the world's random numbers. Its speed never falls to zero, so
    /// that the heading never jumps. Another `attempt` draws another figure.
    pub fn lissajous(seed: u64, world: u64, drone: u32, attempt: u64) -> Self {
        let mut s = Key { seed, world, drone, step: attempt, purpose: purpose("lissajous") }.stream();
        let start = s.uniform(0.0, 2.0 * PI);
        let direction = if s.unit() < 0.5 { -1.0 } else { 1.0 };
        Self::Lissajous {
            center_m: [0.0, 0.0, 1.1],
            amplitude_m: [2.0, 1.0, 0.5],
            cycles: [direction, 2.0 * direction, 1.0],
            phase_rad: [start, 2.0 * start, s.uniform(0.0, 2.0 * PI)],
            turn_rad: s.uniform(0.0, PI),
            period_s: s.uniform(8.0, 12.0),
        }
    }

    /// The circle of one world: radius 1 m at 1 m height around the origin, start angle and direction drawn. Another
    /// `attempt` draws another one.
    pub fn circle(seed: u64, world: u64, drone: u32, attempt: u64) -> Self {
        let mut s = Key { seed, world, drone, step: attempt, purpose: purpose("circle") }.stream();
        let direction = if s.unit() < 0.5 { -1.0 } else { 1.0 };
        Self::Circle {
            center_m: [0.0, 0.0, 1.0],
            radius_m: 1.0,
            phase_rad: s.uniform(0.0, 2.0 * PI),
            rate_rad_s: direction * s.uniform(0.8, 1.2),
        }
    }

    /// Set-point at `t` seconds.
    pub fn at(&self, t: f64) -> Reference {
        match self {
            Self::Hover { at_m } => {
                Reference { pos_m: *at_m, vel_m_s: [0.0; 3], acc_m_s2: [0.0; 3], yaw_rad: 0.0 }
            }
            Self::Circle { center_m, radius_m, phase_rad, rate_rad_s } => {
                let path = |s: f64| {
                    let (sin, cos) = (phase_rad + rate_rad_s * s).sin_cos();
                    let (r, w) = (*radius_m, *rate_rad_s);
                    (
                        [center_m[0] + r * cos, center_m[1] + r * sin, center_m[2]],
                        [-r * w * sin, r * w * cos, 0.0],
                        [-r * w * w * cos, -r * w * w * sin, 0.0],
                    )
                };
                along(path, t)
            }
            Self::Lissajous { center_m, amplitude_m, cycles, phase_rad, turn_rad, period_s } => {
                let (turn_sin, turn_cos) = turn_rad.sin_cos();
                let turned = |u: [f64; 3]| {
                    [turn_cos * u[0] - turn_sin * u[1], turn_sin * u[0] + turn_cos * u[1], u[2]]
                };
                let path = |s: f64| {
                    let (mut p, mut v, mut a) = ([0.0; 3], [0.0; 3], [0.0; 3]);
                    for i in 0..3 {
                        let w = 2.0 * PI * cycles[i] / period_s;
                        let (sin, cos) = (w * s + phase_rad[i]).sin_cos();
                        p[i] = amplitude_m[i] * sin;
                        v[i] = amplitude_m[i] * w * cos;
                        a[i] = -amplitude_m[i] * w * w * sin;
                    }
                    let p = turned(p);
                    let p = [center_m[0] + p[0], center_m[1] + p[1], center_m[2] + p[2]];
                    (p, turned(v), turned(a))
                };
                along(path, t)
            }
            Self::Waypoints(spline) => spline.at(t),
        }
    }

    /// Name as on the command line.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Hover { .. } => "hover",
            Self::Circle { .. } => "circle",
            Self::Lissajous { .. } => "lissajous",
            Self::Waypoints(_) => "waypoints",
        }
    }
}

/// A path of (position, velocity, acceleration) run with the smooth start of [`ramp`], facing along its velocity.
fn along(path: impl Fn(f64) -> ([f64; 3], [f64; 3], [f64; 3]), t: f64) -> Reference {
    let (s, rate, accel) = ramp(t);
    let (p, v, a) = path(s);
    let mut out = Reference { pos_m: p, vel_m_s: v, acc_m_s2: a, yaw_rad: v[1].atan2(v[0]) };
    for i in 0..3 {
        out.vel_m_s[i] = v[i] * rate;
        out.acc_m_s2[i] = a[i] * rate * rate + v[i] * accel;
    }
    out
}

/// Time (s), position (m, world) and heading (rad) of a waypoint.
pub type Waypoint = (f64, [f64; 3], f64);

/// Waypoints of some drones.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Track {
    /// The world, counted over the whole run; none: every world that has no track of its own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub world: Option<u64>,
    /// The drone; none: every drone that has no track of its own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drone: Option<usize>,
    /// Where it leads.
    pub points: Spline,
}

impl Track {
    /// Which drones it leads, in words.
    pub fn leads(&self) -> String {
        let number = |n: Option<u64>| n.map_or("all".into(), |n| n.to_string());
        format!("world {}, drone {}", number(self.world), number(self.drone.map(|d| d as u64)))
    }
}

/// Which drones a track leads: world and drone, all of them where there is none.
type Drones = (Option<u64>, Option<usize>);

/// The tracks of a simulation, at most one for each world and drone. In files it is their list.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(try_from = "Vec<Track>", into = "Vec<Track>")]
pub struct Tracks(BTreeMap<Drones, Track>);

impl Tracks {
    /// Tracks in any order.
    ///
    /// # Errors
    /// [`RolloutError::Trajectory`] for two of the same world and drone.
    pub fn new(list: Vec<Track>) -> Result<Self, RolloutError> {
        let mut tracks = BTreeMap::new();
        for track in list {
            let leads = track.leads();
            if tracks.insert((track.world, track.drone), track).is_some() {
                let reason = format!("expected one for each world and drone, got two for {leads}");
                return Err(RolloutError::Trajectory { name: "tracks".into(), reason });
            }
        }
        Ok(Self(tracks))
    }

    /// From CSV with a header of `t,x,y,z` and optionally `yaw`, `world` and `drone`: seconds, metres, radians, numbers from 0. Rows of
    /// one world and drone, in the order of time, are a track.
    ///
    /// # Errors
    /// [`RolloutError::Trajectory`] for a file that cannot be read, naming row and column, and as [`Spline::new`], naming the track.
    pub fn from_csv(path: &Path) -> Result<Self, RolloutError> {
        let name = format!("waypoints {}", path.display());
        let fault = |reason: String| RolloutError::Trajectory { name: name.clone(), reason };
        let mut reader = csv::ReaderBuilder::new()
            .trim(csv::Trim::All)
            .comment(Some(b'#'))
            .from_path(path)
            .map_err(|e| fault(e.to_string()))?;
        let header: Vec<String> =
            reader.headers().map_err(|e| fault(e.to_string()))?.iter().map(str::to_string).collect();
        let expected = "expected t,x,y,z and optionally yaw, world and drone";
        let known = ["t", "x", "y", "z", "yaw", "world", "drone"];
        if let Some(unknown) = header.iter().find(|h| !known.contains(&h.as_str())) {
            return Err(fault(format!("unknown column {unknown:?}; {expected}")));
        }
        let column = |wanted: &str| header.iter().position(|h| h == wanted);
        let need =
            |wanted: &str| column(wanted).ok_or_else(|| fault(format!("no column {wanted:?}; {expected}")));
        let (t, x, y, z, yaw) = (need("t")?, need("x")?, need("y")?, need("z")?, column("yaw"));
        let (world, drone) = (column("world"), column("drone"));
        let mut tracks: BTreeMap<Drones, Vec<Waypoint>> = BTreeMap::new();
        for (row, record) in reader.records().enumerate() {
            let record = record.map_err(|e| fault(e.to_string()))?;
            let wrong = |i: usize, expected: &str| {
                let (row, column, got) = (row + 1, &header[i], &record[i]);
                fault(format!("row {row}, column {column}: expected {expected}, got {got:?}"))
            };
            let number = |i: usize| record[i].parse::<f64>().map_err(|_| wrong(i, "a number"));
            let whole = |i: usize| record[i].parse::<u64>().map_err(|_| wrong(i, "a whole number from 0"));
            let key = (world.map(whole).transpose()?, drone.map(whole).transpose()?.map(|d| d as usize));
            let heading = yaw.map_or(Ok(0.0), number)?;
            let point = (number(t)?, [number(x)?, number(y)?, number(z)?], heading);
            tracks.entry(key).or_default().push(point);
        }
        if tracks.is_empty() {
            return Err(fault("expected at least two waypoints, found none".into()));
        }
        let made = tracks.into_iter().map(|((world, drone), points)| {
            let part = |what: &str, n: Option<u64>| n.map_or(String::new(), |n| format!("{what} {n}, "));
            let track = part("world", world) + &part("drone", drone.map(|d| d as u64));
            let points = Spline::new(&points).map_err(|e| match e {
                RolloutError::Trajectory { reason, .. } => fault(track + &reason),
                other => other,
            })?;
            Ok(((world, drone), Track { world, drone, points }))
        });
        Ok(Self(made.collect::<Result<_, _>>()?))
    }

    /// All of them.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &Track> {
        self.0.values()
    }

    /// The track of a drone: one of its own, else one of its world, else one of its number in all worlds, else one of all.
    pub fn of(&self, world: u64, drone: usize) -> Option<&Track> {
        let (world, drone) = (Some(world), Some(drone));
        [(world, drone), (world, None), (None, drone), (None, None)].iter().find_map(|key| self.0.get(key))
    }

    /// The one track that leads all drones, where there is no other.
    pub fn only(&self) -> Option<&Spline> {
        self.0.get(&(None, None)).filter(|_| self.0.len() == 1).map(|track| &track.points)
    }
}

impl TryFrom<Vec<Track>> for Tracks {
    type Error = RolloutError;

    fn try_from(list: Vec<Track>) -> Result<Self, RolloutError> {
        Self::new(list)
    }
}

impl From<Tracks> for Vec<Track> {
    fn from(tracks: Tracks) -> Self {
        tracks.0.into_values().collect()
    }
}

/// A clamped cubic spline through points in space, with headings turning the shorter way in between. In files it is the list of
/// its waypoints.
///
/// ```
/// use propwash_rollout::trajectory::Spline;
///
/// let path = Spline::new(&[(0.0, [0.0, 0.0, 1.0], 0.0), (2.0, [1.0, 0.0, 1.0], 0.0)])?;
/// assert_eq!((path.at(0.0).pos_m, path.at(5.0).pos_m), ([0.0, 0.0, 1.0], [1.0, 0.0, 1.0]));
/// assert!(path.at(1.0).vel_m_s[0] > 0.5);
/// # Ok::<(), propwash_rollout::RolloutError>(())
/// ```
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(try_from = "Vec<Waypoint>", into = "Vec<Waypoint>")]
pub struct Spline {
    t_s: Vec<f64>,
    pos_m: Vec<[f64; 3]>,
    vel_m_s: Vec<[f64; 3]>,
    yaw_rad: Vec<f64>,
}

impl Spline {
    /// Through `points` of (time s, position m, heading rad); times must rise.
    pub fn new(points: &[Waypoint]) -> Result<Self, RolloutError> {
        let fault = |reason: String| Err(RolloutError::Trajectory { name: "waypoints".into(), reason });
        if points.len() < 2 {
            return fault(format!("expected at least 2 waypoints, got {}", points.len()));
        }
        for (i, (t, p, yaw)) in points.iter().enumerate() {
            if !(t.is_finite() && yaw.is_finite() && p.iter().all(|v| v.is_finite())) {
                return fault(format!(
                    "waypoint {i}: expected finite numbers, got t {t}, position {p:?}, yaw {yaw}"
                ));
            }
            if i > 0 && *t <= points[i - 1].0 {
                return fault(format!(
                    "waypoint {i}: its time {t} s must be later than the one before ({} s)",
                    points[i - 1].0
                ));
            }
        }
        let t_s: Vec<f64> = points.iter().map(|p| p.0).collect();
        let pos_m: Vec<[f64; 3]> = points.iter().map(|p| p.1).collect();
        let vel_m_s = clamped_velocities(&t_s, &pos_m);
        let mut yaw_rad: Vec<f64> = points.iter().map(|p| p.2).collect();
        for i in 1..yaw_rad.len() {
            let turn = yaw_rad[i] - yaw_rad[i - 1];
            yaw_rad[i] -= 2.0 * PI * (turn / (2.0 * PI)).round();
        }
        Ok(Self { t_s, pos_m, vel_m_s, yaw_rad })
    }

    /// The waypoints: time (s), position (m), heading (rad; unwrapped).
    pub fn points(&self) -> Vec<Waypoint> {
        (0..self.t_s.len()).map(|i| (self.t_s[i], self.pos_m[i], self.yaw_rad[i])).collect()
    }

    /// The same path moved by `offset_m`.
    pub fn shifted(&self, offset_m: [f64; 3]) -> Self {
        let mut out = self.clone();
        for p in &mut out.pos_m {
            for k in 0..3 {
                p[k] += offset_m[k];
            }
        }
        out
    }

    /// Time of the last waypoint, s.
    pub fn end_s(&self) -> f64 {
        self.t_s[self.t_s.len() - 1]
    }

    /// Set-point at `t` seconds; before the first and after the last waypoint it stays there.
    pub fn at(&self, t: f64) -> Reference {
        let last = self.t_s.len() - 1;
        let rest = |i: usize| Reference {
            pos_m: self.pos_m[i],
            vel_m_s: [0.0; 3],
            acc_m_s2: [0.0; 3],
            yaw_rad: self.yaw_rad[i],
        };
        if t <= self.t_s[0] {
            return rest(0);
        }
        if t >= self.t_s[last] {
            return rest(last);
        }
        let i = self.t_s.partition_point(|x| *x <= t) - 1;
        let h = self.t_s[i + 1] - self.t_s[i];
        let x = (t - self.t_s[i]) / h;
        let mut out = rest(i);
        for k in 0..3 {
            let (p0, p1) = (self.pos_m[i][k], self.pos_m[i + 1][k]);
            let (m0, m1) = (self.vel_m_s[i][k] * h, self.vel_m_s[i + 1][k] * h);
            let (c2, c3) = (3.0 * (p1 - p0) - 2.0 * m0 - m1, 2.0 * (p0 - p1) + m0 + m1);
            out.pos_m[k] = p0 + x * (m0 + x * (c2 + x * c3));
            out.vel_m_s[k] = (m0 + x * (2.0 * c2 + x * 3.0 * c3)) / h;
            out.acc_m_s2[k] = (2.0 * c2 + 6.0 * c3 * x) / (h * h);
        }
        let smooth = x * x * (3.0 - 2.0 * x);
        out.yaw_rad += (self.yaw_rad[i + 1] - self.yaw_rad[i]) * smooth;
        out
    }
}

impl From<Spline> for Vec<Waypoint> {
    fn from(spline: Spline) -> Self {
        spline.points()
    }
}

impl TryFrom<Vec<Waypoint>> for Spline {
    type Error = RolloutError;

    /// As [`Spline::new`]. Headings of [`Spline::points`] stay as they are, also where they turn by exactly half a turn.
    fn try_from(points: Vec<Waypoint>) -> Result<Self, RolloutError> {
        let mut spline = Self::new(&points)?;
        if points.windows(2).all(|pair| (pair[1].2 - pair[0].2).abs() <= PI) {
            spline.yaw_rad = points.iter().map(|p| p.2).collect();
        }
        Ok(spline)
    }
}

/// Velocities at the knots of the cubic spline that is at rest at both ends and has continuous acceleration: the
/// tridiagonal system of de Boor, "A practical guide to splines", ch. IV, solved by elimination.
fn clamped_velocities(t: &[f64], p: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let n = t.len();
    let mut v = vec![[0.0; 3]; n];
    let h: Vec<f64> = t.windows(2).map(|w| w[1] - w[0]).collect();
    let mut upper = vec![0.0; n];
    for i in 1..n - 1 {
        let (a, b) = (1.0 / h[i - 1], 1.0 / h[i]);
        let diagonal = 2.0 * (a + b) - a * upper[i - 1];
        upper[i] = b / diagonal;
        for k in 0..3 {
            let slope = |j: usize| (p[j + 1][k] - p[j][k]) / (h[j] * h[j]);
            v[i][k] = (3.0 * (slope(i - 1) + slope(i)) - a * v[i - 1][k]) / diagonal;
        }
    }
    for i in (1..n - 1).rev() {
        for k in 0..3 {
            v[i][k] -= upper[i] * v[i + 1][k];
        }
    }
    v
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all() -> Vec<Trajectory> {
        let points = [(0.0, [0.0; 3], 0.0), (1.0, [1.0, 0.5, 0.2], 3.0), (2.5, [0.0, 2.0, 1.0], -3.0)];
        vec![
            Trajectory::Hover { at_m: [1.0, 2.0, 3.0] },
            Trajectory::circle(1, 2, 0, 0),
            Trajectory::lissajous(1, 2, 0, 0),
            Trajectory::Waypoints(Spline::new(&points).unwrap()),
        ]
    }

    #[test]
    fn velocity_and_acceleration_are_the_derivatives_of_position() {
        for trajectory in all() {
            let h = 1e-5;
            for t in [0.1, 0.35, 0.7, 0.999, 1.3, 2.2] {
                let (a, b, c) = (trajectory.at(t - h), trajectory.at(t), trajectory.at(t + h));
                for k in 0..3 {
                    let v = (c.pos_m[k] - a.pos_m[k]) / (2.0 * h);
                    let acc = (c.vel_m_s[k] - a.vel_m_s[k]) / (2.0 * h);
                    assert!((v - b.vel_m_s[k]).abs() < 1e-6, "{} at {t}", trajectory.name());
                    assert!((acc - b.acc_m_s2[k]).abs() < 1e-3, "{} at {t}", trajectory.name());
                }
            }
        }
    }

    #[test]
    fn no_lissajous_figure_ever_stops_so_headings_turn_smoothly() {
        for world in 0..50 {
            let figure = Trajectory::lissajous(3, world, 0, 0);
            let mut last = figure.at(1.0).yaw_rad;
            for i in 1..1200 {
                let r = figure.at(1.0 + f64::from(i) * 0.01);
                assert!(r.vel_m_s[0].hypot(r.vel_m_s[1]) > 0.5 && r.pos_m[0].hypot(r.pos_m[1]) < 2.3);
                assert!((0.599..1.601).contains(&r.pos_m[2]));
                let turn = (r.yaw_rad - last + PI).rem_euclid(2.0 * PI) - PI;
                assert!(turn.abs() < 0.05, "heading jumps by {turn} in world {world}");
                last = r.yaw_rad;
            }
        }
    }

    #[test]
    fn every_trajectory_starts_at_rest() {
        for trajectory in all() {
            assert!(trajectory.at(0.0).vel_m_s.iter().all(|v| *v == 0.0), "{}", trajectory.name());
        }
    }

    #[test]
    fn the_spline_meets_its_points_with_continuous_acceleration() {
        let points = [
            (0.0, [0.0, 1.0, 2.0], 0.0),
            (0.7, [1.0, 0.0, 2.5], 0.1),
            (2.0, [2.0, 3.0, 1.0], 0.2),
            (2.6, [0.0, 0.0, 1.0], 0.3),
        ];
        let s = Spline::new(&points).unwrap();
        for (t, p, _) in points {
            let at = s.at(t).pos_m;
            assert!((0..3).all(|k| (at[k] - p[k]).abs() < 1e-12));
        }
        for t in [0.7, 2.0] {
            let (before, after) = (s.at(t - 1e-9), s.at(t + 1e-9));
            assert!((0..3).all(|k| (before.acc_m_s2[k] - after.acc_m_s2[k]).abs() < 1e-5));
        }
    }

    #[test]
    fn headings_turn_the_shorter_way() {
        let s = Spline::new(&[(0.0, [0.0; 3], 3.0), (1.0, [1.0; 3], -3.0)]).unwrap();
        assert!((s.at(0.5).yaw_rad - PI).abs() < 0.01);
    }

    #[test]
    fn wrong_waypoints_are_refused_in_words() {
        let one = Spline::new(&[(0.0, [0.0; 3], 0.0)]).unwrap_err().to_string();
        assert!(one.contains("at least 2"), "{one}");
        let order = Spline::new(&[(1.0, [0.0; 3], 0.0), (1.0, [1.0; 3], 0.0)]).unwrap_err().to_string();
        assert!(order.contains("waypoint 1") && order.contains("later"), "{order}");
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("w.csv");
        std::fs::write(&path, "t,x,y,z\n0,0,0,1\n1,zero,0,1\n").unwrap();
        let text = Tracks::from_csv(&path).unwrap_err().to_string();
        assert!(text.contains("row 2") && text.contains("column x") && text.contains("zero"), "{text}");
        std::fs::write(&path, "t,x,y\n0,0,0\n").unwrap();
        assert!(Tracks::from_csv(&path).unwrap_err().to_string().contains("no column \"z\""));
    }

    #[test]
    fn the_track_that_names_a_drone_best_leads_it() {
        let to = |x: f64| Spline::new(&[(0.0, [x, 0.0, 1.0], 0.0), (1.0, [x, 1.0, 1.0], 0.0)]).unwrap();
        let track = |world, drone, x| Track { world, drone, points: to(x) };
        let list = vec![
            track(None, None, 0.0),
            track(Some(1), Some(1), 3.0),
            track(None, Some(1), 1.0),
            track(Some(1), None, 2.0),
        ];
        let tracks = Tracks::new(list.clone()).unwrap();
        let led = |world, drone| tracks.of(world, drone).unwrap().points.at(0.0).pos_m[0];
        assert_eq!([led(0, 0), led(0, 1), led(1, 0), led(1, 1)], [0.0, 1.0, 2.0, 3.0]);
        assert!(tracks.only().is_none() && Tracks::new(list[..1].to_vec()).unwrap().only().is_some());
        assert!(Tracks::new(list[1..2].to_vec()).unwrap().of(1, 0).is_none());
        let text = serde_json::to_string(&tracks).unwrap();
        assert_eq!(serde_json::from_str::<Tracks>(&text).unwrap(), tracks);
        let twice = Tracks::new([list.clone(), list[3..].to_vec()].concat()).unwrap_err().to_string();
        assert!(twice.contains("two for world 1, drone all"), "{twice}");
    }
}
