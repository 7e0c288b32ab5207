//! PNG in and out.

use std::io::Cursor;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{DynamicImage, ImageBuffer, ImageFormat, ImageReader, Luma, Rgb};

use super::PictureError;

/// How hard an encoder tries to write few bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effort {
    /// For pictures that are made in a moment.
    Balanced,
    /// For pictures that are stored for long.
    Best,
}

/// A 16-bit grey picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Grey16 {
    /// Pixels of a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Shape `(row, column)`.
    pub values: Vec<u16>,
}

/// A colour picture as PNG; `rgb` of shape `(row, column, 3)`.
///
/// # Errors
/// [`PictureError::Size`] where the length is not that of the size.
pub fn rgb_png(width: u32, height: u32, rgb: &[u8], effort: Effort) -> Result<Vec<u8>, PictureError> {
    let picture = ImageBuffer::<Rgb<u8>, &[u8]>::from_raw(width, height, rgb);
    let picture = picture.ok_or(PictureError::Size { width, height })?;
    let compression = match effort {
        Effort::Balanced => CompressionType::Default,
        Effort::Best => CompressionType::Best,
    };
    let mut out = Vec::new();
    let encoder = PngEncoder::new_with_quality(&mut out, compression, FilterType::Adaptive);
    picture.write_with_encoder(encoder)?;
    Ok(out)
}

/// A 16-bit grey picture as PNG, quickly: rows as differences to the row above, lightly compressed.
///
/// # Errors
/// [`PictureError::Size`] where the length is not that of the size.
pub fn grey16_png(width: u32, height: u32, values: &[u16]) -> Result<Vec<u8>, PictureError> {
    let picture = ImageBuffer::<Luma<u16>, &[u16]>::from_raw(width, height, values);
    let picture = picture.ok_or(PictureError::Size { width, height })?;
    let mut out = Vec::new();
    picture.write_with_encoder(PngEncoder::new_with_quality(
        &mut out,
        CompressionType::Fast,
        FilterType::Up,
    ))?;
    Ok(out)
}

/// Reads a 16-bit grey PNG of at most 512 MiB.
///
/// # Errors
/// [`PictureError::Png`] for a damaged file, [`PictureError::Kind`] for a picture of another kind.
pub fn read_grey16(png: &[u8]) -> Result<Grey16, PictureError> {
    match ImageReader::with_format(Cursor::new(png), ImageFormat::Png).decode()? {
        DynamicImage::ImageLuma16(picture) => Ok(Grey16 {
            width: picture.width() as usize,
            height: picture.height() as usize,
            values: picture.into_raw(),
        }),
        other => Err(PictureError::Kind { expected: "16-bit grey", found: format!("{:?}", other.color()) }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grey_pictures_come_back_as_they_were_written() {
        let values: Vec<u16> = (0..12u16).map(|i| i.wrapping_mul(24_571)).collect();
        let png = grey16_png(4, 3, &values).unwrap();
        assert_eq!(read_grey16(&png).unwrap(), Grey16 { width: 4, height: 3, values });
        assert!(matches!(grey16_png(4, 3, &[0; 5]), Err(PictureError::Size { width: 4, height: 3 })));
    }

    #[test]
    fn other_pictures_and_damaged_ones_are_refused_in_words() {
        let colour = rgb_png(2, 1, &[1, 2, 3, 4, 5, 6], Effort::Balanced).unwrap();
        let said = read_grey16(&colour).unwrap_err().to_string();
        assert_eq!(said, "expected 16-bit grey, found Rgb8; convert the file");
        let mut png = grey16_png(64, 64, &(0..4096).collect::<Vec<u16>>()).unwrap();
        png.truncate(200);
        assert!(read_grey16(&png).unwrap_err().to_string().starts_with("expected a whole PNG image: "));
    }

    #[test]
    fn a_picture_that_claims_to_be_vast_is_not_read() {
        let mut png = grey16_png(1, 1, &[7]).unwrap();
        // Width and height of the header, and its check sum over type and data.
        png[16..24].copy_from_slice(&[0, 1, 0, 0, 0, 1, 0, 0]);
        let crc = png[12..29].iter().fold(!0u32, |crc, byte| {
            (0..8).fold(crc ^ u32::from(*byte), |c, _| if c & 1 == 1 { c >> 1 ^ 0xEDB8_8320 } else { c >> 1 })
        });
        png[29..33].copy_from_slice(&(!crc).to_be_bytes());
        let said = read_grey16(&png).unwrap_err().to_string();
        assert!(said.contains("imit"), "{said}");
    }
}
