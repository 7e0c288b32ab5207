//! The command line as a user meets it: help that teaches, results that agree with each other, errors in one line.

use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use serde_json::Value;

/// The program, run from the folder of the project with the words of `line` and then `more`.
fn propwash(line: &str, more: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_propwash"))
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .args(line.split_whitespace())
        .args(more)
        .output()
        .unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// Standard output of a run that must end with `code`.
fn expect(line: &str, more: &[&str], code: i32) -> String {
    let out = propwash(line, more);
    assert_eq!(out.status.code(), Some(code), "{line} {more:?}: {}", text(&out.stderr));
    text(&out.stdout)
}

/// A run that must fail: exit code 2, nothing on standard output, one line that begins with `error:`, holds all
/// `needles` and nothing of Rust's debug output.
fn refused(line: &str, more: &[&str], needles: &[&str]) {
    let out = propwash(line, more);
    let message = text(&out.stderr);
    let what = format!("{line} {more:?} said: {message}");
    assert_eq!(out.status.code(), Some(2), "{what}");
    assert!(out.stdout.is_empty(), "{what}");
    assert!(message.starts_with("error: ") && message.trim_end().lines().count() == 1, "{what}");
    for needle in needles {
        assert!(message.contains(needle), "no {needle:?}; {what}");
    }
    for debris in ["Some(", "Err(", "None", "panicked", "RUST_BACKTRACE", "unwrap", "error: error", " { "] {
        assert!(!message.contains(debris), "{debris:?}; {what}");
    }
}

/// A short flight in a scene of the project; `more` comes after.
const FLY: &str = "fly --scene xml/room.xml --drone cf2x_L250";

/// Refused flight, which leaves no folder behind.
fn no_flight(more: &[&str], needles: &[&str]) {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let mut words = more.to_vec();
    let shown = out.to_string_lossy().into_owned();
    words.extend(["--out", &shown]);
    refused(FLY, &words, needles);
    assert!(!out.exists(), "{more:?} left a folder");
}

fn write(dir: &Path, name: &str, content: impl AsRef<[u8]>) -> String {
    let path = dir.join(name);
    fs::write(&path, content).unwrap();
    path.to_string_lossy().into_owned()
}

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap()
}

#[test]
fn every_command_explains_itself_with_units_and_examples() {
    for command in [
        "",
        "fly",
        "depth",
        "drones",
        "scene",
        "scene lint",
        "scene new",
        "scene new forest",
        "scene new corridor",
        "scene new boxes",
        "urdf",
        "remove",
        "vehicle",
        "vehicle diff",
        "log from-dataset",
        "view",
        "bench",
    ] {
        let help = expect(command, &["--help"], 0);
        assert!(
            help.contains("Examples:") && help.contains(&format!("propwash {command}")),
            "{command}: {help}"
        );
        assert!(help.contains("in m") || help.contains("SI"), "{command} names no unit: {help}");
        // Each flag has a text of some words: beside it, or below it.
        let options = help.split("Options:").nth(1).unwrap().split("Examples:").next().unwrap();
        for part in options.split("\n      --").skip(1) {
            assert!(part.split_whitespace().count() >= 3, "{command}: --{part} has no text");
        }
        assert!(help.lines().all(|l| l.chars().count() <= 110), "{command}: {help}");
    }
    assert!(expect("", &["--version"], 0).contains(env!("CARGO_PKG_VERSION")));
    // The exit codes are taught where a script writer looks.
    assert!(expect("", &["--help"], 0).contains("0 fine, 1 a check found a problem, 2 error"));
    assert!(expect("fly", &["--help"], 0).contains("first_principles, so_rpy, so_rpy_rotor"));
}

#[test]
fn no_command_at_all_shows_the_help_and_fails() {
    let out = propwash("", &[]);
    assert_eq!(out.status.code(), Some(2));
    assert!(text(&out.stderr).contains("Examples:"));
}

#[test]
fn vehicles_are_listed_and_shown_with_their_sources() {
    let list = expect("drones", &[], 0);
    let rows = json(&expect("drones --json", &[], 0));
    let names: Vec<&str> = rows.as_array().unwrap().iter().map(|r| r["name"].as_str().unwrap()).collect();
    assert_eq!(names, propwash::vehicle::BUILTIN);
    for row in rows.as_array().unwrap() {
        let name = row["name"].as_str().unwrap();
        assert!(list.contains(name));
        assert!(row["mass_kg"].as_f64().unwrap() > 0.02 && row["hover_rad_s"].as_f64().unwrap() > 100.0);
        assert_eq!(row["rotors"], 4);
        let shown = expect("drones", &[name], 0);
        assert!(
            shown.contains("body.mass_kg") && shown.contains(" kg") && shown.contains("source: "),
            "{shown}"
        );
        let one = json(&expect("drones --json", &[name], 0));
        let values = one["values"].as_array().unwrap();
        let mass = values.iter().find(|v| v["key"] == "body.mass_kg").unwrap();
        assert_eq!(mass["value"], row["mass_kg"], "{name}");
        assert!(values.iter().all(|v| v["source"].is_string()), "{name}: a value without a source");
    }
    refused("drones nope", &[], &["`nope`", "cf2x_L250", "hb_x500", "by its path"]);
    refused("drones ./nope.toml", &[], &["nope.toml", "check the path"]);
    refused("drones xml/room.xml", &[], &["xml/room.xml", "line 1", "TOML"]);
}

#[test]
fn a_closed_pipe_ends_the_program_quietly() {
    let mut child = Command::new(env!("CARGO_BIN_EXE_propwash"))
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .args(["scene", "lint", "xml/zoo.xml"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // The reader goes before anything is written.
    drop(child.stdout.take());
    let mut said = String::new();
    child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(0));
    assert_eq!(said, "");
}

#[test]
fn wrong_command_lines_are_refused_in_one_line() {
    refused("flyy", &[], &["'flyy'", "propwash --help"]);
    refused("fly", &[], &["--scene", "--drone", "--out", "propwash fly --help"]);
    refused("scene", &["new", "forrest", "--out", "x"], &["'forrest'", "forest"]);
    refused("depth --scene xml/room.xml --camera top --pos 0,0,1 --out x.png", &[], &["--camera", "--pos"]);
    no_flight(&["--wrolds", "3"], &["--wrolds", "--worlds"]);
    // What has one possible value need not be said.
    refused("identify no.csv --vehicle cf2x_L250 --out x.toml", &[], &["no.csv", "check the path"]);
    no_flight(&["--video", "a.mp4"], &["--video", "pip install 'propwash[video]'", "python -m propwash fly"]);
}

#[test]
fn what_was_meant_by_a_wrong_name_is_asked() {
    let dir = tempfile::tempdir().unwrap();
    let quad = write(dir.path(), "quad.toml", "no vehicle");
    let mistyped = quad.replace("quad.toml", "qaud.toml");
    let refusals: [(&str, &[&str], &str); 5] = [
        ("drones cf2x_L251", &[], "did you mean `cf2x_L250`?"),
        ("compare log.csv --vehicle", &[&mistyped], "quad.toml`?"),
        ("remove linear_darg --vehicle cf2x_L250 --out", &[&mistyped], "did you mean `linear_drag`?"),
        ("log check", &[&mistyped], "quad.toml`?"),
        ("scene lint", &[&mistyped], "quad.toml`?"),
    ];
    for (line, more, asked) in refusals {
        refused(line, more, &[asked]);
    }
    // A mistyped ending makes a path look like a name, in the folder where it was typed.
    let told = Command::new(env!("CARGO_BIN_EXE_propwash"))
        .args(["drones", "quad.tml"])
        .current_dir(dir.path())
        .output()
        .unwrap();
    assert!(text(&told.stderr).contains("did you mean `quad.toml`?"), "{}", text(&told.stderr));
    refused("remove drag --vehicle cf2x_L250 --out", &[&mistyped], &["did you mean `linear_drag`"]);
    // One word for one thing: both names of a vehicle's flag are taken everywhere.
    refused("compare no.csv --drone cf2x_L250", &[], &["no.csv"]);
    refused("fly --scene forest --vehicle cf2x_L251 --out", &[&mistyped], &["did you mean"]);
}

#[test]
fn a_vehicle_file_beside_a_log_of_its_name_is_no_mapping() {
    let dir = tempfile::tempdir().unwrap();
    let log = write(dir.path(), "quad.csv", "t,px,py,pz\n0,0,0,1\n0.01,0,0,1\n0.02,0,0,1\n");
    fs::copy(format!("{}/params/cf2x_L250.toml", env!("CARGO_MANIFEST_DIR")), dir.path().join("quad.toml"))
        .unwrap();
    let report = text(&propwash("log check", &[&log]).stdout);
    assert!(report.contains("quad.csv") && !report.contains("mapping"), "{report}");
}

#[test]
fn a_picture_is_written_under_the_ending_that_it_has() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("depth.jpg").display().to_string();
    refused(
        "depth --scene forest --pos 0,0,1 --look 1,0,0 --out",
        &[&out],
        &["--out", "ends in .png", "depth.jpg"],
    );
    assert!(!Path::new(&out).exists());
}

#[test]
fn shells_complete_every_command() {
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let script = expect("completions", &[shell], 0);
        for command in ["diagnose", "excite", "identify"] {
            assert!(script.contains(command), "{shell}: no {command}");
        }
    }
    refused("completions csh", &[], &["csh", "bash"]);
}

#[test]
fn impossible_numbers_are_refused_with_the_flag_and_what_it_may_be() {
    let cases: [(&[&str], &[&str]); 36] = [
        (&["--size", "99999x1"], &["--size", "1 to 8192", "99999x1"]),
        (&["--size", "0x0"], &["--size", "0x0"]),
        (&["--size", "64"], &["--size", "WIDTHxHEIGHT"]),
        (&["--fps", "0"], &["fps", "1 to 500 Hz", "got 0"]),
        (&["--fps", "1000", "--sim-hz", "500"], &["fps", "500", "1000"]),
        (&["--fps", "-3"], &["--fps", "whole number", "-3"]),
        (&["--fps", "2.5"], &["--fps", "whole number", "2.5"]),
        (&["--log-hz", "7", "--sim-hz", "500"], &["log_hz", "divisor", "500", "7"]),
        (&["--log-hz", "0"], &["log_hz", "0"]),
        (&["--sim-hz", "100"], &["sim_hz", "at least 500 Hz", "cf2x_L250"]),
        (&["--sim-hz", "0"], &["sim_hz", "1 to", "got 0"]),
        (&["--seconds", "0"], &["--seconds", "above 0"]),
        (&["--seconds", "NaN"], &["--seconds", "above 0", "NaN"]),
        (&["--seconds", "inf"], &["--seconds"]),
        (&["--seconds", "1e12"], &["seconds", "at most 1e9 steps"]),
        (&["--seconds", "0.0001"], &["seconds", "at least one step"]),
        (&["--worlds", "0"], &["--worlds", "1 to", "got 0"]),
        (&["--worlds", "99999999999"], &["--worlds", "10000000"]),
        (&["--threads", "0"], &["--threads", "1 to 1024"]),
        (&["--threads", "100000"], &["--threads", "1 to 1024"]),
        (&["--drones-per-world", "0"], &["--drones-per-world", "1 to 1024"]),
        (&["--drone", "hb_x500", "--drones-per-world", "1"], &["--drones-per-world", "at least 2", "got 1"]),
        (&["--groups", "9"], &["--groups", "0 to 5", "9"]),
        (&["--groups", "0,,1"], &["--groups", "0 to 5"]),
        (&["--near", "5", "--far", "2"], &["--near", "near < far", "5 m, 2 m"]),
        (&["--near", "0"], &["--near", "above 0"]),
        (&["--near", "0.0001"], &["--near", "0.001 m"]),
        (&["--far", "100"], &["--far", "65.533", "100 m"]),
        (&["--fovy", "200"], &["200", "180"]),
        (&["--seed", "-1"], &["--seed", "whole number"]),
        (&["--obstacle-jitter", "-1"], &["--obstacle-jitter", "at least 0"]),
        (&["--integrator", "heun"], &["--integrator", "rk4", "semi-implicit-euler"]),
        (&["--depth", "w"], &["--depth", "range"]),
        (&["--dynamics", "newton"], &["newton", "so_rpy_rotor_drag"]),
        (&["--camera", "nope"], &["'nope'", "drone0/fpv", "drone0/down"]),
        (&["--drone", "nope"], &["`nope`", "cf2x_P250", "cf21B_500"]),
    ];
    for (words, needles) in cases {
        no_flight(words, needles);
    }
}

#[test]
fn wrong_files_are_refused_with_their_place() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    no_flight(&["--trajectory", "spiral"], &["--trajectory", "lissajous, circle, hover", "spiral"]);
    no_flight(&["--trajectory", "waypoints"], &["--trajectory", "waypoints FILE"]);
    no_flight(&["--trajectory", "waypoints", "nope.csv"], &["nope.csv", "t,x,y,z"]);
    for (content, needles) in [
        ("", &["no column"][..]),
        ("t,x,y\n0,0,0\n", &["no column", "\"z\""]),
        ("t,x,y,z\n0,0,0,1\n", &["at least 2"]),
        ("t,x,y,z\n0,0,0,1\n1,zero,0,1\n", &["row 2", "column x", "zero"]),
        ("t,x,y,z\n0,0,0,1\n0,1,0,1\n", &["waypoint 1", "later"]),
        ("t,x,y,z\n0,0,0,1\n1,NaN,0,1\n", &["waypoint 1", "finite"]),
        ("t,x,y,z\n0,0,0,1\n1,0,0\n", &["w.csv"]),
        ("t,x,y,z,speed\n0,0,0,1,3\n", &["speed", "unknown column"]),
    ] {
        let file = write(dir, "w.csv", content);
        no_flight(&["--trajectory", "waypoints", &file], needles);
    }
    no_flight(&["--randomize", "nope.toml"], &["nope.toml", "check the path"]);
    for (content, needles) in [
        ("[[rule]\n", &["r.toml", "line 1"][..]),
        (
            "[[rule]]\nparameter = \"body.mass_kg\"\ndraw = { gamma = 1 }\n",
            &["r.toml", "line 3", "gamma", "uniform"],
        ),
        (
            "[[rule]]\nparameter = \"body.mass\"\ndraw = { scale = [0.9, 1.1] }\n",
            &["body.mass", "body.mass_kg"],
        ),
        (
            "[[rule]]\nparameter = \"body.mass_kg\"\ndraw = { scale = [2, 1] }\n",
            &["body.mass_kg", "in order"],
        ),
    ] {
        let file = write(dir, "r.toml", content);
        no_flight(&["--randomize", &file], needles);
    }
    for (content, needles) in [
        ("dropout = 0.1\n", &["n.toml", "line 1", "dropout", "dropout_probability"][..]),
        ("\ndropout_probability = 2.0\n", &["dropout_probability", "between 0 and 1"]),
    ] {
        let file = write(dir, "n.toml", content);
        no_flight(&["--noise", &file], needles);
    }
    no_flight(&["--shell", "nope.xml"], &["nope.xml"]);
    let shell = write(dir, "shell.xml", "<mujoco><worldbody><body name=\"quad\"/></worldbody></mujoco>");
    no_flight(&["--shell", &shell], &["drone"]);
}

#[test]
fn scenes_that_cannot_be_loaded_are_refused_with_the_reason() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let deep = format!(
        "<mujoco><worldbody>{}{}</worldbody></mujoco>",
        "<body>".repeat(5000),
        "</body>".repeat(5000)
    );
    let bytes: Vec<u8> = (0..=255u8).cycle().take(4000).collect();
    let mesh = r#"<mujoco><asset><mesh name="m" file="absent.obj"/></asset><worldbody><geom type="mesh" mesh="m"/></worldbody></mujoco>"#;
    let field = r#"<mujoco><asset><hfield name="h" file="absent.png" size="1 1 1 1"/></asset><worldbody><geom type="hfield" hfield="h"/></worldbody></mujoco>"#;
    let clash = r#"<mujoco><worldbody><body name="drone0/hull"/></worldbody></mujoco>"#;
    let cases: [(&str, &[u8], &[&str]); 8] = [
        ("unclosed.xml", b"<mujoco><worldbody>", &["unclosed.xml", "parse"]),
        ("mesh.xml", mesh.as_bytes(), &["mesh.xml", "absent.obj"]),
        ("field.xml", field.as_bytes(), &["field.xml", "absent.png"]),
        ("empty.xml", b"", &["empty.xml", "empty"]),
        ("deep.xml", deep.as_bytes(), &["deep.xml", "parse"]),
        ("bytes.xml", &bytes, &["bytes.xml", "parse"]),
        ("other.xml", b"<html/>", &["other.xml"]),
        (
            "attribute.xml",
            b"<mujoco><worldbody><geom sise=\"1\"/></worldbody></mujoco>",
            &["attribute.xml", "sise"],
        ),
    ];
    for (name, content, needles) in cases {
        let file = write(dir, name, content);
        let png = dir.join("x.png").to_string_lossy().into_owned();
        refused("scene lint", &[&file], needles);
        refused("depth --scene", &[&file, "--out", &png], needles);
        let out = dir.join("out").to_string_lossy().into_owned();
        refused("fly --drone cf2x_L250 --scene", &[&file, "--out", &out], needles);
    }
    let file = write(dir, "clash.xml", clash);
    let out = dir.join("out").to_string_lossy().into_owned();
    refused("fly --drone cf2x_L250 --scene", &[&file, "--out", &out], &["drone0/hull", "rename"]);
    refused("scene lint nope.xml", &[], &["nope.xml", "No such file"]);
    refused("scene lint xml", &[], &["not a file"]);
    refused("fly --scene xml --drone cf2x_L250 --out x", &[], &["not a file"]);
}

#[test]
fn an_empty_scene_is_flown_and_said_to_be_empty() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    // Entities that would grow to a billion characters stay what they are.
    let mut bomb = String::from("<?xml version=\"1.0\"?><!DOCTYPE l [<!ENTITY a0 \"aaaaaaaaaa\">");
    for i in 1..10 {
        bomb += &format!("<!ENTITY a{i} \"{}\">", format!("&a{};", i - 1).repeat(10));
    }
    bomb += "]><mujoco model=\"&a9;\"><worldbody/></mujoco>";
    for (name, content, camera) in [
        ("none.xml", "<mujoco><worldbody/></mujoco>", "fpv"),
        ("camera.xml", "<mujoco><worldbody><camera name=\"eye\" pos=\"0 0 1\"/></worldbody></mujoco>", "eye"),
        ("bomb.xml", bomb.as_str(), "fpv"),
    ] {
        let file = write(dir, name, content);
        let out = dir.join(name.trim_end_matches(".xml"));
        let run = propwash(
            "fly --drone cf2x_L250 --seconds 0.05 --size 8x6 --scene",
            &[&file, "--camera", camera, "--out", &out.to_string_lossy()],
        );
        assert_eq!(run.status.code(), Some(0), "{name}: {}", text(&run.stderr));
        assert!(text(&run.stderr).contains("no geoms"), "{name}: {}", text(&run.stderr));
        assert!(text(&run.stdout).contains("1 world:"), "{}", text(&run.stdout));
        assert!(out.join("overview.png").is_file());
    }
    let lint = expect("scene lint", &[&dir.join("none.xml").to_string_lossy()], 0);
    assert!(lint.contains("no geoms"), "{lint}");
}

#[test]
fn a_folder_that_is_not_ours_is_left_alone() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let file = write(dir, "file", "x");
    refused(FLY, &["--out", &file], &["--out", "which is a file"]);
    let foreign = dir.join("foreign");
    fs::create_dir(&foreign).unwrap();
    write(&foreign, "photo.jpg", "x");
    refused(FLY, &["--out", &foreign.to_string_lossy()], &["photo.jpg", "choose another --out"]);
    assert_eq!(fs::read_dir(&foreign).unwrap().count(), 1, "nothing was written into it");
    let below = format!("{file}/below");
    refused(FLY, &["--out", &below], &["Not a directory", "check the path"]);
    let absent = dir.join("absent/x.png").to_string_lossy().into_owned();
    refused("depth --scene xml/room.xml", &["--out", &absent], &["absent/x.png", "check the path"]);
    refused("scene new boxes", &["--out", &absent], &["absent/x.png", "check the path"]);
}

#[test]
#[cfg(unix)]
fn a_folder_without_write_permission_is_an_error() {
    use std::os::unix::fs::PermissionsExt;
    let dir = tempfile::tempdir().unwrap();
    let locked = dir.path().join("locked");
    fs::create_dir(&locked).unwrap();
    fs::set_permissions(&locked, fs::Permissions::from_mode(0o555)).unwrap();
    // Nothing is locked for the system's administrator; the process file system is, for everyone.
    let target = match fs::write(locked.join("probe"), "x") {
        Err(_) => locked.join("data"),
        Ok(()) => PathBuf::from("/proc/data"),
    };
    refused(FLY, &["--out", &target.to_string_lossy()], &[&target.to_string_lossy(), "check the path"]);
}

/// `depth`, `contact` and the remarks of a geom in a lint report.
fn verdict<'a>(report: &'a Value, geom: &str) -> (bool, bool, &'a Value) {
    let found =
        report["geoms"].as_array().unwrap().iter().find(|g| g["name"].as_str().unwrap().contains(geom));
    let found = found.unwrap_or_else(|| panic!("no {geom}"));
    (found["depth"]["seen"].as_bool().unwrap(), found["contact"]["seen"].as_bool().unwrap(), found)
}

#[test]
fn lint_names_every_trick_of_the_zoo() {
    let report = json(&expect("scene lint xml/zoo.xml --json", &[], 1));
    let table = expect("scene lint xml/zoo.xml", &[], 1);
    for (geom, depth, contact, word) in [
        ("'trick_group3'", false, true, "group 3"),
        ("'trick_alpha0'", false, true, "alpha is 0"),
        ("'trick_material_alpha0'", false, true, "alpha is 0"),
        ("'trick_alpha_low'", true, true, "transparent"),
        ("'trick_visual_only'", true, false, "contype"),
        ("'trick_contype2_conaffinity0'", true, true, ""),
        ("'trick_contype0_conaffinity2'", true, true, ""),
        ("'trick_margin'", true, true, "margin"),
        ("'trick_mesh_concave_hulled'", true, true, "convex hull"),
        ("'trick_mesh_concave_visual'", true, false, "contype"),
        ("'trick_mesh_concave_proxy'", false, true, "group 3"),
        ("'trick_plane_finite'", true, true, "rectangle"),
        ("'trick_wire'", true, true, ""),
        ("'trick_sheet'", true, true, ""),
        ("'mover_mocap_child'", true, true, "obstacle 0"),
        ("'mover_free'", true, true, "obstacle 1"),
        ("'door'", true, true, "joint"),
        ("'type_sdf'", true, true, "signed distance field"),
        ("'type_hfield'", true, true, ""),
        ("'type_cylinder'", true, true, ""),
    ] {
        let (seen, touched, record) = verdict(&report, geom);
        assert_eq!((seen, touched), (depth, contact), "{geom}");
        assert!(record.to_string().contains(word), "{geom}: {record}");
        let row = table.lines().find(|l| l.contains(geom)).unwrap_or_else(|| panic!("no row of {geom}"));
        assert!(row.contains(word), "{row}");
        assert_eq!(row.matches("NO").count(), usize::from(!depth) + usize::from(!contact), "{row}");
    }
    assert!(table.contains("4 geom(s) unseen by depth, 2 without contacts"), "{table}");
}

#[test]
fn generated_scenes_pass_the_lint_and_repeat_themselves() {
    let dir = tempfile::tempdir().unwrap();
    for kind in ["forest --seed 3 --trees 60", "corridor --seed 3 --gates 5", "boxes --seed 3 --count 30"] {
        let dir = tempfile::tempdir().unwrap();
        let path = |name: &str| dir.path().join(name).to_string_lossy().into_owned();
        let (a, b, other) = (path("a.xml"), path("b.xml"), path("other.xml"));
        let said = expect(&format!("scene new {kind}"), &["--out", &a], 0);
        assert!(said.contains(&a) && said.contains("geoms"), "{said}");
        expect(&format!("scene new {kind}"), &["--out", &b], 0);
        expect(&format!("scene new {}", kind.replace("--seed 3", "--seed 4")), &["--out", &other], 0);
        assert_eq!(fs::read(&a).unwrap(), fs::read(&b).unwrap(), "{kind}");
        assert_ne!(fs::read(&a).unwrap(), fs::read(&other).unwrap(), "{kind}");
        let report = expect("scene lint", &[&a], 0);
        assert!(report.contains("0 geom(s) unseen by depth, 0 without contacts"), "{kind}: {report}");
    }
    // Something in the way of the start is found.
    let wall = write(
        dir.path(),
        "wall.xml",
        r#"<mujoco><worldbody><geom name="wall" type="box" size="1 1 1" pos="0 0 1"/></worldbody></mujoco>"#,
    );
    assert!(expect("scene lint", &[&wall], 1).contains("overlaps the spawn"));
    expect("scene lint", &[&wall, "--spawn", "-4,0,1"], 0);
}

#[test]
fn impossible_scenes_are_not_generated() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("x.xml");
    let cases: [(&str, &[&str]); 11] = [
        ("forest --trees 100000", &["--trees", "0 to 20000", "100000"]),
        ("forest --trees -1", &["--trees", "whole number"]),
        ("forest --extent -1", &["--extent", "above 0"]),
        ("forest --extent NaN", &["--extent"]),
        ("forest --extent 2", &["--extent", "4 to 1000 m"]),
        ("forest --clearing 100", &["--clearing", "100"]),
        ("forest --trees 5000", &["5000", "trees", "at most"]),
        ("corridor --width 0.1", &["--width", "1.4"]),
        ("corridor --length 0.5", &["--length"]),
        ("boxes --count 1000000", &["--count", "1000000"]),
        ("boxes --moving 1000000", &["--moving", "0 to 1000"]),
    ];
    for (kind, needles) in cases {
        refused(&format!("scene new {kind}"), &["--out", &out.to_string_lossy()], needles);
        assert!(!out.exists(), "{kind} left a file");
    }
}

#[test]
fn a_depth_image_holds_the_numbers_that_are_printed() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).to_string_lossy().into_owned();
    let (png, preview) = (path("d.png"), path("p.png"));
    let line = "depth --scene xml/forest.xml --pos 0,0,1 --look -1,0.5,-0.1 --size 48x36 --far 8 --json";
    let said = json(&expect(line, &["--out", &png, "--preview", &preview], 0));
    let (width, height, values) = propwash::dataset::read_depth_png(Path::new(&png)).unwrap();
    assert_eq!((width, height), (48, 36));
    let status_of = |value: u16| propwash::dataset::decode(value, 0.001).1;
    let count = |status: u8| values.iter().filter(|v| status_of(**v) == status).count();
    for (status, name) in ["hit", "miss", "too_far", "too_near"].into_iter().enumerate() {
        assert_eq!(said[name].as_u64().unwrap() as usize, count(status as u8), "{name}");
    }
    assert!(count(0) > 100 && count(1) > 10 && count(2) > 10, "a picture with hits, sky and far things");
    let hits = || values.iter().filter(|v| status_of(**v) == 0);
    let metres = |v: u16| f64::from(v) * 0.001;
    let (nearest, farthest) = (metres(*hits().min().unwrap()), metres(*hits().max().unwrap()));
    assert!((nearest - said["nearest_m"].as_f64().unwrap()).abs() <= 0.000_501);
    assert!((farthest - said["farthest_m"].as_f64().unwrap()).abs() <= 0.000_501);
    assert!(farthest <= 8.0);
    let pixels: u64 = said["pixels_by_geom"].as_object().unwrap().values().map(|n| n.as_u64().unwrap()).sum();
    assert_eq!(
        pixels,
        said["hit"].as_u64().unwrap()
            + said["too_far"].as_u64().unwrap()
            + said["too_near"].as_u64().unwrap()
    );
    // The preview is a picture in colour of at least that size.
    let preview = image::open(&preview).unwrap();
    assert!(preview.width() >= 48 && preview.height() >= 36);
    assert!(preview.color().has_color());
    // In words: the same counts.
    let words = expect(&line.replace("--json", "--force"), &["--out", &png], 0);
    assert!(words.contains(&format!("{} pixels hit", count(0))), "{words}");
}

#[test]
fn cameras_of_the_scene_are_looked_through_or_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let png = dir.path().join("x.png").to_string_lossy().into_owned();
    let said = json(&expect("depth --scene xml/zoo.xml --camera intrinsics --json", &["--out", &png], 0));
    // 400 and 410 pixels of focal length on 640 x 480, here on 64 x 64.
    let k = &said["k"];
    assert!((k[0][0].as_f64().unwrap() - 40.0).abs() < 1e-4, "{k}");
    assert!((k[1][1].as_f64().unwrap() - 410.0 * 64.0 / 480.0).abs() < 1e-4, "{k}");
    refused(
        "depth --force --scene xml/zoo.xml --camera nope",
        &["--out", &png],
        &["'nope'", "overview", "intrinsics"],
    );
    refused("depth --force --scene xml/zoo.xml --camera orthographic", &["--out", &png], &["orthographic"]);
    refused("depth --force --scene xml/zoo.xml --look 0,0,0", &["--out", &png], &["--look", "not zero"]);
    refused("depth --force --scene xml/zoo.xml --pos 1,2", &["--out", &png], &["--pos", "X,Y,Z"]);
    refused("depth --force --scene xml/zoo.xml --pos 1,2,inf", &["--out", &png], &["--pos", "finite"]);
    refused("depth --force --scene xml/zoo.xml --pos 1e300,2,1", &["--out", &png], &["1e9 m"]);
}

#[test]
fn a_urdf_becomes_a_vehicle_that_flies_and_an_obstacle_that_is_seen() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().to_string_lossy().into_owned();
    let path = |name: &str| dir.path().join(name).to_string_lossy().into_owned();
    refused("urdf tests/data/urdf/quad.urdf", &["--out", &out], &["controller_from", "cf2x_L250"]);
    refused("urdf nope.urdf", &["--out", &out], &["nope.urdf", "check the path"]);
    let said = expect("urdf tests/data/urdf/quad.urdf --controller-from cf2x_L250", &["--out", &out], 0);
    assert!(said.contains("quad.toml") && said.contains("quad.xml"), "{said}");
    let shown = expect("drones", &[&path("quad.toml")], 0);
    assert!(shown.contains("body.mass_kg") && shown.contains("0.03"), "{shown}");
    let flown = expect(
        "fly --scene xml/room.xml --trajectory hover --seconds 0.2 --size 8x6 --json",
        &["--drone", &path("quad.toml"), "--out", &path("data")],
        0,
    );
    assert_eq!(json(&flown)["quarantined_worlds"], 0);
    expect("urdf tests/data/urdf/pkg/urdf/gate.urdf --obstacle", &["--out", &out], 0);
    let seen = json(&expect(
        "depth --size 32x32 --pos -3,0,1 --json --scene",
        &[&path("gate.xml"), "--out", &path("gate.png")],
        0,
    ));
    assert!(seen["hit"].as_u64().unwrap() > 0, "{seen}");
}

#[test]
fn an_effect_is_removed_and_the_difference_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("bare.toml");
    let bare = path.to_str().unwrap();
    let remove = ["linear_drag", "--vehicle", "cf2x_L250", "--out", bare];
    assert!(expect("remove", &remove, 0).contains(bare));
    let file = fs::read_to_string(&path).unwrap();
    let built_in = fs::read_to_string("params/cf2x_L250.toml").unwrap();
    assert!(built_in.starts_with(file.trim_end()) && !file.contains("linear_drag"), "{file}");

    assert!(expect("vehicle diff cf2x_L250 params/cf2x_L250.toml", &[], 0).contains("are the same"));
    let said = expect("vehicle diff cf2x_L250", &[bare], 1);
    assert!(said.contains("effect linear_drag removed in first_principles, so_rpy_rotor_drag"), "{said}");
    assert!(
        said.contains("drag_n_s_per_m.2.2") && said.contains("0.01390009 → -") && said.contains("N·s/m"),
        "{said}"
    );
    let said = json(&expect("vehicle diff --json", &["cf2x_L250", bare], 1));
    assert_eq!(said["same"], false);
    assert_eq!(said["diff"]["effects"][0]["change"], "removed");
    assert_eq!(said["diff"]["parameters"], serde_json::json!([]));

    // A changed number with its sigma, in SI and in per cent.
    let heavy = built_in.replace("mass_kg = 0.0328\n", "mass_kg = 0.0361\nsigma = { mass_kg = 0.0002 }\n");
    let heavy = write(dir.path(), "heavy.toml", heavy);
    let said = expect("vehicle diff cf2x_L250", &[&heavy], 1);
    assert!(
        said.contains("body.mass_kg  0.0328 → 0.0361 ± 0.0002  kg") && said.contains("+10.06 %"),
        "{said}"
    );

    // An effect that was fitted: known digits, and no factor of a rotor that the vehicle has not.
    let weak = "\n[[effect]]\nkind = \"weak_rotor\"\nfactor = [0.99853261, 1, 1, 1, 1, 1, 1, 1]\nsigma = { factor.0 = 0.0033844443 }\n";
    let weak = write(dir.path(), "weak.toml", built_in.clone() + weak);
    let said = expect("vehicle diff cf2x_L250", &[&weak], 1);
    assert!(said.contains("factor.0  - → 0.9985 ± 0.0034\n") && !said.contains("factor.1"), "{said}");
    let said = json(&expect("vehicle diff --json", &["cf2x_L250", &weak], 1));
    assert_eq!(said["diff"]["effects"][0]["parameters"].as_array().unwrap().len(), 8);

    // Nothing is replaced unasked, the input included.
    refused("remove", &remove, &["bare.toml", "there is no file yet", "--force"]);
    let own = ["linear_drag", "--vehicle", &heavy, "--out", &heavy];
    refused("remove", &own, &["heavy.toml", "--force"]);
    expect("remove --force", &own, 0);
    assert!(!fs::read_to_string(&heavy).unwrap().contains("linear_drag"));
    refused("remove --force", &own, &["heavy.toml", "`linear_drag`", "no effects"]);
    refused("remove --force payload --vehicle cf3 --out", &[bare], &["cf3", "cf2x_L250"]);
    refused("remove payload --vehicle cf2x_L250 --out y.toml", &[], &["`payload`", "found linear_drag"]);
    refused("vehicle diff cf2x_L250 nowhere.toml", &[], &["nowhere.toml", "check the path"]);

    // A shell beside the file is missed where the copy lies.
    let odd = built_in.replace("shell = \"cf2x\"", "shell = \"mine_shell.xml\"");
    let odd = write(dir.path(), "odd.toml", odd);
    let out = propwash("remove linear_drag --vehicle", &[&odd, "--out", &format!("{odd}.toml")]);
    assert_eq!(out.status.code(), Some(0));
    assert!(
        text(&out.stderr).contains("warning: the shell of") && text(&out.stderr).contains("mine_shell.xml")
    );
}

#[test]
fn a_recorded_flight_becomes_a_log_that_the_checker_passes() {
    let dir = tempfile::tempdir().unwrap();
    let vehicle = fs::read_to_string("params/cf2x_L250.toml").unwrap()
        + "\n[[effect]]\nkind = \"constant_wind\"\nvelocity_m_s = [0.5, -0.2, 0.1]\n\
           \n[[effect]]\nkind = \"gust\"\nsine_m_s = [0.0, 0.3, 0.0]\nfrequency_hz = 0.5\n\
           \n[[effect]]\nkind = \"battery_sag\"\nfull_v = 4.2\nnominal_v = 4.1\nresistance_ohm = 0.1\ndrop_v_per_a_s = 0.002\n";
    let mine = write(dir.path(), "windy.toml", vehicle);
    let data = dir.path().join("data");
    let shown = data.to_str().unwrap();
    let fly = "fly --scene xml/room.xml --worlds 2 --seconds 6 --fps 1 --size 8x8 --json --drone";
    expect(fly, &[&mine, "--drone", "cf2x_L250", "--out", shown], 0);
    let log = dir.path().join("flight.csv");
    let log = log.to_str().unwrap();
    assert!(expect("log from-dataset --world 1 --drone 0", &[shown, "--out", log], 0).contains("6.0 s"));
    let report = json(&expect("log check --json", &[log], 0));
    assert_eq!(report[0]["verdict"], "info", "{report}");

    let set = propwash::dataset::Dataset::open(&data).unwrap();
    let states = set.world(1).unwrap().states(None).unwrap();
    let column = |name: &str| states.column(name).unwrap();
    let flight = propwash::flight::FlightLog::load(Path::new(log), None).unwrap();
    assert_eq!((flight.position_m.len(), states.n_rows()), (601, 1202));
    assert_eq!((flight.rotor_speed_rad_s.len(), flight.cmd_rotor_rad_s.len()), (4, 4));
    assert_eq!(flight.objects_m.keys().collect::<Vec<_>>(), ["drone1"]);
    for i in [0, 77, 600] {
        let row = 2 * i;
        assert_eq!(flight.position_m.t_s[i], column("t")[row]);
        assert_eq!(flight.position_m.values[i], ["px", "py", "pz"].map(|n| column(n)[row]));
        assert_eq!(flight.objects_m["drone1"].values[i], ["px", "py", "pz"].map(|n| column(n)[row + 1]));
        assert_eq!(flight.ref_position_m.values[i], ["ref_x", "ref_y", "ref_z"].map(|n| column(n)[row]));
        assert_eq!(flight.rotor_speed_rad_s[3].values[i][0], column("rotor4")[row]);
        let gust = 0.3 * (core::f64::consts::PI * column("t")[row]).sin();
        let [x, y, z] = flight.wind_m_s.values[i];
        assert!(
            (x - 0.5).abs() < 1e-12 && (y - gust + 0.2).abs() < 1e-9 && (z - 0.1).abs() < 1e-12,
            "{x} {y} {z}"
        );
        assert_eq!(["wind_x", "wind_y", "wind_z"].map(|n| column(n)[row + 1]), [0.0; 3]);
        assert!(column("vbat")[row + 1].is_nan(), "no battery");
    }
    let v: Vec<f64> = flight.vbat_v.component(0);
    assert!(v.len() == 601 && v[0] < 4.2 && v[600] < v[0] && v[600] > 3.0, "{} {}", v[0], v[600]);

    // The other drone, as Parquet.
    let other = dir.path().join("other.parquet");
    expect("log from-dataset --world 1 --drone 1", &[shown, "--out", other.to_str().unwrap()], 0);
    let other = propwash::flight::FlightLog::load(&other, None).unwrap();
    assert!(other.vbat_v.is_empty() && other.wind_m_s.len() == 601);
    refused("log from-dataset --world 2 --force", &[shown, "--out", log], &["world 2", "0 to 1"]);
    refused("log from-dataset --drone 2 --force", &[shown, "--out", log], &["drone 0 to 1", "got 2"]);
    refused("log from-dataset nowhere --out x.csv", &[], &["nowhere", "no folder"]);
    refused("log from-dataset", &[shown, "--out", "x.txt"], &["x.txt", ".csv or .parquet"]);
}
