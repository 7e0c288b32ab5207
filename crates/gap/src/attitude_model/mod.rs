//! Identifies the abstracted attitude model ([`propwash_physics::attitude_response`]) from a flight log.
//!
//! Start values come from equation error behind a state-variable filter. Output error follows: roll-outs in short windows,
//! first of the attitude (gains and command delay), then of position and velocity along the measured attitude (thrust
//! offset, scale and lag, linear drag, command delay), with exact derivatives by dual numbers. All formulas are those of
//! `physics`. `docs/identify.md` explains the parameters and what a log must contain.
//!
//! Sources: the model and the three steps are those of Crazyflow 0.4.0 (`dynamics/utils/identification.py`); windowed
//! output error with eliminated nuisance parameters is Bock's multiple shooting (1981); delay as a parameter, intervals and
//! random disturbances are added here.

mod apply;
mod commands;
mod error;
mod judge;
mod outcome;
mod report;
mod rotation;
mod solve;
mod start;
mod translation;

pub use error::AttitudeModelError;
pub use report::{ChannelFit, Estimate, Identification};

use commands::Commands;
use nalgebra::SVector;
use propwash_flight::resample::rotation_vector;
use propwash_flight::{Channel, FlightLog, clean};
use propwash_physics::drone::{Drone, Dynamics};
use propwash_physics::effects::{AnyEffect, linear_drag};
use propwash_trace::math::{euler, quat};
use propwash_vehicle::schema::Response;
use propwash_vehicle::{DYNAMICS, Vehicle};
use rotation::Rotation;
use solve::Fit;
use std::path::Path;
use std::sync::Arc;
use translation::{Along, Channels, Translation};

/// Names of the axes.
const AXES: [&str; 3] = ["roll", "pitch", "yaw"];
/// Normal quantile of a 95 % interval.
const Z95: f64 = 1.959_963_984_540_054;
/// Length of the windows, s.
const ROTATION_WINDOW_S: f64 = 2.0;
const TRANSLATION_WINDOW_S: f64 = 1.0;
/// Highest sample rate used in the fit, Hz; a higher one costs time and adds no information.
const MOST_HZ: f64 = 260.0;
/// Least spread of a command (rad) that counts as excitation at all.
const LEAST_SPREAD_RAD: f64 = 0.005;
/// Time after the first command that is not fitted, s.
const UNKNOWN_START_S: f64 = 0.6;
/// A gain whose relative standard deviation exceeds this is not identified.
const MOST_SHARE: f64 = 0.25;

/// What to identify.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// `so_rpy`, `so_rpy_rotor` (with thrust lag) or `so_rpy_rotor_drag` (with lag and drag).
    pub dynamics: String,
}

impl Default for Options {
    fn default() -> Self {
        Self { dynamics: DYNAMICS[3].into() }
    }
}

/// Identifies the model of `vehicle` from `log`. The mass is the vehicle file's.
/// Refuses a name for the vehicle file that would not be read as one.
///
/// # Errors
/// [`AttitudeModelError::Out`].
pub fn check_out(out: &Path) -> Result<(), AttitudeModelError> {
    match out.extension() {
        Some(end) if end == "toml" => Ok(()),
        _ => Err(AttitudeModelError::Out { path: out.into() }),
    }
}

/// Identifies the model of `vehicle` from `log`. The mass is taken from the vehicle file.
///
/// # Errors
/// [`AttitudeModelError`]: channels are missing, the flight is too short, an axis was not excited and the file has no
/// values to hold it at, or the model does not describe the log.
pub fn identify(
    log: &FlightLog,
    vehicle: &Vehicle,
    options: &Options,
) -> Result<Identification, AttitudeModelError> {
    let job = Job::new(log, vehicle, &options.dynamics)?;
    job.run()
}

/// One identification.
struct Job<'a> {
    log: &'a FlightLog,
    vehicle: &'a Vehicle,
    dynamics: &'static str,
    commands: Arc<Commands>,
    channels: Channels,
    gyro: Channel<3>,
    /// Fitted drone: linear drag first, no delay.
    drone: Drone<f64>,
    /// Nominal response in the file, of these or of other dynamics.
    filed: Option<(Response, String)>,
    /// Nominal drag of these dynamics (x, y, z), N·s/m.
    filed_drag: [f64; 3],
    warnings: Vec<String>,
}

type RotationalFit = Fit<{ rotation::SHARED }, { rotation::OWN }>;
type TranslationalFit = Fit<{ translation::SHARED }, { translation::OWN }>;

/// The fitted rotational part.
struct Rotated {
    fit: RotationalFit,
    held: [Option<String>; 3],
    windows: usize,
}

impl<'a> Job<'a> {
    fn new(log: &'a FlightLog, vehicle: &'a Vehicle, dynamics: &str) -> Result<Self, AttitudeModelError> {
        let dynamics = DYNAMICS[1..]
            .iter()
            .find(|d| **d == dynamics)
            .ok_or_else(|| AttitudeModelError::Dynamics { name: dynamics.into() })?;
        let lacks = |what: &str, columns: &str, remedy: &str| AttitudeModelError::Log {
            path: log.path.clone(),
            expected: format!("{what} ({columns})"),
            found: "none".into(),
            remedy: remedy.into(),
        };
        if log.cmd_attitude_rad.is_empty() {
            let remedy = "the attitude model answers attitude commands; log them, or name their columns in a mapping file";
            return Err(lacks("attitude commands", "cmd_roll cmd_pitch cmd_yaw", remedy));
        }
        if log.cmd_thrust_n.is_empty() {
            let remedy =
                "log the commanded collective thrust in N, or name its column and unit in a mapping file";
            return Err(lacks("thrust commands", "cmd_thrust", remedy));
        }
        if log.attitude.is_empty() {
            return Err(lacks("attitudes", "qx qy qz qw", "log the measured attitude"));
        }
        if log.position_m.is_empty() {
            return Err(lacks("positions", "px py pz", "log the measured position"));
        }
        let finite = log.attitude.values.iter().flatten().all(|v| v.is_finite())
            && log.position_m.values.iter().flatten().all(|v| v.is_finite())
            && log.cmd_attitude_rad.values.iter().flatten().all(|v| v.is_finite())
            && log.cmd_thrust_n.values.iter().flatten().all(|v| v.is_finite());
        let ordered = log.attitude.is_ordered()
            && log.position_m.is_ordered()
            && log.velocity_m_s.is_ordered()
            && log.angular_velocity_rad_s.is_ordered()
            && log.specific_force_m_s2.is_ordered()
            && log.cmd_attitude_rad.is_ordered()
            && log.cmd_thrust_n.is_ordered();
        if !finite || !ordered {
            return Err(AttitudeModelError::Log {
                path: log.path.clone(),
                expected: "finite values at rising times".into(),
                found: if finite { "times that do not rise" } else { "values that are no finite numbers" }
                    .into(),
                remedy: "see `propwash log check`".into(),
            });
        }
        let mut warnings = Vec::new();
        let (drone, filed, filed_drag) = prepare(vehicle, dynamics, &mut warnings)?;
        let channels = Channels {
            attitude: thin(&log.attitude, "attitude", &mut warnings),
            position: thin(&log.position_m, "position", &mut warnings),
            velocity: thin(&log.velocity_m_s, "velocity", &mut warnings),
            accelerometer: thin(&log.specific_force_m_s2, "accelerometer", &mut warnings),
        };
        let gyro = thin(&log.angular_velocity_rad_s, "gyro", &mut warnings);
        let commands = Arc::new(Commands::new(&log.cmd_attitude_rad, &log.cmd_thrust_n));
        Ok(Self { log, vehicle, dynamics, commands, channels, gyro, drone, filed, filed_drag, warnings })
    }

    fn run(mut self) -> Result<Identification, AttitudeModelError> {
        let rotation_spans = self.spans(ROTATION_WINDOW_S, true)?;
        let translation_spans = self.spans(TRANSLATION_WINDOW_S, false)?;
        let gap = self.longest_gap_s();
        let start = start::Grid::new(&self.channels.attitude, &self.commands, gap);
        let (gains, delay_s) = start.rotation(&self.commands);
        let rotated = self.rotation(gains, delay_s, &rotation_spans)?;
        self.report(&start, rotated, &translation_spans)
    }

    fn longest_gap_s(&self) -> f64 {
        (5.0 * self.channels.attitude.period_s().unwrap_or(0.01)).max(0.05)
    }

    /// Windows of `length_s` in the parts of the log that the model can describe.
    fn spans(&mut self, length_s: f64, say: bool) -> Result<Vec<(f64, f64)>, AttitudeModelError> {
        let attitude = &self.channels.attitude;
        let gap = self.longest_gap_s();
        // The command in force before the first logged one is unknown; by this time its effect has decayed.
        let from = self.commands.t_s[0] + UNKNOWN_START_S;
        let mut stretches: Vec<(usize, usize)> = Vec::new();
        for i in 0..attitude.len() {
            if attitude.t_s[i] < from {
                continue;
            }
            match stretches.last_mut() {
                Some((_, last)) if *last + 1 == i && attitude.t_s[i] - attitude.t_s[*last] <= gap => {
                    *last = i
                }
                _ => stretches.push((i, i)),
            }
        }
        let weight_n = self.drone.hover_thrust();
        let mut out = Vec::new();
        let mut left_out = [0_usize; 2];
        for (a, b) in stretches {
            let (start, end) = (attitude.t_s[a], attitude.t_s[b]);
            let n = ((end - start) / length_s + 1e-6).floor() as usize;
            for k in 0..n {
                let span = (start + k as f64 * length_s, start + (k + 1) as f64 * length_s);
                let inside = attitude.between(span.0, span.1);
                if inside.len() < 8 || self.channels.position.between(span.0, span.1).len() < 8 {
                    left_out[0] += usize::from(inside.len() >= 8);
                    continue;
                }
                // Roll, pitch and yaw, in which the model is written, jump near these angles.
                let beyond = inside.values.iter().any(|q| {
                    let rpy = euler::from_quat(quat::normalize(*q));
                    rpy[1].abs() > 1.4 || rpy[0].abs() > 2.9 || rpy[2].abs() > 2.9
                });
                let thrust: Vec<f64> =
                    inside.t_s.iter().step_by(4).map(|t| self.commands.at(*t)[3]).collect();
                let mean = thrust.iter().sum::<f64>() / thrust.len() as f64;
                if beyond {
                    left_out[0] += 1;
                } else if mean < 0.3 * weight_n {
                    left_out[1] += 1;
                } else {
                    out.push(span);
                }
            }
        }
        if say {
            if left_out[0] > 0 {
                self.warnings.push(format!(
                    "{} windows of {length_s} s are left out: positions are missing there, or the vehicle pitches beyond 80° or \
                     comes near ±180° of roll or yaw, where roll, pitch and yaw jump",
                    left_out[0]
                ));
            }
            if left_out[1] > 0 {
                self.warnings.push(format!(
                    "{} windows of {length_s} s are left out: the commanded thrust there is below 30 % of the weight, as on the ground",
                    left_out[1]
                ));
            }
        }
        let seconds = out.len() as f64 * length_s;
        if seconds < 8.0 {
            return Err(AttitudeModelError::Log {
                path: self.log.path.clone(),
                expected: "at least 8 s of flight with commands, attitude and position together".into(),
                found: format!(
                    "{seconds} s of use ({:.1} s in the log; {} windows without positions or beyond the angles that the model knows, \
                     {} with less than 30 % of the weight as thrust)",
                    self.log.duration_s, left_out[0], left_out[1]
                ),
                remedy: "fly longer (30 to 60 s), and check the unit of cmd_thrust (N) and the mass".into(),
            });
        }
        Ok(out)
    }

    /// Spread of a command (standard deviation) over the spans.
    fn spread(&self, k: usize, spans: &[(f64, f64)]) -> (f64, f64) {
        let mut values = Vec::new();
        for (a, b) in spans {
            let n = ((b - a) / 0.01) as usize;
            values.extend((0..n).map(|i| self.commands.at(a + i as f64 * 0.01)[k]));
        }
        let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
        let square = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len().max(1) as f64;
        (square.sqrt(), mean)
    }

    /// The rotational fit: gains and delay by the attitude alone.
    fn rotation(
        &mut self,
        mut gains: [f64; 9],
        delay_s: f64,
        spans: &[(f64, f64)],
    ) -> Result<Rotated, AttitudeModelError> {
        let mut held = self.held_axes(&mut gains, spans)?;
        let (drone, commands) = (self.drone.clone(), self.commands.clone());
        let (problem, own) =
            Rotation::new(self.log, &commands, &drone, &self.channels.attitude, &self.gyro, spans);
        let mut fit = self.rotational_start(&gains, delay_s, &held, own);
        fit.run(&problem, 30, rotational_share);
        self.hold_undecided(&mut fit, &problem, &mut held)?;
        if held.iter().all(Option::is_some) {
            return Err(AttitudeModelError::Unfit {
                path: self.log.path.clone(),
                reason: "no axis was excited enough".into(),
                remedy: "fly steps or a multi-sine of several degrees in roll, pitch and yaw".into(),
            });
        }
        let places = problem.windows.iter().map(|w| (w.from_s, w.to_s)).collect();
        if self.leave_out_odd(&mut fit, places, "attitude") {
            fit.run(&problem, 20, rotational_share);
        }
        self.answers_stably(&fit, &held)?;
        if !fit.converged {
            self.warnings.push("the rotational fit did not settle; take its values with doubt".into());
        }
        let windows = fit.used.iter().filter(|u| **u).count();
        Ok(Rotated { windows, fit, held })
    }

    /// Holds axes whose commands hardly move at the nominal gains, and says where those come from; makes the gains of the
    /// others a valid start for a fit.
    fn held_axes(
        &mut self,
        gains: &mut [f64; 9],
        spans: &[(f64, f64)],
    ) -> Result<[Option<String>; 3], AttitudeModelError> {
        let mut held: [Option<String>; 3] = [None, None, None];
        for k in 0..3 {
            let (spread, _) = self.spread(k, spans);
            if spread < LEAST_SPREAD_RAD {
                let found = format!(
                    "its command varies by {:.2}° (standard deviation), {:.1}° are needed at least",
                    spread.to_degrees(),
                    LEAST_SPREAD_RAD.to_degrees()
                );
                held[k] = Some(self.hold(k, gains, found)?);
                continue;
            }
            if gains[6 + k] < 0.0 && gains[k] < 0.0 && gains[3 + k] < 0.0 {
                return Err(AttitudeModelError::Unfit {
                    path: self.log.path.clone(),
                    reason: format!(
                        "commanded and measured {} move against each other (command gain {:.0} 1/s²)",
                        AXES[k],
                        gains[6 + k]
                    ),
                    remedy: format!("give the sign of cmd_{} in a mapping file (`scale = -1`)", AXES[k]),
                });
            }
            // Start from a stable response, whatever the regression found.
            if !(gains[k] < -1.0) || !(gains[3 + k] < -0.5) || !(gains[6 + k] > 1.0) {
                let values = self.filed_gains(k).unwrap_or([-100.0, -15.0, 100.0]);
                for g in 0..3 {
                    gains[3 * g + k] = values[g];
                }
            }
        }
        Ok(held)
    }

    /// The rotational fit before its first iteration.
    fn rotational_start(
        &self,
        gains: &[f64; 9],
        delay_s: f64,
        held: &[Option<String>; 3],
        own: Vec<[f64; rotation::OWN]>,
    ) -> RotationalFit {
        let mut shared = [0.0; rotation::SHARED];
        shared[..9].copy_from_slice(gains);
        shared[rotation::DELAY] = delay_s;
        let mut free = [true; rotation::SHARED];
        free[rotation::BIAS..].fill(!self.gyro.is_empty());
        for k in (0..3).filter(|k| held[*k].is_some()) {
            (0..3).for_each(|g| free[3 * g + k] = false);
        }
        let mut own_sigma = [f64::INFINITY; rotation::OWN];
        own_sigma[6..].fill(0.02);
        let mut fit = Fit::new(shared, free, own, own_sigma);
        fit.sigma[..3].fill(3e-3);
        fit.sigma[rotation::GYRO..].fill(0.05);
        fit
    }

    /// Holds an axis whose gains the log does not determine, and fits the rest again.
    fn hold_undecided(
        &mut self,
        fit: &mut RotationalFit,
        problem: &Rotation,
        held: &mut [Option<String>; 3],
    ) -> Result<(), AttitudeModelError> {
        loop {
            let doubtful = (0..3).find(|k| {
                held[*k].is_none()
                    && (0..3).any(|g| {
                        let i = 3 * g + k;
                        !(fit.sigma_of(i) <= MOST_SHARE * fit.shared[i].abs())
                    })
            });
            let Some(k) = doubtful else { return Ok(()) };
            let worst =
                (0..3).map(|g| fit.sigma_of(3 * g + k) / fit.shared[3 * g + k].abs()).fold(0.0, f64::max);
            let found = format!("its gains stay uncertain by {:.0} % (standard deviation)", worst * 100.0);
            let mut gains: [f64; 9] = std::array::from_fn(|i| fit.shared[i]);
            held[k] = Some(self.hold(k, &mut gains, found)?);
            fit.shared[..9].copy_from_slice(&gains);
            (0..3).for_each(|g| fit.free[3 * g + k] = false);
            fit.run(problem, 20, rotational_share);
        }
    }

    /// Refuses fitted gains for which an axis is unstable.
    fn answers_stably(
        &self,
        fit: &RotationalFit,
        held: &[Option<String>; 3],
    ) -> Result<(), AttitudeModelError> {
        for k in (0..3).filter(|k| held[*k].is_none()) {
            if fit.shared[k] > 0.0 || fit.shared[3 + k] > 0.0 || fit.shared[6 + k] < 0.0 {
                return Err(AttitudeModelError::Unfit {
                    path: self.log.path.clone(),
                    reason: format!(
                        "the gains of {} are {:.1} 1/s², {:.2} 1/s and {:.1} 1/s², which is no stable answer to a command",
                        AXES[k],
                        fit.shared[k],
                        fit.shared[3 + k],
                        fit.shared[6 + k]
                    ),
                    remedy: "check names, signs and units of the commanded angles with `propwash log check`"
                        .into(),
                });
            }
        }
        Ok(())
    }

    /// Excludes windows that fit far worse than the rest; returns whether there are any.
    fn leave_out_odd<const G: usize, const L: usize>(
        &mut self,
        fit: &mut Fit<G, L>,
        spans: Vec<(f64, f64)>,
        what: &str,
    ) -> bool {
        let Some(middle) = clean::median(fit.window_misfit.clone()) else { return false };
        let odd: Vec<usize> =
            (0..spans.len()).filter(|w| fit.window_misfit[*w] > 25.0 * middle.max(1e-2)).collect();
        if odd.is_empty() {
            return false;
        }
        if odd.len() * 4 > spans.len() {
            self.warnings.push(format!(
                "{} of {} windows fit the {what} far worse than the others; none was left out",
                odd.len(),
                spans.len()
            ));
            return false;
        }
        let places: Vec<String> = odd.iter().take(5).map(|w| format!("{:.1} s", spans[*w].0)).collect();
        let more = if odd.len() > 5 { ", …" } else { "" };
        self.warnings.push(format!(
            "{} of {} windows were left out of the {what}: they fit five times worse than the others (from {}{more}); the model \
             does not do what the vehicle does there: a turn harder than its, a collision, a hand or a tracking fault",
            odd.len(),
            spans.len(),
            places.join(", ")
        ));
        for w in odd {
            fit.used[w] = false;
        }
        true
    }

    /// Nominal angle, rate and command gain of an axis.
    fn filed_gains(&self, k: usize) -> Option<[f64; 3]> {
        self.filed
            .as_ref()
            .map(|(r, _)| [r.angle_gain_per_s2[k], r.rate_gain_per_s[k], r.command_gain_per_s2[k]])
    }

    /// Sets the gains of an axis to the nominal ones and says so.
    fn hold(&mut self, k: usize, gains: &mut [f64; 9], found: String) -> Result<String, AttitudeModelError> {
        let (Some(values), Some((_, from))) = (self.filed_gains(k), &self.filed) else {
            return Err(AttitudeModelError::NotExcited { path: self.log.path.clone(), axis: AXES[k], found });
        };
        for g in 0..3 {
            gains[3 * g + k] = values[g];
        }
        let axis = AXES[k];
        self.warnings.push(format!(
            "{axis} was not excited enough ({found}): its gains are held at those of [attitude_response.{from}] in the vehicle file; \
             fly steps or a multi-sine of several degrees in {axis} to identify them"
        ));
        Ok(format!("[attitude_response.{from}] of the vehicle file"))
    }
}

/// Step length of the rotational fit, as a share of the full step.
fn rotational_share(from: &[f64; rotation::SHARED], step: &SVector<f64, { rotation::SHARED }>) -> f64 {
    let mut share: f64 = 1.0;
    for k in 0..9 {
        // No gain more than halves or doubles in one step.
        if step[k] != 0.0 {
            share = share.min(0.5 * from[k].abs() / step[k].abs());
        }
    }
    let delay = step[rotation::DELAY].abs();
    if delay > 0.02 { share.min(0.02 / delay) } else { share }
}

/// The drone to fit, with linear drag as its first effect; the nominal response and drag.
#[allow(clippy::type_complexity)]
fn prepare(
    vehicle: &Vehicle,
    dynamics: &'static str,
    warnings: &mut Vec<String>,
) -> Result<(Drone<f64>, Option<(Response, String)>, [f64; 3]), AttitudeModelError> {
    let responses = &vehicle.file().attitude_response;
    let all = [
        (&responses.so_rpy, DYNAMICS[1]),
        (&responses.so_rpy_rotor, DYNAMICS[2]),
        (&responses.so_rpy_rotor_drag, DYNAMICS[3]),
    ];
    let own = all.iter().find(|(r, name)| *name == dynamics && r.is_some());
    let any = own.or(all.iter().rev().find(|(r, _)| r.is_some()));
    let filed = any.and_then(|(r, name)| r.as_ref().map(|r| (r.clone(), (*name).to_string())));
    let lags = dynamics != DYNAMICS[1];
    let mut template = filed.as_ref().map(|(r, _)| r.clone()).unwrap_or(Response {
        thrust_offset_n: 0.0,
        thrust_scale: 1.0,
        thrust_rate_per_s: None,
        angle_gain_per_s2: [-100.0; 3],
        rate_gain_per_s: [-15.0; 3],
        command_gain_per_s2: [100.0; 3],
        source: None,
        note: None,
        sigma: Default::default(),
    });
    template.thrust_rate_per_s = lags.then(|| template.thrust_rate_per_s.unwrap_or(15.0));
    template.sigma.clear();
    let mut file = vehicle.file().clone();
    *apply::response_mut(&mut file.attitude_response, dynamics) = Some(template);
    let mut drone = Vehicle::from_file(&vehicle.name, file)?.drone(dynamics)?;
    let mut filed_drag = [0.0; 3];
    let mut ignored = Vec::new();
    drone.effects.retain(|effect| match effect {
        AnyEffect::LinearDrag(p) => {
            filed_drag = std::array::from_fn(|k| p.drag_n_s_per_m[k][k]);
            false
        }
        AnyEffect::CommandDelay(_) => false,
        AnyEffect::ActuatorSaturation(_) | AnyEffect::BatterySag(_) => {
            ignored.push(effect.kind());
            false
        }
        _ => true,
    });
    if !ignored.is_empty() {
        warnings.push(format!(
            "the vehicle's {} change commands on their way and are left out of the fit",
            ignored.join(" and ")
        ));
    }
    let drag = linear_drag::Params { drag_n_s_per_m: [[0.0; 3]; 3] };
    drone.effects.insert(0, AnyEffect::LinearDrag(drag));
    if let Dynamics::AttitudeResponse(p) = &mut drone.dynamics {
        p.thrust_dynamics = lags;
    }
    Ok((drone, filed, filed_drag))
}

/// Every n-th sample, so that the rate is at most [`MOST_HZ`].
fn thin<const N: usize>(channel: &Channel<N>, name: &str, warnings: &mut Vec<String>) -> Channel<N> {
    let rate = channel.period_s().map_or(0.0, |p| 1.0 / p);
    let every = (rate / MOST_HZ).ceil().max(1.0) as usize;
    if every == 1 {
        return channel.clone();
    }
    warnings.push(format!(
        "of the {name} at {rate:.0} Hz every {every}th sample is used; {MOST_HZ} Hz are enough for this model"
    ));
    Channel::new(
        channel.t_s.iter().copied().step_by(every).collect(),
        channel.values.iter().copied().step_by(every).collect(),
    )
}

/// Standard deviation of the white part of a signal given by its first differences, from their fourth differences: the norm
/// of the fifth difference of white noise is √252.
fn white_noise(first_differences: &[f64]) -> Option<f64> {
    let fifth: Vec<f64> =
        first_differences.windows(5).map(|d| d[0] - 4.0 * d[1] + 6.0 * d[2] - 4.0 * d[3] + d[4]).collect();
    clean::robust_sigma(&fifth).map(|s| s / 252.0_f64.sqrt())
}

fn channel_noise(channel: &Channel<3>) -> [Option<f64>; 3] {
    std::array::from_fn(|k| {
        let steps: Vec<f64> = channel.values.windows(2).map(|v| v[1][k] - v[0][k]).collect();
        white_noise(&steps)
    })
}

fn attitude_noise(channel: &Channel<4>) -> [Option<f64>; 3] {
    let turns: Vec<[f64; 3]> = channel
        .values
        .windows(2)
        .map(|q| rotation_vector(quat::mul(quat::conjugate(quat::normalize(q[0])), quat::normalize(q[1]))))
        .collect();
    std::array::from_fn(|k| white_noise(&turns.iter().map(|t| t[k]).collect::<Vec<_>>()))
}
