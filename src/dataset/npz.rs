//! Arrays in an npz file, collected frame by frame without holding them in memory.
//!
//! An npy file starts with its shape, which is known only after the last frame; so each array first goes to a file of
//! its own, and at the end all are packed.

use std::fs::{self, File};
use std::io::{self, BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

use super::error::{DatasetError, Result};

/// One array whose first axis grows.
pub(super) struct Spool {
    name: String,
    /// Type in numpy's spelling, e.g. `<f4`.
    descr: &'static str,
    /// Shape without the first axis.
    tail: Vec<usize>,
    path: PathBuf,
    file: BufWriter<File>,
}

impl Spool {
    /// `group` keeps apart the files of arrays that have one name in several npz files.
    pub fn create(
        folder: &Path,
        group: &str,
        name: &str,
        descr: &'static str,
        tail: &[usize],
    ) -> Result<Self> {
        let path = folder.join(format!("spool_{group}_{name}"));
        let file = File::create(&path).map_err(DatasetError::io(&path))?;
        let (name, tail) = (name.to_owned(), tail.to_vec());
        Ok(Self { name, descr, tail, path, file: BufWriter::with_capacity(1 << 16, file) })
    }

    /// Appends little-endian numbers.
    pub fn push<const N: usize>(&mut self, numbers: impl Iterator<Item = [u8; N]>) -> Result<()> {
        let write = || -> io::Result<()> {
            for bytes in numbers {
                self.file.write_all(&bytes)?;
            }
            Ok(())
        };
        write().map_err(DatasetError::io(&self.path))
    }

    /// Appends bytes.
    pub fn push_bytes(&mut self, bytes: &[u8]) -> Result<()> {
        self.file.write_all(bytes).map_err(DatasetError::io(&self.path))
    }
}

/// Head of an npy file, version 1.0, C order (numpy documentation, "NPY format"): magic, length, a Python literal padded
/// with blanks so that the data starts at a multiple of 64.
fn npy_head(descr: &str, shape: &[usize]) -> Vec<u8> {
    let sizes: Vec<String> = shape.iter().map(usize::to_string).collect();
    let comma = if shape.len() == 1 { "," } else { "" };
    let mut text =
        format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({}{comma}), }}", sizes.join(", "));
    let used = 10 + text.len() + 1;
    text.push_str(&" ".repeat(used.next_multiple_of(64) - used));
    text.push('\n');
    let mut head = b"\x93NUMPY\x01\x00".to_vec();
    head.extend((text.len() as u16).to_le_bytes());
    head.extend(text.as_bytes());
    head
}

/// Packs the arrays with `n` entries on their first axis into `path` and removes their files.
pub(super) fn pack(path: &Path, n: usize, spools: Vec<Spool>) -> Result<()> {
    let file = File::create(path).map_err(DatasetError::io(path))?;
    let mut zip = ZipWriter::new(BufWriter::with_capacity(1 << 16, file));
    let broken = |error: zip::result::ZipError| DatasetError::Io {
        path: path.to_path_buf(),
        source: io::Error::other(error),
    };
    for spool in spools {
        let Spool { name, descr, tail, path: from, file } = spool;
        let file = file.into_inner().map_err(|e| DatasetError::io(&from)(e.into_error()))?;
        drop(file);
        let file = File::open(&from).map_err(DatasetError::io(&from))?;
        let size = file.metadata().map_err(DatasetError::io(&from))?.len();
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Deflated)
            .compression_level(Some(1))
            .last_modified_time(DateTime::default()) // 1980-01-01: no clock in the bytes
            .unix_permissions(0o644)
            .large_file(size > 1 << 30);
        zip.start_file(format!("{name}.npy"), options).map_err(broken)?;
        let shape: Vec<usize> = std::iter::once(n).chain(tail).collect();
        zip.write_all(&npy_head(descr, &shape)).map_err(DatasetError::io(path))?;
        io::copy(&mut BufReader::with_capacity(1 << 16, file), &mut zip).map_err(DatasetError::io(path))?;
        fs::remove_file(&from).map_err(DatasetError::io(&from))?;
    }
    let mut file = zip.finish().map_err(broken)?;
    file.flush().map_err(DatasetError::io(path))
}
