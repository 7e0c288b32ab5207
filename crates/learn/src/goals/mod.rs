//! Goals that come with the crate.

pub mod recover;
pub mod track;

pub use recover::Recover;
pub use track::Track;
