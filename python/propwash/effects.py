"""Effects of one's own as Python functions, which fly without Python: ``propwash.effect``.

The function runs once, over names of numbers instead of numbers, and what it does with them becomes an expression of the vehicle file (docs/effects/expression.md). So it flies
in lanes, is compiled (docs/compile.md), has gradients, is fitted and ranked by the gap finder, and is saved with the vehicle.

>>> @propwash.effect
... def breeze(s):
...     s.force[0] += 0.01 * np.sin(2 * s.t)
>>> sim = propwash.Sim(1024, drone=breeze.on("cf21B_500"), control="attitude")
"""

from __future__ import annotations

import inspect
import os
from dataclasses import dataclass
from typing import Any, Callable, Literal

import numpy as np

from ._formula import BeyondError, Formula, Names, Vector, naming, numbers, refuse
from ._native import Vehicle

__all__ = ["Effect", "EffectParameter", "effect"]


class Memory:
    """A number that is remembered from step to step."""

    def __init__(self, name: str, start: float) -> None:
        self.name, self.start = name, start
        self._next: Formula | None = None

    @property
    def value(self) -> Formula:
        """What is remembered."""
        return Formula(self.name)

    @property
    def next(self) -> Formula:
        """What will be remembered after this step."""
        if self._next is None:
            raise refuse(f"memory {self.name}: its next value is not set yet")
        return self._next

    @next.setter
    def next(self, value: Any) -> None:
        self._next = Formula.of(value)


#: Most rotors of a vehicle.
_MOST_ROTORS = 8


class Surroundings:
    """What an effect sees, and what it adds to. Vectors are arrays of numbers; units are SI."""

    #: Names of the state, by what expressions call them.
    _SEES = {
        "t": "t",
        "pos": ("x", "y", "z"),
        "vel": ("vx", "vy", "vz"),
        "vel_body": ("vx_body", "vy_body", "vz_body"),
        "ang_vel": ("wx", "wy", "wz"),
        "quat": ("qx", "qy", "qz", "qw"),
        "roll": "roll",
        "pitch": "pitch",
        "yaw": "yaw",
        "rotor_vel": tuple(f"rotor{k}" for k in range(1, 9)),
        "rotor_sum": "rotor_sum",
        "thrust": "thrust_n",
        "ground": "ground_m",
        "ceiling": "ceiling_m",
        "others": "others_m",
        "wind": ("wind_x", "wind_y", "wind_z"),
        "air_density": "air_density",
        "mass": "mass_kg",
        "gravity": "gravity",
        "normal": ("normal1", "normal2", "normal3"),
        "command": tuple(f"command{k}" for k in range(1, 17)),
        "dt": "dt",
    }
    _ADDS: tuple[str, ...] = ("force", "force_body", "torque", "thrust_factor", "rotor_command", "attitude_command")
    #: How the error calls who looks.
    _WHO = "an effect"

    def __init__(self, rotors: int = 4) -> None:
        made: dict[str, Any] = {name: Vector(name) for name in ("force", "force_body", "torque")}
        made["thrust_factor"] = None
        made["rotor_command"] = Vector("rotor_command", rotors, [f"rotor_command{k + 1}" for k in range(rotors)], most=_MOST_ROTORS)
        made["attitude_command"] = Vector("attitude_command", 4, [f"{name}_command" for name in ("roll", "pitch", "yaw", "thrust")])
        made["_memories"] = {}
        for name, value in made.items():
            object.__setattr__(self, name, value)

    def __getattribute__(self, name: str) -> Any:
        if name == "thrust_factor":
            found = object.__getattribute__(self, name)
            return Formula("1.0") if found is None else found
        return object.__getattribute__(self, name)

    def __getattr__(self, name: str) -> Any:
        found = Surroundings._SEES.get(name)
        if found is None:
            raise refuse(f"{self._WHO} sees {', '.join(Surroundings._SEES)} and adds to {', '.join(self._ADDS)}, not {name}")
        return Formula(found) if isinstance(found, str) else numbers(found)

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "thrust_factor" and name in self._ADDS:
            object.__setattr__(self, name, Formula.of(value))
        elif name in self._ADDS:
            # What `+=` does behind its sum.
            if value is not object.__getattribute__(self, name):
                raise refuse(f"{name} has {len(getattr(self, name))} numbers: {name} += …, {name}[0] += …, {name}[:] = …")
        else:
            raise refuse(f"{self._WHO} adds to {', '.join(self._ADDS)}, not to {name}")

    def memory(self, name: str, start: float = 0.0) -> Memory:
        """A number that is remembered from step to step: ``.value`` is what it was, ``.next`` is to be set.

        Forces see what is remembered in this very step: ``.next`` of the step. Raises TypeError for a name that was given before.
        """
        if not isinstance(name, str) or not name.isidentifier() or name in self._memories:
            raise refuse(f"memory({name!r}): expected a name of letters, digits and underscores that no other memory has")
        if isinstance(start, bool) or not isinstance(start, (int, float, np.integer, np.floating)) or not np.isfinite(start):
            raise refuse(f"memory {name}: expected a finite number to start from, got {start!r}")
        self._memories[name] = Memory(name, float(start))
        found: Memory = self._memories[name]
        return found

    def to_world(self, vector: Any) -> Any:
        """Three numbers along body axes as along the world's."""
        return _turned(self.quat, vector, 1.0)

    def to_body(self, vector: Any) -> Any:
        """Three numbers along the world's axes as along body axes."""
        return _turned(self.quat, vector, -1.0)


def _turned(quat: Any, vector: Any, way: float) -> Any:
    """v + 2 w q × v + 2 q × (q × v), by the vector q and the scalar w of a quaternion or its inverse."""
    axis = quat[:3] * way
    once = np.cross(axis, vector)
    return vector + 2 * quat[3] * once + 2 * np.cross(axis, once)


@dataclass(frozen=True)
class EffectParameter:
    """A number of an effect that can be set, drawn at random and fitted: a default value of the function's further arguments."""

    value: float
    """Its value, SI."""
    unit: str = "1"
    """Its unit as text; ``"1"`` for a ratio."""
    spike: float | None = None
    """How far it may be off on a carefully built vehicle where the effect is absent."""
    slab: float | None = None
    """Its plausible size where the effect is there; without it no search frees the parameter."""
    sign: Literal["any", "up", "down"] | None = None
    """Whether a search may go either way from the file's value, or only up or down."""
    min: float | None = None
    """Least value."""
    max: float | None = None
    """Greatest value."""

    def _toml(self, name: str) -> str:
        lines = [f"[effect.parameter.{name}]", f"value = {float(self.value)!r}", f'unit = "{self.unit}"']
        lines += [f"{key} = {float(value)!r}" for key in ("spike", "slab", "min", "max") if (value := getattr(self, key)) is not None]
        lines += [f'sign = "{self.sign}"'] if self.sign is not None else []
        return "\n".join(lines) + "\n"


class Effect:
    """An effect that a Python function described; ``propwash.effect`` makes it."""

    name: str
    """Its name: that of the function."""
    #: Whether a number as default makes a parameter of the vehicle.
    _NUMBERS_ARE_PARAMETERS = True

    def __init__(self, function: Callable[..., Any], name: str | None = None) -> None:
        self.name = name or function.__name__
        self.__doc__ = function.__doc__
        self._function = function
        first, *rest = inspect.signature(function).parameters.values()
        self._first = first.name
        self._parameters: dict[str, EffectParameter] = {}
        self._constants: dict[str, float] = {}
        for own in rest:
            if own.default is inspect.Parameter.empty:
                raise TypeError(f"{self.name}: {own.name} has no value: write {own.name}=propwash.EffectParameter(0.1, \"N·s/m\")")
            value = own.default
            if isinstance(value, (int, float)) and not isinstance(value, bool):
                if not self._NUMBERS_ARE_PARAMETERS:
                    self._constants[own.name] = float(value)
                    continue
                value = EffectParameter(float(value))
            if not isinstance(value, EffectParameter):
                raise TypeError(f"{self.name}: {own.name}: expected a number or a propwash.EffectParameter, got {value!r}")
            self._parameters[own.name] = value
        self._toml: str | None = None
        try:
            # Errors of the function are told where it is written.
            self._toml = self._written(self._default())
        except BeyondError as error:
            self._beyond = str(error)

    def _default(self) -> Surroundings:
        return Surroundings()

    @property
    def toml(self) -> str:
        """What stands in a vehicle file, of a vehicle with four rotors: an ``[[effect]]`` of the kind ``expression``.

        Raises:
            TypeError: where the function names further rotors: then ``on(vehicle).to_toml()`` has it.
        """
        if self._toml is None:
            raise TypeError(f"{self._beyond}: this is of a vehicle with four rotors, and on(vehicle).to_toml() of one with more")
        return self._toml

    def _written(self, seen: Surroundings) -> str:
        """Runs the function, and writes down what it did."""
        names = Names({*self._parameters, "vx", "vy", "vz"})
        with naming(names):
            returned = self._function(seen, **{own: Formula(own) for own in self._parameters}, **self._constants)
            self._after(seen)
        if returned is not None:
            raise TypeError(f"{self.name}: expected None, got {type(returned).__name__}; an effect adds to {self._first}.force and the like, and returns nothing")
        lists = {
            "force_world_n": seen.force.texts(),
            "force_body_n": seen.force_body.texts(),
            "torque_body_n_m": seen.torque.texts(),
            "rotor_command": seen.rotor_command.texts(),
            "attitude_command": seen.attitude_command.texts(),
        }
        lines = [f"{key} = [" + ", ".join(f'"{text}"' for text in texts) + "]\n" for key, texts in lists.items() if texts is not None]
        used = [text for texts in lists.values() for text in texts or []]
        factor = object.__getattribute__(seen, "thrust_factor")
        if factor is not None:
            lines.append(f'thrust_factor = "{factor._text}"\n')
            used.append(factor._text)
        if not lines:
            raise TypeError(f"{self.name} adds nothing: expected {self._first}.force[0] += … or another of {', '.join(seen._ADDS)}")
        for memory in seen._memories.values():
            if memory._next is None:
                raise TypeError(f"{self.name}: memory {memory.name} never gets a next value: set .next")
            if memory.name in self._parameters:
                raise TypeError(f"{self.name}: memory {memory.name} has the name of a parameter")
            used.append(memory._next._text)
        lets = [f'"{text}"' for text in self._before()] + [f'"{name} = {text}"' for name, text in names.used_by(used)]
        head = [f'[[effect]]\nkind = "expression"\nname = "{self.name}"\n', *self._beside()]
        head += ["let = [\n    " + ",\n    ".join(lets) + ",\n]\n"] if lets else []
        tables = [f'[effect.memory.{m.name}]\nstart = {m.start!r}\nnext = "{m._next._text}"\n' for m in seen._memories.values()]
        return "".join([*head, *lines, *tables, *(own._toml(key) for key, own in self._parameters.items())])

    def _before(self) -> list[str]:
        """Values that stand before those of the function."""
        return []

    def _after(self, seen: Surroundings) -> None:
        """What becomes of what the function did."""

    def _beside(self) -> list[str]:
        """Further keys of the entry."""
        return []

    def on(self, vehicle: str | os.PathLike[str] | Vehicle) -> Vehicle:
        """A vehicle with this effect behind those that it has.

        Raises:
            ValueError: for what expressions cannot say, with its place in the text; for a second effect of this name.
        """
        own = vehicle if isinstance(vehicle, Vehicle) else Vehicle(vehicle)
        if self._toml is not None and "\nrotor_command" not in self._toml:
            return own.with_effects(self._toml)
        return own.with_effects(self._written(Surroundings(n_rotors(own))))

    def __repr__(self) -> str:
        return f"<propwash.Effect {self.name}>"


def n_rotors(vehicle: Vehicle) -> int:
    """Number of rotors of a vehicle."""
    return sum(name.startswith("rotors.") and name.endswith(".spin") for name, _ in vehicle.parameters())


def effect(function: Callable[..., Any]) -> Effect:
    """Makes an effect of a Python function of what surrounds the drone, which runs once and then never again.

    The function takes ``s`` and adds to ``s.force`` (N, world), ``s.force_body`` (N, body), ``s.torque`` (N m, body), three numbers each, multiplies
    ``s.thrust_factor``, or changes ``s.rotor_command`` (rad/s, one for each rotor) and ``s.attitude_command`` (roll, pitch, yaw in rad, thrust in N) on their way to the motors. It sees ``s.t`` (s since the
    reset), ``s.pos``, ``s.vel`` (world), ``s.vel_body`` (through the air, body), ``s.ang_vel`` (body),
    ``s.quat``, ``s.roll``, ``s.pitch``, ``s.yaw``, ``s.rotor_vel``, ``s.rotor_sum``, ``s.thrust``, ``s.ground`` and ``s.ceiling`` (m to them), ``s.others`` (m to the nearest
    vehicle), ``s.wind``, ``s.air_density``, ``s.mass``, ``s.gravity``, ``s.normal`` (three standard normal random numbers, others in every step), ``s.command`` (what the vehicle is
    commanded, by number), ``s.dt``; turns vectors by ``s.to_world`` and ``s.to_body``; and remembers numbers by ``m = s.memory("name", start)``, ``m.value`` and
    ``m.next``. Vectors are arrays. There are arithmetic, whole powers, comparisons, ``abs``, and NumPy's ``where``, ``clip``, ``minimum``, ``maximum``, ``sqrt``, ``exp``, ``sin``, ``cos``, ``tan``, ``arcsin``, ``arccos``,
    ``arctan2``, ``tanh``, ``floor``, ``sign``, ``hypot``, ``cross``, ``@``. Further arguments are parameters, with their values as defaults (``EffectParameter``), which are
    ``effect.expression.NAME.ARGUMENT`` elsewhere.

    Raises:
        TypeError: for what cannot be part of an expression: branches, functions of ``math``, other names; the message says the line.
    """
    return Effect(function)
