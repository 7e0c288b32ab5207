use super::*;
use proptest::prelude::*;

/// A `HIL_ACTUATOR_CONTROLS` of PX4 in lockstep at 4000 µs, armed, with the first four outputs 0.5, 0.25, 0.125 and 1, made by pymavlink
/// 2.4.50 (`MAVLink(None, srcSystem=1, srcComponent=1)`).
const CONTROLS: &str = "fd5100000001015d0000a00f00000000000001000000000000000000003f0000803e0000003e0000803f00000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000081740f";
/// Its `COMMAND_LONG` that asks for `HIL_STATE_QUATERNION` every 5000 µs.
const INTERVAL: &str =
    "fd2000000001014c00000000e64200409c450000000000000000000000000000000000000000ff0101018374";
/// The same controls in MAVLink 1.
const CONTROLS_V1: &str = "fe510001015da00f00000000000001000000000000000000003f0000803e0000003e0000803f00000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000081aff9";

fn bytes(hex: &str) -> Vec<u8> {
    (0..hex.len()).step_by(2).map(|i| u8::from_str_radix(&hex[i..i + 2], 16).unwrap()).collect()
}

fn read_all(reader: &mut Reader) -> Vec<Message> {
    std::iter::from_fn(|| reader.next_message()).collect()
}

fn expected() -> ActuatorControls {
    let mut controls = [0.0; N_CONTROLS];
    controls[..4].copy_from_slice(&[0.5, 0.25, 0.125, 1.0]);
    ActuatorControls { time_us: 4000, controls, armed: true, lockstep: true }
}

#[test]
fn messages_of_pymavlink_are_read_in_pieces_of_any_length() {
    let stream = [bytes(CONTROLS), bytes(INTERVAL), bytes(CONTROLS_V1)].concat();
    let wanted = [
        Message::ActuatorControls(expected()),
        Message::Interval { message: STATE_QUATERNION, interval_us: 5000 },
        Message::ActuatorControls(expected()),
    ];
    for piece in [1, 7, stream.len()] {
        let mut reader = Reader::default();
        let mut found = Vec::new();
        for part in stream.chunks(piece) {
            reader.push(part);
            found.extend(read_all(&mut reader));
        }
        assert_eq!(found, wanted);
        assert_eq!(reader.skipped(), 0);
    }
}

#[test]
fn a_damaged_message_is_passed_over_and_the_next_one_is_read() {
    let mut damaged = bytes(CONTROLS);
    damaged[20] ^= 0x40;
    let mut reader = Reader::default();
    reader.push(b"noise");
    reader.push(&damaged);
    reader.push(&bytes(CONTROLS));
    assert_eq!(read_all(&mut reader), [Message::ActuatorControls(expected())]);
    assert_eq!(reader.skipped(), 5 + damaged.len() as u64);
    assert_eq!(reader.check(), Ok(()));
}

#[test]
fn a_signed_message_is_read_and_one_with_unknown_flags_is_not() {
    let mut frame = bytes(CONTROLS);
    let n = frame.len() - 2;
    frame[2] = 1;
    let crc = mavlink::calculate_crc(&frame[1..n], HIL_ACTUATOR_CONTROLS_DATA::EXTRA_CRC);
    frame[n..].copy_from_slice(&crc.to_le_bytes());
    frame.extend([0; 13]);
    let mut reader = Reader::default();
    reader.push(&frame);
    assert_eq!(read_all(&mut reader), [Message::ActuatorControls(expected())]);
    frame[2] = 2;
    reader.push(&frame);
    assert_eq!(read_all(&mut reader), []);
}

#[test]
fn what_is_no_mavlink_is_said() {
    let mut reader = Reader::default();
    reader.push("GET / HTTP/1.1\r\n".repeat(100).as_bytes());
    assert_eq!(read_all(&mut reader), []);
    let words = reader.check().unwrap_err().to_string();
    assert!(words.contains("1600 bytes") && words.contains("MAVLink"), "{words}");
}

#[test]
fn sensors_are_in_px4s_frames_and_units() {
    let mut out = Vec::new();
    let read = Sensors {
        time_us: 8000,
        accel_m_s2: [1.0, 2.0, 9.75],
        gyro_rad_s: [0.1, 0.2, 0.3],
        mag_gauss: None,
        baro: Some((95_600.0, 12.0)),
    };
    Writer::default().sensors(&read, &mut out);
    let found = HIL_SENSOR_DATA::deser(MavlinkVersion::V2, &out[10..out.len() - 2]).unwrap();
    assert_eq!([found.xacc, found.yacc, found.zacc], [1.0, -2.0, -9.75]);
    assert_eq!([found.xgyro, found.ygyro, found.zgyro], [0.1, -0.2, -0.3]);
    assert_eq!(found.fields_updated.bits(), 0b1_1010_0011_1111);
    assert_eq!((found.abs_pressure, found.temperature, found.time_usec), (956.0, 12.0, 8000));
}

#[test]
fn a_fix_and_the_truth_are_in_degrees_and_centimetres() {
    let (mut out, mut writer, home) = (Vec::new(), Writer::default(), Home::default());
    let fix =
        Fix { time_us: 1, pos_m: [0.0; 3], vel_m_s: [3.0, 4.0, 0.5], horizontal_m: 0.3, vertical_m: 0.4 };
    writer.fix(&fix, &home, &mut out);
    let found = HIL_GPS_DATA::deser(MavlinkVersion::V2, &out[10..out.len() - 2]).unwrap();
    assert_eq!((found.lat, found.lon, found.alt), (473_977_420, 85_455_940, 488_000));
    assert_eq!([found.vn, found.ve, found.vd], [300, -400, -50]);
    // West of north.
    assert_eq!((found.vel, found.cog, found.eph, found.epv), (500, 30_687, 30, 40));
    out.clear();
    let truth = Truth { time_s: 2.0, pos_m: [0.0, 0.0, 12.0], vel_m_s: [0.0, 1.0, 2.0], ..Truth::default() };
    writer.state(&truth, &home, &mut out);
    let found = HIL_STATE_QUATERNION_DATA::deser(MavlinkVersion::V2, &out[10..out.len() - 2]).unwrap();
    assert_eq!((found.alt, found.time_usec), (500_000, 2_000_000));
    assert_eq!([found.vx, found.vy, found.vz], [0, -100, -200]);
    assert_eq!([found.xacc, found.yacc, found.zacc], [0, 0, -1000]);
    assert_eq!(found.attitude_quaternion, [1.0, 0.0, 0.0, 0.0]);
    // The second message of this writer.
    assert_eq!(out[4], 1);
}

proptest! {
    #[test]
    fn no_bytes_make_the_reader_panic_or_wait_for_ever(parts in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..400), 0..8)) {
        let mut reader = Reader::default();
        for part in parts {
            reader.push(&part);
            while reader.next_message().is_some() {}
        }
        // A whole message is found behind anything, at the latest when as much has come as the longest message has.
        reader.push(&[0; 600]);
        while reader.next_message().is_some() {}
        reader.push(&bytes(CONTROLS));
        prop_assert!(read_all(&mut reader).contains(&Message::ActuatorControls(expected())));
    }
}
