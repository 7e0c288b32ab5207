"""What flights cost, as Python functions that run once: the costs of sampling controllers (MPPI, CEM)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native
from ._formula import Names, Sight, naming, said
from .tape import States

__all__ = ["Cost", "Priced", "cost"]

_STATE = {
    "pos": ("x", "y", "z"),
    "quat": ("qx", "qy", "qz", "qw"),
    "vel": ("vx", "vy", "vz"),
    "ang_vel": ("wx", "wy", "wz"),
}
_SINGLE = {name: (name,) for name in ("thrust", "t", "last", "distance")}
_TAKEN = {*_STATE, *_SINGLE, "rotor_vel", "command", "before"}


@dataclass(frozen=True)
class Priced:
    """What the flights of ``Sim.rollout(cost=…)`` cost."""

    cost: NDArray[np.float64]
    """Sum over the commands, of each drone; infinite in worlds that are quarantined. (n_worlds, n_drones)"""
    states: States | None
    """States after each command; None where they were not asked for."""


class Cost:
    """A cost of a drone after each command, made by ``propwash.cost``. It runs once for each kind of vehicle and control mode, and keeps what it said."""

    def __init__(self, function: Callable[[Any], Any], given: Mapping[str, int]) -> None:
        if not callable(function):
            raise TypeError(f"cost: expected a function of what is seen of a drone, got {type(function).__name__}")
        for name, count in given.items():
            if not name.isidentifier() or name in _TAKEN:
                raise ValueError(f"cost: expected names of given numbers that nothing else has, got {name!r}")
            if isinstance(count, bool) or not isinstance(count, (int, np.integer)) or not 1 <= count <= 1000:
                raise ValueError(f"cost: {name}: expected how many numbers are given, 1 to 1000, got {count!r}")
        self._function = function
        self.given = {name: int(count) for name, count in given.items()}
        """How many numbers are given at each rollout, by name."""
        self.name = getattr(function, "__name__", type(function).__name__)
        self._known: dict[tuple[int, int], _native.Cost] = {}

    def __call__(self, s: Any) -> Any:
        """The function itself, for costs that are made of others."""
        return self._function(s)

    def __repr__(self) -> str:
        return f"<propwash.Cost {self.name}>"

    def _for(self, n_rotors: int, width: int) -> _native.Cost:
        """For vehicles with so many rotors, and commands of so many numbers."""
        found = self._known.get((n_rotors, width))
        if found is None:
            numbered = {name: [f"{name}_{k + 1}" for k in range(count)] for name, count in self.given.items()}
            sees: dict[str, Sequence[str]] = {**_STATE, "rotor_vel": [f"rotor{k + 1}" for k in range(n_rotors)], **_SINGLE}
            sees |= {name: [f"{name}{k + 1}" for k in range(width)] for name in ("command", "before")}
            flat = [name for group in numbered.values() for name in group]
            names = Names(set(flat))
            with naming(names):
                text = said(self.name, self._function(Sight("a cost", {**sees, **numbered})))._text
            found = self._known[(n_rotors, width)] = _native.Cost(names.used_by([text]), text, flat, n_rotors, width)
        return found

    def _numbers(self, given: Mapping[str, ArrayLike] | None, n_times: int) -> list[float]:
        """What is given, of every command or once for all, in order."""
        got = dict(given or {})
        if set(got) != set(self.given):
            raise ValueError(f"given: expected {', '.join(self.given) or 'nothing'}, got {', '.join(map(str, got)) or 'nothing'}")
        columns = []
        for name, count in self.given.items():
            array = np.asarray(got[name], np.float64)
            whole = array.reshape(1) if array.shape == () else array
            if count == 1 and whole.shape == (n_times,) and n_times > 1:
                whole = whole[:, None]
            if whole.shape not in ((count,), (n_times, count)):
                raise ValueError(f"given: {name}: expected shape ({count},), or ({n_times}, {count}) = (n_times, {count}), got {array.shape}")
            columns.append(np.broadcast_to(whole, (n_times, count)))
        return [] if not columns else np.concatenate(columns, -1).ravel().tolist()


def cost(function: Callable[[Any], Any] | None = None, **given: int) -> Any:
    """Makes a cost of a Python function, which runs once and then never again; ``Sim.rollout(commands, cost=…)`` adds it up while the flights are flown.

    The function sees one drone after a command: ``s.pos`` (m), ``s.quat`` (x y z w), ``s.vel`` (m/s, world), ``s.ang_vel`` (rad/s, body), ``s.rotor_vel`` (rad/s), ``s.thrust`` (N, of fitted models),
    ``s.t`` (s since the flight began), ``s.last`` (1 after the last command, else 0: for a terminal cost), ``s.command`` and ``s.before`` (the command and the one before it, in units of the control
    mode), and, where the rollout is given a field, ``s.distance`` (m). ``propwash.effect`` says what it may do.

    Args:
        function: The function.
        given: Further numbers that it sees, by name: how many each. Their values are given at every rollout (``given={"goal": …}``), once or for every command.

    >>> @propwash.cost(goal=3)
    ... def to_goal(s):
    ...     off = s.pos - s.goal
    ...     return off @ off + 0.1 * s.vel @ s.vel + 10 * s.last * off @ off
    >>> costs = sim.rollout(commands, cost=to_goal, given={"goal": [0, 0, 1]}).cost
    """
    if function is None:
        return lambda made: Cost(made, given)
    return Cost(function, given)
