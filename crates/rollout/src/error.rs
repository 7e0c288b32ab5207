//! Errors of building and running a simulation.

use propwash_compile::CompileError;

/// What is wrong with a simulation or with what it was asked to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RolloutError {
    /// A number in the options makes no sense.
    #[error("simulation option {name}: expected {expected}, got {got}")]
    Option {
        /// The option.
        name: &'static str,
        /// What it may be.
        expected: String,
        /// What it was.
        got: String,
    },
    /// The steps were to be compiled and cannot be.
    #[error("compiling the steps of the simulation: {0}")]
    Compile(CompileError),
    /// The control mode needs rotors, the dynamics have none.
    #[error(
        "drone {drone}: control mode {mode} commands rotors or torques, but its dynamics are the abstracted attitude \
         response; use control mode state or attitude, or dynamics first_principles"
    )]
    ModeNeedsRotors {
        /// Drone slot.
        drone: usize,
        /// The control mode.
        mode: &'static str,
    },
    /// An array has the wrong length.
    #[error("{name}: expected {expected} numbers ({shape}), got {got}")]
    Length {
        /// The array.
        name: &'static str,
        /// Numbers expected.
        expected: usize,
        /// Their shape in words.
        shape: String,
        /// Numbers given.
        got: usize,
    },
    /// A number is not finite.
    #[error(
        "{name} of world {world}, drone {drone}, entry {entry}: expected a finite number, got {got}; nothing was changed"
    )]
    NotFinite {
        /// The array.
        name: &'static str,
        /// World index.
        world: usize,
        /// Drone slot.
        drone: usize,
        /// Entry in the last axis.
        entry: usize,
        /// The number.
        got: f64,
    },
    /// No stage of that name.
    #[error("no stage named {name:?} in the pipeline; there are: {known}")]
    NoStage {
        /// The name asked for.
        name: String,
        /// The names that exist.
        known: String,
    },
    /// A stage of that name exists already.
    #[error("a stage named {name:?} exists already; replace it, or choose another name")]
    StageExists {
        /// The name.
        name: String,
    },
    /// A built-in stage cannot be replaced by a closure or taken out.
    #[error("stage {name:?} is built in and cannot be {action}; insert stages before or after it instead")]
    BuiltInStage {
        /// The name.
        name: String,
        /// What was tried.
        action: &'static str,
    },
    /// No parameter of that name.
    #[error("drone {drone} has no parameter {name:?}; close ones are: {close}")]
    NoParameter {
        /// Drone slot.
        drone: usize,
        /// The name asked for.
        name: String,
        /// Names like it.
        close: String,
    },
    /// A parameter is outside the bounds within which its formula holds.
    #[error("parameter {name} of drone {drone}: expected {expected}, got {got}")]
    Parameter {
        /// Drone slot.
        drone: usize,
        /// The parameter.
        name: String,
        /// What it may be.
        expected: String,
        /// What it is.
        got: f64,
    },
    /// No gradient.
    #[error("no gradient of {what}; {remedy}")]
    Gradient {
        /// Of what.
        what: String,
        /// What to do.
        remedy: String,
    },
    /// A randomisation file or rule is wrong.
    #[error("randomisation rule {rule}: {reason}")]
    Randomization {
        /// Which rule.
        rule: String,
        /// What is wrong and what to write instead.
        reason: String,
    },
    /// A trajectory is wrong.
    #[error("trajectory {name}: {reason}")]
    Trajectory {
        /// Which trajectory.
        name: String,
        /// What is wrong and what to write instead.
        reason: String,
    },
}
