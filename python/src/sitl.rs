//! A server in which a flight stack flies: the compiled side of `propwash.Sitl`.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};

use propwash::arena::DroneConfig;
use propwash::sitl::{Company, Server, SitlConfig, SitlError};
use pyo3::exceptions::{PyConnectionError, PyOSError, PyTimeoutError, PyValueError};
use pyo3::prelude::*;
use serde_json::json;

use crate::errors::{Error, IntoPython, OrRaise};
use crate::threads::interruptible;
use crate::vehicle::PyVehicle;

impl IntoPython for SitlError {
    fn into_python(self) -> PyErr {
        let words = self.to_string();
        match self {
            SitlError::Arena(e) => e.into_python(),
            SitlError::Option { .. } | SitlError::Protocol(_) => PyValueError::new_err(words),
            SitlError::Port { .. } | SitlError::Record { .. } => PyOSError::new_err(words),
            SitlError::Connection { .. } | SitlError::Closed { .. } => PyConnectionError::new_err(words),
            SitlError::Silent { .. } => PyTimeoutError::new_err(words),
            _ => Error::new_err(words),
        }
    }
}

/// What is said while something is waited for; the last thousand lines.
type Notes = Arc<Mutex<Vec<String>>>;

#[pyclass(frozen, name = "Sitl", module = "propwash._native")]
pub struct PySitl {
    server: Arc<Mutex<Option<Server>>>,
    notes: Notes,
    /// It is being closed: whatever waits ends.
    closing: Arc<AtomicBool>,
}

impl PySitl {
    fn with<T>(&self, look: impl FnOnce(&mut Server) -> PyResult<T>) -> PyResult<T> {
        let mut held = match self.server.try_lock() {
            Ok(held) => held,
            Err(TryLockError::Poisoned(broken)) => broken.into_inner(),
            Err(TryLockError::WouldBlock) => {
                return Err(Error::new_err(
                    "this Sitl steps in another thread: wait until that call returns",
                ));
            }
        };
        held.as_mut().map_or_else(|| Err(closed()), look)
    }
}

fn closed() -> PyErr {
    Error::new_err("this Sitl is closed: make another one")
}

fn held<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[pymethods]
impl PySitl {
    #[new]
    fn new(py: Python<'_>, config: &str, vehicle: &PyVehicle) -> PyResult<Self> {
        let config = SitlConfig::from_text(config).or_raise()?;
        let config = SitlConfig { drone: DroneConfig::from(&vehicle.vehicle), ..config };
        let server = py.detach(|| Server::bind(config)).or_raise()?;
        Ok(Self {
            server: Arc::new(Mutex::new(Some(server))),
            notes: Notes::default(),
            closing: Arc::default(),
        })
    }

    /// Exchanges until so many are done, or simulated time has come so far.
    fn step(&self, py: Python<'_>, n_steps: u64) -> PyResult<()> {
        // Another thread that steps is told of here, and not waited for.
        self.with(|_| Ok(()))?;
        let (server, notes, closing) = (self.server.clone(), self.notes.clone(), self.closing.clone());
        let outcome = interruptible(py, move |stop| {
            let mut held_server = held(&server);
            let server = held_server.as_mut()?;
            let mut say = |words: &str| {
                let mut notes = held(&notes);
                if notes.len() < 1000 {
                    notes.push(words.to_string());
                }
            };
            let end = || stop.load(Ordering::Relaxed) || closing.load(Ordering::Relaxed);
            let mut company = Company { stop: &end, say: &mut say };
            Some((0..n_steps).try_for_each(|_| server.step(&mut company)))
        })?;
        match outcome {
            None | Some(Err(SitlError::Interrupted)) => Err(closed()),
            Some(outcome) => outcome.or_raise(),
        }
    }

    /// Sends sticks to Betaflight.
    fn send_rc(&self, channels_us: Vec<u16>) -> PyResult<()> {
        self.with(|server| server.send_rc(&channels_us).or_raise())
    }

    /// Address and port at which it listens.
    fn address(&self) -> PyResult<(String, u16)> {
        self.with(|server| {
            let address = server.address().or_raise()?;
            Ok((address.ip().to_string(), address.port()))
        })
    }

    /// What there is to know, as JSON.
    fn state(&self) -> PyResult<String> {
        self.with(|server| {
            let (truth, traffic) = (server.truth(), server.traffic());
            let touches = server.touches().iter().map(|t| json!([t.time_s, t.what, t.speed_m_s, t.stands]));
            Ok(json!({
                "time": server.time_s(), "rate_hz": server.rate_hz(),
                "pos": truth.pos_m, "quat": truth.quat_xyzw, "vel": truth.vel_m_s, "ang_vel": truth.ang_vel_rad_s,
                "accel": truth.accel_m_s2, "rotor_vel": server.rotor_vel(), "commands": server.commands(),
                "motors": server.motors(), "armed": server.is_armed(), "standing": server.is_standing(),
                "touches": touches.collect::<Vec<_>>(),
                "traffic": {
                    "commands": traffic.commands, "others": traffic.others, "malformed": traffic.malformed,
                    "stale": traffic.stale, "lost": traffic.lost, "restarts": traffic.restarts,
                },
            })
            .to_string())
        })
    }

    /// What was said while it waited, from the beginning.
    fn notes(&self) -> Vec<String> {
        held(&self.notes).clone()
    }

    /// Closes the port and the record; a step that waits in another thread ends.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        self.closing.store(true, Ordering::Relaxed);
        let server = self.server.clone();
        py.detach(|| held(&server).take().map_or(Ok(()), |mut server| server.finish())).or_raise()
    }
}
