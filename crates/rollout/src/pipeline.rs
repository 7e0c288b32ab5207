//! The stages of a step, by name: `controllers` and `integration` are built in, users add their own before, between and
//! after them.

use super::{RolloutError, SimData};
use propwash_trace::lanes::Number;

/// A user's stage: reads and writes the arrays of the simulation.
pub type StageFn<N = f64> = Box<dyn FnMut(&mut SimData<N>) + Send>;

/// Name of the built-in stage that runs the on-board controllers.
pub const CONTROLLERS: &str = "controllers";
/// Name of the built-in stage that integrates the equations of motion.
pub const INTEGRATION: &str = "integration";

pub(super) enum Stage<N> {
    Controllers,
    Integration,
    User(StageFn<N>),
}

/// Named stages in the order in which a step runs them.
///
/// ```
/// use propwash_rollout::{Sim, SimOptions};
/// use propwash_vehicle::Vehicle;
///
/// let vehicle = Vehicle::builtin("cf2x_L250")?;
/// let mut sim = Sim::<f64>::storing(SimOptions::default(), vec![(vehicle.drone("first_principles")?, vehicle.rates)])?;
/// sim.pipeline.append("gust", Box::new(|data| data.wind[0] = 2.0))?;
/// assert_eq!(sim.pipeline.names(), ["controllers", "integration", "gust"]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Pipeline<N = f64> {
    pub(super) stages: Vec<(String, Stage<N>)>,
}

impl<N> core::fmt::Debug for Pipeline<N> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_list().entries(self.names()).finish()
    }
}

impl<N> Default for Pipeline<N> {
    fn default() -> Self {
        Self {
            stages: vec![(CONTROLLERS.into(), Stage::Controllers), (INTEGRATION.into(), Stage::Integration)],
        }
    }
}

impl<N> Pipeline<N> {
    /// Names of the stages, first to last.
    pub fn names(&self) -> Vec<&str> {
        self.stages.iter().map(|(name, _)| name.as_str()).collect()
    }

    /// Whether only the built-in stages are there.
    pub(super) fn is_plain(&self) -> bool {
        self.stages.iter().all(|(_, s)| !matches!(s, Stage::User(_)))
    }

    /// Names of the user's stages.
    pub(super) fn user_names(&self) -> Vec<&str> {
        let user = self.stages.iter().filter(|(_, s)| matches!(s, Stage::User(_)));
        user.map(|(name, _)| name.as_str()).collect()
    }

    /// Place of the integration among the stages.
    pub(super) fn integration(&self) -> usize {
        let found = self.stages.iter().position(|(_, s)| matches!(s, Stage::Integration));
        found.unwrap_or(self.stages.len())
    }

    fn position(&self, name: &str) -> Result<usize, RolloutError> {
        self.stages
            .iter()
            .position(|(n, _)| n == name)
            .ok_or_else(|| RolloutError::NoStage { name: name.into(), known: self.names().join(", ") })
    }

    fn insert(&mut self, at: usize, name: &str, f: StageFn<N>) -> Result<(), RolloutError> {
        if self.position(name).is_ok() {
            return Err(RolloutError::StageExists { name: name.into() });
        }
        self.stages.insert(at, (name.into(), Stage::User(f)));
        Ok(())
    }

    /// Adds a stage as the first.
    pub fn prepend(&mut self, name: &str, f: StageFn<N>) -> Result<(), RolloutError> {
        self.insert(0, name, f)
    }

    /// Adds a stage as the last.
    pub fn append(&mut self, name: &str, f: StageFn<N>) -> Result<(), RolloutError> {
        self.insert(self.stages.len(), name, f)
    }

    /// Adds a stage directly before `anchor`.
    pub fn insert_before(&mut self, anchor: &str, name: &str, f: StageFn<N>) -> Result<(), RolloutError> {
        let at = self.position(anchor)?;
        self.insert(at, name, f)
    }

    /// Adds a stage directly after `anchor`.
    pub fn insert_after(&mut self, anchor: &str, name: &str, f: StageFn<N>) -> Result<(), RolloutError> {
        let at = self.position(anchor)? + 1;
        self.insert(at, name, f)
    }

    /// Puts another function in the place of a user's stage.
    pub fn replace(&mut self, name: &str, f: StageFn<N>) -> Result<(), RolloutError> {
        let at = self.user_stage(name, "replaced")?;
        self.stages[at].1 = Stage::User(f);
        Ok(())
    }

    /// Takes a user's stage out.
    pub fn remove(&mut self, name: &str) -> Result<(), RolloutError> {
        let at = self.user_stage(name, "removed")?;
        self.stages.remove(at);
        Ok(())
    }

    fn user_stage(&self, name: &str, action: &'static str) -> Result<usize, RolloutError> {
        let at = self.position(name)?;
        match self.stages[at].1 {
            Stage::User(_) => Ok(at),
            _ => Err(RolloutError::BuiltInStage { name: name.into(), action }),
        }
    }
}

/// A stage that lets drones rest on the ground: a drone whose origin sinks below `rest_height_m` over the ground under it
/// (`ground_z`) is put back to that height, and its angular, horizontal and downward velocity are stopped.
///
/// Without it the ground is reported as a contact and does not hold: this crate solves no contact forces.
pub fn rest_on_ground<N: Number>(rest_height_m: f64) -> StageFn<N> {
    Box::new(move |data: &mut SimData<N>| {
        for r in 0..data.ground_z.len() {
            let floor = data.ground_z[r] + N::of(rest_height_m);
            if data.pos[3 * r + 2] < floor {
                data.pos[3 * r + 2] = floor;
                data.vel[3 * r..3 * r + 3].iter_mut().enumerate().for_each(|(i, v)| {
                    *v = if i == 2 { v.max(N::zero()) } else { N::zero() };
                });
                data.ang_vel[3 * r..3 * r + 3].fill(N::zero());
            }
        }
    })
}
