//! Prints traced equations as source code (Rust). No formula is written here: everything printed comes from a trace.

pub mod rust;
