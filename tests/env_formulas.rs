//! Tasks as formulas: for whole batches in lanes they give the numbers of one world at a time, and with derivatives those of
//! differences.

use std::sync::Arc;

use propwash::env::tasks::{Landing, ReachPos, ReachVel, Trajectory};
use propwash::env::{
    Channel, Ending, Env, EnvConfig, EnvError, EpisodeStart, Formulas, MAX_ACTIONS, Outcome, Seen, Start,
    Task, TaskTexts, TracedTask, Verdict, WorldView, WrittenTask, formulas,
};
use propwash::learn::goals::written::{Remembered, Starts};
use propwash::scalar::Real;
use propwash::scalar::bytecode::Interpret;
use propwash::scalar::dual::Dual;
use propwash::scalar::formula::{Formula, Registers};
use propwash::scalar::lanes::{F32x16, F64x8, Number};

/// Numbers that a drone is seen by, before those that the task remembers.
const SEEN: usize = 21 + 2 * MAX_ACTIONS;

/// What a task says of a drone that is seen by these numbers: reward, what ends it, channels.
fn said<S: Real, T: Task + Formulas>(task: &T, v: &[S]) -> Vec<S> {
    let three = |from: usize| core::array::from_fn(|k| v[from + k]);
    let seen = Seen {
        pos_m: three(0),
        quat_xyzw: core::array::from_fn(|k| v[3 + k]),
        vel_m_s: three(7),
        ang_vel_rad_s: three(10),
        previous_pos_m: three(13),
        clearance_m: v[16],
        crashed: v[17],
        action_change: v[18],
        action: core::array::from_fn(|k| v[21 + k]),
        action_before: core::array::from_fn(|k| v[21 + MAX_ACTIONS + k]),
        time_s: v[19],
        step_s: v[20],
    };
    let verdict = task.verdict(&seen, &v[SEEN..]);
    let flag = |mask| S::select(mask, S::one(), S::zero());
    let mut out = vec![verdict.reward, flag(verdict.crashed), flag(verdict.left), flag(verdict.done)];
    let mut channels = vec![S::zero(); task.channels().iter().map(|c| c.width).sum()];
    task.observation(&seen, &v[SEEN..], &mut channels);
    out.extend(channels);
    out
}

/// Numbers of drone `i`, in f32: a state near the goal, now and then a crash.
fn numbers(memory_len: usize, i: usize) -> Vec<f64> {
    let at = |k: usize| f64::from((0.7 * (1.3 * i as f64 + 2.1 * k as f64)).sin() as f32);
    let mut v: Vec<f64> = (0..SEEN + memory_len).map(at).collect();
    (v[2], v[17]) = (v[2] + 1.0, f64::from(u8::from(i % 5 == 3)));
    v[SEEN] = if i.is_multiple_of(2) { 0.0 } else { 1.0 };
    v
}

fn lanes_agree<C: Interpret, T: Task + Formulas>(task: &T, tolerance: f64) {
    let len = SEEN + task.memory_len(1);
    let formula = Formula::new(len, |v| said(task, v));
    let mut registers = Registers::<C>::new(&formula);
    for round in 0..4 {
        let of = |lane: usize| numbers(task.memory_len(1), lane + C::LANES * round);
        for k in 0..len {
            registers.input(k).fill(0, |lane| C::Number::of(of(lane)[k]));
        }
        registers.run(&formula);
        for lane in 0..C::LANES {
            for (k, wanted) in said(task, &of(lane)).into_iter().enumerate() {
                let got = registers.output(&formula, k).get(lane).wide();
                assert!((got - wanted).abs() <= tolerance, "{} {k}: {got}, not {wanted}", task.name());
            }
        }
    }
}

fn derivatives_agree<T: Task + Formulas>(task: &T) {
    const N: usize = 6;
    // By position and velocity.
    let places = [0, 1, 2, 7, 8, 9];
    let mut slopes = 0;
    for i in 0..10 {
        let v = numbers(task.memory_len(1), i);
        let mut duals: Vec<Dual<f64, N>> = v.iter().map(|x| Dual::lit(*x)).collect();
        for (n, place) in places.iter().enumerate() {
            duals[*place] = Dual::input(v[*place], n);
        }
        let exact = said(task, &duals);
        for (n, place) in places.iter().enumerate() {
            let at = |h: f64| {
                let mut near = v.clone();
                near[*place] += h;
                said(task, &near)
            };
            let (high, low) = (at(1e-6), at(-1e-6));
            for (k, exact) in exact.iter().enumerate() {
                let difference = (high[k] - low[k]) / 2e-6;
                let off = (exact.partials[n] - difference).abs();
                assert!(
                    off < 1e-8,
                    "{} {k} by {place}: {}, not {difference}",
                    task.name(),
                    exact.partials[n]
                );
                slopes += usize::from(difference != 0.0);
            }
        }
    }
    assert!(slopes > 50, "{}: only {slopes} slopes are not zero", task.name());
}

fn agree<T: Task + Formulas>(task: T) {
    lanes_agree::<F64x8, T>(&task, 1e-13);
    lanes_agree::<[[F64x8; 2]; 2], T>(&task, 1e-13);
    lanes_agree::<F32x16, T>(&task, 2e-6);
    derivatives_agree(&task);
}

#[test]
fn built_in_formulas_agree_in_lanes_and_with_derivatives() {
    agree(ReachPos::default());
    agree(ReachVel::default());
    agree(Landing::default());
    agree(Trajectory::default());
}

/// A task whose formulas nobody is told of: it is asked one world at a time.
struct OneByOne<T>(T);

impl<T: Task> Task for OneByOne<T> {
    fn channels(&self) -> Vec<Channel> {
        self.0.channels()
    }
    fn memory_len(&self, n_drones: usize) -> usize {
        self.0.memory_len(n_drones)
    }
    fn has_goal(&self) -> bool {
        self.0.has_goal()
    }
    fn begin(&self, start: &mut EpisodeStart) -> Result<(), EnvError> {
        self.0.begin(start)
    }
    fn judge(&self, view: &WorldView, memory: &mut [f32], reward: &mut [f32]) -> Outcome {
        self.0.judge(view, memory, reward)
    }
    fn observe(&self, view: &WorldView, memory: &[f32], drone: usize, out: &mut [f32]) {
        self.0.observe(view, memory, drone, out);
    }
}

/// Everything that a learner sees of some steps, and whether an episode ended by a crash.
fn flown(env: &mut Env, steps: usize) -> (Vec<Vec<f32>>, bool) {
    env.reset(Some(4), None).unwrap();
    let n = env.config().sim.options.n_worlds;
    let (mut out, mut crashed) = (Vec::new(), false);
    for step in 0..steps {
        let number = |i: usize| (0.61 * (i / 4 * 31 + i % 4 * 17 + step * 7) as f64).sin() as f32;
        // Some fall, and some fly away.
        let fall = |i: usize| if i % 12 == 3 { 0.8 } else { 0.0 };
        let action: Vec<f32> = (0..4 * n).map(|i| 0.8 * number(i) - fall(i)).collect();
        env.step(&action).unwrap();
        crashed |= env.ending().contains(&(Ending::Crashed as u8));
        let mut row = env.observation().to_vec();
        row.extend_from_slice(env.reward());
        row.extend(env.ending().iter().map(|e| f32::from(*e)));
        row.extend((0..n).map(|w| f32::from(u8::from(env.clipped(w)))));
        if !env.final_observation().is_empty() {
            let each = env.final_observation().len() / n;
            for w in (0..n).filter(|w| env.ending()[*w] != 0).collect::<Vec<_>>() {
                row.extend_from_slice(&env.final_observation()[w * each..(w + 1) * each]);
            }
        }
        out.push(row);
    }
    (out, crashed)
}

const CASES: [&str; 5] = [
    r#""n_worlds": 3, "step_hz": 25"#,
    r#""n_worlds": 45, "step_hz": 500, "max_episode_s": 0.05, "autoreset": "same_step", "action": {"kind": "velocity"}"#,
    r#""n_worlds": 301, "step_hz": 25, "max_episode_s": 0.6, "levels": {"action_delay_s": 0.05}"#,
    r#""n_worlds": 41, "step_hz": 25, "max_episode_s": 0.6, "autoreset": "same_step", "randomization": {"rule": [
       {"parameter": "env.pos_sigma_m", "draw": {"uniform": [0.0, 0.05]}},
       {"parameter": "env.action_delay_s", "draw": {"uniform": [0.0, 0.05]}}]}"#,
    r#""n_worlds": 5, "step_hz": 25, "max_episode_s": 1.0, "scene": {"each": [
       {"xml": "<mujoco><worldbody><geom type='box' pos='0 0 1' size='9 0.1 0.3'/></worldbody></mujoco>"},
       {"xml": "<mujoco><worldbody><geom type='box' size='9 9 0.3'/></worldbody></mujoco>"}]}"#,
];

fn config(json: &str) -> EnvConfig {
    EnvConfig::from_text(&format!("{{{json}}}")).unwrap()
}

/// Compares a task by formulas with the same one world at a time, in all cases.
fn same_in_all_cases<T: Task + Clone + 'static>(task: T, tolerance: f32) {
    let mut crashes = 0;
    for case in CASES {
        let mut many = Env::with_task(config(case), Arc::new(task.clone())).unwrap();
        let mut one = Env::with_task(config(case), Arc::new(OneByOne(task.clone()))).unwrap();
        let ((many, crashed), (one, _)) = (flown(&mut many, 60), flown(&mut one, 60));
        for (step, (a, b)) in many.iter().zip(&one).enumerate() {
            let near = a.iter().zip(b).all(|(a, b)| a == b || (a - b).abs() <= tolerance);
            assert!(near && a.len() == b.len(), "{case}: step {step}");
        }
        crashes += usize::from(crashed);
    }
    assert!(crashes >= 2, "episodes ended by a crash in {crashes} cases only");
}

#[test]
fn many_worlds_at_once_give_the_bits_of_one_world_at_a_time() {
    same_in_all_cases(ReachPos::default(), 0.0);
    same_in_all_cases(ReachVel::default(), 0.0);
    same_in_all_cases(Landing::default(), 0.0);
    same_in_all_cases(Trajectory::default(), 0.0);
}

/// A user's task that looks at everything that formulas see.
#[derive(Clone)]
struct Everything;

impl Formulas for Everything {
    fn verdict<S: Real>(&self, seen: &Seen<S>, memory: &[S]) -> Verdict<S> {
        let moved = seen.pos_m[0] - seen.previous_pos_m[0];
        let jump = seen.action[3] - seen.action_before[3];
        let reward = moved / seen.step_s + seen.action_change + jump * jump + seen.clearance_m * memory[1];
        Verdict {
            crashed: seen.crashed.gt(S::lit(0.5)),
            left: seen.pos_m[2].gt(S::lit(3.0)),
            done: seen.time_s.gt(S::lit(0.3)) & memory[1].gt(S::lit(0.5)),
            ..Verdict::going_on(reward)
        }
    }
    fn observation<S: Real>(&self, seen: &Seen<S>, _: &[S], out: &mut [S]) {
        out.copy_from_slice(&[seen.quat_xyzw[3] + seen.ang_vel_rad_s[1], seen.time_s]);
    }
}

impl Task for Everything {
    fn channels(&self) -> Vec<Channel> {
        vec![Channel::new("turned", 1), Channel::new("time", 1)]
    }
    fn memory_len(&self, _: usize) -> usize {
        2
    }
    fn begin(&self, start: &mut EpisodeStart) -> Result<(), EnvError> {
        start.starts[0] = Start::at([0.0, 0.5, 1.0]);
        start.memory[1] = start.draw.uniform(0.0, 1.0) as f32;
        Ok(())
    }
    fn judge(&self, view: &WorldView, memory: &mut [f32], reward: &mut [f32]) -> Outcome {
        formulas::judge(self, view, memory, reward)
    }
    fn observe(&self, view: &WorldView, memory: &[f32], drone: usize, out: &mut [f32]) {
        formulas::observe(self, view, memory, drone, out);
    }
    fn formulas(&self) -> Option<TracedTask> {
        Some(TracedTask::of(self))
    }
}

#[test]
fn a_users_formulas_see_everything_that_a_task_sees_of_a_drone() {
    // Clearances are f32 in arrays.
    same_in_all_cases(Everything, 1e-6);
}

/// What [`ReachPos`] says, written down; with `count`, beside, the steps that were near the goal are counted.
fn written(count: bool) -> WrittenTask {
    let off = "sqrt((gx - x)^2 + (gy - y)^2 + (gz - z)^2)";
    let near =
        |(name, between): (&str, [f64; 2])| Remembered { name: name.into(), between, next: String::new() };
    let mut memory: Vec<Remembered> =
        [("gx", [-1.0, 1.0]), ("gy", [-1.0, 1.0]), ("gz", [0.5, 1.5])].map(near).to_vec();
    let mut observe =
        vec![("difference_to_goal".to_string(), ["gx - x", "gy - y", "gz - z"].map(String::from).to_vec())];
    let mut texts = TaskTexts {
        name: "written".into(),
        lets: vec![("off".into(), off.into())],
        reward: "where(crashed, -1, exp(-2 * off))".into(),
        crash_ends: true,
        goal: Some(0),
        ..TaskTexts::default()
    };
    if count {
        let next = "where(off < 1.2, count + 1, count)".into();
        memory.push(Remembered { name: "count".into(), between: [0.0, 0.5], next });
        observe.push(("counted".into(), vec!["count".into(), "t".into()]));
        texts.reward = "0.1 * count + 0.01 * (action1 - before1)^2 - clearance + (x - px) / step".into();
        texts.done = "count > 8".into();
        texts.left = "z > 2.6".into();
    }
    let starts = Starts {
        pos_m: [[-1.0, 1.0], [-1.0, 1.0], [1.0, 2.0]],
        vel_m_s: [[-1.0, 1.0]; 3],
        time_s: if count { [1.0, 3.0] } else { [0.0; 2] },
        ..Starts::default()
    };
    WrittenTask::new(TaskTexts { observe, memory, ..texts }, starts).unwrap()
}

#[test]
fn a_task_that_is_written_down_gives_the_bits_of_the_one_in_rust() {
    for case in CASES {
        let mut built_in = Env::with_task(config(case), Arc::new(ReachPos::default())).unwrap();
        let mut own = Env::with_task(config(case), Arc::new(written(false))).unwrap();
        assert!(own.has_goal());
        assert_eq!(flown(&mut own, 60), flown(&mut built_in, 60), "{case}");
    }
    derivatives_agree(&written(false));
}

#[test]
fn what_a_task_remembers_changes_with_steps_alike_in_lanes_and_one_world_at_a_time() {
    // In lanes a channel shows what is remembered before it is rounded to f32.
    same_in_all_cases(written(true), 1e-5);
}

#[test]
fn starts_of_tasks_turn_and_spin() {
    let texts = TaskTexts {
        reward: "0".into(),
        observe: vec![("t".into(), vec!["t".into()])],
        ..TaskTexts::default()
    };
    let starts = Starts {
        turn_rad: [[0.3, 0.4], [0.0; 2], [0.0; 2]],
        ang_vel_rad_s: [[1.0, 2.0], [0.0; 2], [-3.0, -2.5]],
        time_s: [2.0, 2.0],
        ..Starts::default()
    };
    let mut env =
        Env::with_task(config(CASES[2]), Arc::new(WrittenTask::new(texts, starts).unwrap())).unwrap();
    env.reset(Some(1), None).unwrap();
    let each = env.observation().len() / 301;
    for row in env.observation().chunks_exact(each) {
        assert!(
            (0.149..0.2).contains(&row[3])
                && (1.0..2.0).contains(&row[10])
                && (-3.0..-2.5).contains(&row[12]),
            "{row:?}"
        );
        assert_eq!(row[13], 2.0);
    }
}

#[test]
fn tasks_that_make_no_sense_are_refused() {
    let of = |change: &dyn Fn(&mut TaskTexts)| {
        let mut texts = TaskTexts {
            name: "own".into(),
            reward: "x".into(),
            observe: vec![("o".into(), vec!["z".into()])],
            ..TaskTexts::default()
        };
        change(&mut texts);
        WrittenTask::new(texts, Starts::default()).unwrap_err().to_string()
    };
    for (said, words) in [
        (of(&|t| t.reward = "x +".into()), "reward: column"),
        (of(&|t| t.observe[0].1[0] = "height".into()), "o: column 1"),
        (of(&|t| t.goal = Some(0)), "expected three numbers that are remembered"),
        (
            of(&|t| t.memory.push(Remembered { name: "a".into(), between: [2.0, 1.0], next: String::new() })),
            "finite bounds in order",
        ),
    ] {
        assert!(said.contains(words), "{said} lacks {words}");
    }
    let texts = TaskTexts {
        reward: "0".into(),
        observe: vec![("a".into(), vec!["a".into()])],
        memory: vec![Remembered {
            name: "a".into(),
            between: [1.0; 2],
            next: "a * 1000000000000000000000".into(),
        }],
        ..TaskTexts::default()
    };
    let mut env = Env::with_task(
        config(CASES[0]),
        Arc::new(WrittenTask::new(texts, Starts { pos_m: [[1.0; 2]; 3], ..Starts::default() }).unwrap()),
    )
    .unwrap();
    env.reset(Some(1), None).unwrap();
    let outcomes: Vec<_> = (0..3).map(|_| env.step(&[0.0; 12]).map_err(|e| e.to_string())).collect();
    assert!(
        outcomes[0].is_ok() && outcomes[1].as_ref().is_err_and(|e| e.contains("what is remembered")),
        "{outcomes:?}"
    );
}
