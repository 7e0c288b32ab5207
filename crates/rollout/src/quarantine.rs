//! Worlds whose numbers stop being numbers are set aside and named.

/// Largest coordinate of a drone, m. What flies farther has left every scene, and single precision has steps of 64 m there.
pub const MAX_POSITION_M: f64 = 1e9;

/// The quantity of a world whose drone went beyond [`MAX_POSITION_M`].
pub const TOO_FAR: &str = "distance from the origin";
/// The quantity of a world with an attitude of length 0, which is none.
pub const NO_ATTITUDE: &str = "length of the attitude";

/// Why a world stands still.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Quarantine {
    /// World, counted over the whole run.
    pub world: u64,
    /// Drone slot whose state turned non-finite first, or went too far.
    pub drone: usize,
    /// Step after which it did; the state kept is the one before.
    pub step: u64,
    /// The quantity.
    pub quantity: String,
    /// The user's stage that wrote it; `None` where the equations gave it.
    pub stage: Option<String>,
}

impl Quarantine {
    /// What became of the drone.
    pub fn reason(&self) -> String {
        match self.quantity.as_str() {
            TOO_FAR => format!("its position went beyond {MAX_POSITION_M:e} m"),
            NO_ATTITUDE => "its attitude had length 0".into(),
            quantity => format!("its {quantity} became non-finite"),
        }
    }
}

impl core::fmt::Display for Quarantine {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Self { world, drone, step, .. } = self;
        write!(f, "world {world} is quarantined: drone {drone} in step {step}: {}", self.reason())?;
        if let Some(stage) = &self.stage {
            write!(f, ", written by stage {stage}")?;
        }
        write!(f, "; its last finite state is kept and it takes no further steps until it is reset")
    }
}
