//! `propwash watch`: flights of one vehicle, one after the other, of which something drifts, or nothing does.

#[path = "common/planted/mod.rs"]
mod planted;

use planted::{Plan, fly};
use propwash::gap::Options;
use propwash::gap::drift::{self, ChangeKind, Entry, Order, Reading, Series};
use propwash::gap::watch::Watch;
use propwash::vehicle::Vehicle;
use serde_json::Value;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, SystemTime};

const QUAD: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/planted_quad.toml");
/// Length of a flight, s.
const SECONDS: f64 = 12.0;

/// A folder with flights of the vehicle of one seed, a minute apart.
struct Logs {
    folder: tempfile::TempDir,
    seed: u64,
    /// True values of the first hidden effect's `factor`, by log.
    factors: Vec<f64>,
    number: u64,
}

impl Logs {
    fn new(seed: u64) -> Self {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("logs")).unwrap();
        fs::copy(QUAD, folder.path().join("quad.toml")).unwrap();
        Self { folder, seed, factors: Vec::new(), number: 0 }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Sets the time of a file: that of the log of this number.
    fn date(&self, path: &Path, number: u64) {
        let at = SystemTime::UNIX_EPOCH + Duration::from_secs(1_795_701_720 + 60 * number);
        fs::File::options().append(true).open(path).unwrap().set_modified(at).unwrap();
    }

    /// Flies once more with these effects at this size.
    fn fly(&mut self, effects: &[&'static str], size: f64) {
        let vehicle = Vehicle::load(QUAD).unwrap();
        self.number += 1;
        let mut plan = Plan::exciting(&vehicle, effects, SECONDS, self.seed);
        (plan.flight, plan.size) = (self.number, size);
        let flight = fly(&plan).unwrap();
        if let Some(factor) = flight.truth.hidden.first().and_then(|h| h.parameters.get("factor")) {
            self.factors.push(*factor);
        }
        let path = self.path(&format!("logs/log_{:04}.csv", self.number));
        flight.write(&path).unwrap();
        self.date(&path, self.number);
    }

    /// What a watch says of the logs so far.
    fn watched(&self) -> Series {
        let vehicle = Vehicle::load(QUAD).unwrap();
        let reading = Reading { mapping: None, options: Options::default(), hold_out: 0.2 };
        let text = fs::read_to_string(QUAD).unwrap();
        let mut series = Series::new("quad", &vehicle, &text, reading);
        for log in drift::look(&self.path("logs"), Order::Time).unwrap().logs {
            series.take(&log, &Watch::default()).unwrap();
        }
        for entry in series.entries() {
            println!("{}", drift::block(entry));
        }
        println!("{}\n{:?}", drift::table(&series), self.factors);
        series
    }

    fn run(&self, line: &str) -> Output {
        Command::new(env!("CARGO_BIN_EXE_propwash"))
            .args(line.split_whitespace())
            .current_dir(self.folder.path())
            .output()
            .unwrap()
    }

    fn document(&self, line: &str) -> Value {
        let out = self.run(line);
        let error = String::from_utf8_lossy(&out.stderr).into_owned();
        serde_json::from_slice(&out.stdout).unwrap_or_else(|e| panic!("{e}: {error}"))
    }
}

/// Number of the first log that says something of an effect.
fn first(series: &Series, id: &str) -> Option<usize> {
    series.entries().iter().position(|e| e.changes.iter().any(|c| c.id == id))
}

fn said(entry: &Entry) -> Vec<&str> {
    entry.changes.iter().map(|c| c.id.as_str()).collect()
}

#[test]
fn thrust_that_falls_by_a_hundredth_a_flight_is_a_drift_before_the_last_one() {
    let mut logs = Logs::new(1);
    (0..8).for_each(|k| logs.fly(&["thrust_scale"], 0.1 * f64::from(k)));
    let series = logs.watched();
    let at = first(&series, "thrust_scale").expect("said");
    let change = &series.entries()[at].changes[0];
    assert_eq!(change.kind, ChangeKind::Drifted);
    // A log by itself knows the thrust to 0.0065, so that two of them differ by 0.0092.
    let lost = logs.factors[0] - logs.factors[at];
    assert!(lost < 4.0 * 0.0092, "said in log {at}, when {lost} was lost");
    for entry in series.entries() {
        assert!(said(entry).iter().all(|id| *id == "thrust_scale"), "{:?}", entry.changes);
    }
    let accepted = series.accepted().into_iter().find(|p| p.id == "thrust_scale").unwrap();
    let truth = *logs.factors.last().unwrap();
    assert!(accepted.changed && (accepted.value - truth).abs() < 0.012, "{accepted:?} {truth}");
    assert!((accepted.value - truth).abs() < 2.5 * accepted.sigma, "{accepted:?} {truth}");
    // What was accepted before a flight is right about it.
    let last = series.entries().last().unwrap();
    assert!(last.forecast_over_file.unwrap() < 0.3 && last.errors_over_file.unwrap() < 0.3);
    assert!(!last.still.is_empty() || !last.changes.is_empty());
    // The vehicle with what is accepted reads back, and its values name the logs.
    let text = series.written().unwrap().expect("it lowers the errors");
    let better = Vehicle::from_toml("quad", &text).unwrap();
    assert!(
        text.contains("propwash watch on log_0001.csv")
            && better.sha256() != Vehicle::load(QUAD).unwrap().sha256()
    );
}

#[test]
fn another_wind_and_another_battery_in_each_flight_are_no_drift() {
    for seed in [1, 5] {
        let mut logs = Logs::new(seed);
        for size in [0.1, 0.9, 0.3, 1.2, 0.0, 0.7] {
            logs.fly(&["constant_wind", "battery_sag"], size);
        }
        let series = logs.watched();
        for entry in series.entries() {
            assert!(entry.left_out.is_none() && entry.changes.is_empty(), "{seed}: {:?}", entry.changes);
        }
        let wind = |e: &Entry| e.of_the_flight.iter().any(|o| o.id == "constant_wind");
        assert!(series.entries().iter().filter(|e| wind(e)).count() >= 3, "wind is said of the flight");
        assert!(series.accepted().iter().all(|p| !p.changed && p.id != "constant_wind"));
    }
}

#[test]
fn a_payload_from_the_third_flight_on_is_said_there_and_stays() {
    let mut logs = Logs::new(1);
    (0..2).for_each(|_| logs.fly(&[], 0.0));
    (0..2).for_each(|_| logs.fly(&["payload"], 1.0));
    let series = logs.watched();
    let entries = series.entries();
    assert!(said(&entries[0]).is_empty() && said(&entries[1]).is_empty());
    let change = &entries[2].changes[0];
    assert!(change.id == "payload" && change.kind == ChangeKind::New && change.since == "log_0003.csv");
    assert!(said(&entries[3]).is_empty());
    assert_eq!(entries[3].still, [("payload".to_string(), "log_0003.csv".to_string())]);
    assert!(drift::block(&entries[2]).contains("payload: new in this log: mass_kg"));
}

#[test]
fn thrust_that_comes_back_is_said_to_be_back() {
    let mut logs = Logs::new(2);
    for size in [0.0, 0.0, 0.7, 0.7, 0.0, 0.0] {
        logs.fly(&["thrust_scale"], size);
    }
    let series = logs.watched();
    let changes: Vec<(usize, ChangeKind)> = series
        .entries()
        .iter()
        .enumerate()
        .flat_map(|(i, e)| e.changes.iter().map(move |c| (i, c.kind)))
        .collect();
    assert_eq!(changes, [(2, ChangeKind::Drifted), (4, ChangeKind::Returned)]);
    assert!(series.entries()[5].still.is_empty());
}

#[test]
fn broken_files_are_said_and_a_record_goes_on_where_it_ended() {
    let mut logs = Logs::new(2);
    logs.fly(&["thrust_scale"], 0.0);
    logs.fly(&["thrust_scale"], 0.8);
    let write = |name: &str, text: &[u8]| fs::write(logs.path(&format!("logs/{name}")), text).unwrap();
    write("README.md", b"flights of November");
    write("empty.csv", b"");
    write("noise.csv", b"these are\nno numbers at all\n");
    write("cut.ulg", b"ULog\x01\x12");
    fs::copy(logs.path("logs/log_0001.csv"), logs.path("logs/copy.csv")).unwrap();
    let line = "watch logs --vehicle quad.toml --once";
    let out = logs.run(&format!("{line} --record r.jsonl --write now.toml --json d.json"));
    let text = String::from_utf8_lossy(&out.stdout).into_owned();
    assert_eq!(out.status.code(), Some(1), "{text} {}", String::from_utf8_lossy(&out.stderr));
    assert!(text.contains("6 logs in logs, and 1 other file that is none"), "{text}");
    assert!(text.contains("2 logs diagnosed, 4 left out") && text.contains("← said here"), "{text}");
    for name in ["empty.csv", "noise.csv", "cut.ulg", "copy.csv"] {
        assert!(text.lines().any(|l| l.starts_with(name) && l.contains("left out: ")), "{name}: {text}");
    }
    assert!(text.contains("the same file as log_0001.csv"), "{text}");
    let now = Vehicle::load(logs.path("now.toml")).unwrap();
    assert!(now.file().effect.iter().any(|e| e.kind == "thrust_scale"));
    assert_eq!(fs::read(logs.path("quad.toml")).unwrap(), fs::read(QUAD).unwrap(), "the input stays");
    // Files that are there are replaced with --force alone, the record without.
    assert_eq!(logs.run(&format!("{line} --write now.toml")).status.code(), Some(2));

    // One more flight, of the vehicle as it was.
    logs.fly(&["thrust_scale"], 0.0);
    let again = logs.document(&format!("{line} --record r.jsonl --json -"));
    let whole = logs.document(&format!("{line} --json -"));
    let by_name = |d: &Value| {
        let mut logs = d["logs"].as_array().unwrap().clone();
        logs.sort_by_key(|l| l["name"].as_str().unwrap().to_string());
        logs
    };
    for (again, whole) in by_name(&again).iter().zip(by_name(&whole)) {
        for (key, value) in whole.as_object().unwrap() {
            assert_eq!(again[key], *value, "{}: {key}: a restart gives what one run gives", whole["name"]);
        }
    }
    assert_eq!(again["accepted"], whole["accepted"]);
    let last = by_name(&whole).into_iter().find(|l| l["name"] == "log_0003.csv").unwrap();
    assert_eq!(last["changes"][0]["kind"], "returned");

    // A record of another vehicle, a file that is no record, no folder, no vehicle, no log.
    let refused = |line: &str, words: &str| {
        let out = logs.run(line);
        let error = String::from_utf8_lossy(&out.stderr).into_owned();
        assert!(out.status.code() == Some(2) && error.contains(words), "{line}: {error}");
    };
    refused("watch logs --vehicle cf2x_L250 --once --record r.jsonl", "SHA-256");
    refused("watch logs --vehicle quad.toml --once --record quad.toml", "a record of propwash watch");
    refused("watch nothing --vehicle quad.toml --once", "a folder with flight logs");
    refused("watch logs --vehicle none.toml --once", "none.toml");
    refused("watch logs --vehicle quad.toml --json -", "--once");
    fs::create_dir(logs.path("none")).unwrap();
    let out = logs.run("watch none --vehicle quad.toml --once");
    assert_eq!(out.status.code(), Some(0));
    assert!(String::from_utf8_lossy(&out.stdout).contains("no log in none"));
}

#[cfg(unix)]
#[test]
fn a_watch_takes_new_logs_and_ends_whole_on_ctrl_c() {
    let mut logs = Logs::new(1);
    logs.fly(&[], 0.0);
    let mut child = Command::new(env!("CARGO_BIN_EXE_propwash"))
        .args("watch logs --vehicle quad.toml --interval 0.1 --record r.jsonl".split(' '))
        .current_dir(logs.folder.path())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines().map_while(Result::ok);
    assert!(lines.any(|l| l.starts_with("log_0001.csv")));
    logs.fly(&[], 0.0);
    assert!(lines.any(|l| l.starts_with("log_0002.csv")));
    let id = child.id().to_string();
    assert!(Command::new("kill").args(["-INT", &id]).status().unwrap().success());
    assert!(lines.any(|l| l == "2 logs diagnosed, 0 left out"), "the table comes at the end");
    assert_eq!(child.wait().unwrap().code(), Some(0));
    assert_eq!(fs::read_to_string(logs.path("r.jsonl")).unwrap().lines().count(), 3);
}
