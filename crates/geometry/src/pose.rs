//! Where something is.

/// Position (m, world) and unit quaternion (x, y, z, w; body to world).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Position in the world, m.
    pub pos_m: [f64; 3],
    /// Quaternion x, y, z, w, body to world.
    pub quat_xyzw: [f64; 4],
}

impl Pose {
    /// A pose; nothing is checked here.
    pub fn new(pos_m: [f64; 3], quat_xyzw: [f64; 4]) -> Self {
        Self { pos_m, quat_xyzw }
    }
}

impl Default for Pose {
    fn default() -> Self {
        Self { pos_m: [0.0; 3], quat_xyzw: [0.0, 0.0, 0.0, 1.0] }
    }
}
