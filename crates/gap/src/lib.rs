//! The gap finder: compares a vehicle's model with measured flights, finds missing effects, and measures the completed
//! model.

#![forbid(unsafe_code)]

pub mod accept;
pub mod attitude_model;
mod battery;
mod cable;
mod causes;
pub mod compare;
pub mod complete;
mod constants;
mod cross_check;
pub mod decide;
pub mod diagnose;
pub(crate) mod disturbance;
pub mod drift;
mod drive_slopes;
mod error;
pub mod excite;
pub mod first_flight;
mod first_look;
mod fit;
pub mod fitted;
pub mod formula;
pub(crate) mod free_form;
pub mod ghost;
mod gust_line;
pub mod headline;
mod inputs;
mod integration;
mod judge;
pub mod ladder;
mod lean;
mod limits;
pub mod live;
pub(crate) mod model;
pub mod moments;
pub mod network;
mod noise;
mod opinion;
pub mod overlay;
mod per_log;
pub mod policy;
pub(crate) mod replay;
pub mod report;
pub(crate) mod residual;
pub(crate) mod search;
mod sensor_regression;
pub mod session;
pub(crate) mod shapes;
mod slow_errors;
mod solve;
mod speak;
mod starts;
mod stated;
pub mod throttle;
pub mod track;
mod unseen;
mod usable;
pub mod verdict;
mod walk;
pub mod watch;
mod wiring;
pub(crate) mod witness;

pub use causes::{Cause, Response};
pub use compare::{Comparison, compare};
pub use error::{Error, GapError, Result};
pub use track::{Drive, Options, StatedNoise, Track};
pub use verdict::Diagnosis;

#[cfg(test)]
mod tests;
