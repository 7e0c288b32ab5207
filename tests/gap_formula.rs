//! Effects that are in no list: a formula is found, named with its numbers, written and flown; and none is made up.

#[path = "common/planted/mod.rs"]
mod planted;

use planted::{NoiseLevel, Plan, fly};
use propwash::Result;
use propwash::flight::FlightLog;
use propwash::gap::diagnose::Settings;
use propwash::gap::fitted::{Calibrate, Filed, Fitted, fit};
use propwash::gap::ladder::Flights;
use propwash::gap::verdict::Lack;
use propwash::gap::{Options, Track};
use propwash::vehicle::Vehicle;
use std::path::Path;
use std::process::Command;

const QUAD: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/planted_quad.toml");

/// Share of a log that is kept from the fit, as the command line keeps it.
const HOLD_OUT: f64 = 0.2;

/// A flight with hidden effects, written as a log.
fn flown(vehicle: &Vehicle, hidden: &[&'static str], seed: u64, path: &Path) -> planted::Truth {
    written(&Plan::exciting(vehicle, hidden, 30.0, seed), path)
}

fn written(plan: &Plan, path: &Path) -> planted::Truth {
    let flight = fly(plan).unwrap();
    flight.write(path).unwrap();
    flight.truth
}

fn fitted(vehicle: &Vehicle, log: &Path) -> Result<Fitted> {
    let track = Track::new(FlightLog::load(log, None)?, vehicle, &Options::default())?;
    let flights = Flights::new(vec![track], Vec::new(), HOLD_OUT);
    let text = std::fs::read_to_string(QUAD).unwrap();
    Ok(fit(Filed { label: QUAD, vehicle, text }, &flights, &Settings::default(), "a test", Calibrate::No)?)
}

#[test]
fn dry_friction_is_found_with_its_size_and_flies() {
    let vehicle = Vehicle::load(QUAD).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("flight.csv");
    let truth = flown(&vehicle, &["dry_friction"], 2, &log);
    let true_of = |name: &str| truth.hidden[0].parameters[name];

    let fitted = fitted(&vehicle, &log).unwrap();
    let verdict = &fitted.diagnosed.verdict;
    let [formula] = verdict.formulas.as_slice() else { panic!("{}", verdict.verdict) };
    assert_eq!(formula.words, "force along body x and y = c · tanh(v / {s})");
    let finding = verdict.findings.iter().find(|f| f.id == formula.id).unwrap();
    let of = |name: &str| finding.parameters.iter().find(|p| p.name == name).unwrap();
    let (c, s) = (of("c"), of("s"));
    assert!((c.value + true_of("strength")).abs() < 4.0 * c.sigma, "{c:?} {}", true_of("strength"));
    assert!((s.value - true_of("scale")).abs() < 0.1 * true_of("scale"), "{s:?} {}", true_of("scale"));
    assert!(verdict.verdict.contains("force along body x and y = −"), "{}", verdict.verdict);
    assert!(verdict.verdict.contains("no physical name; like dry friction"), "{}", verdict.verdict);
    assert!(verdict.headline.contains("tanh(v / "), "{}", verdict.headline);
    assert_eq!(verdict.vehicle_sha256, vehicle.sha256(), "it is a verdict on the file as it is");

    // Written, it is an effect like any other.
    let after = Vehicle::from_toml("after", &fitted.text).unwrap();
    let drone = after.drone("first_principles").unwrap();
    assert!(drone.effects.iter().any(|e| e.label() == format!("expression.{}", formula.id)));
    assert!(fitted.text.contains("tanh((vx_body) / s)"), "{}", fitted.text);
}

#[test]
fn an_effect_that_only_leans_does_not_bend_the_search_for_a_lift_that_saturates() {
    let vehicle = Vehicle::load(QUAD).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("flight.csv");
    let truth = flown(&vehicle, &["saturating_lift"], 0, &log);
    let verdict = fitted(&vehicle, &log).unwrap().diagnosed.verdict;
    let [formula] = verdict.formulas.as_slice() else { panic!("{}", verdict.verdict) };
    // Beside the effect that leans on it, |v| comes out in place of |v_xy|.
    let words = "force along body z = c · (1 − exp(−(|v_xy| / {s})²))";
    assert_eq!(formula.words, words, "{}", verdict.verdict);
    let finding = verdict.findings.iter().find(|f| f.id == formula.id).unwrap();
    let c = finding.parameters.iter().find(|p| p.name == "c").unwrap();
    let strength = truth.hidden[0].parameters["strength"];
    assert!((c.value - strength).abs() < 0.15 * strength, "{c:?} {strength}");
}

/// Beside tolerances ten times as large: what it takes off is judged beside their calibration.
#[test]
fn a_torque_about_some_direction_is_one_formula_with_two_coefficients() {
    let vehicle = Vehicle::load(QUAD).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("swing.csv");
    let truth = written(&Plan::exciting(&vehicle, &["swing_torque"], 50.0, 10), &log);
    let fitted = fitted(&vehicle, &log).unwrap();
    let verdict = &fitted.diagnosed.verdict;
    let [formula] = &verdict.formulas[..] else { panic!("{}", verdict.verdict) };
    assert_eq!(formula.words, "torque about body x and y = (c, d) · v_x ω_z", "{}", verdict.verdict);
    let finding = verdict.findings.iter().find(|f| f.id == formula.id).unwrap();
    for (name, axis) in [("c", 0), ("d", 1)] {
        let p = finding.parameters.iter().find(|p| p.name == name).unwrap();
        let known = truth.hidden[0].parameters[&format!("torque_n_m_s2_per_m_rad.{axis}")];
        assert!((p.value - known).abs() < 3.0 * p.sigma && p.sigma < 0.15 * known.abs(), "{p:?} {known}");
    }
    assert!(verdict.verdict.contains("N·s²) · v_x ω_z"), "{}", verdict.verdict);
    // Written and flown.
    let after = Vehicle::from_toml("after", &fitted.text).unwrap();
    assert!(
        after.drone("first_principles").unwrap().effects.iter().any(|e| e.label() == "expression.found_1")
    );
}

/// All rotors' thrust goes with the roll, by which the vehicle steers, too: a force along z alone makes positions worse.
#[test]
fn a_thrust_that_changes_in_flight_is_no_force_beside_it() {
    let vehicle = Vehicle::load(QUAD).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("roll.csv");
    written(&Plan::exciting(&vehicle, &["roll_dependent_thrust"], 50.0, 13), &log);
    let fitted = fitted(&vehicle, &log).unwrap();
    let verdict = &fitted.diagnosed.verdict;
    let [formula] = &verdict.formulas[..] else { panic!("{}", verdict.verdict) };
    assert_eq!(formula.words, "relative change of the thrust = c · sin(roll)", "{}", verdict.verdict);
    assert!(fitted.text.contains("thrust_factor = \"1 + c * (sin(roll))\""), "{}", fitted.text);
    assert!(verdict.headline.contains("relative change of the thrust ∝ sin(roll)"), "{}", verdict.headline);
    // It goes with the sine of twice the roll, which that of the roll comes near to.
    let [before, after] = [0, 1].map(|rung| verdict.ladder[rung].held_out_lack.unwrap());
    let torque = |lack: &Lack| lack.torque_n_m.unwrap();
    assert!(after.force_n < 0.25 * before.force_n, "{before:?} {after:?}");
    assert!(torque(&after) < 0.7 * torque(&before), "{before:?} {after:?}");
}

#[test]
fn a_drag_from_a_threshold_on_is_not_taken_for_one_with_the_square_of_the_speed() {
    let vehicle = Vehicle::load(QUAD).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("flight.csv");
    let plan = Plan { noise: NoiseLevel::Rough, ..Plan::exciting(&vehicle, &["threshold_drag"], 50.0, 10) };
    let truth = written(&plan, &log);
    let verdict = fitted(&vehicle, &log).unwrap().diagnosed.verdict;
    let [formula] = verdict.formulas.as_slice() else { panic!("{}", verdict.verdict) };
    assert_eq!(formula.words, "force along body x, y and z = c · v beyond |v| = {s}", "{}", verdict.verdict);
    let finding = verdict.findings.iter().find(|f| f.id == formula.id).unwrap();
    for (name, known, within) in
        [("c", -truth.hidden[0].parameters["strength"], 0.1), ("s", truth.hidden[0].parameters["scale"], 0.1)]
    {
        let p = finding.parameters.iter().find(|p| p.name == name).unwrap();
        assert!((p.value - known).abs() < within * known.abs(), "{p:?} {known}");
    }
    assert!(verdict.findings.iter().all(|f| f.id == formula.id), "{}", verdict.verdict);
}

#[test]
fn a_drag_in_one_direction_is_no_change_in_mid_flight() {
    ahead_only(11);
}

/// Unequal rotors and a centre of mass beside the middle, which make up for each other, help the vehicle with the formula together only;
/// without the formula either helps.
#[test]
fn a_drag_in_one_direction_is_judged_beside_all_the_calibration_that_helps_it() {
    ahead_only(12);
}

fn ahead_only(seed: u64) {
    let vehicle = Vehicle::load(QUAD).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("flight.csv");
    let truth = written(&Plan::exciting(&vehicle, &["forward_drag"], 50.0, seed), &log);
    let verdict = fitted(&vehicle, &log).unwrap().diagnosed.verdict;
    let [formula] = verdict.formulas.as_slice() else { panic!("{}", verdict.verdict) };
    assert_eq!(formula.words, "force along body x = c · v_x ahead only", "{}", verdict.verdict);
    let finding = verdict.findings.iter().find(|f| f.id == formula.id).unwrap();
    let c = finding.parameters.iter().find(|p| p.name == "c").unwrap();
    let strength = truth.hidden[0].parameters["strength"];
    assert!((c.value + strength).abs() < 0.1 * strength, "{c:?} {strength}");
    assert!(verdict.moments.is_empty() && verdict.sections.is_empty(), "{}", verdict.verdict);
}

#[test]
fn where_nothing_is_hidden_no_formula_is_made_up() {
    let vehicle = Vehicle::load(QUAD).unwrap();
    let folder = tempfile::tempdir().unwrap();
    for seed in [4, 6] {
        let log = folder.path().join(format!("{seed}.csv"));
        flown(&vehicle, &[], seed, &log);
        let verdict = fitted(&vehicle, &log).unwrap().diagnosed.verdict;
        assert!(verdict.formulas.is_empty() && verdict.findings.is_empty(), "{}", verdict.verdict);
    }
}

#[test]
fn a_saved_formula_is_added_and_a_spoilt_one_is_refused_in_words() {
    let vehicle = Vehicle::load(QUAD).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    flown(&vehicle, &["nose_up"], 2, &path("flight.csv"));
    let propwash = |args: &[&str]| {
        let out = Command::new(env!("CARGO_BIN_EXE_propwash"))
            .args(args)
            .current_dir(folder.path())
            .output()
            .unwrap();
        (
            out.status.code(),
            String::from_utf8_lossy(&out.stdout).into_owned() + &String::from_utf8_lossy(&out.stderr),
        )
    };
    let (code, said) = propwash(&["diagnose", "flight.csv", "--vehicle", QUAD, "--out", "d.json"]);
    assert_eq!(code, Some(1), "{said}");
    assert!(said.contains("torque about body y = "), "{said}");
    let add = |diagnosis: &str, out: &str| {
        propwash(&["add", "--from-diagnosis", diagnosis, "--vehicle", QUAD, "--out", out])
    };
    let (code, said) = add("d.json", "better.toml");
    assert_eq!(code, Some(0), "{said}");
    let written = std::fs::read_to_string(path("better.toml")).unwrap();
    assert!(written.contains("name = \"found_1\"") && written.contains("torque_body_n_m"), "{written}");
    assert!(Vehicle::load(path("better.toml").to_str().unwrap()).is_ok());

    let text = std::fs::read_to_string(path("d.json")).unwrap();
    std::fs::write(
        path("spoilt.json"),
        text.replace("kind = \\\"expression\\\"", "kind = \\\"expresion\\\""),
    )
    .unwrap();
    let (code, said) = add("spoilt.json", "none.toml");
    assert_eq!(code, Some(2), "{said}");
    assert!(said.contains("spoilt.json") && said.contains("expresion"), "{said}");
    assert!(!path("none.toml").exists());
}
