//! The commands, each short.

pub mod add;
pub mod bench;
pub mod compare;
pub mod depth;
pub mod diagnose;
pub mod drones;
pub mod excite;
pub mod fly;
pub mod identify;
pub mod log;
pub mod remove;
mod report;
pub mod scene;
pub mod urdf;
pub mod vehicle;

use crate::cli::args::{CameraArgs, CasterArg, KindArg};
use crate::dataset::MAX_DISTANCE;
use crate::sense::{Camera, Caster, DepthKind, Lens};
use crate::{Error, Result};
use std::path::Path;

/// An error of reading or writing `path`.
fn io_error(path: &Path) -> impl FnOnce(std::io::Error) -> Error + '_ {
    move |source| Error::Io { path: path.to_path_buf(), source }
}

/// Prints a line to standard output; a closed pipe becomes an error that ends the program quietly.
fn print(text: impl std::fmt::Display) -> Result<()> {
    use std::io::Write;
    writeln!(std::io::stdout(), "{text}").map_err(io_error(Path::new("standard output")))
}

/// Prints a value as JSON.
fn print_json(value: &serde_json::Value) -> Result<()> {
    print(format_args!("{value:#}"))
}

/// A camera with the settings of the command line, whose range fits 16 bits of millimetres.
fn adjust(camera: Camera, args: &CameraArgs) -> Result<Camera> {
    let farthest = f64::from(MAX_DISTANCE) * 0.001;
    if args.near < 0.001 || args.near >= args.far || args.far > farthest {
        return Err(Error::Usage {
            flag: "--near, --far",
            expected: format!(
                "0.001 m <= near < far <= {farthest} m, which is what 16-bit images of millimetres hold"
            ),
            got: format!("{} m, {} m", args.near, args.far),
        });
    }
    let mut groups = [false; 6];
    for group in &args.groups {
        let Some(seen) = groups.get_mut(usize::from(*group)) else {
            return Err(Error::Usage {
                flag: "--groups",
                expected: "MuJoCo's geom groups 0 to 5, such as 0,1,2".into(),
                got: group.to_string(),
            });
        };
        *seen = true;
    }
    let kind = match args.depth {
        KindArg::Range => DepthKind::Range,
        KindArg::Z => DepthKind::ZDepth,
    };
    let caster = match args.caster {
        CasterArg::Native => Caster::Native,
        CasterArg::Mujoco => Caster::MuJoCo,
    };
    let mut camera = camera
        .with_size(args.size.width, args.size.height)?
        .with_kind(kind)
        .with_groups(groups)
        .with_caster(caster);
    if let Some(fovy_deg) = args.fovy {
        camera = camera.with_lens(Lens::Fovy { fovy_deg })?;
    }
    Ok(camera.with_range(args.near, args.far)?)
}
