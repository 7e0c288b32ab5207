//! What can go wrong between a flight stack and the simulation.

use std::path::PathBuf;

use crate::arena::ArenaError;
use crate::autopilot::ProtocolError;

/// Errors of a [`Server`](super::Server).
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SitlError {
    /// An option that makes no sense.
    #[error("{name}: expected {expected}, got {got}")]
    Option {
        /// The option.
        name: &'static str,
        /// What it may be.
        expected: String,
        /// What it was.
        got: String,
    },
    /// A port cannot be opened.
    #[error(
        "{protocol} {address}: the port cannot be opened: {source}; another simulator may have it: end that one, or give another port"
    )]
    Port {
        /// TCP or UDP.
        protocol: &'static str,
        /// Where.
        address: std::net::SocketAddr,
        /// What the system said.
        source: std::io::Error,
    },
    /// The connection failed.
    #[error("{peer}: the connection failed: {source}")]
    Connection {
        /// Who was at the other end.
        peer: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// The stack closed the connection.
    #[error("{stack} closed the connection at {time_s:.3} s of simulated time")]
    Closed {
        /// The stack.
        stack: &'static str,
        /// When, s.
        time_s: f64,
    },
    /// The stack said nothing for too long.
    #[error("{waited_for}: nothing came within {seconds} s; {remedy}")]
    Silent {
        /// What was waited for.
        waited_for: String,
        /// For how long, s.
        seconds: f64,
        /// What to do.
        remedy: String,
    },
    /// The user asked to end.
    #[error("interrupted")]
    Interrupted,
    /// The state became non-finite, or went too far.
    #[error(
        "the simulation was stopped at {time_s:.3} s: {reason}; check the rate, the commands and the numbers of the vehicle"
    )]
    Diverged {
        /// When, s.
        time_s: f64,
        /// What became of it.
        reason: String,
    },
    /// The record of the flight cannot be written.
    #[error("{}: {source}; check the path and the room on the disk", path.display())]
    Record {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A message or an order of motors.
    #[error(transparent)]
    Protocol(#[from] ProtocolError),
    /// The simulation.
    #[error(transparent)]
    Arena(Box<ArenaError>),
}

impl From<ArenaError> for SitlError {
    fn from(e: ArenaError) -> Self {
        Self::Arena(Box::new(e))
    }
}

impl SitlError {
    /// An option that makes no sense.
    pub(super) fn option(name: &'static str, expected: impl Into<String>, got: impl ToString) -> Self {
        Self::Option { name, expected: expected.into(), got: got.to_string() }
    }
}
