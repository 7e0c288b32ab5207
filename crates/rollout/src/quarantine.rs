//! Worlds whose numbers stop being numbers are set aside and named.

/// Why a world stands still.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Quarantine {
    /// World, counted over the whole run.
    pub world: u64,
    /// Drone slot whose state turned non-finite first.
    pub drone: usize,
    /// Step after which it did; the state kept is the one before.
    pub step: u64,
    /// The quantity.
    pub quantity: String,
    /// The user's stage that wrote it; `None` where the equations gave it.
    pub stage: Option<String>,
}

impl core::fmt::Display for Quarantine {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(
            f,
            "world {} is quarantined: {} of drone {} became non-finite in step {}",
            self.world, self.quantity, self.drone, self.step
        )?;
        if let Some(stage) = &self.stage {
            write!(f, ", written by stage {stage}")?;
        }
        write!(f, "; its last finite state is kept and it takes no further steps until it is reset")
    }
}
