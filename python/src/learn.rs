//! Policies trained by the gradients of their flights: the compiled side of `propwash.learn`.

use std::time::Instant;

use numpy::PyArrayDyn;
use propwash::learn::goals::{Recover, Track, recover, track};
use propwash::learn::{Actions, Curve, Flown, LearnError, Options, Policy, Trained, train};
use propwash::physics::controllers::ControlMode;
use propwash::vehicle::Vehicle;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays;
use crate::errors::{IntoPython, OrRaise};
use crate::vehicle::PyVehicle;

/// What there is to be learnt.
#[derive(Clone, Copy)]
enum AnyGoal {
    Track(Track),
    Recover(Recover),
}

/// The same expression for every goal.
macro_rules! each {
    ($goal:expr, $of:ident => $body:expr) => {
        match $goal {
            AnyGoal::Track($of) => $body,
            AnyGoal::Recover($of) => $body,
        }
    };
}

impl IntoPython for LearnError {
    fn into_python(self) -> PyErr {
        match self {
            LearnError::Rollout(e) => e.into_python(),
            LearnError::Vehicle(e) => e.into_python(),
            other => PyValueError::new_err(other.to_string()),
        }
    }
}

/// A trained policy and how it came to be.
#[pyclass(frozen, name = "Learnt", module = "propwash._native")]
pub struct PyLearnt {
    goal: AnyGoal,
    trained: Trained,
    vehicle: Vehicle,
    dynamics: String,
    seconds: f64,
}

/// A goal by name, with its numbers.
fn goal_of(name: &str, numbers: &Bound<'_, PyDict>) -> PyResult<AnyGoal> {
    let number = |key: &str| -> PyResult<Option<f64>> {
        let Some(value) = numbers.get_item(key)? else { return Ok(None) };
        let value: f64 = value.extract()?;
        match value.is_finite() && value > 0.0 {
            true => Ok(Some(value)),
            false => {
                Err(PyValueError::new_err(format!("{key}: expected a finite number above 0, got {value}")))
            }
        }
    };
    match name {
        "track" => {
            let usual = Track::default();
            Ok(AnyGoal::Track(Track { period_s: number("period")?.unwrap_or(usual.period_s), ..usual }))
        }
        "recover" => {
            let usual = Recover::default();
            Ok(AnyGoal::Recover(Recover {
                speed_m_s: number("speed")?.unwrap_or(usual.speed_m_s),
                spin_rad_s: number("spin")?.unwrap_or(usual.spin_rad_s),
                lean_rad: number("lean")?.unwrap_or(usual.lean_rad),
                time_s: number("time")?.unwrap_or(usual.time_s),
            }))
        }
        _ => Err(PyValueError::new_err(format!("goal: expected `track` or `recover`, got {name:?}"))),
    }
}

/// Commands flown so far, and the mean cost of a command.
#[allow(clippy::type_complexity)]
pub fn curve_of<'py>(
    py: Python<'py>,
    curve: &Curve,
) -> PyResult<(Bound<'py, PyArrayDyn<u64>>, Bound<'py, PyArrayDyn<f64>>)> {
    let commands: Vec<u64> = curve.commands.iter().map(|n| *n as u64).collect();
    let n = commands.len();
    Ok((arrays::owned(py, commands, &[n])?, arrays::owned(py, curve.cost.clone(), &[n])?))
}

/// A network and what surrounds it, for `propwash.Policy`.
pub fn parts_of<'py>(py: Python<'py>, policy: &Policy, scales: &[f64]) -> PyResult<Bound<'py, PyDict>> {
    let widths = policy.network.widths();
    let mut rest = policy.network.weights();
    let mut layers = Vec::new();
    for pair in widths.windows(2) {
        let (weight, behind) = rest.split_at(pair[0] * pair[1]);
        let (bias, others) = behind.split_at(pair[1]);
        rest = others;
        let weight = arrays::owned(py, weight.to_vec(), &[pair[1], pair[0]])?;
        layers.push((weight, arrays::owned(py, bias.to_vec(), &[pair[1]])?));
    }
    let out = PyDict::new(py);
    out.set_item("layers", layers)?;
    out.set_item("middle", policy.actions.middle.clone())?;
    out.set_item("reach", policy.actions.reach.clone())?;
    let kind = if policy.actions.mode == ControlMode::RotorVel { "rotor_vel" } else { "attitude" };
    out.set_item("kind", kind)?;
    out.set_item("scales", scales)?;
    out.set_item("step_hz", policy.sim_hz as usize / policy.substeps)?;
    Ok(out)
}

/// Trains a policy.
#[pyfunction]
#[pyo3(signature = (goal, numbers, vehicle, dynamics, action, options))]
pub fn learn_bptt(
    py: Python<'_>,
    goal: &str,
    numbers: &Bound<'_, PyDict>,
    vehicle: &PyVehicle,
    dynamics: &str,
    action: &str,
    options: &Bound<'_, PyDict>,
) -> PyResult<PyLearnt> {
    let goal = goal_of(goal, numbers)?;
    let usual = Options::default();
    let whole = |key: &str, usual: usize| -> PyResult<usize> {
        options.get_item(key)?.map_or(Ok(usual), |value| value.extract())
    };
    let number = |key: &str, usual: f32| -> PyResult<f32> {
        options.get_item(key)?.map_or(Ok(usual), |value| value.extract())
    };
    let hidden = match options.get_item("hidden")? {
        Some(value) => value.extract()?,
        None => usual.hidden.clone(),
    };
    let options = Options {
        worlds: whole("worlds", usual.worlds)?,
        horizon: whole("horizon", usual.horizon)?,
        substeps: whole("substeps", usual.substeps)?,
        sim_hz: whole("freq", usual.sim_hz as usize)? as u32,
        commands: whole("commands", usual.commands)?,
        hidden,
        rate: number("rate", usual.rate)?,
        longest: number("longest", usual.longest)?,
        seed: whole("seed", 0)? as u64,
    };
    let vehicle = vehicle.vehicle.clone();
    let drone = vehicle.drone(dynamics).or_raise()?;
    let actions = match action {
        "attitude" => Actions::attitude(&drone),
        "rotor_vel" => Actions::rotors(&drone),
        _ => {
            return Err(PyValueError::new_err(format!(
                "action: expected `attitude` or `rotor_vel`, got {action:?}"
            )));
        }
    };
    let began = Instant::now();
    let of = (&vehicle, dynamics);
    let trained = py.detach(|| each!(goal, goal => train(&goal, of, &actions, &options))).or_raise()?;
    let (seconds, dynamics) = (began.elapsed().as_secs_f64(), dynamics.to_string());
    Ok(PyLearnt { goal, trained, vehicle, dynamics, seconds })
}

#[pymethods]
impl PyLearnt {
    /// Seconds that it took.
    #[getter]
    fn seconds(&self) -> f64 {
        self.seconds
    }

    /// Worlds that began anew since they went astray.
    #[getter]
    fn lost(&self) -> usize {
        self.trained.lost
    }

    /// Commands flown so far, and the mean cost of a command.
    #[allow(clippy::type_complexity)]
    fn curve<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Bound<'py, PyArrayDyn<u64>>, Bound<'py, PyArrayDyn<f64>>)> {
        curve_of(py, &self.trained.curve)
    }

    /// The network and what surrounds it: weights and biases of each layer, commands of action zero, what is added for one, the kind of action, scales of
    /// the inputs, actions a second.
    fn parts<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let scales = match self.goal {
            AnyGoal::Track(_) => track::SCALES,
            AnyGoal::Recover(_) => recover::SCALES,
        };
        parts_of(py, &self.trained.policy, &scales)
    }

    /// Flies it, from starts that the training has not seen: error (rms, most, m), flights that ended as they should, that were lost, and the path of the
    /// first.
    #[allow(clippy::type_complexity)]
    fn fly<'py>(
        &self,
        py: Python<'py>,
        vehicle: Option<&PyVehicle>,
        flights: usize,
        settle_s: f64,
        seed: u64,
    ) -> PyResult<(f64, f64, usize, usize, Bound<'py, PyArrayDyn<f64>>)> {
        if flights == 0 {
            return Err(PyValueError::new_err("flights: expected at least 1, got 0"));
        }
        let vehicle = vehicle.map_or(&self.vehicle, |v| &v.vehicle);
        let of = (vehicle, &self.dynamics[..]);
        let how = (flights, settle_s, seed);
        let flown = py.detach(|| each!(&self.goal, goal => self.trained.policy.fly(goal, of, how)));
        let Flown { off_rms_m, off_most_m, reached, lost, path_m } = flown.or_raise()?;
        let n = path_m.len();
        let path = arrays::owned(py, path_m.into_iter().flatten().collect(), &[n, 3])?;
        Ok((off_rms_m, off_most_m, reached, lost, path))
    }
}
