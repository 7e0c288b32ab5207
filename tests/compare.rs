//! `propwash compare`: a model against simulated flights of which everything is known, real ones where they are at hand,
//! and files that are wrong.

#[path = "common/notes.rs"]
mod notes;

use propwash::flight::FlightLog;
use propwash::gap::compare::{AGREE, Cause, Comparison, LogComparison, Response, compare};
use propwash::gap::{Drive, GapError, Options, Track};
use propwash::math::quat;
use propwash::physics::controllers::ControlMode;
use propwash::physics::effects::Command as Sent;
use propwash::physics::integrate::Integrator;
use propwash::physics::measure;
use propwash::physics::surroundings::Surroundings;
use propwash::random::{Key, Stream};
use propwash::rollout::trajectory::Reference;
use propwash::rollout::{Sim, SimOptions};
use propwash::vehicle::Vehicle;
use serde_json::Value;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// What the sensors of a simulated flight are like.
#[derive(Clone, Copy)]
struct Sensors {
    seed: u64,
    position_m: f64,
    attitude_rad: f64,
    gyro_rad_s: f64,
    accel_m_s2: f64,
    rotor_rad_s: f64,
    /// Columns that are written.
    accel: bool,
    gyro: bool,
    rotors: bool,
    commands: bool,
    references: bool,
}

const ORDINARY: Sensors = Sensors {
    seed: 1,
    position_m: 3e-4,
    attitude_rad: 2e-3,
    gyro_rad_s: 0.01,
    accel_m_s2: 0.1,
    rotor_rad_s: 2.0,
    accel: true,
    gyro: true,
    rotors: true,
    commands: false,
    references: false,
};

/// Where the flight should be: a figure at up to some 4 m/s with a turning yaw, which starts at rest.
fn reference(t: f64) -> Reference {
    let place = |t: f64| {
        let fade = (t / 3.0).min(1.0);
        let fade = fade * fade * fade * (10.0 - 15.0 * fade + 6.0 * fade * fade);
        [fade * 2.0 * (1.5 * t).sin(), fade * 1.4 * (2.1 * t + 0.4).sin(), 1.5 + fade * 0.5 * (1.1 * t).sin()]
    };
    let h = 1e-3;
    let (a, b, c) = (place(t - h), place(t), place(t + h));
    Reference {
        pos_m: b,
        vel_m_s: std::array::from_fn(|k| (c[k] - a[k]) / (2.0 * h)),
        acc_m_s2: std::array::from_fn(|k| (c[k] - 2.0 * b[k] + a[k]) / (h * h)),
        yaw_rad: 0.8 * (0.6 * t).sin(),
    }
}

/// A log of a simulated flight of `vehicle`: poses and rotor speeds at 250 Hz, inertial sensors and commands at 500 Hz.
fn flown(vehicle: &Vehicle, seconds: f64, sensors: Sensors) -> String {
    let sim_hz = 1000;
    let options = SimOptions {
        sim_hz,
        integrator: Integrator::Rk4,
        control: ControlMode::State,
        ..SimOptions::default()
    };
    let drone = vehicle.drone("first_principles").unwrap();
    let mut sim = Sim::new(options, vec![(drone.clone(), vehicle.rates)]).unwrap();
    let mut state = sim.data.state(0, 0);
    state.pos = reference(0.0).pos_m;
    sim.set_initial(0, 0, state).unwrap();
    sim.reset(None).unwrap();
    let mut draws: Stream = Key { seed: sensors.seed, world: 0, drone: 0, step: 0, purpose: 7 }.stream();
    let mut out = String::from("t,px,py,pz,qx,qy,qz,qw");
    let add = |out: &mut String, names: &str, on: bool| {
        names.split(' ').filter(|_| on).for_each(|n| write!(out, ",{n}").unwrap());
    };
    add(&mut out, "wx wy wz", sensors.gyro);
    add(&mut out, "ax ay az", sensors.accel);
    add(&mut out, "rotor1 rotor2 rotor3 rotor4", sensors.rotors);
    add(&mut out, "cmd_rotor1 cmd_rotor2 cmd_rotor3 cmd_rotor4", sensors.commands);
    add(&mut out, "ref_x ref_y ref_z ref_vx ref_vy ref_vz ref_ax ref_ay ref_az ref_yaw", sensors.references);
    out.push('\n');
    let n = (seconds * f64::from(sim_hz)) as usize;
    for i in 0..n {
        let t = i as f64 / f64::from(sim_hz);
        let now = reference(t);
        if i % 10 == 0 {
            sim.set_command(&now.command()).unwrap();
        }
        let s = sim.data.state(0, 0);
        sim.step(1).unwrap();
        if i % 2 != 0 {
            continue;
        }
        let sent: [f64; 8] = std::array::from_fn(|k| sim.data.rotor_command.get(k).copied().unwrap_or(0.0));
        let mut row = |values: &[f64], sigma: f64, on: bool, out: &mut String| {
            for v in values {
                if on { write!(out, ",{}", v + sigma * draws.normal()) } else { write!(out, ",") }.unwrap();
            }
        };
        write!(out, "{t}").unwrap();
        let pose = i % 4 == 0;
        row(&s.pos, sensors.position_m, pose, &mut out);
        let tilt: Vec<f64> = (0..3)
            .map(|k| {
                let key = Key { seed: sensors.seed, world: 1, drone: k, step: i as u64, purpose: 8 };
                sensors.attitude_rad * key.stream().normal()
            })
            .collect();
        row(&quat::mul(s.quat, quat::exp([tilt[0], tilt[1], tilt[2]])), 0.0, pose, &mut out);
        if sensors.gyro {
            row(&s.ang_vel, sensors.gyro_rad_s, true, &mut out);
        }
        if sensors.accel {
            let near = Surroundings { ground_distance_m: s.pos[2], ..Surroundings::calm() };
            let rate = drone.rate(&s, &Sent::Rotors(sent), &near);
            let read = measure::accelerometer(&s, &rate, drone.body.gravity_m_s2);
            row(&read, sensors.accel_m_s2, true, &mut out);
        }
        if sensors.rotors {
            row(&s.rotor_vel[..4], sensors.rotor_rad_s, pose, &mut out);
        }
        if sensors.commands {
            row(&sent[..4], 0.0, true, &mut out);
        }
        if sensors.references {
            row(&now.pos_m, 0.0, pose, &mut out);
            row(&now.vel_m_s, 0.0, pose, &mut out);
            row(&now.acc_m_s2, 0.0, pose, &mut out);
            row(&[now.yaw_rad], 0.0, pose, &mut out);
        }
        out.push('\n');
    }
    out
}

/// The vehicle of the simulated flights.
fn quad() -> Vehicle {
    Vehicle::builtin("hb_x500").unwrap()
}

/// The same without any effect.
fn bare() -> Vehicle {
    let mut file = quad().file().clone();
    file.effect.clear();
    Vehicle::from_file("bare", file).unwrap()
}

/// A folder that goes away, with files in it.
struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }
    fn write(&self, name: &str, text: &str) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::write(&path, text).unwrap();
        path
    }
}

fn track(text: &str, vehicle: &Vehicle, drive: Option<Drive>) -> Track {
    let folder = Folder::new();
    let log = FlightLog::open(&folder.write("log.csv", text), None).unwrap().0;
    Track::new(log, vehicle, &Options { drive, ..Options::default() }).unwrap()
}

fn compared(text: &str, vehicle: &Vehicle, drive: Option<Drive>) -> LogComparison {
    let mut out: Comparison = compare(&[track(text, vehicle, drive)], vehicle).unwrap();
    assert!(out.pooled.is_none());
    out.logs.remove(0)
}

fn cause<'a>(list: &'a [Cause], name: &str) -> &'a Cause {
    list.iter().find(|c| c.name == name).unwrap_or_else(|| panic!("no cause {name}"))
}

fn response<'a>(list: &'a [Cause], name: &str, of: &str) -> &'a Response {
    cause(list, name).responses.iter().find(|r| r.name == of).unwrap_or_else(|| panic!("no response {of}"))
}

/// All multiples of noise, for messages.
fn multiples(c: &LogComparison) -> String {
    let horizons: Vec<_> =
        c.horizons.iter().map(|h| h.times_expected.map(|t| t.unwrap_or(f64::NAN))).collect();
    let torque = c.one_step.torque.as_ref().map(|t| t.in_sigmas);
    format!("{horizons:.2?} force {:.2?} torque {torque:.2?} {}", c.one_step.force.in_sigmas, c.verdict)
}

#[test]
fn the_model_that_flew_agrees_with_its_flight_whatever_the_sensors() {
    let vehicle = quad();
    let variants = [
        ("all sensors", ORDINARY, None),
        ("poses alone", Sensors { accel: false, gyro: false, seed: 3, ..ORDINARY }, None),
        ("coarse poses", Sensors { position_m: 3e-3, attitude_rad: 6e-3, seed: 4, ..ORDINARY }, None),
    ];
    for (name, sensors, drive) in variants {
        let c = compared(&flown(&vehicle, 24.0, sensors), &vehicle, drive);
        assert!(c.agrees && c.worst_times_noise <= AGREE, "{name}: {}", multiples(&c));
        // The figure of noise is neither far too small nor far too large: errors are of its size.
        for h in &c.horizons {
            assert!(h.error.n > 100, "{name}: {h:?}");
            for times in h.times_expected.iter().flatten() {
                assert!((0.4..AGREE).contains(times), "{name}: {}", multiples(&c));
            }
        }
        assert!(c.findings.is_empty(), "{name}: {:?}", c.findings);
        assert_eq!(c.one_step.force_from, if sensors.accel { "accelerometer" } else { "poses" });
        assert_eq!(c.one_step.torque_from, if sensors.gyro { "gyroscope" } else { "attitudes" });
        assert!(c.verdict.contains("agrees"), "{}", c.verdict);
    }
}

/// The replay takes the mean of commands over its ticks of 2.5 ms. Commands that jump every 2 ms then leave some
/// 0.1 rad/s between the rotors, which shows after half a second but not in the first 0.2 s.
#[test]
fn commands_drive_the_model_that_flew_along_its_flight() {
    let vehicle = quad();
    let sensors = Sensors { commands: true, seed: 2, ..ORDINARY };
    let c = compared(&flown(&vehicle, 24.0, sensors), &vehicle, Some(Drive::RotorCommands));
    assert_eq!(c.log.drive, "rotor commands");
    for h in &c.horizons[..2] {
        assert!(h.times_expected.iter().flatten().all(|t| (0.4..AGREE).contains(t)), "{}", multiples(&c));
    }
    assert!(c.horizons[3].error.position_m < 0.05, "{:?}", c.horizons[3]);
    let torque = c.one_step.torque.as_ref().unwrap();
    let sigmas = c.one_step.force.in_sigmas.iter().chain(&torque.in_sigmas);
    assert!(sigmas.into_iter().all(|s| *s < AGREE), "{}", multiples(&c));
}

#[test]
fn a_hidden_drag_shows_as_a_force_that_falls_with_speed_by_its_coefficient() {
    let vehicle = quad();
    let drag = {
        let drone = vehicle.drone("first_principles").unwrap();
        let mut value = f64::NAN;
        drone.clone().visit(&mut |name, v| {
            if name == "effect.linear_drag.drag_n_s_per_m.0.0" {
                value = *v;
            }
        });
        value
    };
    assert!(drag > 0.01, "{drag}");
    for (accel, within) in [(true, 0.05), (false, 0.10)] {
        let c = compared(&flown(&vehicle, 40.0, Sensors { accel, ..ORDINARY }), &bare(), None);
        assert!(!c.agrees && c.verdict.contains("departs"), "{}", c.verdict);
        for (of, by) in [("force_body_x", "velocity_forward"), ("force_body_y", "velocity_left")] {
            let r = response(&c.causes, by, of);
            assert!((r.slope / -drag - 1.0).abs() < within, "{by} {accel}: {r:?} {drag}");
            assert!(r.correlation < -0.95 && r.significance > 10.0 && r.slope_sigma < 0.1 * drag, "{r:?}");
        }
        let along = response(&c.causes, "speed", "force_along_velocity");
        assert!(along.slope < 0.0 && along.share > 0.5, "{along:?}");
        let yaw = response(&c.causes, "yaw_rate", "force_body_z");
        assert!(yaw.share < 0.3, "{yaw:?}");
        assert!(c.findings[0].contains("residual force"), "{:?}", c.findings);
        // The force itself, instant by instant: that of the drag at its speed.
        let series = &c.one_step.series;
        assert_eq!(series.t_s.len(), series.force_world_n.len());
        // What is missing grows with the horizon, and the worst second is a fast one.
        assert!(c.horizons.windows(2).all(|w| w[1].error.position_m > w[0].error.position_m));
        let speed = |s: &propwash::gap::compare::Segment| {
            s.context.iter().find(|c| c.0 == "speed").map(|c| c.1).unwrap()
        };
        let speeds = &cause(&c.causes, "speed").values;
        assert!(speed(&c.worst[0]) > speeds[speeds.len() / 2], "{:?}", c.worst[0]);
        assert_eq!(c.worst.len(), 5);
    }
}

#[test]
fn a_whole_flight_along_the_references_is_that_of_the_log() {
    let vehicle = quad();
    let log = flown(&vehicle, 20.0, Sensors { references: true, ..ORDINARY });
    let c = compared(&log, &vehicle, None);
    let same = c.closed_loop.unwrap();
    assert!(same.duration_s > 19.0 && same.position_m < 0.05, "{same:?}");
    assert!((same.tracking_model_m / same.tracking_measured_m - 1.0).abs() < 0.1, "{same:?}");
    // 15 % more mass: the model flies lower than the measured flight.
    let mut file = vehicle.file().clone();
    file.body.mass_kg *= 1.15;
    let heavy = Vehicle::from_file("heavy", file).unwrap();
    let other = compared(&log, &heavy, None).closed_loop.unwrap();
    assert!(other.position_m > 3.0 * same.position_m, "{other:?} {same:?}");
    let c = compared(&flown(&vehicle, 10.0, ORDINARY), &vehicle, None);
    assert!(c.closed_loop.is_none() && c.closed_loop_missing.unwrap().contains("references"));
}

#[test]
fn a_wrong_inertia_shows_in_the_torque_and_not_in_the_force() {
    let vehicle = quad();
    let mut file = vehicle.file().clone();
    file.body.inertia_kg_m2[0][0] *= 1.4;
    let other = Vehicle::from_file("other", file).unwrap();
    let c = compared(&flown(&vehicle, 24.0, ORDINARY), &other, None);
    let torque = c.one_step.torque.as_ref().unwrap();
    assert!(!c.agrees && torque.in_sigmas[0] > 1.5 * torque.in_sigmas[1], "{}", multiples(&c));
    assert!(c.one_step.force.in_sigmas.iter().all(|s| *s < AGREE), "{}", multiples(&c));
}

#[test]
fn several_logs_are_pooled_and_those_of_other_vehicles_refused() {
    let vehicle = quad();
    let texts = [1, 2].map(|seed| flown(&vehicle, 12.0, Sensors { seed, ..ORDINARY }));
    let model = bare();
    let tracks: Vec<Track> = texts.iter().map(|t| track(t, &model, None)).collect();
    let c = compare(&tracks, &model).unwrap();
    let pooled = c.pooled.unwrap();
    for (i, h) in pooled.horizons.iter().enumerate() {
        let each: Vec<_> = c.logs.iter().map(|l| &l.horizons[i].error).collect();
        assert_eq!(h.n, each.iter().map(|e| e.n).sum::<usize>());
        let (low, high) =
            each.iter().fold((f64::MAX, 0.0f64), |m, e| (m.0.min(e.position_m), m.1.max(e.position_m)));
        assert!((low..=high).contains(&h.position_m));
    }
    let one = response(&c.logs[0].causes, "velocity_forward", "force_body_x");
    let both = response(&pooled.causes, "velocity_forward", "force_body_x");
    assert!(both.slope_sigma < one.slope_sigma && (both.slope / one.slope - 1.0).abs() < 0.2);
    assert!(pooled.causes.iter().all(|c| c.name != "time"));

    let mut fast = tracks[1].clone();
    for c in &mut fast.log.rotor_speed_rad_s {
        c.values.iter_mut().for_each(|v| v[0] *= 1.5);
    }
    let error = compare(&[tracks[0].clone(), fast], &model).unwrap_err();
    assert!(matches!(error, GapError::DifferentVehicles { .. }), "{error}");
    assert!(error.to_string().contains("median rotor speeds"), "{error}");
    let mut six = tracks[1].clone();
    six.log.rotor_speed_rad_s.extend(tracks[0].log.rotor_speed_rad_s[..2].to_vec());
    let error = compare(&[tracks[0].clone(), six], &model).unwrap_err().to_string();
    assert!(error.contains("4 and 6 rotors"), "{error}");
    assert!(matches!(compare(&[], &model), Err(GapError::Log { .. })));
}

fn propwash(words: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_propwash")).args(words).output().unwrap()
}

/// A run that must fail with one line that holds all `needles`.
fn refused(words: &[&str], needles: &[&str]) {
    let out = propwash(words);
    let message = String::from_utf8(out.stderr).unwrap();
    let what = format!("{words:?} said: {message}");
    assert_eq!(out.status.code(), Some(2), "{what}");
    assert!(out.stdout.is_empty(), "{what}");
    assert!(message.starts_with("error: ") && message.trim_end().lines().count() == 1, "{what}");
    for needle in needles {
        assert!(message.contains(needle), "no {needle:?}; {what}");
    }
    assert!(!message.contains("panicked"), "{what}");
}

#[test]
fn the_command_tells_in_tables_and_json_and_exits_by_what_it_found() {
    let folder = Folder::new();
    let vehicle = quad();
    let good = folder.write("good.csv", &flown(&vehicle, 12.0, ORDINARY));
    let good = good.to_str().unwrap();
    let bare_file = folder.write("bare.toml", bare().to_toml());
    let bare_file = bare_file.to_str().unwrap();
    let out = propwash(&["compare", good, "--vehicle", "hb_x500"]);
    let text = String::from_utf8(out.stdout).unwrap();
    assert_eq!(out.status.code(), Some(0), "{text}");
    for words in
        ["good.csv", "measured rotor speeds", "agrees with the log", "worst segments", "accelerometer"]
    {
        assert!(text.contains(words), "no {words:?}: {text}");
    }
    let out = propwash(&["compare", good, "--vehicle", bare_file]);
    let text = String::from_utf8(out.stdout).unwrap();
    assert_eq!(out.status.code(), Some(1), "{text}");
    assert!(text.contains("departs from the log") && text.contains("what the residuals go with"), "{text}");
    // A mean that is left stands beside what varies and is explained; residuals have three digits.
    assert!(text.contains("% of what varies"), "{text}");
    let residual = text.lines().find(|line| line.trim_start().starts_with("force  x")).unwrap();
    let rms = residual.split_whitespace().nth(3).unwrap();
    assert!(
        rms.chars().filter(char::is_ascii_digit).count() <= 4 && rms.parse::<f64>().unwrap() > 0.0,
        "{residual}"
    );

    let out = propwash(&["compare", good, "--vehicle", bare_file, "--json", "--ground-z", "-0.1"]);
    assert_eq!(out.status.code(), Some(1));
    let json: Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!(json["agrees"], false);
    assert_eq!(json["logs"][0]["horizons"].as_array().unwrap().len(), 4);
    assert!(json["logs"][0]["one_step"]["series"]["t_s"].as_array().unwrap().len() > 200);
    assert!(json["logs"][0]["causes"].as_array().unwrap().len() > 5);
    // No number that is none: JSON would have null in the place of a plain figure.
    assert!(json["logs"][0]["horizons"][3]["error"]["position_m"].as_f64().unwrap() > 0.0);
}

#[test]
fn wrong_input_gets_a_sentence_through_the_command_line() {
    let folder = Folder::new();
    let text = flown(&quad(), 6.0, ORDINARY);
    let lines: Vec<&str> = text.lines().collect();
    let check = |name: &str, text: &str, needles: &[&str]| {
        let path = folder.write(name, text);
        refused(&["compare", path.to_str().unwrap(), "--vehicle", "hb_x500"], needles);
    };
    check("empty.csv", "", &["empty.csv", "an empty file"]);
    check("one.csv", &lines[..2].join("\n"), &["one.csv", "one row"]);
    let mut bad = lines.clone();
    let nan = lines[201].replacen(lines[201].split(',').nth(8).unwrap(), "nan", 1);
    bad[201] = &nan;
    check("nan.csv", &bad.join("\n"), &["nan.csv", "row 202", "finite number"]);
    let word = lines[201].replacen(lines[201].split(',').nth(8).unwrap(), "fast", 1);
    bad[201] = &word;
    check("text.csv", &bad.join("\n"), &["text.csv", "row 202", "found `fast`"]);
    check("short.csv", &lines[..400].join("\n"), &["short.csv"]);

    // Faults that the checker knows: backward time, foreign units, wrong quaternion order.
    let change = |f: &dyn Fn(usize, &mut Vec<String>)| {
        let mut out = vec![lines[0].to_string()];
        for (i, line) in lines[1..].iter().enumerate() {
            let mut cells: Vec<String> = line.split(',').map(String::from).collect();
            f(i, &mut cells);
            out.push(cells.join(","));
        }
        out.join("\n")
    };
    let back = change(&|i, c| {
        if i > 1500 {
            c[0] = (c[0].parse::<f64>().unwrap() - 0.5).to_string();
        }
    });
    check("clock.csv", &back, &["clock.csv", "cannot be right", "row 1503"]);
    let scaled = |from: usize, factor: f64| {
        change(&move |_, c| {
            for k in from..from + 3 {
                if let Ok(v) = c[k].parse::<f64>() {
                    c[k] = (v * factor).to_string();
                }
            }
        })
    };
    check("degrees.csv", &scaled(8, 57.29578), &["degrees.csv", "deg/s"]);
    check("g.csv", &scaled(11, 1.0 / 9.81), &["g.csv", "multiples of g"]);
    let turned = change(&|_, c| c[4..8].rotate_right(1));
    check("order.csv", &turned, &["order.csv", "w, x, y, z"]);

    let good = folder.write("good.csv", &text);
    let good = good.to_str().unwrap();
    refused(&["compare", good, "--vehicle", "no_such"], &["no_such"]);
    refused(&["compare", good, good, "--vehicle", "hb_x500"], &["each log once"]);
    refused(
        &["compare", good, "--vehicle", "hb_x500", "--drive", "rotor-commands"],
        &["rotor commands", "found measured rotor speeds"],
    );
    refused(&["compare", good, "--vehicle", "hb_x500", "--neighbour", "bob"], &["bob", "tracked object"]);
    refused(
        &["compare", good, "--vehicle", "hb_x500", "--ceiling-z", "-1"],
        &["--ceiling-z", "above the ground"],
    );
    refused(&["compare", good, "--vehicle", "hb_x500", "--ground-z", "nan"], &["finite"]);
    refused(&["compare", good], &["--vehicle"]);
}

/// A folder of real logs beside the repository.
fn real(name: &str) -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data").join(name);
    if !folder.is_dir() {
        notes::tell(&format!("skipped: {} is not there", folder.display()));
        return None;
    }
    Some(folder)
}

/// A vehicle of known mass whose rotors and inertia play no part when thrust and attitude are inputs.
fn of_mass(name: &str, mass_kg: f64) -> Vehicle {
    let mut text = format!(
        "shell = \"cf2x\"\n[body]\nmass_kg = {mass_kg}\n\
         inertia_kg_m2 = [[0.0049, 0.0, 0.0], [0.0, 0.0049, 0.0], [0.0, 0.0, 0.0069]]\n\
         gravity_m_s2 = [0.0, 0.0, -9.81]\n\
         [rotor_default]\nthrust_curve_n_per_rpm = [0.0, 0.0, 2.03e-8]\ntorque_per_thrust_m = 0.014\n\
         time_constant_up_s = 0.03\ntime_constant_down_s = 0.03\ninertia_kg_m2 = 0.0\nradius_m = 0.09\n"
    );
    for (x, y, spin) in [(0.13, -0.13, -1), (-0.13, -0.13, 1), (-0.13, 0.13, -1), (0.13, 0.13, 1)] {
        write!(text, "[[rotor]]\nposition_m = [{x}, {y}, 0.0]\nspin = {spin}\n").unwrap();
    }
    text.push_str(
        "[controller.direct]\nthrust_min_n = 0.1\nthrust_max_n = 8.0\n\
         [rates]\nstate_hz = 100\nattitude_hz = 500\nbody_rate_hz = 500\nforce_torque_hz = 500\n",
    );
    Vehicle::from_toml(name, &text).unwrap()
}

#[test]
fn blackbird_lacks_a_drag_that_falls_with_velocity() {
    let Some(folder) = real("blackbird") else { return };
    let vehicle = of_mass("blackbird", 0.915);
    let log = FlightLog::open(&folder.join("clover_5mps_test.csv"), None).unwrap().0;
    let track = Track::new(log, &vehicle, &Options::default()).unwrap();
    assert_eq!(track.drive, Drive::Thrust);
    let c = compare(&[track], &vehicle).unwrap().logs.remove(0);
    assert!(!c.agrees, "{}", c.verdict);
    // Thrust along body z explains nothing of the lateral force; drag of 0.32 and 0.40 1/s (data's README) is missing.
    for (of, by, k, known) in
        [("force_body_x", "velocity_forward", 0, 0.32), ("force_body_y", "velocity_left", 1, 0.40)]
    {
        let r = response(&c.causes, by, of);
        let drag = -r.slope / 0.915;
        assert!(r.correlation < -0.95 && (drag / known - 1.0).abs() < 0.15, "{of}: {drag} {r:?}");
        assert!(c.one_step.force.explained[k].unwrap() < 0.1, "{:?}", c.one_step.force);
        notes::tell(&format!(
            "blackbird: missing {of} against {by}: {drag:.3} 1/s (known {known}), correlation {:.3}",
            r.correlation
        ));
    }
    // Without drag the position after 1 s is 0.613 m off by the README's roll-outs.
    let after = &c.horizons[3].error;
    assert!((0.4..0.8).contains(&after.position_m), "{after:?}");
    notes::tell(&format!("blackbird: {:.3} m off after 1 s without drag (README 0.613)", after.position_m));
    assert!(c.one_step.torque.is_none() && c.horizons[3].times_expected[2].is_none());
}

#[test]
fn crazyswarm_flights_are_compared_and_pooled() {
    let Some(folder) = real("crazyswarm_payload") else { return };
    let vehicle = of_mass("crazyflie", 0.0369);
    let tracks: Vec<Track> = (201..=205)
        .map(|i| {
            let log = FlightLog::open(&folder.join(format!("log{i}.csv")), None).unwrap().0;
            Track::new(log, &vehicle, &Options { drive: Some(Drive::Thrust), ..Options::default() }).unwrap()
        })
        .collect();
    let c = compare(&tracks, &vehicle).unwrap();
    assert!(!c.agrees && c.logs.len() == 5, "{}", c.verdict);
    let pooled = c.pooled.unwrap();
    assert!(pooled.torque_rms_n_m.is_none() && pooled.horizons[0].n > 300);
    for (of, by) in [("force_body_x", "velocity_forward"), ("force_body_y", "velocity_left")] {
        let r = response(&pooled.causes, by, of);
        assert!(r.slope < 0.0, "{r:?}");
        notes::tell(&format!(
            "crazyswarm: missing {of} against {by}: {:.3} 1/s, correlation {:.3}",
            -r.slope / 0.0369,
            r.correlation
        ));
    }
}
