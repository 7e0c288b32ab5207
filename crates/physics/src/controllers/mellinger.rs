//! The Mellinger controller as flown by the Crazyflie firmware, cut into stages.
//!
//! Source: `controller_mellinger.c` and `power_distribution_quadrotor.c` of the Crazyflie firmware, after Mellinger &
//! Kumar, "Minimum snap trajectory generation and control for quadrotors", ICRA 2011. As in the firmware, gains are in
//! units of motor PWM, the rotation error lacks the factor ½ of the paper, the thrust is rescaled by `mass_thrust`, and
//! all integrals are cleared while no thrust is asked for, and the first tick of the attitude stage has no derivative.

use super::{Due, Memory, mixer};
use crate::controllers::ControlMode;
use crate::params::parameters;
use crate::rigid_body::{MAX_ROTORS, State};
use crate::rotor;
use propwash_trace::Real;
use propwash_trace::math::{euler, quat, vec3};

parameters! {
    /// Gains of the state stage.
    pub struct StateGains {
        /// Proportional gain, N/m.
        kp: [S; 3],
        /// Derivative gain, N·s/m.
        kd: [S; 3],
        /// Integral gain, N/(m·s).
        ki: [S; 3],
        /// Bound of the integral, m·s.
        integral_max: [S; 3],
    }
}

parameters! {
    /// Gains of the attitude stage, or of the body-rate stage.
    pub struct AttitudeGains {
        /// Gain on the rotation error, PWM.
        kr: [S; 3],
        /// Gain on the rate error, PWM·s.
        kw: [S; 3],
        /// Gain on the integral of the rotation error, PWM/s.
        ki: [S; 3],
        /// Gain on the derivative of the rate error, PWM·s².
        kd_omega: [S; 3],
        /// Bound of the integral, s.
        integral_max: [S; 3],
    }
}

parameters! {
    /// Everything that the firmware believes about the vehicle.
    pub struct Params {
        /// Mass that the controller assumes, kg.
        mass_kg: S,
        /// PWM per newton of wanted thrust.
        mass_thrust: S,
        /// Least PWM of a turning motor.
        pwm_min: S,
        /// Greatest PWM.
        pwm_max: S,
        /// Least thrust of one turning rotor, N.
        thrust_min_n: S,
        /// Greatest thrust of one rotor, N.
        thrust_max_n: S,
        /// Bound of the torque command, PWM.
        torque_pwm_max: [S; 3],
        /// Thrust curve by which thrust becomes rotor speed; see [`rotor::Params::thrust_curve`].
        thrust_curve: [S; 3],
        /// State stage.
        state: StateGains<S>,
        /// Attitude stage.
        attitude: AttitudeGains<S>,
        /// Body-rate stage.
        body_rate: AttitudeGains<S>,
        /// Motor mixing.
        mixer: mixer::Params<S>,
    }
}

/// Thrust (N) of one rotor as PWM.
#[inline(always)]
fn pwm<S: Real>(p: &Params<S>, thrust: S) -> S {
    thrust / p.thrust_max_n * p.pwm_max
}

/// PWM as thrust (N) of one rotor.
#[inline(always)]
fn thrust<S: Real>(p: &Params<S>, pwm: S) -> S {
    pwm * (p.thrust_max_n / p.pwm_max)
}

/// `v` bounded by ±`bound` per axis.
#[inline(always)]
fn bounded<S: Real>(v: [S; 3], bound: [S; 3]) -> [S; 3] {
    [v[0].clamp(-bound[0], bound[0]), v[1].clamp(-bound[1], bound[1]), v[2].clamp(-bound[2], bound[2])]
}

/// State stage: 16-number command to [roll, pitch, yaw (rad), thrust (N)]; `integral` is carried from tick to tick.
///
/// `gravity` in m/s² (world), `dt` s between ticks.
#[inline(always)]
pub fn state_to_attitude<S: Real>(
    p: &Params<S>,
    gravity: [S; 3],
    state: &State<S>,
    cmd: &[S; 16],
    integral: &mut [S; 3],
    dt: S,
) -> [S; 4] {
    let pos_err = vec3::sub([cmd[0], cmd[1], cmd[2]], state.pos);
    let vel_err = vec3::sub([cmd[3], cmd[4], cmd[5]], state.vel);
    let acc = [cmd[6], cmd[7], cmd[8]];
    let sum = bounded(vec3::add(*integral, vec3::scale(pos_err, dt)), p.state.integral_max);
    let mut target = vec3::scale(vec3::sub(acc, gravity), p.mass_kg);
    target = vec3::add(target, vec3::mul(p.state.kp, pos_err));
    target = vec3::add(target, vec3::mul(p.state.kd, vel_err));
    target = vec3::add(target, vec3::mul(p.state.ki, sum));

    let up = [S::zero(), S::zero(), S::one()];
    let current = vec3::dot(target, quat::rotate(state.quat, up));
    let z = vec3::normalize_or(target, up);
    let yaw = euler::from_quat(quat::normalize([cmd[9], cmd[10], cmd[11], cmd[12]]))[2];
    let (sin, cos) = yaw.sin_cos();
    // With the wanted thrust along the wanted heading no side axis exists; the level one is taken.
    let y = vec3::normalize_or(vec3::cross(z, [cos, sin, S::zero()]), [-sin, cos, S::zero()]);
    let x = vec3::cross(y, z);
    let rpy = euler::from_matrix([[x[0], y[0], z[0]], [x[1], y[1], z[1]], [x[2], y[2], z[2]]]);

    let rotors = S::lit(p.mixer.n_rotors as f64);
    let thrust = thrust(p, p.mass_thrust * current) * rotors;
    let lifting = S::zero().lt(thrust);
    for i in 0..3 {
        integral[i] = S::select(lifting, sum[i], S::zero());
    }
    [rpy[0], rpy[1], rpy[2], thrust]
}

/// What the attitude stage compares with.
#[derive(Clone, Copy, Debug)]
pub struct AttitudeTarget<S> {
    /// Wanted roll, pitch, yaw, rad.
    pub rpy: [S; 3],
    /// Wanted body rates, rad/s.
    pub ang_vel: [S; 3],
    /// Wanted body rates at the last tick, rad/s.
    pub prev_ang_vel: [S; 3],
    /// Wanted collective thrust, N.
    pub thrust: S,
}

/// Attitude stage: to the thrust (N) of each rotor, whose collective thrust and torque are its command; `integral` is carried from tick to tick,
/// `prev_ang_vel` (rad/s) is the angular velocity at the last tick.
#[inline(always)]
pub fn attitude_to_thrusts<S: Real>(
    p: &Params<S>,
    gains: &AttitudeGains<S>,
    state: &State<S>,
    target: &AttitudeTarget<S>,
    prev_ang_vel: [S; 3],
    integral: &mut [S; 3],
    dt: S,
) -> [S; MAX_ROTORS] {
    let zero = S::zero();
    // 2 vee(R_des^T R − R^T R_des) / 2 from the quaternion of R_des^T R.
    let q = quat::mul(quat::conjugate(euler::to_quat(target.rpy)), state.quat);
    let four_w = S::lit(4.0) * q[3];
    let rot_err = [four_w * q[0], four_w * q[1], four_w * q[2]];
    let rate_err = vec3::sub(target.ang_vel, state.ang_vel);
    let set_change = vec3::sub(target.ang_vel, target.prev_ang_vel);
    let change = vec3::sub(set_change, vec3::sub(state.ang_vel, prev_ang_vel));
    // The firmware has no derivative about yaw.
    let rate_err_dot = [change[0] / dt, change[1] / dt, zero];
    let sum = bounded(vec3::sub(*integral, vec3::scale(rot_err, dt)), gains.integral_max);

    let mut torque = vec3::scale(vec3::mul(gains.kr, rot_err), -S::one());
    torque = vec3::add(torque, vec3::mul(gains.kw, rate_err));
    torque = vec3::add(torque, vec3::mul(gains.ki, sum));
    torque = vec3::add(torque, vec3::mul(gains.kd_omega, rate_err_dot));
    torque = bounded(torque, p.torque_pwm_max);
    let lifting = zero.lt(target.thrust);
    for i in 0..3 {
        torque[i] = S::select(lifting, torque[i], zero);
        integral[i] = S::select(lifting, sum[i], zero);
    }
    pwm_mixing(p, target.thrust, torque)
}

/// The firmware's legacy power distribution: PWM of each motor clipped to its range, as thrust of each rotor (N).
#[inline(always)]
fn pwm_mixing<S: Real>(p: &Params<S>, force: S, torque_pwm: [S; 3]) -> [S; MAX_ROTORS] {
    let zero = S::zero();
    let n = p.mixer.n_rotors;
    let half = S::lit(0.5);
    let base = pwm(p, force / S::lit(n as f64));
    let mut pwms = [zero; MAX_ROTORS];
    let mut total = zero;
    for i in 0..n {
        let signs = p.mixer.signs[i];
        let turn =
            half * torque_pwm[0] * signs[0] + half * torque_pwm[1] * signs[1] + torque_pwm[2] * signs[2];
        pwms[i] = base + turn;
        total = total + pwms[i].abs();
    }
    let idle = total.le(zero);
    let mut forces = [zero; MAX_ROTORS];
    for i in 0..n {
        forces[i] = thrust(p, S::select(idle, zero, pwms[i].clamp(p.pwm_min, p.pwm_max)));
    }
    forces
}

/// Mixer stage: collective thrust (N) and torque (N·m, body) to rotor speeds, rad/s. Thrusts are clipped to the range of
/// a rotor; a collective thrust of exactly zero stops the motors.
#[inline(always)]
pub fn force_torque_to_rotor_vel<S: Real>(p: &Params<S>, cmd: [S; 4]) -> [S; MAX_ROTORS] {
    speeds(p, cmd[0], mixer::rotors_from_wrench(&p.mixer, cmd))
}

/// Rotor speeds (rad/s) for wanted rotor thrusts (N) that together are `collective` (N).
#[inline(always)]
fn speeds<S: Real>(p: &Params<S>, collective: S, wanted: [S; MAX_ROTORS]) -> [S; MAX_ROTORS] {
    let zero = S::zero();
    let idle = collective.abs().le(zero);
    // No rotor turns backwards for a thrust below that of rest.
    let least = p.thrust_min_n.max(p.thrust_curve[0]);
    let mut out = [zero; MAX_ROTORS];
    for i in 0..p.mixer.n_rotors {
        let clipped = wanted[i].clamp(least, p.thrust_max_n);
        out[i] = S::select(idle, zero, rotor::speed_for_thrust(p.thrust_curve, clipped));
    }
    out
}

/// Rotor speed commands (rad/s) held within the speeds of least and greatest thrust, as those of the mixer stage are. A command
/// of zero or below means that the motor is off and stays zero.
#[inline(always)]
pub fn limit_rotor_vel<S: Real>(p: &Params<S>, cmd: &mut [S; MAX_ROTORS]) {
    let low = rotor::speed_for_thrust(p.thrust_curve, p.thrust_min_n);
    let high = rotor::speed_for_thrust(p.thrust_curve, p.thrust_max_n);
    for i in 0..p.mixer.n_rotors {
        let off = cmd[i].le(S::zero());
        cmd[i] = S::select(off, S::zero(), cmd[i].clamp(low, high));
    }
}

/// Collective thrust command (N) held within what all rotors give together; zero or below means off and stays zero.
#[inline(always)]
pub fn limit_thrust<S: Real>(p: &Params<S>, thrust: S) -> S {
    let n = S::lit(p.mixer.n_rotors as f64);
    let off = thrust.le(S::zero());
    S::select(off, S::zero(), thrust.clamp(n * p.thrust_min_n, n * p.thrust_max_n))
}

/// Periods of the stages, s.
#[derive(Clone, Copy, Debug)]
pub struct Periods<S> {
    /// State stage.
    pub state: S,
    /// Attitude stage.
    pub attitude: S,
    /// Body-rate stage.
    pub body_rate: S,
}

/// Runs the stages that tick, from the command's own stage down to rotor speeds; the result stands in
/// `memory.rotor_cmd` and `memory.attitude_cmd`.
#[inline(always)]
pub fn run<S: Real>(
    p: &Params<S>,
    gravity: [S; 3],
    mode: ControlMode,
    due: Due,
    periods: &Periods<S>,
    state: &State<S>,
    command: &[S; 16],
    m: &mut Memory<S>,
) {
    let first4 = [command[0], command[1], command[2], command[3]];
    if mode == ControlMode::State && due.state {
        m.state_cmd = *command;
        let cmd = m.state_cmd;
        m.staged_attitude =
            state_to_attitude(p, gravity, state, &cmd, &mut m.pos_err_integral, periods.state);
        m.staged_ang_vel = [cmd[13], cmd[14], cmd[15]];
    }
    match mode {
        ControlMode::Attitude => m.staged_attitude = first4,
        ControlMode::ForceTorque => m.staged_force_torque = first4,
        _ => {}
    }
    let mut thrusts = None;
    if due.attitude && matches!(mode, ControlMode::State | ControlMode::Attitude | ControlMode::BodyRate) {
        let prev_ang_vel = m.ang_vel_cmd;
        let rate_mode = mode == ControlMode::BodyRate;
        if rate_mode {
            // The firmware has no mode of body rates alone: it levels the vehicle at its present yaw meanwhile.
            let yaw = euler::from_quat(state.quat)[2];
            m.attitude_cmd = [S::zero(), S::zero(), yaw, first4[3]];
            m.ang_vel_cmd = [first4[0], first4[1], first4[2]];
        } else {
            m.attitude_cmd = m.staged_attitude;
            m.ang_vel_cmd = m.staged_ang_vel;
        }
        let a = m.attitude_cmd;
        // As in the firmware, the first tick has no derivative: it differs from itself.
        let first = m.attitude_ticked[0].le(S::zero());
        let mut prev = m.prev_ang_vel;
        let mut prev_target = prev_ang_vel;
        for i in 0..3 {
            prev[i] = S::select(first, state.ang_vel[i], prev[i]);
            prev_target[i] = S::select(first, m.ang_vel_cmd[i], prev_target[i]);
        }
        m.attitude_ticked = [S::one()];
        let target = AttitudeTarget {
            rpy: [a[0], a[1], a[2]],
            ang_vel: m.ang_vel_cmd,
            prev_ang_vel: prev_target,
            thrust: a[3],
        };
        let (gains, dt) =
            if rate_mode { (&p.body_rate, periods.body_rate) } else { (&p.attitude, periods.attitude) };
        let made = attitude_to_thrusts(p, gains, state, &target, prev, &mut m.attitude_err_integral, dt);
        m.staged_force_torque = mixer::wrench_from_rotors(&p.mixer, &made);
        thrusts = Some(made);
        m.prev_ang_vel = state.ang_vel;
    }
    if mode == ControlMode::RotorVel {
        let n = p.mixer.n_rotors;
        m.rotor_cmd[..n].copy_from_slice(&command[..n]);
    } else if due.force_torque {
        m.force_torque_cmd = m.staged_force_torque;
        m.rotor_cmd = match thrusts {
            Some(made) => speeds(p, m.force_torque_cmd[0], mixer::rotors_from_rotors(&p.mixer, &made)),
            None => force_torque_to_rotor_vel(p, m.force_torque_cmd),
        };
    }
}
