//! What a sensor is: something on a drone that gives numbers under names.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};

use super::SenseError;
use crate::physics::measure::Reading;
use crate::random::Stream;
use crate::scene::{Pose, Worker};

/// Type of the numbers of a channel. Sensors write f32; whole numbers, below 2²⁴, are stored and handed over as such.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ChannelType {
    /// Real numbers.
    #[default]
    F32,
    /// Whole numbers, such as those of geoms.
    I32,
    /// Whole numbers from 0 to 255, such as a status.
    U8,
}

/// Numbers that a sensor gives together: one array for each drone.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorChannel {
    /// Its name, one of its own within the sensor.
    pub name: Cow<'static, str>,
    /// SI unit, `1` where it has none.
    pub unit: Cow<'static, str>,
    /// Shape of the array; empty for one number.
    pub shape: Vec<usize>,
    /// Type of its numbers.
    #[serde(rename = "type")]
    pub kind: ChannelType,
}

impl SensorChannel {
    /// A channel of real numbers in this shape.
    pub fn new(
        name: impl Into<Cow<'static, str>>,
        unit: impl Into<Cow<'static, str>>,
        shape: &[usize],
    ) -> Self {
        Self { name: name.into(), unit: unit.into(), shape: shape.into(), kind: ChannelType::F32 }
    }

    /// The same, of another type.
    #[must_use]
    pub fn of_type(self, kind: ChannelType) -> Self {
        Self { kind, ..self }
    }

    /// How many numbers it has.
    pub fn len(&self) -> usize {
        self.shape.iter().product()
    }

    /// Whether it has none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// A drone at the instant at which a sensor samples it.
pub struct Moment<'a> {
    /// Number of the drone in its world.
    pub drone: usize,
    /// Number of the scene that its world is in; none without a scene.
    pub layout: Option<usize>,
    /// Time since the reset, s.
    pub time_s: f64,
    /// Time since the sample before, s; that since the reset for the first one. At least one step of the simulation.
    pub since_s: f64,
    /// Whether it is the first sample since the reset.
    pub first: bool,
    /// Where the drone is, world.
    pub pose: Pose,
    /// Its velocity, m/s, world.
    pub vel_m_s: [f64; 3],
    /// Its angular velocity, rad/s, body.
    pub ang_vel_rad_s: [f64; 3],
    /// The scene with all drones and obstacles where they are; none where there is no scene.
    pub worker: Option<&'a mut Worker>,
    /// Random numbers of this sensor, drone and instant: the same whatever else is simulated beside.
    pub draw: Stream,
    /// Works out [`Moment::reading`].
    pub(crate) read: &'a (dyn Fn() -> Reading<f64> + Sync),
}

impl Moment<'_> {
    /// What the vehicle's own sensors read at the centre of mass, without noise, as its effects let them (mounted askew, biased …).
    /// It is worked out anew at every call.
    pub fn reading(&self) -> Reading<f64> {
        (self.read)()
    }

    /// The scene, for a sensor that cannot do without.
    ///
    /// # Errors
    /// [`SenseError::Parameter`] where there is none, naming the sensor.
    pub fn scene(&mut self, sensor: &str) -> Result<&mut Worker, SenseError> {
        self.worker.as_deref_mut().ok_or_else(|| SenseError::Parameter {
            what: format!("{sensor}: expected a scene to look at, found none; give the simulation one"),
        })
    }
}

/// A sensor on every drone of a simulation. [`Arena::add_sensor`](crate::arena::Arena::add_sensor) mounts it; one value serves all
/// drones and is shared by threads, so what it remembers of a drone stands in numbers that the arena keeps.
///
/// `examples/own_sensor.rs` is a whole one.
pub trait Sensor: Send + Sync {
    /// Its name, one of its own in a simulation; its random numbers go with it.
    fn name(&self) -> &str;

    /// What it gives.
    fn channels(&self) -> Vec<SensorChannel>;

    /// How many numbers it remembers of each drone.
    fn memory_len(&self) -> usize {
        0
    }

    /// Samples one drone: writes every channel's numbers into `out`, in the order of [`Sensor::channels`]. `memory` is zero at the first
    /// sample after a reset; a second sample in the same step gets it as the first one did.
    ///
    /// # Errors
    /// [`SenseError`]: the sample of all worlds fails then.
    fn sample(&self, at: &mut Moment, memory: &mut [f64], out: &mut [&mut [f32]]) -> Result<(), SenseError>;
}
