//! Pictures: a [`Canvas`] for shapes and text in one font, colours by perception, and PNG in and out.

#![forbid(unsafe_code)]

mod axis;
mod canvas;
mod color;
mod file;
mod glyphs;

pub use axis::{round_up, tick_label, ticks};
pub use canvas::{Anchor, Canvas};
pub use color::oklch;
pub use file::{Effort, Grey16, grey16_png, read_grey16, rgb_png};

/// Red, green, blue, sRGB.
pub type Ink = [u8; 3];

/// What can go wrong with a picture.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PictureError {
    /// There is no picture of that size.
    #[error(
        "expected a picture of 1 × 1 pixels or more that fits in memory, found {width} × {height}; choose another size"
    )]
    Size {
        /// Pixels of a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// A picture of another kind than is read here.
    #[error("expected {expected}, found {found}; convert the file")]
    Kind {
        /// What can be read.
        expected: &'static str,
        /// What the file holds.
        found: String,
    },
    /// A file that is damaged or no PNG, or a picture that PNG cannot hold.
    #[error("expected a whole PNG image: {0}")]
    Png(#[from] image::ImageError),
    /// The font that comes with Propwash could not be read.
    #[error("the built-in font: {0}")]
    Font(#[from] ttf_parser::FaceParsingError),
}
