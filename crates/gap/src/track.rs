//! A flight log prepared for replay by a model: the inputs, the measurements, and their noise.

mod drive;
mod noise;
mod objects;
mod sensors;
pub(crate) mod throttle;

use super::inputs::Smoothing;
use super::replay::Contexts;
use super::{GapError, lean, usable};
use drive::{choose_drive, plausible_thrust};
use propwash_flight::resample::Cursor;
use propwash_flight::usable::Unusable;
use propwash_flight::{Channel, Excluded, FlightLog, resample};
use propwash_physics::effects::{AnyEffect, Effect};
use propwash_physics::surroundings::NO_GROUND_M;
use propwash_trace::math::quat;
use propwash_vehicle::{DYNAMICS, Vehicle};
use rayon::prelude::*;
use serde::Serialize;

pub(crate) use drive::{Inputs, without_spikes};
pub(crate) use noise::noise_of;

/// Which channels of a log drive the model.
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
    /// All of them, those known most exactly first; a thrust comes last, since it carries no torques.
    pub const ALL: [Self; 4] = [Self::RotorCommands, Self::RotorSpeeds, Self::AttitudeCommands, Self::Thrust];

    /// The dynamics that it drives: the most detailed attitude response in the file, or those of the rotors.
    pub fn dynamics(self, vehicle: &Vehicle) -> &'static str {
        let response = || DYNAMICS[1..].iter().rev().find(|d| vehicle.drone(d).is_ok());
        let response = (self == Self::AttitudeCommands).then(response).flatten();
        response.copied().unwrap_or(DYNAMICS[0])
    }

    /// Its name in words.
    pub fn title(self) -> &'static str {
        match self {
            Self::RotorSpeeds => "measured rotor speeds",
            Self::RotorCommands => "rotor commands",
            Self::AttitudeCommands => "attitude and thrust commands",
            Self::Thrust => "collective thrust and measured attitude",
        }
    }
}

/// User-stated noise of channels, instead of estimates from the log.
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

    /// Sets the noise of a channel, by its name.
    ///
    /// # Errors
    /// The expectation in words, where there is no such channel or the noise is not a finite number above 0.
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

/// How to read a log.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Options {
    /// Stated noise of channels, which is then not estimated.
    pub noise: StatedNoise,
    /// Drive of the model; by default the first that log and vehicle have of rotor commands, measured rotor speeds,
    /// attitude commands, thrust.
    pub drive: Option<Drive>,
    /// Height of the ground, m, world; 0 if not given.
    pub ground_z_m: Option<f64>,
    /// Height of the ceiling, m, world; none if not given.
    pub ceiling_z_m: Option<f64>,
    /// Names of tracked objects that are vehicles; by default every tracked object that is not a load.
    pub neighbours: Option<Vec<String>>,
    /// Name of the tracked object that hangs on a cable; by default the first whose name contains "load", "cargo" or
    /// "weight".
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
    /// Whether the noise of position, attitude, gyroscope and accelerometer is stated by the user.
    pub stated: [bool; 4],
}

/// A log with all that an analysis needs.
///
/// ```no_run
/// use propwash_flight::FlightLog;
/// use propwash_gap::diagnose::{Settings, diagnose};
/// use propwash_gap::{Options, Track, compare};
/// use propwash_vehicle::Vehicle;
///
/// let vehicle = Vehicle::load("quad.toml")?;
/// let (log, _) = FlightLog::open("flight.csv".as_ref(), None)?;
/// let track = Track::new(log, &vehicle, &Options::default())?;
/// println!("{} logs compared", compare(std::slice::from_ref(&track), &vehicle)?.logs.len());
/// let found = diagnose(&[track], &vehicle, &Settings::default())?;
/// println!("{}", found.verdict.headline);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Track {
    /// The log.
    pub log: FlightLog,
    /// File name, for messages.
    pub name: String,
    /// Drive of the model.
    pub drive: Drive,
    /// Dynamics of the vehicle that fit the drive, one of [`propwash_vehicle::DYNAMICS`].
    pub dynamics: &'static str,
    /// Span in which pose and drive were both measured, s.
    pub span_s: [f64; 2],
    /// Noise of the channels.
    pub noise: Noise,
    /// Height of the ground, m; `None` if unknown.
    pub ground_z_m: Option<f64>,
    /// Height of the ceiling, m.
    pub ceiling_z_m: Option<f64>,
    /// Names of tracked vehicles.
    pub neighbours: Vec<String>,
    /// Name of the tracked load.
    pub load: Option<String>,
    /// Omissions and assumptions.
    pub warnings: Vec<String>,
    /// Excluded spans: on the ground, a crash, gaps.
    pub excluded: Vec<Excluded>,
    pub(crate) inputs: Inputs,
    /// Whether rotor commands follow from throttles and the battery's measured voltage.
    pub(crate) battery_in_commands: bool,
    /// Whether the thrust follows from measured rotor speeds.
    pub(crate) thrust_by_rotors: bool,
    /// How measured inputs were smoothed.
    pub(crate) smoothing: Smoothing,
    pub(crate) position: Channel<3>,
    pub(crate) attitude: Channel<4>,
    pub(crate) gyro: Channel<3>,
    pub(crate) accel: Channel<3>,
    /// What replays of it share.
    pub(crate) contexts: Contexts,
}

/// Builds an error of a log from what was expected, what was found, and what to do.
type Fault<'a> = dyn Fn(&str, String, &str) -> GapError + 'a;

/// Time before the usable span in which the modelled motors and filters settle, s.
pub(crate) const SETTLE_S: f64 = 0.25;
/// Shortest usable flight, s.
pub const SHORTEST_S: f64 = 2.0;

/// What a comparison leaves out of effects whose forces go with what they remember.
fn forgetful(vehicle: &Vehicle, dynamics: &str) -> Option<String> {
    let drone = vehicle.drone(dynamics).ok()?;
    let moved: Vec<String> =
        drone.effects.iter().filter(|e| e.nature().moved_by_memory).map(AnyEffect::label).collect();
    (!moved.is_empty()).then(|| {
        format!(
            "{}: acts as at its start: comparisons with logs do not follow what it remembers or is commanded",
            moved.join(", ")
        )
    })
}

impl Track {
    /// Prepares a log for a vehicle.
    ///
    /// # Errors
    /// [`GapError::Log`] where the log has no pose or nothing that drives the model, [`GapError::TooShort`] where it has
    /// less than [`SHORTEST_S`] of both.
    pub fn new(log: FlightLog, vehicle: &Vehicle, options: &Options) -> Result<Self, GapError> {
        let name = log.path.file_name().map_or_else(|| "log".into(), |n| n.to_string_lossy().into_owned());
        let mut warnings = Vec::new();
        let fault = |expected: &str, found: String, remedy: &str| GapError::Log {
            log: name.clone(),
            expected: expected.into(),
            found,
            remedy: remedy.into(),
        };
        sensors::has_pose(&log, &fault)?;
        let (drive, dynamics, mut inputs) = choose_drive(&log, vehicle, options, &name, &mut warnings)?;
        warnings.extend(forgetful(vehicle, dynamics));
        // From here on, no channel contains spans that no flight model explains.
        let cut = usable::look(&log, vehicle);
        warnings.extend(cut.words());
        let (position, attitude) = sensors::pose(&log, &cut, &mut warnings);
        sensors::changes_in_flight(
            [("position", position.len()), ("attitude", attitude.len())],
            &cut,
            &fault,
        )?;
        plausible_thrust(drive, dynamics, &inputs.in_flight(&cut), vehicle, &fault)?;
        let (gyro, accel) = sensors::inertial(&log, &cut, &mut warnings);
        let span_s = usable::trimmed(&cut.excluded, common_span(&position, &attitude, &inputs));
        long_enough(&cut, span_s, &name, drive)?;
        let gyro = sensors::enough_in(span_s, gyro, "angular velocity", &mut warnings);
        let accel = sensors::enough_in(span_s, accel, "specific force", &mut warnings);
        let mut noise = Noise::of(&options.noise, (&position, &attitude), (&gyro, &accel));
        let smoothing = inputs.smooth(drive, &mut noise);
        let load = objects::load(&log, options)?;
        let neighbours = objects::neighbours(&log, options, load.as_ref())?;
        let battery_in_commands = drive == Drive::RotorCommands && throttle::by_battery(&log, vehicle);
        let thrust_by_rotors = drive::thrust_by_rotors(&log, drive);
        let mut track = Self {
            name,
            drive,
            dynamics,
            span_s,
            noise,
            ground_z_m: Some(options.ground_z_m.unwrap_or(0.0)),
            ceiling_z_m: options.ceiling_z_m,
            neighbours,
            load,
            warnings,
            excluded: cut.excluded,
            inputs,
            battery_in_commands,
            thrust_by_rotors,
            smoothing,
            position,
            attitude,
            gyro,
            accel,
            log,
            contexts: Contexts::default(),
        };
        // A vehicle without these dynamics is refused later, where they are needed.
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

    /// Whether a time is excluded: the vehicle is on the ground, or crashes.
    pub(crate) fn is_excluded(&self, at_s: f64) -> bool {
        self.excluded.iter().any(|e| e.whole() && at_s >= e.from_s && at_s <= e.to_s)
    }

    /// The same log restricted to a span (s).
    pub fn cut(&self, span_s: [f64; 2]) -> Self {
        let [from, to] = self.span_s;
        let span_s = [span_s[0].max(from), span_s[1].min(to)];
        Self { span_s, contexts: Contexts::default(), ..self.clone() }
    }

    /// Distance from height `z_m` down to the ground, m.
    pub(crate) fn ground_distance_m(&self, z_m: f64) -> f64 {
        self.ground_z_m.map_or(NO_GROUND_M, |ground| z_m - ground)
    }

    /// Half widths of the local polynomials behind [`Track::measured_state`].
    pub(crate) fn windows(&self) -> Windows {
        let period = |c: &[f64]| resample::spacing_s(c).unwrap_or(0.01);
        let p_period = period(&self.position.t_s);
        // A parabola over T has the velocity noise σ √(12/n) / T; longer spans are biased by curvature. 60 ms each side at
        // 1 cm, 20 ms at best.
        let half = (0.02 * (self.noise.position_m / 3e-4).powf(0.3)).clamp(0.02, 0.08).max(3.2 * p_period);
        let a_half = 0.02f64.max(3.2 * period(&self.attitude.t_s));
        let wide = (0.02 * (self.noise.attitude_rad / 3e-3).powf(0.3)).clamp(0.02, 0.06);
        let rate =
            if self.gyro.is_empty() { wide.max(a_half) } else { 0.012f64.max(3.2 * period(&self.gyro.t_s)) };
        Windows { position_s: half, attitude_s: a_half, rate_s: rate }
    }

    /// State at a time, from local polynomials through the measurements: (position, attitude, velocity, body rate).
    pub(crate) fn measured_state(&self, at_s: &[f64]) -> Vec<Option<Measured>> {
        let windows = self.windows();
        at_s.par_chunks(1024).flat_map_iter(|at| self.measured_states(at, windows)).collect()
    }

    /// The same, serially.
    fn measured_states(&self, at_s: &[f64], windows: Windows) -> Vec<Option<Measured>> {
        let Windows { position_s, attitude_s: a_half, rate_s } = windows;
        let positions =
            widened(at_s, position_s, |at, half| resample::local_parabola(&self.position, at, half));
        let rates = (self.gyro.is_empty())
            .then(|| widened(at_s, rate_s, |at, half| resample::body_rates(&self.attitude, at, half)));
        let gyros = widened(at_s, rate_s, |at, half| resample::local_parabola(&self.gyro, at, half));
        let attitudes = widened(at_s, a_half, |at, half| {
            let (mut cursors, mut near) = ([Cursor::default(); 3], Channel::default());
            at.iter().map(|at| smooth_attitude(&self.attitude, *at, half, &mut cursors, &mut near)).collect()
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

/// The span in which pose and drive were both measured, s.
fn common_span(position: &Channel<3>, attitude: &Channel<4>, inputs: &Inputs) -> [f64; 2] {
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
    // The modelled motors and filters need time to forget their initial state.
    span[0] += SETTLE_S;
    span
}

/// Refuses a log with too little flight in the usable span.
fn long_enough(cut: &Unusable, span_s: [f64; 2], name: &str, drive: Drive) -> Result<(), GapError> {
    match usable::too_little(cut, span_s) {
        Some(found) => Err(GapError::TooShort {
            log: name.into(),
            expected: format!("at least {SHORTEST_S} s with pose and {}", drive.title()),
            found,
            remedy: "give a longer flight".into(),
        }),
        None => Ok(()),
    }
}

/// Factors by which local fits are widened where samples are too sparse, as between held values. Gaps are longer: 4.5 usual
/// steps.
const WIDER: [f64; 2] = [1.4, 2.0];

/// Local fits at times, widened where too few samples lie in reach.
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

/// Attitude at a time: a parabola of rotation vectors about the nearest sample, over `half_s` each side. `near` is scratch
/// space.
fn smooth_attitude(
    channel: &Channel<4>,
    at_s: f64,
    half_s: f64,
    cursors: &mut [Cursor; 3],
    near: &mut Channel<3>,
) -> Option<[f64; 4]> {
    let t = &channel.t_s;
    let from = cursors[0].seek(t, |x| x < at_s - half_s * (1.0 + 1e-6));
    let to = cursors[1].seek(t, |x| x <= at_s + half_s * (1.0 + 1e-6));
    if to < from + 4 {
        return None;
    }
    let base = channel.values[cursors[2].seek(t, |x| x < at_s).clamp(from, to - 1)];
    near.t_s.clear();
    near.values.clear();
    for i in from..to {
        near.push(t[i], resample::rotation_vector(quat::mul(quat::conjugate(base), channel.values[i])));
    }
    let local = resample::local_parabola(near, &[at_s], half_s)[0]?;
    Some(quat::mul(base, quat::exp(local.value)))
}
