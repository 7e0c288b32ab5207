//! What drones of a simulation see, touch and come near to in its scene.

use numpy::{Element, PyArrayDyn, PyArrayMethods, PyReadwriteArrayDyn, PyUntypedArrayMethods};
use propwash::arena::{ArenaError, Way};
use propwash::scene::{Pose, Scene};
use propwash::sense::{Camera, ChannelType, Clearance, Contact, DepthPlanes, SenseError, SensorChannel};
use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use serde_json::json;

use crate::arrays;
use crate::camera::{CameraSpec, PyCameras};
use crate::errors::{Error, IntoPython, OrRaise};
use crate::sim::{Core, Flight, PySim, either};

/// Results of senses, whose memory is reused.
#[derive(Default)]
pub struct Sensed {
    contacts: Vec<Vec<Contact>>,
    limited: Vec<usize>,
    clearance: Vec<Clearance>,
    camera_poses: Vec<Pose>,
}

impl Core {
    /// The simulation in its scenes, and where results go. Worlds whose drones stand nowhere, since the user wrote so, are quarantined.
    fn sensing(&mut self) -> PyResult<(&mut Flight, &mut Sensed)> {
        if !either!(&self.flight, arena => arena.has_scene()) {
            return Err(no_scene());
        }
        either!(&mut self.flight, arena => arena.set_aside_unplaceable());
        Ok((&mut self.flight, &mut self.sensed))
    }
}

/// The scene called by its number.
fn scene(flight: &Flight, index: usize) -> PyResult<Scene> {
    let (found, n) = either!(flight, arena => (arena.scenes().nth(index).cloned(), arena.scenes().len()));
    found.ok_or_else(|| PyIndexError::new_err(format!("scene: expected less than {n}, got {index}")))
}

/// What is in a scene, as JSON.
pub fn description(scene: &Scene) -> String {
    json!({
        "name": scene.name(), "geoms": scene.geoms(), "bodies": scene.bodies(), "cameras": scene.cameras(),
        "obstacles": scene.obstacles(), "warnings": scene.warnings(), "sha256": scene.hash(),
    })
    .to_string()
}

fn no_scene() -> PyErr {
    Error::new_err(
        "this Sim has no scene, in which drones could see or touch: make it with scene=\"path of an MJCF file\" or a name of \
         propwash.scenes(); for contacts and clearances between drones alone with scene=\"<mujoco/>\", which is empty",
    )
}

/// One error for all that went wrong in some worlds, by the numbers that the caller knows.
fn in_worlds(error: ArenaError, worlds: Option<&[usize]>) -> PyErr {
    match error {
        ArenaError::Sense(SenseError::Worlds { worlds: n, failures }) => {
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

/// A channel of a sensor: name of the sensor, of the channel, unit, shape and type.
pub type Described = (String, String, String, Vec<usize>, &'static str);

/// A channel as Python sees it.
pub fn describe(sensor: &str, channel: &SensorChannel) -> Described {
    let kind = match channel.kind {
        ChannelType::F32 => "float32",
        ChannelType::I32 => "int32",
        ChannelType::U8 => "uint8",
    };
    (sensor.into(), channel.name.to_string(), channel.unit.to_string(), channel.shape.clone(), kind)
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
            "{name} of out: expected an array of shape {}, writable and C-contiguous, got {got}",
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

impl PySim {
    /// A scene by its number.
    pub fn scene_of(&self, index: usize) -> PyResult<Scene> {
        let mut core = self.core()?;
        let (flight, _) = core.sensing()?;
        scene(flight, index)
    }
}

#[pymethods]
impl PySim {
    /// What is in a scene, as JSON.
    fn scene_json(&self, scene: usize) -> PyResult<String> {
        let mut core = self.core()?;
        let (flight, _) = core.sensing()?;
        Ok(description(&crate::sense::scene(flight, scene)?))
    }

    /// A compiled scene, as MuJoCo saves it (MJB).
    fn scene_mjb<'py>(&self, py: Python<'py>, scene: usize) -> PyResult<Bound<'py, PyBytes>> {
        let mut core = self.core()?;
        let (flight, _) = core.sensing()?;
        Ok(PyBytes::new(py, &crate::sense::scene(flight, scene)?.to_mjb()))
    }

    /// The cameras that `spec` describes in a scene: one for each drone, or one of the scene or the world.
    fn cameras(&self, spec: CameraSpec, scene: usize) -> PyResult<PyCameras> {
        let mut core = self.core()?;
        let (flight, _) = core.sensing()?;
        spec.build(&crate::sense::scene(flight, scene)?)
    }

    /// Renders into `planes` (depth, status, geom_id, body_id, normal: arrays or None), and returns positions and
    /// orientations of the cameras, of which there are those of each scene in the order of scenes.
    #[pyo3(signature = (cameras, worlds, planes))]
    #[allow(clippy::type_complexity)]
    fn render<'py>(
        &self,
        py: Python<'py>,
        cameras: Vec<Py<PyCameras>>,
        worlds: Option<Vec<usize>>,
        planes: &Bound<'py, PyDict>,
    ) -> PyResult<(Bound<'py, PyArrayDyn<f64>>, Bound<'py, PyArrayDyn<f64>>)> {
        self.check_worlds(worlds.as_deref())?;
        let mut core = self.core()?;
        let (flight, sensed) = core.sensing()?;
        let own = either!(&*flight, arena => arena.scenes().len() == cameras.len()
            && arena.scenes().zip(&cameras).all(|(scene, camera)| camera.get().belong_to(scene)));
        let Some(first) = cameras.first().map(Py::get).filter(|_| own) else {
            return Err(PyValueError::new_err(
                "camera: expected one of each of this Sim's scenes, in their order, got those of another Sim's scene",
            ));
        };
        let n_worlds = worlds.as_ref().map_or(self.n_worlds, Vec::len);
        let shape = first.shape(n_worlds);
        let image = [&shape[..], &[first.height(), first.width()]].concat();
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
        let lists: Vec<&[Camera]> = cameras.iter().map(|c| &c.get().cameras[..]).collect();
        let mut poses = std::mem::take(&mut sensed.camera_poses);
        poses.resize(n_worlds * first.cameras.len(), Pose::default());
        let done = either!(&*flight, arena => {
            let look = arena.look();
            py.detach(|| self.pool.install(|| look.render(&lists, worlds.as_deref(), out, &mut poses)))
        });
        let pos = poses.iter().flat_map(|p| p.pos_m).collect();
        let quat = poses.iter().flat_map(|p| p.quat_xyzw).collect();
        sensed.camera_poses = poses;
        done.map_err(|e| in_worlds(e, worlds.as_deref()))?;
        let of = |width: usize| [&shape[..], &[width]].concat();
        Ok((arrays::owned(py, pos, &of(3))?, arrays::owned(py, quat, &of(4))?))
    }

    /// All contacts as arrays by name, one entry for each contact in the order of worlds, which are those of the list
    /// or all; their numbers are places in it.
    #[pyo3(signature = (worlds = None))]
    fn contacts<'py>(&self, py: Python<'py>, worlds: Option<Vec<usize>>) -> PyResult<Bound<'py, PyDict>> {
        self.check_worlds(worlds.as_deref())?;
        let mut core = self.core()?;
        let (flight, Sensed { contacts, limited, .. }) = core.sensing()?;
        either!(flight, arena => {
            let look = arena.look();
            py.detach(|| self.pool.install(|| look.contacts(worlds.as_deref(), contacts, limited)))
        })
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

    /// Distance to the nearest obstacle of every drone as arrays by name, (n_worlds, n_drones, …), in the worlds of the
    /// list or all.
    #[pyo3(signature = (max_distance, worlds = None))]
    fn clearance<'py>(
        &self,
        py: Python<'py>,
        max_distance: f64,
        worlds: Option<Vec<usize>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        self.check_worlds(worlds.as_deref())?;
        let n_worlds = worlds.as_ref().map_or(self.n_worlds, Vec::len);
        let mut core = self.core()?;
        let (flight, Sensed { clearance, .. }) = core.sensing()?;
        if !(max_distance > 0.0 && max_distance < 1e9) {
            return Err(PyValueError::new_err(format!(
                "max_distance: expected metres between 0 and 1e9, got {max_distance}"
            )));
        }
        either!(flight, arena => {
            let look = arena.look();
            py.detach(|| self.pool.install(|| look.clearances(worlds.as_deref(), max_distance, clearance)))
        })
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
        out.set_item("known", flags(|c| c.away().is_some())?)?;
        let away = all.iter().flat_map(|c| c.away().unwrap_or([0.0; 3])).collect();
        out.set_item("away", arrays::owned(py, away, &points)?)?;
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

    /// What each drone touched first on its straight way from the poses given, positions (n_worlds, n_drones, 3) and attitudes
    /// (n_worlds, n_drones, 4), to where it is now, as arrays by name, one entry for each drone that touched something.
    fn swept<'py>(
        &self,
        py: Python<'py>,
        pos: &Bound<'_, PyAny>,
        quat: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let (mut places, mut attitudes) = (Vec::new(), Vec::new());
        arrays::numbers("pos", "(n_worlds, n_drones, 3)", pos, &self.shape(&[3]), &mut places)?;
        if let Some(quat) = quat {
            arrays::numbers("quat", "(n_worlds, n_drones, 4)", quat, &self.shape(&[4]), &mut attitudes)?;
        }
        let mut core = self.core()?;
        let (flight, _) = core.sensing()?;
        let ways = either!(flight, arena => {
            let look = arena.look();
            let mut before = look.poses();
            for (row, pose) in before.iter_mut().enumerate() {
                pose.pos_m.copy_from_slice(&places[3 * row..3 * row + 3]);
                if let Some(quat) = attitudes.get(4 * row..4 * row + 4) {
                    pose.quat_xyzw.copy_from_slice(quat);
                }
            }
            py.detach(|| self.pool.install(|| look.swept(&before, None)))
        })
        .map_err(|e| in_worlds(e, None))?;
        let n = ways.len();
        let out = PyDict::new(py);
        let ids = |name: &str, of: &dyn Fn(&Way) -> i32| -> PyResult<()> {
            out.set_item(name, arrays::owned(py, ways.iter().map(of).collect(), &[n])?)
        };
        ids("world", &|w| w.world as i32)?;
        ids("drone", &|w| w.drone as i32)?;
        ids("drone_geom", &|w| w.hit.drone_geom)?;
        ids("other_geom", &|w| w.hit.other_geom)?;
        ids("other_body", &|w| w.hit.other_body)?;
        ids("other_drone", &|w| w.hit.other_drone.map_or(-1, |d| d as i32))?;
        let all = || ways.iter().map(|w| &w.hit);
        out.set_item("fraction", arrays::owned(py, all().map(|h| h.fraction).collect(), &[n])?)?;
        out.set_item("pos", arrays::owned(py, all().flat_map(|h| h.pos_m).collect(), &[n, 3])?)?;
        out.set_item("point", arrays::owned(py, all().flat_map(|h| h.point_m).collect(), &[n, 3])?)?;
        out.set_item("normal", arrays::owned(py, all().flat_map(|h| h.normal).collect(), &[n, 3])?)?;
        out.set_item("exact", arrays::owned(py, all().map(|h| h.exact).collect(), &[n])?)?;
        Ok(out)
    }

    /// Writes the height of the scene under every drone into `data.ground_z`, in the worlds of the list or all; −∞ where there is
    /// nothing.
    #[pyo3(signature = (worlds = None))]
    fn measure_ground(&self, py: Python<'_>, worlds: Option<Vec<usize>>) -> PyResult<()> {
        self.check_worlds(worlds.as_deref())?;
        let mut core = self.core()?;
        let (flight, _) = core.sensing()?;
        either!(flight, arena => {
            py.detach(|| self.pool.install(|| arena.measure_ground(worlds.as_deref())))
        })
        .or_raise()
    }

    /// What the mounted sensors give: name of the sensor, of the channel, unit, shape and type.
    fn sensor_channels(&self) -> PyResult<Vec<Described>> {
        let core = self.core()?;
        either!(&core.flight, arena => {
            let names: Vec<String> = arena.sensor_names().map(str::to_owned).collect();
            let mut out = Vec::new();
            for (number, name) in names.into_iter().enumerate() {
                out.extend(arena.sensor_channels(number).or_raise()?.iter().map(|c| describe(&name, c)));
            }
            Ok(out)
        })
    }

    /// Lets a sensor sample all drones, in all worlds or in those of the mask.
    #[pyo3(signature = (sensor, mask = None))]
    fn sample(&self, py: Python<'_>, sensor: &str, mask: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        let mask = arrays::mask("mask", mask, self.n_worlds)?;
        let mut core = self.core()?;
        either!(&mut core.flight, arena => {
            let number = arena.sensor(sensor).or_raise()?;
            py.detach(|| self.pool.install(|| arena.sample(number, mask.as_deref())))
        })
        .map_err(|e| in_worlds(e, None))
    }

    /// What a sensor sampled last, (n_worlds, n_drones, shape of the channel), a new array.
    fn samples<'py>(
        &self,
        py: Python<'py>,
        sensor: &str,
        channel: &str,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let core = self.core()?;
        let (values, shape) = either!(&core.flight, arena => {
            let number = arena.sensor(sensor).or_raise()?;
            let values = arena.samples(number, channel).or_raise()?.to_vec();
            let channels = arena.sensor_channels(number).or_raise()?;
            (values, channels.iter().find(|c| c.name == channel).map_or(Vec::new(), |c| c.shape.clone()))
        });
        arrays::owned(py, values, &[&[self.n_worlds, self.n_drones], &shape[..]].concat())
    }

    /// Number of the scene of each world; none without a scene.
    #[getter]
    fn layout(&self) -> PyResult<Vec<usize>> {
        let core = self.core()?;
        Ok(either!(&core.flight, arena => arena.layout().to_vec()))
    }

    /// Moves worlds to other scenes, where obstacles of those that moved stand as the scene has them.
    fn set_layout(&self, layout: Vec<usize>) -> PyResult<()> {
        let mut core = self.core()?;
        let (flight, _) = core.sensing()?;
        either!(flight, arena => arena.set_layout(&layout)).or_raise()
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
