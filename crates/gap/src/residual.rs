//! Residuals of a model: missing force and torque at every instant, errors of short roll-outs, and the part of both that
//! sensor noise alone explains.

mod instants;
mod rollouts;

use super::replay::{self, Around, Plant, Raw, STEP, Tick};
use super::track::{Drive, Measured, Track, noise_of};
use propwash_flight::{Channel, resample};
use propwash_physics::drone::Drone;
use propwash_physics::rigid_body::{Rate, State};
use propwash_trace::math::{quat, vec3};
use rayon::prelude::*;

pub(crate) use rollouts::{expected_errors, replay_errors};

/// A model with its inputs along a log.
pub(crate) struct Replay<'a> {
    pub track: &'a Track,
    pub raw: &'a Raw,
    pub drone: &'a Drone<f64>,
    /// The context of the log, with the measured states corrected by the modelled sensor errors.
    pub around: Around,
    pub ticks: Vec<Tick<f64>>,
}

impl<'a> Replay<'a> {
    pub fn new(track: &'a Track, around: &Around, raw: &'a Raw, drone: &'a Drone<f64>) -> Self {
        let around = Around { measured: believed(track, around, drone), ..around.clone() };
        let ticks = replay::drive(track, &around, raw, drone);
        Self { track, raw, drone, around, ticks }
    }

    pub fn plant(&self) -> Plant<'_, f64> {
        Plant::new(self.drone, self.track, &self.around)
    }

    /// Number of instants, [`STEP_S`] apart.
    pub fn n_steps(&self) -> usize {
        self.around.measured.len()
    }

    /// Time of an instant, s.
    pub fn time_s(&self, step: usize) -> f64 {
        self.around.time_s(step * STEP)
    }

    /// The measured state of an instant at which the inputs are known too.
    pub(super) fn known(&self, step: usize) -> Option<&Measured> {
        let valid = self.raw.valid.get(step * STEP).copied().unwrap_or(false);
        self.around.measured[step].as_ref().filter(|_| valid)
    }

    /// The measured state of an instant from which on the inputs are known for so many instants: where a roll-out can start.
    pub(super) fn start(&self, step: usize, steps: usize) -> Option<&Measured> {
        let valid = |k: usize| self.raw.valid.get(k).copied().unwrap_or(false);
        let start = self.around.measured.get(step)?.as_ref()?;
        (step * STEP..=(step + steps) * STEP).all(valid).then_some(start)
    }
}

fn state_of(m: &Measured) -> State<f64> {
    State { pos: m.pos, quat: m.quat, vel: m.vel, ang_vel: m.ang_vel, ..State::rest() }
}

/// The states of the vehicle if its sensors and clocks are as modelled.
pub(crate) fn believed(track: &Track, around: &Around, drone: &Drone<f64>) -> Vec<Option<Measured>> {
    if drone.effects.is_empty() {
        return around.measured.clone();
    }
    let clock = replay::clock(track, drone);
    let rate_s = if track.gyro.is_empty() { clock.pose_s } else { clock.gyro_s };
    let later = |by_s: f64| {
        (by_s != 0.0).then(|| {
            let at: Vec<f64> = (0..around.measured.len()).map(|i| around.time_s(i * STEP) + by_s).collect();
            track.measured_state(&at)
        })
    };
    let (poses, rates) = (later(clock.pose_s), later(rate_s));
    (0..around.measured.len())
        .into_par_iter()
        .with_min_len(256)
        .map(|i| {
            around.measured[i]?;
            let pose = poses.as_ref().unwrap_or(&around.measured)[i]?;
            let rate = rates.as_ref().unwrap_or(&around.measured)[i]?;
            Some(true_state(drone, &Measured { ang_vel: rate.ang_vel, ..pose }))
        })
        .collect()
}

/// The state at which the modelled sensors read `read`, by fixed-point iteration: sensor errors are small.
fn true_state(drone: &Drone<f64>, read: &Measured) -> Measured {
    let mut out = *read;
    for _ in 0..5 {
        let rate = Rate { vel: out.vel, ang_vel: out.ang_vel, ..Rate::zero() };
        let got = drone.read(&state_of(&out), &rate);
        let turn = resample::rotation_vector(quat::mul(quat::conjugate(got.quat), read.quat));
        let mut off = vec3::norm(turn);
        for k in 0..3 {
            let d = [read.pos[k] - got.pos[k], read.vel[k] - got.vel[k], read.ang_vel[k] - got.gyro[k]];
            out.pos[k] += d[0];
            out.vel[k] += d[1];
            out.ang_vel[k] += d[2];
            off += d.iter().map(|x| x.abs()).sum::<f64>();
        }
        if off < 1e-12 {
            break;
        }
        out.quat = quat::normalize(quat::mul(out.quat, quat::exp(turn)));
    }
    out
}

/// Standard deviations of a measured state, per axis.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StateNoise {
    pub pos_m: f64,
    pub vel_m_s: f64,
    pub att_rad: f64,
    pub rate_rad_s: f64,
}

/// Median gains (value, slope, second derivative) of local parabolas of half width `half_s` through samples at `t_s`.
fn gains(t_s: &[f64], half_s: f64, span_s: [f64; 2]) -> [f64; 3] {
    let blank = Channel::<1>::new(t_s.to_vec(), vec![[0.0]; t_s.len()]);
    let at: Vec<f64> = (1..40).map(|i| span_s[0] + (span_s[1] - span_s[0]) * i as f64 / 40.0).collect();
    let local: Vec<_> = resample::local_parabola(&blank, &at, half_s).into_iter().flatten().collect();
    let median = |list: Vec<f64>| propwash_flight::clean::median(list).unwrap_or(1.0);
    [
        median(local.iter().map(|l| l.value_gain).collect()),
        median(local.iter().map(|l| l.slope_gain).collect()),
        median(local.iter().map(|l| l.curvature_gain).collect()),
    ]
}

impl StateNoise {
    pub fn of(track: &Track) -> Self {
        let (windows, noise) = (track.windows(), &track.noise);
        let pose = gains(&track.position.t_s, windows.position_s, track.span_s);
        let att = gains(&track.attitude.t_s, windows.attitude_s, track.span_s);
        let rate_rad_s = if track.gyro.is_empty() {
            noise.attitude_rad * gains(&track.attitude.t_s, windows.rate_s, track.span_s)[1]
        } else {
            noise.gyro_rad_s * gains(&track.gyro.t_s, windows.rate_s, track.span_s)[0]
        };
        Self {
            pos_m: noise.position_m * pose[0],
            vel_m_s: noise.position_m * pose[1],
            att_rad: noise.attitude_rad * att[0],
            rate_rad_s,
        }
    }

    /// The state perturbed by one standard deviation of component `which` (0 to 11: position, velocity, attitude, rate).
    fn moved(&self, m: &Measured, which: usize) -> Measured {
        let mut out = *m;
        let axis = which % 3;
        match which / 3 {
            0 => out.pos[axis] += self.pos_m,
            1 => out.vel[axis] += self.vel_m_s,
            2 => {
                let mut turn = [0.0; 3];
                turn[axis] = self.att_rad;
                out.quat = quat::mul(out.quat, quat::exp(turn));
            }
            _ => out.ang_vel[axis] += self.rate_rad_s,
        }
        out
    }
}

/// Residuals at one instant.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sample {
    pub step: usize,
    /// Force that the model lacks, N, body.
    pub force_n: [f64; 3],
    /// Measured force without gravity, N, body.
    pub measured_force_n: [f64; 3],
    /// Torque that the model lacks, N·m, body.
    pub torque_n_m: Option<[f64; 3]>,
    /// Measured torque, N·m, body.
    pub measured_torque_n_m: Option<[f64; 3]>,
    pub quat: [f64; 4],
}

/// Residuals along a log.
#[derive(Clone, Debug)]
pub(crate) struct Residuals {
    pub samples: Vec<Sample>,
    /// Whether forces come from the accelerometer; otherwise from poses.
    pub from_accelerometer: bool,
    /// Whether torques come from the gyroscope; otherwise from attitudes.
    pub from_gyroscope: bool,
    /// Half widths of the local fits, s.
    pub force_half_s: f64,
    pub torque_half_s: f64,
    /// Standard deviation of a sample due to sensor noise: force (N, body axes), torque (N·m).
    pub force_sigma_n: [f64; 3],
    pub torque_sigma_n_m: [f64; 3],
    /// Correlation time of the noise of neighbouring samples, s.
    pub force_memory_s: f64,
    pub torque_memory_s: f64,
}

/// Noise of the input: standard deviation of one sample of rotor speeds (rad/s) or thrust (N), with its period (s).
fn input_noise(track: &Track) -> Option<(f64, f64)> {
    let period = |c: &Channel<1>| c.period_s().unwrap_or(0.01);
    match track.drive {
        Drive::RotorSpeeds => {
            let n = track.inputs.rotors.len().max(1) as f64;
            // The noise removed by smoothing also indicates the slow noise that remains.
            let known = track.noise.rotor_rad_s;
            let each = |c: &Channel<1>| known.unwrap_or_else(|| noise_of(c));
            let square: f64 = track.inputs.rotors.iter().map(|c| each(c).powi(2)).sum();
            Some(((square / n).sqrt(), period(track.inputs.rotors.first()?)))
        }
        Drive::Thrust => {
            let sigma = track.noise.thrust_n.unwrap_or_else(|| noise_of(&track.inputs.thrust));
            Some((sigma, period(&track.inputs.thrust)))
        }
        Drive::RotorCommands | Drive::AttitudeCommands => None,
    }
}
