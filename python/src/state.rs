//! `propwash.State`: the whole state of a simulation, kept and put back.

use propwash::arena::ArenaState;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;

use crate::errors::OrRaise;
use crate::sim::{Flight, PySim, either};

/// The state of a simulation of either number.
enum Kept {
    F32(Box<ArenaState<f32>>),
    F64(Box<ArenaState<f64>>),
}

/// The whole state of a `Sim`, made by `Sim.save` and put back by `Sim.restore`: arrays, commands, disturbances, wind, memories of
/// controllers and effects, parameters, starts, counts of steps and episodes, quarantine, seed, layout and obstacles.
#[pyclass(frozen, name = "State", module = "propwash")]
pub struct PyState {
    kept: Kept,
    n_worlds: usize,
    n_drones: usize,
}

#[pymethods]
impl PyState {
    fn __repr__(&self) -> String {
        let precision = if matches!(self.kept, Kept::F32(_)) { "f32" } else { "f64" };
        format!("<propwash.State of {} worlds x {} drones, {precision}>", self.n_worlds, self.n_drones)
    }

    fn __reduce__(&self) -> PyResult<()> {
        Err(PyTypeError::new_err(
            "a State cannot be pickled or copied, and need not be: it never changes; make one with Sim.save where it is needed",
        ))
    }
}

#[pymethods]
impl PySim {
    /// Keeps the whole state.
    fn save(&self) -> PyResult<PyState> {
        let core = self.core()?;
        let kept = match &core.flight {
            Flight::F32(arena) => Kept::F32(Box::new(arena.save())),
            Flight::F64(arena) => Kept::F64(Box::new(arena.save())),
        };
        Ok(PyState { kept, n_worlds: self.n_worlds, n_drones: self.n_drones })
    }

    /// Puts a state back.
    fn restore(&self, state: &PyState) -> PyResult<()> {
        let mut core = self.core()?;
        match (&mut core.flight, &state.kept) {
            (Flight::F32(arena), Kept::F32(kept)) => arena.restore(kept).or_raise()?,
            (Flight::F64(arena), Kept::F64(kept)) => arena.restore(kept).or_raise()?,
            (_, kept) => {
                let got = if matches!(kept, Kept::F32(_)) { "f32" } else { "f64" };
                return Err(PyValueError::new_err(format!(
                    "state: expected one of a Sim of the same precision, got one of {got}; nothing was changed"
                )));
            }
        }
        core.known_quarantine();
        Ok(())
    }

    /// Copies one world into all others.
    fn fork(&self, world: usize) -> PyResult<()> {
        let mut core = self.core()?;
        either!(&mut core.flight, arena => arena.fork(world)).or_raise()?;
        core.known_quarantine();
        Ok(())
    }
}
