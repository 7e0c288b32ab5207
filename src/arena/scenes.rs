//! The scenes that worlds are in, as a description names them.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::ArenaError;
use crate::scene::SceneSource;
use crate::scene::generate::{
    self, BoxesOptions, CorridorOptions, ForestOptions, RoomsOptions, TrackOptions,
};

/// Where worlds are.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SceneConfig {
    /// No scene: nothing is seen or touched; environments have ground at height zero.
    None,
    /// Each of these files is a scene (MJCF, or URDF), by its path from the current folder.
    Files(Vec<PathBuf>),
    /// One scene, as MJCF text.
    Xml(String),
    /// The scenes of each of these.
    Each(Vec<SceneConfig>),
    /// Generated forests.
    Forest(ForestOptions),
    /// Generated corridors.
    Corridor(CorridorOptions),
    /// Generated clutter.
    Boxes(BoxesOptions),
    /// Generated race tracks.
    Track(TrackOptions),
    /// Generated rooms.
    Rooms(RoomsOptions),
}

/// Most layouts: each takes memory of its own for each thread.
const MOST_LAYOUTS: usize = 4096;

impl SceneConfig {
    /// The scenes: `layouts` of one that is generated (one where there is none), which differ in their seeds alone; those count up from
    /// that of the options.
    ///
    /// # Errors
    /// [`ArenaError::Option`] for a number of scenes that is not that of those given, and [`ArenaError::Generate`].
    pub fn sources(&self, layouts: Option<usize>) -> Result<Vec<SceneSource>, ArenaError> {
        fn each<T: Clone>(
            n: usize,
            options: &T,
            name: &str,
            seed: impl Fn(&mut T) -> &mut u64,
            make: impl Fn(&T) -> Result<String, generate::GenerateError>,
        ) -> Result<Vec<SceneSource>, ArenaError> {
            (0..n as u64)
                .map(|i| {
                    let mut options = options.clone();
                    let seed = seed(&mut options);
                    *seed = seed.wrapping_add(i);
                    let name = format!("{name} of seed {seed}");
                    Ok(SceneSource::text(name, make(&options)?))
                })
                .collect()
        }
        let n = layouts.unwrap_or(1);
        let given = match self {
            Self::None => Some(0),
            Self::Xml(_) => Some(1),
            Self::Files(files) => Some(files.len()),
            Self::Each(each) => Some(each.len()),
            _ => None,
        };
        if let (Some(given), Some(n)) = (given, layouts)
            && given != n
        {
            return Err(ArenaError::option("layouts", format!("{given}, as many as scenes are given"), n));
        }
        if !(1..=MOST_LAYOUTS).contains(&given.unwrap_or(n)) && *self != Self::None {
            let got = given.unwrap_or(n);
            return Err(ArenaError::option("layouts", format!("1 to {MOST_LAYOUTS} scenes"), got));
        }
        match self {
            Self::None => Ok(Vec::new()),
            Self::Files(files) => Ok(files.iter().map(SceneSource::file).collect()),
            Self::Xml(text) => Ok(vec![SceneSource::text("given as text", text)]),
            Self::Each(each) => {
                let sources = each.iter().map(|one| one.sources(None)).collect::<Result<Vec<_>, _>>()?;
                Ok(sources.concat())
            }
            Self::Forest(o) => each(n, o, "forest", |o| &mut o.seed, generate::forest),
            Self::Corridor(o) => each(n, o, "corridor", |o| &mut o.seed, generate::corridor),
            Self::Boxes(o) => each(n, o, "boxes", |o| &mut o.seed, generate::boxes),
            Self::Track(o) => each(n, o, "track", |o| &mut o.seed, generate::track),
            Self::Rooms(o) => each(n, o, "rooms", |o| &mut o.seed, generate::rooms),
        }
    }
}
