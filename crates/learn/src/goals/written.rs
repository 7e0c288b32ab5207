//! A goal that is written down as expressions: what a Python class of the user becomes (`propwash.learn.Goal`).

use crate::LearnError;
use crate::goal::{Goal, Outcome, Seen};
use propwash_physics::rigid_body::State;
use propwash_rollout::random::Stream;
use propwash_trace::Real;
use propwash_trace::math::quat;
use propwash_trace::program::Program;
use propwash_vehicle::expression::{ExpressionError, Sheet};

/// Names of the numbers of a state and of the time, in the order in which expressions may read them.
pub const STATE: [&str; 14] =
    ["x", "y", "z", "qx", "qy", "qz", "qw", "vx", "vy", "vz", "wx", "wy", "wz", "t"];

/// Most numbers of an action.
pub const MAX_ACTIONS: usize = 8;

/// A number that an episode remembers.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Remembered {
    /// Its name in expressions.
    pub name: String,
    /// It is drawn between these at an episode's start.
    pub between: [f64; 2],
    /// What it is after each command, by what is seen then; empty where it stays.
    pub next: String,
}

/// What is written down. Expressions read [`STATE`] (m, m/s, rad/s, s; quaternion body to world), what is remembered, `action1` … and `before1` … (the action of a step
/// and the one before, −1 to 1; in the cost), and named values before them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Texts {
    /// Values with names, in order.
    pub lets: Vec<(String, String)>,
    /// What the policy sees, each number of about size 1.
    pub observe: Vec<String>,
    /// What a step costs, seen at its end.
    pub cost: String,
    /// How far off it is, m.
    pub off_m: String,
    /// Not 0 where a flight that ends here has done what it should.
    pub reached: String,
    /// Not 0 where an episode is over and nothing is left to do; empty: never.
    pub done: String,
    /// Not 0 where it failed; empty: never.
    pub lost: String,
    /// What episodes remember.
    pub memory: Vec<Remembered>,
}

/// Where episodes begin: each number is drawn between two.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Starts {
    /// Position, m.
    pub pos_m: [[f64; 2]; 3],
    /// Velocity, m/s, world.
    pub vel_m_s: [[f64; 2]; 3],
    /// Angular velocity, rad/s, body.
    pub ang_vel_rad_s: [[f64; 2]; 3],
    /// Attitude as a rotation vector, rad.
    pub turn_rad: [[f64; 2]; 3],
    /// Time, s.
    pub time_s: [f64; 2],
}

impl Default for Starts {
    /// At rest at the origin.
    fn default() -> Self {
        let still = [[0.0; 2]; 3];
        Self { pos_m: still, vel_m_s: still, ang_vel_rad_s: still, turn_rad: still, time_s: [0.0; 2] }
    }
}

impl Starts {
    /// Refuses bounds that are not finite or not in order.
    ///
    /// # Errors
    /// [`LearnError::Goal`].
    pub fn check(&self) -> Result<(), LearnError> {
        let Self { pos_m, vel_m_s, ang_vel_rad_s, turn_rad, time_s } = self;
        let drawn = [pos_m, vel_m_s, ang_vel_rad_s, turn_rad].into_iter().flatten().chain([time_s]);
        drawn.copied().try_for_each(check_bounds)
    }
}

/// Refuses bounds of what is drawn that are not finite or not in order.
///
/// # Errors
/// [`LearnError::Goal`].
pub fn check_bounds([low, high]: [f64; 2]) -> Result<(), LearnError> {
    if low.is_finite() && high.is_finite() && low <= high {
        return Ok(());
    }
    let what = format!("expected finite bounds in order of what is drawn, got {low} to {high}");
    Err(LearnError::Goal { what })
}

/// What is wrong with an expression of a goal, by name.
fn wrong(what: &str) -> impl Fn(ExpressionError) -> LearnError {
    move |e| LearnError::Goal { what: format!("{what}: {e}") }
}

/// A goal of expressions.
#[derive(Clone, Debug)]
pub struct Written {
    sheet: Sheet,
    observe: Vec<Program>,
    cost: Program,
    off_m: Program,
    reached: Program,
    done: Option<Program>,
    lost: Option<Program>,
    next: Vec<Option<Program>>,
    between: Vec<[f64; 2]>,
    starts: Starts,
    episode_s: f64,
    far_off_m: f64,
    lost_cost: f64,
}

impl Written {
    /// From what is written down; `far_off_m`: a flight farther off than this is lost. `lost_cost`: what that costs learners that see costs alone.
    ///
    /// # Errors
    /// [`LearnError::Goal`] for what is no expression, for no observation, and for numbers that make no sense.
    pub fn new(
        texts: &Texts,
        starts: Starts,
        (episode_s, far_off_m, lost_cost): (f64, f64, f64),
    ) -> Result<Self, LearnError> {
        let refused = |what: String| Err(LearnError::Goal { what });
        let mut names: Vec<String> = STATE.iter().map(ToString::to_string).collect();
        names.extend(texts.memory.iter().map(|m| m.name.clone()));
        for of in ["action", "before"] {
            names.extend((1..=MAX_ACTIONS).map(|k| format!("{of}{k}")));
        }
        let mut sheet = Sheet::over(names);
        texts.lets.iter().try_for_each(|(name, text)| sheet.add(name, text).map_err(wrong(name)))?;
        let one = |what: &str, text: &str| sheet.program(text).map_err(wrong(what));
        let maybe =
            |what: &str, text: &str| if text.is_empty() { Ok(None) } else { one(what, text).map(Some) };
        if texts.observe.is_empty() {
            return refused("observe: expected at least one number, got none".into());
        }
        for (name, value, zero) in
            [("time", episode_s, false), ("far", far_off_m, false), ("lost_cost", lost_cost, true)]
        {
            if !(value.is_finite() && (value > 0.0 || zero && value == 0.0)) {
                return refused(format!("{name}: expected a finite number above 0, got {value}"));
            }
        }
        starts.check()?;
        texts.memory.iter().try_for_each(|m| check_bounds(m.between))?;
        Ok(Self {
            observe: texts.observe.iter().map(|text| one("observe", text)).collect::<Result<_, _>>()?,
            cost: one("cost", &texts.cost)?,
            off_m: one("off", &texts.off_m)?,
            reached: one("reached", &texts.reached)?,
            done: maybe("done", &texts.done)?,
            lost: maybe("lost", &texts.lost)?,
            next: texts.memory.iter().map(|m| maybe(&m.name, &m.next)).collect::<Result<_, _>>()?,
            between: texts.memory.iter().map(|m| m.between).collect(),
            sheet,
            starts,
            episode_s,
            far_off_m,
            lost_cost,
        })
    }

    /// All numbers that expressions may read.
    fn numbers<S: Real>(&self, seen: &Seen<S>, action: &[S], before: &[S]) -> Vec<S> {
        let Seen { pos_m, quat_xyzw, vel_m_s, ang_vel_rad_s, time_s, memory } = seen;
        let memory = &memory[..self.between.len()];
        let mut out = [&pos_m[..], quat_xyzw, vel_m_s, ang_vel_rad_s, &[*time_s], memory].concat();
        for list in [action, before] {
            out.extend((0..MAX_ACTIONS).map(|k| list.get(k).copied().unwrap_or(S::zero())));
        }
        self.sheet.numbers(out)
    }

    fn value<S: Real>(&self, program: &Program, seen: &Seen<S>) -> S {
        Sheet::value(program, &self.numbers(seen, &[], &[]))
    }

    fn says(&self, program: Option<&Program>, seen: &Seen<f64>) -> bool {
        program.is_some_and(|program| self.value(program, seen) != 0.0)
    }
}

impl Goal for Written {
    fn observations(&self) -> usize {
        self.observe.len()
    }

    fn observe<S: Real>(&self, seen: &Seen<S>, out: &mut Vec<S>) {
        let numbers = self.numbers(seen, &[], &[]);
        out.extend(self.observe.iter().map(|program| Sheet::value(program, &numbers)));
    }

    fn cost<S: Real>(&self, seen: &Seen<S>, action: &[S], before: &[S]) -> S {
        Sheet::value(&self.cost, &self.numbers(seen, action, before))
    }

    fn start(&self, random: &mut Stream, memory: &mut [f64]) -> (State<f64>, f64) {
        let mut draw = |[low, high]: [f64; 2]| random.uniform(low, high);
        memory.iter_mut().zip(&self.between).for_each(|(to, between)| *to = draw(*between));
        let state = State {
            pos: self.starts.pos_m.map(&mut draw),
            vel: self.starts.vel_m_s.map(&mut draw),
            ang_vel: self.starts.ang_vel_rad_s.map(&mut draw),
            quat: quat::exp(self.starts.turn_rad.map(&mut draw)),
            ..State::rest()
        };
        (state, draw(self.starts.time_s))
    }

    fn episode_s(&self) -> f64 {
        self.episode_s
    }

    fn off_m(&self, seen: &Seen<f64>) -> f64 {
        self.value(&self.off_m, seen)
    }

    fn reached(&self, seen: &Seen<f64>) -> bool {
        self.says(Some(&self.reached), seen)
    }

    fn far_off_m(&self) -> f64 {
        self.far_off_m
    }

    fn memory(&self) -> usize {
        // Episodes that remember nothing are not judged: one number more has those judged that may end before their time.
        self.between.len().max(usize::from(self.lost.is_some() || self.done.is_some()))
    }

    fn judge(&self, _: &Seen<f64>, after: &Seen<f64>, memory: &mut [f64]) -> Outcome {
        for (to, next) in memory.iter_mut().zip(&self.next) {
            if let Some(program) = next {
                *to = self.value(program, after);
            }
        }
        match (self.says(self.lost.as_ref(), after), self.says(self.done.as_ref(), after)) {
            (true, _) => Outcome::Lost,
            (_, true) => Outcome::Done,
            _ => Outcome::On,
        }
    }

    fn lost_cost(&self) -> f64 {
        self.lost_cost
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::goals::Reach;
    use crate::{Actions, Options, train};
    use propwash_rollout::random::{Key, purpose};
    use propwash_vehicle::Vehicle;

    /// [`Reach`], written down.
    fn reach() -> Texts {
        let axes = [("gx", "x"), ("gy", "y"), ("gz", "z")];
        let mut observe: Vec<String> = axes.iter().map(|(g, p)| format!("{g} - {p}")).collect();
        observe.extend(["vx", "vy", "vz"].map(|v| format!("0.5 * {v}")));
        observe.extend(["qx", "qy", "qz", "qw"].map(String::from));
        observe.extend(["wx", "wy", "wz"].map(|w| format!("0.3 * {w}")));
        let smooth: Vec<String> = (1..=4).map(|k| format!("0.02 * (action{k} - before{k})^2")).collect();
        let between = [[-1.5, 1.5], [-1.5, 1.5], [0.5, 2.5]];
        let memory = axes.iter().zip(between);
        Texts {
            lets: vec![("off".into(), "sqrt((gx - x)^2 + (gy - y)^2 + (gz - z)^2 + 0.01)".into())],
            observe,
            cost: format!(
                "2 * (off - 0.1) + 0.1 * (vx^2 + vy^2 + vz^2) + 0.005 * (wx^2 + wy^2 + wz^2) + {}",
                smooth.join(" + ")
            ),
            off_m: "sqrt((gx - x)^2 + (gy - y)^2 + (gz - z)^2)".into(),
            reached: "min(sqrt((gx - x)^2 + (gy - y)^2 + (gz - z)^2) < 0.05, sqrt(vx^2 + vy^2 + vz^2) < 0.1)"
                .into(),
            memory: memory
                .map(|((name, _), between)| Remembered { name: (*name).into(), between, next: String::new() })
                .collect(),
            ..Texts::default()
        }
    }

    fn starts() -> Starts {
        let pos_m = [[-1.5, 1.5], [-1.5, 1.5], [0.5, 2.5]];
        Starts { pos_m, vel_m_s: [[-1.0, 1.0]; 3], ..Starts::default() }
    }

    #[test]
    fn what_is_written_down_is_what_the_goal_in_rust_says() {
        let (written, own) =
            (Written::new(&reach(), starts(), (4.0, 10.0, 100.0)).unwrap(), Reach::default());
        let mut random = Key { seed: 1, world: 0, drone: 0, step: 0, purpose: purpose("test") }.stream();
        let mut memory = [0.0; 3];
        for _ in 0..50 {
            let (mut state, _) = own.start(&mut random, &mut memory);
            state.quat = quat::exp([random.normal(), 0.3, 0.1]);
            state.ang_vel = [0.4, random.normal(), -0.2];
            let numbers = [&state.pos[..], &state.quat, &state.vel, &state.ang_vel].concat();
            let seen = Seen::of(&numbers, 0.7, &memory);
            let (action, before) = ([0.1, -0.2, 0.3, random.normal()], [0.0, 0.4, -0.1, 0.2]);
            let (mut a, mut b) = (Vec::new(), Vec::new());
            written.observe(&seen, &mut a);
            own.observe(&seen, &mut b);
            assert!(
                a.len() == b.len() && a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-14),
                "{a:?} {b:?}"
            );
            let (a, b) = (written.cost(&seen, &action, &before), own.cost(&seen, &action, &before));
            assert!((a - b).abs() < 1e-12, "{a} {b}");
            assert!((written.off_m(&seen) - own.off_m(&seen)).abs() < 1e-14);
            assert_eq!(written.reached(&seen), own.reached(&seen));
        }
    }

    #[test]
    fn it_is_learnt_as_the_goal_in_rust_is() {
        let vehicle = Vehicle::builtin("cf21B_500").unwrap();
        let of = (&vehicle, "first_principles");
        let actions = Actions::attitude(&vehicle.drone(of.1).unwrap());
        let written = Written::new(&reach(), starts(), (4.0, 10.0, 100.0)).unwrap();
        let options = Options { commands: 200_000, rate: 0.01, ..Options::default() };
        let trained = train(&written, of, &actions, &options).unwrap();
        let flown = trained.policy.fly(&written, of, (50, 2.0, 7)).unwrap();
        assert!(flown.lost == 0 && flown.reached >= 48, "{flown:?}");
    }

    #[test]
    fn episodes_end_and_remember_as_their_expressions_say() {
        let texts = Texts {
            observe: vec!["z".into(), "count".into()],
            cost: "x^2".into(),
            off_m: "abs(x)".into(),
            reached: "count >= 2".into(),
            done: "count > 2.5".into(),
            lost: "z < 0".into(),
            memory: vec![Remembered {
                name: "count".into(),
                between: [0.0; 2],
                next: "where(x > 1, count + 1, count)".into(),
            }],
            ..Texts::default()
        };
        let goal = Written::new(&texts, Starts::default(), (4.0, 10.0, 100.0)).unwrap();
        let judged = |x: f64, z: f64, mut memory: [f64; 1]| {
            let mut state = [0.0; 13];
            (state[0], state[2], state[6]) = (x, z, 1.0);
            let before = memory;
            let seen = Seen::of(&state, 0.0, &before);
            (goal.judge(&seen, &seen, &mut memory), memory[0])
        };
        assert_eq!(judged(2.0, 1.0, [1.0]), (Outcome::On, 2.0));
        assert_eq!(judged(0.0, 1.0, [3.0]), (Outcome::Done, 3.0));
        assert_eq!(judged(2.0, -1.0, [3.0]), (Outcome::Lost, 4.0));
    }

    #[test]
    fn goals_that_remember_nothing_end_episodes_too() {
        let texts = Texts {
            observe: vec!["z".into()],
            cost: "x^2".into(),
            off_m: "abs(x)".into(),
            reached: "0".into(),
            lost: "z < 0.95".into(),
            ..Texts::default()
        };
        let goal = Written::new(&texts, Starts::default(), (4.0, 10.0, 100.0)).unwrap();
        let vehicle = Vehicle::builtin("cf21B_500").unwrap();
        let of = (&vehicle, "first_principles");
        let actions = Actions::attitude(&vehicle.drone(of.1).unwrap());
        let options = Options { commands: 2_000, ..Options::default() };
        // Every flight begins at height 0: it is lost with its first command.
        let trained = train(&goal, of, &actions, &options).unwrap();
        assert!(trained.lost >= options.worlds, "{}", trained.lost);
    }

    #[test]
    fn what_makes_no_sense_is_refused() {
        let of = |change: &dyn Fn(&mut Texts, &mut Starts, &mut f64)| {
            let (mut texts, mut starts, mut time) = (reach(), starts(), 4.0);
            change(&mut texts, &mut starts, &mut time);
            Written::new(&texts, starts, (time, 10.0, 100.0)).unwrap_err().to_string()
        };
        for (said, words) in [
            (of(&|t, _, _| t.observe.clear()), "observe: expected at least one number"),
            (of(&|t, _, _| t.cost = "x + gw".into()), "cost: column 5: expected"),
            (of(&|t, _, _| t.lets[0].1 = "off + 1".into()), "off: column 1"),
            (of(&|_, s, _| s.pos_m[1] = [1.0, -1.0]), "finite bounds in order"),
            (of(&|t, _, _| t.memory[0].between = [f64::NAN, 1.0]), "finite bounds in order"),
            (of(&|_, _, time| *time = 0.0), "time: expected a finite number above 0"),
        ] {
            assert!(said.contains(words), "{said} lacks {words}");
        }
    }
}
