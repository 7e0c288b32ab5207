//! What sensors on a vehicle read for a given state.

pub use super::rigid_body::{Rate, State};
use crate::math::{quat, vec3};
use crate::scalar::Real;

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
