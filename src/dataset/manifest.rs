//! The manifest: everything that is the same for all worlds of a data set.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::depth_png;
use super::error::{DatasetError, Result};
use super::recorder::FlightConfig;
use super::table::{Column, clearance_columns, contact_columns, state_columns};
use crate::arena::read_value;
use crate::sense::{Caster, Collider, DepthKind, SensorChannel};

/// Name of the format, `format` in the manifest.
pub const FORMAT: &str = "propwash-dataset";
/// Version of the format, `format_version` in the manifest.
pub const FORMAT_VERSION: u32 = 1;

/// What a data set was made from and what its files hold. `docs/formats.md` describes every field.
///
/// Two runs with equal manifests give the same bytes; a data set is continued only under an equal manifest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Version of libmujoco, e.g. `3.17.0`.
    pub mujoco_version: String,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Worlds, numbered from 0.
    pub n_worlds: usize,
    /// Drones per world, numbered from 0.
    pub n_drones: usize,
    /// Flight time per world, s.
    pub seconds: f64,
    /// Frames per second; 0 when there are no cameras.
    pub fps: f64,
    /// The scene.
    pub scene: SceneRecord,
    /// The vehicle of each drone, shape `(drone,)`.
    pub vehicles: Vec<VehicleRecord>,
    /// How they fly.
    pub flight: FlightRecord,
    /// The whole description of the flight, a [`FlightConfig`], from which it can be flown again; none in data sets of versions that did
    /// not keep it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub config: Option<Value>,
    /// The camera of each drone, shape `(drone,)`, all of one size; empty for a data set without images.
    pub cameras: Vec<CameraRecord>,
    /// Further sensors of every drone; none in data sets of versions that did not have them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sensors: Vec<SensorRecord>,
    /// Scale of the 16-bit depth images.
    pub depth_png: DepthPng,
    /// Surface normals in `frames.npz`.
    pub normals: bool,
    /// Noise model and its parameters; when present every frame has a noisy depth beside the exact one.
    pub noise: Option<Value>,
    /// Geoms of the compiled scene, which `geom_id` and the tables refer to.
    pub geoms: Vec<GeomRecord>,
    /// Bodies of the compiled scene, which `body_id` and the tables refer to.
    pub bodies: Vec<BodyRecord>,
    /// Names of the movable obstacles of the scene, whose places are in `frames.npz`; none in data sets of versions that did not keep them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub obstacles: Vec<String>,
}

/// The scene of a data set.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneRecord {
    /// Name or path as it was given.
    pub name: String,
    /// Hash of the compiled scene, hexadecimal.
    pub sha256: String,
    /// Hash of `scene.mjb`, the compiled scene with its drones as MuJoCo loads it; none in data sets without it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mjb_sha256: Option<String>,
}

/// One drone's vehicle.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VehicleRecord {
    /// Name, e.g. `cf2x_L250`.
    pub name: String,
    /// Dynamics, e.g. `first_principles`.
    pub dynamics: String,
    /// Name of the shell that it wears in the scene.
    pub shell: String,
    /// Hash of the vehicle file, hexadecimal.
    pub sha256: String,
    /// Rotors.
    pub n_rotors: usize,
    /// Rates of the on-board control stages by name, Hz.
    pub rates_hz: BTreeMap<String, u32>,
}

/// How the drones of a data set fly and what is recorded of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FlightRecord {
    /// `state`, `attitude`, `body_rate`, `force_torque` or `rotor_vel`; fixes the command columns of the states.
    pub control_mode: String,
    /// Integrator, e.g. `rk4`.
    pub integrator: String,
    /// Simulation steps per second.
    pub sim_hz: u32,
    /// A row of `states.parquet` every so many steps.
    pub state_every_steps: u32,
    /// A row of `clearance.parquet` every so many steps; 0 when clearance is not measured.
    pub clearance_every_steps: u32,
    /// Largest clearance that is looked for, m; beyond it `distance` is empty.
    pub clearance_max_m: f64,
    /// Contacts are looked for every so many steps; 0 when they are not.
    pub contact_every_steps: u32,
    /// The path between two steps is checked too, so that thin walls are not tunnelled through.
    pub swept: bool,
    /// Who found contacts and clearances; none in data sets of versions that did not say it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub collider: Option<Collider>,
    /// Trajectory and its parameters.
    pub trajectory: Value,
}

/// One drone's camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraRecord {
    /// Name, e.g. `fpv`.
    pub name: String,
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// What a depth value measures.
    pub kind: DepthKind,
    /// Hits nearer than this have the status too near, m.
    pub near_m: f64,
    /// Hits farther than this have the status too far, m.
    pub far_m: f64,
    /// Who cast its rays; none in data sets of versions that did not say it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub caster: Option<Caster>,
    /// Pin-hole matrix K, pixels: `[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]`; x right, y down, pixel centres at n + 0.5.
    pub k: [[f64; 3]; 3],
}

/// One sensor of every drone, whose samples lie in `sensor_NAME.npz` of each world.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorRecord {
    /// Name, letters, digits and underscores.
    pub name: String,
    /// Samples per second.
    pub sample_hz: u32,
    /// What it gives: arrays of its file, beside `time_s` (s) and `step`, with the axes sample, drone and those of the channel.
    pub channels: Vec<SensorChannel>,
}

impl SensorRecord {
    /// Name of its file in the folder of a world.
    pub fn file(&self) -> String {
        format!("sensor_{}.npz", self.name)
    }
}

/// Scale and codes of the 16-bit depth images.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DepthPng {
    /// Metres of one unit.
    pub metres_per_unit: f64,
    /// Value of a ray that hits nothing.
    pub miss: u16,
    /// Value of a hit beyond the camera's range.
    pub too_far: u16,
    /// Value of a hit before the camera's range.
    pub too_near: u16,
    /// Largest value that is a distance.
    pub max_distance: u16,
}

impl DepthPng {
    /// Images with units of `metres_per_unit` metres and the codes of format version 1.
    pub fn new(metres_per_unit: f64) -> Self {
        Self {
            metres_per_unit,
            miss: depth_png::MISS,
            too_far: depth_png::TOO_FAR,
            too_near: depth_png::TOO_NEAR,
            max_distance: depth_png::MAX_DISTANCE,
        }
    }
}

impl Default for DepthPng {
    /// Millimetres.
    fn default() -> Self {
        Self::new(0.001)
    }
}

/// One geom of the scene.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GeomRecord {
    /// Number in `geom_id`, `geom`, `geom1`, `geom2`.
    pub id: i32,
    /// Name in the scene, empty where it has none.
    pub name: String,
    /// `plane`, `sphere`, `capsule`, `ellipsoid`, `cylinder`, `box`, `mesh`, `hfield` or `sdf`.
    #[serde(rename = "type")]
    pub kind: String,
    /// Body that it belongs to.
    pub body: i32,
}

/// One body of the scene.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BodyRecord {
    /// Number in `body_id`, `body`, `body1`, `body2`.
    pub id: i32,
    /// Name in the scene, empty where it has none.
    pub name: String,
    /// Drone whose shell it is part of, or −1.
    pub drone: i32,
}

/// Array in `frames.npz`, as described in the manifest file.
#[derive(Serialize)]
struct ArrayRecord {
    name: &'static str,
    dtype: &'static str,
    shape: &'static str,
    unit: &'static str,
}

/// The manifest as it lies in the file: a head, the caller's part, and what follows from it.
#[derive(Serialize)]
struct OnDisk<'a> {
    format: &'static str,
    format_version: u32,
    propwash_version: &'static str,
    #[serde(flatten)]
    manifest: &'a Manifest,
    conventions: BTreeMap<&'static str, &'static str>,
    pixel_status: BTreeMap<&'static str, u8>,
    tables: BTreeMap<&'static str, Vec<Column>>,
    frames: Vec<ArrayRecord>,
}

/// Keys of [`OnDisk`] that are not in [`Manifest`].
const DERIVED: [&str; 7] =
    ["format", "format_version", "propwash_version", "conventions", "pixel_status", "tables", "frames"];

impl Manifest {
    /// Most rotors of any vehicle.
    pub fn n_rotors(&self) -> usize {
        self.vehicles.iter().map(|v| v.n_rotors).max().unwrap_or(0)
    }

    /// Numbers in a command of drone `drone`.
    pub(super) fn command_width(&self, drone: usize) -> usize {
        match self.flight.control_mode.as_str() {
            "state" => 16,
            "rotor_vel" => self.vehicles[drone].n_rotors,
            _ => 4,
        }
    }

    /// Errors on a manifest that no data set can keep: counts of zero, numbers that are not finite, a camera range that
    /// 16 bits cannot hold.
    pub fn check(&self) -> Result<()> {
        let bad = |field: &str, expected: &str, found: String, remedy: &'static str| {
            Err(DatasetError::Manifest { field: field.into(), expected: expected.into(), found, remedy })
        };
        if self.n_worlds == 0 || self.n_worlds > 10_000_000 {
            return bad("n_worlds", "1 to 10000000", self.n_worlds.to_string(), "ask for at least one world");
        }
        if self.n_drones == 0 || self.n_drones > 100_000 {
            return bad("n_drones", "1 to 100000", self.n_drones.to_string(), "ask for at least one drone");
        }
        if self.vehicles.len() != self.n_drones {
            let found = format!("{} vehicles", self.vehicles.len());
            return bad(
                "vehicles",
                &format!("{} (one per drone)", self.n_drones),
                found,
                "list one per drone",
            );
        }
        if !(self.seconds.is_finite() && self.seconds > 0.0) {
            return bad(
                "seconds",
                "a finite time above 0 s",
                self.seconds.to_string(),
                "ask for a longer flight",
            );
        }
        let modes = ["state", "attitude", "body_rate", "force_torque", "rotor_vel"];
        if !modes.contains(&self.flight.control_mode.as_str()) {
            let found = format!("\"{}\"", self.flight.control_mode);
            return bad("flight.control_mode", &modes.join(", "), found, "use one of these");
        }
        if self.flight.sim_hz == 0 || self.flight.state_every_steps == 0 {
            let found = format!("{} Hz, every {} steps", self.flight.sim_hz, self.flight.state_every_steps);
            return bad("flight.sim_hz, flight.state_every_steps", "both above 0", found, "set both");
        }
        if !(self.flight.clearance_max_m.is_finite() && self.flight.clearance_max_m >= 0.0) {
            let found = self.flight.clearance_max_m.to_string();
            return bad("flight.clearance_max_m", "a finite distance, m", found, "set a limit");
        }
        if let Some(config) = &self.config {
            // Fields that later versions have added are filled in by the first reading.
            let read = |config: &Value| read_value::<FlightConfig>(config.clone());
            let again = read(config).and_then(|c| Ok((read(&serde_json::json!(c))?, c)));
            if !again.as_ref().is_ok_and(|(again, once)| again == once) {
                let found = again.map_or_else(|e| e.to_string(), |_| "one that reads back otherwise".into());
                let remedy = "use finite numbers, and the version that made the data set";
                return bad("config", "the description of a flight", found, remedy);
            }
        }
        self.check_cameras()?;
        self.check_sensors()?;
        for (i, geom) in self.geoms.iter().enumerate() {
            if geom.id != i as i32 {
                return bad(
                    &format!("geoms[{i}].id"),
                    &i.to_string(),
                    geom.id.to_string(),
                    "list all in order",
                );
            }
        }
        for (i, body) in self.bodies.iter().enumerate() {
            if body.id != i as i32 {
                return bad(
                    &format!("bodies[{i}].id"),
                    &i.to_string(),
                    body.id.to_string(),
                    "list all in order",
                );
            }
        }
        Ok(())
    }

    fn check_sensors(&self) -> Result<()> {
        let plain =
            |name: &str| !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
        for (i, sensor) in self.sensors.iter().enumerate() {
            let bad = |part: &str, expected: &str, found: String, remedy| {
                let field = format!("sensors[{i}].{part}");
                Err(DatasetError::Manifest { field, expected: expected.into(), found, remedy })
            };
            let twice = self.sensors[..i].iter().any(|s| s.name == sensor.name);
            if twice || !plain(&sensor.name) {
                let expected = "letters, digits and underscores, and no name twice";
                return bad("name", expected, format!("{:?}", sensor.name), "rename the sensor");
            }
            if sensor.sample_hz == 0 || sensor.sample_hz > self.flight.sim_hz {
                let expected = format!("1 to {} Hz", self.flight.sim_hz);
                return bad("sample_hz", &expected, sensor.sample_hz.to_string(), "change the rate");
            }
            for (k, channel) in sensor.channels.iter().enumerate() {
                let twice = sensor.channels[..k].iter().any(|c| c.name == channel.name);
                let taken = matches!(&*channel.name, "time_s" | "step");
                if twice || taken || channel.is_empty() || !plain(&channel.name) {
                    let expected = "channels with numbers, each with a plain name of its own";
                    return bad("channels", expected, format!("{channel:?}"), "rename the channel");
                }
            }
        }
        Ok(())
    }

    fn check_cameras(&self) -> Result<()> {
        let bad = |field: String, expected: String, found: String, remedy: &'static str| {
            Err(DatasetError::Manifest { field, expected, found, remedy })
        };
        if self.cameras.is_empty() {
            if self.fps != 0.0 || self.normals || self.noise.is_some() {
                let found = format!("fps {}, normals {}, noise {:?}", self.fps, self.normals, self.noise);
                return bad(
                    "cameras".into(),
                    "a camera where frames are asked for".into(),
                    found,
                    "name one per drone, or set fps to 0",
                );
            }
            return Ok(());
        }
        if self.cameras.len() != self.n_drones {
            let found = self.cameras.len().to_string();
            return bad("cameras".into(), format!("{} or none", self.n_drones), found, "name one per drone");
        }
        if !(self.fps.is_finite() && self.fps > 0.0) {
            return bad(
                "fps".into(),
                "a finite rate above 0".into(),
                self.fps.to_string(),
                "set the frame rate",
            );
        }
        let codes = DepthPng::new(self.depth_png.metres_per_unit);
        if self.depth_png != codes {
            let found = format!("{:?}", self.depth_png);
            return bad("depth_png".into(), format!("{codes:?}"), found, "make it with DepthPng::new");
        }
        let unit = self.depth_png.metres_per_unit;
        if !(unit.is_finite() && unit > 0.0) {
            let field = "depth_png.metres_per_unit".into();
            return bad(
                field,
                "a finite number above 0".into(),
                unit.to_string(),
                "use e.g. 0.001 for millimetres",
            );
        }
        (0..self.cameras.len()).try_for_each(|i| self.check_camera(i))
    }

    /// Refuses a camera that is not of the size of all, or whose range 16 bits cannot hold.
    fn check_camera(&self, i: usize) -> Result<()> {
        let bad = |field: String, expected: String, found: String, remedy: &'static str| {
            Err(DatasetError::Manifest { field, expected, found, remedy })
        };
        let (c, unit) = (&self.cameras[i], self.depth_png.metres_per_unit);
        let size = (self.cameras[0].width, self.cameras[0].height);
        if (c.width, c.height) != size
            || c.width == 0
            || c.height == 0
            || c.width > 65_535
            || c.height > 65_535
        {
            return bad(
                format!("cameras[{i}].width, height"),
                "1 to 65535, the same for all drones".into(),
                format!("{}x{}, first camera {}x{}", c.width, c.height, size.0, size.1),
                "give all drones cameras of one size",
            );
        }
        if !c.k.iter().flatten().all(|x| x.is_finite()) {
            let found = format!("{:?}", c.k);
            return bad(format!("cameras[{i}].k"), "finite numbers".into(), found, "check the field of view");
        }
        let (lowest, highest) = (unit, f64::from(depth_png::MAX_DISTANCE) * unit);
        if !(c.near_m >= lowest && c.near_m < c.far_m && c.far_m <= highest) {
            return bad(
                format!("cameras[{i}].near_m, far_m"),
                format!(
                    "{lowest} m <= near < far <= {highest} m, which is what 16 bits hold in units of {unit} m"
                ),
                format!("{} m to {} m", c.near_m, c.far_m),
                "change the camera's range or depth_png.metres_per_unit (the depth scale)",
            );
        }
        Ok(())
    }

    /// The bytes of `manifest.json`.
    pub fn to_json(&self) -> Result<String> {
        self.check()?;
        let mut tables = BTreeMap::from([
            ("states.parquet", state_columns(self)),
            ("contacts.parquet", contact_columns()),
            ("clearance.parquet", clearance_columns()),
        ]);
        if self.flight.clearance_every_steps == 0 {
            tables.remove("clearance.parquet");
        }
        let on_disk = OnDisk {
            format: FORMAT,
            format_version: FORMAT_VERSION,
            propwash_version: env!("CARGO_PKG_VERSION"),
            manifest: self,
            conventions: BTreeMap::from([
                ("units", "SI; time in seconds from the start of the flight"),
                ("quaternions", "x, y, z, w; body (or camera) to world"),
                ("world", "z up"),
                ("body", "x forward, y left, z up"),
                (
                    "camera",
                    "looks along -z, x right, y up; pixel (0, 0) top left, rays through pixel centres",
                ),
            ]),
            pixel_status: BTreeMap::from([("hit", 0), ("miss", 1), ("too_far", 2), ("too_near", 3)]),
            tables,
            frames: self.frame_arrays(),
        };
        let value = serde_json::to_value(&on_disk).map_err(|e| DatasetError::Manifest {
            field: "(all)".into(),
            expected: "values that JSON can hold".into(),
            found: e.to_string(),
            remedy: "use finite numbers and text",
        })?;
        if let Some(field) = first_null(&value, "") {
            // JSON has no NaN and no infinity; serde writes them as null.
            return Err(DatasetError::Manifest {
                field,
                expected: "a finite number".into(),
                found: "NaN, infinity or null".into(),
                remedy: "set a finite value",
            });
        }
        let mut text = serde_json::to_string_pretty(&on_disk).unwrap_or_default();
        text.push('\n');
        Ok(text)
    }

    /// Arrays of `frames.npz`.
    fn frame_arrays(&self) -> Vec<ArrayRecord> {
        let array = |name, dtype, shape, unit| ArrayRecord { name, dtype, shape, unit };
        let mut frames = Vec::new();
        if !self.cameras.is_empty() {
            frames.extend([
                array("time_s", "float64", "(frame,)", "s"),
                array("step", "int64", "(frame,)", ""),
                array("camera_pos_m", "float64", "(frame, drone, 3)", "m, world"),
                array("camera_quat_xyzw", "float64", "(frame, drone, 4)", "camera to world"),
                array("depth_m", "float32", "(frame, drone, row, column)", "m"),
                array("status", "uint8", "(frame, drone, row, column)", "see pixel_status"),
                array("geom_id", "int32", "(frame, drone, row, column)", "see geoms, -1 none"),
                array("body_id", "int32", "(frame, drone, row, column)", "see bodies, -1 none"),
            ]);
            if self.normals {
                frames.push(array(
                    "normal",
                    "float32",
                    "(frame, drone, row, column, 3)",
                    "world, unit length",
                ));
            }
            if self.noise.is_some() {
                frames.push(array("depth_noisy_m", "float32", "(frame, drone, row, column)", "m"));
                frames.push(array(
                    "status_noisy",
                    "uint8",
                    "(frame, drone, row, column)",
                    "see pixel_status",
                ));
            }
            if !self.obstacles.is_empty() {
                frames.push(array(
                    "obstacle_pos_m",
                    "float64",
                    "(frame, obstacle, 3)",
                    "m, world; see obstacles",
                ));
                frames.push(array(
                    "obstacle_quat_xyzw",
                    "float64",
                    "(frame, obstacle, 4)",
                    "obstacle to world",
                ));
            }
        }
        frames
    }

    /// Reads the text of a `manifest.json`.
    pub(super) fn from_json(path: &Path, text: &str) -> Result<Self> {
        let foreign = |found: String| DatasetError::ForeignFormat { path: path.to_path_buf(), found };
        let value: Value = serde_json::from_str(text)
            .map_err(|e| DatasetError::damaged(path, "JSON", format!("text that is no JSON ({e})")))?;
        let Value::Object(mut map) = value else {
            return Err(foreign("JSON that is no object".into()));
        };
        let format = map.get("format").and_then(Value::as_str).map(str::to_owned);
        let version = map.get("format_version").and_then(Value::as_u64);
        if format.as_deref() != Some(FORMAT) || version != Some(u64::from(FORMAT_VERSION)) {
            let shown = |v: Option<&Value>| v.map_or("none".to_owned(), Value::to_string);
            return Err(foreign(format!(
                "format {}, version {}",
                shown(map.get("format")),
                shown(map.get("format_version"))
            )));
        }
        for key in DERIVED {
            map.remove(key);
        }
        let manifest: Self = serde_json::from_value(Value::Object(map))
            .map_err(|e| DatasetError::damaged(path, "the fields of docs/formats.md", e))?;
        manifest.check()?;
        Ok(manifest)
    }
}

/// The description of the flight in a manifest.
///
/// # Errors
/// [`DatasetError::Manifest`] for a manifest that holds none, or one that cannot be read.
pub(super) fn config_of(manifest: &Value) -> Result<FlightConfig> {
    let bad = |expected: &str, found: String, remedy| {
        Err(DatasetError::Manifest { field: "config".into(), expected: expected.into(), found, remedy })
    };
    let format = (&manifest["format"], manifest["format_version"].as_u64());
    if format != (&Value::from(FORMAT), Some(u64::from(FORMAT_VERSION))) {
        let expected = format!("the manifest of a {FORMAT} of version {FORMAT_VERSION}");
        return bad(&expected, format!("format {}, version {:?}", format.0, format.1), "check the file");
    }
    let Some(config) = manifest.get("config") else {
        let found = format!("nothing: version {} of Propwash did not keep it", manifest["propwash_version"]);
        return bad("the whole description of the flight", found, "describe the simulation yourself");
    };
    let remedy = "use the version that made the data set";
    let config: FlightConfig = match read_value(config.clone()) {
        Ok(config) => config,
        Err(e) => return bad("fields that this version knows", e.to_string(), remedy),
    };
    // Vehicles that are not built in are in the description; those that are may have changed.
    for (d, record) in manifest["vehicles"].as_array().into_iter().flatten().enumerate() {
        let own = config.sim.drones.get(d % config.sim.drones.len().max(1)).map(|drone| drone.vehicle.load());
        let known = matches!(&own, Some(Ok(vehicle)) if record["sha256"] == vehicle.sha256());
        if !known {
            let expected =
                format!("the vehicle {} as it was, of SHA-256 {}", record["name"], record["sha256"]);
            return bad(&expected, "another one in this version".into(), remedy);
        }
    }
    Ok(config)
}

/// Dotted name of the first `null` in `value`; the top-level `noise` may be null, and options of `config`, which is checked apart.
fn first_null(value: &Value, at: &str) -> Option<String> {
    match value {
        Value::Null => (at != "noise").then(|| at.to_owned()),
        _ if at == "config" => None,
        Value::Array(items) => {
            items.iter().enumerate().find_map(|(i, item)| first_null(item, &format!("{at}[{i}]")))
        }
        Value::Object(map) => map.iter().find_map(|(key, item)| {
            first_null(item, &if at.is_empty() { key.clone() } else { format!("{at}.{key}") })
        }),
        _ => None,
    }
}

/// One line per field that differs between two manifests' texts: `field: have → asked`.
pub(super) fn differences(have: &str, asked: &str) -> String {
    let parse = |text| serde_json::from_str::<Value>(text).unwrap_or(Value::Null);
    let mut lines = Vec::new();
    let (mut have, mut asked) = (parse(have), parse(asked));
    // The description says the same once more: it is looked at where nothing else differs.
    let configs = [&mut have, &mut asked].map(|v| v.as_object_mut().and_then(|m| m.remove("config")));
    compare(&have, &asked, "", &mut lines);
    if let ([Some(have), Some(asked)], true) = (configs, lines.is_empty()) {
        compare(&have, &asked, "config", &mut lines);
    }
    if lines.is_empty() {
        lines.push("  (the text of manifest.json: order of fields or spelling of numbers)".to_owned());
    }
    let shown = 12;
    let more = lines.len().saturating_sub(shown);
    lines.truncate(shown);
    if more > 0 {
        lines.push(format!("  and {more} more"));
    }
    lines.join("\n")
}

fn compare(have: &Value, asked: &Value, at: &str, lines: &mut Vec<String>) {
    match (have, asked) {
        (Value::Object(a), Value::Object(b)) => {
            let keys: std::collections::BTreeSet<&String> = a.keys().chain(b.keys()).collect();
            for key in keys {
                let at = if at.is_empty() { key.clone() } else { format!("{at}.{key}") };
                compare(a.get(key).unwrap_or(&Value::Null), b.get(key).unwrap_or(&Value::Null), &at, lines);
            }
        }
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => {
            for (i, (x, y)) in a.iter().zip(b).enumerate() {
                compare(x, y, &format!("{at}[{i}]"), lines);
            }
        }
        _ if have == asked => {}
        _ => {
            let short = |v: &Value| match v {
                Value::Null => "nothing".to_owned(),
                Value::Array(items) => format!("{} entries", items.len()),
                v => {
                    let text = v.to_string();
                    if text.chars().count() > 80 {
                        format!("{}…", text.chars().take(80).collect::<String>())
                    } else {
                        text
                    }
                }
            };
            lines.push(format!("  {at}: the folder has {}, asked for {}", short(have), short(asked)));
        }
    }
}
