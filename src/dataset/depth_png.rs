//! 16-bit depth images.

use std::fs;
use std::io::Write;
use std::path::Path;

use crate::picture::{PictureError, grey16_png, read_grey16};

use super::error::{DatasetError, Result};
use crate::flight::files;

/// Value of a ray that hits nothing.
pub const MISS: u16 = 0;
/// Value of a hit beyond the camera's range.
pub const TOO_FAR: u16 = 65_535;
/// Value of a hit before the camera's range.
pub const TOO_NEAR: u16 = 65_534;
/// Largest value that is a distance.
pub const MAX_DISTANCE: u16 = 65_533;

/// Pixel statuses, as in the `status` plane.
pub mod status {
    /// A hit inside the camera's range.
    pub const HIT: u8 = 0;
    /// Nothing on the ray.
    pub const MISS: u8 = 1;
    /// A hit beyond the camera's range.
    pub const TOO_FAR: u8 = 2;
    /// A hit before the camera's range.
    pub const TOO_NEAR: u8 = 3;
}

/// The image value of a pixel: `round(depth / unit)` for a hit (halves to even), a code otherwise.
/// `None` where a hit has no value between 1 and [`MAX_DISTANCE`], or the status is unknown.
pub fn encode(depth_m: f32, pixel_status: u8, metres_per_unit: f64) -> Option<u16> {
    match pixel_status {
        status::MISS => Some(MISS),
        status::TOO_FAR => Some(TOO_FAR),
        status::TOO_NEAR => Some(TOO_NEAR),
        status::HIT => {
            let value = (f64::from(depth_m) / metres_per_unit).round_ties_even();
            // NaN fails both comparisons.
            (value >= 1.0 && value <= f64::from(MAX_DISTANCE)).then_some(value as u16)
        }
        _ => None,
    }
}

/// The inverse of [`encode`]: depth in metres (+inf for a miss or too far, 0 for too near) and status.
pub fn decode(value: u16, metres_per_unit: f64) -> (f32, u8) {
    match value {
        MISS => (f32::INFINITY, status::MISS),
        TOO_FAR => (f32::INFINITY, status::TOO_FAR),
        TOO_NEAR => (0.0, status::TOO_NEAR),
        v => ((f64::from(v) * metres_per_unit) as f32, status::HIT),
    }
}

/// Writes a depth image: metres and pixel statuses, row major.
pub fn write_depth(
    path: &Path,
    (width, height): (usize, usize),
    depth_m: &[f32],
    statuses: &[u8],
    metres_per_unit: f64,
) -> Result<()> {
    let mut values = Vec::with_capacity(depth_m.len());
    for (i, (depth, status)) in depth_m.iter().zip(statuses).enumerate() {
        values.push(encode(*depth, *status, metres_per_unit).ok_or_else(|| {
            let found = format!("depth {depth} m with status {status} in pixel {i}");
            DatasetError::damaged(path, "depths that 16 bits hold", found)
        })?);
    }
    let bytes = image(path, width, height, &values)?;
    files::write(path, true, |file| file.write_all(&bytes)).map_err(DatasetError::io(path))
}

/// Writes a 16-bit grey image, row major.
pub(super) fn write(path: &Path, width: usize, height: usize, values: &[u16]) -> Result<()> {
    fs::write(path, image(path, width, height, values)?).map_err(DatasetError::io(path))
}

/// A 16-bit grey image as PNG; `path` is named in errors.
fn image(path: &Path, width: usize, height: usize, values: &[u16]) -> Result<Vec<u8>> {
    grey16_png(width as u32, height as u32, values)
        .map_err(|error| DatasetError::damaged(path, "an image that PNG can hold", error))
}

/// Reads a 16-bit grey image: width, height, values row major.
pub fn read(path: &Path) -> Result<(usize, usize, Vec<u16>)> {
    let bytes = fs::read(path).map_err(DatasetError::io(path))?;
    let image = read_grey16(&bytes).map_err(|error| match error {
        PictureError::Kind { expected, found } => DatasetError::damaged(path, expected, found),
        PictureError::Png(error) => DatasetError::damaged(path, "a whole PNG image", error),
        other => DatasetError::damaged(path, "16-bit grey", other),
    })?;
    Ok((image.width, image.height, image.values))
}
