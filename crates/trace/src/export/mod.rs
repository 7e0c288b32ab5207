//! Prints traced equations as source code. No formula is written here: everything printed comes from a trace.

pub mod c;
mod recorded;
pub mod rust;
pub mod text;
