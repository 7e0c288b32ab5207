//! Shapes as data. What is asked of them stands in `ray` and `distance`.

pub(crate) mod bvh;
pub(crate) mod hfield;
pub(crate) mod hull;
pub(crate) mod mesh;
pub(crate) mod round;
pub(crate) mod surface;
