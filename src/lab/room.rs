//! What all requests share: the door, what the lab began with, and the sessions.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::answer::Refusal;
use super::desk::Desk;
use super::guard::Door;
use super::worker::Worker;
use super::{MAX_SESSIONS, Options};
use crate::{Error, Result};

/// What all requests share.
pub struct Room {
    /// Who may ask.
    pub door: Door,
    /// What the lab began with.
    pub options: Options,
    /// The folder in which it was started, where saved files go unless told otherwise.
    pub folder: PathBuf,
    sessions: Mutex<Sessions>,
}

#[derive(Default)]
struct Sessions {
    open: BTreeMap<u64, Arc<Worker>>,
    last: u64,
}

impl Room {
    /// A room without sessions. What it begins with is looked at now, so that a wrong path is an error on the terminal.
    ///
    /// # Errors
    /// Those of vehicle and scene; [`Error::Usage`] for a log that is not there.
    pub fn new(door: Door, options: Options) -> Result<Self> {
        let folder = std::env::current_dir().map_err(|source| Error::Io { path: ".".into(), source })?;
        if let Some(absent) = options.logs.iter().find(|log| !log.exists()) {
            let hint = crate::flight::files::suggestion(absent);
            let got = format!("{}{hint}", absent.display());
            return Err(Error::Usage {
                flag: "LOG",
                expected: "a flight log (.csv, .parquet, .ulg, .mcap, or the folder of a ROS 2 bag)".into(),
                got,
            });
        }
        let room = Self { door, options, folder, sessions: Mutex::default() };
        Desk::begun_with(&room.options)?;
        Ok(room)
    }

    fn lock(&self) -> MutexGuard<'_, Sessions> {
        self.sessions.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A new session, with the logs of the command line where `given` is set.
    ///
    /// # Errors
    /// Where there are [`MAX_SESSIONS`] already, and those of what it begins with.
    pub fn open(&self, given: bool) -> Result<u64, Refusal> {
        let full = || {
            let words = format!(
                "{MAX_SESSIONS} sessions are open, which is the most: close one of them on the start page"
            );
            Refusal::conflict(words)
        };
        // Told before the work; whether it still holds is asked again below.
        if self.lock().open.len() >= MAX_SESSIONS {
            return Err(full());
        }
        let desk = if given { Desk::begun_with(&self.options)? } else { Desk::new()? };
        let worker = Worker::start(desk)
            .map_err(|source| Error::Io { path: "a thread for the session".into(), source })?;
        let mut sessions = self.lock();
        if sessions.open.len() >= MAX_SESSIONS {
            return Err(full());
        }
        sessions.last += 1;
        let id = sessions.last;
        sessions.open.insert(id, Arc::new(worker));
        Ok(id)
    }

    /// A session by its number.
    ///
    /// # Errors
    /// Where it is closed or never was.
    pub fn session(&self, id: u64) -> Result<Arc<Worker>, Refusal> {
        let found = self.lock().open.get(&id).cloned();
        found.ok_or_else(|| Refusal::missing("this session is closed: begin a new one on the start page"))
    }

    /// Numbers of the sessions.
    pub fn sessions(&self) -> Vec<u64> {
        self.lock().open.keys().copied().collect()
    }

    /// Ends a session; whether there was one.
    pub fn end(&self, id: u64) -> bool {
        let worker = self.lock().open.remove(&id);
        worker.as_ref().inspect(|w| w.close()).is_some()
    }

    /// Ends all sessions and waits until their threads have, at most for a while.
    pub fn close(&self, patience: Duration) {
        let all: Vec<Arc<Worker>> = std::mem::take(&mut self.lock().open).into_values().collect();
        all.iter().for_each(|w| w.close());
        let until = Instant::now() + patience;
        while all.iter().any(|w| !w.has_ended()) && Instant::now() < until {
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}
