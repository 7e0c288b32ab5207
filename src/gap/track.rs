//! A flight log made ready to be flown again by a model: what drives it, what was measured, and how noisy that is.

use super::inputs::without_noise;
use super::{GapError, lean, usable};
use crate::flight::resample::Cursor;
use crate::flight::{Channel, Excluded, FlightLog, clean, resample};
use crate::math::quat;
use crate::physics::airframe;
use crate::physics::rigid_body::MAX_ROTORS;
use crate::physics::surroundings::NO_GROUND_M;
use crate::vehicle::{DYNAMICS, Vehicle};
use rayon::prelude::*;
use serde::Serialize;

/// What of a log drives the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Drive {
    /// Measured rotor speeds.
    RotorSpeeds,
    /// Commanded rotor speeds, through the model's motors.
    RotorCommands,
    /// Commanded attitude and thrust, through the abstracted response.
    AttitudeCommands,
    /// Collective thrust with the measured attitude: forces only, no torques.
    Thrust,
}

impl Drive {
    /// In words.
    pub fn title(self) -> &'static str {
        match self {
            Self::RotorSpeeds => "measured rotor speeds",
            Self::RotorCommands => "rotor commands",
            Self::AttitudeCommands => "attitude and thrust commands",
            Self::Thrust => "collective thrust and measured attitude",
        }
    }
}

/// Noise of channels as the user states it, in place of what the log says.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StatedNoise {
    /// Position, m.
    pub position_m: Option<f64>,
    /// Attitude, rad.
    pub attitude_rad: Option<f64>,
    /// Gyroscope, rad/s.
    pub gyro_rad_s: Option<f64>,
    /// Accelerometer, m/s².
    pub accel_m_s2: Option<f64>,
}

impl StatedNoise {
    /// Channels whose noise can be stated.
    pub const CHANNELS: [&str; 4] = ["position", "attitude", "gyro", "accel"];

    /// States the noise of a channel, by its name.
    ///
    /// # Errors
    /// What was expected, in words, where there is no such channel or the noise is no finite number above 0.
    pub fn set(&mut self, channel: &str, value: f64) -> Result<(), String> {
        let place = match channel {
            "position" => &mut self.position_m,
            "attitude" => &mut self.attitude_rad,
            "gyro" => &mut self.gyro_rad_s,
            "accel" => &mut self.accel_m_s2,
            _ => return Err(format!("a channel among {}", Self::CHANNELS.join(", "))),
        };
        if !(value > 0.0 && value.is_finite()) {
            return Err(format!("a finite noise of {channel} above 0"));
        }
        *place = Some(value);
        Ok(())
    }
}

/// How a log is to be read.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Options {
    /// Noise of channels that is not to be estimated.
    pub noise: StatedNoise,
    /// What drives the model; the first that the log and the vehicle have of rotor commands, measured rotor speeds,
    /// attitude commands, thrust, if not given.
    pub drive: Option<Drive>,
    /// Height of the ground, m, world; 0 if not given.
    pub ground_z_m: Option<f64>,
    /// Height of the ceiling, m, world; none if not given.
    pub ceiling_z_m: Option<f64>,
    /// Names of tracked objects that are vehicles; all that are not loads if not given.
    pub neighbours: Option<Vec<String>>,
    /// Name of the tracked object that hangs on a cable; the first whose name has "payload" or "load" if not given.
    pub load: Option<String>,
}

/// Standard deviation of one sample of each channel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Noise {
    /// Position, m, per axis.
    pub position_m: f64,
    /// Attitude, rad, per axis.
    pub attitude_rad: f64,
    /// Gyroscope, rad/s.
    pub gyro_rad_s: f64,
    /// Accelerometer, m/s².
    pub accel_m_s2: f64,
    /// Measured rotor speeds that drive the model, rad/s.
    pub rotor_rad_s: Option<f64>,
    /// Thrust that drives the model, N.
    pub thrust_n: Option<f64>,
    /// Whether position, attitude, gyroscope and accelerometer have the noise that the user states.
    pub stated: [bool; 4],
}

/// Samples of commands or of measured inputs.
#[derive(Clone, Debug)]
pub(crate) struct Inputs {
    /// Rotor speeds, measured or commanded, rad/s, shape (rotor).
    pub rotors: Vec<Channel<1>>,
    /// Commanded roll, pitch, yaw, rad.
    pub attitude: Channel<3>,
    /// Thrust, measured or commanded, N.
    pub thrust: Channel<1>,
}

/// A log with what an analysis needs of it.
#[derive(Clone, Debug)]
pub struct Track {
    /// The log.
    pub log: FlightLog,
    /// File name, for messages.
    pub name: String,
    /// What drives the model.
    pub drive: Drive,
    /// Dynamics of the vehicle that fit the drive, one of [`DYNAMICS`].
    pub dynamics: &'static str,
    /// Span in which pose and drive were both measured, s.
    pub span_s: [f64; 2],
    /// Noise of the channels.
    pub noise: Noise,
    /// Height of the ground, m; none where nothing is known of it.
    pub ground_z_m: Option<f64>,
    /// Height of the ceiling, m.
    pub ceiling_z_m: Option<f64>,
    /// Names of tracked vehicles.
    pub neighbours: Vec<String>,
    /// Name of the tracked load.
    pub load: Option<String>,
    /// What was left out or assumed.
    pub warnings: Vec<String>,
    /// Spans that are left out: on the ground, a crash, gaps.
    pub excluded: Vec<Excluded>,
    pub(crate) inputs: Inputs,
    /// Time over which measured inputs were smoothed, s.
    pub(crate) smoothed_s: f64,
    pub(crate) position: Channel<3>,
    pub(crate) attitude: Channel<4>,
    pub(crate) gyro: Channel<3>,
    pub(crate) accel: Channel<3>,
}

/// Time before the usable span in which a model's motors and filters settle, s.
pub(crate) const SETTLE_S: f64 = 0.25;
/// Shortest flight that is analysed, s.
pub const SHORTEST_S: f64 = 2.0;

impl Track {
    /// A log for a vehicle.
    ///
    /// # Errors
    /// [`GapError::Log`] where the log has no pose or nothing that drives the model, [`GapError::TooShort`] where it has less
    /// than [`SHORTEST_S`] of both.
    pub fn new(log: FlightLog, vehicle: &Vehicle, options: &Options) -> Result<Self, GapError> {
        let name = log.path.file_name().map_or_else(|| "log".into(), |n| n.to_string_lossy().into_owned());
        let mut warnings = Vec::new();
        let fault = |expected: &str, found: String, remedy: &str| GapError::Log {
            log: name.clone(),
            expected: expected.into(),
            found,
            remedy: remedy.into(),
        };
        for (what, n) in [("position", log.position_m.len()), ("attitude", log.attitude.len())] {
            if n < 50 {
                return Err(fault(
                    &format!("at least 50 samples of {what} (px py pz, qx qy qz qw)"),
                    format!("{n}"),
                    "log the pose of motion capture or of the estimator",
                ));
            }
        }
        let (drive, dynamics, mut inputs) = choose_drive(&log, vehicle, options, &name, &mut warnings)?;
        // What no flight model explains is in no channel from here on.
        let cut = usable::look(&log, vehicle);
        warnings.extend(cut.words());
        let position = cut.without("position", &distinct(&log.position_m, "position", &mut warnings));
        let mut attitude = cut.without("attitude", &distinct(&log.attitude, "attitude", &mut warnings));
        for q in &mut attitude.values {
            *q = quat::normalize(*q);
        }
        for (what, n) in [("position", position.len()), ("attitude", attitude.len())] {
            if n < 50 {
                return Err(fault(
                    &format!("a {what} that changes in flight, at least 50 times"),
                    match cut.words().join("; ") {
                        said if said.is_empty() => {
                            format!("{n} different samples: nothing moves, or the sensor is stuck")
                        }
                        said => format!("{n} different samples ({said})"),
                    },
                    "give a log of a flight",
                ));
            }
        }
        let flying = Inputs {
            rotors: inputs.rotors.iter().map(|c| usable::flying(&cut, c)).collect(),
            thrust: usable::flying(&cut, &inputs.thrust),
            attitude: Channel::default(),
        };
        plausible_thrust(drive, dynamics, &flying, vehicle, &fault)?;
        let gyro = distinct(&log.angular_velocity_rad_s, "angular velocity", &mut warnings);
        let accel = distinct(&log.specific_force_m_s2, "specific force", &mut warnings);
        let (gyro, accel) = (cut.without("angular velocity", &gyro), cut.without("specific force", &accel));

        let mut span = [0.0, f64::INFINITY];
        let mut within = |t: &[f64]| {
            if let (Some(a), Some(b)) = (t.first(), t.last()) {
                span = [f64::max(span[0], *a), f64::min(span[1], *b)];
            }
        };
        within(&position.t_s);
        within(&attitude.t_s);
        inputs.rotors.iter().for_each(|c| within(&c.t_s));
        within(&inputs.thrust.t_s);
        within(&inputs.attitude.t_s);
        // Motors and filters of the model need a moment to forget how they were started.
        span[0] += SETTLE_S;
        let span = usable::trimmed(&cut.excluded, span);
        if let Some(found) = usable::too_little(&cut, span) {
            return Err(GapError::TooShort {
                log: name.clone(),
                expected: format!("at least {SHORTEST_S} s with pose and {}", drive.title()),
                found,
                remedy: "give a longer flight".into(),
            });
        }
        let in_span = |c: &Channel<3>| c.t_s.iter().filter(|t| **t >= span[0] && **t <= span[1]).count();
        let usable = |c: Channel<3>, what: &str, warnings: &mut Vec<String>| {
            if !c.is_empty() && in_span(&c) < 50 {
                warnings.push(format!("{what}: fewer than 50 samples in the flight, not used"));
                return Channel::default();
            }
            c
        };
        let gyro = usable(gyro, "angular velocity", &mut warnings);
        let accel = usable(accel, "specific force", &mut warnings);
        let stated = &options.noise;
        let mut noise = Noise {
            position_m: stated.position_m.unwrap_or_else(|| noise_of(&position).max(2e-5)),
            attitude_rad: stated.attitude_rad.unwrap_or_else(|| attitude_noise(&attitude).max(1e-4)),
            gyro_rad_s: stated.gyro_rad_s.unwrap_or_else(|| noise_of(&gyro).max(5e-4)),
            accel_m_s2: stated.accel_m_s2.unwrap_or_else(|| noise_of(&accel).max(5e-3)),
            rotor_rad_s: None,
            thrust_n: None,
            stated: [
                stated.position_m.is_some(),
                stated.attitude_rad.is_some(),
                stated.gyro_rad_s.is_some(),
                stated.accel_m_s2.is_some(),
            ],
        };
        let mut smoothed_s = 0.0;
        match drive {
            Drive::RotorSpeeds => {
                if let Some(smooth) = without_noise(&inputs.rotors) {
                    inputs.rotors = smooth.inputs;
                    noise.rotor_rad_s = Some(smooth.noise);
                    smoothed_s = smooth.reach_s;
                }
            }
            Drive::Thrust => {
                if let Some(smooth) = without_noise(std::slice::from_ref(&inputs.thrust)) {
                    inputs.thrust = smooth.inputs.into_iter().next().unwrap_or_default();
                    noise.thrust_n = Some(smooth.noise);
                    smoothed_s = smooth.reach_s;
                }
            }
            // What is sent is known.
            Drive::RotorCommands | Drive::AttitudeCommands => {}
        }
        let load = match &options.load {
            Some(wanted) => Some(known_object(&log, wanted)?),
            None => log.objects_m.keys().find(|n| is_load(n)).cloned(),
        };
        let neighbours = match &options.neighbours {
            Some(list) => list.iter().map(|n| known_object(&log, n)).collect::<Result<_, _>>()?,
            None => {
                log.objects_m.keys().filter(|n| !is_load(n) && Some(*n) != load.as_ref()).cloned().collect()
            }
        };
        let mut track = Self {
            name,
            drive,
            dynamics,
            span_s: span,
            noise,
            ground_z_m: Some(options.ground_z_m.unwrap_or(0.0)),
            ceiling_z_m: options.ceiling_z_m,
            neighbours,
            load,
            warnings,
            excluded: cut.excluded,
            inputs,
            smoothed_s,
            position,
            attitude,
            gyro,
            accel,
            log,
        };
        // A vehicle that lacks these dynamics is refused where they are needed.
        if let Ok(drone) = vehicle.drone(dynamics)
            && let Some(lean) = lean::taken_out(&mut track, drone.body.gravity_m_s2)
        {
            track.warnings.push(lean.words());
        }
        Ok(track)
    }

    /// Length of the usable span, s.
    pub fn duration_s(&self) -> f64 {
        self.span_s[1] - self.span_s[0]
    }

    /// Whether nothing counts at a time: the vehicle on the ground, a crash.
    pub(crate) fn is_excluded(&self, at_s: f64) -> bool {
        self.excluded.iter().any(|e| e.whole() && at_s >= e.from_s && at_s <= e.to_s)
    }

    /// The same log, of which only the part within a span (s) is used.
    pub fn cut(&self, span_s: [f64; 2]) -> Self {
        let [from, to] = self.span_s;
        Self { span_s: [span_s[0].max(from), span_s[1].min(to)], ..self.clone() }
    }

    /// Distance from height `z_m` down to the ground, m.
    pub(crate) fn ground_distance_m(&self, z_m: f64) -> f64 {
        self.ground_z_m.map_or(NO_GROUND_M, |ground| z_m - ground)
    }

    /// Half widths of the local polynomials behind [`Track::measured_state`].
    pub(crate) fn windows(&self) -> Windows {
        let period = |c: &[f64]| resample::spacing_s(c).unwrap_or(0.01);
        let p_period = period(&self.position.t_s);
        // A parabola over T has the velocity noise σ √(12/n) / T; longer spans bend. 60 ms each side at 1 cm, 20 ms at best.
        let half = (0.02 * (self.noise.position_m / 3e-4).powf(0.3)).clamp(0.02, 0.08).max(3.2 * p_period);
        let a_half = 0.02f64.max(3.2 * period(&self.attitude.t_s));
        let wide = (0.02 * (self.noise.attitude_rad / 3e-3).powf(0.3)).clamp(0.02, 0.06);
        let rate =
            if self.gyro.is_empty() { wide.max(a_half) } else { 0.012f64.max(3.2 * period(&self.gyro.t_s)) };
        Windows { position_s: half, attitude_s: a_half, rate_s: rate }
    }

    /// State at a time, from local polynomials through the measurements: (position, attitude, velocity, body rate).
    pub(crate) fn measured_state(&self, at_s: &[f64]) -> Vec<Option<Measured>> {
        at_s.par_chunks(1024).flat_map_iter(|at| self.measured_states(at)).collect()
    }

    /// The same, one after the other.
    fn measured_states(&self, at_s: &[f64]) -> Vec<Option<Measured>> {
        let Windows { position_s, attitude_s: a_half, rate_s } = self.windows();
        let positions =
            widened(at_s, position_s, |at, half| resample::local_parabola(&self.position, at, half));
        let rates = (self.gyro.is_empty())
            .then(|| widened(at_s, rate_s, |at, half| resample::body_rates(&self.attitude, at, half)));
        let gyros = widened(at_s, rate_s, |at, half| resample::local_parabola(&self.gyro, at, half));
        let attitudes = widened(at_s, a_half, |at, half| {
            let mut cursors = [Cursor::default(); 3];
            at.iter().map(|at| smooth_attitude(&self.attitude, *at, half, &mut cursors)).collect()
        });
        (0..at_s.len())
            .map(|i| {
                let position = positions[i].as_ref()?;
                let attitude = attitudes[i]?;
                let rate = match &rates {
                    Some(rates) => rates[i]?,
                    None => gyros[i].as_ref()?.value,
                };
                Some(Measured { pos: position.value, vel: position.slope, quat: attitude, ang_vel: rate })
            })
            .collect()
    }

    /// Specific force that the accelerometer reads at given times, m/s², in its own axes; `None` in its gaps.
    pub(crate) fn felt(&self, at_s: &[f64]) -> Vec<Option<[f64; 3]>> {
        let half_s = 0.0125f64.max(3.2 * self.accel.period_s().unwrap_or(0.01));
        let read = widened(at_s, half_s, |at, half| resample::local_parabola(&self.accel, at, half));
        read.into_iter().map(|l| l.map(|l| l.value)).collect()
    }
}

/// How much wider local fits become where too few samples lie, as between held values. Gaps are longer: 4.5 usual steps.
const WIDER: [f64; 2] = [1.4, 2.0];

/// Local fits at times, wider where they cannot be made.
fn widened<T>(at_s: &[f64], half_s: f64, fit: impl Fn(&[f64], f64) -> Vec<Option<T>>) -> Vec<Option<T>> {
    let mut out = fit(at_s, half_s);
    for wider in WIDER {
        let open: Vec<usize> = (0..out.len()).filter(|i| out[*i].is_none()).collect();
        let at: Vec<f64> = open.iter().map(|i| at_s[*i]).collect();
        for (i, found) in open.into_iter().zip(fit(&at, wider * half_s)) {
            out[i] = found;
        }
    }
    out
}

/// Half widths of local polynomials, s.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Windows {
    /// Through positions.
    pub position_s: f64,
    /// Through attitudes.
    pub attitude_s: f64,
    /// Through the gyroscope, or through attitudes where there is none.
    pub rate_s: f64,
}

/// A measured state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Measured {
    pub pos: [f64; 3],
    pub vel: [f64; 3],
    pub quat: [f64; 4],
    pub ang_vel: [f64; 3],
}

fn is_load(name: &str) -> bool {
    let name = name.to_lowercase();
    name.contains("load") || name.contains("cargo") || name.contains("weight")
}

fn known_object(log: &FlightLog, name: &str) -> Result<String, GapError> {
    if log.objects_m.contains_key(name) {
        return Ok(name.into());
    }
    let list: Vec<&str> = log.objects_m.keys().map(String::as_str).collect();
    let known = if list.is_empty() { "no tracked objects in this log".into() } else { list.join(", ") };
    Err(GapError::Unknown { name: name.into(), what: "tracked object", known })
}

/// What drives the model.
fn choose_drive(
    log: &FlightLog,
    vehicle: &Vehicle,
    options: &Options,
    name: &str,
    warnings: &mut Vec<String>,
) -> Result<(Drive, &'static str, Inputs), GapError> {
    let n_rotors = vehicle.file().rotor.len().min(MAX_ROTORS);
    let full = |list: &[Channel<1>]| list.len() == n_rotors && list.iter().all(|c| c.len() >= 50);
    let response = DYNAMICS[1..].iter().rev().find(|d| vehicle.drone(d).is_ok());
    let thrust = [&log.thrust_n, &log.cmd_thrust_n].into_iter().find(|c| c.len() >= 50);
    let has = |drive: Drive| match drive {
        Drive::RotorSpeeds => full(&log.rotor_speed_rad_s),
        Drive::RotorCommands => full(&log.cmd_rotor_rad_s),
        Drive::AttitudeCommands => {
            response.is_some() && log.cmd_attitude_rad.len() >= 50 && log.cmd_thrust_n.len() >= 50
        }
        Drive::Thrust => thrust.is_some(),
    };
    let order = [Drive::RotorCommands, Drive::RotorSpeeds, Drive::AttitudeCommands, Drive::Thrust];
    let available: Vec<&str> = order.iter().filter(|d| has(**d)).map(|d| d.title()).collect();
    let fault = |expected: String| {
        let mut found = if available.is_empty() { "none of them".into() } else { available.join(", ") };
        for (what, list) in [("rotor", &log.rotor_speed_rad_s), ("cmd_rotor", &log.cmd_rotor_rad_s)] {
            if !list.is_empty() && list.len() != n_rotors {
                found =
                    format!("{found}; {} columns {what}1… for a vehicle of {n_rotors} rotors", list.len());
            }
        }
        GapError::Log {
            log: name.into(),
            expected,
            found,
            remedy: "log one of them, map its columns (docs/logs.md), or choose another vehicle file".into(),
        }
    };
    let drive = match options.drive {
        Some(drive) if has(drive) => drive,
        Some(drive) => return Err(fault(drive.title().into())),
        None => order.into_iter().find(|d| has(*d)).ok_or_else(|| {
            fault("rotor speeds, rotor commands, attitude and thrust commands, or a thrust".into())
        })?,
    };
    let mut inputs = Inputs { rotors: Vec::new(), attitude: Channel::default(), thrust: Channel::default() };
    let dynamics = match drive {
        Drive::RotorSpeeds => {
            for (i, c) in log.rotor_speed_rad_s.iter().enumerate() {
                inputs.rotors.push(without_spikes(c, &format!("rotor{}", i + 1), warnings));
            }
            DYNAMICS[0]
        }
        Drive::RotorCommands => {
            inputs.rotors = log.cmd_rotor_rad_s.clone();
            DYNAMICS[0]
        }
        Drive::AttitudeCommands => {
            inputs.attitude = log.cmd_attitude_rad.clone();
            inputs.thrust = log.cmd_thrust_n.clone();
            response.copied().unwrap_or(DYNAMICS[0])
        }
        Drive::Thrust => {
            inputs.thrust = thrust.cloned().unwrap_or_default();
            if log.thrust_n.len() < 50 {
                warnings
                    .push("the commanded thrust stands for the thrust: it has the motors' lag in it".into());
            }
            DYNAMICS[0]
        }
    };
    Ok((drive, dynamics, inputs))
}

/// Thrust over weight that flights have in the middle: outside, it is the wrong vehicle or the wrong unit.
const PLAUSIBLE_THRUST: [f64; 2] = [0.3, 3.0];

/// Refuses inputs by which the vehicle would not fly: over a flight, thrust is about weight.
fn plausible_thrust(
    drive: Drive,
    dynamics: &str,
    inputs: &Inputs,
    vehicle: &Vehicle,
    fault: &dyn Fn(&str, String, &str) -> GapError,
) -> Result<(), GapError> {
    // A vehicle that lacks these dynamics is refused where they are needed.
    let Ok(drone) = vehicle.drone(dynamics) else { return Ok(()) };
    let middle = |c: &Channel<1>| clean::median(c.component(0)).unwrap_or(0.0);
    let (thrust_n, of) = match drive {
        Drive::RotorSpeeds | Drive::RotorCommands => {
            let mut speeds = [0.0; MAX_ROTORS];
            for (speed, channel) in speeds.iter_mut().zip(&inputs.rotors) {
                *speed = middle(channel);
            }
            let of = format!("{} of {:.0} rad/s in the middle", drive.title(), speeds[0]);
            (airframe::loads(&drone.airframe, &speeds).thrust.iter().sum::<f64>(), of)
        }
        Drive::AttitudeCommands | Drive::Thrust => (middle(&inputs.thrust), "its thrust column".into()),
    };
    let weight_n = drone.hover_thrust();
    let times = thrust_n / weight_n;
    if (PLAUSIBLE_THRUST[0]..=PLAUSIBLE_THRUST[1]).contains(&times) {
        return Ok(());
    }
    Err(fault(
        &format!("a thrust of about the weight of `{}`, {weight_n:.3} N", vehicle.name),
        format!("{thrust_n:.3} N by {of}, {times:.2} times as much"),
        "check the units (rpm labelled rad/s?), the vehicle file's mass and thrust curve, and whether the log is of \
         this vehicle",
    ))
}

/// Rotor speeds without samples that stand out or read zero in flight.
fn without_spikes(channel: &Channel<1>, name: &str, warnings: &mut Vec<String>) -> Channel<1> {
    let typical = clean::median(channel.component(0)).unwrap_or(0.0);
    let mut marks = clean::outliers(channel, 3, 8.0, 0.15 * typical);
    for (mark, v) in marks.iter_mut().zip(&channel.values) {
        *mark |= v[0] < 0.05 * typical;
    }
    let n = marks.iter().filter(|m| **m).count();
    if n > 0 {
        warnings.push(format!("{name}: {n} samples that jump or read 0 were left out"));
    }
    clean::without(channel, &marks)
}

/// The channel without samples that only repeat the one before (held values of a slower sensor).
fn distinct<const N: usize>(channel: &Channel<N>, name: &str, warnings: &mut Vec<String>) -> Channel<N> {
    let mut out = Channel::<N>::default();
    for (t, v) in channel.t_s.iter().zip(&channel.values) {
        let later = out.t_s.last().is_none_or(|last| t > last);
        if later && out.values.last() != Some(v) {
            out.push(*t, *v);
        }
    }
    let left = channel.len() - out.len();
    if left * 20 > channel.len() {
        warnings.push(format!(
            "{name}: {left} of {} samples repeat the one before and were left out",
            channel.len()
        ));
    }
    out
}

/// Samples of the local fits from whose residuals noise is estimated.
const NEAR: usize = 7;

/// Standard deviation of a sample: what cubics through 7 neighbours leave, by the median over the log and components.
pub(crate) fn noise_of<const N: usize>(channel: &Channel<N>) -> f64 {
    let mut all = Vec::new();
    let stride = (channel.len() / 2000).max(1);
    for from in (0..channel.len().saturating_sub(NEAR)).step_by(stride) {
        let t = &channel.t_s[from..from + NEAR];
        for k in 0..N {
            let y: Vec<f64> = (0..NEAR).map(|i| channel.values[from + i][k]).collect();
            all.push(cubic_residual(t, &y));
        }
    }
    // Median of χ² with NEAR − 4 = 3 degrees of freedom: 2.366.
    clean::median(all).map_or(0.0, |m| (m / 2.366).sqrt())
}

fn attitude_noise(channel: &Channel<4>) -> f64 {
    let mut all = Vec::new();
    let stride = (channel.len() / 2000).max(1);
    for from in (0..channel.len().saturating_sub(NEAR)).step_by(stride) {
        let base = quat::conjugate(channel.values[from + NEAR / 2]);
        let turns: Vec<[f64; 3]> =
            (0..NEAR).map(|i| resample::rotation_vector(quat::mul(base, channel.values[from + i]))).collect();
        for k in 0..3 {
            let y: Vec<f64> = turns.iter().map(|r| r[k]).collect();
            all.push(cubic_residual(&channel.t_s[from..from + NEAR], &y));
        }
    }
    clean::median(all).map_or(0.0, |m| (m / 2.366).sqrt())
}

/// Sum of squares that a cubic leaves.
fn cubic_residual(t: &[f64], y: &[f64]) -> f64 {
    let (middle, scale) = (t[t.len() / 2], (t[t.len() - 1] - t[0]).max(1e-9));
    // Orthogonal polynomials by Gram–Schmidt, exact for uneven times.
    let mut rest = y.to_vec();
    let mut basis: Vec<Vec<f64>> = Vec::new();
    for power in 0..4 {
        let mut p: Vec<f64> = t.iter().map(|t| ((t - middle) / scale).powi(power)).collect();
        for b in &basis {
            let d: f64 = p.iter().zip(b).map(|(a, b)| a * b).sum();
            p.iter_mut().zip(b).for_each(|(a, b)| *a -= d * b);
        }
        let norm = p.iter().map(|a| a * a).sum::<f64>().sqrt();
        if norm < 1e-9 {
            continue;
        }
        p.iter_mut().for_each(|a| *a /= norm);
        let d: f64 = rest.iter().zip(&p).map(|(a, b)| a * b).sum();
        rest.iter_mut().zip(&p).for_each(|(a, b)| *a -= d * b);
        basis.push(p);
    }
    rest.iter().map(|r| r * r).sum()
}

/// Attitude at a time: a parabola of rotation vectors about the nearest sample, over `half_s` each side.
fn smooth_attitude(
    channel: &Channel<4>,
    at_s: f64,
    half_s: f64,
    cursors: &mut [Cursor; 3],
) -> Option<[f64; 4]> {
    let t = &channel.t_s;
    let from = cursors[0].seek(t, |x| x < at_s - half_s * (1.0 + 1e-6));
    let to = cursors[1].seek(t, |x| x <= at_s + half_s * (1.0 + 1e-6));
    if to < from + 4 {
        return None;
    }
    let base = channel.values[cursors[2].seek(t, |x| x < at_s).clamp(from, to - 1)];
    let mut near = Channel::<3>::default();
    for i in from..to {
        near.push(t[i], resample::rotation_vector(quat::mul(quat::conjugate(base), channel.values[i])));
    }
    let local = resample::local_parabola(&near, &[at_s], half_s)[0]?;
    Some(quat::mul(base, quat::exp(local.value)))
}
