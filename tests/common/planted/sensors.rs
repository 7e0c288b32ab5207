//! What is measured: motion capture, gyroscope, accelerometer, rotor speeds, battery; and the log as CSV.

use super::Marker;
use super::estimator::{Estimator, Filters, LowPass, specific_force};
use super::hidden::stream;
use super::linear::{M, Q, V, add, mat_t_vec, mat_vec, matrix, quat_exp, quat_mul, quat_unit, sub};
use super::pilot::{Reference, Wanted};
use super::world::{Air, LOAD, MAX_ROTORS, ROTORS, Speeds, State, World, attitude, curve, part};
use propwash::random::Stream;
use serde::Serialize;
use std::fmt::Write;

/// How good sensors and how calm air are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum NoiseLevel {
    /// A laboratory.
    Fine,
    /// A hall: turbulence three times, tolerances twice, motion capture slower and worse.
    Rough,
    /// A log of an on-board computer: poses and velocities of its estimator, filtered inertial data, samples that are held,
    /// clocks and rates that differ from channel to channel and from flight to flight.
    Filtered,
}

impl NoiseLevel {
    /// All of them, by name.
    pub const ALL: &[(&'static str, NoiseLevel)] =
        &[("fine", NoiseLevel::Fine), ("rough", NoiseLevel::Rough), ("filtered", NoiseLevel::Filtered)];

    /// The one with that name.
    ///
    /// # Errors
    /// A sentence with all names.
    pub fn by_name(name: &str) -> Result<Self, String> {
        Self::ALL.iter().find(|(known, _)| *known == name).map(|(_, l)| *l).ok_or_else(|| {
            let names: Vec<&str> = Self::ALL.iter().map(|(n, _)| *n).collect();
            format!("expected a noise level, found `{name}`: take one of {}", names.join(", "))
        })
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        Self::ALL.iter().find(|(_, l)| *l == self).map_or("", |(n, _)| n)
    }
}

/// What of a log drives the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Inputs {
    /// Commanded rotor speeds, exact.
    Commands,
    /// Measured rotor speeds.
    Rotors,
    /// Collective thrust.
    Thrust,
    /// Attitude and thrust commands.
    Attitude,
}

impl Inputs {
    /// All of them, by name.
    pub const ALL: &[(&'static str, Inputs)] = &[
        ("commands", Inputs::Commands),
        ("rotors", Inputs::Rotors),
        ("thrust", Inputs::Thrust),
        ("attitude", Inputs::Attitude),
    ];

    /// The one with that name.
    ///
    /// # Errors
    /// A sentence with all names.
    pub fn by_name(name: &str) -> Result<Self, String> {
        Self::ALL.iter().find(|(known, _)| *known == name).map(|(_, i)| *i).ok_or_else(|| {
            let names: Vec<&str> = Self::ALL.iter().map(|(n, _)| *n).collect();
            format!("expected inputs, found `{name}`: take one of {}", names.join(", "))
        })
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        Self::ALL.iter().find(|(_, i)| *i == self).map_or("", |(n, _)| n)
    }
}

/// What is logged.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Sensors {
    /// Position and attitude.
    pub poses: bool,
    /// Body rates.
    pub gyro: bool,
    /// Specific force.
    pub accel: bool,
    /// Commanded rotor speeds.
    pub commands: bool,
    /// Measured rotor speeds.
    pub rotors: bool,
    /// Collective thrust, of the rotor speeds by the filed thrust curve.
    pub thrust: bool,
    /// Attitude and thrust commands.
    pub attitude: bool,
    /// Battery voltage.
    pub battery: bool,
    /// References.
    pub references: bool,
    /// Position of a load on a cable, where there is one.
    pub load: bool,
}

impl Default for Sensors {
    fn default() -> Self {
        Self {
            poses: true,
            gyro: true,
            accel: true,
            commands: true,
            rotors: false,
            thrust: false,
            attitude: false,
            battery: true,
            references: true,
            load: true,
        }
    }
}

impl Sensors {
    /// The usual sensors, with these inputs and no others.
    pub fn with(inputs: Inputs) -> Self {
        Self {
            commands: inputs == Inputs::Commands,
            rotors: inputs == Inputs::Rotors,
            thrust: inputs == Inputs::Thrust,
            attitude: inputs == Inputs::Attitude,
            ..Self::default()
        }
    }
}

/// A noise level in figures.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Figures {
    /// Rate of motion capture, Hz.
    pub pose_hz: f64,
    /// Noise of positions, m.
    pub position_m: f64,
    /// Noise of attitudes per axis, rad.
    pub attitude_rad: f64,
    /// Rate of gyroscope and accelerometer, Hz.
    pub imu_hz: f64,
    /// Noise of the gyroscope, rad/s.
    pub gyro_rad_s: f64,
    /// Noise of the accelerometer, m/s².
    pub accel_m_s2: f64,
    /// Rate of measured rotor speeds, Hz.
    pub rotor_hz: f64,
    /// Noise of measured rotor speeds, rad/s.
    pub rotor_rad_s: f64,
    /// Rate of the collective thrust, Hz.
    pub thrust_hz: f64,
    /// Noise of the collective thrust, share of it.
    pub thrust_share: f64,
    /// How late rotor speeds and thrust are written, s.
    pub drive_clock_s: f64,
    /// How late poses, gyroscope and accelerometer are written in this flight, beside the clocks of the vehicle, s.
    pub clock_s: V,
    /// Share of samples that repeat the one before: poses, inertial unit, rotor speeds and thrust.
    pub held: V,
    /// Noise of the voltage, V.
    pub battery_v: f64,
    /// Unevenness of pose times, s.
    pub pose_jitter_s: f64,
    /// Unevenness of gyroscope and accelerometer times, s.
    pub imu_jitter_s: f64,
    /// Share of frames that motion capture loses.
    pub dropout: f64,
    /// Standard deviation of the turbulence that is always there, m/s.
    pub turbulence_m_s: f64,
    /// What stands between sensors and log, where anything does.
    pub filters: Option<Filters>,
}

impl Figures {
    /// The figures of a flight; what varies within a level is drawn.
    pub fn new(level: NoiseLevel, seed: u64, flight: u64) -> Self {
        let mut s = stream(seed, flight, "figures");
        let calm = s.uniform(0.03, 0.05);
        // Inputs are measured as badly by fine sensors of the motion as by rough ones.
        let mut inputs = stream(seed, flight, "inputs");
        let hertz = |s: &mut Stream, low: f64, high: f64| low * (high / low).powf(s.unit());
        let fine = Self {
            pose_hz: 240.0,
            position_m: 0.3e-3,
            attitude_rad: 0.2f64.to_radians(),
            imu_hz: 500.0,
            gyro_rad_s: 0.01,
            accel_m_s2: 0.1,
            rotor_hz: hertz(&mut inputs, 250.0, 500.0),
            rotor_rad_s: inputs.uniform(0.0, 8.0),
            thrust_hz: hertz(&mut inputs, 100.0, 500.0),
            thrust_share: inputs.uniform(0.0, 0.02),
            drive_clock_s: 0.3e-3 * inputs.normal(),
            clock_s: [0.0; 3],
            held: [0.0; 3],
            filters: None,
            battery_v: 0.02,
            pose_jitter_s: 0.15e-3,
            imu_jitter_s: 0.03e-3,
            dropout: 0.01,
            turbulence_m_s: calm,
        };
        match level {
            NoiseLevel::Fine => fine,
            NoiseLevel::Rough => Self {
                pose_hz: 100.0,
                position_m: s.uniform(3e-3, 10e-3),
                attitude_rad: 0.3f64.to_radians(),
                gyro_rad_s: 0.03,
                accel_m_s2: 0.3,
                pose_jitter_s: 0.5e-3,
                imu_jitter_s: 0.1e-3,
                dropout: 0.02,
                turbulence_m_s: 3.0 * calm,
                ..fine
            },
            NoiseLevel::Filtered => {
                let pose_hz = hertz(&mut s, 50.0, 500.0);
                // In every second flight a sensor is slower than the rows of its log, down to half of them.
                let mut held = || if s.below(2) == 0 { 0.0 } else { s.uniform(0.1, 0.5) };
                let held = [held(), held(), held()];
                let mut clock = || s.uniform(-0.005, 0.005);
                let (clock_s, drive_clock_s) = ([clock(), clock(), clock()], clock());
                Self {
                    pose_hz,
                    // The inertial unit is not logged more slowly than what is made of it.
                    imu_hz: hertz(&mut s, 100.0, 500.0).max(pose_hz),
                    rotor_hz: hertz(&mut inputs, 100.0, 500.0),
                    // White before the filter, at the step of integration: vibration of the frame.
                    gyro_rad_s: s.uniform(0.02, 0.1),
                    accel_m_s2: s.uniform(0.2, 1.0),
                    drive_clock_s,
                    clock_s,
                    held,
                    filters: Some(Filters::new(seed, flight)),
                    dropout: 0.0,
                    turbulence_m_s: s.uniform(1.0, 3.0) * calm,
                    ..fine
                }
            }
        }
    }
}

/// Columns of the log, with the decimals that are written.
const COLUMNS: &[(&str, usize)] = &[
    ("px", 6),
    ("py", 6),
    ("pz", 6),
    ("qx", 7),
    ("qy", 7),
    ("qz", 7),
    ("qw", 7),
    ("vx", 5),
    ("vy", 5),
    ("vz", 5),
    ("wx", 6),
    ("wy", 6),
    ("wz", 6),
    ("ax", 5),
    ("ay", 5),
    ("az", 5),
    ("rotor1", 3),
    ("rotor2", 3),
    ("rotor3", 3),
    ("rotor4", 3),
    ("rotor5", 3),
    ("rotor6", 3),
    ("rotor7", 3),
    ("rotor8", 3),
    ("thrust", 6),
    ("cmd_rotor1", 4),
    ("cmd_rotor2", 4),
    ("cmd_rotor3", 4),
    ("cmd_rotor4", 4),
    ("cmd_rotor5", 4),
    ("cmd_rotor6", 4),
    ("cmd_rotor7", 4),
    ("cmd_rotor8", 4),
    ("cmd_roll", 6),
    ("cmd_pitch", 6),
    ("cmd_yaw", 6),
    ("cmd_thrust", 6),
    ("vbat", 3),
    ("ref_x", 5),
    ("ref_y", 5),
    ("ref_z", 5),
    ("ref_vx", 5),
    ("ref_vy", 5),
    ("ref_vz", 5),
    ("ref_ax", 5),
    ("ref_ay", 5),
    ("ref_az", 5),
    ("ref_yaw", 5),
    ("obj_payload_x", 6),
    ("obj_payload_y", 6),
    ("obj_payload_z", 6),
    ("obj_neighbour_x", 6),
    ("obj_neighbour_y", 6),
    ("obj_neighbour_z", 6),
];
const VELOCITY: usize = 7;
const GYRO: usize = VELOCITY + 3;
const ACCEL: usize = GYRO + 3;
const ROTOR: usize = ACCEL + 3;
const THRUST: usize = ROTOR + MAX_ROTORS;
const COMMAND: usize = THRUST + 1;
const ATTITUDE: usize = COMMAND + MAX_ROTORS;
const BATTERY: usize = ATTITUDE + 4;
const REFERENCE: usize = BATTERY + 1;
const PAYLOAD: usize = REFERENCE + 10;
const NEIGHBOUR: usize = PAYLOAD + 3;

/// Voltage of the full battery, V.
const FULL_V: f64 = 16.4;

/// A sensor with sample times of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ChannelId {
    /// Motion capture.
    Pose,
    /// Gyroscope.
    Gyro,
    /// Accelerometer.
    Accel,
    /// Rotor speeds.
    Rotor,
    /// Collective thrust.
    Thrust,
    /// Voltage.
    Battery,
}

/// The truth at the time of a sample.
pub struct Sample<'a> {
    /// Time, s.
    pub t: f64,
    /// State of the vehicle.
    pub state: &'a State,
    /// What the motors see.
    pub commands: Speeds,
    /// The air.
    pub air: &'a Air,
    /// Place of the neighbour, m.
    pub neighbour_m: Option<V>,
}

struct Channel {
    id: ChannelId,
    times: Vec<f64>,
    next: usize,
    noise: Stream,
    /// Share of samples that repeat the one before.
    held: f64,
    /// The last ones: column and values.
    last: Readings,
}

/// First column and values of what a sensor reads.
type Readings = Vec<(usize, Vec<f64>)>;

impl Channel {
    /// Whether the sensor has nothing new for its sample number `k`.
    fn repeats(&self, k: usize) -> bool {
        let own = |k: usize| ((1.0 - self.held) * k as f64).floor();
        k > 0 && self.held > 0.0 && own(k) == own(k - 1)
    }
}

/// Gaps of the position system: one of 0.1 to 0.2 s per minute, and by chance one in a shorter flight.
fn gaps(figures: &Figures, seconds: f64, seed: u64, flight: u64) -> Vec<[f64; 2]> {
    if figures.filters.is_some() {
        // An estimator goes on without its sensors.
        return Vec::new();
    }
    let mut s = stream(seed, flight, "gaps");
    let n = (seconds / 60.0 + s.unit()).floor() as usize;
    let mut gaps_s: Vec<[f64; 2]> = (0..n)
        .map(|_| {
            let from = s.uniform(0.05, 0.95) * seconds;
            [from, from + s.uniform(0.1, 0.2)]
        })
        .collect();
    gaps_s.sort_by(|a, b| a[0].total_cmp(&b[0]));
    gaps_s
}

/// Times of the samples of a sensor that loses a share `dropout` of them, and all in its gaps.
fn times(
    s: &mut Stream,
    hz: f64,
    jitter_s: f64,
    dropout: f64,
    gaps_s: &[[f64; 2]],
    seconds: f64,
) -> Vec<f64> {
    let phase = s.uniform(0.05, 0.95) / hz;
    let mut times = Vec::new();
    for k in 0.. {
        let even = k as f64 / hz + phase;
        if even > seconds {
            break;
        }
        // Uneven by no more than 0.3 periods, so that samples keep their order.
        let uneven = (jitter_s * s.normal()).clamp(-0.3 / hz, 0.3 / hz);
        let t = (even + uneven).max(0.0);
        let lost = s.unit() < dropout;
        let gap = gaps_s.iter().any(|g| t >= g[0] && t < g[1]);
        if !lost && !gap && t <= seconds {
            times.push(t);
        }
    }
    times
}

/// The sensors that are there.
fn channels(
    sensors: Sensors,
    f: &Figures,
    gaps_s: &[[f64; 2]],
    seconds: f64,
    seed: u64,
    flight: u64,
) -> Vec<Channel> {
    let one = |id: ChannelId, name: &str, hz: f64, jitter_s: f64, dropout: f64, held: f64| {
        let gaps_s = if id == ChannelId::Pose { gaps_s } else { &[] };
        let mut s = stream(seed, flight, &format!("{name} times"));
        let times = times(&mut s, hz, jitter_s, dropout, gaps_s, seconds);
        let noise = stream(seed, flight, &format!("{name} noise"));
        Channel { id, times, next: 0, noise, held, last: Readings::new() }
    };
    let mut out = Vec::new();
    if sensors.poses {
        out.push(one(ChannelId::Pose, "pose", f.pose_hz, f.pose_jitter_s, f.dropout, f.held[0]));
    }
    if sensors.gyro {
        out.push(one(ChannelId::Gyro, "gyro", f.imu_hz, f.imu_jitter_s, 0.0, f.held[1]));
    }
    if sensors.accel {
        out.push(one(ChannelId::Accel, "accel", f.imu_hz, f.imu_jitter_s, 0.0, f.held[1]));
    }
    if sensors.rotors {
        out.push(one(ChannelId::Rotor, "rotor", f.rotor_hz, f.imu_jitter_s, 0.0, f.held[2]));
    }
    if sensors.thrust {
        out.push(one(ChannelId::Thrust, "thrust", f.thrust_hz, f.imu_jitter_s, 0.0, f.held[2]));
    }
    if sensors.battery {
        out.push(one(ChannelId::Battery, "battery", 10.0, 1e-3, 0.0, 0.0));
    }
    out
}

/// Takes samples and writes the log.
pub struct Recorder {
    channels: Vec<Channel>,
    sensors: Sensors,
    figures: Figures,
    /// From marker to true centre of mass, body; tilt of the world; mount; clocks.
    marker_m: V,
    tilt: M,
    tilt_q: Q,
    mount_q: Q,
    imu_mount: M,
    clock_s: V,
    estimator: Option<Estimator>,
    /// Filters of gyroscope and accelerometer, and what shakes them.
    low_pass: Option<([LowPass; 2], Stream)>,
    /// Thrust curves as filed.
    curves: Vec<V>,
    seconds: f64,
    has_cable: bool,
    cells: Vec<(i64, u8, f64)>,
    gaps_s: Vec<[f64; 2]>,
}

impl Recorder {
    /// A recorder for one flight.
    pub fn new(
        sensors: Sensors,
        figures: &Figures,
        world: &World,
        curves: Vec<V>,
        marker: Marker,
        seconds: f64,
        seed: u64,
        flight: u64,
    ) -> Self {
        let d = &world.dev;
        let f = figures;
        let gaps_s = gaps(f, seconds, seed, flight);
        let channels = channels(sensors, f, &gaps_s, seconds, seed, flight);
        let airframe = if marker == Marker::Airframe { world.com_m } else { [0.0; 3] };
        let tilt_q = quat_exp([d.tilt_rad[0], d.tilt_rad[1], 0.0]);
        let mount_q = quat_exp(d.mount_rad);
        Self {
            channels,
            sensors,
            figures: *figures,
            marker_m: sub(d.marker_m, airframe),
            tilt: matrix(tilt_q),
            tilt_q,
            mount_q,
            imu_mount: matrix(quat_exp(d.imu_mount_rad)),
            clock_s: add(d.clock_s, f.clock_s),
            estimator: f.filters.map(|f| Estimator::new(f, seed, flight)),
            low_pass: f
                .filters
                .map(|f| ([LowPass::new(&f), LowPass::new(&f)], stream(seed, flight, "vibration"))),
            curves,
            seconds,
            has_cable: d.has_cable() && sensors.load,
            cells: Vec::new(),
            gaps_s,
        }
    }

    /// The next sample before `until`, if any: its sensor and its time.
    pub fn due(&self, until: f64) -> Option<(usize, f64)> {
        let next = |c: &Channel| c.times.get(c.next).copied().filter(|t| *t < until);
        let all = self.channels.iter().enumerate().filter_map(|(i, c)| next(c).map(|t| (i, t)));
        all.min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Logs a command and, at every fifth one, the reference.
    pub fn command(&mut self, tick: i64, t: f64, command: &Speeds, wanted: &Wanted, r: &Reference) {
        if t > self.seconds {
            return;
        }
        if self.sensors.commands {
            self.write(t, COMMAND, &command[..self.curves.len()]);
        }
        if self.sensors.attitude {
            self.write(t, ATTITUDE, &wanted.attitude_rad);
            self.write(t, ATTITUDE + 3, &[wanted.thrust_n]);
        }
        if self.sensors.references && tick % 5 == 0 {
            let yaw = r.yaw.sin().atan2(r.yaw.cos());
            let row = [r.p, r.v, r.a].concat();
            self.write(t, REFERENCE, &row);
            self.write(t, REFERENCE + 9, &[yaw]);
        }
    }

    /// Lets the filters see a step of `h` s that ends in `now`.
    pub fn follow(&mut self, world: &World, h: f64, now: &Sample) {
        let f = self.figures;
        let Some((filters, noise)) = &mut self.low_pass else { return };
        let mut three = |sigma: f64| -> V { std::array::from_fn(|_| sigma * noise.normal()) };
        let acc = part(&world.rate(now.t, now.state, &now.commands, now.air), 7);
        let force = specific_force(now.state, acc, world.gravity);
        let shaken = [add(part(now.state, 10), three(f.gyro_rad_s)), add(force, three(f.accel_m_s2))];
        for (filter, u) in filters.iter_mut().zip(shaken) {
            filter.step(h, u);
        }
    }

    /// Takes a sample of the sensor number `channel`, `since` s after what the filters last saw.
    pub fn take(&mut self, channel: usize, world: &World, now: &Sample, since: f64) {
        let c = &mut self.channels[channel];
        let (id, k) = (c.id, c.next);
        c.next += 1;
        let readings = if c.repeats(k) {
            c.last.clone()
        } else {
            let mut noise = c.noise.clone();
            let new = self.read(id, world, now, since, &mut noise);
            self.channels[channel].noise = noise;
            self.channels[channel].last.clone_from(&new);
            new
        };
        let clock_s = match id {
            ChannelId::Pose => self.clock_s[0],
            ChannelId::Gyro => self.clock_s[1],
            ChannelId::Accel => self.clock_s[2],
            ChannelId::Rotor | ChannelId::Thrust => self.figures.drive_clock_s,
            ChannelId::Battery => 0.0,
        };
        for (column, values) in readings {
            self.write(now.t + clock_s, column, &values);
        }
    }

    /// What a sensor reads.
    fn read(
        &mut self,
        id: ChannelId,
        world: &World,
        now: &Sample,
        since: f64,
        noise: &mut Stream,
    ) -> Readings {
        let mut three = |sigma: f64| -> V { std::array::from_fn(|_| sigma * noise.normal()) };
        let d = &world.dev;
        let (x, f) = (now.state, self.figures);
        let acc = || part(&world.rate(now.t, x, &now.commands, now.air), 7);
        match id {
            ChannelId::Pose => {
                let q = attitude(x);
                let mut out = Readings::new();
                if let Some(estimator) = &mut self.estimator {
                    let e = estimator.at(now.t, x, acc(), self.marker_m);
                    let turned = quat_mul(quat_mul(self.tilt_q, e.attitude), self.mount_q);
                    out.push((0, mat_vec(self.tilt, e.position_m).to_vec()));
                    out.push((3, quat_unit(turned).to_vec()));
                    out.push((VELOCITY, mat_vec(self.tilt, e.velocity_m_s).to_vec()));
                } else {
                    let at = add(part(x, 0), mat_vec(matrix(q), self.marker_m));
                    let seen = add(mat_vec(self.tilt, at), three(f.position_m));
                    let turned = quat_mul(quat_mul(self.tilt_q, q), self.mount_q);
                    out.push((0, seen.to_vec()));
                    let seen = quat_unit(quat_mul(turned, quat_exp(three(f.attitude_rad))));
                    out.push((3, seen.to_vec()));
                }
                if self.has_cable {
                    let at = add(mat_vec(self.tilt, part(x, LOAD)), three(f.position_m));
                    out.push((PAYLOAD, at.to_vec()));
                }
                if let Some(p) = now.neighbour_m {
                    let at = add(mat_vec(self.tilt, p), three(f.position_m));
                    out.push((NEIGHBOUR, at.to_vec()));
                }
                out
            }
            ChannelId::Gyro => {
                let (rate, white) = match &self.low_pass {
                    Some((filters, _)) => (filters[0].peek(since, part(x, 10)), [0.0; 3]),
                    None => (part(x, 10), three(f.gyro_rad_s)),
                };
                let w = mat_t_vec(self.imu_mount, rate);
                let scaled: V =
                    std::array::from_fn(|i| (1.0 + d.gyro_scale[i]) * w[i] + d.gyro_bias_rad_s[i]);
                vec![(GYRO, add(scaled, white).to_vec())]
            }
            ChannelId::Accel => {
                let force = specific_force(x, acc(), world.gravity);
                let (force, white) = match &self.low_pass {
                    Some((filters, _)) => (filters[1].peek(since, force), [0.0; 3]),
                    None => (force, three(f.accel_m_s2)),
                };
                let seen = add(mat_t_vec(self.imu_mount, force), d.accel_bias_m_s2);
                vec![(ACCEL, add(seen, white).to_vec())]
            }
            ChannelId::Rotor => {
                let n = self.curves.len();
                vec![(
                    ROTOR,
                    (0..n).map(|i| (x[ROTORS + i] + f.rotor_rad_s * noise.normal()).max(0.0)).collect(),
                )]
            }
            ChannelId::Thrust => {
                let one = |(i, c): (usize, &V)| curve(*c, x[ROTORS + i]);
                let sum: f64 = self.curves.iter().enumerate().map(one).sum();
                vec![(THRUST, vec![sum * (1.0 + f.thrust_share * noise.normal())])]
            }
            ChannelId::Battery => {
                // Without sag the speed controllers make up for a battery that runs down by 4 %.
                let hidden = world.voltage_share(now.t);
                let share = if d.sag_share > 0.0 { hidden } else { 1.0 - 0.04 * now.t / self.seconds };
                vec![(BATTERY, vec![FULL_V * share + three(f.battery_v)[0]])]
            }
        }
    }

    fn write(&mut self, t: f64, column: usize, values: &[f64]) {
        let us = (t * 1e6).round() as i64;
        if us < 0 {
            return;
        }
        for (i, v) in values.iter().enumerate() {
            self.cells.push((us, (column + i) as u8, *v));
        }
    }

    /// The log, the time of its first row (s) and the gaps of motion capture.
    pub fn finish(mut self) -> (String, f64, Vec<[f64; 2]>) {
        self.cells.sort_by_key(|c| (c.0, c.1));
        self.cells.dedup_by_key(|c| (c.0, c.1));
        let mut used = [false; COLUMNS.len()];
        for c in &self.cells {
            used[usize::from(c.1)] = true;
        }
        let mut text = String::with_capacity(16 * self.cells.len());
        text.push('t');
        for (name, _) in COLUMNS.iter().zip(used).filter(|(_, u)| *u).map(|(c, _)| c) {
            text.push(',');
            text.push_str(name);
        }
        text.push('\n');
        let first = self.cells.first().map_or(0, |c| c.0);
        for row in self.cells.chunk_by(|a, b| a.0 == b.0) {
            // Writing to a string cannot fail.
            let _ = write!(text, "{}.{:06}", row[0].0 / 1_000_000, row[0].0 % 1_000_000);
            let mut cells = row.iter().peekable();
            for (i, (_, decimals)) in COLUMNS.iter().enumerate().filter(|(i, _)| used[*i]) {
                text.push(',');
                if let Some(cell) = cells.next_if(|c| usize::from(c.1) == i) {
                    let _ = write!(text, "{:.*}", decimals, cell.2);
                }
            }
            text.push('\n');
        }
        (text, first as f64 * 1e-6, self.gaps_s)
    }
}
