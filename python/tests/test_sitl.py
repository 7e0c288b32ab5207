"""Flight stacks in the loop, at the level of messages: pymavlink plays PX4, sockets play ArduPilot and Betaflight. A small controller in
each client holds the vehicle in the air through the whole protocol. With PROPWASH_BETAFLIGHT (path of a betaflight_SITL) the firmware itself flies."""

import json
import math
import os
import re
import socket
import struct
import subprocess
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import propwash

os.environ.setdefault("MAVLINK20", "1")

G = 9.81
MASS, ARM, TORQUE_PER_THRUST = 2.28, 0.17678, 0.016
INERTIA = np.array([24e-3, 24e-3, 44e-3])
# Signs by motor: front right, rear left, front left, rear right. Roll: right side down; pitch: nose up; yaw: to the right.
ROLL = np.array([-1.0, 1.0, 1.0, -1.0])
PITCH = np.array([1.0, -1.0, 1.0, -1.0])
YAW = np.array([1.0, 1.0, -1.0, -1.0])
THRUST_MAX = propwash.Sim(control="rotor_vel", drone="hb_x500").parameters()["controller.thrust_max_n"]


def hold(goal, pos, vel, rpy, rates):
    """Controls, 0 to 1, that bring an X500 to ``goal``: all in north-east-down and forward-right-down, the nose to the north."""
    wanted = np.clip(1.5 * (goal - pos) - 2.0 * vel, -2.5, 2.5)
    thrust = MASS * (G - wanted[2]) / (math.cos(rpy[0]) * math.cos(rpy[1]))
    angles = np.array([wanted[1] / G, -wanted[0] / G, 0.0])
    torque = INERTIA * (60.0 * (angles - rpy) - 14.0 * rates) * np.array([1.0, 1.0, 0.3])
    forces = thrust / 4 + (ROLL * torque[0] + PITCH * torque[1]) / (4 * ARM) + YAW * torque[2] / (4 * TORQUE_PER_THRUST)
    return np.sqrt(np.clip(forces / THRUST_MAX, 0.0, 1.0))


def euler(w, x, y, z):
    return np.array(
        [
            math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
            math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x)))),
            math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
        ]
    )


class Stepping(threading.Thread):
    """``sitl.step(n)`` in a thread of its own."""

    def __init__(self, sitl, n):
        super().__init__(daemon=True)
        self.sitl, self.n, self.error = sitl, n, None
        self.start()

    def run(self):
        try:
            self.sitl.step(self.n)
        except Exception as e:
            self.error = e

    def done(self, seconds=60.0):
        self.join(seconds)
        assert not self.is_alive(), "the simulator still waits"
        if self.error is not None:
            raise self.error


class Px4:
    """PX4 as pymavlink speaks: in lockstep, with a controller of its own."""

    def __init__(self, address, lockstep=True):
        self.mav2 = pytest.importorskip("pymavlink.dialects.v20.common")
        self.link = socket.create_connection(address, timeout=20.0)
        self.link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.mav = self.mav2.MAVLink(None, srcSystem=1, srcComponent=1)
        self.mav.robust_parsing = False
        self.bytes, self.messages, self.lockstep = b"", [], int(lockstep)
        self.state = None

    def send(self, message):
        self.link.sendall(message.pack(self.mav))

    def controls(self, time_us, controls, armed=True):
        numbers = [float(c) for c in controls] + [0.0] * (16 - len(controls))
        m = self.mav2.MAVLink_hil_actuator_controls_message(time_us, numbers, 129 if armed else 1, self.lockstep)
        self.send(m)

    def sensors(self):
        """All messages up to the next HIL_SENSOR, which is the last of them."""
        found = []
        while True:
            # pymavlink keeps what is left of a read for the next call.
            message = self.mav.parse_char(b"")
            if message is None:
                data = self.link.recv(4096)
                if not data:
                    raise ConnectionError("the simulator closed the connection")
                self.bytes += data
                message = self.mav.parse_char(data)
            if message is not None:
                found.append(message)
                if message.get_type() == "HIL_STATE_QUATERNION":
                    self.state = message
                if message.get_type() == "HIL_SENSOR":
                    self.messages += found
                    return found

    def hold(self, goal):
        """One turn: sensors in, controls out."""
        sensor = self.sensors()[-1]
        s = self.state
        north = math.radians((s.lat * 1e-7 - 47.397742)) * 6371000.0
        east = math.radians((s.lon * 1e-7 - 8.545594)) * 6371000.0 * math.cos(math.radians(47.397742))
        pos = np.array([north, east, 488.0 - s.alt * 1e-3])
        vel = np.array([s.vx, s.vy, s.vz]) * 0.01
        rates = np.array([sensor.xgyro, sensor.ygyro, sensor.zgyro])
        self.controls(sensor.time_usec, hold(goal, pos, vel, euler(*s.attitude_quaternion), rates))
        return sensor


def fly_px4(n, goal, **options):
    """A whole session of ``n`` exchanges; what went over the wire, and the vehicle at the end."""
    with propwash.Sitl("hb_x500", stack="px4", port=0, speed=0.0, **options) as sitl:
        px4 = Px4(sitl.address)
        # In lockstep from the first sensors on.
        px4.controls(0, [0.0] * 4, armed=False)
        px4.send(px4.mav2.MAVLink_command_long_message(1, 1, 511, 0, 115, 4000, 0, 0, 0, 0, 0))
        stepping = Stepping(sitl, n)
        for _ in range(n):
            px4.hold(goal)
        stepping.done()
        return px4, sitl.pos, sitl.vel, sitl.traffic, sitl.time


def test_px4_hovers_through_the_protocol_in_lockstep():
    goal = np.array([1.0, -0.5, -3.0])
    px4, pos, vel, traffic, seconds = fly_px4(2000, goal)
    assert seconds == pytest.approx(8.0)
    # North, west, up.
    np.testing.assert_allclose(pos, [1.0, 0.5, 3.0], atol=0.15)
    np.testing.assert_allclose(vel, 0.0, atol=0.15)
    assert traffic.malformed == 0 and traffic.lost == 0 and traffic.commands >= 2000
    kinds = [m.get_type() for m in px4.messages]
    # Sensors each time, the truth as often as it was asked for, fixes at 10 Hz, heartbeats and the time each second.
    assert kinds.count("HIL_SENSOR") == 2000 and kinds.count("HIL_GPS") == 80
    assert kinds.count("HIL_STATE_QUATERNION") >= 1998
    assert kinds.count("HEARTBEAT") == kinds.count("SYSTEM_TIME") == 8
    sensors = [m for m in px4.messages if m.get_type() == "HIL_SENSOR"]
    assert [m.time_usec for m in sensors] == [4000 * (i + 1) for i in range(2000)]
    imu, mag, baro = 0b111111, 0b111000000, 0b1101000000000
    assert sum(m.fields_updated & imu == imu for m in sensors) == 2000
    assert sum(m.fields_updated & mag == mag for m in sensors) == 800
    assert sum(m.fields_updated & baro == baro for m in sensors) == 400


def test_px4_gets_the_sensors_of_a_vehicle_that_stands():
    with propwash.Sitl("hb_x500", stack="px4", port=0, speed=0.0, noise={}, heading=90.0) as sitl:
        px4 = Px4(sitl.address)
        px4.controls(0, [0.0] * 4, armed=False)
        stepping = Stepping(sitl, 100)
        for _ in range(100):
            found = px4.sensors()
            px4.controls(found[-1].time_usec, [1.0] * 4, armed=False)
        stepping.done()
        # Full power without the armed flag moves nothing.
        assert sitl.standing and not sitl.armed and np.all(sitl.pos == 0.0)
    one = {m.get_type(): m for m in px4.messages}
    s = next(m for m in reversed(px4.messages) if m.get_type() == "HIL_SENSOR" and m.fields_updated & 0b1101111000000 == 0b1101111000000)
    np.testing.assert_allclose([s.xacc, s.yacc, s.zacc], [0.0, 0.0, -G], atol=1e-5)
    np.testing.assert_allclose([s.xgyro, s.ygyro, s.zgyro], 0.0, atol=1e-9)
    # Facing east: north is on the left. pymavlink's own tables of the Earth's field, of an older epoch.
    mavextra = pytest.importorskip("pymavlink.mavextra")
    declination, inclination, strength = mavextra.get_mag_field_ef(47.397742, 8.545594)
    level = math.hypot(s.xmag, s.ymag)
    assert math.degrees(math.atan2(s.xmag, -s.ymag)) == pytest.approx(declination, abs=1.0)
    assert math.degrees(math.atan2(s.zmag, level)) == pytest.approx(inclination, abs=1.0)
    assert math.hypot(level, s.zmag) == pytest.approx(strength, abs=0.006)
    assert s.abs_pressure == pytest.approx(956.0, abs=0.5) and s.pressure_alt == pytest.approx(488.0, abs=0.1)
    assert s.temperature == pytest.approx(15.0 - 0.0065 * 488.0, abs=1e-3)
    gps = one["HIL_GPS"]
    assert (gps.lat, gps.lon, gps.alt, gps.fix_type) == (473977420, 85455940, 488000, 3)
    assert (gps.vn, gps.ve, gps.vd, gps.cog) == (0, 0, 0, 65535)
    np.testing.assert_allclose(np.degrees(euler(*one["HIL_STATE_QUATERNION"].attitude_quaternion)), [0.0, 0.0, 90.0], atol=1e-4)


def test_the_same_session_has_the_same_bytes_and_another_seed_others():
    goal = np.array([0.0, 0.0, -1.0])
    first, again, other = (fly_px4(300, goal, seed=seed)[0].bytes for seed in (4, 4, 5))
    assert first == again and len(first) > 300 * 70
    assert first != other


def test_px4_that_goes_is_said_and_may_come_again():
    sitl = propwash.Sitl("hb_x500", stack="px4", port=0, speed=0.0)
    px4 = Px4(sitl.address)
    px4.controls(0, [0.0] * 4)
    stepping = Stepping(sitl, 1000)
    px4.sensors()
    px4.link.close()
    with pytest.raises(ConnectionError, match="PX4 closed the connection at 0.0"):
        stepping.done()
    sitl.close()
    with pytest.raises(propwash.Error, match="closed"):
        sitl.step()
    with propwash.Sitl("hb_x500", stack="px4", port=0, speed=0.0, again=True) as sitl:
        stepping, last = Stepping(sitl, 1000), []
        for _ in range(2):
            px4 = Px4(sitl.address)
            px4.controls(0, [0.0] * 4)
            for _ in range(20):
                sensor = px4.sensors()[-1]
                px4.controls(sensor.time_usec, [0.0] * 4)
            last.append(sensor.time_usec)
            px4.link.close()
        assert max(last) < 40 * 4000, "time begins anew"
        while not any("put back" in note for note in sitl.notes):
            time.sleep(0.01)
    # Closing ends the step that waits.
    with pytest.raises(propwash.Error, match="closed"):
        stepping.done(10.0)


def test_a_px4_that_stops_is_told_of_within_the_time_out():
    with propwash.Sitl("hb_x500", stack="px4", port=0, speed=0.0, timeout=0.3) as sitl:
        px4 = Px4(sitl.address)
        px4.controls(0, [0.0] * 4)
        stepping = Stepping(sitl, 10)
        px4.sensors()
        # An answer to something before is none.
        px4.controls(0, [0.0] * 4)
        with pytest.raises(TimeoutError, match=r"HIL_ACTUATOR_CONTROLS .* 0.004 s: nothing came within 0.3 s"):
            stepping.done()


def test_something_else_at_the_port_of_px4_is_refused():
    with propwash.Sitl("hb_x500", stack="px4", port=0, speed=0.0) as sitl:
        link = socket.create_connection(sitl.address)
        link.sendall(b"GET / HTTP/1.1\r\n" * 200)
        with pytest.raises(ValueError, match="MAVLink"):
            sitl.step(10)
        link.close()


def test_a_port_in_use_an_order_of_motors_and_other_arguments_are_refused():
    with propwash.Sitl("hb_x500", stack="px4", port=0) as sitl:
        with pytest.raises(OSError, match=f"{sitl.address[1]}.*cannot be opened"):
            propwash.Sitl("hb_x500", stack="px4", port=sitl.address[1])
        assert sitl.motors == (0, 2, 3, 1) and "px4" in repr(sitl)
        with pytest.raises(ValueError, match="Betaflight"):
            sitl.send_rc([1500])
    with pytest.raises(ValueError, match="0 to 3 once, got 0,1,2,2"):
        propwash.Sitl("hb_x500", stack="px4", port=0, motors=[0, 1, 2, 2])
    with pytest.raises(ValueError, match="stack.*px4"):
        propwash.Sitl("hb_x500", stack="inav", port=0)
    with pytest.raises(ValueError, match="below which there is nothing"):
        propwash.Sitl("hb_x500", stack="px4", port=0, start=(0.0, 0.0, -5.0))
    with pytest.raises(TypeError, match="rate"):
        propwash.Sitl("hb_x500", stack="px4", port=0, rate=250.5)
    with propwash.Sitl("hb_x500", stack="px4", port=0, motors=[3, 2, 1, 0]) as sitl:
        assert sitl.motors == (3, 2, 1, 0)


def test_ipv6_is_served():
    try:
        socket.create_server(("::1", 0), family=socket.AF_INET6).close()
    except OSError:
        pytest.skip("this machine has no IPv6")
    with propwash.Sitl("hb_x500", stack="px4", address="::1", port=0, speed=0.0) as sitl:
        px4 = Px4(sitl.address)
        px4.controls(0, [0.0] * 4)
        stepping = Stepping(sitl, 1)
        px4.controls(px4.sensors()[-1].time_usec, [0.0] * 4)
        stepping.done()


class ArduPilot:
    """ArduPilot's side of its JSON interface."""

    def __init__(self, address, rate=400, channels=16):
        self.link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.link.settimeout(20.0)
        self.address, self.rate, self.channels, self.count, self.lines = address, rate, channels, 0, []

    def send(self, controls, count=None):
        pulses = [1000 + round(1000 * c) for c in controls] + [0] * (self.channels - len(controls))
        magic = 18458 if self.channels == 16 else 29569
        number = self.count if count is None else count
        self.link.sendto(struct.pack(f"<HHI{self.channels}H", magic, self.rate, number, *pulses), self.address)

    def receive(self):
        line = self.link.recv(4096)
        assert line[:1] == line[-1:] == b"\n"
        self.lines.append(line)
        return json.loads(line)

    def turn(self, controls):
        self.count += 1
        self.send(controls)
        return self.receive()


def fly_ardupilot(n, goal, channels=16, **options):
    with propwash.Sitl("hb_x500", stack="ardupilot", port=0, speed=0.0, **options) as sitl:
        pilot = ArduPilot(sitl.address, channels=channels)
        stepping, controls = Stepping(sitl, n), np.zeros(4)
        for _ in range(n):
            s = pilot.turn(controls)
            controls = hold(goal, np.array(s["position"]), np.array(s["velocity"]), euler(*s["quaternion"]), np.array(s["imu"]["gyro"]))
        stepping.done()
        return pilot, s, sitl.pos, sitl.traffic, sitl.rate


@pytest.mark.parametrize("channels", [16, 32])
def test_ardupilot_hovers_through_its_interface(channels):
    pilot, last, pos, traffic, rate = fly_ardupilot(3200, np.array([0.0, 1.0, -2.0]), channels)
    assert rate == 400 and last["timestamp"] == pytest.approx(8.0)
    np.testing.assert_allclose(last["position"], [0.0, 1.0, -2.0], atol=0.15)
    np.testing.assert_allclose(pos, [0.0, -1.0, 2.0], atol=0.15)
    assert last["imu"]["accel_body"][2] == pytest.approx(-G, abs=0.5)
    assert (traffic.commands, traffic.lost, traffic.malformed) == (3200, 0, 0)


def test_ardupilots_session_has_the_same_bytes_again():
    goal = np.array([0.0, 0.0, -1.0])
    noise = {"imu": {"gyroscope_density_rad_s_sqrt_hz": 1e-4}}
    first, again = (fly_ardupilot(400, goal, noise=noise)[0].lines for _ in range(2))
    assert first == again


def test_ardupilots_numbers_say_what_was_lost_repeated_or_started_anew():
    floor = "<mujoco><worldbody><geom type='plane' size='0 0 1'/></worldbody></mujoco>"
    finder = {"kind": "range_finder", "range_m": 30.0, "pos_m": [0.0, 0.0, 0.0]}
    with propwash.Sitl("hb_x500", stack="ardupilot", port=0, speed=0.0, scene=floor, sensors=[finder]) as sitl:
        pilot = ArduPilot(sitl.address)
        stepping = Stepping(sitl, 5)
        pilot.link.sendto(b"hello", sitl.address)
        first = pilot.turn([0.6] * 4)
        pilot.send([0.6] * 4)
        assert pilot.receive() == first and first["timestamp"] == pytest.approx(0.0025)
        assert 0.0 < first["rng_1"] < 1.0
        pilot.count += 3
        after = pilot.turn([0.6] * 4)
        assert after["timestamp"] == pytest.approx(0.005)
        pilot.turn([0.9] * 4)
        # ArduPilot is started again: another port, and numbers from the beginning.
        pilot = ArduPilot(sitl.address, rate=1200)
        anew = pilot.turn([0.0] * 4)
        assert anew["timestamp"] == pytest.approx(1 / 1200) and anew["velocity"] == [0, 0, 0]
        pilot.turn([0.0] * 4)
        stepping.done()
        t = sitl.traffic
        assert (t.lost, t.stale, t.malformed, t.restarts) == (3, 1, 1, 1) and sitl.rate == 1200
        assert any("5 bytes" in note for note in sitl.notes)


class Betaflight:
    """Betaflight's side: states in, motors out."""

    def __init__(self, firmware_port):
        self.states = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.states.bind(("127.0.0.1", firmware_port))
        self.states.settimeout(20.0)
        self.rc = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.rc.bind(("127.0.0.1", self.states.getsockname()[1] + 1))
        self.rc.settimeout(5.0)

    @property
    def port(self):
        return self.states.getsockname()[1]

    def receive(self):
        packet = self.states.recv(4096)
        assert len(packet) == 144
        return struct.unpack("<18d", packet)

    def send(self, controls, to):
        self.states.sendto(struct.pack("<4f", *controls), to)


def betaflight():
    for _ in range(20):
        try:
            return Betaflight(0)
        except OSError:
            continue
    pytest.skip("no two ports in a row are free")


def test_betaflight_hovers_through_its_packets():
    peer, goal, seen = betaflight(), np.array([0.5, 0.0, -1.5]), {}
    with propwash.Sitl("hb_x500", stack="betaflight", port=0, firmware=f"127.0.0.1:{peer.port}", speed=0.0) as sitl:
        stepping = Stepping(sitl, 6000)
        # The first state stands still until motors come.
        while len(seen) < 6001:
            s = peer.receive()
            t, gyro, acc, (w, x, y, z), vel, (lon, lat, alt), pressure = s[0], s[1:4], s[4:7], s[7:11], s[11:14], s[14:17], s[17]
            seen[t] = s
            north = math.radians(lat - 47.397742) * 6371000.0
            east = math.radians(lon - 8.545594) * 6371000.0 * math.cos(math.radians(47.397742))
            pos, speed = np.array([north, east, 488.0 - alt]), np.array([vel[1], vel[0], -vel[2]])
            peer.send(hold(goal, pos, speed, euler(w, x, y, z), np.array(gyro)), sitl.address)
        stepping.done()
        assert sitl.time == pytest.approx(6.0)
        np.testing.assert_allclose(sitl.pos, [0.5, 0.0, 1.5], atol=0.15)
        sitl.send_rc([1500, 1500, 1200, 1500, 2000])
        stamp, *channels = struct.unpack("<d16H", peer.rc.recv(100))
        assert stamp == pytest.approx(6.0) and channels[:6] == [1500, 1500, 1200, 1500, 2000, 1500]
        with pytest.raises(ValueError, match="16 channels"):
            sitl.send_rc([100])
    at_rest = seen[0.0]
    # Betaflight negates the accelerometer and then has it in forward-left-up.
    np.testing.assert_allclose(at_rest[4:7], [0.0, 0.0, -G], atol=1e-5)
    np.testing.assert_allclose(at_rest[7:11], [1.0, 0.0, 0.0, 0.0], atol=1e-9)
    assert at_rest[17] == pytest.approx(95600.0, abs=50.0) and abs(pressure - at_rest[17]) < 30.0 and abs(acc[2] + G) < 1.0


def test_what_flew_is_a_log_and_what_was_hit_is_told(tmp_path):
    log = tmp_path / "flight.csv"
    hall = "<mujoco><worldbody><geom type='plane' size='0 0 1'/><geom name='lid' type='box' size='2 2 .1' pos='0 0 2'/></worldbody></mujoco>"
    with propwash.Sitl("hb_x500", stack="ardupilot", port=0, speed=0.0, scene=hall, record=log) as sitl:
        pilot = ArduPilot(sitl.address)
        stepping = Stepping(sitl, 1600)
        for i in range(1600):
            pilot.turn([0.9 if i < 600 else 0.0] * 4)
        stepping.done()
        hits = [t for t in sitl.touches if not t.stands]
        landings = [t for t in sitl.touches if t.stands]
        # Up to the lid, held there, and down to the ground again.
        assert hits and all("lid" in t.what for t in hits) and hits[0].speed > 1.0
        assert landings and sitl.standing and abs(sitl.pos[2]) < 1e-6
        assert any("hit" in note and "lid" in note for note in sitl.notes)
        with pytest.raises(OSError):
            propwash.Sitl("hb_x500", stack="ardupilot", port=0, record=log)
    report = propwash.log_check(log)
    assert report.verdict != "refuse", report
    rows = np.genfromtxt(log, delimiter=",", names=True)
    assert len(rows) == 1600 and rows["pz"].max() > 1.0 and rows["cmd_rotor1"].max() > 500.0


def test_a_vehicle_that_no_stack_knows_is_refused_with_the_way_out():
    hexa = Path(__file__).resolve().parents[2] / "examples" / "own_vehicle" / "hexa.toml"
    with pytest.raises(ValueError, match="quadcopter"):
        propwash.Sitl(hexa, stack="betaflight", port=0)
    try:
        sitl = propwash.Sitl(hexa, stack="ardupilot", port=0)
    except ValueError as e:
        assert re.search("motor [1-6] of ArduPilot.*docs/sitl.md", str(e)), e
        sitl = propwash.Sitl(hexa, stack="ardupilot", port=0, motors=[0, 1, 2, 3, 4, 5])
    assert sorted(sitl.motors) == [0, 1, 2, 3, 4, 5]
    sitl.close()


@pytest.mark.skipif("PROPWASH_BETAFLIGHT" not in os.environ, reason="PROPWASH_BETAFLIGHT names no betaflight_SITL (docs/sitl.md)")
def test_the_firmware_of_betaflight_flies(tmp_path):
    """The firmware itself, at the speed of the clock: armed by a switch, in angle mode, climbing and sinking by the throttle."""
    program = Path(os.environ["PROPWASH_BETAFLIGHT"]).resolve()
    configure(program, tmp_path)
    firmware = subprocess.Popen([program, "127.0.0.1"], cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        with propwash.Sitl("hb_x500", stack="betaflight", timeout=10.0) as sitl:
            fly_by_sticks(sitl)
            assert sitl.traffic.malformed == 0
    finally:
        firmware.kill()
        firmware.wait()


def configure(program, folder):
    """Lets the firmware arm by channel 5 and level itself by channel 6, over its command line (TCP 5761), and saves that."""
    # The first start makes its memory, and ends.
    for _ in range(3):
        firmware = subprocess.Popen([program, "127.0.0.1"], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            time.sleep(3.0)
            if firmware.poll() is not None:
                continue
            link = socket.create_connection(("127.0.0.1", 5761), timeout=5.0)
            link.settimeout(0.2)
            time.sleep(1.0)
            said = talk(link, b"#", 2.0)
            if "CLI" not in said:
                continue
            for line in ["aux 0 0 0 1700 2100 0 0", "aux 1 1 1 1700 2100 0 0", "set small_angle = 180", "save"]:
                said += talk(link, line.encode() + b"\n", 1.0)
            link.close()
            return said
        except (BrokenPipeError, ConnectionError):
            continue
        finally:
            firmware.kill()
            firmware.wait()
    pytest.fail("the command line of the firmware does not answer")


def talk(link, line, seconds):
    link.sendall(line)
    said, until = b"", time.monotonic() + seconds
    while time.monotonic() < until:
        try:
            said += link.recv(65536)
        except TimeoutError:
            pass
    return said.decode(errors="replace")


def fly_by_sticks(sitl):
    """Arms, climbs to 2 m by the throttle, and tries roll, pitch and yaw one after the other."""

    def fly(seconds, armed=True, roll=1500, pitch=1500, yaw=1500, height=None):
        for _ in range(round(seconds * 50)):
            up = 0.0 if height is None else 150.0 * (height - sitl.pos[2]) - 200.0 * sitl.vel[2]
            throttle = 1000 if height is None else int(np.clip(1680.0 + up, 1100, 1900))
            sitl.send_rc([roll, pitch, throttle, yaw, 2000 if armed else 1000, 2000])
            sitl.step(20)
        return sitl.pos, sitl.vel, sitl.quat

    # The receiver of the firmware starts late, and hears no sticks that came before.
    sitl.step(3000)
    fly(2.0, armed=False)
    pos, _, _ = fly(1.0)
    assert sitl.armed and pos[2] == 0.0, "armed, at idle, on the ground"
    pos, vel, quat = fly(5.0, height=2.0)
    assert abs(pos[2] - 2.0) < 0.3 and abs(vel[2]) < 0.2 and quat[3] > 0.999, (pos, vel, quat)
    # In forward-left-up: to the right, then nose down; and level again each time.
    _, vel, quat = fly(0.6, roll=1650, height=2.0)
    assert quat[0] > 0.03 and vel[1] < -0.1 and abs(quat[1]) < 0.02, (vel, quat)
    _, vel, quat = fly(1.5, height=2.0)
    assert abs(quat[0]) < 0.02, quat
    _, after, quat = fly(0.6, pitch=1650, height=2.0)
    assert quat[1] > 0.03 and after[0] - vel[0] > 0.1 and abs(quat[0]) < 0.02, (vel, after, quat)
    pos, _, quat = fly(1.5, height=2.0)
    assert abs(quat[1]) < 0.02 and abs(pos[2] - 2.0) < 0.3, (pos, quat)
    # To the right about the way up.
    rates = []
    for _ in range(10):
        fly(0.1, yaw=1800, height=2.0)
        rates.append(sitl.ang_vel[2])
    assert np.mean(rates) < -0.1, rates
    pos, _, quat = fly(2.0, height=2.0)
    # The firmware's clock is that of a computer that may be busy: it flies on, level and about as high.
    assert abs(pos[2] - 2.0) < 0.8 and abs(sitl.ang_vel[2]) < 0.5 and max(abs(quat[0]), abs(quat[1])) < 0.1, (pos, quat)
