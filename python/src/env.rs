//! The batch of worlds behind `propwash.envs`.

use std::sync::{Arc, Mutex, MutexGuard, TryLockError};

use numpy::{PyArrayDyn, PyArrayMethods, PyUntypedArrayMethods};
use propwash::arena::ArenaError;
use propwash::env::{Env, EnvConfig, EnvSensorChannel};
use propwash::rollout::pool::alone;
use propwash::sense::DepthFrame;
use pyo3::exceptions::{PyIndexError, PyKeyError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::ThreadPool;

use crate::arrays;
use crate::camera::CameraSpec;
use crate::errors::{Error, OrRaise};
use crate::learn::written_task;
use crate::sense::{Described, describe as describe_channel};
use crate::sim::describe;
use crate::task::{PyTask, TaskDraws};
use crate::threads;
use crate::vehicle::PyVehicle;

/// What views of the arrays keep alive.
#[pyclass(frozen, module = "propwash._native")]
struct EnvOwner {
    _env: Arc<Mutex<Env>>,
}

/// A batch of worlds to learn in.
#[pyclass(frozen, name = "Env", module = "propwash._native")]
pub struct PyEnv {
    env: Arc<Mutex<Env>>,
    owner: Py<EnvOwner>,
    pool: Arc<ThreadPool>,
    /// The process that made it.
    process: u32,
    runs: Runs,
    /// Shape of actions.
    action: [usize; 3],
    /// Numbers of actions, reused.
    numbers: Mutex<(Vec<f64>, Vec<f32>)>,
}

/// Where steps run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Runs {
    /// In the thread that calls, since there is too little for more of them.
    Here,
    /// There too, since there shall be one thread.
    Alone,
    /// In the threads of the pool.
    InPool,
}

impl PyEnv {
    fn run<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        match self.runs {
            Runs::Here => work(),
            Runs::Alone => alone(work),
            Runs::InPool => self.pool.install(work),
        }
    }

    fn env(&self) -> PyResult<MutexGuard<'_, Env>> {
        let process = std::process::id();
        if process != self.process {
            return Err(Error::new_err(format!(
                "this environment was made by process {} and this is process {process}, forked from it, in which its threads do \
                 not exist: make an environment of its own in each process, or start processes by `spawn`",
                self.process
            )));
        }
        match self.env.try_lock() {
            Ok(env) => Ok(env),
            Err(TryLockError::Poisoned(broken)) => Ok(broken.into_inner()),
            Err(TryLockError::WouldBlock) => Err(Error::new_err(
                "this environment is at work in another thread: wait until that call returns, or give each thread an \
                 environment of its own",
            )),
        }
    }

    fn world(&self, world: usize) -> PyResult<()> {
        if world < self.action[0] {
            return Ok(());
        }
        Err(PyIndexError::new_err(format!("world: expected less than {}, got {world}", self.action[0])))
    }

    /// A view of an array of a task written in Python.
    fn task_array<'py>(&self, py: Python<'py>, env: &mut Env, name: &str) -> PyResult<Bound<'py, PyAny>> {
        let owner = || self.owner.bind(py).clone().into_any();
        let [n, d, width] = self.action;
        let [w, h] = env.image_size();
        let unknown = || PyKeyError::new_err(format!("no array is called {name:?}"));
        macro_rules! view {
            ($numbers:expr, $shape:expr) => {
                // SAFETY: as in `array`; the arrays of a task and of the arena's obstacles are never replaced or resized either.
                unsafe { arrays::view($numbers, $shape, owner())? }.into_any()
            };
        }
        if matches!(name, "obstacle_pos" | "obstacle_quat") {
            let obstacles = env.obstacles();
            let m = obstacles.n_obstacles;
            return Ok(match name {
                "obstacle_pos" => view!(obstacles.pos_m, &[n, m, 3]),
                _ => view!(obstacles.quat_xyzw, &[n, m, 4]),
            });
        }
        let batch = env.batch().ok_or_else(unknown)?;
        let noisy = !batch.observed_pos.is_empty();
        let own = batch.channels.len() / (n * d);
        Ok(match name {
            "pos" => view!(&mut batch.pos, &[n, d, 3]),
            "quat" => view!(&mut batch.quat, &[n, d, 4]),
            "vel" => view!(&mut batch.vel, &[n, d, 3]),
            "ang_vel" => view!(&mut batch.ang_vel, &[n, d, 3]),
            "previous_pos" => view!(&mut batch.previous_pos, &[n, d, 3]),
            "observed_pos" if noisy => view!(&mut batch.observed_pos, &[n, d, 3]),
            "observed_quat" if noisy => view!(&mut batch.observed_quat, &[n, d, 4]),
            "observed_vel" if noisy => view!(&mut batch.observed_vel, &[n, d, 3]),
            "observed_ang_vel" if noisy => view!(&mut batch.observed_ang_vel, &[n, d, 3]),
            "task_clearance" => view!(&mut batch.clearance, &[n, d]),
            "crashed" => view!(&mut batch.crashed, &[n, d]),
            "true_depth" if w > 0 => view!(&mut batch.depth, &[n, d, h, w]),
            "action" => view!(&mut batch.action, &[n, d, width]),
            "action_change" => view!(&mut batch.action_change, &[n, d]),
            "time" => view!(&mut batch.time, &[n]),
            "step" => view!(&mut batch.step, &[n]),
            "episode" => view!(&mut batch.episode, &[n]),
            "layout" => view!(&mut batch.layout, &[n]),
            "begins" => view!(&mut batch.begins, &[n]),
            "goal_given" => view!(&mut batch.goal_given, &[n]),
            "start_pos" => view!(&mut batch.start_pos, &[n, d, 3]),
            "start_vel" => view!(&mut batch.start_vel, &[n, d, 3]),
            "start_yaw" => view!(&mut batch.start_yaw, &[n, d]),
            "goal_pos" if !batch.goal_pos.is_empty() => view!(&mut batch.goal_pos, &[n, d, 3]),
            "task_reward" => view!(&mut batch.reward, &[n, d]),
            "task_ending" => view!(&mut batch.ending, &[n]),
            "channels" => view!(&mut batch.channels, &[n, d, own]),
            _ => return Err(unknown()),
        })
    }
}

/// A seed of all worlds, or one for each.
#[derive(FromPyObject)]
enum Seeds {
    One(u64),
    Each(Vec<u64>),
}

#[pymethods]
impl PyEnv {
    /// `config`: a description in JSON. `task`: that of a task written in Python, also in JSON, what calls its methods, and its random
    /// numbers. `written`: a task of expressions, by name.
    #[new]
    #[pyo3(signature = (config, vehicles, threads = None, task = None, written = None))]
    fn new(
        py: Python<'_>,
        config: &str,
        vehicles: Vec<Py<PyVehicle>>,
        threads: Option<usize>,
        task: Option<(String, Py<PyAny>, Py<TaskDraws>)>,
        written: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let mut config = EnvConfig::from_text(config).or_raise()?;
        describe(&mut config.sim, &vehicles);
        let pool = threads::pool(threads)?;
        let task = match task {
            None => None,
            Some((described, calls, draws)) => Some(PyTask::new(&described, calls.bind(py), draws.get())?),
        };
        let written = written.map(written_task).transpose()?;
        let make = || match (task, written) {
            (Some(task), _) => Env::with_batch_task(config, Box::new(task)),
            (None, Some(task)) => Env::with_task(config, Arc::new(task)),
            (None, None) => Env::new(config),
        };
        let env = py.detach(|| pool.install(make)).or_raise()?;
        let action = [env.config().sim.options.n_worlds, env.config().sim.n_drones(), env.action_width()];
        let runs = match (env.is_parallel(), pool.current_num_threads() == 1 && env.can_be_alone()) {
            (false, _) => Runs::Here,
            (true, true) => Runs::Alone,
            (true, false) => Runs::InPool,
        };
        let env = Arc::new(Mutex::new(env));
        let owner = Py::new(py, EnvOwner { _env: env.clone() })?;
        let process = std::process::id();
        Ok(Self { env, owner, pool, process, runs, action, numbers: Mutex::default() })
    }

    /// Shape of actions: worlds, drones, numbers of each.
    #[getter]
    fn action_shape(&self) -> (usize, usize, usize) {
        self.action.into()
    }

    /// Names and widths of what is observed.
    fn channels(&self) -> PyResult<Vec<(String, usize)>> {
        Ok(self.env()?.channels().into_iter().map(|c| (c.name.into_owned(), c.width)).collect())
    }

    /// What sensors give: name in observations, name of the sensor, of the channel, unit, shape and type.
    fn sensor_channels(&self) -> PyResult<Vec<(String, Described)>> {
        let env = self.env()?;
        let of = |c: &EnvSensorChannel| (c.name.clone(), describe_channel(&c.sensor, &c.channel));
        Ok(env.sensor_channels().iter().map(of).collect())
    }

    /// A view of what a sensor sampled last, (n_worlds, n_drones, shape of the channel); `ended`: what worlds that ended in the last step
    /// had sampled.
    #[pyo3(signature = (sensor, channel, ended = false))]
    fn samples<'py>(
        &self,
        py: Python<'py>,
        sensor: &str,
        channel: &str,
        ended: bool,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let mut env = self.env()?;
        let known = env.sensor_channels().iter().find(|c| c.sensor == sensor && c.channel.name == channel);
        let shape = known.map_or(Vec::new(), |c| c.channel.shape.clone());
        let shape = [&self.action[..2], &shape[..]].concat();
        let values = match ended {
            true => env.final_samples(sensor, channel),
            false => env.samples(sensor, channel),
        };
        // SAFETY: as in `array`: arrays of samples are made with the arena and keep their place and length.
        unsafe { arrays::view(values.or_raise()?, &shape, self.owner.bind(py).clone().into_any()) }
    }

    /// Least and greatest actions, (n_drones, action).
    #[allow(clippy::type_complexity)]
    fn action_limits<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Bound<'py, PyArrayDyn<f32>>, Bound<'py, PyArrayDyn<f32>>)> {
        let (low, high) = self.env()?.action_limits();
        let shape = &self.action[1..];
        Ok((arrays::owned(py, low, shape)?, arrays::owned(py, high, shape)?))
    }

    /// Width and height of images, zero without a camera; least and greatest depth, m.
    fn image(&self) -> PyResult<([usize; 2], [f64; 2])> {
        let env = self.env()?;
        Ok((env.image_size(), env.depth_range_m()))
    }

    /// What it was made of, as JSON.
    fn config_json(&self) -> PyResult<String> {
        serde_json::to_string(self.env()?.config()).map_err(|e| Error::new_err(e.to_string()))
    }

    /// A view of the array called `name`.
    fn array<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        let mut env = self.env()?;
        let owner = || self.owner.bind(py).clone().into_any();
        let [n, d, _] = self.action;
        let [w, h] = env.image_size();
        let width: usize = env.channels().iter().map(|c| c.width).sum();
        // The owner holds the environment, whose arrays are made with it and never replaced or
        // resized; only calls on this object write to them. Those run Python code only within the methods of a task, during which
        // no reference to the numbers of these arrays is in use.
        macro_rules! view {
            ($numbers:expr, $shape:expr) => {
                // SAFETY: by what stands above.
                unsafe { arrays::view($numbers, $shape, owner())? }.into_any()
            };
        }
        Ok(match name {
            "observation" => view!(env.observation(), &[n, d, width]),
            "depth" if w > 0 => view!(env.depth(), &[n, d, h, w]),
            "reward" => view!(env.reward(), &[n, d]),
            "terminated" => view!(env.terminated(), &[n]),
            "truncated" => view!(env.truncated(), &[n]),
            "ending" => view!(env.ending(), &[n]),
            "clearance" => view!(env.clearance(), &[n, d]),
            "final_observation" => view!(env.final_observation(), &[n, d, width]),
            "final_depth" if w > 0 => view!(env.final_depth(), &[n, d, h, w]),
            _ => return self.task_array(py, &mut env, name),
        })
    }

    /// Whether goals may be given at a reset.
    fn has_goal(&self) -> PyResult<bool> {
        Ok(self.env()?.has_goal())
    }

    /// Begins new episodes in all worlds, or in those of the mask, with goals, (n_worlds, n_drones, 3), if there are some.
    /// `seed`: one for all worlds, or one for each.
    #[pyo3(signature = (seed = None, mask = None, goal = None))]
    fn reset(
        &self,
        py: Python<'_>,
        seed: Option<Seeds>,
        mask: Option<&Bound<'_, PyAny>>,
        goal: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        let [n, d, _] = self.action;
        let mask = arrays::mask("reset_mask", mask, n)?;
        let mut goals = Vec::new();
        if let Some(goal) = goal {
            arrays::numbers("goal", "(n_worlds, n_drones, 3)", goal, &[n, d, 3], &mut goals)?;
        }
        let goals = goal.is_some().then(|| goals.as_chunks::<3>().0);
        let mut env = self.env()?;
        let env = &mut *env;
        let reset = || match &seed {
            Some(Seeds::Each(seeds)) => env.reset_each(seeds, goals),
            Some(Seeds::One(seed)) => env.reset_to(Some(*seed), mask.as_deref(), goals),
            None => env.reset_to(None, mask.as_deref(), goals),
        };
        py.detach(|| self.run(reset)).or_raise()
    }

    /// Flies one step. Returns whether any episode ended, and whether any action was held within its limits.
    fn step(&self, py: Python<'_>, action: &Bound<'_, PyAny>) -> PyResult<(bool, bool)> {
        let mut env = self.env()?;
        let mut numbers = self.numbers.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let (wide, narrow) = &mut *numbers;
        narrow.clear();
        let exact =
            action.cast::<PyArrayDyn<f32>>().ok().filter(|a| a.shape() == self.action && a.is_c_contiguous());
        match exact {
            Some(array) => narrow.extend_from_slice(array.try_readonly()?.as_slice()?),
            None => {
                arrays::numbers("action", "(n_worlds, n_drones, action)", action, &self.action, wide)?;
                narrow.extend(wide.iter().map(|v| *v as f32));
            }
        }
        let env = &mut *env;
        py.detach(|| self.run(|| env.step(narrow))).or_raise()?;
        let ended = env.ending().iter().any(|e| *e != 0);
        Ok((ended, env.any_clipped()))
    }

    /// Worlds whose last action was held within its limits.
    fn clipped<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<bool>>> {
        let env = self.env()?;
        arrays::owned(py, (0..self.action[0]).map(|w| env.clipped(w)).collect(), &[self.action[0]])
    }

    /// Layout in which each world flies.
    fn layouts<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<i64>>> {
        let env = self.env()?;
        arrays::owned(py, (0..self.action[0]).map(|w| env.layout(w) as i64).collect(), &[self.action[0]])
    }

    /// What is in the scene of a layout, as JSON; none without a scene.
    fn scene_json(&self, layout: usize) -> PyResult<Option<String>> {
        Ok(self.env()?.scene(layout).map(crate::sense::description))
    }

    /// Levels of a world's episode, as JSON.
    fn levels_json(&self, world: usize) -> PyResult<String> {
        self.world(world)?;
        serde_json::to_string(self.env()?.levels(world)).map_err(|e| Error::new_err(e.to_string()))
    }

    /// Names and values of the parameters of one drone in one world.
    fn parameters(&self, world: usize, drone: usize) -> PyResult<Vec<(String, f64)>> {
        self.world(world)?;
        if drone >= self.action[1] {
            return Err(PyIndexError::new_err(format!(
                "drone: expected less than {}, got {drone}",
                self.action[1]
            )));
        }
        let mut of = self.env()?.flight().drone(world, drone).clone();
        let mut out = Vec::new();
        of.visit(&mut |name, value| out.push((name.to_string(), *value)));
        Ok(out)
    }

    /// Box around what stands in a layout, m; none for one without geoms, or without layouts.
    fn extent(&self, layout: usize) -> PyResult<Option<[[f64; 3]; 2]>> {
        Ok(self.env()?.course(layout).and_then(|c| c.extent_m))
    }

    /// What a camera sees in a world: depth, status, geom_id, normal by name.
    fn view<'py>(&self, py: Python<'py>, world: usize, camera: CameraSpec) -> PyResult<Bound<'py, PyDict>> {
        self.world(world)?;
        let env = self.env()?;
        let Some(scene) = env.scene(env.layout(world)) else {
            return Err(Error::new_err(
                "this environment has no scene to be shown: give it one, scene=\"path of an MJCF file\"",
            ));
        };
        let cameras = camera.build(scene)?;
        let mut frame = DepthFrame::new();
        let look = env.look();
        py.detach(|| -> Result<(), ArenaError> {
            Ok(cameras.cameras[0].render(&mut *look.world(world)?, &mut frame)?)
        })
        .or_raise()?;
        let shape = [frame.height, frame.width];
        let out = PyDict::new(py);
        let normal = frame.normal.take().unwrap_or_default();
        if !normal.is_empty() {
            let list = normal.into_iter().flatten().collect();
            out.set_item("normal", arrays::owned(py, list, &[frame.height, frame.width, 3])?)?;
        }
        out.set_item("depth", arrays::owned(py, frame.depth_m, &shape)?)?;
        out.set_item("status", arrays::owned(py, frame.status, &shape)?)?;
        out.set_item("geom_id", arrays::owned(py, frame.geom_id, &shape)?)?;
        Ok(out)
    }

    fn __reduce__(&self) -> PyResult<()> {
        Err(PyTypeError::new_err(
            "an environment cannot be pickled or copied: make one with the same arguments where it is needed",
        ))
    }
}

/// Names of the depth devices.
#[pyfunction]
pub fn depth_devices() -> Vec<&'static str> {
    propwash::sense::DEVICES.iter().map(|d| d.name).collect()
}

/// A description in TOML or JSON, completed, as JSON.
#[pyfunction]
pub fn env_config(text: &str) -> PyResult<String> {
    serde_json::to_string(&EnvConfig::from_text(text).or_raise()?)
        .map_err(|e| PyValueError::new_err(e.to_string()))
}

/// Rules of randomisation in TOML as JSON.
#[pyfunction]
pub fn rules_json(text: &str) -> PyResult<String> {
    let rules = propwash::rollout::randomize::Randomization::from_toml(text).or_raise()?;
    serde_json::to_string(&rules).map_err(|e| PyValueError::new_err(e.to_string()))
}
