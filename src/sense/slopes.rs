//! How depths and clearances change with the poses that they depend on.
//!
//! A ray from o along the unit vector d ends at p = o + r d on a surface with normal n. To first order a smooth surface is its tangent plane, whatever the geom, so a
//! moved ray still ends on it where n · (δo + δr d + r δd) = 0 (implicit function theorem). The range therefore gains g = −n / (n · d) as its origin moves and
//! (p − c) × g as the ray turns about a point c; where the surface moves, the same with the opposite sign. A clearance gains the unit vector from the obstacle to
//! the drone where the closest point on the drone moves. Nothing is differenced, and nothing is cast again.
//!
//! There is no slope where a ray ends on nothing, beyond the range, or grazes a surface; and a pixel knows of its own ray alone: that an edge moves into a
//! neighbouring pixel is in no slope.

use super::clearance::Clearance;
use super::depth::{DepthFrame, DepthKind, PixelStatus};
use super::error::SenseError;
use crate::math::{quat, vec3};
use crate::scene::Pose;

/// Cosine of the angle between a ray and a normal below which the ray grazes the surface: 0.06° of it. Normals are known to 1e-7, slopes there to 1e-4.
pub const GRAZING: f64 = 1e-3;

/// Closest points that are nearer to each other than this have no direction, m: MuJoCo's search ends there.
pub const TOUCHING_M: f64 = 1e-6;

/// What a number gains as a rigid body moves.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PoseGain {
    /// By its position, for each metre, world.
    pub by_pos: [f64; 3],
    /// By turning it about the world's origin, for each radian, world.
    about_origin: [f64; 3],
}

impl PoseGain {
    /// Adds what is gained as a point of the body moves.
    pub fn add(&mut self, by_point: [f64; 3], point_m: [f64; 3]) {
        self.by_pos = vec3::add(self.by_pos, by_point);
        self.about_origin = vec3::add(self.about_origin, vec3::cross(point_m, by_point));
    }

    /// Adds all that another gains: of a camera to the drone that carries it.
    pub fn join(&mut self, other: &Self) {
        self.by_pos = vec3::add(self.by_pos, other.by_pos);
        self.about_origin = vec3::add(self.about_origin, other.about_origin);
    }

    /// By turning the body about a point, for each radian about the axes of the world.
    pub fn by_rotation(&self, about_m: [f64; 3]) -> [f64; 3] {
        // A body that flew away stands nowhere: nothing times that is nothing.
        if *self == Self::default() {
            return [0.0; 3];
        }
        vec3::sub(self.about_origin, vec3::cross(about_m, self.by_pos))
    }

    /// By the four numbers x y z w of the body's attitude, about its position. Nothing is gained by their length.
    pub fn by_quat(&self, pose: &Pose) -> [f64; 4] {
        if *self == Self::default() {
            return [0.0; 4];
        }
        let turn = self.by_rotation(pose.pos_m);
        // A change δq turns by the vector part of 2 δq q*, in the axes of the world.
        let twice = turn.map(|t| 2.0 * t);
        quat::mul([twice[0], twice[1], twice[2], 0.0], pose.quat_xyzw)
    }
}

/// Where a pixel's ray ends, and what its depth gains.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelSlope {
    /// Where the ray ends, m, world.
    pub point_m: [f64; 3],
    /// What the depth gains as the camera moves without turning, for each metre, world.
    pub by_pos: [f64; 3],
}

/// The planes of an image that tell how its depths change, row major, (height × width); as in [`DepthFrame`].
#[derive(Clone, Copy, Debug)]
pub struct SlopedImage<'a> {
    /// Pixels in a row.
    pub width: usize,
    /// What `depth_m` states.
    pub kind: DepthKind,
    /// Intrinsics, pixels.
    pub k: [[f64; 3]; 3],
    /// Camera to world.
    pub pose: Pose,
    /// Depth, m.
    pub depth_m: &'a [f32],
    /// [`PixelStatus`] of each pixel.
    pub status: &'a [u8],
    /// Geom that was seen.
    pub geom_id: &'a [i32],
    /// Unit surface normal in the world.
    pub normal: &'a [[f32; 3]],
}

impl SlopedImage<'_> {
    /// The slope of a pixel, if it has one.
    pub fn slope(&self, pixel: usize) -> Option<PixelSlope> {
        if self.status[pixel] != PixelStatus::Hit as u8 {
            return None;
        }
        let [[fx, _, cx], [_, fy, cy], _] = self.k;
        let (i, j) = ((pixel % self.width) as f64, (pixel / self.width) as f64);
        // Along the axis these are 1 m: lengths of this vector times a z-depth are ranges.
        let ray = [(i + 0.5 - cx) / fx, -(j + 0.5 - cy) / fy, -1.0];
        let length = vec3::norm(ray);
        let depth = f64::from(self.depth_m[pixel]);
        let (range, share) = match self.kind {
            DepthKind::Range => (depth, 1.0),
            DepthKind::ZDepth => (depth * length, 1.0 / length),
        };
        let d = quat::rotate(self.pose.quat_xyzw, vec3::scale(ray, 1.0 / length));
        let n = self.normal[pixel].map(f64::from);
        let along = vec3::dot(n, d);
        // A normal of zero, and one that is no number, are none.
        (along.abs() >= GRAZING).then(|| PixelSlope {
            point_m: vec3::add(self.pose.pos_m, vec3::scale(d, range)),
            by_pos: vec3::scale(n, -share / along),
        })
    }

    /// What a loss gains by the camera's pose, where it gains `seeds` by the depths; `seen` is told, for each geom that was seen, what the loss gains by a point of it.
    ///
    /// # Errors
    /// [`SenseError::Shape`] for another number of seeds than pixels; [`SenseError::Parameter`] for a seed that is no number, or not 0 where there is no slope.
    pub fn pull_back(
        &self,
        seeds: &[f64],
        mut seen: impl FnMut(i32, [f64; 3], [f64; 3]),
    ) -> Result<PoseGain, SenseError> {
        let n = self.depth_m.len();
        if seeds.len() != n {
            let (what, shape) = ("seeds", "(height, width)".into());
            return Err(SenseError::Shape { what, shape, expected: n, found: seeds.len() });
        }
        let mut gain = PoseGain::default();
        for (pixel, seed) in seeds.iter().enumerate().filter(|(_, seed)| **seed != 0.0) {
            let slope = self.slope(pixel).filter(|_| seed.is_finite());
            let Some(PixelSlope { point_m, by_pos }) = slope else { return Err(self.no_slope(pixel, *seed)) };
            let by_point = vec3::scale(by_pos, *seed);
            gain.add(by_point, point_m);
            seen(self.geom_id[pixel], vec3::scale(by_point, -1.0), point_m);
        }
        Ok(gain)
    }

    fn no_slope(&self, pixel: usize, seed: f64) -> SenseError {
        let (x, y) = (pixel % self.width, pixel / self.width);
        let why = match self.status[pixel] {
            _ if !seed.is_finite() => "",
            0 => ", whose ray grazes the surface",
            1 => ", where nothing is seen",
            2 => ", which is beyond the range",
            3 => ", which is nearer than the range",
            _ => ", whose world was not rendered",
        };
        let what = format!(
            "seeds: expected finite numbers, and 0 for pixels without a slope, got {seed} at pixel ({x}, {y}){why}; set seeds to 0 where `known` is false"
        );
        SenseError::Parameter { what }
    }
}

impl DepthFrame {
    /// The planes that tell how its depths change.
    ///
    /// # Errors
    /// [`SenseError::Parameter`] for a frame without normals.
    ///
    /// ```
    /// use propwash::prelude::*;
    /// use propwash::sense::Lens;
    ///
    /// let scene = Scene::build(&SceneSource::file("xml/room.xml"), &[])?;
    /// let pose = Pose::new([0.0, 0.0, 1.0], propwash::sense::depth::LOOKING_FORWARD_XYZW);
    /// let camera = Camera::in_world(&scene, pose, Lens::Fovy { fovy_deg: 60.0 })?.with_size(32, 24)?.with_normals(true);
    /// let mut worker = scene.worker()?;
    /// worker.update()?;
    /// let mut frame = DepthFrame::new();
    /// camera.render(&mut worker, &mut frame)?;
    /// // The mean depth, less as the camera moves forwards.
    /// let image = frame.sloped()?;
    /// let seeds: Vec<f64> = (0..32 * 24).map(|i| f64::from(u8::from(image.slope(i).is_some())) / (32.0 * 24.0)).collect();
    /// let gain = image.pull_back(&seeds, |_, _, _| ())?;
    /// assert!(gain.by_pos[0] < 0.0);
    /// # Ok::<(), propwash::Error>(())
    /// ```
    pub fn sloped(&self) -> Result<SlopedImage<'_>, SenseError> {
        let Some(normal) = &self.normal else {
            return Err(SenseError::Parameter { what: NO_NORMALS.into() });
        };
        Ok(SlopedImage {
            width: self.width,
            kind: self.kind,
            k: self.k,
            pose: Pose { pos_m: self.pos_m, quat_xyzw: self.quat_xyzw },
            depth_m: &self.depth_m,
            status: &self.status,
            geom_id: &self.geom_id,
            normal,
        })
    }
}

/// What is said of a frame without normals.
pub const NO_NORMALS: &str =
    "slopes of depths need the normals of what was seen: render the frame with normals";

impl Clearance {
    /// The unit vector, world, along which a point of the drone moves straight away from the obstacle: what the distance gains as the closest point on the drone
    /// moves. None where nothing was found, the distance is only a bound, or both touch so closely ([`TOUCHING_M`]) that no direction can be told.
    pub fn away(&self) -> Option<[f64; 3]> {
        let apart = vec3::sub(self.on_drone_m, self.on_other_m);
        let length = vec3::norm(apart);
        let known = self.found && self.exact && length >= TOUCHING_M && self.distance_m.abs() >= TOUCHING_M;
        // In penetration the point on the drone lies behind that on the obstacle.
        known.then(|| vec3::scale(apart, self.distance_m.signum() / length))
    }
}
