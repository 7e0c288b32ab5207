//! What must hold for any vehicle: conservation, free fall, hover, symmetry, signs, exact derivatives.

use proptest::prelude::*;
use propwash::math::{euler, quat, vec3};
use propwash::physics::controllers::{mellinger, mixer};
use propwash::physics::drone::{Drone, Dynamics};
use propwash::physics::effects::{AnyEffect, Command, linear_drag};
use propwash::physics::integrate::Integrator;
use propwash::physics::rigid_body::{MAX_ROTORS, Rate, State};
use propwash::physics::surroundings::Surroundings;
use propwash::physics::{airframe, attitude_response, rigid_body, rotor};
use propwash::scalar::{Real, dual::Dual};
use propwash::units::{RAD_S_PER_RPM, curve_rpm_to_rad_s};

const GRAVITY: [f64; 3] = [0.0, 0.0, -9.81];
const INTEGRATORS: [Integrator; 3] = [Integrator::Euler, Integrator::SemiImplicitEuler, Integrator::Rk4];

/// Numbers of one airframe, rotor speeds in rpm. Source: `dynamics/first_principles/params.toml` of Crazyflow 0.4.0; of
/// hb_x500 `dynamics/so_rpy/params.toml` and `control/mellinger/params.toml`.
struct Airframe {
    name: &'static str,
    mass_kg: f64,
    inertia_kg_m2: [f64; 3],
    arm_m: f64,
    rotor_inertia_kg_m2: f64,
    thrust_rpm: [f64; 3],
    torque_rpm: [f64; 3],
    /// Spin-up, then spin-down: linear (1/s), quadratic (1/(rpm s)).
    spin: [f64; 4],
}

const AIRFRAMES: [Airframe; 5] = [
    Airframe {
        name: "cf2x_L250",
        mass_kg: 0.0328,
        inertia_kg_m2: [16.8e-6, 16.8e-6, 29.8e-6],
        arm_m: 0.03253,
        rotor_inertia_kg_m2: 34.52e-9,
        thrust_rpm: [0.0, -5.382196214637237e-7, 2.4582929831265485e-10],
        torque_rpm: [0.0, 1.410454111996297e-9, 1.4592584373980652e-12],
        spin: [7.355623702172756, 0.0, 0.0, 0.00024443862952110715],
    },
    Airframe {
        name: "cf2x_P250",
        mass_kg: 0.0318,
        inertia_kg_m2: [16.8e-6, 16.8e-6, 29.8e-6],
        arm_m: 0.03253,
        rotor_inertia_kg_m2: 26.97e-9,
        thrust_rpm: [0.0, -3.6200226530383495e-7, 1.6060924304100328e-10],
        torque_rpm: [0.0, -2.2665265829562245e-9, 1.1149485566919186e-12],
        spin: [5.172596691828673, 8.14774234381285e-5, 0.0, 0.0002095253491455741],
    },
    Airframe {
        name: "cf2x_T350",
        mass_kg: 0.0379,
        inertia_kg_m2: [15.7e-6, 17.1e-6, 30.0e-6],
        arm_m: 0.03253,
        rotor_inertia_kg_m2: 38.93e-9,
        thrust_rpm: [0.0, -7.167227176573658e-7, 2.9401303690194613e-10],
        torque_rpm: [0.0, 5.815894847811497e-10, 1.331813874166509e-12],
        spin: [11.374753209400291, 0.0, 0.0, 0.00037867688499079635],
    },
    Airframe {
        name: "cf21B_500",
        mass_kg: 0.0434,
        inertia_kg_m2: [25e-6, 28e-6, 49e-6],
        arm_m: 0.035355,
        rotor_inertia_kg_m2: 38.93e-9,
        thrust_rpm: [0.0, -3.133427287299859e-7, 4.407354891648379e-10],
        torque_rpm: [0.0, 1.65886356219615e-9, 2.4693477924534137e-12],
        spin: [13.996001897562685, 0.00011093207920685363, 5.933168530682111, 0.00031951312393561264],
    },
    Airframe {
        name: "hb_x500",
        mass_kg: 2.28,
        inertia_kg_m2: [24e-3, 24e-3, 44e-3],
        arm_m: 0.17678,
        rotor_inertia_kg_m2: 0.0,
        thrust_rpm: [0.0, 1e-6, 1e-9],
        torque_rpm: [0.0, 1e-9, 1e-12],
        spin: [10.0, 0.0, 10.0, 0.0],
    },
];

/// Signs of the rotors' places and spins: x, y, spin. Front right, back right, back left, front left.
const LAYOUT: [[f64; 3]; 4] = [[1.0, -1.0, -1.0], [-1.0, -1.0, 1.0], [-1.0, 1.0, -1.0], [1.0, 1.0, 1.0]];

/// A controller that nobody asks.
fn no_controller() -> mellinger::Params<f64> {
    let gains = mellinger::AttitudeGains {
        kr: [0.0; 3],
        kw: [0.0; 3],
        ki: [0.0; 3],
        kd_omega: [0.0; 3],
        integral_max: [0.0; 3],
    };
    mellinger::Params {
        mass_kg: 1.0,
        mass_thrust: 1.0,
        pwm_min: 0.0,
        pwm_max: 1.0,
        thrust_min_n: 0.0,
        thrust_max_n: 1.0,
        torque_pwm_max: [1.0; 3],
        thrust_curve: [0.0, 0.0, 1.0],
        state: mellinger::StateGains { kp: [0.0; 3], kd: [0.0; 3], ki: [0.0; 3], integral_max: [0.0; 3] },
        attitude: gains,
        body_rate: gains,
        mixer: mixer::Params {
            signs: [[0.0; 3]; MAX_ROTORS],
            rotor_from_wrench: [[0.0; 4]; MAX_ROTORS],
            wrench_from_rotor: [[0.0; 4]; MAX_ROTORS],
            beside: [[0.0; 4]; 4],
            n_rotors: 4,
        },
    }
}

fn diagonal(d: [f64; 3]) -> [[f64; 3]; 3] {
    [[d[0], 0.0, 0.0], [0.0, d[1], 0.0], [0.0, 0.0, d[2]]]
}

fn quadrotor(a: &Airframe) -> Drone<f64> {
    let unused = rotor::Params {
        position_m: [0.0; 3],
        axis: [0.0, 0.0, 1.0],
        spin: 0.0,
        thrust_curve: [0.0; 3],
        torque_curve: [0.0; 3],
        spin_up: [0.0; 2],
        spin_down: [0.0; 2],
        inertia_kg_m2: 0.0,
        radius_m: 0.0,
    };
    let mut rotors = [unused; MAX_ROTORS];
    for (slot, [x, y, spin]) in rotors.iter_mut().zip(LAYOUT) {
        *slot = rotor::Params {
            position_m: [x * a.arm_m, y * a.arm_m, 0.0],
            spin,
            thrust_curve: curve_rpm_to_rad_s(a.thrust_rpm),
            torque_curve: curve_rpm_to_rad_s(a.torque_rpm),
            spin_up: [a.spin[0], a.spin[1] / RAD_S_PER_RPM],
            spin_down: [a.spin[2], a.spin[3] / RAD_S_PER_RPM],
            inertia_kg_m2: a.rotor_inertia_kg_m2,
            ..unused
        };
    }
    Drone {
        body: rigid_body::Params::new(a.mass_kg, diagonal(a.inertia_kg_m2), GRAVITY),
        airframe: airframe::Params { rotors, n_rotors: 4 },
        dynamics: Dynamics::Rotors,
        controller: no_controller(),
        effects: vec![],
    }
}

fn named(name: &str) -> Drone<f64> {
    quadrotor(AIRFRAMES.iter().find(|a| a.name == name).unwrap())
}

/// The fitted response of cf21B_500 (Crazyflow 0.4.0, `so_rpy_rotor_drag`).
fn with_attitude_response(mut drone: Drone<f64>) -> Drone<f64> {
    drone.dynamics = Dynamics::AttitudeResponse(attitude_response::Params {
        thrust_offset_n: 0.0,
        thrust_scale: 0.959471532998666,
        thrust_rate_per_s: 11.332539603033299,
        angle_gain_per_s2: [-156.34812197843243, -156.34812197843243, -144.7222372741053],
        rate_gain_per_s: [-16.300330418164553, -16.300330418164553, -17.368699336318954],
        command_gain_per_s2: [139.7494294272397, 139.7494294272397, 127.01037564242333],
        thrust_dynamics: true,
    });
    drone
}

fn with_drag(mut drone: Drone<f64>) -> Drone<f64> {
    let drag = diagonal([0.0216, 0.0216, 0.0248]);
    drone.effects.push(AnyEffect::LinearDrag(linear_drag::Params { drag_n_s_per_m: drag }));
    drone
}

/// A body without rotors, all axes unlike, tumbling about none of them; no gravity.
fn tumbling() -> (Drone<f64>, State<f64>) {
    let mut drone = named("cf21B_500");
    drone.airframe.n_rotors = 0;
    drone.body.gravity_m_s2 = [0.0; 3];
    drone.body.inertia_kg_m2 = [[25e-6, 2e-6, -1e-6], [2e-6, 33e-6, 3e-6], [-1e-6, 3e-6, 49e-6]];
    drone.refresh();
    let start = State {
        pos: [1.0, 2.0, 3.0],
        quat: quat::exp([0.4, -1.1, 0.7]),
        vel: [3.0, -2.0, 1.0],
        ang_vel: [7.0, 11.0, -5.0],
        ..State::rest()
    };
    (drone, start)
}

fn fly(
    drone: &Drone<f64>,
    by: Integrator,
    start: State<f64>,
    command: &Command<f64>,
    dt: f64,
    steps: u32,
) -> State<f64> {
    let calm = Surroundings::calm();
    (0..steps).fold(start, |s, _| by.step(&s, dt, |s| drone.rate(s, command, &calm)))
}

/// Angular momentum of body and rotors about the centre of mass, kg·m²/s, world. A rotor of spin +1 turns clockwise seen
/// from above: its momentum points against its axis.
fn angular_momentum(drone: &Drone<f64>, s: &State<f64>) -> [f64; 3] {
    let mut h = vec3::mat_vec(drone.body.inertia_kg_m2, s.ang_vel);
    for i in 0..drone.airframe.n_rotors {
        let r = &drone.airframe.rotors[i];
        h = vec3::sub(h, vec3::scale(r.axis, r.spin * r.inertia_kg_m2 * s.rotor_vel[i]));
    }
    quat::rotate(s.quat, h)
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    vec3::norm(vec3::sub(a, b))
}

#[test]
fn a_tumbling_body_keeps_its_energy_and_its_momenta() {
    let (drone, start) = tumbling();
    let energy = |s: &State<f64>| {
        let turning = vec3::dot(s.ang_vel, vec3::mat_vec(drone.body.inertia_kg_m2, s.ang_vel));
        0.5 * (drone.body.mass_kg * vec3::dot(s.vel, s.vel) + turning)
    };
    let turning_energy = energy(&State { vel: [0.0; 3], ..start });
    let (e0, h0) = (energy(&start), angular_momentum(&drone, &start));
    let still = Command::Rotors([0.0; MAX_ROTORS]);
    let drift = |steps: u32| {
        let s = fly(&drone, Integrator::Rk4, start, &still, 2.0 / f64::from(steps), steps);
        assert_eq!(s.vel, start.vel, "no force: no change of linear momentum");
        assert!(distance(s.pos, vec3::add(start.pos, vec3::scale(start.vel, 2.0))) < 1e-11);
        assert!(distance(s.ang_vel, start.ang_vel) > 1.0, "the axis of rotation moves");
        let h = distance(angular_momentum(&drone, &s), h0) / vec3::norm(h0);
        ((energy(&s) - e0).abs() / turning_energy, h)
    };
    let coarse = drift(1000);
    let fine = drift(2000);
    println!(
        "relative drift over 2 s: energy {:.1e}, angular momentum {:.1e}; half the step: {:.1e}, {:.1e}",
        coarse.0, coarse.1, fine.0, fine.1
    );
    assert!(coarse.0 < 1e-7 && coarse.1 < 1e-7, "{coarse:?}");
    // Half the step, a sixteenth of the drift: fourth order.
    assert!(fine.0 < coarse.0 / 13.0 && fine.1 < coarse.1 / 13.0, "{coarse:?} then {fine:?}");
}

#[test]
fn angular_momentum_moves_between_body_and_rotors_and_none_is_lost() {
    // Rotors that feel no air, spinning up at different rates in a tumbling body: only reaction and gyroscopic torque act.
    let (mut drone, mut start) = tumbling();
    drone.airframe.n_rotors = 4;
    for (i, r) in drone.airframe.rotors.iter_mut().enumerate() {
        r.thrust_curve = [0.0; 3];
        r.torque_curve = [0.0; 3];
        // One rotor leans, one is heavy: any geometry must hold.
        r.axis = vec3::normalize_or([0.1 * i as f64, -0.05, 1.0], [0.0, 0.0, 1.0]);
        r.inertia_kg_m2 = 4e-8 * (1.0 + i as f64);
    }
    start.rotor_vel[..4].copy_from_slice(&[500.0, 900.0, 100.0, 1300.0]);
    let mut command = [0.0; MAX_ROTORS];
    command[..4].copy_from_slice(&[2200.0, 200.0, 1900.0, 2500.0]);
    let command = Command::Rotors(command);
    let h0 = angular_momentum(&drone, &start);
    let drift = |steps: u32| {
        let s = fly(&drone, Integrator::Rk4, start, &command, 0.5 / f64::from(steps), steps);
        distance(angular_momentum(&drone, &s), h0) / vec3::norm(h0)
    };
    let (coarse, fine) = (drift(250), drift(500));
    println!("relative drift of the angular momentum over 0.5 s: {coarse:.1e}, half the step {fine:.1e}");
    assert!(coarse < 1e-5 && fine < coarse / 13.0, "{coarse:e} then {fine:e}");
}

#[test]
fn a_rotor_that_speeds_up_clockwise_turns_the_body_counter_clockwise() {
    for spin in [1.0, -1.0] {
        let mut drone = named("cf21B_500");
        for r in &mut drone.airframe.rotors {
            r.spin = spin;
            r.torque_curve = [0.0; 3];
        }
        let slow = State { rotor_vel: [1000.0; MAX_ROTORS], ..State::rest() };
        let yaw = |cmd: f64| {
            drone.rate(&slow, &Command::Rotors([cmd; MAX_ROTORS]), &Surroundings::calm()).ang_acc[2]
        };
        // Spin +1 is clockwise seen from above; counter-clockwise is positive about z.
        assert!(spin * yaw(1200.0) > 0.0 && spin * yaw(800.0) < 0.0 && yaw(1000.0) == 0.0);
        let r = &drone.airframe.rotors[0];
        let rotor_acc = rotor::acceleration(r, 1000.0, 1200.0);
        let expected = 4.0 * spin * r.inertia_kg_m2 * rotor_acc / drone.body.inertia_kg_m2[2][2];
        assert!((yaw(1200.0) - expected).abs() < 1e-12 * expected.abs());
    }
}

#[test]
fn the_air_turns_the_body_against_a_steady_rotor() {
    for spin in [1.0, -1.0] {
        let mut drone = named("cf21B_500");
        for r in &mut drone.airframe.rotors {
            r.spin = spin;
        }
        let steady = [2000.0; MAX_ROTORS];
        let state = State { rotor_vel: steady, ..State::rest() };
        let rate = drone.rate(&state, &Command::Rotors(steady), &Surroundings::calm());
        assert!(spin * rate.ang_acc[2] > 1.0, "clockwise rotors (spin +1) are braked counter-clockwise");
    }
}

#[test]
fn a_pitching_body_with_counter_clockwise_rotors_rolls_to_the_left() {
    // Momentum h along +z, turning about +y (nose down): the torque −ω × h points along −x.
    let mut drone = named("cf21B_500");
    for r in &mut drone.airframe.rotors {
        r.spin = -1.0;
    }
    let speeds = [2000.0; MAX_ROTORS];
    let rate = |ang_vel: [f64; 3]| {
        let state = State { ang_vel, rotor_vel: speeds, ..State::rest() };
        drone.rate(&state, &Command::Rotors(speeds), &Surroundings::calm()).ang_acc
    };
    let h = 4.0 * drone.airframe.rotors[0].inertia_kg_m2 * 2000.0;
    let [jx, jy, _] = [0, 1, 2].map(|i| drone.body.inertia_kg_m2[i][i]);
    assert!((rate([0.0, 3.0, 0.0])[0] + 3.0 * h / jx).abs() < 1e-9);
    assert!((rate([3.0, 0.0, 0.0])[1] - 3.0 * h / jy).abs() < 1e-9);
    assert_eq!(rate([0.0; 3])[..2], [0.0, 0.0]);
}

#[test]
fn free_fall_is_exact() {
    let drone = named("cf2x_L250");
    let mut falling = drone.clone();
    falling.airframe.n_rotors = 0;
    let start = State { pos: [0.0, 0.0, 100.0], vel: [2.0, -1.0, 3.0], ..State::rest() };
    let (dt, steps) = (0.002, 1000);
    let t = dt * f64::from(steps);
    for integrator in INTEGRATORS {
        let s = fly(&falling, integrator, start, &Command::Rotors([0.0; MAX_ROTORS]), dt, steps);
        // What the scheme itself does with constant acceleration: the first-order ones lag or lead by half a step.
        let fall = match integrator {
            Integrator::Euler => t * (t - dt),
            Integrator::SemiImplicitEuler => t * (t + dt),
            Integrator::Rk4 => t * t,
        };
        let expected = [2.0 * t, -t, 100.0 + 3.0 * t - 0.5 * 9.81 * fall];
        assert!(distance(s.pos, expected) < 1e-10, "{integrator:?}: {:?} against {expected:?}", s.pos);
        assert!(distance(s.vel, [2.0, -1.0, 3.0 - 9.81 * t]) < 1e-11);
        assert_eq!((s.quat, s.ang_vel), (start.quat, [0.0; 3]));
    }
}

#[test]
fn every_airframe_hovers_at_its_hover_speed() {
    for a in &AIRFRAMES {
        let drone = quadrotor(a);
        let hover = drone.hover_rotor_vel();
        assert!((0..4).all(|i| hover[i] > 100.0) && hover[4..] == [0.0; 4], "{}: {hover:?}", a.name);
        let state = State { quat: quat::exp([0.0, 0.0, 1.3]), rotor_vel: hover, ..State::rest() };
        let rate = drone.rate(&state, &Command::Rotors(hover), &Surroundings::calm());
        assert!(vec3::norm(rate.acc) < 1e-12, "{}: {:?}", a.name, rate.acc);
        // Two rotors turn each way: their torques cancel.
        assert!(vec3::norm(rate.ang_acc) < 1e-10, "{}: {:?}", a.name, rate.ang_acc);
        assert_eq!(rate.rotor_acc, [0.0; MAX_ROTORS]);
        // One per cent faster lifts, one per cent slower sinks.
        for (factor, up) in [(1.01, true), (0.99, false)] {
            let state = State { rotor_vel: hover.map(|w| w * factor), ..state };
            let acc = drone.rate(&state, &Command::Rotors(hover), &Surroundings::calm()).acc;
            assert!((acc[2] > 0.05) == up && (acc[2] < -0.05) != up);
        }
    }
}

#[test]
fn the_attitude_response_hovers_at_its_trim() {
    let drone = with_attitude_response(named("cf21B_500"));
    let thrust = drone.hover_thrust() / 0.959471532998666;
    let state = State { thrust, ..State::rest() };
    let rate = drone.rate(&state, &Command::Attitude([0.0, 0.0, 0.0, thrust]), &Surroundings::calm());
    assert!(vec3::norm(rate.acc) < 1e-13);
    assert_eq!((rate.ang_acc, rate.thrust_rate), ([0.0; 3], 0.0));
}

/// Rotors mirrored in the body's x-z plane: left and right change places.
fn mirrored_rotors(w: [f64; MAX_ROTORS]) -> [f64; MAX_ROTORS] {
    [w[3], w[2], w[1], w[0], w[4], w[5], w[6], w[7]]
}

/// State mirrored in the world's x-z plane; rates are axial vectors.
fn mirrored(s: &State<f64>) -> State<f64> {
    State {
        pos: [s.pos[0], -s.pos[1], s.pos[2]],
        quat: [-s.quat[0], s.quat[1], -s.quat[2], s.quat[3]],
        vel: [s.vel[0], -s.vel[1], s.vel[2]],
        ang_vel: [-s.ang_vel[0], s.ang_vel[1], -s.ang_vel[2]],
        rotor_vel: mirrored_rotors(s.rotor_vel),
        thrust: s.thrust,
    }
}

fn vector(size: f64) -> impl Strategy<Value = [f64; 3]> {
    prop::array::uniform3(-size..size)
}

fn rotors(low: f64, high: f64) -> impl Strategy<Value = [f64; MAX_ROTORS]> {
    prop::array::uniform4(low..high).prop_map(|w| [w[0], w[1], w[2], w[3], 0.0, 0.0, 0.0, 0.0])
}

fn any_state() -> impl Strategy<Value = State<f64>> {
    (vector(5.0), vector(3.0), vector(5.0), vector(10.0), rotors(0.0, 2500.0), 0.0..0.8f64).prop_map(
        |(pos, turn, vel, ang_vel, rotor_vel, thrust)| State {
            pos,
            quat: quat::exp(turn),
            vel,
            ang_vel,
            rotor_vel,
            thrust,
        },
    )
}

proptest! {
    #[test]
    fn the_mirror_image_of_a_flight_is_the_flight_of_the_mirror_image(
        start in any_state(),
        speeds in rotors(100.0, 2500.0),
        rpy in vector(1.0),
    ) {
        let rotors = with_drag(named("cf21B_500"));
        let response = with_attitude_response(rotors.clone());
        let [roll, pitch, yaw] = rpy;
        // Only near level: upside down the fitted response must choose a side.
        let tame = State { quat: quat::exp(vec3::scale(rpy, 0.3)), ang_vel: vec3::scale(start.ang_vel, 0.1), ..start };
        for (drone, start, command, image) in [
            (&rotors, start, Command::Rotors(speeds), Command::Rotors(mirrored_rotors(speeds))),
            (
                &response,
                tame,
                Command::Attitude([roll, pitch, yaw, 0.5]),
                Command::Attitude([-roll, pitch, -yaw, 0.5]),
            ),
        ] {
            let there = mirrored(&fly(drone, Integrator::Rk4, start, &command, 0.002, 50));
            let here = fly(drone, Integrator::Rk4, mirrored(&start), &image, 0.002, 50);
            prop_assert!(distance(there.pos, here.pos) < 1e-11);
            prop_assert!(distance(there.ang_vel, here.ang_vel) < 1e-9);
            for i in 0..4 {
                prop_assert!((there.quat[i] - here.quat[i]).abs() < 1e-11);
            }
            prop_assert!(there.rotor_vel.iter().zip(here.rotor_vel).all(|(a, b)| (a - b).abs() < 1e-9));
        }
    }

    #[test]
    fn alike_rotors_neither_turn_a_level_vehicle_nor_push_it_sideways(speed in 0.0..2500.0f64, cmd in 0.0..2500.0f64) {
        let drone = named("cf2x_P250");
        let start = State { rotor_vel: rotor_speeds(speed), ..State::rest() };
        let s = fly(&drone, Integrator::Rk4, start, &Command::Rotors(rotor_speeds(cmd)), 0.002, 100);
        prop_assert!(vec3::norm(s.ang_vel) < 1e-10 && s.pos[0].abs() + s.pos[1].abs() < 1e-10);
        prop_assert!((1..4).all(|i| s.rotor_vel[i] == s.rotor_vel[0]));
    }

    #[test]
    fn attitude_stays_a_unit_quaternion(start in any_state(), speeds in rotors(0.0, 2500.0)) {
        let drone = named("cf2x_L250");
        for integrator in INTEGRATORS {
            let s = fly(&drone, integrator, start, &Command::Rotors(speeds), 0.002, 500);
            let n2: f64 = s.quat.iter().map(|x| x * x).sum();
            prop_assert!((n2 - 1.0).abs() < 1e-14, "{integrator:?}: {n2}");
        }
    }

    #[test]
    fn the_derivatives_of_the_rate_are_exact(start in any_state(), speeds in rotors(0.0, 2500.0), rpy in vector(1.0)) {
        // Not at a switch between spin-up and spin-down, where there is none.
        prop_assume!((0..4).all(|i| (speeds[i] - start.rotor_vel[i]).abs() > 1.0));
        let rotors = with_drag(named("cf21B_500"));
        check_rate_jacobian(&rotors, &start, &Command::Rotors(speeds));
        // Not upside down, nor near 90° of pitch, where the fitted response has an edge.
        let near_level = State { quat: euler::to_quat(rpy), ..start };
        let command = Command::Attitude([0.3, -0.2, 0.5, 0.4]);
        check_rate_jacobian(&with_attitude_response(rotors), &near_level, &command);
    }
}

fn rotor_speeds(w: f64) -> [f64; MAX_ROTORS] {
    [w, w, w, w, 0.0, 0.0, 0.0, 0.0]
}

/// Inputs of a rate: quaternion, velocity, angular velocity, four rotor speeds, thrust, four commands.
const INPUTS: usize = 19;
/// Outputs of a rate that are compared: acceleration, angular acceleration, four rotor accelerations, thrust rate.
const OUTPUTS: usize = 11;
type D = Dual<f64, INPUTS>;

fn pack(s: &State<f64>, command: &Command<f64>) -> [f64; INPUTS] {
    let mut x = [0.0; INPUTS];
    x[..4].copy_from_slice(&s.quat);
    x[4..7].copy_from_slice(&s.vel);
    x[7..10].copy_from_slice(&s.ang_vel);
    x[10..14].copy_from_slice(&s.rotor_vel[..4]);
    x[14] = s.thrust;
    match command {
        Command::Rotors(w) => x[15..].copy_from_slice(&w[..4]),
        Command::Attitude(c) => x[15..].copy_from_slice(c),
    }
    x
}

fn unpack<S: Real>(x: &[S; INPUTS], rotors: bool) -> (State<S>, Command<S>) {
    let zero = S::zero();
    let mut s = State::rest();
    s.quat.copy_from_slice(&x[..4]);
    s.vel.copy_from_slice(&x[4..7]);
    s.ang_vel.copy_from_slice(&x[7..10]);
    s.rotor_vel[..4].copy_from_slice(&x[10..14]);
    s.thrust = x[14];
    let command = [x[15], x[16], x[17], x[18]];
    if rotors {
        let mut w = [zero; MAX_ROTORS];
        w[..4].copy_from_slice(&command);
        (s, Command::Rotors(w))
    } else {
        (s, Command::Attitude(command))
    }
}

fn outputs<S: Copy>(r: &Rate<S>) -> [S; OUTPUTS] {
    let w = &r.rotor_acc;
    let (a, b) = (r.acc, r.ang_acc);
    [a[0], a[1], a[2], b[0], b[1], b[2], w[0], w[1], w[2], w[3], r.thrust_rate]
}

/// Forward-mode Jacobian of [`Drone::rate`] against central differences.
fn check_rate_jacobian(drone: &Drone<f64>, state: &State<f64>, command: &Command<f64>) {
    let rotors = matches!(command, Command::Rotors(_));
    let x = pack(state, command);
    let (s, c) = unpack(&core::array::from_fn(|i| D::input(x[i], i)), rotors);
    let exact = outputs(&drone.map(&mut constant).rate(&s, &c, &Surroundings::calm()));
    let at = |x: &[f64; INPUTS]| {
        let (s, c) = unpack(x, rotors);
        outputs(&drone.rate(&s, &c, &Surroundings::calm()))
    };
    for k in 0..INPUTS {
        let h = 1e-5 * x[k].abs().max(1.0);
        let (mut plus, mut minus) = (x, x);
        plus[k] += h;
        minus[k] -= h;
        let (plus, minus) = (at(&plus), at(&minus));
        for i in 0..OUTPUTS {
            let slope = (plus[i] - minus[i]) / (2.0 * h);
            let rounding = 1e-15 * (plus[i].abs() + minus[i].abs()) / h;
            let error = (exact[i].partials[k] - slope).abs();
            // Central differences are off by h² times the third derivative, and by rounding.
            let allowed = 1e-6 * (1.0 + slope.abs()) + 100.0 * rounding;
            assert!(
                error <= allowed,
                "output {i}, input {k}: {} against {slope} at {x:?}",
                exact[i].partials[k]
            );
        }
    }
    let plain = at(&x);
    for i in 0..OUTPUTS {
        assert!((exact[i].value - plain[i]).abs() <= 1e-12 * plain[i].abs(), "duals compute the same value");
    }
}

/// A number that no input changes.
fn constant(v: f64) -> D {
    D::lit(v)
}

#[test]
fn the_derivatives_of_the_rate_are_exact_at_rest_and_level() {
    let rotors = with_drag(named("cf21B_500"));
    let response = with_attitude_response(rotors.clone());
    let rest = State::rest();
    let hover = rotors.hover_rotor_vel();
    let faster = Command::Rotors(hover.map(|w| 1.1 * w));
    // Everything zero; hover; upright and turned by half a turn about z, where quaternion entries vanish.
    for quat in [[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0, 0.0]] {
        check_rate_jacobian(&rotors, &State { quat, ..rest }, &Command::Rotors(rotor_speeds(700.0)));
        check_rate_jacobian(&rotors, &State { quat, rotor_vel: hover, ..rest }, &faster);
    }
    check_rate_jacobian(&response, &rest, &Command::Attitude([0.0; 4]));
    check_rate_jacobian(&response, &State { thrust: 0.4, ..rest }, &Command::Attitude([0.0, 0.0, 0.0, 0.4]));
}

#[test]
fn the_derivatives_of_the_rate_are_finite_at_ninety_degrees_of_pitch() {
    let drone = with_attitude_response(with_drag(named("cf21B_500"))).map(&mut constant);
    for pitch in
        [core::f64::consts::FRAC_PI_2, -core::f64::consts::FRAC_PI_2, core::f64::consts::FRAC_PI_2 - 3e-7]
    {
        for ang_vel in [[0.0; 3], [1.0, -2.0, 3.0]] {
            let state = State { quat: quat::exp([0.0, pitch, 0.0]), ang_vel, ..State::rest() };
            let x = pack(&state, &Command::Attitude([0.1, 0.2, 0.3, 0.4]));
            let (s, c) = unpack(&core::array::from_fn(|i| D::input(x[i], i)), false);
            for y in outputs(&drone.rate(&s, &c, &Surroundings::calm())) {
                assert!(y.value.is_finite() && y.partials.iter().all(|p| p.is_finite()), "{pitch}: {y:?}");
            }
        }
    }
}

#[test]
fn a_step_has_exact_derivatives_where_the_body_does_not_turn() {
    // The exponential map at zero angle, where a division by the angle would give no number.
    let drone = named("cf21B_500");
    let hover = drone.hover_rotor_vel();
    let command = Command::Rotors(hover.map(|w| 1.05 * w));
    let x = pack(&State { rotor_vel: hover, ..State::rest() }, &command);
    let dual = drone.map(&mut constant);
    let dt = 0.01;
    for integrator in INTEGRATORS {
        let (s, c) = unpack(&core::array::from_fn(|i| D::input(x[i], i)), true);
        let next = integrator.step(&s, constant(dt), |s| dual.rate(s, &c, &Surroundings::calm()));
        let at = |x: &[f64; INPUTS]| {
            let (s, c) = unpack(x, true);
            integrator.step(&s, dt, |s| drone.rate(s, &c, &Surroundings::calm()))
        };
        for k in 0..INPUTS {
            let h = 1e-5 * x[k].abs().max(1.0);
            let (mut plus, mut minus) = (x, x);
            plus[k] += h;
            minus[k] -= h;
            let (plus, minus) = (at(&plus), at(&minus));
            for i in 0..4 {
                let slope = (plus.quat[i] - minus.quat[i]) / (2.0 * h);
                let exact = next.quat[i].partials[k];
                assert!(
                    (exact - slope).abs() < 1e-9,
                    "{integrator:?} quat {i}, input {k}: {exact} against {slope}"
                );
            }
            for i in 0..3 {
                let slope = (plus.pos[i] - minus.pos[i]) / (2.0 * h);
                let exact = next.pos[i].partials[k];
                assert!(
                    (exact - slope).abs() < 1e-9,
                    "{integrator:?} pos {i}, input {k}: {exact} against {slope}"
                );
            }
        }
    }
}

#[test]
fn a_parameter_can_be_the_input_of_a_derivative() {
    // d acc / d mass of a hovering vehicle is −thrust / m².
    let drone = named("cf21B_500");
    let mut dual = drone.map(&mut |v| Dual::<f64, 1> { value: v, partials: [0.0] });
    dual.visit(&mut |name, value| {
        if name == "body.mass_kg" {
            value.partials = [1.0];
        }
    });
    let hover = drone.hover_rotor_vel().map(|w| Dual::<f64, 1> { value: w, partials: [0.0] });
    let state = State { rotor_vel: hover, ..State::rest() };
    let rate = dual.rate(&state, &Command::Rotors(hover), &Surroundings::calm());
    let expected = -drone.hover_thrust() / drone.body.mass_kg.powi(2);
    assert!((rate.acc[2].partials[0] - expected).abs() < 1e-9 * expected.abs());
    assert!(rate.acc[0].partials[0] == 0.0 && rate.acc[1].partials[0] == 0.0);
}
