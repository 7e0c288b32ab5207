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
import linecache
import os
import sys
from dataclasses import dataclass
from typing import Any, Callable, Literal, Union

import numpy as np

from ._native import Vehicle

__all__ = ["Effect", "EffectParameter", "effect"]

Operand = Union["Formula", float, int]

#: What sums and products are worth in the text of an expression, for parentheses: the higher, the tighter.
_SUM, _PRODUCT, _MINUS, _POWER, _ATOM = range(5)


def _where() -> str:
    """The line of the user's code that is running: the innermost one that is not of this file or NumPy's."""
    frame = sys._getframe(1)
    while frame is not None and frame.f_code.co_filename == __file__:
        frame = frame.f_back  # type: ignore[assignment]
    if frame is None:
        return ""
    line = linecache.getline(frame.f_code.co_filename, frame.f_lineno).strip()
    return f" ({os.path.basename(frame.f_code.co_filename)}, line {frame.f_lineno}{': ' + line if line else ''})"


def _refuse(what: str) -> TypeError:
    return TypeError(what + _where())


class Formula:
    """A number that is not known yet, as the text of an expression."""

    __slots__ = ("_rank", "_text")

    def __init__(self, text: str, rank: int = _ATOM) -> None:
        self._text, self._rank = text, rank

    def __repr__(self) -> str:
        return self._text

    @staticmethod
    def _of(value: Any) -> Formula:
        if isinstance(value, Formula):
            return value
        if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, float, np.integer, np.floating)):
            raise _refuse(f"expected a number or a formula of the state, got {value!r} ({type(value).__name__})")
        number = float(value)
        if not np.isfinite(number):
            raise _refuse(f"expected a finite number, got {number}")
        return Formula(repr(number), _MINUS if number < 0 else _ATOM)

    def _in(self, least: int) -> str:
        return self._text if self._rank >= least else f"({self._text})"

    def _two(self, sign: str, other: Any, rank: int, swapped: bool = False) -> Any:
        if isinstance(other, np.ndarray):
            return NotImplemented  # NumPy takes its parts one by one
        a, b = (Formula._of(other), self) if swapped else (self, Formula._of(other))
        # What stands behind − and / keeps its parentheses, also where it is of the same rank; so does what begins with a minus.
        return Formula(f"{a._in(rank)} {sign} {b._in(max(rank + 1, _POWER if b._rank == _MINUS else 0))}", rank)

    def __add__(self, other: Any) -> Any:
        return self._two("+", other, _SUM)

    def __radd__(self, other: Any) -> Any:
        return self._two("+", other, _SUM, swapped=True)

    def __sub__(self, other: Any) -> Any:
        return self._two("-", other, _SUM)

    def __rsub__(self, other: Any) -> Any:
        return self._two("-", other, _SUM, swapped=True)

    def __mul__(self, other: Any) -> Any:
        return self._two("*", other, _PRODUCT)

    def __rmul__(self, other: Any) -> Any:
        return self._two("*", other, _PRODUCT, swapped=True)

    def __truediv__(self, other: Any) -> Any:
        return self._two("/", other, _PRODUCT)

    def __rtruediv__(self, other: Any) -> Any:
        return self._two("/", other, _PRODUCT, swapped=True)

    def __neg__(self) -> Formula:
        return Formula(f"-{self._in(_POWER)}", _MINUS)

    def __pos__(self) -> Formula:
        return self

    def __abs__(self) -> Formula:
        return self._call("abs")

    def __pow__(self, power: Any) -> Formula:
        if isinstance(power, (float, np.floating)) and float(power).is_integer():
            power = int(power)
        if isinstance(power, (bool, Formula)) or not isinstance(power, (int, np.integer)) or not -16 <= power <= 16:
            raise _refuse(f"expected a whole power from -16 to 16, got {power!r}; roots are np.sqrt")
        return Formula(f"{self._in(_ATOM)}^{int(power)}", _POWER)

    def _call(self, name: str, *others: Any) -> Formula:
        return Formula(f"{name}({', '.join([self._text, *(Formula._of(other)._text for other in others)])})")

    # What NumPy asks the parts of an array for, np.sin(s.vel).
    def sqrt(self) -> Formula:
        return self._call("sqrt")

    def exp(self) -> Formula:
        return self._call("exp")

    def sin(self) -> Formula:
        return self._call("sin")

    def cos(self) -> Formula:
        return self._call("cos")

    def tanh(self) -> Formula:
        return self._call("tanh")

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **_: Any) -> Any:
        name = _UFUNCS.get(ufunc)
        if method != "__call__" or name is None:
            known = ", ".join(sorted(f"np.{u.__name__}" for u in _UFUNCS))
            raise _refuse(f"np.{ufunc.__name__} is no part of expressions; there are {known}")
        if any(isinstance(value, np.ndarray) for value in inputs):
            each = np.broadcast(*(np.asarray(value, dtype=object) for value in inputs))
            return np.array([ufunc(*row) for row in each] + [None], dtype=object)[:-1].reshape(each.shape)
        first = Formula._of(inputs[0])
        if name.startswith("__"):
            return getattr(first, name)(*inputs[1:])
        return first._call(name, *inputs[1:])

    def _compare(self, _: object) -> Any:
        raise _refuse("comparisons are no part of expressions, since effects have no branches: np.minimum and np.maximum bend what begins or ends somewhere")

    __lt__ = __le__ = __gt__ = __ge__ = __eq__ = __ne__ = _compare
    __hash__ = None  # type: ignore[assignment]

    def __bool__(self) -> bool:
        raise _refuse("`if`, `while`, `and`, `or`, `min` and `max` ask whether something is so, which is not known yet: np.minimum and np.maximum bend what begins or ends somewhere")

    def __float__(self) -> float:
        raise _refuse("a number is asked for, which is not known yet: functions of `math` and float() take numbers, those of NumPy (np.sin) take formulas")

    __int__ = __index__ = __float__


_UFUNCS: dict[np.ufunc, str] = {
    np.sqrt: "sqrt",
    np.exp: "exp",
    np.sin: "sin",
    np.cos: "cos",
    np.tanh: "tanh",
    np.absolute: "abs",
    np.minimum: "min",
    np.maximum: "max",
    np.add: "__add__",
    np.subtract: "__sub__",
    np.multiply: "__mul__",
    np.divide: "__truediv__",
    np.negative: "__neg__",
    np.power: "__pow__",
}


class Vector:
    """Three numbers that a function adds to."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._sums: list[Formula | None] = [None, None, None]

    def __getitem__(self, axis: int) -> Formula:
        found = self._sums[self._axis(axis)]
        return Formula("0.0") if found is None else found

    def __iadd__(self, other: Any) -> Vector:  # type: ignore[misc]
        for axis, part in enumerate(self._three(other)):
            self[axis] += part
        return self

    def __isub__(self, other: Any) -> Vector:  # type: ignore[misc]
        for axis, part in enumerate(self._three(other)):
            self[axis] -= part
        return self

    def _three(self, other: Any) -> Any:
        if np.shape(other) != (3,):
            raise _refuse(f"{self._name} has three numbers, got {other!r}: {self._name}[0] += … for one of them")
        return other

    def _refused(self, _: object) -> Any:
        raise _refuse(f"{self._name} is what the effect adds to: {self._name} += three numbers, {self._name}[0] += …")

    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __truediv__ = _refused
    __array_ufunc__ = None

    def __setitem__(self, axis: int, value: Any) -> None:
        at, new = self._axis(axis), Formula._of(value)
        # `+=` on nothing is the sum with 0.
        if self._sums[at] is None and new._text.startswith("0.0 + "):
            rest = new._text[len("0.0 + ") :]
            new = Formula(rest, new._rank)
        self._sums[at] = new

    def _axis(self, axis: Any) -> int:
        if isinstance(axis, bool) or not isinstance(axis, (int, np.integer)) or not 0 <= axis <= 2:
            raise _refuse(f"{self._name}[{axis!r}]: expected 0, 1 or 2")
        return int(axis)

    def _texts(self) -> list[str] | None:
        if all(value is None for value in self._sums):
            return None
        return ["0" if value is None else value._text for value in self._sums]


class Surroundings:
    """What an effect sees, and what it adds to. Vectors are arrays of formulas; units are SI."""

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
    }
    _ADDS = ("force", "force_body", "torque", "thrust_factor")

    def __init__(self) -> None:
        made = {"force": Vector("force"), "force_body": Vector("force_body"), "torque": Vector("torque"), "thrust_factor": None}
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
            raise _refuse(f"an effect sees {', '.join(Surroundings._SEES)} and adds to {', '.join(Surroundings._ADDS)}, not {name}")
        if isinstance(found, str):
            return Formula(found)
        parts = np.array([Formula(part) for part in found], dtype=object)
        parts.flags.writeable = False  # it is seen, not changed
        return parts

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "thrust_factor":
            new = Formula._of(value)
            if new._text.startswith("1.0 * "):
                new = Formula(new._text[len("1.0 * ") :], new._rank)
            object.__setattr__(self, name, new)
        elif name in Surroundings._ADDS:
            # `s.force += …` has added, and then sets the attribute to what it is already.
            if value is not getattr(self, name):
                raise _refuse(f"{name} has three numbers: {name} += …, {name}[0] += …")
        else:
            raise _refuse(f"an effect adds to {', '.join(Surroundings._ADDS)}, not to {name}")


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
    toml: str
    """What stands in a vehicle file: an ``[[effect]]`` of the kind ``expression``."""

    def __init__(self, function: Callable[..., Any], name: str | None = None) -> None:
        self.name = name or function.__name__
        self.__doc__ = function.__doc__
        first, *rest = inspect.signature(function).parameters.values()
        parameters = {}
        for own in rest:
            if own.default is inspect.Parameter.empty:
                raise TypeError(f"{self.name}: {own.name} has no value: write {own.name}=propwash.EffectParameter(0.1, \"N·s/m\")")
            value = own.default
            if isinstance(value, (int, float)) and not isinstance(value, bool):
                value = EffectParameter(float(value))
            if not isinstance(value, EffectParameter):
                raise TypeError(f"{self.name}: {own.name}: expected a number or a propwash.EffectParameter, got {value!r}")
            parameters[own.name] = value
        seen = Surroundings()
        returned = function(seen, **{own: Formula(own) for own in parameters})
        if returned is not None:
            raise TypeError(f"{self.name}: expected None, got {type(returned).__name__}; an effect adds to {first.name}.force and the like, and returns nothing")
        keys = {"force_world_n": seen.force, "force_body_n": seen.force_body, "torque_body_n_m": seen.torque}
        lines = [f'[[effect]]\nkind = "expression"\nname = "{self.name}"\n']
        for key, vector in keys.items():
            texts = vector._texts()
            if texts is not None:
                lines.append(f"{key} = [" + ", ".join(f'"{text}"' for text in texts) + "]\n")
        factor = object.__getattribute__(seen, "thrust_factor")
        if factor is not None:
            lines.append(f'thrust_factor = "{factor._text}"\n')
        if len(lines) == 1:
            raise TypeError(f"{self.name} adds nothing: expected {first.name}.force[0] += … or another of {', '.join(Surroundings._ADDS)}")
        self.toml = "".join([*lines, *(own._toml(key) for key, own in parameters.items())])

    def on(self, vehicle: str | os.PathLike[str] | Vehicle) -> Vehicle:
        """A vehicle with this effect behind those that it has.

        Raises:
            ValueError: for what expressions cannot say, with its place in the text; for a second effect of this name.
        """
        own = vehicle if isinstance(vehicle, Vehicle) else Vehicle(vehicle)
        return own.with_effects(self.toml)

    def __repr__(self) -> str:
        return f"<propwash.Effect {self.name}>"


def effect(function: Callable[..., Any]) -> Effect:
    """Makes an effect of a Python function of what surrounds the drone, which runs once and then never again.

    The function takes ``s`` and adds to ``s.force`` (N, world), ``s.force_body`` (N, body), ``s.torque`` (N m, body), three numbers at once or one (``s.force[0] += …``), or multiplies
    ``s.thrust_factor``. It sees ``s.t`` (s since the reset), ``s.pos``, ``s.vel`` (world), ``s.vel_body`` (through the air, body), ``s.ang_vel`` (body),
    ``s.quat``, ``s.roll``, ``s.pitch``, ``s.yaw``, ``s.rotor_vel``, ``s.rotor_sum``, ``s.thrust``, ``s.ground`` and ``s.ceiling`` (m to them), ``s.others`` (m to the nearest
    vehicle), ``s.wind``, ``s.air_density``, ``s.mass``, ``s.gravity``; arithmetic, whole powers, ``abs`` and NumPy's ``sqrt``, ``exp``, ``sin``, ``cos``, ``tanh``,
    ``minimum``, ``maximum``. Further arguments are parameters, with their values as defaults (``EffectParameter``), which are ``effect.expression.NAME.ARGUMENT`` elsewhere.

    Raises:
        TypeError: for what cannot be part of an expression: branches, comparisons, functions of ``math``, other names; the message says the line.
    """
    return Effect(function)
