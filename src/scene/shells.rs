//! Shells that come with the crate: what other things see and touch of a vehicle.

use super::{SceneError, Shell};
use std::path::Path;

/// Names of the shells in `xml/shells`.
pub const SHELLS: &[&str] = &["cf2x", "cf21B", "hb_x500"];

impl Shell {
    /// The shell called `name` that comes with the crate; see [`SHELLS`].
    ///
    /// # Errors
    /// [`SceneError::NoSuchName`] for any other name.
    pub fn builtin(name: &str) -> Result<Self, SceneError> {
        let xml = match name {
            "cf2x" => include_str!("../../xml/shells/cf2x.xml"),
            "cf21B" => include_str!("../../xml/shells/cf21B.xml"),
            "hb_x500" => include_str!("../../xml/shells/hb_x500.xml"),
            _ => {
                return Err(SceneError::NoSuchName {
                    what: "built-in shell",
                    name: name.into(),
                    scene: "this version of Propwash".into(),
                    known: SHELLS.join(", "),
                });
            }
        };
        Ok(Self { name: name.into(), xml: xml.into(), dir: None })
    }

    /// A shell from an MJCF file; its assets are looked up beside it.
    ///
    /// # Errors
    /// [`SceneError::Read`] when the file cannot be read.
    pub fn load(path: &Path) -> Result<Self, SceneError> {
        let xml = std::fs::read_to_string(path)
            .map_err(|source| SceneError::Read { path: path.to_path_buf(), source })?;
        let name = path.file_stem().map_or_else(|| "shell".into(), |s| s.to_string_lossy().into_owned());
        Ok(Self { name, xml, dir: path.parent().map(Path::to_path_buf) })
    }
}
