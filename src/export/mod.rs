//! Traced equations in other languages. Nothing here is a formula: everything printed comes from a trace.

pub mod rust;
