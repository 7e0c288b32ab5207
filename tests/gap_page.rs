//! The eight commands of docs/gap.md, as the page has them, one after the other in an empty folder.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// The lines of the page's first block of commands: continued lines joined, comments cut off.
fn commands() -> Vec<String> {
    let page = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/gap.md")).unwrap();
    let block = page.split("```sh\n").nth(1).and_then(|rest| rest.split("```").next()).unwrap();
    block
        .replace("\\\n", " ")
        .lines()
        .map(|line| line.split(" #").next().unwrap().trim().to_string())
        .filter(|line| !line.is_empty())
        .collect()
}

/// The program that a command of the page starts, as the tests have built it, and its arguments.
fn program(line: &str) -> (PathBuf, Vec<String>) {
    let words = |text: &str| text.split_whitespace().map(String::from).collect();
    if let Some(rest) = line.strip_prefix("cargo run --release --example hidden_flight --") {
        let test = std::env::current_exe().unwrap();
        let profile = test.parent().and_then(Path::parent).unwrap().to_path_buf();
        let example = profile.join("examples").join(format!("hidden_flight{}", std::env::consts::EXE_SUFFIX));
        assert!(example.is_file(), "{} is missing: run `cargo build --examples` first", example.display());
        return (example, words(rest));
    }
    let rest = line.strip_prefix("propwash ").unwrap_or_else(|| panic!("no command of propwash: {line}"));
    (env!("CARGO_BIN_EXE_propwash").into(), words(rest))
}

fn said(out: &Output) -> String {
    String::from_utf8_lossy(&out.stdout).into_owned()
}

#[test]
fn a_raw_log_becomes_a_better_vehicle_file() {
    let folder = tempfile::tempdir().unwrap();
    let lines = commands();
    assert_eq!(lines.len(), 8, "{lines:#?}");
    // 1: the log has a warning (its poses have a hole), a gap is found before, the two files differ. After, numbers within tolerance
    // are all that is off, since only what helps on unseen flight is written.
    let codes = [0, 1, 1, 1, 0, 1, 0, 0];
    let mut outputs = Vec::new();
    for (line, code) in lines.iter().zip(codes) {
        let (program, arguments) = program(line);
        let out = Command::new(program).args(arguments).current_dir(folder.path()).output().unwrap();
        let found = out.status.code();
        assert_eq!(found, Some(code), "{line}: {} {}", said(&out), String::from_utf8_lossy(&out.stderr));
        outputs.push(out);
    }
    let path = |name: &str| folder.path().join(name);
    let text = |name: &str| std::fs::read_to_string(path(name)).unwrap();

    assert!(said(&outputs[3]).contains("missing: rotor_drag"), "{}", said(&outputs[3]));
    assert!(text("better.toml").contains("rotor_drag"), "{}", text("better.toml"));
    assert!(
        text("better.toml").contains("gyro_bias"),
        "what helps of the sensors' faults too: {}",
        text("better.toml")
    );
    let times = |i: usize| -> f64 {
        let all = said(&outputs[i]);
        let before = all.split(" times what the sensors' noise makes").next().unwrap();
        before.rsplit(' ').next().unwrap().parse().unwrap_or_else(|_| panic!("no figure in {all}"))
    };
    assert!(times(2) > 100.0 && times(6) < 4.0, "{} {}", times(2), times(6));
    assert!(said(&outputs[6]).contains("better: nothing is missing"), "{}", said(&outputs[6]));
    assert!(said(&outputs[5]).contains("rotor_drag"), "{}", said(&outputs[5]));
    assert!(text("path.csv").lines().count() > 10);
    for page in ["before.html", "gap.html"] {
        let page = text(page);
        assert!(page.contains("uPlot") && !page.contains("src=\"http"), "one self-contained page");
        assert!(page.len() <= 1_500_000, "{} bytes", page.len());
    }
    // The picture shows curves: many pixels that are not paper.
    let picture = image::open(path("ladder.png")).unwrap().into_rgb8();
    assert!(picture.width() >= 600 && picture.height() >= 300, "{:?}", picture.dimensions());
    let inked = picture.pixels().filter(|p| p.0.iter().any(|v| *v < 200)).count();
    assert!(inked > 2000, "{inked} pixels with ink");
}
