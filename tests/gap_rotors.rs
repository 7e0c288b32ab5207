//! Vehicle files whose rotors are not those of a log: in another order, turning the other way round, or another vehicle's.

#[path = "common/planted/mod.rs"]
mod planted;

use planted::{Build, Inputs, NoiseLevel, Plan, Sensors};
use propwash::flight::FlightLog;
use propwash::gap::compare::compare;
use propwash::gap::diagnose::{Settings, diagnose};
use propwash::gap::{Options, Track};
use propwash::vehicle::Vehicle;
use std::path::PathBuf;

fn text(name: &str) -> String {
    let path = format!("{}/tests/data/planted_{name}.toml", env!("CARGO_MANIFEST_DIR"));
    std::fs::read_to_string(path).unwrap()
}

/// The file with its rotors in the order `places`, spins times `sense`.
fn rewired(name: &str, places: &[usize], sense: f64) -> Vehicle {
    let file = text(name);
    let mut parts = file.split("[[rotor]]");
    let head = parts.next().unwrap();
    // The last rotor's table ends where the next table begins.
    let mut rotors: Vec<String> = parts.map(str::to_string).collect();
    let last = rotors.last_mut().unwrap();
    let end = last.find("\n[").unwrap();
    let rest = last.split_off(end);
    let turned = |rotor: &str| -> String {
        let spin = |line: &str| -> f64 { line.split('=').nth(1).unwrap().trim().parse().unwrap() };
        rotor
            .lines()
            .map(|l| match l.starts_with("spin") {
                true => format!("spin = {:?}", sense * spin(l)),
                false => l.to_string(),
            })
            .collect::<Vec<_>>()
            .join("\n")
    };
    let ordered: Vec<String> = places.iter().map(|p| format!("[[rotor]]{}\n", turned(&rotors[*p]))).collect();
    Vehicle::from_toml(name, &format!("{head}{}\n{rest}", ordered.concat())).unwrap()
}

/// A log of the vehicle as its file has it, but for tolerances.
fn log(name: &str, inputs: Inputs) -> (tempfile::TempDir, PathBuf) {
    let vehicle = Vehicle::from_toml(name, &text(name)).unwrap();
    let mut plan = Plan::exciting(&vehicle, &["rotor_drag"], 20.0, 8);
    plan.build = Build::fair(8);
    plan.noise = NoiseLevel::Rough;
    plan.sensors = Sensors::with(inputs);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("flight.csv");
    planted::fly(&plan).unwrap().write(&file).unwrap();
    (folder, file)
}

fn track(file: &std::path::Path, vehicle: &Vehicle) -> Track {
    Track::new(FlightLog::load(file, None).unwrap(), vehicle, &Options::default()).unwrap()
}

/// What a diagnosis says of a file, which is what a comparison says too.
fn said(file: &std::path::Path, vehicle: &Vehicle) -> Option<String> {
    let tracks = [track(file, vehicle)];
    let seen = compare(&tracks, vehicle).unwrap();
    let other = seen.logs[0].other_rotors.clone();
    let error = diagnose(&tracks, vehicle, &Settings::default()).map(|_| ()).err().map(|e| e.to_string());
    assert_eq!(other.is_some(), error.is_some(), "{other:?} {error:?}");
    if let Some(other) = &other {
        assert!(seen.verdict.starts_with(other) && seen.within_tolerance.is_none(), "{}", seen.verdict);
        // What is wrong stands alone before the first semicolon, where a page parts its headline.
        assert!(other.find("; ").is_some_and(|end| end <= 90), "{other}");
    }
    error
}

#[test]
fn rotors_in_another_order_or_sense_are_recognised() {
    let (_kept, file) = log("quad", Inputs::Commands);
    let as_filed = [0, 1, 2, 3];
    assert_eq!(said(&file, &rewired("quad", &as_filed, 1.0)), None);
    for (places, sense, words) in [
        (as_filed, -1.0, "rotors that all turn the other way round"),
        ([1, 0, 2, 3], 1.0, "rotors 1 2 3 4 that are the file's 2 1 3 4"),
        ([1, 2, 3, 0], 1.0, "rotors 1 2 3 4 that are the file's 4 1 2 3"),
        ([2, 0, 1, 3], -1.0, "rotors 1 2 3 4 that are the file's 2 3 1 4, all turning the other way round"),
    ] {
        let text = said(&file, &rewired("quad", &places, sense)).expect(words);
        assert!(text.contains(words) && text.contains("[[rotor]]"), "{text}");
    }
}

#[test]
fn orders_of_eight_rotors_are_recognised_by_measured_speeds() {
    let (_kept, file) = log("octo", Inputs::Rotors);
    assert_eq!(said(&file, &rewired("octo", &[0, 1, 2, 3, 4, 5, 6, 7], 1.0)), None);
    let text = said(&file, &rewired("octo", &[7, 6, 5, 4, 3, 2, 1, 0], 1.0)).expect("another order");
    assert!(text.contains("rotors 1 2 3 4 5 6 7 8 that are the file's"), "{text}");
}

/// What the file's own effects make of mass and thrust counts: a body filed far too heavy, with a `wrong_mass` that says so.
#[test]
fn effects_in_the_file_count_for_what_its_rotors_lift() {
    let heavier = text("quad").replace("mass_kg = 0.75", "mass_kg = 1.8");
    let corrected = format!("{heavier}\n[[effect]]\nkind = \"wrong_mass\"\nfactor = {}\n", 0.75 / 1.8);
    let (_kept, file) = log("quad", Inputs::Thrust);
    assert_eq!(said(&file, &Vehicle::from_toml("corrected", &corrected).unwrap()), None);
}

#[test]
fn a_file_of_another_vehicle_is_recognised_by_what_its_rotors_lift() {
    let quad = Vehicle::from_toml("quad", &text("quad")).unwrap();
    let heavier = text("quad").replace("mass_kg = 0.75", "mass_kg = 1.8");
    let heavier = Vehicle::from_toml("heavier", &heavier).unwrap();
    for inputs in [Inputs::Rotors, Inputs::Thrust] {
        let (_kept, file) = log("quad", inputs);
        assert_eq!(said(&file, &quad), None);
        let text = said(&file, &heavier).expect("another vehicle");
        assert!(text.contains("times what the flight needs") && text.contains("units"), "{text}");
    }
}
