//! Mapping files: foreign column names, units, frames, quaternion orders and signs, in a TOML file beside a log.

use super::Format;
use super::axes::Axes;
use super::contract::{Kind, kind_of};
use super::correction::Correction;
use super::error::{FlightError, Result};
use propwash_trace::math::quat;
use propwash_trace::units;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What a mapping file says. `docs/logs.md` has an example per source.
#[derive(Clone, Debug, Default)]
pub struct Mapping {
    path: PathBuf,
    format: Option<Format>,
    delimiter: Option<u8>,
    missing: Vec<String>,
    ignore: Vec<String>,
    /// Topics of a bag in which channels are looked for; all where there are none.
    topics: Vec<String>,
    filter: BTreeMap<String, f64>,
    /// Contract names are also taken as they stand in the file.
    contract_names: Option<bool>,
    columns: BTreeMap<String, Source>,
    attitude: Attitude,
    world_from_file: Axes,
    body_from_file: Axes,
    inverse_attitude: bool,
    time_scale: Option<f64>,
    corrections: BTreeMap<String, Correction>,
}

/// A column of the file and what makes SI of it: `value · scale + offset`.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Source {
    /// Name in the file.
    pub column: String,
    scale: f64,
    offset: f64,
    /// Named by the mapping, so that its absence is an error.
    pub explicit: bool,
}

impl Source {
    /// A cell of the file in SI.
    pub fn convert(&self, cell: f64) -> f64 {
        cell * self.scale + self.offset
    }
}

/// Where attitudes stand in the file.
#[derive(Clone, Debug, Default)]
pub(super) enum Attitude {
    /// `qx qy qz qw`, by their own entries in `[columns]` or as they stand.
    #[default]
    Contract,
    /// Four columns, here in the order x, y, z, w.
    Quaternion(Box<[Source; 4]>),
    /// Roll, pitch, yaw (rotations about x, y, z; yaw first), rad.
    Euler(Box<[Source; 3]>),
    /// Crazyflie's 32-bit quaternion.
    Compressed(Source),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Raw {
    format: Option<RawFormat>,
    delimiter: Option<String>,
    #[serde(default)]
    missing: Vec<String>,
    #[serde(default)]
    ignore: Vec<String>,
    #[serde(default)]
    topics: Vec<String>,
    #[serde(default, rename = "where")]
    filter: BTreeMap<String, f64>,
    contract_names: Option<bool>,
    world_frame: Option<RawFrame>,
    body_frame: Option<RawFrame>,
    #[serde(default)]
    columns: BTreeMap<String, RawColumn>,
    attitude: Option<RawAttitude>,
    time_scale: Option<f64>,
    #[serde(default)]
    channel: BTreeMap<String, Correction>,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum RawFormat {
    Csv,
    Parquet,
    Ulog,
    Mcap,
}

#[derive(Deserialize)]
#[serde(untagged, expecting = "expected the name of a frame or three axes such as [\"x\", \"-y\", \"-z\"]")]
enum RawFrame {
    Name(String),
    Axes([String; 3]),
}

#[derive(Deserialize)]
#[serde(
    untagged,
    expecting = "expected a column name in quotes, or a table { from = \"name\", unit = \"…\", scale = …, offset = … }"
)]
enum RawColumn {
    Name(String),
    Full(RawSource),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawSource {
    from: String,
    unit: Option<String>,
    scale: Option<f64>,
    offset: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawAttitude {
    quaternion: Option<[String; 4]>,
    order: Option<String>,
    euler: Option<[String; 3]>,
    unit: Option<String>,
    signs: Option<[f64; 3]>,
    compressed: Option<String>,
    direction: Option<String>,
}

impl Mapping {
    /// Reads a mapping file.
    ///
    /// # Errors
    /// [`FlightError::Read`] and [`FlightError::Mapping`].
    pub fn load(path: &Path) -> Result<Self> {
        let text = super::files::read_text(path)
            .map_err(|e| FlightError::Read { path: path.to_path_buf(), reason: e.to_string() })?;
        Self::parse(&text, path)
    }

    /// Reads the text of a mapping file; `path` names it in messages.
    ///
    /// # Errors
    /// [`FlightError::Mapping`] with the key that is wrong.
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        let raw: Raw = toml::from_str(text).map_err(|e| FlightError::Mapping {
            path: path.to_path_buf(),
            key: e.span().map_or_else(
                || "the file".into(),
                |s| format!("line {}", text[..s.start.min(text.len())].matches('\n').count() + 1).into(),
            ),
            expected: "a mapping file as in docs/logs.md".into(),
            found: e.message().trim().replace('\n', "; ").into(),
            remedy: "correct the key or its value",
        })?;
        let wrong = |key: &str, expected: &str, found: &str, remedy: &'static str| FlightError::Mapping {
            path: path.to_path_buf(),
            key: key.into(),
            expected: expected.into(),
            found: found.into(),
            remedy,
        };
        let mut out = Self {
            path: path.to_path_buf(),
            format: raw.format.map(|f| match f {
                RawFormat::Csv => Format::Csv,
                RawFormat::Parquet => Format::Parquet,
                RawFormat::Ulog => Format::Ulog,
                RawFormat::Mcap => Format::Mcap,
            }),
            missing: raw.missing,
            ignore: raw.ignore,
            topics: raw.topics,
            filter: raw.filter,
            contract_names: raw.contract_names,
            ..Self::default()
        };
        if let Some(d) = raw.delimiter {
            match d.as_bytes() {
                [byte] => out.delimiter = Some(*byte),
                _ => {
                    return Err(wrong("delimiter", "one ASCII character", &d, "use \",\", \";\" or \"\\t\""));
                }
            }
        }
        for (name, column) in raw.columns {
            let source = source_of(&name, column, &wrong)?;
            out.columns.insert(name, source);
        }
        if let Some(attitude) = raw.attitude {
            let (attitude, inverse) = read_attitude(attitude, &wrong)?;
            (out.attitude, out.inverse_attitude) = (attitude, inverse);
        }
        let (same, turned) = (Axes::default(), Axes::TURNED);
        // East-north-down turned about x would be mirrored, so it is not offered.
        out.world_from_file = frame_of(
            "world_frame",
            raw.world_frame,
            &[("enu", same), ("nwu", same), ("z_up", same), ("ned", turned), ("y_up", Axes::Y_UP)],
            &wrong,
        )?;
        out.body_from_file =
            frame_of("body_frame", raw.body_frame, &[("flu", same), ("frd", turned)], &wrong)?;
        if let Some(scale) = raw.time_scale {
            if !(scale.is_finite() && scale > 0.0) {
                let found = scale.to_string();
                return Err(wrong(
                    "time_scale",
                    "a finite number above 0",
                    &found,
                    "give s per unit of the file",
                ));
            }
            out.time_scale = Some(scale);
        }
        for (name, correction) in raw.channel {
            if let Some((key, expected, found)) = correction.wrong(&name) {
                return Err(wrong(&key, &expected, &found, "correct it, or take it out"));
            }
            out.corrections.insert(name, correction);
        }
        Ok(out)
    }

    /// Corrections of single channels, by name.
    pub(super) fn corrections(&self) -> &BTreeMap<String, Correction> {
        &self.corrections
    }

    /// Seconds per unit of the file's times, after whatever `columns.t` says.
    pub(super) fn time_scale(&self) -> f64 {
        self.time_scale.unwrap_or(1.0)
    }

    /// The mapping file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What the mapping says that the log is.
    pub fn format(&self) -> Option<Format> {
        self.format
    }

    pub(super) fn delimiter(&self) -> u8 {
        self.delimiter.unwrap_or(b',')
    }

    pub(super) fn missing(&self) -> &[String] {
        &self.missing
    }

    pub(super) fn filter(&self) -> &BTreeMap<String, f64> {
        &self.filter
    }

    pub(super) fn attitude(&self) -> &Attitude {
        &self.attitude
    }

    /// Whether the mapping renames anything; then only named columns are used, unless `contract_names = true`.
    fn takes_contract_names(&self) -> bool {
        self.contract_names.unwrap_or(self.columns.is_empty())
    }

    /// Where the mapping itself says that a contract column comes from.
    pub(super) fn named(&self, name: &str) -> Option<&Source> {
        self.columns.get(name)
    }

    /// Columns of the attitude under `[attitude]`.
    pub(super) fn attitude_columns(&self) -> Vec<&str> {
        let sources: Vec<&Source> = match &self.attitude {
            Attitude::Contract => Vec::new(),
            Attitude::Quaternion(s) => s.iter().collect(),
            Attitude::Euler(s) => s.iter().collect(),
            Attitude::Compressed(s) => vec![s],
        };
        sources.into_iter().map(|s| s.column.as_str()).collect()
    }

    /// All columns of the file that the mapping names, but for the time.
    pub(super) fn file_names(&self) -> Vec<&str> {
        let columns = self.columns.iter().filter(|(ours, _)| *ours != "t").map(|(_, s)| s.column.as_str());
        columns.chain(self.attitude_columns()).chain(self.filter.keys().map(String::as_str)).collect()
    }

    /// Whether channels of a bag are found by what its messages are, beside those that the mapping names.
    pub(super) fn finds_channels(&self) -> bool {
        self.contract_names.unwrap_or(self.columns.keys().all(|name| name == "t"))
    }

    /// Whether channels are looked for in a topic.
    pub(super) fn takes_topic(&self, name: &str) -> bool {
        (self.topics.is_empty() || self.topics.iter().any(|t| t == name)) && !self.ignores(name)
    }

    /// Whether a topic is passed over without a note.
    pub(super) fn ignores(&self, name: &str) -> bool {
        self.ignore.iter().any(|n| n == name)
    }

    /// Where a contract column comes from.
    pub(super) fn source(&self, name: &str) -> Option<Source> {
        if let Some(source) = self.columns.get(name) {
            return Some(source.clone());
        }
        (self.takes_contract_names() && !self.ignore.iter().any(|n| n == name)).then(|| Source {
            column: name.to_string(),
            scale: 1.0,
            offset: 0.0,
            explicit: false,
        })
    }

    /// The name in the file of a contract column.
    pub(super) fn file_name(&self, name: &str) -> String {
        self.columns.get(name).map_or_else(|| name.to_string(), |s| s.column.clone())
    }

    /// All contract names that the file's columns may give.
    pub(super) fn contract_names(&self, file: &[String]) -> Vec<String> {
        let mut out: Vec<String> = self.columns.keys().cloned().collect();
        if self.takes_contract_names() {
            out.extend(file.iter().filter(|n| kind_of(n).is_some() && !self.ignore.contains(n)).cloned());
        }
        out
    }

    /// Whether a column of the file is read as numbers.
    pub(super) fn uses(&self, file_name: &str) -> bool {
        self.columns.values().any(|s| s.column == file_name)
            || self.attitude_columns().contains(&file_name)
            || self.filter.contains_key(file_name)
            || matches!(file_name, "world" | "drone") && self.takes_contract_names()
            || (self.takes_contract_names() && kind_of(file_name).is_some())
    }

    /// Whether a column of the file is used, or named as one to pass over.
    pub(super) fn knows(&self, file_name: &str) -> bool {
        self.uses(file_name) || self.ignore.iter().any(|n| n == file_name)
    }

    pub(super) fn to_world(&self, v: [f64; 3]) -> [f64; 3] {
        self.world_from_file.apply(v)
    }

    pub(super) fn to_body(&self, v: [f64; 3]) -> [f64; 3] {
        self.body_from_file.apply(v)
    }

    /// An attitude of the file as ours, xyzw, body to world.
    pub(super) fn to_attitude(&self, q: [f64; 4]) -> [f64; 4] {
        let q = if self.inverse_attitude { quat::conjugate(q) } else { q };
        self.turn(q)
    }

    fn turn(&self, q: [f64; 4]) -> [f64; 4] {
        if self.world_from_file.is_identity() && self.body_from_file.is_identity() {
            return q;
        }
        let body = quat::conjugate(self.body_from_file.quaternion());
        quat::mul(self.world_from_file.quaternion(), quat::mul(q, body))
    }

    /// Roll, pitch, yaw of the file as ours.
    pub(super) fn to_euler(&self, angles: [f64; 3]) -> [f64; 3] {
        if self.world_from_file.is_identity() && self.body_from_file.is_identity() {
            return angles;
        }
        to_euler(self.turn(from_euler(angles)))
    }

    /// A yaw of the file as ours.
    pub(super) fn to_yaw(&self, yaw: f64) -> f64 {
        if self.world_from_file.is_identity() && self.body_from_file.is_identity() {
            return yaw;
        }
        self.to_euler([0.0, 0.0, yaw])[2]
    }
}

/// Makes an error of this file: key, what was expected, what was found, what to do.
type Wrong<'a> = dyn Fn(&str, &str, &str, &'static str) -> FlightError + 'a;

/// Where a column of the contract comes from.
fn source_of(name: &str, column: RawColumn, wrong: &Wrong<'_>) -> Result<Source> {
    let key = format!("columns.{name}");
    let Some(kind) = kind_of(name) else {
        return Err(wrong(
            &key,
            "a name of the flight-log contract such as px, qw, vx, wx, ax, rotor1, cmd_thrust, obj_NAME_x",
            name,
            "the name on the left is ours, the one in quotes is the file's",
        ));
    };
    let raw = match column {
        RawColumn::Name(from) => RawSource { from, unit: None, scale: None, offset: None },
        RawColumn::Full(full) => full,
    };
    let factor = match raw.unit.as_deref() {
        None => 1.0,
        Some(unit) => unit_factor(kind, unit).ok_or_else(|| {
            wrong(&key, &format!("a unit of {}", units_of(kind)), unit, "correct `unit`, or give `scale`")
        })?,
    };
    let (scale, offset) = (raw.scale.unwrap_or(1.0), raw.offset.unwrap_or(0.0));
    if !(scale.is_finite() && scale != 0.0 && offset.is_finite()) {
        let found = format!("scale {scale}, offset {offset}");
        return Err(wrong(&key, "finite numbers, a scale other than 0", &found, "correct them"));
    }
    Ok(Source { column: raw.from, scale: factor * scale, offset, explicit: true })
}

/// A frame by its name, or by three axes.
fn frame_of(key: &str, raw: Option<RawFrame>, names: &[(&str, Axes)], wrong: &Wrong<'_>) -> Result<Axes> {
    let known: Vec<&str> = names.iter().map(|(n, _)| *n).collect();
    let expected = format!("one of {}, or three axes such as [\"x\", \"-y\", \"-z\"]", known.join(", "));
    match raw {
        None => Ok(Axes::default()),
        Some(RawFrame::Name(name)) => {
            let found = names.iter().find(|(n, _)| name.eq_ignore_ascii_case(n)).map(|(_, f)| *f);
            found.ok_or_else(|| wrong(key, &expected, &name, "correct the name"))
        }
        Some(RawFrame::Axes(axes)) => {
            let frame =
                Axes::parse(&axes).map_err(|axis| wrong(key, &expected, &axis, "correct the axis"))?;
            if frame.handedness() != 1.0 {
                return Err(wrong(
                    key,
                    "three different axes of a right-handed frame",
                    &axes.join(", "),
                    "change the sign of one axis, or name each once; a left-handed log must be mirrored first",
                ));
            }
            Ok(frame)
        }
    }
}

fn read_attitude(raw: RawAttitude, wrong: &Wrong<'_>) -> Result<(Attitude, bool)> {
    let plain = |column: &String| Source { column: column.clone(), scale: 1.0, offset: 0.0, explicit: true };
    let inverse = match raw.direction.as_deref() {
        None | Some("world_from_body") => false,
        Some("body_from_world") => true,
        Some(other) => {
            return Err(wrong(
                "attitude.direction",
                "world_from_body (turns body vectors into world vectors) or body_from_world",
                other,
                "correct it",
            ));
        }
    };
    let ways = [raw.quaternion.is_some(), raw.euler.is_some(), raw.compressed.is_some()];
    if ways.iter().filter(|w| **w).count() > 1 {
        return Err(wrong("attitude", "one of quaternion, euler, compressed", "several", "keep one"));
    }
    if raw.euler.is_none() && (raw.unit.is_some() || raw.signs.is_some()) {
        return Err(wrong("attitude", "`unit` and `signs` beside `euler` only", "no `euler`", "remove them"));
    }
    if raw.quaternion.is_none() && raw.order.is_some() {
        return Err(wrong(
            "attitude.order",
            "`order` beside `quaternion` only",
            "no `quaternion`",
            "remove it",
        ));
    }
    let attitude = if let Some(c) = raw.quaternion {
        let s = [plain(&c[0]), plain(&c[1]), plain(&c[2]), plain(&c[3])];
        match raw.order.as_deref() {
            Some("xyzw") => Attitude::Quaternion(Box::new(s)),
            Some("wxyz") => {
                let [w, x, y, z] = s;
                Attitude::Quaternion(Box::new([x, y, z, w]))
            }
            other => {
                let found = other.unwrap_or("nothing");
                return Err(wrong(
                    "attitude.order",
                    "xyzw or wxyz",
                    found,
                    "say which column is the real part",
                ));
            }
        }
    } else if let Some(c) = raw.euler {
        let unit = raw.unit.as_deref().unwrap_or("rad");
        let Some(factor) = unit_factor(Kind::Angle, unit) else {
            return Err(wrong(
                "attitude.unit",
                &format!("a unit of {}", units_of(Kind::Angle)),
                unit,
                "correct it",
            ));
        };
        let signs = raw.signs.unwrap_or([1.0; 3]);
        if signs.iter().any(|s| s.abs() != 1.0) {
            return Err(wrong(
                "attitude.signs",
                "1 or -1 for each angle",
                &format!("{signs:?}"),
                "correct them",
            ));
        }
        Attitude::Euler(Box::new(std::array::from_fn(|i| Source {
            scale: factor * signs[i],
            ..plain(&c[i])
        })))
    } else if let Some(c) = raw.compressed {
        Attitude::Compressed(plain(&c))
    } else {
        Attitude::Contract
    };
    Ok((attitude, inverse))
}

/// Units of each kind with their factor to SI.
const UNITS: &[(Kind, &[(&str, f64)])] = &[
    (Kind::Time, &[("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)]),
    (Kind::Length, &[("m", 1.0), ("cm", 1e-2), ("mm", 1e-3)]),
    (Kind::Speed, &[("m/s", 1.0), ("cm/s", 1e-2), ("mm/s", 1e-3), ("km/h", 1.0 / 3.6)]),
    (
        Kind::Acceleration,
        &[
            ("m/s2", 1.0),
            ("m/s^2", 1.0),
            ("mm/s2", 1e-3),
            ("g", units::STANDARD_GRAVITY_M_S2),
            ("mg", 1e-3 * units::STANDARD_GRAVITY_M_S2),
        ],
    ),
    (Kind::Angle, &[("rad", 1.0), ("mrad", 1e-3), ("deg", std::f64::consts::PI / 180.0)]),
    (
        Kind::Rate,
        &[
            ("rad/s", 1.0),
            ("mrad/s", 1e-3),
            ("deg/s", std::f64::consts::PI / 180.0),
            ("rpm", units::RAD_S_PER_RPM),
            ("krpm", 1e3 * units::RAD_S_PER_RPM),
            ("Hz", 2.0 * std::f64::consts::PI),
        ],
    ),
    (
        Kind::Force,
        &[
            ("N", 1.0),
            ("mN", 1e-3),
            ("gf", 1e-3 * units::STANDARD_GRAVITY_M_S2),
            ("kgf", units::STANDARD_GRAVITY_M_S2),
        ],
    ),
    (Kind::Voltage, &[("V", 1.0), ("mV", 1e-3)]),
    (Kind::Number, &[("1", 1.0), ("percent", 1e-2), ("uint16", 1.0 / 65535.0)]),
];

pub(super) fn units_for(kind: Kind) -> &'static [(&'static str, f64)] {
    UNITS.iter().find(|(k, _)| *k == kind).map_or(&[], |(_, u)| u)
}

fn unit_factor(kind: Kind, unit: &str) -> Option<f64> {
    let plain = unit.replace('µ', "u").replace('²', "2");
    units_for(kind).iter().find(|(n, _)| *n == plain).map(|(_, f)| *f)
}

fn units_of(kind: Kind) -> String {
    units_for(kind).iter().map(|(n, _)| *n).collect::<Vec<_>>().join(", ")
}

/// Attitude xyzw of roll, pitch, yaw (rad): yaw about z, then pitch about y, then roll about x.
pub(super) fn from_euler(angles: [f64; 3]) -> [f64; 4] {
    let [r, p, y] = angles;
    quat::mul(quat::exp([0.0, 0.0, y]), quat::mul(quat::exp([0.0, p, 0.0]), quat::exp([r, 0.0, 0.0])))
}

/// Roll, pitch, yaw (rad) of an attitude xyzw.
pub(super) fn to_euler(q: [f64; 4]) -> [f64; 3] {
    let m = quat::matrix(q);
    [m[2][1].atan2(m[2][2]), (-m[2][0]).clamp(-1.0, 1.0).asin(), m[1][0].atan2(m[0][0])]
}

/// A quaternion xyzw from Crazyflie's 32 bits: the top two bits name the largest component, which is left out; the
/// others follow in order, ten bits each, a sign and nine bits of magnitude in units of √½/511.
/// (crazyflie-firmware, src/utils/interface/quatcompress.h.)
pub(super) fn decompress(packed: u32) -> [f64; 4] {
    let largest = (packed >> 30) as usize;
    let mut rest = packed;
    let mut q = [0.0; 4];
    let mut squares = 0.0;
    for i in (0..4).rev().filter(|i| *i != largest) {
        let magnitude = f64::from(rest & 511) / 511.0 * std::f64::consts::FRAC_1_SQRT_2;
        q[i] = if rest >> 9 & 1 == 1 { -magnitude } else { magnitude };
        rest >>= 10;
        squares += q[i] * q[i];
    }
    q[largest] = (1.0f64 - squares).max(0.0).sqrt();
    q
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Mapping> {
        Mapping::parse(text, Path::new("m.toml"))
    }

    #[test]
    fn every_frame_turns_vectors_and_attitudes_alike() {
        let text = "world_frame = \"ned\"\nbody_frame = [\"y\", \"z\", \"x\"]";
        let map = parse(text).unwrap();
        let q = quat::exp([0.3, -0.7, 1.1]);
        let v = [0.2, -1.0, 3.0];
        let direct = map.to_world(quat::rotate(q, v));
        let turned = quat::rotate(map.to_attitude(q), map.to_body(v));
        for k in 0..3 {
            assert!((direct[k] - turned[k]).abs() < 1e-14);
        }
        for name in ["ned", "enu", "y_up"] {
            let map = parse(&format!("world_frame = \"{name}\"")).unwrap();
            assert_eq!(map.world_from_file.handedness(), 1.0);
            let (a, b) = (map.to_world(v), quat::rotate(map.world_from_file.quaternion(), v));
            for k in 0..3 {
                assert!((a[k] - b[k]).abs() < 1e-14, "{name}");
            }
        }
    }

    #[test]
    fn angles_of_ned_and_frd_change_sign_of_pitch_and_yaw() {
        let map = parse("world_frame = \"ned\"\nbody_frame = \"frd\"").unwrap();
        let e = map.to_euler([0.1, 0.2, 0.3]);
        for (a, b) in e.iter().zip([0.1, -0.2, -0.3]) {
            assert!((a - b).abs() < 1e-14, "{e:?}");
        }
    }

    #[test]
    fn a_compressed_quaternion_comes_back_within_its_resolution() {
        for r in [[0.1, 0.2, -0.3], [2.0, 0.1, 0.5], [-0.2, 2.5, 0.1], [0.3, -0.4, -2.9]] {
            let q: [f64; 4] = quat::exp(r);
            let largest = (0..4).max_by(|a, b| q[*a].abs().total_cmp(&q[*b].abs())).unwrap();
            let negate = q[largest] < 0.0;
            let mut packed = largest as u32;
            for i in (0..4).filter(|i| *i != largest) {
                let magnitude = (511.0 * (q[i].abs() * std::f64::consts::SQRT_2) + 0.5) as u32;
                packed = packed << 10 | u32::from((q[i] < 0.0) ^ negate) << 9 | magnitude;
            }
            let back = decompress(packed);
            let same: f64 = (0..4).map(|i| q[i] * back[i]).sum();
            assert!(same.abs() > 1.0 - 1e-5, "{q:?} {back:?}");
        }
    }

    #[test]
    fn mistakes_in_a_mapping_name_the_key_and_the_remedy() {
        let text = |t: &str| parse(t).unwrap_err().to_string();
        assert!(text("[columns]\npx = { from = \"x\", unit = \"deg\" }").contains("m, cm, mm"));
        assert!(text("[columns]\nposx = \"x\"").contains("name of the flight-log contract"));
        assert!(text("world_frame = [\"x\", \"y\", \"-z\"]").contains("right-handed"));
        assert!(text("[attitude]\nquaternion = [\"a\", \"b\", \"c\", \"d\"]").contains("xyzw or wxyz"));
        assert!(text("wrld_frame = \"ned\"").contains("line 1"));
        assert!(text("[columns]\npx = 3").contains("column name in quotes"));
    }
}
