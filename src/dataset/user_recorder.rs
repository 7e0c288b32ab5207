//! Records worlds that a program of the user's flies, step by step, into a data set.

use std::path::Path;
use std::sync::Arc;

use rayon::prelude::*;

use super::recorder::{FlightConfig, content, manifest, refuse};
use super::world_log::{Content, WorldLog};
use super::{Summary, WorldWriter, Writer, create_or_resume};
use crate::arena::{Arena, Setup};
use crate::error::Result;
use crate::scalar::lanes::Number;
use crate::sense::{Camera, DepthNoise};

/// What a [`Recorder`] writes, and how much of it.
#[derive(Clone, Debug)]
pub struct RecordOptions {
    /// Length of a flight, s.
    pub seconds: f64,
    /// How often the worlds of the simulation are flown: the data set has so many times their number.
    pub episodes: usize,
    /// Depth frames per second.
    pub fps: u32,
    /// Rows of states, contacts and clearances per second; must divide the steps of the simulation.
    pub log_hz: u32,
    /// Whether surface normals are stored.
    pub normals: bool,
    /// Largest clearance that is looked for, m.
    pub clearance_max_m: f64,
    /// The camera of each drone; none: that of the description of the simulation, if it has one.
    pub cameras: Option<Vec<Camera>>,
    /// Noise of these cameras, in place of that of the description.
    pub noise: Option<DepthNoise>,
}

impl Default for RecordOptions {
    /// One flight of 4 s with 20 frames and 100 rows of states a second, by the camera of the description.
    fn default() -> Self {
        let own = FlightConfig::default();
        Self {
            seconds: own.seconds,
            episodes: 1,
            fps: own.fps,
            log_hz: own.log_hz,
            normals: own.normals,
            clearance_max_m: own.clearance_max_m,
            cameras: None,
            noise: None,
        }
    }
}

/// A world that is being written, in its place in the simulation; none where it is there already or has ended.
type Open = Option<(WorldLog, WorldWriter)>;

/// Writes what drones do whose commands come from the user: every world of a simulation, through one or several episodes.
///
/// For each episode: reset the arena, [`Recorder::begin`], then set commands and [`Recorder::step`] until it says that the flight is over;
/// at the end [`Recorder::finish`].
///
/// ```
/// use propwash::dataset::RecordOptions;
/// use propwash::prelude::*;
///
/// let setup = SimConfig::from_text("n_worlds = 2")?.load()?;
/// let mut arena: Arena<f32> = setup.arena()?;
/// let folder = tempfile::tempdir().unwrap();
/// let out = folder.path().join("set");
/// let mut recorder = Recorder::new(&out, &setup, &RecordOptions { seconds: 0.1, ..RecordOptions::default() })?;
/// recorder.begin(&arena)?;
/// arena.set_command(&Reference::hover([0.0, 0.0, 1.0], 0.0).command().repeat(2))?;
/// while recorder.step(&mut arena)? {}
/// assert_eq!(recorder.finish()?.n_worlds, 2);
/// assert_eq!(Dataset::open(&out)?.world(1)?.states(None)?.n_rows(), 11);
/// # Ok::<(), propwash::Error>(())
/// ```
pub struct Recorder {
    content: Arc<Content>,
    writer: Writer,
    /// Worlds of the data set that are there.
    done: Vec<bool>,
    first_world: u64,
    /// Worlds of the simulation.
    n_worlds: usize,
    /// Steps of a flight.
    n_steps: u64,
    /// Episodes begun so far.
    episode: usize,
    step: u64,
    worlds: Vec<Open>,
    flying: bool,
}

impl Recorder {
    /// Starts a data set of a simulation in `out`, or goes on with the one that is there.
    ///
    /// # Errors
    /// [`Error`](crate::Error) for options that make no sense, naming them (also normals and noise without a camera), for a simulation in several scenes, and as [`create_or_resume`].
    pub fn new(out: &Path, setup: &Setup, options: &RecordOptions) -> Result<Self> {
        let sim = setup.config().clone();
        let (n_worlds, first_world) = (sim.options.n_worlds, sim.options.first_world);
        let most = 10_000_000 / n_worlds.max(1);
        if !(1..=most).contains(&options.episodes) {
            let expected = format!("1 to {most}, for at most 10000000 worlds in all");
            return refuse("episodes", expected, options.episodes);
        }
        if setup.scenes().len() > 1 {
            return refuse("scene", "one scene, which the data set describes", setup.scenes().len());
        }
        let mut config = FlightConfig {
            sim,
            seconds: options.seconds,
            fps: options.fps,
            log_hz: options.log_hz,
            normals: options.normals,
            clearance_max_m: options.clearance_max_m,
            by_user: true,
        };
        config.check_rates()?;
        config.sim.scene_sha256 = setup.scenes().iter().map(crate::scene::Scene::hash).collect();
        let own = || setup.cameras().first().cloned().unwrap_or_default();
        let cameras = options.cameras.clone().unwrap_or_else(own);
        if cameras.is_empty() && options.normals {
            return refuse("normals", "a camera, on whose images they are", "none");
        }
        if options.cameras.is_none() && options.noise.is_some() {
            return refuse("noise", "cameras beside it, to which it belongs", "none");
        }
        let cameras = cameras.into_iter().map(|c| c.with_normals(config.normals)).collect();
        let mut content = content(&config, setup, cameras)?;
        if options.cameras.is_some() {
            content.noise = options.noise;
        }
        if let Some(noise) = &content.noise {
            noise.check()?;
        }
        let manifest = manifest(&config, setup, &content, options.episodes * n_worlds);
        let (writer, done) = create_or_resume(out, &manifest)?;
        writer.put_scene(content.mjb.as_deref())?;
        Ok(Self {
            n_steps: (options.seconds * f64::from(content.sim_hz)).round() as u64,
            content: Arc::new(content),
            writer,
            done,
            first_world,
            n_worlds,
            episode: 0,
            step: 0,
            worlds: Vec::new(),
            flying: false,
        })
    }

    /// Steps of a flight.
    pub fn n_steps(&self) -> u64 {
        self.n_steps
    }

    /// Episodes of the data set.
    pub fn n_episodes(&self) -> usize {
        self.done.len() / self.n_worlds
    }

    /// Whether a flight is being recorded.
    pub fn is_flying(&self) -> bool {
        self.flying
    }

    /// What was found and repaired at the start.
    pub fn warnings(&self) -> &[String] {
        self.writer.warnings()
    }

    /// Begins the next episode with the arena as it is, just reset. False: all its worlds are there already, and there is nothing to fly.
    ///
    /// # Errors
    /// [`Error`](crate::Error) while a flight is being recorded, after the last episode, and for an arena that was not reset.
    pub fn begin<N: Number>(&mut self, arena: &Arena<N>) -> Result<bool> {
        if self.flying {
            return refuse("begin", "the end of the flight that is being recorded first", "another begin");
        }
        if self.episode >= self.n_episodes() {
            return refuse("begin", format!("at most {} episodes", self.n_episodes()), self.episode + 1);
        }
        let data = &arena.sim().data;
        if data.n_worlds != self.n_worlds || data.steps.iter().any(|s| *s != 0) {
            let expected = format!("{} worlds that were just reset", self.n_worlds);
            return refuse("begin", expected, "worlds that have flown, or others");
        }
        let first = self.episode * self.n_worlds;
        self.episode += 1;
        let look = arena.look();
        let open = |w: usize| -> Result<Open> {
            if self.done[first + w] {
                return Ok(None);
            }
            let number = self.first_world + (first + w) as u64;
            let log = WorldLog::new(&self.content, look, w, number)?;
            Ok(Some((log, self.writer.world(first + w)?)))
        };
        self.worlds = (0..self.n_worlds).map(open).collect::<Result<_>>()?;
        (self.step, self.flying) = (0, self.worlds.iter().any(Option::is_some));
        Ok(self.flying)
    }

    /// Records the present step and flies it, under the commands that are set. False: that was the last one, and the worlds are written.
    ///
    /// # Errors
    /// [`Error`](crate::Error) without a flight, for an arena that was stepped otherwise meanwhile, and where files cannot be written.
    pub fn step<N: Number>(&mut self, arena: &mut Arena<N>) -> Result<bool> {
        self.check(arena)?;
        self.write(arena)?;
        arena.run_integration()?;
        self.step += 1;
        let mut ended = vec![false; self.n_worlds];
        for (open, ended) in self.worlds.iter_mut().zip(&mut ended) {
            if let Some((log, out)) = open {
                *ended = !log.after_integration(arena.look(), out);
            }
        }
        self.close(arena, &ended)?;
        if self.step < self.n_steps {
            return Ok(self.flying);
        }
        // The end is recorded too, under the commands that a next step would have; the simulation itself stays where it is.
        if self.flying {
            let saved = arena.save();
            let outcome = self.write(arena);
            arena.restore(&saved)?;
            outcome?;
            self.close(arena, &vec![true; self.n_worlds])?;
        }
        Ok(false)
    }

    /// Ends the flight of the worlds of a mask before its time; their rows end with the last step. Worlds whose flight is over stay as
    /// they are.
    ///
    /// # Errors
    /// [`Error`](crate::Error) for a mask of another length, and where files cannot be written.
    pub fn end<N: Number>(&mut self, arena: &Arena<N>, worlds: &[bool]) -> Result<()> {
        if worlds.len() != self.n_worlds {
            return refuse("end", format!("one entry for each of {} worlds", self.n_worlds), worlds.len());
        }
        self.close(arena, worlds)
    }

    /// Seals the data set.
    ///
    /// # Errors
    /// [`DatasetError::Incomplete`](super::DatasetError::Incomplete) while worlds are missing; they are added when the program is run again.
    pub fn finish(&self) -> Result<Summary> {
        Ok(self.writer.finish()?)
    }

    fn check<N: Number>(&self, arena: &Arena<N>) -> Result<()> {
        if !self.flying {
            return refuse("step", "a flight that was begun and has not ended", "none");
        }
        let data = &arena.sim().data;
        let odd =
            self.worlds.iter().zip(&data.steps).position(|(w, steps)| w.is_some() && *steps != self.step);
        match odd {
            None => Ok(()),
            Some(world) => {
                let expected = format!("step {}, at which the recorder is: step by it alone", self.step);
                refuse("step", expected, format!("step {} in world {world}", data.steps[world]))
            }
        }
    }

    /// Writes the present step of every world that is open; the controllers have run after it.
    fn write<N: Number>(&mut self, arena: &mut Arena<N>) -> Result<()> {
        let step = self.step;
        let look = arena.look();
        let outcome: Result<Vec<bool>> = self
            .worlds
            .par_iter_mut()
            .map(|open| match open {
                Some((log, out)) => Ok(!log.before(look, step, out)?),
                None => Ok(false),
            })
            .collect();
        self.close(arena, &outcome?)?;
        arena.run_controllers()?;
        let sampled = self.content.due(step);
        let open: Vec<bool> = self.worlds.iter().map(Option::is_some).collect();
        for sensor in &sampled {
            arena.sample(*sensor, Some(&open))?;
        }
        let at = (arena.look(), arena.sim().equations());
        self.worlds.par_iter_mut().try_for_each(|open| match open {
            Some((log, out)) => {
                log.after_controllers(at, step, &sampled, &[], out)?;
                log.before_integration(at.0);
                Ok(())
            }
            None => Ok(()),
        })
    }

    /// Closes worlds.
    fn close<N: Number>(&mut self, arena: &Arena<N>, worlds: &[bool]) -> Result<()> {
        if worlds.contains(&true) {
            let at = (arena.look(), arena.sim().equations());
            let closed: Result<Vec<()>> = self
                .worlds
                .par_iter_mut()
                .zip(worlds)
                .filter(|(_, ended)| **ended)
                .map(|(open, _)| {
                    let Some((log, mut out)) = open.take() else { return Ok(()) };
                    out.set_info(log.info(at));
                    out.finish().map(drop).map_err(Into::into)
                })
                .collect();
            closed?;
            self.flying = self.worlds.iter().any(Option::is_some);
        }
        Ok(())
    }
}
