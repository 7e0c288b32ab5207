//! A vehicle's equations as a function: what `propwash.export` prints.

use propwash::export::text::{Group, Language, Printed};
use propwash::physics::controllers::ControlMode;
use propwash::physics::integrate::Integrator;
use propwash::rollout::function::{Asked, What, function};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::errors::OrRaise;
use crate::vehicle::PyVehicle;

/// A vehicle's equations as one function of named vectors.
#[pyclass(frozen, name = "Function", module = "propwash._native")]
pub struct PyFunction {
    function: Printed,
}

/// One of a list of names.
fn named<T>(name: &str, got: &str, known: &[&str], found: Option<T>) -> PyResult<T> {
    found.ok_or_else(|| {
        PyValueError::new_err(format!("{name}: expected one of {}, got {got:?}", known.join(", ")))
    })
}

#[pymethods]
impl PyFunction {
    #[new]
    #[allow(clippy::too_many_arguments, reason = "one for each choice")]
    fn new(
        vehicle: &PyVehicle,
        what: &str,
        dynamics: String,
        control: &str,
        integrator: &str,
        freq: u32,
        parameters: Vec<String>,
        surroundings: bool,
    ) -> PyResult<Self> {
        let integrators = [Integrator::Euler, Integrator::SemiImplicitEuler, Integrator::Rk4];
        let modes = ControlMode::ALL.map(ControlMode::name);
        let asked = Asked {
            what: named("what", what, &What::ALL.map(|(name, _)| name), What::named(what))?,
            dynamics,
            control: named(
                "control",
                control,
                &modes,
                ControlMode::ALL.into_iter().find(|m| m.name() == control),
            )?,
            integrator: named(
                "integrator",
                integrator,
                &integrators.map(Integrator::name),
                integrators.into_iter().find(|i| i.name() == integrator),
            )?,
            sim_hz: freq,
            parameters,
            surroundings,
        };
        Ok(Self { function: function(&vehicle.vehicle, &asked).or_raise()? })
    }

    /// Its name in the printed code.
    #[getter]
    fn name(&self) -> &str {
        &self.function.name
    }

    /// What it computes.
    #[getter]
    fn about(&self) -> &str {
        &self.function.about
    }

    /// Name, meaning, names of the numbers and usual values of each input.
    fn inputs(&self) -> Vec<(String, String, Vec<String>, Vec<f64>)> {
        let of = |g: &Group| (g.name.clone(), g.about.clone(), g.entries.clone(), g.defaults.clone());
        self.function.inputs.iter().map(of).collect()
    }

    /// Name, meaning and names of the numbers of each output.
    fn outputs(&self) -> Vec<(String, String, Vec<String>)> {
        self.function.outputs.iter().map(|g| (g.name.clone(), g.about.clone(), g.entries.clone())).collect()
    }

    /// Its source in a language.
    fn source(&self, language: &str) -> PyResult<String> {
        let names = Language::ALL.map(|(name, _)| name);
        Ok(self.function.print(named("to", language, &names, Language::named(language))?))
    }

    /// The results in f64, as the equations give them.
    fn evaluate(&self, inputs: Vec<Vec<f64>>) -> PyResult<Vec<Vec<f64>>> {
        let lengths: Vec<usize> = self.function.inputs.iter().map(|g| g.entries.len()).collect();
        let got: Vec<usize> = inputs.iter().map(Vec::len).collect();
        self.function.evaluate(&inputs).ok_or_else(|| {
            PyValueError::new_err(format!("inputs: expected vectors of {lengths:?} numbers, got {got:?}"))
        })
    }
}
