//! What can be wrong with what a stack sends, and with what it is asked to fly.

/// Errors of messages and motor orders.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ProtocolError {
    /// A packet is not one of this protocol.
    #[error("{stack}: expected {expected}, got {got}")]
    Packet {
        /// The stack whose packet it should be.
        stack: &'static str,
        /// What it may be.
        expected: String,
        /// What it was.
        got: String,
    },
    /// The rotors of the vehicle are not in an order that the stack knows.
    #[error(
        "motors: {what}; say which rotor each motor of the stack drives, such as motors 0,2,3,1 (docs/sitl.md)"
    )]
    Motors {
        /// What does not fit.
        what: String,
    },
    /// A number that is no number of its kind.
    #[error("{name}: expected {expected}, got {got}")]
    Number {
        /// What it is about.
        name: &'static str,
        /// What it may be.
        expected: &'static str,
        /// What it was.
        got: String,
    },
}
