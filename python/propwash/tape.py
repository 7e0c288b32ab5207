"""Flights under a sequence of commands in one call, and their gradients."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native

Floats = NDArray[Any]

_COLUMNS = {"pos": slice(0, 3), "quat": slice(3, 7), "vel": slice(7, 10), "ang_vel": slice(10, 13), "rotor_vel": slice(13, -1)}
"""Where each part of a state stands in the last axis; the last number is the thrust."""


@dataclass(frozen=True)
class States:
    """States, or one number for each number of a state, as views of one array."""

    numbers: Floats
    """All of them: position, attitude, velocity, angular velocity, rotor speeds, thrust. (…, n_drones, state_width)"""

    @property
    def pos(self) -> Floats:
        """Position, m, world. (…, n_drones, 3)"""
        return self.numbers[..., _COLUMNS["pos"]]

    @property
    def quat(self) -> Floats:
        """Attitude x y z w, body to world. (…, n_drones, 4)"""
        return self.numbers[..., _COLUMNS["quat"]]

    @property
    def vel(self) -> Floats:
        """Velocity, m/s, world. (…, n_drones, 3)"""
        return self.numbers[..., _COLUMNS["vel"]]

    @property
    def ang_vel(self) -> Floats:
        """Angular velocity, rad/s, body. (…, n_drones, 3)"""
        return self.numbers[..., _COLUMNS["ang_vel"]]

    @property
    def rotor_vel(self) -> Floats:
        """Rotor speeds, rad/s. (…, n_drones, n_rotors)"""
        return self.numbers[..., _COLUMNS["rotor_vel"]]

    @property
    def thrust(self) -> Floats:
        """Thrust state of the abstracted models, N. (…, n_drones)"""
        return self.numbers[..., -1]

    def zeros(self) -> States:
        """Zeros of the same shape: seeds to be filled."""
        return States(np.zeros_like(self.numbers))


@dataclass(frozen=True)
class Approach:
    """How near the drones of a flight came to what stands still, where they were after each command."""

    distance: NDArray[np.float32]
    """Least distance of a drone's place to anything, m. (n_worlds, n_drones)"""
    first: NDArray[np.uint32]
    """Number of the first command after which it was nearer than the radius, from 0; the number of commands where it never was. (n_worlds, n_drones)"""
    states: States | None
    """States after each command; None where they were not asked for."""


@dataclass(frozen=True)
class Gradient:
    """What a loss gains by everything that a flight began with and was told."""

    state: States
    """The state at the start, each number taken for itself, also the four of the attitude. (n_worlds, n_drones, …)"""
    commands: Floats
    """The commands. (n_worlds, n_times, n_drones, command_width)"""
    disturbance_force: Floats
    """The disturbance force, N, world, the same in all steps. (n_worlds, n_drones, 3)"""
    disturbance_torque: Floats
    """The disturbance torque, N·m, world. (n_worlds, n_drones, 3)"""
    wind: Floats
    """The velocity of the air, m/s, world. (n_worlds, n_drones, 3)"""
    controller_memory: Floats
    """What the on-board controllers remembered. (n_worlds, n_drones, numbers of the control mode)"""
    effect_memory: Floats
    """What effects remembered. (n_worlds, numbers of all effects)"""
    parameters: dict[str, Floats]
    """The parameters that were asked for. (n_worlds, n_drones) each"""


class Tape:
    """A recorded flight, made by ``Sim.record``; it does not change when the ``Sim`` flies on."""

    def __init__(self, native: _native.Tape) -> None:
        self._native = native
        self._states = States(native.take_states())
        self._states.numbers.flags.writeable = False

    def __repr__(self) -> str:
        worlds, times, drones, _ = self._native.shape
        return f"<propwash.Tape of {worlds} worlds x {times} commands x {drones} drones, {self._native.precision}>"

    @property
    def states(self) -> States:
        """States after each command. (n_worlds, n_times, n_drones, …)"""
        return self._states

    @property
    def faults(self) -> list[int]:
        """Numbers of worlds that stood still during the flight; their seeds must be zero."""
        return self._native.faults()

    def pull_back(self, seeds: ArrayLike | States | Mapping[str, ArrayLike], parameters: Sequence[str] = ()) -> Gradient:
        """Takes what a loss gains by the states to what it gains by everything before: the vector-Jacobian product.

        Args:
            seeds: What the loss gains by each number of ``states``: an array of that shape, ``States``, or some parts of it by name
                (``{"pos": ...}``, shape (n_worlds, n_times, n_drones, 3)); parts that are left out count as zero.
            parameters: Names of parameters, as ``Sim.parameters`` lists them, whose gradients are wanted too.

        Raises:
            ValueError: for seeds of another shape, seeds of worlds that stood still, and gradients that are not finite.
            KeyError: for a parameter that no drone has.
        """
        if isinstance(parameters, str):
            raise TypeError(f"parameters: expected a list of names, got the text {parameters!r}")
        found = self._native.pull_back(self._numbers(seeds), list(parameters))
        return Gradient(**{**found, "state": States(found["state"])})

    def push_forward(
        self,
        *,
        state: ArrayLike | States | None = None,
        commands: ArrayLike | None = None,
        disturbance_force: ArrayLike | None = None,
        disturbance_torque: ArrayLike | None = None,
        wind: ArrayLike | None = None,
        controller_memory: ArrayLike | None = None,
        effect_memory: ArrayLike | None = None,
        parameters: Mapping[str, ArrayLike] | None = None,
    ) -> States:
        """How far ``states`` move when everything before moves in a direction: the Jacobian-vector product, by dual numbers in f64 one
        world at a time: exact, and much slower than ``pull_back``.

        Each part of the direction has the shape of that part of ``Gradient``; what is left out stands still.
        """
        given = {
            "state": state.numbers if isinstance(state, States) else state,
            "commands": commands,
            "disturbance_force": disturbance_force,
            "disturbance_torque": disturbance_torque,
            "wind": wind,
            "controller_memory": controller_memory,
            "effect_memory": effect_memory,
            "parameters": dict(parameters or {}),
        }
        return States(self._native.push_forward({name: value for name, value in given.items() if value is not None}))

    def linearize(self) -> tuple[Floats, Floats]:
        """Slopes of the last state by the state at the start (``A``) and by the first command (``B``): x' = A x + B u about the flight.

        Returns:
            (n_worlds, n_drones, n, n) and (n_worlds, n_drones, n, command_width), with n numbers of a state in the order of
            ``States.numbers``. What controllers and effects remember is held as it was.
        """
        return self._native.linearize()

    def _numbers(self, seeds: ArrayLike | States | Mapping[str, ArrayLike]) -> ArrayLike:
        if isinstance(seeds, States):
            return seeds.numbers
        if not isinstance(seeds, Mapping):
            return seeds
        out = self.states.zeros()
        for name, value in seeds.items():
            if name not in (*_COLUMNS, "thrust"):
                raise ValueError(f"seeds: expected parts of a state ({', '.join(_COLUMNS)}, thrust), got {name!r}")
            part = getattr(out, name)
            given = np.asarray(value)
            if given.shape != part.shape:
                raise ValueError(f"seeds of {name}: expected shape {part.shape}, got {given.shape}")
            part[...] = given
        return out.numbers
