//! `propwash bench` as a user meets it: which rows there are, what the file holds, errors in one line. No speeds.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

/// The program, run from the folder of the project.
fn bench(words: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_propwash"))
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .arg("bench")
        .args(words)
        .output()
        .unwrap()
}

/// The least that can be measured.
const SMALL: &[&str] =
    &["--seconds", "0.001", "--worlds", "1", "--sensing-worlds", "1", "--size", "4x4", "--threads", "1"];

/// Rows of a run of some milliseconds a row, and what it printed.
fn figures(words: &[&str]) -> (Value, String) {
    let dir = tempfile::tempdir().unwrap();
    let json = dir.path().join("speed.json");
    let mut all =
        vec!["--seconds", "0.001", "--worlds", "1,17", "--sensing-worlds", "3", "--size", "16x8", "--out"];
    let shown = json.to_string_lossy().into_owned();
    all.push(&shown);
    all.extend(words);
    let out = bench(&all);
    assert_eq!(out.status.code(), Some(0), "{words:?}: {}", String::from_utf8_lossy(&out.stderr));
    let text = std::fs::read_to_string(json).unwrap();
    (serde_json::from_str(&text).unwrap(), String::from_utf8(out.stdout).unwrap())
}

fn refused(words: &[&str], needles: &[&str]) {
    let out = bench(words);
    let message = String::from_utf8(out.stderr).unwrap();
    assert_eq!(out.status.code(), Some(2), "{words:?}: {message}");
    assert!(message.starts_with("error: ") && message.trim_end().lines().count() == 1, "{message}");
    for needle in needles {
        assert!(message.contains(needle), "no {needle:?} in {message}");
    }
}

#[test]
fn every_row_is_there_for_one_thread_and_for_several() {
    let (told, text) = figures(&["--threads", "2"]);
    let rows = told["rows"].as_array().unwrap();
    let of = |what: &str, threads: u64| {
        rows.iter().filter(|r| r["what"] == what && r["threads"] == threads).collect::<Vec<_>>()
    };
    for threads in [1, 2] {
        let worlds: Vec<u64> = of("steps", threads).iter().map(|r| r["worlds"].as_u64().unwrap()).collect();
        assert_eq!(worlds, [1, 17]);
        for (what, units) in [
            ("depth", &["frames/s", "pixels/s"][..]),
            ("contacts", &["drones/s"]),
            ("clearances", &["drones/s"]),
            ("loop", &["frames/s"]),
        ] {
            let found: Vec<&str> = of(what, threads).iter().map(|r| r["unit"].as_str().unwrap()).collect();
            assert_eq!(found, units, "{what}");
            assert!(of(what, threads).iter().all(|r| r["worlds"] == 3));
            assert!(text.contains(what));
        }
    }
    for row in rows {
        let [low, median, high] = ["low", "median", "high"].map(|k| row[k].as_f64().unwrap());
        assert!(0.0 < low && low <= median && median <= high, "{row}");
    }
    // Pixels are frames times their size; 500 steps, and 20 frames, are a second of flight.
    let depth = of("depth", 1);
    let ratio = depth[1]["median"].as_f64().unwrap() / depth[0]["median"].as_f64().unwrap();
    assert!((ratio - 128.0).abs() < 1e-9);
    for (what, per_s) in [("steps", 500.0), ("loop", 20.0)] {
        let row = of(what, 1)[0];
        let times = row["times_real_time"].as_f64().unwrap();
        assert!((times * per_s / row["median"].as_f64().unwrap() - 1.0).abs() < 1e-12);
    }
    let singles: Vec<&str> =
        rows.iter().filter(|r| r["worlds"].is_null()).map(|r| r["what"].as_str().unwrap()).collect();
    assert_eq!(singles[0], "start to first depth image");
    if Path::new("/proc/self/status").exists() {
        assert_eq!(singles[1..], ["memory to first image of 16x8", "memory of 17 worlds of dynamics"]);
    }
    for (name, value) in [
        ("drone", "cf2x_L250"),
        ("control", "state"),
        ("precision", "f32"),
        ("scene", "scene 'forest of seed 0'"),
    ] {
        assert_eq!(told[name], value);
    }
    assert_eq!(told["propwash"], env!("CARGO_PKG_VERSION"));
    assert!(told["processor"].is_string() && told["cores"].is_u64() && told["lanes"].is_string());
    assert_eq!(told["warnings"], serde_json::json!([]));
}

#[test]
fn every_mode_flies_with_ones_own_scene_and_vehicle() {
    for (control, precision) in
        [("state", "f32"), ("body_rate", "f64"), ("force_torque", "f32"), ("rotor_vel", "f64")]
    {
        let (told, _) = figures(&[
            "--scene",
            "xml/room.xml",
            "--drone",
            "hb_x500",
            "--control",
            control,
            "--precision",
            precision,
            "--threads",
            "1",
        ]);
        assert_eq!((&told["control"], &told["precision"]), (&control.into(), &precision.into()));
        assert_eq!(told["drone"], "hb_x500");
        assert!(told["rows"].as_array().unwrap().iter().all(|r| r["threads"].is_null() || r["threads"] == 1));
        assert_eq!(told["warnings"], serde_json::json!([]), "no world is stopped");
    }
    let (told, _) = figures(&["--dynamics", "so_rpy", "--threads", "1"]);
    assert_eq!(told["dynamics"], "so_rpy");
}

#[test]
fn wrong_arguments_are_named_with_what_was_expected() {
    refused(&["--worlds", "1,0"], &["--worlds", "1 to 10000000", "got 0"]);
    refused(&["--worlds", "many"], &["--worlds", "whole number", "many"]);
    refused(&["--sensing-worlds", "0"], &["--sensing-worlds", "got 0"]);
    refused(&["--threads", "0"], &["--threads", "1 to 1024", "got 0"]);
    refused(&["--seconds", "0"], &["--seconds", "above 0"]);
    refused(&["--size", "64"], &["--size", "WIDTHxHEIGHT"]);
    refused(&["--control", "sideways"], &["--control", "attitude", "rotor_vel", "sideways"]);
    refused(&["--control", "state", "--dynamics", "so_rpy", "--drone", "none.toml"], &["none.toml"]);
    refused(&["--control", "rotor_vel", "--dynamics", "so_rpy"], &["--control", "so_rpy", "rotor_vel"]);
    refused(&["--precision", "f16"], &["--precision", "f16", "f32"]);
    refused(&["--scene", "no_such.xml"], &["no_such.xml"]);
    refused(&["--camera", "third_eye"], &["third_eye"]);
    refused(&["--spawn", "0,0"], &["--spawn", "X,Y,Z"]);
}

#[test]
fn a_file_that_cannot_be_written_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("no_such_folder/speed.json");
    let shown = path.to_string_lossy().into_owned();
    let out = bench(&[SMALL, &["--out", &shown]].concat());
    let message = String::from_utf8(out.stderr).unwrap();
    assert_eq!(out.status.code(), Some(2));
    assert!(message.contains("no_such_folder"), "{message}");
}

#[test]
fn json_goes_where_text_does() {
    let out = bench(&[SMALL, &["--json"]].concat());
    assert_eq!(out.status.code(), Some(0), "{}", String::from_utf8_lossy(&out.stderr));
    let told: Value = serde_json::from_slice(&out.stdout).unwrap();
    assert!(told["rows"].as_array().unwrap().iter().any(|row| row["what"] == "steps"), "{told}");
}
