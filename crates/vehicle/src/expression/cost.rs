//! What a flight costs, as an expression: what samplers and rollouts add up.

use super::{ExpressionError, Sheet};
use propwash_trace::formula::Formula;

/// What a cost reads of a drone after a command, one number each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Read {
    /// A number of the state: position, attitude, velocity, angular velocity, rotor speeds, thrust.
    State(usize),
    /// Time, s.
    Time,
    /// 1 after the last command, else 0.
    Last,
    /// Distance to what a field holds, m.
    Distance,
    /// A number of the command.
    Command(usize),
    /// A number of the command before.
    Before(usize),
    /// A number that the caller gives.
    Given(usize),
}

/// A cost of one drone after each command of a flight, traced once.
///
/// Its expression reads `x y z qx qy qz qw vx vy vz wx wy wz rotor1 … thrust` (a state: m, m/s, rad/s, N; quaternion body to world), `t` (s), `last` (1 after the last command, else 0),
/// `distance` (m, with a field), `command1 …` (in the units of the control mode), `before1 …` (the command before; first the one in force when the flight began), and what is given, by name.
#[derive(Clone, Debug)]
pub struct Cost {
    formula: Formula,
    reads: Vec<(usize, Read)>,
    sizes: (usize, usize),
    n_given: usize,
}

impl Cost {
    /// From expressions: values with names, in order, and the cost. `given` names further numbers.
    ///
    /// # Errors
    /// [`ExpressionError`] for what is no expression.
    pub fn new(
        (lets, cost): (&[(String, String)], &str),
        given: &[String],
        (n_rotors, command_width): (usize, usize),
    ) -> Result<Self, ExpressionError> {
        let state = ["x", "y", "z", "qx", "qy", "qz", "qw", "vx", "vy", "vz", "wx", "wy", "wz"];
        let mut names: Vec<String> = state.iter().map(ToString::to_string).collect();
        names.extend((1..=n_rotors).map(|k| format!("rotor{k}")));
        names.push("thrust".into());
        let mut all: Vec<Read> = (0..names.len()).map(Read::State).collect();
        names.extend(["t", "last", "distance"].map(String::from));
        all.extend([Read::Time, Read::Last, Read::Distance]);
        names.extend((1..=command_width).map(|k| format!("command{k}")));
        all.extend((0..command_width).map(Read::Command));
        names.extend((1..=command_width).map(|k| format!("before{k}")));
        all.extend((0..command_width).map(Read::Before));
        names.extend(given.iter().cloned());
        all.extend((0..given.len()).map(Read::Given));
        let mut sheet = Sheet::over(names);
        for (name, text) in lets {
            sheet.add(name, text)?;
        }
        let program = sheet.program(cost)?;
        let formula = Formula::new(all.len(), |v| vec![Sheet::value(&program, &sheet.numbers(v.to_vec()))]);
        let reads = formula.reads().into_iter().map(|i| (i, all[i])).collect();
        Ok(Self { formula, reads, sizes: (n_rotors, command_width), n_given: given.len() })
    }

    /// The formula.
    pub fn formula(&self) -> &Formula {
        &self.formula
    }

    /// The inputs of the formula that it reads, and what they are.
    pub fn reads(&self) -> &[(usize, Read)] {
        &self.reads
    }

    /// Numbers of rotors and of a command for which it was made.
    pub fn sizes(&self) -> (usize, usize) {
        self.sizes
    }

    /// Numbers that are given.
    pub fn n_given(&self) -> usize {
        self.n_given
    }

    /// Whether it reads distances, and so needs a field.
    pub fn reads_distance(&self) -> bool {
        self.reads.iter().any(|(_, read)| *read == Read::Distance)
    }
}
