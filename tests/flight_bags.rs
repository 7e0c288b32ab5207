//! A flight in a bag of ROS 2 and the same flight in CSV: what is made of them is the same.

#[path = "common/bag.rs"]
mod bag;
#[path = "common/planted/mod.rs"]
mod planted;

use bag::{Bag, Compression, START_NS, Written};
use planted::Plan;
use propwash::flight::{CheckReport, FlightLog, Mapping, check};
use propwash::gap::diagnose::{Settings, diagnose};
use propwash::gap::{Diagnosis, Options, Track};
use propwash::math::quat;
use propwash::vehicle::Vehicle;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Output};

/// Columns of a CSV file, NaN where a cell is empty.
fn columns(path: &Path) -> BTreeMap<String, Vec<f64>> {
    let text = std::fs::read_to_string(path).unwrap();
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let mut out: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    for line in lines {
        for (name, cell) in names.iter().zip(line.split(',')) {
            out.entry(name.to_string()).or_default().push(cell.parse().unwrap_or(f64::NAN));
        }
    }
    out
}

/// The text of such columns.
fn rows(table: &BTreeMap<String, Vec<f64>>) -> String {
    let mut out = table.keys().cloned().collect::<Vec<_>>().join(",") + "\n";
    for row in 0..table["t"].len() {
        let cell = |c: &Vec<f64>| if c[row].is_finite() { c[row].to_string() } else { String::new() };
        out += &(table.values().map(cell).collect::<Vec<_>>().join(",") + "\n");
    }
    out
}

/// The numbers of a row, where all were measured.
fn of<const N: usize>(table: &BTreeMap<String, Vec<f64>>, names: [&str; N], row: usize) -> Option<[f64; N]> {
    let mut out = [0.0; N];
    for (value, name) in out.iter_mut().zip(names) {
        *value = *table.get(name)?.get(row).filter(|v| v.is_finite())?;
    }
    Some(out)
}

/// The flight as a bag: a pose, or an odometry where `odometry` is set; gyroscope and accelerometer; motors. Every message comes some milliseconds late,
/// as messages do.
fn bag_of(table: &BTreeMap<String, Vec<f64>>, motors: [&str; 4], odometry: bool) -> Vec<u8> {
    let mut bag = Bag::new(Written { compression: Some(Compression::Zstd), ..Written::default() });
    bag.topic("/place", if odometry { "nav_msgs/msg/Odometry" } else { "geometry_msgs/msg/PoseStamped" });
    bag.topic("/gyro", "sensor_msgs/msg/Imu");
    bag.topic("/accel", "sensor_msgs/msg/Imu");
    bag.topic("/motors", "geometry_msgs/msg/PoseStamped");
    let (p, q) = (["px", "py", "pz"], ["qx", "qy", "qz", "qw"]);
    for (row, t) in table["t"].iter().enumerate() {
        let ns = START_NS + (t * 1e9).round() as u64;
        let late = ns + 2_000_000 + (row as u64 * 7919) % 900_000;
        if let (Some(p), Some(q)) = (of(table, p, row), of(table, q, row)) {
            let message = if odometry {
                let v = of(table, ["vx", "vy", "vz"], row).unwrap();
                let w = of(table, ["wx", "wy", "wz"], row).unwrap();
                bag::odometry(ns, "base_link", p, q, quat::rotate_inverse(q, v), w)
            } else {
                bag::pose(row % 2 == 0, ns, p, q)
            };
            bag.put("/place", late, &message);
        }
        if let Some(w) = of(table, ["wx", "wy", "wz"], row) {
            bag.put("/gyro", late, &bag::imu_of(ns, Some(w), None));
        }
        if let Some(f) = of(table, ["ax", "ay", "az"], row) {
            bag.put("/accel", late, &bag::imu_of(ns, None, Some(f)));
        }
        if let Some(u) = of(table, motors, row) {
            // Any message with a stamp and four numbers will do.
            bag.put("/motors", late, &bag::pose(false, ns, [0.0; 3], u));
        }
    }
    bag.bytes()
}

/// The mapping of such a bag: what is not found by itself.
fn mapping(motors: [&str; 4]) -> String {
    let named = motors
        .iter()
        .zip(["x", "y", "z", "w"])
        .map(|(m, axis)| format!("{m} = \"/motors.pose.orientation.{axis}\"\n"));
    format!("contract_names = true\nignore = [\"/motors\"]\n[columns]\n{}", named.collect::<String>())
}

/// What the checker says of a log beside where it came from.
fn findings(report: &CheckReport) -> Vec<String> {
    let mut out: Vec<String> = report
        .channels
        .iter()
        .map(|c| format!("{} {} {:.3} Hz, held {:.4}", c.name, c.samples, c.rate_hz, c.held))
        .collect();
    out.extend(report.warnings());
    out.push(format!("{:?}", report.verdict));
    out
}

/// What a diagnosis says.
fn said_by(d: &Diagnosis) -> Vec<String> {
    let mut out = vec![d.headline.clone()];
    out.extend(d.findings.iter().map(|f| f.id.clone()));
    out
}

#[test]
fn a_hidden_effect_is_found_in_a_bag_as_in_csv() {
    let vehicle =
        Vehicle::load(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/planted_quad.toml")).unwrap();
    let flight = planted::fly(&Plan::exciting(&vehicle, &["rotor_drag"], 20.0, 3)).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let csv = folder.path().join("flight.csv");
    flight.write(&csv).unwrap();
    let mut table = columns(&csv);
    let motors = ["cmd_rotor1", "cmd_rotor2", "cmd_rotor3", "cmd_rotor4"];
    let bag = folder.path().join("flight.mcap");
    std::fs::write(&bag, bag_of(&table, motors, false)).unwrap();
    let map = Mapping::parse(&mapping(motors), Path::new("flight.toml")).unwrap();
    // The same channels in both.
    table.retain(|name, _| !name.starts_with("ref_") && name != "vbat");
    std::fs::write(&csv, rows(&table)).unwrap();
    let plain = FlightLog::load(&csv, None).unwrap();
    let read = FlightLog::load_with(&bag, Some(&map)).unwrap();
    assert_eq!(read.position_m.values, plain.position_m.values);
    assert_eq!(read.cmd_rotor_rad_s[3].values, plain.cmd_rotor_rad_s[3].values);
    let apart = read.position_m.t_s.iter().zip(&plain.position_m.t_s).map(|(a, b)| (a - b).abs());
    assert!(apart.fold(0.0, f64::max) < 2e-9, "times to the nanosecond");
    assert_eq!(findings(&check(&read)), findings(&check(&plain)));
    let verdict = |log| {
        let track = Track::new(log, &vehicle, &Options::default()).unwrap();
        diagnose(&[track], &vehicle, &Settings::default()).unwrap().verdict
    };
    let (of_bag, of_csv) = (verdict(read), verdict(plain));
    assert_eq!(said_by(&of_bag), said_by(&of_csv));
    assert!(of_bag.findings.iter().any(|f| f.id == "rotor_drag"), "{}", of_bag.headline);
}

fn propwash(folder: &Path, line: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_propwash"));
    command.args(line.split_whitespace()).current_dir(folder).env_remove("RUST_BACKTRACE").output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[test]
fn the_program_takes_bags_wherever_it_takes_logs() {
    let made = tempfile::tempdir().unwrap();
    let folder = made.path();
    let run = |line: &str| propwash(folder, line);
    let fine = |line: &str| {
        let out = run(line);
        assert!(out.status.code() < Some(2), "{line}: {}", text(&out.stderr));
        text(&out.stdout)
    };
    std::fs::copy(
        concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/planted_quad.toml"),
        folder.join("quad.toml"),
    )
    .unwrap();
    fine(
        "fly --scene room --drone quad.toml --worlds 1 --seconds 6 --fps 1 --size 2x2 --log-hz 250 --out set",
    );
    fine("log from-dataset set --out flight.csv");
    let motors = ["rotor1", "rotor2", "rotor3", "rotor4"];
    std::fs::create_dir(folder.join("bag")).unwrap();
    std::fs::write(folder.join("bag/bag_0.mcap"), bag_of(&columns(&folder.join("flight.csv")), motors, true))
        .unwrap();
    std::fs::write(folder.join("bag/metadata.yaml"), "x:\n  relative_file_paths:\n    - bag_0.mcap\n")
        .unwrap();
    std::fs::write(folder.join("bag.toml"), mapping(motors)).unwrap();
    let told = fine("log check bag");
    assert!(
        told.contains(
            "/place (nav_msgs/Odometry): position, attitude, velocity; times: stamps of its messages"
        ),
        "{told}"
    );
    assert!(!told.contains("refuse") && told.contains("250.0 Hz"), "{told}");
    fine("log convert bag --out back.csv");
    let (back, plain) = (columns(&folder.join("back.csv")), columns(&folder.join("flight.csv")));
    assert_eq!(back["t"].len(), plain["t"].len());
    for name in ["px", "qw", "vx", "vz", "wy", "az", "rotor2"] {
        let worst = back[name].iter().zip(&plain[name]).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(worst < 1e-12, "{name}: {worst}");
    }
    let found = |line: &str| -> serde_json::Value {
        let told: serde_json::Value = serde_json::from_str(&fine(line)).unwrap();
        told["headline"].clone()
    };
    assert_eq!(
        found("diagnose bag --vehicle quad.toml --json")[0],
        found("diagnose back.csv --vehicle quad.toml --json")[0]
    );
    fine("view bag --out page.html");
    assert!(folder.join("page.html").is_file());

    std::fs::write(folder.join("old.db3"), b"SQLite format 3\0 and more").unwrap();
    for (line, words) in [
        ("log check old.db3", "ros2 bag convert -i OLD -o convert.yaml"),
        ("log check set", "log from-dataset"),
        ("compare old.db3 --vehicle quad.toml", "a bag in SQLite"),
        ("view old.db3 --out other.html", "a bag in SQLite"),
    ] {
        let out = run(line);
        let said = text(&out.stderr);
        assert!(out.status.code() == Some(2) && said.contains(words), "{line}: {said}");
        assert_eq!(said.trim_end().lines().count(), 1, "{said}");
    }
}
