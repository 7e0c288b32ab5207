//! Motors by throttle and voltage: fitted to flights, in the vehicle file, and driving its model; and a battery that is hidden.
//! The flights are those of the independent simulator of `tests/common/planted`; their commands are turned into throttles by the
//! law of a motor with known numbers.

#[path = "common/planted/mod.rs"]
mod planted;

use planted::{Build, Plan, Sensors};
use propwash::flight::{Channel, FlightLog};
use propwash::gap::accept::{Source, today_utc};
use propwash::gap::compare::compare;
use propwash::gap::complete::{Completion, Entry};
use propwash::gap::diagnose::{Settings, diagnose};
use propwash::gap::throttle::{self, ThrottleFit};
use propwash::gap::{Drive, Options, Track};
use propwash::physics::throttle::Params;
use propwash::vehicle::Vehicle;
use propwash::vehicle::schema::ThrottleOf;
use std::path::Path;
use std::process::{Command, Output};

/// The motors of the flights.
fn motor(hover_rad_s: f64, hover_v: f64) -> Params<f64> {
    Params {
        offset_v: 0.15 * hover_v,
        back_emf_v_s_per_rad: 0.55 * hover_v / hover_rad_s,
        load_v_s2_per_rad2: 0.3 * hover_v / (hover_rad_s * hover_rad_s),
    }
}

/// A vehicle of the tests: 1 kg, four rotors.
fn vehicle() -> Vehicle {
    Vehicle::load(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/planted_kilo.toml")).unwrap()
}

fn hover(vehicle: &Vehicle) -> f64 {
    vehicle.drone("first_principles").unwrap().hover_rotor_vel()[0]
}

/// A flight with commanded and measured rotor speeds.
fn flown(vehicle: &Vehicle, hidden: &[&'static str], seed: u64, number: u64) -> FlightLog {
    let mut plan = Plan::exciting(vehicle, hidden, 40.0, seed);
    plan.build = Build::usual(0.5);
    plan.sensors = Sensors { rotors: true, ..Sensors::default() };
    plan.flight = number;
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join(format!("flight_{number}.csv"));
    planted::fly(&plan).unwrap().write(&file).unwrap();
    FlightLog::load(&file, None).unwrap()
}

/// The battery without the noise of its sensor: a line through what was logged.
fn battery(log: &FlightLog) -> impl Fn(f64) -> f64 + use<> {
    let (t, v) = (&log.vbat_v.t_s, log.vbat_v.component(0));
    let n = t.len() as f64;
    let (mean_t, mean_v) = (t.iter().sum::<f64>() / n, v.iter().sum::<f64>() / n);
    let (mut up, mut down) = (0.0, 0.0);
    for (t, v) in t.iter().zip(&v) {
        up += (t - mean_t) * (v - mean_v);
        down += (t - mean_t).powi(2);
    }
    move |at| mean_v + up / down * (at - mean_t)
}

/// Turns commanded rotor speeds into throttles; `volts` is what they are a share of.
fn throttled(mut log: FlightLog, motor: &Params<f64>, volts: impl Fn(f64) -> f64) -> FlightLog {
    log.cmd_u = std::mem::take(&mut log.cmd_rotor_rad_s)
        .iter()
        .map(|c| {
            let all = c.t_s.iter().zip(&c.values).map(|(t, v)| [motor.throttle(v[0], volts(*t))]);
            Channel::new(c.t_s.clone(), all.collect())
        })
        .collect();
    log
}

fn without_speeds(mut log: FlightLog) -> FlightLog {
    log.rotor_speed_rad_s.clear();
    log
}

/// Largest relative error of the fitted speeds over the throttles of a flight.
fn worst(fit: &ThrottleFit, truth: &Params<f64>, hover_rad_s: f64, volts: f64) -> f64 {
    let t = &fit.table;
    let fitted = Params {
        offset_v: t.offset_v,
        back_emf_v_s_per_rad: t.back_emf_v_s_per_rad,
        load_v_s2_per_rad2: t.load_v_s2_per_rad2,
    };
    let fitted_v = if t.voltage == ThrottleOf::Battery { volts } else { t.nominal_v };
    [0.9, 1.0, 1.1]
        .map(|share| {
            let speed = share * hover_rad_s;
            (fitted.speed(truth.throttle(speed, volts), fitted_v) / speed - 1.0).abs()
        })
        .into_iter()
        .fold(0.0, f64::max)
}

/// The vehicle with the fitted motors.
fn with_motors(vehicle: &Vehicle, fit: &ThrottleFit) -> Vehicle {
    let text = fit.write_into(vehicle.to_toml(), "motors", vehicle).unwrap();
    Vehicle::from_toml("motors", &text).unwrap()
}

#[test]
fn motors_are_fitted_to_speeds_and_their_throttles_then_find_a_hidden_drag() {
    let vehicle = vehicle();
    let log = flown(&vehicle, &[], 7, 0);
    let volts = battery(&log);
    let (hover, full) = (hover(&vehicle), volts(0.0));
    let truth = motor(hover, 0.45 * full);
    let good = throttled(log.clone(), &truth, &volts);
    let fit = throttle::fit(&[good.clone(), without_speeds(good.clone())], &[], &vehicle).unwrap();
    println!("{fit}");
    // A log without speeds tells nothing beside one with them: it is said, and is no source.
    assert!(fit.notes.iter().any(|n| n.contains("no rotor speeds")), "{:?}", fit.notes);
    assert_eq!(fit.log_sha256, std::slice::from_ref(&good.sha256));
    assert!(fit.by_speeds && fit.table.voltage == ThrottleOf::Battery);
    assert!(fit.unseen.share > 0.98, "{:?}", fit.unseen);
    let off = worst(&fit, &truth, hover, full);
    assert!(off < 0.005, "speeds are off by {off}");
    // Rotors follow as the file says within its tolerances, and nothing is late.
    let drone = vehicle.drone("first_principles").unwrap();
    let rotor = &drone.airframe.rotors[0];
    let lag_s = |c: [f64; 2]| 1.0 / (c[0] + 2.0 * c[1] * hover);
    for (lag, filed) in fit.lag_s.unwrap().iter().zip([rotor.spin_up, rotor.spin_down].map(lag_s)) {
        assert!((lag.value / filed - 1.0).abs() < 0.15, "{lag:?} of {filed}");
    }
    assert!(fit.delay_s.value < 0.003, "{:?}", fit.delay_s);

    // The file's text keeps what it was, and takes the motors up.
    let motors = with_motors(&vehicle, &fit);
    assert_eq!(motors.throttle().unwrap().offset_v, fit.table.offset_v);
    assert!(motors.to_toml().contains("time_constant_up_s"));
    // Another flight of the same vehicle, of which only throttles are known, with a drag that the file lacks.
    let log = flown(&vehicle, &["linear_drag"], 7, 1);
    let volts = battery(&log);
    let log = without_speeds(throttled(log, &truth, &volts));
    let refused = Track::new(log.clone(), &vehicle, &Options::default()).unwrap_err().to_string();
    for words in ["no [throttle]", "propwash vehicle throttle"] {
        assert!(refused.contains(words), "{refused}");
    }
    let track = Track::new(log.clone(), &motors, &Options::default()).unwrap();
    assert_eq!(track.drive, Drive::RotorCommands);
    assert!(track.warnings.iter().any(|w| w.contains("cmd_u1… and vbat")), "{:?}", track.warnings);
    // A battery in the file has acted in the throttles already: it does not slow the motors again.
    let sag = "\n[[effect]]\nkind = \"battery_sag\"\nfull_v = 12.0\nnominal_v = 16.0\n";
    let weak = Vehicle::from_toml("weak", &format!("{}{sag}", motors.to_toml())).unwrap();
    let errors = [&motors, &weak].map(|v| {
        let track = Track::new(log.clone(), v, &Options::default()).unwrap();
        compare(&[track], v).unwrap().logs[0].horizons[3].error.position_m
    });
    assert_eq!(errors[0], errors[1]);
    let told = diagnose(&[track], &motors, &Settings::default()).unwrap();
    println!("{}", told.verdict.headline);
    assert!(told.verdict.findings.iter().any(|f| f.id == "linear_drag"), "{}", told.verdict.headline);
}

#[test]
fn without_speeds_the_lift_tells_the_motors() {
    let vehicle = vehicle();
    let log = flown(&vehicle, &[], 8, 0);
    let volts = battery(&log);
    let (hover, full) = (hover(&vehicle), volts(0.0));
    let truth = motor(hover, 0.4 * full);
    let fit = throttle::fit(&[without_speeds(throttled(log, &truth, &volts))], &[], &vehicle).unwrap();
    println!("{fit}");
    assert!(!fit.by_speeds && fit.unseen.share > 0.9, "{:?}", fit.unseen);
    // The file's mass and thrust are off within their tolerances, and the lift puts that into the speeds.
    let off = worst(&fit, &truth, hover, full);
    assert!(off < 0.03, "speeds are off by {off}");
    assert!(fit.notes.iter().any(|n| n.contains("no rotor speeds were logged")), "{:?}", fit.notes);
}

#[test]
fn a_firmware_that_makes_up_for_its_battery_is_told() {
    let vehicle = vehicle();
    let log = flown(&vehicle, &[], 9, 0);
    let truth = motor(hover(&vehicle), 5.0);
    let fit = throttle::fit(&[throttled(log, &truth, |_| 12.0)], &[], &vehicle).unwrap();
    println!("{fit}");
    assert_eq!(fit.table.voltage, ThrottleOf::Nominal);
    assert!(fit.unseen.share > 0.98, "{:?}", fit.unseen);
}

#[test]
fn what_tells_nothing_of_the_motors_is_refused_in_words() {
    let vehicle = vehicle();
    let log = flown(&vehicle, &[], 10, 0);
    let refused = |log: FlightLog, words: &[&str]| {
        let error = throttle::fit(&[log], &[], &vehicle).unwrap_err().to_string();
        for word in words {
            assert!(error.contains(word), "no {word:?} in {error}");
        }
    };
    refused(log.clone(), &["cmd_u1", "found none", "docs/logs.md"]);
    let truth = motor(hover(&vehicle), 5.0);
    let good = throttled(log, &truth, |_| 12.0);
    let mut three = good.clone();
    three.cmd_u.pop();
    refused(three, &["throttles of 4 rotors", "those of 3"]);
    // Throttles that have nothing to do with the speeds.
    let mut other = good;
    for c in &mut other.cmd_u {
        c.values.iter_mut().enumerate().for_each(|(i, v)| v[0] = 0.5 + 0.1 * (i as f64 * 0.37).sin());
    }
    refused(other, &["explain at least 30 %", "cmd_u1"]);
}

#[test]
fn a_hidden_battery_is_named_with_the_law_of_its_voltage_and_written() {
    let vehicle = vehicle();
    let mut plan = Plan::exciting(&vehicle, &["battery_sag"], 50.0, 11);
    plan.sensors = Sensors::default();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("flight.csv");
    planted::fly(&plan).unwrap().write(&file).unwrap();
    let log = FlightLog::load(&file, None).unwrap();
    let measured = battery(&log);
    let track = Track::new(log, &vehicle, &Options::default()).unwrap();
    let told = diagnose(&[track], &vehicle, &Settings::default()).unwrap();
    println!("{}", told.verdict.headline);
    let found = told.verdict.findings.iter().find(|f| f.id == "battery_sag").expect("a battery");
    assert!(found.certain, "{}", told.verdict.headline);
    let share = &found.parameters[0];
    assert!(share.name == "compensated" && share.value.abs() < 0.1, "{share:?}");
    // The law of the voltage: as full as it began, and falling as it did.
    let set = |name: &str| found.set.iter().find(|(n, _)| n == name).map(|(_, v)| *v).unwrap();
    assert!((set("full_v") / measured(0.0) - 1.0).abs() < 0.02, "{} of {}", set("full_v"), measured(0.0));
    assert!(set("drop_v_per_a_s") > 0.0);
    // Written with its law, so that it flies without a log.
    let source = Source { log_sha256: Vec::new(), date: today_utc(), text: "a test".into() };
    let mut completion =
        Completion::new(&vehicle, vehicle.to_toml().into(), "quad", &told.verdict.dynamics, source);
    completion.add(&Entry::of(found)).unwrap();
    let text = completion.text;
    for key in ["kind = \"battery_sag\"", "full_v", "nominal_v", "drop_v_per_a_s"] {
        assert!(text.contains(key), "no {key} in\n{text}");
    }
}

fn propwash(words: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_propwash")).args(words).output().unwrap()
}

#[test]
fn the_command_writes_a_vehicle_file_and_refuses_what_is_wrong() {
    let vehicle = vehicle();
    let log = flown(&vehicle, &[], 12, 0);
    let truth = motor(hover(&vehicle), 5.0);
    let volts = battery(&log);
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    std::fs::write(at("quad.toml"), format!("# mine\n{}", vehicle.to_toml())).unwrap();
    throttled(log.clone(), &truth, &volts).save(at("a.csv").as_ref()).unwrap();
    log.save(at("b.csv").as_ref()).unwrap();
    let run = |more: &[&str]| {
        let (quad, out) = (at("quad.toml"), at("out.toml"));
        let mut words = vec!["vehicle", "throttle", "--vehicle", &quad, "--out", &out];
        words.extend(more);
        propwash(&words)
    };
    let out = run(&[&at("a.csv")]);
    let text = String::from_utf8_lossy(&out.stdout).into_owned();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    for words in ["back-EMF", "time constant up", "explains", "wrote"] {
        assert!(text.contains(words), "no {words:?} in {text}");
    }
    let written = std::fs::read_to_string(at("out.toml")).unwrap();
    assert!(written.starts_with("# mine") && written.contains("[throttle]"), "{written}");
    // Fitted again, the table is replaced.
    let again = run(&[&at("a.csv"), "--force", "--json"]);
    let json: serde_json::Value = serde_json::from_slice(&again.stdout).unwrap();
    assert!(json["motors"]["unseen"]["share"].as_f64().unwrap() > 0.98, "{json}");
    let refused = |out: Output, words: &[&str]| {
        let text = String::from_utf8_lossy(&out.stderr).into_owned();
        assert_eq!(out.status.code(), Some(2), "{text}");
        assert!(text.starts_with("error: ") && text.trim_end().lines().count() == 1, "{text}");
        for word in words {
            assert!(text.contains(word), "no {word:?} in {text}");
        }
    };
    refused(run(&[&at("a.csv")]), &["--out", "--force"]);
    refused(run(&[&at("b.csv"), "--force"]), &["cmd_u1", "found none"]);
    refused(run(&[&at("none.csv"), "--force"]), &["none.csv"]);
    refused(run(&[&at("out.toml"), "--force"]), &["none of the logs"]);
}
