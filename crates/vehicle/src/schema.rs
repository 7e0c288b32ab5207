//! A vehicle file as it stands on disk: numbers in the unit that their key names, with source, note and sigma per table.
//!
//! `docs/vehicles.md` explains every key. [`super::Vehicle::from_file`] checks the values and converts them to SI.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Standard deviations by key, in the value's unit: a number; an array of the value's shape; or, where not all numbers
/// of the array have one, a table by index (`factor.2 = 0.01`, `drag_n_s_per_m.0.0 = 0.001`).
pub type Sigma = BTreeMap<String, toml::Value>;

/// Declares a table of the file. Every table may say where its values come from (`source`), what is to be known about
/// them (`note`) and how certain they are (`sigma`); tables below it follow after `tables:`.
macro_rules! table {
    (
        $(#[$meta:meta])*
        pub struct $name:ident {
            $($(#[$fmeta:meta])* $field:ident: $ty:ty,)*
            $(; tables: $($(#[$tmeta:meta])* $table:ident: $tty:ty,)*)?
        }
    ) => {
        $(#[$meta])*
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct $name {
            $($(#[$fmeta])* pub $field: $ty,)*
            /// Where the values of this table come from.
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub source: Option<String>,
            /// What is to be known about the values of this table.
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub note: Option<String>,
            /// Standard deviations of the values of this table, where known.
            #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
            pub sigma: Sigma,
            $($($(#[$tmeta])* pub $table: $tty,)*)?
        }
    };
}

/// The whole file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VehicleFile {
    /// One line about the vehicle.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub description: Option<String>,
    /// Name of a shell in `xml/shells`, or path of a shell's MJCF file relative to the vehicle file.
    pub shell: String,
    /// Mass properties and gravity.
    pub body: Body,
    /// What rotors have in common.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotor_default: Option<Rotor>,
    /// The rotors, 1 to 8.
    pub rotor: Vec<Rotor>,
    /// Motors by throttle and voltage.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub throttle: Option<ThrottleTable>,
    /// Fitted attitude responses.
    #[serde(default, skip_serializing_if = "AttitudeResponses::is_empty")]
    pub attitude_response: AttitudeResponses,
    /// On-board controller.
    pub controller: Controllers,
    /// Rates of the controller's stages.
    pub rates: RatesTable,
    /// What else acts on the vehicle, in order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub effect: Vec<EffectEntry>,
}

table! {
    /// `[body]`.
    pub struct Body {
        /// Mass with battery, kg.
        mass_kg: f64,
        /// Inertia about the centre of mass, kg·m², body axes, symmetric.
        inertia_kg_m2: [[f64; 3]; 3],
        /// Gravity, m/s², world (z up).
        gravity_m_s2: [f64; 3],
    }
}

table! {
    /// `[rotor_default]` and `[[rotor]]`. A rotor takes what it does not state from the default. Curves and dynamics may be
    /// written in the unit in which they were published; one form of each is allowed per table.
    #[derive(Default)]
    pub struct Rotor {
        /// Hub position from the centre of mass, m, body (`[[rotor]]` only).
        #[serde(default, skip_serializing_if = "Option::is_none")]
        position_m: Option<[f64; 3]>,
        /// Unit direction of thrust, body; z up if absent.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        axis: Option<[f64; 3]>,
        /// +1 turns clockwise seen from above (torque on the body along +axis), −1 counter-clockwise (`[[rotor]]` only).
        #[serde(default, skip_serializing_if = "Option::is_none")]
        spin: Option<f64>,
        /// Thrust c0 + c1 n + c2 n² of the speed n in rpm: N, N/rpm, N/rpm².
        #[serde(default, skip_serializing_if = "Option::is_none")]
        thrust_curve_n_per_rpm: Option<[f64; 3]>,
        /// Thrust c0 + c1 Ω + c2 Ω²: N, N·s/rad, N·s²/rad².
        #[serde(default, skip_serializing_if = "Option::is_none")]
        thrust_curve_n_per_rad_s: Option<[f64; 3]>,
        /// Torque c0 + c1 n + c2 n² of the speed n in rpm: N·m, N·m/rpm, N·m/rpm².
        #[serde(default, skip_serializing_if = "Option::is_none")]
        torque_curve_n_m_per_rpm: Option<[f64; 3]>,
        /// Torque c0 + c1 Ω + c2 Ω²: N·m, N·m·s/rad, N·m·s²/rad².
        #[serde(default, skip_serializing_if = "Option::is_none")]
        torque_curve_n_m_per_rad_s: Option<[f64; 3]>,
        /// Torque as a fixed share of thrust, m.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        torque_per_thrust_m: Option<f64>,
        /// Spin-up c_v (1/s) and c_d (1/(rpm·s)).
        #[serde(default, skip_serializing_if = "Option::is_none")]
        spin_up_per_s_and_per_rpm_s: Option<[f64; 2]>,
        /// Spin-up c_v (1/s) and c_d (1/rad).
        #[serde(default, skip_serializing_if = "Option::is_none")]
        spin_up_per_s_and_per_rad: Option<[f64; 2]>,
        /// Spin-up as a first-order lag, s.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        time_constant_up_s: Option<f64>,
        /// Spin-down c_v (1/s) and c_d (1/(rpm·s)).
        #[serde(default, skip_serializing_if = "Option::is_none")]
        spin_down_per_s_and_per_rpm_s: Option<[f64; 2]>,
        /// Spin-down c_v (1/s) and c_d (1/rad).
        #[serde(default, skip_serializing_if = "Option::is_none")]
        spin_down_per_s_and_per_rad: Option<[f64; 2]>,
        /// Spin-down as a first-order lag, s.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        time_constant_down_s: Option<f64>,
        /// Inertia of propeller and motor bell about the axis, kg·m²; 0 drops gyroscopic and reaction torque.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        inertia_kg_m2: Option<f64>,
        /// Propeller radius, m.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        radius_m: Option<f64>,
    }
}

/// Which voltage the throttle is a share of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ThrottleOf {
    /// That of the battery, as it is at the time.
    #[default]
    Battery,
    /// The nominal one: the firmware makes up for the battery.
    Nominal,
}

table! {
    /// `[throttle]`: motors by throttle and voltage, u V = c + a Ω + b Ω² ([`propwash_physics::throttle`]). It turns logged
    /// throttles (`cmd_u1` …) into rotor commands.
    pub struct ThrottleTable {
        /// Voltage c at which a motor starts to turn, V.
        #[serde(default)]
        offset_v: f64,
        /// Back-EMF a, V·s/rad.
        back_emf_v_s_per_rad: f64,
        /// Voltage b for the propeller's torque, V·s²/rad².
        #[serde(default)]
        load_v_s2_per_rad2: f64,
        /// Voltage where none is logged, V.
        nominal_v: f64,
        /// Which voltage the throttle is a share of.
        #[serde(default)]
        voltage: ThrottleOf,
    }
}

/// `[attitude_response]`: one table per fitted model.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AttitudeResponses {
    /// Thrust answers at once.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub so_rpy: Option<Response>,
    /// Thrust lags.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub so_rpy_rotor: Option<Response>,
    /// Thrust lags; fitted together with linear drag.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub so_rpy_rotor_drag: Option<Response>,
}

impl AttitudeResponses {
    fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

table! {
    /// `[attitude_response.*]`: roll, pitch, yaw as second-order systems, thrust as a scaled command.
    pub struct Response {
        /// Thrust added to the scaled command, N.
        thrust_offset_n: f64,
        /// Thrust per commanded thrust.
        thrust_scale: f64,
        /// Rate at which thrust follows its command, 1/s; not in `so_rpy`.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        thrust_rate_per_s: Option<f64>,
        /// Angular acceleration per angle of roll, pitch, yaw, 1/s².
        angle_gain_per_s2: [f64; 3],
        /// Angular acceleration per angular rate, 1/s.
        rate_gain_per_s: [f64; 3],
        /// Angular acceleration per commanded angle, 1/s².
        command_gain_per_s2: [f64; 3],
    }
}

/// `[controller]`: exactly one of its tables.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Controllers {
    /// The Mellinger controller of the Crazyflie firmware.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mellinger: Option<Mellinger>,
    /// No control law on board: rotor speeds are commanded.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub direct: Option<Direct>,
}

table! {
    /// `[controller.direct]`: what a vehicle without a control law knows about its rotors.
    pub struct Direct {
        /// Least thrust of one turning rotor, N.
        thrust_min_n: f64,
        /// Greatest thrust of one rotor, N.
        thrust_max_n: f64,
    }
}

table! {
    /// `[controller.mellinger]`: what the firmware believes about the vehicle.
    pub struct Mellinger {
        /// Mass that the controller assumes, kg.
        mass_kg: f64,
        /// PWM per newton of wanted thrust.
        mass_thrust_pwm_per_n: f64,
        /// Least PWM of a turning motor.
        pwm_min: f64,
        /// Greatest PWM.
        pwm_max: f64,
        /// Least thrust of one turning rotor, N.
        thrust_min_n: f64,
        /// Greatest thrust of one rotor, N.
        thrust_max_n: f64,
        /// Bound of the torque command about x, y, z, PWM.
        torque_pwm_max: [f64; 3],
        /// Torque about the rotor axis per thrust, m.
        thrust_to_torque_m: f64,
        ; tables:
        /// State stage.
        state: StateStage,
        /// Attitude stage.
        attitude: AttitudeStage,
        /// Body-rate stage.
        body_rate: AttitudeStage,
    }
}

table! {
    /// `[controller.mellinger.state]`.
    pub struct StateStage {
        /// Proportional gain, N/m.
        kp_n_per_m: [f64; 3],
        /// Derivative gain, N·s/m.
        kd_n_s_per_m: [f64; 3],
        /// Integral gain, N/(m·s).
        ki_n_per_m_s: [f64; 3],
        /// Bound of the integral, m·s.
        integral_max_m_s: [f64; 3],
    }
}

table! {
    /// `[controller.mellinger.attitude]` and `[controller.mellinger.body_rate]`.
    pub struct AttitudeStage {
        /// Gain on the rotation error, PWM.
        kr_pwm: [f64; 3],
        /// Gain on the rate error, PWM·s.
        kw_pwm_s: [f64; 3],
        /// Gain on the integral of the rotation error, PWM/s.
        ki_pwm_per_s: [f64; 3],
        /// Gain on the derivative of the rate error, PWM·s².
        kd_omega_pwm_s2: [f64; 3],
        /// Bound of the integral, s.
        integral_max_s: [f64; 3],
    }
}

table! {
    /// `[rates]`: how often each stage of the controller runs.
    pub struct RatesTable {
        /// State stage, Hz.
        state_hz: u32,
        /// Attitude stage, Hz.
        attitude_hz: u32,
        /// Body-rate stage, Hz.
        body_rate_hz: u32,
        /// Mixer, Hz.
        force_torque_hz: u32,
    }
}

/// `[[effect]]`: one effect of [`propwash_physics::effects`]. Its parameters carry the names of the effect's `Params`
/// fields; those that are absent keep their defaults. Those of an `expression` are described in
/// `docs/effects/expression.md`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EffectEntry {
    /// Name of the effect, one of [`propwash_physics::effects::KINDS`].
    pub kind: String,
    /// Dynamics that have the effect; all if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub models: Option<Vec<String>>,
    /// Where the values come from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<String>,
    /// SHA-256 of the log or logs to which the values were fitted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source_log_sha256: Option<LogHashes>,
    /// When they were fitted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub date: Option<String>,
    /// What is to be known about them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub note: Option<String>,
    /// Parameters by name.
    #[serde(flatten)]
    pub params: BTreeMap<String, toml::Value>,
    /// Standard deviations by parameter.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub sigma: Sigma,
}

/// `source_log_sha256`: one text, or a list of them.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged, expecting = "invalid type: expected a SHA-256 in quotes or a list of them")]
pub enum LogHashes {
    /// One log.
    One(String),
    /// Several logs.
    Several(Vec<String>),
}

impl LogHashes {
    /// The hashes.
    pub fn as_slice(&self) -> &[String] {
        match self {
            Self::One(hash) => std::slice::from_ref(hash),
            Self::Several(hashes) => hashes,
        }
    }
}
