//! What may be near: sets of geoms that a query looks through before it looks at shapes.

pub(crate) mod grid;
pub(crate) mod groups;
