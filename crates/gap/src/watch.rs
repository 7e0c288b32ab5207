//! Watching long work: its progress, an early list of what it is about to find, and the wish to end it.

use super::GapError;
use serde::Serialize;
use std::sync::atomic::{AtomicBool, Ordering};

/// A candidate with the evidence for it alone, before a search has settled.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Ranked {
    /// Candidate id.
    pub id: String,
    /// In plain words.
    pub title: String,
    /// Evidence for it alone, nats.
    pub evidence_nats: f64,
    /// Whether the search has it in its set at the moment.
    pub chosen: bool,
}

/// Told of every linearisation: how many are done, of how many at most.
pub type Progress<'a> = &'a (dyn Fn(usize, usize) + Sync);
/// Told of the candidates by falling evidence as soon as a first fit is there, and again with every later one.
pub type Early<'a> = &'a (dyn Fn(&[Ranked]) + Sync);

/// Who watches a search or a fit. Nobody by default.
#[derive(Clone, Copy, Default)]
pub struct Watch<'a> {
    /// `(done, total)`.
    pub progress: Option<Progress<'a>>,
    /// The early list.
    pub early: Option<Early<'a>>,
    /// Once it is set the work ends with [`GapError::Cancelled`]; read between windows of the log.
    pub cancel: Option<&'a AtomicBool>,
}

impl Watch<'_> {
    /// Whether the work is to end.
    pub fn cancelled(&self) -> bool {
        self.cancel.is_some_and(|c| c.load(Ordering::Relaxed))
    }

    /// Ends the work where that is wished for.
    ///
    /// # Errors
    /// [`GapError::Cancelled`].
    pub fn check(&self) -> Result<(), GapError> {
        if self.cancelled() { Err(GapError::Cancelled) } else { Ok(()) }
    }

    pub(crate) fn done(&self, done: usize, total: usize) {
        if let Some(progress) = self.progress {
            progress(done, total);
        }
    }
}
