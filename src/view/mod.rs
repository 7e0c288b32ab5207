//! Pages that show a scene, a data set or a flight log in three dimensions: one HTML file that needs no other and no network.
//!
//! ```no_run
//! use propwash::view::{self, Options};
//!
//! let page = view::page("data/forest".as_ref(), &Options::default())?;
//! std::fs::write("view.html", page.html)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::dataset::Dataset;
use crate::flight::is_bag;
use crate::page::{Array, Page, Part, escape};
use crate::scene::{SCENES, Scene, SceneSource};
use crate::vehicle::Vehicle;
use crate::{Error, Result};

mod flight_log;
mod flown;
mod mesh;
mod probe;
mod shapes;
mod worlds;

pub use flown::{Drone, Marks, Track, World};
pub(crate) use probe::Probe;
pub use shapes::MAX_TRIANGLES;

/// Bytes that a page may have: what does not fit is thinned, and the page says so.
pub const MAX_PAGE_BYTES: usize = 1_500_000;

/// What a page shows beside what it is made of.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Worlds of a data set; empty for as many of the first ones as fit.
    pub worlds: Vec<usize>,
    /// Scene that a flight log was flown in: a file or the name of a scene that comes with the program.
    pub scene: Option<PathBuf>,
    /// Vehicle of a flight log: a file or the name of one that is built in. The page then shows it as ghosts beside the measured one.
    pub vehicle: Option<String>,
}

/// A page, and what is to be known of it.
#[derive(Clone, Debug)]
pub struct Made {
    /// The page.
    pub html: String,
    /// What was left out, thinned or replaced; the page says it too.
    pub notes: Vec<String>,
}

/// What the script of the page reads.
#[derive(Serialize, Default)]
struct Data {
    title: String,
    /// `scene`, `data set`, `flight log` or `simulation`.
    kind: &'static str,
    notes: Vec<String>,
    scene: Option<shapes::Shapes>,
    drones: Vec<Drone>,
    worlds: Vec<World>,
    camera: Option<worlds::Camera>,
    obstacles: Vec<String>,
    /// What colours paths: `clearance`, or `speed` where there is none.
    colour: &'static str,
    /// What can be tried in a watched scene.
    #[serde(skip_serializing_if = "Option::is_none")]
    probe: Option<probe::Choices>,
}

/// The page of a data set (its folder), a scene (a file or the name of one that comes with the program) or a flight log (.csv, .parquet,
/// .ulg, .mcap, or the folder of a ROS 2 bag).
///
/// # Errors
/// [`Error::Usage`] where `what` is none of them, and the errors of reading it.
pub fn page(what: &Path, options: &Options) -> Result<Made> {
    match kind(what)? {
        Kind::Dataset => of_dataset(what, options),
        Kind::Scene => {
            refuse("--world", options.worlds.is_empty())?;
            refuse("--scene", options.scene.is_none())?;
            refuse("--vehicle", options.vehicle.is_none())?;
            of_scene(&SceneSource::file(what), &title(what))
        }
        Kind::Log => {
            refuse("--world", options.worlds.is_empty())?;
            flight_log::page(what, options)
        }
    }
}

/// The last part of a path: a page is handed on, and the folders of who made it are nobody's business.
pub(crate) fn title(path: &Path) -> String {
    let last = |p: &Path| p.file_name().map(|name| name.to_string_lossy().into_owned());
    let whole = || last(&path.canonicalize().ok()?);
    last(path).or_else(whole).unwrap_or_else(|| path.display().to_string())
}

/// Refuses what is no scene.
pub(crate) fn check_scene(what: &Path) -> Result<()> {
    match kind(what)? {
        Kind::Scene => Ok(()),
        _ => Err(Error::Usage {
            flag: "--watch",
            expected: "a scene (.xml), which people change while they look at it".into(),
            got: what.display().to_string(),
        }),
    }
}

/// What a path names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Dataset,
    Scene,
    Log,
}

fn kind(what: &Path) -> Result<Kind> {
    let ending = what.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
    let named = what.to_str().is_some_and(|name| SCENES.contains(&name));
    match ending.as_deref() {
        _ if what.is_dir() && is_bag(what) => Ok(Kind::Log),
        _ if what.is_dir() => Ok(Kind::Dataset),
        Some("xml" | "urdf" | "mjcf") => Ok(Kind::Scene),
        Some("csv" | "txt" | "parquet" | "ulg" | "ulog" | "mcap" | "db3") => Ok(Kind::Log),
        None if named => Ok(Kind::Scene),
        _ => Err(Error::Usage {
            flag: "WHAT",
            expected: format!(
                "the folder of a data set, a scene (.xml, or one of {}), or a flight log (.csv, .parquet, .ulg, .mcap, or the folder of a ROS 2 bag)",
                SCENES.join(", ")
            ),
            got: format!("{}{}", what.display(), crate::flight::files::suggestion(what)),
        }),
    }
}

/// Refuses an option that this kind of page has no use for.
fn refuse(flag: &'static str, absent: bool) -> Result<()> {
    if absent {
        return Ok(());
    }
    let (expected, got) = match flag {
        "--world" => ("a data set, which has worlds", "something without worlds"),
        "--scene" => ("a flight log; data sets and scenes have their own", "one of these"),
        _ => ("a flight log, which a model can fly again", "something else"),
    };
    Err(Error::Usage { flag, expected: expected.into(), got: got.into() })
}

/// The shapes of a scene as pages draw them, with what was left out, for a page that asks for them.
///
/// # Errors
/// Those of scenes.
#[cfg(feature = "lab")]
pub(crate) fn scene_shapes(source: &SceneSource) -> Result<serde_json::Value> {
    let scene = Scene::build(source, &[])?;
    let mut notes = Vec::new();
    let shapes = shapes::shapes(&scene, &mut notes)?;
    Ok(serde_json::json!({ "scene": shapes, "notes": notes }))
}

/// The page of a scene without drones.
pub fn of_scene(source: &SceneSource, title: &str) -> Result<Made> {
    Ok(finished(scene_data(source, title)?))
}

fn scene_data(source: &SceneSource, title: &str) -> Result<Data> {
    let scene = Scene::build(source, &[])?;
    let mut data = Data { title: title.into(), kind: "scene", ..Data::default() };
    data.obstacles = scene.obstacles().iter().map(|o| o.name.clone()).collect();
    data.scene = Some(shapes::shapes(&scene, &mut data.notes)?);
    data.notes.extend(scene.warnings().iter().cloned());
    Ok(data)
}

/// The page of a scene that a server of this machine gives out: it asks for `/version` and loads itself again when that changes, and
/// for `/depth` and `/path` where a camera or a path is tried.
pub(crate) fn watched(source: &SceneSource, title: &str) -> Result<Made> {
    Ok(made(Data { probe: Some(probe::Choices::all()), ..scene_data(source, title)? }, true))
}

/// What [`watched`] gave last, or an empty page, under what is wrong with the scene now.
pub(crate) fn with_fault(last: Option<&str>, title: &str, fault: &str) -> String {
    let empty = || made(Data { title: title.into(), kind: "scene", ..Data::default() }, true).html;
    let page = last.map_or_else(empty, String::from);
    let words = format!("<main id=\"view\"><p id=\"fault\" role=\"alert\">{}</p>", escape(fault));
    page.replacen("<main id=\"view\">", &words, 1)
}

/// The page of a data set.
fn of_dataset(dir: &Path, options: &Options) -> Result<Made> {
    refuse("--scene", options.scene.is_none())?;
    refuse("--vehicle", options.vehicle.is_none())?;
    let set = Dataset::open(dir)?;
    let mut data = Data { title: title(dir), kind: "data set", ..Data::default() };
    let scene = set.scene()?;
    match &scene {
        Some(scene) => data.scene = Some(shapes::shapes(scene, &mut data.notes)?),
        None if set.manifest().scene.name == "none" => {}
        None => data.notes.push(
            "this data set has no scene.mjb, as older versions wrote it: the scene is not shown".into(),
        ),
    }
    data.drones = worlds::drones(&set, &mut data.notes);
    data.obstacles = set.manifest().obstacles.clone();
    data.camera = worlds::camera(&set);
    let room = MAX_PAGE_BYTES.saturating_sub(finished(Data { ..data.copied() }).html.len());
    worlds::add(&set, options, room, &mut data)?;
    Ok(finished(data))
}

impl Data {
    /// All but the worlds, to see how large a page without them is.
    fn copied(&self) -> Self {
        Self {
            title: self.title.clone(),
            kind: self.kind,
            notes: self.notes.clone(),
            scene: self.scene.clone(),
            drones: self.drones.clone(),
            camera: self.camera.clone(),
            obstacles: self.obstacles.clone(),
            colour: self.colour,
            worlds: Vec::new(),
            probe: None,
        }
    }
}

/// A simulation as it is now: its scene, and where drones and obstacles are.
#[derive(Clone, Debug, Default)]
pub struct Snapshot<'a> {
    /// The scene; none for a simulation without.
    pub scene: Option<&'a Scene>,
    /// The vehicles, (drone).
    pub vehicles: Vec<&'a Vehicle>,
    /// The time, s.
    pub time_s: f64,
    /// Worlds: number, positions (m) and attitudes (x y z w) of the drones, then those of the obstacles.
    pub worlds: Vec<Moment>,
}

/// Poses in one world: position, m, and attitude x y z w, body to world.
#[derive(Clone, Debug, Default)]
pub struct Moment {
    /// Number of the world.
    pub world: usize,
    /// Of the drones.
    pub drones: Vec<([f64; 3], [f64; 4])>,
    /// Of the obstacles, in the order of the scene.
    pub obstacles: Vec<([f64; 3], [f64; 4])>,
}

/// The page of a simulation as it is now.
///
/// # Errors
/// Those of the scene.
pub fn of_simulation(now: &Snapshot) -> Result<Made> {
    let mut data = Data { title: "simulation".into(), kind: "simulation", ..Data::default() };
    if let Some(scene) = now.scene {
        data.obstacles = scene.obstacles().iter().map(|o| o.name.clone()).collect();
        data.scene = Some(shapes::shapes(scene, &mut data.notes)?);
    }
    data.drones = now.vehicles.iter().map(|v| flown::drone(v, now.scene.is_some())).collect();
    data.worlds = now.worlds.iter().map(|moment| flown::moment(moment, now.time_s)).collect();
    Ok(finished(data))
}

const STYLE: &str = include_str!("../../assets/page/view.css");
const SCRIPT: &str = include_str!("../../assets/page/view.js");
const IMAGES: &str = include_str!("../../assets/page/images.js");
const PROBE: &str = include_str!("../../assets/page/probe.js");
const WATCH: &str = include_str!("../../assets/page/watch.js");

/// The page of its data.
fn finished(data: Data) -> Made {
    made(data, false)
}

/// The page of its data; a watched one asks its server for news.
fn made(data: Data, watched: bool) -> Made {
    let mut page = Page::new(format!("{} · Propwash", data.title));
    for part in [Part::Three, Part::UPlot, Part::Base, Part::Player, Part::Plots, Part::Scene3D] {
        page.part(part);
    }
    page.style(STYLE).script(IMAGES).script(SCRIPT);
    if watched {
        page.script(PROBE).script(WATCH).may_ask_its_server();
    }
    page.body(&format!(
        "<header><h1>{}</h1><p id=\"about\"></p><div id=\"actions\"></div></header>\n<main id=\"view\"></main>",
        escape(&data.title)
    ));
    page.data("flight", &data);
    Made { html: page.finish(), notes: data.notes }
}

/// Numbers of triples or fours in one row, each component in 16 bits of its own range.
fn columns<const N: usize>(rows: &[[f64; N]]) -> Vec<Array> {
    (0..N).map(|c| Array::i16(&rows.iter().map(|row| row[c]).collect::<Vec<_>>()).packed()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_title_names_no_folders() {
        assert_eq!(title("/somebody/private/forest".as_ref()), "forest");
        assert_eq!(title("private/flight 7.csv".as_ref()), "flight 7.csv");
        let here = title(".".as_ref());
        assert!(!here.is_empty() && !here.contains(['/', '.']), "{here}");
        let scene = of_scene(&SceneSource::file("xml/zoo.xml"), "zoo").unwrap();
        assert!(!scene.html.contains("xml/zoo"), "the scene's name on the page");
    }
}
