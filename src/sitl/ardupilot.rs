//! ArduPilot's side: pulses in, a line of JSON out.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use super::link::{Udp, Wait};
use super::{Common, Company, SitlError};
use crate::autopilot::ardupilot::{Order, Outputs, control, decode, encode, order};

/// After so long without a word from one ArduPilot, another may have its place.
const GONE: Duration = Duration::from_secs(2);
/// Packets that are none of ArduPilot's, before the first that is, after which something else talks here.
const MOST_FOREIGN: u64 = 100;

pub(super) struct Session {
    link: Udp,
    /// Who was answered last, and when it was heard.
    peer: Option<(SocketAddr, Instant)>,
    /// Number of the last packet.
    count: Option<u32>,
    answer: String,
    told_foreign: bool,
    told_second: bool,
}

impl Session {
    pub fn bind(address: SocketAddr) -> Result<Self, SitlError> {
        let link = Udp::bind(address)?;
        Ok(Self {
            link,
            peer: None,
            count: None,
            answer: String::new(),
            told_foreign: false,
            told_second: false,
        })
    }

    pub fn address(&self) -> std::io::Result<SocketAddr> {
        self.link.address()
    }

    pub fn step(&mut self, common: &mut Common, company: &mut Company) -> Result<(), SitlError> {
        let at = self.link.address().map_or_else(|e| e.to_string(), |a| a.to_string());
        let remedy = "start its SITL with --model JSON:ADDRESS (docs/sitl.md)";
        let limit = if self.count.is_some() { common.limit() } else { None };
        let mut wait = Wait::new(format!("a packet of ArduPilot at UDP {at}"), remedy, limit);
        loop {
            wait.look(company)?;
            let slice = wait.slice();
            let Some((packet, from)) = self.link.receive(slice)? else { continue };
            let outputs = match decode(packet) {
                Ok(outputs) => outputs,
                Err(e) => {
                    common.traffic.malformed += 1;
                    if self.count.is_none() && common.traffic.malformed >= MOST_FOREIGN {
                        return Err(e.into());
                    }
                    if !core::mem::replace(&mut self.told_foreign, true) {
                        (company.say)(&format!("{e}, from {from}; such packets are passed over"));
                    }
                    continue;
                }
            };
            let Some(order) = self.order(from, &outputs, company) else {
                common.traffic.others += 1;
                continue;
            };
            self.peer = Some((from, Instant::now()));
            self.count = Some(outputs.frame_count);
            if order == Order::Again && !self.answer.is_empty() {
                common.traffic.stale += 1;
                self.link.send(self.answer.as_bytes(), from)?;
                continue;
            }
            return self.exchange(common, company, order, &outputs, from);
        }
    }

    /// What a packet means; none for one of a second ArduPilot while the first one talks.
    fn order(&mut self, from: SocketAddr, outputs: &Outputs, company: &mut Company) -> Option<Order> {
        let Some((peer, heard)) = self.peer else { return Some(Order::Start) };
        let order = order(self.count, outputs.frame_count);
        if from == peer {
            return Some(order);
        }
        // One that was started again has another port, and counts from its beginning.
        if !matches!(order, Order::Next { .. }) || heard.elapsed() > GONE {
            return Some(Order::Start);
        }
        if !core::mem::replace(&mut self.told_second, true) {
            (company.say)(&format!("{from} is passed over, since {peer} flies the vehicle"));
        }
        None
    }

    fn exchange(
        &mut self,
        common: &mut Common,
        company: &mut Company,
        order: Order,
        outputs: &Outputs,
        from: SocketAddr,
    ) -> Result<(), SitlError> {
        match order {
            Order::Start => {
                (company.say)(&format!("ArduPilot at {from} asks for {} Hz", outputs.frame_rate_hz));
                if common.plant.time_us() > 0 {
                    common.restart()?;
                }
                common.pace.restart();
            }
            Order::Next { lost } => common.traffic.lost += u64::from(lost),
            Order::Again => {}
        }
        if common.config.rate_hz.is_none() {
            common.plant.set_rate(u32::from(outputs.frame_rate_hz))?;
        }
        let range = common.config.pulses_us;
        common.command(outputs.pulses_us.iter().map(|pulse| control(*pulse, range)));
        common.armed = common.shares.iter().any(|share| *share > 0.0);
        common.advance(company)?;
        self.answer = encode(&common.plant.sensed()?, &common.plant.ranges_m()?);
        self.link.send(self.answer.as_bytes(), from)?;
        let now = common.plant.time_s();
        common.pace.hold(now, company)
    }
}
