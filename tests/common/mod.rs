//! What several test programs share.

pub mod crazyflow;
pub mod notes;
