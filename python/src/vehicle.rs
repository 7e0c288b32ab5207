//! `propwash.Vehicle`.

use std::collections::BTreeMap;
use std::path::PathBuf;

use propwash::physics::controllers::Rates;
use propwash::vehicle::effects::named_parameters;
use propwash::vehicle::{self, Vehicle};
use pyo3::prelude::*;

use crate::errors::OrRaise;

/// A vehicle: rigid body, rotors, on-board controllers and a list of effects, as one TOML file states them.
///
/// ``Vehicle("cf2x_L250")`` is a built-in one, ``Vehicle("my/quad.toml")`` a file. It cannot be changed;
/// ``with_effects`` gives another one.
#[pyclass(frozen, name = "Vehicle", module = "propwash")]
#[derive(Clone)]
pub struct PyVehicle {
    pub vehicle: Vehicle,
    /// Text of its file, with comments.
    pub text: String,
}

impl From<Vehicle> for PyVehicle {
    fn from(vehicle: Vehicle) -> Self {
        let own = Vehicle::builtin(&vehicle.name).is_ok_and(|own| own == vehicle);
        let text =
            Vehicle::builtin_file(&vehicle.name).ok().filter(|_| own).unwrap_or(vehicle.to_toml()).into();
        Self { vehicle, text }
    }
}

#[pymethods]
impl PyVehicle {
    #[new]
    fn new(source: PathBuf) -> PyResult<Self> {
        let name = source.to_string_lossy();
        // A file goes before a name, as on the command line.
        let is_path = source.is_file() || source.extension().is_some() || source.components().count() > 1;
        if !is_path {
            let vehicle = Vehicle::builtin(&name).or_raise()?;
            return Ok(Self { vehicle, text: Vehicle::builtin_file(&name).or_raise()?.into() });
        }
        let vehicle = Vehicle::load(&source).or_raise()?;
        Ok(Self { vehicle, text: std::fs::read_to_string(&source)? })
    }

    /// A vehicle from the text of a vehicle file.
    #[staticmethod]
    #[pyo3(signature = (text, name = "vehicle"))]
    fn from_toml(text: &str, name: &str) -> PyResult<Self> {
        Ok(Self { vehicle: Vehicle::from_toml(name, text).or_raise()?, text: text.into() })
    }

    /// Name: that of the built-in vehicle, or the file name without its ending.
    #[getter]
    fn name(&self) -> &str {
        &self.vehicle.name
    }

    /// Name of a built-in shell, or path of a shell's MJCF file: what others see and touch of the vehicle.
    #[getter]
    fn shell(&self) -> &str {
        &self.vehicle.shell
    }

    /// Doubtful but allowed values of the file.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.vehicle.warnings().to_vec()
    }

    /// Names of the dynamics for which the file has parameters.
    #[getter]
    fn dynamics(&self) -> Vec<&'static str> {
        self.vehicle.available_dynamics()
    }

    /// Rates of the on-board controller's stages by the file, Hz; `Sim.rates` are those in force.
    #[getter]
    fn rates(&self) -> BTreeMap<&'static str, u32> {
        by_mode(self.vehicle.rates)
    }

    /// Control modes that make sense with these dynamics.
    #[pyo3(signature = (dynamics = "first_principles"))]
    fn modes(&self, dynamics: &str) -> PyResult<Vec<&'static str>> {
        Ok(self.vehicle.modes(dynamics).or_raise()?.into_iter().map(|m| m.name()).collect())
    }

    /// All parameters in SI by name, as `Sim.set_parameter` takes them.
    #[pyo3(signature = (dynamics = "first_principles"))]
    fn parameters(&self, dynamics: &str) -> PyResult<Vec<(String, f64)>> {
        let mut drone = self.vehicle.drone(dynamics).or_raise()?;
        let mut out = Vec::new();
        drone.visit(&mut |name, value| out.push((name.to_string(), *value)));
        Ok(out)
    }

    /// The effects that belong to these dynamics, in order: kind and parameters by name.
    #[pyo3(signature = (dynamics = "first_principles"))]
    #[allow(clippy::type_complexity)]
    fn effects(&self, dynamics: &str) -> PyResult<Vec<(&'static str, Vec<(String, f64)>)>> {
        let drone = self.vehicle.drone(dynamics).or_raise()?;
        Ok(drone.effects.iter().map(|e| (e.kind(), named_parameters(e))).collect())
    }

    /// The same vehicle with further effects, written as in a vehicle file: the text of `[[effect]]` tables.
    fn with_effects(&self, text: &str) -> PyResult<Self> {
        let text = format!("{}\n{text}\n", self.text);
        let mut vehicle = Vehicle::from_toml(&self.vehicle.name, &text).or_raise()?;
        // Relative shells start at the file that this vehicle was read from.
        if let Some(shell) = self.vehicle.shell_path() {
            vehicle.shell = std::path::absolute(shell)?.to_string_lossy().into_owned();
        }
        Ok(Self { vehicle, text })
    }

    /// Text of its file, with comments.
    #[getter]
    fn text(&self) -> &str {
        &self.text
    }

    /// The file as TOML that reads back equal; comments are not kept.
    fn to_toml(&self) -> &str {
        self.vehicle.to_toml()
    }

    /// SHA-256 (hex) of `to_toml()`.
    #[getter]
    fn sha256(&self) -> String {
        self.vehicle.sha256()
    }

    fn __repr__(&self) -> String {
        format!("<propwash.Vehicle {} ({})>", self.vehicle.name, self.vehicle.available_dynamics().join(", "))
    }

    /// Its name, its text, and the path of its shell, which other processes need not find by the file.
    #[allow(clippy::type_complexity)]
    fn __reduce__(&self, py: Python<'_>) -> PyResult<(Py<PyAny>, (String, String, Option<String>))> {
        let make = py.import("propwash._native")?.getattr("vehicle_of")?.unbind();
        let shell = self.vehicle.shell_path().map(std::path::absolute).transpose()?;
        let shell = shell.map(|path| path.to_string_lossy().into_owned());
        // Networks beside the file: other processes may not know them, and this text holds them.
        let networks = !vehicle::network::files_of(&self.text).is_empty();
        let text = if networks { self.vehicle.to_toml() } else { &self.text };
        Ok((make, (self.vehicle.name.clone(), text.into(), shell)))
    }
}

/// A vehicle that was pickled or copied.
#[pyfunction]
#[pyo3(signature = (name, text, shell))]
pub fn vehicle_of(name: &str, text: &str, shell: Option<String>) -> PyResult<PyVehicle> {
    let mut vehicle = Vehicle::from_toml(name, text).or_raise()?;
    if let Some(shell) = shell {
        vehicle.shell = shell;
    }
    Ok(PyVehicle { vehicle, text: text.into() })
}

/// Names and contents of the networks that the text of a vehicle file needs beside it.
#[pyfunction]
pub fn network_files(text: &str) -> Vec<(String, String)> {
    vehicle::network::files_of(text)
}

/// Rates by the control modes whose commands they take up, Hz.
pub fn by_mode(rates: Rates) -> BTreeMap<&'static str, u32> {
    BTreeMap::from([
        ("state", rates.state_hz),
        ("attitude", rates.attitude_hz),
        ("body_rate", rates.body_rate_hz),
        ("force_torque", rates.force_torque_hz),
    ])
}

/// Names of the built-in vehicles.
#[pyfunction]
pub fn vehicles() -> Vec<&'static str> {
    vehicle::BUILTIN.to_vec()
}
