//! Says in words what a log holds and what in it cannot be right.

mod clock;
mod motion;
mod values;

use super::FlightLog;
use super::align::Lag;
use super::correction::Fix;
use super::usable::{self, Known, Reason, Unusable};
use serde::Serialize;
use std::fmt;

const RAD_PER_DEG: f64 = std::f64::consts::PI / 180.0;

/// How bad a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// Good to know.
    Info,
    /// The log can be used; what the sentence names should be looked at.
    Warning,
    /// The log cannot be right as it is.
    Refuse,
}

/// What a finding is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Fault {
    /// Something that the reader ignored or filled.
    Reading,
    /// Too little was measured to say anything.
    TooLittle,
    /// Time runs backwards or stands still.
    ClockBackwards,
    /// Time jumps ahead while the vehicle does not move on.
    ClockJump,
    /// Times are in another unit than seconds.
    TimeUnit,
    /// Samples are missing.
    Gap,
    /// Sample times are uneven.
    Jitter,
    /// Values are held over several samples.
    Held,
    /// Quaternions are not of unit length.
    Quaternion,
    /// The attitude is of another order, direction or frame.
    AttitudeFrame,
    /// A value is in another unit, or scaled.
    Unit,
    /// The velocity is in another frame than the position.
    VelocityFrame,
    /// The body rates are in another frame than the attitude.
    RateFrame,
    /// The accelerometer is not a body-frame specific force.
    AccelerometerFrame,
    /// Two channels contradict each other in a way that no known mistake explains.
    Disagreement,
    /// A rotor-speed sensor reads nothing for a while.
    RotorDead,
    /// A sensor has single values far from their neighbours.
    Glitch,
    /// Two channels are out of step.
    Delay,
    /// Part of the log is no flight: the vehicle stands, or its motors are off.
    NoFlight,
    /// The vehicle hits something.
    Crash,
}

/// One sentence about the log.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// How bad it is.
    pub severity: Severity,
    /// What it is about.
    pub fault: Fault,
    /// The channel, as in [`ChannelSummary::name`]; empty for the whole log.
    pub channel: String,
    /// What was found, what was expected, what to do.
    pub text: String,
    /// Where it starts, s.
    pub at_s: Option<f64>,
    /// What `log check --write-mapping` writes against it.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub fixes: Vec<Fix>,
}

/// Sample times of a channel.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ChannelSummary {
    /// Name: position, attitude, rotor1, …
    pub name: String,
    /// Number of samples.
    pub samples: usize,
    /// Samples per s, from the median distance; 0 with fewer than two.
    pub rate_hz: f64,
    /// Longest distance between neighbours, s.
    pub largest_gap_s: f64,
    /// Share of samples that equal the one before, 0 to 1.
    pub held: f64,
}

/// A delay between a channel and what another predicts for it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ChannelDelay {
    /// The channel.
    pub channel: String,
    /// What it was compared with.
    pub against: String,
    /// The estimate.
    #[serde(flatten)]
    pub lag: Lag,
    /// Whether the two move alike enough for the estimate to mean something.
    pub certain: bool,
}

/// What the checker found.
#[derive(Clone, Debug, Serialize)]
pub struct CheckReport {
    /// The log.
    pub file: String,
    /// Its SHA-256.
    pub sha256: String,
    /// Its length, s.
    pub duration_s: f64,
    /// The worst severity found.
    pub verdict: Severity,
    /// Channels that were measured.
    pub channels: Vec<ChannelSummary>,
    /// Delays between channels.
    pub delays: Vec<ChannelDelay>,
    /// Findings, the worst first.
    pub findings: Vec<Finding>,
    /// What compare and diagnose leave out.
    pub unusable: Unusable,
}

impl CheckReport {
    /// The sentences that are warnings.
    pub fn warnings(&self) -> Vec<String> {
        let warnings = self.findings.iter().filter(|f| f.severity == Severity::Warning);
        warnings.map(|f| f.text.clone()).collect()
    }

    /// What mends its findings, each once.
    pub fn fixes(&self) -> Vec<Fix> {
        let mut out: Vec<Fix> = Vec::new();
        for fix in self.findings.iter().flat_map(|f| &f.fixes) {
            if !out.contains(fix) {
                out.push(fix.clone());
            }
        }
        out
    }

    /// Whether there is a finding of that kind, at least a warning.
    pub fn has(&self, fault: Fault) -> bool {
        self.findings.iter().any(|f| f.fault == fault && f.severity > Severity::Info)
    }
}

/// Collects findings.
struct Findings(Vec<Finding>);

impl Findings {
    fn add(&mut self, severity: Severity, fault: Fault, channel: &str, at_s: Option<f64>, text: String) {
        self.0.push(Finding { severity, fault, channel: channel.to_string(), text, at_s, fixes: Vec::new() });
    }
    fn info(&mut self, fault: Fault, channel: &str, at_s: Option<f64>, text: String) {
        self.add(Severity::Info, fault, channel, at_s, text);
    }
    fn warn(&mut self, fault: Fault, channel: &str, at_s: Option<f64>, text: String) {
        self.add(Severity::Warning, fault, channel, at_s, text);
    }
    fn refuse(&mut self, fault: Fault, channel: &str, at_s: Option<f64>, text: String) {
        self.add(Severity::Refuse, fault, channel, at_s, text);
    }
    /// Adds what mends the last finding.
    fn mended_by(&mut self, fixes: impl IntoIterator<Item = Fix>) {
        if let Some(last) = self.0.last_mut() {
            last.fixes.extend(fixes);
        }
    }
    fn refused(&self) -> bool {
        self.0.iter().any(|f| f.severity == Severity::Refuse)
    }
}

/// Checks a log. Motion is compared between channels only when clock, units and quaternions are sound.
pub fn check(log: &FlightLog) -> CheckReport {
    let mut found = Findings(Vec::new());
    for text in &log.warnings {
        found.info(Fault::Reading, "", None, text.clone());
    }
    let channels = clock::check(log, &mut found);
    let mut delays = Vec::new();
    let mut unusable = Unusable::default();
    if !found.refused() {
        values::check(log, &mut found);
        // What is in another unit would look like a jump, or a crash.
        if !found.refused() {
            unusable = usable::look(log, &Known::default());
            no_flight(&unusable, &mut found);
        }
    }
    if !found.0.iter().any(|f| {
        f.severity == Severity::Refuse
            && matches!(
                f.fault,
                Fault::ClockBackwards | Fault::TimeUnit | Fault::Quaternion | Fault::TooLittle
            )
    }) {
        delays = motion::check(log, &mut found);
    }
    found.0.sort_by_key(|f| std::cmp::Reverse(f.severity));
    CheckReport {
        file: log.path.display().to_string(),
        sha256: log.sha256.clone(),
        duration_s: log.duration_s,
        verdict: found.0.first().map_or(Severity::Info, |f| f.severity),
        channels,
        delays,
        findings: found.0,
        unusable,
    }
}

/// Says what is no flight. Gaps are said where the clock is checked.
fn no_flight(unusable: &Unusable, found: &mut Findings) {
    for (text, reason) in unusable.sentences() {
        let first = |reason: Reason| unusable.excluded.iter().find(|e| e.reason == reason).map(|e| e.from_s);
        match reason {
            Some(Reason::OnGround | Reason::MotorsOff) => {
                found.info(Fault::NoFlight, "", reason.and_then(first), text);
            }
            Some(Reason::Crash) => found.warn(Fault::Crash, "", first(Reason::Crash), text),
            Some(Reason::Outliers) => found.warn(Fault::Glitch, "", first(Reason::Outliers), text),
            Some(Reason::Dropout) | None => {}
        }
    }
    for o in &unusable.outliers {
        let n = o.t_s.len();
        let text = format!(
            "{} has {} far from {} neighbours: compare and diagnose leave {} out",
            o.channel,
            if n == 1 { "one sample".into() } else { format!("{n} samples") },
            if n == 1 { "its" } else { "their" },
            if n == 1 { "it" } else { "them" },
        );
        // Raw inertial sensors have such samples in every flight.
        if matches!(o.channel, "position" | "attitude") {
            found.warn(Fault::Glitch, o.channel, o.t_s.first().copied(), text);
        } else {
            found.info(Fault::Glitch, o.channel, o.t_s.first().copied(), text);
        }
    }
}

impl fmt::Display for CheckReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{}: {:.1} s, sha256 {}",
            self.file,
            self.duration_s,
            &self.sha256.get(..16).unwrap_or("")
        )?;
        let width = self.channels.iter().map(|c| c.name.len()).max().unwrap_or(0);
        for c in &self.channels {
            write!(f, "  {:width$}  {:>7} samples  {:>7.1} Hz", c.name, c.samples, c.rate_hz)?;
            write!(f, "  longest gap {:.0} ms", c.largest_gap_s * 1e3)?;
            if c.held > 0.02 {
                write!(f, "  {:.0} % held", c.held * 100.0)?;
            }
            writeln!(f)?;
        }
        for d in &self.delays {
            let lag = &d.lag;
            write!(f, "  {} against {}: ", d.channel, d.against)?;
            if d.certain {
                let word = if lag.lag_s >= 0.0 { "late" } else { "early" };
                writeln!(f, "{:.1} ± {:.1} ms {word}", lag.lag_s.abs() * 1e3, lag.sigma_s * 1e3)?;
            } else {
                writeln!(f, "delay not known, only {:.0} % in common", lag.explained.max(0.0) * 100.0)?;
            }
        }
        for finding in &self.findings {
            let word = match finding.severity {
                Severity::Info => "note",
                Severity::Warning => "warning",
                Severity::Refuse => "refused",
            };
            write!(f, "{word}: {}", finding.text)?;
            if let Some(at) = finding.at_s {
                write!(f, " (from {at:.3} s)")?;
            }
            writeln!(f)?;
        }
        match self.verdict {
            Severity::Info => write!(f, "no problem found"),
            Severity::Warning => write!(f, "the log can be used; see the warnings"),
            Severity::Refuse => write!(f, "the log cannot be right as it is"),
        }
    }
}
