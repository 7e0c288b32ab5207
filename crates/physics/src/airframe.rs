//! Rotors on a body: places and spin directions to force and torque, for any geometry.

use super::params::{Parameters, parameters};
use super::rigid_body::MAX_ROTORS;
use super::rotor;
use propwash_trace::Real;
use propwash_trace::math::vec3;

parameters! {
    /// All rotors of a vehicle; entries from `n_rotors` on are unused.
    pub struct Params {
        /// The rotors.
        rotors: [rotor::Params<S>; MAX_ROTORS],
        ; fixed:
        /// Number of rotors in use.
        n_rotors: usize,
    }
}

/// What the rotors give at one instant.
#[derive(Clone, Copy, Debug)]
pub struct Loads<S> {
    /// Thrust of each rotor, N.
    pub thrust: [S; MAX_ROTORS],
    /// Aerodynamic torque of each rotor about its axis, N·m, before its sign.
    pub torque: [S; MAX_ROTORS],
}

/// Thrust and torque of every rotor from its curves, at speeds in rad/s.
#[inline(always)]
pub fn loads<S: Real>(p: &Params<S>, rotor_vel: &[S; MAX_ROTORS]) -> Loads<S> {
    let mut out = Loads { thrust: [S::zero(); MAX_ROTORS], torque: [S::zero(); MAX_ROTORS] };
    for i in 0..p.n_rotors {
        out.thrust[i] = rotor::curve(p.rotors[i].thrust_curve, rotor_vel[i]);
        out.torque[i] = rotor::curve(p.rotors[i].torque_curve, rotor_vel[i]);
    }
    out
}

/// Force (N, body) and torque (N·m, body) of the rotors on the body.
///
/// Thrust acts at the hub, the aerodynamic torque about the axis; the spinning rotors carry the angular momentum
/// h = −Σ sᵢ Jᵢ Ωᵢ aᵢ, so the body feels the gyroscopic torque −ω × h and the reaction torque −ḣ.
#[inline(always)]
pub fn wrench<S: Real>(
    p: &Params<S>,
    loads: &Loads<S>,
    rotor_vel: &[S; MAX_ROTORS],
    rotor_acc: &[S; MAX_ROTORS],
    ang_vel: [S; 3],
) -> ([S; 3], [S; 3]) {
    let mut force = [S::zero(); 3];
    let mut torque = [S::zero(); 3];
    // −h.
    let mut spun = [S::zero(); 3];
    for i in 0..p.n_rotors {
        let r = &p.rotors[i];
        let thrust = vec3::scale(r.axis, loads.thrust[i]);
        force = vec3::add(force, thrust);
        torque = vec3::add(torque, vec3::cross(r.position_m, thrust));
        torque = vec3::add(torque, vec3::scale(r.axis, r.spin * loads.torque[i]));
        let spin_inertia = r.spin * r.inertia_kg_m2;
        spun = vec3::add(spun, vec3::scale(r.axis, spin_inertia * rotor_vel[i]));
        torque = vec3::add(torque, vec3::scale(r.axis, spin_inertia * rotor_acc[i]));
    }
    (force, vec3::add(torque, vec3::cross(ang_vel, spun)))
}

/// Force (N, body) of a known collective thrust (N) that all rotors share alike, each along its own axis.
#[inline(always)]
pub fn collective<S: Real>(p: &Params<S>, thrust: S) -> [S; 3] {
    let share = thrust / S::lit(p.n_rotors.max(1) as f64);
    let mut force = [S::zero(); 3];
    for i in 0..p.n_rotors {
        force = vec3::add(force, vec3::scale(p.rotors[i].axis, share));
    }
    force
}

impl<S: Real> Params<S> {
    /// Visits only the rotors in use; see [`Parameters::visit`].
    pub fn visit_used(&mut self, prefix: &str, f: &mut dyn FnMut(&str, &mut S)) {
        for i in 0..self.n_rotors {
            self.rotors[i].visit(&format!("{prefix}.rotors.{i}"), f);
        }
    }
}
