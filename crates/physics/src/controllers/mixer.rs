//! Motor mixing: collective thrust and torque to the thrust of each rotor, and back.

use crate::params::parameters;
use crate::rigid_body::MAX_ROTORS;
use propwash_trace::Real;

parameters! {
    /// What the controller believes about the rotors. Rows from `n_rotors` on are zero.
    pub struct Params {
        /// Legacy mixing signs of roll, pitch, yaw per rotor (power_distribution_quadrotor.c of the Crazyflie firmware).
        signs: [[S; 3]; MAX_ROTORS],
        /// Thrust of each rotor per collective thrust (1) and torque x, y, z (1/m).
        rotor_from_wrench: [[S; 4]; MAX_ROTORS],
        /// Contribution of each rotor's thrust to collective thrust (1) and torque x, y, z (m).
        wrench_from_rotor: [[S; 4]; MAX_ROTORS],
        /// What `rotor_from_wrench` after `wrench_from_rotor` does to the thrusts of four rotors beside giving them back:
        /// nothing where they can make every wrench, also in derivatives. [`Params::refresh`] keeps it true.
        beside: [[S; 4]; 4],
        ; fixed:
        /// Number of rotors.
        n_rotors: usize,
    }
}

/// Entries of [`Params::beside`] below this are rounding.
const ROUNDING: f64 = 1e-9;

impl<S: Real> Params<S> {
    /// Recomputes what follows from other parameters; call it after changing them.
    pub fn refresh(&mut self) {
        let zero = S::zero();
        self.beside = [[zero; 4]; 4];
        // Only of four rotors; see `rotors_from_rotors`.
        let rows = match self.n_rotors {
            4 => 0..4,
            _ => 0..0,
        };
        for i in rows {
            for j in 0..4 {
                let mut sum = if i == j { -S::one() } else { zero };
                for k in 0..4 {
                    sum = sum + self.rotor_from_wrench[i][k] * self.wrench_from_rotor[j][k];
                }
                self.beside[i][j] = S::select(sum.abs().lt(S::lit(ROUNDING)), zero, sum);
            }
        }
    }
}

/// The rotor thrusts (N) for the collective thrust and torque that given rotor thrusts (N) make: the same as
/// [`rotors_from_wrench`] of [`wrench_from_rotors`]. Four rotors that can make every wrench get back what they gave.
#[inline(always)]
pub fn rotors_from_rotors<S: Real>(p: &Params<S>, thrust: &[S; MAX_ROTORS]) -> [S; MAX_ROTORS] {
    match p.n_rotors {
        4 => {
            let mut out = *thrust;
            for i in 0..4 {
                for j in 0..4 {
                    out[i] = out[i] + p.beside[i][j] * thrust[j];
                }
            }
            out
        }
        _ => rotors_from_wrench(p, wrench_from_rotors(p, thrust)),
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
