//! Three flights for those without a log. The program flies them itself, by the simulator: a vehicle with one effect that its file does not
//! have, and sensors with noise. So they show what the lab does, and prove nothing about real flights.

use super::answer::Refusal;
use crate::flight::FlightLog;
use crate::gap::Drive;
use crate::gap::excite::{Request, rehearse};
use crate::vehicle::Vehicle;

/// The vehicle of all of them: a 2 kg quadrotor.
const VEHICLE: &str = "hb_x500";

/// A flight with a hidden effect.
#[derive(Debug)]
pub struct Example {
    /// Name in requests.
    pub name: &'static str,
    /// What the page calls it.
    pub title: &'static str,
    /// One sentence.
    pub about: &'static str,
    /// Text of the effect that the file lacks.
    hidden: &'static str,
    manoeuvres: &'static [&'static str],
    /// Seed of noise and turbulence.
    seed: u64,
}

/// The examples, in the order of the page.
pub const EXAMPLES: &[Example] = &[
    Example {
        name: "rotor_drag",
        title: "Hidden rotor drag",
        about: "The rotors drag when they move sideways; the vehicle file does not know it.",
        hidden: "kind = \"rotor_drag\"\ndrag_n_s2_per_rad_m = 1.2e-4\n",
        manoeuvres: &[
            "fast eight",
            "legs at four headings",
            "multi-sine",
            "quick eight",
            "climbing diagonals",
            "hard climbs",
            "slow eight",
            "circle nose first",
        ],
        seed: 5,
    },
    Example {
        name: "slung_payload",
        title: "Hidden slung payload",
        about: "A load swings under the vehicle on a cable, and was tracked; the vehicle file does not know it.",
        hidden: "kind = \"slung_payload\"\nmass_kg = 0.25\ncable_length_m = 0.6\nattachment_m = [0.0, 0.0, -0.03]\ndamping_per_s = 0.2\n",
        manoeuvres: &[
            "quick eight",
            "legs at four headings",
            "multi-sine",
            "fast legs x",
            "fast legs y",
            "vertical oscillation",
        ],
        seed: 12,
    },
    Example {
        name: "constant_wind",
        title: "Hidden wind",
        about: "A steady wind blows that nobody measured; the model flies in still air.",
        hidden: "kind = \"constant_wind\"\nvelocity_m_s = [1.6, -0.9, 0.0]\n",
        manoeuvres: &[
            "hover at four headings",
            "fast eight",
            "legs at four headings",
            "multi-sine",
            "quick eight",
            "yaw spin",
        ],
        seed: 13,
    },
];

/// The example of a name.
///
/// # Errors
/// Where there is none of that name.
pub fn named(name: &str) -> Result<&'static Example, Refusal> {
    let known = || EXAMPLES.iter().map(|e| e.name).collect::<Vec<_>>().join(", ");
    let found = EXAMPLES.iter().find(|e| e.name == name);
    found.ok_or_else(|| Refusal::missing(format!("expected one of {}, got `{name}`", known())))
}

impl Example {
    /// Its vehicle as filed: the name, which is built in, and the vehicle.
    ///
    /// # Errors
    /// Those of vehicle files.
    pub fn vehicle(&self) -> Result<(&'static str, Vehicle), Refusal> {
        Ok((VEHICLE, Vehicle::builtin(VEHICLE)?))
    }

    /// Flies it.
    ///
    /// # Errors
    /// Those of [`rehearse`].
    pub fn fly(&self) -> Result<FlightLog, Refusal> {
        let (_, vehicle) = self.vehicle()?;
        let text = format!("{}\n[[effect]]\n{}", vehicle.to_toml(), self.hidden);
        let truth = Vehicle::from_toml("the example", &text)?;
        let request = Request {
            seed: self.seed,
            drive: Drive::RotorCommands,
            box_m: [10.0, 10.0, 5.0],
            ..Request::default()
        };
        let names: Vec<String> = self.manoeuvres.iter().map(|n| (*n).to_string()).collect();
        Ok(rehearse(&vehicle, &truth, &request, &names)?)
    }
}
