//! ArduPilot: its JSON interface over UDP, in lockstep.
//!
//! ArduPilot sends the pulse widths of its outputs to the simulator's port 9002 and waits for a line of JSON, to the address that the
//! packet came from. Source: ArduPilot, `libraries/SITL/examples/JSON/readme.md`; started with `--model JSON:ADDRESS`.

use std::fmt::Write as _;

use crate::frames::{quat_wxyz_ned, turned};
use crate::{ProtocolError, Truth};

/// UDP port of the simulator.
pub const PORT: u16 = 9002;
/// First number of a packet of 16 outputs.
const MAGIC_16: u16 = 18_458;
/// First number of a packet of 32 outputs.
const MAGIC_32: u16 = 29_569;
/// Most range finders of an answer, `rng_1` to `rng_6`.
pub const MOST_RANGES: usize = 6;

/// What ArduPilot sends.
#[derive(Clone, Debug, PartialEq)]
pub struct Outputs {
    /// Steps per second that it asks for.
    pub frame_rate_hz: u16,
    /// Number of this packet since ArduPilot started; the same again where it got no answer.
    pub frame_count: u32,
    /// Pulse widths, µs, of 16 or 32 outputs; 0 where one is off.
    pub pulses_us: Vec<u16>,
}

/// Reads a packet.
///
/// # Errors
/// [`ProtocolError::Packet`] for another length or first number, and for a rate of zero.
pub fn decode(packet: &[u8]) -> Result<Outputs, ProtocolError> {
    let wrong = |got: String| ProtocolError::Packet {
        stack: "ArduPilot",
        expected: format!("40 bytes that begin with {MAGIC_16}, or 72 that begin with {MAGIC_32}"),
        got,
    };
    let u16_at = |at: usize| packet.get(at..at + 2).map(|b| u16::from_le_bytes([b[0], b[1]]));
    let magic = u16_at(0).ok_or_else(|| wrong(format!("{} bytes", packet.len())))?;
    let n = match (magic, packet.len()) {
        (MAGIC_16, 40) => 16,
        (MAGIC_32, 72) => 32,
        (magic, n) => return Err(wrong(format!("{n} bytes that begin with {magic}"))),
    };
    let frame_rate_hz = u16_at(2).unwrap_or_default();
    if frame_rate_hz == 0 {
        return Err(wrong("a frame rate of 0 Hz".into()));
    }
    Ok(Outputs {
        frame_rate_hz,
        frame_count: u32::from_le_bytes([packet[4], packet[5], packet[6], packet[7]]),
        pulses_us: (0..n).filter_map(|i| u16_at(8 + 2 * i)).collect(),
    })
}

/// What a packet means beside the one before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// The first one, or ArduPilot was started again: everything begins anew.
    Start,
    /// The next one, after some that were lost.
    Next {
        /// How many were lost.
        lost: u32,
    },
    /// The one before again, whose answer did not arrive: it gets the same answer.
    Again,
}

/// What a packet with this number means after one with the number `before`.
pub fn order(before: Option<u32>, count: u32) -> Order {
    match before {
        None => Order::Start,
        Some(before) if count == before => Order::Again,
        Some(before) if count > before => Order::Next { lost: count - before - 1 },
        Some(_) => Order::Start,
    }
}

/// Share of full power of a pulse, 0 to 1, between two pulse widths, µs; 0 for an output that is off.
pub fn control(pulse_us: u16, range_us: [u16; 2]) -> f64 {
    let [low, high] = range_us.map(f64::from);
    ((f64::from(pulse_us) - low) / (high - low)).clamp(0.0, 1.0)
}

/// The answer: one line of JSON, with a line break before and after it. `ranges_m`: readings of up to six range finders.
pub fn encode(truth: &Truth, ranges_m: &[f64]) -> String {
    let list = |v: &[f64]| v.iter().map(ToString::to_string).collect::<Vec<_>>().join(",");
    let mut out = format!(
        "\n{{\"timestamp\":{},\"imu\":{{\"gyro\":[{}],\"accel_body\":[{}]}},\"position\":[{}],\"quaternion\":[{}],\"velocity\":[{}]",
        truth.time_s,
        list(&turned(truth.ang_vel_rad_s)),
        list(&turned(truth.accel_m_s2)),
        list(&turned(truth.pos_m)),
        list(&quat_wxyz_ned(truth.quat_xyzw)),
        list(&turned(truth.vel_m_s)),
    );
    let _ = write!(
        out,
        ",\"velocity_wind\":[{}],\"airspeed\":{}",
        list(&turned(truth.wind_m_s)),
        truth.airspeed_m_s()
    );
    for (i, range) in ranges_m.iter().take(MOST_RANGES).enumerate() {
        let _ = write!(out, ",\"rng_{}\":{range}", i + 1);
    }
    out + "}\n"
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn packet(magic: u16, rate: u16, count: u32, pulses: &[u16]) -> Vec<u8> {
        let mut out = [magic, rate].map(u16::to_le_bytes).concat();
        out.extend(count.to_le_bytes());
        out.extend(pulses.iter().flat_map(|p| p.to_le_bytes()));
        out
    }

    #[test]
    fn packets_of_both_lengths_are_read() {
        let outputs = decode(&packet(MAGIC_16, 400, 7, &[1500; 16])).unwrap();
        assert_eq!(outputs, Outputs { frame_rate_hz: 400, frame_count: 7, pulses_us: vec![1500; 16] });
        let pulses: Vec<u16> = (1000..1032).collect();
        assert_eq!(decode(&packet(MAGIC_32, 1200, 1, &pulses)).unwrap().pulses_us, pulses);
    }

    #[test]
    fn other_packets_are_refused() {
        for (bad, words) in [
            (packet(MAGIC_16, 400, 7, &[1500; 15]), "38 bytes"),
            (packet(MAGIC_32, 400, 7, &[1500; 16]), "begin with 29569"),
            (packet(1, 400, 7, &[1500; 16]), "begin with 1"),
            (packet(MAGIC_16, 0, 7, &[1500; 16]), "0 Hz"),
            (vec![3], "1 bytes"),
        ] {
            let said = decode(&bad).unwrap_err().to_string();
            assert!(said.contains(words) && said.contains("18458"), "{said}");
        }
    }

    #[test]
    fn the_count_says_what_a_packet_is() {
        assert_eq!(order(None, 5), Order::Start);
        assert_eq!(order(Some(5), 5), Order::Again);
        assert_eq!(order(Some(5), 6), Order::Next { lost: 0 });
        assert_eq!(order(Some(5), 9), Order::Next { lost: 3 });
        assert_eq!(order(Some(5), 0), Order::Start);
    }

    #[test]
    fn pulses_become_shares() {
        let range = [1000, 2000];
        assert_eq!([0, 1000, 1250, 2000, 2100].map(|p| control(p, range)), [0.0, 0.0, 0.25, 1.0, 1.0]);
    }

    #[test]
    fn an_answer_is_in_ardupilots_frames() {
        let truth =
            Truth { time_s: 0.5, pos_m: [1.0, 2.0, 3.0], vel_m_s: [0.5, 0.25, 1e-9], ..Truth::default() };
        let line = encode(&truth, &[1.5, 2.5]);
        let expected = "\n{\"timestamp\":0.5,\"imu\":{\"gyro\":[0,-0,-0],\"accel_body\":[0,-0,-9.80665]},\"position\":[1,-2,-3],\
            \"quaternion\":[1,0,-0,-0],\"velocity\":[0.5,-0.25,-0.000000001],\"velocity_wind\":[0,-0,-0],\"airspeed\":0.5,\
            \"rng_1\":1.5,\"rng_2\":2.5}\n";
        assert_eq!(line, expected);
    }

    proptest! {
        #[test]
        fn no_packet_makes_it_panic(bytes in prop::collection::vec(any::<u8>(), 0..100)) {
            let _ = decode(&bytes);
        }
    }
}
