"""Policies that are trained in the lanes in which they fly: ``import propwash.learn``.

A small network commands many worlds at once. ``bptt`` takes the exact gradient of what the flights cost back through motion, effects, on-board controllers and
network (backpropagation through time): a tenth of a second, and nothing but Propwash. ``ppo`` sees costs alone (proximal policy optimisation): some seconds.

>>> trained = propwash.learn.bptt(propwash.learn.Track(period=10.0))
>>> print(trained.fly())
>>> trained.policy.save("track.npz")
"""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass
from typing import Any, Iterator, Literal, Mapping, Sequence, Union

import numpy as np
from numpy.typing import NDArray

from . import __version__, _native
from ._native import Vehicle
from ._formula import Formula, Names, Sight, naming, said
from ._repr import shorten_all as _shorten_all
from .effects import n_rotors
from .policies import ActionSpec, Branch, Channel, Input, Layer, Policy
from .sense import _whole

__all__ = [
    "Critic",
    "Cross",
    "Crossed",
    "Flights",
    "Gate",
    "Gates",
    "Goal",
    "Land",
    "Reach",
    "Recover",
    "Swap",
    "Track",
    "Trained",
    "bptt",
    "cross",
    "ppo",
    "swap",
]

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


@dataclass(frozen=True)
class Reach:
    """Fly to a place that is drawn for each episode, and hover there. The policy sees the way there (``difference_to_goal``)."""

    far: float = 1.5
    """Starts and places lie within ± this of (0, 0, 1.5) along x and y, and within ± 1 m along z, m."""
    speed: float = 1.0
    """Starts are up to this fast along each axis, m/s."""
    time: float = 4.0
    """Time of an episode, s."""


@dataclass(frozen=True)
class Land:
    """Touch down softly at (0, 0, ``height``): slower than 0.3 m/s downwards and 0.2 m/s sideways, leaning less than 10°, within 0.2 m.

    Nothing stands there: a flight ends where the drone's origin comes down to the height, and it is the flight before that counts."""

    height: float = 0.0
    """Height at which the drone's origin is when it stands there, m."""
    beside: float = 1.0
    """Starts lie within ± this of the place along x and y, m."""
    above: float = 1.0
    """Starts are half of this to one and a half of it above the place, m."""
    time: float = 6.0
    """Time in which it must touch down, s."""


@dataclass(frozen=True)
class Gate:
    """A round opening that is to be crossed along ``normal``."""

    centre: tuple[float, float, float]
    """Its middle, m."""
    normal: tuple[float, float, float]
    """The way through, of length 1."""
    radius: float = 0.3
    """Radius of the opening, m."""


@dataclass(frozen=True)
class Gates:
    """Race through a ring of gates, in their order, without touching a rim or missing one.

    Each episode moves and turns all gates a little and begins before one that is drawn. The policy sees the next two, as ways to their middles and normals.
    """

    gates: tuple[Gate, ...] = ()
    """The gates; after the last comes the first. Without any: five on a ring of 2 m radius, at heights of 0.9 to 1.6 m."""
    rim: float = 0.1
    """Width of the rims, m; they have no thickness."""
    body: float = 0.07
    """Radius of the drone: it must stay so far inside an opening, and outside a rim, m."""
    moved: float = 0.2
    """Gates are moved by up to this along each axis, m."""
    turned: float = 0.2
    """Gates are turned by up to this about the vertical, rad."""
    speed: float = 2.5
    """Speed that costs least, m/s."""
    laps: int = 1
    """How often each gate is to be passed."""
    time: float = 10.0
    """Time for all of it, s."""


Range = Union[float, tuple[float, float]]


#: What the functions of a ``Goal`` see of a drone: names of numbers.
_SEES = {
    "pos": ("x", "y", "z"),
    "quat": ("qx", "qy", "qz", "qw"),
    "vel": ("vx", "vy", "vz"),
    "ang_vel": ("wx", "wy", "wz"),
    "t": ("t",),
}
#: What they see in an environment beside.
_SHOWN = {
    "previous_pos": ("px", "py", "pz"),
    "clearance": ("clearance",),
    "crashed": ("crashed",),
    "action_change": ("action_change",),
    "step_time": ("step",),
}
_ALONE = dict.fromkeys(_SHOWN, "environments alone show it; bptt and ppo fly in free air, where nothing is near")


class Goal:
    """A goal of one's own: what is drawn at an episode's start stands in the class, and its functions say what the policy sees and what a step costs.

    ``bptt`` and ``ppo`` learn it, and ``propwash.envs`` makes an environment of it: ``DroneVectorEnv(task=Circle)``.

    The functions run once, over names of numbers (``propwash.effect`` says what they may do), and never in training or flight: what they say is computed in the lanes, with its slopes. They see
    ``s.pos`` (m), ``s.quat`` (x y z w), ``s.vel`` (m/s, world), ``s.ang_vel`` (rad/s, body), ``s.t`` (s), what the episode remembers by its name, and, in ``cost`` and ``reward``, ``s.action`` and
    ``s.before``: the action of the step and the one before it, numbers of -1 to 1 of the limits of whoever flies it. In environments ``remember`` sees actions, and all see ``s.crashed`` (1 where the drone touched something in the
    step, else 0), ``s.clearance`` (m to the nearest thing), ``s.previous_pos`` (m, a step ago), ``s.action_change`` (0 to 1) and ``s.step_time`` (s).

    A range is a number, or a pair between which it is drawn.

    >>> class Circle(propwash.learn.Goal):
    ...     pos, vel, begin = [(-1, 1), (-1, 1), (1, 2)], [(-0.5, 0.5)] * 3, (0, 6)
    ...     def way(self, s): return np.array([np.cos(s.t), np.sin(s.t), 1.5]) - s.pos
    ...     def observe(self, s): return [self.way(s), 0.5 * s.vel, s.quat, 0.3 * s.ang_vel, np.sin(s.t), np.cos(s.t)]
    ...     def cost(self, s): return self.way(s) @ self.way(s) + 0.02 * (s.action - s.before) @ (s.action - s.before)
    ...     def off(self, s): return np.sqrt(self.way(s) @ self.way(s))
    >>> trained = propwash.learn.bptt(Circle())
    """

    pos: Sequence[Range] = (0.0, 0.0, 1.0)
    """Where episodes begin, m."""
    vel: Sequence[Range] = (0.0, 0.0, 0.0)
    """Velocity there, m/s, world."""
    ang_vel: Sequence[Range] = (0.0, 0.0, 0.0)
    """Angular velocity there, rad/s, body."""
    turn: Sequence[Range] = (0.0, 0.0, 0.0)
    """Attitude there, as a rotation vector, rad."""
    begin: Range = 0.0
    """Time there, s."""
    memory: Mapping[str, Range | Sequence[Range]] = {}
    """What an episode remembers, by name: a number or a list of them, drawn at its start. Three numbers named ``goal`` can be given at resets of an environment."""
    time: float = 4.0
    """Length of an episode, s."""
    far: float = 10.0
    """A flight farther off than this is lost, m."""
    lost_cost: float = 100.0
    """What being lost costs where a learner sees costs alone (``ppo``, environments)."""
    crash_ends: bool = True
    """Whether an episode ends in an environment where the drone touches something; the flight is lost then."""

    def observe(self, s: Any) -> Sequence[Any] | Mapping[str, Any]:
        """What the policy sees: numbers and arrays of about size 1; the channel ``observation``, or several by name."""
        raise NotImplementedError("a goal says what the policy sees: def observe(self, s): return [s.pos, …]")

    def cost(self, s: Any) -> Any:
        """What a step costs, seen at its end; that of ``reward`` with the other sign, unless it says otherwise."""
        if type(self).reward is Goal.reward:
            raise NotImplementedError("a goal says what a step costs: def cost(self, s): return … (or what it is worth: def reward)")
        return -self.reward(s)

    def reward(self, s: Any) -> Any:
        """What a step is worth in an environment: minus ``cost``, and minus ``lost_cost`` where the flight is lost by it. A class that says otherwise says all of it."""
        return -self.cost(s)

    def off(self, s: Any) -> Any:
        """How far off it is, m."""
        raise NotImplementedError("a goal says how far off it is, in m: def off(self, s): return …")

    def reached(self, s: Any) -> Any:
        """Whether a flight that ends here has done what it should: where it is less than 0.1 m off, unless it says otherwise."""
        return self.off(s) < 0.1

    def done(self, s: Any) -> Any:
        """Whether nothing is left to do: the episode ends, and nothing more is paid. None: never."""
        return None

    def lost(self, s: Any) -> Any:
        """Whether it failed. None: only by being farther off than ``far``, or by numbers that are none."""
        return None

    def remember(self, s: Any) -> Mapping[str, Any]:
        """What is remembered after a command, by name: what does not stand there stays."""
        return {}

    def _parts(self) -> dict[str, list[tuple[str, float, float]]]:
        """Names and bounds of the numbers that are remembered, by the name of each."""
        out: dict[str, list[tuple[str, float, float]]] = {}
        for name, ranges in self.memory.items():
            taken = name in _SEES or name in _SHOWN or name in ("action", "before")
            if not isinstance(name, str) or not name.isidentifier() or taken:
                raise ValueError(f"memory: expected names of letters, digits and underscores that nothing else has, got {name!r}")
            several = isinstance(ranges, (list, np.ndarray)) or (isinstance(ranges, tuple) and any(isinstance(r, (tuple, list)) for r in ranges))
            given = list(ranges) if several else [ranges]  # type: ignore[arg-type]
            names = [f"{name}_{k + 1}" if several else f"{name}_" for k in range(len(given))]
            out[name] = [(own, *_range(f"memory {name}", one)) for own, one in zip(names, given)]
        return out

    def _sight(self, actions: int, shown: bool) -> Sight:
        """What the functions see: with actions of so many numbers, and with what environments show or without."""
        kept = {name: [own for own, *_ in group] for name, group in self._parts().items()}
        acted = {name: [f"{name}{k + 1}" for k in range(actions)] for name in (("action", "before") if actions else ())}
        return Sight("a goal", {**_SEES, **kept, **acted, **(_SHOWN if shown else {})}, {} if shown else _ALONE)

    def _said(self, name: str, value: Any) -> Formula:
        return said(f"{type(self).__name__}.{name}", value)

    def _maybe(self, name: str, sight: Sight) -> Formula | None:
        """What ``done`` or ``lost`` says, None: never."""
        value = getattr(self, name)(sight)
        return None if value is None else self._said(name, value)

    def _observed(self, sight: Sight) -> dict[str, list[str]]:
        """What the policy sees: the numbers of each channel, as texts."""
        seen = self.observe(sight)
        channels = {str(name): list(_flat([one])) for name, one in seen.items()} if isinstance(seen, Mapping) else {"observation": list(_flat(seen))}
        taken = set(channels) & {"pos", "quat", "vel", "ang_vel", "depth"}
        if taken:
            raise ValueError(f"observe: expected names of channels other than pos, quat, vel, ang_vel and depth, which environments observe by themselves, got {sorted(taken)[0]!r}")
        if not any(channels.values()) or not all(channels.values()):
            raise ValueError(f"observe: expected at least one number in each channel, got {({name: len(each) for name, each in channels.items()})}")
        return {name: [self._said("observe", one)._text for one in each] for name, each in channels.items()}

    def _channels(self) -> dict[str, int]:
        """Numbers of each channel."""
        with naming(Names(set())):
            return {name: len(each) for name, each in self._observed(self._sight(0, True)).items()}

    def _kept(self, sight: Sight) -> list[tuple[str, tuple[float, float], str]]:
        """What is remembered: names of its numbers, bounds, and what each is after a command; an empty text where it stays."""
        parts = self._parts()
        after = {}
        for name, value in self.remember(sight).items():
            if name not in parts:
                raise ValueError(f"remember: expected names of memory ({', '.join(parts)}), got {name!r}")
            values = list(_flat([value]))
            if len(values) != len(parts[name]):
                raise ValueError(f"remember: {name}: expected {len(parts[name])} numbers, got {len(values)}")
            after.update({own: self._said("remember", one)._text for (own, *_), one in zip(parts[name], values)})
        return [(own, (low, high), after.get(own, "")) for group in parts.values() for own, low, high in group]

    def _begins(self) -> dict[str, Any]:
        """Where episodes begin."""
        starts = {name: [_range(name, one) for one in _three(name, getattr(self, name))] for name in ("pos", "vel", "ang_vel", "turn")}
        return {**starts, "begin": _range("begin", self.begin)}

    def _names(self) -> Names:
        return Names({own for group in self._parts().values() for own, *_ in group})

    def _numbers(self, actions: int) -> dict[str, Any]:
        """As learners take it."""
        names, sight = self._names(), self._sight(0, False)
        with naming(names):
            observed = [text for each in self._observed(sight).values() for text in each]
            told = {"cost": self._said("cost", self.cost(self._sight(actions, False)))._text}
            told |= {name: self._said(name, getattr(self, name)(sight))._text for name in ("off", "reached")}
            told |= {name: "" if (value := self._maybe(name, sight)) is None else value._text for name in ("done", "lost")}
            memory = self._kept(sight)
        lets = names.used_by([*observed, *told.values(), *(text for *_, text in memory)])
        sizes = {name: float(getattr(self, name)) for name in ("time", "far", "lost_cost")}
        return {"lets": lets, "observe": observed, **told, "memory": memory, **self._begins(), **sizes}

    def _task(self, actions: int) -> dict[str, Any]:
        """As an environment takes it, whose actions have so many numbers."""
        names, sight, priced = self._names(), self._sight(0, True), self._sight(actions, True)
        with naming(names):
            observed = self._observed(sight)
            lost, done = self._maybe("lost", sight), self._maybe("done", sight)
            if type(self).off is not Goal.off:
                far = self._said("off", self.off(sight)) > float(self.far)
                lost = far if lost is None else lost | far
            reward: Any = self._said("reward", self.reward(priced))
            if type(self).reward is Goal.reward:
                over = sight.crashed if self.crash_ends else None
                if lost is not None:
                    over = lost if over is None else lost | over
                if over is not None:
                    reward = np.where(over, reward - float(self.lost_cost), reward)
            told = {"reward": reward._text, "lost": "" if lost is None else lost._text, "done": "" if done is None else done._text}
            memory = self._kept(priced)
        used = [*(text for each in observed.values() for text in each), *told.values(), *(text for *_, text in memory)]
        places = [own for own, *_ in memory]
        goal = places.index("goal_1") if "goal_3" in places and "goal_4" not in places else None
        return {
            "name": type(self).__name__,
            "lets": names.used_by(used),
            "observe": list(observed.items()),
            **told,
            "memory": memory,
            "goal": goal,
            "crash_ends": bool(self.crash_ends),
            **self._begins(),
        }

    def __repr__(self) -> str:
        return f"<{type(self).__name__}, a propwash.learn.Goal>"


def _flat(values: Any) -> Iterator[Any]:
    """The numbers of a list of numbers and arrays."""
    if isinstance(values, (list, tuple)) or isinstance(values, np.ndarray) and values.shape != ():
        for one in values:
            yield from _flat(one)
    else:
        yield values


def _range(name: str, given: Any) -> tuple[float, float]:
    pair = given if isinstance(given, (tuple, list, np.ndarray)) else (given, given)
    try:
        low, high = (float(v) for v in pair)
    except (TypeError, ValueError):
        raise TypeError(f"{name}: expected a number or a pair (low, high), got {given!r}") from None
    return low, high


def _three(name: str, given: Any) -> Sequence[Any]:
    if not isinstance(given, (tuple, list, np.ndarray)) or len(given) != 3:
        raise TypeError(f"{name}: expected three numbers or pairs (low, high), got {given!r}")
    return list(given)


AnyGoal = Union[Track, Recover, Reach, Land, Gates, Goal]


@dataclass(frozen=True)
class Critic:
    """How the value network of short-horizon actor-critic learns (Xu et al., 2022): it estimates what comes after a flight's end, and its slopes enter the gradient
    there."""

    discount: float = 0.97
    """What a cost counts one command later, below 1."""
    lam: float = 0.95
    """Share of longer returns in what the network is taught (λ of TD(λ))."""
    follow: float = 0.2
    """Share of the way that the network whose slopes are used goes towards the one that learns, after each flight."""
    rate: float = 0.003
    """Size of Adam's first steps."""
    epochs: int = 4
    """How often the samples of a flight are gone through."""
    parts: int = 4
    """In how many parts, each a step of Adam."""


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
    detour: float = 0.0
    """Flies the shortest way around things that keeps so far from them, m; 0: straight to the goal, off things as they come. Walls with doors need it. Only the
    training knows that way; the policy finds it by what it sees."""
    time: float = 12.0
    """Longest time of an episode in training, s."""


@dataclass(frozen=True)
class Swap:
    """Change places with other drones, all at once, touching none: what a training by ``swap`` pays for."""

    speed: float = 1.8
    """Speed that is wanted, m/s."""
    keep: float = 0.7
    """Nearer to another drone than this costs more and more, m, from middle to middle: now, and where both come if they fly on."""
    foresee: float = 1.5
    """How far ahead meetings are foreseen, s."""
    floor: float = 0.4
    """Lower than this costs more and more, m."""
    ceiling: float = 2.2
    """Higher than this costs more and more, m."""
    arrive: float = 0.3
    """A place is reached within this distance, m."""
    touch: float = 0.1
    """Radius of a drone, m: where two come nearer than twice of it, their world begins anew."""
    time: float = 10.0
    """Longest time of an episode in training, s."""


@dataclass(frozen=True)
class Flights:
    """What flights from starts that no training has seen showed."""

    flights: int
    error_rms: float
    """How far off they were, m, root mean square over flights and time: from the path (``Track``), the origin (``Recover``), the place (``Reach``; ``Land``: beside
    it), the middle of the next gate (``Gates``). NaN where all were lost."""
    error_most: float
    """The most of it, m."""
    reached: int
    """Flights that ended as they should: within 0.1 m of the path (``Track``); level within 15°, slower than 0.3 m/s and 1 rad/s (``Recover``); within 0.05 m and
    slower than 0.1 m/s (``Reach``); landed softly (``Land``); all gates passed (``Gates``)."""
    lost: int
    """Flights that came more than 1 m (``Track``), 10 m (``Recover``, ``Reach``), 5 m (``Land``) or 6 m (``Gates``) off, touched down too hard, touched or missed a
    gate, or whose numbers stopped being numbers."""
    path: NDArray[np.float64]
    """Positions of the first flight after each command, m. (n, 3)"""
    ends: NDArray[np.float64]
    """The last state of each flight: position (m), attitude (x y z w), velocity (m/s), angular velocity (rad/s, body). (flights, 13)"""


class Trained:
    """A policy and how it came to be."""

    def __init__(self, native: _native.Learnt, goal: AnyGoal, vehicle: Vehicle, by: str) -> None:
        self._native = native
        self._by = by
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
        found = self._native.fly(other, _whole("flights", flights, 1, 10**6), float(settle), _whole("seed", seed, 0, 2**62))
        return Flights(flights, *found)

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
        trained: dict[str, Any] = {"propwash": __version__, "note": self._note}
        if isinstance(self.goal, Goal):
            widths = self.goal._channels()
            channels = tuple(Channel(name, (widths[name],)) for name in sorted(widths))
            return Policy(channels, (Branch(tuple(Input(name) for name in widths)),), _layers(parts), _action(parts), trained)
        if isinstance(self.goal, Gates):
            factor = ([first] * 3 + [1.0] * 3) * 2
            inputs = [Input("gates").scale(factor), state[1], state[0], state[2]]
            listed = [Channel("ang_vel", (3,)), Channel("gates", (12,)), Channel("quat", (4,)), Channel("vel", (3,))]
        elif isinstance(self.goal, (Reach, Land)):
            inputs = [Input("difference_to_goal").scale(first), state[1], state[0], state[2]]
            listed = [Channel("ang_vel", (3,)), Channel("difference_to_goal", (3,)), Channel("quat", (4,)), Channel("vel", (3,))]
            if isinstance(self.goal, Reach):
                trained.update(self._where(parts, "Propwash/ReachPos-v0", {}))
        elif isinstance(self.goal, Track):
            inputs = [Input("local_samples").scale(first), state[1], state[0], state[2]]
            listed = [Channel("ang_vel", (3,)), Channel("local_samples", (30,)), Channel("quat", (4,)), Channel("vel", (3,))]
            trained.update(self._where(parts, "Propwash/Trajectory-v0", {"period_s": self.goal.period}))
        else:
            inputs = [Input("pos").scale(first), *state]
            listed = [Channel("ang_vel", (3,)), Channel("pos", (3,)), Channel("quat", (4,)), Channel("vel", (3,))]
        return Policy(tuple(listed), (Branch(tuple(inputs)),), _layers(parts), _action(parts), trained)

    @property
    def _note(self) -> str:
        return f"propwash.learn.{self._by} of {self.goal}"

    def _where(self, parts: dict[str, Any], name: str, options: dict[str, Any]) -> dict[str, Any]:
        """The environment that asks for the same; nothing without gymnasium."""
        try:
            import gymnasium
        except ModuleNotFoundError:
            return {}
        from . import envs as _envs
        from .policies._convert import Seen

        assert _envs
        env = gymnasium.make_vec(
            name,
            num_envs=1,
            drone=self._vehicle,
            action=parts["kind"],
            normalize_actions=False,
            freq=parts["step_hz"],
            task_options=options,
        )
        return Seen(env).trained(self._note)


def _given(goal: AnyGoal, vehicle: str | os.PathLike[str] | Vehicle, action: str) -> tuple[str, dict[str, Any], Vehicle]:
    """Name and numbers of a goal as the compiled module takes them, and the vehicle."""
    if isinstance(goal, Goal):
        own = vehicle if isinstance(vehicle, Vehicle) else Vehicle(vehicle)
        return "written", goal._numbers(4 if action == "attitude" else n_rotors(own)), own
    if not isinstance(goal, (Track, Recover, Reach, Land, Gates)):
        raise TypeError(f"goal: expected propwash.learn.Track, Recover, Reach, Land, Gates or a Goal of your own, got {type(goal).__name__}")
    numbers = asdict(goal)
    if isinstance(goal, Gates):
        for k, gate in enumerate(goal.gates):
            if not isinstance(gate, Gate):
                raise TypeError(f"gates[{k}]: expected propwash.learn.Gate, got {type(gate).__name__}")
        numbers["gates"] = [(list(map(float, gate.centre)), list(map(float, gate.normal)), float(gate.radius)) for gate in goal.gates]
        numbers["laps"] = _whole("laps", goal.laps, 1, 10**6)
    return type(goal).__name__.lower(), numbers, vehicle if isinstance(vehicle, Vehicle) else Vehicle(vehicle)


def _common(freq: int, substeps: int, worlds: int, horizon: int, commands: int, hidden: Sequence[int], seed: int) -> dict[str, Any]:
    return {
        "freq": _whole("freq", freq, 1, 1_000_000),
        "substeps": _whole("substeps", substeps, 1, 10**6),
        "worlds": _whole("worlds", worlds, 1, 10**6),
        "horizon": _whole("horizon", horizon, 1, 10**6),
        "commands": _whole("commands", commands, 1, 10**12),
        "hidden": [_whole("hidden", width, 1, 10**4) for width in hidden],
        "seed": _whole("seed", seed, 0, 2**62),
    }


def _usual(goal: AnyGoal, action: str) -> tuple[int, int, int, float]:
    """Steps under a command, commands of a flight, commands in all and rate of ``bptt``."""
    slow = action == "attitude"
    if isinstance(goal, Recover):
        return 5, 25, 60_000, 0.01
    if isinstance(goal, Gates):
        return 10 if slow else 5, 40, 1_000_000, 0.005
    if isinstance(goal, Land):
        return 10 if slow else 5, 40, 300_000, 0.01
    if isinstance(goal, Reach):
        return 10 if slow else 5, 40, 200_000, 0.01
    return 10 if slow else 5, 40, 100_000 if slow else 600_000, 0.01


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

    def __init__(self, native: _native.Crossed, goal: Cross | Swap, policy: Policy) -> None:
        self.goal = goal
        self.policy = policy
        """The policy, to be saved, exported, evaluated and flown as any other: it takes observations of the environment as they are."""
        self.prepared: float = native.seconds[0]
        """Time to compile the scenes and to bake their distance fields, s."""
        self.seconds: float = native.seconds[1]
        """Time that all of it took, s."""
        self.lost: int = native.lost
        """Drones that began anew since they touched something."""
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
            often the policy acts (``freq``) and how far actions reach. Nothing may move in the scenes. The training flies on its own in them, without disturbances, noise, delays and randomisation: an
            environment that has some is refused.
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
    seen, config, numbers = _asked(env, goal, seed)
    options = _flown(worlds, horizon, commands, hidden, rate, longest)
    block = (_whole("pool", pool[0], 1, 10**4), _whole("pool", pool[1], 1, 10**4))
    native = _native.learn_cross(json.dumps(config), numbers, block, options, _several(threads))
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
    return Crossed(native, goal, _sighted(seen, inputs, parts, f"propwash.learn.cross of {goal}"))


def swap(
    env: Any,
    goal: Swap = Swap(),
    *,
    worlds: int = 128,
    horizon: int = 30,
    commands: int = 2_000_000,
    hidden: Sequence[int] = (64, 64),
    rate: float = 0.003,
    longest: float = 1.0,
    seed: int = 0,
    threads: int | None = None,
) -> Crossed:
    """Trains one policy that flies every drone of a swarm to its place on the other side, by backpropagation through time.

    Each drone knows its velocity and attitude, the way to its place, and where the nearest others are and how they move (``neighbours``). What others do is given from
    outside: the slope of what it costs to come near them goes through a drone's own motion alone.

    Args:
        env: ``Propwash/SwarmCross-v0`` with ``action="attitude"`` and ``normalize_actions=False``, without wrappers, with 2, 4, 8 or 16 drones of one vehicle, in a scene with nothing but
            ground: it says what flies, from where to where, how many others each knows of, how often the policy acts (``freq``) and how far actions reach. The training flies on its own, without
            disturbances, noise, delays and randomisation, and no drone feels the air of others: an environment that has some is refused.
        goal: What is paid for.
        worlds: Drones that fly at once, in all worlds together; a multiple of those in a world.
        horizon: Commands of a flight before its gradient is taken.
        commands: Commands in all, over all drones.
        hidden: Widths of the network's layers.
        rate: Size of Adam's first steps; it falls to nothing along half a cosine.
        longest: Gradients that are longer are shortened to this.
        seed: Seed of weights, starts and goals.
        threads: Number of threads; None: all. The policy is the same for any.

    Raises:
        ValueError: for another task or action, other numbers of drones, scenes in which something stands, and options that make no sense.
        TypeError: for what is no environment of ``propwash.envs``.
    """
    seen, config, numbers = _asked(env, goal, seed)
    options = _flown(worlds, horizon, commands, hidden, rate, longest)
    native = _native.learn_swap(json.dumps(config), numbers, options, _several(threads))
    parts = native.parts()
    away, speed, height, zero, least, least_other, near, far, factor = parts["scales"]
    inputs = [
        Input("goal").direction(least),
        Input("goal").length().scale(away),
        Input("vel_heading").scale(speed),
        Input("pos").take(2).scale(height, zero),
        Input("quat"),
    ]
    for first in range(0, seen.shapes["neighbours"][0], 6):
        off = Input("neighbours").take(*range(first, first + 3))
        inputs += [off.direction(least_other), off.length().nearness(near, far).scale(factor), off.length().scale(away)]
        inputs.append(Input("neighbours").take(*range(first + 3, first + 6)).scale(speed))
    return Crossed(native, goal, _sighted(seen, tuple(inputs), parts, f"propwash.learn.swap of {goal}"))


def _asked(env: Any, goal: Cross | Swap, seed: int) -> tuple[Any, dict[str, Any], dict[str, float]]:
    """What an environment observes, its description with another seed, and the numbers of a goal."""
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
        if not (np.isfinite(value) and (value > 0.0 or name == "detour" and value == 0.0)):
            expected = "a finite number of at least 0" if name == "detour" else "a finite number above 0"
            raise ValueError(f"goal.{name}: expected {expected}, got {value}")
    return seen, config, numbers


def _flown(worlds: int, horizon: int, commands: int, hidden: Sequence[int], rate: float, longest: float) -> dict[str, Any]:
    return {
        "worlds": _whole("worlds", worlds, 1, 10**6),
        "horizon": _whole("horizon", horizon, 1, 10**6),
        "commands": _whole("commands", commands, 1, 10**12),
        "hidden": [_whole("hidden", width, 1, 10**4) for width in hidden],
        "rate": float(rate),
        "longest": float(longest),
    }


def _several(threads: int | None) -> int | None:
    return None if threads is None else _whole("threads", threads, 1, 4096)


def _sighted(seen: Any, inputs: tuple[Input, ...], parts: dict[str, Any], note: str) -> Policy:
    channels = tuple(Channel(name, seen.shapes[name], 1) for name in sorted({given.channel for given in inputs}))
    return Policy(channels, (Branch(inputs),), _layers(parts), _action(parts), seen.trained(note))


def bptt(
    goal: AnyGoal,
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
    rate: float | None = None,
    longest: float = 0.2,
    critic: Critic | bool | None = None,
    seed: int = 0,
) -> Trained:
    """Trains a policy by backpropagation through time.

    Args:
        goal: ``Track``, ``Recover``, ``Reach``, ``Land`` or ``Gates``.
        vehicle: What flies, with all its effects.
        dynamics: Its model.
        action: What the policy commands: ``attitude`` (roll and pitch up to ± 0.6 rad, yaw up to ± 0.2 rad, thrust 30 to 170 % of hover), or ``rotor_vel`` (± 30 % of the
            speeds of hover).
        freq: Steps of the simulation a second.
        substeps: Steps under each command; None: 10 by attitudes, 5 by rotor speeds and for ``Recover``.
        worlds: Worlds that fly at once; multiples of 16 fill the lanes.
        horizon: Commands of a flight before its gradient is taken; None: 40, for ``Recover`` 25.
        commands: Commands in all, over all worlds; None: 100,000 for ``Track`` by attitudes, 600,000 by rotor speeds, 60,000 for ``Recover``, 200,000 for ``Reach``,
            300,000 for ``Land``, 1,000,000 for ``Gates``.
        hidden: Widths of the network's layers.
        rate: Size of Adam's first steps; it falls to nothing along half a cosine. None: 0.01, for ``Gates`` 0.005.
        longest: Gradients that are longer are shortened to this.
        critic: A value network for what comes after a flight's end; False: none, True: that of ``Critic()``; None: True for ``Land``, else False.
        seed: Seed of weights and starts.

    Raises:
        ValueError: for options that make no sense, vehicles without these dynamics, and models that have no rotors to command.
    """
    name, given, of = _given(goal, vehicle, action)
    steps, flight, all_commands, first_rate = _usual(goal, action)
    if critic is None:
        critic = isinstance(goal, Land)
    how = Critic() if critic is True else critic or None
    if how is not None and not isinstance(how, Critic):
        raise TypeError(f"critic: expected propwash.learn.Critic, a bool or None, got {type(how).__name__}")
    options = _common(
        freq,
        steps if substeps is None else substeps,
        worlds,
        flight if horizon is None else horizon,
        all_commands if commands is None else commands,
        hidden,
        seed,
    )
    options |= {"rate": float(first_rate if rate is None else rate), "longest": float(longest)}
    options["critic"] = None if how is None else _taught(how)
    return Trained(_native.learn_bptt(name, given, of, dynamics, action, options), goal, of, "bptt")


def _taught(critic: Critic) -> dict[str, Any]:
    whole = {name: _whole(f"critic.{name}", getattr(critic, name), 1, 10**6) for name in ("epochs", "parts")}
    return whole | {name: float(getattr(critic, name)) for name in ("discount", "lam", "follow", "rate")}


def ppo(
    goal: AnyGoal,
    vehicle: str | os.PathLike[str] | Vehicle = "cf21B_500",
    *,
    dynamics: str = "first_principles",
    action: Action = "attitude",
    freq: int = 500,
    substeps: int | None = None,
    worlds: int = 128,
    horizon: int = 32,
    commands: int = 2_000_000,
    hidden: Sequence[int] = (64, 64),
    rate: float = 0.005,
    longest: float = 0.5,
    discount: float = 0.95,
    lam: float = 0.95,
    clip: float = 0.2,
    epochs: int = 4,
    parts: int = 4,
    noise: float = 0.3,
    entropy: float = 0.0,
    seed: int = 0,
) -> Trained:
    """Trains a policy by proximal policy optimisation (Schulman et al., 2017): it sees what flights cost, and no slopes.

    The policy that comes out flies the middle of the actions that the training drew. It is the same, bit for bit, at any number of threads.

    Args:
        goal: ``Track``, ``Recover``, ``Reach``, ``Land`` or ``Gates``.
        vehicle: What flies, with all its effects.
        dynamics: Its model.
        action: What the policy commands, as for ``bptt``.
        freq: Steps of the simulation a second.
        substeps: Steps under each command; None: 10 by attitudes, 5 by rotor speeds and for ``Recover``.
        worlds: Worlds that fly at once; multiples of 16 fill the lanes.
        horizon: Commands of a flight before the policy is changed.
        commands: Commands in all, over all worlds.
        hidden: Widths of the layers of both networks, of the actions and of the values.
        rate: Size of Adam's first steps; it falls to nothing along half a cosine.
        longest: Gradients that are longer are shortened to this.
        discount: What a cost counts one command later, below 1.
        lam: Share of longer returns in what an action is judged by (λ of generalised advantage estimation).
        clip: How far the likelihood of an action may move from what it was when it was flown, as a share, before it gains nothing more.
        epochs: How often the samples of a flight are gone through.
        parts: In how many parts, each a step of Adam.
        noise: Standard deviation of the first actions around those of the network; 1 is the limit of an action.
        entropy: What the logarithms of the standard deviations gain the loss by themselves, so that noise does not die early.
        seed: Seed of weights, starts and actions.

    Raises:
        ValueError: for options that make no sense, vehicles without these dynamics, and models that have no rotors to command.
    """
    name, given, of = _given(goal, vehicle, action)
    options = _common(freq, _usual(goal, action)[0] if substeps is None else substeps, worlds, horizon, commands, hidden, seed)
    options |= {"rate": float(rate), "longest": float(longest), "discount": float(discount), "lam": float(lam), "clip": float(clip)}
    options |= {"epochs": _whole("epochs", epochs, 1, 10**6), "parts": _whole("parts", parts, 1, 10**6)}
    options |= {"noise": float(noise), "entropy": float(entropy)}
    return Trained(_native.learn_ppo(name, given, of, dynamics, action, options), goal, of, "ppo")


_shorten_all(globals())
