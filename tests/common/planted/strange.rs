//! Effects that no list of candidates has and that a formula may describe: what an unknown vehicle might do. Some are formulas that a
//! search could write down, others are not.

use super::hidden::Scale;
use super::linear::{V, cross, mul, norm};
use propwash::random::Stream;
use serde::Serialize;
use std::f64::consts::TAU;

/// Ids of these effects; the last two act along axes of the world.
pub const STRANGE: &[&str] = &[
    "dry_friction",
    "root_drag",
    "threshold_drag",
    "forward_drag",
    "rotation_damping",
    "square_damping",
    "weathercock",
    "nose_up",
    "cross_flow",
    "magnus_force",
    "bank_lift",
    "spin_loss",
    "saturating_lift",
    "low_lift",
    "guide_friction",
    "bungee",
];

/// Ids of effects that no formula of few quantities describes: ripples, humps and mixtures, as turbulent flow makes them.
pub const RUGGED: &[&str] = &[
    "rippled_push",
    "resonant_push",
    "speed_hump",
    "mixed_ripple",
    "twist_ripple",
    "rate_ripple",
    "descent_wake",
    "height_ripple",
];

/// One of them, with its strength and, where it has one, its scale.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Strange {
    pub id: &'static str,
    /// N, N·m or a share, times powers of m and s.
    pub strength: f64,
    /// m/s or m.
    pub scale: f64,
}

impl Strange {
    /// The effect `id`, drawn; `size` 1 is as drawn, 0 is nothing.
    pub fn draw(id: &'static str, s: &mut Stream, size: f64, of: &Scale) -> Self {
        let (m, j) = (of.mass, of.inertia);
        let (strength, scale) = match id {
            "dry_friction" => (m * s.uniform(0.25, 0.5), s.uniform(0.3, 0.8)),
            "root_drag" => (m * s.uniform(0.2, 0.4), 0.0),
            "threshold_drag" => (m * s.uniform(0.3, 0.6), s.uniform(0.8, 1.5)),
            "forward_drag" => (m * s.uniform(0.25, 0.5), 0.0),
            "rotation_damping" => (j * s.uniform(4e-3, 8e-3), 0.0),
            "square_damping" => (j * s.uniform(3e-3, 6e-3), 0.0),
            "weathercock" => (j * s.uniform(1.5e-3, 3e-3), 0.0),
            "nose_up" => (j * s.uniform(1e-3, 2e-3), 0.0),
            "cross_flow" => (m * s.uniform(0.08, 0.16), 0.0),
            "magnus_force" => (m * s.uniform(0.06, 0.12), 0.0),
            "guide_friction" => (m * s.uniform(0.25, 0.5), s.uniform(0.05, 0.15)),
            "bungee" => (m * s.uniform(0.5, 1.0), s.uniform(0.3, 0.6)),
            "bank_lift" => (s.uniform(0.3, 0.6), 0.0),
            "spin_loss" => (s.uniform(0.02, 0.04), 0.0),
            "saturating_lift" => (m * s.uniform(0.3, 0.6), s.uniform(1.0, 2.0)),
            "rippled_push" | "mixed_ripple" => (m * s.uniform(0.3, 0.6), s.uniform(1.2, 2.0)),
            "resonant_push" | "speed_hump" => (m * s.uniform(0.4, 0.8), s.uniform(0.8, 1.4)),
            "twist_ripple" => (j * s.uniform(2e-3, 4e-3), s.uniform(1.2, 2.0)),
            "rate_ripple" => (j * s.uniform(2e-3, 4e-3), s.uniform(1.0, 1.6)),
            "descent_wake" => (s.uniform(0.05, 0.1), s.uniform(0.3, 0.6)),
            "height_ripple" => (m * s.uniform(0.3, 0.6), s.uniform(0.8, 1.4)),
            _ => (m * s.uniform(1.5, 3.0), s.uniform(1.0, 2.0)),
        };
        Self { id, strength: size * strength, scale }
    }

    /// Force and torque, body, at air velocity `u` and body rates `w`; `thrust` is that of all rotors, `roll` the bank, `z` the
    /// height.
    pub fn wrench(&self, u: V, w: V, thrust: f64, roll: f64, z: f64) -> (V, V) {
        let (c, speed) = (self.strength, norm(u));
        let (mut force, mut torque) = ([0.0; 3], [0.0; 3]);
        match self.id {
            "dry_friction" => (0..2).for_each(|k| force[k] = -c * (u[k] / self.scale).tanh()),
            "root_drag" => force = mul(u, -c / (speed + 1e-6).sqrt()),
            "threshold_drag" => force = mul(u, -c * (speed - self.scale).max(0.0) / (speed + 1e-9)),
            "forward_drag" => force[0] = -c * u[0].max(0.0),
            "rotation_damping" => torque = mul(w, -c),
            "square_damping" => torque = mul(w, -c * norm(w)),
            "weathercock" => torque[2] = -c * u[0] * u[1],
            "nose_up" => torque[1] = -c * (u[0] * u[0] + u[1] * u[1]),
            "cross_flow" => force = [-c * u[1] * w[2], c * u[0] * w[2], 0.0],
            "magnus_force" => force = mul(cross(w, u), c),
            "bank_lift" => force[2] = c * thrust * roll.sin().powi(2),
            "spin_loss" => force[2] = -c * thrust * norm(w),
            "saturating_lift" => force[2] = c * ((u[0] * u[0] + u[1] * u[1]) / self.scale.powi(2)).tanh(),
            "rippled_push" => (0..2).for_each(|k| force[k] = c * (TAU * u[k] / self.scale).sin()),
            "resonant_push" => {
                let across = u[0].hypot(u[1]);
                let push = c * (-((across - self.scale) / 0.35).powi(2)).exp() / (across + 1e-9);
                force = [-push * u[0], -push * u[1], 0.0];
            }
            "speed_hump" => force[2] = c * (-((speed - self.scale) / 0.4).powi(2)).exp(),
            "mixed_ripple" => force[1] = c * (TAU * (u[0] + u[1]) / self.scale).sin(),
            "twist_ripple" => torque[2] = c * (TAU * u[0] / self.scale).sin(),
            "rate_ripple" => torque[0] = c * (TAU * w[0] / self.scale).sin(),
            "descent_wake" => force[2] = -c * thrust * (-((u[2] + self.scale) / 0.3).powi(2)).exp(),
            "height_ripple" => force[2] = c * (TAU * z / self.scale).sin(),
            // Along axes of the world: see `pull`.
            "guide_friction" | "bungee" => {}
            _ => force[2] = c * (-z / self.scale).exp(),
        }
        (force, torque)
    }

    /// Force along axes of the world at place `p` with velocity `v`.
    pub fn pull(&self, p: V, v: V) -> V {
        let (c, s) = (self.strength, self.scale);
        match self.id {
            "guide_friction" => [-c * (v[0] / s).tanh(), -c * (v[1] / s).tanh(), 0.0],
            "bungee" => [-c * (p[0] - p[0].clamp(-s, s)), 0.0, 0.0],
            _ => [0.0; 3],
        }
    }

    /// One of [`RUGGED`] as an effect of a vehicle file.
    pub fn as_expression(&self) -> String {
        let (c, s) = (self.strength, self.scale);
        let ripple = |of: &str| format!("{c:e} * sin(2 * pi * ({of}) / {s:e})");
        let across = "sqrt(vx_body^2 + vy_body^2 + 1e-9)";
        let hump = |of: &str, width: f64| format!("{c:e} * exp(-((({of}) - {s:e}) / {width:?})^2)");
        let resonant = hump(across, 0.35);
        let none = String::from("0");
        let (key, three) = match self.id {
            "rippled_push" => ("force_body_n", [ripple("vx_body"), ripple("vy_body"), none]),
            "resonant_push" => (
                "force_body_n",
                [
                    format!("-vx_body / {across} * {resonant}"),
                    format!("-vy_body / {across} * {resonant}"),
                    none,
                ],
            ),
            "speed_hump" => {
                let speed = "sqrt(vx_body^2 + vy_body^2 + vz_body^2 + 1e-9)";
                ("force_body_n", [none.clone(), none, hump(speed, 0.4)])
            }
            "mixed_ripple" => ("force_body_n", [none.clone(), ripple("vx_body + vy_body"), none]),
            "twist_ripple" => ("torque_body_n_m", [none.clone(), none, ripple("vx_body")]),
            "rate_ripple" => ("torque_body_n_m", [ripple("wx"), none.clone(), none]),
            "descent_wake" => {
                ("force_body_n", [none.clone(), none, format!("-thrust_n * {}", hump("-vz_body", 0.3))])
            }
            _ => ("force_body_n", [none.clone(), none, ripple("z")]),
        };
        format!("\n[[effect]]\nkind = \"expression\"\nname = \"truth\"\n{key} = {three:?}\n")
    }
}
