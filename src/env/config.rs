//! What an environment is made of, as read from JSON or TOML.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::EnvError;
use super::action::ActionConfig;
use super::randomize::Levels;
use super::tasks::TaskConfig;
use crate::rollout::randomize::Randomization;
use crate::scene::SceneSource;
use crate::scene::generate::{
    self, BoxesOptions, CorridorOptions, ForestOptions, RoomsOptions, TrackOptions,
};
use crate::sense::{DepthKind, DepthNoise};

/// When worlds whose episode has ended start anew.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Autoreset {
    /// In the next step, which ignores their action and gives reward 0.
    #[default]
    NextStep,
    /// In the step that ends them: what was observed last is kept apart.
    SameStep,
    /// When the caller resets them; stepping a world that has ended is an error.
    Disabled,
}

/// A batch of worlds and what is done in them. Every field has a default; unknown ones are refused.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EnvConfig {
    /// What the drones are asked to do.
    pub task: TaskConfig,
    /// Number of worlds.
    pub n_worlds: usize,
    /// Drones in each world.
    pub n_drones: usize,
    /// Number of the first world over a batch that is split: worlds keep their random numbers.
    pub first_world: u64,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Model of motion: a name of [`Vehicle::available_dynamics`](crate::vehicle::Vehicle::available_dynamics).
    pub dynamics: String,
    /// Steps of the simulation per second.
    pub sim_hz: u32,
    /// Steps of the environment per second, which divide those of the simulation.
    pub step_hz: u32,
    /// Episodes are cut off after this time, s.
    pub max_episode_s: f64,
    /// What actions mean.
    pub action: ActionConfig,
    /// Where the drones fly; none is the task's own choice.
    pub scene: Option<SceneConfig>,
    /// How many layouts of a generated scene there are, which differ in their seeds; every world flies in one of them, drawn anew
    /// at every reset. None is the task's own choice.
    pub layouts: Option<usize>,
    /// The depth camera of every drone; none is the task's own choice.
    pub camera: Option<CameraConfig>,
    /// Whether to render depth at all, where the task asks for it.
    pub with_camera: bool,
    /// When worlds that have ended start anew.
    pub autoreset: Autoreset,
    /// Clearances are looked for up to this distance, m.
    pub look_m: f64,
    /// Disturbances, delays and noise, as they are without a rule of `randomization`.
    pub levels: Levels,
    /// What is drawn anew at every reset: numbers of vehicles and effects, starts, and [`Levels`] by the name `env.…`.
    pub randomization: Randomization,
}

impl Default for EnvConfig {
    /// One world in which one drone at 500 Hz is asked, 50 times a second for 10 s, to reach a position.
    fn default() -> Self {
        Self {
            task: TaskConfig::default(),
            n_worlds: 1,
            n_drones: 1,
            first_world: 0,
            seed: 0,
            dynamics: "first_principles".into(),
            sim_hz: 500,
            step_hz: 50,
            max_episode_s: 10.0,
            action: ActionConfig::default(),
            scene: None,
            layouts: None,
            camera: None,
            with_camera: true,
            autoreset: Autoreset::NextStep,
            look_m: 3.0,
            levels: Levels::default(),
            randomization: Randomization::default(),
        }
    }
}

impl EnvConfig {
    /// Reads a description in JSON.
    ///
    /// # Errors
    /// [`EnvError::Config`], saying where and why.
    pub fn from_json(text: &str) -> Result<Self, EnvError> {
        serde_json::from_str(text).map_err(|e| EnvError::Config { reason: e.to_string() })
    }

    /// Reads a description in TOML.
    ///
    /// # Errors
    /// [`EnvError::Config`], saying where and why.
    pub fn from_toml(text: &str) -> Result<Self, EnvError> {
        toml::from_str(text).map_err(|e| {
            let line = e.span().map_or(1, |at| 1 + text[..at.start].matches('\n').count());
            EnvError::Config { reason: format!("line {line}: {}", e.message().trim()) }
        })
    }

    /// Steps of the simulation in one of the environment.
    pub(super) fn substeps(&self) -> u32 {
        self.sim_hz / self.step_hz
    }

    /// Seconds of one step of the environment.
    pub(super) fn step_s(&self) -> f64 {
        1.0 / f64::from(self.step_hz)
    }

    /// Refuses numbers that make no sense.
    pub(super) fn check(&self) -> Result<(), EnvError> {
        let whole = |name: &str, got: usize, most: usize| {
            if (1..=most).contains(&got) {
                return Ok(());
            }
            Err(EnvError::option(name, format!("1 to {most}"), got))
        };
        whole("n_worlds", self.n_worlds, 1 << 24)?;
        whole("n_drones", self.n_drones, 1 << 12)?;
        whole("sim_hz", self.sim_hz as usize, 1_000_000)?;
        if self.step_hz == 0 || !self.sim_hz.is_multiple_of(self.step_hz) {
            let expected = format!("a divisor of sim_hz ({} Hz)", self.sim_hz);
            return Err(EnvError::option("step_hz", expected, self.step_hz));
        }
        let positive = |name: &str, got: f64, most: f64| {
            if got > 0.0 && got <= most {
                return Ok(());
            }
            Err(EnvError::option(name, format!("more than 0, at most {most}"), got))
        };
        positive("max_episode_s", self.max_episode_s, 1e6)?;
        positive("look_m", self.look_m, 1e3)?;
        self.levels.check()?;
        Ok(())
    }
}

/// Where a batch flies.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SceneConfig {
    /// No scene: nothing is seen, and only the ground is touched, at height zero.
    None,
    /// Each of these files is a layout (MJCF, or URDF).
    Files(Vec<PathBuf>),
    /// One layout, as MJCF text.
    Xml(String),
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
    /// The scenes: `layouts` of one that is generated, which differ in their seeds alone; those count up from that of the options.
    pub(super) fn sources(&self, layouts: Option<usize>) -> Result<Vec<SceneSource>, EnvError> {
        fn each<T: Clone>(
            n: usize,
            options: &T,
            name: &str,
            seed: impl Fn(&mut T) -> &mut u64,
            make: impl Fn(&T) -> Result<String, generate::GenerateError>,
        ) -> Result<Vec<SceneSource>, EnvError> {
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
            _ => None,
        };
        if let (Some(given), Some(n)) = (given, layouts)
            && given != n
        {
            return Err(EnvError::option("layouts", format!("{given}, as many as scenes are given"), n));
        }
        if !(1..=MOST_LAYOUTS).contains(&given.unwrap_or(n)) && *self != Self::None {
            let got = given.unwrap_or(n);
            return Err(EnvError::option("layouts", format!("1 to {MOST_LAYOUTS} scenes"), got));
        }
        match self {
            Self::None => Ok(Vec::new()),
            Self::Files(files) => Ok(files.iter().map(SceneSource::file).collect()),
            Self::Xml(text) => Ok(vec![SceneSource::text("given as text", text)]),
            Self::Forest(o) => each(n, o, "forest", |o| &mut o.seed, generate::forest),
            Self::Corridor(o) => each(n, o, "corridor", |o| &mut o.seed, generate::corridor),
            Self::Boxes(o) => each(n, o, "boxes", |o| &mut o.seed, generate::boxes),
            Self::Track(o) => each(n, o, "track", |o| &mut o.seed, generate::track),
            Self::Rooms(o) => each(n, o, "rooms", |o| &mut o.seed, generate::rooms),
        }
    }
}

/// A depth camera on every drone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CameraConfig {
    /// A device whose lens, size, range and noise are taken: a name of [`DEVICES`](crate::sense::DEVICES). What stands beside
    /// it here comes first.
    pub device: Option<String>,
    /// Camera of the drone's shell that says where it sits and, without a device, its lens.
    pub name: String,
    /// Pixels in a row.
    pub width: Option<usize>,
    /// Rows.
    pub height: Option<usize>,
    /// Vertical field of view, degrees.
    pub fovy_deg: Option<f64>,
    /// Least and greatest depth that is seen, m.
    pub range_m: Option<[f64; 2]>,
    /// Along the ray, or along the camera's axis.
    pub kind: DepthKind,
    /// Errors of the sensor; those of the device where this is none.
    pub noise: Option<DepthNoise>,
}

impl Default for CameraConfig {
    /// 64 × 64 pixels of z-depth up to 10 m by the shell's camera `fpv`, without noise.
    fn default() -> Self {
        Self {
            device: None,
            name: "fpv".into(),
            width: None,
            height: None,
            fovy_deg: None,
            range_m: None,
            kind: DepthKind::ZDepth,
            noise: None,
        }
    }
}
