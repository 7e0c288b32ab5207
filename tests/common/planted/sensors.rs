//! What is measured: motion capture, gyroscope, accelerometer, rotor speeds, battery; and the log as CSV.

use super::Marker;
use super::hidden::stream;
use super::linear::{M, Q, V, add, mat_t_vec, mat_vec, matrix, quat_exp, quat_mul, quat_unit, sub};
use super::pilot::Reference;
use super::world::{Air, State, World, attitude, part};
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
            battery: true,
            references: true,
            load: true,
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
}

impl Figures {
    /// The figures of a flight; what varies within a level is drawn.
    pub fn new(level: NoiseLevel, seed: u64, flight: u64) -> Self {
        let mut s = stream(seed, flight, "figures");
        let calm = s.uniform(0.03, 0.05);
        let fine = Self {
            pose_hz: 240.0,
            position_m: 0.3e-3,
            attitude_rad: 0.2f64.to_radians(),
            imu_hz: 500.0,
            gyro_rad_s: 0.01,
            accel_m_s2: 0.1,
            rotor_hz: 250.0,
            rotor_rad_s: 3.0,
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
                rotor_rad_s: 10.0,
                pose_jitter_s: 0.5e-3,
                imu_jitter_s: 0.1e-3,
                dropout: 0.02,
                turbulence_m_s: 3.0 * calm,
                ..fine
            },
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
    ("cmd_rotor1", 4),
    ("cmd_rotor2", 4),
    ("cmd_rotor3", 4),
    ("cmd_rotor4", 4),
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
const GYRO: usize = 7;
const ACCEL: usize = 10;
const ROTOR: usize = 13;
const COMMAND: usize = 17;
const BATTERY: usize = 21;
const REFERENCE: usize = 22;
const PAYLOAD: usize = 32;
const NEIGHBOUR: usize = 35;

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
    pub commands: [f64; 4],
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
    mount: M,
    mount_q: Q,
    clock_s: V,
    seconds: f64,
    has_cable: bool,
    has_neighbour: bool,
    cells: Vec<(i64, u8, f64)>,
    gaps_s: Vec<[f64; 2]>,
}

impl Recorder {
    /// A recorder for one flight.
    pub fn new(
        sensors: Sensors,
        figures: &Figures,
        world: &World,
        marker: Marker,
        seconds: f64,
        seed: u64,
        flight: u64,
    ) -> Self {
        let d = &world.dev;
        let mut gap_stream = stream(seed, flight, "gaps");
        // One gap of 0.1 to 0.2 s per minute, and by chance one in a shorter flight.
        let gaps = (seconds / 60.0 + gap_stream.unit()).floor() as usize;
        let mut gaps_s: Vec<[f64; 2]> = (0..gaps)
            .map(|_| {
                let from = gap_stream.uniform(0.05, 0.95) * seconds;
                [from, from + gap_stream.uniform(0.1, 0.2)]
            })
            .collect();
        gaps_s.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let mut channels = Vec::new();
        let mut add_channel = |id: ChannelId, name: &str, hz: f64, jitter_s: f64, dropout: f64| {
            let mut s = stream(seed, flight, &format!("{name} times"));
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
                let gap = id == ChannelId::Pose && gaps_s.iter().any(|g| t >= g[0] && t < g[1]);
                if !lost && !gap && t <= seconds {
                    times.push(t);
                }
            }
            let noise = stream(seed, flight, &format!("{name} noise"));
            channels.push(Channel { id, times, next: 0, noise });
        };
        let f = figures;
        if sensors.poses {
            add_channel(ChannelId::Pose, "pose", f.pose_hz, f.pose_jitter_s, f.dropout);
        }
        if sensors.gyro {
            add_channel(ChannelId::Gyro, "gyro", f.imu_hz, f.imu_jitter_s, 0.0);
        }
        if sensors.accel {
            add_channel(ChannelId::Accel, "accel", f.imu_hz, f.imu_jitter_s, 0.0);
        }
        if sensors.rotors {
            add_channel(ChannelId::Rotor, "rotor", f.rotor_hz, f.imu_jitter_s, 0.0);
        }
        if sensors.battery {
            add_channel(ChannelId::Battery, "battery", 10.0, 1e-3, 0.0);
        }
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
            mount: matrix(mount_q),
            mount_q,
            clock_s: d.clock_s,
            seconds,
            has_cable: d.has_cable() && sensors.load,
            has_neighbour: false,
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
    pub fn command(&mut self, tick: i64, t: f64, command: &[f64; 4], r: &Reference) {
        if t > self.seconds {
            return;
        }
        if self.sensors.commands {
            self.write(t, COMMAND, command);
        }
        if self.sensors.references && tick % 5 == 0 {
            let yaw = r.yaw.sin().atan2(r.yaw.cos());
            let row = [r.p, r.v, r.a].concat();
            self.write(t, REFERENCE, &row);
            self.write(t, REFERENCE + 9, &[yaw]);
        }
    }

    /// Takes a sample of the sensor number `channel`.
    pub fn take(&mut self, channel: usize, world: &World, now: &Sample) {
        let c = &mut self.channels[channel];
        c.next += 1;
        let id = c.id;
        let mut noise = c.noise.clone();
        let mut three = |sigma: f64| -> V { std::array::from_fn(|_| sigma * noise.normal()) };
        let d = &world.dev;
        let (x, f) = (now.state, self.figures);
        let q = attitude(x);
        match id {
            ChannelId::Pose => {
                let t = now.t + self.clock_s[0];
                let at = add(part(x, 0), mat_vec(matrix(q), self.marker_m));
                let seen = add(mat_vec(self.tilt, at), three(f.position_m));
                let turned = quat_mul(quat_mul(self.tilt_q, q), self.mount_q);
                let seen_q = quat_unit(quat_mul(turned, quat_exp(three(f.attitude_rad))));
                self.write(t, 0, &seen);
                self.write(t, 3, &seen_q);
                if self.has_cable {
                    let at = add(mat_vec(self.tilt, part(x, 17)), three(f.position_m));
                    self.write(t, PAYLOAD, &at);
                }
                if let Some(p) = now.neighbour_m {
                    self.has_neighbour = true;
                    let at = add(mat_vec(self.tilt, p), three(f.position_m));
                    self.write(t, NEIGHBOUR, &at);
                }
            }
            ChannelId::Gyro => {
                let w = mat_t_vec(self.mount, part(x, 10));
                let scaled: V =
                    std::array::from_fn(|i| (1.0 + d.gyro_scale[i]) * w[i] + d.gyro_bias_rad_s[i]);
                self.write(now.t + self.clock_s[1], GYRO, &add(scaled, three(f.gyro_rad_s)));
            }
            ChannelId::Accel => {
                let rate = world.rate(now.t, x, &now.commands, now.air);
                let force = mat_t_vec(matrix(q), sub(part(&rate, 7), world.gravity));
                let seen = add(mat_t_vec(self.mount, force), d.accel_bias_m_s2);
                self.write(now.t + self.clock_s[2], ACCEL, &add(seen, three(f.accel_m_s2)));
            }
            ChannelId::Rotor => {
                let n = [three(f.rotor_rad_s), three(f.rotor_rad_s)].concat();
                let seen: Vec<f64> = (0..4).map(|i| (x[13 + i] + n[i]).max(0.0)).collect();
                self.write(now.t, ROTOR, &seen);
            }
            ChannelId::Battery => {
                // Without sag the speed controllers make up for a battery that runs down by 4 %.
                let hidden = world.voltage_share(now.t);
                let share = if d.sag_share > 0.0 { hidden } else { 1.0 - 0.04 * now.t / self.seconds };
                self.write(now.t, BATTERY, &[FULL_V * share + three(f.battery_v)[0]]);
            }
        }
        self.channels[channel].noise = noise;
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
