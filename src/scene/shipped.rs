//! Scenes that come with the crate, by name: an installation needs no files of them.

use super::SceneError;
use crate::names::nearest;
use mujoco_rs::wrappers::mj_auxiliary::MjVfs;
use std::path::{Path, PathBuf};

macro_rules! shipped {
    (scenes: $($name:literal,)* assets: $($asset:literal,)*) => {
        /// Names of the scenes in `xml/`.
        pub const SCENES: &[&str] = &[$($name),*];

        fn text(name: &str) -> Option<&'static str> {
            match name {
                $($name => Some(include_str!(concat!("../../xml/", $name, ".xml"))),)*
                _ => None,
            }
        }

        /// What the scenes read from `assets/`, by file name.
        const ASSETS: &[(&str, &[u8])] = &[$(($asset, include_bytes!(concat!("../../assets/", $asset)))),*];
    };
}

shipped! {
    scenes: "corridor", "forest", "meshes", "room", "terrain", "zoo",
    assets: "arch.obj", "bowl.obj", "cone.obj", "knot.obj", "rock.obj", "star.obj", "stone.png", "terrain.png", "torus.obj",
            "window.obj",
}

/// A scene that comes with the crate.
pub(super) struct Shipped {
    /// The path that it has in `files`.
    pub path: PathBuf,
    /// It and what it reads, as files in memory.
    pub files: MjVfs,
}

/// The scene that `path` names, if it is a name and not a file: a word without a folder and without an ending.
///
/// # Errors
/// [`SceneError::NoSuchScene`] for a name that no scene has.
pub(super) fn find(path: &Path) -> Result<Option<Shipped>, SceneError> {
    let Some(name) = name_in(path) else { return Ok(None) };
    let Some(text) = text(name) else {
        if path.exists() {
            return Ok(None);
        }
        let guess = nearest(name, SCENES.iter().copied());
        return Err(SceneError::NoSuchScene {
            name: name.into(),
            guess: guess.map_or_else(String::new, |guess| format!(" did you mean '{guess}'?")),
            known: SCENES.join(", "),
        });
    };
    // The folders of the checkout, under a root that no file of a user lies in.
    let root = Path::new("propwash-shipped");
    let path = root.join("xml").join(format!("{name}.xml"));
    let mut files = MjVfs::new();
    let assets = ASSETS.iter().map(|(asset, bytes)| (root.join("assets").join(asset), *bytes));
    for (at, bytes) in assets.chain([(path.clone(), text.as_bytes())]) {
        files
            .add_from_buffer(&at, bytes)
            .map_err(|e| SceneError::Parse { what: format!("scene {name}"), message: e.to_string() })?;
    }
    Ok(Some(Shipped { path, files }))
}

/// The name that a path is, where there is no such file.
fn name_in(path: &Path) -> Option<&str> {
    let text = path.to_str()?;
    let is_name = !text.is_empty() && !text.contains(['/', '\\', '.']);
    (is_name && !path.is_file()).then_some(text)
}

#[cfg(test)]
mod tests {
    use super::super::{Scene, SceneSource, Shell};
    use super::*;
    use std::collections::BTreeSet;

    /// File names in a folder of the checkout with one of these endings.
    fn files(folder: &str, endings: &[&str]) -> BTreeSet<String> {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
        let names = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap());
        names.filter(|n| n.rsplit_once('.').is_some_and(|(_, e)| endings.contains(&e))).collect()
    }

    #[test]
    fn every_scene_and_asset_of_the_checkout_is_shipped() {
        let scenes: BTreeSet<String> = SCENES.iter().map(|n| format!("{n}.xml")).collect();
        assert_eq!(scenes, files("xml", &["xml"]));
        let assets: BTreeSet<String> = ASSETS.iter().map(|(n, _)| n.to_string()).collect();
        assert_eq!(assets, files("assets", &["obj", "png"]));
    }

    #[test]
    fn a_scene_by_name_is_the_file_of_the_checkout() {
        let shells = [Shell::builtin("cf2x").unwrap()];
        for name in SCENES {
            let by_name = Scene::build(&SceneSource::file(name), &shells).unwrap();
            let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("xml").join(format!("{name}.xml"));
            let by_file = Scene::build(&SceneSource::file(file), &shells).unwrap();
            assert_eq!(by_name.hash(), by_file.hash(), "{name}");
            assert_eq!(by_name.name(), format!("scene {name}"));
            assert_eq!(by_name.warnings(), by_file.warnings());
        }
    }

    #[test]
    fn a_scene_is_the_same_whatever_was_built_before() {
        // A copy, of whose meshes MuJoCo remembers nothing from other tests; both scenes read the same ones.
        let folder = tempfile::tempdir().unwrap();
        for name in ["xml", "assets"] {
            std::fs::create_dir(folder.path().join(name)).unwrap();
        }
        for (name, bytes) in ASSETS {
            std::fs::write(folder.path().join("assets").join(name), bytes).unwrap();
        }
        let build = |name: &str| {
            let file = folder.path().join("xml").join(format!("{name}.xml"));
            std::fs::write(&file, text(name).unwrap()).unwrap();
            Scene::build(&SceneSource::file(file), &[]).unwrap().hash()
        };
        build("meshes");
        assert_eq!(build("zoo"), Scene::build(&SceneSource::file("zoo"), &[]).unwrap().hash());
    }

    #[test]
    fn other_names_are_refused_with_those_that_there_are() {
        let error = |name: &str| Scene::build(&SceneSource::file(name), &[]).unwrap_err().to_string();
        let text = error("forrest");
        assert!(
            text.contains("did you mean 'forest'?") && text.contains("corridor, forest, meshes"),
            "{text}"
        );
        assert!(!error("warehouse").contains("did you mean"));
        for path in ["forest.xml", "./forest", "absent/forest", ""] {
            let found = Scene::build(&SceneSource::file(path), &[]).unwrap_err();
            assert!(matches!(found, SceneError::Read { .. }), "{path}: {found}");
        }
        // A folder of the same name is no scene.
        assert!(find(Path::new("src")).unwrap().is_none());
    }
}
