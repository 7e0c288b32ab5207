//! What a vehicle takes over from a similar one: rotor lag near hover, and controller gains that are scaled so that the same error
//! gives the same acceleration.

use std::collections::BTreeMap;

use super::Vehicle;
use super::schema::{AttitudeStage, Mellinger, StateStage, VehicleFile};
use propwash_physics::rotor;

/// How a vehicle's first rotor answers small changes of its command at hover.
pub(super) struct NearHover {
    /// Time constant of speeding up, s.
    pub up_s: f64,
    /// Time constant of slowing down, s.
    pub down_s: f64,
    /// Rotor inertia over the slope of the torque curve, s.
    pub lead_s: f64,
}

impl NearHover {
    pub fn of(vehicle: &Vehicle) -> Self {
        let drone = &vehicle.contents.base;
        let (params, speed) = (&drone.airframe.rotors[0], drone.hover_rotor_vel()[0]);
        let lag = |change: f64| change / rotor::acceleration(params, speed, speed + change);
        Self {
            up_s: lag(1e-3 * speed),
            down_s: lag(-1e-3 * speed),
            lead_s: params.inertia_kg_m2 / slope(params.torque_curve, speed),
        }
    }
}

/// Slope of a quadratic curve at a speed (rad/s); the central difference is exact for it.
pub(super) fn slope(curve: [f64; 3], speed: f64) -> f64 {
    let h = 0.01 * speed;
    (rotor::curve(curve, speed + h) - rotor::curve(curve, speed - h)) / (2.0 * h)
}

/// Why no controller can be taken over.
pub(super) enum Unlike {
    /// The model has no Mellinger controller.
    NoController,
    /// The vehicle has no lever or no inertia about this axis.
    Axis(&'static str),
}

/// What the rotors of a vehicle can do.
#[derive(Clone, Copy)]
pub(super) struct Ability {
    /// Greatest thrust of one rotor, N.
    pub thrust_max_n: f64,
    /// Torque about the rotor's axis per thrust, m.
    pub thrust_to_torque_m: f64,
}

/// The controller of `model` for the body and rotors of `file`, scaled so that the same error gives the same acceleration there.
///
/// # Errors
/// [`Unlike`] where there is nothing to take over, or nothing that it could turn.
pub(super) fn controller(
    model: &Vehicle,
    file: &VehicleFile,
    ability: Ability,
    source: String,
) -> Result<Mellinger, Unlike> {
    let Some(of) = &model.file().controller.mellinger else { return Err(Unlike::NoController) };
    let Ability { thrust_max_n, thrust_to_torque_m } = ability;
    // Torque about x, y, z of full thrust on one side, over the inertia: what a unit of PWM turns.
    let authority = |file: &VehicleFile, thrust: f64, t2t: f64| {
        let mut levers = [0.0; 3];
        for r in &file.rotor {
            let [x, y, _] = r.position_m.unwrap_or_default();
            levers = [levers[0] + y.abs(), levers[1] + x.abs(), levers[2] + t2t];
        }
        let inertia = file.body.inertia_kg_m2;
        core::array::from_fn::<f64, 3, _>(|k| levers[k] * thrust / inertia[k][k])
    };
    let theirs = authority(model.file(), of.thrust_max_n, of.thrust_to_torque_m);
    let ours = authority(file, thrust_max_n, thrust_to_torque_m);
    for k in 0..3 {
        if !(ours[k].is_finite() && ours[k] > 0.0) {
            return Err(Unlike::Axis(["x", "y", "z"][k]));
        }
    }
    let turn = |gain: [f64; 3]| core::array::from_fn(|k| gain[k] * theirs[k] / ours[k]);
    let push = |gain: [f64; 3]| gain.map(|g| g * file.body.mass_kg / of.mass_kg);
    let lift = (of.thrust_max_n * model.file().rotor.len() as f64) / (thrust_max_n * file.rotor.len() as f64);
    let note = |of: &str| Some(format!("{of} of {}, scaled to this vehicle; untested", model.name));
    let stage = |s: &AttitudeStage| AttitudeStage {
        kr_pwm: turn(s.kr_pwm),
        kw_pwm_s: turn(s.kw_pwm_s),
        ki_pwm_per_s: turn(s.ki_pwm_per_s),
        kd_omega_pwm_s2: turn(s.kd_omega_pwm_s2),
        integral_max_s: s.integral_max_s,
        source: s.source.clone(),
        note: note("Gains (same angular acceleration per error)"),
        sigma: BTreeMap::new(),
    };
    let s = &of.state;
    Ok(Mellinger {
        mass_kg: file.body.mass_kg,
        mass_thrust_pwm_per_n: of.mass_thrust_pwm_per_n * lift,
        pwm_min: of.pwm_min,
        pwm_max: of.pwm_max,
        thrust_min_n: thrust_max_n * of.thrust_min_n / of.thrust_max_n,
        thrust_max_n,
        torque_pwm_max: of.torque_pwm_max,
        thrust_to_torque_m,
        source: Some(source),
        note: note("PWM range, ratio of least to greatest thrust, and gains"),
        sigma: BTreeMap::new(),
        state: StateStage {
            kp_n_per_m: push(s.kp_n_per_m),
            kd_n_s_per_m: push(s.kd_n_s_per_m),
            ki_n_per_m_s: push(s.ki_n_per_m_s),
            integral_max_m_s: s.integral_max_m_s,
            source: s.source.clone(),
            note: note("Gains (same acceleration per error)"),
            sigma: BTreeMap::new(),
        },
        attitude: stage(&of.attitude),
        body_rate: stage(&of.body_rate),
    })
}
