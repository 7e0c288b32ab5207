//! What a model leaves of a measurement: force and torque instant by instant, errors of short roll-outs, and how much of
//! both the noise of the sensors alone would make.

use super::replay::{self, Around, Plant, Point, Raw, STEP, STEP_S, TICK_S, Tick};
use super::track::{Drive, Measured, Track, noise_of};
use super::verdict::HorizonError;
use crate::flight::{Channel, resample};
use crate::math::{quat, vec3};
use crate::physics::drone::Drone;
use crate::physics::rigid_body::{self, Rate, State};
use crate::random::{Key, purpose};
use rayon::prelude::*;

/// Steps between the starts of roll-outs: 0.1 s.
const START_EVERY: usize = 20;
/// Starts from which the effect of the sensors' noise is computed.
const NOISE_STARTS: usize = 16;

/// A model driven along a log.
pub(crate) struct Replay<'a> {
    pub track: &'a Track,
    pub raw: &'a Raw,
    pub drone: &'a Drone<f64>,
    /// The world around the vehicle, with the states that the model's sensors say the vehicle had.
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
}

fn state_of(m: &Measured) -> State<f64> {
    State { pos: m.pos, quat: m.quat, vel: m.vel, ang_vel: m.ang_vel, ..State::rest() }
}

/// The states that the vehicle had if its sensors and their clocks are as the model says.
pub(crate) fn believed(track: &Track, around: &Around, drone: &Drone<f64>) -> Vec<Option<Measured>> {
    if drone.effects.is_empty() {
        return around.measured.clone();
    }
    let clock = drone.clock();
    let rate_s = if track.gyro.is_empty() { clock.pose_s } else { clock.gyro_s };
    let later = |by_s: f64| {
        (by_s != 0.0).then(|| {
            let at: Vec<f64> = (0..around.measured.len()).map(|i| around.time_s(i * STEP) + by_s).collect();
            track.measured_state(&at)
        })
    };
    let (poses, rates) = (later(clock.pose_s), later(rate_s));
    (0..around.measured.len())
        .map(|i| {
            around.measured[i]?;
            let pose = poses.as_ref().unwrap_or(&around.measured)[i]?;
            let rate = rates.as_ref().unwrap_or(&around.measured)[i]?;
            Some(true_state(drone, &Measured { ang_vel: rate.ang_vel, ..pose }))
        })
        .collect()
}

/// The state in which the model's sensors read `read`, by fixed-point iteration: sensors are nearly ideal.
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
    let median = |list: Vec<f64>| crate::flight::clean::median(list).unwrap_or(1.0);
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

    /// The state moved by one standard deviation of number `which` (0 to 11: position, velocity, attitude, rate).
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

/// What the model leaves at one instant.
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

/// What the model leaves along a log.
#[derive(Clone, Debug)]
pub(crate) struct Residuals {
    pub samples: Vec<Sample>,
    /// Whether forces come from the accelerometer, or else from poses.
    pub from_accelerometer: bool,
    /// Whether torques come from the gyroscope, or else from attitudes.
    pub from_gyroscope: bool,
    /// Half widths of the local fits, s.
    pub force_half_s: f64,
    pub torque_half_s: f64,
    /// Standard deviation of a sample by the sensors' noise: force (N, body axes), torque (N·m).
    pub force_sigma_n: [f64; 3],
    pub torque_sigma_n_m: [f64; 3],
    /// Time over which the noise of neighbouring samples is one and the same, s.
    pub force_memory_s: f64,
    pub torque_memory_s: f64,
}

/// What the model says at one instant.
#[derive(Clone, Copy, Debug)]
struct Said {
    accel: [f64; 3],
    acc: [f64; 3],
    ang_acc: [f64; 3],
}

/// Weighted mean over the neighbours within `half` steps; `None` where one is missing. The weights are those with which a
/// local parabola of that width sees the signal.
fn seen(
    said: &[Option<Said>],
    i: usize,
    weights: &[f64],
    pick: impl Fn(&Said) -> [f64; 3],
) -> Option<[f64; 3]> {
    let half = weights.len() / 2;
    if i < half || i + half >= said.len() {
        return None;
    }
    let mut sum = [0.0; 3];
    for (w, s) in weights.iter().zip(&said[i - half..=i + half]) {
        let x = pick(s.as_ref()?);
        for k in 0..3 {
            sum[k] += w * x[k];
        }
    }
    Some(sum)
}

/// Weights of [`seen`] for a kernel of u in −1…1 that reaches `half_s` s each way. A few steps stand for it: their reach is
/// chosen so that they pass a slow swing on as the kernel does, to second order.
fn kernel(half_s: f64, of: impl Fn(f64) -> f64) -> Vec<f64> {
    let weights = |scale: f64| -> Vec<f64> {
        let half = scale.floor() as i64;
        (-half..=half).map(|i| of(i as f64 / scale)).collect()
    };
    // Mean square of the distance, in units of the step.
    let spread = |weights: &[f64]| {
        let middle = (weights.len() / 2) as f64;
        let square: f64 = weights.iter().enumerate().map(|(i, w)| w * (i as f64 - middle).powi(2)).sum();
        square / weights.iter().sum::<f64>()
    };
    let reach = half_s / STEP_S;
    let fine = weights(2000.0);
    let wanted = spread(&fine) * (reach / 2000.0).powi(2);
    let (mut low, mut high) = (0.6 * reach, 1.6 * reach);
    // A kernel that passes a slow swing on as it is: steps stand for their surroundings.
    let mut scale = (reach.floor() + 0.5).max(1.0);
    if wanted > 0.01 * reach * reach
        && low >= 1.0
        && (spread(&weights(low)) - wanted) * (spread(&weights(high)) - wanted) < 0.0
    {
        let rises = spread(&weights(high)) > wanted;
        for _ in 0..50 {
            scale = 0.5 * (low + high);
            if (spread(&weights(scale)) > wanted) == rises {
                high = scale;
            } else {
                low = scale;
            }
        }
    }
    let mut out = weights(scale);
    let sum: f64 = out.iter().sum();
    out.iter_mut().for_each(|w| *w /= sum);
    out
}

impl Residuals {
    /// Residual force and torque of a model along a log.
    pub fn new(replay: &Replay) -> Self {
        let (track, drone) = (replay.track, replay.drone);
        let plant = replay.plant();
        let body = plant.parts.body;
        let clock = drone.clock();
        let n = replay.n_steps();
        let said: Vec<Option<Said>> = (0..n)
            .into_par_iter()
            .with_min_len(256)
            .map_init(Vec::new, |neighbours, i| {
                let mut state = state_of(replay.known(i)?);
                let rate = plant.rate(i * STEP, &replay.ticks[i * STEP], &mut state, neighbours);
                let accel = drone.read(&state, &rate).accel;
                Some(Said { accel, acc: rate.acc, ang_acc: rate.ang_acc })
            })
            .collect();
        let times = |late_s: f64| -> Vec<f64> { (0..n).map(|i| replay.time_s(i) + late_s).collect() };
        let period = |c: &[f64]| resample::spacing_s(c).unwrap_or(0.01);

        // Forces. A local parabola sees a signal's value with the weights 3 − 5u², and what was integrated twice, through
        // its second derivative, with (1 − u²)²; once, through its slope, with 1 − u².
        let from_accelerometer = !track.accel.is_empty();
        let (force_half_s, acc_sigma, force_memory_s);
        let mut force: Vec<Option<([f64; 3], [f64; 3])>> = vec![None; n];
        if from_accelerometer {
            let p = period(&track.accel.t_s);
            force_half_s = 0.0125f64.max(3.2 * p);
            acc_sigma = track.noise.accel_m_s2 * gains(&track.accel.t_s, force_half_s, track.span_s)[0];
            force_memory_s = (p * (track.noise.accel_m_s2 / acc_sigma).powi(2)).max(p);
            let weights = kernel(force_half_s, |u| 3.0 - 5.0 * u * u);
            let read = resample::local_parabola(&track.accel, &times(clock.accel_s), force_half_s);
            for i in 0..n {
                let (Some(read), Some(m)) = (&read[i], replay.known(i)) else { continue };
                let Some(model) = seen(&said, i, &weights, |s| s.accel) else { continue };
                let Some(at) = &said[i] else { continue };
                let missing = quat::rotate(m.quat, vec3::sub(read.value, model));
                force[i] = Some((at.acc, vec3::add(at.acc, missing)));
            }
        } else {
            force_half_s = (0.05 * (track.noise.position_m / 3e-4).powf(0.4))
                .clamp(0.05, 0.2)
                .max(4.2 * period(&track.position.t_s));
            acc_sigma = track.noise.position_m * gains(&track.position.t_s, force_half_s, track.span_s)[2];
            force_memory_s = force_half_s;
            let weights = kernel(force_half_s, |u| (1.0 - u * u).powi(2));
            let read = resample::local_parabola(&track.position, &times(clock.pose_s), force_half_s);
            for i in 0..n {
                let Some(read) = &read[i] else { continue };
                if let (Some(model), Some(_)) = (seen(&said, i, &weights, |s| s.acc), replay.known(i)) {
                    force[i] = Some((model, read.curvature));
                }
            }
        }

        // Torques.
        let from_gyroscope = !track.gyro.is_empty();
        let torques = track.drive != Drive::Thrust;
        let (torque_half_s, ang_sigma);
        let turned: Vec<Option<[f64; 3]>>;
        let weights;
        if from_gyroscope {
            let p = period(&track.gyro.t_s);
            torque_half_s =
                (0.025 * (track.noise.gyro_rad_s / 0.01).powf(0.4)).clamp(0.02, 0.08).max(4.2 * p);
            ang_sigma = track.noise.gyro_rad_s * gains(&track.gyro.t_s, torque_half_s, track.span_s)[1];
            // A sample stands for its surroundings too.
            weights = kernel(torque_half_s + 0.5 * p, |u| 1.0 - u * u);
            let slopes = resample::local_parabola(&track.gyro, &times(clock.gyro_s), torque_half_s);
            turned = slopes
                .iter()
                .enumerate()
                .map(|(i, s)| {
                    let (s, m) = (s.as_ref()?, replay.known(i)?);
                    Some(slope_of_rate(drone, m, s.value, s.slope))
                })
                .collect();
        } else {
            let p = period(&track.attitude.t_s);
            torque_half_s =
                (0.05 * (track.noise.attitude_rad / 3e-4).powf(0.3)).clamp(0.05, 0.1).max(4.2 * p);
            ang_sigma = track.noise.attitude_rad * gains(&track.attitude.t_s, torque_half_s, track.span_s)[2];
            weights = kernel(torque_half_s, |u| (1.0 - u * u).powi(2));
            turned = times(clock.pose_s)
                .par_iter()
                .with_min_len(256)
                .map(|at| bend_of_attitude(&track.attitude, *at, torque_half_s))
                .collect();
        }

        let mut samples = Vec::with_capacity(n);
        for i in 0..n {
            let (Some((model, measured)), Some(m)) = (force[i], replay.known(i)) else { continue };
            let mut ang = None;
            if torques && let (Some(read), Some(model)) = (turned[i], seen(&said, i, &weights, |s| s.ang_acc))
            {
                ang = Some((model, read));
            }
            let (of_model, of_read) = ang.unwrap_or_default();
            let a = rigid_body::wrench(&body, m.ang_vel, model, of_model);
            let b = rigid_body::wrench(&body, m.ang_vel, measured, of_read);
            samples.push(Sample {
                step: i,
                force_n: quat::rotate_inverse(m.quat, vec3::sub(b.force, a.force)),
                measured_force_n: quat::rotate_inverse(m.quat, b.force),
                torque_n_m: ang.map(|_| vec3::sub(b.torque, a.torque)),
                measured_torque_n_m: ang.map(|_| b.torque),
                quat: m.quat,
            });
        }

        // Noise of a sample: that of the derivative, and what the noise of states and inputs does to the model.
        let window_s = [2.0 * force_half_s, 2.0 * torque_half_s];
        let (acc_var, ang_var) = noise_in_model(replay, &plant, window_s);
        let acc = acc_var.map(|v| (v + acc_sigma * acc_sigma).sqrt());
        let ang = ang_var.map(|v| (v + ang_sigma * ang_sigma).sqrt());
        let zero = [0.0; 3];
        let made = rigid_body::wrench(&body, zero, vec3::add(acc, body.gravity_m_s2), zero).force;
        let mut torque = [0.0; 3];
        for axis in 0..3 {
            let mut one = zero;
            one[axis] = ang[axis];
            let t = rigid_body::wrench(&body, zero, zero, one).torque;
            (0..3).for_each(|k| torque[k] += t[k] * t[k]);
        }
        Self {
            samples,
            from_accelerometer,
            from_gyroscope,
            force_half_s,
            torque_half_s,
            force_sigma_n: made,
            torque_sigma_n_m: torque.map(f64::sqrt),
            force_memory_s,
            torque_memory_s: torque_half_s,
        }
    }
}

/// Angular acceleration behind a gyroscope that reads `value` and rises with `slope`, if it is as the model says.
fn slope_of_rate(drone: &Drone<f64>, m: &Measured, value: [f64; 3], slope: [f64; 3]) -> [f64; 3] {
    if drone.effects.is_empty() {
        return slope;
    }
    let dt = 1e-3;
    let base = drone.read(&state_of(m), &Rate { vel: m.vel, ang_vel: m.ang_vel, ..Rate::zero() });
    // Readings of pose and velocity belong to `m`, so that only the rate is looked for.
    let read = |w: [f64; 3]| {
        let read = Measured { pos: base.pos, vel: base.vel, quat: base.quat, ang_vel: w };
        true_state(drone, &read).ang_vel
    };
    let (a, b) = (read(value), read(vec3::add(value, vec3::scale(slope, dt))));
    vec3::scale(vec3::sub(b, a), 1.0 / dt)
}

/// Angular acceleration, rad/s², body, from the second derivative of the rotation vector about the sample in the middle.
fn bend_of_attitude(channel: &Channel<4>, at_s: f64, half_s: f64) -> Option<[f64; 3]> {
    let t = &channel.t_s;
    let from = t.partition_point(|x| *x < at_s - half_s * (1.0 + 1e-6));
    let to = t.partition_point(|x| *x <= at_s + half_s * (1.0 + 1e-6));
    if to < from + 4 {
        return None;
    }
    let base = quat::conjugate(channel.values[t.partition_point(|x| *x < at_s).clamp(from, to - 1)]);
    let mut near = Channel::<3>::default();
    for i in from..to {
        near.push(t[i], resample::rotation_vector(quat::mul(base, channel.values[i])));
    }
    Some(resample::local_parabola(&near, &[at_s], half_s)[0]?.curvature)
}

/// Standard deviations of the input: rotor speeds (rad/s) or thrust (N), one sample, with its period (s).
fn input_noise(track: &Track) -> Option<(f64, f64)> {
    let period = |c: &Channel<1>| c.period_s().unwrap_or(0.01);
    match track.drive {
        Drive::RotorSpeeds => {
            let n = track.inputs.rotors.len().max(1) as f64;
            // What smoothing took away tells how noisy the rest is too: slow noise stays in.
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

/// Variances of the model's specific force (m/s², body axes) and angular acceleration (rad/s²) by the noise of states and
/// inputs, seen through windows of the given lengths (force, torque), s.
fn noise_in_model(replay: &Replay, plant: &Plant<f64>, window_s: [f64; 2]) -> ([f64; 3], [f64; 3]) {
    let noise = StateNoise::of(replay.track);
    let known: Vec<usize> = (0..replay.n_steps()).filter(|i| replay.known(*i).is_some()).collect();
    let stride = (known.len() / 40).max(1);
    let mut neighbours = Vec::new();
    let (mut acc, mut ang, mut count) = ([0.0; 3], [0.0; 3], 0.0);
    let n_rotors = plant.parts.airframe.n_rotors;
    for &i in known.iter().step_by(stride) {
        let Some(m) = replay.known(i) else { continue };
        let tick = &replay.ticks[i * STEP];
        let mut at = |m: &Measured, tick: &Tick<f64>| {
            let mut state = state_of(m);
            let rate = plant.rate(i * STEP, tick, &mut state, &mut neighbours);
            (replay.drone.read(&state, &rate).accel, rate.ang_acc)
        };
        let base = at(m, tick);
        let mut add = |moved: ([f64; 3], [f64; 3]), shares: [f64; 2]| {
            for k in 0..3 {
                acc[k] += ((moved.0[k] - base.0[k]) * shares[0]).powi(2);
                ang[k] += ((moved.1[k] - base.1[k]) * shares[1]).powi(2);
            }
        };
        for which in 0..12 {
            let moved = at(&noise.moved(m, which), tick);
            add(moved, [1.0, 1.0]);
        }
        if let Some((sigma, period)) = input_noise(replay.track) {
            // Averaged over a window, white noise of the samples falls with the root of their number.
            let shares = window_s.map(|w| (period / w).min(1.0).sqrt());
            for which in 0..n_rotors.max(1) {
                let mut tick = *tick;
                if replay.track.drive == Drive::Thrust {
                    tick.thrust += if which == 0 { sigma } else { 0.0 };
                } else {
                    tick.rotor_vel[which] += sigma;
                }
                let moved = at(m, &tick);
                add(moved, shares);
            }
            if replay.track.drive == Drive::RotorSpeeds {
                let mut tick = *tick;
                for which in 0..n_rotors {
                    // The slope of a parabola through n samples over T has the noise σ √(12/n) / T.
                    tick.rotor_acc[which] += sigma * (12.0 * period / window_s[1]).sqrt() / window_s[1];
                }
                let moved = at(m, &tick);
                add(moved, [0.0, 1.0]);
            }
        }
        count += 1.0;
    }
    let count = f64::max(count, 1.0);
    (acc.map(|v| v / count), ang.map(|v| v / count))
}

/// Roll-outs along a log and what is measured at their ends.
struct Starts<'a> {
    replay: &'a Replay<'a>,
    /// Length of each horizon in steps.
    steps: Vec<usize>,
    /// Number of instants before each that cannot be crossed.
    holes: Vec<usize>,
}

impl<'a> Starts<'a> {
    fn new(replay: &'a Replay<'a>, horizons_s: &[f64]) -> Self {
        let raw = &replay.raw.valid;
        let mut holes = vec![0];
        for i in 0..replay.n_steps() {
            let inputs = (i * STEP..(i + 1) * STEP).all(|k| raw.get(k).copied().unwrap_or(false));
            let pose = replay.track.drive != Drive::Thrust || replay.around.measured[i].is_some();
            // The last instant of a roll-out needs no input after it; its own tick is checked with the measurement.
            holes.push(holes[i] + usize::from(!(inputs && pose)));
        }
        let steps = horizons_s.iter().map(|h| ((h / STEP_S).round() as usize).max(1)).collect();
        Self { replay, steps, holes }
    }

    /// The horizons (their indices) that can be rolled from step `i` within the segments.
    fn reach(&self, i: usize, segments: Option<&[[f64; 2]]>) -> Vec<usize> {
        if self.replay.known(i).is_none() {
            return Vec::new();
        }
        let (n, time) = (self.replay.n_steps(), |k: usize| self.replay.time_s(k));
        (0..self.steps.len())
            .filter(|h| {
                let end = i + self.steps[*h];
                end < n
                    && self.holes[end] == self.holes[i]
                    && self.replay.known(end).is_some()
                    && segments.is_none_or(|list| {
                        list.iter().any(|s| time(i) >= s[0] - 1e-9 && time(end) <= s[1] + 1e-9)
                    })
            })
            .collect()
    }
}

/// Squared lengths of the differences (position, velocity, attitude, rate) of two states.
fn squares(a: &State<f64>, b: &Measured) -> [f64; 4] {
    let d = |a: [f64; 3], b: [f64; 3]| {
        let d = vec3::sub(a, b);
        vec3::dot(d, d)
    };
    let turn = resample::rotation_vector(quat::mul(quat::conjugate(b.quat), a.quat));
    [d(a.pos, b.pos), d(a.vel, b.vel), vec3::dot(turn, turn), d(a.ang_vel, b.ang_vel)]
}

fn finish(horizons_s: &[f64], sums: &[[f64; 4]], counts: &[usize]) -> Vec<HorizonError> {
    horizons_s
        .iter()
        .zip(sums)
        .zip(counts)
        .map(|((h, s), n)| {
            let [position_m, velocity_m_s, attitude_rad, rate_rad_s] =
                s.map(|s| if *n > 0 { (s / *n as f64).sqrt() } else { 0.0 });
            HorizonError { horizon_s: *h, position_m, velocity_m_s, attitude_rad, rate_rad_s, n: *n }
        })
        .collect()
}

/// Root-mean-square errors (length of the 3-D difference) of roll-outs that start from the measured state every 0.1 s,
/// against the measured state at their ends; `segments` (s, from–to) are the spans in which they must lie. A horizon that
/// never fits has `n` 0; a roll-out that does not stay finite makes its errors not finite.
pub(crate) fn replay_errors(
    replay: &Replay,
    horizons_s: &[f64],
    segments: Option<&[[f64; 2]]>,
) -> Vec<HorizonError> {
    let starts = Starts::new(replay, horizons_s);
    let plant = replay.plant();
    let places: Vec<usize> = (0..replay.n_steps()).step_by(START_EVERY).collect();
    let each: Vec<Vec<(usize, [f64; 4])>> = places
        .par_iter()
        .with_min_len(8)
        .map_init(Vec::<Point>::new, |points, &i| {
            let reach = starts.reach(i, segments);
            let (Some(far), Some(start)) = (reach.iter().map(|h| starts.steps[*h]).max(), replay.known(i))
            else {
                return Vec::new();
            };
            plant.roll(&replay.ticks, i * STEP, far, start, &[], points);
            reach
                .into_iter()
                .filter_map(|h| {
                    let end = starts.steps[h];
                    Some((h, squares(&points[end].state, replay.known(i + end)?)))
                })
                .collect()
        })
        .collect();
    let mut sums = vec![[0.0; 4]; horizons_s.len()];
    let mut counts = vec![0; horizons_s.len()];
    for (h, s) in each.into_iter().flatten() {
        (0..4).for_each(|k| sums[h][k] += s[k]);
        counts[h] += 1;
    }
    finish(horizons_s, &sums, &counts)
}

/// What [`replay_errors`] would be if the model were right and only the sensors were noisy: the noise of the start and of
/// the inputs sent through the model itself, and the noise of the end.
pub(crate) fn expected_errors(replay: &Replay, horizons_s: &[f64]) -> Vec<HorizonError> {
    let noise = StateNoise::of(replay.track);
    let starts = Starts::new(replay, horizons_s);
    let plant = replay.plant();
    let able: Vec<(usize, Vec<usize>)> = (0..replay.n_steps())
        .step_by(START_EVERY)
        .map(|i| (i, starts.reach(i, None)))
        .filter(|(_, reach)| !reach.is_empty())
        .collect();
    let stride = able.len().div_ceil(NOISE_STARTS).max(1);
    let chosen: Vec<_> = able.iter().step_by(stride).collect();
    let input = input_noise(replay.track);
    let each: Vec<Vec<(usize, [f64; 4])>> = chosen
        .par_iter()
        .map(|(i, reach)| {
            let (mut base, mut points) = (Vec::<Point>::new(), Vec::<Point>::new());
            let far = reach.iter().map(|h| starts.steps[*h]).max().unwrap_or(0);
            let Some(start) = replay.known(*i) else { return Vec::new() };
            let from = i * STEP;
            plant.roll(&replay.ticks, from, far, start, &[], &mut base);
            let end_noise =
                [noise.pos_m, noise.vel_m_s, noise.att_rad, noise.rate_rad_s].map(|s| 3.0 * s * s);
            let mut sums = vec![end_noise; reach.len()];
            let mut take = |points: &[Point]| {
                for (sum, h) in sums.iter_mut().zip(reach) {
                    let end = starts.steps[*h];
                    let b = &base[end].state;
                    let b = Measured { pos: b.pos, vel: b.vel, quat: b.quat, ang_vel: b.ang_vel };
                    let s = squares(&points[end].state, &b);
                    (0..4).for_each(|k| sum[k] += s[k]);
                }
            };
            for which in 0..12 {
                let moved = noise.moved(start, which);
                plant.roll(&replay.ticks, from, far, &moved, &[], &mut points);
                take(&points);
            }
            if let Some((sigma, period)) = input {
                // White noise of ticks with the low-frequency power of that of the samples: what integrates is the same.
                let sigma = sigma * (period / TICK_S).sqrt();
                let key =
                    Key { seed: 0, world: 0, drone: 0, step: *i as u64, purpose: purpose("gap.input_noise") };
                let mut draws = key.stream();
                let mut ticks = replay.ticks[from..=from + far * STEP].to_vec();
                for tick in &mut ticks {
                    tick.thrust +=
                        if replay.track.drive == Drive::Thrust { sigma * draws.normal() } else { 0.0 };
                    if replay.track.drive == Drive::RotorSpeeds {
                        for v in tick.rotor_vel.iter_mut().take(plant.parts.airframe.n_rotors) {
                            *v += sigma * draws.normal();
                        }
                    }
                }
                let mut all = replay.ticks.clone();
                all[from..=from + far * STEP].copy_from_slice(&ticks);
                plant.roll(&all, from, far, start, &[], &mut points);
                take(&points);
            }
            reach.iter().copied().zip(sums).collect()
        })
        .collect();
    let mut sums = vec![[0.0; 4]; horizons_s.len()];
    let mut counts = vec![0; horizons_s.len()];
    for (h, s) in each.into_iter().flatten() {
        (0..4).for_each(|k| sums[h][k] += s[k]);
        counts[h] += 1;
    }
    finish(horizons_s, &sums, &counts)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A kernel passes a slow swing cos(ω t) on as 1 − ω² m₂/2: m₂ of 1 − u² is reach²/5, of 1 reach²/3.
    #[test]
    fn few_steps_pass_a_slow_swing_on_as_the_kernel_does() {
        for half_s in [0.0203, 0.025, 0.031, 0.05] {
            for (bends, share) in [(1.0, 5.0), (0.0, 3.0)] {
                let weights = kernel(half_s, |u| 1.0 - bends * u * u);
                let middle = (weights.len() / 2) as f64;
                let second: f64 =
                    weights.iter().enumerate().map(|(i, w)| w * (i as f64 - middle).powi(2)).sum();
                let wanted = (half_s / STEP_S).powi(2) / share;
                assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
                // The box has steps of whole weight: no reach gives every second moment.
                let tolerance = if share == 5.0 { 1e-6 } else { 0.35 };
                assert!(
                    (second / wanted - 1.0).abs() < tolerance,
                    "{half_s} s, /{share}: {second}, not {wanted}"
                );
            }
        }
    }
}
