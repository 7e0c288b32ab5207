"""Controllers of one's own as Python functions, which fly without Python, and laws of other firmware: ``propwash.controller``.

The function runs once for a vehicle, over names of numbers instead of numbers, and becomes an expression of the vehicle's file that commands in place of the on-board controller (docs/controllers.md).

>>> @propwash.controller
... def mine(s):
...     lift = s.vehicle.mass * (9.81 + 6 * (s.command[2] - s.pos[2]) - 4 * s.vel[2])
...     s.mix(lift, -0.002 * s.ang_vel)
>>> sim = propwash.Sim(1024, drone=mine.on("cf2x_L250"), control="state")

``lee``, ``indi``, ``px4``, ``ardupilot`` and ``betaflight`` make controllers that are written this way.
"""

from __future__ import annotations

import os
from typing import Any, Callable, Sequence, overload

import numpy as np

from ._formula import Formula, Vector
from ._native import Vehicle
from .effects import _MOST_ROTORS, Effect, Memory, Surroundings, n_rotors

__all__ = ["Airframe", "Controller", "ardupilot", "betaflight", "controller", "indi", "lee", "px4"]


class Airframe:
    """The numbers of a vehicle that controllers need, as filed, in SI."""

    rotors: int
    """Number of rotors."""
    mass: float
    """Mass, kg."""
    gravity: float
    """Magnitude of gravity, m/s²."""
    inertia: np.ndarray[Any, Any]
    """Inertia, kg m², body. (3, 3)"""
    thrust_min: float
    """Least thrust of one rotor, N."""
    thrust_max: float
    """Greatest thrust of one rotor, N."""
    lag: float
    """Time in which a rotor near hover follows its command by 63 %, s."""
    thrust_curve: np.ndarray[Any, Any]
    """Thrust of a rotor by its speed: N, N s/rad, N s²/rad². (3,)"""
    wrench: np.ndarray[Any, Any]
    """Thrust (N) and torques (N m, body) by the rotors' thrusts. (4, rotor)"""
    shares: np.ndarray[Any, Any]
    """The rotors' thrusts (N) by thrust and torques. (rotor, 4)"""

    def __init__(self, vehicle: Vehicle) -> None:
        of = dict(vehicle.parameters())
        n = self.rotors = n_rotors(vehicle)

        def table(name: str, *shape: int) -> np.ndarray[Any, Any]:
            return np.array([of[".".join([name, *map(str, at)])] for at in np.ndindex(*shape)]).reshape(shape)

        self.mass = of["body.mass_kg"]
        self.gravity = float(np.linalg.norm(table("body.gravity_m_s2", 3)))
        self.inertia = table("body.inertia_kg_m2", 3, 3)
        self.thrust_min, self.thrust_max = of["controller.thrust_min_n"], of["controller.thrust_max_n"]
        self.thrust_curve = table("controller.thrust_curve", 3)
        self.wrench = table("controller.mixer.wrench_from_rotor", n, 4).T
        self.shares = table("controller.mixer.rotor_from_wrench", n, 4)
        hover = float(self.speed(self.mass * self.gravity / n))
        up, down = table("rotors.0.spin_up", 2), table("rotors.0.spin_down", 2)
        # Rotor accelerations go with c_v (command - speed) + c_d (command² - speed²).
        self.lag = 2 / float((up + down) @ [1.0, 2 * hover])

    def speed(self, thrust: Any) -> Any:
        """Speed of a rotor, rad/s, at which it lifts so many newtons by the thrust curve."""
        c0, c1, c2 = (float(c) for c in self.thrust_curve)
        if c2 == 0.0:
            return (thrust - c0) / c1
        return (np.sqrt(c1 * c1 - 4 * c2 * (c0 - thrust)) - c1) / (2 * c2)


def _ends(values: list[Any]) -> tuple[Any, Any]:
    """The least and the greatest of several numbers."""
    low = high = values[0]
    for value in values[1:]:
        low, high = np.minimum(low, value), np.maximum(high, value)
    return low, high


#: Frequency of yaw over that of roll and pitch: turning about z costs the rotors a multiple of what tilting does.
_YAW = 0.4


class Sight(Surroundings):
    """What a controller sees, and what it commands."""

    _ADDS = ("rotor_command",)
    _WHO = "a controller"

    def __init__(self, airframe: Airframe, period: str) -> None:
        super().__init__(airframe.rotors)
        object.__setattr__(self, "vehicle", airframe)
        object.__setattr__(self, "rotor_command", Vector("rotor_command", airframe.rotors, most=_MOST_ROTORS))
        # The period of the controller: a number that is not known before a simulation has its steps.
        object.__setattr__(self, "dt", Formula(period))

    def mix(self, thrust: Any, torque: Any, lag: float | None = None) -> None:
        """Commands the rotor speeds of a collective thrust (N) and three torques (N m, body), by the vehicle's geometry and thrust curve, each rotor within what it can give: where that is not enough,
        the thrust gives way to the torques, and these shrink together.

        With a ``lag`` (s) rotors that follow more slowly are told to go beyond where they shall be, by what their measured speeds lack, so that they follow as if by this time constant.
        """
        airframe: Airframe = self.vehicle
        ahead = 1.0 if lag is None else max(1.0, airframe.lag / lag)
        least, most = (float(airframe.speed(f)) for f in (airframe.thrust_min, airframe.thrust_max))
        x, y, z = torque
        shares = [[float(v) for v in airframe.shares[k]] for k in range(airframe.rotors)]
        room = airframe.thrust_max - airframe.thrust_min
        turns = [share[1] * x + share[2] * y + share[3] * z for share in shares]
        low, high = _ends(turns)
        shrink = room / np.maximum(room, high - low)
        lift = np.clip(thrust / airframe.rotors, airframe.thrust_min - low * shrink, airframe.thrust_max - high * shrink)
        for k, share in enumerate(shares):
            each = share[0] * airframe.rotors * lift + turns[k] * shrink
            speed = airframe.speed(np.clip(each, airframe.thrust_min, airframe.thrust_max))
            now = self.rotor_vel[k]
            self.rotor_command[k] = speed if ahead == 1.0 else np.clip(now + ahead * (speed - now), least, most)


#: What a controller with a rate of its own remembers beside what its function does.
_WAIT, _DUE, _PERIOD = "steps_to_wait", "is_due", "period_steps"


class Controller(Effect):
    """A controller that a Python function described; ``propwash.controller`` makes it."""

    hz: float | None
    """How often a second it runs; in every step where that is None."""
    _NUMBERS_ARE_PARAMETERS = False

    def __init__(self, function: Callable[..., Any], name: str | None = None, hz: float | None = None) -> None:
        if hz is not None and (isinstance(hz, bool) or not isinstance(hz, (int, float)) or not 0 < hz < np.inf):
            raise ValueError(f"hz: expected a rate above 0, got {hz!r}")
        self.hz = hz
        super().__init__(function, name)

    def _default(self) -> Surroundings:
        return self._sight(Vehicle("cf2x_L250"))

    def _sight(self, vehicle: Vehicle) -> Sight:
        period = "dt" if self.hz is None else f"({_PERIOD} * dt)"
        return Sight(Airframe(vehicle), period)

    def _written(self, seen: Surroundings) -> str:
        text = super()._written(seen)
        lacking = [k for k, value in enumerate(seen.rotor_command._values) if value is None]
        if lacking:
            raise TypeError(f"{self.name} commands no speed of rotor {lacking[0] + 1}: expected s.mix(thrust, torque), or s.rotor_command of all rotors")
        return text

    def _beside(self) -> list[str]:
        return ['models = ["first_principles"]\n', "controls = true\n"]

    def _before(self) -> list[str]:
        if self.hz is None:
            return []
        return [f"{_PERIOD} = max(1, floor(1 / ({self.hz!r} * dt) + 0.5))", f"{_DUE} = {_WAIT} < 0.5"]

    def _after(self, seen: Surroundings) -> None:
        """Holds what is commanded and remembered until the next turn."""
        if self.hz is None:
            return
        due = Formula(_DUE)
        for memory in seen._memories.values():
            memory.next = due.call("where", memory.next, memory.value)
        held = [Memory(f"held_rotor{k + 1}", 0.0) for k in range(len(seen.rotor_command))]
        for k, memory in enumerate(held):
            seen.rotor_command[k] = memory.next = due.call("where", seen.rotor_command[k], memory.value)
        wait = Memory(_WAIT, 0.0)
        wait.next = due.call("where", Formula(_PERIOD), wait.value) - 1
        seen._memories.update({memory.name: memory for memory in [*held, wait]})

    def on(self, vehicle: str | os.PathLike[str] | Vehicle) -> Vehicle:
        """A vehicle that this controller flies, in place of its on-board one.

        Raises:
            ValueError: for what expressions cannot say, with its place in the text; for a vehicle that has a controller of one's own already.
        """
        own = vehicle if isinstance(vehicle, Vehicle) else Vehicle(vehicle)
        if "\ncontrols = true" in own.to_toml():
            raise ValueError(f"{own.name}: expected a vehicle without a controller of one's own, found one: put {self.name} on the vehicle as it was before")
        return own.with_effects(self._written(self._sight(own)))

    def __repr__(self) -> str:
        return f"<propwash.Controller {self.name}>"


@overload
def controller(function: Callable[..., Any]) -> Controller: ...
@overload
def controller(*, hz: float | None = None) -> Callable[[Callable[..., Any]], Controller]: ...
def controller(function: Callable[..., Any] | None = None, *, hz: float | None = None) -> Controller | Callable[[Callable[..., Any]], Controller]:
    """Makes a controller of a Python function, which runs once for each vehicle and never in flight: it commands in place of the on-board controller.

    The function takes ``s``, which sees what ``propwash.effect`` lists, ``s.command`` (what ``Sim`` is told, by number, in the units of its control mode), ``s.vehicle``
    (``Airframe``) and ``s.dt`` (s between two turns), remembers by ``s.memory``, and calls ``s.mix(thrust, torque)`` or sets ``s.rotor_command`` (rad/s) of every rotor. It runs in every step, or
    ``hz`` times a second, rounded to whole steps. Arguments with an ``EffectParameter`` as default are parameters of the vehicle (``effect.expression.NAME.ARGUMENT``); at most eight.

    Raises:
        TypeError: for what cannot be part of an expression, with its line; for a rotor that is not commanded.
    """
    if function is None:
        return lambda own: Controller(own, hz=hz)
    return Controller(function, hz=hz)


def _vee(m: Any) -> Any:
    """The vector of a skew-symmetric matrix."""
    return np.array([m[2, 1], m[0, 2], m[1, 0]], dtype=object)


def _unit(v: Any) -> Any:
    return v / np.sqrt(v @ v + 1e-12)


def _matrix(quat: Any) -> Any:
    """The rotation from body to world. (3, 3)"""
    x, y, z, w = quat
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ], dtype=object)  # fmt: skip


def _product(a: Any, b: Any) -> Any:
    """Product of quaternions x, y, z, w."""
    vector = a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])
    return np.array([*vector, a[3] * b[3] - a[:3] @ b[:3]], dtype=object)


def _facing(force: Any, quat: Any) -> Any:
    """The attitude whose body z points along a force and whose body x points as near as can be to that of a quaternion. (3, 3)"""
    up = _unit(force)
    ahead = _matrix(quat)[:, 0]
    left = _unit(np.cross(up, ahead))
    return np.stack([np.cross(left, up), left, up], axis=1)


def _within_reach(vehicle: Airframe, asked: Any) -> Any:
    """Accelerations (m/s²) that four fifths of the rotors' greatest thrust can give beside gravity: sideways each, and upwards."""
    g, most = vehicle.gravity, 0.8 * vehicle.rotors * vehicle.thrust_max / vehicle.mass
    side = float(np.sqrt(max(most**2 - g**2, (0.2 * g) ** 2) / 2))
    up = max(0.8 * (most - g), 0.1 * g)
    return np.clip(asked, [-side, -side, -0.5 * g], [side, side, up])


def _followed(s: Any, position: tuple[float, float], attitude: tuple[float, float]) -> tuple[Any, Any]:
    """The thrust, N, and the angular acceleration, rad/s², by which a vehicle follows a command of `state`, by frequency (rad/s) and damping ratio of its translation and its
    attitude (Lee et al., 2010, eqs. 10-16)."""
    (w, damping), (turn, turn_damping) = position, attitude
    off, late = s.pos - s.command[0:3], s.vel - s.command[3:6]
    asked = _within_reach(s.vehicle, s.command[6:9] - w**2 * off - 2 * damping * w * late)
    force = s.vehicle.mass * (asked + np.array([0.0, 0.0, s.vehicle.gravity]))
    now, wanted = _matrix(s.quat), _facing(force, s.command[9:13])
    apart = 0.5 * _vee(wanted.T @ now - now.T @ wanted)
    spin = s.ang_vel - now.T @ (wanted @ s.command[13:16])
    turns = turn * np.array([1.0, 1.0, _YAW])
    return force @ now[:, 2], -(turns**2) * apart - 2 * turn_damping * turns * spin


def lee(
    position: float = 4.0, damping: float = 1.0, attitude: float = 20.0, attitude_damping: float = 0.8, lag: float = 0.02, hz: float | None = None
) -> Controller:
    """Geometric tracking control on SE(3), for ``control="state"`` (T. Lee, M. Leok, N. H. McClamroch, "Geometric tracking control of a quadrotor UAV on SE(3)", CDC 2010, eqs. 10-16).

    Gains are natural frequencies (rad/s) and damping ratios of the translation and the attitude, so that they fit any vehicle: k_x = m ω², k_v = 2 ζ m ω, k_R = J ω², k_Ω = 2 ζ J ω; that of yaw is 0.4 of ``attitude``; what they ask of the translation stays within what the rotors can give. The
    acceleration and the body rates of the command are fed forward; its angular acceleration, which commands do not have, is taken as zero. The law assumes rotors that follow at once: ``lag`` is that of
    ``s.mix``.
    """

    def law(s: Any) -> None:
        inertia = s.vehicle.inertia
        lift, turning = _followed(s, (position, damping), (attitude, attitude_damping))
        s.mix(lift, inertia @ turning + np.cross(s.ang_vel, inertia @ s.ang_vel), lag)

    return Controller(law, "lee", hz)


def indi(
    position: float = 4.0, damping: float = 1.0, attitude: float = 20.0, attitude_damping: float = 0.8, lag: float = 0.02, filter_hz: float = 30.0, hz: float | None = None
) -> Controller:
    """Incremental nonlinear dynamic inversion of the angular acceleration, for ``control="state"`` (E. J. J. Smeur, Q. Chu, G. C. H. E. de Croon, "Adaptive incremental nonlinear dynamic
    inversion for attitude control of micro air vehicles", JGCD 39(3), 2016): the torque that the rotors give, and the angular acceleration that it makes, both through the same low-pass of second order
    (``filter_hz``, damping 0.55), and what is missing is added. Position and attitude errors ask for accelerations as ``lee`` does. It needs measured rotor speeds; what pushes the vehicle
    need not be known. ``lag`` is that of ``s.mix``.
    """
    omega = 2 * np.pi * filter_hz

    def low_pass(s: Any, name: str, value: Any) -> tuple[Any, Any]:
        """A signal through the low-pass, and its derivative."""
        level, slope = s.memory(name), s.memory(f"{name}_slope")
        # It begins where the signal is.
        before = np.where(s.t < 0.5 * s.dt, value, level.value)
        slope.next = slope.value + s.dt * (omega**2 * (value - before) - 2 * 0.55 * omega * slope.value)
        level.next = before + s.dt * slope.next
        return level.next, slope.next

    def law(s: Any) -> None:
        lift, turning = _followed(s, (position, damping), (attitude, attitude_damping))
        c0, c1, c2 = (float(c) for c in s.vehicle.thrust_curve)
        thrusts = [c0 + c1 * s.rotor_vel[k] + c2 * s.rotor_vel[k] ** 2 for k in range(s.vehicle.rotors)]
        torque = []
        for axis, name in enumerate("xyz"):
            _, gained = low_pass(s, f"rate_{name}", s.ang_vel[axis])
            given, _ = low_pass(s, f"torque_{name}", sum(float(s.vehicle.wrench[1 + axis, k]) * t for k, t in enumerate(thrusts)))
            torque.append(given + float(s.vehicle.inertia[axis, axis]) * (turning[axis] - gained))
        s.mix(lift, torque, lag)

    return Controller(law, "indi", hz)


def _slope(s: Any, name: str, of: Any, share: float) -> Any:
    """The derivative of a number through a low-pass of first order, whose ``share`` is new in each turn."""
    last, slope = s.memory(f"last_{name}"), s.memory(f"slope_{name}")
    last.next = of
    # The first difference would be that to nothing measured yet.
    slope.next = slope.value + share * (np.where(s.t < 0.5 * s.dt, 0.0, (of - last.value) / s.dt) - slope.value)
    return slope.next


def _turn_left(s: Any) -> Any:
    """The quaternion, body axes, from the attitude to that of a command of `attitude`: roll, pitch and yaw about the body's axes, yaw first."""
    half = [s.command[k] * 0.5 for k in range(3)]
    (cr, cp, cy), (sr, sp, sy) = [np.cos(h) for h in half], [np.sin(h) for h in half]
    wanted = np.array([sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy, cr * cp * cy + sr * sp * sy], dtype=object)
    return _product(np.array([-s.quat[0], -s.quat[1], -s.quat[2], s.quat[3]], dtype=object), wanted)


def _turns(s: Any) -> Any:
    """How much each rotor turns the vehicle, as mixers of firmware have it: roll, pitch and yaw over the greatest of all rotors. (rotor, 3)"""
    wrench = s.vehicle.wrench[1:].T
    return wrench / np.abs(wrench).max(axis=0)


def _mixed(s: Any, throttle: Any, turn: Any) -> list[Any]:
    """Outputs of the motors, 0 to 1. Turning goes before lifting: the throttle gives way where a motor would leave its range."""
    shares = _turns(s)
    each = [sum(float(shares[k, axis]) * turn[axis] for axis in range(3)) for k in range(s.vehicle.rotors)]
    lowest, highest = _ends(each)
    shrink = 1 / np.maximum(1, highest - lowest)
    lift = np.clip(throttle, -lowest * shrink, 1 - highest * shrink)
    return [np.clip(lift + value * shrink, 0, 1) for value in each]


def _by_thrust(s: Any, outputs: list[Any]) -> None:
    """Motors whose thrust goes with their output."""
    for k, output in enumerate(outputs):
        s.rotor_command[k] = s.vehicle.speed(np.maximum(output * s.vehicle.thrust_max, s.vehicle.thrust_min))


def _tilt_and_heading(full: Any) -> tuple[Any, Any]:
    """The turn that is left in two: the shortest one of body z to where it shall point, as a quaternion, and then half the angle about z, −π/2 to π/2."""
    up = _matrix(full)[:, 2]
    root = np.sqrt(np.maximum(2 * (1 + up[2]), 1e-9))
    tilt = np.array([-up[1] / root, up[0] / root, 0.0, root * 0.5], dtype=object)
    left = _product(np.array([-tilt[0], -tilt[1], 0.0, tilt[3]], dtype=object), full)
    side = np.where(left[3] < 0, -1.0, 1.0)
    return tilt, np.arctan2(left[2] * side, left[3] * side)


def px4(
    attitude: Sequence[float] = (6.5, 6.5, 2.8),
    rate: Sequence[Sequence[float]] = ((0.15, 0.2, 0.003), (0.15, 0.2, 0.003), (0.2, 0.1, 0.0)),
    yaw_weight: float = 0.4,
    rate_max: Sequence[float] = (3.84, 3.84, 3.49),
    cutoff_hz: float = 30.0,
    integral_max: float = 0.3,
    hz: float | None = None,
) -> Controller:
    """Attitude and rate control as PX4 has it, for ``control="attitude"``.

    The attitude error is a quaternion whose tilt goes before its yaw, which counts ``yaw_weight`` (D. Brescianini, M. Hehn, R. D'Andrea, "Nonlinear quadrocopter attitude control", ETH Zürich 2013; PX4, mc_att_control), times
    gains (MC_ROLL_P …), within ``rate_max`` (rad/s; MC_ROLLRATE_MAX is 220 °/s), a rate for a PID (lib/rate_control) with its derivative through ``cutoff_hz`` (IMU_DGYRO_CUTOFF) and its integral within ``integral_max``
    (MC_RR_INT_LIM), which sums the less the greater the error is, nothing from 400 °/s on, and acts one turn later. Gains are PX4's defaults: outputs are shares of the motors' range, which lift in proportion.
    """

    def law(s: Any) -> None:
        full = _turn_left(s)
        tilt, half_yaw = _tilt_and_heading(full)
        yaw = half_yaw * yaw_weight
        error = 2 * _product(tilt, np.array([0.0, 0.0, np.sin(yaw), np.cos(yaw)], dtype=object))[:3]
        # Upside down no way of body z is the shortest: all of the turn counts as it is.
        twice, opposite = np.where(full[3] < 0, -2.0, 2.0), tilt[3] < 0.0045
        error = [np.where(opposite, twice * full[axis], error[axis]) for axis in range(3)]
        share = s.dt / (s.dt + 1 / (2 * np.pi * cutoff_hz))
        turn = []
        for axis, name in enumerate("xyz"):
            p, i, d = rate[axis]
            # The yaw gain is divided by the weight, which acts on the error already.
            gain = attitude[axis] / (yaw_weight if axis == 2 else 1.0)
            left = np.clip(gain * error[axis], -rate_max[axis], rate_max[axis]) - s.ang_vel[axis]
            out = p * left
            if i:
                total = s.memory(f"integral_{name}")
                fade = np.maximum(1 - (left / np.radians(400)) ** 2, 0)
                total.next = np.clip(total.value + fade * i * left * s.dt, -integral_max, integral_max)
                out = out + total.value
            turn.append(out - d * _slope(s, name, s.ang_vel[axis], share) if d else out)
        _by_thrust(s, _mixed(s, s.command[3] / (s.vehicle.rotors * s.vehicle.thrust_max), turn))

    return Controller(law, "px4", hz)


def ardupilot(
    attitude: Sequence[float] = (4.5, 4.5, 4.5),
    rate: Sequence[Sequence[float]] = ((0.135, 0.135, 0.0036), (0.135, 0.135, 0.0036), (0.18, 0.018, 0.0)),
    accel_max: Sequence[float] = (19.199, 19.199, 4.712),
    cutoff_hz: float = 20.0,
    yaw_cutoff_hz: float = 2.5,
    integral_max: float = 0.5,
    hz: float | None = None,
) -> Controller:
    """Attitude and rate control as ArduCopter has it, for ``control="attitude"``.

    The attitude error is the shortest turn of the thrust, and then that of the heading, within 45° or what would saturate it. Rates go with it (ATC_ANG_RLL_P …) near to zero, and with its root far from it, where the acceleration would
    exceed half of ``accel_max`` (rad/s²; ATC_ACCEL_R_MAX is 110000 centidegrees/s²), clamped to 40…720 °/s² (yaw: 10…120) (ArduPilot, AC_AttitudeControl, sqrt_controller). A PID follows them (AC_PID), whose target passes a
    low-pass (ATC_RAT_RLL_FLTT, ``cutoff_hz``), and so does the derivative of its error (FLTD), about yaw the error itself too (ATC_RAT_YAW_FLTE, ``yaw_cutoff_hz``); its integral stays within ``integral_max`` (IMAX). Gains are ArduPilot's
    defaults. What shapes commands before (ATC_INPUT_TC) is not there.
    """

    def law(s: Any) -> None:
        tilt, half_yaw = _tilt_and_heading(_turn_left(s))
        sine = np.sqrt(tilt[:2] @ tilt[:2] + 1e-16)
        lean = tilt[:2] * (2 * np.arctan2(sine, tilt[3]) / sine)
        limits = [np.clip(accel_max[axis] / 2, *np.radians((10, 120) if axis == 2 else (40, 720))) for axis in range(3)]
        heading_max = min(_stopping(1 / rate[2][0], attitude[2], limits[2]), np.pi / 4) if rate[2][0] else np.pi
        error = [*lean, np.clip(2 * half_yaw, -heading_max, heading_max)]
        share, begun = s.dt / (s.dt + 1 / (2 * np.pi * cutoff_hz)), s.t > 0.5 * s.dt
        turn = []
        for axis, name in enumerate("xyz"):
            p, i, d = rate[axis]
            far, size = limits[axis] / attitude[axis] ** 2, np.abs(error[axis])
            root = np.sqrt(np.maximum(2 * limits[axis] * (size - 0.5 * far), 1e-12))
            asked = np.where(size > far, np.sign(error[axis]) * root, attitude[axis] * error[axis])
            asked = np.clip(asked, -size / s.dt, size / s.dt)
            # All filters begin with the first value that they are given.
            target = s.memory(f"target_{name}")
            target.next = np.where(begun, target.value + share * (asked - target.value), asked)
            left = target.next - s.ang_vel[axis]
            if axis == 2 and yaw_cutoff_hz:
                smooth = s.memory("error_z")
                smooth.next = np.where(begun, smooth.value + s.dt / (s.dt + 1 / (2 * np.pi * yaw_cutoff_hz)) * (left - smooth.value), left)
                left = smooth.next
            out = p * left
            if i:
                total = s.memory(f"integral_{name}")
                total.next = np.clip(total.value + i * left * s.dt, -integral_max, integral_max)
                out = out + total.next
            turn.append(out + d * _slope(s, name, left, share) if d else out)
        _by_thrust(s, _mixed(s, s.command[3] / (s.vehicle.rotors * s.vehicle.thrust_max), turn))

    return Controller(law, "ardupilot", hz)


def _stopping(speed: float, gain: float, accel: float) -> float:
    """Error at which the controller that follows its root asks for a speed."""
    return speed / gain if speed < accel / gain else 0.5 * accel / gain**2 + speed**2 / (2 * accel)


def betaflight(
    pid: Sequence[Sequence[float]] = ((45, 80, 30), (47, 84, 34), (45, 80, 0)),
    cutoff_hz: float = 75.0,
    idle: float = 0.055,
    hz: float | None = None,
) -> Controller:
    """Rate control as Betaflight has it, for ``control="body_rate"``.

    P, I and D in the configurator's numbers, scaled as the firmware scales them for rates in °/s (Betaflight 4.5, pid.h: PTERM_SCALE 0.032029, ITERM_SCALE 0.244381, DTERM_SCALE 0.000529), the derivative of the gyroscope through a low-pass of
    first order, roll and pitch within 500 of 1000, yaw and the integrals within 400; motors with air mode, whose speed goes with their output from ``idle`` of the greatest (dshot_idle_value) on. Thrust is commanded in N: the throttle is the output at which hovering rotors lift it.
    """

    def law(s: Any) -> None:
        degrees = 180 / np.pi
        share = s.dt / (s.dt + 1 / (2 * np.pi * cutoff_hz))
        turn = []
        for axis, name in enumerate("xyz"):
            p, i, d = pid[axis]
            left = s.command[axis] - s.ang_vel[axis]
            out = 0.032029 * p * degrees * left
            if i:
                total = s.memory(f"integral_{name}")
                total.next = np.clip(total.value + 0.244381 * i * degrees * left * s.dt, -400, 400)
                out = out + total.next
            if d:
                out = out - 0.000529 * d * degrees * _slope(s, name, s.ang_vel[axis], share)
            limit = 400 if axis == 2 else 500
            turn.append(np.clip(out, -limit, limit) / 1000)
        top = float(s.vehicle.speed(s.vehicle.thrust_max))
        throttle = (s.vehicle.speed(np.maximum(s.command[3] / s.vehicle.rotors, s.vehicle.thrust_min)) / top - idle) / (1 - idle)
        for k, output in enumerate(_mixed(s, throttle, turn)):
            s.rotor_command[k] = top * (idle + (1 - idle) * output)

    return Controller(law, "betaflight", hz)
