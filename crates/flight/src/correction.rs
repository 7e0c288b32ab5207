//! Corrections of single channels, as a mapping file lists them under `[channel.NAME]`, and how those that the checker asks for
//! are written into one.

use super::axes::Axes;
use super::resample::slerp;
use super::{
    Channel, CheckReport, FlightError, FlightLog, Mapping, Result, STANDARD_GRAVITY_M_S2, check, files,
    mapping_beside,
};
use propwash_trace::math::{quat, vec3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use toml_edit::{Array, DocumentMut, Item, Table, Value, value};

/// Most time between two attitudes by which a vector is turned, s.
const MAX_GAP_S: f64 = 0.25;

/// Channels whose samples are vectors, by the names that the checker gives them.
const VECTORS: [&str; 5] = ["position", "velocity", "angular_velocity", "specific_force", "wind"];
/// Those whose vectors may stand in the other frame, with the frame that is expected.
const TURNED: [(&str, Frame); 3] =
    [("velocity", Frame::World), ("angular_velocity", Frame::Body), ("specific_force", Frame::Body)];
/// Channels of numbers or angles.
const NUMBERS: [&str; 8] =
    ["rotors", "cmd_rotors", "cmd_u", "thrust", "cmd_thrust", "vbat", "commanded_attitude", "reference_yaw"];

/// The frame in which a file gives vectors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Frame {
    /// North-west-up or east-north-up.
    World,
    /// Forward-left-up.
    Body,
}

impl Frame {
    fn name(self) -> &'static str {
        match self {
            Self::World => "world",
            Self::Body => "body",
        }
    }
}

/// What is wrong with a channel, in the words of a mapping file.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Change {
    /// Values in SI are those of the file times `scale` plus `offset`.
    Scale {
        /// Factor.
        scale: f64,
        /// Summand, SI.
        offset: f64,
    },
    /// Our axes in terms of the file's, such as `x`, `-y`, `-z`.
    Axes([&'static str; 3]),
    /// Seconds added to its times.
    ShiftS(f64),
    /// Vectors stand in this frame.
    Frame(Frame),
    /// Gravity was taken off an acceleration.
    GravityRemoved,
    /// The quaternion turns world into body.
    BodyFromWorld,
    /// The columns of the quaternion are w, x, y, z.
    Wxyz,
}

/// A correction that the checker knows for a finding.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Fix {
    /// Of one channel.
    Channel {
        /// Its name in a mapping file.
        channel: &'static str,
        /// What changes.
        change: Change,
    },
    /// The whole log is north-east-down and forward-right-down.
    NorthEastDown,
    /// Times in s are those of the file times this.
    TimeScale(f64),
}

impl Fix {
    /// A change of a channel.
    pub(super) fn of(channel: &'static str, change: Change) -> Self {
        Self::Channel { channel, change }
    }

    /// Whether two are of one kind and channel.
    fn like(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Channel { channel, change }, Self::Channel { channel: c, change: b }) => {
                channel == c && std::mem::discriminant(change) == std::mem::discriminant(b)
            }
            _ => std::mem::discriminant(self) == std::mem::discriminant(other),
        }
    }

    /// Another unit of a channel.
    pub(super) fn scale(channel: &'static str, scale: f64) -> Self {
        Self::of(channel, Change::Scale { scale, offset: 0.0 })
    }
}

impl std::fmt::Display for Fix {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (channel, change) = match self {
            Self::NorthEastDown => {
                return f.write_str("the whole log: world_frame = \"ned\", body_frame = \"frd\"");
            }
            Self::TimeScale(scale) => return write!(f, "all times: times {scale}"),
            Self::Channel { channel, change } => (channel.replace('_', " "), change),
        };
        match change {
            Change::Scale { scale, offset: 0.0 } => write!(f, "{channel}: times {scale}"),
            Change::Scale { scale, offset } => write!(f, "{channel}: times {scale} plus {offset}"),
            Change::Axes(axes) => write!(f, "{channel}: axes {}", axes.join(", ")),
            Change::ShiftS(s) => write!(f, "{channel}: {:+.1} ms", 1e3 * s),
            Change::Frame(frame) => write!(f, "{channel}: from the {} frame", frame.name()),
            Change::GravityRemoved => write!(f, "{channel}: gravity put back"),
            Change::BodyFromWorld => write!(f, "{channel}: direction reversed"),
            Change::Wxyz => write!(f, "{channel}: columns in the order w, x, y, z"),
        }
    }
}

/// A table `[channel.NAME]` of a mapping file.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Correction {
    shift_s: Option<f64>,
    scale: Option<f64>,
    offset: Option<f64>,
    axes: Option<[String; 3]>,
    frame: Option<Frame>,
    gravity: Option<Gravity>,
    direction: Option<Direction>,
    order: Option<Order>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Gravity {
    Removed,
    Included,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Direction {
    WorldFromBody,
    BodyFromWorld,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Order {
    Xyzw,
    Wxyz,
}

impl Correction {
    /// What is wrong with a table: key, expected, found.
    pub fn wrong(&self, name: &str) -> Option<(String, String, String)> {
        let key = |k: &str| format!("channel.{name}.{k}");
        let known = [&VECTORS[..], &["attitude"], &NUMBERS[..]].concat();
        if !known.contains(&name) {
            let found = name.to_string();
            return Some((format!("channel.{name}"), format!("one of {}", known.join(", ")), found));
        }
        let numbers = [("shift_s", self.shift_s), ("scale", self.scale), ("offset", self.offset)];
        if let Some((k, v)) = numbers.iter().find_map(|(k, v)| Some((*k, v.filter(|v| !v.is_finite())?))) {
            return Some((key(k), "a finite number".into(), v.to_string()));
        }
        if self.scale == Some(0.0) {
            return Some((key("scale"), "a factor other than 0".into(), "0".into()));
        }
        let vector = VECTORS.contains(&name);
        let unfit = [
            ("scale", self.scale.is_some() && name == "attitude", "any channel but the attitude"),
            ("offset", self.offset.is_some() && name == "attitude", "any channel but the attitude"),
            (
                "axes",
                self.axes.is_some() && !vector && name != "attitude",
                "a channel of vectors, or attitude",
            ),
            (
                "frame",
                self.frame.is_some() && !TURNED.iter().any(|(n, _)| *n == name),
                "velocity, angular_velocity or specific_force",
            ),
            ("gravity", self.gravity.is_some() && name != "specific_force", "specific_force"),
            ("direction", self.direction.is_some() && name != "attitude", "attitude"),
            ("order", self.order.is_some() && name != "attitude", "attitude"),
        ];
        if let Some((k, _, of)) = unfit.into_iter().find(|(_, unfit, _)| *unfit) {
            return Some((key(k), format!("this key for {of} only"), name.replace('_', " ")));
        }
        if let Some(axes) = &self.axes {
            let handedness = Axes::parse(axes).map_or(0.0, |a| a.handedness());
            let expected = match name {
                "attitude" if handedness < 0.0 => "axes of a right-handed frame: a mirrored attitude is none",
                _ if handedness == 0.0 => "three different axes such as [\"x\", \"-y\", \"-z\"]",
                _ => return None,
            };
            return Some((key("axes"), expected.into(), axes.join(", ")));
        }
        None
    }

    /// Its axes; those of the file where it names none.
    fn axes(&self) -> Axes {
        self.axes.as_ref().and_then(|names| Axes::parse(names).ok()).unwrap_or_default()
    }

    fn number(&self, x: f64) -> f64 {
        x * self.scale.unwrap_or(1.0) + self.offset.unwrap_or(0.0)
    }

    fn shift(&self, t_s: &mut [f64]) {
        t_s.iter_mut().for_each(|t| *t += self.shift_s.unwrap_or(0.0));
    }

    fn numbers(&self, channel: &mut Channel<1>) {
        self.shift(&mut channel.t_s);
        channel.values.iter_mut().for_each(|v| *v = v.map(|x| self.number(x)));
    }

    fn vectors(&self, channel: &mut Channel<3>) {
        self.shift(&mut channel.t_s);
        let axes = self.axes();
        channel.values.iter_mut().for_each(|v| *v = axes.apply(*v).map(|x| self.number(x)));
    }

    fn attitude(&self, channel: &mut Channel<4>) {
        self.shift(&mut channel.t_s);
        let axes = self.axes();
        for q in &mut channel.values {
            if self.order == Some(Order::Wxyz) {
                *q = [q[1], q[2], q[3], q[0]];
            }
            if self.direction == Some(Direction::BodyFromWorld) {
                *q = quat::conjugate(*q);
            }
            // World and body turn alike, so that only the axis of the rotation does.
            let [x, y, z] = axes.apply([q[0], q[1], q[2]]);
            *q = [x, y, z, q[3]];
        }
    }

    /// Turns vectors into the frame that is expected, and puts gravity back; samples without an attitude nearby are left out, and
    /// their number is returned.
    fn turn(&self, channel: &mut Channel<3>, attitude: &Channel<4>, expected: Frame) -> usize {
        let from = self.frame.filter(|f| *f != expected);
        let lifted = self.gravity == Some(Gravity::Removed);
        if from.is_none() && !lifted {
            return 0;
        }
        let attitude = attitude.map(quat::normalize);
        let mut out = Channel::default();
        let up = [0.0, 0.0, STANDARD_GRAVITY_M_S2];
        for ((t, v), q) in
            channel.t_s.iter().zip(&channel.values).zip(slerp(&attitude, &channel.t_s, MAX_GAP_S))
        {
            let Some(q) = q else { continue };
            let mut v = *v;
            if lifted && from == Some(Frame::World) {
                v = vec3::add(v, up);
            }
            match from {
                Some(Frame::World) => v = quat::rotate_inverse(q, v),
                Some(Frame::Body) => v = quat::rotate(q, v),
                None => {}
            }
            if lifted && from.is_none() {
                v = vec3::add(v, quat::rotate_inverse(q, up));
            }
            out.push(*t, v);
        }
        let lost = channel.len() - out.len();
        *channel = out;
        lost
    }

    /// The correction with another change after it; `None` where the two do not make one table.
    fn with(&self, change: &Change) -> Option<Self> {
        let mut out = self.clone();
        let plain = self.frame.is_none() && self.gravity.is_none();
        match change {
            Change::Scale { scale, offset } => {
                if !plain && (*offset != 0.0 || self.gravity.is_some()) {
                    return None;
                }
                out.scale = Some(self.scale.unwrap_or(1.0) * scale);
                let summand = self.offset.unwrap_or(0.0) * scale + offset;
                out.offset = (summand != 0.0).then_some(summand);
            }
            Change::Axes(axes) => {
                if !plain {
                    return None;
                }
                out.axes = Some(self.axes().then(&Axes::parse(axes).ok()?).names());
            }
            Change::ShiftS(s) => out.shift_s = Some(self.shift_s.unwrap_or(0.0) + s),
            Change::Frame(frame) => {
                if !plain {
                    return None;
                }
                out.frame = Some(*frame);
            }
            Change::GravityRemoved => {
                if self.gravity.is_some() {
                    return None;
                }
                out.gravity = Some(Gravity::Removed);
            }
            Change::BodyFromWorld => {
                let back = self.direction == Some(Direction::BodyFromWorld);
                out.direction = Some(if back { Direction::WorldFromBody } else { Direction::BodyFromWorld });
            }
            Change::Wxyz => {
                if self.order.is_some() || self.direction.is_some() || self.axes.is_some() {
                    return None;
                }
                out.order = Some(Order::Wxyz);
            }
        }
        Some(out)
    }

    /// Writes what it says over a table of a mapping file.
    fn write(&self, table: &mut Table) {
        let mut number = |key: &str, x: Option<f64>| {
            if let Some(x) = x {
                table[key] = value(x);
            }
        };
        number("shift_s", self.shift_s);
        number("scale", self.scale);
        number("offset", self.offset);
        if let Some(axes) = &self.axes {
            table["axes"] = value(Value::Array(axes.iter().collect::<Array>()));
        }
        let mut word = |key: &str, w: Option<&str>| {
            if let Some(w) = w {
                table[key] = value(w);
            }
        };
        word("frame", self.frame.map(Frame::name));
        word("gravity", self.gravity.map(|g| if g == Gravity::Removed { "removed" } else { "included" }));
        word(
            "direction",
            self.direction.map(|d| match d {
                Direction::WorldFromBody => "world_from_body",
                Direction::BodyFromWorld => "body_from_world",
            }),
        );
        word("order", self.order.map(|o| if o == Order::Wxyz { "wxyz" } else { "xyzw" }));
    }
}

/// Turns vectors of the body into the world; the number of samples that are left out, since they have no attitude nearby.
pub(super) fn body_to_world(channel: &mut Channel<3>, attitude: &Channel<4>) -> usize {
    let correction = Correction { frame: Some(Frame::Body), ..Correction::default() };
    correction.turn(channel, attitude, Frame::World)
}

/// Applies the corrections of a mapping to a log as it was read.
pub(super) fn apply(log: &mut FlightLog, corrections: &BTreeMap<String, Correction>, time_scale: f64) {
    if time_scale != 1.0 {
        log.times_mut(|t| *t *= time_scale);
        log.start_s *= time_scale;
    }
    let of = |name: &str| corrections.get(name);
    if let Some(c) = of("attitude") {
        c.attitude(&mut log.attitude);
    }
    for (name, channel) in [
        ("position", &mut log.position_m),
        ("velocity", &mut log.velocity_m_s),
        ("angular_velocity", &mut log.angular_velocity_rad_s),
        ("specific_force", &mut log.specific_force_m_s2),
        ("wind", &mut log.wind_m_s),
        ("commanded_attitude", &mut log.cmd_attitude_rad),
    ] {
        let Some(c) = of(name) else { continue };
        c.vectors(channel);
        if let Some((_, expected)) = TURNED.iter().find(|(n, _)| *n == name) {
            let lost = c.turn(channel, &log.attitude, *expected);
            if lost > 0 {
                let words = name.replace('_', " ");
                log.warnings.push(format!(
                    "{lost} samples of the {words} have no attitude by which to turn them and are left out"
                ));
            }
        }
    }
    for (name, list) in [
        ("rotors", &mut log.rotor_speed_rad_s),
        ("cmd_rotors", &mut log.cmd_rotor_rad_s),
        ("cmd_u", &mut log.cmd_u),
    ] {
        if let Some(c) = of(name) {
            list.iter_mut().for_each(|channel| c.numbers(channel));
        }
    }
    for (name, channel) in [
        ("thrust", &mut log.thrust_n),
        ("cmd_thrust", &mut log.cmd_thrust_n),
        ("vbat", &mut log.vbat_v),
        ("reference_yaw", &mut log.ref_yaw_rad),
    ] {
        if let Some(c) = of(name) {
            c.numbers(channel);
        }
    }
}

/// Most rounds of checks and corrections: a log in another unit hides frames, and frames hide delays.
const ROUNDS: usize = 6;

/// A log that was read with corrections.
#[derive(Clone, Debug)]
pub struct Mended {
    /// The mapping file with them; that in use where there are none.
    pub text: String,
    /// What was corrected, in order.
    pub fixes: Vec<Fix>,
    /// What the checker still asks for and no mapping can say beside the rest.
    pub left: Vec<Fix>,
    /// The check of the log with the mapping.
    pub report: CheckReport,
}

/// Corrects what the checker finds wrong with a log, round by round, and checks it again; nothing is written. The mapping in use is
/// chosen as in [`FlightLog::load`].
///
/// # Errors
/// Those of [`FlightLog::load`].
pub fn mend(log: &Path, mapping: Option<&Path>) -> Result<Mended> {
    let of_log = mapping.map(Path::to_path_buf).or_else(|| mapping_beside(log));
    let mut text = match &of_log {
        Some(path) => files::read_text(path)
            .map_err(|e| FlightError::Read { path: path.clone(), reason: e.to_string() })?,
        None => String::new(),
    };
    let name = of_log.unwrap_or_else(|| log.with_extension("toml"));
    let mut rules = if text.is_empty() { None } else { Some(Mapping::parse(&text, &name)?) };
    let (mut fixes, mut left): (Vec<Fix>, Vec<Fix>) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        let report = check(&FlightLog::load_with(log, rules.as_ref())?);
        let mut wanted: Vec<Fix> = Vec::new();
        for fix in report.fixes() {
            // One of a kind at a time: two checks may see one mistake.
            if !left.contains(&fix) && !wanted.iter().any(|w| w.like(&fix)) {
                wanted.push(fix);
            }
        }
        if wanted.is_empty() {
            return Ok(Mended { text, fixes, left, report });
        }
        let (next, unwritten) = fixed(&text, rules.as_ref(), &wanted)?;
        fixes.extend(wanted.into_iter().filter(|f| !unwritten.contains(f)));
        left.extend(unwritten);
        rules = Some(Mapping::parse(&next, &name)?);
        text = next;
    }
    let report = check(&FlightLog::load_with(log, rules.as_ref())?);
    left = report.fixes();
    Ok(Mended { text, fixes, left, report })
}

/// The text of a mapping file with fixes, and those that cannot be written: `text` and `mapping` are those of the one in use, if any.
///
/// # Errors
/// [`FlightError::Mapping`] where the text is no TOML.
fn fixed(text: &str, mapping: Option<&Mapping>, fixes: &[Fix]) -> Result<(String, Vec<Fix>)> {
    let mut document: DocumentMut = text.parse().map_err(|e: toml_edit::TomlError| FlightError::Mapping {
        path: mapping.map_or_else(Default::default, |m| m.path().to_path_buf()),
        key: "the file".into(),
        expected: "a mapping file as in docs/logs.md".into(),
        found: e.message().trim().replace('\n', "; ").into(),
        remedy: "correct the key or its value",
    })?;
    let mut unwritten = Vec::new();
    let mut channels: BTreeMap<String, Correction> =
        mapping.map(|m| m.corrections().clone()).unwrap_or_default();
    for fix in fixes {
        match fix {
            Fix::TimeScale(scale) => {
                document["time_scale"] = value(mapping.map_or(1.0, Mapping::time_scale) * scale);
            }
            Fix::NorthEastDown => {
                if document.contains_key("world_frame") || document.contains_key("body_frame") {
                    unwritten.push(fix.clone());
                } else {
                    document["world_frame"] = value("ned");
                    document["body_frame"] = value("frd");
                }
            }
            Fix::Channel { channel, change } => {
                match channels.entry((*channel).into()).or_default().with(change) {
                    Some(next) => {
                        let tables = document.entry("channel").or_insert_with(|| {
                            let mut table = Table::new();
                            table.set_implicit(true);
                            Item::Table(table)
                        });
                        let of_channel = tables
                            .as_table_mut()
                            .map(|t| t.entry(channel).or_insert(Item::Table(Table::new())));
                        match of_channel.and_then(Item::as_table_mut) {
                            Some(table) => {
                                next.write(table);
                                channels.insert((*channel).into(), next);
                            }
                            // An inline table that somebody wrote by hand.
                            None => unwritten.push(fix.clone()),
                        }
                    }
                    None => unwritten.push(fix.clone()),
                }
            }
        }
    }
    Ok((document.to_string(), unwritten))
}
