//! A session of the lab: `propwash.Lab`.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use propwash::gap::session::{Axis, Flight, Session, Use};
use propwash::gap::watch::Watch;
use pyo3::prelude::*;

use crate::arrays::owned;
use crate::errors::OrRaise;
use crate::gap::{Reading, json};
use crate::threads::interruptible;
use crate::vehicle::PyVehicle;

/// Arrays of one flight: name of the log, times, force, torque (empty where the drive carries none).
type Arrays<'py> = (String, Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>);

/// What a session saves: vehicle file, lines as (change, text), report page, commands of a shell, remarks.
type Saved = (String, Vec<(String, String)>, Option<String>, String, Vec<String>);

/// A session with flights of one vehicle, in Rust; `propwash.Lab` is what users call.
#[pyclass(frozen, name = "LabSession", module = "propwash._native")]
pub struct PyLab {
    session: Arc<Mutex<Session>>,
    /// Paths of the flights, in the order of the session.
    logs: Vec<String>,
}

/// What a session's job leaves.
type Job<T> = Result<T, propwash::gap::Error>;

impl PyLab {
    /// The session, locked. Lock it before entering a pool: a thread of the pool that waits for a part of its own work takes up other
    /// work meanwhile, and would wait for ever for a lock that it holds itself.
    fn locked(&self) -> MutexGuard<'_, Session> {
        self.session.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Does something short without holding Python's lock.
    fn quick<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut Session) -> Job<T> + Send,
    ) -> PyResult<T> {
        let pool = crate::threads::pool(None)?;
        py.detach(|| {
            let session = &mut *self.locked();
            pool.install(|| work(session))
        })
        .or_raise()
    }

    /// Does something long, which Ctrl-C ends; what `progress` raises ends it too.
    fn long(
        &self,
        py: Python<'_>,
        progress: Option<Py<PyAny>>,
        work: impl FnOnce(&mut Session, &Watch) -> Job<()> + Send + 'static,
    ) -> PyResult<()> {
        let (session, pool) = (self.session.clone(), crate::threads::pool(None)?);
        interruptible(py, move |stop: &Arc<AtomicBool>| {
            let raised = Mutex::new(None);
            let told = |done: usize, total: usize| {
                let Some(to) = &progress else { return };
                Python::attach(|py| {
                    if let Err(e) = to.call1(py, (done, total)) {
                        raised.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(e);
                        stop.store(true, Ordering::Relaxed);
                    }
                });
            };
            let watch = Watch { progress: Some(&told), early: None, cancel: Some(stop) };
            // Locked before entering the pool, as in `locked`.
            let session = &mut *session.lock().unwrap_or_else(PoisonError::into_inner);
            let done = pool.install(|| work(session, &watch));
            match raised.into_inner().unwrap_or_else(PoisonError::into_inner) {
                Some(e) => Err(e),
                None => done.or_raise(),
            }
        })?
    }
}

#[pymethods]
impl PyLab {
    /// Opens flights; `check` says of each whether it only checks what is fitted to the others.
    #[new]
    fn new(
        py: Python<'_>,
        label: String,
        logs: Vec<PathBuf>,
        check: Vec<bool>,
        vehicle: Py<PyVehicle>,
        reading: Reading,
    ) -> PyResult<Self> {
        let pool = crate::threads::pool(None)?;
        let names = logs.iter().map(|l| l.display().to_string()).collect();
        let session = interruptible(py, move |_| {
            let of = vehicle.get();
            pool.install(|| {
                let tracks = reading.read(&logs, of)?;
                let used = |check: bool| if check { Use::Check } else { Use::Fit };
                let flights = tracks.into_iter().zip(check);
                let flights = flights.map(|(track, c)| Flight { track, used: used(c) }).collect();
                Session::open(&label, &of.vehicle, &of.text, flights).or_raise()
            })
        })??;
        Ok(Self { session: Arc::new(Mutex::new(session)), logs: names })
    }

    /// Everything but arrays, as JSON.
    fn state(&self, py: Python<'_>) -> PyResult<String> {
        json(&self.quick(py, |s| Ok(s.state()))?)
    }

    fn find(&self, py: Python<'_>, progress: Option<Py<PyAny>>) -> PyResult<()> {
        self.long(py, progress, |s, watch| s.find(watch))
    }

    fn fit(&self, py: Python<'_>, progress: Option<Py<PyAny>>) -> PyResult<()> {
        self.long(py, progress, |s, watch| s.fit(watch))
    }

    fn toggle(&self, py: Python<'_>, effect: &str, on: bool) -> PyResult<()> {
        self.quick(py, |s| s.toggle(effect, on))
    }

    fn set(&self, py: Python<'_>, effect: &str, parameter: &str, value: f64) -> PyResult<()> {
        self.quick(py, |s| s.set(effect, parameter, value))
    }

    fn set_use(&self, py: Python<'_>, flight: usize, check: bool) -> PyResult<()> {
        self.quick(py, |s| s.set_use(flight, if check { Use::Check } else { Use::Fit }))
    }

    fn expression(&self, py: Python<'_>, axis: &str, text: &str) -> PyResult<String> {
        self.quick(py, |s| s.expression(Axis::named(axis)?, text))
    }

    fn undo(&self, py: Python<'_>) -> PyResult<bool> {
        self.quick(py, |s| Ok(s.undo()))
    }

    fn redo(&self, py: Python<'_>) -> PyResult<bool> {
        self.quick(py, |s| Ok(s.redo()))
    }

    fn go(&self, py: Python<'_>, step: usize) -> PyResult<()> {
        self.quick(py, |s| s.go(step))
    }

    /// Figures as JSON, and arrays of every flight, by the model itself.
    fn exact<'py>(&self, py: Python<'py>, window: Option<[f64; 2]>) -> PyResult<(String, Vec<Arrays<'py>>)> {
        let exact = self.quick(py, |s| s.exact(window))?;
        let figures = json(&exact.figures)?;
        let rows = |list: Vec<[f64; 3]>| -> PyResult<Bound<'py, PyAny>> {
            let n = list.len();
            Ok(owned(py, list.into_iter().flatten().collect(), &[n, 3])?.into_any())
        };
        let flights = exact.flights.into_iter().map(|f| {
            let n = f.t_s.len();
            Ok((f.log, owned(py, f.t_s, &[n])?.into_any(), rows(f.force_n)?, rows(f.torque_n_m)?))
        });
        Ok((figures, flights.collect::<PyResult<_>>()?))
    }

    /// What is to be written; `out` names the vehicle file in the commands, `flags` what reading the logs takes.
    fn save(&self, py: Python<'_>, out: String, flags: Vec<String>, report: bool) -> PyResult<Saved> {
        let (session, logs, pool) = (self.session.clone(), self.logs.clone(), crate::threads::pool(None)?);
        let saved = interruptible(py, move |_| {
            let session = session.lock().unwrap_or_else(PoisonError::into_inner);
            pool.install(|| session.save(&out, &logs, &flags, report))
        })?
        .or_raise()?;
        let lines = saved.diff.into_iter().map(|l| {
            let change = match l.change {
                propwash::gap::session::LineChange::Kept => "kept",
                propwash::gap::session::LineChange::Added => "added",
                propwash::gap::session::LineChange::Removed => "removed",
            };
            (change.to_string(), l.text)
        });
        Ok((saved.vehicle, lines.collect(), saved.report, saved.steps, saved.remarks))
    }
}
