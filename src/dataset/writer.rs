//! Writes a data set: worlds in any order and in parallel, each either whole or absent.

use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Component, Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::depth_png;
use super::error::{DatasetError, Result};
use super::files::{self, FileRecord, PARTIAL};
use super::manifest::{FORMAT, FORMAT_VERSION, Manifest, SensorRecord, differences};
use super::npz::{self, Spool};
use super::table::{TableWriter, clearance_columns, contact_columns, extra_command_names, state_columns};
pub use crate::rollout::trajectory::Reference;
use crate::sense::{ChannelType, SensorChannel};

/// File names inside a data set.
pub(super) const MANIFEST: &str = "manifest.json";
pub(super) const COMPLETE: &str = "complete.json";
pub(super) const SCENE: &str = "scene.mjb";
pub(super) const WORLD: &str = "world.json";
pub(super) const STATES: &str = "states.parquet";
pub(super) const CONTACTS: &str = "contacts.parquet";
pub(super) const CLEARANCE: &str = "clearance.parquet";
pub(super) const FRAMES: &str = "frames.npz";

/// Name of a world's folder: `world_00000`.
pub fn world_dir_name(world: usize) -> String {
    format!("world_{world:05}")
}

/// A row of `states.parquet`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StateRow<'a> {
    /// Seconds since the start.
    pub t_s: f64,
    /// Simulation step.
    pub step: u64,
    /// Drone.
    pub drone: usize,
    /// Position, m, world.
    pub pos_m: [f64; 3],
    /// Attitude, body to world.
    pub quat_xyzw: [f64; 4],
    /// Velocity, m/s, world.
    pub vel_m_s: [f64; 3],
    /// Angular velocity, rad/s, body.
    pub ang_vel_rad_s: [f64; 3],
    /// Accelerometer reading (acceleration less gravity), m/s², body.
    pub specific_force_m_s2: Option<[f64; 3]>,
    /// Rotor speeds, rad/s, one per rotor of the vehicle; empty where the dynamics have none.
    pub rotor_rad_s: &'a [f64],
    /// Collective thrust, N.
    pub thrust_n: Option<f64>,
    /// Command in force, as the control mode defines it: 16, 4 or one number per rotor.
    pub command: &'a [f64],
    /// Roll, pitch, yaw (rad) and thrust (N) that the on-board controller asks for; in mode `attitude`, where it is the
    /// command, it must be `None`.
    pub attitude_command: Option<[f64; 4]>,
    /// Rotor speeds that the on-board controller asks for, rad/s; empty where there are none, and in mode `rotor_vel`,
    /// where they are the command.
    pub rotor_command_rad_s: &'a [f64],
    /// Where the drone should be.
    pub reference: Option<Reference>,
    /// Voltage of the battery under load, V; `None` for a vehicle without one.
    pub battery_v: Option<f64>,
    /// Velocity of the air at the drone, m/s, world.
    pub wind_m_s: Option<[f64; 3]>,
}

/// A row of `contacts.parquet`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactRow {
    /// Seconds since the start.
    pub t_s: f64,
    /// Simulation step.
    pub step: u64,
    /// Drone.
    pub drone: usize,
    /// The other drone, when it is one.
    pub other_drone: Option<usize>,
    /// Geom of the drone and geom that it touches, −1 for a flex.
    pub geoms: [i32; 2],
    /// Their bodies.
    pub bodies: [i32; 2],
    /// Flex that it touches, −1 for a geom.
    pub other_flex: i32,
    /// Signed distance, m, negative inside.
    pub distance_m: f64,
    /// Point of contact, m, world.
    pub point_m: [f64; 3],
    /// Unit normal from what it touches to the drone, world; zero where a swept check starts inside.
    pub normal: [f64; 3],
    /// False where the distance is a lower bound (signed distance fields), so that a swept contact may be early.
    pub exact: bool,
    /// For a contact that the swept check found: how far into the step before `t_s`, 0 to 1.
    pub swept_fraction: Option<f64>,
}

/// The nearest other geom.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nearest {
    /// Signed distance, m, negative inside.
    pub distance_m: f64,
    /// Closest point on the drone, m, world.
    pub from_m: [f64; 3],
    /// Closest point on the other geom, m, world.
    pub to_m: [f64; 3],
    /// Geom of the drone.
    pub drone_geom: i32,
    /// The other geom.
    pub geom: i32,
    /// Its body.
    pub body: i32,
    /// The drone that it belongs to, if it is one.
    pub other_drone: Option<usize>,
    /// False where the distance is a lower bound (signed distance fields).
    pub exact: bool,
}

/// A row of `clearance.parquet`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClearanceRow {
    /// Seconds since the start.
    pub t_s: f64,
    /// Simulation step.
    pub step: u64,
    /// Drone.
    pub drone: usize,
    /// What is nearest; `None` when nothing is within `flight.clearance_max_m`.
    pub nearest: Option<Nearest>,
}

/// Depth with sensor noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoisyDepth<'a> {
    /// Depth, m, shape `(row, column)`.
    pub depth_m: &'a [f32],
    /// Pixel statuses, shape `(row, column)`.
    pub status: &'a [u8],
}

/// What one drone's camera sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View<'a> {
    /// Depth, m, shape `(row, column)`.
    pub depth_m: &'a [f32],
    /// Pixel statuses, shape `(row, column)`.
    pub status: &'a [u8],
    /// Geoms, −1 none, shape `(row, column)`.
    pub geom_id: &'a [i32],
    /// Bodies, −1 none, shape `(row, column)`.
    pub body_id: &'a [i32],
    /// World normals, shape `(row, column)`; present exactly where the manifest says `normals`.
    pub normal: Option<&'a [[f32; 3]]>,
    /// Present exactly where the manifest has a noise model.
    pub noisy: Option<NoisyDepth<'a>>,
    /// Camera position, m, world.
    pub pos_m: [f64; 3],
    /// Camera attitude, camera to world.
    pub quat_xyzw: [f64; 4],
    /// Pin-hole matrix; must be the manifest's.
    pub k: [[f64; 3]; 3],
}

/// One frame of all drones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameInput<'a> {
    /// Seconds since the start.
    pub t_s: f64,
    /// Simulation step.
    pub step: u64,
    /// Shape `(drone,)`.
    pub views: &'a [View<'a>],
    /// Where the obstacles of the manifest are: positions, m, world, and orientations x y z w, shape `(obstacle,)`.
    pub obstacles: (&'a [[f64; 3]], &'a [[f64; 4]]),
}

/// A world that was taken out because its state was no longer finite.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Quarantine {
    /// Step at which it was noticed.
    pub step: u64,
    /// Drone in which it was noticed.
    pub drone: usize,
    /// What was not finite.
    pub reason: String,
}

/// Contents of `world.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorldRecord {
    /// Number of the world.
    pub world: usize,
    /// Rows of `states.parquet`.
    pub n_states: u64,
    /// Rows of `contacts.parquet`.
    pub n_contacts: u64,
    /// Rows of `clearance.parquet`.
    pub n_clearances: u64,
    /// Frames of `frames.npz`.
    pub n_frames: u64,
    /// Why the world ended early, if it did.
    pub quarantine: Option<Quarantine>,
    /// What the caller noted: drawn parameters, start poses, places of moved obstacles.
    pub info: Value,
    /// All other files of the world's folder, sorted by path.
    pub files: Vec<FileRecord>,
}

/// Contents of `complete.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CompleteRecord {
    /// [`FORMAT`].
    pub format: String,
    /// [`FORMAT_VERSION`].
    pub format_version: u32,
    /// Hash of `manifest.json`.
    pub manifest_sha256: String,
    /// All worlds in order; each hash covers the file list of its world.
    pub worlds: Vec<WorldSeal>,
}

/// One world in `complete.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorldSeal {
    /// Its folder.
    pub dir: String,
    /// Hash of its `world.json`.
    pub world_json_sha256: String,
}

/// What a finished data set holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Summary {
    /// Worlds.
    pub n_worlds: usize,
    /// Worlds that were quarantined.
    pub n_quarantined: usize,
    /// Rows of all `states.parquet`.
    pub n_states: u64,
    /// Rows of all `contacts.parquet`.
    pub n_contacts: u64,
    /// Rows of all `clearance.parquet`.
    pub n_clearances: u64,
    /// Frames of all drones together.
    pub n_images: u64,
    /// Size of all files of all worlds.
    pub bytes: u64,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Progress {
    Open,
    Writing,
    Done,
}

struct Shared {
    dir: PathBuf,
    manifest: Manifest,
    manifest_sha256: String,
    progress: Mutex<Vec<Progress>>,
    warnings: Vec<String>,
    /// Holds the folder's lock.
    _lock: File,
}

impl Shared {
    fn progress(&self) -> MutexGuard<'_, Vec<Progress>> {
        self.progress.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Writes the worlds of one data set. Clones write the same one.
#[derive(Clone)]
pub struct Writer {
    shared: Arc<Shared>,
}

/// Starts a data set in `dir`, or continues the one that is there.
///
/// Returns which worlds are there already, shape `(world,)`. Every world that is there is read and compared with its
/// hashes; damaged ones are removed, named in [`Writer::warnings`], and to be written anew. What an interrupted run left
/// half-written is removed. Errors: the folder holds other files, a data set with another manifest, or is being written
/// by another process.
pub fn create_or_resume(dir: &Path, manifest: &Manifest) -> Result<(Writer, Vec<bool>)> {
    let text = manifest.to_json()?;
    fs::create_dir_all(dir).map_err(DatasetError::io(dir))?;
    let mut warnings = Vec::new();
    let lock = lock(dir, &mut warnings)?;
    settle_manifest(dir, &text)?;
    let seal = checked_seal(dir, &text, manifest.n_worlds, &mut warnings)?;
    let done = whole_worlds(dir, manifest.n_worlds, seal.as_ref(), &mut warnings)?;
    let progress = done.iter().map(|d| if *d { Progress::Done } else { Progress::Open }).collect();
    let shared = Shared {
        dir: dir.to_path_buf(),
        manifest: manifest.clone(),
        manifest_sha256: files::sha256(text.as_bytes()),
        progress: Mutex::new(progress),
        warnings,
        _lock: lock,
    };
    Ok((Writer { shared: Arc::new(shared) }, done))
}

/// How often, and after how long each time, a folder that another run seems to have is tried again.
const LOCK_TRIES: usize = 10;
const LOCK_WAIT: Duration = Duration::from_millis(20);

/// Locks a folder against other runs, as long as the file lives.
fn lock(dir: &Path, warnings: &mut Vec<String>) -> Result<File> {
    let lock = File::open(dir).map_err(DatasetError::io(dir))?;
    let mut tried = lock.try_lock();
    // A child that another thread of this process starts holds copies of our files for a moment, until it runs its own program.
    for _ in 0..LOCK_TRIES {
        if !matches!(tried, Err(TryLockError::WouldBlock)) {
            break;
        }
        std::thread::sleep(LOCK_WAIT);
        tried = lock.try_lock();
    }
    match tried {
        Ok(()) => {}
        Err(TryLockError::WouldBlock) => return Err(DatasetError::Busy { path: dir.to_path_buf() }),
        Err(TryLockError::Error(e)) => warnings.push(format!(
            "{}: cannot be locked ({e}); let no other process write this data set",
            dir.display()
        )),
    }
    Ok(lock)
}

/// Compares the manifest that is there with `text`, or writes it; removes what an interrupted run left half-written.
fn settle_manifest(dir: &Path, text: &str) -> Result<()> {
    let entries = list(dir)?;
    let path = dir.join(MANIFEST);
    match fs::read_to_string(&path) {
        Ok(have) if have == text => {}
        Ok(have) => {
            Manifest::from_json(&path, &have)?;
            return Err(DatasetError::ManifestMismatch {
                path: dir.to_path_buf(),
                differences: differences(&have, text),
            });
        }
        Err(e) if e.kind() == io::ErrorKind::NotFound => {
            // Before there is a manifest, all that a run can leave is a part of it.
            let ours = format!("{PARTIAL}{MANIFEST}");
            if let Some(foreign) = entries.iter().find(|n| !n.starts_with(&ours)) {
                return Err(DatasetError::NotADataset {
                    path: dir.to_path_buf(),
                    found: format!("\"{foreign}\" and no {MANIFEST}"),
                });
            }
        }
        Err(source) => return Err(DatasetError::Io { path, source }),
    }
    for name in entries.iter().filter(|n| n.starts_with(PARTIAL)) {
        remove(&dir.join(name))?;
    }
    if !entries.iter().any(|n| n == MANIFEST) {
        files::write_atomic(dir, MANIFEST, text.as_bytes())?;
    }
    Ok(())
}

/// The seal of a finished data set; a damaged one is removed and named in `warnings`.
fn checked_seal(
    dir: &Path,
    text: &str,
    n_worlds: usize,
    warnings: &mut Vec<String>,
) -> Result<Option<CompleteRecord>> {
    match read_seal(dir, text, n_worlds) {
        Ok(seal) => Ok(seal),
        Err(DatasetError::Damaged { path, expected, found }) => {
            remove(&dir.join(COMPLETE))?;
            let words = format!("expected {expected}, found {found}");
            warnings.push(format!("the seal was damaged and is made anew: {}: {words}", path.display()));
            Ok(None)
        }
        Err(other) => Err(other),
    }
}

/// Which worlds are whole; damaged ones are removed and named in `warnings`. Shape `(world,)`.
fn whole_worlds(
    dir: &Path,
    n_worlds: usize,
    seal: Option<&CompleteRecord>,
    warnings: &mut Vec<String>,
) -> Result<Vec<bool>> {
    let sealed = |world: usize| seal.map(|seal| seal.worlds[world].world_json_sha256.as_str());
    let states: Vec<Result<bool>> =
        (0..n_worlds).into_par_iter().map(|world| is_whole(dir, world, sealed(world))).collect();
    let mut done = Vec::with_capacity(n_worlds);
    for (world, state) in states.into_iter().enumerate() {
        match state {
            Ok(whole) => done.push(whole),
            Err(DatasetError::Damaged { path, expected, found }) => {
                // First the seal, so that it never speaks for a world that is not there.
                let complete = dir.join(COMPLETE);
                if complete.exists() {
                    remove(&complete)?;
                }
                remove(&dir.join(world_dir_name(world)))?;
                warnings.push(format!(
                    "world {world} was damaged and is made anew: {}: expected {expected}, found {found}",
                    path.display()
                ));
                done.push(false);
            }
            Err(other) => return Err(other),
        }
    }
    Ok(done)
}

/// Names in a folder, sorted.
pub(super) fn list(dir: &Path) -> Result<Vec<String>> {
    let mut names = Vec::new();
    for entry in fs::read_dir(dir).map_err(DatasetError::io(dir))? {
        let entry = entry.map_err(DatasetError::io(dir))?;
        names.push(entry.file_name().to_string_lossy().into_owned());
    }
    names.sort();
    Ok(names)
}

fn remove(path: &Path) -> Result<()> {
    if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) }
        .map_err(DatasetError::io(path))
}

/// Reads `complete.json`, where there is one, and compares it with the manifest's text.
pub(super) fn read_seal(dir: &Path, manifest: &str, n_worlds: usize) -> Result<Option<CompleteRecord>> {
    let path = dir.join(COMPLETE);
    let text = match fs::read_to_string(&path) {
        Ok(text) => text,
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(e) if e.kind() == io::ErrorKind::InvalidData => {
            return Err(DatasetError::damaged(&path, "text", "other bytes"));
        }
        Err(source) => return Err(DatasetError::Io { path, source }),
    };
    let seal: CompleteRecord = serde_json::from_str(&text)
        .map_err(|e| DatasetError::damaged(&path, "the fields of docs/formats.md", e))?;
    let found = files::sha256(manifest.as_bytes());
    if seal.manifest_sha256 != found {
        let expected = format!("sha256 {} (from {COMPLETE})", seal.manifest_sha256);
        return Err(DatasetError::damaged(dir.join(MANIFEST), expected, format!("sha256 {found}")));
    }
    if seal.worlds.len() != n_worlds {
        return Err(DatasetError::damaged(&path, format!("{n_worlds} worlds"), seal.worlds.len()));
    }
    if let Some((world, seal)) = seal.worlds.iter().enumerate().find(|(w, s)| s.dir != world_dir_name(*w)) {
        return Err(DatasetError::damaged(&path, format!("folder {}", world_dir_name(world)), &seal.dir));
    }
    Ok(Some(seal))
}

/// Reads the `world.json` of a world's folder and compares it with its hash in the seal, where there is one.
pub(super) fn read_world_record(folder: &Path, sealed: Option<&str>) -> Result<WorldRecord> {
    let path = folder.join(WORLD);
    let text = match fs::read_to_string(&path) {
        Ok(text) => text,
        Err(e) if e.kind() == io::ErrorKind::NotFound => {
            return Err(DatasetError::damaged(&path, "the world's list of files", "none"));
        }
        Err(e) if e.kind() == io::ErrorKind::InvalidData => {
            return Err(DatasetError::damaged(&path, "text", "other bytes"));
        }
        Err(source) => return Err(DatasetError::Io { path, source }),
    };
    let found = files::sha256(text.as_bytes());
    if let Some(wanted) = sealed.filter(|wanted| *wanted != found) {
        let expected = format!("sha256 {wanted} (from {COMPLETE})");
        return Err(DatasetError::damaged(&path, expected, format!("sha256 {found}")));
    }
    let record: WorldRecord = serde_json::from_str(&text)
        .map_err(|e| DatasetError::damaged(&path, "the fields of docs/formats.md", e))?;
    let inside = |file: &&FileRecord| {
        let mut parts = Path::new(&file.path).components();
        !file.path.is_empty() && parts.all(|part| matches!(part, Component::Normal(_)))
    };
    match record.files.iter().find(|file| !inside(file)) {
        Some(file) => {
            Err(DatasetError::damaged(&path, "paths inside the world's folder", format!("{:?}", file.path)))
        }
        None => Ok(record),
    }
}

/// Whether a world is there; an error where it is there and damaged.
fn is_whole(dir: &Path, world: usize, sealed: Option<&str>) -> Result<bool> {
    let folder = dir.join(world_dir_name(world));
    if !folder.try_exists().map_err(DatasetError::io(&folder))? {
        return Ok(false);
    }
    let record = read_world_record(&folder, sealed)?;
    if record.world != world {
        let found = format!("world {}", record.world);
        return Err(DatasetError::damaged(folder.join(WORLD), format!("world {world}"), found));
    }
    for file in &record.files {
        files::check(&folder, file, true)?;
    }
    Ok(true)
}

impl Writer {
    /// The data set's folder.
    pub fn dir(&self) -> &Path {
        &self.shared.dir
    }

    /// The manifest.
    pub fn manifest(&self) -> &Manifest {
        &self.shared.manifest
    }

    /// What was found and repaired at the start.
    pub fn warnings(&self) -> &[String] {
        &self.shared.warnings
    }

    /// Stores the compiled scene, [`Scene::to_mjb`](crate::scene::Scene::to_mjb), whose hash the manifest has.
    pub fn put_scene(&self, mjb: Option<&[u8]>) -> Result<()> {
        let Some(bytes) = mjb else { return Ok(()) };
        let path = self.shared.dir.join(SCENE);
        if fs::read(&path).is_ok_and(|have| have == bytes) {
            return Ok(());
        }
        files::write_atomic(&self.shared.dir, SCENE, bytes)
    }

    /// Starts world `world`. Worlds may be written in any order and at the same time from several threads.
    ///
    /// Memory: one group of 16 384 table rows (about 8 MB for a quadrotor); frames go to disk as they come.
    /// Errors when the world is out of range, there already, or being written.
    pub fn world(&self, world: usize) -> Result<WorldWriter> {
        let manifest = &self.shared.manifest;
        {
            let mut progress = self.shared.progress();
            let problem = match progress.get(world) {
                None => format!("expected 0 to {}; correct the number", manifest.n_worlds - 1),
                Some(Progress::Done) => "is there already; skip it".to_owned(),
                Some(Progress::Writing) => "is being written; open each world once".to_owned(),
                Some(Progress::Open) => {
                    progress[world] = Progress::Writing;
                    String::new()
                }
            };
            if !problem.is_empty() {
                return Err(DatasetError::World { world, problem });
            }
        }
        WorldWriter::open(self.shared.clone(), world).inspect_err(|_| {
            self.shared.progress()[world] = Progress::Open;
        })
    }

    /// Seals the data set: writes `complete.json`. Errors when a world is missing.
    pub fn finish(&self) -> Result<Summary> {
        let shared = &self.shared;
        let n_worlds = shared.manifest.n_worlds;
        {
            let progress = shared.progress();
            let missing = progress.iter().filter(|p| **p != Progress::Done).count();
            if let Some(first) = progress.iter().position(|p| *p != Progress::Done) {
                let path = shared.dir.clone();
                return Err(DatasetError::Incomplete { path, expected: n_worlds, missing, first });
            }
        }
        let mut summary = Summary { n_worlds, ..Summary::default() };
        let sealed: Vec<(WorldRecord, WorldSeal, u64)> = (0..n_worlds)
            .into_par_iter()
            .map(|world| {
                let dir = world_dir_name(world);
                let folder = shared.dir.join(&dir);
                let record = read_world_record(&folder, None)?;
                // All that is listed must be on the disk before the seal is.
                for file in &record.files {
                    files::sync(&folder.join(&file.path))?;
                }
                for images in ["depth", "depth_noisy"].map(|name| folder.join(name)) {
                    if images.is_dir() {
                        files::sync(&images)?;
                    }
                }
                let seal = files::record(&folder, WORLD)?;
                Ok((record, WorldSeal { dir, world_json_sha256: seal.sha256 }, seal.bytes))
            })
            .collect::<Result<_>>()?;
        let mut worlds = Vec::with_capacity(n_worlds);
        for (record, seal, bytes) in sealed {
            summary.n_quarantined += usize::from(record.quarantine.is_some());
            summary.n_states += record.n_states;
            summary.n_contacts += record.n_contacts;
            summary.n_clearances += record.n_clearances;
            summary.n_images += record.n_frames * shared.manifest.n_drones as u64;
            summary.bytes += bytes + record.files.iter().map(|f| f.bytes).sum::<u64>();
            worlds.push(seal);
        }
        let complete = CompleteRecord {
            format: FORMAT.to_owned(),
            format_version: FORMAT_VERSION,
            manifest_sha256: shared.manifest_sha256.clone(),
            worlds,
        };
        files::write_atomic(&shared.dir, COMPLETE, pretty(&complete, &shared.dir)?.as_bytes())?;
        Ok(summary)
    }
}

/// JSON with a final line break.
fn pretty(value: &impl Serialize, path: &Path) -> Result<String> {
    let mut text = serde_json::to_string_pretty(value)
        .map_err(|e| DatasetError::Io { path: path.to_path_buf(), source: io::Error::other(e) })?;
    text.push('\n');
    Ok(text)
}

/// The growing arrays of `frames.npz`.
struct FrameSpools {
    time_s: Spool,
    step: Spool,
    camera_pos_m: Spool,
    camera_quat_xyzw: Spool,
    depth_m: Spool,
    status: Spool,
    geom_id: Spool,
    body_id: Spool,
    normal: Option<Spool>,
    depth_noisy_m: Option<Spool>,
    status_noisy: Option<Spool>,
    obstacle_pos_m: Option<Spool>,
    obstacle_quat_xyzw: Option<Spool>,
}

/// What `states.parquet` says of a command.
struct Commands<'a> {
    /// Roll, pitch, yaw (rad) and thrust (N).
    attitude: Option<[f64; 4]>,
    thrust: Option<f64>,
    rotors: &'a [f64],
    /// Numbers in columns of the control mode.
    extra: &'a [f64],
}

impl FrameSpools {
    /// Adds a frame that was checked.
    fn push(&mut self, frame: &FrameInput) -> Result<()> {
        self.time_s.push(std::iter::once(frame.t_s.to_le_bytes()))?;
        self.step.push(std::iter::once((frame.step as i64).to_le_bytes()))?;
        let (pos_m, quat_xyzw) = frame.obstacles;
        if let (Some(pos), Some(quat)) = (&mut self.obstacle_pos_m, &mut self.obstacle_quat_xyzw) {
            pos.push(pos_m.iter().flatten().map(|v| v.to_le_bytes()))?;
            quat.push(quat_xyzw.iter().flatten().map(|v| v.to_le_bytes()))?;
        }
        for view in frame.views {
            self.camera_pos_m.push(view.pos_m.iter().map(|v| v.to_le_bytes()))?;
            self.camera_quat_xyzw.push(view.quat_xyzw.iter().map(|v| v.to_le_bytes()))?;
            self.depth_m.push(view.depth_m.iter().map(|v| v.to_le_bytes()))?;
            self.status.push_bytes(view.status)?;
            self.geom_id.push(view.geom_id.iter().map(|v| v.to_le_bytes()))?;
            self.body_id.push(view.body_id.iter().map(|v| v.to_le_bytes()))?;
            if let (Some(spool), Some(normal)) = (&mut self.normal, view.normal) {
                spool.push(normal.iter().flatten().map(|v| v.to_le_bytes()))?;
            }
            if let (Some(spool), Some(noisy)) = (&mut self.depth_noisy_m, view.noisy) {
                spool.push(noisy.depth_m.iter().map(|v| v.to_le_bytes()))?;
            }
            if let (Some(spool), Some(noisy)) = (&mut self.status_noisy, view.noisy) {
                spool.push_bytes(noisy.status)?;
            }
        }
        Ok(())
    }

    fn create(folder: &Path, manifest: &Manifest) -> Result<Self> {
        let (d, h, w) = (manifest.n_drones, manifest.cameras[0].height, manifest.cameras[0].width);
        let make = |name, descr, tail: &[usize]| Spool::create(folder, "frames", name, descr, tail);
        let (noisy, o) = (manifest.noise.is_some(), manifest.obstacles.len());
        Ok(Self {
            time_s: make("time_s", "<f8", &[])?,
            step: make("step", "<i8", &[])?,
            camera_pos_m: make("camera_pos_m", "<f8", &[d, 3])?,
            camera_quat_xyzw: make("camera_quat_xyzw", "<f8", &[d, 4])?,
            depth_m: make("depth_m", "<f4", &[d, h, w])?,
            status: make("status", "|u1", &[d, h, w])?,
            geom_id: make("geom_id", "<i4", &[d, h, w])?,
            body_id: make("body_id", "<i4", &[d, h, w])?,
            normal: manifest.normals.then(|| make("normal", "<f4", &[d, h, w, 3])).transpose()?,
            depth_noisy_m: noisy.then(|| make("depth_noisy_m", "<f4", &[d, h, w])).transpose()?,
            status_noisy: noisy.then(|| make("status_noisy", "|u1", &[d, h, w])).transpose()?,
            obstacle_pos_m: (o > 0).then(|| make("obstacle_pos_m", "<f8", &[o, 3])).transpose()?,
            obstacle_quat_xyzw: (o > 0).then(|| make("obstacle_quat_xyzw", "<f8", &[o, 4])).transpose()?,
        })
    }

    fn into_list(self) -> Vec<Spool> {
        let mut list = vec![
            self.time_s,
            self.step,
            self.camera_pos_m,
            self.camera_quat_xyzw,
            self.depth_m,
            self.status,
            self.geom_id,
            self.body_id,
        ];
        let more = [self.normal, self.depth_noisy_m, self.status_noisy];
        let obstacles = [self.obstacle_pos_m, self.obstacle_quat_xyzw];
        list.extend(more.into_iter().chain(obstacles).flatten());
        list
    }
}

/// The growing arrays of `sensor_….npz`.
struct SensorSpools {
    time_s: Spool,
    step: Spool,
    /// By channel.
    channels: Vec<Spool>,
    n_samples: usize,
    last_s: f64,
}

impl SensorSpools {
    fn create(folder: &Path, n_drones: usize, sensor: &SensorRecord) -> Result<Self> {
        let make = |name: &str, descr, tail: &[usize]| Spool::create(folder, &sensor.name, name, descr, tail);
        let channel = |c: &SensorChannel| {
            let tail = [&[n_drones], &c.shape[..]].concat();
            make(&c.name, dtype(c.kind), &tail)
        };
        Ok(Self {
            time_s: make("time_s", "<f8", &[])?,
            step: make("step", "<i8", &[])?,
            channels: sensor.channels.iter().map(channel).collect::<Result<_>>()?,
            n_samples: 0,
            last_s: f64::NEG_INFINITY,
        })
    }
}

/// Type of a channel's numbers in numpy's spelling.
fn dtype(kind: ChannelType) -> &'static str {
    match kind {
        ChannelType::F32 => "<f4",
        ChannelType::I32 => "<i4",
        ChannelType::U8 => "|u1",
    }
}

/// Writes one world. Dropped without [`WorldWriter::finish`] it leaves nothing behind, and the world can be started again.
pub struct WorldWriter {
    shared: Arc<Shared>,
    world: usize,
    partial: PathBuf,
    states: TableWriter,
    contacts: TableWriter,
    clearances: Option<TableWriter>,
    frames: Option<FrameSpools>,
    sensors: Vec<SensorSpools>,
    n_frames: u64,
    images: Vec<String>,
    last_frame_s: f64,
    quarantine: Option<Quarantine>,
    info: Value,
    /// A write broke off half-way.
    failed: bool,
    guard: Guard,
}

/// Takes an unfinished world back.
struct Guard {
    shared: Arc<Shared>,
    world: usize,
    partial: PathBuf,
    finished: bool,
}

impl Drop for Guard {
    fn drop(&mut self) {
        if !self.finished {
            // The next start removes it if this fails.
            let _ = fs::remove_dir_all(&self.partial);
            self.shared.progress()[self.world] = Progress::Open;
        }
    }
}

impl WorldWriter {
    fn open(shared: Arc<Shared>, world: usize) -> Result<Self> {
        let manifest = &shared.manifest;
        let partial = shared.dir.join(format!("{PARTIAL}{}", world_dir_name(world)));
        if partial.exists() {
            remove(&partial)?;
        }
        fs::create_dir(&partial).map_err(DatasetError::io(&partial))?;
        let guard = Guard { shared: shared.clone(), world, partial: partial.clone(), finished: false };
        let mut frames = None;
        if !manifest.cameras.is_empty() {
            let folders: &[&str] =
                if manifest.noise.is_some() { &["depth", "depth_noisy"] } else { &["depth"] };
            for name in folders {
                let folder = partial.join(name);
                fs::create_dir(&folder).map_err(DatasetError::io(&folder))?;
            }
            frames = Some(FrameSpools::create(&partial, manifest)?);
        }
        let sensors = manifest
            .sensors
            .iter()
            .map(|sensor| SensorSpools::create(&partial, manifest.n_drones, sensor))
            .collect::<Result<_>>()?;
        let clearances = (manifest.flight.clearance_every_steps > 0)
            .then(|| TableWriter::create(partial.join(CLEARANCE), clearance_columns()))
            .transpose()?;
        Ok(Self {
            states: TableWriter::create(partial.join(STATES), state_columns(manifest))?,
            contacts: TableWriter::create(partial.join(CONTACTS), contact_columns())?,
            clearances,
            frames,
            sensors,
            n_frames: 0,
            images: Vec::new(),
            last_frame_s: f64::NEG_INFINITY,
            quarantine: None,
            info: Value::Null,
            failed: false,
            world,
            partial,
            guard,
            shared,
        })
    }

    /// The world's number.
    pub fn world(&self) -> usize {
        self.world
    }

    fn input_error<T>(
        &self,
        item: impl Into<String>,
        expected: impl Into<String>,
        found: impl Into<String>,
        remedy: &'static str,
    ) -> Result<T> {
        Err(DatasetError::Input {
            world: self.world,
            item: item.into(),
            expected: expected.into(),
            found: found.into(),
            remedy,
        })
    }

    fn check_drone(&self, item: &str, drone: usize, t_s: f64, step: u64) -> Result<()> {
        let n = self.shared.manifest.n_drones;
        if drone >= n {
            let (expected, found) = (format!("0 to {}", n - 1), drone.to_string());
            return self.input_error(format!("{item}, drone"), expected, found, "correct the drone number");
        }
        if !t_s.is_finite() {
            return self.input_error(
                format!("{item}, time"),
                "a finite time",
                t_s.to_string(),
                "correct the time",
            );
        }
        if i64::try_from(step).is_err() {
            let found = step.to_string();
            return self.input_error(format!("{item}, step"), "below 2^63", found, "correct the step");
        }
        Ok(())
    }

    /// Writes a row of `states.parquet`.
    pub fn state(&mut self, row: &StateRow) -> Result<()> {
        self.check_drone("state", row.drone, row.t_s, row.step)?;
        self.check_sizes(row)?;
        let Commands { attitude, thrust: thrust_command, rotors: rotor_command, extra } =
            self.commands(row)?;
        let most_rotors = self.shared.manifest.n_rotors();
        let t = &mut self.states;
        t.float(row.t_s);
        t.integer(row.step as i64);
        t.integer(self.world as i64);
        t.integer(row.drone as i64);
        t.floats(&row.pos_m);
        t.floats(&row.quat_xyzw);
        t.floats(&row.vel_m_s);
        t.floats(&row.ang_vel_rad_s);
        t.maybe_floats(row.specific_force_m_s2.as_ref().map_or(&[], |a| a), 3);
        t.maybe_floats(row.rotor_rad_s, most_rotors);
        t.maybe(row.thrust_n);
        t.floats(extra);
        t.maybe_floats(attitude.as_ref().map_or(&[], |a| &a[..3]), 3);
        t.maybe(thrust_command);
        t.maybe_floats(rotor_command, most_rotors);
        for part in [
            row.reference.map(|r| r.pos_m),
            row.reference.map(|r| r.vel_m_s),
            row.reference.map(|r| r.acc_m_s2),
        ] {
            t.maybe_floats(part.as_ref().map_or(&[], |p| p), 3);
        }
        t.maybe(row.reference.map(|r| r.yaw_rad));
        t.maybe(row.battery_v);
        t.maybe_floats(row.wind_m_s.as_ref().map_or(&[], |w| w), 3);
        t.end_row().inspect_err(|_| self.failed = true)
    }

    /// Refuses a row whose command or rotors have not the numbers of the drone.
    fn check_sizes(&self, row: &StateRow) -> Result<()> {
        let manifest = &self.shared.manifest;
        let mode = manifest.flight.control_mode.as_str();
        let n_rotors = manifest.vehicles[row.drone].n_rotors;
        let item = |part: &str| format!("state of drone {} at step {}, {part}", row.drone, row.step);
        let width = manifest.command_width(row.drone);
        if row.command.len() != width {
            let found = format!("{} numbers", row.command.len());
            let expected = format!("{width} numbers in mode {mode}");
            return self.input_error(
                item("command"),
                expected,
                found,
                "give the command of the control mode",
            );
        }
        for (part, values) in [("rotor speeds", row.rotor_rad_s), ("rotor commands", row.rotor_command_rad_s)]
        {
            if !values.is_empty() && values.len() != n_rotors {
                let found = format!("{} numbers", values.len());
                let expected = format!("{n_rotors} numbers or none");
                return self.input_error(item(part), expected, found, "give one per rotor");
            }
        }
        Ok(())
    }

    /// The command of a row by its columns; what the control mode makes of it may not be given twice.
    fn commands<'r>(&self, row: &StateRow<'r>) -> Result<Commands<'r>> {
        let mode = self.shared.manifest.flight.control_mode.as_str();
        let item = |part: &str| format!("state of drone {} at step {}, {part}", row.drone, row.step);
        let (mut attitude, mut rotor_command) = (row.attitude_command, row.rotor_command_rad_s);
        let mut thrust_command = attitude.map(|a| a[3]);
        match mode {
            "attitude" if attitude.is_some() => {
                let remedy = "leave attitude_command empty, the command is it";
                return self.input_error(item("attitude command"), "none in mode attitude", "one", remedy);
            }
            "rotor_vel" if !rotor_command.is_empty() => {
                let remedy = "leave rotor_command_rad_s empty, the command is it";
                return self.input_error(item("rotor commands"), "none in mode rotor_vel", "some", remedy);
            }
            "attitude" => {
                attitude = Some([row.command[0], row.command[1], row.command[2], row.command[3]]);
                thrust_command = Some(row.command[3]);
            }
            "rotor_vel" => rotor_command = row.command,
            "body_rate" => thrust_command = Some(row.command[3]),
            "force_torque" => thrust_command = Some(row.command[0]),
            _ => {}
        }
        let extra: &[f64] = match mode {
            "state" => row.command,
            "body_rate" => &row.command[..3],
            "force_torque" => &row.command[1..],
            _ => &[],
        };
        debug_assert_eq!(extra.len(), extra_command_names(mode).len());
        Ok(Commands { attitude, thrust: thrust_command, rotors: rotor_command, extra })
    }

    /// Writes a row of `contacts.parquet`.
    pub fn contact(&mut self, row: &ContactRow) -> Result<()> {
        self.check_drone("contact", row.drone, row.t_s, row.step)?;
        if let Some(other) = row.other_drone {
            self.check_drone("contact, other", other, row.t_s, row.step)?;
        }
        let manifest = &self.shared.manifest;
        for (part, ids, n) in
            [("geoms", row.geoms, manifest.geoms.len()), ("bodies", row.bodies, manifest.bodies.len())]
        {
            let least = [0, if row.other_flex >= 0 { -1 } else { 0 }];
            if (0..2).any(|i| ids[i] < least[i] || i64::from(ids[i]) >= n as i64) {
                let (expected, found) = (format!("two of 0 to {}", n as i64 - 1), format!("{ids:?}"));
                let remedy = "list all geoms and bodies in the manifest";
                return self.input_error(
                    format!("contact at step {}, {part}", row.step),
                    expected,
                    found,
                    remedy,
                );
            }
        }
        let t = &mut self.contacts;
        t.float(row.t_s);
        t.integer(row.step as i64);
        t.integer(self.world as i64);
        t.integer(row.drone as i64);
        t.integer(row.other_drone.map_or(-1, |d| d as i64));
        for id in row.geoms.iter().chain(&row.bodies) {
            t.integer(i64::from(*id));
        }
        t.integer(i64::from(row.other_flex));
        t.float(row.distance_m);
        t.floats(&row.point_m);
        t.floats(&row.normal);
        t.integer(i64::from(row.exact));
        t.integer(i64::from(row.swept_fraction.is_some()));
        t.maybe(row.swept_fraction);
        t.end_row().inspect_err(|_| self.failed = true)
    }

    /// Writes a row of `clearance.parquet`.
    pub fn clearance(&mut self, row: &ClearanceRow) -> Result<()> {
        self.check_drone("clearance", row.drone, row.t_s, row.step)?;
        if let Some(nearest) = row.nearest {
            if let Some(other) = nearest.other_drone {
                self.check_drone("clearance, other", other, row.t_s, row.step)?;
            }
            let manifest = &self.shared.manifest;
            let (geoms, bodies) = (manifest.geoms.len() as i64, manifest.bodies.len() as i64);
            let n = [geoms, geoms, bodies];
            let ids = [nearest.drone_geom, nearest.geom, nearest.body].map(i64::from);
            if (0..3).any(|i| ids[i] < 0 || ids[i] >= n[i]) {
                let (expected, found) = (format!("ids below {n:?}"), format!("{ids:?}"));
                let remedy = "list all geoms and bodies in the manifest";
                let item = format!("clearance at step {}, geoms and body", row.step);
                return self.input_error(item, expected, found, remedy);
            }
        }
        let world = self.world;
        let Some(t) = &mut self.clearances else {
            let expected = "no clearance (flight.clearance_every_steps is 0)";
            return self.input_error("clearance", expected, "a row", "set clearance_every_steps");
        };
        t.float(row.t_s);
        t.integer(row.step as i64);
        t.integer(world as i64);
        t.integer(row.drone as i64);
        t.maybe(row.nearest.map(|n| n.distance_m));
        t.maybe_floats(row.nearest.as_ref().map_or(&[], |n| &n.from_m), 3);
        t.maybe_floats(row.nearest.as_ref().map_or(&[], |n| &n.to_m), 3);
        t.integer(row.nearest.map_or(-1, |n| i64::from(n.drone_geom)));
        t.integer(row.nearest.map_or(-1, |n| i64::from(n.geom)));
        t.integer(row.nearest.map_or(-1, |n| i64::from(n.body)));
        t.integer(row.nearest.and_then(|n| n.other_drone).map_or(-1, |d| d as i64));
        t.integer(i64::from(row.nearest.is_none_or(|n| n.exact)));
        t.end_row().inspect_err(|_| self.failed = true)
    }

    /// Writes a frame of all drones: exact arrays and 16-bit images.
    pub fn frame(&mut self, frame: &FrameInput) -> Result<()> {
        self.check_frame(frame)?;
        let images = self.encoded(frame)?;
        // All is sound; from here only the disk can fail.
        self.failed = true;
        let camera = &self.shared.manifest.cameras[0];
        for (name, pixels) in images {
            depth_png::write(&self.partial.join(&name), camera.width, camera.height, &pixels)?;
            self.images.push(name);
        }
        if let Some(spools) = &mut self.frames {
            spools.push(frame)?;
        }
        self.last_frame_s = frame.t_s;
        self.n_frames += 1;
        self.failed = false;
        Ok(())
    }

    /// Refuses a frame that is not what the manifest promises.
    fn check_frame(&self, frame: &FrameInput) -> Result<()> {
        let number = self.n_frames;
        let manifest = &self.shared.manifest;
        let item = |part: &str| format!("frame {number}, {part}");
        let Some(camera) = manifest.cameras.first() else {
            let expected = "no frames (the manifest has no camera)";
            return self.input_error(item("all"), expected, "one", "list cameras in the manifest");
        };
        let n = camera.width * camera.height;
        if frame.views.len() != manifest.n_drones {
            let (expected, found) = (manifest.n_drones.to_string(), frame.views.len().to_string());
            return self.input_error(item("views"), expected, found, "give one view per drone");
        }
        // NaN fails the comparison too.
        if !(frame.t_s > self.last_frame_s && frame.t_s.is_finite() && i64::try_from(frame.step).is_ok()) {
            let expected = format!("a time after {} s", self.last_frame_s);
            let found = format!("{} s, step {}", frame.t_s, frame.step);
            return self.input_error(item("time"), expected, found, "write frames in the order of time");
        }
        for (drone, view) in frame.views.iter().enumerate() {
            self.check_view(drone, view, n)?;
        }
        let (pos_m, quat_xyzw) = frame.obstacles;
        let (named, given) = (manifest.obstacles.len(), pos_m.len());
        let is_finite = pos_m.iter().flatten().chain(quat_xyzw.iter().flatten()).all(|x| x.is_finite());
        if given != named || quat_xyzw.len() != named || !is_finite {
            let expected = format!("{named} finite poses, one for each obstacle of the manifest");
            let found = format!("{given} positions {pos_m:?} and {} orientations", quat_xyzw.len());
            return self.input_error(item("obstacles"), expected, found, "make manifest and frames agree");
        }
        Ok(())
    }

    /// Refuses a view of one drone that is not what the manifest promises, or has not `n` pixels.
    fn check_view(&self, drone: usize, view: &View, n: usize) -> Result<()> {
        let (number, manifest) = (self.n_frames, &self.shared.manifest);
        let camera = &manifest.cameras[drone];
        let item = |part: &str| format!("frame {number} of drone {drone}, {part}");
        let sizes = [
            ("depth", view.depth_m.len()),
            ("status", view.status.len()),
            ("geom ids", view.geom_id.len()),
            ("body ids", view.body_id.len()),
            ("normals", view.normal.map_or(n, <[_]>::len)),
            ("noisy depth", view.noisy.map_or(n, |v| v.depth_m.len())),
            ("noisy status", view.noisy.map_or(n, |v| v.status.len())),
        ];
        if let Some((part, size)) = sizes.iter().find(|(_, size)| *size != n) {
            let expected = format!("{n} pixels ({}x{})", camera.width, camera.height);
            return self.input_error(item(part), expected, size.to_string(), "render at the manifest's size");
        }
        let promised = (manifest.normals, manifest.noise.is_some());
        let given = (view.normal.is_some(), view.noisy.is_some());
        if promised != given {
            let text = |(normals, noise)| format!("normals {normals}, noisy depth {noise}");
            let remedy = "make manifest and frames agree";
            return self.input_error(item("parts"), text(promised), text(given), remedy);
        }
        if view.k != camera.k {
            let expected = format!("{:?}", camera.k);
            let found = format!("{:?}", view.k);
            return self.input_error(item("K"), expected, found, "give the manifest the camera's matrix");
        }
        for (part, ids, n_known) in [
            ("geom ids", view.geom_id, manifest.geoms.len()),
            ("body ids", view.body_id, manifest.bodies.len()),
        ] {
            if let Some(id) = ids.iter().find(|id| **id < -1 || i64::from(**id) >= n_known as i64) {
                let expected = format!("-1 to {}", n_known as i64 - 1);
                let remedy = "list all geoms and bodies in the manifest";
                return self.input_error(item(part), expected, id.to_string(), remedy);
            }
        }
        if !view.pos_m.iter().chain(&view.quat_xyzw).all(|x| x.is_finite()) {
            let found = format!("{:?}, {:?}", view.pos_m, view.quat_xyzw);
            return self.input_error(item("pose"), "finite numbers", found, "quarantine the world instead");
        }
        Ok(())
    }

    /// The 16-bit images of a frame that was checked: path within the world, and pixels.
    fn encoded(&self, frame: &FrameInput) -> Result<Vec<(String, Vec<u16>)>> {
        let (number, manifest) = (self.n_frames, &self.shared.manifest);
        let width = manifest.cameras[0].width;
        let unit = manifest.depth_png.metres_per_unit;
        let mut images = Vec::with_capacity(2 * frame.views.len());
        for (drone, view) in frame.views.iter().enumerate() {
            let planes = [
                Some(("depth", view.depth_m, view.status)),
                view.noisy.map(|noisy| ("depth_noisy", noisy.depth_m, noisy.status)),
            ];
            for (folder, depth_m, status) in planes.into_iter().flatten() {
                let mut pixels = Vec::with_capacity(depth_m.len());
                for (i, (depth, status)) in depth_m.iter().zip(status).enumerate() {
                    let Some(value) = depth_png::encode(*depth, *status, unit) else {
                        let (row, column) = (i / width, i % width);
                        let most = f64::from(depth_png::MAX_DISTANCE) * unit;
                        return self.input_error(
                            format!(
                                "frame {number} of drone {drone}, {folder} at row {row}, column {column}"
                            ),
                            format!(
                                "a hit from {unit} m to {most} m, or status 1 miss, 2 too far, 3 too near"
                            ),
                            format!("status {status}, {depth} m"),
                            "give hits outside the camera's range the status too near or too far",
                        );
                    };
                    pixels.push(value);
                }
                images.push((format!("{folder}/drone{drone}_{number:06}.png"), pixels));
            }
        }
        Ok(images)
    }

    /// Writes a sample of a sensor of the manifest, by its number: the numbers of each channel, (drone, shape of the channel).
    pub fn sample(&mut self, sensor: usize, t_s: f64, step: u64, values: &[&[f32]]) -> Result<()> {
        let manifest = &self.shared.manifest;
        let Some(record) = manifest.sensors.get(sensor) else {
            let expected = format!("less than {}, the sensors of the manifest", manifest.sensors.len());
            return self.input_error("sensor", expected, sensor.to_string(), "list sensors in the manifest");
        };
        let item = |part: &str| format!("sensor {} at step {step}, {part}", record.name);
        if values.len() != record.channels.len() {
            let (expected, found) = (record.channels.len().to_string(), values.len().to_string());
            return self.input_error(item("channels"), expected, found, "give every channel");
        }
        for (channel, values) in record.channels.iter().zip(values) {
            let n = manifest.n_drones * channel.len();
            if values.len() != n {
                let found = format!("{} numbers", values.len());
                let remedy = "give the numbers of all drones";
                return self.input_error(item(&channel.name), format!("{n} numbers"), found, remedy);
            }
            let is_whole = |v: &f32| match channel.kind {
                ChannelType::F32 => true,
                ChannelType::I32 => v.fract() == 0.0 && v.abs() <= 16_777_216.0,
                ChannelType::U8 => v.fract() == 0.0 && (0.0..=255.0).contains(v),
            };
            if let Some(odd) = values.iter().find(|v| !is_whole(v)) {
                let expected = format!("whole numbers that {:?} holds", channel.kind);
                return self.input_error(item(&channel.name), expected, odd.to_string(), "correct its type");
            }
        }
        let spools = &self.sensors[sensor];
        if !(t_s > spools.last_s && t_s.is_finite() && i64::try_from(step).is_ok()) {
            let expected = format!("a time after {} s", spools.last_s);
            let found = format!("{t_s} s, step {step}");
            return self.input_error(item("time"), expected, found, "write samples in the order of time");
        }
        let kinds: Vec<ChannelType> = record.channels.iter().map(|c| c.kind).collect();
        // All is sound; from here only the disk can fail.
        self.failed = true;
        let spools = &mut self.sensors[sensor];
        spools.time_s.push(std::iter::once(t_s.to_le_bytes()))?;
        spools.step.push(std::iter::once((step as i64).to_le_bytes()))?;
        for ((spool, values), kind) in spools.channels.iter_mut().zip(values).zip(kinds) {
            match kind {
                ChannelType::F32 => spool.push(values.iter().map(|v| v.to_le_bytes()))?,
                ChannelType::I32 => spool.push(values.iter().map(|v| (*v as i32).to_le_bytes()))?,
                ChannelType::U8 => spool.push(values.iter().map(|v| [*v as u8]))?,
            }
        }
        spools.n_samples += 1;
        spools.last_s = t_s;
        self.failed = false;
        Ok(())
    }

    /// Marks the world as taken out; it then may end early. The first mark stays.
    pub fn quarantine(&mut self, quarantine: Quarantine) {
        self.quarantine.get_or_insert(quarantine);
    }

    /// Notes about this world for `world.json`: drawn parameters, start poses, places of moved obstacles.
    pub fn set_info(&mut self, info: Value) {
        self.info = info;
    }

    /// Closes the world's files, notes their hashes, and then puts the world into its place. Errors also when an earlier
    /// write of this world failed.
    pub fn finish(self) -> Result<WorldRecord> {
        if self.failed {
            let problem = "an earlier write failed; free the disk and write the world again".to_owned();
            return Err(DatasetError::World { world: self.world, problem });
        }
        let Self {
            shared,
            world,
            partial,
            states,
            contacts,
            clearances,
            frames,
            sensors,
            n_frames,
            images,
            ..
        } = self;
        let mut guard = self.guard;
        let mut names = images;
        let n_states = states.finish()?;
        let n_contacts = contacts.finish()?;
        names.extend([STATES.to_owned(), CONTACTS.to_owned()]);
        let mut n_clearances = 0;
        if let Some(clearances) = clearances {
            n_clearances = clearances.finish()?;
            names.push(CLEARANCE.to_owned());
        }
        if let Some(frames) = frames {
            let n = usize::try_from(n_frames).unwrap_or(usize::MAX);
            npz::pack(&partial.join(FRAMES), n, frames.into_list())?;
            names.push(FRAMES.to_owned());
        }
        for (spools, sensor) in sensors.into_iter().zip(&shared.manifest.sensors) {
            let mut list = vec![spools.time_s, spools.step];
            list.extend(spools.channels);
            npz::pack(&partial.join(sensor.file()), spools.n_samples, list)?;
            names.push(sensor.file());
        }
        names.sort();
        let mut records = Vec::with_capacity(names.len());
        for name in &names {
            records.push(files::record(&partial, name)?);
            // Images are many; `Writer::finish` brings them to the disk, and until then their hashes guard them.
            if !name.ends_with(".png") {
                files::sync(&partial.join(name))?;
            }
        }
        let record = WorldRecord {
            world,
            n_states,
            n_contacts,
            n_clearances,
            n_frames,
            quarantine: self.quarantine,
            info: self.info,
            files: records,
        };
        files::write_atomic(&partial, WORLD, pretty(&record, &partial)?.as_bytes())?;
        let place = shared.dir.join(world_dir_name(world));
        fs::rename(&partial, &place).map_err(DatasetError::io(&place))?;
        guard.finished = true;
        files::sync(&shared.dir)?;
        shared.progress()[world] = Progress::Done;
        Ok(record)
    }
}
