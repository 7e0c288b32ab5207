//! Flights that are commanded from the states as they come, forwards alone or forwards and backwards in one call: what policies are trained by.

use super::blocks::Phase;
use super::lanes::{Ask, Commands};
use super::{RolloutError, Sim};
use propwash_trace::lanes::Number;

/// Which worlds, and which command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// Number of the first world in the lanes; the others follow it.
    pub first_world: usize,
    /// Worlds in the lanes; lanes behind them repeat the last and count for nothing.
    pub n_worlds: usize,
    /// Which command of the flight, from 0.
    pub t: usize,
}

/// What commands drones from their states. Numbers stand in lanes: one block of worlds for each number of a state
/// ([`crate::tape::state_width`]) or of a command.
///
/// [`Commander::command`] and [`Commander::look`] alternate. Blocks of worlds are flown by several threads.
pub trait Commander<N: Number>: Sync {
    /// The commands for these states.
    fn command(&self, at: Place, state: &[N::Cell], command: &mut [N::Cell]);

    /// The states after the command.
    fn look(&self, at: Place, state: &[N::Cell]);

    /// These worlds did not stay finite: they stay where the flight began, and what was said of it backwards is void.
    fn lost(&self, at: Place);
}

/// What commands drones and says what their states are worth, with slopes.
///
/// Backwards [`Pilot::seed`] and [`Pilot::pull_back`] alternate. A long flight is flown in groups, of which the earlier ones are flown again before
/// they are undone: then the same commands are asked for again, from the same states.
pub trait Pilot<N: Number>: Commander<N> {
    /// Adds what the loss gains by the states after the command.
    fn seed(&self, at: Place, by_state: &mut [N::Cell]);

    /// Adds what the loss gains by the states for which the command was given, through what it gains by the command.
    fn pull_back(&self, at: Place, by_command: &[N::Cell], by_state: &mut [N::Cell]);
}

impl<N: Number> Sim<N> {
    /// Flies all worlds under `times` commands of a pilot, each in force for `substeps` steps, and goes back over the flight with its gradients.
    /// Afterwards the worlds stand at the end of the flight.
    ///
    /// # Errors
    /// [`RolloutError::Option`] for a simulation that does not fly in lanes or has several drones in a world, [`RolloutError::Gradient`] for stages of the
    /// user's and worlds in quarantine, and those of [`Sim::step`].
    pub fn fly_piloted(
        &mut self,
        pilot: &dyn Pilot<N>,
        times: usize,
        substeps: usize,
    ) -> Result<(), RolloutError> {
        self.check_piloted(times, substeps)?;
        let commands = Commands { numbers: &[], times, substeps };
        let none = vec![Vec::new(); self.data.n_drones];
        self.run_lanes((times * substeps, Phase::Both), &Ask::Pilot(commands, pilot, &none), Vec::new());
        Ok(())
    }

    /// Flies all worlds under `times` commands, each in force for `substeps` steps: [`Sim::fly_piloted`] without the way back.
    ///
    /// # Errors
    /// Those of [`Sim::fly_piloted`].
    pub fn fly_commanded(
        &mut self,
        commander: &dyn Commander<N>,
        times: usize,
        substeps: usize,
    ) -> Result<(), RolloutError> {
        self.check_piloted(times, substeps)?;
        let commands = Commands { numbers: &[], times, substeps };
        self.run_lanes((times * substeps, Phase::Both), &Ask::Commander(commands, commander), Vec::new());
        Ok(())
    }

    /// Makes ready for a flight that is commanded as it goes, or says why there can be none.
    fn check_piloted(&mut self, times: usize, substeps: usize) -> Result<(), RolloutError> {
        let option = |name, expected: &str, got: String| {
            Err(RolloutError::Option { name, expected: expected.into(), got })
        };
        if !self.in_lanes() {
            return option("engine", "`lanes`, for pilots", format!("{:?}", self.options().engine));
        }
        if self.data.n_drones != 1 {
            return option("drones", "one in each world, for pilots", self.data.n_drones.to_string());
        }
        if times == 0 || substeps == 0 {
            return option("times, substeps", "at least one each", format!("{times}, {substeps}"));
        }
        self.check_slopes()?;
        self.check_data()?;
        self.mend_attitudes();
        if let Some(fault) = self.data.quarantine.iter().flatten().next() {
            return Err(RolloutError::Gradient {
                what: format!("a world that stands still: {fault}"),
                remedy: "reset it first".into(),
            });
        }
        Ok(())
    }
}
