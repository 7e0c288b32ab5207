//! Records what a `Sim` flies into a data set.

use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, TryLockError};

use propwash::dataset::{RecordOptions, Recorder};
use propwash::sense::DepthNoise;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::arrays;
use crate::camera::PyCameras;
use crate::errors::{Error, OrRaise, read_json};
use crate::sim::{Flight, PySim, either};

/// The compiled side of `propwash.Recorder`.
#[pyclass(frozen, name = "Recorder", module = "propwash._native")]
pub struct PyRecorder {
    sim: Py<PySim>,
    recorder: Mutex<Recorder>,
}

impl PyRecorder {
    fn recorder(&self) -> PyResult<MutexGuard<'_, Recorder>> {
        match self.recorder.try_lock() {
            Ok(recorder) => Ok(recorder),
            Err(TryLockError::Poisoned(broken)) => Ok(broken.into_inner()),
            Err(TryLockError::WouldBlock) => Err(Error::new_err(
                "this Recorder is at work in another thread: wait until that call returns",
            )),
        }
    }
}

#[pymethods]
impl PyRecorder {
    #[new]
    #[pyo3(signature = (out, sim, seconds, episodes, fps, log_hz, normals, clearance_max_m, cameras, noise))]
    #[allow(clippy::too_many_arguments)]
    fn new(
        py: Python<'_>,
        out: PathBuf,
        sim: Py<PySim>,
        seconds: f64,
        episodes: usize,
        fps: u32,
        log_hz: u32,
        normals: bool,
        clearance_max_m: f64,
        cameras: Option<Py<PyCameras>>,
        noise: Option<&str>,
    ) -> PyResult<Self> {
        let noise: Option<DepthNoise> = noise.map(|text| read_json("noise", text)).transpose()?;
        let cameras = match &cameras {
            Some(cameras) if !cameras.get().per_drone => {
                return Err(PyValueError::new_err(
                    "camera: expected one that every drone carries, such as Camera(\"fpv\") or Camera(mount=\"drone\"), got one of \
                     the scene",
                ));
            }
            Some(cameras) => Some(cameras.get().cameras.clone()),
            None => None,
        };
        let options =
            RecordOptions { seconds, episodes, fps, log_hz, normals, clearance_max_m, cameras, noise };
        let setup = &sim.get().setup;
        let recorder = py.detach(|| Recorder::new(&out, setup, &options)).or_raise()?;
        Ok(Self { sim, recorder: Mutex::new(recorder) })
    }

    /// Steps of a flight.
    #[getter]
    fn n_steps(&self) -> PyResult<u64> {
        Ok(self.recorder()?.n_steps())
    }

    /// Whether a flight is being recorded.
    #[getter]
    fn flying(&self) -> PyResult<bool> {
        Ok(self.recorder()?.is_flying())
    }

    /// What was found and repaired at the start.
    fn warnings(&self) -> PyResult<Vec<String>> {
        Ok(self.recorder()?.warnings().to_vec())
    }

    /// Begins the next episode; false: its worlds are there already.
    fn begin(&self) -> PyResult<bool> {
        let mut recorder = self.recorder()?;
        let core = self.sim.get().core()?;
        either!(&core.flight, arena => recorder.begin(arena)).or_raise()
    }

    /// Records and flies some steps; false: the flight is over.
    fn step(&self, py: Python<'_>, n_steps: usize, data: Py<PyAny>) -> PyResult<bool> {
        let mut recorder = self.recorder()?;
        let recorder = &mut *recorder;
        let sim = self.sim.get();
        let mut core = sim.core()?;
        sim.step_one_by_one(py, n_steps, data, || {
            either!(&mut core.flight, arena => {
                py.detach(|| sim.pool.install(|| recorder.step(arena))).or_raise()
            })
        })
    }

    /// Ends the flight of the worlds of a mask.
    fn end(&self, mask: &Bound<'_, PyAny>) -> PyResult<()> {
        let mut recorder = self.recorder()?;
        let sim = self.sim.get();
        let mask = arrays::mask("mask", Some(mask), sim.n_worlds)?.unwrap_or_default();
        let core = sim.core()?;
        either!(&core.flight, arena => recorder.end(arena, &mask)).or_raise()
    }

    /// Seals the data set: its worlds, those that were quarantined, and its images.
    fn finish(&self, py: Python<'_>) -> PyResult<(usize, usize, u64)> {
        let recorder = self.recorder()?;
        let recorder = &*recorder;
        let summary = py.detach(|| recorder.finish()).or_raise()?;
        Ok((summary.n_worlds, summary.n_quarantined, summary.n_images))
    }
}
