//! The abstracted model: roll, pitch and yaw answer a command as three second-order systems, thrust answers as a scaled,
//! optionally delayed, force along body z.
//!
//! Source: Crazyflow 0.4.0 (`so_rpy`, `so_rpy_rotor`, `so_rpy_rotor_drag`), fitted to flights of the real vehicles. Those
//! three are settings of this one model: without thrust dynamics, with them, and with them and linear drag.
//!
//! At 90° of pitch roll and yaw rates do not exist. Here |pitch| > 85° keeps the divisor of the rate conversion at
//! cos 85° ([`euler::MIN_COS_PITCH`]), so accelerations stay bounded; up to 85° the model is exact. Upside down, roll
//! jumps between +π and −π and the model turns back by the shorter way. Fitted near hover, it is not meant for either.

use super::params::parameters;
use super::rigid_body::{self, State, Wrench};
use propwash_trace::Real;
use propwash_trace::math::{euler, quat, vec3};

parameters! {
    /// Fitted coefficients.
    pub struct Params {
        /// Thrust added to the scaled command, N (`acc_coef`).
        thrust_offset_n: S,
        /// Thrust per commanded thrust (`cmd_f_coef`).
        thrust_scale: S,
        /// Rate at which thrust follows its command, 1/s (`thrust_dyn_coef`); used when `thrust_dynamics` is set.
        thrust_rate_per_s: S,
        /// Angular acceleration per angle, 1/s² (`rpy_coef`).
        angle_gain_per_s2: [S; 3],
        /// Angular acceleration per angular rate, 1/s (`rpy_rates_coef`).
        rate_gain_per_s: [S; 3],
        /// Angular acceleration per commanded angle, 1/s² (`cmd_rpy_coef`).
        command_gain_per_s2: [S; 3],
        ; fixed:
        /// Whether thrust follows its command with a first-order lag, or at once.
        thrust_dynamics: bool,
    }
}

/// Collective thrust (N, along body z) for a thrust state and a thrust command, both N.
#[inline(always)]
pub fn thrust<S: Real>(p: &Params<S>, state: S, command: S) -> S {
    let follows = if p.thrust_dynamics { state } else { command };
    p.thrust_offset_n + p.thrust_scale * follows
}

/// Rate of the thrust state, N/s.
#[inline(always)]
pub fn thrust_rate<S: Real>(p: &Params<S>, state: S, command: S) -> S {
    if p.thrust_dynamics { p.thrust_rate_per_s * (command - state) } else { S::zero() }
}

/// Angular acceleration (rad/s², body) towards commanded roll, pitch, yaw (rad).
#[inline(always)]
pub fn angular_acceleration<S: Real>(
    p: &Params<S>,
    quat: [S; 4],
    ang_vel: [S; 3],
    rpy_command: [S; 3],
) -> [S; 3] {
    let rpy = euler::from_quat(quat);
    let rates = euler::rates_from_body(rpy, ang_vel);
    let accels = vec3::add(
        vec3::add(vec3::mul(p.angle_gain_per_s2, rpy), vec3::mul(p.rate_gain_per_s, rates)),
        vec3::mul(p.command_gain_per_s2, rpy_command),
    );
    euler::body_accel_from_rates(rpy, rates, accels)
}

/// Linear (m/s², world) and angular (rad/s², body) acceleration under the command [roll, pitch, yaw (rad), thrust (N)]
/// and an outer wrench.
///
/// The fitted angular response already holds the body's own inertia, so an outer torque adds J⁻¹ τ and no gyroscopic
/// term.
#[inline(always)]
pub fn accelerations<S: Real>(
    p: &Params<S>,
    body: &rigid_body::Params<S>,
    state: &State<S>,
    command: [S; 4],
    thrust: S,
    outer: &Wrench<S>,
) -> ([S; 3], [S; 3]) {
    let z_axis = quat::rotate(state.quat, [S::zero(), S::zero(), S::one()]);
    let force = vec3::add(vec3::scale(z_axis, thrust), outer.force_world(state.quat));
    let acc = vec3::add(vec3::scale(force, S::one() / body.mass_kg), body.gravity_m_s2);
    let response = angular_acceleration(p, state.quat, state.ang_vel, [command[0], command[1], command[2]]);
    let ang_acc = vec3::add(response, vec3::mat_vec(body.inertia_inverse, outer.torque));
    (acc, ang_acc)
}
