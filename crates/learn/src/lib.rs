//! Policies that are trained by the gradients of their flights ([`train`]), or by what they cost ([`ppo`]).
//!
//! Backpropagation through time: a small network commands many worlds at once, in the lanes in which they fly, and the exact gradient of what the
//! flights cost goes back through motion, effects, on-board controllers and network in one sweep ([`propwash_rollout::pilot`]). What a policy shall
//! do is a [`Goal`]: what it observes and what a step costs, written once over any number type. Proximal policy optimisation trains the same policies for the same goals.
//!
//! ```
//! use propwash_learn::{Actions, Options, goals::Track, train};
//! use propwash_vehicle::Vehicle;
//!
//! let vehicle = Vehicle::builtin("cf21B_500")?;
//! let of = (&vehicle, "first_principles");
//! let actions = Actions::attitude(&vehicle.drone(of.1)?);
//! // A figure of eight in 10 s, learnt in 100,000 commands.
//! let trained = train(&Track::default(), of, &actions, &Options::default())?;
//! // 20 flights from starts that it has not seen; errors count from the third second on.
//! let flown = trained.policy.fly(&Track::default(), of, (20, 2.0, 7))?;
//! assert!(flown.lost == 0 && flown.off_rms_m < 0.0087);
//! # Ok::<(), propwash_learn::LearnError>(())
//! ```

#![forbid(unsafe_code)]

mod adam;
mod batch;
mod bptt;
mod check;
mod episodes;
mod goal;
pub mod goals;
mod network;
mod policy;
pub mod ppo;
pub mod sampling;
mod sighted;
mod traced;
mod value;

pub use bptt::{Critic, Curve, Options, Trained, train};
pub use goal::{Actions, Goal, Outcome, Seen};
pub use network::Network;
pub use policy::{Flown, Policy};
pub use sighted::{Around, Near, Other, SightedGoal, Surroundings, train_sighted};

/// What is wrong with a training.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LearnError {
    /// The simulation refuses it.
    #[error(transparent)]
    Rollout(#[from] propwash_rollout::RolloutError),
    /// The vehicle refuses it.
    #[error(transparent)]
    Vehicle(#[from] propwash_vehicle::VehicleError),
    /// The surroundings of a training cannot be used.
    #[error("surroundings: {what}")]
    Surroundings {
        /// Why.
        what: String,
    },
    /// A goal that is written down makes no sense.
    #[error("goal: {what}")]
    Goal {
        /// Why.
        what: String,
    },
    /// An option makes no sense.
    #[error("training option {name}: expected {expected}, got {got}")]
    Option {
        /// The option.
        name: &'static str,
        /// What it may be.
        expected: String,
        /// What it was.
        got: String,
    },
}
