//! Lanes fly as the equations do: every vehicle, model, mode and integrator, from random states.

use propwash::physics::controllers::{ControlMode, Rates};
use propwash::physics::drone::Drone;
use propwash::physics::effects::{AnyEffect, KINDS};
use propwash::physics::integrate::Integrator;
use propwash::physics::params::Parameters;
use propwash::physics::rigid_body::State;
use propwash::random::{Key, Stream, purpose};
use propwash::rollout::pipeline::CONTROLLERS;
use propwash::rollout::randomize::{Draw, Randomization, Rule};
use propwash::rollout::{Engine, Sim, SimOptions};
use propwash::scalar::lanes::Number;
use propwash::vehicle::Vehicle;

fn draws(step: u64) -> Stream {
    Key { seed: 1, world: 0, drone: 0, step, purpose: purpose("test.lanes") }.stream()
}

/// A state about a decimetre from the origin, tilted by about 0.2 rad and moving at some decimetres per second, rotors about hover
/// speed. (Further off, controllers saturate, and the flight itself magnifies the rounding of f32.)
fn state(drone: &Drone<f64>, s: &mut Stream) -> State<f64> {
    let mut out = State::rest();
    for i in 0..3 {
        out.pos[i] = 0.1 * s.normal();
        out.vel[i] = 0.3 * s.normal();
        out.ang_vel[i] = 0.3 * s.normal();
    }
    out.quat = [0.1 * s.normal(), 0.1 * s.normal(), 0.1 * s.normal(), 1.0];
    let length = out.quat.iter().map(|v| v * v).sum::<f64>().sqrt();
    out.quat.iter_mut().for_each(|v| *v /= length);
    out.rotor_vel = drone.hover_rotor_vel().map(|v| v * (1.0 + 0.05 * s.normal()));
    out.thrust = drone.hover_thrust();
    out
}

fn command(drone: &Drone<f64>, mode: ControlMode, s: &mut Stream) -> Vec<f64> {
    let weight = drone.hover_thrust();
    match mode {
        ControlMode::State => {
            let mut c = vec![0.0; 16];
            c[..3].iter_mut().for_each(|v| *v = 0.1 * s.normal());
            let yaw = 0.3 * s.normal();
            (c[11], c[12]) = ((0.5 * yaw).sin(), (0.5 * yaw).cos());
            c
        }
        ControlMode::Attitude => {
            vec![0.2 * s.normal(), 0.2 * s.normal(), 0.3 * s.normal(), weight * s.uniform(0.9, 1.1)]
        }
        ControlMode::BodyRate => {
            vec![0.3 * s.normal(), 0.3 * s.normal(), 0.3 * s.normal(), weight * s.uniform(0.9, 1.1)]
        }
        ControlMode::ForceTorque => vec![weight * s.uniform(0.95, 1.05), 0.0, 0.0, 0.0],
        ControlMode::RotorVel => {
            let n = drone.airframe.n_rotors;
            drone.hover_rotor_vel()[..n].iter().map(|v| v * s.uniform(0.99, 1.01)).collect()
        }
    }
}

/// The simulation after its random start, under random commands.
fn sim<N: Number>(options: &SimOptions, drones: &[(Drone<f64>, Rates)]) -> Sim<N> {
    let mut sim = Sim::<N>::storing(options.clone(), drones.to_vec()).unwrap();
    let mut s = draws(1);
    for w in 0..options.n_worlds {
        for (d, (drone, _)) in drones.iter().enumerate() {
            sim.set_initial(w, d, state(drone, &mut s)).unwrap();
        }
    }
    sim.reset(None).unwrap();
    let mut commands = Vec::new();
    for _ in 0..options.n_worlds {
        for (drone, _) in drones {
            commands.extend(command(drone, options.control, &mut s));
        }
    }
    sim.set_command(&commands).unwrap();
    sim
}

/// Commands that level a drone which has no controller of its own: torques or rotor speeds against tilt and turn.
fn levelling<N: Number>(sim: &Sim<N>, drones: &[(Drone<f64>, Rates)]) -> Vec<f64> {
    let mut out = Vec::new();
    for w in 0..sim.data.n_worlds {
        for (d, (drone, _)) in drones.iter().enumerate() {
            let s = sim.data.state(w, d);
            let turn = 2.0 * s.quat[3].signum();
            let wanted: [f64; 3] = std::array::from_fn(|i| -40.0 * turn * s.quat[i] - 12.0 * s.ang_vel[i]);
            let torque: [f64; 3] = std::array::from_fn(|i| drone.body.inertia_kg_m2[i][i] * wanted[i]);
            if sim.options().control == ControlMode::ForceTorque {
                out.push(drone.hover_thrust());
                out.extend(torque);
                continue;
            }
            let rotors = &drone.airframe.rotors[..drone.airframe.n_rotors];
            let each = drone.hover_thrust() / rotors.len() as f64;
            let square = |i: usize| rotors.iter().map(|r| r.position_m[i] * r.position_m[i]).sum::<f64>();
            // Thrust grows with the square of the speed; a rotor at y > 0 rolls to the right, one at x > 0 pitches up.
            out.extend(rotors.iter().zip(drone.hover_rotor_vel()).map(|(r, hover)| {
                let roll = torque[0] * r.position_m[1] / square(1);
                let pitch = -torque[1] * r.position_m[0] / square(0);
                hover * (1.0 + (roll + pitch) / (2.0 * each))
            }));
        }
    }
    out
}

/// Takes steps; where nothing on board closes the loop, commands do every fifth.
fn fly<N: Number>(sim: &mut Sim<N>, drones: &[(Drone<f64>, Rates)], steps: usize) {
    if !matches!(sim.options().control, ControlMode::ForceTorque | ControlMode::RotorVel) {
        return sim.step(steps).unwrap();
    }
    for _ in 0..steps / 5 {
        let command = levelling(sim, drones);
        sim.set_command(&command).unwrap();
        sim.step(5).unwrap();
    }
}

/// Largest difference in position, m, and of attitude, rad, between two simulations.
fn apart<A: Number, B: Number>(a: &Sim<A>, b: &Sim<B>) -> (f64, f64) {
    let (mut far, mut turned): (f64, f64) = (0.0, 0.0);
    for w in 0..a.data.n_worlds {
        for d in 0..a.data.n_drones {
            let (a, b) = (a.data.state(w, d), b.data.state(w, d));
            for i in 0..3 {
                far = far.max((a.pos[i] - b.pos[i]).abs());
            }
            let same: f64 = (0..4).map(|i| a.quat[i] * b.quat[i]).sum::<f64>().signum();
            let off: f64 = (0..4).map(|i| (a.quat[i] - same * b.quat[i]).powi(2)).sum();
            turned = turned.max(2.0 * off.sqrt());
        }
    }
    (far, turned)
}

fn compare(name: &str, options: &SimOptions, drones: &[(Drone<f64>, Rates)], steps: usize, tight: bool) {
    let mut reference = sim::<f64>(&SimOptions { engine: Engine::Reference, ..options.clone() }, drones);
    let mut wide = sim::<f64>(&SimOptions { engine: Engine::Lanes, ..options.clone() }, drones);
    let mut narrow = sim::<f32>(options, drones);
    fly(&mut reference, drones, steps);
    fly(&mut wide, drones, steps);
    fly(&mut narrow, drones, steps);
    assert!(reference.data.quarantine.iter().all(Option::is_none), "{name}");
    let moved = apart(&reference, &sim::<f64>(options, drones));
    assert!(moved.0 > 0.0003 * steps as f64, "{name} {moved:?}");
    let (f64_m, f64_rad) = apart(&reference, &wide);
    let (f32_m, f32_rad) = apart(&reference, &narrow);
    println!("{name}: f64 {f64_m:.1e} m {f64_rad:.1e} rad, f32 {f32_m:.1e} m {f32_rad:.1e} rad");
    assert!(f64_m < 1e-10 && f64_rad < 1e-10, "{name}: f64 lanes are off by {f64_m:e} m, {f64_rad:e} rad");
    // A tumbling vehicle magnifies rounding, in both precisions alike: what f64 is off by says how much.
    let magnified_rad = f64_rad * f64::from(f32::EPSILON) / f64::EPSILON;
    let most_rad = if tight { 1e-4 } else { magnified_rad.max(1e-3) };
    assert!(f32_m < 1e-4 && f32_rad < most_rad, "{name}: f32 lanes are off by {f32_m:e} m, {f32_rad:e} rad");
    assert_eq!(reference.data.steps, narrow.data.steps);
}

#[test]
fn lanes_fly_as_the_equations_do() {
    for name in propwash::vehicle::BUILTIN {
        let vehicle = Vehicle::builtin(name).unwrap();
        for dynamics in vehicle.available_dynamics() {
            let drone = vehicle.drone(dynamics).unwrap();
            for control in vehicle.modes(dynamics).unwrap() {
                for integrator in [Integrator::Euler, Integrator::SemiImplicitEuler, Integrator::Rk4] {
                    let options = SimOptions { n_worlds: 37, control, integrator, ..SimOptions::default() };
                    let name = format!("{name} {dynamics} {control:?} {integrator:?}");
                    compare(&name, &options, &[(drone.clone(), vehicle.rates)], 500, true);
                }
            }
        }
    }
}

fn quad() -> (Drone<f64>, Rates) {
    let vehicle = Vehicle::builtin("cf2x_L250").unwrap();
    (vehicle.drone("first_principles").unwrap(), vehicle.rates)
}

/// Every built-in effect with numbers that are not those of an effect without influence, one after the other.
#[test]
fn lanes_feel_every_effect_as_the_equations_do() {
    let mut random = draws(2);
    let mut flown = 0;
    for kind in KINDS {
        let mut effect = AnyEffect::by_kind(kind).unwrap();
        effect.visit("", &mut |_, v| *v += 2e-4 * random.uniform(0.5, 1.0));
        let (mut drone, rates) = quad();
        drone.effects.push(effect);
        let options =
            SimOptions { n_worlds: 19, seed: 4, control: ControlMode::Attitude, ..SimOptions::default() };
        // A drone that is made of other parts falls far: what is compared is a short flight.
        compare(kind, &options, &[(drone.clone(), rates), (drone, rates)], 100, false);
        flown += 1;
    }
    assert!(flown > 35, "{flown}");
}

/// A world of two vehicle types with own rates, one of them in turbulence, drawn anew at every reset.
fn busy(n_worlds: usize, first_world: usize) -> SimOptions {
    let rule = |parameter: &str, draw| Rule { parameter: parameter.into(), draw, shared: false };
    let rules = vec![
        rule("body.mass_kg", Draw::Scale([0.95, 1.05])),
        rule("rotors.*.thrust_curve.2", Draw::Scale([0.98, 1.02])),
        rule("initial.pos.*", Draw::Normal(0.3)),
        rule("initial.rotation.*", Draw::Normal(0.1)),
    ];
    SimOptions {
        n_worlds,
        first_world: first_world as u64,
        seed: 9,
        sim_hz: 400,
        control: ControlMode::State,
        randomization: Randomization { rules },
        engine: Engine::Lanes,
        ..SimOptions::default()
    }
}

fn two_kinds() -> Vec<(Drone<f64>, Rates)> {
    let (mut windy, rates) = quad();
    let mut air = AnyEffect::by_kind("turbulence").unwrap();
    air.visit("", &mut |name, v| *v = if name.contains("sigma") { 0.3 } else { 2.0 });
    let mut wash = AnyEffect::by_kind("downwash").unwrap();
    wash.visit("", &mut |name, v| *v = if name.contains("area") { 0.002 } else { 0.1 });
    windy.effects.extend([air, wash]);
    let other = Vehicle::builtin("cf21B_500").unwrap();
    let slow = Rates { state_hz: 90, attitude_hz: 250, body_rate_hz: 400, force_torque_hz: 400 };
    vec![(windy, rates), (other.drone("so_rpy_rotor_drag").unwrap(), slow), (quad().0, slow)]
        .into_iter()
        .map(|(d, r)| {
            (d, Rates { attitude_hz: r.attitude_hz.min(400), body_rate_hz: 400, force_torque_hz: 400, ..r })
        })
        .collect()
}

/// Two calls with a reset of some worlds between them, so that worlds of one block are at different steps.
fn flown<N: Number>(options: &SimOptions, reset: impl Fn(usize) -> bool) -> Sim<N> {
    let mut sim = Sim::<N>::storing(options.clone(), two_kinds()).unwrap();
    let mut commands = Vec::new();
    for w in 0..options.n_worlds {
        for d in 0..3 {
            let mut s = draws(1000 + 10 * (options.first_world + w as u64) + d);
            commands.extend(command(&two_kinds()[0].0, ControlMode::State, &mut s));
        }
    }
    sim.set_command(&commands).unwrap();
    sim.step(7).unwrap();
    let mask: Vec<bool> = (0..options.n_worlds).map(|w| reset(options.first_world as usize + w)).collect();
    sim.reset(Some(&mask)).unwrap();
    sim.step(33).unwrap();
    sim.step(1).unwrap();
    sim
}

fn bits<N: Number>(sim: &Sim<N>, worlds: std::ops::Range<usize>) -> Vec<u64> {
    let d = &sim.data;
    let mut out = Vec::new();
    for (array, width) in [
        (&d.pos, 3),
        (&d.quat, 4),
        (&d.vel, 3),
        (&d.ang_vel, 3),
        (&d.rotor_vel, d.n_rotors),
        (&d.thrust, 1),
        (&d.rotor_command, d.n_rotors),
        (&d.attitude_command, 4),
        (&d.controller_memory, d.controller_memory.len() / (d.n_worlds * d.n_drones)),
    ] {
        let row = width * d.n_drones;
        out.extend(array[worlds.start * row..worlds.end * row].iter().map(|v| v.wide().to_bits()));
    }
    out
}

#[test]
fn worlds_of_one_block_may_be_at_different_steps() {
    let options = busy(21, 0);
    let odd = |w: usize| w % 3 == 1;
    let reference = flown::<f64>(&SimOptions { engine: Engine::Reference, ..options.clone() }, odd);
    let wide = flown::<f64>(&options, odd);
    let narrow = flown::<f32>(&options, odd);
    assert_eq!((&reference.data.steps, &reference.data.episodes), (&wide.data.steps, &wide.data.episodes));
    assert_eq!(reference.data.steps[..3], [41, 34, 41]);
    let (m, rad) = apart(&reference, &wide);
    assert!(m < 1e-10 && rad < 1e-10, "{m} {rad}");
    let (m, rad) = apart(&reference, &narrow);
    assert!(m < 1e-4 && rad < 1e-4, "{m} {rad}");
    for (a, b) in reference.data.controller_memory.iter().zip(&wide.data.controller_memory) {
        assert!((a - b).abs() <= 1e-9 * (1.0 + a.abs()), "{a} {b}");
    }
}

fn same_bits<N: Number>() {
    let odd = |w: usize| w % 3 == 1;
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let sim = flown::<N>(&busy(300, 0), odd);
            bits(&sim, 0..300)
        })
    };
    let one = run(1);
    for threads in [2, 3, 8] {
        assert!(one == run(threads), "{threads} threads, {}", N::NAME);
    }
    let all = flown::<N>(&busy(300, 0), odd);
    for world in [0, 1, 17, 150, 299] {
        let alone = flown::<N>(&busy(1, world), odd);
        assert!(bits(&all, world..world + 1) == bits(&alone, 0..1), "world {world} alone, {}", N::NAME);
    }
}

#[test]
fn the_same_bits_for_any_number_of_threads_and_worlds() {
    same_bits::<f32>();
    same_bits::<f64>();
}

#[test]
fn kernels_give_the_same_bits_alone_and_among_many() {
    for control in [ControlMode::RotorVel, ControlMode::Attitude, ControlMode::State] {
        let run = |n_worlds: usize, first_world: u64| {
            let randomization = busy(1, 0).randomization;
            let options =
                SimOptions { n_worlds, first_world, control, randomization, ..SimOptions::default() };
            let mut sim = Sim::<f32>::storing(options, vec![quad()]).unwrap();
            let one = command(&quad().0, control, &mut draws(5));
            sim.set_command(&one.repeat(n_worlds)).unwrap();
            sim.step(60).unwrap();
            sim
        };
        let many = run(1000, 0);
        for world in [0, 15, 16, 33, 999] {
            let alone = run(1, world as u64);
            assert!(bits(&many, world..world + 1) == bits(&alone, 0..1), "{control:?}: world {world}");
        }
    }
}

#[test]
fn a_broken_world_is_set_aside_where_the_equations_set_it_aside_and_harms_no_other() {
    let fly = |engine: Engine, broken: bool| {
        let options =
            SimOptions { n_worlds: 40, engine, control: ControlMode::Attitude, ..SimOptions::default() };
        let mut sim = sim::<f64>(&options, &[quad(), quad()]);
        if broken {
            let row = sim.data.row(11, 1);
            // Grows without bound until it overflows, after some steps.
            sim.data.disturbance_torque[3 * row] = 1e120;
        }
        sim.step(50).unwrap();
        sim
    };
    let (reference, lanes, well) =
        (fly(Engine::Reference, true), fly(Engine::Lanes, true), fly(Engine::Lanes, false));
    let fault = lanes.data.quarantine[11].clone().unwrap();
    assert_eq!(reference.data.quarantine[11].as_ref().unwrap(), &fault);
    assert!(fault.step > 0, "{fault:?}");
    assert_eq!(reference.data.steps, lanes.data.steps);
    assert!(lanes.data.pos.iter().all(|v| v.is_finite()));
    assert_eq!(lanes.data.quarantine.iter().filter(|q| q.is_some()).count(), 1);
    assert!(bits(&lanes, 0..11) == bits(&well, 0..11), "worlds before");
    assert!(bits(&lanes, 12..40) == bits(&well, 12..40), "worlds behind");
    let mut on = lanes;
    on.step(5).unwrap();
    assert_eq!(on.data.steps[11], fault.step);
}

#[test]
fn stages_of_users_run_between_lanes() {
    let run = |engine: Engine| {
        let options =
            SimOptions { n_worlds: 5, engine, control: ControlMode::Attitude, ..SimOptions::default() };
        let mut sim = sim::<f64>(&options, &[quad()]);
        let slower: propwash::rollout::pipeline::StageFn =
            Box::new(|data| data.rotor_command.iter_mut().for_each(|v| *v *= 0.9));
        sim.pipeline.insert_after(CONTROLLERS, "slower", slower).unwrap();
        sim.step(60).unwrap();
        sim
    };
    let (m, rad) = apart(&run(Engine::Reference), &run(Engine::Lanes));
    assert!(m < 1e-10 && rad < 1e-10, "{m} {rad}");
    let plain = sim::<f64>(
        &SimOptions { n_worlds: 5, control: ControlMode::Attitude, ..SimOptions::default() },
        &[quad()],
    );
    assert!(apart(&run(Engine::Lanes), &plain).0 > 0.01);
}

#[test]
fn parameters_set_for_one_world_reach_its_lane() {
    let options = SimOptions { n_worlds: 20, control: ControlMode::Attitude, ..SimOptions::default() };
    let run = |engine: Engine| {
        let mut sim = sim::<f64>(&SimOptions { engine, ..options.clone() }, &[quad()]);
        sim.step(10).unwrap();
        sim.set_parameter(Some(13), 0, "body.mass_kg", 0.05).unwrap();
        sim.step(40).unwrap();
        sim.set_parameter(None, 0, "body.gravity_m_s2.0", 0.5).unwrap();
        sim.step(40).unwrap();
        sim
    };
    let (m, rad) = apart(&run(Engine::Reference), &run(Engine::Lanes));
    assert!(m < 1e-10 && rad < 1e-10, "{m} {rad}");
}
