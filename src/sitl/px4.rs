//! PX4's side: `HIL_SENSOR` out, `HIL_ACTUATOR_CONTROLS` in.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use super::link::{Got, Tcp, Wait};
use super::{Common, Company, SitlError};
use crate::autopilot::px4::{ActuatorControls, Message, Reader, STATE_QUATERNION, Writer};

/// Interval of `HIL_STATE_QUATERNION` until PX4 asks for another, µs: what it asks for.
const STATE_US: i64 = 5000;

pub(super) struct Session {
    link: Tcp,
    reader: Reader,
    writer: Writer,
    out: Vec<u8>,
    arrived: Vec<u8>,
    /// PX4 has answered, and waits for each `HIL_SENSOR`.
    lockstep: bool,
    /// Time between two `HIL_STATE_QUATERNION`, µs; below 0 none.
    state_us: i64,
    next_state_us: u64,
    next_beat_us: u64,
}

impl Session {
    pub fn bind(address: SocketAddr) -> Result<Self, SitlError> {
        Ok(Self {
            link: Tcp::bind(address)?,
            reader: Reader::default(),
            writer: Writer::default(),
            out: Vec::new(),
            arrived: Vec::new(),
            lockstep: false,
            state_us: STATE_US,
            next_state_us: 0,
            next_beat_us: 0,
        })
    }

    pub fn address(&self) -> std::io::Result<SocketAddr> {
        self.link.address()
    }

    pub fn step(&mut self, common: &mut Common, company: &mut Company) -> Result<(), SitlError> {
        loop {
            if self.link.peer().is_none() {
                self.connect(common, company)?;
            }
            match self.exchange(common, company) {
                Err(SitlError::Closed { .. }) if common.config.again => {
                    (company.say)("PX4 closed the connection; the vehicle is put back");
                    common.restart()?;
                }
                outcome => return outcome,
            }
        }
    }

    fn connect(&mut self, common: &mut Common, company: &mut Company) -> Result<(), SitlError> {
        let at = self.link.address().map_or_else(|e| e.to_string(), |a| a.to_string());
        let remedy = "start PX4's SITL for an external simulator (docs/sitl.md)";
        let mut wait = Wait::new(format!("PX4 to connect to TCP {at}"), remedy, None);
        while !self.link.accept()? {
            wait.look(company)?;
            std::thread::sleep(Duration::from_millis(5));
        }
        self.reader = Reader::default();
        self.writer = Writer::default();
        (self.lockstep, self.state_us) = (false, STATE_US);
        (self.next_state_us, self.next_beat_us) = (0, 0);
        if let Some(peer) = self.link.peer() {
            (company.say)(&format!("connected to {peer}"));
        }
        common.pace.restart();
        Ok(())
    }

    fn exchange(&mut self, common: &mut Common, company: &mut Company) -> Result<(), SitlError> {
        let began = Instant::now();
        // What came since the last answer is older than the sensors that go now.
        while self.receive(common, Duration::ZERO)? == Got::Data {
            while let Some(controls) = self.next_controls(common) {
                self.take(common, &controls);
                common.traffic.stale += u64::from(self.lockstep);
                self.lockstep |= controls.lockstep;
            }
        }
        common.advance(company)?;
        self.send(common)?;
        if !self.lockstep {
            // PX4 boots, or is built without lockstep: it gets sensors at the rate of the clock and is not waited for.
            let step = Duration::from_secs_f64(1.0 / f64::from(common.plant.rate_hz()));
            loop {
                company.look()?;
                let left = step.saturating_sub(began.elapsed());
                if left.is_zero() {
                    break;
                }
                self.receive(common, left.min(Duration::from_millis(50)))?;
                while let Some(controls) = self.next_controls(common) {
                    self.take(common, &controls);
                    self.lockstep = controls.lockstep;
                }
                if self.lockstep {
                    break;
                }
            }
            self.reader.check()?;
        } else {
            self.answer(common, company)?;
        }
        let now = common.plant.time_s();
        common.pace.hold(now, company)
    }

    /// Waits for the controls that answer the last sensors.
    fn answer(&mut self, common: &mut Common, company: &mut Company) -> Result<(), SitlError> {
        let sent_us = common.plant.time_us();
        let what = format!("HIL_ACTUATOR_CONTROLS of PX4 for the sensors of {:.3} s", common.plant.time_s());
        let remedy = "PX4 may have stopped, or answers less often than it gets sensors: give a lower rate (docs/sitl.md)";
        let mut wait = Wait::new(what, remedy, common.limit());
        loop {
            while let Some(controls) = self.next_controls(common) {
                // PX4 stamps its answer with the time of the sensors that it answers.
                if controls.time_us >= sent_us {
                    self.take(common, &controls);
                    self.lockstep = controls.lockstep;
                    return Ok(());
                }
                common.traffic.stale += 1;
            }
            wait.look(company)?;
            self.receive(common, wait.slice())?;
        }
    }

    fn take(&mut self, common: &mut Common, controls: &ActuatorControls) {
        common.armed = controls.armed;
        let share = |u: &f32| if controls.armed { f64::from(*u).clamp(0.0, 1.0) } else { 0.0 };
        common.command(controls.controls.iter().map(share));
    }

    /// The next controls of what has arrived; other messages are heard on the way.
    fn next_controls(&mut self, common: &mut Common) -> Option<ActuatorControls> {
        loop {
            match self.reader.next_message()? {
                Message::ActuatorControls(controls) => return Some(controls),
                Message::Interval { message: STATE_QUATERNION, interval_us } => {
                    self.state_us = if interval_us == 0 { STATE_US } else { interval_us };
                    common.traffic.others += 1;
                }
                Message::Interval { .. } | Message::Other(_) => common.traffic.others += 1,
            }
        }
    }

    fn receive(&mut self, common: &mut Common, wait: Duration) -> Result<Got, SitlError> {
        self.arrived.clear();
        let got = self.link.receive(wait, &mut self.arrived)?;
        self.reader.push(&self.arrived);
        common.traffic.malformed = common.traffic.malformed.max(self.reader.skipped());
        if got == Got::Closed {
            return Err(self.closed(common));
        }
        Ok(got)
    }

    fn closed(&mut self, common: &Common) -> SitlError {
        self.link.close();
        SitlError::Closed { stack: "PX4", time_s: common.plant.time_s() }
    }

    /// Sends what is due.
    fn send(&mut self, common: &mut Common) -> Result<(), SitlError> {
        let (plant, home) = (&common.plant, common.config.home);
        let now = plant.time_us();
        self.out.clear();
        if now >= self.next_beat_us {
            self.writer.heartbeat(&mut self.out);
            self.writer.system_time(1_000_000 * common.config.epoch_s + now, now, &mut self.out);
            self.next_beat_us = now + 1_000_000;
        }
        // The truth and the fix go before the sensors, which set PX4's clock and let it run.
        if let Ok(interval) = u64::try_from(self.state_us)
            && now >= self.next_state_us
        {
            self.writer.state(&plant.truth(), &home, &mut self.out);
            self.next_state_us = now + interval;
        }
        if let Some(fix) = plant.fix()? {
            self.writer.fix(&fix, &home, &mut self.out);
        }
        self.writer.sensors(&plant.sensors()?, &mut self.out);
        if self.link.send(&self.out)? { Ok(()) } else { Err(self.closed(common)) }
    }
}
