//! Flight stacks in the loop: PX4, ArduPilot or Betaflight runs the controller, Propwash is the vehicle, the world and the sensors
//! (SITL, "software in the loop"; `docs/sitl.md`).
//!
//! A [`Server`] opens the port that the stack expects. Each [`Server::step`] is one exchange: the vehicle flies by the motors that the
//! stack commanded last, sensors are sent, and the answer is waited for (lockstep). Messages are made and read by
//! [`crate::autopilot`].

mod ardupilot;
mod betaflight;
mod config;
mod error;
mod link;
mod plant;
mod px4;
mod record;
mod sensors;

use std::net::SocketAddr;

pub use config::{SitlConfig, ThrottleLaw};
pub use error::SitlError;
pub use link::Company;
pub use sensors::{Barometer, Gps, Magnetometer, SensorNoise};

use crate::autopilot::{Stack, Truth};
use plant::Plant;

/// The vehicle touched something.
#[derive(Clone, Debug, PartialEq)]
pub struct Touch {
    /// When, s.
    pub time_s: f64,
    /// What it touched.
    pub what: String,
    /// How fast it was, m/s.
    pub speed_m_s: f64,
    /// Whether it stands on it now; else it was stopped in the direction of it.
    pub stands: bool,
}

/// What went over the link so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Commands of motors that came.
    pub commands: u64,
    /// Messages of other kinds.
    pub others: u64,
    /// Packets that are none of the protocol, and bytes between messages of PX4.
    pub malformed: u64,
    /// Commands that came too late, or in answer to something before.
    pub stale: u64,
    /// Packets that were lost, as far as their numbers say, and states that were sent again.
    pub lost: u64,
    /// How often the stack began anew.
    pub restarts: u64,
}

/// What all three have in common.
struct Common {
    config: SitlConfig,
    plant: Plant,
    traffic: Traffic,
    touches: Vec<Touch>,
    /// What the motors do, 0 to 1, in the order of the stack.
    shares: Vec<f64>,
    armed: bool,
    pace: link::Pace,
}

/// Touches that are kept: more tell nothing new.
const MOST_TOUCHES: usize = 1000;

impl Common {
    /// Flies one exchange by the motors as they are.
    fn advance(&mut self, company: &mut Company) -> Result<(), SitlError> {
        if let Some(touch) = self.plant.advance(&self.shares)? {
            if !touch.stands {
                (company.say)(&format!(
                    "at {:.3} s the vehicle hit {} at {:.1} m/s; contacts are not solved: it was stopped in that direction",
                    touch.time_s, touch.what, touch.speed_m_s
                ));
            }
            if self.touches.len() < MOST_TOUCHES {
                self.touches.push(touch);
            }
        }
        Ok(())
    }

    /// Puts everything back to the start.
    fn restart(&mut self) -> Result<(), SitlError> {
        self.traffic.restarts += 1;
        self.shares.fill(0.0);
        self.armed = false;
        self.pace.restart();
        self.plant.reset()
    }

    /// How long the stack may say nothing.
    fn limit(&self) -> Option<std::time::Duration> {
        let t = self.config.timeout_s;
        (t > 0.0).then(|| std::time::Duration::from_secs_f64(t))
    }

    /// Takes over commands for the first motors.
    fn command(&mut self, shares: impl IntoIterator<Item = f64>) {
        self.traffic.commands += 1;
        self.shares.iter_mut().zip(shares).for_each(|(to, share)| *to = share);
    }
}

/// The side of one stack.
enum Session {
    Px4(Box<px4::Session>),
    ArduPilot(Box<ardupilot::Session>),
    Betaflight(Box<betaflight::Session>),
}

/// A simulator that a flight stack flies in.
///
/// ```no_run
/// use propwash::sitl::{Company, Server, SitlConfig};
///
/// let mut server = Server::bind(SitlConfig::default())?;
/// let mut company = Company { stop: &|| false, say: &mut |words| eprintln!("{words}") };
/// while server.time_s() < 60.0 {
///     server.step(&mut company)?;
/// }
/// println!("{:?}", server.truth().pos_m);
/// # Ok::<(), propwash::Error>(())
/// ```
pub struct Server {
    common: Common,
    session: Session,
}

impl std::fmt::Debug for Server {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Server").field("config", &self.common.config).finish_non_exhaustive()
    }
}

impl Server {
    /// Builds the simulation and opens the port; nobody is waited for yet.
    ///
    /// # Errors
    /// [`SitlError`] for options that make no sense, a vehicle or scene that cannot be used, rotors in no order that the stack knows, and
    /// a port that cannot be opened.
    pub fn bind(config: SitlConfig) -> Result<Self, SitlError> {
        config.check()?;
        let plant = Plant::new(&config)?;
        let n_rotors = plant.n_rotors();
        let session = match config.stack {
            Stack::Px4 => Session::Px4(Box::new(px4::Session::bind(config.listens())?)),
            Stack::ArduPilot => Session::ArduPilot(Box::new(ardupilot::Session::bind(config.listens())?)),
            Stack::Betaflight => Session::Betaflight(Box::new(betaflight::Session::bind(&config)?)),
        };
        let common = Common {
            pace: link::Pace::new(config.speed),
            shares: vec![0.0; n_rotors],
            traffic: Traffic::default(),
            touches: Vec::new(),
            armed: false,
            plant,
            config,
        };
        Ok(Self { common, session })
    }

    /// Where it listens.
    ///
    /// # Errors
    /// [`SitlError::Connection`] where the system does not say.
    pub fn address(&self) -> Result<SocketAddr, SitlError> {
        let address = match &self.session {
            Session::Px4(s) => s.address(),
            Session::ArduPilot(s) => s.address(),
            Session::Betaflight(s) => s.address(),
        };
        address.map_err(|source| SitlError::Connection { peer: "own port".into(), source })
    }

    /// One exchange. Waits for the stack: for ever until it first says something, up to the time-out after that; `company` ends it.
    ///
    /// # Errors
    /// [`SitlError`]: a stack that goes or says nothing, a port at which something else talks, a simulation that diverges, and
    /// [`SitlError::Interrupted`].
    pub fn step(&mut self, company: &mut Company) -> Result<(), SitlError> {
        let common = &mut self.common;
        match &mut self.session {
            Session::Px4(s) => s.step(common, company),
            Session::ArduPilot(s) => s.step(common, company),
            Session::Betaflight(s) => s.step(common, company),
        }
    }

    /// Sends sticks to Betaflight, µs; channels that are not given are in the middle, the throttle is low.
    ///
    /// # Errors
    /// [`SitlError::Option`] for another stack, for more than 16 channels and for pulses that are none.
    pub fn send_rc(&mut self, channels_us: &[u16]) -> Result<(), SitlError> {
        match &mut self.session {
            Session::Betaflight(s) => s.send_rc(&self.common, channels_us),
            _ => {
                let stack = self.common.config.stack.title();
                let got = format!("{stack}, which has links of its own for sticks");
                Err(SitlError::option("sticks", "Betaflight", got))
            }
        }
    }

    /// The description.
    pub fn config(&self) -> &SitlConfig {
        &self.common.config
    }

    /// Simulated time since the start, s.
    pub fn time_s(&self) -> f64 {
        self.common.plant.time_s()
    }

    /// Exchanges per second.
    pub fn rate_hz(&self) -> u32 {
        self.common.plant.rate_hz()
    }

    /// Where the vehicle truly is.
    pub fn truth(&self) -> Truth {
        self.common.plant.truth()
    }

    /// Rotor speeds, rad/s, in the order of the vehicle.
    pub fn rotor_vel(&self) -> &[f64] {
        self.common.plant.rotor_vel()
    }

    /// What the stack's motors do, 0 to 1, in its order.
    pub fn commands(&self) -> &[f64] {
        &self.common.shares
    }

    /// For each motor of the stack the rotor of the vehicle that it drives.
    pub fn motors(&self) -> &[usize] {
        self.common.plant.order()
    }

    /// Whether PX4 is armed; of the others, whether any motor is on.
    pub fn is_armed(&self) -> bool {
        self.common.armed
    }

    /// Whether the ground carries the vehicle.
    pub fn is_standing(&self) -> bool {
        self.common.plant.is_standing()
    }

    /// What the vehicle touched so far, the first thousand times.
    pub fn touches(&self) -> &[Touch] {
        &self.common.touches
    }

    /// What went over the link so far.
    pub fn traffic(&self) -> Traffic {
        self.common.traffic
    }

    /// Writes out the record of the flight; dropping the server does so too, but cannot say what fails.
    ///
    /// # Errors
    /// [`SitlError::Record`].
    pub fn finish(&mut self) -> Result<(), SitlError> {
        self.common.plant.finish()
    }
}
