//! Goals that come with the crate.

pub mod cross;
pub mod recover;
pub mod track;

pub use cross::Cross;
pub use recover::Recover;
pub use track::Track;
