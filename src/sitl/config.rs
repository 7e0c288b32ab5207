//! What a server is told.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::{SensorNoise, SitlError};
use crate::arena::{ArenaError, DroneConfig, SceneConfig, SensorConfig};
use crate::autopilot::earth::Home;
use crate::autopilot::{Stack, ardupilot, betaflight};

/// From the share of full power that a stack commands, 0 to 1, to the speed at which a motor settles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ThrottleLaw {
    /// Speed in proportion to the share: as the simulators of PX4 (Gazebo's motor model) and Betaflight do.
    Speed,
    /// Thrust in proportion to the share, by the thrust curve of the rotor.
    Thrust,
    /// The law of the vehicle file (`[throttle]`, docs/throttle.md), at the nominal voltage of its battery.
    Vehicle,
}

/// A flight stack, the vehicle that it flies, and the world in which it does.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct SitlConfig {
    /// The stack.
    pub stack: Stack,
    /// The vehicle, by first principles.
    pub drone: DroneConfig,
    /// The scene; none is level ground.
    pub scene: Option<SceneConfig>,
    /// The vehicle starts on what is below this point, m, world.
    pub start_m: [f64; 3],
    /// Where its nose points at the start, degrees from north to the east; north is the world's x axis.
    pub heading_deg: f64,
    /// Address at which the simulator listens.
    pub address: IpAddr,
    /// Port; none is that of the stack, 0 any that is free.
    pub port: Option<u16>,
    /// Where Betaflight hears states; it hears sticks at the next port.
    pub firmware: SocketAddr,
    /// Exchanges per second; none is the rate of the stack, for ArduPilot what it asks for.
    pub rate_hz: Option<u32>,
    /// Steps of the simulation in each exchange; none is as many as it needs for 1000 Hz.
    pub substeps: Option<u32>,
    /// Where on Earth the vehicle starts.
    pub home: Home,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Simulated seconds for each second, at most; 0 is as fast as the stack answers.
    pub speed: f64,
    /// How long the stack may say nothing once it has begun, s; 0 is for ever.
    pub timeout_s: f64,
    /// What commands mean; none is the law of the vehicle file where it has one, else speed.
    pub throttle: Option<ThrottleLaw>,
    /// Rotor speed at full power, rad/s, for the law of speed; none is that of the greatest thrust in the vehicle file.
    pub max_speed_rad_s: Option<f64>,
    /// For each motor of the stack the rotor that it drives; none is by where rotors stand and how they turn.
    pub motors: Option<Vec<usize>>,
    /// Pulse widths of ArduPilot's outputs at no and at full power, µs.
    pub pulses_us: [u16; 2],
    /// Errors of sensors; none is [`SensorNoise::typical`] for PX4, which takes sensors that repeat a value for broken, and no errors for
    /// the others, of which ArduPilot adds errors of its own.
    pub noise: Option<SensorNoise>,
    /// Range finders, in the order in which ArduPilot hears them as `rng_1` to `rng_6`.
    pub sensors: Vec<SensorConfig>,
    /// Seconds from 1970 to the start of the simulation, which PX4 takes as the time of day.
    pub epoch_s: u64,
    /// When the stack goes, put the vehicle back and wait for it again; else that is an error.
    pub again: bool,
    /// A log of what flies (docs/logs.md).
    pub record: Option<PathBuf>,
    /// Whether a file may be replaced by it.
    pub replace: bool,
}

impl Default for SitlConfig {
    /// PX4 with the built-in X500, at the rate of the clock.
    fn default() -> Self {
        let loopback = IpAddr::V4(Ipv4Addr::LOCALHOST);
        Self {
            stack: Stack::Px4,
            drone: DroneConfig {
                vehicle: crate::arena::VehicleSource::Named("hb_x500".into()),
                ..DroneConfig::default()
            },
            scene: None,
            start_m: [0.0, 0.0, 1.0],
            heading_deg: 0.0,
            address: loopback,
            port: None,
            firmware: SocketAddr::new(loopback, betaflight::PORT_STATE),
            rate_hz: None,
            substeps: None,
            home: Home::default(),
            seed: 0,
            speed: 1.0,
            timeout_s: 30.0,
            throttle: None,
            max_speed_rad_s: None,
            motors: None,
            pulses_us: [1000, 2000],
            noise: None,
            sensors: Vec::new(),
            // 2025-01-01, the first day of the World Magnetic Model 2025.
            epoch_s: 1_735_689_600,
            again: false,
            record: None,
            replace: false,
        }
    }
}

/// Most exchanges per second, and most steps of the simulation in one.
const MOST_HZ: u32 = 10_000;

impl SitlConfig {
    /// Reads a description in JSON or TOML.
    ///
    /// # Errors
    /// [`ArenaError::Config`], saying where, what was expected and what was found.
    pub fn from_text(text: &str) -> Result<Self, ArenaError> {
        crate::arena::read_text(text)
    }

    /// The port on which the simulator listens.
    pub fn listens(&self) -> SocketAddr {
        SocketAddr::new(self.address, self.port.unwrap_or(self.stack.port()))
    }

    /// The rate at which it begins, Hz.
    pub fn first_rate_hz(&self) -> u32 {
        self.rate_hz.unwrap_or(self.stack.rate_hz())
    }

    /// Errors of the sensors.
    pub fn sensor_noise(&self) -> SensorNoise {
        let otherwise = match self.stack {
            Stack::Px4 => SensorNoise::typical(),
            Stack::ArduPilot | Stack::Betaflight => SensorNoise::default(),
        };
        self.noise.unwrap_or(otherwise)
    }

    /// Refuses numbers that make no sense.
    ///
    /// # Errors
    /// [`SitlError::Option`], [`SitlError::Protocol`] for the home, [`SitlError::Arena`] for the noise.
    pub fn check(&self) -> Result<(), SitlError> {
        if let Some(hz) = self.rate_hz.filter(|hz| !(1..=MOST_HZ).contains(hz)) {
            return Err(SitlError::option("rate_hz", format!("1 to {MOST_HZ} exchanges per second"), hz));
        }
        if let Some(n) = self.substeps.filter(|n| !(1..=100).contains(n)) {
            return Err(SitlError::option("substeps", "1 to 100 steps in each exchange", n));
        }
        for (name, value) in [("speed", self.speed), ("timeout_s", self.timeout_s)] {
            if !(0.0..=1e6).contains(&value) {
                return Err(SitlError::option(name, "a number from 0 to 1e6", value));
            }
        }
        if let Some(speed) = self.max_speed_rad_s.filter(|v| !(v.is_finite() && *v > 0.0)) {
            return Err(SitlError::option("max_speed_rad_s", "a rotor speed above 0 rad/s", speed));
        }
        if self.max_speed_rad_s.is_some() && !matches!(self.throttle, Some(ThrottleLaw::Speed) | None) {
            return Err(SitlError::option(
                "max_speed_rad_s",
                "the throttle law speed, whose full power it is",
                "another law",
            ));
        }
        let [low, high] = self.pulses_us;
        if low >= high || high > 5000 {
            return Err(SitlError::option(
                "pulses_us",
                "two pulse widths in order, up to 5000 µs",
                format!("{low},{high}"),
            ));
        }
        if !(self.start_m.iter().all(|x| x.abs() <= 1e6) && self.heading_deg.abs() <= 360.0) {
            let got = format!("{:?} and {}", self.start_m, self.heading_deg);
            return Err(SitlError::option(
                "start_m and heading_deg",
                "a place within 1e6 m and -360 to 360°",
                got,
            ));
        }
        if self.sensors.len() > ardupilot::MOST_RANGES {
            let expected = format!("at most {} range finders", ardupilot::MOST_RANGES);
            return Err(SitlError::option("sensors", expected, self.sensors.len()));
        }
        if let Some(other) = self.sensors.iter().find(|s| !matches!(s, SensorConfig::RangeFinder(_))) {
            return Err(SitlError::option("sensors", "sensors of the kind range_finder", other.name()));
        }
        if !self.sensors.is_empty() && self.stack != Stack::ArduPilot {
            let got = format!("{} for {}", self.sensors.len(), self.stack.title());
            return Err(SitlError::option("sensors", "range finders for ArduPilot alone", got));
        }
        if self.again && self.stack != Stack::Px4 {
            let got = format!("{}, which is always waited for anew", self.stack.title());
            return Err(SitlError::option("again", "PX4, whose connection can end", got));
        }
        self.home.check()?;
        self.sensor_noise().check().map_err(|e| SitlError::from(ArenaError::from(e)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_description_is_read_and_written() {
        let config = SitlConfig::from_text(
            "stack = \"ardupilot\"\nrate_hz = 400\nthrottle = \"thrust\"\nmotors = [1, 0, 2, 3]\n[home]\nlat_deg = -35.0\n[noise]\nbarometer_pa = 2.0",
        )
        .unwrap();
        assert_eq!(
            (config.stack, config.rate_hz, config.throttle),
            (Stack::ArduPilot, Some(400), Some(ThrottleLaw::Thrust))
        );
        assert_eq!(
            (config.home.lat_deg, config.home.alt_m, config.sensor_noise().barometer_pa),
            (-35.0, 488.0, 2.0)
        );
        assert_eq!(config.listens().to_string(), "127.0.0.1:9002");
        let text = serde_json::to_string(&config).unwrap();
        assert_eq!(SitlConfig::from_text(&text).unwrap(), config);
        assert!(SitlConfig::from_text("stack = \"inav\"").unwrap_err().to_string().contains("px4"));
        assert!(SitlConfig::from_text("sped = 2.0").unwrap_err().to_string().contains("speed"));
    }

    #[test]
    fn what_makes_no_sense_is_refused_by_its_name() {
        let fine = SitlConfig::default();
        fine.check().unwrap();
        let range = || vec![SensorConfig::RangeFinder(Default::default())];
        for (bad, words) in [
            (SitlConfig { rate_hz: Some(0), ..fine.clone() }, "rate_hz"),
            (SitlConfig { substeps: Some(1000), ..fine.clone() }, "substeps"),
            (SitlConfig { speed: f64::NAN, ..fine.clone() }, "speed"),
            (SitlConfig { timeout_s: -1.0, ..fine.clone() }, "timeout_s"),
            (SitlConfig { max_speed_rad_s: Some(0.0), ..fine.clone() }, "max_speed_rad_s"),
            (
                SitlConfig {
                    max_speed_rad_s: Some(1.0),
                    throttle: Some(ThrottleLaw::Thrust),
                    ..fine.clone()
                },
                "another law",
            ),
            (SitlConfig { pulses_us: [2000, 1000], ..fine.clone() }, "pulses_us"),
            (SitlConfig { heading_deg: 1e3, ..fine.clone() }, "heading_deg"),
            (SitlConfig { sensors: range(), ..fine.clone() }, "ArduPilot alone"),
            (
                SitlConfig { sensors: vec![SensorConfig::Imu(Default::default())], ..fine.clone() },
                "range_finder",
            ),
            (SitlConfig { again: true, stack: Stack::ArduPilot, ..fine.clone() }, "again"),
            (SitlConfig { home: Home { lat_deg: 95.0, ..Home::default() }, ..fine.clone() }, "latitude"),
            (
                SitlConfig {
                    noise: Some(SensorNoise { gps_vertical_m: -1.0, ..SensorNoise::default() }),
                    ..fine.clone()
                },
                "gps_vertical_m",
            ),
        ] {
            let said = bad.check().unwrap_err().to_string();
            assert!(said.contains(words), "{words}: {said}");
        }
    }
}
