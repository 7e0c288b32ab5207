//! One step forward in time. Attitude advances by the exponential map, so it stays a rotation whatever the rate.

use super::rigid_body::{MAX_ROTORS, Rate, State};
use propwash_trace::Real;
use propwash_trace::math::{quat, vec3};

/// Integration scheme.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Integrator {
    /// Explicit Euler: first order.
    #[default]
    Euler,
    /// Velocities first, then poses with the new velocities: first order, keeps the energy of oscillations bounded.
    SemiImplicitEuler,
    /// Runge–Kutta, fourth order on the rotation group too.
    Rk4,
}

impl Integrator {
    /// Name as in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Euler => "euler",
            Self::SemiImplicitEuler => "semi_implicit_euler",
            Self::Rk4 => "rk4",
        }
    }

    /// Advances `state` by `dt` seconds; `rate` gives the time derivative of a state.
    #[inline(always)]
    pub fn step<S: Real>(
        self,
        state: &State<S>,
        dt: S,
        mut rate: impl FnMut(&State<S>) -> Rate<S>,
    ) -> State<S> {
        match self {
            Self::Euler => advance(state, &rate(state), dt),
            Self::SemiImplicitEuler => {
                let mut r = rate(state);
                r.vel = vec3::add(state.vel, vec3::scale(r.acc, dt));
                r.ang_vel = vec3::add(state.ang_vel, vec3::scale(r.ang_acc, dt));
                advance(state, &r, dt)
            }
            Self::Rk4 => rk4(state, dt, rate),
        }
    }
}

/// `state` moved along a constant rate for `dt` seconds.
#[inline(always)]
fn advance<S: Real>(state: &State<S>, rate: &Rate<S>, dt: S) -> State<S> {
    let mut next = *state;
    next.pos = vec3::add(state.pos, vec3::scale(rate.vel, dt));
    next.vel = vec3::add(state.vel, vec3::scale(rate.acc, dt));
    next.ang_vel = vec3::add(state.ang_vel, vec3::scale(rate.ang_acc, dt));
    let turn = quat::exp(vec3::scale(rate.ang_vel, dt));
    next.quat = quat::renormalize(quat::mul(state.quat, turn));
    for i in 0..MAX_ROTORS {
        next.rotor_vel[i] = state.rotor_vel[i] + rate.rotor_acc[i] * dt;
    }
    next.thrust = state.thrust + rate.thrust_rate * dt;
    next
}

/// Rate of the rotation vector θ of q = q₀ ⊗ exp(θ) when the body turns with `w`: ω + ½ θ×ω + ¹⁄₁₂ θ×(θ×ω).
#[inline(always)]
fn rotation_vector_rate<S: Real>(theta: [S; 3], w: [S; 3]) -> [S; 3] {
    let once = vec3::cross(theta, w);
    let twice = vec3::cross(theta, once);
    vec3::add(w, vec3::add(vec3::scale(once, S::lit(0.5)), vec3::scale(twice, S::lit(1.0 / 12.0))))
}

/// Runge–Kutta–Munthe-Kaas: the classical tableau on the rotation vector, so the order holds for attitude as well.
///
/// Source: Munthe-Kaas, "Runge–Kutta methods on Lie groups", BIT 38, 1998; averaging body rates as if they were
/// vectors, as is often done, loses two orders when the axis of rotation moves.
#[inline(always)]
fn rk4<S: Real>(state: &State<S>, dt: S, mut rate: impl FnMut(&State<S>) -> Rate<S>) -> State<S> {
    let half = S::lit(0.5) * dt;
    let k1 = rate(state);
    let mut k2 = rate(&advance(state, &k1, half));
    k2.ang_vel = rotation_vector_rate(vec3::scale(k1.ang_vel, half), k2.ang_vel);
    let mut k3 = rate(&advance(state, &k2, half));
    k3.ang_vel = rotation_vector_rate(vec3::scale(k2.ang_vel, half), k3.ang_vel);
    let mut k4 = rate(&advance(state, &k3, dt));
    k4.ang_vel = rotation_vector_rate(vec3::scale(k3.ang_vel, dt), k4.ang_vel);

    let sixth = S::lit(1.0 / 6.0);
    let two = S::lit(2.0);
    let mut mean = k1;
    macro_rules! average {
        ($($field:ident),*) => {$(
            for i in 0..mean.$field.len() {
                mean.$field[i] = sixth * (k1.$field[i] + two * (k2.$field[i] + k3.$field[i]) + k4.$field[i]);
            }
        )*};
    }
    average!(vel, ang_vel, acc, ang_acc, rotor_acc);
    mean.thrust_rate = sixth * (k1.thrust_rate + two * (k2.thrust_rate + k3.thrust_rate) + k4.thrust_rate);
    advance(state, &mean, dt)
}
