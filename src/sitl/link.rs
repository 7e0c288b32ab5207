//! Sockets: the only file that opens any.

use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::time::{Duration, Instant};

use super::SitlError;

/// How long a wait lasts at most before it is looked whether it shall end.
const LOOK: Duration = Duration::from_millis(50);
/// How often a wait is told of.
const TELL: Duration = Duration::from_secs(10);

/// Who waits with us: ends waits, and hears what is waited for.
pub struct Company<'a> {
    /// Whether to end whatever waits; asked at least every 50 ms.
    pub stop: &'a dyn Fn() -> bool,
    /// Hears what is waited for, at once and every ten seconds, and what is odd.
    pub say: &'a mut dyn FnMut(&str),
}

impl Company<'_> {
    /// Ends what is being done, if that is wished.
    pub(super) fn look(&self) -> Result<(), SitlError> {
        if (self.stop)() { Err(SitlError::Interrupted) } else { Ok(()) }
    }
}

/// One wait for a peer.
pub(super) struct Wait {
    what: String,
    remedy: String,
    began: Instant,
    told: Option<Instant>,
    limit: Option<Duration>,
}

impl Wait {
    /// For something, for ever or up to a limit. Waits that are short are not told of.
    pub fn new(what: String, remedy: &str, limit: Option<Duration>) -> Self {
        Self { what, remedy: remedy.into(), began: Instant::now(), told: None, limit }
    }

    /// How long to wait before the next look.
    pub fn slice(&self) -> Duration {
        let left = self.limit.map_or(LOOK, |limit| limit.saturating_sub(self.began.elapsed()));
        left.clamp(Duration::from_millis(1), LOOK)
    }

    /// Between two looks: ends the wait where that is wished or where it has lasted too long, and tells of it.
    pub fn look(&mut self, company: &mut Company) -> Result<(), SitlError> {
        company.look()?;
        let waited = self.began.elapsed();
        if let Some(limit) = self.limit.filter(|limit| waited >= *limit) {
            return Err(SitlError::Silent {
                waited_for: self.what.clone(),
                seconds: limit.as_secs_f64(),
                remedy: self.remedy.clone(),
            });
        }
        let due = match self.told {
            // What is waited for without a limit is said at once, other waits when they become long.
            None => self.limit.is_none() || waited >= TELL,
            Some(told) => told.elapsed() >= TELL,
        };
        if due {
            (company.say)(&format!("waiting for {}; {}", self.what, self.remedy));
            self.told = Some(Instant::now());
        }
        Ok(())
    }
}

/// What reading came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Got {
    /// Bytes.
    Data,
    /// None in time.
    Nothing,
    /// The end.
    Closed,
}

/// Whether an error of a socket means that nothing came in time.
fn is_late(kind: ErrorKind) -> bool {
    matches!(kind, ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted)
}

/// Whether an error of a socket means that the peer is gone.
fn is_gone(kind: ErrorKind) -> bool {
    matches!(kind, ErrorKind::ConnectionReset | ErrorKind::ConnectionAborted | ErrorKind::BrokenPipe)
}

/// A TCP server of one client at a time.
pub(super) struct Tcp {
    listener: TcpListener,
    client: Option<(TcpStream, SocketAddr)>,
}

impl Tcp {
    pub fn bind(address: SocketAddr) -> Result<Self, SitlError> {
        let port = |source| SitlError::Port { protocol: "TCP", address, source };
        let listener = TcpListener::bind(address).map_err(port)?;
        listener.set_nonblocking(true).map_err(port)?;
        Ok(Self { listener, client: None })
    }

    pub fn address(&self) -> std::io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    /// Who is connected.
    pub fn peer(&self) -> Option<SocketAddr> {
        self.client.as_ref().map(|c| c.1)
    }

    /// Lets the next client in, if there is one.
    pub fn accept(&mut self) -> Result<bool, SitlError> {
        let failed = |source| SitlError::Connection { peer: "a client that connects".into(), source };
        match self.listener.accept() {
            Ok((stream, peer)) => {
                stream.set_nonblocking(false).map_err(failed)?;
                stream.set_nodelay(true).map_err(failed)?;
                // A client that reads nothing must not hold the server for ever.
                stream.set_write_timeout(Some(Duration::from_secs(10))).map_err(failed)?;
                self.client = Some((stream, peer));
                Ok(true)
            }
            Err(e) if is_late(e.kind()) || is_gone(e.kind()) => Ok(false),
            Err(e) => Err(failed(e)),
        }
    }

    pub fn close(&mut self) {
        self.client = None;
    }

    /// Sends all; false: the client is gone.
    pub fn send(&mut self, bytes: &[u8]) -> Result<bool, SitlError> {
        let Some((stream, peer)) = &mut self.client else { return Ok(false) };
        match stream.write_all(bytes) {
            Ok(()) => Ok(true),
            Err(e) if is_gone(e.kind()) => Ok(false),
            Err(source) => Err(SitlError::Connection { peer: peer.to_string(), source }),
        }
    }

    /// Appends what comes within a time; zero is what has come already.
    pub fn receive(&mut self, wait: Duration, into: &mut Vec<u8>) -> Result<Got, SitlError> {
        let Some((stream, peer)) = &mut self.client else { return Ok(Got::Closed) };
        let failed = |source| SitlError::Connection { peer: peer.to_string(), source };
        let mut buffer = [0u8; 4096];
        stream.set_nonblocking(wait.is_zero()).map_err(failed)?;
        if !wait.is_zero() {
            stream.set_read_timeout(Some(wait)).map_err(failed)?;
        }
        let got = stream.read(&mut buffer);
        if wait.is_zero() {
            stream.set_nonblocking(false).map_err(failed)?;
        }
        match got {
            Ok(0) => Ok(Got::Closed),
            Ok(n) => {
                into.extend_from_slice(&buffer[..n]);
                Ok(Got::Data)
            }
            Err(e) if is_late(e.kind()) => Ok(Got::Nothing),
            Err(e) if is_gone(e.kind()) => Ok(Got::Closed),
            Err(source) => Err(failed(source)),
        }
    }
}

/// A UDP port.
pub(super) struct Udp {
    socket: UdpSocket,
    buffer: [u8; 2048],
}

impl Udp {
    pub fn bind(address: SocketAddr) -> Result<Self, SitlError> {
        let socket = UdpSocket::bind(address).map_err(|source| SitlError::Port {
            protocol: "UDP",
            address,
            source,
        })?;
        Ok(Self { socket, buffer: [0; 2048] })
    }

    pub fn address(&self) -> std::io::Result<SocketAddr> {
        self.socket.local_addr()
    }

    /// Sends a packet. A peer that is not there yet is no error.
    pub fn send(&mut self, packet: &[u8], to: SocketAddr) -> Result<(), SitlError> {
        match self.socket.send_to(packet, to) {
            Ok(_) => Ok(()),
            Err(e) if e.kind() == ErrorKind::ConnectionRefused || is_gone(e.kind()) => Ok(()),
            Err(source) => Err(SitlError::Connection { peer: to.to_string(), source }),
        }
    }

    /// The packet that comes within a time, and where it is from; zero is one that has come already.
    pub fn receive(&mut self, wait: Duration) -> Result<Option<(&[u8], SocketAddr)>, SitlError> {
        let failed = |source| SitlError::Connection { peer: "UDP".into(), source };
        self.socket.set_nonblocking(wait.is_zero()).map_err(failed)?;
        if !wait.is_zero() {
            self.socket.set_read_timeout(Some(wait)).map_err(failed)?;
        }
        match self.socket.recv_from(&mut self.buffer) {
            Ok((n, from)) => Ok(Some((&self.buffer[..n], from))),
            // Of a packet that was sent to nobody.
            Err(e) if is_late(e.kind()) || e.kind() == ErrorKind::ConnectionRefused || is_gone(e.kind()) => {
                Ok(None)
            }
            Err(source) => Err(failed(source)),
        }
    }
}

/// Holds simulated time back to that of the clock.
pub(super) struct Pace {
    speed: f64,
    from: Option<(Instant, f64)>,
}

impl Pace {
    /// Simulated seconds for each second; 0 holds nothing back.
    pub fn new(speed: f64) -> Self {
        Self { speed, from: None }
    }

    /// Begins anew from here.
    pub fn restart(&mut self) {
        self.from = None;
    }

    /// Sleeps until simulated time may be this. What is late by more than a tenth of a second is not made up for.
    pub fn hold(&mut self, time_s: f64, company: &Company) -> Result<(), SitlError> {
        if self.speed == 0.0 {
            return company.look();
        }
        let (began, first_s) = *self.from.get_or_insert((Instant::now(), time_s));
        let due = Duration::from_secs_f64(((time_s - first_s) / self.speed).max(0.0));
        loop {
            company.look()?;
            let now = began.elapsed();
            if now > due + Duration::from_millis(100) {
                self.from = Some((Instant::now(), time_s));
            }
            let left = due.saturating_sub(now);
            if left.is_zero() {
                return Ok(());
            }
            std::thread::sleep(left.min(LOOK));
        }
    }
}
