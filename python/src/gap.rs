//! Models against flights: `propwash.compare`, `propwash.diagnose`, `propwash.add`.

use std::collections::HashMap;
use std::path::PathBuf;

use propwash::gap::diagnose::{Moments, Settings};
use propwash::gap::drift::{self, Order, Series};
use propwash::gap::fitted::{self, Calibrate, Filed};
use propwash::gap::ladder::Flights;
use propwash::gap::report::{Report, ladder_png, text};
use propwash::gap::watch::Watch;
use propwash::gap::{Drive, Options, StatedNoise, Track, compare};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::errors::{Error, IntoPython, OrRaise};
use crate::threads::interruptible;
use crate::vehicle::PyVehicle;

/// How logs are read.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Reading {
    drive: Option<String>,
    ground_z: Option<f64>,
    ceiling_z: Option<f64>,
    neighbours: Option<Vec<String>>,
    load: Option<String>,
    noise: HashMap<String, f64>,
    mapping: Option<PathBuf>,
}

impl Reading {
    pub fn read(&self, logs: &[PathBuf], vehicle: &PyVehicle) -> PyResult<Vec<Track>> {
        fitted::read(logs, self.mapping.as_deref(), &vehicle.vehicle, &self.options()?).or_raise()
    }

    /// How logs are read, beside their mapping.
    fn options(&self) -> PyResult<Options> {
        let drive = drive(self.drive.as_deref())?;
        let ground = self.ground_z.unwrap_or(0.0);
        if let Some(ceiling) = self.ceiling_z.filter(|c| !(*c > ground)) {
            return Err(PyValueError::new_err(format!(
                "ceiling_z: expected a height above the ground at {ground} m, got {ceiling} m"
            )));
        }
        let mut noise = StatedNoise::default();
        for (channel, value) in &self.noise {
            let words = |e| format!("noise: expected {e}, got {channel}: {value}");
            noise.set(channel, *value).map_err(|e| PyValueError::new_err(words(e)))?;
        }
        Ok(Options {
            drive,
            noise,
            ground_z_m: self.ground_z,
            ceiling_z_m: self.ceiling_z,
            neighbours: self.neighbours.clone(),
            load: self.load.clone(),
        })
    }
}

/// What drives the model, by its name.
pub fn drive(name: Option<&str>) -> PyResult<Option<Drive>> {
    Ok(match name {
        None => None,
        Some("rotor_speeds") => Some(Drive::RotorSpeeds),
        Some("rotor_commands") => Some(Drive::RotorCommands),
        Some("attitude_commands") => Some(Drive::AttitudeCommands),
        Some("thrust") => Some(Drive::Thrust),
        Some(got) => {
            return Err(PyValueError::new_err(format!(
                "drive: expected rotor_speeds, rotor_commands, attitude_commands or thrust, got {got:?}"
            )));
        }
    })
}

/// A value as JSON.
pub fn json(value: &impl serde::Serialize) -> PyResult<String> {
    serde_json::to_string(value).map_err(|e| Error::new_err(format!("JSON cannot be written: {e}")))
}

/// A comparison as JSON and as a page.
#[pyfunction]
pub fn gap_compare(
    py: Python<'_>,
    logs: Vec<PathBuf>,
    vehicle: Py<PyVehicle>,
    reading: Reading,
) -> PyResult<(String, String)> {
    let pool = crate::threads::pool(None)?;
    interruptible(py, move |_| {
        let vehicle = vehicle.get();
        pool.install(|| {
            let tracks = reading.read(&logs, vehicle)?;
            let comparison = compare(&tracks, &vehicle.vehicle).or_raise()?;
            let page = Report::with_flights(&comparison, &tracks, &vehicle.vehicle).or_raise()?;
            Ok((json(&comparison)?, page.html()))
        })
    })?
}

/// What `gap_diagnose` gives: the diagnosis as JSON, in words, as a page and as a picture of its ladder; the text of the completed
/// vehicle file with its remarks, none where nothing was found; effects that the flights do not determine, with what to fly; why
/// nothing was completed, where nothing was.
type Diagnosed<'py> = (
    String,
    String,
    String,
    Option<Bound<'py, PyBytes>>,
    Option<String>,
    Vec<(String, String)>,
    Option<String>,
);

/// Diagnoses flights, or fits the effects that are given.
#[pyfunction]
#[allow(clippy::too_many_arguments)]
pub fn gap_diagnose(
    py: Python<'_>,
    logs: Vec<PathBuf>,
    held_out: Vec<PathBuf>,
    hold_out: f64,
    vehicle: Py<PyVehicle>,
    reading: Reading,
    only: Option<Vec<String>>,
    given: Option<Vec<String>>,
    calibrate: bool,
    moments: bool,
    network: bool,
) -> PyResult<Diagnosed<'_>> {
    let pool = crate::threads::pool(None)?;
    let adding = given.is_some();
    let (fitted, page, picture) = interruptible(py, move |_| {
        let of = vehicle.get();
        pool.install(|| {
            let (tracks, unseen) = (reading.read(&logs, of)?, reading.read(&held_out, of)?);
            let flights = Flights::new(tracks, unseen, hold_out);
            propwash::gap::compare::one_vehicle(&flights.all()).or_raise()?;
            let moments = if moments { Moments::Apart } else { Moments::No };
            let settings = Settings { given, only, moments, network, ..Settings::default() };
            let filed = Filed { label: &of.vehicle.name, vehicle: &of.vehicle, text: of.text.clone() };
            let by = if adding { "propwash.add" } else { "propwash.diagnose" };
            let calibrate = match (adding, calibrate) {
                (_, true) => Calibrate::Write,
                (true, false) => Calibrate::No,
                (false, false) => Calibrate::Show,
            };
            let fitted = fitted::fit(filed, &flights, &settings, by, calibrate).or_raise()?;
            let verdict = &fitted.diagnosed.verdict;
            let about = fitted.flights(&flights);
            let page =
                Report::of_diagnosis(&fitted.diagnosed, about, &of.vehicle, fitted.after()).or_raise()?;
            // A diagnosis without a ladder has no picture of one; its warnings say why.
            let picture = match verdict.ladder.is_empty() {
                true => None,
                false => Some(ladder_png(verdict).or_raise()?),
            };
            Ok::<_, PyErr>((fitted, page.html(), picture))
        })
    })??;
    let verdict = &fitted.diagnosed.verdict;
    let changed = fitted.after().is_some().then(|| fitted.text.clone());
    let nothing = fitted.nothing();
    let open = fitted.diagnosed.undetermined();
    let open = open.into_iter().map(|u| (u.id, format!("{}; {}", u.found, u.manoeuvre))).collect();
    Ok((json(verdict)?, text(verdict), page, picture.map(|p| PyBytes::new(py, &p)), changed, open, nothing))
}

/// Takes the logs of a folder, one after the other: everything as JSON, in words, and the text of the vehicle file with what is accepted,
/// none where that does not lower the errors of the newest flight.
#[pyfunction]
#[allow(clippy::too_many_arguments)]
pub fn gap_watch(
    py: Python<'_>,
    folder: PathBuf,
    vehicle: Py<PyVehicle>,
    reading: Reading,
    hold_out: f64,
    by_name: bool,
    record: Option<PathBuf>,
) -> PyResult<(String, String, Option<String>)> {
    let pool = crate::threads::pool(None)?;
    interruptible(py, move |stop| {
        let of = vehicle.get();
        pool.install(|| {
            let options = reading.options()?;
            let how = drift::Reading { mapping: reading.mapping.clone(), options, hold_out };
            let mut series = Series::new(&of.vehicle.name, &of.vehicle, &of.text, how);
            if let Some(record) = &record {
                series.resume(record).or_raise()?;
            }
            let order = if by_name { Order::Name } else { Order::Time };
            let watch = Watch { cancel: Some(stop), ..Watch::default() };
            let each = |series: &Series, _: &drift::Entry| -> Result<(), propwash::Error> {
                let Some(path) = &record else { return Ok(()) };
                let failed = |source| propwash::Error::Io { path: path.clone(), source };
                series.record(path).map_err(failed)
            };
            let grows = series.take_all(&folder, order, SETTLES, &watch, each).or_raise()?;
            let mut words: Vec<String> = series.entries().iter().map(drift::block).collect();
            words.extend(grows.iter().map(|name| format!("{name}  left out: still being written")));
            words.push(String::new());
            words.push(drift::table(&series));
            let text = series.written().map_err(propwash::Error::from).or_raise()?;
            Ok((json(&series.document())?, words.join("\n"), text))
        })
    })?
}

/// How long a log must stay as it is to be taken.
const SETTLES: std::time::Duration = std::time::Duration::from_millis(200);

impl IntoPython for propwash::Error {
    fn into_python(self) -> PyErr {
        use propwash::Error as E;
        let words = self.to_string();
        match self {
            E::Vehicle(e) => e.into_python(),
            E::Rollout(e) => e.into_python(),
            E::Scene(e) => e.into_python(),
            E::Sense(e) => e.into_python(),
            E::Arena(e) => (*e).into_python(),
            E::Gap(e) => e.into_python(),
            E::Io { .. }
            | E::Flight(propwash::flight::FlightError::Read { .. })
            | E::Dataset(propwash::dataset::DatasetError::Io { .. }) => {
                pyo3::exceptions::PyOSError::new_err(words)
            }
            E::Usage { .. }
            | E::Flight(_)
            | E::Accept(_)
            | E::AttitudeModel(_)
            | E::Generate(_)
            | E::Dataset(_) => PyValueError::new_err(words),
            _ => Error::new_err(words),
        }
    }
}

impl IntoPython for propwash::gap::Error {
    fn into_python(self) -> PyErr {
        propwash::Error::from(self).into_python()
    }
}

impl IntoPython for propwash::gap::GapError {
    fn into_python(self) -> PyErr {
        use propwash::gap::GapError as G;
        let words = self.to_string();
        match self {
            G::Unknown { .. } => pyo3::exceptions::PyKeyError::new_err(words),
            G::Log { .. } | G::DifferentVehicles { .. } | G::Expression { .. } => {
                PyValueError::new_err(words)
            }
            _ => Error::new_err(words),
        }
    }
}
