//! Obstacles that move by themselves: in an arena, in learning environments and in data sets.

use std::path::Path;
use std::process::Command;

use propwash::arena::{Arena, MotionKind, SimConfig};
use propwash::dataset::Dataset;
use propwash::dataset::recorder::FlightConfig;
use propwash::env::{Ending, Env, EnvConfig};
use propwash::math::vec3;

/// A ball between two walls, a post on an open floor, and a drone above it all.
const SCENE: &str = "<mujoco><worldbody>\
    <geom name='floor' type='plane' size='20 20 1'/>\
    <geom name='left' type='box' size='.05 .6 1' pos='-.5 0 1'/><geom name='right' type='box' size='.05 .6 1' pos='.5 0 1'/>\
    <geom name='near' type='box' size='.6 .05 1' pos='0 -.5 1'/><geom name='far' type='box' size='.6 .05 1' pos='0 .5 1'/>\
    <body name='ball' mocap='true' pos='0 0 1'><geom type='sphere' size='.1'/></body>\
    <body name='post' mocap='true' pos='8 0 .5' euler='0 0 30'><geom type='capsule' size='.1 .4'/></body>\
    </worldbody></mujoco>";

fn config(text: &str) -> SimConfig {
    let mut config = SimConfig::from_text(text).unwrap();
    config.scene = Some(propwash::arena::SceneConfig::Xml(SCENE.into()));
    config
}

fn positions(arena: &Arena<f64>, world: usize) -> Vec<[f64; 3]> {
    arena.look().obstacle_pos_m(world).to_vec()
}

#[test]
fn they_stay_within_reach_and_speed_and_turn_before_walls() {
    for (kind, name) in [(MotionKind::Line, "line"), (MotionKind::Circle, "circle")] {
        let motion = format!(
            "n_worlds = 8\nobstacle_motion = {{ kind = \"{name}\", speed_m_s = [0.5, 1.0], reach_m = [1.0, 1.5] }}"
        );
        let mut arena = Arena::<f64>::from_config(&config(&motion)).unwrap();
        assert_eq!(arena.obstacle_motion().unwrap().kind, kind);
        let dt = 1.0 / f64::from(arena.sim().options().sim_hz);
        let quats = arena.look().obstacle_quat(0).to_vec();
        let (mut fastest, mut furthest) = ([[0.0f64; 2]; 8], [[0.0f64; 2]; 8]);
        for _ in 0..2000 {
            let before: Vec<_> = (0..8).map(|w| positions(&arena, w)).collect();
            arena.step(5).unwrap();
            for (w, before) in before.iter().enumerate() {
                let now = positions(&arena, w);
                for (o, place) in [[0.0, 0.0, 1.0], [8.0, 0.0, 0.5]].into_iter().enumerate() {
                    assert_eq!(now[o][2], place[2]);
                    let speed = vec3::norm(vec3::sub(now[o], before[o])) / (5.0 * dt);
                    fastest[w][o] = fastest[w][o].max(speed);
                    furthest[w][o] = furthest[w][o].max(vec3::norm(vec3::sub(now[o], place)));
                }
            }
        }
        for w in 0..8 {
            // The walls leave 0.35 m about the ball in four directions, and up to √2 of it between them.
            let most = if kind == MotionKind::Circle { 0.35 } else { 0.35 * 2f64.sqrt() };
            assert!(furthest[w][0] > 0.1 && furthest[w][0] < most, "{name} world {w}: {:?}", furthest[w]);
            assert!(furthest[w][1] > 0.9 && furthest[w][1] <= 1.5, "{name} world {w}: {:?}", furthest[w]);
            for speed in fastest[w] {
                assert!(speed > 0.49 && speed <= 1.0 + 1e-9, "{name} world {w}: {:?}", fastest[w]);
            }
        }
        // Each world has its own way.
        assert!((1..8).all(|w| furthest[w] != furthest[0]));
        assert_eq!(arena.look().obstacle_quat(0), quats);
    }
}

#[test]
fn where_they_are_depends_on_the_time_of_their_world_alone() {
    let text = "n_worlds = 3\nseed = 5\nobstacle_motion = {}";
    let mut one = Arena::<f64>::from_config(&config(text)).unwrap();
    let mut other = Arena::<f64>::from_config(&config(text)).unwrap();
    one.step(60).unwrap();
    for _ in 0..60 {
        // Whatever is written into the arrays is overwritten.
        other.obstacle_pos_mut().fill(3.0);
        other.step(1).unwrap();
    }
    assert_eq!(positions(&one, 2), positions(&other, 2));
    // Halves of steps move them too.
    one.run_controllers().unwrap();
    one.run_integration().unwrap();
    other.step(1).unwrap();
    assert_eq!(positions(&one, 1), positions(&other, 1));
    // A world that stands among others as it does alone.
    let mut part = config(text).load().unwrap().worlds::<f64>(2, 1).unwrap();
    part.step(61).unwrap();
    assert_eq!(positions(&part, 0), positions(&one, 2));
    // Saved, restored and forked.
    let saved = one.save();
    one.step(30).unwrap();
    let later = positions(&one, 0);
    one.restore(&saved).unwrap();
    assert_eq!(positions(&one, 1), positions(&other, 1));
    one.step(30).unwrap();
    assert_eq!(positions(&one, 0), later);
    one.fork(0).unwrap();
    one.step(30).unwrap();
    assert_eq!(positions(&one, 0), positions(&one, 2));
    // A reset draws anew, about the same places; worlds left out go on.
    let kept = positions(&one, 0);
    one.reset(Some(&[false, true, true])).unwrap();
    assert_eq!(positions(&one, 0), kept);
    let begun = positions(&one, 1);
    assert!(begun != positions(&one, 2));
    one.reset(Some(&[false, true, false])).unwrap();
    assert!(begun != positions(&one, 1));
    let place = [8.0, 0.0, 0.5];
    assert!(vec3::norm(vec3::sub(positions(&one, 1)[1], place)) <= 1.5);
}

#[test]
fn only_those_that_are_named_move_and_wrong_words_are_refused() {
    let mut arena = Arena::<f64>::from_config(&config("obstacle_motion = { names = [\"post\"] }")).unwrap();
    let before = positions(&arena, 0);
    assert_eq!(before[0], [0.0, 0.0, 1.0]);
    arena.step(50).unwrap();
    let now = positions(&arena, 0);
    assert!(now[0] == before[0] && now[1] != before[1]);
    arena.set_obstacle_motion(None).unwrap();
    arena.step(50).unwrap();
    assert_eq!(positions(&arena, 0), now);

    let refused = |text: &str| {
        let config = SimConfig::from_text(text).map(|mut c| {
            c.scene.get_or_insert(propwash::arena::SceneConfig::Xml(SCENE.into()));
            c
        });
        config.and_then(|c| Arena::<f64>::from_config(&c)).unwrap_err().to_string()
    };
    for (text, words) in [
        ("obstacle_motion = { names = [\"bal\"] }", "names of movable obstacles: 'ball', 'post', got 'bal'"),
        (
            "obstacle_motion = { speed_m_s = [1.0, 0.5] }",
            "obstacle_motion.speed_m_s: expected the least and the greatest",
        ),
        ("obstacle_motion = { reach_m = [-1.0, 0.5] }", "obstacle_motion.reach_m"),
        ("obstacle_motion = { kind = \"zigzag\" }", "unknown variant `zigzag`"),
        ("obstacle_motion = { sped_m_s = 1 }", "unknown field `sped_m_s`"),
        ("obstacle_motion = {}\nscene = \"none\"", "moving obstacles needs a scene"),
        ("obstacle_motion = {}\nscene = { xml = \"<mujoco/>\" }", "a scene with movable obstacles"),
    ] {
        let said = refused(text);
        assert!(said.contains(words), "{text}: {said}");
    }
}

/// Drones that hover about the origin, and a ball at a place on the x axis and of a radius, m.
fn env([x, radius]: [f64; 2], more: &str) -> Env {
    let scene = "<mujoco><worldbody><geom type='plane' size='20 20 1'/>\
        <body name='ball' mocap='true' pos='0 0 1'><geom type='sphere' size='.2'/></body></worldbody></mujoco>"
        .replace("0 0 1'><geom type='sphere' size='.2'", &format!("{x} 0 1'><geom type='sphere' size='{radius}'"));
    let text = format!(
        "n_worlds = 16\ntask = {{ kind = \"reach_pos\" }}\nmax_episode_s = 8.0\nscene = {{ xml = \"{scene}\" }}\n{more}"
    );
    Env::new(EnvConfig::from_text(&text).unwrap()).unwrap()
}

#[test]
fn in_an_environment_they_are_seen_and_hit_drones() {
    let crashes = |more: &str| {
        let mut env = env([4.0, 1.0], more);
        env.reset(Some(3), None).unwrap();
        let action = vec![0.0; 16 * env.action_width()];
        let mut n = 0;
        for _ in 0..300 {
            env.step(&action).unwrap();
            n += env.ending().iter().filter(|e| **e == Ending::Crashed as u8).count();
        }
        n
    };
    let still = crashes("");
    let moving =
        crashes("obstacle_motion = { kind = \"circle\", speed_m_s = [4.0, 5.0], reach_m = [4.0, 4.0] }");
    // Some drones that hover sink to the ground by themselves.
    assert!(still <= 4 && moving >= still + 3, "{still} {moving}");
    // Every episode has its own shift and way, the same from the same seed.
    let starts = |seed| {
        let mut env =
            env([0.0, 0.2], "obstacle_jitter_m = 0.5\nobstacle_motion = { speed_m_s = [0.0, 0.0] }");
        env.reset(Some(seed), None).unwrap();
        let first = env.obstacles().pos_m.to_vec();
        env.reset(None, None).unwrap();
        (first, env.obstacles().pos_m.to_vec())
    };
    let (first, second) = starts(1);
    assert!(first != second && starts(1) == (first.clone(), second) && starts(2).0 != first);
    assert!(first.chunks(3).all(|p| p[0].abs() <= 0.5 && p[1].abs() <= 0.5 && p[2] == 1.0));
    assert!(first.chunks(3).skip(1).all(|p| p != &first[..3]), "worlds differ");
}

fn fly(out: &Path, line: &str) {
    let output = Command::new(env!("CARGO_BIN_EXE_propwash"))
        .args(["fly", "--json", "--out"])
        .arg(out)
        .args(line.split_whitespace())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn data_sets_say_where_they_were_and_every_contact_is_found_in_its_step() {
    let dir = tempfile::tempdir().unwrap();
    let scene = dir.path().join("ball.xml");
    let text = "<mujoco><worldbody><geom type='plane' size='20 20 1'/>\
        <body name='ball' mocap='true' pos='.8 0 1'><geom type='sphere' size='.4'/></body></worldbody></mujoco>";
    std::fs::write(&scene, text).unwrap();
    let line = format!(
        "--scene {} --drone cf2x_L250 --worlds 12 --seconds 2 --fps 10 --size 16x12 --trajectory hover --obstacle-motion \
         line:speed_m_s=[2.0,3.0],reach_m=[1.5,2.0]",
        scene.display()
    );
    let (often, seldom) = (dir.path().join("often"), dir.path().join("seldom"));
    fly(&often, &format!("{line} --log-hz 500 --threads 1"));
    fly(&seldom, &format!("{line} --log-hz 10"));
    let (often, seldom) = (Dataset::open(&often).unwrap(), Dataset::open(&seldom).unwrap());
    assert_eq!(often.manifest().obstacles, ["ball"]);
    let (mut touched, mut moved) = (0, 0);
    for w in 0..12 {
        let first = |set: &Dataset| {
            let table = set.world(w).unwrap().contacts(Some(&["step"])).unwrap();
            table.column("step").unwrap().iter().map(|s| *s as u64).min()
        };
        // A drone that hovers does not come nearer by itself: the ball does, between rows of clearances too.
        assert_eq!(first(&often), first(&seldom), "world {w}");
        touched += usize::from(first(&often).is_some());
        let (a, b) = (often.world(w).unwrap().frames().unwrap(), seldom.world(w).unwrap().frames().unwrap());
        let (places, others) = (a.obstacle_pos_m.unwrap(), b.obstacle_pos_m.unwrap());
        assert_eq!(places, others);
        assert_eq!(
            (places.shape(), a.obstacle_quat_xyzw.unwrap().shape()),
            (&[21, 1, 3][..], &[21, 1, 4][..])
        );
        moved += usize::from((places[[0, 0, 0]] - places[[10, 0, 0]]).abs() > 0.01);
    }
    assert!(touched >= 3 && moved >= 10, "{touched} {moved}");
    // Flown again from its description, obstacles are where they were.
    let config = FlightConfig::from_file(&dir.path().join("seldom/manifest.json")).unwrap();
    let mut arena = Arena::<f64>::from_config(&config.sim).unwrap();
    arena.step(250).unwrap();
    let frames = seldom.world(7).unwrap().frames().unwrap();
    let at = frames.step.iter().position(|s| *s == 250).unwrap();
    let recorded: Vec<f64> = (0..3).map(|k| frames.obstacle_pos_m.as_ref().unwrap()[[at, 0, k]]).collect();
    assert_eq!(arena.look().obstacle_pos_m(7)[0].to_vec(), recorded);
}
