//! The depth camera of every drone, as a description names it.

use serde::{Deserialize, Serialize};

use super::{ArenaError, MountConfig};
use crate::math::quat;
use crate::scene::{Pose, Scene};
use crate::sense::depth::LOOKING_FORWARD_XYZW;
use crate::sense::{Camera, Caster, DepthDevice, DepthKind, DepthNoise, Lens};

/// A depth camera on every drone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CameraConfig {
    /// A device whose lens, size, range, kind of depth and noise are taken: a name of [`DEVICES`](crate::sense::DEVICES). What stands
    /// beside it here comes first.
    pub device: Option<String>,
    /// Camera of the drones' shells, or else of the scene, that says where it sits and, without a device, its lens.
    pub name: String,
    /// Where it sits on every drone, in place of the camera called `name`; it then looks with 90° from top to bottom, or as is said here.
    pub mount: Option<MountConfig>,
    /// Pixels in a row.
    pub width: Option<usize>,
    /// Rows.
    pub height: Option<usize>,
    /// Vertical field of view, degrees.
    pub fovy_deg: Option<f64>,
    /// Focal lengths in x and y and the principal point from the left and the top edge (fx, fy, cx, cy), pixels of an image of this size, in
    /// place of a field of view.
    pub pinhole_px: Option<[f64; 4]>,
    /// Least and greatest depth that is seen, m.
    pub range_m: Option<[f64; 2]>,
    /// Along the ray, or along the camera's axis.
    pub kind: Option<DepthKind>,
    /// Errors of the sensor; those of the device where this is none.
    pub noise: Option<DepthNoise>,
    /// MuJoCo's geom groups that it sees, 0 to 5.
    pub groups: Vec<u8>,
    /// Who casts its rays.
    pub caster: Caster,
}

impl Default for CameraConfig {
    /// 64 × 64 pixels of z-depth from 0.01 m to 20 m by the shell's camera `fpv`, of the groups 0, 1 and 2, without noise.
    fn default() -> Self {
        Self {
            device: None,
            name: "fpv".into(),
            mount: None,
            width: None,
            height: None,
            fovy_deg: None,
            pinhole_px: None,
            range_m: None,
            kind: None,
            noise: None,
            groups: vec![0, 1, 2],
            caster: Caster::default(),
        }
    }
}

/// Pixels of a camera without other orders, width and height.
const SIZE: [usize; 2] = [64, 64];
/// Depth that it sees, m.
const RANGE_M: [f64; 2] = [0.01, 20.0];

impl CameraConfig {
    fn of_device<T>(&self, pick: impl Fn(&DepthDevice) -> T) -> Result<Option<T>, ArenaError> {
        let Some(name) = &self.device else { return Ok(None) };
        let device = DepthDevice::named(name);
        let refused = |known| ArenaError::option("camera device", format!("one of {known}"), name);
        device.map(|d| Some(pick(d))).map_err(refused)
    }

    /// Width and height, pixels.
    ///
    /// # Errors
    /// [`ArenaError::Option`] for a device that there is not.
    pub fn size(&self) -> Result<[usize; 2], ArenaError> {
        let [w, h] = self.of_device(|d| d.size)?.unwrap_or(SIZE);
        Ok([self.width.unwrap_or(w), self.height.unwrap_or(h)])
    }

    /// Least and greatest depth, m.
    ///
    /// # Errors
    /// As [`CameraConfig::size`].
    pub fn range(&self) -> Result<[f64; 2], ArenaError> {
        Ok(self.range_m.or(self.of_device(|d| d.range_m)?).unwrap_or(RANGE_M))
    }

    /// What a depth measures.
    ///
    /// # Errors
    /// As [`CameraConfig::size`].
    pub fn kind(&self) -> Result<DepthKind, ArenaError> {
        Ok(self.kind.or(self.of_device(|d| d.kind)?).unwrap_or_default())
    }

    /// Vertical field of view, degrees; none where it is that of the camera in the scene.
    ///
    /// # Errors
    /// As [`CameraConfig::size`].
    pub fn fovy_deg(&self) -> Result<Option<f64>, ArenaError> {
        Ok(self.fovy_deg.or(self.of_device(|d| d.fovy_deg)?))
    }

    /// Errors of the sensor; none where it has none.
    ///
    /// # Errors
    /// As [`CameraConfig::size`], and [`ArenaError::Sense`] for noise that makes no sense.
    pub fn errors(&self) -> Result<Option<DepthNoise>, ArenaError> {
        let noise = self.noise.or(self.of_device(|d| d.noise)?).unwrap_or_default();
        noise.check()?;
        Ok((noise != DepthNoise::default()).then_some(noise))
    }

    /// The camera of one drone: that of its shell, else that of the scene.
    ///
    /// # Errors
    /// [`ArenaError::Option`] for a device or a group that there is not, [`ArenaError::Sense`] for a camera that there is not and for
    /// a size, a lens or a range that cannot be.
    pub fn build(&self, scene: &Scene, drone: usize) -> Result<Camera, ArenaError> {
        if let Some(mount) = &self.mount {
            return self.apply(Camera::mounted(
                scene,
                drone,
                Self::looking(mount),
                Lens::Fovy { fovy_deg: 90.0 },
            )?);
        }
        let on_drone = format!("drone{drone}/{}", self.name);
        let known = |name: &str| scene.cameras().iter().any(|c| c.name == name);
        let name = if known(&on_drone) { &on_drone } else { &self.name };
        self.apply(Camera::from_scene(scene, name)?)
    }

    /// Camera to body, of a camera that looks along the x axis of its mount.
    pub fn looking(mount: &MountConfig) -> Pose {
        let turn = quat::normalize(mount.quat_xyzw);
        Pose::new(mount.pos_m, quat::mul(turn, LOOKING_FORWARD_XYZW))
    }

    /// The lens, where it is not that of the camera in the scene.
    fn lens(&self) -> Result<Option<Lens>, ArenaError> {
        let Some([fx_px, fy_px, cx_px, cy_px]) = self.pinhole_px else {
            return Ok(self.fovy_deg()?.map(|fovy_deg| Lens::Fovy { fovy_deg }));
        };
        if let Some(fovy_deg) = self.fovy_deg {
            let expected = "either a field of view or intrinsics";
            return Err(ArenaError::option("pinhole_px", expected, format!("both, fovy_deg is {fovy_deg}")));
        }
        Ok(Some(Lens::Pinhole { fx_px, fy_px, cx_px, cy_px, size: self.size()? }))
    }

    /// A camera with everything that is said here but its place.
    ///
    /// # Errors
    /// As [`CameraConfig::build`].
    pub fn apply(&self, mut camera: Camera) -> Result<Camera, ArenaError> {
        if let Some(lens) = self.lens()? {
            camera = camera.with_lens(lens)?;
        }
        let mut groups = [false; 6];
        for group in &self.groups {
            match groups.get_mut(usize::from(*group)) {
                Some(seen) => *seen = true,
                None => {
                    let expected = "MuJoCo's geom groups 0 to 5, such as 0, 1, 2";
                    return Err(ArenaError::option("camera groups", expected, group));
                }
            }
        }
        let ([width, height], [near, far]) = (self.size()?, self.range()?);
        let camera = camera.with_size(width, height)?.with_range(near, far)?;
        Ok(camera.with_kind(self.kind()?).with_groups(groups).with_caster(self.caster))
    }
}
