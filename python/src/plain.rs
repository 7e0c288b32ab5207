//! A drone as a plain function of state and command, and what flights cost: the compiled side of `Sim.f`, `Sim.F` and `propwash.cost`.

use numpy::{PyArrayDyn, PyUntypedArray, PyUntypedArrayMethods};
use propwash::arena::{Cost, Priced};
use propwash::rollout::pool::alone;
use propwash::rollout::tape::state_width;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::arrays;
use crate::errors::OrRaise;
use crate::field::PyField;
use crate::sim::{Flight, PySim, either};
use crate::tape::{sequence, within};

/// Rows and steps below which other threads are not asked: they would cost more than they bring.
const HERE: usize = 200;

/// What a flight costs after each command, traced once.
#[pyclass(frozen, name = "Cost", module = "propwash._native")]
pub struct PyCost {
    pub cost: Cost,
}

#[pymethods]
impl PyCost {
    /// From expressions: values with names, in order, and the cost; names of what is given; numbers of rotors and of a command.
    #[new]
    fn new(
        lets: Vec<(String, String)>,
        cost: &str,
        given: Vec<String>,
        n_rotors: usize,
        command_width: usize,
    ) -> PyResult<Self> {
        let made = Cost::new((&lets, cost), &given, (n_rotors, command_width));
        Ok(Self { cost: made.map_err(|e| PyValueError::new_err(format!("cost: {e}")))? })
    }
}

/// Rows of an array of two axes, of which the last has `width` numbers.
fn rows(name: &str, value: &Bound<'_, PyAny>, width: usize, out: &mut Vec<f64>) -> PyResult<usize> {
    let n = value.cast::<PyUntypedArray>().map_or(0, |array| array.shape().first().copied().unwrap_or(0));
    arrays::numbers(name, "(n, numbers)", value, &[n, width], out)?;
    Ok(n)
}

#[pymethods]
impl PySim {
    /// Time derivatives of states of a drone under commands, (n, numbers of a state), or, where `n_steps` is given, the states after so many steps.
    #[pyo3(signature = (world, drone, x, u, n_steps = None))]
    fn function<'py>(
        &self,
        py: Python<'py>,
        world: usize,
        drone: usize,
        x: &Bound<'py, PyAny>,
        u: &Bound<'py, PyAny>,
        n_steps: Option<usize>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        if self.has_stages() {
            return Err(PyValueError::new_err(
                "steps with stages that are functions of Python are no function of state and command: take them out of the pipeline, or write them as effects \
                 (propwash.effect)",
            ));
        }
        let mut core = self.core()?;
        either!(&mut core.flight, arena => {
            let data = &arena.sim().data;
            let (wide, narrow) = (state_width(data.n_rotors), data.command_width);
            let (mut states, mut commands) = (Vec::new(), Vec::new());
            let n = rows("x", x, wide, &mut states)?;
            rows("u", u, narrow, &mut commands)?;
            let at = (world, drone);
            let work = move || match n_steps {
                None => arena.rate_at(at, &states, &commands),
                Some(n_steps) => arena.steps_from(at, &states, &commands, n_steps),
            };
            let few = n.saturating_mul(n_steps.unwrap_or(1)) < HERE;
            let found = py.detach(|| if few { alone(work) } else { within(&self.pool, work) });
            arrays::owned(py, found.or_raise()?, &[n, wide])
        })
    }

    /// Flies a sequence of commands: what each drone costs, (n_worlds, n_drones), the states, where they are kept, and whether worlds were quarantined that were not before.
    #[allow(clippy::type_complexity)]
    fn rollout_priced<'py>(
        &self,
        py: Python<'py>,
        commands: &Bound<'py, PyAny>,
        substeps: usize,
        cost: &PyCost,
        given: Vec<f64>,
        how: (Option<Py<PyField>>, bool),
    ) -> PyResult<(Bound<'py, PyArrayDyn<f64>>, Option<Bound<'py, PyAny>>, bool)> {
        let (field, keep) = how;
        self.plain()?;
        let mut core = self.core()?;
        let before = core.quarantined();
        let shape = [self.n_worlds, self.n_drones];
        let field = field.as_ref().map(|field| &field.get().field);
        let asked = Priced { cost: &cost.cost, given: &given, field };
        let (states, costs) = either!(&mut core.flight, arena => {
            let (times, commands) = sequence(arena, commands)?;
            let flown = py.detach(|| within(&self.pool, || arena.rollout_priced(&commands, substeps, asked, keep)));
            let (states, costs) = flown.or_raise()?;
            let width = states.len() / (self.n_worlds * times * self.n_drones);
            let states = match keep {
                true => Some(arrays::owned(py, states, &[shape[0], times, shape[1], width])?.into_any()),
                false => None,
            };
            (states, costs)
        });
        core.known_quarantine();
        let more = core.quarantined() > before;
        Ok((arrays::owned(py, costs, &shape)?, states, more))
    }
}
