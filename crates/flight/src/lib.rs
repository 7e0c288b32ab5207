//! Logs of real flights: one reader per format, all to one [`FlightLog`] in SI on one clock.
//!
//! The contract (names, units, frames) stands in `docs/logs.md`. A mapping file beside a log ([`Mapping`]) gives
//! foreign names, units and frames; [`check()`] says in words what is wrong with a log.

#![forbid(unsafe_code)]

pub mod align;
mod axes;
mod bag;
mod channel;
pub mod check;
pub mod clean;
mod contract;
pub mod correction;
mod error;
pub mod files;
mod mapping;
pub mod peek;
pub mod resample;
pub mod stray;
mod table;
mod ulog;
pub mod usable;
mod write;

pub use bag::is_bag;
pub use channel::Channel;
pub use check::{CheckReport, Fault, Finding, Severity, check};
pub use error::{FlightError, Result};
pub use mapping::Mapping;
pub use propwash_trace::units::STANDARD_GRAVITY_M_S2;
pub use usable::{Excluded, Reason, Unusable};

use serde::Serialize;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What a log was read from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// Text, one row per sample.
    Csv,
    /// Columns of a Parquet file.
    Parquet,
    /// PX4 ULog.
    Ulog,
    /// MCAP, alone or in the folder of a ROS 2 bag.
    Mcap,
}

/// A flight: measured channels, each with its own sample times, in SI on one clock (s from the start of the log).
///
/// World z is up, body x forward, y left, z up. A channel that was not measured is empty. Times are as in the file,
/// less the first; [`check()`] finds those that do not rise.
///
/// ```no_run
/// use propwash_flight::FlightLog;
///
/// let (log, report) = FlightLog::open("flight.csv".as_ref(), None)?;
/// println!("{:?}; {} findings of the checker", log.format, report.findings.len());
/// # Ok::<(), propwash_flight::FlightError>(())
/// ```
#[derive(Clone, Debug, Serialize)]
pub struct FlightLog {
    /// File that it came from; for a ROS 2 bag its folder, where that was given.
    pub path: PathBuf,
    /// SHA-256 of that file, lower-case hexadecimal; of the bags in a folder, one after the other.
    pub sha256: String,
    /// What the file is.
    pub format: Format,
    /// Mapping file that was used.
    pub mapping: Option<PathBuf>,
    /// Time of the file's first row on its own clock, s.
    pub start_s: f64,
    /// Last time, s.
    pub duration_s: f64,
    /// Rows of the file; for ULog and bags, messages that were used.
    pub n_rows: usize,
    /// Position in the world, m.
    pub position_m: Channel<3>,
    /// Attitude, xyzw, body to world, as in the file (length not corrected).
    pub attitude: Channel<4>,
    /// Velocity in the world, m/s.
    pub velocity_m_s: Channel<3>,
    /// Body rates, rad/s.
    pub angular_velocity_rad_s: Channel<3>,
    /// Specific force (what an accelerometer reads), body, m/s².
    pub specific_force_m_s2: Channel<3>,
    /// Measured rotor speeds, rad/s, rotor 1 first.
    pub rotor_speed_rad_s: Vec<Channel<1>>,
    /// Measured collective thrust, N.
    pub thrust_n: Channel<1>,
    /// Commanded rotor speeds, rad/s.
    pub cmd_rotor_rad_s: Vec<Channel<1>>,
    /// Commanded throttle of each rotor, 0 to 1.
    pub cmd_u: Vec<Channel<1>>,
    /// Commanded roll, pitch, yaw, rad.
    pub cmd_attitude_rad: Channel<3>,
    /// Commanded collective thrust, N.
    pub cmd_thrust_n: Channel<1>,
    /// Battery voltage, V.
    pub vbat_v: Channel<1>,
    /// Wind in the world, m/s.
    pub wind_m_s: Channel<3>,
    /// Reference position, m, world.
    pub ref_position_m: Channel<3>,
    /// Reference velocity, m/s, world.
    pub ref_velocity_m_s: Channel<3>,
    /// Reference acceleration, m/s², world.
    pub ref_acceleration_m_s2: Channel<3>,
    /// Reference yaw, rad.
    pub ref_yaw_rad: Channel<1>,
    /// How the flight was simulated, where it was.
    pub simulated: Option<Simulated>,
    /// Positions of whatever else was tracked, m, world, by name.
    pub objects_m: BTreeMap<String, Channel<3>>,
    /// What was ignored, filled or changed while reading.
    pub warnings: Vec<String>,
    /// Rows of the file whose time does not rise: (row, time before, time, s).
    #[serde(skip)]
    pub(crate) clock_faults: Vec<ClockFault>,
}

/// How a flight was simulated: what its integrator makes of the equations of motion is part of it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Simulated {
    /// Step of the integrator, s.
    pub step_s: f64,
    /// Its order: 1 for Euler's schemes, 4 for Runge and Kutta's.
    pub order: u32,
}

/// A row whose time is not after that of the row before.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ClockFault {
    pub row: usize,
    pub before_s: f64,
    pub time_s: f64,
    /// Of a bag, whose rows are the messages of this topic.
    pub topic: Option<String>,
}

impl ClockFault {
    /// Where it is, in words.
    fn place(&self) -> String {
        match &self.topic {
            Some(topic) => format!("message {} of {topic}", self.row),
            None => format!("row {}", self.row),
        }
    }
}

/// Whether a file is one of a vehicle, which no mapping is: it has a body.
fn is_vehicle(path: &Path) -> bool {
    let text = files::read(path).ok().and_then(|bytes| String::from_utf8(bytes).ok());
    text.and_then(|text| text.parse::<toml::Table>().ok()).is_some_and(|table| table.contains_key("body"))
}

/// Says of a mapping that nobody has named why it is read at all: a vehicle file of the log's name is not meant as one.
fn beside_the_log(e: FlightError) -> FlightError {
    match e {
        FlightError::Mapping { path, key, expected, found, .. } => FlightError::Mapping {
            path,
            key,
            expected,
            found,
            remedy: "a file of the log's name that ends in .toml is read as its mapping: correct it, or rename it where it is \
                     something else, such as a vehicle file",
        },
        e => e,
    }
}

impl FlightLog {
    /// Reads a log. Its mapping is `mapping`, else the file of the same name with the ending `.toml` where there is
    /// one that is no vehicle file, else none. The format follows from the mapping, else from the ending (`.csv`, `.txt`, `.parquet`, `.ulg`, `.mcap`); a
    /// folder is a ROS 2 bag.
    ///
    /// # Errors
    /// [`FlightError`] where the file cannot be read as numbers under known names. Whether the numbers can be right is
    /// left to [`check()`]; [`FlightLog::open`] does both.
    pub fn load(path: &Path, mapping: Option<&Path>) -> Result<Self> {
        let mapping = match (mapping, mapping_beside(path)) {
            (Some(path), _) => Some(Mapping::load(path)?),
            (None, Some(beside)) => Some(Mapping::load(&beside).map_err(beside_the_log)?),
            (None, None) => None,
        };
        Self::load_with(path, mapping.as_ref())
    }

    /// Reads a log with a mapping, or as the contract says without one.
    ///
    /// # Errors
    /// As [`FlightLog::load`].
    pub fn load_with(path: &Path, mapping: Option<&Mapping>) -> Result<Self> {
        if path.is_dir() {
            return Self::load_folder(path, mapping);
        }
        let bytes = bytes_of(path)?;
        let format = format_of(path, &bytes, mapping)?;
        let sha256 = hex(&Sha256::digest(&bytes));
        let mut log = Self::empty(path, sha256, format);
        log.mapping = mapping.map(|m| m.path().to_path_buf());
        match format {
            Format::Ulog if !bytes.starts_with(ulog::MAGIC) => {
                return Err(FlightError::Format {
                    path: path.to_path_buf(),
                    expected: "a PX4 ULog file, which starts with the bytes `ULog`".into(),
                    found: "other bytes".into(),
                    remedy: "copy the log from the vehicle again, or correct its ending".into(),
                });
            }
            Format::Ulog => ulog::read(&mut log, mapping)?,
            Format::Mcap => {
                let clock_s = bag::read(&mut log, std::iter::once(Ok((path, bytes))), mapping)?;
                return Ok(log.corrected(mapping, clock_s));
            }
            Format::Csv | Format::Parquet => contract::read(&mut log, &bytes, mapping)?,
        }
        Ok(log.corrected(mapping, 0.0))
    }

    /// Reads the folder of a ROS 2 bag.
    fn load_folder(path: &Path, mapping: Option<&Mapping>) -> Result<Self> {
        let found = bag::files(path)?;
        let mut log = Self::empty(path, String::new(), Format::Mcap);
        log.mapping = mapping.map(|m| m.path().to_path_buf());
        log.warnings.extend(found.notes);
        let mut hash = Sha256::new();
        let contents = found.paths.iter().map(|file| {
            let bytes = bytes_of(file)?;
            hash.update(&bytes);
            Ok((file.as_path(), bytes))
        });
        let clock_s = bag::read(&mut log, contents, mapping)?;
        log.sha256 = hex(&hash.finalize());
        Ok(log.corrected(mapping, clock_s))
    }

    /// The log with the corrections of a mapping, its times from its first row on; `clock_s` is what they count from in the file, s.
    fn corrected(mut self, mapping: Option<&Mapping>, clock_s: f64) -> Self {
        if let Some(mapping) = mapping {
            correction::apply(&mut self, mapping.corrections(), mapping.time_scale());
        }
        self.set_origin();
        self.start_s += clock_s;
        self
    }

    /// Reads and checks a log, and refuses one that cannot be right.
    ///
    /// # Errors
    /// As [`FlightLog::load`], and [`FlightError::Refused`] with the checker's sentences.
    pub fn open(path: &Path, mapping: Option<&Path>) -> Result<(Self, CheckReport)> {
        let log = Self::load(path, mapping)?;
        let report = check(&log);
        let reasons: Vec<&str> = report
            .findings
            .iter()
            .filter(|f| f.severity == Severity::Refuse)
            .map(|f| f.text.as_str())
            .collect();
        if reasons.is_empty() {
            Ok((log, report))
        } else {
            Err(FlightError::Refused { path: path.to_path_buf(), reason: reasons.join("; ") })
        }
    }

    /// Writes the log as the contract says, CSV or Parquet by the ending of `path`: one row per time at which anything
    /// was measured, empty cells elsewhere. A file that is there is replaced when the new one is whole.
    ///
    /// # Errors
    /// Those of [`FlightLog::may_save`], and of the system.
    pub fn save(&self, path: &Path) -> Result<()> {
        write::save(self, path)
    }

    /// Whether [`FlightLog::save`] can write at `path`; call it before long work.
    ///
    /// # Errors
    /// [`FlightError::Write`], and [`FlightError::Format`] for any other ending.
    pub fn may_save(path: &Path) -> Result<()> {
        write::may_save(path)
    }

    /// A log without samples.
    pub fn empty(path: &Path, sha256: String, format: Format) -> Self {
        Self {
            path: path.to_path_buf(),
            sha256,
            format,
            mapping: None,
            start_s: 0.0,
            duration_s: 0.0,
            n_rows: 0,
            position_m: Channel::default(),
            attitude: Channel::default(),
            velocity_m_s: Channel::default(),
            angular_velocity_rad_s: Channel::default(),
            specific_force_m_s2: Channel::default(),
            rotor_speed_rad_s: Vec::new(),
            thrust_n: Channel::default(),
            cmd_rotor_rad_s: Vec::new(),
            cmd_u: Vec::new(),
            cmd_attitude_rad: Channel::default(),
            cmd_thrust_n: Channel::default(),
            vbat_v: Channel::default(),
            wind_m_s: Channel::default(),
            ref_position_m: Channel::default(),
            ref_velocity_m_s: Channel::default(),
            ref_acceleration_m_s2: Channel::default(),
            ref_yaw_rad: Channel::default(),
            simulated: None,
            objects_m: BTreeMap::new(),
            warnings: Vec::new(),
            clock_faults: Vec::new(),
        }
    }

    /// Calls `f` with the name (`position`, `rotor1`, …), times and width of every channel that has samples.
    pub fn for_each(&self, mut f: impl FnMut(&str, &dyn ChannelView)) {
        let mut give = |name: &str, c: &dyn ChannelView| {
            if !c.t_s().is_empty() {
                f(name, c);
            }
        };
        give("position", &self.position_m);
        give("attitude", &self.attitude);
        give("velocity", &self.velocity_m_s);
        give("angular velocity", &self.angular_velocity_rad_s);
        give("specific force", &self.specific_force_m_s2);
        for (i, c) in self.rotor_speed_rad_s.iter().enumerate() {
            give(&format!("rotor{}", i + 1), c);
        }
        give("thrust", &self.thrust_n);
        for (i, c) in self.cmd_rotor_rad_s.iter().enumerate() {
            give(&format!("cmd_rotor{}", i + 1), c);
        }
        for (i, c) in self.cmd_u.iter().enumerate() {
            give(&format!("cmd_u{}", i + 1), c);
        }
        give("commanded attitude", &self.cmd_attitude_rad);
        give("cmd_thrust", &self.cmd_thrust_n);
        give("vbat", &self.vbat_v);
        give("wind", &self.wind_m_s);
        give("reference position", &self.ref_position_m);
        give("reference velocity", &self.ref_velocity_m_s);
        give("reference acceleration", &self.ref_acceleration_m_s2);
        give("reference yaw", &self.ref_yaw_rad);
        for (name, c) in &self.objects_m {
            give(&format!("object {name}"), c);
        }
    }

    /// Changes every time.
    fn times_mut(&mut self, change: impl Fn(&mut f64)) {
        let mut all: Vec<&mut Vec<f64>> = Vec::new();
        for c in [
            &mut self.position_m,
            &mut self.velocity_m_s,
            &mut self.angular_velocity_rad_s,
            &mut self.specific_force_m_s2,
            &mut self.cmd_attitude_rad,
            &mut self.wind_m_s,
            &mut self.ref_position_m,
            &mut self.ref_velocity_m_s,
            &mut self.ref_acceleration_m_s2,
        ] {
            all.push(&mut c.t_s);
        }
        all.push(&mut self.attitude.t_s);
        for c in [&mut self.thrust_n, &mut self.cmd_thrust_n, &mut self.vbat_v, &mut self.ref_yaw_rad] {
            all.push(&mut c.t_s);
        }
        for list in [&mut self.rotor_speed_rad_s, &mut self.cmd_rotor_rad_s, &mut self.cmd_u] {
            all.extend(list.iter_mut().map(|c| &mut c.t_s));
        }
        all.extend(self.objects_m.values_mut().map(|c| &mut c.t_s));
        all.into_iter().flatten().for_each(&change);
        for fault in &mut self.clock_faults {
            change(&mut fault.before_s);
            change(&mut fault.time_s);
        }
    }

    /// Lets time start at the first row and takes the duration.
    fn set_origin(&mut self) {
        if self.start_s != 0.0 {
            let start_s = self.start_s;
            self.times_mut(|t| *t -= start_s);
        }
        let mut last: f64 = 0.0;
        self.for_each(|_, c| last = c.t_s().iter().copied().fold(last, f64::max));
        self.duration_s = last;
    }
}

/// The mapping beside a log: the file of the same name with the ending `.toml`, where it is no vehicle file.
fn mapping_beside(log: &Path) -> Option<PathBuf> {
    Some(log.with_extension("toml")).filter(|beside| beside.is_file() && !is_vehicle(beside))
}

/// A channel of any width.
pub trait ChannelView {
    /// Times, s.
    fn t_s(&self) -> &[f64];
    /// Numbers per sample.
    fn width(&self) -> usize;
    /// The numbers of a sample.
    fn sample(&self, i: usize) -> &[f64];
}

impl<const N: usize> ChannelView for Channel<N> {
    fn t_s(&self) -> &[f64] {
        &self.t_s
    }
    fn width(&self) -> usize {
        N
    }
    fn sample(&self, i: usize) -> &[f64] {
        &self.values[i]
    }
}

fn bytes_of(path: &Path) -> Result<Vec<u8>> {
    files::read(path).map_err(|e| FlightError::Read { path: path.to_path_buf(), reason: e.to_string() })
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

fn format_of(path: &Path, bytes: &[u8], mapping: Option<&Mapping>) -> Result<Format> {
    if let Some(format) = mapping.and_then(Mapping::format) {
        return Ok(format);
    }
    if bytes.starts_with(b"PAR1") {
        return Ok(Format::Parquet);
    }
    if bytes.starts_with(ulog::MAGIC) {
        return Ok(Format::Ulog);
    }
    if bytes.starts_with(bag::MAGIC) {
        return Ok(Format::Mcap);
    }
    bag::refuse_others(path, bytes)?;
    let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    match ending.as_str() {
        "csv" | "txt" => Ok(Format::Csv),
        "parquet" => Ok(Format::Parquet),
        "ulg" | "ulog" => Ok(Format::Ulog),
        "mcap" => Ok(Format::Mcap),
        _ => Err(FlightError::Format {
            path: path.to_path_buf(),
            expected: "a file that ends in .csv, .txt, .parquet, .ulg or .mcap, or the folder of a ROS 2 bag"
                .into(),
            found: if ending.is_empty() { "no ending".into() } else { format!("the ending .{ending}") },
            remedy: "rename it, or give `format` in a mapping file".into(),
        }),
    }
}
