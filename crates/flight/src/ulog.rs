//! PX4 flight logs (ULog): topics of the estimator, sensors, motors and battery.
//!
//! PX4's local frame is north-east-down with forward-right-down bodies and quaternions w, x, y, z from body to world;
//! here x stays north and forward, y turns to west and left, z up. (PX4 message definitions, msg/*.msg.)

use super::channel::Channel;
use super::error::{FlightError, Result};
use super::files::parsed;
use super::{ClockFault, FlightLog, Mapping};
use propwash_trace::units::rpm_to_rad_s;
use px4_ulog::stream_parser::model::{DataMessage, FlattenedFieldType, FlattenedFormat};
use px4_ulog::stream_parser::{Message, SimpleCallbackResult, read_file_with_simple_callback};
use std::collections::BTreeMap;

/// First bytes of a ULog file.
pub(super) const MAGIC: &[u8] = b"ULog\x01\x12\x35";

/// Topics that are read, with the fields of each.
const TOPICS: &[(&str, &[&str])] = &[
    ("vehicle_local_position", &["x", "y", "z", "vx", "vy", "vz"]),
    ("vehicle_attitude", &["q[0]", "q[1]", "q[2]", "q[3]"]),
    ("vehicle_angular_velocity", &["xyz[0]", "xyz[1]", "xyz[2]"]),
    ("vehicle_acceleration", &["xyz[0]", "xyz[1]", "xyz[2]"]),
    (
        "sensor_combined",
        &[
            "gyro_rad[0]",
            "gyro_rad[1]",
            "gyro_rad[2]",
            "accelerometer_m_s2[0]",
            "accelerometer_m_s2[1]",
            "accelerometer_m_s2[2]",
        ],
    ),
    ("battery_status", &["voltage_v"]),
    ("vehicle_local_position_setpoint", &["x", "y", "z", "vx", "vy", "vz", "yaw"]),
];

/// Most motors that are read.
const MAX_MOTORS: usize = 12;

/// Samples of a topic: time, s, and the fields; NaN where a field is not in the message.
#[derive(Default)]
struct Topic {
    t_s: Vec<f64>,
    values: Vec<Vec<f64>>,
}

fn motor_fields(topic: &str) -> Option<Vec<String>> {
    let pattern = match topic {
        "actuator_motors" => "control[#]",
        "actuator_outputs" => "output[#]",
        "esc_status" => "esc[#].esc_rpm",
        _ => return None,
    };
    Some((0..MAX_MOTORS).map(|i| pattern.replace('#', &i.to_string())).collect())
}

/// A number of a message, whatever its type.
fn number(format: &FlattenedFormat, name: &str, data: &[u8]) -> Option<f64> {
    let field = format.fields.iter().find(|f| f.flattened_field_name == name)?;
    let bytes = data.get(usize::from(field.offset)..)?;
    fn take<const N: usize>(bytes: &[u8]) -> Option<[u8; N]> {
        bytes.get(..N)?.try_into().ok()
    }
    Some(match field.field_type {
        FlattenedFieldType::Int8 => f64::from(i8::from_le_bytes(take(bytes)?)),
        FlattenedFieldType::UInt8 => f64::from(u8::from_le_bytes(take(bytes)?)),
        FlattenedFieldType::Int16 => f64::from(i16::from_le_bytes(take(bytes)?)),
        FlattenedFieldType::UInt16 => f64::from(u16::from_le_bytes(take(bytes)?)),
        FlattenedFieldType::Int32 => f64::from(i32::from_le_bytes(take(bytes)?)),
        FlattenedFieldType::UInt32 => f64::from(u32::from_le_bytes(take(bytes)?)),
        FlattenedFieldType::Int64 => i64::from_le_bytes(take(bytes)?) as f64,
        FlattenedFieldType::UInt64 => u64::from_le_bytes(take(bytes)?) as f64,
        FlattenedFieldType::Float => f64::from(f32::from_le_bytes(take(bytes)?)),
        FlattenedFieldType::Double => f64::from_le_bytes(take(bytes)?),
        FlattenedFieldType::Bool | FlattenedFieldType::Char => return None,
    })
}

/// Reads a ULog file into `log`. Of a mapping only `format` may be given: units and frames of ULog are fixed.
pub(super) fn read(log: &mut FlightLog, mapping: Option<&Mapping>) -> Result<()> {
    if mapping.is_some() {
        log.warnings
            .push("units and frames of a ULog are fixed: only `format` of the mapping was used".into());
    }
    let format = |expected: &str, found: String, remedy: &str| FlightError::Format {
        path: log.path.clone(),
        expected: expected.into(),
        found,
        remedy: remedy.into(),
    };
    let Some(name) = log.path.to_str() else {
        return Err(format("a path in UTF-8", "another".into(), "rename the file"));
    };
    let mut topics: BTreeMap<String, Topic> = BTreeMap::new();
    let mut dropouts_ms = 0u64;
    let mut repeated = 0u64;
    let mut take = |message: &Message| {
        match message {
            Message::Data(data) if data.multi_id.value() == 0 => {
                repeated += u64::from(!keep(&mut topics, data));
            }
            Message::DropoutMessage(dropout) => dropouts_ms += u64::from(dropout.duration_ms),
            _ => {}
        }
        SimpleCallbackResult::KeepReading
    };
    let completeness = parsed(|| read_file_with_simple_callback(name, &mut take))
        .and_then(|read| read.map_err(|e| e.to_string()))
        .map_err(|found| format("a PX4 ULog file", found, "copy the log from the vehicle again"))?;
    if completeness.is_incomplete() {
        log.warnings.push("the file ends inside a record: what stands before it was read".into());
    }
    if repeated > 0 {
        log.warnings.push(format!("{repeated} messages repeat the time of the one before and were left out"));
    }
    if dropouts_ms > 0 {
        log.warnings.push(format!("the logger dropped messages for {dropouts_ms} ms in all"));
    }
    fill(log, &topics);
    let mut any = false;
    log.for_each(|_, _| any = true);
    if !any {
        return Err(FlightError::Format {
            path: log.path.clone(),
            expected: "topics such as vehicle_local_position, vehicle_attitude, sensor_combined".into(),
            found: "none of them".into(),
            remedy: "log the default topics of PX4 (parameter SDLOG_PROFILE)".into(),
        });
    }
    log.n_rows = topics.values().map(|t| t.t_s.len()).sum();
    log.start_s = topics.values().filter_map(|t| t.t_s.first().copied()).fold(f64::INFINITY, f64::min);
    log.clock_faults.extend(topics.values().flat_map(clock_faults));
    Ok(())
}

/// Keeps a sample of a topic that is read; false where it repeats the time of the one before.
fn keep(topics: &mut BTreeMap<String, Topic>, data: &DataMessage) -> bool {
    let topic = &data.flattened_format.message_name;
    let fields: Vec<String> = match TOPICS.iter().find(|(n, _)| n == topic) {
        Some((_, fields)) => fields.iter().map(|f| f.to_string()).collect(),
        None => match motor_fields(topic) {
            Some(fields) => fields,
            None => return true,
        },
    };
    let stamp = number(data.flattened_format, "timestamp_sample", data.data)
        .filter(|t| *t > 0.0)
        .or_else(|| number(data.flattened_format, "timestamp", data.data));
    if let Some(us) = stamp {
        let values =
            fields.iter().map(|f| number(data.flattened_format, f, data.data).unwrap_or(f64::NAN)).collect();
        let entry = topics.entry(topic.clone()).or_default();
        // The same sample may be published again; the first is kept.
        if entry.t_s.last() == Some(&(us * 1e-6)) {
            return false;
        }
        entry.t_s.push(us * 1e-6);
        entry.values.push(values);
    }
    true
}

/// Times of a topic that do not rise.
fn clock_faults(topic: &Topic) -> Vec<ClockFault> {
    let fault =
        |i: usize| ClockFault { row: i + 1, before_s: topic.t_s[i - 1], time_s: topic.t_s[i], topic: None };
    (1..topic.t_s.len()).filter(|i| topic.t_s[*i] <= topic.t_s[*i - 1]).map(fault).collect()
}

/// The named columns of a topic where all are finite.
fn take<const N: usize>(topics: &BTreeMap<String, Topic>, topic: &str, first: usize) -> Channel<N> {
    let mut out = Channel::default();
    if let Some(topic) = topics.get(topic) {
        for (t, row) in topic.t_s.iter().zip(&topic.values) {
            let value: [f64; N] = std::array::from_fn(|k| row[first + k]);
            if value.iter().all(|v| v.is_finite()) {
                out.push(*t, value);
            }
        }
    }
    out
}

/// The motors of a topic that ever have a value, each as a channel; motors after the last used one are left out.
fn motors(topics: &BTreeMap<String, Topic>, topic: &str, f: impl Fn(f64) -> f64) -> Vec<Channel<1>> {
    let mut all: Vec<Channel<1>> =
        (0..MAX_MOTORS).map(|i| take::<1>(topics, topic, i).map(|v| [f(v[0])])).collect();
    while all.last().is_some_and(|c| c.values.iter().all(|v| v[0] == 0.0)) {
        all.pop();
    }
    all
}

fn fill(log: &mut FlightLog, topics: &BTreeMap<String, Topic>) {
    let turn = |v: [f64; 3]| [v[0], -v[1], -v[2]];
    log.position_m = take::<3>(topics, "vehicle_local_position", 0).map(turn);
    log.velocity_m_s = take::<3>(topics, "vehicle_local_position", 3).map(turn);
    log.attitude = take::<4>(topics, "vehicle_attitude", 0).map(|q| [q[1], -q[2], -q[3], q[0]]);
    log.angular_velocity_rad_s = take::<3>(topics, "vehicle_angular_velocity", 0).map(turn);
    if log.angular_velocity_rad_s.is_empty() {
        log.angular_velocity_rad_s = take::<3>(topics, "sensor_combined", 0).map(turn);
    }
    log.specific_force_m_s2 = take::<3>(topics, "vehicle_acceleration", 0).map(turn);
    if log.specific_force_m_s2.is_empty() {
        log.specific_force_m_s2 = take::<3>(topics, "sensor_combined", 3).map(turn);
    }
    log.vbat_v = take::<1>(topics, "battery_status", 0);
    log.ref_position_m = take::<3>(topics, "vehicle_local_position_setpoint", 0).map(turn);
    log.ref_velocity_m_s = take::<3>(topics, "vehicle_local_position_setpoint", 3).map(turn);
    log.ref_yaw_rad = take::<1>(topics, "vehicle_local_position_setpoint", 6).map(|y| [-y[0]]);
    log.rotor_speed_rad_s = motors(topics, "esc_status", rpm_to_rad_s);
    log.cmd_u = motors(topics, "actuator_motors", |u| u);
    if log.cmd_u.is_empty() {
        log.cmd_u = motors(topics, "actuator_outputs", |pwm| (pwm - 1000.0) * 1e-3);
        // Outputs of 0 stand for channels that are not in use.
        while log.cmd_u.last().is_some_and(|c| c.values.iter().all(|v| v[0] <= -0.1)) {
            log.cmd_u.pop();
        }
        if !log.cmd_u.is_empty() {
            log.warnings.push(
                "cmd_u comes from actuator_outputs, with 1000 µs taken as 0 and 2000 µs as 1: check PWM_MAIN_MIN and \
                 PWM_MAIN_MAX"
                    .into(),
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_on_which_the_parser_panics_is_an_error_that_names_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("odd.ulg");
        // The head with version 1 and a time, flags that are all zero, and a parameter ('P') without a single byte.
        let mut bytes = [MAGIC, &[1], &[0; 8]].concat();
        bytes.extend([40, 0, b'B']);
        bytes.extend([0; 40]);
        bytes.extend([0, 0, b'P']);
        std::fs::write(&path, bytes).unwrap();
        let said = FlightLog::load(&path, None).unwrap_err().to_string();
        for words in ["odd.ulg", "expected a PX4 ULog file", "the parser gives up", "copy the log"] {
            assert!(said.contains(words), "{said}");
        }
    }
}
