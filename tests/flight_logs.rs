//! Flight logs: synthetic ones with each fault planted and found by name, real ones where they are at hand, and files
//! that are wrong.

#[path = "common/ulog.rs"]
mod ulog;

use propwash::flight::correction::mend;
use propwash::flight::usable::{Known, look};
use propwash::flight::{Channel, CheckReport, Fault, FlightError, FlightLog, Mapping, Severity, check};
use propwash::math::{quat, vec3};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

const G: f64 = 9.80665;

/// Rows of a made-up flight: columns by name, NaN where empty.
#[derive(Clone)]
struct Rows {
    names: Vec<String>,
    cells: Vec<Vec<f64>>,
}

/// A number in −1…1 that looks random.
fn noise(i: usize, salt: u64) -> f64 {
    let mut x = (i as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ salt.wrapping_mul(0xD1B5_4A32_D192_ED03);
    x ^= x >> 31;
    x = x.wrapping_mul(0xBF58_476D_1CE4_E5B9);
    x ^= x >> 29;
    (x >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

/// Position of the flight, m: a slanted figure with two speeds.
fn position(t: f64) -> [f64; 3] {
    [1.5 * (1.1 * t).sin() + 0.3 * (2.3 * t).cos(), 1.2 * (1.7 * t + 0.4).sin(), 1.5 + 0.4 * (0.9 * t).sin()]
}

/// n-th difference quotient of the position; exact enough for tests (1e-6).
fn derivative(t: f64, order: usize) -> [f64; 3] {
    let h = 1e-3;
    let (a, b, c) = (position(t - h), position(t), position(t + h));
    std::array::from_fn(|k| match order {
        1 => (c[k] - a[k]) / (2.0 * h),
        _ => (c[k] - 2.0 * b[k] + a[k]) / (h * h),
    })
}

/// Attitude of a quadrotor that flies the figure: z along v̇ − g, with a moving yaw.
fn attitude(t: f64) -> [f64; 4] {
    let a = derivative(t, 2);
    let z = vec3::normalize_or([a[0], a[1], a[2] + G], [0.0, 0.0, 1.0]);
    // Turn e_z onto z, after a yaw.
    let axis = vec3::cross([0.0, 0.0, 1.0], z);
    let sine = vec3::norm(axis);
    let turn = vec3::scale(axis, if sine > 1e-12 { sine.atan2(z[2]) / sine } else { 1.0 });
    quat::mul(quat::exp(turn), quat::exp([0.0, 0.0, 0.8 * (0.7 * t).sin()]))
}

fn body_rate(t: f64) -> [f64; 3] {
    let h = 1e-4;
    let turn = quat::mul(quat::conjugate(attitude(t - h)), attitude(t + h));
    let sign = turn[3].signum();
    std::array::from_fn(|k| turn[k] * sign / h)
}

/// A clean flight of `seconds` at `rate_hz` with ordinary sensor noise.
fn flight(seconds: f64, rate_hz: f64) -> Rows {
    let names = "t px py pz qx qy qz qw vx vy vz wx wy wz ax ay az rotor1 rotor2 rotor3 rotor4 vbat";
    let names: Vec<String> = names.split(' ').map(String::from).collect();
    let n = (seconds * rate_hz) as usize;
    let mut cells = vec![Vec::with_capacity(n); names.len()];
    for i in 0..n {
        let t = i as f64 / rate_hz;
        let (p, v, q, w) = (position(t), derivative(t, 1), attitude(t), body_rate(t));
        let f = quat::rotate_inverse(q, vec3::add(derivative(t, 2), [0.0, 0.0, G]));
        let tilt = [0.002 * noise(i, 1), 0.002 * noise(i, 2), 0.002 * noise(i, 3)];
        let q = quat::mul(q, quat::exp(tilt));
        let rotor = 1400.0 * (f[2] / G).sqrt();
        let mut row = vec![t];
        row.extend((0..3).map(|k| p[k] + 3e-4 * noise(i, 4 + k as u64)));
        row.extend(q);
        row.extend((0..3).map(|k| v[k] + 5e-3 * noise(i, 7 + k as u64)));
        row.extend((0..3).map(|k| w[k] + 0.02 * noise(i, 10 + k as u64)));
        row.extend((0..3).map(|k| f[k] + 0.15 * noise(i, 13 + k as u64)));
        row.extend((0..4).map(|k| rotor + 8.0 * noise(i, 16 + k as u64)));
        row.push(16.4 - 0.01 * t);
        for (column, value) in cells.iter_mut().zip(row) {
            column.push(value);
        }
    }
    Rows { names, cells }
}

impl Rows {
    fn index(&self, name: &str) -> usize {
        self.names.iter().position(|n| n == name).unwrap()
    }
    fn column(&mut self, name: &str) -> &mut Vec<f64> {
        let i = self.index(name);
        &mut self.cells[i]
    }
    /// Changes three columns together.
    fn three(&mut self, names: [&str; 3], f: impl Fn(usize, [f64; 3]) -> [f64; 3]) {
        let at = names.map(|n| self.index(n));
        for i in 0..self.cells[0].len() {
            let new = f(i, at.map(|k| self.cells[k][i]));
            at.iter().zip(new).for_each(|(k, v)| self.cells[*k][i] = v);
        }
    }
    fn attitudes(&mut self, f: impl Fn([f64; 4]) -> [f64; 4]) {
        let at = ["qx", "qy", "qz", "qw"].map(|n| self.index(n));
        for i in 0..self.cells[0].len() {
            let new = f(at.map(|k| self.cells[k][i]));
            at.iter().zip(new).for_each(|(k, v)| self.cells[*k][i] = v);
        }
    }
    fn attitude(&self, i: usize) -> [f64; 4] {
        ["qx", "qy", "qz", "qw"].map(|n| self.cells[self.index(n)][i])
    }
    fn scale(&mut self, names: &[&str], factor: f64) {
        names.iter().for_each(|n| self.column(n).iter_mut().for_each(|v| *v *= factor));
    }
    /// Moves columns later by linear interpolation of their samples.
    fn delay(&mut self, names: &[&str], seconds: f64) {
        let t = self.cells[0].clone();
        let step = t[1] - t[0];
        for name in names {
            let old = self.column(name).clone();
            for i in 0..t.len() {
                let at = ((t[i] - seconds) / step).clamp(0.0, (t.len() - 2) as f64);
                let (k, f) = (at as usize, at.fract());
                self.column(name)[i] = old[k] + f * (old[k + 1] - old[k]);
            }
        }
    }
    fn drop(&mut self, names: &[&str]) {
        for name in names {
            let i = self.index(name);
            self.names.remove(i);
            self.cells.remove(i);
        }
    }
    fn rename(&mut self, from: &str, to: &str) {
        let i = self.index(from);
        self.names[i] = to.into();
    }
    fn text(&self) -> String {
        let mut out = self.names.join(",") + "\n";
        for i in 0..self.cells[0].len() {
            for (k, column) in self.cells.iter().enumerate() {
                let comma = if k > 0 { "," } else { "" };
                if column[i].is_nan() { write!(out, "{comma}") } else { write!(out, "{comma}{}", column[i]) }
                    .unwrap();
            }
            out.push('\n');
        }
        out
    }
}

/// A folder that goes away, with a log in it.
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

fn load(text: &str) -> Result<FlightLog, FlightError> {
    let folder = Folder::new();
    FlightLog::load(&folder.write("log.csv", text), None)
}

fn checked(rows: &Rows) -> CheckReport {
    check(&load(&rows.text()).unwrap())
}

/// Faults of at least a warning, each once.
fn faults(report: &CheckReport) -> Vec<Fault> {
    let mut out: Vec<Fault> = Vec::new();
    for f in report.findings.iter().filter(|f| f.severity > Severity::Info) {
        if !out.contains(&f.fault) {
            out.push(f.fault);
        }
    }
    out
}

/// The planted fault is found, with `words` in its sentence, and nothing else.
fn finds(rows: &Rows, severity: Severity, fault: Fault, words: &str) {
    let report = checked(rows);
    assert_eq!(faults(&report), [fault], "{report}");
    assert_eq!(report.verdict, severity, "{report}");
    assert!(
        report.findings.iter().any(|f| f.fault == fault && f.text.contains(words)),
        "`{words}`: {report}"
    );
}

const POSITION: [&str; 3] = ["px", "py", "pz"];
const VELOCITY: [&str; 3] = ["vx", "vy", "vz"];
const RATES: [&str; 3] = ["wx", "wy", "wz"];
const FORCE: [&str; 3] = ["ax", "ay", "az"];

#[test]
fn a_clean_flight_raises_nothing_at_any_usual_rate() {
    for rate_hz in [100.0, 240.0, 500.0] {
        let report = checked(&flight(20.0, rate_hz));
        assert_eq!(faults(&report), [], "{report}");
        let p = report.channels.iter().find(|c| c.name == "position").unwrap();
        assert!((p.rate_hz - rate_hz).abs() < 1e-6 * rate_hz && p.samples == (20.0 * rate_hz) as usize);
        let named = |name: &str| report.delays.iter().find(|d| d.channel == name).unwrap();
        for name in ["velocity", "angular velocity", "specific force"] {
            let d = named(name);
            assert!(d.certain && d.lag.lag_s.abs() < 2e-3, "{name}: {d:?}");
        }
    }
}

#[test]
fn a_clean_log_of_sensors_with_different_rates_keeps_their_own_times() {
    let mut rows = flight(20.0, 400.0);
    for i in 0..rows.cells[0].len() {
        for (names, every) in
            [(&["px", "py", "pz", "qx", "qy", "qz", "qw", "vx", "vy", "vz"][..], 4), (&["vbat"], 40)]
        {
            for name in names {
                if i % every != 0 {
                    rows.column(name)[i] = f64::NAN;
                }
            }
        }
    }
    let log = load(&rows.text()).unwrap();
    assert_eq!((log.position_m.len(), log.vbat_v.len(), log.specific_force_m_s2.len()), (2000, 200, 8000));
    assert!((log.position_m.period_s().unwrap() - 0.01).abs() < 1e-12);
    let report = check(&log);
    assert_eq!(faults(&report), [], "{report}");
}

#[test]
fn foreign_units_are_found_by_name() {
    let plant = |names: &[&str], factor: f64, words: &str| {
        let mut rows = flight(20.0, 200.0);
        rows.scale(names, factor);
        finds(&rows, Severity::Refuse, Fault::Unit, words);
    };
    plant(&RATES, 180.0 / std::f64::consts::PI, "deg/s");
    plant(&FORCE, 1.0 / G, "multiples of g");
    plant(&FORCE, 1000.0, "mm/s²");
    plant(&["rotor1", "rotor2", "rotor3", "rotor4"], 30.0 / std::f64::consts::PI, "rpm");
    plant(&VELOCITY, 1000.0, "mm/s");
    plant(&POSITION, 1000.0, "position is in mm");
    plant(&["vbat"], 1000.0, "mV");
}

#[test]
fn commands_in_degrees_percent_and_pulse_widths_are_found() {
    let mut rows = flight(20.0, 200.0);
    let n = rows.cells[0].len();
    for (name, size) in [("cmd_roll", 12.0), ("cmd_pitch", 9.0), ("cmd_yaw", 20.0)] {
        rows.names.push(name.into());
        rows.cells.push((0..n).map(|i| size * (i as f64 * 0.01).sin()).collect());
    }
    finds(&rows, Severity::Refuse, Fault::Unit, "degrees");
    for (scale, offset, words) in
        [(100.0, 0.0, "percent"), (1000.0, 1000.0, "pulse widths"), (65535.0, 0.0, "16-bit")]
    {
        let mut rows = flight(20.0, 200.0);
        for k in 1..=4 {
            rows.names.push(format!("cmd_u{k}"));
            rows.cells.push((0..n).map(|i| offset + scale * (0.5 + 0.2 * (i as f64 * 0.01).sin())).collect());
        }
        finds(&rows, Severity::Refuse, Fault::Unit, words);
    }
}

#[test]
fn times_in_other_units_are_found() {
    for (factor, words) in [
        (1e3, "milliseconds read as seconds"),
        (1e6, "microseconds read as seconds"),
        (1e-3, "labelled as microseconds"),
    ] {
        let mut rows = flight(20.0, 200.0);
        rows.scale(&["t"], factor);
        finds(&rows, Severity::Refuse, Fault::TimeUnit, words);
    }
}

#[test]
fn backward_and_repeated_times_are_refused_with_their_row() {
    let mut rows = flight(20.0, 200.0);
    rows.column("t")[1000] = 2.0;
    finds(&rows, Severity::Refuse, Fault::ClockBackwards, "row 1002");
    let mut rows = flight(20.0, 200.0);
    rows.column("t")[1000] = 999.0 / 200.0;
    finds(&rows, Severity::Refuse, Fault::ClockBackwards, "stands still at row 1002");
    let folder = Folder::new();
    let refused = FlightLog::open(&folder.write("log.csv", &rows.text()), None).unwrap_err().to_string();
    assert!(refused.contains("cannot be right") && refused.contains("row 1002"), "{refused}");
}

#[test]
fn a_gap_is_a_warning_and_a_clock_jump_is_refused() {
    let mut rows = flight(20.0, 200.0);
    rows.cells.iter_mut().for_each(|c| {
        c.drain(1000..1050);
    });
    finds(&rows, Severity::Warning, Fault::Gap, "the longest 255 ms");
    let mut rows = flight(20.0, 200.0);
    rows.column("t")[1000..].iter_mut().for_each(|t| *t += 0.4);
    let report = checked(&rows);
    assert!(report.has(Fault::ClockJump) && report.verdict == Severity::Refuse, "{report}");
    assert!(report.findings[0].text.contains("0.405 s"), "{report}");
}

#[test]
fn quaternions_that_are_no_rotations_are_found() {
    let mut rows = flight(20.0, 200.0);
    rows.attitudes(|q| q.map(|x| x * 1.013));
    finds(&rows, Severity::Warning, Fault::Quaternion, "1.0130");
    let mut rows = flight(20.0, 200.0);
    rows.attitudes(|q| q.map(|x| x * 1.4));
    finds(&rows, Severity::Refuse, Fault::Quaternion, "not of length 1");
}

#[test]
fn quaternion_order_and_direction_are_found_with_and_without_inertial_sensors() {
    for without in [&[][..], &FORCE[..], &RATES[..], &["wx", "wy", "wz", "ax", "ay", "az"][..]] {
        for (f, words) in [
            ((|q: [f64; 4]| quat::conjugate(q)) as fn([f64; 4]) -> [f64; 4], "turns world into body"),
            (|q| [q[3], q[0], q[1], q[2]], "w, x, y, z"),
        ] {
            let mut rows = flight(20.0, 200.0);
            rows.attitudes(f);
            rows.drop(without);
            let report = checked(&rows);
            assert!(
                report.has(Fault::AttitudeFrame) && report.verdict == Severity::Refuse,
                "{words} {without:?}: {report}"
            );
            assert!(report.findings.iter().any(|f| f.text.contains(words)), "{words} {without:?}: {report}");
        }
    }
}

/// Changes a vector, given the clean rows and the row.
type Turn<'a> = &'a dyn Fn(&Rows, usize, [f64; 3]) -> [f64; 3];

#[test]
fn frames_of_accelerometer_velocity_and_rates_are_found() {
    let base = flight(20.0, 200.0);
    let turned = |names, words, fault, f: Turn| {
        let mut rows = base.clone();
        rows.three(names, |i, v| f(&base, i, v));
        finds(&rows, Severity::Refuse, fault, words);
    };
    let to_world = |r: &Rows, i: usize, v| quat::rotate(r.attitude(i), v);
    let to_body = |r: &Rows, i: usize, v| quat::rotate_inverse(r.attitude(i), v);
    let frd = |_: &Rows, _: usize, v: [f64; 3]| [v[0], -v[1], -v[2]];
    turned(FORCE, "in the world frame", Fault::AccelerometerFrame, &to_world);
    turned(FORCE, "forward-right-down", Fault::AccelerometerFrame, &frd);
    turned(FORCE, "gravity was taken off", Fault::AccelerometerFrame, &|r, i, v| {
        vec3::sub(v, quat::rotate_inverse(r.attitude(i), [0.0, 0.0, G]))
    });
    turned(VELOCITY, "body frame", Fault::VelocityFrame, &to_body);
    turned(VELOCITY, "north-east-down", Fault::VelocityFrame, &frd);
    turned(VELOCITY, "opposite sign", Fault::VelocityFrame, &|_, _, v| v.map(|x| -x));
    turned(RATES, "world frame", Fault::RateFrame, &to_world);
    turned(RATES, "forward-right-down", Fault::RateFrame, &frd);
}

#[test]
fn a_whole_log_in_ned_and_frd_is_found_and_read_right_with_a_mapping() {
    let turn = |_: usize, v: [f64; 3]| [v[0], -v[1], -v[2]];
    let mut rows = flight(20.0, 200.0);
    for names in [POSITION, VELOCITY, RATES, FORCE] {
        rows.three(names, turn);
    }
    rows.attitudes(|q| [q[0], -q[1], -q[2], q[3]]);
    finds(&rows, Severity::Refuse, Fault::AccelerometerFrame, "north-east-down and forward-right-down");
    let folder = Folder::new();
    let path = folder.write("log.csv", &rows.text());
    folder.write("log.toml", "world_frame = \"ned\"\nbody_frame = \"frd\"\n");
    let log = FlightLog::load(&path, None).unwrap();
    let report = check(&log);
    assert_eq!(faults(&report), [], "{report}");
    let plain = load(&flight(20.0, 200.0).text()).unwrap();
    for (a, b) in log.attitude.values.iter().zip(&plain.attitude.values) {
        assert!((0..4).map(|k| a[k] * b[k]).sum::<f64>().abs() > 1.0 - 1e-12);
    }
}

#[test]
fn dead_stuck_and_glitching_rotor_sensors_are_found() {
    let mut rows = flight(20.0, 200.0);
    rows.column("rotor2")[1500..1560].fill(0.0);
    finds(&rows, Severity::Warning, Fault::RotorDead, "rotor2 reads nothing in 60");
    let mut rows = flight(20.0, 200.0);
    let value = rows.column("rotor3")[1500];
    rows.column("rotor3")[1500..1800].fill(value);
    finds(&rows, Severity::Warning, Fault::RotorDead, "rotor3 is stuck");
    let mut rows = flight(20.0, 200.0);
    for i in [300, 301, 900, 2000, 3000] {
        rows.column("rotor1")[i] = 3800.0;
    }
    finds(&rows, Severity::Warning, Fault::Glitch, "rotor1 has 5 samples");
}

#[test]
fn rotors_at_rest_before_take_off_are_no_fault() {
    let mut rows = flight(20.0, 200.0);
    for k in 1..=4 {
        rows.column(&format!("rotor{k}"))[..200].fill(0.0);
    }
    assert_eq!(faults(&checked(&rows)), []);
}

#[test]
fn delays_between_channels_are_found_to_a_millisecond_with_their_sign() {
    for (names, channel, seconds) in [
        (FORCE, "specific force", 0.012),
        (RATES, "angular velocity", -0.008),
        (VELOCITY, "velocity", 0.024),
        (FORCE, "specific force", 0.006),
    ] {
        let mut rows = flight(30.0, 250.0);
        rows.delay(&names, seconds);
        let report = checked(&rows);
        let d = report.delays.iter().find(|d| d.channel == channel).unwrap();
        assert!((d.lag.lag_s - seconds).abs() < 1e-3 && d.certain, "{channel} {seconds}: {d:?}");
        let word = if seconds > 0.0 { "late" } else { "early" };
        let told = |f: &propwash::flight::Finding| {
            f.fault == Fault::Delay && f.channel == channel && f.text.contains(word)
        };
        assert!(report.findings.iter().any(told), "{report}");
    }
}

#[test]
fn a_mapping_reads_foreign_names_units_and_orders_as_the_contract() {
    let plain = flight(5.0, 100.0);
    let expected = load(&plain.text()).unwrap();
    let mut rows = plain.clone();
    rows.scale(&["t"], 1e3);
    rows.scale(&POSITION, 1e3);
    rows.scale(&RATES, 180.0 / std::f64::consts::PI);
    rows.scale(&FORCE, 1.0 / G);
    rows.scale(&["rotor1", "rotor2", "rotor3", "rotor4"], 30.0 / std::f64::consts::PI);
    rows.attitudes(quat::conjugate);
    for (from, to) in [
        ("t", "timestamp"),
        ("px", "x"),
        ("py", "y"),
        ("pz", "z"),
        ("qx", "b"),
        ("qy", "c"),
        ("qz", "d"),
        ("qw", "a"),
        ("vx", "u"),
        ("vy", "v"),
        ("vz", "w"),
        ("wx", "gyro.x"),
        ("wy", "gyro.y"),
        ("wz", "gyro.z"),
        ("ax", "acc.x"),
        ("ay", "acc.y"),
        ("az", "acc.z"),
        ("rotor1", "m1"),
        ("rotor2", "m2"),
        ("rotor3", "m3"),
        ("rotor4", "m4"),
        ("vbat", "note"),
    ] {
        rows.rename(from, to);
    }
    let mapping = r#"
[columns]
t = { from = "timestamp", unit = "ms" }
px = { from = "x", unit = "mm" }
py = { from = "y", unit = "mm" }
pz = { from = "z", unit = "mm" }
vx = "u"
vy = "v"
vz = "w"
wx = { from = "gyro.x", unit = "deg/s" }
wy = { from = "gyro.y", unit = "deg/s" }
wz = { from = "gyro.z", unit = "deg/s" }
ax = { from = "acc.x", unit = "g" }
ay = { from = "acc.y", unit = "g" }
az = { from = "acc.z", unit = "g" }
rotor1 = { from = "m1", unit = "rpm" }
rotor2 = { from = "m2", unit = "rpm" }
rotor3 = { from = "m3", unit = "rpm" }
rotor4 = { from = "m4", unit = "rpm" }
[attitude]
quaternion = ["a", "b", "c", "d"]
order = "wxyz"
direction = "body_from_world"
"#;
    let folder = Folder::new();
    let path = folder.write("log.csv", &rows.text());
    let mapping = Mapping::parse(mapping, Path::new("log.toml")).unwrap();
    let log = FlightLog::load_with(&path, Some(&mapping)).unwrap();
    let near = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9 * b.abs().max(1.0));
    for i in 0..expected.position_m.len() {
        assert!((log.position_m.t_s[i] - expected.position_m.t_s[i]).abs() < 1e-9);
        assert!(near(&log.position_m.values[i], &expected.position_m.values[i]));
        assert!(near(&log.attitude.values[i], &expected.attitude.values[i]));
        assert!(near(&log.angular_velocity_rad_s.values[i], &expected.angular_velocity_rad_s.values[i]));
        assert!(near(&log.specific_force_m_s2.values[i], &expected.specific_force_m_s2.values[i]));
        assert!(near(&log.rotor_speed_rad_s[3].values[i], &expected.rotor_speed_rad_s[3].values[i]));
    }
    assert!(log.warnings.iter().any(|w| w.contains("ignored: note")), "{:?}", log.warnings);
}

#[test]
fn csv_and_parquet_hold_the_same_log() {
    let mut rows = flight(5.0, 100.0);
    for i in 0..rows.cells[0].len() {
        if i % 3 != 0 {
            rows.column("vbat")[i] = f64::NAN;
        }
    }
    let log = load(&rows.text()).unwrap();
    let folder = Folder::new();
    for name in ["out.csv", "out.parquet"] {
        let path = folder.0.path().join(name);
        log.save(&path).unwrap();
        let back = FlightLog::load(&path, None).unwrap();
        assert_eq!(back.position_m, log.position_m, "{name}");
        assert_eq!(back.attitude, log.attitude, "{name}");
        assert_eq!(back.vbat_v, log.vbat_v, "{name}");
        assert_eq!(back.rotor_speed_rad_s, log.rotor_speed_rad_s, "{name}");
        assert_eq!(back.sha256.len(), 64);
        assert_ne!(back.sha256, log.sha256);
    }
    assert!(log.save(&folder.0.path().join("out.xls")).unwrap_err().to_string().contains(".csv or .parquet"));
}

#[test]
fn wrong_files_get_a_sentence_with_row_and_column() {
    let head = "t,px,py,pz,qx,qy,qz,qw";
    let row = |t: f64| format!("{t},0,0,1,0,0,0,1");
    for (text, words) in [
        (String::new(), "an empty file"),
        ("\n \n".into(), "an empty file"),
        (format!("{head}\n"), "a header alone"),
        (format!("{head}\n{}\n", row(0.0)), "one row"),
        (
            format!("{head}\n{}\n0.1,0,abc,1,0,0,0,1\n", row(0.0)),
            "row 3, column `py`: expected a number, found `abc`",
        ),
        (
            format!("{head}\n{}\n0.1,0,nan,1,0,0,0,1\n", row(0.0)),
            "row 3, column `py`: expected a finite number",
        ),
        (
            format!("{head}\n{}\n0.1,0,inf,1,0,0,0,1\n", row(0.0)),
            "row 3, column `py`: expected a finite number",
        ),
        (
            format!("{head}\n{}\n,0,0,1,0,0,0,1\n", row(0.0)),
            "row 3, column `t`: expected a time in every row",
        ),
        (format!("{head}\n{}\n0.1,0,0\n", row(0.0)), "found 3 cells in row 3"),
        ("px,py,pz\n0,0,0\n1,1,1\n".into(), "expected a column `t`"),
        ("t,px,py\n0,0,0\n1,1,1\n".into(), "expected a column `pz` (px, py, pz belong together)"),
        ("t,px,px\n0,0,0\n1,1,1\n".into(), "the column `px` twice"),
        ("t,x,y\n0,0,0\n1,1,1\n".into(), "columns of the flight-log contract"),
        ("t,rotor1,rotor3\n0,0,0\n1,1,1\n".into(), "expected a column `rotor2`"),
        ("t,drone,px,py,pz\n0,0,0,0,0\n0,1,1,1,1\n".into(), "one vehicle in one log"),
    ] {
        let error = load(&text).unwrap_err().to_string();
        assert!(error.contains(words), "`{words}` in: {error}");
    }
    let folder = Folder::new();
    for (name, words) in [
        ("log.parquet", "a whole Parquet file"),
        ("log.ulg", "a PX4 ULog file"),
        ("log.mcap", "an MCAP file"),
        ("log.xyz", ".ulg or .mcap"),
    ] {
        let error = FlightLog::load(&folder.write(name, "no such thing"), None).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    }
    assert!(matches!(FlightLog::load(Path::new("nowhere.csv"), None), Err(FlightError::Read { .. })));
}

#[test]
fn a_vehicle_file_of_the_logs_name_is_no_mapping_and_other_files_of_it_say_why_they_were_read() {
    let folder = Folder::new();
    let log = folder.write("quad.csv", "t,px,py,pz\n0,0,0,1\n0.1,0,0,1\n");
    assert_eq!(FlightLog::load(&log, None).unwrap().mapping, None);
    let vehicle = propwash::vehicle::Vehicle::builtin("cf2x_L250").unwrap();
    let beside = folder.write("quad.toml", vehicle.to_toml());
    assert_eq!(FlightLog::load(&log, None).unwrap().mapping, None);
    // A mapping that was named is what the user means.
    let error = FlightLog::load(&log, Some(&beside)).unwrap_err().to_string();
    assert!(error.contains("mapping file") && !error.contains("rename it"), "{error}");
    folder.write("quad.toml", "colour = \"red\"\n");
    let error = FlightLog::load(&log, None).unwrap_err().to_string();
    assert!(error.contains("read as its mapping") && error.contains("rename it"), "{error}");
}

#[test]
fn too_short_a_log_is_refused_and_says_so() {
    let mut rows = flight(20.0, 200.0);
    rows.cells.iter_mut().for_each(|c| c.truncate(3));
    let report = checked(&rows);
    assert_eq!((report.verdict, report.has(Fault::TooLittle)), (Severity::Refuse, true), "{report}");
}

/// A ULog file of the flight: north-east-down, forward-right-down, w x y z, µs.
fn px4_log(rows: &Rows) -> Vec<u8> {
    let get = |name: &str, i: usize| rows.cells[rows.index(name)][i];
    let row = |i: usize| {
        let turned = |names: [&str; 3]| [get(names[0], i), -get(names[1], i), -get(names[2], i)];
        let q = rows.attitude(i);
        let u = get("rotor1", i) / 3000.0;
        let values = [
            [turned(POSITION), turned(VELOCITY)].concat(),
            vec![q[3], q[0], -q[1], -q[2]],
            turned(RATES).to_vec(),
            turned(FORCE).to_vec(),
            vec![u, u, u, u, f64::NAN, f64::NAN],
            vec![get("vbat", i)],
        ];
        (5_000_000 + (get("t", i) * 1e6).round() as u64, values)
    };
    ulog::file((0..rows.cells[0].len()).map(row))
}

#[test]
fn a_px4_log_is_turned_into_our_frames() {
    let rows = flight(20.0, 200.0);
    let plain = load(&rows.text()).unwrap();
    let folder = Folder::new();
    let path = folder.0.path().join("log.ulg");
    let bytes = px4_log(&rows);
    std::fs::write(&path, &bytes).unwrap();
    let log = FlightLog::load(&path, None).unwrap();
    let report = check(&log);
    assert_eq!(faults(&report), [], "{report}");
    assert!((log.start_s - 5.0).abs() < 1e-9 && log.cmd_u.len() == 4);
    for i in (0..4000).step_by(97) {
        assert!((log.position_m.t_s[i] - plain.position_m.t_s[i]).abs() < 1e-6);
        for k in 0..3 {
            assert!((log.position_m.values[i][k] - plain.position_m.values[i][k]).abs() < 1e-6);
            assert!(
                (log.specific_force_m_s2.values[i][k] - plain.specific_force_m_s2.values[i][k]).abs() < 1e-5
            );
        }
        for k in 0..4 {
            assert!((log.attitude.values[i][k] - plain.attitude.values[i][k]).abs() < 1e-6);
        }
    }
    // A log that was cut off keeps what stands before the cut, and says so.
    std::fs::write(&path, &bytes[..bytes.len() / 2 + 5]).unwrap();
    let cut = FlightLog::load(&path, None).unwrap();
    assert!((cut.duration_s - 10.0).abs() < 0.2, "{}", cut.duration_s);
    assert!(cut.warnings.iter().any(|w| w.contains("ends inside a record")), "{:?}", cut.warnings);
}

#[test]
fn the_command_says_fine_found_or_error_by_its_exit_code() {
    let run = |args: &[&str]| {
        let out = std::process::Command::new(env!("CARGO_BIN_EXE_propwash"))
            .arg("log")
            .args(args)
            .env_remove("RUST_BACKTRACE")
            .output()
            .unwrap();
        let text = |b: &[u8]| String::from_utf8_lossy(b).into_owned();
        (out.status.code(), text(&out.stdout), text(&out.stderr))
    };
    let folder = Folder::new();
    let good = folder.write("good.csv", &flight(10.0, 200.0).text());
    let mut rows = flight(10.0, 200.0);
    rows.scale(&RATES, 180.0 / std::f64::consts::PI);
    let bad = folder.write("bad.csv", &rows.text());
    let (good, bad) = (good.to_str().unwrap(), bad.to_str().unwrap());
    let (code, out, _) = run(&["check", good]);
    assert!(code == Some(0) && out.contains("no problem found") && out.contains("200.0 Hz"), "{out}");
    let (code, out, _) = run(&["check", good, bad, "--json"]);
    let json: serde_json::Value = serde_json::from_str(&out).unwrap();
    assert_eq!(
        (code, json[1]["verdict"].as_str(), json[1]["findings"][0]["fault"].as_str()),
        (Some(1), Some("refuse"), Some("unit"))
    );
    let (code, _, error) = run(&["check", "nowhere.csv"]);
    assert!(code == Some(2) && error.contains("nowhere.csv: cannot be read"), "{error}");
    // A ULog with a parameter ('P') of no bytes, on which the parser panics; and a file without an end.
    let odd = folder.0.path().join("odd.ulg");
    let head = [&b"ULog\x01\x12\x35\x01"[..], &[0; 8], &[40, 0, b'B'], &[0; 40], &[0, 0, b'P']].concat();
    std::fs::write(&odd, head).unwrap();
    for (file, words) in [(odd.to_str().unwrap(), "the parser gives up"), ("/dev/zero", "a device or a pipe")]
    {
        let (code, out, error) = run(&["check", file]);
        assert!(code == Some(2) && out.is_empty() && error.contains(words), "{error}");
        assert!(error.contains(file) && error.trim_end().lines().count() == 1, "one line: {error}");
    }
    // The mapping that mends it: written, used from then on, and not written over; nothing is written for a good log.
    let mapping = folder.0.path().join("mend.toml");
    let written = mapping.to_str().unwrap();
    let (code, out, _) = run(&["check", bad, "--write-mapping", written]);
    assert!(code == Some(0) && out.contains("corrected: angular velocity: times 0.0174"), "{out}");
    assert_eq!(run(&["check", bad, "--mapping", written]).0, Some(0));
    let (code, _, error) = run(&["check", bad, "--write-mapping", written]);
    assert!(code == Some(2) && error.contains("--force"), "{error}");
    assert_eq!(run(&["check", bad, "--write-mapping", written, "--force"]).0, Some(0));
    let (code, _, error) = run(&["check", good, bad, "--write-mapping", written, "--force"]);
    assert!(code == Some(2) && error.contains("expected one log"), "{error}");
    let none = folder.0.path().join("none.toml");
    let (code, _, error) = run(&["check", good, "--write-mapping", none.to_str().unwrap()]);
    assert!(code == Some(0) && error.contains("nothing to correct") && !none.exists(), "{error}");
    let out = folder.0.path().join("good.parquet");
    assert_eq!(run(&["convert", good, "--out", out.to_str().unwrap()]).0, Some(0));
    assert_eq!(run(&["check", out.to_str().unwrap()]).0, Some(0));
}

/// A mistake in a log, given the clean rows too.
type Mistake = Box<dyn Fn(&mut Rows, &Rows)>;

/// Mistakes that the checker can name, alone and together.
fn mistakes() -> Vec<(&'static str, Vec<Mistake>)> {
    let per_degree = std::f64::consts::PI / 180.0;
    let scaled = |names: &'static [&'static str], factor: f64| {
        move |rows: &mut Rows, _: &Rows| rows.scale(names, factor)
    };
    let turned = |names: [&'static str; 3], f: fn([f64; 4], [f64; 3]) -> [f64; 3]| {
        move |rows: &mut Rows, base: &Rows| rows.three(names, |i, v| f(base.attitude(i), v))
    };
    let attitudes = |f: fn([f64; 4]) -> [f64; 4]| move |rows: &mut Rows, _: &Rows| rows.attitudes(f);
    let frd = |_: [f64; 4], v: [f64; 3]| [v[0], -v[1], -v[2]];
    vec![
        ("rates in deg/s", vec![Box::new(scaled(&RATES, 1.0 / per_degree))]),
        ("forces in g", vec![Box::new(scaled(&FORCE, 1.0 / G))]),
        ("velocity in mm/s", vec![Box::new(scaled(&VELOCITY, 1000.0))]),
        ("position in mm", vec![Box::new(scaled(&POSITION, 1000.0))]),
        (
            "rotors in rpm",
            vec![Box::new(scaled(&["rotor1", "rotor2", "rotor3", "rotor4"], 30.0 / std::f64::consts::PI))],
        ),
        ("battery in mV", vec![Box::new(scaled(&["vbat"], 1000.0))]),
        ("times in ms", vec![Box::new(scaled(&["t"], 1000.0))]),
        ("velocity in the body", vec![Box::new(turned(VELOCITY, quat::rotate_inverse))]),
        ("velocity turned", vec![Box::new(turned(VELOCITY, frd))]),
        ("velocity reversed", vec![Box::new(turned(VELOCITY, |_, v| v.map(|x| -x)))]),
        ("rates in the world", vec![Box::new(turned(RATES, quat::rotate))]),
        ("rates turned", vec![Box::new(turned(RATES, frd))]),
        ("forces in the world", vec![Box::new(turned(FORCE, quat::rotate))]),
        ("forces turned", vec![Box::new(turned(FORCE, frd))]),
        (
            "forces without gravity",
            vec![Box::new(turned(FORCE, |q, v| vec3::sub(v, quat::rotate_inverse(q, [0.0, 0.0, G]))))],
        ),
        (
            "accelerations in the world",
            vec![Box::new(turned(FORCE, |q, v| vec3::sub(quat::rotate(q, v), [0.0, 0.0, G])))],
        ),
        ("attitude the other way", vec![Box::new(attitudes(quat::conjugate))]),
        ("attitude w, x, y, z", vec![Box::new(attitudes(|q| [q[3], q[0], q[1], q[2]]))]),
        (
            "a log in ned and frd",
            vec![
                Box::new(turned(POSITION, frd)),
                Box::new(turned(VELOCITY, frd)),
                Box::new(turned(RATES, frd)),
                Box::new(turned(FORCE, frd)),
                Box::new(attitudes(|q| [q[0], -q[1], -q[2], q[3]])),
            ],
        ),
        (
            "several at once",
            vec![
                Box::new(scaled(&["t"], 1e6)),
                Box::new(turned(VELOCITY, quat::rotate_inverse)),
                Box::new(turned(RATES, frd)),
                Box::new(scaled(&RATES, 1.0 / per_degree)),
                Box::new(scaled(&FORCE, 1.0 / G)),
                Box::new(scaled(&["vbat"], 1000.0)),
            ],
        ),
    ]
}

/// Two channels have the same samples.
fn same(name: &str, a: &Channel<3>, b: &Channel<3>) {
    let apart = |a: &[f64; 3], b: &[f64; 3]| vec3::norm(vec3::sub(*a, *b));
    let worst = a.values.iter().zip(&b.values).map(|(a, b)| apart(a, b)).fold(0.0, f64::max);
    assert!(a.len() == b.len() && worst < 1e-6, "{name}: {worst}");
    let late = a.t_s.iter().zip(&b.t_s).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(late < 1e-6, "{name}: {late} s");
}

/// Every mistake that the checker can name is mended by the mapping that it writes: the log then reads as the clean one does.
#[test]
fn what_the_checker_finds_a_mapping_mends() {
    let base = flight(20.0, 200.0);
    let clean = load(&base.text()).unwrap();
    for (name, changes) in mistakes() {
        let mut rows = base.clone();
        changes.iter().for_each(|change| change(&mut rows, &base));
        let folder = Folder::new();
        let path = folder.write("log.csv", &rows.text());
        let mended = mend(&path, None).unwrap();
        let report = &mended.report;
        assert!(
            report.verdict == Severity::Info && mended.left.is_empty(),
            "{name}: {report}\n{}",
            mended.text
        );
        let mapping = folder.write("log.toml", &mended.text);
        let log = FlightLog::load(&path, Some(&mapping)).unwrap();
        assert_eq!(faults(&check(&log)), [], "{name}");
        same(name, &log.position_m, &clean.position_m);
        same(name, &log.velocity_m_s, &clean.velocity_m_s);
        same(name, &log.angular_velocity_rad_s, &clean.angular_velocity_rad_s);
        same(name, &log.specific_force_m_s2, &clean.specific_force_m_s2);
        for (a, b) in log.attitude.values.iter().zip(&clean.attitude.values) {
            assert!((0..4).map(|k| a[k] * b[k]).sum::<f64>().abs() > 1.0 - 1e-12, "{name}");
        }
        let rotor = |log: &FlightLog| log.rotor_speed_rad_s[0].values[100][0];
        assert!((rotor(&log) / rotor(&clean) - 1.0).abs() < 1e-9, "{name}");
        assert!((log.vbat_v.values[5][0] / clean.vbat_v.values[5][0] - 1.0).abs() < 1e-9, "{name}");
    }
}

/// Delays are shifted back to a millisecond, also of a mapping that names columns and has comments.
#[test]
fn delays_are_mended_beside_what_a_mapping_says() {
    for (names, seconds) in [(FORCE, 0.012), (RATES, -0.008), (VELOCITY, 0.024)] {
        let mut rows = flight(30.0, 250.0);
        rows.delay(&names, seconds);
        rows.rename("px", "pos_x");
        let folder = Folder::new();
        let path = folder.write("log.csv", &rows.text());
        folder.write("log.toml", "contract_names = true # ours\n[columns]\npx = \"pos_x\"\n");
        let mended = mend(&path, None).unwrap();
        assert!(mended.report.verdict == Severity::Info, "{names:?}: {}\n{}", mended.report, mended.text);
        assert!(mended.text.contains("# ours") && mended.text.contains("px = \"pos_x\""), "{}", mended.text);
        let shift: f64 =
            mended.text.lines().find_map(|l| l.strip_prefix("shift_s = ")).unwrap().parse().unwrap();
        assert!((shift + seconds).abs() < 1e-3, "{names:?}: {shift} for {seconds}");
    }
}

/// An attitude that is north-east-down beside positions that are not leans the other way.
#[test]
fn an_attitude_in_another_frame_than_the_position_is_found_by_its_lean() {
    let mut rows = flight(20.0, 200.0);
    rows.attitudes(|q| [q[0], -q[1], -q[2], q[3]]);
    rows.drop(&["wx", "wy", "wz", "ax", "ay", "az"]);
    finds(&rows, Severity::Refuse, Fault::AttitudeFrame, "the attitude is north-east-down");
    let folder = Folder::new();
    let mended = mend(&folder.write("log.csv", &rows.text()), None).unwrap();
    assert!(mended.report.verdict == Severity::Info, "{}\n{}", mended.report, mended.text);
}

#[test]
fn wrong_corrections_get_a_sentence() {
    let folder = Folder::new();
    let path = folder.write("log.csv", &flight(10.0, 200.0).text());
    for (text, words) in [
        ("time_scale = 0.0", "time_scale"),
        ("[channel.velocity]\nshift_s = nan", "channel.velocity.shift_s"),
        ("[channel.velocity]\nscale = 0.0", "channel.velocity.scale"),
        ("[channel.speed]\nscale = 2.0", "channel.speed"),
        ("[channel.vbat]\naxes = [\"x\", \"y\", \"z\"]", "channel.vbat.axes"),
        ("[channel.velocity]\naxes = [\"x\", \"x\", \"z\"]", "channel.velocity.axes"),
        ("[channel.attitude]\naxes = [\"x\", \"y\", \"-z\"]", "right-handed"),
        ("[channel.position]\nframe = \"body\"", "channel.position.frame"),
        ("[channel.velocity]\ngravity = \"removed\"", "channel.velocity.gravity"),
        ("[channel.velocity]\nshift = 0.1", "shift"),
        ("[channel.velocity]\nframe = \"moon\"", "moon"),
    ] {
        let mapping = folder.write("m.toml", text);
        let error = FlightLog::load(&path, Some(&mapping)).unwrap_err().to_string();
        assert!(error.contains(words) && error.contains("m.toml"), "{text}: {error}");
    }
}

/// The mappings of docs/logs.md, each a block of TOML.
#[test]
fn every_mapping_of_the_page_is_one() {
    let page = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/logs.md")).unwrap();
    let blocks: Vec<&str> = page.split("```toml\n").skip(1).map(|b| b.split("```").next().unwrap()).collect();
    assert!(blocks.len() >= 3);
    for block in blocks {
        Mapping::parse(block, Path::new("docs/logs.md")).unwrap();
    }
}

/// A folder of real logs beside the repository.
fn real(name: &str) -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data").join(name);
    if !folder.is_dir() {
        println!("skipped: {} is not there", folder.display());
        return None;
    }
    Some(folder)
}

#[test]
fn the_blackbird_logs_are_sound_and_their_inertial_sensor_lags() {
    let Some(folder) = real("blackbird") else { return };
    for (file, samples) in [("clover_5mps_test.csv", 3000), ("clover_5mps_train.csv", 9100)] {
        let log = FlightLog::load(&folder.join(file), None).unwrap();
        let report = check(&log);
        assert!(report.verdict < Severity::Refuse, "{report}");
        assert!(
            report.channels.iter().all(|c| c.samples == samples && (c.rate_hz - 100.0).abs() < 0.1),
            "{report}"
        );
        // The README says that the inertial sensor lags by about 6 ms.
        let gyro = report.delays.iter().find(|d| d.channel == "angular velocity").unwrap();
        assert!(gyro.certain && (1e-3..8e-3).contains(&gyro.lag.lag_s), "{gyro:?}");
        let force = report.delays.iter().find(|d| d.channel == "specific force").unwrap();
        assert!(force.certain && (0.0..9e-3).contains(&force.lag.lag_s), "{force:?}");
    }
}

#[test]
fn the_crazyswarm_logs_are_read_at_250_hz_without_a_gyro() {
    let Some(folder) = real("crazyswarm_payload") else { return };
    for (file, samples) in [
        ("log201.csv", 4095),
        ("log202.csv", 2292),
        ("log203.csv", 1927),
        ("log204.csv", 1756),
        ("log205.csv", 1757),
    ] {
        let log = FlightLog::load(&folder.join(file), None).unwrap();
        assert_eq!(log.objects_m["payload"].len(), samples);
        assert!(log.angular_velocity_rad_s.is_empty());
        let report = check(&log);
        assert!(report.verdict < Severity::Refuse, "{report}");
        assert!(report.channels.iter().all(|c| (c.rate_hz - 250.0).abs() < 0.1), "{report}");
        assert!(report.findings.iter().any(|f| f.text.contains("no angular velocity")), "{report}");
    }
}

#[test]
fn nothing_of_a_real_flight_is_taken_for_ground_crash_or_outlier() {
    for (name, logs) in [("blackbird", 2), ("crazyswarm_payload", 5), ("imrc_brushless", 6)] {
        let Some(folder) = real(name) else { continue };
        let mut seen = 0;
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.extension().is_none_or(|e| e != "csv") {
                continue;
            }
            seen += 1;
            let log = FlightLog::load(&path, None).unwrap();
            let cut = look(&log, &Known::default());
            let said = cut.words();
            println!("{}: {said:?}", path.display());
            // One estimator is corrected by its cameras in a step of 6 cm at 0.7 s.
            let jumps = if path.ends_with("eckart27.csv") { 0.1 } else { 0.0 };
            let whole: f64 = cut.excluded.iter().filter(|e| e.whole()).map(|e| e.to_s - e.from_s).sum();
            assert!(whole <= jumps, "{}: {said:?}", path.display());
            for o in &cut.outliers {
                assert!(o.t_s.len() * 1000 < o.of, "{}: {said:?}", path.display());
            }
            // Gaps of the first rows of a file, and values that an estimator holds.
            let gaps: f64 =
                cut.excluded.iter().filter(|e| e.channel == "position").map(|e| e.to_s - e.from_s).sum();
            assert!(gaps < 0.2, "{}: {said:?}", path.display());
        }
        assert_eq!(seen, logs);
    }
}

#[test]
fn a_stay_on_the_ground_is_told_as_a_note_and_outliers_as_a_warning() {
    let mut rows = flight(20.0, 200.0);
    let n = rows.cells[0].len();
    // The last four seconds on the ground, idling.
    let place: Vec<f64> = ["px", "py", "pz"].iter().map(|c| rows.column(c)[n - 801]).collect();
    for i in n - 800..n {
        for (k, name) in POSITION.iter().enumerate() {
            rows.column(name)[i] = place[k] + 3e-4 * noise(i, 30 + k as u64);
        }
        for (name, value) in ["qx", "qy", "qz", "qw"].iter().zip([0.0, 0.0, 0.0, 1.0]) {
            rows.column(name)[i] = value + 1e-3 * noise(i, 33);
        }
        for name in VELOCITY.iter().chain(&RATES) {
            rows.column(name)[i] = 0.01 * noise(i, 34);
        }
        for (name, value) in FORCE.iter().zip([0.0, 0.0, G]) {
            rows.column(name)[i] = value + 0.1 * noise(i, 35);
        }
        for k in 1..=4 {
            rows.column(&format!("rotor{k}"))[i] = 300.0 + 5.0 * noise(i, 40 + k);
        }
    }
    let report = checked(&rows);
    let note = report.findings.iter().find(|f| f.fault == Fault::NoFlight).unwrap();
    assert_eq!(note.severity, Severity::Info, "{report}");
    assert!(note.text.starts_with("left out: 4.3 s on the ground (15.7–20.0 s)"), "{report}");
    let mut rows = flight(20.0, 200.0);
    for i in (100..3900).step_by(300) {
        rows.column("px")[i] += 0.04;
    }
    finds(&rows, Severity::Warning, Fault::Glitch, "position has 13 samples far from their neighbours");
}
