//! What may be missing in a model: an effect, which of its parameters are free, and how large they may be.
//!
//! Every parameter has two widths. The *spike* is its tolerance on a carefully measured vehicle: "the effect is absent"
//! means that the parameter stays within it. The *slab* is a plausible size where the effect is there. Spike-and-slab
//! priors: George & McCulloch, "Variable selection via Gibbs sampling", JASA 88(423), 1993.

use crate::drone::Drone;
use crate::rigid_body::MAX_ROTORS;

/// Which sign an effect's parameter can have, counted from its value in the vehicle file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Sign {
    /// Both.
    Any,
    /// Only larger than filed.
    Up,
    /// Only smaller than filed.
    Down,
}

/// One free parameter.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Freedom {
    /// Name as [`crate::params::Parameters::visit`] gives it, without the effect's prefix: `offset_m.0`.
    pub name: String,
    /// SI unit, `1` where it has none.
    pub unit: &'static str,
    /// Standard deviation about the filed value on a carefully built vehicle; 0 where the parameter is only free together
    /// with the effect.
    pub spike: f64,
    /// Standard deviation about the filed value where the effect is there.
    pub slab: f64,
    /// Which way it can go.
    pub sign: Sign,
    /// Whether the model divides by it: at zero a motor responds instantly and an empty mass flies off.
    pub divides: bool,
    /// Whether it shows in torques alone: it is only free where the rotors' speeds are known.
    pub in_torques: bool,
    /// What the vehicle file states of which this is a multiple.
    pub scales: Option<Filed>,
}

/// A value of vehicle files: what a factor multiplies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Filed {
    /// Mass.
    Mass,
    /// Moment of inertia about a body axis.
    Inertia(usize),
    /// Thrust of all rotors.
    Thrust,
    /// Torque of all rotors.
    Torque,
    /// Moment of inertia of the rotors.
    RotorInertia,
    /// Time in which rotors spin up.
    SpinUp,
    /// Time in which rotors spin down.
    SpinDown,
}

impl Freedom {
    fn new(name: String, unit: &'static str, (spike, slab): (f64, f64), sign: Sign) -> Self {
        Self { name, unit, spike, slab, sign, divides: false, in_torques: false, scales: None }
    }

    /// A parameter that can be off either way.
    pub fn any(name: impl Into<String>, unit: &'static str, spike: f64, slab: f64) -> Self {
        Self::new(name.into(), unit, (spike, slab), Sign::Any)
    }

    /// A parameter that can only be larger than filed.
    pub fn up(name: impl Into<String>, unit: &'static str, spike: f64, slab: f64) -> Self {
        Self::new(name.into(), unit, (spike, slab), Sign::Up)
    }

    /// A parameter that can only be smaller than filed.
    pub fn down(name: impl Into<String>, unit: &'static str, spike: f64, slab: f64) -> Self {
        Self::new(name.into(), unit, (spike, slab), Sign::Down)
    }

    /// The same, by which the model divides.
    #[must_use]
    pub fn dividing(mut self) -> Self {
        self.divides = true;
        self
    }

    /// The same, a multiple of what the file states.
    #[must_use]
    pub fn scaling(mut self, filed: Filed) -> Self {
        self.scales = Some(filed);
        self
    }

    /// The same, which shows in torques alone.
    #[must_use]
    pub fn in_torques(mut self) -> Self {
        self.in_torques = true;
        self
    }
}

/// Where a parameter may lie.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Least value allowed; −∞ for none.
    pub least: f64,
    /// Greatest value allowed; ∞ for none.
    pub most: f64,
    /// Whether the least value itself is refused.
    pub open: bool,
}

impl Bounds {
    /// Any number of at least `least`.
    pub const fn from(least: f64) -> Self {
        Self::within(least, f64::INFINITY)
    }

    /// Any number above `least`.
    pub const fn above(least: f64) -> Self {
        Self { open: true, ..Self::from(least) }
    }

    /// Any number from `least` to `most`.
    pub const fn within(least: f64, most: f64) -> Self {
        Self { least, most, open: false }
    }

    /// Any number above `least`, up to `most`.
    pub const fn above_to(least: f64, most: f64) -> Self {
        Self { least, most, open: true }
    }

    /// Whether a value is allowed.
    pub fn holds(&self, value: f64) -> bool {
        (self.least..=self.most).contains(&value) && !(self.open && value == self.least)
    }

    /// The bounds in words: `a number from 0 to 1`, `a number above 0`.
    pub fn words(&self) -> String {
        let word = if self.open { "above" } else { "from" };
        let from = Some(self.least).filter(|v| v.is_finite()).map(|v| format!(" {word} {v}"));
        let to = Some(self.most).filter(|v| v.is_finite()).map(|v| format!(" to {v}"));
        format!("a number{}{}", from.unwrap_or_default(), to.unwrap_or_default())
    }
}

/// Where on the vehicle an effect acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Area {
    /// Air on the airframe.
    Airframe,
    /// Mass properties.
    Mass,
    /// Rotors, motors, battery.
    Drive,
    /// Sensors and frames.
    Measurement,
}

/// What the data must hold for a candidate to be tried.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Needs {
    /// Nothing beyond a pose and what drives the vehicle.
    Nothing,
    /// Commands to the motors (not only measured rotor speeds).
    Commands,
    /// Rotor speeds or thrust that were measured, not commanded.
    MeasuredInputs,
    /// A ground of known height.
    Ground,
    /// A ceiling of known height.
    Ceiling,
    /// The position of another vehicle.
    Neighbour,
    /// The position of a load on a cable.
    Load,
    /// A gyroscope.
    Gyro,
    /// An accelerometer.
    Accelerometer,
    /// Commands to the motors, and the battery's voltage.
    Voltage,
}

/// What flights determine of several effects only beside each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Relative {
    /// Their ratios: mass, thrust, inertia, torque.
    Ratio,
    /// Times between them: commands, clocks of sensors.
    Time,
}

impl Relative {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Ratio, Self::Time];
}

/// Groups of parameters within tolerance, in a vehicle builder's words.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Group {
    /// One rotor otherwise than the next.
    Rotors,
    /// Moments of inertia.
    Inertia,
    /// Mass, and where its centre is.
    Mass,
    /// Thrust and torque over rotor speed.
    Curves,
    /// Air on the airframe.
    Air,
    /// Offsets and scales of sensors.
    Sensors,
    /// Times.
    Clocks,
}

impl Group {
    /// All of them, in the order in which they are shown.
    pub const ALL: [Self; 7] =
        [Self::Rotors, Self::Inertia, Self::Mass, Self::Curves, Self::Air, Self::Sensors, Self::Clocks];

    /// The group of effects that act here, unless they say otherwise.
    pub fn of(area: Area) -> Self {
        match area {
            Area::Mass => Self::Mass,
            Area::Drive => Self::Curves,
            Area::Airframe => Self::Air,
            Area::Measurement => Self::Sensors,
        }
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rotors => "rotors unequal",
            Self::Inertia => "inertia",
            Self::Mass => "mass and centre of mass",
            Self::Curves => "thrust and torque curves",
            Self::Air => "air",
            Self::Sensors => "sensor offsets",
            Self::Clocks => "clocks",
        }
    }

    /// Whether it describes the instruments of a log: the next flight may have other ones.
    pub fn of_the_log(self) -> bool {
        matches!(self, Self::Sensors | Self::Clocks)
    }
}

/// What a comparison of flights with a model must know of an effect beside its formula and its parameters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Nature {
    /// It describes the air or the limits of one flight, and no vehicle.
    pub of_the_flight: bool,
    /// Its parameters may differ between logs of one vehicle: instruments, weather, battery.
    pub differs_between_logs: bool,
    /// It is there or not: never written as a small correction of a vehicle.
    pub only_when_found: bool,
    /// It acts on torques alone, which are unknown where only a collective thrust is known.
    pub torques_only: bool,
    /// It scales weight, or the thrust against it: two such effects hover as well as none.
    pub scales_hover: bool,
    /// Its forces go with what it remembers ([`super::View::memory`]) or is commanded, which a comparison with logs does not follow.
    pub moved_by_memory: bool,
    /// It goes with time as a charge that is drawn does: a measured voltage of the battery decides in its place.
    pub goes_with_charge: bool,
    /// It is the battery: where commands follow from throttles and a measured voltage, it has acted already.
    pub is_battery: bool,
    /// What it is only known beside.
    pub relative: Option<Relative>,
    /// Group of its calibration; none: that of the area on which it acts.
    pub group: Option<Group>,
    /// Effects, by their names in verdicts, that it looks like where only a collective thrust is known.
    pub alike_by_thrust: &'static [&'static str],
    /// It goes with the mean speed of the rotors: known behind a thrust too, where that follows from measured speeds.
    pub by_mean_speed: bool,
}

/// A response of the vehicle that a candidate scales: it is known only as well as the rotors' speeds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Answer {
    /// Angular acceleration about a body axis.
    Torque(usize),
    /// Torque about body z while the rotors speed up.
    RotorAcceleration,
    /// Changes of the thrust with rotor speed.
    Thrust,
}

/// A value that a log gives before anything is fitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FromLog {
    /// Length of the cable of a tracked load, m.
    CableLength,
    /// Damping of its swing, 1/s.
    CableDamping,
    /// Fastest rotor command, rad/s: a limit shows where it is reached.
    FastestCommand,
    /// Frequency at which the disturbances are loudest, Hz.
    LoudestFrequency,
    /// Law of the battery's voltage: full, its resistance, and its fall with the charge.
    BatteryVoltage,
}

/// An effect that may be missing, with what is free in it.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Candidate {
    /// Name in verdicts: the effect's kind, with a suffix where one kind gives several (`weak_rotor.2`).
    pub id: String,
    /// The effect's kind.
    pub kind: &'static str,
    /// What it is, in plain words, lower case: `drag that grows with speed`.
    pub title: String,
    /// Where it acts.
    pub area: Area,
    /// What the data must hold.
    pub needs: Needs,
    /// Free parameters.
    pub freedoms: Vec<Freedom>,
    /// Values that parameters take while the effect is tried, where the default would hide the others (a frequency).
    pub preset: Vec<(String, f64)>,
    /// The manoeuvre that shows it best, in plain words: `fly fast and slow, level, in all directions`.
    pub manoeuvre: &'static str,
    /// Multiple of its parameters' slabs beyond which such an effect is not believed on the fit alone; ∞ where any size is
    /// possible.
    pub most_slabs: f64,
    /// The response that it scales.
    pub answer: Option<Answer>,
    /// Parameters that a log gives.
    pub from_log: Vec<(&'static str, FromLog)>,
}

impl Candidate {
    /// A candidate that needs nothing and is called after its kind.
    pub fn new(
        kind: &'static str,
        title: &str,
        area: Area,
        freedoms: Vec<Freedom>,
        manoeuvre: &'static str,
    ) -> Self {
        Self {
            id: kind.into(),
            kind,
            title: title.into(),
            area,
            needs: Needs::Nothing,
            freedoms,
            preset: Vec::new(),
            manoeuvre,
            most_slabs: f64::INFINITY,
            answer: None,
            from_log: Vec::new(),
        }
    }

    /// The same under a name of its own.
    #[must_use]
    pub fn called(mut self, id: &str) -> Self {
        self.id = id.into();
        self
    }

    /// The same with `.suffix` behind its name.
    #[must_use]
    pub fn part(mut self, suffix: impl core::fmt::Display) -> Self {
        self.id = format!("{}.{suffix}", self.kind);
        self
    }

    /// The same where the data must hold something.
    #[must_use]
    pub fn needing(mut self, needs: Needs) -> Self {
        self.needs = needs;
        self
    }

    /// The same, believed on the fit alone only up to so many slabs.
    #[must_use]
    pub fn at_most(mut self, slabs: f64) -> Self {
        self.most_slabs = slabs;
        self
    }

    /// The same, which scales a response of the vehicle.
    #[must_use]
    pub fn answering(mut self, answer: Answer) -> Self {
        self.answer = Some(answer);
        self
    }

    /// The same with a parameter whose value a log gives.
    #[must_use]
    pub fn given_by(mut self, name: &'static str, value: FromLog) -> Self {
        self.from_log.push((name, value));
        self
    }

    /// The parameter that a log gives in this way.
    pub fn given(&self, value: FromLog) -> Option<&'static str> {
        self.from_log.iter().find(|(_, v)| *v == value).map(|(name, _)| *name)
    }

    /// The same with a parameter that takes `value` while the effect is tried.
    #[must_use]
    pub fn preset(mut self, name: &str, value: f64) -> Self {
        self.preset.push((name.into(), value));
        self
    }
}

/// Sizes of a vehicle that the sizes of effects go with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// Mass with all that is fixed to the vehicle, kg.
    pub mass_kg: f64,
    /// Its weight, N.
    pub weight_n: f64,
    /// Mean speed of the rotors in hover, rad/s.
    pub hover_rad_s: f64,
    /// Sum of the speeds of the rotors in hover, rad/s.
    pub speed_sum_rad_s: f64,
    /// Mean radius of the rotors, m.
    pub radius_m: f64,
    /// Number of rotors, at least 1.
    pub n_rotors: f64,
    /// Rotor radius over that of a 5 inch propeller, 1: what lengths on the airframe go with.
    pub size: f64,
}

/// Radius of a 5 inch propeller, m.
const FIVE_INCH_M: f64 = 0.0635;

impl Scale {
    /// The sizes of `drone`.
    pub fn of(drone: &Drone<f64>) -> Self {
        let used = drone.airframe.n_rotors.min(MAX_ROTORS);
        let n_rotors = used.max(1) as f64;
        let speed_sum_rad_s: f64 = drone.hover_rotor_vel()[..used].iter().sum();
        let radius_m = drone.airframe.rotors[..used].iter().map(|r| r.radius_m).sum::<f64>() / n_rotors;
        Self {
            mass_kg: drone.parts().body.mass_kg,
            weight_n: drone.hover_thrust(),
            hover_rad_s: speed_sum_rad_s / n_rotors,
            speed_sum_rad_s,
            radius_m,
            n_rotors,
            size: radius_m / FIVE_INCH_M,
        }
    }
}

/// Two or three freedoms of one kind along the axes of an array parameter: `name.0`, `name.1` …
pub fn along(
    name: &str,
    axes: core::ops::Range<usize>,
    unit: &'static str,
    (spike, slab): (f64, f64),
) -> Vec<Freedom> {
    axes.map(|i| Freedom::any(format!("{name}.{i}"), unit, spike, slab)).collect()
}
