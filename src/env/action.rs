//! From actions to commands.

use serde::{Deserialize, Serialize};

use super::EnvError;
use crate::math::vec3;
use crate::physics::controllers::{ControlMode, mellinger};
use crate::physics::drone::Drone;
use crate::physics::rigid_body::MAX_ROTORS;

/// What the numbers of an action are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ActionKind {
    /// Roll, pitch, yaw (rad), collective thrust (N).
    #[default]
    Attitude,
    /// Body rates (rad/s), collective thrust (N).
    BodyRate,
    /// Collective thrust (N), torque (N·m, body).
    ForceTorque,
    /// Rotor speeds, rad/s.
    RotorVel,
    /// Velocity (m/s) along the drone's heading, to its left and upwards, and yaw rate (rad/s): the on-board controller follows a
    /// set-point that moves so, speeding up and slowing down within `max_accel_m_s2`.
    Velocity,
}

impl ActionKind {
    /// Control mode of the simulation.
    pub fn mode(self) -> ControlMode {
        match self {
            Self::Attitude => ControlMode::Attitude,
            Self::BodyRate => ControlMode::BodyRate,
            Self::ForceTorque => ControlMode::ForceTorque,
            Self::RotorVel => ControlMode::RotorVel,
            Self::Velocity => ControlMode::State,
        }
    }

    /// Numbers of one drone's action.
    pub fn width(self, n_rotors: usize) -> usize {
        match self {
            Self::RotorVel => n_rotors,
            _ => 4,
        }
    }
}

/// What actions mean. Thrusts and rotor speeds are limited by the vehicle, everything else by what stands here.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ActionConfig {
    /// What their numbers are.
    pub kind: ActionKind,
    /// Actions run from −1 to 1, where 0 is hovering; else they are in the units of their kind.
    pub normalized: bool,
    /// Greatest roll and pitch, rad.
    pub max_tilt_rad: f64,
    /// Greatest yaw, rad.
    pub max_yaw_rad: f64,
    /// Greatest body rate about each axis, rad/s.
    pub max_rate_rad_s: [f64; 3],
    /// Greatest speed along each axis, m/s.
    pub max_speed_m_s: f64,
    /// Greatest yaw rate of a velocity action, rad/s.
    pub max_yaw_rate_rad_s: f64,
    /// Velocity actions change the velocity that is flown by no more than this, m/s²: the on-board controller tips over when it is
    /// asked for more than the vehicle can do.
    pub max_accel_m_s2: f64,
    /// Greatest torque about each axis, N·m: needed by the kind `force_torque`, which has no other limit.
    pub max_torque_n_m: Option<[f64; 3]>,
}

impl Default for ActionConfig {
    fn default() -> Self {
        Self {
            kind: ActionKind::Attitude,
            normalized: true,
            max_tilt_rad: 0.5,
            max_yaw_rad: std::f64::consts::FRAC_PI_2,
            max_rate_rad_s: [6.0, 6.0, 3.0],
            max_speed_m_s: 2.5,
            max_yaw_rate_rad_s: 2.0,
            max_accel_m_s2: 4.0,
            max_torque_n_m: None,
        }
    }
}

/// Limits of one drone's action, in the units of its kind.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Limits {
    pub low: Vec<f64>,
    /// What 0 stands for.
    pub neutral: Vec<f64>,
    pub high: Vec<f64>,
}

impl ActionConfig {
    pub(super) fn check(&self) -> Result<(), EnvError> {
        let positive = |name: &str, got: f64, most: f64| {
            if got > 0.0 && got <= most {
                return Ok(());
            }
            Err(EnvError::option(format!("action {name}"), format!("more than 0, at most {most}"), got))
        };
        positive("max_tilt_rad", self.max_tilt_rad, std::f64::consts::FRAC_PI_2)?;
        positive("max_yaw_rad", self.max_yaw_rad, std::f64::consts::PI)?;
        for rate in self.max_rate_rad_s {
            positive("max_rate_rad_s", rate, 1e3)?;
        }
        positive("max_speed_m_s", self.max_speed_m_s, 1e3)?;
        positive("max_yaw_rate_rad_s", self.max_yaw_rate_rad_s, 1e3)?;
        positive("max_accel_m_s2", self.max_accel_m_s2, 1e4)?;
        for torque in self.max_torque_n_m.into_iter().flatten() {
            positive("max_torque_n_m", torque, 1e6)?;
        }
        if self.kind == ActionKind::ForceTorque && self.max_torque_n_m.is_none() {
            return Err(EnvError::option(
                "action max_torque_n_m",
                "three torques (N·m) for the kind force_torque",
                "none",
            ));
        }
        Ok(())
    }

    /// Limits for one vehicle; `n_rotors` rotors have entries.
    pub(super) fn limits(&self, drone: &Drone<f64>, n_rotors: usize) -> Limits {
        let p = &drone.controller;
        let thrust = [mellinger::limit_thrust(p, f64::MIN_POSITIVE), mellinger::limit_thrust(p, f64::MAX)];
        let hover = drone.hover_command().clamp(thrust[0], thrust[1]);
        let around = |most: [f64; 3], thrust_last: bool| {
            let three = |sign: f64| most.map(|v| sign * v).to_vec();
            let with = |mut list: Vec<f64>, thrust: f64| {
                list.insert(if thrust_last { 3 } else { 0 }, thrust);
                list
            };
            Limits {
                low: with(three(-1.0), thrust[0]),
                neutral: with(three(0.0), hover),
                high: with(three(1.0), thrust[1]),
            }
        };
        match self.kind {
            ActionKind::Attitude => around([self.max_tilt_rad, self.max_tilt_rad, self.max_yaw_rad], true),
            ActionKind::BodyRate => around(self.max_rate_rad_s, true),
            ActionKind::ForceTorque => around(self.max_torque_n_m.unwrap_or_default(), false),
            ActionKind::RotorVel => {
                let (mut low, mut high) = ([f64::MIN_POSITIVE; MAX_ROTORS], [1e9; MAX_ROTORS]);
                mellinger::limit_rotor_vel(p, &mut low);
                mellinger::limit_rotor_vel(p, &mut high);
                let hover = drone.hover_rotor_vel();
                let of = |list: &[f64; MAX_ROTORS]| list[..n_rotors].to_vec();
                // Rotors that this vehicle lacks have nothing to say.
                let none = |list: &mut [f64; MAX_ROTORS]| list[drone.airframe.n_rotors..].fill(0.0);
                none(&mut low);
                none(&mut high);
                Limits { low: of(&low), neutral: of(&hover), high: of(&high) }
            }
            ActionKind::Velocity => {
                let v = self.max_speed_m_s;
                let most = vec![v, v, v, self.max_yaw_rate_rad_s];
                Limits { low: most.iter().map(|v| -v).collect(), neutral: vec![0.0; 4], high: most }
            }
        }
    }
}

impl Limits {
    /// Entry `i` of an action in the units of its kind, and whether it lay outside the limits and was held within them.
    pub fn value(&self, normalized: bool, i: usize, action: f64) -> (f64, bool) {
        value([self.low[i], self.neutral[i], self.high[i]], normalized, action)
    }

    /// Entry `i` of an action as a number from −1 to 1, held within the limits.
    pub fn unit(&self, normalized: bool, i: usize, action: f64) -> f64 {
        if normalized {
            return action.clamp(-1.0, 1.0);
        }
        let off = action.clamp(self.low[i], self.high[i]) - self.neutral[i];
        let range = if off < 0.0 { self.neutral[i] - self.low[i] } else { self.high[i] - self.neutral[i] };
        if range > 0.0 { off / range } else { 0.0 }
    }

    /// Writes an action, whose numbers are those of a command, in the units of its kind. Returns whether an entry was held within the
    /// limits.
    #[inline]
    pub fn command(&self, normalized: bool, action: &[f32], command: &mut [f32]) -> bool {
        let limits = self.low.iter().zip(&self.neutral).zip(&self.high);
        let mut clipped = false;
        for ((a, to), ((low, middle), high)) in action.iter().zip(command).zip(limits) {
            let (value, held) = value([*low, *middle, *high], normalized, f64::from(*a));
            *to = value as f32;
            clipped |= held;
        }
        clipped
    }
}

/// An entry of an action in the units of its kind, by the least number, what 0 stands for, and the greatest; and whether it was held
/// within them.
#[inline(always)]
fn value([low, middle, high]: [f64; 3], normalized: bool, action: f64) -> (f64, bool) {
    if !normalized {
        return (action.clamp(low, high), action < low || action > high);
    }
    let a = action.clamp(-1.0, 1.0);
    let value = if a < 0.0 { middle + a * (middle - low) } else { middle + a * (high - middle) };
    (value, a != action)
}

/// The set-point of velocity actions does not run away farther than this from the drone, m …
const LEASH_M: f64 = 0.4;
/// … nor turn farther than this from its heading, rad.
const LEASH_RAD: f64 = 0.6;

/// A set-point that moves as velocity actions say.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct SetPoint {
    pub pos_m: [f64; 3],
    pub vel_m_s: [f64; 3],
    pub yaw_rad: f64,
}

impl SetPoint {
    /// Moves it for `dt_s` by `action` (velocity along the heading, to the left, upwards; yaw rate), its velocity changing by no more
    /// than `accel_m_s2`, and writes the command of control mode `state`. The drone is at `pos_m` with heading `yaw_rad`.
    pub fn follow(
        &mut self,
        action: [f64; 4],
        (pos_m, yaw_rad): ([f64; 3], f64),
        accel_m_s2: f64,
        dt_s: f64,
        command: &mut [f32],
    ) {
        let (sin, cos) = self.yaw_rad.sin_cos();
        let [forward, left, up, turn] = action;
        let wanted = [cos * forward - sin * left, sin * forward + cos * left, up];
        let change = vec3::sub(wanted, self.vel_m_s);
        let (size, most) = (vec3::norm(change), accel_m_s2 * dt_s);
        let change = if size > most { vec3::scale(change, most / size) } else { change };
        self.vel_m_s = vec3::add(self.vel_m_s, change);
        self.pos_m = vec3::add(self.pos_m, vec3::scale(self.vel_m_s, dt_s));
        let off = vec3::sub(self.pos_m, pos_m);
        let length = vec3::norm(off);
        if length > LEASH_M {
            self.pos_m = vec3::add(pos_m, vec3::scale(off, LEASH_M / length));
        }
        // The nearer way around from the heading to the set-point.
        let ahead =
            (self.yaw_rad + turn * dt_s - yaw_rad).sin().atan2((self.yaw_rad + turn * dt_s - yaw_rad).cos());
        self.yaw_rad = yaw_rad + ahead.clamp(-LEASH_RAD, LEASH_RAD);
        let (sin, cos) = (0.5 * self.yaw_rad).sin_cos();
        // No acceleration: one that jumps at every step makes the attitude loop tip over.
        let mut numbers = [0.0; 16];
        numbers[0..3].copy_from_slice(&self.pos_m);
        numbers[3..6].copy_from_slice(&self.vel_m_s);
        numbers[9..13].copy_from_slice(&[0.0, 0.0, sin, cos]);
        numbers[15] = turn;
        for (to, v) in command.iter_mut().zip(numbers) {
            *to = v as f32;
        }
    }
}
