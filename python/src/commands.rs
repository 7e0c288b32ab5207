//! What subcommands of the program do, as functions: data sets, scenes, logs, the attitude model, flights that show an effect.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

use propwash::arena::{FlightPattern, SceneConfig};
use propwash::dataset::recorder::{self, FlightConfig};
use propwash::flight::{FlightLog, check, correction};
use propwash::gap::Drive;
use propwash::gap::accept::today_utc;
use propwash::gap::attitude_model::{self, Options};
use propwash::gap::excite::{self as excitation, Air, Request, Sensors, csv, flight, plan};
use propwash::gap::{first_flight, throttle};
use propwash::scene::{self, SceneSource};
use propwash::vehicle::first::{Given, Layout};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::errors::{OrRaise, read_json};
use crate::gap::{drive, json};
use crate::sim::describe;
use crate::threads::interruptible;
use crate::vehicle::PyVehicle;

/// Reads a description in JSON or TOML, or the manifest of a data set, and gives that of the flight, complete, as JSON.
#[pyfunction]
pub fn read_flight(text: &str) -> PyResult<String> {
    json(&FlightConfig::from_text(text).or_raise()?)
}

/// Waypoints of a CSV file, as a description has them, in JSON.
#[pyfunction]
pub fn waypoints(path: PathBuf) -> PyResult<String> {
    json(&FlightPattern::from_csv(&path).or_raise()?)
}

/// The caller's function for progress. What it raises ends the flight: worlds that are there are kept.
struct Told<'a> {
    to: Option<Py<PyAny>>,
    raised: &'a Mutex<Option<PyErr>>,
    stop: &'a AtomicBool,
}

impl recorder::Progress for Told<'_> {
    fn tell(&self, done: usize, all: usize) {
        let Some(to) = &self.to else { return };
        Python::attach(|py| {
            if let Err(e) = to.call1(py, (done, all)) {
                self.raised.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(e);
                self.stop.store(true, Ordering::Relaxed);
            }
        });
    }

    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

/// Flies what a description with changes says into a data set, and gives what became of it as JSON. `progress(done, all)` is called
/// before the first world and after each.
#[pyfunction]
pub fn fly(
    py: Python<'_>,
    config: &str,
    changes: &str,
    vehicles: Vec<Py<PyVehicle>>,
    out: PathBuf,
    threads: Option<usize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<String> {
    let changes = serde_json::from_str(changes).map_err(|e| PyValueError::new_err(e.to_string()))?;
    let mut config = FlightConfig::from_text(config).and_then(|config| config.changed(changes)).or_raise()?;
    describe(&mut config.sim, &vehicles);
    let pool = crate::threads::pool(threads)?;
    let flown = interruptible(py, move |stop| {
        let raised = Mutex::new(None);
        let progress = Told { to: progress, raised: &raised, stop };
        let flown = pool.install(|| recorder::fly(&config.load()?, &out, &progress));
        match raised.into_inner().unwrap_or_else(PoisonError::into_inner) {
            Some(e) => Err(e),
            None => flown.map(|recorded| recorded.details(&out)).or_raise(),
        }
    });
    json(&flown??)
}

/// The one scene that a description names.
fn source(scene: &str) -> PyResult<SceneSource> {
    let scene: SceneConfig = read_json("scene", scene)?;
    let sources = scene.sources(None).or_raise()?;
    match <[SceneSource; 1]>::try_from(sources) {
        Ok([one]) => Ok(one),
        Err(all) => Err(PyValueError::new_err(format!("scene: expected one, got {}", all.len()))),
    }
}

/// What depth and contacts see of a scene: as JSON and in words; whether they see every geom; whether the start overlaps something.
#[pyfunction]
pub fn lint(
    py: Python<'_>,
    scene: &str,
    spawn: [f64; 3],
    spawn_radius: f64,
) -> PyResult<(String, String, bool, bool)> {
    let source = source(scene)?;
    let report = interruptible(py, move |_| scene::lint(&source, spawn, spawn_radius))?.or_raise()?;
    let all_seen = report.mismatches().next().is_none();
    Ok((json(&report)?, report.to_string(), all_seen, report.spawn_is_blocked()))
}

/// MJCF of a generated scene.
#[pyfunction]
pub fn scene_new(py: Python<'_>, scene: &str) -> PyResult<String> {
    match py.detach(|| source(scene))? {
        SceneSource::Text { xml, .. } => Ok(xml),
        SceneSource::File(path) => {
            let words = format!("scene: expected one that is generated, got {}", path.display());
            Err(PyValueError::new_err(words))
        }
    }
}

/// What a log holds and what in it cannot be right: as JSON and in words; with `mend`, of the log as a mapping corrects it, then the text
/// of that mapping and what it corrects too.
#[pyfunction]
pub fn log_check(
    py: Python<'_>,
    log: PathBuf,
    mapping: Option<PathBuf>,
    mend: bool,
) -> PyResult<(String, String, String, Vec<String>)> {
    let checked = interruptible(py, move |_| {
        if mend {
            let mended = correction::mend(&log, mapping.as_deref())?;
            let fixes = mended.fixes.iter().map(ToString::to_string).collect();
            return Ok((mended.report, mended.text, fixes));
        }
        Ok((check(&FlightLog::load(&log, mapping.as_deref())?), String::new(), Vec::new()))
    });
    let checked = checked?.map_err(|e: propwash::flight::FlightError| propwash::Error::from(e)).or_raise()?;
    let (report, text, fixes) = checked;
    Ok((json(&report)?, report.to_string(), text, fixes))
}

/// The attitude model of a log: as JSON and in words; the text of the vehicle file with it, which `out` is to hold; warnings about the
/// log.
#[pyfunction]
pub fn identify(
    py: Python<'_>,
    log: PathBuf,
    vehicle: Py<PyVehicle>,
    dynamics: String,
    mapping: Option<PathBuf>,
    out: Option<PathBuf>,
) -> PyResult<(String, String, String, Vec<String>)> {
    let made = interruptible(py, move |_| {
        let vehicle = &vehicle.get().vehicle;
        out.as_deref().map_or(Ok(()), attitude_model::check_out)?;
        let (log, report) = FlightLog::open(&log, mapping.as_deref())?;
        let found = attitude_model::identify(&log, vehicle, &Options { dynamics })?;
        let better = found.vehicle_for_any_folder(vehicle, &today_utc())?;
        Ok::<_, propwash::Error>((found, better, report.warnings()))
    });
    let (found, better, warnings) = made?.or_raise()?;
    Ok((json(&found)?, found.to_string(), better.to_toml().to_string(), warnings))
}

/// What is known of a new vehicle.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct NewVehicle {
    mass: f64,
    mass_sigma: Option<f64>,
    arm: f64,
    rotors: usize,
    plus: bool,
    first_clockwise: bool,
    radius: Option<f64>,
    inertia: Option<[f64; 3]>,
    thrust_to_weight: Option<f64>,
}

/// A first vehicle from what is known and from flights: the text of its file, JSON, and words.
#[pyfunction]
pub fn vehicle_new(
    py: Python<'_>,
    given: NewVehicle,
    logs: Vec<PathBuf>,
    mapping: Option<PathBuf>,
    name: String,
) -> PyResult<(String, String, String)> {
    let given = Given {
        mass_kg: given.mass,
        mass_sigma_kg: given.mass_sigma,
        arm_m: given.arm,
        rotors: given.rotors,
        layout: if given.plus { Layout::Plus } else { Layout::X },
        first_clockwise: given.first_clockwise,
        radius_m: given.radius,
        inertia_kg_m2: given.inertia,
        thrust_to_weight: given.thrust_to_weight,
    };
    let made =
        interruptible(py, move |_| first_flight::first_vehicle(&given, &logs, mapping.as_deref(), &name));
    let (vehicle, told) = made?.or_raise()?;
    Ok((vehicle.to_toml().to_string(), json(&told)?, told.to_string()))
}

/// A vehicle with its motors by throttle, fitted to flights: the text of its file, JSON, and words.
#[pyfunction]
pub fn vehicle_throttle(
    py: Python<'_>,
    logs: Vec<PathBuf>,
    held_out: Vec<PathBuf>,
    vehicle: Py<PyVehicle>,
    mapping: Option<PathBuf>,
) -> PyResult<(String, String, String)> {
    let pool = crate::threads::pool(None)?;
    interruptible(py, move |_| {
        let of = vehicle.get();
        pool.install(|| {
            let found = throttle::read(&logs, &held_out, mapping.as_deref(), &of.vehicle).or_raise()?;
            let text = found.write_into(&of.text, &of.vehicle.name, &of.vehicle);
            let text = text.map_err(propwash::gap::Error::from).or_raise()?;
            Ok((text, json(&found)?, found.to_string()))
        })
    })?
}

/// What to plan a flight for.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Wish {
    want: Vec<String>,
    seconds: f64,
    share: f64,
    room: [f64; 3],
    ground: bool,
    ceiling_z: Option<f64>,
    drive: Option<String>,
    sensors: String,
    air_force: Option<f64>,
    seed: u64,
}

/// A waypoint: time, s, position, m, heading, rad.
type Waypoint = (f64, [f64; 3], f64);

impl Wish {
    fn request(self) -> PyResult<Request> {
        let air = Air::default();
        Ok(Request {
            want: self.want,
            seconds: self.seconds,
            share: self.share,
            box_m: self.room,
            ground: self.ground,
            ceiling_z_m: self.ceiling_z,
            sensors: sensors(&self.sensors)?,
            air: Air { force_m_s2: self.air_force.unwrap_or(air.force_m_s2), ..air },
            drive: driven_by(self.drive.as_deref())?,
            seed: self.seed,
        })
    }
}

/// What drives the model; rotor commands where nothing is said.
fn driven_by(name: Option<&str>) -> PyResult<Drive> {
    Ok(drive(name)?.unwrap_or(Drive::RotorCommands))
}

/// A flight of named manoeuvres: its waypoints, and the same as CSV.
#[pyfunction]
pub fn manoeuvres(
    py: Python<'_>,
    vehicle: Py<PyVehicle>,
    wish: Wish,
    names: Vec<String>,
) -> PyResult<(Vec<Waypoint>, String)> {
    let request = wish.request()?;
    let waypoints =
        interruptible(py, move |_| flight(&vehicle.get().vehicle, &request, &names))?.or_raise()?;
    let text = csv(&waypoints);
    Ok((waypoints, text))
}

/// Manoeuvres that tell effects from others, each with what it does, in words.
#[pyfunction]
pub fn tell_apart(
    py: Python<'_>,
    vehicle: Py<PyVehicle>,
    want: Vec<String>,
    others: Vec<String>,
    drive: Option<&str>,
    sensors_given: &str,
) -> PyResult<Vec<(String, String)>> {
    let (drive, sensors) = (driven_by(drive)?, sensors(sensors_given)?);
    interruptible(py, move |_| {
        excitation::tell_apart(&vehicle.get().vehicle, drive, &sensors, &want, &others)
    })?
    .or_raise()
}

/// A flight that shows effects: as JSON; its waypoints; the same as CSV; whether every interval is as narrow as wanted.
#[pyfunction]
pub fn excite(
    py: Python<'_>,
    vehicle: Py<PyVehicle>,
    wish: Wish,
) -> PyResult<(String, Vec<Waypoint>, String, bool)> {
    let request = wish.request()?;
    let pool = crate::threads::pool(None)?;
    let made =
        interruptible(py, move |_| pool.install(|| plan(&vehicle.get().vehicle, &request)))?.or_raise()?;
    Ok((json(&made)?, made.waypoints.clone(), made.csv(), made.complete()))
}

/// The sensors of a flight: those by default with what is given.
fn sensors(given: &str) -> PyResult<Sensors> {
    let fault = |e: serde_json::Error| PyValueError::new_err(format!("sensors: {e}"));
    let mut all = serde_json::to_value(Sensors::default()).map_err(fault)?;
    let given: serde_json::Map<String, serde_json::Value> = read_json("sensors", given)?;
    for (name, value) in given {
        let Some(place) = all.get_mut(&name) else {
            let known: Vec<&String> = all.as_object().into_iter().flatten().map(|(k, _)| k).collect();
            let words = format!("sensors: expected one of {known:?}, got {name:?}");
            return Err(PyValueError::new_err(words));
        };
        *place = value;
    }
    serde_json::from_value(all).map_err(fault)
}
