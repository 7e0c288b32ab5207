//! Flying, seeing and touching as one thing: every effect flies alike by every door, gets the ground and the ceiling that it reads, and
//! saved worlds go on bit for bit.

use propwash::arena::{Arena, ArenaError, CameraConfig, DroneConfig, FlightPattern, SceneConfig, SimConfig};
use propwash::dataset::Dataset;
use propwash::dataset::recorder::{FlightConfig, record};
use propwash::env::{Env, EnvConfig};
use propwash::physics::controllers::ControlMode;
use propwash::physics::effects::{AnyEffect, KINDS};
use propwash::physics::rigid_body::State;
use propwash::rollout::randomize::{Draw, Randomization, Rule};
use propwash::rollout::trajectory::Trajectory;
use propwash::rollout::{Engine, Sim, SimData, SimOptions};
use propwash::scalar::lanes::Number;
use propwash::scene::{Pose, Scene, SceneSource, Shell, WorkerPool};
use propwash::sense::{Camera, DepthPlanes};
use propwash::vehicle::Vehicle;
use std::sync::Arc;

#[path = "common/effects.rs"]
mod effects;

use effects::{entry, vehicle};

/// What flies beside the effect of interest, so that winds act on a vehicle that hovers.
fn beside(kind: &str) -> String {
    let drag = "kind = \"linear_drag\"\ndrag_n_s_per_m = [[0.015, 0, 0], [0, 0.015, 0], [0, 0, 0.015]]";
    let wind = "kind = \"constant_wind\"\nvelocity_m_s = [3.0, 1.0, 0.5]";
    let others = [("linear_drag", drag), ("constant_wind", wind)];
    others.iter().filter(|(k, _)| *k != kind).map(|(_, text)| format!("[[effect]]\n{text}\n")).collect()
}

/// Whether an effect changes how a vehicle moves, and not only what sensors make of it.
fn moves(kind: &str) -> bool {
    let sensors =
        ["sensor_offset", "mount", "world_tilt", "gyro_scale", "gyro_bias", "accel_bias", "clock_offset"];
    !sensors.contains(&kind)
}

/// A slab to fly over and one to fly under, as an MJCF.
fn slabs(ground_z: f64, ceiling_z: f64) -> String {
    format!(
        "<mujoco><worldbody><geom type=\"box\" size=\"20 20 0.5\" pos=\"0 0 {}\"/>\
         <geom type=\"box\" size=\"20 20 0.5\" pos=\"0 0 {}\"/></worldbody></mujoco>",
        ground_z - 0.5,
        ceiling_z + 0.5
    )
}

/// Heights of ground and ceiling around one drone that hovers at 1 m, and around two that fly.
fn heights(n_drones: usize) -> (f64, f64) {
    if n_drones == 1 { (0.93, 1.07) } else { (0.0, 2.5) }
}

fn scene(xml: &str, vehicles: &[Vehicle]) -> Scene {
    let shells: Vec<Shell> = vehicles.iter().map(|v| Shell::builtin(&v.shell).unwrap()).collect();
    Scene::build(&SceneSource::text("slabs", xml), &shells).unwrap()
}

/// Numbers that say how a drone moves.
fn motion(s: &State<f64>) -> Vec<f64> {
    [&s.pos[..], &s.quat, &s.vel, &s.ang_vel].concat()
}

/// Greatest difference of two lists.
fn apart(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// What everything is compared with: the equations in f64 without an arena, told the heights by hand.
struct Reference {
    options: SimOptions,
    starts: Vec<State<f64>>,
    /// What is in force in each step, (step, drone, command).
    commands: Vec<Vec<f64>>,
    /// Whether random numbers are those of a first episode, or of a second.
    first_episode: bool,
    heights: (f64, f64),
}

impl Reference {
    fn end(&self, effects: &str) -> Vec<f64> {
        let v = vehicle(effects);
        let drone = v.drone("first_principles").unwrap();
        let n = self.starts.len();
        let mut sim = Sim::<f64>::new(self.options.clone(), vec![(drone, v.rates); n]).unwrap();
        for (d, start) in self.starts.iter().enumerate() {
            sim.set_initial(0, d, State { rotor_vel: [0.0; 8], thrust: 0.0, ..*start }).unwrap();
        }
        if self.first_episode {
            sim.reseed(self.options.seed);
        }
        sim.reset(None).unwrap();
        sim.data.ground_z.fill(self.heights.0);
        sim.data.ceiling_z.fill(self.heights.1);
        for command in &self.commands {
            sim.set_command(command).unwrap();
            sim.step(1).unwrap();
        }
        assert!(sim.data.quarantine[0].is_none());
        (0..n).flat_map(|d| motion(&sim.data.state(0, d))).collect()
    }
}

const SEED: u64 = 7;
/// Steps of 2 ms that are flown.
const STEPS: usize = 100;

fn options() -> SimOptions {
    SimOptions { control: ControlMode::State, engine: Engine::Reference, seed: SEED, ..SimOptions::default() }
}

/// Flies a data set of one world with `effects`: motion at the end, and what it is compared with.
fn by_fly(effects: &str, n_drones: usize, xml: &str, heights: (f64, f64)) -> (Vec<f64>, Reference) {
    let vehicles = vec![vehicle(effects); n_drones];
    let flight = FlightConfig {
        sim: SimConfig {
            options: SimOptions { seed: SEED, ..SimOptions::default() },
            n_drones: Some(n_drones),
            drones: vec![DroneConfig::from(&vehicles[0])],
            scene: Some(SceneConfig::Xml(xml.into())),
            pattern: Some(if n_drones == 1 { FlightPattern::Hover } else { FlightPattern::Lissajous }),
            camera: Some(CameraConfig {
                width: Some(4),
                height: Some(3),
                range_m: Some([0.1, 10.0]),
                ..CameraConfig::default()
            }),
            ..SimConfig::default()
        },
        seconds: STEPS as f64 / 500.0,
        fps: 1,
        log_hz: 500,
        normals: false,
        clearance_max_m: 0.5,
        by_user: false,
    };
    let flight = flight.load().unwrap();
    let dir = tempfile::tempdir().unwrap();
    record(&flight, &dir.path().join("out"), &|_, _| {}).unwrap();
    let data = Dataset::open(&dir.path().join("out")).unwrap();
    let states = data.world(0).unwrap().states(None).unwrap();
    let at = |step: usize, drone: usize, names: &[&str]| -> Vec<f64> {
        names.iter().map(|name| states.column(name).unwrap()[step * n_drones + drone]).collect()
    };
    let names = ["px", "py", "pz", "qx", "qy", "qz", "qw", "vx", "vy", "vz", "wx", "wy", "wz"];
    let command: Vec<String> = ["x", "y", "z", "vx", "vy", "vz", "ax", "ay", "az", "qx", "qy", "qz", "qw"]
        .iter()
        .chain(&["wx", "wy", "wz"])
        .map(|name| format!("cmd_{name}"))
        .collect();
    let command: Vec<&str> = command.iter().map(String::as_str).collect();
    let start = |d: usize| {
        let v = at(0, d, &names);
        State { pos: [v[0], v[1], v[2]], quat: [v[3], v[4], v[5], v[6]], ..State::rest() }
    };
    let reference = Reference {
        options: options(),
        starts: (0..n_drones).map(start).collect(),
        commands: (0..STEPS).map(|k| (0..n_drones).flat_map(|d| at(k, d, &command)).collect()).collect(),
        first_episode: false,
        heights,
    };
    ((0..n_drones).flat_map(|d| at(STEPS, d, &names)).collect(), reference)
}

/// Flies a learning environment of one world with `effects`.
fn by_env(effects: &str, n_drones: usize, scene: Option<&str>, heights: (f64, f64)) -> (Vec<f64>, Reference) {
    let task = match n_drones {
        1 => {
            serde_json::json!({ "kind": "landing", "start_m": [[0, 0, 1], [0, 0, 1]], "start_speed_m_s": 0.0 })
        }
        _ => {
            serde_json::json!({ "kind": "swarm_cross", "radius_m": 0.2, "start_off_m": 0.05, "free_m": 0.05, "arrive_m": 0.01,
                                 "height_m": [0.8, 1.6] })
        }
    };
    let config = serde_json::json!({
        "task": task, "n_drones": n_drones, "action": { "kind": "velocity" }, "seed": SEED, "with_camera": false,
        "autoreset": "disabled", "scene": scene.map_or(serde_json::json!("none"), |xml| serde_json::json!({ "xml": xml })),
    });
    let mut config = EnvConfig::from_text(&config.to_string()).unwrap();
    config.sim.drones = vec![DroneConfig::from(&vehicle(effects))];
    let mut env = Env::new(config).unwrap();
    env.reset(Some(SEED), None).unwrap();
    let starts = (0..n_drones).map(|d| env.flight().data.state(0, d)).collect();
    let mut commands = Vec::new();
    for k in 0..STEPS / 10 {
        let action: Vec<f32> =
            [0.2, -0.1, 0.0, 0.1].repeat(n_drones).iter().map(|v| v * (k % 3) as f32).collect();
        env.step(&action).unwrap();
        assert_eq!(env.ending(), [0], "step {k} ends the episode of a vehicle with\n{effects}");
        let flown: Vec<f64> = env.flight().data.command.iter().map(|v| f64::from(*v)).collect();
        commands.extend(std::iter::repeat_n(flown, 10));
    }
    let end = (0..n_drones).flat_map(|d| motion(&env.flight().data.state(0, d))).collect();
    (end, Reference { options: options(), starts, commands, first_episode: true, heights })
}

/// Flies an arena in lanes of f32 and in f64 from where a reference starts, by its commands.
fn by_arena<N: Number>(effects: &str, engine: Engine, like: &Reference, xml: &str) -> Vec<f64> {
    let v = vehicle(effects);
    let n = like.starts.len();
    let options = SimOptions { engine, ..like.options.clone() };
    let drone = v.drone("first_principles").unwrap();
    let sim = Sim::<N>::storing(options, vec![(drone, v.rates); n]).unwrap();
    let mut arena = Arena::within(sim, &[scene(xml, &vec![v; n])], &[0]).unwrap();
    for (d, start) in like.starts.iter().enumerate() {
        arena.set_initial(0, d, State { rotor_vel: [0.0; 8], thrust: 0.0, ..*start }).unwrap();
    }
    if like.first_episode {
        arena.reseed(like.options.seed);
    }
    arena.reset(None).unwrap();
    for command in &like.commands {
        arena.set_command(command).unwrap();
        arena.step(1).unwrap();
    }
    (0..n).flat_map(|d| motion(&arena.sim().data.state(0, d))).collect()
}

/// How far lanes of f32 may be from f64 after 100 steps. States of about 1 and rates of some rad/s are rounded by 6e-8 to 2e-7 of
/// them in each step, which comes to at most 3e-5 with any of the effects; other instructions of processors may round otherwise.
const F32: f64 = 5e-5;

#[test]
fn every_effect_flies_alike_in_an_arena_a_data_set_and_an_environment() {
    for kind in KINDS {
        let n_drones = if *kind == "downwash" { 2 } else { 1 };
        let heights = heights(n_drones);
        let xml = slabs(heights.0, heights.1);
        let (with, without) = (format!("{}{}", beside(kind), entry(kind)), beside(kind));
        let (flown, reference) = by_fly(&with, n_drones, &xml, heights);
        let expected = reference.end(&with);
        // The heights of the slabs are measured with some rounding, all else is the same arithmetic.
        let off = apart(&flown, &expected);
        assert!(off < 1e-11, "{kind}: a data set flies otherwise, by {off:e}");
        let matters = apart(&expected, &reference.end(&without));
        assert_eq!(matters > 5.0 * F32, moves(kind), "{kind} moves the vehicle by {matters:e}");
        let off = apart(&by_arena::<f64>(&with, Engine::Reference, &reference, &xml), &expected);
        assert!(off < 1e-11, "{kind}: an arena of f64 flies otherwise, by {off:e}");
        let off = apart(&by_arena::<f32>(&with, Engine::Lanes, &reference, &xml), &expected);
        assert!(off < F32, "{kind}: an arena in lanes flies otherwise, by {off:e}");

        let (flown, reference) = by_env(&with, n_drones, Some(&xml), heights);
        let expected = reference.end(&with);
        let off = apart(&flown, &expected);
        assert!(off < F32, "{kind}: an environment flies otherwise, by {off:e}");
        let matters = apart(&expected, &reference.end(&without));
        assert_eq!(
            matters > 5.0 * F32,
            moves(kind),
            "{kind} moves the vehicle in an environment by {matters:e}"
        );
    }
}

#[test]
fn the_ground_of_an_environment_without_a_scene_is_at_zero_for_effects_too() {
    // Two hundred times that of a single rotor, so that it is felt at 1 m.
    let strong = "[[effect]]\nkind = \"ground_effect\"\nstrength = 200.0\n";
    let (flown, reference) = by_env(strong, 1, None, (0.0, f64::INFINITY));
    let off = apart(&flown, &reference.end(strong));
    assert!(off < F32, "an environment without a scene flies otherwise, by {off:e}");
    let matters = apart(&flown, &reference.end(""));
    assert!(matters > 5.0 * F32, "the ground lifts by {matters:e}");
}

/// A table over one half of the ground, that is at −5 m.
const TABLE: &str = "<mujoco><worldbody><geom type=\"plane\" size=\"0 0 1\" pos=\"0 0 -5\"/>\
    <geom type=\"box\" size=\"5 5 0.25\" pos=\"-5 0 -0.25\"/></worldbody></mujoco>";

#[test]
fn an_environment_in_a_scene_feels_the_ground_below_each_drone_in_every_step() {
    let config = |scene: serde_json::Value| {
        let landing = serde_json::json!({ "kind": "landing", "start_m": [[-0.1, -0.1, 0.06], [0.1, 0.1, 0.09]],
                                          "start_speed_m_s": 0.4, "goal_m": [0, 0, 0.05] });
        let config = serde_json::json!({ "task": landing, "n_worlds": 24, "seed": SEED, "scene": scene });
        EnvConfig::from_text(&config.to_string()).unwrap()
    };
    let strong = vehicle("[[effect]]\nkind = \"ground_effect\"\nstrength = 5.0\n");
    let fly = |scene: serde_json::Value, vehicle: &Vehicle| {
        let mut config = config(scene);
        config.sim.drones = vec![DroneConfig::from(vehicle)];
        let mut env = Env::new(config).unwrap();
        env.reset(Some(SEED), None).unwrap();
        let starts: Vec<_> = (0..24).map(|w| env.flight().data.state(w, 0)).collect();
        for _ in 0..6 {
            env.step(&[0.0; 24 * 4]).unwrap();
        }
        (
            starts,
            (0..24).map(|w| env.flight().data.state(w, 0)).collect::<Vec<_>>(),
            env.flight().data.command.clone(),
        )
    };
    let table = serde_json::json!({ "xml": TABLE });
    let (starts, ends, command) = fly(table.clone(), &strong);
    let (_, plain, _) = fly(table, &vehicle(""));
    // The same by hand, with the height written before every step.
    let drone = strong.drone("first_principles").unwrap();
    let by_hand = SimOptions {
        n_worlds: 24,
        control: ControlMode::Attitude,
        engine: Engine::Lanes,
        seed: SEED,
        ..SimOptions::default()
    };
    let mut sim = Sim::<f32>::storing(by_hand, vec![(drone, strong.rates)]).unwrap();
    for (w, start) in starts.iter().enumerate() {
        sim.set_initial(w, 0, State { rotor_vel: [0.0; 8], ..*start }).unwrap();
    }
    sim.reset(None).unwrap();
    sim.data.command.copy_from_slice(&command);
    for _ in 0..60 {
        for w in 0..24 {
            sim.data.ground_z[w] = if sim.data.pos[3 * w] < 0.0 { 0.0 } else { -5.0 };
        }
        sim.step(1).unwrap();
    }
    let (mut crossed, mut lifted) = (0, 0);
    for w in 0..24 {
        let off = apart(&motion(&ends[w]), &motion(&sim.data.state(w, 0)));
        assert!(off < F32, "world {w} flies otherwise, by {off:e}");
        crossed += usize::from((starts[w].pos[0] < 0.0) != (ends[w].pos[0] < 0.0));
        let by = ends[w].vel[2] - plain[w].vel[2];
        let (before, after) = (starts[w].pos[0] < 0.0, ends[w].pos[0] < 0.0);
        assert!(
            before != after || (by > 0.005) == before,
            "world {w} from {:?}: lifted by {by}",
            starts[w].pos
        );
        lifted += usize::from(by > 0.005);
    }
    assert!(crossed > 0 && lifted > 5 && lifted < 20, "{crossed} crossed the edge, {lifted} were lifted");
    // Without a scene the ground is at zero everywhere.
    let (_, over, _) = fly(serde_json::json!("none"), &strong);
    let (_, free, _) = fly(serde_json::json!("none"), &vehicle(""));
    assert!((0..24).all(|w| over[w].vel[2] > free[w].vel[2] + 0.005));
}

#[test]
fn a_data_set_tells_expressions_where_the_ground_and_the_ceiling_are() {
    let heights = (0.5, 1.25);
    let xml = slabs(heights.0, heights.1);
    let force = |text: &str| {
        format!(
            "[[effect]]\nkind = \"expression\"\nname = \"near\"\nforce_world_n = [\"0\", \"0\", \"{text}\"]\n"
        )
    };
    let (told, _) = by_fly(&force("0.02 / ground_m + 0.01 / ceiling_m"), 1, &xml, heights);
    let (known, _) = by_fly(&force("0.02 / (z - 0.5) + 0.01 / (1.25 - z)"), 1, &xml, heights);
    let (none, _) = by_fly("", 1, &xml, heights);
    assert!(apart(&told, &known) < 1e-9, "{told:?}, not {known:?}");
    assert!(apart(&told, &none) > 0.01);
}

#[test]
fn what_stands_below_and_above_is_found_whatever_it_is_and_moves() {
    let xml = "<mujoco><worldbody><geom type=\"plane\" size=\"1 1 1\"/>\
        <geom type=\"plane\" size=\"1 1 1\" pos=\"0 0 8\" euler=\"180 0 0\"/>\
        <geom type=\"sphere\" size=\"0.5\" pos=\"3 0 4\"/>\
        <geom type=\"box\" size=\"1 1 1\" pos=\"6 0 3\" contype=\"0\" conaffinity=\"0\"/>\
        <body name=\"shelf\" mocap=\"true\" pos=\"9 0 2\"><geom type=\"box\" size=\"1 1 0.1\"/></body></worldbody></mujoco>";
    let v = vehicle(&format!("{}{}", entry("ground_effect"), entry("ceiling_effect")));
    let drone = v.drone("first_principles").unwrap();
    let options = SimOptions { n_worlds: 4, ..SimOptions::default() };
    let sim = Sim::<f64>::new(options, vec![(drone, v.rates)]).unwrap();
    let mut arena = Arena::within(sim, &[scene(xml, std::slice::from_ref(&v))], &[0; 4]).unwrap();
    for (w, x) in [0.0, 3.0, 6.0, 9.0].into_iter().enumerate() {
        arena.set_initial(w, 0, State { pos: [x, 0.0, 5.0], ..State::rest() }).unwrap();
    }
    arena.reset(None).unwrap();
    arena.measure().unwrap();
    let near = |found: &[f64], expected: [f64; 4]| {
        assert!(apart(found, &expected[..found.len()]) < 1e-9, "{found:?}, not {expected:?}");
    };
    near(&arena.sim().data.ground_z, [0.0, 4.5, 0.0, 2.1]);
    near(&arena.sim().data.ceiling_z, [8.0; 4]);
    // The shelf goes up, over the last drone.
    arena.obstacle_pos_mut()[3 * 3 + 2] = 6.0;
    arena.measure().unwrap();
    near(&arena.sim().data.ground_z, [0.0, 4.5, 0.0, 0.0]);
    near(&arena.sim().data.ceiling_z, [8.0, 8.0, 8.0, 5.9]);
    // Below the sphere.
    arena.data_mut().pos[3 + 2] = 1.0;
    arena.step(1).unwrap();
    near(&arena.sim().data.ceiling_z, [8.0, 3.5, 8.0, 5.9]);
    // A world with a number that is none is set aside and harms no other.
    arena.data_mut().pos[2 * 3] = f64::NAN;
    arena.step(1).unwrap();
    assert!(arena.sim().data.quarantine.iter().map(Option::is_some).eq([false, false, true, false]));
    near(&arena.sim().data.ground_z[..2], [0.0, 0.0, 0.0, 0.0]);
}

/// An arena of three worlds with two drones each, masses drawn anew, in slabs.
fn worlds<N: Number>(
    effects: &str,
    control: ControlMode,
    engine: Engine,
    pool: &Arc<WorkerPool>,
) -> Arena<N> {
    let v = vehicle(effects);
    let rule = Rule { parameter: "body.mass_kg".into(), draw: Draw::Scale([0.95, 1.05]), shared: false };
    let options = SimOptions {
        n_worlds: 3,
        control,
        engine,
        seed: SEED,
        randomization: Randomization { rules: vec![rule] },
        ..SimOptions::default()
    };
    let drone = v.drone("first_principles").unwrap();
    let command: Vec<f64> = match control {
        ControlMode::State => Trajectory::Hover { at_m: [0.1, 0.0, 1.0] }.at(0.0).command().to_vec(),
        ControlMode::ForceTorque => vec![drone.hover_thrust(), 0.0, 1e-6, 0.0],
        ControlMode::RotorVel => drone.hover_rotor_vel()[..4].to_vec(),
        _ => vec![0.05, -0.02, 0.1, drone.hover_thrust()],
    };
    let sim = Sim::<N>::storing(options, vec![(drone, v.rates); 2]).unwrap();
    let mut arena = Arena::sharing(sim, std::slice::from_ref(pool), &[0; 3]).unwrap();
    for w in 0..3 {
        for d in 0..2 {
            let pos = [0.3 * d as f64, 0.1 * w as f64, 1.0 + 0.3 * d as f64];
            arena.set_initial(w, d, State { pos, ..State::rest() }).unwrap();
        }
    }
    arena.reset(None).unwrap();
    arena.set_command(&command.repeat(6)).unwrap();
    arena
}

/// Saves in flight, flies on, goes back, flies on again; in this arena and in a new one.
fn goes_on<N: Number>(kind: &str, control: ControlMode, engine: Engine, pool: &Arc<WorkerPool>) {
    let effects = format!("{}{}", beside(kind), entry(kind));
    let mut arena = worlds::<N>(&effects, control, engine, pool);
    let place = arena.sim().data.pos.as_ptr();
    arena.step(7).unwrap();
    let saved = arena.save();
    let fly = |arena: &mut Arena<N>| -> SimData<N> {
        arena.step(5).unwrap();
        arena.data_mut().wind.iter_mut().for_each(|v| *v = N::of(0.5));
        arena.data_mut().disturbance_force[4] = N::of(0.003);
        arena.reset(Some(&[false, true, false])).unwrap();
        arena.step(8).unwrap();
        arena.sim().data.clone()
    };
    let first = fly(&mut arena);
    arena.set_parameter(Some(1), 0, "body.mass_kg", 0.04).unwrap();
    arena.obstacle_pos_mut().fill(3.0);
    arena.restore(&saved).unwrap();
    let who = format!("{kind}, {}, {engine:?}", control.name());
    assert!(fly(&mut arena) == first, "{who}: it goes on otherwise");
    assert_eq!(arena.sim().data.pos.as_ptr(), place, "arrays stay where they are");
    let mut other = worlds::<N>(&effects, control, engine, pool);
    other.step(3).unwrap();
    other.restore(&saved).unwrap();
    assert!(fly(&mut other) == first, "{who}: another arena goes on otherwise");
    // One world in all: the same motion, where no effect draws random numbers.
    arena.restore(&saved).unwrap();
    arena.fork(1).unwrap();
    arena.step(20).unwrap();
    let (data, each) = (&arena.sim().data, 6);
    let same = data.pos.chunks(each).all(|world| world == &data.pos[each..2 * each]);
    assert_eq!(same, !arena.reads().noise, "{who}: forked worlds");
    assert!(data.steps.iter().all(|s| *s == 27));
}

#[test]
fn saved_worlds_go_on_bit_for_bit_for_every_effect_and_control_mode() {
    let modes = [
        ControlMode::State,
        ControlMode::Attitude,
        ControlMode::BodyRate,
        ControlMode::ForceTorque,
        ControlMode::RotorVel,
    ];
    let xml = slabs(0.5, 2.0)
        .replace("</worldbody>", "<body mocap=\"true\"><geom size=\"0.1\"/></body></worldbody>");
    let pool = Arc::new(WorkerPool::new(&scene(&xml, &vec![vehicle(""); 2])));
    for kind in KINDS {
        for mode in modes {
            goes_on::<f64>(kind, mode, Engine::Reference, &pool);
            goes_on::<f32>(kind, mode, Engine::Lanes, &pool);
        }
    }
}

#[test]
fn an_arena_gives_the_same_bits_for_any_threads_and_any_number_of_steps_at_once() {
    let fly = |threads: usize, at_once: usize| {
        let threads = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        threads.install(|| {
            let v = vehicle(&format!("{}{}", beside(""), entry("ground_effect")));
            let options = SimOptions {
                n_worlds: 100,
                control: ControlMode::Attitude,
                seed: SEED,
                ..SimOptions::default()
            };
            let drone = v.drone("first_principles").unwrap();
            let sim = Sim::<f32>::storing(options, vec![(drone.clone(), v.rates)]).unwrap();
            let mut arena = Arena::within(sim, &[scene(TABLE, &[v])], &[0; 100]).unwrap();
            for w in 0..100 {
                let pos = [0.01 * w as f64 - 0.5, 0.0, 0.07];
                arena.set_initial(w, 0, State { pos, vel: [0.5, 0.0, 0.0], ..State::rest() }).unwrap();
            }
            arena.reset(None).unwrap();
            arena.set_command(&[0.0, 0.0, 0.0, drone.hover_thrust()].repeat(100)).unwrap();
            for _ in 0..40 / at_once {
                arena.step(at_once).unwrap();
            }
            arena.sim().data.clone()
        })
    };
    let one = fly(1, 40);
    assert!(one == fly(4, 40) && one == fly(2, 1));
}

#[test]
fn an_arena_sees_and_touches_in_the_scene_of_each_world() {
    let wall = |x: f64| {
        format!(
            "<mujoco><worldbody><geom name=\"wall\" type=\"box\" size=\"0.01 5 5\" pos=\"{x} 0 0\"/></worldbody></mujoco>"
        )
    };
    let v = vehicle("");
    let scenes = [scene(&wall(1.0), std::slice::from_ref(&v)), scene(&wall(2.0), std::slice::from_ref(&v))];
    let sim = |n: usize| {
        let options = SimOptions { n_worlds: n, ..SimOptions::default() };
        Sim::<f32>::storing(options, vec![(v.drone("first_principles").unwrap(), v.rates)]).unwrap()
    };
    let mut arena = Arena::within(sim(3), &scenes, &[0, 1, 0]).unwrap();
    let cameras: Vec<Vec<Camera>> = scenes
        .iter()
        .map(|s| vec![Camera::on_drone(s, 0, "fpv").unwrap().with_size(3, 3).unwrap()])
        .collect();
    let cameras: Vec<&[Camera]> = cameras.iter().map(Vec::as_slice).collect();
    let middle = |arena: &Arena<f32>, worlds: Option<&[usize]>, n: usize| -> Vec<f32> {
        let (mut depth, mut poses) = (vec![0.0; n * 9], vec![Pose::default(); n]);
        let planes = DepthPlanes { depth_m: Some(&mut depth), ..DepthPlanes::default() };
        arena.render(&cameras, worlds, planes, &mut poses).unwrap();
        (0..n).map(|w| depth[w * 9 + 4] + poses[w].pos_m[0] as f32).collect()
    };
    let close =
        |a: &[f32], b: &[f32]| a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5);
    assert!(close(&middle(&arena, None, 3), &[0.99, 1.99, 0.99]));
    assert!(close(&middle(&arena, Some(&[1, 2]), 2), &[1.99, 0.99]));
    let mut clear = Vec::new();
    arena.clearances(None, 5.0, &mut clear).unwrap();
    assert!(clear[1].distance_m - clear[0].distance_m > 0.99 && clear[0] == clear[2]);
    // Through the wall of the first scene, in one step.
    let before = arena.poses();
    for w in 0..3 {
        arena.data_mut().pos[3 * w] = 1.5;
    }
    let met = arena.swept(&before, None).unwrap();
    assert_eq!(met.iter().map(|way| (way.world, way.drone)).collect::<Vec<_>>(), [(0, 0), (2, 0)]);
    assert!((met[0].hit.point_m[0] - 0.99).abs() < 1e-4);
    arena.set_layout(&[1, 0, 1]).unwrap();
    assert_eq!(arena.swept(&before, None).unwrap()[0].world, 1);
    let (mut contacts, mut limited) = (Vec::new(), Vec::new());
    arena.data_mut().pos[3] = 1.0;
    arena.contacts(None, &mut contacts, &mut limited).unwrap();
    assert!(contacts[0].is_empty() && contacts[1].iter().any(|c| c.touches()) && contacts[2].is_empty());

    let words = |e: ArenaError| e.to_string();
    let unfit = words(Arena::within(sim(1), &[scene(TABLE, &[v.clone(), v.clone()])], &[0]).unwrap_err());
    assert!(unfit.contains("1 drones") && unfit.contains("2 drones in scene 0"), "{unfit}");
    assert!(words(Arena::within(sim(2), &scenes, &[0, 2]).unwrap_err()).contains("numbers below 2"));
    assert!(words(arena.contacts(Some(&[3]), &mut contacts, &mut limited).unwrap_err()).contains("got 3"));
    let mut open = Arena::open(sim(1), None);
    assert!(words(open.measure_ground(None).unwrap_err()).contains("needs a scene"));
    assert!(words(open.restore(&arena.save()).unwrap_err()).contains("saved state"));
    let other = Sim::<f32>::storing(
        SimOptions::default(),
        vec![(vehicle(&entry("payload")).drone("first_principles").unwrap(), v.rates)],
    );
    let refused = words(open.restore(&Arena::open(other.unwrap(), None).save()).unwrap_err());
    assert!(refused.contains("payload"), "{refused}");
    assert!(words(open.fork(1).unwrap_err()).contains("less than 1"));
}

/// Every effect of the list has its entry here, so that a new one is flown too.
#[test]
fn entries_are_of_their_kinds() {
    for kind in KINDS {
        let effects = vehicle(&entry(kind)).drone("first_principles").unwrap().effects;
        assert_eq!(effects.iter().map(AnyEffect::kind).collect::<Vec<_>>(), [*kind]);
    }
}

#[test]
fn gravity_and_wind_of_a_scene_hold_in_its_worlds() {
    let floor = "<worldbody><geom type='plane' size='5 5 1'/></worldbody>";
    let moon = format!("<mujoco><option gravity='0 0 -1.62' wind='3 0 0'/>{floor}</mujoco>");
    let earth = format!("<mujoco>{floor}</mujoco>");
    let v = vehicle("");
    let scenes = [scene(&moon, std::slice::from_ref(&v)), scene(&earth, std::slice::from_ref(&v))];
    let options = SimOptions { n_worlds: 2, control: ControlMode::ForceTorque, ..SimOptions::default() };
    let drone_of = |v: &Vehicle| v.drone("first_principles").unwrap();
    let sim = Sim::<f64>::new(options, vec![(drone_of(&v), v.rates)]).unwrap();
    let mut arena = Arena::within(sim, &scenes, &[0, 1]).unwrap();
    let fall = |arena: &mut Arena<f64>| {
        for w in 0..2 {
            arena.set_initial(w, 0, State { pos: [0.0, 0.0, 3.0], ..State::rest() }).unwrap();
        }
        arena.reset(None).unwrap();
        // Without the thrust that carries the weight, whatever the gravity is.
        arena.data_mut().rotor_vel.fill(0.0);
        let data = &arena.sim().data;
        let accelerations = [0, 1].map(|w| arena.sim().rate(w, 0).acc[2]);
        (accelerations, [data.wind[0], data.wind[3]])
    };
    let own = v.drone("first_principles").unwrap().body.gravity_m_s2[2];
    let (acc, wind) = fall(&mut arena);
    assert!((acc[0] + 1.62).abs() < 0.05 && (acc[1] - own).abs() < 0.05, "{acc:?}");
    assert_eq!(wind, [3.0, 0.0]);
    // They go with the scene.
    arena.set_layout(&[1, 0]).unwrap();
    let (acc, wind) = fall(&mut arena);
    assert!((acc[1] + 1.62).abs() < 0.05 && (acc[0] - own).abs() < 0.05, "{acc:?}");
    assert_eq!(wind, [0.0, 3.0]);
    // A gravity that all scenes state needs no vehicle for each world.
    let sim = Sim::<f64>::new(arena.sim().options().clone(), vec![(drone_of(&v), v.rates)]).unwrap();
    let moons = [scenes[0].clone(), scenes[0].clone()];
    let shared = Arena::within(sim, &moons, &[0, 1]).unwrap();
    assert!(std::ptr::eq(shared.sim().drone(0, 0), shared.sim().drone(1, 0)));
    assert_eq!(shared.sim().drone(1, 0).body.gravity_m_s2, [0.0, 0.0, -1.62]);
    // What does not count is said.
    let wet = format!("<mujoco><option density='1000' viscosity='0.001'/>{floor}</mujoco>");
    let warnings = scene(&wet, &[]).warnings().join("; ");
    assert!(warnings.contains("density of the air of 1000") && warnings.contains("viscosity"), "{warnings}");
}

#[test]
fn a_world_whose_drone_stands_nowhere_is_marked_and_the_others_are_seen() {
    let v = vehicle("");
    let floor = scene(
        "<mujoco><worldbody><geom type='plane' size='5 5 1'/></worldbody></mujoco>",
        std::slice::from_ref(&v),
    );
    let options = SimOptions { n_worlds: 4, ..SimOptions::default() };
    let sim = Sim::<f64>::new(options, vec![(v.drone("first_principles").unwrap(), v.rates)]).unwrap();
    let mut arena = Arena::within(sim, &[floor], &[0; 4]).unwrap();
    arena.data_mut().pos[2] = 1.0;
    arena.data_mut().pos[3] = f64::NAN;
    arena.data_mut().pos[6] = 2e9;
    arena.data_mut().quat[12..16].fill(0.0);
    let mut out = Vec::new();
    // Unmarked worlds fail, and are named.
    let error = arena.clearances(None, 5.0, &mut out).unwrap_err().to_string();
    assert!(error.contains("3 of 4 worlds"), "{error}");
    assert_eq!(arena.set_aside_unplaceable(), 3);
    assert_eq!(arena.set_aside_unplaceable(), 0);
    let marks: Vec<_> = arena.sim().data.quarantine.iter().flatten().map(|q| q.quantity.as_str()).collect();
    assert_eq!(marks, ["position", "distance from the origin", "length of the attitude"]);
    arena.clearances(None, 5.0, &mut out).unwrap();
    assert!(
        (out[0].distance_m - 0.98).abs() < 0.05 && out[1..].iter().all(|c| c.distance_m.is_nan()),
        "{out:?}"
    );
    let (mut contacts, mut limited) = (Vec::new(), Vec::new());
    arena.contacts(None, &mut contacts, &mut limited).unwrap();
    assert!(contacts.iter().all(Vec::is_empty));
    arena.swept(&arena.poses(), None).unwrap();
    // A reset ends it.
    arena.reset(None).unwrap();
    assert!(arena.sim().data.quarantine.iter().all(Option::is_none));
}

/// In a scene the ground is measured before every step of a sequence too: a drone that flies over the edge of a table leaves its air cushion. Such
/// flights have no gradient, and say so; those of effects that read no ground have one.
#[test]
fn sequences_of_commands_measure_the_ground_before_every_step() {
    let at = |effects: &str| {
        let v = vehicle(effects);
        let drone = v.drone("first_principles").unwrap();
        let hover = drone.hover_command();
        let options = SimOptions {
            n_worlds: 2,
            control: ControlMode::Attitude,
            engine: Engine::Lanes,
            ..SimOptions::default()
        };
        let sim = Sim::<f64>::storing(options, vec![(drone, v.rates)]).unwrap();
        let mut arena = Arena::within(sim, &[scene(TABLE, &[v])], &[0, 0]).unwrap();
        for (w, x) in [(0, -0.1), (1, -3.0)] {
            let state = State { pos: [x, 0.0, 0.05], vel: [1.5, 0.0, 0.0], ..State::rest() };
            arena.set_initial(w, 0, state).unwrap();
        }
        arena.reset(None).unwrap();
        (arena, hover)
    };
    let strong = "[[effect]]\nkind = \"ground_effect\"\nstrength = 3.0\n";
    let (mut arena, hover) = at(strong);
    let commands: Vec<f64> = (0..2 * 5).flat_map(|k| [0.0, 0.01 * f64::from(k % 5), 0.0, hover]).collect();
    let start = arena.save();
    let states = arena.rollout(&commands, 20).unwrap();
    let (end, width) = (arena.sim().data.pos.clone(), states.len() / 10);
    arena.restore(&start).unwrap();
    for t in 0..5 {
        let now: Vec<f64> = (0..2).flat_map(|w| commands[4 * (5 * w + t)..][..4].to_vec()).collect();
        arena.set_command(&now).unwrap();
        arena.step(20).unwrap();
        for w in 0..2 {
            assert_eq!(states[(5 * w + t) * width..][..3], arena.sim().data.pos[3 * w..3 * w + 3], "{t} {w}");
        }
    }
    assert_eq!(end, arena.sim().data.pos);
    assert!(end[5] > end[2] + 0.001, "the table lifts the drone that stays over it: {end:?}");
    let refused = arena.record(&commands, 20).unwrap_err().to_string();
    assert!(refused.contains("the ground or the ceiling is measured in the scene"), "{refused}");
    let (mut arena, _) = at("");
    let mut tape = arena.record(&commands, 20).unwrap();
    let seeds = vec![1.0; tape.states().len()];
    assert!(tape.pull_back(&seeds, &[]).unwrap().commands.iter().any(|g| *g != 0.0));
}
