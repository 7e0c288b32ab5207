"""Policies that are trained by the gradients of their flights: ``import propwash.learn``.

A small network commands many worlds at once, in the lanes in which they fly, and the exact gradient of what the flights cost goes back through motion,
effects, on-board controllers and network (backpropagation through time). It takes a tenth of a second, and nothing but Propwash.

>>> trained = propwash.learn.bptt(propwash.learn.Track(period=10.0))
>>> print(trained.fly())
>>> trained.policy.save("track.npz")
"""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass
from typing import Any, Literal, Sequence, Union

import numpy as np
from numpy.typing import NDArray

from . import __version__, _native
from ._native import Vehicle
from ._repr import shorten_all as _shorten_all
from .policies import ActionSpec, Branch, Channel, Input, Layer, Policy
from .sense import _whole

__all__ = ["Cross", "Crossed", "Flights", "Recover", "Track", "Trained", "bptt", "cross"]

Action = Literal["attitude", "rotor_vel"]


@dataclass(frozen=True)
class Track:
    """Follow an upright figure of eight, 2 m wide and 1 m high, around (0, 0, 1): that of ``Propwash/Trajectory-v0``, whose observations the policy sees."""

    period: float = 10.0
    """Time for all of it, s."""


@dataclass(frozen=True)
class Recover:
    """Come to rest after a throw, level, near the origin."""

    speed: float = 4.0
    """Throws are up to this fast in any direction, m/s."""
    spin: float = 8.0
    """They spin by up to this about each axis, rad/s."""
    lean: float = float(np.pi / 2)
    """They lean by up to this about any axis, rad; π is any attitude."""
    time: float = 2.5
    """Time until the drone should be at rest, s."""


Goal = Union[Track, Recover]


@dataclass(frozen=True)
class Cross:
    """Cross a forest to a goal, seeing by a depth camera: what a training by ``cross`` pays for."""

    speed: float = 1.8
    """Speed that is wanted, m/s."""
    keep: float = 0.6
    """Nearer to things than this costs more and more, m: from the middle of the drone."""
    ceiling: float = 2.0
    """Higher than this costs more and more, m."""
    arrive: float = 0.6
    """The goal is reached within this distance, m."""
    touch: float = 0.1
    """A drone whose middle is nearer to things than this begins anew, m."""
    time: float = 12.0
    """Longest time of an episode in training, s."""


@dataclass(frozen=True)
class Flights:
    """What flights from starts that no training has seen showed."""

    flights: int
    error_rms: float
    """How far off they were, m, root mean square over flights and time: from the path (``Track``), from the origin (``Recover``). NaN where all were lost."""
    error_most: float
    """The most of it, m."""
    reached: int
    """Flights that ended as they should: within 0.1 m of the path (``Track``); level within 15°, slower than 0.3 m/s and 1 rad/s (``Recover``)."""
    lost: int
    """Flights that came more than 1 m (``Track``) or 10 m (``Recover``) off, or whose numbers stopped being numbers."""
    path: NDArray[np.float64]
    """Positions of the first flight after each command, m. (n, 3)"""


class Trained:
    """A policy and how it came to be."""

    def __init__(self, native: _native.Learnt, goal: Goal, vehicle: Vehicle) -> None:
        self._native = native
        self._vehicle = vehicle
        self.goal = goal
        self.seconds: float = native.seconds
        """Time that the training took, s."""
        self.lost: int = native.lost
        """Worlds that began anew since they went astray."""
        self.commands, self.cost = native.curve()
        """Commands flown so far at each update, and the mean cost of a command in it."""
        self._policy: Policy | None = None

    def __repr__(self) -> str:
        return f"<propwash.learn.Trained for {self.goal}, {int(self.commands[-1])} commands in {self.seconds:.2f} s>"

    def fly(self, vehicle: str | os.PathLike[str] | Vehicle | None = None, *, flights: int = 100, settle: float = 2.0, seed: int = 1_000_000) -> Flights:
        """Flies the policy from other starts than those of the training.

        Args:
            vehicle: Another vehicle, such as one with further effects; None is that of the training. Commands mean what they meant there.
            flights: How many.
            settle: Time at the beginning of each that errors are not counted for, s.
            seed: Seed of the starts.
        """
        other = None if vehicle is None else vehicle if isinstance(vehicle, Vehicle) else Vehicle(vehicle)
        rms, most, reached, lost, path = self._native.fly(other, _whole("flights", flights, 1, 10**6), float(settle), _whole("seed", seed, 0, 2**62))
        return Flights(flights, rms, most, reached, lost, path)

    @property
    def policy(self) -> Policy:
        """The policy, to be saved, exported, evaluated and flown as any other."""
        if self._policy is None:
            self._policy = self._make()
        return self._policy

    def _make(self) -> Policy:
        parts = self._native.parts()
        first, second, third = (float(scale) for scale in parts["scales"])
        state = [Input("quat"), Input("vel").scale(second), Input("ang_vel").scale(third)]
        trained: dict[str, Any] = {"propwash": __version__, "note": f"propwash.learn.bptt of {self.goal}"}
        if isinstance(self.goal, Track):
            inputs = [Input("local_samples").scale(first), state[1], state[0], state[2]]
            channels = [Channel("ang_vel", (3,)), Channel("local_samples", (30,)), Channel("quat", (4,)), Channel("vel", (3,))]
            trained.update(self._where(parts))
        else:
            inputs = [Input("pos").scale(first), *state]
            channels = [Channel("ang_vel", (3,)), Channel("pos", (3,)), Channel("quat", (4,)), Channel("vel", (3,))]
        return Policy(tuple(channels), (Branch(tuple(inputs)),), _layers(parts), _action(parts), trained)

    def _where(self, parts: dict[str, Any]) -> dict[str, Any]:
        """The environment that asks for the same; nothing without gymnasium."""
        try:
            import gymnasium
        except ModuleNotFoundError:
            return {}
        from . import envs as _envs
        from .policies._convert import Seen

        assert isinstance(self.goal, Track) and _envs
        env = gymnasium.make_vec(
            "Propwash/Trajectory-v0",
            num_envs=1,
            drone=self._vehicle,
            action=parts["kind"],
            normalize_actions=False,
            freq=parts["step_hz"],
            task_options={"period_s": self.goal.period},
        )
        return Seen(env).trained(f"propwash.learn.bptt of {self.goal}")


def _layers(parts: dict[str, Any]) -> tuple[Layer, ...]:
    """Layers of a network, a tanh behind each but the last, whose tanh is that of the limit."""
    layers: list[Layer] = []
    for weight, bias in parts["layers"]:
        layers += [Layer("linear", np.asarray(weight, np.float32), np.asarray(bias, np.float32)), Layer("tanh")]
    return tuple(layers[:-1])


def _action(parts: dict[str, Any]) -> ActionSpec:
    middle, reach = np.array(parts["middle"]), np.array(parts["reach"])
    low, high = (middle - reach).astype(np.float32), (middle + reach).astype(np.float32)
    return ActionSpec(parts["kind"], low, high, limit="tanh", normalized=False, step_hz=parts["step_hz"])


class Crossed:
    """A policy that sees, and how it came to be."""

    def __init__(self, native: _native.Crossed, goal: Cross, policy: Policy) -> None:
        self.goal = goal
        self.policy = policy
        """The policy, to be saved, exported, evaluated and flown as any other: it takes observations of the environment as they are."""
        self.prepared: float = native.seconds[0]
        """Time to compile the scenes and to bake their distance fields, s."""
        self.seconds: float = native.seconds[1]
        """Time that all of it took, s."""
        self.lost: int = native.lost
        """Worlds that began anew since they touched something."""
        self.commands, self.cost = native.curve()
        """Commands flown so far at each update, and the mean cost of a command in it."""

    def __repr__(self) -> str:
        return f"<propwash.learn.Crossed, {int(self.commands[-1])} commands in {self.seconds:.1f} s>"


def cross(
    env: Any,
    goal: Cross = Cross(),
    *,
    pool: tuple[int, int] = (1, 1),
    worlds: int = 128,
    horizon: int = 30,
    commands: int = 2_000_000,
    hidden: Sequence[int] = (64, 64),
    rate: float = 0.003,
    longest: float = 1.0,
    seed: int = 0,
    threads: int | None = None,
) -> Crossed:
    """Trains a policy that crosses forests by what a depth camera shows, by backpropagation through time.

    What it costs to come near things goes through their exact distance and its slope (``DistanceField``), not through pixels.

    Args:
        env: ``Propwash/ForestDepth-v0`` with ``action="attitude"`` and ``normalize_actions=False``, without wrappers: it says what flies, in which scenes, what the camera is, how
            often the policy acts (``freq``) and how far actions reach. Nothing may move in the scenes. The training flies on its own in them, without noise and delays.
        goal: What is paid for.
        pool: Height and width of blocks of pixels of which the policy sees the nearest.
        worlds: Worlds that fly at once; multiples of 16 fill the lanes.
        horizon: Commands of a flight before its gradient is taken.
        commands: Commands in all, over all worlds.
        hidden: Widths of the network's layers.
        rate: Size of Adam's first steps; it falls to nothing along half a cosine.
        longest: Gradients that are longer are shortened to this.
        seed: Seed of weights, scenes that worlds are in, starts and goals.
        threads: Number of threads; None: all. The policy is the same for any.

    Raises:
        ValueError: for another task or action, several drones, scenes in which something moves, and options that make no sense.
        TypeError: for what is no environment of ``propwash.envs``.
    """
    from .policies._convert import Seen

    seen = Seen(env)
    if seen.base is not getattr(env, "unwrapped", env):
        raise TypeError(f"env: expected an environment without wrappers, got {type(env).__name__}")
    config = json.loads(json.dumps(seen.base.config))
    config["seed"] = _whole("seed", seed, 0, 2**62)
    if config["action"]["normalized"]:
        raise ValueError("env: expected normalize_actions=False, so that commands have their units; got True")
    numbers = asdict(goal)
    for name, value in numbers.items():
        if not (np.isfinite(value) and value > 0.0):
            raise ValueError(f"goal.{name}: expected a finite number above 0, got {value}")
    options = {
        "worlds": _whole("worlds", worlds, 1, 10**6),
        "horizon": _whole("horizon", horizon, 1, 10**6),
        "commands": _whole("commands", commands, 1, 10**12),
        "hidden": [_whole("hidden", width, 1, 10**4) for width in hidden],
        "rate": float(rate),
        "longest": float(longest),
    }
    block = (_whole("pool", pool[0], 1, 10**4), _whole("pool", pool[1], 1, 10**4))
    several = None if threads is None else _whole("threads", threads, 1, 4096)
    native = _native.learn_cross(json.dumps(config), numbers, block, options, several)
    parts = native.parts()
    away, speed, height, zero, least, near, factor = parts["scales"]
    inputs = (
        Input("goal").direction(least),
        Input("goal").length().scale(away),
        Input("vel_heading").scale(speed),
        Input("pos").take(2).scale(height, zero),
        Input("quat"),
        Input("depth").nearness(near, config["camera"]["range_m"][1]).pool(block[0], block[1], "max").scale(factor),
    )
    channels = tuple(Channel(name, seen.shapes[name], 1) for name in sorted({given.channel for given in inputs}))
    policy = Policy(channels, (Branch(inputs),), _layers(parts), _action(parts), seen.trained(f"propwash.learn.cross of {goal}"))
    return Crossed(native, goal, policy)


def bptt(
    goal: Goal,
    vehicle: str | os.PathLike[str] | Vehicle = "cf21B_500",
    *,
    dynamics: str = "first_principles",
    action: Action = "attitude",
    freq: int = 500,
    substeps: int | None = None,
    worlds: int = 16,
    horizon: int | None = None,
    commands: int | None = None,
    hidden: Sequence[int] = (64, 64),
    rate: float = 0.01,
    longest: float = 0.2,
    seed: int = 0,
) -> Trained:
    """Trains a policy by backpropagation through time.

    Args:
        goal: ``Track`` or ``Recover``.
        vehicle: What flies, with all its effects.
        dynamics: Its model.
        action: What the policy commands: ``attitude`` (roll and pitch up to ± 0.6 rad, yaw up to ± 0.2 rad, thrust 30 to 170 % of hover), or ``rotor_vel`` (± 30 % of the
            speeds of hover).
        freq: Steps of the simulation a second.
        substeps: Steps under each command; None: 10 for ``Track`` by attitudes, else 5.
        worlds: Worlds that fly at once; multiples of 16 fill the lanes.
        horizon: Commands of a flight before its gradient is taken; None: 40 for ``Track``, 25 for ``Recover``.
        commands: Commands in all, over all worlds; None: 100,000 for ``Track`` by attitudes, 600,000 by rotor speeds, 60,000 for ``Recover``.
        hidden: Widths of the network's layers.
        rate: Size of Adam's first steps; it falls to nothing along half a cosine.
        longest: Gradients that are longer are shortened to this.
        seed: Seed of weights and starts.

    Raises:
        ValueError: for options that make no sense, vehicles without these dynamics, and models that have no rotors to command.
    """
    if not isinstance(goal, (Track, Recover)):
        raise TypeError(f"goal: expected propwash.learn.Track or Recover, got {type(goal).__name__}")
    of = vehicle if isinstance(vehicle, Vehicle) else Vehicle(vehicle)
    slow = isinstance(goal, Track) and action == "attitude"
    track = isinstance(goal, Track)
    options = {
        "freq": _whole("freq", freq, 1, 1_000_000),
        "substeps": _whole("substeps", (10 if slow else 5) if substeps is None else substeps, 1, 10**6),
        "worlds": _whole("worlds", worlds, 1, 10**6),
        "horizon": _whole("horizon", (40 if track else 25) if horizon is None else horizon, 1, 10**6),
        "commands": _whole("commands", ((100_000 if slow else 600_000) if track else 60_000) if commands is None else commands, 1, 10**12),
        "hidden": [_whole("hidden", width, 1, 10**4) for width in hidden],
        "rate": float(rate),
        "longest": float(longest),
        "seed": _whole("seed", seed, 0, 2**62),
    }
    name = type(goal).__name__.lower()
    return Trained(_native.learn_bptt(name, asdict(goal), of, dynamics, action, options), goal, of)


_shorten_all(globals())
