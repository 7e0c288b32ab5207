//! What can go wrong when geometry is asked.

/// Errors of patterns of rays and of planes for what they meet.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GeometryError {
    /// Buffers have the wrong size.
    #[error("{what} must have {expected} numbers {shape}, got {found}")]
    Shape {
        /// Which array.
        what: &'static str,
        /// Its shape in words.
        shape: String,
        /// Numbers expected.
        expected: usize,
        /// Numbers found.
        found: usize,
    },
    /// What was asked makes no sense.
    #[error("{what}")]
    Parameter {
        /// What was expected, what was found, what to do.
        what: String,
    },
}
