//! On-board control laws, in stages: state → attitude → force and torque → rotor speeds.

use propwash_trace::Real;

pub mod mellinger;
pub mod mixer;

/// What a command means.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ControlMode {
    /// 16 numbers: position (m), velocity (m/s), acceleration (m/s²), attitude xyzw of which yaw is used, body rates
    /// (rad/s); world frame but for the rates.
    #[default]
    State,
    /// Roll, pitch, yaw (rad), collective thrust (N).
    Attitude,
    /// Body rates (rad/s), collective thrust (N).
    BodyRate,
    /// Collective thrust (N), torque (N·m, body).
    ForceTorque,
    /// Rotor speeds, rad/s.
    RotorVel,
}

impl ControlMode {
    /// All modes.
    pub const ALL: [Self; 5] =
        [Self::State, Self::Attitude, Self::BodyRate, Self::ForceTorque, Self::RotorVel];

    /// Numbers of a command for a vehicle with `n_rotors` rotors.
    pub fn width(self, n_rotors: usize) -> usize {
        match self {
            Self::State => 16,
            Self::Attitude | Self::BodyRate | Self::ForceTorque => 4,
            Self::RotorVel => n_rotors,
        }
    }

    /// Name as in files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::State => "state",
            Self::Attitude => "attitude",
            Self::BodyRate => "body_rate",
            Self::ForceTorque => "force_torque",
            Self::RotorVel => "rotor_vel",
        }
    }
}

/// Most numbers of any command.
pub const COMMAND_WIDTH: usize = 16;

/// Declares a struct whose fields are arrays of `S`, with its length and its conversion from and to consecutive numbers.
macro_rules! flat {
    ($(#[$meta:meta])* pub struct $name:ident { $($(#[$fmeta:meta])* $field:ident: $len:expr,)* }) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub struct $name<S> { $($(#[$fmeta])* pub $field: [S; $len],)* }

        impl<S: Real> $name<S> {
            /// Numbers in all fields together.
            pub const LEN: usize = 0 $(+ $len)*;

            /// Fields in order, with their lengths.
            const FIELDS: &[(&str, usize)] = &[$((stringify!($field), $len),)*];

            /// All numbers zero.
            pub fn zero() -> Self {
                Self { $($field: [S::zero(); $len],)* }
            }
            /// From `get(index)`, index running over the fields in order of declaration.
            #[inline(always)]
            pub fn load(mut get: impl FnMut(usize) -> S) -> Self {
                let mut out = Self::zero();
                let mut k = 0;
                $(for slot in &mut out.$field { *slot = get(k); k += 1; })*
                let _ = k;
                out
            }
            /// To `put(index, number)`.
            #[inline(always)]
            pub fn store(&self, mut put: impl FnMut(usize, S)) {
                let mut k = 0;
                $(for slot in &self.$field { put(k, *slot); k += 1; })*
                let _ = k;
            }
        }
    };
}

flat! {
    /// What the on-board controller remembers between its ticks.
    pub struct Memory {
        /// State command in force.
        state_cmd: 16,
        /// Integral of the position error, m·s.
        pos_err_integral: 3,
        /// Attitude command waiting for the attitude stage: roll, pitch, yaw (rad), thrust (N).
        staged_attitude: 4,
        /// Body rates waiting for the attitude stage, rad/s.
        staged_ang_vel: 3,
        /// Attitude command in force.
        attitude_cmd: 4,
        /// Body-rate set-point in force, rad/s.
        ang_vel_cmd: 3,
        /// Integral of the attitude error, rad·s.
        attitude_err_integral: 3,
        /// Angular velocity at the last tick of the attitude stage, rad/s.
        prev_ang_vel: 3,
        /// 1 after the first tick of the attitude stage; before it there is no last tick to differ from.
        attitude_ticked: 1,
        /// Force (N) and torque (N·m) waiting for the mixer.
        staged_force_torque: 4,
        /// Force and torque in force.
        force_torque_cmd: 4,
        /// Rotor speeds in force, rad/s.
        rotor_cmd: crate::rigid_body::MAX_ROTORS,
    }
}

impl<S: Real> Memory<S> {
    /// Numbers that a control mode reads or changes, by index, for vehicles of at most `n_rotors` rotors. All others stay zero.
    pub fn used(mode: ControlMode, n_rotors: usize) -> Vec<usize> {
        let mut out = Vec::new();
        let mut first = 0;
        for (field, len) in Self::FIELDS {
            let n = match (*field, mode) {
                ("rotor_cmd", _) => n_rotors,
                ("state_cmd" | "pos_err_integral" | "staged_ang_vel", ControlMode::State) => *len,
                ("state_cmd" | "pos_err_integral" | "staged_ang_vel", _) => 0,
                ("staged_attitude", ControlMode::BodyRate) => 0,
                (_, ControlMode::State | ControlMode::Attitude | ControlMode::BodyRate) => *len,
                ("staged_force_torque" | "force_torque_cmd", ControlMode::ForceTorque) => *len,
                (_, ControlMode::ForceTorque | ControlMode::RotorVel) => 0,
            };
            out.extend(first..first + n);
            first += len;
        }
        out
    }
}

/// Which stages tick in this step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Due {
    /// State stage.
    pub state: bool,
    /// Attitude or body-rate stage.
    pub attitude: bool,
    /// Mixer.
    pub force_torque: bool,
}

/// Rates of the stages, Hz.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Rates {
    /// State stage, Hz.
    pub state_hz: u32,
    /// Attitude stage, Hz.
    pub attitude_hz: u32,
    /// Body-rate stage, Hz.
    pub body_rate_hz: u32,
    /// Mixer, Hz.
    pub force_torque_hz: u32,
}

impl Rates {
    /// What ticks at simulation step `step` (from 0) of a simulation at `sim_hz`.
    ///
    /// Exact for any ratio: a stage of `f` Hz ticks `f` times in every second. Its n-th tick falls on the first step at or
    /// after n / f.
    pub fn due(&self, mode: ControlMode, step: u64, sim_hz: u32) -> Due {
        let attitude_hz = if mode == ControlMode::BodyRate { self.body_rate_hz } else { self.attitude_hz };
        Due {
            state: ticks(step, self.state_hz, sim_hz),
            attitude: ticks(step, attitude_hz, sim_hz),
            force_torque: ticks(step, self.force_torque_hz, sim_hz),
        }
    }
}

/// Whether a stage of `stage_hz` ticks at `step` of a simulation at `sim_hz`: whether a multiple of 1/stage_hz lies in
/// ((step − 1)/sim_hz, step/sim_hz].
pub fn ticks(step: u64, stage_hz: u32, sim_hz: u32) -> bool {
    let (f, n) = (u64::from(stage_hz), u64::from(sim_hz));
    // A multiple lies there where step · f, in units of 1/(f · n), is less than one step past it.
    step == 0 || f >= n || (step % n) * f % n < f
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stage_ticks_exactly_as_often_as_its_rate_says() {
        for (stage, sim) in [(400, 500), (100, 500), (500, 500), (333, 1000), (50, 50), (7, 240)] {
            for second in 0..3u64 {
                let range = second * sim..(second + 1) * sim;
                let count = range.filter(|s| ticks(*s, stage as u32, sim as u32)).count() as u64;
                assert_eq!(count, stage, "{stage} Hz in a {sim} Hz simulation, second {second}");
            }
        }
    }

    #[test]
    fn a_tick_falls_on_the_first_step_at_or_after_its_time() {
        for (stage, sim) in
            [(400u32, 500u32), (333, 1000), (7, 240), (500, 500), (900, 500), (u32::MAX, u32::MAX - 1)]
        {
            let (f, n) = (u128::from(stage), u128::from(sim));
            for step in (0..2000u64).chain(u64::MAX - 2000..=u64::MAX) {
                let s = u128::from(step);
                let expected = step == 0 || s * f / n > (s - 1) * f / n;
                assert_eq!(ticks(step, stage, sim), expected, "{stage} Hz in {sim} Hz, step {step}");
            }
        }
    }

    #[test]
    fn memory_survives_a_round_trip() {
        let memory = Memory::<f64>::load(|i| i as f64);
        let mut numbers = vec![0.0; Memory::<f64>::LEN];
        memory.store(|i, v| numbers[i] = v);
        assert!(numbers.iter().enumerate().all(|(i, v)| *v == i as f64));
    }
}
