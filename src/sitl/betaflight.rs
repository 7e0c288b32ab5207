//! Betaflight's side: states out, motors in.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use super::link::{Udp, Wait};
use super::{Common, Company, SitlConfig, SitlError};
use crate::autopilot::betaflight::{N_CHANNELS, decode_motors, encode_rc, encode_state};

/// How long an answer is waited for before the state is sent again.
const AGAIN: Duration = Duration::from_millis(100);

pub(super) struct Session {
    link: Udp,
    /// Where it hears states, and where sticks.
    state_to: SocketAddr,
    rc_to: SocketAddr,
    /// It has answered.
    heard: bool,
    told_foreign: bool,
}

impl Session {
    pub fn bind(config: &SitlConfig) -> Result<Self, SitlError> {
        let state_to = config.firmware;
        let Some(rc_port) = state_to.port().checked_add(1) else {
            let expected = "an address with a port below 65535, after which that of the sticks comes";
            return Err(SitlError::option("firmware", expected, state_to));
        };
        let rc_to = SocketAddr::new(state_to.ip(), rc_port);
        if state_to.is_ipv4() != config.address.is_ipv4() {
            let got = format!("{} and {state_to}", config.address);
            return Err(SitlError::option("address and firmware", "both of IPv4 or both of IPv6", got));
        }
        Ok(Self { link: Udp::bind(config.listens())?, state_to, rc_to, heard: false, told_foreign: false })
    }

    pub fn address(&self) -> std::io::Result<SocketAddr> {
        self.link.address()
    }

    pub fn send_rc(&mut self, common: &Common, channels_us: &[u16]) -> Result<(), SitlError> {
        if channels_us.len() > N_CHANNELS || channels_us.iter().any(|c| !(750..=2250).contains(c)) {
            let expected = format!("up to {N_CHANNELS} channels of 750 to 2250 µs");
            return Err(SitlError::option("sticks", expected, format!("{channels_us:?}")));
        }
        self.link.send(&encode_rc(common.plant.time_s(), channels_us), self.rc_to)
    }

    pub fn step(&mut self, common: &mut Common, company: &mut Company) -> Result<(), SitlError> {
        if !self.heard {
            // Time stands still until it answers.
            self.exchange(common, company)?;
            common.pace.restart();
            self.heard = true;
        }
        // What came since is in answer to an older state.
        while let Some(motors) = self.receive(common, company, Duration::ZERO)? {
            common.traffic.stale += u64::from(motors.is_some());
        }
        common.advance(company)?;
        self.exchange(common, company)?;
        let now = common.plant.time_s();
        common.pace.hold(now, company)
    }

    /// Sends the state until motors come.
    fn exchange(&mut self, common: &mut Common, company: &mut Company) -> Result<(), SitlError> {
        let state = encode_state(&common.plant.sensed()?, &common.config.home);
        let at = self.link.address().map_or_else(|e| e.to_string(), |a| a.to_string());
        let what = format!("the motors of Betaflight at UDP {at}, which gets states at {}", self.state_to);
        let remedy = "start betaflight_SITL with the address of this simulator (docs/sitl.md)";
        let limit = if self.heard { common.limit() } else { None };
        let mut wait = Wait::new(what, remedy, limit);
        let mut sent: Option<Instant> = None;
        loop {
            if sent.is_none_or(|at| at.elapsed() >= AGAIN) {
                common.traffic.lost += u64::from(sent.is_some() && self.heard);
                self.link.send(&state, self.state_to)?;
                sent = Some(Instant::now());
            }
            if let Some(Some(motors)) = self.receive(common, company, wait.slice())? {
                common.command(motors);
                common.armed = motors.iter().any(|m| *m > 0.0);
                return Ok(());
            }
            wait.look(company)?;
        }
    }

    /// The packet that comes within a time: none, one that is none of Betaflight's, or its motors.
    fn receive(
        &mut self,
        common: &mut Common,
        company: &mut Company,
        wait: Duration,
    ) -> Result<Option<Option<[f64; 4]>>, SitlError> {
        let Some((packet, from)) = self.link.receive(wait)? else { return Ok(None) };
        match decode_motors(packet) {
            Ok(motors) => Ok(Some(Some(motors))),
            Err(e) => {
                common.traffic.malformed += 1;
                if !core::mem::replace(&mut self.told_foreign, true) {
                    (company.say)(&format!("{e}, from {from}; such packets are passed over"));
                }
                Ok(Some(None))
            }
        }
    }
}
