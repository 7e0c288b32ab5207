//! What a person works on: logs, a vehicle, a scene, and where they lie. One thread owns it ([`super::worker`]).

use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::{Value, json};
use tempfile::TempDir;

use super::Options;
use super::answer::{Answer, Refusal};
use super::engine::Engine;
use super::examples::{self, Example};
use super::mapping::Choice;
use super::sanity::{self, Sane};
use crate::flight::{CheckReport, FlightLog, Mapping, Severity, check, files, peek};
use crate::scene::{SCENES, SceneSource};
use crate::vehicle::{BUILTIN, Vehicle};
use crate::view;
use crate::{Error, Result};

/// Most logs of a session.
pub const MAX_LOGS: usize = 32;

/// What a log is for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Use {
    /// Effects are fitted to it.
    #[default]
    Fit,
    /// It is held out, and checks what was found.
    Check,
}

/// A log and what the checker says of it.
pub struct Log {
    /// Number in requests.
    pub id: usize,
    /// Name, without folders.
    pub name: String,
    /// Where it lies.
    pub path: PathBuf,
    /// Mapping that it is read with, beside one that lies next to it.
    pub mapping: Option<PathBuf>,
    /// What it is for.
    pub used: Use,
    state: Checked,
}

/// What is known of a log.
enum Checked {
    NotYet,
    /// It cannot be read; whether naming its columns would help.
    Fault {
        words: String,
        mappable: bool,
    },
    Read {
        report: Box<CheckReport>,
        sane: Vec<Sane>,
    },
}

/// A vehicle as filed.
pub struct Filed {
    /// Built-in name, or name of the file.
    pub label: String,
    /// Where its file lies; none for a built-in one.
    pub path: Option<PathBuf>,
    /// The text of its file.
    pub text: String,
    /// The vehicle.
    pub vehicle: Vehicle,
}

/// What a person works on.
pub struct Desk {
    folder: TempDir,
    /// The logs, in the order in which they came.
    pub logs: Vec<Log>,
    /// The vehicle.
    pub vehicle: Option<Filed>,
    scene: Option<(String, PathBuf)>,
    example: Option<&'static Example>,
    last: usize,
    engine: Option<Engine>,
}

impl Desk {
    /// An empty desk with a folder of its own, which goes with it.
    ///
    /// # Errors
    /// Where the system has no place for temporary files.
    pub fn new() -> Result<Self> {
        let folder = tempfile::Builder::new()
            .prefix("propwash-lab-")
            .tempdir()
            .map_err(|source| Error::Io { path: std::env::temp_dir(), source })?;
        Ok(Self {
            folder,
            logs: Vec::new(),
            vehicle: None,
            scene: None,
            example: None,
            last: 0,
            engine: None,
        })
    }

    /// A desk with what the command line names.
    ///
    /// # Errors
    /// Those of vehicle and scene.
    pub fn begun_with(options: &Options) -> Result<Self> {
        let mut desk = Self::new()?;
        for log in &options.logs {
            desk.put_log(view::title(log), log.clone());
        }
        if let Some(name) = &options.vehicle {
            desk.vehicle = Some(filed(name)?);
        }
        if let Some(scene) = &options.scene {
            view::scene_shapes(&SceneSource::file(scene))?;
            desk.scene = Some((view::title(scene), scene.clone()));
        }
        Ok(desk)
    }

    /// The folder of the session.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Leaves out what was computed of the logs.
    pub fn forget_engine(&mut self) {
        self.engine = None;
    }

    /// The engine.
    ///
    /// # Errors
    /// Where the logs were not opened yet.
    pub fn engine(&mut self) -> std::result::Result<&mut Engine, Refusal> {
        self.engine
            .as_mut()
            .ok_or_else(|| Refusal::conflict("the logs were changed: press Continue on the check page"))
    }

    /// Opens the engine over the logs that can be used.
    ///
    /// # Errors
    /// In words, where something is missing or a log does not suit the vehicle.
    pub fn open(&mut self) -> Answer {
        if let Some(words) = self.waits_for() {
            return Err(Refusal::conflict(words));
        }
        let Some(filed) = &self.vehicle else {
            return Err(Refusal::conflict("choose the vehicle that flew"));
        };
        let logs: Vec<&Log> = self.logs.iter().filter(|l| l.usable()).collect();
        self.engine = Some(Engine::open(filed, &logs)?);
        Ok(Value::Null)
    }

    /// What a log is used for.
    ///
    /// # Errors
    /// Where no log would be left for the fit.
    pub fn set_use(&mut self, id: usize, used: Use) -> Answer {
        self.log(id)?;
        if let Some(engine) = &mut self.engine {
            engine.set_use(id, used)?;
        }
        self.log(id)?.used = used;
        Ok(Value::Null)
    }

    fn put_log(&mut self, name: String, path: PathBuf) -> usize {
        self.engine = None;
        self.last += 1;
        let used = Use::default();
        self.logs.push(Log { id: self.last, name, path, mapping: None, used, state: Checked::NotYet });
        self.last
    }

    /// A log by its number.
    ///
    /// # Errors
    /// Where it is not there.
    pub fn log(&mut self, id: usize) -> std::result::Result<&mut Log, Refusal> {
        let found = self.logs.iter_mut().find(|l| l.id == id);
        found.ok_or_else(|| Refusal::missing("this log is not there any more: load the page again"))
    }

    /// Takes a file that was uploaded to `path`, by what it is: a log, a vehicle file, a mapping or a scene.
    ///
    /// # Errors
    /// In words, where it is none of these or is wrong.
    pub fn take(&mut self, name: &str, path: &Path) -> Answer {
        self.take_as(name, path).map_err(|refusal| refusal.hiding(path, name))
    }

    fn take_as(&mut self, name: &str, path: &Path) -> Answer {
        let ending =
            Path::new(name).extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        match ending.as_str() {
            "csv" | "txt" | "parquet" | "ulg" | "ulog" | "mcap" => {
                if self.logs.len() >= MAX_LOGS {
                    return Err(Refusal::conflict(format!(
                        "a session takes at most {MAX_LOGS} logs: take one out first"
                    )));
                }
                if self.example.take().is_some() {
                    self.logs.clear();
                    self.vehicle = None;
                }
                let id = self.put_log(name.to_string(), path.to_path_buf());
                self.look_at(id)?;
                Ok(json!({ "kind": "log", "log": id }))
            }
            "toml" => self.take_toml(name, path),
            "xml" | "mjcf" => {
                view::scene_shapes(&SceneSource::file(path))?;
                self.scene = Some((name.to_string(), path.to_path_buf()));
                Ok(json!({ "kind": "scene" }))
            }
            _ => Err(Refusal::bad(format!(
                "expected a flight log (.csv, .txt, .parquet, .ulg, .mcap), a vehicle file or a mapping (.toml), or a scene (.xml), got `{name}`"
            ))),
        }
    }

    /// A vehicle file has a body; any other TOML file is a mapping: of the log of its name, else of all logs without one.
    fn take_toml(&mut self, name: &str, path: &Path) -> Answer {
        let text = files::read_text(path).map_err(|source| Error::Io { path: name.into(), source })?;
        if text.parse::<toml::Table>().is_ok_and(|t| t.contains_key("body")) {
            let vehicle = Vehicle::from_toml(name, &text)?;
            self.vehicle = Some(Filed { label: name.into(), path: Some(path.to_path_buf()), text, vehicle });
            self.look_again();
            return Ok(json!({ "kind": "vehicle" }));
        }
        Mapping::parse(&text, Path::new(name))?;
        let stem = Path::new(name).file_stem();
        let own = self.logs.iter().any(|l| Path::new(&l.name).file_stem() == stem);
        if self.logs.is_empty() {
            return Err(Refusal::bad(format!(
                "`{name}` is a mapping: drop the log that it belongs to first"
            )));
        }
        for log in &mut self.logs {
            let meant = if own { Path::new(&log.name).file_stem() == stem } else { log.mapping.is_none() };
            if meant {
                log.mapping = Some(path.to_path_buf());
                log.state = Checked::NotYet;
            }
        }
        self.look_again();
        Ok(json!({ "kind": "mapping" }))
    }

    /// Flies an example and puts it on the empty desk.
    ///
    /// # Errors
    /// Where there is none of that name.
    pub fn example(&mut self, name: &str) -> Answer {
        let example = examples::named(name)?;
        let log = example.fly()?;
        let path = self.folder().join(format!("example_{name}.csv"));
        log.save(&path)?;
        let (label, vehicle) = example.vehicle()?;
        let text = vehicle.to_toml().to_string();
        self.logs.clear();
        self.vehicle = Some(Filed { label: label.into(), path: None, text, vehicle });
        self.example = Some(example);
        let id = self.put_log(format!("example_{name}.csv"), path);
        self.look_at(id)?;
        Ok(json!({ "log": id }))
    }

    /// Chooses a built-in vehicle.
    ///
    /// # Errors
    /// Where there is none of that name. Files are uploaded, not named.
    pub fn choose_vehicle(&mut self, name: &str) -> Answer {
        if !BUILTIN.contains(&name) {
            let known = BUILTIN.join(", ");
            return Err(Refusal::bad(format!(
                "expected one of {known}, or a vehicle file that is dropped on the page, got `{name}`"
            )));
        }
        self.vehicle = Some(filed(name)?);
        self.look_again();
        Ok(Value::Null)
    }

    /// Chooses a scene of the program, or none.
    ///
    /// # Errors
    /// Where there is none of that name.
    pub fn choose_scene(&mut self, name: Option<&str>) -> Answer {
        let Some(name) = name else {
            self.scene = None;
            return Ok(Value::Null);
        };
        if !SCENES.contains(&name) {
            let known = SCENES.join(", ");
            return Err(Refusal::bad(format!(
                "expected one of {known}, or a scene file that is dropped on the page, got `{name}`"
            )));
        }
        self.scene = Some((name.to_string(), name.into()));
        Ok(Value::Null)
    }

    /// The shapes of the scene for the page; null without one.
    ///
    /// # Errors
    /// Those of scenes.
    pub fn scene(&self) -> Answer {
        let Some((_, path)) = &self.scene else { return Ok(Value::Null) };
        Ok(view::scene_shapes(&SceneSource::file(path))?)
    }

    /// Takes a log away.
    ///
    /// # Errors
    /// Where it is not there.
    pub fn remove(&mut self, id: usize) -> Answer {
        self.log(id)?;
        self.engine = None;
        self.logs.retain(|l| l.id != id);
        Ok(Value::Null)
    }

    /// Reads and checks what was not looked at yet.
    pub fn look(&mut self) {
        let ids: Vec<usize> =
            self.logs.iter().filter(|l| matches!(l.state, Checked::NotYet)).map(|l| l.id).collect();
        for id in ids {
            // Its faults are kept as its state.
            let _ = self.look_at(id);
        }
    }

    /// Looks at all logs again: with another vehicle or mapping they may be usable.
    fn look_again(&mut self) {
        self.engine = None;
        self.logs.iter_mut().for_each(|l| l.state = Checked::NotYet);
        self.look();
    }

    fn look_at(&mut self, id: usize) -> std::result::Result<(), Refusal> {
        let vehicle = self.vehicle.take();
        let log = self.log(id);
        let done = log.map(|log| log.look(vehicle.as_ref().map(|v| &v.vehicle)));
        self.vehicle = vehicle;
        done
    }

    /// The columns of a log's file and what their names suggest.
    ///
    /// # Errors
    /// Where the file is no table.
    pub fn columns(&mut self, id: usize) -> Answer {
        let log = self.log(id)?;
        let seen = peek::peek(&log.path)?;
        let choice = Choice::suggested(&seen);
        Ok(json!({ "name": log.name, "seen": seen, "contract": peek::contract(8), "choice": choice }))
    }

    /// What the checker says of a log that is read with a mapping; with `keep` it is read so from now on.
    ///
    /// # Errors
    /// In words, where the mapping contradicts itself or the log cannot be read with it.
    pub fn map(&mut self, id: usize, choice: &Choice, keep: bool) -> Answer {
        let text = choice.toml().map_err(Refusal::bad)?;
        let folder = self.folder().to_path_buf();
        if keep {
            self.engine = None;
        }
        let vehicle = self.vehicle.take();
        let answer = self.log(id).and_then(|log| {
            let name = Path::new(&log.name).with_extension("toml");
            let mapping = Mapping::parse(&text, &name)?;
            let read = FlightLog::load_with(&log.path, Some(&mapping))?;
            let report = check(&read);
            let sane = sanity::look(&read, vehicle.as_ref().map(|v| &v.vehicle));
            let answer = json!({ "report": report, "sane": sane, "text": text, "name": name });
            if keep {
                let path = folder.join(format!("mapping_{id}.toml"));
                std::fs::write(&path, &text).map_err(|source| Error::Io { path: path.clone(), source })?;
                log.mapping = Some(path);
                log.state = Checked::Read { report: Box::new(report), sane };
            }
            Ok(answer)
        });
        self.vehicle = vehicle;
        answer
    }

    /// Why no flight can be shown yet, if so.
    pub fn waits_for(&self) -> Option<&'static str> {
        let usable = |l: &&Log| l.usable();
        match (self.logs.iter().find(usable), &self.vehicle) {
            (None, _) if self.logs.is_empty() => Some("drop a flight log, or try an example"),
            (None, _) => {
                Some("none of the logs can be used: see what is wrong with them, or name their columns")
            }
            (_, None) => Some("choose the vehicle that flew"),
            (Some(_), Some(_)) if !self.logs.iter().any(|l| l.usable() && l.used == Use::Fit) => {
                Some("use at least one log for the fit")
            }
            _ => None,
        }
    }

    /// All that the first screens show.
    pub fn state(&self) -> Value {
        let logs: Vec<Value> = self.logs.iter().map(Log::state).collect();
        let vehicle = self.vehicle.as_ref().map(|v| {
            let drone = v.vehicle.drone("first_principles").ok();
            json!({
                "label": v.label,
                "builtin": v.path.is_none(),
                "mass_kg": drone.as_ref().map(|d| d.body.mass_kg),
                "rotors": drone.as_ref().map(|d| d.airframe.n_rotors),
                "warnings": v.vehicle.warnings(),
            })
        });
        json!({
            "logs": logs,
            "vehicle": vehicle,
            "scene": self.scene.as_ref().map(|(name, _)| name),
            "example": self.example.map(|e| json!({ "name": e.name, "title": e.title })),
            "waits_for": self.waits_for(),
            "engine": self.engine.as_ref().map(Engine::state),
        })
    }

    /// One line about it for the start page.
    pub fn about(&self) -> String {
        let names: Vec<&str> = self.logs.iter().map(|l| l.name.as_str()).collect();
        match (&self.vehicle, names.as_slice()) {
            (None, []) => "empty".into(),
            (Some(v), []) => v.label.clone(),
            (None, names) => names.join(", "),
            (Some(v), names) => format!("{} × {}", v.label, names.join(", ")),
        }
    }
}

/// A vehicle by its built-in name, or from a file.
fn filed(name: &str) -> Result<Filed> {
    if BUILTIN.contains(&name) {
        let vehicle = Vehicle::builtin(name)?;
        return Ok(Filed { label: name.into(), path: None, text: vehicle.to_toml().to_string(), vehicle });
    }
    let path = PathBuf::from(name);
    let vehicle = crate::arena::VehicleSource::Named(name.into()).load()?;
    let text = files::read_text(&path).map_err(|source| Error::Io { path: path.clone(), source })?;
    Ok(Filed { label: name.into(), path: Some(path), text, vehicle })
}

impl Log {
    /// Whether it can be compared with a model.
    pub fn usable(&self) -> bool {
        matches!(&self.state, Checked::Read { report, .. } if report.verdict < Severity::Refuse)
    }

    fn look(&mut self, vehicle: Option<&Vehicle>) {
        self.state = match FlightLog::load(&self.path, self.mapping.as_deref()) {
            Ok(log) => {
                let sane = sanity::look(&log, vehicle);
                Checked::Read { report: Box::new(check(&log)), sane }
            }
            Err(e) => {
                let mappable = peek::peek(&self.path).is_ok();
                // Where it lies is our affair.
                let words = e.to_string().replace(&self.path.display().to_string(), &self.name);
                Checked::Fault { words, mappable }
            }
        };
    }

    fn state(&self) -> Value {
        let mut out = json!({
            "id": self.id,
            "name": self.name,
            "used": self.used,
            "usable": self.usable(),
            "mapped": self.mapping.is_some(),
        });
        let more = match &self.state {
            Checked::NotYet => json!({ "verdict": "not yet" }),
            Checked::Fault { words, mappable } => {
                json!({ "verdict": "fault", "words": words, "mappable": mappable })
            }
            Checked::Read { report, sane } => json!({
                "verdict": report.verdict,
                "duration_s": report.duration_s,
                "channels": report.channels,
                "findings": report.findings,
                "excluded": report.unusable.excluded,
                "sane": sane,
                "mappable": true,
            }),
        };
        if let (Value::Object(out), Value::Object(more)) = (&mut out, more) {
            out.extend(more);
        }
        out
    }
}
