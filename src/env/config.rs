//! What an environment is made of, as read from JSON or TOML.

use serde::{Deserialize, Serialize};

use super::EnvError;
use super::action::ActionConfig;
use super::randomize::Levels;
use super::tasks::TaskConfig;
use crate::arena::{SimConfig, read_text};

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
#[serde(default)]
pub struct EnvConfig {
    /// What flies, where and how. An action says what commands mean, and tasks choose scenes and cameras where there are none.
    #[serde(flatten)]
    pub sim: SimConfig,
    /// What the drones are asked to do.
    pub task: TaskConfig,
    /// Steps of the environment per second, which divide those of the simulation.
    pub step_hz: u32,
    /// Episodes are cut off after this time, s.
    pub max_episode_s: f64,
    /// What actions mean.
    pub action: ActionConfig,
    /// Whether to render depth at all, where the task asks for it.
    pub with_camera: bool,
    /// When worlds that have ended start anew.
    pub autoreset: Autoreset,
    /// Clearances are looked for up to this distance, m.
    pub look_m: f64,
    /// Disturbances, delays and noise, as they are without a rule of `randomization`, which names them `env.…`.
    pub levels: Levels,
}

impl Default for EnvConfig {
    /// One world in which one drone at 500 Hz is asked, 50 times a second for 10 s, to reach a position.
    fn default() -> Self {
        Self {
            sim: SimConfig::default(),
            task: TaskConfig::default(),
            step_hz: 50,
            max_episode_s: 10.0,
            action: ActionConfig::default(),
            with_camera: true,
            autoreset: Autoreset::NextStep,
            look_m: 3.0,
            levels: Levels::default(),
        }
    }
}

impl EnvConfig {
    /// Reads a description in JSON or TOML.
    ///
    /// # Errors
    /// [`EnvError::Config`], saying where and why.
    pub fn from_text(text: &str) -> Result<Self, EnvError> {
        Ok(read_text(text)?)
    }

    /// Steps of the simulation in one of the environment.
    pub(super) fn substeps(&self) -> u32 {
        self.sim.options.sim_hz / self.step_hz
    }

    /// Seconds of one step of the environment.
    pub(super) fn step_s(&self) -> f64 {
        1.0 / f64::from(self.step_hz)
    }

    /// Refuses numbers that make no sense.
    pub(super) fn check(&self) -> Result<(), EnvError> {
        self.sim.check()?;
        for (name, got, most) in
            [("n_worlds", self.sim.options.n_worlds, 1 << 24), ("n_drones", self.sim.n_drones(), 1 << 12)]
        {
            if got > most {
                return Err(EnvError::option(name, format!("1 to {most}"), got));
            }
        }
        let sim_hz = self.sim.options.sim_hz;
        if self.step_hz == 0 || !sim_hz.is_multiple_of(self.step_hz) {
            let expected = format!("a divisor of sim_hz ({sim_hz} Hz)");
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
