//! Depth images, by the ray caster of our own or by MuJoCo's rays.
//!
//! A camera looks along its −z axis with y up. Pixel (0, 0) is the top left one; the ray of pixel (i, j) goes through
//! its centre, image point (i + 0.5, j + 0.5), where the image spans [0, width] × [0, height]. In these coordinates
//! `K` has the principal point (cx, cy); the centre of the image is (width / 2, height / 2). (Libraries that put pixel
//! centres at whole numbers use cx − 0.5, cy − 0.5.)

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError, Weak};

use serde::{Deserialize, Serialize};

use super::SenseError;
use super::caster::{self, Caster, RayPattern, RayQuery};
use crate::geometry::ray::{DepthRule, Planes};
use crate::math::quat;
use crate::scene::{CameraInfo, CameraMode, Pose, Scene, SceneError, Worker, checked_pose};

/// What a pixel of a depth image states, m.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DepthKind {
    /// Distance from the camera to the surface along the ray.
    Range,
    /// Distance along the camera's axis, as depth cameras report it: range times the cosine of the ray's angle to the axis.
    #[default]
    ZDepth,
}

/// What happened to the ray of a pixel.
#[repr(u8)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PixelStatus {
    /// A surface between near and far; depth in metres.
    Hit = 0,
    /// Nothing along the ray; depth is +inf.
    Miss = 1,
    /// A surface beyond far; depth is +inf, ids and normal tell what it was.
    TooFar = 2,
    /// A surface nearer than near; depth is 0, ids and normal tell what it was.
    TooNear = 3,
}

/// Status of pixels of a world that could not be rendered; their depth is NaN.
pub const STATUS_NOT_RENDERED: u8 = 255;

/// How image points become rays.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Lens {
    /// Square pixels, principal point in the centre.
    Fovy {
        /// Vertical field of view, degrees, between 0 and 180.
        fovy_deg: f64,
    },
    /// A pinhole in pixels, for an image of the given size; other sizes scale it.
    Pinhole {
        /// Focal length in x, pixels.
        fx_px: f64,
        /// Focal length in y, pixels.
        fy_px: f64,
        /// Principal point from the left edge, pixels.
        cx_px: f64,
        /// Principal point from the top edge, pixels.
        cy_px: f64,
        /// Image size that these numbers are for, width and height.
        size: [usize; 2],
    },
    /// A sensor in metres, as a camera of an MJCF scene gives it.
    Sensor {
        /// Width and height of the sensor, m.
        sensor_m: [f64; 2],
        /// Focal lengths in x and y, m.
        focal_m: [f64; 2],
        /// Offset of the principal point, m, as MuJoCo's renderer takes it: positive moves the optical axis to the
        /// left and to the top of the image. (MuJoCo's rangefinder takes it from the top left corner instead.)
        principal_m: [f64; 2],
    },
}

impl Lens {
    /// fx, fy, cx, cy in pixels for an image size.
    pub fn intrinsics_px(&self, width: usize, height: usize) -> [f64; 4] {
        let (w, h) = (width as f64, height as f64);
        match *self {
            Self::Fovy { fovy_deg } => {
                let f = 0.5 * h / (0.5 * fovy_deg.to_radians()).tan();
                [f, f, 0.5 * w, 0.5 * h]
            }
            Self::Pinhole { fx_px, fy_px, cx_px, cy_px, size } => {
                let (sx, sy) = (w / size[0] as f64, h / size[1] as f64);
                [fx_px * sx, fy_px * sy, cx_px * sx, cy_px * sy]
            }
            Self::Sensor { sensor_m, focal_m, principal_m } => {
                let (sx, sy) = (w / sensor_m[0], h / sensor_m[1]);
                // mjv_cameraFrustum and mjv_updateScene of MuJoCo 3.17.0: left = (w/2 − px)/fx, top = (h/2 − py)/fy.
                [
                    focal_m[0] * sx,
                    focal_m[1] * sy,
                    0.5 * w - principal_m[0] * sx,
                    0.5 * h - principal_m[1] * sy,
                ]
            }
        }
    }
}

/// Where a camera is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mount {
    /// At a camera of the model, which MuJoCo moves in all its modes.
    Model {
        /// Camera id.
        camera: usize,
    },
    /// On a drone, at a pose in the drone's body frame (x forward, y left, z up).
    Drone {
        /// The drone.
        drone: usize,
        /// Camera to body: position, and rotation of a frame that looks along −z with y up.
        pose: Pose,
    },
    /// Fixed in the world.
    World {
        /// Camera to world.
        pose: Pose,
    },
}

/// What moves a camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Carrier {
    /// No drone.
    Nothing,
    /// A drone, to which it is fixed.
    Drone(usize),
    /// It follows a body in another way: a mode of MJCF other than `fixed`.
    Following,
}

/// Largest image side, pixels.
pub const MAX_SIDE_PX: usize = 16_384;

/// A depth camera. Cheap to clone.
///
/// ```
/// use propwash::prelude::*;
/// use propwash::sense::Lens;
///
/// let scene = Scene::build(&SceneSource::file("xml/room.xml"), &[])?;
/// let pose = Pose::new([0.0, 0.0, 1.0], propwash::sense::depth::LOOKING_FORWARD_XYZW);
/// let camera = Camera::in_world(&scene, pose, Lens::Fovy { fovy_deg: 60.0 })?.with_size(32, 24)?;
/// let mut worker = scene.worker()?;
/// worker.update()?;
/// let mut frame = DepthFrame::new();
/// camera.render(&mut worker, &mut frame)?;
/// assert_eq!(frame.depth_m.len(), 32 * 24);
/// # Ok::<(), propwash::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct Camera {
    name: String,
    mount: Mount,
    lens: Lens,
    width: usize,
    height: usize,
    near_m: f64,
    far_m: f64,
    kind: DepthKind,
    normals: bool,
    caster: Caster,
    /// Groups, and the drone or else the body that it does not see.
    query: RayQuery,
    /// Rays of the pixels: one copy for all cameras of the same size and lens.
    pattern: Arc<RayPattern>,
}

/// Width, height and the bits of fx, fy, cx, cy.
type PatternKey = (usize, usize, [u64; 4]);

/// The pattern of a pinhole with intrinsics `k` in pixels.
fn pattern_of(width: usize, height: usize, k: [f64; 4]) -> Arc<RayPattern> {
    static KNOWN: Mutex<Option<HashMap<PatternKey, Weak<RayPattern>>>> = Mutex::new(None);
    let key = (width, height, k.map(f64::to_bits));
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    let known = known.get_or_insert_default();
    if let Some(pattern) = known.get(&key).and_then(Weak::upgrade) {
        return pattern;
    }
    let pattern = Arc::new(RayPattern::image(width, height, k));
    known.retain(|_, pattern| pattern.strong_count() > 0);
    known.insert(key, Arc::downgrade(&pattern));
    pattern
}

/// Quaternion (x, y, z, w) that turns a camera's frame (looks along −z, y up) into a body's (x forward, z up): a
/// camera mounted with it looks forward.
pub const LOOKING_FORWARD_XYZW: [f64; 4] = [0.5, -0.5, -0.5, 0.5];

impl Camera {
    /// The camera of this name in the model, e.g. `overview`, or `drone0/fpv` on a shell.
    ///
    /// Its size is the resolution that the scene gives, or 64 × 64; its lens the scene's field of view or sensor. It
    /// sees groups 0, 1 and 2 without limits of range. It does not see the body that carries it: the whole drone, or
    /// the scene body if that is not the world.
    ///
    /// # Errors
    /// [`SceneError::NoSuchName`] for an unknown name; [`SenseError::Camera`] for an orthographic camera.
    pub fn from_scene(scene: &Scene, name: &str) -> Result<Self, SenseError> {
        let info = scene.camera(name)?;
        Self::from_info(scene, info)
    }

    /// The camera `name` on the shell of a drone.
    ///
    /// # Errors
    /// As [`Camera::from_scene`], and [`SceneError::NoSuch`].
    pub fn on_drone(scene: &Scene, drone: usize, name: &str) -> Result<Self, SenseError> {
        scene.drone_body(drone)?;
        Self::from_scene(scene, &format!("drone{drone}/{name}"))
    }

    /// A camera of one's own, mounted on a drone: `pose` is camera to body (see [`LOOKING_FORWARD_XYZW`]). Size 64 × 64
    /// until [`Camera::with_size`].
    ///
    /// # Errors
    /// [`SenseError::Scene`] for an unknown drone or a bad pose, [`SenseError::Camera`] for an impossible lens.
    pub fn mounted(scene: &Scene, drone: usize, pose: Pose, lens: Lens) -> Result<Self, SenseError> {
        scene.drone_body(drone)?;
        let pose = check_mount(pose)?;
        let name = format!("custom on drone {drone}");
        Self::new(scene, name, Mount::Drone { drone, pose }, lens, [64, 64], Some(drone), None)
    }

    /// A camera of one's own, fixed in the world: `pose` is camera to world. Size 64 × 64 until [`Camera::with_size`].
    ///
    /// # Errors
    /// [`SenseError::Scene`] for a bad pose, [`SenseError::Camera`] for an impossible lens.
    pub fn in_world(scene: &Scene, pose: Pose, lens: Lens) -> Result<Self, SenseError> {
        let pose = check_mount(pose)?;
        Self::new(scene, "custom in the world".into(), Mount::World { pose }, lens, [64, 64], None, None)
    }

    fn from_info(scene: &Scene, info: &CameraInfo) -> Result<Self, SenseError> {
        if info.orthographic {
            return Err(SenseError::Camera {
                camera: info.name.clone(),
                message: "it is orthographic, but depth images need rays through one point; set \
                          projection=\"perspective\" or use another camera"
                    .into(),
            });
        }
        let lens = if info.sensor_size_m.iter().all(|s| *s > 0.0) {
            let [fx, fy, px, py] = info.intrinsic_m;
            Lens::Sensor { sensor_m: info.sensor_size_m, focal_m: [fx, fy], principal_m: [px, py] }
        } else {
            Lens::Fovy { fovy_deg: info.fovy_deg }
        };
        let size = if info.resolution.iter().all(|r| *r > 1) { info.resolution } else { [64, 64] };
        let own_body = (info.drone.is_none() && info.body_id != 0).then_some(info.body_id);
        Self::new(
            scene,
            info.name.clone(),
            Mount::Model { camera: info.id },
            lens,
            size,
            info.drone,
            own_body,
        )
    }

    fn new(
        scene: &Scene,
        name: String,
        mount: Mount,
        lens: Lens,
        size: [usize; 2],
        own_drone: Option<usize>,
        own_body: Option<usize>,
    ) -> Result<Self, SenseError> {
        let mut query = RayQuery::default();
        if let Some(drone) = own_drone {
            query = query.without_drone(scene, drone)?;
        } else if let Some(body) = own_body {
            query = query.without_body(body);
        }
        let camera = Self {
            name,
            mount,
            lens,
            width: 0,
            height: 0,
            near_m: 0.0,
            far_m: f64::INFINITY,
            kind: DepthKind::default(),
            normals: false,
            caster: Caster::Native,
            query,
            pattern: Arc::default(),
        };
        camera.with_size(size[0], size[1])
    }

    fn fail(&self, message: String) -> SenseError {
        SenseError::Camera { camera: self.name.clone(), message }
    }

    /// Sets the image size, pixels.
    ///
    /// # Errors
    /// [`SenseError::Camera`] for a side of 0 or beyond [`MAX_SIDE_PX`], or an impossible lens.
    pub fn with_size(mut self, width: usize, height: usize) -> Result<Self, SenseError> {
        if !(1..=MAX_SIDE_PX).contains(&width) || !(1..=MAX_SIDE_PX).contains(&height) {
            return Err(self.fail(format!(
                "an image of {width} x {height} pixels is not possible; give sides of 1 to {MAX_SIDE_PX}"
            )));
        }
        if let Lens::Fovy { fovy_deg } = self.lens
            && !(fovy_deg > 0.0 && fovy_deg < 180.0)
        {
            return Err(
                self.fail(format!("a vertical field of view of {fovy_deg} degrees is not between 0 and 180"))
            );
        }
        let k = self.lens.intrinsics_px(width, height);
        if !(k.iter().all(|x| x.is_finite()) && k[0] > 0.0 && k[1] > 0.0) {
            return Err(self.fail(format!(
                "focal lengths and principal point come to {k:?} pixels; focal lengths and sensor or image size must \
                 be positive and finite"
            )));
        }
        self.width = width;
        self.height = height;
        self.pattern = pattern_of(width, height, k);
        Ok(self)
    }

    /// Sets the lens.
    ///
    /// # Errors
    /// [`SenseError::Camera`] for an impossible lens.
    pub fn with_lens(mut self, lens: Lens) -> Result<Self, SenseError> {
        self.lens = lens;
        let (width, height) = (self.width, self.height);
        self.with_size(width, height)
    }

    /// Sets range limits, m, of the quantity that the image states (range or z-depth); `far_m` may be infinite.
    ///
    /// # Errors
    /// [`SenseError::Camera`] unless 0 ≤ near < far.
    pub fn with_range(mut self, near_m: f64, far_m: f64) -> Result<Self, SenseError> {
        if !(near_m >= 0.0 && near_m < far_m) {
            return Err(self.fail(format!(
                "range limits must satisfy 0 <= near < far, got near {near_m} m and far {far_m} m"
            )));
        }
        self.near_m = near_m;
        self.far_m = far_m;
        Ok(self)
    }

    /// Sets what the image states.
    #[must_use]
    pub fn with_kind(mut self, kind: DepthKind) -> Self {
        self.kind = kind;
        self
    }

    /// Sets which of the six geom groups are seen.
    #[must_use]
    pub fn with_groups(mut self, groups: [bool; 6]) -> Self {
        self.query = self.query.with_groups(groups);
        self
    }

    /// Whether frames hold surface normals.
    #[must_use]
    pub fn with_normals(mut self, normals: bool) -> Self {
        self.normals = normals;
        self
    }

    /// Lets the camera see the body or drone that carries it.
    #[must_use]
    pub fn seeing_itself(mut self) -> Self {
        self.query = self.query.with_all_bodies();
        self
    }

    /// Sets who casts the rays. [`Caster::Native`] is the default; it refuses scenes of 2²⁴ geoms and more.
    #[must_use]
    pub fn with_caster(mut self, caster: Caster) -> Self {
        self.caster = caster;
        self
    }

    /// Name of the camera.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Width, pixels.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height, pixels.
    pub fn height(&self) -> usize {
        self.height
    }

    /// What the image states.
    pub fn kind(&self) -> DepthKind {
        self.kind
    }

    /// Puts the greatest depth of the range where a depth states none (see [`PixelStatus`]), or more.
    pub fn fill_unseen(&self, depth_m: &mut [f32]) {
        let far = self.far_m as f32;
        for depth in depth_m {
            // NaN is not smaller either.
            *depth = if *depth < far { *depth } else { far };
        }
    }

    /// Near and far limits, m.
    pub fn range_m(&self) -> (f64, f64) {
        (self.near_m, self.far_m)
    }

    /// Where it is.
    pub fn mount(&self) -> Mount {
        self.mount
    }

    /// Its lens.
    pub fn lens(&self) -> Lens {
        self.lens
    }

    /// The drone that carries it and that it does not see.
    pub fn own_drone(&self) -> Option<usize> {
        self.query.filter.own_drone
    }

    /// What moves it in its scene.
    pub fn carrier(&self, scene: &Scene) -> Carrier {
        let info = match self.mount {
            Mount::Drone { drone, .. } => return Carrier::Drone(drone),
            Mount::Model { camera } => scene.cameras().get(camera),
            Mount::World { .. } => None,
        };
        match info {
            Some(info) if info.mode != CameraMode::Fixed => Carrier::Following,
            Some(CameraInfo { drone: Some(drone), .. }) => Carrier::Drone(*drone),
            _ => Carrier::Nothing,
        }
    }

    /// Who casts its rays.
    pub fn caster(&self) -> Caster {
        self.caster
    }

    /// Which groups it sees.
    pub fn groups(&self) -> [bool; 6] {
        self.query.filter.groups
    }

    /// The matrix of intrinsics, pixels: [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], for image points whose origin is the
    /// outer corner of pixel (0, 0), y down.
    pub fn k(&self) -> [[f64; 3]; 3] {
        let [fx, fy, cx, cy] = self.lens.intrinsics_px(self.width, self.height);
        [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]
    }

    /// Unit directions of the pixels' rays in the camera's frame, row major (height × width); computed anew.
    pub fn rays(&self) -> Vec<[f64; 3]> {
        (0..self.pattern.len()).map(|pixel| self.pattern.direction(pixel)).collect()
    }

    /// The rays of its pixels, row major (height × width), in its frame.
    pub fn pattern(&self) -> &RayPattern {
        &self.pattern
    }

    /// Pose of the camera at the worker's poses: camera to world.
    ///
    /// # Errors
    /// [`SenseError::Scene`].
    pub fn pose(&self, worker: &Worker) -> Result<Pose, SenseError> {
        Ok(match self.mount {
            Mount::World { pose } => pose,
            Mount::Model { camera } => worker.camera_pose(camera)?,
            Mount::Drone { drone, pose } => {
                let body = worker.body_pose(worker.scene().drone_body(drone)?)?;
                let offset = quat::rotate(body.quat_xyzw, pose.pos_m);
                Pose {
                    pos_m: [body.pos_m[0] + offset[0], body.pos_m[1] + offset[1], body.pos_m[2] + offset[2]],
                    quat_xyzw: quat::mul(body.quat_xyzw, pose.quat_xyzw),
                }
            }
        })
    }

    /// Renders one image into `frame`, whose buffers are reused.
    ///
    /// # Errors
    /// [`SenseError::Scene`], e.g. when the worker was not updated; [`SenseError::Parameter`] where [`Caster::Native`] is
    /// asked for a scene of 2²⁴ geoms or more.
    pub fn render(&self, worker: &mut Worker, frame: &mut DepthFrame) -> Result<(), SenseError> {
        let n = self.pattern.len();
        frame.width = self.width;
        frame.height = self.height;
        frame.kind = self.kind;
        frame.k = self.k();
        frame.depth_m.resize(n, 0.0);
        frame.status.resize(n, 0);
        frame.geom_id.resize(n, 0);
        frame.body_id.resize(n, 0);
        if self.normals {
            frame.normal.get_or_insert_with(Vec::new).resize(n, [0.0; 3]);
        } else {
            frame.normal = None;
        }
        let planes = Planes {
            depth: Some(&mut frame.depth_m),
            status: Some(&mut frame.status),
            geom: Some(&mut frame.geom_id),
            body: Some(&mut frame.body_id),
            normal: frame.normal.as_deref_mut(),
        };
        let pose = self.render_planes(worker, planes)?;
        frame.pos_m = pose.pos_m;
        frame.quat_xyzw = pose.quat_xyzw;
        Ok(())
    }

    /// Renders only the planes that are asked for, into buffers of the caller; the others cost nothing. Returns the pose
    /// of the camera.
    ///
    /// # Errors
    /// [`SenseError::Shape`] for a plane that has not one entry for each pixel; as [`Camera::render`].
    pub fn render_into(&self, worker: &mut Worker, planes: DepthPlanes) -> Result<Pose, SenseError> {
        let planes = Planes {
            depth: planes.depth_m,
            status: planes.status,
            geom: planes.geom_id,
            body: planes.body_id,
            normal: planes.normal,
        };
        planes.check(self.pattern.len())?;
        self.render_planes(worker, planes)
    }

    pub(super) fn render_planes(&self, worker: &mut Worker, planes: Planes) -> Result<Pose, SenseError> {
        let pose = self.pose(worker)?;
        match self.caster {
            Caster::Native => {
                let rule = DepthRule {
                    z_depth: self.kind == DepthKind::ZDepth,
                    near: self.near_m as f32,
                    far: self.far_m as f32,
                };
                caster::render(worker, &pose, &self.pattern, &self.query, rule, planes)?;
            }
            Caster::MuJoCo => {
                let mut scratch = std::mem::take(&mut worker.scratch);
                let result = self.cast(worker, &pose, &mut scratch, planes);
                worker.scratch = scratch;
                result?;
            }
        }
        Ok(pose)
    }

    fn cast(
        &self,
        worker: &mut Worker,
        pose: &Pose,
        scratch: &mut crate::scene::RayScratch,
        mut planes: Planes,
    ) -> Result<(), SenseError> {
        let r = quat::matrix(pose.quat_xyzw);
        scratch.directions.clear();
        scratch.directions.extend((0..self.pattern.len()).map(|pixel| {
            let v = self.pattern.direction(pixel);
            [
                r[0][0] * v[0] + r[0][1] * v[1] + r[0][2] * v[2],
                r[1][0] * v[0] + r[1][1] * v[1] + r[1][2] * v[2],
                r[2][0] * v[0] + r[2][1] * v[1] + r[2][2] * v[2],
            ]
        }));
        caster::oracle_rays(worker, &self.query, pose.pos_m, scratch, planes.normal.is_some())?;
        let geoms = worker.scene().geoms();
        for i in 0..self.pattern.len() {
            let distance = scratch.distances[i];
            let geom = scratch.geoms[i];
            let miss = !(distance >= 0.0);
            let value = match self.kind {
                DepthKind::Range => distance,
                DepthKind::ZDepth => distance * -self.pattern.direction(i)[2],
            };
            let (depth, status) = if miss {
                (f32::INFINITY, PixelStatus::Miss)
            } else if value < self.near_m {
                (0.0, PixelStatus::TooNear)
            } else if value > self.far_m {
                (f32::INFINITY, PixelStatus::TooFar)
            } else {
                // Zero has no sign.
                (value as f32 + 0.0, PixelStatus::Hit)
            };
            if let Some(plane) = planes.depth.as_deref_mut() {
                plane[i] = depth;
            }
            if let Some(plane) = planes.status.as_deref_mut() {
                plane[i] = status as u8;
            }
            if let Some(plane) = planes.geom.as_deref_mut() {
                plane[i] = if miss { -1 } else { geom };
            }
            if let Some(plane) = planes.body.as_deref_mut() {
                plane[i] = match usize::try_from(geom) {
                    Ok(g) if !miss => geoms[g].body_id as i32,
                    _ => -1,
                };
            }
            if let Some(plane) = planes.normal.as_deref_mut() {
                plane[i] = if miss { [0.0; 3] } else { scratch.normals[i].map(|x| x as f32) };
            }
        }
        Ok(())
    }
}

/// Planes of an image that [`Camera::render_into`] shall fill, row major (height × width); see [`DepthFrame`].
#[derive(Debug, Default)]
pub struct DepthPlanes<'a> {
    /// Depth, m.
    pub depth_m: Option<&'a mut [f32]>,
    /// [`PixelStatus`] of each pixel.
    pub status: Option<&'a mut [u8]>,
    /// Geom that was seen, −1 for none.
    pub geom_id: Option<&'a mut [i32]>,
    /// Body that was seen, −1 for none.
    pub body_id: Option<&'a mut [i32]>,
    /// Outward unit surface normal in the world, zero where nothing was seen.
    pub normal: Option<&'a mut [[f32; 3]]>,
}

fn check_mount(pose: Pose) -> Result<Pose, SceneError> {
    checked_pose(|| "a camera".into(), pose.pos_m, pose.quat_xyzw)
}

/// One depth image with all that is known about it. Planes are row major, (height × width).
#[derive(Clone, Debug, PartialEq)]
pub struct DepthFrame {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// What `depth_m` states.
    pub kind: DepthKind,
    /// Depth, m; see [`PixelStatus`] for pixels without one.
    pub depth_m: Vec<f32>,
    /// [`PixelStatus`] of each pixel.
    pub status: Vec<u8>,
    /// Geom that was seen; -1 for none or a flex.
    pub geom_id: Vec<i32>,
    /// Body that was seen; -1 for none or a flex.
    pub body_id: Vec<i32>,
    /// Unit surface normal in the world, as MuJoCo's rays give it; zero where nothing was seen.
    pub normal: Option<Vec<[f32; 3]>>,
    /// Position of the camera, m.
    pub pos_m: [f64; 3],
    /// Camera to world, x y z w; the camera looks along its −z, y up.
    pub quat_xyzw: [f64; 4],
    /// Intrinsics, pixels, see [`Camera::k`].
    pub k: [[f64; 3]; 3],
}

impl Default for DepthFrame {
    fn default() -> Self {
        Self {
            width: 0,
            height: 0,
            kind: DepthKind::default(),
            depth_m: Vec::new(),
            status: Vec::new(),
            geom_id: Vec::new(),
            body_id: Vec::new(),
            normal: None,
            pos_m: [0.0; 3],
            quat_xyzw: [0.0, 0.0, 0.0, 1.0],
            k: [[0.0; 3]; 3],
        }
    }
}

impl DepthFrame {
    /// An empty frame; [`Camera::render`] gives it its size.
    pub fn new() -> Self {
        Self::default()
    }
}
