//! Depth cameras as Python describes them.

use numpy::PyArrayDyn;
use propwash::scene::{Pose, Scene};
use propwash::sense::{Camera, Carrier, Caster, DepthKind, Lens};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::arrays;
use crate::errors::OrRaise;

/// A camera in words and numbers; `propwash.Camera` explains them.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct CameraSpec {
    name: Option<String>,
    mount: Option<String>,
    pos: Option<[f64; 3]>,
    quat: Option<[f64; 4]>,
    fovy_deg: Option<f64>,
    pinhole_px: Option<[f64; 4]>,
    resolution: Option<[usize; 2]>,
    near: f64,
    far: f64,
    kind: String,
    groups: [bool; 6],
    sees_itself: bool,
    caster: String,
    normals: bool,
}

impl CameraSpec {
    /// The cameras in `scene`.
    pub fn build(&self, scene: &Scene) -> PyResult<PyCameras> {
        let (cameras, per_drone) = match (&self.name, self.mount.as_deref()) {
            (Some(name), None) => self.named(scene, name)?,
            (None, Some(mount)) => self.placed(scene, mount)?,
            _ => {
                return Err(PyValueError::new_err(
                    "camera: expected the name of a camera, or mount=\"drone\" or \"world\" with pos, and not both",
                ));
            }
        };
        let cameras = cameras.into_iter().map(|c| self.adjust(c)).collect::<PyResult<Vec<_>>>()?;
        Ok(PyCameras { cameras, per_drone, scene: scene.clone() })
    }

    /// One on every drone if drones carry a camera of that name, else the one of the scene.
    fn named(&self, scene: &Scene, name: &str) -> PyResult<(Vec<Camera>, bool)> {
        let drones = 0..scene.n_drones();
        let carried = |d: usize| scene.cameras().iter().any(|c| c.name == format!("drone{d}/{name}"));
        if drones.clone().any(carried) {
            let all: Result<_, _> = drones.map(|d| Camera::on_drone(scene, d, name)).collect();
            return Ok((all.or_raise()?, true));
        }
        Ok((vec![Camera::from_scene(scene, name).or_raise()?], false))
    }

    fn placed(&self, scene: &Scene, mount: &str) -> PyResult<(Vec<Camera>, bool)> {
        let (Some(pos), Some(quat)) = (self.pos, self.quat) else {
            return Err(PyValueError::new_err("camera: a mount needs pos and quat"));
        };
        let pose = Pose::new(pos, quat);
        let lens = self.lens()?.unwrap_or(Lens::Fovy { fovy_deg: 90.0 });
        match mount {
            "drone" => {
                let all: Result<_, _> =
                    (0..scene.n_drones()).map(|d| Camera::mounted(scene, d, pose, lens)).collect();
                Ok((all.or_raise()?, true))
            }
            "world" => Ok((vec![Camera::in_world(scene, pose, lens).or_raise()?], false)),
            got => Err(PyValueError::new_err(format!("mount: expected drone or world, got {got:?}"))),
        }
    }

    fn lens(&self) -> PyResult<Option<Lens>> {
        match (self.fovy_deg, self.pinhole_px, self.resolution) {
            (None, None, _) => Ok(None),
            (Some(fovy_deg), None, _) => Ok(Some(Lens::Fovy { fovy_deg })),
            (None, Some([fx_px, fy_px, cx_px, cy_px]), Some(size)) => {
                Ok(Some(Lens::Pinhole { fx_px, fy_px, cx_px, cy_px, size }))
            }
            (None, Some(_), None) => Err(PyValueError::new_err(
                "camera: pinhole_px are pixels of an image of some size: give resolution=(width, height) too",
            )),
            (Some(_), Some(_), _) => {
                Err(PyValueError::new_err("camera: expected fovy_deg or pinhole_px, got both"))
            }
        }
    }

    fn adjust(&self, mut camera: Camera) -> PyResult<Camera> {
        if let Some([width, height]) = self.resolution {
            camera = camera.with_size(width, height).or_raise()?;
        }
        if let (Some(_), Some(lens)) = (&self.name, self.lens()?) {
            camera = camera.with_lens(lens).or_raise()?;
        }
        let kind = match self.kind.as_str() {
            "range" => DepthKind::Range,
            "z_depth" => DepthKind::ZDepth,
            got => {
                return Err(PyValueError::new_err(format!("kind: expected range or z_depth, got {got:?}")));
            }
        };
        let caster = match self.caster.as_str() {
            "native" => Caster::Native,
            "mujoco" => Caster::MuJoCo,
            got => {
                return Err(PyValueError::new_err(format!("caster: expected native or mujoco, got {got:?}")));
            }
        };
        camera = camera.with_range(self.near, self.far).or_raise()?;
        camera =
            camera.with_kind(kind).with_groups(self.groups).with_caster(caster).with_normals(self.normals);
        Ok(if self.sees_itself { camera.seeing_itself() } else { camera })
    }
}

/// Cameras in the scene of one simulation, ready to render.
#[pyclass(frozen, name = "Cameras", module = "propwash._native")]
pub struct PyCameras {
    /// In the order of drones, or one.
    pub cameras: Vec<Camera>,
    /// Whether there is one for each drone.
    pub per_drone: bool,
    scene: Scene,
}

impl PyCameras {
    /// Shape of what each camera has one of.
    pub fn shape(&self, n_worlds: usize) -> Vec<usize> {
        if self.per_drone { vec![n_worlds, self.cameras.len()] } else { vec![n_worlds] }
    }

    /// Whether they were made for this scene.
    pub fn belong_to(&self, scene: &Scene) -> bool {
        std::ptr::eq(self.scene.geoms(), scene.geoms())
    }
}

#[pymethods]
impl PyCameras {
    /// Pixels in a row.
    #[getter]
    pub fn width(&self) -> usize {
        self.cameras.first().map_or(0, Camera::width)
    }

    /// Rows.
    #[getter]
    pub fn height(&self) -> usize {
        self.cameras.first().map_or(0, Camera::height)
    }

    /// Whether there is one for each drone.
    #[getter]
    fn per_drone(&self) -> bool {
        self.per_drone
    }

    /// The drone that carries each, −1 for none, −2 for one that follows otherwise than fixed to it.
    fn carriers(&self) -> Vec<i64> {
        let number = |c: &Camera| match c.carrier(&self.scene) {
            Carrier::Drone(drone) => drone as i64,
            Carrier::Nothing => -1,
            Carrier::Following => -2,
        };
        self.cameras.iter().map(number).collect()
    }

    /// Intrinsics, (3, 3) or (n_drones, 3, 3).
    fn k<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let numbers = self.cameras.iter().flat_map(|c| c.k().concat()).collect();
        let shape = if self.per_drone { vec![self.cameras.len(), 3, 3] } else { vec![3, 3] };
        arrays::owned(py, numbers, &shape)
    }
}
