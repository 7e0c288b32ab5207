//! Steps of a session: every change can be taken back, and gone to again.

use super::{Base, Session, Use, present};
use crate::GapError;
use crate::error::Result;
use crate::ladder::Flights;
use crate::live::Flight as Seen;
use crate::verdict::Lack;
use serde::Serialize;
use std::collections::VecDeque;
use std::sync::Arc;

use present::{Figures, Setting};

/// Most steps that are kept.
const MOST: usize = 200;

/// Everything that a step can change.
#[derive(Clone)]
pub(super) struct Place {
    pub uses: Vec<Use>,
    /// The uses at the last search or fit.
    pub fitted: Option<Vec<Use>>,
    pub parted: Arc<Flights>,
    /// The flights ready for evaluations, in the order of the columns.
    pub seen: Arc<Vec<Seen>>,
    pub base: Arc<Base>,
    pub setting: Setting,
}

struct Step {
    what: String,
    place: Place,
    figures: Figures,
}

/// The steps, the present one among them.
#[derive(Default)]
pub(super) struct History {
    steps: VecDeque<Step>,
    now: usize,
}

/// A step as pages list it: a rung of the ladder.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HistoryStep {
    /// Its number, for [`Session::go`].
    pub number: usize,
    /// What was done.
    pub what: String,
    /// Force and torque that the model lacks since then, on the judged flight.
    pub figures: Option<Lack>,
    /// Whether these come from the model itself.
    pub exact: bool,
    /// Whether this is the present step.
    pub current: bool,
}

impl History {
    pub fn begin(place: Place, figures: Figures) -> Self {
        let step = Step { what: "as filed".into(), place, figures };
        Self { steps: VecDeque::from([step]), now: 0 }
    }

    /// The figures of the present step are those now.
    pub fn exact(&mut self, figures: Figures) {
        if let Some(step) = self.steps.get_mut(self.now) {
            step.figures = figures;
        }
    }

    /// Figures of the present step.
    pub fn figures(&self) -> Option<Figures> {
        self.steps.get(self.now).map(|s| s.figures)
    }

    pub fn list(&self) -> Vec<HistoryStep> {
        let one = |(i, s): (usize, &Step)| HistoryStep {
            number: i,
            what: s.what.clone(),
            figures: s.figures.now,
            exact: s.figures.exact,
            current: i == self.now,
        };
        self.steps.iter().enumerate().map(one).collect()
    }

    /// Words of the steps that led here.
    pub fn words(&self) -> Vec<&str> {
        self.steps.iter().take(self.now + 1).map(|s| s.what.as_str()).collect()
    }

    fn push(&mut self, step: Step) {
        self.steps.truncate(self.now + 1);
        // One move of a slider is one step, however many values it passes.
        let same = step.what.ends_with(" by hand") && self.steps.back().is_some_and(|s| s.what == step.what);
        if same {
            self.steps.pop_back();
        }
        self.steps.push_back(step);
        // The first step, the file, stays.
        while self.steps.len() > MOST {
            self.steps.remove(1);
        }
        self.now = self.steps.len() - 1;
    }
}

impl Session {
    /// Goes on to a new step.
    pub(super) fn take(&mut self, what: String, base: Arc<Base>, setting: Setting) {
        self.now.base = base;
        self.now.setting = setting;
        self.exact = None;
        let figures = self.forecast();
        self.history.push(Step { what, place: self.now.clone(), figures });
    }

    /// Takes the last step back; says whether there was one.
    pub fn undo(&mut self) -> bool {
        let back = self.history.now.checked_sub(1);
        back.is_some_and(|to| self.at(to))
    }

    /// Does the step that was taken back again; says whether there was one.
    pub fn redo(&mut self) -> bool {
        self.at(self.history.now + 1)
    }

    /// Goes to a step of the history, by its number.
    ///
    /// # Errors
    /// [`GapError::Unknown`] where there is none.
    pub fn go(&mut self, number: usize) -> Result<()> {
        if self.at(number) {
            return Ok(());
        }
        let known = format!("0 to {}", self.history.steps.len() - 1);
        Err(GapError::Unknown { name: number.to_string(), what: "step of this session", known }.into())
    }

    fn at(&mut self, to: usize) -> bool {
        let Some(step) = self.history.steps.get(to) else { return false };
        self.now = step.place.clone();
        self.history.now = to;
        self.exact = None;
        true
    }
}
