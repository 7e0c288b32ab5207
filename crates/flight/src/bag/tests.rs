//! Bags as recorders write them, and as they are found after a crash.

#[path = "../../../../tests/common/bag.rs"]
mod made;

use crate::{FlightLog, Mapping, Result};
use made::{Bag, Bytes, Compression, START_NS, Written};
use propwash_trace::math::quat;
use std::path::Path;

const LEVEL: [f64; 4] = [0.0, 0.0, 0.0, 1.0];
const STEP_NS: u64 = 10_000_000;

fn read_with(bytes: &[u8], mapping: &str) -> Result<FlightLog> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bag.mcap");
    std::fs::write(&path, bytes).unwrap();
    let mapping = Mapping::parse(mapping, Path::new("bag.toml"))?;
    FlightLog::load_with(&path, Some(&mapping))
}

fn read(bytes: &[u8]) -> Result<FlightLog> {
    read_with(bytes, "")
}

/// The error of a bag, which says all of these.
fn refused(bytes: &[u8], mapping: &str, words: &[&str]) {
    let said = read_with(bytes, mapping).unwrap_err().to_string();
    for word in words {
        assert!(said.contains(word), "`{word}` in: {said}");
    }
}

fn says(log: &FlightLog, words: &str) {
    assert!(log.warnings.iter().any(|w| w.contains(words)), "`{words}` in {:#?}", log.warnings);
}

/// The time of a message, ns, and a motion that no two messages share.
fn at(i: u64) -> (u64, f64) {
    (START_NS + i * STEP_NS, 0.25 * i as f64)
}

fn of(kind: &str, messages: impl Fn(u64, f64) -> Vec<u8>, n: u64) -> Vec<u8> {
    let mut bag = Bag::new(Written::default());
    bag.topic("/it", kind);
    for (ns, x) in (0..n).map(at) {
        bag.put("/it", ns, &messages(ns, x));
    }
    bag.bytes()
}

#[test]
fn every_compression_and_file_without_chunks_reads_alike() {
    let plain = read(&made::short(Written::default())).unwrap();
    assert_eq!(plain.position_m.len(), 10);
    assert_eq!(plain.position_m.values[3], [0.03, 0.0, 1.0]);
    assert_eq!(plain.velocity_m_s.values[3], [1.0, 0.0, 0.0]);
    assert_eq!(plain.specific_force_m_s2.values[3], [0.0, 0.0, 9.8]);
    assert_eq!(plain.start_s, START_NS as f64 * 1e-9);
    assert!((plain.position_m.t_s[3] - 0.03).abs() < 1e-12, "{:?}", plain.position_m.t_s);
    for (compression, chunks, chunk_bytes) in [
        (Some(Compression::Lz4), true, 1000),
        (Some(Compression::Zstd), true, 1 << 20),
        (Some(Compression::Zstd), true, 100),
        (None, true, 2000),
        (None, false, 0),
    ] {
        let log = read(&made::short(Written { compression, chunks, chunk_bytes })).unwrap();
        assert_eq!(log.position_m, plain.position_m);
        assert_eq!(log.angular_velocity_rad_s, plain.angular_velocity_rad_s);
        assert_eq!(log.warnings, plain.warnings);
    }
}

#[test]
fn both_orders_of_bytes_give_the_same_pose() {
    let q = quat::exp([0.3, -0.2, 1.0]);
    for big in [false, true] {
        let log =
            read(&of("geometry_msgs/msg/PoseStamped", |ns, x| made::pose(big, ns, [x, 2.0, -3.0], q), 5));
        let log = log.unwrap();
        assert_eq!(log.position_m.values[4], [1.0, 2.0, -3.0]);
        assert_eq!(log.attitude.values[4], q);
        says(&log, "/it (geometry_msgs/PoseStamped): position, attitude; times: stamps of its messages");
    }
}

#[test]
fn every_type_of_field_becomes_a_column_and_what_is_none_is_passed_over() {
    let text = "bool on\nint8 a\nstring word\nfloat64 b\nbyte c\nint16 d\nuint64 e\nfloat32[3] few\nstring[] words\nPart[2] parts\n\
                uint8 SEVEN=7\nint32[<=4] some\nfloat64[] none\nuint8[] image\nchar end\nfloat64 last\n===\nMSG: own/Part\nuint8 k\nfloat64[] x\nEmpty e\n\
                ===\nMSG: own/Empty\n";
    let part = |b: Bytes, k: u8| b.u8(k).u32(1).f64(&[f64::from(k)]).u8(0);
    for big in [false, true] {
        let mut bag = Bag::new(Written::default());
        bag.any("/own", "own/msg/Test", "ros2msg", text, "cdr");
        for (ns, x) in (0..4).map(at) {
            let start = Bytes::cdr(big).u8(1).u8(250).text("odd").f64(&[x]).u8(200);
            let numbers = start.i16(-5).u64(1 << 40).f32(0.5).f32(1.5).f32(2.5);
            let parts = part(part(numbers.u32(2).text("a").text("bcd"), 7), 8);
            let image = parts.u32(2).u32(3).u32(4).u32(0).u32(100);
            let done = (0..100).fold(image, |b, i| b.u8(i)).u8(b'z').f64(&[2.0 * x]).done();
            bag.put("/own", ns, &done);
        }
        let bytes = bag.bytes();
        let columns = [
            ("on", 1.0),
            ("a", -6.0),
            ("b", 0.75),
            ("c", 200.0),
            ("d", -5.0),
            ("e", (1u64 << 40) as f64),
            ("few[2]", 2.5),
            ("parts[1].x[0]", 8.0),
            ("some[1]", 4.0),
            ("end", f64::from(b'z')),
            ("last", 1.5),
        ];
        for (path, value) in columns {
            let log = read_with(&bytes, &format!("[columns]\nvbat = \"/own.{path}\"\n")).unwrap();
            assert_eq!((log.vbat_v.len(), log.vbat_v.values[3]), (4, [value]), "{path}");
            says(&log, "/own.image was left out: more than 64 elements");
            says(&log, "times of the recorder");
        }
        let all =
            ["expected a column `/own.words[0]`", "/own.parts[0].k", "(not image: more than 64 elements)"];
        refused(&bytes, "[columns]\nvbat = \"/own.words[0]\"\n", &all);
    }
}

#[test]
fn ros_1_messages_are_read_without_padding() {
    let text = "Header header\nfloat64 voltage\n===\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n";
    let mut bag = Bag::new(Written::default());
    bag.any("/battery", "sensor_msgs/BatteryState", "ros1msg", text, "ros1");
    for (ns, x) in (0..4).map(at) {
        let (s, left) = (ns / 1_000_000_000, ns % 1_000_000_000);
        let message = Bytes::ros1().u32(7).u32(s as u32).u32(left as u32).text("odd").f64(&[12.0 - x]);
        bag.put("/battery", ns + 5_000_000, &message.done());
    }
    let log = read(&bag.bytes()).unwrap();
    assert_eq!(log.vbat_v.component(0), [12.0, 11.75, 11.5, 11.25]);
    assert_eq!(log.start_s, START_NS as f64 * 1e-9, "the stamps, not the times of the recorder");
}

#[test]
fn the_twist_of_an_odometry_is_turned_from_the_body_unless_it_names_the_world() {
    let q = quat::exp([0.0, 0.0, std::f64::consts::FRAC_PI_2]);
    let bag = |child: &'static str| {
        of(
            "nav_msgs/msg/Odometry",
            move |ns, x| made::odometry(ns, child, [x; 3], q, [1.0, 0.0, 0.5], [0.0, 0.1, 0.2]),
            4,
        )
    };
    let log = read(&bag("base_link")).unwrap();
    for (is, expected) in log.velocity_m_s.values[1].iter().zip([0.0, 1.0, 0.5]) {
        assert!((is - expected).abs() < 1e-12, "{:?}", log.velocity_m_s.values[1]);
    }
    assert_eq!(log.angular_velocity_rad_s.values[1], [0.0, 0.1, 0.2]);
    let log = read(&bag("odom")).unwrap();
    assert_eq!(log.velocity_m_s.values[1], [1.0, 0.0, 0.5]);
    assert!(log.angular_velocity_rad_s.is_empty(), "rates of the world are no body rates");
}

#[test]
fn a_stamped_twist_is_of_the_frame_that_it_names() {
    let q = quat::exp([0.0, 0.0, std::f64::consts::FRAC_PI_2]);
    let bag = |frame: &str, topic: &str| {
        let mut bag = Bag::new(Written::default());
        bag.topic("/pose", "geometry_msgs/msg/PoseStamped");
        bag.topic(topic, "geometry_msgs/msg/TwistStamped");
        for (ns, x) in (0..4).map(at) {
            bag.put("/pose", ns, &made::pose(false, ns, [x; 3], q));
            let twist = Bytes::cdr(false).header(ns, frame).f64(&[1.0, 0.0, 0.5, 0.0, 0.0, 0.0]);
            bag.put(topic, ns, &twist.done());
        }
        read(&bag.bytes()).unwrap()
    };
    assert_eq!(bag("map", "/velocity").velocity_m_s.values[2], [1.0, 0.0, 0.5]);
    let turned = bag("base_link", "/velocity").velocity_m_s.values[2];
    assert!((turned[0].abs() < 1e-12) && (turned[1] - 1.0).abs() < 1e-12, "{turned:?}");
    let log = bag("somewhere", "/velocity");
    assert!(log.velocity_m_s.is_empty());
    says(&log, "found `somewhere`");
    let log = bag("map", "/cmd_vel");
    assert!(log.velocity_m_s.is_empty(), "a command is no measurement");
    says(&log, "topics that nothing uses, ignored: /cmd_vel (geometry_msgs/TwistStamped)");
}

#[test]
fn px4_messages_are_turned_as_in_a_ulog() {
    let text = "uint64 timestamp\nuint64 timestamp_sample\nuint8 pose_frame\nfloat32[3] position\nfloat32[4] q\nuint8 velocity_frame\n\
                float32[3] velocity\nfloat32[3] angular_velocity\n";
    let mut bag = Bag::new(Written::default());
    bag.any("/fmu/out/vehicle_odometry", "px4_msgs/msg/VehicleOdometry", "ros2msg", text, "cdr");
    bag.any(
        "/fmu/out/actuator_motors",
        "px4_msgs/msg/ActuatorMotors",
        "ros2msg",
        "uint64 timestamp\nfloat32[12] control\n",
        "cdr",
    );
    for (ns, x) in (0..4).map(at) {
        let mut message = Bytes::cdr(false).u64(ns / 1000 + 9).u64(ns / 1000).u8(1);
        for number in [x, 1.0, -2.0, 0.5, 0.5, 0.5, 0.5] {
            message = message.f32(number);
        }
        message = message.u8(3);
        for number in [1.0, 0.0, 0.0, 0.1, 0.2, 0.3] {
            message = message.f32(number);
        }
        bag.put("/fmu/out/vehicle_odometry", ns + 1_000_000, &message.done());
        let motor = |i: i32| if i < 4 { 0.25 } else { f64::NAN };
        let motors = (0..12).fold(Bytes::cdr(false).u64(ns / 1000), |b, i| b.f32(motor(i)));
        bag.put("/fmu/out/actuator_motors", ns + 1_000_000, &motors.done());
    }
    let log = read(&bag.bytes()).unwrap();
    assert_eq!(log.position_m.values[2], [0.5, -1.0, 2.0]);
    assert_eq!(log.attitude.values[2], [0.5, -0.5, -0.5, 0.5]);
    // The body's x is the file's y, which is ours turned over.
    let v = log.velocity_m_s.values[2];
    assert!((v[0].abs() + (v[1] + 1.0).abs() + v[2].abs()) < 1e-6, "{v:?}");
    assert_eq!(log.angular_velocity_rad_s.values[2].map(|x| x as f32), [0.1, -0.2, -0.3]);
    assert_eq!((log.cmd_u.len(), log.cmd_u[3].values[1]), (4, [0.25]));
    assert_eq!(log.start_s, START_NS as f64 * 1e-9, "the time of the sample");
}

#[test]
fn a_mapping_names_columns_units_and_frames() {
    let bag = made::short(Written::default());
    let log = read_with(
        &bag,
        "contract_names = true\n[columns]\nrotor1 = { from = \"/motors.data[0]\", unit = \"rpm\" }\nrotor2 = \"/motors.data[3]\"\n",
    );
    let log = log.unwrap();
    assert_eq!(log.rotor_speed_rad_s.len(), 2);
    assert_eq!(log.rotor_speed_rad_s[1].values[0], [1003.0]);
    assert!((log.rotor_speed_rad_s[0].values[0][0] - 1000.0 * std::f64::consts::PI / 30.0).abs() < 1e-9);
    assert_eq!((log.position_m.len(), log.specific_force_m_s2.len()), (10, 10), "the rest is found");
    let only = "world_frame = \"ned\"\n[columns]\npx = \"/odom.pose.pose.position.x\"\npy = \"/odom.pose.pose.position.y\"\n\
                pz = { from = \"/odom.pose.pose.position.z\", unit = \"cm\" }\n[attitude]\norder = \"xyzw\"\n\
                quaternion = [\"/odom.pose.pose.orientation.x\", \"/odom.pose.pose.orientation.y\", \"/odom.pose.pose.orientation.z\", \"/odom.pose.pose.orientation.w\"]\n";
    let log = read_with(&bag, only).unwrap();
    assert_eq!(log.position_m.values[2], [0.02, 0.0, -0.01]);
    assert_eq!((log.attitude.len(), log.velocity_m_s.len()), (10, 0));
    let log = read_with(
        &bag,
        "where = { \"/motors.data[0]\" = 7 }\ncontract_names = true\n[columns]\nvbat = \"/motors.data[1]\"\n",
    )
    .unwrap();
    assert!(log.vbat_v.is_empty() && log.position_m.len() == 10);
    let late = "[channel.velocity]\nshift_s = 0.5\n";
    assert!((read_with(&bag, late).unwrap().velocity_m_s.t_s[0] - 0.5).abs() < 1e-9);
    let apart = "[columns]\nvx = \"/odom.twist.twist.linear.x\"\nvy = \"/imu.linear_acceleration.y\"\nvz = \"/imu.linear_acceleration.z\"\n";
    refused(&bag, apart, &["from messages of one topic", "/imu and /odom"]);
    refused(
        &bag,
        "[columns]\nvbat = \"/power.voltage\"\n",
        &["`/power.voltage`", "/imu (sensor_msgs/Imu)", "/odom (nav_msgs/Odometry)"],
    );
    refused(&bag, "[columns]\nt = \"/odom.header\"\n", &["log_time", "header.stamp"]);
}

#[test]
fn two_topics_that_could_be_the_vehicle_are_not_chosen_from() {
    let mut bag = Bag::new(Written::default());
    for topic in ["/a/pose", "/b/pose", "/goal_pose"] {
        bag.topic(topic, "geometry_msgs/msg/PoseStamped");
    }
    for (topic, kind) in [("/imu/data", "sensor_msgs/msg/Imu"), ("/imu/raw", "sensor_msgs/msg/Imu")] {
        bag.topic(topic, kind);
    }
    for (ns, x) in (0..4).map(at) {
        bag.put("/a/pose", ns, &made::pose(false, ns, [x, 1.0, 0.0], LEVEL));
        bag.put("/b/pose", ns, &made::pose(false, ns, [x, 2.0, 0.0], LEVEL));
        bag.put("/goal_pose", ns, &made::pose(false, ns, [x, 3.0, 0.0], LEVEL));
        bag.put("/imu/data", ns, &made::imu(ns, [0.1; 3], [9.0; 3]));
        bag.put("/imu/raw", ns, &made::imu(ns, [0.2; 3], [9.0; 3]));
    }
    let bytes = bag.bytes();
    let words = [
        "one topic that gives the position",
        "/a/pose (geometry_msgs/PoseStamped) and /b/pose",
        "topics = [",
        "ignore = [",
    ];
    refused(&bytes, "", &words);
    let log = read_with(&bytes, "ignore = [\"/a/pose\"]\n").unwrap();
    assert_eq!((log.position_m.values[0][1], log.ref_position_m.values[0][1]), (2.0, 3.0));
    assert!(log.angular_velocity_rad_s.is_empty());
    says(&log, "body rates left out, since several topics could give it: /imu/data");
    let log = read_with(&bytes, "topics = [\"/a/pose\", \"/imu/raw\"]\n").unwrap();
    assert_eq!((log.position_m.values[0][1], log.angular_velocity_rad_s.values[0]), (1.0, [0.2; 3]));
    assert!(log.ref_position_m.is_empty());
}

#[test]
fn clocks_that_differ_give_way_to_that_of_the_recorder() {
    let bag = |late_ns: u64, stamp: fn(u64) -> u64| {
        let mut bag = Bag::new(Written::default());
        bag.topic("/pose", "geometry_msgs/msg/PoseStamped");
        bag.topic("/imu", "sensor_msgs/msg/Imu");
        for (ns, x) in (0..6).map(at) {
            bag.put("/pose", ns + late_ns, &made::pose(false, stamp(ns), [x; 3], LEVEL));
            bag.put("/imu", ns + late_ns, &made::imu(ns, [0.1; 3], [9.0; 3]));
        }
        bag.bytes()
    };
    // Late, but on one clock; 100 s apart; without stamps in one message; stamps that stand still.
    let log = read(&bag(300_000_000, |ns| ns)).unwrap();
    assert_eq!(log.start_s, START_NS as f64 * 1e-9);
    let apart = bag(3_000_000, |ns| ns - 100_000_000_000);
    let log = read(&apart).unwrap();
    assert_eq!(log.start_s, (START_NS + 3_000_000) as f64 * 1e-9);
    says(&log, "the clocks of /pose and /imu are 100.0 s apart");
    let log = read_with(&apart, "[columns]\nt = \"header.stamp\"\n").unwrap();
    assert!((log.angular_velocity_rad_s.t_s[0] - 100.0).abs() < 1e-9);
    let log = read(&bag(3_000_000, |ns| if ns == START_NS { 0 } else { ns })).unwrap();
    says(&log, "/pose (geometry_msgs/PoseStamped): position, attitude; times: times of the recorder");
    let log = read(&bag(3_000_000, |_| START_NS)).unwrap();
    says(&log, "stamps of /pose stand still");
    assert_eq!(log.position_m.len(), 6);
    let log = read_with(&bag(3_000_000, |ns| ns), "[columns]\nt = \"log_time\"\n").unwrap();
    assert_eq!(log.start_s, (START_NS + 3_000_000) as f64 * 1e-9);
}

#[test]
fn messages_out_of_order_are_sorted_and_stamps_that_run_backwards_are_said() {
    let mut bag = Bag::new(Written::default());
    bag.topic("/pose", "geometry_msgs/msg/PoseStamped");
    for i in [1, 0, 2, 3, 4, 5] {
        let (ns, x) = at(i);
        // Message 5 was measured before message 4, and message 6 at the time of message 5.
        let stamp = if i >= 4 { at(2).0 + 1 } else { ns };
        bag.put("/pose", ns, &made::pose(false, stamp, [x; 3], LEVEL));
    }
    let log = read(&bag.bytes()).unwrap();
    assert_eq!(log.position_m.values.iter().map(|v| v[0]).collect::<Vec<_>>(), [0.0, 0.25, 0.5, 0.75, 1.0]);
    says(&log, "1 messages of /pose repeat the time");
    says(&log, "`t = \"log_time\"`");
    let report = crate::check(&log).to_string();
    assert!(report.contains("time runs backwards at message 5 of /pose"), "{report}");
}

#[test]
fn sequences_of_changing_length_and_of_several_bodies_are_left_out_and_said() {
    let mut bag = Bag::new(Written::default());
    bag.topic("/pose", "geometry_msgs/msg/PoseStamped");
    bag.topic("/motors", "std_msgs/msg/Float64MultiArray");
    bag.topic("/vicon", "geometry_msgs/msg/TransformStamped");
    for (i, (ns, x)) in (0..4).map(at).enumerate() {
        bag.put("/pose", ns, &made::pose(false, ns, [x; 3], LEVEL));
        bag.put("/motors", ns, &made::array(&vec![1.0; 3 + i % 2]));
        let body = ["cf1", "cf2"][i % 2];
        bag.put("/vicon", ns, &Bytes::cdr(false).header(ns, "w").text(body).f64(&[x; 3]).f64(&LEVEL).done());
    }
    let bytes = bag.bytes();
    let log = read(&bytes).unwrap();
    assert_eq!(log.position_m.len(), 4);
    says(&log, "/vicon was left out: its messages tell of several bodies or frames (child_frame_id changes)");
    refused(&bytes, "[columns]\nvbat = \"/motors.data[0]\"\n", &["(not data: not as long in every message)"]);
}

#[test]
fn what_cannot_be_read_is_said_by_topic() {
    let mut bag = Bag::new(Written::default());
    bag.topic("/pose", "geometry_msgs/msg/PoseStamped");
    bag.any("/web", "foxglove.Pose", "jsonschema", "{}", "json");
    bag.any("/idl", "own/msg/It", "ros2idl", "struct", "cdr");
    bag.any("/bare", "", "", "", "cdr");
    bag.any("/wide", "sensor_msgs/msg/Imu", "ros2msg", "wstring w", "cdr");
    for topic in ["/web", "/idl", "/bare", "/wide"] {
        bag.put(topic, START_NS, b"{}{}{}{}");
    }
    for (ns, x) in (0..3).map(at) {
        bag.put("/pose", ns, &made::pose(false, ns, [x; 3], LEVEL));
    }
    bag.put("/pose", START_NS + 90_000_000, &[0, 1, 0, 0, 5]);
    let bytes = bag.bytes();
    let log = read(&bytes).unwrap();
    assert_eq!(log.position_m.len(), 3);
    says(&log, "/web left out: its messages are `json`; what is read is message encoding `cdr`");
    says(&log, "/idl left out: its type is defined in IDL");
    says(&log, "/bare left out: the file has no definition");
    says(&log, "/wide left out: a field of type `wstring`");
    says(&log, "1 messages of /pose were left out: a message that ends before its last field");
    refused(&bytes, "[columns]\nvbat = \"/web.voltage\"\n", &["a topic /web that can be read", "`json`"]);
    let mut bag = Bag::new(Written::default());
    bag.any("/web", "foxglove.Pose", "jsonschema", "{}", "json");
    bag.put("/web", START_NS, b"{}");
    refused(&bag.bytes(), "", &["the topics /web (its messages are `json`)", "cdr"]);
    refused(&Bag::new(Written::default()).bytes(), "", &["found no message", "check that the recorder ran"]);
    refused(b"", "format = \"mcap\"", &["an MCAP file", "an empty file"]);
    refused(b"SQLite format 3\0", "", &["a bag in SQLite", "ros2 bag convert -i OLD"]);
    refused(b"#ROSBAG V2.0\n", "", &["a bag of ROS 1", "mcap convert"]);
    let packed = of("geometry_msgs/msg/PoseStamped", |_, _| vec![0x28, 0xb5, 0x2f, 0xfd, 0, 0], 3);
    refused(&packed, "", &["packed one by one", "(3 messages)"]);
}

#[test]
fn a_bag_that_was_never_closed_gives_every_whole_message() {
    for compression in [None, Some(Compression::Lz4), Some(Compression::Zstd)] {
        let bytes = made::short(Written { compression, chunk_bytes: 2000, chunks: true });
        let mut last = 0;
        for end in (8..bytes.len()).step_by(61) {
            match read(&bytes[..end]) {
                Ok(log) => {
                    let n = log.position_m.len();
                    assert!(n >= last, "{end}: {n} after {last}");
                    last = n;
                }
                Err(e) => assert!(last == 0, "{end}: {e}"),
            }
        }
        assert_eq!(last, 10);
        // The last record of the messages (`data end`, four bytes) is missing, or more.
        let end = bytes.windows(9).rposition(|w| w == [15, 4, 0, 0, 0, 0, 0, 0, 0]).unwrap();
        let log = read(&bytes[..end - 20]).unwrap();
        says(&log, "bag.mcap ends or is damaged at byte");
    }
}

#[test]
fn a_damaged_chunk_is_left_out_and_the_others_are_read() {
    let bytes = made::short(Written { compression: None, chunk_bytes: 2000, chunks: true });
    let whole = read(&bytes).unwrap();
    // 0.05 as it stands in a position.
    let at = bytes.windows(8).position(|w| w == 0.05f64.to_le_bytes()).unwrap();
    let mut odd = bytes.clone();
    odd[at + 3] ^= 4;
    let log = read(&odd).unwrap();
    says(&log, "is damaged (");
    assert!(log.position_m.len() < whole.position_m.len() && log.position_m.len() > 4);
    assert!(log.position_m.values.iter().all(|v| whole.position_m.values.contains(v)));
}

#[test]
fn no_byte_that_is_wrong_makes_the_reader_panic() {
    for compression in [None, Some(Compression::Lz4), Some(Compression::Zstd)] {
        let bytes = made::short(Written { compression, chunk_bytes: 1500, chunks: compression.is_some() });
        let mut seed = 1u64;
        for at in (0..bytes.len()).step_by(13) {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            let mut odd = bytes.clone();
            odd[at] = (seed >> 33) as u8;
            if seed.is_multiple_of(5) {
                odd.truncate(bytes.len() - (seed >> 40) as usize % bytes.len());
            }
            let _ = read(&odd).map(|log| crate::check(&log).to_string());
        }
    }
}

#[test]
fn the_folder_of_a_bag_is_read_file_after_file() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("rosbag2_1");
    std::fs::create_dir(&bag).unwrap();
    let part = |from: u64| {
        let mut made = Bag::new(Written { compression: Some(Compression::Zstd), ..Written::default() });
        made.topic("/pose", "geometry_msgs/msg/PoseStamped");
        for (ns, x) in (from..from + 3).map(at) {
            made.put("/pose", ns, &made::pose(false, ns, [x; 3], LEVEL));
        }
        made.bytes()
    };
    std::fs::write(bag.join("it_0.mcap"), part(0)).unwrap();
    std::fs::write(bag.join("it_1.mcap"), part(3)).unwrap();
    std::fs::write(
        bag.join("metadata.yaml"),
        "a:\n  relative_file_paths:\n    - it_0.mcap\n    - it_1.mcap\n",
    )
    .unwrap();
    let log = FlightLog::load(&bag, None).unwrap();
    assert_eq!((log.position_m.len(), log.n_rows, log.sha256.len()), (6, 6, 64));
    assert!(log.position_m.is_ordered() && log.path == bag);
    // A mapping beside the folder.
    std::fs::write(folder.path().join("rosbag2_1.toml"), "world_frame = \"ned\"\n").unwrap();
    let turned = FlightLog::load(&bag, None).unwrap();
    assert_eq!(turned.position_m.values[4], [1.0, -1.0, -1.0]);
}

/// A bag that another program wrote (tests/reference/ros2_bags.py says which).
fn foreign(name: &str, mapping: &str) -> FlightLog {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/bags").join(name);
    FlightLog::load_with(&path, Some(&Mapping::parse(mapping, Path::new("bag.toml")).unwrap())).unwrap()
}

#[test]
fn bags_of_two_foreign_writers_read_as_they_were_meant() {
    let rosbags =
        foreign("rosbags.mcap", "contract_names = true\n[columns]\nrotor1 = \"/joints.velocity[1]\"\n");
    let foxglove = foreign("foxglove.mcap", "");
    for log in [&rosbags, &foxglove] {
        assert_eq!(log.position_m.len(), 5);
        assert!((log.start_s - 1_700_000_000.123_457).abs() < 1e-6);
        for i in 0..5 {
            let n = i as f64;
            assert_eq!(log.position_m.values[i], [0.25 * n, 1.0 + 0.5 * n, -2.0]);
            assert_eq!(log.attitude.values[i], [0.5, -0.5, 0.5, 0.5]);
            assert!((log.position_m.t_s[i] - 5.000_003e-3 * n).abs() < 1e-12);
        }
    }
    for i in 0..5 {
        let n = i as f64;
        // The attitude takes the body's x, y, z to the world's z, −x, −y.
        for (is, meant) in rosbags.velocity_m_s.values[i].iter().zip([0.0, 0.25 * n, 1.5]) {
            assert!((is - meant).abs() < 1e-15, "{:?}", rosbags.velocity_m_s.values[i]);
        }
        assert_eq!(rosbags.angular_velocity_rad_s.values[i], [0.125, -0.5 * n, 3.0]);
        assert_eq!(rosbags.specific_force_m_s2.values[i], [0.1, -0.2 * n, 9.81]);
        assert_eq!(rosbags.vbat_v.values[i], [16.5 - 0.25 * n]);
        assert_eq!(rosbags.rotor_speed_rad_s[0].values[i], [1001.5 + n]);
    }
    type Of = fn(f64) -> f64;
    let columns: [(&str, Of); 10] = [
        ("on", |n| 1.0 - n % 2.0),
        ("b", |n| 0.25 * n),
        ("a", |n| -n),
        ("d", |n| n - 300.0),
        ("c", |_| 200.0),
        ("few[2]", |n| 2.5 + n),
        ("some[1]", |_| 2.0),
        ("parts[1].x[0]", |n| 1.0 + 0.5 * n),
        ("e", |n| (1u64 << 40) as f64 + n),
        ("last", |n| -0.25 * n),
    ];
    for (path, value) in columns {
        let log = foreign("foxglove.mcap", &format!("[columns]\nvbat = \"/odd.{path}\"\n"));
        let expected: Vec<f64> = (0..5).map(|i| value(f64::from(i))).collect();
        assert_eq!(log.vbat_v.component(0), expected, "{path}");
    }
}
