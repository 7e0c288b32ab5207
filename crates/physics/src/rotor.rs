//! One rotor: how fast it turns, what it lifts, what it takes.

use super::params::parameters;
use propwash_trace::Real;

parameters! {
    /// One rotor, its motor and its place on the airframe.
    pub struct Params {
        /// Hub position from the centre of mass, m, body.
        position_m: [S; 3],
        /// Unit direction of thrust, body.
        axis: [S; 3],
        /// Sign of the aerodynamic torque on the body about `axis`: +1 when the rotor turns clockwise seen from above.
        spin: S,
        /// Thrust curve: f = c0 + c1 Ω + c2 Ω² with N, N·s/rad, N·s²/rad².
        thrust_curve: [S; 3],
        /// Torque curve: τ = c0 + c1 Ω + c2 Ω² with N·m, N·m·s/rad, N·m·s²/rad².
        torque_curve: [S; 3],
        /// Spin-up coefficients (c_v in 1/s, c_d in 1/rad).
        spin_up: [S; 2],
        /// Spin-down coefficients (c_v in 1/s, c_d in 1/rad).
        spin_down: [S; 2],
        /// Inertia of propeller and motor bell about the axis, kg·m².
        inertia_kg_m2: S,
        /// Propeller radius, m (ground effect, downwash).
        radius_m: S,
    }
}

/// c0 + c1 x + c2 x².
#[inline(always)]
pub fn curve<S: Real>(c: [S; 3], x: S) -> S {
    c[0] + c[1] * x + c[2] * (x * x)
}

/// Rotor acceleration, rad/s²: Ω̇ = c_v (Ω_cmd − Ω) + c_d (Ω_cmd² − Ω²), with its own coefficients up and down.
///
/// The linear term is back-EMF, the quadratic one propeller drag. Source: Crazyflow 0.4.0, first-principles model
/// (`rotor_dyn_coef`), there in rpm.
#[inline(always)]
pub fn acceleration<S: Real>(p: &Params<S>, speed: S, command: S) -> S {
    let up = command.gt(speed);
    let viscous = S::select(up, p.spin_up[0], p.spin_down[0]);
    let drag = S::select(up, p.spin_up[1], p.spin_down[1]);
    (command - speed) * (viscous + drag * (command + speed))
}

/// Rotor speed (rad/s) at which the thrust curve gives `thrust` (N): the larger root of the quadratic.
///
/// Below the least thrust of the curve there is no such speed; the speed of least thrust is returned.
#[inline(always)]
pub fn speed_for_thrust<S: Real>(thrust_curve: [S; 3], thrust: S) -> S {
    let [c, b, a] = thrust_curve;
    let discriminant = (b * b - S::lit(4.0) * a * (c - thrust)).max(S::zero());
    (discriminant.sqrt() - b) / (S::lit(2.0) * a)
}
