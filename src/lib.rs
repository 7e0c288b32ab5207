//! Propwash: a drone simulator that senses and collides in MuJoCo scenes, and that finds the physics it is missing.
//!
//! ```
//! use propwash::prelude::*;
//!
//! // Four worlds of one Crazyflie each, in a forest.
//! let mut arena: Arena<f32> =
//!     Arena::builder().scene("xml/forest.xml").drone("cf2x_L250").worlds(4).build()?;
//! // Fly: go to a place, one second at 500 Hz.
//! arena.set_command(&Reference::hover([0.5, 0.0, 1.2], 0.0).command().repeat(4))?;
//! arena.step(500)?;
//! // Touch: how far is the nearest thing from the drone of each world?
//! let mut clearances = Vec::new();
//! arena.clearances(None, 5.0, &mut clearances)?;
//! assert!(clearances.iter().all(|c| c.distance_m > 0.0));
//! // See: what does the camera of its shell show in world 0?
//! let camera = Camera::on_drone(arena.scene(0).unwrap(), 0, "fpv")?;
//! let mut frame = DepthFrame::new();
//! camera.render(&mut *arena.look().world(0)?, &mut frame)?;
//! assert_eq!(frame.depth_m.len(), 64 * 64);
//! # Ok::<(), propwash::Error>(())
//! ```
//!
//! | to | begin with |
//! | --- | --- |
//! | fly, see and touch | [`arena::Arena`], by [`arena::Builder`] or a [`arena::SimConfig`] |
//! | fly without a scene | [`rollout::Sim`] |
//! | learn | [`env::Env`], [`env::EnvConfig`]; by gradients [`learn::train`] |
//! | record data sets | [`dataset::recorder`] for patterns, [`dataset::Recorder`] for a loop of your own |
//! | read data sets | [`dataset::Dataset`] |
//! | find what a model lacks | [`flight::FlightLog`], [`mod@gap::compare`], [`mod@gap::diagnose`], [`gap::accept`] |
//! | let PX4, ArduPilot or Betaflight fly | [`sitl::Server`] |
//! | describe a vehicle | [`vehicle::Vehicle`] |
//! | add an effect, a sensor or a task | [`physics::effects::register`], [`sense::Sensor`], [`env::Task`] |
//!
//! The modules in the order in which data flows; this list is the map of the library. Those that are exported from crates of
//! their own need no MuJoCo; `docs/architecture.md` says which uses which.
//!
//! ```text
//! vehicle + command → physics → rollout → scene (over geometry) → sense → arena → dataset | env
//! flight → gap → vehicle
//! ```

pub mod error;

// What a number is, and what is built of numbers.
pub use propwash_trace as scalar;
pub use propwash_trace::{export, math, names, units};

// The equations, and what they are given and move.
pub use propwash_physics as physics;
pub use propwash_physics::parameters;
pub use propwash_vehicle as vehicle;
// Generated straight-line code of the commonest steps.
pub use propwash_kernels as kernels;
pub use propwash_rollout as rollout;
// The C compiler of the machine, for steps without a kernel.
pub use propwash_compile as compile;
pub use propwash_rollout::random;
// Policies trained by the gradients of their flights.
pub use propwash_learn as learn;

// Shapes, and what rays meet, what is near and what touches, without MuJoCo.
pub use propwash_geometry as geometry;

pub mod scene;
pub mod sense;

// Flying, seeing and touching as one thing.
pub mod arena;

// Logs of real flights, and the gap finder that compares models with them.
pub use propwash_flight as flight;
pub use propwash_gap as gap;

pub mod dataset;
pub mod env;

// Flight stacks in the loop: what they and a simulation tell each other, and the servers.
pub use propwash_autopilot as autopilot;
pub mod sitl;

// Pages that show flights in a browser.
pub use propwash_page as page;
#[cfg(feature = "lab")]
pub mod lab;
// Pictures: drawing, and PNG in and out.
pub use propwash_picture as picture;
pub mod view;

pub mod cli;

pub use error::{Error, Result};

/// What most programs use.
pub mod prelude {
    pub use crate::arena::{Arena, CameraConfig, DroneConfig, SceneConfig, SensorConfig, SimConfig};
    pub use crate::dataset::{Dataset, Recorder};
    pub use crate::env::{Env, EnvConfig};
    pub use crate::physics::controllers::ControlMode;
    pub use crate::physics::integrate::Integrator;
    pub use crate::physics::rigid_body::State;
    pub use crate::rollout::trajectory::Reference;
    pub use crate::rollout::{Sim, SimOptions};
    pub use crate::scene::{Pose, Scene, SceneSource, Shell};
    pub use crate::sense::{Camera, DepthFrame};
    pub use crate::vehicle::Vehicle;
    pub use crate::{Error, Result};
}

/// Compiles and runs the example of the README.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct ReadmeDoctests;

/// Compiles and runs the example in Rust of the page on learning environments.
#[cfg(doctest)]
#[doc = include_str!("../docs/environments.md")]
pub struct EnvironmentsDoctests;
