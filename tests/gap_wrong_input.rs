//! Wrong input to check, compare and diagnose: each gets its sentence, none a panic or a confident verdict.

use propwash::flight::FlightLog;
use propwash::gap::compare::compare;
use propwash::gap::diagnose::{Settings, diagnose};
use propwash::gap::{Options, Track};
use propwash::math::quat;
use propwash::physics::controllers::ControlMode;
use propwash::physics::effects::Command;
use propwash::physics::integrate::Integrator;
use propwash::physics::measure;
use propwash::physics::surroundings::Surroundings;
use propwash::random::{Key, Stream};
use propwash::rollout::trajectory::Reference;
use propwash::rollout::{Sim, SimOptions};
use propwash::vehicle::Vehicle;
use std::fmt::Write as _;

/// Columns of the made-up flights.
const COLUMNS: &str = "t,px,py,pz,qx,qy,qz,qw,wx,wy,wz,ax,ay,az,rotor1,rotor2,rotor3,rotor4";

/// A log of a simulated flight of `vehicle` at 200 Hz, without velocity columns; hovering where `size_m` is 0.
fn flown(vehicle: &Vehicle, seconds: f64, size_m: f64) -> Vec<Vec<f64>> {
    let options = SimOptions {
        sim_hz: 1000,
        integrator: Integrator::Rk4,
        control: ControlMode::State,
        ..SimOptions::default()
    };
    let drone = vehicle.drone("first_principles").unwrap();
    let mut sim = Sim::new(options, vec![(drone.clone(), vehicle.rates)]).unwrap();
    let place = |t: f64| {
        let size = size_m * (t / 2.0).min(1.0).powi(3);
        [size * (1.7 * t).sin(), 0.7 * size * (2.3 * t + 0.4).sin(), 1.5 + 0.3 * size * (1.1 * t).sin()]
    };
    let mut state = sim.data.state(0, 0);
    state.pos = place(0.0);
    sim.set_initial(0, 0, state).unwrap();
    sim.reset(None).unwrap();
    let mut draws: Stream = Key { seed: 5, world: 0, drone: 0, step: 0, purpose: 7 }.stream();
    let mut out = Vec::new();
    for i in 0..(seconds * 1000.0) as usize {
        let t = i as f64 * 1e-3;
        if i % 10 == 0 {
            let h = 1e-3;
            let (a, b, c) = (place(t - h), place(t), place(t + h));
            let now = Reference {
                pos_m: b,
                vel_m_s: std::array::from_fn(|k| (c[k] - a[k]) / (2.0 * h)),
                acc_m_s2: std::array::from_fn(|k| (c[k] - 2.0 * b[k] + a[k]) / (h * h)),
                yaw_rad: 0.3 * size_m * (0.6 * t).sin(),
            };
            sim.set_command(&now.command()).unwrap();
        }
        let s = sim.data.state(0, 0);
        sim.step(1).unwrap();
        if i % 5 != 0 {
            continue;
        }
        let sent: [f64; 8] = std::array::from_fn(|k| sim.data.rotor_command.get(k).copied().unwrap_or(0.0));
        let near = Surroundings { ground_distance_m: s.pos[2], ..Surroundings::calm() };
        let rate = drone.rate(&s, &Command::Rotors(sent), &near);
        let accel = measure::accelerometer(&s, &rate, drone.body.gravity_m_s2);
        let mut noisy = |v: f64, sigma: f64| v + sigma * draws.normal();
        let turn = [noisy(0.0, 2e-3), noisy(0.0, 2e-3), noisy(0.0, 2e-3)];
        let mut row = vec![t];
        row.extend(s.pos.map(|p| noisy(p, 3e-4)));
        row.extend(quat::mul(s.quat, quat::exp(turn)));
        row.extend(s.ang_vel.map(|w| noisy(w, 0.01)));
        row.extend(accel.map(|a| noisy(a, 0.1)));
        row.extend((0..4).map(|k| noisy(s.rotor_vel[k], 1.0)));
        out.push(row);
    }
    out
}

fn csv(columns: &str, rows: &[Vec<f64>]) -> String {
    let mut out = format!("{columns}\n");
    for row in rows {
        let cells: Vec<String> = row.iter().map(f64::to_string).collect();
        writeln!(out, "{}", cells.join(",")).unwrap();
    }
    out
}

fn vehicle() -> Vehicle {
    Vehicle::builtin("hb_x500").unwrap()
}

/// What check, compare and diagnose say to the logs: the refusal, or (compare's verdict, diagnose's, whether diagnose
/// names an effect without doubt).
fn ask(texts: &[(&str, &str)], vehicle: &Vehicle) -> Result<(String, String, Vec<String>), String> {
    let folder = tempfile::tempdir().unwrap();
    let mut tracks = Vec::new();
    for (name, text) in texts {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        let log = FlightLog::open(&path, None).map_err(|e| e.to_string())?.0;
        tracks.push(Track::new(log, vehicle, &Options::default()).map_err(|e| e.to_string())?);
    }
    let compared = compare(&tracks, vehicle).map_err(|e| e.to_string());
    let diagnosed = diagnose(&tracks, vehicle, &Settings::default()).map_err(|e| e.to_string());
    match (compared, diagnosed) {
        (Err(e), Err(f)) => Err(format!("{e}; {f}")),
        (Ok(c), Ok(d)) => {
            let sure = d.verdict.findings.iter().filter(|f| f.certain).map(|f| f.id.clone()).collect();
            Ok((c.verdict, d.verdict.verdict, sure))
        }
        (c, d) => Err(format!("{:?}; {:?}", c.map(|c| c.verdict), d.map(|d| d.verdict.verdict))),
    }
}

/// The logs are refused in words that hold all of `needles`.
fn refused(texts: &[(&str, &str)], vehicle: &Vehicle, needles: &[&str]) {
    match ask(texts, vehicle) {
        Ok(said) => panic!("{}: not refused: {said:?}", texts[0].0),
        Err(text) => {
            for needle in needles {
                assert!(text.contains(needle), "{}: no {needle:?} in: {text}", texts[0].0);
            }
        }
    }
}

#[test]
fn files_that_are_no_logs_are_refused_with_what_was_expected() {
    let (v, rows) = (vehicle(), flown(&vehicle(), 5.0, 1.0));
    let good = csv(COLUMNS, &rows);
    refused(&[("empty.csv", "")], &v, &["empty.csv", "an empty file"]);
    refused(&[("one.csv", &csv(COLUMNS, &rows[..1]))], &v, &["one.csv", "one row"]);
    let mut nan = rows.clone();
    nan.iter_mut().for_each(|r| r[2] = f64::NAN);
    refused(&[("nan.csv", &csv(COLUMNS, &nan))], &v, &["nan.csv", "finite number", "py"]);
    let word = good.replacen(&rows[300][9].to_string(), "fast", 1);
    refused(&[("text.csv", &word)], &v, &["text.csv", "row 302", "found `fast`"]);
    let without: Vec<Vec<f64>> = rows.iter().map(|r| r[..14].to_vec()).collect();
    let columns = COLUMNS.split(",rotor1").next().unwrap();
    refused(
        &[("undriven.csv", &csv(columns, &without))],
        &v,
        &["undriven.csv", "rotor speeds", "none of them"],
    );
}

#[test]
fn clocks_frames_and_units_that_cannot_be_right_are_refused() {
    let (v, rows) = (vehicle(), flown(&vehicle(), 8.0, 1.0));
    let changed = |f: &dyn Fn(usize, &mut Vec<f64>)| {
        let mut out = rows.clone();
        out.iter_mut().enumerate().for_each(|(i, r)| f(i, r));
        csv(COLUMNS, &out)
    };
    let back = changed(&|i, r| r[0] -= if i > 700 { 0.5 } else { 0.0 });
    refused(&[("back.csv", &back)], &v, &["back.csv", "time runs backwards at row 703"]);
    let order = changed(&|_, r| r[4..8].rotate_right(1));
    refused(&[("order.csv", &order)], &v, &["order.csv", "w, x, y, z"]);
    for (name, scale) in [("mm.csv", 1000.0), ("cm.csv", 100.0)] {
        let far = changed(&|_, r| r[1..4].iter_mut().for_each(|p| *p *= scale));
        refused(&[(name, &far)], &v, &[name, "the positions are in mm or cm"]);
    }
    let rpm = changed(&|_, r| r[14..18].iter_mut().for_each(|w| *w *= 30.0 / std::f64::consts::PI));
    refused(&[("rpm.csv", &rpm)], &v, &["rpm.csv", "rpm"]);
    let commands = COLUMNS.replace("rotor", "cmd_rotor");
    let slow = csv(&commands, &flown(&v, 5.0, 1.0));
    assert!(ask(&[("commands.csv", &slow)], &v).is_ok(), "commands in rad/s are not refused");
    let rpm = rpm.replace("rotor", "cmd_rotor");
    refused(&[("commands_rpm.csv", &rpm)], &v, &["commands_rpm.csv", "rpm"]);
}

#[test]
fn logs_of_another_vehicle_are_refused() {
    let (v, small) = (vehicle(), Vehicle::builtin("cf2x_L250").unwrap());
    let (own, other) = (csv(COLUMNS, &flown(&v, 5.0, 1.0)), csv(COLUMNS, &flown(&small, 5.0, 0.5)));
    refused(
        &[("own.csv", &own), ("other.csv", &other)],
        &v,
        &["other.csv", "whether the log is of this vehicle"],
    );
    refused(&[("own.csv", &own)], &small, &["own.csv", "whether the log is of this vehicle"]);
    // A log with the columns of six rotors.
    let six: Vec<Vec<f64>> =
        flown(&v, 5.0, 1.0).into_iter().map(|r| [r.clone(), r[14..16].to_vec()].concat()).collect();
    let six = csv(&format!("{COLUMNS},rotor5,rotor6"), &six);
    refused(&[("six.csv", &six)], &v, &["six.csv", "6 columns rotor1…", "vehicle of 4 rotors"]);
}

#[test]
fn a_vehicle_file_without_its_mass_is_refused_by_the_name_of_the_value() {
    let text = Vehicle::builtin_file("hb_x500").unwrap();
    let without: String =
        text.lines().filter(|l| !l.starts_with("mass_kg")).map(|l| format!("{l}\n")).collect();
    let error = Vehicle::from_toml("half", &without).unwrap_err().to_string();
    assert!(error.contains("mass_kg") && error.contains("half"), "{error}");
}

#[test]
fn flights_that_show_nothing_get_no_confident_verdict() {
    let v = vehicle();
    // Three seconds of hover.
    match ask(&[("hover.csv", &csv(COLUMNS, &flown(&v, 3.0, 0.0)))], &v) {
        Ok((_, said, sure)) => assert!(sure.is_empty(), "{said}"),
        Err(text) => assert!(text.contains("hover.csv"), "{text}"),
    }
    // A pose that stands still while everything else goes on.
    let mut still = flown(&v, 5.0, 1.0);
    let pose = still[0][1..8].to_vec();
    still.iter_mut().for_each(|r| r[1..8].copy_from_slice(&pose));
    refused(&[("still.csv", &csv(COLUMNS, &still))], &v, &["still.csv"]);
}
