//! Distances: of two shapes, of a point and a shape, and of a drone and all that is near.
//!
//! A mesh collides as its convex hull, a plane as a whole half space, a height field as the prisms below its triangles, whatever the
//! group and alpha; only geoms that can collide count.
//!
//! Geoms that no pose moves are in a tree of boxes made with the table; those of obstacles are in a small tree and drones in a grid, made
//! anew for other poses. Both give what may be nearer than the best so far, near ones first. Between two geoms, planes and balls have closed
//! forms; all other convex pairs are followed by the algorithm of Gilbert, Johnson and Keerthi until the distance is proven; height
//! fields descend a pyramid of heights, the triangles of signed distance fields a tree.

pub(crate) mod find;
pub(crate) mod foot;
pub(crate) mod gjk;
pub(crate) mod near;
pub(crate) mod pair;
