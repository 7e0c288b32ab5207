//! Betaflight: the packets of its target SITL over UDP.
//!
//! The simulator sends the state to Betaflight's port 9003; for each of them Betaflight sends the motors to the simulator's port 9002.
//! Whoever flies sends sticks to Betaflight's port 9004. Betaflight runs by the clock of the computer, scaled by the times of the states:
//! it waits for nothing, so that only the simulator's side is in lockstep. Source: Betaflight 4.6,
//! `src/platform/SIMULATOR/sitl.c` and `target/SITL/target.h`.

use crate::earth::{Home, atmosphere};
use crate::frames::quat_wxyz_ned;
use crate::{ProtocolError, Truth};

/// UDP port on which the simulator hears motors.
pub const PORT_MOTORS: u16 = 9002;
/// UDP port on which Betaflight hears states.
pub const PORT_STATE: u16 = 9003;
/// UDP port on which Betaflight hears sticks.
pub const PORT_RC: u16 = 9004;
/// Motors of a packet.
pub const N_MOTORS: usize = 4;
/// Channels of a packet of sticks.
pub const N_CHANNELS: usize = 16;

/// The packet of a state (`fdm_packet`): 18 doubles, little-endian. Time, s; body rates, rad/s, forward-right-down; the accelerometer,
/// m/s²; attitude w, x, y, z; velocity, m/s, east-north-up; longitude and latitude, degrees, and height, m; pressure, Pa.
///
/// Betaflight takes roll, minus pitch and minus yaw as its gyroscope, and minus all three of the accelerometer as its own, and both then
/// have to be in its frame, forward-left-up (`updateState`). The attitude is that from forward-right-down to north-east-down: built as a
/// simulator, Betaflight changes the signs of two entries of the matrix that it makes of it (`imuComputeRotationMatrix` in `flight/imu.c`), so
/// that its pitch, nose down, and its heading come out right.
pub fn encode_state(truth: &Truth, home: &Home) -> [u8; 144] {
    let [wx, wy, wz] = truth.ang_vel_rad_s;
    let [ax, ay, az] = truth.accel_m_s2;
    let [qw, qx, qy, qz] = quat_wxyz_ned(truth.quat_xyzw);
    let [north, west, up] = truth.vel_m_s;
    let [lat, lon, alt] = home.at(truth.pos_m);
    let (pressure, _) = atmosphere(alt);
    let numbers = [
        truth.time_s,
        wx,
        -wy,
        -wz,
        -ax,
        -ay,
        -az,
        qw,
        qx,
        qy,
        qz,
        -west,
        north,
        up,
        lon,
        lat,
        alt,
        pressure,
    ];
    let mut out = [0; 144];
    for (to, number) in out.chunks_exact_mut(8).zip(numbers) {
        to.copy_from_slice(&number.to_le_bytes());
    }
    out
}

/// Reads the packet of the motors (`servo_packet`): four floats, 0 to 1, in the order of [`motors`](crate::motors); NaN counts as 0.
///
/// # Errors
/// [`ProtocolError::Packet`] for another length.
pub fn decode_motors(packet: &[u8]) -> Result<[f64; N_MOTORS], ProtocolError> {
    if packet.len() != 4 * N_MOTORS {
        return Err(ProtocolError::Packet {
            stack: "Betaflight",
            expected: "16 bytes: the speeds of four motors".into(),
            got: format!("{} bytes", packet.len()),
        });
    }
    Ok(core::array::from_fn(|i| {
        let at = &packet[4 * i..4 * i + 4];
        let motor = f64::from(f32::from_le_bytes([at[0], at[1], at[2], at[3]]));
        if motor.is_nan() { 0.0 } else { motor.clamp(0.0, 1.0) }
    }))
}

/// The packet of sticks (`rc_packet`): time, s, and 16 channels, µs; those that are not given are 1500, the throttle, the third one, 1000.
pub fn encode_rc(time_s: f64, channels_us: &[u16]) -> [u8; 40] {
    let mut out = [0; 40];
    out[..8].copy_from_slice(&time_s.to_le_bytes());
    for (i, to) in out[8..].chunks_exact_mut(2).enumerate() {
        let otherwise = if i == 2 { 1000 } else { 1500 };
        to.copy_from_slice(&channels_us.get(i).copied().unwrap_or(otherwise).to_le_bytes());
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_state_is_in_betaflights_layout() {
        let truth = Truth {
            time_s: 1.5,
            ang_vel_rad_s: [0.1, 0.2, 0.3],
            accel_m_s2: [1.0, 2.0, 9.75],
            quat_xyzw: [0.1, 0.2, 0.3, 0.9],
            vel_m_s: [1.0, 2.0, 3.0],
            ..Truth::default()
        };
        let packet = encode_state(&truth, &Home::default());
        let found: Vec<f64> =
            packet.chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect();
        let expected = [
            1.5, 0.1, -0.2, -0.3, -1.0, -2.0, -9.75, 0.9, 0.1, -0.2, -0.3, -2.0, 1.0, 3.0, 8.545_594,
            47.397_742, 488.0,
        ];
        assert_eq!(found[..17], expected);
        assert!((found[17] - 95_600.0).abs() < 100.0, "{}", found[17]);
    }

    #[test]
    fn motors_are_read_and_held_in_their_range() {
        let packet: Vec<u8> = [0.5f32, -1.0, 2.0, f32::NAN].iter().flat_map(|m| m.to_le_bytes()).collect();
        assert_eq!(decode_motors(&packet), Ok([0.5, 0.0, 1.0, 0.0]));
        assert!(decode_motors(&packet[1..]).unwrap_err().to_string().contains("15 bytes"));
    }

    #[test]
    fn sticks_that_are_not_given_are_in_the_middle_and_the_throttle_is_low() {
        let packet = encode_rc(2.0, &[1100, 1200]);
        let channels: Vec<u16> =
            packet[8..].chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect();
        assert_eq!(channels[..5], [1100, 1200, 1000, 1500, 1500]);
        assert_eq!(packet[..8], 2.0f64.to_le_bytes());
    }
}
