//! Force and torque that a model lacks at every instant of a log.

use super::{Replay, Residuals, Sample, StateNoise, gains, input_noise, state_of, true_state};
use crate::replay::{Plant, STEP, STEP_S, Tick, clock};
use crate::track::{Drive, Measured};
use propwash_flight::{Channel, resample};
use propwash_physics::drone::Drone;
use propwash_physics::rigid_body::{self, Rate};
use propwash_trace::math::{quat, vec3};
use rayon::prelude::*;

/// Model output at one instant.
#[derive(Clone, Copy, Debug)]
struct Said {
    accel: [f64; 3],
    acc: [f64; 3],
    ang_acc: [f64; 3],
}

/// Weighted mean over the neighbours within `half` steps; `None` where one is missing. The weights are those of a local
/// parabola of that width.
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

/// Weights of [`seen`] for a kernel of u in −1…1 with half width `half_s`, s. Since it is sampled by few steps, their reach
/// is chosen such that low frequencies pass as through the kernel, to second order.
fn kernel(half_s: f64, of: impl Fn(f64) -> f64) -> Vec<f64> {
    let weights = |scale: f64| -> Vec<f64> {
        let half = scale.floor() as i64;
        (-half..=half).map(|i| of(i as f64 / scale)).collect()
    };
    // Second moment, in units of the step.
    let spread = |weights: &[f64]| {
        let middle = (weights.len() / 2) as f64;
        let square: f64 = weights.iter().enumerate().map(|(i, w)| w * (i as f64 - middle).powi(2)).sum();
        square / weights.iter().sum::<f64>()
    };
    let reach = half_s / STEP_S;
    let fine = weights(2000.0);
    let wanted = spread(&fine) * (reach / 2000.0).powi(2);
    let (mut low, mut high) = (0.6 * reach, 1.6 * reach);
    // The identity kernel: steps represent their surroundings.
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
        let track = replay.track;
        let plant = replay.plant();
        let said = said_along(replay, &plant);
        let (from_accelerometer, from_gyroscope) = (!track.accel.is_empty(), !track.gyro.is_empty());
        let linear = if from_accelerometer {
            Linear::from_accelerometer(replay, &said)
        } else {
            Linear::from_positions(replay, &said)
        };
        let angular =
            if from_gyroscope { Angular::from_gyroscope(replay) } else { Angular::from_attitudes(replay) };
        let samples = samples(replay, &plant.parts.body, &said, &linear, &angular);
        let (force_sigma_n, torque_sigma_n_m) = sample_noise(replay, &plant, &linear, &angular);
        Self {
            samples,
            from_accelerometer,
            from_gyroscope,
            force_half_s: linear.half_s,
            torque_half_s: angular.half_s,
            force_sigma_n,
            torque_sigma_n_m,
            force_memory_s: linear.memory_s,
            torque_memory_s: angular.half_s,
        }
    }
}

/// Model output at every instant; `None` where state or inputs are unknown.
fn said_along(replay: &Replay, plant: &Plant<f64>) -> Vec<Option<Said>> {
    (0..replay.n_steps())
        .into_par_iter()
        .with_min_len(256)
        .map_init(Vec::new, |neighbours, i| {
            let mut state = state_of(replay.known(i)?);
            let rate = plant.rate(i * STEP, &replay.ticks[i * STEP], &mut state, neighbours);
            let accel = replay.drone.read(&state, &rate).accel;
            Some(Said { accel, acc: rate.acc, ang_acc: rate.ang_acc })
        })
        .collect()
}

/// Times, s, at which a delayed sensor reads what happens at every instant.
fn times(replay: &Replay, late_s: f64) -> Vec<f64> {
    (0..replay.n_steps()).map(|i| replay.time_s(i) + late_s).collect()
}

fn period_s(t_s: &[f64]) -> f64 {
    resample::spacing_s(t_s).unwrap_or(0.01)
}

// A local parabola weighs the signal's value with 3 − 5u²; through the second derivative of a twice integrated signal, with
// (1 − u²)²; through the slope of a once integrated one, with 1 − u².

/// Accelerations along a log as seen through local fits.
struct Linear {
    /// Modelled and measured acceleration at every instant, m/s², world.
    pairs: Vec<Option<([f64; 3], [f64; 3])>>,
    /// Half width of the fits, s.
    half_s: f64,
    /// Standard deviation of the measured one due to sensor noise, m/s².
    sigma: f64,
    /// Correlation time of the noise of neighbouring samples, s.
    memory_s: f64,
}

impl Linear {
    fn from_accelerometer(replay: &Replay, said: &[Option<Said>]) -> Self {
        let track = replay.track;
        let p = period_s(&track.accel.t_s);
        let half_s = 0.0125f64.max(3.2 * p);
        let sigma = track.noise.accel_m_s2 * gains(&track.accel.t_s, half_s, track.span_s)[0];
        let memory_s = (p * (track.noise.accel_m_s2 / sigma).powi(2)).max(p);
        let weights = kernel(half_s, |u| 3.0 - 5.0 * u * u);
        let late_s = clock(track, replay.drone).accel_s;
        let readings = &replay.around.readings;
        let fit = || resample::local_parabola(&track.accel, &times(replay, late_s), half_s);
        let read = readings.accel.at(late_s, fit);
        let pairs = (0..replay.n_steps())
            .map(|i| {
                let (read, m) = (read[i].as_ref()?, replay.known(i)?);
                let model = seen(said, i, &weights, |s| s.accel)?;
                let at = said[i].as_ref()?;
                let missing = quat::rotate(m.quat, vec3::sub(read.value, model));
                Some((at.acc, vec3::add(at.acc, missing)))
            })
            .collect();
        Self { pairs, half_s, sigma, memory_s }
    }

    fn from_positions(replay: &Replay, said: &[Option<Said>]) -> Self {
        let track = replay.track;
        let half_s = (0.05 * (track.noise.position_m / 3e-4).powf(0.4))
            .clamp(0.05, 0.2)
            .max(4.2 * period_s(&track.position.t_s));
        let sigma = track.noise.position_m * gains(&track.position.t_s, half_s, track.span_s)[2];
        let weights = kernel(half_s, |u| (1.0 - u * u).powi(2));
        let late_s = clock(track, replay.drone).pose_s;
        let readings = &replay.around.readings;
        let fit = || resample::local_parabola(&track.position, &times(replay, late_s), half_s);
        let read = readings.position.at(late_s, fit);
        let pairs = (0..replay.n_steps())
            .map(|i| {
                let read = read[i].as_ref()?;
                let model = seen(said, i, &weights, |s| s.acc)?;
                replay.known(i).map(|_| (model, read.curvature))
            })
            .collect();
        Self { pairs, half_s, sigma, memory_s: half_s }
    }
}

/// Angular accelerations along a log as seen through local fits.
struct Angular {
    /// Measured angular acceleration at every instant, rad/s², body.
    measured: Vec<Option<[f64; 3]>>,
    /// Weights with which the fits see the modelled one.
    weights: Vec<f64>,
    /// Half width of the fits, s.
    half_s: f64,
    /// Standard deviation of the measured one due to sensor noise, rad/s².
    sigma: f64,
}

impl Angular {
    fn from_gyroscope(replay: &Replay) -> Self {
        let (track, drone) = (replay.track, replay.drone);
        let p = period_s(&track.gyro.t_s);
        let half_s = (0.025 * (track.noise.gyro_rad_s / 0.01).powf(0.4)).clamp(0.02, 0.08).max(4.2 * p);
        let sigma = track.noise.gyro_rad_s * gains(&track.gyro.t_s, half_s, track.span_s)[1];
        // A sample represents its surroundings too.
        let weights = kernel(half_s + 0.5 * p, |u| 1.0 - u * u);
        let late_s = clock(track, drone).gyro_s;
        let fit = || resample::local_parabola(&track.gyro, &times(replay, late_s), half_s);
        let slopes = replay.around.readings.gyro.at(late_s, fit);
        let measured = slopes
            .par_iter()
            .with_min_len(256)
            .enumerate()
            .map(|(i, s)| {
                let (s, m) = (s.as_ref()?, replay.known(i)?);
                Some(slope_of_rate(drone, m, s.value, s.slope))
            })
            .collect();
        Self { measured, weights, half_s, sigma }
    }

    fn from_attitudes(replay: &Replay) -> Self {
        let track = replay.track;
        let p = period_s(&track.attitude.t_s);
        let half_s = (0.05 * (track.noise.attitude_rad / 3e-4).powf(0.3)).clamp(0.05, 0.1).max(4.2 * p);
        let sigma = track.noise.attitude_rad * gains(&track.attitude.t_s, half_s, track.span_s)[2];
        let weights = kernel(half_s, |u| (1.0 - u * u).powi(2));
        let late_s = clock(track, replay.drone).pose_s;
        let bend = |at: &f64| bend_of_attitude(&track.attitude, *at, half_s);
        let bends = || times(replay, late_s).par_iter().with_min_len(256).map(bend).collect();
        let measured = replay.around.readings.bends.at(late_s, bends).to_vec();
        Self { measured, weights, half_s, sigma }
    }
}

/// Force and torque that the model lacks at every instant at which the force is known.
fn samples(
    replay: &Replay,
    body: &rigid_body::Params<f64>,
    said: &[Option<Said>],
    linear: &Linear,
    angular: &Angular,
) -> Vec<Sample> {
    let torques = replay.track.drive != Drive::Thrust;
    let mut samples = Vec::with_capacity(replay.n_steps());
    for i in 0..replay.n_steps() {
        let (Some((model, measured)), Some(m)) = (linear.pairs[i], replay.known(i)) else { continue };
        let mut ang = None;
        if torques
            && let (Some(read), Some(model)) =
                (angular.measured[i], seen(said, i, &angular.weights, |s| s.ang_acc))
        {
            ang = Some((model, read));
        }
        let (of_model, of_read) = ang.unwrap_or_default();
        let a = rigid_body::wrench(body, m.ang_vel, model, of_model);
        let b = rigid_body::wrench(body, m.ang_vel, measured, of_read);
        samples.push(Sample {
            step: i,
            force_n: quat::rotate_inverse(m.quat, vec3::sub(b.force, a.force)),
            measured_force_n: quat::rotate_inverse(m.quat, b.force),
            torque_n_m: ang.map(|_| vec3::sub(b.torque, a.torque)),
            measured_torque_n_m: ang.map(|_| b.torque),
            quat: m.quat,
        });
    }
    samples
}

/// Standard deviations of a sample's force (N) and torque (N·m), body axes: noise of the derivative, and noise of states
/// and inputs propagated through the model.
fn sample_noise(
    replay: &Replay,
    plant: &Plant<f64>,
    linear: &Linear,
    angular: &Angular,
) -> ([f64; 3], [f64; 3]) {
    let body = &plant.parts.body;
    let window_s = [2.0 * linear.half_s, 2.0 * angular.half_s];
    let (acc_var, ang_var) = noise_in_model(replay, plant, window_s);
    let acc = acc_var.map(|v| (v + linear.sigma * linear.sigma).sqrt());
    let ang = ang_var.map(|v| (v + angular.sigma * angular.sigma).sqrt());
    let zero = [0.0; 3];
    let force = rigid_body::wrench(body, zero, vec3::add(acc, body.gravity_m_s2), zero).force;
    let mut torque = [0.0; 3];
    for axis in 0..3 {
        let mut one = zero;
        one[axis] = ang[axis];
        let t = rigid_body::wrench(body, zero, zero, one).torque;
        (0..3).for_each(|k| torque[k] += t[k] * t[k]);
    }
    (force, torque.map(f64::sqrt))
}

/// Angular acceleration for a gyroscope reading `value` with slope `slope`, if the sensor is as modelled.
fn slope_of_rate(drone: &Drone<f64>, m: &Measured, value: [f64; 3], slope: [f64; 3]) -> [f64; 3] {
    if drone.effects.is_empty() {
        return slope;
    }
    let dt = 1e-3;
    let base = drone.read(&state_of(m), &Rate { vel: m.vel, ang_vel: m.ang_vel, ..Rate::zero() });
    // Pose and velocity readings belong to `m`, so only the rate is solved for.
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

/// Variances of the model's specific force (m/s², body axes) and angular acceleration (rad/s²) due to the noise of states
/// and inputs, averaged over windows of the given lengths (force, torque), s.
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A kernel passes a slow oscillation cos(ω t) with the gain 1 − ω² m₂/2: m₂ of 1 − u² is reach²/5, of 1 reach²/3.
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
                // The box has steps of equal weight: no reach gives every second moment.
                let tolerance = if share == 5.0 { 1e-6 } else { 0.35 };
                assert!(
                    (second / wanted - 1.0).abs() < tolerance,
                    "{half_s} s, /{share}: {second}, not {wanted}"
                );
            }
        }
    }
}
