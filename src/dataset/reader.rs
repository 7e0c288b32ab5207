//! Reads a data set.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, BufReader};
use std::path::{Path, PathBuf};

use ndarray::{Array1, Array3, Array4, Array5, ArrayD, Dimension};
use ndarray_npy::{NpzReader, ReadableElement};
use rayon::prelude::*;

use super::depth_png;
use super::error::{DatasetError, Result};
use super::files;
use super::manifest::Manifest;
use super::table::Table;
use super::writer::{
    CLEARANCE, COMPLETE, CONTACTS, CompleteRecord, FRAMES, MANIFEST, SCENE, STATES, WORLD, WorldRecord,
    Writer, create_or_resume, read_world_record, world_dir_name,
};
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
        let path = dir.join(COMPLETE);
        let complete = match fs::read_to_string(&path) {
            Ok(seal) => {
                let record: CompleteRecord = serde_json::from_str(&seal)
                    .map_err(|e| DatasetError::damaged(&path, "the fields of docs/formats.md", e))?;
                let found = files::sha256(text.as_bytes());
                if record.manifest_sha256 != found {
                    let expected = format!("sha256 {} (from {COMPLETE})", record.manifest_sha256);
                    return Err(DatasetError::damaged(
                        dir.join(MANIFEST),
                        expected,
                        format!("sha256 {found}"),
                    ));
                }
                if record.worlds.len() != manifest.n_worlds {
                    let expected = format!("{} worlds", manifest.n_worlds);
                    return Err(DatasetError::damaged(&path, expected, record.worlds.len()));
                }
                Some(record)
            }
            Err(e) if e.kind() == io::ErrorKind::NotFound => None,
            Err(source) => return Err(DatasetError::Io { path, source }),
        };
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
        let record = read_world_record(&folder)?;
        Ok(WorldReader { manifest: &self.manifest, folder, record })
    }

    /// Reads every file and compares it with its hash; errors at the first difference, or when worlds are missing.
    pub fn verify(&self) -> Result<()> {
        let Some(complete) = &self.complete else {
            let have = self.worlds();
            let n = self.manifest.n_worlds;
            let first = (0..n).find(|w| !have.contains(w)).unwrap_or(0);
            if have.len() == n {
                return Err(DatasetError::damaged(
                    self.dir.join(COMPLETE),
                    "the seal of the data set",
                    "none",
                ));
            }
            let path = self.dir.clone();
            return Err(DatasetError::Incomplete { path, expected: n, missing: n - have.len(), first });
        };
        if let Some(wanted) = &self.manifest.scene.mjb_sha256 {
            let path = self.dir.join(SCENE);
            if !path.is_file() {
                return Err(DatasetError::damaged(
                    &path,
                    "the compiled scene, which the manifest names",
                    "none",
                ));
            }
            let found = files::record(&self.dir, SCENE)?.sha256;
            if found != *wanted {
                return Err(DatasetError::damaged(
                    &path,
                    format!("sha256 {wanted}"),
                    format!("sha256 {found}"),
                ));
            }
        }
        complete.worlds.par_iter().enumerate().try_for_each(|(world, seal)| {
            let folder = self.dir.join(&seal.dir);
            let found = files::record(&folder, WORLD)?.sha256;
            if found != seal.world_json_sha256 {
                let expected = format!("sha256 {} (from {COMPLETE})", seal.world_json_sha256);
                return Err(DatasetError::damaged(folder.join(WORLD), expected, format!("sha256 {found}")));
            }
            let reader = self.world(world)?;
            reader.record.files.iter().try_for_each(|file| files::check(&reader.folder, file, true))
        })
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
        Ok((self.folder.join(STATES), files::record(&self.folder, STATES)?.sha256))
    }

    fn table(&self, name: &str, names: Option<&[&str]>, rows: u64) -> Result<Table> {
        let path = self.folder.join(name);
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
        let path = self.folder.join(FRAMES);
        let Some(camera) = self.manifest.cameras.first() else {
            return Err(DatasetError::damaged(&path, "a data set with cameras", "one without"));
        };
        let file = File::open(&path).map_err(DatasetError::io(&path))?;
        let mut npz = NpzReader::new(BufReader::new(file))
            .map_err(|e| DatasetError::damaged(&path, "a whole npz file", e))?;
        let f = usize::try_from(self.record.n_frames).unwrap_or(usize::MAX);
        let (d, h, w) = (self.manifest.n_drones, camera.height, camera.width);
        let noisy = self.manifest.noise.is_some();
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
        })
    }

    /// Samples of the sensor of this name, with shapes checked against the manifest.
    pub fn sensor(&self, name: &str) -> Result<SensorSamples> {
        let Some(sensor) = self.manifest.sensors.iter().find(|s| s.name == name) else {
            let names: Vec<&str> = self.manifest.sensors.iter().map(|s| s.name.as_str()).collect();
            let expected = format!("one of the sensors {names:?}");
            return Err(DatasetError::damaged(&self.folder, expected, format!("{name:?}")));
        };
        let path = self.folder.join(sensor.file());
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
        let path = self.folder.join(format!("{folder}/drone{drone}_{frame:06}.png"));
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
