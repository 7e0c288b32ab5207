//! What sensors on a vehicle read for a given state.

pub use super::rigid_body::{Rate, State};
use propwash_trace::Real;
use propwash_trace::math::{quat, vec3};

/// What all sensors of a vehicle read at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading<S> {
    /// Position by motion capture, m, world.
    pub pos: [S; 3],
    /// Attitude by motion capture, xyzw, body to world.
    pub quat: [S; 4],
    /// Velocity, m/s, world.
    pub vel: [S; 3],
    /// Gyroscope, rad/s, body.
    pub gyro: [S; 3],
    /// Accelerometer (specific force), m/s², body.
    pub accel: [S; 3],
    /// Angular acceleration, rad/s², body: no sensor reads it, but it moves an accelerometer beside the centre of mass.
    pub ang_acc: [S; 3],
}

impl<S: Real> Reading<S> {
    /// What ideal sensors at the centre of mass read.
    #[inline(always)]
    pub fn ideal(state: &State<S>, rate: &Rate<S>, gravity_m_s2: [S; 3]) -> Self {
        Self {
            pos: state.pos,
            quat: state.quat,
            vel: state.vel,
            gyro: gyroscope(state),
            accel: accelerometer(state, rate, gravity_m_s2),
            ang_acc: rate.ang_acc,
        }
    }
}

/// How late the samples of each sensor are: a sample stamped t was taken at t − delay, s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clock<S> {
    /// Motion capture (position, attitude, velocity).
    pub pose_s: S,
    /// Gyroscope.
    pub gyro_s: S,
    /// Accelerometer.
    pub accel_s: S,
    /// What drives the model where that was measured: rotor speeds, thrust.
    pub inputs_s: S,
}

impl<S: Real> Clock<S> {
    /// All in step.
    pub fn zero() -> Self {
        Self { pose_s: S::zero(), gyro_s: S::zero(), accel_s: S::zero(), inputs_s: S::zero() }
    }

    /// Both delays one after the other.
    #[inline(always)]
    pub fn plus(self, other: Self) -> Self {
        Self {
            pose_s: self.pose_s + other.pose_s,
            gyro_s: self.gyro_s + other.gyro_s,
            accel_s: self.accel_s + other.accel_s,
            inputs_s: self.inputs_s + other.inputs_s,
        }
    }

    /// The sensors' delays counted from the stamps of measured inputs, which then have none.
    #[inline(always)]
    pub fn from_inputs(self) -> Self {
        let late = self.inputs_s;
        Self {
            pose_s: self.pose_s - late,
            gyro_s: self.gyro_s - late,
            accel_s: self.accel_s - late,
            inputs_s: S::zero(),
        }
    }
}

/// Specific force at the centre of mass, m/s², body: what an ideal accelerometer reads, R⁻¹ (v̇ − g).
#[inline(always)]
pub fn accelerometer<S: Real>(state: &State<S>, rate: &Rate<S>, gravity_m_s2: [S; 3]) -> [S; 3] {
    quat::rotate_inverse(state.quat, vec3::sub(rate.acc, gravity_m_s2))
}

/// Angular velocity, rad/s, body: what an ideal gyroscope reads.
#[inline(always)]
pub fn gyroscope<S: Real>(state: &State<S>) -> [S; 3] {
    state.ang_vel
}

/// Position (m, world) of a point fixed to the body at `offset_m` (body): what motion capture reads of a marker there.
#[inline(always)]
pub fn marker<S: Real>(state: &State<S>, offset_m: [S; 3]) -> [S; 3] {
    vec3::add(state.pos, quat::rotate(state.quat, offset_m))
}
