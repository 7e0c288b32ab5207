//! Stages of a step that are written in Python, and the built-in ones that Python may add.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use propwash::rollout::pipeline::{StageFn, rest_on_ground};
use propwash::scalar::lanes::Number;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyType;

pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What the stages of one simulation share while it steps.
#[derive(Default)]
pub struct Call {
    /// What stages are given: `Sim.data`.
    data: Mutex<Option<Py<PyAny>>>,
    /// The first exception.
    error: Mutex<Option<PyErr>>,
}

impl Call {
    /// Before a call of `step`.
    pub fn begin(&self, data: Py<PyAny>) {
        *lock(&self.data) = Some(data);
        *lock(&self.error) = None;
    }

    /// The exception that a stage raised, if one did.
    pub fn take_error(&self) -> Option<PyErr> {
        lock(&self.error).take()
    }

    /// After it.
    pub fn end(&self) {
        *lock(&self.data) = None;
    }

    /// Calls a stage, unless one before it failed.
    fn run(&self, slot: &Slot) {
        if lock(&self.error).is_some() {
            return;
        }
        let outcome = Python::attach(|py| {
            let function = lock(&slot.function).as_ref().map(|f| f.clone_ref(py));
            let data = lock(&self.data).as_ref().map(|d| d.clone_ref(py));
            let (Some(function), Some(data)) = (function, data) else { return Ok(()) };
            let result = function.call1(py, (data,))?;
            if result.is_none(py) {
                return Ok(());
            }
            let got = result.bind(py).get_type().name()?.to_string_lossy().into_owned();
            Err(PyTypeError::new_err(format!(
                "stage {:?}: expected None, got {got}; a stage writes into the arrays that it is given and returns nothing",
                slot.name
            )))
        });
        if let Err(e) = outcome {
            *lock(&self.error) = Some(e);
        }
    }
}

/// One stage that is written in Python.
pub struct Slot {
    /// Its name.
    pub name: String,
    /// The function; none after the garbage collector has cleared it.
    pub function: Mutex<Option<Py<PyAny>>>,
}

impl Slot {
    /// A slot for `function`.
    pub fn new(name: &str, function: Py<PyAny>) -> Arc<Self> {
        Arc::new(Self { name: name.into(), function: Mutex::new(Some(function)) })
    }

    /// The stage that calls it.
    pub fn stage<N: Number>(self: &Arc<Self>, call: &Arc<Call>) -> StageFn<N> {
        let (slot, call) = (self.clone(), call.clone());
        // The function sees the arrays through its own views of them.
        Box::new(move |_| call.run(&slot))
    }
}

/// Stage that lets drones rest on the ground: a drone whose origin sinks below `rest_height_m` over the ground under it
/// (`data.ground_z`) is put back to that height, and its angular, horizontal and downward velocity are stopped.
///
/// Without it the ground is reported as a contact and does not hold: contact forces are not solved.
#[pyclass(frozen, name = "RestOnGround", module = "propwash", from_py_object)]
#[derive(Clone)]
pub struct RestOnGround {
    #[pyo3(get)]
    rest_height_m: f64,
}

#[pymethods]
impl RestOnGround {
    #[new]
    fn new(rest_height_m: f64) -> PyResult<Self> {
        if !rest_height_m.is_finite() {
            return Err(PyValueError::new_err(format!(
                "rest_height_m: expected a finite height in metres, got {rest_height_m}"
            )));
        }
        Ok(Self { rest_height_m })
    }

    fn __repr__(&self) -> String {
        format!("RestOnGround({})", self.rest_height_m)
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> (Bound<'py, PyType>, (f64,)) {
        (slf.get_type(), (slf.get().rest_height_m,))
    }
}

impl RestOnGround {
    /// The stage.
    pub fn stage<N: Number>(&self) -> StageFn<N> {
        rest_on_ground(self.rest_height_m)
    }
}

/// Where a stage goes.
#[derive(Clone, Copy, Debug)]
pub enum Place<'a> {
    First,
    Last,
    Before(&'a str),
    After(&'a str),
    /// In the place of the one of the same name.
    Instead,
}

impl<'a> Place<'a> {
    /// From the words of the Python side.
    pub fn of(word: &str, anchor: Option<&'a str>) -> PyResult<Self> {
        match (word, anchor) {
            ("first", None) => Ok(Self::First),
            ("last", None) => Ok(Self::Last),
            ("before", Some(anchor)) => Ok(Self::Before(anchor)),
            ("after", Some(anchor)) => Ok(Self::After(anchor)),
            ("instead", None) => Ok(Self::Instead),
            _ => Err(PyValueError::new_err(format!(
                "place: expected first, last, instead, or before or after with the name of a stage, got {word} {anchor:?}"
            ))),
        }
    }
}
