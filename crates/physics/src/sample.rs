//! A made-up quadrotor for unit tests: 1 kg, rotors at (±0.1, ±0.1) m.

use super::airframe;
use super::controllers::{Rates, mellinger, mixer};
use super::drone::{Drone, Dynamics};
use super::effects::AnyEffect;
use super::rigid_body::{self, MAX_ROTORS};
use super::rotor;

/// Signs of y, −x and spin of the four rotors.
const SIGNS: [[f64; 3]; 4] = [[-1.0, -1.0, -1.0], [-1.0, 1.0, 1.0], [1.0, 1.0, -1.0], [1.0, -1.0, 1.0]];

/// The vehicle with these effects.
pub fn quad(effects: Vec<AnyEffect<f64>>) -> Drone<f64> {
    let arm = 0.1;
    let thrust_curve = [0.0, 0.0, 1e-5];
    let base = rotor::Params {
        position_m: [0.0; 3],
        axis: [0.0, 0.0, 1.0],
        spin: 1.0,
        thrust_curve,
        torque_curve: [0.0, 0.0, 1e-7],
        spin_up: [20.0, 0.0],
        spin_down: [15.0, 0.0],
        inertia_kg_m2: 1e-5,
        radius_m: 0.06,
    };
    let mut rotors = [base; MAX_ROTORS];
    let mut mix = mixer::Params {
        signs: [[0.0; 3]; MAX_ROTORS],
        rotor_from_wrench: [[0.0; 4]; MAX_ROTORS],
        wrench_from_rotor: [[0.0; 4]; MAX_ROTORS],
        beside: [[0.0; 4]; 4],
        n_rotors: 4,
    };
    for (i, s) in SIGNS.iter().enumerate() {
        rotors[i].position_m = [-arm * s[1], arm * s[0], 0.0];
        rotors[i].spin = s[2];
        mix.signs[i] = *s;
        mix.wrench_from_rotor[i] = [1.0, arm * s[0], arm * s[1], 0.01 * s[2]];
        mix.rotor_from_wrench[i] = [0.25, s[0] / (4.0 * arm), s[1] / (4.0 * arm), s[2] / (4.0 * 0.01)];
    }
    mix.refresh();
    let gains = mellinger::AttitudeGains {
        kr: [6.0, 6.0, 2.0],
        kw: [1.0, 1.0, 0.6],
        ki: [0.0, 0.0, 0.1],
        kd_omega: [0.0; 3],
        integral_max: [1.0; 3],
    };
    Drone {
        body: rigid_body::Params::new(
            1.0,
            [[0.01, 0.0, 0.0], [0.0, 0.01, 0.0], [0.0, 0.0, 0.018]],
            [0.0, 0.0, -9.81],
        ),
        airframe: airframe::Params { rotors, n_rotors: 4 },
        dynamics: Dynamics::Rotors,
        controller: mellinger::Params {
            mass_kg: 1.0,
            mass_thrust: 0.05,
            pwm_min: 0.0,
            pwm_max: 1.0,
            thrust_min_n: 0.1,
            thrust_max_n: 5.0,
            torque_pwm_max: [0.4; 3],
            thrust_curve,
            state: mellinger::StateGains {
                kp: [6.0, 6.0, 15.0],
                kd: [4.0, 4.0, 6.0],
                ki: [0.5; 3],
                integral_max: [2.0; 3],
            },
            attitude: gains,
            body_rate: gains,
            mixer: mix,
        },
        effects,
    }
}

/// 100 Hz state stage, 500 Hz for the rest.
pub const RATES: Rates = Rates { state_hz: 100, attitude_hz: 500, body_rate_hz: 500, force_torque_hz: 500 };
