//! What effects may read about the world around a vehicle. Each effect declares what it reads ([`Reads`]); the caller fills it in.

use propwash_trace::Real;

/// Another vehicle in the same world.
#[derive(Clone, Copy, Debug)]
pub struct Neighbour<S> {
    /// Position of its centre of mass, m, world.
    pub pos: [S; 3],
    /// Its velocity, m/s, world.
    pub vel: [S; 3],
    /// Its weight, N: what its rotors push down in hover.
    pub weight_n: S,
    /// Radius of the disc that has the area of all its rotors, m.
    pub disc_radius_m: S,
}

/// A load that hangs from the vehicle on a cable: where it is and how it moves, from a pendulum in simulation or from a
/// measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Load<S> {
    /// Position, m, world.
    pub position_m: [S; 3],
    /// Velocity, m/s, world.
    pub velocity_m_s: [S; 3],
    /// Acceleration, m/s², world.
    pub acceleration_m_s2: [S; 3],
    /// 1 where there is a load, 0 where there is none.
    pub present: S,
}

impl<S: Real> Load<S> {
    /// No load.
    pub fn absent() -> Self {
        let zero = S::zero();
        Self { position_m: [zero; 3], velocity_m_s: [zero; 3], acceleration_m_s2: [zero; 3], present: zero }
    }
}

/// Distance to the ground that stands for "no ground below", m.
pub const NO_GROUND_M: f64 = 1e6;

/// Distance to the ceiling that stands for "no ceiling above", m.
pub const NO_CEILING_M: f64 = 1e6;

/// Which of the [`Surroundings`] an effect reads, so that whoever flies a vehicle fills them. Time, density of the air, loads and
/// what the user sets as disturbances are always there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Reads {
    /// [`Surroundings::ground_distance_m`].
    pub ground: bool,
    /// [`Surroundings::ceiling_distance_m`].
    pub ceiling: bool,
    /// [`Surroundings::neighbours`].
    pub neighbours: bool,
    /// [`Surroundings::wind_m_s`], also by velocities through the air.
    pub wind: bool,
    /// [`Surroundings::normals`].
    pub noise: bool,
}

impl Reads {
    /// Reads nothing of all that.
    pub const NOTHING: Self =
        Self { ground: false, ceiling: false, neighbours: false, wind: false, noise: false };
    /// Reads the ground alone.
    pub const GROUND: Self = Self { ground: true, ..Self::NOTHING };
    /// Reads the ceiling alone.
    pub const CEILING: Self = Self { ceiling: true, ..Self::NOTHING };
    /// Reads the other vehicles alone.
    pub const NEIGHBOURS: Self = Self { neighbours: true, ..Self::NOTHING };
    /// Reads the wind alone.
    pub const WIND: Self = Self { wind: true, ..Self::NOTHING };
    /// Reads random numbers alone.
    pub const NOISE: Self = Self { noise: true, ..Self::NOTHING };

    /// What one of two reads.
    pub fn or(self, other: Self) -> Self {
        Self {
            ground: self.ground || other.ground,
            ceiling: self.ceiling || other.ceiling,
            neighbours: self.neighbours || other.neighbours,
            wind: self.wind || other.wind,
            noise: self.noise || other.noise,
        }
    }
}

/// Surroundings of one vehicle during one step.
#[derive(Clone, Copy, Debug)]
pub struct Surroundings<'a, S> {
    /// Time since the last reset, s.
    pub time_s: S,
    /// Air density, kg/m³.
    pub air_density_kg_m3: S,
    /// Velocity of the air, m/s, world, before effects add to it.
    pub wind_m_s: [S; 3],
    /// Height of the centre of mass above what lies below it, m; [`NO_GROUND_M`] without ground.
    pub ground_distance_m: S,
    /// Distance from the centre of mass up to what lies above it, m; [`NO_CEILING_M`] without ceiling.
    pub ceiling_distance_m: S,
    /// Disturbance force set by the user, N, world.
    pub disturbance_force_n: [S; 3],
    /// Disturbance torque set by the user, N·m, world.
    pub disturbance_torque_n_m: [S; 3],
    /// Voltage of the vehicle's battery where it is measured, V; 0 where effects model it themselves.
    pub battery_v: S,
    /// The other vehicles of this world.
    pub neighbours: &'a [Neighbour<S>],
    /// The load on the vehicle's cable; what the caller fills in goes before what an effect computes.
    pub load: Load<S>,
    /// What the vehicle is commanded, in the numbers and units of its control mode; empty where that is not known.
    pub command: &'a [S],
    /// Standard normal numbers of this step, where an effect reads them ([`Reads::noise`]): three for turbulence, three for expressions.
    pub normals: [S; 6],
    /// What the vehicle's effects remember.
    pub memory: Remembered<'a, S>,
}

/// What the effects of a vehicle remember, as they left it in this step.
#[derive(Clone, Copy, Debug)]
pub struct Remembered<'a, S> {
    /// The numbers of all effects, in their order; empty where they are not known.
    pub numbers: &'a [S],
    /// Length of a step, s, with which their number goes.
    pub step_s: f64,
}

/// Density of air at sea level, 15 °C: ISO 2533 standard atmosphere, kg/m³.
pub const AIR_DENSITY_KG_M3: f64 = 1.225;

impl<S: Real> Surroundings<'_, S> {
    /// Still air of standard density, nothing near.
    pub fn calm() -> Self {
        let zero = S::zero();
        Self {
            time_s: zero,
            air_density_kg_m3: S::lit(AIR_DENSITY_KG_M3),
            wind_m_s: [zero; 3],
            ground_distance_m: S::lit(NO_GROUND_M),
            ceiling_distance_m: S::lit(NO_CEILING_M),
            disturbance_force_n: [zero; 3],
            disturbance_torque_n_m: [zero; 3],
            battery_v: zero,
            neighbours: &[],
            load: Load::absent(),
            command: &[],
            normals: [zero; 6],
            memory: Remembered { numbers: &[], step_s: 0.0 },
        }
    }
}
