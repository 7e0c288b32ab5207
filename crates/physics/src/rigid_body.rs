//! Newton–Euler equations of a rigid body whose frame origin is its centre of mass.

use super::params::parameters;
use propwash_trace::Real;
use propwash_trace::math::{quat, vec3};

/// Most rotors of one vehicle.
pub const MAX_ROTORS: usize = 8;

/// State of one vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State<S> {
    /// Position of the centre of mass, m, world.
    pub pos: [S; 3],
    /// Attitude, xyzw, body to world, unit length.
    pub quat: [S; 4],
    /// Velocity, m/s, world.
    pub vel: [S; 3],
    /// Angular velocity, rad/s, body.
    pub ang_vel: [S; 3],
    /// Rotor speeds, rad/s, never negative; entries past the last rotor are zero.
    pub rotor_vel: [S; MAX_ROTORS],
    /// Collective thrust state of the abstracted model, N.
    pub thrust: S,
}

impl<S: Real> State<S> {
    /// At the origin, level, at rest, rotors still.
    pub fn rest() -> Self {
        let zero = S::zero();
        Self {
            pos: [zero; 3],
            quat: quat::identity(),
            vel: [zero; 3],
            ang_vel: [zero; 3],
            rotor_vel: [zero; MAX_ROTORS],
            thrust: zero,
        }
    }
}

/// Time derivative of a [`State`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rate<S> {
    /// d pos / dt, m/s, world.
    pub vel: [S; 3],
    /// Attitude rate as angular velocity, rad/s, body.
    pub ang_vel: [S; 3],
    /// d vel / dt, m/s², world.
    pub acc: [S; 3],
    /// d ang_vel / dt, rad/s², body.
    pub ang_acc: [S; 3],
    /// d rotor_vel / dt, rad/s².
    pub rotor_acc: [S; MAX_ROTORS],
    /// d thrust / dt, N/s.
    pub thrust_rate: S,
}

impl<S: Real> Rate<S> {
    /// Nothing changes.
    pub fn zero() -> Self {
        let zero = S::zero();
        Self {
            vel: [zero; 3],
            ang_vel: [zero; 3],
            acc: [zero; 3],
            ang_acc: [zero; 3],
            rotor_acc: [zero; MAX_ROTORS],
            thrust_rate: zero,
        }
    }
}

/// Force and torque on the body about its centre of mass, without gravity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wrench<S> {
    /// N, world.
    pub force: [S; 3],
    /// What acts in body axes beside `force`, N; see [`Wrench::force_world`].
    pub body_force: [S; 3],
    /// N·m, body.
    pub torque: [S; 3],
}

impl<S: Real> Wrench<S> {
    /// Nothing acts.
    pub fn zero() -> Self {
        Self { force: [S::zero(); 3], body_force: [S::zero(); 3], torque: [S::zero(); 3] }
    }

    /// Adds a force (N, body).
    #[inline(always)]
    pub fn add_body_force(&mut self, force: [S; 3]) {
        self.body_force = vec3::add(self.body_force, force);
    }

    /// The whole force on a body of attitude `q`, N, world: what acts in body axes is turned together.
    #[inline(always)]
    pub fn force_world(&self, q: [S; 4]) -> [S; 3] {
        vec3::add(self.force, quat::rotate(q, self.body_force))
    }
}

parameters! {
    /// Mass properties and gravity.
    pub struct Params {
        /// Mass, kg.
        mass_kg: S,
        /// Inertia about the centre of mass, kg·m², body axes.
        inertia_kg_m2: [[S; 3]; 3],
        /// Inverse of `inertia_kg_m2`, 1/(kg·m²); [`Params::refresh`] keeps it true.
        inertia_inverse: [[S; 3]; 3],
        /// Gravity, m/s², world.
        gravity_m_s2: [S; 3],
    }
}

impl<S: Real> Params<S> {
    /// Mass properties with the inverse inertia computed.
    pub fn new(mass_kg: S, inertia_kg_m2: [[S; 3]; 3], gravity_m_s2: [S; 3]) -> Self {
        Self { mass_kg, inertia_kg_m2, inertia_inverse: vec3::inverse(inertia_kg_m2), gravity_m_s2 }
    }

    /// Recomputes what follows from other parameters; call it after changing the inertia.
    pub fn refresh(&mut self) {
        self.inertia_inverse = vec3::inverse(self.inertia_kg_m2);
    }
}

/// Linear and angular acceleration of a body of attitude `q` under a wrench: m v̇ = m g + F, J ω̇ = τ − ω × J ω.
///
/// Returns (m/s² world, rad/s² body). Source: Newton–Euler equations, e.g. McKinnon & Schoellig, "Unscented external
/// force and torque estimation for quadrotors", IROS 2016, eq. 1–4.
#[inline(always)]
pub fn accelerations<S: Real>(
    p: &Params<S>,
    q: [S; 4],
    ang_vel: [S; 3],
    wrench: &Wrench<S>,
) -> ([S; 3], [S; 3]) {
    let acc = vec3::add(vec3::scale(wrench.force_world(q), S::one() / p.mass_kg), p.gravity_m_s2);
    let momentum = vec3::mat_vec(p.inertia_kg_m2, ang_vel);
    let torque = vec3::sub(wrench.torque, vec3::cross(ang_vel, momentum));
    (acc, vec3::mat_vec(p.inertia_inverse, torque))
}

/// The wrench under which a body that turns with `ang_vel` has these accelerations (m/s² world, rad/s² body): the same
/// equations as [`accelerations`], read the other way.
#[inline(always)]
pub fn wrench<S: Real>(p: &Params<S>, ang_vel: [S; 3], acc: [S; 3], ang_acc: [S; 3]) -> Wrench<S> {
    let momentum = vec3::mat_vec(p.inertia_kg_m2, ang_vel);
    Wrench {
        force: vec3::scale(vec3::sub(acc, p.gravity_m_s2), p.mass_kg),
        body_force: [S::zero(); 3],
        torque: vec3::add(vec3::mat_vec(p.inertia_kg_m2, ang_acc), vec3::cross(ang_vel, momentum)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_wrench_of_accelerations_gives_them_back() {
        let inertia = [[0.01, 0.001, 0.0], [0.001, 0.02, -0.002], [0.0, -0.002, 0.03]];
        let p = Params::new(0.7, inertia, [0.0, 0.0, -9.81]);
        let (turn, acc, ang_acc) = ([1.0, -2.0, 3.0], [0.3, -0.4, 5.0], [10.0, 20.0, -7.0]);
        let (a, b) = accelerations(&p, quat::identity(), turn, &wrench(&p, turn, acc, ang_acc));
        for k in 0..3 {
            assert!((a[k] - acc[k]).abs() < 1e-12 && (b[k] - ang_acc[k]).abs() < 1e-10, "{a:?} {b:?}");
        }
    }
}
