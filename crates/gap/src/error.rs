//! Errors of comparing models with measurements.

use crate::accept::AcceptError;
use propwash_flight::FlightError;
use propwash_trace::names::of_list;
use propwash_vehicle::VehicleError;

/// What can go wrong on the way from files of flights to a completed vehicle: an error of one of its steps.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The vehicle's file is wrong.
    #[error(transparent)]
    Vehicle(#[from] VehicleError),
    /// A flight log could not be read, or cannot be right.
    #[error(transparent)]
    Flight(#[from] FlightError),
    /// Comparing the model with the flights.
    #[error(transparent)]
    Gap(#[from] GapError),
    /// A fitted effect could not be written into the vehicle's file.
    #[error(transparent)]
    Accept(#[from] AcceptError),
}

/// Result with [`enum@Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Errors of comparing, diagnosing and fitting. Each says what was expected, what was found, and what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GapError {
    /// A log lacks what the analysis needs.
    #[error("{log}: expected {expected}, found {found}: {remedy}")]
    Log {
        /// Name of the log.
        log: String,
        /// What is needed.
        expected: String,
        /// What is there.
        found: String,
        /// What to do.
        remedy: String,
    },
    /// Too little of a log can be used.
    #[error("{log}: expected {expected}, found {found}: {remedy}")]
    TooShort {
        /// Name of the log.
        log: String,
        /// What is needed.
        expected: String,
        /// What is there.
        found: String,
        /// What to do.
        remedy: String,
    },
    /// An unknown name.
    #[error("`{name}` is no {what}; there are {known}{}", of_list(name, known))]
    Unknown {
        /// The requested name.
        name: String,
        /// Kind of thing it should name: `candidate`, `manoeuvre` …
        what: &'static str,
        /// The known names.
        known: String,
    },
    /// Logs that cannot belong to one vehicle.
    #[error("{first} and {second} cannot be flights of one vehicle: {reason}; give them one by one")]
    DifferentVehicles {
        /// Name of the first log.
        first: String,
        /// Name of the other.
        second: String,
        /// The difference between them.
        reason: String,
    },
    /// An own expression is wrong.
    #[error("column {column} of `{text}`: expected {expected}, found {found}")]
    Expression {
        /// As typed.
        text: String,
        /// Where it is wrong, in characters from 1.
        column: usize,
        /// What would be right.
        expected: String,
        /// What stands there.
        found: String,
    },
    /// The work was ended at the caller's wish.
    #[error("cancelled: everything is as it was before")]
    Cancelled,
    /// The numerical problem cannot be solved.
    #[error("{what} cannot be computed: {reason}")]
    Numbers {
        /// What was to be computed.
        what: &'static str,
        /// Why not.
        reason: String,
    },
}
