//! Checks the linearisation against finite differences, on a simulated flight.

use super::fit::{Cut, Prepared, Starts, linearise};
use super::model::{Enters, Model, Parameter};
use super::replay::{Around, Raw, STEP, drive};
use super::slow_errors::slow_errors;
use super::track::{Options, Track};
use propwash_flight::{FlightLog, Format};
use propwash_physics::drone::Drone;
use propwash_physics::effects::Command;
use propwash_physics::integrate::Integrator;
use propwash_physics::measure::Reading;
use propwash_physics::rigid_body::{MAX_ROTORS, State};
use propwash_physics::surroundings::Surroundings;
use propwash_trace::Real;
use propwash_trace::dual::Dual;
use propwash_trace::math::{quat, vec3};
use propwash_vehicle::Vehicle;
use std::path::Path;

fn vehicle() -> Vehicle {
    Vehicle::from_toml("quad", include_str!("../../../tests/data/planted_quad.toml")).unwrap()
}

/// A few seconds of turning and climbing, by commands that change every 4 ms, with ideal sensors; a simple attitude law
/// keeps the vehicle upright.
fn flight(drone: &Drone<f64>, seconds: u32) -> FlightLog {
    let mut log = FlightLog::empty(Path::new("made.csv"), "0".repeat(64), Format::Csv);
    log.cmd_rotor_rad_s = vec![Default::default(); 4];
    let hover = drone.hover_rotor_vel()[0];
    let mut state = State { pos: [0.0, 0.0, 1.2], rotor_vel: drone.hover_rotor_vel(), ..State::rest() };
    let mut command = [0.0; MAX_ROTORS];
    for k in 0..1000 * seconds {
        let t = f64::from(k) * 1e-3;
        if k % 4 == 0 {
            let q = state.quat;
            let want = [0.35 * (2.0 * t).sin(), 0.3 * (1.7 * t).cos(), 0.0];
            let error = [want[0] - 2.0 * q[0], want[1] - 2.0 * q[1], 0.6 * (1.1 * t).sin()];
            let torque: [f64; 3] =
                core::array::from_fn(|i| 0.09 * error[i] - [0.02, 0.02, 0.004][i] * state.ang_vel[i]);
            let lift = 0.06 * (3.1 * t).sin() + 0.03 * (9.0 * t).sin();
            for i in 0..4 {
                let r = &drone.airframe.rotors[i];
                let along = r.position_m[1] * torque[0] - r.position_m[0] * torque[1];
                let share = lift + 10.0 * along + 4.0 * r.spin * torque[2];
                command[i] = hover * (1.0 + share).clamp(0.5, 1.4);
            }
            for i in 0..4 {
                log.cmd_rotor_rad_s[i].push(t, [command[i]]);
            }
        }
        let around = Surroundings { ground_distance_m: state.pos[2], ..Surroundings::calm() };
        let rate = drone.rate(&state, &Command::Rotors(command), &around);
        let reading = Reading::ideal(&state, &rate, drone.body.gravity_m_s2);
        if k % 4 == 0 {
            log.position_m.push(t, reading.pos);
            log.attitude.push(t, reading.quat);
        }
        if k % 2 == 0 {
            log.angular_velocity_rad_s.push(t, reading.gyro);
            log.specific_force_m_s2.push(t, reading.accel);
        }
        state = Integrator::Rk4.step(&state, 1e-3, |s| drone.rate(s, &Command::Rotors(command), &around));
    }
    log.duration_s = f64::from(seconds);
    log
}

fn made() -> (Vehicle, Drone<f64>, Track) {
    let vehicle = vehicle();
    let drone = vehicle.drone("first_principles").unwrap();
    let options = Options { ceiling_z_m: Some(3.0), ..Options::default() };
    let track = Track::new(flight(&drone, 3), &vehicle, &options).unwrap();
    (vehicle, drone, track)
}

#[test]
fn what_the_file_states_with_a_sigma_is_a_prior_and_is_not_searched() {
    let text = include_str!("../../../tests/data/planted_quad.toml")
        .replacen("mass_kg = 0.75\n", "mass_kg = 0.75\nsigma = { mass_kg = 0.003, inertia_kg_m2.0.0 = 5e-5 }\n", 1)
        .replacen("radius_m = 0.0635\n", "radius_m = 0.0635\nsigma = { thrust_curve_n_per_rad_s.2 = 3.2e-8, time_constant_up_s = 0.003 }\n", 1)
        .replacen(
            "kind = \"linear_drag\"\n",
            "kind = \"linear_drag\"\nsigma = { drag_n_s_per_m = [[0.01, 0.0, 0.0], [0.0, 0.02, 0.0], [0.0, 0.0, 0.03]] }\n",
            1,
        );
    let measured = Vehicle::from_toml("quad", &text).unwrap();
    let (drone, track) = (measured.drone("first_principles").unwrap(), made().2);
    let around = Around::new(&track, &drone);
    let of = |vehicle: &Vehicle| Model::new(&drone, &[&track], &[&around]).unwrap().held_to(vehicle);
    let model = of(&measured);
    let prior = |kind: &str, name: &str| {
        let of = |p: &&Parameter| model.candidates[p.candidate].kind == kind && p.name == name;
        let p = model.parameters.iter().find(of).unwrap();
        (p.spike, model.may[p.candidate])
    };
    let near = |(sigma, may): (f64, bool), expected: (f64, bool)| {
        assert!(
            (sigma / expected.0 - 1.0).abs() < 1e-9 && may == expected.1,
            "{sigma} {may}, expected {expected:?}"
        );
    };
    near(prior("wrong_mass", "factor"), (0.004, false));
    near(prior("wrong_inertia", "factor.0"), (0.02, false));
    near(prior("thrust_scale", "factor"), (0.02, false));
    near(prior("linear_drag", "drag_n_s_per_m.1.1"), (0.02, false));
    // Of two times one is stated: the other is searched, and so are both.
    near(prior("motor_lag", "spin_up_factor"), (0.1, true));
    let plain = Model::new(&drone, &[&track], &[&around]).unwrap();
    let as_before = |name: &str| {
        let k = model.parameters.iter().position(|p| p.name == name).unwrap();
        assert_eq!(model.parameters[k].spike, plain.parameters[k].spike, "{name}");
    };
    ["factor.1", "factor.2", "spin_down_factor"].into_iter().for_each(as_before);

    let mut values = model.filed();
    let said = model.say_held(&values);
    assert!(
        said.iter().any(|w| w.contains("body.mass_kg = 0.75 ± 0.003: held to that, wrong_mass")),
        "{said:?}"
    );
    let mass = model.parameters.iter().position(|p| p.name == "factor" && p.spike == 0.004).unwrap();
    values[mass] = 1.02;
    let said = model.say_held(&values);
    assert!(said.iter().any(|w| w.contains("5.0 of its sigmas higher (wrong_mass)")), "{said:?}");

    // What a fit wrote is none.
    let log = format!("kind = \"linear_drag\"\nsource_log_sha256 = \"{}\"\n", "0".repeat(64));
    let fitted = text.replacen("kind = \"linear_drag\"\n", &log, 1);
    let model = of(&Vehicle::from_toml("quad", &fitted).unwrap());
    assert!(
        model.held.iter().all(|h| model.candidates[h.candidate].kind != "linear_drag"),
        "{:?}",
        model.held
    );
}

#[test]
fn slopes_of_what_drives_the_motors_are_those_of_finite_differences() {
    let (_, drone, track) = made();
    let around = Around::new(&track, &drone);
    let raw = Raw::new(&track, &around);
    let model = Model::new(&drone, &[&track], &[&around]).unwrap();
    let mut counted = 0;
    for (k, p) in model.parameters.iter().enumerate() {
        if p.enters != Enters::Drive || p.name == "max_rotor_vel_rad_s" {
            continue;
        }
        // The speed has no derivative by the offset where a command arrives exactly at a tick: use values that avoid it.
        for offset in [0.3137, 1.1171] {
            let mut at = model.filed();
            at[k] += offset * p.slab;
            let keep = vec![true; model.drone.effects.len()];
            let seeded: Drone<Dual<f64, 1>> =
                model.drone_at(&at, &keep, |j, v| if j == k { Dual::input(v, 0) } else { Dual::lit(v) });
            let exact = drive(&track, &around, &raw, &seeded);
            let step = 1e-4 * p.slab;
            let moved = |by: f64| {
                let mut there = at.clone();
                there[k] += by;
                drive(&track, &around, &raw, &model.drone_at(&there, &keep, |_, v| v))
            };
            let (up, down) = (moved(step), moved(-step));
            let largest = exact.iter().map(|t| t.rotor_vel[0].partials[0].abs()).fold(0.0, f64::max);
            for i in 100..exact.len() {
                let difference = (up[i].rotor_vel[0] - down[i].rotor_vel[0]) / (2.0 * step);
                let slope = exact[i].rotor_vel[0].partials[0];
                assert!(
                    (slope - difference).abs() < 2e-3 * largest,
                    "{} tick {i}: {slope} {difference}",
                    p.name
                );
            }
            assert!(largest > 0.0, "{} does nothing", p.name);
            counted += 1;
        }
    }
    assert!(counted >= 6, "{counted}");
}

#[test]
fn slopes_of_measurements_by_every_parameter_are_those_of_finite_differences() {
    let (_, drone, track) = made();
    let logs = [Prepared::new(&track, &drone)];
    let model = Model::new(&drone, &[&track], &[&logs[0].around]).unwrap();
    let all: Vec<usize> = (0..model.candidates.len()).collect();
    // Away from nominal, so that products of parameters count too.
    let at: Vec<f64> = model
        .parameters
        .iter()
        .map(|p| {
            let side = if p.sign == propwash_physics::effects::Sign::Down { -1.0 } else { 1.0 };
            p.filed + 0.2137 * side * p.slab
        })
        .collect();
    let horizon = 0.25;
    let here =
        linearise(&logs, &model, &at.clone().into(), &all, Cut::all(horizon), &Starts::new(), &[track.noise]);
    let own = |w: &super::fit::Window| w.gram.nrows() - 1 - model.parameters.len();
    for (k, p) in model.parameters.iter().enumerate() {
        // The residual's square changes by −2 Jᵀr: its second difference is JᵀJ.
        let step = 2e-3 * p.slab;
        let moved = |by: f64| {
            let mut there = at.clone();
            there[k] += by;
            linearise(&logs, &model, &there.into(), &all, Cut::all(horizon), &Starts::new(), &[track.noise])
        };
        let (up, down) = (moved(step), moved(-step));
        // A limit that no command reaches has zero derivative; its column is a secant by design.
        if p.name == "max_rotor_vel_rad_s" {
            continue;
        }
        let (mut exact, mut difference, mut squares) = (0.0, 0.0, 0.0);
        for ((w, u), d) in here.windows.iter().zip(&up.windows).zip(&down.windows) {
            let last = w.gram.nrows() - 1;
            let column = own(w) + k;
            if w.n_rows != u.n_rows || w.n_rows != d.n_rows {
                continue;
            }
            exact += -2.0 * w.gram[(column, last)];
            difference += (u.gram[(last, last)] - d.gram[(last, last)]) / (2.0 * step);
            squares += 2.0 * (w.gram[(column, column)] * w.gram[(last, last)]).sqrt();
        }
        assert!(squares > 0.0, "{} does nothing", p.name);
        let id = &model.candidates[p.candidate].id;
        assert!(
            (exact - difference).abs() < 0.02 * squares,
            "{id} {}: {exact} {difference} of {squares}",
            p.name
        );
    }
}

#[test]
fn a_delay_of_commands_is_all_sensors_being_late() {
    let (_, drone, track) = made();
    let logs = [Prepared::new(&track, &drone)];
    let model = Model::new(&drone, &[&track], &[&logs[0].around]).unwrap();
    let linear =
        linearise(&logs, &model, &model.filed().into(), &[], Cut::all(0.25), &Starts::new(), &[track.noise]);
    let reduced = linear.reduce(&super::disturbance::Disturbance::unknown());
    let h = super::per_log::Information::new(&model, &linear, &reduced, |_| true).unwrap().h;
    let index = |id: &str| {
        (0..model.parameters.len())
            .find(|k| model.candidates[model.parameters[*k].candidate].id == id)
            .unwrap()
    };
    let mut v = nalgebra::DVector::zeros(model.parameters.len());
    v[index("command_delay")] = 1.0;
    let one = v.dot(&(&h * &v));
    for id in ["clock_offset.pose", "clock_offset.gyro", "clock_offset.accel"] {
        v[index(id)] = -1.0;
    }
    let both = v.dot(&(&h * &v));
    assert!(both < 1e-6 * one, "{both} of {one}");

    // Exactly, not only to first order: the same samples fall into the same windows with the same residuals.
    let timing = model.timing();
    let late = |commands_s: f64, sensors_s: f64| {
        let mut values = model.filed();
        values[index("command_delay")] = commands_s;
        for id in ["clock_offset.pose", "clock_offset.gyro", "clock_offset.accel"] {
            values[index(id)] = sensors_s;
        }
        linearise(&logs, &model, &values.into(), &timing, Cut::all(0.25), &Starts::new(), &[track.noise])
    };
    let commands = late(0.0137, 0.0);
    for sensors in [late(0.0, 0.0137), late(0.0061, 0.0076)] {
        assert_eq!(commands.windows.len(), sensors.windows.len());
        for (a, b) in commands.windows.iter().zip(&sensors.windows) {
            let last = a.gram.nrows() - 1;
            let (x, y) = (a.gram[(last, last)], b.gram[(last, last)]);
            assert!(a.n_rows == b.n_rows && (x - y).abs() < 1e-6 * x, "{x} {y}");
        }
    }
}

/// Late commands with early poses equal a late gyroscope with a late accelerometer: each finding names the other pair.
#[test]
fn clocks_are_told_only_beside_each_other() {
    use super::search::{Evidence, THRESHOLD};
    let (_, drone, track) = made();
    let logs = [Prepared::new(&track, &drone)];
    let model = Model::new(&drone, &[&track], &[&logs[0].around]).unwrap();
    let filed = model.filed();
    let linear =
        linearise(&logs, &model, &filed.clone().into(), &[], Cut::all(0.25), &Starts::new(), &[track.noise]);
    let reduced = linear.reduce(&super::disturbance::Disturbance::unknown());
    let h = super::per_log::Information::new(&model, &linear, &reduced, |_| true).unwrap().h;
    let candidate = |id: &str| model.candidates.iter().position(|c| c.id == id).unwrap();
    let ids = ["command_delay", "clock_offset.pose", "clock_offset.gyro", "clock_offset.accel"];
    let [delay, pose, gyro, accel] = ids.map(candidate);
    let mut late = nalgebra::DVector::zeros(model.parameters.len());
    for (c, s) in [(delay, 0.006), (pose, -0.006)] {
        late[model.of(c).next().unwrap()] = s;
    }
    let evidence = Evidence::new(&model, &h, &(&h * &late), &filed, 1.0, 1.0).unwrap();
    let sorted = |mut set: Vec<usize>| {
        set.sort_unstable();
        set
    };
    let set = sorted(vec![delay, pose]);
    let other = sorted(vec![gyro, accel]);
    for of in [delay, pose] {
        let alike = evidence.in_place_of_all(&set, of, THRESHOLD);
        assert!(alike.iter().any(|(ids, _)| sorted(ids.clone()) == other), "{alike:?}");
        assert!(alike.iter().all(|(ids, _)| !ids.contains(&of)), "{alike:?}");
    }
    assert!(evidence.in_place_of_all(&[pose], pose, THRESHOLD).is_empty());
}

/// Two logs of one vehicle whose gyroscopes have different delays: each has its own clock, the vehicle is the same.
#[test]
fn clocks_may_differ_from_log_to_log() {
    use super::diagnose::{Settings, diagnose};
    let (vehicle, _, track) = made();
    let mut late = track.clone();
    late.name = "late.csv".into();
    late.gyro.t_s.iter_mut().for_each(|t| *t += 0.006);
    let of = |tracks: &[Track]| diagnose(tracks, &vehicle, &Settings::default()).unwrap().verdict;
    let both = of(&[track.clone(), late.clone()]);
    let clock = |log: &str| {
        let mut own = both.per_log.iter().filter(|d| d.log == log);
        own.find(|d| d.id == "clock_offset.gyro")
            .unwrap_or_else(|| panic!("{log}: {:?}", both.per_log))
            .clone()
    };
    let (first, second) = (clock(&track.name), clock("late.csv"));
    let apart = second.value - first.value;
    assert!((apart - 0.006).abs() < 4.0 * second.sigma && second.sigma < 0.5e-3, "{first:?} {second:?}");
    assert!((second.value + first.value - 2.0 * second.shared).abs() < 0.1e-3, "deviations sum to nothing");
    // Logs that agree differ in nothing.
    assert_eq!(of(&[track.clone(), track]).per_log, vec![]);
}

/// A parameter uncorrelated with others has the uncertainty of the mean of the parts' scores: √(n/(n−1) Σ s²)/(h +
/// 1/slab²).
#[test]
fn parts_that_disagree_widen_a_number_by_their_scatter() {
    use super::search::Evidence;
    use nalgebra::{DMatrix, DVector};
    let (_, drone, track) = made();
    let around = Around::new(&track, &drone);
    let model = Model::new(&drone, &[&track], &[&around]).unwrap();
    let n = model.parameters.len();
    let k = (0..n)
        .find(|k| model.candidates[model.parameters[*k].candidate].id == "torque_scale")
        .expect("a candidate of one number");
    let slab = model.parameters[k].slab;
    let mut h = DMatrix::zeros(n, n);
    h[(k, k)] = 40.0 / (slab * slab);
    let parts: Vec<DVector<f64>> = [3.0, -2.0, 1.0, -4.0, 2.0]
        .iter()
        .map(|s| {
            let mut score = DVector::zeros(n);
            score[k] = s / slab;
            score
        })
        .collect();
    for dispersion in [1.0, 2.5] {
        let evidence =
            Evidence::new(&model, &h, &DVector::zeros(n), &model.filed(), dispersion, 1.0).unwrap();
        let sigma = evidence.by_scatter(&[model.parameters[k].candidate], &parts).unwrap();
        let squares: f64 = 9.0 + 4.0 + 1.0 + 16.0 + 4.0;
        let wanted = (5.0 / 4.0 * squares).sqrt() / dispersion / (40.0 / dispersion + 1.0) * slab;
        assert!((sigma[k] / wanted - 1.0).abs() < 1e-9, "{} is not {wanted}", sigma[k]);
        // Without information in any part there is no scatter.
        assert!(sigma.iter().enumerate().all(|(i, s)| i == k || s.abs() < 1e-12 * slab.max(1.0)));
    }
}

/// White noise equivalent to the slow pose errors in a log.
fn slow(log: FlightLog) -> [f64; 2] {
    let vehicle = vehicle();
    let drone = vehicle.drone("first_principles").unwrap();
    let track = Track::new(log, &vehicle, &Options::default()).unwrap();
    slow_errors(&track, &Around::new(&track, &drone), drone.body.gravity_m_s2).map(Option::unwrap)
}

#[test]
fn slow_errors_of_poses_show_beside_inertial_data_and_wrong_sensors_do_not() {
    let drone = vehicle().drone("first_principles").unwrap();
    let exact = flight(&drone, 8);
    let [position_m, attitude_rad] = slow(exact.clone());
    assert!(position_m < 1e-4 && attitude_rad < 1e-4, "{position_m} {attitude_rad}");

    // An inertial unit with offset and scale that is late, and a marker off the middle.
    let mut other = exact.clone();
    let quats = exact.attitude.values.clone();
    for (p, q) in other.position_m.values.iter_mut().zip(quats) {
        *p = vec3::add(*p, quat::rotate(q, [0.03, -0.02, 0.01]));
    }
    for a in &mut other.specific_force_m_s2.values {
        *a = [1.03 * a[0] + 0.2, 0.98 * a[1] - 0.1, 1.01 * a[2] + 0.1];
    }
    other.specific_force_m_s2.t_s.iter_mut().for_each(|t| *t += 0.004);
    for w in &mut other.angular_velocity_rad_s.values {
        *w = [1.02 * w[0] + 0.01, 0.99 * w[1], w[2] - 0.02];
    }
    let [position_m, attitude_rad] = slow(other);
    assert!(position_m < 5e-4 && attitude_rad < 1e-3, "{position_m} {attitude_rad}");

    // Poses of an estimator, off by 2 mm and 10 mrad at 2 Hz: neighbours differ by nothing.
    let turn = std::f64::consts::TAU * 2.0;
    let mut smooth = exact;
    for (p, t) in smooth.position_m.values.iter_mut().zip(&smooth.position_m.t_s) {
        (0..3).for_each(|k| p[k] += 2e-3 * (turn * t + k as f64).sin());
    }
    for (q, t) in smooth.attitude.values.iter_mut().zip(&smooth.attitude.t_s) {
        let off = core::array::from_fn(|k| 0.01 * (turn * t + 2.0 * k as f64).sin());
        *q = quat::mul(*q, quat::exp(off));
    }
    let [position_m, attitude_rad] = slow(smooth);
    // Root mean square of the second difference over 0.125 s, and σ √(720/n) / T² by 62.5 samples over 0.25 s.
    let seen = (2.0 - 2.0 * (turn * 0.125).cos()) / (2f64.sqrt() * 0.125 * 0.125);
    let worth = 0.25f64.powi(2) * (62.5f64 / 720.0).sqrt();
    let wanted = 0.01 * seen * worth;
    assert!((attitude_rad / wanted - 1.0).abs() < 0.2, "{attitude_rad}, not {wanted}");
    // An attitude error of 10 mrad bends the path like 0.1 m/s²: the two are uncorrelated.
    let wanted = (2e-3 * seen).hypot(0.01 * 9.81 * 0.577) * worth;
    assert!((position_m / wanted - 1.0).abs() < 0.4, "{position_m}, not {wanted}");
}

#[test]
fn an_attitude_that_leans_with_the_acceleration_is_set_upright() {
    let vehicle = vehicle();
    let drone = vehicle.drone("first_principles").unwrap();
    let exact = flight(&drone, 8);
    let track = |log: FlightLog| Track::new(log, &vehicle, &Options::default()).unwrap();
    let said = |t: &Track| t.warnings.iter().find(|w| w.contains("leans")).cloned();
    assert_eq!(said(&track(exact.clone())), None);

    // 6 mrad per m/s², 0.2 s late.
    let mut leaning = exact.clone();
    let (mut across, mut before) = ([0.0; 3], 0.0);
    let (attitude, felt) = (&mut leaning.attitude, &exact.specific_force_m_s2);
    let mut most = 0.0f64;
    for ((q, t), f) in attitude.values.iter_mut().zip(&attitude.t_s).zip(felt.values.iter().step_by(2)) {
        let keep = (-(t - before) / 0.2).exp();
        before = *t;
        let a = quat::rotate(*q, *f);
        (0..2).for_each(|k| across[k] = keep * across[k] + (1.0 - keep) * a[k]);
        let lean = vec3::scale(vec3::cross(across, [0.0, 0.0, 1.0]), 0.006);
        most = most.max(vec3::norm(lean));
        *q = quat::mul(quat::exp(lean), *q);
    }
    let track = track(leaning);
    let words = said(&track).unwrap();
    let number: f64 = words.split("leans by ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
    assert!((number - 6.0).abs() < 0.6 && words.contains("0.20 s"), "{words}");
    let off = track.attitude.values.iter().zip(&exact.attitude.values).map(|(a, b)| {
        vec3::norm(propwash_flight::resample::rotation_vector(quat::mul(quat::conjugate(*a), *b)))
    });
    let off = off.fold(0.0, f64::max);
    assert!(most > 0.01 && off < 0.15 * most, "{off} of {most}");
}

#[test]
fn a_ghost_starts_where_the_sensors_read_what_was_measured() {
    let (_, drone, track) = made();
    let askew = "[[effect]]\nkind = \"sensor_offset\"\nposition_m = [0.03, -0.02, 0.01]\n";
    let vehicle = Vehicle::from_toml("askew", &format!("{}\n{askew}", vehicle().to_toml())).unwrap();
    let ghost = super::ghost::ghost(&track, &vehicle, 0.5, 0.1).unwrap();
    assert!(ghost.starts_s.len() >= 4, "{:?}", ghost.starts_s);
    let around = Around::new(&track, &drone);
    for start in &ghost.starts_s {
        let k = ghost.t_s.iter().position(|t| t == start).unwrap();
        let i = (0..around.measured.len()).find(|i| (around.time_s(i * STEP) - start).abs() < 1e-9).unwrap();
        let apart = vec3::norm(vec3::sub(ghost.pos_m[k], around.measured[i].unwrap().pos));
        assert!(apart < 1e-9, "{start} s: {apart} m from the marker");
    }
    // It parts from the measurement between two starts no sooner than it must.
    assert!(ghost.t_s.windows(2).all(|t| t[0] < t[1]));
}

/// What becomes of a formula takes no verdict back: one that no vehicle file can hold is not named, and the reason is given.
#[test]
fn a_formula_that_fails_leaves_the_verdict_as_it_is() {
    use super::decide::rules::Rule;
    use super::diagnose::{Settings, diagnose};
    use super::fitted::{Calibrate, Filed, fit_from};
    use super::formula::{Formula, Proposed};
    use super::ladder::Flights;
    let (vehicle, _, track) = made();
    let flights = Flights::new(vec![track], Vec::new(), 0.2);
    let mut diagnosed = diagnose(&flights.fit, &vehicle, &Settings::default()).unwrap();
    let before = diagnosed.verdict.clone();
    let formulas = vec![Formula {
        id: "found_1".into(),
        words: "force along body x = c · v".into(),
        like: String::new(),
        table: "[[effect]]\nkind = \"expresion\"\n".into(),
    }];
    diagnosed.proposed = vec![Proposed { formulas, factors: vec![[0.1, 0.0]], beside: Vec::new() }];
    let text = include_str!("../../../tests/data/planted_quad.toml").to_string();
    let filed = Filed { label: "quad", vehicle: &vehicle, text };
    let fitted = fit_from(filed, &flights, &Settings::default(), "a test", Calibrate::No, diagnosed).unwrap();
    let verdict = &fitted.diagnosed.verdict;
    assert_eq!((&verdict.verdict, verdict.formulas.len()), (&before.verdict, 0));
    let why = verdict.why.iter().find(|w| w.rule == Rule::Formula).unwrap();
    assert!(why.text.contains("expresion"), "{}", why.text);
}

/// Motors that are followed from a second before some windows on turn in them as those that were followed all the time.
#[test]
fn motors_that_are_followed_for_some_windows_alone_turn_as_in_the_whole_log() {
    use super::replay::{Context, commanded_by_pose};
    let vehicle = vehicle();
    let drone = vehicle.drone("first_principles").unwrap();
    let track = Track::new(flight(&drone, 8), &vehicle, &Options::default()).unwrap();
    let Context { around, raw } = Context::of(&track, &drone);
    let n = around.n_ticks;
    let whole = commanded_by_pose(&track, &around, &raw, &drone, std::slice::from_ref(&(0..n)));
    let windows = [0..40, 1200..1300, 1350..1400, n - 100..n];
    let some = commanded_by_pose(&track, &around, &raw, &drone, &windows);
    let mut moved = 0.0f64;
    for k in windows.into_iter().flatten() {
        let [a, b] = [&whole, &some].map(|d| d.tick(k, |x| x));
        for i in 0..4 {
            assert!((a.rotor_vel[i] - b.rotor_vel[i]).abs() < 1e-6 * a.rotor_vel[i], "{k}: {a:?} {b:?}");
            assert!((a.rotor_acc[i] - b.rotor_acc[i]).abs() < 1e-3, "{k}: {a:?} {b:?}");
            moved = moved.max(a.rotor_acc[i].abs());
        }
    }
    assert!(moved > 10.0, "{moved}");
    // Nothing is known beside them: it was left out.
    assert_eq!(some.tick(700, |x| x).rotor_vel[0], 0.0);
}

/// What `compare` sees in a third of the windows it would see in all of them, and a right file is not taken for a wrong one.
#[test]
fn a_wrong_mass_is_seen_in_a_third_of_the_windows_and_in_all_of_them() {
    use super::first_look::within_tolerance;
    use super::policy::{CLEAR_FROM_S, CLEAR_NATS, CLEAR_WINDOWS, GLANCE_WINDOWS};
    use super::replay::Inputs;
    use super::solve::glance;
    let right = vehicle();
    let drone = right.drone("first_principles").unwrap();
    let text = include_str!("../../../tests/data/planted_quad.toml");
    let heavy = Vehicle::from_toml("quad", &text.replace("mass_kg = 0.75\n", "mass_kg = 1.05\n")).unwrap();
    let options = Options { ceiling_z_m: Some(3.0), ..Options::default() };
    let track = Track::new(flight(&drone, 24), &right, &options).unwrap();
    assert!(track.duration_s() > CLEAR_FROM_S, "{}", track.duration_s());
    let looked = |vehicle: &Vehicle| {
        let inputs = Inputs::new(&track, vehicle).unwrap();
        within_tolerance(std::slice::from_ref(&track), &[inputs], vehicle).unwrap()
    };
    assert_eq!(looked(&heavy), Some(false));
    assert_eq!(looked(&right), Some(true));
    let wrong = heavy.drone("first_principles").unwrap();
    let logs = [Prepared::new(&track, &wrong)];
    let mut model = Model::new(&wrong, &[&track], &[&logs[0].around]).unwrap();
    let [few, all] =
        [CLEAR_WINDOWS[1], GLANCE_WINDOWS].map(|most| glance(&logs, &mut model, most).unwrap().unwrap());
    assert!(2 * few.linear.windows.len() < all.linear.windows.len());
    for solution in [&few, &all] {
        assert!(solution.evidence(&model).unwrap().of(&solution.set) > CLEAR_NATS);
    }
}
