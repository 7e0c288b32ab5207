//! Gradients of recorded flights: backwards what they are forwards by dual numbers and by central differences, for every model, control
//! mode, integrator and effect; and never a silent zero or a number that is none.

use propwash::physics::controllers::{ControlMode, Rates};
use propwash::physics::drone::Drone;
use propwash::physics::effects::KINDS;
use propwash::physics::integrate::Integrator;
use propwash::physics::rigid_body::State;
use propwash::random::{Key, Stream, purpose};
use propwash::rollout::pilot::{Commander, Pilot, Place};
use propwash::rollout::randomize::{Draw, Randomization, Rule};
use propwash::rollout::tape::{Partials, Tape};
use propwash::rollout::{Engine, RolloutError, Sim, SimOptions};
use propwash::scalar::lanes::{Cell, F32x16, Number};
use propwash::vehicle::{BUILTIN, Vehicle};

#[path = "common/effects.rs"]
mod effects;

fn draws(number: u64) -> Stream {
    Key { seed: 21, world: number, drone: 0, step: 0, purpose: purpose("test.gradients") }.stream()
}

/// Parameters of a drone by name.
fn names(drone: &Drone<f64>) -> Vec<String> {
    let mut out = Vec::new();
    drone.clone().visit(&mut |name, _| out.push(name.to_string()));
    out
}

/// Drones near hover, whose rotors are not driven to their limits, where slopes have two sides; they move and turn a little, with wind, disturbances and commands around hover.
fn upset<N: Number>(options: &SimOptions, drones: &[(Drone<f64>, Rates)], number: u64) -> (Sim<N>, Vec<N>) {
    let mut random = draws(number);
    let mut sim = Sim::<N>::storing(options.clone(), drones.to_vec()).unwrap();
    let (worlds, n) = (options.n_worlds, drones.len());
    for w in 0..worlds {
        for (d, (drone, _)) in drones.iter().enumerate() {
            let mut spread = |size: f64| core::array::from_fn::<f64, 3, _>(|_| size * random.normal());
            let (pos, turn, vel, ang_vel) = (spread(0.1), spread(0.15), spread(0.3), spread(0.8));
            let quat = propwash::math::quat::exp(turn);
            let rotor_vel = drone.hover_rotor_vel().map(|v| v * random.uniform(0.93, 1.07));
            let thrust = sim.data.state(w, d).thrust * random.uniform(0.93, 1.07);
            sim.data.set_state(w, d, &State { pos, quat, vel, ang_vel, rotor_vel, thrust });
        }
    }
    let mut fill =
        |list: &mut Vec<N>, size: f64| list.iter_mut().for_each(|v| *v = N::of(size * random.normal()));
    fill(&mut sim.data.wind, 0.5);
    fill(&mut sim.data.disturbance_force, 0.01);
    fill(&mut sim.data.disturbance_torque, 1e-5);
    sim.data.ground_z.fill(N::of(-1.5));
    sim.data.ceiling_z.fill(N::of(1.7));
    let mut commands = Vec::new();
    for _ in 0..worlds * TIMES {
        for (drone, _) in &drones[..n] {
            commands.extend(command(options.control, drone, sim.data.n_rotors, &mut random).map(N::of));
        }
    }
    // Before the sequence the first commands are in force.
    let each = n * sim.data.command_width;
    for w in 0..worlds {
        let from = w * TIMES * each;
        sim.data.command[w * each..(w + 1) * each].copy_from_slice(&commands[from..from + each]);
    }
    (sim, commands)
}

/// A command around hover.
fn command(
    mode: ControlMode,
    drone: &Drone<f64>,
    n_rotors: usize,
    random: &mut Stream,
) -> impl Iterator<Item = f64> {
    let mut near = |size: f64| size * random.normal();
    let mut out: Vec<f64> = match mode {
        ControlMode::State => {
            let mut out: Vec<f64> = (0..9).map(|i| near([0.1, 0.1, 0.2][i / 3])).collect();
            let yaw = near(0.3);
            out.extend([0.0, 0.0, (yaw / 2.0).sin(), (yaw / 2.0).cos()]);
            out.extend((0..3).map(|_| near(0.2)));
            out
        }
        ControlMode::RotorVel => {
            drone.hover_rotor_vel()[..n_rotors].iter().map(|v| v * (1.0 + near(0.03))).collect()
        }
        ControlMode::ForceTorque => {
            let size = 0.02 * drone.hover_thrust() * 0.05;
            vec![drone.hover_thrust() * (1.0 + near(0.05)), near(size), near(size), near(0.1 * size)]
        }
        ControlMode::Attitude | ControlMode::BodyRate => {
            vec![near(0.1), near(0.1), near(0.2), drone.hover_command() * (1.0 + near(0.05))]
        }
    };
    out.resize(mode.width(n_rotors), 0.0);
    out.into_iter()
}

const TIMES: usize = 3;

/// Numbers that the controllers of four rotors remember under state commands, and which of them are force and torque that wait for the mixer.
const OF_STATE: (usize, std::ops::Range<usize>) = (52, 40..44);

/// The parts of a set of partials, each with its name.
fn parts<N>(p: &Partials<N>) -> Vec<(&str, &[N])> {
    let mut out: Vec<(&str, &[N])> = vec![
        ("state", &p.state),
        ("commands", &p.commands),
        ("force", &p.disturbance_force),
        ("torque", &p.disturbance_torque),
        ("wind", &p.wind),
        ("controllers' memory", &p.controller_memory),
        ("effects' memory", &p.effect_memory),
    ];
    out.extend(p.parameters.iter().map(|(name, list)| (&name[..], &list[..])));
    out
}

fn parts_mut<N>(p: &mut Partials<N>) -> Vec<&mut Vec<N>> {
    let mut out = vec![
        &mut p.state,
        &mut p.commands,
        &mut p.disturbance_force,
        &mut p.disturbance_torque,
        &mut p.wind,
        &mut p.controller_memory,
        &mut p.effect_memory,
    ];
    out.extend(p.parameters.iter_mut().map(|(_, list)| list));
    out
}

/// Compares, part by part, what a random loss gains in a random direction: backwards and by dual numbers. Returns the parts that
/// mattered.
fn agree<N: Number>(
    name: &str,
    tape: &mut Tape<N>,
    wanted: &[&str],
    within: f64,
    number: u64,
) -> Vec<String> {
    let mut random = draws(1000 + number);
    let width = tape.state_width();
    // Weights that bring the parts of a state to like sizes.
    let weigh = |col: usize| if col >= 13 && col + 1 < width { 1e-3 } else { 1.0 };
    let seeds: Vec<N> = (0..tape.states().len()).map(|i| N::of(weigh(i % width) * random.normal())).collect();
    let gains = tape.pull_back(&seeds, wanted).unwrap_or_else(|e| panic!("{name}: {e}"));
    let mut mattered = Vec::new();
    for (k, (part, gained)) in parts(&gains).into_iter().enumerate() {
        if gained.is_empty() {
            continue;
        }
        let mut direction = tape.zero(wanted);
        let list = &mut parts_mut(&mut direction)[k];
        assert_eq!(list.len(), gained.len(), "{name}: {part}");
        for v in list.iter_mut() {
            *v = N::of(random.normal());
        }
        if part == "controllers' memory" {
            // Force and torque that wait for the mixer, of a drone whose rotors are at their limit: they are exactly at it, where the slope has
            // two sides, and rounding chooses between them.
            let columns = list.len() / tape.start().n_worlds / tape.start().n_drones;
            if columns == OF_STATE.0 {
                list.chunks_mut(columns).for_each(|row| row[OF_STATE.1].fill(N::zero()));
            }
        }
        let along: Vec<f64> = list.iter().map(|v| v.wide()).collect();
        let moved = tape.push_forward(&direction).unwrap_or_else(|e| panic!("{name}: {part}: {e}"));
        let forwards: Vec<f64> = moved.iter().zip(&seeds).map(|(m, s)| m.wide() * s.wide()).collect();
        let backwards: Vec<f64> = gained.iter().zip(&along).map(|(g, a)| g.wide() * a).collect();
        let size = forwards.iter().chain(&backwards).map(|v| v.abs()).sum::<f64>();
        let (f, b) = (forwards.iter().sum::<f64>(), backwards.iter().sum::<f64>());
        assert!(
            (f - b).abs() <= within * size,
            "{name}: by {part}: {b:e} backwards, {f:e} forwards (of {size:e})"
        );
        if size > 0.0 {
            mattered.push(part.to_string());
        }
    }
    mattered
}

/// All models of two vehicles in all modes by all integrators, by state, commands, what disturbs, wind, memory and every parameter.
#[test]
fn every_model_mode_and_integrator_has_the_gradient_of_dual_numbers() {
    let mut flown = 0;
    for (v, name) in BUILTIN.iter().enumerate() {
        let vehicle = Vehicle::builtin(name).unwrap();
        for dynamics in vehicle.available_dynamics() {
            let drone = vehicle.drone(dynamics).unwrap();
            for mode in vehicle.modes(dynamics).unwrap() {
                for integrator in [Integrator::Euler, Integrator::SemiImplicitEuler, Integrator::Rk4] {
                    // One vehicle by all integrators, the others by the usual one.
                    if v > 0 && integrator != Integrator::Euler {
                        continue;
                    }
                    let options =
                        SimOptions { n_worlds: 2, control: mode, integrator, ..SimOptions::default() };
                    let label = format!("{name} {dynamics} {} {}", mode.name(), integrator.name());
                    let drones = [(drone.clone(), vehicle.rates)];
                    let (mut sim, commands) = upset::<f64>(&options, &drones, flown);
                    // 7 steps under a command: stages that tick at other rates tick in some of them only.
                    let mut tape = sim.record(&commands, 7).unwrap();
                    let every = names(&drone);
                    // All parameters once, then a ninth of them each time.
                    let own =
                        |k: usize| v == 0 && integrator == Integrator::Euler || k % 9 == flown as usize % 9;
                    let wanted: Vec<&str> =
                        every.iter().enumerate().filter(|(k, _)| own(*k)).map(|(_, n)| &n[..]).collect();
                    let mattered = agree(&label, &mut tape, &wanted, 1e-10, flown);
                    assert!(mattered.len() > 4, "{label}: {mattered:?}");
                    flown += 1;
                }
            }
        }
    }
    assert!(flown > 40, "{flown}");
}

/// Every effect, with what it remembers, beside a drag; two drones for what they feel of each other.
#[test]
fn every_effect_has_the_gradient_of_dual_numbers() {
    // What sensors and the file's frame make of a flight does not move it, nor does what is at its defaults here.
    let mut moved = 0;
    for (number, kind) in KINDS.iter().enumerate() {
        let drag = "[[effect]]\nkind = \"linear_drag\"\ndrag_n_s_per_m = [[0.01, 0, 0], [0, 0.01, 0], [0, 0, 0.01]]\n";
        let beside = if *kind == "linear_drag" { "" } else { drag };
        let vehicle = effects::vehicle(&format!("{beside}{}", effects::entry(kind)));
        let drone = vehicle.drone("first_principles").unwrap();
        let near = drone.reads().neighbours;
        let options = SimOptions { n_worlds: 3, control: ControlMode::Attitude, ..SimOptions::default() };
        let drones = vec![(drone.clone(), vehicle.rates); if near { 3 } else { 1 }];
        let (mut sim, commands) = upset::<f64>(&options, &drones, number as u64);
        let mut tape = sim.record(&commands, 5).unwrap();
        let every = names(&drone);
        let own = |name: &&str| name.starts_with("effect.") || !near && name.starts_with("body.mass");
        let wanted: Vec<&str> = every.iter().map(|n| &n[..]).filter(own).collect();
        let mattered = agree(kind, &mut tape, &wanted, 1e-10, number as u64);
        let own = |name: &String| name.starts_with(&format!("effect.{kind}"));
        moved += usize::from(mattered.iter().any(own));
    }
    assert!(moved >= 25, "{moved} of {} effects have gains by their own parameters", KINDS.len());
}

/// Worlds that began at different times, of two kinds of drones with their own rates, parameters of their own, flights longer than what is
/// kept at once, in f64 and in f32.
#[test]
fn worlds_that_differ_have_their_own_gradients() {
    let quad = Vehicle::builtin("cf2x_L250").unwrap();
    let other = Vehicle::builtin("cf21B_500").unwrap();
    let windy = effects::vehicle(&format!("{}{}", effects::entry("turbulence"), effects::entry("downwash")));
    let slow = Rates { state_hz: 90, attitude_hz: 250, body_rate_hz: 400, force_torque_hz: 400 };
    let even = Rates { attitude_hz: 400, force_torque_hz: 400, body_rate_hz: 400, ..quad.rates };
    let rule = |parameter: &str, draw| Rule { parameter: parameter.into(), draw, shared: false };
    let rules = vec![
        rule("body.mass_kg", Draw::Scale([0.95, 1.05])),
        rule("rotors.*.thrust_curve.2", Draw::Scale([0.98, 1.02])),
    ];
    let options = SimOptions {
        n_worlds: 21,
        seed: 4,
        sim_hz: 400,
        control: ControlMode::State,
        randomization: Randomization { rules },
        engine: Engine::Lanes,
        ..SimOptions::default()
    };
    let drones = vec![
        (windy.drone("first_principles").unwrap(), even),
        (other.drone("so_rpy_rotor_drag").unwrap(), slow),
        (quad.drone("first_principles").unwrap(), slow),
    ];
    fn of<N: Number>(options: &SimOptions, drones: &[(Drone<f64>, Rates)], within: f64) {
        for (number, substeps) in [(1, 4), (2, 60)] {
            let (mut sim, commands) = upset::<N>(options, drones, number);
            sim.step(3).unwrap();
            let late: Vec<bool> = (0..options.n_worlds).map(|w| w % 3 == 1).collect();
            sim.reset(Some(&late)).unwrap();
            let mut tape = sim.record(&commands, substeps).unwrap();
            agree("two kinds", &mut tape, &["effect.turbulence.sigma_m_s.0"], within, number);
        }
        // The same without what drones feel of each other, where every parameter has its gradient.
        let (mut sim, commands) = upset::<N>(options, &drones[1..], 3);
        sim.step(3).unwrap();
        let late: Vec<bool> = (0..options.n_worlds).map(|w| w % 3 == 1).collect();
        sim.reset(Some(&late)).unwrap();
        let mut tape = sim.record(&commands, 60).unwrap();
        agree("their own masses", &mut tape, &["body.mass_kg", "rotors.2.thrust_curve.2"], within, 3);
        // Another draw, the same programs.
        sim.reset(None).unwrap();
        let mut tape = sim.record(&commands, 8).unwrap();
        agree("drawn anew", &mut tape, &["body.mass_kg"], within, 4);
    }
    of::<f64>(&options, &drones, 1e-10);
    of::<f32>(&options, &drones, 2e-3);
}

/// Central differences of whole flights, by what rollouts say.
#[test]
fn gradients_are_those_of_differences() {
    let vehicle = Vehicle::builtin("cf21B_500").unwrap();
    let drone = vehicle.drone("first_principles").unwrap();
    for mode in vehicle.modes("first_principles").unwrap() {
        let options = SimOptions { control: mode, ..SimOptions::default() };
        let drones = [(drone.clone(), vehicle.rates)];
        let (mut sim, commands) = upset::<f64>(&options, &drones, 77);
        let start = sim.save();
        let mut tape = sim.record(&commands, 10).unwrap();
        let seeds: Vec<f64> =
            (0..tape.states().len()).map(|i| if i % tape.state_width() < 13 { 1.0 } else { 0.0 }).collect();
        let gains = tape.pull_back(&seeds, &["body.mass_kg", "body.inertia_kg_m2.0.0"]).unwrap();
        let loss = |sim: &mut Sim<f64>, commands: &[f64]| -> f64 {
            sim.rollout(commands, 10).unwrap().iter().zip(&seeds).map(|(v, s)| v * s).sum()
        };
        let scale = gains.commands.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        for k in 0..commands.len() {
            let step = 1e-5 * commands[k].abs().max(1e-2);
            let mut at = |by: f64| {
                let mut moved = commands.clone();
                moved[k] += by;
                sim.restore(&start).unwrap();
                loss(&mut sim, &moved)
            };
            let slope = (at(step) - at(-step)) / (2.0 * step);
            assert!(
                (slope - gains.commands[k]).abs() < 1e-6 * scale,
                "{mode:?} {k}: {slope} {}",
                gains.commands[k]
            );
        }
        for (name, by) in &gains.parameters {
            let value = {
                let mut value = 0.0;
                drone.clone().visit(&mut |n, v| {
                    if n == name {
                        value = *v
                    }
                });
                value
            };
            let mut at = |by: f64| {
                sim.restore(&start).unwrap();
                sim.set_parameter(None, 0, name, value * (1.0 + by)).unwrap();
                loss(&mut sim, &commands)
            };
            let slope = (at(1e-5) - at(-1e-5)) / (2e-5 * value);
            assert!(
                (slope - by[0]).abs() < 1e-6 * by[0].abs().max(1.0),
                "{mode:?} {name}: {slope} {}",
                by[0]
            );
        }
    }
}

/// A rollout does what setting commands and stepping does, with and without lanes, and where a world flies away.
#[test]
fn rollouts_are_steps_under_one_command_after_the_other() {
    fn of<N: Number>(engine: Engine, lost: bool) {
        let vehicle = Vehicle::builtin("cf2x_L250").unwrap();
        let drones = vec![(vehicle.drone("first_principles").unwrap(), vehicle.rates); 2];
        let options =
            SimOptions { n_worlds: 37, engine, control: ControlMode::Attitude, ..SimOptions::default() };
        let (mut sim, commands) = upset::<N>(&options, &drones, 5);
        if lost {
            // Far out, and fast: beyond what counts as a position within the second command.
            sim.data.pos[3 * 2 * 4] = N::of(0.99998e9);
            sim.data.vel[3 * 2 * 4] = N::of(1e6);
        }
        let before = sim.save();
        let states = sim.rollout(&commands, 8).unwrap();
        let after = sim.save();
        sim.restore(&before).unwrap();
        let width = 18;
        assert_eq!(states.len(), 37 * TIMES * 2 * width);
        let each = 2 * 4;
        for t in 0..TIMES {
            for w in 0..37 {
                let from = (w * TIMES + t) * each;
                sim.data.command[w * each..(w + 1) * each].copy_from_slice(&commands[from..from + each]);
            }
            sim.step(8).unwrap();
            for row in 0..37 * 2 {
                let (w, d) = (row / 2, row % 2);
                let got = &states[((w * TIMES + t) * 2 + d) * width..][..width];
                assert_eq!(got[..3], sim.data.pos[3 * row..3 * row + 3], "{engine:?} {t} {w} {d}");
                assert_eq!(got[3..7], sim.data.quat[4 * row..4 * row + 4]);
                assert_eq!(got[13..17], sim.data.rotor_vel[4 * row..4 * row + 4]);
            }
        }
        assert_eq!(sim.save().data(), after.data());
        assert_eq!(sim.data.quarantine[4].is_some(), lost);
    }
    for lost in [false, true] {
        of::<f64>(Engine::Reference, lost);
        of::<f64>(Engine::Lanes, lost);
        of::<f32>(Engine::Lanes, lost);
    }
}

/// The same where every stage ticks in every step, so that what no later step reads is computed once, at the end: all models in all modes, and every effect.
#[test]
fn rollouts_compute_once_what_only_their_end_shows() {
    fn of<N: Number>(what: &str, drones: &[(Drone<f64>, Rates)], mode: ControlMode, substeps: usize) {
        let options = SimOptions { n_worlds: 19, control: mode, ..SimOptions::default() };
        let hz = options.sim_hz;
        let rates = Rates { state_hz: hz, attitude_hz: hz, body_rate_hz: hz, force_torque_hz: hz };
        let drones: Vec<_> = drones.iter().map(|(drone, _)| (drone.clone(), rates)).collect();
        let (mut sim, commands) = upset::<N>(&options, &drones, 9);
        let before = sim.save();
        let states = sim.rollout(&commands, substeps).unwrap();
        let after = sim.save();
        sim.restore(&before).unwrap();
        let each = drones.len() * sim.data.command_width;
        let width = states.len() / (19 * TIMES * drones.len());
        for t in 0..TIMES {
            for w in 0..19 {
                let from = (w * TIMES + t) * each;
                sim.data.command[w * each..(w + 1) * each].copy_from_slice(&commands[from..from + each]);
            }
            sim.step(substeps).unwrap();
            for row in 0..19 * drones.len() {
                let (w, d) = (row / drones.len(), row % drones.len());
                let got = &states[((w * TIMES + t) * drones.len() + d) * width..][..width];
                let (data, n) = (&sim.data, width - 14);
                let parts = [
                    (&data.pos, 3),
                    (&data.quat, 4),
                    (&data.vel, 3),
                    (&data.ang_vel, 3),
                    (&data.rotor_vel, n),
                ];
                let wanted = parts.iter().flat_map(|(list, n)| &list[n * row..n * (row + 1)]);
                let wanted: Vec<N> = wanted.chain([&data.thrust[row]]).copied().collect();
                assert_eq!(
                    got, wanted,
                    "{what} {mode:?}, {substeps} steps under command {t}: world {w}, drone {d}"
                );
            }
        }
        assert_eq!(sim.save().data(), after.data(), "{what} {mode:?} at the end");
    }
    let mut flown = 0;
    for substeps in [1, 3] {
        let vehicle = Vehicle::builtin("cf21B_500").unwrap();
        for dynamics in vehicle.available_dynamics() {
            for mode in vehicle.modes(dynamics).unwrap() {
                let drones = [(vehicle.drone(dynamics).unwrap(), vehicle.rates)];
                of::<f64>(dynamics, &drones, mode, substeps);
                of::<f32>(dynamics, &drones, mode, substeps);
                flown += 1;
            }
        }
        for kind in KINDS {
            let vehicle = effects::vehicle(&effects::entry(kind));
            let drone = vehicle.drone("first_principles").unwrap();
            let n = if drone.reads().neighbours { 3 } else { 1 };
            of::<f32>(kind, &vec![(drone, vehicle.rates); n], ControlMode::Attitude, substeps);
        }
    }
    assert!(flown > 20, "{flown}");
}

/// Hover, no thrust at all, on its side, upside down, and anywhere between: never a number that is none.
#[test]
fn gradients_are_finite_wherever_a_drone_is() {
    let worlds = 4096;
    for (name, dynamics, mode) in [
        ("cf2x_L250", "first_principles", ControlMode::Attitude),
        ("cf21B_500", "first_principles", ControlMode::RotorVel),
        ("cf2x_L250", "first_principles", ControlMode::State),
        ("cf2x_T350", "so_rpy_rotor_drag", ControlMode::Attitude),
    ] {
        let vehicle = Vehicle::builtin(name).unwrap();
        let drone = vehicle.drone(dynamics).unwrap();
        let options =
            SimOptions { n_worlds: worlds, control: mode, engine: Engine::Lanes, ..SimOptions::default() };
        let mut sim = Sim::<f32>::storing(options, vec![(drone.clone(), vehicle.rates)]).unwrap();
        let mut random = draws(9);
        let mut commands: Vec<f32> = Vec::new();
        for w in 0..worlds {
            let mut s = sim.data.state(w, 0);
            let half = [0.0, 0.5, 1.0, 2.0][w % 4] * std::f64::consts::FRAC_PI_2;
            let axis = w / 4 % 3;
            s.quat = [0.0; 4];
            (s.quat[axis], s.quat[3]) = ((half / 2.0).sin(), (half / 2.0).cos());
            if w % 16 > 4 {
                s.quat = propwash::math::quat::exp(core::array::from_fn(|_| 2.0 * random.normal()));
                s.vel = core::array::from_fn(|_| 5.0 * random.normal());
                s.ang_vel = core::array::from_fn(|_| 6.0 * random.normal());
            }
            if w % 5 == 1 {
                (s.rotor_vel, s.thrust) = ([0.0; 8], 0.0);
            }
            sim.data.set_state(w, 0, &s);
            let still = w % 7 == 2;
            commands
                .extend(command(mode, &drone, 4, &mut random).map(|v| if still { 0.0 } else { v as f32 }));
        }
        let mut tape = sim.record(&commands, 10).unwrap();
        assert!(tape.faults().is_empty());
        let seeds: Vec<f32> = (0..tape.states().len()).map(|_| random.normal() as f32).collect();
        let gains = tape.pull_back(&seeds, &["body.mass_kg"]).unwrap();
        let moved = gains.commands.chunks(mode.width(4)).filter(|c| c.iter().any(|v| *v != 0.0)).count();
        assert!(moved > worlds / 4, "{name} {mode:?}: {moved} of {worlds} commands matter");
    }
}

#[test]
fn what_has_no_gradient_is_refused_in_words() {
    let vehicle = effects::vehicle(&effects::entry("downwash"));
    let drones = vec![(vehicle.drone("first_principles").unwrap(), vehicle.rates); 2];
    let options = SimOptions { n_worlds: 2, control: ControlMode::Attitude, ..SimOptions::default() };
    let (mut sim, commands) = upset::<f64>(&options, &drones, 1);
    let told = |e: RolloutError| e.to_string();
    assert!(told(sim.record(&commands[1..], 4).unwrap_err()).contains("commands: expected"));
    assert!(told(sim.record(&commands, 0).unwrap_err()).contains("substeps"));
    let mut bad = commands.clone();
    bad[5] = f64::NAN;
    assert!(told(sim.rollout(&bad, 4).unwrap_err()).contains("world 0, drone 1, entry 1"));
    let mut tape = sim.record(&commands, 4).unwrap();
    let seeds = vec![1.0; tape.states().len()];
    assert!(told(tape.pull_back(&seeds[1..], &[]).unwrap_err()).contains("seeds: expected"));
    assert!(told(tape.pull_back(&seeds, &["body.mass"]).unwrap_err()).contains("body.mass_kg"));
    assert!(told(tape.pull_back(&seeds, &["body.mass_kg"]).unwrap_err()).contains("other drones feel"));
    // A world that flies away.
    sim.data.pos[0] = 2e9;
    let mut tape = sim.record(&commands, 4).unwrap();
    assert_eq!(tape.faults().len(), 1);
    assert!(told(tape.pull_back(&seeds, &[]).unwrap_err()).contains("world 0"));
    let half = seeds.len() / 2;
    let others: Vec<f64> = seeds.iter().enumerate().map(|(i, v)| if i < half { 0.0 } else { *v }).collect();
    let gains = tape.pull_back(&others, &[]).unwrap();
    assert!(gains.state[gains.state.len() / 2..].iter().any(|v| *v != 0.0));
    sim.pipeline.append("gust", Box::new(|data| data.wind[0] = 1.0)).unwrap();
    assert!(told(sim.record(&commands, 4).unwrap_err()).contains("gust"));
}

/// A pilot that commands hover and asks for nothing.
struct Idle(f32);

impl Commander<f32> for Idle {
    fn command(&self, _: Place, _: &[F32x16], command: &mut [F32x16]) {
        command.fill(F32x16::splat(0.0));
        command[3] = F32x16::splat(self.0);
    }
    fn look(&self, _: Place, _: &[F32x16]) {}
    fn lost(&self, at: Place) {
        assert_eq!(at.first_world, 16, "only the second block is lost");
    }
}

impl Pilot<f32> for Idle {
    fn seed(&self, _: Place, _: &mut [F32x16]) {}
    fn pull_back(&self, _: Place, by_command: &[F32x16], _: &mut [F32x16]) {
        assert!(by_command.iter().all(|cell| *cell == F32x16::splat(0.0)));
    }
}

/// A flight under a pilot ends where the same commands end, block by block; a block that is lost stays where it was; and what it cannot fly is
/// refused in words.
#[test]
fn pilots_fly_what_sequences_of_commands_fly() {
    let vehicle = Vehicle::builtin("cf2x_L250").unwrap();
    let drone = vehicle.drone("first_principles").unwrap();
    let drones = vec![(drone.clone(), vehicle.rates)];
    let options = SimOptions { n_worlds: 35, control: ControlMode::Attitude, ..SimOptions::default() };
    let (mut sim, _) = upset::<f32>(&options, &drones, 12);
    let hover = drone.hover_command() as f32;
    let start = sim.save();
    let commands: Vec<f32> = [0.0, 0.0, 0.0, hover].repeat(35 * 6);
    sim.rollout(&commands, 10).unwrap();
    let wanted = sim.save();
    sim.restore(&start).unwrap();
    sim.fly_piloted(&Idle(hover), 6, 10).unwrap();
    assert_eq!(sim.data.pos, wanted.data().pos);
    assert_eq!(sim.data.controller_memory, wanted.data().controller_memory);
    assert_eq!(sim.data.steps, wanted.data().steps);
    // The same without the way back.
    sim.restore(&start).unwrap();
    sim.fly_commanded(&Idle(hover), 6, 10).unwrap();
    assert_eq!(sim.data.pos, wanted.data().pos);
    assert_eq!(sim.data.controller_memory, wanted.data().controller_memory);
    assert_eq!(sim.data.steps, wanted.data().steps);
    sim.restore(&start).unwrap();
    (sim.data.pos[3 * 20], sim.data.vel[3 * 20]) = (0.99998e9, 1e6);
    let before = sim.save();
    for backwards in [true, false] {
        sim.restore(&before).unwrap();
        match backwards {
            true => sim.fly_piloted(&Idle(hover), 6, 10).unwrap(),
            false => sim.fly_commanded(&Idle(hover), 6, 10).unwrap(),
        }
        for w in 0..35 {
            let own = 3 * w..3 * w + 3;
            let lost = (16..32).contains(&w);
            let expected = if lost { &before.data().pos } else { &wanted.data().pos };
            assert_eq!(sim.data.pos[own.clone()], expected[own], "{w}");
            assert_eq!(sim.data.steps[w], if lost { 0 } else { 60 });
        }
    }
    let told = |sim: &mut Sim<f32>, times| sim.fly_piloted(&Idle(hover), times, 1).unwrap_err().to_string();
    assert!(told(&mut sim, 0).contains("at least one each"));
    let forwards = sim.fly_commanded(&Idle(hover), 1, 0).unwrap_err().to_string();
    assert!(forwards.contains("at least one each"));
    sim.data.pos[0] = 2e9;
    sim.step(1).unwrap();
    assert!(told(&mut sim, 1).contains("stands still"));
    let (mut two, _) = upset::<f32>(&options, &[drones[0].clone(), drones[0].clone()], 1);
    assert!(told(&mut two, 1).contains("one in each world"));
    let reference = SimOptions { engine: Engine::Reference, ..options };
    let (mut slow, _) = upset::<f32>(&reference, &drones, 1);
    assert!(told(&mut slow, 1).contains("`lanes`, for pilots"));
}
