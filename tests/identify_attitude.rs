//! Identification of the attitude model on logs of a simulator of its own: roll, pitch and yaw as three second-order
//! equations, integrated at 1 kHz or finer, with a thrust lag, drag, a pure delay and held commands.

use propwash::flight::FlightLog;
use propwash::gap::attitude_model::{AttitudeModelError, Identification, Options, identify};
use propwash::vehicle::Vehicle;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// What the simulated vehicle is.
#[derive(Clone, Debug)]
struct Truth {
    angle: [f64; 3],
    rate: [f64; 3],
    command: [f64; 3],
    offset: f64,
    scale: f64,
    lag: f64,
    drag: [f64; 3],
    delay: f64,
    mass: f64,
}

impl Truth {
    /// The numbers of cf2x_L250, moved by a few per cent, with a delay.
    fn new(seed: u64) -> Self {
        let mut dice = Dice::new(seed, 1);
        let mut about = |v: f64| v * (1.0 + 0.15 * dice.uniform());
        Self {
            angle: [about(-486.0), about(-470.0), about(-333.0)],
            rate: [about(-33.0), about(-31.0), about(-39.0)],
            command: [about(448.0), about(440.0), about(306.0)],
            offset: about(0.02),
            scale: about(1.03),
            lag: about(8.0),
            drag: [about(0.0150), about(0.0170), about(0.0139)],
            delay: 0.0237 + 0.01 * dice.uniform(),
            mass: 0.0328,
        }
    }

    fn named(&self) -> Vec<(String, f64)> {
        let axes = ["roll", "pitch", "yaw"];
        let mut out = Vec::new();
        for k in 0..3 {
            out.push((format!("angle_gain_per_s2.{}", axes[k]), self.angle[k]));
            out.push((format!("rate_gain_per_s.{}", axes[k]), self.rate[k]));
            out.push((format!("command_gain_per_s2.{}", axes[k]), self.command[k]));
            out.push((format!("drag_n_s_per_m.{}", ["x", "y", "z"][k]), self.drag[k]));
        }
        out.push(("thrust_offset_n".into(), self.offset));
        out.push(("thrust_scale".into(), self.scale));
        out.push(("thrust_rate_per_s".into(), self.lag));
        for name in ["attitude_delay_s", "thrust_delay_s", "command_delay_s"] {
            out.push((name.into(), self.delay));
        }
        out
    }
}

/// Numbers that look random, each from its own counter.
struct Dice {
    seed: u64,
    count: u64,
}

impl Dice {
    fn new(seed: u64, purpose: u64) -> Self {
        Self {
            seed: seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ purpose.wrapping_mul(0xD1B5_4A32_D192_ED03),
            count: 0,
        }
    }
    /// Uniform in −1…1.
    fn uniform(&mut self) -> f64 {
        self.count += 1;
        let mut x = self.seed.wrapping_add(self.count.wrapping_mul(0xA076_1D64_78BD_642F));
        for k in [31, 29, 32] {
            x ^= x >> k;
            x = x.wrapping_mul(0xBF58_476D_1CE4_E5B9);
        }
        x ^= x >> 31;
        (x >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
    /// Standard normal.
    fn normal(&mut self) -> f64 {
        let (u, v) = (0.5 * (self.uniform() + 1.0), self.uniform());
        (-2.0 * (u.max(1e-300)).ln()).sqrt() * (std::f64::consts::PI * v).cos()
    }
}

/// How it is flown.
#[derive(Clone)]
struct Flight {
    seconds: f64,
    /// Amplitude of yaw and of thrust, 1 for exciting.
    yaw: f64,
    thrust: f64,
    position_noise_m: f64,
    attitude_noise_rad: f64,
    seed: u64,
    sensors: bool,
}

impl Default for Flight {
    fn default() -> Self {
        Self {
            seconds: 60.0,
            yaw: 1.0,
            thrust: 1.0,
            position_noise_m: 0.0,
            attitude_noise_rad: 0.0,
            seed: 1,
            sensors: false,
        }
    }
}

/// State: roll, pitch, yaw, their rates, position, velocity, thrust state.
type X = [f64; 13];

/// R = Rz Ry Rx, written out.
fn matrix(rpy: &[f64]) -> [[f64; 3]; 3] {
    let (sr, cr) = rpy[0].sin_cos();
    let (sp, cp) = rpy[1].sin_cos();
    let (sy, cy) = rpy[2].sin_cos();
    [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
}

fn slope(p: &Truth, x: &X, c: &[f64; 4]) -> X {
    let mut d = [0.0; 13];
    for k in 0..3 {
        d[k] = x[3 + k];
        d[3 + k] = p.angle[k] * x[k] + p.rate[k] * x[3 + k] + p.command[k] * c[k];
        d[6 + k] = x[9 + k];
    }
    let r = matrix(&x[..3]);
    let thrust = p.offset + p.scale * x[12];
    let mut body = [0.0; 3];
    for j in 0..3 {
        body[j] = -p.drag[j] * (0..3).map(|i| r[i][j] * x[9 + i]).sum::<f64>();
    }
    body[2] += thrust;
    for i in 0..3 {
        d[9 + i] = (0..3).map(|j| r[i][j] * body[j]).sum::<f64>() / p.mass;
    }
    d[11] -= 9.81;
    d[12] = p.lag * (c[3] - x[12]);
    d
}

fn step(p: &Truth, x: &X, c: &[f64; 4], h: f64) -> X {
    let at = |k: &X, s: f64| -> X { std::array::from_fn(|i| x[i] + s * k[i]) };
    let k1 = slope(p, x, c);
    let k2 = slope(p, &at(&k1, 0.5 * h), c);
    let k3 = slope(p, &at(&k2, 0.5 * h), c);
    let k4 = slope(p, &at(&k3, h), c);
    std::array::from_fn(|i| x[i] + h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]))
}

/// The command at 100 Hz: multi-sine and steps, and as much feedback as keeps the vehicle in a hall.
fn command(p: &Truth, f: &Flight, t: f64, x: &X) -> [f64; 4] {
    let wave = |w: &[f64], phase: f64| -> f64 {
        w.iter().enumerate().map(|(i, w)| (w * t + phase + 1.7 * i as f64).sin()).sum::<f64>()
            / w.len() as f64
    };
    let stair =
        |period: f64, phase: f64| if ((t + phase) / period).rem_euclid(2.0) < 1.0 { 1.0 } else { -1.0 };
    let roll = 0.22 * wave(&[1.3, 4.1, 7.9, 13.0], 0.3) + 0.16 * stair(1.37, 0.2);
    let pitch = 0.22 * wave(&[1.1, 3.7, 8.6, 12.1], 1.1) + 0.16 * stair(1.61, 0.9);
    let yaw = f.yaw * (0.5 * wave(&[0.7, 2.3, 5.9, 9.7], 2.0) + 0.3 * stair(2.3, 0.4));
    // Pull towards the middle in the world, turned by yaw.
    let (sy, cy) = x[2].sin_cos();
    let pull = [-0.10 * x[6] - 0.12 * x[9], -0.10 * x[7] - 0.12 * x[10]];
    let (ahead, left) = (cy * pull[0] + sy * pull[1], -sy * pull[0] + cy * pull[1]);
    let weight = p.mass * 9.81;
    let tilt = (x[0].cos() * x[1].cos()).max(0.6);
    let climb = if f.thrust > 0.0 {
        1.0 / tilt + f.thrust * (0.12 * wave(&[2.1, 5.2, 9.0, 15.0], 0.7) + 0.14 * stair(0.83, 0.1))
            - 0.5 * (x[8] - 2.0)
            - 0.35 * x[11]
    } else {
        1.0
    };
    let lift = (weight * climb - p.offset) / p.scale;
    [
        (roll - left).clamp(-0.7, 0.7),
        (pitch + ahead).clamp(-0.7, 0.7),
        yaw,
        lift.clamp(0.2 * weight, 2.0 * weight),
    ]
}

/// Flies and writes the log as the contract's CSV: pose at 200 Hz, commands at 100 Hz.
fn fly(dir: &Path, name: &str, p: &Truth, f: &Flight) -> PathBuf {
    let mut dice = Dice::new(f.seed, 2);
    let mut x: X = [0.0; 13];
    x[8] = 2.0;
    x[12] = p.mass * 9.81 / p.scale;
    let mut text = String::from("t,px,py,pz,qx,qy,qz,qw,cmd_roll,cmd_pitch,cmd_yaw,cmd_thrust");
    if f.sensors {
        text += ",wx,wy,wz,ax,ay,az";
    }
    text.push('\n');
    let late = (p.delay * 1e3).floor();
    let rest = p.delay * 1e3 - late;
    let mut sent: Vec<[f64; 4]> = Vec::new();
    let n = (f.seconds * 1e3) as usize;
    for i in 0..n {
        let t = i as f64 * 1e-3;
        if i % 10 == 0 {
            sent.push(command(p, f, t, &x));
        }
        let sent_at = |ms: f64| sent[if ms < 0.0 { 0 } else { ms as usize / 10 }];
        if i % 5 == 0 {
            let mut q = quaternion(&x[..3]);
            let noise: [f64; 3] = std::array::from_fn(|_| 0.5 * f.attitude_noise_rad * dice.normal());
            q = times(q, [noise[0], noise[1], noise[2], 1.0]);
            let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
            let mut cells: Vec<f64> = vec![t];
            cells.extend((0..3).map(|k| x[6 + k] + f.position_noise_m * dice.normal()));
            cells.extend(q.map(|v| v / length));
            let mut line: Vec<String> = cells.iter().map(f64::to_string).collect();
            if i % 10 == 0 {
                line.extend(sent[sent.len() - 1].iter().map(f64::to_string));
            } else {
                line.extend(["", "", "", ""].map(String::from));
            }
            if f.sensors {
                let c = sent_at((i as f64 - p.delay * 1e3).floor());
                let d = slope(p, &x, &c);
                let (sr, cr) = x[0].sin_cos();
                let (sp, cp) = x[1].sin_cos();
                let w = [x[3] - sp * x[5], cr * x[4] + sr * cp * x[5], -sr * x[4] + cr * cp * x[5]];
                let r = matrix(&x[..3]);
                let a = [d[9], d[10], d[11] + 9.81];
                line.extend((0..3).map(|k| (w[k] + 0.01 + 0.01 * dice.normal()).to_string()));
                line.extend((0..3).map(|k| {
                    let f: f64 = (0..3).map(|i| r[i][k] * a[i]).sum();
                    (f + 0.05 + 0.1 * dice.normal()).to_string()
                }));
            }
            writeln!(text, "{}", line.join(",")).unwrap();
        }
        // Within this millisecond the command of a whole number of milliseconds ago holds for the share `rest`.
        let old = sent_at(i as f64 - late - 1.0);
        let new = sent_at(i as f64 - late);
        if old == new || rest == 0.0 {
            x = step(p, &x, &new, 1e-3);
        } else {
            x = step(p, &x, &old, rest * 1e-3);
            x = step(p, &x, &new, (1.0 - rest) * 1e-3);
        }
    }
    let path = dir.join(name);
    std::fs::write(&path, text).unwrap();
    path
}

fn quaternion(rpy: &[f64]) -> [f64; 4] {
    let half = |a: f64| (0.5 * a).sin_cos();
    let ((sr, cr), (sp, cp), (sy, cy)) = (half(rpy[0]), half(rpy[1]), half(rpy[2]));
    times([0.0, 0.0, sy, cy], times([0.0, sp, 0.0, cp], [sr, 0.0, 0.0, cr]))
}

fn times(a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
    [
        a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
        a[3] * b[1] + a[1] * b[3] + a[2] * b[0] - a[0] * b[2],
        a[3] * b[2] + a[2] * b[3] + a[0] * b[1] - a[1] * b[0],
        a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
    ]
}

fn run(truth: &Truth, flight: &Flight) -> Result<Identification, AttitudeModelError> {
    let dir = tempfile::tempdir().unwrap();
    let path = fly(dir.path(), "flight.csv", truth, flight);
    let log = FlightLog::load(&path, None).unwrap();
    let vehicle = Vehicle::builtin("cf2x_L250").unwrap();
    let started = std::time::Instant::now();
    let out = identify(&log, &vehicle, &Options::default());
    eprintln!("identified in {:.2} s", started.elapsed().as_secs_f64());
    out
}

#[test]
fn every_parameter_of_a_noise_free_minute_is_within_one_per_cent_and_the_delay_within_a_millisecond() {
    let truth = Truth::new(1);
    let found = run(&truth, &Flight::default()).unwrap();
    println!("{found}");
    assert!(!found.warnings.iter().any(|w| w.contains("left out")), "{:?}", found.warnings);
    for (name, value) in truth.named() {
        let got = found.get(&name).unwrap_or_else(|| panic!("{name} is missing")).value;
        println!("{name:28} {value:12.6} {got:12.6} {:8.3} %", 100.0 * (got / value - 1.0));
        if name.ends_with("delay_s") {
            assert!((got - value).abs() < 1e-3, "{name}: {got} for {value}");
        } else if name == "thrust_offset_n" {
            // One per cent of the weight: the offset is a small difference of large thrusts.
            assert!((got - value).abs() < 0.01 * truth.mass * 9.81, "{name}: {got} for {value}");
        } else {
            assert!((got / value - 1.0).abs() < 0.01, "{name}: {got} for {value}");
        }
    }
}

#[test]
fn on_noisy_logs_most_true_values_lie_inside_the_intervals() {
    let (mut inside, mut all) = (0, 0);
    for seed in 0..4 {
        let truth = Truth::new(10 + seed);
        let flight = Flight {
            seconds: 40.0,
            position_noise_m: 1e-3,
            attitude_noise_rad: 0.2_f64.to_radians(),
            seed,
            sensors: seed == 3,
            ..Flight::default()
        };
        let found = run(&truth, &flight).unwrap();
        for (name, value) in truth.named() {
            let e = found.get(&name).unwrap();
            let (low, high) = (e.low_95.unwrap(), e.high_95.unwrap());
            let ok = low <= value && value <= high;
            all += 1;
            inside += usize::from(ok);
            let miss = (e.value - value) / e.sigma.unwrap();
            println!(
                "{seed} {name:28} {value:11.5} {:11.5} {miss:6.2} σ {:8.3} %",
                e.value,
                100.0 * (e.value / value - 1.0)
            );
            assert!(miss.abs() < 6.0, "{name}: {} for {value}, {miss} σ", e.value);
        }
        for c in found.fits.iter().filter(|c| c.channel.starts_with("attitude")) {
            let ratio = c.rms_in_noise.unwrap();
            assert!((0.9..1.1).contains(&ratio), "{}: {ratio} times the noise", c.channel);
        }
    }
    println!("{inside} of {all} inside");
    assert!(inside * 100 >= all * 85, "{inside} of {all} inside");
}

#[test]
fn a_yaw_that_nobody_excited_is_held_at_the_file_or_refused() {
    let truth = Truth::new(2);
    let flight = Flight { seconds: 20.0, yaw: 0.0, ..Flight::default() };
    let dir = tempfile::tempdir().unwrap();
    let log = FlightLog::load(&fly(dir.path(), "flight.csv", &truth, &flight), None).unwrap();
    let vehicle = Vehicle::builtin("cf2x_L250").unwrap();
    let found = identify(&log, &vehicle, &Options::default()).unwrap();
    let yaw = found.get("angle_gain_per_s2.yaw").unwrap();
    assert_eq!((yaw.value, yaw.sigma), (-333.2438787006866, None));
    assert!(
        found.warnings.iter().any(|w| w.starts_with("yaw was not excited enough")),
        "{:?}",
        found.warnings
    );
    let roll = found.get("angle_gain_per_s2.roll").unwrap();
    assert!((roll.value / truth.angle[0] - 1.0).abs() < 0.01);

    let mut bare = vehicle.file().clone();
    bare.attitude_response = Default::default();
    bare.effect.clear();
    let bare = Vehicle::from_file("bare", bare).unwrap();
    let refused = identify(&log, &bare, &Options::default()).unwrap_err().to_string();
    assert!(refused.contains("the yaw axis was not excited enough"), "{refused}");
}

#[test]
fn thrust_that_hardly_varies_leaves_offset_and_scale_together() {
    let truth = Truth { offset: 0.0, ..Truth::new(3) };
    let flight = Flight { seconds: 20.0, thrust: 0.0, ..Flight::default() };
    let found = run(&truth, &flight).unwrap();
    println!("{found}");
    let text = found.warnings.join("\n");
    assert!(text.contains("thrust offset and thrust scale cannot be told apart"), "{text}");
    assert!(found.get("thrust_offset_n").unwrap().held.is_some());
    assert!((found.get("thrust_scale").unwrap().value / truth.scale - 1.0).abs() < 0.01);
    assert!(text.contains("the thrust lag is not well determined"), "{text}");
    assert!(found.get("thrust_rate_per_s").unwrap().held.is_some());
    let (turn, lift) = (found.get("attitude_delay_s").unwrap(), found.get("thrust_delay_s").unwrap());
    assert!(lift.held.is_some() && (lift.value - turn.value).abs() < 1e-3, "{lift:?} for {turn:?}");
}

#[test]
fn mass_is_never_claimed_from_motion() {
    let truth = Truth::new(4);
    let dir = tempfile::tempdir().unwrap();
    let flight = Flight { seconds: 20.0, ..Flight::default() };
    let log = FlightLog::load(&fly(dir.path(), "flight.csv", &truth, &flight), None).unwrap();
    let vehicle = Vehicle::builtin("cf2x_L250").unwrap();
    let mut heavy = vehicle.file().clone();
    heavy.body.mass_kg *= 1.1;
    let heavy = Vehicle::from_file("heavy", heavy).unwrap();
    let [a, b] = [&vehicle, &heavy].map(|v| identify(&log, v, &Options::default()).unwrap());
    for found in [&a, &b] {
        assert!(found.warnings.iter().any(|w| w.starts_with("mass and thrust scale cannot be told apart")));
        assert!((found.thrust_scale_per_mass_per_kg * truth.mass / truth.scale - 1.0).abs() < 0.002);
    }
    let ratio = b.get("thrust_scale").unwrap().value / a.get("thrust_scale").unwrap().value;
    assert!((ratio - 1.1).abs() < 1e-3, "{ratio}");
}

#[test]
fn logs_that_cannot_do_get_their_sentence() {
    let truth = Truth::new(5);
    let dir = tempfile::tempdir().unwrap();
    let path = fly(dir.path(), "flight.csv", &truth, &Flight { seconds: 12.0, ..Flight::default() });
    let text = std::fs::read_to_string(&path).unwrap();
    let vehicle = Vehicle::builtin("cf2x_L250").unwrap();
    let sentence = |text: &str, dynamics: &str| -> String {
        let path = dir.path().join("other.csv");
        std::fs::write(&path, text).unwrap();
        let log = FlightLog::load(&path, None).unwrap();
        match identify(&log, &vehicle, &Options { dynamics: dynamics.into() }) {
            Ok(found) => panic!("expected an error, found {found}"),
            Err(error) => error.to_string(),
        }
    };
    let model = "so_rpy_rotor_drag";
    let without = |name: &str| text.replacen(name, &format!("other_{name}"), 1);
    assert!(
        sentence(&without("cmd_thrust"), model).contains("expected thrust commands (cmd_thrust), found none")
    );
    let no_angles = text.replacen("cmd_roll,cmd_pitch,cmd_yaw", "a,b,c", 1);
    assert!(sentence(&no_angles, model).contains("expected attitude commands"));
    assert!(sentence(&text.replacen("px,py,pz", "a,b,c", 1), model).contains("expected positions"));
    let no_attitude = text.replacen("qx,qy,qz,qw", "a,b,c,d", 1);
    assert!(sentence(&no_attitude, model).contains("expected attitudes"));
    let short: String = text.lines().take(600).map(|l| format!("{l}\n")).collect();
    assert!(sentence(&short, model).contains("at least 8 s of flight"));
    assert!(sentence(&text, "so_rpy_lag").contains("no attitude model is called `so_rpy_lag`"));
    let turned: String = text
        .lines()
        .map(|l| {
            let mut cells: Vec<String> = l.split(',').map(str::to_string).collect();
            if let Ok(v) = cells[9].parse::<f64>() {
                cells[9] = (-v).to_string();
            }
            cells.join(",") + "\n"
        })
        .collect();
    let said = sentence(&turned, model);
    assert!(said.contains("commanded and measured pitch move against each other"), "{said}");
}

#[test]
fn the_command_writes_a_vehicle_file_that_holds_what_was_found() {
    let truth = Truth::new(6);
    let dir = tempfile::tempdir().unwrap();
    let path = fly(dir.path(), "flight.csv", &truth, &Flight { seconds: 20.0, ..Flight::default() });
    let out = dir.path().join("better.toml");
    let run = |extra: &[&str]| {
        std::process::Command::new(env!("CARGO_BIN_EXE_propwash"))
            .arg("identify")
            .arg(&path)
            .args(["--model", "attitude", "--vehicle", "cf2x_L250"])
            .args(extra)
            .output()
            .unwrap()
    };
    let done = run(&["--out", out.to_str().unwrap(), "--json"]);
    assert_eq!(done.status.code(), Some(0), "{}", String::from_utf8_lossy(&done.stderr));
    let json: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
    assert_eq!(json["dynamics"], "so_rpy_rotor_drag");
    let better = Vehicle::load(&out).unwrap();
    let file = better.file();
    let response = file.attitude_response.so_rpy_rotor_drag.as_ref().unwrap();
    assert!((response.thrust_rate_per_s.unwrap() / truth.lag - 1.0).abs() < 0.01);
    assert!(response.source.as_ref().unwrap().contains(json["log_sha256"].as_str().unwrap()));
    assert!(response.sigma.contains_key("command_gain_per_s2"));
    let drone = better.drone("so_rpy_rotor_drag").unwrap();
    let kinds: Vec<&str> = drone.effects.iter().map(|e| e.kind()).collect();
    assert_eq!(kinds, ["linear_drag", "command_delay"]);
    // What other dynamics had stays.
    let before = Vehicle::builtin("cf2x_L250").unwrap();
    assert_eq!(better.drone("first_principles").unwrap(), before.drone("first_principles").unwrap());
    assert_eq!(file.attitude_response.so_rpy, before.file().attitude_response.so_rpy);

    let table = run(&[]);
    let text = String::from_utf8_lossy(&table.stdout).into_owned();
    assert!(text.contains("thrust_rate_per_s") && text.contains("± (95 %)"), "{text}");
    let wrong = run(&["--dynamics", "so_rpy_lag"]);
    assert_eq!(wrong.status.code(), Some(2));
}
