//! Every example runs, and says what it promises. Cargo builds them together with the tests.

use std::path::{Path, PathBuf};
use std::process::Command;

/// Runs an example from the folder of the project and gives what it printed.
fn example(name: &str, args: &[&Path]) -> String {
    // target/PROFILE/deps/examples-HASH → target/PROFILE/examples/NAME
    let test = std::env::current_exe().unwrap();
    let profile: PathBuf = test.parent().and_then(Path::parent).unwrap().into();
    let program = profile.join("examples").join(format!("{name}{}", std::env::consts::EXE_SUFFIX));
    assert!(program.is_file(), "{} is missing: run `cargo build --examples` first", program.display());
    let out = Command::new(program).current_dir(env!("CARGO_MANIFEST_DIR")).args(args).output().unwrap();
    assert!(out.status.success(), "{name}: {}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).unwrap()
}

/// The number after `before` in `text`.
fn number(text: &str, before: &str) -> f64 {
    let rest = text.split(before).nth(1).unwrap_or_else(|| panic!("no {before:?} in {text}"));
    let digits = |c: char| !(c.is_ascii_digit() || c == '.' || c == '-');
    let rest = rest.trim_start();
    rest.split(digits)
        .next()
        .unwrap()
        .parse()
        .unwrap_or_else(|_| panic!("no number after {before:?}: {text}"))
}

#[test]
fn there_is_a_test_for_every_example() {
    let mut names: Vec<String> = std::fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("examples"))
        .unwrap()
        .map(|e| e.unwrap().file_name().to_string_lossy().into_owned())
        // Those in Python have their tests in python/tests.
        .filter(|name| name.ends_with(".rs"))
        .collect();
    names.sort();
    let tested = [
        "custom_stage.rs",
        "fly_and_see.rs",
        "hidden_flight.rs",
        "own_backend.rs",
        "own_effect.rs",
        "own_sensor.rs",
        "own_task.rs",
        "randomize.rs",
        "read_dataset.rs",
    ];
    assert_eq!(names, tested);
}

#[test]
fn own_sensor() {
    let said = example("own_sensor", &[]);
    let (fall, truth) = (number(&said, "falls by"), number(&said, "atmosphere"));
    assert!((truth - 60.0).abs() < 2.0 && (fall - truth).abs() < 2.0, "{said}");
}

#[test]
fn own_backend() {
    let said = example("own_backend", &[]);
    let off = |digits: u32| number(&said, &format!("with {digits} binary digits the climb is"));
    assert!(off(52) < 1e-3 && off(23) < 0.1, "{said}");
    assert!(off(23) < off(16) && off(16) < off(10) && off(10) > 10.0, "{said}");
}

#[test]
fn own_vehicle() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("data");
    let flown = Command::new(env!("CARGO_BIN_EXE_propwash"))
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .args("fly --scene room --drone examples/own_vehicle/hexa.toml --trajectory circle --seconds 3 --size 32x24 --out".split(' '))
        .arg(&out)
        .output()
        .unwrap();
    assert!(flown.status.success(), "{}", String::from_utf8_lossy(&flown.stderr));
    let data = propwash::dataset::Dataset::open(&out).unwrap();
    assert_eq!(data.manifest().vehicles[0].n_rotors, 6);
    let world = data.world(0).unwrap();
    assert!(world.record().quarantine.is_none());
    // It follows the circle at its height, by its own controller.
    let states = world.states(Some(&["pz", "ref_z"])).unwrap();
    let off =
        states.column("pz").unwrap().iter().zip(states.column("ref_z").unwrap()).map(|(a, b)| (a - b).abs());
    assert!(off.fold(0.0, f64::max) < 0.1);
    // Others see and touch its own shell.
    assert!(data.manifest().geoms.iter().any(|g| g.name == "drone0/rotor_front_right"));
}

#[test]
fn own_effect() {
    let said = example("own_effect", &[]);
    assert!(number(&said, "the climb by up to") > 1.0, "{said}");
    assert!(number(&said, "lanes in f32 agree to") < 1.0, "{said}");
    assert!(said.contains("settling_s") && said.contains("a number above 0"), "{said}");
}

#[test]
fn fly_and_see() {
    let said = example("fly_and_see", &[]);
    assert!(number(&said, "depth image:") > 500.0, "{said}");
    // It follows a circle of 0.8 m radius at 1 m height.
    let at: Vec<f64> = said
        .split("position [")
        .nth(1)
        .and_then(|rest| rest.split(']').next())
        .unwrap()
        .split(", ")
        .map(|v| v.parse().unwrap())
        .collect();
    assert!((at[0].hypot(at[1]) - 0.8).abs() < 0.2 && (at[2] - 1.0).abs() < 0.1, "{said}");
    assert!(said.contains("nearest obstacle: geom") && said.contains("contacts: 0"), "{said}");
}

#[test]
fn custom_stage() {
    let said = example("custom_stage", &[]);
    assert!(said.contains("controllers, gust, integration"), "{said}");
    let aside: Vec<f64> =
        said.lines().filter(|l| l.starts_with("world")).map(|l| number(l, "blown")).collect();
    assert_eq!(aside.len(), 4, "{said}");
    assert!(aside.windows(2).all(|w| w[0] > w[1]), "the heavier, the less: {said}");
    assert!(aside.iter().all(|cm| (1.0..200.0).contains(cm)), "{said}");
}

#[test]
fn own_task() {
    let said = example("own_task", &[]);
    let [holds, gives] = ["holds its place: hit in", "gives way: hit in"].map(|policy| number(&said, policy));
    assert!(holds > 90.0 && gives < 10.0, "{said}");
}

#[test]
fn hidden_flight() {
    let dir = tempfile::tempdir().unwrap();
    let (log, truth) = (dir.path().join("flight.csv"), dir.path().join("truth.json"));
    let words = |text: &'static str| text.split(' ').map(Path::new);
    let mut args: Vec<&Path> = words("--effect rotor_drag,payload --seed 3 --seconds 2 --out").collect();
    args.push(&log);
    args.push(Path::new("--truth"));
    args.push(&truth);
    let said = example("hidden_flight", &args);
    assert!(said.contains("rows, 2 s") && said.contains("what was hidden"), "{said}");
    let truth: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(truth).unwrap()).unwrap();
    assert_eq!(truth["hidden"][0]["id"], "rotor_drag");
    assert!(truth["hidden"][1]["parameters"]["mass_kg"].as_f64().unwrap() > 0.03, "{truth}");
    let (log, _) = propwash::flight::FlightLog::open(&log, None).unwrap();
    assert!((log.duration_s - 2.0).abs() < 0.02 && log.cmd_rotor_rad_s.len() == 4);
}

#[test]
fn randomize() {
    let said = example("randomize", &[]);
    assert!(said.contains("bit for bit: true") && said.contains("the same world 5: true"), "{said}");
    let mut masses: Vec<&str> = said.lines().filter(|l| l.contains(" g, after")).collect();
    masses.dedup();
    assert_eq!(masses.len(), 8, "{said}");
}

#[test]
fn read_dataset() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("data");
    let flown = Command::new(env!("CARGO_BIN_EXE_propwash"))
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .args(
            "fly --scene xml/room.xml --drone cf2x_L250 --worlds 2 --seconds 0.5 --size 16x12 --out"
                .split(' '),
        )
        .arg(&out)
        .status()
        .unwrap();
    assert!(flown.success());
    let said = example("read_dataset", &[&out]);
    assert!(said.starts_with("2 worlds of 1 drones for 0.5 s"), "{said}");
    for part in said.split("\nworld ").skip(1) {
        let exact = part.split(" at ").nth(2).and_then(|r| r.split(' ').next()).unwrap();
        let rounded = number(part, "which is");
        assert!((exact.parse::<f64>().unwrap() - rounded).abs() < 0.000_6, "{part}");
    }
    assert_eq!(said.matches("contacts").count(), 2, "{said}");
}

#[test]
fn read_dataset_makes_its_own_when_there_is_none() {
    let said = example("read_dataset", &[]);
    let folder = said.lines().find_map(|l| l.split("images in ").nth(1)).unwrap().trim();
    assert!(Path::new(folder).join("complete.json").is_file(), "{said}");
    assert!(said.contains("2 worlds of 1 drones for 1 s"), "{said}");
    std::fs::remove_dir_all(folder).unwrap();
}
