//! PX4: the MAVLink messages `HIL_*` over TCP, in lockstep.
//!
//! PX4 connects to the simulator's port 4560. The simulator sends `HIL_SENSOR`, whose `time_usec` sets PX4's clock, and waits for the
//! `HIL_ACTUATOR_CONTROLS` that answers it. Sources: <https://docs.px4.io/main/en/simulation/> ("PX4 MAVLink API"), PX4-Autopilot
//! `src/modules/simulation/simulator_mavlink/SimulatorMavlink.cpp`; message definitions of MAVLink `common.xml` by the crate `mavlink`.

use mavlink::dialects::common::{
    COMMAND_LONG_DATA, HEARTBEAT_DATA, HIL_ACTUATOR_CONTROLS_DATA, HIL_GPS_DATA, HIL_SENSOR_DATA,
    HIL_STATE_QUATERNION_DATA, HilActuatorControlsFlags, HilSensorUpdatedFlags, MavAutopilot, MavCmd,
    MavMessage, MavModeFlag, MavState, MavType, SYSTEM_TIME_DATA,
};
use mavlink::{
    MAV_STX, MAV_STX_V2, MAVLinkV2MessageRaw, MavHeader, MavlinkVersion, Message as _, MessageData,
};

use crate::earth::{GRAVITY_M_S2, Home, pressure_altitude_m};
use crate::frames::{narrow, quat_wxyz_ned, turned};
use crate::{ProtocolError, Truth};

/// TCP port of a simulator of the first instance of PX4; that of instance i is 4560 + i.
pub const PORT: u16 = 4560;
/// Outputs of `HIL_ACTUATOR_CONTROLS`.
pub const N_CONTROLS: usize = 16;
/// Number of `HIL_STATE_QUATERNION`.
pub const STATE_QUATERNION: u32 = HIL_STATE_QUATERNION_DATA::ID;

/// What PX4 commands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ActuatorControls {
    /// PX4's time, µs; in lockstep that of the `HIL_SENSOR` that it answers.
    pub time_us: u64,
    /// Outputs, 0 to 1 for motors, all zero while disarmed.
    pub controls: [f32; N_CONTROLS],
    /// Whether the vehicle is armed.
    pub armed: bool,
    /// Whether PX4 was built for lockstep, and so waits for the next `HIL_SENSOR`.
    pub lockstep: bool,
}

/// A message from PX4.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Message {
    /// What its motors shall do.
    ActuatorControls(ActuatorControls),
    /// It asks for a message at an interval, `MAV_CMD_SET_MESSAGE_INTERVAL`.
    Interval {
        /// Number of the message.
        message: u32,
        /// Time between two, µs; 0 the default, below 0 none.
        interval_us: i64,
    },
    /// Any other, by its number; heartbeats (0) are such.
    Other(u32),
}

/// Takes messages out of a stream of bytes: MAVLink 1 and 2, those whose checksum is right.
#[derive(Clone, Debug, Default)]
pub struct Reader {
    buffer: Vec<u8>,
    skipped: u64,
    messages: u64,
}

/// What the beginning of a buffer is.
enum Start {
    /// A message and its length.
    Message(Message, usize),
    /// The first bytes of a message.
    Short,
    /// No message begins here.
    Foreign,
}

impl Reader {
    /// Adds what has arrived.
    pub fn push(&mut self, bytes: &[u8]) {
        self.buffer.extend_from_slice(bytes);
    }

    /// The next message that is whole.
    pub fn next_message(&mut self) -> Option<Message> {
        loop {
            match start(&self.buffer) {
                Start::Message(message, length) => {
                    self.buffer.drain(..length);
                    self.messages += 1;
                    return Some(message);
                }
                Start::Short => return None,
                Start::Foreign => {
                    // As far as the next byte that could begin a message.
                    let is_start = |b: &u8| matches!(*b, MAV_STX | MAV_STX_V2);
                    let n = self.buffer[1..].iter().position(is_start).map_or(self.buffer.len(), |k| k + 1);
                    self.buffer.drain(..n);
                    self.skipped += n as u64;
                }
            }
        }
    }

    /// Bytes so far that were part of no message.
    pub fn skipped(&self) -> u64 {
        self.skipped
    }

    /// Refuses a stream in which many bytes came and no message was: something else than PX4 talks here.
    ///
    /// # Errors
    /// [`ProtocolError::Packet`].
    pub fn check(&self) -> Result<(), ProtocolError> {
        /// More than the longest message, and than the rest of one at which a stream was entered.
        const MANY: u64 = 1024;
        if self.messages > 0 || self.skipped < MANY {
            return Ok(());
        }
        Err(ProtocolError::Packet {
            stack: "PX4",
            expected: "messages of MAVLink 1 or 2 with right checksums".into(),
            got: format!("{} bytes without one: something else is connected to this port", self.skipped),
        })
    }
}

fn start(bytes: &[u8]) -> Start {
    let Some(first) = bytes.first() else { return Start::Short };
    let (version, header, signed) = match *first {
        MAV_STX => (MavlinkVersion::V1, 6, 0),
        // Of the flags that a reader must know, a signature (1) is known; its 13 bytes are passed over.
        MAV_STX_V2 => match bytes.get(2) {
            None => return Start::Short,
            Some(flags) if flags & !1 != 0 => return Start::Foreign,
            Some(flags) => (MavlinkVersion::V2, 10, 13 * usize::from(flags & 1)),
        },
        _ => return Start::Foreign,
    };
    let Some(payload_len) = bytes.get(1) else { return Start::Short };
    let end = header + usize::from(*payload_len);
    let Some(frame) = bytes.get(..end + 2 + signed) else { return Start::Short };
    let id = match version {
        MavlinkVersion::V1 => u32::from(frame[5]),
        MavlinkVersion::V2 => u32::from_le_bytes([frame[7], frame[8], frame[9], 0]),
    };
    let crc = mavlink::calculate_crc(&frame[1..end], MavMessage::extra_crc(id));
    if crc.to_le_bytes() != frame[end..end + 2] {
        return Start::Foreign;
    }
    Start::Message(message(version, id, &frame[header..end]), end + 2 + signed)
}

fn message(version: MavlinkVersion, id: u32, payload: &[u8]) -> Message {
    match id {
        HIL_ACTUATOR_CONTROLS_DATA::ID => {
            HIL_ACTUATOR_CONTROLS_DATA::deser(version, payload).map_or(Message::Other(id), |m| {
                Message::ActuatorControls(ActuatorControls {
                    time_us: m.time_usec,
                    // Outputs without a value are NaN.
                    controls: m.controls.map(|u| if u.is_finite() { u } else { 0.0 }),
                    armed: m.mode.contains(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED),
                    lockstep: m
                        .flags
                        .contains(HilActuatorControlsFlags::HIL_ACTUATOR_CONTROLS_FLAGS_LOCKSTEP),
                })
            })
        }
        COMMAND_LONG_DATA::ID => match COMMAND_LONG_DATA::deser(version, payload) {
            Ok(m) if m.command == MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL => {
                Message::Interval { message: m.param1 as u32, interval_us: m.param2 as i64 }
            }
            _ => Message::Other(id),
        },
        _ => Message::Other(id),
    }
}

/// What the sensors of one step read, in our frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensors {
    /// Time, µs.
    pub time_us: u64,
    /// Accelerometer, m/s², body.
    pub accel_m_s2: [f64; 3],
    /// Gyroscope, rad/s, body.
    pub gyro_rad_s: [f64; 3],
    /// Magnetometer, gauss, body, where it has a new sample.
    pub mag_gauss: Option<[f64; 3]>,
    /// Pressure (Pa) and temperature (°C), where the barometer has a new sample.
    pub baro: Option<(f64, f64)>,
}

/// A fix of the satellite receiver, in our frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fix {
    /// Time, µs.
    pub time_us: u64,
    /// Position from home, m, world.
    pub pos_m: [f64; 3],
    /// Velocity, m/s, world.
    pub vel_m_s: [f64; 3],
    /// Standard deviation of the horizontal position, m.
    pub horizontal_m: f64,
    /// Standard deviation of the height, m.
    pub vertical_m: f64,
}

/// Makes the messages of a simulator: MAVLink 2, system 1, component 200 (`MAV_COMP_ID_SYSTEM_CONTROL`, as PX4's simulators say).
#[derive(Clone, Debug, Default)]
pub struct Writer {
    sequence: u8,
}

impl Writer {
    fn write<D: MessageData>(&mut self, data: &D, out: &mut Vec<u8>) {
        let header = MavHeader { system_id: 1, component_id: 200, sequence: self.sequence };
        self.sequence = self.sequence.wrapping_add(1);
        let mut raw = MAVLinkV2MessageRaw::new();
        raw.serialize_message_data(header, data);
        out.extend_from_slice(raw.raw_bytes());
    }

    /// Appends a `HEARTBEAT` of a simulator.
    pub fn heartbeat(&mut self, out: &mut Vec<u8>) {
        let data = HEARTBEAT_DATA {
            custom_mode: 0,
            mavtype: MavType::MAV_TYPE_GENERIC,
            autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
            base_mode: MavModeFlag::empty(),
            system_status: MavState::MAV_STATE_ACTIVE,
            mavlink_version: 3,
        };
        self.write(&data, out);
    }

    /// Appends a `SYSTEM_TIME`: time since 1970 and since the start, µs.
    pub fn system_time(&mut self, unix_us: u64, since_start_us: u64, out: &mut Vec<u8>) {
        let data = SYSTEM_TIME_DATA { time_unix_usec: unix_us, time_boot_ms: (since_start_us / 1000) as u32 };
        self.write(&data, out);
    }

    /// Appends a `HIL_SENSOR`.
    pub fn sensors(&mut self, read: &Sensors, out: &mut Vec<u8>) {
        use HilSensorUpdatedFlags as Flag;
        let mut updated = Flag::HIL_SENSOR_UPDATED_XACC
            | Flag::HIL_SENSOR_UPDATED_YACC
            | Flag::HIL_SENSOR_UPDATED_ZACC
            | Flag::HIL_SENSOR_UPDATED_XGYRO
            | Flag::HIL_SENSOR_UPDATED_YGYRO
            | Flag::HIL_SENSOR_UPDATED_ZGYRO;
        if read.mag_gauss.is_some() {
            updated |=
                Flag::HIL_SENSOR_UPDATED_XMAG | Flag::HIL_SENSOR_UPDATED_YMAG | Flag::HIL_SENSOR_UPDATED_ZMAG;
        }
        if read.baro.is_some() {
            // PX4 takes a barometer's sample where these three are set.
            updated |= Flag::HIL_SENSOR_UPDATED_ABS_PRESSURE
                | Flag::HIL_SENSOR_UPDATED_PRESSURE_ALT
                | Flag::HIL_SENSOR_UPDATED_TEMPERATURE;
        }
        let [xacc, yacc, zacc] = narrow(turned(read.accel_m_s2));
        let [xgyro, ygyro, zgyro] = narrow(turned(read.gyro_rad_s));
        let [xmag, ymag, zmag] = narrow(turned(read.mag_gauss.unwrap_or_default()));
        let (pressure_alt, (pressure_pa, celsius)) =
            read.baro.map_or((0.0, (0.0, 0.0)), |baro| (pressure_altitude_m(baro.0), baro));
        let data = HIL_SENSOR_DATA {
            time_usec: read.time_us,
            xacc,
            yacc,
            zacc,
            xgyro,
            ygyro,
            zgyro,
            xmag,
            ymag,
            zmag,
            abs_pressure: (0.01 * pressure_pa) as f32,
            diff_pressure: 0.0,
            pressure_alt: pressure_alt as f32,
            temperature: celsius as f32,
            fields_updated: updated,
        };
        self.write(&data, out);
    }

    /// Appends a `HIL_GPS`, a fix in three dimensions by ten satellites.
    pub fn fix(&mut self, fix: &Fix, home: &Home, out: &mut Vec<u8>) {
        let [lat, lon, alt] = degrees(home, fix.pos_m);
        let [north, east, down] = turned(fix.vel_m_s);
        let ground = north.hypot(east);
        let course_deg = east.atan2(north).to_degrees().rem_euclid(360.0);
        let cm = |v: f64| (100.0 * v).round();
        let data = HIL_GPS_DATA {
            time_usec: fix.time_us,
            lat,
            lon,
            alt,
            eph: cm(fix.horizontal_m) as u16,
            epv: cm(fix.vertical_m) as u16,
            vel: cm(ground) as u16,
            vn: cm(north) as i16,
            ve: cm(east) as i16,
            vd: cm(down) as i16,
            // 65535 is "unknown": a vehicle that stands has no course.
            cog: if ground < 0.1 { u16::MAX } else { (cm(course_deg) as u16) % 36_000 },
            fix_type: 3,
            satellites_visible: 10,
        };
        self.write(&data, out);
    }

    /// Appends a `HIL_STATE_QUATERNION`, the truth that PX4 logs as such.
    pub fn state(&mut self, truth: &Truth, home: &Home, out: &mut Vec<u8>) {
        let [lat, lon, alt] = degrees(home, truth.pos_m);
        let [rollspeed, pitchspeed, yawspeed] = narrow(turned(truth.ang_vel_rad_s));
        let [vx, vy, vz] = turned(truth.vel_m_s).map(|v| (100.0 * v).round() as i16);
        let [xacc, yacc, zacc] = turned(truth.accel_m_s2).map(|a| (1000.0 * a / GRAVITY_M_S2).round() as i16);
        let airspeed = (100.0 * truth.airspeed_m_s()).round() as u16;
        let data = HIL_STATE_QUATERNION_DATA {
            time_usec: truth.time_us(),
            attitude_quaternion: narrow(quat_wxyz_ned(truth.quat_xyzw)),
            rollspeed,
            pitchspeed,
            yawspeed,
            lat,
            lon,
            alt,
            vx,
            vy,
            vz,
            ind_airspeed: airspeed,
            true_airspeed: airspeed,
            xacc,
            yacc,
            zacc,
        };
        self.write(&data, out);
    }
}

/// Latitude and longitude in 1e-7 degrees, height above the sea in mm.
fn degrees(home: &Home, pos_m: [f64; 3]) -> [i32; 3] {
    let [lat, lon, alt] = home.at(pos_m);
    [(1e7 * lat).round() as i32, (1e7 * lon).round() as i32, (1e3 * alt).round() as i32]
}

#[cfg(test)]
mod tests;
