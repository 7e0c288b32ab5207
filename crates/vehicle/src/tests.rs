//! Tests of vehicle files: published numbers, round trips, refusals.

use super::*;
use propwash_physics::controllers::mellinger::{self, Periods};
use propwash_physics::controllers::{Due, Memory};
use propwash_physics::effects::{AnyEffect, Command};
use propwash_physics::integrate::Integrator;
use propwash_physics::rigid_body::State;
use propwash_physics::surroundings::Surroundings;
use propwash_trace::units::rad_s_to_rpm;

fn all() -> impl Iterator<Item = Vehicle> {
    BUILTIN.iter().map(|name| Vehicle::builtin(name).unwrap())
}

#[test]
fn every_builtin_has_every_dynamics_and_every_mode() {
    for vehicle in all() {
        assert_eq!(vehicle.available_dynamics(), DYNAMICS);
        assert!(vehicle.warnings().is_empty(), "{:?}", vehicle.warnings());
        for name in DYNAMICS {
            let drone = vehicle.drone(name).unwrap();
            assert_eq!(drone.airframe.n_rotors, 4);
            let rotors = name == "first_principles";
            assert_eq!(matches!(drone.dynamics, Dynamics::Rotors), rotors);
            if let Dynamics::AttitudeResponse(p) = &drone.dynamics {
                assert_eq!(p.thrust_dynamics, name != "so_rpy");
                assert_eq!(p.thrust_rate_per_s > 0.0, name != "so_rpy");
            }
            let drag = drone.effects.iter().filter(|e| e.kind() == "linear_drag").count();
            assert_eq!(drag, usize::from(rotors || name == "so_rpy_rotor_drag"), "{} {name}", vehicle.name);
            let modes = vehicle.modes(name).unwrap();
            let want: &[ControlMode] =
                if rotors { &ControlMode::ALL } else { &[ControlMode::State, ControlMode::Attitude] };
            assert_eq!(modes, want);
        }
    }
}

/// Numbers read by hand from the files of Crazyflow 0.4.0 (dynamics/*/params.toml, control/mellinger/params.toml).
#[test]
fn published_numbers_are_those_of_crazyflow() {
    // name, mass, J_zz, kf c1 and c2 in rpm, arm, mass of the controller, thrust2torque, −drag z, so_rpy f, rotor_drag rate
    type Row = (&'static str, f64, f64, f64, f64, f64, f64, f64, f64, f64, f64);
    #[rustfmt::skip]
    let rows: [Row; 4] = [
        ("cf2x_L250", 0.0328, 29.8e-6, -5.382196214637237e-7, 2.4582929831265485e-10, 0.03253, 0.029, 0.007350862856566459, 0.013900090000325344, 1.023224599403443, 6.722233443049602),
        ("cf2x_P250", 0.0318, 29.8e-6, -3.6200226530383495e-7, 1.6060924304100328e-10, 0.03253, 0.029, 0.0069928948992470565, 0.01677452, 0.98275823, 8.6550045096901),
        ("cf2x_T350", 0.0379, 30.0e-6, -7.167227176573658e-7, 2.9401303690194613e-10, 0.03253, 0.0325, 0.005355990836477486, 0.02204579179094129, 1.0140372607776442, 5.686434020676935),
        ("cf21B_500", 0.0434, 49e-6, -3.133427287299859e-7, 4.407354891648379e-10, 0.035355, 0.0393, 0.00593893393599368, 0.02477138502714662, 0.9459441379738676, 11.332539603033299),
    ];
    for (name, mass, jzz, c1, c2, arm, believed, t2t, drag, scale, rate) in rows {
        let vehicle = Vehicle::builtin(name).unwrap();
        let drone = vehicle.drone("first_principles").unwrap();
        assert_eq!((drone.body.mass_kg, drone.body.inertia_kg_m2[2][2]), (mass, jzz), "{name}");
        assert_eq!(drone.body.gravity_m_s2, [0.0, 0.0, -9.81]);
        let thrust = drone.airframe.rotors[0].thrust_curve;
        let rpm = 12_345.0;
        let (want, got) = (c1 * rpm + c2 * rpm * rpm, {
            let w = propwash_trace::units::rpm_to_rad_s(rpm);
            thrust[0] + thrust[1] * w + thrust[2] * w * w
        });
        assert!((got / want - 1.0).abs() < 1e-14, "{name}: {got} {want}");
        assert_eq!(drone.controller.thrust_curve, thrust);
        // Rows of mixing_matrix: roll [-1,-1,1,1], pitch [-1,1,1,-1], yaw [-1,1,-1,1].
        let places = [[arm, -arm], [-arm, -arm], [-arm, arm], [arm, arm]];
        for i in 0..4 {
            let r = &drone.airframe.rotors[i];
            assert_eq!((r.position_m, r.axis), ([places[i][0], places[i][1], 0.0], [0.0, 0.0, 1.0]));
            assert_eq!(r.spin, [-1.0, 1.0, -1.0, 1.0][i]);
            assert_eq!(drone.controller.mixer.wrench_from_rotor[i][3], t2t * r.spin);
        }
        assert_eq!(drone.controller.mass_kg, believed);
        assert_eq!(drone.controller.mass_thrust, 132000.0);
        assert_eq!(drone.controller.state.kp, [0.4, 0.4, 1.25]);
        assert_eq!(drone.controller.body_rate.kw, [20000.0, 20000.0, 12000.0]);
        let AnyEffect::LinearDrag(d) = &drone.effects[0] else { panic!("{:?}", drone.effects) };
        assert_eq!(d.drag_n_s_per_m[2], [0.0, 0.0, drag]);
        let Dynamics::AttitudeResponse(p) = vehicle.drone("so_rpy").unwrap().dynamics else { panic!() };
        assert_eq!(p.thrust_scale, scale);
        let Dynamics::AttitudeResponse(p) = vehicle.drone("so_rpy_rotor_drag").unwrap().dynamics else {
            panic!()
        };
        assert_eq!(p.thrust_rate_per_s, rate);
    }
    // rotor_dyn_coef of cf21B_500: [13.996001897562685, 0.00011093207920685363, 5.933168530682111, 0.00031951312393561264]
    let rotor = Vehicle::builtin("cf21B_500").unwrap().drone("first_principles").unwrap().airframe.rotors[0];
    assert_eq!((rotor.spin_up[0], rotor.spin_down[0]), (13.996001897562685, 5.933168530682111));
    let per_rad = 60.0 / std::f64::consts::TAU;
    assert!((rotor.spin_up[1] / (0.00011093207920685363 * per_rad) - 1.0).abs() < 1e-15);
    assert!((rotor.spin_down[1] / (0.00031951312393561264 * per_rad) - 1.0).abs() < 1e-15);
    assert_eq!((rotor.inertia_kg_m2, rotor.radius_m), (38.93e-9, 27.5e-3));
}

/// PX4-gazebo-models, models/x500/model.sdf, and Crazyflow 0.4.0 for the rest.
#[test]
fn the_x500_has_the_rotors_of_px4_and_the_limits_of_crazyflow() {
    let vehicle = Vehicle::builtin("hb_x500").unwrap();
    let drone = vehicle.drone("first_principles").unwrap();
    let rotor = drone.airframe.rotors[3];
    assert_eq!(rotor.thrust_curve, [0.0, 0.0, 8.54858e-06]);
    assert!((rotor.torque_curve[2] - 8.54858e-06 * 0.016).abs() < 1e-20);
    assert_eq!((rotor.spin_up, rotor.spin_down), ([80.0, 0.0], [40.0, 0.0]));
    assert_eq!((rotor.radius_m, rotor.position_m), (0.127, [0.17678, 0.17678, 0.0]));
    assert_eq!((drone.controller.thrust_min_n, drone.controller.thrust_max_n), (1.0, 12.13));
    assert_eq!(drone.body.mass_kg, 2.28);
    let Dynamics::AttitudeResponse(p) = vehicle.drone("so_rpy_rotor_drag").unwrap().dynamics else {
        panic!()
    };
    assert_eq!(p.angle_gain_per_s2, [-51.423019722268464, -51.423019722268464, -26.92907102709692]);
    let note = vehicle.file().rotor_default.as_ref().unwrap().note.clone().unwrap();
    assert!(note.starts_with("Extrapolated"), "{note}");
}

#[test]
fn hover_speeds_are_those_of_real_propellers() {
    // Crazyflies hover at roughly 13,000 to 18,000 rpm, a 10 inch propeller under 560 g near 7,700 rpm.
    for (name, low, high) in [
        ("cf2x_L250", 15_000.0, 21_000.0),
        ("cf2x_P250", 20_000.0, 25_000.0),
        ("cf2x_T350", 16_000.0, 21_000.0),
        ("cf21B_500", 14_000.0, 17_000.0),
        ("hb_x500", 7_500.0, 8_000.0),
    ] {
        let drone = Vehicle::builtin(name).unwrap().drone("first_principles").unwrap();
        let rpm = rad_s_to_rpm(drone.hover_rotor_vel()[0]);
        assert!((low..high).contains(&rpm), "{name}: {rpm}");
    }
}

/// Five seconds of 500 Hz with the on-board controller after a shove and a tilt.
fn settle(vehicle: &Vehicle) -> State<f64> {
    let drone = vehicle.drone("first_principles").unwrap();
    let mut state = State::rest();
    state.rotor_vel = drone.hover_rotor_vel();
    state.vel = [0.3, -0.2, 0.1];
    state.quat = propwash_trace::math::euler::to_quat([0.2, -0.1, 0.3]);
    let mut memory = Memory::zero();
    let mut command = [0.0; 16];
    command[12] = 1.0;
    let r = &vehicle.rates;
    let period = |hz: u32| 1.0 / f64::from(hz);
    let periods = Periods {
        state: period(r.state_hz),
        attitude: period(r.attitude_hz),
        body_rate: period(r.body_rate_hz),
    };
    for step in 0..2500 {
        let due: Due = r.due(ControlMode::State, step, 500);
        let gravity = drone.body.gravity_m_s2;
        mellinger::run(
            &drone.controller,
            gravity,
            ControlMode::State,
            due,
            &periods,
            &state,
            &command,
            &mut memory,
        );
        let mut speeds = memory.rotor_cmd;
        mellinger::limit_rotor_vel(&drone.controller, &mut speeds);
        let calm = Surroundings::calm();
        state = Integrator::Rk4.step(&state, 1.0 / 500.0, |s| drone.rate(s, &Command::Rotors(speeds), &calm));
    }
    state
}

#[test]
fn every_builtin_settles_after_a_shove() {
    for vehicle in all() {
        let state = settle(&vehicle);
        let rpy = propwash_trace::math::euler::from_quat(state.quat);
        assert!(state.pos.iter().all(|x| x.abs() < 0.5), "{}: {:?}", vehicle.name, state.pos);
        assert!(state.vel.iter().all(|x| x.abs() < 0.1), "{}: {:?}", vehicle.name, state.vel);
        assert!(rpy.iter().all(|x| x.abs() < 0.05), "{}: {rpy:?}", vehicle.name);
    }
}

#[test]
fn files_read_back_equal_and_hash_alike() {
    for vehicle in all() {
        let again = Vehicle::from_toml(&vehicle.name, vehicle.to_toml()).unwrap();
        assert_eq!(again, vehicle);
        assert_eq!(again.sha256(), vehicle.sha256());
        assert_eq!(vehicle.sha256().len(), 64);
        let commented = format!("# a comment\n{}", vehicle.to_toml());
        assert_eq!(Vehicle::from_toml(&vehicle.name, &commented).unwrap().sha256(), vehicle.sha256());
        let mut file = vehicle.file().clone();
        file.body.mass_kg *= 1.5;
        let heavier = Vehicle::from_file(&vehicle.name, file).unwrap();
        assert_ne!(heavier.sha256(), vehicle.sha256());
        assert_eq!(heavier.drone("so_rpy").unwrap().body.mass_kg, vehicle.file().body.mass_kg * 1.5);
    }
    let text = Vehicle::builtin("cf2x_L250").unwrap().to_toml().to_string();
    assert!(text.contains("2.4582929831265485e-10"), "small numbers stay readable: {text}");
}

#[test]
fn notes_that_look_like_numbers_survive_writing() {
    let mut file = Vehicle::builtin("cf2x_L250").unwrap().file().clone();
    file.body.note = Some("two lines\nmass = 0.00000123\n\"quoted\" 'too' \\ end".into());
    let vehicle = Vehicle::from_file("noted", file.clone()).unwrap();
    assert_eq!(Vehicle::from_toml("noted", vehicle.to_toml()).unwrap().file(), &file);
}

#[test]
fn every_builtin_value_has_a_source() {
    for vehicle in all() {
        let all = vehicle.provenance();
        assert!(all.len() > 60, "{}", all.len());
        for p in &all {
            assert!(
                p.source.as_ref().is_some_and(|s| s.contains("Crazyflow 0.4.0") || s.contains("PX4")),
                "{p:?}"
            );
        }
    }
    let of = |key: &str| {
        let all = Vehicle::builtin("cf2x_T350").unwrap().provenance();
        all.into_iter().find(|p| p.key == key).unwrap()
    };
    assert_eq!(of("body.mass_kg").unit, Some("kg"));
    assert_eq!(of("body.mass_kg").value, toml::Value::Float(0.0379));
    assert_eq!(of("rotor.2.spin").unit, None);
    assert_eq!(of("rotor_default.thrust_curve_n_per_rpm").unit, Some("N, N/rpm, N/rpm²"));
    assert_eq!(of("effect.0.drag_n_s_per_m").unit, Some("N·s/m"));
    assert_eq!(of("controller.mellinger.state.integral_max_m_s").unit, Some("m·s"));
    assert_eq!(of("controller.mellinger.torque_pwm_max").unit, Some("PWM"));
    assert_eq!(of("controller.mellinger.pwm_min").unit, Some("PWM"));
    assert_eq!(of("rates.state_hz").unit, Some("Hz"));
}

const BASE: &str = include_str!("../../../params/cf2x_L250.toml");

/// The file of cf2x_L250 with one piece of text replaced.
fn changed(from: &str, to: &str) -> Result<Vehicle, VehicleError> {
    assert!(BASE.contains(from), "the file has no {from:?}");
    Vehicle::from_toml("test", &BASE.replacen(from, to, 1))
}

#[test]
fn sigmas_and_logs_of_fits_are_kept() {
    let fit = r#"
[[effect]]
kind = "command_delay"
delay_s = 0.012
sigma = { delay_s = 0.001 }
source_log_sha256 = "abc"
date = "2025-01-02"
"#;
    let vehicle = Vehicle::from_toml("fit", &format!("{BASE}{fit}")).unwrap();
    let last = vehicle.provenance().into_iter().find(|p| p.key == "effect.1.delay_s").unwrap();
    assert_eq!(last.sigma, Some(toml::Value::Float(0.001)));
    assert_eq!(last.source.as_deref(), Some("fitted to the log of sha256 abc on 2025-01-02"));
    assert_eq!(last.unit, Some("s"));
    for name in DYNAMICS {
        let effects = vehicle.drone(name).unwrap().effects;
        let AnyEffect::CommandDelay(p) = effects.last().unwrap() else { panic!("{effects:?}") };
        assert_eq!(p.delay_s, 0.012);
    }
    assert_eq!(Vehicle::from_toml("fit", vehicle.to_toml()).unwrap(), vehicle);
    // Several logs, and sigmas of only those numbers of an array that were fitted.
    let partial = r#"
[[effect]]
kind = "weak_rotor"
factor = [1.0, 1.0, 0.93, 1.0]
sigma = { factor.2 = 0.004 }
source_log_sha256 = ["abc", "def"]
"#;
    let n = named_factor_count();
    let factors = (0..n).map(|i| if i == 2 { "0.93" } else { "1.0" }).collect::<Vec<_>>().join(", ");
    let partial = partial.replace("1.0, 1.0, 0.93, 1.0", &factors);
    let vehicle = Vehicle::from_toml("fit", &format!("{BASE}{partial}")).unwrap();
    let factor = vehicle.provenance().into_iter().find(|p| p.key == "effect.1.factor").unwrap();
    assert_eq!(factor.sigma.unwrap().to_string(), "{ 2 = 0.004 }");
    assert_eq!(factor.source.as_deref(), Some("fitted to the logs of sha256 abc, def"));
    assert_eq!(vehicle.file().effect[1].source_log_sha256.as_ref().unwrap().as_slice(), ["abc", "def"]);
    assert_eq!(Vehicle::from_toml("fit", vehicle.to_toml()).unwrap(), vehicle);
    for (sigma, words) in [
        ("{ factor.9 = 0.1 }", &["`effect.1.sigma.factor.9`", "an index into factor", "count from 0"][..]),
        ("{ factor.2 = -0.1 }", &["`effect.1.sigma.factor.2`", "not negative"]),
        ("{ factor.2.0 = 0.1 }", &["`effect.1.sigma.factor.2.0`", "an index into factor"]),
        ("{ factor.2 = \"x\" }", &["`effect.1.sigma.factor.2`", "a number"]),
        ("{ factor = {} }", &["`effect.1.sigma.factor`", "empty table"]),
        ("{ factor = [0.1, 0.1] }", &["`effect.1.sigma.factor`", "2 numbers", "by index"]),
    ] {
        let text = format!("{BASE}{}", partial.replace("{ factor.2 = 0.004 }", sigma));
        let error = Vehicle::from_toml("fit", &text).unwrap_err().to_string();
        for word in words {
            assert!(error.contains(word), "no {word:?} in {error}");
        }
    }
    let text = format!("{BASE}{}", partial.replace("[\"abc\", \"def\"]", "12"));
    let error = Vehicle::from_toml("fit", &text).unwrap_err().to_string();
    assert!(error.contains("expected a SHA-256 in quotes or a list of them"), "{error}");
    assert!(error.contains("write the value in the type"), "{error}");

    let body = changed("mass_kg = 0.0328", "mass_kg = 0.0328\nsigma = { mass_kg = 0.0001 }").unwrap();
    let mass = body.provenance().into_iter().find(|p| p.key == "body.mass_kg").unwrap();
    assert_eq!(mass.sigma, Some(toml::Value::Float(0.0001)));
}

#[test]
fn units_of_the_file_do_not_change_the_vehicle() {
    let published = Vehicle::from_toml("a", BASE).unwrap().drone("first_principles").unwrap();
    let rotor = published.airframe.rotors[0];
    let list = |c: &[f64]| format!("{c:?}");
    let mut file = Vehicle::from_toml("a", BASE).unwrap().file().clone();
    let default = file.rotor_default.as_mut().unwrap();
    default.thrust_curve_n_per_rpm = None;
    default.thrust_curve_n_per_rad_s = Some(rotor.thrust_curve);
    default.torque_curve_n_m_per_rpm = None;
    default.torque_curve_n_m_per_rad_s = Some(rotor.torque_curve);
    default.spin_up_per_s_and_per_rpm_s = None;
    default.spin_up_per_s_and_per_rad = Some(rotor.spin_up);
    default.spin_down_per_s_and_per_rpm_s = None;
    default.spin_down_per_s_and_per_rad = Some(rotor.spin_down);
    let si = Vehicle::from_file("a", file).unwrap();
    assert_eq!(si.drone("first_principles").unwrap(), published, "{}", list(&rotor.thrust_curve));
}

#[test]
fn a_rotor_may_differ_from_the_default() {
    let own = "spin = -1\nthrust_curve_n_per_rad_s = [0.0, 0.0, 3e-8]\ntorque_per_thrust_m = 0.01\nradius_m = 0.03\naxis = [0.0, 0.0, 1.0000001]";
    let drone = changed("spin = -1", own).unwrap().drone("first_principles").unwrap();
    let (first, second) = (drone.airframe.rotors[0], drone.airframe.rotors[1]);
    assert_eq!(first.thrust_curve, [0.0, 0.0, 3e-8]);
    assert!((first.torque_curve[2] - 3e-10).abs() < 1e-24);
    assert_eq!((first.radius_m, second.radius_m), (0.03, 23.55e-3));
    assert_eq!(first.axis, [0.0, 0.0, 1.0]);
    assert_ne!(second.thrust_curve, first.thrust_curve);
    assert_eq!(first.spin_up, second.spin_up);
}

#[test]
fn a_vehicle_without_a_control_law_takes_rotor_speeds() {
    let start = BASE.find("[controller.mellinger]").unwrap();
    let end = BASE.find("[rates]").unwrap();
    let direct = "[controller.direct]\nthrust_min_n = 0.01\nthrust_max_n = 0.12\n\n";
    let text = format!("{}{direct}{}", &BASE[..start], &BASE[end..]);
    let vehicle = Vehicle::from_toml("direct", &text).unwrap();
    assert_eq!(vehicle.modes("first_principles").unwrap(), [ControlMode::ForceTorque, ControlMode::RotorVel]);
    assert_eq!(vehicle.modes("so_rpy").unwrap(), [ControlMode::Attitude]);
    assert!(vehicle.warnings().is_empty());
    // All rotors turning one way: no yaw without thrust. An error with a control law, a warning without.
    let one_way = vehicle.to_toml().replace("spin = -1.0", "spin = 1.0");
    let vehicle = Vehicle::from_toml("one way", &one_way).unwrap();
    assert_eq!(vehicle.modes("first_principles").unwrap(), [ControlMode::RotorVel]);
    assert!(vehicle.warnings()[0].contains("rank 3 of 4"), "{:?}", vehicle.warnings());
    let error = Vehicle::from_toml("x", &BASE.replace("spin = -1", "spin = 1")).unwrap_err().to_string();
    for word in ["`rotor`", "thrust and torque about x, y and z", "rank 3 of 4", "[controller.direct]"] {
        assert!(error.contains(word), "{error}");
    }
}

#[test]
fn doubtful_vehicles_are_warned_about() {
    let impossible = changed("[0.0, 0.0, 29.8e-6]", "[0.0, 0.0, 39.8e-6]").unwrap();
    assert!(impossible.warnings()[0].contains("triangle inequality"), "{:?}", impossible.warnings());
    let heavy = changed("mass_kg = 0.0328", "mass_kg = 0.0528").unwrap();
    assert!(heavy.warnings()[0].contains("cannot hover"), "{:?}", heavy.warnings());
    let light = changed("mass_kg = 0.0328", "mass_kg = 0.0008").unwrap();
    assert!(light.warnings()[0].contains("cannot sink"), "{:?}", light.warnings());
}

/// `(replaced, by, words that the message must have)`: key, what was expected or found, remedy.
#[rustfmt::skip]
const REFUSED: &[(&str, &str, &[&str])] = &[
    ("mass_kg = 0.0328", "mas_kg = 0.0328", &["unknown field `mas_kg`", "`mass_kg`", "line 8", "correct or remove the key"]),
    ("mass_kg = 0.0328\n", "", &["missing field `mass_kg`", "[body]", "add the key"]),
    ("mass_kg = 0.0328", "mass_kg = -0.0328", &["`body.mass_kg`", "above 0 kg", "-0.0328", "write a positive number"]),
    ("mass_kg = 0.0328", "mass_kg = nan", &["`body.mass_kg`", "finite", "NaN", "neither nan nor inf"]),
    ("mass_kg = 0.0328", "mass_kg = \"30 g\"", &["invalid type", "30 g", "numbers without quotes"]),
    ("mass_kg = 0.0328", "mass_kg = 0.0328 kg", &["line 8", "correct the TOML syntax"]),
    ("mass_kg = 0.0328", "mass_kg = 0.0328\nsigma = { mas_kg = 1.0 }", &["`body.sigma.mas_kg`", "mass_kg", "sigma to a value"]),
    ("mass_kg = 0.0328", "mass_kg = 0.0328\nsigma = { mass_kg = -1.0 }", &["`body.sigma.mass_kg`", "not negative", "write 0"]),
    ("mass_kg = 0.0328", "mass_kg = 0.0328\nsigma = { mass_kg = [1.0, 2.0] }", &["`body.sigma.mass_kg`", "one number", "2 numbers", "one sigma per number"]),
    ("gravity_m_s2 = [0.0, 0.0, -9.81]", "gravity_m_s2 = [0.0, -9.81]", &["invalid length 2", "array of length 3", "as many numbers"]),
    ("gravity_m_s2 = [0.0, 0.0, -9.81]", "gravity_m_s2 = [0.0, 0.0, -9.81, 1.0]", &["`body.gravity_m_s2`", "3 numbers", "found 4", "too many"]),
    ("[0.0, 16.8e-6, 0.0]", "[0.0, 16.8e-6, 0.0, 1.0]", &["`body.inertia_kg_m2.1`", "found 4", "too many"]),
    ("[0.0, 16.8e-6, 0.0]", "[1e-6, 16.8e-6, 0.0]", &["`body.inertia_kg_m2.0.1`", "symmetric", "both sides of the diagonal"]),
    ("[0.0, 16.8e-6, 0.0]", "[0.0, -16.8e-6, 0.0]", &["`body.inertia_kg_m2`", "positive definite", "principal moments"]),
    ("thrust_curve_n_per_rpm = [0.0, -5.382196214637237e-7, 2.4582929831265485e-10]", "thrust_curve_n_per_rpm = [0.0, 1e-7, -2e-10]", &["`rotor.0.thrust_curve (c2)`", "above 0", "the last one positive"]),
    ("thrust_curve_n_per_rpm = ", "thrust_curve_n_per_rad_s = [0.0, 0.0, 1e-8]\nthrust_curve_n_per_rpm = ", &["`rotor_default.thrust_curve_n_per_rad_s`", "only one of", "keep the form"]),
    ("thrust_curve_n_per_rpm = [0.0, -5.382196214637237e-7, 2.4582929831265485e-10]", "", &["`rotor.0.thrust_curve_n_per_rpm`", "found nothing", "[rotor_default]"]),
    ("spin_down_per_s_and_per_rpm_s = [0.0, 0.00024443862952110715]", "time_constant_down_s = -0.1", &["rotor.0.spin_down", "not negative", "at least one positive"]),
    ("radius_m = 23.55e-3", "radius_m = 0", &["`rotor.0.radius_m`", "above 0 m", "write a positive number"]),
    ("radius_m = 23.55e-3", "radius_m = 0.02\nspin = 1", &["`rotor_default.spin`", "every rotor has its own", "move it"]),
    ("spin = -1", "spin = -2", &["`rotor.0.spin`", "clockwise", "found -2", "write 1 or -1"]),
    ("spin = -1\n", "", &["`rotor.0.spin`", "found nothing", "add it"]),
    ("position_m = [0.03253, -0.03253, 0.0]\n", "", &["`rotor.0.position_m`", "hub", "add it"]),
    ("spin = -1", "spin = -1\naxis = [0.0, 0.1, 1.0]", &["`rotor.0.axis`", "unit vector", "divide"]),
    ("thrust_min_n = 0.012817578393224994", "thrust_min_n = 0.2", &["`controller.mellinger.thrust_min_n`", "less than thrust_max_n, 0.12", "least and greatest"]),
    ("pwm_min = 7000", "pwm_min = 70000", &["`controller.mellinger.pwm_min`", "less than pwm_max", "least and the greatest"]),
    ("kp_n_per_m = [0.4, ", "kp_n_per_m = [-0.4, ", &["`controller.mellinger.state.kp_n_per_m.0`", "not negative", "write 0"]),
    ("thrust_to_torque_m = 0.007350862856566459", "thrust_to_torque_m = 0", &["`controller.mellinger.thrust_to_torque_m`", "above 0 m", "positive"]),
    ("[controller.mellinger.attitude]", "[controller.mellinger.atitude]", &["`atitude`", "`attitude`", "docs/vehicles.md"]),
    ("[rates]", "[controller.direct]\nthrust_min_n = 0.0\nthrust_max_n = 1.0\n[rates]", &["`controller`", "found both", "keep"]),
    ("[rates]", "[throttle]\nback_emf_v_s_per_rad = 1e-3\nnominal_v = 0.0\n[rates]", &["`throttle.nominal_v`", "above 0 V", "positive"]),
    ("[rates]", "[throttle]\nback_emf_v_s_per_rad = -1e-3\nnominal_v = 3.7\n[rates]", &["`throttle.back_emf_v_s_per_rad`", "not negative", "write 0"]),
    ("[rates]", "[throttle]\nback_emf_v_s_per_rad = 0.0\nnominal_v = 3.7\n[rates]", &["`throttle.back_emf_v_s_per_rad`", "0 for both", "take the table out"]),
    ("[rates]", "[throttle]\nback_emf_v_s_per_rad = 1e-3\nnominal_v = 3.7\nvoltage = \"mains\"\n[rates]", &["unknown variant `mains`", "`battery`", "`nominal`"]),
    ("state_hz = 100", "state_hz = 0", &["`rates.state_hz`", "above 0 Hz", "positive"]),
    ("state_hz = 100", "state_hz = -5", &["invalid value", "state_hz = -5", "u32"]),
    ("thrust_rate_per_s = 11.531559320597035\n", "", &["`attitude_response.so_rpy_rotor.thrust_rate_per_s`", "found nothing", "so_rpy"]),
    ("thrust_scale = 1.023224599403443", "thrust_scale = 1.0\nthrust_rate_per_s = 3.0", &["`attitude_response.so_rpy.thrust_rate_per_s`", "at once", "so_rpy_rotor"]),
    ("kind = \"linear_drag\"", "kind = \"cubic_drag\"", &["`effect.0.kind`", "linear_drag, constant_wind", "cubic_drag", "correct the name"]),
    ("models = [\"first_principles\"", "models = [\"first_principle\"", &["`effect.0.models.0`", "first_principles, so_rpy", "correct the name"]),
    ("drag_n_s_per_m = [", "drag = 1.0\ndrag_n_s_per_m = [", &["`effect.0.drag`", "linear_drag (drag_n_s_per_m)", "correct or remove"]),
    ("    [0.0, 0.0, 0.013900090000325344],\n", "", &["`effect.0.drag_n_s_per_m`", "9 numbers (3 × 3)", "6 numbers (2 × 3)", "as many numbers"]),
    ("[0.0, 0.0, 0.013900090000325344]", "[0.0, 0.0, \"x\"]", &["`effect.0.drag_n_s_per_m.2.2`", "a string", "without quotes"]),
    ("[[effect]]", "[[effect]]\nkind = \"command_delay\"\ndelay_s = 0.7\n[[effect]]", &["`effect.0.delay_s`", "from 0 to 0.5", "0.7", "range"]),
    ("[[effect]]", "[[effect]]\nkind = \"wrong_inertia\"\nproduct = [0.5, 0, 0]\n[[effect]]", &["`effect.0.product.0`", "from -0.49 to 0.49", "found 0.5"]),
    ("[[effect]]", "[[effect]]\nkind = \"linear_drag\"\n[[effect]]", &["`effect.1.kind`", "once for first_principles", "merge"]),
    ("shell = \"cf2x\"", "shell = \"\"", &["`shell`", "name of a shell", "write"]),
    ("[body]", "[bodi]", &["unknown field `bodi`", "`body`", "correct or remove"]),
];

#[test]
fn an_effect_that_leaves_no_inertia_is_refused() {
    let askew = "[[effect]]\nkind = \"wrong_inertia\"\nproduct = [0.45, 0, 0]\n[[effect]]";
    let with = BASE.replacen("[[effect]]", askew, 1);
    Vehicle::from_toml("askew", &with).unwrap();
    // Two thirds of the geometric mean in the file and 0.45 more: no body.
    let filed = with.replacen("[16.8e-6, 0.0, 0.0]", "[16.8e-6, 11e-6, 0.0]", 1).replacen(
        "[0.0, 16.8e-6, 0.0]",
        "[11e-6, 16.8e-6, 0.0]",
        1,
    );
    let message = Vehicle::from_toml("askew", &filed).unwrap_err().to_string();
    for part in ["`effect.0`", "positive definite", "wrong_inertia", "smaller"] {
        assert!(message.contains(part), "{part}: {message}");
    }
}

#[test]
fn wrong_files_are_refused_with_key_and_remedy() {
    for (from, to, words) in REFUSED {
        let error = match changed(from, to) {
            Ok(_) => panic!("{to:?} in place of {from:?} was accepted"),
            Err(error) => error.to_string(),
        };
        for word in *words {
            assert!(error.contains(word), "{to:?} in place of {from:?}: no {word:?} in\n{error}");
        }
        assert!(error.starts_with("test"), "no file name in {error}");
    }
}

#[test]
fn missing_tables_are_named() {
    for table in ["body", "controller", "rates", "rotor"] {
        let mut file: toml::Table = toml::from_str(BASE).unwrap();
        file.remove(table);
        let error = Vehicle::from_toml("test", &toml::to_string(&file).unwrap()).unwrap_err().to_string();
        assert!(error.contains(&format!("missing field `{table}`")) && error.contains("add"), "{error}");
    }
    let mut file: toml::Table = toml::from_str(BASE).unwrap();
    file.remove("attitude_response");
    let vehicle = Vehicle::from_toml("test", &toml::to_string(&file).unwrap()).unwrap();
    assert_eq!(vehicle.available_dynamics(), ["first_principles"]);
    let error = vehicle.drone("so_rpy").unwrap_err().to_string();
    for word in ["test", "`attitude_response.so_rpy`", "has first_principles", "add the table"] {
        assert!(error.contains(word), "{error}");
    }
    let rotors = toml::Value::Array(vec![file["rotor"][0].clone(); 9]);
    file.insert("rotor".into(), rotors);
    let error = Vehicle::from_toml("test", &toml::to_string(&file).unwrap()).unwrap_err().to_string();
    assert!(error.contains("`rotor`") && error.contains("1 to 8") && error.contains("found 9"), "{error}");
}

#[test]
fn unknown_names_list_the_known_ones() {
    let error = Vehicle::builtin("cf3").unwrap_err().to_string();
    assert!(error.contains("`cf3`") && error.contains("cf2x_L250, cf2x_P250"), "{error}");
    let error = Vehicle::builtin("hb_x500").unwrap().drone("so").unwrap_err().to_string();
    assert!(error.contains("`so`") && error.contains("so_rpy_rotor_drag"), "{error}");
    let error = Vehicle::load("/nowhere/x.toml").unwrap_err().to_string();
    assert!(error.contains("/nowhere/x.toml") && error.contains("check the path"), "{error}");
}

#[test]
fn a_loaded_file_knows_its_name_and_the_place_of_its_shell() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("mine.toml");
    std::fs::write(&path, BASE.replace("shell = \"cf2x\"", "shell = \"mine_shell.xml\"")).unwrap();
    let vehicle = Vehicle::load(&path).unwrap();
    assert_eq!(vehicle.name, "mine");
    assert_eq!(vehicle.shell_path(), Some(dir.path().join("mine_shell.xml")));
    assert_eq!(Vehicle::builtin("cf2x_L250").unwrap().shell_path(), None);
    std::fs::write(&path, [0xff, 0xfe]).unwrap();
    let error = Vehicle::load(&path).unwrap_err().to_string();
    assert!(error.contains("mine.toml") && error.contains("UTF-8"), "{error}");
}

#[test]
fn damaged_files_are_errors_and_never_panics() {
    let mut seed = 1_u64;
    let mut random = move |below: usize| {
        seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (seed >> 33) as usize % below
    };
    let pieces: Vec<&str> = BASE.split_inclusive(|c: char| !c.is_alphanumeric()).collect();
    let mut refused = 0;
    for _ in 0..2000 {
        let mut text = pieces.clone();
        for _ in 0..=random(3) {
            let (from, to) = (random(text.len()), random(text.len()));
            match random(3) {
                0 => text[to] = text[from],
                1 => drop(text.remove(from)),
                _ => text.insert(to, text[from]),
            }
        }
        let read = Vehicle::from_toml("damaged", &text.concat());
        refused += usize::from(read.is_err());
        for name in DYNAMICS {
            let _ = read.as_ref().map(|v| v.drone(name));
        }
    }
    assert!(refused > 500, "{refused}");
}

#[test]
fn the_example_of_the_handbook_is_a_vehicle() {
    let handbook = include_str!("../../../docs/vehicles.md");
    let start = handbook.find("```toml\n").unwrap() + "```toml\n".len();
    let text = &handbook[start..start + handbook[start..].find("```").unwrap()];
    let vehicle = Vehicle::from_toml("example", text).unwrap();
    assert_eq!(vehicle.available_dynamics(), ["first_principles", "so_rpy"]);
    assert!(vehicle.warnings().is_empty(), "{:?}", vehicle.warnings());
    let drone = vehicle.drone("first_principles").unwrap();
    assert_eq!(drone.effects.len(), 2);
    assert_eq!(drone.airframe.rotors[2].spin_up, [20.0, 0.0]);
    for name in BUILTIN {
        assert!(handbook.contains(&format!("`{name}`")), "{name} is not in the table");
    }
}

/// Numbers in the `factor` of `weak_rotor`.
fn named_factor_count() -> usize {
    effects::named_parameters(&AnyEffect::by_kind("weak_rotor").unwrap()).len()
}

#[test]
fn the_parameters_of_every_effect_have_the_unit_of_their_page() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/effects");
    for kind in propwash_physics::effects::KINDS {
        let page = std::fs::read_to_string(folder.join(format!("{kind}.md"))).unwrap();
        for (name, _) in effects::named_parameters(&AnyEffect::by_kind(kind).unwrap()) {
            let field = name.split('.').next().unwrap();
            let row = page.lines().find(|l| l.starts_with(&format!("| `{field}` |"))).unwrap();
            let unit = row.split('|').nth(2).unwrap().trim();
            assert_eq!(provenance::unit_of(field).unwrap_or("1"), unit, "{kind}: {field}");
        }
    }
}

#[test]
fn equal_vehicles_have_no_difference_and_layout_is_none() {
    for vehicle in all() {
        let again = Vehicle::from_toml("again", vehicle.to_toml()).unwrap();
        assert!(diff(&vehicle, &again).is_same(), "{:?}", diff(&vehicle, &again));
    }
    let a = Vehicle::builtin("cf2x_L250").unwrap();
    for other in all().filter(|v| v.name != a.name) {
        let d = diff(&a, &other);
        assert!(
            d.parameters.iter().any(|p| p.name == "body.mass_kg" && p.unit == Some("kg")),
            "{}",
            other.name
        );
    }
}

#[test]
fn differences_are_told_in_si_with_their_sigmas() {
    let a = Vehicle::from_toml("a", BASE).unwrap();
    let mut text = BASE.replace("mass_kg = 0.0328", "mass_kg = 0.0361\nsigma = { mass_kg = 0.0002 }");
    text = text
        .replace("2.4582929831265485e-10]", "3e-10]\nsigma = { thrust_curve_n_per_rpm = [0.0, 0.0, 1e-12] }");
    text = text.replace("thrust_to_torque_m = 0.007350862856566459", "thrust_to_torque_m = 0.008");
    text += "[[effect]]\nkind = \"payload\"\nmass_kg = 0.004\nsigma = { mass_kg = 0.0003 }\n";
    let b = Vehicle::from_toml("b", &text).unwrap();
    let d = diff(&a, &b);
    let names: Vec<&str> = d.parameters.iter().map(|p| p.name.as_str()).collect();
    let curves = (0..4).map(|i| format!("rotors.{i}.thrust_curve.2"));
    let mut want: Vec<String> = vec!["body.mass_kg".into()];
    want.extend(curves);
    want.push("controller.thrust_to_torque_m".into());
    assert_eq!(names, want);
    let mass = &d.parameters[0];
    assert_eq!((mass.old, mass.new, mass.new_sigma), (Some(0.0328), Some(0.0361), Some(0.0002)));
    assert!((mass.change_percent.unwrap() - 100.0 * 0.0033 / 0.0328).abs() < 1e-9);
    let curve = &d.parameters[1];
    assert_eq!(curve.unit, Some("N·s²/rad²"));
    let scale = propwash_trace::units::RAD_S_PER_RPM.powi(2);
    assert!((curve.new.unwrap() * scale / 3e-10 - 1.0).abs() < 1e-12);
    assert!((curve.new_sigma.unwrap() * scale / 1e-12 - 1.0).abs() < 1e-12);
    let [payload] = d.effects.as_slice() else { panic!("{:?}", d.effects) };
    assert_eq!(
        (payload.kind.as_str(), payload.change, &payload.dynamics[..]),
        ("payload", "added", &DYNAMICS[..])
    );
    assert_eq!(payload.parameters.len(), 4);
    assert_eq!(payload.parameters[0].new_sigma, Some(0.0003));
    let back = diff(&b, &a);
    assert_eq!((back.effects[0].change, back.effects[0].parameters[0].new), ("removed", None));
    assert_eq!(back.parameters[0].old_sigma, Some(0.0002));

    // One dynamics only, and the order of effects.
    let drag = "[[effect]]\nkind = \"linear_drag\"\nmodels = [\"so_rpy\"]\n";
    let c = Vehicle::from_toml("c", &format!("{BASE}{drag}")).unwrap();
    assert_eq!(diff(&a, &c).effects[0].dynamics, ["so_rpy"]);
    let two = |x: &str, y: &str| {
        Vehicle::from_toml("two", &format!("{BASE}[[effect]]\nkind = \"{x}\"\n[[effect]]\nkind = \"{y}\"\n"))
            .unwrap()
    };
    let order = diff(&two("payload", "com_offset"), &two("com_offset", "payload"));
    assert!(order.effects.is_empty() && order.other.len() == 4, "{order:?}");
    assert!(order.other[0].contains("payload, com_offset → "), "{}", order.other[0]);
}

#[test]
fn files_that_are_no_descriptions_of_vehicles_are_not_read_whole() {
    let folder = std::env::temp_dir().join(format!("propwash_huge_{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("huge.toml");
    std::fs::File::create(&path).unwrap().set_len(1 << 34).unwrap();
    let said = Vehicle::load(&path).unwrap_err().to_string();
    assert!(said.contains("has more than 16777216 bytes"), "{said}");
    std::fs::remove_dir_all(&folder).unwrap();
}
