//! Files that commands write: looked for before the work, replaced on request only, whole or not at all.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

/// The program in a folder, with the words of a line.
fn propwash(folder: &Path, line: &str) -> Output {
    let mut program = Command::new(env!("CARGO_BIN_EXE_propwash"));
    program.current_dir(folder).args(line.split_whitespace()).output().unwrap()
}

fn refuses(folder: &Path, line: &str, words: &[&str]) {
    let out = propwash(folder, line);
    let said = String::from_utf8(out.stderr).unwrap();
    assert_eq!(out.status.code(), Some(2), "{line}: {said}");
    assert!(out.stdout.is_empty() && said.trim_end().lines().count() == 1, "{line}: {said}");
    for word in words {
        assert!(said.contains(word), "no {word:?}; {line}: {said}");
    }
}

/// A log that stands still.
fn log() -> String {
    let row = |i| format!("{},0,0,1,0,0,0,1,0,0,0,{}\n", f64::from(i) * 0.01, 0.3 + f64::from(i % 3) * 0.01);
    "t,px,py,pz,qx,qy,qz,qw,cmd_roll,cmd_pitch,cmd_yaw,cmd_thrust\n".to_string()
        + &(0..400).map(row).collect::<String>()
}

const COMMANDS: &[(&str, &str)] = &[
    ("log convert flight.csv", "--out"),
    ("log from-dataset nowhere", "--out"),
    ("scene new boxes", "--out"),
    ("depth --scene nowhere.xml", "--out"),
    ("depth --scene nowhere.xml --out new.png", "--preview"),
    ("identify flight.csv --model attitude --vehicle nobody", "--out"),
    ("excite --vehicle nobody --want linear_drag", "--out"),
    ("compare flight.csv --vehicle nobody", "--report"),
    ("diagnose flight.csv --vehicle nobody", "--out"),
    ("diagnose flight.csv --vehicle nobody", "--report"),
    ("diagnose flight.csv --vehicle nobody", "--ladder"),
    ("add linear_drag --vehicle nobody --fit flight.csv", "--out"),
    ("add linear_drag --vehicle nobody --fit flight.csv --out new.toml", "--report"),
    ("remove linear_drag --vehicle nobody", "--out"),
    ("bench --scene nowhere.xml --worlds 1", "--out"),
];

#[test]
fn every_command_looks_at_its_outputs_before_it_works_and_replaces_none_unasked() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let there = folder.join("there.toml");
    fs::write(&there, "mine").unwrap();
    fs::create_dir(folder.join("dir.toml")).unwrap();
    fs::write(folder.join("flight.csv"), log()).unwrap();
    for (line, flag) in COMMANDS {
        // Inputs that are wrong too would be noticed later.
        refuses(folder, &format!("{line} {flag} there.toml"), &["there.toml", "no file yet", "--force"]);
        refuses(
            folder,
            &format!("{line} {flag} no/x.toml"),
            &["no/x.toml", "no is not there: make that folder first"],
        );
        refuses(folder, &format!("{line} {flag} dir.toml"), &["dir.toml", "it is a folder"]);
    }
    refuses(
        folder,
        "diagnose flight.csv --vehicle nobody --out a --report a",
        &["--report", "--out names too"],
    );
    let log = folder.join("flight.csv");
    let before = fs::read(&log).unwrap();
    refuses(
        folder,
        "compare flight.csv --vehicle cf2x_L250 --force --report flight.csv",
        &["none of the logs"],
    );
    refuses(folder, "log convert flight.csv --out flight.txt --force", &[".csv or .parquet"]);
    assert_eq!((fs::read(&log).unwrap(), fs::read(&there).unwrap()), (before, b"mine".to_vec()));
    let mut names: Vec<_> = fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["dir.toml", "flight.csv", "there.toml"], "nothing else is left");
}

#[test]
fn with_force_files_are_replaced_whole() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let there = folder.join("there.xml");
    fs::write(&there, "mine").unwrap();
    let done = propwash(folder, "scene new boxes --count 3 --out there.xml --force");
    assert_eq!(done.status.code(), Some(0), "{}", String::from_utf8_lossy(&done.stderr));
    assert!(fs::read_to_string(&there).unwrap().contains("<mujoco"));
    let urdf = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/urdf/quad.urdf");
    let line = format!("urdf {urdf} --controller-from cf2x_L250 --out .");
    // One of its two files is there: neither is written.
    fs::write(folder.join("quad.toml"), "mine").unwrap();
    refuses(folder, &line, &["quad.toml", "--force"]);
    assert!(!folder.join("quad.xml").exists());
    assert_eq!(propwash(folder, &format!("{line} --force")).status.code(), Some(0));
    assert!(fs::read_to_string(folder.join("quad.toml")).unwrap().contains("mass"));
}

/// A disk that is full half-way: no file may become larger than some kilobytes.
#[cfg(target_os = "linux")]
#[test]
fn a_log_that_is_converted_in_place_survives_a_full_disk() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("f.csv");
    let rows = |i| format!("{i},0,0,1,0,0,0,1,0,0,{}\n", i % 3);
    let head = "t,px,py,pz,qx,qy,qz,qw,cmd_roll,cmd_pitch,cmd_thrust\n";
    fs::write(&path, head.to_string() + &(0..1500).map(rows).collect::<String>()).unwrap();
    // Numbers with many digits: the new file is larger than the old one.
    let odd =
        |name: &str| format!("{name} = {{ from = \"{name}\", scale = 0.3333333, offset = 0.123456789 }}\n");
    let map = "contract_names = true\n[columns]\nt = { from = \"t\", unit = \"ms\" }\n".to_string()
        + &odd("px")
        + &odd("py");
    fs::write(folder.path().join("f.toml"), map).unwrap();
    let before = fs::read(&path).unwrap();
    let run = |limit: &str| {
        let line = format!("{limit}exec \"$0\" log convert f.csv --out f.csv --force");
        let mut shell = Command::new("sh");
        shell
            .arg("-c")
            .arg(line)
            .arg(env!("CARGO_BIN_EXE_propwash"))
            .current_dir(folder.path())
            .output()
            .unwrap()
    };
    // 512 bytes a block. The signal of the limit is ignored, so that writing fails as on a full disk.
    let full = run("trap '' XFSZ; ulimit -f 60; ");
    let said = String::from_utf8_lossy(&full.stderr);
    assert_eq!(full.status.code(), Some(2), "{said}");
    assert!(said.contains("f.csv: cannot be written"), "{said}");
    assert!(fs::read(&path).unwrap() == before, "the log is as it was");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2, "no part of the new one is left");
    assert_eq!(run("").status.code(), Some(0));
    assert!(fs::metadata(&path).unwrap().len() as usize > before.len());
}
