//! What flight stacks in software-in-the-loop (SITL) and their simulators tell each other, as functions over bytes.
//!
//! | stack | link | the simulator sends | the stack sends |
//! | --- | --- | --- | --- |
//! | PX4 ([`px4`]) | TCP, MAVLink | `HIL_SENSOR`, `HIL_GPS`, `HIL_STATE_QUATERNION` | `HIL_ACTUATOR_CONTROLS` |
//! | ArduPilot ([`ardupilot`]) | UDP | a line of JSON | pulse widths |
//! | Betaflight ([`betaflight`]) | UDP | a block of doubles | motor commands |
//!
//! Nothing here opens a socket or simulates: `propwash::sitl` does. Ours is a world whose x points north, y west and z up, and a body
//! whose x points forward, y left and z up; the functions turn that into the frames of each stack ([`frames`]).

#![forbid(unsafe_code)]

pub mod ardupilot;
pub mod betaflight;
pub mod earth;
mod error;
pub mod frames;
pub mod motors;
pub mod px4;

pub use error::ProtocolError;

/// Most motors that any of the stacks commands.
pub const MAX_MOTORS: usize = 32;

/// A flight stack that can be served.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Stack {
    /// PX4, by the MAVLink messages `HIL_*` over TCP.
    #[default]
    Px4,
    /// ArduPilot, by its JSON interface over UDP.
    ArduPilot,
    /// Betaflight, by the packets of its target SITL over UDP.
    Betaflight,
}

impl Stack {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Px4, Self::ArduPilot, Self::Betaflight];

    /// Name as on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Px4 => "px4",
            Self::ArduPilot => "ardupilot",
            Self::Betaflight => "betaflight",
        }
    }

    /// Name as its authors write it.
    pub fn title(self) -> &'static str {
        match self {
            Self::Px4 => "PX4",
            Self::ArduPilot => "ArduPilot",
            Self::Betaflight => "Betaflight",
        }
    }

    /// The stack of this name.
    pub fn of(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|stack| stack.name() == name)
    }

    /// Port on which the simulator is expected: PX4 connects to TCP 4560, ArduPilot and Betaflight send to UDP 9002.
    pub fn port(self) -> u16 {
        match self {
            Self::Px4 => px4::PORT,
            Self::ArduPilot => ardupilot::PORT,
            Self::Betaflight => betaflight::PORT_MOTORS,
        }
    }

    /// Steps per second of the exchange unless asked otherwise: 250 Hz as PX4's simulators send, 400 Hz of ArduCopter's main loop until
    /// ArduPilot says its own rate, 1000 Hz for Betaflight.
    pub fn rate_hz(self) -> u32 {
        match self {
            Self::Px4 => 250,
            Self::ArduPilot => 400,
            Self::Betaflight => 1000,
        }
    }
}

/// Where a vehicle truly is and how it moves, in our frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// Time since the start, s.
    pub time_s: f64,
    /// Position from where it stood at the start, m, world (north, west, up).
    pub pos_m: [f64; 3],
    /// Attitude, xyzw, body to world.
    pub quat_xyzw: [f64; 4],
    /// Velocity, m/s, world.
    pub vel_m_s: [f64; 3],
    /// Angular velocity, rad/s, body.
    pub ang_vel_rad_s: [f64; 3],
    /// Specific force, m/s², body: what an ideal accelerometer reads, +9.8 along z at rest.
    pub accel_m_s2: [f64; 3],
    /// Velocity of the air, m/s, world.
    pub wind_m_s: [f64; 3],
}

impl Default for Truth {
    /// At rest where it stood at the start, level, facing north.
    fn default() -> Self {
        Self {
            time_s: 0.0,
            pos_m: [0.0; 3],
            quat_xyzw: [0.0, 0.0, 0.0, 1.0],
            vel_m_s: [0.0; 3],
            ang_vel_rad_s: [0.0; 3],
            accel_m_s2: [0.0, 0.0, earth::GRAVITY_M_S2],
            wind_m_s: [0.0; 3],
        }
    }
}

impl Truth {
    /// Time in whole microseconds.
    pub fn time_us(&self) -> u64 {
        (self.time_s * 1e6).round() as u64
    }

    /// Speed of the air along the body's x axis, m/s: what a pitot tube measures, never negative.
    pub fn airspeed_m_s(&self) -> f64 {
        let air = core::array::from_fn(|k| self.vel_m_s[k] - self.wind_m_s[k]);
        propwash_trace::math::quat::rotate_inverse(self.quat_xyzw, air)[0].max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stacks_are_found_by_their_names() {
        for stack in Stack::ALL {
            assert_eq!(Stack::of(stack.name()), Some(stack));
        }
        assert_eq!(Stack::of("inav"), None);
        assert_eq!(Stack::ALL.map(Stack::port), [4560, 9002, 9002]);
    }

    #[test]
    fn a_pitot_tube_feels_head_wind_alone() {
        let truth = Truth { vel_m_s: [10.0, 3.0, 1.0], wind_m_s: [-2.0, 3.0, 0.0], ..Truth::default() };
        assert!((truth.airspeed_m_s() - 12.0).abs() < 1e-12);
        assert_eq!(Truth { vel_m_s: [-5.0, 0.0, 0.0], ..Truth::default() }.airspeed_m_s(), 0.0);
        assert_eq!(Truth { time_s: 0.004, ..truth }.time_us(), 4000);
    }
}
