//! The simulation behind `propwash.Sim`: its state, its commands and its steps. What it senses is in `sense.rs`.

use std::collections::BTreeMap;
use std::ffi::CString;
use std::sync::{Arc, Mutex, MutexGuard, TryLockError};
use std::time::Instant;

use numpy::PyArrayDyn;
use propwash::arena::{Arena, ArenaError, CameraConfig, MountConfig, Precision, Setup, SimConfig};
use propwash::dataset::recorder::FlightConfig;
use propwash::math::quat;
use propwash::physics::controllers::{ControlMode, Rates};
use propwash::physics::rigid_body::State;
use propwash::rollout::pool::alone;
use propwash::rollout::quarantine::Quarantine;
use propwash::scalar::lanes::Number;
use propwash::scene::Pose;
use pyo3::exceptions::{PyIndexError, PyKeyError, PyRuntimeWarning, PyTypeError, PyValueError};
use pyo3::gc::{PyTraverseError, PyVisit};
use pyo3::prelude::*;
use rayon::ThreadPool;
use serde_json::json;

use crate::arrays;
use crate::doubt;
use crate::errors::{Error, OrRaise};
use crate::sense::Sensed;
use crate::stages::{Call, Place, RestOnGround, Slot, lock};
use crate::threads::{self, LOOK};
use crate::vehicle::{PyVehicle, by_mode};

/// Steps of the smallest part of a call: to bring worlds into lanes and back costs as much as six of them.
const LEAST_STEPS: usize = 8;

/// A simulation of either number, in its scenes.
pub enum Flight {
    F32(Box<Arena<f32>>),
    F64(Box<Arena<f64>>),
}

/// The same expression for a simulation of either number.
macro_rules! either {
    ($flight:expr, $arena:ident => $body:expr) => {
        match $flight {
            Flight::F32($arena) => $body,
            Flight::F64($arena) => $body,
        }
    };
}
pub(crate) use either;

/// Everything of one simulation that a call may change.
pub struct Core {
    pub flight: Flight,
    /// Results of senses, reused.
    pub sensed: Sensed,
    /// Numbers of commands, reused.
    numbers: Vec<f64>,
    /// Quarantined worlds that were told of.
    told: usize,
    /// Greatest sizes that a command's numbers may have without a closer look, (drone, command_width).
    limits: Vec<f64>,
    /// Whether a command beyond limits was told of.
    doubted: bool,
}

impl Core {
    /// Number of quarantined worlds.
    pub fn quarantined(&self) -> usize {
        either!(&self.flight, arena => arena.sim().n_quarantined())
    }

    /// Worlds that are quarantined now are not told of again.
    pub fn known_quarantine(&mut self) {
        self.told = either!(&self.flight, arena => arena.sim().n_quarantined());
    }
}

/// Owner of the arrays, which their views keep alive. It is an object of its own, apart from the one that holds stages: the
/// garbage collector does not see what arrays hold, and would never free a stage that holds its simulation.
#[pyclass(frozen, module = "propwash._native")]
struct Owner {
    _core: Arc<Mutex<Core>>,
}

/// The compiled side of `propwash.Sim`.
#[pyclass(frozen, name = "Sim", module = "propwash._native")]
pub struct PySim {
    core: Arc<Mutex<Core>>,
    /// What views of the arrays keep alive.
    owner: Py<Owner>,
    /// Stages that are written in Python, apart so that the garbage collector finds them while a step runs.
    pub slots: Mutex<Vec<Arc<Slot>>>,
    pub call: Arc<Call>,
    pub pool: Arc<ThreadPool>,
    /// The process that made it.
    process: u32,
    pub n_worlds: usize,
    pub n_drones: usize,
    pub n_obstacles: usize,
    n_rotors: usize,
    mode: ControlMode,
    pub setup: Setup,
}

/// Reads a description in JSON or TOML, or the manifest of a data set, and gives that of the simulation, complete, as JSON.
#[pyfunction]
pub fn read_config(text: &str) -> PyResult<String> {
    let config = FlightConfig::from_text(text).or_raise()?.sim;
    serde_json::to_string(&config).map_err(|e| Error::new_err(e.to_string()))
}

impl PySim {
    /// The state, for one caller at a time.
    ///
    /// # Errors
    /// `Error` in a forked process, and while another thread or a stage of its own is inside.
    pub fn core(&self) -> PyResult<MutexGuard<'_, Core>> {
        let process = std::process::id();
        if process != self.process {
            return Err(Error::new_err(format!(
                "this Sim was made by process {} and this is process {process}, forked from it, in which its threads do not \
                 exist: make a Sim of its own in each process, or start processes by `spawn`",
                self.process
            )));
        }
        match self.core.try_lock() {
            Ok(core) => Ok(core),
            Err(TryLockError::Poisoned(broken)) => Ok(broken.into_inner()),
            Err(TryLockError::WouldBlock) => Err(Error::new_err(
                "this Sim is at work in another thread, or calls itself from one of its own stages: wait until that call \
                 returns, or give each thread a Sim of its own; stages change the arrays that they are given",
            )),
        }
    }

    /// Refuses a call that flies many steps without Python where Python wrote a stage.
    pub fn plain(&self) -> PyResult<()> {
        match self.has_stages() {
            false => Ok(()),
            true => Err(PyValueError::new_err(
                "a sequence of commands is flown in one call, in which stages that are functions of Python cannot run: take them out of \
                 the pipeline, or step under one command after the other",
            )),
        }
    }

    /// Whether Python wrote a stage.
    pub fn has_stages(&self) -> bool {
        !lock(&self.slots).is_empty()
    }

    /// Calls `step` up to `n_steps` times, until it says that it has no more. Stages are given `data`; the first exception that one of
    /// them raises ends the call.
    pub fn step_one_by_one(
        &self,
        py: Python<'_>,
        n_steps: usize,
        data: Py<PyAny>,
        mut step: impl FnMut() -> PyResult<bool>,
    ) -> PyResult<bool> {
        let staged = self.has_stages();
        if staged {
            self.call.begin(data);
        }
        let (mut more, mut looked) = (true, Instant::now());
        let outcome = (0..n_steps).try_for_each(|_| {
            if !more {
                return Ok(());
            }
            let done = step();
            match self.call.take_error() {
                Some(error) if staged => return Err(error),
                _ => more = done?,
            }
            if looked.elapsed() > LOOK {
                py.check_signals()?;
                looked = Instant::now();
            }
            Ok(())
        });
        if staged {
            self.call.end();
        }
        outcome.map(|()| more)
    }

    fn check(&self, world: usize, drone: usize) -> PyResult<()> {
        if world < self.n_worlds && drone < self.n_drones {
            return Ok(());
        }
        Err(PyIndexError::new_err(format!(
            "expected a world below {} and a drone below {}, got world {world}, drone {drone}",
            self.n_worlds, self.n_drones
        )))
    }

    /// `tail` of every drone.
    pub fn shape(&self, tail: &[usize]) -> Vec<usize> {
        [&[self.n_worlds, self.n_drones], tail].concat()
    }
}

/// A camera at the centre of mass that looks forward.
fn forward() -> Pose {
    CameraConfig::looking(&MountConfig::default())
}

/// Puts vehicles that Python holds into a description, one for each entry of its drones.
pub fn describe(config: &mut SimConfig, vehicles: &[Py<PyVehicle>]) {
    for (drone, vehicle) in config.drones.iter_mut().zip(vehicles) {
        let vehicle = &vehicle.get().vehicle;
        drone.vehicle = vehicle.into();
        drone.shell = drone.shell.take().or(vehicle.shell_path());
    }
}

#[pymethods]
impl PySim {
    /// `config`: a description in JSON; `vehicles`: those of its drones, where they are not the ones that it names.
    #[new]
    #[pyo3(signature = (config, vehicles = None, threads = None))]
    fn new(
        py: Python<'_>,
        config: &str,
        vehicles: Option<Vec<Py<PyVehicle>>>,
        threads: Option<usize>,
    ) -> PyResult<Self> {
        let mut config = SimConfig::from_text(config).or_raise()?;
        describe(&mut config, &vehicles.unwrap_or_default());
        if config.precision == Precision::Auto {
            config.precision = Precision::F32;
        }
        let pool = threads::pool(threads)?;
        let made = py.detach(|| {
            let setup = config.load()?;
            let flight = match config.precision {
                Precision::F64 => Flight::F64(Box::new(setup.arena()?)),
                _ => Flight::F32(Box::new(setup.arena()?)),
            };
            Ok::<_, ArenaError>((setup, flight))
        });
        let (setup, flight) = made.or_raise()?;
        let (n_rotors, n_obstacles) =
            either!(&flight, arena => (arena.sim().data.n_rotors, arena.n_obstacles()));
        let mode = config.options.control;
        let limits =
            setup.drones().iter().flat_map(|(drone, _)| doubt::limits(mode, drone, n_rotors)).collect();
        let sensed = Sensed::default();
        let core = Core { flight, sensed, numbers: Vec::new(), told: 0, limits, doubted: false };
        let core = Arc::new(Mutex::new(core));
        let owner = Py::new(py, Owner { _core: core.clone() })?;
        Ok(Self {
            core,
            owner,
            slots: Mutex::default(),
            call: Arc::default(),
            pool,
            process: std::process::id(),
            n_worlds: config.options.n_worlds,
            n_drones: setup.vehicles().len(),
            n_obstacles,
            n_rotors,
            mode,
            setup,
        })
    }

    /// What it was made of, complete, as JSON.
    fn config_json(&self) -> PyResult<String> {
        serde_json::to_string(self.setup.config()).map_err(|e| Error::new_err(e.to_string()))
    }

    /// The vehicle of each drone.
    fn vehicles(&self) -> Vec<PyVehicle> {
        self.setup.vehicles().iter().cloned().map(PyVehicle::from).collect()
    }

    /// Rates of the controllers of each drone, Hz, by the mode whose commands they take up.
    fn rates(&self) -> Vec<BTreeMap<&'static str, u32>> {
        let freq = self.setup.config().options.sim_hz;
        let of = |(_, rates): &(_, Rates)| {
            let mut out = by_mode(*rates);
            out.insert(ControlMode::RotorVel.name(), freq);
            out
        };
        self.setup.drones().iter().map(of).collect()
    }

    /// The camera of the description, as arguments of `propwash.Camera` in JSON; none without one.
    fn camera_json(&self) -> PyResult<Option<String>> {
        let Some(c) = &self.setup.config().camera else { return Ok(None) };
        let mount = c.mount.as_ref().map(CameraConfig::looking);
        let fovy_deg = if c.pinhole_px.is_some() { None } else { c.fovy_deg().or_raise()? };
        let json = json!({
            "name": mount.is_none().then_some(&c.name), "mount": mount.map(|_| "drone"),
            "pos": mount.map(|m| m.pos_m), "quat": mount.unwrap_or_else(forward).quat_xyzw,
            "pinhole_px": c.pinhole_px, "resolution": c.size().or_raise()?, "fovy_deg": fovy_deg, "range": c.range().or_raise()?, "kind": c.kind().or_raise()?, "groups": c.groups, "caster": c.caster,
        });
        Ok(Some(json.to_string()))
    }

    /// Commands of the pattern, (n_worlds, n_drones, 16), at a time since the last reset, or at the present one of each world.
    #[pyo3(signature = (time = None))]
    fn pattern_command<'py>(
        &self,
        py: Python<'py>,
        time: Option<f64>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let core = self.core()?;
        let commands: Vec<f64> = either!(&core.flight, arena => {
            let at = |row: usize| time.unwrap_or_else(|| arena.sim().time_s(row / self.n_drones));
            arena.trajectories().iter().enumerate().flat_map(|(row, path)| path.at(at(row)).command()).collect()
        });
        if commands.is_empty() {
            return Err(Error::new_err(
                "this Sim flies no pattern: make it of a configuration with one, such as {\"pattern\": \"lissajous\"}",
            ));
        }
        arrays::owned(py, commands, &self.shape(&[16]))
    }

    /// Number of worlds.
    #[getter]
    fn n_worlds(&self) -> usize {
        self.n_worlds
    }

    /// Drones in each world.
    #[getter]
    fn n_drones(&self) -> usize {
        self.n_drones
    }

    /// Number of scenes.
    #[getter]
    fn n_scenes(&self) -> usize {
        self.setup.scenes().len()
    }

    /// Numbers of one drone's command.
    #[getter]
    fn command_width(&self) -> usize {
        self.mode.width(self.n_rotors)
    }

    /// Most rotors of any drone.
    #[getter]
    fn n_rotors(&self) -> usize {
        self.n_rotors
    }

    /// A view of the array called `name`, as wide as it is stored.
    fn array<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        let owner = || self.owner.bind(py).clone().into_any();
        let mut core = self.core()?;
        if let "obstacle_pos" | "obstacle_quat" = name {
            let numbers = either!(&mut core.flight, arena => match name {
                "obstacle_pos" => arena.obstacle_pos_mut(),
                _ => arena.obstacle_quat_mut(),
            });
            let shape = [self.n_worlds, self.n_obstacles, if name == "obstacle_pos" { 3 } else { 4 }];
            // SAFETY: the vectors of obstacles are made once with the simulation and keep their length and place.
            return Ok(unsafe { arrays::view(numbers, &shape, owner())? }.into_any());
        }
        either!(&mut core.flight, arena => {
            let data = arena.data_mut();
            let rows = self.n_worlds * self.n_drones;
            let (rotors, command) = ([data.n_rotors], [data.command_width]);
            let memory = [data.controller_memory.len() / rows];
            let (numbers, tail): (&mut Vec<_>, &[usize]) = match name {
                "pos" => (&mut data.pos, &[3]),
                "quat" => (&mut data.quat, &[4]),
                "vel" => (&mut data.vel, &[3]),
                "ang_vel" => (&mut data.ang_vel, &[3]),
                "rotor_vel" => (&mut data.rotor_vel, &rotors),
                "thrust" => (&mut data.thrust, &[]),
                "command" => (&mut data.command, &command),
                "rotor_command" => (&mut data.rotor_command, &rotors),
                "attitude_command" => (&mut data.attitude_command, &[4]),
                "disturbance_force" => (&mut data.disturbance_force, &[3]),
                "disturbance_torque" => (&mut data.disturbance_torque, &[3]),
                "wind" => (&mut data.wind, &[3]),
                "ground_z" => (&mut data.ground_z, &[]),
                "ceiling_z" => (&mut data.ceiling_z, &[]),
                "controller_memory" => (&mut data.controller_memory, &memory),
                "steps" | "episodes" => {
                    let counts = if name == "steps" { &mut data.steps } else { &mut data.episodes };
                    // SAFETY: as below.
                    let view = unsafe { arrays::view(counts, &[self.n_worlds], owner())? };
                    return Ok(view.into_any());
                }
                _ => return Err(PyKeyError::new_err(format!("no array is called {name:?}"))),
            };
            // SAFETY: the owner holds the simulation, whose arrays are made with it: nothing in this crate replaces or
            // resizes them, and steps refuse arrays whose length was changed. Stages run Python code only through
            // closures that leave the reference which they are given alone.
            Ok(unsafe { arrays::view(numbers, &self.shape(tail), owner())? }.into_any())
        })
    }

    /// Sets all commands, (n_worlds, n_drones, command_width), of the mode called `mode`. Gives a warning for the first command ever that
    /// is beyond what the vehicle can do.
    fn set_command(&self, mode: &str, command: &Bound<'_, PyAny>) -> PyResult<Option<String>> {
        let mut core = self.core()?;
        let own = self.mode.name();
        if mode != own {
            return Err(Error::new_err(format!(
                "{mode}_control: this Sim was made with control=\"{own}\"; call {own}_control, or make a Sim with \
                 control=\"{mode}\""
            )));
        }
        let Core { flight, numbers, limits, doubted, .. } = &mut *core;
        let width = self.mode.width(self.n_rotors);
        let shape = self.shape(&[width]);
        let axes = match self.mode {
            ControlMode::State => "(n_worlds, n_drones, 16)",
            ControlMode::RotorVel => "(n_worlds, n_drones, n_rotors)",
            _ => "(n_worlds, n_drones, 4)",
        };
        arrays::numbers("command", axes, command, &shape, numbers)?;
        let empty = match self.mode {
            ControlMode::State => doubt::without_attitude(numbers, self.n_drones),
            _ => None,
        };
        if let Some((world, drone, got)) = empty {
            return Err(PyValueError::new_err(format!(
                "command of world {world}, drone {drone}: expected an attitude x y z w (entries 9 to 12) that is not zero, got \
                 {got:?}; level, heading along x, is [0, 0, 0, 1] (propwash.Command makes such commands); nothing was changed"
            )));
        }
        either!(flight, arena => arena.set_command(numbers)).or_raise()?;
        if *doubted || !doubt::any_beyond(numbers, limits) {
            return Ok(None);
        }
        // A closer look, by what the vehicle can do in its world.
        let words = either!(flight, arena => {
            let of = |world, drone| arena.sim().drone(world, drone);
            let exact = |world, drone| doubt::limits(self.mode, of(world, drone), self.n_rotors);
            let first = doubt::first_beyond(numbers, self.n_drones, width, exact);
            first.map(|first| {
                let vehicle = &self.setup.vehicles()[first.1].name;
                doubt::words(self.mode, first, of(first.0, first.1), vehicle)
            })
        });
        *doubted = words.is_some();
        if words.is_none() {
            // Worlds can do more than the vehicle's file says: up to here there is no second look.
            doubt::widen(limits, numbers);
        }
        Ok(words)
    }

    /// Advances all worlds; true when worlds were quarantined that were not before.
    fn step(&self, py: Python<'_>, n_steps: usize, data: Py<PyAny>) -> PyResult<bool> {
        let mut core = self.core()?;
        let Core { flight, told, .. } = &mut *core;
        either!(flight, arena => {
            // The pool costs a hand-over of some 20 µs, which a step that one thread takes does not need.
            let mut advance = |now: usize| {
                py.detach(|| match arena.is_parallel(now) {
                    true if self.pool.current_num_threads() == 1 && arena.can_be_alone() => {
                        alone(|| arena.step(now))
                    }
                    true => self.pool.install(|| arena.step(now)),
                    false => arena.step(now),
                })
                .or_raise()
            };
            if self.has_stages() {
                self.step_one_by_one(py, n_steps, data, || advance(1).map(|()| true))?;
            } else {
                // In parts after which Ctrl-C is heard; steps are the same in any parts.
                let mut most = (1_000_000 / (self.n_worlds * self.n_drones).max(1)).max(LEAST_STEPS);
                let mut left = n_steps;
                while left > 0 {
                    let (now, begin) = (most.min(left), Instant::now());
                    advance(now)?;
                    left -= now;
                    if left > 0 {
                        py.check_signals()?;
                        if begin.elapsed() > LOOK {
                            most = (most / 2).max(LEAST_STEPS);
                        }
                    }
                }
            }
            if let Some(why) = propwash::compile::complaint() {
                let text = CString::new(format!("steps fly as byte code, more slowly: {why}"))?;
                PyErr::warn(py, &py.get_type::<PyRuntimeWarning>(), &text, 1)?;
            }
            let now = arena.sim().n_quarantined();
            let more = now > *told;
            *told = now;
            Ok(more)
        })
    }

    /// How compiling goes, a line for each step that was traced and has no kernel.
    fn compiling(&self) -> PyResult<Vec<String>> {
        let core = self.core()?;
        Ok(either!(&core.flight, arena => arena.sim().compiling().iter().map(|s| s.to_string()).collect()))
    }

    /// Back to the initial states, in all worlds or in those of the mask.
    #[pyo3(signature = (mask = None))]
    fn reset(&self, py: Python<'_>, mask: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        let mask = arrays::mask("mask", mask, self.n_worlds)?;
        let mut core = self.core()?;
        either!(&mut core.flight, arena => py.detach(|| arena.reset(mask.as_deref()))).or_raise()?;
        core.known_quarantine();
        Ok(())
    }

    /// Sets what resets start from: arrays (n_worlds, n_drones, n), each optional; what is None stays as it is.
    #[pyo3(signature = (pos, quat, vel, ang_vel))]
    fn set_initial(
        &self,
        pos: Option<&Bound<'_, PyAny>>,
        quat: Option<&Bound<'_, PyAny>>,
        vel: Option<&Bound<'_, PyAny>>,
        ang_vel: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        let mut lists = [Vec::new(), Vec::new(), Vec::new(), Vec::new()];
        let given = [("pos", pos, 3), ("quat", quat, 4), ("vel", vel, 3), ("ang_vel", ang_vel, 3)];
        for (list, (name, value, width)) in lists.iter_mut().zip(given) {
            let axes = format!("(n_worlds, n_drones, {width})");
            if let Some(value) = value {
                arrays::numbers(name, &axes, value, &self.shape(&[width]), list)?;
            }
        }
        let [pos, quat, vel, ang_vel] = lists;
        let mut core = self.core()?;
        let three = |list: &[f64], row: usize, old: [f64; 3]| match list.get(3 * row..3 * row + 3) {
            Some(new) => [new[0], new[1], new[2]],
            None => old,
        };
        let rows = 0..self.n_worlds * self.n_drones;
        let mut states = Vec::with_capacity(rows.len());
        // All are tried before one is set.
        for row in rows {
            let (world, drone) = (row / self.n_drones, row % self.n_drones);
            let old = either!(&core.flight, arena => *arena.sim().initial(world, drone));
            let s = State {
                pos: three(&pos, row, old.pos),
                quat: match quat.get(4 * row..4 * row + 4) {
                    Some(q) => unit([q[0], q[1], q[2], q[3]]),
                    None => old.quat,
                },
                vel: three(&vel, row, old.vel),
                ang_vel: three(&ang_vel, row, old.ang_vel),
                ..State::rest()
            };
            let whole = [&s.pos[..], &s.quat, &s.vel, &s.ang_vel].concat();
            if !whole.iter().all(|v| v.is_finite()) || s.quat == [0.0; 4] {
                return Err(PyValueError::new_err(format!(
                    "initial state of world {world}, drone {drone}: expected finite numbers and an attitude that is not zero, \
                     got pos {:?}, quat {:?}, vel {:?}, ang_vel {:?}; nothing was changed",
                    s.pos, s.quat, s.vel, s.ang_vel
                )));
            }
            states.push((world, drone, s));
        }
        for (world, drone, state) in states {
            either!(&mut core.flight, arena => arena.set_initial(world, drone, state)).or_raise()?;
        }
        Ok(())
    }

    /// Which worlds are quarantined.
    fn quarantined<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<bool>>> {
        let core = self.core()?;
        let flags =
            either!(&core.flight, arena => arena.sim().data.quarantine.iter().map(Option::is_some).collect());
        arrays::owned(py, flags, &[self.n_worlds])
    }

    /// Of every quarantined world: index, drone, step, quantity, stage and all of it in words.
    #[allow(clippy::type_complexity)]
    fn quarantine(&self) -> PyResult<Vec<(usize, usize, u64, String, Option<String>, String)>> {
        let core = self.core()?;
        let told = |(w, q): (usize, &Option<Box<Quarantine>>)| {
            let q = q.as_ref()?;
            Some((w, q.drone, q.step, q.quantity.clone(), q.stage.clone(), q.to_string()))
        };
        Ok(
            either!(&core.flight, arena => arena.sim().data.quarantine.iter().enumerate().filter_map(told).collect()),
        )
    }

    /// Names of the stages, first to last.
    fn stage_names(&self) -> PyResult<Vec<String>> {
        let core = self.core()?;
        Ok(
            either!(&core.flight, arena => arena.sim().pipeline.names().iter().map(|n| n.to_string()).collect()),
        )
    }

    /// Adds a stage: a function of the arrays, or a built-in one.
    #[pyo3(signature = (place, name, stage, anchor = None))]
    fn add_stage(
        &self,
        place: &str,
        name: &str,
        stage: &Bound<'_, PyAny>,
        anchor: Option<&str>,
    ) -> PyResult<()> {
        let place = Place::of(place, anchor)?;
        let mut core = self.core()?;
        let built_in: Option<RestOnGround> = stage.extract().ok();
        if built_in.is_none() && !stage.is_callable() {
            return Err(PyTypeError::new_err(format!(
                "stage {name:?}: expected a function of Sim.data or a propwash.RestOnGround, got {}",
                stage.get_type().name()?.to_string_lossy()
            )));
        }
        let slot = Slot::new(name, stage.clone().unbind());
        either!(&mut core.flight, arena => {
            let f = match &built_in {
                Some(of) => of.stage(),
                None => slot.stage(&self.call),
            };
            let pipeline = arena.pipeline_mut();
            match place {
                Place::First => pipeline.prepend(name, f),
                Place::Last => pipeline.append(name, f),
                Place::Before(anchor) => pipeline.insert_before(anchor, name, f),
                Place::After(anchor) => pipeline.insert_after(anchor, name, f),
                Place::Instead => pipeline.replace(name, f),
            }
        })
        .or_raise()?;
        let mut slots = lock(&self.slots);
        slots.retain(|s| s.name != name);
        if built_in.is_none() {
            slots.push(slot);
        }
        Ok(())
    }

    /// Takes a stage out.
    fn remove_stage(&self, name: &str) -> PyResult<()> {
        let mut core = self.core()?;
        either!(&mut core.flight, arena => arena.pipeline_mut().remove(name)).or_raise()?;
        lock(&self.slots).retain(|s| s.name != name);
        Ok(())
    }

    /// Names and values of the parameters of one drone in one world.
    fn parameters(&self, world: usize, drone: usize) -> PyResult<Vec<(String, f64)>> {
        self.check(world, drone)?;
        let core = self.core()?;
        let mut of = either!(&core.flight, arena => arena.sim().drone(world, drone).clone());
        let mut out = Vec::new();
        of.visit(&mut |name, value| out.push((name.to_string(), *value)));
        Ok(out)
    }

    /// One parameter in all worlds, (n_worlds, n_drones); NaN for drones without it.
    fn parameter<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let core = self.core()?;
        let mut out = vec![f64::NAN; self.n_worlds * self.n_drones];
        for (row, out) in out.iter_mut().enumerate() {
            let (world, drone) = (row / self.n_drones, row % self.n_drones);
            let mut of = either!(&core.flight, arena => arena.sim().drone(world, drone).clone());
            of.visit(&mut |n, value| {
                if n == name {
                    *out = *value;
                }
            });
        }
        if out.iter().all(|v| v.is_nan()) {
            return Err(PyKeyError::new_err(format!(
                "no drone has a parameter {name:?}; Sim.parameters() lists the names"
            )));
        }
        arrays::owned(py, out, &[self.n_worlds, self.n_drones])
    }

    /// Sets one parameter of one drone, in each world to its own value, (n_worlds,).
    fn set_parameter(
        &self,
        py: Python<'_>,
        name: &str,
        drone: usize,
        values: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        self.check(0, drone)?;
        let mut numbers = Vec::new();
        arrays::numbers(name, "(n_worlds,)", values, &[self.n_worlds], &mut numbers)?;
        let mut core = self.core()?;
        either!(&mut core.flight, arena => py.detach(|| set_all(arena, name, drone, &numbers)))
    }

    /// Collective thrust to command for every drone to hover, N, (n_worlds, n_drones).
    fn hover_thrust<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let core = self.core()?;
        let rows = 0..self.n_worlds * self.n_drones;
        let n = self.n_drones;
        let of = |row| either!(&core.flight, arena => arena.sim().drone(row / n, row % n).hover_command());
        arrays::owned(py, rows.map(of).collect(), &[self.n_worlds, self.n_drones])
    }

    /// Rotor speeds that carry the weight of every drone, rad/s, (n_worlds, n_drones, n_rotors).
    fn hover_rotor_vel<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let core = self.core()?;
        let rows = 0..self.n_worlds * self.n_drones;
        let of = |row: usize| {
            let (world, drone) = (row / self.n_drones, row % self.n_drones);
            let speeds = either!(&core.flight, arena => arena.sim().drone(world, drone).hover_rotor_vel());
            speeds.into_iter().take(self.n_rotors)
        };
        arrays::owned(py, rows.flat_map(of).collect(), &self.shape(&[self.n_rotors]))
    }

    fn __reduce__(&self) -> PyResult<()> {
        Err(PyTypeError::new_err(
            "a Sim cannot be pickled or copied: make one with the same arguments where it is needed; its state are the arrays \
             of Sim.data",
        ))
    }

    fn __traverse__(&self, visit: PyVisit<'_>) -> Result<(), PyTraverseError> {
        let Ok(slots) = self.slots.try_lock() else { return Ok(()) };
        for slot in slots.iter() {
            if let Ok(function) = slot.function.try_lock() {
                visit.call(&*function)?;
            }
        }
        Ok(())
    }

    fn __clear__(&self) {
        let slots = std::mem::take(&mut *lock(&self.slots));
        for slot in slots {
            // Dropped after the lock: dropping may run Python code.
            let function = lock(&slot.function).take();
            drop(function);
        }
    }
}

impl Drop for PySim {
    /// Views may keep the arrays alive, and the stages with them; the functions are let go.
    fn drop(&mut self) {
        self.__clear__();
    }
}

/// A quaternion of length 1; zero where it has none.
fn unit(q: [f64; 4]) -> [f64; 4] {
    let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    if length > 1e-6 && length.is_finite() {
        quat::normalize(q)
    } else if length.is_nan() {
        q
    } else {
        [0.0; 4]
    }
}

/// One value for each world; all or none.
fn set_all<N: Number>(arena: &mut Arena<N>, name: &str, drone: usize, values: &[f64]) -> PyResult<()> {
    if values.iter().all(|v| v.to_bits() == values[0].to_bits()) {
        return arena.set_parameter(None, drone, name, values[0]).or_raise();
    }
    let mut before = vec![f64::NAN; values.len()];
    for (world, old) in before.iter_mut().enumerate() {
        arena.sim().drone(world, drone).clone().visit(&mut |n, v| {
            if n == name {
                *old = *v;
            }
        });
    }
    for (world, value) in values.iter().enumerate() {
        let done = arena.set_parameter(Some(world), drone, name, *value).or_raise();
        if done.is_err() {
            for (world, old) in before.iter().enumerate().take(world) {
                arena.set_parameter(Some(world), drone, name, *old).or_raise()?;
            }
            return done;
        }
    }
    Ok(())
}
