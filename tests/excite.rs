//! `propwash excite` as a user meets it: a plan that `propwash fly` flies, and sentences for what cannot be planned.

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

const QUAD: &str = "tests/data/planted_quad.toml";

fn propwash(words: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_propwash"))
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .args(words)
        .output()
        .unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

fn excite(more: &[&str]) -> Output {
    propwash(&[&["excite", "--vehicle", QUAD], more].concat())
}

/// A request that must fail: exit code 2, one line that holds all `needles`.
fn refused(more: &[&str], needles: &[&str]) {
    let out = excite(more);
    let message = text(&out.stderr);
    assert_eq!(out.status.code(), Some(2), "{more:?}: {message}");
    assert_eq!(message.trim_end().lines().count(), 1, "{message}");
    for needle in needles {
        assert!(message.contains(needle), "no {needle:?} in: {message}");
    }
}

#[test]
fn a_plan_for_drag_is_reached_and_flies() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("path.csv");
    let shown = path.to_str().unwrap();
    let out = excite(&["--want", "linear_drag", "--out", shown, "--json"]);
    assert_eq!(out.status.code(), Some(0), "{}", text(&out.stderr));
    let plan: Value = serde_json::from_slice(&out.stdout).unwrap();
    let seconds = plan["duration_s"].as_f64().unwrap();
    assert!(seconds > 5.0 && seconds <= 60.0, "{seconds}");
    let parameters = plan["parameters"].as_array().unwrap();
    assert_eq!(parameters.len(), 3);
    for p in parameters {
        assert_eq!(p["reached"], true);
        let after: Vec<f64> =
            p["after"].as_array().unwrap().iter().map(|s| s["with_look_alike"].as_f64().unwrap()).collect();
        // Information only grows.
        assert!(after.windows(2).all(|w| w[1] <= w[0] * (1.0 + 1e-9)), "{after:?}");
        assert!(after[after.len() - 1] <= 1.001 * p["target"].as_f64().unwrap());
    }
    assert!(plan["peak_error_m"].as_f64().unwrap() < 0.6);

    let table = text(&excite(&["--want", "linear_drag"]).stdout);
    for needle in ["before", "whole flight", "linear_drag.drag_n_s_per_m.2.2", "reached"] {
        assert!(table.contains(needle), "no {needle:?} in\n{table}");
    }

    // An empty scene.
    let scene = dir.path().join("empty.xml");
    std::fs::write(&scene, "<mujoco><worldbody/></mujoco>").unwrap();
    let folder = dir.path().join("flight");
    let long = format!("{seconds:.0}");
    let out = propwash(&[
        "fly",
        "--scene",
        scene.to_str().unwrap(),
        "--drone",
        QUAD,
        "--trajectory",
        "waypoints",
        shown,
        "--seconds",
        &long,
        "--fps",
        "1",
        "--size",
        "8x8",
        "--out",
        folder.to_str().unwrap(),
        "--json",
    ]);
    assert_eq!(out.status.code(), Some(0), "{}", text(&out.stderr));
    let report: Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!(report["quarantined_worlds"], 0);
    assert_eq!(report["contact_rows"], 0);
    assert!(report["state_rows"].as_f64().unwrap() >= 100.0 * (seconds - 1.0));
}

#[test]
fn what_cannot_be_planned_gets_its_sentence() {
    refused(&["--want", "nope"], &["`nope` is no candidate", "linear_drag"]);
    refused(&["--want", "downwash"], &["needs another tracked vehicle"]);
    refused(&["--want", "ground_effect", "--scene-free"], &["needs the height of the ground"]);
    refused(&["--want", "linear_drag", "--box", "6,6"], &["--box", "length, width and height", "6,6"]);
    refused(&["--want", "linear_drag", "--box", "0.2,6,3"], &["a box of 1 m to 1000 m", "0.2"]);
    refused(&["--want", "linear_drag", "--seconds", "1"], &["4 s to 1800 s", "1 s"]);
    refused(&["--want", "linear_drag", "--share", "2"], &["a share of the slab between 0 and 1"]);
    refused(&["--want", "linear_drag", "--ceiling-z", "9"], &["a ceiling in the box", "9 m"]);
    refused(&["--want", "linear_drag", "--gyro-noise", "-1"], &["--gyro-noise"]);
    refused(&["--want", "linear_drag", "--pose-hz", "5"], &["poses at 20 Hz or more"]);
    refused(&["--want", "linear_drag", "--from", "linear_drag"], &["both lists are the same"]);
    let out = propwash(&["excite", "--vehicle", "no_such_vehicle", "--want", "linear_drag"]);
    assert_eq!(out.status.code(), Some(2));
    assert!(!Path::new("path.csv").exists());
}

#[test]
fn a_parameter_that_cannot_be_reached_says_why_and_ends_with_1() {
    let out = excite(&["--want", "payload", "--seconds", "20"]);
    let said = text(&out.stdout);
    assert_eq!(out.status.code(), Some(1), "{said}{}", text(&out.stderr));
    assert!(said.contains("payload.mass_kg") && said.contains("not reached"), "{said}");
    assert!(said.contains("looks like it in every manoeuvre"), "{said}");
}

#[test]
fn the_manoeuvres_that_tell_two_effects_apart_are_named() {
    let out = excite(&["--want", "com_offset", "--from", "weak_rotor.1", "--json"]);
    assert_eq!(out.status.code(), Some(0), "{}", text(&out.stderr));
    let said: Value = serde_json::from_slice(&out.stdout).unwrap();
    let advice = said["advice"].as_array().unwrap();
    assert!((1..=3).contains(&advice.len()));
    assert!(advice[0]["text"].as_str().unwrap().contains("tells com_offset from weak_rotor.1"));
}

/// What a diagnosis advises can be flown: the manoeuvres stand in the file one after the other.
#[test]
fn named_manoeuvres_are_written_in_turn() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("next.csv");
    let shown = path.to_str().unwrap();
    let length = |names: &str| -> f64 {
        let out = excite(&["--fly", names, "--force", "--out", shown, "--json"]);
        assert_eq!(out.status.code(), Some(0), "{}", text(&out.stderr));
        let told: Value = serde_json::from_slice(&out.stdout).unwrap();
        let last = std::fs::read_to_string(&path).unwrap().lines().last().unwrap().to_string();
        let end: f64 = last.split(',').next().unwrap().parse().unwrap();
        assert!((end - told["duration_s"].as_f64().unwrap()).abs() < 1e-3);
        end
    };
    let (low, spin) = (length("low passes"), length("yaw spin"));
    assert!((length("low passes, yaw spin") - low - spin).abs() < 1e-2);
    length("yaw spin,low passes");
    let rows = std::fs::read_to_string(&path).unwrap();
    let heights: Vec<f64> =
        rows.lines().skip(1).map(|l| l.split(',').nth(3).unwrap().parse().unwrap()).collect();
    let lowest = heights.iter().position(|z| *z < 0.5).unwrap();
    assert!(lowest > heights.len() / 3, "the low passes come second");

    refused(&["--fly", "barrel roll", "--force", "--out", shown], &["manoeuvre", "barrel roll", "yaw spin"]);
    refused(&["--fly", "under the ceiling", "--force", "--out", shown], &["under the ceiling", "ceiling"]);
}
