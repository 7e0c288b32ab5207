//! The generator of flights with a hidden effect: its equations against closed cases and against `propwash::physics`, its
//! flights, its logs.

#[path = "common/planted/mod.rs"]
mod planted;

use planted::linear::{add, cross, dot, mat_t_vec, mat_vec, matrix, mul, norm, quat_exp, sub};
use planted::world::{Air, DelayLine, Dryden, LOAD, LOAD_SPEED, ROTORS, SIZE, attitude, near_wall, part};
use planted::{
    BOX_M, Build, CEILING_Z_M, Deviations, Excitation, Figures, Flight, HIDDEN, Inputs, MAX_ROTORS, Marker,
    NoiseLevel, Nominal, Plan, Scatter, Sensors, Speeds, State, UNLISTED, World, fly, of_rotors,
};
use propwash::flight::{CheckReport, Fault, FlightLog, Severity, check};
use propwash::physics::controllers::ControlMode;
use propwash::physics::effects::{Command, KINDS};
use propwash::physics::rigid_body;
use propwash::physics::surroundings::{Neighbour, Surroundings};
use propwash::rollout::{Sim, SimData, SimOptions};
use propwash::vehicle::Vehicle;
use std::collections::BTreeMap;
use std::fmt::Write;

fn quad() -> Vehicle {
    Vehicle::load("tests/data/planted_quad.toml").unwrap()
}

/// A vehicle of tests/data/planted_NAME.toml.
fn planted(name: &str) -> Vehicle {
    Vehicle::load(format!("tests/data/planted_{name}.toml")).unwrap()
}

const VEHICLES: [&str; 6] = ["micro", "pocket", "quad", "kilo", "hexa", "octo"];

fn nominal() -> Nominal {
    Nominal::read(&quad()).unwrap()
}

/// The vehicle as filed but for what `change` does.
fn world(change: impl FnOnce(&mut Deviations)) -> World {
    let mut dev = Deviations::none();
    change(&mut dev);
    World::new(&nominal(), &dev, 10.0)
}

/// Hover at the origin of the filed vehicle.
fn hover() -> State {
    World::nominal(&nominal()).at_hover([0.0, 0.0, 10.0], 0.0)
}

fn acceleration(w: &World, x: &State) -> [f64; 3] {
    let rotors = planted::world::rotors(x);
    part(&w.rate(0.0, x, &rotors, &Air::default()), 7)
}

fn angular(w: &World, x: &State) -> [f64; 3] {
    let rotors = planted::world::rotors(x);
    part(&w.rate(0.0, x, &rotors, &Air::default()), 10)
}

fn near(a: f64, b: f64, by: f64) {
    assert!((a - b).abs() <= by, "{a} is not {b} within {by}");
}

/// Runs with constant commands.
fn run(w: &World, mut x: State, commands: Speeds, seconds: f64, h: f64) -> State {
    let n = (seconds / h).round() as usize;
    for k in 0..n {
        x = w.rk4(k as f64 * h, h, &x, &commands, &Air::default());
    }
    x
}

fn checked(flight: &Flight) -> (FlightLog, CheckReport) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("flight.csv");
    flight.write(&path).unwrap();
    let log = FlightLog::load(&path, None).unwrap();
    let report = check(&log);
    (log, report)
}

#[test]
fn the_vehicle_file_is_sound_and_hovers_under_its_own_controller() {
    let vehicle = quad();
    assert_eq!(vehicle.warnings(), [] as [String; 0]);
    let drone = vehicle.drone("first_principles").unwrap();
    let options = SimOptions { n_worlds: 1, control: ControlMode::State, ..SimOptions::default() };
    let mut sim = Sim::new(options, vec![(drone, vehicle.rates)]).unwrap();
    let mut wanted = [0.0; 16];
    (wanted[0], wanted[2], wanted[12]) = (0.5, 1.0, 1.0);
    sim.set_command(&wanted).unwrap();
    sim.step(5000).unwrap();
    let data: &SimData = &sim.data;
    let at = data.state(0, 0);
    assert!(norm(sub(at.pos, [0.5, 0.0, 1.0])) < 0.03 && norm(at.vel) < 0.02, "{at:?}");
    // Hover takes 45 % of the greatest thrust.
    let n = nominal();
    near((n.hover_rad_s() / n.limits[1]).powi(2), 0.45, 0.005);
}

#[test]
fn hover_thrust_carries_the_weight_and_a_wrong_vehicle_does_not_hover() {
    let x = hover();
    near(x[13], (0.75f64 * 9.81 / 4.0 / 1.6e-6).sqrt(), 1e-9);
    let w = World::nominal(&nominal());
    assert!(norm(acceleration(&w, &x)) < 1e-12 && norm(angular(&w, &x)) < 1e-12);

    let up = |change: fn(&mut Deviations)| acceleration(&world(change), &x)[2];
    near(up(|d| d.thrust_factor = 1.1), 0.1 * 9.81, 1e-12);
    near(up(|d| d.mass_factor = 1.1), -9.81 * (1.0 - 1.0 / 1.1), 1e-12);
    near(up(|d| d.payload_kg = 0.075), -9.81 * (1.0 - 1.0 / 1.1), 1e-12);
    near(up(|d| d.rotor_factor[2] = 0.8), -0.05 * 9.81, 1e-12);
    near(up(|d| d.thrust_curve_share = 0.3), 0.0, 1e-12);
    near(up(|d| d.sag_share = 0.2), 0.0, 1e-12);
    // A centre of mass 5 mm ahead: 5 mm × weight about −y of thrust behind it pitches the nose down, torque +y.
    let nose = angular(&world(|d| d.com_offset_m = [5e-3, 0.0, 0.0]), &x);
    near(nose[1], 5e-3 * 0.75 * 9.81 / 2.6e-3, 1e-9);
    // Rotor 1 stands front right: without it the vehicle falls to that side, roll to the right and nose down.
    let weak = angular(&world(|d| d.rotor_factor[0] = 0.8), &x);
    near(weak[0], 0.2 * 0.75 * 9.81 / 4.0 * 0.08 / 2.5e-3, 1e-9);
    near(weak[1], 0.2 * 0.75 * 9.81 / 4.0 * 0.08 / 2.6e-3, 1e-9);
    // Thrust that leans about +x pushes to −y.
    let lean = acceleration(&world(|d| d.lean_rad = [0.02, 0.0]), &x);
    near(lean[1], -9.81 * 0.02f64.sin(), 1e-9);
}

#[test]
fn the_battery_takes_thrust_linearly_with_time() {
    let w = world(|d| d.sag_share = 0.25);
    for (t, share) in [(0.0, 1.0), (4.0, 0.9), (10.0, 0.75)] {
        near((w.target(1000.0, t) / 1000.0).powi(2), share, 1e-12);
    }
}

#[test]
fn walls_add_thrust_as_their_formula_says() {
    near(near_wall(1.0, 0.06, 0.12), 1.0 / (1.0 - 1.0 / 64.0), 1e-12);
    near(near_wall(1.0, 0.06, 1e-3), 1.0 / (1.0 - 0.25), 1e-12);
    let mut x = hover();
    x[2] = 0.0635;
    near(
        acceleration(&world(|d| d.ground_strength = 2.0), &x)[2],
        9.81 * (1.0 / (1.0 - 2.0 / 16.0) - 1.0),
        0.01,
    );
    x[2] = CEILING_Z_M - 0.0635;
    near(
        acceleration(&world(|d| d.ceiling_strength = 2.0), &x)[2],
        9.81 * (1.0 / (1.0 - 2.0 / 16.0) - 1.0),
        0.01,
    );
}

#[test]
fn a_vehicle_with_still_rotors_falls_freely_and_then_at_its_terminal_speed() {
    let mut x = hover();
    x[13..17].fill(0.0);
    let free = world(|d| d.linear_drag_factor = [0.0; 3]);
    let y = run(&free, x, [0.0; MAX_ROTORS], 2.0, 1e-3);
    near(y[2] - x[2], -0.5 * 9.81 * 4.0, 1e-9);
    near(y[9], -9.81 * 2.0, 1e-9);

    let slow = run(&World::nominal(&nominal()), x, [0.0; MAX_ROTORS], 60.0, 1e-2);
    near(slow[9], -0.75 * 9.81 / 0.26, 1e-6);
    let square = world(|d| {
        d.linear_drag_factor = [0.0; 3];
        d.quadratic_drag_n_s2_per_m2 = [0.03; 3];
    });
    near(run(&square, x, [0.0; MAX_ROTORS], 60.0, 1e-2)[9], -(0.75f64 * 9.81 / 0.03).sqrt(), 1e-6);
    let cube = world(|d| {
        d.linear_drag_factor = [0.0; 3];
        d.cubic_drag_n_s3_per_m3 = 0.01;
    });
    near(run(&cube, x, [0.0; MAX_ROTORS], 60.0, 1e-2)[9], -(0.75f64 * 9.81 / 0.01).cbrt(), 1e-6);
}

#[test]
fn motors_follow_a_step_exponentially_after_its_delay() {
    let w = world(|d| d.lag_factor = [2.0, 0.5]);
    let x = hover();
    let from = x[13];
    let mut line = DelayLine::new([from; MAX_ROTORS]);
    line.push(0.013, [from + 100.0; MAX_ROTORS], 0.0);
    line.push(0.213, [from; MAX_ROTORS], 0.0);
    let mut y = x;
    for k in 0..213 {
        let t = f64::from(k) * 1e-3;
        y = w.advance(t, t + 1e-3, &y, &line, &Air::default());
    }
    let peak = 100.0 * (1.0 - (-0.2f64 / 0.06).exp());
    near(y[13], from + peak, 1e-4);
    for k in 213..233 {
        let t = f64::from(k) * 1e-3;
        y = w.advance(t, t + 1e-3, &y, &line, &Air::default());
    }
    near(y[13], from + peak * (-1.0f64).exp(), 1e-4);
    // A switch within a step is met to the instant: one long call and two short ones agree.
    let at_once = w.advance(0.012, 0.016, &x, &line, &Air::default());
    let in_two =
        w.advance(0.013, 0.016, &w.advance(0.012, 0.013, &x, &line, &Air::default()), &line, &Air::default());
    near(at_once[13], in_two[13], 1e-12);
}

/// Kinetic and potential energy of body and mass on the cable, J.
fn energy(w: &World, x: &State) -> f64 {
    let g = 9.81;
    let (v, rate, pv) = (part(x, 7), part(x, 10), part(x, LOAD_SPEED));
    let spin = 0.5 * dot(rate, mat_vec(w.inertia, rate));
    let m = w.dev.slung_kg;
    0.5 * w.mass_kg * dot(v, v) + w.mass_kg * g * x[2] + spin + 0.5 * m * dot(pv, pv) + m * g * x[LOAD + 2]
}

#[test]
fn a_pendulum_keeps_its_length_and_its_energy_and_swings_with_its_period() {
    let change = |d: &mut Deviations| {
        d.slung_kg = 0.06;
        d.cable_m = 0.5;
        d.hook_m = [0.01, 0.0, -0.02];
        d.linear_drag_factor = [0.0; 3];
        d.rotor_inertia_factor = 0.0;
    };
    let w = world(change);
    // Thrown while turning, rotors still; the mass swings by 0.8 rad.
    let mut x = w.at_hover([0.0, 0.0, 50.0], 0.3);
    x[13..17].fill(0.0);
    x[7..10].copy_from_slice(&[1.0, 0.5, 8.0]);
    x[10..13].copy_from_slice(&[0.0, 1.5, 0.7]);
    let hook = add(part(&x, 0), mat_vec(matrix(attitude(&x)), w.hook_m));
    let down = mat_vec(matrix(quat_exp([0.8, 0.0, 0.0])), [0.0, 0.0, -0.5]);
    x[LOAD..LOAD_SPEED].copy_from_slice(&add(hook, down));
    let hook_speed = add(part(&x, 7), mat_vec(matrix(attitude(&x)), cross(part(&x, 10), w.hook_m)));
    x[LOAD_SPEED..SIZE].copy_from_slice(&hook_speed);
    let before = energy(&w, &x);
    let y = run(&w, x, [0.0; MAX_ROTORS], 1.0, 1e-3);
    let hook = add(part(&y, 0), mat_vec(matrix(attitude(&y)), w.hook_m));
    near(norm(sub(part(&y, LOAD), hook)), 0.5, 1e-12);
    // What is lost went into the air: drag × speed² of at most 9 m/s.
    let lost = before - energy(&w, &y);
    assert!((0.0..0.003 * 81.0).contains(&lost), "{lost}");

    // Below a vehicle so heavy that it stands still, small swings take 2π √(L/g).
    let heavy = world(|d| {
        change(d);
        d.hook_m = [0.0; 3];
        d.mass_factor = 1e7;
        d.inertia_factor = [1e7; 3];
        d.thrust_factor = 1e7;
    });
    let mut x = hover();
    let aside = [x[0] + 0.5 * 0.05f64.sin(), x[1], x[2] - 0.5 * 0.05f64.cos()];
    x[LOAD..LOAD_SPEED].copy_from_slice(&aside);
    let period = std::f64::consts::TAU * (0.5f64 / 9.81).sqrt();
    let y = run(&heavy, x, [x[13]; MAX_ROTORS], period, period / 2000.0);
    near(y[LOAD] - y[0], 0.5 * 0.05f64.sin() * (-0.003 * period / (2.0 * 0.06)).exp(), 1e-4);
    // Under tension the vehicle carries both weights.
    let both = world(|d| {
        change(d);
        d.hook_m = [0.0, 0.0, -0.02];
    });
    let x = both.at_hover([0.0, 0.0, 10.0], 0.0);
    assert!(acceleration(&both, &x)[2].abs() < 1e-9);
}

#[test]
fn half_the_step_gives_the_same_flight() {
    let w = world(|d| {
        d.rotor_drag_n_s2_per_rad_m = 5e-5;
        d.slung_kg = 0.05;
        d.inflow_n_s2_per_rad_m = 1e-4;
    });
    let mut x = w.at_hover([0.0, 0.0, 5.0], 0.0);
    x[10..13].copy_from_slice(&[2.0, -3.0, 1.0]);
    let commands = [900.0, 1100.0, 1250.0, 1050.0, 0.0, 0.0, 0.0, 0.0];
    let (coarse, fine) = (run(&w, x, commands, 0.5, 1e-3), run(&w, x, commands, 0.5, 2.5e-4));
    for i in 0..SIZE {
        near(coarse[i], fine[i], 1e-6 * (1.0 + fine[i].abs()));
    }
}

#[test]
fn turbulence_has_its_size_its_memory_and_no_dependence_on_the_step() {
    for dt in [1e-3, 0.05] {
        let n = if dt < 0.01 { 1_000_000 } else { 200_000 };
        let mut air = Dryden::new(0.5, planted::hidden::stream(1, 0, "test"));
        let lag = (0.3f64 / dt).round() as usize;
        let mut series: Vec<[f64; 3]> = Vec::new();
        for _ in 0..n {
            air.step(dt);
            series.push(air.wind_m_s());
        }
        for axis in 0..3 {
            let mean = |f: &dyn Fn(usize) -> f64, n: usize| (0..n).map(f).sum::<f64>() / n as f64;
            let variance = mean(&|k| series[k][axis] * series[k][axis], n);
            let late = mean(&|k| series[k][axis] * series[k + lag][axis], n - lag) / variance;
            // Correlation of the spectra: e^{−s} along, e^{−s}(1 − s/2) across, s = 0.3 s / 0.75 s.
            let s: f64 = 0.3 / 0.75;
            let wanted = if axis == 0 { (-s).exp() } else { (-s).exp() * (1.0 - 0.5 * s) };
            near(variance.sqrt(), 0.5, 0.03);
            near(late, wanted, 0.05);
        }
    }
}

/// A vehicle file with the true parameters of one effect, by the names that the truth gives them.
fn filed_with(base: &Vehicle, id: &str, parameters: &BTreeMap<String, f64>) -> Option<Vehicle> {
    let kind = id.split('.').next().unwrap_or(id);
    // Of effects with memory, random numbers or on sensors the simulator's rate alone says nothing; their parameters have
    // names of their own here.
    let apart = [
        "battery_sag",
        "command_delay",
        "linear_drag",
        "slung_payload",
        "turbulence",
        "gust",
        "rotor_tilt",
        "thrust_curve",
        "ceiling_effect",
        "wrong_inertia",
        "mount",
        "world_tilt",
        "sensor_offset",
        "gyro_bias",
        "gyro_scale",
        "accel_bias",
        "clock_offset",
    ];
    if !KINDS.contains(&kind) || apart.contains(&kind) {
        return None;
    }
    let mut text = format!("{}\n[[effect]]\nkind = \"{kind}\"\n", base.to_toml());
    let mut lists: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    for (name, value) in parameters {
        match name.split_once('.') {
            Some((list, _)) => lists.entry(list.into()).or_default().push(*value),
            None if kind == "weak_rotor" => {
                let mut all = vec![1.0; 8];
                all[usize::from(id.as_bytes()[id.len() - 1] - b'1')] = *value;
                lists.insert("factor".into(), all);
            }
            None => writeln!(text, "{name} = {value:?}").unwrap(),
        }
    }
    for (name, values) in lists {
        writeln!(text, "{name} = {values:?}").unwrap();
    }
    Some(Vehicle::from_toml(id, &text).unwrap_or_else(|e| panic!("{id}: {e}\n{text}")))
}

#[test]
fn the_equations_agree_with_those_of_the_simulator_for_every_effect_that_both_have() {
    for name in ["quad", "micro", "hexa", "octo"] {
        agree_with_the_simulator(&planted(name));
    }
}

fn agree_with_the_simulator(filed_vehicle: &Vehicle) {
    let nominal = Nominal::read(filed_vehicle).unwrap();
    let (rotors, hover_rad_s) = (nominal.rotors.len(), nominal.hover_rad_s());
    let scale = nominal.scale(20.0);
    let filed = nominal.filed(20.0);
    let mut compared = Vec::new();
    for id in of_rotors(rotors) {
        for seed in 0..5 {
            let mut dev = Deviations::none();
            dev.plant(id, seed, 1.0, &scale, false);
            let Some(vehicle) = filed_with(filed_vehicle, id, &dev.parameters(id, &filed)) else { continue };
            let drone = vehicle.drone("first_principles").unwrap();
            let w = World::new(&nominal, &dev, 20.0);
            let mut s = planted::hidden::stream(seed, 0, "states");
            let mut x = World::nominal(&nominal).at_hover([0.0, 0.0, 10.0], 0.0);
            x[0..3].copy_from_slice(&[s.uniform(-0.1, 0.1), s.uniform(-0.1, 0.1), s.uniform(0.15, 0.3)]);
            let q = quat_exp([s.uniform(-0.4, 0.4), s.uniform(-0.4, 0.4), s.uniform(-1.0, 1.0)]);
            x[3..7].copy_from_slice(&q);
            for i in 7..13 {
                x[i] = s.uniform(-4.0, 4.0);
            }
            for i in ROTORS..ROTORS + rotors {
                x[i] *= s.uniform(0.7, 1.3);
            }
            let commands: Speeds =
                std::array::from_fn(|i| if i < rotors { hover_rad_s * s.uniform(0.7, 1.15) } else { 0.0 });
            let t = s.uniform(0.0, 10.0);
            let above = [0.05, -0.02, 0.9];
            let air = Air { neighbour_m: Some(above), ..Air::default() };
            let ours = w.rate(t, &x, &commands, &air);

            let mut state = rigid_body::State::rest();
            (state.pos, state.quat) = (part(&x, 0), attitude(&x));
            (state.vel, state.ang_vel) = (part(&x, 7), part(&x, 10));
            state.rotor_vel = planted::world::rotors(&x);
            let neighbour = Neighbour {
                pos: above,
                vel: [0.0; 3],
                weight_n: w.neighbour.0,
                disc_radius_m: w.neighbour.1,
            };
            let around = Surroundings {
                time_s: t,
                ground_distance_m: x[2],
                neighbours: std::slice::from_ref(&neighbour),
                ..Surroundings::calm()
            };
            let theirs = drone.rate(&state, &Command::Rotors(commands), &around);
            for i in 0..3 {
                near(ours[7 + i], theirs.acc[i], 1e-9 * (1.0 + theirs.acc[i].abs()));
                near(ours[10 + i], theirs.ang_acc[i], 1e-9 * (1.0 + theirs.ang_acc[i].abs()));
            }
            for i in 0..rotors {
                let limit = dev.max_rotor_rad_s;
                if commands[i] < limit {
                    near(ours[ROTORS + i], theirs.rotor_acc[i], 1e-9 * (1.0 + theirs.rotor_acc[i].abs()));
                }
            }
            compared.push(id);
        }
    }
    compared.dedup();
    for id in
        ["rotor_drag", "downwash", "ground_effect", "payload", "weak_rotor.3", "blade_flapping", "motor_lag"]
    {
        assert!(compared.contains(&id), "{id} was not compared: {compared:?}");
    }
}

#[test]
fn every_effect_flies_with_every_seed_inside_the_box_and_changes_the_flight_or_the_readings() {
    let vehicle = quad();
    let mut shrunk = Vec::new();
    for seed in 0..3 {
        let mut plain: BTreeMap<&str, Flight> = BTreeMap::new();
        for id in HIDDEN.iter().chain(UNLISTED) {
            let plan = Plan::exciting(&vehicle, &[*id], 8.0, seed);
            let flight = fly(&plan).unwrap_or_else(|e| panic!("{e}"));
            let same = plain
                .entry(plan.excitation.name())
                .or_insert_with(|| fly(&Plan { hidden: vec![], ..plan.clone() }).unwrap());
            let (motion, truth) = (flight.truth.motion, &flight.truth.hidden[0]);
            assert!(motion.farthest_m < BOX_M && motion.height_m[0] > 0.0, "{id} {seed}: {motion:?}");
            assert!(flight.states.iter().all(|(_, x)| x.iter().all(|v| v.is_finite())), "{id} {seed}");
            assert!(truth.parameters.iter().any(|(k, v)| *v != truth.filed[k]), "{id}: {truth:?}");
            assert_eq!(truth.listed, HIDDEN.contains(id));
            if flight.truth.size < 1.0 {
                shrunk.push((*id, seed));
            }
            // Noise, track and air are the same, so every difference is the effect's.
            let apart = |a: &Flight, b: &Flight| {
                let pairs = a.states.iter().zip(&b.states);
                pairs.map(|(a, b)| norm(sub(part(&a.1, 0), part(&b.1, 0)))).fold(0.0, f64::max)
            };
            let measures = ["mount", "world_tilt", "sensor_offset", "gyro", "accel", "clock"];
            let moved = apart(&flight, same);
            if measures.iter().any(|m| id.starts_with(m)) {
                assert_eq!(moved, 0.0, "{id} only changes readings");
                assert_ne!(flight.csv(), same.csv(), "{id} {seed}");
            } else {
                assert!(moved > 1e-3, "{id} {seed} moves the vehicle by {moved} m only");
            }
        }
    }
    assert!(shrunk.len() <= 6, "{shrunk:?}");
}

#[test]
fn the_checker_accepts_fine_flights_of_every_kind_and_warns_of_planted_clocks() {
    let vehicle = quad();
    for (name, excitation) in Excitation::ALL {
        for noise in [NoiseLevel::Fine, NoiseLevel::Rough] {
            let plan = Plan { excitation: *excitation, noise, ..Plan::exciting(&vehicle, &[], 20.0, 1) };
            let flight = fly(&plan).unwrap();
            let (log, report) = checked(&flight);
            let refused: Vec<_> = report.findings.iter().filter(|f| f.severity == Severity::Refuse).collect();
            assert!(refused.is_empty(), "{name} {noise:?}: {refused:?}");
            assert!(!report.has(Fault::Delay), "{name} {noise:?}: {:?}", report.findings);
            near(log.duration_s, 20.0, 0.02);
            let rate = flight.truth.figures.pose_hz;
            let n = log.position_m.t_s.len() as f64;
            assert!(n > 0.95 * rate * 20.0 && n < rate * 20.0 + 2.0, "{name}: {n}");
            assert_eq!(log.cmd_rotor_rad_s[3].t_s.len(), 10_001);
            assert_eq!(log.angular_velocity_rad_s.t_s.len(), 10_000);
        }
    }
    for id in HIDDEN {
        let flight = fly(&Plan::exciting(&vehicle, &[*id], 12.0, 2)).unwrap();
        let (log, report) = checked(&flight);
        let refused: Vec<_> = report.findings.iter().filter(|f| f.severity == Severity::Refuse).collect();
        assert!(refused.is_empty(), "{id}: {refused:?}");
        assert_eq!(log.objects_m.contains_key("payload"), *id == "slung_payload");
        assert_eq!(log.objects_m.contains_key("neighbour"), *id == "downwash");
        if id.starts_with("clock_offset") {
            assert!(report.has(Fault::Delay), "{id}: {:?}", report.delays);
        }
    }
}

#[test]
fn the_same_plan_gives_the_same_bytes_and_other_flights_of_a_vehicle_the_same_truth() {
    let vehicle = quad();
    let plan = Plan::exciting(&vehicle, &["rotor_drag", "payload"], 3.0, 7);
    let first = fly(&plan).unwrap();
    assert_eq!(first.csv(), fly(&plan).unwrap().csv());
    let next = fly(&Plan { flight: 1, ..plan.clone() }).unwrap();
    assert_ne!(first.csv(), next.csv());
    assert_eq!(first.truth.deviations, next.truth.deviations);
    let other = fly(&Plan { seed: 8, ..plan.clone() }).unwrap();
    assert_ne!(first.truth.deviations, other.truth.deviations);
    // One effect does not change how another is drawn, and the excitation does not either.
    let alone = fly(&Plan { hidden: vec!["payload"], excitation: Excitation::Circle, ..plan }).unwrap();
    assert_eq!(alone.truth.hidden[0].parameters, first.truth.hidden[1].parameters);
}

#[test]
fn the_exciting_flight_excites() {
    let vehicle = quad();
    for seed in 0..3 {
        let motion = fly(&Plan::exciting(&vehicle, &[], 50.0, seed)).unwrap().truth.motion;
        let [roll, pitch, yaw] = motion.rate_rad_s;
        assert!(roll > 3.0 && pitch > 3.0 && yaw > 2.0, "{motion:?}");
        assert!(motion.thrust_share[0] < 0.7 && motion.thrust_share[1] > 1.3, "{motion:?}");
        assert!(motion.speed_m_s > 4.5 && motion.speed_m_s < 8.0, "{motion:?}");
        assert!(motion.tracking_m < 0.6 && motion.farthest_m < 5.0, "{motion:?}");
        let low = fly(&Plan::exciting(&vehicle, &["ground_effect"], 50.0, seed)).unwrap().truth.motion;
        assert!(low.height_m[0] < 0.2 && low.height_m[1] > 0.8, "{low:?}");
        let held = fly(&Plan::exciting(&vehicle, &["actuator_saturation"], 50.0, seed)).unwrap().truth;
        assert!((0.002..0.35).contains(&held.motion.saturated), "{:?}", held.motion);
    }
}

#[test]
fn sensors_read_the_truth_through_their_planted_errors() {
    let vehicle = quad();
    let quiet = |hidden: &[&'static str]| Plan {
        build: Build::usual(0.0),
        sensors: Sensors { rotors: true, ..Sensors::default() },
        ..Plan::exciting(&vehicle, hidden, 10.0, 5)
    };
    // Mean of gyroscope minus truth, at the nearest state.
    let flight = fly(&quiet(&["gyro_bias"])).unwrap();
    let (log, _) = checked(&flight);
    let gyro = &log.angular_velocity_rad_s;
    let mut mean = [0.0; 3];
    for (t, w) in gyro.t_s.iter().zip(&gyro.values) {
        let x = &flight.states[((t / 0.01).round() as usize).min(flight.states.len() - 1)].1;
        mean = add(mean, mul(sub(*w, part(x, 10)), 1.0 / gyro.t_s.len() as f64));
    }
    for i in 0..3 {
        near(mean[i], flight.truth.deviations.gyro_bias_rad_s[i], 0.01);
    }

    // The marker in the frame of the body, from positions alone, on states at exact times.
    let flight = fly(&quiet(&["sensor_offset"])).unwrap();
    let (log, _) = checked(&flight);
    let mut mean = [0.0; 3];
    let mut n = 0.0;
    for (t, p) in log.position_m.t_s.iter().zip(&log.position_m.values) {
        let k = (t / 0.01).round();
        if (t - 0.01 * k).abs() < 3e-4 && (k as usize) < flight.states.len() {
            let x = &flight.states[k as usize].1;
            let moved = mul(part(x, 7), t - 0.01 * k);
            mean = add(mean, mat_t_vec(matrix(attitude(x)), sub(*p, add(part(x, 0), moved))));
            n += 1.0;
        }
    }
    assert!(n > 20.0, "{n}");
    for i in 0..3 {
        near(mean[i] / n, flight.truth.deviations.marker_m[i], 5e-4);
    }

    // Measured rotors, and an accelerometer that reads the thrust in hover.
    let hover = fly(&Plan { excitation: Excitation::HoverYaw, ..quiet(&[]) }).unwrap();
    let (log, _) = checked(&hover);
    let mean = |v: &[[f64; 1]]| v.iter().map(|v| v[0]).sum::<f64>() / v.len() as f64;
    near(mean(&log.rotor_speed_rad_s[0].values), 1072.0, 10.0);
    let accel = &log.specific_force_m_s2.values;
    near(accel.iter().map(|a| a[2]).sum::<f64>() / accel.len() as f64, 9.81, 0.03);

    // What the position system follows matters where the centre of mass has moved.
    let plan = quiet(&["com_offset"]);
    let centre = fly(&plan).unwrap();
    let frame = fly(&Plan { marker: Marker::Airframe, ..plan }).unwrap();
    assert_eq!(centre.states, frame.states);
    let (a, b) = (checked(&centre).0, checked(&frame).0);
    let apart = norm(sub(a.position_m.values[500], b.position_m.values[500]));
    near(apart, norm(centre.truth.deviations.com_offset_m), 1e-5);
}

#[test]
fn channels_can_be_left_out_and_wrong_plans_are_refused_in_words() {
    let vehicle = quad();
    let sensors =
        Sensors { accel: false, gyro: false, battery: false, references: false, ..Sensors::default() };
    let flight = fly(&Plan { sensors, ..Plan::exciting(&vehicle, &[], 2.0, 0) }).unwrap();
    let header = flight.csv().lines().next().unwrap();
    assert_eq!(header, "t,px,py,pz,qx,qy,qz,qw,cmd_rotor1,cmd_rotor2,cmd_rotor3,cmd_rotor4");
    let refused = |plan: Plan| fly(&plan).unwrap_err();
    assert!(refused(Plan::exciting(&vehicle, &[], f64::NAN, 0)).contains("expected a length"));
    assert!(
        refused(Plan::exciting(&vehicle, &["propwash"], 1.0, 0)).contains("expected the id of an effect")
    );
    assert!(
        refused(Plan::exciting(&vehicle, &["gust", "gust"], 1.0, 0)).contains("expected each effect once")
    );
    let windy = format!("{}\n[[effect]]\nkind = \"constant_wind\"\n", vehicle.to_toml());
    let windy = Vehicle::from_toml("windy", &windy).unwrap();
    assert!(refused(Plan::exciting(&windy, &[], 1.0, 0)).contains("no effect but linear_drag"));
    assert!(Excitation::by_name("loop").unwrap_err().contains("lissajous"));
}

/// The true state between two of a flight, 10 ms apart.
fn between(flight: &Flight, t: f64) -> State {
    let k = ((t / 0.01).floor().max(0.0) as usize).min(flight.states.len() - 2);
    let (a, b) = (&flight.states[k], &flight.states[k + 1]);
    let share = (t - a.0) / (b.0 - a.0);
    std::array::from_fn(|i| a.1[i] + share * (b.1[i] - a.1[i]))
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, n) = values.fold((0.0, 0.0), |(sum, n), v| (sum + v * v, n + 1.0));
    (sum / n).sqrt()
}

#[test]
fn measured_rotor_speeds_and_thrust_have_the_noise_that_was_drawn() {
    let vehicle = quad();
    let figures: Vec<Figures> = (0..40).map(|seed| Figures::new(NoiseLevel::Fine, seed, 0)).collect();
    let span = |pick: fn(&Figures) -> f64| {
        let all = figures.iter().map(pick);
        (all.clone().fold(f64::INFINITY, f64::min), all.fold(0.0, f64::max))
    };
    let (least, most) = span(|f| f.rotor_rad_s);
    assert!(least < 1.0 && most > 7.0 && most <= 8.0, "{least} {most}");
    let (least, most) = span(|f| f.thrust_share);
    assert!(least < 0.003 && most > 0.017 && most <= 0.02, "{least} {most}");
    let (least, most) = span(|f| f.rotor_hz);
    assert!(least >= 250.0 && most <= 500.0 && most > 1.5 * least, "{least} {most}");
    for seed in 0..4 {
        let plan = Plan { excitation: Excitation::HoverYaw, ..Plan::exciting(&vehicle, &[], 10.0, seed) };
        let measured = fly(&Plan { sensors: Sensors::with(Inputs::Rotors), ..plan.clone() }).unwrap();
        let (log, report) = checked(&measured);
        assert!(!report.findings.iter().any(|f| f.severity == Severity::Refuse), "{:?}", report.findings);
        assert!(log.cmd_rotor_rad_s.is_empty() && log.rotor_speed_rad_s.len() == 4);
        let noise = measured.truth.figures.rotor_rad_s;
        for (i, channel) in log.rotor_speed_rad_s.iter().enumerate() {
            let off = channel.t_s.iter().zip(&channel.values);
            let start = measured.truth.log_start_s;
            // Between states, motors are known to about 2 rad/s.
            let seen = rms(off.map(|(t, v)| v[0] - between(&measured, t + start)[ROTORS + i]));
            near(seen, noise, 0.1 * noise + 2.0);
        }
        let thrust = fly(&Plan { sensors: Sensors::with(Inputs::Thrust), ..plan }).unwrap();
        let (log, _) = checked(&thrust);
        assert!(log.rotor_speed_rad_s.is_empty() && log.cmd_rotor_rad_s.is_empty());
        let start = thrust.truth.log_start_s;
        let filed = |x: &State| planted::world::rotors(x).iter().map(|w| 1.6e-6 * w * w).sum::<f64>();
        let off = log.thrust_n.t_s.iter().zip(&log.thrust_n.values);
        let seen = rms(off.map(|(t, v)| v[0] / filed(&between(&thrust, t + start)) - 1.0));
        near(seen, thrust.truth.figures.thrust_share, 0.1 * thrust.truth.figures.thrust_share + 0.002);
    }
}

/// Rotation vector from the true to the logged attitude, world, rad.
fn turn(q: [f64; 4], x: &State) -> [f64; 3] {
    let t = attitude(x);
    let r = planted::linear::quat_mul(q, [-t[0], -t[1], -t[2], t[3]]);
    let sign = if r[3] < 0.0 { -2.0 } else { 2.0 };
    [sign * r[0], sign * r[1], sign * r[2]]
}

#[test]
fn an_estimator_s_log_is_smooth_slowly_wrong_and_leans_in_manoeuvres() {
    let vehicle = quad();
    for seed in 0..4 {
        let plan = Plan {
            noise: NoiseLevel::Filtered,
            build: Build::usual(0.0),
            sensors: Sensors::with(Inputs::Rotors),
            ..Plan::exciting(&vehicle, &[], 20.0, seed)
        };
        let flight = fly(&plan).unwrap();
        let (log, report) = checked(&flight);
        assert!(!report.findings.iter().any(|f| f.severity == Severity::Refuse), "{:?}", report.findings);
        let figures = flight.truth.figures;
        let filters = figures.filters.unwrap();
        let late = figures.clock_s[0] - flight.truth.log_start_s;
        let times = &log.position_m.t_s;
        let off: Vec<[f64; 3]> = times
            .iter()
            .zip(&log.position_m.values)
            .map(|(t, p)| sub(*p, part(&between(&flight, t - late), 0)))
            .collect();
        let held = figures.held[0];
        let new: Vec<usize> =
            (1..off.len()).filter(|k| log.position_m.values[*k] != log.position_m.values[k - 1]).collect();
        near(1.0 - new.len() as f64 / off.len() as f64, held, 0.02);
        if held == 0.0 {
            // A quarter of the error at most is new from sample to sample at 50 Hz, and less at higher rates.
            let jumps = rms((1..off.len()).map(|k| norm(sub(off[k], off[k - 1]))));
            let size = rms(off.iter().map(|o| norm(*o)));
            assert!(size > 3e-4 && size < 9e-3 && jumps < 0.3 * size, "{size} {jumps}");
        }
        // The lean is along a × z, of 1 to 3° at 5 m/s².
        let (mut with, mut square) = (0.0, 0.0);
        let mut lagged = [0.0; 3];
        for k in 1..times.len() {
            let at = times[k] - late;
            let (x, before) = (between(&flight, at), between(&flight, at - 0.01));
            let acc = mul(sub(part(&x, 7), part(&before, 7)), 100.0);
            let keep = (-(times[k] - times[k - 1]) / filters.lean_memory_s).exp();
            lagged = add(mul(lagged, keep), mul([acc[0], acc[1], 0.0], 1.0 - keep));
            let axis = cross(lagged, [0.0, 0.0, 1.0]);
            if held == 0.0 {
                with += dot(turn(log.attitude.values[k], &x), axis);
                square += dot(axis, axis);
            }
        }
        let wanted = filters.lean_rad_per_m_s2;
        let degrees = (5.0 * wanted).to_degrees();
        assert!((1.0..3.0).contains(&degrees), "{degrees}");
        if held == 0.0 {
            near(with / square, wanted, 0.25 * wanted);
        }
        let velocity = &log.velocity_m_s;
        assert_eq!(velocity.t_s.len(), times.len());
        let wrong = rms(velocity
            .t_s
            .iter()
            .zip(&velocity.values)
            .map(|(t, v)| norm(sub(*v, part(&between(&flight, t - late), 7)))));
        assert!(wrong < 0.35, "{wrong}");
        // The next flight has clocks of its own, and its truth says how late they are with the delay of the filters.
        let next = fly(&Plan { flight: 1, ..plan.clone() }).unwrap();
        assert_ne!(next.truth.figures.clock_s, figures.clock_s);
        let told = flight.truth.all["clock_offset.gyro"]["late_s"];
        near(told, figures.clock_s[1] - figures.drive_clock_s + filters.late_s(), 1e-12);
        assert!((0.0025..0.007).contains(&filters.late_s()), "{}", filters.late_s());
        assert_eq!(flight.csv(), fly(&plan).unwrap().csv());
    }
}

#[test]
fn the_filter_of_the_inertial_unit_takes_half_the_power_at_its_frequency() {
    let figures = planted::estimator::Filters { cut_hz: 50.0, ..planted::estimator::Filters::new(0, 0) };
    for (hz, share) in [(1.0, 1.0), (50.0, 0.5f64.sqrt()), (200.0, 0.13)] {
        let mut filter = planted::estimator::LowPass::new(&figures);
        let mut peak: f64 = 0.0;
        for k in 0..100_000 {
            let t = f64::from(k) * 1e-5;
            let y = filter.step(1e-5, [(std::f64::consts::TAU * hz * t).sin(), 0.0, 0.0]);
            if t > 0.5 {
                peak = peak.max(y[0].abs());
            }
        }
        near(peak, share, 0.01);
    }
}

#[test]
fn vehicles_of_35_g_to_5_kg_with_4_to_8_rotors_fly_with_any_effect() {
    let masses: Vec<f64> = VEHICLES.iter().map(|n| Nominal::read(&planted(n)).unwrap().mass_kg).collect();
    assert!(masses[0] == 0.035 && masses[5] == 5.0 && masses.is_sorted(), "{masses:?}");
    let mut shrunk = Vec::new();
    for name in VEHICLES {
        let vehicle = planted(name);
        assert_eq!(vehicle.warnings(), [] as [String; 0]);
        let rotors = vehicle.file().rotor.len();
        let all = of_rotors(rotors);
        assert_eq!(all.len(), HIDDEN.len() + rotors - 4);
        for (k, id) in all.iter().chain(UNLISTED).enumerate() {
            let seed = k as u64;
            let plan = Plan { build: Build::fair(seed), ..Plan::exciting(&vehicle, &[*id], 8.0, seed) };
            let flight = fly(&plan).unwrap_or_else(|e| panic!("{name} {e}"));
            let motion = flight.truth.motion;
            assert!(motion.farthest_m < BOX_M && motion.height_m[0] > 0.0, "{name} {id} {seed}: {motion:?}");
            if flight.truth.size < 1.0 {
                shrunk.push((name, *id, flight.truth.size));
            }
        }
        for (what, excitation) in Excitation::ALL {
            let plan = Plan { excitation: *excitation, ..Plan::exciting(&vehicle, &[], 10.0, 3) };
            let flight = fly(&plan).unwrap_or_else(|e| panic!("{name} {what} {e}"));
            assert!(flight.truth.motion.tracking_m < 0.9, "{name} {what}: {:?}", flight.truth.motion);
            let (log, report) = checked(&flight);
            assert_eq!(log.cmd_rotor_rad_s.len(), rotors);
            assert!(!report.findings.iter().any(|f| f.severity == Severity::Refuse), "{:?}", report.findings);
        }
    }
    assert!(shrunk.len() <= 24, "{shrunk:?}");
    assert!(
        fly(&Plan::exciting(&quad(), &["weak_rotor.5"], 1.0, 0)).unwrap_err().contains("one of 4 rotors")
    );
}

#[test]
fn a_fair_world_scatters_otherwise_than_the_priors_and_knows_no_common_mount() {
    let scale = nominal().scale(10.0);
    for scatter in [Scatter::Normal, Scatter::Uniform, Scatter::StudentT] {
        let build = Build { width: 1.0, scatter, apart: false };
        let masses = (0..2000).map(|seed| Deviations::tolerances(seed, build, &scale).mass_factor - 1.0);
        near(rms(masses), 0.005, 0.0005);
    }
    let builds: Vec<Build> = (0..60).map(Build::fair).collect();
    assert!(builds.iter().any(|b| b.apart) && builds.iter().any(|b| !b.apart));
    assert!(builds.iter().all(|b| b.width >= 0.5 && b.width <= 2.0) && builds.iter().any(|b| b.width > 1.8));
    for scatter in [Scatter::Normal, Scatter::Uniform, Scatter::StudentT] {
        assert!(builds.iter().any(|b| b.scatter == scatter), "{scatter:?}");
    }
    let vehicle = quad();
    let mut which = [0, 0];
    for seed in 0..20 {
        let build = Build { width: 0.0, scatter: Scatter::Normal, apart: true };
        let mut dev = Deviations::tolerances(seed, build, &scale);
        dev.plant("mount", seed, 1.0, &scale, true);
        let [pose, imu] = [norm(dev.mount_rad), norm(dev.imu_mount_rad)];
        assert!((pose == 0.0) != (imu == 0.0), "{pose} {imu}");
        which[usize::from(pose == 0.0)] += 1;
        assert!(dev.also(&["mount"], &scale, 4).is_empty() && dev.also(&[], &scale, 4) == ["mount"]);
        dev.plant("clock_offset.gyro", seed, 1.0, &scale, true);
        assert!(dev.clock_s[1] == dev.clock_s[2] && dev.clock_s[0] == 0.0);
        assert_eq!(dev.also(&["mount", "clock_offset.gyro"], &scale, 4), ["clock_offset.accel"]);
    }
    assert!(which[0] > 3 && which[1] > 3, "{which:?}");
    // Of usual tolerances nothing counts as an effect.
    for seed in 0..50 {
        let truth = fly(&Plan::exciting(&vehicle, &[], 0.5, seed)).unwrap().truth;
        assert_eq!(truth.also, [] as [&str; 0], "seed {seed}");
        assert_eq!(truth.beyond, [] as [&str; 0], "seed {seed}");
    }
    // A part that is off by 3.1 tolerances is further off than usual, and no planted effect yet.
    let mut dev = Deviations::none();
    dev.inertia_factor[2] = 1.0 - 3.1 * 0.03;
    assert_eq!(dev.beyond(&scale, 4), ["wrong_inertia.z"]);
    assert!(dev.also(&[], &scale, 4).is_empty());
}

#[test]
fn attitude_and_thrust_commands_are_logged_as_the_vehicle_follows_them() {
    let vehicle = quad();
    let plan = Plan {
        build: Build::usual(0.0),
        sensors: Sensors::with(Inputs::Attitude),
        ..Plan::exciting(&vehicle, &[], 20.0, 0)
    };
    let flight = fly(&plan).unwrap();
    let (log, report) = checked(&flight);
    assert!(!report.findings.iter().any(|f| f.severity == Severity::Refuse), "{:?}", report.findings);
    assert!(log.cmd_rotor_rad_s.is_empty() && log.cmd_attitude_rad.t_s.len() == 10_001);
    // The attitude follows its command about 0.15 s late; without the command half of it would be left.
    let (mut left, mut all) = ([0.0; 3], [0.0; 3]);
    for (t, command) in log.cmd_attitude_rad.t_s.iter().zip(&log.cmd_attitude_rad.values) {
        if *t > 19.0 {
            break;
        }
        let r = matrix(attitude(&between(&flight, t + 0.15)));
        let is = [r[2][1].atan2(r[2][2]), (-r[2][0]).asin(), r[1][0].atan2(r[0][0])];
        assert!(command[2].abs() < 2.0, "yaw stays near one heading: {}", command[2]);
        for k in 0..3 {
            left[k] += (is[k] - command[k]).powi(2);
            all[k] += command[k].powi(2);
        }
    }
    for k in 0..3 {
        assert!(left[k] < 0.5 * all[k], "axis {k}: {} of {}", left[k], all[k]);
    }
    let thrust =
        log.cmd_thrust_n.values.iter().map(|v| v[0]).sum::<f64>() / log.cmd_thrust_n.values.len() as f64;
    near(thrust, 0.75 * 9.81, 0.6);
}
