//! What drones of a simulation see, touch and come near to in its scene.

use std::path::Path;

use numpy::{Element, PyArrayDyn, PyArrayMethods, PyReadwriteArrayDyn, PyUntypedArrayMethods};
use propwash::scalar::lanes::Number;
use propwash::scene::{Pose, Scene, SceneError, SceneSource, Shell, WorkerPool};
use propwash::sense::{
    Clearance, Contact, DepthPlanes, SenseError, WorldPoses, clearance_batch, contacts_batch,
    render_batch_into,
};
use propwash::vehicle::Vehicle;
use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::prelude::*;
use serde_json::json;

use crate::arrays;
use crate::camera::{CameraSpec, PyCameras};
use crate::errors::{Error, IntoPython, OrRaise};
use crate::sim::{Core, Flight, PySim, either};

/// The scenes of a simulation, of which each world has one, and what it needs to sense in them.
pub struct Sensing {
    scenes: Vec<(Scene, WorkerPool)>,
    obstacle_pos: Vec<f64>,
    obstacle_quat: Vec<f64>,
    /// Poses of the worlds that are asked about.
    poses: Poses,
    contacts: Vec<Vec<Contact>>,
    limited: Vec<usize>,
    clearance: Vec<Clearance>,
    camera_poses: Vec<Pose>,
}

/// Poses of some worlds, in f64.
#[derive(Default)]
struct Poses {
    n_worlds: usize,
    drone_pos: Vec<f64>,
    drone_quat: Vec<f64>,
    obstacle_pos: Vec<f64>,
    obstacle_quat: Vec<f64>,
}

impl Poses {
    fn world_poses(&self) -> WorldPoses<'_> {
        WorldPoses {
            n_worlds: self.n_worlds,
            drone_pos_m: &self.drone_pos,
            drone_quat_xyzw: &self.drone_quat,
            obstacle_pos_m: Some(&self.obstacle_pos),
            obstacle_quat_xyzw: Some(&self.obstacle_quat),
        }
    }
}

impl Sensing {
    /// Of each scene its kind, `path`, or `xml` where its text is the MJCF itself; shells of the drones, or paths of other ones;
    /// the scene of each world.
    pub fn new(
        sources: &[(String, String)],
        drones: &[(&Vehicle, Option<&str>)],
        layout: &[usize],
    ) -> PyResult<Self> {
        let shells: Vec<Shell> = drones
            .iter()
            .map(|(vehicle, path)| match (path, vehicle.shell_path()) {
                (Some(path), _) => Shell::load(Path::new(path)),
                (None, Some(path)) => Shell::load(&path),
                (None, None) => Shell::builtin(&vehicle.shell),
            })
            .collect::<Result<_, _>>()
            .or_raise()?;
        let mut scenes: Vec<(Scene, WorkerPool)> = Vec::new();
        for (kind, text) in sources {
            let source = match kind.as_str() {
                "xml" => SceneSource::text("given as text", text),
                _ => SceneSource::file(text),
            };
            let scene = Scene::build(&source, &shells).or_raise()?;
            scenes.push((scene.clone(), WorkerPool::new(&scene)));
        }
        // Worlds in scenes with fewer have no numbers in the rows that are left.
        let most = scenes.iter().map(|(s, _)| s.obstacles().len()).max().unwrap_or(0);
        let of_worlds = |of: fn(&propwash::scene::ObstacleInfo) -> Vec<f64>, width: usize| -> Vec<f64> {
            let of_world = |i: &usize| {
                let mut rows: Vec<f64> = scenes[*i].0.obstacles().iter().flat_map(of).collect();
                rows.resize(most * width, f64::NAN);
                rows
            };
            layout.iter().flat_map(of_world).collect()
        };
        Ok(Self {
            obstacle_pos: of_worlds(|o| o.pos_m.to_vec(), 3),
            obstacle_quat: of_worlds(|o| o.quat_xyzw.to_vec(), 4),
            poses: Poses::default(),
            contacts: Vec::new(),
            limited: Vec::new(),
            clearance: Vec::new(),
            camera_poses: Vec::new(),
            scenes,
        })
    }

    /// Number of bodies that can be moved in the scene with most.
    pub fn n_obstacles(&self) -> usize {
        self.scenes.iter().map(|(s, _)| s.obstacles().len()).max().unwrap_or(0)
    }

    /// The scene called by its number.
    fn scene(&self, index: usize) -> PyResult<&Scene> {
        self.scenes.get(index).map(|(s, _)| s).ok_or_else(|| {
            PyIndexError::new_err(format!("scene: expected less than {}, got {index}", self.scenes.len()))
        })
    }

    /// The numbers of `obstacle_pos` or `obstacle_quat`.
    pub fn obstacle_array(&mut self, name: &str) -> &mut [f64] {
        if name == "obstacle_pos" { &mut self.obstacle_pos } else { &mut self.obstacle_quat }
    }

    /// Takes over the poses of the worlds asked about, all of them where `worlds` is none; they fly in the scene `scene`.
    fn load(&mut self, flight: &Flight, worlds: Option<&[usize]>, scene: usize) {
        let (n_obstacles, own) = (self.n_obstacles(), self.scenes[scene].0.obstacles().len());
        let n_drones = self.scenes.first().map_or(0, |(s, _)| s.n_drones());
        let poses = &mut self.poses;
        for list in
            [&mut poses.drone_pos, &mut poses.drone_quat, &mut poses.obstacle_pos, &mut poses.obstacle_quat]
        {
            list.clear();
        }
        let n_worlds = either!(flight, sim => sim.data.n_worlds);
        poses.n_worlds = worlds.map_or(n_worlds, <[usize]>::len);
        for k in 0..poses.n_worlds {
            let w = worlds.map_or(k, |list| list[k]);
            let rows = |width: usize, n: usize| width * n * w..width * n * (w + 1);
            either!(flight, sim => {
                poses.drone_pos.extend(sim.data.pos[rows(3, n_drones)].iter().map(|v| v.wide()));
                poses.drone_quat.extend(sim.data.quat[rows(4, n_drones)].iter().map(|v| v.wide()));
            });
            poses.obstacle_pos.extend_from_slice(&self.obstacle_pos[rows(3, n_obstacles)][..3 * own]);
            poses.obstacle_quat.extend_from_slice(&self.obstacle_quat[rows(4, n_obstacles)][..4 * own]);
        }
    }
}

impl Core {
    fn sensing(&mut self) -> PyResult<(&Flight, &mut Sensing)> {
        match &mut self.sensing {
            Some(sensing) => Ok((&self.flight, sensing)),
            None => Err(no_scene()),
        }
    }
}

fn no_scene() -> PyErr {
    Error::new_err(
        "this Sim has no scene, in which drones could see or touch: make it with scene=\"path of an MJCF file\"",
    )
}

/// One error for all that went wrong in some worlds, by the numbers that the caller knows.
fn in_worlds(error: SenseError, worlds: Option<&[usize]>) -> PyErr {
    match error {
        SenseError::Worlds { worlds: n, failures } => {
            let list: Vec<String> = failures
                .iter()
                .take(3)
                .map(|(w, e)| format!("world {}: {e}", worlds.map_or(*w, |list| list[*w])))
                .collect();
            let more = if failures.len() > list.len() { "; …" } else { "" };
            Error::new_err(format!("{} of {n} worlds failed; {}{more}", failures.len(), list.join("; ")))
        }
        other => other.into_python(),
    }
}

/// An array of the caller that a plane of images goes into.
type Plane<'py, T> = Option<PyReadwriteArrayDyn<'py, T>>;

fn plane<'py, T: Element>(
    planes: &Bound<'py, PyDict>,
    name: &str,
    shape: &[usize],
) -> PyResult<Plane<'py, T>> {
    let Some(value) = planes.get_item(name)? else { return Ok(None) };
    if value.is_none() {
        return Ok(None);
    }
    let fault = |got: String| {
        PyValueError::new_err(format!(
            "{name} of out: expected a writable array of shape {}, C-contiguous, got {got}",
            arrays::tuple(shape)
        ))
    };
    let array = value.cast_into::<PyArrayDyn<T>>().map_err(|e| fault(e.to_string()))?;
    if array.shape() != shape || !array.is_c_contiguous() {
        let order = if array.is_c_contiguous() { "" } else { ", not contiguous" };
        return Err(fault(format!("shape {}{order}", arrays::tuple(array.shape()))));
    }
    Ok(Some(array.try_readwrite().map_err(|e| fault(e.to_string()))?))
}

/// The numbers of a plane.
fn slice<'a, T: Element>(plane: &'a mut Plane<'_, T>) -> PyResult<Option<&'a mut [T]>> {
    plane.as_mut().map(|p| p.as_slice_mut().map_err(Into::into)).transpose()
}

#[pymethods]
impl PySim {
    /// What is in a scene, as JSON.
    fn scene_json(&self, scene: usize) -> PyResult<String> {
        let mut core = self.core()?;
        let (_, sensing) = core.sensing()?;
        let scene = sensing.scene(scene)?;
        Ok(json!({
            "name": scene.name(), "geoms": scene.geoms(), "bodies": scene.bodies(), "cameras": scene.cameras(),
            "obstacles": scene.obstacles(), "warnings": scene.warnings(), "sha256": scene.hash(),
        })
        .to_string())
    }

    /// The cameras that `spec` describes in a scene: one for each drone, or one of the scene or the world.
    fn cameras(&self, spec: CameraSpec, scene: usize) -> PyResult<PyCameras> {
        let mut core = self.core()?;
        let (_, sensing) = core.sensing()?;
        spec.build(sensing.scene(scene)?)
    }

    /// Renders into `planes` (depth, status, geom_id, body_id, normal: arrays or None), and returns positions and
    /// orientations of the cameras.
    #[pyo3(signature = (cameras, worlds, planes))]
    #[allow(clippy::type_complexity)]
    fn render<'py>(
        &self,
        py: Python<'py>,
        cameras: &Bound<'py, PyCameras>,
        worlds: Option<Vec<usize>>,
        planes: &Bound<'py, PyDict>,
    ) -> PyResult<(Bound<'py, PyArrayDyn<f64>>, Bound<'py, PyArrayDyn<f64>>)> {
        self.check_worlds(worlds.as_deref())?;
        let cameras = cameras.get();
        let n_worlds = worlds.as_ref().map_or(self.n_worlds, Vec::len);
        let shape = cameras.shape(n_worlds);
        let image = [&shape[..], &[cameras.height(), cameras.width()]].concat();
        let mut depth = plane::<f32>(planes, "depth", &image)?;
        let mut status = plane::<u8>(planes, "status", &image)?;
        let mut geom = plane::<i32>(planes, "geom_id", &image)?;
        let mut body = plane::<i32>(planes, "body_id", &image)?;
        let mut normal = plane::<f32>(planes, "normal", &[&image[..], &[3]].concat())?;
        let out = DepthPlanes {
            depth_m: slice(&mut depth)?,
            status: slice(&mut status)?,
            geom_id: slice(&mut geom)?,
            body_id: slice(&mut body)?,
            normal: slice(&mut normal)?.map(|n| n.as_chunks_mut::<3>().0),
        };
        let mut core = self.core()?;
        let (flight, sensing) = core.sensing()?;
        let Some(scene) = sensing.scenes.iter().position(|(s, _)| cameras.belong_to(s)) else {
            return Err(PyValueError::new_err(
                "camera: expected one of this Sim, got one of another Sim's scene",
            ));
        };
        sensing.load(flight, worlds.as_deref(), scene);
        let mut poses = std::mem::take(&mut sensing.camera_poses);
        poses.resize(n_worlds * cameras.cameras.len(), Pose::default());
        let done = py.detach(|| {
            self.pool.install(|| {
                let at = sensing.poses.world_poses();
                render_batch_into(&sensing.scenes[scene].1, &cameras.cameras, &at, out, &mut poses)
            })
        });
        let pos = poses.iter().flat_map(|p| p.pos_m).collect();
        let quat = poses.iter().flat_map(|p| p.quat_xyzw).collect();
        sensing.camera_poses = poses;
        done.map_err(|e| in_worlds(e, worlds.as_deref()))?;
        let of = |width: usize| [&shape[..], &[width]].concat();
        Ok((arrays::owned(py, pos, &of(3))?, arrays::owned(py, quat, &of(4))?))
    }

    /// All contacts in a scene as arrays by name, one entry for each contact in the order of worlds, which are those of the list
    /// or all; their numbers are places in it.
    #[pyo3(signature = (scene, worlds))]
    fn contacts<'py>(
        &self,
        py: Python<'py>,
        scene: usize,
        worlds: Option<Vec<usize>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        self.check_worlds(worlds.as_deref())?;
        let mut core = self.core()?;
        let (flight, sensing) = core.sensing()?;
        sensing.scene(scene)?;
        sensing.load(flight, worlds.as_deref(), scene);
        let Sensing { scenes, poses, contacts, limited, .. } = sensing;
        let at = poses.world_poses();
        py.detach(|| self.pool.install(|| contacts_batch(&scenes[scene].1, &at, contacts, limited)))
            .map_err(|e| in_worlds(e, worlds.as_deref()))?;
        let all = || contacts.iter().enumerate().flat_map(|(w, list)| list.iter().map(move |c| (w, c)));
        let n = all().count();
        let out = PyDict::new(py);
        let ids = |name: &str, of: &dyn Fn(usize, &Contact) -> i32| -> PyResult<()> {
            let list: Vec<i32> = all().map(|(w, c)| of(w, c)).collect();
            out.set_item(name, arrays::owned(py, list, &[n])?)
        };
        ids("world", &|w, _| w as i32)?;
        ids("drone", &|_, c| c.drone as i32)?;
        ids("other_drone", &|_, c| c.other_drone.map_or(-1, |d| d as i32))?;
        ids("drone_geom", &|_, c| c.drone_geom)?;
        ids("drone_body", &|_, c| c.drone_body)?;
        ids("other_geom", &|_, c| c.other_geom)?;
        ids("other_body", &|_, c| c.other_body)?;
        ids("other_flex", &|_, c| c.other_flex)?;
        out.set_item("distance", arrays::owned(py, all().map(|(_, c)| c.distance_m).collect(), &[n])?)?;
        out.set_item("point", arrays::owned(py, all().flat_map(|(_, c)| c.point_m).collect(), &[n, 3])?)?;
        out.set_item("normal", arrays::owned(py, all().flat_map(|(_, c)| c.normal).collect(), &[n, 3])?)?;
        let limited: Vec<i64> = limited.iter().map(|n| *n as i64).collect();
        let n_worlds = limited.len();
        out.set_item("limited", arrays::owned(py, limited, &[n_worlds])?)?;
        Ok(out)
    }

    /// Distance to the nearest obstacle of every drone in a scene as arrays by name, (n_worlds, n_drones, …), in the worlds of the
    /// list or all.
    #[pyo3(signature = (max_distance, scene, worlds))]
    fn clearance<'py>(
        &self,
        py: Python<'py>,
        max_distance: f64,
        scene: usize,
        worlds: Option<Vec<usize>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        self.check_worlds(worlds.as_deref())?;
        let n_worlds = worlds.as_ref().map_or(self.n_worlds, Vec::len);
        let mut core = self.core()?;
        let (flight, sensing) = core.sensing()?;
        if !(max_distance > 0.0 && max_distance < 1e9) {
            return Err(PyValueError::new_err(format!(
                "max_distance: expected metres between 0 and 1e9, got {max_distance}"
            )));
        }
        sensing.scene(scene)?;
        sensing.load(flight, worlds.as_deref(), scene);
        let Sensing { scenes, poses, clearance, .. } = sensing;
        let at = poses.world_poses();
        py.detach(|| self.pool.install(|| clearance_batch(&scenes[scene].1, &at, max_distance, clearance)))
            .map_err(|e| in_worlds(e, worlds.as_deref()))?;
        let all = &*clearance;
        let shape = [n_worlds, self.n_drones];
        let points = [n_worlds, self.n_drones, 3];
        let out = PyDict::new(py);
        let ids = |name: &str, of: &dyn Fn(&Clearance) -> i32| -> PyResult<()> {
            out.set_item(name, arrays::owned(py, all.iter().map(of).collect(), &shape)?)
        };
        ids("drone_geom", &|c| c.drone_geom)?;
        ids("other_geom", &|c| c.other_geom)?;
        ids("other_body", &|c| c.other_body)?;
        ids("other_drone", &|c| c.other_drone.map_or(-1, |d| d as i32))?;
        let flags = |of: fn(&Clearance) -> bool| arrays::owned(py, all.iter().map(of).collect(), &shape);
        out.set_item("found", flags(|c| c.found)?)?;
        out.set_item("exact", flags(|c| c.exact)?)?;
        out.set_item("distance", arrays::owned(py, all.iter().map(|c| c.distance_m).collect(), &shape)?)?;
        out.set_item(
            "on_drone",
            arrays::owned(py, all.iter().flat_map(|c| c.on_drone_m).collect(), &points)?,
        )?;
        out.set_item(
            "on_other",
            arrays::owned(py, all.iter().flat_map(|c| c.on_other_m).collect(), &points)?,
        )?;
        Ok(out)
    }

    /// Writes the height of a scene under every drone into `data.ground_z`, in the worlds of the list or all; −∞ where there is
    /// nothing.
    #[pyo3(signature = (scene, worlds))]
    fn measure_ground(&self, py: Python<'_>, scene: usize, worlds: Option<Vec<usize>>) -> PyResult<()> {
        self.check_worlds(worlds.as_deref())?;
        let n_worlds = worlds.as_ref().map_or(self.n_worlds, Vec::len);
        let mut core = self.core()?;
        core.sensing()?;
        let Core { flight, sensing, .. } = &mut *core;
        let Some(sensing) = sensing else { return Err(no_scene()) };
        sensing.scene(scene)?;
        sensing.load(flight, worlds.as_deref(), scene);
        let Sensing { scenes, poses, .. } = sensing;
        let (at, pool) = (poses.world_poses(), &scenes[scene].1);
        let n_drones = self.n_drones;
        let heights: Vec<Result<Vec<f64>, SceneError>> = py.detach(|| {
            self.pool.install(|| {
                (0..n_worlds)
                    .into_par_iter()
                    .map(|k| {
                        pool.with(|worker| {
                            at.apply(k, worker)?;
                            (0..n_drones)
                                .map(|d| {
                                    let z = at.drone_pos_m[3 * (k * n_drones + d) + 2];
                                    Ok(worker
                                        .ground_distance(d)?
                                        .map_or(f64::NEG_INFINITY, |below| z - below))
                                })
                                .collect()
                        })?
                    })
                    .collect()
            })
        });
        for (k, list) in heights.into_iter().enumerate() {
            let world = worlds.as_ref().map_or(k, |list| list[k]);
            for (drone, z) in list.or_raise()?.into_iter().enumerate() {
                let row = world * n_drones + drone;
                match flight {
                    Flight::F32(sim) => sim.data.ground_z[row] = z as f32,
                    Flight::F64(sim) => sim.data.ground_z[row] = z,
                }
            }
        }
        Ok(())
    }
}

impl PySim {
    fn check_worlds(&self, worlds: Option<&[usize]>) -> PyResult<()> {
        match worlds.unwrap_or_default().iter().find(|w| **w >= self.n_worlds) {
            None => Ok(()),
            Some(odd) => Err(PyIndexError::new_err(format!(
                "worlds: expected numbers below {}, the number of worlds, got {odd}",
                self.n_worlds
            ))),
        }
    }
}
