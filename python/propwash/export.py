"""A vehicle's equations in other languages and libraries: ``import propwash.export``.

The same equations that fly in ``Sim``, printed as straight-line code: the time derivative of the state, a step of the simulation, the on-board controllers,
the gradient of a step. ``numpy``, ``jax`` and ``casadi`` give functions to call, ``source`` the text in any language.

>>> rate = propwash.export.casadi("cf21B_500", dynamics="so_rpy")
>>> step = propwash.export.numpy("my_quad.toml", what="step", control="rotor_vel")
>>> print(propwash.export.source("cf21B_500", to="c"))
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, Literal, Mapping, Sequence, TypedDict, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native
from ._native import Vehicle
from ._optional import need

if TYPE_CHECKING:
    from typing_extensions import Unpack

__all__ = ["Choices", "Function", "casadi", "jax", "numpy", "source"]

What = Literal["rate", "step", "controller", "gradient"]
Language = Literal["c", "c-float", "cuda", "wgsl", "numpy", "jax", "casadi", "latex"]
VehicleLike = Union[str, "os.PathLike[str]", Vehicle]


class Choices(TypedDict, total=False):
    """Which function of a vehicle, beside what it computes."""

    dynamics: str
    """As that of ``Sim``: ``"first_principles"`` where it is not given."""
    control: str
    """What commands mean: ``"attitude"``. A rate has rotor speeds, or attitude and thrust for fitted models."""
    integrator: str
    """How a step integrates: ``"euler"``."""
    freq: int
    """Steps per second: 500."""
    parameters: Sequence[str] | Literal["all"]
    """Names of parameters that are inputs (``sim.parameters()`` lists them), or ``"all"``; the others are numbers in the code."""
    surroundings: bool
    """Whether forces, wind, heights of ground and ceiling, time and random numbers are an input ``w``; else the air is still, and the drone far from everything."""


class Function:
    """A vehicle's equations as a function of vectors, over NumPy or JAX arrays; ``f(x, u)``, or with further inputs by name.

    Last axes are the vectors, leading axes a batch. Inputs that are left out have their usual values (``defaults``). One output comes as an array, several
    as a tuple.
    """

    name: str
    """Its name in the printed code."""
    about: str
    """What it computes."""
    inputs: Mapping[str, Sequence[str]]
    """The inputs in order, with the names of their numbers."""
    outputs: Mapping[str, Sequence[str]]
    """The outputs in order, with the names of their numbers."""
    defaults: Mapping[str, NDArray[np.float64]]
    """Usual values of the inputs: a drone that hovers, parameters as in its file."""
    source: str
    """The Python code that runs."""

    def __init__(self, native: _native.Function, language: str) -> None:
        self.name, self.about = native.name, native.about
        self.inputs = {name: tuple(entries) for name, _, entries, _ in native.inputs()}
        self.defaults = {name: np.array(values) for name, _, _, values in native.inputs()}
        self.outputs = {name: tuple(entries) for name, _, entries in native.outputs()}
        self.source = native.source(language)
        space: dict[str, Any] = {}
        exec(compile(self.source, f"<{self.name}>", "exec"), space)
        self._run = space[self.name]

    def __call__(self, *inputs: ArrayLike, **named: ArrayLike) -> Any:
        if len(inputs) > len(self.inputs):
            raise TypeError(f"{self.name}: expected at most {len(self.inputs)} inputs ({', '.join(self.inputs)}), got {len(inputs)}")
        given: dict[str, Any] = dict(zip(self.inputs, inputs))
        for name, value in named.items():
            if name not in self.inputs or name in given:
                what = "was given twice" if name in given else "is no input"
                raise TypeError(f"{self.name}: {name} {what}; there are {', '.join(self.inputs)}")
            given[name] = value
        for name, entries in self.inputs.items():
            shape = np.shape(given.setdefault(name, self.defaults[name]))
            if shape[-1:] != (len(entries),):
                raise ValueError(f"{self.name}: {name}: expected {len(entries)} numbers in the last axis ({', '.join(entries)}), got {shape}")
        return self._run(*(given[name] for name in self.inputs))

    def __repr__(self) -> str:
        inputs = ", ".join(f"{name}[{len(entries)}]" for name, entries in self.inputs.items())
        outputs = ", ".join(f"{name}[{len(entries)}]" for name, entries in self.outputs.items())
        return f"Function({self.about}: {inputs} -> {outputs})"


def _function(vehicle: VehicleLike, what: What, choices: Choices) -> _native.Function:
    unknown = set(choices) - set(Choices.__annotations__)
    if unknown:
        raise TypeError(f"unknown choice {sorted(unknown)[0]!r}: there are {', '.join(Choices.__annotations__)}")
    own = vehicle if isinstance(vehicle, Vehicle) else Vehicle(vehicle)
    free = choices.get("parameters", ())
    return _native.Function(
        own,
        what,
        choices.get("dynamics", "first_principles"),
        choices.get("control", "attitude"),
        choices.get("integrator", "euler"),
        choices.get("freq", 500),
        [free] if isinstance(free, str) else list(free),
        choices.get("surroundings", False),
    )


def source(vehicle: VehicleLike, what: What = "rate", to: Language = "c", **choices: Unpack[Choices]) -> str:
    """The source of a function of a vehicle.

    Args:
        vehicle: Name of a built-in vehicle, path of a vehicle file, or a ``Vehicle``.
        what: ``"rate"``: time derivative of the state under commanded rotor speeds (fitted models: attitude and thrust). ``"step"``: the state after a
            step of the simulation in which all stages of the controllers tick. ``"controller"``: what the on-board controllers command. ``"gradient"``:
            what a loss gains by the inputs of a step, from what it gains by its outputs.
        to: ``"c"`` (C99, double), ``"c-float"``, ``"cuda"``, ``"wgsl"``, ``"numpy"``, ``"jax"``, ``"casadi"``, ``"latex"``.
        **choices: ``dynamics``, ``control``, ``integrator``, ``freq``, ``parameters``, ``surroundings``: see ``Choices``.

    Raises:
        ValueError, KeyError: for what the vehicle lacks; the message says what there is.
    """
    return _function(vehicle, what, choices).source(to)


def numpy(vehicle: VehicleLike, what: What = "rate", **choices: Unpack[Choices]) -> Function:
    """The same as a function over NumPy arrays."""
    return Function(_function(vehicle, what, choices), "numpy")


def jax(vehicle: VehicleLike, what: What = "rate", **choices: Unpack[Choices]) -> Function:
    """The same over JAX arrays: it can be jitted, mapped and differentiated. JAX computes in f32 unless ``jax_enable_x64`` is set."""
    need("jax", "jax", "propwash.export.jax")
    return Function(_function(vehicle, what, choices), "jax")


def casadi(vehicle: VehicleLike, what: What = "rate", **choices: Unpack[Choices]) -> Any:
    """The same as a ``casadi.Function`` of its inputs, all of which it takes, for solvers of CasADi."""
    need("casadi", "casadi", "propwash.export.casadi")
    native = _function(vehicle, what, choices)
    space: dict[str, Any] = {}
    exec(compile(native.source("casadi"), f"<{native.name}>", "exec"), space)
    return space[native.name]()
