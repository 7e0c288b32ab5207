//! What no flight model can explain is left out of an analysis and said: the ground, motors off, crashes, gaps, outliers.
//! And good logs are not refused: slow ones, held ones, hard turns, short held-out logs.

#[path = "common/notes.rs"]
mod notes;
#[path = "common/planted/mod.rs"]
mod planted;

use planted::{Excitation, NoiseLevel, Plan, Sensors, fly};
use propwash::flight::usable::{Known, look};
use propwash::flight::{FlightLog, Reason, Unusable};
use propwash::gap::compare::{compare, one_vehicle};
use propwash::gap::diagnose::{Settings, diagnose};
use propwash::gap::{GapError, Options, Track};
use propwash::math::quat;
use propwash::vehicle::Vehicle;
use std::path::Path;

const G: f64 = 9.81;

fn vehicle() -> Vehicle {
    Vehicle::load(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/planted_quad.toml")).unwrap()
}

fn read(csv: &str) -> FlightLog {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flight.csv");
    std::fs::write(&path, csv).unwrap();
    FlightLog::open(&path, None).unwrap().0
}

/// A flight of the generator.
fn flown(
    v: &Vehicle,
    hidden: &[&'static str],
    excitation: Excitation,
    seconds: f64,
    noise: NoiseLevel,
) -> FlightLog {
    let mut plan = Plan::exciting(v, hidden, seconds, 3);
    plan.excitation = excitation;
    plan.noise = noise;
    plan.sensors = Sensors { rotors: true, ..Sensors::default() };
    read(fly(&plan).unwrap().csv())
}

fn track(log: FlightLog) -> Result<Track, GapError> {
    Track::new(log, &vehicle(), &Options::default())
}

/// What a log says when nothing is known of the vehicle.
fn found(log: &FlightLog) -> Unusable {
    look(log, &Known::default())
}

/// Appends `seconds` on the ground: a fall with motors off, then nothing moves.
fn landed(log: &mut FlightLog, seconds: f64, idle_rad_s: f64) -> f64 {
    let end = log.duration_s;
    let place = *log.position_m.values.last().unwrap();
    let fall_s = (2.0 * (place[2] - 0.02) / G).sqrt();
    let (pose_s, imu_s) = (1.0 / 240.0, 0.002);
    let wobble = |i: usize, k: usize| ((i * 7919 + k * 104_729) as f64 * 0.618).sin();
    for i in 1..(seconds / pose_s) as usize {
        let t = i as f64 * pose_s;
        let z = if t < fall_s { place[2] - 0.5 * G * t * t } else { 0.02 };
        log.position_m.push(end + t, [place[0], place[1], z].map(|x| x + 3e-4 * wobble(i, 0)));
        let tilt = if t < fall_s { 0.3 } else { 0.02 };
        log.attitude.push(end + t, quat::exp([tilt + 2e-3 * wobble(i, 1), 2e-3 * wobble(i, 2), 0.0]));
    }
    for i in 1..(seconds / imu_s) as usize {
        let t = i as f64 * imu_s;
        let force = if t < fall_s { 0.0 } else { G };
        log.specific_force_m_s2
            .push(end + t, [0.1 * wobble(i, 3), 0.1 * wobble(i, 4), force + 0.1 * wobble(i, 5)]);
        log.angular_velocity_rad_s.push(end + t, std::array::from_fn(|k| 0.01 * wobble(i, 6 + k)));
        for c in log.cmd_rotor_rad_s.iter_mut().chain(&mut log.rotor_speed_rad_s) {
            c.push(end + t, [idle_rad_s]);
        }
    }
    log.duration_s = end + seconds;
    end
}

#[test]
fn flights_of_every_kind_keep_all_but_a_thousandth() {
    let v = vehicle();
    for excitation in [
        Excitation::MultiSine,
        Excitation::LowPass,
        Excitation::Lissajous,
        Excitation::Circle,
        Excitation::HoverYaw,
        Excitation::Steps,
        Excitation::Waypoints,
    ] {
        for noise in [NoiseLevel::Fine, NoiseLevel::Rough] {
            let log = flown(&v, &[], excitation, 30.0, noise);
            let cut = found(&log);
            let whole: Vec<_> = cut.excluded.iter().filter(|e| e.whole()).collect();
            assert!(whole.is_empty(), "{excitation:?} {noise:?}: {whole:?}");
            for o in &cut.outliers {
                assert!(o.t_s.len() * 1000 < o.of, "{excitation:?} {noise:?} {}: {}", o.channel, o.t_s.len());
            }
            // The generator loses a tenth to a fifth of a second at most.
            let dropped: f64 =
                cut.excluded.iter().filter(|e| e.channel == "position").map(|e| e.to_s - e.from_s).sum();
            assert!(dropped < 0.3, "{excitation:?} {noise:?}: {:?}", cut.words());
        }
    }
}

#[test]
fn a_landing_is_found_and_left_out_with_the_fall_before_it() {
    let v = vehicle();
    // At rest, and idling at a fifteenth of the speed of hover.
    for idle in [0.0, 70.0] {
        let mut log = flown(&v, &[], Excitation::MultiSine, 12.0, NoiseLevel::Fine);
        let end = landed(&mut log, 6.0, idle);
        let t = track(log).unwrap();
        let ground: Vec<_> = t.excluded.iter().filter(|e| e.reason == Reason::OnGround).collect();
        assert_eq!(ground.len(), 1, "{:?}", t.excluded);
        let from = ground[0].from_s;
        assert!(from <= end + 0.1 && from > end - 0.5 && ground[0].to_s > end + 5.9, "{ground:?}");
        assert!(t.span_s[1] <= from + 1e-9 && t.span_s[1] > end - 0.5, "{:?}", t.span_s);
        let said: Vec<&String> = t.warnings.iter().filter(|w| w.contains("on the ground")).collect();
        assert!(said.len() == 1 && said[0].starts_with("left out: 6."), "{:?}", t.warnings);
    }
}

#[test]
fn a_landing_does_not_change_what_is_compared() {
    let v = vehicle();
    let clean = flown(&v, &["linear_drag"], Excitation::MultiSine, 12.0, NoiseLevel::Fine);
    let mut long = clean.clone();
    landed(&mut long, 8.0, 70.0);
    let force = |log: FlightLog| compare(&[track(log).unwrap()], &v).unwrap().logs[0].one_step.force.rms;
    let (a, b) = (force(clean), force(long));
    for k in 0..3 {
        assert!((a[k] / b[k] - 1.0).abs() < 0.05, "{a:?} {b:?}");
    }
}

#[test]
fn a_flight_of_which_too_little_is_left_is_refused_with_what_was_cut() {
    let v = vehicle();
    let mut log = flown(&v, &[], Excitation::MultiSine, 2.4, NoiseLevel::Fine);
    landed(&mut log, 20.0, 70.0);
    let error = track(log).unwrap_err();
    assert!(matches!(error, GapError::TooShort { .. }), "{error}");
    let text = error.to_string();
    assert!(text.contains("at least 2 s") && text.contains("on the ground"), "{text}");
}

#[test]
fn motors_commanded_off_in_the_air_are_left_out_and_slow_measured_ones_are_not() {
    let v = vehicle();
    let mut log = flown(&v, &[], Excitation::MultiSine, 12.0, NoiseLevel::Fine);
    let cut = |c: &mut propwash::flight::Channel<1>, to: f64| {
        for (t, v) in c.t_s.iter().zip(&mut c.values) {
            if (6.0..6.4).contains(t) {
                v[0] = to;
            }
        }
    };
    let mut commanded = log.clone();
    commanded.cmd_rotor_rad_s.iter_mut().for_each(|c| cut(c, 45.0));
    let spans: Vec<_> = found(&commanded).excluded.into_iter().filter(|e| e.whole()).collect();
    assert_eq!(spans.len(), 1, "{spans:?}");
    assert_eq!(spans[0].reason, Reason::MotorsOff);
    assert!((spans[0].from_s - 6.0).abs() < 0.02 && (spans[0].to_s - 6.5).abs() < 0.03, "{spans:?}");
    // Measured speeds are inputs, whatever they are, unless the sensors read nothing.
    log.cmd_rotor_rad_s.clear();
    let mut slow = log.clone();
    slow.rotor_speed_rad_s.iter_mut().for_each(|c| cut(c, 200.0));
    assert!(found(&slow).excluded.iter().all(|e| !e.whole()));
    log.rotor_speed_rad_s.iter_mut().for_each(|c| cut(c, 0.0));
    assert!(found(&log).excluded.iter().any(|e| e.reason == Reason::MotorsOff));
}

#[test]
fn a_crash_is_left_out_to_the_end_and_a_knock_only_around_it() {
    let v = vehicle();
    let log = flown(&v, &[], Excitation::MultiSine, 12.0, NoiseLevel::Fine);
    // A knock that turns the velocity round, after which the flight goes on as it was, mirrored.
    let knocked = |by_m_s: f64| {
        let mut log = log.clone();
        for (t, p) in log.position_m.t_s.iter().zip(&mut log.position_m.values) {
            p[0] += by_m_s * (t - 8.0).max(0.0);
        }
        for (t, a) in log.specific_force_m_s2.t_s.iter().zip(&mut log.specific_force_m_s2.values) {
            if (8.0..8.006).contains(t) {
                a[0] += 250.0 * by_m_s.signum();
            }
        }
        log
    };
    let spans = |log: &FlightLog| -> Vec<_> {
        found(log).excluded.into_iter().filter(|e| e.reason == Reason::Crash).collect()
    };
    let knock = spans(&knocked(5.0));
    assert_eq!(knock.len(), 1, "{knock:?}");
    assert!(knock[0].from_s < 7.8 && knock[0].to_s > 8.3 && knock[0].to_s < 8.8, "{knock:?}");
    // The accelerometer alone is an outlier.
    assert!(spans(&knocked(0.001)).is_empty());
    // Not upright afterwards: no flight.
    let mut log = knocked(5.0);
    for (t, q) in log.attitude.t_s.iter().zip(&mut log.attitude.values) {
        if *t > 8.05 {
            *q = quat::mul(*q, quat::exp([3.0, 0.0, 0.0]));
        }
    }
    let crash = spans(&log);
    assert!(crash.len() == 1 && crash[0].to_s > 11.9, "{crash:?}");
}

#[test]
fn outliers_of_motion_capture_are_left_out_and_counted_once() {
    let v = vehicle();
    for noise in [NoiseLevel::Fine, NoiseLevel::Rough] {
        let clean = flown(&v, &[], Excitation::MultiSine, 20.0, noise);
        let mut log = clean.clone();
        // One in 300: far beyond the noise of 0.3 mm, or of 3 to 10 mm.
        let size = if noise == NoiseLevel::Fine { 0.03 } else { 0.4 };
        let (mut moved, mut turned) = (Vec::new(), Vec::new());
        for i in (100..log.position_m.len() - 100).step_by(300) {
            log.position_m.values[i][i % 3] += size;
            moved.push(log.position_m.t_s[i]);
            let j = i + 50;
            log.attitude.values[j] = quat::mul(log.attitude.values[j], quat::exp([0.0, 0.15, 0.0]));
            turned.push(log.attitude.t_s[j]);
        }
        let t = track(log).unwrap();
        for (name, times) in [("position", &moved), ("attitude", &turned)] {
            let own = found(&t.log).outliers.into_iter().find(|o| o.channel == name).unwrap();
            let missed = times.iter().filter(|t| !own.t_s.contains(t)).count();
            let wrong = own.t_s.iter().filter(|t| !times.contains(t)).count();
            assert!(
                missed == 0 && wrong * 1000 <= own.of,
                "{noise:?} {name}: {missed} missed, {wrong} wrong"
            );
        }
        let said: Vec<&String> = t.warnings.iter().filter(|w| w.contains("outlier")).collect();
        assert!(
            said.len() == 1 && said[0].contains("of position") && said[0].contains("of attitude"),
            "{said:?}"
        );
        // What is compared is as if they had never been.
        let errors = |t: Track| compare(&[t], &v).unwrap().logs[0].horizons[2].error.position_m;
        let (a, b) = (errors(track(clean).unwrap()), errors(t));
        assert!((a / b - 1.0).abs() < 0.1, "{a} {b}");
    }
}

#[test]
fn gaps_are_said_once_for_all_channels() {
    let v = vehicle();
    let mut log = flown(&v, &[], Excitation::MultiSine, 12.0, NoiseLevel::Fine);
    let own = found(&log).excluded.iter().filter(|e| e.channel == "position").count();
    for (from, to) in [(3.0, 3.1), (7.0, 7.14), (9.0, 9.05)] {
        let lost = |t: &[f64]| t.iter().map(|t| *t >= from && *t < to).collect::<Vec<bool>>();
        log.position_m = propwash::flight::clean::without(&log.position_m, &lost(&log.position_m.t_s));
        log.attitude = propwash::flight::clean::without(&log.attitude, &lost(&log.attitude.t_s));
    }
    let t = track(log).unwrap();
    let said: Vec<&String> = t.warnings.iter().filter(|w| w.contains("gap")).collect();
    assert_eq!(said.len(), 1, "{:?}", t.warnings);
    assert!(said[0].contains(&format!("{} gaps of the pose, the longest", own + 3)), "{said:?}");
}

#[test]
fn logs_of_50_hz_without_an_accelerometer_are_diagnosed() {
    let v = vehicle();
    let mut log = flown(&v, &["linear_drag"], Excitation::MultiSine, 40.0, NoiseLevel::Fine);
    fn every<const N: usize>(c: &mut propwash::flight::Channel<N>) {
        let mut next = 0.0;
        let lost: Vec<bool> = c
            .t_s
            .iter()
            .map(|t| {
                let take = *t >= next;
                next += if take { 0.02 } else { 0.0 };
                !take
            })
            .collect();
        *c = propwash::flight::clean::without(c, &lost);
    }
    let curve = v.drone("first_principles").unwrap();
    let first = log.rotor_speed_rad_s[0].clone();
    for i in 0..first.len() {
        let speeds: [f64; 8] = std::array::from_fn(|k| {
            log.rotor_speed_rad_s.get(k).map_or(0.0, |c| c.values[i.min(c.len() - 1)][0])
        });
        let thrust: f64 = propwash::physics::airframe::loads(&curve.airframe, &speeds).thrust.iter().sum();
        log.thrust_n.push(first.t_s[i], [thrust]);
    }
    log.rotor_speed_rad_s.clear();
    log.cmd_rotor_rad_s.clear();
    log.specific_force_m_s2 = Default::default();
    log.angular_velocity_rad_s = Default::default();
    every(&mut log.position_m);
    every(&mut log.attitude);
    every(&mut log.thrust_n);
    let t = track(log).unwrap();
    let verdict = diagnose(&[t], &v, &Settings::default()).unwrap().verdict;
    notes::tell(&format!("50 Hz, thrust, no accelerometer: {}", verdict.verdict));
}

#[test]
fn held_samples_leave_most_instants() {
    let v = vehicle();
    let mut log = flown(&v, &[], Excitation::MultiSine, 20.0, NoiseLevel::Rough);
    fn hold<const N: usize>(c: &mut propwash::flight::Channel<N>, salt: usize) {
        for i in 1..c.len() {
            let draw = ((i * 7919 + salt * 104_729) as f64 * 0.754_877_666).fract();
            if draw < 0.27 {
                c.values[i] = c.values[i - 1];
            }
        }
    }
    // All on the slowest clock, as loggers write them.
    let rows = log.position_m.t_s.clone();
    let gyro = propwash::flight::resample::linear(&log.angular_velocity_rad_s, &rows, 0.1);
    let accel = propwash::flight::resample::linear(&log.specific_force_m_s2, &rows, 0.1);
    let both = |list: Vec<Option<[f64; 3]>>| {
        let mut out = propwash::flight::Channel::<3>::default();
        rows.iter().zip(list).for_each(|(t, v)| v.into_iter().for_each(|v| out.push(*t, v)));
        out
    };
    (log.angular_velocity_rad_s, log.specific_force_m_s2) = (both(gyro), both(accel));
    hold(&mut log.position_m, 1);
    hold(&mut log.attitude, 1);
    hold(&mut log.angular_velocity_rad_s, 1);
    hold(&mut log.specific_force_m_s2, 1);
    let c = compare(&[track(log).unwrap()], &v).unwrap();
    let one = &c.logs[0].one_step;
    notes::tell(&format!("27 % held: {} of 4000 instants", one.n));
    // 2727 as measured.
    assert!(one.n > 2400, "{} instants of 4000", one.n);
}

#[test]
fn hard_turns_and_a_hover_are_flights_of_one_vehicle() {
    let v = vehicle();
    let turns = flown(&v, &[], Excitation::Circle, 15.0, NoiseLevel::Fine);
    // The same turns with twice the load: thrust, speed and specific force together.
    let mut hard = turns.clone();
    hard.cmd_rotor_rad_s.iter_mut().chain(&mut hard.rotor_speed_rad_s).for_each(|c| {
        c.values.iter_mut().for_each(|v| v[0] *= 2f64.sqrt());
    });
    let heavy = hard.clone();
    hard.specific_force_m_s2.values.iter_mut().for_each(|a| *a = a.map(|x| 2.0 * x));
    let two =
        |a: &FlightLog, b: &FlightLog| one_vehicle(&[track(a.clone()).unwrap(), track(b.clone()).unwrap()]);
    two(&turns, &hard).unwrap();
    // Twice the thrust at the same load is another vehicle.
    let error = two(&turns, &heavy).unwrap_err().to_string();
    assert!(error.contains("load factor"), "{error}");
}

/// A flight under attitude and thrust commands of a vehicle with linear drag whose thrust follows its command ten times as fast
/// as the vehicle file says.
fn attitude_commands(truth: &Vehicle) -> FlightLog {
    use propwash::physics::effects::Command;
    use propwash::physics::integrate::Integrator;
    use propwash::physics::measure::Reading;
    use propwash::physics::rigid_body::State;
    use propwash::physics::surroundings::Surroundings;
    use std::fmt::Write as _;
    let drone = truth.drone("so_rpy_rotor_drag").unwrap();
    let hover = drone.hover_thrust();
    let around = Surroundings::calm();
    let mut state = State { pos: [0.0, 0.0, 3.0], thrust: hover, ..State::rest() };
    let mut csv =
        String::from("t,px,py,pz,qx,qy,qz,qw,wx,wy,wz,ax,ay,az,cmd_roll,cmd_pitch,cmd_yaw,cmd_thrust\n");
    let wobble = |i: usize, k: usize| 1.7 * ((i * 7919 + k * 104_729) as f64 * 0.618).sin();
    let mut command = [0.0; 4];
    for i in 0..20_000 {
        let t = i as f64 * 1e-3;
        if i % 4 == 0 {
            let back = |k: usize| (0.15 * state.pos[k] + 0.2 * state.vel[k]).clamp(-0.3, 0.3);
            let lift = 1.0 + 0.3 * (3.0 - state.pos[2]) - 0.3 * state.vel[2]
                + 0.25 * (if (7.3 * t).sin() > 0.0 { 1.0 } else { -1.0 });
            command = [
                back(1) + 0.35 * (2.1 * t).sin(),
                -back(0) + 0.35 * (1.7 * t).cos(),
                0.4 * (0.9 * t).sin(),
                hover * lift.clamp(0.4, 1.6),
            ];
        }
        let rate = drone.rate(&state, &Command::Attitude(command), &around);
        if i % 4 == 0 {
            let r = Reading::ideal(&state, &rate, drone.body.gravity_m_s2);
            let turn = [0, 1, 2].map(|k| 2e-3 * wobble(i, k));
            let mut row = vec![t];
            row.extend((0..3).map(|k| r.pos[k] + 3e-4 * wobble(i, 3 + k)));
            row.extend(quat::mul(r.quat, quat::exp(turn)));
            row.extend((0..3).map(|k| r.gyro[k] + 0.01 * wobble(i, 6 + k)));
            row.extend((0..3).map(|k| r.accel[k] + 0.1 * wobble(i, 9 + k)));
            row.extend(command);
            let cells: Vec<String> = row.iter().map(f64::to_string).collect();
            writeln!(csv, "{}", cells.join(",")).unwrap();
        }
        state = Integrator::Rk4.step(&state, 1e-3, |s| drone.rate(s, &Command::Attitude(command), &around));
    }
    read(&csv)
}

/// The abstracted response of the vehicle file of this test; thrust follows its command at such a rate.
fn with_response(rate_per_s: f64, drag: bool) -> Vehicle {
    let text = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/planted_quad.toml"))
        .unwrap();
    let text = text.split("[[effect").next().unwrap();
    let response = format!(
        "\n[attitude_response.so_rpy_rotor_drag]\nthrust_offset_n = 0.0\nthrust_scale = 1.0\nthrust_rate_per_s = {rate_per_s:?}\n\
         angle_gain_per_s2 = [-120.0, -120.0, -16.0]\nrate_gain_per_s = [-17.0, -17.0, -7.0]\n\
         command_gain_per_s2 = [120.0, 120.0, 16.0]\n"
    );
    let effect = if drag {
        "\n[[effect]]\nkind = \"linear_drag\"\ndrag_n_s_per_m = [[0.25, 0.0, 0.0], [0.0, 0.25, 0.0], [0.0, 0.0, 0.2]]\n"
    } else {
        ""
    };
    Vehicle::from_toml("quad", &format!("{text}{response}{effect}")).unwrap()
}

#[test]
fn attitude_commands_gemv_dimensions_mismatch() {
    // The search walked the motors' lag below nothing, where thrust runs away and no window has finite slopes.
    let filed = with_response(28.0, false);
    let log = attitude_commands(&with_response(280.0, true));
    let t = Track::new(log, &filed, &Options::default()).unwrap();
    let d = diagnose(&[t], &filed, &Settings::default()).unwrap().verdict;
    notes::tell(&format!("attitude commands: {}", d.verdict));
    for f in &d.findings {
        assert!(f.parameters.iter().all(|p| p.value.is_finite()), "{f:?}");
        if f.kind == "motor_lag" {
            assert!(f.parameters.iter().all(|p| p.value > 0.0), "{f:?}");
        }
    }
    assert!(d.findings.iter().any(|f| f.id == "linear_drag"), "{}", d.verdict);
}
