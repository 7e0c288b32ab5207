//! Tests of expression effects.

use super::*;
use crate::Vehicle;
use propwash_physics::drone::{Drone, Dynamics};
use propwash_physics::effects::expression::{Known, known};
use propwash_physics::effects::{AnyEffect, Command, Effect, candidates, linear_drag};
use propwash_physics::params::Parameters;
use propwash_physics::rigid_body::{MAX_ROTORS, State};
use propwash_physics::sample::quad;
use propwash_physics::surroundings::{Neighbour, Reads, Surroundings};
use propwash_trace::Real;
use propwash_trace::dual::Dual;
use propwash_trace::math::{euler, quat};

/// Value of an expression of a = 2, b = −3.
fn value(text: &str) -> f64 {
    let program = parse(text, &["a", "b"]).unwrap();
    program.eval(|i| [2.0, -3.0][usize::from(i) - VARIABLES.len()])
}

#[test]
fn texts_mean_what_mathematicians_mean() {
    for (text, expected) in [
        ("1 + 2 * 3", 7.0),
        ("(1 + 2) * 3", 9.0),
        ("7 - 2 - 1", 4.0),
        ("8 / 4 / 2", 1.0),
        ("-a^2", -4.0),
        ("(-a)^2", 4.0),
        ("a^-2", 0.25),
        ("2 * a ^ 3 + 1", 17.0),
        ("a^2^2", 16.0),
        ("-a * -b", -6.0),
        ("--a", 2.0),
        ("4 - -a", 6.0),
        ("1.5e-1 + .5 + 2E+1 + 3.", 23.65),
        ("abs(b) + sqrt(9) + max(a, b) - min(a, b)", 11.0),
        ("sin(0) + cos(0) + exp(0) + tanh(0)", 2.0),
        ("max( a+1 , b ) * 2", 6.0),
        (" 2*( a\t- (b) ) ", 10.0),
        ("tan(0) + asin(0) + acos(1) + atan2(0, 1) + floor(2.7) + sign(b)", 1.0),
        ("where(a > b, a, b) + where(a < b, a, b)", -1.0),
        ("where(a >= 2, 1, 0) + 2 * (b <= -3) + 4 * (a + 1 > 3) + 8 * (b<a)", 11.0),
        ("where(min(a > 0, b > 0), 1, 2) + where(max(a > 0, b > 0), 10, 20)", 12.0),
        ("where(a, 1, 2) + where(a - 2, 10, 20)", 21.0),
    ] {
        assert!((value(text) - expected).abs() < 1e-12, "{text} = {}", value(text));
    }
    assert!((value("exp(sin(a)) / cos(b)") - 2f64.sin().exp() / 3f64.cos()).abs() < 1e-12);
}

#[test]
fn faults_are_named_with_their_place_and_what_was_expected() {
    let deep = format!("{}1{}", "(".repeat(70), ")".repeat(70));
    let wide = format!("{}a{}", "(1 + ".repeat(40), ")".repeat(40));
    for (text, column, expected, found) in [
        ("", 1, "a number, a variable", "the end"),
        ("a +", 4, "a number, a variable", "the end"),
        ("a b", 3, "an operator", "`b`"),
        ("2a", 1, "a finite number", "`2a`"),
        ("a * vx_bdy", 5, "did you mean `vx_body`?", "`vx_bdy`"),
        ("c + 1", 1, "a variable or a declared parameter", "`c`"),
        ("(a + b", 7, "`)` or an operator", "the end"),
        ("a)", 2, "an operator", "`)`"),
        ("cot(a)", 1, "a function (abs, sqrt", "`cot(`"),
        ("a < b < 3", 7, "one comparison", "`<`"),
        ("where(a, b)", 1, "3 arguments of where", "2"),
        ("coss(a)", 1, "did you mean `cos`?", "`coss(`"),
        ("1 + sin", 5, "`(` after the function `sin`", "`sin`"),
        ("sin()", 1, "1 argument of sin", "0"),
        ("max(a)", 1, "2 arguments of max", "1"),
        ("abs(a, b)", 1, "1 argument of abs", "2"),
        ("a^b", 3, "an integer from -16 to 16", "`b`"),
        ("a^1.5", 3, "an integer from -16 to 16", "`1.5`"),
        ("a^17", 3, "an integer from -16 to 16", "`17`"),
        ("a^", 3, "an integer from -16 to 16", "the end"),
        ("1e999", 1, "a finite number", "`1e999`"),
        ("1.2.3", 1, "a finite number", "`1.2.3`"),
        ("a − b", 3, "an operator", "no minus sign"),
        ("a = b", 3, "an operator", "`=`"),
        ("a ** 2", 4, "a number, a variable", "`*`"),
        (&deep, 66, "at most 64 parentheses", "more"),
        (&wide, 1, "at most 32 numbers at once", "41"),
    ] {
        let error = parse(text, &["a", "b"]).unwrap_err();
        assert_eq!(error.column, column, "{text}: {error}");
        assert!(error.expected.contains(expected), "{text}: {error}");
        assert!(error.found.contains(found), "{text}: {error}");
    }
    assert!(parse(&"1+".repeat(600), &[]).unwrap_err().expected.contains("1000 characters"));
}

const TETHER: &str = r#"
[[effect]]
kind = "expression"
name = "tether"
force_body_n = ["-k * vx_body", "0", "-c * abs(wz) * rotor_sum"]
source = "guess"

[effect.parameter.k]
value = 0.3
unit = "N·s/m"
spike = 0.001
slab = 0.2
sign = "up"
min = 0.0
sigma = { value = 0.01 }

[effect.parameter.c]
value = 1e-7
unit = "N·s²/rad²"
"#;

fn with(entries: &str) -> Result<Vehicle, VehicleError> {
    let mut file = Vehicle::builtin("cf2x_L250").unwrap().file().clone();
    file.effect.clear();
    let plain = Vehicle::from_file("plain", file).unwrap();
    Vehicle::from_toml("mine", &format!("{}\n{entries}", plain.to_toml()))
}

/// The sample vehicle with the effects of `entries`.
fn sample(entries: &str) -> Drone<f64> {
    quad(with(entries).unwrap().drone("first_principles").unwrap().effects)
}

fn entry(name: &str, lines: &str) -> String {
    format!("[[effect]]\nkind = \"expression\"\nname = \"{name}\"\n{lines}\n")
}

fn tilted<S: Real>() -> State<S> {
    let list = |a: [f64; 3]| a.map(S::lit);
    State {
        pos: list([0.5, -1.0, 2.0]),
        vel: list([1.0, -2.0, 1.5]),
        ang_vel: list([0.3, -0.2, 0.5]),
        quat: euler::to_quat(list([0.2, -0.3, 0.4])),
        rotor_vel: [480.0, 500.0, 520.0, 470.0, 0.0, 0.0, 0.0, 0.0].map(S::lit),
        ..State::rest()
    }
}

fn acc(drone: &Drone<f64>) -> ([f64; 3], [f64; 3]) {
    let around = Surroundings { wind_m_s: [0.5, 0.2, -0.1], time_s: 0.7, ..Surroundings::calm() };
    let rate = drone.rate(&tilted(), &Command::Rotors([500.0; MAX_ROTORS]), &around);
    (rate.acc, rate.ang_acc)
}

fn close(a: [f64; 3], b: [f64; 3]) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9)
}

#[test]
fn drag_written_as_an_expression_is_drag() {
    let written = entry("d", "force_body_n = [\"-0.3 * vx_body\", \"-0.4*vy_body\", \"-vz_body / 2\"]");
    let drag = linear_drag::Params { drag_n_s_per_m: [[0.3, 0.0, 0.0], [0.0, 0.4, 0.0], [0.0, 0.0, 0.5]] };
    let built_in = quad(vec![AnyEffect::LinearDrag(drag)]);
    assert!(close(acc(&sample(&written)).0, acc(&built_in).0));
    // In world axes without wind: the velocity over ground.
    let world = entry("d", "force_world_n = [\"-vx + wind_x\", \"-(vy - wind_y)\", \"wind_z - vz\"]");
    let plain = acc(&quad(vec![])).0;
    let found = acc(&sample(&world)).0;
    assert!(close([found[0] - plain[0], found[1] - plain[1], found[2] - plain[2]], [-0.5, 2.2, -1.6]));
}

#[test]
fn torques_turn_and_thrust_factors_scale_the_rotors() {
    let (plain_acc, plain_turn) = acc(&quad(vec![]));
    let torque = entry("t", "torque_body_n_m = [\"0.01 * wz\", \"0\", \"-1e-5 * rotor1\"]");
    let (same, turn) = acc(&sample(&torque));
    assert!(close(same, plain_acc));
    let change = [turn[0] - plain_turn[0], turn[1] - plain_turn[1], turn[2] - plain_turn[2]];
    assert!(close(change, [0.5, 0.0, -0.0048 / 0.018]), "{change:?}");
    let fading = entry("f", "thrust_factor = \"1 - 0.1 * t\"");
    let (found, _) = acc(&sample(&fading));
    let lifted = [plain_acc[0], plain_acc[1], plain_acc[2] + 9.81];
    assert!(close([found[0], found[1], found[2] + 9.81], lifted.map(|a| 0.93 * a)));
}

/// What every variable reads of this state, in the surroundings of [`every_variable_reads_what_its_name_says`].
fn expected(state: &State<f64>) -> Vec<(&'static str, f64)> {
    let body = quat::rotate_inverse(state.quat, [0.5, -2.2, 1.6]);
    let sum = 1970.0;
    let squares = [480.0f64, 500.0, 520.0, 470.0].iter().map(|v| v * v).sum::<f64>();
    vec![
        ("pi", core::f64::consts::PI),
        ("t", 0.7),
        ("x", 0.5),
        ("y", -1.0),
        ("z", 2.0),
        ("vx", 1.0),
        ("vy", -2.0),
        ("vz", 1.5),
        ("vx_body", body[0]),
        ("vy_body", body[1]),
        ("vz_body", body[2]),
        ("wx", 0.3),
        ("wy", -0.2),
        ("wz", 0.5),
        ("qx", state.quat[0]),
        ("qy", state.quat[1]),
        ("qz", state.quat[2]),
        ("qw", state.quat[3]),
        ("roll", 0.2),
        ("pitch", -0.3),
        ("yaw", 0.4),
        ("rotor1", 480.0),
        ("rotor2", 500.0),
        ("rotor3", 520.0),
        ("rotor4", 470.0),
        ("rotor5", 0.0),
        ("rotor6", 0.0),
        ("rotor7", 0.0),
        ("rotor8", 0.0),
        ("rotor_sum", sum),
        ("thrust_n", 1e-5 * squares),
        ("ground_m", 1.9),
        ("ceiling_m", 1.2),
        ("others_m", 1e6),
        ("wind_x", 0.5),
        ("wind_y", 0.2),
        ("wind_z", -0.1),
        ("air_density", 1.225),
        ("mass_kg", 1.0),
        ("gravity", 9.81),
        ("normal1", 1.5),
        ("normal2", -0.5),
        ("normal3", 0.25),
        ("command1", 0.1),
        ("command2", 0.2),
        ("command3", 0.3),
        ("command4", 0.4),
    ]
}

#[test]
fn every_variable_reads_what_its_name_says() {
    let state: State<f64> = tilted();
    let drone = quad(vec![]);
    let around = Surroundings {
        wind_m_s: [0.5, 0.2, -0.1],
        time_s: 0.7,
        ground_distance_m: 1.9,
        ceiling_distance_m: 1.2,
        command: &[0.1, 0.2, 0.3, 0.4],
        normals: [9.0, 9.0, 9.0, 1.5, -0.5, 0.25],
        ..Surroundings::calm()
    };
    let expected = expected(&state);
    let always = VARIABLES.iter().map(|v| v.name).filter(|name| known(name) == Known::Always);
    // What nobody commands is zero.
    let names: Vec<&str> =
        always.filter(|n| !n.starts_with("command") || n.len() == 8 && "1234".contains(&n[7..])).collect();
    let tried: Vec<&str> = expected.iter().map(|(name, _)| *name).collect();
    assert_eq!(names, tried, "every variable is tried");
    let page = include_str!("../../../../docs/effects/expression.md");
    for (name, value) in expected {
        let lines = format!("force_world_n = [\"{name}\", \"0\", \"0\"]");
        let effect = sample(&entry("one", &lines)).effects[0];
        let view = propwash_physics::effects::View {
            body: &drone.body,
            airframe: &drone.airframe,
            state: &state,
            surroundings: &around,
            collective_n: None,
            memory: &[],
        };
        let mut out = propwash_physics::rigid_body::Wrench::zero();
        effect.wrench(&view, &mut out);
        assert!((out.force[0] - value).abs() < 1e-12, "{name}: {} {value}", out.force[0]);
        let documented = page.contains(&format!("`{name}`")) || name.starts_with("rotor");
        assert!(documented, "{name} is not on the page");
    }
}

#[test]
fn an_expression_declares_what_its_variables_read() {
    let state: State<f64> = tilted();
    let near = Surroundings { ground_distance_m: 1.9, ceiling_distance_m: 1.2, ..Surroundings::calm() };
    let other = Neighbour { pos: [1.0, 0.0, 0.0], vel: [0.0; 3], weight_n: 1.0, disc_radius_m: 0.1 };
    for variable in VARIABLES.iter().filter(|v| known(v.name) == Known::Always) {
        let lines = format!("force_world_n = [\"1e-3 * {}\", \"0\", \"0\"]", variable.name);
        let drone = sample(&entry("one", &lines));
        let rate =
            |around: Surroundings<f64>| drone.rate(&state, &Command::Rotors([500.0; MAX_ROTORS]), &around);
        let changes = |around| rate(around) != rate(near);
        let found = Reads {
            ground: changes(Surroundings { ground_distance_m: 1.8, ..near }),
            ceiling: changes(Surroundings { ceiling_distance_m: 1.1, ..near }),
            neighbours: changes(Surroundings { neighbours: &[other], ..near }),
            wind: changes(Surroundings { wind_m_s: [0.5, 0.2, -0.1], ..near }),
            noise: changes(Surroundings { normals: [0.5, 0.2, -0.1, 0.3, 0.4, 0.5], ..near }),
        };
        assert_eq!(drone.reads(), found, "{}", variable.name);
    }
    let two = sample(&entry("two", "force_world_n = [\"ground_m\", \"wind_x\", \"0\"]"));
    assert_eq!(two.reads(), Reads::GROUND.or(Reads::WIND), "all variables count");
}

#[test]
fn derivatives_by_parameters_are_exact() {
    type D = Dual<f64, 1>;
    let text = entry(
        "e",
        "force_body_n = [\"-k * vx_body * abs(vx_body)\", \"sin(k * t) * tanh(vy)\", \"k^2 / (1 + exp(-z))\"]\n\
         torque_body_n_m = [\"sqrt(k) * wx\", \"max(k, 0.1) * wy\", \"min(k, 1) * wz\"]\n\
         thrust_factor = \"1 - k^3 * cos(roll)\"\n\
         parameter.k = { value = 0.4, unit = \"1\" }",
    );
    let drone = sample(&text);
    fn rate<S: Real>(drone: &Drone<f64>, k: S) -> Vec<S> {
        let mut drone = drone.map(&mut S::lit);
        drone.visit(&mut |name, v| {
            if name == "effect.expression.e.k" {
                *v = k;
            }
        });
        let around = Surroundings { time_s: S::lit(0.7), ..Surroundings::calm() };
        let rate = drone.rate(&tilted(), &Command::Rotors([S::lit(500.0); MAX_ROTORS]), &around);
        [rate.acc, rate.ang_acc].concat()
    }
    let exact = rate(&drone, D::input(0.4, 0));
    let (up, down) = (rate(&drone, 0.4 + 1e-6), rate(&drone, 0.4 - 1e-6));
    for (i, exact) in exact.iter().enumerate() {
        let difference = (up[i] - down[i]) / 2e-6;
        assert!((exact.partials[0] - difference).abs() < 1e-6 * (1.0 + difference.abs()), "{i}");
        assert!(exact.partials[0] != 0.0, "{i}");
    }
}

#[test]
fn a_file_with_expressions_reads_back_equal_and_keeps_its_sums() {
    let vehicle = with(TETHER).unwrap();
    let again = Vehicle::from_toml("again", vehicle.to_toml()).unwrap();
    assert_eq!(vehicle.file(), again.file());
    assert_eq!(vehicle.to_toml(), again.to_toml());
    let effects = |v: &Vehicle| v.drone("first_principles").unwrap().effects;
    assert_eq!(effects(&vehicle), effects(&again));
    let (AnyEffect::Expression(a), AnyEffect::Expression(b)) = (effects(&vehicle)[0], effects(&again)[0])
    else {
        panic!("an expression expected")
    };
    assert!(core::ptr::eq(a.formula, b.formula), "the same text gives the same formula");
    // Parameters in the order of their names.
    assert_eq!(a.value[..3], [1e-7, 0.3, 0.0]);
    let of = |key: &str| vehicle.provenance().into_iter().find(|p| p.key == key).unwrap();
    let k = of("effect.0.parameter.k.value");
    assert_eq!((k.unit, k.source.as_deref()), (Some("N·s/m"), Some("guess")));
    assert_eq!(k.sigma, Some(toml::Value::Float(0.01)));
    assert!(vehicle.provenance().iter().all(|p| !p.key.contains("force_body_n")));
    let mut file = vehicle.file().clone();
    assert!(set_parameter(&mut file.effect[0], "k", 0.25, Some(0.02)));
    assert!(!set_parameter(&mut file.effect[0], "q", 0.25, None));
    let fitted = Vehicle::from_file("fitted", file).unwrap();
    let AnyEffect::Expression(f) = effects(&fitted)[0] else { panic!("an expression expected") };
    assert_eq!((f.value[1], core::ptr::eq(f.formula, a.formula)), (0.25, true));
}

#[test]
fn several_expressions_have_their_own_names_and_are_candidates_like_any_other() {
    let second = entry(
        "fade",
        "thrust_factor = \"1 - s * t\"\nparameter.s = { value = 0, unit = \"1/s\", slab = 0.01 }",
    );
    let fixed = entry("fixed", "force_world_n = [\"0\", \"0\", \"0.1 / max(ground_m, 0.1)\"]");
    let mut drone = sample(&format!("{TETHER}\n{second}\n{fixed}"));
    let mut names = Vec::new();
    drone.visit(&mut |name, _| names.push(name.to_string()));
    names.retain(|n| n.starts_with("effect."));
    assert_eq!(
        names,
        ["effect.expression.tether.c", "effect.expression.tether.k", "effect.expression.fade.s"]
    );
    let own: Vec<_> = candidates(&drone).into_iter().filter(|c| c.kind == "expression").collect();
    assert_eq!(own.len(), 2, "an expression without a slab frees nothing");
    assert_eq!((own[0].id.as_str(), own[1].id.as_str()), ("tether", "fade"));
    assert_eq!(own[0].freedoms.len(), 1);
    let k = &own[0].freedoms[0];
    assert_eq!((k.name.as_str(), k.unit, k.spike, k.slab, k.sign), ("k", "N·s/m", 0.001, 0.2, Sign::Up));
    let again = format!("{TETHER}\n{TETHER}");
    let message = with(&again).unwrap_err().to_string();
    assert!(message.contains("effect.1.kind") && message.contains("expression.tether a second"), "{message}");
}

#[test]
fn an_expression_feels_the_abstracted_thrust() {
    let text = entry("w", "force_body_n = [\"thrust_n\", \"rotor_sum\", \"0\"]");
    let drone = with(&text).unwrap().drone("so_rpy").unwrap();
    assert!(matches!(drone.dynamics, Dynamics::AttitudeResponse(_)));
    let command = Command::Attitude([0.0, 0.0, 0.0, 0.3]);
    let rate = drone.rate(&State::rest(), &command, &Surroundings::calm());
    assert!(rate.acc[0] > 0.0 && rate.acc[1] > 0.0);
}

#[test]
fn entries_that_cannot_be_are_refused_with_their_key() {
    let f = "thrust_factor = \"1 - a\"";
    let a = |keys: &str| format!("{f}\nparameter.a = {{ {keys} }}");
    let many: String = (0..9).map(|i| format!("parameter.a{i} = {{ value = 0, unit = \"1\" }}\n")).collect();
    for (name, lines, key, expected) in [
        ("", f, "effect.0.name", "letters, digits"),
        ("a.b", f, "effect.0.name", "letters, digits"),
        ("gust", f, "effect.0.name", "no built-in effect"),
        ("n", "", "effect.0`", "at least one of force_body_n"),
        ("n", f, "effect.0.thrust_factor", "at column 5 of `1 - a`"),
        ("n", "force_body_n = [\"0\", \"0\"]", "effect.0.force_body_n", "three expressions"),
        ("n", "force_body_n = \"0\"", "effect.0.force_body_n", "three expressions"),
        ("n", "force_body_n = [\"0\", true, \"0\"]", "effect.0.force_body_n.1", "in quotes"),
        ("n", "force_n = [\"0\", \"0\", \"0\"]", "effect.0.force_n", "force_body_n"),
        ("n", &a("unit = \"1\""), "effect.0.parameter.a.value", "the value"),
        ("n", &a("value = 0"), "effect.0.parameter.a.unit", "the unit"),
        ("n", &a("value = \"0\", unit = \"1\""), "effect.0.parameter.a.value", "a number"),
        ("n", &a("value = 0, unit = \"1\", wide = 2"), "effect.0.parameter.a.wide", "spike"),
        ("n", &a("value = 0, unit = \"1\", sign = \"plus\""), "effect.0.parameter.a.sign", "any, up or down"),
        ("n", &a("value = 0, unit = \"1\", spike = 0.1"), "effect.0.parameter.a.slab", "more than the spike"),
        ("n", &a("value = 0, unit = \"1\", slab = -0.1"), "effect.0.parameter.a.slab", "not negative"),
        ("n", &a("value = 2, unit = \"1\", max = 1"), "effect.0.parameter.a.value", "a number to 1"),
        ("n", &a("value = 2, unit = \"1\", min = 3, max = 1"), "effect.0.parameter.a.min", "at most max"),
        ("n", &a("value = 2, unit = \"1\", sigma = { value = -1 }"), "sigma.value", "not negative"),
        ("n", &format!("{f}\nsigma = {{ a = 1 }}"), "effect.0.sigma.a", "a key of the same table"),
        ("n", &format!("{f}\n{many}"), "effect.0.parameter`", "at most 8"),
        (
            "n",
            &format!("{}\nparameter.b = {{ value = 0, unit = \"1\" }}", a("value = 0, unit = \"1\"")),
            "effect.0.parameter.b",
            "uses",
        ),
        (
            "n",
            "thrust_factor = \"vx\"\nparameter.vx = { value = 0, unit = \"1\" }",
            "effect.0.parameter.vx",
            "no variable",
        ),
        ("n", &format!("{f}\nparameter = 3"), "effect.0.parameter`", "tables"),
        ("n", &format!("{f}\nparameter.a = 3"), "effect.0.parameter.a`", "a table"),
    ] {
        let message = with(&entry(name, lines)).unwrap_err().to_string();
        assert!(message.contains(key) && message.contains(expected), "{lines}: {message}");
    }
    let nameless = "[[effect]]\nkind = \"expression\"\nthrust_factor = \"1\"\n";
    assert!(with(nameless).unwrap_err().to_string().contains("effect.0.name"));
    // Simulations hold drawn values to the same bounds.
    let bounded = sample(&entry("n", &a("value = 0, unit = \"1\", max = 1")));
    let mut effect = bounded.effects[0];
    effect.visit("", &mut |_, v| *v = 1.5);
    let fault = crate::effects::out_of_range(&mut effect).unwrap();
    assert_eq!((fault.parameter.as_str(), fault.expected.as_str(), fault.found), ("a", "a number to 1", 1.5));
}

#[test]
fn the_example_of_the_page_is_an_effect() {
    let page = include_str!("../../../../docs/effects/expression.md");
    let example = page.split("```toml\n").nth(1).and_then(|rest| rest.split("```").next()).unwrap();
    let effects = with(example).unwrap().drone("first_principles").unwrap().effects;
    assert_eq!(effects[0].label(), "expression.tether");
    assert_eq!(candidates(&quad(effects)).iter().filter(|c| c.id == "tether").count(), 1);
}

/// Memory of an effect after each of several steps of 10 ms, and the rotor command that it lets pass in the last.
fn remembered(drone: &Drone<f64>, steps: usize, sent: [f64; MAX_ROTORS]) -> (Vec<f64>, [f64; MAX_ROTORS]) {
    let mut memory = vec![0.0; drone.memory_len(0.01)];
    let mut command = Command::Rotors(sent);
    drone.start(&command, |effect| effect.memory_len(0.01), &mut memory);
    for k in 0..steps {
        command = Command::Rotors(sent);
        let time_s = 0.01 * k as f64;
        let mut around = Surroundings { time_s, normals: [0.5; 6], ..Surroundings::calm() };
        drone.transmit(&tilted(), &mut around, (0.01, 0.01), &mut command, &mut memory);
    }
    let Command::Rotors(speeds) = command else { panic!("rotors expected") };
    (memory, speeds)
}

#[test]
fn what_is_remembered_follows_its_expressions_all_from_the_step_before() {
    let lines = "force_world_n = [\"low\", \"0\", \"0\"]\n\
        memory.low = { start = 2.0, next = \"low + dt * (vx - low) / 0.2\" }\n\
        memory.swapped = { start = 5, next = \"other\" }\n\
        memory.other = { next = \"swapped + normal1\" }";
    let drone = sample(&entry("filter", lines));
    let (memory, _) = remembered(&drone, 3, [500.0; MAX_ROTORS]);
    let low = (0..3).fold(2.0, |low, _| low + 0.01 * (1.0 - low) / 0.2);
    // In the order of their names: low, other, swapped.
    assert!((memory[0] - low).abs() < 1e-15, "{memory:?}");
    assert_eq!(memory[1..], [6.0, 0.5]);
    assert!(drone.effects[0].nature().moved_by_memory && Effect::<f64>::reads(&drone.effects[0]).noise);
    // Forces see what it is now; without a memory what it was at the start.
    let pull = |numbers: &[f64]| {
        let mut around = Surroundings::calm();
        around.memory = propwash_physics::surroundings::Remembered { numbers, step_s: 0.01 };
        drone.rate(&tilted(), &Command::Rotors([500.0; MAX_ROTORS]), &around).acc[0]
    };
    let still = pull(&[0.0; 3]);
    assert!((pull(&memory) - still - low).abs() < 1e-12 && (pull(&[]) - still - 2.0).abs() < 1e-12);
}

#[test]
fn commands_pass_through_expressions_and_values_have_names() {
    let lines = "let = [\"lean = sqrt(roll^2 + pitch^2)\", \"share = where(lean > 0.3, 0.5, 1)\"]\n\
        rotor_command = [\"share * rotor_command1\", \"rotor_command2 + held\", \"rotor_command3\", \"min(rotor_command4, 300)\"]\n\
        memory.held = { start = 1, next = \"rotor_command1 / 100\" }";
    let drone = sample(&entry("governor", lines));
    assert!(!drone.controls_itself() && !drone.effects[0].nature().moved_by_memory);
    // Forces by commands are what logs do not show, too.
    let told = sample(&entry(
        "told",
        "let = [\"half = command1 / 2\"]\nforce_body_n = [\"0.01 * half\", \"0\", \"0\"]",
    ));
    assert!(told.effects[0].nature().moved_by_memory);
    let (memory, speeds) = remembered(&drone, 1, [500.0; MAX_ROTORS]);
    assert_eq!((&memory[..], &speeds[..5]), (&[5.0][..], &[250.0, 501.0, 500.0, 300.0, 500.0][..]));
    assert_eq!(remembered(&drone, 2, [500.0; MAX_ROTORS]).1[1], 505.0);
}

#[test]
fn a_controller_commands_in_place_of_the_one_on_board() {
    let lines = "models = [\"first_principles\"]\ncontrols = true\n\
        rotor_command = [\"command1 + held\", \"2\", \"3\", \"4\"]\nmemory.held = { next = \"held + 1\" }";
    let drone = sample(&entry("mine", lines));
    let told = [10.0, 20.0];
    let around = Surroundings { command: &told, ..Surroundings::calm() };
    let mut memory = [0.0];
    for k in 0..2 {
        let command = drone.own_command(&tilted(), &around, (0.01, 0.01), &mut memory);
        let Some(Command::Rotors(speeds)) = command else { panic!("rotors expected") };
        assert_eq!(speeds[..5], [10.0 + f64::from(k), 2.0, 3.0, 4.0, 0.0]);
    }
    // On the way to the motors it does nothing a second time.
    assert_eq!(remembered(&drone, 3, [500.0; MAX_ROTORS]), (vec![0.0], [500.0; MAX_ROTORS]));
    assert!(drone.controls_itself());
}

#[test]
fn entries_that_cannot_be_meant_are_refused_in_words() {
    let force = "force_body_n = [\"a\", \"0\", \"0\"]";
    for (lines, words) in [
        (
            format!("{force}\nlet = [\"a = b\", \"b = 1\"]"),
            "`effect.0.let.0`: expected a variable or a declared parameter",
        ),
        (format!("{force}\nlet = [\"a 1\"]"), "a text `name = expression`"),
        (format!("{force}\nlet = \"a = 1\""), "a list of texts `name = expression`"),
        (
            format!("{force}\nlet = [\"a = 1\", \"a = 2\"]"),
            "a name of letters, digits and underscores that nothing else has",
        ),
        (format!("{force}\nlet = [\"vx = 1\"]"), "that nothing else has, found `vx`"),
        (format!("{force}\nlet = [\"a = dt\"]"), "found `dt`, which is known once a step"),
        (format!("{force}\nmemory.a = 1"), "a finite number `start`"),
        (format!("{force}\nmemory.a = {{ begin = 1, next = \"1\" }}"), "a finite number `start`"),
        (
            format!("{force}\nmemory.a = {{ start = inf, next = \"1\" }}"),
            "expected a finite number, found inf",
        ),
        (
            format!("{force}\nmemory.a = {{ start = 1, next = \"a +\" }}"),
            "`effect.0.memory.a.next`: expected a number",
        ),
        (
            "rotor_command = [\"1\", \"2\", \"3\"]".into(),
            "4 expressions, one for each rotor, found 3 entries",
        ),
        (
            "attitude_command = [\"1\", \"2\", \"3\"]".into(),
            "four expressions, for roll, pitch, yaw and thrust",
        ),
        ("controls = true\nforce_body_n = [\"1\", \"0\", \"0\"]\nmodels = []".into(), "at least one of"),
        (
            "models = [\"first_principles\"]\ncontrols = true\nforce_body_n = [\"1\", \"0\", \"0\"]".into(),
            "rotor_command or attitude_command of a controller",
        ),
        ("controls = 1\nforce_body_n = [\"1\", \"0\", \"0\"]".into(), "true or false"),
        (
            "controls = true\nrotor_command = [\"1\", \"2\", \"3\", \"4\"]".into(),
            "write models = [\"first_principles\"]",
        ),
        ("memory.a = { next = \"a\" }".into(), "at least one of force_body_n"),
    ] {
        let error = with(&entry("e", &lines)).unwrap_err().to_string();
        assert!(error.contains(words), "{lines}\n{error}\nlacks {words}");
    }
    let many: Vec<String> = (0..33).map(|i| format!("memory.m{i} = {{ next = \"1\" }}")).collect();
    let error =
        with(&entry("e", &format!("thrust_factor = \"1\"\n{}", many.join("\n")))).unwrap_err().to_string();
    assert!(error.contains("at most 32 numbers"), "{error}");
    let many: Vec<String> = (0..257).map(|i| format!("\"v{i} = 1\"")).collect();
    let error = with(&entry("e", &format!("thrust_factor = \"1\"\nlet = [{}]", many.join(", "))))
        .unwrap_err()
        .to_string();
    assert!(error.contains("at most 256 values"), "{error}");
}
