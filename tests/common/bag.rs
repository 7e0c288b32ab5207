//! Bags of ROS made for tests: MCAP files, their messages written by hand.

#![allow(dead_code, reason = "every program that includes this uses its own part of it")]

use std::collections::BTreeMap;
use std::io::Cursor;

pub use mcap::Compression;
use mcap::records::MessageHeader;
use mcap::{WriteOptions, Writer};

/// Definitions, without what they contain.
const PARTS: [(&str, &str); 10] = [
    ("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id\n"),
    ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n"),
    ("geometry_msgs/Pose", "Point position\nQuaternion orientation\n"),
    ("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z\n"),
    ("geometry_msgs/Quaternion", "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n"),
    ("geometry_msgs/Twist", "Vector3 linear\nVector3 angular\n"),
    ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n"),
    ("geometry_msgs/PoseWithCovariance", "Pose pose\nfloat64[36] covariance\n"),
    ("geometry_msgs/TwistWithCovariance", "Twist twist\nfloat64[36] covariance\n"),
    ("std_msgs/MultiArrayLayout", "uint32 data_offset\n"),
];

/// Types by name: their definition, and what of [`PARTS`] it contains.
const TYPES: [(&str, &str, &str); 7] = [
    (
        "geometry_msgs/msg/PoseStamped",
        "std_msgs/Header header\nPose pose\n",
        "Header Time Pose Point Quaternion",
    ),
    (
        "nav_msgs/msg/Odometry",
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\ngeometry_msgs/TwistWithCovariance twist\n",
        "Header Time PoseWithCovariance Pose Point Quaternion TwistWithCovariance Twist Vector3",
    ),
    (
        "sensor_msgs/msg/Imu",
        "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance # -1: none\n\
         geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n\
         geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n",
        "Header Time Quaternion Vector3",
    ),
    ("geometry_msgs/msg/TwistStamped", "std_msgs/Header header\nTwist twist\n", "Header Time Twist Vector3"),
    ("std_msgs/msg/Float64MultiArray", "MultiArrayLayout layout\nfloat64[] data\n", "MultiArrayLayout"),
    ("std_msgs/msg/Float32", "float32 data\n", ""),
    (
        "geometry_msgs/msg/TransformStamped",
        "std_msgs/Header header\nstring child_frame_id\nTransform transform\n===\nMSG: geometry_msgs/Transform\nVector3 translation\nQuaternion rotation\n",
        "Header Time Vector3 Quaternion",
    ),
];

/// The definition of a type as a recorder of ROS 2 writes it.
pub fn definition(name: &str) -> String {
    let (_, text, parts) = TYPES.iter().find(|(n, _, _)| *n == name).unwrap();
    let mut out = text.to_string();
    for part in parts.split_whitespace() {
        let (name, text) = PARTS.iter().find(|(n, _)| n.rsplit('/').next() == Some(part)).unwrap();
        out += &format!("{}\nMSG: {name}\n{text}", "=".repeat(80));
    }
    out
}

/// A message on its way, in CDR or in the layout of ROS 1.
pub struct Bytes {
    bytes: Vec<u8>,
    big: bool,
    ros1: bool,
}

impl Bytes {
    /// CDR, most significant byte first or last.
    pub fn cdr(big: bool) -> Self {
        Self { bytes: vec![0, u8::from(!big), 0, 0], big, ros1: false }
    }

    /// The layout of ROS 1.
    pub fn ros1() -> Self {
        Self { bytes: Vec::new(), big: false, ros1: true }
    }

    fn put<const N: usize>(mut self, mut number: [u8; N]) -> Self {
        while !self.ros1 && !(self.bytes.len() - 4).is_multiple_of(N) {
            // What stands in gaps is anything.
            self.bytes.push(0xaa);
        }
        if self.big {
            number.reverse();
        }
        self.bytes.extend(number);
        self
    }

    pub fn u8(self, v: u8) -> Self {
        self.put([v])
    }
    pub fn i16(self, v: i16) -> Self {
        self.put(v.to_le_bytes())
    }
    pub fn u32(self, v: u32) -> Self {
        self.put(v.to_le_bytes())
    }
    pub fn u64(self, v: u64) -> Self {
        self.put(v.to_le_bytes())
    }
    pub fn f32(self, v: f64) -> Self {
        self.put((v as f32).to_le_bytes())
    }
    pub fn f64(self, v: &[f64]) -> Self {
        v.iter().fold(self, |out, v| out.put(v.to_le_bytes()))
    }
    pub fn text(self, text: &str) -> Self {
        let end: &[u8] = if self.ros1 { b"" } else { b"\0" };
        let mut out = self.u32((text.len() + end.len()) as u32);
        out.bytes.extend(text.bytes());
        out.bytes.extend(end);
        out
    }
    /// A header of ROS 2 with a time (ns) and a frame.
    pub fn header(self, ns: u64, frame: &str) -> Self {
        self.u32((ns / 1_000_000_000) as u32).u32((ns % 1_000_000_000) as u32).text(frame)
    }
    pub fn done(self) -> Vec<u8> {
        self.bytes
    }
}

/// A pose in the frame `map`.
pub fn pose(big: bool, ns: u64, p: [f64; 3], q: [f64; 4]) -> Vec<u8> {
    Bytes::cdr(big).header(ns, "map").f64(&p).f64(&q).done()
}

/// An odometry: velocity and rates in the body.
pub fn odometry(ns: u64, child: &str, p: [f64; 3], q: [f64; 4], v: [f64; 3], w: [f64; 3]) -> Vec<u8> {
    let start = Bytes::cdr(false).header(ns, "odom").text(child);
    start.f64(&p).f64(&q).f64(&[0.0; 36]).f64(&v).f64(&w).f64(&[0.0; 36]).done()
}

/// Readings of an inertial sensor without an attitude.
pub fn imu(ns: u64, w: [f64; 3], f: [f64; 3]) -> Vec<u8> {
    imu_of(ns, Some(w), Some(f))
}

/// Readings of a gyroscope, of an accelerometer, or of both.
pub fn imu_of(ns: u64, w: Option<[f64; 3]>, f: Option<[f64; 3]>) -> Vec<u8> {
    let covariance = |is_there: bool| {
        let mut out = [0.0; 9];
        out[0] = if is_there { 0.0 } else { -1.0 };
        out
    };
    let start = Bytes::cdr(false).header(ns, "base_link").f64(&[0.0, 0.0, 0.0, 1.0]).f64(&covariance(false));
    let rates = start.f64(&w.unwrap_or_default()).f64(&covariance(w.is_some()));
    rates.f64(&f.unwrap_or_default()).f64(&covariance(f.is_some())).done()
}

/// Numbers of any count.
pub fn array(values: &[f64]) -> Vec<u8> {
    Bytes::cdr(false).u32(0).u32(values.len() as u32).f64(values).done()
}

/// How a file is written.
#[derive(Clone, Copy)]
pub struct Written {
    pub compression: Option<Compression>,
    pub chunk_bytes: u64,
    /// Whether messages stand in chunks.
    pub chunks: bool,
}

impl Default for Written {
    fn default() -> Self {
        Self { compression: None, chunk_bytes: 1 << 20, chunks: true }
    }
}

/// A bag on its way to a file.
pub struct Bag {
    writer: Writer<Cursor<Vec<u8>>>,
    channels: BTreeMap<String, u16>,
}

impl Bag {
    pub fn new(as_: Written) -> Self {
        let options = WriteOptions::new()
            .profile("ros2")
            .library("tests")
            .compression(as_.compression)
            .use_chunks(as_.chunks)
            .chunk_size(Some(as_.chunk_bytes));
        Self { writer: options.create(Cursor::default()).unwrap(), channels: BTreeMap::new() }
    }

    /// A topic with messages of a type of ROS 2.
    pub fn topic(&mut self, topic: &str, kind: &str) {
        self.any(topic, kind, "ros2msg", &definition(kind), "cdr");
    }

    /// A topic of any encoding.
    pub fn any(&mut self, topic: &str, kind: &str, schema: &str, text: &str, message: &str) {
        let id = match schema {
            "" => 0,
            _ => self.writer.add_schema(kind, schema, text.as_bytes()).unwrap(),
        };
        let id = self.writer.add_channel(id, topic, message, &BTreeMap::new()).unwrap();
        self.channels.insert(topic.into(), id);
    }

    pub fn put(&mut self, topic: &str, log_ns: u64, message: &[u8]) {
        let channel_id = self.channels[topic];
        let header = MessageHeader { channel_id, sequence: 0, log_time: log_ns, publish_time: log_ns };
        self.writer.write_to_known_channel(&header, message).unwrap();
    }

    pub fn bytes(mut self) -> Vec<u8> {
        self.writer.finish().unwrap();
        self.writer.into_inner().into_inner()
    }
}

/// When the flights of tests begin, ns.
pub const START_NS: u64 = 1_700_000_000_000_000_000;

/// A tenth of a second of hovering with everything that is read by itself, and an array.
pub fn short(as_: Written) -> Vec<u8> {
    let mut bag = Bag::new(as_);
    bag.topic("/odom", "nav_msgs/msg/Odometry");
    bag.topic("/imu", "sensor_msgs/msg/Imu");
    bag.topic("/motors", "std_msgs/msg/Float64MultiArray");
    for i in 0..10 {
        let ns = START_NS + 10_000_000 * i;
        let x = 0.01 * i as f64;
        let level = [0.0, 0.0, 0.0, 1.0];
        bag.put("/odom", ns, &odometry(ns, "base_link", [x, 0.0, 1.0], level, [1.0, 0.0, 0.0], [0.0; 3]));
        bag.put("/imu", ns, &imu(ns, [0.0; 3], [0.0, 0.0, 9.8]));
        bag.put("/motors", ns, &array(&[1000.0, 1001.0, 1002.0, 1003.0]));
    }
    bag.bytes()
}
