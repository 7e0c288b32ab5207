//! What a policy shall do: what it observes, what a step costs, where episodes begin.

use propwash_physics::controllers::ControlMode;
use propwash_physics::drone::Drone;
use propwash_physics::rigid_body::State;
use propwash_rollout::random::Stream;
use propwash_trace::Real;

/// What a goal sees of a world.
#[derive(Clone, Copy, Debug)]
pub struct Seen<'a, S> {
    /// Position, m, world.
    pub pos_m: [S; 3],
    /// Attitude x y z w, body to world.
    pub quat_xyzw: [S; 4],
    /// Velocity, m/s, world.
    pub vel_m_s: [S; 3],
    /// Angular velocity, rad/s, body.
    pub ang_vel_rad_s: [S; 3],
    /// Time since the beginning of what is to be flown, s.
    pub time_s: S,
    /// What the episode remembers ([`Goal::memory`]).
    pub memory: &'a [S],
}

impl<'a, S: Real> Seen<'a, S> {
    /// From the numbers of a state in order.
    pub fn of(state: &[S], time_s: S, memory: &'a [S]) -> Self {
        let at = |from: usize, i: usize| state[from + i];
        Self {
            pos_m: core::array::from_fn(|i| at(0, i)),
            quat_xyzw: core::array::from_fn(|i| at(3, i)),
            vel_m_s: core::array::from_fn(|i| at(7, i)),
            ang_vel_rad_s: core::array::from_fn(|i| at(10, i)),
            time_s,
            memory,
        }
    }
}

/// What actions, numbers of −1 to 1, mean as commands.
#[derive(Clone, Debug, PartialEq)]
pub struct Actions {
    /// How commands are meant.
    pub mode: ControlMode,
    /// The command of action zero.
    pub middle: Vec<f64>,
    /// What is added for action one.
    pub reach: Vec<f64>,
}

impl Actions {
    /// Roll and pitch of up to ± 0.6 rad, yaw of up to ± 0.2 rad, and thrust between 30 and 170 % of that of hover.
    pub fn attitude(drone: &Drone<f64>) -> Self {
        let hover = drone.hover_command();
        Self {
            mode: ControlMode::Attitude,
            middle: vec![0.0, 0.0, 0.0, hover],
            reach: vec![0.6, 0.6, 0.2, 0.7 * hover],
        }
    }

    /// Rotor speeds around those of hover, by up to ± 30 %.
    pub fn rotors(drone: &Drone<f64>) -> Self {
        let n = drone.airframe.n_rotors;
        let hover = drone.hover_rotor_vel()[..n].to_vec();
        let reach = hover.iter().map(|v| 0.3 * v).collect();
        Self { mode: ControlMode::RotorVel, middle: hover, reach }
    }

    /// Numbers of an action.
    pub fn len(&self) -> usize {
        self.middle.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.middle.is_empty()
    }

    /// The command that an action means.
    pub fn command<'a>(&'a self, action: &'a [f32]) -> impl Iterator<Item = f64> + 'a {
        self.middle.iter().zip(&self.reach).zip(action).map(|((m, r), a)| m + r * f64::from(*a))
    }
}

/// How an episode goes on after a command.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Outcome {
    /// It goes on.
    #[default]
    On,
    /// It is over, since there is nothing left to do: no further command costs anything.
    Done,
    /// It is over, since it failed: this costs [`Goal::lost_cost`].
    Lost,
}

/// What a policy shall do.
///
/// An episode can remember numbers, such as its target or which gate is next. They are drawn at its start and changed by [`Goal::judge`] between
/// commands; gradients take them as given.
pub trait Goal: Sync {
    /// Numbers of an observation.
    fn observations(&self) -> usize;

    /// Writes the observation, each number of about size 1.
    fn observe<S: Real>(&self, seen: &Seen<S>, out: &mut Vec<S>);

    /// What a step costs, seen at its end: the action of the step and the one before, each number of −1 to 1.
    fn cost<S: Real>(&self, seen: &Seen<S>, action: &[S], before: &[S]) -> S;

    /// Where an episode begins: the state (rotors are set to hover) and the time, s. Fills what it remembers, all zero so far.
    fn start(&self, random: &mut Stream, memory: &mut [f64]) -> (State<f64>, f64);

    /// Length of an episode, s.
    fn episode_s(&self) -> f64;

    /// How far off a flight is, m, in a state at a time: what evaluations report.
    fn off_m(&self, seen: &Seen<f64>) -> f64;

    /// Whether a flight that ends in this state has done what it should.
    fn reached(&self, seen: &Seen<f64>) -> bool;

    /// A flight farther off than this is lost: training begins a new episode, m.
    fn far_off_m(&self) -> f64;

    /// Numbers that an episode remembers. Episodes of goals without any are never judged: only their time and [`Goal::far_off_m`] end them.
    fn memory(&self) -> usize {
        0
    }

    /// Judges one command, by what was seen before and after it, and changes what the episode remembers; both show the memory as it was.
    fn judge(&self, _before: &Seen<f64>, _after: &Seen<f64>, _memory: &mut [f64]) -> Outcome {
        Outcome::On
    }

    /// What it costs to be lost, for learners that see costs alone.
    fn lost_cost(&self) -> f64 {
        100.0
    }
}
