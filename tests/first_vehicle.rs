//! A first vehicle file from mass, arm and one flight: it holds the truth in its intervals, and a drag that is hidden from it is found.
//! The flights are those of the independent simulator of `tests/common/planted`.

#[path = "common/planted/mod.rs"]
mod planted;

use planted::{Build, Excitation, Inputs, Plan, Sensors};
use propwash::flight::FlightLog;
use propwash::gap::diagnose::{Settings, diagnose};
use propwash::gap::first_flight::sharpen;
use propwash::gap::{Options, Track};
use propwash::physics::rotor;
use propwash::vehicle::first::{FirstVehicle, Given};
use propwash::vehicle::{BUILTIN, Vehicle};
use std::path::{Path, PathBuf};
use std::process::Command;

/// What is known of a vehicle: mass and arm.
fn given(truth: &Vehicle) -> Given {
    let drone = truth.drone("first_principles").unwrap();
    let [x, y, _] = drone.airframe.rotors[0].position_m;
    Given { rotors: drone.airframe.n_rotors, ..Given::new(drone.body.mass_kg, x.hypot(y)) }
}

/// A flight of a vehicle that is as its file says, with a hidden drag, logged with these inputs.
fn flight(truth: &Vehicle, inputs: Inputs, seed: u64, number: u64, file: &Path) -> FlightLog {
    let mut plan = Plan::exciting(truth, &["linear_drag"], 40.0, seed);
    plan.build = Build::usual(0.0);
    plan.sensors = Sensors::with(inputs);
    plan.flight = number;
    // The lively flight is too much for the weak motors of some.
    let flown =
        [Excitation::MultiSine, Excitation::Waypoints, Excitation::Lissajous].into_iter().find_map(|e| {
            plan.excitation = e;
            planted::fly(&plan).ok()
        });
    flown.expect("a flight that ends in the air").write(file).unwrap();
    FlightLog::load(file, None).unwrap()
}

/// Numbers whose truth lies within 1.96 standard deviations, and all.
fn inside(first: &FirstVehicle, truth: &Vehicle) -> [(bool, String); 8] {
    let drone = truth.drone("first_principles").unwrap();
    let (r, speed) = (&drone.airframe.rotors[0], drone.hover_rotor_vel()[0]);
    let thrust = rotor::curve(r.thrust_curve, speed);
    let inertia = drone.body.inertia_kg_m2;
    // How fast a rotor follows a command a little beyond the speed of a hover.
    let lag_s = |change: f64| change / rotor::acceleration(r, speed, speed + change);
    let truths = [
        ("inertia x", &first.inertia_kg_m2[0], inertia[0][0]),
        ("inertia y", &first.inertia_kg_m2[1], inertia[1][1]),
        ("inertia z", &first.inertia_kg_m2[2], inertia[2][2]),
        ("thrust", &first.thrust_n_s2_per_rad2, thrust / (speed * speed)),
        ("torque", &first.torque_per_thrust_m, rotor::curve(r.torque_curve, speed) / thrust),
        ("radius", &first.radius_m, r.radius_m),
        ("lag", &first.lag_s, 0.5 * (lag_s(1e-3 * speed) + lag_s(-1e-3 * speed))),
        ("rotor inertia", &first.rotor_inertia_kg_m2, r.inertia_kg_m2),
    ];
    truths.map(|(name, e, truth)| {
        let off = (e.value - truth) / e.sigma;
        (
            off.abs() <= 1.96,
            format!("{name} {:.3e} ± {:.1e}, truth {truth:.3e}: {off:+.1} sigmas", e.value, e.sigma),
        )
    })
}

#[test]
fn mass_arm_and_one_flight_make_a_file_that_holds_the_truth_and_finds_a_hidden_drag() {
    let folder = tempfile::tempdir().unwrap();
    let (mut held, mut all, mut found) = (0, 0, 0);
    for (k, name) in BUILTIN.iter().enumerate() {
        let truth = Vehicle::builtin(name).unwrap();
        let seed = 40 + k as u64;
        let mut first = FirstVehicle::new(&given(&truth)).unwrap();
        let log = flight(&truth, Inputs::Rotors, seed, 0, &folder.path().join(format!("{name}_rotors.csv")));
        for line in sharpen(&mut first, &[log]).unwrap() {
            println!("{name}: {line}");
        }
        for (fine, words) in inside(&first, &truth) {
            println!("{name}: {words}");
            held += usize::from(fine);
            all += 1;
        }
        // Thrust and inertia are sharpened, and no truth is left to the laws of scale where a flight tells more.
        assert!(!first.thrust_n_s2_per_rad2.is_law && !first.inertia_kg_m2[0].is_law, "{name}");
        if *name == "hb_x500" {
            // Its thrust goes with the square of the speed, as the first file takes it: nothing but noise is between.
            for (e, truth) in first.inertia_kg_m2.iter().zip([0.024, 0.024]) {
                assert!((e.value / truth - 1.0).abs() < 0.03, "{} of {truth} kg·m²", e.value);
            }
        }
        let vehicle = first.vehicle(name).unwrap();
        let log = flight(&truth, Inputs::Thrust, seed, 1, &folder.path().join(format!("{name}_thrust.csv")));
        let track = Track::new(log, &vehicle, &Options::default()).unwrap();
        let told = diagnose(&[track], &vehicle, &Settings::default()).unwrap();
        println!("{name}: {}", told.verdict.headline);
        found += usize::from(told.verdict.findings.iter().any(|f| f.id == "linear_drag"));
    }
    assert!(held * 10 >= all * 9, "{held} of {all} truths lie in their intervals");
    assert_eq!(found, BUILTIN.len(), "drags found");
}

#[test]
fn rotors_in_another_order_are_put_where_the_flight_says() {
    let truth = Vehicle::builtin("cf2x_L250").unwrap();
    let mut file = truth.file().clone();
    file.rotor.swap(0, 2);
    file.rotor.rotate_left(1);
    let other = Vehicle::from_file("other", file).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let log = flight(&other, Inputs::Rotors, 7, 0, &folder.path().join("flight.csv"));
    let mut first = FirstVehicle::new(&given(&truth)).unwrap();
    let said = sharpen(&mut first, &[log]).unwrap();
    assert!(said.iter().any(|s| s.contains("stand at places")), "{said:?}");
    for (rotor, true_rotor) in first.rotors.iter().zip(&other.file().rotor) {
        let place = true_rotor.position_m.unwrap();
        assert!((0..2).all(|k| (rotor.0[k] - place[k]).abs() < 1e-3), "{:?} {place:?}", first.rotors);
        assert_eq!(Some(rotor.1), true_rotor.spin);
    }
}

fn propwash(folder: &Path, args: &[&str]) -> (Option<i32>, String, String) {
    let out = Command::new(env!("CARGO_BIN_EXE_propwash")).args(args).current_dir(folder).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (out.status.code(), text(&out.stdout), text(&out.stderr))
}

#[test]
fn the_command_writes_the_file_says_where_numbers_come_from_and_what_to_measure() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let new = ["vehicle", "new", "--mass", "0.0328", "--arm", "0.046", "--out", "mine.toml"];
    let (code, out, err) = propwash(folder, &new);
    assert_eq!(code, Some(0), "{err}");
    for words in ["wrote mine.toml", "0.24 × mass × arm²", "measure next", "log rotor speeds", "two strings"]
    {
        assert!(out.contains(words), "{words}: {out}");
    }
    // The file flies.
    let truth = Vehicle::builtin("cf2x_L250").unwrap();
    flight(&truth, Inputs::Rotors, 3, 0, &folder.join("flight.csv"));
    let again = [&new[..6], &["--from-log", "flight.csv", "--out", "mine.toml"]].concat();
    let (code, _, err) = propwash(folder, &again);
    assert!(code == Some(2) && err.contains("--force"), "{err}");
    let (code, out, err) = propwash(folder, &[&again[..], &["--force", "--json"]].concat());
    assert_eq!(code, Some(0), "{err}");
    let told: serde_json::Value = serde_json::from_str(&out).unwrap();
    let thrust = told["vehicle"]["numbers"]
        .as_array()
        .unwrap()
        .iter()
        .find(|n| n["name"] == "thrust over squared speed")
        .unwrap();
    assert!(thrust["sigma"].as_f64().unwrap() < 0.05 * thrust["value"].as_f64().unwrap(), "{thrust}");
    assert!(thrust["source"].as_str().unwrap().contains("flight.csv"), "{thrust}");
    let (code, _, err) = propwash(folder, &["compare", "flight.csv", "--vehicle", "mine.toml"]);
    assert!(matches!(code, Some(0 | 1)), "{err}");
}

#[test]
fn wrong_input_is_a_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("broken.csv"), "t,px\n0,1,2\n").unwrap();
    std::fs::write(folder.join("notes.txt"), "hello").unwrap();
    flight(&Vehicle::builtin("hb_x500").unwrap(), Inputs::Rotors, 3, 0, &folder.join("a.csv"));
    let cases: [(&[&str], &str); 10] = [
        (&["--mass", "750", "--arm", "0.1"], "kg"),
        (&["--mass", "nan", "--arm", "0.1"], "mass"),
        (&["--mass", "0.75", "--arm", "113"], "arm"),
        (&["--mass", "0.75", "--arm", "0.113", "--rotors", "5"], "4, 6 or 8"),
        (&["--mass", "0.75", "--arm", "0.113", "--inertia", "1,2"], "three numbers"),
        (&["--mass", "0.75", "--arm", "0.113", "--inertia", "1,2,x"], "invalid"),
        (&["--mass", "0.75", "--arm", "0.113", "--from-log", "none.csv"], "none.csv"),
        (
            &["--mass", "0.75", "--arm", "0.113", "--from-log", "a.csv", "--from-log", "a.csv"],
            "each log once",
        ),
        (&["--mass", "0.75", "--arm", "0.113", "--from-log", "broken.csv"], "broken.csv"),
        (&["--mass", "0.75", "--arm", "0.113", "--from-log", "notes.txt"], "notes.txt"),
    ];
    for (args, words) in cases {
        let (code, _, err) = propwash(folder, &[&["vehicle", "new"], args, &["--out", "mine.toml"]].concat());
        assert_eq!(code, Some(2), "{args:?}: {err}");
        assert!(err.contains(words) && !err.contains("panicked"), "{args:?}: {err}");
        assert!(!folder.join("mine.toml").exists(), "{args:?}");
    }
    // A log of another number of rotors.
    let hexa = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/data/planted_hexa.toml");
    flight(&Vehicle::load(&hexa).unwrap(), Inputs::Rotors, 3, 0, &folder.join("hexa.csv"));
    let args =
        ["vehicle", "new", "--mass", "2.2", "--arm", "0.25", "--from-log", "hexa.csv", "--out", "mine.toml"];
    let (code, _, err) = propwash(folder, &args);
    assert!(code == Some(2) && err.contains("number of rotors"), "{err}");
}
