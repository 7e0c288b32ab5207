"""Planning by sampling: ``import propwash.planning``.

Thousands of command sequences are flown from where the drone is by a model that is quick to fly, and the best of them say what to do next (MPPI, iCEM). Draws, flights
and costs happen in one call, in the lanes in which the samples fly.

>>> @propwash.cost(goal=3)
... def near(s):
...     off = s.pos - s.goal
...     return 50 * off @ off + s.vel @ s.vel + np.where(s.distance < 0.15, 1000, 0)
>>> planner = propwash.planning.Planner("cf21B_500", near, field=sim.distance_field(0.05))
>>> plan = planner.update(sim.states, t=0.0, goal=[2.0, 0.0, 1.0])
>>> sim.attitude_control(plan.command[None, None])
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any, Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native
from ._native import Vehicle
from ._repr import shorten_all as _shorten_all
from .costs import Cost
from .effects import n_rotors
from .field import DistanceField
from .sense import _whole
from .sim import Control
from .tape import States

__all__ = ["Plan", "Planner"]

Floats = NDArray[np.float64]

@dataclass(frozen=True)
class Plan:
    """What an update decides."""

    command: Floats
    """The command for now, in the units of the control mode. (command_width,)"""
    mode: int
    """Which of the plans side by side it is of."""
    cost: float
    """What the samples of which it is made cost, on average."""
    best: float
    """What the best sample of all costs."""


class Planner:
    """Plans by sampling, again and again: every ``update`` begins with the plan of the one before.

    A plan is a mean of commands for each of the times to come. Samples are drawn about it, flown and judged; it becomes the mean of the best (``elites``; Pinneri et al.,
    "Sample-efficient cross-entropy method for real-time planning", 2020) or of all, weighted by exp(-cost / temperature) (``temperature``; Williams et al., "Information
    theoretic MPC for model-based reinforcement learning", 2017). With several ``modes`` as many plans live side by side, and the best is flown: a way left and a way right of a
    pole do not become one way into it.

    The cost is a function of Python that runs once (``propwash.cost`` says what it sees). It is paid for each command, at its end; ``s.t`` begins with the time of the update.
    """

    def __init__(
        self,
        vehicle: str | os.PathLike[str] | Vehicle,
        cost: Cost | Callable[[Any], Any],
        *,
        field: DistanceField | None = None,
        control: Control = "attitude",
        dynamics: str = "so_rpy_rotor_drag",
        samples: int = 8192,
        horizon: int = 25,
        step: float = 0.04,
        substeps: int = 1,
        update: float = 0.02,
        modes: int = 1,
        elites: float = 0.01,
        temperature: float | None = None,
        lasting: float = 0.8,
        middle: Sequence[float] | None = None,
        spread: Sequence[float] | None = None,
        low: Sequence[float] | None = None,
        high: Sequence[float] | None = None,
        threads: int | None = None,
        seed: int = 0,
    ) -> None:
        """
        Args:
            vehicle: A built-in name, a vehicle file or a ``Vehicle``.
            cost: What each command costs: made by ``propwash.cost``, or a plain function that is given nothing.
            field: How near things are, for ``s.distance``: ``Sim.distance_field``.
            control: What commands mean.
            dynamics: The model that flies the samples.
            samples: Sequences of an update, over all modes: a multiple of 16 for each.
            horizon: Commands of a plan.
            step: Time under each command, s.
            substeps: Steps of the model under each command.
            update: Time from one update to the next, s: by so much plans move on.
            modes: Plans side by side.
            elites: Share of the samples, the best, whose mean a plan becomes.
            temperature: In place of ``elites``: costs of samples count by exp(-cost / temperature).
            lasting: Correlation of the draws of one command and the next.
            middle: The command about which plans begin. Attitudes: level, and the thrust of hover.
            spread: Standard deviation of each number of a command; 0: it is not drawn. Attitudes: 0.12 rad for roll and pitch, 15 % of the thrust of hover.
            low, high: Bounds of each number of a command. Attitudes: 0.6 rad for roll and pitch, 30 and 170 % of the thrust of hover.
            threads: None: all processors.
            seed: Of the draws; the same seed gives the same plans, bit for bit.

        Raises:
            TypeError: for a cost that cannot be an expression, with the line.
            ValueError: for numbers that make no sense, and a vehicle without this model.
        """
        own = vehicle if isinstance(vehicle, Vehicle) else Vehicle(vehicle)
        made = cost if isinstance(cost, Cost) else Cost(cost, {})
        rotors = n_rotors(own)
        written = made._for(rotors, {"state": 16, "rotor_vel": rotors}.get(control, 4))
        options: dict[str, Any] = {
            "samples": _whole("samples", samples, 1, 2**31),
            "horizon": _whole("horizon", horizon, 1, 10**6),
            "step": float(step),
            "substeps": _whole("substeps", substeps, 1, 10**6),
            "update": float(update),
            "modes": _whole("modes", modes, 1, 10**6),
            "elites": float(elites),
            "temperature": None if temperature is None else float(temperature),
            "lasting": float(lasting),
            "seed": _whole("seed", seed, 0, 2**62),
        }
        for name, value in {"middle": middle, "spread": spread, "low": low, "high": high}.items():
            options[name] = None if value is None else [float(v) for v in value]
        count = None if threads is None else _whole("threads", threads, 1, 4096)
        self._native = _native.Planner(own, dynamics, control, written, options, count)
        self._cost, self._field = made, field

    def update(self, state: States | ArrayLike, t: float = 0.0, **given: ArrayLike) -> Plan:
        """Plans anew.

        Args:
            state: Where the drone is: ``States`` of one drone, or an array that begins with position (m), attitude (x y z w), velocity (m/s, world) and angular
                velocity (rad/s, body). Samples begin with rotors as in hover.
            t: Time, s: the ``s.t`` of the cost.
            **given: What the cost is given, by name.

        Raises:
            ValueError: for a state or numbers that are not finite or not as many as they should be, a cost that reads ``distance`` without a field, and where no sample has a finite cost.
        """
        array = np.asarray(state.numbers if isinstance(state, States) else state, np.float64)
        if array.ndim == 0 or array.size != array.shape[-1] or array.size < 13:
            raise ValueError(f"state: expected at least 13 numbers of one drone, got the shape {array.shape}")
        values = self._cost._numbers(given, 1)
        near = None if self._field is None else self._field._native
        command, mode, cost, best = self._native.update(array.ravel()[:13].tolist(), float(t), values, near)
        return Plan(np.array(command), mode, cost, best)

    def begin(self) -> None:
        """Forgets all plans, as it was made."""
        self._native.begin()

    @property
    def means(self) -> NDArray[np.float32]:
        """The plans as the next update finds them. (modes, horizon, command_width)"""
        return self._native.means()

    @property
    def costs(self) -> NDArray[np.float32]:
        """What each sample of the last update cost; infinite where the model did not stay finite. (samples,)"""
        return self._native.costs()


_shorten_all(globals())
