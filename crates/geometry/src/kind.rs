//! What shapes there are.

use std::fmt;

use serde::Serialize;

/// Shape of a geom (mjtGeom).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum GeomType {
    /// Half space under its own x-y plane; rays see only its rectangle, contacts the whole plane.
    Plane,
    /// Height field on a base box.
    Hfield,
    /// Sphere.
    Sphere,
    /// Cylinder with half spheres at its ends.
    Capsule,
    /// Ellipsoid.
    Ellipsoid,
    /// Cylinder with flat ends.
    Cylinder,
    /// Box.
    Box,
    /// Triangle mesh; rays see the triangles, contacts the convex hull.
    Mesh,
    /// Signed distance field.
    Sdf,
}

impl GeomType {
    /// All types.
    pub const ALL: [GeomType; 9] = [
        Self::Plane,
        Self::Hfield,
        Self::Sphere,
        Self::Capsule,
        Self::Ellipsoid,
        Self::Cylinder,
        Self::Box,
        Self::Mesh,
        Self::Sdf,
    ];

    /// By its number in MuJoCo's models; none for a number that is none of a geom.
    pub fn from_id(id: i32) -> Option<Self> {
        usize::try_from(id).ok().and_then(|i| Self::ALL.get(i).copied())
    }

    /// Name as in MJCF.
    pub fn name(self) -> &'static str {
        match self {
            Self::Plane => "plane",
            Self::Hfield => "hfield",
            Self::Sphere => "sphere",
            Self::Capsule => "capsule",
            Self::Ellipsoid => "ellipsoid",
            Self::Cylinder => "cylinder",
            Self::Box => "box",
            Self::Mesh => "mesh",
            Self::Sdf => "sdf",
        }
    }
}

impl fmt::Display for GeomType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}
