//! Planning by sampling: the compiled side of `propwash.planning`.

use std::sync::{Arc, Mutex};

use numpy::PyArrayDyn;
use propwash::learn::sampling::{Options, Planner, Weigh};
use propwash::physics::controllers::ControlMode;
use propwash::scalar::lanes::F32x16;
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::ThreadPool;

use crate::arrays;
use crate::errors::OrRaise;
use crate::field::PyField;
use crate::plain::PyCost;
use crate::tape::within;
use crate::threads;
use crate::vehicle::PyVehicle;

/// Plans by sampling.
#[pyclass(frozen, name = "Planner", module = "propwash._native")]
pub struct PyPlanner {
    planner: Mutex<Planner>,
    pool: Arc<ThreadPool>,
    shape: [usize; 3],
}

fn number<T: for<'a> FromPyObject<'a, 'a, Error = PyErr>>(
    given: &Bound<'_, PyDict>,
    key: &'static str,
) -> PyResult<T> {
    let value = given.get_item(key)?;
    value.ok_or_else(|| PyValueError::new_err(format!("{key}: expected a number, got none")))?.extract()
}

/// The options, of which those of a command must be given unless attitudes are commanded.
fn options_of(
    vehicle: &PyVehicle,
    (dynamics, control): (&str, &str),
    given: &Bound<'_, PyDict>,
) -> PyResult<Options> {
    let drone = vehicle.vehicle.drone(dynamics).or_raise()?;
    let usual = Options::attitude(&drone);
    let Some(mode) = ControlMode::ALL.into_iter().find(|mode| mode.name() == control) else {
        let known: Vec<_> = ControlMode::ALL.iter().map(|mode| mode.name()).collect();
        let known = known.join(", ");
        return Err(PyValueError::new_err(format!("control: expected one of {known}, got {control:?}")));
    };
    let of_command = |key: &'static str, usual: &[f64]| match given.get_item(key)? {
        Some(value) if !value.is_none() => value.extract(),
        _ if mode == ControlMode::Attitude => Ok(usual.to_vec()),
        _ => Err(PyValueError::new_err(format!(
            "{key}: expected {} numbers, one for each of a command with control={control:?}, got None",
            mode.width(drone.airframe.n_rotors)
        ))),
    };
    Ok(Options {
        mode,
        samples: number(given, "samples")?,
        modes: number(given, "modes")?,
        horizon: number(given, "horizon")?,
        step_s: number(given, "step")?,
        substeps: number(given, "substeps")?,
        update_s: number(given, "update")?,
        middle: of_command("middle", &usual.middle)?,
        spread: of_command("spread", &usual.spread)?,
        low: of_command("low", &usual.low)?,
        high: of_command("high", &usual.high)?,
        lasting: number(given, "lasting")?,
        weigh: match given.get_item("temperature")? {
            Some(value) if !value.is_none() => Weigh::Temperature(value.extract()?),
            _ => Weigh::Elites(number(given, "elites")?),
        },
        seed: number(given, "seed")?,
    })
}

#[pymethods]
impl PyPlanner {
    #[new]
    #[pyo3(signature = (vehicle, dynamics, control, cost, options, threads))]
    fn new(
        vehicle: &PyVehicle,
        dynamics: &str,
        control: &str,
        cost: &PyCost,
        options: &Bound<'_, PyDict>,
        threads: Option<usize>,
    ) -> PyResult<Self> {
        let options = options_of(vehicle, (dynamics, control), options)?;
        let shape = [options.modes, options.horizon, options.middle.len()];
        let pool = threads::pool(threads)?;
        let made = Planner::new((&vehicle.vehicle, dynamics), cost.cost.clone(), options).or_raise()?;
        Ok(Self { planner: Mutex::new(made), pool, shape })
    }

    fn begin(&self) -> PyResult<()> {
        self.planner()?.begin();
        Ok(())
    }

    /// Plans anew: the command, its mode, the mean cost of what it is made of, the least cost.
    #[pyo3(signature = (motion, time, given, field))]
    fn update(
        &self,
        py: Python<'_>,
        motion: [f64; 13],
        time: f64,
        given: Vec<f64>,
        field: Option<&PyField>,
    ) -> PyResult<(Vec<f64>, usize, f64, f64)> {
        let mut guard = self.planner()?;
        let planner = &mut *guard;
        let mut state = planner.at_rest();
        state.pos.copy_from_slice(&motion[..3]);
        state.quat.copy_from_slice(&motion[3..7]);
        state.vel.copy_from_slice(&motion[7..10]);
        state.ang_vel.copy_from_slice(&motion[10..]);
        let near = field.map(|f| |pos: &[F32x16; 3]| f.field.distance_lanes(pos));
        let plan = py.detach(|| {
            within(&self.pool, || match &near {
                Some(near) => planner.update(&state, time, &given, Some(near)),
                None => planner.update(&state, time, &given, None),
            })
        });
        let plan = plan.or_raise()?;
        Ok((plan.command, plan.mode, plan.cost, plan.best))
    }

    /// The plans. (mode, time, number of a command)
    fn means<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        arrays::owned(py, self.planner()?.means().to_vec(), &self.shape)
    }

    /// What the samples of the last update cost. (sample)
    fn costs<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let costs = self.planner()?.costs().to_vec();
        let n = costs.len();
        arrays::owned(py, costs, &[n])
    }
}

impl PyPlanner {
    fn planner(&self) -> PyResult<std::sync::MutexGuard<'_, Planner>> {
        let busy = "the planner is planning in another thread: make one for each thread";
        self.planner.try_lock().map_err(|_| PyRuntimeError::new_err(busy))
    }
}
