"""Flight stacks in the loop: PX4, ArduPilot or Betaflight flies a simulated vehicle."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from . import _native
from ._native import Vehicle
from .sense import _floats, _whole
from .sim import SceneLike, _path, _plain, _scene, _sensors, _text, _vehicle


@dataclass(frozen=True)
class SitlTouch:
    """The vehicle touched something."""

    time: float
    """When, s."""
    what: str
    """Name of the geom, or ``"the ground"``."""
    speed: float
    """How fast it was, m/s."""
    stands: bool
    """Whether it stands on it now; else it was stopped in the direction of it."""


@dataclass(frozen=True)
class SitlTraffic:
    """What went over the link so far."""

    commands: int
    """Commands of motors that came."""
    others: int
    """Messages of other kinds."""
    malformed: int
    """Packets that are none of the protocol, and bytes between messages of PX4."""
    stale: int
    """Commands that came too late, or in answer to something before."""
    lost: int
    """Packets that were lost, as far as their numbers say, and states that were sent again."""
    restarts: int
    """How often the stack began anew."""


class Sitl:
    """A simulator that a flight stack flies in: the stack runs the controller, Propwash is the vehicle, the world and the sensors, in
    lockstep (docs/sitl.md)::

        with propwash.Sitl("hb_x500", stack="px4", speed=0.0) as sitl:
            print(sitl.address)          # where PX4 is to connect
            while sitl.time < 60.0:
                sitl.step(250)           # waits for PX4, and flies 250 exchanges
            print(sitl.pos)

    The world's x points north, y west, z up; positions count from where the vehicle stands at the start.

    Args:
        drone: Name of a built-in vehicle, path of a vehicle file, or a ``Vehicle``; flown by first principles.
        stack: ``"px4"`` (HIL messages of MAVLink over TCP), ``"ardupilot"`` (its JSON interface over UDP) or ``"betaflight"`` (the packets
            of its SITL over UDP).
        scene: As in ``Sim``; level ground where it is None.
        start: The vehicle starts on what is below this point, m, world.
        heading: Where its nose points at the start, degrees from north to the east.
        address: Address at which it listens.
        port: Port; that of the stack where it is None (4560 for PX4, 9002 for the others), 0 is any that is free.
        firmware: Where Betaflight hears states, ``"IP:PORT"``; it hears sticks at the next port.
        rate: Exchanges per second; that of the stack where it is None (250 for PX4, 1000 for Betaflight, for ArduPilot what it asks
            for).
        substeps: Steps of the simulation in each exchange; as many as it needs for 1000 Hz where it is None.
        home: Where on Earth it starts: latitude and longitude, degrees, and height above the sea, m.
        seed: Seed of all random numbers.
        speed: Simulated seconds for each second, at most; 0 is as fast as the stack answers.
        timeout: How long the stack may say nothing once it has begun, s; 0 is for ever.
        throttle: What a command of 0 to 1 means: ``"speed"`` (rotor speed in proportion to it), ``"thrust"`` or ``"vehicle"`` (the
            ``[throttle]`` of the vehicle file); None is that of the file where it has one, else speed.
        max_speed: Rotor speed at full power, rad/s, for the law of speed; that of the greatest thrust where it is None.
        motors: For each motor of the stack the rotor that it drives; by where rotors stand and how they turn where it is None.
        pulses: Pulse widths of ArduPilot's outputs at no and at full power, µs.
        noise: Errors of the sensors, a dict (docs/sitl.md), ``{}`` for none; None is those of a small autopilot for PX4, none for the
            others.
        sensors: Range finders for ArduPilot (docs/sensors.md).
        again: When PX4 closes the connection, put the vehicle back and wait for it again; else that is an error.
        record: Path of a log of what flies (CSV, docs/logs.md).
        force: Replace that file if there is one.

    Raises:
        TypeError, ValueError: for arguments that make no sense, and for rotors in no order that the stack knows.
        OSError: for a port that cannot be opened, and for a file that cannot be read or written.
    """

    vehicle: Vehicle
    """What flies."""
    stack: str
    """The flight stack."""
    address: tuple[str, int]
    """Address and port at which it listens."""

    def __init__(
        self,
        drone: str | os.PathLike[str] | Vehicle = "hb_x500",
        stack: Literal["px4", "ardupilot", "betaflight"] = "px4",
        *,
        scene: SceneLike = None,
        start: Sequence[float] = (0.0, 0.0, 1.0),
        heading: float = 0.0,
        address: str = "127.0.0.1",
        port: int | None = None,
        firmware: str = "127.0.0.1:9003",
        rate: int | None = None,
        substeps: int | None = None,
        home: Sequence[float] = (47.397742, 8.545594, 488.0),
        seed: int = 0,
        speed: float = 1.0,
        timeout: float = 30.0,
        throttle: Literal["speed", "thrust", "vehicle"] | None = None,
        max_speed: float | None = None,
        motors: Sequence[int] | None = None,
        pulses: Sequence[int] = (1000, 2000),
        noise: Mapping[str, Any] | None = None,
        sensors: Sequence[str | Mapping[str, Any]] = (),
        again: bool = False,
        record: str | os.PathLike[str] | None = None,
        force: bool = False,
    ) -> None:
        lat, lon, alt = _floats("home", home, 3)
        config = {
            "stack": _text("stack", stack),
            "scene": None if scene is None else _scene(scene),
            "start_m": _floats("start", start, 3),
            "heading_deg": heading,
            "address": _text("address", address),
            "port": None if port is None else _whole("port", port, 0, 65535),
            "firmware": _text("firmware", firmware),
            "rate_hz": None if rate is None else _whole("rate", rate, 1, 10_000),
            "substeps": None if substeps is None else _whole("substeps", substeps, 1, 100),
            "home": {"lat_deg": lat, "lon_deg": lon, "alt_m": alt},
            "seed": _whole("seed", seed, 0, 2**64 - 1),
            "speed": speed,
            "timeout_s": timeout,
            "throttle": throttle,
            "max_speed_rad_s": max_speed,
            "motors": None if motors is None else [_whole("motors", m, 0, 63) for m in motors],
            "pulses_us": [_whole("pulses", p, 0, 5000) for p in pulses],
            "noise": None if noise is None else dict(noise),
            "sensors": _sensors(sensors),
            "again": bool(again),
            "record": None if record is None else _path("record", record),
            "replace": bool(force),
        }
        self.vehicle = _vehicle(drone)
        self.stack = stack
        self._native = _native.Sitl(json.dumps(_plain("", config)), self.vehicle)
        self.address = self._native.address()

    def step(self, n: int = 1) -> None:
        """Flies ``n`` exchanges. Waits for the stack: for ever until it first says something (Ctrl-C ends that), up to ``timeout`` after
        it.

        Raises:
            ConnectionError: where the stack closes the connection.
            TimeoutError: where it says nothing for too long.
            ValueError: where something else talks at the port.
            propwash.Error: where the simulation diverges.
        """
        self._native.step(_whole("n", n, 0, 2**32))

    def send_rc(self, channels: Sequence[int]) -> None:
        """Sends sticks to Betaflight: up to 16 channels, µs (roll, pitch, throttle, yaw, switches); those that are not given are 1500, the
        throttle 1000."""
        self._native.send_rc([_whole("channels", c, 0, 65535) for c in channels])

    def close(self) -> None:
        """Closes the port and the record; a ``step`` that waits in another thread ends with an error."""
        self._native.close()

    def __enter__(self) -> Sitl:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        host, port = self.address
        return f"Sitl({self.vehicle.name!r}, stack={self.stack!r}, address={host}:{port})"

    def _state(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(self._native.state())
        return found

    @property
    def time(self) -> float:
        """Simulated time since the start, s."""
        return float(self._state()["time"])

    @property
    def rate(self) -> int:
        """Exchanges per second."""
        return int(self._state()["rate_hz"])

    @property
    def pos(self) -> NDArray[np.float64]:
        """Where the vehicle is, from where it stood at the start, m (north, west, up). (3,)"""
        return np.array(self._state()["pos"])

    @property
    def quat(self) -> NDArray[np.float64]:
        """Attitude x y z w, body to world. (4,)"""
        return np.array(self._state()["quat"])

    @property
    def vel(self) -> NDArray[np.float64]:
        """Velocity, m/s, world. (3,)"""
        return np.array(self._state()["vel"])

    @property
    def ang_vel(self) -> NDArray[np.float64]:
        """Angular velocity, rad/s, body. (3,)"""
        return np.array(self._state()["ang_vel"])

    @property
    def rotor_vel(self) -> NDArray[np.float64]:
        """Rotor speeds, rad/s. (n_rotors,)"""
        return np.array(self._state()["rotor_vel"])

    @property
    def commands(self) -> NDArray[np.float64]:
        """What the stack's motors do, 0 to 1, in its order. (n_rotors,)"""
        return np.array(self._state()["commands"])

    @property
    def motors(self) -> tuple[int, ...]:
        """For each motor of the stack the rotor that it drives."""
        return tuple(self._state()["motors"])

    @property
    def armed(self) -> bool:
        """Whether PX4 is armed; of the others, whether any motor is on."""
        return bool(self._state()["armed"])

    @property
    def standing(self) -> bool:
        """Whether the ground carries the vehicle."""
        return bool(self._state()["standing"])

    @property
    def touches(self) -> tuple[SitlTouch, ...]:
        """What the vehicle touched so far, the first thousand times."""
        return tuple(SitlTouch(*touch) for touch in self._state()["touches"])

    @property
    def traffic(self) -> SitlTraffic:
        """What went over the link so far."""
        return SitlTraffic(**self._state()["traffic"])

    @property
    def notes(self) -> tuple[str, ...]:
        """What was said while it waited, and what was odd."""
        return tuple(self._native.notes())
