//! What messages tell whose types say it: channels that are found without a mapping.
//!
//! Worlds of ROS are z up, bodies forward-left-up (REP 103); an `Imu` gives specific force and rates of the body (REP 145); the twist of an `Odometry`
//! stands in its child frame (nav_msgs/msg/Odometry.msg). Messages of PX4 are north-east-down and forward-right-down, as in a ULog (PX4-Autopilot,
//! msg/*.msg).

use super::topic::Topic;
use crate::channel::Channel;
use crate::correction;
use crate::mapping::{Attitude, Mapping, to_euler};
use crate::{FlightError, FlightLog, Result};
use propwash_trace::math::quat;
use propwash_trace::units::rpm_to_rad_s;
use std::collections::BTreeMap;

/// Most motors that are read.
const MAX_MOTORS: usize = 16;

/// What a topic may give.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Gives {
    Position,
    Attitude,
    Velocity,
    Rates,
    Force,
    Battery,
    Rotors,
    Throttle,
    Angles,
    Reference,
}

impl Gives {
    /// In the order in which channels are filled: what is turned by the attitude comes after it.
    const ALL: [Self; 10] = [
        Self::Position,
        Self::Attitude,
        Self::Velocity,
        Self::Rates,
        Self::Force,
        Self::Battery,
        Self::Rotors,
        Self::Throttle,
        Self::Angles,
        Self::Reference,
    ];

    fn words(self) -> &'static str {
        match self {
            Self::Position => "position",
            Self::Attitude => "attitude",
            Self::Velocity => "velocity",
            Self::Rates => "body rates",
            Self::Force => "specific force",
            Self::Battery => "battery voltage",
            Self::Rotors => "rotor speeds",
            Self::Throttle => "motor commands",
            Self::Angles => "commanded attitude",
            Self::Reference => "reference",
        }
    }

    /// A name of the contract that tells whether a mapping gives this channel itself.
    fn name(self) -> &'static str {
        match self {
            Self::Position => "px",
            Self::Attitude => "qx",
            Self::Velocity => "vx",
            Self::Rates => "wx",
            Self::Force => "ax",
            Self::Battery => "vbat",
            Self::Rotors => "rotor1",
            Self::Throttle => "cmd_u1",
            Self::Angles => "cmd_roll",
            Self::Reference => "ref_x",
        }
    }

    /// Whether it stands in the world, which ROS and PX4 turn differently.
    fn in_world(self) -> bool {
        matches!(self, Self::Position | Self::Attitude | Self::Velocity | Self::Reference)
    }

    /// Whether it is asked for and not measured.
    fn is_command(self) -> bool {
        matches!(self, Self::Throttle | Self::Angles | Self::Reference)
    }
}

/// Which message gives what; of several kinds the first rank that is there is taken.
const RULES: &[(&str, &[(Gives, u8)])] = &[
    ("geometry_msgs/PoseStamped", &[(Gives::Position, 0), (Gives::Attitude, 0), (Gives::Reference, 0)]),
    ("geometry_msgs/PoseWithCovarianceStamped", &[(Gives::Position, 0), (Gives::Attitude, 0)]),
    ("geometry_msgs/Pose", &[(Gives::Position, 0), (Gives::Attitude, 0)]),
    ("geometry_msgs/TransformStamped", &[(Gives::Position, 0), (Gives::Attitude, 0)]),
    ("geometry_msgs/PointStamped", &[(Gives::Position, 0)]),
    ("geometry_msgs/QuaternionStamped", &[(Gives::Attitude, 0)]),
    ("geometry_msgs/TwistStamped", &[(Gives::Velocity, 0)]),
    ("geometry_msgs/TwistWithCovarianceStamped", &[(Gives::Velocity, 0)]),
    (
        "nav_msgs/Odometry",
        &[(Gives::Position, 0), (Gives::Attitude, 0), (Gives::Velocity, 0), (Gives::Rates, 2)],
    ),
    ("sensor_msgs/Imu", &[(Gives::Attitude, 1), (Gives::Rates, 0), (Gives::Force, 0)]),
    ("sensor_msgs/BatteryState", &[(Gives::Battery, 0)]),
    ("mavros_msgs/AttitudeTarget", &[(Gives::Angles, 0)]),
    ("mavros_msgs/RCOut", &[(Gives::Throttle, 1)]),
    ("px4_msgs/VehicleLocalPosition", &[(Gives::Position, 0), (Gives::Velocity, 0)]),
    ("px4_msgs/VehicleAttitude", &[(Gives::Attitude, 0)]),
    (
        "px4_msgs/VehicleOdometry",
        &[(Gives::Position, 1), (Gives::Attitude, 1), (Gives::Velocity, 1), (Gives::Rates, 2)],
    ),
    ("px4_msgs/VehicleAngularVelocity", &[(Gives::Rates, 0)]),
    ("px4_msgs/VehicleAcceleration", &[(Gives::Force, 0)]),
    ("px4_msgs/SensorCombined", &[(Gives::Rates, 1), (Gives::Force, 1)]),
    ("px4_msgs/BatteryStatus", &[(Gives::Battery, 0)]),
    ("px4_msgs/EscStatus", &[(Gives::Rotors, 0)]),
    ("px4_msgs/ActuatorMotors", &[(Gives::Throttle, 0)]),
    ("px4_msgs/ActuatorOutputs", &[(Gives::Throttle, 1)]),
    ("px4_msgs/VehicleLocalPositionSetpoint", &[(Gives::Reference, 0)]),
];

/// Whether messages of a kind may give a channel.
pub(super) fn reads(kind: &str) -> bool {
    RULES.iter().any(|(k, _)| *k == kind)
}

fn rank(kind: &str, gives: Gives) -> Option<u8> {
    let (_, all) = RULES.iter().find(|(k, _)| *k == kind)?;
    all.iter().find(|(g, _)| *g == gives).map(|(_, rank)| *rank)
}

fn of_px4(kind: &str) -> bool {
    kind.starts_with("px4_msgs/")
}

/// Whether the name of a topic says that it is a command.
fn is_commanded(topic: &str) -> bool {
    const WORDS: [&str; 10] =
        ["cmd", "command", "commands", "commanded", "desired", "goal", "ref", "reference", "sp", "target"];
    let lower = topic.to_lowercase();
    lower.contains("setpoint") || lower.split(['/', '_']).any(|word| WORDS.contains(&word))
}

/// Topics by what they give.
#[derive(Debug, Default)]
pub(super) struct Choice {
    pub given: Vec<(Gives, String)>,
    pub notes: Vec<String>,
}

impl Choice {
    fn topic(&self, gives: Gives) -> Option<&str> {
        self.given.iter().find(|(g, _)| *g == gives).map(|(_, t)| t.as_str())
    }

    /// What a topic gives, in words.
    pub fn words(&self, topic: &str) -> String {
        let words: Vec<&str> =
            self.given.iter().filter(|(_, t)| t == topic).map(|(g, _)| g.words()).collect();
        words.join(", ")
    }
}

/// Chooses a topic for every channel that the mapping does not give itself. Of several that could give the position or the attitude none is
/// chosen, since what is made of the log would be that of another vehicle; of others none either, with a note.
///
/// # Errors
/// [`FlightError::Format`] with the topics that are in question.
pub(super) fn choose<'a>(
    log: &FlightLog,
    topics: impl Iterator<Item = &'a Topic>,
    mapping: &Mapping,
) -> Result<Choice> {
    let topics: BTreeMap<&str, &Topic> = topics.map(|t| (t.name.as_str(), t)).collect();
    let mut choice = Choice::default();
    for gives in Gives::ALL {
        let named = mapping.named(gives.name()).is_some()
            || gives == Gives::Attitude && !matches!(mapping.attitude(), Attitude::Contract);
        if named {
            continue;
        }
        let world = choice.topic(Gives::Position).and_then(|t| topics.get(t)).map(|t| of_px4(&t.kind));
        let mut found: Vec<(u8, &Topic)> = topics
            .values()
            .copied()
            .filter(|t| !t.log_ns.is_empty() && (gives.is_command() || !is_commanded(&t.name)))
            .filter(|t| gives != Gives::Reference || of_px4(&t.kind) || is_commanded(&t.name))
            .filter(|t| !gives.in_world() || world.is_none_or(|px4| of_px4(&t.kind) == px4))
            .filter_map(|t| Some((rank(&t.kind, gives)?, t)))
            .filter(|(_, t)| has(t, gives))
            .collect();
        if let Some(best) = found.iter().map(|(rank, _)| *rank).min() {
            found.retain(|(rank, _)| *rank == best);
        }
        // A message that has the position tells of the same body at the same time.
        let same = choice.topic(Gives::Position).filter(|t| found.iter().any(|(_, f)| f.name == **t));
        match (&found[..], same) {
            ([], _) => {}
            (_, Some(topic)) => choice.given.push((gives, topic.to_string())),
            ([(_, topic)], None) => choice.given.push((gives, topic.name.clone())),
            (several, None) => {
                let list: Vec<String> =
                    several.iter().map(|(_, t)| format!("{} ({})", t.name, t.kind)).collect();
                let remedy = format!(
                    "say in a mapping file beside the log which to read (`topics = [\"{}\", …]`, all that belong to the vehicle) or which to pass \
                     over (`ignore = [\"{}\"]`)",
                    several[0].1.name, several[1].1.name
                );
                if matches!(gives, Gives::Position | Gives::Attitude) {
                    return Err(FlightError::Format {
                        path: log.path.clone(),
                        expected: format!("one topic that gives the {}", gives.words()),
                        found: list.join(" and "),
                        remedy,
                    });
                }
                choice.notes.push(format!(
                    "{} left out, since several topics could give it: {}; {remedy}",
                    gives.words(),
                    list.join(", ")
                ));
            }
        }
    }
    Ok(choice)
}

/// Fields of x, y, z under a path.
fn xyz(topic: &Topic, path: &str) -> Option<[Vec<f64>; 3]> {
    let dot = if path.is_empty() { "" } else { "." };
    topic.all(["x", "y", "z"].map(|axis| format!("{path}{dot}{axis}"))).map(|c| c.map(<[f64]>::to_vec))
}

/// Elements of an array.
fn array<const N: usize>(topic: &Topic, path: &str) -> Option<[Vec<f64>; N]> {
    topic.all(std::array::from_fn(|i| format!("{path}[{i}]"))).map(|c| c.map(<[f64]>::to_vec))
}

/// Where a message has its pose: the path of the position and that of the attitude.
fn pose(kind: &str) -> Option<(&'static str, &'static str)> {
    Some(match kind {
        "geometry_msgs/PoseStamped" => ("pose.position", "pose.orientation"),
        "geometry_msgs/PoseWithCovarianceStamped" | "nav_msgs/Odometry" => {
            ("pose.pose.position", "pose.pose.orientation")
        }
        "geometry_msgs/Pose" => ("position", "orientation"),
        "geometry_msgs/TransformStamped" => ("transform.translation", "transform.rotation"),
        "geometry_msgs/PointStamped" => ("point", ""),
        "geometry_msgs/QuaternionStamped" => ("", "quaternion"),
        "sensor_msgs/Imu" => ("", "orientation"),
        _ => return None,
    })
}

fn position(topic: &Topic) -> Option<[Vec<f64>; 3]> {
    match topic.kind.as_str() {
        "px4_msgs/VehicleLocalPosition" => xyz(topic, ""),
        "px4_msgs/VehicleOdometry" => array(topic, "position"),
        kind => xyz(topic, pose(kind)?.0),
    }
}

/// Attitudes xyzw, in the frames of the file.
fn attitude(topic: &Topic) -> Option<[Vec<f64>; 4]> {
    match topic.kind.as_str() {
        "px4_msgs/VehicleAttitude" | "px4_msgs/VehicleOdometry" => {
            let [w, x, y, z] = array(topic, "q")?;
            Some([x, y, z, w])
        }
        "mavros_msgs/AttitudeTarget" => quaternion(topic, "orientation"),
        // The first number of a covariance is −1 where a driver has no such reading (sensor_msgs/msg/Imu.msg).
        "sensor_msgs/Imu" if lacks(topic, "orientation_covariance") => None,
        kind => quaternion(topic, pose(kind)?.1),
    }
}

fn quaternion(topic: &Topic, path: &str) -> Option<[Vec<f64>; 4]> {
    topic.all(["x", "y", "z", "w"].map(|axis| format!("{path}.{axis}"))).map(|c| c.map(<[f64]>::to_vec))
}

fn lacks(topic: &Topic, covariance: &str) -> bool {
    topic.column(&format!("{covariance}[0]")).is_some_and(|c| c.iter().all(|v| *v == -1.0))
}

fn velocity(topic: &Topic) -> Option<[Vec<f64>; 3]> {
    match topic.kind.as_str() {
        "geometry_msgs/TwistStamped" => xyz(topic, "twist.linear"),
        "geometry_msgs/TwistWithCovarianceStamped" | "nav_msgs/Odometry" => xyz(topic, "twist.twist.linear"),
        "px4_msgs/VehicleLocalPosition" => {
            topic.all(["vx", "vy", "vz"].map(String::from)).map(|c| c.map(<[f64]>::to_vec))
        }
        "px4_msgs/VehicleOdometry" => array(topic, "velocity"),
        _ => None,
    }
}

fn rates(topic: &Topic) -> Option<[Vec<f64>; 3]> {
    match topic.kind.as_str() {
        "sensor_msgs/Imu" if lacks(topic, "angular_velocity_covariance") => None,
        "sensor_msgs/Imu" => xyz(topic, "angular_velocity"),
        "nav_msgs/Odometry" if in_own_frame(topic) => None,
        "nav_msgs/Odometry" => xyz(topic, "twist.twist.angular"),
        "px4_msgs/VehicleOdometry" => array(topic, "angular_velocity"),
        "px4_msgs/VehicleAngularVelocity" => array(topic, "xyz"),
        "px4_msgs/SensorCombined" => array(topic, "gyro_rad"),
        _ => None,
    }
}

fn force(topic: &Topic) -> Option<[Vec<f64>; 3]> {
    match topic.kind.as_str() {
        "sensor_msgs/Imu" if lacks(topic, "linear_acceleration_covariance") => None,
        "sensor_msgs/Imu" => xyz(topic, "linear_acceleration"),
        "px4_msgs/VehicleAcceleration" => array(topic, "xyz"),
        "px4_msgs/SensorCombined" => array(topic, "accelerometer_m_s2"),
        _ => None,
    }
}

/// The columns of motors, as far as there are any.
fn motors(topic: &Topic) -> Vec<Vec<f64>> {
    let of = |path: &dyn Fn(usize) -> String| {
        let columns = (0..MAX_MOTORS).map_while(|i| topic.column(&path(i)));
        columns.map(<[f64]>::to_vec).collect()
    };
    match topic.kind.as_str() {
        "px4_msgs/EscStatus" => of(&|i| format!("esc[{i}].esc_rpm")),
        "px4_msgs/ActuatorMotors" => of(&|i| format!("control[{i}]")),
        "px4_msgs/ActuatorOutputs" => of(&|i| format!("output[{i}]")),
        "mavros_msgs/RCOut" => of(&|i| format!("channels[{i}]")),
        _ => Vec::new(),
    }
}

/// Whether an odometry names one frame for its pose and its twist: then both stand in the world.
fn in_own_frame(topic: &Topic) -> bool {
    topic.child_frame().is_some() && topic.child_frame() == topic.frame()
}

fn battery(topic: &Topic) -> Option<&[f64]> {
    topic.column(if of_px4(&topic.kind) { "voltage_v" } else { "voltage" })
}

/// Whether the messages of a topic have what their kind promises.
fn has(topic: &Topic, gives: Gives) -> bool {
    match gives {
        Gives::Position => topic.mixed().is_none() && position(topic).is_some(),
        Gives::Attitude => topic.mixed().is_none() && attitude(topic).is_some(),
        Gives::Velocity => velocity(topic).is_some(),
        Gives::Rates => rates(topic).is_some(),
        Gives::Force => force(topic).is_some(),
        Gives::Battery => battery(topic).is_some(),
        Gives::Rotors | Gives::Throttle => !motors(topic).is_empty(),
        Gives::Angles => attitude(topic).is_some(),
        Gives::Reference => of_px4(&topic.kind) || position(topic).is_some(),
    }
}

/// Samples of columns where all are finite, at times that are.
fn samples<const N: usize>(t: &[f64], columns: &[Vec<f64>; N]) -> Channel<N> {
    let mut out = Channel::default();
    for (i, t) in t.iter().enumerate().filter(|(_, t)| t.is_finite()) {
        let value: [f64; N] = std::array::from_fn(|k| columns[k][i]);
        if value.iter().all(|v| v.is_finite()) {
            out.push(*t, value);
        }
    }
    out
}

/// Turns what a topic has into our frames: those of ROS as the mapping says, those of PX4 as they always are.
struct Frames<'a> {
    px4: bool,
    mapping: &'a Mapping,
}

impl Frames<'_> {
    fn world(&self, v: [f64; 3]) -> [f64; 3] {
        if self.px4 { [v[0], -v[1], -v[2]] } else { self.mapping.to_world(v) }
    }

    fn body(&self, v: [f64; 3]) -> [f64; 3] {
        if self.px4 { [v[0], -v[1], -v[2]] } else { self.mapping.to_body(v) }
    }

    fn attitude(&self, q: [f64; 4]) -> [f64; 4] {
        if self.px4 { [q[0], -q[1], -q[2], q[3]] } else { self.mapping.to_attitude(q) }
    }
}

/// Fills the channel that a topic gives, with its times.
pub(super) fn fill(
    log: &mut FlightLog,
    gives: Gives,
    topic: &Topic,
    t: &[f64],
    mapping: &Mapping,
    world: Option<&str>,
) {
    let frames = Frames { px4: of_px4(&topic.kind), mapping };
    let three = |columns: Option<[Vec<f64>; 3]>| columns.map(|c| samples(t, &c)).unwrap_or_default();
    match gives {
        Gives::Position => log.position_m = three(position(topic)).map(|v| frames.world(v)),
        Gives::Attitude => {
            let columns = attitude(topic).map(|c| samples(t, &c)).unwrap_or_default();
            log.attitude = columns.map(|q| frames.attitude(q));
        }
        Gives::Velocity => fill_velocity(log, topic, t, &frames, world),
        Gives::Rates => log.angular_velocity_rad_s = three(rates(topic)).map(|v| frames.body(v)),
        Gives::Force => log.specific_force_m_s2 = three(force(topic)).map(|v| frames.body(v)),
        Gives::Battery => {
            // Drivers without a voltage write 0.
            let volts = battery(topic).unwrap_or_default();
            let volts = volts.iter().map(|v| if *v > 0.0 { *v } else { f64::NAN }).collect();
            log.vbat_v = samples(t, &[volts]);
        }
        Gives::Rotors => log.rotor_speed_rad_s = of_motors(t, motors(topic), |v| rpm_to_rad_s(v).abs()),
        Gives::Throttle => throttle(log, topic, t),
        Gives::Angles => angles(log, topic, t, &frames),
        Gives::Reference => {
            log.ref_position_m = three(position(topic).or_else(|| xyz(topic, ""))).map(|v| frames.world(v));
            if of_px4(&topic.kind) {
                let columns = topic.all(["vx", "vy", "vz"].map(String::from)).map(|c| c.map(<[f64]>::to_vec));
                log.ref_velocity_m_s = three(columns).map(|v| frames.world(v));
                if let Some(yaw) = topic.column("yaw") {
                    log.ref_yaw_rad = samples(t, &[yaw.to_vec()]).map(|y| [-y[0]]);
                }
            }
        }
    }
}

/// The velocity in the world, whatever frame a message has it in.
fn fill_velocity(log: &mut FlightLog, topic: &Topic, t: &[f64], frames: &Frames, world: Option<&str>) {
    let Some(columns) = velocity(topic) else { return };
    let plain = samples(t, &columns).map(|v| frames.world(v));
    let name = &topic.name;
    match topic.kind.as_str() {
        "nav_msgs/Odometry" if in_own_frame(topic) => log.velocity_m_s = plain,
        "nav_msgs/Odometry" => log.velocity_m_s = turned(topic, t, columns, frames),
        "px4_msgs/VehicleOdometry" => {
            // 3 is the body, the others are level frames of which the pose has one as well (px4_msgs/msg/VehicleOdometry.msg).
            let is = |path: &str, value: f64| topic.column(path).is_some_and(|c| c.iter().all(|v| *v == value));
            if is("velocity_frame", 3.0) {
                log.velocity_m_s = turned(topic, t, columns, frames);
            } else if [1.0, 2.0].iter().any(|f| is("velocity_frame", *f) && is("pose_frame", *f)) {
                log.velocity_m_s = plain;
            } else {
                log.warnings.push(format!("velocity of {name} left out: its velocity_frame is not that of the pose, nor the body"));
            }
        }
        "px4_msgs/VehicleLocalPosition" => log.velocity_m_s = plain,
        _ => match topic.frame() {
            Some(frame) if Some(frame) == world || is_world(frame) => log.velocity_m_s = plain,
            Some(frame) if is_body(frame) => {
                log.velocity_m_s = samples(t, &columns).map(|v| frames.body(v));
                let lost = correction::body_to_world(&mut log.velocity_m_s, &log.attitude);
                log.warnings.push(format!("velocity of {name} stands in the body (`{frame}`) and was turned by the attitude"));
                if lost > 0 {
                    log.warnings.push(format!("{lost} samples of it have no attitude within 0.25 s and were left out"));
                }
            }
            frame => log.warnings.push(format!(
                "velocity of {name} left out: expected the frame of the position, a usual name of the world (map, odom, world) or of the body \
                 (base_link), found `{}`; name its columns in a mapping file, with `frame` under [channel.velocity]",
                frame.unwrap_or_default()
            )),
        },
    }
}

/// A velocity in the body, turned by the attitude of the same message.
fn turned(topic: &Topic, t: &[f64], velocity: [Vec<f64>; 3], frames: &Frames) -> Channel<3> {
    let Some([qx, qy, qz, qw]) = attitude(topic) else { return Channel::default() };
    let [x, y, z] = velocity;
    let all = samples(t, &[x, y, z, qx, qy, qz, qw]);
    let turn = |v: &[f64; 7]| {
        let q = quat::normalize(frames.attitude([v[3], v[4], v[5], v[6]]));
        quat::rotate(q, frames.body([v[0], v[1], v[2]]))
    };
    Channel::new(all.t_s.clone(), all.values.iter().map(turn).collect())
}

/// Names of fixed frames (REP 105, and those of usual drivers).
fn is_world(frame: &str) -> bool {
    let bare = frame.trim_start_matches('/').rsplit('/').next().unwrap_or(frame);
    ["world", "map", "odom", "earth", "local_origin", "mocap", "vicon", "optitrack"].contains(&bare)
}

/// Names of frames that fly with the vehicle.
fn is_body(frame: &str) -> bool {
    let bare = frame.trim_start_matches('/').rsplit('/').next().unwrap_or(frame);
    ["base_link", "base_footprint", "base_frame", "body", "fcu", "imu_link", "base_link_flu"].contains(&bare)
}

/// Motors that ever have a value, each as a channel; motors after the last used one are left out.
fn of_motors(t: &[f64], columns: Vec<Vec<f64>>, f: impl Fn(f64) -> f64) -> Vec<Channel<1>> {
    let mut all: Vec<Channel<1>> =
        columns.into_iter().map(|column| samples(t, &[column]).map(|v| [f(v[0])])).collect();
    while all.last().is_some_and(|c| c.values.iter().all(|v| v[0] <= 0.0)) {
        all.pop();
    }
    all
}

fn throttle(log: &mut FlightLog, topic: &Topic, t: &[f64]) {
    if topic.kind == "px4_msgs/ActuatorMotors" {
        log.cmd_u = of_motors(t, motors(topic), |u| u);
        return;
    }
    // Outputs of 0 stand for channels that are not in use.
    let mut columns = motors(topic);
    while columns.last().is_some_and(|c| c.iter().all(|v| !(*v >= 900.0))) {
        columns.pop();
    }
    log.cmd_u = of_motors(t, columns, |width_us| (width_us - 1000.0) * 1e-3);
    log.warnings.push(format!(
        "cmd_u comes from {}, with 1000 µs taken as 0 and 2000 µs as 1, and every output taken as a motor: check what is connected, and the limits",
        topic.name
    ));
}

fn angles(log: &mut FlightLog, topic: &Topic, t: &[f64], frames: &Frames) {
    let Some(mut columns) = attitude(topic) else { return };
    // Bit 7 says that the attitude is to be ignored (mavros_msgs/msg/AttitudeTarget.msg).
    if let Some(mask) = topic.column("type_mask") {
        for (angle, mask) in columns[0].iter_mut().zip(mask) {
            if *mask as u32 & 128 != 0 {
                *angle = f64::NAN;
            }
        }
    }
    let all = samples(t, &columns);
    let angles = all.values.iter().map(|q| to_euler(quat::normalize(frames.attitude(*q)))).collect();
    log.cmd_attitude_rad = Channel::new(all.t_s, angles);
    log.warnings.push(format!(
        "the thrust of {0} is a share and no force, so cmd_thrust was left out: `cmd_thrust = {{ from = \"{0}.thrust\", scale = N_AT_FULL }}` in a \
         mapping file gives it",
        topic.name
    ));
}
