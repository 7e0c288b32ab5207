//! Tasks that are not built in: written again, `reach_pos` gives the numbers of the built-in one, by one world at a time and by all at once.

use std::sync::Arc;

use propwash::arena::SceneConfig;
use propwash::env::{
    Batch, BatchObstacles, BatchTask, Channel, Draw, Ending, Env, EnvConfig, EnvError, EpisodeStart,
    FreePlace, Obstacles, Outcome, Start, Task, TaskConfig, WorldView,
};

/// `reach_pos` with its defaults, one world at a time.
struct OneByOne;

fn off(goal: &[f32], pos: [f64; 3]) -> [f64; 3] {
    core::array::from_fn(|k| f64::from(goal[k]) - pos[k])
}

fn length(v: [f64; 3]) -> f64 {
    v.iter().map(|v| v * v).sum::<f64>().sqrt()
}

impl Task for OneByOne {
    fn channels(&self) -> Vec<Channel> {
        vec![Channel::new("difference_to_goal", 3)]
    }

    fn memory_len(&self, _: usize) -> usize {
        3
    }

    fn has_goal(&self) -> bool {
        true
    }

    fn begin(&self, start: &mut EpisodeStart) -> Result<(), EnvError> {
        start.start_within([[-1.0, -1.0, 1.0], [1.0, 1.0, 2.0]], 1.0);
        let drawn = start.within([[-1.0, -1.0, 0.5], [1.0, 1.0, 1.5]]);
        let goal = start.given_goal(0).unwrap_or(drawn);
        start.memory.iter_mut().zip(goal).for_each(|(to, v)| *to = v as f32);
        Ok(())
    }

    fn judge(&self, view: &WorldView, memory: &mut [f32], reward: &mut [f32]) -> Outcome {
        let seen = &view.drones[0];
        reward[0] = if seen.crashed { -1.0 } else { (-2.0 * length(off(memory, seen.pos_m))).exp() as f32 };
        if seen.crashed { Outcome::Crashed } else { Outcome::Continue }
    }

    fn observe(&self, view: &WorldView, memory: &[f32], drone: usize, out: &mut [f32]) {
        let off = off(memory, view.drones[drone].pos_m);
        out.iter_mut().zip(off).for_each(|(to, v)| *to = v as f32);
    }
}

/// The same, all worlds at once.
struct AtOnce;

fn three(list: &[f32], row: usize) -> [f64; 3] {
    core::array::from_fn(|k| f64::from(list[3 * row + k]))
}

impl BatchTask for AtOnce {
    fn channels(&self) -> Vec<Channel> {
        OneByOne.channels()
    }

    fn has_goal(&self) -> bool {
        true
    }

    fn on_reset(&mut self, batch: &mut Batch, _: &mut BatchObstacles) -> Result<(), EnvError> {
        for w in (0..batch.n_worlds).filter(|w| batch.begins[*w]).collect::<Vec<_>>() {
            let mut draw = batch.stream(w, Draw::Reset);
            let mut fill = |list: &mut [f32], low: [f64; 3], high: [f64; 3]| {
                (0..3).for_each(|k| list[3 * w + k] = draw.uniform(low[k], high[k]) as f32);
            };
            fill(&mut batch.start_pos, [-1.0, -1.0, 1.0], [1.0, 1.0, 2.0]);
            fill(&mut batch.start_vel, [-1.0; 3], [1.0; 3]);
            if !batch.goal_given[w] {
                fill(&mut batch.goal_pos, [-1.0, -1.0, 0.5], [1.0, 1.0, 1.5]);
            }
        }
        Ok(())
    }

    fn judge(&mut self, batch: &mut Batch) -> Result<(), EnvError> {
        for w in 0..batch.n_worlds {
            if batch.crashed[w] {
                batch.reward[w] = -1.0;
                batch.end(w, Outcome::Crashed);
            } else {
                let off = off(&batch.goal_pos[3 * w..], three(&batch.pos, w));
                batch.reward[w] = (-2.0 * length(off)).exp() as f32;
            }
        }
        Ok(())
    }

    fn observe(&mut self, batch: &mut Batch) -> Result<(), EnvError> {
        let pos = if batch.observed_pos.is_empty() { &batch.pos } else { &batch.observed_pos };
        for (i, out) in batch.channels.iter_mut().enumerate() {
            *out = (f64::from(batch.goal_pos[i]) - f64::from(pos[i])) as f32;
        }
        Ok(())
    }
}

/// Everything that differs between two environments of the same task.
fn flown(env: &mut Env, first: usize, goal: Option<&[[f64; 3]]>) -> Vec<Vec<u32>> {
    env.reset_to(Some(9), None, goal).unwrap();
    let n = env.config().sim.options.n_worlds;
    let mut out = Vec::new();
    let bits = |list: &[f32]| list.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    for step in 0..40 {
        let action: Vec<f32> = (0..n * 4)
            .map(|i| {
                let x = ((first + i / 4) * 7919 + i % 4 * 104_729 + step * 1_299_709) as f64;
                // Some fall.
                (0.8 * (x * 0.618).sin()) as f32 - if i % 12 == 3 { 0.6 } else { 0.0 }
            })
            .collect();
        env.step(&action).unwrap();
        let mut row = bits(env.observation());
        row.extend(bits(env.reward()));
        row.extend(env.ending().iter().map(|e| u32::from(*e)));
        row.extend(env.terminated().iter().map(|e| u32::from(*e)));
        row.extend(env.truncated().iter().map(|e| u32::from(*e)));
        // Rows of worlds that go on mean nothing.
        for w in 0..n {
            if !env.final_observation().is_empty() && env.ending()[w] != 0 {
                let each = env.final_observation().len() / n;
                row.extend(bits(&env.final_observation()[w * each..(w + 1) * each]));
            }
        }
        out.push(row);
    }
    out
}

const CASES: [&str; 5] = [
    r#""n_worlds": 6"#,
    r#""n_worlds": 6, "autoreset": "same_step", "max_episode_s": 0.5, "step_hz": 25"#,
    r#""n_worlds": 300, "autoreset": "next_step", "max_episode_s": 0.3, "step_hz": 25"#,
    r#""n_worlds": 6, "max_episode_s": 0.5, "step_hz": 25, "levels": {"pos_sigma_m": 0.02, "attitude_sigma_rad": 0.01},
       "randomization": {"rule": [{"parameter": "env.action_delay_s", "draw": {"uniform": [0.0, 0.05]}},
       {"parameter": "initial.pos.0", "draw": {"uniform": [-0.1, 0.1]}}]}"#,
    r#""n_worlds": 6, "max_episode_s": 0.5, "step_hz": 25, "scene": {"each": [
       {"xml": "<mujoco><worldbody><geom type='plane' size='0 0 1'/></worldbody></mujoco>"},
       {"xml": "<mujoco><worldbody><geom type='box' size='9 9 0.3'/></worldbody></mujoco>"}]}"#,
];

fn config(json: &str) -> EnvConfig {
    EnvConfig::from_text(&format!("{{{json}}}")).unwrap()
}

#[test]
fn reach_pos_written_again_gives_the_bits_of_the_built_in_one() {
    for case in CASES {
        let built_in = flown(&mut Env::new(config(case)).unwrap(), 0, None);
        let one_by_one = flown(&mut Env::with_task(config(case), Arc::new(OneByOne)).unwrap(), 0, None);
        assert!(built_in == one_by_one, "{case}: one world at a time");
        let mut env = Env::with_batch_task(config(case), Box::new(AtOnce)).unwrap();
        let at_once = flown(&mut env, 0, None);
        for (step, (a, b)) in built_in.iter().zip(&at_once).enumerate() {
            // Noise is added in f64, of which arrays hold f32.
            let is_near = |a: &u32, b: &u32| (f32::from_bits(*a) - f32::from_bits(*b)).abs() < 4e-7;
            let is_noisy = case.contains("sigma");
            let same = if is_noisy { a.iter().zip(b).all(|(a, b)| is_near(a, b)) } else { a == b };
            assert!(same && a.len() == b.len(), "{case}: all at once, step {step}");
        }
        assert!(at_once == flown(&mut env, 0, None), "{case}: the same seed again");
    }
}

#[test]
fn a_batch_task_gives_the_same_bits_for_any_threads_and_any_part_of_a_batch() {
    let of = |n: usize, first: usize| {
        let json = format!(r#""n_worlds": {n}, "first_world": {first}, "max_episode_s": 0.4, "step_hz": 25"#);
        Env::with_batch_task(config(&json), Box::new(AtOnce)).unwrap()
    };
    let pool = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let one = pool(1).install(|| flown(&mut of(300, 0), 0, None));
    let four = pool(4).install(|| flown(&mut of(300, 0), 0, None));
    assert!(one == four);
    let part = flown(&mut of(6, 12), 12, None);
    for (all, part) in one.iter().zip(&part) {
        assert!(all[12 * 16..18 * 16] == part[..6 * 16], "observations");
        assert!(all[300 * 16 + 12..300 * 16 + 18] == part[6 * 16..6 * 17], "rewards");
    }
}

#[test]
fn goals_are_those_that_a_reset_gives_and_later_ones_are_drawn() {
    let case = r#""n_worlds": 2, "max_episode_s": 0.2, "step_hz": 25"#;
    let goal = [[0.3, -0.2, 1.1], [0.0, 0.5, 0.9]];
    let built_in = flown(&mut Env::new(config(case)).unwrap(), 0, Some(&goal));
    let mut env = Env::with_batch_task(config(case), Box::new(AtOnce)).unwrap();
    assert!(built_in == flown(&mut env, 0, Some(&goal)));
    env.reset_to(Some(1), None, Some(&goal)).unwrap();
    let seen = |env: &mut Env, w: usize, k: usize| f64::from(env.observation()[16 * w + k]);
    for w in 0..2 {
        for k in 0..3 {
            let sum = seen(&mut env, w, k) + seen(&mut env, w, 13 + k);
            assert!((sum - goal[w][k]).abs() < 1e-6, "world {w}, {k}: {sum}");
        }
    }
    // Rows of worlds that are left alone are not looked at.
    env.reset_to(None, Some(&[true, false]), Some(&[goal[0], [f64::NAN; 3]])).unwrap();
    let refused =
        |env: &mut Env, goal: &[[f64; 3]]| env.reset_to(None, None, Some(goal)).unwrap_err().to_string();
    assert!(refused(&mut env, &[goal[0]]).contains("goal: expected 6 numbers"));
    assert!(refused(&mut env, &[goal[0], [f64::NAN; 3]]).contains("goal of world 1, drone 0"));
    let mut env = Env::new(config(r#""task": {"kind": "reach_vel"}"#)).unwrap();
    env.reset_to(Some(0), None, Some(&[[0.5, 0.0, 0.0]])).unwrap();
    let mut env = Env::new(config(r#""task": {"kind": "trajectory"}"#)).unwrap();
    assert!(refused(&mut env, &[[0.0; 3]]).contains("the task trajectory takes no goals"));
}

const BALL: &str = "<mujoco><worldbody><geom type='plane' size='0 0 1'/>\
    <body name='ball' mocap='true' pos='0 9 1'><geom type='sphere' size='0.15'/></body></worldbody></mujoco>";

/// A ball comes along y at 2 m/s and is at the drone after one second.
struct Ball {
    places: bool,
}

fn ball_y(time_s: f64) -> f64 {
    2.0 - 2.0 * time_s
}

impl Task for Ball {
    fn channels(&self) -> Vec<Channel> {
        Vec::new()
    }

    fn scene(&self) -> (SceneConfig, Option<usize>) {
        (SceneConfig::Xml(BALL.into()), None)
    }

    fn begin(&self, start: &mut EpisodeStart) -> Result<(), EnvError> {
        start.starts[0] = Start::at([0.0, 0.0, 1.0]);
        Ok(())
    }

    fn move_obstacles(&self, _: &mut [f32], time_s: f64, obstacles: &mut Obstacles) {
        obstacles.pos_m[0] = [0.0, ball_y(time_s), 1.0];
    }

    fn judge(&self, view: &WorldView, _: &mut [f32], _: &mut [f32]) -> Outcome {
        if view.drones[0].crashed { Outcome::Crashed } else { Outcome::Continue }
    }

    fn observe(&self, _: &WorldView, _: &[f32], _: usize, _: &mut [f32]) {}
}

impl BatchTask for Ball {
    fn channels(&self) -> Vec<Channel> {
        Vec::new()
    }

    fn scene(&self) -> (SceneConfig, Option<usize>) {
        (SceneConfig::Xml(BALL.into()), None)
    }

    fn start_place(&self) -> Option<FreePlace> {
        let space_m = [[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]];
        self.places.then_some(FreePlace { space_m, clearance_m: 0.3 })
    }

    fn on_reset(&mut self, _: &mut Batch, obstacles: &mut BatchObstacles) -> Result<(), EnvError> {
        assert!(obstacles.n_obstacles == 1 && obstacles.pos_m[1] > 1.0);
        Ok(())
    }

    fn before_step(&mut self, batch: &mut Batch, obstacles: &mut BatchObstacles) -> Result<(), EnvError> {
        for w in 0..batch.n_worlds {
            obstacles.pos_m[3 * w + 1] = ball_y((batch.step[w] + 1) as f64 * batch.step_s);
        }
        Ok(())
    }

    fn judge(&mut self, batch: &mut Batch) -> Result<(), EnvError> {
        for w in (0..batch.n_worlds).filter(|w| batch.crashed[*w]).collect::<Vec<_>>() {
            batch.end(w, Outcome::Crashed);
        }
        Ok(())
    }

    fn observe(&mut self, _: &mut Batch) -> Result<(), EnvError> {
        Ok(())
    }
}

#[test]
fn a_moving_obstacle_hits_when_it_comes_and_stands_where_the_scene_has_it_after_a_reset() {
    let json = r#""n_worlds": 2, "step_hz": 20, "autoreset": "disabled""#;
    let ends = |env: &mut Env| {
        env.reset(Some(1), None).unwrap();
        assert!(env.clearance().iter().all(|c| *c > 0.5));
        let mut steps = 0;
        while env.ending()[0] == 0 {
            steps += 1;
            env.step(&[0.0; 8]).unwrap();
            assert!(steps < 40, "the ball never came");
        }
        assert_eq!(env.ending(), [Ending::Crashed as u8; 2]);
        steps
    };
    let mut one = Env::with_task(config(json), Arc::new(Ball { places: true })).unwrap();
    let mut all = Env::with_batch_task(config(json), Box::new(Ball { places: true })).unwrap();
    // The ball of 15 cm meets the shell of 5 to 10 cm when its middle is 20 to 25 cm away.
    let steps = ends(&mut one);
    assert!((17..20).contains(&steps), "{steps}");
    assert_eq!(ends(&mut all), steps);
    assert_eq!(ends(&mut all), steps, "again after a reset");
}

#[test]
fn what_a_task_leaves_out_is_refused_with_the_place_and_the_remedy() {
    let said = |result: Result<Env, EnvError>| result.err().unwrap().to_string();
    let mut env = Env::with_batch_task(config(""), Box::new(Ball { places: false })).unwrap();
    let error = env.reset(Some(1), None).unwrap_err().to_string();
    assert!(error.contains("start_pos of world 0, drone 0") && error.contains("start_space"), "{error}");
    let error = env.step(&[0.0; 4]).unwrap_err().to_string();
    assert!(error.contains("a reset of all worlds first"), "{error}");

    struct Named(&'static str, usize);
    impl Task for Named {
        fn channels(&self) -> Vec<Channel> {
            vec![Channel::new(self.0, self.1)]
        }
        fn begin(&self, start: &mut EpisodeStart) -> Result<(), EnvError> {
            start.starts[0] = Start::at([0.0, 0.0, 1.0]);
            Ok(())
        }
        fn judge(&self, view: &WorldView, _: &mut [f32], reward: &mut [f32]) -> Outcome {
            reward[0] = if view.time_s > 0.05 { f32::NAN } else { 0.0 };
            Outcome::Continue
        }
        fn observe(&self, _: &WorldView, _: &[f32], _: usize, _: &mut [f32]) {}
    }
    let named = |name, width| Env::with_task(config(""), Arc::new(Named(name, width)));
    assert!(said(named("pos", 3)).contains("channels of the task"));
    assert!(said(named("", 3)).contains("channels of the task"));
    assert!(said(named("x", 0)).contains("width of the channel x"));
    let mut env = named("x", 2).unwrap();
    env.reset(Some(1), None).unwrap();
    let error = (0..4).find_map(|_| env.step(&[0.0; 4]).err()).unwrap().to_string();
    assert!(error.contains("reward of world 0, drone 0") && error.contains("NaN"), "{error}");
    let kind = config(r#""task": {"kind": "own", "name": "dodge"}"#);
    assert!(said(Env::new(kind)).contains("reach_pos"));
}

#[test]
fn the_table_of_built_in_tasks_names_every_kind() {
    for task in TaskConfig::built_in() {
        let json = format!(r#""task": {{"kind": "{}"}}"#, task.name);
        let read = serde_json::to_value(config(&json).task).unwrap();
        assert_eq!(read["kind"], task.name);
        let title: String = task.name.split('_').map(|part| part[..1].to_uppercase() + &part[1..]).collect();
        assert_eq!(task.title, title);
    }
}
