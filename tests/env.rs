//! Learning environments: the same bits for any threads and batch, resets, endings, delays, noise, and what tasks promise.

use propwash::env::{Autoreset, Ending, Env, EnvConfig, EnvError};
use propwash::vehicle::Vehicle;

fn vehicle() -> Vehicle {
    Vehicle::builtin("cf2x_L250").unwrap()
}

fn env(json: &str) -> Env {
    Env::new(EnvConfig::from_text(json).unwrap()).unwrap()
}

fn refused(json: &str) -> String {
    match EnvConfig::from_text(json).and_then(|c| Env::new(c).map(|_| ())) {
        Ok(()) => panic!("{json} was taken"),
        Err(e) => e.to_string(),
    }
}

/// Actions that differ by world, drone and step but not by the batch.
fn actions(env: &Env, first: usize, step: usize) -> Vec<f32> {
    let (n, d, w) = (env.config().sim.options.n_worlds, env.config().sim.n_drones(), env.action_width());
    (0..n * d * w)
        .map(|i| {
            let (world, rest) = (first + i / (d * w), i % (d * w));
            let x = (world * 7919 + rest * 104_729 + step * 1_299_709) as f64;
            (0.8 * (x * 0.618).sin()) as f32
        })
        .collect()
}

/// Everything that a caller sees over some steps.
fn flown(env: &mut Env, seed: u64, first: usize, steps: usize) -> Vec<u32> {
    env.reset(Some(seed), None).unwrap();
    let mut out = Vec::new();
    for step in 0..steps {
        let action = actions(env, first, step);
        env.step(&action).unwrap();
        for list in [
            env.observation().to_vec(),
            env.depth().to_vec(),
            env.reward().to_vec(),
            env.clearance().to_vec(),
        ] {
            out.extend(list.iter().map(|v| v.to_bits()));
        }
        out.extend(env.ending().iter().map(|e| u32::from(*e)));
    }
    out
}

const TASKS: [&str; 8] = [
    r#""task": {"kind": "reach_pos"}"#,
    r#""task": {"kind": "reach_vel"}, "action": {"kind": "body_rate"}"#,
    r#""task": {"kind": "landing"}, "action": {"kind": "rotor_vel"}"#,
    r#""task": {"kind": "trajectory", "shape": "lissajous"}"#,
    r#""task": {"kind": "forest_depth"}, "action": {"kind": "velocity"}, "layouts": 2, "camera": {"device": "vl53l5cx"}"#,
    r#""task": {"kind": "gate_race"}, "action": {"kind": "velocity"}, "layouts": 2, "camera": {"width": 8, "height": 6}"#,
    r#""task": {"kind": "room_explore"}, "action": {"kind": "velocity"}, "layouts": 2, "camera": {"width": 16, "height": 12}"#,
    r#""task": {"kind": "swarm_cross"}, "n_drones": 3, "action": {"kind": "velocity"}, "layouts": 2, "camera": {"width": 8, "height": 8}"#,
];

const RANDOM: &str = r#""levels": {"pos_sigma_m": 0.02, "attitude_sigma_rad": 0.01}, "randomization": {"rule": [
    {"parameter": "body.mass_kg", "draw": {"scale": [0.9, 1.1]}},
    {"parameter": "env.action_delay_s", "draw": {"uniform": [0.0, 0.05]}},
    {"parameter": "env.depth_delay_s", "draw": {"uniform": [0.0, 0.06]}},
    {"parameter": "env.wind_m_s.*", "draw": {"uniform": [-1.0, 1.0]}}]}"#;

#[test]
fn the_same_seed_gives_the_same_bits_for_any_threads_and_batch() {
    for task in TASKS {
        let of = |n: usize, first: usize| {
            env(&format!(
                r#"{{{task}, {RANDOM}, "n_worlds": {n}, "first_world": {first}, "step_hz": 25, "max_episode_s": 0.4}}"#
            ))
        };
        let pool = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let (mut four, mut again) = (of(4, 0), of(4, 0));
        let one_thread = pool(1).install(|| flown(&mut four, 5, 0, 20));
        let eight = pool(8).install(|| flown(&mut again, 5, 0, 20));
        assert!(one_thread == eight, "{task}: threads change the numbers");
        assert!(one_thread == flown(&mut four, 5, 0, 20), "{task}: a second run with the same seed differs");
        assert!(one_thread != flown(&mut four, 6, 0, 20), "{task}: another seed gives the same");
        // World 2 by itself.
        let alone = flown(&mut of(1, 2), 5, 2, 20);
        let mut batch = of(4, 0);
        batch.reset(Some(5), None).unwrap();
        let mut at = 0;
        for step in 0..20 {
            let action = actions(&batch, 0, step);
            batch.step(&action).unwrap();
            let lists = [
                batch.observation().to_vec(),
                batch.depth().to_vec(),
                batch.reward().to_vec(),
                batch.clearance().to_vec(),
            ];
            for list in lists {
                let each = list.len() / 4;
                for v in &list[2 * each..3 * each] {
                    assert!(v.to_bits() == alone[at], "{task}: world 2 differs in a batch at step {step}");
                    at += 1;
                }
            }
            assert_eq!(u32::from(batch.ending()[2]), alone[at]);
            at += 1;
        }
    }
}

#[test]
fn episodes_end_by_time_and_start_anew_as_the_mode_says() {
    let of = |mode: &str| {
        let mut e = env(&format!(
            r#"{{"n_worlds": 3, "step_hz": 50, "max_episode_s": 0.1, "autoreset": "{mode}", "task": {{"kind": "reach_pos"}}}}"#
        ));
        e.reset(Some(1), None).unwrap();
        e
    };
    let hover = [0.0; 12];
    // In the next step: five steps, then one that resets.
    let mut e = of("next_step");
    let first = e.observation().to_vec();
    for k in 1..=5 {
        e.step(&hover).unwrap();
        assert_eq!(e.truncated().iter().all(|t| *t), k == 5, "step {k}");
        assert_eq!(e.ending()[0], if k == 5 { Ending::TimeUp as u8 } else { 0 });
    }
    let last = e.observation().to_vec();
    e.step(&hover).unwrap();
    assert!(e.reward().iter().all(|r| *r == 0.0) && !e.truncated()[0] && e.ending()[0] == 0);
    let second = e.observation().to_vec();
    assert!(second != last && second != first, "a new episode starts elsewhere");
    e.step(&hover).unwrap();
    assert!(e.reward()[0] > 0.0);

    // In the same step: the last observation is kept apart, and episodes are those of the other mode.
    let mut e = of("same_step");
    for _ in 0..5 {
        e.step(&hover).unwrap();
    }
    assert!(e.truncated().iter().all(|t| *t));
    assert!(e.final_observation() == last && e.observation() == second);

    // Never.
    let mut e = of("disabled");
    for _ in 0..5 {
        e.step(&hover).unwrap();
    }
    let error = e.step(&hover).unwrap_err();
    assert!(matches!(error, EnvError::Ended { world: 0 }), "{error}");
    e.reset(None, Some(&[true, true, false])).unwrap();
    assert!(matches!(e.step(&hover).unwrap_err(), EnvError::Ended { world: 2 }));
    assert!(e.observation()[..2 * last.len() / 3] == second[..2 * last.len() / 3]);
    assert!(e.observation()[2 * last.len() / 3..] == last[2 * last.len() / 3..], "world 2 was left alone");
}

#[test]
fn a_drone_that_flies_through_a_thin_wall_within_one_step_has_crashed() {
    // 1 mm thick; at 5 steps per second the drone is on its far side at the next look.
    let wall =
        r#"<mujoco><worldbody><geom type='box' size='0.0005 3 3' pos='0.8 0 1'/></worldbody></mujoco>"#;
    let mut e = env(&format!(
        r#"{{"scene": {{"xml": "{wall}"}}, "step_hz": 5, "action": {{"kind": "velocity", "max_accel_m_s2": 50}}, "with_camera": false,
        "task": {{"kind": "reach_pos", "start_m": [[0, 0, 1], [0, 0, 1]], "start_speed_m_s": 0.0}}}}"#
    ));
    let start = r#"{"rule": [{"parameter": "initial.vel.0", "draw": {"uniform": [8.0, 8.0]}}]}"#;
    let mut config = e.config().clone();
    config.sim.options.randomization = serde_json::from_str(start).unwrap();
    e = Env::new(config).unwrap();
    e.reset(Some(0), None).unwrap();
    assert!((e.clearance()[0] - 0.75).abs() < 0.02, "{}", e.clearance()[0]);
    e.step(&[1.0, 0.0, 0.0, 0.0]).unwrap();
    assert!(e.observation()[0] > 0.9, "it is beyond the wall: {}", e.observation()[0]);
    assert!(e.clearance()[0] > 0.0, "and free there");
    assert_eq!((e.ending()[0], e.reward()[0]), (Ending::Crashed as u8, -1.0));
}

#[test]
fn two_drones_that_change_places_within_one_step_have_crashed() {
    let floor = "<mujoco><worldbody><geom type='plane' size='0 0 1'/></worldbody></mujoco>";
    let json = |speed: f64| {
        format!(
            r#"{{"scene": {{"xml": "{floor}"}}, "step_hz": 5, "n_drones": 2, "with_camera": false,
            "task": {{"kind": "swarm_cross", "radius_m": 0.6, "height_m": [1, 1], "start_off_m": 0.0, "free_m": 0.1,
            "arrive_m": 0.01, "space_m": [20, 20]}}, "action": {{"kind": "velocity",
            "max_speed_m_s": {speed}, "max_accel_m_s2": 1000}}}}"#
        )
    };
    // Both fly at their goals, which are the places of the other, as fast as they can.
    let crashes = |speed: f64| {
        let mut e = env(&json(speed));
        e.reset(Some(3), None).unwrap();
        for _ in 0..12 {
            e.step(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]).unwrap();
            if e.ending()[0] != 0 {
                return e.ending()[0];
            }
        }
        0
    };
    assert_eq!(crashes(2.0), Ending::Crashed as u8);
}

#[test]
fn a_command_comes_late_by_its_delay_and_no_other() {
    // Height after some steps of full thrust: one that is late by 60 ms is where the other was 60 ms before.
    let height = |delay: f64, steps: usize| {
        let mut e = env(&format!(
            r#"{{"step_hz": 50, "levels": {{"action_delay_s": {delay}}}, "task": {{"kind": "reach_pos", "start_m": [[0,0,1],[0,0,1]],
            "start_speed_m_s": 0.0}}}}"#
        ));
        e.reset(Some(0), None).unwrap();
        for _ in 0..steps {
            e.step(&[0.0, 0.0, 0.0, 1.0]).unwrap();
        }
        f64::from(e.observation()[2])
    };
    assert!(height(0.0, 10) > 1.02, "{}", height(0.0, 10));
    assert!((height(0.06, 13) - height(0.0, 10)).abs() < 1e-5, "{} {}", height(0.06, 13), height(0.0, 10));
    assert!((height(0.06, 3) - 1.0).abs() < 1e-5, "nothing has arrived yet: {}", height(0.06, 3));
    // A part of a step too.
    let (early, late) = (height(0.0, 10), height(0.01, 10));
    assert!(late < early && late > height(0.0, 9), "{late} between {} and {early}", height(0.0, 9));
}

#[test]
fn an_image_comes_late_by_its_delay_and_is_the_one_of_then() {
    let of = |delay: f64| {
        let wall = r#"<mujoco><worldbody><geom type='box' size='0.1 9 9' pos='4 0 1'/></worldbody></mujoco>"#;
        let mut e = env(&format!(
            r#"{{"scene": {{"xml": "{wall}"}}, "step_hz": 20, "camera": {{"width": 4, "height": 4}}, "action": {{"kind": "velocity"}},
            "levels": {{"depth_delay_s": {delay}}}, "task": {{"kind": "reach_pos", "start_m": [[0,0,1],[0,0,1]], "start_speed_m_s": 0.0}}}}"#
        ));
        e.reset(Some(0), None).unwrap();
        let mut images = vec![e.depth().to_vec()];
        for _ in 0..12 {
            e.step(&[1.0, 0.0, 0.0, 0.0]).unwrap();
            images.push(e.depth().to_vec());
        }
        images
    };
    let (now, late) = (of(0.0), of(0.15));
    assert!(now[12][0] < now[9][0] - 0.1, "it comes nearer: {} {}", now[9][0], now[12][0]);
    for k in 0..=12 {
        assert!(late[k] == now[k.saturating_sub(3)], "image {k}");
    }
}

#[test]
fn noise_has_the_deviation_asked_for_and_is_observed_only() {
    let of = |sigma: f64| {
        let mut e = env(&format!(
            r#"{{"n_worlds": 500, "levels": {{"pos_sigma_m": {sigma}, "vel_sigma_m_s": {sigma}}}, "task": {{"kind": "reach_pos"}}}}"#
        ));
        e.reset(Some(4), None).unwrap();
        let action = vec![0.0; 2000];
        for _ in 0..3 {
            e.step(&action).unwrap();
        }
        (e.observation().to_vec(), e.reward().to_vec())
    };
    let ((clean, reward), (noisy, same)) = (of(0.0), of(0.05));
    assert!(reward == same, "the reward is that of the true state");
    let width = clean.len() / 500;
    let deviation = |column: usize| {
        let square: f64 =
            (0..500).map(|w| f64::from(noisy[w * width + column] - clean[w * width + column]).powi(2)).sum();
        (square / 500.0).sqrt()
    };
    for column in [0, 1, 2, 7, 8, 9] {
        assert!((0.045..0.055).contains(&deviation(column)), "column {column}: {}", deviation(column));
    }
    assert_eq!(deviation(3), 0.0, "attitude has no noise here");
    // What the task observes follows from the noisy position.
    assert!((0.045..0.055).contains(&deviation(13)));
}

#[test]
fn the_forest_is_crossed_by_a_drone_that_flies_where_it_sees_room() {
    // A policy by hand, of depth alone: of sixteen directions take the one near the goal's in which most is free.
    let mut e = env(
        r#"{"task": {"kind": "forest_depth"}, "action": {"kind": "velocity", "max_speed_m_s": 1.5}, "n_worlds": 8, "layouts": 4,
        "step_hz": 20, "max_episode_s": 30, "camera": {"width": 16, "height": 8}, "autoreset": "disabled"}"#,
    );
    e.reset(Some(7), None).unwrap();
    let (mut ended, mut total) = ([0u8; 8], [0.0f32; 8]);
    let width = e.channels().iter().map(|c| c.width).sum::<usize>();
    for _ in 0..600 {
        let (obs, depth) = (e.observation().to_vec(), e.depth().to_vec());
        let mut action = vec![0.0f32; 32];
        for w in 0..8 {
            let goal = &obs[w * width + 13..w * width + 16];
            let column: Vec<f32> =
                (0..16).map(|c| (0..8).fold(10.0f32, |a, r| a.min(depth[128 * w + 16 * r + c]))).collect();
            let around = |c: usize| {
                column[c.saturating_sub(2)..(c + 3).min(16)].iter().fold(10.0f32, |a, v| a.min(*v))
            };
            let angle = |c: usize| 0.9 - 0.12 * c as f32;
            let bearing = goal[1].atan2(goal[0]).clamp(-0.9, 0.9);
            let cost = |c: usize| (angle(c) - bearing).abs() + 1.5 * (2.0 - around(c)).max(0.0);
            let best = (0..16).min_by(|a, b| cost(*a).total_cmp(&cost(*b))).unwrap();
            let (sin, cos) = angle(best).sin_cos();
            let speed = (0.5 * (around(best) - 0.5)).clamp(0.0, 0.7);
            let side = |from: usize| column[from..from + 5].iter().fold(10.0f32, |a, v| a.min(*v)).max(0.2);
            let push = (0.25 / side(11) - 0.25 / side(0)).clamp(-0.5, 0.5);
            action[4 * w] = speed * cos;
            action[4 * w + 1] = 1.2 * speed * sin + push;
            action[4 * w + 2] = (0.8 * goal[2]).clamp(-0.3, 0.3);
            action[4 * w + 3] = (0.8 * angle(best)).clamp(-0.5, 0.5);
        }
        e.step(&action).unwrap();
        let mask: Vec<bool> = e.ending().iter().map(|e| *e != 0).collect();
        for w in 0..8 {
            if ended[w] == 0 {
                total[w] += e.reward()[w];
                ended[w] = e.ending()[w];
            }
        }
        if ended.iter().all(|e| *e != 0) {
            break;
        }
        e.reset(None, Some(&mask)).unwrap();
    }
    let arrived = ended.iter().filter(|e| **e == Ending::Done as u8).count();
    assert!(arrived >= 6, "{arrived} of 8 arrived: {ended:?}");
    for w in 0..8 {
        // About 14 m of progress and 10 for arriving, less what nearness costs.
        let good = ended[w] != Ending::Done as u8 || (15.0..26.0).contains(&total[w]);
        assert!(good, "world {w}: {} for {total:?}", ended[w]);
    }
}

#[test]
fn gates_are_passed_in_their_order_by_a_drone_that_aims_at_their_middles() {
    let mut e = env(
        r#"{"task": {"kind": "gate_race", "random_start": false, "start_off_m": 0.0}, "action": {"kind": "velocity", "max_speed_m_s": 1.5},
        "n_worlds": 8, "step_hz": 25, "max_episode_s": 120, "with_camera": false, "layouts": 8, "autoreset": "disabled"}"#,
    );
    e.reset(Some(1), None).unwrap();
    let gates = e.course(0).unwrap().gates.len() as f32;
    let width = e.channels().iter().map(|c| c.width).sum::<usize>();
    let (mut ended, mut total) = ([0u8; 8], [0.0f32; 8]);
    for _ in 0..2000 {
        let obs = e.observation().to_vec();
        let mut action = vec![0.0f32; 32];
        for w in 0..8 {
            let (at, axis) = (&obs[w * width + 13..w * width + 16], &obs[w * width + 16..w * width + 19]);
            let along: f32 = (0..3).map(|k| at[k] * axis[k]).sum();
            let off = (0..3).map(|k| (at[k] - along * axis[k]).powi(2)).sum::<f32>().sqrt();
            // To a place before the gate until it is straight ahead, then through.
            let back = if off > 0.12 { (3.0 * off).min(1.0) } else { -0.6 };
            let aim: Vec<f32> = (0..3).map(|k| at[k] - back * axis[k]).collect();
            let far = aim.iter().map(|v| v * v).sum::<f32>().sqrt();
            let speed = (1.5 * far).min(1.0) / far.max(1e-6) / 1.5;
            let turn = if along > 1.0 { at[1].atan2(at[0]) } else { axis[1].atan2(axis[0]) };
            for (k, v) in aim.iter().map(|v| v * speed).chain([0.7 * turn]).enumerate() {
                action[4 * w + k] = v.clamp(-1.0, 1.0);
            }
        }
        e.step(&action).unwrap();
        let mask: Vec<bool> = e.ending().iter().map(|e| *e != 0).collect();
        for w in 0..8 {
            if ended[w] == 0 {
                total[w] += e.reward()[w];
                ended[w] = e.ending()[w];
            }
        }
        if ended.iter().all(|e| *e != 0) {
            break;
        }
        e.reset(None, Some(&mask)).unwrap();
    }
    let done = ended.iter().filter(|e| **e == Ending::Done as u8).count();
    assert!(done >= 6, "{done} of 8 flew the course: {ended:?}");
    for w in 0..8 {
        let all = ended[w] == Ending::Done as u8;
        assert_eq!(all, total[w] > 2.0 * gates + 10.0, "world {w}: {} for {total:?}", ended[w]);
    }
}

#[test]
fn a_room_is_seen_by_turning_in_it_and_no_cell_counts_twice() {
    let mut e = env(
        r#"{"task": {"kind": "room_explore", "start_m": [[0, 0, 1.2], [0, 0, 1.2]], "see_m": 6.0}, "scene": {"rooms": {"columns": 2, "rows": 1,
        "things": 0}}, "layouts": 1, "action": {"kind": "velocity"}, "step_hz": 20, "camera": {"width": 32, "height": 32}}"#,
    );
    e.reset(Some(2), None).unwrap();
    let width = e.channels().iter().map(|c| c.width).sum::<usize>();
    let seen_at = width - 257;
    let turn = |e: &mut Env, steps: usize| {
        let mut sum = 0.0;
        for _ in 0..steps {
            e.step(&[0.0, 0.0, 0.0, 1.0]).unwrap();
            sum += e.reward()[0];
        }
        sum
    };
    let first = turn(&mut e, 80);
    let seen = e.observation()[seen_at];
    let second = turn(&mut e, 80);
    // Half of the house is this room: about 16 m², half a point each, less what turning costs.
    assert!((0.4..0.8).contains(&seen), "{seen}");
    assert!(first > 5.0 && second < 0.2 * first, "{first}, then {second}");
    assert!(e.observation()[seen_at + 1..].iter().sum::<f32>() > 30.0, "the map near the drone shows it");
}

#[test]
fn actions_that_are_no_numbers_are_refused_and_nothing_is_flown() {
    let mut e = env(r#"{"n_worlds": 2}"#);
    assert!(e.step(&[0.0; 8]).unwrap_err().to_string().contains("reset"));
    e.reset(Some(0), None).unwrap();
    let before = e.observation().to_vec();
    let error = e.step(&[0.0; 7]).unwrap_err().to_string();
    assert!(error.contains("expected 8 numbers") && error.contains("got 7"), "{error}");
    let error = e.step(&[0.0, 0.0, 0.0, 0.0, 0.0, f32::NAN, 0.0, 0.0]).unwrap_err().to_string();
    assert!(error.contains("world 1, drone 0, entry 1") && error.contains("NaN"), "{error}");
    assert!(e.observation() == before);
    e.step(&[0.0, 0.0, 0.0, 0.0, 3.0, 0.0, 0.0, 0.0]).unwrap();
    assert!(!e.clipped(0) && e.clipped(1), "held within the limits, and said");
}

#[test]
fn descriptions_that_make_no_sense_are_refused_by_name() {
    for (json, words) in [
        (r#"{"n_worlds": 0}"#, "n_worlds: expected 1 to"),
        (r#"{"n_wrlds": 1}"#, "unknown field `n_wrlds`"),
        (r#"{"step_hz": 60}"#, "step_hz: expected a divisor of sim_hz (500 Hz), got 60"),
        (r#"{"task": {"kind": "reach"}}"#, "unknown variant `reach`"),
        (r#"{"task": {"kind": "reach_pos", "goal": 1}}"#, "unknown field `goal`"),
        (
            r#"{"task": {"kind": "reach_pos", "goal_m": [[1, 0, 0], [0, 0, 0]]}}"#,
            "task goal_m: expected two corners",
        ),
        (r#"{"task": {"kind": "reach_pos"}, "n_drones": 2}"#, "n_drones: expected 1"),
        (r#"{"task": {"kind": "swarm_cross"}}"#, "n_drones: expected 2 or more"),
        (r#"{"task": {"kind": "swarm_cross"}, "n_drones": 2, "scene": "none"}"#, "scene: expected any scene"),
        (r#"{"task": {"kind": "gate_race"}, "scene": {"forest": {}}}"#, "named gate"),
        (r#"{"task": {"kind": "room_explore"}, "with_camera": false}"#, "with_camera: expected true"),
        (
            r#"{"task": {"kind": "room_explore"}, "scene": {"rooms": {"columns": 9}}}"#,
            "task space_m: expected at most 24 m",
        ),
        (r#"{"camera": {"device": "vl53l5cx"}}"#, "camera: expected none without a scene"),
        (
            r#"{"scene": {"forest": {}}, "camera": {"device": "lidar"}}"#,
            "camera device: expected one of ideal",
        ),
        (r#"{"scene": {"forest": {"size": 3}}}"#, "unknown field `size`"),
        (r#"{"scene": {"files": []}}"#, "layouts: expected 1 to 4096 scenes, got 0"),
        (r#"{"action": {"kind": "force_torque"}}"#, "action max_torque_n_m: expected three torques"),
        (
            r#"{"drones": [{"dynamics": "so_rpy"}], "action": {"kind": "rotor_vel"}}"#,
            "action kind: expected one that flies",
        ),
        (r#"{"levels": {"action_delay_s": -1}}"#, "env.action_delay_s: expected 0 to 1"),
        (r#"{"max_episode_s": 0}"#, "max_episode_s: expected more than 0"),
        (
            r#"{"randomization": {"rule": [{"parameter": "env.wnd", "draw": {"normal": 1}}]}}"#,
            "randomization of env.wnd",
        ),
    ] {
        let message = refused(json);
        assert!(message.contains(words), "{json}: {message}");
    }
    let toml = EnvConfig::from_text("n_worlds = 2\nautoreset = \"same_step\"\n[task]\nkind = \"landing\"\n")
        .unwrap();
    assert_eq!((toml.sim.options.n_worlds, toml.autoreset), (2, Autoreset::SameStep));
    let error = EnvConfig::from_text("n_worlds = 2\n[task]\nkind = \"lnding\"\n").unwrap_err().to_string();
    assert!(error.contains("line") && error.contains("lnding"), "{error}");
}

#[test]
fn a_vehicle_is_hovering_under_neutral_actions_of_every_kind() {
    for kind in ["attitude", "body_rate", "force_torque", "rotor_vel", "velocity"] {
        let mut e = env(&format!(
            r#"{{"action": {{"kind": "{kind}", "max_torque_n_m": [0.003, 0.003, 0.001]}}, "task": {{"kind": "reach_pos",
            "start_m": [[0,0,1],[0,0,1]], "start_speed_m_s": 0.0}}}}"#
        ));
        e.reset(Some(0), None).unwrap();
        for _ in 0..25 {
            e.step(&[0.0; 4]).unwrap();
        }
        let p = &e.observation()[..3];
        assert!((p[2] - 1.0).abs() < 0.05 && p[0].abs() < 0.02 && p[1].abs() < 0.02, "{kind}: {p:?}");
    }
}

#[test]
fn limits_in_si_are_those_of_the_vehicle() {
    let e = env(r#"{"action": {"normalized": false, "max_tilt_rad": 0.7}}"#);
    let (low, high) = e.action_limits();
    let v = vehicle().drone("first_principles").unwrap();
    let n = v.airframe.n_rotors as f64;
    assert_eq!(low[3], (n * v.controller.thrust_min_n) as f32);
    assert_eq!(high[3], (n * v.controller.thrust_max_n) as f32);
    assert_eq!((low[0], high[1]), (-0.7, 0.7));
}
