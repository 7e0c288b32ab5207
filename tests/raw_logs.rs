//! The commands of `docs/raw_logs.md`, run one by one on raw logs of two flights each: from a log and no vehicle file to a vehicle with
//! a smaller error on the other flight. The flights are those of the independent simulator of `tests/common/planted`.

#[path = "common/planted/mod.rs"]
mod planted;
#[path = "common/ulog.rs"]
mod ulog;

use planted::{Build, Plan};
use propwash::flight::{Channel, FlightLog};
use propwash::physics::effects::AnyEffect;
use propwash::physics::throttle::Params;
use propwash::vehicle::Vehicle;
use std::fmt::Write as _;
use std::path::Path;
use std::process::{Command, Output};

/// The page, and its blocks of a language.
fn blocks(language: &str) -> Vec<String> {
    let page = include_str!("../docs/raw_logs.md");
    let fence = format!("```{language}\n");
    page.split(&fence).skip(1).map(|rest| rest.split("```").next().unwrap().to_string()).collect()
}

fn run(folder: &Path, line: &str, more: &[&str]) -> Output {
    let words: Vec<&str> = line.split_whitespace().collect();
    assert_eq!(words[0], "propwash", "{line}");
    Command::new(env!("CARGO_BIN_EXE_propwash"))
        .args(&words[1..])
        .args(more)
        .current_dir(folder)
        .output()
        .unwrap()
}

/// Runs a block; errors of its two comparisons after 0.5 s: position, m.
fn walked(folder: &Path, block: &str) -> Vec<f64> {
    let mut errors = Vec::new();
    for line in block.lines() {
        let compares = line.starts_with("propwash compare");
        let out = run(folder, line, if compares { &["--json"] } else { &[] });
        let (text, said) = (String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr));
        // A comparison that finds something ends with 1, and so does a check with warnings.
        assert!(matches!(out.status.code(), Some(0 | 1)), "{line}: {said}");
        if compares {
            let told: serde_json::Value = serde_json::from_str(&text).unwrap();
            let horizons = told["logs"][0]["horizons"].as_array().unwrap().clone();
            errors.push(horizons[2]["error"]["position_m"].as_f64().unwrap());
        } else {
            println!("$ {line}\n{text}");
        }
    }
    println!("position after 0.5 s of the other flight: {errors:?} m");
    errors
}

/// Motors of the flights: throttle × voltage in hover is 45 % of the battery.
fn motor(vehicle: &Vehicle, full_v: f64) -> Params<f64> {
    let hover = vehicle.drone("first_principles").unwrap().hover_rotor_vel()[0];
    let drive_v = 0.45 * full_v;
    Params {
        offset_v: 0.1 * drive_v,
        back_emf_v_s_per_rad: 0.6 * drive_v / hover,
        load_v_s2_per_rad2: 0.3 * drive_v / (hover * hover),
    }
}

/// A flight as its sensors gave it, with throttles in place of commanded speeds; and its drag along x, N·s/m.
fn flown(name: &str, number: u64) -> (FlightLog, f64) {
    let path = format!("{}/tests/data/planted_{name}.toml", env!("CARGO_MANIFEST_DIR"));
    let vehicle = Vehicle::load(path).unwrap();
    let mut plan = Plan::exciting(&vehicle, &["linear_drag"], 40.0, 21);
    plan.build = Build::usual(0.5);
    plan.flight = number;
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("flight.csv");
    let flight = planted::fly(&plan).unwrap();
    flight.write(&file).unwrap();
    let drag = flight.truth.all["linear_drag"]["drag_n_s_per_m.0.0"];
    let mut log = FlightLog::load(&file, None).unwrap();
    let (first, last) = (log.vbat_v.values[0][0], log.vbat_v.values.last().unwrap()[0]);
    let seconds = *log.vbat_v.t_s.last().unwrap();
    let motor = motor(&vehicle, first);
    let throttle = |c: &Channel<1>| {
        let each = c.t_s.iter().zip(&c.values);
        let all = each.map(|(t, v)| [motor.throttle(v[0], first + (last - first) * t / seconds)]);
        Channel::new(c.t_s.clone(), all.collect())
    };
    log.cmd_u = std::mem::take(&mut log.cmd_rotor_rad_s).iter().map(throttle).collect();
    (log, drag)
}

/// Whether a vehicle file has this drag along x, within a twentieth.
fn has_drag(file: &Path, truth: f64) {
    let drone = Vehicle::load(file).unwrap().drone("first_principles").unwrap();
    let drag = drone.effects.iter().find_map(|e| match e {
        AnyEffect::LinearDrag(p) => Some(p.drag_n_s_per_m[0][0]),
        _ => None,
    });
    let drag = drag.expect("a drag in the file");
    println!("drag along x {drag:.5} N·s/m, true {truth:.5}");
    assert!((drag / truth - 1.0).abs() < 0.05, "{drag} of {truth} N·s/m");
}

/// Values of channels by time, µs: what each gives at it.
fn by_time<T>(channels: Vec<(usize, Vec<(f64, T)>)>) -> std::collections::BTreeMap<u64, Vec<(usize, T)>> {
    let mut out = std::collections::BTreeMap::<u64, Vec<(usize, T)>>::new();
    for (id, values) in channels {
        for (t, value) in values {
            out.entry(5_000_000 + (t * 1e6).round() as u64).or_default().push((id, value));
        }
    }
    out
}

fn values<const N: usize>(c: &Channel<N>, f: impl Fn([f64; N]) -> Vec<f64>) -> Vec<(f64, Vec<f64>)> {
    c.t_s.iter().zip(&c.values).map(|(t, v)| (*t, f(*v))).collect()
}

/// A flight as PX4 writes it: north-east-down, and its order of motors.
fn ulog_of(log: &FlightLog) -> Vec<u8> {
    let down = |v: [f64; 3]| vec![v[0], -v[1], -v[2]];
    let nan = f64::NAN;
    let motors = |k: usize| {
        let at = |r: usize| log.cmd_u[r].values[k][0];
        // Front right, rear left, front left, rear right; ours go round clockwise from the front right.
        (log.cmd_u[0].t_s[k], vec![at(0), at(2), at(3), at(1), nan, nan])
    };
    let rows = by_time(vec![
        (0, values(&log.position_m, |p| [down(p), vec![nan; 3]].concat())),
        (1, values(&log.attitude, |q| vec![q[3], q[0], -q[1], -q[2]])),
        (2, values(&log.angular_velocity_rad_s, down)),
        (3, values(&log.specific_force_m_s2, down)),
        (4, (0..log.cmd_u[0].len()).map(motors).collect()),
        (5, values(&log.vbat_v, |v| vec![v[0]])),
    ]);
    ulog::file(rows.into_iter().map(|(t, given)| {
        let mut topics: [Vec<f64>; 6] = Default::default();
        given.into_iter().for_each(|(id, v)| topics[id] = v);
        (t, topics)
    }))
}

/// A flight with the names and units of a Crazyflie's micro SD card.
fn crazyflie_of(log: &FlightLog) -> String {
    const NAMES: [&[&str]; 6] = [
        &["stateEstimate.x", "stateEstimate.y", "stateEstimate.z"],
        &["stateEstimate.qx", "stateEstimate.qy", "stateEstimate.qz", "stateEstimate.qw"],
        &["gyro.x", "gyro.y", "gyro.z"],
        &["acc.x", "acc.y", "acc.z"],
        &["motor.m1", "motor.m2", "motor.m3", "motor.m4"],
        &["pm.vbat"],
    ];
    let motors = |k: usize| {
        let at = |r: usize| (log.cmd_u[r].values[k][0] * 65535.0).round();
        (log.cmd_u[0].t_s[k], (0..4).map(at).collect())
    };
    let rows = by_time(vec![
        (0, values(&log.position_m, |p| p.to_vec())),
        (1, values(&log.attitude, |q| q.to_vec())),
        (2, values(&log.angular_velocity_rad_s, |w| w.map(f64::to_degrees).to_vec())),
        (3, values(&log.specific_force_m_s2, |a| a.map(|a| a / 9.80665).to_vec())),
        (4, (0..log.cmd_u[0].len()).map(motors).collect()),
        (5, values(&log.vbat_v, |v| vec![v[0]])),
    ]);
    let mut out = format!("timestamp,{}\n", NAMES.concat().join(","));
    for (t, given) in rows {
        write!(out, "{}", t as f64 * 1e-3).unwrap();
        for (id, names) in NAMES.iter().enumerate() {
            let cells = given.iter().find(|(of, _)| *of == id);
            for k in 0..names.len() {
                match cells {
                    Some((_, v)) => write!(out, ",{}", v[k]).unwrap(),
                    None => out.push(','),
                }
            }
        }
        out.push('\n');
    }
    out
}

#[test]
fn px4_logs_and_no_vehicle_file_end_in_a_vehicle_with_a_smaller_error() {
    let folder = tempfile::tempdir().unwrap();
    let mut truth = 0.0;
    for (number, name) in [(0, "first.ulg"), (1, "second.ulg")] {
        let (log, drag) = flown("kilo", number);
        std::fs::write(folder.path().join(name), ulog_of(&log)).unwrap();
        truth = drag;
    }
    let errors = walked(folder.path(), &blocks("sh")[0]);
    assert!(errors.len() == 2 && errors[1] < 0.5 * errors[0], "{errors:?}");
    has_drag(&folder.path().join("better.toml"), truth);
}

#[test]
fn a_crazyflies_card_and_no_vehicle_file_end_in_a_vehicle_with_a_smaller_error() {
    let folder = tempfile::tempdir().unwrap();
    let mut truth = 0.0;
    for (number, name) in [(0, "usd00.csv"), (1, "usd01.csv")] {
        let (log, drag) = flown("micro", number);
        std::fs::write(folder.path().join(name), crazyflie_of(&log)).unwrap();
        truth = drag;
    }
    std::fs::write(folder.path().join("crazyflie.toml"), &blocks("toml")[0]).unwrap();
    let errors = walked(folder.path(), &blocks("sh")[1]);
    assert!(errors.len() == 2 && errors[1] < 0.5 * errors[0], "{errors:?}");
    has_drag(&folder.path().join("cf_better.toml"), truth);
}
