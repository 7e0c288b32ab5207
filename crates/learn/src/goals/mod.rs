//! Goals that come with the crate.

pub mod cross;
pub mod gates;
pub mod land;
pub mod reach;
pub mod recover;
pub mod swap;
pub mod track;
pub mod written;

pub use cross::Cross;
pub use gates::{Gate, Gates};
pub use land::Land;
pub use reach::Reach;
pub use recover::Recover;
pub use swap::Swap;
pub use track::Track;
pub use written::Written;
