//! Tasks written in Python, as the tasks of a batch: `propwash.envs.Task`.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use numpy::{PyArrayDyn, PyReadonlyArray1};
use propwash::arena::{CameraConfig, SceneConfig};
use propwash::env::{
    Batch, BatchObstacles, BatchTask, Channel, Draw, EnvError, FreePlace, TaskConfig, episode_stream,
};
use propwash::random::Stream;
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyString, PyWeakrefMethods, PyWeakrefReference};
use serde::Deserialize;
use serde_json::Value;

use crate::arrays;
use crate::errors::{Error, read_json, read_value};

/// What a task says of itself.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Described {
    name: String,
    channels: Vec<(String, usize)>,
    start: Option<([[f64; 3]; 2], f64)>,
    goal: Option<([[f64; 3]; 2], f64)>,
    has_goal: bool,
    moves_obstacles: bool,
    scene: SceneConfig,
    layouts: Option<usize>,
    camera: Option<CameraConfig>,
}

/// Random numbers while a method of a task runs: one stream for each world, which goes on from call to call.
#[derive(Default)]
struct Draws {
    /// Seed and number of each world. (world)
    origins: Vec<(u64, u64)>,
    /// What the method is for; none between methods.
    what: Option<Draw>,
    /// Made at the first call. (world)
    streams: Vec<Option<Stream>>,
}

/// The random numbers of a task's worlds.
#[pyclass(frozen, module = "propwash._native")]
pub struct TaskDraws(Arc<Mutex<Draws>>);

impl TaskDraws {
    /// `n` numbers for each drone of each world, by `draw` from its stream and the number among the `n`.
    fn fill<'py>(
        &self,
        py: Python<'py>,
        shape: [usize; 3],
        [episode, step]: [PyReadonlyArray1<'py, i64>; 2],
        begins: &PyReadonlyArray1<'py, bool>,
        draw: impl Fn(&mut Stream, usize) -> f64,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let mut draws = lock(&self.0);
        let Some(what) = draws.what else {
            return Err(PyRuntimeError::new_err(
                "random numbers of worlds: expected a call within on_reset, before_step, reward, terminated or observe, by the \
                 thread that runs it",
            ));
        };
        let [n, d, k] = shape;
        if draws.streams.is_empty() {
            let (episode, step) = (episode.as_slice()?, step.as_slice()?);
            let begins = begins.as_slice()?;
            let stream = |w: usize| {
                let step = if what == Draw::Reset { 0 } else { step[w] };
                let is_wanted = what != Draw::Reset || begins[w];
                is_wanted.then(|| episode_stream(draws.origins[w], episode[w] as u64, step as u64, what))
            };
            draws.streams = (0..n).map(stream).collect();
        }
        let mut out = vec![f32::NAN; n * d * k];
        for (stream, row) in draws.streams.iter_mut().zip(out.chunks_exact_mut((d * k).max(1))) {
            if let Some(stream) = stream {
                row.iter_mut().enumerate().for_each(|(i, v)| *v = draw(stream, i % k) as f32);
            }
        }
        arrays::owned(py, out, &shape)
    }
}

#[pymethods]
impl TaskDraws {
    #[new]
    fn new() -> Self {
        Self(Arc::default())
    }

    /// Uniform between `low` and `high`, (n) each. (world, drone, n)
    fn uniform<'py>(
        &self,
        py: Python<'py>,
        shape: [usize; 2],
        keys: [PyReadonlyArray1<'py, i64>; 2],
        begins: PyReadonlyArray1<'py, bool>,
        low: Vec<f64>,
        high: Vec<f64>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let [n, d] = shape;
        if low.len() != high.len() {
            return Err(PyValueError::new_err("uniform: low and high differ in length"));
        }
        self.fill(py, [n, d, low.len()], keys, &begins, |stream, i| stream.uniform(low[i], high[i]))
    }

    /// Standard normal. (world, drone, n)
    fn normal<'py>(
        &self,
        py: Python<'py>,
        shape: [usize; 3],
        keys: [PyReadonlyArray1<'py, i64>; 2],
        begins: PyReadonlyArray1<'py, bool>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        self.fill(py, shape, keys, &begins, |stream, _| stream.normal())
    }
}

fn lock(draws: &Mutex<Draws>) -> MutexGuard<'_, Draws> {
    draws.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A task whose methods are those of an object of Python.
pub struct PyTask {
    described: Described,
    /// What calls the user's methods. It is owned by the environment of Python, whose arrays it views: a strong reference from here
    /// would keep all of them alive for ever.
    calls: Py<PyWeakrefReference>,
    draws: Arc<Mutex<Draws>>,
}

impl PyTask {
    /// `described` in JSON; `calls` has the methods `on_reset`, `before_step`, `judge` and `observe`.
    pub fn new(described: &str, calls: &Bound<'_, PyAny>, draws: &TaskDraws) -> PyResult<Self> {
        let value: Value = read_json("task", described)?;
        let name = value["name"].as_str().unwrap_or("task").to_string();
        // Those that come from the user as they are.
        read_value::<SceneConfig>(&format!("{name}.scene"), value["scene"].clone())?;
        read_value::<Option<CameraConfig>>(&format!("{name}.camera"), value["camera"].clone())?;
        let described = read_value(&name, value)?;
        let calls = PyWeakrefReference::new(calls)?.unbind();
        Ok(Self { described, calls, draws: draws.0.clone() })
    }

    /// Calls a method, in which random numbers are those for `what`. The caller has let go of the interpreter.
    fn call(
        &self,
        batch: &Batch,
        what: Draw,
        method: impl Fn(Python<'_>) -> Bound<'_, PyString>,
    ) -> Result<(), EnvError> {
        {
            let mut draws = lock(&self.draws);
            draws.what = Some(what);
            draws.origins.clear();
            draws.origins.extend((0..batch.n_worlds).map(|w| batch.origin(w)));
            draws.streams.clear();
        }
        let outcome = Python::attach(|py| {
            let Some(calls) = self.calls.bind(py).upgrade() else {
                return Err(Error::new_err("the environment of this task is gone"));
            };
            calls.call_method0(method(py)).map(drop)
        });
        lock(&self.draws).what = None;
        outcome.map_err(|e| EnvError::Failed(Box::new(e)))
    }
}

fn place(described: Option<([[f64; 3]; 2], f64)>) -> Option<FreePlace> {
    described.map(|(space_m, clearance_m)| FreePlace { space_m, clearance_m })
}

impl BatchTask for PyTask {
    fn name(&self) -> &str {
        &self.described.name
    }

    fn scene(&self) -> (SceneConfig, Option<usize>) {
        (self.described.scene.clone(), self.described.layouts)
    }

    fn camera(&self) -> Option<CameraConfig> {
        self.described.camera.clone()
    }

    fn channels(&self) -> Vec<Channel> {
        self.described.channels.iter().map(|(name, width)| Channel::new(name.clone(), *width)).collect()
    }

    fn start_place(&self) -> Option<FreePlace> {
        place(self.described.start)
    }

    fn goal_place(&self) -> Option<FreePlace> {
        place(self.described.goal)
    }

    fn has_goal(&self) -> bool {
        self.described.has_goal
    }

    fn on_reset(&mut self, batch: &mut Batch, _: &mut BatchObstacles) -> Result<(), EnvError> {
        self.call(batch, Draw::Reset, |py| intern!(py, "on_reset").clone())
    }

    fn before_step(&mut self, batch: &mut Batch, _: &mut BatchObstacles) -> Result<(), EnvError> {
        if !self.described.moves_obstacles {
            return Ok(());
        }
        self.call(batch, Draw::Step, |py| intern!(py, "before_step").clone())
    }

    fn judge(&mut self, batch: &mut Batch) -> Result<(), EnvError> {
        self.call(batch, Draw::Judge, |py| intern!(py, "judge").clone())
    }

    fn observe(&mut self, batch: &mut Batch) -> Result<(), EnvError> {
        self.call(batch, Draw::Observe, |py| intern!(py, "observe").clone())
    }
}

/// The built-in tasks: name, name in camel case, what an environment is made with unless its user says otherwise as JSON.
#[pyfunction]
pub fn built_in_tasks() -> PyResult<Vec<(&'static str, &'static str, String)>> {
    let each = TaskConfig::built_in().into_iter().map(|task| {
        let defaults = serde_json::to_string(&task.defaults).map_err(|e| Error::new_err(e.to_string()))?;
        Ok((task.name, task.title, defaults))
    });
    each.collect()
}
