"""Numbers that are not known yet: what Python functions that run once compute with, and the expressions of a vehicle file that they become."""

from __future__ import annotations

import contextlib
import contextvars
import linecache
import os
import re
import sys
from typing import Any, Callable, Iterator, Mapping, Sequence, Union

import numpy as np

Operand = Union["Formula", float, int]

#: What comparisons, sums and products are worth in the text of an expression, for parentheses: the higher, the tighter.
_COMPARE, _SUM, _PRODUCT, _MINUS, _POWER, _ATOM = range(6)

#: Texts above this length get a name, so that no expression grows with the number of times that something is used.
_LONG = 100

_FILES = (__file__, *(os.path.join(os.path.dirname(__file__), name) for name in ("effects.py", "controllers.py", "learn.py", "costs.py")))


def _where() -> str:
    """The line of the user's code that is running: the innermost one that is not of these files or NumPy's."""
    frame = sys._getframe(1)
    numpy = os.path.dirname(np.__file__)
    while frame is not None and (frame.f_code.co_filename in _FILES or frame.f_code.co_filename.startswith((numpy, "<__array_function__"))):
        frame = frame.f_back  # type: ignore[assignment]
    if frame is None:
        return ""
    line = linecache.getline(frame.f_code.co_filename, frame.f_lineno).strip()
    return f" ({os.path.basename(frame.f_code.co_filename)}, line {frame.f_lineno}{': ' + line if line else ''})"


def refuse(what: str) -> TypeError:
    """The error for what cannot be an expression, with the line of the user's function."""
    return TypeError(what + _where())


class BeyondError(TypeError):
    """A number of a vector is asked for that this vehicle does not have, and another one may."""


class Names:
    """Values with names, in the order in which a function computed them."""

    def __init__(self, taken: set[str]) -> None:
        self.taken = taken
        self._known: dict[str, str] = {}

    def name(self, text: str) -> str:
        """The name of a value; the same text has the same name."""
        found = self._known.get(text)
        if found is None:
            number = len(self._known) + 1
            while f"v{number}" in self.taken:
                number += 1
            found = f"v{number}"
            self.taken.add(found)
            self._known[text] = found
        return found

    def used_by(self, texts: list[str]) -> list[tuple[str, str]]:
        """Names and texts of the values that these texts need, in order."""
        of = {name: text for text, name in self._known.items()}
        wanted, waiting = set(), list(texts)
        while waiting:
            for word in re.findall(r"[A-Za-z_]\w*", waiting.pop()):
                if word in of and word not in wanted:
                    wanted.add(word)
                    waiting.append(of[word])
        return [(name, text) for text, name in self._known.items() if name in wanted]


_names: contextvars.ContextVar[Names | None] = contextvars.ContextVar("propwash_names", default=None)


@contextlib.contextmanager
def naming(names: Names) -> Iterator[None]:
    """While a function runs whose long values get names."""
    token = _names.set(names)
    try:
        yield
    finally:
        _names.reset(token)


class Formula:
    """A number that is not known yet, as the text of an expression."""

    __slots__ = ("_rank", "_text")

    def __init__(self, text: str, rank: int = _ATOM) -> None:
        names = _names.get()
        if names is not None and len(text) > _LONG and rank != _COMPARE:
            text, rank = names.name(text), _ATOM
        self._text, self._rank = text, rank

    def __repr__(self) -> str:
        return self._text

    @staticmethod
    def of(value: Any) -> Formula:
        """A number as one; anything else is refused."""
        if isinstance(value, Formula):
            return value
        if isinstance(value, np.ndarray) and value.shape == ():
            value = value.item()
            if isinstance(value, Formula):
                return value
        if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, float, np.integer, np.floating)):
            raise refuse(f"expected a number or a formula of the state, got {value!r} ({type(value).__name__})")
        number = float(value)
        if not np.isfinite(number):
            raise refuse(f"expected a finite number, got {number}")
        return Formula(repr(number), _MINUS if number < 0 else _ATOM)

    def _in(self, least: int) -> str:
        return self._text if self._rank >= least else f"({self._text})"

    def _two(self, sign: str, other: Any, rank: int, swapped: bool = False) -> Any:
        if isinstance(other, np.ndarray) and other.shape != ():
            return NotImplemented
        a, b = (Formula.of(other), self) if swapped else (self, Formula.of(other))
        # What stands behind − and / keeps its parentheses, also where it is of the same rank; so does what begins with a minus.
        plain = _simpler(sign, a, b)
        if plain is not None:
            return plain
        left = max(rank, _SUM)  # comparisons do not chain
        return Formula(f"{a._in(left)} {sign} {b._in(max(rank + 1, _POWER if b._rank == _MINUS else 0))}", rank)

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
        return self.call("abs")

    def __pow__(self, power: Any) -> Formula:
        if isinstance(power, (float, np.floating)) and float(power).is_integer():
            power = int(power)
        if isinstance(power, (bool, Formula)) or not isinstance(power, (int, np.integer)) or not -16 <= power <= 16:
            raise refuse(f"expected a whole power from -16 to 16, got {power!r}; roots are np.sqrt")
        return Formula(f"{self._in(_ATOM)}^{int(power)}", _POWER)

    def call(self, name: str, *others: Any) -> Formula:
        """A function of expressions, of this and further numbers."""
        return Formula(f"{name}({', '.join([self._text, *(Formula.of(other)._text for other in others)])})")

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **more: Any) -> Any:
        return _ufunc(ufunc, method, inputs, more)

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        return _function(function, args, kwargs)

    def __lt__(self, other: Any) -> Any:
        return self._two("<", other, _COMPARE)

    def __le__(self, other: Any) -> Any:
        return self._two("<=", other, _COMPARE)

    def __gt__(self, other: Any) -> Any:
        return self._two(">", other, _COMPARE)

    def __ge__(self, other: Any) -> Any:
        return self._two(">=", other, _COMPARE)

    def __and__(self, other: Any) -> Formula:
        return self.call("min", other)

    def __or__(self, other: Any) -> Formula:
        return self.call("max", other)

    def __invert__(self) -> Any:
        return 1 - self

    def _equal(self, _: object) -> Any:
        raise refuse("== and != are no part of expressions, since two numbers of a flight are never quite the same: compare by <, <=, > or >=")

    __eq__ = __ne__ = _equal
    __hash__ = None  # type: ignore[assignment]

    def __bool__(self) -> bool:
        raise refuse("`if`, `while`, `and`, `or`, `min` and `max` ask whether something is so, which is not known yet: np.where(condition, a, b) chooses, & and | join conditions, np.minimum and np.maximum bend")

    def __float__(self) -> float:
        raise refuse("a number is asked for, which is not known yet: functions of `math`, float() and np.linalg take numbers, those of NumPy (np.sin) take formulas")

    __int__ = __index__ = __float__


def _simpler(sign: str, a: Formula, b: Formula) -> Formula | None:
    """A sum with 0, or a product with 0 or 1, without it: matrices of vehicles are full of them."""
    zero_a, zero_b = a._text == "0.0", b._text == "0.0"
    if sign == "+" and (zero_a or zero_b):
        return b if zero_a else a
    if sign == "-" and zero_b:
        return a
    if sign == "*" and (zero_a or zero_b):
        return Formula("0.0")
    if sign == "*" and "1.0" in (a._text, b._text):
        return b if a._text == "1.0" else a
    return None


_UFUNCS: dict[np.ufunc, str] = {
    np.sqrt: "sqrt",
    np.exp: "exp",
    np.sin: "sin",
    np.cos: "cos",
    np.tan: "tan",
    np.arcsin: "asin",
    np.arccos: "acos",
    np.arctan2: "atan2",
    np.tanh: "tanh",
    np.floor: "floor",
    np.sign: "sign",
    np.absolute: "abs",
    np.minimum: "min",
    np.maximum: "max",
    np.add: "__add__",
    np.subtract: "__sub__",
    np.multiply: "__mul__",
    np.divide: "__truediv__",
    np.negative: "__neg__",
    np.positive: "__pos__",
    np.power: "__pow__",
    np.less: "__lt__",
    np.less_equal: "__le__",
    np.greater: "__gt__",
    np.greater_equal: "__ge__",
    np.logical_and: "__and__",
    np.logical_or: "__or__",
    np.logical_not: "__invert__",
    np.bitwise_and: "__and__",
    np.bitwise_or: "__or__",
    np.invert: "__invert__",
}

#: Those that are written by others.
_BY_OTHERS: dict[np.ufunc, Callable[..., Any]] = {
    np.square: lambda a: a * a,
    np.hypot: lambda a, b: np.sqrt(a * a + b * b),
    np.reciprocal: lambda a: 1 / a,
    np.arctan: lambda a: a.call("atan2", 1.0),
    np.equal: lambda a, b: Formula.of(a) == b,
    np.not_equal: lambda a, b: Formula.of(a) != b,
}


def _one(ufunc: np.ufunc, *values: Any) -> Any:
    """A function of single numbers."""
    if not any(isinstance(value, Formula) for value in values):
        return ufunc(*values)
    if ufunc in _BY_OTHERS:
        return _BY_OTHERS[ufunc](*values)
    name = _UFUNCS.get(ufunc)
    if name is None:
        known = ", ".join(sorted(f"np.{u.__name__}" for u in [*_UFUNCS, *_BY_OTHERS]))
        raise refuse(f"np.{ufunc.__name__} is no part of expressions; there are {known}")
    first = Formula.of(values[0])
    if name.startswith("__"):
        return getattr(first, name)(*values[1:])
    return first.call(name, *values[1:])


def _boxed(value: Any) -> np.ndarray[Any, Any]:
    """As a plain array of objects."""
    if isinstance(value, np.ndarray):
        return np.asarray(value, dtype=object)
    if isinstance(value, Formula):
        out = np.empty((), dtype=object)
        out[()] = value
        return out
    return np.array(value, dtype=object)


def _plain(value: Any) -> Any:
    """The same of plain arrays, also within lists."""
    if isinstance(value, (list, tuple)):
        return [_plain(one) for one in value]
    return _boxed(value) if isinstance(value, (Formula, Numbers)) else value


def _each(function: Callable[..., Any], *values: Any) -> Any:
    """A function of single numbers for all numbers of arrays."""
    together = np.broadcast(*[_boxed(value) for value in values])
    out = np.empty(together.shape, dtype=object)
    for at, numbers in zip(np.ndindex(*together.shape), together):
        out[at] = function(*numbers)
    return out.view(Numbers) if out.shape else out[()]


def _ufunc(ufunc: np.ufunc, method: str, inputs: tuple[Any, ...], more: dict[str, Any]) -> Any:
    target = more.pop("out", None)
    if method == "__call__" and ufunc is not np.matmul and not more:
        out = _each(lambda *values: _one(ufunc, *values), *inputs)
    elif ufunc in (np.matmul, np.add, np.multiply):
        # Sums and products of objects are NumPy's own.
        plain = [_boxed(value) for value in inputs]
        out = getattr(ufunc, method)(*plain, **more)
        out = out.view(Numbers) if isinstance(out, np.ndarray) and out.shape else out
    else:
        raise refuse(f"np.{ufunc.__name__}.{method} is no part of expressions: take the numbers one by one")
    if target is None:
        return out
    target[0][...] = out
    return target[0]


def _function(function: Any, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
    if function is np.where and len(args) == 3 and not kwargs:
        return _each(_choice, *args)
    if function is np.clip and len(args) == 3 and not kwargs:
        return _each(lambda value, low, high: _one(np.minimum, _one(np.maximum, value, low), high), *args)
    if not any(isinstance(value, Formula) for value in args):
        out = function(*_plain(args), **kwargs)
        return out.view(Numbers) if isinstance(out, np.ndarray) and out.dtype == object else out
    raise refuse(f"np.{function.__name__} is no part of expressions: np.where and np.clip are, and what has sums and products of arrays")


def _choice(condition: Any, yes: Any, no: Any) -> Any:
    if not isinstance(condition, Formula):
        return yes if condition else no
    return condition.call("where", yes, no)


class Numbers(np.ndarray[Any, Any]):
    """Numbers that are not known yet, as an array: what NumPy does with arrays of numbers, element by element."""

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **more: Any) -> Any:
        return _ufunc(ufunc, method, inputs, more)

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        return _function(function, args, kwargs)


def numbers(texts: Any) -> Numbers:
    """An array of names of numbers."""
    out = np.empty(len(texts), dtype=object)
    out[:] = [Formula(text) for text in texts]
    out.flags.writeable = False  # it is seen, not changed
    return out.view(Numbers)


class Sight:
    """What a function that runs once sees: names of numbers, one or several under each attribute.

    ``who`` sees it, in errors; ``elsewhere`` says of further names why they are not seen.
    """

    def __init__(self, who: str, sees: Mapping[str, Sequence[str]], elsewhere: Mapping[str, str] = {}) -> None:
        self._who, self._sees, self._elsewhere = who, dict(sees), elsewhere

    def __getattr__(self, name: str) -> Any:
        found = self._sees.get(name)
        if found is not None:
            texts = numbers(found)
            return texts if len(found) > 1 else texts[0]
        why = f": {self._elsewhere[name]}" if name in self._elsewhere else ""
        raise refuse(f"{self._who} sees {', '.join(self._sees)} here, not {name}{why}")


def said(what: str, value: Any) -> Formula:
    """A number that a function returned; ``what`` names the function in the error for anything else."""
    if isinstance(value, (bool, np.bool_)):
        value = float(value)
    try:
        return Formula.of(value)
    except TypeError as e:
        raise TypeError(f"{what}: {e}") from None


class Vector:
    """Numbers that a function adds to, or sets."""

    def __init__(self, name: str, length: int = 3, start: list[str] | None = None, *, most: int = 0) -> None:
        #: As many numbers as other vehicles may have.
        self._most = most
        self._name = name
        self._values: list[Formula | None] = [None] * length
        self._start = start

    def __len__(self) -> int:
        return len(self._values)

    def _one(self, at: int) -> Formula:
        found = self._values[at]
        if found is None:
            return Formula("0.0" if self._start is None else self._start[at])
        return found

    def __getitem__(self, axis: Any) -> Any:
        if isinstance(axis, slice):
            out = np.empty(len(range(*axis.indices(len(self)))), dtype=object)
            out[:] = [self._one(at) for at in range(*axis.indices(len(self)))]
            return out.view(Numbers)
        return self._one(self._axis(axis))

    def __setitem__(self, axis: Any, value: Any) -> None:
        if isinstance(axis, slice):
            places = range(*axis.indices(len(self)))
            given = list(np.broadcast_to(_boxed(value), len(places)))
            for at, one in zip(places, given):
                self[at] = one
            return
        at, new = self._axis(axis), Formula.of(value)
        self._values[at] = new

    def __iadd__(self, value: Any) -> Vector:  # type: ignore[misc]
        self[:] = self[:] + self._whole(value)
        return self

    def __isub__(self, value: Any) -> Vector:  # type: ignore[misc]
        self[:] = self[:] - self._whole(value)
        return self

    def _whole(self, value: Any) -> Any:
        if np.shape(value) != (len(self),):
            raise refuse(f"{self._name} has {len(self)} numbers, got {value!r}: {self._name}[0] += … for one of them")
        return value

    def _refused(self, _: object) -> Any:
        raise refuse(f"{self._name} is what the function writes: {self._name} += {len(self)} numbers, {self._name}[0] += …; {self._name}[:] are its numbers")

    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __imul__ = __truediv__ = __rtruediv__ = __itruediv__ = _refused
    __array_ufunc__ = None

    def _axis(self, axis: Any) -> int:
        last = len(self) - 1
        if isinstance(axis, bool) or not isinstance(axis, (int, np.integer)) or not 0 <= axis <= last:
            error = refuse(f"{self._name}[{axis!r}]: expected {'0, 1 or 2' if last == 2 else f'0 to {last}'}")
            raise BeyondError(str(error)) if isinstance(axis, int) and last < axis < self._most else error
        return int(axis)

    def texts(self) -> list[str] | None:
        """Its expressions; `None` where nothing was set."""
        if all(value is None for value in self._values):
            return None
        return [self._one(at)._text if self._start is not None or value is not None else "0" for at, value in enumerate(self._values)]
