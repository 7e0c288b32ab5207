"""Bags of ROS 2 by two writers that are not ours: what `tests/flight_bags.rs` reads.

Usage: python tests/reference/ros2_bags.py OUT_DIR

The files in tests/data/bags were written on 2026-11-27 with rosbags 0.11.9, mcap 1.6.0 and mcap-ros2-support 0.6.0 (`pip install rosbags
mcap-ros2-support`), Python 3.11:
  rosbags.mcap    rosbags, with its own definitions of ROS 2 Jazzy: odometry, inertial sensor, battery, joints
  foxglove.mcap   mcap-ros2-support, chunks in zstd: poses, and a message of all kinds of fields

Message i tells of the time START_NS + i * 5,000,003 ns; it was recorded 2 ms later.
"""

import shutil
import sys
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType
from mcap_ros2.writer import Writer as FoxgloveWriter
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

START_NS = 1_700_000_000_123_456_789
MESSAGES = 5


def moment(i: int):
    """Time (ns), position, attitude xyzw, velocity and rates in the body, specific force."""
    pos, quat = (0.25 * i, 1 + 0.5 * i, -2.0), (0.5, -0.5, 0.5, 0.5)
    return START_NS + 5_000_003 * i, pos, quat, (1.5, 0.0, -0.25 * i), (0.125, -0.5 * i, 3.0), (0.1, -0.2 * i, 9.81)


def rosbags(path: Path):
    """A bag by rosbags, one file of whose folder is kept."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types = store.types
    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    folder = path.with_suffix("")
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topics = {"/odom": "nav_msgs/msg/Odometry", "/imu": "sensor_msgs/msg/Imu"}
        topics |= {"/battery": "sensor_msgs/msg/BatteryState", "/joints": "sensor_msgs/msg/JointState"}
        connections = {t: writer.add_connection(t, kind, typestore=store) for t, kind in topics.items()}

        def put(topic: str, ns: int, **fields):
            stamp = types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="odom")
            message = types[topics[topic]](header=header, **fields)
            writer.write(connections[topic], ns + 2_000_000, store.serialize_cdr(message, topics[topic]))

        for i in range(MESSAGES):
            ns, pos, quat, vel, rates, force = moment(i)
            pose = types["geometry_msgs/msg/Pose"](types["geometry_msgs/msg/Point"](*pos), quaternion(*quat))
            twist = types["geometry_msgs/msg/Twist"](vector(*vel), vector(*rates))
            put(
                "/odom",
                ns,
                child_frame_id="base_link",
                pose=types["geometry_msgs/msg/PoseWithCovariance"](pose, np.arange(36.0)),
                twist=types["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
            )
            none = np.zeros(9)
            none[0] = -1
            put(
                "/imu",
                ns,
                orientation=quaternion(0.0, 0.0, 0.0, 1.0),
                orientation_covariance=none,
                angular_velocity=vector(*rates),
                angular_velocity_covariance=np.zeros(9),
                linear_acceleration=vector(*force),
                linear_acceleration_covariance=np.zeros(9),
            )
            amounts = dict.fromkeys(["temperature", "current", "charge", "capacity", "design_capacity", "percentage"], 0.5)
            put(
                "/battery",
                ns,
                voltage=16.5 - 0.25 * i,
                **amounts,
                power_supply_status=2,
                power_supply_health=1,
                power_supply_technology=3,
                present=True,
                cell_voltage=np.array([4.0, 4.25, 4.125], dtype=np.float32),
                cell_temperature=np.array([], dtype=np.float32),
                location="slot",
                serial_number="x7",
            )
            speeds = np.array([1000.0 + i, 1001.5 + i, -3.25])
            put("/joints", ns, name=["m1", "m2", "m3"], position=np.array([]), velocity=speeds, effort=np.array([]))
    shutil.move(folder / f"{folder.name}.mcap", path)
    shutil.rmtree(folder)


LINE = "=" * 80
POSE = f"""std_msgs/Header header
geometry_msgs/Pose pose
{LINE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{LINE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
{LINE}
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
{LINE}
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
{LINE}
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
"""
ODD = f"""bool on
string word
float64 b
int8 a
int16 d
uint8 c
float32[3] few
int32[<=4] some
Part[2] parts
uint64 e
float64 last
{LINE}
MSG: own/Part
uint8 k
float64[] x
"""


def foxglove(path: Path):
    """A file by mcap-ros2-support."""
    with open(path, "wb") as file:
        writer = FoxgloveWriter(file, chunk_size=600, compression=CompressionType.ZSTD)
        pose = writer.register_msgdef("geometry_msgs/msg/PoseStamped", POSE)
        odd = writer.register_msgdef("own/msg/Odd", ODD)
        for i in range(MESSAGES):
            ns, pos, quat, vel, _, _ = moment(i)
            header = {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}, "frame_id": "map"}
            at = {"position": dict(zip("xyz", pos, strict=True)), "orientation": dict(zip("xyzw", quat, strict=True))}
            writer.write_message("/pose", pose, {"header": header, "pose": at}, log_time=ns + 2_000_000)
            parts = [{"k": 1, "x": [pos[0]]}, {"k": 2, "x": [pos[1], 7.0]}]
            fields = {"on": i % 2 == 0, "word": "w" * i, "b": pos[0], "a": -i, "d": -300 + i, "c": 200}
            fields |= {"few": [0.5, 1.5, 2.5 + i], "some": [1, 2], "parts": parts, "e": 2**40 + i, "last": vel[2]}
            writer.write_message("/odd", odd, fields, log_time=ns + 2_000_000)
        writer.finish()


if __name__ == "__main__":
    out = Path(sys.argv[1])
    out.mkdir(parents=True, exist_ok=True)
    rosbags(out / "rosbags.mcap")
    foxglove(out / "foxglove.mcap")
