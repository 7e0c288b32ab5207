//! Reads a data set.

use std::collections::{BTreeMap, HashSet};
use std::fs::{self, File};
use std::io::{self, BufReader};
use std::path::{Path, PathBuf};

use ndarray::{Array1, Array3, Array4, Array5, ArrayD, Dimension};
use ndarray_npy::{NpzReader, ReadableElement};
use rayon::prelude::*;

use super::depth_png;
use super::error::{DatasetError, Result};
use super::files::{self, FileRecord};
use super::manifest::Manifest;
use super::table::Table;
use super::writer::{
    CLEARANCE, COMPLETE, CONTACTS, CompleteRecord, FRAMES, MANIFEST, SCENE, STATES, WORLD, WorldRecord,
    Writer, create_or_resume, list, read_seal, read_world_record, world_dir_name,
};
use crate::scene::Scene;
use crate::sense::ChannelType;

/// An opened data set.
#[derive(Clone, Debug)]
pub struct Dataset {
    dir: PathBuf,
    manifest: Manifest,
    complete: Option<CompleteRecord>,
}

/// All frames of one world.
#[derive(Clone, Debug, PartialEq)]
pub struct Frames {
    /// Seconds since the start, shape `(frame,)`.
    pub time_s: Array1<f64>,
    /// Simulation steps, shape `(frame,)`.
    pub step: Array1<i64>,
    /// Camera positions, m, world, shape `(frame, drone, 3)`.
    pub camera_pos_m: Array3<f64>,
    /// Camera attitudes, camera to world, shape `(frame, drone, 4)`.
    pub camera_quat_xyzw: Array3<f64>,
    /// Depth, m, shape `(frame, drone, row, column)`.
    pub depth_m: Array4<f32>,
    /// Pixel statuses, shape `(frame, drone, row, column)`.
    pub status: Array4<u8>,
    /// Geoms, −1 none, shape `(frame, drone, row, column)`.
    pub geom_id: Array4<i32>,
    /// Bodies, −1 none, shape `(frame, drone, row, column)`.
    pub body_id: Array4<i32>,
    /// World normals, shape `(frame, drone, row, column, 3)`.
    pub normal: Option<Array5<f32>>,
    /// Noisy depth, m, shape `(frame, drone, row, column)`.
    pub depth_noisy_m: Option<Array4<f32>>,
    /// Statuses of the noisy depth, shape `(frame, drone, row, column)`.
    pub status_noisy: Option<Array4<u8>>,
    /// Where the obstacles of the manifest are, m, world, shape `(frame, obstacle, 3)`; none where it names none.
    pub obstacle_pos_m: Option<Array3<f64>>,
    /// Their orientations x y z w, shape `(frame, obstacle, 4)`.
    pub obstacle_quat_xyzw: Option<Array3<f64>>,
}

impl Dataset {
    /// Starts a data set in `dir`, or continues the one that is there: [`create_or_resume`].
    pub fn create_or_resume(dir: &Path, manifest: &Manifest) -> Result<(Writer, Vec<bool>)> {
        create_or_resume(dir, manifest)
    }

    /// Opens the data set in `dir`, which may be unfinished ([`Dataset::is_complete`]).
    pub fn open(dir: &Path) -> Result<Self> {
        let path = dir.join(MANIFEST);
        let text = match fs::read_to_string(&path) {
            Ok(text) => text,
            Err(e) if e.kind() == io::ErrorKind::NotFound => {
                let found =
                    if dir.is_dir() { format!("a folder without {MANIFEST}") } else { "no folder".into() };
                return Err(DatasetError::NotADataset { path: dir.to_path_buf(), found });
            }
            Err(e) if e.kind() == io::ErrorKind::InvalidData => {
                return Err(DatasetError::damaged(&path, "text", "other bytes"));
            }
            Err(source) => return Err(DatasetError::Io { path, source }),
        };
        let manifest = Manifest::from_json(&path, &text)?;
        let complete = read_seal(dir, &text, manifest.n_worlds)?;
        Ok(Self { dir: dir.to_path_buf(), manifest, complete })
    }

    /// The data set's folder.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// The manifest.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// Whether the data set was sealed with all its worlds.
    pub fn is_complete(&self) -> bool {
        self.complete.is_some()
    }

    /// Numbers of the worlds that are there.
    pub fn worlds(&self) -> Vec<usize> {
        (0..self.manifest.n_worlds).filter(|w| self.dir.join(world_dir_name(*w)).is_dir()).collect()
    }

    /// Opens a world; errors when it is out of range or not there.
    pub fn world(&self, world: usize) -> Result<WorldReader<'_>> {
        let n = self.manifest.n_worlds;
        if world >= n {
            let problem = format!("expected 0 to {}; correct the number", n - 1);
            return Err(DatasetError::World { world, problem });
        }
        let folder = self.dir.join(world_dir_name(world));
        if !folder.is_dir() {
            return Err(DatasetError::Incomplete {
                path: self.dir.clone(),
                expected: n,
                missing: n - self.worlds().len(),
                first: world,
            });
        }
        let seal = self.complete.as_ref().map(|seal| seal.worlds[world].world_json_sha256.as_str());
        let record = read_world_record(&folder, seal)?;
        Ok(WorldReader { manifest: &self.manifest, folder, record })
    }

    /// Reads every file and compares it with its hash; errors at the first difference, when worlds are missing, and where there is a
    /// world or a file in one that no list names.
    pub fn verify(&self) -> Result<()> {
        self.faults().into_iter().next().map_or(Ok(()), Err)
    }

    /// All that [`Dataset::verify`] finds, of each world the first.
    pub fn faults(&self) -> Vec<DatasetError> {
        let n = self.manifest.n_worlds;
        let whole = self.check_scene().and_then(|()| self.check_folder());
        let worlds = (0..n).into_par_iter().map(|world| self.check_world(world));
        let worlds: Vec<Result<()>> = [whole].into_par_iter().chain(worlds).collect();
        let mut faults: Vec<DatasetError> = worlds.into_iter().filter_map(Result::err).collect();
        if self.complete.is_none() && self.worlds().len() == n {
            faults.insert(
                0,
                DatasetError::damaged(self.dir.join(COMPLETE), "the seal of the data set", "none"),
            );
        }
        // Each world that is not there says the same.
        let mut told = false;
        faults.retain(|fault| {
            !matches!(fault, DatasetError::Incomplete { .. }) || !std::mem::replace(&mut told, true)
        });
        faults
    }

    /// The compiled scene with the drones of the data set, from its `scene.mjb`; none in data sets without it, and in those that were flown
    /// without a scene.
    ///
    /// # Errors
    /// [`DatasetError::Damaged`] where the file is missing, is not that of the manifest, or is no scene of this version of MuJoCo.
    pub fn scene(&self) -> Result<Option<Scene>> {
        if self.manifest.scene.mjb_sha256.is_none() {
            return Ok(None);
        }
        self.check_scene()?;
        let path = self.dir.join(SCENE);
        let bytes = fs::read(&path).map_err(DatasetError::io(&path))?;
        let shells: Vec<String> = self.manifest.vehicles.iter().map(|v| v.shell.clone()).collect();
        let version = &self.manifest.mujoco_version;
        let scene = Scene::from_mjb(&self.manifest.scene.name, &bytes, &shells)
            .map_err(|e| DatasetError::damaged(&path, format!("a scene of MuJoCo {version}"), e))?;
        if scene.hash() != self.manifest.scene.sha256 {
            return Err(DatasetError::damaged(&path, "the scene whose hash the manifest has", "another"));
        }
        Ok(Some(scene))
    }

    fn check_scene(&self) -> Result<()> {
        let Some(wanted) = &self.manifest.scene.mjb_sha256 else { return Ok(()) };
        let path = self.dir.join(SCENE);
        if !path.is_file() {
            return Err(DatasetError::damaged(&path, "the compiled scene, which the manifest names", "none"));
        }
        let found = files::record(&self.dir, SCENE)?.sha256;
        if found == *wanted {
            return Ok(());
        }
        Err(DatasetError::damaged(&path, format!("sha256 {wanted}"), format!("sha256 {found}")))
    }

    /// Whether the worlds of the manifest are all that there are.
    fn check_folder(&self) -> Result<()> {
        let n = self.manifest.n_worlds;
        let ours: HashSet<String> = (0..n).map(world_dir_name).collect();
        let other = |name: &String| name.starts_with("world_") && !ours.contains(name);
        match list(&self.dir)?.into_iter().find(other) {
            Some(name) => {
                let expected = format!("{n} worlds, which the manifest names");
                Err(DatasetError::damaged(self.dir.join(name), expected, "another"))
            }
            None => Ok(()),
        }
    }

    fn check_world(&self, world: usize) -> Result<()> {
        let reader = self.world(world)?;
        let record = &reader.record;
        record.files.iter().try_for_each(|file| files::check(&reader.folder, file, true))?;
        let listed: HashSet<&str> =
            record.files.iter().map(|file| file.path.as_str()).chain([WORLD]).collect();
        match files::names(&reader.folder)?.into_iter().find(|name| !listed.contains(name.as_str())) {
            Some(name) => {
                let expected = format!("only files that {WORLD} names");
                Err(DatasetError::damaged(reader.folder.join(name), expected, "another"))
            }
            None => Ok(()),
        }
    }
}

/// One world of a data set.
#[derive(Clone, Debug)]
pub struct WorldReader<'a> {
    manifest: &'a Manifest,
    folder: PathBuf,
    record: WorldRecord,
}

impl WorldReader<'_> {
    /// Counts, notes and files.
    pub fn record(&self) -> &WorldRecord {
        &self.record
    }

    pub(super) fn manifest(&self) -> &Manifest {
        self.manifest
    }

    /// Path and hash of `states.parquet`.
    pub(super) fn states_file(&self) -> Result<(PathBuf, String)> {
        Ok((self.folder.join(STATES), self.listed(STATES)?.sha256.clone()))
    }

    fn listed(&self, name: &str) -> Result<&FileRecord> {
        self.record.files.iter().find(|file| file.path == name).ok_or_else(|| {
            DatasetError::damaged(self.folder.join(WORLD), format!("{name} in the list of files"), "no such")
        })
    }

    /// Path of a file, compared with its hash.
    fn file(&self, name: &str) -> Result<PathBuf> {
        files::check(&self.folder, self.listed(name)?, true)?;
        Ok(self.folder.join(name))
    }

    fn table(&self, name: &str, names: Option<&[&str]>, rows: u64) -> Result<Table> {
        let path = self.file(name)?;
        let table = Table::read(&path, names)?;
        if table.n_rows() as u64 != rows {
            return Err(DatasetError::damaged(&path, format!("{rows} rows"), table.n_rows()));
        }
        Ok(table)
    }

    /// `states.parquet`: the named columns, or all.
    pub fn states(&self, names: Option<&[&str]>) -> Result<Table> {
        self.table(STATES, names, self.record.n_states)
    }

    /// `contacts.parquet`: the named columns, or all.
    pub fn contacts(&self, names: Option<&[&str]>) -> Result<Table> {
        self.table(CONTACTS, names, self.record.n_contacts)
    }

    /// `clearance.parquet`: the named columns, or all.
    pub fn clearance(&self, names: Option<&[&str]>) -> Result<Table> {
        self.table(CLEARANCE, names, self.record.n_clearances)
    }

    /// `frames.npz`, with shapes checked against the manifest.
    pub fn frames(&self) -> Result<Frames> {
        let Some(camera) = self.manifest.cameras.first() else {
            let path = self.folder.join(FRAMES);
            return Err(DatasetError::damaged(&path, "a data set with cameras", "one without"));
        };
        let path = self.file(FRAMES)?;
        let file = File::open(&path).map_err(DatasetError::io(&path))?;
        let mut npz = NpzReader::new(BufReader::new(file))
            .map_err(|e| DatasetError::damaged(&path, "a whole npz file", e))?;
        let f = usize::try_from(self.record.n_frames).unwrap_or(usize::MAX);
        let (d, h, w) = (self.manifest.n_drones, camera.height, camera.width);
        let (noisy, o) = (self.manifest.noise.is_some(), self.manifest.obstacles.len());
        Ok(Frames {
            time_s: array(&mut npz, &path, "time_s", &[f])?,
            step: array(&mut npz, &path, "step", &[f])?,
            camera_pos_m: array(&mut npz, &path, "camera_pos_m", &[f, d, 3])?,
            camera_quat_xyzw: array(&mut npz, &path, "camera_quat_xyzw", &[f, d, 4])?,
            depth_m: array(&mut npz, &path, "depth_m", &[f, d, h, w])?,
            status: array(&mut npz, &path, "status", &[f, d, h, w])?,
            geom_id: array(&mut npz, &path, "geom_id", &[f, d, h, w])?,
            body_id: array(&mut npz, &path, "body_id", &[f, d, h, w])?,
            normal: self
                .manifest
                .normals
                .then(|| array(&mut npz, &path, "normal", &[f, d, h, w, 3]))
                .transpose()?,
            depth_noisy_m: noisy
                .then(|| array(&mut npz, &path, "depth_noisy_m", &[f, d, h, w]))
                .transpose()?,
            status_noisy: noisy.then(|| array(&mut npz, &path, "status_noisy", &[f, d, h, w])).transpose()?,
            obstacle_pos_m: (o > 0)
                .then(|| array(&mut npz, &path, "obstacle_pos_m", &[f, o, 3]))
                .transpose()?,
            obstacle_quat_xyzw: (o > 0)
                .then(|| array(&mut npz, &path, "obstacle_quat_xyzw", &[f, o, 4]))
                .transpose()?,
        })
    }

    /// Samples of the sensor of this name, with shapes checked against the manifest.
    pub fn sensor(&self, name: &str) -> Result<SensorSamples> {
        let Some(sensor) = self.manifest.sensors.iter().find(|s| s.name == name) else {
            let names: Vec<&str> = self.manifest.sensors.iter().map(|s| s.name.as_str()).collect();
            let expected = format!("one of the sensors {names:?}");
            return Err(DatasetError::damaged(&self.folder, expected, format!("{name:?}")));
        };
        let path = self.file(&sensor.file())?;
        let file = File::open(&path).map_err(DatasetError::io(&path))?;
        let mut npz = NpzReader::new(BufReader::new(file))
            .map_err(|e| DatasetError::damaged(&path, "a whole npz file", e))?;
        let step: Array1<i64> = npz
            .by_name("step")
            .map_err(|e| DatasetError::damaged(&path, "array step of the manifest's type", e))?;
        let n = step.len();
        let mut channels = BTreeMap::new();
        for channel in &sensor.channels {
            let shape = [&[n, self.manifest.n_drones], &channel.shape[..]].concat();
            let name = &*channel.name;
            let values: ArrayD<f32> = match channel.kind {
                ChannelType::F32 => array(&mut npz, &path, name, &shape)?,
                ChannelType::I32 => array::<i32, _>(&mut npz, &path, name, &shape)?.mapv(|v| v as f32),
                ChannelType::U8 => array::<u8, _>(&mut npz, &path, name, &shape)?.mapv(f32::from),
            };
            channels.insert(name.to_owned(), values);
        }
        Ok(SensorSamples { time_s: array(&mut npz, &path, "time_s", &[n])?, step, channels })
    }

    /// Values of a 16-bit depth image, shape `(row, column)`; `noisy` for the image with sensor noise.
    pub fn image(&self, drone: usize, frame: usize, noisy: bool) -> Result<Vec<u16>> {
        let folder = if noisy { "depth_noisy" } else { "depth" };
        let path = self.file(&format!("{folder}/drone{drone}_{frame:06}.png"))?;
        let (width, height, values) = depth_png::read(&path)?;
        let camera = self.manifest.cameras.first().map_or((0, 0), |c| (c.width, c.height));
        if (width, height) != camera {
            let expected = format!("{}x{} pixels", camera.0, camera.1);
            return Err(DatasetError::damaged(&path, expected, format!("{width}x{height}")));
        }
        Ok(values)
    }
}

/// All samples of one sensor in one world.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorSamples {
    /// Seconds since the start, shape `(sample,)`.
    pub time_s: Array1<f64>,
    /// Simulation steps, shape `(sample,)`.
    pub step: Array1<i64>,
    /// By channel, shape `(sample, drone, …)`; whole numbers as f32.
    pub channels: BTreeMap<String, ArrayD<f32>>,
}

/// An array of an npz file with the wanted shape.
fn array<T: ReadableElement, D: Dimension>(
    npz: &mut NpzReader<BufReader<File>>,
    path: &Path,
    name: &str,
    shape: &[usize],
) -> Result<ndarray::Array<T, D>> {
    let array: ndarray::Array<T, D> = npz
        .by_name(name)
        .map_err(|e| DatasetError::damaged(path, format!("array {name} of the manifest's type"), e))?;
    if array.shape() != shape {
        return Err(DatasetError::damaged(
            path,
            format!("array {name} of shape {shape:?}"),
            format!("{:?}", array.shape()),
        ));
    }
    Ok(array)
}
