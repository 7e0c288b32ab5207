//! Motor mixing: collective thrust and torque to the thrust of each rotor, and back.

use crate::physics::params::parameters;
use crate::physics::rigid_body::MAX_ROTORS;
use crate::scalar::Real;

parameters! {
    /// What the controller believes about the rotors. Rows from `n_rotors` on are zero.
    pub struct Params {
        /// Legacy mixing signs of roll, pitch, yaw per rotor (power_distribution_quadrotor.c of the Crazyflie firmware).
        signs: [[S; 3]; MAX_ROTORS],
        /// Thrust of each rotor per collective thrust (1) and torque x, y, z (1/m).
        rotor_from_wrench: [[S; 4]; MAX_ROTORS],
        /// Contribution of each rotor's thrust to collective thrust (1) and torque x, y, z (m).
        wrench_from_rotor: [[S; 4]; MAX_ROTORS],
        ; fixed:
        /// Number of rotors.
        n_rotors: usize,
    }
}

/// Rotor thrusts (N) for collective thrust (N) and torque (N·m, body).
#[inline(always)]
pub fn rotors_from_wrench<S: Real>(p: &Params<S>, wrench: [S; 4]) -> [S; MAX_ROTORS] {
    let mut out = [S::zero(); MAX_ROTORS];
    for i in 0..p.n_rotors {
        let row = p.rotor_from_wrench[i];
        out[i] = row[0] * wrench[0] + row[1] * wrench[1] + row[2] * wrench[2] + row[3] * wrench[3];
    }
    out
}

/// Collective thrust (N) and torque (N·m, body) of rotor thrusts (N).
#[inline(always)]
pub fn wrench_from_rotors<S: Real>(p: &Params<S>, thrust: &[S; MAX_ROTORS]) -> [S; 4] {
    let mut out = [S::zero(); 4];
    for i in 0..p.n_rotors {
        for k in 0..4 {
            out[k] = out[k] + p.wrench_from_rotor[i][k] * thrust[i];
        }
    }
    out
}
